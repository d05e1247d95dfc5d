//! Tables between stages.
//!
//! Canonical form, little endian: `pipeline table 1\n`; counts of columns and rows (u64); for each column its name
//! and unit; for each cell, row by row, a tag (0 empty, 1 truth value, 2 integer, 3 number, 4 text) and its value (u8, i128, bits
//! of an f64, text). A text is its length in bytes (u64) and UTF-8.

use std::io::{self, Read, Write};

use crate::engine::artifact::{Artifact, Origin, SaveError, Saved, TypeName};
use crate::figure::table::{Cell, Column, Table};

const HEADER: &[u8] = b"pipeline table 1\n";

impl Artifact for Table {
    const TYPE: TypeName = "table";
    const FORMATS: &'static [&'static str] = &["csv", "json"];

    fn write(&self, out: &mut dyn Write) -> io::Result<()> {
        out.write_all(HEADER)?;
        out.write_all(&(self.columns.len() as u64).to_le_bytes())?;
        out.write_all(&(self.rows.len() as u64).to_le_bytes())?;
        for column in &self.columns {
            write_text(out, &column.name)?;
            write_text(out, &column.unit)?;
        }
        self.rows.iter().flatten().try_for_each(|cell| write_cell(out, cell))
    }

    fn read(input: &mut dyn Read) -> io::Result<Self> {
        if bytes::<{ HEADER.len() }>(input)? != HEADER {
            return Err(invalid("not a table"));
        }
        let [columns, rows] = [read_count(input)?, read_count(input)?];
        if columns == 0 && rows > 0 {
            return Err(invalid("rows without columns"));
        }
        let mut table = Table::new(Vec::new());
        for _ in 0..columns {
            table.columns.push(Column::new(read_text(input)?, read_text(input)?));
        }
        for _ in 0..rows {
            table.rows.push((0..columns).map(|_| read_cell(input)).collect::<io::Result<_>>()?);
        }
        if input.read(&mut [0])? != 0 {
            return Err(invalid("bytes after the last cell"));
        }
        Ok(table)
    }

    fn memory(&self) -> u64 {
        let text = |cell: &Cell| if let Cell::Text(text) = cell { text.len() } else { 0 };
        let cells: usize = self.rows.iter().flatten().map(|cell| size_of::<Cell>() + text(cell)).sum();
        (cells + self.rows.len() * size_of::<Vec<Cell>>() + self.columns.len() * size_of::<Column>()) as u64
    }

    fn save(&self, format: &str, _: &Origin) -> Result<Saved, SaveError> {
        match format {
            "csv" => Ok(self.to_csv().into()),
            "json" => Ok(self.to_json().into()),
            _ => Err(SaveError(format!("a table cannot be written as `{format}`"))),
        }
    }
}

fn write_text(out: &mut dyn Write, text: &str) -> io::Result<()> {
    out.write_all(&(text.len() as u64).to_le_bytes())?;
    out.write_all(text.as_bytes())
}

fn write_cell(out: &mut dyn Write, cell: &Cell) -> io::Result<()> {
    match cell {
        Cell::Empty => out.write_all(&[0]),
        Cell::Boolean(value) => out.write_all(&[1, u8::from(*value)]),
        Cell::Integer(value) => out.write_all(&[2]).and_then(|()| out.write_all(&value.to_le_bytes())),
        Cell::Number(value) => out.write_all(&[3]).and_then(|()| out.write_all(&value.to_bits().to_le_bytes())),
        Cell::Text(text) => out.write_all(&[4]).and_then(|()| write_text(out, text)),
    }
}

fn read_cell(input: &mut dyn Read) -> io::Result<Cell> {
    match bytes::<1>(input)? {
        [0] => Ok(Cell::Empty),
        [1] => match bytes::<1>(input)? {
            [0] => Ok(Cell::Boolean(false)),
            [1] => Ok(Cell::Boolean(true)),
            _ => Err(invalid("a truth value is neither 0 nor 1")),
        },
        [2] => Ok(Cell::Integer(i128::from_le_bytes(bytes(input)?))),
        [3] => Ok(Cell::Number(f64::from_bits(u64::from_le_bytes(bytes(input)?)))),
        [4] => Ok(Cell::Text(read_text(input)?)),
        _ => Err(invalid("a cell of no known sort")),
    }
}

fn bytes<const COUNT: usize>(input: &mut dyn Read) -> io::Result<[u8; COUNT]> {
    let mut bytes = [0; COUNT];
    match input.read_exact(&mut bytes) {
        Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => Err(invalid("the table ends too early")),
        other => other.map(|()| bytes),
    }
}

fn read_count(input: &mut dyn Read) -> io::Result<u64> {
    Ok(u64::from_le_bytes(bytes(input)?))
}

/// A text; grows with what the input really holds, whatever length it claims.
fn read_text(mut input: &mut dyn Read) -> io::Result<String> {
    let length = read_count(input)?;
    let mut text = Vec::new();
    (&mut input).take(length).read_to_end(&mut text)?;
    if text.len() as u64 != length {
        return Err(invalid("the table ends too early"));
    }
    String::from_utf8(text).map_err(|_| invalid("a text is not UTF-8"))
}

fn invalid(message: &str) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, message)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table() -> Table {
        let mut table = Table::new(vec![Column::new("n", ""), Column::new("angle", "deg")]);
        table.push(vec![Cell::Integer(-7), Cell::Number(-0.0)]);
        table.push(vec![Cell::Empty, Cell::Text("Größe\n".into())]);
        table.push(vec![Cell::Boolean(true), Cell::Number(f64::INFINITY)]);
        table
    }

    fn written(table: &Table) -> Vec<u8> {
        let mut bytes = Vec::new();
        table.write(&mut bytes).unwrap();
        bytes
    }

    #[test]
    fn the_canonical_form_reads_back_equal() {
        let bytes = written(&table());
        let read = Table::read(&mut bytes.as_slice()).unwrap();
        assert_eq!(read, table());
        assert_eq!(written(&read), bytes);
    }

    #[test]
    fn bytes_that_are_cut_prolonged_or_wrong_are_refused() {
        let bytes = written(&table());
        for length in 0..bytes.len() {
            let error = Table::read(&mut &bytes[..length]).unwrap_err();
            assert_eq!(error.kind(), io::ErrorKind::InvalidData, "{length}");
        }
        assert!(Table::read(&mut [bytes.clone(), vec![0]].concat().as_slice()).is_err());
        let mut huge = bytes;
        huge[17..25].copy_from_slice(&u64::MAX.to_le_bytes());
        assert!(Table::read(&mut huge.as_slice()).is_err());
    }
}

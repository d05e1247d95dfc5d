//! Tables: those of one stage put together, with a column for each axis.

use serde::Serialize;
use serde_json::Value as Json;

use crate::engine::manifest::plain_text;
use crate::figure::table::{Cell, Table};

/// Rows of a table that are shown at most.
pub const ROWS: usize = 300;

/// A table as it is shown.
#[derive(Debug, Clone, Serialize)]
pub struct Shown {
    /// Name of the stage, with `.result` for a further result.
    pub title: String,
    /// What it is, where that is known.
    pub note: String,
    /// Its columns.
    pub columns: Vec<Head>,
    /// The rows that are shown.
    pub rows: Vec<Vec<Field>>,
    /// Rows that are left out.
    pub left_out: usize,
    /// Links to published files: text and address.
    pub files: Vec<[String; 2]>,
}

/// The head of a column.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Head {
    /// Its name.
    pub name: String,
    /// Its unit.
    pub unit: String,
    /// Whether numbers stand in it.
    pub is_numeric: bool,
}

/// A cell: the text that is shown, and where that is rounded the exact one.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Field {
    /// What is shown.
    pub text: String,
    /// The value, where the text is not all of it.
    pub exact: Option<String>,
}

/// Puts the tables of the jobs of a stage together; each with its coordinate.
pub fn shown(title: String, parts: &[(&Json, Table)]) -> Shown {
    let mut names: Vec<(String, String, bool)> = Vec::new();
    let mut add = |name: &str, unit: &str, is_axis: bool| {
        if !names.iter().any(|(known, ..)| known == name) {
            names.push((name.to_owned(), unit.to_owned(), is_axis));
        }
    };
    for (coordinate, _) in parts {
        coordinate.as_object().into_iter().flatten().for_each(|(axis, _)| add(axis, "", true));
    }
    for (_, table) in parts {
        table.columns.iter().for_each(|column| add(&column.name, &column.unit, false));
    }
    let row_count: usize = parts.iter().map(|(_, table)| table.rows.len()).sum();
    let rows: Vec<Vec<Cell>> = parts.iter().flat_map(|(coordinate, table)| rows(&names, coordinate, table)).take(ROWS).collect();
    let is_numeric = |column: usize| {
        let mut filled = rows.iter().map(|row| &row[column]).filter(|cell| **cell != Cell::Empty).peekable();
        filled.peek().is_some() && filled.all(|cell| cell.number().is_some())
    };
    let columns = names.iter().enumerate().map(|(index, (name, unit, _))| Head {
        name: name.clone(),
        unit: unit.clone(),
        is_numeric: is_numeric(index),
    });
    Shown {
        title,
        note: String::new(),
        columns: columns.collect(),
        left_out: row_count - rows.len(),
        rows: rows.iter().map(|row| row.iter().map(field).collect()).collect(),
        files: Vec::new(),
    }
}

fn rows<'a>(names: &'a [(String, String, bool)], coordinate: &'a Json, table: &'a Table) -> impl Iterator<Item = Vec<Cell>> + 'a {
    let places: Vec<Option<usize>> = names.iter().map(|(name, ..)| table.column(name)).collect();
    let cell = move |index: usize, row: &[Cell]| match places[index] {
        Some(column) => row[column].clone(),
        None => coordinate.get(&names[index].0).map_or(Cell::Empty, cell_of),
    };
    table.rows.iter().map(move |row| (0..names.len()).map(|index| cell(index, row)).collect())
}

fn cell_of(value: &Json) -> Cell {
    match value {
        Json::Bool(value) => Cell::Boolean(*value),
        Json::Number(number) => number.as_f64().map_or(Cell::Empty, Cell::from_number),
        other => Cell::Text(plain_text(other)),
    }
}

/// Six significant digits, and the exact value where that is not all.
fn field(cell: &Cell) -> Field {
    let exact = cell.to_string();
    match cell {
        Cell::Number(value) if value.is_finite() => {
            let text = rounded(*value);
            Field { exact: (text != exact).then_some(exact), text }
        }
        _ => Field { text: exact, exact: None },
    }
}

/// Six significant digits, without zeros at the end; with an exponent where it is far from one.
pub fn rounded(value: f64) -> String {
    let size = value.abs();
    if value == 0.0 {
        return "0".into();
    }
    if !(1e-4..1e7).contains(&size) {
        let text = format!("{value:.4e}");
        let (digits, exponent) = text.split_once('e').unwrap_or((&text, "0"));
        return format!("{}e{exponent}", trimmed(digits));
    }
    let exponent = format!("{size:e}").split_once('e').and_then(|(_, exponent)| exponent.parse::<i32>().ok()).unwrap_or(0);
    let decimals = (5 - exponent).clamp(0, 9) as usize;
    trimmed(&format!("{value:.decimals$}")).to_owned()
}

fn trimmed(text: &str) -> &str {
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { text }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::figure::table::Column;
    use serde_json::json;

    #[test]
    fn tables_of_a_stage_are_one_with_its_axes() {
        let table = |value| {
            let mut table = Table::new(vec![Column::new("rmse", "W")]);
            table.push(vec![Cell::Number(value)]);
            table
        };
        let coordinates = [json!({ "n": 64, "by": "a" }), json!({ "n": 256, "by": "b" })];
        let shown = shown("error".into(), &[(&coordinates[0], table(0.123_456_789)), (&coordinates[1], table(2.0))]);
        let heads: Vec<_> = shown.columns.iter().map(|head| (head.name.as_str(), head.is_numeric)).collect();
        assert_eq!(heads, [("n", true), ("by", false), ("rmse", true)]);
        assert_eq!(shown.rows[0][2], Field { text: "0.123457".into(), exact: Some("0.123456789".into()) });
        assert_eq!((shown.rows[1][0].text.as_str(), shown.left_out), ("256", 0));
    }

    #[test]
    fn numbers_have_six_digits() {
        for (value, text) in
            [(0.0, "0"), (1234567.8, "1234568"), (0.000123456789, "0.000123457"), (1.5e-9, "1.5e-9"), (-2.5, "-2.5"), (3e12, "3e12")]
        {
            assert_eq!(rounded(value), text);
        }
    }
}

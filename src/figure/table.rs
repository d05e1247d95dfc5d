//! Tables: named columns with units, rows of cells.
//!
//! The container, its text forms, and what can be done with rows alone: putting tables one after the
//! other, choosing, sorting, averaging repetitions. Computing what stands in a cell is others' work.

use std::cmp::Ordering;
use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use serde_json::{Value as Json, json};

use super::estimate;

/// Rows or columns that do not allow what is asked of them.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum TableError {
    /// A column that is asked for is not there.
    #[error("no column `{name}`; there are {}", listed(available))]
    NoColumn {
        /// What was asked for.
        name: String,
        /// What there is.
        available: Vec<String>,
    },
    /// Tables that do not fit together.
    #[error("column `{column}` is in `{first}` in one table and in `{second}` in another")]
    Units {
        /// The column.
        column: String,
        /// Its unit in an earlier table.
        first: String,
        /// Its unit in a later one.
        second: String,
    },
}

fn listed(names: &[String]) -> String {
    if names.is_empty() { "none".into() } else { names.iter().map(|name| format!("`{name}`")).collect::<Vec<_>>().join(", ") }
}

/// One value of a table.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Cell {
    /// Nothing there: an axis that this row does not have.
    Empty,
    /// A truth value.
    Boolean(bool),
    /// An exact integer (counts, seeds).
    Integer(i128),
    /// A measured or computed number.
    Number(f64),
    /// Text.
    Text(String),
}

impl Cell {
    /// A number in its one form: an integer where it is whole and below 2^53.
    pub fn from_number(value: f64) -> Self {
        let is_whole = value.fract() == 0.0 && value.abs() <= 9_007_199_254_740_992.0;
        if is_whole { Cell::Integer(value as i128) } else { Cell::Number(value) }
    }

    /// Whether the cell says the same, however it is stored: 1 and 1.0 do.
    pub fn means(&self, other: &Cell) -> bool {
        self.order(other) == Ordering::Equal
    }

    /// Empty cells first, then truth values, numbers by size (NaN last), text by its characters.
    pub fn order(&self, other: &Cell) -> Ordering {
        match (self, other) {
            (Cell::Boolean(a), Cell::Boolean(b)) => a.cmp(b),
            (Cell::Text(a), Cell::Text(b)) => a.cmp(b),
            (Cell::Integer(a), Cell::Integer(b)) => a.cmp(b),
            _ => match (self.number(), other.number()) {
                // Adding zero makes one of the two zeros.
                (Some(a), Some(b)) => (a + 0.0).total_cmp(&(b + 0.0)),
                _ => self.rank().cmp(&other.rank()),
            },
        }
    }

    fn rank(&self) -> u8 {
        match self {
            Cell::Empty => 0,
            Cell::Boolean(_) => 1,
            Cell::Integer(_) | Cell::Number(_) => 2,
            Cell::Text(_) => 3,
        }
    }

    /// The cell as a number, if it is one.
    pub fn number(&self) -> Option<f64> {
        match self {
            Cell::Integer(value) => Some(*value as f64),
            Cell::Number(value) => Some(*value),
            Cell::Empty | Cell::Boolean(_) | Cell::Text(_) => None,
        }
    }
}

impl std::fmt::Display for Cell {
    /// Shortest text that reads back as the same value; whole numbers without a point; nothing for an empty cell.
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Cell::Empty => Ok(()),
            Cell::Boolean(value) => value.fmt(out),
            Cell::Integer(value) => value.fmt(out),
            Cell::Number(value) => {
                // `{:?}` is the shortest round-trip form and switches to an exponent for large and small values.
                let text = format!("{value:?}");
                out.write_str(text.strip_suffix(".0").unwrap_or(&text))
            }
            Cell::Text(value) => value.fmt(out),
        }
    }
}

/// A column's name and unit.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Column {
    /// Unique in its table; axis columns of map-valued axes read `axis.field`.
    pub name: String,
    /// Unit of the numbers (`deg`, `stops`, `sr`, `W/m2`); empty where they have none.
    pub unit: String,
}

impl Column {
    /// A column of that name and unit (empty: none).
    pub fn new(name: impl Into<String>, unit: impl Into<String>) -> Self {
        Self { name: name.into(), unit: unit.into() }
    }
}

/// Rows of cells under named columns.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Table {
    /// The columns, left to right.
    pub columns: Vec<Column>,
    /// The rows, top to bottom; each as long as `columns`.
    pub rows: Vec<Vec<Cell>>,
}

impl Table {
    /// An empty table with these columns.
    pub fn new(columns: Vec<Column>) -> Self {
        Self { columns, rows: Vec::new() }
    }

    /// Adds a row.
    ///
    /// # Panics
    /// If the row is not as long as the list of columns.
    pub fn push(&mut self, row: Vec<Cell>) {
        assert_eq!(row.len(), self.columns.len(), "a row has one cell per column");
        self.rows.push(row);
    }

    /// The position of the column of that name.
    pub fn column(&self, name: &str) -> Option<usize> {
        self.columns.iter().position(|column| column.name == name)
    }

    /// The position of the column of that name, or what there is instead.
    pub fn required_column(&self, name: &str) -> Result<usize, TableError> {
        self.column(name).ok_or_else(|| TableError::NoColumn { name: name.into(), available: self.names() })
    }

    /// Positions of several columns.
    pub fn required_columns(&self, names: &[String]) -> Result<Vec<usize>, TableError> {
        names.iter().map(|name| self.required_column(name)).collect()
    }

    /// The names of the columns.
    pub fn names(&self) -> Vec<String> {
        self.columns.iter().map(|column| column.name.clone()).collect()
    }

    /// The columns of these names, in this order.
    pub fn selected(&self, names: &[String]) -> Result<Table, TableError> {
        let positions = self.required_columns(names)?;
        let columns = positions.iter().map(|position| self.columns[*position].clone()).collect();
        let rows = self.rows.iter().map(|row| positions.iter().map(|position| row[*position].clone()).collect()).collect();
        Ok(Table { columns, rows })
    }

    /// The rows in order of these columns, the first one first; a `-` before a name turns its order around.
    ///
    /// Rows that are equal there keep their order; so do numbers that are not (NaN comes last).
    pub fn sorted(mut self, names: &[String]) -> Result<Table, TableError> {
        let keys = names
            .iter()
            .map(|name| match name.strip_prefix('-') {
                Some(bare) if self.column(name).is_none() => Ok((self.required_column(bare)?, true)),
                _ => Ok((self.required_column(name)?, false)),
            })
            .collect::<Result<Vec<_>, TableError>>()?;
        self.rows.sort_by(|a, b| {
            let orders = keys.iter().map(|&(column, is_falling)| {
                let order = a[column].order(&b[column]);
                if is_falling { order.reverse() } else { order }
            });
            orders.fold(Ordering::Equal, Ordering::then)
        });
        Ok(self)
    }

    /// One row for all rows that differ only in `axis` and in measured numbers: their means.
    ///
    /// A column is measured if a cell of it is a [`Cell::Number`] and it is none of the first `label_count`;
    /// all others tell rows apart. In place of `axis` stands `count`, how many rows were taken together, and in
    /// place of a measured column `m` stand `m.mean`, `m.standard_error`, `m.low` and `m.high`: the Student t interval of that
    /// `level`. Standard error and interval are empty for fewer than two numbers.
    pub fn summarized(&self, axis: &str, level: f64, label_count: usize) -> Result<Table, TableError> {
        let axis = self.required_column(axis)?;
        let is_measured = |column: usize| column >= label_count && self.rows.iter().any(|row| matches!(row[column], Cell::Number(_)));
        let (measured, labels): (Vec<usize>, Vec<usize>) =
            (0..self.columns.len()).filter(|column| *column != axis).partition(|c| is_measured(*c));

        let mut columns: Vec<Column> = labels.iter().map(|column| self.columns[*column].clone()).collect();
        columns.push(Column::new("count", ""));
        for Column { name, unit } in measured.iter().map(|column| &self.columns[*column]) {
            columns.extend(["mean", "standard_error", "low", "high"].map(|what| Column::new(format!("{name}.{what}"), unit)));
        }

        let mut table = Table::new(columns);
        for group in self.groups(&labels) {
            let mut row: Vec<Cell> = labels.iter().map(|column| group[0][*column].clone()).collect();
            row.push(Cell::Integer(group.len() as i128));
            for &column in &measured {
                let values: Vec<f64> = group.iter().filter_map(|row| row[column].number()).collect();
                row.extend(summary(&values, level));
            }
            table.push(row);
        }
        Ok(table)
    }

    /// Rows that agree in these columns, in the order in which their first ones stand.
    pub fn groups(&self, columns: &[usize]) -> Vec<Vec<&[Cell]>> {
        let mut positions: BTreeMap<Vec<(u8, String)>, usize> = BTreeMap::new();
        let mut groups: Vec<Vec<&[Cell]>> = Vec::new();
        for row in &self.rows {
            let key = columns.iter().map(|column| (row[*column].rank(), row[*column].to_string())).collect();
            let position = *positions.entry(key).or_insert(groups.len());
            if position == groups.len() {
                groups.push(Vec::new());
            }
            groups[position].push(row);
        }
        groups
    }

    /// The table as CSV (RFC 4180): a line of names, then the rows; numbers in the shortest form that reads back equal.
    ///
    /// Names stand without their units, so that programs find them; units are in the JSON form.
    pub fn to_csv(&self) -> Vec<u8> {
        let mut writer = csv::WriterBuilder::new().terminator(csv::Terminator::Any(b'\n')).from_writer(Vec::new());
        let header = writer.write_record(self.columns.iter().map(|column| &column.name));
        let rows = self.rows.iter().map(|row| writer.write_record(row.iter().map(Cell::to_string)));
        header.and_then(|()| rows.collect::<Result<(), _>>()).expect("rows are as long as the header, and memory takes all");
        writer.into_inner().expect("memory takes all")
    }

    /// The table as JSON: `{"columns": [{"name", "unit"}], "rows": [[…]]}`, one row a line.
    ///
    /// Empty cells are `null`; numbers that JSON lacks are the texts `NaN`, `inf`, `-inf`.
    pub fn to_json(&self) -> Vec<u8> {
        let columns: Vec<String> =
            self.columns.iter().map(|column| json!({ "name": column.name, "unit": column.unit }).to_string()).collect();
        let rows: Vec<String> = self.rows.iter().map(|row| Json::Array(row.iter().map(json_of).collect()).to_string()).collect();
        let lines = |items: Vec<String>| if items.is_empty() { String::new() } else { format!("\n    {}\n  ", items.join(",\n    ")) };
        format!("{{\n  \"columns\": [{}],\n  \"rows\": [{}]\n}}\n", lines(columns), lines(rows)).into_bytes()
    }
}

fn json_of(cell: &Cell) -> Json {
    match cell {
        Cell::Empty => Json::Null,
        Cell::Boolean(value) => json!(value),
        Cell::Integer(value) => match (u64::try_from(*value), i64::try_from(*value)) {
            (Ok(value), _) => json!(value),
            (_, Ok(value)) => json!(value),
            _ => json!(value.to_string()),
        },
        Cell::Number(value) if value.is_finite() => json!(value),
        Cell::Number(_) | Cell::Text(_) => json!(cell.to_string()),
    }
}

fn summary(values: &[f64], level: f64) -> [Cell; 4] {
    let Some(estimate) = estimate::mean_interval(values, level) else { return [const { Cell::Empty }; 4] };
    let spread = estimate.standard_error.map_or(Cell::Empty, Cell::Number);
    let [low, high] = estimate.interval.map_or([Cell::Empty, Cell::Empty], |bounds| bounds.map(Cell::Number));
    [Cell::Number(estimate.mean), spread, low, high]
}

/// A table with the name of where it comes from and its place on the axes that were collapsed.
#[derive(Debug, Clone, Copy)]
pub struct Part<'a> {
    /// Name of the stage.
    pub label: &'a str,
    /// Value on each collapsed axis, and fields of map-valued ones as `axis.field`.
    pub axes: &'a [(String, Cell)],
    /// The rows.
    pub table: &'a Table,
}

/// Tables put one after the other.
#[derive(Debug, Clone, PartialEq)]
pub struct Collection {
    /// `stage`, then the axes, then the tables' own columns, each in order of first appearance.
    pub table: Table,
    /// How many columns at the left tell where a row comes from.
    pub label_count: usize,
}

/// Puts tables one after the other, with a leading column `stage` and columns for the axes.
///
/// A column that a part lacks is empty in its rows. Where a table has a column of the name of an axis (or `stage`) itself, it is
/// the same column if it says the same in every row, and `own.NAME` if it does not.
pub fn collect(parts: &[Part<'_>]) -> Result<Collection, TableError> {
    let mut columns = vec![Column::new("stage", "")];
    for (name, _) in parts.iter().flat_map(|part| part.axes) {
        add_column(&mut columns, &Column::new(name, ""))?;
    }
    let label_count = columns.len();
    let mut placements = Vec::new();
    for part in parts {
        let mut placement = Vec::new();
        for (index, column) in part.table.columns.iter().enumerate() {
            let name = own_name(parts, &columns[..label_count], &column.name);
            let is_label = columns[..label_count].iter().any(|label| label.name == name);
            placement.push(if is_label { None } else { Some((index, add_column(&mut columns, &Column::new(name, &column.unit))?)) });
        }
        placements.push(placement);
    }

    let mut table = Table::new(columns);
    for (part, placement) in parts.iter().zip(&placements) {
        for row in &part.table.rows {
            let mut cells = vec![Cell::Empty; table.columns.len()];
            cells[0] = Cell::Text(part.label.into());
            for (name, value) in part.axes {
                cells[table.column(name).expect("every axis got its column")] = value.clone();
            }
            for (from, to) in placement.iter().flatten() {
                cells[*to] = row[*from].clone();
            }
            table.push(cells);
        }
    }
    Ok(Collection { table, label_count })
}

/// The position of a column among `columns`, added if it is new.
fn add_column(columns: &mut Vec<Column>, column: &Column) -> Result<usize, TableError> {
    let Some(position) = columns.iter().position(|known| known.name == column.name) else {
        columns.push(column.clone());
        return Ok(columns.len() - 1);
    };
    let known = &mut columns[position];
    if known.unit.is_empty() {
        known.unit.clone_from(&column.unit);
    } else if !column.unit.is_empty() && known.unit != column.unit {
        return Err(TableError::Units { column: column.name.clone(), first: known.unit.clone(), second: column.unit.clone() });
    }
    Ok(position)
}

/// What a table's column is called beside the labels: its name, or `own.NAME` where a label says something else.
fn own_name(parts: &[Part<'_>], labels: &[Column], name: &str) -> String {
    let differs = |part: &Part<'_>| {
        let Some(column) = part.table.column(name) else { return false };
        let stage = Cell::Text(part.label.into());
        let label = if name == "stage" { Some(&stage) } else { part.axes.iter().find(|(axis, _)| axis == name).map(|(_, value)| value) };
        part.table.rows.iter().any(|row| label.is_none_or(|label| !row[column].means(label)))
    };
    let is_taken = labels.iter().any(|label| label.name == name) && parts.iter().any(differs);
    if is_taken { own_name(parts, labels, &format!("own.{name}")) } else { name.to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn measured(values: &[f64]) -> Table {
        let mut table = Table::new(vec![Column::new("rmse", ""), Column::new("angle", "deg")]);
        for value in values {
            table.push(vec![Cell::Number(*value), Cell::Integer(3)]);
        }
        table
    }

    fn axis(name: &str, value: i128) -> Vec<(String, Cell)> {
        vec![(name.into(), Cell::Integer(value))]
    }

    #[test]
    fn numbers_have_their_shortest_text_and_read_back_equal() {
        for value in [0.1, 1.0 / 3.0, 1e-310, 6.02e23, -0.0, f64::MAX] {
            let text = Cell::Number(value).to_string();
            assert_eq!(text.parse::<f64>().unwrap().to_bits(), value.to_bits(), "{text}");
        }
        assert_eq!(Cell::Number(64.0).to_string(), "64");
        assert_eq!(Cell::Integer(i128::from(u64::MAX)).to_string(), "18446744073709551615");
    }

    #[test]
    fn csv_reads_back_through_another_reader() {
        let mut table = Table::new(vec![Column::new("say", ""), Column::new("x", "deg")]);
        table.push(vec![Cell::Text("a \"quoted\", word\nand a line".into()), Cell::Number(0.1)]);
        table.push(vec![Cell::Empty, Cell::Number(f64::INFINITY)]);
        let bytes = table.to_csv();
        let mut reader = csv::Reader::from_reader(bytes.as_slice());
        assert_eq!(reader.headers().unwrap(), vec!["say", "x"]);
        let rows: Vec<csv::StringRecord> = reader.records().collect::<Result<_, _>>().unwrap();
        assert_eq!(&rows[0][0], "a \"quoted\", word\nand a line");
        assert_eq!(&rows[1][1], "inf");
    }

    #[test]
    fn json_has_units_and_only_valid_numbers() {
        let mut table = measured(&[0.1]);
        table.push(vec![Cell::Number(f64::NAN), Cell::Empty]);
        let read: Json = serde_json::from_slice(&table.to_json()).unwrap();
        assert_eq!(read["columns"][1], json!({ "name": "angle", "unit": "deg" }));
        assert_eq!(read["rows"], json!([[0.1, 3], ["NaN", null]]));
    }

    #[test]
    fn collected_rows_say_where_they_come_from_and_lack_what_they_lack() {
        let (with_axis, without) = (measured(&[0.5, 0.25]), measured(&[0.125]));
        let axes = axis("n", 64);
        let parts = [Part { label: "error", axes: &axes, table: &with_axis }, Part { label: "floor", axes: &[], table: &without }];
        let Collection { table, label_count } = collect(&parts).unwrap();
        assert_eq!(table.names(), ["stage", "n", "rmse", "angle"]);
        assert_eq!(label_count, 2);
        assert_eq!(table.rows[1][..3], [Cell::Text("error".into()), Cell::Integer(64), Cell::Number(0.25)]);
        assert_eq!(table.rows[2][..3], [Cell::Text("floor".into()), Cell::Empty, Cell::Number(0.125)]);
    }

    #[test]
    fn a_column_that_repeats_its_axis_is_that_axis_and_another_keeps_a_name_of_its_own() {
        let mut settings = Table::new(vec![Column::new("gamma", ""), Column::new("stage", "")]);
        settings.push(vec![Cell::Number(2.0), Cell::Text("inner".into())]);
        let axes = axis("gamma", 2);
        let same = collect(&[Part { label: "ldr", axes: &axes, table: &settings }]).unwrap().table;
        assert_eq!(same.names(), ["stage", "gamma", "own.stage"]);
        let other = axis("gamma", 3);
        let differing = collect(&[Part { label: "ldr", axes: &other, table: &settings }]).unwrap().table;
        assert_eq!(differing.names(), ["stage", "gamma", "own.gamma", "own.stage"]);
        assert_eq!(differing.rows[0][1..3], [Cell::Integer(3), Cell::Number(2.0)]);
    }

    #[test]
    fn tables_in_different_units_are_not_mixed() {
        let mut radians = measured(&[1.0]);
        radians.columns[1].unit = "rad".into();
        let degrees = measured(&[1.0]);
        let parts = [Part { label: "a", axes: &[], table: &degrees }, Part { label: "b", axes: &[], table: &radians }];
        assert!(matches!(collect(&parts), Err(TableError::Units { .. })));
    }

    #[test]
    fn rows_are_sorted_by_several_columns_and_keep_their_order_where_equal() {
        let mut table = Table::new(vec![Column::new("a", ""), Column::new("b", "")]);
        for (a, b) in [(2, 1), (1, 1), (2, 3), (1, 2)] {
            table.push(vec![Cell::Integer(a), Cell::Number(b as f64 + 0.5)]);
        }
        let sorted = table.sorted(&["a".into(), "-b".into()]).unwrap();
        let b: Vec<f64> = sorted.rows.iter().map(|row| row[1].number().unwrap()).collect();
        assert_eq!(b, [2.5, 1.5, 3.5, 1.5]);
        assert!(matches!(sorted.sorted(&["c".into()]), Err(TableError::NoColumn { .. })));
    }

    #[test]
    fn repetitions_become_a_mean_with_its_interval() {
        let tables: Vec<Table> = [1.0, 2.0, 4.0].iter().map(|value| measured(&[*value + 0.5])).collect();
        let axes: Vec<_> = (0..3).map(|run| axis("run", run)).collect();
        let parts: Vec<Part<'_>> = tables.iter().zip(&axes).map(|(table, axes)| Part { label: "error", axes, table }).collect();
        let Collection { table, label_count } = collect(&parts).unwrap();
        let summary = table.summarized("run", 0.95, label_count).unwrap();
        assert_eq!(summary.names(), ["stage", "angle", "count", "rmse.mean", "rmse.standard_error", "rmse.low", "rmse.high"]);
        assert_eq!(summary.rows.len(), 1);
        assert_eq!(summary.rows[0][2], Cell::Integer(3));
        let mean = 7.0 / 3.0 + 0.5;
        assert!((summary.rows[0][3].number().unwrap() - mean).abs() < 1e-14);
        // s = sqrt(7/3), standard error s / sqrt(3), t(0.975, 2) = 4.302653.
        let half = 4.302_652_729_911_275 * (7.0_f64 / 3.0).sqrt() / 3.0_f64.sqrt();
        assert!((summary.rows[0][6].number().unwrap() - (mean + half)).abs() < 1e-9);
    }
}

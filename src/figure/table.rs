//! Tables: named columns with units, rows of cells.
//!
//! The container and its text forms; computing what stands in it is others' work.

use serde::{Deserialize, Serialize};

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
    /// The cell as a number, if it is one.
    pub fn number(&self) -> Option<f64> {
        match self {
            Cell::Integer(value) => Some(*value as f64),
            Cell::Number(value) => Some(*value),
            Cell::Empty | Cell::Boolean(_) | Cell::Text(_) => None,
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
}

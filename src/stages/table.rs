//! The kind `table`: collected rows as one table.

use std::sync::Arc;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::artifacts::lights;
use super::names::Names;
use crate::catalogue;
use crate::engine::artifact::{AnyArtifact, Artifact, TypeName};
use crate::engine::coordinate::Scalar;
use crate::engine::job::Job;
use crate::engine::parameter::{Accepts, Ports};
use crate::engine::stage::{Mistake, ResultDeclaration, Stage, StageError};
use crate::figure::table::{Cell, Collection, Part, Table, TableError, collect};
use crate::light::lights::LightSet;

/// Puts tables one after the other, with a column for the stage and one for each collapsed axis.
///
/// Columns: `stage`, then the axes, then those of the tables, each in order of first appearance; what a row lacks is empty.
///
/// ```yaml
/// errors: { table: { of: error }, save: [csv, json] } # one row for each n
/// ```
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Collect {
    /// The tables or lights: one stage or a list of them.
    pub of: Ports<Rows>,
    /// The axes to collapse into rows; by default all.
    #[serde(default)]
    pub over: Option<Vec<String>>,
    /// An axis of repetitions (seeds): its rows become one with means, standard errors and Student t intervals
    /// (`m.mean`, `m.standard_error`, `m.low`, `m.high`, and `count`) of every column of measured numbers.
    #[serde(default)]
    pub repeat: Option<String>,
    /// Level of those intervals; default 0.95.
    #[serde(default = "usual_level")]
    #[schemars(extend("exclusiveMinimum" = 0, "exclusiveMaximum" = 1))]
    pub interval: f64,
    /// The columns to keep, in this order; by default all.
    #[serde(default)]
    pub columns: Names,
    /// The columns to sort rows by, the first one first; `-` before a name turns its order around. By default rows stand as collected.
    #[serde(default)]
    pub sort: Names,
}

/// The usual level of intervals.
pub fn usual_level() -> f64 {
    0.95
}

impl Stage for Collect {
    const KIND: &'static str = "table";
    const VERSION: u32 = 1;
    const RESULTS: &'static [ResultDeclaration] = &[ResultDeclaration { name: "", types: &[Table::TYPE] }];
    type Output = Table;

    fn mistakes(&self) -> Vec<Mistake> {
        let is_lost = |name: &String| self.columns.0.contains(name) || self.columns.is_empty();
        let lost = self.sort.0.iter().find(|name| !is_lost(name) && !is_lost(&name.trim_start_matches('-').to_owned()));
        let mistake = |name: &String| Mistake {
            field: "sort".into(),
            message: format!("sorts by `{name}`, which `columns` leaves out"),
            hint: Some("add it to `columns`".into()),
        };
        lost.map(mistake).into_iter().collect()
    }

    fn run(&self, job: &Job<'_>) -> Result<Table, StageError> {
        let collection = collected(job, &self.of)?;
        let table = match &self.repeat {
            Some(axis) => collection.table.summarized(axis, self.interval, collection.label_count).map_err(table_error)?,
            None => collection.table,
        };
        let chosen = if self.columns.is_empty() { table } else { table.selected(&self.columns.0).map_err(table_error)? };
        chosen.sorted(&self.sort.0).map_err(table_error)
    }
}

/// What can be read as rows: tables, and lights with one row each. Another type of artifact is one more arm here.
pub enum Rows {}

impl Accepts for Rows {
    const TYPES: &'static [TypeName] = &[Table::TYPE, LightSet::TYPE];
    type Value = Arc<Table>;

    fn take(artifact: AnyArtifact) -> Option<Self::Value> {
        artifact.get::<Table>().or_else(|| artifact.get::<LightSet>().map(|lights| Arc::new(lights::rows(&lights))))
    }
}

/// All tables of a port in one.
pub fn collected(job: &Job<'_>, of: &Ports<Rows>) -> Result<Collection, StageError> {
    let inputs = job.collected(of).collect::<Result<Vec<_>, _>>()?;
    let axes: Vec<Vec<(String, Cell)>> = inputs.iter().map(|input| cells(input.columns)).collect();
    let parts: Vec<Part<'_>> =
        inputs.iter().zip(&axes).map(|(input, axes)| Part { label: input.label, axes, table: &input.value }).collect();
    collect(&parts).map_err(table_error)
}

fn cells(columns: &[(String, Scalar)]) -> Vec<(String, Cell)> {
    columns.iter().map(|(name, value)| (name.clone(), cell(value))).collect()
}

/// The value of an axis as a cell.
pub fn cell(value: &Scalar) -> Cell {
    match value {
        Scalar::Boolean(value) => Cell::Boolean(*value),
        Scalar::Integer(value) => Cell::Integer(*value),
        Scalar::Number(value) => Cell::Number(*value),
        Scalar::Text(value) => Cell::Text(value.clone()),
    }
}

/// The error of a table with the nearest right word.
pub fn table_error(error: TableError) -> StageError {
    let TableError::NoColumn { name, available } = &error else { return StageError::content(error) };
    match catalogue::nearest(name, available.iter().map(String::as_str)) {
        Some(nearest) => StageError::content_with_hint(&error, format!("did you mean `{nearest}`?")),
        None => StageError::content(error),
    }
}

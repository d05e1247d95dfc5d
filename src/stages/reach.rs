//! The kind `reach`; the mathematics is in `figure::reach`.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::names::Names;
use super::table::{Rows, collected, table_error};
use crate::engine::artifact::Artifact;
use crate::engine::job::Job;
use crate::engine::parameter::Ports;
use crate::engine::stage::{ResultDeclaration, Stage, StageError};
use crate::figure::reach::reach;
use crate::figure::table::{Cell, Column, Table};

/// Tells where each curve comes below a level for good: how many lights or samples an error takes.
///
/// Columns: `series`, then `x` with the place at which a power law between the two nearest measurements crosses the level, and
/// `x.measured`, the first x measured from which on all are at or below it (both under the name of the column `x`); empty where the last
/// measurement is still above.
///
/// ```yaml
/// enough: { reach: { of: error, x: n, y: rmse, level: 0.01 }, save: csv }
/// ```
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ReachStage {
    /// The tables: one stage or a list of them.
    pub of: Ports<Rows>,
    /// The axes to collapse into rows; by default all.
    #[serde(default)]
    pub over: Option<Vec<String>>,
    /// The column across: a count.
    pub x: String,
    /// The column that must come below the level: an error.
    pub y: String,
    /// The level.
    pub level: f64,
    /// The columns that tell curves apart: one name or a list; a row of the result for each curve.
    #[serde(default)]
    pub series: Names,
}

impl Stage for ReachStage {
    const KIND: &'static str = "reach";
    const VERSION: u32 = 1;
    const RESULTS: &'static [ResultDeclaration] = &[ResultDeclaration { name: "", types: &[Table::TYPE] }];
    type Output = Table;

    fn axes_used(&self) -> Option<Vec<String>> {
        Some(self.series.0.iter().chain([&self.x]).cloned().collect())
    }

    fn run(&self, job: &Job<'_>) -> Result<Table, StageError> {
        let rows = collected(job, &self.of)?.table;
        let (x, y) = (rows.required_column(&self.x).map_err(table_error)?, rows.required_column(&self.y).map_err(table_error)?);
        let series = rows.required_columns(&self.series.0).map_err(table_error)?;
        let mut columns: Vec<Column> = series.iter().map(|&column| rows.columns[column].clone()).collect();
        columns.extend([rows.columns[x].clone(), Column::new(format!("{}.measured", self.x), rows.columns[x].unit.clone())]);
        let mut table = Table::new(columns);
        for group in rows.groups(&series) {
            let mut points: Vec<(f64, f64)> = group.iter().filter_map(|row| Some((row[x].number()?, row[y].number()?))).collect();
            points.sort_by(|a, b| a.0.total_cmp(&b.0));
            if points.windows(2).any(|pair| pair[0].0 == pair[1].0) {
                let message = format!("a curve has several `{}` at one `{}`", self.y, self.x);
                return Err(StageError::content_with_hint(message, "name what tells them apart in `series`"));
            }
            let found = reach(&points, self.level).map(|reach| [reach.interpolated, reach.measured].map(Cell::from_number));
            let names = series.iter().map(|&column| group[0][column].clone());
            table.push(names.chain(found.unwrap_or([Cell::Empty, Cell::Empty])).collect());
        }
        Ok(table)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::artifact::AnyArtifact;
    use crate::stages::rasters::trial;

    fn curve(name: &str, points: &[(i128, f64)]) -> AnyArtifact {
        let mut table = Table::new(["name", "k", "rmse"].map(|column| Column::new(column, "")).to_vec());
        points.iter().for_each(|&(k, y)| table.push(vec![Cell::Text(name.into()), Cell::Integer(k), Cell::Number(y)]));
        AnyArtifact::new(table)
    }

    fn run(text: &str, curves: Vec<AnyArtifact>) -> Result<Table, String> {
        let (results, _) = trial::run::<ReachStage>(text, [("a", curves)]);
        results.map(|results| (*results[0].get::<Table>().unwrap()).clone()).map_err(|error| error.to_string())
    }

    #[test]
    fn each_curve_has_a_row() {
        let curves = vec![curve("good", &[(16, 0.04), (4, 0.16)]), curve("bad", &[(4, 0.5), (16, 0.4)])];
        let table = run("{ of: [a], x: k, y: rmse, level: 0.08, series: [name] }", curves).unwrap();
        assert_eq!(table.names(), ["name", "k", "k.measured"]);
        let k = table.rows[0][1].number().unwrap();
        assert!((k - 8.0).abs() < 1e-9, "{k}");
        assert_eq!(table.rows[0][2].number(), Some(16.0));
        assert_eq!(table.rows[1], [Cell::Text("bad".into()), Cell::Empty, Cell::Empty]);
    }

    #[test]
    fn curves_that_are_mixed_up_are_refused() {
        let curves = vec![curve("a", &[(4, 0.1)]), curve("b", &[(4, 0.2)])];
        assert!(run("{ of: [a], x: k, y: rmse, level: 0.1 }", curves).unwrap_err().contains("several"));
    }
}

//! The kind `assess`; the mathematics is in `image::assessment`.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::table::usual_level;
use crate::engine::artifact::Artifact;
use crate::engine::job::Job;
use crate::engine::parameter::{Port, Ports};
use crate::engine::stage::{InputSizes, ResultDeclaration, Stage, StageError};
use crate::figure::table::{Cell, Column, Table};
use crate::image::assessment::{Assessed, AssessmentError, Estimate, assess};
use crate::image::raster::Image;

/// Assesses an estimator from independent runs against a reference: bias, variance, error and efficiency, with intervals.
///
/// The first result is a table of one row: `runs`; `bias` (mean signed error), `bias_low`, `bias_high`; `bias_rms` (over pixels,
/// less what scatter adds to it); `z_rms` (of S runs about the root of (S - 1) / (S - 3) if unbiased; no measure
/// where rare events carry the mean); `variance` (of one run), `variance_low`, `variance_high`; `rmse` (of one
/// run), `rmse_low`, `rmse_high`; `relative_rmse` (over the mean of the reference), `relative_bias_rms`; `work`, and `efficiency`, 1 / (variance x
/// work), `efficiency_low`, `efficiency_high`, empty where nothing scatters. Of a single run, for estimators that do not draw, there is no variance and no interval. Intervals are Student's t over the runs. The result `.bias` is the mean
/// of the runs less the reference, in linear light. Pixels whose alpha is 0 do not count.
///
/// Work is counted, not timed, so that results are the same on every machine: `setup` and, for each covered pixel of the picture,
/// `terms` of `term_cost` each. What a unit is, is the pipeline's choice; one look at a pixel of a map is a good one.
///
/// ```yaml
/// judged: { assess: { of: repeated, to: truth, over: [run], terms: $n } } # bias, variance, efficiency
/// ```
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Assess {
    /// The runs: one reference or a list; several images, or one of an estimator that does not draw.
    pub of: Ports<Image>,
    /// The axes that are runs; by default all. The others remain axes of the stage.
    #[serde(default)]
    pub over: Option<Vec<String>>,
    /// The reference; of the same size.
    pub to: Port<Image>,
    /// Level of the intervals; default 0.95.
    #[serde(default = "usual_level")]
    #[schemars(extend("exclusiveMinimum" = 0, "exclusiveMaximum" = 1))]
    pub interval: f64,
    /// Terms that each pixel sums: samples or lights. Default 1.
    #[serde(default = "one")]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub terms: f64,
    /// Work of one term, in units of the pipeline's choice. Default 1.
    #[serde(default = "one")]
    #[schemars(range(min = 0))]
    pub term_cost: f64,
    /// Work before the first pixel, once a run: building tables, drawing a shared set, cutting. Default 0.
    #[serde(default)]
    #[schemars(range(min = 0))]
    pub setup: f64,
}

fn one() -> f64 {
    1.0
}

impl Stage for Assess {
    const KIND: &'static str = "assess";
    const VERSION: u32 = 1;
    const RESULTS: &'static [ResultDeclaration] =
        &[ResultDeclaration { name: "", types: &[Table::TYPE] }, ResultDeclaration { name: "bias", types: &[Image::TYPE] }];
    type Output = (Table, Image);

    fn memory(&self, inputs: &InputSizes) -> u64 {
        // Of the runs one at a time, and their mean in f64; their number is not known here, so all of them bound it.
        4 * inputs.values().sum::<u64>()
    }

    fn run(&self, job: &Job<'_>) -> Result<(Table, Image), StageError> {
        let reference = job.input(&self.to)?;
        let runs = || {
            job.collected(&self.of).map(|run| {
                job.check()?;
                run.map(|run| run.value)
            })
        };
        let assessed = assess(&reference, runs, self.interval).map_err(stage_error)?;
        let covered = (0..reference.color.pixels().len()).filter(|&index| reference.is_covered(index)).count();
        let work = self.setup + covered as f64 * self.terms * self.term_cost;
        Ok((table(&assessed, work), assessed.bias))
    }
}

fn table(Assessed { assessment, .. }: &Assessed, work: f64) -> Table {
    let spread = |Estimate { value, interval }: Estimate| [value, interval.low, interval.high].map(number);
    let relative = |value: f64| number(value / assessment.reference);
    let variance = assessment.variance;
    let efficiency = [variance.value, variance.interval.high, variance.interval.low].map(|variance| number(1.0 / (variance * work)));
    let columns = [
        ("runs", vec![Cell::Integer(assessment.run_count as i128)]),
        ("bias", spread(assessment.bias).to_vec()),
        ("bias_rms", vec![number(assessment.bias_rms)]),
        ("z_rms", vec![number(assessment.z_rms)]),
        ("variance", spread(variance).to_vec()),
        ("rmse", spread(assessment.rmse).to_vec()),
        ("relative_rmse", vec![relative(assessment.rmse.value)]),
        ("relative_bias_rms", vec![relative(assessment.bias_rms)]),
        ("work", vec![number(work)]),
        ("efficiency", efficiency.to_vec()),
    ];
    let names = columns
        .iter()
        .flat_map(|(name, cells)| ["", "_low", "_high"].iter().take(cells.len()).map(move |end| Column::new(format!("{name}{end}"), "")));
    let mut table = Table::new(names.collect());
    table.push(columns.iter().flat_map(|(_, cells)| cells.iter().cloned()).collect());
    table
}

/// What is no number (nothing scatters) is empty.
fn number(value: f64) -> Cell {
    if value.is_finite() { Cell::Number(value) } else { Cell::Empty }
}

fn stage_error(error: AssessmentError<StageError>) -> StageError {
    match error {
        AssessmentError::Source(error) => error,
        other => StageError::content(other),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::artifact::AnyArtifact;
    use crate::image::raster::Raster;
    use crate::stages::rasters::trial;

    fn image(value: f32) -> AnyArtifact {
        AnyArtifact::new(Image::opaque(Raster::filled(2, 2, [value; 3])))
    }

    fn run(text: &str, runs: Vec<AnyArtifact>) -> Result<(Table, Image), String> {
        let (results, _) = trial::run::<Assess>(text, [("a", runs), ("b", vec![image(1.0)])]);
        let results = results.map_err(|error| error.to_string())?;
        Ok(((*results[0].get::<Table>().unwrap()).clone(), (*results[1].get::<Image>().unwrap()).clone()))
    }

    fn value(table: &Table, name: &str) -> Cell {
        table.rows[0][table.columns.iter().position(|column| column.name == name).unwrap()].clone()
    }

    #[test]
    fn a_row_holds_bias_variance_error_and_efficiency() {
        let (table, bias) = run("{ of: [a], to: b, terms: 5, term_cost: 2, setup: 10 }", vec![image(1.0), image(2.0)]).unwrap();
        assert_eq!(value(&table, "runs"), Cell::Integer(2));
        assert_eq!(value(&table, "bias"), Cell::Number(0.5));
        assert_eq!(value(&table, "variance"), Cell::Number(0.5));
        assert_eq!(value(&table, "rmse"), Cell::Number(0.5_f64.sqrt()));
        // 10 + 4 pixels x 5 x 2.
        assert_eq!(value(&table, "work"), Cell::Number(50.0));
        assert_eq!(value(&table, "efficiency"), Cell::Number(1.0 / 25.0));
        assert_eq!(bias.color.pixel(1, 1), [0.5; 3]);
    }

    #[test]
    fn what_does_not_scatter_has_no_efficiency() {
        let (table, _) = run("{ of: [a], to: b }", vec![image(1.5), image(1.5), image(1.5)]).unwrap();
        assert_eq!((value(&table, "efficiency"), value(&table, "z_rms")), (Cell::Empty, Cell::Empty));
        assert_eq!(value(&table, "bias_rms"), Cell::Number(0.5));
    }

    #[test]
    fn one_run_has_an_error_and_no_variance() {
        let (table, _) = run("{ of: [a], to: b }", vec![image(1.5)]).unwrap();
        assert_eq!(
            (value(&table, "rmse"), value(&table, "variance"), value(&table, "rmse_low")),
            (Cell::Number(0.5), Cell::Empty, Cell::Empty)
        );
    }
}

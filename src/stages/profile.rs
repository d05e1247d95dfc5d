//! `profile`: a distribution as curves.

use std::borrow::Cow;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::engine::artifact::Artifact;
use crate::engine::job::Job;
use crate::engine::parameter::Port;
use crate::engine::stage::{InputSizes, ResultDeclaration, Stage, StageError};
use crate::figure::table::{Cell, Column, Table};
use crate::light::distribution::Distribution;

/// Lists the densities and cumulative probabilities of a distribution: of its rows, or of the columns of one row.
///
/// Columns: `row` and `theta_deg` (or `column` and `phi_deg`); `weight` (intensity times the row's factor); `pmf`
/// (probability); `pdf` (density per degree of that angle); `cdf` (0 to 1); `pdf_scaled` ((x - min) / (max - min) of the pdf,
/// the second report's display form, no density); `cdf_percent` (0 to 100).
///
/// ```yaml
/// rows: { profile: { of: dist }, save: csv }
/// ```
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ProfileStage {
    /// The distribution.
    pub of: Port<Distribution>,
    /// A row, counted from 0 at the top, or `brightest` for the one most often drawn: its conditional distribution.
    /// Without it the marginal distribution of all rows.
    #[serde(default)]
    pub row: Option<ProfileRow>,
}

/// The row of a conditional distribution.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ProfileRow {
    /// That row, counted from 0 at the top.
    Index(u32),
    /// The row of the largest probability, the upper one on ties.
    Brightest,
}

const BRIGHTEST: &str = "brightest";

impl ProfileRow {
    fn index(self, distribution: &Distribution) -> usize {
        match self {
            ProfileRow::Index(row) => row as usize,
            ProfileRow::Brightest => (0..distribution.height())
                .rev()
                .max_by(|&a, &b| distribution.marginal_pmf(a).total_cmp(&distribution.marginal_pmf(b)))
                .expect("a distribution has rows"),
        }
    }
}

impl Serialize for ProfileRow {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            ProfileRow::Index(row) => serializer.serialize_u32(*row),
            ProfileRow::Brightest => serializer.serialize_str(BRIGHTEST),
        }
    }
}

impl<'de> Deserialize<'de> for ProfileRow {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        match serde_yaml::Value::deserialize(deserializer)? {
            serde_yaml::Value::String(word) if word == BRIGHTEST => Ok(ProfileRow::Brightest),
            other => u32::deserialize(other).map(ProfileRow::Index).map_err(D::Error::custom),
        }
    }
}

impl JsonSchema for ProfileRow {
    fn inline_schema() -> bool {
        true
    }

    fn schema_name() -> Cow<'static, str> {
        "ProfileRow".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({ "anyOf": [{ "type": "integer", "minimum": 0, "maximum": u32::MAX }, { "const": BRIGHTEST }] })
    }
}

impl Stage for ProfileStage {
    const KIND: &'static str = "profile";
    const VERSION: u32 = 1;
    const RESULTS: &'static [ResultDeclaration] = &[ResultDeclaration { name: "", types: &[Table::TYPE] }];
    type Output = Table;

    fn memory(&self, inputs: &InputSizes) -> u64 {
        // Some hundred bytes of cells for each row or column: of small maps more than the map, of large ones far less.
        (1 << 20) + inputs.values().sum::<u64>() / 4
    }

    fn run(&self, job: &Job<'_>) -> Result<Table, StageError> {
        let distribution = job.input(&self.of)?;
        let Some(row) = self.row else { return Ok(marginal(&distribution)) };
        let row = row.index(&distribution);
        if row >= distribution.height() {
            let message = format!("row `{row}` lies outside the distribution, which has {} rows", distribution.height());
            return Err(StageError::content_with_hint(message, format!("rows run from `0` to `{}`", distribution.height() - 1)));
        }
        if distribution.row_weight(row) == 0.0 {
            job.warn(format!("row `{row}` is never drawn: its conditional distribution is zero everywhere"));
        }
        Ok(conditional(&distribution, row))
    }
}

/// One place of a profile.
struct Point {
    angle: f64,
    weight: f64,
    pmf: f64,
    cdf: f64,
}

fn marginal(distribution: &Distribution) -> Table {
    let points = (0..distribution.height()).map(|y| Point {
        angle: distribution.theta(y).to_degrees(),
        weight: distribution.row_weight(y),
        pmf: distribution.marginal_pmf(y),
        cdf: distribution.marginal_cdf(y),
    });
    table("row", "theta_deg", 180.0 / distribution.height() as f64, points.collect())
}

fn conditional(distribution: &Distribution, row: usize) -> Table {
    let probabilities = distribution.conditional_pmf(row).zip(distribution.conditional_cdf(row));
    let points = probabilities.enumerate().map(|(x, (pmf, cdf))| Point {
        angle: distribution.phi(x).to_degrees(),
        weight: distribution.pmf(x, row) * distribution.total(),
        pmf,
        cdf,
    });
    table("column", "phi_deg", 360.0 / distribution.width() as f64, points.collect())
}

/// The points as rows; each stands for `spacing` degrees.
fn table(index: &str, angle: &str, spacing: f64, points: Vec<Point>) -> Table {
    let largest = points.iter().map(|point| point.pmf).fold(f64::NEG_INFINITY, f64::max);
    let smallest = points.iter().map(|point| point.pmf).fold(f64::INFINITY, f64::min);
    // A flat profile has no range to be scaled to.
    let range = if largest > smallest { largest - smallest } else { 1.0 };
    let units =
        [(index, ""), (angle, "deg"), ("weight", ""), ("pmf", ""), ("pdf", "1/deg"), ("cdf", ""), ("pdf_scaled", ""), ("cdf_percent", "%")];
    let mut table = Table::new(units.map(|(name, unit)| Column::new(name, unit)).into());
    for (index, point) in points.into_iter().enumerate() {
        let scaled = (point.pmf - smallest) / range;
        let numbers = [point.angle, point.weight, point.pmf, point.pmf / spacing, point.cdf, scaled, 100.0 * point.cdf];
        table.push([Cell::Integer(index as i128)].into_iter().chain(numbers.map(Cell::Number)).collect());
    }
    table
}

#[cfg(test)]
mod tests {
    use std::convert::Infallible;

    use super::*;
    use crate::image::raster::Raster;
    use crate::light::distribution::Settings;
    use crate::light::envmap::EnvMap;

    fn example() -> Distribution {
        let pixels = (0..8 * 4).map(|k| [if k < 8 { 0.0 } else { k as f32 }; 3]).collect();
        Distribution::build(&EnvMap::new(Raster::new(8, 4, pixels)), &Settings::default(), || Ok::<(), Infallible>(())).unwrap()
    }

    fn column(table: &Table, name: &str) -> Vec<f64> {
        let place = table.column(name).unwrap();
        table.rows.iter().map(|row| row[place].number().unwrap()).collect()
    }

    #[test]
    fn densities_integrate_to_one_over_their_angle_and_curves_end_where_they_should() {
        for (table, spacing, count) in [(marginal(&example()), 45.0, 4), (conditional(&example(), 2), 45.0, 8)] {
            assert_eq!(table.rows.len(), count);
            let integral: f64 = column(&table, "pdf").iter().map(|pdf| pdf * spacing).sum();
            assert!((integral - 1.0).abs() < 1e-14);
            assert_eq!((column(&table, "cdf")[count - 1], column(&table, "cdf_percent")[count - 1]), (1.0, 100.0));
            let scaled = column(&table, "pdf_scaled");
            assert_eq!(scaled.iter().copied().fold(1.0, f64::min), 0.0);
            assert_eq!(scaled.iter().copied().fold(0.0, f64::max), 1.0);
        }
    }

    #[test]
    fn the_brightest_row_is_the_upper_one_of_the_most_probable() {
        assert_eq!(ProfileRow::Brightest.index(&example()), 2);
    }

    #[test]
    fn weights_of_the_rows_sum_to_the_total() {
        let sum: f64 = column(&marginal(&example()), "weight").iter().sum();
        assert!((sum - example().total()).abs() < 1e-12 * sum);
        let row: f64 = column(&conditional(&example(), 1), "weight").iter().sum();
        assert!((row - example().row_weight(1)).abs() < 1e-12 * row);
    }

    #[test]
    fn a_row_that_is_never_drawn_is_zero_everywhere() {
        let table = conditional(&example(), 0);
        for name in ["weight", "pmf", "pdf", "cdf", "pdf_scaled", "cdf_percent"] {
            assert_eq!(column(&table, name), [0.0; 8], "{name}");
        }
    }
}

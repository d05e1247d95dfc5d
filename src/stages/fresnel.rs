//! The kind `fresnel`.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::engine::job::Job;
use crate::engine::stage::{ResultDeclaration, Stage, StageError};
use crate::figure::table::{Cell, Column, Table};
use crate::light::fresnel::{self, Boundary};

/// Tabulates the reflectance of a dielectric over the angle of incidence.
///
/// The first result has one row per angle: `angle_deg`, `rs` (perpendicular), `rp` (parallel), `unpolarized` and
/// `schlick`. The result `angles` has one row: Brewster's angle, the critical angle (empty where there is none),
/// R0, and where Schlick's approximation errs most. Born and Wolf, "Principles of optics", 1.5; Schlick (1994).
///
/// ```yaml
/// glass: { fresnel: { eta: 1.5 }, save: csv }
/// ```
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Fresnel {
    /// Index of refraction of the material; the other side is vacuum (or air, as 1).
    #[schemars(extend("exclusiveMinimum" = 0, "maximum" = 1000.0))]
    pub eta: f64,
    /// Whether the light comes from inside the material. Default `false`: it enters.
    #[serde(default)]
    pub leaving: bool,
    /// Distance between two angles, in degrees; 0 and 90 are always among them. Default 0.1.
    #[serde(default = "usual_step")]
    #[schemars(range(min = 0.0001, max = 90.0), extend("x-unit" = "deg"))]
    pub step_degrees: f64,
}

fn usual_step() -> f64 {
    0.1
}

impl Stage for Fresnel {
    const KIND: &'static str = "fresnel";
    const VERSION: u32 = 1;
    const RESULTS: &'static [ResultDeclaration] =
        &[ResultDeclaration { name: "", types: &["table"] }, ResultDeclaration { name: "angles", types: &["table"] }];
    type Output = (Table, Table);

    fn run(&self, _job: &Job<'_>) -> Result<(Table, Table), StageError> {
        let boundary = if self.leaving { Boundary::leaving(self.eta) } else { Boundary::entering(self.eta) };
        Ok((curves(boundary, self.step_degrees), landmarks(boundary, self.eta)))
    }
}

fn curves(boundary: Boundary, step_degrees: f64) -> Table {
    let columns = [("angle_deg", "deg"), ("rs", ""), ("rp", ""), ("unpolarized", ""), ("schlick", "")];
    let mut table = Table::new(columns.map(|(name, unit)| Column::new(name, unit)).to_vec());
    for angle in angles(step_degrees) {
        let cosine = fresnel::cosine_of_degrees(angle);
        let (rs, rp) = (boundary.perpendicular(cosine), boundary.parallel(cosine));
        table.push([angle, rs, rp, boundary.unpolarized(cosine), boundary.schlick(cosine)].map(Cell::Number).to_vec());
    }
    table
}

/// Multiples of the step below 90 degrees, and 90 itself.
fn angles(step: f64) -> Vec<f64> {
    let count = 90.0 / step;
    // Where the step divides 90, quotients have the shorter digits: 3 * 0.1 is not 0.3, 90 * 3 / 900 is.
    let whole = count.round();
    if (count - whole).abs() < 1e-9 * whole {
        return (0..=whole as u64).map(|index| 90.0 * index as f64 / whole).collect();
    }
    (0..=count as u64).map(|index| index as f64 * step).chain([90.0]).collect()
}

fn landmarks(boundary: Boundary, eta: f64) -> Table {
    let columns =
        [("eta", ""), ("brewster_deg", "deg"), ("critical_deg", "deg"), ("r0", ""), ("schlick_error", ""), ("schlick_error_at_deg", "deg")];
    let (error, error_angle) = boundary.largest_schlick_error();
    let mut table = Table::new(columns.map(|(name, unit)| Column::new(name, unit)).to_vec());
    table.push(vec![
        Cell::Number(eta),
        Cell::Number(fresnel::degrees(boundary.brewster_angle())),
        boundary.critical_angle().map_or(Cell::Empty, |angle| Cell::Number(fresnel::degrees(angle))),
        Cell::Number(boundary.at_normal()),
        Cell::Number(error),
        Cell::Number(fresnel::degrees(error_angle)),
    ]);
    table
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn angles_begin_at_0_and_end_at_90_whatever_the_step() {
        assert_eq!(angles(90.0), [0.0, 90.0]);
        assert_eq!(angles(40.0), [0.0, 40.0, 80.0, 90.0]);
        let tenths = angles(0.1);
        assert_eq!((tenths.len(), tenths[3], tenths[900]), (901, 0.3, 90.0));
        for step in [0.0001, 0.007, 0.7, 7.0, 89.999] {
            let angles = angles(step);
            assert!(angles.is_sorted_by(|a, b| a < b) && angles[0] == 0.0 && angles[angles.len() - 1] == 90.0, "{step}");
        }
    }

    #[test]
    fn the_curves_end_at_total_reflection_and_begin_at_r0() {
        let table = curves(Boundary::entering(1.5), 1.0);
        assert_eq!(table.rows.len(), 91);
        assert!((table.rows[0][1].number().unwrap() - 0.04).abs() < 1e-15);
        assert_eq!(table.rows[90], [90.0, 1.0, 1.0, 1.0, 1.0].map(Cell::Number));
    }

    #[test]
    fn light_that_enters_has_no_critical_angle() {
        let critical = |boundary, eta| landmarks(boundary, eta).rows[0][2].clone();
        assert_eq!(critical(Boundary::entering(1.4), 1.4), Cell::Empty);
        assert!((critical(Boundary::leaving(1.4), 1.4).number().unwrap() - 45.58).abs() < 0.005);
    }
}

//! The kind `rotate`; the mathematics is in `light::reproject`.

use glam::{DMat3, DVec3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::engine::artifact::Artifact;
use crate::engine::job::Job;
use crate::engine::parameter::Port;
use crate::engine::stage::{Mistake, ResultDeclaration, Stage, StageError};
use crate::light::envmap::EnvMap;
use crate::light::reproject;
use crate::math::elementary;

/// Turns a map by any rotation: what was at direction d is then at R d.
///
/// Either by `degrees` about `axis`, right-handed, or by a `matrix`. Each pixel becomes the mean of the old map over its
/// solid angle: no light is lost or made. About +y, `rotate_degrees` of `load` does the same.
///
/// ```yaml
/// turned: { rotate: { of: env, axis: [1, 0, 0], degrees: 90 } }
/// ```
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Rotate {
    /// The map.
    pub of: Port<EnvMap>,
    /// The axis, of any length.
    #[serde(default)]
    pub axis: Option<[f64; 3]>,
    /// The angle about `axis`: counterclockwise for one to whom the axis points.
    #[serde(default)]
    #[schemars(range(min = -36000, max = 36000), extend("x-unit" = "degrees"))]
    pub degrees: Option<f64>,
    /// The rotation R as three rows, in place of axis and angle. Rows have length 1 and stand on each other, to 1e-3, and
    /// the determinant is positive; what rounding left is made exact.
    #[serde(default)]
    pub matrix: Option<[[f64; 3]; 3]>,
}

impl Rotate {
    fn rotation(&self) -> Option<DMat3> {
        if let Some(rows) = self.matrix {
            return nearest_rotation(DMat3::from_cols_array_2d(&rows).transpose());
        }
        let axis = DVec3::from_array(self.axis?).try_normalize()?;
        let (sine, cosine) = elementary::sin_cos(self.degrees?.to_radians());
        Some(about(axis, sine, cosine))
    }
}

/// Rodrigues' formula: R = cos I + sin [a]× + (1 - cos) a aᵀ.
fn about(axis: DVec3, sine: f64, cosine: f64) -> DMat3 {
    let turned = |v: DVec3| v * cosine + axis.cross(v) * sine + axis * axis.dot(v) * (1.0 - cosine);
    DMat3::from_cols(turned(DVec3::X), turned(DVec3::Y), turned(DVec3::Z))
}

/// The rotation that a matrix is but for rounding.
fn nearest_rotation(matrix: DMat3) -> Option<DMat3> {
    const TOLERANCE: f64 = 1e-3;
    let is_near = (matrix.transpose() * matrix).abs_diff_eq(DMat3::IDENTITY, TOLERANCE) && matrix.determinant() > 0.0;
    let x = matrix.x_axis.normalize_or_zero();
    let y = (matrix.y_axis - x * x.dot(matrix.y_axis)).normalize_or_zero();
    is_near.then(|| DMat3::from_cols(x, y, x.cross(y)))
}

impl Stage for Rotate {
    const KIND: &'static str = "rotate";
    const VERSION: u32 = 1;
    const RESULTS: &'static [ResultDeclaration] = &[ResultDeclaration { name: "", types: &[EnvMap::TYPE] }];
    type Output = EnvMap;

    fn mistakes(&self) -> Vec<Mistake> {
        let has_angle = self.axis.is_some() || self.degrees.is_some();
        let (field, message, hint) = match (self.matrix.is_some(), has_angle) {
            (true, true) => ("matrix", "`matrix` and `axis` with `degrees` both say the rotation", "remove one of them"),
            (false, _) if self.axis.is_none() => ("of", "there is no rotation", "set `axis` and `degrees`, or `matrix`"),
            (false, _) if self.degrees.is_none() => ("axis", "the angle about `axis` is missing", "set `degrees`"),
            (true, false) if self.rotation().is_none() => {
                ("matrix", "`matrix` is not a rotation", "write three rows of length 1 that stand on each other, with determinant 1")
            }
            (false, _) if self.rotation().is_none() => ("axis", "`axis` has no length", "write a direction, such as [0, 1, 0]"),
            _ => return Vec::new(),
        };
        vec![Mistake { field: field.into(), message: message.into(), hint: Some(hint.into()) }]
    }

    fn run(&self, job: &Job<'_>) -> Result<EnvMap, StageError> {
        let rotation = self.rotation().ok_or_else(|| StageError::content("there is no rotation"))?;
        reproject::turned(&*job.input(&self.of)?, rotation, || job.check())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stages::rasters::trial;

    fn rotation(text: &str) -> DMat3 {
        let stage: Rotate = serde_yaml::from_str(text).unwrap();
        stage.rotation().unwrap()
    }

    #[test]
    fn a_quarter_about_y_brings_z_to_x() {
        let quarter = rotation("{ of: m, axis: [0, 5, 0], degrees: 90 }");
        assert!((quarter * DVec3::Z - DVec3::X).length() < 1e-15);
        let same = rotation("{ of: m, matrix: [[0, 0, 1], [0, 1, 0], [-1, 0, 0]] }");
        assert!(quarter.abs_diff_eq(same, 1e-15));
    }

    #[test]
    fn any_axis_and_angle_is_glams_rotation() {
        let axis = DVec3::new(1.0, -2.0, 0.5).normalize();
        let found = rotation("{ of: m, axis: [1, -2, 0.5], degrees: 200 }");
        assert!(found.abs_diff_eq(DMat3::from_axis_angle(axis, 200.0_f64.to_radians()), 1e-14));
    }

    #[test]
    fn what_is_no_rotation_is_a_mistake() {
        let mistake = |text: &str| trial::mistakes::<Rotate>(&format!("{{ of: m, {text} }}"));
        assert!(mistake("degrees: 3")[0].contains("no rotation"));
        assert!(mistake("axis: [0, 1, 0]")[0].contains("missing"));
        assert!(mistake("axis: [0, 0, 0], degrees: 3")[0].contains("no length"));
        assert!(mistake("matrix: [[2, 0, 0], [0, 1, 0], [0, 0, 1]]")[0].contains("not a rotation"));
        assert!(mistake("matrix: [[-1, 0, 0], [0, 1, 0], [0, 0, 1]]")[0].contains("not a rotation"));
        assert!(mistake("matrix: [[1, 0, 0], [0, 1, 0], [0, 0, 1]], degrees: 3")[0].contains("both"));
        assert!(mistake("axis: [0, 1, 0], degrees: 3").is_empty());
    }
}

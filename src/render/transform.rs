//! Where a shape stands: a list of steps, applied one after the other, and the affine map they make.

use glam::{DAffine3, DMat3, DMat4, DVec3};
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::math::elementary;

/// One step of a transform.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum Step {
    /// Multiplies coordinates: by one factor, or by one per axis. A negative factor mirrors.
    Scale(Factors),
    /// Turns about an axis through the origin, counter-clockwise seen from its tip.
    Rotate(Rotate),
    /// Moves by a vector.
    Translate([f64; 3]),
    /// Any affine map: four rows of four numbers, the last row `[0, 0, 0, 1]`; points are columns.
    Matrix([[f64; 4]; 4]),
    /// Puts the shape at `origin`, its +z towards `target` and its +y as near to `up` as that allows.
    LookAt(LookAt),
}

/// A turn.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Rotate {
    /// The axis, of any length but zero.
    pub axis: [f64; 3],
    /// The angle.
    #[schemars(extend("x-unit" = "degrees"))]
    pub degrees: f64,
}

/// A place and a direction to face.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct LookAt {
    /// Where the shape's origin goes.
    pub origin: [f64; 3],
    /// A point in the direction of the shape's +z.
    pub target: [f64; 3],
    /// Which way is up.
    #[serde(default = "up")]
    pub up: [f64; 3],
}

fn up() -> [f64; 3] {
    [0.0, 1.0, 0.0]
}

/// One factor for all axes, or one for each.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Factors(pub [f64; 3]);

impl Serialize for Factors {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let [x, y, z] = self.0;
        if x == y && y == z { serializer.serialize_f64(x) } else { self.0.serialize(serializer) }
    }
}

impl<'de> Deserialize<'de> for Factors {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(FactorsVisitor)
    }
}

struct FactorsVisitor;

impl<'de> serde::de::Visitor<'de> for FactorsVisitor {
    type Value = Factors;

    fn expecting(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        out.write_str("a factor, or [x, y, z]")
    }

    fn visit_f64<E: serde::de::Error>(self, factor: f64) -> Result<Factors, E> {
        Ok(Factors([factor; 3]))
    }

    fn visit_u64<E: serde::de::Error>(self, factor: u64) -> Result<Factors, E> {
        self.visit_f64(factor as f64)
    }

    fn visit_i64<E: serde::de::Error>(self, factor: i64) -> Result<Factors, E> {
        self.visit_f64(factor as f64)
    }

    fn visit_seq<A: serde::de::SeqAccess<'de>>(self, factors: A) -> Result<Factors, A::Error> {
        <[f64; 3]>::deserialize(serde::de::value::SeqAccessDeserializer::new(factors)).map(Factors)
    }
}

impl JsonSchema for Factors {
    fn inline_schema() -> bool {
        true
    }

    fn schema_name() -> std::borrow::Cow<'static, str> {
        "Factors".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({
            "anyOf": [{ "type": "number" }, { "type": "array", "items": { "type": "number" }, "minItems": 3, "maxItems": 3 }],
        })
    }
}

/// A transform that cannot be used.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum TransformError {
    /// The volume of everything would be zero, or not finite.
    #[error("step {step} of the transform flattens the shape or is not finite; factors other than 0 and an invertible matrix are needed")]
    Singular {
        /// The step, counted from 1.
        step: usize,
    },
    /// A rotation about nothing.
    #[error("step {step} of the transform turns about an axis of length 0; give a direction such as `[0, 1, 0]`")]
    NoAxis {
        /// The step, counted from 1.
        step: usize,
    },
    /// A direction to face that does not exist.
    #[error("step {step} of the transform looks from a point at itself, or along `up`; move `target` or turn `up`")]
    NoView {
        /// The step, counted from 1.
        step: usize,
    },
    /// A matrix that is not affine.
    #[error("step {step} of the transform is a matrix whose last row is not `[0, 0, 0, 1]`")]
    NotAffine {
        /// The step, counted from 1.
        step: usize,
    },
}

/// The map of all steps, the first one applied first.
pub fn affine(steps: &[Step]) -> Result<DAffine3, TransformError> {
    let mut whole = DAffine3::IDENTITY;
    for (index, step) in steps.iter().enumerate() {
        let map = step.affine(index + 1)?;
        let volume = map.matrix3.determinant();
        whole = map * whole;
        if !volume.is_normal() || !whole.is_finite() || !whole.matrix3.determinant().is_normal() {
            return Err(TransformError::Singular { step: index + 1 });
        }
    }
    Ok(whole)
}

impl Step {
    fn affine(&self, step: usize) -> Result<DAffine3, TransformError> {
        Ok(match self {
            Self::Scale(factors) => DAffine3::from_scale(factors.0.into()),
            Self::Translate(by) => DAffine3::from_translation((*by).into()),
            Self::Rotate(Rotate { axis, degrees }) => {
                let axis = DVec3::from(*axis).try_normalize().ok_or(TransformError::NoAxis { step })?;
                DAffine3::from_mat3(rotation(axis, *degrees))
            }
            Self::Matrix(rows) => {
                if rows[3] != [0.0, 0.0, 0.0, 1.0] {
                    return Err(TransformError::NotAffine { step });
                }
                DAffine3::from_mat4(DMat4::from_cols_array_2d(rows).transpose())
            }
            Self::LookAt(look) => look.affine().ok_or(TransformError::NoView { step })?,
        })
    }
}

impl LookAt {
    fn affine(&self) -> Option<DAffine3> {
        let origin = DVec3::from(self.origin);
        let z = (DVec3::from(self.target) - origin).try_normalize()?;
        let x = DVec3::from(self.up).try_normalize()?.cross(z);
        // Up and view within 1e-6 of a line leave nothing to tell left from right.
        let x = (x.length() > 1e-6).then(|| x.normalize())?;
        Some(DAffine3 { matrix3: DMat3::from_cols(x, z.cross(x), z), translation: origin })
    }
}

/// Rodrigues' formula; quarter turns are exact.
fn rotation(axis: DVec3, degrees: f64) -> DMat3 {
    let (sin, cos) = sin_cos_of_degrees(degrees);
    let column = |unit: DVec3| unit * cos + axis.cross(unit) * sin + axis * (axis.dot(unit) * (1.0 - cos));
    DMat3::from_cols(column(DVec3::X), column(DVec3::Y), column(DVec3::Z))
}

fn sin_cos_of_degrees(degrees: f64) -> (f64, f64) {
    match degrees.rem_euclid(360.0) {
        0.0 => (0.0, 1.0),
        90.0 => (1.0, 0.0),
        180.0 => (0.0, -1.0),
        270.0 => (-1.0, 0.0),
        degrees => elementary::sin_cos(degrees.to_radians()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn map(text: &str) -> Result<DAffine3, TransformError> {
        affine(&serde_json::from_value::<Vec<Step>>(serde_yaml::from_str(text).unwrap()).unwrap())
    }

    fn moved(text: &str, point: [f64; 3]) -> DVec3 {
        map(text).unwrap().transform_point3(point.into())
    }

    fn is_close(a: DVec3, b: [f64; 3]) -> bool {
        (a - DVec3::from(b)).length() < 1e-12
    }

    #[test]
    fn steps_apply_in_the_order_in_which_they_stand() {
        assert!(is_close(moved("[{ scale: 2 }, { translate: [0, 1, 0] }]", [1.0, 1.0, 1.0]), [2.0, 3.0, 2.0]));
        assert!(is_close(moved("[{ translate: [0, 1, 0] }, { scale: [2, 3, 4] }]", [1.0, 1.0, 1.0]), [2.0, 6.0, 4.0]));
        assert!(is_close(moved("[]", [1.0, 2.0, 3.0]), [1.0, 2.0, 3.0]));
    }

    #[test]
    fn turns_are_right_handed_and_quarters_are_exact() {
        assert_eq!(moved("[{ rotate: { axis: [0, 0, 5], degrees: 90 } }]", [1.0, 0.0, 0.0]), DVec3::Y);
        assert_eq!(moved("[{ rotate: { axis: [1, 0, 0], degrees: -270 } }]", [0.0, 1.0, 0.0]), DVec3::Z);
        let half = 0.5_f64.sqrt();
        assert!(is_close(moved("[{ rotate: { axis: [0, 1, 0], degrees: 45 } }]", [0.0, 0.0, 1.0]), [half, 0.0, half]));
    }

    #[test]
    fn a_matrix_has_points_as_columns() {
        let text = "[{ matrix: [[1, 0, 0, 5], [0, 0, -1, 6], [0, 1, 0, 7], [0, 0, 0, 1]] }]";
        assert!(is_close(moved(text, [1.0, 2.0, 3.0]), [6.0, 3.0, 9.0]));
    }

    #[test]
    fn look_at_faces_the_target_upright() {
        let text = "[{ look-at: { origin: [1, 2, 3], target: [1, 2, -4] } }]";
        assert!(is_close(moved(text, [0.0, 0.0, 1.0]), [1.0, 2.0, 2.0]));
        assert!(is_close(moved(text, [0.0, 1.0, 0.0]), [1.0, 3.0, 3.0]));
        assert!((map(text).unwrap().matrix3.determinant() - 1.0).abs() < 1e-12);
    }

    #[test]
    fn what_flattens_or_faces_nothing_is_named_with_its_step() {
        assert_eq!(map("[{ scale: 1 }, { scale: [1, 0, 1] }]"), Err(TransformError::Singular { step: 2 }));
        assert_eq!(map("[{ rotate: { axis: [0, 0, 0], degrees: 3 } }]"), Err(TransformError::NoAxis { step: 1 }));
        assert_eq!(map("[{ look-at: { origin: [0, 1, 0], target: [0, 5, 0] } }]"), Err(TransformError::NoView { step: 1 }));
        let matrix = "[{ matrix: [[1, 0, 0, 5], [0, 1, 0, 6], [0, 0, 1, 7], [0, 0, 1, 1]] }]";
        assert_eq!(map(matrix), Err(TransformError::NotAffine { step: 1 }));
    }

    #[test]
    fn factors_are_written_as_they_are_read() {
        for text in ["2.0", "[1.0,2.0,3.0]"] {
            let factors: Factors = serde_json::from_str(text).unwrap();
            assert_eq!(serde_json::to_string(&factors).unwrap(), text);
        }
    }
}

//! A pinhole camera.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::math::elementary;
use crate::render::camera::lens::Faults;
use crate::render::scene::vector::Vector;

/// A pinhole camera.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Perspective {
    /// Where it stands. Default `[0, 0, 4]`.
    #[serde(default = "origin")]
    pub origin: Vector,
    /// The point in the middle of the picture. Default `[0, 0, 0]`.
    #[serde(default = "Vector::zero")]
    pub target: Vector,
    /// What is upwards in the picture. Default `[0, 1, 0]`.
    #[serde(default = "Vector::y")]
    pub up: Vector,
    /// Horizontal field of view. Default 40.
    #[serde(default = "fov_degrees")]
    #[schemars(extend("exclusiveMinimum" = 0, "exclusiveMaximum" = 180, "x-unit" = "degrees"))]
    pub fov_degrees: f64,
    /// Faults of the lens: `distortion` and `aberration`. Default none.
    #[serde(default)]
    pub lens: Faults,
}

/// The usual place: in front of the origin.
pub(crate) fn origin() -> Vector {
    Vector([0.0, 0.0, 4.0])
}

/// The usual field of view.
pub(crate) fn fov_degrees() -> f64 {
    40.0
}

impl Default for Perspective {
    fn default() -> Self {
        Self { origin: origin(), target: Vector::zero(), up: Vector::y(), fov_degrees: fov_degrees(), lens: Faults::default() }
    }
}

impl Perspective {
    /// Half of the picture's width on a plane at distance 1.
    pub fn half_width(&self) -> f32 {
        half_width(self.fov_degrees)
    }
}

/// Tangent of half the field of view.
pub(crate) fn half_width(fov_degrees: f64) -> f32 {
    elementary::tan(0.5 * fov_degrees.to_radians()) as f32
}

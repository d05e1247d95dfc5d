//! A camera of parallel rays.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::render::camera::lens::Faults;
use crate::render::camera::perspective;
use crate::render::scene::vector::Vector;

/// A camera of parallel rays; what is behind `origin` is not seen.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Orthographic {
    /// The middle of the film. Default `[0, 0, 4]`.
    #[serde(default = "perspective::origin")]
    pub origin: Vector,
    /// A point in the middle of the picture. Default `[0, 0, 0]`.
    #[serde(default = "Vector::zero")]
    pub target: Vector,
    /// What is upwards in the picture. Default `[0, 1, 0]`.
    #[serde(default = "Vector::y")]
    pub up: Vector,
    /// Width of the picture in the world. Default 2: a unit sphere from edge to edge.
    #[serde(default = "width")]
    #[schemars(range(max = 1e9), extend("exclusiveMinimum" = 0))]
    pub width: f32,
    /// Faults of the lens: `distortion` and `aberration`. Default none.
    #[serde(default)]
    pub lens: Faults,
}

fn width() -> f32 {
    2.0
}

impl Default for Orthographic {
    fn default() -> Self {
        Self { origin: perspective::origin(), target: Vector::zero(), up: Vector::y(), width: width(), lens: Faults::default() }
    }
}

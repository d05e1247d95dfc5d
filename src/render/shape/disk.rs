//! A disk about the origin in the plane z = 0.

use glam::{DAffine3, DVec3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::render::shape::Form;
use crate::render::shape::unit::Unit;

/// A disk in the plane z = 0 with normal +z; texture coordinates are those of the square around it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Disk {
    /// The radius.
    #[serde(default = "one")]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub radius: f64,
}

fn one() -> f64 {
    1.0
}

impl Disk {
    /// The unit disk, scaled.
    pub fn form(&self) -> Form {
        Form::Unit(Unit::Disk, DAffine3::from_scale(DVec3::splat(self.radius)))
    }
}

//! A sphere by center and radius.

use glam::{DAffine3, DMat3, DVec3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::render::shape::Form;
use crate::render::shape::unit::Unit;

/// A sphere; texture coordinates are longitude and latitude, u to the right and v up as seen from outside.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Sphere {
    /// The center.
    #[serde(default)]
    pub center: [f64; 3],
    /// The radius.
    #[serde(default = "one")]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub radius: f64,
}

fn one() -> f64 {
    1.0
}

impl Sphere {
    /// The unit sphere, scaled and moved.
    pub fn form(&self) -> Form {
        let matrix3 = DMat3::from_diagonal(DVec3::splat(self.radius));
        Form::Unit(Unit::Sphere, DAffine3 { matrix3, translation: self.center.into() })
    }
}

//! A box along the axes, by two corners.

use glam::{DAffine3, DMat3, DVec3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::render::shape::unit::Unit;
use crate::render::shape::{Form, ShapeError};

/// A box along the axes, closed, normals outwards; each face has texture coordinates from 0 to 1.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Cuboid {
    /// The corner with the least coordinates.
    #[serde(default = "minus_one")]
    pub min: [f64; 3],
    /// The corner with the greatest coordinates.
    #[serde(default = "one")]
    pub max: [f64; 3],
}

fn minus_one() -> [f64; 3] {
    [-1.0; 3]
}

fn one() -> [f64; 3] {
    [1.0; 3]
}

impl Cuboid {
    /// The box [-1, 1]³, scaled and moved.
    pub fn form(&self) -> Result<Form, ShapeError> {
        let (min, max) = (DVec3::from(self.min), DVec3::from(self.max));
        if min.cmplt(max).all() {
            let matrix3 = DMat3::from_diagonal((max - min) / 2.0);
            Ok(Form::Unit(Unit::Box, DAffine3 { matrix3, translation: (min + max) / 2.0 }))
        } else {
            Err(ShapeError::EmptyBox { min: self.min, max: self.max })
        }
    }
}

//! Three coordinates as a person writes them.

use std::borrow::Cow;

use glam::Vec3;
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Serialize};

/// A point or a direction `[x, y, z]`; each coordinate from -1e9 to 1e9.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Vector(pub [f32; 3]);

impl Vector {
    /// The origin.
    pub fn zero() -> Self {
        Self([0.0; 3])
    }

    /// Upwards.
    pub fn y() -> Self {
        Self([0.0, 1.0, 0.0])
    }

    /// To compute with.
    pub fn vec3(self) -> Vec3 {
        Vec3::from_array(self.0)
    }
}

impl JsonSchema for Vector {
    fn inline_schema() -> bool {
        true
    }

    fn schema_name() -> Cow<'static, str> {
        "Vector".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        // Squares of lengths stay far below the largest f32.
        let coordinate = json_schema!({ "type": "number", "minimum": -1e9, "maximum": 1e9 });
        json_schema!({ "type": "array", "items": coordinate, "minItems": 3, "maxItems": 3 })
    }
}

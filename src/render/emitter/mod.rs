//! Where light comes from: one file per kind that needs one.
//!
//! What a person writes is [`EmitterDescription`] and, on a shape, [`ShapeEmitter`]; a scene compiles all of it to
//! [`Lights`], of which one is drawn by power and then a direction by that light. Densities are per steradian at the
//! reference point and include the choice of the light, so that the one function serves drawing and weighing.

pub mod environment;
pub mod lights;
pub mod spot;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::render::emitter::spot::SpotParameters;
use crate::render::scene::vector::Vector;
use crate::render::scene_file::SceneFile;
use crate::render::texture::parameter::Radiance;
use crate::render::texture::value::{Color, Light};

/// Light that is no shape's.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum EmitterDescription {
    /// Light around everything: the map of the stage's `env`, another one, or the same from everywhere.
    Environment(EnvironmentParameters),
    /// The lights of the stage's `lights`: each shines from one direction.
    Lights(LightsParameters),
    /// Light from a point alike to all sides.
    Point(PointParameters),
    /// Light from a point within a cone, fading towards its edge.
    Spot(SpotParameters),
    /// Parallel light from one direction.
    Directional(DirectionalParameters),
}

/// Light around everything: the map of the stage's `env`, or of `path`, or `radiance` alone.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct EnvironmentParameters {
    /// The file of a lat-long map, in place of the stage's `env`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub path: Option<SceneFile>,
    /// The same radiance from everywhere, in place of a map: a number or `[r, g, b]`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub radiance: Option<Color<Light>>,
    /// Factor of its radiance. Default 1.
    #[serde(default = "one")]
    #[schemars(range(min = 0, max = 1e9))]
    pub strength: f32,
    /// Angle by which the map is turned about +y, right-handed: from +z towards +x. Default 0.
    #[serde(default)]
    #[schemars(range(min = -36_000, max = 36_000), extend("x-unit" = "degrees"))]
    pub rotate_degrees: f64,
}

/// The lights of the stage's `lights`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct LightsParameters {
    /// Factor of their irradiance. Default 1.
    #[serde(default = "one")]
    #[schemars(range(min = 0, max = 1e9))]
    pub strength: f32,
    /// Angle by which they are turned about +y, right-handed: from +z towards +x. Default 0.
    #[serde(default)]
    #[schemars(range(min = -36_000, max = 36_000), extend("x-unit" = "degrees"))]
    pub rotate_degrees: f64,
}

/// Light from a point alike to all sides.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PointParameters {
    /// Where it is.
    pub position: Vector,
    /// Power per solid angle: a number or `[r, g, b]`.
    #[schemars(extend("x-unit" = "W/sr"))]
    pub intensity: Color<Light>,
}

/// Parallel light from one direction.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DirectionalParameters {
    /// From the scene towards the light, of any length but zero.
    pub towards: Vector,
    /// Irradiance on a surface that faces it: a number or `[r, g, b]`.
    #[schemars(extend("x-unit" = "W/m²"))]
    pub irradiance: Color<Light>,
}

/// Light of a shape.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum ShapeEmitter {
    /// The surface shines on the side of its normal.
    Area(AreaParameters),
}

/// The surface shines on the side of its normal.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct AreaParameters {
    /// Radiance, alike in all directions: a number, `[r, g, b]` or a texture.
    pub radiance: Radiance,
}

fn one() -> f32 {
    1.0
}

impl Default for EnvironmentParameters {
    fn default() -> Self {
        Self { path: None, radiance: None, strength: 1.0, rotate_degrees: 0.0 }
    }
}

impl EnvironmentParameters {
    /// Whether it is the map of the stage's `env`.
    pub fn is_of_stage(&self) -> bool {
        self.path.is_none() && self.radiance.is_none()
    }
}

impl Default for LightsParameters {
    fn default() -> Self {
        Self { strength: 1.0, rotate_degrees: 0.0 }
    }
}

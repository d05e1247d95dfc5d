//! A perfect mirror.

use glam::Vec3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::render::bsdf::{BsdfError, BsdfSample, Transport};
use crate::render::texture::parameter::{Pictures, Reflectance};
use crate::render::texture::value::Color;
use crate::render::texture::{Texture, TexturePoint};

/// A perfect mirror of one reflectance at all angles.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct MirrorParameters {
    /// Share of the light that comes back, 0 to 1: a number, `[r, g, b]` or a texture.
    #[serde(default = "all")]
    pub reflectance: Reflectance,
    /// Whether the back is black; by default both sides are alike.
    #[serde(default)]
    pub one_sided: bool,
}

/// All of the light.
pub(crate) fn all() -> Reflectance {
    Reflectance::Constant(Color::grey(1.0).expect("all of the light"))
}

/// A mirror of a scene.
#[derive(Debug, Clone, PartialEq)]
pub struct MirrorMaterial {
    reflectance: Texture<Vec3>,
}

impl MirrorMaterial {
    /// With these parameters, and those pictures for its textures.
    pub fn new(parameters: &MirrorParameters, pictures: &dyn Pictures) -> Result<Self, BsdfError> {
        Ok(Self { reflectance: parameters.reflectance.texture(pictures)? })
    }

    /// What it is at that point.
    pub fn at(&self, point: &TexturePoint) -> Mirror {
        Mirror { reflectance: self.reflectance.at(point) }
    }

    /// Whether it is the same everywhere.
    pub fn is_constant(&self) -> bool {
        self.reflectance.constant().is_some()
    }
}

/// f = rho / |cos| in the mirrored direction alone.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mirror {
    /// Share of the light that comes back.
    pub reflectance: Vec3,
}

impl Mirror {
    /// The mirrored direction.
    #[inline]
    pub fn sample(&self, outgoing: Vec3, _choice: f32, _point: [f32; 2], _: Transport) -> Option<BsdfSample> {
        Some(BsdfSample { direction: mirrored(outgoing), weight: self.reflectance, pdf: 1.0, is_delta: true, eta: 1.0 })
    }

    /// Zero: no other direction is ever the mirrored one.
    #[inline]
    pub fn evaluate_with_pdf(&self, _outgoing: Vec3, _incoming: Vec3, _: Transport) -> (Vec3, f32) {
        (Vec3::ZERO, 0.0)
    }

    /// The reflectance.
    pub fn albedo(&self) -> Vec3 {
        self.reflectance
    }
}

/// (-x, -y, z).
#[inline]
pub fn mirrored(outgoing: Vec3) -> Vec3 {
    Vec3::new(-outgoing.x, -outgoing.y, outgoing.z)
}

//! Lambert's surface: equally bright from all sides.

use std::f32::consts::FRAC_1_PI;

use glam::Vec3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use wide::f32x4;

use crate::math::single;
use crate::render::bsdf::{BsdfError, BsdfSample, Transport};
use crate::render::lanes::{Vectors, Weighted};
use crate::render::texture::parameter::{Pictures, Reflectance};
use crate::render::texture::value::Color;
use crate::render::texture::{Texture, TexturePoint};

/// Equally bright from all sides (Lambert): f = reflectance / pi.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DiffuseParameters {
    /// Share of the light that comes back, 0 to 1: a number, `[r, g, b]` or a texture.
    #[serde(default = "default_reflectance")]
    pub reflectance: Reflectance,
    /// Whether the back is black; by default both sides are alike.
    #[serde(default)]
    pub one_sided: bool,
}

/// Half of the light.
pub(crate) fn default_reflectance() -> Reflectance {
    Reflectance::Constant(Color::grey(0.5).expect("half of the light"))
}

/// A diffuse surface of a scene.
#[derive(Debug, Clone, PartialEq)]
pub struct DiffuseMaterial {
    reflectance: Texture<Vec3>,
}

impl DiffuseMaterial {
    /// With these parameters, and those pictures for its textures.
    pub fn new(parameters: &DiffuseParameters, pictures: &dyn Pictures) -> Result<Self, BsdfError> {
        Ok(Self { reflectance: parameters.reflectance.texture(pictures)? })
    }

    /// What it is at that point.
    pub fn at(&self, point: &TexturePoint) -> Diffuse {
        Diffuse { reflectance: self.reflectance.at(point) }
    }

    /// Whether it is the same everywhere.
    pub fn is_constant(&self) -> bool {
        self.reflectance.constant().is_some()
    }
}

/// f = rho / pi, drawn by the cosine.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Diffuse {
    /// Share of the light that comes back.
    pub reflectance: Vec3,
}

impl Diffuse {
    /// A direction by the cosine: the weight is the reflectance.
    #[inline]
    pub fn sample(&self, _outgoing: Vec3, _choice: f32, point: [f32; 2], _: Transport) -> Option<BsdfSample> {
        let direction = Vec3::from_array(single::cosine_hemisphere(point));
        let pdf = direction.z * FRAC_1_PI;
        (pdf > 0.0).then_some(BsdfSample { direction, weight: self.reflectance, pdf, is_delta: false, eta: 1.0 })
    }

    /// rho cos / pi and cos / pi above the surface.
    #[inline]
    pub fn evaluate_with_pdf(&self, _outgoing: Vec3, incoming: Vec3, _: Transport) -> (Vec3, f32) {
        let pdf = incoming.z.max(0.0) * FRAC_1_PI;
        (self.reflectance * pdf, pdf)
    }

    /// The same for four directions at once, given by their cosines.
    #[inline]
    pub fn evaluate_lanes(&self, cosines: f32x4) -> Weighted {
        let pdf = cosines.fast_max(f32x4::ZERO) * FRAC_1_PI;
        Weighted { value: Vectors::splat(self.reflectance).scaled(pdf), pdf }
    }

    /// The reflectance.
    pub fn albedo(&self) -> Vec3 {
        self.reflectance
    }
}

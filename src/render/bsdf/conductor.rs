//! Smooth metal.

use glam::Vec3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::render::bsdf::metal::{ComplexIndex, ConductorFresnel, IndexTexture, Metal, Spectrum, index_of};
use crate::render::bsdf::mirror::{all, mirrored};
use crate::render::bsdf::{BsdfError, BsdfSample, Transport};
use crate::render::texture::parameter::{Pictures, Reflectance, RefractiveIndex};
use crate::render::texture::{Texture, TexturePoint};

/// Smooth metal: mirrors the Fresnel share of its complex index of refraction.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ConductorParameters {
    /// Which metal; or give `eta` and `k`.
    #[serde(default)]
    pub metal: Option<Metal>,
    /// How the spectrum of `metal` became three numbers.
    #[serde(default)]
    pub spectrum: Spectrum,
    /// Real part of the index of refraction, 0 to 100: a number, `[r, g, b]` or a texture.
    #[serde(default)]
    pub eta: Option<RefractiveIndex>,
    /// Imaginary part of the index of refraction, 0 to 100: a number, `[r, g, b]` or a texture.
    #[serde(default)]
    pub k: Option<RefractiveIndex>,
    /// Factor on what is reflected, 0 to 1: a number, `[r, g, b]` or a texture; 1 in nature.
    #[serde(default = "all")]
    pub reflectance: Reflectance,
    /// How the reflected share depends on the angle.
    #[serde(default)]
    pub fresnel: ConductorFresnel,
    /// Whether the back is black; by default both sides are alike.
    #[serde(default)]
    pub one_sided: bool,
}

/// Smooth metal of a scene.
#[derive(Debug, Clone, PartialEq)]
pub struct ConductorMaterial {
    index: IndexTexture,
    fresnel: ConductorFresnel,
    reflectance: Texture<Vec3>,
}

impl ConductorMaterial {
    /// With these parameters, and those pictures for its textures.
    pub fn new(parameters: &ConductorParameters, pictures: &dyn Pictures) -> Result<Self, BsdfError> {
        let ConductorParameters { metal, spectrum, eta, k, reflectance, fresnel, .. } = parameters;
        let index = index_of(*metal, *spectrum, [eta.as_ref(), k.as_ref()], pictures)?;
        Ok(Self { index, fresnel: *fresnel, reflectance: reflectance.texture(pictures)? })
    }

    /// What it is at that point.
    pub fn at(&self, point: &TexturePoint) -> Conductor {
        Conductor { index: self.index.at(point), fresnel: self.fresnel, reflectance: self.reflectance.at(point) }
    }

    /// Whether it is the same everywhere.
    pub fn is_constant(&self) -> bool {
        self.index.is_constant() && self.reflectance.constant().is_some()
    }
}

/// f = F rho / |cos| in the mirrored direction alone.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Conductor {
    /// Index of refraction.
    pub index: ComplexIndex,
    /// How the reflected share depends on the angle.
    pub fresnel: ConductorFresnel,
    /// Factor on what is reflected.
    pub reflectance: Vec3,
}

impl Conductor {
    /// The mirrored direction.
    #[inline]
    pub fn sample(&self, outgoing: Vec3, _choice: f32, _point: [f32; 2], _: Transport) -> Option<BsdfSample> {
        let weight = self.reflectance * self.index.reflectance(outgoing.z, self.fresnel);
        Some(BsdfSample { direction: mirrored(outgoing), weight, pdf: 1.0, is_delta: true, eta: 1.0 })
    }

    /// Zero: no other direction is ever the mirrored one.
    #[inline]
    pub fn evaluate_with_pdf(&self, _outgoing: Vec3, _incoming: Vec3, _: Transport) -> (Vec3, f32) {
        (Vec3::ZERO, 0.0)
    }

    /// What is reflected along the normal.
    pub fn albedo(&self) -> Vec3 {
        self.reflectance * self.index.reflectance(1.0, self.fresnel)
    }
}

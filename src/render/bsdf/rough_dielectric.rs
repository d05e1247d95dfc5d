//! Frosted glass: a dielectric boundary with microfacets.
//!
//! Walter et al., "Microfacet models for refraction through rough surfaces" (2007), equations 20 and 21. With
//! eta = eta_t / eta_i, i on the outgoing side, the normal of a refracting facet is along o + eta i, and
//! f_t = (1 - F) D G2 |o.h| |i.h| eta² / (cos_o cos_i (o.h + eta i.h)²), over eta² for radiance.

use glam::Vec3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::render::bsdf::dielectric::{DielectricFresnel, Interface, compression, glass, refracted};
use crate::render::bsdf::microfacet::{FacetDistribution, Facets, Masking, NormalSampling, SMOOTHEST, mirrored_by};
use crate::render::bsdf::mirror::all;
use crate::render::bsdf::rough_conductor::default_alpha;
use crate::render::bsdf::{BsdfError, BsdfSample, Transport};
use crate::render::texture::parameter::{Pictures, Reflectance, Roughness};
use crate::render::texture::{Texture, TexturePoint};

/// Frosted glass: facets whose normals vary about the surface's reflect and refract once.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RoughDielectricParameters {
    /// Index of refraction behind the surface over that in front of it, where the normal points; not 1.
    /// One number: the index belongs to what lies behind, so that light would gain or lose where it varied from entry to exit.
    #[serde(default = "glass")]
    #[schemars(range(min = 0.1, max = 10))]
    pub eta: f64,
    /// Width of the distribution of slopes, 0.001 to 1: a number or a texture. Smoother is `dielectric`.
    #[serde(default = "default_alpha")]
    pub alpha: Roughness,
    /// How the normals of the facets are distributed.
    #[serde(default)]
    pub distribution: FacetDistribution,
    /// How facets hide and shadow each other.
    #[serde(default)]
    pub masking: Masking,
    /// How normals of facets are drawn.
    #[serde(default)]
    pub sampling: NormalSampling,
    /// Factor on what is reflected, 0 to 1: a number, `[r, g, b]` or a texture; 1 in nature.
    #[serde(default = "all")]
    pub reflectance: Reflectance,
    /// Factor on what passes, 0 to 1: a number, `[r, g, b]` or a texture; 1 in nature.
    #[serde(default = "all")]
    pub transmittance: Reflectance,
    /// How the reflected share depends on the angle.
    #[serde(default)]
    pub fresnel: DielectricFresnel,
}

/// Frosted glass of a scene.
#[derive(Debug, Clone, PartialEq)]
pub struct RoughDielectricMaterial {
    smooth: RoughDielectric,
    alpha: Texture<f32>,
    reflectance: Texture<Vec3>,
    transmittance: Texture<Vec3>,
}

impl RoughDielectricMaterial {
    /// With these parameters, and those pictures for its textures.
    pub fn new(parameters: &RoughDielectricParameters, pictures: &dyn Pictures) -> Result<Self, BsdfError> {
        let &RoughDielectricParameters { eta, distribution, masking, sampling, fresnel, .. } = parameters;
        if (eta - 1.0).abs() < 0.001 {
            return Err(BsdfError::IndexMatched(eta));
        }
        let facets = Facets { distribution, masking, sampling, alpha: SMOOTHEST };
        let interface = Interface::new(eta, fresnel);
        let smooth = RoughDielectric { interface, facets, reflectance: Vec3::ONE, transmittance: Vec3::ONE };
        let (reflectance, transmittance) = (parameters.reflectance.texture(pictures)?, parameters.transmittance.texture(pictures)?);
        Ok(Self { smooth, alpha: parameters.alpha.texture(pictures)?, reflectance, transmittance })
    }

    /// What it is at that point.
    pub fn at(&self, point: &TexturePoint) -> RoughDielectric {
        let facets = Facets { alpha: self.alpha.at(point).max(SMOOTHEST), ..self.smooth.facets };
        let (reflectance, transmittance) = (self.reflectance.at(point), self.transmittance.at(point));
        RoughDielectric { facets, reflectance, transmittance, ..self.smooth }
    }

    /// Whether it is the same everywhere.
    pub fn is_constant(&self) -> bool {
        self.alpha.constant().is_some() && self.reflectance.constant().is_some() && self.transmittance.constant().is_some()
    }
}

/// Facets of a dielectric.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RoughDielectric {
    /// Indices of both sides.
    pub interface: Interface,
    /// The facets.
    pub facets: Facets,
    /// Factor on what is reflected.
    pub reflectance: Vec3,
    /// Factor on what passes.
    pub transmittance: Vec3,
}

/// The other side of the surface.
const BACK: Vec3 = Vec3::new(1.0, 1.0, -1.0);

impl RoughDielectric {
    /// Index on the far side over that on the side of `outgoing`.
    pub fn relative_index(&self, outgoing: Vec3) -> f32 {
        self.interface.relative_index(outgoing.z)
    }

    /// `outgoing` mirrored or refracted by a facet; `None` if that leads to the wrong side of the surface.
    #[inline]
    pub fn sample(&self, outgoing: Vec3, choice: f32, point: [f32; 2], transport: Transport) -> Option<BsdfSample> {
        let side = side_of(outgoing);
        let half = side * self.facets.sample(side * outgoing, point);
        let cos_oh = outgoing.dot(half);
        if cos_oh <= 0.0 {
            return None;
        }
        let (reflected, passing) = self.interface.shares(cos_oh.copysign(outgoing.z));
        if choice < reflected {
            self.sample_reflection(outgoing, half, cos_oh, reflected)
        } else {
            self.sample_refraction(outgoing, half, cos_oh, passing, transport)
        }
    }

    fn sample_reflection(&self, outgoing: Vec3, half: Vec3, cos_oh: f32, reflected: f32) -> Option<BsdfSample> {
        let direction = mirrored_by(outgoing, half, cos_oh);
        if direction.z * outgoing.z <= 0.0 {
            return None;
        }
        let (masking, density) = self.facets.masking_and_density(outgoing, direction, half.z.abs(), cos_oh);
        let pdf = reflected * self.facets.density(half, 1.0) * density * 0.25;
        let weight = self.reflectance * (masking / density);
        (pdf > 0.0).then_some(BsdfSample { direction, weight, pdf, is_delta: false, eta: 1.0 })
    }

    fn sample_refraction(&self, outgoing: Vec3, half: Vec3, cos_oh: f32, passing: f32, transport: Transport) -> Option<BsdfSample> {
        let eta = self.relative_index(outgoing);
        let direction = refracted(outgoing, half, eta)?;
        if direction.z * outgoing.z >= 0.0 {
            return None;
        }
        let (masking, density) = self.facets.masking_and_density(outgoing, direction, half.z.abs(), cos_oh);
        let length = cos_oh + eta * direction.dot(half);
        let jacobian = cos_oh * direction.dot(half).abs() * (eta * eta) / (length * length);
        let pdf = passing * self.facets.density(half, 1.0) * density * jacobian;
        let weight = self.transmittance * (masking / density / compression(eta, transport));
        (pdf > 0.0).then_some(BsdfSample { direction, weight, pdf, is_delta: false, eta })
    }

    /// Value times |cos_i| and density, of reflection or of refraction by the sides of both directions.
    #[inline]
    pub fn evaluate_with_pdf(&self, outgoing: Vec3, incoming: Vec3, transport: Transport) -> (Vec3, f32) {
        let is_reflection = outgoing.z * incoming.z > 0.0;
        let eta = if is_reflection { 1.0 } else { self.relative_index(outgoing) };
        let towards = outgoing + incoming * eta;
        let length2 = towards.length_squared();
        if incoming.z == 0.0 || length2 < 1e-12 {
            return (Vec3::ZERO, 0.0);
        }
        // The facet's normal, on the side of `outgoing`.
        let half = towards * ((towards.z * outgoing.z).signum() / length2.sqrt());
        let (cos_oh, cos_ih) = (outgoing.dot(half), incoming.dot(half));
        // Both see the same facet: from its front, and for refraction one of them from its back.
        if cos_oh <= 0.0 || (cos_ih > 0.0) != is_reflection {
            return (Vec3::ZERO, 0.0);
        }
        let (masking, density) = self.facets.masking_and_density(outgoing, incoming, half.z.abs(), cos_oh);
        // The share is the same from both sides; on the thinner one it does not hang on the last digits of a cosine.
        let is_thinner = is_reflection || eta > 1.0;
        let (reflected, passing) =
            self.interface.shares(if is_thinner { cos_oh.copysign(outgoing.z) } else { cos_ih.abs().copysign(incoming.z) });
        if is_reflection {
            let quarter = reflected * self.facets.density(half, 1.0) * 0.25;
            return (self.reflectance * (masking * quarter), density * quarter);
        }
        let jacobian = cos_oh * cos_ih.abs() * (eta * eta) / length2;
        let passed = passing * self.facets.density(half, 1.0) * jacobian;
        (self.transmittance * (masking * passed / compression(eta, transport)), density * passed)
    }

    /// What a smooth boundary reflects and passes along the normal.
    pub fn albedo(&self) -> Vec3 {
        let (reflected, passing) = self.interface.shares(1.0);
        self.reflectance * reflected + self.transmittance * passing
    }
}

/// The factors that bring `outgoing` to the side of +z, and back.
#[inline]
fn side_of(outgoing: Vec3) -> Vec3 {
    if outgoing.z > 0.0 { Vec3::ONE } else { BACK }
}

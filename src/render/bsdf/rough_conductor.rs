//! Metal with microfacets.
//!
//! f = F(o.h) D(h) G2(o, i) / (4 cos_o cos_i), after Cook and Torrance (1982) and Walter et al. (2007).

use glam::Vec3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::render::bsdf::metal::{ComplexIndex, ConductorFresnel, Metal, Spectrum, index_of};
use crate::render::bsdf::microfacet::{FacetDistribution, Facets, Masking, NormalSampling, SMOOTHEST};
use crate::render::bsdf::mirror::all;
use crate::render::bsdf::{BsdfError, BsdfSample, Transport};
use crate::render::texture::parameter::{Pictures, Reflectance, Roughness};
use crate::render::texture::value::{Color, Index, Number};
use crate::render::texture::{Texture, TexturePoint};

/// Metal with microfacets: light is mirrored once by facets whose normals vary about the surface's.
///
/// What facets hide of each other is lost: rough metals reflect less than smooth ones (single scattering).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RoughConductorParameters {
    /// Which metal; or give `eta` and `k`.
    #[serde(default)]
    pub metal: Option<Metal>,
    /// How the spectrum of `metal` became three numbers.
    #[serde(default)]
    pub spectrum: Spectrum,
    /// Real part of the index of refraction, 0 to 100: a number or `[r, g, b]`.
    #[serde(default)]
    pub eta: Option<Color<Index>>,
    /// Imaginary part of the index of refraction, 0 to 100: a number or `[r, g, b]`.
    #[serde(default)]
    pub k: Option<Color<Index>>,
    /// Width of the distribution of slopes, 0.001 to 1: a number or a texture. Smoother is `conductor`.
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
    /// How the reflected share depends on the angle.
    #[serde(default)]
    pub fresnel: ConductorFresnel,
    /// Whether the back is black; by default both sides are alike.
    #[serde(default)]
    pub one_sided: bool,
}

/// Roughness by default.
pub(crate) fn default_alpha() -> Roughness {
    Roughness::Constant(Number::new(0.1).expect("within the limits"))
}

/// Rough metal of a scene.
#[derive(Debug, Clone, PartialEq)]
pub struct RoughConductorMaterial {
    smooth: RoughConductor,
    alpha: Texture<f32>,
    reflectance: Texture<Vec3>,
}

impl RoughConductorMaterial {
    /// With these parameters, and those pictures for its textures.
    pub fn new(parameters: &RoughConductorParameters, pictures: &dyn Pictures) -> Result<Self, BsdfError> {
        let &RoughConductorParameters { metal, spectrum, eta, k, distribution, masking, sampling, fresnel, .. } = parameters;
        let index = index_of(metal, spectrum, eta, k)?;
        let facets = Facets { distribution, masking, sampling, alpha: SMOOTHEST };
        let smooth = RoughConductor { index, fresnel, facets, reflectance: Vec3::ONE };
        Ok(Self { smooth, alpha: parameters.alpha.texture(pictures)?, reflectance: parameters.reflectance.texture(pictures)? })
    }

    /// What it is at that point.
    pub fn at(&self, point: &TexturePoint) -> RoughConductor {
        let facets = Facets { alpha: self.alpha.at(point).max(SMOOTHEST), ..self.smooth.facets };
        RoughConductor { facets, reflectance: self.reflectance.at(point), ..self.smooth }
    }

    /// Whether it is the same everywhere.
    pub fn is_constant(&self) -> bool {
        self.alpha.constant().is_some() && self.reflectance.constant().is_some()
    }
}

/// Facets of a metal.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RoughConductor {
    /// Index of refraction.
    pub index: ComplexIndex,
    /// How the reflected share depends on the angle.
    pub fresnel: ConductorFresnel,
    /// The facets.
    pub facets: Facets,
    /// Factor on what is reflected.
    pub reflectance: Vec3,
}

impl RoughConductor {
    /// `outgoing` mirrored by a facet; `None` if that leads into the surface.
    #[inline]
    pub fn sample(&self, outgoing: Vec3, _choice: f32, point: [f32; 2], _: Transport) -> Option<BsdfSample> {
        let half = self.facets.sample(outgoing, point);
        let cos_oh = outgoing.dot(half);
        let direction = (2.0 * cos_oh * half - outgoing).normalize();
        if cos_oh <= 0.0 || direction.z <= 0.0 {
            return None;
        }
        let (masking, density) = self.facets.masking_and_density(outgoing, direction, half.z, cos_oh);
        let pdf = self.facets.density(half, 1.0) * density * 0.25;
        let weight = self.reflectance * self.index.reflectance(cos_oh, self.fresnel) * (masking / density);
        (pdf > 0.0).then_some(BsdfSample { direction, weight, pdf, is_delta: false, eta: 1.0 })
    }

    /// F D G2 / (4 cos_o) and the density of the drawn normals over 4 o.h.
    #[inline]
    pub fn evaluate_with_pdf(&self, outgoing: Vec3, incoming: Vec3, _: Transport) -> (Vec3, f32) {
        let half = outgoing + incoming;
        let length2 = half.length_squared();
        if incoming.z <= 0.0 || length2 <= 0.0 {
            return (Vec3::ZERO, 0.0);
        }
        let length = length2.sqrt();
        // For unit vectors, o.h = |o + i| / 2.
        let cos_oh = (0.5 * length).min(1.0);
        let (masking, density) = self.facets.masking_and_density(outgoing, incoming, half.z / length, cos_oh);
        let quarter = self.facets.density(half, length2) * 0.25;
        (self.reflectance * self.index.reflectance(cos_oh, self.fresnel) * (masking * quarter), density * quarter)
    }

    /// What a smooth surface reflects along the normal.
    pub fn albedo(&self) -> Vec3 {
        self.reflectance * self.index.reflectance(1.0, self.fresnel)
    }
}

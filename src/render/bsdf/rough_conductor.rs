//! Metal with microfacets.
//!
//! f = F(o.h) D(h) G2(o, i) / (4 cos_o cos_i), after Cook and Torrance (1982) and Walter et al. (2007).

use glam::Vec3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::render::bsdf::metal::{ComplexIndex, ConductorFresnel, IndexTexture, Metal, Spectrum, index_of};
use crate::render::bsdf::microfacet::{FacetDistribution, Facets, HalfWay, Masking, NormalSampling, SMOOTHEST, mirrored_by};
use crate::render::bsdf::mirror::all;
use crate::render::bsdf::{BsdfError, BsdfSample, Transport};
use crate::render::texture::parameter::{Pictures, Reflectance, RefractiveIndex, Roughness};
use crate::render::texture::value::Number;
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
    /// Real part of the index of refraction, 0 to 100: a number, `[r, g, b]` or a texture.
    #[serde(default)]
    pub eta: Option<RefractiveIndex>,
    /// Imaginary part of the index of refraction, 0 to 100: a number, `[r, g, b]` or a texture.
    #[serde(default)]
    pub k: Option<RefractiveIndex>,
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
    index: IndexTexture,
    fresnel: ConductorFresnel,
    /// Of any roughness.
    facets: Facets,
    alpha: Texture<f32>,
    reflectance: Texture<Vec3>,
}

impl RoughConductorMaterial {
    /// With these parameters, and those pictures for its textures.
    pub fn new(parameters: &RoughConductorParameters, pictures: &dyn Pictures) -> Result<Self, BsdfError> {
        let &RoughConductorParameters { metal, spectrum, distribution, masking, sampling, fresnel, .. } = parameters;
        let index = index_of(metal, spectrum, [parameters.eta.as_ref(), parameters.k.as_ref()], pictures)?;
        let facets = Facets { distribution, masking, sampling, alpha: SMOOTHEST };
        let (alpha, reflectance) = (parameters.alpha.texture(pictures)?, parameters.reflectance.texture(pictures)?);
        Ok(Self { index, fresnel, facets, alpha, reflectance })
    }

    /// What it is at that point.
    pub fn at(&self, point: &TexturePoint) -> RoughConductor {
        let facets = Facets { alpha: self.alpha.at(point).max(SMOOTHEST), ..self.facets };
        RoughConductor { index: self.index.at(point), fresnel: self.fresnel, facets, reflectance: self.reflectance.at(point) }
    }

    /// Whether it is the same everywhere.
    pub fn is_constant(&self) -> bool {
        self.index.is_constant() && self.alpha.constant().is_some() && self.reflectance.constant().is_some()
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
        let direction = mirrored_by(outgoing, half, cos_oh);
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
        let Some(half) = HalfWay::between(outgoing, incoming) else { return (Vec3::ZERO, 0.0) };
        let (masking, density) = self.facets.masking_and_density(outgoing, incoming, half.sum.z / half.length, half.cosine);
        let quarter = self.facets.density(half.sum, half.length2) * 0.25;
        (self.reflectance * self.index.reflectance(half.cosine, self.fresnel) * (masking * quarter), density * quarter)
    }

    /// What a smooth surface reflects along the normal.
    pub fn albedo(&self) -> Vec3 {
        self.reflectance * self.index.reflectance(1.0, self.fresnel)
    }
}

//! Disney's reflectance model of 2012: diffuse with retro-reflection, a specular lobe and a clear coat.
//!
//! Burley, "Physically based shading at Disney" (2012), section 5 and appendix B, without sheen, subsurface and
//! anisotropy. With l and v the incoming and outgoing directions, h half way between and w(c) = (1 - c)^5:
//!
//! - diffuse (base / pi) (1 + (F90 - 1) w(n.l)) (1 + (F90 - 1) w(n.v)) (1 - metallic), F90 = 1/2 + 2 (l.h)² roughness;
//! - specular F D G with D of GGX (GTR2), alpha = roughness², F = C + (1 - C) w(l.h) and
//!   C = metallic base + (1 - metallic) 0.08 specular (tint where asked for);
//! - clear coat clearcoat / 4 F' D' G' with D' = GTR1, F' from 0.04, G' of alpha 1/4, on top of the others.
//!
//! G is the product of 1 / (c + sqrt(a² + c² - a² c²)) over both directions, which holds the 1 / (4 n.l n.v).
//! The model reflects more than it gets where it is rough and white: up to 1.44 at grazing angles, by design.

use std::f32::consts::{FRAC_1_PI, PI};

use glam::Vec3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::math::single;
use crate::render::bsdf::microfacet::{FacetDistribution, Facets, HalfWay, Masking, NormalSampling, SMOOTHEST, mirrored_by};
use crate::render::bsdf::{BsdfError, BsdfSample, Transport};
use crate::render::texture::parameter::{Parameter, Pictures, Portion, Reflectance};
use crate::render::texture::value::{Color, Number};
use crate::render::texture::{Texture, TexturePoint};

/// Disney's model of 2012 (Burley), without sheen, subsurface and anisotropy.
///
/// Rough white surfaces reflect more than they get, most at grazing angles: that is the model.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DisneyParameters {
    /// Color of the surface, 0 to 1: a number, `[r, g, b]` or a texture.
    #[serde(default = "base_color")]
    pub base_color: Reflectance,
    /// Factor on the diffuse part, 0 to 1: a number or a texture; 1 in the paper.
    #[serde(default = "one")]
    pub diffuse: Portion,
    /// Roughness of diffuse and specular part, 0 to 1: a number or a texture. The facets have alpha = roughness².
    #[serde(default = "half")]
    pub roughness: Portion,
    /// Strength of the specular part, 0 to 1: a number or a texture; at 1 it mirrors 8 % along the normal.
    #[serde(default = "half")]
    pub specular: Portion,
    /// How far the specular part has the hue of `base_color`, 0 to 1: a number or a texture.
    #[serde(default = "zero")]
    pub specular_tint: Portion,
    /// From 0, a dielectric, to 1, a metal without diffuse part: a number or a texture.
    #[serde(default = "zero")]
    pub metallic: Portion,
    /// Strength of the clear coat, 0 to 1: a number or a texture.
    #[serde(default = "zero")]
    pub clearcoat: Portion,
    /// From 0, satin, to 1, gloss: a number or a texture.
    #[serde(default = "one")]
    pub clearcoat_gloss: Portion,
    /// How the specular part is masked and shadowed.
    #[serde(default)]
    pub specular_g: SpecularG,
    /// How normals of the specular facets are drawn.
    #[serde(default)]
    pub sampling: NormalSampling,
    /// Whether the back is black; by default both sides are alike.
    #[serde(default)]
    pub one_sided: bool,
}

/// How the specular part is masked and shadowed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum SpecularG {
    /// As if alpha were ((1 + roughness) / 2)²: the paper of 2012.
    #[default]
    #[serde(rename = "burley-2012")]
    Burley2012,
    /// By the alpha of the facets themselves, which darkens grazing angles less: the course notes of 2014.
    #[serde(rename = "burley-2014")]
    Burley2014,
}

fn base_color() -> Reflectance {
    Parameter::Constant(Color::grey(0.8).expect("within the limits"))
}

fn portion(value: f64) -> Portion {
    Parameter::Constant(Number::new(value).expect("within the limits"))
}

fn zero() -> Portion {
    portion(0.0)
}

fn half() -> Portion {
    portion(0.5)
}

fn one() -> Portion {
    portion(1.0)
}

/// Disney's model in a scene.
#[derive(Debug, Clone, PartialEq)]
pub struct DisneyMaterial {
    base_color: Texture<Vec3>,
    diffuse: Texture<f32>,
    roughness: Texture<f32>,
    specular: Texture<f32>,
    specular_tint: Texture<f32>,
    metallic: Texture<f32>,
    clearcoat: Texture<f32>,
    clearcoat_gloss: Texture<f32>,
    specular_g: SpecularG,
    sampling: NormalSampling,
}

impl DisneyMaterial {
    /// With these parameters, and those pictures for its textures.
    pub fn new(parameters: &DisneyParameters, pictures: &dyn Pictures) -> Result<Self, BsdfError> {
        let number = |parameter: &Portion| parameter.texture(pictures);
        Ok(Self {
            base_color: parameters.base_color.texture(pictures)?,
            diffuse: number(&parameters.diffuse)?,
            roughness: number(&parameters.roughness)?,
            specular: number(&parameters.specular)?,
            specular_tint: number(&parameters.specular_tint)?,
            metallic: number(&parameters.metallic)?,
            clearcoat: number(&parameters.clearcoat)?,
            clearcoat_gloss: number(&parameters.clearcoat_gloss)?,
            specular_g: parameters.specular_g,
            sampling: parameters.sampling,
        })
    }

    /// What it is at that point.
    pub fn at(&self, point: &TexturePoint) -> Disney {
        let base = self.base_color.at(point);
        let (roughness, metallic) = (self.roughness.at(point), self.metallic.at(point));
        let (clearcoat, gloss) = (self.clearcoat.at(point), self.clearcoat_gloss.at(point));
        let dielectric = 0.08 * self.specular.at(point) * Vec3::ONE.lerp(tint(base), self.specular_tint.at(point));
        let alpha = (roughness * roughness).max(SMOOTHEST);
        let masking_alpha = match self.specular_g {
            SpecularG::Burley2012 => (0.5 + 0.5 * roughness) * (0.5 + 0.5 * roughness),
            SpecularG::Burley2014 => alpha,
        };
        let diffuse = base * (self.diffuse.at(point) * (1.0 - metallic));
        let diffuse_probability = if diffuse == Vec3::ZERO { 0.0 } else { 0.5 * (1.0 - metallic) };
        let specular_probability = (1.0 - diffuse_probability) / (1.0 + clearcoat);
        Disney {
            diffuse,
            roughness,
            normal_reflectance: dielectric.lerp(base, metallic),
            facets: Facets { distribution: FacetDistribution::Ggx, masking: Masking::Separable, sampling: self.sampling, alpha },
            masking_alpha,
            clearcoat,
            coat: Gtr1::new(0.1 + (0.001 - 0.1) * gloss),
            diffuse_probability,
            specular_probability,
        }
    }

    /// Whether it is the same everywhere.
    pub fn is_constant(&self) -> bool {
        let numbers =
            [&self.diffuse, &self.roughness, &self.specular, &self.specular_tint, &self.metallic, &self.clearcoat, &self.clearcoat_gloss];
        self.base_color.constant().is_some() && numbers.iter().all(|number| number.constant().is_some())
    }
}

/// The color at luminance 1, in the paper's weights; white for black.
fn tint(base: Vec3) -> Vec3 {
    let luminance = base.dot(Vec3::new(0.3, 0.6, 0.1));
    if luminance > 0.0 { base / luminance } else { Vec3::ONE }
}

/// (1 - c)^5.
#[inline]
fn grazing(cosine: f32) -> f32 {
    let m = (1.0 - cosine).clamp(0.0, 1.0);
    m * m * m * m * m
}

/// 1 / (c + sqrt(a² + c² - a² c²)).
#[inline]
fn visible(cosine: f32, alpha: f32) -> f32 {
    let (a2, c2) = (alpha * alpha, cosine * cosine);
    1.0 / (cosine + (a2 + c2 - a2 * c2).sqrt())
}

/// The distribution of the normals of the coat: D = (a² - 1) / (pi ln a² (1 + (a² - 1) cos²)), with very long tails.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gtr1 {
    /// Width, below 1.
    pub alpha: f32,
    /// (a² - 1) / (pi ln a²).
    norm: f32,
}

impl Gtr1 {
    /// Of that width, above 0 and below 1.
    pub fn new(alpha: f32) -> Self {
        let squared = alpha * alpha;
        Self { alpha, norm: (squared - 1.0) / (PI * single::ln(squared)) }
    }

    /// D(h) of a unit vector.
    #[inline]
    pub fn density(&self, half: Vec3) -> f32 {
        // 1 + (a² - 1) cos² = sin² + a² cos², without the cancellation.
        self.norm / (half.x * half.x + half.y * half.y + self.alpha * self.alpha * half.z * half.z)
    }

    /// A normal with density D cos: cos² = (1 - a^(2 (1 - u))) / (1 - a²).
    #[inline]
    pub fn sample(&self, point: [f32; 2]) -> Vec3 {
        let squared = self.alpha * self.alpha;
        // sin² = (a^(2 (1 - u)) - a²) / (1 - a²); its square root keeps the digits of narrow lobes.
        let sine2 = ((single::exp((1.0 - point[0]) * single::ln(squared)) - squared) / (1.0 - squared)).clamp(0.0, 1.0);
        let (sine, cosine) = single::sin_cos_of_turns(point[1]);
        let radius = sine2.sqrt();
        Vec3::new(radius * cosine, radius * sine, (1.0 - sine2).sqrt())
    }
}

/// Disney's model at one point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Disney {
    /// Base color of the diffuse part.
    diffuse: Vec3,
    roughness: f32,
    /// What the specular part mirrors along the normal.
    normal_reflectance: Vec3,
    facets: Facets,
    /// Alpha of the specular G.
    masking_alpha: f32,
    clearcoat: f32,
    coat: Gtr1,
    diffuse_probability: f32,
    specular_probability: f32,
}

/// Alpha of the coat's G.
const COAT_MASKING: f32 = 0.25;

impl Disney {
    /// Width of the narrowest lobe that has a part in it.
    pub fn least_alpha(&self) -> f32 {
        if self.clearcoat > 0.0 { self.facets.alpha.min(self.coat.alpha) } else { self.facets.alpha }
    }

    /// A direction by the cosine, or `outgoing` mirrored by a facet of the specular part or of the coat.
    #[inline]
    pub fn sample(&self, outgoing: Vec3, choice: f32, point: [f32; 2], transport: Transport) -> Option<BsdfSample> {
        let direction = if choice < self.diffuse_probability {
            Vec3::from_array(single::cosine_hemisphere(point))
        } else {
            let is_specular = choice < self.diffuse_probability + self.specular_probability;
            let half = if is_specular { self.facets.sample(outgoing, point) } else { self.coat.sample(point) };
            let cos_oh = outgoing.dot(half);
            if cos_oh <= 0.0 {
                return None;
            }
            mirrored_by(outgoing, half, cos_oh)
        };
        let (value, pdf) = self.evaluate_with_pdf(outgoing, direction, transport);
        (pdf > 0.0).then(|| BsdfSample { direction, weight: value / pdf, pdf, is_delta: false, eta: 1.0 })
    }

    /// The sum of the parts, and the mixture of their densities.
    #[inline]
    pub fn evaluate_with_pdf(&self, outgoing: Vec3, incoming: Vec3, _: Transport) -> (Vec3, f32) {
        let Some(HalfWay { sum, length, cosine: cos_oh, .. }) = HalfWay::between(outgoing, incoming) else { return (Vec3::ZERO, 0.0) };
        let half = sum / length;
        let (cos_o, cos_i) = (outgoing.z, incoming.z);

        let retro = 2.0 * cos_oh * cos_oh * self.roughness - 0.5;
        let diffuse = self.diffuse * (FRAC_1_PI * (1.0 + retro * grazing(cos_i)) * (1.0 + retro * grazing(cos_o)));

        let schlick = grazing(cos_oh);
        let fresnel = self.normal_reflectance + (Vec3::ONE - self.normal_reflectance) * schlick;
        let facets = self.facets.density(half, 1.0);
        let specular = fresnel * (facets * visible(cos_i, self.masking_alpha) * visible(cos_o, self.masking_alpha));

        let coat = self.coat.density(half);
        let coat_fresnel = 0.04 + 0.96 * schlick;
        let clear = 0.25 * self.clearcoat * coat * coat_fresnel * visible(cos_i, COAT_MASKING) * visible(cos_o, COAT_MASKING);

        let seen = self.facets.drawn_from(outgoing, half.z, cos_oh);
        let coat_probability = 1.0 - self.diffuse_probability - self.specular_probability;
        let pdf = self.diffuse_probability * cos_i * FRAC_1_PI
            + self.specular_probability * facets * seen * 0.25
            + coat_probability.max(0.0) * coat * half.z / (4.0 * cos_oh);
        ((diffuse + specular + clear) * cos_i, pdf)
    }

    /// About what comes back of light along the normal: the diffuse color and what both mirrors reflect there.
    pub fn albedo(&self) -> Vec3 {
        self.diffuse + self.normal_reflectance + 0.25 * self.clearcoat * 0.04
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::stream::{Purpose, Stream};

    /// int D cos = 1, by the trapezoid rule in ln(sin² + a² cos²), in which the integrand is constant.
    #[test]
    fn the_distribution_of_the_coat_is_normalized_and_drawn() {
        for alpha in [0.001_f32, 0.005, 0.05, 0.1, 0.5, 0.9] {
            let coat = Gtr1::new(alpha);
            let a2 = f64::from(alpha) * f64::from(alpha);
            let count = 2000;
            // t = sin² + a² cos² from a² to 1; 2 pi cos dcos = -pi dt / (a² - 1)..., so the integral is pi / (1 - a²) int D dt.
            let mut sum = 0.0;
            for k in 0..count {
                let t = crate::math::elementary::exp(crate::math::elementary::ln(a2) * (1.0 - (f64::from(k) + 0.5) / f64::from(count)));
                let sine2 = (t - a2) / (1.0 - a2);
                let half = Vec3::new((sine2 as f32).sqrt(), 0.0, ((1.0 - sine2) as f32).sqrt());
                sum += f64::from(coat.density(half)) * t * -crate::math::elementary::ln(a2) / f64::from(count);
            }
            let integral = std::f64::consts::PI / (1.0 - a2) * sum;
            assert!((integral - 1.0).abs() < 1e-4, "{alpha}: {integral}");

            // P(sin² < s) = ln((s + a² (1 - s)) / a²) / -ln a²: at the median t = a.
            let stream = Stream::new(4, Purpose::Test);
            let median = (f64::from(alpha) - a2) / (1.0 - a2);
            let below = (0..20_000).filter(|index| {
                let drawn = coat.sample(stream.generator(*index).uniform_pair().map(|u| u as f32));
                f64::from(drawn.x * drawn.x + drawn.y * drawn.y) < median
            });
            // Five standard errors of a half.
            assert!((below.count() as f64 / 20_000.0 - 0.5).abs() < 0.0177, "{alpha}");
        }
    }
}

//! A diffuse body under a smooth clear coat.
//!
//! Light that enters the coat is scattered by the body, partly thrown back into it by the coat, and leaves:
//! f = (rho / pi) (1 - F(i)) (1 - F(o)) eta^-2 / (1 - Fi), with Fi the mean of the coat's reflectance from inside
//! (Fresnel in Mitsuba's `plastic`; after Jakob et al., "A comprehensive framework for rendering layered materials", 2014).

use std::f32::consts::FRAC_1_PI;

use glam::Vec3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::light::fresnel::Boundary;
use crate::math::single;
use crate::render::bsdf::dielectric::{DielectricFresnel, Interface, glass};
use crate::render::bsdf::diffuse::default_reflectance;
use crate::render::bsdf::mirror::{all, mirrored};
use crate::render::bsdf::{BsdfError, BsdfSample, Transport};
use crate::render::texture::parameter::{Pictures, Reflectance};
use crate::render::texture::{Texture, TexturePoint};

/// A diffuse body under a smooth clear coat, as Mitsuba's `plastic`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PlasticParameters {
    /// Index of refraction of the coat over that of the medium in front of it. One number: what the coat throws back
    /// into the body is an integral over it.
    #[serde(default = "glass")]
    #[schemars(range(max = 10), extend("exclusiveMinimum" = 1))]
    pub eta: f64,
    /// Share of light that the body scatters, 0 to 1: a number, `[r, g, b]` or a texture.
    #[serde(default = "default_reflectance")]
    pub diffuse: Reflectance,
    /// Factor on what the coat mirrors, 0 to 1: a number, `[r, g, b]` or a texture; 1 in nature.
    #[serde(default = "all")]
    pub specular: Reflectance,
    /// Whether colors saturate as light is scattered by the body again and again: / (1 - rho Fi) in place of / (1 - Fi).
    #[serde(default)]
    pub nonlinear: bool,
    /// Whether the back is black; by default both sides are alike.
    #[serde(default)]
    pub one_sided: bool,
}

/// A coated surface of a scene.
#[derive(Debug, Clone, PartialEq)]
pub struct PlasticMaterial {
    interface: Interface,
    eta: f32,
    inner_mean: f32,
    nonlinear: bool,
    diffuse: Texture<Vec3>,
    specular: Texture<Vec3>,
}

impl PlasticMaterial {
    /// With these parameters, and those pictures for its textures.
    pub fn new(parameters: &PlasticParameters, pictures: &dyn Pictures) -> Result<Self, BsdfError> {
        Ok(Self {
            interface: Interface::new(parameters.eta, DielectricFresnel::Exact),
            eta: parameters.eta as f32,
            inner_mean: hemispherical_mean(Boundary::leaving(parameters.eta)) as f32,
            nonlinear: parameters.nonlinear,
            diffuse: parameters.diffuse.texture(pictures)?,
            specular: parameters.specular.texture(pictures)?,
        })
    }

    /// What it is at that point.
    pub fn at(&self, point: &TexturePoint) -> Plastic {
        let (diffuse, specular) = (self.diffuse.at(point), self.specular.at(point));
        let again = if self.nonlinear { diffuse * self.inner_mean } else { Vec3::splat(self.inner_mean) };
        let body = diffuse / ((Vec3::ONE - again) * (self.eta * self.eta));
        let sum = diffuse.element_sum() + specular.element_sum();
        let specular_share = if sum > 0.0 { specular.element_sum() / sum } else { 0.5 };
        Plastic { interface: self.interface, inner_mean: self.inner_mean, eta: self.eta, body, specular, specular_share }
    }

    /// Whether it is the same everywhere.
    pub fn is_constant(&self) -> bool {
        self.diffuse.constant().is_some() && self.specular.constant().is_some()
    }
}

/// The mean of the reflectance over the cosine-weighted hemisphere, int_0^1 2 F(c) c dc, to seven digits.
fn hemispherical_mean(boundary: Boundary) -> f64 {
    // Midpoint rule in c², whose integrand bends at the critical angle alone.
    const COUNT: u32 = 20_000;
    let value = |index: u32| boundary.unpolarized(((f64::from(index) + 0.5) / f64::from(COUNT)).sqrt());
    (0..COUNT).map(value).sum::<f64>() / f64::from(COUNT)
}

/// The coat's mirror and the body's diffuse lobe.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Plastic {
    interface: Interface,
    inner_mean: f32,
    eta: f32,
    /// rho eta^-2 / (1 - Fi), or with rho Fi.
    body: Vec3,
    specular: Vec3,
    /// Share of the mirror in the drawing, before Fresnel's.
    specular_share: f32,
}

impl Plastic {
    /// Probability of drawing the mirrored direction, where that share is mirrored.
    #[inline]
    fn specular_probability(&self, (reflected, passing): (f32, f32)) -> f32 {
        let mirror = reflected * self.specular_share;
        let body = passing * (1.0 - self.specular_share);
        // Both are zero only for a grazing direction on a coat that mirrors nothing.
        if mirror + body > 0.0 { mirror / (mirror + body) } else { 1.0 }
    }

    /// (rho / pi) (1 - F(i)) (1 - F(o)) eta^-2 / (1 - Fi) cos_i.
    #[inline]
    fn body_value(&self, incoming: Vec3, (_, passing): (f32, f32)) -> Vec3 {
        let passing_in = self.interface.shares(incoming.z).1;
        self.body * (passing * passing_in * incoming.z * FRAC_1_PI)
    }

    /// The mirrored direction, or one by the cosine.
    #[inline]
    pub fn sample(&self, outgoing: Vec3, choice: f32, point: [f32; 2], _: Transport) -> Option<BsdfSample> {
        let shares = self.interface.shares(outgoing.z);
        let probability = self.specular_probability(shares);
        if choice < probability {
            let weight = self.specular * (shares.0 / probability);
            return Some(BsdfSample { direction: mirrored(outgoing), weight, pdf: probability, is_delta: true, eta: 1.0 });
        }
        let direction = Vec3::from_array(single::cosine_hemisphere(point));
        let pdf = (1.0 - probability) * direction.z * FRAC_1_PI;
        let weight = self.body_value(direction, shares) / pdf;
        (pdf > 0.0).then_some(BsdfSample { direction, weight, pdf, is_delta: false, eta: 1.0 })
    }

    /// Of the body alone: the mirror is a delta lobe.
    #[inline]
    pub fn evaluate_with_pdf(&self, outgoing: Vec3, incoming: Vec3, _: Transport) -> (Vec3, f32) {
        if incoming.z <= 0.0 {
            return (Vec3::ZERO, 0.0);
        }
        let shares = self.interface.shares(outgoing.z);
        let pdf = (1.0 - self.specular_probability(shares)) * incoming.z * FRAC_1_PI;
        (self.body_value(incoming, shares), pdf)
    }

    /// What comes back of light along the normal: F specular + (1 - F) body int (1 - F(i)) cos / pi.
    ///
    /// The integral is 1 - Fe = eta² (1 - Fi), by the identity of the means from both sides.
    pub fn albedo(&self) -> Vec3 {
        let (reflected, passing) = self.interface.shares(1.0);
        let leaving = self.eta * self.eta * (1.0 - self.inner_mean);
        self.specular * reflected + self.body * (passing * leaving)
    }
}

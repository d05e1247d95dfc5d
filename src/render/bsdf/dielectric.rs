//! Smooth boundary of glass, water and other dielectrics.
//!
//! After Walter et al., "Microfacet models for refraction through rough surfaces" (2007); the scaling of radiance by
//! the square of the index after Veach, "Robust Monte Carlo methods for light transport simulation" (1997), 5.2.

use glam::Vec3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::light::fresnel::Boundary;
use crate::render::bsdf::mirror::{all, mirrored};
use crate::render::bsdf::{BsdfError, BsdfSample, Transport};
use crate::render::texture::parameter::{Pictures, Reflectance};
use crate::render::texture::{Texture, TexturePoint};

/// Smooth glass or water: reflects the Fresnel share and refracts the rest by Snell's law.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DielectricParameters {
    /// Index of refraction behind the surface over that in front of it, where the normal points.
    /// One number: the index belongs to what lies behind, so that light would gain or lose where it varied from entry to exit.
    #[serde(default = "glass")]
    #[schemars(range(min = 0.1, max = 10))]
    pub eta: f64,
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

/// Index of refraction of glass by default.
pub(crate) fn glass() -> f64 {
    1.5
}

/// How the reflected share depends on the angle.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum DielectricFresnel {
    /// Fresnel's equations for unpolarized light.
    #[default]
    Exact,
    /// Schlick's approximation (1994), by the angle on the thinner side.
    Schlick,
}

/// A dielectric boundary of a scene.
#[derive(Debug, Clone, PartialEq)]
pub struct DielectricMaterial {
    eta: f64,
    fresnel: DielectricFresnel,
    reflectance: Texture<Vec3>,
    transmittance: Texture<Vec3>,
}

impl DielectricMaterial {
    /// With these parameters, and those pictures for its textures.
    pub fn new(parameters: &DielectricParameters, pictures: &dyn Pictures) -> Result<Self, BsdfError> {
        let DielectricParameters { eta, reflectance, transmittance, fresnel } = parameters;
        Ok(Self {
            eta: *eta,
            fresnel: *fresnel,
            reflectance: reflectance.texture(pictures)?,
            transmittance: transmittance.texture(pictures)?,
        })
    }

    /// What it is at that point.
    pub fn at(&self, point: &TexturePoint) -> Dielectric {
        Dielectric {
            interface: Interface::new(self.eta, self.fresnel),
            reflectance: self.reflectance.at(point),
            transmittance: self.transmittance.at(point),
        }
    }

    /// Whether it is the same everywhere.
    pub fn is_constant(&self) -> bool {
        self.reflectance.constant().is_some() && self.transmittance.constant().is_some()
    }
}

/// The two media of a boundary and how it divides light between them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Interface {
    /// Index behind the surface over that in front of it.
    eta: f64,
    fresnel: DielectricFresnel,
}

impl Interface {
    /// A boundary of that relative index, behind over in front.
    pub fn new(eta: f64, fresnel: DielectricFresnel) -> Self {
        Self { eta, fresnel }
    }

    /// Index on the far side over that on the side where z has the sign of `cosine`.
    #[inline]
    pub fn relative_index(&self, cosine: f32) -> f32 {
        (if cosine > 0.0 { self.eta } else { 1.0 / self.eta }) as f32
    }

    /// The shares of what arrives at that cosine, of which the sign is the side: reflected and passing.
    #[inline]
    pub fn shares(&self, cosine: f32) -> (f32, f32) {
        let boundary = if cosine > 0.0 { Boundary::entering(self.eta) } else { Boundary::leaving(self.eta) };
        let cosine = f64::from(cosine.abs()).min(1.0);
        let share = match self.fresnel {
            DielectricFresnel::Exact => boundary.unpolarized(cosine),
            DielectricFresnel::Schlick => boundary.schlick(cosine),
        };
        // Each of them keeps its digits where it is small.
        (share as f32, (1.0 - share) as f32)
    }

    /// The reflected share of what arrives at that cosine, of which the sign is the side.
    #[inline]
    pub fn reflectance(&self, cosine: f32) -> f32 {
        self.shares(cosine).0
    }
}

/// By what radiance is divided when it enters a medium of that relative index: eta² for radiance, 1 for energy.
#[inline]
pub fn compression(eta: f32, transport: Transport) -> f32 {
    if transport == Transport::Radiance { eta * eta } else { 1.0 }
}

/// The direction into which `outgoing` is refracted by a boundary whose unit normal is `normal`, on its side.
///
/// `eta` is the index on the far side over that on the side of `outgoing`. `None` beyond the critical angle.
#[inline]
pub fn refracted(outgoing: Vec3, normal: Vec3, eta: f32) -> Option<Vec3> {
    let cosine = outgoing.dot(normal);
    // The part along the boundary keeps its digits where 1 - cosine² would not.
    let along = outgoing - normal * cosine;
    let sine2 = along.length_squared() / (eta * eta);
    let direction = || -(along / eta) - normal * (1.0 - sine2).sqrt();
    (sine2 < 1.0).then(|| direction().normalize())
}

/// Both smooth lobes of a boundary.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Dielectric {
    /// Indices of both sides.
    pub interface: Interface,
    /// Factor on what is reflected.
    pub reflectance: Vec3,
    /// Factor on what passes.
    pub transmittance: Vec3,
}

impl Dielectric {
    /// The mirrored or the refracted direction, with the probability of their shares.
    #[inline]
    pub fn sample(&self, outgoing: Vec3, choice: f32, _point: [f32; 2], transport: Transport) -> Option<BsdfSample> {
        let (reflected, passing) = self.interface.shares(outgoing.z);
        if choice < reflected {
            return Some(BsdfSample { direction: mirrored(outgoing), weight: self.reflectance, pdf: reflected, is_delta: true, eta: 1.0 });
        }
        let eta = self.interface.relative_index(outgoing.z);
        let direction = refracted(outgoing, Vec3::new(0.0, 0.0, 1.0_f32.copysign(outgoing.z)), eta)?;
        let weight = self.transmittance / compression(eta, transport);
        Some(BsdfSample { direction, weight, pdf: passing, is_delta: true, eta })
    }

    /// Zero: no other direction is ever the reflected or the refracted one.
    #[inline]
    pub fn evaluate_with_pdf(&self, _outgoing: Vec3, _incoming: Vec3, _: Transport) -> (Vec3, f32) {
        (Vec3::ZERO, 0.0)
    }

    /// What is reflected and what passes along the normal.
    pub fn albedo(&self) -> Vec3 {
        let (reflected, passing) = self.interface.shares(1.0);
        self.reflectance * reflected + self.transmittance * passing
    }
}

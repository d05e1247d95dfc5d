//! How surfaces scatter light: one file per kind.
//!
//! What a person writes is a [`BsdfDescription`]; a scene holds it as a [`Material`], whose parameters may be textures;
//! at a hit it becomes a [`Bsdf`] of plain numbers, and with the frames of the surface a `shading::Shading`.
//! A [`Bsdf`] lives in the local frame: z is the shading normal, and both directions point away from the surface.
//! Values include the cosine of the incoming direction; densities are per steradian.
//!
//! Reading order: this file, `diffuse`, `mirror`, `dielectric`, `metal`, `conductor`, `microfacet`,
//! `rough_conductor`, `rough_dielectric`, `plastic`, `disney`, then `perturbed` and `blend`, which hold others, `material`,
//! `shading`, `measure`. A new kind is a file and its rows in the enums below and in `material`.

pub mod blend;
pub mod conductor;
pub mod dielectric;
pub mod diffuse;
pub mod disney;
#[cfg(test)]
mod laws;
pub mod material;
pub mod measure;
pub mod metal;
pub mod microfacet;
pub mod mirror;
pub mod perturbed;
pub mod plastic;
pub mod rough_conductor;
pub mod rough_dielectric;
pub mod shading;

use glam::Vec3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use thiserror::Error;
use wide::f32x4;

use crate::math::single;
use crate::render::bsdf::blend::{Blend, BlendParameters};
use crate::render::bsdf::conductor::{Conductor, ConductorParameters};
use crate::render::bsdf::dielectric::{Dielectric, DielectricParameters};
use crate::render::bsdf::diffuse::{Diffuse, DiffuseParameters};
use crate::render::bsdf::disney::{Disney, DisneyParameters};
use crate::render::bsdf::mirror::{Mirror, MirrorParameters};
use crate::render::bsdf::perturbed::{Bend, BumpMapParameters, NormalMapParameters, Shadowing};
use crate::render::bsdf::plastic::{Plastic, PlasticParameters};
use crate::render::bsdf::rough_conductor::{RoughConductor, RoughConductorParameters};
use crate::render::bsdf::rough_dielectric::{RoughDielectric, RoughDielectricParameters};
use crate::render::frame::Frame;
use crate::render::lanes::{Vectors, Weighted};
use crate::render::texture::bitmap::TexelError;

/// How a surface scatters light.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
#[expect(clippy::large_enum_variant, reason = "a scene has few, and most are of the large variants")]
pub enum BsdfDescription {
    /// Equally bright from all sides (Lambert).
    Diffuse(DiffuseParameters),
    /// A perfect mirror of one reflectance at all angles.
    Mirror(MirrorParameters),
    /// Smooth glass or water: reflects and refracts.
    Dielectric(DielectricParameters),
    /// Smooth metal.
    Conductor(ConductorParameters),
    /// Metal with microfacets.
    RoughConductor(RoughConductorParameters),
    /// Frosted glass: a dielectric with microfacets.
    RoughDielectric(RoughDielectricParameters),
    /// A diffuse body under a smooth clear coat.
    Plastic(PlasticParameters),
    /// Disney's model of 2012, from cloth to car paint.
    Disney(DisneyParameters),
    /// A BSDF whose normals a picture holds.
    NormalMap(NormalMapParameters),
    /// A BSDF whose normals are those of a relief of small heights.
    BumpMap(BumpMapParameters),
    /// Two BSDFs, mixed.
    Blend(BlendParameters),
}

/// What is wrong with the parameters of a BSDF beyond what their schema says.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum BsdfError {
    /// Two ways to say which metal.
    #[error("`metal` and `{0}` both say which metal it is: give either `metal`, or `eta` and `k`")]
    MetalTwice(&'static str),
    /// No way to say which metal.
    #[error("`{0}` is missing: give a `metal`, or `eta` and `k`")]
    MetalMissing(&'static str),
    /// A boundary between equal media, of which microfacets bend no light.
    #[error("a rough boundary with `eta: {0}` bends no light: take an `eta` below 0.999 or above 1.001, or `dielectric`")]
    IndexMatched(f64),
    /// A picture with values that the parameter may not have.
    #[error(transparent)]
    Texel(#[from] TexelError),
}

impl BsdfError {
    /// The parameter at fault, by its name in the text.
    pub fn parameter(&self) -> &'static str {
        match self {
            Self::MetalTwice(name) | Self::MetalMissing(name) => name,
            Self::IndexMatched(_) => "eta",
            Self::Texel(_) => "path",
        }
    }
}

/// What is carried along a path: it decides whether refraction scales by the square of the index.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Transport {
    /// Radiance, towards the camera: compressed by (eta_i / eta_t)² into the denser side.
    Radiance,
    /// Energy, as photons carry it.
    Energy,
}

/// How directions are drawn at surfaces that are not ideally smooth.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum DirectionSampling {
    /// As the BSDF asks for.
    #[default]
    Bsdf,
    /// By the cosine from the normal, whatever the BSDF: right on average, and noisy on glossy surfaces.
    Cosine,
}

/// A direction drawn from a BSDF.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BsdfSample {
    /// Where light comes from: a unit vector away from the surface.
    pub direction: Vec3,
    /// Value times cosine over density.
    pub weight: Vec3,
    /// Density per steradian; for a delta lobe the probability of having chosen it.
    pub pdf: f32,
    /// Whether no other way of drawing could have found this direction.
    pub is_delta: bool,
    /// Index of refraction on the side of `direction` over that on the side of the outgoing one: 1 for reflection.
    pub eta: f32,
}

/// How a surface scatters light at one point; borrows from the material what is made of others.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bsdf<'m> {
    lobe: Lobe<'m>,
    sides: Sides,
    directions: DirectionSampling,
    /// The normal about which the lobe lies, if it is not z.
    bend: Option<Bend>,
}

/// What the back of a surface does.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sides {
    /// The same as the front.
    Alike,
    /// Nothing: it is black.
    FrontOnly,
    /// What its lobe says: it lets light through, or is made of others.
    Own,
}

impl Sides {
    /// Of an opaque surface.
    pub fn of_opaque(one_sided: bool) -> Self {
        if one_sided { Self::FrontOnly } else { Self::Alike }
    }
}

/// One kind of scattering with its numbers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Lobe<'m> {
    /// See [`BsdfDescription::Diffuse`].
    Diffuse(Diffuse),
    /// See [`BsdfDescription::Mirror`].
    Mirror(Mirror),
    /// See [`BsdfDescription::Dielectric`].
    Dielectric(Dielectric),
    /// See [`BsdfDescription::Conductor`].
    Conductor(Conductor),
    /// See [`BsdfDescription::RoughConductor`].
    RoughConductor(RoughConductor),
    /// See [`BsdfDescription::RoughDielectric`].
    RoughDielectric(RoughDielectric),
    /// See [`BsdfDescription::Plastic`].
    Plastic(Plastic),
    /// See [`BsdfDescription::Disney`].
    Disney(Disney),
    /// See [`BsdfDescription::Blend`].
    Blend(Blend<'m>),
}

/// Does the same with the lobe of any kind.
macro_rules! for_each_lobe {
    ($lobe:expr, $kind:ident => $action:expr) => {
        match $lobe {
            Lobe::Diffuse($kind) => $action,
            Lobe::Mirror($kind) => $action,
            Lobe::Dielectric($kind) => $action,
            Lobe::Conductor($kind) => $action,
            Lobe::RoughConductor($kind) => $action,
            Lobe::RoughDielectric($kind) => $action,
            Lobe::Plastic($kind) => $action,
            Lobe::Disney($kind) => $action,
            Lobe::Blend($kind) => $action,
        }
    };
}

impl<'m> Bsdf<'m> {
    /// A lobe on those sides of a surface, whose directions are drawn in that way.
    pub fn new(lobe: Lobe<'m>, sides: Sides, directions: DirectionSampling) -> Self {
        Self { lobe, sides, directions, bend: None }
    }

    /// The same with its own frame laid along the axes of another.
    #[must_use]
    pub fn bent(self, frame: &Frame, shadowing: Shadowing) -> Self {
        let normal = frame.to_world(self.shading_normal());
        // Bent twice it may have turned away from the surface, where no map may bring it.
        let bend = (normal.z > 0.0).then_some(Bend { normal, shadowing });
        Self { bend, ..self }
    }

    /// What it is made of.
    pub fn lobe(&self) -> &Lobe<'m> {
        &self.lobe
    }

    /// The normal about which it scatters, in the local frame: z unless a map bends it.
    pub fn shading_normal(&self) -> Vec3 {
        self.bend.map_or(Vec3::Z, |bend| bend.normal)
    }

    /// The same in the world, for a surface of that frame.
    pub fn normal_in(&self, frame: &Frame) -> Vec3 {
        self.bend.map_or(frame.normal, |bend| frame.to_world(bend.normal))
    }

    /// Draws a direction; `choice` picks among lobes, `point` a direction within one, all uniform on [0, 1).
    ///
    /// `None` where the drawn normal or direction leads below the surface, and where nothing is scattered:
    /// the densities of the drawn directions then integrate to less than one.
    #[inline]
    pub fn sample(&self, outgoing: Vec3, choice: f32, point: [f32; 2], transport: Transport) -> Option<BsdfSample> {
        match &self.bend {
            None => self.sample_upright(outgoing, choice, point, transport),
            Some(bend) => self.sample_bent(bend, outgoing, choice, point, transport),
        }
    }

    /// Value times |cosine of the incoming direction|, and the density of [`Self::sample`]; zero for delta lobes.
    #[inline]
    pub fn evaluate_with_pdf(&self, outgoing: Vec3, incoming: Vec3, transport: Transport) -> (Vec3, f32) {
        match &self.bend {
            None => self.evaluate_upright(outgoing, incoming, transport),
            Some(bend) => self.evaluate_bent(bend, outgoing, incoming, transport),
        }
    }

    /// The same for four incoming directions at once; `None` for what is not cheap enough to be worth it.
    #[inline]
    pub fn evaluate_lanes(&self, outgoing: Vec3, incoming: &Vectors) -> Option<Weighted> {
        match (&self.lobe, &self.bend) {
            (Lobe::Diffuse(diffuse), None) => {
                Some(diffuse.evaluate_lanes(self.flip(outgoing).map_or(f32x4::ZERO, |flip| incoming.z * flip.z)))
            }
            _ => None,
        }
    }

    fn sample_bent(&self, bend: &Bend, outgoing: Vec3, choice: f32, point: [f32; 2], transport: Transport) -> Option<BsdfSample> {
        let frame = bend.frame(outgoing)?;
        let sample = self.sample_upright(frame.to_local(outgoing), choice, point, transport)?;
        let direction = frame.to_world(sample.direction).normalize();
        let agrees = direction.z * sample.direction.z > 0.0;
        agrees.then(|| BsdfSample { direction, weight: sample.weight * bend.shadow(direction), ..sample })
    }

    fn evaluate_bent(&self, bend: &Bend, outgoing: Vec3, incoming: Vec3, transport: Transport) -> (Vec3, f32) {
        let Some(frame) = bend.frame(outgoing) else { return (Vec3::ZERO, 0.0) };
        let local = frame.to_local(incoming);
        if local.z * incoming.z <= 0.0 {
            return (Vec3::ZERO, 0.0);
        }
        let (value, pdf) = self.evaluate_upright(frame.to_local(outgoing), local, transport);
        (value * bend.shadow(incoming), pdf)
    }

    #[inline]
    fn sample_upright(&self, outgoing: Vec3, choice: f32, point: [f32; 2], transport: Transport) -> Option<BsdfSample> {
        let flip = self.flip(outgoing)?;
        let sample = if self.draws_by_cosine() {
            self.sample_by_cosine(outgoing * flip, choice, point, transport)?
        } else {
            for_each_lobe!(&self.lobe, lobe => lobe.sample(outgoing * flip, choice, point, transport))?
        };
        Some(BsdfSample { direction: sample.direction * flip, ..sample })
    }

    #[inline]
    fn evaluate_upright(&self, outgoing: Vec3, incoming: Vec3, transport: Transport) -> (Vec3, f32) {
        let Some(flip) = self.flip(outgoing) else { return (Vec3::ZERO, 0.0) };
        let (outgoing, incoming) = (outgoing * flip, incoming * flip);
        let (value, pdf) = for_each_lobe!(&self.lobe, lobe => lobe.evaluate_with_pdf(outgoing, incoming, transport));
        if self.draws_by_cosine() { (value, self.cosine_pdf(incoming)) } else { (value, pdf) }
    }

    /// Value times |cosine of the incoming direction|; zero for delta lobes.
    pub fn evaluate(&self, outgoing: Vec3, incoming: Vec3, transport: Transport) -> Vec3 {
        self.evaluate_with_pdf(outgoing, incoming, transport).0
    }

    /// Density of [`Self::sample`] per steradian; zero for delta lobes.
    pub fn pdf(&self, outgoing: Vec3, incoming: Vec3) -> f32 {
        self.evaluate_with_pdf(outgoing, incoming, Transport::Energy).1
    }

    /// Whether there are delta lobes alone, which no light can be connected to.
    pub fn is_delta(&self) -> bool {
        match &self.lobe {
            Lobe::Blend(blend) => blend.parts().iter().all(Bsdf::is_delta),
            lobe => matches!(lobe, Lobe::Mirror(_) | Lobe::Dielectric(_) | Lobe::Conductor(_)),
        }
    }

    /// Whether light passes through.
    pub fn is_transmissive(&self) -> bool {
        match &self.lobe {
            Lobe::Blend(blend) => blend.parts().iter().any(Bsdf::is_transmissive),
            _ => self.sides == Sides::Own,
        }
    }

    /// The share of light along the normal that comes back or passes, for the layer of a picture.
    pub fn albedo(&self) -> Vec3 {
        for_each_lobe!(&self.lobe, lobe => lobe.albedo())
    }

    /// The factors that bring directions to the side for which opaque lobes are written; `None` on a black side.
    fn flip(&self, outgoing: Vec3) -> Option<Vec3> {
        const BACK: Vec3 = Vec3::new(1.0, 1.0, -1.0);
        match self.sides {
            _ if outgoing.z > 0.0 => Some(Vec3::ONE),
            Sides::Alike if outgoing.z < 0.0 => Some(BACK),
            Sides::Own if outgoing.z < 0.0 => Some(Vec3::ONE),
            _ => None,
        }
    }

    /// Whether the lobe's own way of drawing is replaced; delta parts have no other way.
    fn draws_by_cosine(&self) -> bool {
        self.directions == DirectionSampling::Cosine && matches!(self.lobe, Lobe::RoughConductor(_) | Lobe::RoughDielectric(_))
    }

    fn sample_by_cosine(&self, outgoing: Vec3, choice: f32, point: [f32; 2], transport: Transport) -> Option<BsdfSample> {
        let up = single::cosine_hemisphere(point);
        let is_transmitted = self.is_transmissive() && choice < 0.5;
        let side = if is_transmitted { -outgoing.z } else { outgoing.z };
        let direction = Vec3::new(up[0], up[1], up[2].copysign(side));
        let pdf = self.cosine_pdf(direction);
        let (value, _) = for_each_lobe!(&self.lobe, lobe => lobe.evaluate_with_pdf(outgoing, direction, transport));
        let eta = if is_transmitted { self.eta(outgoing) } else { 1.0 };
        (pdf > 0.0 && value != Vec3::ZERO).then(|| BsdfSample { direction, weight: value / pdf, pdf, is_delta: false, eta })
    }

    /// Density of the cosine, over one side of an opaque surface or both of a transmissive one.
    fn cosine_pdf(&self, incoming: Vec3) -> f32 {
        use std::f32::consts::{FRAC_1_PI, TAU};
        if self.is_transmissive() { incoming.z.abs() / TAU } else { incoming.z.max(0.0) * FRAC_1_PI }
    }

    fn eta(&self, outgoing: Vec3) -> f32 {
        match &self.lobe {
            Lobe::RoughDielectric(lobe) => lobe.relative_index(outgoing),
            _ => 1.0,
        }
    }
}

//! The BSDF of a shape as a scene holds it: checked, and with textures for parameters.

use glam::{Vec2, Vec3};

use crate::render::bsdf::conductor::ConductorMaterial;
use crate::render::bsdf::dielectric::DielectricMaterial;
use crate::render::bsdf::diffuse::DiffuseMaterial;
use crate::render::bsdf::mirror::MirrorMaterial;
use crate::render::bsdf::plastic::PlasticMaterial;
use crate::render::bsdf::rough_conductor::RoughConductorMaterial;
use crate::render::bsdf::rough_dielectric::RoughDielectricMaterial;
use crate::render::bsdf::{Bsdf, BsdfDescription, BsdfError, DirectionSampling, Lobe, Sides};
use crate::render::texture::TexturePoint;

/// The BSDF of a shape: ask it at a hit for the [`Bsdf`] there.
#[derive(Debug, Clone, PartialEq)]
pub struct Material {
    kind: MaterialKind,
    sides: Sides,
    directions: DirectionSampling,
    /// What it is everywhere, if no parameter varies.
    constant: Option<Bsdf>,
}

#[derive(Debug, Clone, PartialEq)]
enum MaterialKind {
    Diffuse(DiffuseMaterial),
    Mirror(MirrorMaterial),
    Dielectric(DielectricMaterial),
    Conductor(ConductorMaterial),
    RoughConductor(RoughConductorMaterial),
    RoughDielectric(RoughDielectricMaterial),
    Plastic(PlasticMaterial),
}

impl Material {
    /// Checks a description; `directions` says how directions are drawn where the BSDF leaves a choice.
    pub fn new(description: &BsdfDescription, directions: DirectionSampling) -> Result<Self, BsdfError> {
        let (kind, sides) = MaterialKind::new(description)?;
        let material = Self { kind, sides, directions, constant: None };
        let anywhere = TexturePoint { uv: Vec2::ZERO, position: Vec3::ZERO };
        let constant = material.kind.is_constant().then(|| material.at(&anywhere));
        Ok(Self { constant, ..material })
    }

    /// What it is at that point.
    #[inline]
    pub fn at(&self, point: &TexturePoint) -> Bsdf {
        self.constant.unwrap_or_else(|| Bsdf::new(self.kind.at(point), self.sides, self.directions))
    }

    /// Whether light passes through.
    pub fn is_transmissive(&self) -> bool {
        self.sides == Sides::Own
    }
}

impl MaterialKind {
    fn new(description: &BsdfDescription) -> Result<(Self, Sides), BsdfError> {
        Ok(match description {
            BsdfDescription::Diffuse(it) => (Self::Diffuse(DiffuseMaterial::new(it)), Sides::of_opaque(it.one_sided)),
            BsdfDescription::Mirror(it) => (Self::Mirror(MirrorMaterial::new(it)), Sides::of_opaque(it.one_sided)),
            BsdfDescription::Dielectric(it) => (Self::Dielectric(DielectricMaterial::new(it)), Sides::Own),
            BsdfDescription::Conductor(it) => (Self::Conductor(ConductorMaterial::new(it)?), Sides::of_opaque(it.one_sided)),
            BsdfDescription::RoughConductor(it) => (Self::RoughConductor(RoughConductorMaterial::new(it)?), Sides::of_opaque(it.one_sided)),
            BsdfDescription::RoughDielectric(it) => (Self::RoughDielectric(RoughDielectricMaterial::new(it)?), Sides::Own),
            BsdfDescription::Plastic(it) => (Self::Plastic(PlasticMaterial::new(it)), Sides::of_opaque(it.one_sided)),
        })
    }

    fn at(&self, point: &TexturePoint) -> Lobe {
        match self {
            Self::Diffuse(it) => Lobe::Diffuse(it.at(point)),
            Self::Mirror(it) => Lobe::Mirror(it.at(point)),
            Self::Dielectric(it) => Lobe::Dielectric(it.at(point)),
            Self::Conductor(it) => Lobe::Conductor(it.at(point)),
            Self::RoughConductor(it) => Lobe::RoughConductor(it.at(point)),
            Self::RoughDielectric(it) => Lobe::RoughDielectric(it.at(point)),
            Self::Plastic(it) => Lobe::Plastic(it.at(point)),
        }
    }

    fn is_constant(&self) -> bool {
        match self {
            Self::Diffuse(it) => it.is_constant(),
            Self::Mirror(it) => it.is_constant(),
            Self::Dielectric(it) => it.is_constant(),
            Self::Conductor(it) => it.is_constant(),
            Self::RoughConductor(it) => it.is_constant(),
            Self::RoughDielectric(it) => it.is_constant(),
            Self::Plastic(it) => it.is_constant(),
        }
    }
}

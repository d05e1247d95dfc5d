//! The BSDF of a shape as a scene holds it: checked, and with textures for parameters.

use crate::render::bsdf::conductor::ConductorMaterial;
use crate::render::bsdf::dielectric::DielectricMaterial;
use crate::render::bsdf::diffuse::DiffuseMaterial;
use crate::render::bsdf::mirror::MirrorMaterial;
use crate::render::bsdf::plastic::PlasticMaterial;
use crate::render::bsdf::rough_conductor::RoughConductorMaterial;
use crate::render::bsdf::rough_dielectric::RoughDielectricMaterial;
use crate::render::bsdf::{Bsdf, BsdfDescription, BsdfError, DirectionSampling, Lobe, Sides};
use crate::render::ray::Surface;
use crate::render::texture::TexturePoint;
use crate::render::texture::parameter::{Pictures, Unread};

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
    /// Checks a description, of which no files are read; `directions` says how directions are drawn where the BSDF leaves a choice.
    pub fn new(description: &BsdfDescription, directions: DirectionSampling) -> Result<Self, BsdfError> {
        Self::with_pictures(description, directions, &Unread)
    }

    /// Checks a description whose textures have those pictures.
    pub fn with_pictures(
        description: &BsdfDescription,
        directions: DirectionSampling,
        pictures: &dyn Pictures,
    ) -> Result<Self, BsdfError> {
        let (kind, sides) = MaterialKind::new(description, pictures)?;
        let material = Self { kind, sides, directions, constant: None };
        let constant = material.kind.is_constant().then(|| material.at(&TexturePoint::ANYWHERE));
        Ok(Self { constant, ..material })
    }

    /// What it is at that point of a surface.
    #[inline]
    pub fn on(&self, surface: &Surface) -> Bsdf {
        self.constant.unwrap_or_else(|| self.at(&TexturePoint::of(surface)))
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
    fn new(description: &BsdfDescription, pictures: &dyn Pictures) -> Result<(Self, Sides), BsdfError> {
        Ok(match description {
            BsdfDescription::Diffuse(it) => (Self::Diffuse(DiffuseMaterial::new(it, pictures)?), Sides::of_opaque(it.one_sided)),
            BsdfDescription::Mirror(it) => (Self::Mirror(MirrorMaterial::new(it, pictures)?), Sides::of_opaque(it.one_sided)),
            BsdfDescription::Dielectric(it) => (Self::Dielectric(DielectricMaterial::new(it, pictures)?), Sides::Own),
            BsdfDescription::Conductor(it) => (Self::Conductor(ConductorMaterial::new(it, pictures)?), Sides::of_opaque(it.one_sided)),
            BsdfDescription::RoughConductor(it) => (Self::RoughConductor(RoughConductorMaterial::new(it, pictures)?), Sides::of_opaque(it.one_sided)),
            BsdfDescription::RoughDielectric(it) => (Self::RoughDielectric(RoughDielectricMaterial::new(it, pictures)?), Sides::Own),
            BsdfDescription::Plastic(it) => (Self::Plastic(PlasticMaterial::new(it, pictures)?), Sides::of_opaque(it.one_sided)),
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

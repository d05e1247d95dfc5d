//! The BSDF of a shape as a scene holds it: checked, and with textures for parameters.

use crate::render::bsdf::blend::BlendMaterial;
use crate::render::bsdf::conductor::ConductorMaterial;
use crate::render::bsdf::dielectric::DielectricMaterial;
use crate::render::bsdf::diffuse::DiffuseMaterial;
use crate::render::bsdf::disney::DisneyMaterial;
use crate::render::bsdf::mirror::MirrorMaterial;
use crate::render::bsdf::perturbed::PerturbedMaterial;
use crate::render::bsdf::plastic::PlasticMaterial;
use crate::render::bsdf::rough_conductor::RoughConductorMaterial;
use crate::render::bsdf::rough_dielectric::RoughDielectricMaterial;
use crate::render::bsdf::{Bsdf, BsdfDescription, BsdfError, DirectionSampling, Lobe, Sides};
use crate::render::ray::Surface;
use crate::render::texture::TexturePoint;
use crate::render::texture::parameter::{Pictures, Unread};

/// The BSDF of a shape: ask it at a hit for the [`Bsdf`] there.
#[derive(Debug, Clone, PartialEq)]
#[expect(clippy::large_enum_variant, reason = "a scene has few, and most are of the large variants")]
pub enum Material {
    /// One lobe.
    Single(SingleMaterial),
    /// Another material, its normals bent.
    Perturbed(PerturbedMaterial),
    /// Two materials, mixed.
    Blend(BlendMaterial),
}

/// A material of one lobe.
#[derive(Debug, Clone, PartialEq)]
pub struct SingleMaterial {
    kind: SingleKind,
    sides: Sides,
    directions: DirectionSampling,
    /// What it is everywhere, if no parameter varies.
    constant: Option<Bsdf<'static>>,
}

#[derive(Debug, Clone, PartialEq)]
enum SingleKind {
    Diffuse(DiffuseMaterial),
    Mirror(MirrorMaterial),
    Dielectric(DielectricMaterial),
    Conductor(ConductorMaterial),
    RoughConductor(RoughConductorMaterial),
    RoughDielectric(RoughDielectricMaterial),
    Plastic(PlasticMaterial),
    Disney(DisneyMaterial),
}

impl Material {
    /// Checks a description, of which no files are read; `directions` says how directions are drawn where the BSDF leaves a choice.
    pub fn new(description: &BsdfDescription, directions: DirectionSampling) -> Result<Self, BsdfError> {
        Self::with_pictures(description, directions, &Unread)
    }

    /// Checks a description whose textures have those pictures.
    pub fn with_pictures(description: &BsdfDescription, directions: DirectionSampling, pictures: &dyn Pictures) -> Result<Self, BsdfError> {
        use SingleKind as Kind;
        let opaque = Sides::of_opaque;
        let (kind, sides) = match description {
            BsdfDescription::Diffuse(it) => (Kind::Diffuse(DiffuseMaterial::new(it, pictures)?), opaque(it.one_sided)),
            BsdfDescription::Mirror(it) => (Kind::Mirror(MirrorMaterial::new(it, pictures)?), opaque(it.one_sided)),
            BsdfDescription::Dielectric(it) => (Kind::Dielectric(DielectricMaterial::new(it, pictures)?), Sides::Own),
            BsdfDescription::Conductor(it) => (Kind::Conductor(ConductorMaterial::new(it, pictures)?), opaque(it.one_sided)),
            BsdfDescription::RoughConductor(it) => (Kind::RoughConductor(RoughConductorMaterial::new(it, pictures)?), opaque(it.one_sided)),
            BsdfDescription::RoughDielectric(it) => (Kind::RoughDielectric(RoughDielectricMaterial::new(it, pictures)?), Sides::Own),
            BsdfDescription::Plastic(it) => (Kind::Plastic(PlasticMaterial::new(it, pictures)?), opaque(it.one_sided)),
            BsdfDescription::Disney(it) => (Kind::Disney(DisneyMaterial::new(it, pictures)?), opaque(it.one_sided)),
            BsdfDescription::NormalMap(it) => return PerturbedMaterial::normal_map(it, directions, pictures).map(Self::Perturbed),
            BsdfDescription::BumpMap(it) => return PerturbedMaterial::bump_map(it, directions, pictures).map(Self::Perturbed),
            BsdfDescription::Blend(it) => return BlendMaterial::new(it, directions, pictures).map(Self::Blend),
        };
        Ok(Self::Single(SingleMaterial::new(kind, sides, directions)))
    }

    /// What it is at that point of a surface.
    #[inline]
    pub fn on(&self, surface: &Surface) -> Bsdf<'_> {
        match self {
            Self::Single(SingleMaterial { constant: Some(bsdf), .. }) => *bsdf,
            other => other.at(&TexturePoint::of(surface)),
        }
    }

    /// What it is at that point.
    pub fn at(&self, point: &TexturePoint) -> Bsdf<'_> {
        match self {
            Self::Single(it) => it.at(point),
            Self::Perturbed(it) => it.at(point),
            Self::Blend(it) => Bsdf::new(Lobe::Blend(it.at(point)), Sides::Own, DirectionSampling::Bsdf),
        }
    }

    /// Whether light passes through.
    pub fn is_transmissive(&self) -> bool {
        match self {
            Self::Single(it) => it.sides == Sides::Own,
            Self::Perturbed(it) => it.is_transmissive(),
            Self::Blend(it) => it.is_transmissive(),
        }
    }
}

impl SingleMaterial {
    fn new(kind: SingleKind, sides: Sides, directions: DirectionSampling) -> Self {
        let varying = Self { kind, sides, directions, constant: None };
        let constant = varying.kind.is_constant().then(|| varying.at(&TexturePoint::ANYWHERE));
        Self { constant, ..varying }
    }

    fn at(&self, point: &TexturePoint) -> Bsdf<'static> {
        self.constant.unwrap_or_else(|| Bsdf::new(self.kind.at(point), self.sides, self.directions))
    }
}

impl SingleKind {
    fn at(&self, point: &TexturePoint) -> Lobe<'static> {
        match self {
            Self::Diffuse(it) => Lobe::Diffuse(it.at(point)),
            Self::Mirror(it) => Lobe::Mirror(it.at(point)),
            Self::Dielectric(it) => Lobe::Dielectric(it.at(point)),
            Self::Conductor(it) => Lobe::Conductor(it.at(point)),
            Self::RoughConductor(it) => Lobe::RoughConductor(it.at(point)),
            Self::RoughDielectric(it) => Lobe::RoughDielectric(it.at(point)),
            Self::Plastic(it) => Lobe::Plastic(it.at(point)),
            Self::Disney(it) => Lobe::Disney(it.at(point)),
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
            Self::Disney(it) => it.is_constant(),
        }
    }
}

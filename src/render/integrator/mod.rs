//! How radiance along a camera ray is estimated: one file per kind.
//!
//! `path` does the work of `direct` too, which is a path of one scattering. Everything a sample needs beyond the
//! scene are its numbers, so any sample of any pixel can be computed by itself.

pub mod normals;
pub mod path;
pub mod volume_path;

use std::num::NonZeroU32;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::render::bsdf::DirectionSampling;
use crate::render::emitter::environment::Density;
use crate::render::integrator::path::Transporter;
use crate::render::integrator::volume_path::VolumePathParameters;
use crate::render::medium::Tracking;

/// How radiance is estimated.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum IntegratorDescription {
    /// Shading normals as colors, (n + 1) / 2; black where there is no surface.
    Normals(NormalsParameters),
    /// Light that reaches the camera after one scattering at most, besides that of emitters seen directly.
    Direct(DirectParameters),
    /// All light, along paths of any length (Kajiya 1986; multiple importance sampling of Veach and Guibas 1995).
    Path(PathParameters),
    /// The same through media that scatter light on its way (`medium` of a shape).
    VolumePath(VolumePathParameters),
}

impl Default for IntegratorDescription {
    fn default() -> Self {
        Self::Path(PathParameters::default())
    }
}

/// Shading normals as colors.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct NormalsParameters {}

/// Light after one scattering.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DirectParameters {
    /// Which directions are tried at a surface. Default `mis`.
    #[serde(default)]
    pub strategy: Strategy,
    /// How directions towards the environment are drawn. Default `importance`.
    #[serde(default)]
    pub environment: EnvironmentSampling,
    /// Whether the environment's density leaves to scattering what scattering finds well enough (Karlik et al. 2019);
    /// used with `strategy: mis` and `environment: importance` alone. Default true.
    #[serde(default = "yes")]
    pub mis_compensation: bool,
    /// How a surface draws directions. Default `bsdf`.
    #[serde(default)]
    pub bsdf_sampling: DirectionSampling,
    /// Directions towards emitters at each surface that a camera ray hits. Default 1.
    #[serde(default = "one")]
    #[schemars(range(min = 1, max = 4096))]
    pub emitter_samples: u32,
    /// Directions towards emitters among which each of these is chosen, by what it would bring if nothing hid it
    /// (resampled importance sampling, Talbot et al. 2005): less noise for little time, since the others need no
    /// shadow ray. Default 4 under a map with `strategy: mis` and `environment: importance`, else 1.
    #[serde(default)]
    #[schemars(range(min = 1, max = 64))]
    pub emitter_candidates: Option<NonZeroU32>,
}

/// Light along paths of any length.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PathParameters {
    /// Most scatterings of a path: 0 shows emitters alone, 1 adds direct light. Light beyond is lost. Default 16.
    #[serde(default = "max_depth")]
    #[schemars(range(min = 0, max = 1_000_000))]
    pub max_depth: u32,
    /// Scatterings after which a path may end by chance, which loses nothing on average. Default 3.
    #[serde(default = "roulette_depth")]
    #[schemars(range(min = 0, max = 1_000_000))]
    pub roulette_depth: u32,
    /// Which directions are tried at a surface. Default `mis`.
    #[serde(default)]
    pub strategy: Strategy,
    /// How directions towards the environment are drawn. Default `importance`.
    #[serde(default)]
    pub environment: EnvironmentSampling,
    /// Whether the environment's density leaves to scattering what scattering finds well enough (Karlik et al. 2019);
    /// used with `strategy: mis` and `environment: importance` alone. Default true.
    #[serde(default = "yes")]
    pub mis_compensation: bool,
    /// How a surface draws directions. Default `bsdf`.
    #[serde(default)]
    pub bsdf_sampling: DirectionSampling,
    /// Directions towards emitters at a surface, one of which is chosen by what it would bring if nothing hid it
    /// (resampled importance sampling, Talbot et al. 2005): less noise for little time, since the others need no
    /// shadow ray. Default 4 under a map with `strategy: mis` and `environment: importance`, else 1.
    #[serde(default)]
    #[schemars(range(min = 1, max = 64))]
    pub emitter_candidates: Option<NonZeroU32>,
    /// Largest channel of what a path adds after its first scattering; more is scaled down. Loses light: biased.
    /// Default none.
    #[serde(default)]
    #[schemars(range(max = 1e9), extend("exclusiveMinimum" = 0))]
    pub clamp_indirect: Option<f32>,
}

/// Which directions are tried at a surface to find light.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Strategy {
    /// Those of emitters alone; mirrors and glass still find light by scattering.
    Emitter,
    /// Those of scattering alone. Points and parallel light, which it never hits, are drawn all the same.
    Bsdf,
    /// Both, each weighted by the power heuristic.
    #[default]
    Mis,
}

/// How directions towards the environment are drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum EnvironmentSampling {
    /// All directions alike.
    Uniform,
    /// In proportion to luminance.
    #[default]
    Importance,
}

fn yes() -> bool {
    true
}

fn one() -> u32 {
    1
}

fn max_depth() -> u32 {
    16
}

fn roulette_depth() -> u32 {
    3
}

impl DirectParameters {
    /// Paths of one scattering.
    fn path(&self) -> PathParameters {
        let &Self { strategy, environment, mis_compensation, bsdf_sampling, emitter_candidates, emitter_samples: _ } = self;
        PathParameters {
            max_depth: 1,
            roulette_depth: u32::MAX,
            strategy,
            environment,
            mis_compensation,
            bsdf_sampling,
            emitter_candidates,
            clamp_indirect: None,
        }
    }
}

impl Default for DirectParameters {
    fn default() -> Self {
        Self {
            strategy: Strategy::default(),
            environment: EnvironmentSampling::default(),
            mis_compensation: true,
            bsdf_sampling: DirectionSampling::default(),
            emitter_samples: 1,
            emitter_candidates: None,
        }
    }
}

impl Default for PathParameters {
    fn default() -> Self {
        Self {
            max_depth: max_depth(),
            roulette_depth: roulette_depth(),
            strategy: Strategy::default(),
            environment: EnvironmentSampling::default(),
            mis_compensation: true,
            bsdf_sampling: DirectionSampling::default(),
            emitter_candidates: None,
            clamp_indirect: None,
        }
    }
}

/// An integrator of a scene.
#[derive(Debug, Clone, Copy)]
pub enum Integrator {
    /// Normals as colors.
    Normals,
    /// Surfaces alone.
    Path(Transporter),
    /// Surfaces and media.
    VolumePath(Transporter),
}

impl IntegratorDescription {
    /// Its paths, if it has any: those of `direct` scatter once.
    fn paths(&self) -> Option<PathParameters> {
        match self {
            Self::Normals(_) => None,
            Self::Direct(kind) => Some(kind.path()),
            Self::Path(kind) => Some(*kind),
            Self::VolumePath(kind) => Some(kind.path()),
        }
    }

    /// Ready to trace a scene with or without a map around it.
    pub fn compiled(&self, has_map: bool) -> Integrator {
        let Some(paths) = self.paths() else { return Integrator::Normals };
        let transporter = Transporter {
            max_depth: paths.max_depth,
            roulette_depth: paths.roulette_depth,
            strategy: paths.strategy,
            emitter_samples: if let Self::Direct(kind) = self { kind.emitter_samples } else { 1 },
            emitter_candidates: candidates(paths.emitter_candidates, paths.environment, paths.strategy, has_map),
            clamp_indirect: paths.clamp_indirect.unwrap_or(f32::INFINITY),
        };
        if self.follows_media() { Integrator::VolumePath(transporter) } else { Integrator::Path(transporter) }
    }

    /// Whether media in the scene are seen.
    pub fn follows_media(&self) -> bool {
        matches!(self, Self::VolumePath(_))
    }

    /// How media are followed.
    pub fn tracking(&self) -> Tracking {
        match self {
            Self::VolumePath(kind) => kind.tracking,
            _ => Tracking::default(),
        }
    }

    /// The density by which directions towards the environment are drawn, where there is one.
    pub fn environment_density(&self) -> Density {
        // Without paths no directions are drawn.
        let Some(paths) = self.paths() else { return Density::Uniform };
        match (paths.environment, paths.strategy) {
            (EnvironmentSampling::Uniform, _) => Density::Uniform,
            // It needs scattering beside it, at every vertex.
            (EnvironmentSampling::Importance, Strategy::Mis) if paths.mis_compensation => Density::Compensated { draws: self.draws() },
            (EnvironmentSampling::Importance, _) => Density::Full,
        }
    }

    /// Draws of lights at a vertex of a scene with a map.
    fn draws(&self) -> u32 {
        match self.compiled(true) {
            Integrator::Normals => 0,
            Integrator::Path(transporter) | Integrator::VolumePath(transporter) => transporter.draws(),
        }
    }

    /// How surfaces draw directions.
    pub fn direction_sampling(&self) -> DirectionSampling {
        self.paths().map_or_else(DirectionSampling::default, |paths| paths.bsdf_sampling)
    }

    /// What the manifest must say of it.
    pub fn caveats(&self) -> Vec<String> {
        let clamp = self.paths().and_then(|paths| paths.clamp_indirect);
        let said = |clamp| format!("`clamp_indirect: {clamp}` is biased: it loses the light of indirect paths beyond that");
        let mut caveats: Vec<String> = clamp.map(said).into_iter().collect();
        if self.tracking() == Tracking::SquaredDensity {
            let what = "light is scattered by the square of the density; right where that is 0 or 1 alone";
            caveats.push(format!("`tracking: squared-density` (fourth report) is biased: {what}"));
        }
        caveats
    }
}

/// Several where light is looked for as well as can be; one where ways to look for it are compared, and where no map
/// is: candidates under a lamp lower the noise by nothing and take half as long again.
fn candidates(written: Option<NonZeroU32>, environment: EnvironmentSampling, strategy: Strategy, has_map: bool) -> u32 {
    let pays = environment == EnvironmentSampling::Importance && strategy == Strategy::Mis && has_map;
    written.map_or(if pays { 4 } else { 1 }, NonZeroU32::get)
}

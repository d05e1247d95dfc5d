//! What fills a shape and scatters light on its way: one file per kind.
//!
//! Extinction is grey, sigma_t times a density that may vary; color comes from the albedo, the share of a collision that
//! is scattered on. So one distance serves all three channels, and the weight of a collision is the albedo alone.
//! [`media`] knows which medium a ray is in; what happens on a stretch within one is here: a distance is drawn either
//! from the closed form of the optical depth or by collisions with a majorant, most of which do nothing (delta tracking,
//! Woodcock et al. 1965), and light that passes is counted likewise (ratio tracking, Novák, Selle, Jarosz 2014).
//!
//! Reading order: `phase`, this file, `exponential`, `grid`, `media`. A new kind is a file and its rows in
//! [`MediumDescription`] and [`Density`].

pub mod exponential;
pub mod grid;
pub mod homogeneous;
#[cfg(test)]
mod laws;
pub mod media;
pub mod phase;

use std::sync::Arc;

use glam::{DAffine3, Vec3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::math::elementary;
use crate::render::medium::exponential::{Exponential, ExponentialParameters};
use crate::render::medium::grid::{Grid, GridError, GridParameters, Voxels};
use crate::render::medium::homogeneous::HomogeneousParameters;
use crate::render::medium::phase::{Phase, PhaseDescription};
use crate::render::ray::Ray;
use crate::render::sampler::Further;
use crate::render::scene_file::SceneFile;
use crate::render::shape::bvh::Bounds;
use crate::render::texture::value::{Color, Limits, Number, Share, Value};

/// What fills a shape.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum MediumDescription {
    /// The same everywhere.
    Homogeneous(HomogeneousParameters),
    /// Fog that thins out with height.
    Exponential(ExponentialParameters),
    /// Densities on a grid.
    Grid(GridParameters),
}

impl MediumDescription {
    /// Its name in the text.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Homogeneous(_) => "homogeneous",
            Self::Exponential(_) => "exponential",
            Self::Grid(_) => "grid",
        }
    }

    /// The file that it names.
    pub fn file(&self) -> Option<&SceneFile> {
        match self {
            Self::Homogeneous(_) | Self::Exponential(_) => None,
            Self::Grid(grid) => grid.path.as_ref(),
        }
    }

    /// The parameter that cannot be used with the others, and why.
    pub fn contradiction(&self) -> Option<(&'static str, String)> {
        match self {
            Self::Homogeneous(_) => None,
            Self::Exponential(fog) => fog.contradiction(),
            Self::Grid(grid) => grid.contradiction(),
        }
    }
}

/// What is wrong with a medium beyond what its schema says.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum MediumError {
    /// Voxels that are none.
    #[error(transparent)]
    Grid(#[from] GridError),
    /// Densities that a tracking cannot use.
    #[error("`tracking: squared-density` needs densities from 0 to 1, and the greatest is {0}")]
    Dense(f64),
    /// A medium in which every ray would collide without end.
    #[error("a ray through it meets about {0:.0} collisions, over the limit of {STEP_LIMIT}: lower `sigma_t` or the densities")]
    Thick(f64),
}

/// How strongly a medium takes light out of a ray: from 0 to 1e6.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Extinction;

impl Limits for Extinction {
    const NAME: &'static str = "Extinction";
    const MINIMUM: f64 = 0.0;
    const MAXIMUM: f64 = 1e6;
}

/// How distances are drawn and light that passes is counted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Tracking {
    /// By the closed form of the optical depth where the medium has one (`homogeneous`, `exponential`), else `delta`.
    #[default]
    ClosedForm,
    /// By delta tracking with the greatest density as majorant; light that passes by ratio tracking.
    Delta,
    /// As the fourth report does: as `delta`, but with the density once more as a factor of each collision, as if
    /// light were scattered by its square. Biased, and for densities from 0 to 1 alone.
    SquaredDensity,
}

/// A medium of a scene.
#[derive(Debug, Clone, PartialEq)]
pub struct Medium {
    /// Extinction per unit of length where the density is 1.
    sigma_t: f64,
    /// Share of a collision that is scattered on.
    albedo: Vec3,
    phase: Phase,
    density: Density,
}

/// How much of a medium there is, as a factor of its extinction.
#[derive(Debug, Clone, PartialEq)]
enum Density {
    Homogeneous,
    Exponential(Exponential),
    Grid(Grid),
}

/// A shape as far as what fills it has to know it.
#[derive(Debug, Clone, Copy)]
pub struct Place {
    /// The box around it in the world.
    pub bounds: Bounds,
    /// From the cube [-1, 1]³ to the box around it in its own coordinates, and on to the world.
    pub to_world: DAffine3,
}

/// A collision on a stretch of a ray, or what is left of the optical depth that was to be passed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Flight {
    /// Nothing happened.
    Passed {
        /// Optical depth that is left to pass until the next collision.
        left: f64,
    },
    /// It collided.
    Collided {
        /// Distance from the origin of the ray.
        distance: f64,
        /// What is left of the light that is scattered.
        weight: Vec3,
    },
}

/// The beginning and the end of a stretch of a ray, as distances from its origin.
pub type Stretch = [f64; 2];

/// Most collisions with the majorant on the way through a medium, on average.
const STEP_LIMIT: f64 = 1e5;

/// Below this share of light that passes, ratio tracking goes on by chance.
const ROULETTE_SHARE: f64 = 0.1;

impl Medium {
    /// What fills a shape, with the voxels that its file holds, if it names one.
    pub fn new(description: &MediumDescription, place: &Place, voxels: Option<Voxels>) -> Result<Self, MediumError> {
        let (sigma_t, albedo, phase, density) = match description {
            MediumDescription::Homogeneous(it) => (it.sigma_t, it.albedo, it.phase, Density::Homogeneous),
            MediumDescription::Exponential(it) => {
                (it.sigma_t, it.albedo, it.phase, Density::Exponential(Exponential::new(it, &place.bounds)))
            }
            MediumDescription::Grid(it) => {
                let voxels = voxels.map(Ok).or_else(|| it.own_voxels()).unwrap_or(Err(GridError::Missing))?;
                (it.sigma_t, it.albedo, it.phase, Density::Grid(Grid::new(Arc::new(voxels), place)))
            }
        };
        Ok(Self { sigma_t: sigma_t.value(), albedo: albedo.inner(), phase: phase.compiled(), density })
    }

    /// The same, if `tracking` can be used in it.
    pub fn checked(self, place: &Place, tracking: Tracking) -> Result<Self, MediumError> {
        let peak = self.peak();
        if tracking == Tracking::SquaredDensity && peak > 1.0 {
            return Err(MediumError::Dense(peak));
        }
        let across = f64::from((place.bounds.max - place.bounds.min).length());
        let steps = self.sigma_t * peak * across;
        if !self.has_closed_form(tracking) && steps > STEP_LIMIT {
            return Err(MediumError::Thick(steps));
        }
        Ok(self)
    }

    /// How it scatters.
    pub fn phase(&self) -> &Phase {
        &self.phase
    }

    /// Whether light passes as if there were nothing.
    pub fn is_void(&self) -> bool {
        self.sigma_t == 0.0
    }

    /// The greatest density on a stretch of a ray.
    fn greatest_density(&self, ray: &Ray, stretch: Stretch) -> f64 {
        match &self.density {
            Density::Homogeneous => 1.0,
            Density::Exponential(fog) => fog.greatest(ray, stretch),
            Density::Grid(grid) => grid.greatest(),
        }
    }

    /// The greatest density anywhere in the shape.
    pub fn peak(&self) -> f64 {
        match &self.density {
            Density::Homogeneous => 1.0,
            Density::Exponential(fog) => fog.floor_density(),
            Density::Grid(grid) => grid.greatest(),
        }
    }

    /// The density at a point of a ray.
    #[inline]
    fn density(&self, ray: &Ray, distance: f64) -> f64 {
        match &self.density {
            Density::Homogeneous => 1.0,
            Density::Exponential(fog) => fog.at(ray, distance),
            Density::Grid(grid) => grid.at(ray, distance),
        }
    }

    /// The optical depth of a stretch, if it has a closed form.
    pub fn optical_depth(&self, ray: &Ray, stretch: Stretch) -> Option<f64> {
        match &self.density {
            Density::Homogeneous => Some(self.sigma_t * (stretch[1] - stretch[0])),
            Density::Exponential(fog) => Some(self.sigma_t * fog.integral(ray, stretch)),
            Density::Grid(_) => None,
        }
    }

    /// The distance at which an optical depth is reached, counted from the beginning of a stretch that has more of it.
    fn distance_of(&self, ray: &Ray, stretch: Stretch, optical_depth: f64) -> f64 {
        match &self.density {
            Density::Exponential(fog) => stretch[0] + fog.length_of(ray, stretch[0], optical_depth / self.sigma_t),
            _ => stretch[0] + optical_depth / self.sigma_t,
        }
    }

    /// Whether optical depths are computed, rather than estimated by tracking.
    fn has_closed_form(&self, tracking: Tracking) -> bool {
        tracking == Tracking::ClosedForm && !matches!(self.density, Density::Grid(_))
    }

    /// Follows a stretch of a ray of which `left` is the optical depth until the next collision, drawn from e^-x.
    pub fn fly(&self, ray: &Ray, stretch: Stretch, left: f64, tracking: Tracking, further: &mut Further) -> Flight {
        if self.is_void() {
            return Flight::Passed { left };
        }
        if !self.has_closed_form(tracking) {
            return self.track(ray, stretch, left, tracking, further);
        }
        let whole = self.optical_depth(ray, stretch).unwrap_or(0.0);
        if left >= whole {
            return Flight::Passed { left: left - whole };
        }
        let distance = self.distance_of(ray, stretch, left).clamp(stretch[0], stretch[1]);
        Flight::Collided { distance, weight: self.albedo }
    }

    /// Delta tracking: collisions with the majorant, each of which is one with the medium by the ratio of densities.
    fn track(&self, ray: &Ray, stretch: Stretch, mut left: f64, tracking: Tracking, further: &mut Further) -> Flight {
        let majorant = self.greatest_density(ray, stretch);
        let extinction = self.sigma_t * majorant;
        if extinction <= 0.0 {
            return Flight::Passed { left };
        }
        let mut distance = stretch[0];
        loop {
            let step = left / extinction;
            if step >= stretch[1] - distance {
                return Flight::Passed { left: left - extinction * (stretch[1] - distance) };
            }
            distance += step;
            let density = self.density(ray, distance);
            if further.uniform() * majorant < density {
                let factor = if tracking == Tracking::SquaredDensity { density } else { 1.0 };
                return Flight::Collided { distance, weight: self.albedo * factor as f32 };
            }
            left = exponential_variate(further.uniform());
        }
    }

    /// The share of light that passes a stretch of a ray: exact, or an estimate from 0 to 1.
    pub fn transmittance(&self, ray: &Ray, stretch: Stretch, tracking: Tracking, further: &mut Further) -> f64 {
        if self.is_void() {
            return 1.0;
        }
        if self.has_closed_form(tracking) {
            return elementary::exp(-self.optical_depth(ray, stretch).unwrap_or(0.0));
        }
        let majorant = self.greatest_density(ray, stretch);
        let extinction = self.sigma_t * majorant;
        if extinction <= 0.0 {
            return 1.0;
        }
        let (mut distance, mut share) = (stretch[0], 1.0);
        loop {
            distance += exponential_variate(further.uniform()) / extinction;
            if distance >= stretch[1] {
                return share;
            }
            share *= 1.0 - self.density(ray, distance) / majorant;
            if share < ROULETTE_SHARE {
                if further.uniform() * ROULETTE_SHARE >= share {
                    return 0.0;
                }
                share = ROULETTE_SHARE;
            }
        }
    }
}

/// An optical depth with the density e^-x, for a number from [0, 1).
#[inline]
pub fn exponential_variate(u: f64) -> f64 {
    -elementary::ln_1p(-u)
}

/// A white medium: nothing is absorbed.
fn white() -> Color<Share> {
    Color::grey(1.0).expect("all of the light")
}

/// One collision per unit of length.
fn unit_extinction() -> Number<Extinction> {
    Number::new(1.0).expect("1 is between 0 and 1e6")
}

/// Scattering alike to all sides.
fn isotropic() -> PhaseDescription {
    PhaseDescription::default()
}

//! Paths from the camera through media: as `path`, with vertices in the air as well as on surfaces.
//!
//! Where a medium scatters, light is looked for in the same two ways as on a surface, with the same weights: by drawing
//! lights, whose light comes through with the transmittance, and by drawing a direction from the phase function. All
//! numbers of surfaces are those of `path`, so that without media both give the same bits.
//!
//! After Pharr, Jakob, Humphreys, "Physically Based Rendering", 4th edition, section 14.2 (2023).

use glam::Vec3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::num::NonZeroU32;

use crate::render::bsdf::shading::Shading;
use crate::render::bsdf::{DirectionSampling, Transport};
use crate::render::emitter::lights::LightSample;
use crate::render::film::Background;
use crate::render::integrator::path::{
    CAMERA_SETS, CHOICE_SET, DIRECTION_SET, FirstHit, OnSurface, Origin, Transporter, VERTEX_SETS, Vertex,
};
use crate::render::integrator::{EnvironmentSampling, PathParameters, Strategy, max_depth, roulette_depth, yes};
use crate::render::medium::Tracking;
use crate::render::medium::media::Collision;
use crate::render::ray::Ray;
use crate::render::sampler::{Numbers, unit};
use crate::render::scene::compiled::Scene;

/// Light along paths of any length, through media too.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct VolumePathParameters {
    /// Most scatterings of a path, on surfaces and in media: 0 shows emitters alone, 1 adds direct light. Light beyond
    /// is lost. Default 16.
    #[serde(default = "max_depth")]
    #[schemars(range(min = 0, max = 1_000_000))]
    pub max_depth: u32,
    /// Scatterings after which a path may end by chance, which loses nothing on average. Default 3.
    #[serde(default = "roulette_depth")]
    #[schemars(range(min = 0, max = 1_000_000))]
    pub roulette_depth: u32,
    /// Which directions are tried where light is scattered. Default `mis`.
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
    /// Directions towards emitters, one of which is chosen by what it would bring if nothing hid it (resampled
    /// importance sampling, Talbot et al. 2005). Default 4 with `strategy: mis` and `environment: importance`, else 1.
    #[serde(default)]
    #[schemars(range(min = 1, max = 64))]
    pub emitter_candidates: Option<NonZeroU32>,
    /// How distances in media are drawn, and light that passes is counted. Default `closed-form`.
    #[serde(default)]
    pub tracking: Tracking,
    /// Largest channel of what a path adds after its first scattering; more is scaled down. Loses light: biased.
    /// Default none.
    #[serde(default)]
    #[schemars(range(max = 1e9), extend("exclusiveMinimum" = 0))]
    pub clamp_indirect: Option<f32>,
}

impl VolumePathParameters {
    /// What it has in common with paths between surfaces.
    pub fn path(&self) -> PathParameters {
        PathParameters {
            max_depth: self.max_depth,
            roulette_depth: self.roulette_depth,
            strategy: self.strategy,
            environment: self.environment,
            mis_compensation: self.mis_compensation,
            bsdf_sampling: self.bsdf_sampling,
            emitter_candidates: self.emitter_candidates,
            clamp_indirect: self.clamp_indirect,
        }
    }
}

/// First of the sets, one a vertex, by which distances in media are drawn: far behind those of surfaces.
const FLIGHT_SETS: u32 = 1 << 24;
/// First of the sets, one a vertex, by which light through media is counted.
const SHADOW_SETS: u32 = 1 << 25;
/// First of the sets, one a vertex, of further numbers for distances.
const TRACKING_SETS: u32 = 1 << 26;
/// 2^-32.
const OF_32_BITS: f64 = 1.0 / 4_294_967_296.0;

/// A point in a medium, reached along `way`.
struct InMedium<'a> {
    collision: &'a Collision<'a>,
    way: Vec3,
}

impl Vertex for InMedium<'_> {
    fn position(&self) -> Vec3 {
        self.collision.position
    }

    fn evaluate_with_pdf(&self, direction: Vec3) -> (Vec3, f32) {
        let value = self.collision.phase.value(self.way, direction);
        (Vec3::splat(value), value)
    }

    fn shadow_ray(&self, light: &LightSample) -> Option<Ray> {
        light.shadow_ray_from(self.collision.position)
    }
}

/// What a path has gathered, and where it goes on.
struct Path {
    ray: Ray,
    origin: Origin,
    radiance: Vec3,
    throughput: Vec3,
    eta_squared: f32,
}

impl Transporter {
    /// Radiance along a camera ray, and which surface it would see first without media.
    pub fn radiance_through_media(&self, scene: &Scene, camera_ray: Ray, numbers: &Numbers<'_>) -> (Vec3, FirstHit) {
        let mut path = Path { ray: camera_ray, origin: Origin::Unique, radiance: Vec3::ZERO, throughput: Vec3::ONE, eta_squared: 1.0 };
        let mut first = FirstHit::default();
        for depth in 0..=self.max_depth {
            if !self.follow(scene, &mut path, &mut first, depth, numbers) {
                break;
            }
        }
        (path.radiance, first)
    }

    /// Goes to the next vertex, adds its light and scatters there; false where the path ends.
    fn follow(&self, scene: &Scene, path: &mut Path, first: &mut FirstHit, depth: u32, numbers: &Numbers<'_>) -> bool {
        let is_last = depth == self.max_depth && depth > 0;
        let hit = scene.geometry.intersect(&path.ray);
        // Of the last ray only the light that it hits counts: nothing is scattered on its way that would be seen.
        if is_last && hit.is_none() {
            let mut further = numbers.further(TRACKING_SETS + depth);
            let passing = scene.media.transmittance(&path.ray, &mut further);
            let light = self.background(scene, path.ray.direction, path.origin) * passing;
            path.radiance += self.limited(path.throughput * light, depth);
            return false;
        }
        let surface = hit.as_ref().map(|hit| (scene.geometry.surface(&path.ray, hit), hit.distance));
        if depth == 0
            && let Some((surface, distance)) = &surface
        {
            let bsdf = scene.material_of(surface.shape).on(surface);
            *first = FirstHit::of(surface, -path.ray.direction, &bsdf, *distance);
        }
        let flight = Ray { reach: hit.map_or(f32::INFINITY, |hit| hit.distance), ..path.ray };
        let u = f64::from(numbers.bits(FLIGHT_SETS + depth)[0]) * OF_32_BITS;
        if let Some(collision) = scene.media.collision(&flight, u, &mut numbers.further(TRACKING_SETS + depth)) {
            return depth < self.max_depth && self.scatter_in_medium(scene, path, &collision, depth, numbers);
        }
        let Some((surface, _)) = surface else {
            if depth > 0 || scene.background == Background::Environment {
                let light = self.background(scene, path.ray.direction, path.origin);
                path.radiance += self.limited(path.throughput * light, depth);
            }
            return false;
        };
        path.radiance += self.limited(path.throughput * self.emission(scene, &path.ray, &surface, path.origin), depth);
        if depth == self.max_depth {
            return false;
        }
        let bsdf = scene.material_of(surface.shape).on(&surface);
        let shading = Shading::new(bsdf, &surface.frame, surface.normal, -path.ray.direction);
        if !bsdf.is_delta() {
            let vertex = OnSurface { surface: &surface, shading: &shading };
            self.add_direct(scene, path, &vertex, depth, numbers);
        }
        let sets = CAMERA_SETS + VERTEX_SETS * depth;
        let choice = numbers.bits(sets + CHOICE_SET);
        let drawn = shading.sample(unit(choice[0]), numbers.pair(sets + DIRECTION_SET), Transport::Radiance);
        let Some(sample) = drawn else { return false };
        path.throughput *= sample.weight;
        path.eta_squared *= sample.eta * sample.eta;
        path.origin = if sample.is_delta { Origin::Unique } else { Origin::Scattered { reference: surface.position, pdf: sample.pdf } };
        path.ray = surface.spawn(sample.direction);
        self.goes_on(path, depth, unit(choice[1]))
    }

    fn scatter_in_medium(&self, scene: &Scene, path: &mut Path, collision: &Collision<'_>, depth: u32, numbers: &Numbers<'_>) -> bool {
        path.throughput *= collision.weight;
        if path.throughput == Vec3::ZERO {
            return false;
        }
        let way = path.ray.direction;
        self.add_direct(scene, path, &InMedium { collision, way }, depth, numbers);
        let sets = CAMERA_SETS + VERTEX_SETS * depth;
        // Density and value are the same, so the weight is one.
        let direction = collision.phase.sample(way, numbers.pair(sets + DIRECTION_SET));
        path.origin = Origin::Scattered { reference: collision.position, pdf: collision.phase.value(way, direction) };
        path.ray = Ray::new(collision.position, direction);
        self.goes_on(path, depth, unit(numbers.bits(sets + CHOICE_SET)[1]))
    }

    /// Adds light by drawing lights from a vertex, as far as it comes through.
    fn add_direct(&self, scene: &Scene, path: &mut Path, vertex: &impl Vertex, depth: u32, numbers: &Numbers<'_>) {
        let mut further = numbers.further(SHADOW_SETS + depth);
        let visible = |ray: &Ray| {
            if scene.geometry.is_occluded(ray) {
                return None;
            }
            let share = scene.media.transmittance(ray, &mut further);
            (share > 0.0).then_some(share)
        };
        let direct = self.direct(scene, vertex, numbers, CAMERA_SETS + VERTEX_SETS * depth, visible);
        path.radiance += self.limited(path.throughput * direct, depth + 1);
    }

    /// Russian roulette; false where the path ends.
    fn goes_on(&self, path: &mut Path, depth: u32, choice: f32) -> bool {
        if depth >= self.roulette_depth {
            let survival = (path.throughput.max_element() * path.eta_squared).min(0.95);
            if choice >= survival {
                return false;
            }
            path.throughput /= survival;
        }
        path.throughput != Vec3::ZERO
    }
}

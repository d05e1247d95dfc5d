//! Paths from the camera: light found at every vertex both by drawing lights and by scattering.
//!
//! A vertex draws from three sets of numbers: the light and the point on it, the direction of scattering, and the
//! lobe with the roulette. Weights are the power heuristic in solid angle (Veach and Guibas 1995). The last allowed
//! vertex still traces its scattered ray for emission, so both ways of finding light are there at every vertex;
//! which is what a compensated density of the environment needs.
//!
//! Of several candidates towards lights one is chosen by what it would bring if nothing hid it, and only that one is
//! tested for shadow: resampled importance sampling after Talbot, Cline, Egbert, "Importance resampling for global
//! illumination" (EGSR 2005). Its estimate, the candidates' mean times the visibility of the chosen one, has the
//! right mean for any weights of multiple importance sampling that sum to one at each direction; they count
//! the candidates as so many draws.

use glam::Vec3;

use crate::render::bsdf::shading::Shading;
use crate::render::bsdf::{Bsdf, Transport};
use crate::render::emitter::lights::LightSample;
use crate::render::film::Background;
use crate::render::integrator::Strategy;
use crate::render::ray::{Ray, Surface};
use crate::render::sampler::{Numbers, unit};
use crate::render::scene::compiled::Scene;

/// Numbers of the camera: the place on the film, the place on the lens.
pub const CAMERA_SETS: u32 = 2;
/// Sets of a vertex: the light, the direction of scattering, and choices.
pub(super) const VERTEX_SETS: u32 = 3;
/// The direction of scattering among the sets of a vertex.
pub(super) const DIRECTION_SET: u32 = 1;
/// Choices among the sets of a vertex: the lobe; the light of several, and whether the path goes on.
pub(super) const CHOICE_SET: u32 = 2;
/// The largest number below 1.
const BELOW_ONE: f32 = 1.0 - f32::EPSILON / 2.0;

/// How paths are traced.
#[derive(Debug, Clone, Copy)]
pub struct Transporter {
    /// Most scatterings.
    pub max_depth: u32,
    /// Scatterings after which a path may end by chance.
    pub roulette_depth: u32,
    /// Which directions are tried.
    pub strategy: Strategy,
    /// Lights tested for shadow at a vertex.
    pub emitter_samples: u32,
    /// Draws of which each of these is chosen.
    pub emitter_candidates: u32,
    /// Largest channel of what is added after the first scattering.
    pub clamp_indirect: f32,
}

/// What a camera ray sees first.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct FirstHit {
    /// Whether it sees a surface at all.
    pub is_hit: bool,
    /// Its albedo.
    pub albedo: Vec3,
    /// Its shading normal, towards the camera.
    pub normal: Vec3,
    /// Its distance.
    pub depth: f32,
}

/// Light that may come to a vertex.
#[derive(Debug, Clone, Copy)]
struct Candidate {
    light: LightSample,
    /// What the draw adds if nothing hides it, its weight included.
    brought: Vec3,
}

/// How the ray at hand was found, for the weight of the light that it hits.
#[derive(Debug, Clone, Copy)]
pub(super) enum Origin {
    /// By the camera or by a lobe that no drawing of lights could have found.
    Unique,
    /// By scattering at that point, with that density.
    Scattered { reference: Vec3, pdf: f32 },
}

/// A point that scatters light.
pub(super) trait Vertex {
    /// Where it is.
    fn position(&self) -> Vec3;

    /// What part of the light from a direction is scattered on, and the density of scattering into that direction.
    fn evaluate_with_pdf(&self, direction: Vec3) -> (Vec3, f32);

    /// The ray along which a light may be hidden; `None` where it is at this very point.
    fn shadow_ray(&self, light: &LightSample) -> Option<Ray>;
}

/// A point of a surface, seen from one direction.
pub(super) struct OnSurface<'a> {
    pub surface: &'a Surface,
    pub shading: &'a Shading<'a>,
}

impl Vertex for OnSurface<'_> {
    #[inline]
    fn position(&self) -> Vec3 {
        self.surface.position
    }

    #[inline]
    fn evaluate_with_pdf(&self, direction: Vec3) -> (Vec3, f32) {
        self.shading.evaluate_with_pdf(direction, Transport::Radiance)
    }

    #[inline]
    fn shadow_ray(&self, light: &LightSample) -> Option<Ray> {
        light.shadow_ray(self.surface)
    }
}

impl Transporter {
    /// Paths without scattering, for what the camera sees first.
    pub const EMITTERS_ALONE: Self = Self {
        max_depth: 0,
        roulette_depth: 0,
        strategy: Strategy::Emitter,
        emitter_samples: 1,
        emitter_candidates: 1,
        clamp_indirect: f32::INFINITY,
    };

    /// Radiance along a camera ray, and what it sees first.
    pub fn radiance(&self, scene: &Scene, camera_ray: Ray, numbers: &Numbers<'_>) -> (Vec3, FirstHit) {
        let mut ray = camera_ray;
        let mut first = FirstHit::default();
        let (mut radiance, mut throughput) = (Vec3::ZERO, Vec3::ONE);
        let mut origin = Origin::Unique;
        let mut eta_squared = 1.0;
        for depth in 0..=self.max_depth {
            // Of the last ray only the light that it hits counts.
            let is_last = depth == self.max_depth && depth > 0;
            if is_last && !scene.lights.has_areas() {
                if !scene.geometry.is_occluded(&ray) {
                    radiance += self.limited(throughput * self.background(scene, ray.direction, origin), depth);
                }
                break;
            }
            let Some(hit) = scene.geometry.intersect(&ray) else {
                if depth > 0 || scene.background == Background::Environment {
                    radiance += self.limited(throughput * self.background(scene, ray.direction, origin), depth);
                }
                break;
            };
            let surface = scene.geometry.surface(&ray, &hit);
            radiance += self.limited(throughput * self.emission(scene, &ray, &surface, origin), depth);
            let outgoing = -ray.direction;
            let bsdf = scene.material_of(surface.shape).on(&surface);
            if depth == 0 {
                first = FirstHit::of(&surface, outgoing, &bsdf, hit.distance);
            }
            if depth == self.max_depth {
                break;
            }
            let shading = Shading::new(bsdf, &surface.frame, surface.normal, outgoing);
            let sets = CAMERA_SETS + VERTEX_SETS * depth;
            if !bsdf.is_delta() {
                let vertex = OnSurface { surface: &surface, shading: &shading };
                let visible = |ray: &Ray| (!scene.geometry.is_occluded(ray)).then_some(1.0);
                let direct = self.direct(scene, &vertex, numbers, sets, visible);
                radiance += self.limited(throughput * direct, depth + 1);
            }
            let choice = numbers.bits(sets + CHOICE_SET);
            let Some(sample) = shading.sample(unit(choice[0]), numbers.pair(sets + DIRECTION_SET), Transport::Radiance) else { break };
            throughput *= sample.weight;
            eta_squared *= sample.eta * sample.eta;
            if depth >= self.roulette_depth {
                let survival = (throughput.max_element() * eta_squared).min(0.95);
                if unit(choice[1]) >= survival {
                    break;
                }
                throughput /= survival;
            }
            if throughput == Vec3::ZERO {
                break;
            }
            origin = if sample.is_delta { Origin::Unique } else { Origin::Scattered { reference: surface.position, pdf: sample.pdf } };
            ray = surface.spawn(sample.direction);
        }
        (radiance, first)
    }

    /// Light by drawing lights from a vertex; `visible` gives the share that comes through along a ray, if any does.
    #[inline]
    pub(super) fn direct(
        &self,
        scene: &Scene,
        vertex: &impl Vertex,
        numbers: &Numbers<'_>,
        sets: u32,
        mut visible: impl FnMut(&Ray) -> Option<f32>,
    ) -> Vec3 {
        if scene.lights.is_empty() {
            return Vec3::ZERO;
        }
        let light_once = |part| {
            let chosen = self.chosen(scene, vertex, numbers, sets, part)?;
            let share = visible(&vertex.shadow_ray(&chosen.light)?)?;
            Some(chosen.brought * share)
        };
        (0..self.emitter_samples).filter_map(light_once).sum::<Vec3>() / self.emitter_samples as f32
    }

    /// One of the candidates of a draw, by what it would bring if nothing hid it; what it brings counts for all.
    #[inline]
    fn chosen(&self, scene: &Scene, vertex: &impl Vertex, numbers: &Numbers<'_>, sets: u32, part: u32) -> Option<Candidate> {
        let (count, draws) = (self.emitter_candidates, self.draws());
        if draws == 1 {
            return self.candidate(scene, vertex, numbers.bits(sets));
        }
        let mut choice = unit(numbers.bits_of_part(sets + CHOICE_SET, part, self.emitter_samples)[1]);
        let mut chosen = None;
        let mut total = 0.0;
        for index in part * count..(part + 1) * count {
            let Some(candidate) = self.candidate(scene, vertex, numbers.bits_of_part(sets, index, draws)) else { continue };
            let share = candidate.brought.element_sum();
            total += share;
            let probability = share / total;
            // What is left of the number chooses among the rest.
            if choice < probability {
                choice /= probability;
                chosen = Some((candidate, share));
            } else {
                choice = ((choice - probability) / (1.0 - probability)).min(BELOW_ONE);
            }
        }
        let (candidate, share) = chosen?;
        Some(Candidate { brought: candidate.brought * (total / (share * count as f32)), ..candidate })
    }

    /// A draw of a light; `None` where it brings nothing, hidden or not.
    #[inline]
    fn candidate(&self, scene: &Scene, vertex: &impl Vertex, bits: [u32; 2]) -> Option<Candidate> {
        let light = scene.lights.sample(&scene.geometry, vertex.position(), bits)?;
        let is_left_to_scattering = self.strategy == Strategy::Bsdf && !light.is_delta;
        if is_left_to_scattering || light.pdf <= 0.0 || light.radiance == Vec3::ZERO {
            return None;
        }
        let (value, scattering_pdf) = vertex.evaluate_with_pdf(light.direction);
        if value == Vec3::ZERO {
            return None;
        }
        let weight = if light.is_delta || self.strategy == Strategy::Emitter {
            1.0
        } else {
            power_heuristic(light.pdf * self.draws() as f32, scattering_pdf)
        };
        let brought = value * light.radiance * (weight / light.pdf);
        (brought != Vec3::ZERO).then_some(Candidate { light, brought })
    }

    /// Draws of lights at a vertex.
    #[inline]
    pub fn draws(&self) -> u32 {
        self.emitter_samples * self.emitter_candidates
    }

    /// What the environment adds to a ray that hits nothing.
    pub(super) fn background(&self, scene: &Scene, direction: Vec3, origin: Origin) -> Vec3 {
        match origin {
            Origin::Unique => scene.lights.environment().map_or(Vec3::ZERO, |environment| environment.radiance(direction)),
            Origin::Scattered { .. } if self.strategy == Strategy::Emitter => Vec3::ZERO,
            Origin::Scattered { pdf, .. } => {
                let Some((radiance, light_pdf)) = scene.lights.environment_towards(direction) else { return Vec3::ZERO };
                radiance * self.weight_of_hit(pdf, light_pdf)
            }
        }
    }

    /// What a surface adds by its own light.
    pub(super) fn emission(&self, scene: &Scene, ray: &Ray, surface: &Surface, origin: Origin) -> Vec3 {
        let Some(emitted) = scene.lights.emitted(surface, ray.direction) else { return Vec3::ZERO };
        match origin {
            Origin::Unique => emitted,
            Origin::Scattered { .. } if self.strategy == Strategy::Emitter => Vec3::ZERO,
            Origin::Scattered { reference, pdf } => {
                emitted * self.weight_of_hit(pdf, scene.lights.area_pdf(&scene.geometry, reference, surface))
            }
        }
    }

    fn weight_of_hit(&self, scattering_pdf: f32, light_pdf: f32) -> f32 {
        match self.strategy {
            Strategy::Bsdf => 1.0,
            Strategy::Emitter => 0.0,
            Strategy::Mis => power_heuristic(scattering_pdf, light_pdf * self.draws() as f32),
        }
    }

    /// Scales down what is too bright, after the first scattering.
    pub(super) fn limited(&self, added: Vec3, scatterings: u32) -> Vec3 {
        let largest = added.max_element();
        if scatterings < 2 || largest <= self.clamp_indirect { added } else { added * (self.clamp_indirect / largest) }
    }
}

impl FirstHit {
    pub(super) fn of(surface: &Surface, outgoing: Vec3, bsdf: &Bsdf<'_>, depth: f32) -> Self {
        let normal = bsdf.normal_in(&surface.frame);
        let towards_camera = if normal.dot(outgoing) < 0.0 { -normal } else { normal };
        Self { is_hit: true, albedo: bsdf.albedo(), normal: towards_camera, depth }
    }
}

/// Weight of a draw with density `a` beside another way with density `b`: a² / (a² + b²), without overflow.
#[inline]
fn power_heuristic(a: f32, b: f32) -> f32 {
    if a <= 0.0 {
        return 0.0;
    }
    let ratio = b / a;
    1.0 / (1.0 + ratio * ratio)
}

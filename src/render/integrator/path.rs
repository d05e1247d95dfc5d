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
//! the candidates as so many draws. Each channel of the color chooses by what the candidates bring to it, all by one
//! number: so where nothing is hidden each is the candidates' mean, without the noise of the chosen one's color, and
//! where lights differ in strength but not in color all three choose the same and cast one shadow ray.

use std::ops::Range;

use glam::Vec3;
use wide::f32x4;

use crate::render::bsdf::shading::Shading;
use crate::render::bsdf::{Bsdf, Transport};
use crate::render::emitter::environment::LightLanes;
use crate::render::emitter::lights::LightSample;
use crate::render::film::Background;
use crate::render::integrator::Strategy;
use crate::render::lanes::{LANES, Vectors, Weighted};
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
/// Red, green and blue.
const CHANNELS: usize = 3;

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

/// The candidates of one draw, of which each channel keeps one.
struct Choice {
    /// Uniform on [0, 1), whatever was chosen before: what is left of the number chooses among the rest.
    numbers: [f32; CHANNELS],
    /// What all candidates bring together.
    total: Vec3,
    /// Of the candidates so far, the one that each channel keeps.
    kept: [Option<LightSample>; CHANNELS],
    /// The candidate's index, by which channels that keep the same know it.
    indices: [u32; CHANNELS],
}

impl Choice {
    fn new(number: f32) -> Self {
        Self { numbers: [number; CHANNELS], total: Vec3::ZERO, kept: [None; CHANNELS], indices: [0; CHANNELS] }
    }

    /// More candidates, by what they bring, of which the first has that index: a channel keeps one of them with the
    /// probability of its share in what has come so far.
    #[inline]
    fn add<const N: usize>(&mut self, first: u32, brought: &[Vec3; N], light: impl Fn(usize) -> LightSample) {
        let mut sum = Vec3::ZERO;
        let sums = brought.map(|brought| {
            sum += brought;
            sum
        });
        self.total += sum;
        for channel in 0..CHANNELS {
            if sum[channel] <= 0.0 {
                continue;
            }
            let number = &mut self.numbers[channel];
            let probability = sum[channel] / self.total[channel];
            // What is infinite is kept, so that the sample shows it and is counted.
            if *number >= probability {
                *number = ((*number - probability) / (1.0 - probability)).min(BELOW_ONE);
                continue;
            }
            // The first whose sum lies beyond, counted without a branch; none does by rounding, or beside what is infinite.
            let wanted = *number / probability * sum[channel];
            let counted: usize = sums.iter().map(|sum| usize::from(sum[channel] <= wanted)).sum();
            let is_right = brought.get(counted).is_some_and(|brought| brought[channel] > 0.0);
            let place = if is_right { counted } else { last_of(brought, channel) };
            let before = if place == 0 { 0.0 } else { sums[place - 1][channel] };
            *number = ((wanted - before) / brought[place][channel]).clamp(0.0, BELOW_ONE);
            self.kept[channel] = Some(light(place));
            self.indices[channel] = first + place as u32;
        }
    }

    /// What the candidates bring together, each channel by the share of its kept one that comes through.
    #[inline]
    fn seen(&self, mut share_seen: impl FnMut(&LightSample) -> f32) -> Vec3 {
        let mut shares = [0.0; CHANNELS];
        for channel in 0..CHANNELS {
            let Some(light) = &self.kept[channel] else { continue };
            let same = (0..channel).find(|&other| self.kept[other].is_some() && self.indices[other] == self.indices[channel]);
            shares[channel] = same.map_or_else(|| share_seen(light), |other| shares[other]);
        }
        let channel = |index: usize| if shares[index] > 0.0 { self.total[index] * shares[index] } else { 0.0 };
        Vec3::new(channel(0), channel(1), channel(2))
    }
}

/// Of what brings anything to a channel the last: what is no number counts.
#[cold]
fn last_of(brought: &[Vec3], channel: usize) -> usize {
    brought.iter().rposition(|brought| brought[channel] > 0.0 || brought[channel].is_nan()).unwrap_or(0)
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

    /// The same for four directions at once.
    #[inline]
    fn evaluate_lanes(&self, directions: &Vectors) -> Weighted {
        Weighted::one_by_one(directions, |direction| self.evaluate_with_pdf(direction))
    }

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
    fn evaluate_lanes(&self, directions: &Vectors) -> Weighted {
        self.shading.evaluate_lanes(directions, Transport::Radiance)
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
                // Asked for first: while the map comes out of memory the ray is traced, and where it is black it need not be.
                let light = throughput * self.background(scene, ray.direction, origin);
                if light != Vec3::ZERO && !scene.geometry.is_occluded(&ray) {
                    radiance += self.limited(light, depth);
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
        let mut share_seen = |light: &LightSample| vertex.shadow_ray(light).and_then(|ray| visible(&ray)).unwrap_or(0.0);
        let (count, draws) = (self.emitter_candidates, self.draws());
        if draws == 1 {
            let Some(candidate) = self.candidate(scene, vertex, numbers.bits(sets)) else { return Vec3::ZERO };
            let share = share_seen(&candidate.light);
            return if share > 0.0 { candidate.brought * share } else { Vec3::ZERO };
        }
        let mut sum = Vec3::ZERO;
        for part in 0..self.emitter_samples {
            let mut choice = Choice::new(unit(numbers.bits_of_part(sets + CHOICE_SET, part, self.emitter_samples)[1]));
            self.add_candidates(scene, vertex, numbers, sets, part * count..(part + 1) * count, &mut choice);
            sum += choice.seen(&mut share_seen);
        }
        sum / draws as f32
    }

    /// Adds the draws of these indices to a choice: four at once where all light comes from a map.
    #[inline]
    fn add_candidates(
        &self,
        scene: &Scene,
        vertex: &impl Vertex,
        numbers: &Numbers<'_>,
        sets: u32,
        mut indices: Range<u32>,
        choice: &mut Choice,
    ) {
        let bits = |index| numbers.bits_of_part(sets, index, self.draws());
        if let Some(environment) = scene.lights.lone_environment() {
            while indices.len() >= LANES {
                let first = indices.start;
                let bits = std::array::from_fn(|lane| bits(first + lane as u32));
                let Some(lanes) = environment.sample_lanes(bits) else { break };
                choice.add(first, &self.brought(vertex, &lanes), |lane| LightSample::of_lane(&lanes, lane));
                indices.start += LANES as u32;
            }
        }
        for index in indices {
            if let Some(Candidate { light, brought }) = self.candidate(scene, vertex, bits(index)) {
                choice.add(index, &[brought], |_| light);
            }
        }
    }

    /// What draws of a map bring if nothing hides them, their weights included: [`Self::weighed`] in lanes.
    #[inline]
    fn brought(&self, vertex: &impl Vertex, lanes: &LightLanes) -> [Vec3; LANES] {
        let (light, scattering) = (&lanes.light, vertex.evaluate_lanes(&lanes.directions));
        let weight = match self.strategy {
            Strategy::Bsdf => return [Vec3::ZERO; LANES],
            Strategy::Emitter => f32x4::ONE,
            Strategy::Mis => {
                let ratio = scattering.pdf / (light.pdf * self.draws() as f32);
                1.0 / (1.0 + ratio * ratio)
            }
        };
        // Where nothing shines there is no density to divide by.
        let scale = (weight / light.pdf) & light.pdf.simd_gt(f32x4::ZERO);
        scattering.value.times(&light.value).scaled(scale).to_array()
    }

    /// A draw of a light; `None` where it brings nothing, hidden or not.
    #[inline]
    fn candidate(&self, scene: &Scene, vertex: &impl Vertex, bits: [u32; 2]) -> Option<Candidate> {
        self.weighed(vertex, scene.lights.sample(&scene.geometry, vertex.position(), bits)?)
    }

    /// The same of a light that was drawn.
    #[inline]
    fn weighed(&self, vertex: &impl Vertex, light: LightSample) -> Option<Candidate> {
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

#[cfg(test)]
mod tests {
    use std::cell::Cell;
    use std::convert::Infallible;

    use super::*;
    use crate::light::test_maps;
    use crate::math::stream::{Purpose, Stream};
    use crate::render::emitter::EnvironmentParameters;
    use crate::render::emitter::environment::{Density, Environment};

    /// A light whose density tells which one it is.
    fn light(index: usize) -> LightSample {
        LightSample { direction: Vec3::Z, radiance: Vec3::ONE, pdf: index as f32, is_delta: false, target: None }
    }

    fn chosen(number: f32, brought: &[Vec3]) -> Choice {
        let mut choice = Choice::new(number);
        // Four at once, and the others one by one.
        let (fours, others) = brought.as_chunks::<LANES>();
        let first_other = LANES * fours.len();
        (0..).step_by(LANES).zip(fours).for_each(|(first, four)| choice.add(first as u32, four, |lane| light(first + lane)));
        (first_other..).zip(others).for_each(|(index, brought)| choice.add(index as u32, &[*brought], |_| light(index)));
        choice
    }

    const COLORED: [Vec3; 4] = [Vec3::new(1.0, 0.0, 2.0), Vec3::new(3.0, 1.0, 0.0), Vec3::ZERO, Vec3::new(0.0, 5.0, 2.0)];

    /// Over all numbers a channel sees the sum of what the candidates that are not hidden bring to it.
    #[test]
    fn each_channel_keeps_a_candidate_by_its_share() {
        const NUMBERS: u32 = 40_000;
        for hidden in 0..1_usize << COLORED.len() {
            let is_seen = |index: usize| hidden >> index & 1 == 0;
            let seen = |k: u32| chosen((k as f32 + 0.5) / NUMBERS as f32, &COLORED).seen(|light| f32::from(is_seen(light.pdf as usize)));
            let mean = (0..NUMBERS).map(|k| seen(k).as_dvec3()).sum::<glam::DVec3>() / f64::from(NUMBERS);
            let expected: Vec3 = (0..COLORED.len()).filter(|&index| is_seen(index)).map(|index| COLORED[index]).sum();
            assert!((mean - expected.as_dvec3()).abs().max_element() < 1e-3, "{hidden:b}: {mean} {expected}");
        }
    }

    #[test]
    fn where_nothing_is_hidden_the_choice_adds_no_noise() {
        for k in 0..100 {
            assert_eq!(chosen(k as f32 / 100.0, &COLORED).seen(|_| 1.0), COLORED.into_iter().sum::<Vec3>());
        }
    }

    #[test]
    fn lights_of_one_color_are_asked_for_once() {
        for k in 0..100 {
            let asked = Cell::new(0);
            let shades = [0.5, 2.0, 0.25, 8.0].map(|strength| Vec3::new(1.0, 0.5, 0.25) * strength);
            chosen(k as f32 / 100.0, &shades).seen(|_| {
                asked.set(asked.get() + 1);
                1.0
            });
            assert_eq!(asked.get(), 1, "{k}");
        }
    }

    /// A surface that scatters more of what comes from above.
    struct Above;

    impl Vertex for Above {
        fn position(&self) -> Vec3 {
            Vec3::ZERO
        }

        fn evaluate_with_pdf(&self, direction: Vec3) -> (Vec3, f32) {
            let pdf = direction.y.max(0.0);
            (Vec3::new(0.1, 0.5, 0.9) * pdf, pdf)
        }

        fn shadow_ray(&self, _: &LightSample) -> Option<Ray> {
            None
        }
    }

    #[test]
    fn draws_in_lanes_bring_what_single_ones_do() {
        let map = test_maps::noisy(32, 16);
        let environment = Environment::new(&map, &EnvironmentParameters::default(), Density::Full, || Ok::<(), Infallible>(())).unwrap().0;
        let mut numbers = Stream::new(4, Purpose::Test).generator(0);
        for strategy in [Strategy::Mis, Strategy::Emitter, Strategy::Bsdf] {
            let transporter = Transporter { strategy, emitter_candidates: 4, ..Transporter::EMITTERS_ALONE };
            for _ in 0..500 {
                let lanes = environment.sample_lanes(std::array::from_fn(|_| [0; 2].map(|_: u32| numbers.bits() as u32))).unwrap();
                for (lane, brought) in transporter.brought(&Above, &lanes).into_iter().enumerate() {
                    let single = transporter.weighed(&Above, LightSample::of_lane(&lanes, lane));
                    assert_eq!(brought, single.map_or(Vec3::ZERO, |single| single.brought), "{strategy:?}");
                }
            }
        }
    }

    #[test]
    fn what_is_infinite_shows() {
        let seen = |brought: &[Vec3]| chosen(0.5, brought).seen(|_| 1.0).x;
        assert_eq!(seen(&[Vec3::INFINITY, Vec3::ONE]), f32::INFINITY);
        assert_eq!(seen(&[Vec3::MAX, Vec3::MAX]), f32::INFINITY);
    }
}

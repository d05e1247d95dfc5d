//! All lights of a scene, one of which is drawn by power.
//!
//! Half of the probability goes by power and half to all alike, so that a strong light far away does not starve a
//! weak one near by. The number that chooses is stretched and used again, which keeps well spread points spread over
//! each light.

use glam::Vec3;

use crate::render::emitter::environment::{Environment, LightLanes};
use crate::render::emitter::spot::Spot;
use crate::render::ray::{Ray, Surface};
use crate::render::sampler::unit;
use crate::render::shape::geometry::Geometry;
use crate::render::texture::{Texture, TexturePoint};

/// One light.
#[derive(Debug, Clone)]
pub enum Source {
    /// The map around everything.
    Environment(Box<Environment>),
    /// A shape that shines on the side of its normal.
    Area {
        /// Index of the placed shape.
        shape: u32,
        /// What it radiates.
        radiance: Texture<Vec3>,
    },
    /// A point alike to all sides.
    Point {
        /// Where.
        position: Vec3,
        /// Power per solid angle.
        intensity: Vec3,
    },
    /// A point that shines within a cone.
    Spot(Spot),
    /// Parallel light.
    Directional {
        /// Unit vector from the scene towards the light.
        towards: Vec3,
        /// On a surface that faces it.
        irradiance: Vec3,
    },
}

/// All lights of a scene.
#[derive(Debug, Clone)]
pub struct Lights {
    sources: Vec<Source>,
    /// Where each light's part of the unit interval begins, in units of 2^-32; one more than there are lights.
    starts: Vec<u64>,
    /// Index of the map among the lights.
    environment: Option<usize>,
    /// By shape: index of its light, or `NONE`.
    of_shape: Vec<u32>,
    has_areas: bool,
}

const NONE: u32 = u32::MAX;

/// Light towards a point, and the way to it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LightSample {
    /// Unit vector towards the light.
    pub direction: Vec3,
    /// Radiance from there; for points and parallel light, irradiance on a surface that faces them.
    pub radiance: Vec3,
    /// Density per steradian times the probability of the light; of the light alone where `is_delta`.
    pub pdf: f32,
    /// Whether no drawn direction could ever hit it.
    pub is_delta: bool,
    /// Where the light is, unless it is infinitely far away.
    pub target: Option<Vec3>,
}

impl LightSample {
    /// One of the draws of a map.
    #[inline]
    pub fn of_lane(lanes: &LightLanes, lane: usize) -> Self {
        let LightLanes { directions, light } = lanes;
        let (direction, radiance) = (directions.lane(lane), light.value.lane(lane));
        Self { direction, radiance, pdf: light.pdf.as_array()[lane], is_delta: false, target: None }
    }

    /// From a point whose intensity depends on the direction away from it.
    #[inline]
    fn of_point(position: Vec3, reference: Vec3, pdf: f32, intensity: impl Fn(Vec3) -> Vec3) -> Option<Self> {
        let way = position - reference;
        let direction = way.normalize();
        let radiance = intensity(-direction) / way.length_squared();
        let is_there = radiance.is_finite() && direction.is_finite();
        is_there.then_some(Self { direction, radiance, pdf, is_delta: true, target: Some(position) })
    }

    /// The ray along which it may be hidden.
    #[inline]
    pub fn shadow_ray(&self, surface: &Surface) -> Option<Ray> {
        match self.target {
            Some(target) => surface.spawn_to(target),
            None => Some(surface.spawn(self.direction)),
        }
    }

    /// The same from a point that is on no surface.
    #[inline]
    pub fn shadow_ray_from(&self, position: Vec3) -> Option<Ray> {
        match self.target {
            Some(target) => Ray::to(position, target),
            None => Some(Ray::new(position, self.direction)),
        }
    }
}

impl Lights {
    /// The lights of a scene of that extent.
    pub fn new(sources: Vec<Source>, geometry: &Geometry) -> Self {
        let powers: Vec<f64> = sources.iter().map(|source| source.power(geometry)).collect();
        let starts = shares(&powers);
        let environment = sources.iter().position(|source| matches!(source, Source::Environment(_)));
        let mut of_shape = vec![NONE; geometry.shape_count()];
        for (index, source) in sources.iter().enumerate() {
            if let Source::Area { shape, .. } = source {
                of_shape[*shape as usize] = index as u32;
            }
        }
        let has_areas = of_shape.iter().any(|light| *light != NONE);
        Self { sources, starts, environment, of_shape, has_areas }
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.sources.is_empty()
    }

    /// Whether a shape shines.
    pub fn has_areas(&self) -> bool {
        self.has_areas
    }

    /// The map around everything, if there is one.
    #[inline]
    pub fn environment(&self) -> Option<&Environment> {
        match self.sources.get(self.environment?) {
            Some(Source::Environment(environment)) => Some(environment),
            _ => None,
        }
    }

    /// Draws a light and a direction towards it; `None` where nothing comes from it.
    #[inline]
    pub fn sample(&self, geometry: &Geometry, reference: Vec3, bits: [u32; 2]) -> Option<LightSample> {
        let (light, probability, bits) = self.choose(bits)?;
        match &self.sources[light] {
            Source::Environment(environment) => {
                let sample = environment.sample(bits)?;
                let (direction, radiance) = (sample.direction, sample.radiance);
                Some(LightSample { direction, radiance, pdf: sample.pdf * probability, is_delta: false, target: None })
            }
            Source::Area { shape, radiance } => {
                let sample = geometry.sample(*shape, reference, bits.map(unit))?;
                let direction = (sample.position - reference).normalize();
                // It shines on the side of its normal alone.
                if direction.dot(sample.normal) >= 0.0 {
                    return None;
                }
                let radiance = radiance.at(&TexturePoint::at(sample.uv, sample.position));
                let pdf = sample.pdf * probability;
                Some(LightSample { direction, radiance, pdf, is_delta: false, target: Some(sample.position) })
            }
            Source::Point { position, intensity } => LightSample::of_point(*position, reference, probability, |_| *intensity),
            Source::Spot(spot) => LightSample::of_point(spot.position, reference, probability, |direction| spot.towards(direction)),
            Source::Directional { towards, irradiance } => {
                Some(LightSample { direction: *towards, radiance: *irradiance, pdf: probability, is_delta: true, target: None })
            }
        }
    }

    /// The map, if there is no other light.
    #[inline]
    pub fn lone_environment(&self) -> Option<&Environment> {
        self.environment().filter(|_| self.sources.len() == 1)
    }

    /// What the map shines from a direction, and the density of drawing that direction.
    #[inline]
    pub fn environment_towards(&self, direction: Vec3) -> Option<(Vec3, f32)> {
        let light = self.environment?;
        let (radiance, pdf) = self.environment()?.radiance_and_pdf(direction);
        Some((radiance, pdf * self.probability(light)))
    }

    /// What a surface shines against the direction of the ray that hit it.
    #[inline]
    pub fn emitted(&self, surface: &Surface, direction: Vec3) -> Option<Vec3> {
        let light = self.of_shape[surface.shape as usize];
        if light == NONE || direction.dot(surface.normal) >= 0.0 {
            return None;
        }
        match &self.sources[light as usize] {
            Source::Area { radiance, .. } => Some(radiance.at(&TexturePoint::at(surface.uv, surface.position))),
            _ => None,
        }
    }

    /// Density of drawing the point of a shining surface from a reference point, per steradian there.
    #[inline]
    pub fn area_pdf(&self, geometry: &Geometry, reference: Vec3, surface: &Surface) -> f32 {
        let light = self.of_shape[surface.shape as usize];
        if light == NONE { 0.0 } else { geometry.pdf(reference, surface) * self.probability(light as usize) }
    }

    fn probability(&self, light: usize) -> f32 {
        ((self.starts[light + 1] - self.starts[light]) as f64 / WHOLE) as f32
    }

    /// The light in whose part the first number falls, its probability, and the number stretched over that part.
    #[inline]
    fn choose(&self, bits: [u32; 2]) -> Option<(usize, f32, [u32; 2])> {
        if self.sources.len() <= 1 {
            return (!self.sources.is_empty()).then_some((0, 1.0, bits));
        }
        let target = u64::from(bits[0]);
        let light = self.starts.partition_point(|start| *start <= target) - 1;
        let (start, end) = (self.starts[light], self.starts[light + 1]);
        let stretched = ((target - start) << 32) / (end - start);
        Some((light, self.probability(light), [stretched as u32, bits[1]]))
    }
}

/// 2^32.
const WHOLE: f64 = 4_294_967_296.0;

/// Starts of the parts of all lights: half by power, half alike.
fn shares(powers: &[f64]) -> Vec<u64> {
    let total: f64 = powers.iter().sum();
    let count = powers.len().max(1) as f64;
    let share = |power: f64| if total > 0.0 && total.is_finite() { 0.5 * power / total + 0.5 / count } else { 1.0 / count };
    let mut starts = vec![0];
    let mut before = 0.0;
    for power in powers {
        before += share(*power);
        starts.push(((before * WHOLE) as u64).min(WHOLE as u64));
    }
    if let Some(last) = starts.last_mut().filter(|_| !powers.is_empty()) {
        *last = WHOLE as u64;
    }
    starts
}

/// Luminance of Rec. 709 primaries.
fn luminance(color: Vec3) -> f64 {
    0.2126 * f64::from(color.x) + 0.7152 * f64::from(color.y) + 0.0722 * f64::from(color.z)
}

impl Source {
    /// About how much light it sends into the scene.
    fn power(&self, geometry: &Geometry) -> f64 {
        use std::f64::consts::PI;
        let bounds = geometry.bounds();
        let radius = 0.5 * f64::from((bounds.max - bounds.min).length());
        let radius = if radius.is_finite() { radius } else { 1.0 };
        match self {
            Self::Environment(environment) => 4.0 * PI * PI * radius * radius * environment.mean_luminance(),
            Self::Area { shape, radiance } => PI * geometry.area(*shape) * luminance(radiance.mean()),
            Self::Point { intensity, .. } => 4.0 * PI * luminance(*intensity),
            Self::Spot(spot) => spot.solid_angle() * luminance(spot.intensity),
            Self::Directional { irradiance, .. } => PI * radius * radius * luminance(*irradiance),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_of_lights_fill_the_unit_interval() {
        for powers in [vec![1.0], vec![0.0, 0.0, 0.0], vec![1e30, 1.0, 1e-30], vec![f64::INFINITY, 1.0]] {
            let starts = shares(&powers);
            assert_eq!((starts[0], *starts.last().unwrap()), (0, WHOLE as u64));
            // Each has at least half of its equal share.
            let least = (0.49 * WHOLE / powers.len() as f64) as u64;
            assert!(starts.windows(2).all(|pair| pair[1] - pair[0] > least), "{powers:?}: {starts:?}");
        }
        assert_eq!(shares(&[]), [0]);
    }
}

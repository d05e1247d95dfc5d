//! Fog that thins out with height: density a e^(-b h), with closed forms for all that is asked of it.

use glam::{DVec3, Vec3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::math::elementary;
use crate::render::medium::phase::PhaseDescription;
use crate::render::medium::{Extinction, Stretch, isotropic, unit_extinction, white};
use crate::render::ray::Ray;
use crate::render::scene::vector::Vector;
use crate::render::shape::bvh::Bounds;
use crate::render::texture::value::{Color, Number, Share};

/// Fog that thins out with height: the density is floor_density · e^(-falloff · height), above the lowest point of
/// the box around the shape.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ExponentialParameters {
    /// Extinction where the density is 1: one number, since the color comes from the `albedo`. Default 1.
    #[serde(default = "unit_extinction")]
    #[schemars(extend("x-unit" = "1/length"))]
    pub sigma_t: Number<Extinction>,
    /// Share of a collision that is scattered on: a number or `[r, g, b]`. Default 1.
    #[serde(default = "white")]
    pub albedo: Color<Share>,
    /// Into which directions it scatters. Default `isotropic`.
    #[serde(default = "isotropic")]
    pub phase: PhaseDescription,
    /// Density at the floor. Default 1.
    #[serde(default = "one")]
    #[schemars(range(min = 0, max = 1_000_000))]
    pub floor_density: f64,
    /// How fast it thins out: the density falls by a factor of e over a height of 1 / falloff. Default 1.
    #[serde(default = "one")]
    #[schemars(range(min = 0, max = 1_000_000), extend("x-unit" = "1/length"))]
    pub falloff: f64,
    /// Which way height is measured, of any length but zero. Default `[0, 1, 0]`.
    #[serde(default = "Vector::y")]
    pub up: Vector,
}

fn one() -> f64 {
    1.0
}

impl ExponentialParameters {
    /// The parameter that cannot be used.
    pub fn contradiction(&self) -> Option<(&'static str, String)> {
        (self.up.vec3() == Vec3::ZERO).then(|| ("up", "`up` is zero; it is the direction in which the fog thins out".to_owned()))
    }
}

/// Exponential fog of a scene.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Exponential {
    floor_density: f64,
    falloff: f64,
    up: DVec3,
    /// Where the height is zero, along `up`.
    floor: f64,
}

impl Exponential {
    /// In a shape with that box around it.
    pub fn new(parameters: &ExponentialParameters, bounds: &Bounds) -> Self {
        let up = DVec3::from(parameters.up.0.map(f64::from)).normalize();
        let (min, max) = (bounds.min.as_dvec3(), bounds.max.as_dvec3());
        let lowest = DVec3::select(up.cmpge(DVec3::ZERO), min, max);
        Self { floor_density: parameters.floor_density, falloff: parameters.falloff, up, floor: lowest.dot(up) }
    }

    /// The density at the floor, which is the greatest.
    pub fn floor_density(&self) -> f64 {
        self.floor_density
    }

    /// The density at a point of a ray.
    #[inline]
    pub fn at(&self, ray: &Ray, distance: f64) -> f64 {
        let height = self.up.dot(ray.origin.as_dvec3()) - self.floor + distance * self.slope(ray);
        self.floor_density * elementary::exp(-self.falloff * height)
    }

    /// The greatest density on a stretch: that of its lower end.
    pub fn greatest(&self, ray: &Ray, stretch: Stretch) -> f64 {
        let lower = if self.slope(ray) > 0.0 { stretch[0] } else { stretch[1] };
        self.at(ray, lower)
    }

    /// ∫ a e^(-b (y0 + t dy)) dt = a e^(-b y0) (1 - e^(-b dy L)) / (b dy); for b dy → 0, a e^(-b y0) L.
    pub fn integral(&self, ray: &Ray, stretch: Stretch) -> f64 {
        let length = stretch[1] - stretch[0];
        let k = self.falloff * self.slope(ray);
        let x = k * length;
        let mean = if x == 0.0 { 1.0 } else { -elementary::exp_m1(-x) / x };
        self.at(ray, stretch[0]) * length * mean
    }

    /// The length from `start` on over which the density has that integral; infinite where it never has.
    pub fn length_of(&self, ray: &Ray, start: f64, integral: f64) -> f64 {
        let k = self.falloff * self.slope(ray);
        let length = integral / self.at(ray, start);
        let x = k * length;
        if x == 0.0 {
            length
        } else if x >= 1.0 {
            f64::INFINITY
        } else {
            -elementary::ln_1p(-x) / k
        }
    }

    #[inline]
    fn slope(&self, ray: &Ray) -> f64 {
        self.up.dot(ray.direction.as_dvec3())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fog(falloff: f64, up: [f32; 3]) -> Exponential {
        let text = format!("{{ floor_density: 2, falloff: {falloff}, up: {up:?} }}");
        let bounds = Bounds { min: Vec3::new(-1.0, 0.5, -2.0), max: Vec3::new(3.0, 4.0, 5.0) };
        Exponential::new(&serde_yaml::from_str(&text).unwrap(), &bounds)
    }

    /// Rays up, down, level and nearly level.
    fn rays() -> impl Iterator<Item = Ray> {
        let directions = [Vec3::Y, Vec3::NEG_Y, Vec3::X, Vec3::new(0.6, 0.8, 0.0), Vec3::new(0.8, -0.6, 0.0), Vec3::new(1.0, 1e-7, 0.0)];
        directions.into_iter().map(|direction| Ray::new(Vec3::new(0.2, 1.7, 0.4), direction))
    }

    #[test]
    fn the_density_is_that_of_the_floor_where_the_box_begins() {
        for (up, lowest) in [([0.0, 2.0, 0.0], Vec3::new(0.0, 0.5, 0.0)), ([-1.0, 0.0, 0.0], Vec3::new(3.0, 2.0, 0.0))] {
            let fog = fog(1.5, up);
            assert!((fog.at(&Ray::new(lowest, Vec3::Z), 1.0) - 2.0).abs() < 1e-6);
            let up = Vec3::from(up).normalize();
            let higher = fog.at(&Ray::new(lowest, up), 1.0);
            assert!((higher - 2.0 * elementary::exp(-1.5)).abs() < 1e-6);
        }
    }

    #[test]
    fn its_integral_is_that_of_the_density() {
        for falloff in [0.0, 1e-9, 0.7, 12.0] {
            for ray in rays() {
                let fog = fog(falloff, [0.0, 1.0, 0.0]);
                let stretch = [0.3, 1.5];
                // Simpson's rule on 2000 parts.
                const PARTS: usize = 2000;
                let step = (stretch[1] - stretch[0]) / PARTS as f64;
                let weight = |k: usize| if k == 0 || k == PARTS { 1.0 } else { [2.0, 4.0][k % 2] };
                let sum: f64 = (0..=PARTS).map(|k| weight(k) * fog.at(&ray, stretch[0] + k as f64 * step)).sum();
                let expected = sum * step / 3.0;
                let found = fog.integral(&ray, stretch);
                assert!((found / expected - 1.0).abs() < 1e-9, "{falloff} {ray:?}: {found} {expected}");
            }
        }
    }

    #[test]
    fn the_length_of_an_integral_has_that_integral() {
        for falloff in [0.0, 0.7, 12.0] {
            for ray in rays() {
                let fog = fog(falloff, [0.0, 1.0, 0.0]);
                for length in [1e-6, 0.1, 1.0] {
                    let found = fog.length_of(&ray, 0.2, fog.integral(&ray, [0.2, 0.2 + length]));
                    assert!((found / length - 1.0).abs() < 1e-6, "{falloff} {ray:?}: {found} {length}");
                }
            }
        }
        let upwards = Ray::new(Vec3::ONE, Vec3::Y);
        assert_eq!(fog(1.0, [0.0, 1.0, 0.0]).length_of(&upwards, 0.0, 1e3), f64::INFINITY, "there is not that much above");
    }
}

//! Noise between two values, over the surface or through space.
//!
//! Which noise is `math::noise`; here its octaves become a share from 0 to 1 that mixes two values.

use glam::{DVec3, Vec2, Vec3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::math::noise::{self, Octaves};
use crate::render::texture::{Texel, TexturePoint};

/// What noise is a function of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Domain {
    /// The place in the world, as if the shape were carved from it: no seams and no poles.
    #[default]
    World,
    /// u and v of the shape.
    Uv,
}

/// Which noise.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Basis {
    /// Gradient noise (Perlin 2002).
    Perlin,
    /// Values at lattice points, between them the cosine.
    CosineValue,
}

/// Noise between two values.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Noise<T> {
    /// Where the noise is least.
    pub a: T,
    /// Where it is greatest.
    pub b: T,
    /// Which noise.
    pub basis: Basis,
    /// How many, and how they shrink.
    pub octaves: Octaves,
    /// Lattice cells per unit, of the first octave.
    pub scale: f64,
    /// What it is a function of.
    pub domain: Domain,
    /// Another seed gives another field.
    pub seed: u64,
}

impl<T: Texel> Noise<T> {
    /// The value there.
    pub fn at(&self, point: &TexturePoint) -> T {
        self.a.mixed(self.b, self.share(self.place(point)) as f32)
    }

    /// Change of the value with u and v.
    pub fn slope(&self, point: &TexturePoint) -> [T; 2] {
        let place = self.place(point);
        let ways = match self.domain {
            Domain::World => point.world_tangents,
            Domain::Uv => [Vec3::X, Vec3::Y],
        };
        // A small part of the smallest cell.
        let step = 1e-3 / self.octaves.finest();
        ways.map(|way| {
            let along = way.as_dvec3() * self.scale;
            let length = along.length();
            if length == 0.0 || !length.is_finite() {
                return T::of_uv(Vec2::ZERO);
            }
            let offset = along * (step / length);
            let change = (self.share(place + offset) - self.share(place - offset)) * length / (2.0 * step);
            (self.b - self.a) * change as f32
        })
    }

    /// In units of the lattice.
    fn place(&self, point: &TexturePoint) -> DVec3 {
        let place = match self.domain {
            Domain::World => point.position,
            Domain::Uv => point.uv.extend(0.0),
        };
        place.as_dvec3() * self.scale
    }

    /// From 0 to 1: gradient noise is cut where it is beyond -1 and 1, which single octaves are by a few percent at most.
    fn share(&self, place: DVec3) -> f64 {
        match self.basis {
            Basis::Perlin => (0.5 + 0.5 * self.octaves.sum(place, self.seed, noise::perlin)).clamp(0.0, 1.0),
            Basis::CosineValue => self.octaves.sum(place, self.seed, noise::cosine_value),
        }
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec2;

    use super::*;

    fn noise(basis: Basis, count: u32) -> Noise<f32> {
        let octaves = Octaves { count, lacunarity: 2.0, gain: 0.5 };
        Noise { a: 2.0, b: 4.0, basis, octaves, scale: 3.0, domain: Domain::Uv, seed: 5 }
    }

    fn point(x: f32, y: f32) -> TexturePoint {
        TexturePoint { uv: Vec2::new(x, y), ..TexturePoint::ANYWHERE }
    }

    #[test]
    fn gradient_noise_is_half_way_at_lattice_points_for_any_number_of_octaves() {
        for count in [1, 9] {
            for (x, y) in [(0.0, 0.0), (1.0, 2.0), (-3.0, 7.0), (4.0, -1.0)] {
                assert_eq!(noise(Basis::Perlin, count).at(&point(x, y)), 3.0, "{count} octaves");
            }
        }
    }

    #[test]
    fn values_fill_the_range_and_do_not_leave_it() {
        for (basis, count) in [(Basis::Perlin, 1), (Basis::Perlin, 9), (Basis::CosineValue, 1), (Basis::CosineValue, 9)] {
            let values: Vec<f32> = (0..4000).map(|k| noise(basis, count).at(&point(0.618 * k as f32, 0.414 * k as f32))).collect();
            let (least, greatest) = values.iter().fold((f32::MAX, f32::MIN), |(l, g), v| (l.min(*v), g.max(*v)));
            assert!(least >= 2.0 && greatest <= 4.0 && least < 2.6 && greatest > 3.4, "{basis:?} {count}: {least} to {greatest}");
        }
    }

    #[test]
    fn slopes_are_differences_of_values() {
        for basis in [Basis::Perlin, Basis::CosineValue] {
            for domain in [Domain::Uv, Domain::World] {
                let noise = Noise { domain, ..noise(basis, 2) };
                let at = |u: f32, v: f32| {
                    let world_tangents = [Vec3::new(0.5, 0.0, 1.0), Vec3::new(0.0, 2.0, 0.0)];
                    let position = world_tangents[0] * u + world_tangents[1] * v;
                    TexturePoint { uv: Vec2::new(u, v), position, world_tangents, ..TexturePoint::ANYWHERE }
                };
                let [du, dv] = noise.slope(&at(0.37, 0.71));
                let difference = |u: f32, v: f32| (noise.at(&at(0.37 + u, 0.71 + v)) - noise.at(&at(0.37 - u, 0.71 - v))) / 2e-3;
                assert!((du - difference(1e-3, 0.0)).abs() < 2e-2 && (dv - difference(0.0, 1e-3)).abs() < 2e-2, "{basis:?} {domain:?}");
            }
        }
    }
}

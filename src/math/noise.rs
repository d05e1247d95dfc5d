//! Noise in space: numbers that vary smoothly and are functions of position and seed alone.
//!
//! Gradient noise of Perlin, "Improving noise" (2002): quintic interpolation, zero at lattice points,
//! twelve gradients to the edges of a cube. Perlin's table of 256 entries is replaced by a hash of the
//! lattice coordinates, so that nothing repeats and every seed gives another field.

use std::f64::consts::PI;

use glam::DVec3;

use crate::math::elementary;

/// A hash of a lattice point; all 64 bits depend on all inputs.
///
/// Coordinates are packed by odd multipliers and mixed by the finalizer of SplitMix64
/// (Steele, Lea, Flood, "Fast splittable pseudorandom number generators", 2014).
pub fn lattice_hash(x: i32, y: i32, z: i32, seed: u64) -> u64 {
    let packed = (x as u32 as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15)
        ^ (y as u32 as u64).wrapping_mul(0xc2b2_ae3d_27d4_eb4f)
        ^ (z as u32 as u64).wrapping_mul(0x1656_67b1_9e37_79f9)
        ^ seed.wrapping_mul(0xd6e8_feb8_6659_fd93);
    let mut bits = packed.wrapping_add(0x9e37_79b9_7f4a_7c15);
    bits = (bits ^ (bits >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    bits = (bits ^ (bits >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    bits ^ (bits >> 31)
}

/// Uniform on [0, 1) for a lattice point, a multiple of 2^-24.
pub fn lattice_uniform(x: i32, y: i32, z: i32, seed: u64) -> f32 {
    (lattice_hash(x, y, z, seed) >> 40) as f32 * (1.0 / 16_777_216.0)
}

/// Gradient noise at `point`, in [-1.04, 1.04], zero at points with integer coordinates.
pub fn perlin(point: DVec3, seed: u64) -> f64 {
    let [x, y, z] = point.to_array().map(floor);
    let f = point - DVec3::new(f64::from(x), f64::from(y), f64::from(z));
    let [u, v, w] = [fade(f.x), fade(f.y), fade(f.z)];
    let corner = |i: i32, j: i32, k: i32| {
        let offset = f - DVec3::new(f64::from(i), f64::from(j), f64::from(k));
        slope(lattice_hash(x.wrapping_add(i), y.wrapping_add(j), z.wrapping_add(k), seed), offset)
    };
    let edge = |j: i32, k: i32| mix(u, corner(0, j, k), corner(1, j, k));
    mix(w, mix(v, edge(0, 0), edge(1, 0)), mix(v, edge(0, 1), edge(1, 1)))
}

/// Noise of random values at lattice points, between which it goes by the cosine: t' = (1 - cos pi t) / 2; in [0, 1).
///
/// The fourth report's noise. It is value noise and not Perlin's: lattice points are its extremes.
pub fn cosine_value(point: DVec3, seed: u64) -> f64 {
    let [x, y, z] = point.to_array().map(floor);
    let f = point - DVec3::new(f64::from(x), f64::from(y), f64::from(z));
    let [u, v, w] = [f.x, f.y, f.z].map(|t| 0.5 - 0.5 * elementary::cos(PI * t));
    let corner = |i: i32, j: i32, k: i32| f64::from(lattice_uniform(x.wrapping_add(i), y.wrapping_add(j), z.wrapping_add(k), seed));
    let edge = |j: i32, k: i32| mix(u, corner(0, j, k), corner(1, j, k));
    mix(w, mix(v, edge(0, 0), edge(1, 0)), mix(v, edge(0, 1), edge(1, 1)))
}

/// Sizes of a noise that are added: each octave is finer than the one before, and weaker.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Octaves {
    /// How many.
    pub count: u32,
    /// Frequency of each over that of the one before.
    pub lacunarity: f64,
    /// Amplitude of each over that of the one before.
    pub gain: f64,
}

impl Octaves {
    /// sum of gain^k noise(lacunarity^k p) over sum of gain^k, so that the range stays that of `noise`.
    ///
    /// Octave k has the seed `seed` + k.
    pub fn sum(&self, point: DVec3, seed: u64, noise: impl Fn(DVec3, u64) -> f64) -> f64 {
        let (mut sum, mut amplitudes, mut amplitude, mut frequency) = (0.0, 0.0, 1.0, 1.0);
        for octave in 0..self.count {
            sum += amplitude * noise(point * frequency, seed.wrapping_add(u64::from(octave)));
            amplitudes += amplitude;
            amplitude *= self.gain;
            frequency *= self.lacunarity;
        }
        if amplitudes > 0.0 { sum / amplitudes } else { 0.0 }
    }

    /// Frequency of the finest over that of the first.
    pub fn finest(&self) -> f64 {
        (1..self.count).fold(1.0, |frequency, _| frequency * self.lacunarity.max(1.0))
    }
}

/// Fractal sum of gradient noise: each octave has twice the frequency and `gain` times the amplitude.
pub fn fractal(point: DVec3, count: u32, gain: f64, seed: u64) -> f64 {
    Octaves { count, lacunarity: 2.0, gain }.sum(point, seed, perlin)
}

/// The largest integer not above `x`; saturates, so that noise far outside is flat and not wrong.
///
/// Without the instructions of newer processors, `f64::floor` is a call.
fn floor(x: f64) -> i32 {
    let whole = x as i32;
    if f64::from(whole) > x { whole.saturating_sub(1) } else { whole }
}

/// 6 t^5 - 15 t^4 + 10 t^3: first and second derivatives vanish at 0 and 1.
fn fade(t: f64) -> f64 {
    t * t * t * (t * (t * 6.0 - 15.0) + 10.0)
}

fn mix(t: f64, a: f64, b: f64) -> f64 {
    a + t * (b - a)
}

/// Product of `offset` with one of Perlin's twelve gradients (four of them twice, so that four bits choose).
fn slope(hash: u64, offset: DVec3) -> f64 {
    let choice = hash >> 60;
    let u = if choice < 8 { offset.x } else { offset.y };
    let v = match choice {
        0..=3 => offset.y,
        12 | 14 => offset.x,
        _ => offset.z,
    };
    (if choice & 1 == 0 { u } else { -u }) + (if choice & 2 == 0 { v } else { -v })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_vanishes_on_the_lattice() {
        for x in -3..3 {
            for y in -3..3 {
                assert_eq!(perlin(DVec3::new(f64::from(x), f64::from(y), 5.0), 9), 0.0);
            }
        }
    }

    #[test]
    fn value_noise_is_the_lattice_value_at_lattice_points_and_the_cosine_between() {
        let at = |x: f64| cosine_value(DVec3::new(x, 2.0, -3.0), 9);
        let corner = |x| f64::from(lattice_uniform(x, 2, -3, 9));
        assert_eq!([at(4.0), at(5.0)], [corner(4), corner(5)]);
        // (1 - cos(pi / 4)) / 2 of the way after a quarter.
        let part = 0.5 - 0.5 * std::f64::consts::FRAC_1_SQRT_2;
        assert!((at(4.25) - (corner(4) + part * (corner(5) - corner(4)))).abs() < 1e-12);
    }

    #[test]
    fn octaves_are_weighted_by_their_gain() {
        let octaves = Octaves { count: 3, lacunarity: 3.0, gain: 0.25 };
        let frequencies = octaves.sum(DVec3::X, 7, |point, seed| point.x * [1.0, 10.0, 100.0][seed as usize - 7]);
        assert_eq!(frequencies, (1.0 + 0.25 * 30.0 + 0.0625 * 900.0) / 1.3125);
        assert_eq!(octaves.finest(), 9.0);
    }

    #[test]
    fn noise_is_continuous_and_bounded() {
        let mut largest: f64 = 0.0;
        for step in 0..20_000 {
            let t = f64::from(step) * 1e-2;
            let point = DVec3::new(t, 0.7 * t - 30.0, 0.3 * t + 0.5);
            let value = perlin(point, 1);
            largest = largest.max(value.abs());
            // The slope of gradient noise stays below 4 along any unit direction.
            assert!((perlin(point + DVec3::splat(1e-6), 1) - value).abs() < 1e-5);
        }
        assert!(largest > 0.5 && largest < 1.05, "{largest}");
    }

    #[test]
    fn noise_has_mean_zero_and_depends_on_the_seed() {
        let mean = |seed| {
            let points = (0..40_000).map(|k| DVec3::new(f64::from(k) * 0.618, f64::from(k) * 0.414, f64::from(k) * 0.732));
            points.map(|point| perlin(point, seed)).sum::<f64>() / 40_000.0
        };
        // Variance of gradient noise is about 0.07, so five standard errors are 0.0066.
        assert!(mean(1).abs() < 0.0066 && mean(2).abs() < 0.0066);
        assert_ne!(mean(1), mean(2));
    }

    #[test]
    fn hashes_of_lattice_points_are_uniform() {
        let mut counts = [0_u32; 16];
        for x in -20..20 {
            for y in -20..20 {
                for z in -20..20 {
                    counts[(lattice_hash(x, y, z, 3) >> 60) as usize] += 1;
                }
            }
        }
        // Chi-square with 15 degrees of freedom: 37.7 is its 0.999 quantile.
        let chi: f64 = counts.iter().map(|&count| (f64::from(count) - 4000.0) * (f64::from(count) - 4000.0) / 4000.0).sum();
        assert!(chi < 37.7, "{chi}");
    }
}

//! Numbers in [0, 1) addressed by (seed, pixel, sample index, set): the same on any machine, in any order.
//!
//! A *set* is a pair of dimensions that belong together (the place on the film, the point of a light); points of
//! one set are spread over the unit square as well as the kind can, points of different sets are independent of
//! each other. So a path of any length has well-spread dimensions, and no number depends on how many others
//! were drawn before it. Knows nothing of what the numbers are used for.

pub mod independent;
pub mod sobol;
pub mod stratified;

use std::num::NonZeroU32;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::math::sobol::Scramble;
use crate::math::stream::mixed;
use crate::render::sampler::independent::Independent;
use crate::render::sampler::sobol::Sobol;
use crate::render::sampler::stratified::Stratified;

/// How the random numbers of each pixel are spread.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum SamplerDescription {
    /// All numbers independent: plain Monte Carlo.
    Independent(Independent),
    /// Correlated multi-jitter: every pair of dimensions in as many strata as there are samples (Kensler 2013).
    Stratified(Stratified),
    /// The first two dimensions of Sobol's sequence, scrambled after Owen: the least noise (Burley 2020).
    Sobol(Sobol),
}

impl Default for SamplerDescription {
    fn default() -> Self {
        Self::Sobol(Sobol { samples_per_pixel: NonZeroU32::MIN.saturating_add(15), replicates: None })
    }
}

/// Most samples of a pixel: sums of more lose digits in f32, and 2^24 of them take days.
pub const SAMPLE_LIMIT: u32 = 1 << 24;

impl SamplerDescription {
    /// Samples of each pixel.
    pub fn samples_per_pixel(&self) -> u32 {
        match self {
            Self::Independent(kind) => kind.samples_per_pixel.get(),
            Self::Stratified(kind) => kind.samples_per_pixel.get(),
            Self::Sobol(kind) => kind.samples_per_pixel.get(),
        }
    }

    /// The number of replicates as written.
    pub fn replicates(&self) -> Option<u32> {
        match self {
            Self::Independent(_) => None,
            Self::Stratified(kind) => kind.replicates.map(NonZeroU32::get),
            Self::Sobol(kind) => kind.replicates.map(NonZeroU32::get),
        }
    }

    /// Whether the first samples of a longer render are those of a shorter one.
    pub fn is_prefix_stable(&self) -> bool {
        !matches!(self, Self::Stratified(_))
    }

    /// The same sampler with another number of samples.
    #[must_use]
    pub fn with_samples(self, samples_per_pixel: NonZeroU32) -> Self {
        match self {
            Self::Independent(_) => Self::Independent(Independent { samples_per_pixel }),
            Self::Stratified(kind) => Self::Stratified(Stratified { samples_per_pixel, ..kind }),
            Self::Sobol(kind) => Self::Sobol(Sobol { samples_per_pixel, ..kind }),
        }
    }

    /// Ready to draw. `count` is the number of samples of each replicate.
    pub fn compiled(&self, seed: u64, count: u32) -> Sampler {
        let kind = match self {
            Self::Independent(_) => SamplerKind::Independent,
            Self::Stratified(_) => SamplerKind::Stratified(stratified::Grid::of(count)),
            Self::Sobol(_) => SamplerKind::Sobol,
        };
        Sampler { kind, seed: mixed(seed ^ 0x5265_6e64_6572_696e) }
    }
}

/// A sampler of one seed.
#[derive(Debug, Clone, Copy)]
pub struct Sampler {
    kind: SamplerKind,
    seed: u64,
}

#[derive(Debug, Clone, Copy)]
enum SamplerKind {
    Independent,
    Stratified(stratified::Grid),
    Sobol,
}

impl Sampler {
    /// The numbers of a pixel; each replicate is scrambled by itself.
    pub fn pixel(&self, x: u32, y: u32, replicate: u32) -> PixelSampler {
        let place = (u64::from(x) << 32) | u64::from(y);
        let key = mixed(self.seed ^ mixed(place ^ mixed(u64::from(replicate) ^ 0x9e37_79b9_7f4a_7c15)));
        let sets = std::array::from_fn(|set| Scramble::of(set_key(key, set as u32)));
        PixelSampler { kind: self.kind, key, sets }
    }
}

/// Sets whose scrambles are kept for all samples of a pixel: those of the camera and two vertices.
const KEPT_SETS: usize = 8;

/// The numbers of one pixel and replicate.
#[derive(Debug, Clone, Copy)]
pub struct PixelSampler {
    kind: SamplerKind,
    key: u64,
    sets: [Scramble; KEPT_SETS],
}

impl PixelSampler {
    /// The numbers of one sample.
    pub fn sample(&self, index: u32) -> Numbers<'_> {
        let state = match self.kind {
            SamplerKind::Independent => mixed(self.key.wrapping_add(u64::from(index).wrapping_mul(0xd134_2543_de82_ef95))),
            SamplerKind::Stratified(_) => 0,
            SamplerKind::Sobol => u64::from(index.reverse_bits()),
        };
        Numbers { pixel: self, index, state }
    }
}

/// The numbers of one sample of one pixel.
#[derive(Debug, Clone, Copy)]
pub struct Numbers<'a> {
    pixel: &'a PixelSampler,
    index: u32,
    /// What of the index all sets share.
    state: u64,
}

impl Numbers<'_> {
    /// Two uniform numbers of 32 bits each.
    #[inline]
    pub fn bits(&self, set: u32) -> [u32; 2] {
        let key = || set_key(self.pixel.key, set);
        match self.pixel.kind {
            SamplerKind::Independent => independent::pair(self.state, set),
            SamplerKind::Stratified(grid) => grid.pair(key(), self.index),
            SamplerKind::Sobol => {
                let kept = self.pixel.sets.get(set as usize).copied();
                kept.unwrap_or_else(|| Scramble::of(key())).pair(self.state as u32)
            }
        }
    }

    /// Draw `part` of `count` from one set: as if the pixel had `count` times as many samples.
    #[inline]
    pub fn bits_of_part(&self, set: u32, part: u32, count: u32) -> [u32; 2] {
        let index = self.index.wrapping_mul(count).wrapping_add(part);
        match self.pixel.kind {
            // Strata are laid out for the samples of a pixel; further draws have strata of their own.
            SamplerKind::Stratified(_) => {
                let key = mixed(set_key(self.pixel.key, set) ^ u64::from(part));
                let sample = Numbers { pixel: &PixelSampler { key, ..*self.pixel }, ..*self };
                sample.bits(set)
            }
            _ => self.pixel.sample(index).bits(set),
        }
    }

    /// As many independent numbers as are asked for, of a set of their own.
    #[inline]
    pub fn further(&self, set: u32) -> Further {
        Further { state: mixed(set_key(self.pixel.key, set) ^ mixed(u64::from(self.index))) }
    }

    /// Two uniform numbers on [0, 1), multiples of 2^-24.
    #[inline]
    pub fn pair(&self, set: u32) -> [f32; 2] {
        self.bits(set).map(unit)
    }
}

/// Independent numbers for work whose length is not known beforehand.
#[derive(Debug, Clone, Copy)]
pub struct Further {
    state: u64,
}

impl Further {
    /// The next uniform number on [0, 1), a multiple of 2^-53.
    #[inline]
    pub fn uniform(&mut self) -> f64 {
        self.state = self.state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        (mixed(self.state) >> 11) as f64 * (1.0 / 9_007_199_254_740_992.0)
    }
}

/// A number in [0, 1) from the upper 24 bits.
#[inline]
pub fn unit(bits: u32) -> f32 {
    (bits >> 8) as f32 * (1.0 / 16_777_216.0)
}

#[inline]
fn set_key(key: u64, set: u32) -> u64 {
    mixed(key.wrapping_add(u64::from(set).wrapping_mul(0x9e37_79b9_7f4a_7c15)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::statistics::{chi_square_test, sidak_level};

    fn samplers(count: u32) -> [SamplerDescription; 3] {
        let samples_per_pixel = NonZeroU32::new(count).unwrap();
        [
            SamplerDescription::Independent(Independent { samples_per_pixel }),
            SamplerDescription::Stratified(Stratified { samples_per_pixel, replicates: None }),
            SamplerDescription::Sobol(Sobol { samples_per_pixel, replicates: None }),
        ]
    }

    /// One point a pixel: those are independent of each other, so the chi-square test holds for every kind.
    #[test]
    fn over_pixels_every_set_and_sample_is_uniform_on_the_square() {
        const BINS: usize = 16;
        let level = sidak_level(1e-3, 36);
        for count in [1, 7, 16] {
            for description in samplers(count) {
                let sampler = description.compiled(3, count);
                for (set, index) in [(0, 0), (1, count - 1), (5, count / 2), (40, 0)] {
                    let mut observed = vec![0; BINS * BINS];
                    for pixel in 0..40_000 {
                        let [u, v] = sampler.pixel(pixel % 200, pixel / 200, 0).sample(index).pair(set);
                        observed[(u * BINS as f32) as usize * BINS + (v * BINS as f32) as usize] += 1;
                    }
                    let expected = vec![40_000.0 / (BINS * BINS) as f64; BINS * BINS];
                    let test = chi_square_test(&observed, &expected);
                    assert!(test.p_value > level, "{description:?} set {set} sample {index}: {test:?}");
                }
            }
        }
    }

    /// Correlation of the first coordinates of two sets over the samples of many pixels.
    #[test]
    fn sets_and_replicates_are_uncorrelated() {
        for description in samplers(16) {
            let sampler = description.compiled(9, 16);
            let correlation = |a: &dyn Fn(u32, u32) -> f32, b: &dyn Fn(u32, u32) -> f32| {
                let pairs = (0..2000).flat_map(|pixel| (0..16).map(move |index| (pixel, index)));
                let product = |(pixel, index)| f64::from(a(pixel, index) - 0.5) * f64::from(b(pixel, index) - 0.5);
                pairs.map(product).sum::<f64>() / 32_000.0 * 12.0
            };
            let of = |set: u32, replicate: u32| move |pixel, index| sampler.pixel(pixel, 0, replicate).sample(index).pair(set)[0];
            // At most: the sixteen points of a pixel act as one; five standard errors of 2000.
            let bound = 5.0 / 2000.0_f64.sqrt();
            for (a, b) in [((0, 0), (1, 0)), ((0, 0), (2, 0)), ((3, 0), (4, 0)), ((8, 0), (9, 0)), ((0, 0), (0, 1))] {
                let found = correlation(&of(a.0, a.1), &of(b.0, b.1));
                assert!(found.abs() < bound, "{description:?} {a:?} {b:?}: {found}");
            }
        }
    }

    #[test]
    fn numbers_are_addressed_and_not_counted() {
        for description in samplers(64) {
            let draw = |seed, x, y, index, set| description.compiled(seed, 64).pixel(x, y, 0).sample(index).bits(set);
            let reference = draw(1, 2, 3, 4, 5);
            assert_eq!(reference, draw(1, 2, 3, 4, 5));
            for other in [draw(2, 2, 3, 4, 5), draw(1, 3, 2, 4, 5), draw(1, 2, 4, 4, 5), draw(1, 2, 3, 5, 5), draw(1, 2, 3, 4, 6)] {
                assert_ne!(reference, other, "{description:?}");
            }
        }
    }
}

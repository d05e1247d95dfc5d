//! Counter-addressed random streams: every number is a function of seed, purpose and index alone.
//!
//! Equal seeds and purposes give equal numbers on any machine, in any order and for any thread count;
//! the numbers of index k do not depend on how many others are drawn.
//!
//! PCG XSL RR 128/64 (O'Neill, "PCG: a family of simple fast space-efficient statistically good
//! algorithms", 2014), by the crate rand_pcg; the conversion to floats is ours, since those of `rand`
//! may change between releases.

use rand_core::Rng;
use rand_pcg::Pcg64;

/// What numbers are drawn for; streams of different purposes are independent.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[repr(u64)]
pub enum Purpose {
    /// Directions of a sample set.
    Sampling = 1,
    /// The rows of a two-stage sample set.
    Rows = 2,
    /// Dither before quantization.
    Dither = 3,
    /// Shapes and noise of synthetic maps.
    Synthesis = 4,
    /// Samples that each pixel draws for itself.
    PixelSampling = 5,
    /// Paths of the renderer.
    Rendering = 6,
    /// Directions that each pixel draws by the lobe of its surface.
    LobeSampling = 20,
    /// Data made by tests and benchmarks.
    Test = 1000,
}

/// All numbers of one seed and purpose.
#[derive(Debug, Clone, Copy)]
pub struct Stream {
    state: u128,
}

impl Stream {
    /// The stream of `seed` for `purpose`.
    pub fn new(seed: u64, purpose: Purpose) -> Self {
        Self { state: (u128::from(mixed(seed)) << 64) | u128::from(mixed(seed ^ mixed(purpose as u64))) }
    }

    /// The numbers of the item of that index (a sample, a pixel).
    #[inline]
    pub fn generator(&self, index: u64) -> Generator {
        // The index goes through state and stream, so that neighbors do not start on correlated points.
        let state = self.state ^ u128::from(mixed(index ^ 0x9e37_79b9_7f4a_7c15));
        Generator(Pcg64::new(state, u128::from(index)))
    }
}

/// The numbers of one item, one after the other.
#[derive(Debug, Clone)]
pub struct Generator(Pcg64);

impl Generator {
    /// Uniform on [0, 1), a multiple of 2^-53.
    #[inline]
    pub fn uniform(&mut self) -> f64 {
        (self.0.next_u64() >> 11) as f64 * (1.0 / 9_007_199_254_740_992.0)
    }

    /// Two uniform numbers.
    #[inline]
    pub fn uniform_pair(&mut self) -> [f64; 2] {
        [self.uniform(), self.uniform()]
    }

    /// 64 random bits.
    #[inline]
    pub fn bits(&mut self) -> u64 {
        self.0.next_u64()
    }
}

/// A bijection of 64 bits that spreads every bit over all (finalizer of SplitMix64, Steele et al. 2014).
#[inline]
pub fn mixed(bits: u64) -> u64 {
    let mut z = bits.wrapping_add(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn streams_differ_by_seed_purpose_and_index() {
        let first = |seed, purpose, index| Stream::new(seed, purpose).generator(index).bits();
        let reference = first(7, Purpose::Sampling, 0);
        assert_eq!(reference, first(7, Purpose::Sampling, 0));
        assert_ne!(reference, first(8, Purpose::Sampling, 0));
        assert_ne!(reference, first(7, Purpose::Rows, 0));
        assert_ne!(reference, first(7, Purpose::Sampling, 1));
    }

    #[test]
    fn first_numbers_of_neighbors_are_uniform_and_uncorrelated() {
        let stream = Stream::new(1, Purpose::Test);
        let count = 100_000;
        let draws: Vec<f64> = (0..count).map(|index| stream.generator(index).uniform()).collect();
        let mean = draws.iter().sum::<f64>() / count as f64;
        let lagged = draws.windows(2).map(|pair| (pair[0] - 0.5) * (pair[1] - 0.5)).sum::<f64>() / (count - 1) as f64;
        // Five standard errors: 1 / sqrt(12 n) and 1 / (12 sqrt(n)).
        assert!((mean - 0.5).abs() < 5.0 * 9.13e-4, "{mean}");
        assert!(lagged.abs() < 5.0 * 2.64e-4, "{lagged}");
    }
}

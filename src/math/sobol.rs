//! Owen-scrambled Sobol points in pairs of dimensions, by hashing, for 2^32 samples.
//!
//! Every set is the first two dimensions of Sobol's sequence, its order shuffled and its digits scrambled in
//! nested fashion under keys of its own: a (0, m, 2)-net in base 2 for every aligned block of 2^m samples, and
//! independent of all other sets.
//!
//! After Burley, "Practical hash-based Owen scrambling", JCGT 9(4), 2020, after Laine and Karras 2011; the
//! constants of the hash are Vegdahl's (2021), chosen for little bias.

use crate::math::stream::mixed;

/// The keys under which one set is shuffled and scrambled.
#[derive(Debug, Clone, Copy)]
pub struct Scramble {
    order: u32,
    digits: [u32; 2],
}

impl Scramble {
    /// The keys of a set.
    #[inline]
    pub fn of(key: u64) -> Self {
        let digits = mixed(key);
        Self { order: key as u32, digits: [(digits >> 32) as u32, digits as u32] }
    }

    /// The point of the sample whose index has these bits in reversed order.
    #[inline]
    pub fn pair(self, reversed_index: u32) -> [u32; 2] {
        // The shuffled index in reversed order is the first coordinate of the point itself.
        let first = hashed(reversed_index, self.order);
        let [first, second] = reversed([first, second_dimension(first)]);
        reversed([hashed(first, self.digits[0]), hashed(second, self.digits[1])])
    }

    /// The point of sample `index` on [0, 1)², with 52 digits.
    ///
    /// Points of one set differ within their first 32 digits, so in a nested scrambling the digits after those are
    /// independent of each other: they come from a hash. With them no part of the square is out of reach,
    /// however small.
    #[inline]
    pub fn point(self, index: u32) -> [f64; 2] {
        const DIGITS: f64 = 1.0 / 4_503_599_627_370_496.0;
        let upper = self.pair(index.reverse_bits());
        let lower = mixed((u64::from(self.order) << 32 | u64::from(index)) ^ (u64::from(self.digits[0]) << 32 | u64::from(self.digits[1])));
        let joined = |upper: u32, lower: u64| (u64::from(upper) << 20 | lower & 0xf_ffff) as f64 * DIGITS;
        [joined(upper[0], lower), joined(upper[1], lower >> 32)]
    }
}

/// Both with their digits in reversed order, turned together since reversing is most of the work of a point.
#[inline]
fn reversed([first, second]: [u32; 2]) -> [u32; 2] {
    let both = (u64::from(second) << 32 | u64::from(first)).reverse_bits();
    [(both >> 32) as u32, both as u32]
}

/// A hash in which every bit depends on lower bits alone: nested uniform scrambling (each digit is flipped by a hash
/// of the digits before it) of a number in reversed order.
#[inline]
fn hashed(mut bits: u32, key: u32) -> u32 {
    bits ^= bits.wrapping_mul(0x3d20_adea);
    bits = bits.wrapping_add(key);
    bits = bits.wrapping_mul((key >> 16) | 1);
    bits ^= bits.wrapping_mul(0x0552_6c56);
    bits ^ bits.wrapping_mul(0x53a2_2864)
}

/// The second coordinate from the first: its generator matrix is Pascal's triangle modulo 2.
///
/// Column j of the matrix is (1 + S)^j e_0 with S the shift to the next digit, and (1 + S)^(2^k) = 1 + S^(2^k)
/// modulo 2; so the product splits into halves, quarters, and so on.
#[inline]
fn second_dimension(mut digits: u32) -> u32 {
    digits ^= digits << 16;
    digits ^= (digits & 0x00ff_00ff) << 8;
    digits ^= (digits & 0x0f0f_0f0f) << 4;
    digits ^= (digits & 0x3333_3333) << 2;
    digits ^ ((digits & 0x5555_5555) << 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Sobol's second dimension from its direction numbers: v_j = v_{j-1} xor (v_{j-1} >> 1).
    #[test]
    fn the_second_dimension_follows_its_direction_numbers() {
        let mut directions = vec![1_u32 << 31];
        (1..32).for_each(|j| directions.push(directions[j - 1] ^ (directions[j - 1] >> 1)));
        for index in (0..2000).chain([u32::MAX, 0x1234_5678]) {
            let expected = (0..32).filter(|j| index >> j & 1 == 1).fold(0, |sum, j| sum ^ directions[j]);
            assert_eq!(second_dimension(index.reverse_bits()), expected, "{index}");
        }
    }

    #[test]
    fn every_elementary_interval_holds_one_point() {
        for key in 0..8 {
            let scramble = Scramble::of(mixed(key));
            // Blocks at the start, and one beyond 65 536 points.
            for start in [0_u32, 1 << 20] {
                for m in [1, 2, 5, 8] {
                    let block = (start >> m) << m;
                    let points: Vec<[u32; 2]> = (block..block + (1 << m)).map(|index: u32| scramble.pair(index.reverse_bits())).collect();
                    for k in 0..=m {
                        let cell = |point: &[u32; 2]| {
                            let (x, y) = (u64::from(point[0]) >> (32 - k), u64::from(point[1]) >> (32 - (m - k)));
                            (x << (m - k)) | y
                        };
                        let mut cells: Vec<u64> = points.iter().map(cell).collect();
                        cells.sort_unstable();
                        cells.dedup();
                        assert_eq!(cells.len(), 1 << m, "key {key} m {m} k {k}");
                    }
                }
            }
        }
    }

    #[test]
    fn points_are_the_pairs_with_further_digits() {
        let scramble = Scramble::of(mixed(3));
        for index in (0..1000).chain([70_000, u32::MAX]) {
            let (point, pair) = (scramble.point(index), scramble.pair(index.reverse_bits()));
            for (coordinate, digits) in point.into_iter().zip(pair) {
                assert!((0.0..1.0).contains(&coordinate));
                assert_eq!((coordinate * 4_294_967_296.0) as u32, digits);
            }
        }
        let lower: f64 = (0..4096).map(|index| (scramble.point(index)[1] * 4_294_967_296.0).fract()).sum::<f64>() / 4096.0;
        // Five standard errors.
        assert!((lower - 0.5).abs() < 5.0 / (12.0_f64 * 4096.0).sqrt(), "{lower}");
    }

    /// Over keys each point is uniform: the mean of x² y over 64 points and 1000 keys is 1/6.
    #[test]
    fn scrambling_is_unbiased() {
        let values: Vec<f64> = (0..1000)
            .map(|key| {
                let scramble = Scramble::of(mixed(key));
                let value = |index: u32| {
                    let [x, y] = scramble.pair(index.reverse_bits()).map(|bits| f64::from(bits) / 4_294_967_296.0);
                    x * x * y
                };
                (0..64).map(value).sum::<f64>() / 64.0
            })
            .collect();
        let z = (crate::math::statistics::mean(&values) - 1.0 / 6.0) / crate::math::statistics::standard_error(&values);
        assert!(z.abs() < 4.0, "{z}");
    }
}

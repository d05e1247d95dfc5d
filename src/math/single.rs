//! Single-precision powers for loops over pixels.
//!
//! Only additions, multiplications, divisions and the layout of the bits, so that they give the same
//! answer on every machine and the compiler may compute several pixels at once. Relative errors are
//! near one part in a million; where eight digits matter use `elementary`.

use std::f32::consts::LN_2;

/// Cube root of a positive normal number; a relative error below 3e-7.
///
/// A third of the exponent by integer arithmetic on the bits, then two steps of Halley's iteration
/// y ← y (y³ + 2x) / (2y³ + x), each of which cubes the error (0.05 → 1e-4 → below rounding).
pub fn cube_root(x: f32) -> f32 {
    /// Makes the greatest relative error of the start least over the mantissas.
    const EXPONENT_OFFSET: u32 = 709_921_077;
    let start = f32::from_bits(x.to_bits() / 3 + EXPONENT_OFFSET);
    halley(halley(start, x), x)
}

fn halley(y: f32, x: f32) -> f32 {
    let cube = y * y * y;
    y * (cube + 2.0 * x) / (2.0 * cube + x)
}

/// x to the power y for 0 <= x, by 2^(y log2 x); a relative error below 1e-6 times max(1, |y log2 x|).
///
/// Zero to the power zero is one. Results below 2^-126 are zero.
pub fn power(x: f32, y: f32) -> f32 {
    let positive = exp2(y * log2(x.max(f32::MIN_POSITIVE)));
    let of_zero = if y == 0.0 { 1.0 } else { 0.0 };
    if x < f32::MIN_POSITIVE { of_zero } else { positive }
}

/// Logarithm to base two of a positive normal number.
///
/// x = 2^k m with m in [sqrt(1/2), sqrt(2)), and ln m = 2 artanh(s) with s = (m - 1) / (m + 1), |s| < 0.172;
/// the series is cut behind s⁹ / 9, the next term is below 4e-10.
fn log2(x: f32) -> f32 {
    const SQRT_HALF_BITS: u32 = 0x3f35_04f3;
    const MANTISSA_BITS: u32 = 23;
    let shifted = x.to_bits().wrapping_sub(SQRT_HALF_BITS);
    let exponent = (shifted as i32) >> MANTISSA_BITS;
    let m = f32::from_bits(x.to_bits().wrapping_sub((exponent << MANTISSA_BITS) as u32));
    let s = (m - 1.0) / (m + 1.0);
    let s2 = s * s;
    let series = 1.0 + s2 * (1.0 / 3.0 + s2 * (1.0 / 5.0 + s2 * (1.0 / 7.0 + s2 * (1.0 / 9.0))));
    exponent as f32 + (2.0 / LN_2) * s * series
}

/// Two to the power x; zero below -126, and 2^127 above 127.
///
/// x = k + f with |f| <= 1/2, and the Taylor series of e^(f ln 2) to the seventh power (error below 6e-9).
fn exp2(x: f32) -> f32 {
    /// Adding and subtracting 1.5 · 2^23 rounds to the nearest integer.
    const ROUNDER: f32 = 12_582_912.0;
    let bounded = x.clamp(-126.0, 127.0);
    let k = (bounded + ROUNDER) - ROUNDER;
    let t = (bounded - k) * LN_2;
    let series =
        1.0 + t * (1.0 + t * (1.0 / 2.0 + t * (1.0 / 6.0 + t * (1.0 / 24.0 + t * (1.0 / 120.0 + t * (1.0 / 720.0 + t * (1.0 / 5040.0)))))));
    let scale = f32::from_bits(((k as i32 + 127) as u32) << 23);
    if x < -126.0 { 0.0 } else { series * scale }
}

/// Angle of the point (x, y) from the positive x axis, in (-pi, pi]; an error below 4e-7. Zero at the origin.
///
/// The smaller coordinate over the larger, above tan(pi/8) turned back by pi/4, then the polynomial of Moshier's
/// Cephes library for |x| <= tan(pi/8).
pub fn atan2(y: f32, x: f32) -> f32 {
    use std::f32::consts::{FRAC_PI_2, FRAC_PI_4, PI};
    const TAN_PI_8: f32 = 0.414_213_57;
    let (larger, smaller) = (x.abs().max(y.abs()), x.abs().min(y.abs()));
    let is_steep = smaller > TAN_PI_8 * larger;
    let (numerator, denominator) = if is_steep { (smaller - larger, smaller + larger) } else { (smaller, larger) };
    let t = if denominator > 0.0 { numerator / denominator } else { 0.0 };
    let z = t * t;
    let series = t + t * z * (-0.333_329_5 + z * (0.199_777_1 + z * (-0.138_776_85 + z * 0.080_537_446)));
    let octant = if is_steep { FRAC_PI_4 + series } else { series };
    let quadrant = if y.abs() > x.abs() { FRAC_PI_2 - octant } else { octant };
    let half = if x < 0.0 { PI - quadrant } else { quadrant };
    if y < 0.0 { -half } else { half }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::elementary;

    fn numbers() -> impl Iterator<Item = f32> {
        // Every 4099th number between 2^-40 and 2^40.
        (0x2b80_0000_u32..0x5380_0000).step_by(4099).map(f32::from_bits)
    }

    #[test]
    fn cube_roots_agree_with_the_exact_ones() {
        for x in numbers() {
            let exact = elementary::cbrt(f64::from(x));
            let error = (f64::from(cube_root(x)) / exact - 1.0).abs();
            assert!(error < 3e-7, "{x}: {error}");
        }
    }

    #[test]
    fn powers_agree_with_the_exact_ones() {
        for y in [0.0, 0.1, 0.3, 0.7, 1.0, 2.4] {
            for x in numbers() {
                let exact = elementary::pow(f64::from(x), f64::from(y));
                let error = (f64::from(power(x, y)) / exact - 1.0).abs();
                let exponent = f64::from(y) * elementary::log2(f64::from(x)).abs();
                assert!(error < 2.5e-7 * exponent.max(1.0), "{x}^{y}: {error}");
            }
        }
    }

    #[test]
    fn powers_of_zero_are_zero_but_for_the_exponent_zero() {
        assert_eq!(power(0.0, 0.7), 0.0);
        assert_eq!(power(0.0, 0.0), 1.0);
        assert_eq!(power(1.0, 0.3), 1.0);
        assert_eq!(power(1e-30, 10.0), 0.0);
    }

    #[test]
    fn angles_agree_with_the_exact_ones() {
        let turns = (0..20_000).map(|k| f64::from(k) * 1e-4 * std::f64::consts::PI);
        for (sin, cos) in turns.map(|angle| elementary::sin_cos(angle - 3.14)) {
            for radius in [1e-30, 1.0, 1e30] {
                let (y, x) = ((sin * radius) as f32, (cos * radius) as f32);
                let exact = elementary::atan2(f64::from(y), f64::from(x));
                assert!((f64::from(atan2(y, x)) - exact).abs() < 4e-7, "{y} {x}");
            }
        }
        let axes = [(0.0, 0.0), (0.0, 1.0), (1.0, 0.0), (0.0, -1.0), (-1.0, 0.0)].map(|(y, x)| atan2(y, x));
        let quarter = std::f32::consts::FRAC_PI_2;
        assert_eq!(axes, [0.0, 0.0, quarter, 2.0 * quarter, -quarter]);
    }
}

//! Single-precision powers, logarithms, circles and error functions for loops over pixels and samples.
//!
//! Only additions, multiplications, divisions and the layout of the bits, so that they give the same
//! answer on every machine and the compiler may compute several pixels at once. Relative errors are
//! near one part in a million; where eight digits matter use `elementary`.

use std::f32::consts::{FRAC_PI_2, LN_2, LOG2_E};
use std::ops::{Add, Mul};

use wide::{f32x4, i32x4};

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
#[inline]
pub fn log2(x: f32) -> f32 {
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
#[inline]
pub fn exp2(x: f32) -> f32 {
    /// Adding and subtracting 1.5 · 2^23 rounds to the nearest integer.
    const ROUNDER: f32 = 12_582_912.0;
    let bounded = x.clamp(-126.0, 127.0);
    let rounded = bounded + ROUNDER;
    let k = rounded - ROUNDER;
    let t = (bounded - k) * LN_2;
    let series =
        1.0 + t * (1.0 + t * (1.0 / 2.0 + t * (1.0 / 6.0 + t * (1.0 / 24.0 + t * (1.0 / 120.0 + t * (1.0 / 720.0 + t * (1.0 / 5040.0)))))));
    // The lowest bits of `rounded` are k; taking them from there keeps the loops around this function in vector registers.
    let scale = f32::from_bits(rounded.to_bits().wrapping_add(127) << 23);
    if x < -126.0 { 0.0 } else { series * scale }
}

/// Natural logarithm of a positive normal number; an absolute error below 2e-7 times max(1, |ln x|).
#[inline]
pub fn ln(x: f32) -> f32 {
    LN_2 * log2(x)
}

/// e to the power x; a relative error below 2e-7 times max(1, |x|), and zero below 2^-126.
#[inline]
pub fn exp(x: f32) -> f32 {
    exp2(LOG2_E * x)
}

/// Sine and cosine of `turns` full circles, for 0 <= turns <= 1; an absolute error below 1.5e-7.
///
/// The nearest quarter circle, and Taylor's series for the rest of at most pi / 4 (next terms below 4e-9 and 3e-8).
#[inline]
pub fn sin_cos_of_turns(turns: f32) -> (f32, f32) {
    let quarters = 4.0 * turns;
    // Rounding down of what is positive, without the call that `floor` is where the machine has no instruction for it.
    let quadrant = (quarters + 0.5) as i32;
    let (sine, cosine) = sin_cos_of_eighth(FRAC_PI_2 * (quarters - quadrant as f32));
    let (along, across) = if quadrant & 1 == 0 { (sine, cosine) } else { (cosine, sine) };
    // Sine is negative in the third and the fourth quarter, cosine in the second and the third.
    (if quadrant & 2 == 0 { along } else { -along }, if (quadrant + 1) & 2 == 0 { across } else { -across })
}

/// The same of four numbers at once, with the same bits.
#[inline]
pub fn sin_cos_of_turns_in_lanes(turns: f32x4) -> (f32x4, f32x4) {
    let quarters = turns * 4.0;
    let quadrants = (quarters + 0.5).fast_trunc_int();
    let (sine, cosine) = sin_cos_of_eighth((quarters - f32x4::from_i32x4(quadrants)) * FRAC_PI_2);
    let is_odd = f32x4::from_i32x4(quadrants & i32x4::ONE).simd_gt(f32x4::ZERO);
    let (along, across) = (is_odd.bitselect(cosine, sine), is_odd.bitselect(sine, cosine));
    let sign = |half_turn: i32x4| f32x4::from_i32x4(i32x4::ONE - (half_turn & i32x4::splat(2)));
    (along * sign(quadrants), across * sign(quadrants + i32x4::ONE))
}

/// Sine and cosine of an angle of at most pi / 4 in radians; of one, or of several at once.
#[inline]
fn sin_cos_of_eighth<T>(x: T) -> (T, T)
where
    T: Copy + From<f32> + Mul<Output = T> + Add<Output = T>,
{
    let series = |x2: T, coefficients: [f32; 5]| {
        let [first, others @ ..] = coefficients.map(T::from);
        others.into_iter().fold(first, |sum, coefficient| coefficient + x2 * sum)
    };
    let x2 = x * x;
    let sine = x * series(x2, [1.0 / 362_880.0, -1.0 / 5040.0, 1.0 / 120.0, -1.0 / 6.0, 1.0]);
    let cosine = series(x2, [1.0 / 40_320.0, -1.0 / 720.0, 1.0 / 24.0, -1.0 / 2.0, 1.0]);
    (sine, cosine)
}

/// e^(x²) (1 - erf x) for 0 <= x; a relative error below 3e-7.
///
/// t Q(2 t - 1) with t = 1 / (1 + 0.45 x), Q interpolated at Chebyshev points to degree 9 (error below 4e-8).
#[inline]
pub fn scaled_erfc(x: f32) -> f32 {
    const Q: [f32; 10] = [
        0.467_140_3,
        0.335_434_56,
        0.162_789_15,
        0.042_139_02,
        -0.002_857_009,
        -0.005_135_255_5,
        -0.000_146_666_25,
        0.000_699_645_14,
        1.688_738_6e-5,
        -8.063_934_7e-5,
    ];
    let t = 1.0 / (1.0 + 0.45 * x);
    t * polynomial(&Q, 2.0 * t - 1.0)
}

/// The number x of which (1 + erf x) / 2 is `u`, for 2^-32 <= u < 1; a relative error below 2e-6.
///
/// With w = -ln(4 u (1 - u)), x / (2 u - 1) is smooth in w and, beyond w = 5, in sqrt w; both interpolated at
/// Chebyshev points (after the idea of Giles, "Approximating the erfinv function", 2010).
#[inline]
pub fn inverse_gaussian_cdf(u: f32) -> f32 {
    const NEAR: [f32; 9] = [
        1.501_409_4,
        0.616_601_9,
        -0.026_108_686,
        -0.019_589_822,
        0.008_529_176,
        -0.000_428_089,
        -0.000_845_545_94,
        0.000_209_060_58,
        3.553_138e-5,
    ];
    const FAR: [f32; 8] =
        [3.403_519_5, 1.341_812_9, 0.005_185_172, -0.004_150_542, 0.002_392_318, -0.002_460_689_3, 0.002_730_615_3, -0.001_187_066];
    const FAR_START: f32 = 2.236_068;
    const FAR_END: f32 = 4.898_979_5;
    let w = -ln(4.0 * u * (1.0 - u));
    let ratio = if w < 5.0 {
        polynomial(&NEAR, (w - 2.5) / 2.5)
    } else {
        polynomial(&FAR, 2.0 * (w.sqrt() - FAR_START) / (FAR_END - FAR_START) - 1.0)
    };
    (2.0 * u - 1.0) * ratio
}

/// The sum of coefficients[k] x^k.
#[inline]
fn polynomial(coefficients: &[f32], x: f32) -> f32 {
    coefficients.iter().rev().fold(0.0, |sum, coefficient| sum * x + coefficient)
}

/// A direction about +z with density proportional to its z, for a point of [0, 1)²; its z may be 0.
///
/// The square goes to the disk by concentric squares (Shirley and Chiu, "A low distortion map between disk and
/// square", 1997), which keeps well spread points well spread, and from there up to the sphere.
#[inline]
pub fn cosine_hemisphere(point: [f32; 2]) -> [f32; 3] {
    let [x, y, radius] = concentric_disk(point);
    [x, y, ((1.0 - radius) * (1.0 + radius)).sqrt()]
}

/// A point of the unit disk, uniform by area, and its distance from the center, for a point of [0, 1)².
#[inline]
pub fn concentric_disk(point: [f32; 2]) -> [f32; 3] {
    let (a, b) = (2.0 * point[0] - 1.0, 2.0 * point[1] - 1.0);
    let is_wide = a.abs() > b.abs();
    let (long, short) = if is_wide { (a, b) } else { (b, a) };
    let ratio = if long == 0.0 { 0.0 } else { short / long };
    let (sine, cosine) = sin_cos_of_eighth(FRAC_PI_2 * 0.5 * ratio);
    let (x, y) = if is_wide { (cosine, sine) } else { (sine, cosine) };
    [long * x, long * y, long.abs()]
}

#[cfg(test)]
mod tests {
    use std::f32::consts::FRAC_2_SQRT_PI;

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
    fn exponentials_and_logarithms_agree_with_the_exact_ones() {
        for step in -8700..8800 {
            let x = step as f32 / 100.0;
            let error = (f64::from(exp(x)) / elementary::exp(f64::from(x)) - 1.0).abs();
            assert!(error < 2e-7 * f64::from(x.abs()).max(1.0), "exp {x}: {error}");
        }
        for x in numbers() {
            let exact = elementary::ln(f64::from(x));
            assert!((f64::from(ln(x)) - exact).abs() < 2e-7 * exact.abs().max(1.0), "ln {x}");
        }
    }

    #[test]
    fn sines_and_cosines_agree_with_the_exact_ones() {
        for step in 0..=100_000_u32 {
            let turns = step as f32 / 100_000.0;
            let (sine, cosine) = sin_cos_of_turns(turns);
            let (exact_sine, exact_cosine) = elementary::sin_cos(2.0 * std::f64::consts::PI * f64::from(turns));
            assert!((f64::from(sine) - exact_sine).abs() < 1.5e-7, "{turns}");
            assert!((f64::from(cosine) - exact_cosine).abs() < 1.5e-7, "{turns}");
            let lanes = sin_cos_of_turns_in_lanes(f32x4::new([turns, 0.0, 1.0, turns]));
            assert_eq!([lanes.0.to_array()[3], lanes.1.to_array()[3]], [sine, cosine], "{turns}");
        }
    }

    #[test]
    fn scaled_error_functions_agree_with_the_exact_ones() {
        for step in 0..=2000_u32 {
            let x = step as f32 / 400.0;
            let wide = f64::from(x);
            let exact = elementary::exp(wide * wide) * (1.0 - elementary::erf(wide));
            // 1 - erf loses digits beyond x = 2: there by the continued fraction.
            let exact = if x < 2.0 { exact } else { continued_fraction(wide) };
            let error = (f64::from(scaled_erfc(x)) / exact - 1.0).abs();
            assert!(error < 3e-7, "{x}: {error}");
        }
        assert!((scaled_erfc(100.0) * 100.0 / (FRAC_2_SQRT_PI / 2.0) - 1.0).abs() < 1e-4);
    }

    /// e^(x²) erfc x = (1 / sqrt pi) / (x + (1/2) / (x + 1 / (x + (3/2) / (x + ...)))).
    fn continued_fraction(x: f64) -> f64 {
        let tail = (1..200).rev().fold(x, |tail, k| x + f64::from(k) / 2.0 / tail);
        f64::from(FRAC_2_SQRT_PI) / 2.0 / tail
    }

    #[test]
    fn the_inverse_leads_back_to_the_probability() {
        for step in 1..10_000_u32 {
            let u = step as f32 / 10_000.0;
            let back = 0.5 * (1.0 + elementary::erf(f64::from(inverse_gaussian_cdf(u))));
            assert!((back - f64::from(u)).abs() < 3e-7, "{u}: {back}");
        }
        // Published quantiles: erf^-1(2u - 1) is the normal quantile over sqrt 2.
        for (u, quantile) in [(1e-3_f32, -3.090_232_3_f32), (1e-6, -4.753_424), (0.975, 1.959_964)] {
            assert!((inverse_gaussian_cdf(u) * std::f32::consts::SQRT_2 / quantile - 1.0).abs() < 1e-5, "{u}");
        }
        assert!(inverse_gaussian_cdf(2.3e-10).is_finite());
    }

    #[test]
    fn concentric_squares_become_concentric_circles_of_equal_area() {
        let side = 200_u32;
        let mut moments = [0.0_f64; 4];
        for k in 0..side * side {
            let point = [k % side, k / side].map(|index| (index as f32 + 0.5) / side as f32);
            let [x, y, radius] = concentric_disk(point);
            assert!((x * x + y * y - radius * radius).abs() < 4e-7);
            let half_side = (2.0 * point[0] - 1.0).abs().max((2.0 * point[1] - 1.0).abs());
            assert_eq!(radius, half_side);
            let square = f64::from(x * x);
            for (moment, value) in moments.iter_mut().zip([f64::from(x), f64::from(y), square, f64::from(y * y) * square]) {
                *moment += value / f64::from(side * side);
            }
        }
        // Of the uniform disk: E x = E y = 0, E x² = 1/4, E x² y² = 1/24.
        for (moment, exact) in moments.into_iter().zip([0.0, 0.0, 0.25, 1.0 / 24.0]) {
            assert!((moment - exact).abs() < 1e-4, "{moment} instead of {exact}");
        }
        for corner in [[0.0, 0.0], [0.5, 0.5], [0.0, 0.5], [0.999_999_94, 0.0]] {
            let [x, y, z] = cosine_hemisphere(corner);
            assert!((x * x + y * y + z * z - 1.0).abs() < 4e-7 && z >= 0.0, "{corner:?}");
        }
    }
}

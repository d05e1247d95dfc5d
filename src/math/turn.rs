//! The angle of a vector as a fraction of a whole turn, in single precision, for the renderer's inner loops.
//!
//! Only additions, multiplications, divisions and selections, so that they give the same answer on every machine
//! and the compiler may compute several at once. Where eight digits matter use `elementary`; the way back is
//! `single::sin_cos_of_turns`.

use std::f32::consts::{FRAC_PI_4, PI};

/// The angle of the vector (x, y) from +x towards +y as a fraction of a turn in [0, 1); error below 1e-7.
///
/// Zero for the zero vector. Within the octant the angle is reduced by another eighth of a turn, so that the
/// argument of the series of the arc tangent is at most tan(pi / 8).
#[inline]
pub fn of_vector(x: f32, y: f32) -> f32 {
    const TAN_EIGHTH: f32 = 0.414_213_57;
    let (ax, ay) = (x.abs(), y.abs());
    let (low, high) = if ax < ay { (ax, ay) } else { (ay, ax) };
    let is_steep = low > TAN_EIGHTH * high;
    let (above, below) = if is_steep { (low - high, low + high) } else { (low, high) };
    let t = if below > 0.0 { above / below } else { 0.0 };
    let t2 = t * t;
    let series =
        t * (1.0 - t2 * (1.0 / 3.0 - t2 * (1.0 / 5.0 - t2 * (1.0 / 7.0 - t2 * (1.0 / 9.0 - t2 * (1.0 / 11.0 - t2 * (1.0 / 13.0)))))));
    let in_octant = (if is_steep { FRAC_PI_4 + series } else { series }) * (0.5 / PI);
    let in_quadrant = if ax < ay { 0.25 - in_octant } else { in_octant };
    let in_half = if x < 0.0 { 0.5 - in_quadrant } else { in_quadrant };
    if y >= 0.0 || in_half == 0.0 { in_half } else { below_one(1.0 - in_half) }
}

/// A tiny negative turn rounds up to one whole turn, which is none.
#[inline]
fn below_one(turn: f32) -> f32 {
    if turn < 1.0 { turn } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::elementary;

    #[test]
    fn angles_agree_with_the_exact_ones() {
        for k in 0..40_000 {
            let angle = f64::from(k) / 40_000.0;
            let (sine, cosine) = elementary::sin_cos(angle * std::f64::consts::TAU);
            for length in [1e-20, 1.0, 1e20] {
                let found = of_vector((cosine * length) as f32, (sine * length) as f32);
                assert!((0.0..1.0).contains(&found));
                let error = (f64::from(found) - angle).abs();
                assert!(error.min(1.0 - error) < 1e-7, "{angle}: {found}");
            }
        }
        assert_eq!([of_vector(0.0, 0.0), of_vector(1.0, 0.0), of_vector(1.0, -0.0), of_vector(1.0, -1e-30)], [0.0; 4]);
        assert_eq!([of_vector(0.0, 1.0), of_vector(-1.0, 0.0), of_vector(-1.0, -0.0), of_vector(0.0, -1.0)], [0.25, 0.5, 0.5, 0.75]);
    }
}

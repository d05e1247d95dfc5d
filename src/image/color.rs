//! Luminance, sRGB, CIELAB, and the opponent space in which FLIP filters.
//!
//! Linear RGB has the Rec. 709 primaries and the white D65. Curves in f64 serve encodings that are kept;
//! the conversions in f32 serve loops over pixels and vectorize.

use crate::math::elementary;
use crate::math::single;

/// Weights of linear red, green and blue in luminance (ITU-R BT.709).
pub const REC709_WEIGHTS: [f64; 3] = [0.2126, 0.7152, 0.0722];

/// Luminance 0.2126 R + 0.7152 G + 0.0722 B of a linear color.
pub fn luminance(color: [f32; 3]) -> f64 {
    let [r, g, b] = color.map(f64::from);
    REC709_WEIGHTS[0] * r + REC709_WEIGHTS[1] * g + REC709_WEIGHTS[2] * b
}

/// Encodes a linear value in [0, 1] by the curve of sRGB (IEC 61966-2-1).
///
/// 12.92 v up to v = 0.0031308, above 1.055 v^(1/2.4) - 0.055.
pub fn srgb_encode(v: f64) -> f64 {
    if v <= 0.003_130_8 { 12.92 * v } else { 1.055 * elementary::pow(v, 1.0 / 2.4) - 0.055 }
}

/// Decodes an sRGB value in [0, 1] to a linear one (IEC 61966-2-1).
pub fn srgb_decode(v: f64) -> f64 {
    if v <= 0.040_45 { v / 12.92 } else { elementary::pow((v + 0.055) / 1.055, 2.4) }
}

/// Linear RGB to CIE XYZ: the matrix that follows from the chromaticities of Rec. 709 and D65 (0.3127, 0.3290).
pub const XYZ_OF_RGB: [[f32; 3]; 3] =
    [[0.412_386_56, 0.357_591_49, 0.180_450_49], [0.212_636_82, 0.715_182_98, 0.072_180_2], [0.019_330_62, 0.119_197_16, 0.950_372_6]];

/// CIE XYZ to linear RGB: the inverse of [`XYZ_OF_RGB`].
pub const RGB_OF_XYZ: [[f32; 3]; 3] =
    [[3.241_003_2, -1.537_398_9, -0.498_615_86], [-0.969_224_33, 1.875_930_1, 0.041_554_224], [0.055_639_423, -0.204_011_2, 1.057_148_9]];

/// XYZ of the white (1, 1, 1).
pub const WHITE_XYZ: [f32; 3] = [0.950_428_55, 1.0, 1.088_900_3];

/// Linear RGB to YCxCz without its constants: (Yn, Xn - Yn, Yn - Zn), each of X, Y, Z over that of white.
///
/// YCxCz is (116 Yn - 16, 500 (Xn - Yn), 200 (Yn - Zn)); a filter whose weights sum to one does not see
/// the constants. Black is (0, 0, 0) and white (1, 0, 0).
#[inline]
pub fn opponent(color: [f32; 3]) -> [f32; 3] {
    let [x, y, z] = multiplied(&XYZ_OF_RGB, color);
    let [xn, yn, zn] = [x / WHITE_XYZ[0], y / WHITE_XYZ[1], z / WHITE_XYZ[2]];
    [yn, xn - yn, yn - zn]
}

/// The inverse of [`opponent`].
#[inline]
pub fn linear_of_opponent(opponent: [f32; 3]) -> [f32; 3] {
    let [yn, red_green, blue_yellow] = opponent;
    let xyz = [(red_green + yn) * WHITE_XYZ[0], yn * WHITE_XYZ[1], (yn - blue_yellow) * WHITE_XYZ[2]];
    multiplied(&RGB_OF_XYZ, xyz)
}

/// CIELAB (L*, a*, b*) of a linear color with non-negative X, Y and Z; L* of white is 100.
#[inline]
pub fn lab(color: [f32; 3]) -> [f32; 3] {
    let [x, y, z] = multiplied(&XYZ_OF_RGB, color);
    let [fx, fy, fz] = [x / WHITE_XYZ[0], y / WHITE_XYZ[1], z / WHITE_XYZ[2]].map(lab_curve);
    [116.0 * fy - 16.0, 500.0 * (fx - fy), 200.0 * (fy - fz)]
}

/// f(t) = cube root of t above (6/29)³, below t / (3 (6/29)²) + 4/29.
#[inline]
fn lab_curve(t: f32) -> f32 {
    const DELTA: f32 = 6.0 / 29.0;
    let root = single::cube_root(t.max(DELTA * DELTA * DELTA));
    let line = t * (1.0 / (3.0 * DELTA * DELTA)) + 4.0 / 29.0;
    if t > DELTA * DELTA * DELTA { root } else { line }
}

#[inline]
fn multiplied(matrix: &[[f32; 3]; 3], v: [f32; 3]) -> [f32; 3] {
    matrix.map(|row| row[0] * v[0] + row[1] * v[1] + row[2] * v[2])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn srgb_meets_its_published_anchors() {
        assert_eq!(srgb_encode(0.0), 0.0);
        assert!((srgb_encode(1.0) - 1.0).abs() < 1e-15);
        assert!((srgb_encode(0.18) - 0.461_356).abs() < 5e-7);
        // The eight-bit code 188 is the middle of light.
        assert!((srgb_decode(188.0 / 255.0) - 0.502_886).abs() < 5e-7);
    }

    #[test]
    fn srgb_decodes_what_it_encodes() {
        for code in 0..=65535_u32 {
            let encoded = f64::from(code) / 65535.0;
            // The standard's two breakpoints are rounded: there, the branches differ by about 1e-8.
            assert!((srgb_encode(srgb_decode(encoded)) - encoded).abs() < 2e-7, "{code}");
        }
    }

    #[test]
    fn white_has_lightness_100_and_no_color() {
        let [l, a, b] = lab([1.0, 1.0, 1.0]);
        assert!((l - 100.0).abs() < 1e-4 && a.abs() < 1e-3 && b.abs() < 1e-3, "{l} {a} {b}");
        let [yn, red_green, blue_yellow] = opponent([1.0, 1.0, 1.0]);
        assert!((yn - 1.0).abs() < 1e-6 && red_green.abs() < 1e-6 && blue_yellow.abs() < 1e-6);
    }

    #[test]
    fn primaries_have_their_published_lab_values() {
        // Lindbloom's calculator, sRGB with D65 and without adaptation.
        let published = [
            ([1.0, 0.0, 0.0], [53.24, 80.09, 67.20]),
            ([0.0, 1.0, 0.0], [87.73, -86.18, 83.18]),
            ([0.0, 0.0, 1.0], [32.30, 79.19, -107.86]),
        ];
        for (color, expected) in published {
            for (found, expected) in lab(color).into_iter().zip(expected) {
                // White points that differ in the fourth digit move b* by some hundredths.
                assert!((found - expected).abs() < 0.06, "{color:?}: {found} for {expected}");
            }
        }
    }

    #[test]
    fn opponent_colors_turn_back() {
        for color in [[0.2, 0.5, 0.9], [1.0, 0.0, 0.0], [0.01, 0.02, 0.005]] {
            for (found, expected) in linear_of_opponent(opponent(color)).into_iter().zip(color) {
                assert!((found - expected).abs() < 2e-6, "{found} for {expected}");
            }
        }
    }

    #[test]
    fn luminance_of_white_is_one() {
        assert!((luminance([1.0; 3]) - 1.0).abs() < 1e-15);
    }
}

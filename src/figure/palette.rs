//! Colors and shapes that stay apart in print, in grey and for color-blind readers.
//!
//! Okabe and Ito, "Color universal design" (2008), in an order in which the first ones differ most in
//! lightness on white; yellow, too light for a line, is left out. The map for heat is viridis
//! (van der Walt and Smith, 2015, CC0), by its ninths.

use super::canvas::Ink;

/// Text and frame.
pub const BLACK: Ink = Ink::opaque([0x1a, 0x1a, 0x1a]);
/// Text of less weight.
pub const GREY: Ink = Ink::opaque([0x55, 0x55, 0x55]);
/// Lines at the labelled values.
pub const GRID: Ink = Ink::opaque([0xdd, 0xdd, 0xdd]);
/// Lines between the labelled values.
pub const FINE_GRID: Ink = Ink::opaque([0xf1, 0xf1, 0xf1]);
/// The paper.
pub const WHITE: Ink = Ink::opaque([0xff, 0xff, 0xff]);

const HUES: [[u8; 3]; 7] = [
    [0x00, 0x72, 0xb2], // blue
    [0xd5, 0x5e, 0x00], // vermilion
    [0x00, 0x9e, 0x73], // bluish green
    [0xcc, 0x79, 0xa7], // reddish purple
    [0xe6, 0x9f, 0x00], // orange
    [0x56, 0xb4, 0xe9], // sky blue
    [0x33, 0x33, 0x33], // black
];

/// The color of curve number `index`; begins again after seven.
pub fn hue(index: usize) -> Ink {
    Ink::opaque(HUES[index % HUES.len()])
}

/// Dash lengths in points of line style number `index`; the first is unbroken.
pub fn dashes(index: usize) -> &'static [f64] {
    const STYLES: [&[f64]; 4] = [&[], &[5.0, 2.2], &[1.3, 1.8], &[6.0, 2.0, 1.3, 2.0]];
    STYLES[index % STYLES.len()]
}

/// The outline of marker number `index` about the origin, for a disk of radius 1; `None` is the disk.
pub fn marker(index: usize) -> Option<&'static [[f64; 2]]> {
    const SQUARE: [[f64; 2]; 4] = [[-0.88, -0.88], [0.88, -0.88], [0.88, 0.88], [-0.88, 0.88]];
    const UP: [[f64; 2]; 3] = [[0.0, -1.3], [1.15, 0.75], [-1.15, 0.75]];
    const DIAMOND: [[f64; 2]; 4] = [[0.0, -1.3], [1.3, 0.0], [0.0, 1.3], [-1.3, 0.0]];
    const DOWN: [[f64; 2]; 3] = [[0.0, 1.3], [1.15, -0.75], [-1.15, -0.75]];
    const PLUS: [[f64; 2]; 12] = [
        [-0.4, -1.2],
        [0.4, -1.2],
        [0.4, -0.4],
        [1.2, -0.4],
        [1.2, 0.4],
        [0.4, 0.4],
        [0.4, 1.2],
        [-0.4, 1.2],
        [-0.4, 0.4],
        [-1.2, 0.4],
        [-1.2, -0.4],
        [-0.4, -0.4],
    ];
    const CROSS: [[f64; 2]; 12] = [
        [-1.15, -0.65],
        [-0.65, -1.15],
        [0.0, -0.5],
        [0.65, -1.15],
        [1.15, -0.65],
        [0.5, 0.0],
        [1.15, 0.65],
        [0.65, 1.15],
        [0.0, 0.5],
        [-0.65, 1.15],
        [-1.15, 0.65],
        [-0.5, 0.0],
    ];
    const SHAPES: [Option<&[[f64; 2]]>; 7] = [None, Some(&SQUARE), Some(&UP), Some(&DIAMOND), Some(&DOWN), Some(&PLUS), Some(&CROSS)];
    SHAPES[index % SHAPES.len()]
}

/// The color of heat, from 0 (dark violet) to 1 (yellow); monotonic in lightness.
pub fn heat(fraction: f64) -> Ink {
    const STOPS: [[u8; 3]; 9] = [
        [0x44, 0x01, 0x54],
        [0x47, 0x2d, 0x7b],
        [0x3b, 0x52, 0x8b],
        [0x2c, 0x72, 0x8e],
        [0x21, 0x91, 0x8c],
        [0x28, 0xae, 0x80],
        [0x5e, 0xc9, 0x62],
        [0xad, 0xdc, 0x30],
        [0xfd, 0xe7, 0x25],
    ];
    let position = fraction.clamp(0.0, 1.0) * (STOPS.len() - 1) as f64;
    let below = (position as usize).min(STOPS.len() - 2);
    let t = position - below as f64;
    Ink::opaque([0, 1, 2].map(|k| (f64::from(STOPS[below][k]) * (1.0 - t) + f64::from(STOPS[below + 1][k]) * t).round() as u8))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn heat_grows_lighter() {
        let lightness = |ink: Ink| 0.2126 * f64::from(ink.rgb[0]) + 0.7152 * f64::from(ink.rgb[1]) + 0.0722 * f64::from(ink.rgb[2]);
        let steps: Vec<f64> = (0..=64).map(|step| lightness(heat(f64::from(step) / 64.0))).collect();
        assert!(steps.windows(2).all(|pair| pair[0] < pair[1]));
    }
}

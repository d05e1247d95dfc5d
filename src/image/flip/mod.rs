//! FLIP: the difference that a person sees who flips between two images, and its form for high dynamic range.
//!
//! Two pipelines meet in each pixel. Color: the images are filtered by the eye's contrast sensitivity and
//! compared in CIELAB. Features: edges and points that only one of them has raise the color error. The
//! result is 0 (no difference) to 1. HDR-FLIP shows both images at a range of exposures through a tone curve
//! and takes the greatest error of each pixel. Reading order: `filters`, this file, `view`.
//!
//! After Andersson, Nilsson, Akenine-Möller, Oskarsson, Åström and Fairchild, "FLIP: a difference evaluator for
//! alternating images" (HPG 2020), and Andersson, Nilsson, Shirley and Akenine-Möller, "Visualizing errors
//! in rendered high dynamic range images" (Eurographics short papers 2021).

mod filters;
mod view;

use rayon::prelude::*;

use crate::image::color;
use crate::image::raster::{Plane, Raster};
use crate::math::elementary;
use crate::math::single;

use filters::Filters;
use view::{SeenRow, View};

/// Pixels in one degree of the visual field if nothing else is known.
///
/// A display 0.7 m wide with 3840 pixels seen from 0.7 m has 67.02; the papers say 67.
pub const DEFAULT_PIXELS_PER_DEGREE: f64 = 67.0;

/// Exponent of the color difference (q_c in the paper).
const COLOR_EXPONENT: f32 = 0.7;
/// Differences up to this part of the greatest one share the range 0 to `CUT_ERROR` (p_c).
const CUT_DIFFERENCE: f32 = 0.4;
/// Color error at the cut (p_t).
const CUT_ERROR: f32 = 0.95;
/// Rows that are worked on together; results do not depend on it.
const STRIP_ROWS: usize = 64;

/// Exposures at which HDR-FLIP looks.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ExposureRange {
    /// The darkest exposure in stops.
    pub start_stops: f64,
    /// The brightest exposure in stops, not below `start_stops`.
    pub stop_stops: f64,
    /// How many, evenly spaced, both ends included; one shows `start_stops` alone.
    pub count: usize,
}

impl ExposureRange {
    /// The papers' range for a reference: from where its brightest pixel leaves the tone curve's shoulder to
    /// where its median does, in steps of about one stop.
    ///
    /// With x the input that the curve takes to 0.85: log2(x / greatest luminance) to log2(x / median
    /// luminance). `luminances` may have any order and are reordered; of an even number of them the median
    /// is the upper of the two in the middle, and 2^-23 stands for anything darker.
    pub fn of_luminances(luminances: &mut [f32]) -> Self {
        let shoulder = shoulder_of_tone_curve();
        let stops_to_shoulder = |luminance: f32| elementary::log2(shoulder / f64::from(luminance.max(f32::EPSILON)));
        let greatest = luminances.iter().copied().fold(0.0, f32::max);
        let middle = luminances.len() / 2;
        let median = if luminances.is_empty() { 0.0 } else { *luminances.select_nth_unstable_by(middle, f32::total_cmp).1 };
        Self::one_per_stop(stops_to_shoulder(greatest), stops_to_shoulder(median))
    }

    /// Exposures between these, both included, about one stop apart: max(2, ceil(stop - start)) of them.
    pub fn one_per_stop(start_stops: f64, stop_stops: f64) -> Self {
        Self { start_stops, stop_stops, count: ((stop_stops - start_stops).ceil() as usize).max(2) }
    }

    /// The exposures in stops, each once.
    pub fn stops(&self) -> Vec<f64> {
        let step = (self.stop_stops - self.start_stops) / (self.count.max(2) - 1) as f64;
        let mut stops: Vec<f64> = (0..self.count.max(1)).map(|index| self.start_stops + index as f64 * step).collect();
        stops.dedup();
        stops
    }
}

/// The FLIP error of each pixel between images for a display: linear, in [0, 1]; what lies outside is clamped.
///
/// `pixels_per_degree` is 1 to 1000. `check` is asked for each strip of rows.
///
/// # Panics
/// If the sizes differ.
pub fn flip<E: Send>(
    reference: &Raster,
    test: &Raster,
    pixels_per_degree: f64,
    check: impl Fn() -> Result<(), E> + Sync,
) -> Result<Plane, E> {
    greatest_error(reference, test, pixels_per_degree, &[Display::Clamped], check)
}

/// The HDR-FLIP error of each pixel: the greatest FLIP error over the exposures, through the ACES tone curve.
///
/// Images are linear; what is negative or not a number counts as zero. `check` is asked for each strip of
/// rows at each exposure.
///
/// # Panics
/// If the sizes differ.
pub fn hdr_flip<E: Send>(
    reference: &Raster,
    test: &Raster,
    pixels_per_degree: f64,
    exposures: &ExposureRange,
    check: impl Fn() -> Result<(), E> + Sync,
) -> Result<Plane, E> {
    let exposed = |stops: f64| Display::ToneMapped { scale: elementary::exp2(stops) as f32 };
    let displays: Vec<Display> = exposures.stops().into_iter().map(exposed).collect();
    greatest_error(reference, test, pixels_per_degree, &displays, check)
}

/// How linear values come to the display.
#[derive(Clone, Copy)]
enum Display {
    /// Clamped to [0, 1].
    Clamped,
    /// Scaled, through the tone curve, and clamped.
    ToneMapped { scale: f32 },
}

impl Display {
    #[inline]
    fn shown(self, color: [f32; 3]) -> [f32; 3] {
        match self {
            Self::Clamped => color.map(|v| positive(v).min(1.0)),
            Self::ToneMapped { scale } => color.map(|v| tone_curve((positive(v) * scale).min(BRIGHTEST))),
        }
    }
}

/// The value, or 0 where it is negative or not a number.
#[inline]
fn positive(v: f32) -> f32 {
    if v > 0.0 { v } else { 0.0 }
}

/// Far up the shoulder, where the curve is above 1; keeps infinities out of its fraction.
const BRIGHTEST: f32 = 1e6;

/// Numerator and denominator of Narkowicz's fit of the ACES curve, its input scaled by 0.6 as the paper does.
const TONE_NUMERATOR: [f32; 3] = [0.0, 0.6 * 0.03, 0.6 * 0.6 * 2.51];
/// See [`TONE_NUMERATOR`].
const TONE_DENOMINATOR: [f32; 3] = [0.14, 0.6 * 0.59, 0.6 * 0.6 * 2.43];

#[inline]
fn tone_curve(x: f32) -> f32 {
    let [n0, n1, n2] = TONE_NUMERATOR;
    let [d0, d1, d2] = TONE_DENOMINATOR;
    ((x * (x * n2 + n1) + n0) / (x * (x * d2 + d1) + d0)).min(1.0)
}

/// The input that the tone curve takes to 0.85, from a quadratic equation.
fn shoulder_of_tone_curve() -> f64 {
    const TARGET: f64 = 0.85;
    let [c, b, a] = std::array::from_fn(|power| f64::from(TONE_NUMERATOR[power]) - TARGET * f64::from(TONE_DENOMINATOR[power]));
    (-b + (b * b - 4.0 * a * c).sqrt()) / (2.0 * a)
}

fn greatest_error<E: Send>(
    reference: &Raster,
    test: &Raster,
    pixels_per_degree: f64,
    displays: &[Display],
    check: impl Fn() -> Result<(), E> + Sync,
) -> Result<Plane, E> {
    let (width, height) = (reference.width(), reference.height());
    assert_eq!((width, height), (test.width(), test.height()), "FLIP compares images of one size");
    let mut values = vec![0.0_f32; width * height];
    if values.is_empty() {
        return Ok(Plane { width, height, values });
    }

    let filters = Filters::new(pixels_per_degree);
    let errors = PixelError::new();
    // A strip filters the rows above and below it too; taller strips keep that share small.
    let strip_rows = STRIP_ROWS.max(4 * filters.radius());
    values.par_chunks_mut(strip_rows * width).enumerate().try_for_each(|(strip, values)| {
        let first_row = strip * strip_rows;
        let mut views = [View::new(reference, &filters, first_row, strip_rows), View::new(test, &filters, first_row, strip_rows)];
        let mut seen = [SeenRow::new(width), SeenRow::new(width)];
        for display in displays {
            check()?;
            views.iter_mut().for_each(|view| view.look(|color| display.shown(color)));
            for (row, values) in values.chunks_mut(width).enumerate() {
                views.iter().zip(&mut seen).for_each(|(view, seen)| view.write_row(row, seen));
                errors.raise_to(values, &seen[0], &seen[1]);
            }
        }
        Ok(())
    })?;
    Ok(Plane { width, height, values })
}

/// The last steps of FLIP, pixel by pixel.
struct PixelError {
    /// The greatest color difference: pure green against pure blue.
    greatest_difference: f32,
}

impl PixelError {
    fn new() -> Self {
        let [green, blue] = [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(hunt_lab);
        Self { greatest_difference: single::power(hyab(green, blue), COLOR_EXPONENT) }
    }

    /// Raises each of `errors` to the error between two rows, if that is greater.
    fn raise_to(&self, errors: &mut [f32], reference: &SeenRow, test: &SeenRow) {
        let color_of = |row: &SeenRow, x: usize| [row.lightness[x], row.a[x], row.b[x]];
        for (x, error) in errors.iter_mut().enumerate() {
            let color_error = self.color_error(hyab(color_of(reference, x), color_of(test, x)));
            let edge = (reference.edge[x] - test.edge[x]).abs();
            let point = (reference.point[x] - test.point[x]).abs();
            // ((1 / sqrt 2) max(...))^q_f with q_f = 1/2.
            let feature_error = (std::f32::consts::FRAC_1_SQRT_2 * edge.max(point)).sqrt();
            *error = error.max(single::power(color_error, 1.0 - feature_error).min(1.0));
        }
    }

    /// Maps a difference to [0, 1], with most of that range for small ones.
    fn color_error(&self, difference: f32) -> f32 {
        let powered = single::power(difference, COLOR_EXPONENT);
        let cut = CUT_DIFFERENCE * self.greatest_difference;
        let below = CUT_ERROR / cut * powered;
        let above = CUT_ERROR + (powered - cut) / (self.greatest_difference - cut) * (1.0 - CUT_ERROR);
        if powered < cut { below } else { above }
    }
}

/// CIELAB with a* and b* scaled by 0.01 L*: colors look weaker where it is dark (Hunt effect).
#[inline]
fn hunt_lab(color: [f32; 3]) -> [f32; 3] {
    let [lightness, a, b] = color::lab(color);
    [lightness, 0.01 * lightness * a, 0.01 * lightness * b]
}

/// |ΔL| + sqrt(Δa² + Δb²): city block in lightness, Euclidean in color, made for large differences.
#[inline]
fn hyab(one: [f32; 3], other: [f32; 3]) -> f32 {
    let [lightness, a, b]: [f32; 3] = std::array::from_fn(|channel| one[channel] - other[channel]);
    lightness.abs() + (a * a + b * b).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::convert::Infallible;

    fn checked() -> Result<(), Infallible> {
        Ok(())
    }

    fn flip_of(reference: &Raster, test: &Raster, pixels_per_degree: f64) -> Plane {
        flip(reference, test, pixels_per_degree, checked).unwrap()
    }

    fn mean(plane: &Plane) -> f64 {
        plane.values.iter().copied().map(f64::from).sum::<f64>() / plane.values.len() as f64
    }

    fn constant_error(reference: [f32; 3], test: [f32; 3]) -> f32 {
        let error = flip_of(&Raster::filled(5, 4, reference), &Raster::filled(5, 4, test), 67.0);
        assert!(error.values.iter().all(|v| (v - error.values[0]).abs() < 1e-6), "the error of constants is constant");
        error.values[0]
    }

    /// A slow ramp in each channel under a fine pattern of period `modulus`, made of exact small integers.
    fn patterned(a: usize, b: usize, c: usize, modulus: usize) -> Raster {
        let (width, height) = (53, 37);
        let pixel = |index: usize| {
            let (x, y) = (index % width, index / width);
            let ramps = [x as f64 / 52.0, y as f64 / 36.0, (x + y) as f64 / 88.0];
            std::array::from_fn(|channel| {
                let pattern = ((x * a + y * b + x * y * c + channel * 5) % modulus) as f64 / (modulus - 1) as f64;
                (0.75 * ramps[channel] + 0.25 * pattern) as f32
            })
        };
        Raster::new(width, height, (0..width * height).map(pixel).collect())
    }

    fn patterned_pair() -> [Raster; 2] {
        [patterned(7, 13, 3, 32), patterned(5, 11, 2, 27)]
    }

    /// The fourth power, twenty times as bright: some stops between shadows and lights.
    fn stretched(raster: &Raster) -> Raster {
        let stretch = |v: f32| 20.0 * (v * v) * (v * v);
        Raster::new(raster.width(), raster.height(), raster.pixels().iter().map(|color| color.map(stretch)).collect())
    }

    /// Golden: means and the pixels (0, 0), (26, 18), (52, 36) and (5, 30) of the authors' flip-evaluator 1.7.
    fn assert_agrees(plane: &Plane, golden_mean: f64, golden_pixels: [f32; 4]) {
        // Both compute in f32, in another order; FLIP's powers below one magnify small differences.
        assert!((mean(plane) / golden_mean - 1.0).abs() < 1e-5, "{} for {golden_mean}", mean(plane));
        for ((x, y), golden) in [(0, 0), (26, 18), (52, 36), (5, 30)].into_iter().zip(golden_pixels) {
            let found = plane.values[y * plane.width + x];
            assert!((found - golden).abs() < 2e-5, "({x}, {y}): {found} for {golden}");
        }
    }

    #[test]
    fn flip_agrees_with_its_authors_program() {
        let [reference, test] = patterned_pair();
        let near = [0.130_561_14, 0.170_243_16, 0.194_227_28, 0.102_798];
        assert_agrees(&flip_of(&reference, &test, 67.0), 0.159_965_938, near);
        let far = [0.189_726_96, 0.319_986_82, 0.353_213_6, 0.140_082_91];
        assert_agrees(&flip_of(&reference, &test, 25.0), 0.323_611_962, far);
    }

    #[test]
    fn hdr_flip_agrees_with_its_authors_program() {
        let [reference, test] = patterned_pair().map(|raster| stretched(&raster));
        let mut luminances: Vec<f32> = reference.pixels().iter().map(|color| color::luminance(*color) as f32).collect();
        let exposures = ExposureRange::of_luminances(&mut luminances);
        assert!((exposures.start_stops - -2.923_838_6).abs() < 2e-6, "{exposures:?}");
        assert!((exposures.stop_stops - 0.025_019_391).abs() < 2e-6, "{exposures:?}");
        assert_eq!(exposures.count, 3);
        let error = hdr_flip(&reference, &test, 67.0, &exposures, checked).unwrap();
        assert_agrees(&error, 0.268_948_346, [0.156_454_44, 0.350_949_1, 0.202_044_08, 0.200_789_27]);
    }

    #[test]
    fn constants_have_their_closed_form() {
        // By the published CIELAB values of the primaries, with the Hunt effect.
        let [green, blue] = [[87.73, -86.18 * 0.8773, 83.18 * 0.8773], [32.30, 79.19 * 0.3230, -107.86 * 0.3230]];
        let chroma = elementary::hypot(green[1] - blue[1], green[2] - blue[2]);
        let greatest = elementary::pow(green[0] - blue[0] + chroma, 0.7);
        let lightness = |v: f64| 116.0 * elementary::cbrt(v) - 16.0;
        let between_greys = 0.95 / (0.4 * greatest) * elementary::pow(lightness(0.5) - lightness(0.25), 0.7);
        assert!((f64::from(constant_error([0.5; 3], [0.25; 3])) - between_greys).abs() < 3e-4, "{between_greys}");
        let white_and_black = 0.95 + 0.05 * (elementary::pow(100.0, 0.7) - 0.4 * greatest) / (0.6 * greatest);
        assert!((f64::from(constant_error([1.0; 3], [0.0; 3])) - white_and_black).abs() < 3e-4, "{white_and_black}");
        assert!((constant_error([0.0, 1.0, 0.0], [0.0, 0.0, 1.0]) - 1.0).abs() < 1e-6);
    }

    #[test]
    fn equal_images_have_no_error_and_order_does_not_matter() {
        let [reference, test] = patterned_pair();
        assert!(flip_of(&reference, &reference, 67.0).values.iter().all(|v| *v == 0.0));
        assert_eq!(flip_of(&reference, &test, 67.0), flip_of(&test, &reference, 67.0));
    }

    #[test]
    fn a_mirrored_pair_has_the_mirrored_error() {
        let mirrored = |raster: &Raster| {
            let rows = (0..raster.height()).flat_map(|y| raster.row(y).iter().rev().copied().collect::<Vec<_>>());
            Raster::new(raster.width(), raster.height(), rows.collect())
        };
        let [reference, test] = patterned_pair();
        let straight = flip_of(&reference, &test, 67.0);
        let turned = flip_of(&mirrored(&reference), &mirrored(&test), 67.0);
        for (row, turned_row) in straight.values.chunks(straight.width).zip(turned.values.chunks(straight.width)) {
            for (one, other) in row.iter().zip(turned_row.iter().rev()) {
                // Sums run through their terms in the other order.
                assert!((one - other).abs() < 2e-5, "{one} {other}");
            }
        }
    }

    #[test]
    fn a_transposed_pair_has_the_transposed_error() {
        let transposed = |raster: &Raster| {
            let (width, height) = (raster.height(), raster.width());
            let pixel = |index: usize| raster.pixel(index / width, index % width);
            Raster::new(width, height, (0..width * height).map(pixel).collect())
        };
        let [reference, test] = patterned_pair();
        let straight = flip_of(&reference, &test, 67.0);
        let turned = flip_of(&transposed(&reference), &transposed(&test), 67.0);
        for y in 0..straight.height {
            for x in 0..straight.width {
                let (one, other) = (straight.values[y * straight.width + x], turned.values[x * turned.width + y]);
                assert!((one - other).abs() < 2e-5, "({x}, {y}): {one} {other}");
            }
        }
    }

    #[test]
    fn a_strip_border_does_not_show() {
        // At ten pixels a degree strips are 64 rows high; 150 rows of the same columns must all agree.
        let columns = |a: usize| {
            let pixel = |index: usize| [((index % 40) * a % 11) as f32 / 10.0; 3];
            Raster::new(40, 150, (0..40 * 150).map(pixel).collect())
        };
        let error = flip_of(&columns(3), &columns(4), 10.0);
        for row in error.values.chunks(40) {
            assert_eq!(row, &error.values[..40]);
        }
    }

    #[test]
    fn any_number_is_taken() {
        let odd = Raster::new(2, 2, vec![[f32::NAN; 3], [f32::INFINITY; 3], [-1.0; 3], [f32::MAX; 3]]);
        let grey = Raster::filled(2, 2, [0.2; 3]);
        let range = ExposureRange { start_stops: -20.0, stop_stops: 20.0, count: 5 };
        for error in [flip_of(&odd, &grey, 67.0), hdr_flip(&odd, &grey, 67.0, &range, checked).unwrap()] {
            assert!(error.values.iter().all(|v| (0.0..=1.0).contains(v)), "{:?}", error.values);
        }
        assert!(flip_of(&Raster::filled(0, 0, [0.0; 3]), &Raster::filled(0, 0, [0.0; 3]), 67.0).values.is_empty());
        assert!(constant_error([1.0; 3], [0.9; 3]) > 0.0);
    }

    #[test]
    fn a_black_reference_has_a_range_of_exposures() {
        for luminances in [&mut [0.0_f32; 4][..], &mut []] {
            let range = ExposureRange::of_luminances(luminances);
            // log2(2.1189 / 2^-23).
            assert!((range.start_stops - 24.0833).abs() < 1e-4 && range.start_stops == range.stop_stops, "{range:?}");
            assert_eq!(range.stops().len(), 1);
        }
    }

    #[test]
    fn an_interruption_ends_the_work() {
        let grey = Raster::filled(8, 8, [0.2; 3]);
        assert_eq!(flip(&grey, &grey, 67.0, || Err("stop")), Err("stop"));
    }
}

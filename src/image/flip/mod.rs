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
    /// luminance), and max(2, ceil(stop - start)) exposures. `luminances` may have any order; of an even number of them the median is the
    /// upper of the two in the middle, and 2^-23 stands for anything darker.
    pub fn of_luminances(luminances: &mut [f32]) -> Self {
        let shoulder = shoulder_of_tone_curve();
        let stops_to_shoulder = |luminance: f32| elementary::log2(shoulder / f64::from(luminance.max(f32::EPSILON)));
        let greatest = luminances.iter().copied().fold(0.0, f32::max);
        let middle = luminances.len() / 2;
        let median = if luminances.is_empty() { 0.0 } else { *luminances.select_nth_unstable_by(middle, f32::total_cmp).1 };
        let (start_stops, stop_stops) = (stops_to_shoulder(greatest), stops_to_shoulder(median));
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
            // The larger of a NaN and zero is zero.
            Self::Clamped => color.map(|v| v.max(0.0).min(1.0)),
            Self::ToneMapped { scale } => color.map(|v| tone_curve((v.max(0.0) * scale).min(BRIGHTEST))),
        }
    }
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

//! Errors between two images: numbers, and maps of where they lie.
//!
//! Pixels whose alpha is 0 in either image do not count; all others do, none is dropped. Channels are averaged
//! with equal weights, then pixels. Sums are f64, row by row, the rows in order. `of` is what is judged, `to` the
//! reference. Values are compared as they stand: linear light of images, encoded values of pictures.

use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::image::average::STANDARD_ERROR;
use crate::image::color;
use crate::image::flip::{self, ExposureRange};
use crate::image::raster::{Image, Layer, Picture, PictureSamples, Plane, Raster};
use crate::math::elementary;

/// A measure of the difference between two images.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Metric {
    /// Root of the mean squared error, in the unit of the images.
    Rmse,
    /// Mean squared error.
    Mse,
    /// Relative mean squared error: mean of (x - r)² / (r² + 0.01).
    Relmse,
    /// Symmetric mean absolute percentage error: mean of 2 |x - r| / (|x| + |r| + 0.01), from 0 to 2 (not in percent).
    Smape,
    /// Peak signal-to-noise ratio 10 log10(peak² / MSE), in dB, relative to `peak`. Has no map.
    Psnr,
    /// FLIP (Andersson et al. 2020), mean from 0 to 1, of what a display shows: linear images clamped to [0, 1],
    /// pictures read as sRGB.
    Flip,
    /// HDR-FLIP (Andersson et al. 2021), mean from 0 to 1: the greatest FLIP over exposures. Not for pictures.
    HdrFlip,
    /// Mean of (x - r) / standard error, with sign; needs the layer `standard_error` in one image at least.
    MeanZ,
}

impl Metric {
    /// Its word in pipelines and tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Rmse => "rmse",
            Self::Mse => "mse",
            Self::Relmse => "relmse",
            Self::Smape => "smape",
            Self::Psnr => "psnr",
            Self::Flip => "flip",
            Self::HdrFlip => "hdr-flip",
            Self::MeanZ => "mean-z",
        }
    }

    /// Unit of its value; empty where it has none or that of the images.
    pub fn unit(self) -> &'static str {
        if self == Self::Psnr { "dB" } else { "" }
    }

    /// Whether it says of each pixel how much it contributes.
    pub fn has_map(self) -> bool {
        self != Self::Psnr
    }
}

/// Added to the squared reference in relative errors, so that black pixels do not decide.
const RELATIVE_EPSILON: f64 = 1e-2;

/// Two images that cannot be compared in this way.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum MetricError {
    /// Widths or heights differ.
    #[error("`of` has {of_width} x {of_height} pixels and `to` has {to_width} x {to_height}; both must have one size")]
    SizesDiffer {
        /// Width of the judged image.
        of_width: usize,
        /// Height of the judged image.
        of_height: usize,
        /// Width of the reference.
        to_width: usize,
        /// Height of the reference.
        to_height: usize,
    },
    /// Infinities or what is not a number.
    #[error(
        "`{port}` has {count} pixels that are not finite, the first in column {x} of row {y}; remove them where it is loaded (`sanitize`)"
    )]
    NotFinite {
        /// Which of the two: `of` or `to`.
        port: &'static str,
        /// How many pixels.
        count: usize,
        /// Column of the first.
        x: usize,
        /// Row of the first.
        y: usize,
    },
    /// No pixel is covered in both.
    #[error("no pixel is covered in both `of` and `to`; there is nothing to compare")]
    NothingCovered,
    /// Neither image says how sure it is.
    #[error("`mean-z` needs the layer `{STANDARD_ERROR}` in `of` or `to`; `average` adds it")]
    StandardErrorMissing,
}

/// Two images of one size with finite values wherever both are covered.
pub struct Compared<'a> {
    of: &'a Image,
    to: &'a Image,
    covered_count: usize,
    lone_count: usize,
}

impl<'a> Compared<'a> {
    /// Checks that the two can be compared: `of` is judged by `to`.
    pub fn new(of: &'a Image, to: &'a Image) -> Result<Self, MetricError> {
        let [of_width, of_height, to_width, to_height] = [of.color.width(), of.color.height(), to.color.width(), to.color.height()];
        if (of_width, of_height) != (to_width, to_height) {
            return Err(MetricError::SizesDiffer { of_width, of_height, to_width, to_height });
        }
        let pixel_count = of_width * of_height;
        let covered_count = (0..pixel_count).filter(|&index| of.is_covered(index) && to.is_covered(index)).count();
        let lone_count = (0..pixel_count).filter(|&index| of.is_covered(index) != to.is_covered(index)).count();
        if covered_count == 0 {
            return Err(MetricError::NothingCovered);
        }
        let compared = Self { of, to, covered_count, lone_count };
        compared.require_finite("of", &of.color)?;
        compared.require_finite("to", &to.color)?;
        Ok(compared)
    }

    /// Pixels that are covered in one image only and so do not count.
    pub fn lone_count(&self) -> usize {
        self.lone_count
    }

    fn require_finite(&self, port: &'static str, raster: &Raster) -> Result<(), MetricError> {
        let is_bad = |index: &usize| self.is_covered(*index) && !raster.pixels()[*index].iter().all(|v| v.is_finite());
        let mut bad = (0..raster.pixels().len()).filter(is_bad);
        match bad.next() {
            None => Ok(()),
            Some(first) => {
                let (x, y) = (first % raster.width(), first / raster.width());
                Err(MetricError::NotFinite { port, count: 1 + bad.count(), x, y })
            }
        }
    }

    fn is_covered(&self, index: usize) -> bool {
        self.of.is_covered(index) && self.to.is_covered(index)
    }

    fn width(&self) -> usize {
        self.of.color.width()
    }

    /// One number for each covered pixel and 0 elsewhere, from its index.
    fn map(&self, error: impl Fn(usize) -> f64 + Sync) -> Map {
        let mut values = vec![0.0; self.width() * self.of.color.height()];
        values.par_chunks_mut(self.width()).enumerate().for_each(|(y, row)| {
            for (x, value) in row.iter_mut().enumerate() {
                let index = y * self.width() + x;
                if self.is_covered(index) {
                    *value = error(index);
                }
            }
        });
        Map { width: self.width(), values }
    }

    /// One number for each covered pixel: the mean of `error(x, r)` over the channels.
    fn map_of_channels(&self, error: impl Fn(f64, f64) -> f64 + Sync) -> Map {
        self.map(|index| {
            let (of, to) = (self.of.color.pixels()[index], self.to.color.pixels()[index]);
            let sum: f64 = (0..3).map(|channel| error(f64::from(of[channel]), f64::from(to[channel]))).sum();
            sum / 3.0
        })
    }

    /// Keeps only the covered pixels of a map.
    fn covered(&self, plane: Plane) -> Map {
        self.map(|index| f64::from(plane.values[index]))
    }

    fn mean(&self, map: &Map) -> f64 {
        map.sum() / self.covered_count as f64
    }
}

/// One f64 a pixel, before rounding to a plane.
struct Map {
    width: usize,
    values: Vec<f64>,
}

impl Map {
    /// Sums of rows, added in order.
    fn sum(&self) -> f64 {
        let rows: Vec<f64> = self.values.par_chunks(self.width).map(|row| row.iter().sum()).collect();
        rows.iter().sum()
    }

    fn into_plane(self, f: impl Fn(f64) -> f64) -> Plane {
        let height = self.values.len() / self.width;
        Plane { width: self.width, height, values: self.values.into_iter().map(|v| f(v) as f32).collect() }
    }
}

/// What the metrics must be told.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MetricSettings {
    /// Pixels in one degree of the visual field for FLIP, 1 to 1000.
    pub pixels_per_degree: f64,
    /// Greatest value of the signal for PSNR, above 0.
    pub peak: f64,
    /// Darkest exposure of HDR-FLIP in stops; by default found from the reference.
    pub start_stops: Option<f64>,
    /// Brightest exposure of HDR-FLIP in stops; by default found from the reference.
    pub stop_stops: Option<f64>,
    /// How many exposures of HDR-FLIP; by default one per stop.
    pub exposure_count: Option<usize>,
}

impl Default for MetricSettings {
    fn default() -> Self {
        Self { pixels_per_degree: flip::DEFAULT_PIXELS_PER_DEGREE, peak: 1.0, start_stops: None, stop_stops: None, exposure_count: None }
    }
}

/// What a metric found.
#[derive(Debug, Clone, PartialEq)]
pub struct Measurement {
    /// The metric.
    pub metric: Metric,
    /// Its value; infinite for the PSNR of equal images.
    pub value: f64,
    /// Error of each pixel, 0 where none is covered; `None` for PSNR.
    ///
    /// For `rmse` the root of the mean over the channels, otherwise what `value` is the mean of.
    pub map: Option<Plane>,
    /// The exposures at which HDR-FLIP looked.
    pub exposures: Option<ExposureRange>,
    /// Channels left out of `mean-z`: they differ and their standard error is 0.
    pub undefined_count: usize,
}

/// Measures the difference by one metric; `check` is asked now and then by those that take time.
pub fn measure<E: Send + From<MetricError>>(
    metric: Metric,
    compared: &Compared<'_>,
    settings: &MetricSettings,
    check: impl Fn() -> Result<(), E> + Sync,
) -> Result<Measurement, E> {
    let found = |value: f64, map: Option<Plane>| Measurement { metric, value, map, exposures: None, undefined_count: 0 };
    let mean_of = |map: Map| {
        let value = compared.mean(&map);
        found(value, Some(map.into_plane(|v| v)))
    };
    check()?;
    Ok(match metric {
        Metric::Mse => mean_of(squared_error(compared)),
        Metric::Rmse => {
            let map = squared_error(compared);
            found(compared.mean(&map).sqrt(), Some(map.into_plane(f64::sqrt)))
        }
        Metric::Relmse => mean_of(compared.map_of_channels(|x, r| (x - r) * (x - r) / (r * r + RELATIVE_EPSILON))),
        Metric::Smape => mean_of(compared.map_of_channels(|x, r| 2.0 * (x - r).abs() / (x.abs() + r.abs() + RELATIVE_EPSILON))),
        Metric::Psnr => {
            let peak = settings.peak;
            let mse = compared.mean(&squared_error(compared));
            found(10.0 * elementary::log10(peak * peak / mse), None)
        }
        Metric::Flip => {
            let plane = flip::flip(&compared.to.color, &compared.of.color, settings.pixels_per_degree, check)?;
            mean_of(compared.covered(plane))
        }
        Metric::HdrFlip => {
            let exposures = exposures_for(compared, settings);
            let plane = flip::hdr_flip(&compared.to.color, &compared.of.color, settings.pixels_per_degree, &exposures, check)?;
            Measurement { exposures: Some(exposures), ..mean_of(compared.covered(plane)) }
        }
        Metric::MeanZ => mean_z(compared)?,
    })
}

fn squared_error(compared: &Compared<'_>) -> Map {
    compared.map_of_channels(|x, r| (x - r) * (x - r))
}

/// The papers' range for the covered pixels of the reference, but for what the settings fix.
fn exposures_for(compared: &Compared<'_>, settings: &MetricSettings) -> ExposureRange {
    let covered = compared.to.color.pixels().iter().enumerate().filter(|(index, _)| compared.is_covered(*index));
    let mut luminances: Vec<f32> = covered.map(|(_, color)| color::luminance(*color) as f32).collect();
    let found = ExposureRange::of_luminances(&mut luminances);
    let [one, other] = [settings.start_stops.unwrap_or(found.start_stops), settings.stop_stops.unwrap_or(found.stop_stops)];
    let range = ExposureRange::one_per_stop(one.min(other), one.max(other));
    ExposureRange { count: settings.exposure_count.unwrap_or(range.count), ..range }
}

/// Mean over the channels of (x - r) / sqrt(se_x² + se_r²), a missing layer standing for 0.
fn mean_z(compared: &Compared<'_>) -> Result<Measurement, MetricError> {
    let errors = [standard_error(compared.of), standard_error(compared.to)];
    if errors == [None, None] {
        return Err(MetricError::StandardErrorMissing);
    }
    let z_of = |index: usize, channel: usize| {
        let difference = f64::from(compared.of.color.pixels()[index][channel]) - f64::from(compared.to.color.pixels()[index][channel]);
        let variances = errors.iter().flatten().map(|layer| f64::from(layer.pixels()[index][channel])).map(|error| error * error);
        let deviation = variances.sum::<f64>().sqrt();
        let is_defined = deviation > 0.0 || difference == 0.0;
        is_defined.then(|| if difference == 0.0 { 0.0 } else { difference / deviation })
    };
    let defined = |index: usize| (0..3).filter_map(move |channel| z_of(index, channel));
    let sums = compared.map(|index| defined(index).sum());
    let counts = compared.map(|index| defined(index).count() as f64);
    let defined_count = counts.sum();
    let value = if defined_count > 0.0 { sums.sum() / defined_count } else { 0.0 };
    let undefined_count = 3 * compared.covered_count - defined_count as usize;
    let map = compared.map(|index| sums.values[index] / counts.values[index].max(1.0)).into_plane(|v| v);
    Ok(Measurement { metric: Metric::MeanZ, value, map: Some(map), exposures: None, undefined_count })
}

fn standard_error(image: &Image) -> Option<&Raster> {
    match image.layers.get(STANDARD_ERROR) {
        Some(Layer::Color(raster)) => Some(raster),
        Some(Layer::Scalar(_)) | None => None,
    }
}

/// The encoded values of a picture as they stand, from 0 to 1.
pub fn encoded_values(picture: &Picture) -> Image {
    let table = |greatest: u16| -> Vec<f32> { (0..=greatest).map(|code| (f64::from(code) / f64::from(greatest)) as f32).collect() };
    let (pixels, greatest): (Vec<[f32; 3]>, u16) = match &picture.samples {
        PictureSamples::Eight(samples) => {
            let table = table(255);
            (samples.iter().map(|sample| sample.map(|code| table[usize::from(code)])).collect(), 255)
        }
        PictureSamples::Sixteen(samples) => {
            let table = table(65535);
            (samples.iter().map(|sample| sample.map(|code| table[usize::from(code)])).collect(), 65535)
        }
    };
    let (width, height) = (picture.width, picture.height);
    let plane =
        |alpha: &Vec<u16>| Plane { width, height, values: alpha.iter().map(|&code| f32::from(code) / f32::from(greatest)).collect() };
    Image { alpha: picture.alpha.as_ref().map(plane), ..Image::opaque(Raster::new(width, height, pixels)) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::display;

    fn image(pixels: &[[f32; 3]]) -> Image {
        Image::opaque(Raster::new(pixels.len(), 1, pixels.to_vec()))
    }

    fn value(metric: Metric, of: &Image, to: &Image) -> f64 {
        measured(metric, of, to, &MetricSettings::default()).value
    }

    fn measured(metric: Metric, of: &Image, to: &Image, settings: &MetricSettings) -> Measurement {
        measure(metric, &Compared::new(of, to).unwrap(), settings, || Ok::<(), MetricError>(())).unwrap()
    }

    fn assert_near(found: f64, expected: f64) {
        // f32 inputs, and a handful of roundings.
        assert!((found - expected).abs() <= 2e-7 * expected.abs(), "{found} for {expected}");
    }

    #[test]
    fn constants_give_the_closed_forms() {
        let (of, to) = (image(&[[0.5; 3]; 4]), image(&[[0.25; 3]; 4]));
        assert_near(value(Metric::Mse, &of, &to), 0.0625);
        assert_near(value(Metric::Rmse, &of, &to), 0.25);
        assert_near(value(Metric::Relmse, &of, &to), 0.0625 / (0.0625 + 0.01));
        assert_near(value(Metric::Smape, &of, &to), 2.0 * 0.25 / (0.5 + 0.25 + 0.01));
        assert_near(value(Metric::Psnr, &of, &to), 10.0 * elementary::log10(16.0));
        let settings = MetricSettings { peak: 10.0, ..MetricSettings::default() };
        assert_near(measured(Metric::Psnr, &of, &to, &settings).value, 10.0 * elementary::log10(1600.0));
    }

    #[test]
    fn channels_and_pixels_count_alike() {
        let (of, to) = (image(&[[3.0, 0.0, 0.0], [0.0, 0.0, 0.0]]), image(&[[0.0; 3]; 2]));
        assert_near(value(Metric::Mse, &of, &to), 9.0 / 6.0);
        let map = measured(Metric::Rmse, &of, &to, &MetricSettings::default()).map.unwrap();
        assert_eq!(map.values, [3.0_f32.sqrt(), 0.0]);
    }

    #[test]
    fn equal_images_have_no_error() {
        let one = image(&[[0.1, 0.7, 30.0], [0.0, 2.0, 0.4], [1.0, 1.0, 1.0]]);
        for metric in [Metric::Rmse, Metric::Mse, Metric::Relmse, Metric::Smape, Metric::Flip, Metric::HdrFlip] {
            let found = measured(metric, &one, &one, &MetricSettings::default());
            assert_eq!(found.value, 0.0, "{metric:?}");
            assert!(found.map.unwrap().values.iter().all(|v| *v == 0.0), "{metric:?}");
        }
        assert_eq!(value(Metric::Psnr, &one, &one), f64::INFINITY);
    }

    #[test]
    fn what_has_no_reference_is_symmetric() {
        let (one, other) = (image(&[[0.1, 0.7, 0.3], [0.0, 2.0, 0.4]]), image(&[[0.2, 0.5, 0.3], [0.9, 0.1, 0.0]]));
        for metric in [Metric::Rmse, Metric::Mse, Metric::Smape, Metric::Psnr, Metric::Flip] {
            assert_eq!(value(metric, &one, &other), value(metric, &other, &one), "{metric:?}");
        }
        assert_ne!(value(Metric::Relmse, &one, &other), value(Metric::Relmse, &other, &one));
    }

    #[test]
    fn pixels_without_alpha_in_either_image_do_not_count() {
        let mut of = image(&[[1.0; 3], [9.0; 3], [f32::NAN; 3]]);
        let mut to = image(&[[0.0; 3]; 3]);
        of.alpha = Some(Plane { width: 3, height: 1, values: vec![0.5, 1.0, 0.0] });
        to.alpha = Some(Plane { width: 3, height: 1, values: vec![1.0, 0.0, 0.0] });
        assert_eq!(value(Metric::Rmse, &of, &to), 1.0);
        assert_eq!(Compared::new(&of, &to).unwrap().lone_count(), 1);
        for metric in [Metric::Flip, Metric::HdrFlip] {
            assert!(value(metric, &of, &to) > 0.9, "{metric:?}");
        }
        of.alpha = Some(Plane { width: 3, height: 1, values: vec![0.0; 3] });
        assert_eq!(Compared::new(&of, &to).err(), Some(MetricError::NothingCovered));
    }

    #[test]
    fn what_cannot_be_compared_is_said() {
        let of = image(&[[0.0; 3], [f32::NAN; 3], [f32::INFINITY; 3]]);
        assert_eq!(Compared::new(&of, &of).err(), Some(MetricError::NotFinite { port: "of", count: 2, x: 1, y: 0 }));
        let message = Compared::new(&of, &image(&[[0.0; 3]])).err().unwrap().to_string();
        assert_eq!(message, "`of` has 3 x 1 pixels and `to` has 1 x 1; both must have one size");
        let fine = image(&[[0.0; 3]]);
        let compared = Compared::new(&fine, &fine).unwrap();
        let of_metric = |metric| measure(metric, &compared, &MetricSettings::default(), || Ok(())).err();
        assert_eq!(of_metric(Metric::MeanZ), Some(MetricError::StandardErrorMissing));
    }

    #[test]
    fn mean_z_counts_differences_in_standard_errors() {
        let with_error = |pixels: &[[f32; 3]], error: f32| {
            let mut image = image(pixels);
            image.layers.insert(STANDARD_ERROR.into(), Layer::Color(Raster::filled(pixels.len(), 1, [error; 3])));
            image
        };
        let settings = MetricSettings::default();
        // (1 + 2 + 0) / 0.5 in the first pixel and -1 / 0.5 three times in the second: a mean of 0.
        let (of, to) = (with_error(&[[1.0, 2.0, 0.0], [-1.0; 3]], 0.5), image(&[[0.0; 3]; 2]));
        let found = measured(Metric::MeanZ, &of, &to, &settings);
        assert_eq!((found.value, found.map.unwrap().values), (0.0, vec![2.0, -2.0]));
        // Errors of both add in squares: 0.3² + 0.4² = 0.5².
        let (of, to) = (with_error(&[[1.0; 3]], 0.3), with_error(&[[0.0; 3]], 0.4));
        assert_near(measured(Metric::MeanZ, &of, &to, &settings).value, 2.0);
        // Without any error a difference has no z.
        let (of, to) = (with_error(&[[1.0, 0.0, 0.0]], 0.0), image(&[[0.0; 3]]));
        let found = measured(Metric::MeanZ, &of, &to, &settings);
        assert_eq!((found.value, found.undefined_count), (0.0, 1));
    }

    #[test]
    fn pictures_are_read_as_codes_or_as_srgb_light() {
        let picture = Picture { width: 1, height: 1, samples: PictureSamples::Eight(vec![[0, 188, 255]]), alpha: Some(vec![51]) };
        let encoded = encoded_values(&picture);
        assert_eq!(encoded.color.pixel(0, 0), [0.0, (188.0_f64 / 255.0) as f32, 1.0]);
        assert_eq!(encoded.alpha.unwrap().values, [0.2]);
        let [black, grey, white] = display::decoded(&picture).color.pixel(0, 0);
        assert!(black == 0.0 && (grey - 0.502_886).abs() < 1e-6 && white == 1.0);
        let deep = Picture { samples: PictureSamples::Sixteen(vec![[0, 32768, 65535]]), ..picture };
        assert_eq!(encoded_values(&deep).color.pixel(0, 0), [0.0, (32768.0_f64 / 65535.0) as f32, 1.0]);
    }

    #[test]
    fn exposures_that_are_given_are_used() {
        let (of, to) = (image(&[[2.0; 3], [0.5; 3]]), image(&[[1.0; 3], [0.6; 3]]));
        let settings = MetricSettings { start_stops: Some(-3.0), stop_stops: Some(4.5), ..MetricSettings::default() };
        let found = measured(Metric::HdrFlip, &of, &to, &settings).exposures.unwrap();
        assert_eq!((found.start_stops, found.stop_stops, found.count), (-3.0, 4.5, 8));
        let settings = MetricSettings { exposure_count: Some(3), ..settings };
        assert_eq!(measured(Metric::HdrFlip, &of, &to, &settings).exposures.unwrap().stops(), [-3.0, 0.75, 4.5]);
    }
}

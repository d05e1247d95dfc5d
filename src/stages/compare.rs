//! The kind `compare`; the mathematics is in `image::metrics` and `image::flip`.

use std::borrow::Cow;
use std::num::NonZeroU32;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::engine::artifact::Artifact;
use crate::engine::job::Job;
use crate::engine::parameter::Port;
use crate::engine::stage::{InputSizes, Mistake, ResultDeclaration, Stage, StageError};
use crate::figure::table::{Cell, Column, Table};
use crate::image::display;
use crate::image::flip::DEFAULT_PIXELS_PER_DEGREE;
use crate::image::metrics::{self, Compared, Measurement, Metric, MetricError, MetricSettings};
use crate::image::raster::{Image, Plane, Raster};
use crate::stages::rasters::LinearOrPicture;

/// Measures how far an image is from a reference.
///
/// The first result is a table of one row with a column for each metric, named like it. The result `.map` is an image
/// with the error of each pixel as grey. Both inputs are linear (images, environment maps), compared in linear light;
/// or both are pictures, whose encoded values from 0 to 1 are compared, except that `flip` reads them as sRGB. Pixels
/// whose alpha is 0 in either do not count; channels, and pixels of a lat-long map, count alike.
///
/// ```yaml
/// error: { compare: { of: sphere, to: truth, metrics: [rmse, hdr-flip] }, save: { map: png } }
/// ```
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Compare {
    /// What is judged.
    pub of: Port<LinearOrPicture>,
    /// The reference; of the same size.
    pub to: Port<LinearOrPicture>,
    /// The metrics, in the order of the columns.
    #[serde(default = "default_metrics")]
    #[schemars(length(min = 1))]
    pub metrics: Vec<Metric>,
    /// The metric whose errors `.map` shows; by default the first in `metrics` that has a map, else `rmse`.
    ///
    /// `rmse` shows the root of each pixel's mean squared error, the others what their value is the mean of.
    #[serde(default)]
    pub map: Option<Metric>,
    /// Pixels in one degree of the visual field, for `flip` and `hdr-flip`, from 1 to 1000.
    ///
    /// 67 is a display 0.7 m wide with 3840 pixels seen from 0.7 m (Andersson et al. 2020).
    #[serde(default = "default_pixels_per_degree")]
    #[schemars(range(min = 1, max = 1000), extend("x-unit" = "px/deg"))]
    pub pixels_per_degree: f64,
    /// Greatest value of the signal, for `psnr`; 1 by default, which is right for pictures and must be set for anything brighter.
    #[serde(default)]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub peak: Option<f64>,
    /// Darkest exposure of `hdr-flip`; by default log2(2.119 / greatest luminance of the reference).
    ///
    /// 2.119 is what the tone curve takes to 0.85 (Andersson et al. 2021).
    #[serde(default)]
    #[schemars(range(min = -64, max = 64), extend("x-unit" = "stops"))]
    pub hdr_flip_start_stops: Option<f64>,
    /// Brightest exposure of `hdr-flip`; by default log2(2.119 / median luminance of the reference).
    #[serde(default)]
    #[schemars(range(min = -64, max = 64), extend("x-unit" = "stops"))]
    pub hdr_flip_stop_stops: Option<f64>,
    /// How many exposures of `hdr-flip`, evenly spaced; by default max(2, ceil(stop - start)).
    #[serde(default)]
    #[schemars(range(max = 1000))]
    pub hdr_flip_exposure_count: Option<NonZeroU32>,
}

fn default_metrics() -> Vec<Metric> {
    vec![Metric::Rmse]
}

fn default_pixels_per_degree() -> f64 {
    DEFAULT_PIXELS_PER_DEGREE
}

impl Stage for Compare {
    const KIND: &'static str = "compare";
    const VERSION: u32 = 1;
    const RESULTS: &'static [ResultDeclaration] =
        &[ResultDeclaration { name: "", types: &[Table::TYPE] }, ResultDeclaration { name: "map", types: &[Image::TYPE] }];
    type Output = (Table, Image);

    fn mistakes(&self) -> Vec<Mistake> {
        let is_repeated = self.metrics.iter().enumerate().any(|(index, metric)| self.metrics[..index].contains(metric));
        let is_empty_range = matches!((self.hdr_flip_start_stops, self.hdr_flip_stop_stops), (Some(start), Some(stop)) if start > stop);
        let has_psnr = self.metrics.contains(&Metric::Psnr);
        let rules = [
            (is_repeated, "metrics", "a metric stands in the list twice", "name each once"),
            (!has_psnr && self.peak.is_some(), "peak", "only `psnr` has a peak", "leave `peak` out, or add `psnr`"),
            (self.map == Some(Metric::Psnr), "map", "`psnr` says nothing of single pixels", "use `map: rmse`"),
            (is_empty_range, "hdr_flip_stop_stops", "the range of exposures ends before it starts", "exchange the two"),
            (self.has_unused_exposures(), "metrics", "exposures are given but `hdr-flip` is not measured", "add `hdr-flip`"),
        ];
        let broken = rules.into_iter().filter(|(is_broken, ..)| *is_broken);
        broken.map(|(_, field, message, hint)| Mistake { field: field.into(), message: message.into(), hint: Some(hint.into()) }).collect()
    }

    fn caveats(&self) -> Vec<String> {
        let is_assumed = self.metrics.contains(&Metric::Psnr) && self.peak.is_none();
        is_assumed.then(|| "`psnr` is relative to a peak of 1; set `peak` where values go beyond".to_owned()).into_iter().collect()
    }

    fn memory(&self, inputs: &InputSizes) -> u64 {
        // Copies of environment maps and pictures in f32, and maps in f64 and f32.
        3 * inputs.values().sum::<u64>()
    }

    fn run(&self, job: &Job<'_>) -> Result<(Table, Image), StageError> {
        let (of, to) = (job.input(&self.of)?, job.input(&self.to)?);
        let mut measurements = Vec::new();
        for metric in self.measured() {
            let [of_values, to_values] = comparable(metric, &of, &to)?;
            let compared = Compared::new(&of_values, &to_values)?;
            let measurement = metrics::measure(metric, &compared, &self.settings(), || job.check())?;
            warn_of(job, &measurement, &compared, measurements.is_empty());
            measurements.push(measurement);
        }
        let [of_values, to_values] = comparable(Metric::Rmse, &of, &to)?;
        let map = self.map_among(&measurements).clone();
        Ok((table(&measurements[..self.metrics.len()]), image_of(map, [&of_values, &to_values])))
    }
}

impl Compare {
    fn has_unused_exposures(&self) -> bool {
        let is_given = self.hdr_flip_start_stops.is_some() || self.hdr_flip_stop_stops.is_some() || self.hdr_flip_exposure_count.is_some();
        is_given && !self.metrics.contains(&Metric::HdrFlip) && self.map != Some(Metric::HdrFlip)
    }

    fn map_metric(&self) -> Metric {
        let first_with_map = || self.metrics.iter().copied().find(|metric| metric.has_map());
        self.map.or_else(first_with_map).unwrap_or(Metric::Rmse)
    }

    /// The metrics of the table, and that of the map behind them if it is none of those.
    fn measured(&self) -> Vec<Metric> {
        let map = self.map_metric();
        let further = (!self.metrics.contains(&map)).then_some(map);
        self.metrics.iter().copied().chain(further).collect()
    }

    fn map_among<'a>(&self, measurements: &'a [Measurement]) -> &'a Plane {
        let found = measurements.iter().find(|measurement| measurement.metric == self.map_metric());
        found.and_then(|measurement| measurement.map.as_ref()).expect("the metric of the map was measured and has one")
    }

    fn settings(&self) -> MetricSettings {
        MetricSettings {
            pixels_per_degree: self.pixels_per_degree,
            peak: self.peak.unwrap_or(1.0),
            start_stops: self.hdr_flip_start_stops,
            stop_stops: self.hdr_flip_stop_stops,
            exposure_count: self.hdr_flip_exposure_count.map(|count| count.get() as usize),
        }
    }
}

/// What this metric compares of the inputs: linear images as they are, pictures as codes or as light.
pub fn comparable<'a>(metric: Metric, of: &'a LinearOrPicture, to: &'a LinearOrPicture) -> Result<[Cow<'a, Image>; 2], StageError> {
    match (of, to) {
        (LinearOrPicture::Linear(of), LinearOrPicture::Linear(to)) => Ok([Cow::Borrowed(of), Cow::Borrowed(to)]),
        (LinearOrPicture::Picture(of), LinearOrPicture::Picture(to)) => match metric {
            Metric::Flip => Ok([of, to].map(|picture| Cow::Owned(display::decoded(picture)))),
            Metric::HdrFlip | Metric::MeanZ => {
                let message = format!("`{}` is for linear images, not for pictures", metric.name());
                Err(StageError::content_with_hint(message, "compare the images before `tone-map`"))
            }
            _ => Ok([of, to].map(|picture| Cow::Owned(metrics::encoded_values(picture)))),
        },
        _ => Err(StageError::content_with_hint(
            "one of `of` and `to` is a picture and the other is linear",
            "compare both before `tone-map` or both after it",
        )),
    }
}

fn warn_of(job: &Job<'_>, measurement: &Measurement, compared: &Compared<'_>, is_first: bool) {
    if is_first && compared.lone_count() > 0 {
        job.warn(format!("{} pixels are covered in one image only and do not count", compared.lone_count()));
    }
    if measurement.undefined_count > 0 {
        let count = measurement.undefined_count;
        job.warn(format!("`mean-z` leaves out {count} channels that differ although their standard error is 0"));
    }
    if measurement.value.is_infinite() {
        job.warn("the images are equal: `psnr` is infinite, and its cell is empty");
    }
}

/// One row; beside `hdr-flip` the exposures it looked at.
fn table(measurements: &[Measurement]) -> Table {
    let mut columns = Vec::new();
    let mut row = Vec::new();
    for measurement in measurements {
        columns.push(Column::new(measurement.metric.name(), measurement.metric.unit()));
        row.push(if measurement.value.is_finite() { Cell::Number(measurement.value) } else { Cell::Empty });
    }
    for exposures in measurements.iter().filter_map(|measurement| measurement.exposures) {
        let names = [("hdr_flip_start_stops", "stops"), ("hdr_flip_stop_stops", "stops"), ("hdr_flip_exposure_count", "")];
        columns.extend(names.map(|(name, unit)| Column::new(name, unit)));
        let count = Cell::Integer(exposures.count as i128);
        row.extend([Cell::Number(exposures.start_stops), Cell::Number(exposures.stop_stops), count]);
    }
    let mut table = Table::new(columns);
    table.push(row);
    table
}

/// The map as grey, covered where both images are.
fn image_of(map: Plane, compared: [&Image; 2]) -> Image {
    let is_opaque = compared.iter().all(|image| image.alpha.is_none());
    let coverage = |index: usize| if compared.iter().all(|image| image.is_covered(index)) { 1.0 } else { 0.0 };
    let (width, height) = (map.width, map.height);
    let alpha = (!is_opaque).then(|| Plane { width, height, values: (0..width * height).map(coverage).collect() });
    Image { alpha, ..Image::opaque(Raster::new(width, height, map.values.into_iter().map(|v| [v; 3]).collect())) }
}

impl From<MetricError> for StageError {
    fn from(error: MetricError) -> Self {
        Self::content(error)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::artifact::AnyArtifact;
    use crate::image::raster::{Picture, PictureSamples};
    use crate::light::envmap::EnvMap;
    use crate::stages::rasters::trial;

    fn image(values: [f32; 3]) -> AnyArtifact {
        AnyArtifact::new(Image::opaque(Raster::filled(3, 2, values)))
    }

    fn picture(code: u8) -> AnyArtifact {
        AnyArtifact::new(Picture { width: 3, height: 2, samples: PictureSamples::Eight(vec![[code; 3]; 6]), alpha: None })
    }

    fn run(text: &str, of: AnyArtifact, to: AnyArtifact) -> Result<(Table, Image, Vec<String>), String> {
        let (results, warnings) = trial::run::<Compare>(text, [("a", vec![of]), ("b", vec![to])]);
        let results = results.map_err(|error| error.to_string())?;
        Ok(((*results[0].get::<Table>().unwrap()).clone(), (*results[1].get::<Image>().unwrap()).clone(), warnings))
    }

    fn names(table: &Table) -> Vec<&str> {
        table.columns.iter().map(|column| column.name.as_str()).collect()
    }

    #[test]
    fn a_table_has_a_column_for_each_metric() {
        let text = "{ of: a, to: b, metrics: [smape, psnr, hdr-flip, mse], peak: 2 }";
        let (table, map, warnings) = run(text, image([0.5; 3]), image([0.25; 3])).unwrap();
        let exposures = ["hdr_flip_start_stops", "hdr_flip_stop_stops", "hdr_flip_exposure_count"];
        assert_eq!(names(&table), [["smape", "psnr", "hdr-flip", "mse"].as_slice(), &exposures].concat());
        assert_eq!(table.columns[1].unit, "dB");
        assert_eq!(table.rows[0][3], Cell::Number(0.0625));
        // 2 · 0.25 / 0.76 in every pixel of the map of the first metric.
        assert_eq!(map.color.pixel(2, 1), [(0.5_f64 / 0.76) as f32; 3]);
        assert!(warnings.is_empty() && map.alpha.is_none());
    }

    #[test]
    fn the_map_may_show_a_metric_that_the_table_has_not() {
        let (table, map, _) = run("{ of: a, to: b, map: mse }", image([0.5; 3]), image([0.25; 3])).unwrap();
        assert_eq!((names(&table), map.color.pixel(0, 0)), (vec!["rmse"], [0.0625; 3]));
        let (table, map, _) = run("{ of: a, to: b, metrics: [psnr], peak: 1 }", image([0.5; 3]), image([0.25; 3])).unwrap();
        assert_eq!((names(&table), map.color.pixel(0, 0)), (vec!["psnr"], [0.25; 3]));
    }

    #[test]
    fn equal_images_have_an_empty_psnr() {
        let (table, _, warnings) = run("{ of: a, to: b, metrics: [psnr, rmse], peak: 1 }", image([0.5; 3]), image([0.5; 3])).unwrap();
        assert_eq!((table.rows[0].as_slice(), warnings.len()), ([Cell::Empty, Cell::Number(0.0)].as_slice(), 1));
    }

    #[test]
    fn pictures_are_compared_by_codes_but_flip_reads_them_as_srgb() {
        let text = "{ of: a, to: b, metrics: [rmse, flip] }";
        let (table, ..) = run(text, picture(51), picture(102)).unwrap();
        let Cell::Number(rmse) = table.rows[0][0] else { panic!("a number") };
        assert!((rmse - 0.2).abs() < 1e-7, "{rmse}");
        let light = |code: f64| image([crate::image::color::srgb_decode(code / 255.0) as f32; 3]);
        let (linear, ..) = run(text, light(51.0), light(102.0)).unwrap();
        assert_eq!(table.rows[0][1], linear.rows[0][1]);
    }

    #[test]
    fn what_cannot_be_compared_is_said() {
        let map = AnyArtifact::new(EnvMap::new(Raster::filled(4, 2, [1.0; 3])));
        let message = |text: &str, of: AnyArtifact, to: AnyArtifact| run(text, of, to).err().unwrap();
        let plain = "{ of: a, to: b }";
        assert_eq!(message(plain, image([1.0; 3]), map), "`of` has 3 x 2 pixels and `to` has 4 x 2; both must have one size");
        assert_eq!(message(plain, image([1.0; 3]), picture(3)), "one of `of` and `to` is a picture and the other is linear");
        let hdr = "{ of: a, to: b, metrics: [hdr-flip] }";
        assert_eq!(message(hdr, picture(3), picture(3)), "`hdr-flip` is for linear images, not for pictures");
    }

    #[test]
    fn parameters_that_contradict_each_other_are_mistakes() {
        let mistakes = |rest: &str| trial::mistakes::<Compare>(&format!("{{ of: a, to: b, {rest} }}"));
        assert!(mistakes("metrics: [psnr]").is_empty());
        assert_eq!(mistakes("metrics: [rmse, flip, rmse]"), ["metrics: a metric stands in the list twice"]);
        assert_eq!(mistakes("map: psnr"), ["map: `psnr` says nothing of single pixels"]);
        assert_eq!(mistakes("peak: 1"), ["peak: only `psnr` has a peak"]);
        assert_eq!(mistakes("metrics: [hdr-flip], hdr_flip_start_stops: 2, hdr_flip_stop_stops: 1").len(), 1);
        assert_eq!(mistakes("hdr_flip_exposure_count: 3").len(), 1);
        assert!(mistakes("metrics: [rmse, relmse, smape, psnr, flip, hdr-flip, mean-z], peak: 1, map: flip").is_empty());
    }
}

//! How good an estimator is, from independent runs of it: bias, variance and efficiency, each with an interval.
//!
//! Means of whole pictures are taken run by run, and intervals are Student's t over the runs: pixels of one run may be as
//! correlated as they like (they are where all share their samples). Knows nothing of how pictures come about.
//!
//! After Pharr, Jakob, Humphreys, "Physically Based Rendering", 4th edition, section 2.1.4 (efficiency).

use crate::image::average::{AverageError, RunningMean, STANDARD_ERROR};
use crate::image::raster::{Image, Layer, Raster};
use crate::math::statistics::{self, Interval};

/// What the runs say of an estimator. Squares and variances are means over channels and covered pixels.
///
/// Of a single run (an estimator that does not scatter) there is no variance and no interval: those are NaN.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Assessment {
    /// Number of runs.
    pub run_count: usize,
    /// Mean of the reference over channels and covered pixels.
    pub reference: f64,
    /// Mean signed error.
    pub bias: Estimate,
    /// Root of the mean over pixels of the squared bias, less what scatter adds to it; 0 where scatter explains all.
    pub bias_rms: f64,
    /// Root of the mean of squared z-values, (mean - reference) / standard error: of n runs about the root of (n - 1) / (n - 3) for an
    /// unbiased estimator of normal scatter.
    pub z_rms: f64,
    /// Variance of one run.
    pub variance: Estimate,
    /// Root of the mean squared error of one run.
    pub rmse: Estimate,
}

/// A value with its interval.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Estimate {
    /// The value.
    pub value: f64,
    /// Its interval; at least 0 for what cannot be negative.
    pub interval: Interval,
}

/// Runs that cannot be assessed.
#[derive(Debug, thiserror::Error)]
pub enum AssessmentError<E> {
    /// Nothing was given.
    #[error("there is no run to assess")]
    NoRuns,
    /// Sizes or coverage differ.
    #[error(transparent)]
    Average(#[from] AverageError),
    /// The reference has another size.
    #[error("the reference has {} x {} pixels, the runs have {} x {}", reference[0], reference[1], runs[0], runs[1])]
    Size {
        /// Of the reference.
        reference: [usize; 2],
        /// Of the runs.
        runs: [usize; 2],
    },
    /// No pixel is covered in both.
    #[error("no pixel is covered in the reference and in the runs")]
    Nothing,
    /// The runs could not be had.
    #[error(transparent)]
    Source(E),
}

/// The mean of the runs, with what it says of the estimator.
pub struct Assessed {
    /// The numbers.
    pub assessment: Assessment,
    /// Mean of the runs less the reference, with the coverage of both.
    pub bias: Image,
}

/// Assesses runs against a reference at that level of confidence.
///
/// `runs` gives all of them in order, each time it is called: twice, so that they need not all be in memory.
///
/// # Errors
/// See [`AssessmentError`].
pub fn assess<E, I: Iterator<Item = Result<std::sync::Arc<Image>, E>>>(
    reference: &Image,
    runs: impl Fn() -> I,
    confidence: f64,
) -> Result<Assessed, AssessmentError<E>> {
    let mut running: Option<RunningMean> = None;
    for run in runs() {
        let run = run.map_err(AssessmentError::Source)?;
        match &mut running {
            None => running = Some(RunningMean::of(&run)),
            Some(mean) => mean.push(&run)?,
        }
    }
    let mean = running.map(RunningMean::finish).ok_or(AssessmentError::NoRuns)?;
    let sizes = [reference, &mean].map(|image| [image.color.width(), image.color.height()]);
    if sizes[0] != sizes[1] {
        return Err(AssessmentError::Size { reference: sizes[0], runs: sizes[1] });
    }
    let covered: Vec<usize> =
        (0..mean.color.pixels().len()).filter(|&index| mean.is_covered(index) && reference.is_covered(index)).collect();
    if covered.is_empty() {
        return Err(AssessmentError::Nothing);
    }
    let mut errors = Errors::default();
    for run in runs() {
        errors.add(&*run.map_err(AssessmentError::Source)?, reference, &mean, &covered);
    }
    Ok(Assessed { assessment: errors.assessment(reference, &mean, &covered, confidence), bias: difference(&mean, reference, &covered) })
}

/// Means over the covered pixels, one of each run.
#[derive(Default)]
struct Errors {
    signed: Vec<f64>,
    squared: Vec<f64>,
    scatter: Vec<f64>,
}

/// Mean over channels and covered pixels.
fn mean_over(covered: &[usize], value: impl Fn(usize, usize) -> f64) -> f64 {
    let values = covered.iter().flat_map(|&index| (0..3).map(move |channel| (index, channel)));
    statistics::sum(values.map(|(index, channel)| value(index, channel))) / (3 * covered.len()) as f64
}

fn channel(image: &Image, index: usize, channel: usize) -> f64 {
    f64::from(image.color.pixels()[index][channel])
}

impl Errors {
    fn add(&mut self, run: &Image, reference: &Image, mean: &Image, covered: &[usize]) {
        let error = |index, c| channel(run, index, c) - channel(reference, index, c);
        let deviation = |index, c| channel(run, index, c) - channel(mean, index, c);
        self.signed.push(mean_over(covered, error));
        self.squared.push(mean_over(covered, |index, c| error(index, c) * error(index, c)));
        self.scatter.push(mean_over(covered, |index, c| deviation(index, c) * deviation(index, c)));
    }

    fn assessment(&self, reference: &Image, mean: &Image, covered: &[usize], confidence: f64) -> Assessment {
        let count = self.signed.len() as f64;
        // The mean of squared deviations from the runs' own mean is short by one part of n.
        let scatter: Vec<f64> = self.scatter.iter().map(|scatter| scatter * count / (count - 1.0)).collect();
        let variance = estimate(&scatter, confidence, at_least_zero);
        let bias_square = mean_over(covered, |index, c| {
            let bias = channel(mean, index, c) - channel(reference, index, c);
            bias * bias
        });
        Assessment {
            run_count: self.signed.len(),
            reference: mean_over(covered, |index, c| channel(reference, index, c)),
            bias: estimate(&self.signed, confidence, |bias| bias),
            bias_rms: if count > 1.0 { (bias_square - variance.value / count).max(0.0).sqrt() } else { bias_square.sqrt() },
            z_rms: z_rms(mean, reference, covered),
            variance,
            rmse: estimate(&self.squared, confidence, |square| at_least_zero(square).sqrt()),
        }
    }
}

/// Unlike `max`, keeps NaN.
fn at_least_zero(value: f64) -> f64 {
    if value < 0.0 { 0.0 } else { value }
}

/// `of` the mean of values, and of the ends of its interval.
fn estimate(values: &[f64], confidence: f64, of: impl Fn(f64) -> f64) -> Estimate {
    let interval = statistics::mean_interval(values, confidence);
    Estimate { value: of(statistics::mean(values)), interval: Interval { low: of(interval.low), high: of(interval.high) } }
}

/// Over what scatters at all; NaN where nothing does.
fn z_rms(mean: &Image, reference: &Image, covered: &[usize]) -> f64 {
    let Some(Layer::Color(errors)) = mean.layers.get(STANDARD_ERROR) else { return f64::NAN };
    let squares: Vec<f64> = covered
        .iter()
        .flat_map(|&index| (0..3).map(move |c| (index, c)))
        .filter(|&(index, c)| errors.pixels()[index][c] > 0.0)
        .map(|(index, c)| (channel(mean, index, c) - channel(reference, index, c)) / f64::from(errors.pixels()[index][c]))
        .map(|z| z * z)
        .collect();
    statistics::mean(&squares).sqrt()
}

fn difference(mean: &Image, reference: &Image, covered: &[usize]) -> Image {
    let (width, height) = (mean.color.width(), mean.color.height());
    let mut pixels = vec![[0.0; 3]; width * height];
    for &index in covered {
        pixels[index] = [0, 1, 2].map(|c| (channel(mean, index, c) - channel(reference, index, c)) as f32);
    }
    Image { alpha: mean.alpha.clone(), ..Image::opaque(Raster::new(width, height, pixels)) }
}

#[cfg(test)]
mod tests {
    use std::convert::Infallible;
    use std::sync::Arc;

    use super::*;
    use crate::math::elementary;
    use crate::math::stream::{Purpose, Stream};

    fn image(width: usize, value: impl Fn(usize) -> f32) -> Image {
        Image::opaque(Raster::new(width, 1, (0..width).map(|k| [value(k); 3]).collect()))
    }

    fn assessed(reference: &Image, runs: &[Arc<Image>]) -> Result<Assessed, AssessmentError<Infallible>> {
        assess(reference, || runs.iter().cloned().map(Ok), 0.95)
    }

    /// Normal numbers by Box and Muller, of that mean and variance in every pixel.
    fn noisy_runs(count: u64, width: usize, mean: f64, deviation: f64) -> Vec<Arc<Image>> {
        let stream = Stream::new(3, Purpose::Test);
        let run = |run: u64| {
            let value = |k: usize| {
                let [u, v] = stream.generator(run * width as u64 + k as u64).uniform_pair();
                let radius = (-2.0 * elementary::ln(1.0 - u)).sqrt();
                (mean + deviation * radius * elementary::cos(2.0 * std::f64::consts::PI * v)) as f32
            };
            Arc::new(image(width, value))
        };
        (0..count).map(run).collect()
    }

    #[test]
    fn bias_variance_and_error_are_found_again() {
        let runs = noisy_runs(64, 300, 2.5, 0.25);
        let found = assessed(&image(300, |_| 2.0), &runs).unwrap();
        let Assessment { bias, bias_rms, variance, rmse, z_rms, run_count, reference } = found.assessment;
        assert_eq!((run_count, reference), (64, 2.0));
        assert!((bias.value - 0.5).abs() < 0.01 && bias.interval.low < 0.5 && 0.5 < bias.interval.high);
        assert!((bias_rms - 0.5).abs() < 0.01, "{bias_rms}");
        assert!((variance.value - 0.0625).abs() < 0.003 && variance.interval.low < 0.0625 && 0.0625 < variance.interval.high);
        assert!((rmse.value - 0.3125_f64.sqrt()).abs() < 0.01, "{rmse:?}");
        assert!(z_rms > 10.0, "{z_rms}");
        assert!((found.bias.color.pixel(3, 0)[0] - 0.5).abs() < 0.2);
    }

    #[test]
    fn an_unbiased_estimator_has_none_beyond_its_scatter() {
        let found = assessed(&image(300, |_| 2.0), &noisy_runs(64, 300, 2.0, 0.25)).unwrap().assessment;
        assert!(found.bias.interval.low < 0.0 && 0.0 < found.bias.interval.high, "{found:?}");
        assert!(found.bias_rms < 0.01 && (found.z_rms - 1.0).abs() < 0.15, "{found:?}");
    }

    #[test]
    fn one_run_is_all_bias() {
        let found = assessed(&image(4, |_| 1.0), &[Arc::new(image(4, |k| 1.0 + k as f32))]).unwrap().assessment;
        assert_eq!((found.bias.value, found.rmse.value, found.bias_rms), (1.5, 3.5_f64.sqrt(), 3.5_f64.sqrt()));
        assert!(found.variance.value.is_nan() && found.bias.interval.low.is_nan() && found.z_rms.is_nan());
    }

    #[test]
    fn runs_that_cannot_be_assessed_are_refused() {
        let runs = noisy_runs(2, 4, 1.0, 0.1);
        assert!(matches!(assessed(&image(4, |_| 1.0), &[]), Err(AssessmentError::NoRuns)));
        assert!(matches!(assessed(&image(5, |_| 1.0), &runs), Err(AssessmentError::Size { .. })));
        let bare = Image { alpha: Some(crate::image::raster::Plane { width: 4, height: 1, values: vec![0.0; 4] }), ..image(4, |_| 1.0) };
        assert!(matches!(assessed(&bare, &runs), Err(AssessmentError::Nothing)));
    }
}

//! What a figure says of repeated and scaled measurements: means with intervals, power laws.
//!
//! Knows no table and no drawing. Formulas: Student, "The probable error of a mean" (1908); ordinary least
//! squares on logarithms for power laws.

use serde::{Deserialize, Serialize};

use crate::math::elementary;
use crate::math::statistics;

/// A mean of repeated measurements.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MeanInterval {
    /// The mean.
    pub mean: f64,
    /// How many numbers it is the mean of.
    pub count: usize,
    /// Standard deviation (with count - 1) over the root of the count; `None` for one number.
    pub standard_error: Option<f64>,
    /// The two-sided Student t interval of the mean; `None` for one number.
    pub interval: Option<[f64; 2]>,
}

/// The mean of `values` with the two-sided Student t interval of that level (0.95); `None` of no values.
pub fn mean_interval(values: &[f64], level: f64) -> Option<MeanInterval> {
    let count = values.len();
    if count == 0 {
        return None;
    }
    let mean = values.iter().sum::<f64>() / count as f64;
    if count == 1 {
        return Some(MeanInterval { mean, count, standard_error: None, interval: None });
    }
    let variance = values.iter().map(|value| (value - mean) * (value - mean)).sum::<f64>() / (count - 1) as f64;
    let standard_error = (variance / count as f64).sqrt();
    let reach = statistics::student_t_quantile(0.5 + level / 2.0, (count - 1) as f64) * standard_error;
    Some(MeanInterval { mean, count, standard_error: Some(standard_error), interval: Some([mean - reach, mean + reach]) })
}

/// y = coefficient x^slope, fitted to points.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PowerLaw {
    /// y at x = 1.
    pub coefficient: f64,
    /// The exponent.
    pub slope: f64,
    /// Standard error of the exponent, from the residuals; `None` for two points.
    pub slope_error: Option<f64>,
    /// Smallest and largest x that was used.
    pub range: [f64; 2],
}

impl PowerLaw {
    /// Its y at x.
    pub fn at(&self, x: f64) -> f64 {
        self.coefficient * elementary::pow(x, self.slope)
    }
}

/// Least squares of ln y on ln x over the points with positive x and y; `None` for fewer than two different x.
pub fn power_law(points: &[[f64; 2]]) -> Option<PowerLaw> {
    let logs: Vec<[f64; 2]> =
        points.iter().filter(|point| point[0] > 0.0 && point[1] > 0.0).map(|point| point.map(elementary::ln)).collect();
    let [x, y] = [0, 1].map(|k| logs.iter().map(|point| point[k]).collect::<Vec<_>>());
    let line = statistics::slope(&x, &y)?;
    let slope_error = (logs.len() > 2).then_some(line.standard_error);
    let used = points.iter().filter(|point| point[0] > 0.0 && point[1] > 0.0).map(|point| point[0]);
    let range = used.fold([f64::INFINITY, 0.0_f64], |[low, high], x| [low.min(x), high.max(x)]);
    Some(PowerLaw { coefficient: elementary::exp(line.intercept), slope: line.slope, slope_error, range })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_power_law_is_found_again() {
        let points: Vec<[f64; 2]> = (4..13).map(|k| f64::from(1 << k)).map(|x| [x, 3.0 / x.sqrt()]).collect();
        let law = power_law(&points).unwrap();
        assert!((law.slope + 0.5).abs() < 1e-13 && (law.coefficient - 3.0).abs() < 1e-12, "{law:?}");
        assert!(law.slope_error.unwrap() < 1e-13);
        assert_eq!(law.range, [16.0, 4096.0]);
    }

    #[test]
    fn the_error_of_a_slope_is_that_of_the_closed_form() {
        // ln x = -1, 0, 1 with ln y = 0, d, 0: slope 0, residuals -d/3, 2d/3, -d/3, error sqrt(6/9 d^2 / 1 / 2).
        let d = 0.3;
        let points = [[elementary::exp(-1.0), 1.0], [1.0, elementary::exp(d)], [elementary::exp(1.0), 1.0]];
        let law = power_law(&points).unwrap();
        assert!(law.slope.abs() < 1e-15);
        assert!((law.slope_error.unwrap() - (d * d / 3.0).sqrt()).abs() < 1e-15);
        assert!((law.coefficient - elementary::exp(d / 3.0)).abs() < 1e-15);
    }

    #[test]
    fn a_law_needs_two_points() {
        assert_eq!(power_law(&[[2.0, 1.0], [2.0, 3.0], [4.0, 0.0]]), None);
        assert_eq!(power_law(&[[2.0, 8.0], [4.0, 4.0]]).unwrap().slope_error, None);
    }

    #[test]
    fn one_number_has_a_mean_and_no_interval() {
        let single = mean_interval(&[2.5], 0.95).unwrap();
        assert_eq!((single.mean, single.count, single.interval), (2.5, 1, None));
        assert_eq!(mean_interval(&[], 0.95), None);
    }

    #[test]
    fn intervals_cover_the_truth_as_often_as_they_say() {
        use crate::math::stream::{Purpose, Stream};
        let stream = Stream::new(11, Purpose::Test);
        let trials = 4000;
        let covered = (0..trials)
            .filter(|trial| {
                let mut numbers = stream.generator(*trial);
                // Sums of twelve uniform numbers are close to normal, about 6.
                let values: Vec<f64> = (0..5).map(|_| (0..12).map(|_| numbers.uniform()).sum()).collect();
                let [low, high] = mean_interval(&values, 0.9).unwrap().interval.unwrap();
                low <= 6.0 && 6.0 <= high
            })
            .count();
        // Four standard errors of a proportion of 0.9 in 4000.
        assert!((covered as f64 / trials as f64 - 0.9).abs() < 4.0 * (0.09_f64 / trials as f64).sqrt(), "{covered}");
    }
}

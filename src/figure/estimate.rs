//! What a figure says of repeated and scaled measurements: means with intervals, power laws.
//!
//! Knows no table and no drawing. Formulas: Student, "The probable error of a mean" (1908); ordinary least
//! squares on logarithms for power laws.

use serde::{Deserialize, Serialize};

use crate::math::elementary;

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
    let reach = student_t_quantile(0.5 + level / 2.0, (count - 1) as f64) * standard_error;
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

/// Least squares of ln y on ln x over the points with positive x and y; `None` for fewer than two different x.
pub fn power_law(points: &[[f64; 2]]) -> Option<PowerLaw> {
    let logs: Vec<[f64; 2]> =
        points.iter().filter(|point| point[0] > 0.0 && point[1] > 0.0).map(|point| point.map(elementary::ln)).collect();
    let count = logs.len() as f64;
    let mean = [0, 1].map(|k| logs.iter().map(|point| point[k]).sum::<f64>() / count);
    let sum_xx: f64 = logs.iter().map(|[x, _]| (x - mean[0]) * (x - mean[0])).sum();
    let sum_xy: f64 = logs.iter().map(|[x, y]| (x - mean[0]) * (y - mean[1])).sum();
    if logs.len() < 2 || sum_xx <= 0.0 {
        return None;
    }
    let slope = sum_xy / sum_xx;
    let intercept = mean[1] - slope * mean[0];
    let residuals: f64 = logs.iter().map(|[x, y]| y - intercept - slope * x).map(|residual| residual * residual).sum();
    let slope_error = (logs.len() > 2).then(|| (residuals / (count - 2.0) / sum_xx).sqrt());
    let used = points.iter().filter(|point| point[0] > 0.0 && point[1] > 0.0).map(|point| point[0]);
    let range = used.fold([f64::INFINITY, 0.0_f64], |[low, high], x| [low.min(x), high.max(x)]);
    Some(PowerLaw { coefficient: elementary::exp(intercept), slope, slope_error, range })
}

/// The t with P(T <= t) = `probability` for Student's distribution; `probability` in [0.5, 1).
fn student_t_quantile(probability: f64, degrees: f64) -> f64 {
    let tail = |t: f64| incomplete_beta(degrees / (degrees + t * t), degrees / 2.0, 0.5) / 2.0;
    let mut high = 1.0;
    while tail(high) > 1.0 - probability && high < 1e300 {
        high *= 2.0;
    }
    let mut low = 0.0;
    // Halving ends when the two are neighbors: 60 halvings of a factor of two, and a few for the first interval.
    for _ in 0..64 {
        let middle = (low + high) / 2.0;
        if tail(middle) > 1.0 - probability { low = middle } else { high = middle }
    }
    (low + high) / 2.0
}

/// The regularized incomplete beta function I_x(a, b), by Lentz's continued fraction.
///
/// Abramowitz and Stegun 26.5.8; the fraction converges for x < (a + 1) / (a + b + 2), elsewhere I_x(a, b) = 1 - I_{1-x}(b, a).
fn incomplete_beta(x: f64, a: f64, b: f64) -> f64 {
    if x <= 0.0 || x >= 1.0 {
        return if x <= 0.0 { 0.0 } else { 1.0 };
    }
    if x > (a + 1.0) / (a + b + 2.0) {
        return 1.0 - incomplete_beta(1.0 - x, b, a);
    }
    let ln_beta = elementary::ln_gamma(a) + elementary::ln_gamma(b) - elementary::ln_gamma(a + b);
    let front = elementary::exp(a * elementary::ln(x) + b * elementary::ln_1p(-x) - ln_beta) / a;
    let apart = |value: f64| if value.abs() < 1e-300 { 1e-300 } else { value };
    let (mut c, mut d, mut fraction) = (1.0, 1.0 / apart(1.0 - (a + b) * x / (a + 1.0)), 1.0);
    fraction *= d;
    for m in 1..500 {
        let m = f64::from(m);
        let even = m * (b - m) * x / ((a + 2.0 * m - 1.0) * (a + 2.0 * m));
        let odd = -(a + m) * (a + b + m) * x / ((a + 2.0 * m) * (a + 2.0 * m + 1.0));
        let before = fraction;
        for step in [even, odd] {
            d = 1.0 / apart(1.0 + step * d);
            c = apart(1.0 + step / c);
            fraction *= c * d;
        }
        if (fraction - before).abs() <= 1e-16 * fraction.abs() {
            break;
        }
    }
    front * fraction
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn student_quantiles_are_those_of_closed_forms_and_tables() {
        // One degree: tan(pi (p - 1/2)). Two: (2p - 1) sqrt(2 / (1 - (2p - 1)^2)).
        let one = elementary::tan(std::f64::consts::PI * 0.475);
        let two = 0.95 * (2.0_f64 / (1.0 - 0.95 * 0.95)).sqrt();
        assert!((student_t_quantile(0.975, 1.0) / one - 1.0).abs() < 1e-11);
        assert!((student_t_quantile(0.975, 2.0) / two - 1.0).abs() < 1e-11);
        // Published tables (Abramowitz and Stegun 26.10), three digits after the point.
        for (degrees, quantile) in [(5.0, 2.571), (15.0, 2.131), (30.0, 2.042), (120.0, 1.980)] {
            assert!((student_t_quantile(0.975, degrees) - quantile).abs() < 6e-4, "{degrees}");
        }
        assert!((student_t_quantile(0.975, 1e7) - 1.959_963_98).abs() < 1e-5);
        assert!((student_t_quantile(0.995, 15.0) - 2.947).abs() < 6e-4);
    }

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

//! Means, variances, quantiles, intervals, slopes and goodness-of-fit tests.
//!
//! Sums are compensated and run in the order of the values, so that equal values give equal bits.
//! Distribution functions come from the regularized incomplete gamma and beta functions, quantiles
//! from bisecting the function itself: what they lack in speed they have in range.
//!
//! After Press et al., "Numerical Recipes", 3rd edition, chapters 6 and 14 (2007); Neumaier,
//! "Rundungsfehleranalyse einiger Verfahren zur Summation endlicher Summen" (1974).

use crate::math::elementary;

/// Sum of the values, in order, with the rounding errors carried along (Neumaier 1974).
pub fn sum(values: impl IntoIterator<Item = f64>) -> f64 {
    let mut total = 0.0_f64;
    let mut lost = 0.0_f64;
    for value in values {
        let next = total + value;
        lost += if total.abs() >= value.abs() { (total - next) + value } else { (value - next) + total };
        total = next;
    }
    // After an overflow the carried error is NaN, and the plain sum is the answer.
    if lost.is_finite() { total + lost } else { total }
}

/// Arithmetic mean; NaN of nothing.
pub fn mean(values: &[f64]) -> f64 {
    sum(values.iter().copied()) / values.len() as f64
}

/// Unbiased sample variance (divisor n - 1) in two passes; NaN of fewer than two values.
pub fn variance(values: &[f64]) -> f64 {
    if values.len() < 2 {
        return f64::NAN;
    }
    let center = mean(values);
    let squares = sum(values.iter().map(|value| (value - center) * (value - center)));
    // The sum of deviations would be zero but for the rounding of the mean (Chan, Golub, LeVeque 1983).
    let drift = sum(values.iter().map(|value| value - center));
    (squares - drift * drift / values.len() as f64) / (values.len() - 1) as f64
}

/// Standard error of the mean, sqrt(variance / n); NaN of fewer than two values.
pub fn standard_error(values: &[f64]) -> f64 {
    (variance(values) / values.len() as f64).sqrt()
}

/// A closed interval.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Interval {
    /// Lower end.
    pub low: f64,
    /// Upper end.
    pub high: f64,
}

/// Student-t interval for the mean of normal values at `confidence` in (0, 1); NaN of fewer than two values.
pub fn mean_interval(values: &[f64], confidence: f64) -> Interval {
    let center = mean(values);
    let half = student_t_quantile(0.5 + confidence / 2.0, values.len().saturating_sub(1) as f64) * standard_error(values);
    Interval { low: center - half, high: center + half }
}

/// Chi-square interval for the variance of normal values at `confidence` in (0, 1); NaN of fewer than two values.
pub fn variance_interval(values: &[f64], confidence: f64) -> Interval {
    let freedom = values.len().saturating_sub(1) as f64;
    let squares = variance(values) * freedom;
    Interval {
        low: squares / chi_square_quantile(0.5 + confidence / 2.0, freedom),
        high: squares / chi_square_quantile(0.5 - confidence / 2.0, freedom),
    }
}

/// F interval for the ratio of the variances of two independent normal sets at `confidence` in (0, 1).
pub fn variance_ratio_interval(above: &[f64], below: &[f64], confidence: f64) -> Interval {
    let ratio = variance(above) / variance(below);
    let (m, n) = (above.len().saturating_sub(1) as f64, below.len().saturating_sub(1) as f64);
    Interval { low: ratio / f_quantile(0.5 + confidence / 2.0, m, n), high: ratio / f_quantile(0.5 - confidence / 2.0, m, n) }
}

/// Linear interpolation between order statistics: position p (n - 1) of the sorted values, p in [0, 1].
///
/// Hyndman and Fan's type 7, the rule of numpy and R. NaN of nothing.
pub fn percentile(sorted: &[f64], p: f64) -> f64 {
    let Some(last) = sorted.len().checked_sub(1) else { return f64::NAN };
    let position = p.clamp(0.0, 1.0) * last as f64;
    let below = position.floor() as usize;
    let above = (below + 1).min(last);
    sorted[below] + (sorted[above] - sorted[below]) * (position - below as f64)
}

/// A line through points, by least squares.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Line {
    /// Change of y per unit of x.
    pub slope: f64,
    /// y at x = 0.
    pub intercept: f64,
    /// Standard error of the slope from the residuals; NaN with fewer than three points.
    pub standard_error: f64,
}

/// The line of least squares through (x, y); `None` with fewer than two different x.
///
/// For a rate of convergence give it ln N and ln RMSE.
///
/// # Panics
/// If the lists differ in length.
pub fn slope(x: &[f64], y: &[f64]) -> Option<Line> {
    assert_eq!(x.len(), y.len(), "each x has its y");
    let (x_mean, y_mean) = (mean(x), mean(y));
    let sxx = sum(x.iter().map(|x| (x - x_mean) * (x - x_mean)));
    let sxy = sum(x.iter().zip(y).map(|(x, y)| (x - x_mean) * (y - y_mean)));
    if x.len() < 2 || sxx.is_nan() || sxx <= 0.0 {
        return None;
    }
    let slope = sxy / sxx;
    let intercept = y_mean - slope * x_mean;
    let residual = |(x, y): (&f64, &f64)| (y - y_mean) - slope * (x - x_mean);
    let squares = sum(x.iter().zip(y).map(|point| residual(point) * residual(point)));
    let standard_error = if x.len() < 3 { f64::NAN } else { (squares / (x.len() - 2) as f64 / sxx).sqrt() };
    Some(Line { slope, intercept, standard_error })
}

/// Level of each of `count` independent tests such that all together have `level`: 1 - (1 - level)^(1/count).
///
/// Šidák, "Rectangular confidence regions for the means of multivariate normal distributions" (1967).
pub fn sidak_level(level: f64, count: u32) -> f64 {
    // Through the logarithm of 1 - level: for small levels 1 - level has lost their digits.
    let log_kept = elementary::ln_1p(-level) / f64::from(count.max(1));
    // 1 - e^x = -2 e^(x/2) sinh(x/2); the series of the difference is accurate where x is tiny.
    if log_kept > -1e-5 { -log_kept * (1.0 + log_kept / 2.0 * (1.0 + log_kept / 3.0)) } else { 1.0 - elementary::exp(log_kept) }
}

/// Outcome of a chi-square test of observed counts against expected ones.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ChiSquareTest {
    /// Sum of (observed - expected)² / expected over the cells after pooling.
    pub statistic: f64,
    /// Cells after pooling, less one; 0 where nothing can be tested.
    pub degrees_of_freedom: usize,
    /// Probability of a statistic at least as large if the expectation holds; 0 where an impossible cell was hit.
    pub p_value: f64,
}

/// Cells of fewer expected counts than this are pooled (Cochran 1954).
const SMALLEST_EXPECTED: f64 = 5.0;

/// Pearson's chi-square test for independent draws; the expected counts sum to the number of draws.
///
/// Cells are pooled from the smallest expectation upwards until each has at least 5; a count in a cell
/// of expectation 0 refutes it outright. Not valid for stratified or clustered draws.
///
/// # Panics
/// If the lists differ in length.
pub fn chi_square_test(observed: &[u64], expected: &[f64]) -> ChiSquareTest {
    assert_eq!(observed.len(), expected.len(), "each count has its expectation");
    let is_impossible = |(&count, &expectation): (&u64, &f64)| count > 0 && (expectation.is_nan() || expectation <= 0.0);
    let cells = pooled_cells(observed, expected);
    let statistic = sum(cells.iter().map(|cell| (cell.0 - cell.1) * (cell.0 - cell.1) / cell.1));
    let degrees_of_freedom = cells.len().saturating_sub(1);
    let p_value = if observed.iter().zip(expected).any(is_impossible) {
        0.0
    } else if degrees_of_freedom == 0 {
        1.0
    } else {
        chi_square_upper(statistic, degrees_of_freedom as f64)
    };
    ChiSquareTest { statistic, degrees_of_freedom, p_value }
}

/// (observed, expected) of the cells after pooling, smallest expectation first; cells of none are left out.
fn pooled_cells(observed: &[u64], expected: &[f64]) -> Vec<(f64, f64)> {
    let mut order: Vec<usize> = (0..expected.len()).filter(|&cell| expected[cell] > 0.0).collect();
    order.sort_by(|&a, &b| expected[a].total_cmp(&expected[b]).then(a.cmp(&b)));
    let mut cells: Vec<(f64, f64)> = Vec::new();
    let mut open = (0.0, 0.0);
    for cell in order {
        open = (open.0 + observed[cell] as f64, open.1 + expected[cell]);
        if open.1 >= SMALLEST_EXPECTED {
            cells.push(std::mem::take(&mut open));
        }
    }
    // What is left at the end, all together below 5, joins the last cell, or stands alone.
    match cells.last_mut() {
        Some(last) => *last = (last.0 + open.0, last.1 + open.1),
        None if open.1 > 0.0 => cells.push(open),
        None => {}
    }
    cells
}

/// Probability that a standard normal number is at most z.
pub fn normal_cdf(z: f64) -> f64 {
    if z < 0.0 { 0.5 * gamma_upper(0.5, z * z / 2.0) } else { 0.5 + 0.5 * gamma_lower(0.5, z * z / 2.0) }
}

/// The z below which a standard normal number lies with probability p in (0, 1); infinite at the ends.
pub fn normal_quantile(p: f64) -> f64 {
    symmetric_quantile(p, normal_cdf)
}

/// Probability that Student's t with `freedom` > 0 degrees of freedom is at most t.
pub fn student_t_cdf(t: f64, freedom: f64) -> f64 {
    // Both arguments of the beta function are formed without cancellation.
    let tail = 0.5 * beta_split(freedom / 2.0, 0.5, freedom / (freedom + t * t), t * t / (freedom + t * t));
    if t < 0.0 { tail } else { 1.0 - tail }
}

/// The t below which Student's t with `freedom` > 0 degrees of freedom lies with probability p.
pub fn student_t_quantile(p: f64, freedom: f64) -> f64 {
    if freedom.is_nan() || freedom <= 0.0 {
        return f64::NAN;
    }
    symmetric_quantile(p, |t| student_t_cdf(t, freedom))
}

/// Probability that chi-square with `freedom` > 0 degrees of freedom is at most x.
pub fn chi_square_cdf(x: f64, freedom: f64) -> f64 {
    gamma_lower(freedom / 2.0, x.max(0.0) / 2.0)
}

/// Probability that chi-square with `freedom` > 0 degrees of freedom is above x; accurate where it is tiny.
pub fn chi_square_upper(x: f64, freedom: f64) -> f64 {
    gamma_upper(freedom / 2.0, x.max(0.0) / 2.0)
}

/// The x below which chi-square with `freedom` > 0 degrees of freedom lies with probability p.
pub fn chi_square_quantile(p: f64, freedom: f64) -> f64 {
    positive_quantile(p, freedom, |x| chi_square_cdf(x, freedom), |x| chi_square_upper(x, freedom))
}

/// Probability that F with `above` and `below` > 0 degrees of freedom is at most x.
pub fn f_cdf(x: f64, above: f64, below: f64) -> f64 {
    let x = x.max(0.0);
    beta_split(above / 2.0, below / 2.0, above * x / (above * x + below), below / (above * x + below))
}

/// Probability that F with `above` and `below` > 0 degrees of freedom is above x; accurate where it is tiny.
pub fn f_upper(x: f64, above: f64, below: f64) -> f64 {
    let x = x.max(0.0);
    beta_split(below / 2.0, above / 2.0, below / (above * x + below), above * x / (above * x + below))
}

/// The x below which F with `above` and `below` > 0 degrees of freedom lies with probability p.
pub fn f_quantile(p: f64, above: f64, below: f64) -> f64 {
    positive_quantile(p, above.min(below), |x| f_cdf(x, above, below), |x| f_upper(x, above, below))
}

/// Regularized lower incomplete gamma function P(a, x) for a > 0, x >= 0.
pub fn gamma_lower(a: f64, x: f64) -> f64 {
    match is_in_domain(a, x) {
        false => f64::NAN,
        true if x == 0.0 => 0.0,
        true if x < a + 1.0 => gamma_series(a, x),
        true => 1.0 - gamma_fraction(a, x),
    }
}

/// Regularized upper incomplete gamma function Q(a, x) = 1 - P(a, x) for a > 0, x >= 0.
pub fn gamma_upper(a: f64, x: f64) -> f64 {
    match is_in_domain(a, x) {
        false => f64::NAN,
        true if x == 0.0 => 1.0,
        true if x < a + 1.0 => 1.0 - gamma_series(a, x),
        true => gamma_fraction(a, x),
    }
}

/// Regularized incomplete beta function I_x(a, b) for a, b > 0, x in [0, 1].
pub fn beta(a: f64, b: f64, x: f64) -> f64 {
    beta_split(a, b, x, 1.0 - x)
}

fn is_in_domain(a: f64, x: f64) -> bool {
    a > 0.0 && a.is_finite() && x >= 0.0
}

/// Terms after which a series or fraction is given up: enough for a up to about 1e8.
const TERM_LIMIT: u32 = 200_000;

/// x^a e^-x / gamma(a), the factor before series and fraction.
fn gamma_factor(a: f64, x: f64) -> f64 {
    if x.is_infinite() { 0.0 } else { elementary::exp(a * elementary::ln(x) - x - elementary::ln_gamma(a)) }
}

/// P(a, x) as a power series; converges fast for x < a + 1.
fn gamma_series(a: f64, x: f64) -> f64 {
    let mut term = 1.0 / a;
    let mut total = term;
    for n in 1..TERM_LIMIT {
        term *= x / (a + f64::from(n));
        total += term;
        if term < total * f64::EPSILON / 2.0 {
            break;
        }
    }
    (total * gamma_factor(a, x)).min(1.0)
}

/// Smallest magnitude that Lentz's method lets a denominator have.
const TINY: f64 = 1e-300;

/// Q(a, x) as a continued fraction by the modified Lentz method; converges fast for x >= a + 1.
fn gamma_fraction(a: f64, x: f64) -> f64 {
    if x.is_infinite() {
        return 0.0;
    }
    let mut b = x + 1.0 - a;
    let mut c = 1.0 / TINY;
    let mut d = 1.0 / b;
    let mut h = d;
    for n in 1..TERM_LIMIT {
        let numerator = -f64::from(n) * (f64::from(n) - a);
        b += 2.0;
        d = 1.0 / away_from_zero(numerator * d + b);
        c = away_from_zero(b + numerator / c);
        h *= d * c;
        if (d * c - 1.0).abs() < f64::EPSILON {
            break;
        }
    }
    h * gamma_factor(a, x)
}

fn away_from_zero(x: f64) -> f64 {
    if x.abs() < TINY { TINY } else { x }
}

/// I_x(a, b) with `rest` = 1 - x given apart, where x near 1 would have lost it.
fn beta_split(a: f64, b: f64, x: f64, rest: f64) -> f64 {
    if x.is_nan() || x <= 0.0 || rest.is_nan() || rest <= 0.0 || !(a > 0.0 && b > 0.0) {
        return if x <= 0.0 {
            0.0
        } else if rest <= 0.0 {
            1.0
        } else {
            f64::NAN
        };
    }
    let log_factor =
        elementary::ln_gamma(a + b) - elementary::ln_gamma(a) - elementary::ln_gamma(b) + a * elementary::ln(x) + b * elementary::ln(rest);
    let factor = elementary::exp(log_factor);
    // The fraction converges fast below the mean; above it, symmetry I_x(a, b) = 1 - I_(1-x)(b, a).
    if x < (a + 1.0) / (a + b + 2.0) { factor * beta_fraction(a, b, x) / a } else { 1.0 - factor * beta_fraction(b, a, rest) / b }
}

/// The continued fraction of the incomplete beta function by the modified Lentz method.
fn beta_fraction(a: f64, b: f64, x: f64) -> f64 {
    let mut c = 1.0;
    let mut d = 1.0 / away_from_zero(1.0 - (a + b) * x / (a + 1.0));
    let mut h = d;
    for m in 1..TERM_LIMIT {
        let m = f64::from(m);
        let even = m * (b - m) * x / ((a + 2.0 * m - 1.0) * (a + 2.0 * m));
        d = 1.0 / away_from_zero(1.0 + even * d);
        c = away_from_zero(1.0 + even / c);
        h *= d * c;
        let odd = -(a + m) * (a + b + m) * x / ((a + 2.0 * m) * (a + 2.0 * m + 1.0));
        d = 1.0 / away_from_zero(1.0 + odd * d);
        c = away_from_zero(1.0 + odd / c);
        h *= d * c;
        if (d * c - 1.0).abs() < f64::EPSILON {
            break;
        }
    }
    h
}

/// Quantile of a distribution that is symmetric about zero, from its lower tail.
fn symmetric_quantile(p: f64, cdf: impl Fn(f64) -> f64) -> f64 {
    if p.is_nan() || !(0.0..=1.0).contains(&p) {
        return f64::NAN;
    }
    if p == 0.5 {
        return 0.0;
    }
    let tail = p.min(1.0 - p);
    let magnitude = if tail == 0.0 { f64::INFINITY } else { crossing(1.0, |x| cdf(-x) <= tail) };
    if p < 0.5 { -magnitude } else { magnitude }
}

/// Quantile of a positive distribution, from the tail that holds fewer of its digits.
fn positive_quantile(p: f64, freedom: f64, lower: impl Fn(f64) -> f64, upper: impl Fn(f64) -> f64) -> f64 {
    if p.is_nan() || !(0.0..=1.0).contains(&p) || freedom.is_nan() || freedom <= 0.0 {
        return f64::NAN;
    }
    match p {
        0.0 => 0.0,
        1.0 => f64::INFINITY,
        p if p <= 0.5 => crossing(freedom, |x| lower(x) >= p),
        p => crossing(freedom, |x| upper(x) <= 1.0 - p),
    }
}

/// The smallest x > 0 from which on `is_beyond` holds, to the last bits; `start` is a guess of its size.
fn crossing(start: f64, is_beyond: impl Fn(f64) -> bool) -> f64 {
    let (mut low, mut high) = (start, start);
    while !is_beyond(high) && high < f64::MAX / 4.0 {
        (low, high) = (high, high * 4.0);
    }
    while is_beyond(low) && low > f64::MIN_POSITIVE * 4.0 {
        (low, high) = (low / 4.0, low);
    }
    // A bracket of a factor 4 has at most 2^54 floats in it.
    for _ in 0..60 {
        let middle = low + (high - low) / 2.0;
        if is_beyond(middle) {
            high = middle;
        } else {
            low = middle;
        }
    }
    high
}

#[cfg(test)]
mod tests {
    use super::*;

    fn is_near(found: f64, expected: f64, relative: f64) -> bool {
        (found - expected).abs() <= relative * expected.abs()
    }

    #[test]
    fn a_compensated_sum_keeps_what_a_plain_sum_loses() {
        assert_eq!(sum([1.0, 1e100, 1.0, -1e100]), 2.0);
        assert_eq!(sum([f64::MAX, f64::MAX]), f64::INFINITY);
        assert_eq!(sum([]), 0.0);
    }

    #[test]
    fn a_variance_survives_a_large_offset() {
        let values: Vec<f64> = [4.0, 7.0, 13.0, 16.0].iter().map(|x| x + 1e9).collect();
        assert_eq!(variance(&values), 30.0);
        assert!(variance(&[1.0]).is_nan());
        assert!(mean(&[]).is_nan());
    }

    /// Tables of Abramowitz and Stegun, chapter 26, and of the NIST handbook, section 1.3.6.7.
    #[test]
    fn quantiles_agree_with_published_tables() {
        assert!(is_near(normal_quantile(0.975), 1.959963984540054, 1e-14));
        assert!(is_near(normal_quantile(1e-10), -6.361340902404056, 1e-13));
        assert!(is_near(student_t_quantile(0.975, 15.0), 2.131449545559323, 1e-12));
        assert!(is_near(student_t_quantile(0.975, 1.0), 12.706204736174698, 1e-11));
        assert!(is_near(chi_square_quantile(0.95, 10.0), 18.307038053275146, 1e-13));
        assert!(is_near(chi_square_quantile(0.025, 15.0), 6.262137795043253, 1e-12));
        assert!(is_near(f_quantile(0.95, 5.0, 10.0), 3.325834530413011, 1e-12));
        assert!(is_near(f_quantile(0.975, 15.0, 15.0), 2.862, 2e-4));
    }

    #[test]
    fn distribution_functions_agree_with_closed_forms() {
        for x in [0.01, 0.3, 1.0, 2.5, 9.0, 40.0] {
            // Two degrees of freedom: exponential. One for t: Cauchy. P(1/2, x²) is the error function.
            assert!(is_near(chi_square_upper(x, 2.0), elementary::exp(-x / 2.0), 1e-13));
            assert!(is_near(student_t_cdf(-x, 1.0), 0.5 - elementary::atan(x) / std::f64::consts::PI, 1e-11));
            assert!(is_near(gamma_lower(0.5, x * x), elementary::erf(x), 1e-14));
            // F with two degrees of freedom above: 1 - (1 + 2 x / n)^(-n/2).
            assert!(is_near(f_upper(x, 2.0, 6.0), elementary::pow(1.0 + x / 3.0, -3.0), 1e-12));
        }
        // I_x(2, 3) = 6 x² - 8 x³ + 3 x⁴.
        for x in [0.1_f64, 0.5, 0.9] {
            assert!(is_near(beta(2.0, 3.0, x), x * x * (6.0 - 8.0 * x + 3.0 * x * x), 1e-13));
        }
    }

    #[test]
    fn quantiles_invert_their_functions_over_a_wide_range() {
        for freedom in [1.0, 2.5, 30.0, 1000.0, 1e6] {
            for p in [1e-12, 1e-3, 0.2, 0.5, 0.8, 0.999] {
                assert!(is_near(chi_square_cdf(chi_square_quantile(p, freedom), freedom), p, 1e-8), "chi-square {freedom} {p}");
                assert!(is_near(student_t_cdf(student_t_quantile(p, freedom), freedom), p, 1e-8), "t {freedom} {p}");
                assert!(is_near(f_cdf(f_quantile(p, freedom, 7.0), freedom, 7.0), p, 1e-8), "F {freedom} {p}");
            }
        }
        assert_eq!(normal_quantile(0.0), f64::NEG_INFINITY);
        assert_eq!(normal_quantile(0.5), 0.0);
        assert!(normal_quantile(1.5).is_nan());
        assert!(student_t_quantile(0.9, 0.0).is_nan());
    }

    #[test]
    fn intervals_of_a_known_set_agree_with_hand_work() {
        // Mean 10, variance 30, n 4: t(.975, 3) = 3.182446305284263, chi-square(3) .21579528262 and 9.3484036045.
        let values = [4.0, 7.0, 13.0, 16.0];
        let mean = mean_interval(&values, 0.95);
        let half = 3.182446305284263 * (30.0_f64 / 4.0).sqrt();
        assert!(is_near(mean.low, 10.0 - half, 1e-11) && is_near(mean.high, 10.0 + half, 1e-11));
        let variance = variance_interval(&values, 0.95);
        assert!(is_near(variance.low, 90.0 / 9.348403604496148, 1e-11) && is_near(variance.high, 90.0 / 0.2157952826238981, 1e-11));
        let ratio = variance_ratio_interval(&values, &values, 0.95);
        assert!(is_near(ratio.low * ratio.high, 1.0, 1e-12));
    }

    #[test]
    fn percentiles_interpolate_between_order_statistics() {
        assert_eq!(percentile(&[1.0, 2.0, 4.0], 0.75), 3.0);
        assert_eq!(percentile(&[1.0, 2.0, 4.0], 1.0), 4.0);
        assert!(percentile(&[], 0.5).is_nan());
    }

    #[test]
    fn a_line_through_noisy_points_has_the_textbook_slope_and_error() {
        let line = slope(&[1.0, 2.0, 3.0, 4.0], &[6.0, 5.0, 7.0, 10.0]).unwrap();
        // Sxx = 5, Sxy = 7, residual squares 4.2: slope 1.4, error sqrt(4.2 / 2 / 5).
        assert!(is_near(line.slope, 1.4, 1e-14) && is_near(line.intercept, 3.5, 1e-14));
        assert!(is_near(line.standard_error, 0.42_f64.sqrt(), 1e-14));
        assert_eq!(slope(&[1.0, 1.0], &[1.0, 2.0]), None);
        assert_eq!(slope(&[], &[]), None);
        assert!(slope(&[0.0, 1.0], &[0.0, 1.0]).unwrap().standard_error.is_nan());
    }

    #[test]
    fn sidak_levels_multiply_back_to_the_whole() {
        for (level, count) in [(0.001, 1), (0.001, 24), (0.05, 1_000_000), (1e-9, 3)] {
            let kept = f64::from(count) * elementary::ln_1p(-sidak_level(level, count));
            assert!(is_near(kept, elementary::ln_1p(-level), 1e-10), "{level} {count}");
        }
    }

    #[test]
    fn a_chi_square_test_agrees_with_hand_work() {
        // Mendel's peas: 315, 108, 101, 32 against 9:3:3:1; chi-square .470, p .925.
        let total = 556.0;
        let expected = [9.0, 3.0, 3.0, 1.0].map(|part| part * total / 16.0);
        let test = chi_square_test(&[315, 108, 101, 32], &expected);
        assert_eq!(test.degrees_of_freedom, 3);
        assert!((test.statistic - 0.470024).abs() < 1e-6, "{test:?}");
        assert!((test.p_value - 0.925426).abs() < 1e-6, "{test:?}");
    }

    #[test]
    fn small_cells_are_pooled_and_impossible_ones_refute() {
        let test = chi_square_test(&[2, 3, 3, 92], &[2.0, 3.0, 3.0, 92.0]);
        assert_eq!((test.statistic, test.degrees_of_freedom, test.p_value), (0.0, 1, 1.0));
        assert_eq!(chi_square_test(&[1, 99], &[0.0, 100.0]).p_value, 0.0);
        assert_eq!(chi_square_test(&[], &[]).p_value, 1.0);
        assert_eq!(chi_square_test(&[3], &[3.0]).degrees_of_freedom, 0);
    }

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
}

//! Pixel filters, drawn from rather than weighted with.
//!
//! All are products of one function of x and the same of y, at least zero, with a radius in pixels. After Ernst,
//! Stamminger and Greiner, "Filter importance sampling" (2006).

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::math::elementary;

/// How much of its surroundings a pixel sees.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum FilterDescription {
    /// All of a square alike.
    Box(BoxFilter),
    /// Falls linearly to zero.
    Tent(TentFilter),
    /// A bell curve, lowered so that it is zero at its radius.
    Gaussian(GaussianFilter),
}

impl Default for FilterDescription {
    fn default() -> Self {
        Self::Box(BoxFilter::default())
    }
}

/// All of a square alike.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct BoxFilter {
    /// Half of the side of the square. Default 0.5: the pixel itself.
    #[serde(default = "half")]
    #[schemars(range(max = 16), extend("exclusiveMinimum" = 0, "x-unit" = "px"))]
    pub radius: f32,
}

/// Falls linearly to zero.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct TentFilter {
    /// Where it is zero. Default 1.
    #[serde(default = "one")]
    #[schemars(range(max = 16), extend("exclusiveMinimum" = 0, "x-unit" = "px"))]
    pub radius: f32,
}

/// A bell curve, lowered so that it is zero at its radius.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct GaussianFilter {
    /// Where it is zero. Default 1.5.
    #[serde(default = "one_and_half")]
    #[schemars(range(max = 16), extend("exclusiveMinimum" = 0, "x-unit" = "px"))]
    pub radius: f32,
    /// Standard deviation. Default 0.5.
    #[serde(default = "half")]
    #[schemars(range(min = 0.01, max = 16), extend("x-unit" = "px"))]
    pub deviation: f32,
}

fn half() -> f32 {
    0.5
}

fn one() -> f32 {
    1.0
}

fn one_and_half() -> f32 {
    1.5
}

impl Default for BoxFilter {
    fn default() -> Self {
        Self { radius: half() }
    }
}

/// A filter ready to be drawn from.
#[derive(Debug, Clone, PartialEq)]
pub enum Filter {
    /// Uniform on a square of that half side.
    Box(f32),
    /// Linear to that radius.
    Tent(f32),
    /// Positions at equal steps of the cumulative function, with straight lines between.
    Tabulated(Vec<f32>),
}

/// Steps of a tabulated filter.
const STEPS: usize = 1024;

impl FilterDescription {
    /// Ready to be drawn from.
    pub fn compiled(&self) -> Filter {
        match self {
            Self::Box(kind) => Filter::Box(kind.radius),
            Self::Tent(kind) => Filter::Tent(kind.radius),
            Self::Gaussian(kind) => Filter::Tabulated(kind.quantiles()),
        }
    }
}

impl GaussianFilter {
    /// Its value at a distance from the center of the pixel, not normalized.
    fn value(&self, distance: f64) -> f64 {
        let bell = |x: f64| elementary::exp(-0.5 * x * x / f64::from(self.deviation * self.deviation));
        (bell(distance) - bell(f64::from(self.radius))).max(0.0)
    }

    /// Where the cumulative function is k / `STEPS`, by the trapezoidal rule on fine steps.
    fn quantiles(&self) -> Vec<f32> {
        const FINE: usize = 16_384;
        let radius = f64::from(self.radius);
        let position = |k: usize| radius * (2.0 * k as f64 / FINE as f64 - 1.0);
        let mut cumulative = vec![0.0];
        for k in 1..=FINE {
            cumulative.push(cumulative[k - 1] + self.value(position(k - 1)) + self.value(position(k)));
        }
        let total = cumulative[FINE];
        if total <= 0.0 {
            // A bell so flat that lowering it leaves only rounding is a box.
            return (0..=STEPS).map(|k| (radius * (2.0 * k as f64 / STEPS as f64 - 1.0)) as f32).collect();
        }
        let quantile = |step: usize| {
            let target = total * step as f64 / STEPS as f64;
            let above = cumulative.partition_point(|sum| *sum < target).clamp(1, FINE);
            let (low, high) = (cumulative[above - 1], cumulative[above]);
            let part = if high > low { (target - low) / (high - low) } else { 0.0 };
            (position(above - 1) + part * (position(above) - position(above - 1))) as f32
        };
        (0..=STEPS).map(quantile).collect()
    }
}

impl Filter {
    /// Where a sample lies, in pixels from the center of its pixel.
    #[inline]
    pub fn offset(&self, point: [f32; 2]) -> [f32; 2] {
        match self {
            Self::Box(radius) => point.map(|u| (2.0 * u - 1.0) * radius),
            Self::Tent(radius) => point.map(|u| tent(u) * radius),
            Self::Tabulated(quantiles) => point.map(|u| {
                let position = u * STEPS as f32;
                let step = (position as usize).min(STEPS - 1);
                quantiles[step] + (position - step as f32) * (quantiles[step + 1] - quantiles[step])
            }),
        }
    }
}

/// Inverts the cumulative function of 1 - |x| on [-1, 1].
#[inline]
fn tent(u: f32) -> f32 {
    if u < 0.5 { (2.0 * u).sqrt() - 1.0 } else { 1.0 - (2.0 - 2.0 * u).sqrt() }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Mean of f over the filter, by points at equal steps.
    fn mean(filter: &Filter, f: impl Fn(f64) -> f64) -> f64 {
        const COUNT: u32 = 100_000;
        (0..COUNT).map(|k| f(f64::from(filter.offset([(k as f32 + 0.5) / COUNT as f32; 2])[0]))).sum::<f64>() / f64::from(COUNT)
    }

    #[test]
    fn draws_have_the_moments_of_their_filter() {
        let gaussian = GaussianFilter { radius: 1.5, deviation: 0.5 };
        // Moments of the lowered bell by the midpoint rule.
        let integral = |f: &dyn Fn(f64) -> f64| (0..30_000).map(|k| f((f64::from(k) + 0.5) / 1e4 - 1.5)).sum::<f64>();
        let of_gaussian = |power: i32| {
            let moment = |x: f64| gaussian.value(x) * (0..power).map(|_| x).product::<f64>();
            integral(&moment) / integral(&|x| gaussian.value(x))
        };
        for (description, second, fourth) in [
            (FilterDescription::Box(BoxFilter { radius: 0.5 }), 1.0 / 12.0, 1.0 / 80.0),
            (FilterDescription::Tent(TentFilter { radius: 2.0 }), 4.0 / 6.0, 16.0 / 15.0),
            (FilterDescription::Gaussian(gaussian), of_gaussian(2), of_gaussian(4)),
        ] {
            let filter = description.compiled();
            assert!(mean(&filter, |x| x).abs() < 1e-5, "{description:?}");
            let (found, fourth_found) = (mean(&filter, |x| x * x), mean(&filter, |x| x * x * x * x));
            // Straight lines between quantiles spread the outermost step a little.
            assert!((found / second - 1.0).abs() < 4e-3 && (fourth_found / fourth - 1.0).abs() < 2e-2, "{description:?} {found} {second}");
        }
    }

    #[test]
    fn no_sample_lies_beyond_the_radius() {
        for description in [
            FilterDescription::default(),
            FilterDescription::Tent(TentFilter { radius: 0.5 }),
            FilterDescription::Gaussian(GaussianFilter { radius: 0.5, deviation: 16.0 }),
            FilterDescription::Gaussian(GaussianFilter { radius: 0.5, deviation: 0.01 }),
        ] {
            let filter = description.compiled();
            for u in [0.0, 0.3, 0.5, 1.0 - f32::EPSILON / 2.0] {
                let [x, y] = filter.offset([u, 1.0 - f32::EPSILON / 2.0 - u / 2.0]);
                assert!(x.abs() <= 0.5 && y.abs() <= 0.5 && x.is_finite(), "{description:?} {u}: {x} {y}");
            }
        }
    }
}

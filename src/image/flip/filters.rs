//! The filters of FLIP: contrast sensitivity of the eye, and detectors of edges and points.
//!
//! All are separable, so each is kept as the kernels of its passes along rows and columns. A kernel reaches
//! equally far to both sides, and beyond the image the border pixel is repeated.

use std::f64::consts::PI;

use crate::math::elementary;

/// Gaussian terms a sqrt(pi / b) e^(-pi² x² / b), x in degrees, of the contrast sensitivity to luminance.
const ACHROMATIC: Gaussian = Gaussian { a: 1.0, b: 0.0047 };
/// The same for red against green.
const RED_GREEN: Gaussian = Gaussian { a: 1.0, b: 0.0053 };
/// The same for blue against yellow: a sum of two.
const BLUE_YELLOW: [Gaussian; 2] = [Gaussian { a: 34.1, b: 0.04 }, Gaussian { a: 13.5, b: 0.025 }];
/// Width of a feature in degrees: peak to trough of the edge detector (w in the paper).
const FEATURE_WIDTH: f64 = 0.082;
/// Weights below this part of the greatest one change nothing in single precision.
const NEGLIGIBLE: f64 = 1e-10;

#[derive(Clone, Copy)]
struct Gaussian {
    a: f64,
    b: f64,
}

impl Gaussian {
    fn at(self, degrees: f64) -> f64 {
        elementary::exp(-PI * PI * degrees * degrees / self.b)
    }

    fn amplitude(self) -> f64 {
        self.a * (PI / self.b).sqrt()
    }
}

/// Weights of one pass, for the pixels from `-radius` to `radius`.
pub struct Kernel {
    /// `2 * radius + 1` weights.
    pub weights: Vec<f32>,
}

impl Kernel {
    /// How many pixels it reaches to each side.
    pub fn radius(&self) -> usize {
        self.weights.len() / 2
    }

    /// Cuts off what is negligible at both ends.
    fn trimmed(weights: &[f64]) -> Self {
        let greatest = weights.iter().fold(0.0_f64, |greatest, weight| greatest.max(weight.abs()));
        let reach = weights.len() / 2;
        let first = (0..reach).find(|&i| weights[i].abs() > NEGLIGIBLE * greatest).unwrap_or(reach);
        Self { weights: weights[first..weights.len() - first].iter().map(|&weight| weight as f32).collect() }
    }
}

/// The kernels for one viewing distance.
pub struct Filters {
    /// Luminance, along rows and along columns.
    pub achromatic: Kernel,
    /// Red against green, along rows and along columns.
    pub red_green: Kernel,
    /// Blue against yellow: the two Gaussians along rows.
    pub blue_yellow_rows: [Kernel; 2],
    /// The same along columns, with the share of each of the two in the whole.
    pub blue_yellow_columns: [Kernel; 2],
    /// Gaussian of the feature detectors across their direction; sums to one.
    pub smooth: Kernel,
    /// Edge detector: first derivative of that Gaussian; positive and negative weights sum to one each.
    pub edge: Kernel,
    /// Point detector: second derivative; positive and negative weights sum to one each.
    pub point: Kernel,
}

impl Filters {
    /// The filters where one degree of the visual field covers that many pixels, 1 to 1000.
    pub fn new(pixels_per_degree: f64) -> Self {
        let [wide, narrow] = BLUE_YELLOW.map(|gaussian| sampled(gaussian, pixels_per_degree));
        let shares = shares_of([&wide, &narrow]);
        let scaled = |weights: &[f64], factor: f64| weights.iter().map(|weight| weight * factor).collect::<Vec<_>>();
        let feature = FeatureWeights::new(pixels_per_degree);
        Self {
            achromatic: Kernel::trimmed(&normalized(&sampled(ACHROMATIC, pixels_per_degree))),
            red_green: Kernel::trimmed(&normalized(&sampled(RED_GREEN, pixels_per_degree))),
            blue_yellow_rows: [&wide, &narrow].map(|weights| Kernel::trimmed(&normalized(weights))),
            blue_yellow_columns: [(&wide, shares[0]), (&narrow, shares[1])]
                .map(|(weights, share)| Kernel::trimmed(&scaled(&normalized(weights), share))),
            smooth: Kernel::trimmed(&feature.smooth),
            edge: Kernel::trimmed(&feature.edge),
            point: Kernel::trimmed(&feature.point),
        }
    }

    /// How far any of them reaches.
    pub fn radius(&self) -> usize {
        let [wide, narrow] = &self.blue_yellow_rows;
        let kernels = [&self.achromatic, &self.red_green, wide, narrow, &self.smooth, &self.edge, &self.point];
        kernels.into_iter().map(Kernel::radius).max().unwrap_or(0)
    }
}

/// The Gaussian at the pixels, without its amplitude; all reach three deviations of the widest.
fn sampled(gaussian: Gaussian, pixels_per_degree: f64) -> Vec<f64> {
    let widest_deviation = (BLUE_YELLOW[0].b / (2.0 * PI * PI)).sqrt();
    let radius = (3.0 * widest_deviation * pixels_per_degree).ceil() as i64;
    (-radius..=radius).map(|pixel| gaussian.at(pixel as f64 / pixels_per_degree)).collect()
}

/// What part of the two-dimensional blue-yellow filter each of its Gaussians has.
fn shares_of(weights: [&[f64]; 2]) -> [f64; 2] {
    let volume = |index: usize| {
        let sum: f64 = weights[index].iter().sum();
        BLUE_YELLOW[index].amplitude() * sum * sum
    };
    let whole = volume(0) + volume(1);
    [volume(0) / whole, volume(1) / whole]
}

fn normalized(weights: &[f64]) -> Vec<f64> {
    let sum: f64 = weights.iter().sum();
    weights.iter().map(|weight| weight / sum).collect()
}

struct FeatureWeights {
    smooth: Vec<f64>,
    edge: Vec<f64>,
    point: Vec<f64>,
}

impl FeatureWeights {
    /// Deviation sigma = w / 2 in pixels, out to three of it.
    fn new(pixels_per_degree: f64) -> Self {
        let deviation = 0.5 * FEATURE_WIDTH * pixels_per_degree;
        let radius = (3.0 * deviation).ceil() as i64;
        let sampled = |f: &dyn Fn(f64) -> f64| (-radius..=radius).map(|pixel| f(pixel as f64)).collect::<Vec<_>>();
        let gaussian = |x: f64| elementary::exp(-x * x / (2.0 * deviation * deviation));
        Self {
            smooth: normalized(&sampled(&gaussian)),
            edge: balanced(&sampled(&|x| -x * gaussian(x))),
            point: balanced(&sampled(&|x| (x * x / (deviation * deviation) - 1.0) * gaussian(x))),
        }
    }
}

/// Scales positive and negative weights so that each sort sums to one in magnitude.
fn balanced(weights: &[f64]) -> Vec<f64> {
    let positive: f64 = weights.iter().filter(|weight| **weight > 0.0).sum();
    let negative: f64 = -weights.iter().filter(|weight| **weight < 0.0).sum::<f64>();
    weights.iter().map(|&weight| if weight > 0.0 { weight / positive } else { weight / negative }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sum(kernel: &Kernel) -> f64 {
        kernel.weights.iter().copied().map(f64::from).sum()
    }

    #[test]
    fn smoothing_kernels_sum_to_one_and_detectors_to_zero() {
        for pixels_per_degree in [1.0, 7.3, 67.0, 1000.0] {
            let filters = Filters::new(pixels_per_degree);
            let [wide, narrow] = &filters.blue_yellow_columns;
            for total in [sum(&filters.achromatic), sum(&filters.red_green), sum(wide) + sum(narrow), sum(&filters.smooth)] {
                // Weights are rounded to f32 one by one.
                assert!((total - 1.0).abs() < 1e-6, "{pixels_per_degree}: {total}");
            }
            for detector in [&filters.edge, &filters.point] {
                let positive: f64 = detector.weights.iter().map(|weight| f64::from(weight.max(0.0))).sum();
                assert!(sum(detector).abs() < 1e-6 && (positive - 1.0).abs() < 1e-6, "{pixels_per_degree}");
            }
        }
    }

    #[test]
    fn reach_is_that_of_the_paper_at_a_common_desk() {
        let filters = Filters::new(67.0);
        assert_eq!(filters.blue_yellow_rows[0].radius(), 10);
        assert_eq!(filters.edge.radius(), 9);
        assert_eq!(filters.radius(), 10);
    }
}

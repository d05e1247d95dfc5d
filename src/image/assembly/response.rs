//! The response of a camera, from photographs of one view with known times.
//!
//! Finds g with g(z) = ln E + ln t for the codes z of a pixel of irradiance E at time t: least squares with the hat as
//! weights and a term that wants g smooth. The logarithms of E are eliminated one by one, so that only 256 unknowns
//! are left, however many pixels are used.
//!
//! After Debevec & Malik, "Recovering high dynamic range radiance maps from photographs" (1997), section 2.1.

use crate::image::assembly::{AssemblyError, Exposure, Exposures, Weighting};
use crate::image::color;
use crate::math::elementary;
use crate::math::linear;

/// Codes at which a curve is known: those of eight bits.
pub const KNOT_COUNT: usize = 256;

/// The code in the middle, at which all channels are given one exposure.
const MIDDLE: usize = KNOT_COUNT / 2;

/// Logarithm of the exposure that each code stands for, in one channel.
#[derive(Debug, Clone, PartialEq)]
pub struct Curve(Vec<f64>);

impl Curve {
    /// Values at the 256 codes.
    pub fn knots(&self) -> &[f64] {
        &self.0
    }

    /// ln of the exposure of a code from 0 to 1, between codes on straight lines.
    pub fn log_exposure(&self, z: f64) -> f64 {
        let [(low, share_of_low), (high, share_of_high)] = knots_around(z);
        share_of_low * self.0[low] + share_of_high * self.0[high]
    }

    /// The first code from which the curve does not rise to the next, in the middle 240 codes.
    pub fn first_fall(&self) -> Option<usize> {
        (8..KNOT_COUNT - 8).find(|code| self.0[code + 1] <= self.0[*code])
    }
}

/// The two codes beside a value from 0 to 1, with their shares.
fn knots_around(z: f64) -> [(usize, f64); 2] {
    let position = z.clamp(0.0, 1.0) * (KNOT_COUNT - 1) as f64;
    // What single precision makes of a code over 255 is that code.
    let position = if (position - position.round()).abs() < 1e-4 { position.round() } else { position };
    let low = (position.floor() as usize).min(KNOT_COUNT - 2);
    [(low, 1.0 - (position - low as f64)), (low + 1, position - low as f64)]
}

/// How a response is recovered.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Recovery {
    /// How many pixels are used, spread evenly over the picture.
    pub pixel_count: usize,
    /// Weight of smoothness (lambda of the paper) for as many observations as there are codes.
    pub smoothness: f64,
}

/// The curve of each channel. The scale that no photograph tells is set so that the middle code has the exposure that it
/// has in sRGB, in all three: what has middle codes in all channels is taken to be grey.
pub fn recover<E: From<AssemblyError>>(
    exposures: &Exposures,
    recovery: &Recovery,
    check: impl Fn() -> Result<(), E>,
) -> Result<[Curve; 3], E> {
    let mut pixels = chosen(exposures, recovery.pixel_count);
    pixels.retain(|pixel| exposures.is_covered(*pixel));
    let curve = |channel| -> Result<Curve, E> {
        check()?;
        Ok(of_channel(exposures.as_slice(), &pixels, channel, recovery.smoothness)?)
    };
    Ok([curve(0)?, curve(1)?, curve(2)?])
}

/// Columns and rows of a lattice with about that many points.
fn chosen(exposures: &Exposures, count: usize) -> Vec<[usize; 2]> {
    let [width, height] = exposures.size();
    let step = ((width * height) as f64 / count.max(1) as f64).sqrt().max(1.0);
    let along = |length: usize| -> Vec<usize> {
        let points = ((length as f64 / step).ceil() as usize).clamp(1, length.max(1));
        (0..points).map(|point| (2 * point + 1) * length / (2 * points)).collect()
    };
    let columns = along(width);
    along(height).into_iter().flat_map(|y| columns.iter().map(move |x| [*x, y])).collect()
}

fn of_channel(exposures: &[Exposure], pixels: &[[usize; 2]], channel: usize, smoothness: f64) -> Result<Curve, AssemblyError> {
    let mut system = System { matrix: vec![0.0; KNOT_COUNT * KNOT_COUNT], right: vec![0.0; KNOT_COUNT] };
    let mut observation_count = 0;
    for [x, y] in pixels {
        let codes: Vec<(f64, f64)> = exposures
            .iter()
            .map(|Exposure { codes, seconds, .. }| (f64::from(codes.pixel(*x, *y)[channel]), elementary::ln(*seconds)))
            .collect();
        observation_count += system.add_pixel(&codes);
    }
    if observation_count == 0 {
        return Err(AssemblyError::Response(
            "no pixel is between black and white in two exposures of different times; take exposures one or two stops apart",
        ));
    }
    let scale = observation_count as f64 / KNOT_COUNT as f64;
    system.add_smoothness(smoothness * smoothness * scale);
    // The paper's last equation: the middle code has ln exposure 0; no other equation says anything of it.
    system.add(MIDDLE, MIDDLE, scale);
    let knots = linear::solve_symmetric(system.matrix, system.right)
        .ok_or(AssemblyError::Response("the photographs leave parts of the curve open; raise `smoothness` or take more exposures"))?;
    let middle = elementary::ln(color::srgb_decode(MIDDLE as f64 / (KNOT_COUNT - 1) as f64)) - knots[MIDDLE];
    Ok(Curve(knots.into_iter().map(|value| value + middle).collect()))
}

/// Normal equations for the values at the codes.
struct System {
    matrix: Vec<f64>,
    right: Vec<f64>,
}

impl System {
    fn add(&mut self, row: usize, column: usize, value: f64) {
        self.matrix[row * KNOT_COUNT + column] += value;
    }

    /// Adds Σ w² (g(z_j) - ln E - ln t_j)² with the best ln E, which is the weighted mean of g(z_j) - ln t_j; gives how
    /// many terms there are, none if they say nothing of g.
    fn add_pixel(&mut self, codes: &[(f64, f64)]) -> usize {
        let weight = |z: f64| if z > 0.0 && z < 1.0 { Weighting::Hat.weight(z) } else { 0.0 };
        let terms: Vec<(f64, f64, f64)> = codes.iter().map(|(z, time)| (*z, *time, weight(*z))).filter(|term| term.2 > 0.0).collect();
        let tells = terms.iter().any(|term| term.1 != terms[0].1);
        if !tells {
            return 0;
        }
        let total: f64 = terms.iter().map(|(_, _, weight)| weight * weight).sum();
        let mean_time = terms.iter().map(|(_, time, weight)| weight * weight * time).sum::<f64>() / total;
        // The mean row, as codes with shares, and each row as its difference from it.
        let mean: Vec<(usize, f64)> =
            terms.iter().flat_map(|(z, _, weight)| knots_around(*z).map(|(knot, share)| (knot, share * weight * weight / total))).collect();
        for (z, time, weight) in &terms {
            let own = knots_around(*z).into_iter();
            let row: Vec<(usize, f64)> =
                own.chain(mean.iter().map(|(knot, share)| (*knot, -share))).filter(|(_, share)| *share != 0.0).collect();
            for (knot, share) in &row {
                for (other, other_share) in &row {
                    self.add(*knot, *other, weight * weight * share * other_share);
                }
                self.right[*knot] += weight * weight * share * (time - mean_time);
            }
        }
        terms.len()
    }

    /// Adds weight Σ (w(z) (g(z - 1) - 2 g(z) + g(z + 1)))² over the inner codes.
    fn add_smoothness(&mut self, weight: f64) {
        for code in 1..KNOT_COUNT - 1 {
            let w = Weighting::Hat.weight(code as f64 / (KNOT_COUNT - 1) as f64);
            let row = [(code - 1, 1.0), (code, -2.0), (code + 1, 1.0)];
            for (knot, share) in row {
                for (other, other_share) in row {
                    self.add(knot, other, weight * w * w * share * other_share);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::raster::Raster;
    use crate::math::stream::{Purpose, Stream};

    const USUAL: Recovery = Recovery { pixel_count: 1000, smoothness: 10.0 };

    fn on() -> Result<(), AssemblyError> {
        Ok(())
    }

    /// Photographs of light over `stops` stops by a camera with that curve and eight bits.
    fn photographs(encode: impl Fn(f64) -> f64, times: &[f64], stops: f64) -> Exposures {
        let (width, height) = (64, 32);
        let mut generator = Stream::new(5, Purpose::Test).generator(0);
        let light: Vec<[f64; 3]> = (0..width * height).map(|_| [0, 1, 2].map(|_| elementary::exp2(-stops * generator.uniform()))).collect();
        let of_time = |seconds: f64| {
            let code = |light: f64| ((encode((light * seconds).min(1.0)) * 255.0).round() / 255.0) as f32;
            Exposure {
                name: "a".into(),
                codes: Raster::new(width, height, light.iter().map(|pixel| pixel.map(code)).collect()),
                alpha: None,
                seconds,
            }
        };
        Exposures::new(times.iter().map(|time| of_time(*time)).collect()).unwrap()
    }

    /// Largest error of ln exposure over the codes from 10 to 245.
    fn error(curve: &Curve, decode: impl Fn(f64) -> f64) -> f64 {
        let at = |code: usize| elementary::ln(decode(code as f64 / 255.0));
        let shift = elementary::ln(color::srgb_decode(128.0 / 255.0)) - at(128);
        (10..=245).map(|code| (curve.knots()[code] - at(code) - shift).abs()).fold(0.0, f64::max)
    }

    #[test]
    fn known_curves_are_found_again() {
        let times = [1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0];
        let film = |light: f64| light / (light + 0.18) * 1.18;
        let of_film = |code: f64| 0.18 * code / (1.18 - code);
        for curve in recover(&photographs(color::srgb_encode, &times, 9.0), &USUAL, on).unwrap() {
            assert!(error(&curve, color::srgb_decode) < 0.03, "srgb: {}", error(&curve, color::srgb_decode));
            assert_eq!(curve.first_fall(), None);
        }
        for curve in recover(&photographs(|light| light, &times, 9.0), &USUAL, on).unwrap() {
            assert!(error(&curve, |code| code) < 0.05, "linear: {}", error(&curve, |code| code));
        }
        for curve in recover(&photographs(film, &times, 9.0), &USUAL, on).unwrap() {
            assert!(error(&curve, of_film) < 0.05, "film: {}", error(&curve, of_film));
        }
    }

    #[test]
    fn the_smoothness_is_a_weight_and_not_a_number_of_pixels() {
        let exposures = photographs(color::srgb_encode, &[1.0, 3.0, 9.0, 27.0], 7.0);
        let few = recover(&exposures, &Recovery { pixel_count: 200, ..USUAL }, on).unwrap();
        let many = recover(&exposures, &Recovery { pixel_count: 2000, ..USUAL }, on).unwrap();
        for code in (20..=240).step_by(20) {
            assert!((few[0].knots()[code] - many[0].knots()[code]).abs() < 0.03, "{code}");
        }
    }

    #[test]
    fn eliminating_the_light_gives_the_answer_of_the_whole_system() {
        // Three pixels, two times: the normal equations with all unknowns, solved as they are in the paper.
        let times = [0.0, elementary::ln(4.0)];
        let pixels = [[100, 180], [60, 128], [30, 80]].map(|codes: [usize; 2]| codes.map(|code| code as f64 / 255.0));
        let mut small = System { matrix: vec![0.0; KNOT_COUNT * KNOT_COUNT], right: vec![0.0; KNOT_COUNT] };
        let (n, mut whole, mut right) = (KNOT_COUNT + 3, vec![0.0; (KNOT_COUNT + 3) * (KNOT_COUNT + 3)], vec![0.0; KNOT_COUNT + 3]);
        for (index, codes) in pixels.iter().enumerate() {
            small.add_pixel(&[(codes[0], times[0]), (codes[1], times[1])]);
            for (z, time) in codes.iter().zip(times) {
                let (knot, weight) = ((z * 255.0).round() as usize, Weighting::Hat.weight(*z));
                for (a, share) in [(knot, 1.0), (KNOT_COUNT + index, -1.0)] {
                    for (b, other) in [(knot, 1.0), (KNOT_COUNT + index, -1.0)] {
                        whole[a * n + b] += weight * weight * share * other;
                    }
                    right[a] += weight * weight * share * time;
                }
            }
        }
        small.add_smoothness(1.0);
        small.add(MIDDLE, MIDDLE, 1.0);
        let mut smooth = System { matrix: vec![0.0; KNOT_COUNT * KNOT_COUNT], right: vec![0.0; KNOT_COUNT] };
        smooth.add_smoothness(1.0);
        smooth.add(MIDDLE, MIDDLE, 1.0);
        for row in 0..KNOT_COUNT {
            for column in 0..KNOT_COUNT {
                whole[row * n + column] += smooth.matrix[row * KNOT_COUNT + column];
            }
        }
        let found = linear::solve_symmetric(small.matrix, small.right).unwrap();
        let expected = linear::solve_symmetric(whole, right).unwrap();
        for code in 0..KNOT_COUNT {
            assert!((found[code] - expected[code]).abs() < 1e-6, "{code}: {} for {}", found[code], expected[code]);
        }
    }

    #[test]
    fn codes_between_the_knots_lie_on_lines() {
        let curve = Curve((0..256).map(|code| f64::from(code * code)).collect());
        assert_eq!(curve.log_exposure(10.0 / 255.0), 100.0);
        assert!((curve.log_exposure(10.5 / 255.0) - 110.5).abs() < 1e-9);
        assert_eq!((curve.log_exposure(0.0), curve.log_exposure(1.0)), (0.0, 65_025.0));
    }

    #[test]
    fn what_says_nothing_of_the_curve_is_refused() {
        let message = |exposures: &Exposures| recover(exposures, &USUAL, on).unwrap_err().to_string();
        // The same time twice, and nothing but white.
        assert!(message(&photographs(color::srgb_encode, &[1.0, 1.0], 6.0)).contains("different times"));
        assert!(message(&photographs(|_| 1.0, &[1.0, 2.0], 6.0)).contains("different times"));
    }
}

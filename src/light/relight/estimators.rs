//! A diffuse sphere from directions with weights: samples in the reports' ways and the unbiased one, or lights.
//!
//! Every estimate here is (albedo / pi) sum_k (n . d_k)+ X_k, and an estimator is a choice of X. One set serves
//! all normals, so that errors are smooth and alike in neighboring pixels. What each estimator tends to
//! is in `limits`.
//!
//! X after the first coursework report's equations 4 and 5; the unbiased form is Monte Carlo integration with
//! importance sampling (Pharr, Jakob and Humphreys, "Physically based rendering", 13.10).

use std::f64::consts::PI;

use glam::{DVec3, Vec4};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::image::raster::Image;
use crate::light::envmap::{Angles, EnvMap, theta_of_row};
use crate::light::lights::LightSet;
use crate::light::relight::reflected::Weighted;
use crate::light::relight::sphere::{self, Scanline};
use crate::light::samples::{Frame, Sample, SampleSet};
use crate::math::elementary;

/// How a sample's radiance and probability become its weight.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum SampleEstimator {
    /// X = L: the first report's equation 4; tends to a mean weighted by brightness, not to the radiance.
    EqualWeight,
    /// X = I (R, G, B) / |RGB| / P: the first report's equation 5 as printed, without solid angle.
    NormalizedColor,
    /// X = I sin(theta) (R, G, B) / |RGB| / P: the other reading of equation 5.
    NormalizedColorSine,
    /// X = L / p: unbiased.
    PdfWeighted,
}

impl SampleEstimator {
    /// Its name, as in a pipeline file.
    pub fn name(self) -> &'static str {
        match self {
            Self::EqualWeight => "equal-weight",
            Self::NormalizedColor => "normalized-color",
            Self::NormalizedColorSine => "normalized-color-sine",
            Self::PdfWeighted => "pdf-weighted",
        }
    }
}

/// Samples that cannot light a sphere in the way asked for.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum RelightError {
    /// An empty set has no mean.
    #[error("there are no samples to average; draw at least one")]
    NoSamples,
    /// No radiance is known.
    #[error("the samples carry no radiance; set `env` to the map that lights the sphere")]
    NoRadiance,
    /// Pixel indices mean another map.
    #[error(
        "the samples count pixels of a map of `{}x{}`, `env` has `{}x{}`; set `env` to a map of the size that was sampled",
        sampled[0], sampled[1], map[0], map[1]
    )]
    OtherMap {
        /// Width and height of the map the samples come from.
        sampled: [usize; 2],
        /// Width and height of the map that was given.
        map: [usize; 2],
    },
    /// Probabilities of another map's pixels.
    #[error("the distribution is of a map of `{}x{}`, `env` has `{}x{}`; set `env` to the map it was made of", drawn[0], drawn[1], map[0], map[1])]
    OtherDistribution {
        /// Width and height of the map of the distribution.
        drawn: [usize; 2],
        /// Width and height of the map that was given.
        map: [usize; 2],
    },
    /// Equation 5 divides by the probability of a pixel.
    #[error("`{estimator}` needs samples drawn from a map's pixels; use `pdf-weighted`, or draw from a distribution")]
    NoPixels {
        /// The estimator.
        estimator: &'static str,
    },
}

/// Directions with weights, in blocks that fit the registers.
#[derive(Debug, Clone)]
pub struct WeightedDirections {
    blocks: Vec<Block>,
    /// Samples left out because their probability is 0: an inversion can reach such pixels, an estimate cannot use them.
    pub skipped_count: usize,
}

/// Four f32 fill a register of the baseline instruction set.
const LANES: usize = 4;

/// Normals that share each block while it is in registers.
const NORMALS: usize = 2;

/// How many blocks are summed before the caller is asked whether to stop: about a tenth of a millisecond.
const BLOCKS_PER_CHECK: usize = 1 << 15;

/// Blocks summed in f32 before they are added up in f64: the sum of a lane errs by at most 16 roundings.
const RUN: usize = 16;

/// In f32, as the image is: a cosine errs by 2^-23 of the largest one.
#[derive(Debug, Clone, Copy, Default)]
struct Block {
    direction: [Vec4; 3],
    weight: [Vec4; 3],
}

impl WeightedDirections {
    /// Samples in world space under an estimator, each weighted by X / N.
    ///
    /// Radiance is that of the sampled pixel of `map`, or the samples' own where no map is given. Where the
    /// samples come from no map, the pixel is the one that contains the direction.
    ///
    /// # Errors
    /// See [`RelightError`].
    ///
    /// # Panics
    /// If the samples are about a normal; see `turned`.
    pub fn of_samples(samples: &SampleSet, map: Option<&EnvMap>, estimator: SampleEstimator) -> Result<Self, RelightError> {
        let (weighted, skipped_count) = weighted_samples(samples, map, estimator)?;
        Ok(Self { blocks: blocks(&weighted), skipped_count })
    }

    /// Lights, each weighted by its irradiance.
    pub fn of_lights(lights: &LightSet) -> Self {
        Self { blocks: blocks(&weighted_lights(lights)), skipped_count: 0 }
    }

    /// Irradiance on a surface with that unit normal: the sum of weight times cosine.
    pub fn irradiance(&self, normal: DVec3) -> [f64; 3] {
        let mut sums = Sums::default();
        sums.add(&self.blocks, [normal; NORMALS]);
        sums.totals()[0]
    }

    /// The radiance of a diffuse sphere of `size` x `size` pixels.
    ///
    /// # Errors
    /// What `check` gives.
    pub fn relight<E: Send>(&self, size: usize, albedo: [f64; 3], check: impl Fn() -> Result<(), E> + Sync) -> Result<Image, E> {
        sphere::picture(size, |line| self.radiances(line, albedo, &check))
    }

    fn radiances<E>(&self, line: &Scanline, albedo: [f64; 3], check: &impl Fn() -> Result<(), E>) -> Result<Vec<[f64; 3]>, E> {
        let mut colors = Vec::with_capacity(line.normals.len() + 1);
        for normals in line.normals.chunks(NORMALS) {
            let mut sums = Sums::default();
            for blocks in self.blocks.chunks(BLOCKS_PER_CHECK) {
                check()?;
                sums.add(blocks, [normals[0], normals[normals.len() - 1]]);
            }
            colors.extend(sums.totals().map(|irradiance| reflected(albedo, irradiance)));
        }
        colors.truncate(line.normals.len());
        Ok(colors)
    }
}

/// Directions of samples in world space with their weights X / N, and how many were left out because their probability is 0.
///
/// # Errors
/// See [`RelightError`].
///
/// # Panics
/// If the samples are about a normal; see `turned`.
pub fn weighted_samples(
    samples: &SampleSet,
    map: Option<&EnvMap>,
    estimator: SampleEstimator,
) -> Result<(Vec<Weighted>, usize), RelightError> {
    assert_eq!(samples.frame, Frame::World, "samples about a normal have no fixed direction");
    check_sizes(samples, map)?;
    let needs_pixels = matches!(estimator, SampleEstimator::NormalizedColor | SampleEstimator::NormalizedColorSine);
    if needs_pixels && samples.map_width == 0 {
        return Err(RelightError::NoPixels { estimator: estimator.name() });
    }

    let scale = 1.0 / samples.samples.len() as f64;
    let angles = map.map_or(Angles::Center, |map| map.angles);
    let mut skipped_count = 0;
    let mut weighted = Vec::with_capacity(samples.samples.len());
    for sample in &samples.samples {
        let radiance = radiance_of(sample, samples, map)?;
        let sine = || elementary::sin(theta_of_row(sample.y as usize, samples.map_height as usize, angles));
        match weight(estimator, sample, radiance, sine) {
            Some(weight) => weighted.push((sample.direction, weight.map(|channel| channel * scale))),
            None => skipped_count += 1,
        }
    }
    Ok((weighted, skipped_count))
}

/// Directions of lights with their irradiances.
pub fn weighted_lights(lights: &LightSet) -> Vec<Weighted> {
    lights.lights.iter().map(|light| (light.direction, light.irradiance)).collect()
}

/// Radiance of a diffuse surface, (albedo / pi) E, in every channel.
pub fn reflected(albedo: [f64; 3], irradiance: [f64; 3]) -> [f64; 3] {
    [0, 1, 2].map(|channel| albedo[channel] / PI * irradiance[channel])
}

/// That there are samples, and that they mean pixels of this map.
pub(super) fn check_sizes(samples: &SampleSet, map: Option<&EnvMap>) -> Result<(), RelightError> {
    if samples.samples.is_empty() {
        return Err(RelightError::NoSamples);
    }
    let sampled = [samples.map_width as usize, samples.map_height as usize];
    match map.map(|map| [map.width(), map.height()]) {
        Some(map) if sampled != [0, 0] && sampled != map => Err(RelightError::OtherMap { sampled, map }),
        _ => Ok(()),
    }
}

fn radiance_of(sample: &Sample, samples: &SampleSet, map: Option<&EnvMap>) -> Result<[f64; 3], RelightError> {
    let radiance = match map {
        Some(map) if samples.map_width == 0 => Some(map.nearest(sample.direction)),
        Some(map) => Some(map.raster.pixel(sample.x as usize, sample.y as usize)),
        None => sample.radiance,
    };
    radiance.map(|rgb| rgb.map(f64::from)).ok_or(RelightError::NoRadiance)
}

/// X of an estimator; `None` where it divides by a probability of 0.
fn weight(estimator: SampleEstimator, sample: &Sample, radiance: [f64; 3], sine: impl Fn() -> f64) -> Option<[f64; 3]> {
    let scaled = |color: [f64; 3], numerator: f64, probability: f64| {
        (probability > 0.0).then(|| color.map(|channel| channel * (numerator / probability)))
    };
    match estimator {
        SampleEstimator::EqualWeight => Some(radiance),
        SampleEstimator::PdfWeighted => scaled(radiance, 1.0, sample.pdf),
        SampleEstimator::NormalizedColor => scaled(color_direction(radiance), intensity(radiance), sample.pmf),
        SampleEstimator::NormalizedColorSine => scaled(color_direction(radiance), intensity(radiance) * sine(), sample.pmf),
    }
}

/// I = (R + G + B) / 3, the reports' intensity.
pub fn intensity([r, g, b]: [f64; 3]) -> f64 {
    (r + g + b) / 3.0
}

/// (R, G, B) / sqrt(R^2 + G^2 + B^2); black stays black.
pub(super) fn color_direction([r, g, b]: [f64; 3]) -> [f64; 3] {
    let length = (r * r + g * g + b * b).sqrt();
    if length > 0.0 { [r / length, g / length, b / length] } else { [0.0; 3] }
}

fn blocks(weighted: &[(DVec3, [f64; 3])]) -> Vec<Block> {
    let filled = |chunk: &[(DVec3, [f64; 3])]| {
        let mut block = Block::default();
        for (lane, (direction, weight)) in chunk.iter().enumerate() {
            for axis in 0..3 {
                block.direction[axis][lane] = direction[axis] as f32;
                block.weight[axis][lane] = weight[axis] as f32;
            }
        }
        block
    };
    weighted.chunks(LANES).map(filled).collect()
}

/// Running sums for a few normals; lanes are added up last, always in the same order.
#[derive(Default)]
struct Sums([[[f64; LANES]; 3]; NORMALS]);

impl Sums {
    fn add(&mut self, blocks: &[Block], normals: [DVec3; NORMALS]) {
        let normals = normals.map(|normal| normal.to_array().map(|component| Vec4::splat(component as f32)));
        for run in blocks.chunks(RUN) {
            let sums = sums_of_run(run, &normals).map(|channels| channels.map(|lanes| lanes.to_array()));
            for (total, sum) in self.0.as_flattened_mut().as_flattened_mut().iter_mut().zip(sums.as_flattened().as_flattened()) {
                *total += f64::from(*sum);
            }
        }
    }

    fn totals(&self) -> [[f64; 3]; NORMALS] {
        self.0.map(|channels| channels.map(|[a, b, c, d]| (a + b) + (c + d)))
    }
}

/// Sums of cosine times weight; each component of a normal fills a vector.
fn sums_of_run(run: &[Block], normals: &[[Vec4; 3]; NORMALS]) -> [[Vec4; 3]; NORMALS] {
    let mut sums = [[Vec4::ZERO; 3]; NORMALS];
    for Block { direction: d, weight } in run {
        for (sums, n) in sums.iter_mut().zip(normals) {
            let cosines = (n[0] * d[0] + n[1] * d[1] + n[2] * d[2]).max(Vec4::ZERO);
            for (sum, weight) in sums.iter_mut().zip(weight) {
                *sum += cosines * *weight;
            }
        }
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::lights::{Light, Region};
    use crate::light::relight::limits::{self, Integrand};
    use crate::light::test_maps::noisy;

    fn sample(x: u32, y: u32, map: &EnvMap, pmf: f64) -> Sample {
        let pdf = pmf / map.solid_angle(y as usize);
        let direction = map.direction(x as usize, y as usize);
        Sample { x, y, u: 0.0, v: 0.0, direction, pmf, pdf, radiance: None }
    }

    /// Every pixel once, as if drawn with probability 1 / pixels: then estimates are sums over the map.
    fn every_pixel(map: &EnvMap) -> SampleSet {
        let (width, height) = (map.width() as u32, map.height() as u32);
        let pmf = 1.0 / f64::from(width * height);
        let samples = (0..width * height).map(|index| sample(index % width, index / width, map, pmf)).collect();
        SampleSet { map_width: width, map_height: height, frame: Frame::World, samples }
    }

    #[test]
    fn estimates_with_every_pixel_once_are_their_limits() {
        let map = noisy(32, 16);
        let samples = every_pixel(&map);
        let normal = DVec3::new(0.36, 0.48, 0.8);
        for (estimator, integrand) in [
            (SampleEstimator::PdfWeighted, Integrand::radiance()),
            (SampleEstimator::NormalizedColor, Integrand::normalized_color()),
            (SampleEstimator::NormalizedColorSine, Integrand::normalized_color_sine()),
        ] {
            let found = WeightedDirections::of_samples(&samples, Some(&map), estimator).unwrap().irradiance(normal);
            let expected = limits::irradiance_at(&map, &integrand, normal);
            // Single precision: 16 roundings of 2^-24 in a run, and two in each term.
            assert!((0..3).all(|c| (found[c] / expected[c] - 1.0).abs() < 1e-6), "{estimator:?}: {found:?} {expected:?}");
        }
    }

    #[test]
    fn one_light_lights_by_its_cosine() {
        let region = Region { x0: 0, y0: 0, x1: 1, y1: 1 };
        let light = Light { region, x: 0.5, y: 0.5, direction: DVec3::Z, irradiance: [1.0, 2.0, 4.0], solid_angle: 1.0, energy: 1.0 };
        let directions = WeightedDirections::of_lights(&LightSet { map_width: 1, map_height: 1, lights: vec![light] });
        assert_eq!(directions.irradiance(DVec3::Z), [1.0, 2.0, 4.0]);
        assert_eq!(directions.irradiance(DVec3::NEG_Z), [0.0; 3]);
        let image = directions.relight(3, [PI, PI, PI / 2.0], || Ok::<(), ()>(())).unwrap();
        assert_eq!(image.color.pixel(1, 1), [1.0, 2.0, 2.0]);
        assert_eq!((image.color.pixel(0, 0), image.is_covered(0)), (image.color.pixel(2, 2), true));
    }

    #[test]
    fn pictures_agree_with_single_normals() {
        let map = noisy(16, 8);
        let directions = WeightedDirections::of_samples(&every_pixel(&map), Some(&map), SampleEstimator::PdfWeighted).unwrap();
        for size in [1, 2, 5, 8] {
            let image = directions.relight(size, [1.0; 3], || Ok::<(), ()>(())).unwrap();
            for index in (0..size * size).filter(|index| image.is_covered(*index)) {
                let normal = sphere::normal_at(size, index % size, index / size).unwrap();
                let expected = reflected([1.0; 3], directions.irradiance(normal)).map(|channel| channel as f32);
                assert_eq!(image.color.pixels()[index], expected);
            }
        }
    }

    #[test]
    fn samples_that_cannot_light_are_refused_or_counted() {
        let map = noisy(16, 8);
        let of = |samples: &SampleSet, map: Option<&EnvMap>, estimator| WeightedDirections::of_samples(samples, map, estimator);
        let good = every_pixel(&map);
        let by_pdf = SampleEstimator::PdfWeighted;

        assert_eq!(of(&SampleSet { samples: vec![], ..good.clone() }, Some(&map), by_pdf).unwrap_err(), RelightError::NoSamples);
        assert_eq!(of(&good, None, by_pdf).unwrap_err(), RelightError::NoRadiance);
        let other = RelightError::OtherMap { sampled: [16, 8], map: [4, 4] };
        assert_eq!(of(&good, Some(&noisy(4, 4)), by_pdf).unwrap_err(), other);
        let free = SampleSet { map_width: 0, map_height: 0, ..good.clone() };
        assert!(of(&free, Some(&map), by_pdf).is_ok());
        let no_pixels = RelightError::NoPixels { estimator: "normalized-color" };
        assert_eq!(of(&free, Some(&map), SampleEstimator::NormalizedColor).unwrap_err(), no_pixels);

        let impossible = SampleSet { samples: vec![sample(0, 0, &map, 0.0), sample(1, 1, &map, 0.5)], ..good };
        assert_eq!(of(&impossible, Some(&map), by_pdf).unwrap().skipped_count, 1);
        assert_eq!(of(&impossible, Some(&map), SampleEstimator::EqualWeight).unwrap().skipped_count, 0);
    }
}

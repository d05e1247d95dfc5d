//! Estimators of the diffuse sphere: their means, their variances and how fast they converge.
//!
//! Samples are drawn here, independently, from a flat list of cumulated pixel weights, so that nothing of the
//! samplers under test elsewhere is taken on trust. Means are compared at four standard errors; the nine intervals
//! for variances share the level .001 (Šidák).

use glam::DVec3;
use std::f64::consts::PI;

use pipeline::image::raster::Raster;
use pipeline::light::envmap::EnvMap;
use pipeline::light::relight::estimators::{SampleEstimator, WeightedDirections, intensity};
use pipeline::light::relight::limits::{Integrand, Strategy, irradiance_at, variance_at};
use pipeline::light::relight::turned::TurnedDirections;
use pipeline::light::samples::{Frame, Sample, SampleSet};
use pipeline::math::sphere::{cosine_hemisphere, cosine_hemisphere_pdf};
use pipeline::math::statistics::{mean, sidak_level, slope, standard_error, variance_interval};
use pipeline::math::stream::{Purpose, Stream};

const WIDTH: usize = 64;
const HEIGHT: usize = 32;

const NORMALS: [DVec3; 4] = [DVec3::X, DVec3::Y, DVec3::new(0.36, -0.48, 0.8), DVec3::NEG_Z];

/// Colored noise with a bright window near the horizon and a brighter one near the pole.
fn map() -> EnvMap {
    let stream = Stream::new(11, Purpose::Test);
    let pixel = |index: usize| {
        let (x, y) = (index % WIDTH, index / WIDTH);
        let tint = match (x, y) {
            (20..28, 14..18) => [30.0, 20.0, 5.0],
            (40..50, 3..5) => [10.0, 30.0, 60.0],
            _ => [1.0, 0.8, 0.6],
        };
        let mut numbers = stream.generator(index as u64);
        tint.map(|channel: f64| (channel * numbers.uniform()) as f32)
    };
    EnvMap::new(Raster::new(WIDTH, HEIGHT, (0..WIDTH * HEIGHT).map(pixel).collect()))
}

/// Probabilities of all pixels, by intensity or by solid angle alone, and their running sums.
struct Pixels {
    pmf: Vec<f64>,
    cdf: Vec<f64>,
}

impl Pixels {
    fn new(map: &EnvMap, strategy: Strategy) -> Self {
        let weight = |index: usize| {
            let (x, y) = (index % WIDTH, index / WIDTH);
            match strategy {
                Strategy::Intensity => intensity(map.raster.pixel(x, y).map(f64::from)) * map.solid_angle(y),
                Strategy::Uniform => map.solid_angle(y),
                Strategy::Cosine => unreachable!("cosine directions are not drawn by pixel"),
            }
        };
        let weights: Vec<f64> = (0..WIDTH * HEIGHT).map(weight).collect();
        let total: f64 = weights.iter().sum();
        let pmf: Vec<f64> = weights.iter().map(|weight| weight / total).collect();
        let running = |sum: &mut f64, p: &f64| {
            *sum += p;
            Some(*sum)
        };
        let cdf = pmf.iter().scan(0.0, running).collect();
        Self { pmf, cdf }
    }

    fn draw(&self, map: &EnvMap, count: usize, seed: u64) -> SampleSet {
        let stream = Stream::new(seed, Purpose::Test);
        let sample = |index: usize| {
            let u = stream.generator(index as u64).uniform();
            let pixel = self.cdf.partition_point(|sum| *sum <= u).min(WIDTH * HEIGHT - 1);
            let (x, y) = (pixel % WIDTH, pixel / WIDTH);
            let pmf = self.pmf[pixel];
            Sample {
                x: x as u32,
                y: y as u32,
                u: 0.0,
                v: 0.0,
                direction: map.direction(x, y),
                pmf,
                pdf: pmf / map.solid_angle(y),
                radiance: None,
            }
        };
        let samples = (0..count).map(sample).collect();
        SampleSet { map_width: WIDTH as u32, map_height: HEIGHT as u32, frame: Frame::World, samples }
    }
}

/// One radiance of a white surface per seed, for each normal and channel.
fn estimates(map: &EnvMap, strategy: Strategy, estimator: SampleEstimator, count: usize, seeds: u64) -> Vec<[Vec<f64>; 3]> {
    let mut found = vec![[const { Vec::new() }; 3]; NORMALS.len()];
    let pixels = (strategy != Strategy::Cosine).then(|| Pixels::new(map, strategy));
    for seed in 0..seeds {
        let irradiances: Vec<[f64; 3]> = match &pixels {
            Some(pixels) => {
                let directions = WeightedDirections::of_samples(&pixels.draw(map, count, seed), Some(map), estimator).unwrap();
                NORMALS.iter().map(|normal| directions.irradiance(*normal)).collect()
            }
            None => {
                let samples = cosine_samples(count, seed);
                let directions = TurnedDirections::new(&samples, map, estimator).unwrap();
                NORMALS.iter().map(|normal| directions.irradiance(*normal, &|| Ok::<(), ()>(())).unwrap()).collect()
            }
        };
        for (found, irradiance) in found.iter_mut().zip(irradiances) {
            (0..3).for_each(|channel| found[channel].push(irradiance[channel] / PI));
        }
    }
    found
}

fn cosine_samples(count: usize, seed: u64) -> SampleSet {
    let stream = Stream::new(seed, Purpose::Test);
    let sample = |index: usize| {
        let direction = cosine_hemisphere(stream.generator(index as u64).uniform_pair());
        let pdf = cosine_hemisphere_pdf(direction.z);
        Sample { x: 0, y: 0, u: 0.0, v: 0.0, direction, pmf: 0.0, pdf, radiance: None }
    };
    SampleSet { map_width: 0, map_height: 0, frame: Frame::Normal, samples: (0..count).map(sample).collect() }
}

/// Standard errors between the mean of the estimates and what the integrand sums to, for each normal and channel.
fn deviations(estimates: &[[Vec<f64>; 3]], map: &EnvMap, integrand: &Integrand) -> Vec<f64> {
    let of_normal = |(normal, found): (&DVec3, &[Vec<f64>; 3])| {
        let expected = irradiance_at(map, integrand, *normal);
        [0, 1, 2].map(|channel| (mean(&found[channel]) - expected[channel] / PI) / standard_error(&found[channel]))
    };
    NORMALS.iter().zip(estimates).flat_map(of_normal).collect()
}

#[test]
fn pdf_weighted_is_unbiased_for_any_density() {
    let map = map();
    for strategy in [Strategy::Intensity, Strategy::Uniform] {
        let found = estimates(&map, strategy, SampleEstimator::PdfWeighted, 256, 400);
        let z = deviations(&found, &map, &Integrand::radiance());
        assert!(z.iter().all(|z| z.abs() < 4.0), "{strategy:?}: {z:?}");
    }
}

#[test]
fn the_reports_estimators_tend_to_their_own_limits() {
    let map = map();
    for estimator in [SampleEstimator::EqualWeight, SampleEstimator::NormalizedColor, SampleEstimator::NormalizedColorSine] {
        let found = estimates(&map, Strategy::Intensity, estimator, 256, 400);
        let z = deviations(&found, &map, &Integrand::of(estimator, &map));
        assert!(z.iter().all(|z| z.abs() < 4.0), "{estimator:?}: {z:?}");
        // The control: they are far from the truth, which more samples do not bring nearer.
        let z = deviations(&found, &map, &Integrand::radiance());
        assert!(z.iter().any(|z| z.abs() > 40.0), "{estimator:?}: {z:?}");
    }
}

#[test]
fn variances_are_those_of_the_closed_form() {
    let map = map();
    let (count, seeds) = (1024, 300);
    let confidence = 1.0 - sidak_level(0.001, 9);
    for strategy in [Strategy::Intensity, Strategy::Uniform, Strategy::Cosine] {
        let found = estimates(&map, strategy, SampleEstimator::PdfWeighted, count, seeds);
        for (normal, found) in NORMALS.iter().zip(&found).take(3) {
            let expected = variance_at(&map, strategy, *normal, [0.0, 1.0, 0.0]) / count as f64;
            let interval = variance_interval(&found[1], confidence);
            assert!(interval.low < expected && expected < interval.high, "{strategy:?} {normal}: {expected} in {interval:?}");
        }
    }
}

#[test]
fn errors_fall_with_the_square_root_of_the_count_unless_biased() {
    let map = map();
    let truth: Vec<f64> = NORMALS.iter().map(|normal| irradiance_at(&map, &Integrand::radiance(), *normal)[1] / PI).collect();
    let rmse = |estimator, count| {
        let found = estimates(&map, Strategy::Intensity, estimator, count, 128);
        let squares =
            found.iter().zip(&truth).flat_map(|(found, truth)| found[1].iter().map(move |value| (value - truth) * (value - truth)));
        mean(&squares.collect::<Vec<_>>()).sqrt()
    };
    let line = |estimator, counts: &[usize]| {
        let logarithms = |values: &[f64]| values.iter().map(|value| pipeline::math::elementary::ln(*value)).collect::<Vec<_>>();
        let errors: Vec<f64> = counts.iter().map(|count| rmse(estimator, *count)).collect();
        slope(&logarithms(&counts.iter().map(|count| *count as f64).collect::<Vec<_>>()), &logarithms(&errors))
            .expect("several counts")
            .slope
    };
    let unbiased = line(SampleEstimator::PdfWeighted, &[16, 64, 256, 1024, 4096]);
    assert!((unbiased + 0.5).abs() < 0.05, "{unbiased}");
    // With few samples scatter still adds to the bias.
    let biased = line(SampleEstimator::EqualWeight, &[256, 1024, 4096]);
    assert!(biased.abs() < 0.02, "{biased}");
}

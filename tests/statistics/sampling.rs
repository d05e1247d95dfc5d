//! Samplers against probabilities that are worked out here from the map, not asked of the code under test.

use std::convert::Infallible;
use std::f64::consts::PI;

use pipeline::image::raster::Raster;
use pipeline::light::distribution::{Distribution, Intensity, Settings, Sine};
use pipeline::light::envmap::EnvMap;
use pipeline::light::points::{Arrangement, strata};
use pipeline::light::samples::{Sample, SampleSet};
use pipeline::light::sampling::{self, Draw};
use pipeline::math::elementary;
use pipeline::math::statistics::{chi_square_test, chi_square_upper, mean, normal_cdf, standard_error};
use pipeline::math::stream::{Purpose, Stream};

use crate::shared::{self, Family};

/// Tests of this module that can fail by chance; together they do so once in a thousand seeds.
const TESTS: Family = Family(17);

fn go() -> Result<(), Infallible> {
    Ok(())
}

/// Colors over three decades with black pixels and a black row; brighter to the right and below.
fn rough_map(width: usize, height: usize) -> EnvMap {
    let stream = Stream::new(17, Purpose::Test);
    let color = |k: usize| {
        let (x, y) = (k % width, k / width);
        let [size, hue] = stream.generator(k as u64).uniform_pair();
        let tilt = 1.0 + x as f64 / width as f64 + y as f64 / height as f64;
        let value = tilt * elementary::pow(10.0, 3.0 * size);
        if hue < 0.1 || y == 3 { [0.0; 3] } else { [value as f32, (value * hue) as f32, (value * (1.0 - hue)) as f32] }
    };
    EnvMap::new(Raster::new(width, height, (0..width * height).map(color).collect()))
}

fn maps() -> Vec<(&'static str, EnvMap)> {
    let mut maps = vec![("32 x 16", rough_map(32, 16)), ("37 x 9", rough_map(37, 9))];
    maps.extend(shared::map("studio_64x32.pfm").map(|map| ("studio", map)));
    maps
}

fn table(map: &EnvMap, sine: Sine) -> Distribution {
    Distribution::build(map, &Settings { sine, ..Settings::default() }, go).unwrap()
}

/// Luminance times the sine at the row's center over the sum, row by row: section 3 of the specification.
fn pmf_by_definition(map: &EnvMap) -> Vec<f64> {
    let weight = |k: usize| {
        let [r, g, b] = map.raster.pixels()[k].map(f64::from);
        let theta = ((k / map.width()) as f64 + 0.5) * PI / map.height() as f64;
        (0.2126 * r + 0.7152 * g + 0.0722 * b) * elementary::sin(theta)
    };
    let weights: Vec<f64> = (0..map.width() * map.height()).map(weight).collect();
    let total: f64 = weights.iter().sum();
    weights.iter().map(|weight| weight / total).collect()
}

fn drawn(distribution: &Distribution, arrangement: Arrangement, count: usize, seed: u64) -> SampleSet {
    sampling::draw(distribution, &Draw::of(arrangement, count, seed), go).unwrap()
}

/// The cell of a lat-long grid in which the sample's direction lies, from the direction alone.
fn cell_of(sample: &Sample, width: usize, height: usize) -> usize {
    let theta = elementary::acos(sample.direction.y);
    let phi = elementary::atan2(sample.direction.z, sample.direction.x).rem_euclid(2.0 * PI);
    let (x, y) = ((phi / (2.0 * PI) * width as f64) as usize, (theta / PI * height as f64) as usize);
    y.min(height - 1) * width + x.min(width - 1)
}

/// How often `iid` directions fall into each pixel.
fn counts(distribution: &Distribution, million: u64) -> Vec<u64> {
    let (width, height) = (distribution.width(), distribution.height());
    let mut counts = vec![0; width * height];
    for seed in 0..million {
        for sample in sampling::independent(distribution, 1_000_000, seed, go).unwrap().samples {
            counts[cell_of(&sample, width, height)] += 1;
        }
    }
    counts
}

fn p_value(counts: &[u64], pmf: &[f64]) -> f64 {
    let draws = counts.iter().sum::<u64>() as f64;
    chi_square_test(counts, &pmf.iter().map(|pmf| pmf * draws).collect::<Vec<_>>()).p_value
}

/// Three tests.
#[test]
fn independent_directions_follow_the_map() {
    for (name, map) in maps() {
        let pmf = pmf_by_definition(&map);
        TESTS.assert_plausible(name, p_value(&counts(&table(&map, Sine::Center), 4), &pmf));
    }
}

#[test]
fn the_reported_probability_and_density_are_those_of_the_definition() {
    for (name, map) in maps() {
        let pmf = pmf_by_definition(&map);
        let (width, height) = (map.width(), map.height());
        let solid_angle = |y: usize| {
            let edge = |y: usize| elementary::cos(y as f64 * PI / height as f64);
            2.0 * PI / width as f64 * (edge(y) - edge(y + 1))
        };
        for sample in sampling::independent(&table(&map, Sine::Center), 10_000, 1, go).unwrap().samples {
            let (x, y) = (sample.x as usize, sample.y as usize);
            assert_eq!(cell_of(&sample, width, height), y * width + x, "{name}");
            // The intensity is rounded to f32.
            let expected = pmf[y * width + x];
            assert!((sample.pmf / expected - 1.0).abs() < 2e-7, "{name}");
            assert!((sample.pdf / (expected / solid_angle(y)) - 1.0).abs() < 2e-7, "{name}");
        }
    }
}

#[test]
fn a_forgotten_sine_a_mirrored_map_and_one_percent_are_noticed() {
    for (name, map) in maps() {
        let (width, height) = (map.width(), map.height());
        let pmf = pmf_by_definition(&map);
        let right = counts(&table(&map, Sine::Center), 12);

        TESTS.assert_refused(&format!("{name}: no sine"), p_value(&counts(&table(&map, Sine::None), 4), &pmf));
        TESTS.assert_refused(&format!("{name}: sine of the edge"), p_value(&counts(&table(&map, Sine::Edge), 4), &pmf));
        let mirrored: Vec<f64> = (0..width * height).map(|k| pmf[k - k % width + (width - 1 - k % width)]).collect();
        TESTS.assert_refused(&format!("{name}: mirrored"), p_value(&right, &mirrored));
        let shifted: Vec<f64> = (0..width * height).map(|k| pmf[k - k % width + (k + 1) % width]).collect();
        TESTS.assert_refused(&format!("{name}: a pixel aside"), p_value(&right, &shifted));
        let larger: Vec<f64> = pmf.iter().map(|pmf| 1.01 * pmf).collect();
        TESTS.assert_refused(&format!("{name}: 1 % too large"), p_value(&right, &larger));
        // One half 1 % up, the other down, and still a pmf.
        let tilted: Vec<f64> = pmf.iter().enumerate().map(|(k, pmf)| if k % 2 == 0 { 1.01 * pmf } else { 0.99 * pmf }).collect();
        let sum: f64 = tilted.iter().sum();
        let tilted: Vec<f64> = tilted.iter().map(|pmf| pmf / sum).collect();
        TESTS.assert_refused(&format!("{name}: 1 % to and fro"), p_value(&right, &tilted));
    }
}

/// Two-sided p-value of a mean against its expectation.
fn mean_p_value(values: &[f64], expected: f64) -> f64 {
    2.0 * normal_cdf(-((mean(values) - expected) / standard_error(values)).abs())
}

/// The mean of 1 / pdf over a region is its solid angle. Three tests, with their controls.
///
/// The region is what is at least half as bright as the mean: in darker places 1 / pdf is large and seldom met.
#[test]
fn densities_measure_the_solid_angle_of_what_is_bright() {
    for (name, map) in maps() {
        let (width, height) = (map.width(), map.height());
        let pmf = pmf_by_definition(&map);
        let is_bright = |k: usize| pmf[k] / map.solid_angle(k / width) > 0.5 / (4.0 * PI);
        let bright: f64 = (0..width * height).filter(|&k| is_bright(k)).map(|k| map.solid_angle(k / width)).sum();
        let samples = sampling::independent(&table(&map, Sine::Center), 4_000_000, 23, go).unwrap().samples;
        let measure = |sample: &Sample| if is_bright(cell_of(sample, width, height)) { 1.0 / sample.pdf } else { 0.0 };
        let measures: Vec<f64> = samples.iter().map(measure).collect();
        TESTS.assert_plausible(name, mean_p_value(&measures, bright));
        let off: Vec<f64> = measures.iter().map(|measure| measure / 1.01).collect();
        TESTS.assert_refused(&format!("{name}: density 1 % off"), mean_p_value(&off, bright));
    }
}

/// One test for the lat-long cells, whose solid angles are known in closed form.
#[test]
fn uniform_directions_follow_solid_angle() {
    let (width, height) = (24, 12);
    let edge = |y: usize| elementary::cos(y as f64 * PI / height as f64);
    let pmf: Vec<f64> = (0..width * height).map(|k| (edge(k / width) - edge(k / width + 1)) / 2.0 / width as f64).collect();
    let mut counts = vec![0; width * height];
    for sample in sampling::uniform(None, 4_000_000, 3, go).unwrap().samples {
        counts[cell_of(&sample, width, height)] += 1;
    }
    TESTS.assert_plausible("uniform", p_value(&counts, &pmf));
    let by_angle = vec![1.0 / (width * height) as f64; width * height];
    TESTS.assert_refused("uniform in theta", p_value(&counts, &by_angle));
    let tilted: Vec<f64> = pmf.iter().enumerate().map(|(k, pmf)| pmf * if k % 2 == 0 { 1.01 } else { 0.99 }).collect();
    TESTS.assert_refused("1 % to and fro", p_value(&counts, &tilted));
}

/// One test: cells in theta and phi about +z, of probability (cos² a - cos² b) / columns.
#[test]
fn cosine_directions_follow_the_cosine() {
    let (width, height) = (24, 12);
    let edge = |y: usize| elementary::cos(y as f64 * PI / 2.0 / height as f64);
    let ring = |y: usize| edge(y) * edge(y) - edge(y + 1) * edge(y + 1);
    let pmf: Vec<f64> = (0..width * height).map(|k| ring(k / width) / width as f64).collect();
    let mut counts = vec![0; width * height];
    for sample in sampling::cosine(4_000_000, 3, go).unwrap().samples {
        let theta = elementary::acos(sample.direction.z);
        let phi = elementary::atan2(sample.direction.y, sample.direction.x).rem_euclid(2.0 * PI);
        let (x, y) = ((phi / (2.0 * PI) * width as f64) as usize, (theta / (PI / 2.0) * height as f64) as usize);
        counts[y.min(height - 1) * width + x.min(width - 1)] += 1;
    }
    TESTS.assert_plausible("cosine", p_value(&counts, &pmf));
    let uniform: Vec<f64> = (0..width * height).map(|k| (edge(k / width) - edge(k / width + 1)) / width as f64).collect();
    TESTS.assert_refused("uniform on the hemisphere", p_value(&counts, &uniform));
    let tilted: Vec<f64> = pmf.iter().enumerate().map(|(k, pmf)| pmf * if k % 2 == 0 { 1.01 } else { 0.99 }).collect();
    TESTS.assert_refused("1 % to and fro", p_value(&counts, &tilted));
}

/// Six tests: rows as independent draws of which there are sqrt(N), and columns given their rows.
#[test]
fn clustered_rows_follow_the_marginal_and_their_columns_the_conditional() {
    for (name, map) in maps() {
        let (width, height) = (map.width(), map.height());
        let pmf = pmf_by_definition(&map);
        let rows: Vec<f64> = pmf.chunks(width).map(|row| row.iter().sum()).collect();
        let side = 2_000;
        let samples = drawn(&table(&map, Sine::Center), Arrangement::RowsThenColumns, side * side, 5).samples;

        let mut row_counts = vec![0; height];
        let mut counts = vec![0; width * height];
        for cluster in samples.chunks(side) {
            row_counts[cluster[0].y as usize] += 1;
            cluster.iter().for_each(|sample| counts[cell_of(sample, width, height)] += 1);
        }
        TESTS.assert_plausible(&format!("{name}: rows"), p_value(&row_counts, &rows));
        // As if all N were independent, the rows would be far too uneven: the wrong test refuses right samples.
        TESTS.assert_refused(&format!("{name}: clusters taken for independent draws"), p_value(&counts, &pmf));

        let mut statistic = 0.0;
        let mut freedom = 0;
        for (y, row) in counts.chunks(width).enumerate().filter(|(_, row)| row.iter().sum::<u64>() > 0) {
            let drawn = row.iter().sum::<u64>() as f64;
            let expected: Vec<f64> = pmf[y * width..(y + 1) * width].iter().map(|pmf| pmf / rows[y] * drawn).collect();
            let test = chi_square_test(row, &expected);
            statistic += test.statistic;
            freedom += test.degrees_of_freedom;
        }
        TESTS.assert_plausible(&format!("{name}: columns"), chi_square_upper(statistic, freedom as f64));
    }
}

#[test]
fn stratified_points_fall_one_into_each_cell() {
    // On an even map whose pixels are the cells, each pixel is drawn exactly once.
    for count in [1, 12, 64, 97, 1000, 4096] {
        let [rows, columns] = strata(count);
        let map = EnvMap::new(Raster::filled(columns, rows, [1.0; 3]));
        for seed in 0..20 {
            let samples = drawn(&table(&map, Sine::None), Arrangement::Stratified, count, seed).samples;
            let cells: Vec<usize> = samples.iter().map(|sample| sample.y as usize * columns + sample.x as usize).collect();
            assert_eq!(cells, (0..count).collect::<Vec<_>>());
        }
        if count > 12 {
            let samples = sampling::independent(&table(&map, Sine::None), count, 1, go).unwrap().samples;
            let mut cells: Vec<usize> = samples.iter().map(|sample| sample.y as usize * columns + sample.x as usize).collect();
            cells.sort_unstable();
            assert_ne!(cells, (0..count).collect::<Vec<_>>(), "independent points would pass too");
        }
    }
}

/// Three tests. Of each set the sample of another index, so that the draws are independent; since the
/// indices take turns, the test is a little too mild.
#[test]
fn stratified_directions_follow_the_map_over_many_seeds() {
    let count = 16;
    for (name, map) in maps() {
        let distribution = table(&map, Sine::Center);
        let mut counts = vec![0; map.width() * map.height()];
        for seed in 0..200_000 {
            let samples = drawn(&distribution, Arrangement::Stratified, count, seed).samples;
            let sample = &samples[seed as usize % count];
            counts[cell_of(sample, map.width(), map.height())] += 1;
        }
        TESTS.assert_plausible(name, p_value(&counts, &pmf_by_definition(&map)));
    }
}

fn settings(sine: Sine, intensity: Intensity, clamp: Option<f32>) -> Settings {
    Settings { sine, intensity, clamp, ..Settings::default() }
}

fn is_near(found: f64, expected: f64, digit: f64) -> bool {
    (found - expected).abs() <= 0.51 * digit
}

/// Section 15 of the specification, to the digits given there.
#[test]
fn grace_has_the_published_sums_and_entropy() {
    let Some(map) = shared::map("grace_latlong.pfm") else { return };
    let build = |sine, intensity, clamp| Distribution::build(&map, &settings(sine, intensity, clamp), go).unwrap();
    let plain = build(Sine::None, Intensity::Mean, None).total();
    assert!(is_near(plain, 263342.0, 0.1), "{plain}");
    let clamped = build(Sine::None, Intensity::Mean, Some(1.0)).total();
    assert!(is_near(clamped, 63664.0, 1.0), "{clamped}");
    let edge = build(Sine::Edge, Intensity::Mean, None).total();
    assert!(is_near(edge, 178045.0, 0.1), "{edge}");
    let inclusive = build(Sine::EdgeInclusive, Intensity::Mean, None).total();
    assert!(is_near(inclusive, 178183.8, 0.1), "{inclusive}");

    let center = build(Sine::Center, Intensity::Mean, None);
    assert!(is_near(center.total(), 178484.7, 0.1), "{}", center.total());
    let brightest = (0..map.height()).max_by(|&a, &b| center.marginal_pmf(a).total_cmp(&center.marginal_pmf(b)));
    assert_eq!(brightest, Some(129));
    let information = |pmf: f64| if pmf > 0.0 { -pmf * elementary::log2(pmf) } else { 0.0 };
    let entropy: f64 = (0..map.height()).map(|y| (0..map.width()).map(|x| information(center.pmf(x, y))).sum::<f64>()).sum();
    assert!(is_near(entropy, 15.1859, 0.0001), "{entropy}");
}

/// Variance of one sample's estimate of the luminance a white diffuse surface reflects, by summing over pixels;
/// importance is by mean intensity.
#[test]
fn grace_has_the_published_variances() {
    let Some(map) = shared::map("grace_latlong.pfm") else { return };
    let by_mean = settings(Sine::Center, Intensity::Mean, None);
    let importance = Distribution::build(&map, &by_mean, go).unwrap();
    let (width, height) = (map.width(), map.height());
    let directions: Vec<_> = (0..width * height).map(|k| map.direction(k % width, k / width)).collect();
    let luminance = |k: usize| {
        let [r, g, b] = map.raster.pixels()[k].map(f64::from);
        0.2126 * r + 0.7152 * g + 0.0722 * b
    };
    let published = [
        (glam::DVec3::X, [0.2839, 22.45, 9.059], [0.0001, 0.01, 0.001]),
        (glam::DVec3::Y, [0.3998, 69.77, 23.96], [0.0001, 0.01, 0.01]),
        // Published as .0834; two ways to compute it here give .083347, which rounds to that only in two steps.
        (glam::DVec3::NEG_Y, [0.08335, 0.420, 0.395], [0.0001, 0.001, 0.001]),
    ];
    for (normal, expected, digits) in published {
        let mut mean = 0.0;
        let mut squares = [0.0; 3];
        for (k, direction) in directions.iter().enumerate() {
            let (cosine, solid_angle) = (normal.dot(*direction).max(0.0), map.solid_angle(k / width));
            let value = luminance(k) * cosine / PI;
            mean += value * solid_angle;
            // A second moment is the integral of value² / density: importance, uniform, cosine.
            let densities = [importance.pdf_of_pixel(k % width, k / width), 1.0 / (4.0 * PI), cosine / PI];
            for (square, density) in squares.iter_mut().zip(densities) {
                *square += if value > 0.0 { value * value / density * solid_angle } else { 0.0 };
            }
        }
        for ((square, expected), digit) in squares.into_iter().zip(expected).zip(digits) {
            let variance = square - mean * mean;
            assert!(is_near(variance, expected, digit), "{normal}: {variance} {expected}");
        }
    }
}

//! Every warp on every map: each realizes the probabilities that are worked out here from the map alone.
//!
//! Maps are those of the shared folder, where it is there, and those that break things: black, one bright pixel, a bright pole
//! row, a seam column, 1 x 1, 3 x 5. Driven by independent points, so that the chi-square test holds; well-spread points have
//! tests of their own. The level .001 is shared (Šidák) among at most `TEST_COUNT` tests.

use std::convert::Infallible;
use std::f64::consts::PI;
use std::num::NonZeroU32;

use pipeline::formats;
use pipeline::image::raster::Raster;
use pipeline::light::distribution::{Distribution, Settings};
use pipeline::light::envmap::EnvMap;
use pipeline::light::lights::Light;
use pipeline::light::median_cut::{self, MedianCutError, Place, Variant, median_cut};
use pipeline::light::nearest;
use pipeline::light::points::Arrangement;
use pipeline::light::samples::Sample;
use pipeline::light::sampling::{self, Draw, Placement};
use pipeline::light::warp::WarpKind;
use pipeline::math::elementary;
use pipeline::math::statistics::{chi_square_test, mean, sidak_level, standard_error};
use pipeline::math::stream::{Purpose, Stream};

/// Fifteen maps by three warps, two placements by three warps, two maps of the nearest look-up, with room.
const TEST_COUNT: u32 = 64;

fn level() -> f64 {
    sidak_level(0.001, TEST_COUNT)
}

fn go() -> Result<(), Infallible> {
    Ok(())
}

const WARPS: [WarpKind; 3] = [WarpKind::Marginal, WarpKind::Alias, WarpKind::Hierarchical];

fn made(width: usize, height: usize, color: impl Fn(usize, usize) -> f32) -> EnvMap {
    EnvMap::new(Raster::new(width, height, (0..width * height).map(|k| [color(k % width, k / width); 3]).collect()))
}

fn noise(width: usize, height: usize) -> EnvMap {
    let stream = Stream::new(31, Purpose::Test);
    made(width, height, |x, y| elementary::pow(10.0, 3.0 * stream.generator((y * width + x) as u64).uniform()) as f32)
}

fn maps() -> Vec<(String, EnvMap)> {
    let mut maps = vec![
        ("black".to_owned(), made(8, 4, |_, _| 0.0)),
        ("one pixel".to_owned(), made(64, 32, |x, y| if (x, y) == (37, 5) { 9.0 } else { 0.0 })),
        ("bright pole row".to_owned(), made(48, 24, |_, y| if y == 0 { 1000.0 } else { 0.01 })),
        ("seam column".to_owned(), made(48, 24, |x, _| if x == 47 { 500.0 } else { 0.1 })),
        ("1 x 1".to_owned(), made(1, 1, |_, _| 2.0)),
        ("3 x 5".to_owned(), noise(3, 5)),
    ];
    let folder = std::env::var_os("PIPELINE_SHARED").map(std::path::PathBuf::from);
    let folder = folder.unwrap_or_else(|| std::path::PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../shared")).join("data/envmaps");
    let Ok(entries) = std::fs::read_dir(&folder) else {
        println!("skipped: no {}", folder.display());
        return maps;
    };
    let mut paths: Vec<_> = entries.map(|entry| entry.unwrap().path()).collect();
    paths.sort();
    for path in paths {
        let name = path.file_name().unwrap().to_str().unwrap().to_owned();
        let bytes = std::fs::read(&path).unwrap();
        let decoded = formats::read(&bytes, &name, &formats::Limits::default()).unwrap();
        let formats::Content::Linear(image) = decoded.content else { panic!("{name} is a picture") };
        maps.push((name, EnvMap::new(image.color)));
    }
    maps
}

fn build(map: &EnvMap) -> Distribution {
    Distribution::build(map, &Settings::default(), go).unwrap()
}

/// Luminance of what is not negative times the sine at the row's center, over the sum; the sine alone on a black map.
fn pmf_by_definition(map: &EnvMap) -> Vec<f64> {
    let sine = |k: usize| elementary::sin(((k / map.width()) as f64 + 0.5) * PI / map.height() as f64);
    let luminance = |k: usize| {
        let [r, g, b] = map.raster.pixels()[k].map(|channel| f64::from(channel.max(0.0)));
        0.2126 * r + 0.7152 * g + 0.0722 * b
    };
    let count = map.width() * map.height();
    let weights: Vec<f64> = (0..count).map(|k| luminance(k) * sine(k)).collect();
    let total: f64 = weights.iter().sum();
    let even: f64 = (0..count).map(sine).sum();
    (0..count).map(|k| if total > 0.0 { weights[k] / total } else { sine(k) / even }).collect()
}

fn counts(distribution: &Distribution, draw: &Draw, cell: impl Fn(&Sample) -> usize, cells: usize) -> Vec<u64> {
    let mut counts = vec![0; cells];
    for sample in sampling::draw(distribution, draw, go).unwrap().samples {
        counts[cell(&sample)] += 1;
    }
    counts
}

fn p_value(counts: &[u64], pmf: &[f64]) -> f64 {
    let draws = counts.iter().sum::<u64>() as f64;
    chi_square_test(counts, &pmf.iter().map(|pmf| pmf * draws).collect::<Vec<_>>()).p_value
}

#[test]
fn every_warp_follows_every_map() {
    for (name, map) in maps() {
        let (pmf, table) = (pmf_by_definition(&map), build(&map));
        let mut wrong = pmf.clone();
        // A control: one part in a hundred moved from each row to the next, and rows of one pixel aside.
        wrong.rotate_right(1);
        for (place, warp) in WARPS.into_iter().enumerate() {
            let draw = Draw { warp, ..Draw::of(Arrangement::Independent, 2_000_000, 40 + place as u64) };
            let counts = counts(&table, &draw, |sample| sample.y as usize * map.width() + sample.x as usize, pmf.len());
            let p = p_value(&counts, &pmf);
            assert!(p > level(), "{name} {warp:?}: p = {p:e}");
            if pmf.iter().any(|p| (p - pmf[0]).abs() > 0.2 * pmf[0]) {
                let p = p_value(&counts, &wrong);
                assert!(p < 1e-6 * level(), "{name} {warp:?}: a pixel aside was not noticed, p = {p:e}");
            }
        }
    }
}

/// The four quarters of each pixel, by the direction alone.
fn quarter_of(sample: &Sample, width: usize, height: usize) -> usize {
    let theta = elementary::acos(sample.direction.y);
    let phi = elementary::atan2(sample.direction.z, sample.direction.x).rem_euclid(2.0 * PI);
    let (x, y) = ((phi / PI * width as f64) as usize, (2.0 * theta / PI * height as f64) as usize);
    y.min(2 * height - 1) * 2 * width + x.min(2 * width - 1)
}

#[test]
fn places_in_pixels_follow_their_measure() {
    let (width, height) = (12, 6);
    let map = noise(width, height);
    let (pmf, table) = (pmf_by_definition(&map), build(&map));
    let pixel = |k: usize| (k / (2 * width) / 2) * width + k % (2 * width) / 2;
    let even: Vec<f64> = (0..4 * width * height).map(|k| pmf[pixel(k)] / 4.0).collect();
    let by_solid_angle: Vec<f64> = (0..4 * width * height)
        .map(|k| {
            let cosine = |edge: usize| elementary::cos(edge as f64 * PI / (2 * height) as f64);
            let (half, row) = (k / (2 * width), k / (2 * width) / 2);
            pmf[pixel(k)] / 2.0 * (cosine(half) - cosine(half + 1)) / (cosine(2 * row) - cosine(2 * row + 2))
        })
        .collect();
    for warp in WARPS {
        for (placement, right, wrong) in [(Placement::Uv, &even, &by_solid_angle), (Placement::SolidAngle, &by_solid_angle, &even)] {
            let draw = Draw { warp, placement, ..Draw::of(Arrangement::Independent, 4_000_000, 9) };
            let counts = counts(&table, &draw, |sample| quarter_of(sample, width, height), 4 * width * height);
            let p = p_value(&counts, right);
            assert!(p > level(), "{warp:?} {placement:?}: p = {p:e}");
            let p = p_value(&counts, wrong);
            assert!(p < 1e-6 * level(), "{warp:?} {placement:?}: the other measure was not noticed, p = {p:e}");
        }
    }
}

#[test]
fn the_nearest_look_up_realizes_what_it_reports() {
    for map in [noise(24, 12), made(7, 5, |x, y| if (x + y) % 3 == 0 { 0.0 } else { (1 + x * y) as f32 })] {
        let table = build(&map);
        let (width, height) = (map.width(), map.height());
        let realized: Vec<f64> = (0..width * height).map(|k| nearest::pmf(&table, k % width, k / width)).collect();
        let draw = Draw { warp: WarpKind::Nearest { reports_intended: false }, ..Draw::of(Arrangement::Independent, 4_000_000, 3) };
        let counts = counts(&table, &draw, |sample| sample.y as usize * width + sample.x as usize, width * height);
        let p = p_value(&counts, &realized);
        assert!(p > level(), "p = {p:e}");
        let p = p_value(&counts, &pmf_by_definition(&map));
        assert!(p < 1e-6 * level(), "the intended probabilities were taken for the realized ones: p = {p:e}");
    }
}

/// Scatter over 64 seeds of the estimate of a diffuse surface's radiance, by arrangement and warp.
fn deviation(map: &EnvMap, table: &Distribution, arrangement: Arrangement, warp: WarpKind) -> (f64, f64) {
    let normal = glam::DVec3::new(0.36, 0.48, 0.8);
    let estimate = |seed| {
        let placement = Placement::SolidAngle;
        let samples = sampling::draw(table, &Draw { warp, placement, ..Draw::of(arrangement, 1024, seed) }, go).unwrap().samples;
        let value = |sample: &Sample| {
            f64::from(map.raster.pixel(sample.x as usize, sample.y as usize)[1]) * normal.dot(sample.direction).max(0.0) / sample.pdf
        };
        samples.iter().map(value).sum::<f64>() / samples.len() as f64
    };
    let values: Vec<f64> = (0..64).map(estimate).collect();
    (mean(&values), standard_error(&values) * 8.0)
}

/// Points that are well spread scatter less through every warp, and not at all less true: means agree within four standard errors.
#[test]
fn well_spread_points_help_through_every_warp() {
    let map = noise(64, 32);
    let table = build(&map);
    let mut truth = 0.0;
    let normal = glam::DVec3::new(0.36, 0.48, 0.8);
    for k in 0..64 * 32 {
        truth += f64::from(map.raster.pixels()[k][1]) * normal.dot(map.direction(k % 64, k / 64)).max(0.0) * map.solid_angle(k / 64);
    }
    let (_, plain) = deviation(&map, &table, Arrangement::Independent, WarpKind::Marginal);
    for (warp, at_most) in [(WarpKind::Marginal, 0.35), (WarpKind::Hierarchical, 0.35), (WarpKind::Alias, 0.8)] {
        for arrangement in [Arrangement::Sobol, Arrangement::Stratified] {
            let (mean, scatter) = deviation(&map, &table, arrangement, warp);
            assert!(scatter < at_most * plain, "{arrangement:?} {warp:?}: {} of independent points'", scatter / plain);
            // Pixel centers stand for pixels in the truth: a thousandth at this size.
            assert!((mean - truth).abs() < 4.0 * scatter / 8.0 + 1e-3 * truth, "{arrangement:?} {warp:?}: {mean} {truth}");
        }
    }
}

/// On every map the regions of every cut are the sphere, once, and the lights carry what the map shines.
#[test]
fn every_cut_covers_every_map_and_carries_its_light() {
    let variants = [Variant::Debevec, Variant::Coursework2021, Variant::Variance];
    let places = [Place::Center, Place::Centroid, Place::VectorMean, Place::Median];
    for (name, map) in maps() {
        let pixels = (0..map.width() * map.height()).map(|k| (map.raster.pixels()[k], map.solid_angle(k / map.width())));
        let light: [f64; 3] = [0, 1, 2].map(|channel| pixels.clone().map(|(color, angle)| f64::from(color[channel]) * angle).sum());
        for (variant, place) in variants.into_iter().flat_map(|variant| places.map(|place| (variant, place))) {
            let settings = median_cut::Settings { place, ..median_cut::Settings::of(variant, NonZeroU32::new(100).unwrap()) };
            let set = median_cut(&map, &settings, || Ok::<(), MedianCutError>(())).unwrap();
            let mut covered = vec![0_u8; map.width() * map.height()];
            for Light { region, .. } in &set.lights {
                for y in region.y0..region.y1 {
                    (region.x0..region.x1).for_each(|x| covered[y as usize * map.width() + x as usize] += 1);
                }
            }
            assert!(covered.iter().all(|times| *times == 1), "{name} {variant:?} {place:?}");
            assert_eq!(set.lights.len(), covered.len().min(100));
            for (channel, light) in light.iter().enumerate() {
                let sum: f64 = set.lights.iter().map(|light| light.irradiance[channel]).sum();
                assert!((sum - light).abs() <= 1e-10 * light.abs(), "{name} {variant:?} {place:?}: {sum} of {light}");
            }
            assert!(set.lights.iter().all(|light| (light.direction.length() - 1.0).abs() < 1e-12), "{name} {variant:?} {place:?}");
        }
    }
}

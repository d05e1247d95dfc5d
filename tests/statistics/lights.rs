//! The errors of few samples and few lights on Grace Cathedral, beside the published ones.
//!
//! RMS over the normals of the whole sphere of the luminance of the error, over the mean luminance: section 15 of the specification.
//! Errors of independent samples are worked out in closed form from the probabilities, those of lights are measured.

use std::convert::Infallible;
use std::f64::consts::PI;
use std::num::NonZeroU32;

use glam::DVec3;
use pipeline::light::distribution::{Distribution, Intensity, Settings, Sine};
use pipeline::light::envmap::EnvMap;
use pipeline::light::median_cut::{self, MedianCutError, Place, Variant, median_cut};

use crate::shared;

fn luminance([r, g, b]: [f64; 3]) -> f64 {
    0.2126 * r + 0.7152 * g + 0.0722 * b
}

/// Normals spread evenly over the whole sphere (Fibonacci's spiral).
fn normals() -> Vec<DVec3> {
    let count = 400;
    let normal = |k: usize| {
        let z = 1.0 - (2 * k + 1) as f64 / f64::from(count);
        let (sin, cos) = pipeline::math::elementary::sin_cos(k as f64 * 2.399_963_229_728_653);
        DVec3::new((1.0 - z * z).sqrt() * cos, z, (1.0 - z * z).sqrt() * sin)
    };
    (0..count as usize).map(normal).collect()
}

/// Direction and luminance times solid angle of every pixel.
fn pixels(map: &EnvMap) -> Vec<(DVec3, f64)> {
    let pixel = |k: usize| {
        let (x, y) = (k % map.width(), k / map.width());
        (map.direction(x, y), luminance(map.raster.pixel(x, y).map(f64::from)) * map.solid_angle(y))
    };
    (0..map.width() * map.height()).map(pixel).collect()
}

fn radiances(lights: &[(DVec3, f64)], normals: &[DVec3]) -> Vec<f64> {
    let radiance = |normal: &DVec3| lights.iter().map(|(direction, weight)| normal.dot(*direction).max(0.0) * weight).sum::<f64>() / PI;
    normals.iter().map(radiance).collect()
}

#[track_caller]
fn assert_published(what: &str, found: f64, published: f64, digit: f64) {
    assert!((found - published).abs() <= 0.51 * digit, "{what}: {found} instead of {published}");
}

#[test]
fn grace_has_the_published_errors() {
    let Some(map) = shared::map("grace_latlong.pfm") else { return };
    let (normals, pixels) = (normals(), pixels(&map));
    let truth = radiances(&pixels, &normals);
    let mean = truth.iter().sum::<f64>() / truth.len() as f64;
    let mean_square = truth.iter().map(|value| value * value).sum::<f64>() / truth.len() as f64;

    // The mean over normals of (n . d)+² is 1/6.
    let relative = |pmf: &dyn Fn(usize) -> f64, count: f64| {
        let second = |(k, (_, weight)): (usize, &(DVec3, f64))| if *weight > 0.0 { weight * weight / pmf(k) } else { 0.0 };
        let square = pixels.iter().enumerate().map(second).sum::<f64>() / (6.0 * PI * PI);
        ((square - mean_square) / count).sqrt() / mean
    };
    let build = |settings: Settings| Distribution::build(&map, &settings, || Ok::<(), Infallible>(())).unwrap();
    let by_mean = Settings { intensity: Intensity::Mean, ..Settings::default() };
    let tables = [
        ("importance", build(by_mean), [0.134, 0.067, 0.0335], [0.001, 0.001, 0.0001]),
        ("clamped", build(Settings { clamp: Some(1.0), ..by_mean }), [0.388, 0.194, 0.097], [0.001; 3]),
        ("no sine", build(Settings { sine: Sine::None, ..by_mean }), [0.160, 0.080, 0.040], [0.001; 3]),
    ];
    for (count, place) in [(64.0, 0), (256.0, 1), (1024.0, 2)] {
        let uniform = relative(&|k| map.solid_angle(k / map.width()) / (4.0 * PI), count);
        assert_published("uniform", uniform, [1.11, 0.555, 0.278][place], [0.01, 0.001, 0.001][place]);
        for (name, table, published, digits) in &tables {
            let found = relative(&|k| table.pmf(k % map.width(), k / map.width()), count);
            assert_published(name, found, published[place], digits[place]);
        }
    }

    let cuts = [
        ("median cut, centroid", Variant::Debevec, Place::Centroid, [0.0092, 0.0021, 0.0007], [0.0001; 3]),
        ("median cut, center", Variant::Debevec, Place::Center, [0.050, 0.016, 0.004], [0.001; 3]),
        ("the second report's medians", Variant::Coursework2021, Place::Median, [0.0127, 0.0057, 0.0032], [0.0001; 3]),
        ("variance cut", Variant::Variance, Place::VectorMean, [0.0045, 0.0013, 0.0003], [0.0001; 3]),
    ];
    let mut wrong = Vec::new();
    for (name, variant, place, published, digits) in cuts {
        for (index, count) in [64, 256, 1024].into_iter().enumerate() {
            let settings = median_cut::Settings { place, ..median_cut::Settings::of(variant, NonZeroU32::new(count).unwrap()) };
            let set = median_cut(&map, &settings, || Ok::<(), MedianCutError>(())).unwrap();
            let lights: Vec<(DVec3, f64)> = set.lights.iter().map(|light| (light.direction, luminance(light.irradiance))).collect();
            let found = radiances(&lights, &normals);
            let squares: f64 = found.iter().zip(&truth).map(|(found, truth)| (found - truth) * (found - truth)).sum();
            let error = (squares / truth.len() as f64).sqrt() / mean;
            println!("{name}, {count}: {error:.5} (published {})", published[index]);
            if (error - published[index]).abs() > 1.01 * digits[index] {
                wrong.push(format!("{name}, {count}: {error} instead of {}", published[index]));
            }
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

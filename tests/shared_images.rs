//! Real images against values that were computed independently, with numpy in double precision.
//!
//! The images are not part of this repository; where they are absent the test says so and passes.

use std::fs;
use std::path::{Path, PathBuf};

use pipeline::formats::{self, Content, Limits};
use pipeline::image::raster::{PictureSamples, Raster};
use pipeline::math::elementary;
use pipeline::stages::conversion;
use serde_json::Value as Json;

fn data() -> Option<PathBuf> {
    let named = std::env::var_os("PIPELINE_SHARED").map(PathBuf::from);
    let folder = named.unwrap_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared")).join("data");
    folder.join("stats.json").is_file().then_some(folder)
}

#[test]
fn every_shared_image_has_the_statistics_that_numpy_found() {
    let Some(data) = data() else {
        println!("skipped: the shared images are not here");
        return;
    };
    let all: Json = serde_json::from_str(&fs::read_to_string(data.join("stats.json")).unwrap()).unwrap();
    let images = all.as_object().unwrap().iter().filter(|(_, expected)| expected.get("width").is_some());
    let mut count = 0;
    for (name, expected) in images {
        let bytes = fs::read(data.join(name)).unwrap();
        let info = conversion::info(&bytes, name, &Limits::default()).unwrap();
        assert_eq!((info.width as u64, info.height as u64), (number(&expected["width"]), number(&expected["height"])), "{name}");
        check_pixels(name, expected, &raster(&bytes, name));
        if let Some(mean) = expected["mean_intensity"].as_f64() {
            check_statistics(name, expected, mean, &info.pixels);
        }
        count += 1;
    }
    println!("{count} images");
    assert!(count >= 10, "{count} images");
}

fn number(value: &Json) -> u64 {
    value.as_u64().unwrap()
}

/// Pixels as they are in the file: light, or codes.
fn raster(bytes: &[u8], name: &str) -> Raster {
    match formats::read(bytes, name, &Limits::default()).unwrap().content {
        Content::Linear(image) => image.color,
        Content::Display(picture) => {
            let PictureSamples::Eight(samples) = picture.samples else { panic!("the shared pictures have 8 bits") };
            Raster::new(picture.width, picture.height, samples.iter().map(|pixel| pixel.map(f32::from)).collect())
        }
    }
}

fn check_pixels(name: &str, expected: &Json, raster: &Raster) {
    for (at, value) in expected["pixels"].as_object().into_iter().flatten() {
        let (x, y) = at.split_once(',').unwrap();
        let found = raster.pixel(x.parse().unwrap(), y.parse().unwrap());
        let is_near = |expected: &Json, found: f32| {
            // DWA is lossy: decoders may differ in the last bit of a half.
            let tolerance = if name.contains("dwa") { 2e-3 } else { 1e-6 };
            let expected = expected.as_f64().unwrap();
            (f64::from(found) - expected).abs() <= tolerance * expected.abs()
        };
        let is_right = match value.as_array() {
            Some(channels) => channels.iter().zip(found).all(|(expected, found)| is_near(expected, found)),
            None => is_near(value, found[0]),
        };
        assert!(is_right, "{name}: pixel {at} is {found:?}, expected {value}");
    }
}

fn check_statistics(name: &str, expected: &Json, mean: f64, found: &conversion::PixelStatistics) {
    let tolerance = if name.contains("dwa") { 2e-4 } else { 1e-9 };
    let expected_height = number(&expected["height"]) as f64;
    let near = |key: &str, found: f64, expected: f64| {
        let difference = (found - expected).abs();
        assert!(difference <= tolerance * expected.abs().max(1e-2), "{name}: {key} is {found}, expected {expected}");
    };
    near("mean_intensity", found.mean_intensity, mean);
    for (key, found) in [("min_rgb", &found.min_rgb), ("max_rgb", &found.max_rgb)] {
        if let Some(expected) = expected[key].as_array() {
            found.iter().zip(expected).for_each(|(found, expected)| near(key, *found, expected.as_f64().unwrap()));
        }
    }
    if let (Some(expected), Some(found)) = (expected["integral_rgb"].as_array(), found.integral_rgb) {
        // There each pixel has the solid angle 2 pi^2 / (W H) sin theta, which is larger than the exact one by this.
        let half = std::f64::consts::PI / (2.0 * expected_height);
        let factor = half / elementary::sin(half);
        found.iter().zip(expected).for_each(|(found, expected)| near("integral_rgb", factor * found, expected.as_f64().unwrap()));
    }
    if let Some(zeros) = expected["zero_pixels"].as_u64() {
        assert_eq!(found.zero_count, zeros, "{name}: pixels that are 0");
    }
    if let Some(at) = expected["brightest_xy"].as_array() {
        assert_eq!(found.brightest, (number(&at[0]) as usize, number(&at[1]) as usize), "{name}: brightest pixel");
    }
}

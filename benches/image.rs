//! Times of the image room: `cargo bench --bench image`.
//!
//! The sizes are those of the main job: spheres of 511 x 511 pixels and a map of 1024 x 512.
#![allow(missing_docs)]

use std::convert::Infallible;

use divan::{Bencher, black_box};
use pipeline::image::average::RunningMean;
use pipeline::image::flip::{self, ExposureRange};
use pipeline::image::metrics::{self, Compared, Metric, MetricError, MetricSettings};
use pipeline::image::nl_means::{self, Border, Guide, Settings};
use pipeline::image::raster::{Image, Raster};
use pipeline::image::tone::{self, Bits, Exposure, Gamma, Operator, ToneSettings};
use pipeline::math::elementary;
use pipeline::math::stream::{Purpose, Stream};

fn main() {
    divan::main();
}

/// Log-normal noise: a dynamic range of about five decades.
fn noise(width: usize, height: usize, seed: u64) -> Raster {
    let stream = Stream::new(seed, Purpose::Test);
    let pixel = |index: usize| {
        let mut generator = stream.generator(index as u64);
        std::array::from_fn(|_| elementary::exp(4.0 * (generator.uniform() + generator.uniform() + generator.uniform() - 1.5)) as f32)
    };
    Raster::new(width, height, (0..width * height).map(pixel).collect())
}

fn unchecked() -> Result<(), Infallible> {
    Ok(())
}

#[divan::bench]
fn flip_of_a_511_sphere(bencher: Bencher) {
    let (reference, test) = (noise(511, 511, 1), noise(511, 511, 2));
    bencher.bench(|| flip::flip(black_box(&reference), &test, 67.0, unchecked));
}

#[divan::bench(args = [2, 10, 16])]
fn hdr_flip_of_a_511_sphere(bencher: Bencher, exposures: usize) {
    let (reference, test) = (noise(511, 511, 1), noise(511, 511, 2));
    let range = ExposureRange { start_stops: -8.0, stop_stops: 2.0, count: exposures };
    bencher.bench(|| flip::hdr_flip(black_box(&reference), &test, 67.0, &range, unchecked));
}

#[divan::bench(args = [Metric::Rmse, Metric::Relmse, Metric::Smape, Metric::Psnr])]
fn metric_of_a_511_sphere(bencher: Bencher, metric: &Metric) {
    let (of, to) = (Image::opaque(noise(511, 511, 1)), Image::opaque(noise(511, 511, 2)));
    let settings = MetricSettings::default();
    bencher.bench(|| {
        let compared = Compared::new(&of, &to).expect("both have one size");
        metrics::measure(*metric, &compared, &settings, || Ok::<(), MetricError>(()))
    });
}

#[divan::bench(args = [1.0, 2.2])]
fn gamma_of_a_1k_map(bencher: Bencher, gamma: f64) {
    let image = Image::opaque(noise(1024, 512, 1));
    let settings = ToneSettings { gamma: Gamma::Power(gamma), ..ToneSettings::default() };
    bencher.bench(|| tone::tone_map(black_box(&image), &settings, unchecked));
}

#[divan::bench(args = [Operator::AcesHill, Operator::Agx, Operator::Neutral])]
fn operator_on_a_1k_map(bencher: Bencher, operator: &Operator) {
    let image = Image::opaque(noise(1024, 512, 1));
    let settings = ToneSettings { operator: *operator, exposure: Exposure::Auto, ..ToneSettings::default() };
    bencher.bench(|| tone::tone_map(black_box(&image), &settings, unchecked));
}

#[divan::bench]
fn sixteen_bits_of_a_1k_map(bencher: Bencher) {
    let image = Image::opaque(noise(1024, 512, 1));
    let settings = ToneSettings { bits: Bits::Sixteen, ..ToneSettings::default() };
    bencher.bench(|| tone::tone_map(black_box(&image), &settings, unchecked));
}

#[divan::bench]
fn average_of_16_spheres(bencher: Bencher) {
    let images: Vec<Image> = (0..16).map(|seed| Image::opaque(noise(511, 511, seed))).collect();
    bencher.bench(|| {
        let mut mean = RunningMean::of(&images[0]);
        images[1..].iter().try_for_each(|image| mean.push(image)).expect("all have one size");
        mean.finish()
    });
}

/// At the defaults of `denoise` but for the patch, whose size should hardly count.
#[divan::bench(args = [1, 3, 10])]
fn nl_means_of_256_pixels_square(bencher: Bencher, patch_radius: u32) {
    let (color, variance) = (noise(256, 256, 1), noise(256, 256, 2));
    let settings = Settings { patch_radius, window_radius: 10, k: 0.45, patchwise: false, border: Border::Clamp };
    let guide = Guide { color: &color, variance: &variance, coverage: None, features: &[] };
    bencher.bench(|| nl_means::filter(black_box(&color), guide, settings, unchecked));
}

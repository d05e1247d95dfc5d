//! Times of cutting and relighting, at the sizes that the README quotes: `cargo bench --bench light`.
//!
//! Maps are noise made here, so that nothing is read. Threads are rayon's (`RAYON_NUM_THREADS`).

use std::convert::Infallible;
use std::num::NonZeroU32;

use divan::{Bencher, black_box};
use pipeline::image::raster::Raster;
use pipeline::light::envmap::EnvMap;
use pipeline::light::harmonics::Coefficients;
use pipeline::light::median_cut::{MedianCutError, Settings, Variant, median_cut};
use pipeline::light::relight::estimators::{SampleEstimator, WeightedDirections};
use pipeline::light::relight::exact;
use pipeline::light::relight::limits::Integrand;
use pipeline::light::relight::turned::TurnedDirections;
use pipeline::light::relight::views::{Lookup, mirror};
use pipeline::light::samples::{Frame, Sample, SampleSet};
use pipeline::math::sphere::{cosine_hemisphere, cosine_hemisphere_pdf, uniform_sphere, uniform_sphere_pdf};
use pipeline::math::stream::{Purpose, Stream};

fn main() {
    divan::main();
}

/// The coursework's picture.
const SIZE: usize = 511;

const WHITE: [f64; 3] = [1.0; 3];

/// Noise over four decades.
fn map(width: usize, height: usize) -> EnvMap {
    let mut numbers = Stream::new(1, Purpose::Test).generator(0);
    let mut channel = || {
        let uniform = numbers.uniform();
        (uniform * uniform * uniform * uniform) as f32
    };
    EnvMap::new(Raster::new(width, height, (0..width * height).map(|_| [channel(), channel(), channel()]).collect()))
}

fn samples(count: u64, frame: Frame) -> SampleSet {
    let stream = Stream::new(2, Purpose::Test);
    let sample = |index| {
        let u = stream.generator(index).uniform_pair();
        let (direction, pdf) = match frame {
            Frame::World => (uniform_sphere(u), uniform_sphere_pdf()),
            Frame::Normal => {
                let direction = cosine_hemisphere(u);
                (direction, cosine_hemisphere_pdf(direction.z))
            }
        };
        Sample { x: 0, y: 0, u: u[0], v: u[1], direction, pmf: 1.0, pdf, radiance: Some([1.0, 2.0, 3.0]) }
    };
    SampleSet { map_width: 0, map_height: 0, frame, samples: (0..count).map(sample).collect() }
}

fn never() -> Result<(), Infallible> {
    Ok(())
}

#[divan::bench(args = [Variant::Debevec, Variant::Coursework2021], sample_count = 10)]
fn median_cut_of_4096x2048_into_1024_lights(bencher: Bencher, variant: &Variant) {
    let map = map(4096, 2048);
    let settings = Settings::of(*variant, NonZeroU32::new(1024).expect("1024 is not 0"));
    bencher.bench_local(|| median_cut(black_box(&map), &settings, || Ok::<(), MedianCutError>(())));
}

#[divan::bench(args = [256, 1024], sample_count = 5)]
fn variance_cut_of_4096x2048(bencher: Bencher, count: u32) {
    let map = map(4096, 2048);
    let settings = Settings::of(Variant::Variance, NonZeroU32::new(count).expect("no count is 0"));
    bencher.bench_local(|| median_cut(black_box(&map), &settings, || Ok::<(), MedianCutError>(())));
}

#[divan::bench(args = [64, 256, 1024], sample_count = 10)]
fn samples_onto_511x511(bencher: Bencher, count: u64) {
    let samples = samples(count, Frame::World);
    let directions = WeightedDirections::of_samples(&samples, None, SampleEstimator::PdfWeighted).expect("samples carry radiance");
    bencher.bench_local(|| black_box(&directions).relight(SIZE, WHITE, never));
}

#[divan::bench(args = [64], sample_count = 10)]
fn cosine_samples_onto_511x511(bencher: Bencher, count: u64) {
    let (samples, map) = (samples(count, Frame::Normal), map(1024, 512));
    let directions = TurnedDirections::new(&samples, &map, SampleEstimator::PdfWeighted).expect("samples have a density");
    bencher.bench_local(|| black_box(&directions).relight(SIZE, WHITE, never));
}

#[divan::bench(args = [[256, 128], [1024, 512], [4096, 2048]], sample_count = 5)]
fn exact_511x511(bencher: Bencher, [width, height]: [usize; 2]) {
    let map = map(width, height);
    bencher.bench_local(|| exact::relight(black_box(&map), &Integrand::radiance(), SIZE, WHITE, never));
}

#[divan::bench(sample_count = 10)]
fn harmonics_of_1024x512_onto_511x511(bencher: Bencher) {
    let map = map(1024, 512);
    bencher.bench_local(|| Coefficients::of(black_box(&map), never).map(|coefficients| coefficients.relight(SIZE, WHITE, never)));
}

#[divan::bench(sample_count = 10)]
fn mirror_511x511(bencher: Bencher) {
    let map = map(1024, 512);
    bencher.bench_local(|| mirror(black_box(&map), Lookup::Bilinear, SIZE, never));
}

//! Times building a distribution and drawing from it.
//!
//! `cargo bench --bench sampling` for divan's table. `numpy_sampling.py` runs `sampling --times MAP WIDTH HEIGHT COUNT`
//! on a raw file of f32 RGB and reads seconds, the best of several runs, from lines of `name seconds`.

use std::convert::Infallible;
use std::time::Instant;

use pipeline::image::raster::Raster;
use pipeline::light::distribution::{Distribution, Settings};
use pipeline::light::envmap::EnvMap;
use pipeline::light::sampling;
use pipeline::math::elementary;
use pipeline::math::stream::{Purpose, Stream};

fn main() {
    let arguments: Vec<String> = std::env::args().collect();
    match arguments.iter().position(|argument| argument == "--times") {
        Some(place) => print_times(&arguments[place + 1..]),
        None => divan::main(),
    }
}

fn go() -> Result<(), Infallible> {
    Ok(())
}

fn build(map: &EnvMap) -> Distribution {
    Distribution::build(map, &Settings::default(), go).expect("a finite map")
}

/// A map of random values over five decades.
fn rough_map(width: usize, height: usize) -> EnvMap {
    let stream = Stream::new(1, Purpose::Test);
    let value = |k: usize| elementary::pow(10.0, 5.0 * stream.generator(k as u64).uniform() - 3.0) as f32;
    EnvMap::new(Raster::new(width, height, (0..width * height).map(|k| [value(k); 3]).collect()))
}

#[divan::bench(args = [1024, 4096])]
fn build_distribution(bencher: divan::Bencher, width: usize) {
    let map = rough_map(width, width / 2);
    bencher.bench(|| build(&map));
}

#[divan::bench(args = [1024, 4096])]
fn draw_a_million(bencher: divan::Bencher, width: usize) {
    let distribution = build(&rough_map(width, width / 2));
    bencher.bench(|| sampling::independent(&distribution, 1_000_000, 7, go));
}

fn print_times(arguments: &[String]) {
    // Cargo adds a flag of its own at the end.
    let [path, width, height, count, ..] = arguments else { panic!("--times MAP WIDTH HEIGHT COUNT") };
    let number = |text: &String| text.parse::<usize>().expect("a whole number");
    let bytes = std::fs::read(path).expect("a raw file of f32 RGB");
    let channel = |bytes: &[u8]| f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]);
    let pixels = bytes.chunks_exact(12).map(|pixel| [channel(pixel), channel(&pixel[4..]), channel(&pixel[8..])]).collect();
    let map = EnvMap::new(Raster::new(number(width), number(height), pixels));
    let distribution = build(&map);
    println!("build {}", best_seconds(7, || build(&map)));
    println!("draw {}", best_seconds(5, || sampling::independent(&distribution, number(count), 7, go)));
}

fn best_seconds<T>(run_count: usize, work: impl Fn() -> T) -> f64 {
    let seconds = |_| {
        let start = Instant::now();
        let result = work();
        let elapsed = start.elapsed().as_secs_f64();
        drop(std::hint::black_box(result));
        elapsed
    };
    (0..run_count).map(seconds).fold(f64::INFINITY, f64::min)
}

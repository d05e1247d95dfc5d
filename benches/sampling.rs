//! Times building a distribution and drawing from it.
//!
//! `cargo bench --bench sampling` for divan's table. `numpy_sampling.py` runs `sampling --times MAP WIDTH HEIGHT COUNT`, and
//! `light_peers.py` `sampling --lit MAP WIDTH HEIGHT COUNT`, on a raw file of f32 RGB, and read seconds, the best of several runs, from
//! lines of `name seconds`.

use std::convert::Infallible;
use std::time::Instant;

use pipeline::image::raster::Raster;
use pipeline::light::distribution::{Distribution, Settings};
use pipeline::light::envmap::EnvMap;
use pipeline::light::points::Arrangement;
use pipeline::light::sampling::{self, Draw, Placement, Sampler};
use pipeline::light::warp::WarpKind;
use pipeline::math::elementary;
use pipeline::math::stream::{Purpose, Stream};

fn main() {
    let arguments: Vec<String> = std::env::args().collect();
    let place = |name: &str| arguments.iter().position(|argument| argument == name).map(|place| &arguments[place + 1..]);
    match (place("--times"), place("--lit")) {
        (Some(rest), _) => print_times(rest),
        (None, Some(rest)) => print_lit_times(rest),
        (None, None) => divan::main(),
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

#[divan::bench(args = [Arrangement::Sobol, Arrangement::Stratified])]
fn draw_a_million_well_spread(bencher: divan::Bencher, arrangement: Arrangement) {
    let distribution = build(&rough_map(1024, 512));
    let draw = Draw { warp: WarpKind::Hierarchical, placement: Placement::SolidAngle, ..Draw::of(arrangement, 1_000_000, 7) };
    bencher.bench(|| sampling::draw(&distribution, &draw, go));
}

const WARPS: [(&str, WarpKind); 3] =
    [("marginal", WarpKind::Marginal), ("alias", WarpKind::Alias), ("hierarchical", WarpKind::Hierarchical)];

/// Points that are drawn together.
const BATCH: usize = 128;

/// Direction, radiance and density of one direction, as a renderer keeps them.
type Drawn = [f32; 7];

/// Draws into memory that is there: numbers, directions within pixels, radiances, densities.
fn draw_lit(sampler: &Sampler<'_>, map: &EnvMap, drawn: &mut [Drawn]) {
    let stream = Stream::new(7, Purpose::Test);
    for (batch, drawn) in drawn.chunks_mut(BATCH).enumerate() {
        let mut numbers = stream.generator(batch as u64);
        let points: [[f64; 2]; BATCH] = std::array::from_fn(|_| numbers.uniform_pair());
        for (drawn, lit) in drawn.iter_mut().zip(sampler.lit(map, &points)) {
            let ([x, y, z], [r, g, b]) = (lit.direction.as_vec3().to_array(), lit.radiance);
            *drawn = [x, y, z, r, g, b, lit.pdf as f32];
        }
    }
}

/// Building the distribution, and what each warp needs beside it; drawing directions with radiance and density on one thread.
fn print_lit_times(arguments: &[String]) {
    let (map, count) = map_and_count(arguments);
    let distribution = build(&map);
    println!("build {}", best_seconds(7, || build(&map)));
    let mut drawn: Vec<Drawn> = vec![[0.0; 7]; count];
    for (name, kind) in WARPS {
        let made = || Sampler::new(&distribution, kind, Placement::SolidAngle, go).expect("a map of pixel centers");
        println!("build-{name} {}", best_seconds(3, made));
        let sampler = made();
        let seconds = (0..5).map(|_| {
            let (start, processor) = (Instant::now(), processor_seconds());
            draw_lit(&sampler, &map, &mut drawn);
            std::hint::black_box(&drawn);
            processor.map_or(start.elapsed().as_secs_f64(), |before| processor_seconds().unwrap_or(before) - before)
        });
        println!("{name} {}", seconds.fold(f64::INFINITY, f64::min));
    }
    // The mean of radiance over density is the integral over the sphere, whoever draws.
    let mean = drawn.iter().map(|d| f64::from(d[4]) / f64::from(d[6])).sum::<f64>() / count as f64;
    println!("integral {mean}");
}

/// Processor time of this thread, which other programs on the machine do not add to; where Linux tells it.
fn processor_seconds() -> Option<f64> {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
    Some(text.split_whitespace().next()?.parse::<f64>().ok()? / 1e9)
}

fn map_and_count(arguments: &[String]) -> (EnvMap, usize) {
    // Cargo adds a flag of its own at the end.
    let [path, width, height, count, ..] = arguments else { panic!("MAP WIDTH HEIGHT COUNT") };
    let number = |text: &String| text.parse::<usize>().expect("a whole number");
    let bytes = std::fs::read(path).expect("a raw file of f32 RGB");
    let channel = |bytes: &[u8]| f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]);
    let pixels = bytes.chunks_exact(12).map(|pixel| [channel(pixel), channel(&pixel[4..]), channel(&pixel[8..])]).collect();
    (EnvMap::new(Raster::new(number(width), number(height), pixels)), number(count))
}

fn print_times(arguments: &[String]) {
    let (map, count) = map_and_count(arguments);
    let distribution = build(&map);
    println!("build {}", best_seconds(7, || build(&map)));
    println!("draw {}", best_seconds(5, || sampling::independent(&distribution, count, 7, go)));
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

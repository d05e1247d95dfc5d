//! The path tracer: every way to find light and every sampler has the same mean, which is the exact one where it is known.
//!
//! Means over at least 16 seeds, compared by their standard errors. Each test splits the level .001 over its
//! comparisons (Šidák) on Student's t; no sample may be anything but a finite color.

use std::convert::Infallible;
use std::f64::consts::PI;

use pipeline::image::filter::{Rows, resize_exactly};
use pipeline::image::raster::Raster;
use pipeline::light::envmap::EnvMap;
use pipeline::light::relight::exact;
use pipeline::light::relight::limits::Integrand;
use pipeline::math::elementary;
use pipeline::math::statistics::{mean, sidak_level, standard_error, student_t_cdf, variance};
use pipeline::math::stream::{Purpose, Stream};
use pipeline::render::film::sums::{Block, Refused, Window};
use pipeline::render::picture::{self, Request};
use pipeline::render::scene::SceneDescription;
use pipeline::render::scene::compiled::{NoLibrary, Scene, Surroundings};

pub const SEEDS: u64 = 16;

/// Dim noise with two small windows a thousand times brighter: what a compensated density is made for.
pub fn windows(width: usize, height: usize) -> EnvMap {
    let stream = Stream::new(21, Purpose::Test);
    let pixel = |index: usize| {
        let [u, v] = [(index % width) as f64 / width as f64, (index / width) as f64 / height as f64];
        let mut numbers = stream.generator(index as u64);
        let is_window = (0.1..0.16).contains(&u) && (0.2..0.3).contains(&v) || (0.6..0.64).contains(&u) && (0.4..0.5).contains(&v);
        let scale = if is_window { 200.0 } else { 0.2 };
        [1.0, 0.8, 0.6].map(|channel: f64| (channel * scale * (0.5 + numbers.uniform())) as f32)
    };
    EnvMap::new(Raster::new(width, height, (0..width * height).map(pixel).collect()))
}

fn description(text: &str) -> SceneDescription {
    serde_yaml::with::singleton_map_recursive::deserialize(serde_yaml::Deserializer::from_str(text)).unwrap()
}

/// Pixels of a render; no sample may have been refused.
pub fn pixels(text: &str, env: Option<&EnvMap>, seed: u64) -> Vec<[f64; 3]> {
    let description = description(text);
    assert_eq!(description.mistakes(), [], "{text}");
    let surroundings = Surroundings { env, lights: None, seed };
    let scene = Scene::new(&description, &surroundings, &mut NoLibrary, || Ok(())).unwrap();
    let block = Block { first: 0, count: description.samples_per_replicate() };
    let window = Window::whole(description.film.resolution);
    let request = Request { window, block, replicates: description.replicates(), start: None };
    let film = picture::render(&scene, &request, || Ok::<(), Infallible>(()), |_| ()).unwrap();
    assert_eq!(film.refused, Refused::default());
    film.image(&description.film).color.pixels().iter().map(|pixel| pixel.map(f64::from)).collect()
}

/// The same number of every seed's picture: all its channels, and their means over the picture last.
pub fn by_seed(text: &str, env: Option<&EnvMap>) -> Vec<Vec<f64>> {
    by_seeds(SEEDS, text, env)
}

fn by_seeds(count: u64, text: &str, env: Option<&EnvMap>) -> Vec<Vec<f64>> {
    (0..count)
        .map(|seed| {
            let pixels = pixels(text, env, seed + 1);
            let means: Vec<f64> = (0..3).map(|k| pixels.iter().map(|pixel| pixel[k]).sum::<f64>() / pixels.len() as f64).collect();
            pixels.into_iter().flatten().chain(means).collect()
        })
        .collect()
}

fn column(rows: &[Vec<f64>], index: usize) -> Vec<f64> {
    rows.iter().map(|row| row[index]).collect()
}

/// Two-sided probability of a t at least as large in magnitude.
pub fn p_value(t: f64, freedom: f64) -> f64 {
    2.0 * (1.0 - student_t_cdf(t.abs(), freedom))
}

/// Whether two sets of pictures have the same mean everywhere (Welch's test).
pub fn assert_same_means(name: &str, a: &[Vec<f64>], b: &[Vec<f64>], comparisons: u32) {
    let count = a[0].len();
    let level = sidak_level(1e-3, comparisons * count as u32);
    for index in 0..count {
        let (x, y) = (column(a, index), column(b, index));
        let (vx, vy) = (variance(&x) / x.len() as f64, variance(&y) / y.len() as f64);
        let difference = mean(&x) - mean(&y);
        if vx + vy == 0.0 {
            assert!(difference.abs() <= 1e-6 * mean(&y).abs(), "{name} {index}: {} {}", mean(&x), mean(&y));
            continue;
        }
        let freedom = (vx + vy) * (vx + vy) / (vx * vx / (x.len() - 1) as f64 + vy * vy / (y.len() - 1) as f64);
        let p = p_value(difference / (vx + vy).sqrt(), freedom);
        assert!(p > level, "{name}, number {index} of {count}: {} against {}, p = {p}", mean(&x), mean(&y));
    }
}

/// Diffuse, glossy, plastic and glass things under a lamp, a point, parallel light and a map.
const STILL: &str = "
camera: { perspective: { origin: [0, 1, 5], fov_degrees: 50 } }
film: { resolution: [6, 4] }
sampler: SAMPLER
integrator: INTEGRATOR
shapes:
  - { sphere: { center: [-0.9, 0, 0], radius: 0.6 }, bsdf: { diffuse: { reflectance: [0.8, 0.4, 0.2] } } }
  - { sphere: { center: [0.4, 0, 0.6], radius: 0.5 }, bsdf: { rough-conductor: { metal: copper, alpha: 0.3 } } }
  - { sphere: { center: [1.6, 0, -0.2], radius: 0.6 }, bsdf: { plastic: {} } }
  - { rectangle: {}, transform: [{ rotate: { axis: [1, 0, 0], degrees: -90 } }, { scale: 3 }, { translate: [0, -0.6, 0] }] }
  - { disk: {}, transform: [{ rotate: { axis: [1, 0, 0], degrees: 90 } }, { translate: [0, 3, 0] }], emitter: { area: { radiance: [6, 5, 4] } } }
  - { sphere: { center: [-2.2, 0.6, -0.5], radius: 0.3 }, emitter: { area: { radiance: { checker: { a: [3, 9, 2], b: 12, scale: 4 } } } } }
emitters:
  - { point: { position: [2, 2, 2], intensity: 3 } }
  - { directional: { towards: [1, 2, 1], irradiance: 0.7 } }
";

pub fn still(sampler: &str, integrator: &str) -> String {
    STILL.replace("SAMPLER", sampler).replace("INTEGRATOR", integrator)
}

pub const MANY: &str = "{ independent: { samples_per_pixel: 1024 } }";

#[test]
fn every_strategy_finds_the_same_light() {
    let map = windows(64, 32);
    for depth in ["direct: { ", "path: { max_depth: 4, "] {
        let kind = |rest: &str| by_seed(&still(MANY, &format!("{{ {depth}{rest} }} }}")), Some(&map));
        let reference = kind("mis_compensation: false");
        let others = [
            "mis_compensation: true",
            "strategy: emitter",
            "strategy: bsdf",
            "bsdf_sampling: cosine",
            "strategy: emitter, environment: uniform",
            "environment: uniform",
            "emitter_candidates: 1",
            "emitter_candidates: 7",
            "strategy: emitter, emitter_candidates: 8",
            "strategy: bsdf, emitter_candidates: 3",
            "environment: uniform, emitter_candidates: 5",
        ];
        for other in others {
            assert_same_means(&format!("{depth}{other}"), &kind(other), &reference, 24);
        }
        if depth.starts_with("direct") {
            assert_same_means("four lights a vertex", &kind("emitter_samples: 4"), &reference, 24);
            assert_same_means("two of three each", &kind("emitter_samples: 2, emitter_candidates: 3"), &reference, 24);
        }
    }
}

/// The control: without the weights of multiple importance sampling light counts twice, and this must show.
#[test]
fn light_that_counts_twice_is_noticed() {
    let map = windows(64, 32);
    let of = |strategy: &str| by_seed(&still(MANY, &format!("{{ direct: {{ strategy: {strategy} }} }}")), Some(&map));
    let sum: Vec<Vec<f64>> = of("emitter").iter().zip(of("bsdf")).map(|(a, b)| a.iter().zip(b).map(|(a, b)| a + b).collect()).collect();
    let result = std::panic::catch_unwind(|| assert_same_means("twice", &sum, &of("mis"), 1));
    assert!(result.is_err());
}

#[test]
fn roulette_loses_nothing() {
    let map = windows(64, 32);
    let kind = |rest: &str| by_seed(&still(MANY, &format!("{{ path: {{ max_depth: 8, roulette_depth: {rest} }} }}")), Some(&map));
    assert_same_means("roulette", &kind("0"), &kind("100"), 1);
}

#[test]
fn every_sampler_has_the_same_mean() {
    // Light of the windows that is found by scattering alone is rare: means of few seeds are skewed, and their spread with them.
    const MORE_SEEDS: u64 = 96;
    let map = windows(64, 32);
    let reference = by_seeds(MORE_SEEDS, &still(MANY, "{ path: { max_depth: 3 } }"), Some(&map));
    for sampler in [
        "{ stratified: { samples_per_pixel: 64 } }",
        "{ stratified: { samples_per_pixel: 7 } }",
        "{ sobol: { samples_per_pixel: 64 } }",
        "{ sobol: { samples_per_pixel: 5 } }",
        "{ sobol: { samples_per_pixel: 64, replicates: 4 } }",
        "{ independent: { samples_per_pixel: 8 } }",
    ] {
        let found = by_seeds(MORE_SEEDS, &still(sampler, "{ path: { max_depth: 3 } }"), Some(&map));
        assert_same_means(sampler, &found, &reference, 6);
    }
}

const SPHERE: &str = "
film: { resolution: [16, 16], background: transparent }
camera: { orthographic: {} }
sampler: SAMPLER
integrator: { direct: {} }
shapes: [{ sphere: {}, bsdf: { diffuse: { reflectance: 1 } } }]
";

/// Averages 16 x 16 points of the exact sphere to a pixel; `None` where not all of them are on it.
///
/// The exact sphere has the light of a pixel of the map in its center, the renderer all over it, which makes percents where
/// a window sets. So each pixel is laid out as 8 x 8 first.
fn supersampled(map: &EnvMap, size: usize) -> Vec<Option<[f64; 3]>> {
    const FINE: usize = 16;
    let finer = [8 * map.width(), 8 * map.height()];
    let map = &EnvMap::new(resize_exactly(&map.raster, finer, Rows::Area, || Ok::<(), Infallible>(())).unwrap());
    let fine = exact::relight(map, &Integrand::radiance(), size * FINE, [1.0; 3], || Ok::<(), Infallible>(())).unwrap();
    let pixel = |place: usize| {
        let (x, y) = (place % size * FINE, place / size * FINE);
        let points: Vec<(usize, usize)> = (0..FINE * FINE).map(|k| (x + k % FINE, y + k / FINE)).collect();
        let is_whole = points.iter().all(|(x, y)| fine.is_covered(y * size * FINE + x));
        let sum = |k: usize| points.iter().map(|(x, y)| f64::from(fine.color.pixel(*x, *y)[k])).sum::<f64>();
        is_whole.then(|| std::array::from_fn(|k| sum(k) / (FINE * FINE) as f64))
    };
    (0..size * size).map(pixel).collect()
}

#[test]
fn the_diffuse_sphere_is_the_exact_one() {
    let map = windows(64, 32);
    let truth = supersampled(&map, 16);
    for sampler in ["{ sobol: { samples_per_pixel: 64 } }", "{ independent: { samples_per_pixel: 256 } }"] {
        let text = SPHERE.replace("SAMPLER", sampler);
        let renders: Vec<Vec<[f64; 3]>> = (0..SEEDS).map(|seed| pixels(&text, Some(&map), seed + 1)).collect();
        let mut scores = Vec::new();
        let (mut found_sum, mut true_sum) = (vec![0.0; SEEDS as usize], 0.0);
        for (place, expected) in truth.iter().enumerate() {
            let Some(expected) = expected else { continue };
            for k in 0..3 {
                let values: Vec<f64> = renders.iter().map(|pixels| pixels[place][k]).collect();
                scores.push((mean(&values) - expected[k]) / standard_error(&values));
                true_sum += expected[k];
                found_sum.iter_mut().zip(&values).for_each(|(sum, value)| *sum += value);
            }
        }
        let level = sidak_level(1e-3, 2 * (scores.len() as u32 + 1));
        let worst = scores.iter().fold(0.0, |worst: f64, z| worst.max(z.abs()));
        assert!(p_value(worst, SEEDS as f64 - 1.0) > level, "{sampler}: {worst} standard errors");
        let whole = (mean(&found_sum) - true_sum) / standard_error(&found_sum);
        assert!(whole.abs() < 3.0, "{sampler}: the whole sphere is off by {whole} standard errors");
    }
}

/// The error bar of replicates agrees with the spread over seeds.
#[test]
fn variance_layers_are_honest() {
    let map = windows(64, 32);
    for sampler in ["{ independent: { samples_per_pixel: 64 } }", "{ sobol: { samples_per_pixel: 64, replicates: 8 } }"] {
        let text = SPHERE.replace("SAMPLER", sampler).replace("background: transparent", "background: transparent, layers: [variance]");
        let description = description(&text);
        let (mut values, mut claimed) = (Vec::new(), Vec::new());
        for seed in 0..64 {
            let surroundings = Surroundings { env: Some(&map), lights: None, seed };
            let scene = Scene::new(&description, &surroundings, &mut NoLibrary, || Ok(())).unwrap();
            let block = Block { first: 0, count: description.samples_per_replicate() };
            let request =
                Request { window: Window { x0: 7, y0: 5, x1: 8, y1: 6 }, block, replicates: description.replicates(), start: None };
            let film = picture::render(&scene, &request, || Ok::<(), Infallible>(()), |_| ()).unwrap();
            let image = film.image(&description.film);
            values.push(f64::from(image.color.pixel(0, 0)[1]));
            match &image.layers["variance"] {
                pipeline::image::raster::Layer::Color(raster) => claimed.push(f64::from(raster.pixel(0, 0)[1])),
                pipeline::image::raster::Layer::Scalar(_) => unreachable!("a variance has three channels"),
            }
        }
        // Both are estimates of one number with about 64 and 64 x 7 degrees of freedom: a factor of 2 is far beyond both.
        let ratio = mean(&claimed) / variance(&values);
        assert!((0.5..2.0).contains(&ratio), "{sampler}: {ratio}");
    }
}

/// A dim gradient and six small windows, 89 % of the light: largest over smallest luminance 1.4e5.
fn gradient_and_windows(width: usize) -> EnvMap {
    const WINDOWS: [[f64; 5]; 6] = [
        [0.10, 0.13, 0.25, 0.32, 120.0],
        [0.145, 0.175, 0.25, 0.32, 120.0],
        [0.19, 0.22, 0.25, 0.32, 120.0],
        [0.60, 0.61, 0.40, 0.45, 700.0],
        [0.70, 0.71, 0.40, 0.45, 350.0],
        [0.40, 0.42, 0.12, 0.16, 300.0],
    ];
    let height = width / 2;
    let pixel = |index: usize| {
        let [u, v] = [((index % width) as f64 + 0.5) / width as f64, ((index / width) as f64 + 0.5) / height as f64];
        let is_inside = |[left, right, top, bottom, _]: &&[f64; 5]| (*left..*right).contains(&u) && (*top..*bottom).contains(&v);
        match WINDOWS.iter().find(is_inside) {
            Some([.., radiance]) => [1.1, 1.0, 0.8].map(|channel| (channel * radiance) as f32),
            None => [0.8, 1.0, 1.3].map(|channel| (channel * (0.005 + 0.2475 * (1.0 + elementary::cos(PI * v)))) as f32),
        }
    };
    EnvMap::new(Raster::new(width, height, (0..width * height).map(pixel).collect()))
}

/// relMSE x samples at 64 samples from two seeds, over the pixels that the sphere covers.
fn noise(map: &EnvMap, integrator: &str) -> f64 {
    let text = SPHERE.replace("SAMPLER", "{ sobol: { samples_per_pixel: 64 } }").replace("[16, 16]", "[64, 64]");
    let text = text.replace("{ direct: {} }", integrator);
    let (a, b) = (pixels(&text, Some(map), 1), pixels(&text, Some(map), 2));
    let truth = supersampled(map, 64);
    let covered = (0..truth.len()).filter(|place| truth[*place].is_some());
    let terms: Vec<f64> = covered
        .flat_map(|place| {
            let (a, b) = (a[place], b[place]);
            (0..3).map(move |k| {
                let middle = 0.5 * (a[k] + b[k]);
                (a[k] - b[k]) * (a[k] - b[k]) / (2.0 * (middle * middle + 0.01))
            })
        })
        .collect();
    mean(&terms) * 64.0
}

/// By default settings; independent samples have about .75 on the first map.
#[test]
fn the_default_settings_are_quiet_under_small_windows() {
    for (name, map, bound) in [("gradient", gradient_and_windows(512), 0.01), ("noise", windows(256, 128), 0.08)] {
        let [best, single] = ["{ direct: {} }", "{ direct: { emitter_candidates: 1 } }"].map(|integrator| noise(&map, integrator));
        println!("windows over {name}: relMSE x samples at 64 is {best:.4}, {single:.4} with one candidate");
        assert!(best < bound && best < single, "{name}: {best}, {single}");
    }
}

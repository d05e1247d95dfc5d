//! The published table of errors on Grace Cathedral: every way to sample the map, and every cut.
//!
//! RMS over the pixels of a 16 x 16 picture of the white sphere, its visible side, of the error of luminance, over the mean
//! luminance. Of samplers it is the expected one, in closed form: V = sum P X² (n . d)+² / pi² - E² from the probabilities
//! of the distributions under test. Over the normals of the whole sphere, or at another size of the picture, errors are others.

use std::f64::consts::PI;
use std::num::NonZeroU32;

use glam::DVec3;
use pipeline::light::distribution::{Distribution, Intensity, Settings, Sine};
use pipeline::light::envmap::EnvMap;
use pipeline::light::lights::Light;
use pipeline::light::median_cut::{self, MedianCutError, Place, Variant, median_cut};

use crate::shared;

const SIZE: usize = 16;

/// Samples or lights.
const COUNTS: [u32; 3] = [64, 256, 1024];

/// A number as it is printed: its value, and half of its last digit.
struct Printed(&'static str);

impl Printed {
    fn agrees(&self, found: f64) -> bool {
        let digits = self.0.split_once('.').map_or(0, |(_, digits)| digits.len());
        // A hair more, where the digit that was rounded is a five.
        (found - self.0.parse::<f64>().unwrap()).abs() <= 0.51 * 0.1_f64.powi(digits as i32)
    }
}

fn luminance([r, g, b]: [f64; 3]) -> f64 {
    0.2126 * r + 0.7152 * g + 0.0722 * b
}

fn normals() -> Vec<DVec3> {
    let position = |k: usize| (2 * k + 1) as f64 / SIZE as f64 - 1.0;
    let pixels = (0..SIZE * SIZE).map(|k| (position(k % SIZE), -position(k / SIZE)));
    let covered = pixels.filter(|(x, y)| x * x + y * y < 1.0);
    covered.map(|(x, y)| DVec3::new(x, y, (1.0 - x * x - y * y).sqrt())).collect()
}

/// A way to draw pixels: the probability of one, for a normal, and of a row.
struct Sampler<'a> {
    name: &'static str,
    /// Probability of pixel (x, y) with that cosine to the normal.
    pmf: Box<dyn Fn(usize, usize, f64) -> f64 + 'a>,
    /// Whether sqrt(N) rows are drawn with as many columns in each.
    is_by_rows: bool,
    published: [Printed; 3],
}

impl<'a> Sampler<'a> {
    fn of(name: &'static str, table: &'a Distribution, is_by_rows: bool, published: [&'static str; 3]) -> Self {
        Self { name, pmf: Box::new(|x, y, _| table.pmf(x, y)), is_by_rows, published: published.map(Printed) }
    }
}

/// Variance of one sample: between rows, and within them.
#[derive(Debug, Clone, Copy, Default)]
struct Variance {
    between: f64,
    within: f64,
}

impl Variance {
    /// Of the mean of `count` samples. Cochran, "Sampling Techniques", section 10.3.
    fn of_mean(self, count: u32, is_by_rows: bool) -> f64 {
        let clusters = if is_by_rows { f64::from(count.isqrt()) } else { f64::from(count) };
        self.between / clusters + self.within / f64::from(count)
    }
}

struct Scene<'a> {
    map: &'a EnvMap,
    normals: Vec<DVec3>,
    /// Direction, and luminance times solid angle, of each pixel.
    pixels: Vec<(DVec3, f64)>,
    /// Radiance at each normal.
    truth: Vec<f64>,
}

impl<'a> Scene<'a> {
    fn new(map: &'a EnvMap) -> Self {
        let pixel = |k: usize| {
            let (x, y) = (k % map.width(), k / map.width());
            (map.direction(x, y), luminance(map.raster.pixel(x, y).map(f64::from)) * map.solid_angle(y))
        };
        let pixels: Vec<_> = (0..map.width() * map.height()).map(pixel).collect();
        let normals = normals();
        let truth = radiances(&pixels, &normals);
        Self { map, normals, pixels, truth }
    }

    fn mean(&self) -> f64 {
        self.truth.iter().sum::<f64>() / self.truth.len() as f64
    }

    fn variance(&self, sampler: &Sampler<'_>, normal: DVec3, truth: f64) -> Variance {
        let (mut squares_of_rows, mut squares) = (0.0, 0.0);
        for (y, row) in self.pixels.chunks(self.map.width()).enumerate() {
            let (mut probability, mut sum) = (0.0, 0.0);
            for (x, (direction, weight)) in row.iter().enumerate() {
                let cosine = normal.dot(*direction).max(0.0);
                let pmf = (sampler.pmf)(x, y, cosine);
                if pmf > 0.0 {
                    let term = weight * cosine / PI;
                    (probability, sum, squares) = (probability + pmf, sum + term, squares + term * term / pmf);
                }
            }
            squares_of_rows += if probability > 0.0 { sum * sum / probability } else { 0.0 };
        }
        Variance { between: squares_of_rows - truth * truth, within: squares - squares_of_rows }
    }

    /// The root of the mean variance of `count` samples, over the mean.
    fn errors(&self, sampler: &Sampler<'_>) -> [f64; 3] {
        let variances = self.normals.iter().zip(&self.truth).map(|(normal, truth)| self.variance(sampler, *normal, *truth));
        let variances: Vec<Variance> = variances.collect();
        COUNTS.map(|count| {
            let sum: f64 = variances.iter().map(|variance| variance.of_mean(count, sampler.is_by_rows)).sum();
            (sum / variances.len() as f64).sqrt() / self.mean()
        })
    }

    fn error_of_lights(&self, lights: &[(DVec3, f64)]) -> f64 {
        let found = radiances(lights, &self.normals);
        let squares: f64 = found.iter().zip(&self.truth).map(|(found, truth)| (found - truth) * (found - truth)).sum();
        (squares / self.truth.len() as f64).sqrt() / self.mean()
    }
}

fn radiances(lights: &[(DVec3, f64)], normals: &[DVec3]) -> Vec<f64> {
    let radiance = |normal: &DVec3| lights.iter().map(|(direction, weight)| normal.dot(*direction).max(0.0) * weight).sum::<f64>() / PI;
    normals.iter().map(radiance).collect()
}

/// What of found and published errors differs, in words.
fn differences(name: &str, found: [f64; 3], published: &[Printed; 3]) -> Vec<String> {
    println!("{name}: {found:.5?}");
    let pairs = found.into_iter().zip(published).filter(|(found, printed)| !printed.agrees(*found));
    pairs.map(|(found, printed)| format!("{name}: {found} instead of {}", printed.0)).collect()
}

#[test]
fn samplers_err_on_grace_as_published() {
    let Some(map) = shared::map("grace_latlong.pfm") else { return };
    let scene = Scene::new(&map);
    let build = |settings| Distribution::build(&map, &settings, || Ok::<(), std::convert::Infallible>(())).unwrap();
    let plain = Settings { intensity: Intensity::Mean, ..Settings::default() };
    let (importance, clamped) = (build(plain), build(Settings { clamp: Some(1.0), ..plain }));
    let sineless = build(Settings { sine: Sine::None, ..plain });
    let solid_angle = |y| map.solid_angle(y);
    let samplers = [
        Sampler {
            name: "uniform",
            pmf: Box::new(|_, y, _| solid_angle(y) / (4.0 * PI)),
            is_by_rows: false,
            published: ["1.11", ".555", ".278"].map(Printed),
        },
        Sampler {
            name: "cosine",
            pmf: Box::new(|_, y, cosine| cosine / PI * solid_angle(y)),
            is_by_rows: false,
            published: [".687", ".344", ".172"].map(Printed),
        },
        Sampler::of("importance", &importance, false, [".134", ".067", ".0335"]),
        Sampler::of("rows, then columns", &importance, true, [".288", ".198", ".138"]),
        Sampler::of("importance of the clamped map", &clamped, false, [".388", ".194", ".097"]),
        Sampler::of("importance without the sine", &sineless, false, [".160", ".080", ".040"]),
    ];
    let wrong: Vec<String> =
        samplers.iter().flat_map(|sampler| differences(sampler.name, scene.errors(sampler), &sampler.published)).collect();
    assert!(wrong.is_empty(), "{wrong:#?}");
}

/// The direction of a light as it is.
fn own_direction(_: &EnvMap, light: &Light) -> DVec3 {
    light.direction
}

/// That of the pixel after the medians: the published table has the second report's lights in pixels, ours lie on the edges
/// at which halves are cut.
fn direction_of_pixel(map: &EnvMap, light: &Light) -> DVec3 {
    map.direction(light.x as usize, light.y as usize)
}

type DirectionOf = fn(&EnvMap, &Light) -> DVec3;

#[test]
fn few_lights_err_on_grace_as_published() {
    let Some(map) = shared::map("grace_latlong.pfm") else { return };
    let scene = Scene::new(&map);
    let cuts: [(_, _, _, DirectionOf, _); 4] = [
        ("median cut, centroid", Variant::Debevec, Place::Centroid, own_direction, [".0092", ".0021", ".0007"]),
        ("median cut, center", Variant::Debevec, Place::Center, own_direction, [".050", ".016", ".004"]),
        ("the second report's medians", Variant::Coursework2021, Place::Median, direction_of_pixel, [".0127", ".0057", ".0032"]),
        ("variance cut", Variant::Variance, Place::Centroid, own_direction, [".0045", ".0013", ".0003"]),
    ];
    let mut wrong = Vec::new();
    for (name, variant, place, direction, published) in cuts {
        let errors = COUNTS.map(|count| {
            let settings = median_cut::Settings { place, ..median_cut::Settings::of(variant, NonZeroU32::new(count).unwrap()) };
            let set = median_cut(&map, &settings, || Ok::<(), MedianCutError>(())).unwrap();
            let lit = |light: &Light| (direction(&map, light), luminance(light.irradiance));
            scene.error_of_lights(&set.lights.iter().map(lit).collect::<Vec<_>>())
        });
        wrong.extend(differences(name, errors, &published.map(Printed)));
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

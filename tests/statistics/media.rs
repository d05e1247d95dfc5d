//! Media: light that passes, light that is scattered once, light that is scattered without end, each against a closed form,
//! and every way to follow a medium against the others.
//!
//! Means over 16 seeds; each test splits the level .001 over its comparisons (Šidák) on Student's t.

use pipeline::image::raster::Raster;
use pipeline::light::envmap::EnvMap;
use pipeline::math::elementary::exp;
use pipeline::math::statistics::{mean, sidak_level, standard_error};

use crate::render::{MANY, SEEDS, assert_same_means, by_seed, p_value, pixels, still, windows};

fn white() -> EnvMap {
    EnvMap::new(Raster::new(8, 4, vec![[1.0; 3]; 32]))
}

/// A narrow view along -z from [0, 0, 5].
fn narrow(integrator: &str, rest: &str) -> String {
    format!(
        "
camera: {{ orthographic: {{ origin: [0, 0, 5], target: [0, 0, 0], width: 0.02 }} }}
film: {{ resolution: [2, 2] }}
sampler: {{ independent: {{ samples_per_pixel: 256 }} }}
integrator: {{ volume-path: {{ {integrator} }} }}
{rest}"
    )
}

/// The mean over the picture, by seed, of one channel.
fn means(text: &str, env: Option<&EnvMap>, channel: usize) -> Vec<f64> {
    let of_seed = |seed| {
        let pixels = pixels(text, env, seed + 1);
        pixels.iter().map(|pixel| pixel[channel]).sum::<f64>() / pixels.len() as f64
    };
    (0..SEEDS).map(of_seed).collect()
}

/// Whether the means of all seeds agree with what must come out.
#[track_caller]
fn assert_mean(name: &str, values: &[f64], expected: f64, comparisons: u32) {
    let (found, error) = (mean(values), standard_error(values));
    if error < 1e-6 * expected {
        assert!((found - expected).abs() < 1e-4 * expected, "{name}: {found} for {expected}");
        return;
    }
    let p = p_value((found - expected) / error, values.len() as f64 - 1.0);
    assert!(p > sidak_level(1e-3, comparisons), "{name}: {found} for {expected}, +- {error}");
}

const TRACKINGS: [&str; 2] = ["closed-form", "delta"];

#[test]
fn without_media_it_is_the_path_tracer_bit_for_bit() {
    let map = windows(64, 32);
    for rest in ["max_depth: 4", "strategy: bsdf, roulette_depth: 0", "strategy: emitter, environment: uniform", "max_depth: 0"] {
        let of = |kind: &str, text: &str| pixels(&text.replace("KIND", &format!("{{ {kind}: {{ {rest} }} }}")), Some(&map), 3);
        let text = still("{ sobol: { samples_per_pixel: 64 } }", "KIND");
        let expected = of("path", &text);
        assert_eq!(of("volume-path", &text), expected, "{rest}");
        // A vacuum is no medium either, not even where its boundary lies in the floor.
        for bottom in [-2.0, -0.6] {
            let vacuum = format!("{{ box: {{ min: [-4, {bottom}, -4], max: [4, 4, 6] }}, medium: {{ homogeneous: {{ sigma_t: 0 }} }} }}");
            let boxed = text.replace("shapes:", &format!("shapes:\n  - {vacuum}"));
            assert_eq!(of("volume-path", &boxed), expected, "{rest}, in a box of nothing from {bottom}");
        }
    }
}

/// Absorbing alone, a medium lets e^-tau of the light behind it through.
#[test]
fn absorbed_light_follows_the_closed_form() {
    let cases = [
        ("{ homogeneous: { sigma_t: 0.7, albedo: 0 } }", "", 2.0 * 0.7),
        // Level rays at height 1.25 over the floor, all through a box two deep.
        ("{ exponential: { sigma_t: 3, albedo: 0, floor_density: 0.8, falloff: 0.9 } }", "", 2.0 * 3.0 * 0.8 * exp(-0.9 * 1.25)),
        // Height along the view: the integral of e^(-b h) over two.
        ("{ exponential: { sigma_t: 3, albedo: 0, floor_density: 0.5, falloff: 1.5, up: [0, 0, 1] } }", "", 1.5 * (1.0 - exp(-3.0)) / 1.5),
        ("{ exponential: { sigma_t: 3, albedo: 0, floor_density: 0.5, falloff: 1.5, up: [0, 0, -1] } }", "", 1.5 * (1.0 - exp(-3.0)) / 1.5),
        // Two layers, linear between the centers: their mean.
        ("{ grid: { sigma_t: 2, albedo: 0, values: [[[0.2]], [[0.9]]] } }", "", 2.0 * 2.0 * 0.55),
        // The later one counts where they overlap: half the way each.
        (
            "{ homogeneous: { sigma_t: 0.3, albedo: 0 } }",
            "  - { sphere: { radius: 0.5 }, medium: { homogeneous: { sigma_t: 2, albedo: 0 } } }",
            0.3 + 2.0,
        ),
    ];
    for (medium, more, optical_depth) in cases {
        for tracking in TRACKINGS {
            let shapes = format!("shapes:\n  - {{ box: {{ min: [-1, -1.25, -1], max: [1, 1, 1] }}, medium: {medium} }}\n{more}");
            let found = means(&narrow(&format!("tracking: {tracking}"), &shapes), Some(&white()), 1);
            assert_mean(&format!("{medium} {tracking}"), &found, exp(-optical_depth), 12);
        }
    }
}

/// Light from behind the camera, scattered once back to it: rho p(-1) E ∫ sigma e^(-2 sigma t) dt.
#[test]
fn light_scattered_once_follows_the_closed_form() {
    for g in [0.0, 0.6, -0.3] {
        for tracking in TRACKINGS {
            let (sigma, albedo, irradiance, length) = (0.8, 0.5, 3.0, 2.0);
            let text = format!(
                "
shapes: [{{ box: {{}}, medium: {{ homogeneous: {{ sigma_t: {sigma}, albedo: {albedo}, phase: {{ henyey-greenstein: {{ g: {g} }} }} }} }} }}]
emitters: [{{ directional: {{ towards: [0, 0, 1], irradiance: {irradiance} }} }}]"
            );
            let found = means(&narrow(&format!("max_depth: 1, tracking: {tracking}"), &text), None, 0);
            let phase = (1.0 - g * g) / (4.0 * std::f64::consts::PI * (1.0 + g) * (1.0 + g) * (1.0 + g));
            let expected = albedo * phase * irradiance * (1.0 - exp(-2.0 * sigma * length)) / 2.0;
            assert_mean(&format!("g = {g}, {tracking}"), &found, expected, 6);
        }
    }
}

/// Every direction brings 1 and nothing is absorbed: no medium can be seen, whatever its shape, density and phase.
#[test]
fn a_white_medium_in_a_white_room_cannot_be_seen() {
    let shapes = [
        "box: {}, medium: { homogeneous: { sigma_t: 2 } }",
        "sphere: {}, medium: { homogeneous: { sigma_t: 3, phase: { henyey-greenstein: { g: 0.8 } } } }",
        "box: {}, medium: { exponential: { sigma_t: 4, falloff: 2, phase: { henyey-greenstein: { g: -0.4 } } } }",
        "box: {}, transform: [{ rotate: { axis: [1, 2, 0], degrees: 40 } }], medium: { grid: { sigma_t: 5, values: [[[0, 1], [0.5, 0.1]]] } }",
        "torus: {}, transform: [{ rotate: { axis: [1, 0, 0], degrees: 90 } }, { translate: [-0.8, 0, 0] }], medium: { homogeneous: { sigma_t: 3 } }",
        "sphere: {}, bsdf: { dielectric: {} }, medium: { homogeneous: { sigma_t: 1 } }",
    ];
    for shape in shapes {
        for tracking in TRACKINGS {
            for strategy in ["mis", "bsdf"] {
                let text =
                    format!("shapes:\n  - {{ {shape} }}\n  - {{ sphere: {{ radius: 0.2 }}, bsdf: {{ diffuse: {{ reflectance: 1 }} }} }}");
                let settings = format!("max_depth: 2000, roulette_depth: 20, strategy: {strategy}, tracking: {tracking}");
                let found = means(&narrow(&settings, &text), Some(&white()), 2);
                assert_mean(&format!("{shape} {tracking} {strategy}"), &found, 1.0, 24);
            }
        }
    }
}

/// Lamps in and beyond fog, things in it, and glass with something inside.
const FOGGY: &str = "
camera: { perspective: { origin: [0, 1, 5], fov_degrees: 50 } }
film: { resolution: [6, 4] }
sampler: SAMPLER
integrator: INTEGRATOR
shapes:
  - { box: { min: [-3, -0.7, -3], max: [3, 2, 3] }, medium: { exponential: { sigma_t: 0.6, albedo: [0.9, 0.7, 0.5], falloff: 0.8, phase: { henyey-greenstein: { g: 0.4 } } } } }
  - { sphere: { center: [-0.9, 0.2, 0], radius: 0.6 }, medium: { grid: { sigma_t: 4, albedo: 0.9, values: [[[0, 0.5], [1, 0.2]], [[0.7, 0.1], [0.4, 1]]] } } }
  - { sphere: { center: [0.6, 0, 0.6], radius: 0.5 }, bsdf: { dielectric: {} }, medium: { homogeneous: { sigma_t: 2, albedo: [0.2, 0.9, 0.5] } } }
  - { rectangle: {}, transform: [{ rotate: { axis: [1, 0, 0], degrees: -90 } }, { scale: 3 }, { translate: [0, -0.6, 0] }] }
  - { disk: {}, transform: [{ rotate: { axis: [1, 0, 0], degrees: 90 } }, { translate: [0, 3, 0] }], emitter: { area: { radiance: [6, 5, 4] } } }
  - { sphere: { center: [1.6, 1.1, -0.5], radius: 0.3 }, emitter: { area: { radiance: 9 } } }
emitters:
  - { point: { position: [2, 1, 2], intensity: 3 } }
  - { directional: { towards: [1, 2, 1], irradiance: 0.7 } }
";

fn foggy(sampler: &str, rest: &str) -> String {
    FOGGY.replace("SAMPLER", sampler).replace("INTEGRATOR", &format!("{{ volume-path: {{ {rest} }} }}"))
}

#[test]
fn every_way_to_follow_a_medium_finds_the_same_light() {
    let map = windows(64, 32);
    let of = |rest: &str| by_seed(&foggy(MANY, &format!("max_depth: 4, {rest}")), Some(&map));
    let reference = of("mis_compensation: false, emitter_candidates: 1");
    let others = [
        "tracking: delta",
        "strategy: emitter",
        "strategy: bsdf",
        "strategy: bsdf, tracking: delta",
        "mis_compensation: true",
        "emitter_candidates: 5",
        "roulette_depth: 0",
    ];
    for other in others {
        assert_same_means(other, &of(other), &reference, 8);
    }
    let sobol = by_seed(&foggy("{ sobol: { samples_per_pixel: 64 } }", "max_depth: 4"), Some(&map));
    assert_same_means("sobol", &sobol, &reference, 8);
}

/// The control: the fourth report's tracking is darker where the density is below one, and this must show.
#[test]
fn the_bias_of_squared_density_is_noticed() {
    let of = |tracking: &str| by_seed(&foggy(MANY, &format!("max_depth: 4, tracking: {tracking}")), None);
    let result = std::panic::catch_unwind(|| assert_same_means("squared", &of("squared-density"), &of("delta"), 1));
    assert!(result.is_err());
}

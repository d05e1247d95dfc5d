//! Laws that every medium must obey under every tracking.
//!
//! Rows are scene text, so a new kind is one row here. Each test has the level .001, split over its comparisons (Šidák).

use std::f64::consts::SQRT_2;
use std::sync::Arc;

use glam::{DAffine3, DVec3, Vec3};

use super::*;
use crate::math::statistics::{chi_square_test, mean, sidak_level, standard_error, student_t_cdf};
use crate::render::sampler::{Numbers, SamplerDescription};

/// One of each kind, and what makes the integral of its density hard.
const MEDIA: [&str; 6] = [
    "{ homogeneous: { sigma_t: 1.5, albedo: [0.9, 0.5, 0.2] } }",
    "{ exponential: { sigma_t: 3, albedo: 0.8, floor_density: 0.9, falloff: 2 } }",
    "{ exponential: { sigma_t: 2, floor_density: 1, falloff: 0 } }",
    "{ exponential: { sigma_t: 4, floor_density: 0.7, falloff: 1, up: [1, 1, 0] } }",
    "{ grid: { sigma_t: 4, albedo: 0.5, values: [[[0, 1], [0.5, 0.2]], [[0.3, 0.6], [0.9, 0]]] } }",
    "{ grid: { sigma_t: 1, values: [[[1]]] } }",
];

const TRACKINGS: [Tracking; 3] = [Tracking::ClosedForm, Tracking::Delta, Tracking::SquaredDensity];

const PLACE: Place =
    Place { bounds: Bounds { min: Vec3::new(-1.0, -1.0, -1.0), max: Vec3::new(1.0, 1.0, 1.0) }, to_world: DAffine3::IDENTITY };

fn medium(text: &str) -> Medium {
    let text = serde_yaml::Deserializer::from_str(text);
    let description: MediumDescription = serde_yaml::with::singleton_map_recursive::deserialize(text).unwrap();
    Medium::new(&description, &PLACE, None).unwrap()
}

/// Through the middle, along the floor, upwards and slanted; with the stretch that lies in the cube.
fn ways() -> [(Ray, Stretch); 4] {
    let slanted = Vec3::new(1.0, 1.0, 0.0).normalize();
    [
        (Ray::new(Vec3::new(-2.0, 0.1, 0.3), Vec3::X), [1.0, 3.0]),
        (Ray::new(Vec3::new(0.2, -0.99, -1.0), Vec3::Z), [0.0, 2.0]),
        (Ray::new(Vec3::new(0.5, 3.0, -0.2), Vec3::NEG_Y), [2.0, 4.0]),
        (Ray::new(Vec3::new(-1.0, -1.0, 0.5), slanted), [0.0, 2.0 * SQRT_2]),
    ]
}

/// ∫ sigma_t times density by the midpoint rule, up to each of `count` equal parts of the stretch.
fn optical_depths(medium: &Medium, ray: &Ray, [start, end]: Stretch, count: usize) -> Vec<f64> {
    const PARTS: usize = 4000;
    let step = (end - start) / (count * PARTS) as f64;
    let mut sum = 0.0;
    let part = |part: usize| {
        let at = |k: usize| medium.density(ray, start + (part * PARTS + k) as f64 * step + 0.5 * step);
        sum += medium.sigma_t * step * (0..PARTS).map(at).sum::<f64>();
        sum
    };
    (0..count).map(part).collect()
}

fn with_numbers<A>(work: impl Fn(&Numbers<'_>, u32) -> A, count: u32) -> Vec<A> {
    let sampler = SamplerDescription::default().compiled(11, count).pixel(3, 4, 0);
    (0..count).map(|index| work(&sampler.sample(index), index)).collect()
}

#[test]
fn closed_forms_are_the_integral_of_the_density() {
    for text in MEDIA {
        let medium = medium(text);
        for (ray, stretch) in ways() {
            let Some(found) = medium.optical_depth(&ray, stretch) else { continue };
            let expected = optical_depths(&medium, &ray, stretch, 1)[0];
            assert!((found - expected).abs() < 1e-6 * expected.max(1e-3), "{text}: {found} {expected}");
        }
    }
}

#[test]
fn as_much_light_passes_as_the_optical_depth_says() {
    const COUNT: u32 = 20_000;
    let level = sidak_level(1e-3, (2 * MEDIA.len() * TRACKINGS.len() * ways().len()) as u32);
    for text in MEDIA {
        let medium = medium(text);
        for tracking in TRACKINGS {
            for (ray, stretch) in ways() {
                let expected = elementary::exp(-optical_depths(&medium, &ray, stretch, 1)[0]);
                let shares = with_numbers(|numbers, _| medium.transmittance(&ray, stretch, tracking, &mut numbers.further(1)), COUNT);
                assert!(shares.iter().all(|share| (0.0..=1.0).contains(share)));
                let passed = with_numbers(
                    |numbers, _| {
                        let mut further = numbers.further(2);
                        let left = exponential_variate(further.uniform());
                        f64::from(u8::from(matches!(medium.fly(&ray, stretch, left, tracking, &mut further), Flight::Passed { .. })))
                    },
                    COUNT,
                );
                for values in [shares, passed] {
                    let (found, error) = (mean(&values), standard_error(&values));
                    let p = 2.0 * (1.0 - student_t_cdf(((found - expected) / error).abs(), f64::from(COUNT - 1)));
                    let is_exact = error < 1e-12 && (found - expected).abs() < 1e-6;
                    assert!(is_exact || p > level, "{text} {tracking:?} {ray:?}: {found} for {expected}, +- {error}");
                }
            }
        }
    }
}

/// The distances of collisions have the density sigma_t rho e^-tau, and their mean is the free path.
#[test]
fn collisions_lie_where_the_density_says() {
    const COUNT: u32 = 20_000;
    const CELLS: usize = 20;
    let level = sidak_level(1e-3, (MEDIA.len() * 2 * ways().len()) as u32);
    for text in MEDIA {
        let medium = medium(text);
        for tracking in [Tracking::ClosedForm, Tracking::Delta] {
            for (ray, stretch) in ways() {
                let mut found = vec![0_u64; CELLS + 1];
                for flight in with_numbers(
                    |numbers, _| {
                        let mut further = numbers.further(3);
                        let left = exponential_variate(further.uniform());
                        medium.fly(&ray, stretch, left, tracking, &mut further)
                    },
                    COUNT,
                ) {
                    match flight {
                        Flight::Passed { left } => {
                            assert!(left >= 0.0);
                            found[CELLS] += 1;
                        }
                        Flight::Collided { distance, weight } => {
                            assert_eq!(weight, medium.albedo);
                            let share = (distance - stretch[0]) / (stretch[1] - stretch[0]);
                            found[((share * CELLS as f64) as usize).min(CELLS - 1)] += 1;
                        }
                    }
                }
                let passing: Vec<f64> =
                    optical_depths(&medium, &ray, stretch, CELLS).into_iter().map(|depth| elementary::exp(-depth)).collect();
                let before = std::iter::once(1.0).chain(passing.iter().copied());
                let mut expected: Vec<f64> = before.zip(&passing).map(|(before, after)| f64::from(COUNT) * (before - after)).collect();
                expected.push(f64::from(COUNT) * passing[CELLS - 1]);
                let test = chi_square_test(&found, &expected);
                assert!(test.p_value > level, "{text} {tracking:?} {ray:?}: {test:?}");
            }
        }
    }
}

#[test]
fn the_mean_free_path_is_one_over_sigma_t() {
    let medium = medium(MEDIA[0]);
    let (ray, stretch) = (Ray::new(Vec3::ZERO, Vec3::X), [0.0, 1e3]);
    for tracking in TRACKINGS {
        let distances = with_numbers(
            |numbers, _| {
                let mut further = numbers.further(4);
                let left = exponential_variate(further.uniform());
                match medium.fly(&ray, stretch, left, tracking, &mut further) {
                    Flight::Collided { distance, .. } => distance,
                    Flight::Passed { .. } => unreachable!("1500 free paths"),
                }
            },
            20_000,
        );
        let z = (mean(&distances) - 1.0 / 1.5) / standard_error(&distances);
        assert!(z.abs() < 4.0, "{tracking:?}: {z} standard errors");
    }
}

/// A stretch cut in two is as good as a whole one: what is left of the optical depth is carried over.
#[test]
fn a_flight_goes_on_where_it_was_left() {
    for text in &MEDIA[..4] {
        let medium = medium(text);
        for (ray, stretch) in ways() {
            let middle = stretch[0] + 0.4 * (stretch[1] - stretch[0]);
            for left in [0.01, 0.3, 0.8, 2.0, 9.0] {
                let fly = |stretch, left| {
                    let sampler = SamplerDescription::default().compiled(1, 1).pixel(0, 0, 0);
                    medium.fly(&ray, stretch, left, Tracking::ClosedForm, &mut sampler.sample(0).further(0))
                };
                let whole = fly(stretch, left);
                let parts = match fly([stretch[0], middle], left) {
                    Flight::Passed { left } => fly([middle, stretch[1]], left),
                    collided => collided,
                };
                match (whole, parts) {
                    (Flight::Passed { left: a }, Flight::Passed { left: b }) => assert!((a - b).abs() < 1e-9, "{a} {b}"),
                    (Flight::Collided { distance: a, .. }, Flight::Collided { distance: b, .. }) => {
                        assert!((a - b).abs() < 1e-6 * a.max(1.0), "{text} {left}: {a} {b}")
                    }
                    other => panic!("{text} {left}: {other:?}"),
                }
            }
        }
    }
}

#[test]
fn squared_density_is_the_others_where_the_density_is_one_and_darker_elsewhere() {
    let weights = |medium: &Medium, tracking| {
        let (ray, stretch) = ways()[0];
        let flights = with_numbers(
            |numbers, _| match medium.fly(&ray, stretch, 0.1, tracking, &mut numbers.further(5)) {
                Flight::Collided { weight, .. } => f64::from(weight.x / medium.albedo.x),
                Flight::Passed { .. } => 1.0,
            },
            1000,
        );
        mean(&flights)
    };
    assert_eq!(weights(&medium(MEDIA[5]), Tracking::SquaredDensity), 1.0);
    assert!(weights(&medium(MEDIA[1]), Tracking::SquaredDensity) < 0.9);
    assert_eq!(weights(&medium(MEDIA[1]), Tracking::Delta), 1.0);
}

#[test]
fn what_a_tracking_cannot_do_is_refused() {
    let thick = |text: &str, tracking| medium(text).checked(&PLACE, tracking).err().map(|error| error.to_string());
    assert_eq!(thick("{ homogeneous: { sigma_t: 1e6 } }", Tracking::ClosedForm), None);
    assert!(thick("{ homogeneous: { sigma_t: 1e6 } }", Tracking::Delta).unwrap().contains("sigma_t"));
    let dense = "{ exponential: { floor_density: 2 } }";
    assert_eq!(thick(dense, Tracking::Delta), None);
    assert!(thick(dense, Tracking::SquaredDensity).unwrap().contains("from 0 to 1"));
    assert!(thick(MEDIA[1], Tracking::SquaredDensity).is_none());
}

#[test]
fn a_grid_stands_in_the_place_of_its_shape() {
    let half_turn = DAffine3::from_rotation_z(std::f64::consts::PI) * DAffine3::from_scale(DVec3::splat(2.0));
    let voxels = Arc::new(Voxels::new([2, 1, 1], vec![0.25, 1.0]).unwrap());
    let grid = Grid::new(voxels, &Place { to_world: half_turn, ..PLACE });
    let at = |x: f32| grid.at(&Ray::new(Vec3::new(x, 0.0, 0.0), Vec3::Y), 0.0);
    assert!((at(-1.5) - 1.0).abs() < 1e-6 && (at(1.5) - 0.25).abs() < 1e-6);
}

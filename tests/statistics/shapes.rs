//! Points drawn from shapes that give light, against the density that the renderer weighs them by.
//!
//! Directions from a reference point fall into the cells of a grid; what a cell should hold is found by rays through it,
//! counting everything that a ray meets, hidden or not.

use std::f64::consts::PI;
use std::sync::Arc;

use glam::{DAffine3, DMat3, DVec3, Vec3};
use pipeline::math::stream::{Purpose, Stream};
use pipeline::render::mesh::Mesh;
use pipeline::render::ray::Ray;
use pipeline::render::shape::geometry::{Geometry, Placed};
use pipeline::render::shape::{Form, Shape, ShapeError};

const COLUMNS: usize = 40;
const ROWS: usize = 20;
/// Rays a side of each cell.
const FINE: usize = 40;
const DRAWS: u64 = 40_000;

const SHAPES: [&str; 7] = [
    r#"{ "sphere": {} }"#,
    r#"{ "rectangle": {} }"#,
    r#"{ "disk": { "radius": 1.3 } }"#,
    r#"{ "box": { "min": [-1, -0.5, -0.2], "max": [1, 0.7, 0.4] } }"#,
    r#"{ "icosphere": { "subdivisions": 1 } }"#,
    r#"{ "torus": { "columns": 16, "rows": 8, "tube_radius": 0.3 } }"#,
    r#"{ "uv-sphere": { "columns": 8, "rows": 5 } }"#,
];

fn geometry(shape: &str, to_world: DAffine3) -> Geometry {
    let shape: Shape = serde_json::from_str(shape).unwrap();
    let form: Form = shape.form(|_| -> Result<Arc<Mesh>, ShapeError> { unreachable!("no file is named") }).unwrap();
    Geometry::build(&[Placed { form, to_world, is_emitter: true }], || Ok::<(), ShapeError>(())).unwrap()
}

fn transforms() -> [DAffine3; 2] {
    let turned = DAffine3::from_axis_angle(DVec3::new(1.0, 2.0, -1.0).normalize(), 0.9);
    let skewed = DMat3::from_cols(DVec3::new(1.2, 0.2, 0.0), DVec3::new(-0.3, 0.7, 0.1), DVec3::new(0.0, 0.4, 1.5));
    [turned * DAffine3::from_scale(DVec3::splat(0.8)), DAffine3 { matrix3: skewed, translation: DVec3::ZERO } * turned]
}

fn direction(u: f64, v: f64) -> Vec3 {
    let (phi, z) = (2.0 * PI * u, 1.0 - 2.0 * v);
    let radius = (1.0 - z * z).sqrt();
    // Places on a grid need no more than the system's functions.
    #[allow(clippy::disallowed_methods)]
    DVec3::new(radius * phi.cos(), radius * phi.sin(), z).as_vec3()
}

fn cell(direction: Vec3) -> usize {
    let d = direction.as_dvec3();
    #[allow(clippy::disallowed_methods)]
    let u = (d.y.atan2(d.x) / (2.0 * PI)).rem_euclid(1.0);
    let v = ((1.0 - d.z) / 2.0).clamp(0.0, 1.0);
    let (column, row) = ((u * COLUMNS as f64) as usize, (v * ROWS as f64) as usize);
    row.min(ROWS - 1) * COLUMNS + column.min(COLUMNS - 1)
}

/// How many surfaces that may be drawn a ray meets: density times this is what is integrated over the solid angle.
fn crossings(geometry: &Geometry, reference: Vec3, direction: Vec3) -> f64 {
    let (mut ray, mut count) = (Ray::new(reference, direction), 0.0);
    while let Some(hit) = geometry.intersect(&ray) {
        let surface = geometry.surface(&ray, &hit);
        count += 1.0;
        ray = surface.spawn(direction);
        // From outside a sphere gives only its near side.
        if is_cone(geometry, reference, &surface) {
            break;
        }
    }
    count
}

/// Whether the density is one per direction, equal for near and far side.
fn is_cone(geometry: &Geometry, reference: Vec3, surface: &pipeline::render::ray::Surface) -> bool {
    let opposite = Ray::new(surface.position + surface.normal, -surface.normal);
    let there = geometry.intersect(&opposite).map(|hit| geometry.surface(&opposite, &hit));
    let own = geometry.pdf(reference, surface);
    let tilted = pipeline::render::ray::Surface { normal: surface.frame.tangent, ..*surface };
    there.is_some() && geometry.pdf(reference, &tilted) == own
}

/// The greatest deviation among all cells, in standard errors.
///
/// Points weighted by one over their density must add up to the solid angle that the surfaces take in each cell. (The
/// density itself has a pole where a surface is seen from its edge; its inverse has none.)
fn deviation(shape: &str, to_world: DAffine3, is_spoiled: bool) -> f64 {
    let geometry = geometry(shape, to_world);
    let reference = Vec3::new(1.7, 1.1, 2.0);
    // Number, sum and sum of squares of the weights.
    let mut drawn = vec![(0_u64, 0.0, 0.0); COLUMNS * ROWS];
    let stream = Stream::new(3, Purpose::Test);
    for index in 0..DRAWS {
        let u = stream.generator(index).uniform_pair().map(|u| (u as f32).min(1.0 - f32::EPSILON));
        let u = if is_spoiled { [u[0] * u[0], u[1]] } else { u };
        if let Some(sample) = geometry.sample(0, reference, u) {
            let (count, sum, squares) = &mut drawn[cell((sample.position - reference).normalize())];
            let weight = 1.0 / f64::from(sample.pdf);
            (*count, *sum, *squares) = (*count + 1, *sum + weight, *squares + weight * weight);
        }
    }
    let side = |k: usize, count: usize| (k as f64 + 0.5) / (count * FINE) as f64;
    let cell_angle = 4.0 * PI / (COLUMNS * ROWS) as f64;
    let mut seen = vec![0.0; COLUMNS * ROWS];
    for row in 0..ROWS * FINE {
        for column in 0..COLUMNS * FINE {
            let count = crossings(&geometry, reference, direction(side(column, COLUMNS), side(row, ROWS)));
            seen[row / FINE * COLUMNS + column / FINE] += count * cell_angle / (FINE * FINE) as f64;
        }
    }
    let draws = DRAWS as f64;
    let filled = drawn.iter().zip(&seen).filter(|((count, ..), _)| *count >= 100);
    let deviations = filled.map(|((_, sum, squares), seen)| {
        let mean = sum / draws;
        let error = ((squares / draws - mean * mean) / draws).sqrt();
        // The grid of rays finds the part of a cell that a rim cuts to a hundredth.
        ((mean - seen).abs() - 0.01 * cell_angle).max(0.0) / error
    });
    deviations.fold(0.0, f64::max)
}

/// Some 40 cells in each of 14 tests: five and a half standard errors are beyond the level .001.
#[test]
fn points_are_drawn_by_their_density() {
    for shape in SHAPES {
        for (index, to_world) in transforms().into_iter().enumerate() {
            let deviation = deviation(shape, to_world, false);
            assert!(deviation < 5.5, "{shape}, transform {index}: {deviation}");
        }
    }
}

#[test]
fn points_drawn_otherwise_are_refused() {
    for shape in ["{ \"sphere\": {} }", "{ \"rectangle\": {} }", "{ \"torus\": { \"columns\": 16, \"rows\": 8, \"tube_radius\": 0.3 } }"] {
        let deviation = deviation(shape, transforms()[0], true);
        assert!(deviation > 8.0, "{shape}: {deviation}");
    }
}

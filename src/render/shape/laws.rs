//! Laws that every row of the table of shapes keeps, under every sort of transform.

use std::convert::Infallible;
use std::sync::Arc;

use glam::{DAffine3, DVec3, Vec3};

use crate::math::sphere;
use crate::math::stream::{Generator, Purpose, Stream};
use crate::render::mesh::{Arrays, Mesh};
use crate::render::ray::{Hit, Ray, Surface};
use crate::render::shape::geometry::{Geometry, Placed};
use crate::render::shape::unit::Unit;
use crate::render::shape::{Form, Shape, ShapeError};
use crate::render::transform::{self, Step};

#[derive(Debug)]
struct Never;

impl From<ShapeError> for Never {
    fn from(error: ShapeError) -> Self {
        panic!("{error}")
    }
}

impl From<Infallible> for Never {
    fn from(error: Infallible) -> Self {
        match error {}
    }
}

fn built(placed: &[Placed]) -> Geometry {
    Geometry::build(placed, || Ok::<(), Never>(())).unwrap()
}

/// YAML by way of JSON's data model, in which an enum is a map of one key, as in a scene.
fn read<T: serde::de::DeserializeOwned>(text: &str) -> T {
    serde_json::from_value(serde_yaml::from_str(text).unwrap()).unwrap()
}

fn form(text: &str) -> Form {
    read::<Shape>(text).form(|_| -> Result<Arc<Mesh>, Never> { panic!("no file is named") }).unwrap()
}

fn affine(text: &str) -> DAffine3 {
    transform::affine(&read::<Vec<Step>>(text)).unwrap()
}

/// One of each kind that needs no file, small enough to be looked at triangle by triangle.
const SHAPES: [&str; 11] = [
    "sphere: {}",
    "sphere: { center: [0.3, -0.2, 0.1], radius: 0.7 }",
    "rectangle: {}",
    "disk: { radius: 0.8 }",
    "box: {}",
    "box: { min: [-0.5, -1, -0.2], max: [0.7, 0.3, 1] }",
    "icosphere: { subdivisions: 3 }",
    "uv-sphere: { columns: 24, rows: 12, relief: { amplitude: 0.3 } }",
    "torus: { columns: 32, rows: 16, radius: 0.8, tube_radius: 0.3 }",
    "knot: { columns: 96, rows: 12 }",
    "blob: { subdivisions: 3 }",
];

const TRANSFORMS: [&str; 6] = [
    "[]",
    "[{ scale: 0.3 }, { rotate: { axis: [1, 2, 3], degrees: 77 } }, { translate: [3, -2, 1] }]",
    "[{ scale: [0.5, 2, 1.3] }, { rotate: { axis: [0, 1, -1], degrees: 130 } }]",
    "[{ scale: [1, -1, 1] }, { translate: [0, 0.5, 0] }]",
    "[{ matrix: [[1, 0.4, 0, 1], [0, 1, -0.3, 0], [0.2, 0, 0.8, -1], [0, 0, 0, 1]] }]",
    "[{ scale: 50 }, { translate: [10000, 10000, -10000] }]",
];

/// Every shape under every transform.
fn cases() -> impl Iterator<Item = (String, Placed)> {
    SHAPES.into_iter().flat_map(|shape| {
        let form = form(shape);
        TRANSFORMS
            .into_iter()
            .map(move |steps| (format!("{shape} {steps}"), Placed { form: form.clone(), to_world: affine(steps), is_emitter: true }))
    })
}

fn numbers(index: u64) -> Generator {
    Stream::new(5, Purpose::Test).generator(index)
}

fn direction(numbers: &mut Generator) -> Vec3 {
    sphere::uniform_sphere(numbers.uniform_pair()).as_vec3().normalize()
}

/// Center and radius of a sphere around everything.
fn surroundings(geometry: &Geometry) -> (Vec3, f32) {
    let bounds = geometry.bounds();
    ((bounds.min + bounds.max) / 2.0, (bounds.max - bounds.min).length() / 2.0)
}

/// A ray from around the shapes to somewhere within their box.
fn ray(geometry: &Geometry, numbers: &mut Generator) -> Ray {
    let (center, radius) = surroundings(geometry);
    let origin = center + direction(numbers) * (2.0 * radius);
    let target = center + direction(numbers) * (radius * numbers.uniform() as f32);
    Ray::new(origin, (target - origin).normalize())
}

fn hits(geometry: &Geometry, seed: u64, count: usize) -> Vec<(Ray, Hit, Surface)> {
    let mut numbers = numbers(seed);
    let rays = (0..count).map(|_| ray(geometry, &mut numbers));
    rays.filter_map(|ray| geometry.intersect(&ray).map(|hit| (ray, hit, geometry.surface(&ray, &hit)))).collect()
}

/// Distance to a triangle in double precision (Möller & Trumbore 1997), and how far inside its edges the point is.
fn triangle_hit(ray: &Ray, corners: [DVec3; 3]) -> Option<(f64, f64)> {
    let (origin, direction) = (ray.origin.as_dvec3(), ray.direction.as_dvec3());
    let (e1, e2) = (corners[1] - corners[0], corners[2] - corners[0]);
    let p = direction.cross(e2);
    let determinant = e1.dot(p);
    let s = origin - corners[0];
    let u = s.dot(p) / determinant;
    let q = s.cross(e1);
    let v = direction.dot(q) / determinant;
    let t = e2.dot(q) / determinant;
    let inside = u.min(v).min(1.0 - u - v);
    (inside >= 0.0 && t > 0.0).then_some((t, inside))
}

fn world_triangles(mesh: &Mesh, to_world: &DAffine3) -> Vec<[DVec3; 3]> {
    (0..mesh.triangles().len()).map(|t| mesh.corners(t).map(|p| to_world.transform_point3(p.as_dvec3()))).collect()
}

#[test]
fn meshes_are_hit_where_every_triangle_looked_at_says() {
    for (name, placed) in cases() {
        let Form::Mesh(mesh) = &placed.form else { continue };
        let triangles = world_triangles(mesh, &placed.to_world);
        let geometry = built(std::slice::from_ref(&placed));
        let scale = f64::from(surroundings(&geometry).1);
        let place = geometry.bounds().max.abs().max(geometry.bounds().min.abs()).max_element();
        let mut numbers = numbers(1);
        for _ in 0..60 {
            let ray = ray(&geometry, &mut numbers);
            let expected = triangles.iter().filter_map(|&corners| triangle_hit(&ray, corners)).min_by(|a, b| a.0.total_cmp(&b.0));
            let found = geometry.intersect(&ray).map(|hit| f64::from(hit.distance));
            // Corners are rounded to single precision at their place.
            let tolerance = 1e-5 * scale + 2e-5 * f64::from(place) * 0.1;
            let agree = match (found, expected) {
                (Some(found), Some((distance, _))) => (found - distance).abs() < tolerance,
                (None, None) => true,
                _ => false,
            };
            // Within rounding of an edge of the silhouette either answer is right.
            let near_an_edge = expected.is_none_or(|(_, inside)| inside < 1e-2);
            assert!(agree || near_an_edge, "{name}: {found:?} {expected:?}");
        }
    }
}

#[test]
fn a_box_is_its_six_faces_and_a_rectangle_two_triangles() {
    let rectangle = Arc::new(
        Mesh::new(Arrays {
            positions: [[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]].map(Vec3::from).to_vec(),
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            ..Arrays::default()
        })
        .unwrap()
        .0,
    );
    let faces = [
        "[{ translate: [0, 0, 1] }]",
        "[{ translate: [0, 0, 1] }, { rotate: { axis: [0, 1, 0], degrees: 90 } }]",
        "[{ translate: [0, 0, 1] }, { rotate: { axis: [0, 1, 0], degrees: 180 } }]",
        "[{ translate: [0, 0, 1] }, { rotate: { axis: [0, 1, 0], degrees: 270 } }]",
        "[{ translate: [0, 0, 1] }, { rotate: { axis: [1, 0, 0], degrees: 90 } }]",
        "[{ translate: [0, 0, 1] }, { rotate: { axis: [1, 0, 0], degrees: -90 } }]",
    ];
    for steps in &TRANSFORMS[..5] {
        let place = affine(steps);
        let whole = built(&[Placed { form: form("box: {}"), to_world: place, is_emitter: false }]);
        let of = |form: &Form| built(&faces.map(|face| Placed { form: form.clone(), to_world: place * affine(face), is_emitter: false }));
        let parts = [of(&Form::Unit(Unit::Rectangle, DAffine3::IDENTITY)), of(&Form::Mesh(Arc::clone(&rectangle)))];
        let mut numbers = numbers(2);
        for _ in 0..500 {
            let ray = ray(&whole, &mut numbers);
            let hit = whole.intersect(&ray);
            for part in &parts {
                let other = part.intersect(&ray);
                assert_eq!(hit.is_some(), other.is_some(), "{steps} {ray:?}");
                if let (Some(hit), Some(other)) = (hit, other) {
                    assert!((hit.distance - other.distance).abs() < 1e-5 * hit.distance, "{steps} {hit:?} {other:?}");
                    let (a, b) = (whole.surface(&ray, &hit), part.surface(&ray, &other));
                    assert!((a.normal - b.normal).length() < 1e-5, "{steps}");
                }
            }
        }
    }
}

#[test]
fn a_sphere_is_hit_where_the_chord_says() {
    for (center, radius) in [([0.0; 3], 1.0), ([3.0, -1.0, 2.0], 1e-3), ([-700.0, 3.0, 8.0], 1e3), ([1e4, -1e4, 1e4], 2.0)] {
        let text = format!("sphere: {{ center: {center:?}, radius: {radius:?} }}");
        let geometry = built(&[Placed { form: form(&text), to_world: DAffine3::IDENTITY, is_emitter: false }]);
        let mut numbers = numbers(3);
        for _ in 0..2000 {
            let ray = ray(&geometry, &mut numbers);
            let (origin, direction) = (ray.origin.as_dvec3() - DVec3::from(center), ray.direction.as_dvec3().normalize());
            let miss = origin.cross(direction).length();
            let hit = geometry.intersect(&ray);
            if (miss / radius - 1.0).abs() > 1e-6 {
                assert_eq!(hit.is_some(), miss < radius, "{text} {miss}");
            }
            if let Some(hit) = hit {
                let position = geometry.surface(&ray, &hit).position.as_dvec3() - DVec3::from(center);
                let half_chord = (radius * radius - miss * miss).max(0.0).sqrt();
                let expected = -origin.dot(direction) - half_chord;
                // Near the rim the chord is the root of what rounding leaves.
                assert!((f64::from(hit.distance) - expected).abs() < 1e-6 * expected + 1e-3 * radius, "{text}");
                let rounding = DVec3::from(center).abs().max_element() * 1.2e-7 + radius * 2e-7;
                assert!((position.length() - radius).abs() < rounding, "{text}");
            }
        }
    }
}

#[test]
fn what_is_met_before_the_reach_occludes_and_nothing_else() {
    for (name, placed) in cases() {
        let geometry = built(&[placed]);
        let mut numbers = numbers(4);
        for _ in 0..100 {
            let mut ray = ray(&geometry, &mut numbers);
            let hit = geometry.intersect(&ray);
            assert_eq!(geometry.is_occluded(&ray), hit.is_some(), "{name}");
            if let Some(hit) = hit {
                ray.reach = hit.distance * 0.999;
                assert!(!geometry.is_occluded(&ray) && geometry.intersect(&ray).is_none(), "{name}");
                ray.reach = hit.distance * 1.001;
                assert!(geometry.is_occluded(&ray) && geometry.intersect(&ray) == Some(hit), "{name}");
            }
        }
    }
}

#[test]
fn normals_and_derivatives_are_those_of_neighboring_points() {
    for (name, placed) in cases() {
        let geometry = built(&[placed]);
        let (_, radius) = surroundings(&geometry);
        let place = geometry.bounds().max.abs().max_element();
        // Far from the origin differences of single-precision positions are coarse.
        let step = 1e-3_f32.max(2e-6 * place / radius);
        let mut numbers = numbers(6);
        let mut compared = 0;
        for (ray, hit, surface) in hits(&geometry, 5, 150) {
            assert!((surface.normal.length() - 1.0).abs() < 1e-5 && (surface.frame.normal.length() - 1.0).abs() < 1e-5, "{name}");
            assert!(surface.normal.dot(surface.frame.normal) >= -1e-6, "{name}");
            assert!((surface.position - ray.at(hit.distance)).length() < 1e-5 * (hit.distance + place), "{name}");
            let cos = surface.normal.dot(ray.direction).abs();
            let target = surface.position + direction(&mut numbers).cross(surface.normal) * (step * radius);
            let other = Ray::new(ray.origin, (target - ray.origin).normalize());
            let Some(other_hit) = geometry.intersect(&other) else { continue };
            let next = geometry.surface(&other, &other_hit);
            let way = next.position - surface.position;
            let is_same_face = geometry.primitive(&hit) == geometry.primitive(&other_hit) && way.length() < 3.0 * step * radius;
            if cos < 0.2 || !is_same_face {
                continue;
            }
            compared += 1;
            assert!(surface.normal.dot(way).abs() < 0.02 * way.length() + 4.0 * surface.offset, "{name}: {} {way}", surface.normal);
            let by_uv = surface.dp_du * (next.uv[0] - surface.uv[0]) + surface.dp_dv * (next.uv[1] - surface.uv[1]);
            // Near the poles and the seam of a sphere u jumps.
            let is_at_the_seam = (next.uv[0] - surface.uv[0]).abs() > 0.1 || surface.dp_du.length() < 0.5 * surface.dp_dv.length();
            assert!(is_at_the_seam || (by_uv - way).length() < 0.05 * way.length() + 8.0 * surface.offset, "{name}: {by_uv} {way}");
        }
        assert!(compared > 10, "{name}: {compared}");
    }
}

#[test]
fn u_goes_right_where_v_goes_up_seen_from_the_normal() {
    for (name, placed) in cases() {
        let mirrors = placed.to_world.matrix3.determinant() < 0.0;
        let geometry = built(&[placed]);
        for (_, _, surface) in hits(&geometry, 7, 100) {
            let side = surface.dp_du.cross(surface.dp_dv).dot(surface.normal);
            let is_degenerate = side.abs() < 1e-3 * surface.dp_du.length() * surface.dp_dv.length();
            assert!(is_degenerate || (side > 0.0) != mirrors, "{name}");
        }
    }
}

#[test]
fn normals_of_closed_shapes_point_outwards() {
    for (name, placed) in cases().filter(|(name, _)| !name.starts_with("rectangle") && !name.starts_with("disk")) {
        let geometry = built(&[placed]);
        for (ray, _, surface) in hits(&geometry, 8, 100) {
            assert!(surface.normal.dot(ray.direction) < 1e-4, "{name}: {:?}", surface);
        }
    }
}

#[test]
fn a_new_ray_leaves_the_surface_it_starts_on() {
    for (name, placed) in cases() {
        let is_convex = !["torus", "knot", "blob", "uv-sphere"].iter().any(|kind| name.starts_with(kind));
        let geometry = built(&[placed]);
        let mut numbers = numbers(10);
        for (_, hit, surface) in hits(&geometry, 9, 150) {
            for _ in 0..8 {
                let mut direction = direction(&mut numbers);
                // Grazing ones too.
                if numbers.uniform() < 0.3 {
                    direction = (direction - surface.normal * (direction.dot(surface.normal) * 0.99)).normalize();
                }
                let next = geometry.intersect(&surface.spawn(direction));
                let leaves = direction.dot(surface.normal) > 0.0;
                if is_convex && leaves {
                    assert!(next.is_none(), "{name}: {surface:?} {direction} {next:?}");
                }
                if let Some(next) = next {
                    let again =
                        geometry.primitive(&next) == geometry.primitive(&hit) && name.starts_with(['i', 't', 'k', 'b', 'r', 'd', 'u']);
                    assert!(!again, "{name}: {surface:?} {direction} {next:?}");
                }
            }
        }
    }
}

#[test]
fn closed_shapes_do_not_leak() {
    let closed = ["sphere: {}", "box: {}", "icosphere: { subdivisions: 2 }", "uv-sphere: { columns: 16, rows: 8 }"];
    let places = ["[]", "[{ scale: 0.001 }]", "[{ scale: 1000 }]", "[{ scale: 10 }, { translate: [10000, -10000, 10000] }]", TRANSFORMS[2]];
    for shape in closed {
        for steps in places {
            let geometry = built(&[Placed { form: form(shape), to_world: affine(steps), is_emitter: false }]);
            let (center, _) = surroundings(&geometry);
            let mut numbers = numbers(11);
            let mut ray = Ray::new(center, direction(&mut numbers));
            // A walk inside that is thrown back at every wall.
            for bounce in 0..4000 {
                let Some(hit) = geometry.intersect(&ray) else { panic!("{shape} {steps} leaks at bounce {bounce}: {ray:?}") };
                let surface = geometry.surface(&ray, &hit);
                let inwards = (direction(&mut numbers) - surface.normal * 1.0001).try_normalize().unwrap_or(-surface.normal);
                ray = surface.spawn(inwards);
            }
        }
    }
}

#[test]
fn rays_at_edges_and_corners_of_a_closed_mesh_all_hit() {
    let Form::Mesh(mesh) = form("icosphere: { subdivisions: 3 }") else { unreachable!() };
    for steps in TRANSFORMS {
        let to_world = affine(steps);
        let geometry = built(&[Placed { form: Form::Mesh(Arc::clone(&mesh)), to_world, is_emitter: false }]);
        let inside = to_world.transform_point3(DVec3::new(0.1, 0.02, -0.05)).as_vec3();
        for triangle in 0..mesh.triangles().len() {
            let [a, b, _] = mesh.corners(triangle).map(|corner| to_world.transform_point3(corner.as_dvec3()).as_vec3());
            for target in [a, b, (a + b) / 2.0, a * 0.3 + b * 0.7] {
                assert!(geometry.intersect(&Ray::new(inside, (target - inside).normalize())).is_some(), "{steps} {target}");
            }
        }
    }
}

#[test]
fn moving_the_scene_moves_the_hits() {
    let motion = affine("[{ rotate: { axis: [3, 1, 2], degrees: 40 } }, { scale: 2.5 }, { translate: [1, 2, 3] }]");
    for (name, placed) in cases().filter(|(name, _)| !name.contains("10000")) {
        let geometry = built(std::slice::from_ref(&placed));
        let moved = built(&[Placed { to_world: motion * placed.to_world, ..placed }]);
        let mut agreed = 0;
        for (ray, hit, surface) in hits(&geometry, 12, 80) {
            let origin = motion.transform_point3(ray.origin.as_dvec3()).as_vec3();
            let direction = motion.transform_vector3(ray.direction.as_dvec3()).normalize().as_vec3();
            let ray = Ray::new(origin, direction);
            let Some(other) = moved.intersect(&ray) else { continue };
            if moved.primitive(&other) != geometry.primitive(&hit) {
                continue;
            }
            let other = moved.surface(&ray, &other);
            let cos = surface.normal.dot((surface.position - ray.origin).normalize()).abs().max(0.05);
            let expected = motion.transform_point3(surface.position.as_dvec3()).as_vec3();
            assert!((other.position - expected).length() < 2e-4 / cos, "{name} {expected} {}", other.position);
            agreed += 1;
        }
        assert!(agreed > 15, "{name}: {agreed}");
    }
}

#[test]
fn a_mesh_that_stands_in_several_places_is_the_same_in_each() {
    let Form::Mesh(mesh) = form("knot: { columns: 64, rows: 8 }") else { unreachable!() };
    let alone = |to_world: DAffine3| Placed { form: Form::Mesh(Arc::new((*mesh).clone())), to_world, is_emitter: true };
    let together = |to_world: DAffine3| Placed { form: Form::Mesh(Arc::clone(&mesh)), to_world, is_emitter: true };
    let places = TRANSFORMS[..5].iter().map(|steps| affine(steps)).collect::<Vec<_>>();
    let baked = built(&places.iter().map(|&place| alone(place)).collect::<Vec<_>>());
    let shared = built(&places.iter().map(|&place| together(place)).collect::<Vec<_>>());
    assert!(shared.memory() < baked.memory() / 3);
    let mut agreed = 0;
    for (ray, hit, surface) in hits(&baked, 13, 2000) {
        let Some(other) = shared.intersect(&ray) else { continue };
        if (other.shape, shared.primitive(&other)) != (hit.shape, baked.primitive(&hit)) {
            continue;
        }
        let other = shared.surface(&ray, &other);
        let cos = surface.normal.dot(ray.direction).abs().max(0.05);
        assert!((other.position - surface.position).length() < 2e-5 / cos, "{:?} {:?}", other, surface);
        assert!((other.normal - surface.normal).length() < 1e-3);
        assert!(shared.intersect(&other.spawn(other.normal)).is_none_or(|next| next.distance > 1e-5 || next.shape != hit.shape));
        agreed += 1;
    }
    assert!(agreed > 500, "{agreed}");
    for (shape, place) in places.iter().enumerate() {
        let area = built(&[alone(*place)]).area(0);
        assert!((shared.area(shape as u32) - area).abs() < 1e-9 * area);
    }
}

#[test]
fn the_density_of_a_drawn_point_is_that_of_the_ray_to_it() {
    for (name, placed) in cases() {
        let geometry = built(&[placed]);
        let (center, radius) = surroundings(&geometry);
        let mut numbers = numbers(14);
        let mut seen = 0;
        for _ in 0..100 {
            let reference = center + direction(&mut numbers) * (1.5 * radius);
            let u = numbers.uniform_pair().map(|u| (u as f32).min(1.0 - f32::EPSILON));
            let Some(sample) = geometry.sample(0, reference, u) else { continue };
            assert!(sample.pdf > 0.0 && sample.pdf.is_finite() && (sample.normal.length() - 1.0).abs() < 1e-5, "{name}");
            let ray = Ray::new(reference, (sample.position - reference).normalize());
            let Some(hit) = geometry.intersect(&ray) else { continue };
            let is_in_front = (hit.distance - (sample.position - reference).length()).abs() < 1e-4 * hit.distance;
            let surface = geometry.surface(&ray, &hit);
            let cos = surface.normal.dot(ray.direction).abs();
            // At an edge the ray may meet the neighbor of the triangle that was drawn.
            if !is_in_front || cos < 0.05 || surface.normal.dot(sample.normal) < 0.999 {
                continue;
            }
            let pdf = geometry.pdf(reference, &surface);
            assert!((pdf / sample.pdf - 1.0).abs() < 2e-2, "{name}: {pdf} {}", sample.pdf);
            assert!(sample.uv.iter().zip(surface.uv).all(|(a, b)| (a - b).abs() < 2e-2 || (a - b).abs() > 0.98), "{name}");
            seen += 1;
        }
        assert!(seen > 12, "{name}: {seen}");
    }
}

#[test]
fn areas_are_those_of_the_closed_forms() {
    let area = |shape: &str, steps: &str| built(&[Placed { form: form(shape), to_world: affine(steps), is_emitter: true }]).area(0);
    let pi = std::f64::consts::PI;
    for (found, expected) in [
        (area("rectangle: {}", "[{ scale: [2, 3, 5] }]"), 24.0),
        (area("disk: { radius: 2 }", "[{ rotate: { axis: [1, 0, 0], degrees: 30 } }]"), 4.0 * pi),
        (area("box: { min: [0, 0, 0], max: [1, 2, 3] }", "[{ scale: 2 }]"), 88.0),
        (area("sphere: { radius: 3 }", "[]"), 36.0 * pi),
        // A spheroid of axes 1, 1, 2: 2 pi (1 + 2 asin(e) / e), e = sqrt(3)/2.
        (area("sphere: {}", "[{ scale: [1, 1, 2] }]"), 2.0 * pi * (1.0 + 2.0 * (pi / 3.0) / (0.75_f64).sqrt())),
        (area("torus: { radius: 1, tube_radius: 0.4, columns: 512, rows: 256 }", "[]"), 4.0 * pi * pi * 0.4),
    ] {
        assert!((found / expected - 1.0).abs() < 2e-4, "{found} {expected}");
    }
}

#[test]
fn shapes_without_a_place_in_single_precision_are_refused() {
    for (shape, steps) in
        [("sphere: { radius: 1.0e+60 }", "[]"), ("sphere: { radius: 1.0e-200 }", "[]"), ("box: {}", "[{ translate: [1.0e+50, 0, 0] }]")]
    {
        let placed = [Placed { form: form(shape), to_world: affine(steps), is_emitter: false }];
        struct Refused(ShapeError);
        impl From<ShapeError> for Refused {
            fn from(error: ShapeError) -> Self {
                Self(error)
            }
        }
        let Err(Refused(error)) = Geometry::build(&placed, || Ok::<(), Refused>(())) else { panic!("{shape} {steps}") };
        assert_eq!(error, ShapeError::OutOfRange { shape: 0 });
    }
}

#[test]
fn a_scene_without_shapes_meets_nothing() {
    let geometry = built(&[]);
    let ray = Ray::new(Vec3::ZERO, Vec3::X);
    assert!(geometry.intersect(&ray).is_none() && !geometry.is_occluded(&ray));
}

#[test]
fn many_shapes_are_met_as_if_each_were_alone() {
    let all: Vec<Placed> = cases().filter(|(name, _)| !name.contains("10000")).map(|(_, placed)| placed).collect();
    let together = built(&all);
    let each: Vec<Geometry> = all.iter().map(|placed| built(std::slice::from_ref(placed))).collect();
    let mut numbers = numbers(15);
    for _ in 0..300 {
        let ray = ray(&together, &mut numbers);
        let nearest = each.iter().filter_map(|one| one.intersect(&ray)).map(|hit| hit.distance).min_by(f32::total_cmp);
        let found = together.intersect(&ray).map(|hit| hit.distance);
        // Shared trees round the ray; two shapes may be met at almost the same place.
        match (found, nearest) {
            (Some(found), Some(nearest)) => assert!((found - nearest).abs() < 1e-4 * nearest.max(1.0), "{found} {nearest}"),
            (None, None) => {}
            other => panic!("{other:?}"),
        }
    }
}

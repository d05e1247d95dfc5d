//! Meshes, trees and rays: `cargo bench --bench render`. Rays per second follow from the items.
//!
//! Two meshes, a sphere of 16 000 triangles and a displaced one of a million; rays of a camera in image order, cosine
//! rays off their hits, and shadow rays to one side. The tree of the crate obvhs stands beside ours.

use std::convert::Infallible;
use std::sync::{Arc, LazyLock};

use divan::counter::ItemsCount;
use divan::{Bencher, black_box};
use glam::{DAffine3, Vec3, Vec3A};
use obvhs::BvhBuildParams;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::builder::build_bvh2_from_tris;
use obvhs::cwbvh::CwBvh;
use obvhs::cwbvh::builder::build_cwbvh_from_tris;
use obvhs::rt_triangle::RtTriangle;
use obvhs::triangle::Triangle;
use pipeline::math::sphere;
use pipeline::math::stream::{Purpose, Stream};
use pipeline::render::frame::Frame;
use pipeline::render::mesh::Mesh;
use pipeline::render::ray::Ray;
use pipeline::render::shape::generated::{Relief, UvSphere};
use pipeline::render::shape::geometry::{Geometry, Placed};
use pipeline::render::shape::triangles::Triangles;
use pipeline::render::shape::{Form, ShapeError};

fn main() {
    divan::main();
}

#[derive(Debug, Clone, Copy)]
enum Scene {
    Thousands,
    Million,
}

const SCENES: [Scene; 2] = [Scene::Thousands, Scene::Million];

fn made(columns: u32, rows: u32, relief: Option<Relief>) -> Prepared {
    let mesh = Arc::new(UvSphere { columns, rows, radius: 1.0, relief }.mesh().unwrap());
    Prepared::new(mesh)
}

static THOUSANDS: LazyLock<Prepared> = LazyLock::new(|| made(128, 64, None));
static MILLION: LazyLock<Prepared> =
    LazyLock::new(|| made(1000, 500, Some(Relief { amplitude: 0.2, frequency: 4.0, octaves: 6, seed: 1 })));

fn prepared(scene: Scene) -> &'static Prepared {
    match scene {
        Scene::Thousands => &THOUSANDS,
        Scene::Million => &MILLION,
    }
}

/// A mesh under every tree, and rays for it.
struct Prepared {
    mesh: Arc<Mesh>,
    geometry: Geometry,
    others: Others,
    primary: Vec<Ray>,
    bounce: Vec<Ray>,
    shadow: Vec<Ray>,
}

struct Others {
    wide: CwBvh,
    wide_triangles: Vec<RtTriangle>,
    binary: Bvh2,
    binary_triangles: Vec<RtTriangle>,
}

#[derive(Debug)]
struct Never;

impl From<ShapeError> for Never {
    fn from(error: ShapeError) -> Self {
        panic!("{error}")
    }
}

fn corners(mesh: &Mesh) -> Vec<Triangle> {
    let of = |triangle: usize| {
        let [v0, v1, v2] = mesh.corners(triangle).map(Vec3A::from);
        Triangle { v0, v1, v2 }
    };
    (0..mesh.triangles().len()).map(of).collect()
}

impl Prepared {
    fn new(mesh: Arc<Mesh>) -> Self {
        let placed = Placed { form: Form::Mesh(Arc::clone(&mesh)), to_world: DAffine3::IDENTITY, is_emitter: false };
        let geometry = Geometry::build(&[placed], || Ok::<(), Never>(())).unwrap();
        let triangles = corners(&mesh);
        let wide = build_cwbvh_from_tris(&triangles, BvhBuildParams::fast_build(), &mut Default::default());
        let binary = build_bvh2_from_tris(&triangles, BvhBuildParams::fast_build(), &mut Default::default());
        let in_order = |indices: &[u32]| indices.iter().map(|&index| RtTriangle::from(&triangles[index as usize])).collect();
        let (wide_triangles, binary_triangles) = (in_order(&wide.primitive_indices), in_order(&binary.primitive_indices));
        let others = Others { wide, wide_triangles, binary, binary_triangles };
        let primary = primary();
        let surfaces: Vec<_> = primary.iter().filter_map(|ray| geometry.intersect(ray).map(|hit| geometry.surface(ray, &hit))).collect();
        let stream = Stream::new(1, Purpose::Test);
        let bounced = |(index, surface): (usize, &pipeline::render::ray::Surface)| {
            let local = sphere::cosine_hemisphere(stream.generator(index as u64).uniform_pair()).as_vec3();
            surface.spawn(Frame::about(surface.normal).to_world(local).normalize())
        };
        let bounce = surfaces.iter().enumerate().map(bounced).collect();
        let light = Vec3::new(5.0, 8.0, 6.0);
        let shadow =
            surfaces.iter().filter(|surface| surface.normal.dot(light) > 0.0).filter_map(|surface| surface.spawn_to(light)).collect();
        Self { mesh, geometry, others, primary, bounce, shadow }
    }
}

/// 512 x 512 rays that fill the view with a sphere of radius 1.
fn primary() -> Vec<Ray> {
    let origin = Vec3::new(0.0, 0.0, 4.0);
    let pixels = (0..512 * 512).map(|k| ((k % 512) as f32 + 0.5, (k / 512) as f32 + 0.5));
    pixels.map(|(x, y)| Ray::new(origin, Vec3::new((x / 256.0 - 1.0) * 0.36, (1.0 - y / 256.0) * 0.36, -1.0).normalize())).collect()
}

fn count(rays: &[Ray], is_hit: impl Fn(&Ray) -> bool) -> usize {
    rays.iter().filter(|ray| is_hit(ray)).count()
}

fn obvhs_ray(ray: &Ray) -> obvhs::ray::Ray {
    obvhs::ray::Ray::new(ray.origin.into(), ray.direction.into(), 0.0, ray.reach)
}

fn wide_hit(others: &Others, ray: &Ray) -> bool {
    let mut hit = obvhs::ray::RayHit::none();
    others.wide.ray_traverse(obvhs_ray(ray), &mut hit, |ray, id| others.wide_triangles[id].intersect(ray))
}

fn binary_hit(others: &Others, ray: &Ray) -> bool {
    let mut hit = obvhs::ray::RayHit::none();
    others.binary.ray_traverse(obvhs_ray(ray), &mut hit, |ray, id| others.binary_triangles[id].intersect(ray))
}

#[divan::bench(args = SCENES, sample_count = 5, sample_size = 1)]
fn build(bencher: Bencher, scene: Scene) {
    let mesh = &prepared(scene).mesh;
    bencher
        .counter(ItemsCount::new(mesh.triangles().len()))
        .bench(|| Triangles::build(Arc::clone(black_box(mesh)), None, || Ok::<(), Infallible>(())).unwrap());
}

#[divan::bench(args = SCENES, sample_count = 3, sample_size = 1)]
fn build_obvhs_wide(bencher: Bencher, scene: Scene) {
    let triangles = corners(&prepared(scene).mesh);
    bencher
        .counter(ItemsCount::new(triangles.len()))
        .bench(|| build_cwbvh_from_tris(black_box(&triangles), BvhBuildParams::fast_build(), &mut Default::default()));
}

#[divan::bench(args = SCENES, sample_count = 5, sample_size = 1)]
fn primary_rays(bencher: Bencher, scene: Scene) {
    let scene = prepared(scene);
    bencher.counter(ItemsCount::new(scene.primary.len())).bench(|| count(&scene.primary, |ray| scene.geometry.intersect(ray).is_some()));
}

#[divan::bench(args = SCENES, sample_count = 5, sample_size = 1)]
fn primary_rays_obvhs_wide(bencher: Bencher, scene: Scene) {
    let scene = prepared(scene);
    bencher.counter(ItemsCount::new(scene.primary.len())).bench(|| count(&scene.primary, |ray| wide_hit(&scene.others, ray)));
}

#[divan::bench(args = SCENES, sample_count = 5, sample_size = 1)]
fn primary_rays_obvhs_binary(bencher: Bencher, scene: Scene) {
    let scene = prepared(scene);
    bencher.counter(ItemsCount::new(scene.primary.len())).bench(|| count(&scene.primary, |ray| binary_hit(&scene.others, ray)));
}

#[divan::bench(args = SCENES, sample_count = 5, sample_size = 1)]
fn bounce_rays(bencher: Bencher, scene: Scene) {
    let scene = prepared(scene);
    bencher.counter(ItemsCount::new(scene.bounce.len())).bench(|| count(&scene.bounce, |ray| scene.geometry.intersect(ray).is_some()));
}

#[divan::bench(args = SCENES, sample_count = 5, sample_size = 1)]
fn bounce_rays_obvhs_wide(bencher: Bencher, scene: Scene) {
    let scene = prepared(scene);
    bencher.counter(ItemsCount::new(scene.bounce.len())).bench(|| count(&scene.bounce, |ray| wide_hit(&scene.others, ray)));
}

#[divan::bench(args = SCENES, sample_count = 5, sample_size = 1)]
fn bounce_rays_obvhs_binary(bencher: Bencher, scene: Scene) {
    let scene = prepared(scene);
    bencher.counter(ItemsCount::new(scene.bounce.len())).bench(|| count(&scene.bounce, |ray| binary_hit(&scene.others, ray)));
}

#[divan::bench(args = SCENES, sample_count = 5, sample_size = 1)]
fn shadow_rays(bencher: Bencher, scene: Scene) {
    let scene = prepared(scene);
    bencher.counter(ItemsCount::new(scene.shadow.len())).bench(|| count(&scene.shadow, |ray| scene.geometry.is_occluded(ray)));
}

#[divan::bench(args = SCENES, sample_count = 5, sample_size = 1)]
fn shadow_rays_obvhs_wide(bencher: Bencher, scene: Scene) {
    let scene = prepared(scene);
    bencher.counter(ItemsCount::new(scene.shadow.len())).bench(|| {
        count(&scene.shadow, |ray| {
            scene.others.wide.ray_traverse_miss(obvhs_ray(ray), |ray, id| scene.others.wide_triangles[id].intersect(ray))
        })
    });
}

#[divan::bench(args = SCENES, sample_count = 5, sample_size = 1)]
fn surfaces(bencher: Bencher, scene: Scene) {
    let scene = prepared(scene);
    let hits: Vec<_> = scene.primary.iter().filter_map(|ray| scene.geometry.intersect(ray).map(|hit| (*ray, hit))).collect();
    bencher
        .counter(ItemsCount::new(hits.len()))
        .bench(|| hits.iter().map(|(ray, hit)| scene.geometry.surface(ray, hit).normal).sum::<Vec3>());
}

//! Renders a window of a picture over a block of samples.
//!
//! Every pixel is a function of the scene and its own position; rows are shared out among threads, so the result does
//! not depend on how many there are. A block that begins where a finished one ends goes on from its sums.

use std::borrow::Cow;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use glam::Vec3;
use rayon::prelude::*;

use crate::render::film::sums::{Address, Block, Film, Fold, Refused, Sums, Window, channel};
use crate::render::integrator::path::{CAMERA_SETS, FirstHit, Transporter};
use crate::render::integrator::{Integrator, normals};
use crate::render::sampler::Numbers;
use crate::render::scene::compiled::Scene;

/// Set of the place on the film.
const FILM_SET: u32 = 0;
/// Set of the place on the lens.
const LENS_SET: u32 = 1;
const _: () = assert!(CAMERA_SETS == 2);

/// Radiance beyond this is as good as infinite: the sum of the most samples that a pixel may have is still a number.
const LARGEST: f32 = 1e30;

/// Samples of a pixel between two questions whether to stop.
const PATIENCE: u32 = 256;

/// What is to be rendered.
#[derive(Debug, Clone, Copy)]
pub struct Request<'a> {
    /// Which pixels.
    pub window: Window,
    /// Which samples of each replicate.
    pub block: Block,
    /// Replicates.
    pub replicates: u32,
    /// Sums of the first samples of the block, a power of two of them, of these pixels or more: where to go on from.
    pub start: Option<&'a Film>,
}

/// Renders; `progress` is told the finished part, from 0 to 1.
///
/// A `start` that does not fit the request is not used.
pub fn render<E: Send>(
    scene: &Scene,
    request: &Request<'_>,
    check: impl Fn() -> Result<(), E> + Sync,
    progress: impl Fn(f32) + Sync,
) -> Result<Film, E> {
    let Request { window, block, replicates, .. } = *request;
    let start = request.start.filter(|film| fits(film, request)).and_then(|film| seen_through(film, window));
    let start = start.as_deref();
    let mut sums = vec![Sums::default(); window.pixel_count() * replicates as usize];
    let refused = Mutex::new(start.map_or(Refused::default(), |film| film.refused));
    let finished = AtomicUsize::new(0);
    let per_row = window.width() * replicates as usize;
    sums.par_chunks_mut(per_row.max(1)).enumerate().try_for_each(|(row, sums)| {
        let before = start.map(|film| &film.sums[row * per_row..][..per_row]);
        let line = Line { scene, request, y: window.y0 + row as u32, started: start.map_or(0, |film| film.block.count) };
        let found = line.render(sums, before, &check)?;
        if found != Refused::default() {
            let mut all = refused.lock().expect("no one panics while adding");
            *all = all.plus(found);
        }
        let done = finished.fetch_add(1, Ordering::Relaxed) + 1;
        progress(done as f32 / window.height() as f32);
        Ok(())
    })?;
    let refused = refused.into_inner().expect("no one panics while adding");
    Ok(Film { window, block, replicates, sums, refused })
}

/// The part of a film that is seen through a window.
fn seen_through(film: &Film, window: Window) -> Option<Cow<'_, Film>> {
    if film.window == window { Some(Cow::Borrowed(film)) } else { film.cropped(window).map(Cow::Owned) }
}

/// Whether a film is the beginning of what is asked for, at a node of the tree of samples.
fn fits(film: &Film, request: &Request<'_>) -> bool {
    let count = film.block.count;
    film.window.holds(&request.window)
        && film.replicates == request.replicates
        && film.block.first == request.block.first
        && film.sums.len() == film.window.pixel_count() * request.replicates as usize
        && count.is_power_of_two()
        && count <= request.block.count
}

/// One row of the window.
struct Line<'a> {
    scene: &'a Scene,
    request: &'a Request<'a>,
    y: u32,
    /// Samples that are done already.
    started: u32,
}

impl Line<'_> {
    fn render<E>(&self, sums: &mut [Sums], before: Option<&[Sums]>, check: &impl Fn() -> Result<(), E>) -> Result<Refused, E> {
        let Request { window, block, replicates, .. } = *self.request;
        let mut refused = Refused::default();
        let mut fold = Fold::default();
        for (place, sums) in sums.iter_mut().enumerate() {
            check()?;
            let (x, replicate) = (window.x0 + place as u32 / replicates, place as u32 % replicates);
            match before {
                Some(before) => fold.restart(before[place], self.started.trailing_zeros()),
                None => fold.clear(),
            }
            let numbers = self.scene.sampler.pixel(x, self.y, replicate);
            for index in block.first + self.started..block.first + block.count {
                if index % PATIENCE == PATIENCE - 1 {
                    check()?;
                }
                let sample = self.sample(x, &numbers.sample(index));
                let sample = sample.unwrap_or_else(|| {
                    let first = Some(Address { y: self.y, x, replicate, index });
                    refused = refused.plus(Refused { count: 1, first });
                    Sums::default()
                });
                fold.add(sample);
            }
            *sums = fold.total();
        }
        Ok(refused)
    }

    /// One sample; `None` where it is no color that can be added up.
    #[inline]
    fn sample(&self, x: u32, numbers: &Numbers<'_>) -> Option<Sums> {
        let scene = self.scene;
        let [dx, dy] = scene.filter.offset(numbers.pair(FILM_SET));
        let lens = if scene.camera.has_lens() { numbers.pair(LENS_SET) } else { [0.5; 2] };
        let position = [x as f32 + 0.5 + dx, self.y as f32 + 0.5 + dy];
        let (color, first) = match scene.camera.parted(position) {
            None => self.traced(position, lens, numbers),
            Some(positions) => self.traced_by_channel(positions, lens, numbers),
        };
        let is_right = color.min_element() >= 0.0 && color.max_element() <= LARGEST && !color.is_nan();
        is_right.then(|| {
            let mut sums = Sums::default();
            sums.set_triple(channel::COLOR, color.to_array());
            if scene.kept.squares {
                sums.set_triple(channel::SQUARE, (color * color).min(Vec3::splat(LARGEST)).to_array());
            }
            if first.is_hit {
                self.keep_first(&first, &mut sums);
            }
            sums
        })
    }

    /// Color and first surface at a position of the film.
    #[inline]
    fn traced(&self, position: [f32; 2], lens: [f32; 2], numbers: &Numbers<'_>) -> (Vec3, FirstHit) {
        let scene = self.scene;
        let ray = scene.camera.ray(position, lens);
        match &scene.integrator {
            Integrator::Path(transporter) => transporter.radiance(scene, ray, numbers),
            Integrator::VolumePath(transporter) => transporter.radiance_through_media(scene, ray, numbers),
            Integrator::Normals => {
                let first: FirstHit = Transporter::EMITTERS_ALONE.radiance(scene, ray, numbers).1;
                (normals::color(&first), first)
            }
        }
    }

    /// Red, green and blue each from its own position, with the same numbers; green's surface is the first one.
    fn traced_by_channel(&self, positions: [[f32; 2]; 3], lens: [f32; 2], numbers: &Numbers<'_>) -> (Vec3, FirstHit) {
        let [red, (green, first), blue] = positions.map(|position| self.traced(position, lens, numbers));
        (Vec3::new(red.0.x, green.y, blue.0.z), first)
    }

    #[inline]
    fn keep_first(&self, first: &FirstHit, sums: &mut Sums) {
        let kept = &self.scene.kept;
        if kept.albedo {
            sums.set_triple(channel::ALBEDO, first.albedo.to_array());
        }
        if kept.normal {
            sums.set_triple(channel::NORMAL, first.normal.to_array());
        }
        if kept.depth {
            sums.0[channel::DEPTH] = first.depth;
        }
        if kept.coverage {
            sums.0[channel::COVERAGE] = 1.0;
        }
    }
}

#[cfg(test)]
mod tests {
    use std::convert::Infallible;

    use super::*;
    use crate::image::raster::{Image, Raster};
    use crate::light::envmap::EnvMap;
    use crate::light::test_maps;
    use crate::render::film::sums::Assembly;
    use crate::render::scene::SceneDescription;
    use crate::render::scene::compiled::{NoLibrary, Surroundings};

    fn description(text: &str) -> SceneDescription {
        let text = serde_yaml::Deserializer::from_str(text);
        let description: SceneDescription = serde_yaml::with::singleton_map_recursive::deserialize(text).unwrap();
        assert_eq!(description.mistakes(), []);
        description
    }

    fn compiled(description: &SceneDescription, env: Option<&EnvMap>) -> Scene {
        let surroundings = Surroundings { env, lights: None, seed: 5 };
        Scene::new(description, &surroundings, &mut NoLibrary, || Ok(())).unwrap()
    }

    fn film(description: &SceneDescription, env: Option<&EnvMap>, window: Window, block: Block, start: Option<&Film>) -> Film {
        let request = Request { window, block, replicates: description.replicates(), start };
        render(&compiled(description, env), &request, || Ok::<(), Infallible>(()), |_| ()).unwrap()
    }

    fn whole(description: &SceneDescription, env: Option<&EnvMap>) -> Film {
        let block = Block { first: 0, count: description.samples_per_replicate() };
        film(description, env, Window::whole(description.film.resolution), block, None)
    }

    fn image(text: &str, env: Option<&EnvMap>) -> Image {
        let description = description(text);
        let film = whole(&description, env);
        assert_eq!(film.refused, Refused::default(), "{text}");
        film.image(&description.film)
    }

    /// A sphere on a plate, some glass, under a lamp and a map.
    const STILL: &str = "
camera: { perspective: { origin: [0, 1, 5] } }
film: { resolution: [12, 9], layers: [albedo, normal, depth, variance] }
sampler: SAMPLER
integrator: { path: { max_depth: 5 } }
shapes:
  - { sphere: { center: [-0.5, 0, 0], radius: 0.7 }, bsdf: { diffuse: { reflectance: [0.8, 0.4, 0.2] } } }
  - { sphere: { center: [0.8, 0, 0.3], radius: 0.5 }, bsdf: { dielectric: {} } }
  - { rectangle: {}, transform: [{ rotate: { axis: [1, 0, 0], degrees: -90 } }, { scale: 3 }, { translate: [0, -0.7, 0] }] }
  - { disk: {}, transform: [{ rotate: { axis: [1, 0, 0], degrees: 90 } }, { translate: [0, 3, 0] }], emitter: { area: { radiance: 5 } } }
emitters:
  - { point: { position: [2, 2, 2], intensity: 3 } }
  - { environment: { strength: 0.5, rotate_degrees: 30 } }
";

    fn still(sampler: &str) -> SceneDescription {
        description(&STILL.replace("SAMPLER", sampler))
    }

    #[test]
    fn parts_in_any_cut_and_thread_count_have_the_bytes_of_one_piece() {
        let map = test_maps::noisy(32, 16);
        for sampler in ["{ independent: { samples_per_pixel: 64 } }", "{ sobol: { samples_per_pixel: 64, replicates: 4 } }"] {
            let description = still(sampler);
            let count = description.samples_per_replicate();
            let window = Window::whole([12, 9]);
            let block = |first, count| Block { first, count };
            let part = |window, block| film(&description, Some(&map), window, block, None);
            let all = part(window, block(0, count));
            let single = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
            assert_eq!(single.install(|| part(window, block(0, count))), all);

            let assembled = |parts: &[Film]| {
                let mut assembly = Assembly::new(window, all.block, all.replicates);
                parts.iter().for_each(|part| assert!(assembly.take(part.clone())));
                assembly.finish().unwrap()
            };
            assert_eq!(assembled(&[part(window, block(0, count / 2)), part(window, block(count / 2, count / 2))]), all);
            for level in 0..=count.ilog2() {
                let start = part(window, block(0, 1 << level));
                assert_eq!(film(&description, Some(&map), window, block(0, count), Some(&start)), all, "from {}", 1 << level);
            }
            let tile = |x0, y0, x1, y1| part(Window { x0, y0, x1, y1 }, block(0, count));
            assert_eq!(assembled(&[tile(0, 0, 12, 4), tile(0, 4, 12, 9)]), all);
            let corner = Window { x0: 5, y0: 4, x1: 12, y1: 9 };
            assert_eq!(tile(5, 4, 12, 9), all.cropped(corner).unwrap());
            // Going on from a larger window.
            let start = part(window, block(0, count / 4));
            assert_eq!(film(&description, Some(&map), corner, block(0, count), Some(&start)), all.cropped(corner).unwrap());
        }
    }

    #[test]
    fn a_start_that_does_not_fit_is_not_used() {
        let description = still("{ independent: { samples_per_pixel: 8 } }");
        let right = whole(&description, None);
        let mut start = film(&description, None, Window::whole([12, 9]), Block { first: 0, count: 4 }, None);
        start.sums.iter_mut().for_each(|sums| sums.0[0] += 1.0);
        start.window.x0 = 1;
        let found = film(&description, None, right.window, right.block, Some(&start));
        assert_eq!(found, right);
    }

    const SPHERE: &str = "
film: { resolution: [16, 16], background: transparent, layers: [albedo, normal, depth] }
camera: { orthographic: {} }
sampler: { sobol: { samples_per_pixel: 16 } }
integrator: INTEGRATOR
shapes: [{ sphere: {}, bsdf: { diffuse: { reflectance: 1 } } }]
";

    /// Every direction brings 1 and all of it comes back: so does every pixel, whatever is sampled.
    #[test]
    fn a_white_sphere_in_a_white_room_cannot_be_seen() {
        let map = test_maps::constant(8, 4, [1.0; 3]);
        for (integrator, tolerance) in [
            ("{ direct: { strategy: bsdf } }", 1e-5),
            ("{ path: { strategy: bsdf } }", 1e-5),
            ("{ direct: {} }", 0.5),
            ("{ direct: { strategy: emitter, emitter_samples: 64 } }", 0.1),
        ] {
            let image = image(&SPHERE.replace("INTEGRATOR", integrator), Some(&map));
            for (pixel, alpha) in image.color.pixels().iter().zip(&image.alpha.as_ref().unwrap().values) {
                let expected = if *alpha > 0.0 { 1.0 } else { 0.0 };
                // Edge pixels have few samples.
                let tolerance = if *alpha < 1.0 { 10.0 * tolerance } else { tolerance };
                assert!((pixel[1] - expected).abs() < tolerance, "{integrator}: {pixel:?}");
            }
        }
    }

    /// A grey sphere before a grey map: aberration changes edges, and red where green is not.
    #[test]
    fn zero_aberration_weights_change_no_bit_and_others_part_the_colors() {
        let map = test_maps::constant(8, 4, [0.2; 3]);
        let with = |lens: &str| {
            let text = STILL
                .replace("origin: [0, 1, 5]", &format!("origin: [0, 1, 5], lens: {{ {lens} }}"))
                .replace("SAMPLER", "{ sobol: { samples_per_pixel: 8 } }");
            whole(&description(&text), Some(&map))
        };
        let plain = with("");
        assert_eq!(with("aberration: { r: 0, g: 0, b: 0 }, distortion: { k1: 0 }"), plain);
        let parted = with("aberration: { r: 0.1, b: -0.1 }");
        let channel = |film: &Film, k: usize| film.sums.iter().map(|sums| sums.0[channel::COLOR + k]).collect::<Vec<f32>>();
        assert_eq!(channel(&parted, 1), channel(&plain, 1));
        assert_ne!(channel(&parted, 0), channel(&plain, 0));
        assert_ne!(channel(&parted, 2), channel(&plain, 2));
        // Red alone, moved: the whole picture enlarged by the same factor has that red.
        let moved = with("aberration: { r: 0.1, g: 0.1, b: 0.1 }");
        assert_eq!(channel(&parted, 0), channel(&moved, 0));
    }

    /// Means of the channels of a picture.
    fn means(image: &Image) -> Vec3 {
        let pixels = image.color.pixels();
        pixels.iter().map(|pixel| Vec3::from_array(*pixel)).sum::<Vec3>() / pixels.len() as f32
    }

    /// Red is u and green is v of the light: so both ways to find it see the same picture on it.
    #[test]
    fn a_light_with_a_picture_is_drawn_and_hit_with_the_same_coordinates() {
        let text = "
camera: { orthographic: { origin: [0, 0, 5], width: 2 } }
film: { resolution: [4, 4] }
sampler: { sobol: { samples_per_pixel: 2048 } }
integrator: { direct: { strategy: STRATEGY } }
shapes:
  - { rectangle: {}, bsdf: { diffuse: { reflectance: 1 } } }
  - { SHAPE, transform: [{ scale: 0.8 }, { rotate: { axis: [0, 1, 0], degrees: 200 } }, { translate: [1.6, 0.4, 1.5] }], emitter: { area: { radiance: { uv: {} } } } }
";
        for shape in ["rectangle: {}", "disk: {}", "sphere: {}", "box: {}", "icosphere: { subdivisions: 2 }", "torus: {}"] {
            let by = |strategy: &str| means(&image(&text.replace("STRATEGY", strategy).replace("SHAPE", shape), None));
            let [emitter, bsdf, mis] = ["emitter", "bsdf", "mis"].map(by);
            assert!((emitter - bsdf).abs().max_element() < 0.03 * bsdf.max_element(), "{shape}: {emitter} and {bsdf}");
            assert!((mis - bsdf).abs().max_element() < 0.03 * bsdf.max_element(), "{shape}: {mis} and {bsdf}");
            assert!(bsdf.x > 1e-3 && bsdf.y > 1e-3 && bsdf.z == 0.0, "{shape}: {bsdf}");
        }
    }

    /// Flux of a textured light is pi A mean(L): inside a black box all of it falls on the walls, whatever its pattern.
    #[test]
    fn a_light_with_a_pattern_sends_the_flux_of_its_mean() {
        let text = "
camera: { orthographic: { origin: [0, 0, 0.5], target: [0, 0, 1], width: 40 } }
film: { resolution: [32, 32] }
sampler: { sobol: { samples_per_pixel: 256 } }
integrator: { direct: { strategy: emitter } }
shapes:
  - { rectangle: {}, transform: [{ scale: 20 }, { rotate: { axis: [0, 1, 0], degrees: 180 } }, { translate: [0, 0, 1] }], bsdf: { diffuse: { reflectance: 1 } } }
  - { rectangle: {}, transform: [{ scale: 0.5 }], bsdf: { diffuse: { reflectance: 0 } }, emitter: { area: { radiance: { stripes: { a: 0, b: 4, delta: 0.25 } } } } }
";
        // The wall shows E / pi, and its area is 1600: nearly all of the flux reaches it, 3 pi A with A = 1. Half of it
        // falls on a thousand samples in the middle.
        let flux = means(&image(text, None)).x * 1600.0;
        assert!((flux / 3.0 - 1.0).abs() < 0.02, "{flux}");
    }

    /// E = I f(angle) cos / r² on a floor 2 below a spotlight, with the beam of 10 and the edge at 30 degrees.
    #[test]
    fn a_spotlight_lights_a_floor_by_its_falloff() {
        let text = "
camera: { orthographic: { origin: [0, 0, 5], width: 4 } }
film: { resolution: [101, 1] }
sampler: { sobol: { samples_per_pixel: 16 } }
integrator: { direct: {} }
shapes: [{ rectangle: {}, transform: [{ scale: 5 }], bsdf: { diffuse: { reflectance: 1 } } }]
emitters: [{ spot: { position: [0, 0, 2], intensity: 8, cutoff_degrees: 30, beam_degrees: 10, falloff: FALLOFF } }]
";
        let cos = |degrees: f64| crate::math::elementary::cos(degrees.to_radians());
        for falloff in ["mitsuba", "pbrt3", "pbrt4"] {
            let image = image(&text.replace("FALLOFF", falloff), None);
            for x in 0..101 {
                let place = (f64::from(x) - 50.0) * 4.0 / 101.0;
                let angle = crate::math::elementary::atan(place.abs() / 2.0).to_degrees();
                let t = ((cos(angle) - cos(30.0)) / (cos(10.0) - cos(30.0))).clamp(0.0, 1.0);
                let share = match falloff {
                    "mitsuba" => ((30.0 - angle) / 20.0).clamp(0.0, 1.0),
                    "pbrt3" => t * t * t * t,
                    _ => t * t * (3.0 - 2.0 * t),
                };
                let squared = place * place + 4.0;
                let expected = 8.0 * share * (2.0 / squared.sqrt()) / squared / std::f64::consts::PI;
                let found = f64::from(image.color.pixel(x as usize, 0)[0]);
                // A pixel is 0.04 wide: its mean is not the value in its middle where the light bends.
                assert!((found - expected).abs() < 6e-3, "{falloff} at {angle}: {found} instead of {expected}");
            }
        }
    }

    #[test]
    fn layers_show_the_first_surface() {
        let image = image(&SPHERE.replace("INTEGRATOR", "{ normals: {} }"), None);
        let layer = |name: &str| match &image.layers[name] {
            crate::image::raster::Layer::Color(raster) => raster.pixel(8, 7),
            crate::image::raster::Layer::Scalar(plane) => [plane.values[7 * 16 + 8]; 3],
        };
        let near = |found: [f32; 3], expected: [f32; 3]| found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 5e-3);
        assert!(near(layer("normal"), [1.0 / 16.0, 1.0 / 16.0, 0.995]), "{:?}", layer("normal"));
        assert!(near(layer("depth"), [3.004; 3]), "{:?}", layer("depth"));
        assert_eq!(layer("albedo"), [1.0; 3]);
        assert!(near(image.color.pixel(8, 7), [0.531, 0.531, 0.998]), "{:?}", image.color.pixel(8, 7));
    }

    #[test]
    fn single_pixel_pole_row_and_black_maps_give_finite_pictures() {
        let lit = |width: usize, height: usize, is_lit: &dyn Fn(usize) -> bool| {
            let pixel = |place: usize| if is_lit(place) { [1e6, 1e5, 1e4] } else { [0.0; 3] };
            EnvMap::new(Raster::new(width, height, (0..width * height).map(pixel).collect()))
        };
        let maps = [
            (lit(1, 1, &|_| true), true),
            (lit(64, 32, &|place| place == 700), true),
            (lit(64, 32, &|place| place < 64), true),
            (lit(64, 32, &|place| place >= 64 * 31), false),
            (lit(64, 32, &|_| false), false),
        ];
        for (map, shines_from_above) in &maps {
            for integrator in ["{ path: {} }", "{ direct: { environment: uniform } }", "{ path: { strategy: emitter } }"] {
                let image = image(&SPHERE.replace("INTEGRATOR", integrator), Some(map));
                let top: f32 = image.color.row(3).iter().map(|pixel| pixel[0]).sum();
                // The upper half of the sphere sees none of the light from below.
                assert!(top.is_finite() && (*shines_from_above || top == 0.0), "{integrator} {top}");
                if *shines_from_above && !integrator.contains("uniform") {
                    assert!(top > 0.0, "{integrator}");
                }
            }
        }
    }

    #[test]
    fn a_camera_inside_a_wall_sees_its_inside() {
        let text = "
camera: { perspective: { origin: [0, 0, 0], target: [0, 0, -1] } }
film: { resolution: [6, 6] }
integrator: { path: { max_depth: 4 } }
shapes:
  - { box: { min: [-1, -1, -1], max: [1, 1, 1] }, bsdf: { diffuse: { reflectance: 0.5 } } }
";
        let map = test_maps::constant(4, 2, [1.0; 3]);
        assert!(image(text, Some(&map)).color.pixels().iter().all(|pixel| *pixel == [0.0; 3]), "no light leaks into a closed box");
        // On the wall itself.
        let grazing = text.replace("origin: [0, 0, 0], target: [0, 0, -1]", "origin: [0, 0, 1], target: [0, 0, -1]");
        image(&grazing, Some(&map));
    }

    #[test]
    fn depth_counts_scatterings() {
        let text = "
camera: { perspective: { origin: [0, 0, 5], fov_degrees: 10 } }
film: { resolution: [4, 4] }
integrator: { path: { max_depth: DEPTH } }
shapes: [{ sphere: { radius: 2 }, bsdf: { mirror: { reflectance: 0.5 } } }]
";
        let map = test_maps::constant(4, 2, [1.0; 3]);
        for (depth, expected) in [("0", 0.0), ("1", 0.5), ("7", 0.5)] {
            let image = image(&text.replace("DEPTH", depth), Some(&map));
            assert!((image.color.pixel(1, 1)[0] - expected).abs() < 1e-6, "{depth}");
        }
    }

    #[test]
    fn samples_that_are_not_finite_are_counted_with_the_first_address() {
        let description = description(&SPHERE.replace("INTEGRATOR", "{ direct: { strategy: emitter } }"));
        let film = whole(&description, Some(&test_maps::constant(8, 4, [f32::MAX; 3])));
        let first = film.refused.first.unwrap();
        assert!(film.refused.count > 100);
        assert!(first.y <= 1 && film.sums.iter().all(|sums| sums.0.iter().all(|value| value.is_finite())));
        let again = whole(&description, Some(&test_maps::constant(8, 4, [f32::MAX; 3])));
        assert_eq!(film.refused, again.refused);
    }

    #[test]
    fn parallel_and_point_light_have_their_closed_forms() {
        let text = "
camera: { orthographic: { width: 0.01 } }
film: { resolution: [2, 2] }
integrator: INTEGRATOR
shapes: [{ rectangle: {}, bsdf: { diffuse: { reflectance: 0.5 } } }]
emitters: [EMITTER]
";
        use std::f32::consts::FRAC_1_PI;
        for (emitter, expected) in [
            ("{ directional: { towards: [0, 3, 4], irradiance: [2, 4, 6] } }", 2.0 * 0.8 * 0.5 * FRAC_1_PI),
            ("{ point: { position: [0, 0, 2], intensity: [8, 4, 2] } }", 8.0 / 4.0 * 0.5 * FRAC_1_PI),
            ("{ directional: { towards: [0, 0, -1], irradiance: 5 } }", 0.0),
        ] {
            for integrator in ["{ direct: {} }", "{ path: { strategy: bsdf } }", "{ direct: { emitter_samples: 3, strategy: emitter } }"] {
                let image = image(&text.replace("EMITTER", emitter).replace("INTEGRATOR", integrator), None);
                assert!((image.color.pixel(0, 0)[0] / expected.max(1e-9) - 1.0).abs() < 1e-4 || expected == image.color.pixel(0, 0)[0]);
            }
        }
    }

    #[test]
    fn rendering_stops_when_told_to() {
        let description = still("{ independent: { samples_per_pixel: 4 } }");
        let scene = compiled(&description, None);
        let request = Request { window: Window::whole([12, 9]), block: Block { first: 0, count: 4 }, replicates: 1, start: None };
        assert_eq!(render(&scene, &request, || Err("stop"), |_| ()).unwrap_err(), "stop");
    }
}

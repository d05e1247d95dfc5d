//! The interior of a gothic church, drawn from a formula: the map of every example when no file is given.
//!
//! A ray per pixel is followed through the signed distance of the building and shaded by probes, sun
//! and lamps; pixels at edges and in glass are refined by more rays; flames, which are smaller than a
//! pixel, are added with their exact energy. The apse is at -x, the middle of the map.
//! Reading order: `building` (shape), `surface` (stone), `glass`, `light`, this file.

pub mod building;
pub mod glass;
pub mod light;
pub mod surface;

use std::f32::consts::PI;

use glam::Vec3;
use rayon::prelude::*;

use crate::image::raster::Raster;
use crate::light::envmap::{self, EnvMap};
use crate::light::synthesis::PIXELS_PER_CHECK;
use crate::light::synthesis::disk::Disk;
use crate::math::elementary;
use building::{Hit, Part};
use light::{Lamp, Probes};

/// Where the eye stands: in the middle way between the pews, under the vault's third bay.
pub const EYE: Vec3 = Vec3::new(0.0, 1.9, 0.0);

/// Places of the further rays of a refined pixel, in pixels from its center: a square turned, so that no two share a row or column.
const REFINEMENT: [(f64, f64); 4] = [(-0.125, -0.375), (0.375, -0.125), (0.125, 0.375), (-0.375, 0.125)];
/// Neighbors that differ by more than this ratio are refined.
const CONTRAST: f32 = 1.45;
/// The farthest anything is, in meters.
const FARTHEST: f32 = 80.0;
/// Pixels per side of the tiles whose rays start together.
const TILE: usize = 8;

/// All that shading needs.
struct Interior {
    probes: Probes,
    lamps: Vec<Lamp>,
    seed: u64,
}

/// What one ray through a pixel's center has found.
#[derive(Debug, Clone, Copy, Default)]
struct Seen {
    /// Radiance of the surface.
    surface: Vec3,
    /// Radiance of the dust before it.
    dust: Vec3,
    /// Its distance.
    t: f32,
}

/// Computes the map; `seed` varies stones and glass, not the building.
pub fn map<E: Send>(seed: u64, width: usize, check: impl Fn() -> Result<(), E> + Sync) -> Result<EnvMap, E> {
    let t0 = std::time::Instant::now();
    let lamps = light::lamps();
    let interior = Interior { probes: Probes::gathered(&lamps, &check)?, lamps, seed };
    eprintln!("probes {:?}", t0.elapsed());
    let starts = tile_starts(width, &check)?;
    eprintln!("starts {:?}", t0.elapsed());
    let seen = by_pixel(width, &check, |x, y| interior.seen(direction_in(width, x, y, (0.0, 0.0)), start_of(&starts, width, x, y)))?;
    eprintln!("coarse {:?}", t0.elapsed());
    eprintln!(
        "edges {}",
        (0..width * width / 2).filter(|i| is_edge(&seen, width, i % width, i / width)).count() as f64 / (width * width / 2) as f64
    );
    let pixels = by_pixel(width, &check, |x, y| interior.refined(&seen, width, x, y).to_array())?;
    let mut map = EnvMap::new(Raster::new(width, width / 2, pixels));
    for flame in light::flames() {
        add_flame(&mut map, &flame);
        check()?;
    }
    Ok(map)
}

/// Adds a flame that nothing hides.
fn add_flame(map: &mut EnvMap, flame: &light::Flame) {
    let to_flame = flame.position - EYE;
    let distance = to_flame.length();
    if building::trace(EYE, to_flame / distance, 0.0, distance - 0.15).is_some() {
        return;
    }
    let radius = elementary::asin(f64::from(flame.radius / distance));
    let disk = Disk { center: to_flame.as_dvec3().normalize(), radius, radiance: flame.radiance.to_array().map(f64::from) };
    disk.add_to(map, |_| true);
}

/// All pixels, row by row, in parallel.
fn by_pixel<T: Send + Copy + Default, E: Send>(
    width: usize,
    check: impl Fn() -> Result<(), E> + Sync,
    pixel: impl Fn(usize, usize) -> T + Sync,
) -> Result<Vec<T>, E> {
    let mut pixels = vec![T::default(); width * width / 2];
    pixels.par_chunks_mut(PIXELS_PER_CHECK).enumerate().try_for_each(|(part, values)| {
        check()?;
        for (offset, value) in values.iter_mut().enumerate() {
            let index = part * PIXELS_PER_CHECK + offset;
            *value = pixel(index % width, index / width);
        }
        Ok(())
    })?;
    Ok(pixels)
}

/// Direction through pixel (x, y), `offset` pixels from its center.
fn direction_in(width: usize, x: usize, y: usize, offset: (f64, f64)) -> Vec3 {
    let angle = std::f64::consts::TAU / width as f64;
    envmap::direction_at((y as f64 + 0.5 + offset.1) * angle, (x as f64 + 0.5 + offset.0) * angle).as_vec3()
}

/// Distance that all rays of each tile may skip.
fn tile_starts<E: Send>(width: usize, check: impl Fn() -> Result<(), E> + Sync) -> Result<Vec<f32>, E> {
    let (columns, rows) = (width.div_ceil(TILE), (width / 2).div_ceil(TILE));
    // Half a tile's diagonal, and a little more for rounding.
    let spread = 0.72 * TILE as f32 * 2.0 * PI / width as f32;
    if spread > 0.3 {
        return Ok(vec![0.0; columns * rows]);
    }
    let middle = |tile: usize| tile * TILE + TILE / 2 - 1;
    (0..columns * rows)
        .into_par_iter()
        .map(|index| {
            check()?;
            let direction = direction_in(width, middle(index % columns), middle(index / columns), (0.5, 0.5));
            Ok(building::free_distance(EYE, direction, spread))
        })
        .collect()
}

impl Interior {
    /// What one ray from the eye finds.
    fn seen(&self, direction: Vec3, start: f32) -> Seen {
        let hit = trace_to_wall(EYE, direction, start);
        let dust = light::scattered(EYE, direction, hit.t, &self.lamps);
        Seen { surface: self.shaded(EYE, direction, hit, true), dust, t: hit.t }
    }

    /// Radiance of a pixel: of one ray, or the mean of several where it differs from a neighbor.
    fn refined(&self, seen: &[Seen], width: usize, x: usize, y: usize) -> Vec3 {
        let here = seen[y * width + x];
        if !is_edge(seen, width, x, y) {
            return here.surface + here.dust;
        }
        let nearest = neighbors(width, x, y).into_iter().map(|index| seen[index].t).fold(here.t, f32::min);
        let start = (0.96 * nearest - 0.3).max(0.0);
        let sum: Vec3 = REFINEMENT
            .into_iter()
            .map(|offset| {
                let direction = direction_in(width, x, y, offset);
                self.shaded(EYE, direction, trace_to_wall(EYE, direction, start), true)
            })
            .sum();
        sum / REFINEMENT.len() as f32 + here.dust
    }

    /// Radiance that the surface at `hit` sends to the ray's origin; mirrors once.
    fn shaded(&self, origin: Vec3, direction: Vec3, hit: Hit, may_mirror: bool) -> Vec3 {
        let p = origin + direction * hit.t;
        if hit.part == Part::Glass
            && let Some(radiance) = light::glass_radiance(p, direction, self.seed)
        {
            return radiance;
        }
        let n = if hit.part == Part::Floor && p.y < 1e-3 { Vec3::Y } else { building::normal(p, 0.001 + 2e-4 * hit.t) };
        let surface = surface::surface(hit.part, p, n, self.seed);
        let lifted = p + n * 0.02;
        let mut irradiance = self.probes.irradiance(p, surface.normal) * openness(p, n);
        let cosine = surface.normal.dot(light::TO_SUN);
        if cosine > 0.0 && n.dot(light::TO_SUN) > 0.0 {
            irradiance += light::sun(lifted, |window| window.transmittance(self.seed)) * cosine;
        }
        let diffuse = surface.albedo / PI * irradiance;
        if surface.gloss == 0.0 || !may_mirror {
            return diffuse;
        }
        let share = schlick(surface.gloss, -direction.dot(surface.normal));
        let reflected = direction - 2.0 * direction.dot(surface.normal) * surface.normal;
        diffuse * (1.0 - share) + self.shaded(lifted, reflected, trace_to_wall(lifted, reflected, 0.0), false) * share
    }
}

/// The building is closed: a ray that escapes through a rounding error ends in the dark far away.
fn trace_to_wall(origin: Vec3, direction: Vec3, start: f32) -> Hit {
    building::trace(origin, direction, start, FARTHEST).unwrap_or(Hit { t: FARTHEST, part: Part::Wall })
}

fn start_of(starts: &[f32], width: usize, x: usize, y: usize) -> f32 {
    starts[y / TILE * width.div_ceil(TILE) + x / TILE]
}

/// The pixels left, right, above and below; columns go around.
fn neighbors(width: usize, x: usize, y: usize) -> [usize; 4] {
    let (left, right) = ((x + width - 1) % width, (x + 1) % width);
    let (above, below) = (y.saturating_sub(1), (y + 1).min(width / 2 - 1));
    [y * width + left, y * width + right, above * width + x, below * width + x]
}

/// Whether a pixel differs from one of its neighbors so much that one ray is not enough.
fn is_edge(seen: &[Seen], width: usize, x: usize, y: usize) -> bool {
    // Differences far below the level of lit stone are not seen.
    let level = |index: usize| (seen[index].surface + seen[index].dust).element_sum() + 0.05;
    let here = level(y * width + x);
    neighbors(width, x, y).into_iter().map(level).any(|there| here > CONTRAST * there || there > CONTRAST * here)
}

/// Share of the light of far surroundings that reaches a corner or crevice.
///
/// Compares distances along the normal with what an open plane would have (Evans, "Fast
/// approximations for global illumination on dynamic scenes", 2006).
fn openness(p: Vec3, n: Vec3) -> f32 {
    let mut closed = 0.0;
    for (height, weight) in [(0.1, 0.30), (0.35, 0.30), (1.1, 0.26)] {
        closed += weight * (1.0 - building::distance(p + n * height) / (0.93 * height)).clamp(0.0, 1.0);
    }
    1.0 - closed
}

/// Schlick's approximation of Fresnel reflectance.
fn schlick(normal_reflectance: f32, cosine: f32) -> f32 {
    let m = (1.0 - cosine).clamp(0.0, 1.0);
    let m2 = m * m;
    normal_reflectance + (1.0 - normal_reflectance) * m2 * m2 * m
}

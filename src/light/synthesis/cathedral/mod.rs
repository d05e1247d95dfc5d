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
use crate::light::envmap::EnvMap;
use crate::light::synthesis::PIXELS_PER_CHECK;
use crate::light::synthesis::disk::Disk;
use crate::math::elementary;
use building::Part;
use light::{Lamp, Probes};

/// Where the eye stands: in the middle way between the pews, under the vault's third bay.
pub const EYE: Vec3 = Vec3::new(0.0, 1.9, 0.0);

/// Rays per side of a pixel that is refined.
const REFINED: usize = 3;
/// Neighbors that differ by more than this ratio are refined.
const CONTRAST: f32 = 1.18;
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

/// Sines and cosines of sub-pixel positions are taken once per row and column.
struct Grid {
    width: usize,
    columns: Vec<(f64, f64)>,
}

/// Computes the map; `seed` varies stones and glass, not the building.
pub fn map<E: Send>(seed: u64, width: usize, check: impl Fn() -> Result<(), E> + Sync) -> Result<EnvMap, E> {
    let lamps = light::lamps();
    let interior = Interior { probes: Probes::gathered(&lamps, &check)?, lamps, seed };
    let grid = Grid::new(width);
    let starts = interior.tile_starts(width, &check)?;
    let coarse = interior.coarse(&grid, &starts, &check)?;
    let mut map = EnvMap::new(interior.refined(&grid, &starts, &coarse, &check)?);
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

impl Grid {
    fn new(width: usize) -> Self {
        let at = |index| elementary::sin_cos((index as f64 + 0.5) * std::f64::consts::TAU / (width * REFINED) as f64);
        Self { width, columns: (0..width * REFINED).map(at).collect() }
    }

    /// Direction of sub-pixel (x, y), of which there are `REFINED` a side in a pixel.
    fn direction(&self, x: usize, y: usize) -> Vec3 {
        let (sin_theta, cos_theta) = self.row(y);
        self.direction_in_row(x, sin_theta, cos_theta)
    }

    fn row(&self, y: usize) -> (f64, f64) {
        elementary::sin_cos((y as f64 + 0.5) * std::f64::consts::PI / (self.width / 2 * REFINED) as f64)
    }

    fn direction_in_row(&self, x: usize, sin_theta: f64, cos_theta: f64) -> Vec3 {
        let (sin_phi, cos_phi) = self.columns[x];
        Vec3::new((sin_theta * cos_phi) as f32, cos_theta as f32, (sin_theta * sin_phi) as f32)
    }
}

impl Interior {
    /// Distance that all rays of each tile may skip.
    fn tile_starts<E: Send>(&self, width: usize, check: impl Fn() -> Result<(), E> + Sync) -> Result<Vec<f32>, E> {
        let (columns, rows) = (width.div_ceil(TILE), (width / 2).div_ceil(TILE));
        // Half a tile's diagonal, and a little more for rounding.
        let spread = 0.72 * TILE as f32 * 2.0 * PI / width as f32;
        if spread > 0.3 {
            return Ok(vec![0.0; columns * rows]);
        }
        (0..columns * rows)
            .into_par_iter()
            .map(|index| {
                check()?;
                let middle = |tile: usize| (tile * TILE) as f64 + 0.5 * (TILE as f64 - 1.0);
                let theta = (middle(index / columns) + 0.5) * std::f64::consts::TAU / width as f64;
                let phi = (middle(index % columns) + 0.5) * std::f64::consts::TAU / width as f64;
                let direction = crate::light::envmap::direction_at(theta, phi).as_vec3();
                Ok(building::free_distance(EYE, direction, spread))
            })
            .collect()
    }

    /// One ray through the middle of each pixel.
    fn coarse<E: Send>(&self, grid: &Grid, starts: &[f32], check: impl Fn() -> Result<(), E> + Sync) -> Result<Vec<Vec3>, E> {
        const { assert!(REFINED % 2 == 1, "the middle ray goes through the pixel's center") };
        let middle = REFINED / 2;
        let mut pixels = vec![Vec3::ZERO; grid.width * grid.width / 2];
        pixels.par_chunks_mut(PIXELS_PER_CHECK.min(grid.width)).enumerate().try_for_each(|(part, pixels)| {
            check()?;
            for (offset, pixel) in pixels.iter_mut().enumerate() {
                let index = part * PIXELS_PER_CHECK.min(grid.width) + offset;
                let (x, y) = (index % grid.width, index / grid.width);
                let direction = grid.direction(x * REFINED + middle, y * REFINED + middle);
                *pixel = self.radiance(direction, start_of(starts, grid.width, x, y));
            }
            Ok(())
        })?;
        Ok(pixels)
    }

    /// The map: pixels that differ from a neighbor are means over a grid of rays.
    fn refined<E: Send>(&self, grid: &Grid, starts: &[f32], coarse: &[Vec3], check: impl Fn() -> Result<(), E> + Sync) -> Result<Raster, E> {
        let width = grid.width;
        let mut raster = Raster::filled(width, width / 2, [0.0; 3]);
        raster.pixels_mut().par_chunks_mut(PIXELS_PER_CHECK.min(width)).enumerate().try_for_each(|(part, pixels)| {
            check()?;
            for (offset, pixel) in pixels.iter_mut().enumerate() {
                let index = part * PIXELS_PER_CHECK.min(width) + offset;
                let (x, y) = (index % width, index / width);
                let color = if is_edge(coarse, width, x, y) {
                    self.mean_radiance(grid, x, y, start_of(starts, width, x, y), coarse[index])
                } else {
                    coarse[index]
                };
                *pixel = color.to_array();
            }
            Ok(())
        })?;
        Ok(raster)
    }

    fn mean_radiance(&self, grid: &Grid, x: usize, y: usize, start: f32, middle: Vec3) -> Vec3 {
        let mut sum = middle;
        for sub_y in 0..REFINED {
            for sub_x in 0..REFINED {
                if (sub_x, sub_y) != (REFINED / 2, REFINED / 2) {
                    sum += self.radiance(grid.direction(x * REFINED + sub_x, y * REFINED + sub_y), start);
                }
            }
        }
        sum / (REFINED * REFINED) as f32
    }

    /// Radiance that reaches the eye from `direction`.
    fn radiance(&self, direction: Vec3, start: f32) -> Vec3 {
        let t = building::trace(EYE, direction, start, FARTHEST).unwrap_or(FARTHEST);
        self.shaded(EYE, direction, t, true) + light::scattered(EYE, direction, t, &self.lamps)
    }

    /// Radiance towards the ray's origin of the surface at distance `t`; mirrors once.
    fn shaded(&self, origin: Vec3, direction: Vec3, t: f32, may_mirror: bool) -> Vec3 {
        let p = origin + direction * t;
        let part = building::part(p);
        if part == Part::Glass {
            if let Some(radiance) = light::glass_radiance(p, direction, self.seed) {
                return radiance;
            }
        }
        let n = building::normal(p, 0.001 + 2e-4 * t);
        let surface = surface::surface(part, p, n, self.seed);
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
        diffuse * (1.0 - share) + self.mirrored(lifted, direction, surface.normal) * share
    }

    fn mirrored(&self, p: Vec3, direction: Vec3, n: Vec3) -> Vec3 {
        let reflected = direction - 2.0 * direction.dot(n) * n;
        let t = building::trace(p, reflected, 0.0, FARTHEST).unwrap_or(FARTHEST);
        self.shaded(p, reflected, t, false)
    }
}

fn start_of(starts: &[f32], width: usize, x: usize, y: usize) -> f32 {
    starts[y / TILE * width.div_ceil(TILE) + x / TILE]
}

/// Whether a pixel differs from one of its neighbors so much that one ray is not enough.
fn is_edge(pixels: &[Vec3], width: usize, x: usize, y: usize) -> bool {
    let height = width / 2;
    let here = pixels[y * width + x];
    let beside = [(x + 1) % width, (x + width - 1) % width].map(|x| pixels[y * width + x]);
    let above = [y.saturating_sub(1), (y + 1).min(height - 1)].map(|y| pixels[y * width + x]);
    let sum = |color: Vec3| color.element_sum();
    beside.into_iter().chain(above).any(|there| sum(here) > CONTRAST * sum(there) || sum(there) > CONTRAST * sum(here))
}

/// Share of the light of far surroundings that reaches a corner or crevice.
///
/// Compares distances along the normal with what an open plane would have (Evans, "Fast
/// approximations for global illumination on dynamic scenes", 2006).
fn openness(p: Vec3, n: Vec3) -> f32 {
    let mut closed = 0.0;
    for (height, weight) in [(0.06, 1.0), (0.18, 0.75), (0.5, 0.45), (1.3, 0.28)] {
        closed += weight * (1.0 - building::distance(p + n * height) / (0.93 * height)).clamp(0.0, 1.0);
    }
    let open = 1.0 - closed / 2.48;
    open * open * 0.97 + 0.03
}

/// Schlick's approximation of Fresnel reflectance.
fn schlick(normal_reflectance: f32, cosine: f32) -> f32 {
    let m = (1.0 - cosine).clamp(0.0, 1.0);
    let m2 = m * m;
    normal_reflectance + (1.0 - normal_reflectance) * m2 * m2 * m
}

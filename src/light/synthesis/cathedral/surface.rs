//! What surfaces look like before light: albedo, unevenness, gloss.

use glam::{DVec3, Vec2, Vec3};

use crate::light::synthesis::cathedral::building::{self, Part};
use crate::math::noise::{fractal, lattice_uniform, perlin};

/// A surface under light.
#[derive(Debug, Clone, Copy)]
pub struct Surface {
    /// Diffuse reflectance.
    pub albedo: Vec3,
    /// Unit normal with the surface's unevenness.
    pub normal: Vec3,
    /// Reflectance at right angles of a polished coat; 0 for none.
    pub gloss: f32,
}

/// Mean albedo of a part, for light that has been reflected once already.
pub fn mean_albedo(part: Part) -> Vec3 {
    match part {
        Part::Floor => Vec3::new(0.13, 0.115, 0.095),
        Part::Web => Vec3::new(0.30, 0.265, 0.21),
        Part::Rib => Vec3::new(0.25, 0.215, 0.165),
        Part::Wall => Vec3::new(0.23, 0.195, 0.145),
        Part::Glass => Vec3::splat(0.04),
        Part::Wood => Vec3::new(0.085, 0.042, 0.018),
        Part::Iron => Vec3::splat(0.025),
        Part::Marble => Vec3::new(0.62, 0.60, 0.56),
        Part::Gold => Vec3::new(0.65, 0.42, 0.12),
    }
}

/// The surface of `part` at `p` with geometric normal `n`.
pub fn surface(part: Part, p: Vec3, n: Vec3, seed: u64) -> Surface {
    match part {
        Part::Floor => floor(p, n, seed),
        Part::Wall => ashlar(part, p, n, seed),
        Part::Web => courses(p, n, seed),
        Part::Rib => stained(part, p, n, 0.35, seed),
        Part::Wood => wood(p, n, seed),
        Part::Gold => Surface { gloss: 0.5, ..stained(part, p, n, 0.3, seed) },
        Part::Marble => Surface { gloss: 0.04, ..stained(part, p, n, 0.15, seed) },
        Part::Glass | Part::Iron => Surface { albedo: mean_albedo(part), normal: n, gloss: 0.0 },
    }
}

fn noise_at(p: Vec3, scale: f64, octaves: u32, seed: u64) -> f32 {
    fractal(p.as_dvec3() * scale, octaves, 0.55, seed) as f32
}

/// Weathered stone: large stains and fine grain.
fn stained(part: Part, p: Vec3, n: Vec3, amount: f32, seed: u64) -> Surface {
    let stain = noise_at(p, 0.8, 2, seed) + 0.6 * noise_at(p, 6.0, 1, seed ^ 1);
    let albedo = mean_albedo(part) * (1.0 + amount * 1.3 * stain).clamp(0.35, 1.7);
    Surface { albedo, normal: n, gloss: 0.0 }
}

/// A wall of squared stones with joints.
fn ashlar(part: Part, p: Vec3, n: Vec3, seed: u64) -> Surface {
    let across = if n.x.abs() > 0.8 { p.z } else { p.x + 0.37 * p.z };
    let course = (p.y / 0.42).floor();
    let length = 0.95;
    let shift = lattice_uniform(course as i32, 17, 0, seed);
    let block = (across / length + shift).floor();
    let q = Vec2::new((across / length + shift - block) * length, p.y - 0.42 * course);
    let to_joint = q.x.min(length - q.x).min(q.y).min(0.42 - q.y);
    let tone = 0.78 + 0.44 * lattice_uniform(course as i32, block as i32, (n.z > 0.0).into(), seed ^ 2);
    let joint = 1.0 - 0.45 * (1.0 - to_joint / 0.018).clamp(0.0, 1.0);
    let base = stained(part, p, n, 0.4, seed);
    let warmth = lattice_uniform(block as i32, course as i32, 5, seed) - 0.5;
    let tint = Vec3::new(1.0 + 0.06 * warmth, 1.0, 1.0 - 0.12 * warmth);
    Surface { albedo: base.albedo * tint * tone * joint, ..base }
}

/// A vault's web: thin courses of small stones, faintly seen through limewash.
fn courses(p: Vec3, n: Vec3, seed: u64) -> Surface {
    let height = (p.y / 0.28).floor();
    let to_joint = (p.y - 0.28 * height).min(0.28 * (height + 1.0) - p.y);
    let joint = 1.0 - 0.18 * (1.0 - to_joint / 0.03).clamp(0.0, 1.0);
    let tone = 0.93 + 0.14 * lattice_uniform(height as i32, (p.x / 0.8).floor() as i32, (p.z / 0.8).floor() as i32, seed);
    let base = stained(Part::Web, p, n, 0.3, seed);
    Surface { albedo: base.albedo * joint * tone, ..base }
}

/// Polished tiles set cornerwise, dark and light, with veins; a border of plain slabs along the piers.
fn floor(p: Vec3, n: Vec3, seed: u64) -> Surface {
    let size = 0.52;
    let out = p.z.abs();
    let is_border = (4.75..6.9).contains(&out) && p.x > building::EAST;
    let rotated = Vec2::new(p.x + p.z, p.x - p.z) * std::f32::consts::FRAC_1_SQRT_2;
    let q = (if is_border { Vec2::new(p.x, p.z) } else { rotated }) / (if is_border { 1.0 } else { size });
    let cell = q.floor();
    let (i, j) = (cell.x as i32, cell.y as i32);
    let inside = q - cell;
    let to_joint = inside.x.min(1.0 - inside.x).min(inside.y).min(1.0 - inside.y) * size;
    let drawn = lattice_uniform(i, j, 1, seed);
    let is_dark = !is_border && (i + j) % 2 != 0;
    // Veins: where a warped noise crosses zero. Every tile was cut elsewhere, hence the shift.
    let cut = DVec3::new(p.x as f64, drawn as f64 * 40.0, p.z as f64);
    let vein = (1.0 - 16.0 * perlin(cut * 2.6, seed ^ 3).abs() as f32).max(0.0);
    let cloud = 1.0 + 0.5 * noise_at(p + Vec3::Y * drawn * 30.0, 4.0, 1, seed ^ 5);
    let albedo = if is_dark {
        Vec3::new(0.022, 0.021, 0.023) * cloud * (0.8 + 0.4 * drawn) + Vec3::splat(0.05 * vein)
    } else if is_border {
        Vec3::new(0.15, 0.12, 0.09) * cloud * (0.85 + 0.3 * drawn)
    } else {
        Vec3::new(0.28, 0.25, 0.205) * cloud * (0.85 + 0.3 * drawn) * (1.0 - 0.22 * vein)
    };
    let is_joint = to_joint < 0.006;
    // Wear: tiles lie a little out of level and are waved by centuries of feet.
    let tilt = Vec2::new(lattice_uniform(i, j, 2, seed) - 0.5, lattice_uniform(i, j, 3, seed) - 0.5) * 0.012;
    let point = p.as_dvec3() * 2.3;
    let wave = Vec2::new(0.014, 0.006) * perlin(point, seed ^ 6) as f32;
    let normal = if n.y > 0.9 { (n + Vec3::new(tilt.x + wave.x, 0.0, tilt.y + wave.y)).normalize() } else { n };
    Surface { albedo: albedo * if is_joint { 0.45 } else { 1.0 }, normal, gloss: if is_joint || n.y < 0.9 { 0.0 } else { 0.045 } }
}

fn wood(p: Vec3, n: Vec3, seed: u64) -> Surface {
    let grain = noise_at(p * Vec3::new(9.0, 9.0, 0.8), 1.0, 2, seed);
    Surface { albedo: mean_albedo(Part::Wood) * (1.0 + 0.7 * grain), normal: n, gloss: 0.0 }
}

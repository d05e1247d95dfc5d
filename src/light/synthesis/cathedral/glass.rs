//! Stained glass: what daylight is left of at each place of each window.
//!
//! A window is two lights and an eye of stone tracery, filled with medallions on a ground of small
//! panes; the rose is wheels of petals. Colors are drawn per pane by hashing its integer place, so a
//! window looks the same at any resolution.

use glam::{Vec2, Vec3};

use crate::light::synthesis::cathedral::building::{self, Opening};
use crate::math::elementary;
use crate::math::noise::lattice_uniform;

/// One window of the building.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Window {
    /// A number that no other window has.
    pub number: i32,
    /// Which way it faces, as a unit vector from inside to outside.
    pub outward: Vec3,
    /// Place on the window: along the wall from its middle, and height.
    pub place: Vec2,
    /// Its outline; `None` is the rose.
    pub opening: Option<Opening>,
}

/// Mean transmittance of a window, its tracery included, for light that is not looked at pane by pane.
pub fn mean_transmittance(opening: Option<Opening>) -> Vec3 {
    match opening {
        Some(opening) if opening == building::CLERESTORY_WINDOW => Vec3::new(0.40, 0.32, 0.31),
        Some(_) => Vec3::new(0.36, 0.27, 0.32),
        None => Vec3::new(0.22, 0.16, 0.25),
    }
}

/// The window that a point on glass belongs to.
pub fn window_at(p: Vec3) -> Window {
    let bay = (p.x / building::BAY).round();
    let south = p.z > 0.0;
    let outward = Vec3::new(0.0, 0.0, if south { 1.0 } else { -1.0 });
    let number = 8 * bay as i32 + 4 * i32::from(south);
    let along = p.x - building::BAY * bay;
    if p.x < building::EAST {
        let (_, place, face) = building::apse_face(p);
        let angle_cosines = [Vec2::new(1.0, 0.0), Vec2::new(0.809, 0.588), Vec2::new(0.309, 0.951)];
        let side = if p.z < 0.0 { -1.0 } else { 1.0 };
        let facing = angle_cosines[face as usize];
        let outward = Vec3::new(-facing.x, 0.0, side * facing.y);
        let number = -1000 + (if face == 0 { 0 } else { face * side as i32 });
        let place = if face == 0 { p.z } else { place };
        Window { number, outward, place: Vec2::new(place, p.y), opening: Some(building::APSE_WINDOW) }
    } else if p.x > building::WEST {
        Window { number: 1000, outward: Vec3::X, place: Vec2::new(p.z, p.y), opening: None }
    } else if p.z.abs() > 8.0 {
        Window { number, outward, place: Vec2::new(along, p.y), opening: Some(building::AISLE_WINDOW) }
    } else {
        Window { number: number + 1, outward, place: Vec2::new(along, p.y), opening: Some(building::CLERESTORY_WINDOW) }
    }
}

impl Window {
    /// Share of daylight that comes through at `place`; `None` where stone or iron stands before the glass.
    pub fn transmittance(&self, seed: u64) -> Option<Vec3> {
        match self.opening {
            Some(opening) => lancet(self, &opening, seed),
            None => rose(self, seed),
        }
    }
}

fn lancet(window: &Window, opening: &Opening, seed: u64) -> Option<Vec3> {
    let Vec2 { x, y } = window.place;
    let arch = opening.arch;
    let outline = opening.distance(x.abs(), y);
    let eye = eye_of(opening);
    let from_eye = Vec2::new(x, y - eye.1).length() - eye.0;
    let light = building::Arch { half_span: 0.5 * arch.half_span, overshoot: 0.5 * arch.half_span, spring: arch.spring - 0.25 };
    let from_light = light.distance((x.abs() - 0.5 * arch.half_span).abs(), y);
    let is_mullion = x.abs() < 0.07 && y < arch.spring + 0.4;
    let is_bar = from_light < 0.0 && (y / 0.75).fract() < 0.035;
    if outline > -0.07 || is_mullion || from_eye.abs() < 0.06 || from_light.abs() < 0.05 || is_bar {
        return None;
    }
    if from_eye < 0.0 {
        return flower(window, Vec2::new(x, y - eye.1), eye.0, seed);
    }
    if from_light > 0.0 {
        return Some(palette(0.1 + 0.2 * pane(window, 7, (x > 0.0).into(), seed)) * 0.8);
    }
    Some(medallions(window, x.abs() - 0.5 * arch.half_span, 0.5 * arch.half_span, seed))
}

/// Radius and height of the round light over the two pointed ones.
fn eye_of(opening: &Opening) -> (f32, f32) {
    let Opening { arch, .. } = opening;
    (0.4 * arch.half_span, arch.spring + 0.78 * arch.half_span)
}

/// A light's filling: a border, round medallions in warm colors, and a ground of small blue and red panes.
fn medallions(window: &Window, x: f32, half_width: f32, seed: u64) -> Vec3 {
    let (side, y) = (i32::from(window.place.x > 0.0), window.place.y);
    let into_border = half_width - x.abs() - 0.05;
    if into_border < 0.09 {
        let along = (y / 0.16).floor() as i32;
        return palette(if along % 2 == 0 { 0.33 } else { 0.87 }) * shade(window, along, 3 + side, seed);
    }
    let pitch = 1.9 * half_width;
    let index = (y / pitch).round();
    let local = Vec2::new(x, y - pitch * index);
    let radius = 0.72 * half_width;
    let index = index as i32;
    if (local.length() - radius).abs() < 0.035 {
        return palette(0.95) * 0.9;
    }
    if local.length() < radius {
        return scene(window, local / radius, 16 * index + side, seed);
    }
    let (i, j) = (((x + y) / 0.17).floor() as i32, ((x - y) / 0.17).floor() as i32);
    let drawn = pane(window, i, j, seed);
    let is_grisaille = window.opening == Some(building::CLERESTORY_WINDOW);
    let color =
        if is_grisaille && drawn < 0.85 { Vec3::new(0.56, 0.64, 0.48) } else { palette(if (i + j) % 2 == 0 { 0.15 } else { 0.5 * drawn }) };
    color * shade(window, i, j, seed)
}

/// A few figures before a deep ground: upright robes with heads.
fn scene(window: &Window, q: Vec2, index: i32, seed: u64) -> Vec3 {
    let figure = ((q.x + 0.9) / 0.6).floor() as i32;
    let middle = 0.6 * (figure as f32 + 0.5) - 0.9;
    let tall = 0.35 * (pane(window, figure, index, seed) - 0.5);
    let x = (q.x - middle).abs();
    let head = Vec2::new(x, q.y - 0.3 - tall).length();
    let robe = x - 0.09 - 0.12 * (0.2 + tall - q.y).clamp(0.0, 1.0);
    let drawn = |salt| pane(window, figure + salt, 3 * index + salt, seed);
    if head < 0.12 {
        Vec3::new(0.85, 0.62, 0.42)
    } else if head < 0.2 {
        palette(0.9)
    } else if robe < 0.0 && q.y < 0.2 + tall {
        palette(drawn(5)) * shade(window, figure, (q.y * 5.0).floor() as i32, seed)
    } else {
        palette(if index & 16 == 0 { 0.13 } else { 0.5 }) * shade(window, (q.x * 6.0).floor() as i32, (q.y * 6.0).floor() as i32, seed)
    }
}

/// The filling of a round light: six petals about a center.
fn flower(window: &Window, q: Vec2, radius: f32, seed: u64) -> Option<Vec3> {
    let r = q.length() / radius;
    let (petal, across) = sector(q, 6);
    if r < 0.28 {
        return Some(palette(0.9));
    }
    let lobe = Vec2::new(across, q.length() - 0.62 * radius).length() - 0.27 * radius;
    Some(if lobe < 0.0 { palette(0.45 + 0.1 * pane(window, petal, 11, seed)) } else { palette(0.14) * 0.9 })
}

/// The rose: a center, twelve petals with pointed heads, a rim of roundels.
fn rose(window: &Window, seed: u64) -> Option<Vec3> {
    let (height, radius) = building::ROSE;
    let q = window.place - Vec2::new(0.0, height);
    let r = q.length() / radius;
    let hub = (r - 0.2).abs();
    if r > 0.97 || hub < 0.022 || (r - 0.62).abs() < 0.016 {
        return None;
    }
    if r < 0.2 {
        return flower(window, q, 0.2 * radius, seed);
    }
    let (spoke, across) = sector(q, 12);
    let half = 0.267_949 * q.length();
    if half - across.abs() < 0.055 && r < 0.75 {
        return None;
    }
    if r < 0.62 {
        let head = Vec2::new(across, q.length() - 0.47 * radius).length() - 0.12 * radius;
        if head.abs() < 0.05 {
            return None;
        }
        let ring = ((r - 0.2) / 0.05).floor() as i32;
        let hue = if head < 0.0 { 0.45 + 0.12 * pane(window, spoke, 2, seed) } else { 0.1 + 0.15 * pane(window, spoke, ring, seed) };
        return Some(palette(if ring == 2 { 0.92 } else { hue }) * shade(window, spoke, ring, seed));
    }
    // Twenty-four roundels on the rim, half a step turned against the petals.
    let (roundel, across) = sector(q, 24);
    let disk = Vec2::new(across, q.length() - 0.81 * radius).length() - 0.085 * radius;
    if disk.abs() < 0.045 {
        return None;
    }
    let hue = if disk < 0.0 { [0.15, 0.5, 0.9, 0.66][(roundel % 4) as usize] } else { 0.13 };
    Some(palette(hue) * shade(window, roundel, 40, seed))
}

/// Which of `count` equal sectors holds `q`, and how far `q` lies from that sector's middle line.
fn sector(q: Vec2, count: i32) -> (i32, f32) {
    let turn = std::f64::consts::TAU / f64::from(count);
    let index = (elementary::atan2(f64::from(q.y), f64::from(q.x)) / turn).round();
    let (sine, cosine) = elementary::sin_cos(index * turn);
    let across = -q.x * sine as f32 + q.y * cosine as f32;
    ((index as i32).rem_euclid(count), across)
}

/// Number in [0, 1) of pane (i, j).
fn pane(window: &Window, i: i32, j: i32, seed: u64) -> f32 {
    lattice_uniform(i, j, window.number, seed)
}

/// Hand-made glass is uneven: a factor about one.
fn shade(window: &Window, i: i32, j: i32, seed: u64) -> f32 {
    0.65 + 0.7 * lattice_uniform(i, j, window.number, seed ^ 0x5eed)
}

/// Colors of old glass by a number in [0, 1): mostly blue and ruby, some green, amber, violet, white.
fn palette(hue: f32) -> Vec3 {
    match (hue * 16.0) as i32 {
        0..=2 => Vec3::new(0.03, 0.22, 0.56),
        3 => Vec3::new(0.06, 0.38, 0.68),
        4 => Vec3::new(0.16, 0.50, 0.70),
        5 => Vec3::new(0.62, 0.05, 0.10),
        6 => Vec3::new(0.20, 0.50, 0.25),
        7 | 8 => Vec3::new(0.85, 0.07, 0.03),
        9 => Vec3::new(0.78, 0.40, 0.10),
        10 => Vec3::new(0.09, 0.42, 0.14),
        11 => Vec3::new(0.30, 0.55, 0.22),
        12 => Vec3::new(0.22, 0.30, 0.44),
        13 => Vec3::new(0.90, 0.50, 0.08),
        14 => Vec3::new(0.95, 0.72, 0.20),
        _ => Vec3::new(0.92, 0.88, 0.74),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Mean of a window's transmittance over a fine grid of its opening.
    fn measured(opening: Option<Opening>, number: i32) -> Vec3 {
        let (mut sum, mut count) = (Vec3::ZERO, 0.0);
        for i in 0..400 {
            for j in 0..800 {
                let (across, y) = (-3.5 + 7.0 * i as f32 / 400.0, 1.0 + 17.0 * j as f32 / 800.0);
                let is_inside = match opening {
                    Some(opening) => opening.distance(across.abs(), y) < 0.0,
                    None => Vec2::new(across, y - building::ROSE.0).length() < building::ROSE.1,
                };
                if is_inside {
                    let window = Window { number, outward: Vec3::X, place: Vec2::new(across, y), opening };
                    sum += window.transmittance(0).unwrap_or(Vec3::ZERO);
                    count += 1.0;
                }
            }
        }
        sum / count
    }

    #[test]
    fn mean_transmittances_are_those_of_the_panes() {
        for opening in [Some(building::CLERESTORY_WINDOW), Some(building::AISLE_WINDOW), Some(building::APSE_WINDOW), None] {
            let mean = (0..12).map(|number| measured(opening, number)).sum::<Vec3>() / 12.0;
            let stated = mean_transmittance(opening);
            // Windows differ by what is drawn; two decimals of a typical one are stated.
            assert!((mean - stated).abs().max_element() < 0.03, "{opening:?}: {mean} stated as {stated}");
        }
    }
}

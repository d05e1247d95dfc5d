//! Light in the building: daylight through glass, a low sun in colored pools, lamps, and what walls send back.
//!
//! Direct sun is exact up to the sun's width. Everything diffuse comes from probes: irradiance for six
//! directions at the points of a coarse grid, gathered by rays in two bounces (after Greger, Shirley,
//! Hubbard, Greenberg, "The irradiance volume", 1998, with the six-sided basis of McTaggart, 2004).

use std::f32::consts::PI;

use glam::{DVec3, Vec2, Vec3};
use rayon::prelude::*;

use crate::light::synthesis::cathedral::building::{self, Hit, Opening, Part};
use crate::light::synthesis::cathedral::glass::{self, Window};
use crate::light::synthesis::cathedral::surface;
use crate::math::elementary;

/// Unit direction towards the sun: south (+z), high, a little west.
pub const TO_SUN: Vec3 = Vec3::new(0.248_069, 0.847_569, 0.469_180);
/// Irradiance of the sun on a surface that faces it, before the glass.
const SUN: Vec3 = Vec3::new(125.0, 108.0, 80.0);
/// Intensity of one chandelier, as a point far away.
const CHANDELIER: Vec3 = Vec3::new(62.0, 34.0, 13.0);
/// Intensity of the altar's candles together.
const ALTAR: Vec3 = Vec3::new(30.0, 15.5, 5.5);
/// Dust in the air: scattering per meter. Light is scattered evenly to all sides.
const DUST: f32 = 0.0065;
/// What light there is where none of the above reaches.
const REST: Vec3 = Vec3::new(0.006, 0.0055, 0.006);

/// A lamp as far surfaces see it.
#[derive(Debug, Clone, Copy)]
pub struct Lamp {
    /// Where it is.
    pub position: Vec3,
    /// Radiant intensity.
    pub intensity: Vec3,
}

/// All lamps of the building.
pub fn lamps() -> Vec<Lamp> {
    let chandeliers =
        [-18.0, -6.0, 6.0].map(|x| Lamp { position: Vec3::new(x, building::CHANDELIER_HEIGHT + 0.25, 0.0), intensity: CHANDELIER });
    let altar = [-1.2, 1.2].map(|z| Lamp { position: Vec3::new(-29.0, 2.35, z), intensity: 0.5 * ALTAR });
    chandeliers.into_iter().chain(altar).collect()
}

/// A small flame or filament, and how bright it is.
#[derive(Debug, Clone, Copy)]
pub struct Flame {
    /// Where it is.
    pub position: Vec3,
    /// Its radius in meters.
    pub radius: f32,
    /// Its radiance.
    pub radiance: Vec3,
}

/// The flames that are seen where [`lamps`] give light; each lamp's flames have its intensity together.
pub fn flames() -> Vec<Flame> {
    let mut flames = Vec::new();
    for x in [-18.0, -6.0, 6.0] {
        let center = Vec3::new(x, building::CHANDELIER_HEIGHT, 0.0);
        let (outer, inner) = (12, 6);
        for (count, radius, height) in [(outer, building::CHANDELIER_RADIUS, 0.2), (inner, 0.55, 0.78)] {
            for index in 0..count {
                let (sine, cosine) = elementary::sin_cos((f64::from(index) + 0.5) * std::f64::consts::TAU / f64::from(count));
                let position = center + Vec3::new(radius * cosine as f32, height, radius * sine as f32);
                flames.push(flame(position, 0.012, CHANDELIER / (outer + inner) as f32));
            }
        }
    }
    for z in [-1.5, -1.2, -0.9, 0.9, 1.2, 1.5] {
        flames.push(flame(Vec3::new(-29.2, 2.35 + 0.15 * (1.5 - f32::abs(z)), z), 0.014, ALTAR / 6.0));
    }
    flames
}

/// A sphere of that intensity: L pi r^2 = I.
fn flame(position: Vec3, radius: f32, intensity: Vec3) -> Flame {
    Flame { position, radius, radiance: intensity / (PI * radius * radius) }
}

/// Radiance of the daylight behind a window, as seen from inside in direction `view`: bright above, dim towards the ground.
pub fn daylight(window: &Window, view: Vec3) -> Vec3 {
    let sky = Vec3::new(28.0, 31.0, 35.5) * (0.62 + 0.5 * view.y.clamp(-0.4, 1.0));
    let near_sun = window.outward.dot(TO_SUN).max(0.0);
    sky + Vec3::new(40.0, 34.0, 24.0) * near_sun
}

/// Radiance of a window at a point of its glass, pane by pane; tracery is dark.
pub fn glass_radiance(p: Vec3, view: Vec3, seed: u64) -> Option<Vec3> {
    let window = glass::window_at(p);
    window.transmittance(seed).map(|transmittance| transmittance * daylight(&window, view))
}

/// Irradiance of the sun at `p` for a surface that faces it; zero in shadow.
///
/// `panes` gives the transmittance of a window, fine or mean.
pub fn sun(p: Vec3, panes: impl Fn(&Window) -> Option<Vec3>) -> Vec3 {
    for (plane, opening) in [(building::CLERESTORY_GLASS, building::CLERESTORY_WINDOW), (building::AISLE_GLASS, building::AISLE_WINDOW)] {
        let t = (plane + 0.01 - p.z) / TO_SUN.z;
        if t <= 0.05 {
            continue;
        }
        let q = p + TO_SUN * t;
        let is_glass = q.x > building::EAST && q.x < building::WEST && opening.distance(building::fold_bay(q.x), q.y) < 0.0;
        if !is_glass {
            continue;
        }
        let Some(transmittance) = panes(&glass::window_at(q)) else { continue };
        if building::trace(p, TO_SUN, 0.03, t - 0.25).is_none() {
            return SUN * transmittance;
        }
    }
    Vec3::ZERO
}

/// Light that dust scatters towards the eye along a ray: beams below the windows, halos about the lamps.
///
/// Both integrals are exact for light that is not weakened on its way: a beam is a box sheared along the
/// sun's direction, and about a lamp the integral of I / d^2 along a line is I times the angle the line
/// spans at the lamp over its distance from the lamp.
pub fn scattered(origin: Vec3, direction: Vec3, length: f32, lamps: &[Lamp]) -> Vec3 {
    let phase = DUST / (4.0 * PI);
    let mut sum = Vec3::ZERO;
    for beams in [&CLERESTORY_BEAMS, &AISLE_BEAMS] {
        sum += SUN * glass::mean_transmittance(Some(beams.opening)) * beams.length(origin, direction, length);
    }
    for lamp in lamps {
        let to_lamp = lamp.position - origin;
        let along = to_lamp.dot(direction);
        let beside = (to_lamp - direction * along).length().max(0.12);
        let turn = elementary::atan2(f64::from(length * beside), f64::from(beside * beside - along * (length - along)));
        let angle = if turn < 0.0 { turn + std::f64::consts::TAU } else { turn };
        sum += lamp.intensity * (angle as f32 / beside);
    }
    sum * phase
}

/// The beams of a row of windows: two to each, since the mullion parts it.
struct Beams {
    opening: Opening,
    /// z of the glass.
    plane: f32,
    /// Where the beams lie in z: from the wall that stops them to the face of their own.
    reach: (f32, f32),
}

const CLERESTORY_BEAMS: Beams = Beams {
    opening: building::CLERESTORY_WINDOW,
    plane: building::CLERESTORY_GLASS,
    reach: (-building::NAVE_HALF_WIDTH, building::NAVE_HALF_WIDTH),
};
const AISLE_BEAMS: Beams =
    Beams { opening: building::AISLE_WINDOW, plane: building::AISLE_GLASS, reach: (building::NAVE_HALF_WIDTH, building::OUTER_HALF_WIDTH) };

impl Beams {
    /// Length of the parts of a ray that lie in these beams.
    fn length(&self, origin: Vec3, direction: Vec3, length: f32) -> f32 {
        // The place on the glass that the sun's ray through a point of our ray comes from is linear in t.
        let slope = Vec2::new(TO_SUN.x, TO_SUN.y) / TO_SUN.z;
        let start = Vec2::new(origin.x, origin.y) + slope * (self.plane - origin.z);
        let speed = Vec2::new(direction.x, direction.y) - slope * direction.z;
        let height = (self.opening.sill, self.opening.arch.spring + 0.6);
        let within = clipped((0.0, length), origin.z, direction.z, self.reach);
        let (from, to) = clipped(within, start.y, speed.y, height);
        if from >= to {
            return 0.0;
        }
        let half_light = 0.45 * self.opening.arch.half_span;
        let middles = (-4..=2).flat_map(|bay| [-0.5, 0.5].map(|side| building::BAY * bay as f32 + side * self.opening.arch.half_span));
        middles
            .map(|middle| {
                let (from, to) = clipped((from, to), start.x, speed.x, (middle - half_light, middle + half_light));
                (to - from).max(0.0)
            })
            .sum()
    }
}

/// The part of the interval `from..to` of t in which `value + rate t` is between the two bounds.
fn clipped((from, to): (f32, f32), value: f32, rate: f32, (low, high): (f32, f32)) -> (f32, f32) {
    // A rate of almost nothing is made a little something: the bounds are then far away, on the right sides.
    let inverse = 1.0 / if rate.abs() < 1e-6 { 1e-6 } else { rate };
    let (a, b) = ((low - value) * inverse, (high - value) * inverse);
    (from.max(a.min(b)), to.min(a.max(b)))
}

/// Rays that each probe gathers with.
const GATHER_COUNT: usize = 128;
/// Lowest corner, spacing and number of the probes.
const GRID_ORIGIN: Vec3 = Vec3::new(-32.0, 0.7, -10.2);
const GRID_SPACING: Vec3 = Vec3::new(3.0, 2.45, 1.7);
const GRID_COUNT: [usize; 3] = [16, 8, 13];

/// Irradiance at one point.
#[derive(Debug, Clone, Copy)]
struct Probe {
    /// For the six directions +x -x +y -y +z -z.
    sides: [Vec3; 6],
    /// What it counts beside others: 1 in air, little inside stone, where it only repeats its neighbors.
    weight: f32,
}

const DARK: Probe = Probe { sides: [Vec3::ZERO; 6], weight: 1.0 };

/// Diffuse light throughout the building.
pub struct Probes {
    probes: Vec<Probe>,
}

/// What one ray of a probe has met.
struct Gathered {
    direction: Vec3,
    point: Vec3,
    normal: Vec3,
    albedo: Vec3,
    /// Radiance towards the probe without any light that was reflected before.
    direct: Vec3,
}

impl Probes {
    /// Gathers the light of windows, sun and lamps with two bounces.
    ///
    /// `check` is asked before each probe.
    pub fn gathered<E: Send>(lamps: &[Lamp], check: impl Fn() -> Result<(), E> + Sync) -> Result<Self, E> {
        let directions = even_directions(GATHER_COUNT);
        let count = GRID_COUNT.iter().product::<usize>();
        let hits: Vec<Option<Vec<Gathered>>> = (0..count)
            .into_par_iter()
            .map(|index| {
                check()?;
                let position = position_of(index);
                let is_air = building::distance(position) > 0.08;
                Ok(is_air.then(|| directions.iter().map(|&direction| gather(position, direction)).collect()))
            })
            .collect::<Result<_, E>>()?;
        let mut field = Self { probes: vec![DARK; count] };
        for _bounce in 0..3 {
            check()?;
            let sums = |(index, hits): (usize, &Option<Vec<Gathered>>)| Some(field.summed(position_of(index), hits.as_deref()?, lamps));
            let gathered: Vec<Option<Probe>> = hits.par_iter().enumerate().map(sums).collect();
            field = Self { probes: filled_from_neighbors(gathered) };
        }
        Ok(field)
    }

    /// Irradiance at `p` on a surface with normal `n`.
    pub fn irradiance(&self, p: Vec3, n: Vec3) -> Vec3 {
        // A step off the wall, so that probes behind it weigh less.
        let lifted = p + n * 0.5;
        let place = ((lifted - GRID_ORIGIN) / GRID_SPACING).max(Vec3::ZERO);
        let last = Vec3::new(GRID_COUNT[0] as f32 - 1.001, GRID_COUNT[1] as f32 - 1.001, GRID_COUNT[2] as f32 - 1.001);
        let place = place.min(last);
        let cell = place.floor();
        let f = place - cell;
        let (mut sum, mut weights) = (Vec3::ZERO, 0.0);
        for corner in 0..8_usize {
            let [i, j, k] = [corner & 1, corner >> 1 & 1, corner >> 2];
            let index = ((cell.x as usize + i) * GRID_COUNT[1] + cell.y as usize + j) * GRID_COUNT[2] + cell.z as usize + k;
            let probe = &self.probes[index];
            let pick = |upper: usize, f: f32| if upper == 1 { f } else { 1.0 - f };
            let height = (position_of(index) - p).dot(n);
            let facing = 0.5 + 0.5 * height / (height.abs() + 1.0);
            let weight = pick(i, f.x) * pick(j, f.y) * pick(k, f.z) * (facing * facing + 0.01) * probe.weight;
            sum += projected(&probe.sides, n) * weight;
            weights += weight;
        }
        REST + sum / weights
    }

    fn summed(&self, position: Vec3, hits: &[Gathered], lamps: &[Lamp]) -> Probe {
        let mut sides = [Vec3::ZERO; 6];
        let weight = 4.0 * PI / hits.len() as f32;
        for hit in hits {
            let radiance = hit.direct + hit.albedo / PI * self.irradiance(hit.point, hit.normal);
            add(&mut sides, hit.direction, radiance * weight);
        }
        for lamp in lamps {
            let to_lamp = lamp.position - position;
            let distance = to_lamp.length();
            let is_near = distance < 30.0 && building::trace(position, to_lamp / distance, 0.0, distance - 0.5).is_none();
            if is_near {
                add(&mut sides, to_lamp / distance, lamp.intensity / (distance * distance).max(1.0));
            }
        }
        Probe { sides, weight: 1.0 }
    }
}

/// Gives probes inside stone the mean of their neighbors, so that between probes light varies without a step.
fn filled_from_neighbors(mut probes: Vec<Option<Probe>>) -> Vec<Probe> {
    let [_, rows, columns] = GRID_COUNT;
    for weight in [0.08, 0.02, 0.005] {
        let before = probes.clone();
        for (index, probe) in probes.iter_mut().enumerate().filter(|(_, probe)| probe.is_none()) {
            let place = [index / (rows * columns), index / columns % rows, index % columns];
            let (mut sides, mut count) = ([Vec3::ZERO; 6], 0.0);
            for (axis, stride) in [rows * columns, columns, 1].into_iter().enumerate() {
                let below = (place[axis] > 0).then(|| before[index - stride]).flatten();
                let above = (place[axis] + 1 < GRID_COUNT[axis]).then(|| before[index + stride]).flatten();
                for neighbor in below.into_iter().chain(above) {
                    sides = std::array::from_fn(|side| sides[side] + neighbor.sides[side]);
                    count += 1.0;
                }
            }
            if count > 0.0 {
                *probe = Some(Probe { sides: sides.map(|side| side / count), weight });
            }
        }
    }
    probes.into_iter().map(|probe| probe.unwrap_or(Probe { weight: 0.001, ..DARK })).collect()
}

fn gather(position: Vec3, direction: Vec3) -> Gathered {
    let Hit { t, part } = building::trace(position, direction, 0.0, 80.0).unwrap_or(Hit { t: 80.0, part: Part::Wall });
    let point = position + direction * t;
    let albedo = surface::mean_albedo(part);
    let normal = building::normal(point, 0.02);
    let direct = if part == Part::Glass {
        {
            let window = glass::window_at(point);
            glass::mean_transmittance(window.opening) * daylight(&window, direction)
        }
    } else {
        let cosine = normal.dot(TO_SUN);
        if cosine > 0.0 {
            albedo / PI * cosine * sun(point + normal * 0.02, |window| Some(glass::mean_transmittance(window.opening)))
        } else {
            Vec3::ZERO
        }
    };
    Gathered { direction, point, normal, albedo, direct }
}

fn add(sides: &mut [Vec3; 6], direction: Vec3, irradiance: Vec3) {
    for (axis, component) in direction.to_array().into_iter().enumerate() {
        sides[2 * axis + usize::from(component < 0.0)] += irradiance * component.abs();
    }
}

/// Irradiance on normal n: the sides that n looks at, weighted by the squares of its components.
fn projected(sides: &[Vec3; 6], n: Vec3) -> Vec3 {
    (0..3).map(|axis| sides[2 * axis + usize::from(n[axis] < 0.0)] * (n[axis] * n[axis])).sum()
}

fn position_of(index: usize) -> Vec3 {
    let [_, rows, columns] = GRID_COUNT;
    let place = Vec3::new((index / (rows * columns)) as f32, (index / columns % rows) as f32, (index % columns) as f32);
    GRID_ORIGIN + place * GRID_SPACING
}

/// Directions spread evenly over the sphere: a spiral of golden angles (Gonzalez 2010).
fn even_directions(count: usize) -> Vec<Vec3> {
    let golden = std::f64::consts::PI * (3.0 - 5.0_f64.sqrt());
    (0..count)
        .map(|index| {
            let y = 1.0 - (2 * index + 1) as f64 / count as f64;
            let (sine, cosine) = elementary::sin_cos(golden * index as f64);
            let radius = (1.0 - y * y).sqrt();
            DVec3::new(radius * cosine, y, radius * sine).as_vec3()
        })
        .collect()
}

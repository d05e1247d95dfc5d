//! A photographer's room: softboxes over a dark floor, between dark walls.
//!
//! The eye is in the middle, where the object would stand. Walls and floor are diffuse and lit by every
//! box exactly (Lambert's formula for polygons, 1760, cut at the surface's horizon), once, without shadows.

use std::f64::consts::PI;

use glam::DVec3;

use crate::light::envmap::{self, EnvMap};
use crate::light::synthesis::{Rgb, filled, single};
use crate::math::elementary;

/// Half the room's size; the eye stands at the origin, the floor 1.3 m below it.
const ROOM_LOW: DVec3 = DVec3::new(-4.5, -1.3, -4.0);
const ROOM_HIGH: DVec3 = DVec3::new(4.5, 2.9, 4.0);
/// Light from what the boxes' light has met more than once.
const AMBIENT: Rgb = [0.010, 0.010, 0.011];
/// Rays a side for a pixel near a box.
const RAYS: usize = 4;

/// A rectangle of cloth with lamps behind.
#[derive(Debug, Clone, Copy)]
struct Softbox {
    center: DVec3,
    /// From the center to the middle of an upright side, and to the middle of the top.
    half_width: DVec3,
    half_height: DVec3,
    /// Radiance in the middle.
    radiance: Rgb,
}

/// How much darker the corners of the cloth are than its middle.
const FALL_OFF: f64 = 0.45;

impl Softbox {
    /// A box that faces the eye.
    fn new(center: [f64; 3], width: f64, height: f64, radiance: Rgb) -> Self {
        let center = DVec3::from_array(center);
        let towards = -center.normalize();
        let side = if towards.y.abs() > 0.9 { DVec3::X } else { DVec3::Y.cross(towards).normalize() };
        let up = towards.cross(side);
        Self { center, half_width: side * (0.5 * width), half_height: up * (0.5 * height), radiance }
    }

    fn corners(&self) -> [DVec3; 4] {
        let (u, v) = (self.half_width, self.half_height);
        [self.center - u - v, self.center + u - v, self.center + u + v, self.center - u + v]
    }

    /// Distance and brightness (1 in the middle) where a ray from the eye meets the cloth.
    fn hit(&self, direction: DVec3) -> Option<(f64, f64)> {
        let normal = self.half_width.cross(self.half_height);
        let cosine = direction.dot(normal);
        let distance = if cosine == 0.0 { return None } else { self.center.dot(normal) / cosine };
        let place = direction * distance - self.center;
        let u = place.dot(self.half_width) / self.half_width.length_squared();
        let v = place.dot(self.half_height) / self.half_height.length_squared();
        let is_inside = distance > 0.0 && u.abs() <= 1.0 && v.abs() <= 1.0;
        is_inside.then_some((distance, 1.0 - FALL_OFF * 0.5 * (u * u + v * v)))
    }

    /// Irradiance at `p` with normal `n` for unit radiance; the cloth's mean brightness included.
    fn irradiance(&self, p: DVec3, n: DVec3) -> f64 {
        // The mean of (u^2 + v^2) / 2 over the square is 1 / 3.
        let mean = 1.0 - FALL_OFF / 3.0;
        let is_front = (p - self.center).dot(-self.center) > 0.0;
        if is_front { mean * polygon_irradiance(&self.corners(), p, n) } else { 0.0 }
    }
}

/// Lambert's formula: half the sum over the edges of the angle an edge spans times the cosine of its plane's normal.
fn polygon_irradiance(corners: &[DVec3; 4], p: DVec3, n: DVec3) -> f64 {
    let mut clipped: [DVec3; 8] = [DVec3::ZERO; 8];
    let mut count = 0;
    for index in 0..4 {
        let (a, b) = (corners[index] - p, corners[(index + 1) % 4] - p);
        let (height_a, height_b) = (a.dot(n), b.dot(n));
        if height_a >= 0.0 {
            clipped[count] = a.normalize_or(n);
            count += 1;
        }
        if (height_a >= 0.0) != (height_b >= 0.0) {
            clipped[count] = (a + (b - a) * (height_a / (height_a - height_b))).normalize_or(n);
            count += 1;
        }
    }
    let mut sum = 0.0;
    for index in 0..count {
        let (a, b) = (clipped[index], clipped[(index + 1) % count]);
        let cross = a.cross(b);
        let sine = cross.length();
        if sine > 0.0 {
            sum += elementary::atan2(sine, a.dot(b)) * cross.dot(n) / sine;
        }
    }
    0.5 * sum.abs()
}

fn softboxes() -> [Softbox; 5] {
    [
        // Key from the upper left of the middle, fill from the right, two strips behind, a large one overhead.
        Softbox::new([-2.2, 1.5, 2.3], 1.6, 1.2, [62.0, 57.0, 50.0]),
        Softbox::new([-2.6, 0.5, -2.4], 1.2, 1.8, [8.5, 9.4, 11.0]),
        Softbox::new([3.0, 0.7, 1.6], 0.35, 2.2, [34.0, 37.0, 44.0]),
        Softbox::new([3.1, 0.6, -1.3], 0.35, 2.2, [95.0, 82.0, 62.0]),
        Softbox::new([0.2, 2.6, 0.1], 2.2, 1.3, [18.0, 18.0, 18.0]),
    ]
}

/// Computes the map.
pub fn map<E: Send>(width: usize, check: impl Fn() -> Result<(), E> + Sync) -> Result<EnvMap, E> {
    let boxes = softboxes();
    filled(width, check, |x, y| single(pixel(&boxes, width, x, y)))
}

fn pixel(boxes: &[Softbox], width: usize, x: usize, y: usize) -> Rgb {
    let angle = 2.0 * PI / width as f64;
    let direction_to = |dx: f64, dy: f64| envmap::direction_at((y as f64 + dy) * angle, (x as f64 + dx) * angle);
    let center = direction_to(0.5, 0.5);
    let room = room_radiance(boxes, center);
    // A pixel's diagonal is shorter than its height times the root of two.
    let is_near = |softbox: &Softbox| {
        let reach = (softbox.half_width + softbox.half_height).length() / softbox.center.length() + angle;
        (center - softbox.center.normalize()).length() < reach
    };
    if !boxes.iter().any(is_near) {
        return room;
    }
    let mut sum = [0.0; 3];
    for ray in 0..RAYS * RAYS {
        let place = |index: usize| (index as f64 + 0.5) / RAYS as f64;
        let direction = direction_to(place(ray % RAYS), place(ray / RAYS));
        let hits = boxes.iter().filter_map(|softbox| softbox.hit(direction).map(|(distance, share)| (distance, softbox, share)));
        let seen = hits.min_by(|a, b| a.0.total_cmp(&b.0)).map_or(room, |(_, softbox, share)| softbox.radiance.map(|value| value * share));
        sum = std::array::from_fn(|c| sum[c] + seen[c]);
    }
    sum.map(|channel| channel / (RAYS * RAYS) as f64)
}

/// Radiance of the walls, floor and ceiling, boxes left out.
fn room_radiance(boxes: &[Softbox], direction: DVec3) -> Rgb {
    let distances = DVec3::from_array(std::array::from_fn(|axis| {
        let wall = if direction[axis] < 0.0 { ROOM_LOW[axis] } else { ROOM_HIGH[axis] };
        if direction[axis] == 0.0 { f64::INFINITY } else { wall / direction[axis] }
    }));
    let distance = distances.min_element();
    let axis = (0..3).find(|&axis| distances[axis] == distance).unwrap_or(0);
    let mut normal = DVec3::ZERO;
    normal[axis] = if direction[axis] < 0.0 { 1.0 } else { -1.0 };
    let albedo = match axis {
        1 if direction.y < 0.0 => 0.11,
        1 => 0.035,
        _ => 0.055,
    };
    let point = direction * distance;
    let mut irradiance = AMBIENT.map(|channel| channel * PI);
    for softbox in boxes {
        let share = softbox.irradiance(point, normal);
        irradiance = std::array::from_fn(|c| irradiance[c] + share * softbox.radiance[c]);
    }
    irradiance.map(|channel| channel * albedo / PI)
}

#[cfg(test)]
mod tests {
    use std::convert::Infallible;

    use super::*;

    #[test]
    fn a_polygon_lights_as_a_sum_over_its_parts_does() {
        let corners = [[-1.0, -0.5, 2.0], [1.0, -0.5, 2.5], [1.0, 1.5, 2.5], [-1.0, 1.5, 2.0]].map(DVec3::from_array);
        for (p, n) in
            [(DVec3::ZERO, DVec3::Z), (DVec3::new(0.3, -1.0, 0.2), DVec3::Y), (DVec3::new(0.0, 0.5, 0.0), DVec3::new(0.0, 0.6, 0.8))]
        {
            let (u, v) = (corners[1] - corners[0], corners[3] - corners[0]);
            let area = u.cross(v);
            let count = 400;
            let mut sum = 0.0;
            for i in 0..count {
                for j in 0..count {
                    let place = |index: i32| (f64::from(index) + 0.5) / f64::from(count);
                    let to = corners[0] + u * place(i) + v * place(j) - p;
                    let distance = to.length();
                    sum += (to.dot(n) / distance).max(0.0) * area.dot(to).abs() / (distance * distance * distance);
                }
            }
            sum /= f64::from(count * count);
            let exact = polygon_irradiance(&corners, p, n);
            assert!((sum / exact - 1.0).abs() < 1e-3, "{sum} {exact}");
        }
    }

    #[test]
    fn boxes_are_bright_and_the_room_is_dark() {
        let Ok(map) = map(256, || Ok::<(), Infallible>(()));
        let key = map.nearest(DVec3::new(-2.2, 1.5, 2.3).normalize());
        assert!(key[0] > 55.0, "{key:?}");
        let floor = map.nearest(DVec3::new(0.3, -1.0, 0.2).normalize());
        assert!(floor[0] < 0.8 && floor[0] > 1e-3, "{floor:?}");
        assert!(map.raster.pixels().iter().flatten().all(|value| value.is_finite() && *value > 0.0));
    }

    #[test]
    fn energy_does_not_depend_on_the_width() {
        let total = |width: usize| {
            let Ok(map) = map(width, || Ok::<(), Infallible>(()));
            (0..width / 2).map(|y| map.raster.row(y).iter().map(|p| f64::from(p[1])).sum::<f64>() * map.solid_angle(y)).sum::<f64>()
        };
        let (coarse, fine) = (total(128), total(512));
        assert!((coarse / fine - 1.0).abs() < 0.01, "{coarse} {fine}");
    }
}

//! Small bright sources, often smaller than a pixel: their energy is kept exactly at any resolution.
//!
//! A disk is cut into parts of equal solid angle, and each part's energy goes to the pixel that holds
//! it. The integral over the map is that of the disk by construction, whatever the width.

use std::f64::consts::PI;

use glam::DVec3;

use crate::light::envmap::{EnvMap, pixel_containing};
use crate::light::synthesis::Rgb;
use crate::math::elementary;

/// A disk of constant radiance on the sphere of directions.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Disk {
    /// Unit direction of its center.
    pub center: DVec3,
    /// Angle from its center to its rim, in radians, at most pi / 2.
    pub radius: f64,
    /// Its radiance.
    pub radiance: Rgb,
}

impl Disk {
    /// Solid angle in steradians: 2 pi (1 - cos r), written so that small disks keep their digits.
    pub fn solid_angle(&self) -> f64 {
        let half_sine = elementary::sin(0.5 * self.radius);
        4.0 * PI * half_sine * half_sine
    }

    /// Adds the disk to `map`, energy for energy; parts for which `is_seen` is false are left out.
    pub fn add_to(&self, map: &mut EnvMap, is_seen: impl Fn(DVec3) -> bool) {
        let (width, height) = (map.width(), map.height());
        let (tangent, bitangent) = self.center.any_orthonormal_pair();
        let half_sine = elementary::sin(0.5 * self.radius);
        let count = self.part_count(height);
        let energy = self.solid_angle() / count as f64;
        for part in 0..count {
            // Equal steps of cos(angle) are equal solid angles, and golden angles spread them evenly (Vogel 1979).
            let share = (part as f64 + 0.5) / count as f64;
            let cosine = 1.0 - 2.0 * half_sine * half_sine * share;
            let sine = ((1.0 - cosine) * (1.0 + cosine)).sqrt();
            let (sin_turn, cos_turn) = elementary::sin_cos(part as f64 * GOLDEN_ANGLE);
            let direction = self.center * cosine + (tangent * cos_turn + bitangent * sin_turn) * sine;
            if is_seen(direction) {
                let (x, y) = pixel_containing(direction, width, height);
                let [r, g, b] = self.radiance.map(|radiance| radiance * energy / map.solid_angle(y));
                let [old_r, old_g, old_b] = map.raster.pixel(x, y).map(f64::from);
                map.raster.set_pixel(x, y, [(old_r + r) as f32, (old_g + g) as f32, (old_b + b) as f32]);
            }
        }
    }

    /// So many that a pixel inside the disk holds some sixty parts.
    fn part_count(&self, height: usize) -> usize {
        let radius_in_pixels = self.radius * height as f64 / PI;
        ((radius_in_pixels * radius_in_pixels * 64.0 * PI) as usize).clamp(256, 1 << 24)
    }
}

/// pi (3 - sqrt 5), in radians.
const GOLDEN_ANGLE: f64 = 2.399_963_229_728_653;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::raster::Raster;

    #[test]
    fn a_disk_keeps_its_energy_at_every_resolution() {
        for (radius, width) in [(0.004, 16), (0.004, 256), (0.004, 4096), (0.3, 64)] {
            let disk = Disk { center: DVec3::new(1.0, 2.0, -2.0) / 3.0, radius, radiance: [1.0, 2.0, 100.0] };
            let mut map = EnvMap::new(Raster::filled(width, width / 2, [0.0; 3]));
            disk.add_to(&mut map, |_| true);
            let total: f64 =
                (0..width / 2).map(|y| map.raster.row(y).iter().map(|p| f64::from(p[2])).sum::<f64>() * map.solid_angle(y)).sum();
            let expected = 100.0 * 2.0 * PI * (1.0 - elementary::cos(radius));
            // Rounding to f32 as parts are added one by one: 256 of them to the smallest disk's pixel.
            assert!((total / expected - 1.0).abs() < 2e-5, "{width}: {total} {expected}");
        }
    }

    #[test]
    fn a_disk_larger_than_a_pixel_has_its_radiance_inside() {
        let disk = Disk { center: DVec3::X, radius: 0.2, radiance: [5.0; 3] };
        let mut map = EnvMap::new(Raster::filled(512, 256, [0.0; 3]));
        disk.add_to(&mut map, |_| true);
        for direction in [DVec3::X, DVec3::new(1.0, 0.1, 0.05).normalize()] {
            // A pixel's border parts its 60 parts by a few more or less.
            assert!((map.nearest(direction)[0] - 5.0).abs() < 0.6, "{:?}", map.nearest(direction));
        }
        assert_eq!(map.nearest(DVec3::new(1.0, 0.25, 0.0).normalize()), [0.0; 3]);
    }
}

//! Lat-long environment maps and the geometry of their pixels.
//!
//! Axis order of the coursework: polar angle theta from +y, azimuth phi from +x towards +z,
//! d = (sin theta cos phi, cos theta, sin theta sin phi); row 0 is the top (+y), seen from inside.
//! Knows nothing of densities; see `distribution`.
//!
//! After Debevec, "Rendering synthetic objects into real scenes" (1998); `docs/conventions.md`.

use std::f64::consts::PI;

use glam::DVec3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::image::raster::Raster;
use crate::math::elementary;

/// Where in a pixel its direction lies.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Angles {
    /// Pixel centers: theta = (j + 1/2) pi / H, phi = (i + 1/2) 2 pi / W.
    #[default]
    Center,
    /// Upper left corners: theta = j pi / H, phi = i 2 pi / W (first report).
    Edge,
    /// Both poles included: theta = j pi / (H - 1), phi = i 2 pi / W (second report).
    EdgeInclusive,
}

/// Radiance from every direction: RGB f32 in lat-long layout.
#[derive(Debug, Clone, PartialEq)]
pub struct EnvMap {
    /// Linear radiance, row 0 at +y.
    pub raster: Raster,
    /// Which direction a pixel stands for.
    pub angles: Angles,
}

impl EnvMap {
    /// A map with directions through the pixel centers.
    pub fn new(raster: Raster) -> Self {
        Self { raster, angles: Angles::Center }
    }

    /// Pixels around the horizon.
    pub fn width(&self) -> usize {
        self.raster.width()
    }

    /// Pixels from pole to pole.
    pub fn height(&self) -> usize {
        self.raster.height()
    }

    /// Polar angle of row `y`, in radians from +y.
    pub fn theta(&self, y: usize) -> f64 {
        theta_of_row(y, self.height(), self.angles)
    }

    /// Azimuth of column `x`, in radians from +x towards +z.
    pub fn phi(&self, x: usize) -> f64 {
        phi_of_column(x, self.width(), self.angles)
    }

    /// The direction that pixel (x, y) stands for.
    pub fn direction(&self, x: usize, y: usize) -> DVec3 {
        direction_at(self.theta(y), self.phi(x))
    }

    /// Exact solid angle of each pixel of row `y`, in steradians; all pixels sum to 4 pi.
    ///
    /// (2 pi / W) (cos(j pi / H) - cos((j + 1) pi / H)), whatever `angles` is.
    pub fn solid_angle(&self, y: usize) -> f64 {
        solid_angle_of_pixel(y, self.width(), self.height())
    }

    /// Radiance of the pixel that contains `direction`.
    pub fn nearest(&self, direction: DVec3) -> [f32; 3] {
        let (x, y) = pixel_containing(direction, self.width(), self.height());
        self.raster.pixel(x, y)
    }

    /// Radiance between the four pixel centers around `direction`.
    ///
    /// Columns go round; above the top row stands the same row half a turn further, and likewise below the last.
    pub fn bilinear(&self, direction: DVec3) -> [f64; 3] {
        let [u, v] = square_at(direction);
        let (x, y) = (u * self.width() as f64 - 0.5, v * self.height() as f64 - 0.5);
        let (right, below) = (x - x.floor(), y - y.floor());
        let mut radiance = [0.0; 3];
        for (row, share_of_row) in [(0, 1.0 - below), (1, below)] {
            for (column, share_of_column) in [(0, 1.0 - right), (1, right)] {
                let pixel = self.pixel_around(x.floor() as isize + column, y.floor() as isize + row);
                (0..3).for_each(|channel| radiance[channel] += share_of_row * share_of_column * f64::from(pixel[channel]));
            }
        }
        radiance
    }

    /// The pixel at most one step beyond the edges, where the sphere goes on.
    fn pixel_around(&self, x: isize, y: isize) -> [f32; 3] {
        let (width, height) = (self.width() as isize, self.height() as isize);
        let is_across_pole = y < 0 || y >= height;
        let column = if is_across_pole { x + width / 2 } else { x };
        self.raster.pixel(column.rem_euclid(width) as usize, y.clamp(0, height - 1) as usize)
    }
}

/// A row of pixels on the sphere, without cancellation near the poles.
#[derive(Debug, Clone, Copy)]
pub struct Band {
    /// 1 - |cos theta| at its upper edge; counted from the other pole below the equator.
    pub top: f64,
    /// The same at its lower edge.
    pub bottom: f64,
    /// Sign of cos theta.
    pub side: f64,
}

impl Band {
    /// Row `y` of a map of `height` rows from pole to pole.
    pub fn of_row(y: usize, height: usize) -> Self {
        // 1 - cos t = 2 sin²(t / 2). A row across the equator is counted from the upper pole.
        let is_upper = 2 * y < height;
        let depth = |edge: usize| {
            let from_pole = if is_upper { edge } else { height - edge };
            let sine = elementary::sin(0.5 * PI * from_pole as f64 / height as f64);
            2.0 * sine * sine
        };
        Self { top: depth(y), bottom: depth(y + 1), side: if is_upper { 1.0 } else { -1.0 } }
    }
}

/// Polar angle of row `y` of `height`, in radians from +y.
pub fn theta_of_row(y: usize, height: usize, angles: Angles) -> f64 {
    match angles {
        Angles::Center => (y as f64 + 0.5) * PI / height as f64,
        Angles::Edge => y as f64 * PI / height as f64,
        Angles::EdgeInclusive => y as f64 * PI / (height.max(2) - 1) as f64,
    }
}

/// Azimuth of column `x` of `width`, in radians from +x towards +z.
pub fn phi_of_column(x: usize, width: usize, angles: Angles) -> f64 {
    match angles {
        Angles::Center => (x as f64 + 0.5) * 2.0 * PI / width as f64,
        Angles::Edge | Angles::EdgeInclusive => x as f64 * 2.0 * PI / width as f64,
    }
}

/// The unit vector (sin theta cos phi, cos theta, sin theta sin phi).
pub fn direction_at(theta: f64, phi: f64) -> DVec3 {
    let (sin_theta, cos_theta) = elementary::sin_cos(theta);
    let (sin_phi, cos_phi) = elementary::sin_cos(phi);
    DVec3::new(sin_theta * cos_phi, cos_theta, sin_theta * sin_phi)
}

/// The point of the unit square (u = phi / 2 pi, v = theta / pi) that looks along the unit `direction`.
pub fn square_at(direction: DVec3) -> [f64; 2] {
    let theta = elementary::acos(direction.y.clamp(-1.0, 1.0));
    let turn = elementary::atan2(direction.z, direction.x) / (2.0 * PI);
    let u = if turn < 0.0 { turn + 1.0 } else { turn };
    // A tiny negative turn rounds up to one whole turn, which is none.
    [if u >= 1.0 { 0.0 } else { u }, theta / PI]
}

/// Column and row of the pixel that contains `direction`.
pub fn pixel_containing(direction: DVec3, width: usize, height: usize) -> (usize, usize) {
    let [u, v] = square_at(direction);
    let column = ((u * width as f64) as usize).min(width - 1);
    let row = ((v * height as f64) as usize).min(height - 1);
    (column, row)
}

/// Exact solid angle of a pixel in row `y`, in steradians.
///
/// Written with the sine at the row's center, to which it is proportional:
/// cos a - cos b = 2 sin((b - a) / 2) sin((a + b) / 2).
pub fn solid_angle_of_pixel(y: usize, width: usize, height: usize) -> f64 {
    let theta = theta_of_row(y, height, Angles::Center);
    (2.0 * PI / width as f64) * 2.0 * elementary::sin(PI / (2.0 * height as f64)) * elementary::sin(theta)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn solid_angles_cover_the_sphere_once() {
        let (width, height) = (64, 32);
        let total: f64 = (0..height).map(|y| width as f64 * solid_angle_of_pixel(y, width, height)).sum();
        assert!((total - 4.0 * PI).abs() < 1e-13, "{total}");
    }

    #[test]
    fn a_pixel_is_found_again_by_its_direction() {
        let (width, height) = (64, 32);
        for y in 0..height {
            for x in 0..width {
                let theta = theta_of_row(y, height, Angles::Center);
                let phi = phi_of_column(x, width, Angles::Center);
                assert_eq!(pixel_containing(direction_at(theta, phi), width, height), (x, y));
            }
        }
    }

    #[test]
    fn bilinear_goes_round_and_across_the_poles() {
        let pixels = (0..8).map(|index| [index as f32, 0.0, 1.0]).collect();
        let map = EnvMap::new(Raster::new(4, 2, pixels));
        let at = |u: f64, v: f64| map.bilinear(direction_at(v * PI, u * 2.0 * PI))[0];
        for (u, v, expected) in [(0.125, 0.25, 0.0), (0.625, 0.75, 6.0), (0.25, 0.25, 0.5), (0.0, 0.25, 1.5), (0.125, 0.5, 2.0)] {
            assert!((at(u, v) - expected).abs() < 1e-12, "{u} {v}: {}", at(u, v));
        }
        // At the pole both sides meet: columns 0 and 2 of the top row, 0 and 2.
        assert!((at(0.125, 1e-12) - 1.0).abs() < 1e-9);
    }

    #[test]
    fn the_axes_are_those_of_the_coursework() {
        assert!((direction_at(0.0, 0.3) - DVec3::Y).length() < 1e-15);
        assert!((direction_at(PI / 2.0, 0.0) - DVec3::X).length() < 1e-15);
        assert!((direction_at(PI / 2.0, PI / 2.0) - DVec3::Z).length() < 1e-15);
    }
}

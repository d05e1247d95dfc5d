//! Faults of lenses: radial distortion and chromatic aberration, on top of any camera.
//!
//! A place on the film at distance r from the middle is seen in the direction of distance r g(r), or the other way
//! round, with g = 1 + k1 r² + k2 r^4 (Brown, "Close-range camera calibration", 1971). r is measured on the plane at
//! distance 1 from the pinhole: the tangent of the angle to the view; of an orthographic camera in half widths.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Faults of a lens.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Faults {
    /// How straight lines bend. Default not at all.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub distortion: Option<Distortion>,
    /// How colors part towards the edge. Default not at all.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub aberration: Option<Aberration>,
}

/// Radial distortion by g(r) = 1 + k1 r² + k2 r^4; r is the tangent of the angle to the view (half widths if orthographic).
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Distortion {
    /// Factor of r². Default 0.
    #[serde(default)]
    #[schemars(range(min = -100, max = 100))]
    pub k1: f64,
    /// Factor of r^4. Default 0.
    #[serde(default)]
    #[schemars(range(min = -100, max = 100))]
    pub k2: f64,
    /// From where to where g leads.
    #[serde(default)]
    pub mapping: Mapping,
}

/// From where to where the polynomial of a distortion leads.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Mapping {
    /// A ray of tangent r meets the film at r g(r), as in calibrated cameras: negative k is barrel, positive pincushion.
    #[default]
    RayToSensor,
    /// A place r of the film is seen at the tangent r g(r), as in the fourth report: positive k looks like barrel.
    SensorToRay,
}

/// Each color of the film sees the picture enlarged about its middle by a factor of its own, 1 + weight.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Aberration {
    /// Shift of red, as a share of the distance from the middle. Default 0.
    #[serde(default)]
    #[schemars(range(min = -0.5, max = 0.5))]
    pub r: f32,
    /// Shift of green. Default 0.
    #[serde(default)]
    #[schemars(range(min = -0.5, max = 0.5))]
    pub g: f32,
    /// Shift of blue. Default 0.
    #[serde(default)]
    #[schemars(range(min = -0.5, max = 0.5))]
    pub b: f32,
}

impl Aberration {
    /// Of red, green and blue.
    pub fn weights(self) -> [f32; 3] {
        [self.r, self.g, self.b]
    }
}

impl Distortion {
    fn factor(&self, r: f64) -> f64 {
        let squared = r * r;
        1.0 + squared * (self.k1 + squared * self.k2)
    }

    /// Slope of r g(r): 1 + 3 k1 r² + 5 k2 r^4.
    fn slope(&self, r: f64) -> f64 {
        let squared = r * r;
        1.0 + squared * (3.0 * self.k1 + squared * 5.0 * self.k2)
    }

    /// The smallest radius at which r g(r) turns round, if it ever does.
    fn turn(&self) -> f64 {
        // 5 k2 s² + 3 k1 s + 1 = 0 with s = r², in the form that cancels nothing for small k2.
        let (a, b) = (5.0 * self.k2, 3.0 * self.k1);
        let discriminant = b * b - 4.0 * a;
        if discriminant < 0.0 {
            return f64::INFINITY;
        }
        let root = discriminant.sqrt();
        let roots = [2.0 / (-b + root), 2.0 / (-b - root)];
        roots.into_iter().filter(|s| *s > 0.0).fold(f64::INFINITY, f64::min).sqrt()
    }

    /// Whether a picture whose corner is at that radius of the film shows each direction once.
    pub fn is_one_to_one(&self, corner: f64) -> bool {
        let turn = self.turn();
        match self.mapping {
            Mapping::SensorToRay => corner < turn,
            Mapping::RayToSensor => turn == f64::INFINITY || corner < turn * self.factor(turn),
        }
    }

    /// By what a place of the film at that radius is moved to where it is seen.
    pub fn scale(&self, r: f64) -> f64 {
        match self.mapping {
            Mapping::SensorToRay => self.factor(r),
            Mapping::RayToSensor if r > 0.0 => self.undistorted(r) / r,
            Mapping::RayToSensor => 1.0,
        }
    }

    /// The r with r g(r) = `sensor`, by Newton's method from `sensor`, kept between bounds that close in.
    fn undistorted(&self, sensor: f64) -> f64 {
        // Filters reach a little beyond the corner that was checked; there the turn is the end.
        let (mut low, mut high) = (0.0, self.turn().min(1e9));
        let mut r = sensor.min(high);
        for _ in 0..60 {
            let excess = r * self.factor(r) - sensor;
            if excess > 0.0 {
                high = r;
            } else {
                low = r;
            }
            let newton = r - excess / self.slope(r);
            let next = if newton >= low && newton <= high { newton } else { 0.5 * (low + high) };
            if (next - r).abs() <= 1e-14 * sensor {
                return next;
            }
            r = next;
        }
        r
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn distortion(k1: f64, k2: f64, mapping: Mapping) -> Distortion {
        Distortion { k1, k2, mapping }
    }

    #[test]
    fn both_mappings_are_inverse_to_each_other() {
        for (k1, k2) in [(0.3, 0.0), (-0.2, 0.0), (0.1, 0.4), (-0.3, 0.1), (0.0, -0.05), (5.0, 5.0), (0.0, 0.0), (-0.1, 1e-9)] {
            let (there, back) = (distortion(k1, k2, Mapping::SensorToRay), distortion(k1, k2, Mapping::RayToSensor));
            for r in [0.0, 1e-6, 0.1, 0.5, 0.9] {
                let moved = r * there.scale(r);
                assert!((moved * back.scale(moved) - r).abs() < 1e-12, "{k1} {k2} at {r}");
            }
        }
    }

    #[test]
    fn a_picture_that_folds_is_refused() {
        // r (1 - r² / 3) turns at r = 1, where it is 2/3.
        let [inward, outward] = [Mapping::SensorToRay, Mapping::RayToSensor].map(|mapping| distortion(-1.0 / 3.0, 0.0, mapping));
        assert!(inward.is_one_to_one(0.99) && !inward.is_one_to_one(1.01));
        assert!(outward.is_one_to_one(0.66) && !outward.is_one_to_one(0.67));
        assert!((outward.scale(0.666) * 0.666 - 1.0).abs() < 0.04, "{}", outward.scale(0.666));
        // 1 - 3 r² / 10 + 5 r^4 / 10 has no root.
        assert!(distortion(-0.1, 0.1, Mapping::RayToSensor).is_one_to_one(1e6));
        assert!(distortion(0.5, -0.01, Mapping::SensorToRay).is_one_to_one(3.0));
        assert!(!distortion(0.5, -0.01, Mapping::SensorToRay).is_one_to_one(10.0));
    }
}

//! Where camera rays begin: one file per kind.
//!
//! Row 0 is the top; a position on the film is in pixels from the upper left corner, x to the right, y down.
//! `+x` of the picture is to the right of someone who looks from `origin` at `target` with `up` upwards.

pub mod lens;
pub mod orthographic;
pub mod perspective;
pub mod thin_lens;

use glam::Vec3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::math::single;
use crate::render::camera::lens::{Aberration, Distortion};
use crate::render::camera::orthographic::Orthographic;
use crate::render::camera::perspective::Perspective;
use crate::render::camera::thin_lens::ThinLens;
use crate::render::ray::Ray;
use crate::render::scene::vector::Vector;

/// Where the picture is taken from, and how.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum CameraDescription {
    /// A pinhole.
    Perspective(Perspective),
    /// A lens with an opening: what is out of focus is blurred.
    ThinLens(ThinLens),
    /// Parallel rays.
    Orthographic(Orthographic),
}

impl Default for CameraDescription {
    fn default() -> Self {
        Self::Perspective(Perspective::default())
    }
}

/// Why a camera sees nothing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum CameraError {
    /// There is no direction of view.
    #[error("`target` of the camera is its `origin`")]
    NoDirection,
    /// There is no upright.
    #[error("`up` of the camera lies along its view, or is zero")]
    NoUp,
    /// A lens that would show some directions twice and others never.
    #[error("the distortion turns round within the picture: lower `k1` and `k2`, or the field of view")]
    Folds,
}

impl CameraError {
    /// The field at fault, within the camera's kind.
    pub fn field(self) -> &'static str {
        match self {
            Self::NoDirection => "target",
            Self::NoUp => "up",
            Self::Folds => "lens.distortion",
        }
    }
}

impl CameraDescription {
    /// Its name in a scene.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Perspective(_) => "perspective",
            Self::ThinLens(_) => "thin-lens",
            Self::Orthographic(_) => "orthographic",
        }
    }

    /// Ready to cast rays through a picture of that many pixels.
    pub fn compiled(&self, resolution: [u32; 2]) -> Result<Camera, CameraError> {
        let (view, projection, faults) = match self {
            Self::Perspective(kind) => {
                (View::of(kind.origin, kind.target, kind.up)?, Projection::Pinhole { half_width: kind.half_width() }, kind.lens)
            }
            Self::ThinLens(kind) => (View::of(kind.origin, kind.target, kind.up)?, kind.projection(), kind.lens),
            Self::Orthographic(kind) => {
                (View::of(kind.origin, kind.target, kind.up)?, Projection::Parallel { half_width: 0.5 * kind.width }, kind.lens)
            }
        };
        let [width, height] = resolution.map(|count| count as f32);
        let distortion = faults.distortion.filter(|distortion| (distortion.k1, distortion.k2) != (0.0, 0.0));
        let weights = faults.aberration.map(Aberration::weights).filter(|weights| weights.iter().any(|weight| *weight != 0.0));
        let camera =
            Camera { view, projection, center: [0.5 * width, 0.5 * height], per_pixel: 2.0 / width, distortion, aberration: weights };
        let reach = weights.map_or(1.0, |weights| 1.0 + f64::from(weights.into_iter().fold(0.0, f32::max)));
        let corner = camera.plane_radius([0.0, 0.0]) * reach;
        match distortion {
            Some(distortion) if !distortion.is_one_to_one(corner) => Err(CameraError::Folds),
            _ => Ok(camera),
        }
    }
}

/// A camera of a scene.
#[derive(Debug, Clone, Copy)]
pub struct Camera {
    view: View,
    projection: Projection,
    /// Middle of the film, in pixels.
    center: [f32; 2],
    /// Half widths of the film in one pixel.
    per_pixel: f32,
    /// How straight lines bend.
    distortion: Option<Distortion>,
    /// How far red, green and blue are moved away from the middle.
    aberration: Option<[f32; 3]>,
}

/// Axes of a picture in the world.
#[derive(Debug, Clone, Copy)]
struct View {
    origin: Vec3,
    right: Vec3,
    up: Vec3,
    forward: Vec3,
}

/// What happens between film and world; sizes on a plane at distance 1, or of the film itself.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Projection {
    /// All rays go through one point.
    Pinhole {
        /// Tangent of half the field of view.
        half_width: f32,
    },
    /// Rays from a disk that meet on a plane.
    Thin {
        /// Tangent of half the field of view.
        half_width: f32,
        /// Radius of the disk.
        radius: f32,
        /// Distance of the plane.
        focus: f32,
    },
    /// All rays are parallel.
    Parallel {
        /// Half of the width of the film in the world.
        half_width: f32,
    },
}

impl View {
    fn of(origin: Vector, target: Vector, up: Vector) -> Result<Self, CameraError> {
        let origin = origin.vec3();
        let forward = (target.vec3() - origin).try_normalize().ok_or(CameraError::NoDirection)?;
        let up = up.vec3().try_normalize().ok_or(CameraError::NoUp)?;
        let right = forward.cross(up);
        // Below this sine the rest of `up` is rounding.
        const LEAST_SINE: f32 = 1e-5;
        let right = if right.length() > LEAST_SINE { right.normalize() } else { return Err(CameraError::NoUp) };
        Ok(Self { origin, right, up: right.cross(forward), forward })
    }
}

impl Camera {
    /// The ray through a position on the film; `lens` is a point of the unit square.
    #[inline]
    pub fn ray(&self, position: [f32; 2], lens: [f32; 2]) -> Ray {
        let View { origin, right, up, forward } = self.view;
        let [x, y] = self.seen(self.on_film(position));
        match self.projection {
            Projection::Pinhole { half_width } => {
                Ray::new(origin, (forward + right * (x * half_width) + up * (y * half_width)).normalize())
            }
            Projection::Thin { half_width, radius, focus } => {
                let [lens_x, lens_y, _] = single::concentric_disk(lens);
                let offset = (right * lens_x + up * lens_y) * radius;
                let focused = (forward + right * (x * half_width) + up * (y * half_width)) * focus;
                Ray::new(origin + offset, (focused - offset).normalize())
            }
            Projection::Parallel { half_width } => Ray::new(origin + right * (x * half_width) + up * (y * half_width), forward),
        }
    }

    /// Where red, green and blue of a position on the film come from; `None` where they are one.
    #[inline]
    pub fn parted(&self, position: [f32; 2]) -> Option<[[f32; 2]; 3]> {
        let moved = |weight: f32| [0, 1].map(|k| position[k] + (position[k] - self.center[k]) * weight);
        self.aberration.map(|weights| weights.map(moved))
    }

    /// Right and up in half widths of the film.
    #[inline]
    fn on_film(&self, position: [f32; 2]) -> [f32; 2] {
        [(position[0] - self.center[0]) * self.per_pixel, (self.center[1] - position[1]) * self.per_pixel]
    }

    /// Where a place of the film is seen, both in half widths.
    #[inline]
    fn seen(&self, place: [f32; 2]) -> [f32; 2] {
        let Some(distortion) = &self.distortion else { return place };
        let scale = distortion.scale(self.plane_distance(place)) as f32;
        place.map(|coordinate| coordinate * scale)
    }

    /// Distance of a position on the film from the middle, in the unit of distortions.
    fn plane_radius(&self, position: [f32; 2]) -> f64 {
        self.plane_distance(self.on_film(position))
    }

    /// See [`lens`]: the tangent of the angle, or half widths.
    fn plane_distance(&self, place: [f32; 2]) -> f64 {
        let unit = match self.projection {
            Projection::Pinhole { half_width } | Projection::Thin { half_width, .. } => f64::from(half_width),
            Projection::Parallel { .. } => 1.0,
        };
        let [x, y] = place.map(f64::from);
        unit * (x * x + y * y).sqrt()
    }

    /// Whether rays depend on the point of the lens.
    pub fn has_lens(&self) -> bool {
        matches!(self.projection, Projection::Thin { .. })
    }

    /// Where it stands.
    pub fn origin(&self) -> Vec3 {
        self.view.origin
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn perspective() -> Perspective {
        Perspective { origin: Vector([0.0, 0.0, 4.0]), target: Vector([0.0; 3]), ..Perspective::default() }
    }

    #[test]
    fn pictures_are_upright_and_not_mirrored() {
        let kinds = [
            CameraDescription::Perspective(perspective()),
            CameraDescription::ThinLens(ThinLens::focused(perspective(), 0.0, 3.0)),
            CameraDescription::Orthographic(Orthographic { width: 2.0, ..Orthographic::default() }),
        ];
        for kind in kinds {
            let camera = kind.compiled([200, 100]).unwrap();
            let center = camera.ray([100.0, 50.0], [0.5; 2]);
            assert!((center.direction - Vec3::NEG_Z).length() < 1e-6, "{kind:?}");
            // Far along the ray of the upper right corner: to the right (+x) and above (+y), twice as wide as high.
            let corner = camera.ray([200.0, 0.0], [0.5; 2]).at(3.0);
            assert!(corner.x > 0.0 && (corner.x / corner.y - 2.0).abs() < 1e-5, "{kind:?} {corner}");
        }
    }

    #[test]
    fn the_field_of_view_is_horizontal() {
        let camera = CameraDescription::Perspective(Perspective { fov_degrees: 90.0, ..perspective() }).compiled([64, 16]).unwrap();
        let [left, right] = [0.0, 64.0].map(|x| camera.ray([x, 8.0], [0.0; 2]).direction);
        assert!(left.dot(right).abs() < 1e-6);
    }

    #[test]
    fn rays_of_a_thin_lens_meet_on_the_plane_of_focus() {
        let kind = ThinLens::focused(perspective(), 0.5, 3.0);
        let camera = CameraDescription::ThinLens(kind).compiled([64, 64]).unwrap();
        let pinhole = CameraDescription::Perspective(perspective()).compiled([64, 64]).unwrap();
        let sharp = pinhole.ray([50.0, 11.0], [0.0; 2]);
        let target = sharp.at(-3.0 / sharp.direction.z);
        for lens in [[0.0, 0.0], [0.9, 0.3], [0.2, 0.99], [0.5, 0.5]] {
            let ray = camera.ray([50.0, 11.0], lens);
            let met = ray.at((target.z - ray.origin.z) / ray.direction.z);
            assert!((met - target).length() < 1e-5, "{lens:?}: {met} {target}");
            assert!((ray.origin - sharp.origin).length() <= 0.5);
        }
    }

    fn faulty(distortion: &str) -> CameraDescription {
        let text = format!("{{ perspective: {{ fov_degrees: 60, lens: {{ {distortion} }} }} }}");
        serde_yaml::with::singleton_map::deserialize(serde_yaml::Deserializer::from_str(&text)).unwrap()
    }

    /// Half way to the edge the tangent is t = tan 30 / 2 = 0.288675; of r (1 - 0.2 r²) = t the root is by Newton's method, by hand.
    #[test]
    fn radial_distortion_moves_tangents_by_its_polynomial() {
        for (mapping, k1, expected) in [("sensor-to-ray", 0.2, 0.293486), ("ray-to-sensor", -0.2, 0.293744)] {
            let camera = faulty(&format!("distortion: {{ k1: {k1}, mapping: {mapping} }}")).compiled([64, 64]).unwrap();
            for position in [[48.0, 32.0], [32.0, 16.0]] {
                let direction = camera.ray(position, [0.5; 2]).direction;
                let tangent = direction.truncate().length() / -direction.z;
                assert!((tangent - expected).abs() < 2e-6, "{mapping}: {tangent}");
            }
        }
    }

    #[test]
    fn no_distortion_and_no_aberration_are_none_to_the_last_bit() {
        let plain = faulty("").compiled([64, 48]).unwrap();
        let zero = faulty("distortion: { k1: 0, k2: 0 }, aberration: { r: 0, g: 0, b: 0 }").compiled([64, 48]).unwrap();
        for position in [[0.0, 0.0], [13.7, 40.1], [64.0, 48.0]] {
            assert_eq!(plain.ray(position, [0.2; 2]), zero.ray(position, [0.2; 2]));
            assert_eq!(zero.parted(position), None);
        }
    }

    #[test]
    fn colors_part_away_from_the_middle() {
        let camera = faulty("aberration: { r: 0.1, b: -0.1 }").compiled([64, 48]).unwrap();
        let [red, green, blue] = camera.parted([42.0, 34.0]).unwrap();
        assert_eq!(green, [42.0, 34.0]);
        let near = |found: [f32; 2], expected: [f32; 2]| (0..2).all(|k| (found[k] - expected[k]).abs() < 1e-5);
        assert!(near(red, [43.0, 35.0]) && near(blue, [41.0, 33.0]), "{red:?} {blue:?}");
    }

    #[test]
    fn a_distortion_that_folds_the_picture_is_refused() {
        let error = faulty("distortion: { k1: -0.6, mapping: sensor-to-ray }").compiled([64, 64]).unwrap_err();
        assert_eq!((error, error.field()), (CameraError::Folds, "lens.distortion"));
    }

    #[test]
    fn a_camera_that_sees_nothing_is_refused() {
        let error = |kind: Perspective| CameraDescription::Perspective(kind).compiled([4, 4]).unwrap_err();
        assert_eq!(error(Perspective { target: Vector([0.0, 0.0, 4.0]), ..perspective() }), CameraError::NoDirection);
        assert_eq!(error(Perspective { up: Vector([0.0, 0.0, 2.0]), ..perspective() }), CameraError::NoUp);
        assert_eq!(error(Perspective { up: Vector([0.0; 3]), ..perspective() }), CameraError::NoUp);
    }
}

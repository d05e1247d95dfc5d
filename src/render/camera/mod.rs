//! Where camera rays begin: one file per kind.
//!
//! Row 0 is the top; a position on the film is in pixels from the upper left corner, x to the right, y down.
//! `+x` of the picture is to the right of someone who looks from `origin` at `target` with `up` upwards.

pub mod orthographic;
pub mod perspective;
pub mod thin_lens;

use glam::Vec3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::math::single;
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
}

impl CameraError {
    /// The field at fault, within the camera's kind.
    pub fn field(self) -> &'static str {
        match self {
            Self::NoDirection => "target",
            Self::NoUp => "up",
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
        let (view, lens) = match self {
            Self::Perspective(kind) => (View::of(kind.origin, kind.target, kind.up)?, Lens::Pinhole { half_width: kind.half_width() }),
            Self::ThinLens(kind) => (View::of(kind.origin, kind.target, kind.up)?, kind.lens()),
            Self::Orthographic(kind) => (View::of(kind.origin, kind.target, kind.up)?, Lens::Parallel { half_width: 0.5 * kind.width }),
        };
        let [width, height] = resolution.map(|count| count as f32);
        Ok(Camera { view, lens, center: [0.5 * width, 0.5 * height], per_pixel: 2.0 / width })
    }
}

/// A camera of a scene.
#[derive(Debug, Clone, Copy)]
pub struct Camera {
    view: View,
    lens: Lens,
    /// Middle of the film, in pixels.
    center: [f32; 2],
    /// Half widths of the film in one pixel.
    per_pixel: f32,
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
pub(crate) enum Lens {
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
        let x = (position[0] - self.center[0]) * self.per_pixel;
        let y = (self.center[1] - position[1]) * self.per_pixel;
        match self.lens {
            Lens::Pinhole { half_width } => Ray::new(origin, (forward + right * (x * half_width) + up * (y * half_width)).normalize()),
            Lens::Thin { half_width, radius, focus } => {
                let [lens_x, lens_y, _] = single::concentric_disk(lens);
                let offset = (right * lens_x + up * lens_y) * radius;
                let focused = (forward + right * (x * half_width) + up * (y * half_width)) * focus;
                Ray::new(origin + offset, (focused - offset).normalize())
            }
            Lens::Parallel { half_width } => Ray::new(origin + right * (x * half_width) + up * (y * half_width), forward),
        }
    }

    /// Whether rays depend on the point of the lens.
    pub fn has_lens(&self) -> bool {
        matches!(self.lens, Lens::Thin { .. })
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

    #[test]
    fn a_camera_that_sees_nothing_is_refused() {
        let error = |kind: Perspective| CameraDescription::Perspective(kind).compiled([4, 4]).unwrap_err();
        assert_eq!(error(Perspective { target: Vector([0.0, 0.0, 4.0]), ..perspective() }), CameraError::NoDirection);
        assert_eq!(error(Perspective { up: Vector([0.0, 0.0, 2.0]), ..perspective() }), CameraError::NoUp);
        assert_eq!(error(Perspective { up: Vector([0.0; 3]), ..perspective() }), CameraError::NoUp);
    }
}

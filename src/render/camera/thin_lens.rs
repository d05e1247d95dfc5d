//! A thin lens: sharp on one plane, blurred in front of it and behind.
//!
//! A point at depth z appears as a disk of diameter 2 R |z - f| / z in the plane of focus f, for an opening of radius R.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::render::camera::Projection;
use crate::render::camera::lens::Faults;
use crate::render::camera::perspective::{self, Perspective};
use crate::render::scene::vector::Vector;

/// A lens with an opening; with `aperture_radius: 0` a pinhole.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ThinLens {
    /// The middle of the lens. Default `[0, 0, 4]`.
    #[serde(default = "perspective::origin")]
    pub origin: Vector,
    /// The point in the middle of the picture. Default `[0, 0, 0]`.
    #[serde(default = "Vector::zero")]
    pub target: Vector,
    /// What is upwards in the picture. Default `[0, 1, 0]`.
    #[serde(default = "Vector::y")]
    pub up: Vector,
    /// Horizontal field of view. Default 40.
    #[serde(default = "perspective::fov_degrees")]
    #[schemars(extend("exclusiveMinimum" = 0, "exclusiveMaximum" = 180, "x-unit" = "degrees"))]
    pub fov_degrees: f64,
    /// Radius of the lens in the world.
    #[schemars(range(min = 0, max = 1e9))]
    pub aperture_radius: f32,
    /// Distance of the plane that is sharp, measured along the view.
    #[schemars(range(max = 1e9), extend("exclusiveMinimum" = 0))]
    pub focus_distance: f32,
    /// Faults of the lens: `distortion` and `aberration`. Default none.
    #[serde(default)]
    pub lens: Faults,
}

impl ThinLens {
    /// A pinhole camera's view through a lens.
    pub fn focused(view: Perspective, aperture_radius: f32, focus_distance: f32) -> Self {
        let Perspective { origin, target, up, fov_degrees, lens } = view;
        Self { origin, target, up, fov_degrees, aperture_radius, focus_distance, lens }
    }

    /// What it does to rays: exactly a pinhole's where it has no opening.
    pub(crate) fn projection(&self) -> Projection {
        let half_width = perspective::half_width(self.fov_degrees);
        match self.aperture_radius {
            0.0 => Projection::Pinhole { half_width },
            radius => Projection::Thin { half_width, radius, focus: self.focus_distance },
        }
    }
}

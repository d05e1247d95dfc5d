//! What the kinds `wrap` and `unwrap` share: where a disk lies and how it looks, as a person writes it.

use glam::DVec3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::engine::stage::{Mistake, StageError};
use crate::light::layout::{Disk, Layout, LayoutError};

/// Direction and place of a disk; absent fields are those of the largest disk seen along -z.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct View {
    /// The direction in which the camera looks; of any length. By default [0, 0, -1].
    #[serde(default)]
    pub looks_along: Option<[f64; 3]>,
    /// A direction that is up in the picture. By default [0, 1, 0].
    #[serde(default)]
    pub up: Option<[f64; 3]>,
    /// Center of the disk in pixels from the upper left corner of the picture. By default its middle.
    #[serde(default)]
    #[schemars(extend("x-unit" = "px"))]
    pub center: Option<[f64; 2]>,
    /// Radius of the disk in pixels. By default half of the shorter side.
    #[serde(default)]
    #[schemars(range(max = 1e6), extend("exclusiveMinimum" = 0, "x-unit" = "px"))]
    pub radius: Option<f64>,
    /// For a mirror ball: distance of the camera from the center of the ball, in radii of the ball. By default the
    /// camera is so far away that its rays are parallel.
    #[serde(default)]
    #[schemars(range(max = 1e6), extend("exclusiveMinimum" = 1))]
    pub camera_distance: Option<f64>,
}

impl View {
    /// The disk in a picture of that size.
    pub fn disk(&self, [width, height]: [usize; 2]) -> Disk {
        let usual = Disk::inscribed(width.min(height));
        Disk {
            center: self.center.unwrap_or([0.5 * width as f64, 0.5 * height as f64]),
            radius: self.radius.unwrap_or(usual.radius),
            camera_distance: self.camera_distance.unwrap_or(usual.camera_distance),
            looks_along: self.looks_along.map_or(usual.looks_along, DVec3::from_array),
            up: self.up.map_or(usual.up, DVec3::from_array),
        }
    }

    /// Fields that the layout does not read, and directions that are none.
    pub fn mistakes(&self, layout: Layout) -> Vec<Mistake> {
        let is_ball = layout == Layout::MirrorBall;
        let fields = [
            ("looks_along", self.looks_along.is_some() && !layout.is_disk(), "a disk; turn the map by a stage of kind `rotate`"),
            ("up", self.up.is_some() && !layout.is_disk(), "a disk; turn the map by a stage of kind `rotate`"),
            ("center", self.center.is_some() && !layout.is_disk(), "a disk"),
            ("radius", self.radius.is_some() && !layout.is_disk(), "a disk"),
            ("camera_distance", self.camera_distance.is_some() && !is_ball, "a mirror ball"),
        ];
        let unread = fields.into_iter().filter(|(_, is_unread, _)| *is_unread).map(|(field, _, what)| Mistake {
            field: format!("view.{field}"),
            message: format!("`{field}` means nothing to layout `{}`, which is not {what}", layout.name()),
            hint: Some(format!("remove `{field}`")),
        });
        let axes = self.disk([2, 2]);
        let has_axes = axes.looks_along.normalize_or_zero().cross(axes.up.normalize_or_zero()).length() >= 1e-6;
        let parallel = (layout.is_disk() && !has_axes).then(|| Mistake {
            field: "view".into(),
            message: LayoutError::Axes.to_string(),
            hint: Some("set `up` to a direction across `looks_along`".into()),
        });
        unread.chain(parallel).collect()
    }
}

impl From<LayoutError> for StageError {
    fn from(error: LayoutError) -> Self {
        Self::content(error)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_of_disks_are_mistakes_for_cubes() {
        let view = View { up: Some([0.0, 0.0, 1.0]), camera_distance: Some(3.0), ..View::default() };
        let fields = |layout| view.mistakes(layout).into_iter().map(|mistake| mistake.field).collect::<Vec<_>>();
        assert_eq!(fields(Layout::CubeCross), ["view.up", "view.camera_distance"]);
        // Up is along the view: there is no right.
        assert_eq!(fields(Layout::MirrorBall), ["view"]);
        assert!(View::default().mistakes(Layout::Angular).is_empty());
    }
}

//! A map cut into regions, one directional light for each.
//!
//! Only the container; cutting is `median_cut`, using is `relight`.

use glam::DVec3;

/// Pixels x0 <= x < x1, y0 <= y < y1.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Region {
    /// First column.
    pub x0: u32,
    /// First row.
    pub y0: u32,
    /// Column after the last.
    pub x1: u32,
    /// Row after the last.
    pub y1: u32,
}

/// One directional light that stands for a region of the map.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Light {
    /// The region it stands for.
    pub region: Region,
    /// Horizontal position in pixels, 0 at the left edge of the map.
    pub x: f64,
    /// Vertical position in pixels, 0 at the top edge of the map.
    pub y: f64,
    /// Unit direction from the scene towards the light.
    pub direction: DVec3,
    /// RGB irradiance on a surface that faces it: the sum of radiance times solid angle of the region.
    pub irradiance: [f64; 3],
    /// Solid angle of the region in steradians.
    pub solid_angle: f64,
    /// What the cut balanced: the variant's own measure of the region's energy.
    pub energy: f64,
}

/// The lights of one cut, top left first.
#[derive(Debug, Clone, PartialEq)]
pub struct LightSet {
    /// Width of the map that was cut, in pixels.
    pub map_width: u32,
    /// Height of the map that was cut, in pixels.
    pub map_height: u32,
    /// The lights.
    pub lights: Vec<Light>,
}

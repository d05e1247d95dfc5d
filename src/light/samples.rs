//! Directions drawn from a map or from the sphere, with the probabilities they were drawn with.
//!
//! Only the container; drawing is `sampling`, using is `relight`.

use glam::DVec3;

/// One direction and what is known of it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// Column of the pixel it lies in.
    pub x: u32,
    /// Row of the pixel it lies in.
    pub y: u32,
    /// Horizontal position on the unit square, phi / 2 pi.
    pub u: f64,
    /// Vertical position on the unit square, theta / pi.
    pub v: f64,
    /// Unit direction from the scene towards the light.
    pub direction: DVec3,
    /// Probability of the pixel; of the whole set they need not sum to one.
    pub pmf: f64,
    /// Density per steradian at the direction.
    pub pdf: f64,
    /// Radiance of the map there, if a map was given.
    pub radiance: Option<[f32; 3]>,
}

/// The frame in which directions are given.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Frame {
    /// World space: +y up.
    World,
    /// About +z, to be turned to each normal (cosine-distributed directions).
    Normal,
}

/// Directions in the order in which they were drawn.
#[derive(Debug, Clone, PartialEq)]
pub struct SampleSet {
    /// Width of the map whose pixels `x` counts; 0 where no map was involved.
    pub map_width: u32,
    /// Height of the map whose pixels `y` counts; 0 where no map was involved.
    pub map_height: u32,
    /// The frame of the directions.
    pub frame: Frame,
    /// The directions.
    pub samples: Vec<Sample>,
}

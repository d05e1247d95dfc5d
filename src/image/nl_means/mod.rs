//! Non-local means: every pixel becomes the mean of those around it whose surroundings look the same but for noise.
//!
//! After Rousselle, Knaus and Zwicker, "Adaptive rendering with non-local means filtering" (2012), sections 4 and 5:
//! distances are measured in units of the noise that is known of each pixel. The order of work is theirs too: one
//! offset at a time, so that the distances of patches are sums over windows of one plane, by [`windows`]. With
//! features (albedo, normal) weights are the lesser of both, after Rousselle, Manzi and Zwicker, "Robust denoising
//! using feature and color information" (2013), section 4. A feature's distance is there the difference of two pixels; here
//! it is that from a pixel's value and slope, or the normals of a ball in a small picture would let no two pixels be averaged.
//!
//! A picture is worked on in tiles, each with its own scratch; a pixel's sums run over the offsets in one order, so
//! the result is the same for any number of threads.

mod padded;
mod tile;
mod variance;
mod windows;

use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::image::raster::{Plane, Raster};

use padded::Padded;
use tile::Tile;
pub use variance::{of_one, of_two, raised};

/// How far the filter looks, and how much it takes for noise.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settings {
    /// A patch has 2 f + 1 pixels along each side.
    pub patch_radius: u32,
    /// The window that is searched has 2 r + 1 pixels along each side.
    pub window_radius: u32,
    /// Differences count in units of k standard deviations.
    pub k: f32,
    /// Whether whole patches are averaged, and not their centers alone.
    pub patchwise: bool,
    /// What lies beyond the edge.
    pub border: Border,
}

/// What lies beyond the edge.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Border {
    /// Patches see the nearest pixel of the edge again; only pixels of the image are averaged.
    #[default]
    Clamp,
    /// The image repeats: its left edge borrows from the right one. For lat-long maps' columns, and for comparison
    /// with filters that shift the image around.
    Wrap,
}

/// What weights are made from.
#[derive(Debug, Clone, Copy)]
pub struct Guide<'a> {
    /// The color that patches are compared by.
    pub color: &'a Raster,
    /// Variance of each of its channels.
    pub variance: &'a Raster,
    /// Pixels that count, those above zero; all if absent.
    pub coverage: Option<&'a Plane>,
    /// Noise-free features of the scene, such as albedo and normal, that must agree too.
    pub features: &'a [&'a Raster],
}

/// Least squared gradient of a feature that a difference is measured by, and differences in units of .6 of its root.
const FEATURE_FLOOR: f32 = 1e-3;
const FEATURE_K: f32 = 0.6;

/// Width and height of a tile in pixels: its planes stay in the caches, and what is computed around it is little.
const TILE: [usize; 2] = [128, 64];

/// `target` with each pixel averaged over its window by the weights of `guide`, which may be the target itself.
///
/// All rasters must have one size, finite values and variances of at least zero. Takes (2 r + 1)² steps of about ten
/// operations a pixel, and a few more for twice the patch. `check` is asked for each row of offsets of a tile (every 40 ms for the
/// largest window) and ends the work by its error.
pub fn filter<E: Send>(
    target: &Raster,
    guide: Guide<'_>,
    settings: Settings,
    check: impl Fn() -> Result<(), E> + Sync,
) -> Result<Raster, E> {
    let (width, height) = (target.width(), target.height());
    let padded = Padded::new(target, guide, settings);
    let across = width.div_ceil(TILE[0]);
    let place = |index: usize| {
        let (x, y) = (index % across * TILE[0], index / across * TILE[1]);
        ([x, y], [TILE[0].min(width - x), TILE[1].min(height - y)])
    };
    let filtered = (0..across * height.div_ceil(TILE[1])).into_par_iter().map(|index| {
        let (at, size) = place(index);
        Tile::new(at, size, settings).filtered(&padded, &check)
    });
    let filtered: Vec<Vec<[f32; 3]>> = filtered.collect::<Result<_, E>>()?;
    let mut result = target.clone();
    for (index, pixels) in filtered.iter().enumerate() {
        let ([x, y], [columns, _]) = place(index);
        for (row, pixels) in pixels.chunks_exact(columns).enumerate() {
            let start = (y + row) * width + x;
            result.pixels_mut()[start..start + columns].copy_from_slice(pixels);
        }
    }
    Ok(result)
}

/// The mean of two.
pub fn mean_of_two(a: &Raster, b: &Raster) -> Raster {
    let pixels = a.pixels().iter().zip(b.pixels()).map(|(a, b)| std::array::from_fn(|c| 0.5 * (a[c] + b[c])));
    Raster::new(a.width(), a.height(), pixels.collect())
}

impl Settings {
    /// How far around a tile distances between pixels are needed.
    fn reach(self) -> usize {
        self.patch_radius as usize + self.patchwise_radius()
    }

    /// Half of the side of the patch that is averaged.
    fn patchwise_radius(self) -> usize {
        if self.patchwise { self.patch_radius.saturating_sub(1) as usize } else { 0 }
    }
}

#[cfg(test)]
mod tests;

//! The film: how large, how pixels gather samples, what is kept beside the color.
//!
//! Filters are importance-sampled: a sample belongs to one pixel and lies within the filter's reach of it, so a pixel
//! depends on its own samples alone and weights are all one. `sums` holds what samples add up to, `filter` the
//! filters. Knows nothing of light.

pub mod filter;
pub mod sums;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::render::film::filter::FilterDescription;

/// Most pixels of a film along each side.
pub const SIDE_LIMIT: u32 = 65_536;

/// How large the picture is and what it holds.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct FilmDescription {
    /// Width and height in pixels. Default `[512, 512]`.
    #[serde(default = "resolution")]
    #[schemars(inner(range(min = 1, max = 65_536)), extend("x-unit" = "px"))]
    pub resolution: [u32; 2],
    /// How much of its surroundings a pixel sees. Default `box`.
    #[serde(default)]
    pub filter: FilterDescription,
    /// What is kept beside the color. Default none.
    #[serde(default)]
    #[schemars(extend("uniqueItems" = true))]
    pub layers: Vec<LayerKind>,
    /// What stands where no shape is seen. Default `environment`.
    #[serde(default)]
    pub background: Background,
}

fn resolution() -> [u32; 2] {
    [512, 512]
}

impl Default for FilmDescription {
    fn default() -> Self {
        Self { resolution: resolution(), filter: FilterDescription::default(), layers: Vec::new(), background: Background::default() }
    }
}

impl FilmDescription {
    /// Whether that layer is kept.
    pub fn has(&self, layer: LayerKind) -> bool {
        self.layers.contains(&layer)
    }

    /// Pixels.
    pub fn pixel_count(&self) -> usize {
        self.resolution[0] as usize * self.resolution[1] as usize
    }
}

/// What a film keeps beside the color.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum LayerKind {
    /// Color of the first surface that scatters, without light on it.
    Albedo,
    /// Shading normal of the first surface in the world, as components; its mean is shorter than one at edges.
    Normal,
    /// Distance from the camera ray's origin to the first surface, as a mean over the samples that hit one; else 0.
    Depth,
    /// Variance of the pixel's value (not of one sample) as `variance`, and its root as `standard_error`. With
    /// `independent` from the samples; else from replicates, of which there are at least two, and then also as
    /// `sample_variance` what it would be if the samples were independent: too large, but steadier from pixel to pixel.
    Variance,
}

/// What stands where no shape is seen.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Background {
    /// The environment, or black where there is none.
    #[default]
    Environment,
    /// Nothing: black with alpha 0, while the environment still lights the scene; alpha is coverage.
    Transparent,
}

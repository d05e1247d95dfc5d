//! Sobol points in pairs of dimensions for 2^32 samples; the scrambling is in `math::sobol`.

use std::num::NonZeroU32;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Owen-scrambled Sobol points; any number of samples works, powers of two work best.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Sobol {
    /// Camera rays a pixel.
    #[schemars(range(min = 1, max = 16_777_216))]
    pub samples_per_pixel: NonZeroU32,
    /// Independently scrambled sets into which the samples are split, for the error bar; must divide the number of
    /// samples. More of them make the error bar more certain and the picture a little noisier.
    /// Default 1, and 2 where the film has the layer `variance`.
    #[serde(default)]
    #[schemars(range(min = 1, max = 64))]
    pub replicates: Option<NonZeroU32>,
}

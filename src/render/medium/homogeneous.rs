//! A medium that is the same everywhere.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::render::medium::phase::PhaseDescription;
use crate::render::medium::{Extinction, isotropic, unit_extinction, white};
use crate::render::texture::value::{Color, Number, Share};

/// The same everywhere.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct HomogeneousParameters {
    /// Extinction, which is sigma_a + sigma_s: one number, since the color comes from the `albedo`. Default 1.
    #[serde(default = "unit_extinction")]
    #[schemars(extend("x-unit" = "1/length"))]
    pub sigma_t: Number<Extinction>,
    /// Share of a collision that is scattered on, sigma_s / sigma_t: a number or `[r, g, b]`. Default 1.
    #[serde(default = "white")]
    pub albedo: Color<Share>,
    /// Into which directions it scatters. Default `isotropic`.
    #[serde(default = "isotropic")]
    pub phase: PhaseDescription,
}

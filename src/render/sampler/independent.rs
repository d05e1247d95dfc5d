//! Independent numbers: a hash of the address.

use std::num::NonZeroU32;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::mixed;

/// Independent samples; noise falls as one over the square root of their number.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Independent {
    /// Camera rays a pixel.
    #[schemars(range(min = 1, max = 16_777_216))]
    pub samples_per_pixel: NonZeroU32,
}

/// The pair of a set; `state` is a hash of seed, pixel and sample.
#[inline]
pub fn pair(state: u64, set: u32) -> [u32; 2] {
    let bits = mixed(state.wrapping_add(u64::from(set).wrapping_mul(0x9e37_79b9_7f4a_7c15)));
    [(bits >> 32) as u32, bits as u32]
}

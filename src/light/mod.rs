//! The mathematics of light: environment maps, sampling, cuts, relighting, Fresnel.
//!
//! No files, no clock, no terminal. Reading order: `envmap`, `distribution`, `warp`, `points`, `sampling`, `median_cut`,
//! `relight`, `fresnel`, `synthesis`.

pub mod alias;
pub mod distribution;
pub mod envmap;
pub mod fresnel;
pub mod harmonics;
pub mod hierarchical;
pub mod layout;
pub mod lights;
pub mod median_cut;
pub mod nearest;
pub mod overlap;
pub mod points;
pub mod profiles;
pub mod relight;
pub mod reproject;
pub mod rigs;
pub mod samples;
pub mod sampling;
pub mod synthesis;
#[cfg(test)]
pub(crate) mod test_maps;
pub mod warp;

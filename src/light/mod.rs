//! The mathematics of light: environment maps, sampling, cuts, relighting, Fresnel.
//!
//! No files, no clock, no terminal. Reading order: `envmap`, `distribution`, `sampling`, `median_cut`,
//! `relight`, `fresnel`, `synthesis`.

pub mod distribution;
pub mod envmap;
pub mod fresnel;
pub mod harmonics;
pub mod layout;
pub mod lights;
pub mod median_cut;
pub mod overlap;
pub mod relight;
pub mod reproject;
pub mod rigs;
pub mod samples;
pub mod sampling;
pub mod summed_area;
pub mod synthesis;
#[cfg(test)]
pub(crate) mod test_maps;

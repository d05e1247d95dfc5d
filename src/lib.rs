//! A declarative batch pipeline for image-based lighting.
//!
//! A YAML file names stages; the engine plans them as a typed graph, runs what is not yet in the store,
//! and writes a manifest from which every figure can be made again bit for bit.
//! `docs/architecture.md` has the map of the rooms and the direction of their imports.

pub mod catalogue;
pub mod cli;
pub mod engine;
pub mod figure;
pub mod formats;
pub mod image;
pub mod light;
pub mod math;
pub mod render;
pub mod report;
pub mod stages;

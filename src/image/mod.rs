//! Pixels: rasters, color, filters, tone curves, metrics, drawing.
//!
//! Knows no file and no light. Reading order: `raster`, then what acts on it.

pub mod assembly;
pub mod assessment;
pub mod average;
pub mod color;
pub mod colormap;
pub mod display;
pub mod drawing;
pub mod filter;
pub mod flip;
pub mod metrics;
pub mod nl_means;
pub mod raster;
pub mod tone;

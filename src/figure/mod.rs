//! What a reader looks at: tables, charts, contact sheets. Draws series and rasters, knows no light.
//!
//! Reading order: `table`, `chart`, `sheet`.

pub mod chart;
pub mod sheet;
pub mod table;

//! What a reader looks at: tables, charts, contact sheets. Draws series and rasters, knows no light.
//!
//! Reading order: `table`, `estimate`, `chart` (what a figure says), `curves` (from a table to a chart),
//! `axis`, `layout` (where everything stands), `canvas` with its encoders `svg`, `bitmap`, `pdf`; `sheet`.

pub mod axis;
pub mod bitmap;
pub mod canvas;
pub mod chart;
pub mod curves;
pub mod estimate;
pub mod layout;
pub mod palette;
pub mod pdf;
pub mod reach;
pub mod sheet;
mod subset;
pub mod svg;
pub mod table;
pub mod text;

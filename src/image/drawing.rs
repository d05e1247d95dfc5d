//! Blocks and outlines painted on rasters.

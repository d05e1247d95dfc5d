//! Median cut.

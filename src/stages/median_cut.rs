//! median_cut.

//! Pixels, filters, layers, and the fold of samples.

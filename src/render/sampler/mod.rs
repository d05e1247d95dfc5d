//! Numbers addressed by (seed, pixel, sample index, dimension).

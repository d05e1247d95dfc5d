//! Warps of the unit square to directions, each beside its density.

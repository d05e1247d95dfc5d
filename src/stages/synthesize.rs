//! synthesize.

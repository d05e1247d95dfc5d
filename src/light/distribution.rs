//! Sampling distribution of a map.

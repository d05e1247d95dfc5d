//! pfm.

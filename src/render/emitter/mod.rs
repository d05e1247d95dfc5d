//! Where light comes from.

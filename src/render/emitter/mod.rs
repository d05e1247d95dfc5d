//! Where light comes from.

pub mod environment;

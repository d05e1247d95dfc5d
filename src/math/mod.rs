//! Numbers only: elementary functions, directions on the sphere, random streams, noise, statistics.
//!
//! Knows no image, no file and no clock. Reading order: `elementary`, `sphere`, `stream`, `sobol`, `noise`, `statistics`.

pub mod elementary;
pub mod linear;
pub mod noise;
pub mod single;
pub mod sobol;
pub mod sphere;
pub mod statistics;
pub mod stream;
pub mod turn;

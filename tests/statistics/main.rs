//! Laws that hold on average: each sampler against its density, at a stated level and with fixed seeds.
//!
//! Slower than unit tests. One module per room; each states how many tests share its level of .001 (Šidák),
//! and shows by controls that what it should refuse, it refuses.

mod bsdf;
mod estimators;
mod lights;
mod media;
mod render;
mod sampling;
mod shapes;
mod shared;
mod strategies;

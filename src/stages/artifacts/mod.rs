//! Canonical bytes and outside formats of the types that flow between stages, one file per type.

pub mod canonical;
pub mod distribution;
pub mod envmap;
pub mod figure;
pub mod film;
pub mod image;
pub mod lights;
pub mod mesh;
pub mod picture;
pub mod samples;
pub mod table;

//! The path tracer: one folder per family, one file per kind; no files, no clock, no terminal.
//!
//! What a person writes is `scene` (serde reads it, its JSON Schema checks it); it is compiled once into flat
//! tables, and every number of a picture is a function of (seed, pixel, sample index, dimension). All of it is
//! f32, for speed; sums over samples are folded by one fixed tree.
//!
//! Reading order: `ray`, `lanes`, `frame`, `transform`, `mesh`, `shape`, `texture`, `bsdf`, `medium`, `scatter`, `emitter`, `camera`, `sampler`, `film`, `scene`, `integrator`,
//! `picture`.

pub mod bsdf;
pub mod camera;
pub mod emitter;
pub mod film;
pub mod frame;
pub mod integrator;
pub mod lanes;
pub mod medium;
pub mod mesh;
pub mod picture;
pub mod ray;
pub mod sampler;
pub mod scatter;
pub mod scene;
pub mod scene_file;
pub mod shape;
pub mod texture;
pub mod transform;

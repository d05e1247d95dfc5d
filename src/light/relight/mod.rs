//! A sphere under a map: from samples, from lights, from nine harmonics, and exactly.
//!
//! Radiances of a diffuse sphere are (albedo / pi) times a sum of radiance, solid angle and cosine; the files
//! differ in what they sum over. Reading order: `sphere` (which normals), `estimators` (samples and
//! lights), `turned` (samples about each normal), `exact` (every pixel), `limits` (what the
//! estimators tend to), `lobe`, `reflected` and `drawn` (glossy spheres; pixels that draw for themselves), `views` (mirror
//! and normals).

pub mod drawn;
pub mod estimators;
pub mod exact;
pub mod limits;
pub mod lobe;
pub mod reflected;
pub mod sphere;
pub mod supersample;
pub mod turned;
pub mod views;

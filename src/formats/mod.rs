//! Bytes to rasters and back: PFM, Radiance HDR, OpenEXR, PNG, PPM, NPY.
//!
//! Pure functions over byte slices; reading and writing files is the caller's work.
pub mod exr;
pub mod hdr;
pub mod npy;
pub mod pfm;
pub mod png;
pub mod ppm;

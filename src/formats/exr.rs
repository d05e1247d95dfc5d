//! exr.

//! ppm.

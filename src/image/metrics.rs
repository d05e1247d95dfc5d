//! Errors between images.

//! fresnel.

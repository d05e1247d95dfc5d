//! Rays, hits, and the surface at a hit.

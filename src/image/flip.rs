//! FLIP and HDR-FLIP.

//! Tone curves and display encodings.

//! tone_map.

//! envmap.

//! mark.

//! relight.

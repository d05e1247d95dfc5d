//! average.

//! Maps without a file.

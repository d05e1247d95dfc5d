//! hdr.

//! Relighting a sphere.

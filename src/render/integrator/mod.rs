//! How radiance along a camera ray is estimated.

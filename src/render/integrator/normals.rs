//! Shading normals as colors.

use glam::Vec3;

use crate::render::integrator::path::FirstHit;

/// (n + 1) / 2 of the first surface; black where there is none.
pub fn color(first: &FirstHit) -> Vec3 {
    if first.is_hit { (first.normal + Vec3::ONE) * 0.5 } else { Vec3::ZERO }
}

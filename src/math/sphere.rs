//! Warps of the unit square to directions, each beside its density, and frames about a normal.
//!
//! A warp takes a point of [0, 1)² and preserves area in the measure of its density; densities are per
//! steradian. Knows no map; see `light::distribution` for warps that follow one.
//!
//! After Pharr, Jakob, Humphreys, "Physically Based Rendering", 4th edition, appendix A.5 (2023), and
//! Duff et al., "Building an Orthonormal Basis, Revisited", JCGT 6(1) (2017).

use std::f64::consts::PI;

use glam::{DMat3, DVec3};

use crate::math::elementary;

/// A direction uniform on the sphere: azimuth 2 pi u0 from +x towards +z, cosine from +y uniform (1 - 2 u1).
///
/// The axes are those of lat-long maps, and u1 = 0 is their top.
pub fn uniform_sphere(u: [f64; 2]) -> DVec3 {
    let cos_theta = 1.0 - 2.0 * u[1];
    // (1 - c)(1 + c) keeps the digits of the sine near the poles, where 1 - c² cancels.
    let sin_theta = (4.0 * u[1] * (1.0 - u[1])).sqrt();
    let (sin_phi, cos_phi) = elementary::sin_cos(2.0 * PI * u[0]);
    DVec3::new(sin_theta * cos_phi, cos_theta, sin_theta * sin_phi)
}

/// Density of [`uniform_sphere`], 1 / (4 pi) per steradian.
pub fn uniform_sphere_pdf() -> f64 {
    1.0 / (4.0 * PI)
}

/// A direction about +z with density proportional to its z (Malley's method, in polar coordinates).
///
/// sin²(theta) = u0, azimuth 2 pi u1 from +x towards +y; z is never 0, since u0 < 1.
pub fn cosine_hemisphere(u: [f64; 2]) -> DVec3 {
    let sin_theta = u[0].sqrt();
    let (sin_phi, cos_phi) = elementary::sin_cos(2.0 * PI * u[1]);
    DVec3::new(sin_theta * cos_phi, sin_theta * sin_phi, (1.0 - u[0]).sqrt())
}

/// Density of [`cosine_hemisphere`] at a direction of that z: max(0, z) / pi per steradian.
pub fn cosine_hemisphere_pdf(cos_theta: f64) -> f64 {
    cos_theta.max(0.0) / PI
}

/// Right-handed orthonormal frame whose third axis is the unit vector `n`.
///
/// `frame * local` turns a direction about +z into one about `n`; the transpose turns it back.
/// Continuous except where n.z changes its sign (Duff et al. 2017, listing 3).
pub fn frame_about(n: DVec3) -> DMat3 {
    let sign = 1.0_f64.copysign(n.z);
    let a = -1.0 / (sign + n.z);
    let b = n.x * n.y * a;
    let tangent = DVec3::new(1.0 + sign * n.x * n.x * a, sign * b, -sign * n.x);
    let bitangent = DVec3::new(b, sign + n.y * n.y * a, -n.y);
    DMat3::from_cols(tangent, bitangent, n)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Centers of `side`² cells of the unit square.
    fn grid(side: usize) -> impl Iterator<Item = [f64; 2]> {
        (0..side * side).map(move |k| [((k % side) as f64 + 0.5) / side as f64, ((k / side) as f64 + 0.5) / side as f64])
    }

    fn mean_over_square(side: usize, value: impl Fn([f64; 2]) -> f64) -> f64 {
        grid(side).map(value).sum::<f64>() / (side * side) as f64
    }

    #[test]
    fn warped_directions_have_unit_length() {
        for u in grid(64).chain([[0.0, 0.0], [1.0 - f64::EPSILON / 2.0; 2]]) {
            assert!((uniform_sphere(u).length() - 1.0).abs() < 4.0 * f64::EPSILON);
            assert!((cosine_hemisphere(u).length() - 1.0).abs() < 4.0 * f64::EPSILON);
            assert!(cosine_hemisphere(u).z > 0.0);
        }
    }

    #[test]
    fn weighing_by_one_over_density_gives_the_solid_angle() {
        assert!((mean_over_square(32, |_| 1.0 / uniform_sphere_pdf()) - 4.0 * PI).abs() < 1e-12);
        // The integral of z over the hemisphere is pi; over z² it is 2 pi / 3.
        let first = mean_over_square(32, |u| {
            let d = cosine_hemisphere(u);
            d.z / cosine_hemisphere_pdf(d.z)
        });
        let second = mean_over_square(512, |u| {
            let d = cosine_hemisphere(u);
            d.z * d.z / cosine_hemisphere_pdf(d.z)
        });
        assert!((first - PI).abs() < 1e-12, "{first}");
        // The midpoint rule at the root at u0 = 1 errs by the order of side^(-3/2).
        assert!((second - 2.0 * PI / 3.0).abs() < 1e-4, "{second}");
    }

    #[test]
    fn moments_of_the_uniform_sphere_are_those_of_every_axis() {
        for axis in [DVec3::X, DVec3::Y, DVec3::Z] {
            let first = mean_over_square(256, |u| uniform_sphere(u).dot(axis));
            let second = mean_over_square(256, |u| uniform_sphere(u).dot(axis) * uniform_sphere(u).dot(axis));
            assert!(first.abs() < 1e-12);
            assert!((second - 1.0 / 3.0).abs() < 1e-5, "{second}");
        }
    }

    #[test]
    fn a_frame_is_orthonormal_and_right_handed_about_any_normal() {
        let poles = [DVec3::Z, -DVec3::Z, DVec3::Y, DVec3::new(0.0, 0.0, -0.0) - DVec3::Z];
        for n in grid(32).map(uniform_sphere).chain(poles) {
            let frame = frame_about(n);
            let identity = frame.transpose() * frame;
            assert!(identity.abs_diff_eq(DMat3::IDENTITY, 1e-14), "{n}");
            assert!((frame.determinant() - 1.0).abs() < 1e-14, "{n}");
            assert!(((frame * DVec3::Z) - n).length() < 1e-15);
        }
    }
}

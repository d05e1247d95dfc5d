//! The four shapes that need no triangles, each of unit size: where a ray meets them, their surface, points on them.
//!
//! Everything is in local coordinates and double precision, so that a sphere of radius 1e-3 and one of 1e3, here or
//! 1e4 away, is as exact as the ray that asks; see `placed` for the way to the world.
//!
//! Sphere: the robust quadratic of Haines, Günther, Akenine-Möller, "Precision improvements for ray/sphere
//! intersection", Ray Tracing Gems, chapter 7 (2019). Its cone of directions: Pharr et al., "Physically Based
//! Rendering", 4th edition, section 6.2.4 (2023).

use std::f64::consts::PI;

use glam::{DMat3, DVec3};

use crate::math::elementary;
use crate::math::sphere;
use crate::math::turn;

/// A shape of unit size about the origin.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Unit {
    /// Radius 1; pole of the texture coordinates +y.
    Sphere,
    /// [-1, 1]² in z = 0.
    Rectangle,
    /// Radius 1 in z = 0.
    Disk,
    /// [-1, 1]³.
    Box,
}

/// A point of a unit shape.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct UnitPoint {
    /// Where it is, exactly on the shape.
    pub position: DVec3,
    /// Unit normal, outwards.
    pub normal: DVec3,
    /// Texture coordinates.
    pub uv: [f32; 2],
    /// Change of the position with u; zero at the poles of the sphere.
    pub dp_du: DVec3,
    /// Change of the position with v.
    pub dp_dv: DVec3,
}

/// The nearest hit at a parameter in (0, reach), and the face of a box (0 else): 2 axis + 1 on its positive side.
pub fn intersect(unit: Unit, origin: DVec3, direction: DVec3, reach: f64) -> Option<(f64, u32)> {
    match unit {
        Unit::Sphere => intersect_sphere(origin, direction, reach).map(|t| (t, 0)),
        Unit::Rectangle => intersect_plane(origin, direction, reach).filter(|(_, p)| p.abs().max_element() <= 1.0).map(|(t, _)| (t, 0)),
        Unit::Disk => intersect_plane(origin, direction, reach).filter(|(_, p)| p.length_squared() <= 1.0).map(|(t, _)| (t, 0)),
        Unit::Box => intersect_box(origin, direction, reach),
    }
}

fn intersect_sphere(origin: DVec3, direction: DVec3, reach: f64) -> Option<f64> {
    let a = direction.length_squared();
    let b = origin.dot(direction);
    // From outside and away: most rays that leave a ball are told by this.
    if b >= 0.0 && origin.length_squared() >= 1.0 {
        return None;
    }
    // The foot of the perpendicular from the center; its length decides, and nothing large cancels.
    let foot = origin - direction * (b / a);
    let discriminant = a * (1.0 - foot.length_squared());
    if discriminant < 0.0 {
        return None;
    }
    let distance = origin.length();
    let q = -(b + discriminant.sqrt().copysign(b));
    let (first, second) = ((distance - 1.0) * (distance + 1.0) / q, q / a);
    let (near, far) = if first < second { (first, second) } else { (second, first) };
    let t = if near > 0.0 { near } else { far };
    (t > 0.0 && t < reach).then_some(t)
}

fn intersect_plane(origin: DVec3, direction: DVec3, reach: f64) -> Option<(f64, DVec3)> {
    let t = -origin.z / direction.z;
    // A ray within the plane gives NaN or infinity.
    (t > 0.0 && t < reach).then(|| (t, (origin + direction * t).with_z(0.0)))
}

fn intersect_box(origin: DVec3, direction: DVec3, reach: f64) -> Option<(f64, u32)> {
    let (mut near, mut far) = ((f64::NEG_INFINITY, 0), (f64::INFINITY, 0));
    for axis in 0..3 {
        let (o, d) = (origin[axis], direction[axis]);
        if d == 0.0 {
            if o.abs() > 1.0 {
                return None;
            }
            continue;
        }
        // The side by which it enters is the negative one where it goes up.
        let side = u32::from(d < 0.0);
        let enter = (-1.0_f64.copysign(d) - o) / d;
        let leave = (1.0_f64.copysign(d) - o) / d;
        if enter > near.0 {
            near = (enter, 2 * axis as u32 + side);
        }
        if leave < far.0 {
            far = (leave, 2 * axis as u32 + 1 - side);
        }
    }
    if near.0 > far.0 {
        return None;
    }
    let (t, face) = if near.0 > 0.0 { near } else { far };
    (t > 0.0 && t < reach).then_some((t, face))
}

/// The point of the shape nearest to `near`, which lies on it but for rounding.
pub fn point(unit: Unit, near: DVec3, face: u32) -> UnitPoint {
    match unit {
        Unit::Sphere => sphere_point(near.normalize()),
        Unit::Rectangle | Unit::Disk => UnitPoint {
            position: near.with_z(0.0),
            normal: DVec3::Z,
            uv: [(near.x * 0.5 + 0.5) as f32, (near.y * 0.5 + 0.5) as f32],
            dp_du: DVec3::X * 2.0,
            dp_dv: DVec3::Y * 2.0,
        },
        Unit::Box => box_point(near, face),
    }
}

/// Longitude from +x towards -z over 2 pi and height from the south pole over pi: to the right and up, seen from outside.
fn sphere_point(position: DVec3) -> UnitPoint {
    let DVec3 { x, y, z } = position;
    let sin_theta = (x * x + z * z).sqrt();
    let uv = [turn::of_vector(x as f32, -z as f32), 2.0 * turn::of_vector(-y as f32, sin_theta as f32)];
    let dp_dv = if sin_theta > 0.0 { DVec3::new(-x * y / sin_theta, sin_theta, -z * y / sin_theta) * PI } else { DVec3::X * PI };
    UnitPoint { position, normal: position, uv, dp_du: DVec3::new(z, 0.0, -x) * (2.0 * PI), dp_dv }
}

/// Axes of u and v of each face, so that u × v is its normal and v is up on the four sides.
fn box_axes(face: u32) -> (DVec3, DVec3) {
    match face {
        0 => (DVec3::Z, DVec3::Y),
        1 => (-DVec3::Z, DVec3::Y),
        2 => (DVec3::X, DVec3::Z),
        3 => (DVec3::X, -DVec3::Z),
        4 => (-DVec3::X, DVec3::Y),
        _ => (DVec3::X, DVec3::Y),
    }
}

fn box_point(near: DVec3, face: u32) -> UnitPoint {
    let (u, v) = box_axes(face);
    let normal = u.cross(v);
    let position = near - normal * (near.dot(normal) - 1.0);
    let uv = [(position.dot(u) * 0.5 + 0.5) as f32, (position.dot(v) * 0.5 + 0.5) as f32];
    UnitPoint { position, normal, uv, dp_du: u * 2.0, dp_dv: v * 2.0 }
}

/// Corners of the smallest box around the shape: minus and plus these.
pub fn half_extent(unit: Unit) -> DVec3 {
    match unit {
        Unit::Sphere | Unit::Box => DVec3::ONE,
        Unit::Rectangle | Unit::Disk => DVec3::new(1.0, 1.0, 0.0),
    }
}

/// Areas of the shape after a linear map: of each pair of opposite faces for a box, else the whole.
///
/// `cofactor` maps a normal times an area to that after the map. For an ellipsoid Thomsen's formula would do; the
/// sphere's value is exact only under a similarity and is not used otherwise.
pub fn face_areas(unit: Unit, cofactor: DMat3) -> [f64; 3] {
    let [x, y, z] = [cofactor.x_axis, cofactor.y_axis, cofactor.z_axis].map(DVec3::length);
    match unit {
        Unit::Sphere => [ellipsoid_area(cofactor), 0.0, 0.0],
        Unit::Rectangle => [0.0, 0.0, 4.0 * z],
        Unit::Disk => [0.0, 0.0, PI * z],
        Unit::Box => [8.0 * x, 8.0 * y, 8.0 * z],
    }
}

/// Area of the image of the unit sphere: the mean of |cofactor n| over the sphere, times 4 pi.
///
/// A product rule that is exact for the sphere and good to six digits for axes within 1 : 10.
fn ellipsoid_area(cofactor: DMat3) -> f64 {
    const SIDE: usize = 128;
    let cells = (0..SIDE * SIDE).map(|k| [(k % SIDE) as f64 + 0.5, (k / SIDE) as f64 + 0.5].map(|x| x / SIDE as f64));
    let sum: f64 = cells.map(|u| (cofactor * sphere::uniform_sphere(u)).length()).sum();
    4.0 * PI * sum / (SIDE * SIDE) as f64
}

/// A uniform point in local area, and its density per local area; of a box on the pair of faces `axis` alone.
pub fn sample_area(unit: Unit, axis: usize, u: [f64; 2]) -> (UnitPoint, f64) {
    match unit {
        Unit::Sphere => (sphere_point(sphere::uniform_sphere(u)), 1.0 / (4.0 * PI)),
        Unit::Rectangle => (point(unit, DVec3::new(2.0 * u[0] - 1.0, 2.0 * u[1] - 1.0, 0.0), 0), 0.25),
        Unit::Disk => {
            let radius = u[0].sqrt();
            let (sin, cos) = elementary::sin_cos(2.0 * PI * u[1]);
            (point(unit, DVec3::new(radius * cos, radius * sin, 0.0), 0), 1.0 / PI)
        }
        Unit::Box => {
            // Halves of the first number are the two faces.
            let positive = u32::from(u[0] >= 0.5);
            let first = 2.0 * u[0] - f64::from(positive);
            let face = 2 * axis as u32 + positive;
            let (along_u, along_v) = box_axes(face);
            let position = along_u.cross(along_v) + along_u * (2.0 * first - 1.0) + along_v * (2.0 * u[1] - 1.0);
            (box_point(position, face), 1.0 / 8.0)
        }
    }
}

/// A point of the unit sphere in a direction uniform on the cone under which `from` sees it, and the density per steradian.
///
/// `None` where `from` is not outside.
pub fn sample_cone(from: DVec3, u: [f64; 2]) -> Option<(UnitPoint, f64)> {
    let squared = from.length_squared();
    let spread = cone_spread(squared)?;
    let distance = squared.sqrt();
    let one_minus_cos = u[0] * spread;
    let cos = 1.0 - one_minus_cos;
    let sin_squared = one_minus_cos * (1.0 + cos);
    // Where the ray first meets the sphere; the root vanishes on the rim.
    let chord = distance * cos - (1.0 - squared * sin_squared).max(0.0).sqrt();
    let cos_alpha = ((squared + 1.0 - chord * chord) / (2.0 * distance)).clamp(-1.0, 1.0);
    let sin_alpha = ((1.0 - cos_alpha) * (1.0 + cos_alpha)).sqrt();
    let (sin_phi, cos_phi) = elementary::sin_cos(2.0 * PI * u[1]);
    let local = DVec3::new(sin_alpha * cos_phi, sin_alpha * sin_phi, cos_alpha);
    let position = (sphere::frame_about(from / distance) * local).normalize();
    Some((sphere_point(position), 1.0 / (2.0 * PI * spread)))
}

/// Density per steradian of [`sample_cone`] from a point at that squared distance; `None` where it is not outside.
pub fn cone_pdf(squared_distance: f64) -> Option<f64> {
    cone_spread(squared_distance).map(|spread| 1.0 / (2.0 * PI * spread))
}

/// 1 - cos of the half angle of the cone; without cancellation for distant spheres.
fn cone_spread(squared_distance: f64) -> Option<f64> {
    if squared_distance <= 1.0 {
        return None;
    }
    let sin_squared = 1.0 / squared_distance;
    Some(sin_squared / (1.0 + (1.0 - sin_squared).sqrt()))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Longitude from +x towards -z over 2 pi, height from the south pole over pi, by the angles of double precision.
    #[test]
    fn texture_coordinates_of_a_sphere_are_its_longitude_and_height() {
        for k in 0..20_000 {
            let u = [f64::from(k % 200) / 200.0, (f64::from(k / 200) + 0.5) / 100.0];
            let (sine, cosine) = elementary::sin_cos(2.0 * PI * u[0]);
            let (sin_theta, cos_theta) = elementary::sin_cos(PI * u[1]);
            let found = point(Unit::Sphere, DVec3::new(sin_theta * cosine, -cos_theta, -sin_theta * sine), 0).uv;
            let across = (f64::from(found[0]) - u[0]).abs();
            assert!(across.min(1.0 - across) < 2e-7 && (f64::from(found[1]) - u[1]).abs() < 3e-7, "{u:?}: {found:?}");
        }
        let uv = |x, y, z| point(Unit::Sphere, DVec3::new(x, y, z), 0).uv;
        assert_eq!(
            [uv(1.0, 0.0, 0.0), uv(0.0, 0.0, -1.0), uv(-1.0, 0.0, 0.0), uv(0.0, 0.0, 1.0)],
            [0.0, 0.25, 0.5, 0.75].map(|u| [u, 0.5])
        );
        assert_eq!([uv(0.0, 1.0, 0.0), uv(0.0, -1.0, 0.0)], [[0.0, 1.0], [0.0, 0.0]]);
    }
}

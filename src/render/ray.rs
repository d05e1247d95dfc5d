//! Rays, what they hit, and the point of a surface with a bound of its rounding error.
//!
//! New rays start beside a surface, moved along its normal by that bound, never by a fixed distance: so a ray neither
//! hits the surface it leaves nor misses what is near, at any scale and anywhere in the scene.
//!
//! After Pharr, Jakob, Humphreys, "Physically Based Rendering", 4th edition, section 6.8 (2023).

use glam::Vec3;

use crate::render::frame::Frame;

/// A half-line up to a distance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ray {
    /// Where it starts.
    pub origin: Vec3,
    /// Where it goes, of unit length.
    pub direction: Vec3,
    /// Hits count at distances above 0 and below this.
    pub reach: f32,
}

impl Ray {
    /// A ray without an end.
    pub fn new(origin: Vec3, direction: Vec3) -> Self {
        Self { origin, direction, reach: f32::INFINITY }
    }

    /// A ray that ends just before `target`, for questions of visibility; `None` where that is the origin itself.
    pub fn to(origin: Vec3, target: Vec3) -> Option<Self> {
        let way = target - origin;
        let distance = way.length();
        let direction = way / distance;
        direction.is_finite().then_some(Self { origin, direction, reach: SHADOW_PART * distance })
    }

    /// The point at that distance.
    pub fn at(&self, distance: f32) -> Vec3 {
        self.origin + self.direction * distance
    }
}

/// The nearest thing a ray meets; `Geometry::surface` tells the rest.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hit {
    /// Distance from the ray's origin.
    pub distance: f32,
    /// Index of the placed shape.
    pub shape: u32,
    /// Triangle of a mesh, face of a box; else 0.
    pub primitive: u32,
    /// Weights of a triangle's second and third corner.
    pub barycentric: [f32; 2],
}

/// A point of a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Surface {
    /// Where it is.
    pub position: Vec3,
    /// Unit normal of the true surface, outwards (of a triangle: counter-clockwise corners seen from its tip).
    pub normal: Vec3,
    /// Axes for shading: z is the interpolated normal, on the side of `normal`; x goes along `dp_du`.
    pub frame: Frame,
    /// Texture coordinates.
    pub uv: [f32; 2],
    /// Change of the position with u and v.
    pub dp_du: Vec3,
    /// See `dp_du`.
    pub dp_dv: Vec3,
    /// Index of the placed shape.
    pub shape: u32,
    /// How far along `normal` a new ray has to start, so as to be beside the surface for certain.
    pub offset: f32,
}

/// What part of the way to a light a shadow ray goes: it ends before the light itself.
const SHADOW_PART: f32 = 1.0 - 1e-4;

impl Surface {
    /// A ray from here in a unit direction, on the side of the surface to which it goes.
    pub fn spawn(&self, direction: Vec3) -> Ray {
        Ray::new(self.origin_towards(direction), direction)
    }

    /// A ray from here that ends just before `target`, for questions of visibility.
    ///
    /// `None` where the target is this very point.
    pub fn spawn_to(&self, target: Vec3) -> Option<Ray> {
        Ray::to(self.origin_towards(target - self.position), target)
    }

    /// This position, moved to that side of the surface to which `direction` points.
    pub fn origin_towards(&self, direction: Vec3) -> Vec3 {
        let side = if direction.dot(self.normal) < 0.0 { -self.normal } else { self.normal };
        let moved = self.position + side * self.offset;
        // The sum itself is rounded: go to the next number in the direction of the move.
        Vec3::new(away(moved.x, side.x), away(moved.y, side.y), away(moved.z, side.z))
    }
}

/// The next number beyond `value` in the direction of the sign of `side`; `value` itself where that is zero.
fn away(value: f32, side: f32) -> f32 {
    if side > 0.0 {
        value.next_up()
    } else if side < 0.0 {
        value.next_down()
    } else {
        value
    }
}

/// A point drawn from a shape that gives light, as seen from a reference point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AreaSample {
    /// Where it is.
    pub position: Vec3,
    /// Unit normal of the true surface there, outwards.
    pub normal: Vec3,
    /// Texture coordinates.
    pub uv: [f32; 2],
    /// Density per steradian at the reference point.
    pub pdf: f32,
}

#[cfg(test)]
mod tests {
    use super::*;

    fn surface(position: Vec3, normal: Vec3, offset: f32) -> Surface {
        let frame = Frame::about(normal);
        Surface { position, normal, frame, uv: [0.0; 2], dp_du: frame.tangent, dp_dv: frame.bitangent, shape: 0, offset }
    }

    #[test]
    fn a_new_ray_starts_on_the_side_to_which_it_goes() {
        for scale in [1e-4, 1.0, 1e4] {
            let normal = Vec3::new(1.0, -2.0, 0.5).normalize();
            let start = surface(Vec3::splat(scale), normal, scale * 1e-6);
            for direction in [normal, -normal, Vec3::X, -Vec3::X] {
                let ray = start.spawn(direction);
                let side = (ray.origin - start.position).dot(normal) * direction.dot(normal);
                assert!(side > 0.0 && ray.reach == f32::INFINITY, "{scale} {direction}");
            }
        }
    }

    #[test]
    fn a_ray_to_a_point_ends_just_before_it() {
        let start = surface(Vec3::ZERO, Vec3::Z, 1e-6);
        let target = Vec3::new(3.0, 0.0, 4.0);
        let ray = start.spawn_to(target).unwrap();
        let gap = (target - ray.at(ray.reach)).length();
        assert!(gap > 3e-4 && gap < 7e-4, "{gap}");
        assert_eq!(surface(Vec3::ZERO, Vec3::Z, 0.0).spawn_to(Vec3::new(0.0, 0.0, f32::from_bits(1))), None);
    }
}

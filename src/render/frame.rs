//! An orthonormal frame in f32: world ↔ local with z along the normal.

use glam::Vec3;

use crate::render::lanes::Vectors;

/// Three perpendicular unit vectors; right-handed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frame {
    /// Local x.
    pub tangent: Vec3,
    /// Local y.
    pub bitangent: Vec3,
    /// Local z.
    pub normal: Vec3,
}

impl Frame {
    /// The frame about a unit vector that needs no branch (Duff et al. 2017, JCGT 6(1)).
    pub fn about(normal: Vec3) -> Self {
        let sign = 1.0_f32.copysign(normal.z);
        let a = -1.0 / (sign + normal.z);
        let b = normal.x * normal.y * a;
        Self {
            tangent: Vec3::new(1.0 + sign * normal.x * normal.x * a, sign * b, -sign * normal.x),
            bitangent: Vec3::new(b, sign + normal.y * normal.y * a, -normal.y),
            normal,
        }
    }

    /// The frame about a unit vector whose x lies in the direction of `tangent`, as far as that is perpendicular.
    ///
    /// Where `tangent` is zero or along the normal, any frame about the normal.
    pub fn along(normal: Vec3, tangent: Vec3) -> Self {
        let flat = tangent - normal * normal.dot(tangent);
        let length_squared = flat.length_squared();
        if length_squared <= 1e-10 * tangent.length_squared() || !length_squared.is_normal() {
            return Self::about(normal);
        }
        // Once more, since the first difference has lost digits where the two are nearly parallel.
        let tangent = flat / length_squared.sqrt();
        let tangent = (tangent - normal * normal.dot(tangent)).normalize();
        Self { tangent, bitangent: normal.cross(tangent), normal }
    }

    /// Components of a world vector along x, y and z.
    pub fn to_local(&self, vector: Vec3) -> Vec3 {
        Vec3::new(vector.dot(self.tangent), vector.dot(self.bitangent), vector.dot(self.normal))
    }

    /// The same of four world vectors.
    #[inline]
    pub fn to_local_lanes(&self, vectors: &Vectors) -> Vectors {
        Vectors { x: vectors.dot(self.tangent), y: vectors.dot(self.bitangent), z: vectors.dot(self.normal) }
    }

    /// The world vector with these components.
    pub fn to_world(&self, vector: Vec3) -> Vec3 {
        self.tangent * vector.x + self.bitangent * vector.y + self.normal * vector.z
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::stream::{Purpose, Stream};

    fn is_right_handed(frame: &Frame) -> bool {
        let near = |a: Vec3, b: Vec3| (a - b).length() < 2e-6;
        near(frame.tangent.cross(frame.bitangent), frame.normal) && near(frame.normal.cross(frame.tangent), frame.bitangent)
    }

    #[test]
    fn frames_are_right_handed_everywhere() {
        let poles = [Vec3::Z, -Vec3::Z, Vec3::new(0.0, 0.0, -0.0) + Vec3::Y, Vec3::new(1e-4, 0.0, -1.0).normalize()];
        let mut numbers = Stream::new(1, Purpose::Test).generator(0);
        let mut random = || Vec3::from_array(std::array::from_fn(|_| numbers.uniform() as f32 - 0.5)).normalize();
        let others: Vec<(Vec3, Vec3)> = (0..1000).map(|_| (random(), random())).collect();
        for normal in poles.into_iter().chain(others.iter().map(|(normal, _)| *normal)) {
            assert!(is_right_handed(&Frame::about(normal)), "{normal}");
        }
        for (normal, tangent) in others {
            let frame = Frame::along(normal, tangent);
            assert!(is_right_handed(&frame) && frame.tangent.dot(tangent) >= 0.0, "{normal} {tangent}");
        }
        assert!(is_right_handed(&Frame::along(Vec3::Y, Vec3::Y)));
        assert!(is_right_handed(&Frame::along(Vec3::Y, Vec3::ZERO)));
    }

    #[test]
    fn there_and_back_is_the_same_vector() {
        let frame = Frame::about(Vec3::new(0.48, -0.6, 0.64));
        let vector = Vec3::new(0.1, 2.0, -3.0);
        assert!((frame.to_world(frame.to_local(vector)) - vector).length() < 1e-5);
        assert!((frame.to_local(frame.normal) - Vec3::Z).length() < 1e-6);
    }
}

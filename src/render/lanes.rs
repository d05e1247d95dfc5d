//! Four vectors side by side, a lane each: for what is done to several draws of a map at once.
//!
//! Every lane has the bits that the same steps give one by one.

use glam::Vec3;
use wide::f32x4;

/// Vectors that are computed at once.
pub const LANES: usize = 4;

/// Four vectors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Vectors {
    /// Along x, or red.
    pub x: f32x4,
    /// Along y, or green.
    pub y: f32x4,
    /// Along z, or blue.
    pub z: f32x4,
}

impl Vectors {
    /// The same vector in every lane.
    #[inline]
    pub fn splat(vector: Vec3) -> Self {
        Self { x: f32x4::splat(vector.x), y: f32x4::splat(vector.y), z: f32x4::splat(vector.z) }
    }

    /// A vector for each lane.
    #[inline]
    pub fn of(vectors: [Vec3; LANES]) -> Self {
        let [x, y, z, _] = f32x4::transpose(vectors.map(|vector| f32x4::new([vector.x, vector.y, vector.z, 0.0])));
        Self { x, y, z }
    }

    /// The vector of each lane.
    #[inline]
    pub fn to_array(&self) -> [Vec3; LANES] {
        f32x4::transpose([self.x, self.y, self.z, f32x4::ZERO]).map(|lane| Vec3::from_slice(&lane.as_array()[..3]))
    }

    /// The vector of one lane.
    #[inline]
    pub fn lane(&self, lane: usize) -> Vec3 {
        Vec3::new(self.x.as_array()[lane], self.y.as_array()[lane], self.z.as_array()[lane])
    }

    /// Products with one vector.
    #[inline]
    pub fn dot(&self, vector: Vec3) -> f32x4 {
        self.x * vector.x + self.y * vector.y + self.z * vector.z
    }

    /// Products component by component.
    #[inline]
    #[must_use]
    pub fn times(&self, other: &Self) -> Self {
        Self { x: self.x * other.x, y: self.y * other.y, z: self.z * other.z }
    }

    /// Each times a number.
    #[inline]
    #[must_use]
    pub fn scaled(&self, scale: f32x4) -> Self {
        Self { x: self.x * scale, y: self.y * scale, z: self.z * scale }
    }
}

/// Light or scattering per lane, and a density per steradian.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Weighted {
    /// Colors.
    pub value: Vectors,
    /// Densities.
    pub pdf: f32x4,
}

impl Weighted {
    /// Of what each direction gives by itself.
    #[inline]
    pub fn one_by_one(directions: &Vectors, evaluate: impl Fn(Vec3) -> (Vec3, f32)) -> Self {
        let pairs = directions.to_array().map(evaluate);
        Self { value: Vectors::of(pairs.map(|pair| pair.0)), pdf: f32x4::new(pairs.map(|pair| pair.1)) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lanes_go_in_and_come_out_in_order() {
        let vectors = [Vec3::X, Vec3::new(1.0, 2.0, 3.0), Vec3::NEG_Y, Vec3::splat(0.1)];
        let lanes = Vectors::of(vectors);
        assert_eq!(lanes.to_array(), vectors);
        assert_eq!([0, 1, 2, 3].map(|lane| lanes.lane(lane)), vectors);
        let other = Vec3::new(0.3, -0.7, 1.1);
        assert_eq!(lanes.dot(other).to_array(), vectors.map(|vector| vector.dot(other)));
        assert_eq!(lanes.times(&Vectors::splat(other)).to_array(), vectors.map(|vector| vector * other));
        assert_eq!(lanes.scaled(f32x4::new([1.0, 2.0, 3.0, 4.0])).lane(3), vectors[3] * 4.0);
    }
}

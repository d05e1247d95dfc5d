//! Squares of two values, alternating over u and v.

use glam::Vec2;

/// Squares of two values on the unit square of uv.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Checker<T> {
    /// Value of the square at u = v = 0.
    pub a: T,
    /// Value of its neighbors.
    pub b: T,
    /// Squares per unit of u and of v.
    pub scale: f32,
}

impl<T: Copy> Checker<T> {
    /// The value of the square in which `uv` lies.
    #[inline]
    pub fn at(&self, uv: Vec2) -> T {
        let square = (uv * self.scale).floor();
        // Halves tell odd from even without a conversion that could overflow.
        let sum = (square.x + square.y) * 0.5;
        if sum == sum.floor() { self.a } else { self.b }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn neighbors_alternate_on_both_sides_of_zero() {
        let checker = Checker { a: 1, b: 2, scale: 4.0 };
        for (u, v, expected) in
            [(0.1, 0.1, 1), (0.3, 0.1, 2), (0.1, 0.3, 2), (0.3, 0.3, 1), (-0.1, 0.1, 2), (-0.1, -0.1, 1), (1.1, -0.3, 1)]
        {
            assert_eq!(checker.at(Vec2::new(u, v)), expected, "at {u} {v}");
        }
    }
}

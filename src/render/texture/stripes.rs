//! Stripes of two values along u.

use glam::Vec2;

/// Stripes of two values along u.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stripes<T> {
    /// Value of the stripe that begins at u = 0.
    pub a: T,
    /// Value of the other.
    pub b: T,
    /// Width of the first stripe, as a share of both.
    pub delta: f32,
    /// Pairs of stripes per unit of u.
    pub scale: f32,
}

impl<T: Copy> Stripes<T> {
    /// `a` where the fraction of scale u is below delta, else `b`.
    #[inline]
    pub fn at(&self, uv: Vec2) -> T {
        let along = uv.x * self.scale;
        if along - along.floor() < self.delta { self.a } else { self.b }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stripes_have_their_width_on_both_sides_of_zero() {
        let stripes = Stripes { a: 1, b: 2, delta: 0.25, scale: 2.0 };
        for (u, expected) in [(0.0, 1), (0.12, 1), (0.13, 2), (0.49, 2), (0.5, 1), (-0.01, 2), (-0.49, 1), (-0.3, 2)] {
            assert_eq!(stripes.at(Vec2::new(u, 0.3)), expected, "at {u}");
        }
        let none = Stripes { delta: 0.0, ..stripes };
        let all = Stripes { delta: 1.0, ..stripes };
        assert!([-0.7, 0.0, 0.2].iter().all(|u| none.at(Vec2::new(*u, 0.0)) == 2 && all.at(Vec2::new(*u, 0.0)) == 1));
    }
}

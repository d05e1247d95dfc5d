//! A warp of the unit square that follows a grid of weights: down a pyramid of sums, half by half.
//!
//! At each level a cell is cut into an upper and a lower half, the chosen one into left and right, and the point
//! is stretched from the part of the square that belongs to the half. So points that lie near each other stay
//! near each other, in both directions, where a search of row and column tears rows apart. Grids of any size: what
//! lies beyond the edge of an odd level weighs nothing.
//!
//! Beside the grid itself, which the caller keeps, a third of its number of cells in f64. Knows no map.
//!
//! After Clarberg, Jarosz, Akenine-Möller, Jensen, "Wavelet importance sampling" (2005), section 4, and McCool and
//! Harwood, "Probability trees" (1997).

use rayon::prelude::*;

/// Sums of 2 x 2 cells, of those again 2 x 2, up to one.
#[derive(Debug, Clone, PartialEq)]
pub struct Hierarchy {
    width: usize,
    height: usize,
    /// From the finest, of half the grid's size, to the one of a single sum.
    levels: Vec<Level>,
}

#[derive(Debug, Clone, PartialEq)]
struct Level {
    width: usize,
    height: usize,
    sums: Vec<f64>,
}

/// A cell of the grid, and where in it the point came to lie.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cell {
    /// Column.
    pub x: usize,
    /// Row.
    pub y: usize,
    /// Place in the cell on [0, 1)²: uniform if the point was.
    pub inside: [f64; 2],
}

/// The largest number below 1.
const BELOW_ONE: f64 = 1.0 - f64::EPSILON / 2.0;

impl Hierarchy {
    /// The pyramid over `width` x `height` cells, each at least 1, of these weights, finite and at least 0.
    pub fn new(width: usize, height: usize, weight: impl Fn(usize, usize) -> f64 + Sync) -> Self {
        let mut levels = vec![Level::over(width, height, weight)];
        loop {
            let finest = &levels[levels.len() - 1];
            if finest.sums.len() == 1 {
                return Self { width, height, levels };
            }
            let next = Level::over(finest.width, finest.height, |x, y| finest.sums[y * finest.width + x]);
            levels.push(next);
        }
    }

    /// Sum of all weights.
    pub fn total(&self) -> f64 {
        self.levels[self.levels.len() - 1].sums[0]
    }

    /// The cell that a point of [0, 1)² leads to; `weight` as it was given to [`Self::new`].
    ///
    /// `u[1]` chooses between upper and lower, `u[0]` between left and right. A cell of no weight is never reached
    /// unless there is no weight at all.
    #[inline]
    pub fn find(&self, u: [f64; 2], weight: impl Fn(usize, usize) -> f64) -> Cell {
        let mut cell = Cell { x: 0, y: 0, inside: u };
        for level in self.levels.iter().rev().skip(1) {
            cell.descend(|x, y| level.sum(x, y));
        }
        let (width, height) = (self.width, self.height);
        cell.descend(|x, y| if x < width && y < height { weight(x, y) } else { 0.0 });
        cell
    }

    /// Bytes it holds in memory.
    pub fn memory(&self) -> u64 {
        self.levels.iter().map(|level| (level.sums.len() * size_of::<f64>()) as u64).sum()
    }
}

impl Level {
    /// Sums of the 2 x 2 cells of a grid, as the descent adds them: first along rows.
    fn over(width: usize, height: usize, weight: impl Fn(usize, usize) -> f64 + Sync) -> Self {
        let at = |x: usize, y: usize| if x < width && y < height { weight(x, y) } else { 0.0 };
        let (half_width, half_height) = (width.div_ceil(2), height.div_ceil(2));
        let mut sums = vec![0.0; half_width * half_height];
        sums.par_chunks_mut(half_width).enumerate().for_each(|(row, sums)| {
            for (column, sum) in sums.iter_mut().enumerate() {
                let (x, y) = (2 * column, 2 * row);
                *sum = (at(x, y) + at(x + 1, y)) + (at(x, y + 1) + at(x + 1, y + 1));
            }
        });
        Self { width: half_width, height: half_height, sums }
    }

    #[inline]
    fn sum(&self, x: usize, y: usize) -> f64 {
        if x < self.width && y < self.height { self.sums[y * self.width + x] } else { 0.0 }
    }
}

impl Cell {
    /// One level down: to one of the four cells within this one.
    #[inline]
    fn descend(&mut self, sum: impl Fn(usize, usize) -> f64) {
        let (x, y) = (2 * self.x, 2 * self.y);
        let upper = [sum(x, y), sum(x + 1, y)];
        let lower = [sum(x, y + 1), sum(x + 1, y + 1)];
        let (is_lower, v) = chosen(self.inside[1], upper[0] + upper[1], lower[0] + lower[1]);
        let [left, right] = if is_lower { lower } else { upper };
        let (is_right, u) = chosen(self.inside[0], left, right);
        *self = Cell { x: x + usize::from(is_right), y: y + usize::from(is_lower), inside: [u, v] };
    }
}

/// Whether `u` in [0, 1) falls into the second of two weights, and where in its share.
#[inline]
fn chosen(u: f64, first: f64, second: f64) -> (bool, f64) {
    let target = u * (first + second);
    // A target that rounding put beyond what the second has, or into a first of nothing, must not land there.
    let is_second = second > 0.0 && (target >= first || first == 0.0);
    let place = if is_second { (target - first) / second } else { target / first };
    // Where there is no weight at all the place is not a number; any will do.
    (is_second, if place >= 0.0 { place.min(BELOW_ONE) } else { 0.0 })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::stream::{Purpose, Stream};

    const SIZES: [[usize; 2]; 8] = [[1, 1], [2, 1], [1, 5], [3, 5], [8, 4], [37, 9], [16, 16], [33, 2]];

    fn weights(width: usize, height: usize) -> Vec<f64> {
        let stream = Stream::new(4, Purpose::Test);
        let weight = |k: usize| {
            let [size, kind] = stream.generator(k as u64).uniform_pair();
            if kind < 0.2 { 0.0 } else { size * size * size + f64::from(kind > 0.97) * 1000.0 }
        };
        let mut weights: Vec<f64> = (0..width * height).map(weight).collect();
        weights[width * height / 2] += 1.0;
        weights
    }

    fn hierarchy(width: usize, height: usize, weights: &[f64]) -> Hierarchy {
        Hierarchy::new(width, height, |x, y| weights[y * width + x])
    }

    /// The area of the square that leads to a cell, by halving its edges: along v at each u, as cells are boxes
    /// only after their row is known.
    #[test]
    fn the_share_of_the_square_of_each_cell_is_its_weight() {
        for [width, height] in SIZES {
            let weights = weights(width, height);
            let table = hierarchy(width, height, &weights);
            let total: f64 = weights.iter().sum();
            assert!((table.total() / total - 1.0).abs() < 1e-14);
            // On a fine grid of points stretched places must fill each cell evenly: the mean place is its middle,
            // and the number of points its weight.
            let side = 400;
            let mut found = vec![(0_u32, [0.0; 2]); width * height];
            for k in 0..side * side {
                let u = [f64::from(k % side) + 0.5, f64::from(k / side) + 0.5].map(|place| place / f64::from(side));
                let cell = table.find(u, |x, y| weights[y * width + x]);
                let entry = &mut found[cell.y * width + cell.x];
                entry.0 += 1;
                (0..2).for_each(|axis| entry.1[axis] += cell.inside[axis]);
            }
            for ((count, places), weight) in found.iter().zip(&weights) {
                let share = f64::from(*count) / f64::from(side * side);
                // The edge of a cell is crossed by some four lines of points of each side.
                assert!((share - weight / total).abs() < 4.0 / f64::from(side), "{width}x{height}: {share} {}", weight / total);
                assert!(*weight > 0.0 || *count == 0);
                if share > 0.05 {
                    assert!(places.iter().all(|sum| (sum / f64::from(*count) - 0.5).abs() < 0.05), "{width}x{height}");
                }
            }
        }
    }

    #[test]
    fn what_weighs_nothing_is_never_reached() {
        for lit in 0..15 {
            let weights: Vec<f64> = (0..15).map(|k| if k == lit { 1e-300 } else { 0.0 }).collect();
            let table = hierarchy(3, 5, &weights);
            for u in [0.0, 0.25, 0.5, 0.75, BELOW_ONE] {
                for v in [0.0, 0.4, 0.6, BELOW_ONE] {
                    let cell = table.find([u, v], |x, y| weights[y * 3 + x]);
                    assert_eq!(cell.y * 3 + cell.x, lit);
                    assert!(cell.inside.iter().all(|place| (0.0..1.0).contains(place)));
                }
            }
        }
    }

    #[test]
    fn nothing_is_not_a_number_where_there_is_no_weight() {
        let cell = hierarchy(4, 2, &[0.0; 8]).find([0.3, 0.9], |_, _| 0.0);
        assert!(cell.x < 4 && cell.y < 2 && cell.inside.iter().all(|place| (0.0..1.0).contains(place)));
    }

    #[test]
    fn neighbors_on_the_square_stay_neighbors() {
        // An even grid is the identity.
        let table = Hierarchy::new(8, 4, |_, _| 1.0);
        for [u, v] in [[0.1, 0.2], [0.99, 0.5], [0.0, 0.999], [0.625, 0.0]] {
            let cell = table.find([u, v], |_, _| 1.0);
            assert!(((cell.x as f64 + cell.inside[0]) / 8.0 - u).abs() < 1e-15);
            assert!(((cell.y as f64 + cell.inside[1]) / 4.0 - v).abs() < 1e-15);
        }
    }

    #[test]
    fn a_third_of_the_cells_are_kept() {
        assert!(Hierarchy::new(1024, 512, |_, _| 1.0).memory() < 1024 * 512 * 8 * 34 / 100);
    }
}

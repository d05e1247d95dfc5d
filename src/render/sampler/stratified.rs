//! Correlated multi-jitter: N points, one in each cell of an m x n grid and one in each of N rows and columns.
//!
//! After Kensler, "Correlated multi-jittered sampling", Pixar technical memo 13-01 (2013); the permutation of a
//! small set is our own. Any count works: a prime one is a Latin hypercube.

use std::num::NonZeroU32;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::mixed;

/// Jittered strata. Another number of samples gives other samples, so such a render cannot be continued.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Stratified {
    /// Camera rays a pixel; squares and products of near factors are spread best.
    #[schemars(range(min = 1, max = 16_777_216))]
    pub samples_per_pixel: NonZeroU32,
    /// Independent sets into which the samples are split, for the error bar; must divide the number of samples.
    /// Default 1, and 2 where the film has the layer `variance`.
    #[serde(default)]
    #[schemars(range(min = 1, max = 64))]
    pub replicates: Option<NonZeroU32>,
}

/// The strata of a count: `columns * rows` cells.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Grid {
    columns: u32,
    rows: u32,
}

impl Grid {
    /// The factors of `count` nearest to its root.
    pub fn of(count: u32) -> Self {
        let columns = (1..=count.isqrt()).rev().find(|columns| count.is_multiple_of(*columns)).unwrap_or(1);
        Self { columns, rows: count.max(1) / columns }
    }

    /// Point `index` of the set of that key.
    pub fn pair(self, key: u64, index: u32) -> [u32; 2] {
        let Self { columns, rows } = self;
        let cell = permuted(index, columns * rows, key);
        let (column, row) = (cell % columns, cell / columns);
        let row_in_column = permuted(row, rows, mixed(key ^ 1));
        let column_in_row = permuted(column, columns, mixed(key ^ 2));
        let jitter = mixed(key ^ (u64::from(cell) << 2) ^ 3);
        [
            placed(u64::from(column) * u64::from(rows) + u64::from(row_in_column), columns * rows, (jitter >> 32) as u32),
            placed(u64::from(row) * u64::from(columns) + u64::from(column_in_row), columns * rows, jitter as u32),
        ]
    }
}

/// The number (stratum + jitter) / count, as a fraction of 2^32.
fn placed(stratum: u64, count: u32, jitter: u32) -> u32 {
    let numerator = (u128::from(stratum) << 32) + u128::from(jitter);
    (numerator / u128::from(count)) as u32
}

/// A permutation of 0..count by a key: a bijection of the next power of two, applied until the result is below `count`.
fn permuted(index: u32, count: u32, key: u64) -> u32 {
    let mask = count.next_power_of_two() - 1;
    let half = (32 - mask.leading_zeros()).div_ceil(2);
    let mut value = index;
    loop {
        for round in 0..3 {
            let bits = mixed(key ^ round);
            // Each step is a bijection of the masked bits: an odd factor, a shift folded in, a sum.
            value = value.wrapping_mul(bits as u32 | 1) & mask;
            value ^= value >> half.max(1);
            value = value.wrapping_add((bits >> 32) as u32) & mask;
        }
        if value < count {
            return value;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_permutation_hits_everything_once() {
        for count in [1, 2, 3, 5, 8, 17, 64, 100] {
            for key in 0..20 {
                let mut seen = vec![false; count as usize];
                (0..count).for_each(|index| seen[permuted(index, count, mixed(key)) as usize] = true);
                assert!(seen.iter().all(|seen| *seen), "{count} {key}");
            }
        }
    }

    #[test]
    fn every_cell_row_and_column_holds_one_point() {
        for count in [1, 4, 7, 12, 64, 100] {
            let grid = Grid::of(count);
            for key in 0..10 {
                let points: Vec<[f64; 2]> =
                    (0..count).map(|index| grid.pair(mixed(key), index).map(|bits| f64::from(bits) / 4_294_967_296.0)).collect();
                let occupied = |cell: &dyn Fn(&[f64; 2]) -> u32| {
                    let mut cells: Vec<u32> = points.iter().map(cell).collect();
                    cells.sort_unstable();
                    cells.dedup();
                    cells.len() as u32
                };
                let at = |value: f64, count: u32| (value * f64::from(count) + 1e-7) as u32;
                assert_eq!(occupied(&|point| at(point[0], grid.columns) * grid.rows + at(point[1], grid.rows)), count);
                assert_eq!(occupied(&|point| at(point[0], count)), count);
                assert_eq!(occupied(&|point| at(point[1], count)), count);
            }
        }
    }
}

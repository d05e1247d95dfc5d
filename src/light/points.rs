//! Points of the unit square for a set of samples: independent, in clusters, in strata, or scrambled Sobol.
//!
//! Point k of a set is a function of seed, purpose, the number of the set and k, so that sets are the same for any number of threads.
//! Knows nothing of what the points lead to; see `warp`.
//!
//! After Cochran, "Sampling Techniques", 3rd edition, chapter 10 (two-stage sampling); Owen, "Randomly permuted
//! (t, m, s)-nets and (t, s)-sequences" (1995), by the hashes of Burley (2020), see `math::sobol`.

use crate::math::sobol::Scramble;
use crate::math::stream::{Purpose, Stream};

/// How the points of a set are spread over the unit square.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Arrangement {
    /// Each independent of the others.
    Independent,
    /// sqrt(count) second coordinates, each with as many first ones.
    RowsThenColumns,
    /// One uniform point in each of `count` equal cells.
    Stratified,
    /// The first points of Sobol's sequence, scrambled after Owen: one in each elementary interval where the count is a
    /// power of two, and well spread for any count.
    Sobol,
}

/// One set of points.
#[derive(Debug, Clone, Copy)]
pub struct PointSet {
    first: u64,
    kind: Kind,
}

#[derive(Debug, Clone, Copy)]
enum Kind {
    Independent(Stream),
    RowsThenColumns { columns: Stream, rows: Stream, side: u64 },
    Stratified { stream: Stream, cells: [usize; 2] },
    Sobol(Scramble),
}

impl PointSet {
    /// Set number `index` of `count` points each; sets of other numbers are independent of it.
    ///
    /// A `count` that is no square number is rounded down for `RowsThenColumns`; callers refuse it before.
    pub fn new(arrangement: Arrangement, count: usize, seed: u64, purpose: Purpose, index: u64) -> Self {
        let stream = Stream::new(seed, purpose);
        let kind = match arrangement {
            Arrangement::Independent => Kind::Independent(stream),
            Arrangement::RowsThenColumns => {
                Kind::RowsThenColumns { columns: stream, rows: Stream::new(seed, Purpose::Rows), side: count.isqrt().max(1) as u64 }
            }
            Arrangement::Stratified => Kind::Stratified { stream, cells: strata(count) },
            Arrangement::Sobol => Kind::Sobol(Scramble::of(stream.generator(index).bits())),
        };
        Self { first: index.wrapping_mul(count as u64), kind }
    }

    /// Point `k` of the set, on [0, 1)².
    #[inline]
    pub fn point(&self, k: u64) -> [f64; 2] {
        let number = self.first.wrapping_add(k);
        match self.kind {
            Kind::Independent(stream) => stream.generator(number).uniform_pair(),
            Kind::RowsThenColumns { columns, rows, side } => {
                [columns.generator(number).uniform(), rows.generator(self.first.wrapping_add(k / side)).uniform()]
            }
            Kind::Stratified { stream, cells } => jittered(cells, k, stream.generator(number).uniform_pair()),
            Kind::Sobol(scramble) => scramble.point(k as u32),
        }
    }
}

/// Rows and columns of the cells of a stratified set: rows x columns = `count`, as near to a square as that allows.
///
/// Columns are the larger part, as a map is wider than high. Of a prime they are all: choose counts with factors.
pub fn strata(count: usize) -> [usize; 2] {
    let rows = (1..=count.isqrt()).rev().find(|rows| count.is_multiple_of(*rows)).unwrap_or(1);
    [rows, count / rows]
}

/// The largest number below 1.
const BELOW_ONE: f64 = 1.0 - f64::EPSILON / 2.0;

/// The point of cell k (row by row) of [rows, columns] cells at `u` within it.
fn jittered([rows, columns]: [usize; 2], k: u64, u: [f64; 2]) -> [f64; 2] {
    let (row, column) = (k / columns as u64, k % columns as u64);
    let across = (column as f64 + u[0]) / columns as f64;
    let down = (row as f64 + u[1]) / rows as f64;
    // The last cell's end may round up to 1.
    [across.min(BELOW_ONE), down.min(BELOW_ONE)]
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn strata_multiply_to_the_count_and_are_nearly_square() {
        let expected = [(1, [1, 1]), (2, [1, 2]), (12, [3, 4]), (64, [8, 8]), (128, [8, 16]), (1000, [25, 40]), (97, [1, 97])];
        for (count, cells) in expected {
            assert_eq!(strata(count), cells);
        }
    }

    #[test]
    fn jittered_points_stay_in_their_own_cells() {
        for count in [1_usize, 7, 12, 64, 1000] {
            let [rows, columns] = strata(count);
            let end = jittered([rows, columns], count as u64 - 1, [BELOW_ONE; 2]);
            assert!(end.iter().all(|&coordinate| coordinate < 1.0));
            for u in [[0.0, 0.0], [0.5, 0.9], [0.999_999_999; 2]] {
                let cells: BTreeSet<_> = (0..count as u64)
                    .map(|k| jittered([rows, columns], k, u))
                    .map(|[across, down]| ((across * columns as f64) as usize, (down * rows as f64) as usize))
                    .collect();
                assert_eq!(cells.len(), count);
                assert!(cells.iter().all(|&(column, row)| column < columns && row < rows));
            }
        }
    }

    fn set(arrangement: Arrangement, count: usize, index: u64) -> Vec<[f64; 2]> {
        let set = PointSet::new(arrangement, count, 5, Purpose::Test, index);
        (0..count as u64).map(|k| set.point(k)).collect()
    }

    #[test]
    fn sobol_points_fall_one_into_each_elementary_interval_for_any_power_of_two() {
        // Beyond the 65 536 points that tables of direction numbers often end at.
        for m in [0, 1, 4, 9, 17] {
            let points = set(Arrangement::Sobol, 1 << m, 3);
            for k in [0, m / 2, m] {
                let cells = |[u, v]: &[f64; 2]| ((u * f64::from(1 << k)) as u32, (v * f64::from(1 << (m - k))) as u32);
                assert_eq!(points.iter().map(cells).collect::<BTreeSet<_>>().len(), 1 << m, "m {m} k {k}");
            }
        }
    }

    #[test]
    fn sets_differ_by_their_number_and_longer_ones_begin_with_shorter_ones() {
        for arrangement in [Arrangement::Independent, Arrangement::Stratified, Arrangement::Sobol, Arrangement::RowsThenColumns] {
            assert_ne!(set(arrangement, 16, 1), set(arrangement, 16, 2));
            assert_eq!(set(arrangement, 16, 1), set(arrangement, 16, 1));
        }
        for arrangement in [Arrangement::Independent, Arrangement::Sobol] {
            assert_eq!(set(arrangement, 100, 0), set(arrangement, 1000, 0)[..100]);
        }
    }
}

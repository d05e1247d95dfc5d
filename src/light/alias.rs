//! Alias tables for a distribution: a row, then a column of it, in constant time.
//!
//! A uniform number chooses one of n equal boxes; its fraction decides whether the box's own item or the one that
//! shares the box is meant, and is stretched again, so that nothing of the point is wasted. A bucket is a 32-bit
//! float and an index, and beside it stand the intensities of the two pixels that it may lead to: sixteen bytes a pixel, one
//! place in memory a draw, the probability included. The price is that items that share a box
//! are no neighbors, so points that are well spread are less so afterwards.
//!
//! A threshold keeps its 24 digits however small it is, and an item below the average gets its mass from its own box
//! alone; so every pixel's probability is realized to one part in 10^7, faint ones too.
//!
//! After Walker, "An efficient method for generating discrete random variables with general distributions" (1977), built
//! by the method of Vose, "A linear algorithm for generating random numbers with a given distribution" (1991).

use rayon::prelude::*;

use crate::light::distribution::Distribution;

/// One of n equal boxes.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Bucket {
    /// Share of the box that belongs to the item of its own index.
    threshold: f32,
    /// The item to which the rest belongs.
    alias: u32,
}

/// A box of a row of pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Column {
    bucket: Bucket,
    /// Intensity of the pixel of the box's own index, and of the other.
    intensities: [f32; 2],
}

/// Alias tables of the rows of a distribution and of the columns of each row.
#[derive(Debug, Clone, PartialEq)]
pub struct AliasTables {
    width: usize,
    rows: Vec<Bucket>,
    columns: Vec<Column>,
}

/// Where a point leads.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Found {
    /// Column.
    pub x: usize,
    /// Row.
    pub y: usize,
    /// Intensity of the pixel.
    pub intensity: f32,
    /// Where in the pixel's share the point lies, on [0, 1)².
    pub inside: [f64; 2],
}

/// The largest number below 1.
const BELOW_ONE: f64 = 1.0 - f64::EPSILON / 2.0;

impl AliasTables {
    /// The tables of a distribution; each row is one worker's. `check` is asked for each row.
    pub fn new<E: Send>(distribution: &Distribution, check: impl Fn() -> Result<(), E> + Sync) -> Result<Self, E> {
        let (width, height) = (distribution.width(), distribution.height());
        let mut columns = vec![Column { bucket: WHOLE, intensities: [0.0; 2] }; width * height];
        let spare = || vec![WHOLE; width];
        columns.par_chunks_mut(width).enumerate().try_for_each_init(spare, |buckets, (y, columns)| {
            check()?;
            let intensities = &distribution.intensities()[y * width..(y + 1) * width];
            fill(buckets, intensities.iter().map(|&intensity| f64::from(intensity)));
            for (x, (column, bucket)) in columns.iter_mut().zip(buckets.iter()).enumerate() {
                *column = Column { bucket: *bucket, intensities: [intensities[x], intensities[bucket.alias as usize]] };
            }
            Ok(())
        })?;
        let mut rows = vec![WHOLE; height];
        fill(&mut rows, (0..height).map(|y| distribution.row_weight(y)));
        Ok(Self { width, rows, columns })
    }

    /// The pixels of points of [0, 1)²: the second coordinate chooses the row.
    ///
    /// Every step is a loop of its own over all points: the one that reads the table, which is larger than a cache, does nothing
    /// else, so that all its reads are on their way at once.
    #[inline]
    pub fn find_all<const N: usize>(&self, points: &[[f64; 2]; N]) -> [Found; N] {
        let mut found = [Found::default(); N];
        let mut boxes = [(0, 0.0); N];
        for ((found, place), point) in found.iter_mut().zip(&mut boxes).zip(points) {
            let (row, fraction) = boxed(point[1], self.rows.len());
            let (is_own, inside) = self.rows[row].choice(fraction);
            found.y = if is_own { row } else { self.rows[row].alias as usize };
            found.inside[1] = inside;
            *place = boxed(point[0], self.width);
        }
        let mut columns = [Column { bucket: WHOLE, intensities: [0.0; 2] }; N];
        for ((column, found), (index, _)) in columns.iter_mut().zip(&found).zip(&boxes) {
            *column = self.columns[found.y * self.width + index];
        }
        for ((found, Column { bucket, intensities }), (index, fraction)) in found.iter_mut().zip(columns).zip(boxes) {
            let (is_own, inside) = bucket.choice(fraction);
            found.x = if is_own { index } else { bucket.alias as usize };
            found.intensity = if is_own { intensities[0] } else { intensities[1] };
            found.inside[0] = inside;
        }
        found
    }

    /// Bytes it holds in memory.
    pub fn memory(&self) -> u64 {
        (self.rows.len() * size_of::<Bucket>() + self.columns.len() * size_of::<Column>()) as u64
    }
}

/// A box that belongs to its own item alone.
const WHOLE: Bucket = Bucket { threshold: 1.0, alias: 0 };

impl Bucket {
    /// Whether a fraction of the box belongs to its own item, and where in its owner's share it lies.
    #[inline]
    fn choice(self, fraction: f64) -> (bool, f64) {
        let threshold = f64::from(self.threshold);
        // Selections, not branches: which way it goes cannot be predicted.
        let is_own = fraction < threshold;
        let (start, length) = if is_own { (0.0, threshold) } else { (threshold, 1.0 - threshold) };
        (is_own, ((fraction - start) / length).min(BELOW_ONE))
    }
}

/// The box of `count` that `u` in [0, 1) falls into, and the fraction that is left.
#[inline]
fn boxed(u: f64, count: usize) -> (usize, f64) {
    let scaled = u * count as f64;
    let index = (scaled as usize).min(count - 1);
    (index, (scaled - index as f64).min(BELOW_ONE))
}

/// Fills the buckets for these weights, at least 0; without any weight all are equal.
fn fill(buckets: &mut [Bucket], weights: impl Iterator<Item = f64> + Clone) {
    let total: f64 = weights.clone().sum();
    for (index, bucket) in buckets.iter_mut().enumerate() {
        *bucket = Bucket { threshold: 1.0, alias: index as u32 };
    }
    if total <= 0.0 {
        return;
    }
    let scale = buckets.len() as f64 / total;
    let mut masses: Vec<f64> = weights.map(|weight| weight * scale).collect();
    let heaviest = masses.iter().enumerate().fold(0, |best, (index, mass)| if *mass > masses[best] { index } else { best });
    let (mut small, mut large): (Vec<usize>, Vec<usize>) = (0..masses.len()).partition(|&index| masses[index] < 1.0);
    while let Some(item) = small.pop() {
        let Some(&giver) = large.last() else {
            // Rounding left the givers a hair short. What weighs nothing must not become reachable by that.
            if masses[item] == 0.0 {
                buckets[item] = Bucket { threshold: 0.0, alias: heaviest as u32 };
            }
            continue;
        };
        buckets[item] = Bucket { threshold: masses[item] as f32, alias: giver as u32 };
        masses[giver] -= 1.0 - masses[item];
        if masses[giver] < 1.0 {
            large.pop();
            small.push(giver);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::convert::Infallible;

    use super::*;
    use crate::light::distribution::Settings;
    use crate::light::test_maps::noisy;
    use crate::math::stream::{Purpose, Stream};

    /// The item that `u` chooses, and where in its share it lies.
    fn find(buckets: &[Bucket], u: f64) -> (usize, f64) {
        let (index, fraction) = boxed(u, buckets.len());
        let (is_own, place) = buckets[index].choice(fraction);
        (if is_own { index } else { buckets[index].alias as usize }, place)
    }

    fn filled(weights: &[f64]) -> Vec<Bucket> {
        let mut buckets = vec![Bucket { threshold: 0.0, alias: 0 }; weights.len()];
        fill(&mut buckets, weights.iter().copied());
        buckets
    }

    /// What each item gets: its own box's share and those of the boxes it shares.
    fn realized(buckets: &[Bucket]) -> Vec<f64> {
        let mut masses = vec![0.0; buckets.len()];
        for (index, bucket) in buckets.iter().enumerate() {
            masses[index] += f64::from(bucket.threshold) / buckets.len() as f64;
            masses[bucket.alias as usize] += (1.0 - f64::from(bucket.threshold)) / buckets.len() as f64;
        }
        masses
    }

    fn rough(count: usize) -> Vec<f64> {
        let stream = Stream::new(9, Purpose::Test);
        let weight = |k: usize| {
            let [size, kind] = stream.generator(k as u64).uniform_pair();
            if kind < 0.3 { 0.0 } else { crate::math::elementary::pow(10.0, 12.0 * size - 9.0) }
        };
        (0..count).map(weight).collect()
    }

    #[test]
    fn every_item_gets_its_share_however_faint() {
        for weights in [rough(1), rough(2), rough(17), rough(1000), vec![1.0; 64], vec![0.0, 0.0, 3.0], vec![1e-30, 1.0]] {
            let total: f64 = weights.iter().sum();
            if total == 0.0 {
                continue;
            }
            for (found, weight) in realized(&filled(&weights)).iter().zip(&weights) {
                let expected = weight / total;
                // A rounding to f32 of its own threshold and of those who share with it.
                assert!((found - expected).abs() <= 2e-7 * expected, "{found} {expected}");
                assert!(*weight > 0.0 || *found == 0.0);
            }
        }
    }

    #[test]
    fn numbers_are_stretched_again_over_each_share() {
        let weights = [0.5, 3.0, 0.0, 1.5];
        let buckets = filled(&weights);
        let count = 400_000;
        let mut sums = [(0_u32, 0.0, 0.0); 4];
        for k in 0..count {
            let (item, place) = find(&buckets, (f64::from(k) + 0.5) / f64::from(count));
            assert!((0.0..1.0).contains(&place));
            sums[item].0 += 1;
            sums[item].1 += place;
            sums[item].2 += place * place;
        }
        for ((hits, first, second), weight) in sums.into_iter().zip(weights) {
            assert!((f64::from(hits) / f64::from(count) - weight / 5.0).abs() < 1e-5);
            if hits > 0 {
                assert!((first / f64::from(hits) - 0.5).abs() < 1e-4 && (second / f64::from(hits) - 1.0 / 3.0).abs() < 1e-4);
            }
        }
    }

    #[test]
    fn ends_of_the_unit_interval_land_on_what_weighs_something() {
        for lit in 0..5 {
            let weights: Vec<f64> = (0..5).map(|k| if k == lit { 1e-30 } else { 0.0 }).collect();
            for u in [0.0, 0.2, 0.4, 0.999, BELOW_ONE] {
                assert_eq!(find(&filled(&weights), u).0, lit);
            }
        }
    }

    #[test]
    fn rows_and_columns_follow_the_distribution() {
        let map = noisy(37, 9);
        let table = Distribution::build(&map, &Settings::default(), || Ok::<(), Infallible>(())).unwrap();
        let aliases = AliasTables::new(&table, || Ok::<(), Infallible>(())).unwrap();
        let rows = realized(&aliases.rows);
        for (y, row) in rows.iter().enumerate() {
            let of_row = &aliases.columns[y * 37..(y + 1) * 37];
            let columns = realized(&of_row.iter().map(|column| column.bucket).collect::<Vec<_>>());
            for (x, column) in columns.iter().enumerate() {
                let (found, expected) = (row * column, table.pmf(x, y));
                assert!((found - expected).abs() <= 4e-7 * expected, "({x}, {y}): {found} {expected}");
            }
        }
        assert!(aliases.memory() == 37 * 9 * 16 + 9 * 8);
        let points: [[f64; 2]; 64] = std::array::from_fn(|k| Stream::new(3, Purpose::Test).generator(k as u64).uniform_pair());
        for found in aliases.find_all(&points) {
            assert_eq!(found.intensity, table.intensities()[found.y * 37 + found.x]);
        }
        assert!(AliasTables::new(&table, || Err("stop")).is_err());
    }
}

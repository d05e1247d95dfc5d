//! Directions drawn from a distribution, from the sphere, or about a normal.
//!
//! Sample k takes its numbers from the stream at k alone, so that a set is the same for any number of
//! threads and the first N of an `independent` set are the set of N. Says nothing of how samples are used; see `relight`.
//!
//! After Pharr, Jakob, Humphreys, "Physically Based Rendering", 3rd edition, chapters 7 and 13; Cochran,
//! "Sampling Techniques", 3rd edition, chapter 10 (two-stage sampling).

use std::f64::consts::PI;

use glam::DVec3;
use rayon::prelude::*;

use crate::light::distribution::Distribution;
use crate::light::envmap::{self, EnvMap};
use crate::light::samples::{Frame, Sample, SampleSet};
use crate::math::elementary;
use crate::math::sphere;
use crate::math::stream::{Purpose, Stream};

/// Why there is no set of samples.
#[derive(Debug, thiserror::Error)]
pub enum SamplingError<E> {
    /// As many rows as columns need a square number of samples.
    #[error("`{count}` samples are not a square number, as many rows as columns in each: try `{below}` or `{above}`")]
    NotSquare {
        /// The count asked for.
        count: usize,
        /// The square below it.
        below: usize,
        /// The square above it.
        above: usize,
    },
    /// There is no room for that many.
    #[error("`{count}` samples do not fit into memory: {} bytes each", size_of::<Sample>())]
    TooMany {
        /// The count asked for.
        count: usize,
    },
    /// The caller's check said to stop.
    #[error("interrupted")]
    Interrupted(E),
}

/// Draws `count` directions independently of each other.
///
/// Directions are those that pixels stand for; the density is the pixel's probability over its solid angle.
pub fn independent<E>(
    distribution: &Distribution,
    count: usize,
    seed: u64,
    check: impl Fn() -> Result<(), E>,
) -> Result<SampleSet, SamplingError<E>> {
    let stream = Stream::new(seed, Purpose::Sampling);
    pixels(distribution, count, |k| stream.generator(k).uniform_pair(), check)
}

/// Draws sqrt(`count`) rows, then as many columns in each: the second report's way.
///
/// Two-stage cluster sampling, not stratification: unbiased, never better than `independent` and up to
/// sqrt(`count`) times worse in variance. Samples of a row follow each other.
pub fn rows_then_columns<E>(
    distribution: &Distribution,
    count: usize,
    seed: u64,
    check: impl Fn() -> Result<(), E>,
) -> Result<SampleSet, SamplingError<E>> {
    let side = count.isqrt();
    if side * side != count {
        return Err(SamplingError::NotSquare { count, below: side * side, above: (side + 1) * (side + 1) });
    }
    let rows = Stream::new(seed, Purpose::Rows);
    let columns = Stream::new(seed, Purpose::Sampling);
    let row = |k: u64| rows.generator(k / side as u64).uniform();
    pixels(distribution, count, |k| [columns.generator(k).uniform(), row(k)], check)
}

/// Draws one point of each of `count` equal cells of the unit square, and the pixels they lead to.
///
/// The square has as many rows and columns of cells as [`strata`] gives; within its cell a point is
/// uniform (jittered). Cells follow each other row by row.
pub fn stratified<E>(
    distribution: &Distribution,
    count: usize,
    seed: u64,
    check: impl Fn() -> Result<(), E>,
) -> Result<SampleSet, SamplingError<E>> {
    let stream = Stream::new(seed, Purpose::Sampling);
    let strata = strata(count);
    pixels(distribution, count, |k| jittered(strata, k, stream.generator(k).uniform_pair()), check)
}

/// Rows and columns of the cells of a stratified set: rows x columns = `count`, as near to a square as that allows.
///
/// Columns are the larger part, as a map is wider than high. Of a prime they are all: choose counts with factors.
pub fn strata(count: usize) -> [usize; 2] {
    let rows = (1..=count.isqrt()).rev().find(|rows| count.is_multiple_of(*rows)).unwrap_or(1);
    [rows, count / rows]
}

/// Draws `count` directions uniform on the sphere, in world space.
///
/// Pixels, and their probability, are those of the lat-long map of `map_size` (width, height) that contain the
/// directions; without a map both are 0.
pub fn uniform<E>(
    map_size: Option<[u32; 2]>,
    count: usize,
    seed: u64,
    check: impl Fn() -> Result<(), E>,
) -> Result<SampleSet, SamplingError<E>> {
    let stream = Stream::new(seed, Purpose::Sampling);
    let sample_at = |k: u64| {
        let direction = sphere::uniform_sphere(stream.generator(k).uniform_pair());
        let sample = direction_sample(direction, sphere::uniform_sphere_pdf());
        match map_size {
            Some([width, height]) => {
                let (x, y) = envmap::pixel_containing(direction, width as usize, height as usize);
                let pmf = envmap::solid_angle_of_pixel(y, width as usize, height as usize) * sphere::uniform_sphere_pdf();
                Sample { x: x as u32, y: y as u32, pmf, ..sample }
            }
            None => sample,
        }
    };
    let samples = collect(count, |start| std::array::from_fn(|i| sample_at(start + i as u64)), check)?;
    let [map_width, map_height] = map_size.unwrap_or_default();
    Ok(SampleSet { map_width, map_height, frame: Frame::World, samples })
}

/// Draws `count` directions about +z with density cosine over pi, to be turned to each normal.
///
/// They belong to no map: pixels and their probability are 0.
pub fn cosine<E>(count: usize, seed: u64, check: impl Fn() -> Result<(), E>) -> Result<SampleSet, SamplingError<E>> {
    let stream = Stream::new(seed, Purpose::Sampling);
    let sample_at = |k: u64| {
        let direction = sphere::cosine_hemisphere(stream.generator(k).uniform_pair());
        direction_sample(direction, sphere::cosine_hemisphere_pdf(direction.z))
    };
    let samples = collect(count, |start| std::array::from_fn(|i| sample_at(start + i as u64)), check)?;
    Ok(SampleSet { map_width: 0, map_height: 0, frame: Frame::Normal, samples })
}

/// Sets the radiance of each sample from `env`: of its own pixel where the set was drawn from a map of
/// that size, else of the pixel that contains its direction.
///
/// Directions about a normal have no radiance before they are turned, and keep none.
pub fn look_up(set: &mut SampleSet, env: &EnvMap) {
    if set.frame == Frame::Normal {
        return;
    }
    let has_pixels = (set.map_width as usize, set.map_height as usize) == (env.width(), env.height());
    set.samples.par_iter_mut().with_min_len(1024).for_each(|sample| {
        let own = || env.raster.pixel(sample.x as usize, sample.y as usize);
        sample.radiance = Some(if has_pixels { own() } else { env.nearest(sample.direction) });
    });
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

/// A sample that belongs to no pixel.
fn direction_sample(direction: DVec3, pdf: f64) -> Sample {
    let [u, v] = envmap::square_at(direction);
    Sample { x: 0, y: 0, u, v, direction, pmf: 0.0, pdf, radiance: None }
}

/// The pixels to which the points lead, `point(k)` for sample k.
fn pixels<E>(
    distribution: &Distribution,
    count: usize,
    point: impl Fn(u64) -> [f64; 2] + Sync,
    check: impl Fn() -> Result<(), E>,
) -> Result<SampleSet, SamplingError<E>> {
    let directions = Directions::of(distribution);
    let batch = |start: u64| {
        let points: [[f64; 2]; BATCH] = std::array::from_fn(|i| point(start + i as u64));
        distribution.sample_all(&points).map(|pixel| {
            let (x, y) = (pixel.x as usize, pixel.y as usize);
            let [u, v] = [directions.columns[x].position, directions.rows[y].position];
            let pdf = pixel.pmf / distribution.solid_angle(y);
            Sample { x: pixel.x, y: pixel.y, u, v, direction: directions.at(x, y), pmf: pixel.pmf, pdf, radiance: None }
        })
    };
    let samples = collect(count, batch, check)?;
    let (map_width, map_height) = (distribution.width() as u32, distribution.height() as u32);
    Ok(SampleSet { map_width, map_height, frame: Frame::World, samples })
}

/// Sines and cosines of all rows and columns: thousands, where samples may be millions.
struct Directions {
    rows: Vec<Angle>,
    columns: Vec<Angle>,
}

#[derive(Clone, Copy)]
struct Angle {
    sin: f64,
    cos: f64,
    /// On the unit square.
    position: f64,
}

impl Directions {
    fn of(distribution: &Distribution) -> Self {
        let angle = |radians: f64, whole: f64| {
            let (sin, cos) = elementary::sin_cos(radians);
            Angle { sin, cos, position: radians / whole }
        };
        Self {
            rows: (0..distribution.height()).map(|y| angle(distribution.theta(y), PI)).collect(),
            columns: (0..distribution.width()).map(|x| angle(distribution.phi(x), 2.0 * PI)).collect(),
        }
    }

    /// As [`envmap::direction_at`] gives it.
    fn at(&self, x: usize, y: usize) -> DVec3 {
        let (theta, phi) = (self.rows[y], self.columns[x]);
        DVec3::new(theta.sin * phi.cos, theta.cos, theta.sin * phi.sin)
    }
}

/// Samples that are made together.
const BATCH: usize = 32;

/// Batches between two checks: some ten milliseconds.
const BATCHES_PER_CHECK: usize = 1 << 13;

/// The first `count` samples of the batches; `batch(start)` gives those from `start` on.
fn collect<E>(
    count: usize,
    batch: impl Fn(u64) -> [Sample; BATCH] + Sync,
    check: impl Fn() -> Result<(), E>,
) -> Result<Vec<Sample>, SamplingError<E>> {
    let batch_count = count.div_ceil(BATCH);
    let mut batches: Vec<[Sample; BATCH]> = Vec::new();
    batches.try_reserve_exact(batch_count).map_err(|_| SamplingError::TooMany { count })?;
    for first in (0..batch_count).step_by(BATCHES_PER_CHECK) {
        check().map_err(SamplingError::Interrupted)?;
        let last = (first + BATCHES_PER_CHECK).min(batch_count);
        // An indexed range goes straight to its place in the reserved memory, in order.
        batches.par_extend((first..last).into_par_iter().with_min_len(8).map(|index| batch((index * BATCH) as u64)));
    }
    let mut samples = batches.into_flattened();
    samples.truncate(count);
    Ok(samples)
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;
    use std::convert::Infallible;

    use super::*;
    use crate::image::raster::Raster;
    use crate::light::distribution::Settings;
    use crate::light::envmap::Angles;

    fn go() -> Result<(), Infallible> {
        Ok(())
    }

    fn map() -> EnvMap {
        let stream = Stream::new(5, Purpose::Test);
        EnvMap::new(Raster::new(24, 12, (0..24 * 12).map(|k| [stream.generator(k).uniform() as f32; 3]).collect()))
    }

    fn table(map: &EnvMap) -> Distribution {
        Distribution::build(map, &Settings::default(), go).unwrap()
    }

    #[test]
    fn a_sample_knows_its_pixel_its_direction_and_its_density() {
        for angles in [Angles::Center, Angles::Edge, Angles::EdgeInclusive] {
            let mut map = map();
            map.angles = angles;
            let table = table(&map);
            for sample in independent(&table, 200, 1, go).unwrap().samples {
                let (x, y) = (sample.x as usize, sample.y as usize);
                assert_eq!(sample.direction, map.direction(x, y));
                assert_eq!([sample.u, sample.v], table.position(x, y));
                assert_eq!((sample.pmf, sample.pdf), (table.pmf(x, y), table.pdf_of_pixel(x, y)));
                assert_eq!(sample.radiance, None);
            }
        }
    }

    #[test]
    fn a_longer_independent_set_begins_with_the_shorter() {
        let table = table(&map());
        let long = independent(&table, 5000, 9, go).unwrap();
        for count in [1, 31, 32, 33, 4999] {
            assert_eq!(independent(&table, count, 9, go).unwrap().samples, long.samples[..count]);
        }
        assert_ne!(independent(&table, 32, 10, go).unwrap().samples, long.samples[..32]);
    }

    #[test]
    fn sets_do_not_depend_on_the_number_of_threads() {
        let table = table(&map());
        let draw = || (independent(&table, 70_000, 2, go).unwrap(), uniform(Some([24, 12]), 3_000, 2, go).unwrap());
        let pool = |count| rayon::ThreadPoolBuilder::new().num_threads(count).build().unwrap();
        assert_eq!(pool(1).install(draw), pool(3).install(draw));
    }

    #[test]
    fn rows_then_columns_shares_each_row_among_its_columns() {
        let table = table(&map());
        let set = rows_then_columns(&table, 100, 4, go).unwrap();
        for row in set.samples.chunks(10) {
            assert!(row.iter().all(|sample| sample.y == row[0].y));
            assert!(row.iter().map(|sample| sample.x).collect::<BTreeSet<_>>().len() > 3);
        }
        let error = rows_then_columns(&table, 99, 4, go).unwrap_err().to_string();
        assert!(error.contains("square") && error.contains("`81` or `100`"), "{error}");
    }

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

    #[test]
    fn uniform_samples_carry_the_pixel_that_contains_them() {
        let set = uniform(Some([24, 12]), 500, 6, go).unwrap();
        assert_eq!((set.map_width, set.map_height, set.frame), (24, 12, Frame::World));
        for sample in set.samples {
            assert_eq!((sample.x as usize, sample.y as usize), envmap::pixel_containing(sample.direction, 24, 12));
            assert!((sample.pmf - envmap::solid_angle_of_pixel(sample.y as usize, 24, 12) / (4.0 * PI)).abs() < 1e-16);
            assert_eq!(sample.pdf, 1.0 / (4.0 * PI));
        }
        let free = uniform(None, 3, 6, go).unwrap();
        assert_eq!((free.map_width, free.samples[0].x, free.samples[0].pmf), (0, 0, 0.0));
    }

    #[test]
    fn cosine_samples_lie_about_the_normal_with_their_density() {
        let set = cosine(500, 6, go).unwrap();
        assert_eq!(set.frame, Frame::Normal);
        assert!(set.samples.iter().all(|sample| sample.direction.z > 0.0 && sample.pdf == sample.direction.z / PI));
    }

    #[test]
    fn radiance_comes_from_the_samples_own_pixel_or_from_its_direction() {
        let map = map();
        let mut set = independent(&table(&map), 100, 1, go).unwrap();
        look_up(&mut set, &map);
        assert!(set.samples.iter().all(|sample| sample.radiance == Some(map.raster.pixel(sample.x as usize, sample.y as usize))));
        let other = EnvMap::new(Raster::filled(7, 3, [2.0; 3]));
        look_up(&mut set, &other);
        assert!(set.samples.iter().all(|sample| sample.radiance == Some([2.0; 3])));
        let mut turned = cosine(3, 1, go).unwrap();
        look_up(&mut turned, &other);
        assert_eq!(turned.samples[0].radiance, None);
    }

    #[test]
    fn drawing_stops_when_told_to_and_refuses_what_cannot_fit() {
        let table = table(&map());
        assert!(matches!(independent(&table, 10, 1, || Err("stop")), Err(SamplingError::Interrupted("stop"))));
        assert!(matches!(independent(&table, usize::MAX / 256, 1, go), Err(SamplingError::TooMany { .. })));
    }
}

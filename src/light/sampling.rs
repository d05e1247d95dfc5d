//! Directions drawn from a distribution, from the sphere, or about a normal.
//!
//! Sample k is a function of the seed and k alone, so that a set is the same for any number of threads, and the first N
//! of an `Independent` or `Sobol` set are the set of N. Says nothing of how samples are used; see `relight`. Points
//! of the unit square are `points`, their ways to pixels `warp`.
//!
//! After Pharr, Jakob, Humphreys, "Physically Based Rendering", 3rd edition, chapters 7 and 13.

use std::f64::consts::PI;

use glam::DVec3;
use rayon::prelude::*;

use crate::light::distribution::{Distribution, Pixel, Placed};
use crate::light::envmap::{self, Angles, Band, EnvMap};
use crate::light::points::{Arrangement, PointSet};
use crate::light::samples::{Frame, Sample, SampleSet};
use crate::light::warp::{Warp, WarpKind};
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
    /// Places within pixels are those of pixel centers.
    #[error("places inside pixels need a map whose pixels stand for their centers; this one's stand for other points (`angles`)")]
    NotCentered,
    /// The report's look-up says nothing of places.
    #[error("a look-up of the nearest cumulative probability gives pixels, no places inside them; draw pixel centers")]
    NoPlaces,
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

/// Where in its pixel a direction lies.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Placement {
    /// At the direction that the pixel stands for; the density is the pixel's probability over its solid angle.
    #[default]
    Center,
    /// Uniform in u and v: the density P W H / (2 pi² sin theta) grows towards the nearer pole.
    Uv,
    /// Uniform in solid angle: the density is the pixel's probability over its solid angle, everywhere in it.
    SolidAngle,
}

/// How a set is drawn from a distribution.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Draw {
    /// How many directions.
    pub count: usize,
    /// The seed.
    pub seed: u64,
    /// How points are spread over the unit square.
    pub arrangement: Arrangement,
    /// How a point finds its pixel.
    pub warp: WarpKind,
    /// Where in the pixel the direction lies.
    pub placement: Placement,
}

impl Draw {
    /// Pixel centers by inversion.
    pub fn of(arrangement: Arrangement, count: usize, seed: u64) -> Self {
        Self { count, seed, arrangement, warp: WarpKind::Marginal, placement: Placement::Center }
    }
}

/// Draws directions from a distribution.
///
/// # Errors
/// `NotSquare` for rows then columns of another count, `NotCentered` and `NoPlaces` for placements that cannot be,
/// `TooMany`, and what `check` gives.
pub fn draw<E: Send>(
    distribution: &Distribution,
    draw: &Draw,
    check: impl Fn() -> Result<(), E> + Sync,
) -> Result<SampleSet, SamplingError<E>> {
    let (count, side) = (draw.count, draw.count.isqrt());
    if draw.arrangement == Arrangement::RowsThenColumns && side * side != count {
        return Err(SamplingError::NotSquare { count, below: side * side, above: (side + 1) * (side + 1) });
    }
    let sampler = Sampler::new(distribution, draw.warp, draw.placement, &check)?;
    let points = PointSet::new(draw.arrangement, count, draw.seed, Purpose::Sampling, 0);
    let batch = |start: u64| sampler.samples(&std::array::from_fn(|i| points.point(start + i as u64)));
    let samples = collect(count, batch, check)?;
    let (map_width, map_height) = (distribution.width() as u32, distribution.height() as u32);
    Ok(SampleSet { map_width, map_height, frame: Frame::World, samples })
}

/// Draws `count` directions independently of each other, through pixel centers.
///
/// # Errors
/// As [`draw`].
pub fn independent<E: Send>(
    distribution: &Distribution,
    count: usize,
    seed: u64,
    check: impl Fn() -> Result<(), E> + Sync,
) -> Result<SampleSet, SamplingError<E>> {
    draw(distribution, &Draw::of(Arrangement::Independent, count, seed), check)
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

/// A sample that belongs to no pixel.
fn direction_sample(direction: DVec3, pdf: f64) -> Sample {
    let [u, v] = envmap::square_at(direction);
    Sample { x: 0, y: 0, u, v, direction, pmf: 0.0, pdf, radiance: None }
}

/// Points to directions: a warp, and where in the pixel.
#[derive(Debug)]
pub struct Sampler<'a> {
    warp: Warp<'a>,
    placement: Placement,
    directions: Directions,
}

impl<'a> Sampler<'a> {
    /// Builds what drawing needs beside the distribution.
    ///
    /// # Errors
    /// `NotCentered`, `NoPlaces`, and what `check` gives.
    pub fn new<E: Send>(
        distribution: &'a Distribution,
        warp: WarpKind,
        placement: Placement,
        check: impl Fn() -> Result<(), E> + Sync,
    ) -> Result<Self, SamplingError<E>> {
        if placement != Placement::Center && distribution.angles() != Angles::Center {
            return Err(SamplingError::NotCentered);
        }
        if placement != Placement::Center && matches!(warp, WarpKind::Nearest { .. }) {
            return Err(SamplingError::NoPlaces);
        }
        let warp = Warp::new(distribution, warp, check).map_err(SamplingError::Interrupted)?;
        Ok(Self { warp, placement, directions: Directions::of(distribution) })
    }

    /// The samples of points of [0, 1)², without radiance.
    pub fn samples<const N: usize>(&self, points: &[[f64; 2]; N]) -> [Sample; N] {
        match self.placement {
            Placement::Center => self.warp.sample_all(points).map(|pixel| self.central(pixel)),
            Placement::Uv => self.warp.place_all(points).map(|placed| self.in_square(placed)),
            Placement::SolidAngle => self.warp.place_all(points).map(|placed| self.in_solid_angle(placed)),
        }
    }

    /// Directions of points of [0, 1)² with the map's radiance and their densities: all that an estimate needs, and no more.
    ///
    /// The directions, radiances and densities of [`Self::samples`], but for roundings.
    pub fn lit<const N: usize>(&self, map: &EnvMap, points: &[[f64; 2]; N]) -> [Lit; N] {
        let pixel = |x: u32, y: u32| map.raster.pixel(x as usize, y as usize);
        if self.placement != Placement::SolidAngle {
            let lit = |sample: Sample| Lit { direction: sample.direction, radiance: pixel(sample.x, sample.y), pdf: sample.pdf };
            return self.samples(points).map(lit);
        }
        let placed = self.warp.place_all(points);
        let mut all = [Lit { direction: DVec3::ZERO, radiance: [0.0; 3], pdf: 0.0 }; N];
        // Apart from the arithmetic, so that all reads are on their way at once.
        for (lit, placed) in all.iter_mut().zip(&placed) {
            lit.radiance = pixel(placed.pixel.x, placed.pixel.y);
        }
        for (lit, Placed { pixel, inside }) in all.iter_mut().zip(placed) {
            lit.pdf = pixel.pmf * self.directions.densities[pixel.y as usize];
            lit.direction = self.directions.within(pixel, inside);
        }
        all
    }

    /// Density per steradian with which a unit direction is drawn; the same function as that of the samples.
    pub fn pdf(&self, direction: DVec3) -> f64 {
        let distribution = self.warp.distribution();
        let (x, y) = distribution.pixel_at(direction);
        match self.placement {
            Placement::Center | Placement::SolidAngle => distribution.pdf_of_pixel(x, y),
            Placement::Uv => self.pdf_on_square(distribution.pmf(x, y), (1.0 - direction.y * direction.y).max(0.0).sqrt()),
        }
    }

    /// P W H / (2 pi² sin theta); 0 at the poles, where no sample lies.
    fn pdf_on_square(&self, pmf: f64, sin_theta: f64) -> f64 {
        let distribution = self.warp.distribution();
        let pixel_count = distribution.width() as f64 * distribution.height() as f64;
        if sin_theta > 0.0 { pmf * pixel_count / (2.0 * PI * PI * sin_theta) } else { 0.0 }
    }

    fn central(&self, pixel: Pixel) -> Sample {
        let (x, y) = (pixel.x as usize, pixel.y as usize);
        let [u, v] = [self.directions.columns[x].position, self.directions.rows[y].position];
        let pdf = pixel.pmf / self.warp.distribution().solid_angle(y);
        Sample { x: pixel.x, y: pixel.y, u, v, direction: self.directions.at(x, y), pmf: pixel.pmf, pdf, radiance: None }
    }

    fn in_square(&self, Placed { pixel, inside }: Placed) -> Sample {
        let distribution = self.warp.distribution();
        // A hair off the pole, where the density is infinite.
        let down = if pixel.y == 0 { inside[1].max(f64::from(f32::EPSILON)) } else { inside[1] };
        let u = (f64::from(pixel.x) + inside[0]) / distribution.width() as f64;
        let v = (f64::from(pixel.y) + down) / distribution.height() as f64;
        let (theta, phi) = (elementary::sin_cos(v * PI), elementary::sin_cos(u * 2.0 * PI));
        let direction = DVec3::new(theta.0 * phi.1, theta.1, theta.0 * phi.0);
        Sample { x: pixel.x, y: pixel.y, u, v, direction, pmf: pixel.pmf, pdf: self.pdf_on_square(pixel.pmf, theta.0), radiance: None }
    }

    fn in_solid_angle(&self, Placed { pixel, inside }: Placed) -> Sample {
        let distribution = self.warp.distribution();
        let direction = self.directions.within(pixel, inside);
        let u = (f64::from(pixel.x) + inside[0]) / distribution.width() as f64;
        let Band { top, bottom, side } = self.directions.bands[pixel.y as usize];
        let from_pole = 2.0 * elementary::asin(((top + (bottom - top) * inside[1]) / 2.0).sqrt()) / PI;
        let v = if side > 0.0 { from_pole } else { 1.0 - from_pole };
        let pdf = pixel.pmf / distribution.solid_angle(pixel.y as usize);
        Sample { x: pixel.x, y: pixel.y, u, v, direction, pmf: pixel.pmf, pdf, radiance: None }
    }
}

/// A direction from which a map shines.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lit {
    /// Unit direction towards the map.
    pub direction: DVec3,
    /// What comes from there.
    pub radiance: [f32; 3],
    /// Density per steradian.
    pub pdf: f64,
}

/// Sines and cosines of all rows and columns: thousands, where samples may be millions.
#[derive(Debug)]
struct Directions {
    rows: Vec<Angle>,
    columns: Vec<Angle>,
    bands: Vec<Band>,
    /// Of each column: cosine and sine at its left edge.
    edges: Vec<[f64; 2]>,
    /// Azimuth that a column spans, in radians.
    column_angle: f64,
    /// Of each row: one over the solid angle of a pixel.
    densities: Vec<f64>,
}

#[derive(Debug, Clone, Copy)]
struct Angle {
    sin: f64,
    cos: f64,
    /// On the unit square.
    position: f64,
}

/// Cosine and sine of an angle in radians.
fn edge(radians: f64) -> [f64; 2] {
    let (sin, cos) = elementary::sin_cos(radians);
    [cos, sin]
}

/// Angles below this many radians have cosine and sine from [`small_turn`].
const SMALL_TURN: f64 = 0.1;

/// Cosine and sine of a small angle by their series, to all digits.
#[inline]
fn small_turn(radians: f64) -> [f64; 2] {
    let square = radians * radians;
    let cos = 1.0 - square / 2.0 * (1.0 - square / 12.0 * (1.0 - square / 30.0 * (1.0 - square / 56.0)));
    let sin = radians * (1.0 - square / 6.0 * (1.0 - square / 20.0 * (1.0 - square / 42.0 * (1.0 - square / 72.0))));
    [cos, sin]
}

impl Directions {
    fn of(distribution: &Distribution) -> Self {
        let angle = |radians: f64, whole: f64| {
            let (sin, cos) = elementary::sin_cos(radians);
            Angle { sin, cos, position: radians / whole }
        };
        let (height, column_angle) = (distribution.height(), 2.0 * PI / distribution.width() as f64);
        Self {
            rows: (0..height).map(|y| angle(distribution.theta(y), PI)).collect(),
            columns: (0..distribution.width()).map(|x| angle(distribution.phi(x), 2.0 * PI)).collect(),
            bands: (0..height).map(|y| Band::of_row(y, height)).collect(),
            edges: (0..distribution.width()).map(|x| edge(x as f64 * column_angle)).collect(),
            column_angle,
            densities: (0..height).map(|y| 1.0 / distribution.solid_angle(y)).collect(),
        }
    }

    /// The direction at a place in a pixel that is uniform in solid angle if the place is uniform on [0, 1)².
    #[inline]
    fn within(&self, pixel: Pixel, inside: [f64; 2]) -> DVec3 {
        let Band { top, bottom, side } = self.bands[pixel.y as usize];
        // 1 - |cos theta|, whose digits do not cancel near the poles, is uniform in solid angle.
        let depth = top + (bottom - top) * inside[1];
        let sin_theta = (depth * (2.0 - depth)).sqrt();
        let ([cos_edge, sin_edge], turn) = (self.edges[pixel.x as usize], inside[0] * self.column_angle);
        let [cos_turn, sin_turn] = if self.column_angle < SMALL_TURN { small_turn(turn) } else { edge(turn) };
        let cos_phi = cos_edge * cos_turn - sin_edge * sin_turn;
        let sin_phi = sin_edge * cos_turn + cos_edge * sin_turn;
        DVec3::new(sin_theta * cos_phi, side * (1.0 - depth), sin_theta * sin_phi)
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
    use crate::light::test_maps::noisy;

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
        let clusters = |count| draw(&table, &Draw::of(Arrangement::RowsThenColumns, count, 4), go);
        let set = clusters(100).unwrap();
        for row in set.samples.chunks(10) {
            assert!(row.iter().all(|sample| sample.y == row[0].y));
            assert!(row.iter().map(|sample| sample.x).collect::<BTreeSet<_>>().len() > 3);
        }
        let error = clusters(99).unwrap_err().to_string();
        assert!(error.contains("square") && error.contains("`81` or `100`"), "{error}");
    }

    const ALL: [Placement; 3] = [Placement::Center, Placement::Uv, Placement::SolidAngle];
    const WARPS: [WarpKind; 3] = [WarpKind::Marginal, WarpKind::Alias, WarpKind::Hierarchical];

    #[test]
    fn the_density_of_a_sample_is_the_density_of_its_direction() {
        let map = map();
        let table = table(&map);
        for warp in WARPS {
            for placement in ALL {
                let sampler = Sampler::new(&table, warp, placement, go).unwrap();
                let how = Draw { warp, placement, ..Draw::of(Arrangement::Sobol, 3000, 8) };
                let mut differing = 0;
                for sample in draw(&table, &how, go).unwrap().samples {
                    assert!((sample.direction.length() - 1.0).abs() < 1e-14);
                    let [u, v] = envmap::square_at(sample.direction);
                    assert!((u - sample.u).abs() < 1e-12 && (v - sample.v).abs() < 1e-7, "{placement:?}: {v} {}", sample.v);
                    // A direction on the very edge of a pixel may be taken for its neighbor's.
                    differing += u32::from((sampler.pdf(sample.direction) / sample.pdf - 1.0).abs() > 1e-9);
                    assert_eq!(sample.pmf, table.pmf(sample.x as usize, sample.y as usize));
                }
                assert!(differing <= 1, "{warp:?} {placement:?}: {differing}");
            }
        }
    }

    #[test]
    fn small_turns_are_turns_to_all_digits() {
        for k in 0..=1000 {
            let radians = SMALL_TURN * f64::from(k) / 1000.0;
            let ([cos, sin], [cos_found, sin_found]) = (edge(radians), small_turn(radians));
            assert!((cos - cos_found).abs() < 2.0 * f64::EPSILON && (sin - sin_found).abs() < f64::EPSILON, "{radians}");
        }
    }

    #[test]
    fn lit_directions_are_those_of_the_samples() {
        let map = noisy(96, 48);
        let table = table(&map);
        for warp in WARPS {
            for placement in ALL {
                let sampler = Sampler::new(&table, warp, placement, go).unwrap();
                let points: [[f64; 2]; 64] = std::array::from_fn(|k| Stream::new(2, Purpose::Test).generator(k as u64).uniform_pair());
                for (lit, sample) in sampler.lit(&map, &points).iter().zip(sampler.samples(&points)) {
                    assert!((lit.direction - sample.direction).length() < 1e-14);
                    assert!((lit.pdf / sample.pdf - 1.0).abs() < 1e-14);
                    assert_eq!(lit.radiance, map.raster.pixel(sample.x as usize, sample.y as usize));
                }
            }
        }
    }

    /// The mean of 1 / pdf over the whole sphere is 4 pi, as every pixel of this map shines.
    #[test]
    fn densities_measure_the_sphere_for_every_placement() {
        let map = map();
        let table = Distribution::build(&map, &Settings { defensive: 0.5, ..Settings::default() }, go).unwrap();
        for warp in WARPS {
            for placement in ALL {
                let how = Draw { warp, placement, ..Draw::of(Arrangement::Sobol, 1 << 14, 8) };
                let samples = draw(&table, &how, go).unwrap().samples;
                let mean = samples.iter().map(|sample| 1.0 / sample.pdf).sum::<f64>() / samples.len() as f64;
                assert!((mean / (4.0 * PI) - 1.0).abs() < 5e-3, "{warp:?} {placement:?}: {mean}");
                let up = samples.iter().map(|sample| sample.direction.y * sample.direction.y / sample.pdf).sum::<f64>();
                assert!((up / samples.len() as f64 / (4.0 * PI / 3.0) - 1.0).abs() < 2e-2, "{warp:?} {placement:?}");
            }
        }
    }

    #[test]
    fn what_cannot_be_placed_is_refused() {
        let mut edge = map();
        edge.angles = Angles::Edge;
        let uv = Draw { placement: Placement::Uv, ..Draw::of(Arrangement::Sobol, 4, 1) };
        assert!(matches!(draw(&table(&edge), &uv, go), Err(SamplingError::NotCentered)));
        let nearest = Draw { warp: WarpKind::Nearest { reports_intended: true }, ..uv };
        assert!(matches!(draw(&table(&map()), &nearest, go), Err(SamplingError::NoPlaces)));
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
        let alias = Draw { warp: WarpKind::Alias, ..Draw::of(Arrangement::Independent, 10, 1) };
        assert!(matches!(draw(&table, &alias, || Err("stop")), Err(SamplingError::Interrupted("stop"))));
        assert!(matches!(independent(&table, usize::MAX / 256, 1, go), Err(SamplingError::TooMany { .. })));
    }
}

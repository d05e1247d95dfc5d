//! A diffuse sphere from directions drawn about +z and turned to each normal.
//!
//! With cosine-distributed directions the cosine cancels against the density, and the estimate is the mean of
//! the radiances met. Each normal looks its directions up in the map, so finding a pixel must be quick.

use std::f64::consts::PI;

use glam::DVec3;

use crate::image::raster::Image;
use crate::light::envmap::EnvMap;
use crate::light::relight::estimators::{RelightError, SampleEstimator, check_sizes, reflected};
use crate::light::relight::sphere::{self, Scanline};
use crate::light::samples::SampleSet;
use crate::math::elementary;
use crate::math::sphere::frame_about;

/// Directions about a normal with weights, and the map they look into.
pub struct TurnedDirections<'a> {
    map: &'a EnvMap,
    finder: PixelFinder,
    /// Local direction, and cosine over N and, if pdf-weighted, over the density.
    weighted: Vec<(DVec3, f64)>,
    /// Samples left out because their density is 0.
    pub skipped_count: usize,
}

/// How many directions are looked up before the caller is asked whether to stop.
const DIRECTIONS_PER_CHECK: usize = 1 << 16;

impl<'a> TurnedDirections<'a> {
    /// Samples about +z under `EqualWeight` or `PdfWeighted`.
    ///
    /// # Errors
    /// `NoSamples`, `OtherMap`, and `NoPixels` for the other two estimators.
    pub fn new(samples: &SampleSet, map: &'a EnvMap, estimator: SampleEstimator) -> Result<Self, RelightError> {
        check_sizes(samples, Some(map))?;
        let scale = 1.0 / samples.samples.len() as f64;
        let mut weighted = Vec::with_capacity(samples.samples.len());
        for sample in &samples.samples {
            let cosine = sample.direction.z.max(0.0);
            match estimator {
                SampleEstimator::EqualWeight => weighted.push((sample.direction, cosine * scale)),
                SampleEstimator::PdfWeighted if sample.pdf > 0.0 => weighted.push((sample.direction, cosine / sample.pdf * scale)),
                SampleEstimator::PdfWeighted => {}
                SampleEstimator::NormalizedColor | SampleEstimator::NormalizedColorSine => {
                    return Err(RelightError::NoPixels { estimator: estimator.name() });
                }
            }
        }
        let skipped_count = samples.samples.len() - weighted.len();
        Ok(Self { map, finder: PixelFinder::new(map.width(), map.height()), weighted, skipped_count })
    }

    /// Irradiance on a surface with that unit normal.
    ///
    /// # Errors
    /// What `check` gives.
    pub fn irradiance<E>(&self, normal: DVec3, check: &impl Fn() -> Result<(), E>) -> Result<[f64; 3], E> {
        let frame = frame_about(normal);
        let mut sum = [0.0; 3];
        for weighted in self.weighted.chunks(DIRECTIONS_PER_CHECK) {
            check()?;
            for (direction, weight) in weighted {
                let (x, y) = self.finder.pixel(frame * *direction);
                let radiance = self.map.raster.pixel(x, y);
                (0..3).for_each(|channel| sum[channel] += weight * f64::from(radiance[channel]));
            }
        }
        Ok(sum)
    }

    /// The radiance of a diffuse sphere of `size` x `size` pixels.
    ///
    /// # Errors
    /// What `check` gives.
    pub fn relight<E: Send>(&self, size: usize, albedo: [f64; 3], check: impl Fn() -> Result<(), E> + Sync) -> Result<Image, E> {
        let radiance = |normal: &DVec3| Ok(reflected(albedo, self.irradiance(*normal, &check)?));
        sphere::picture(size, |line: &Scanline| line.normals.iter().map(radiance).collect())
    }
}

/// Finds the pixel that contains a direction without arc functions.
///
/// Edges of rows are compared by their cosine, edges of columns by |z| / (|x| + |z|) counted on through the
/// quadrants; both only grow, and a table of buckets says where to begin comparing.
struct PixelFinder {
    /// cos(j pi / H) for j in 0..=H.
    row_edges: Vec<f64>,
    first_rows: Vec<u32>,
    /// Turn of 2 pi i / W for i in 0..=W, from 0 to 4.
    column_edges: Vec<f64>,
    first_columns: Vec<u32>,
}

impl PixelFinder {
    fn new(width: usize, height: usize) -> Self {
        let row_edges: Vec<f64> = (0..=height).map(|j| elementary::cos(j as f64 * PI / height as f64)).collect();
        let column_edge = |i: usize| match i {
            i if i == width => 4.0,
            i => {
                let (sin, cos) = elementary::sin_cos(i as f64 * 2.0 * PI / width as f64);
                turn(cos, sin)
            }
        };
        let column_edges: Vec<f64> = (0..=width).map(column_edge).collect();

        let row_from_top = |bucket: usize| 1.0 - bucket as f64 / (2.0 * height as f64);
        let first_rows = (0..=4 * height).map(|bucket| first_row(&row_edges, 0, row_from_top(bucket)) as u32).collect();
        let turn_of = |bucket: usize| bucket as f64 / width as f64;
        let first_columns = (0..=4 * width).map(|bucket| first_column(&column_edges, 0, turn_of(bucket)) as u32).collect();
        Self { row_edges, first_rows, column_edges, first_columns }
    }

    /// Column and row.
    fn pixel(&self, direction: DVec3) -> (usize, usize) {
        let (width, height) = (self.column_edges.len() - 1, self.row_edges.len() - 1);
        let row_bucket = ((1.0 - direction.y) * (2.0 * height as f64)) as usize;
        // A bucket's border may be rounded to the wrong side of a row's edge, hence one step back.
        let row = (self.first_rows[row_bucket.min(4 * height)] as usize).saturating_sub(1);
        let turn = turn(direction.x, direction.z);
        let column = (self.first_columns[((turn * width as f64) as usize).min(4 * width)] as usize).saturating_sub(1);
        (first_column(&self.column_edges, column, turn), first_row(&self.row_edges, row, direction.y))
    }
}

/// The row, counted on from `row`, whose lower edge is below `y`.
fn first_row(edges: &[f64], row: usize, y: f64) -> usize {
    (row..edges.len() - 2).find(|row| y > edges[row + 1]).unwrap_or(edges.len() - 2)
}

/// The column, counted on from `column`, whose right edge is beyond `turn`.
fn first_column(edges: &[f64], column: usize, turn: f64) -> usize {
    (column..edges.len() - 2).find(|column| turn < edges[column + 1]).unwrap_or(edges.len() - 2)
}

/// Where (x, z) lies on the way around, 0 at +x, 1 at +z, 2 at -x, 3 at -z; 0 for no direction.
fn turn(x: f64, z: f64) -> f64 {
    let length = x.abs() + z.abs();
    if length == 0.0 {
        return 0.0;
    }
    match (x >= 0.0, z >= 0.0) {
        (true, true) => z / length,
        (false, true) => 1.0 - x / length,
        (false, false) => 2.0 - z / length,
        (true, false) => 3.0 + x / length,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::envmap::{direction_at, pixel_containing};
    use crate::math::stream::{Purpose, Stream};

    #[test]
    fn the_finder_agrees_with_arc_functions() {
        let stream = Stream::new(3, Purpose::Test);
        for (width, height) in [(1, 1), (2, 1), (7, 5), (64, 32), (1024, 512)] {
            let finder = PixelFinder::new(width, height);
            for index in 0..20_000 {
                let [u, v] = stream.generator(index).uniform_pair();
                let direction = direction_at(v * PI, u * 2.0 * PI);
                assert_eq!(finder.pixel(direction), pixel_containing(direction, width, height), "{direction}");
            }
            for direction in [DVec3::X, DVec3::Y, DVec3::Z] {
                assert_eq!(finder.pixel(direction), pixel_containing(direction, width, height), "{direction}");
            }
        }
    }
}

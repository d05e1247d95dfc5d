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

        // Buckets begin a little early, so that no rounding puts a direction before the first pixel of its bucket.
        let top_of = |bucket: usize| 1.0 - (bucket as f64 - 1e-3) * 2.0 / (BUCKETS * height) as f64;
        let first_rows = (0..=BUCKETS * height).map(|bucket| row_from(&row_edges, 0, top_of(bucket)) as u32).collect();
        let turn_of = |bucket: usize| (bucket as f64 - 1e-3) * 4.0 / (BUCKETS * width) as f64;
        let first_columns = (0..=BUCKETS * width).map(|bucket| column_from(&column_edges, 0, turn_of(bucket)) as u32).collect();
        Self { row_edges, first_rows, column_edges, first_columns }
    }

    /// Column and row.
    fn pixel(&self, direction: DVec3) -> (usize, usize) {
        let depth = (1.0 - direction.y) * (self.first_rows.len() as f64 - 1.0) / 2.0;
        let first_row = self.first_rows[(depth as usize).min(self.first_rows.len() - 1)];
        let turn = turn(direction.x, direction.z);
        let way = turn * ((self.first_columns.len() as f64 - 1.0) / 4.0);
        let first_column = self.first_columns[(way as usize).min(self.first_columns.len() - 1)];
        (column_from(&self.column_edges, first_column as usize, turn), row_from(&self.row_edges, first_row as usize, direction.y))
    }
}

/// Buckets per pixel: so many that the first pixel is nearly always the right one.
const BUCKETS: usize = 8;

/// The first row, from `row` on, whose lower edge is below `y`.
fn row_from(edges: &[f64], mut row: usize, y: f64) -> usize {
    while row + 2 < edges.len() && y <= edges[row + 1] {
        row += 1;
    }
    row
}

/// The first column, from `column` on, whose right edge is beyond `turn`.
fn column_from(edges: &[f64], mut column: usize, turn: f64) -> usize {
    while column + 2 < edges.len() && turn >= edges[column + 1] {
        column += 1;
    }
    column
}

/// Where (x, z) lies on the way around, 0 at +x, 1 at +z, 2 at -x, 3 at -z; 0 for no direction.
fn turn(x: f64, z: f64) -> f64 {
    let part = z / (x.abs() + z.abs()).max(f64::MIN_POSITIVE);
    let from_x = if x < 0.0 { 2.0 - part } else { part };
    if from_x < 0.0 { from_x + 4.0 } else { from_x }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::envmap::{direction_at, pixel_containing};
    use crate::light::samples::{Frame, Sample};
    use crate::light::test_maps::{constant, noisy};
    use crate::math::sphere::{cosine_hemisphere, cosine_hemisphere_pdf};
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

    #[test]
    fn cosine_samples_of_a_constant_map_are_exact() {
        let map = constant(8, 4, [2.0, 1.0, 0.5]);
        let sample = |index| {
            let direction = cosine_hemisphere(Stream::new(5, Purpose::Test).generator(index).uniform_pair());
            let pdf = cosine_hemisphere_pdf(direction.z);
            Sample { x: 0, y: 0, u: 0.0, v: 0.0, direction, pmf: 0.0, pdf, radiance: None }
        };
        let set = SampleSet { map_width: 0, map_height: 0, frame: Frame::Normal, samples: (0..16).map(sample).collect() };
        let turned = TurnedDirections::new(&set, &map, SampleEstimator::PdfWeighted).unwrap();
        let image = turned.relight(7, [1.0; 3], || Ok::<(), ()>(())).unwrap();
        for index in (0..49).filter(|index| image.is_covered(*index)) {
            let pixel = image.color.pixels()[index];
            assert!((pixel[0] - 2.0).abs() < 1e-6 && (pixel[2] - 0.5).abs() < 1e-6, "{pixel:?}");
        }
        assert!(TurnedDirections::new(&set, &map, SampleEstimator::NormalizedColor).is_err());
    }

    #[test]
    fn directions_are_turned_to_the_normal() {
        // One sample along the normal itself sees the one pixel that the normal looks at.
        let map = noisy(64, 32);
        let along = Sample { x: 0, y: 0, u: 0.0, v: 0.0, direction: DVec3::Z, pmf: 0.0, pdf: 1.0 / PI, radiance: None };
        let set = SampleSet { map_width: 0, map_height: 0, frame: Frame::Normal, samples: vec![along] };
        let turned = TurnedDirections::new(&set, &map, SampleEstimator::PdfWeighted).unwrap();
        for normal in [DVec3::X, DVec3::new(0.36, 0.48, 0.8), DVec3::new(-0.6, -0.8, 0.0)] {
            let found = turned.irradiance(normal, &|| Ok::<(), ()>(())).unwrap();
            let seen = map.nearest(normal);
            assert!((0..3).all(|c| (found[c] / PI - f64::from(seen[c])).abs() < 1e-6 * f64::from(seen[c])), "{normal}");
        }
    }
}

//! The map around the scene as an emitter: radiance of a direction, and directions drawn by it.
//!
//! Densities are constant over the solid angle of a pixel, radiance is that of the nearest pixel; both stand side by
//! side, so that asking for a direction is one access to memory. Directions are drawn by a table of one 32-bit integer
//! a pixel: cumulative probabilities in units of 2^-32, whose differences make the densities; so what is drawn and
//! what is reported agree to the last digit. A pixel that shines has at least one unit. Rows and columns are found by
//! inversion, which keeps points that are well spread well spread.
//!
//! Rotation by a degrees is right-handed about +y: what was at direction d is at R_y(a) d.
//!
//! MIS compensation after Karlik, Šik, Vévoda, Skřivan, Křivánek, "MIS compensation: optimizing sampling techniques in
//! multiple importance sampling" (TOG 38(6), 2019).

use std::f64::consts::PI;

use glam::Vec3;
use rayon::prelude::*;
use wide::f32x4;

use crate::light::envmap::{self, EnvMap, solid_angle_of_pixel};
use crate::math::single;
use crate::math::turn;
use crate::render::emitter::EnvironmentParameters;
use crate::render::lanes::{LANES, Vectors, Weighted};
use crate::render::sampler::unit;

/// A map that gives light, with the density by which directions towards it are drawn.
#[derive(Debug, Clone)]
pub struct Environment {
    width: usize,
    height: usize,
    /// By pixel.
    pixels: Vec<Pixel>,
    /// Turns by which the map is rotated, from 0 to 1.
    rotation: f32,
    /// By row: its edges as heights 1 - |y| below the nearer pole, and the sign of y.
    bands: Vec<Band>,
    /// None where all directions are alike.
    table: Option<Table>,
    density: Density,
    /// Mean luminance over the sphere.
    mean: f64,
}

/// What a pixel of the map gives.
#[derive(Debug, Clone, Copy)]
#[repr(align(16))]
struct Pixel {
    /// With strength, without what is negative.
    radiance: [f32; 3],
    /// Density per steradian of drawing a direction in it.
    pdf: f32,
}

/// A row of pixels on the sphere.
#[derive(Debug, Clone, Copy)]
struct Band {
    /// 1 - |y| at its upper edge. Near a pole this has digits that y itself has lost.
    top: f32,
    /// 1 - |y| at its lower edge.
    bottom: f32,
    /// Sign of y.
    side: f32,
}

/// Which density directions are drawn by.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Density {
    /// The same everywhere.
    Uniform,
    /// In proportion to luminance.
    Full,
    /// In proportion to what luminance exceeds a part of its mean, for use beside scattering alone: with so many draws
    /// to one of scattering, the part is 2 / (draws + 1), that is all of it for one draw.
    ///
    /// Then the mean of all densities comes nearest to the luminance: (draws p + p_scattering) / (draws + 1) with the
    /// density of scattering taken for that of the hemisphere, twice that of the sphere.
    Compensated {
        /// Draws of the map to one of scattering.
        draws: u32,
    },
}

/// A direction drawn from a map.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EnvironmentSample {
    /// Towards the map.
    pub direction: Vec3,
    /// What comes from there.
    pub radiance: Vec3,
    /// Density per steradian.
    pub pdf: f32,
}

/// Four of them at once.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LightLanes {
    /// Towards the map.
    pub directions: Vectors,
    /// What comes from there, and its density.
    pub light: Weighted,
}

/// A map that cannot give light.
#[derive(Debug, thiserror::Error)]
pub enum EnvironmentError<E> {
    /// A pixel that is infinite or not a number.
    #[error("pixel ({x}, {y}) of the map around the scene is not finite; `load` it in a stage with `sanitize: zero` and give it as `env`")]
    NotFinite {
        /// Column.
        x: usize,
        /// Row.
        y: usize,
    },
    /// The work was stopped.
    #[error(transparent)]
    Interrupted(#[from] E),
}

impl Environment {
    /// The emitter of a map, and the number of pixels with a negative channel, which counts as zero.
    pub fn new<E: Send>(
        map: &EnvMap,
        parameters: &EnvironmentParameters,
        density: Density,
        check: impl Fn() -> Result<(), E> + Sync,
    ) -> Result<(Self, u64), EnvironmentError<E>> {
        let &EnvironmentParameters { strength, rotate_degrees, .. } = parameters;
        let (width, height) = (map.width(), map.height());
        let is_infinite = |color: &[f32; 3]| color.iter().any(|value| !value.is_finite());
        if let Some(place) = map.raster.pixels().par_iter().position_first(is_infinite) {
            return Err(EnvironmentError::NotFinite { x: place % width, y: place / width });
        }
        check()?;
        let is_negative = |color: &&[f32; 3]| color.iter().any(|value| *value < 0.0);
        let negative_count = map.raster.pixels().par_iter().filter(is_negative).count() as u64;
        let lit = |color: &[f32; 3]| {
            let radiance = color.map(|value| (value.max(0.0) * strength).min(f32::MAX));
            Pixel { radiance, pdf: UNIFORM_PDF }
        };
        let mut pixels: Vec<Pixel> = map.raster.pixels().par_iter().map(lit).collect();
        check()?;
        let solid_angles: Vec<f64> = (0..height).map(|y| solid_angle_of_pixel(y, width, height)).collect();
        let Luminances { mean, least } = Luminances::of(&pixels, &solid_angles);
        // A nearly constant map would be left with rounding; scattering alone is the better sampler there.
        let is_even = mean - least <= 0.01 * mean;
        let is_compensated = matches!(density, Density::Compensated { .. });
        let density = if is_compensated && is_even { Density::Full } else { density };
        check()?;
        let floor = match density {
            Density::Compensated { draws } => mean * 2.0 / (f64::from(draws) + 1.0),
            Density::Uniform | Density::Full => 0.0,
        };
        let excess = |pixel: &Pixel| (pixel.luminance() - floor).max(0.0);
        let table = (density != Density::Uniform).then(|| Table::new(&mut pixels, &solid_angles, excess));
        let rotation = (rotate_degrees / 360.0).rem_euclid(1.0) as f32;
        let bands = (0..height).map(|y| Band::from(envmap::Band::of_row(y, height))).collect();
        Ok((Self { width, height, pixels, rotation, bands, table, density, mean }, negative_count))
    }

    /// Mean luminance over the sphere.
    pub fn mean_luminance(&self) -> f64 {
        self.mean
    }

    /// The density that is used: `Full` where a compensated one was asked for and saves nothing.
    pub fn density(&self) -> Density {
        self.density
    }

    /// What comes from a unit direction.
    #[inline]
    pub fn radiance(&self, direction: Vec3) -> Vec3 {
        Vec3::from_array(self.pixels[self.pixel_at(direction)].radiance)
    }

    /// What comes from a unit direction, and the density per steradian with which it would be drawn.
    #[inline]
    pub fn radiance_and_pdf(&self, direction: Vec3) -> (Vec3, f32) {
        let Pixel { radiance, pdf } = self.pixels[self.pixel_at(direction)];
        (Vec3::from_array(radiance), pdf)
    }

    /// A direction by two uniform numbers; `None` where the map is black.
    #[inline]
    pub fn sample(&self, bits: [u32; 2]) -> Option<EnvironmentSample> {
        let Some(table) = &self.table else { return Some(self.sample_uniform(bits)) };
        let Draw { row, column, along, across } = table.draw(bits);
        let Pixel { radiance, pdf } = self.pixels[row * self.width + column];
        // Only where nothing shines is a pixel without probability drawn.
        if pdf <= 0.0 {
            return None;
        }
        let band = self.bands[row];
        // The density is constant over the solid angle: heights are uniform between the edges of the row.
        let height = band.top + (band.bottom - band.top) * across;
        let sine = (height * (2.0 - height)).sqrt();
        let turned = (column as f32 + along) / self.width as f32 - self.rotation;
        let (z, x) = single::sin_cos_of_turns(if turned < 0.0 { turned + 1.0 } else { turned });
        let direction = Vec3::new(sine * x, band.side * (1.0 - height), sine * z);
        Some(EnvironmentSample { direction, radiance: Vec3::from_array(radiance), pdf })
    }

    /// Four directions at once, each with the bits of [`Self::sample`]; the density is zero where the map is black.
    ///
    /// `None` where all directions are alike.
    #[inline]
    pub fn sample_lanes(&self, bits: [[u32; 2]; LANES]) -> Option<LightLanes> {
        let table = self.table.as_ref()?;
        let draws = bits.map(|bits| table.draw(bits));
        let pixels = draws.each_ref().map(|draw| self.pixels[draw.row * self.width + draw.column]);
        let bands = draws.each_ref().map(|draw| self.bands[draw.row]);
        let [red, green, blue, pdf] =
            f32x4::transpose(pixels.map(|Pixel { radiance: [red, green, blue], pdf }| f32x4::new([red, green, blue, pdf])));
        let number = |of: fn(&Draw) -> f32| f32x4::new(draws.each_ref().map(of));
        let edge = |of: fn(Band) -> f32| f32x4::new(bands.map(of));

        let (top, bottom) = (edge(|band| band.top), edge(|band| band.bottom));
        let height = top + (bottom - top) * number(|draw| draw.across);
        let sine = (height * (2.0 - height)).sqrt();
        let turned = number(|draw| draw.column as f32 + draw.along) / self.width as f32 - self.rotation;
        let (z, x) = single::sin_cos_of_turns_in_lanes(turned.simd_lt(f32x4::ZERO).bitselect(turned + 1.0, turned));
        let directions = Vectors { x: sine * x, y: edge(|band| band.side) * (1.0 - height), z: sine * z };
        Some(LightLanes { directions, light: Weighted { value: Vectors { x: red, y: green, z: blue }, pdf } })
    }

    fn sample_uniform(&self, bits: [u32; 2]) -> EnvironmentSample {
        let direction = uniform_sphere(bits.map(unit));
        EnvironmentSample { direction, radiance: self.radiance(direction), pdf: UNIFORM_PDF }
    }

    /// Index of the pixel in which a direction lies.
    #[inline]
    fn pixel_at(&self, direction: Vec3) -> usize {
        let sine = (direction.x * direction.x + direction.z * direction.z).sqrt();
        let v = 2.0 * turn::of_vector(direction.y, sine);
        let turned = turn::of_vector(direction.x, direction.z) + self.rotation;
        let u = if turned >= 1.0 { turned - 1.0 } else { turned };
        let row = ((v * self.height as f32) as usize).min(self.height - 1);
        let column = ((u * self.width as f32) as usize).min(self.width - 1);
        row * self.width + column
    }

    /// Bytes it holds.
    pub fn memory(&self) -> u64 {
        let table = self.table.as_ref().map_or(0, |table| size_of_val(&*table.columns) + size_of_val(&*table.guides));
        (size_of_val(&*self.pixels) + table) as u64
    }
}

impl Pixel {
    /// Luminance of Rec. 709 primaries.
    fn luminance(&self) -> f64 {
        let [red, green, blue] = self.radiance.map(f64::from);
        0.2126 * red + 0.7152 * green + 0.0722 * blue
    }
}

/// What a compensated density needs to know of all pixels.
struct Luminances {
    /// Over the sphere.
    mean: f64,
    /// Of any pixel.
    least: f64,
}

impl Luminances {
    fn of(pixels: &[Pixel], solid_angles: &[f64]) -> Self {
        let width = pixels.len() / solid_angles.len();
        let of_row = |(row, solid_angle): (&[Pixel], &f64)| {
            let sum: f64 = row.iter().map(Pixel::luminance).sum();
            (sum * solid_angle, row.iter().map(Pixel::luminance).fold(f64::INFINITY, f64::min))
        };
        let rows: Vec<(f64, f64)> = pixels.par_chunks(width).zip(solid_angles).map(of_row).collect();
        let total: f64 = rows.iter().map(|row| row.0).sum();
        Self { mean: total / (4.0 * PI), least: rows.iter().map(|row| row.1).fold(f64::INFINITY, f64::min) }
    }
}

/// 1 / 4 pi.
const UNIFORM_PDF: f32 = 0.079_577_47;

/// A direction uniform on the sphere.
#[inline]
fn uniform_sphere(point: [f32; 2]) -> Vec3 {
    let y = 1.0 - 2.0 * point[1];
    let sine = (1.0 - y * y).max(0.0).sqrt();
    let (z, x) = single::sin_cos_of_turns(point[0]);
    Vec3::new(sine * x, y, sine * z)
}

impl From<envmap::Band> for Band {
    fn from(band: envmap::Band) -> Self {
        Self { top: band.top as f32, bottom: band.bottom as f32, side: band.side as f32 }
    }
}

/// All probability, in units: cumulative sums end here.
const WHOLE: u32 = u32::MAX;

/// Cumulative probabilities of rows, and of the columns of each row.
#[derive(Debug, Clone)]
struct Table {
    width: usize,
    /// One more than there are rows.
    rows: Vec<u32>,
    row_guides: Vec<u16>,
    row_search: Search,
    /// One more for each row than there are columns.
    columns: Vec<u32>,
    /// For each row.
    guides: Vec<u16>,
    search: Search,
}

/// How a bucket is found: for equal parts of the unit interval a guide says in which bucket each begins.
///
/// Few and small guides, since what counts is how much memory many draws touch.
#[derive(Debug, Clone, Copy)]
struct Search {
    /// Of a number, to get its part.
    shift: u32,
    /// Of a bucket, to fit a guide; the search begins a little before.
    coarseness: u32,
}

/// A place on the map.
struct Draw {
    row: usize,
    column: usize,
    /// From the left edge of the pixel, 0, to its right edge, 1.
    along: f32,
    /// From the upper edge of the pixel, 0, to its lower edge, 1.
    across: f32,
}

impl Table {
    /// The table of `weight` times solid angle; writes the densities into the pixels.
    fn new(pixels: &mut [Pixel], solid_angles: &[f64], weight: impl Fn(&Pixel) -> f64 + Sync) -> Self {
        let height = solid_angles.len();
        let width = pixels.len() / height;
        let search = Search::among(width);
        let guide_count = search.guide_count();
        let mut columns = vec![0; (width + 1) * height];
        let mut guides = vec![0; guide_count * height];
        let sums: Vec<f64> = columns
            .par_chunks_mut(width + 1)
            .zip(guides.par_chunks_mut(guide_count))
            .zip(pixels.par_chunks(width).zip(solid_angles))
            .map(|((starts, guides), (row, solid_angle))| {
                let sum = accumulate(row.iter().map(&weight), starts);
                if sum > 0.0 {
                    search.fill(starts, guides);
                }
                sum * solid_angle
            })
            .collect();
        let mut rows = vec![0; height + 1];
        accumulate(sums.iter().copied(), &mut rows);
        let row_search = Search::among(height);
        let mut row_guides = vec![0; row_search.guide_count()];
        row_search.fill(&rows, &mut row_guides);
        pixels.par_chunks_mut(width).zip(columns.par_chunks(width + 1)).enumerate().for_each(|(y, (row, starts))| {
            let probability = f64::from(rows[y + 1] - rows[y]) / f64::from(WHOLE);
            let scale = (probability / f64::from(WHOLE) / solid_angles[y]) as f32;
            row.iter_mut().zip(starts.windows(2)).for_each(|(pixel, edges)| pixel.pdf = (edges[1] - edges[0]) as f32 * scale);
        });
        Self { width, rows, row_guides, row_search, columns, guides, search }
    }

    /// A pixel and a place in it.
    #[inline]
    fn draw(&self, bits: [u32; 2]) -> Draw {
        let (row, across) = self.row_search.find(&self.rows, &self.row_guides, bits[1]);
        let guide_count = self.search.guide_count();
        let starts = &self.columns[row * (self.width + 1)..][..self.width + 1];
        let guides = &self.guides[row * guide_count..][..guide_count];
        let (column, along) = self.search.find(starts, guides, bits[0]);
        Draw { row, column, along, across }
    }
}

/// Cumulative probabilities in units; gives the sum of the weights.
///
/// What weighs anything gets a unit first and its share of the rest; so it can be drawn, whatever its weight.
fn accumulate(weights: impl Iterator<Item = f64> + Clone, starts: &mut [u32]) -> f64 {
    let (mut sum, mut lit_count) = (0.0, 0_u32);
    for weight in weights.clone() {
        sum += weight;
        lit_count += u32::from(weight > 0.0);
    }
    if sum <= 0.0 {
        starts.fill(0);
        return 0.0;
    }
    let units = f64::from(WHOLE - lit_count) / sum;
    let (mut before, mut lit_before) = (0.0, 0_u32);
    for (start, weight) in starts.iter_mut().zip(weights) {
        // What follows the last that weighs anything starts at the end, whatever the rounding of the sums.
        let is_beyond = lit_before == lit_count;
        *start = if is_beyond { WHOLE } else { ((before * units) as u32).min(WHOLE - lit_count) + lit_before };
        before += weight;
        lit_before += u32::from(weight > 0.0);
    }
    let last = starts.len() - 1;
    starts[last] = WHOLE;
    sum
}

impl Search {
    /// Among so many buckets: about a guide for four.
    fn among(count: usize) -> Self {
        let shift = 32 - (count / 4).max(2).next_power_of_two().trailing_zeros().min(16);
        Self { shift, coarseness: count.ilog2().saturating_sub(15) }
    }

    #[inline]
    fn guide_count(self) -> usize {
        1 << (32 - self.shift)
    }

    fn fill(self, starts: &[u32], guides: &mut [u16]) {
        let mut bucket = 0;
        for (part, guide) in guides.iter_mut().enumerate() {
            let target = (part as u64) << self.shift;
            while bucket + 2 < starts.len() && u64::from(starts[bucket + 1]) <= target {
                bucket += 1;
            }
            *guide = (bucket >> self.coarseness) as u16;
        }
    }

    /// The bucket in which a uniform number falls, and where in it, from 0 to 1.
    #[inline]
    fn find(self, starts: &[u32], guides: &[u16], bits: u32) -> (usize, f32) {
        // Of all numbers below `WHOLE`.
        let target = ((u64::from(bits) * u64::from(WHOLE)) >> 32) as u32;
        let mut bucket = usize::from(guides[(target >> self.shift) as usize]) << self.coarseness;
        while bucket + 2 < starts.len() && starts[bucket + 1] <= target {
            bucket += 1;
        }
        let (start, end) = (starts[bucket], starts[bucket + 1]);
        let place = (target.wrapping_sub(start) as f32 + 0.5) / (end.wrapping_sub(start) as f32).max(1.0);
        (bucket, place.min(1.0 - f32::EPSILON / 2.0))
    }
}

#[cfg(test)]
mod tests {
    use std::convert::Infallible;

    use super::*;
    use crate::image::raster::Raster;
    use crate::light::test_maps;
    use crate::math::elementary;
    use crate::math::statistics::chi_square_test;
    use crate::math::stream::{Purpose, Stream};

    fn made(map: &EnvMap, strength: f32, rotate_degrees: f64, density: Density) -> (Environment, u64) {
        Environment::new(map, &EnvironmentParameters { strength, rotate_degrees, ..EnvironmentParameters::default() }, density, || {
            Ok::<(), Infallible>(())
        })
        .unwrap()
    }

    fn environment(map: &EnvMap, rotate_degrees: f64, density: Density) -> Environment {
        made(map, 1.0, rotate_degrees, density).0
    }

    fn one_pixel(width: usize, height: usize, lit: usize) -> EnvMap {
        let pixels = (0..width * height).map(|place| if place == lit { [3.0, 2.0, 1.0] } else { [0.0; 3] }).collect();
        EnvMap::new(Raster::new(width, height, pixels))
    }

    const DENSITIES: [Density; 4] = [Density::Uniform, Density::Full, Density::Compensated { draws: 1 }, Density::Compensated { draws: 4 }];

    #[test]
    fn radiance_is_that_of_the_nearest_pixel() {
        for (width, height) in [(64, 32), (37, 9), (1, 1), (5, 1)] {
            let map = test_maps::noisy(width, height);
            let found = environment(&map, 0.0, Density::Uniform);
            for y in 0..height {
                for x in 0..width {
                    let direction = map.direction(x, y).as_vec3();
                    assert_eq!(found.radiance(direction).to_array(), map.raster.pixel(x, y), "({x}, {y})");
                }
            }
        }
    }

    #[test]
    fn a_rotated_map_shows_at_the_turned_direction_what_was_at_the_direction() {
        let map = test_maps::noisy(64, 32);
        let (plain, turned) = (environment(&map, 0.0, Density::Full), environment(&map, 40.0, Density::Full));
        let rotation = glam::DMat3::from_rotation_y(40.0_f64.to_radians());
        for place in 0..64 * 32 {
            let direction = map.direction(place % 64, place / 64);
            assert_eq!(turned.radiance((rotation * direction).as_vec3()), plain.radiance(direction.as_vec3()));
        }
    }

    /// What is drawn has the radiance and the density that are reported for its direction.
    #[test]
    fn drawing_and_asking_agree() {
        let map = test_maps::noisy(64, 33);
        let mut numbers = Stream::new(2, Purpose::Test).generator(0);
        for density in DENSITIES {
            let environment = environment(&map, 123.0, density);
            let mut differing = 0;
            for _ in 0..20_000 {
                let bits = numbers.bits();
                let sample = environment.sample([(bits >> 32) as u32, bits as u32]).unwrap();
                assert!((sample.direction.length() - 1.0).abs() < 1e-6);
                let asked = environment.radiance_and_pdf(sample.direction);
                differing += u32::from(asked != (sample.radiance, sample.pdf));
            }
            // Directions within rounding of an edge between pixels.
            assert!(differing < 10, "{density:?}: {differing}");
        }
    }

    #[test]
    fn lanes_have_the_bits_of_single_draws() {
        let half_black = EnvMap::new(Raster::new(8, 4, (0..32).map(|place| if place < 16 { [0.0; 3] } else { [1.0, 2.0, 0.5] }).collect()));
        for (map, rotate_degrees) in [(test_maps::noisy(64, 33), 77.0), (one_pixel(16, 8, 37), -10.0), (half_black, 0.0)] {
            let environment = environment(&map, rotate_degrees, Density::Full);
            let mut numbers = Stream::new(3, Purpose::Test).generator(0);
            for _ in 0..2000 {
                let bits = std::array::from_fn(|_| [0; 2].map(|_: u32| numbers.bits() as u32));
                let lanes = environment.sample_lanes(bits).unwrap();
                for (lane, bits) in bits.into_iter().enumerate() {
                    let EnvironmentSample { direction, radiance, pdf } = environment.sample(bits).unwrap();
                    let LightLanes { directions, light } = &lanes;
                    let found = (directions.lane(lane), light.value.lane(lane), light.pdf.to_array()[lane]);
                    assert_eq!(found, (direction, radiance, pdf));
                }
            }
        }
        let black = environment(&test_maps::constant(8, 4, [0.0; 3]), 0.0, Density::Full);
        assert_eq!(black.sample_lanes([[1 << 31; 2]; LANES]).unwrap().light.pdf, f32x4::ZERO);
        assert_eq!(environment(&test_maps::noisy(8, 4), 0.0, Density::Uniform).sample_lanes([[0; 2]; LANES]), None);
    }

    #[test]
    fn densities_integrate_to_one() {
        for map in [test_maps::noisy(64, 33), one_pixel(16, 8, 37), one_pixel(16, 8, 3), test_maps::constant(8, 4, [1.0; 3])] {
            for density in DENSITIES {
                let environment = environment(&map, 0.0, density);
                let pixel = |x: usize, y: usize| {
                    let pdf = environment.radiance_and_pdf(map.direction(x, y).as_vec3()).1;
                    f64::from(pdf) * map.solid_angle(y)
                };
                let integral: f64 = (0..map.height()).map(|y| (0..map.width()).map(|x| pixel(x, y)).sum::<f64>()).sum();
                assert!((integral - 1.0).abs() < 1e-5, "{density:?}: {integral}");
            }
        }
    }

    /// Directions fall into equal cells of height and azimuth as the integral of the density over each says.
    #[test]
    fn directions_follow_their_density() {
        let map = test_maps::noisy(24, 12);
        const DRAWS: u32 = 200_000;
        for (seed, density) in (0..).zip(DENSITIES) {
            let environment = environment(&map, 0.0, density);
            let mut numbers = Stream::new(8, Purpose::Test).generator(seed);
            let mut observed = vec![0; 24 * 12];
            for _ in 0..DRAWS {
                let bits = numbers.bits();
                let sample = environment.sample([(bits >> 32) as u32, bits as u32]).unwrap();
                // The equal-area cells are not the pixels: within a pixel the draw has to be right as well.
                let row = ((1.0 - sample.direction.y) * 6.0) as usize;
                let column = (turn::of_vector(sample.direction.x, sample.direction.z) * 24.0) as usize;
                observed[row.min(11) * 24 + column] += 1;
            }
            const FINE: usize = 40;
            let expected: Vec<f64> = (0..24 * 12)
                .map(|cell| {
                    let (row, column) = (cell / 24, cell % 24);
                    let pdf = |k: usize| {
                        let y = 1.0 - (row as f64 + (k as f64 + 0.5) / FINE as f64) / 6.0;
                        let phi = (column as f64 + 0.5) / 24.0 * 2.0 * PI;
                        let sine = (1.0 - y * y).sqrt();
                        let direction = glam::DVec3::new(sine * elementary::cos(phi), y, sine * elementary::sin(phi));
                        f64::from(environment.radiance_and_pdf(direction.as_vec3()).1)
                    };
                    let mean = (0..FINE).map(pdf).sum::<f64>() / FINE as f64;
                    f64::from(DRAWS) * mean * 4.0 * PI / (24.0 * 12.0)
                })
                .collect();
            let test = chi_square_test(&observed, &expected);
            assert!(test.p_value > 1e-4, "{density:?}: {test:?}");
        }
    }

    #[test]
    fn only_what_shines_is_drawn_however_faint_and_wherever_it_is() {
        for lit in [0, 5, 31, 32 * 7, 32 * 15, 32 * 16 - 1] {
            let mut map = one_pixel(32, 16, lit);
            map.raster.set_pixel(3, 9, [1e-30; 3]);
            let environment = environment(&map, 0.0, Density::Full);
            for k in 0..=65_535_u32 {
                let bits = [k * 65_537, u32::MAX - k * 65_537];
                let sample = environment.sample(bits).unwrap();
                assert!(sample.radiance.x > 0.0 && sample.pdf > 0.0);
            }
            assert!(environment.radiance_and_pdf(map.direction(3, 9).as_vec3()).1 > 0.0);
        }
    }

    #[test]
    fn black_maps_give_no_sample_and_even_ones_no_compensation() {
        let black = environment(&test_maps::constant(8, 4, [0.0; 3]), 0.0, Density::Full);
        assert_eq!(black.sample([1 << 31; 2]), None);
        assert_eq!(black.radiance(Vec3::Y), Vec3::ZERO);
        let even = environment(&test_maps::constant(8, 4, [2.0; 3]), 0.0, Density::Compensated { draws: 1 });
        assert_eq!(even.density(), Density::Full);
        assert!((even.mean_luminance() - 2.0).abs() < 1e-12);
    }

    #[test]
    fn the_first_pixel_that_is_not_finite_is_named_and_negatives_are_counted() {
        let mut map = test_maps::constant(8, 4, [1.0; 3]);
        map.raster.set_pixel(2, 1, [-1.0, 2.0, 0.0]);
        let (found, negative_count) = made(&map, 3.0, 0.0, Density::Full);
        assert_eq!((negative_count, found.radiance(map.direction(2, 1).as_vec3())), (1, Vec3::new(0.0, 6.0, 0.0)));
        map.raster.set_pixel(3, 2, [1.0, f32::NAN, 0.0]);
        let error = Environment::new(&map, &EnvironmentParameters::default(), Density::Full, || Ok::<(), Infallible>(())).unwrap_err();
        assert!(error.to_string().contains("(3, 2)"), "{error}");
    }
}

//! The probability of each pixel of a map, and its inversion: row first, then column.
//!
//! A pixel's weight is its intensity times a factor of its row (by default the sine of the polar angle,
//! to which its solid angle is proportional). Rows have a marginal distribution, the pixels of a row a
//! conditional one; both are inverted in the half-open form C(k-1) <= u < C(k), so that what weighs
//! nothing is never drawn. Knows nothing of random numbers; see `sampling`.
//!
//! Four bytes a pixel: intensities stay f32, and f64 prefix sums stand only before every 16th of them. A
//! table of guides (Chen and Asau, "On generating random variates from an empirical distribution", 1974)
//! leads to the right 16, which are then added up as they were when the table was built. So the
//! probability that is reported is the one that is realized, to the rounding of f64, however
//! large the range of the map.
//!
//! After Pharr, Jakob, Humphreys, "Physically Based Rendering", 3rd edition, sections 13.6.7 and 14.2.4.

use std::f64::consts::PI;

use glam::DVec3;
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::light::envmap::{self, Angles, EnvMap};
use crate::math::elementary;

/// Factor by which a pixel's intensity is multiplied, by its row.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Sine {
    /// Sine at the center of the row, (j + 1/2) pi / H: proportional to the exact solid angle.
    #[default]
    Center,
    /// The exact solid angle of the pixel; the same probabilities as `center`, weights in radiance times steradians.
    Exact,
    /// Sine at the upper edge of the row, j pi / H, as in the first report: the top row is never drawn.
    Edge,
    /// Sine at j pi / (H - 1), as in the second report: the top and the bottom row are never drawn.
    EdgeInclusive,
    /// One: too many directions near the poles.
    None,
}

impl Sine {
    /// The factor of row `y` of `height` rows of `width` pixels.
    fn of_row(self, y: usize, width: usize, height: usize) -> f64 {
        let sine_at = |angles| elementary::sin(envmap::theta_of_row(y, height, angles));
        match self {
            Sine::Center => sine_at(Angles::Center),
            Sine::Exact => envmap::solid_angle_of_pixel(y, width, height),
            Sine::Edge => sine_at(Angles::Edge),
            // The sine of the rounded pi is not zero, and the last row would stay reachable.
            Sine::EdgeInclusive if y + 1 == height => 0.0,
            Sine::EdgeInclusive => sine_at(Angles::EdgeInclusive),
            Sine::None => 1.0,
        }
    }
}

/// What of a pixel's color its probability follows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Intensity {
    /// (R + G + B) / 3, as in the reports.
    Mean,
    /// Luminance .2126 R + .7152 G + .0722 B of the Rec. 709 primaries.
    #[default]
    Rec709,
    /// The largest channel: bounds the error of each channel.
    Max,
}

/// How weights come from colors.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Settings {
    /// Factor of a row.
    pub sine: Sine,
    /// What of the color counts.
    pub intensity: Intensity,
    /// Each channel is at most this before the intensity is taken; above 0.
    pub clamp: Option<f32>,
    /// Whether the sphere's uniform density is taken off the density, and what is left drawn from (Karlík et al. 2019).
    pub is_compensated: bool,
    /// Share, 0 to 1, of the sphere's uniform density in a mixture with the rest; taken after the compensation.
    pub defensive: f64,
}

/// Why a map has no distribution.
#[derive(Debug, thiserror::Error)]
pub enum DistributionError<E> {
    /// A pixel that is infinite or not a number.
    #[error("pixel ({x}, {y}) of the map is not finite: `{}, {}, {}`", value[0], value[1], value[2])]
    NotFinite {
        /// Column.
        x: usize,
        /// Row, from the top.
        y: usize,
        /// The color found.
        value: [f32; 3],
    },
    /// A map of no pixels, or of more than 2^32 in a row or a column.
    #[error("a map of {width} x {height} pixels has no distribution")]
    Size {
        /// Width of the map.
        width: usize,
        /// Height of the map.
        height: usize,
    },
    /// The caller's check said to stop.
    #[error("interrupted")]
    Interrupted(E),
}

/// A pixel that was drawn.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Pixel {
    /// Column.
    pub x: u32,
    /// Row, from the top.
    pub y: u32,
    /// Its probability.
    pub pmf: f64,
}

/// A pixel that was drawn, and a place in it.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Placed {
    /// The pixel.
    pub pixel: Pixel,
    /// Where in the pixel, on [0, 1)²: from its left and from its upper edge.
    pub inside: [f64; 2],
}

/// Pixels of one block: as many as fill a cache line.
const BLOCK: usize = 16;

/// Density of a direction uniform on the sphere, per steradian.
const UNIFORM_DENSITY: f64 = 1.0 / (4.0 * PI);

/// A density that falls no further than by this share below the uniform one is not worth compensating.
const EVENNESS: f64 = 0.01;

/// Pixels of one parallel piece of work, at least one row.
const BAND: usize = 1 << 16;

/// The distribution of a map's pixels. Sums to one, whatever the map.
#[derive(Debug, Clone, PartialEq)]
pub struct Distribution {
    width: usize,
    height: usize,
    angles: Angles,
    /// Intensity of each pixel, row by row, at least 0.
    intensities: Vec<f32>,
    /// Of each row: the factor of its intensities.
    factors: Vec<f64>,
    /// Of each row: the sum of its intensities.
    row_sums: Vec<f64>,
    /// Sum of the weights of all rows up to and with this one.
    cumulative: Vec<f64>,
    /// Of each row: probability per unit of intensity, factor / total.
    scales: Vec<f64>,
    /// Of each row: solid angle of a pixel in steradians.
    solid_angles: Vec<f64>,
    /// The row that contains g / row_guides.len() of the total; a power of two of them.
    row_guides: Vec<u32>,
    /// Of each block of each row: sum of the intensities before it in its row.
    block_sums: Vec<f64>,
    /// `guide_count` for each row: the block that contains g / guide_count of the row's sum.
    block_guides: Vec<u32>,
    last_row: usize,
    negative_count: u64,
    is_uniform: bool,
    is_compensated: bool,
}

/// What a distribution is made of: the part of it that is stored.
#[derive(Debug, Clone, PartialEq)]
pub struct Parts {
    /// Pixels in a row, at least 1.
    pub width: usize,
    /// Rows, at least 1.
    pub height: usize,
    /// Which direction a pixel stands for.
    pub angles: Angles,
    /// Factor of each row, finite and at least 0.
    pub factors: Vec<f64>,
    /// Intensity of each pixel, finite and at least 0; not all weights may be 0.
    pub intensities: Vec<f32>,
    /// Pixels of the map with a negative channel.
    pub negative_count: u64,
    /// Whether the map gave no weight at all, and the sphere's uniform distribution stands for it.
    pub is_uniform: bool,
    /// Whether the density was compensated, so that lit pixels may be out of reach.
    pub is_compensated: bool,
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct RowFacts {
    sum: f64,
    negative_count: u64,
    is_finite: bool,
}

impl Distribution {
    /// The distribution of the pixels of `map`.
    ///
    /// Negative channels count as 0, and are counted. Where no pixel has any weight, the distribution is uniform
    /// over solid angle and says so in [`Self::is_uniform`]. `check` is asked every few milliseconds.
    pub fn build<E: Send>(
        map: &EnvMap,
        settings: &Settings,
        check: impl Fn() -> Result<(), E> + Sync,
    ) -> Result<Self, DistributionError<E>> {
        let (width, height) = (map.width(), map.height());
        let is_countable = |size: usize| size > 0 && u32::try_from(size).is_ok();
        if !is_countable(width) || !is_countable(height) {
            return Err(DistributionError::Size { width, height });
        }
        let factors = (0..height).map(|y| settings.sine.of_row(y, width, height)).collect();
        let mut table = Self::unfilled(Parts {
            width,
            height,
            angles: map.angles,
            factors,
            intensities: vec![0.0; width * height],
            negative_count: 0,
            is_uniform: false,
            is_compensated: false,
        });
        let facts = table.fill(|y, row| fill_row(map.raster.row(y), settings, row), &check).map_err(DistributionError::Interrupted)?;
        if let Some(y) = facts.iter().position(|row| !row.is_finite) {
            return Err(not_finite(map, y));
        }
        table.negative_count = facts.iter().map(|row| row.negative_count).sum();
        if !table.accumulate() {
            table.make_uniform(&check).map_err(DistributionError::Interrupted)?;
        }
        if settings.is_compensated {
            table.compensate(&check).map_err(DistributionError::Interrupted)?;
        }
        if settings.defensive > 0.0 {
            table.mix_with_uniform(settings.defensive.min(1.0), &check).map_err(DistributionError::Interrupted)?;
        }
        Ok(table)
    }

    /// The distribution again from its parts; `None` if they contradict what is said of them there.
    pub fn from_parts(parts: Parts) -> Option<Self> {
        let is_measure = |value: f64| value >= 0.0 && value.is_finite();
        let has_size = parts.width > 0 && parts.height > 0 && u32::try_from(parts.width.max(parts.height)).is_ok();
        let has_all = parts.width.checked_mul(parts.height) == Some(parts.intensities.len()) && parts.factors.len() == parts.height;
        if !has_size || !has_all || !parts.factors.iter().copied().all(is_measure) {
            return None;
        }
        let mut table = Self::unfilled(parts);
        let facts = table.fill(kept_row, || Ok::<(), std::convert::Infallible>(())).ok()?;
        (facts.iter().all(|row| row.is_finite) && table.accumulate()).then_some(table)
    }

    /// A table with its parts in place and its sums still zero.
    fn unfilled(parts: Parts) -> Self {
        let Parts { width, height, angles, factors, intensities, negative_count, is_uniform, is_compensated } = parts;
        let block_count = width.div_ceil(BLOCK);
        Self {
            width,
            height,
            angles,
            intensities,
            factors,
            row_sums: vec![0.0; height],
            cumulative: vec![0.0; height],
            scales: vec![0.0; height],
            solid_angles: (0..height).map(|y| envmap::solid_angle_of_pixel(y, width, height)).collect(),
            row_guides: vec![0; height.next_power_of_two()],
            block_sums: vec![0.0; height * block_count],
            block_guides: vec![0; height * block_count.next_power_of_two()],
            last_row: 0,
            negative_count,
            is_uniform,
            is_compensated,
        }
    }

    /// Fills the intensities of each row and sums them, in parallel; each row is one worker's.
    fn fill<E: Send>(
        &mut self,
        fill_row: impl Fn(usize, &mut [f32]) -> RowFacts + Sync,
        check: impl Fn() -> Result<(), E> + Sync,
    ) -> Result<Vec<RowFacts>, E> {
        let (width, block_count) = (self.width, self.block_count());
        let guide_count = block_count.next_power_of_two();
        let rows = (BAND / width).max(1);
        let mut facts = vec![RowFacts { sum: 0.0, negative_count: 0, is_finite: true }; self.height];
        let bands = facts
            .par_chunks_mut(rows)
            .zip(self.intensities.par_chunks_mut(rows * width))
            .zip(self.block_sums.par_chunks_mut(rows * block_count))
            .zip(self.block_guides.par_chunks_mut(rows * guide_count));
        bands.enumerate().try_for_each(|(band, (((facts, intensities), sums), guides))| {
            check()?;
            let each = facts.iter_mut().zip(intensities.chunks_mut(width));
            let each = each.zip(sums.chunks_mut(block_count)).zip(guides.chunks_mut(guide_count));
            for (k, (((facts, intensities), sums), guides)) in each.enumerate() {
                *facts = fill_row(band * rows + k, intensities);
                facts.sum = sum_blocks(intensities, sums);
                fill_guides(guides, facts.sum, |block| sums.get(block + 1).copied());
            }
            Ok(())
        })?;
        self.row_sums = facts.iter().map(|row| row.sum).collect();
        Ok(facts)
    }

    /// Sums the rows; says whether there is any weight.
    fn accumulate(&mut self) -> bool {
        let mut total = 0.0;
        for y in 0..self.height {
            let weight = self.row_weight(y);
            total += weight;
            self.cumulative[y] = total;
            if weight > 0.0 {
                self.last_row = y;
            }
        }
        let cumulative = &self.cumulative;
        fill_guides(&mut self.row_guides, total, |y| (y + 1 < cumulative.len()).then(|| cumulative[y]));
        self.scales = self.factors.iter().map(|factor| factor / total).collect();
        total > 0.0 && self.scales.iter().all(|scale| scale.is_finite())
    }

    fn make_uniform<E: Send>(&mut self, check: impl Fn() -> Result<(), E> + Sync) -> Result<(), E> {
        self.factors = (0..self.height).map(|y| Sine::Center.of_row(y, self.width, self.height)).collect();
        self.intensities.fill(1.0);
        self.is_uniform = true;
        self.fill(kept_row, check)?;
        assert!(self.accumulate(), "each row's center has a positive sine");
        Ok(())
    }

    /// Takes the sphere's uniform density off, and leaves what is above it; a nearly even density stays.
    ///
    /// In a combination with another technique the dim part of the sphere is that one's, and the samples saved go
    /// where it is bright. What is left is zero over part of the sphere, so alone it would be biased.
    ///
    /// Karlík, Šik, Vévoda, Skřivan, Křivánek, "MIS compensation", ACM TOG 38(6), 2019, equation 14 for a
    /// technique of uniform density.
    fn compensate<E: Send>(&mut self, check: impl Fn() -> Result<(), E> + Sync) -> Result<(), E> {
        let least = (0..self.height).map(|y| self.least_density(y)).fold(f64::INFINITY, f64::min);
        if UNIFORM_DENSITY - least <= EVENNESS * UNIFORM_DENSITY {
            return Ok(());
        }
        self.is_compensated = true;
        self.reweigh(|density| (density - UNIFORM_DENSITY).max(0.0), check)
    }

    /// Puts (1 - share) of the density and `share` of the sphere's uniform one in its place.
    fn mix_with_uniform<E: Send>(&mut self, share: f64, check: impl Fn() -> Result<(), E> + Sync) -> Result<(), E> {
        self.reweigh(|density| (1.0 - share) * density + share * UNIFORM_DENSITY, check)?;
        // Nothing is out of reach any more.
        self.is_compensated = false;
        Ok(())
    }

    /// Makes the weights `changed(density per steradian)` times solid angle; not all of them may become 0.
    fn reweigh<E: Send>(&mut self, changed: impl Fn(f64) -> f64 + Sync, check: impl Fn() -> Result<(), E> + Sync) -> Result<(), E> {
        // A density of the row, per unit of intensity; the table's own numbers are being written over.
        let densities: Vec<f64> = self.scales.iter().zip(&self.solid_angles).map(|(scale, solid_angle)| scale / solid_angle).collect();
        self.factors.clone_from(&self.solid_angles);
        let of_row = |y: usize, row: &mut [f32]| {
            row.iter_mut().for_each(|value| *value = changed(f64::from(*value) * densities[y]) as f32);
            RowFacts { sum: 0.0, negative_count: 0, is_finite: true }
        };
        self.fill(of_row, check)?;
        assert!(self.accumulate(), "a density that is not even lies somewhere above its mean");
        Ok(())
    }

    /// The least density per steradian in row `y`.
    fn least_density(&self, y: usize) -> f64 {
        let least = self.row(y).iter().fold(f32::INFINITY, |least, &intensity| least.min(intensity));
        f64::from(least) * self.scales[y] / self.solid_angles[y]
    }

    /// Pixels in a row.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// Which direction a pixel stands for.
    pub fn angles(&self) -> Angles {
        self.angles
    }

    /// Sum of all weights: intensity times the factor of its row.
    #[inline]
    pub fn total(&self) -> f64 {
        self.cumulative[self.height - 1]
    }

    /// Pixels of the map that had a negative channel; it counted as 0.
    pub fn negative_count(&self) -> u64 {
        self.negative_count
    }

    /// Whether the map gave no weight at all, so that this is the sphere's uniform distribution.
    pub fn is_uniform(&self) -> bool {
        self.is_uniform
    }

    /// Whether the density was compensated and pixels that shine may be out of reach: for use beside another technique alone.
    pub fn is_compensated(&self) -> bool {
        self.is_compensated
    }

    /// Intensity of each pixel, row by row from the top; its density per steradian where compensation or a mixture changed it.
    pub fn intensities(&self) -> &[f32] {
        &self.intensities
    }

    /// Factor of each row.
    pub fn factors(&self) -> &[f64] {
        &self.factors
    }

    /// Polar angle that row `y` stands for, in radians.
    pub fn theta(&self, y: usize) -> f64 {
        envmap::theta_of_row(y, self.height, self.angles)
    }

    /// Azimuth that column `x` stands for, in radians.
    pub fn phi(&self, x: usize) -> f64 {
        envmap::phi_of_column(x, self.width, self.angles)
    }

    /// Solid angle of a pixel of row `y` in steradians.
    pub fn solid_angle(&self, y: usize) -> f64 {
        self.solid_angles[y]
    }

    /// Sum of the weights of row `y`.
    #[inline]
    pub fn row_weight(&self, y: usize) -> f64 {
        self.factors[y] * self.row_sums[y]
    }

    /// Sum of the intensities of row `y`, without its factor.
    pub fn row_sum(&self, y: usize) -> f64 {
        self.row_sums[y]
    }

    /// Probability of row `y`.
    pub fn marginal_pmf(&self, y: usize) -> f64 {
        self.row_weight(y) / self.total()
    }

    /// Probability of the rows from the top down to and with `y`; 1 at the last.
    pub fn marginal_cdf(&self, y: usize) -> f64 {
        self.cumulative[y] / self.total()
    }

    /// Probability of each pixel of row `y`, given the row; all 0 in a row that is never drawn.
    pub fn conditional_pmf(&self, y: usize) -> impl Iterator<Item = f64> + '_ {
        let sum = if self.row_weight(y) > 0.0 { self.row_sums[y] } else { f64::INFINITY };
        self.row(y).iter().map(move |&intensity| f64::from(intensity) / sum)
    }

    /// Probability of the pixels of row `y` from the left up to and with each, given the row; 1 at the last.
    ///
    /// All 0 in a row that is never drawn.
    pub fn conditional_cdf(&self, y: usize) -> impl Iterator<Item = f64> + '_ {
        let sum = if self.row_weight(y) > 0.0 { self.row_sums[y] } else { f64::INFINITY };
        let block_count = self.block_count();
        let before = &self.block_sums[y * block_count..(y + 1) * block_count];
        self.row(y).chunks(BLOCK).zip(before).flat_map(move |(block, before)| {
            let running = block.iter().scan(0.0, |total, &intensity| {
                *total += f64::from(intensity);
                Some(*total)
            });
            running.map(move |within| (before + within) / sum)
        })
    }

    /// Probability of the pixel in column `x` of row `y`.
    #[inline]
    pub fn pmf(&self, x: usize, y: usize) -> f64 {
        self.pmf_of_intensity(self.intensities[y * self.width + x], y)
    }

    /// Probability of a pixel of row `y` that has that intensity.
    #[inline]
    pub(in crate::light) fn pmf_of_intensity(&self, intensity: f32, y: usize) -> f64 {
        f64::from(intensity) * self.scales[y]
    }

    /// Density of the pixel in column `x` of row `y` per steradian: its probability over its solid angle.
    pub fn pdf_of_pixel(&self, x: usize, y: usize) -> f64 {
        self.pmf(x, y) / self.solid_angles[y]
    }

    /// Weight of the pixel in column `x` of row `y`: its probability times [`Self::total`].
    #[inline]
    pub fn weight(&self, x: usize, y: usize) -> f64 {
        f64::from(self.intensities[y * self.width + x]) * self.factors[y]
    }

    /// Density per steradian at a unit direction: that of the pixel that stands for it.
    pub fn pdf(&self, direction: DVec3) -> f64 {
        let (x, y) = self.pixel_at(direction);
        self.pdf_of_pixel(x, y)
    }

    /// Column and row of the pixel that stands for a unit direction.
    ///
    /// The pixel that contains it where pixels stand for their centers; else the one whose direction is
    /// nearest in both angles, so that a drawn direction finds its own pixel again.
    pub fn pixel_at(&self, direction: DVec3) -> (usize, usize) {
        if self.angles == Angles::Center {
            return envmap::pixel_containing(direction, self.width, self.height);
        }
        let [u, v] = envmap::square_at(direction);
        let steps = if self.angles == Angles::EdgeInclusive { self.height - 1 } else { self.height };
        let column = (u * self.width as f64).round() as usize % self.width;
        let row = ((v * steps as f64).round() as usize).min(self.height - 1);
        (column, row)
    }

    /// The point of the unit square (phi / 2 pi, theta / pi) that pixel (x, y) stands for.
    pub fn position(&self, x: usize, y: usize) -> [f64; 2] {
        [self.phi(x) / (2.0 * PI), self.theta(y) / PI]
    }

    /// Draws a pixel: `u[1]` in [0, 1) chooses the row, `u[0]` in [0, 1) the column in it.
    pub fn sample(&self, u: [f64; 2]) -> Pixel {
        self.sample_all(&[u])[0]
    }

    /// Draws one pixel for each point, as [`Self::sample`] does.
    ///
    /// Step by step for all points together. The table is larger than a cache, and nearly every step reads a place
    /// of its own: without a branch between the reads, those of all points are on their way at once.
    pub fn sample_all<const N: usize>(&self, points: &[[f64; 2]; N]) -> [Pixel; N] {
        let rows: [usize; N] = std::array::from_fn(|k| self.row_at(points[k][1]));
        let guides: [usize; N] = std::array::from_fn(|k| self.guided_block(rows[k], points[k][0]));
        let sums: [f64; N] = std::array::from_fn(|k| self.sum_after(rows[k], guides[k]));
        let blocks: [usize; N] = std::array::from_fn(|k| self.block_from(rows[k], guides[k], sums[k], points[k][0]));
        let intensities: [[f32; BLOCK]; N] = std::array::from_fn(|k| self.block(rows[k], blocks[k]));
        std::array::from_fn(|k| {
            let (y, u) = (rows[k], points[k][0]);
            let place = first_beyond(&intensities[k], self.rest_in_block(y, blocks[k], u));
            match intensities[k].get(place) {
                Some(&intensity) => self.pixel(blocks[k] * BLOCK + place, y, intensity),
                None => self.last_pixel_up_to(y, blocks[k]),
            }
        })
    }

    /// Draws one pixel for each point, and says where in the pixel's share of the square the point lies, on [0, 1)².
    ///
    /// As [`Self::sample_all`] otherwise. The places are uniform if the points are, and keep their order.
    pub fn place_all<const N: usize>(&self, points: &[[f64; 2]; N]) -> [Placed; N] {
        let pixels = self.sample_all(points);
        std::array::from_fn(|k| {
            let (pixel, [u, v]) = (pixels[k], points[k]);
            let (x, y) = (pixel.x as usize, pixel.y as usize);
            let above = if y == 0 { 0.0 } else { self.cumulative[y - 1] };
            let down = (v * self.total() - above) / self.row_weight(y);
            let across = (u * self.row_sums[y] - self.sum_before(x, y)) / f64::from(self.intensities[y * self.width + x]);
            Placed { pixel, inside: [across, down].map(into_unit) }
        })
    }

    /// Sum of the intensities of row `y` left of column `x`, added as the search adds them.
    #[inline]
    fn sum_before(&self, x: usize, y: usize) -> f64 {
        let block = x / BLOCK;
        let within = &self.row(y)[block * BLOCK..x];
        self.block_sums[y * self.block_count() + block] + within.iter().fold(0.0, |sum, &intensity| sum + f64::from(intensity))
    }

    /// Cumulative probability of row `y`'s pixels left of column `x`, given the row; 1 at the width.
    pub(in crate::light) fn conditional_before(&self, x: usize, y: usize) -> f64 {
        if x == self.width { 1.0 } else { self.sum_before(x, y) / self.row_sums[y] }
    }

    /// The row j with C(j-1) <= u < C(j) for u in [0, 1); the last reachable one for any u beyond.
    #[inline]
    pub fn row_at(&self, u: f64) -> usize {
        let target = u * self.total();
        let mut y = self.row_guides[guide_index(u, self.row_guides.len())] as usize;
        while y < self.last_row && self.cumulative[y] <= target {
            y += 1;
        }
        // u just below 1 may round to the total, and rows after the last reachable one weigh nothing.
        y.min(self.last_row)
    }

    /// The column of row `y` that u in [0, 1) chooses; the last reachable one for any u beyond.
    ///
    /// Means nothing in a row of weight 0.
    pub fn column_at(&self, y: usize, u: f64) -> usize {
        let guide = self.guided_block(y, u);
        let block = self.block_from(y, guide, self.sum_after(y, guide), u);
        let place = first_beyond(&self.block(y, block), self.rest_in_block(y, block, u));
        if place < BLOCK { block * BLOCK + place } else { self.last_pixel_up_to(y, block).x as usize }
    }

    #[inline]
    fn block_count(&self) -> usize {
        self.width.div_ceil(BLOCK)
    }

    /// The block from which the search for `u` in row `y` starts; never beyond the one it ends at.
    #[inline]
    fn guided_block(&self, y: usize, u: f64) -> usize {
        let guide_count = self.block_count().next_power_of_two();
        self.block_guides[y * guide_count + guide_index(u, guide_count)] as usize
    }

    /// Sum of the intensities of row `y` up to and with that block; infinite at the last, where the search ends.
    #[inline]
    fn sum_after(&self, y: usize, block: usize) -> f64 {
        if block + 1 < self.block_count() { self.block_sums[y * self.block_count() + block + 1] } else { f64::INFINITY }
    }

    /// The block that `u` chooses, at or after `block`, with `sum` after which `sum_after` gives.
    #[inline]
    fn block_from(&self, y: usize, mut block: usize, sum: f64, u: f64) -> usize {
        let target = u * self.row_sums[y];
        if sum > target {
            return block;
        }
        block += 1;
        while self.sum_after(y, block) <= target {
            block += 1;
        }
        block
    }

    /// What is left of u times the sum of row `y` before that block.
    #[inline]
    fn rest_in_block(&self, y: usize, block: usize, u: f64) -> f64 {
        u * self.row_sums[y] - self.block_sums[y * self.block_count() + block]
    }

    /// The intensities of a block; those beyond the end of the row are 0, and nothing is drawn there.
    #[inline]
    fn block(&self, y: usize, block: usize) -> [f32; BLOCK] {
        let row = self.row(y);
        let rest = &row[block * BLOCK..];
        rest.first_chunk().copied().unwrap_or_else(|| std::array::from_fn(|k| rest.get(k).copied().unwrap_or(0.0)))
    }

    #[inline]
    fn pixel(&self, x: usize, y: usize, intensity: f32) -> Pixel {
        Pixel { x: x as u32, y: y as u32, pmf: self.pmf_of_intensity(intensity, y) }
    }

    /// The last reachable pixel up to the end of that block: where rounding has left a target at the very end.
    fn last_pixel_up_to(&self, y: usize, block: usize) -> Pixel {
        let row = self.row(y);
        let end = ((block + 1) * BLOCK).min(self.width);
        let x = row[..end].iter().rposition(|&intensity| intensity > 0.0).unwrap_or(0);
        self.pixel(x, y, row[x])
    }

    #[inline]
    fn row(&self, y: usize) -> &[f32] {
        &self.intensities[y * self.width..(y + 1) * self.width]
    }

    /// Bytes it holds in memory.
    pub fn memory(&self) -> u64 {
        let of_rows = self.height * (6 * size_of::<f64>()) + self.row_guides.len() * size_of::<u32>();
        let of_blocks = self.block_sums.len() * size_of::<f64>() + self.block_guides.len() * size_of::<u32>();
        (self.intensities.len() * size_of::<f32>() + of_blocks + of_rows) as u64
    }
}

/// Bytes that the distribution of a map of that many pixels takes at most, but for its rows.
pub fn memory_of(pixel_count: u64) -> u64 {
    // 4 for the intensity, 8 / 16 for the sums of blocks, up to 2 x 4 / 16 for their guides.
    pixel_count * 5
}

/// Intensities of one row of colors.
fn fill_row(colors: &[[f32; 3]], settings: &Settings, row: &mut [f32]) -> RowFacts {
    match settings.intensity {
        Intensity::Mean => fill_row_by(colors, settings.clamp, row, |[r, g, b]| (r + g + b) * (1.0 / 3.0)),
        Intensity::Rec709 => fill_row_by(colors, settings.clamp, row, |[r, g, b]| 0.2126 * r + 0.7152 * g + 0.0722 * b),
        Intensity::Max => fill_row_by(colors, settings.clamp, row, |[r, g, b]| r.max(g).max(b)),
    }
}

fn fill_row_by(colors: &[[f32; 3]], clamp: Option<f32>, row: &mut [f32], intensity: impl Fn([f64; 3]) -> f64) -> RowFacts {
    let channels = colors.as_flattened();
    let is_finite = channels.iter().fold(true, |all, channel| all & channel.is_finite());
    let has_negative = channels.iter().fold(false, |any, &channel| any | (channel < 0.0));
    // In f64, where the sum of three large channels is still finite; rounded once. Adding 0 turns -0 into 0.
    let rounded = |color: [f32; 3]| (intensity(color.map(f64::from)) + 0.0) as f32;
    let limit = clamp.unwrap_or(f32::INFINITY);
    let kept = |channel: f32| if channel > 0.0 { channel.min(limit) } else { 0.0 };
    if has_negative || clamp.is_some() {
        row.iter_mut().zip(colors).for_each(|(out, color)| *out = rounded(color.map(kept)));
    } else {
        row.iter_mut().zip(colors).for_each(|(out, color)| *out = rounded(*color));
    }
    let is_negative = |color: &&[f32; 3]| color.iter().any(|&channel| channel < 0.0);
    let negative_count = if has_negative { colors.iter().filter(is_negative).count() as u64 } else { 0 };
    RowFacts { sum: 0.0, negative_count, is_finite }
}

/// Facts of intensities that stay as they are.
fn kept_row(_: usize, row: &mut [f32]) -> RowFacts {
    let is_measure = row.iter().all(|&intensity| intensity >= 0.0 && intensity.is_finite());
    RowFacts { sum: 0.0, negative_count: 0, is_finite: is_measure }
}

/// Puts the sum before each block into `before`; gives the sum of all.
fn sum_blocks(intensities: &[f32], before: &mut [f64]) -> f64 {
    let mut total = 0.0;
    for (block, before) in intensities.chunks(BLOCK).zip(before) {
        *before = total;
        total += block.iter().fold(0.0, |sum, &intensity| sum + f64::from(intensity));
    }
    total
}

/// For each g: the first bucket whose cumulative sum lies above g / guides.len() of the total.
///
/// `cumulative` gives the sum up to and with a bucket, `None` for the last. With a power of two of guides,
/// g / guides.len() and its product with u are exact, and no guide leads beyond its target.
fn fill_guides(guides: &mut [u32], total: f64, cumulative: impl Fn(usize) -> Option<f64>) {
    let step = 1.0 / guides.len() as f64;
    let mut bucket = 0;
    for (g, guide) in guides.iter_mut().enumerate() {
        let target = g as f64 * step * total;
        while cumulative(bucket).is_some_and(|sum| sum <= target) {
            bucket += 1;
        }
        *guide = bucket as u32;
    }
}

/// What rounding has put at or beyond the ends of [0, 1) back into it.
#[inline]
fn into_unit(place: f64) -> f64 {
    const BELOW_ONE: f64 = 1.0 - f64::EPSILON / 2.0;
    place.clamp(0.0, BELOW_ONE)
}

#[inline]
fn guide_index(u: f64, guide_count: usize) -> usize {
    ((u * guide_count as f64) as usize).min(guide_count - 1)
}

/// Position of the first intensity at which the running sum exceeds `rest`; `BLOCK` if none does.
///
/// Counts instead of leaving the loop: where it ends cannot be predicted, and a wrong guess costs more.
#[inline]
fn first_beyond(block: &[f32; BLOCK], rest: f64) -> usize {
    let mut sum = 0.0;
    let mut count = 0;
    for &intensity in block {
        sum += f64::from(intensity);
        count += usize::from(sum <= rest);
    }
    count
}

/// The first pixel of row `y` that is not finite.
fn not_finite<E>(map: &EnvMap, y: usize) -> DistributionError<E> {
    let is_wrong = |color: &[f32; 3]| color.iter().any(|channel| !channel.is_finite());
    let x = map.raster.row(y).iter().position(is_wrong).expect("the row has such a pixel");
    DistributionError::NotFinite { x, y, value: map.raster.pixel(x, y) }
}

#[cfg(test)]
mod tests {
    use std::convert::Infallible;

    use super::*;
    use crate::image::raster::Raster;
    use crate::math::stream::{Purpose, Stream};

    fn build(map: &EnvMap, settings: Settings) -> Distribution {
        Distribution::build(map, &settings, || Ok::<(), Infallible>(())).unwrap()
    }

    fn map_of(width: usize, height: usize, color: impl Fn(usize, usize) -> [f32; 3]) -> EnvMap {
        let pixels = (0..width * height).map(|k| color(k % width, k / width)).collect();
        EnvMap::new(Raster::new(width, height, pixels))
    }

    /// A map of random colors over six decades, with black pixels and a black row.
    fn rough_map(width: usize, height: usize) -> EnvMap {
        let stream = Stream::new(3, Purpose::Test);
        map_of(width, height, |x, y| {
            let mut numbers = stream.generator((y * width + x) as u64);
            let [size, hue] = numbers.uniform_pair();
            if size < 0.2 || y == 2 {
                return [0.0; 3];
            }
            let value = elementary::pow(10.0, 6.0 * size - 3.0) as f32;
            [value, value * hue as f32, value * (1.0 - hue as f32)]
        })
    }

    const JUST_BELOW_ONE: f64 = 1.0 - f64::EPSILON / 2.0;

    /// Weights as section 3 of the specification writes them: one after the other, in f64, nothing shared with the table.
    fn weights_by_definition(map: &EnvMap) -> Vec<f64> {
        let (width, height) = (map.width(), map.height());
        let weight = |k: usize| {
            let [r, g, b] = map.raster.pixels()[k].map(f64::from);
            let theta = ((k / width) as f64 + 0.5) * PI / height as f64;
            (0.2126 * r + 0.7152 * g + 0.0722 * b) * elementary::sin(theta)
        };
        (0..width * height).map(weight).collect()
    }

    #[test]
    fn probabilities_are_weights_over_their_sum() {
        for (width, height) in [(64, 32), (37, 9), (1, 5), (16, 3), (1000, 4)] {
            let map = rough_map(width, height);
            let table = build(&map, Settings::default());
            let weights = weights_by_definition(&map);
            let total: f64 = weights.iter().sum();
            assert!((table.total() / total - 1.0).abs() < 1e-6);
            let mut sum = 0.0;
            for (k, weight) in weights.iter().enumerate() {
                let (x, y) = (k % width, k / width);
                // One rounding to f32.
                assert!((table.pmf(x, y) - weight / total).abs() <= 2.0 * f64::from(f32::EPSILON) * weight / total);
                let parts = table.marginal_pmf(y) * table.conditional_pmf(y).nth(x).unwrap();
                assert!((parts - table.pmf(x, y)).abs() <= 1e-14 * parts);
                sum += table.pmf(x, y);
            }
            assert!((sum - 1.0).abs() < 1e-12, "{sum}");
        }
    }

    #[test]
    fn densities_integrate_to_one_over_the_sphere() {
        let table = build(&rough_map(64, 32), Settings::default());
        let integral: f64 = (0..32).map(|y| (0..64).map(|x| table.pdf_of_pixel(x, y)).sum::<f64>() * table.solid_angle(y)).sum();
        assert!((integral - 1.0).abs() < 1e-12, "{integral}");
    }

    /// The realized probability of a pixel is the length of the interval of u that leads to it: found by bisection.
    #[test]
    fn the_table_realizes_what_it_reports() {
        let table = build(&rough_map(37, 9), Settings::default());
        let first = |is_beyond: &dyn Fn(f64) -> bool| {
            let (mut low, mut high) = (0.0_f64, 1.0_f64);
            for _ in 0..80 {
                let middle = (low + high) / 2.0;
                if is_beyond(middle) { high = middle } else { low = middle }
            }
            high
        };
        for y in 0..9 {
            let row = first(&|u| table.row_at(u) > y) - first(&|u| table.row_at(u) >= y);
            // Bisection and the sums before it leave some units of the last place of one.
            assert!((row - table.marginal_pmf(y)).abs() < 1e-14, "row {y}: {row}");
            if row == 0.0 {
                continue;
            }
            for (x, expected) in table.conditional_pmf(y).enumerate() {
                let realized = first(&|u| table.column_at(y, u) > x) - first(&|u| table.column_at(y, u) >= x);
                assert!((realized - expected).abs() < 1e-14, "({x}, {y}): {realized} {expected}");
            }
        }
    }

    #[test]
    fn drawing_agrees_with_a_search_of_the_plain_cdf() {
        for (width, height) in [(64, 32), (37, 9), (1000, 4), (1, 1)] {
            let table = build(&rough_map(width, height), Settings::default());
            let stream = Stream::new(11, Purpose::Test);
            for k in 0..5_000 {
                let u = stream.generator(k).uniform_pair();
                let pixel = table.sample(u);
                let y = (0..height).position(|y| table.marginal_cdf(y) > u[1]).unwrap();
                let x = table.conditional_cdf(y).position(|cdf| cdf > u[0]).unwrap();
                assert_eq!((pixel.x as usize, pixel.y as usize), (x, y));
                assert_eq!(pixel.pmf, table.pmf(x, y));
            }
        }
    }

    #[test]
    fn what_weighs_nothing_is_never_drawn() {
        // One lit pixel among black ones, at every place of rows of several blocks; both ends of the unit interval.
        for width in [1, 15, 16, 17, 48] {
            for x in 0..width {
                for y in 0..3 {
                    let map = map_of(width, 3, |i, j| if (i, j) == (x, y) { [1e-20; 3] } else { [0.0; 3] });
                    let table = build(&map, Settings::default());
                    for u in [0.0, 0.1, 0.5, 0.9, JUST_BELOW_ONE] {
                        for v in [0.0, 0.3, JUST_BELOW_ONE] {
                            let pixel = table.sample([u, v]);
                            assert_eq!((pixel.x as usize, pixel.y as usize), (x, y));
                            assert!((pixel.pmf - 1.0).abs() < 1e-15);
                        }
                    }
                }
            }
        }
    }

    #[test]
    fn ends_of_the_unit_square_land_on_lit_pixels_of_a_rough_map() {
        for width in [33, 48, 257] {
            let map = rough_map(width, 21);
            let table = build(&map, Settings::default());
            for y in (0..21).filter(|&y| table.row_weight(y) > 0.0) {
                let lit = |x: usize| map.raster.pixel(x, y) != [0.0; 3];
                assert_eq!(table.column_at(y, 0.0), (0..width).find(|&x| lit(x)).unwrap());
                assert_eq!(table.column_at(y, JUST_BELOW_ONE), (0..width).rfind(|&x| lit(x)).unwrap());
                assert_eq!(table.column_at(y, 1.0), (0..width).rfind(|&x| lit(x)).unwrap());
            }
        }
    }

    #[test]
    fn each_sine_weighs_rows_as_its_report_does() {
        let map = map_of(4, 8, |_, _| [1.0; 3]);
        let weights = |sine| {
            let table = build(&map, Settings { sine, ..Settings::default() });
            (0..8).map(|y| table.row_weight(y) / 4.0).collect::<Vec<_>>()
        };
        let near = |found: Vec<f64>, expected: [f64; 8]| found.iter().zip(expected).all(|(f, e)| (f - e).abs() < 1e-6);
        let sines = |step: f64, offset: f64| std::array::from_fn(|y| elementary::sin((y as f64 + offset) * PI / step));
        assert!(near(weights(Sine::Center), sines(8.0, 0.5)));
        assert!(near(weights(Sine::Edge), sines(8.0, 0.0)));
        assert!(near(weights(Sine::EdgeInclusive), sines(7.0, 0.0)));
        assert!(near(weights(Sine::None), [1.0; 8]));
        assert!((4.0 * weights(Sine::Exact).iter().sum::<f64>() - 4.0 * PI).abs() < 1e-5);
        // Rows of no sine are out of reach, also where rounding leaves a hair of it.
        assert_eq!(weights(Sine::Edge)[0], 0.0);
        assert_eq!((weights(Sine::EdgeInclusive)[0], weights(Sine::EdgeInclusive)[7]), (0.0, 0.0));
    }

    #[test]
    fn center_and_exact_give_the_same_probabilities() {
        let map = rough_map(64, 32);
        let center = build(&map, Settings::default());
        let exact = build(&map, Settings { sine: Sine::Exact, ..Settings::default() });
        for k in 0..64 * 32 {
            let (a, b) = (center.pmf(k % 64, k / 64), exact.pmf(k % 64, k / 64));
            assert!((a - b).abs() <= 1e-13 * a);
        }
    }

    #[test]
    fn intensity_clamp_and_negatives_act_channel_by_channel() {
        let map = map_of(2, 1, |x, _| if x == 0 { [4.0, 0.5, -2.0] } else { [0.25; 3] });
        let first = |intensity, clamp| build(&map, Settings { intensity, clamp, sine: Sine::None, ..Settings::default() }).intensities()[0];
        assert_eq!(first(Intensity::Mean, None), 1.5);
        assert_eq!(first(Intensity::Mean, Some(1.0)), 0.5);
        assert_eq!(first(Intensity::Max, None), 4.0);
        assert_eq!(first(Intensity::Rec709, None), (0.2126 * 4.0 + 0.7152 * 0.5) as f32);
        assert_eq!(build(&map, Settings::default()).negative_count(), 1);
    }

    #[test]
    fn the_largest_finite_colors_have_a_finite_sum() {
        let map = map_of(64, 2, |_, _| [f32::MAX; 3]);
        for intensity in [Intensity::Mean, Intensity::Rec709, Intensity::Max] {
            let table = build(&map, Settings { intensity, ..Settings::default() });
            assert!((table.pmf(5, 1) - 1.0 / 128.0).abs() < 1e-9, "{intensity:?}");
        }
    }

    #[test]
    fn the_first_pixel_that_is_not_finite_is_named() {
        for wrong in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            let map = map_of(300, 400, |x, y| if (x, y) == (7, 301) || (x, y) == (3, 399) { [1.0, wrong, 1.0] } else { [1.0; 3] });
            let error = Distribution::build(&map, &Settings { clamp: Some(1.0), ..Settings::default() }, || Ok::<(), Infallible>(()));
            assert_eq!(error.unwrap_err().to_string(), format!("pixel (7, 301) of the map is not finite: `1, {wrong}, 1`"));
        }
    }

    #[test]
    fn a_black_map_is_uniform_over_solid_angle_and_says_so() {
        for color in [[0.0; 3], [-1.0; 3]] {
            let table = build(&map_of(48, 6, |_, _| color), Settings { sine: Sine::None, ..Settings::default() });
            assert!(table.is_uniform());
            for y in 0..6 {
                assert!((table.pdf_of_pixel(3, y) - 1.0 / (4.0 * PI)).abs() < 1e-15);
            }
        }
        // The one row of this map has no sine at its upper edge.
        assert!(build(&map_of(4, 1, |_, _| [1.0; 3]), Settings { sine: Sine::Edge, ..Settings::default() }).is_uniform());
        assert!(!build(&map_of(4, 1, |_, _| [1.0; 3]), Settings::default()).is_uniform());
    }

    #[test]
    fn a_map_without_pixels_is_refused() {
        let map = EnvMap::new(Raster::new(0, 0, Vec::new()));
        let found = Distribution::build(&map, &Settings::default(), || Ok::<(), Infallible>(()));
        assert!(matches!(found, Err(DistributionError::Size { width: 0, height: 0 })));
    }

    #[test]
    fn building_stops_when_told_to() {
        let found = Distribution::build(&rough_map(64, 32), &Settings::default(), || Err("stop"));
        assert!(matches!(found, Err(DistributionError::Interrupted("stop"))));
    }

    #[test]
    fn places_in_the_pixel_go_back_to_the_point() {
        for (width, height) in [(64, 32), (37, 9), (1, 1), (3, 5)] {
            let table = build(&map_of(width, height, |x, y| [(1 + x * 7 % 5 + y) as f32; 3]), Settings::default());
            let stream = Stream::new(12, Purpose::Test);
            for k in 0..500 {
                let [u, v] = stream.generator(k).uniform_pair();
                let Placed { pixel, inside } = table.place_all(&[[u, v]])[0];
                let (x, y) = (pixel.x as usize, pixel.y as usize);
                let row_start = table.marginal_cdf(y) - table.marginal_pmf(y);
                assert!((row_start + inside[1] * table.marginal_pmf(y) - v).abs() < 1e-14);
                let conditional = table.conditional_pmf(y).nth(x).unwrap();
                let start: f64 = table.conditional_pmf(y).take(x).sum();
                assert!((start + inside[0] * conditional - u).abs() < 1e-14);
                assert!(inside.iter().all(|place| (0.0..1.0).contains(place)));
            }
        }
    }

    /// The density minus the mean where that is positive, over its integral: worked out from the map.
    #[test]
    fn compensation_keeps_what_is_above_the_mean() {
        for sine in [Sine::Center, Sine::Exact, Sine::None, Sine::Edge] {
            let map = rough_map(64, 32);
            let plain = build(&map, Settings { sine, ..Settings::default() });
            let table = build(&map, Settings { sine, is_compensated: true, ..Settings::default() });
            assert!(table.is_compensated());
            let excess = |k: usize| (plain.pdf_of_pixel(k % 64, k / 64) - 1.0 / (4.0 * PI)).max(0.0) * plain.solid_angle(k / 64);
            let total: f64 = (0..64 * 32).map(excess).sum();
            for k in 0..64 * 32 {
                let (found, expected) = (table.pmf(k % 64, k / 64), excess(k) / total);
                assert!((found - expected).abs() <= 1e-6 * expected, "{sine:?} {k}: {found} {expected}");
            }
        }
        let even = build(&map_of(16, 8, |x, _| [1.0 + 0.001 * x as f32; 3]), Settings { is_compensated: true, ..Settings::default() });
        assert!(!even.is_compensated());
        assert_eq!(even, build(&map_of(16, 8, |x, _| [1.0 + 0.001 * x as f32; 3]), Settings::default()));
    }

    #[test]
    fn a_mixture_has_its_share_of_the_uniform_density() {
        for (sine, is_compensated) in [(Sine::Center, false), (Sine::EdgeInclusive, false), (Sine::Center, true)] {
            let map = rough_map(37, 9);
            let plain = build(&map, Settings { sine, is_compensated, ..Settings::default() });
            let table = build(&map, Settings { sine, is_compensated, defensive: 0.25, ..Settings::default() });
            assert!(!table.is_compensated());
            for k in 0..37 * 9 {
                let expected = 0.75 * plain.pdf_of_pixel(k % 37, k / 37) + 0.25 / (4.0 * PI);
                assert!((table.pdf_of_pixel(k % 37, k / 37) / expected - 1.0).abs() < 1e-6, "{sine:?} {k}");
            }
        }
        let black = build(&map_of(8, 4, |_, _| [0.0; 3]), Settings { is_compensated: true, defensive: 0.5, ..Settings::default() });
        assert!(black.is_uniform() && !black.is_compensated());
    }

    #[test]
    fn a_direction_finds_the_pixel_that_stands_for_it() {
        for angles in [Angles::Center, Angles::Edge, Angles::EdgeInclusive] {
            let mut map = rough_map(64, 33);
            map.angles = angles;
            let table = build(&map, Settings::default());
            // At a pole all pixels of a row share one direction.
            let rows = if angles == Angles::Center { 0..33 } else { 1..32 };
            for y in rows {
                for x in 0..64 {
                    assert_eq!(table.pixel_at(map.direction(x, y)), (x, y), "{angles:?}");
                    assert_eq!(table.pdf(map.direction(x, y)), table.pdf_of_pixel(x, y));
                }
            }
        }
    }

    #[test]
    fn a_table_is_made_again_from_its_parts() {
        let table = build(&rough_map(37, 9), Settings { sine: Sine::Exact, ..Settings::default() });
        let parts = || Parts {
            width: 37,
            height: 9,
            angles: table.angles(),
            factors: table.factors().to_vec(),
            intensities: table.intensities().to_vec(),
            negative_count: 0,
            is_uniform: false,
            is_compensated: false,
        };
        assert_eq!(Distribution::from_parts(parts()), Some(table.clone()));
        assert_eq!(Distribution::from_parts(Parts { width: 36, ..parts() }), None);
        assert_eq!(Distribution::from_parts(Parts { factors: vec![0.0; 9], ..parts() }), None);
        assert_eq!(Distribution::from_parts(Parts { intensities: vec![f32::NAN; 37 * 9], ..parts() }), None);
        assert_eq!(Distribution::from_parts(Parts { intensities: vec![-1.0; 37 * 9], ..parts() }), None);
    }

    #[test]
    fn a_table_takes_less_than_five_bytes_a_pixel() {
        let table = build(&map_of(1024, 512, |_, _| [1.0; 3]), Settings::default());
        assert!(table.memory() < memory_of(1024 * 512));
    }
}

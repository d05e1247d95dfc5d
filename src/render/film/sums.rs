//! What the samples of pixels add up to, and the one tree by which they are added.
//!
//! Samples of a pixel and replicate are leaves of a binary tree over their indices: a node of 2^k samples is the sum
//! of its two halves, each an f32. Any number of samples is the chain of the largest aligned blocks that make it up,
//! added from the smallest. So sums do not depend on where work was split or continued, and their rounding grows
//! with the logarithm of the count. Pixels of different windows are simply put together.

use std::collections::BTreeMap;

use crate::image::average::{SAMPLE_VARIANCE, STANDARD_ERROR, VARIANCE};
use crate::image::raster::{Image, Layer, Plane, Raster};
use crate::render::film::{Background, FilmDescription, LayerKind};

/// Numbers that one sample adds to its pixel.
pub const CHANNELS: usize = 14;

/// Place of each quantity among the numbers of a sample.
pub mod channel {
    /// Radiance, three numbers.
    pub const COLOR: usize = 0;
    /// Squares of the radiance, three numbers.
    pub const SQUARE: usize = 3;
    /// Albedo of the first surface, three numbers.
    pub const ALBEDO: usize = 6;
    /// Normal of the first surface, three numbers.
    pub const NORMAL: usize = 9;
    /// Distance of the first surface.
    pub const DEPTH: usize = 12;
    /// 1 where a surface was hit.
    pub const COVERAGE: usize = 13;
}

/// What one sample or many of them add up to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sums(pub [f32; CHANNELS]);

impl Default for Sums {
    fn default() -> Self {
        Self([0.0; CHANNELS])
    }
}

impl Sums {
    /// The sum of two.
    #[inline]
    #[must_use]
    pub fn plus(&self, other: &Self) -> Self {
        Self(std::array::from_fn(|k| self.0[k] + other.0[k]))
    }

    /// Three numbers in a row.
    #[inline]
    pub fn triple(&self, first: usize) -> [f32; 3] {
        [self.0[first], self.0[first + 1], self.0[first + 2]]
    }

    /// Sets three numbers in a row.
    #[inline]
    pub fn set_triple(&mut self, first: usize, values: [f32; 3]) {
        self.0[first..first + 3].copy_from_slice(&values);
    }
}

/// Adds samples by the tree: a binary counter whose digits are finished nodes.
#[derive(Debug, Clone, Default)]
pub struct Fold {
    /// Finished nodes by level; those of the digits that are one.
    nodes: [Sums; 32],
    count: u32,
}

impl Fold {
    /// Begins again with a finished node of 2^level samples.
    pub fn restart(&mut self, sums: Sums, level: u32) {
        self.nodes[level as usize] = sums;
        self.count = 1 << level;
    }

    /// Forgets everything.
    pub fn clear(&mut self) {
        self.count = 0;
    }

    /// Adds the next sample.
    #[inline]
    pub fn add(&mut self, sample: Sums) {
        let level = self.count.trailing_ones() as usize;
        let node = self.nodes[..level].iter().fold(sample, |right, left| left.plus(&right));
        self.nodes[level] = node;
        self.count += 1;
    }

    /// The sum of all.
    pub fn total(&self) -> Sums {
        let mut levels = (0..32).filter(|level| self.count >> level & 1 == 1).map(|level| self.nodes[level]);
        let Some(smallest) = levels.next() else { return Sums::default() };
        levels.fold(smallest, |right, left| left.plus(&right))
    }
}

/// Part of a film: rows and columns `x0 <= x < x1`, `y0 <= y < y1`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Window {
    /// First column.
    pub x0: u32,
    /// First row.
    pub y0: u32,
    /// Column after the last.
    pub x1: u32,
    /// Row after the last.
    pub y1: u32,
}

impl Window {
    /// A whole film.
    pub fn whole(resolution: [u32; 2]) -> Self {
        Self { x0: 0, y0: 0, x1: resolution[0], y1: resolution[1] }
    }

    /// Columns.
    pub fn width(&self) -> usize {
        (self.x1 - self.x0) as usize
    }

    /// Rows.
    pub fn height(&self) -> usize {
        (self.y1 - self.y0) as usize
    }

    /// Pixels.
    pub fn pixel_count(&self) -> usize {
        self.width() * self.height()
    }
}

/// Samples of every replicate by their indices: `first..first + count`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Block {
    /// First index.
    pub first: u32,
    /// How many.
    pub count: u32,
}

/// Samples that were not numbers and count as zero.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Refused {
    /// How many.
    pub count: u64,
    /// Pixel (x, y), replicate and index of the first one, in the order of rows.
    pub first: Option<Address>,
}

/// Where a sample belongs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Address {
    /// Row.
    pub y: u32,
    /// Column.
    pub x: u32,
    /// Replicate.
    pub replicate: u32,
    /// Index in the replicate.
    pub index: u32,
}

impl Refused {
    /// Both together.
    #[must_use]
    pub fn plus(self, other: Self) -> Self {
        let first = [self.first, other.first].into_iter().flatten().min();
        Self { count: self.count + other.count, first }
    }
}

/// Sums over a block of samples, for every pixel of a window.
#[derive(Debug, Clone, PartialEq)]
pub struct Film {
    /// Which pixels.
    pub window: Window,
    /// Which samples of every replicate.
    pub block: Block,
    /// Replicates.
    pub replicates: u32,
    /// By row, column and replicate.
    pub sums: Vec<Sums>,
    /// Samples that were not numbers.
    pub refused: Refused,
}

/// Why two parts of a film do not make one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum FilmError {
    /// Different windows, or blocks that are not the two halves of a larger one.
    #[error("the parts are not two halves of one block of samples of the same pixels")]
    NotHalves,
    /// Windows or blocks that do not fit.
    #[error("the parts do not cover the window once with the same samples")]
    NotTiles,
}

impl Film {
    /// The sum of two sibling blocks of one size.
    pub fn followed_by(&self, right: &Self) -> Result<Self, FilmError> {
        let count = self.block.count;
        let are_halves = count.is_power_of_two() && right.block.count == count && self.block.first.is_multiple_of(2 * count);
        let are_alike = self.window == right.window && self.replicates == right.replicates;
        if !are_halves || !are_alike || right.block.first != self.block.first + count {
            return Err(FilmError::NotHalves);
        }
        let sums = self.sums.iter().zip(&right.sums).map(|(left, right)| left.plus(right)).collect();
        let block = Block { first: self.block.first, count: 2 * count };
        Ok(Self { window: self.window, block, replicates: self.replicates, sums, refused: self.refused.plus(right.refused) })
    }

    /// Windows of the same samples put together to one.
    pub fn from_tiles(window: Window, tiles: &[Self]) -> Result<Self, FilmError> {
        let first = tiles.first().ok_or(FilmError::NotTiles)?;
        let replicates = first.replicates as usize;
        let mut sums = vec![Sums::default(); window.pixel_count() * replicates];
        let mut covered = 0;
        let mut refused = Refused::default();
        for tile in tiles {
            let Window { x0, y0, x1, y1 } = tile.window;
            let is_inside = x0 >= window.x0 && y0 >= window.y0 && x1 <= window.x1 && y1 <= window.y1;
            if !is_inside || tile.block != first.block || tile.replicates != first.replicates {
                return Err(FilmError::NotTiles);
            }
            for (row, values) in tile.sums.chunks(tile.window.width() * replicates).enumerate() {
                let start = ((y0 - window.y0) as usize + row) * window.width() + (x0 - window.x0) as usize;
                sums[start * replicates..][..values.len()].copy_from_slice(values);
            }
            covered += tile.window.pixel_count();
            refused = refused.plus(tile.refused);
        }
        if covered != window.pixel_count() {
            return Err(FilmError::NotTiles);
        }
        Ok(Self { window, block: first.block, replicates: first.replicates, sums, refused })
    }

    /// The picture, with the layers that are asked for.
    ///
    /// Variances are of the pixel's value: from squares where there is one replicate, else between replicates.
    pub fn image(&self, description: &FilmDescription) -> Image {
        let replicates = self.replicates as usize;
        let pixels: Vec<&[Sums]> = self.sums.chunks(replicates).collect();
        let (width, height) = (self.window.width(), self.window.height());
        let count = f64::from(self.block.count) * f64::from(self.replicates);
        let is_transparent = description.background == Background::Transparent;
        let raster = |value: &dyn Fn(&[Sums]) -> [f32; 3]| Raster::new(width, height, pixels.iter().map(|pixel| value(pixel)).collect());
        let plane = |value: &dyn Fn(&[Sums]) -> f32| Plane { width, height, values: pixels.iter().map(|pixel| value(pixel)).collect() };
        let coverage = |pixel: &[Sums]| total(pixel, channel::COVERAGE);
        // Alpha is not premultiplied: colors are means over the samples that count.
        let divisor = |pixel: &[Sums]| if is_transparent { coverage(pixel) } else { count };
        let mut layers = BTreeMap::new();
        if description.has(LayerKind::Albedo) {
            layers.insert("albedo".to_owned(), Layer::Color(raster(&|pixel| means(pixel, channel::ALBEDO, divisor(pixel)))));
        }
        if description.has(LayerKind::Normal) {
            layers.insert("normal".to_owned(), Layer::Color(raster(&|pixel| means(pixel, channel::NORMAL, divisor(pixel)))));
        }
        if description.has(LayerKind::Depth) {
            layers.insert("depth".to_owned(), Layer::Scalar(plane(&|pixel| mean(total(pixel, channel::DEPTH), coverage(pixel)))));
        }
        if description.has(LayerKind::Variance) {
            let scale = |pixel: &[Sums]| if divisor(pixel) > 0.0 { count / divisor(pixel) } else { 0.0 };
            let scaled = |pixel: &[Sums], variance: [f64; 3]| variance.map(|value| (value * scale(pixel) * scale(pixel)) as f32);
            let variance = |pixel: &[Sums]| scaled(pixel, self.variance_of_mean(pixel));
            layers.insert(STANDARD_ERROR.to_owned(), Layer::Color(raster(&|pixel| variance(pixel).map(f32::sqrt))));
            layers.insert(VARIANCE.to_owned(), Layer::Color(raster(&variance)));
            if replicates > 1 {
                let of_samples = |pixel: &[Sums]| scaled(pixel, variance_of_independent(pixel, count));
                layers.insert(SAMPLE_VARIANCE.to_owned(), Layer::Color(raster(&of_samples)));
            }
        }
        let alpha = is_transparent.then(|| plane(&|pixel| (coverage(pixel) / count) as f32));
        Image { color: raster(&|pixel| means(pixel, channel::COLOR, divisor(pixel))), alpha, layers }
    }

    /// Variance of the mean over all samples, per channel.
    fn variance_of_mean(&self, pixel: &[Sums]) -> [f64; 3] {
        let count = f64::from(self.block.count);
        if pixel.len() == 1 {
            return variance_of_independent(pixel, count);
        }
        std::array::from_fn(|k| {
            let values: Vec<f64> = pixel.iter().map(|sums| f64::from(sums.0[channel::COLOR + k]) / count).collect();
            let replicates = values.len() as f64;
            let mean = values.iter().sum::<f64>() / replicates;
            values.iter().map(|value| (value - mean) * (value - mean)).sum::<f64>() / (replicates * (replicates - 1.0))
        })
    }
}

/// Variance of the mean of `count` samples per channel if they were independent, from their squares.
fn variance_of_independent(pixel: &[Sums], count: f64) -> [f64; 3] {
    std::array::from_fn(|k| {
        let mean = total(pixel, channel::COLOR + k) / count;
        let square = total(pixel, channel::SQUARE + k) / count;
        (square - mean * mean).max(0.0) / (count - 1.0).max(1.0)
    })
}

/// A channel over all replicates.
fn total(pixel: &[Sums], channel: usize) -> f64 {
    pixel.iter().map(|sums| f64::from(sums.0[channel])).sum()
}

fn means(pixel: &[Sums], first: usize, divisor: f64) -> [f32; 3] {
    std::array::from_fn(|k| mean(total(pixel, first + k), divisor))
}

fn mean(sum: f64, divisor: f64) -> f32 {
    if divisor > 0.0 { (sum / divisor) as f32 } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::stream::{Purpose, Stream};

    fn samples(count: u64) -> Vec<Sums> {
        let stream = Stream::new(4, Purpose::Test);
        (0..count)
            .map(|index| {
                let mut numbers = stream.generator(index);
                Sums(std::array::from_fn(|_| (numbers.uniform() * 1e3 - 100.0) as f32))
            })
            .collect()
    }

    fn folded(samples: &[Sums]) -> Sums {
        let mut fold = Fold::default();
        samples.iter().for_each(|sample| fold.add(*sample));
        fold.total()
    }

    /// The tree by its definition: halves of the largest power of two, then the rest.
    fn by_definition(samples: &[Sums]) -> Sums {
        match samples {
            [] => Sums::default(),
            [only] => *only,
            _ => {
                let largest = 1 << samples.len().ilog2();
                let half = if largest == samples.len() { largest / 2 } else { largest };
                by_definition(&samples[..half]).plus(&by_definition(&samples[half..]))
            }
        }
    }

    #[test]
    fn the_counter_is_the_tree() {
        let samples = samples(300);
        for count in 0..samples.len() {
            assert_eq!(folded(&samples[..count]), by_definition(&samples[..count]), "{count}");
        }
    }

    #[test]
    fn going_on_from_a_power_of_two_gives_the_same_bits() {
        let samples = samples(256);
        for level in 0..8 {
            let (before, after) = samples.split_at(1 << level);
            let mut fold = Fold::default();
            fold.restart(folded(before), level);
            after.iter().for_each(|sample| fold.add(*sample));
            assert_eq!(fold.total(), folded(&samples));
        }
    }

    fn film(window: Window, block: Block, value: impl Fn(u32, u32, u32) -> Sums) -> Film {
        let mut sums = Vec::new();
        for y in window.y0..window.y1 {
            for x in window.x0..window.x1 {
                let all: Vec<Sums> = (block.first..block.first + block.count).map(|index| value(x, y, index)).collect();
                sums.push(folded(&all));
            }
        }
        Film { window, block, replicates: 1, sums, refused: Refused::default() }
    }

    #[test]
    fn blocks_and_tiles_make_the_whole() {
        let samples = samples(4096);
        let value = |x: u32, y: u32, index: u32| samples[((y * 7 + x) * 64 + index) as usize % 4096];
        let window = Window::whole([7, 5]);
        let whole = film(window, Block { first: 0, count: 64 }, value);
        let [a, b, c] = [(0, 32), (32, 16), (48, 16)].map(|(first, count)| film(window, Block { first, count }, value));
        assert_eq!(a.followed_by(&b.followed_by(&c).unwrap()).unwrap(), whole);
        assert_eq!(a.followed_by(&b).unwrap_err(), FilmError::NotHalves);
        assert_eq!(c.followed_by(&b).unwrap_err(), FilmError::NotHalves);
        let tile = |x0, y0, x1, y1| film(Window { x0, y0, x1, y1 }, Block { first: 0, count: 64 }, value);
        let tiles = [tile(3, 0, 7, 2), tile(0, 0, 3, 2), tile(0, 2, 7, 5)];
        assert_eq!(Film::from_tiles(window, &tiles).unwrap(), whole);
        assert_eq!(Film::from_tiles(window, &tiles[1..]).unwrap_err(), FilmError::NotTiles);
    }

    fn of_colors(colors: &[f32], replicates: u32) -> Film {
        let per_replicate = colors.len() / replicates as usize;
        let sums = (0..replicates as usize).map(|replicate| {
            let sample = |value: &f32| {
                let mut sums = Sums::default();
                sums.set_triple(channel::COLOR, [*value; 3]);
                sums.set_triple(channel::SQUARE, [value * value; 3]);
                sums
            };
            let own: Vec<Sums> = colors.iter().skip(replicate).step_by(replicates as usize).map(sample).collect();
            folded(&own)
        });
        let block = Block { first: 0, count: per_replicate as u32 };
        Film { window: Window::whole([1, 1]), block, replicates, sums: sums.collect(), refused: Refused::default() }
    }

    #[test]
    fn the_variance_is_that_of_the_mean() {
        let description = FilmDescription { layers: vec![LayerKind::Variance], ..FilmDescription::default() };
        let variance = |film: &Film| match &film.image(&description).layers["variance"] {
            Layer::Color(raster) => raster.pixel(0, 0)[0],
            Layer::Scalar(_) => unreachable!(),
        };
        let colors = [1.0, 2.0, 4.0, 9.0];
        // Variance of 1 2 4 9 is 38 / 3; of the mean a quarter of that.
        assert!((variance(&of_colors(&colors, 1)) - 38.0 / 12.0).abs() < 1e-5);
        // Two replicates, means 2.5 and 5.5: the variance of their mean is (3 / 2)².
        assert!((variance(&of_colors(&colors, 2)) - 2.25).abs() < 1e-6);
        // Taken as four independent samples they say what one replicate says.
        let Layer::Color(raster) = &of_colors(&colors, 2).image(&description).layers["sample_variance"] else { unreachable!() };
        assert!((raster.pixel(0, 0)[0] - 38.0 / 12.0).abs() < 1e-5);
        assert!(!of_colors(&colors, 1).image(&description).layers.contains_key("sample_variance"));
        assert_eq!(of_colors(&colors, 2).image(&description).color.pixel(0, 0), [4.0; 3]);
    }

    #[test]
    fn transparent_colors_are_means_over_what_is_covered() {
        let mut sums = Sums::default();
        sums.set_triple(channel::COLOR, [6.0, 3.0, 0.0]);
        sums.0[channel::COVERAGE] = 3.0;
        let film = Film {
            window: Window::whole([2, 1]),
            block: Block { first: 0, count: 4 },
            replicates: 1,
            sums: vec![sums, Sums::default()],
            refused: Refused::default(),
        };
        let image = film.image(&FilmDescription { background: Background::Transparent, ..FilmDescription::default() });
        assert_eq!(image.color.pixels(), [[2.0, 1.0, 0.0], [0.0; 3]]);
        assert_eq!(image.alpha.unwrap().values, [0.75, 0.0]);
    }
}

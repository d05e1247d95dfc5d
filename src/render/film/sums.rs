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

    /// Its rows in so many bands of about equal height, or as many as there are rows.
    pub fn bands(&self, count: u32) -> impl Iterator<Item = Self> {
        let (window, rows) = (*self, self.y1 - self.y0);
        let count = count.min(rows);
        let edge = move |band: u32| window.y0 + (u64::from(rows) * u64::from(band) / u64::from(count)) as u32;
        (0..count).map(move |band| Self { y0: edge(band), y1: edge(band + 1), ..window })
    }

    /// Whether that window lies inside of this one.
    pub fn holds(&self, window: &Self) -> bool {
        window.x0 >= self.x0 && window.y0 >= self.y0 && window.x1 <= self.x1 && window.y1 <= self.y1
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

/// Puts parts of a film together: bands of rows from the first to the last, and of each band blocks of samples from the first
/// to the last.
#[derive(Debug)]
pub struct Assembly {
    /// What is to be made; its sums are those of finished bands.
    whole: Film,
    /// Rows that are finished.
    finished: u32,
    /// Nodes of the tree of samples of the band in work, the one of the first samples first.
    nodes: Vec<Film>,
}

impl Assembly {
    /// Nothing is there yet.
    pub fn new(window: Window, block: Block, replicates: u32) -> Self {
        let sums = vec![Sums::default(); window.pixel_count() * replicates as usize];
        let whole = Film { window, block, replicates, sums, refused: Refused::default() };
        Self { whole, finished: window.y0, nodes: Vec::new() }
    }

    /// Takes the next part; false for one that it does not expect.
    #[must_use]
    pub fn take(&mut self, part: Film) -> bool {
        if !self.expects(&part) {
            return false;
        }
        let mut node = part;
        while self.nodes.last().is_some_and(|last| last.is_half_beside(&node)) {
            let mut left = self.nodes.pop().expect("the loop has looked");
            left.add_following(&node);
            node = left;
        }
        self.nodes.push(node);
        if self.next_index() == self.whole.block.first + self.whole.block.count {
            self.finish_band();
        }
        true
    }

    /// The film, if every pixel has all its samples.
    pub fn finish(self) -> Option<Film> {
        (self.finished == self.whole.window.y1).then_some(self.whole)
    }

    /// Index of the first sample that the band in work does not have.
    fn next_index(&self) -> u32 {
        self.nodes.last().map_or(self.whole.block.first, |last| last.block.first + last.block.count)
    }

    /// Whether a part goes on where the last one ended.
    pub fn expects(&self, part: &Film) -> bool {
        let Film { window, block, replicates, .. } = self.whole;
        let goes_on = match self.nodes.last() {
            Some(last) => part.window == last.window,
            None => part.window.y0 == self.finished && part.window.y0 < part.window.y1,
        };
        let is_band = (part.window.x0, part.window.x1) == (window.x0, window.x1) && window.holds(&part.window);
        let has_sums = part.sums.len() == part.window.pixel_count() * replicates as usize;
        let follows = part.block.first == self.next_index() && part.block.count <= block.first + block.count - part.block.first;
        goes_on && is_band && has_sums && follows && part.replicates == replicates
    }

    /// Adds the chain of nodes from the smallest, which has the last samples, and puts the band in its place.
    fn finish_band(&mut self) {
        let mut nodes = std::mem::take(&mut self.nodes).into_iter().rev();
        let Some(smallest) = nodes.next() else { return };
        let band = nodes.fold(smallest, |right, mut left| {
            left.add_following(&right);
            left
        });
        let place = (band.window.y0 - self.whole.window.y0) as usize * self.whole.window.width() * self.whole.replicates as usize;
        self.whole.sums[place..][..band.sums.len()].copy_from_slice(&band.sums);
        self.whole.refused = self.whole.refused.plus(band.refused);
        self.finished = band.window.y1;
    }
}

impl Film {
    /// The part of it that is seen through a window; `None` where the window is larger, or samples were refused, whose pixels
    /// are not known.
    pub fn cropped(&self, window: Window) -> Option<Self> {
        let has_refused = self.refused.count > 0 && self.window != window;
        if !self.window.holds(&window) || has_refused {
            return None;
        }
        let replicates = self.replicates as usize;
        let per_row = window.width() * replicates;
        let row = |y: u32| {
            let place = (y - self.window.y0) as usize * self.window.width() + (window.x0 - self.window.x0) as usize;
            &self.sums[place * replicates..][..per_row]
        };
        let sums = (window.y0..window.y1).flat_map(row).copied().collect();
        Some(Self { window, sums, ..*self })
    }

    /// Adds the samples that follow: its own are the left branch of the tree, the others the right one.
    fn add_following(&mut self, right: &Self) {
        self.sums.iter_mut().zip(&right.sums).for_each(|(left, right)| *left = left.plus(right));
        self.block.count += right.block.count;
        self.refused = self.refused.plus(right.refused);
    }

    /// Whether that block is the other half of a node of the tree of samples.
    fn is_half_beside(&self, right: &Self) -> bool {
        let count = self.block.count;
        count.is_power_of_two() && right.block.count == count && self.block.first.is_multiple_of(2 * count)
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
        let part = |y0, y1, first, count| film(Window { x0: 0, y0, x1: 7, y1 }, Block { first, count }, value);
        let assembled = |parts: &[Film]| {
            let mut assembly = Assembly::new(window, whole.block, 1);
            parts.iter().all(|part| assembly.take(part.clone())).then(|| assembly.finish()).flatten()
        };
        let blocks = [part(0, 5, 0, 32), part(0, 5, 32, 16), part(0, 5, 48, 16)];
        let bands = [part(0, 2, 0, 64), part(2, 5, 0, 64)];
        let both = [part(0, 2, 0, 32), part(0, 2, 32, 32), part(2, 5, 0, 16), part(2, 5, 16, 16), part(2, 5, 32, 32)];
        assert_eq!(assembled(&blocks).unwrap(), whole);
        assert_eq!(assembled(&bands).unwrap(), whole);
        assert_eq!(assembled(&both).unwrap(), whole);
        assert_eq!(bands[1], whole.cropped(bands[1].window).unwrap());
        assert_eq!(bands[1].cropped(window), None);
        // Something is missing, stands twice or in the wrong order.
        for wrong in
            [&blocks[1..], &blocks[..2], &bands[1..], &both[..4], &[&bands[..1], &bands].concat(), &[&blocks[..2], &bands].concat()]
        {
            assert_eq!(assembled(wrong), None);
        }
    }

    #[test]
    fn any_count_of_samples_is_assembled_from_blocks_of_any_size() {
        let samples = samples(300);
        let window = Window::whole([1, 1]);
        let block = |first: u32, count: u32| film(window, Block { first, count }, |_, _, index| samples[index as usize]);
        for count in [1, 2, 3, 5, 37, 64, 100, 255, 256, 300] {
            for size in [1, 2, 16, 32, 128].into_iter().filter(|size| *size <= count) {
                let mut assembly = Assembly::new(window, Block { first: 0, count }, 1);
                let starts = (0..count).step_by(size as usize);
                starts.for_each(|first| assert!(assembly.take(block(first, size.min(count - first)))));
                assert_eq!(assembly.finish().unwrap(), block(0, count), "{count} by {size}");
            }
        }
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

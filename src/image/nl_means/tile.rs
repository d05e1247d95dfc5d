//! One tile of a filtered image: distances, weights and sums, offset by offset.

use std::num::NonZeroUsize;
use std::ops::Range;

use super::Settings;
use super::padded::{Feature, Padded};
use super::windows::WindowSums;
use crate::math::single;

/// Added to the noise that a difference is measured by, so that noise-free pixels have distances too.
const NOISE_FLOOR: f32 = 1e-10;

/// Weights of patches farther apart than this are zero in f32.
const FARTHEST: f32 = 88.0;

/// One tile and its scratch planes.
///
/// Three sizes of plane lie inside each other: the tile itself; the tile and the half of a patch whose weights are
/// averaged around each pixel (nothing unless `patchwise`); that and the half of a patch that distances are summed over.
pub struct Tile {
    settings: Settings,
    /// Column and row of the tile's first pixel in the image.
    at: [usize; 2],
    size: [usize; 2],
    /// Distances, their sums, weights and their means, one after the other, all with the largest plane's stride.
    values: Vec<f32>,
    windows: WindowSums,
    sums: [Vec<f32>; 3],
    weights: Vec<f32>,
}

impl Tile {
    /// A tile of `size` pixels whose first is at column and row `at`.
    pub fn new(at: [usize; 2], size: [usize; 2], settings: Settings) -> Self {
        let count = size[0] * size[1];
        let sums = std::array::from_fn(|_| vec![0.0; count]);
        Self { settings, at, size, values: Vec::new(), windows: WindowSums::default(), sums, weights: vec![0.0; count] }
    }

    /// The tile's pixels, row by row. Pixels that do not count stay as they are.
    ///
    /// # Errors
    /// What `check` gives, asked for each row of offsets.
    pub fn filtered<E>(mut self, image: &Padded, check: &impl Fn() -> Result<(), E>) -> Result<Vec<[f32; 3]>, E> {
        let radius = self.settings.window_radius as isize;
        for dy in -radius..=radius {
            check()?;
            for dx in -radius..=radius {
                let offset = dy * image.width as isize + dx;
                self.measure(image, offset);
                self.sum_squares(self.settings.patch_radius as usize);
                self.weigh(image, offset, [dx as f32, dy as f32]);
                self.sum_squares(self.settings.patchwise_radius());
                self.gather(image, offset);
            }
        }
        Ok(self.finished(image))
    }

    /// Distances of each pixel from the one at the offset.
    fn measure(&mut self, image: &Padded, offset: isize) {
        let reach = self.settings.reach();
        let scale = Scale::new(self.settings);
        let stride = self.stride();
        let mut values = std::mem::take(&mut self.values);
        values.resize(stride * (self.size[1] + 2 * reach), 0.0);
        for (row, out) in values.chunks_exact_mut(stride).enumerate() {
            let here = self.span(image, reach, row);
            let there = moved(&here, offset);
            distances(out, Pixels::of(image, here), Pixels::of(image, there), scale);
        }
        self.values = values;
    }

    /// Sums over squares of 2 `radius` + 1 values, each at the place of the square's first value.
    fn sum_squares(&mut self, radius: usize) {
        let length = NonZeroUsize::MIN.saturating_add(2 * radius);
        let stride = self.stride();
        self.windows.slide(&mut self.values, length, 1);
        self.windows.slide(&mut self.values, length, stride);
    }

    /// Sums of distances become weights; the offset as a place in the planes and as pixels across and down.
    fn weigh(&mut self, image: &Padded, offset: isize, [dx, dy]: [f32; 2]) {
        let around = self.settings.patchwise_radius();
        let side = (2 * self.settings.patch_radius + 1) as f32;
        let count = side * side;
        let (columns, rows, stride) = (self.size[0] + 2 * around, self.size[1] + 2 * around, self.stride());
        for row in 0..rows {
            let here = self.span(image, around, row);
            let there = moved(&here, offset);
            let values = &mut self.values[row * stride..row * stride + columns];
            for Feature { values: feature, scale, slopes } in &image.features {
                let own = feature[here.clone()].iter().zip(slopes[0][here.clone()].iter().zip(&slopes[1][here.clone()]));
                let expected = own.map(|(own, (across, down))| own + (across * dx + down * dy));
                for (((sum, expected), other), scale) in
                    values.iter_mut().zip(expected).zip(&feature[there.clone()]).zip(&scale[here.clone()])
                {
                    *sum = sum.max((expected - other) * (expected - other) * scale * count);
                }
            }
            values.iter_mut().for_each(|sum| *sum = single::exp(sum.max(0.0) * (-1.0 / count)));
        }
    }

    /// Adds the pixels at the offset by their weights.
    fn gather(&mut self, image: &Padded, offset: isize) {
        let around = self.settings.patchwise_radius();
        let side = (2 * around + 1) as f32;
        let (columns, stride) = (self.size[0], self.stride());
        for row in 0..self.size[1] {
            let there = moved(&self.span(image, 0, row), offset);
            let own = row * columns..(row + 1) * columns;
            let values = &mut self.values[row * stride..row * stride + columns];
            for ((value, counts), weight) in values.iter_mut().zip(&image.counts[there.clone()]).zip(&mut self.weights[own.clone()]) {
                *value *= counts / (side * side);
                *weight += *value;
            }
            for (sums, target) in self.sums.iter_mut().zip(&image.target) {
                for ((sum, weight), target) in sums[own.clone()].iter_mut().zip(&*values).zip(&target[there.clone()]) {
                    *sum += weight * target;
                }
            }
        }
    }

    fn finished(self, image: &Padded) -> Vec<[f32; 3]> {
        let columns = self.size[0];
        let pixel = |index: usize| {
            let here = self.span(image, 0, index / columns).start + index % columns;
            let is_kept = image.counts[here] == 0.0 || self.weights[index] <= 0.0;
            std::array::from_fn(|c| if is_kept { image.target[c][here] } else { self.sums[c][index] / self.weights[index] })
        };
        (0..self.weights.len()).map(pixel).collect()
    }

    fn stride(&self) -> usize {
        self.size[0] + 2 * self.settings.reach()
    }

    /// Where a row of the tile widened by `around` on every side lies in a padded plane; row 0 is the first of the widened tile.
    fn span(&self, image: &Padded, around: usize, row: usize) -> Range<usize> {
        let edge = image.margin - around;
        let start = (self.at[1] + edge + row) * image.width + self.at[0] + edge;
        start..start + self.size[0] + 2 * around
    }
}

/// A range of a padded plane, moved by an offset of the window.
fn moved(range: &Range<usize>, offset: isize) -> Range<usize> {
    let start = range.start.checked_add_signed(offset).expect("the margin is as wide as the window");
    start..start + range.len()
}

/// A row of pixels with their variances.
struct Pixels<'a> {
    color: [&'a [f32]; 3],
    variance: [&'a [f32]; 3],
}

impl<'a> Pixels<'a> {
    fn of(image: &'a Padded, range: Range<usize>) -> Self {
        let rows = |planes: &'a [Vec<f32>; 3]| planes.each_ref().map(|plane| &plane[range.clone()]);
        Self { color: rows(&image.color), variance: rows(&image.variance) }
    }
}

/// What a difference is measured by.
#[derive(Clone, Copy)]
struct Scale {
    k_squared: f32,
    /// Largest distance between two pixels: enough to make the weight of every patch with it zero.
    cap: f32,
}

impl Scale {
    fn new(settings: Settings) -> Self {
        let k_squared = settings.k * settings.k;
        let side = (2 * settings.patch_radius + 1) as f32;
        // Differences less than the noise count as negative, down to -1 / k² a pixel.
        Self { k_squared, cap: side * side * (FARTHEST + 1.0 / k_squared) }
    }
}

/// Mean over the channels of ((u_p - u_q)² - (v_p + min(v_p, v_q))) / (k² (v_p + v_q)).
fn distances(out: &mut [f32], own: Pixels<'_>, other: Pixels<'_>, scale: Scale) {
    let count = out.len();
    let [own_color, own_variance, other_color, other_variance] =
        [own.color, own.variance, other.color, other.variance].map(|rows| rows.map(|row| &row[..count]));
    for i in 0..count {
        let of_channel = |c: usize| {
            let difference = own_color[c][i] - other_color[c][i];
            let (own, other) = (own_variance[c][i], other_variance[c][i]);
            (difference * difference - (own + own.min(other))) / (NOISE_FLOOR + scale.k_squared * (own + other))
        };
        out[i] = ((of_channel(0) + of_channel(1) + of_channel(2)) * (1.0 / 3.0)).min(scale.cap);
    }
}

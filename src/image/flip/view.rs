//! An image as FLIP sees it: filtered, in CIELAB, with the strength of edges and points.
//!
//! Works on strips of rows. `look` filters along the rows into planes, `write_row` along the columns; loops run
//! over blocks of neighboring columns, so that the compiler can keep a block's sums in vector registers. Each
//! sum adds its terms in the order of the kernel, whatever the strip.

use super::filters::{Filters, Kernel};
use super::hunt_lab;
use crate::image::color;
use crate::image::raster::Raster;

/// Columns whose sums are kept together.
const BLOCK: usize = 16;

/// One row of an image as seen.
pub struct SeenRow {
    /// L* of the filtered colors.
    pub lightness: Vec<f32>,
    /// a* of the filtered colors with the Hunt effect.
    pub a: Vec<f32>,
    /// b* of the filtered colors with the Hunt effect.
    pub b: Vec<f32>,
    /// Strength of edges in luminance.
    pub edge: Vec<f32>,
    /// Strength of points in luminance.
    pub point: Vec<f32>,
}

impl SeenRow {
    /// Room for a row of that many pixels.
    pub fn new(width: usize) -> Self {
        let row = || vec![0.0; width.next_multiple_of(BLOCK)];
        Self { lightness: row(), a: row(), b: row(), edge: row(), point: row() }
    }
}

/// A strip of an image, filtered along its rows.
pub struct View<'a> {
    image: &'a Raster,
    filters: &'a Filters,
    /// First row of the strip, and the rows filtered for it: further by the kernels' reach.
    first_row: usize,
    filtered: std::ops::Range<usize>,
    /// The image's width rounded up to whole blocks.
    stride: usize,
    achromatic: Vec<f32>,
    red_green: Vec<f32>,
    blue_yellow: [Vec<f32>; 2],
    smooth: Vec<f32>,
    edge: Vec<f32>,
    point: Vec<f32>,
}

impl<'a> View<'a> {
    /// A view of `row_count` rows from `first_row` on, fewer at the lower end of the image.
    pub fn new(image: &'a Raster, filters: &'a Filters, first_row: usize, row_count: usize) -> Self {
        let reach = filters.radius();
        let filtered = first_row.saturating_sub(reach)..(first_row + row_count + reach).min(image.height());
        let stride = image.width().next_multiple_of(BLOCK);
        let plane = || vec![0.0; stride * filtered.len()];
        Self {
            image,
            filters,
            first_row,
            stride,
            achromatic: plane(),
            red_green: plane(),
            blue_yellow: [plane(), plane()],
            smooth: plane(),
            edge: plane(),
            point: plane(),
            filtered,
        }
    }

    /// Filters the strip along its rows; `shown` gives the displayed color in [0, 1] of a linear one.
    pub fn look(&mut self, shown: impl Fn([f32; 3]) -> [f32; 3]) {
        let reach = self.filters.radius();
        let mut planes: [Vec<f32>; 3] = std::array::from_fn(|_| vec![0.0; self.stride + 2 * reach]);
        for (index, y) in self.filtered.clone().enumerate() {
            write_padded(&mut planes, self.image.row(y), reach, &shown);
            let [luminance, red_green, blue_yellow] = &planes;
            let row = index * self.stride..(index + 1) * self.stride;
            along_row(&mut self.achromatic[row.clone()], luminance, &self.filters.achromatic, reach);
            along_row(&mut self.red_green[row.clone()], red_green, &self.filters.red_green, reach);
            for (plane, kernel) in self.blue_yellow.iter_mut().zip(&self.filters.blue_yellow_rows) {
                along_row(&mut plane[row.clone()], blue_yellow, kernel, reach);
            }
            along_row(&mut self.smooth[row.clone()], luminance, &self.filters.smooth, reach);
            along_row(&mut self.edge[row.clone()], luminance, &self.filters.edge, reach);
            along_row(&mut self.point[row], luminance, &self.filters.point, reach);
        }
    }

    /// Filters along the columns and writes what is seen in row `row` of the strip.
    pub fn write_row(&self, row: usize, seen: &mut SeenRow) {
        for x in (0..self.stride).step_by(BLOCK) {
            let [wide, narrow] = &self.filters.blue_yellow_columns;
            let luminance = self.along_column(&self.achromatic, &self.filters.achromatic, row, x);
            let red_green = self.along_column(&self.red_green, &self.filters.red_green, row, x);
            let blue_yellow =
                sums(self.along_column(&self.blue_yellow[0], wide, row, x), self.along_column(&self.blue_yellow[1], narrow, row, x));
            for i in 0..BLOCK {
                let filtered = color::linear_of_opponent([luminance[i], red_green[i], blue_yellow[i]]);
                let lab = hunt_lab(filtered.map(|v| v.clamp(0.0, 1.0)));
                [seen.lightness[x + i], seen.a[x + i], seen.b[x + i]] = lab;
            }
            let edge_x = self.along_column(&self.edge, &self.filters.smooth, row, x);
            let edge_y = self.along_column(&self.smooth, &self.filters.edge, row, x);
            seen.edge[x..x + BLOCK].copy_from_slice(&lengths(edge_x, edge_y));
            let point_x = self.along_column(&self.point, &self.filters.smooth, row, x);
            let point_y = self.along_column(&self.smooth, &self.filters.point, row, x);
            seen.point[x..x + BLOCK].copy_from_slice(&lengths(point_x, point_y));
        }
    }

    /// The block of columns from `x` on, filtered down the columns around row `row` of the strip.
    fn along_column(&self, plane: &[f32], kernel: &Kernel, row: usize, x: usize) -> [f32; BLOCK] {
        let center = self.first_row + row;
        let mut sum = [0.0; BLOCK];
        for (tap, weight) in kernel.weights.iter().enumerate() {
            let y = (center + tap).saturating_sub(kernel.radius()).min(self.image.height() - 1);
            let start = (y - self.filtered.start) * self.stride + x;
            let values: &[f32; BLOCK] = plane[start..start + BLOCK].try_into().expect("a block has that many columns");
            for i in 0..BLOCK {
                sum[i] += weight * values[i];
            }
        }
        sum
    }
}

/// Writes a row of opponent colors with its border pixels repeated on both sides.
fn write_padded(planes: &mut [Vec<f32>; 3], row: &[[f32; 3]], reach: usize, shown: impl Fn([f32; 3]) -> [f32; 3]) {
    for (x, color) in row.iter().enumerate() {
        let opponent = color::opponent(shown(*color));
        for (plane, value) in planes.iter_mut().zip(opponent) {
            plane[reach + x] = value;
        }
    }
    for plane in planes {
        let (first, last) = (plane[reach], plane[reach + row.len() - 1]);
        plane[..reach].fill(first);
        plane[reach + row.len()..].fill(last);
    }
}

/// Filters a row that is padded by `reach` on both sides.
fn along_row(out: &mut [f32], padded: &[f32], kernel: &Kernel, reach: usize) {
    let offset = reach - kernel.radius();
    for (block, out) in out.chunks_exact_mut(BLOCK).enumerate() {
        let mut sum = [0.0; BLOCK];
        for (tap, weight) in kernel.weights.iter().enumerate() {
            let start = block * BLOCK + offset + tap;
            let values: &[f32; BLOCK] = padded[start..start + BLOCK].try_into().expect("a block has that many columns");
            for i in 0..BLOCK {
                sum[i] += weight * values[i];
            }
        }
        out.copy_from_slice(&sum);
    }
}

fn sums(one: [f32; BLOCK], other: [f32; BLOCK]) -> [f32; BLOCK] {
    std::array::from_fn(|i| one[i] + other[i])
}

fn lengths(x: [f32; BLOCK], y: [f32; BLOCK]) -> [f32; BLOCK] {
    std::array::from_fn(|i| (x[i] * x[i] + y[i] * y[i]).sqrt())
}

//! Contact sheets: pictures in rows and columns with the values of their axes beside them.
//!
//! Pictures are shrunk by averaging the light that their pixels stand for (decoded by the sRGB curve, weighted by the exact area
//! that each covers), and enlarged by repeating pixels. Labels are wrapped, then written smaller, and never reach into
//! another's room.

use rayon::prelude::*;

use super::bitmap::Bitmap;
use super::canvas::{Anchor, Ink, Label, Mark};
use super::text::{self, CAPITAL_HEIGHT};
use crate::image::color::{srgb_decode, srgb_encode};
use crate::image::raster::{Picture, PictureSamples};

/// A contact sheet before it is drawn; lengths are in pixels.
#[derive(Debug, Clone, PartialEq)]
pub struct Sheet {
    /// Above everything; may be empty.
    pub title: String,
    /// One text for each row, at its left; texts may be empty.
    pub row_labels: Vec<String>,
    /// One text for each column, above it; texts may be empty.
    pub column_labels: Vec<String>,
    /// A picture for each row and column, row by row, none where there is none; see [`fitted`].
    pub cells: Vec<Option<Bitmap>>,
    /// Width of a column.
    pub cell_width: usize,
    /// Free space between cells.
    pub gap: usize,
    /// Color of the sheet, encoded sRGB.
    pub background: [u8; 3],
}

/// A picture with eight bits a channel, laid over `background` where it is transparent.
pub fn flattened(picture: &Picture, background: [u8; 3]) -> Bitmap {
    let largest = if matches!(picture.samples, PictureSamples::Eight(_)) { 255 } else { 65_535 };
    let alpha = |index: usize| picture.alpha.as_ref().map_or(1.0, |alpha| f64::from(alpha[index]) / f64::from(largest));
    let over = |color: f64, index: usize, k: usize| {
        let coverage = alpha(index);
        (color * coverage + f64::from(background[k]) * (1.0 - coverage)).round() as u8
    };
    let pixels = match &picture.samples {
        PictureSamples::Eight(samples) => {
            samples.iter().enumerate().map(|(index, color)| [0, 1, 2].map(|k| over(f64::from(color[k]), index, k))).collect()
        }
        PictureSamples::Sixteen(samples) => {
            samples.iter().enumerate().map(|(index, color)| [0, 1, 2].map(|k| over(f64::from(color[k]) / 257.0, index, k))).collect()
        }
    };
    Bitmap { width: picture.width, height: picture.height, pixels }
}

/// The bitmap at another width, its height in proportion.
pub fn fitted(bitmap: Bitmap, width: usize) -> Bitmap {
    if bitmap.width == width || bitmap.width == 0 || bitmap.height == 0 {
        return bitmap;
    }
    let height = (bitmap.height as f64 * width as f64 / bitmap.width as f64).round().max(1.0) as usize;
    if width < bitmap.width { shrunk(&bitmap, width, height) } else { enlarged(&bitmap, width, height) }
}

fn enlarged(bitmap: &Bitmap, width: usize, height: usize) -> Bitmap {
    let pixel = |x: usize, y: usize| bitmap.pixels[y * bitmap.height / height * bitmap.width + x * bitmap.width / width];
    let pixels = (0..height).flat_map(|y| (0..width).map(move |x| pixel(x, y))).collect();
    Bitmap { width, height, pixels }
}

/// Each pixel is the mean of the light in the area that it covers.
fn shrunk(bitmap: &Bitmap, width: usize, height: usize) -> Bitmap {
    let light: Vec<f64> = (0..=255).map(|value| srgb_decode(f64::from(value) / 255.0)).collect();
    let (columns, rows) = (shares(bitmap.width, width), shares(bitmap.height, height));
    let row_of =
        |row: &Vec<(usize, f64)>| -> Vec<[u8; 3]> { columns.iter().map(|column| mean_light(bitmap, &light, column, row)).collect() };
    Bitmap { width, height, pixels: rows.par_iter().flat_map_iter(row_of).collect() }
}

fn mean_light(bitmap: &Bitmap, light: &[f64], columns: &[(usize, f64)], rows: &[(usize, f64)]) -> [u8; 3] {
    let mut sum = [0.0; 3];
    for (y, height) in rows {
        for (x, width) in columns {
            let color = bitmap.pixels[y * bitmap.width + x];
            for k in 0..3 {
                sum[k] += light[usize::from(color[k])] * width * height;
            }
        }
    }
    sum.map(|mean| (srgb_encode(mean.clamp(0.0, 1.0)) * 255.0).round() as u8)
}

/// For each of `count` equal parts of a side of `length` pixels: which pixels it covers, and how much of it each fills.
fn shares(length: usize, count: usize) -> Vec<Vec<(usize, f64)>> {
    let edge = |part: usize| part as f64 * length as f64 / count as f64;
    let size = length as f64 / count as f64;
    (0..count)
        .map(|part| {
            let (low, high) = (edge(part), edge(part + 1).min(length as f64));
            let pixels = low as usize..(high.ceil() as usize).min(length);
            pixels.map(|pixel| (pixel, (high.min(pixel as f64 + 1.0) - low.max(pixel as f64)) / size)).collect()
        })
        .collect()
}

/// Line spacing as a multiple of the font's size.
const LEADING: f64 = 1.3;
const LEAST_TEXT_SIZE: f64 = 9.0;
const GREATEST_TEXT_SIZE: f64 = 26.0;

/// Lines of text that fit their room.
struct Lines {
    lines: Vec<String>,
    size: f64,
}

impl Lines {
    /// The text within `width`: in lines, written smaller where a word is too wide, cut by letters only at the smallest size.
    fn of(text: &str, size: f64, width: f64) -> Self {
        let words = text.split_ascii_whitespace().flat_map(|word| word.split_inclusive('-'));
        let widest = words.map(|word| text::width(word, size)).fold(0.0, f64::max);
        let size = (size * (width / widest.max(width))).max(LEAST_TEXT_SIZE.min(size));
        Self { lines: text::wrapped(text, size, width), size }
    }

    fn height(&self) -> f64 {
        self.lines.len() as f64 * self.size * LEADING
    }

    fn width(&self) -> f64 {
        self.lines.iter().map(|line| text::width(line, self.size)).fold(0.0, f64::max)
    }

    /// Draws the lines with their middle or end at `x`, the first one below `top`.
    fn draw(&self, bitmap: &mut Bitmap, x: f64, top: f64, anchor: Anchor, ink: Ink) {
        for (index, line) in self.lines.iter().enumerate() {
            let baseline = top + (index as f64 + 0.5) * self.size * LEADING + CAPITAL_HEIGHT * self.size / 2.0;
            let label = Label { text: line.clone(), position: [x, baseline], anchor, size: self.size, is_turned: false, ink };
            bitmap.draw(&Mark::Text(label), 1.0);
        }
    }
}

/// Draws the sheet as an opaque picture with eight bits a channel.
///
/// # Panics
/// If there are not as many cells as rows times columns.
pub fn draw(sheet: &Sheet) -> Picture {
    let columns = sheet.column_labels.len();
    assert_eq!(sheet.cells.len(), sheet.row_labels.len() * columns, "a sheet has a cell for each row and column");
    let gap = sheet.gap;
    let size = (sheet.cell_width as f64 / 14.0).clamp(LEAST_TEXT_SIZE + 2.0, GREATEST_TEXT_SIZE);
    let row_lines: Vec<Lines> =
        sheet.row_labels.iter().map(|label| Lines::of(label, size, (0.6 * sheet.cell_width as f64).max(8.0 * size))).collect();
    let column_lines: Vec<Lines> = sheet.column_labels.iter().map(|label| Lines::of(label, size, sheet.cell_width as f64)).collect();

    let gutter = row_lines.iter().map(Lines::width).fold(0.0, f64::max).ceil() as usize;
    let left = gap + if gutter > 0 { gutter + gap.max(8) } else { 0 };
    let width = left + columns * (sheet.cell_width + gap);
    let title = Lines::of(&sheet.title, 1.25 * size, width as f64 - 2.0 * gap as f64);
    let head = column_lines.iter().map(Lines::height).fold(0.0, f64::max).ceil() as usize;
    let title_height = title.height().ceil() as usize;
    let top = gap + title_height + if head > 0 { head + gap / 2 } else { 0 };
    let heights: Vec<usize> =
        sheet.cells.chunks(columns.max(1)).zip(&row_lines).map(|(row, label)| row_height(row, label, sheet)).collect();
    let height = top + heights.iter().map(|height| height + gap).sum::<usize>();

    let ink = readable_on(sheet.background);
    let mut bitmap = Bitmap::filled(width.max(1), height.max(1), sheet.background);
    title.draw(&mut bitmap, width as f64 / 2.0, gap as f64 / 2.0, Anchor::Middle, ink);
    let column_x = |column: usize| left + column * (sheet.cell_width + gap);
    for (column, lines) in column_lines.iter().enumerate() {
        let middle = column_x(column) as f64 + sheet.cell_width as f64 / 2.0;
        lines.draw(&mut bitmap, middle, (top - gap / 2) as f64 - lines.height(), Anchor::Middle, ink);
    }
    let mut y = top;
    for (row, (lines, row_height)) in row_lines.iter().zip(&heights).enumerate() {
        lines.draw(&mut bitmap, (left - gap.max(8)) as f64, y as f64 + (*row_height as f64 - lines.height()) / 2.0, Anchor::End, ink);
        for column in 0..columns {
            if let Some(cell) = &sheet.cells[row * columns + column] {
                paste(
                    &mut bitmap,
                    cell,
                    column_x(column) + (sheet.cell_width.saturating_sub(cell.width)) / 2,
                    y + (row_height - cell.height) / 2,
                );
            }
        }
        y += row_height + gap;
    }
    Picture { width: bitmap.width, height: bitmap.height, samples: PictureSamples::Eight(bitmap.pixels), alpha: None }
}

/// The highest of a row's pictures and its label; a row without pictures is as high as wide.
fn row_height(row: &[Option<Bitmap>], label: &Lines, sheet: &Sheet) -> usize {
    let highest = row.iter().flatten().map(|cell| cell.height).max().unwrap_or(sheet.cell_width);
    highest.max(label.height().ceil() as usize)
}

/// Black or white, whichever stands out.
fn readable_on(background: [u8; 3]) -> Ink {
    let [r, g, b] = background.map(f64::from);
    if 0.2126 * r + 0.7152 * g + 0.0722 * b > 140.0 { Ink::opaque([0x1a; 3]) } else { Ink::opaque([0xf4; 3]) }
}

fn paste(sheet: &mut Bitmap, cell: &Bitmap, x: usize, y: usize) {
    for row in 0..cell.height {
        let to = (y + row) * sheet.width + x;
        sheet.pixels[to..to + cell.width].copy_from_slice(&cell.pixels[row * cell.width..(row + 1) * cell.width]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gradient(width: usize, height: usize) -> Bitmap {
        let pixels =
            (0..width * height).map(|index| [(index % width * 255 / width) as u8, (index / width * 255 / height) as u8, 90]).collect();
        Bitmap { width, height, pixels }
    }

    fn light(bitmap: &Bitmap) -> f64 {
        let sum: f64 = bitmap.pixels.iter().map(|pixel| srgb_decode(f64::from(pixel[0]) / 255.0)).sum();
        sum / bitmap.pixels.len() as f64
    }

    #[test]
    fn shrinking_keeps_the_mean_of_the_light() {
        let picture = gradient(100, 60);
        let small = fitted(picture.clone(), 37);
        assert_eq!((small.width, small.height), (37, 22));
        // Rounding to eight bits: at most half a step of the steepest part of the curve, 2.3 / 255.
        assert!((light(&small) - light(&picture)).abs() < 0.5 * 2.3 / 255.0, "{} {}", light(&small), light(&picture));
        assert_eq!(fitted(Bitmap::filled(31, 17, [12, 200, 255]), 7).pixels, vec![[12, 200, 255]; 28]);
    }

    #[test]
    fn black_and_white_pixels_shrink_to_half_the_light_and_not_half_the_code() {
        let checker = Bitmap { width: 2, height: 2, pixels: vec![[0; 3], [255; 3], [255; 3], [0; 3]] };
        assert_eq!(fitted(checker, 1).pixels, [[188; 3]]);
    }

    #[test]
    fn enlarging_repeats_pixels() {
        let two = Bitmap { width: 2, height: 1, pixels: vec![[1; 3], [2; 3]] };
        assert_eq!(fitted(two, 4).pixels, [[1; 3], [1; 3], [2; 3], [2; 3], [1; 3], [1; 3], [2; 3], [2; 3]]);
    }

    #[test]
    fn transparent_pixels_show_the_background() {
        let picture = Picture { width: 2, height: 1, samples: PictureSamples::Eight(vec![[10, 20, 30]; 2]), alpha: Some(vec![0, 255]) };
        assert_eq!(flattened(&picture, [255; 3]).pixels, [[255; 3], [10, 20, 30]]);
        let deep = Picture { width: 1, height: 1, samples: PictureSamples::Sixteen(vec![[65_535, 0, 257]]), alpha: None };
        assert_eq!(flattened(&deep, [0; 3]).pixels, [[255, 0, 1]]);
    }

    #[test]
    fn every_picture_stands_whole_in_its_cell_and_no_label_reaches_into_it() {
        let color = [200, 30, 40];
        let label = "a very long label that has to be wrapped, with averyverylongwordinit";
        let sheet = Sheet {
            title: label.into(),
            row_labels: vec![label.into(), String::new()],
            column_labels: vec![label.into(), "n = 64".into(), String::new()],
            cells: vec![
                Some(Bitmap::filled(60, 40, color)),
                None,
                Some(Bitmap::filled(60, 30, color)),
                None,
                Some(Bitmap::filled(50, 60, color)),
                None,
            ],
            cell_width: 60,
            gap: 10,
            background: [255; 3],
        };
        let PictureSamples::Eight(pixels) = draw(&sheet).samples else { panic!("eight bits") };
        assert_eq!(pixels.iter().filter(|pixel| **pixel == color).count(), 60 * 40 + 60 * 30 + 50 * 60);
    }

    #[test]
    fn labels_do_not_leave_the_sheet() {
        let label = "extraordinarily-long estimator name";
        let sheet = Sheet {
            title: label.into(),
            row_labels: vec![label.into()],
            column_labels: vec![label.into()],
            cells: vec![None],
            cell_width: 40,
            gap: 6,
            background: [255; 3],
        };
        let picture = draw(&sheet);
        let PictureSamples::Eight(pixels) = &picture.samples else { panic!("eight bits") };
        let is_white = |x: usize, y: usize| pixels[y * picture.width + x] == [255; 3];
        assert!((0..picture.width).all(|x| is_white(x, 0) && is_white(x, picture.height - 1)));
        assert!((0..picture.height).all(|y| is_white(0, y) && is_white(picture.width - 1, y)));
    }
}

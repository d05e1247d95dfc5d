//! A canvas as pixels and as PNG: every edge with its exact coverage of the pixels it crosses.
//!
//! Shapes are lists of contours. Coverage is the signed area under their edges, summed along each row
//! and limited to one, so that overlapping pieces of one stroke count once. Blends in encoded sRGB,
//! as every viewer of SVG and PDF does.

use super::canvas::{Anchor, Canvas, Ink, Label, Mark};
use super::text;
use crate::math::elementary;

/// An 8-bit RGB image, row by row from the top.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Bitmap {
    /// Pixels in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Encoded sRGB.
    pub pixels: Vec<[u8; 3]>,
}

impl Bitmap {
    /// A bitmap of one color.
    pub fn filled(width: usize, height: usize, rgb: [u8; 3]) -> Self {
        Self { width, height, pixels: vec![rgb; width * height] }
    }

    /// Draws a mark whose points are `scale` pixels.
    pub fn draw(&mut self, mark: &Mark, scale: f64) {
        match mark {
            Mark::Stroke { points, width, ink } => self.fill(&stroke_contours(&scaled(points, scale), width * scale), *ink),
            Mark::Area { points, ink } => self.fill(&[scaled(points, scale)], *ink),
            Mark::Disk { center, radius, ink } => self.fill(&[circle(center.map(|c| c * scale), radius * scale)], *ink),
            Mark::Text(label) => self.fill(&text_contours(label, scale), label.ink),
        }
    }

    /// Fills a shape given by its contours in pixels.
    fn fill(&mut self, contours: &[Vec<[f64; 2]>], ink: Ink) {
        let Some(mut coverage) = Coverage::around(contours, self.width, self.height) else { return };
        for contour in contours {
            for (index, &to) in contour.iter().enumerate() {
                coverage.add_edge(contour[(index + contour.len() - 1) % contour.len()], to);
            }
        }
        coverage.for_each(|x, y, covered| {
            let pixel = &mut self.pixels[y * self.width + x];
            let weight = covered * ink.opacity;
            *pixel = [0, 1, 2].map(|k| (f64::from(pixel[k]) * (1.0 - weight) + f64::from(ink.rgb[k]) * weight).round() as u8);
        });
    }
}

/// Signed areas to the right of edges, within a rectangle of pixels.
struct Coverage {
    x0: usize,
    y0: usize,
    width: usize,
    height: usize,
    /// Two more per row than pixels: an edge touches the pixel after its own.
    cells: Vec<f64>,
}

impl Coverage {
    /// Room for these contours, as far as they lie on the image; `None` where they do not.
    fn around(contours: &[Vec<[f64; 2]>], width: usize, height: usize) -> Option<Self> {
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for point in contours.iter().flatten() {
            for k in 0..2 {
                low[k] = low[k].min(point[k]);
                high[k] = high[k].max(point[k]);
            }
        }
        let size = [width, height];
        let first = [0, 1].map(|k| low[k].clamp(0.0, size[k] as f64).floor() as usize);
        let end = [0, 1].map(|k| high[k].clamp(0.0, size[k] as f64).ceil() as usize);
        let [width, height] = [0, 1].map(|k| end[k].saturating_sub(first[k]));
        (width > 0 && height > 0).then(|| Self { x0: first[0], y0: first[1], width, height, cells: vec![0.0; (width + 2) * height] })
    }

    fn add_edge(&mut self, from: [f64; 2], to: [f64; 2]) {
        let (sign, upper, lower) = if from[1] < to[1] { (1.0, from, to) } else { (-1.0, to, from) };
        let [top, bottom] = [upper[1], lower[1]].map(|y| (y - self.y0 as f64).clamp(0.0, self.height as f64));
        if top >= bottom {
            return;
        }
        let slope = (lower[0] - upper[0]) / (lower[1] - upper[1]);
        let (x0, y0) = (self.x0 as f64, self.y0 as f64);
        let x_at = |y: f64| upper[0] + (y + y0 - upper[1]) * slope - x0;
        let limit = self.width as f64;
        for row in top as usize..bottom.ceil() as usize {
            let (upper, lower) = (top.max(row as f64), bottom.min(row as f64 + 1.0));
            let (a, b) = (x_at(upper).clamp(0.0, limit), x_at(lower).clamp(0.0, limit));
            self.add_span(row, a.min(b), a.max(b), sign * (lower - upper));
        }
    }

    /// Spreads an edge that falls by `drop` between `left` and `right` over the cells of a row.
    ///
    /// Each cell gets the growth of the area to the right of the edge from one pixel to the next.
    fn add_span(&mut self, row: usize, left: f64, right: f64, drop: f64) {
        let cells = &mut self.cells[row * (self.width + 2)..(row + 1) * (self.width + 2)];
        let first = left as usize;
        if right <= (first + 1) as f64 {
            let uncovered = (left + right) / 2.0 - first as f64;
            cells[first] += drop * (1.0 - uncovered);
            cells[first + 1] += drop * uncovered;
            return;
        }
        let rate = drop / (right - left);
        let mut before = 0.0;
        for (column, cell) in cells.iter_mut().enumerate().take(right.ceil() as usize).skip(first) {
            // Area in this pixel: what the edge has dropped so far, averaged over the pixel's width.
            let (enter, leave) = (left.max(column as f64), right.min((column + 1) as f64));
            let reached = rate * (enter - left);
            let leaving = rate * (leave - left);
            let area = (reached + leaving) / 2.0 * (leave - enter) + leaving * ((column + 1) as f64 - leave);
            *cell += area - before;
            before = area;
        }
        cells[right.ceil() as usize] += drop - before;
    }

    fn for_each(&self, mut paint: impl FnMut(usize, usize, f64)) {
        for row in 0..self.height {
            let mut sum = 0.0;
            for column in 0..self.width {
                sum += self.cells[row * (self.width + 2) + column];
                let covered = sum.abs().min(1.0);
                if covered > 1e-4 {
                    paint(self.x0 + column, self.y0 + row, covered);
                }
            }
        }
    }
}

fn scaled(points: &[[f64; 2]], scale: f64) -> Vec<[f64; 2]> {
    points.iter().map(|point| point.map(|c| c * scale)).collect()
}

/// A band along each piece of the line and a disk at each corner between, all turning the same way.
fn stroke_contours(points: &[[f64; 2]], width: f64) -> Vec<Vec<[f64; 2]>> {
    let half = width / 2.0;
    let mut contours = Vec::new();
    for (index, ends) in points.windows(2).enumerate() {
        let [a, b] = [ends[0], ends[1]];
        let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
        let length = (dx * dx + dy * dy).sqrt();
        if length > 0.0 {
            let (nx, ny) = (-dy / length * half, dx / length * half);
            contours.push(vec![[a[0] - nx, a[1] - ny], [b[0] - nx, b[1] - ny], [b[0] + nx, b[1] + ny], [a[0] + nx, a[1] + ny]]);
        }
        if index > 0 && width > 1.0 {
            contours.push(circle(a, half));
        }
    }
    contours
}

/// A regular polygon that stands for a circle: its corners miss the circle's area by under a percent.
fn circle(center: [f64; 2], radius: f64) -> Vec<[f64; 2]> {
    let corners = if radius > 4.0 { 48 } else { 16 };
    (0..corners)
        .map(|corner| {
            let (sin, cos) = elementary::sin_cos(2.0 * std::f64::consts::PI * f64::from(corner) / f64::from(corners));
            [center[0] + radius * cos, center[1] + radius * sin]
        })
        .collect()
}

fn text_contours(label: &Label, scale: f64) -> Vec<Vec<[f64; 2]>> {
    let size = label.size;
    let shift = match label.anchor {
        Anchor::Start => 0.0,
        Anchor::Middle => -text::width(&label.text, size) / 2.0,
        Anchor::End => -text::width(&label.text, size),
    };
    let place = |[x, y]: [f64; 2]| {
        let (along, down) = (x * size + shift, y * size);
        let [dx, dy] = if label.is_turned { [down, -along] } else { [along, down] };
        [(label.position[0] + dx) * scale, (label.position[1] + dy) * scale]
    };
    text::contours(&label.text).into_iter().map(|contour| contour.into_iter().map(place).collect()).collect()
}

/// The canvas on white paper at so many pixels an inch.
pub fn render(canvas: &Canvas, dots_per_inch: f64) -> Bitmap {
    let scale = dots_per_inch / 72.0;
    let [width, height] = [canvas.width, canvas.height].map(|length| (length * scale).ceil().max(1.0) as usize);
    let mut bitmap = Bitmap::filled(width, height, [255; 3]);
    for mark in &canvas.marks {
        bitmap.draw(mark, scale);
    }
    bitmap
}

/// A bitmap as PNG, with its resolution and names and texts of where it comes from.
pub fn encode_png(bitmap: &Bitmap, dots_per_inch: f64, metadata: &[(&str, &str)]) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, bitmap.width as u32, bitmap.height as u32);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    let per_meter = (dots_per_inch / 0.0254).round() as u32;
    encoder.set_pixel_dims(Some(png::PixelDimensions { xppu: per_meter, yppu: per_meter, unit: png::Unit::Meter }));
    for (name, value) in metadata {
        // Plain chunks where ISO 8859-1 suffices: more programs show them.
        let added = if value.chars().all(|character| (' '..='~').contains(&character) || ('\u{a1}'..='\u{ff}').contains(&character)) {
            encoder.add_text_chunk((*name).into(), (*value).into())
        } else {
            encoder.add_itxt_chunk((*name).into(), (*value).into())
        };
        added.expect("names of origins are short and plain");
    }
    let written = encoder.write_header().and_then(|mut writer| writer.write_image_data(bitmap.pixels.as_flattened()));
    written.expect("writing to memory cannot fail, and there are as many bytes as the header says");
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    const BLACK: Ink = Ink::opaque([0, 0, 0]);

    fn darkness(bitmap: &Bitmap) -> f64 {
        bitmap.pixels.iter().map(|pixel| 1.0 - f64::from(pixel[0]) / 255.0).sum()
    }

    #[test]
    fn a_shape_darkens_the_paper_by_its_area() {
        let mut bitmap = Bitmap::filled(40, 40, [255; 3]);
        bitmap.fill(&[vec![[3.3, 4.1], [31.7, 9.2], [12.9, 35.5]]], BLACK);
        let exact = ((31.7_f64 - 3.3) * (35.5 - 4.1) - (12.9 - 3.3) * (9.2 - 4.1)).abs() / 2.0;
        // Rounding to 8 bits: at most half a step in each of about 100 pixels of the edge.
        assert!((darkness(&bitmap) - exact).abs() < 100.0 * 0.5 / 255.0, "{} {exact}", darkness(&bitmap));
    }

    #[test]
    fn a_stroke_that_turns_back_on_itself_counts_once() {
        let line = [[5.0, 5.0], [25.0, 5.0], [5.0, 5.0]];
        let mut bitmap = Bitmap::filled(30, 10, [255; 3]);
        bitmap.draw(&Mark::Stroke { points: line.to_vec(), width: 2.0, ink: BLACK }, 1.0);
        let round_end = std::f64::consts::PI / 2.0;
        assert!((darkness(&bitmap) - (40.0 + round_end)).abs() < 0.3, "{}", darkness(&bitmap));
    }

    #[test]
    fn what_lies_outside_the_paper_is_cut_off() {
        let mut bitmap = Bitmap::filled(10, 10, [255; 3]);
        bitmap.fill(&[vec![[-50.0, -50.0], [50.0, -50.0], [50.0, 5.0], [-50.0, 5.0]]], BLACK);
        assert!((darkness(&bitmap) - 50.0).abs() < 1e-9);
        bitmap.fill(&[vec![[20.0, 20.0], [30.0, 20.0], [30.0, 30.0]]], BLACK);
        assert!((darkness(&bitmap) - 50.0).abs() < 1e-9);
    }

    #[test]
    fn letters_have_holes() {
        let mut bitmap = Bitmap::filled(100, 100, [255; 3]);
        let label = Label { text: "O".into(), position: [50.0, 90.0], anchor: Anchor::Middle, size: 100.0, is_turned: false, ink: BLACK };
        bitmap.draw(&Mark::Text(label), 1.0);
        assert_eq!(bitmap.pixels[54 * 100 + 50], [255; 3]);
        assert!(darkness(&bitmap) > 1000.0);
    }
}

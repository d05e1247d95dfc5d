//! Blocks and outlines painted into pixels.
//!
//! Everything is clipped at the borders and painted without blending. Knows nothing of what it marks.

use crate::image::raster::{Image, Picture, PictureSamples, Raster};

/// Pixels x0 <= x < x1, y0 <= y < y1; nothing where an end is not beyond its begin.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Rectangle {
    /// First column.
    pub x0: usize,
    /// First row.
    pub y0: usize,
    /// Column after the last.
    pub x1: usize,
    /// Row after the last.
    pub y1: usize,
}

impl Rectangle {
    /// The `side` x `side` pixels around pixel (x, y); `side` is odd. Not below 0, but perhaps beyond an image's far edges.
    pub fn around(x: usize, y: usize, side: usize) -> Self {
        let reach = side / 2;
        Self { x0: x.saturating_sub(reach), y0: y.saturating_sub(reach), x1: x + reach + 1, y1: y + reach + 1 }
    }

    fn clipped(self, width: usize, height: usize) -> Self {
        let (x1, y1) = (self.x1.min(width), self.y1.min(height));
        Self { x0: self.x0.min(x1), y0: self.y0.min(y1), x1, y1 }
    }
}

/// Something with pixels that can be painted.
pub trait Canvas: Clone {
    /// Width and height.
    fn size(&self) -> (usize, usize);

    /// Paints a rectangle, clipped; `color` in the canvas's own values, for a display from 0 to 1.
    fn fill(&mut self, rectangle: Rectangle, color: [f32; 3]);

    /// Copies a rectangle, clipped, from a canvas of the same size and sort.
    fn copy(&mut self, from: &Self, rectangle: Rectangle);

    /// A black canvas of the same size and sort, opaque where this one is.
    fn blackened(&self) -> Self {
        let mut black = self.clone();
        let (width, height) = self.size();
        black.blacken(Rectangle { x0: 0, y0: 0, x1: width, y1: height });
        black
    }

    /// Makes a rectangle black without a change of its coverage.
    fn blacken(&mut self, rectangle: Rectangle);

    /// Paints the edges of a region `thickness` pixels wide: inside it along the left and the top, and along the
    /// right and the bottom where these are the canvas's own, so that neighbors have one line between them.
    fn outline(&mut self, Rectangle { x0, y0, x1, y1 }: Rectangle, thickness: usize, color: [f32; 3]) {
        let (width, height) = self.size();
        self.fill(Rectangle { x0, y0, x1: x1.min(x0 + thickness), y1 }, color);
        self.fill(Rectangle { x0, y0, x1, y1: y1.min(y0 + thickness) }, color);
        if x1 == width {
            self.fill(Rectangle { x0: x0.max(x1.saturating_sub(thickness)), y0, x1, y1 }, color);
        }
        if y1 == height {
            self.fill(Rectangle { x0, y0: y0.max(y1.saturating_sub(thickness)), x1, y1 }, color);
        }
    }
}

impl Canvas for Raster {
    fn size(&self) -> (usize, usize) {
        (self.width(), self.height())
    }

    fn fill(&mut self, rectangle: Rectangle, color: [f32; 3]) {
        let (width, height) = self.size();
        fill_rows(self.pixels_mut(), width, rectangle.clipped(width, height), color);
    }

    fn copy(&mut self, from: &Self, rectangle: Rectangle) {
        let (width, height) = self.size();
        copy_rows(self.pixels_mut(), from.pixels(), width, rectangle.clipped(width, height));
    }

    fn blacken(&mut self, rectangle: Rectangle) {
        self.fill(rectangle, [0.0; 3]);
    }
}

/// Painting makes pixels opaque; layers stay as they are.
impl Canvas for Image {
    fn size(&self) -> (usize, usize) {
        self.color.size()
    }

    fn fill(&mut self, rectangle: Rectangle, color: [f32; 3]) {
        let (width, height) = self.size();
        self.color.fill(rectangle, color);
        if let Some(alpha) = &mut self.alpha {
            fill_rows(&mut alpha.values, width, rectangle.clipped(width, height), 1.0);
        }
    }

    fn copy(&mut self, from: &Self, rectangle: Rectangle) {
        let (width, height) = self.size();
        self.color.copy(&from.color, rectangle);
        if let (Some(alpha), Some(from)) = (&mut self.alpha, &from.alpha) {
            copy_rows(&mut alpha.values, &from.values, width, rectangle.clipped(width, height));
        }
    }

    fn blacken(&mut self, rectangle: Rectangle) {
        self.color.blacken(rectangle);
    }
}

/// Painting makes pixels opaque; colors are clamped to what a display shows.
impl Canvas for Picture {
    fn size(&self) -> (usize, usize) {
        (self.width, self.height)
    }

    fn fill(&mut self, rectangle: Rectangle, color: [f32; 3]) {
        let rectangle = rectangle.clipped(self.width, self.height);
        let quantized = |largest: f32| color.map(|channel| (channel.clamp(0.0, 1.0) * largest + 0.5) as u16);
        let opaque = match &mut self.samples {
            PictureSamples::Eight(pixels) => {
                fill_rows(pixels, self.width, rectangle, quantized(255.0).map(|channel| channel as u8));
                u16::from(u8::MAX)
            }
            PictureSamples::Sixteen(pixels) => {
                fill_rows(pixels, self.width, rectangle, quantized(65535.0));
                u16::MAX
            }
        };
        if let Some(alpha) = &mut self.alpha {
            fill_rows(alpha, self.width, rectangle, opaque);
        }
    }

    fn copy(&mut self, from: &Self, rectangle: Rectangle) {
        let rectangle = rectangle.clipped(self.width, self.height);
        match (&mut self.samples, &from.samples) {
            (PictureSamples::Eight(pixels), PictureSamples::Eight(from)) => copy_rows(pixels, from, self.width, rectangle),
            (PictureSamples::Sixteen(pixels), PictureSamples::Sixteen(from)) => copy_rows(pixels, from, self.width, rectangle),
            _ => unreachable!("canvases of the same sort have the same number of bits"),
        }
        if let (Some(alpha), Some(from)) = (&mut self.alpha, &from.alpha) {
            copy_rows(alpha, from, self.width, rectangle);
        }
    }

    fn blacken(&mut self, rectangle: Rectangle) {
        let rectangle = rectangle.clipped(self.width, self.height);
        match &mut self.samples {
            PictureSamples::Eight(pixels) => fill_rows(pixels, self.width, rectangle, [0; 3]),
            PictureSamples::Sixteen(pixels) => fill_rows(pixels, self.width, rectangle, [0; 3]),
        }
    }
}

fn fill_rows<T: Copy>(pixels: &mut [T], width: usize, Rectangle { x0, y0, x1, y1 }: Rectangle, value: T) {
    for y in y0..y1 {
        pixels[y * width + x0..y * width + x1].fill(value);
    }
}

fn copy_rows<T: Copy>(pixels: &mut [T], from: &[T], width: usize, Rectangle { x0, y0, x1, y1 }: Rectangle) {
    for y in y0..y1 {
        let row = y * width + x0..y * width + x1;
        pixels[row.clone()].copy_from_slice(&from[row]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::raster::Plane;

    const BLUE: [f32; 3] = [0.0, 0.0, 1.0];

    /// One letter a pixel, `#` where it is blue.
    fn drawn(raster: &Raster) -> Vec<String> {
        let row = |y| raster.row(y).iter().map(|pixel| if *pixel == BLUE { '#' } else { '.' }).collect();
        (0..raster.height()).map(row).collect()
    }

    #[test]
    fn blocks_are_centered_and_clipped_at_the_border() {
        let mut raster = Raster::filled(6, 4, [0.5; 3]);
        raster.fill(Rectangle::around(0, 0, 3), BLUE);
        raster.fill(Rectangle::around(4, 3, 3), BLUE);
        assert_eq!(drawn(&raster), ["##....", "##....", "...###", "...###"]);
        raster.fill(Rectangle::around(2, 2, 255), BLUE);
        assert!(raster.pixels().iter().all(|pixel| *pixel == BLUE));
        raster.fill(Rectangle::around(100, 100, 5), [0.0; 3]);
        assert!(raster.pixels().iter().all(|pixel| *pixel == BLUE));
    }

    #[test]
    fn neighbors_have_one_line_between_them_and_the_canvas_a_frame() {
        let mut raster = Raster::filled(7, 5, [0.0; 3]);
        raster.outline(Rectangle { x0: 0, y0: 0, x1: 3, y1: 5 }, 1, BLUE);
        raster.outline(Rectangle { x0: 3, y0: 0, x1: 7, y1: 5 }, 1, BLUE);
        assert_eq!(drawn(&raster), ["#######", "#..#..#", "#..#..#", "#..#..#", "#######"]);
    }

    #[test]
    fn a_thick_outline_stays_in_its_region() {
        let mut raster = Raster::filled(6, 3, [0.0; 3]);
        raster.outline(Rectangle { x0: 2, y0: 1, x1: 4, y1: 2 }, 9, BLUE);
        assert_eq!(drawn(&raster), ["......", "..##..", "......"]);
    }

    #[test]
    fn pictures_take_colors_with_their_own_number_of_bits_and_become_opaque() {
        let eight = Picture { width: 2, height: 1, samples: PictureSamples::Eight(vec![[9; 3]; 2]), alpha: Some(vec![0; 2]) };
        let mut painted = eight.clone();
        painted.fill(Rectangle::around(0, 0, 1), [0.5, 7.0, -1.0]);
        assert_eq!(painted.samples, PictureSamples::Eight(vec![[128, 255, 0], [9; 3]]));
        assert_eq!(painted.alpha, Some(vec![255, 0]));

        let mut sixteen = Picture { samples: PictureSamples::Sixteen(vec![[9; 3]; 2]), ..eight };
        sixteen.fill(Rectangle::around(1, 0, 1), BLUE);
        assert_eq!(sixteen.samples, PictureSamples::Sixteen(vec![[9; 3], [0, 0, 65535]]));
        assert_eq!(sixteen.alpha, Some(vec![0, 65535]));
    }

    #[test]
    fn windows_are_copied_onto_black() {
        let original = Raster::new(3, 1, vec![[1.0; 3], [2.0; 3], [3.0; 3]]);
        let mut windows = original.blackened();
        windows.copy(&original, Rectangle::around(2, 0, 1));
        assert_eq!(windows.pixels(), [[0.0; 3], [0.0; 3], [3.0; 3]]);

        let alpha = Some(Plane { width: 3, height: 1, values: vec![0.0, 1.0, 0.0] });
        let image = Image { alpha: alpha.clone(), ..Image::opaque(original) };
        assert_eq!(image.blackened().alpha, alpha);
    }
}

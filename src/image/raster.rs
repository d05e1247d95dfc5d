//! The pixel containers that flow through the program. Row 0 is the top row everywhere.
//!
//! `Raster` is linear RGB, `Plane` one number a pixel, `Image` a raster with alpha and named layers, and
//! `Picture` what a display shows. Says nothing of directions; see `light::envmap`.

use std::collections::BTreeMap;

/// Linear RGB in f32, rows from the top, pixels from the left.
#[derive(Debug, Clone, PartialEq)]
pub struct Raster {
    width: usize,
    height: usize,
    pixels: Vec<[f32; 3]>,
}

impl Raster {
    /// Wraps `pixels`, row by row from the top.
    ///
    /// # Panics
    /// If `pixels.len() != width * height`.
    pub fn new(width: usize, height: usize, pixels: Vec<[f32; 3]>) -> Self {
        assert_eq!(pixels.len(), width * height, "a raster has one value per pixel");
        Self { width, height, pixels }
    }

    /// A raster of one color.
    pub fn filled(width: usize, height: usize, color: [f32; 3]) -> Self {
        Self::new(width, height, vec![color; width * height])
    }

    /// Pixels in a row.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// All pixels, row by row from the top.
    pub fn pixels(&self) -> &[[f32; 3]] {
        &self.pixels
    }

    /// All pixels, to change.
    pub fn pixels_mut(&mut self) -> &mut [[f32; 3]] {
        &mut self.pixels
    }

    /// Row `y`, counted from the top.
    pub fn row(&self, y: usize) -> &[[f32; 3]] {
        &self.pixels[y * self.width..(y + 1) * self.width]
    }

    /// The pixel in column `x` of row `y`.
    #[inline]
    pub fn pixel(&self, x: usize, y: usize) -> [f32; 3] {
        self.pixels[y * self.width + x]
    }

    /// Sets the pixel in column `x` of row `y`.
    pub fn set_pixel(&mut self, x: usize, y: usize, color: [f32; 3]) {
        self.pixels[y * self.width + x] = color;
    }
}

/// One f32 a pixel, rows from the top: alpha, depth, an error map.
#[derive(Debug, Clone, PartialEq)]
pub struct Plane {
    /// Pixels in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// `width * height` values, row by row.
    pub values: Vec<f32>,
}

/// A further channel group of an image, as large as the image.
#[derive(Debug, Clone, PartialEq)]
pub enum Layer {
    /// One number a pixel (depth).
    Scalar(Plane),
    /// Three numbers a pixel (variance, albedo, normal, standard error).
    Color(Raster),
}

/// A linear image: color, optional alpha in [0, 1], and named layers of the same size.
///
/// Color is not premultiplied; where alpha is 0 the color is black and means nothing.
#[derive(Debug, Clone, PartialEq)]
pub struct Image {
    /// Linear RGB.
    pub color: Raster,
    /// Coverage; `None` means 1 everywhere.
    pub alpha: Option<Plane>,
    /// Layers by name, in alphabetical order: `albedo`, `depth`, `normal`, `standard_error`, `variance`.
    pub layers: BTreeMap<String, Layer>,
}

impl Image {
    /// An opaque image without further layers.
    pub fn opaque(color: Raster) -> Self {
        Self { color, alpha: None, layers: BTreeMap::new() }
    }

    /// Whether the pixel of that index (row by row) counts: its alpha is not 0.
    pub fn is_covered(&self, index: usize) -> bool {
        self.alpha.as_ref().is_none_or(|alpha| alpha.values[index] > 0.0)
    }
}

/// A display-referred picture: encoded RGB, optional alpha, with 8 or 16 bits a channel.
#[derive(Debug, Clone, PartialEq)]
pub struct Picture {
    /// Pixels in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Encoded RGB, row by row from the top.
    pub samples: PictureSamples,
    /// Coverage with the same number of bits, 0 to the largest value; `None` means opaque.
    pub alpha: Option<Vec<u16>>,
}

/// Encoded color values of a picture.
#[derive(Debug, Clone, PartialEq)]
pub enum PictureSamples {
    /// 0 to 255.
    Eight(Vec<[u8; 3]>),
    /// 0 to 65535.
    Sixteen(Vec<[u16; 3]>),
}

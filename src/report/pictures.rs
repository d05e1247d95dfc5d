//! Of an image: a preview, its statistics, and all its pixels for the viewer.

use std::convert::Infallible;

use serde::Serialize;

use super::packing::{base64, packed_floats};
use crate::formats;
use crate::image::colormap::Colormap;
use crate::image::display;
use crate::image::raster::{Image, Picture, Plane, Raster};
use crate::image::tone::{Exposure, ToneSettings, tone_map};

/// An image made small, and what is to be said of it.
#[derive(Debug, Clone)]
pub struct Preview {
    /// A PNG.
    pub png: Vec<u8>,
    /// Its pixels in a row, and rows.
    pub size: [usize; 2],
    /// Pixels of the image in a row, and rows.
    pub full_size: [usize; 2],
    /// Stops of the exposure in it.
    pub stops: f64,
    /// What was found in all pixels.
    pub statistics: Statistics,
}

/// What is in an image's covered pixels; of the numbers only finite ones count.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Statistics {
    /// Least channel; null where nothing is finite.
    pub min: Option<f32>,
    /// Mean of all channels.
    pub mean: Option<f64>,
    /// Greatest channel.
    pub max: Option<f32>,
    /// Pixels with a channel that is not a number.
    pub nan: u64,
    /// Pixels with an infinite channel.
    pub infinite: u64,
    /// Pixels with a negative channel.
    pub negative: u64,
}

/// Looks at all covered pixels.
pub fn statistics(image: &Image) -> Statistics {
    let (mut min, mut max, mut sum, mut count) = (f32::INFINITY, f32::NEG_INFINITY, 0.0, 0_u64);
    let mut found = Statistics { min: None, mean: None, max: None, nan: 0, infinite: 0, negative: 0 };
    for (_, pixel) in image.color.pixels().iter().enumerate().filter(|(index, _)| image.is_covered(*index)) {
        found.nan += u64::from(pixel.iter().any(|value| value.is_nan()));
        found.infinite += u64::from(pixel.iter().any(|value| value.is_infinite()));
        found.negative += u64::from(pixel.iter().any(|value| *value < 0.0));
        for value in pixel.iter().filter(|value| value.is_finite()) {
            (min, max) = (min.min(*value), max.max(*value));
            sum += f64::from(*value);
            count += 1;
        }
    }
    if count > 0 {
        (found.min, found.mean, found.max) = (Some(min), Some(sum / count as f64), Some(max));
    }
    found
}

/// How previews of a stage are made, so that they can be compared.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Look {
    /// Most pixels in a row.
    pub width: usize,
    /// Stops; `None` to choose them by the image.
    pub stops: Option<f64>,
    /// Whether numbers are shown as colors: the image is an error.
    pub is_error: bool,
}

/// A preview of linear light.
pub fn preview(image: &Image, look: Look) -> Preview {
    let small = reduced(image, look.width);
    let exposure = look.stops.map_or(Exposure::Auto, Exposure::Stops);
    let colormap = look.is_error.then_some(Colormap::Magma);
    let settings = ToneSettings { exposure, colormap, ..ToneSettings::default() };
    let Ok(developed) = tone_map(&small, &settings, || Ok::<_, Infallible>(()));
    made(&developed.picture, developed.exposure_stops, statistics(image), &image.color)
}

/// A preview of a picture, as it is.
pub fn preview_of_picture(picture: &Picture, width: usize) -> Preview {
    let image = display::decoded(picture);
    let (small, _) = display::encoded(&over_black(reduced(&image, width)));
    made(&small, 0.0, statistics(&image), &image.color)
}

fn made(picture: &Picture, stops: f64, statistics: Statistics, full: &Raster) -> Preview {
    let (png, _) = formats::encode_picture(picture, "png", &[]).expect("previews are small");
    Preview { png, size: [picture.width, picture.height], full_size: [full.width(), full.height()], stops, statistics }
}

fn over_black(mut image: Image) -> Image {
    if let Some(alpha) = image.alpha.take() {
        for (pixel, coverage) in image.color.pixels_mut().iter_mut().zip(&alpha.values) {
            *pixel = pixel.map(|value| value * coverage);
        }
    }
    image
}

/// All pixels of linear light: red, green, blue and, where there is coverage, that.
pub fn packed_image(image: &Image) -> String {
    let pixels = image.color.pixels();
    let mut channels: Vec<Vec<f32>> = (0..3).map(|channel| pixels.iter().map(|pixel| pixel[channel]).collect()).collect();
    channels.extend(image.alpha.as_ref().map(|alpha| alpha.values.clone()));
    packed_floats(&channels)
}

/// All pixels of a picture, as a PNG.
pub fn packed_picture(picture: &Picture) -> String {
    formats::encode_picture(picture, "png", &[]).map(|(bytes, _)| base64(&bytes)).unwrap_or_default()
}

/// An image of at most `width` pixels a row: each the mean of the covered pixels in its place.
fn reduced(image: &Image, width: usize) -> Image {
    let (full_width, full_height) = (image.color.width(), image.color.height());
    if full_width <= width {
        return Image { color: image.color.clone(), alpha: image.alpha.clone(), layers: Default::default() };
    }
    let height = (full_height * width).div_ceil(full_width).max(1);
    let span = |index: usize, count: usize, full: usize| index * full / count..((index + 1) * full / count).max(index * full / count + 1);
    let mut colors = Vec::with_capacity(width * height);
    let mut coverages = Vec::with_capacity(width * height);
    for y in 0..height {
        for x in 0..width {
            let (color, coverage) = mean(image, span(x, width, full_width), span(y, height, full_height));
            colors.push(color);
            coverages.push(coverage);
        }
    }
    let alpha = image.alpha.as_ref().map(|_| Plane { width, height, values: coverages });
    Image { color: Raster::new(width, height, colors), alpha, layers: Default::default() }
}

/// Mean color of the covered, finite pixels of a block, and mean coverage.
fn mean(image: &Image, columns: std::ops::Range<usize>, rows: std::ops::Range<usize>) -> ([f32; 3], f32) {
    let (mut sum, mut weights, mut count) = ([0.0_f64; 3], 0.0_f64, 0_u32);
    for y in rows {
        for x in columns.clone() {
            let coverage = image.alpha.as_ref().map_or(1.0, |alpha| f64::from(alpha.values[y * alpha.width + x]));
            let pixel = image.color.pixel(x, y);
            count += 1;
            if coverage > 0.0 && pixel.iter().all(|value| value.is_finite()) {
                weights += coverage;
                (0..3).for_each(|channel| sum[channel] += coverage * f64::from(pixel[channel]));
            }
        }
    }
    let color = if weights > 0.0 { sum.map(|value| (value / weights) as f32) } else { [0.0; 3] };
    (color, (weights / f64::from(count.max(1))) as f32)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn statistics_count_what_light_cannot_be_and_leave_it_out() {
        let pixels = vec![[1.0, 2.0, 3.0], [f32::NAN, -1.0, 0.0], [f32::INFINITY, 0.0, 0.0], [9.0; 3]];
        let mut image = Image::opaque(Raster::new(4, 1, pixels));
        image.alpha = Some(Plane { width: 4, height: 1, values: vec![1.0, 1.0, 0.5, 0.0] });
        let found = statistics(&image);
        assert_eq!((found.nan, found.infinite, found.negative), (1, 1, 1));
        assert_eq!((found.min, found.max, found.mean), (Some(-1.0), Some(3.0), Some(5.0 / 7.0)));
        assert_eq!(statistics(&Image::opaque(Raster::filled(1, 1, [f32::NAN; 3]))).mean, None);
    }

    #[test]
    fn a_reduced_image_keeps_the_mean_of_what_is_covered() {
        let mut image = Image::opaque(Raster::new(4, 2, (0..8).map(|index| [index as f32; 3]).collect()));
        let small = reduced(&image, 2);
        assert_eq!(small.color.pixels(), [[2.5; 3], [4.5; 3]]);
        image.alpha = Some(Plane { width: 4, height: 2, values: vec![1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0] });
        let small = reduced(&image, 2);
        assert_eq!((small.color.pixel(0, 0), small.alpha.unwrap().values), ([0.0; 3], vec![0.25, 0.0]));
    }

    #[test]
    fn previews_of_a_stage_share_an_exposure() {
        let image = |value| Image::opaque(Raster::filled(8, 4, [value; 3]));
        let look = Look { width: 4, stops: None, is_error: false };
        let first = preview(&image(4.0), look);
        assert_eq!((first.stops, first.size, first.full_size), (-2.0, [4, 2], [8, 4]));
        let second = preview(&image(8.0), Look { stops: Some(first.stops), ..look });
        assert_eq!(second.stops, -2.0);
    }
}

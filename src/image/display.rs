//! Between linear light and pictures for a display, by the sRGB curve.
//!
//! Serves formats and tools that need the other sort of pixels. Tone curves are `tone`; here values are clipped.
//!
//! After IEC 61966-2-1 (1999).

use rayon::prelude::*;

use crate::image::color;
use crate::image::raster::{Image, Picture, PictureSamples, Plane, Raster};

/// The picture of linear light with 8 bits a channel: clipped to [0, 1], sRGB-encoded, rounded; with a warning if
/// pixels were clipped. NaN becomes 0.
pub fn encoded(image: &Image) -> (Picture, Vec<String>) {
    let color = &image.color;
    let samples: Vec<[u8; 3]> = color.pixels().par_iter().map(|pixel| pixel.map(|value| quantized(value, 255.0) as u8)).collect();
    let alpha = image.alpha.as_ref();
    let alpha = alpha.map(|plane| plane.values.iter().map(|value| (f64::from(value.clamp(0.0, 1.0)) * 255.0).round() as u16).collect());

    let is_outside = |pixel: &&[f32; 3]| pixel.iter().any(|value| !(0.0..=1.0).contains(value));
    let count = color.pixels().par_iter().filter(is_outside).count();
    let share = 100.0 * count as f64 / color.pixels().len().max(1) as f64;
    let warning = (count > 0)
        .then(|| format!("{count} pixels ({share:.2} %) have values outside [0, 1] and were clipped: use `tone-map` to choose how"));
    let picture = Picture { width: color.width(), height: color.height(), samples: PictureSamples::Eight(samples), alpha };
    (picture, warning.into_iter().collect())
}

/// The linear light that a display shows for a picture, by the sRGB curve; alpha becomes a plane.
pub fn decoded(picture: &Picture) -> Image {
    let (pixels, largest) = match &picture.samples {
        PictureSamples::Eight(samples) => (linear(samples, 255), 255.0),
        PictureSamples::Sixteen(samples) => (linear(samples, 65_535), 65_535.0),
    };
    let mut image = Image::opaque(Raster::new(picture.width, picture.height, pixels));
    image.alpha = picture.alpha.as_ref().map(|alpha| Plane {
        width: picture.width,
        height: picture.height,
        values: alpha.iter().map(|value| (f64::from(*value) / largest) as f32).collect(),
    });
    image
}

/// The values of a picture from 0 to 1 as they stand, without a curve: for normals, roughness and other data.
pub fn undecoded(picture: &Picture) -> Raster {
    let pixels = match &picture.samples {
        PictureSamples::Eight(samples) => samples.par_iter().map(|pixel| pixel.map(|code| f32::from(code) / 255.0)).collect(),
        PictureSamples::Sixteen(samples) => samples.par_iter().map(|pixel| pixel.map(|code| f32::from(code) / 65_535.0)).collect(),
    };
    Raster::new(picture.width, picture.height, pixels)
}

/// sRGB-encoded value times `largest`, to the nearest; linear 0 to 1 is the range.
fn quantized(value: f32, largest: f64) -> u16 {
    // A NaN is not above zero either.
    let value = if value > 0.0 { f64::from(value).min(1.0) } else { 0.0 };
    (color::srgb_encode(value) * largest + 0.5) as u16
}

fn linear<T: Copy + Into<u16> + Sync>(samples: &[[T; 3]], largest: u16) -> Vec<[f32; 3]> {
    let table: Vec<f32> = (0..=largest).map(|code| color::srgb_decode(f64::from(code) / f64::from(largest)) as f32).collect();
    samples.par_iter().map(|pixel| pixel.map(|code| table[usize::from(code.into())])).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn published_values_of_the_curve_are_met() {
        // The middle grey of 18 % is 118 of 255 in sRGB.
        assert_eq!(quantized(0.18, 255.0), 118);
        assert_eq!((quantized(f32::NAN, 255.0), quantized(-1.0, 255.0), quantized(f32::INFINITY, 255.0)), (0, 0, 255));
    }

    #[test]
    fn every_code_survives_light_and_back() {
        let samples: Vec<[u8; 3]> = (0..=255).map(|code| [code; 3]).collect();
        let picture = Picture { width: 256, height: 1, samples: PictureSamples::Eight(samples), alpha: None };
        let (again, warnings) = encoded(&decoded(&picture));
        assert_eq!(again, picture);
        assert!(warnings.is_empty());
    }

    #[test]
    fn clipped_pixels_are_counted() {
        let pixels = vec![[0.5, 0.5, 1.5], [-0.1, 0.0, 0.0], [1.0, 0.0, 0.0], [f32::NAN, 0.0, 0.0]];
        let (_, warnings) = encoded(&Image::opaque(Raster::new(4, 1, pixels)));
        assert!(warnings[0].starts_with("3 pixels (75.00 %)"), "{warnings:?}");
    }
}

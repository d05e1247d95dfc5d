//! What `pipeline info` shows and `pipeline convert` does: one file, no pipeline.
//!
//! Pure functions over bytes, of the same code as `load` and `save`.

use serde::Serialize;

use crate::formats::{self, Content, Encoded, FormatError, Limits};
use crate::image::raster::{Image, Layer, PictureSamples, Raster};
use crate::light::envmap;

/// What an image file holds.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Info {
    /// Name of the format: `pfm`, `exr`, …
    pub format: &'static str,
    /// Pixels in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Whether there is alpha.
    pub has_alpha: bool,
    /// Names of the layers beside the color.
    pub layers: Vec<String>,
    /// What the header says, name and value.
    pub facts: Vec<(String, String)>,
    /// What is odd about the file.
    pub warnings: Vec<String>,
    /// Where the file says it comes from, name and text.
    pub origin: Vec<(String, String)>,
    /// What its pixels are; of linear light, or of codes where it is a picture.
    pub pixels: PixelStatistics,
}

/// Sums and extremes over all pixels; non-finite values are left out of them.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PixelStatistics {
    /// What a value is: `linear`, `8 bit` or `16 bit`.
    pub values: &'static str,
    /// Smallest value of each channel.
    pub min_rgb: [f64; 3],
    /// Largest value of each channel.
    pub max_rgb: [f64; 3],
    /// Mean of each channel.
    pub mean_rgb: [f64; 3],
    /// Mean of (R + G + B) / 3.
    pub mean_intensity: f64,
    /// Integral over the sphere of each channel, for a picture twice as wide as high read as a lat-long map, in the
    /// values' unit times steradians; sums are by the exact solid angle of each pixel.
    pub integral_rgb: Option<[f64; 3]>,
    /// Column and row of the pixel with the largest R + G + B, the first of equals.
    pub brightest: (usize, usize),
    /// Pixels whose three channels are 0.
    pub zero_count: u64,
    /// Pixels with a value below 0.
    pub negative_count: u64,
    /// Pixels with a NaN or an infinity.
    pub non_finite_count: u64,
}

/// What there is to say of a file's bytes; `name` is used in messages.
pub fn info(bytes: &[u8], name: &str, limits: &Limits) -> Result<Info, FormatError> {
    let decoded = formats::read(bytes, name, limits)?;
    let (width, height) = decoded.size();
    let (pixels, has_alpha, layers) = match &decoded.content {
        Content::Linear(image) => {
            (statistics(&image.color, "linear"), image.alpha.is_some(), image.layers.iter().map(layer_text).collect())
        }
        Content::Display(picture) => {
            let (values, pixels): (_, Vec<[f32; 3]>) = match &picture.samples {
                PictureSamples::Eight(samples) => ("8 bit", samples.iter().map(|pixel| pixel.map(f32::from)).collect()),
                PictureSamples::Sixteen(samples) => ("16 bit", samples.iter().map(|pixel| pixel.map(f32::from)).collect()),
            };
            (statistics(&Raster::new(width, height, pixels), values), picture.alpha.is_some(), Vec::new())
        }
    };
    let origin = formats::origin(bytes);
    Ok(Info { format: decoded.format, width, height, has_alpha, layers, facts: decoded.facts, warnings: decoded.warnings, origin, pixels })
}

/// The bytes of a file in the format that the extension of `output_name` promises.
///
/// Linear light becomes a picture by clipping and the sRGB curve, a picture linear light by the inverse curve; each
/// with a warning.
pub fn convert(bytes: &[u8], input_name: &str, output_name: &str, limits: &Limits) -> Result<Encoded, FormatError> {
    let extension = output_name.rsplit_once('.').map_or("", |(_, extension)| extension);
    let Some(format) = formats::by_extension(extension) else {
        let names: Vec<_> = formats::FORMATS.iter().map(|format| format.name).collect();
        let name = formats::escaped(output_name);
        return Err(FormatError::Unwritable(format!("`{name}` names no image format: end it in one of .{}", names.join(", ."))));
    };
    let decoded = formats::read(bytes, input_name, limits)?;
    let mut warnings = decoded.warnings;
    let (bytes, more) = match (decoded.content, format.write_picture) {
        (Content::Linear(image), _) => (format.write)(&image, &[])?,
        (Content::Display(picture), Some(write)) => write(&picture, &[])?,
        (Content::Display(picture), None) => {
            warnings.push("a picture for displays was made linear by the sRGB curve".into());
            let image: Image = formats::display::decoded(&picture);
            (format.write)(&image, &[])?
        }
    };
    warnings.extend(more);
    Ok((bytes, warnings))
}

fn layer_text((name, layer): (&String, &Layer)) -> String {
    let kind = match layer {
        Layer::Scalar(_) => "scalar",
        Layer::Color(_) => "color",
    };
    format!("{} ({kind})", formats::escaped(name))
}

fn statistics(raster: &Raster, values: &'static str) -> PixelStatistics {
    let survey = formats::survey(raster);
    let count = raster.pixels().len() as f64;
    let (mut min_rgb, mut max_rgb) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    let (mut total, mut integral) = ([0.0; 3], [0.0; 3]);
    let (mut brightest, mut most) = ((0, 0), f64::NEG_INFINITY);
    for y in 0..raster.height() {
        let mut row_total = [0.0; 3];
        for (x, pixel) in raster.row(y).iter().enumerate() {
            let pixel = pixel.map(f64::from);
            for channel in (0..3).filter(|channel| pixel[*channel].is_finite()) {
                min_rgb[channel] = min_rgb[channel].min(pixel[channel]);
                max_rgb[channel] = max_rgb[channel].max(pixel[channel]);
                row_total[channel] += pixel[channel];
            }
            let sum = pixel.iter().sum::<f64>();
            if sum.is_finite() && sum > most {
                (brightest, most) = ((x, y), sum);
            }
        }
        let solid_angle = envmap::solid_angle_of_pixel(y, raster.width(), raster.height());
        for channel in 0..3 {
            total[channel] += row_total[channel];
            integral[channel] += row_total[channel] * solid_angle;
        }
    }
    let mean_rgb = total.map(|sum| sum / count);
    PixelStatistics {
        values,
        min_rgb,
        max_rgb,
        mean_rgb,
        mean_intensity: mean_rgb.iter().sum::<f64>() / 3.0,
        integral_rgb: (raster.width() == 2 * raster.height()).then_some(integral),
        brightest,
        zero_count: raster.pixels().iter().filter(|pixel| **pixel == [0.0; 3]).count() as u64,
        negative_count: survey.negative.map_or(0, |found| found.count),
        non_finite_count: survey.non_finite.map_or(0, |found| found.count),
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use super::*;

    #[test]
    fn a_constant_map_integrates_to_the_whole_sphere() {
        let bytes = formats::encode(&Image::opaque(Raster::filled(32, 16, [1.0, 2.0, 0.0])), "exr", &[("stage", "sky")]).unwrap().0;
        let info = info(&bytes, "sky.exr", &Limits::default()).unwrap();
        let integral = info.pixels.integral_rgb.unwrap();
        assert!((integral[0] - 4.0 * PI).abs() < 1e-12 && (integral[1] - 8.0 * PI).abs() < 1e-12);
        assert_eq!((info.pixels.mean_intensity, info.pixels.brightest), (1.0, (0, 0)));
        assert_eq!(info.origin, [("stage".to_owned(), "sky".to_owned())]);
    }

    #[test]
    fn converting_there_and_back_keeps_what_both_formats_hold() {
        let image = Image::opaque(Raster::new(2, 1, vec![[0.0, 0.5, 1.0], [1.0, 0.25, 0.0]]));
        let pfm = formats::encode(&image, "pfm", &[]).unwrap().0;
        let limits = Limits::default();
        for name in ["a.exr", "a.hdr", "a.npy"] {
            let (bytes, warnings) = convert(&pfm, "a.pfm", name, &limits).unwrap();
            assert_eq!(warnings, [""; 0]);
            assert_eq!(convert(&bytes, name, "b.PFM", &limits).unwrap().0, pfm, "{name}");
        }
        let (png, _) = convert(&pfm, "a.pfm", "a.png", &limits).unwrap();
        let (ppm, _) = convert(&png, "a.png", "a.ppm", &limits).unwrap();
        assert_eq!(convert(&ppm, "a.ppm", "c.png", &limits).unwrap().0, png);
        assert!(convert(&ppm, "a.ppm", "c.exr", &limits).unwrap().1[0].contains("sRGB"));
        assert!(convert(&ppm, "a.ppm", "c.gif", &limits).unwrap_err().to_string().contains(".pfm"));
    }
}

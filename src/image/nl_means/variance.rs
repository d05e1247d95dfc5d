//! The variance of a pixel's value: as an image carries it, or from two independent images of the same.
//!
//! What is right in the mean (replicates, differences of two images) rests on few numbers a pixel and is very noisy itself;
//! what is steady (the spread of a pixel's samples) is wrong by a factor where the samples are spread evenly. So the steady one
//! gives the pattern and the right one, pooled over a square, its scale: Rousselle et al. (2012), section 5.

use rayon::prelude::*;

use super::mean_of_two;
use crate::image::average::{SAMPLE_VARIANCE, STANDARD_ERROR, VARIANCE};
use crate::image::raster::{Image, Layer, Raster};

/// Half of the side of the square in which noise is pooled.
const POOL_RADIUS: usize = 5;

/// The variance of each channel of each pixel as the image's layers tell it; nothing if they do not.
pub fn of_one(image: &Image) -> Option<Raster> {
    let unbiased = of_mean(image)?;
    Some(match layer(image, SAMPLE_VARIANCE) {
        Some(pattern) => scaled(pattern, &unbiased),
        None => unbiased,
    })
}

/// The variance of each channel of a pixel of either of two independent images of the same.
pub fn of_two(a: &Image, b: &Image) -> Raster {
    let pixels = a.color.pixels().iter().zip(b.color.pixels());
    let halves = pixels.map(|(a, b)| std::array::from_fn(|c| 0.5 * (a[c] - b[c]) * (a[c] - b[c])));
    let unbiased = Raster::new(a.color.width(), a.color.height(), halves.collect());
    let pattern = |image: &Image| layer(image, SAMPLE_VARIANCE).cloned().or_else(|| of_mean(image));
    match pattern(a).zip(pattern(b)) {
        Some((a, b)) => scaled(&mean_of_two(&a, &b), &unbiased),
        None => box_mean(&unbiased, POOL_RADIUS),
    }
}

/// The square of the layer `standard_error`, which is that of the mean wherever it was made here, or else the layer `variance`.
fn of_mean(image: &Image) -> Option<Raster> {
    let Some(error) = layer(image, STANDARD_ERROR) else { return layer(image, VARIANCE).cloned() };
    let squares = error.pixels().iter().map(|pixel| pixel.map(|value| value * value)).collect();
    Some(Raster::new(error.width(), error.height(), squares))
}

/// A layer of three channels.
fn layer<'a>(image: &'a Image, name: &str) -> Option<&'a Raster> {
    match image.layers.get(name)? {
        Layer::Color(raster) => Some(raster),
        Layer::Scalar(_) => None,
    }
}

/// `pattern` times the ratio of both pooled; where the pattern knows of no noise at all, what is pooled.
fn scaled(pattern: &Raster, unbiased: &Raster) -> Raster {
    let (of_pattern, of_unbiased) = (box_mean(pattern, POOL_RADIUS), box_mean(unbiased, POOL_RADIUS));
    let pixels = pattern.pixels().iter().zip(of_pattern.pixels()).zip(of_unbiased.pixels()).map(|((own, mean), right_mean)| {
        std::array::from_fn(|c| if mean[c] > 0.0 { own[c] * (right_mean[c] / mean[c]) } else { right_mean[c] })
    });
    Raster::new(pattern.width(), pattern.height(), pixels.collect())
}

/// Variances raised to at least the mean of the 3 x 3 around each, so that pixels whose few samples agree by chance are
/// not taken for certain.
pub fn raised(variance: &Raster) -> Raster {
    let mean = box_mean(variance, 1);
    let pixels = variance.pixels().iter().zip(mean.pixels()).map(|(own, mean)| std::array::from_fn(|c| own[c].max(mean[c])));
    Raster::new(variance.width(), variance.height(), pixels.collect())
}

/// Means over squares of 2 `radius` + 1 pixels, of those that exist; sums in f64, row by row.
fn box_mean(raster: &Raster, radius: usize) -> Raster {
    let (width, height) = (raster.width(), raster.height());
    let along = |row: &[[f32; 3]]| -> Vec<[f64; 3]> {
        let around = |x: usize| &row[x.saturating_sub(radius)..(x + radius + 1).min(width)];
        let sum = |pixels: &[[f32; 3]]| std::array::from_fn(|c| pixels.iter().map(|pixel| f64::from(pixel[c])).sum::<f64>());
        (0..width).map(|x| sum(around(x)).map(|sum| sum / around(x).len() as f64)).collect()
    };
    let rows: Vec<Vec<[f64; 3]>> = (0..height).into_par_iter().map(|y| along(raster.row(y))).collect();
    let pixels = (0..height).into_par_iter().flat_map_iter(|y| {
        let around = &rows[y.saturating_sub(radius)..(y + radius + 1).min(height)];
        (0..width).map(move |x| std::array::from_fn(|c| (around.iter().map(|row| row[x][c]).sum::<f64>() / around.len() as f64) as f32))
    });
    Raster::new(width, height, pixels.collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn means_over_squares_are_of_what_exists() {
        let raster = Raster::new(3, 2, (0..6_u8).map(|i| [f32::from(i); 3]).collect());
        let mean = box_mean(&raster, 1);
        assert_eq!(mean.pixel(0, 0)[0], (0.0 + 1.0 + 3.0 + 4.0) / 4.0);
        assert_eq!(mean.pixel(1, 1)[2], 15.0 / 6.0);
    }

    fn image(color: f32, layers: &[(&str, Raster)]) -> Image {
        let layers = layers.iter().map(|(name, raster)| (name.to_string(), Layer::Color(raster.clone()))).collect();
        Image { layers, ..Image::opaque(Raster::filled(20, 20, [color; 3])) }
    }

    #[test]
    fn the_standard_error_is_asked_before_the_variance() {
        let flat = |value| Raster::filled(20, 20, [value; 3]);
        assert_eq!(of_one(&image(0.0, &[(VARIANCE, flat(5.0))])).unwrap(), flat(5.0));
        assert_eq!(of_one(&image(0.0, &[(VARIANCE, flat(5.0)), (STANDARD_ERROR, flat(3.0))])).unwrap(), flat(9.0));
        assert!(of_one(&image(0.0, &[])).is_none());
    }

    #[test]
    fn a_pattern_that_is_wrong_by_a_factor_is_scaled_right() {
        let pattern = Raster::new(20, 20, (0..400).map(|i| [if i % 2 == 0 { 10.0 } else { 30.0 }; 3]).collect());
        let carried = image(1.0, &[(VARIANCE, Raster::filled(20, 20, [2.0; 3])), (SAMPLE_VARIANCE, pattern.clone())]);
        // Half of (3 - 1)² is 2; eleven columns hold five or six of each sort, so pooled means are 230 or 210 over 11.
        let two = of_two(&carried, &image(3.0, &[(SAMPLE_VARIANCE, pattern)]));
        for found in [of_one(&carried).unwrap(), two] {
            let (first, second) = (found.pixel(8, 8)[0], found.pixel(9, 8)[0]);
            assert!((first - 2.0 * 10.0 / (230.0 / 11.0)).abs() < 1e-5, "{first}");
            assert!((second - 2.0 * 30.0 / (210.0 / 11.0)).abs() < 1e-5, "{second}");
        }
        assert_eq!(of_two(&image(1.0, &[]), &image(3.0, &[])).pixel(3, 3), [2.0; 3]);
    }
}

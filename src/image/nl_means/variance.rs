//! The variance of a pixel's value: as images carry it, or from two independent images of the same.

use rayon::prelude::*;

use crate::image::average::{STANDARD_ERROR, VARIANCE};
use crate::image::raster::{Image, Layer, Raster};

/// Half of the side of the square in which the noise of two images is pooled.
const POOL_RADIUS: usize = 5;

/// The variance of each channel of each pixel as the image carries it: the square of its layer `standard_error`, which is that of
/// the mean wherever it was made here, or else its layer `variance`. Nothing if it has neither with three channels.
pub fn of_mean(image: &Image) -> Option<Raster> {
    match (image.layers.get(STANDARD_ERROR), image.layers.get(VARIANCE)) {
        (Some(Layer::Color(error)), _) => {
            let squares = error.pixels().iter().map(|pixel| pixel.map(|value| value * value)).collect();
            Some(Raster::new(error.width(), error.height(), squares))
        }
        (_, Some(Layer::Color(variance))) => Some(variance.clone()),
        _ => None,
    }
}

/// The variance of a pixel of either of two independent images of the same: half of their squared difference.
///
/// Right in the mean, but of one difference each, so it is pooled over 11 x 11 pixels. Where both images carry a variance
/// (`carried`, their mean), that is kept and only scaled by the ratio of both pooled: Rousselle et al. (2012), section 5. It is wrong by
/// a factor for points that are spread evenly, but knows single pixels.
pub fn of_two(a: &Raster, b: &Raster, carried: Option<&Raster>) -> Raster {
    let halves = a.pixels().iter().zip(b.pixels()).map(|(a, b)| std::array::from_fn(|c| 0.5 * (a[c] - b[c]) * (a[c] - b[c])));
    let pooled = box_mean(&Raster::new(a.width(), a.height(), halves.collect()), POOL_RADIUS);
    let Some(carried) = carried else { return pooled };
    let pooled_carried = box_mean(carried, POOL_RADIUS);
    let scaled = pooled.pixels().iter().zip(pooled_carried.pixels()).zip(carried.pixels()).map(|((true_mean, mean), own)| {
        std::array::from_fn(|c| if mean[c] > 0.0 { own[c] * (true_mean[c] / mean[c]) } else { true_mean[c] })
    });
    Raster::new(a.width(), a.height(), scaled.collect())
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
    use std::collections::BTreeMap;

    use super::*;

    #[test]
    fn means_over_squares_are_of_what_exists() {
        let raster = Raster::new(3, 2, (0..6_u8).map(|i| [f32::from(i); 3]).collect());
        let mean = box_mean(&raster, 1);
        assert_eq!(mean.pixel(0, 0)[0], (0.0 + 1.0 + 3.0 + 4.0) / 4.0);
        assert_eq!(mean.pixel(1, 1)[2], 15.0 / 6.0);
    }

    #[test]
    fn the_standard_error_is_asked_first() {
        let layer = |value| Layer::Color(Raster::filled(1, 1, [value; 3]));
        let mut image =
            Image { layers: BTreeMap::from([(VARIANCE.to_string(), layer(5.0))]), ..Image::opaque(Raster::filled(1, 1, [0.0; 3])) };
        assert_eq!(of_mean(&image).unwrap().pixel(0, 0), [5.0; 3]);
        image.layers.insert(STANDARD_ERROR.into(), layer(3.0));
        assert_eq!(of_mean(&image).unwrap().pixel(0, 0), [9.0; 3]);
        assert!(of_mean(&Image::opaque(Raster::filled(1, 1, [0.0; 3]))).is_none());
    }

    #[test]
    fn a_carried_variance_that_is_wrong_by_a_factor_is_scaled_right() {
        let a = Raster::filled(20, 20, [1.0; 3]);
        let b = Raster::filled(20, 20, [3.0; 3]);
        let carried = Raster::new(20, 20, (0..400).map(|i| [if i % 2 == 0 { 10.0 } else { 30.0 }; 3]).collect());
        let found = of_two(&a, &b, Some(&carried));
        // Half of (3 - 1)² is 2; eleven columns hold five or six of each sort, so pooled means are 230 or 210 over 11.
        let (first, second) = (found.pixel(8, 8)[0], found.pixel(9, 8)[0]);
        assert!(
            (first - 2.0 * 10.0 / (230.0 / 11.0)).abs() < 1e-5 && (second - 2.0 * 30.0 / (210.0 / 11.0)).abs() < 1e-5,
            "{first} {second}"
        );
        assert_eq!(of_two(&a, &b, None).pixel(3, 3), [2.0; 3]);
    }
}

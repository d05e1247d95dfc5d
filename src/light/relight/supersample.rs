//! Pixels as averages of points, for comparing with what a box filter gives.

use crate::image::raster::{Image, Plane, Raster};

/// Averages squares of `factor` x `factor` points: color over those that are covered, alpha over all.
///
/// The sides of `image` are multiples of `factor`; layers are left out.
pub fn averaged(image: Image, factor: usize) -> Image {
    if factor <= 1 {
        return image;
    }
    let (width, height) = (image.color.width() / factor, image.color.height() / factor);
    let mut pixels = Vec::with_capacity(width * height);
    let mut alpha = Vec::with_capacity(width * height);
    for place in 0..width * height {
        let (x, y) = (place % width * factor, place / width * factor);
        let (mut sum, mut covered) = ([0.0_f64; 3], 0.0_f64);
        for row in y..y + factor {
            for column in x..x + factor {
                let index = row * width * factor + column;
                let weight = image.alpha.as_ref().map_or(1.0, |alpha| f64::from(alpha.values[index]));
                let color = image.color.pixels()[index];
                (0..3).for_each(|k| sum[k] += weight * f64::from(color[k]));
                covered += weight;
            }
        }
        pixels.push(sum.map(|channel| if covered > 0.0 { (channel / covered) as f32 } else { 0.0 }));
        alpha.push((covered / (factor * factor) as f64) as f32);
    }
    let alpha = image.alpha.is_some().then_some(Plane { width, height, values: alpha });
    Image { alpha, ..Image::opaque(Raster::new(width, height, pixels)) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colors_are_means_of_what_is_covered_and_alpha_of_all() {
        let pixels = vec![[4.0, 1.0, 0.0], [0.0; 3], [2.0, 1.0, 0.0], [0.0; 3]];
        let alpha = Plane { width: 2, height: 2, values: vec![1.0, 0.0, 1.0, 0.0] };
        let image = Image { alpha: Some(alpha), ..Image::opaque(Raster::new(2, 2, pixels)) };
        let averaged = averaged(image, 2);
        assert_eq!(averaged.color.pixels(), [[3.0, 1.0, 0.0]]);
        assert_eq!(averaged.alpha.unwrap().values, [0.5]);
    }

    #[test]
    fn one_point_a_pixel_is_the_picture_itself() {
        let image = Image::opaque(Raster::filled(3, 3, [0.5; 3]));
        assert_eq!(averaged(image.clone(), 1), image);
    }
}

//! The sphere as a camera sees it: which pixels it covers, and the normal at each.
//!
//! Orthographic along -z, +x to the right, +y up, the sphere touching the picture's edges. Pixel (i, j) of
//! S x S is the point x = 2 (i + 1/2) / S - 1, y = 1 - 2 (j + 1/2) / S; it shows the sphere where
//! x^2 + y^2 < 1, with normal (x, y, sqrt(1 - x^2 - y^2)). Knows nothing of light.

use std::collections::BTreeMap;

use glam::DVec3;
use rayon::prelude::*;

use crate::image::raster::{Image, Plane, Raster};

/// The covered pixels of one row of the picture.
#[derive(Debug, Clone)]
pub struct Scanline {
    /// Row, from the top.
    pub row: usize,
    /// First covered column.
    pub first: usize,
    /// The normals, from the left; all have the same y.
    pub normals: Vec<DVec3>,
}

impl Scanline {
    /// The covered pixels of row `row` of a picture of `size` x `size`.
    pub fn new(size: usize, row: usize) -> Self {
        let first = (0..size).find(|column| normal_at(size, *column, row).is_some()).unwrap_or(size);
        let normals = (first..size).map_while(|column| normal_at(size, column, row)).collect();
        Self { row, first, normals }
    }
}

/// The normal that pixel (`column`, `row`) shows, if it shows the sphere.
pub fn normal_at(size: usize, column: usize, row: usize) -> Option<DVec3> {
    let x = 2.0 * (column as f64 + 0.5) / size as f64 - 1.0;
    let y = 1.0 - 2.0 * (row as f64 + 0.5) / size as f64;
    let inside = x * x + y * y;
    (inside < 1.0).then(|| DVec3::new(x, y, (1.0 - inside).sqrt()))
}

/// Makes a picture row by row; `colors` gives one RGB for each normal of a scanline.
///
/// Alpha is 1 where the center of the pixel shows the sphere, else 0 (and the color black).
///
/// # Errors
/// What `colors` gives, for the first such row.
pub fn picture<E: Send>(size: usize, colors: impl Fn(&Scanline) -> Result<Vec<[f64; 3]>, E> + Sync) -> Result<Image, E> {
    let mut pixels = vec![[0.0f32; 3]; size * size];
    let mut alpha = vec![0.0f32; size * size];
    let rows = pixels.par_chunks_mut(size).zip(alpha.par_chunks_mut(size));
    rows.enumerate().try_for_each(|(row, (pixels, alpha))| {
        let line = Scanline::new(size, row);
        let covered = line.first..line.first + line.normals.len();
        for (pixel, color) in pixels[covered.clone()].iter_mut().zip(colors(&line)?) {
            *pixel = color.map(|channel| channel as f32);
        }
        alpha[covered].fill(1.0);
        Ok(())
    })?;
    Ok(image(size, pixels, alpha))
}

/// An image of these colors and this coverage, without further layers.
pub fn image(size: usize, pixels: Vec<[f32; 3]>, alpha: Vec<f32>) -> Image {
    let alpha = Plane { width: size, height: size, values: alpha };
    Image { color: Raster::new(size, size, pixels), alpha: Some(alpha), layers: BTreeMap::new() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn normals_are_unit_and_look_at_the_camera() {
        assert_eq!(normal_at(1, 0, 0), Some(DVec3::Z));
        for (column, row) in [(0, 255), (255, 0), (300, 40), (511 / 2, 511 / 2)] {
            let normal = normal_at(511, column, row).unwrap();
            assert!((normal.length() - 1.0).abs() < 1e-15 && normal.z > 0.0, "{normal}");
        }
        let top = normal_at(511, 255, 0).unwrap();
        assert!(top.y > 0.99 && top.x == 0.0, "up is +y: {top}");
        assert!(normal_at(511, 510, 255).unwrap().x > 0.99, "right is +x");
        assert_eq!(normal_at(511, 0, 0), None);
    }

    #[test]
    fn scanlines_hold_exactly_the_covered_pixels() {
        for size in [1, 2, 3, 10, 33] {
            let image = picture(size, |line| Ok::<_, ()>(vec![[1.0; 3]; line.normals.len()])).unwrap();
            for index in 0..size * size {
                let covered = normal_at(size, index % size, index / size).is_some();
                assert_eq!(image.is_covered(index), covered);
                assert_eq!(image.color.pixels()[index], if covered { [1.0; 3] } else { [0.0; 3] });
            }
        }
    }
}

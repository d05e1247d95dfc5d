//! A sphere with a lobe, lit by weighted directions (samples, lights) or by every pixel of a map.
//!
//! The radiance towards the camera is albedo times the sum of weight times f (n . w)+. For a lobe other than Lambert's there
//! is no short cut over rows, as in `exact`: every normal looks at every direction.

use std::f64::consts::PI;

use glam::DVec3;

use crate::image::raster::Image;
use crate::light::envmap::EnvMap;
use crate::light::relight::limits::Integrand;
use crate::light::relight::lobe::{Lobe, Reflection};
use crate::light::relight::sphere::{self, Scanline};

/// A direction from which light comes, and its weight in each channel.
pub type Weighted = (DVec3, [f64; 3]);

/// Directions looked at before the caller is asked whether to stop: some milliseconds.
const DIRECTIONS_PER_CHECK: usize = 1 << 16;

/// The sphere under weighted directions.
///
/// # Errors
/// What `check` gives.
pub fn by_directions<E: Send>(
    directions: &[Weighted],
    lobe: Lobe,
    size: usize,
    albedo: [f64; 3],
    check: impl Fn() -> Result<(), E> + Sync,
) -> Result<Image, E> {
    let radiance = |normal: &DVec3| {
        let reflection = lobe.at(*normal);
        let mut sum = [0.0; 3];
        for directions in directions.chunks(DIRECTIONS_PER_CHECK) {
            check()?;
            for (direction, weight) in directions {
                let value = reflection.value(*direction);
                (0..3).for_each(|channel| sum[channel] += weight[channel] * value);
            }
        }
        Ok([0, 1, 2].map(|channel| albedo[channel] * sum[channel]))
    };
    sphere::picture(size, |line: &Scanline| line.normals.iter().map(radiance).collect())
}

/// The sphere under every pixel of a map: the sum over pixel centers of the integrand's color.
///
/// Right as long as the lobe is wider than a pixel, by [`error_of_centers`].
///
/// # Errors
/// What `check` gives.
pub fn exact<E: Send>(
    map: &EnvMap,
    integrand: &Integrand<'_>,
    lobe: Lobe,
    size: usize,
    albedo: [f64; 3],
    check: impl Fn() -> Result<(), E> + Sync,
) -> Result<Image, E> {
    let rows: Vec<Vec<Weighted>> =
        (0..map.height()).map(|y| (0..map.width()).map(|x| (map.direction(x, y), integrand.color(map, x, y))).collect()).collect();
    let radiance = |normal: &DVec3| {
        let reflection = lobe.at(*normal);
        let mut sum = [0.0; 3];
        for (y, row) in rows.iter().enumerate() {
            if y % 64 == 0 {
                check()?;
            }
            let of_row = row_sum(row, &reflection);
            (0..3).for_each(|channel| sum[channel] += of_row[channel]);
        }
        Ok([0, 1, 2].map(|channel| albedo[channel] * sum[channel]))
    };
    sphere::picture(size, |line: &Scanline| line.normals.iter().map(radiance).collect())
}

/// How far [`exact`] is from the integral over pixels of constant radiance: of one bright pixel that the lobe's peak looks at, the
/// relative error, and what others err by in units of that peak.
///
/// A lobe falls as 1 - e t² / 2 with the angle t from its peak, and the mean of t² over a pixel of a by b radians is
/// (a² + b²) / 12. So it is e (a² + b²) / 24, of square pixels of angle a near the equator e a² / 12, as long as that is small.
pub fn error_of_centers(map: &EnvMap, lobe: Lobe) -> f64 {
    let (across, down) = (2.0 * PI / map.width() as f64, PI / map.height() as f64);
    lobe.sharpness() * (across * across + down * down) / 24.0
}

/// Bytes that [`exact`] needs beside its input and its result.
pub fn memory(pixel_count: u64) -> u64 {
    pixel_count * size_of::<Weighted>() as u64
}

fn row_sum(row: &[Weighted], reflection: &Reflection) -> [f64; 3] {
    let mut sum = [0.0; 3];
    for (direction, color) in row {
        let value = reflection.value(*direction);
        (0..3).for_each(|channel| sum[channel] += color[channel] * value);
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::envmap::{Angles, direction_at, phi_of_column, solid_angle_of_pixel, theta_of_row};
    use crate::light::relight::exact as diffuse;
    use crate::light::test_maps::{constant, noisy};

    fn go() -> Result<(), ()> {
        Ok(())
    }

    #[test]
    fn with_lamberts_lobe_it_is_the_diffuse_sphere() {
        let map = noisy(32, 16);
        let integrand = Integrand::radiance();
        let by_lobe = exact(&map, &integrand, Lobe::Diffuse, 9, [1.0, 0.5, 0.25], go).unwrap();
        let by_arcs = diffuse::relight(&map, &integrand, 9, [1.0, 0.5, 0.25], go).unwrap();
        for (a, b) in by_lobe.color.pixels().iter().zip(by_arcs.color.pixels()) {
            assert!((0..3).all(|channel| (a[channel] - b[channel]).abs() <= 1e-6 * b[channel].abs()));
        }
    }

    #[test]
    fn one_direction_is_seen_through_the_lobe() {
        let lobe = Lobe::Phong { exponent: 8 };
        let light = [(DVec3::Z, [1.0, 2.0, 4.0])];
        let image = by_directions(&light, lobe, 1, [1.0, 1.0, 0.5], go).unwrap();
        // Straight on: (8 + 2) / (2 pi).
        let peak = (10.0 / (2.0 * std::f64::consts::PI)) as f32;
        assert_eq!(image.color.pixel(0, 0), [peak, 2.0 * peak, 2.0 * peak]);
    }

    #[test]
    fn a_rough_mirror_under_a_constant_map_shows_its_albedo() {
        let map = constant(128, 64, [2.0; 3]);
        let image = exact(&map, &Integrand::radiance(), Lobe::Ggx { alpha: 0.5 }, 1, [1.0; 3], go).unwrap();
        assert!((image.color.pixel(0, 0)[0] / 2.0 - 0.6878).abs() < 2e-3, "{:?}", image.color.pixel(0, 0));
    }

    /// What a lobe whose peak looks at the middle of a lone bright pixel shows: by the pixel's center, and by 16 x 16 parts of it.
    fn center_and_integral(lobe: Lobe, width: usize) -> [f64; 2] {
        let places = |parts: usize| {
            let place = |x: usize, y: usize| {
                let (width, height) = (width * parts, width / 2 * parts);
                let direction = direction_at(theta_of_row(y, height, Angles::Center), phi_of_column(x, width, Angles::Center));
                (direction, solid_angle_of_pixel(y, width, height))
            };
            let (first_x, first_y) = (width / 4 * parts, width / 4 * parts);
            (0..parts * parts).map(|k| place(first_x + k % parts, first_y + k / parts)).collect::<Vec<_>>()
        };
        let bright = places(1)[0].0;
        let reflection = lobe.at((bright + DVec3::Z).normalize());
        [1, 16].map(|parts| places(parts).into_iter().map(|(direction, angle)| angle * reflection.value(direction)).sum())
    }

    #[test]
    fn centers_err_by_what_is_said_of_narrow_lobes() {
        for (lobe, width) in [
            (Lobe::Phong { exponent: 64 }, 128),
            (Lobe::Phong { exponent: 500 }, 512),
            (Lobe::Ggx { alpha: 0.1 }, 128),
            (Lobe::Ggx { alpha: 0.05 }, 256),
        ] {
            let [center, integral] = center_and_integral(lobe, width);
            let (error, said) = (center / integral - 1.0, error_of_centers(&constant(width, width / 2, [1.0; 3]), lobe));
            assert!(error > 0.8 * said && error < 1.1 * said, "{lobe:?}: {error}, and {said} is said");
        }
    }

    #[test]
    fn summing_stops_when_told_to() {
        assert_eq!(by_directions(&[(DVec3::Z, [1.0; 3])], Lobe::Diffuse, 4, [1.0; 3], || Err("stop")).unwrap_err(), "stop");
        assert_eq!(exact(&noisy(4, 2), &Integrand::radiance(), Lobe::Diffuse, 4, [1.0; 3], || Err("stop")).unwrap_err(), "stop");
    }
}

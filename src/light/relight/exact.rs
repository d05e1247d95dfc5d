//! The sum over every pixel of a map, for every normal of the sphere.
//!
//! All normals of one scanline have the same y and the same length rho of (x, z), and differ in their azimuth psi
//! alone. For them and one row of the map, n . d = y cos(theta) + rho sin(theta) cos(phi - psi), so the lit pixels
//! are an arc of phi about psi, equally wide for the whole scanline: one arc cosine serves them all. The sum of
//! color times direction over an arc is a difference of two prefix sums, and its product with n the irradiance.
//! So the sphere costs two look-ups per normal and map row, and is equal to the sum pixel by pixel.

use std::f64::consts::PI;

use rayon::prelude::*;

use crate::image::raster::Image;
use crate::light::envmap::EnvMap;
use crate::light::relight::estimators::reflected;
use crate::light::relight::limits::Integrand;
use crate::light::relight::sphere::{self, Scanline};
use crate::math::elementary;

/// Sum of color times direction: x, y and z for red, then for green and for blue.
type Flux = [f64; 9];

/// Map rows whose prefix sums are held at once: a megabyte for a map of 1024 columns, so that they stay in the cache.
const ROWS_AT_ONCE: usize = 8;

/// Normals whose sums are held at once.
const NORMALS_AT_ONCE: usize = 1 << 18;

/// Bytes that [`relight`] needs beside its input and its result.
pub fn memory(map_width: usize, size: usize) -> u64 {
    let normals = (size * size).min(NORMALS_AT_ONCE + size) as u64;
    let prefixes = (ROWS_AT_ONCE * (map_width + map_width / 2 + 4)) as u64;
    (normals * 2 + prefixes) * size_of::<Flux>() as u64
}

/// The radiance (albedo / pi) sum_k c_k (n . d_k)+ of a diffuse sphere, c being the integrand's color of each pixel.
///
/// # Errors
/// What `check` gives.
pub fn relight<E: Send>(
    map: &EnvMap,
    integrand: &Integrand<'_>,
    size: usize,
    albedo: [f64; 3],
    check: impl Fn() -> Result<(), E> + Sync,
) -> Result<Image, E> {
    let azimuths = azimuths(map);
    let mut pixels = vec![[0.0f32; 3]; size * size];
    let mut alpha = vec![0.0f32; size * size];
    for rows in bands(size) {
        let mut lines: Vec<LitLine> = rows.into_par_iter().map(|row| LitLine::new(Scanline::new(size, row), map)).collect();
        add_map(&mut lines, map, integrand, &azimuths, &check)?;
        for LitLine { line, fluxes, .. } in lines {
            let start = line.row * size + line.first;
            for (index, (normal, flux)) in line.normals.iter().zip(&fluxes).enumerate() {
                let irradiance = [0, 3, 6].map(|c| normal.x * flux[c] + normal.y * flux[c + 1] + normal.z * flux[c + 2]);
                pixels[start + index] = reflected(albedo, irradiance).map(|channel| channel as f32);
                alpha[start + index] = 1.0;
            }
        }
    }
    Ok(sphere::image(size, pixels, alpha))
}

/// Cosine and sine of the azimuth of each column.
fn azimuths(map: &EnvMap) -> Vec<[f64; 2]> {
    let of_column = |x| {
        let (sin, cos) = elementary::sin_cos(map.phi(x));
        [cos, sin]
    };
    (0..map.width()).map(of_column).collect()
}

/// Ranges of picture rows with a bounded number of normals.
fn bands(size: usize) -> Vec<std::ops::Range<usize>> {
    let rows = (NORMALS_AT_ONCE / size).max(1);
    (0..size).step_by(rows).map(|first| first..(first + rows).min(size)).collect()
}

fn add_map<E: Send>(
    lines: &mut [LitLine],
    map: &EnvMap,
    integrand: &Integrand<'_>,
    azimuths: &[[f64; 2]],
    check: &(impl Fn() -> Result<(), E> + Sync),
) -> Result<(), E> {
    for first in (0..map.height()).step_by(ROWS_AT_ONCE) {
        let end = (first + ROWS_AT_ONCE).min(map.height());
        let rows: Vec<MapRow> = (first..end).into_par_iter().map(|y| MapRow::new(map, integrand, azimuths, y)).collect();
        lines.par_iter_mut().try_for_each(|line| {
            check()?;
            rows.iter().for_each(|row| line.add(row));
            Ok(())
        })?;
    }
    Ok(())
}

/// Prefix sums over one row of the map, continued over one turn and a half.
struct MapRow {
    sin_theta: f64,
    cos_theta: f64,
    total: Flux,
    /// Entry m is the sum over columns -reach to m - reach, both included; columns go round.
    prefix: Vec<Flux>,
}

impl MapRow {
    fn new(map: &EnvMap, integrand: &Integrand<'_>, azimuths: &[[f64; 2]], y: usize) -> Self {
        let (sin_theta, cos_theta) = elementary::sin_cos(map.theta(y));
        let of_column = |(x, [cos_phi, sin_phi]): (usize, &[f64; 2])| -> Flux {
            let direction = [sin_theta * cos_phi, cos_theta, sin_theta * sin_phi];
            let color = integrand.color(map, x, y);
            std::array::from_fn(|entry| color[entry / 3] * direction[entry % 3])
        };
        let fluxes: Vec<Flux> = azimuths.iter().enumerate().map(of_column).collect();

        let mut total = [0.0; 9];
        fluxes.iter().for_each(|flux| add(&mut total, flux));

        let (width, reach) = (map.width(), reach(map.width()));
        let mut sum = [0.0; 9];
        let mut prefix = Vec::with_capacity(reach + width + 1);
        for flux in fluxes.iter().cycle().skip(width - reach).take(reach + width + 1) {
            add(&mut sum, flux);
            prefix.push(sum);
        }
        Self { sin_theta, cos_theta, total, prefix }
    }
}

/// How many columns left of column 0 an arc can begin: it is at most half a turn to the left of +x.
fn reach(width: usize) -> usize {
    width / 2 + 1
}

fn add(sum: &mut Flux, flux: &Flux) {
    sum.iter_mut().zip(flux).for_each(|(sum, flux)| *sum += flux);
}

/// A scanline of the sphere with what has been summed for each of its normals.
struct LitLine {
    line: Scanline,
    y: f64,
    /// Length of (x, z).
    rho: f64,
    columns_per_radian: f64,
    /// Azimuth of each normal in columns of the map, counted from `reach` columns left of column 0.
    azimuths: Vec<f64>,
    fluxes: Vec<Flux>,
}

impl LitLine {
    fn new(line: Scanline, map: &EnvMap) -> Self {
        let columns_per_radian = map.width() as f64 / (2.0 * PI);
        let first = reach(map.width()) as f64 - map.phi(0) * columns_per_radian;
        let azimuths = line.normals.iter().map(|n| elementary::atan2(n.z, n.x) * columns_per_radian + first).collect();
        let y = line.normals.first().map_or(0.0, |n| n.y);
        let rho = ((1.0 - y) * (1.0 + y)).sqrt();
        Self { y, rho, columns_per_radian, azimuths, fluxes: vec![[0.0; 9]; line.normals.len()], line }
    }

    /// Adds the lit arc of a map row to every normal.
    fn add(&mut self, row: &MapRow) {
        // n . d = a + b cos(phi - psi).
        let (a, b) = (self.y * row.cos_theta, self.rho * row.sin_theta);
        if a <= -b {
            return;
        }
        if a >= b {
            return self.fluxes.iter_mut().for_each(|flux| add(flux, &row.total));
        }

        // A pixel on the arc's very end has no cosine, so it does not matter on which side rounding puts it.
        let half_width = elementary::acos(-a / b) * self.columns_per_radian;
        for (flux, azimuth) in self.fluxes.iter_mut().zip(&self.azimuths) {
            let before = &row.prefix[(azimuth - half_width) as usize];
            let through = &row.prefix[(azimuth + half_width) as usize];
            for entry in 0..9 {
                flux[entry] += through[entry] - before[entry];
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::envmap::Angles;
    use crate::light::relight::limits;
    use crate::light::test_maps::{constant, grace, noisy};

    fn relit(map: &EnvMap, size: usize) -> Image {
        relight(map, &Integrand::radiance(), size, [1.0; 3], || Ok::<(), ()>(())).unwrap()
    }

    /// Greatest difference between `relight` and the sum pixel by pixel, in units of the largest radiance.
    fn error(map: &EnvMap, integrand: &Integrand<'_>, size: usize, columns: impl Iterator<Item = usize> + Clone) -> f64 {
        let mut lines: Vec<LitLine> = (0..size).map(|row| LitLine::new(Scanline::new(size, row), map)).collect();
        add_map(&mut lines, map, integrand, &azimuths(map), &|| Ok::<(), ()>(())).unwrap();
        let (mut error, mut largest) = (0.0_f64, 0.0_f64);
        for line in &lines {
            for column in columns.clone().filter(|column| *column < line.fluxes.len()) {
                let (n, flux) = (line.line.normals[column], line.fluxes[column]);
                let brute = limits::irradiance_at(map, integrand, n);
                for (channel, brute) in brute.into_iter().enumerate() {
                    let flux = &flux[3 * channel..];
                    error = error.max((n.x * flux[0] + n.y * flux[1] + n.z * flux[2] - brute).abs());
                    largest = largest.max(brute);
                }
            }
        }
        error / largest
    }

    #[test]
    fn arcs_equal_the_sum_pixel_by_pixel_for_all_angles_and_odd_sizes() {
        for (width, height) in [(1, 1), (2, 1), (3, 2), (5, 9), (32, 16), (33, 20)] {
            for angles in [Angles::Center, Angles::Edge, Angles::EdgeInclusive] {
                let map = EnvMap { angles, ..noisy(width, height) };
                for integrand in [Integrand::radiance(), Integrand::normalized_color(), Integrand::equal_weight(&map)] {
                    let error = error(&map, &integrand, 23, 0..23);
                    // Sums of at most 660 numbers, each order rounding once per number: 660 x 2^-53 = 7e-14 at worst.
                    assert!(error < 4e-14, "{width}x{height} {angles:?}: {error}");
                }
            }
        }
    }

    #[test]
    fn arcs_equal_the_sum_pixel_by_pixel_on_grace() {
        let Some(map) = grace() else { return };
        let error = error(&map, &Integrand::radiance(), 9, [0, 3, 8].into_iter());
        assert!(error < 4e-14, "{error}");
    }

    #[test]
    fn a_white_sphere_in_a_constant_map_is_white() {
        let image = relit(&constant(256, 128, [1.0, 2.0, 0.5]), 15);
        for (index, pixel) in image.color.pixels().iter().enumerate().filter(|(index, _)| image.is_covered(*index)) {
            // The sum over pixels differs from the integral by O(H^-2): 3e-4 at H = 64.
            assert!((pixel[0] - 1.0).abs() < 1.5e-4 && (pixel[1] - 2.0).abs() < 3e-4, "{index}: {pixel:?}");
        }
    }

    #[test]
    fn a_band_boundary_does_not_show() {
        assert_eq!((bands(511).len(), bands(3000).len()), (1, 35));
        let rows: Vec<usize> = bands(3000).into_iter().flatten().collect();
        assert_eq!(rows, (0..3000).collect::<Vec<_>>());
    }
}

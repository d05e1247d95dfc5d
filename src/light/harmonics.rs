//! Spherical harmonics up to the second band, and the irradiance of a map from its nine coefficients.
//!
//! After Ramamoorthi and Hanrahan, "An efficient representation for irradiance environment maps" (2001).

use std::f64::consts::PI;

use glam::DVec3;
use rayon::prelude::*;

use crate::image::raster::Image;
use crate::light::envmap::EnvMap;
use crate::light::relight::estimators::reflected;
use crate::light::relight::sphere;

/// Coefficients L_lm of each channel, in the order 00, 1-1, 10, 11, 2-2, 2-1, 20, 21, 22.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Coefficients(pub [[f64; 9]; 3]);

/// Factors A_l of the clamped cosine for each coefficient: pi, 2 pi / 3 and pi / 4 (eq. 8 and 9).
const COSINE: [f64; 9] = {
    const BANDS: [f64; 3] = [PI, 2.0 * PI / 3.0, PI / 4.0];
    [BANDS[0], BANDS[1], BANDS[1], BANDS[1], BANDS[2], BANDS[2], BANDS[2], BANDS[2], BANDS[2]]
};

/// The nine real harmonics Y_lm at a unit direction (eq. 3).
pub fn basis(DVec3 { x, y, z }: DVec3) -> [f64; 9] {
    // sqrt(1 / 4 pi), sqrt(3 / 4 pi), sqrt(15 / 4 pi), sqrt(5 / 16 pi), sqrt(15 / 16 pi).
    const C0: f64 = 0.282_094_791_773_878_14;
    const C1: f64 = 0.488_602_511_902_919_9;
    const C2: f64 = 1.092_548_430_592_079_2;
    const C20: f64 = 0.315_391_565_252_520_05;
    const C22: f64 = 0.546_274_215_296_039_6;
    [C0, C1 * y, C1 * z, C1 * x, C2 * x * y, C2 * y * z, C20 * (3.0 * z * z - 1.0), C2 * x * z, C22 * (x * x - y * y)]
}

impl Coefficients {
    /// L_lm = integral of L Y_lm, as a sum over the pixels of a map.
    ///
    /// # Errors
    /// What `check` gives, which is asked once a row.
    pub fn of<E: Send>(map: &EnvMap, check: impl Fn() -> Result<(), E> + Sync) -> Result<Self, E> {
        let rows: Vec<Result<[[f64; 9]; 3], E>> =
            (0..map.height()).into_par_iter().map(|y| check().map(|()| coefficients_of_row(map, y))).collect();
        let mut sums = [[0.0; 9]; 3];
        for row in rows {
            for (sum, of_row) in sums.as_flattened_mut().iter_mut().zip(row?.as_flattened()) {
                *sum += of_row;
            }
        }
        Ok(Self(sums))
    }

    /// E(n) = sum of A_l L_lm Y_lm(n) (eq. 7). Can be negative, opposite to a small bright light.
    pub fn irradiance(&self, normal: DVec3) -> [f64; 3] {
        let basis = basis(normal);
        self.0.map(|coefficients| (0..9).map(|lm| COSINE[lm] * coefficients[lm] * basis[lm]).sum())
    }

    /// The radiance of a diffuse sphere of `size` x `size` pixels.
    ///
    /// # Errors
    /// What `check` gives.
    pub fn relight<E: Send>(&self, size: usize, albedo: [f64; 3], check: impl Fn() -> Result<(), E> + Sync) -> Result<Image, E> {
        sphere::picture(size, |line| {
            check()?;
            Ok(line.normals.iter().map(|normal| reflected(albedo, self.irradiance(*normal))).collect())
        })
    }
}

fn coefficients_of_row(map: &EnvMap, y: usize) -> [[f64; 9]; 3] {
    let mut sums = [[0.0; 9]; 3];
    for (x, pixel) in map.raster.row(y).iter().enumerate() {
        let basis = basis(map.direction(x, y));
        for (sums, channel) in sums.iter_mut().zip(pixel) {
            for lm in 0..9 {
                sums[lm] += f64::from(*channel) * basis[lm];
            }
        }
    }
    sums.map(|channel| channel.map(|sum| sum * map.solid_angle(y)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::raster::Raster;
    use crate::light::test_maps::{constant, grace};

    fn coefficients(map: &EnvMap) -> Coefficients {
        Coefficients::of(map, || Ok::<(), ()>(())).unwrap()
    }

    #[test]
    fn the_basis_is_orthonormal() {
        let map = constant(256, 128, [1.0; 3]);
        for a in 0..9 {
            for b in 0..9 {
                let product = |x, y| basis(map.direction(x, y))[a] * basis(map.direction(x, y))[b] * map.solid_angle(y);
                let integral: f64 = (0..128).flat_map(|y| (0..256).map(move |x| product(x, y))).sum();
                // The midpoint rule in theta errs by O(H^-2).
                assert!((integral - f64::from(a == b)).abs() < 3e-4, "{a} {b}: {integral}");
            }
        }
    }

    #[test]
    fn grace_has_the_published_values() {
        let Some(map) = grace() else { return };
        let coefficients = coefficients(&map);
        for (normal, expected) in [
            (DVec3::X, [0.9891, 0.5371, 0.6954]),
            (DVec3::Y, [1.0756, 0.8103, 1.2956]),
            (DVec3::Z, [1.1560, 0.4554, 0.3853]),
            (DVec3::NEG_Y, [0.2515, 0.0795, 0.0299]),
        ] {
            let radiance = coefficients.irradiance(normal).map(|channel| channel / PI);
            assert!((0..3).all(|c| (radiance[c] - expected[c]).abs() < 5.1e-5), "{radiance:?} instead of {expected:?}");
        }
    }

    #[test]
    fn a_map_of_low_bands_is_relit_exactly() {
        // L = 2 + x + y z: E = 2 pi + (2 pi / 3) x + (pi / 4) y z.
        let grid = constant(512, 256, [0.0; 3]);
        let radiance = |index: usize| {
            let d = grid.direction(index % 512, index / 512);
            [(2.0 + d.x + d.y * d.z) as f32; 3]
        };
        let map = EnvMap::new(Raster::new(512, 256, (0..512 * 256).map(radiance).collect()));
        let n = DVec3::new(0.48, -0.6, 0.64);
        let expected = 2.0 * PI + 2.0 * PI / 3.0 * n.x + PI / 4.0 * n.y * n.z;
        let found = coefficients(&map).irradiance(n)[1];
        assert!((found / expected - 1.0).abs() < 1e-4, "{found} {expected}");
    }
}

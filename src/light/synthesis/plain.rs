//! Maps with known answers: constant, gradient, one pixel, checker.
//!
//! They are for tests and teaching: what a correct program makes of them can be written down.

use crate::light::envmap::{Angles, EnvMap, theta_of_row};
use crate::light::synthesis::{Rgb, filled, single};
use crate::math::elementary;

/// The same radiance everywhere: every normal receives pi L, and the map holds 4 pi L.
pub fn constant<E: Send>(radiance: Rgb, width: usize, check: impl Fn() -> Result<(), E> + Sync) -> Result<EnvMap, E> {
    filled(width, check, |_, _| single(radiance))
}

/// Radiance linear in the height of the direction: L(d) = (top + bottom) / 2 + d.y (top - bottom) / 2.
///
/// The irradiance at normal n is pi ((top + bottom) / 2 + n.y (top - bottom) / 3).
#[derive(Debug, Clone, PartialEq)]
pub struct Gradient {
    /// Radiance at the zenith.
    pub top: Rgb,
    /// Radiance at the nadir.
    pub bottom: Rgb,
}

impl Default for Gradient {
    fn default() -> Self {
        Self { top: [1.0; 3], bottom: [0.0; 3] }
    }
}

impl Gradient {
    /// The map, each pixel by the direction of its center.
    pub fn map<E: Send>(&self, width: usize, check: impl Fn() -> Result<(), E> + Sync) -> Result<EnvMap, E> {
        filled(width, check, |_, y| {
            let height = elementary::cos(theta_of_row(y, width / 2, Angles::Center));
            let share = 0.5 * (1.0 + height);
            single(std::array::from_fn(|channel| self.bottom[channel] * (1.0 - share) + self.top[channel] * share))
        })
    }
}

/// One pixel of another radiance than all others: shows orientation, and what a sampler makes of a point.
#[derive(Debug, Clone, PartialEq)]
pub struct OnePixel {
    /// Column and row; `None` is column width / 16, row height / 4: 45 degrees up, and about 22.5 from +x towards +z.
    pub pixel: Option<[usize; 2]>,
    /// Radiance of that pixel.
    pub radiance: Rgb,
    /// Radiance of all others.
    pub background: Rgb,
}

impl Default for OnePixel {
    fn default() -> Self {
        Self { pixel: None, radiance: [1.0; 3], background: [0.0; 3] }
    }
}

impl OnePixel {
    /// The map.
    ///
    /// # Panics
    /// If the pixel lies outside.
    pub fn map<E: Send>(&self, width: usize, check: impl Fn() -> Result<(), E> + Sync) -> Result<EnvMap, E> {
        let [x, y] = self.pixel.unwrap_or([width / 16, width / 8]);
        let mut map = constant(self.background, width, check)?;
        map.raster.set_pixel(x, y, single(self.radiance));
        Ok(map)
    }
}

/// Squares in angle, twice as many around as from pole to pole; the one at the top left is bright.
#[derive(Debug, Clone, PartialEq)]
pub struct Checker {
    /// Squares from pole to pole; at most the map's height.
    pub squares: usize,
    /// Radiance of the bright squares.
    pub radiance: Rgb,
    /// Radiance of the dark squares.
    pub background: Rgb,
}

impl Default for Checker {
    fn default() -> Self {
        Self { squares: 8, radiance: [1.0; 3], background: [0.0; 3] }
    }
}

impl Checker {
    /// The map; a pixel belongs to the square that holds its center.
    pub fn map<E: Send>(&self, width: usize, check: impl Fn() -> Result<(), E> + Sync) -> Result<EnvMap, E> {
        // Centers stand at odd multiples of half a pixel, squares at multiples of height / squares.
        let square = |index: usize| (2 * index + 1) * self.squares / width;
        filled(width, check, |x, y| {
            let is_bright = (square(x) + square(y)) % 2 == 0;
            single(if is_bright { self.radiance } else { self.background })
        })
    }
}

#[cfg(test)]
mod tests {
    use std::convert::Infallible;
    use std::f64::consts::PI;

    use super::*;
    use glam::DVec3;

    fn computed(map: Result<EnvMap, Infallible>) -> EnvMap {
        let Ok(map) = map;
        map
    }

    fn free() -> Result<(), Infallible> {
        Ok(())
    }

    #[test]
    fn a_constant_map_holds_four_pi_of_its_radiance() {
        let map = computed(constant([1.0, 2.0, 0.5], 64, free));
        for (channel, radiance) in [1.0, 2.0, 0.5].into_iter().enumerate() {
            let total: f64 =
                (0..32).map(|y| map.raster.row(y).iter().map(|p| f64::from(p[channel])).sum::<f64>() * map.solid_angle(y)).sum();
            assert!((total - 4.0 * PI * radiance).abs() < 1e-12, "{total}");
        }
    }

    #[test]
    fn a_gradient_lights_a_normal_as_its_closed_form_says() {
        let gradient = Gradient { top: [3.0, 1.0, 0.0], bottom: [1.0, 2.0, 0.5] };
        let map = computed(gradient.map(256, free));
        for normal in [DVec3::Y, DVec3::X, -DVec3::Y, DVec3::new(1.0, 2.0, -2.0) / 3.0] {
            for channel in 0..3 {
                let mut irradiance = 0.0;
                for y in 0..128 {
                    for x in 0..256 {
                        let cosine = map.direction(x, y).dot(normal).max(0.0);
                        irradiance += f64::from(map.raster.pixel(x, y)[channel]) * cosine * map.solid_angle(y);
                    }
                }
                let (top, bottom) = (gradient.top[channel], gradient.bottom[channel]);
                let expected = PI * ((top + bottom) / 2.0 + normal.y * (top - bottom) / 3.0);
                // Midpoint rule at height 128: the error falls as height^-2 and is 3e-4 at 64 (math of the exact sphere).
                assert!((irradiance - expected).abs() < 3e-4 * (top + bottom), "{irradiance} {expected}");
            }
        }
    }

    #[test]
    fn one_pixel_differs_and_no_more() {
        let map = computed(OnePixel { pixel: Some([5, 3]), ..OnePixel::default() }.map(32, free));
        let lit: Vec<usize> = (0..32 * 16).filter(|&index| map.raster.pixels()[index] != [0.0; 3]).collect();
        assert_eq!(lit, [3 * 32 + 5]);
    }

    #[test]
    fn the_default_pixel_tells_the_axes_apart() {
        let map = computed(OnePixel::default().map(1024, free));
        let index = map.raster.pixels().iter().position(|pixel| pixel[0] > 0.0).unwrap();
        let direction = map.direction(index % 1024, index / 1024);
        assert!(direction.x > direction.z + 0.3 && direction.z > 0.2 && direction.y > 0.7 - 0.01, "{direction}");
    }

    #[test]
    fn a_checker_has_as_many_squares_as_asked_for() {
        for squares in [1, 2, 5, 8] {
            let map = computed(Checker { squares, ..Checker::default() }.map(80, free));
            let changes = |values: Vec<f32>| values.windows(2).filter(|pair| pair[0] != pair[1]).count();
            assert_eq!(changes((0..80).map(|x| map.raster.pixel(x, 0)[0]).collect()), 2 * squares - 1);
            assert_eq!(changes((0..40).map(|y| map.raster.pixel(0, y)[0]).collect()), squares - 1);
            let bright = map.raster.pixels().iter().filter(|pixel| pixel[0] == 1.0).count();
            assert_eq!(bright, 80 * 40 / 2);
        }
    }
}

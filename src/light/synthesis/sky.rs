//! A clear sky with the sun, over a diffuse ground.
//!
//! Sky: Preetham, Shirley, Smits, "A practical analytic model for daylight" (1999), its appendix A.2.
//! Sun: a black body of 5772 K behind the air of the same paper's appendix A.1 (Rayleigh, aerosol and ozone; water
//! vapor and mixed gases absorb outside what is seen and are left out), weighed with the color matching
//! functions as fitted by Wyman, Sloan, Shirley (2013). Radiance is photometric: Rec. 709 primaries whose luminance is in kcd/m^2.

use std::f64::consts::PI;

use glam::{DMat3, DVec3};

use crate::light::envmap::{Angles, EnvMap, direction_at, phi_of_column, theta_of_row};
use crate::light::synthesis::disk::Disk;
use crate::light::synthesis::{Rgb, filled, single};
use crate::math::elementary;

/// Half the sun's diameter of 0.533 degrees.
pub const SUN_RADIUS: f64 = 0.2665 * PI / 180.0;

/// Where the sun stands and how clear the air is.
#[derive(Debug, Clone, PartialEq)]
pub struct SunSky {
    /// Height of the sun's center over the horizon, in degrees, 0 to 90.
    pub sun_elevation_degrees: f64,
    /// Direction of the sun, in degrees from +x towards +z.
    pub sun_azimuth_degrees: f64,
    /// Haze: 2 is very clear, 3 clear, 6 hazy, 10 almost fog; 2 to 10.
    pub turbidity: f64,
    /// Diffuse reflectance of the ground, 0 to 1.
    pub ground_albedo: f64,
}

impl Default for SunSky {
    fn default() -> Self {
        Self { sun_elevation_degrees: 40.0, sun_azimuth_degrees: 60.0, turbidity: 3.0, ground_albedo: 0.2 }
    }
}

impl SunSky {
    /// The map. The sun's energy is exact at any width, be it larger or smaller than a pixel.
    ///
    /// # Panics
    /// If a parameter is out of its range.
    pub fn map<E: Send>(&self, width: usize, check: impl Fn() -> Result<(), E> + Sync) -> Result<EnvMap, E> {
        let sky = Sky::new(self);
        let ground = sky.ground(self.ground_albedo);
        let columns: Vec<(f64, f64)> = (0..width).map(|x| elementary::sin_cos(phi_of_column(x, width, Angles::Center))).collect();
        let rows: Vec<(f64, f64)> = (0..width / 2).map(|y| elementary::sin_cos(theta_of_row(y, width / 2, Angles::Center))).collect();
        let mut map = filled(width, &check, |x, y| {
            let ((sin_phi, cos_phi), (sin_theta, cos_theta)) = (columns[x], rows[y]);
            let direction = DVec3::new(sin_theta * cos_phi, cos_theta, sin_theta * sin_phi);
            single(if is_ground(direction) { ground } else { sky.radiance(direction) })
        })?;
        check()?;
        // The ground hides what of the disk is below the horizon.
        sky.sun.add_to(&mut map, |direction| !is_ground(direction));
        Ok(map)
    }
}

/// Below the horizon, or on it but for rounding.
fn is_ground(direction: DVec3) -> bool {
    direction.y < 1e-9
}

/// Perez's formula for one of Y, x, y, with the value at the zenith.
#[derive(Debug, Clone, Copy)]
struct Perez {
    coefficients: [f64; 5],
    /// Value at the zenith over the formula's value there.
    scale: f64,
}

impl Perez {
    fn new(coefficients: [f64; 5], zenith: f64, sun_theta: f64) -> Self {
        let unscaled = Self { coefficients, scale: 1.0 };
        Self { coefficients, scale: zenith / unscaled.at(1.0, sun_theta, elementary::cos(sun_theta)) }
    }

    /// (1 + A e^(B / cos theta)) (1 + C e^(D gamma) + E cos^2 gamma), scaled.
    fn at(&self, cos_theta: f64, gamma: f64, cos_gamma: f64) -> f64 {
        let [a, b, c, d, e] = self.coefficients;
        let gradation = 1.0 + a * elementary::exp(b / cos_theta);
        self.scale * gradation * (1.0 + c * elementary::exp(d * gamma) + e * cos_gamma * cos_gamma)
    }
}

struct Sky {
    luminance: Perez,
    chromaticity: [Perez; 2],
    sun: Disk,
}

impl Sky {
    fn new(parameters: &SunSky) -> Self {
        let t = parameters.turbidity;
        let sun_theta = (90.0 - parameters.sun_elevation_degrees) * PI / 180.0;
        let center = direction_at(sun_theta, parameters.sun_azimuth_degrees * PI / 180.0);
        let chi = (4.0 / 9.0 - t / 120.0) * (PI - 2.0 * sun_theta);
        let zenith = (4.0453 * t - 4.9710) * elementary::tan(chi) - 0.2155 * t + 2.4192;
        let luminance = [0.1787 * t - 1.4630, -0.3554 * t + 0.4275, -0.0227 * t + 5.3251, 0.1206 * t - 2.5771, -0.0670 * t + 0.3703];
        let x = [-0.0193 * t - 0.2592, -0.0665 * t + 0.0008, -0.0004 * t + 0.2125, -0.0641 * t - 0.8989, -0.0033 * t + 0.0452];
        let y = [-0.0167 * t - 0.2608, -0.0950 * t + 0.0092, -0.0079 * t + 0.2102, -0.0441 * t - 1.6537, -0.0109 * t + 0.0529];
        let zenith_x = zenith_chromaticity(&ZENITH_X, t, sun_theta);
        let zenith_y = zenith_chromaticity(&ZENITH_Y, t, sun_theta);
        Self {
            // At the horizon and low turbidity the fitted polynomial dips below zero, where the model means dark.
            luminance: Perez::new(luminance, zenith.max(0.0), sun_theta),
            chromaticity: [Perez::new(x, zenith_x, sun_theta), Perez::new(y, zenith_y, sun_theta)],
            sun: Disk { center, radius: SUN_RADIUS, radiance: sun_radiance(sun_theta, t) },
        }
    }

    /// Radiance of the sky without the sun; never negative.
    fn radiance(&self, direction: DVec3) -> Rgb {
        let cos_gamma = direction.dot(self.sun.center).clamp(-1.0, 1.0);
        let gamma = elementary::acos(cos_gamma);
        let luminance = self.luminance.at(direction.y, gamma, cos_gamma).max(0.0);
        let [x, y] = self.chromaticity.map(|formula| formula.at(direction.y, gamma, cos_gamma));
        rgb_of(DVec3::new(x / y, 1.0, (1.0 - x - y) / y) * luminance)
    }

    /// Radiance of a diffuse ground under sky and sun.
    fn ground(&self, albedo: f64) -> Rgb {
        let (rows, columns) = (32, 64);
        let mut irradiance = [0.0; 3];
        for row in 0..rows {
            // Equal steps of sin^2(theta) are equal shares of the cosine-weighted hemisphere.
            let cos_theta = (1.0 - (f64::from(row) + 0.5) / f64::from(rows)).sqrt();
            let theta = elementary::acos(cos_theta);
            for column in 0..columns {
                let radiance = self.radiance(direction_at(theta, (f64::from(column) + 0.5) * 2.0 * PI / f64::from(columns)));
                irradiance = std::array::from_fn(|c| irradiance[c] + radiance[c] * PI / f64::from(rows * columns));
            }
        }
        let from_sun = self.sun.solid_angle() * self.sun.center.y.max(0.0);
        std::array::from_fn(|c| albedo / PI * (irradiance[c] + self.sun.radiance[c] * from_sun))
    }
}

/// Rows: turbidity squared, turbidity, one; columns: cube, square, first power of the sun's polar angle, one.
const ZENITH_X: [[f64; 4]; 3] =
    [[0.00166, -0.00375, 0.00209, 0.0], [-0.02903, 0.06377, -0.03202, 0.00394], [0.11693, -0.21196, 0.06052, 0.25886]];
/// See [`ZENITH_X`].
const ZENITH_Y: [[f64; 4]; 3] =
    [[0.00275, -0.00610, 0.00317, 0.0], [-0.04214, 0.08970, -0.04153, 0.00516], [0.15346, -0.26756, 0.06670, 0.26688]];

fn zenith_chromaticity(table: &[[f64; 4]; 3], turbidity: f64, theta: f64) -> f64 {
    let powers = [theta * theta * theta, theta * theta, theta, 1.0];
    let rows = table.map(|row| row.iter().zip(powers).map(|(value, power)| value * power).sum::<f64>());
    turbidity * turbidity * rows[0] + turbidity * rows[1] + rows[2]
}

/// Radiance of the sun's disk through the air.
fn sun_radiance(theta: f64, turbidity: f64) -> Rgb {
    let step = 5.0;
    let mut color = DVec3::ZERO;
    for index in 0..81 {
        let wavelength = 380.0 + step * f64::from(index);
        let radiance = black_body(wavelength, 5772.0) * air_transmittance(wavelength, theta, turbidity);
        color += color_matching(wavelength) * radiance * step;
    }
    // 683 lm/W, and 1000 cd to a kcd.
    rgb_of(color * 0.683)
}

/// Share of light of `wavelength` (nanometers) that comes down through the air.
fn air_transmittance(wavelength: f64, theta: f64, turbidity: f64) -> f64 {
    let micrometers = wavelength / 1000.0;
    let degrees = theta * 180.0 / PI;
    let air_mass = 1.0 / (elementary::cos(theta) + 0.15 * elementary::pow(93.885 - degrees, -1.253));
    let rayleigh = 0.008735 * elementary::pow(micrometers, -4.08);
    let aerosol = (0.04608 * turbidity - 0.04586) * elementary::pow(micrometers, -1.3);
    // Chappuis band of ozone: 0.35 cm of it, absorption 0.125 / cm at 595 nm, as a bell of 55 nm.
    let ozone = 0.35 * 0.125 * bell(wavelength, 595.0, 55.0, 55.0);
    elementary::exp(-(rayleigh + aerosol + ozone) * air_mass)
}

/// Planck's law: W m^-2 sr^-1 nm^-1.
fn black_body(wavelength: f64, kelvin: f64) -> f64 {
    let meters = wavelength * 1e-9;
    // 2 h c^2 and h c / k, CODATA 2018.
    let (first, second) = (1.191_042_972e-16, 1.438_776_877e-2);
    let fifth = meters * meters * meters * meters * meters;
    first / (fifth * (elementary::exp(second / (meters * kelvin)) - 1.0)) * 1e-9
}

/// CIE 1931 x, y, z of `wavelength` in nanometers.
fn color_matching(wavelength: f64) -> DVec3 {
    let w = wavelength;
    DVec3::new(
        1.056 * bell(w, 599.8, 37.9, 31.0) + 0.362 * bell(w, 442.0, 16.0, 26.7) - 0.065 * bell(w, 501.1, 20.4, 26.2),
        0.821 * bell(w, 568.8, 46.9, 40.5) + 0.286 * bell(w, 530.9, 16.3, 31.1),
        1.217 * bell(w, 437.0, 11.8, 36.0) + 0.681 * bell(w, 459.0, 26.0, 13.8),
    )
}

/// Gaussian with a width to the left and one to the right.
fn bell(x: f64, middle: f64, left: f64, right: f64) -> f64 {
    let t = (x - middle) / if x < middle { left } else { right };
    elementary::exp(-0.5 * t * t)
}

/// Linear Rec. 709 of CIE XYZ; what lies outside the triangle is clipped to its edge.
fn rgb_of(xyz: DVec3) -> Rgb {
    let to_rgb = DMat3::from_cols_array(&[
        3.240_454_2,
        -0.969_266,
        0.055_643_4,
        -1.537_138_5,
        1.876_010_8,
        -0.204_025_9,
        -0.498_531_4,
        0.041_556,
        1.057_225_2,
    ]);
    (to_rgb * xyz).to_array().map(|channel| channel.max(0.0))
}

#[cfg(test)]
mod tests {
    use std::convert::Infallible;

    use super::*;

    fn map(sky: &SunSky, width: usize) -> EnvMap {
        let Ok(map) = sky.map(width, || Ok::<(), Infallible>(()));
        map
    }

    fn luminance([r, g, b]: [f32; 3]) -> f64 {
        f64::from(0.2126 * r + 0.7152 * g + 0.0722 * b)
    }

    #[test]
    fn the_sun_gives_about_as_much_light_as_it_does() {
        // Direct normal illuminance on a clear day with a high sun is 85 to 110 klx; outside the air 127 (1361 W/m^2 at 93 lm/W).
        let normal_illuminance = |theta, turbidity| {
            let [r, g, b] = sun_radiance(theta, turbidity);
            (0.2126 * r + 0.7152 * g + 0.0722 * b) * 2.0 * PI * (1.0 - elementary::cos(SUN_RADIUS))
        };
        let high = normal_illuminance(0.5, 2.5);
        assert!((85.0..110.0).contains(&high), "{high}");
        assert!(normal_illuminance(1.45, 2.5) < 0.4 * high);
    }

    #[test]
    fn black_body_and_luminosity_give_the_known_efficacy() {
        // 93 lm/W for 5772 K, over sigma T^4 / pi.
        let step = 1.0;
        let luminous: f64 =
            (0..450).map(|k| black_body(360.0 + f64::from(k), 5772.0) * color_matching(360.0 + f64::from(k)).y * step).sum();
        let total = 5.670_374e-8 * 5772.0 * 5772.0 * 5772.0 * 5772.0 / PI;
        let efficacy = 683.0 * luminous / total;
        assert!((efficacy - 93.0).abs() < 1.5, "{efficacy}");
    }

    #[test]
    fn the_brightest_pixel_is_where_the_sun_stands() {
        let sky = SunSky { sun_elevation_degrees: 30.0, sun_azimuth_degrees: 200.0, ..SunSky::default() };
        let map = map(&sky, 256);
        let brightest =
            (0..256 * 128).max_by(|&a, &b| luminance(map.raster.pixels()[a]).total_cmp(&luminance(map.raster.pixels()[b]))).unwrap();
        let direction = map.direction(brightest % 256, brightest / 256);
        let expected = direction_at(60.0 * PI / 180.0, 200.0 * PI / 180.0);
        // One pixel is 1.4 degrees.
        assert!(direction.dot(expected) > elementary::cos(1.4 * PI / 180.0));
    }

    #[test]
    fn energy_does_not_depend_on_the_width() {
        let total = |width: usize| {
            let map = map(&SunSky::default(), width);
            (0..width / 2).map(|y| map.raster.row(y).iter().map(|&p| luminance(p)).sum::<f64>() * map.solid_angle(y)).sum::<f64>()
        };
        let (coarse, fine) = (total(64), total(1024));
        assert!((coarse / fine - 1.0).abs() < 0.01, "{coarse} {fine}");
    }

    #[test]
    fn a_clear_sky_is_blue_and_never_negative() {
        for (elevation, turbidity) in [(0.0, 2.0), (5.0, 10.0), (40.0, 3.0), (90.0, 2.0)] {
            let sky = SunSky { sun_elevation_degrees: elevation, turbidity, ..SunSky::default() };
            let map = map(&sky, 128);
            assert!(map.raster.pixels().iter().flatten().all(|value| value.is_finite() && *value >= 0.0));
        }
        let [r, _, b] = map(&SunSky::default(), 128).nearest(DVec3::Y);
        assert!(b > 1.5 * r, "{r} {b}");
    }
}

//! The sphere as a mirror, and its normals.

use glam::DVec3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::image::raster::Image;
use crate::light::envmap::EnvMap;
use crate::light::relight::sphere;

/// How a map is read between the centers of its pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Lookup {
    /// The pixel that contains the direction.
    Nearest,
    /// Between the four nearest pixel centers, around the horizon and across the poles.
    #[default]
    Bilinear,
}

/// How the components of a normal become a color.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Encoding {
    /// (n + 1) / 2, from 0 to 1: the coursework's 0 to 255 picture after `tone-map` with gamma 1.
    #[default]
    Unit,
    /// x, y and z as they are, from -1 to 1: data, not a picture.
    Raw,
}

/// A mirror sphere: the radiance from the direction in which each normal reflects the view.
///
/// r = 2 (n . v) n - v for v = +z, so r = (2 nz nx, 2 nz ny, 2 nz^2 - 1).
///
/// # Errors
/// What `check` gives.
pub fn mirror<E: Send>(map: &EnvMap, lookup: Lookup, size: usize, check: impl Fn() -> Result<(), E> + Sync) -> Result<Image, E> {
    let color = |normal: &DVec3| {
        let direction = reflected_view(*normal);
        match lookup {
            Lookup::Nearest => map.nearest(direction).map(f64::from),
            Lookup::Bilinear => map.bilinear(direction),
        }
    };
    sphere::picture(size, |line| {
        check()?;
        Ok(line.normals.iter().map(color).collect())
    })
}

/// The normals themselves, as colors.
///
/// # Errors
/// What `check` gives.
pub fn normals<E: Send>(encoding: Encoding, size: usize, check: impl Fn() -> Result<(), E> + Sync) -> Result<Image, E> {
    let color = |normal: &DVec3| match encoding {
        Encoding::Unit => ((*normal + 1.0) / 2.0).to_array(),
        Encoding::Raw => normal.to_array(),
    };
    sphere::picture(size, |line| {
        check()?;
        Ok(line.normals.iter().map(color).collect())
    })
}

/// Where a mirror with that normal shows a camera that looks along -z.
fn reflected_view(n: DVec3) -> DVec3 {
    DVec3::new(2.0 * n.z * n.x, 2.0 * n.z * n.y, 2.0 * n.z * n.z - 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::test_maps::{constant, noisy};

    #[test]
    fn the_center_of_a_mirror_shows_what_is_behind_the_camera() {
        let map = noisy(64, 32);
        let image = mirror(&map, Lookup::Nearest, 1, || Ok::<(), ()>(())).unwrap();
        assert_eq!(image.color.pixel(0, 0), map.nearest(DVec3::Z));
    }

    #[test]
    fn a_mirror_shows_each_direction_once_and_its_rim_what_is_behind_it() {
        assert!((reflected_view(DVec3::X) - DVec3::NEG_Z).length() < 1e-15);
        let diagonal = DVec3::new(0.0, 0.5_f64.sqrt(), 0.5_f64.sqrt());
        assert!((reflected_view(diagonal) - DVec3::Y).length() < 1e-15);
        let oblique = DVec3::new(0.3, -0.4, 0.75_f64.sqrt());
        assert!((reflected_view(oblique).length() - 1.0).abs() < 1e-15);
    }

    #[test]
    fn a_constant_map_makes_a_constant_mirror() {
        for lookup in [Lookup::Nearest, Lookup::Bilinear] {
            let image = mirror(&constant(8, 4, [0.25, 1.0, 3.0]), lookup, 21, || Ok::<(), ()>(())).unwrap();
            for index in (0..21 * 21).filter(|index| image.is_covered(*index)) {
                assert_eq!(image.color.pixels()[index], [0.25, 1.0, 3.0]);
            }
        }
    }

    #[test]
    fn normals_are_colors_from_0_to_1_or_as_they_are() {
        let unit = normals(Encoding::Unit, 3, || Ok::<(), ()>(())).unwrap();
        let raw = normals(Encoding::Raw, 3, || Ok::<(), ()>(())).unwrap();
        assert_eq!((unit.color.pixel(1, 1), raw.color.pixel(1, 1)), ([0.5, 0.5, 1.0], [0.0, 0.0, 1.0]));
        assert!(raw.color.pixel(0, 1)[0] < 0.0 && raw.color.pixel(1, 0)[1] > 0.0);
    }
}

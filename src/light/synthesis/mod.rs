//! Environment maps without a file: test patterns with known answers, skies, rooms.
//!
//! Every map is a function of direction, its parameters and the width alone: the same bytes on any
//! machine and for any thread count. Knows nothing of stages; see `stages::synthesize`.
//! Reading order: this file, `plain` (closed forms), `disk` (small bright sources), `sky`, `studio`, `cathedral`.

use rayon::prelude::*;

use crate::image::raster::Raster;
use crate::light::envmap::EnvMap;

pub mod cathedral;
pub mod disk;
pub mod plain;
pub mod sky;
pub mod studio;

/// Linear RGB radiance.
pub type Rgb = [f64; 3];

/// A map and its parameters.
#[derive(Debug, Clone, PartialEq)]
pub enum Synthetic {
    /// The same radiance everywhere.
    Constant(Rgb),
    /// Linear in height from bottom to top.
    Gradient(plain::Gradient),
    /// One pixel that differs from all others.
    OnePixel(plain::OnePixel),
    /// Squares in angle, alternately of two radiances.
    Checker(plain::Checker),
    /// A clear sky with the sun over a diffuse ground.
    SunSky(sky::SunSky),
    /// A dark room with softboxes.
    Studio,
    /// The interior of a gothic church; the number varies stone and glass.
    Cathedral(u64),
}

/// Names of all maps, in the order of the manual.
pub const NAMES: [&str; 7] = ["constant", "gradient", "one-pixel", "checker", "sun-sky", "studio", "cathedral"];

/// The smallest and the largest width of a map, in pixels; widths are even.
pub const WIDTHS: std::ops::RangeInclusive<usize> = 2..=65_536;

impl Synthetic {
    /// The map of that name with default parameters; `None` for a name not in [`NAMES`].
    pub fn named(name: &str) -> Option<Self> {
        Some(match name {
            "constant" => Self::Constant([1.0; 3]),
            "gradient" => Self::Gradient(plain::Gradient::default()),
            "one-pixel" => Self::OnePixel(plain::OnePixel::default()),
            "checker" => Self::Checker(plain::Checker::default()),
            "sun-sky" => Self::SunSky(sky::SunSky::default()),
            "studio" => Self::Studio,
            "cathedral" => Self::Cathedral(0),
            _ => return None,
        })
    }
}

/// Computes a map of `width` x `width / 2` pixels.
///
/// `check` is asked often and stops the work by its error.
///
/// # Panics
/// If `width` is odd or outside [`WIDTHS`], or a parameter outside its documented range.
pub fn synthesize<E: Send>(map: &Synthetic, width: usize, check: impl Fn() -> Result<(), E> + Sync) -> Result<EnvMap, E> {
    assert!(width.is_multiple_of(2) && WIDTHS.contains(&width), "a map's width is even and in range");
    match map {
        Synthetic::Constant(radiance) => plain::constant(*radiance, width, check),
        Synthetic::Gradient(gradient) => gradient.map(width, check),
        Synthetic::OnePixel(one_pixel) => one_pixel.map(width, check),
        Synthetic::Checker(checker) => checker.map(width, check),
        Synthetic::SunSky(sky) => sky.map(width, check),
        Synthetic::Studio => studio::map(width, check),
        Synthetic::Cathedral(seed) => cathedral::map(*seed, width, check),
    }
}

/// The map of that name with default parameters, for `synthetic:NAME`; `None` for a name not in [`NAMES`].
///
/// # Panics
/// As [`synthesize`].
pub fn by_name(name: &str, width: usize) -> Option<EnvMap> {
    let map = Synthetic::named(name)?;
    let Ok(map) = synthesize(&map, width, || Ok::<(), std::convert::Infallible>(()));
    Some(map)
}

/// Pixels computed between two questions to `check`: a few milliseconds of the slowest map.
const PIXELS_PER_CHECK: usize = 512;

/// Fills a map pixel by pixel: `pixel` gives the radiance of column x, row y.
pub(crate) fn filled<E: Send>(
    width: usize,
    check: impl Fn() -> Result<(), E> + Sync,
    pixel: impl Fn(usize, usize) -> [f32; 3] + Sync,
) -> Result<EnvMap, E> {
    let mut raster = Raster::filled(width, width / 2, [0.0; 3]);
    raster.pixels_mut().par_chunks_mut(width).enumerate().try_for_each(|(y, row)| {
        for (part, pixels) in row.chunks_mut(PIXELS_PER_CHECK).enumerate() {
            check()?;
            for (x, value) in pixels.iter_mut().enumerate() {
                *value = pixel(part * PIXELS_PER_CHECK + x, y);
            }
        }
        Ok(())
    })?;
    Ok(EnvMap::new(raster))
}

/// Single precision, as maps hold it.
pub(crate) fn single(color: Rgb) -> [f32; 3] {
    color.map(|channel| channel as f32)
}

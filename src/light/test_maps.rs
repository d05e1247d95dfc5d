//! Maps for the tests of this room.

use std::path::PathBuf;

use crate::image::raster::Raster;
use crate::light::envmap::EnvMap;
use crate::math::stream::{Purpose, Stream};

/// Noise over four decades with one window a thousand times brighter; no symmetry.
pub fn noisy(width: usize, height: usize) -> EnvMap {
    let stream = Stream::new(5, Purpose::Test);
    let pixel = |index: usize| {
        let mut numbers = stream.generator(index as u64);
        let is_window = index % width > width / 2 && index % width < width * 5 / 8 && index / width == height / 3;
        let scale = if is_window { 1000.0 } else { 1.0 };
        [(); 3].map(|()| {
            let uniform = numbers.uniform();
            (scale * uniform * uniform * uniform * uniform) as f32
        })
    };
    EnvMap::new(Raster::new(width, height, (0..width * height).map(pixel).collect()))
}

/// A map of one radiance.
pub fn constant(width: usize, height: usize, radiance: [f32; 3]) -> EnvMap {
    EnvMap::new(Raster::filled(width, height, radiance))
}

/// The shared Grace map, 1024 x 512; says so and gives `None` where the shared folder is absent.
pub fn grace() -> Option<EnvMap> {
    let shared =
        std::env::var_os("PIPELINE_SHARED").map_or_else(|| PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../shared")), PathBuf::from);
    let Ok(bytes) = std::fs::read(shared.join("data/envmaps/grace_latlong.pfm")) else {
        println!("skipped: no shared/data/envmaps/grace_latlong.pfm");
        return None;
    };
    // Little endian, bottom row first, after the header `PF\n1024 512\n-1.000000\n`.
    let (width, height) = (1024, 512);
    let values: Vec<f32> =
        bytes[bytes.len() - width * height * 12..].chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect();
    let pixels: Vec<[f32; 3]> = values.chunks_exact(3).map(|c| [c[0], c[1], c[2]]).collect();
    Some(EnvMap::new(Raster::new(width, height, pixels.chunks_exact(width).rev().flatten().copied().collect())))
}

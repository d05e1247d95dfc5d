//! What the modules share: levels of families of tests, and maps of the shared folder, where there is one.

use std::path::PathBuf;

use pipeline::image::raster::Raster;
use pipeline::light::envmap::EnvMap;
use pipeline::math::statistics::sidak_level;

/// So many tests that can fail by chance; together they do so once in a thousand seeds (Šidák).
#[derive(Debug, Clone, Copy)]
pub struct Family(pub u32);

impl Family {
    /// The level of each.
    pub fn level(self) -> f64 {
        sidak_level(0.001, self.0)
    }

    /// What is right must not be unlikely.
    #[track_caller]
    pub fn assert_plausible(self, what: &str, p_value: f64) {
        assert!(p_value > self.level(), "{what}: p = {p_value:e}, level {:e}", self.level());
    }

    /// Controls must be refused by far: a millionth of the level, so that they are not a matter of the seed.
    #[track_caller]
    pub fn assert_refused(self, what: &str, p_value: f64) {
        assert!(p_value < 1e-6 * self.level(), "{what} was not noticed: p = {p_value:e}");
    }
}

/// The map in that little-endian color PFM of `../shared/data/envmaps`; says so and gives `None` where it is absent.
///
/// Read by a few lines of its own, so that the laws of light do not hang on the readers of files.
pub fn map(name: &str) -> Option<EnvMap> {
    let folder = std::env::var_os("PIPELINE_SHARED").map(PathBuf::from);
    let folder = folder.unwrap_or_else(|| PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../shared"));
    let path = folder.join("data/envmaps").join(name);
    let Ok(bytes) = std::fs::read(&path) else {
        println!("skipped: no {}", path.display());
        return None;
    };
    let mut lines = bytes.splitn(4, |&byte| byte == b'\n');
    let mut line = || std::str::from_utf8(lines.next().unwrap()).unwrap().trim();
    assert_eq!(line(), "PF");
    let sizes: Vec<usize> = line().split_whitespace().map(|size| size.parse().unwrap()).collect();
    assert!(line().parse::<f64>().unwrap() < 0.0, "little endian");
    let channel = |bytes: &[u8]| f32::from_le_bytes(bytes.try_into().unwrap());
    let pixel = |bytes: &[u8]| [channel(&bytes[..4]), channel(&bytes[4..8]), channel(&bytes[8..])];
    let from_below: Vec<[f32; 3]> = lines.next().unwrap().chunks_exact(12).map(pixel).collect();
    let pixels = from_below.chunks(sizes[0]).rev().flatten().copied().collect();
    Some(EnvMap::new(Raster::new(sizes[0], sizes[1], pixels)))
}

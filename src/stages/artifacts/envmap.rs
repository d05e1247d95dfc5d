//! `envmap`: a lat-long map of radiance.
//!
//! Bytes: magic, which direction a pixel stands for, the size, then the pixels as in `image`.

use std::io::{self, Read, Write};

use super::image::{check_end, check_magic, invalid, raster_memory, read_array, read_raster, read_size, saved, write_colors, write_size};
use crate::engine::artifact::{Artifact, Origin, SaveError, Saved, TypeName};
use crate::formats;
use crate::image::raster::Image;
use crate::light::envmap::{Angles, EnvMap};

const MAGIC: &[u8; 8] = b"envmap\0\x01";

impl Artifact for EnvMap {
    const TYPE: TypeName = "envmap";
    const FORMATS: &'static [&'static str] = &["exr", "hdr", "pfm", "png"];

    fn write(&self, out: &mut dyn Write) -> io::Result<()> {
        let angles = match self.angles {
            Angles::Center => 0,
            Angles::Edge => 1,
            Angles::EdgeInclusive => 2,
        };
        out.write_all(MAGIC)?;
        out.write_all(&[angles])?;
        write_size(self.width(), self.height(), out)?;
        write_colors(self.raster.pixels(), out)
    }

    fn read(input: &mut dyn Read) -> io::Result<Self> {
        check_magic(MAGIC, input)?;
        let angles = match read_array(input)? {
            [0] => Angles::Center,
            [1] => Angles::Edge,
            [2] => Angles::EdgeInclusive,
            _ => return Err(invalid("unknown angles")),
        };
        let (width, height) = read_size(input)?;
        let raster = read_raster(width, height, input)?;
        check_end(input)?;
        Ok(Self { raster, angles })
    }

    fn memory(&self) -> u64 {
        raster_memory(&self.raster)
    }

    fn save(&self, format: &str, origin: &Origin) -> Result<Saved, SaveError> {
        saved(formats::encode(&Image::opaque(self.raster.clone()), format, &origin.entries()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::raster::Raster;

    fn bytes(map: &EnvMap) -> Vec<u8> {
        let mut bytes = Vec::new();
        map.write(&mut bytes).unwrap();
        bytes
    }

    #[test]
    fn a_map_comes_back_with_its_angles() {
        for angles in [Angles::Center, Angles::Edge, Angles::EdgeInclusive] {
            let raster = Raster::new(4, 2, (0..8).map(|index| [index as f32, -1.0, 1e-40]).collect());
            let map = EnvMap { raster, angles };
            assert_eq!(EnvMap::read(&mut bytes(&map).as_slice()).unwrap(), map);
        }
    }

    #[test]
    fn bytes_cut_anywhere_are_refused() {
        let bytes = bytes(&EnvMap::new(Raster::filled(3, 2, [1.0; 3])));
        assert!((0..bytes.len()).all(|end| EnvMap::read(&mut &bytes[..end]).is_err()));
    }

    #[test]
    fn every_format_of_the_table_can_be_saved() {
        let map = EnvMap::new(Raster::filled(4, 2, [0.5; 3]));
        for format in EnvMap::FORMATS {
            let saved = map.save(format, &Origin::default()).unwrap();
            assert_eq!(saved.warnings, [""; 0], "{format}");
        }
    }
}

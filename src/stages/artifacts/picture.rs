//! `picture`: encoded RGB for a display, with 8 or 16 bits a channel.
//!
//! Bytes: magic, depth, whether there is alpha, the size, the colors, then the alpha.

use std::io::{self, Read, Write};

use super::image::{check_end, check_magic, invalid, read_array, read_flag, read_pieces, read_size, saved, write_size};
use crate::engine::artifact::{Artifact, Origin, SaveError, Saved, TypeName};
use crate::formats;
use crate::image::raster::{Picture, PictureSamples};

const MAGIC: &[u8; 8] = b"picture\x01";

impl Artifact for Picture {
    const TYPE: TypeName = "picture";
    const FORMATS: &'static [&'static str] = &["png", "ppm"];

    fn write(&self, out: &mut dyn Write) -> io::Result<()> {
        let depth = match self.samples {
            PictureSamples::Eight(_) => 8,
            PictureSamples::Sixteen(_) => 16,
        };
        out.write_all(MAGIC)?;
        out.write_all(&[depth, u8::from(self.alpha.is_some())])?;
        write_size(self.width, self.height, out)?;
        match &self.samples {
            PictureSamples::Eight(samples) => out.write_all(samples.as_flattened())?,
            PictureSamples::Sixteen(samples) => write_shorts(samples.as_flattened(), out)?,
        }
        self.alpha.as_ref().map_or(Ok(()), |alpha| write_shorts(alpha, out))
    }

    fn read(input: &mut dyn Read) -> io::Result<Self> {
        check_magic(MAGIC, input)?;
        let depth = read_array(input)?;
        let has_alpha = read_flag(input)?;
        let (width, height) = read_size(input)?;
        let samples = match depth {
            [8] => PictureSamples::Eight(read_pieces(width * height, input, |bytes: [u8; 3]| bytes)?),
            [16] => PictureSamples::Sixteen(read_pieces(width * height, input, |bytes: [u8; 6]| {
                [0, 2, 4].map(|at| u16::from_le_bytes([bytes[at], bytes[at + 1]]))
            })?),
            _ => return Err(invalid("the depth is neither 8 nor 16")),
        };
        let alpha = if has_alpha { Some(read_pieces(width * height, input, u16::from_le_bytes)?) } else { None };
        check_end(input)?;
        Ok(Self { width, height, samples, alpha })
    }

    fn memory(&self) -> u64 {
        let samples = match &self.samples {
            PictureSamples::Eight(samples) => 3 * samples.len(),
            PictureSamples::Sixteen(samples) => 6 * samples.len(),
        };
        (samples + self.alpha.as_ref().map_or(0, |alpha| 2 * alpha.len())) as u64
    }

    fn save(&self, format: &str, origin: &Origin) -> Result<Saved, SaveError> {
        saved(formats::encode_picture(self, format, &origin.entries()))
    }
}

fn write_shorts(values: &[u16], out: &mut dyn Write) -> io::Result<()> {
    const PIECE: usize = 1 << 15;
    let mut buffer = Vec::with_capacity(2 * PIECE.min(values.len()));
    for piece in values.chunks(PIECE) {
        buffer.clear();
        buffer.extend(piece.iter().flat_map(|value| value.to_le_bytes()));
        out.write_all(&buffer)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn samples() -> [Picture; 2] {
        let eight = PictureSamples::Eight((0..6).map(|index| [index, 2 * index, 255 - index]).collect());
        let sixteen = PictureSamples::Sixteen((0..6).map(|index| [index, 2 * index, 65_535 - index]).collect());
        let alpha = Some(vec![0, 1, 2, 3, 4, 255]);
        [Picture { width: 3, height: 2, samples: eight, alpha }, Picture { width: 2, height: 3, samples: sixteen, alpha: None }]
    }

    fn bytes(picture: &Picture) -> Vec<u8> {
        let mut bytes = Vec::new();
        picture.write(&mut bytes).unwrap();
        bytes
    }

    #[test]
    fn a_picture_comes_back() {
        for picture in samples() {
            assert_eq!(Picture::read(&mut bytes(&picture).as_slice()).unwrap(), picture);
        }
    }

    #[test]
    fn bytes_cut_anywhere_are_refused() {
        for picture in samples() {
            let bytes = bytes(&picture);
            assert!((0..bytes.len()).all(|end| Picture::read(&mut &bytes[..end]).is_err()));
        }
    }

    #[test]
    fn every_format_of_the_table_can_be_saved() {
        for format in Picture::FORMATS {
            assert!(!samples()[0].save(format, &Origin::default()).unwrap().bytes.is_empty(), "{format}");
        }
    }
}

//! `image`: linear RGB with alpha and layers; and the canonical bytes of rasters, which other types share.
//!
//! Bytes: magic, flags, sizes, then floats by their bits, rows from the top, little endian. Written and read
//! in pieces, so that an artifact needs no second copy of itself, and a wrong size no room.

use std::io::{self, Read, Write};

use crate::engine::artifact::{Artifact, Origin, SaveError, Saved, TypeName};
use crate::formats;
use crate::image::raster::{Image, Layer, Plane, Raster};

const MAGIC: &[u8; 8] = b"image\0\0\x01";

impl Artifact for Image {
    const TYPE: TypeName = "image";
    const FORMATS: &'static [&'static str] = &["exr", "hdr", "pfm", "npy", "png"];

    fn write(&self, out: &mut dyn Write) -> io::Result<()> {
        out.write_all(MAGIC)?;
        write_size(self.color.width(), self.color.height(), out)?;
        out.write_all(&[u8::from(self.alpha.is_some())])?;
        out.write_all(&(self.layers.len() as u32).to_le_bytes())?;
        write_colors(self.color.pixels(), out)?;
        if let Some(alpha) = &self.alpha {
            write_floats(&alpha.values, out)?;
        }
        self.layers.iter().try_for_each(|(name, layer)| write_layer(name, layer, out))
    }

    fn read(input: &mut dyn Read) -> io::Result<Self> {
        check_magic(MAGIC, input)?;
        let (width, height) = read_size(input)?;
        let has_alpha = read_flag(input)?;
        let layer_count = u32::from_le_bytes(read_array(input)?);
        let color = read_raster(width, height, input)?;
        let alpha = if has_alpha { Some(read_plane(width, height, input)?) } else { None };
        let mut image = Self { color, alpha, layers: Default::default() };
        for _ in 0..layer_count {
            let (name, layer) = read_layer(width, height, input)?;
            if image.layers.last_key_value().is_some_and(|(last, _)| *last >= name) {
                return Err(invalid("layers are not in order"));
            }
            image.layers.insert(name, layer);
        }
        check_end(input)?;
        Ok(image)
    }

    fn memory(&self) -> u64 {
        let layer = |layer: &Layer| match layer {
            Layer::Color(raster) => raster_memory(raster),
            Layer::Scalar(plane) => 4 * plane.values.len() as u64,
        };
        let alpha = self.alpha.as_ref().map_or(0, |alpha| 4 * alpha.values.len() as u64);
        raster_memory(&self.color) + alpha + self.layers.values().map(layer).sum::<u64>()
    }

    fn save(&self, format: &str, origin: &Origin) -> Result<Saved, SaveError> {
        saved(formats::encode(self, format, &origin.entries()))
    }
}

fn write_layer(name: &str, layer: &Layer, out: &mut dyn Write) -> io::Result<()> {
    out.write_all(&(name.len() as u32).to_le_bytes())?;
    out.write_all(name.as_bytes())?;
    match layer {
        Layer::Scalar(plane) => {
            out.write_all(&[0])?;
            write_floats(&plane.values, out)
        }
        Layer::Color(raster) => {
            out.write_all(&[1])?;
            write_colors(raster.pixels(), out)
        }
    }
}

fn read_layer(width: usize, height: usize, input: &mut dyn Read) -> io::Result<(String, Layer)> {
    const LONGEST_NAME: u32 = 1024;
    let size = u32::from_le_bytes(read_array(input)?);
    if size > LONGEST_NAME {
        return Err(invalid("a layer's name is too long"));
    }
    let mut name = vec![0; size as usize];
    input.read_exact(&mut name).map_err(ended)?;
    let name = String::from_utf8(name).map_err(|_| invalid("a layer's name is not text"))?;
    let layer =
        if read_flag(input)? { Layer::Color(read_raster(width, height, input)?) } else { Layer::Scalar(read_plane(width, height, input)?) };
    Ok((name, layer))
}

/// Bytes of a raster in memory.
pub fn raster_memory(raster: &Raster) -> u64 {
    12 * raster.pixels().len() as u64
}

/// What `save` gives for what a format gives.
pub fn saved(encoded: Result<formats::Encoded, formats::FormatError>) -> Result<Saved, SaveError> {
    let (bytes, warnings) = encoded.map_err(|error| SaveError(error.to_string()))?;
    Ok(Saved { bytes, warnings })
}

/// Width and height, 8 bytes each.
pub fn write_size(width: usize, height: usize, out: &mut dyn Write) -> io::Result<()> {
    out.write_all(&(width as u64).to_le_bytes())?;
    out.write_all(&(height as u64).to_le_bytes())
}

/// Width and height, if their pixels could be counted in memory.
pub fn read_size(input: &mut dyn Read) -> io::Result<(usize, usize)> {
    let (width, height) = (u64::from_le_bytes(read_array(input)?), u64::from_le_bytes(read_array(input)?));
    let is_countable = width.checked_mul(height).and_then(|count| count.checked_mul(64)).is_some_and(|size| size < 1 << 50);
    if is_countable { Ok((width as usize, height as usize)) } else { Err(invalid("the size is out of bounds")) }
}

/// All pixels of a raster.
pub fn write_colors(pixels: &[[f32; 3]], out: &mut dyn Write) -> io::Result<()> {
    write_floats(pixels.as_flattened(), out)
}

/// A raster of a size that was read before.
pub fn read_raster(width: usize, height: usize, input: &mut dyn Read) -> io::Result<Raster> {
    let pixels = read_pieces(width * height, input, |bytes: [u8; 12]| {
        let [r, g, b] = [0, 4, 8].map(|at| f32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]]));
        [r, g, b]
    })?;
    Ok(Raster::new(width, height, pixels))
}

/// The first bytes of a type, which name it and its version.
pub fn check_magic(magic: &[u8; 8], input: &mut dyn Read) -> io::Result<()> {
    if read_array::<8>(input)? == *magic { Ok(()) } else { Err(invalid("the bytes are of another type or version")) }
}

/// That nothing follows.
pub fn check_end(input: &mut dyn Read) -> io::Result<()> {
    match input.read(&mut [0])? {
        0 => Ok(()),
        _ => Err(invalid("bytes follow the end")),
    }
}

/// A byte that is 0 or 1.
pub fn read_flag(input: &mut dyn Read) -> io::Result<bool> {
    match read_array(input)? {
        [0] => Ok(false),
        [1] => Ok(true),
        _ => Err(invalid("a flag is neither 0 nor 1")),
    }
}

/// The next N bytes.
pub fn read_array<const N: usize>(input: &mut dyn Read) -> io::Result<[u8; N]> {
    let mut bytes = [0; N];
    input.read_exact(&mut bytes).map_err(ended)?;
    Ok(bytes)
}

/// Values of N bytes each. Room is taken as bytes come, never for what a header only promises.
pub fn read_pieces<T, const N: usize>(count: usize, input: &mut dyn Read, value: impl Fn([u8; N]) -> T) -> io::Result<Vec<T>> {
    const PIECE: usize = 1 << 16;
    let mut buffer = vec![0; PIECE.min(count) * N];
    let mut values = Vec::new();
    while values.len() < count {
        let piece = &mut buffer[..(count - values.len()).min(PIECE) * N];
        input.read_exact(piece).map_err(ended)?;
        values.extend(piece.as_chunks::<N>().0.iter().map(|bytes| value(*bytes)));
    }
    values.shrink_to_fit();
    Ok(values)
}

/// Bytes that are not what they should be.
pub fn invalid(problem: &str) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, problem)
}

fn ended(error: io::Error) -> io::Error {
    if error.kind() == io::ErrorKind::UnexpectedEof { invalid("the bytes end too early") } else { error }
}

fn read_plane(width: usize, height: usize, input: &mut dyn Read) -> io::Result<Plane> {
    Ok(Plane { width, height, values: read_pieces(width * height, input, f32::from_le_bytes)? })
}

fn write_floats(values: &[f32], out: &mut dyn Write) -> io::Result<()> {
    const PIECE: usize = 1 << 14;
    let mut buffer = Vec::with_capacity(4 * PIECE.min(values.len()));
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

    fn sample() -> Image {
        let plane = |seed: f32| Plane { width: 3, height: 2, values: (0..6).map(|index| seed + index as f32).collect() };
        let layers =
            [("depth".to_owned(), Layer::Scalar(plane(9.0))), ("variance".to_owned(), Layer::Color(Raster::filled(3, 2, [0.5; 3])))];
        Image { color: Raster::filled(3, 2, [1.0, f32::MIN_POSITIVE, -0.0]), alpha: Some(plane(0.0)), layers: layers.into() }
    }

    fn bytes(image: &Image) -> Vec<u8> {
        let mut bytes = Vec::new();
        image.write(&mut bytes).unwrap();
        bytes
    }

    #[test]
    fn an_image_comes_back_with_all_it_has() {
        for image in [sample(), Image::opaque(Raster::filled(1, 1, [2.0; 3]))] {
            assert_eq!(Image::read(&mut bytes(&image).as_slice()).unwrap(), image);
        }
    }

    #[test]
    fn bytes_cut_anywhere_or_followed_by_more_are_refused() {
        let bytes = bytes(&sample());
        for end in 0..bytes.len() {
            let error = Image::read(&mut &bytes[..end]).unwrap_err();
            assert_eq!(error.kind(), io::ErrorKind::InvalidData, "{end}");
        }
        assert!(Image::read(&mut [bytes.as_slice(), &[0]].concat().as_slice()).is_err());
    }

    #[test]
    fn a_header_that_promises_terabytes_takes_no_room() {
        let mut bytes = bytes(&sample());
        bytes[8..16].copy_from_slice(&(1u64 << 22).to_le_bytes());
        bytes[16..24].copy_from_slice(&(1u64 << 20).to_le_bytes());
        assert!(Image::read(&mut bytes.as_slice()).is_err());
        bytes[8..24].fill(0xff);
        assert!(Image::read(&mut bytes.as_slice()).is_err());
    }

    #[test]
    fn every_format_of_the_table_can_be_saved() {
        for format in Image::FORMATS {
            assert!(!sample().save(format, &Origin::default()).unwrap().bytes.is_empty(), "{format}");
        }
        assert!(sample().save("gif", &Origin::default()).is_err());
    }
}

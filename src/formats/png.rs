//! PNG: pictures with 8 or 16 bits a channel and alpha, and text about their origin.
//!
//! Every depth, palette, transparency and interlacing is read; the crate `png` decodes. Linear light is
//! clipped and sRGB-encoded when it is written. No color chunk is written: a picture's curve is its stage's.
//!
//! After W3C, "Portable Network Graphics specification" (third edition, 2025).

use std::io::Cursor;

use ::png::{BitDepth, ColorType, Compression, Decoder, DecodingError, Encoder, Transformations};

use super::{Decoded, ENTRY_PREFIX, Encoded, Entry, Format, FormatError, Limits};
use crate::image::display;
use crate::image::raster::{Image, Picture, PictureSamples};

/// The row of this format.
pub const FORMAT: Format = Format {
    name: "png",
    title: TITLE,
    extensions: &["png"],
    sniff: |bytes| bytes.starts_with(&SIGNATURE),
    read,
    write,
    write_picture: Some(write_picture),
    origin,
};

const TITLE: &str = "PNG";
const SIGNATURE: [u8; 8] = [0x89, b'P', b'N', b'G', b'\r', b'\n', 0x1a, b'\n'];

/// Reads the first frame.
pub fn read(bytes: &[u8], limits: &Limits) -> Result<Decoded, FormatError> {
    let mut decoder = Decoder::new(Cursor::new(bytes));
    decoder.set_ignore_text_chunk(true);
    decoder.set_ignore_iccp_chunk(true);
    decoder.set_transformations(Transformations::EXPAND);
    let header = decoder.read_header_info().map_err(|error| translated(&error))?;
    let (width, height) = limits.checked(TITLE, header.width.into(), header.height.into())?;
    let facts = vec![
        ("color type".to_owned(), format!("{:?}", header.color_type).to_lowercase()),
        ("bits a channel".to_owned(), (header.bit_depth as u8).to_string()),
        ("interlaced".to_owned(), if header.interlaced { "yes".into() } else { "no".into() }),
    ];
    check_plausible(bytes.len(), header.raw_bytes())?;

    let mut reader = decoder.read_info().map_err(|error| translated(&error))?;
    let size = reader.output_buffer_size().ok_or_else(|| FormatError::damaged(TITLE, "size in the header is too large"))?;
    let mut data = vec![0; size];
    reader.next_frame(&mut data).map_err(|error| translated(&error))?;

    let (color_type, depth) = reader.output_color_type();
    let (samples, alpha) = match depth {
        BitDepth::Sixteen => {
            let values: Vec<u16> = data.as_chunks::<2>().0.iter().map(|pair| u16::from_be_bytes(*pair)).collect();
            let (colors, alpha) = split(&values, color_type);
            (PictureSamples::Sixteen(colors), alpha)
        }
        _ => {
            let (colors, alpha) = split(&data, color_type);
            (PictureSamples::Eight(colors), alpha)
        }
    };
    let mut decoded = Decoded::display(FORMAT.name, Picture { width, height, samples, alpha });
    decoded.facts = facts;
    let trailing = chunks(bytes).last().filter(|chunk| chunk.kind == b"IEND").map(|chunk| bytes.len() - chunk.end);
    decoded.warnings.extend(super::trailing_warning(trailing.unwrap_or(0)));
    Ok(decoded)
}

/// Writes linear light as a picture of 8 bits, clipped and sRGB-encoded, with its alpha.
pub fn write(image: &Image, entries: &[Entry<'_>]) -> Result<Encoded, FormatError> {
    let (picture, mut warnings) = display::encoded(image);
    warnings.extend(super::layers_left_out(image, TITLE));
    Ok((write_picture(&picture, entries)?.0, warnings))
}

/// Writes a picture with its depth and alpha.
pub fn write_picture(picture: &Picture, entries: &[Entry<'_>]) -> Result<Encoded, FormatError> {
    let side = |count: usize| u32::try_from(count).map_err(|_| FormatError::Unwritable(format!("{count} pixels are too many for PNG")));
    let mut bytes = Vec::new();
    let mut encoder = Encoder::new(&mut bytes, side(picture.width)?, side(picture.height)?);
    // A run writes hundreds of pictures: ten times the speed for files a tenth larger.
    encoder.set_compression(Compression::Fast);
    encoder.set_color(if picture.alpha.is_some() { ColorType::Rgba } else { ColorType::Rgb });
    for (name, text) in entries {
        let keyword = format!("{ENTRY_PREFIX}{name}");
        // Plain text chunks are Latin-1, and readers differ beyond ASCII.
        if text.is_ascii() { encoder.add_text_chunk(keyword, (*text).into()) } else { encoder.add_itxt_chunk(keyword, (*text).into()) }
            .map_err(|error| FormatError::Unwritable(format!("PNG: {error}")))?;
    }
    let (depth, data) = match &picture.samples {
        PictureSamples::Eight(samples) => (BitDepth::Eight, joined(samples, &picture.alpha, |value, out| out.push(value as u8))),
        PictureSamples::Sixteen(samples) => {
            (BitDepth::Sixteen, joined(samples, &picture.alpha, |value, out| out.extend(value.to_be_bytes())))
        }
    };
    encoder.set_depth(depth);
    let mut writer = encoder.write_header().map_err(|error| FormatError::Unwritable(format!("PNG: {error}")))?;
    let written = writer.write_image_data(&data).and_then(|()| writer.finish());
    written.map_err(|error| FormatError::Unwritable(format!("PNG: {error}")))?;
    Ok((bytes, Vec::new()))
}

/// The text chunks that say where a file comes from.
pub fn origin(bytes: &[u8]) -> Vec<(String, String)> {
    chunks(bytes).filter_map(|chunk| chunk.entry()).collect()
}

/// Deflate packs at most 1032 bytes into one: pixels beyond that are not in the file, and get no room.
fn check_plausible(file_size: usize, raw_size: usize) -> Result<(), FormatError> {
    const LARGEST_RATIO: usize = 1032;
    if raw_size / LARGEST_RATIO > file_size {
        let problem = format!("{file_size} bytes cannot hold the {raw_size} bytes of pixels that the size in the header asks for");
        return Err(FormatError::truncated(TITLE, problem));
    }
    Ok(())
}

/// Colors and alpha of interleaved values; grey becomes three equal channels.
fn split<T: Copy + Into<u16>>(values: &[T], color_type: ColorType) -> (Vec<[T; 3]>, Option<Vec<u16>>) {
    let channels = color_type.samples();
    let pixels = values.chunks_exact(channels);
    let colors = pixels.clone().map(|pixel| if channels < 3 { [pixel[0]; 3] } else { [pixel[0], pixel[1], pixel[2]] }).collect();
    let has_alpha = matches!(color_type, ColorType::GrayscaleAlpha | ColorType::Rgba);
    (colors, has_alpha.then(|| pixels.map(|pixel| pixel[channels - 1].into()).collect()))
}

fn joined<T: Copy + Into<u16>>(samples: &[[T; 3]], alpha: &Option<Vec<u16>>, push: impl Fn(u16, &mut Vec<u8>)) -> Vec<u8> {
    let mut out = Vec::with_capacity(samples.len() * 4 * size_of::<T>());
    for (index, pixel) in samples.iter().enumerate() {
        pixel.iter().for_each(|value| push((*value).into(), &mut out));
        if let Some(alpha) = alpha {
            push(alpha[index], &mut out);
        }
    }
    out
}

struct ChunkAt<'a> {
    kind: &'a [u8],
    data: &'a [u8],
    /// Position of the byte after its checksum.
    end: usize,
}

impl ChunkAt<'_> {
    fn entry(&self) -> Option<(String, String)> {
        let mut parts = self.data.splitn(2, |byte| *byte == 0);
        let name = std::str::from_utf8(parts.next()?).ok()?.strip_prefix(ENTRY_PREFIX)?;
        let rest = parts.next()?;
        let text = match self.kind {
            // ISO 8859-1, whose bytes are the first characters of Unicode.
            b"tEXt" => rest.iter().copied().map(char::from).collect(),
            // Uncompressed, then the ends of the language and of the translated keyword.
            b"iTXt" => String::from_utf8_lossy(rest.strip_prefix(&[0, 0])?.splitn(3, |byte| *byte == 0).nth(2)?).into_owned(),
            _ => return None,
        };
        Some((name.to_owned(), text))
    }
}

/// The whole chunks of a file up to its end mark.
fn chunks(bytes: &[u8]) -> impl Iterator<Item = ChunkAt<'_>> {
    let mut position = SIGNATURE.len();
    let mut has_ended = false;
    std::iter::from_fn(move || {
        let head = bytes.get(position..position + 8).filter(|_| !has_ended)?;
        let size = u32::from_be_bytes(head[..4].try_into().expect("four bytes")) as usize;
        let data = bytes.get(position + 8..position + 8 + size)?;
        position += 12 + size;
        has_ended = head[4..] == *b"IEND";
        (position <= bytes.len()).then_some(ChunkAt { kind: &head[4..], data, end: position })
    })
}

fn translated(error: &DecodingError) -> FormatError {
    match error {
        DecodingError::IoError(error) if error.kind() == std::io::ErrorKind::UnexpectedEof => {
            FormatError::truncated(TITLE, "end of the file within the image")
        }
        other => FormatError::damaged(TITLE, format!("invalid: {}", super::escaped(&other.to_string()))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::Content;

    fn picture(bytes: &[u8]) -> Picture {
        let Content::Display(picture) = read(bytes, &Limits::default()).unwrap().content else { panic!("a PNG is a picture") };
        picture
    }

    #[test]
    fn both_depths_come_back_with_and_without_alpha() {
        let eight = PictureSamples::Eight((0..6).map(|index| [index, 2 * index, 255 - index]).collect());
        let sixteen = PictureSamples::Sixteen((0..6).map(|index| [index, 2 * index, 65_535 - index]).collect());
        for samples in [eight, sixteen] {
            for alpha in [None, Some(vec![0, 1, 2, 3, 4, 255])] {
                let original = Picture { width: 3, height: 2, samples: samples.clone(), alpha };
                assert_eq!(picture(&write_picture(&original, &[]).unwrap().0), original);
            }
        }
    }

    #[test]
    fn the_origin_is_found_again() {
        let entries = [("pipeline", "cøursework"), ("stage", "sphere"), ("coordinate", ""), ("key", "ab12")];
        let samples = PictureSamples::Eight(vec![[0; 3]]);
        let bytes = write_picture(&Picture { width: 1, height: 1, samples, alpha: None }, &entries).unwrap().0;
        let mut found = origin(&bytes);
        let mut expected = entries.map(|(name, text)| (name.to_owned(), text.to_owned())).to_vec();
        found.sort();
        expected.sort();
        assert_eq!(found, expected);
    }
}

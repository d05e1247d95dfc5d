//! NumPy arrays: a text header with type and shape, then the numbers, little endian in C order.
//!
//! Reads arrays of 32-bit floats with the shape of an image: (h, w), (h, w, 1), (h, w, 3) and (h, w, 4), whose
//! last channel is alpha. Writes those, and any shape of 32- and 64-bit floats for tables.
//!
//! After NumPy, "A simple file format for NumPy arrays" (NEP 1, versions 1.0 to 3.0).

use rayon::prelude::*;

use super::{Decoded, Encoded, Entry, Format, FormatError, Limits};
use crate::image::raster::{Image, Plane, Raster};

/// The row of this format.
pub const FORMAT: Format = Format {
    name: "npy",
    title: TITLE,
    extensions: &["npy"],
    sniff: |bytes| bytes.starts_with(MAGIC),
    read,
    write,
    write_picture: None,
    origin: super::no_origin,
};

const TITLE: &str = "NPY";
const MAGIC: &[u8] = b"\x93NUMPY";
const LONGEST_HEADER: usize = 1 << 16;

/// Reads an image.
pub fn read(bytes: &[u8], limits: &Limits) -> Result<Decoded, FormatError> {
    let (header, data) = header(bytes)?;
    check_numbers(header)?;
    let (height, width, channels) = image_shape(header)?;
    let (width, height) = limits.checked(TITLE, width, height)?;
    let size = width * height * channels * 4;
    if data.len() < size {
        return Err(FormatError::truncated(TITLE, format!("{} of {size} bytes of numbers are there", data.len())));
    }

    let number = |pixel: &[u8], channel: usize| {
        let at = 4 * channel;
        f32::from_le_bytes([pixel[at], pixel[at + 1], pixel[at + 2], pixel[at + 3]])
    };
    let mut pixels = vec![[0.0; 3]; width * height];
    pixels.par_iter_mut().zip(data[..size].par_chunks_exact(4 * channels)).for_each(|(pixel, bytes)| {
        *pixel = [0, 1, 2].map(|channel| number(bytes, if channels < 3 { 0 } else { channel }));
    });
    let mut image = Image::opaque(Raster::new(width, height, pixels));
    if channels == 4 {
        let values = data[..size].chunks_exact(16).map(|bytes| number(bytes, 3)).collect();
        image.alpha = Some(Plane { width, height, values });
    }
    let mut decoded = Decoded::linear(FORMAT.name, image);
    decoded.warnings.extend(super::trailing_warning(data.len() - size));
    decoded.facts = vec![("channels".into(), channels.to_string())];
    Ok(decoded)
}

/// Writes an image as (h, w, 3), or (h, w, 4) where it has alpha.
pub fn write(image: &Image, _: &[Entry<'_>]) -> Result<Encoded, FormatError> {
    let color = &image.color;
    let channels = if image.alpha.is_some() { 4 } else { 3 };
    let mut bytes = preamble("<f4", &[color.height(), color.width(), channels]);
    bytes.reserve_exact(color.pixels().len() * channels * 4);
    for (index, pixel) in color.pixels().iter().enumerate() {
        bytes.extend(pixel.iter().flat_map(|value| value.to_le_bytes()));
        if let Some(alpha) = &image.alpha {
            bytes.extend(alpha.values[index].to_le_bytes());
        }
    }
    Ok((bytes, super::layers_left_out(image, TITLE)))
}

/// An array of 64-bit floats; `shape` from the slowest to the fastest index.
///
/// # Panics
/// If the product of `shape` is not the number of values.
pub fn write_f64(shape: &[usize], values: &[f64]) -> Vec<u8> {
    assert_eq!(shape.iter().product::<usize>(), values.len(), "a shape covers its values");
    let mut bytes = preamble("<f8", shape);
    bytes.reserve_exact(values.len() * 8);
    bytes.extend(values.iter().flat_map(|value| value.to_le_bytes()));
    bytes
}

/// An array of 32-bit floats; `shape` from the slowest to the fastest index.
///
/// # Panics
/// If the product of `shape` is not the number of values.
pub fn write_f32(shape: &[usize], values: &[f32]) -> Vec<u8> {
    assert_eq!(shape.iter().product::<usize>(), values.len(), "a shape covers its values");
    let mut bytes = preamble("<f4", shape);
    bytes.reserve_exact(values.len() * 4);
    bytes.extend(values.iter().flat_map(|value| value.to_le_bytes()));
    bytes
}

/// A table with named columns of 64-bit floats (a structured array of one dimension), given row by row.
///
/// # Panics
/// If `values` is not a whole number of rows.
pub fn write_columns(names: &[&str], values: &[f64]) -> Vec<u8> {
    let row_count = values.len().checked_div(names.len()).unwrap_or(0);
    assert_eq!(row_count * names.len(), values.len(), "a table has whole rows");
    let fields: Vec<_> = names.iter().map(|name| format!("('{}', '<f8')", name.replace(['\\', '\''], "_"))).collect();
    let mut bytes = preamble_of_type(&format!("[{}]", fields.join(", ")), &[row_count]);
    bytes.reserve_exact(values.len() * 8);
    bytes.extend(values.iter().flat_map(|value| value.to_le_bytes()));
    bytes
}

fn preamble(number: &str, shape: &[usize]) -> Vec<u8> {
    preamble_of_type(&format!("'{number}'"), shape)
}

/// Magic, version and header, padded so that the numbers begin at a multiple of 64.
fn preamble_of_type(number: &str, shape: &[usize]) -> Vec<u8> {
    let sides: String = shape.iter().map(|side| format!("{side}, ")).collect();
    // A tuple of one keeps its comma; numpy writes the others without the last.
    let sides = if shape.len() == 1 { sides.trim_end() } else { sides.trim_end_matches(", ") };
    let header = format!("{{'descr': {number}, 'fortran_order': False, 'shape': ({sides}), }}");
    let size_bytes = if header.len() < 60_000 { 2 } else { 4 };
    let start = MAGIC.len() + 2 + size_bytes;
    let padded = (start + header.len() + 1).next_multiple_of(64) - start;
    let mut bytes = MAGIC.to_vec();
    bytes.extend([if size_bytes == 2 { 1 } else { 2 }, 0]);
    bytes.extend(&(padded as u32).to_le_bytes()[..size_bytes]);
    bytes.extend(format!("{header:<width$}\n", width = padded - 1).into_bytes());
    bytes
}

/// The header's text and what follows it.
fn header(bytes: &[u8]) -> Result<(&str, &[u8]), FormatError> {
    let ends = || FormatError::truncated(TITLE, "the file ends within the header");
    let version = *bytes.get(MAGIC.len()).ok_or_else(ends)?;
    let size_bytes = match version {
        1 => 2,
        2 | 3 => 4,
        other => return Err(FormatError::unsupported(TITLE, format!("version {other} in the header: expected 1, 2 or 3"))),
    };
    let start = MAGIC.len() + 2 + size_bytes;
    let size = bytes.get(MAGIC.len() + 2..start).ok_or_else(ends)?;
    let size = size.iter().rev().fold(0, |size, byte| size << 8 | usize::from(*byte));
    if size > LONGEST_HEADER {
        return Err(FormatError::damaged(TITLE, format!("the header is longer than {LONGEST_HEADER} bytes")));
    }
    let header = std::str::from_utf8(bytes.get(start..start + size).ok_or_else(ends)?);
    Ok((header.map_err(|_| FormatError::damaged(TITLE, "the header is not text"))?, &bytes[start + size..]))
}

/// The text after a key of the header's dictionary.
fn value<'a>(header: &'a str, key: &str) -> Result<&'a str, FormatError> {
    let missing = || FormatError::damaged(TITLE, format!("no `{key}` in the header"));
    let at = header.find(&format!("'{key}'")).ok_or_else(missing)?;
    Ok(header[at + key.len() + 2..].trim_start().strip_prefix(':').ok_or_else(missing)?.trim_start())
}

fn check_numbers(header: &str) -> Result<(), FormatError> {
    let number = value(header, "descr")?;
    if !number.starts_with("'<f4'") {
        let found = super::escaped(number.split(',').next().unwrap_or_default());
        return Err(FormatError::unsupported(TITLE, format!("numbers {found}: save the image with `.astype('<f4')`")));
    }
    if !value(header, "fortran_order")?.starts_with("False") {
        return Err(FormatError::unsupported(TITLE, "columns before rows: save the image with `numpy.ascontiguousarray`"));
    }
    Ok(())
}

fn image_shape(header: &str) -> Result<(u64, u64, usize), FormatError> {
    let text = value(header, "shape")?;
    let inside = text.strip_prefix('(').and_then(|text| text.split_once(')')).map(|(inside, _)| inside);
    let sides = inside.map(|inside| inside.split(',').map(str::trim).filter(|side| !side.is_empty()).map(str::parse).collect());
    let Some(Ok(sides)) = sides.map(|sides: Result<Vec<u64>, _>| sides) else {
        return Err(FormatError::damaged(TITLE, "the shape in the header is not a tuple of whole numbers"));
    };
    match sides[..] {
        [height, width] => Ok((height, width, 1)),
        [height, width, channels @ (1 | 3 | 4)] => Ok((height, width, channels as usize)),
        _ => Err(FormatError::unsupported(TITLE, format!("shape {sides:?}: expected (h, w), (h, w, 1), (h, w, 3) or (h, w, 4)"))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::Content;

    #[test]
    fn an_image_comes_back_with_and_without_alpha() {
        let raster = Raster::new(3, 2, (0..6).map(|index| [index as f32, -0.5, f32::MIN_POSITIVE]).collect());
        let plane = Plane { width: 3, height: 2, values: vec![0.0, 0.25, 0.5, 0.75, 1.0, 0.0] };
        for alpha in [None, Some(plane)] {
            let image = Image { alpha, ..Image::opaque(raster.clone()) };
            let decoded = read(&write(&image, &[]).unwrap().0, &Limits::default()).unwrap();
            assert_eq!(decoded.content, Content::Linear(image));
        }
    }

    #[test]
    fn headers_are_those_of_numpy() {
        let bytes = write_f64(&[2, 3], &[0.0; 6]);
        // What numpy 2 writes for numpy.zeros((2, 3)).
        let expected = b"\x93NUMPY\x01\x00\x76\x00{'descr': '<f8', 'fortran_order': False, 'shape': (2, 3), }";
        assert_eq!(&bytes[..expected.len()], expected);
        assert_eq!((bytes[127], bytes.len()), (b'\n', 128 + 48));
        assert!(String::from_utf8_lossy(&write_f32(&[5], &[0.0; 5])).contains("'shape': (5,), }"));
    }

    #[test]
    fn other_numbers_and_shapes_are_refused_by_name() {
        for (bytes, word) in
            [(write_f64(&[1, 1], &[0.0]), "<f8"), (write_f32(&[1, 1, 2], &[0.0; 2]), "shape"), (write_columns(&["x"], &[1.0]), "numbers")]
        {
            let error = read(&bytes, &Limits::default()).unwrap_err().to_string();
            assert!(error.contains(word), "{error}");
        }
    }
}

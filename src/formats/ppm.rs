//! Portable pixel maps: `P6` and `P3`, and the grey `P5` and `P2`, with 8 or 16 bits a channel.
//!
//! Values are scaled to 255 or 65535 where the header names another maximum. Values of 16 bits are big
//! endian. Alpha is not written: the format has none.
//!
//! After Netpbm's ppm and pgm documentation.

use super::{Decoded, Encoded, Entry, Format, FormatError, Limits};
use crate::image::display;
use crate::image::raster::{Image, Picture, PictureSamples};

/// The row of this format.
pub const FORMAT: Format = Format {
    name: "ppm",
    title: TITLE,
    extensions: &["ppm", "pgm", "pnm"],
    sniff: |bytes| bytes.len() >= 3 && bytes[0] == b'P' && b"2356".contains(&bytes[1]) && is_white(bytes[2]),
    read,
    write,
    write_picture: Some(write_picture),
    origin: super::no_origin,
};

const TITLE: &str = "PPM";

/// Comments included; nobody writes a longer header.
const LONGEST_HEADER: usize = 1 << 16;

/// Reads any of the four.
pub fn read(bytes: &[u8], limits: &Limits) -> Result<Decoded, FormatError> {
    let Some([b'P', kind @ (b'2' | b'3' | b'5' | b'6')]) = bytes.first_chunk() else {
        return Err(FormatError::damaged(TITLE, "it does not begin with P2, P3, P5 or P6"));
    };
    let mut words = Words { bytes, position: 2 };
    let (is_text, channels) = (*kind < b'5', if b"36".contains(kind) { 3 } else { 1 });
    let [width, height, largest] = [words.header_number("width")?, words.header_number("height")?, words.header_number("maximum")?];
    let (width, height) = limits.checked(TITLE, width, height)?;
    let largest = u16::try_from(largest).ok().filter(|largest| *largest > 0);
    let largest = largest.ok_or_else(|| FormatError::damaged(TITLE, "the maximum in the header is not within 1 and 65535"))?;

    let count = width * height * channels;
    let (values, end) = if is_text { words.text_values(count)? } else { binary_values(bytes, words.position + 1, count, largest)? };
    if let Some(value) = values.iter().find(|value| **value > largest) {
        return Err(FormatError::damaged(TITLE, format!("the value {value} is over the maximum {largest} of the header")));
    }
    let pixel =
        |index: usize| if channels == 3 { [values[3 * index], values[3 * index + 1], values[3 * index + 2]] } else { [values[index]; 3] };
    let pixels = (0..width * height).map(pixel);
    let samples = if largest < 256 {
        PictureSamples::Eight(pixels.map(|pixel| pixel.map(|value| scaled(value, largest, 255) as u8)).collect())
    } else {
        PictureSamples::Sixteen(pixels.map(|pixel| pixel.map(|value| scaled(value, largest, 65_535))).collect())
    };
    let mut decoded = Decoded::display(FORMAT.name, Picture { width, height, samples, alpha: None });
    let trailing = bytes[end.min(bytes.len())..].iter().filter(|byte| !is_text || !is_white(**byte)).count();
    decoded.warnings.extend(super::trailing_warning(trailing));
    decoded.facts = vec![("channels".into(), channels.to_string()), ("maximum".into(), largest.to_string())];
    Ok(decoded)
}

/// Writes linear light as `P6`, clipped and sRGB-encoded.
pub fn write(image: &Image, entries: &[Entry<'_>]) -> Result<Encoded, FormatError> {
    let (picture, mut warnings) = display::encoded(image);
    warnings.extend(super::layers_left_out(image, TITLE));
    Ok((write_picture(&picture, entries)?.0, warnings))
}

/// Writes `P6` with the maximum 255 or 65535.
pub fn write_picture(picture: &Picture, _: &[Entry<'_>]) -> Result<Encoded, FormatError> {
    let header = |largest: u32| format!("P6\n{} {}\n{largest}\n", picture.width, picture.height).into_bytes();
    let bytes = match &picture.samples {
        PictureSamples::Eight(samples) => [header(255).as_slice(), samples.as_flattened()].concat(),
        PictureSamples::Sixteen(samples) => {
            let mut bytes = header(65_535);
            bytes.extend(samples.iter().flatten().flat_map(|value| value.to_be_bytes()));
            bytes
        }
    };
    Ok((bytes, Vec::new()))
}

fn scaled(value: u16, largest: u16, to: u32) -> u16 {
    let (value, largest) = (u32::from(value), u32::from(largest));
    if largest == to { value as u16 } else { ((value * to + largest / 2) / largest) as u16 }
}

fn binary_values(bytes: &[u8], start: usize, count: usize, largest: u16) -> Result<(Vec<u16>, usize), FormatError> {
    let size = if largest < 256 { count } else { 2 * count };
    let rest = bytes.get(start..).unwrap_or_default();
    let Some(data) = rest.get(..size) else {
        return Err(FormatError::truncated(TITLE, format!("{} of {size} bytes of pixels are there", rest.len())));
    };
    let values = if largest < 256 {
        data.iter().map(|byte| u16::from(*byte)).collect()
    } else {
        data.as_chunks::<2>().0.iter().map(|pair| u16::from_be_bytes(*pair)).collect()
    };
    Ok((values, start + size))
}

struct Words<'a> {
    bytes: &'a [u8],
    position: usize,
}

impl Words<'_> {
    fn header_number(&mut self, what: &str) -> Result<u64, FormatError> {
        let number = self.number().map_err(|fault| fault.error(&format!("{what} in the header")))?;
        if self.position > LONGEST_HEADER {
            return Err(FormatError::damaged(TITLE, format!("the header is longer than {LONGEST_HEADER} bytes")));
        }
        Ok(number)
    }

    fn text_values(&mut self, count: usize) -> Result<(Vec<u16>, usize), FormatError> {
        // A value takes a digit and a blank, so a short file cannot ask for much room.
        let mut values = Vec::with_capacity(count.min(self.bytes.len() / 2 + 1));
        for index in 0..count {
            let value = self.number().map_err(|fault| fault.error(&format!("value {index}")))?;
            values.push(u16::try_from(value).map_err(|_| FormatError::damaged(TITLE, format!("value {index} is over 65535")))?);
        }
        Ok((values, self.position))
    }

    /// The next number; comments run from `#` to the end of a line.
    fn number(&mut self) -> Result<u64, Fault> {
        while let Some(byte) = self.bytes.get(self.position) {
            match byte {
                b'#' => self.skip_while(|byte| byte != b'\n' && byte != b'\r'),
                byte if is_white(*byte) => self.skip_while(is_white),
                _ => break,
            }
        }
        let start = self.position;
        self.skip_while(|byte| byte.is_ascii_digit());
        let digits = std::str::from_utf8(&self.bytes[start..self.position]).expect("digits are text");
        match self.bytes.get(self.position) {
            None if digits.is_empty() => Err(Fault::Ends),
            Some(byte) if !is_white(*byte) && *byte != b'#' => Err(Fault::IsNoNumber),
            _ => digits.parse().map_err(|_| Fault::IsNoNumber),
        }
    }

    fn skip_while(&mut self, is_skipped: impl Fn(u8) -> bool) {
        self.position += self.bytes[self.position..].iter().take_while(|byte| is_skipped(**byte)).count();
    }
}

enum Fault {
    Ends,
    IsNoNumber,
}

impl Fault {
    fn error(self, place: &str) -> FormatError {
        match self {
            Self::Ends => FormatError::truncated(TITLE, format!("the file ends before the {place}")),
            Self::IsNoNumber => FormatError::damaged(TITLE, format!("{place}: expected a whole number")),
        }
    }
}

fn is_white(byte: u8) -> bool {
    matches!(byte, b' ' | b'\t' | b'\n' | b'\r' | 0x0b | 0x0c)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::Content;

    fn picture(bytes: &[u8]) -> Picture {
        let Content::Display(picture) = read(bytes, &Limits::default()).unwrap().content else { panic!("a PPM is a picture") };
        picture
    }

    #[test]
    fn text_and_bytes_give_the_same_picture() {
        let text = picture(b"P3 # colors\n2 1 # size\n255\n1 2 3\n4 5 255\n");
        assert_eq!(text, picture(b"P6\n2 1\n255\n\x01\x02\x03\x04\x05\xff"));
        assert_eq!(text.samples, PictureSamples::Eight(vec![[1, 2, 3], [4, 5, 255]]));
    }

    #[test]
    fn sixteen_bits_are_big_endian() {
        assert_eq!(picture(b"P5 1 1 65535 \x01\x02").samples, PictureSamples::Sixteen(vec![[0x0102; 3]]));
    }

    #[test]
    fn another_maximum_is_scaled() {
        assert_eq!(picture(b"P2 3 1 4 0 2 4").samples, PictureSamples::Eight(vec![[0; 3], [128; 3], [255; 3]]));
        assert_eq!(picture(b"P2 2 1 1000 500 1000").samples, PictureSamples::Sixteen(vec![[32_768; 3], [65_535; 3]]));
    }

    #[test]
    fn values_over_the_maximum_and_missing_ones_are_refused() {
        for (bytes, word) in
            [(&b"P2 1 1 4 5"[..], "over"), (b"P2 2 1 4 1", "truncated"), (b"P6 1 1 255 ab", "truncated"), (b"P6 1 1 0 a", "maximum")]
        {
            let error = read(bytes, &Limits::default()).unwrap_err().to_string();
            assert!(error.contains(word), "{error}");
        }
    }
}

//! Portable float map: a text header, then raw 32-bit floats, rows from the bottom to the top.
//!
//! `PF` has three channels, `Pf` one, which is replicated. The sign of the scale is the byte order and
//! its size a unit factor, which is recorded and not applied. Trailing bytes are a warning.
//!
//! After P. Debevec's PFM note and Netpbm's pfm documentation.

use rayon::prelude::*;

use super::{Decoded, Encoded, Entry, Format, FormatError, Limits};
use crate::image::raster::{Image, Raster};

/// The row of this format.
pub const FORMAT: Format = Format {
    name: "pfm",
    title: TITLE,
    extensions: &["pfm"],
    sniff: |bytes| bytes.starts_with(b"PF") || bytes.starts_with(b"Pf"),
    read,
    write,
    write_picture: None,
    origin: super::no_origin,
};

const TITLE: &str = "PFM";

/// A header has four short words; blanks beyond this are not a header.
const LONGEST_HEADER: usize = 1024;

/// Reads a PFM. Needs its decoded size in memory and nothing more.
pub fn read(bytes: &[u8], limits: &Limits) -> Result<Decoded, FormatError> {
    let header = Header::parse(bytes)?;
    let (width, height) = limits.checked(TITLE, header.width, header.height)?;
    let row_size = width * header.channels * 4;
    let (data, trailing) = header.data(bytes, row_size * height)?;

    let mut pixels = vec![[0.0; 3]; width * height];
    let rows = pixels.par_chunks_mut(width).zip(data.par_chunks(row_size).rev());
    match (header.channels, header.is_little_endian) {
        (3, true) => rows.for_each(|(row, bytes)| fill_color(row, bytes, f32::from_le_bytes)),
        (3, false) => rows.for_each(|(row, bytes)| fill_color(row, bytes, f32::from_be_bytes)),
        (_, true) => rows.for_each(|(row, bytes)| fill_grey(row, bytes, f32::from_le_bytes)),
        (_, false) => rows.for_each(|(row, bytes)| fill_grey(row, bytes, f32::from_be_bytes)),
    }

    let mut decoded = Decoded::linear(FORMAT.name, Image::opaque(Raster::new(width, height, pixels)));
    decoded.unit_factor = header.unit_factor;
    decoded.warnings.extend(super::trailing_warning(trailing));
    decoded.facts = vec![
        ("channels".into(), header.channels.to_string()),
        ("byte order".into(), if header.is_little_endian { "little endian".into() } else { "big endian".into() }),
        ("scale".into(), format!("{}{}", if header.is_little_endian { "-" } else { "" }, header.unit_factor)),
    ];
    Ok(decoded)
}

/// Writes three channels, little endian, scale -1.
pub fn write(image: &Image, _: &[Entry<'_>]) -> Result<Encoded, FormatError> {
    let color = &image.color;
    let mut bytes = format!("PF\n{} {}\n-1.0\n", color.width(), color.height()).into_bytes();
    bytes.reserve_exact(color.pixels().len() * 12);
    for y in (0..color.height()).rev() {
        bytes.extend(color.row(y).iter().flatten().flat_map(|value| value.to_le_bytes()));
    }
    Ok((bytes, super::layers_left_out(image, TITLE)))
}

struct Header {
    channels: usize,
    width: u64,
    height: u64,
    unit_factor: f64,
    is_little_endian: bool,
    /// Position of the white space that ends the scale.
    end: usize,
}

impl Header {
    fn parse(bytes: &[u8]) -> Result<Self, FormatError> {
        let mut words = Words { bytes, position: 0 };
        let channels = match words.next("signature")? {
            b"PF" => 3,
            b"Pf" => 1,
            b"PF4" => return Err(FormatError::unsupported(TITLE, "the four-channel variant `PF4` in the header: save it as `PF`")),
            other => return Err(FormatError::damaged(TITLE, format!("bad magic `{}` in the header: expected `PF` or `Pf`", shown(other)))),
        };
        let width = whole(words.next("width")?, "width")?;
        let height = whole(words.next("height")?, "height")?;
        let scale = scale(words.next("scale")?)?;
        Ok(Self { channels, width, height, unit_factor: scale.abs(), is_little_endian: scale < 0.0, end: words.position })
    }

    /// The pixels' bytes and how many follow them.
    fn data<'a>(&self, bytes: &'a [u8], size: usize) -> Result<(&'a [u8], usize), FormatError> {
        let rest = &bytes[self.start_of_data(bytes, size)..];
        if rest.len() < size {
            let problem = format!("{} of {size} bytes of pixels are there, as the header's size asks for", rest.len());
            return Err(FormatError::truncated(TITLE, problem));
        }
        Ok((&rest[..size], rest.len() - size))
    }

    /// By the letter, one byte of white space ends the header. Some writers end the line with blanks or with CR LF: then the
    /// data begins after the line, unless the file's length shows that the letter was meant.
    fn start_of_data(&self, bytes: &[u8], size: usize) -> usize {
        let by_letter = (self.end + 1).min(bytes.len());
        let blanks = bytes[self.end..].iter().take_while(|byte| matches!(byte, b' ' | b'\t' | b'\r')).count();
        let line_feed = self.end + blanks;
        let ends_in_line_feed = blanks > 0 && bytes.get(line_feed) == Some(&b'\n');
        if ends_in_line_feed && bytes.len() - by_letter != size { line_feed + 1 } else { by_letter }
    }
}

struct Words<'a> {
    bytes: &'a [u8],
    position: usize,
}

impl<'a> Words<'a> {
    fn next(&mut self, what: &str) -> Result<&'a [u8], FormatError> {
        let header = &self.bytes[..self.bytes.len().min(LONGEST_HEADER)];
        let start = header[self.position..].iter().position(|byte| !is_white(*byte)).map(|skipped| self.position + skipped);
        let end = start.and_then(|start| header[start..].iter().position(|byte| is_white(*byte)).map(|length| start + length));
        let (Some(start), Some(end)) = (start, end) else {
            return Err(if self.bytes.len() > LONGEST_HEADER {
                FormatError::damaged(TITLE, format!("no {what} in the first {LONGEST_HEADER} bytes of the header"))
            } else {
                FormatError::truncated(TITLE, format!("the header ends before its {what}"))
            });
        };
        self.position = end;
        Ok(&header[start..end])
    }
}

fn is_white(byte: u8) -> bool {
    matches!(byte, b' ' | b'\t' | b'\n' | b'\r' | 0x0b | 0x0c)
}

fn whole(word: &[u8], what: &str) -> Result<u64, FormatError> {
    let digits = word.iter().all(u8::is_ascii_digit).then(|| std::str::from_utf8(word).ok()).flatten();
    digits
        .and_then(|digits| digits.parse().ok())
        .ok_or_else(|| FormatError::damaged(TITLE, format!("{what} `{}` in the header is not a whole number of pixels", shown(word))))
}

fn scale(word: &[u8]) -> Result<f64, FormatError> {
    let number = std::str::from_utf8(word).ok().and_then(|text| text.parse::<f64>().ok());
    number.filter(|scale| scale.is_finite() && *scale != 0.0).ok_or_else(|| {
        let problem = format!("scale `{}` in the header: expected a number other than 0, negative for little endian", shown(word));
        FormatError::damaged(TITLE, problem)
    })
}

fn shown(word: &[u8]) -> String {
    super::escaped(&String::from_utf8_lossy(&word[..word.len().min(40)]))
}

fn fill_color(row: &mut [[f32; 3]], bytes: &[u8], float: impl Fn([u8; 4]) -> f32) {
    for (pixel, values) in row.iter_mut().zip(bytes.as_chunks::<12>().0) {
        let [r, g, b] = [0, 4, 8].map(|at| float([values[at], values[at + 1], values[at + 2], values[at + 3]]));
        *pixel = [r, g, b];
    }
}

fn fill_grey(row: &mut [[f32; 3]], bytes: &[u8], float: impl Fn([u8; 4]) -> f32) {
    for (pixel, value) in row.iter_mut().zip(bytes.as_chunks::<4>().0) {
        *pixel = [float(*value); 3];
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::Content;

    fn color(bytes: &[u8]) -> Raster {
        let Content::Linear(image) = read(bytes, &Limits::default()).unwrap().content else { panic!("a PFM is linear") };
        image.color
    }

    fn floats(values: &[f32]) -> Vec<u8> {
        values.iter().flat_map(|value| value.to_le_bytes()).collect()
    }

    #[test]
    fn the_first_row_of_the_file_is_the_bottom_of_the_picture() {
        let bytes = [b"Pf\n1 2\n-1\n".to_vec(), floats(&[1.0, 2.0])].concat();
        assert_eq!(color(&bytes).pixels(), [[2.0; 3], [1.0; 3]]);
    }

    #[test]
    fn a_positive_scale_means_big_endian() {
        let bytes = [b"PF 1 1 2.5\n".to_vec(), [1.5f32, -2.0, 3.0].iter().flat_map(|value| value.to_be_bytes()).collect()].concat();
        let decoded = read(&bytes, &Limits::default()).unwrap();
        assert_eq!(decoded.unit_factor, 2.5);
        assert_eq!(color(&bytes).pixel(0, 0), [1.5, -2.0, 3.0]);
    }

    #[test]
    fn a_line_that_ends_in_cr_lf_does_not_shift_the_data() {
        // The float begins with the byte of a line feed, so that only the length can tell the two readings apart.
        let value = f32::from_le_bytes([b'\n', 2, 3, 4]);
        for end in ["\r\n", " \n", "\r", "\n"] {
            let bytes = [format!("Pf\r\n1 1\r\n-1.0{end}").into_bytes(), floats(&[value])].concat();
            assert_eq!(color(&bytes).pixel(0, 0), [value; 3], "{end:?}");
        }
    }

    #[test]
    fn a_size_over_the_limit_is_refused_from_the_header() {
        for size in ["65537 1", "1 65537", "65536 8192", "18446744073709551615 3"] {
            let error = read(format!("PF\n{size}\n-1\n").as_bytes(), &Limits::default()).unwrap_err();
            assert!(matches!(error, FormatError::TooLarge { .. }), "{size}: {error}");
        }
    }
}

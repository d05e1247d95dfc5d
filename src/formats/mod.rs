//! Bytes to rasters and back: PFM, Radiance HDR, OpenEXR, PNG, PPM, NPY.
//!
//! Pure functions over byte slices; reading and writing files is the caller's work. The reader is chosen
//! by content, never by name, and no reader gives storage before the header's size has passed `Limits`.
//! Adding a format is one file here and one row in `FORMATS`. Reading order: `pfm`, `hdr`, `exr`, then
//! the display formats `png` and `ppm` with `display` between them and linear light, then `npy`, `npz`.

pub mod display;
pub mod exr;
pub mod hdr;
pub mod npy;
pub mod npz;
pub mod pfm;
pub mod png;
pub mod ppm;

use rayon::prelude::*;

use crate::image::raster::{Image, Picture, Raster};

/// Name and text of one thing a file says of its origin.
pub type Entry<'a> = (&'a str, &'a str);

/// A file's bytes, and what its reader should know (values that were clipped).
pub type Encoded = (Vec<u8>, Vec<String>);

/// What stands before the name of an origin entry inside a file: `pipeline:stage`.
pub const ENTRY_PREFIX: &str = "pipeline:";

/// What a header may promise before its data is believed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limits {
    /// Pixels a side.
    pub side: u64,
    /// Bytes of all pixels decoded, counted as RGB floats: 12 a pixel.
    pub bytes: u64,
}

impl Default for Limits {
    fn default() -> Self {
        Self { side: 65_536, bytes: 4 << 30 }
    }
}

impl Limits {
    /// Width and height as a header gives them, if there are pixels and not too many.
    pub fn checked(&self, format: &'static str, width: u64, height: u64) -> Result<(usize, usize), FormatError> {
        if width == 0 || height == 0 {
            return Err(FormatError::damaged(format, format!("size {width} x {height} in the header: there are no pixels")));
        }
        let bytes = width.checked_mul(height).and_then(|count| count.checked_mul(12));
        if width > self.side || height > self.side || bytes.is_none_or(|bytes| bytes > self.bytes) {
            return Err(FormatError::TooLarge { format, width, height, limits: *self });
        }
        Ok((width as usize, height as usize))
    }
}

/// What a file holds.
#[derive(Debug, Clone, PartialEq)]
pub enum Content {
    /// Linear light.
    Linear(Image),
    /// Values for a display.
    Display(Picture),
}

/// A file that was read.
#[derive(Debug, Clone, PartialEq)]
pub struct Decoded {
    /// Its pixels.
    pub content: Content,
    /// Name of its format, as in `FORMATS`.
    pub format: &'static str,
    /// What is odd about the file: trailing bytes, a name that disagrees, non-finite or negative pixels.
    pub warnings: Vec<String>,
    /// What the header says beside the size, name and value, in the order of interest.
    pub facts: Vec<(String, String)>,
    /// The unit factor a PFM header gives (absolute value of its scale); not applied. One elsewhere.
    pub unit_factor: f64,
}

impl Decoded {
    fn linear(format: &'static str, image: Image) -> Self {
        Self { content: Content::Linear(image), format, warnings: Vec::new(), facts: Vec::new(), unit_factor: 1.0 }
    }

    fn display(format: &'static str, picture: Picture) -> Self {
        Self { content: Content::Display(picture), format, warnings: Vec::new(), facts: Vec::new(), unit_factor: 1.0 }
    }

    /// Pixels in a row, and rows.
    pub fn size(&self) -> (usize, usize) {
        match &self.content {
            Content::Linear(image) => (image.color.width(), image.color.height()),
            Content::Display(picture) => (picture.width, picture.height),
        }
    }
}

/// Why bytes gave no image, or an image no bytes.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum FormatError {
    /// The first bytes belong to no known format.
    #[error("unknown format: {0}; expected the signature (magic bytes) of PFM, Radiance HDR, OpenEXR, PNG, PPM or NPY")]
    Unknown(String),
    /// The content breaks the rules of its format.
    #[error("{format}: {problem}")]
    Damaged {
        /// Title of the format.
        format: &'static str,
        /// What is wrong and where.
        problem: String,
    },
    /// The data ends too early.
    #[error("{format}: truncated: {problem}")]
    Truncated {
        /// Title of the format.
        format: &'static str,
        /// What is missing.
        problem: String,
    },
    /// The header promises more than is allowed.
    #[error(
        "{format}: size {width} x {height} is too large: the limit is {} pixels a side and {} MiB decoded, at 12 bytes a pixel",
        limits.side, limits.bytes >> 20
    )]
    TooLarge {
        /// Title of the format.
        format: &'static str,
        /// Pixels in a row, as the header has it.
        width: u64,
        /// Rows, as the header has it.
        height: u64,
        /// What is allowed.
        limits: Limits,
    },
    /// Legal content that is not read here.
    #[error("{format}: unsupported: {feature}")]
    Unsupported {
        /// Title of the format.
        format: &'static str,
        /// What it is, and what to do instead.
        feature: String,
    },
    /// There is no such format to write, or it cannot hold this.
    #[error("{0}")]
    Unwritable(String),
    /// One of the above in a named file.
    #[error("`{name}`: {source}{}", if disagreement.is_empty() { String::new() } else { format!(" ({disagreement})") })]
    InFile {
        /// The name, fit for a terminal.
        name: String,
        /// What is wrong.
        source: Box<FormatError>,
        /// Empty, or that the name promises another format.
        disagreement: String,
    },
}

impl FormatError {
    fn damaged(format: &'static str, problem: impl Into<String>) -> Self {
        Self::Damaged { format, problem: problem.into() }
    }

    fn truncated(format: &'static str, problem: impl Into<String>) -> Self {
        Self::Truncated { format, problem: problem.into() }
    }

    fn unsupported(format: &'static str, feature: impl Into<String>) -> Self {
        Self::Unsupported { format, feature: feature.into() }
    }
}

/// One row of the table of formats.
pub struct Format {
    /// Its name in `save:` and its first file extension.
    pub name: &'static str,
    /// Its name in messages.
    pub title: &'static str,
    /// File extensions that promise it, in lower case.
    pub extensions: &'static [&'static str],
    /// Whether bytes begin like it.
    pub sniff: fn(&[u8]) -> bool,
    /// Decodes a whole file.
    pub read: fn(&[u8], &Limits) -> Result<Decoded, FormatError>,
    /// Encodes linear light.
    pub write: fn(&Image, &[Entry<'_>]) -> Result<Encoded, FormatError>,
    /// Encodes a picture; `None` where the format holds linear light only.
    pub write_picture: Option<fn(&Picture, &[Entry<'_>]) -> Result<Encoded, FormatError>>,
    /// The origin entries inside a file.
    pub origin: fn(&[u8]) -> Vec<(String, String)>,
}

/// All image formats.
pub const FORMATS: &[Format] = &[pfm::FORMAT, hdr::FORMAT, exr::FORMAT, png::FORMAT, ppm::FORMAT, npy::FORMAT];

/// Reads an image in whatever format the bytes are.
///
/// `name` is used in messages only, and to say when its extension promises another format. Nothing is
/// allocated for pixels before the size in the header has passed `limits`.
pub fn read(bytes: &[u8], name: &str, limits: &Limits) -> Result<Decoded, FormatError> {
    let in_file = |source, disagreement| FormatError::InFile { name: escaped(name), source: Box::new(source), disagreement };
    let format = recognized(bytes).map_err(|error| in_file(error, String::new()))?;
    let disagreement = disagreement(name, format).unwrap_or_default();
    let mut decoded = (format.read)(bytes, limits).map_err(|error| in_file(error, disagreement.clone()))?;
    if !disagreement.is_empty() {
        decoded.warnings.push(disagreement);
    }
    if let Content::Linear(image) = &decoded.content {
        decoded.warnings.extend(survey(&image.color).warnings());
    }
    Ok(decoded)
}

/// Writes linear light in the format of that name, with what the reader should know.
///
/// `entries` say where it comes from; they go into PNG text chunks and EXR attributes and nowhere else.
pub fn encode(image: &Image, format: &str, entries: &[Entry<'_>]) -> Result<Encoded, FormatError> {
    (named(format)?.write)(image, entries)
}

/// Writes a picture in the format of that name (`png`, `ppm`).
pub fn encode_picture(picture: &Picture, format: &str, entries: &[Entry<'_>]) -> Result<Encoded, FormatError> {
    let Some(write) = named(format)?.write_picture else {
        return Err(FormatError::Unwritable(format!("`{format}` holds linear light, not a picture: use png or ppm")));
    };
    write(picture, entries)
}

/// The origin entries inside a published file, without `ENTRY_PREFIX`; none where there are none.
pub fn origin(bytes: &[u8]) -> Vec<(String, String)> {
    recognized(bytes).map(|format| (format.origin)(bytes)).unwrap_or_default()
}

/// The row of the format that `extension` promises, without its point, in any case.
pub fn by_extension(extension: &str) -> Option<&'static Format> {
    let extension = extension.to_ascii_lowercase();
    FORMATS.iter().find(|format| format.extensions.contains(&extension.as_str()))
}

/// Pixels that light cannot have.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Survey {
    /// Pixels with a NaN or an infinity, if any.
    pub non_finite: Option<Found>,
    /// Pixels with a value below zero, if any.
    pub negative: Option<Found>,
}

/// How many pixels are of a sort, and which is the first.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Found {
    /// How many.
    pub count: u64,
    /// Column and row of the first, rows from the top.
    pub first: (usize, usize),
}

impl Survey {
    /// One sentence for each sort that was found.
    pub fn warnings(&self) -> Vec<String> {
        let of = |sort: &str, found: Option<Found>| found.map(|found| found.sentence(sort));
        [of("not finite (NaN or infinite)", self.non_finite), of("negative", self.negative)].into_iter().flatten().collect()
    }
}

impl Found {
    fn sentence(&self, sort: &str) -> String {
        let (verb, first) = if self.count == 1 { ("pixel is", "at") } else { ("pixels are", "the first at") };
        format!("{} {verb} {sort}, {first} ({}, {})", self.count, self.first.0, self.first.1)
    }
}

/// Counts the non-finite and the negative pixels.
pub fn survey(raster: &Raster) -> Survey {
    let width = raster.width().max(1);
    let found = |is_of_sort: fn(&[f32; 3]) -> bool| {
        let rows = raster.pixels().par_chunks(width).enumerate();
        rows.filter_map(|(y, row)| {
            let x = row.iter().position(is_of_sort)?;
            Some(Found { count: row[x..].iter().filter(|pixel| is_of_sort(pixel)).count() as u64, first: (x, y) })
        })
        .reduce_with(|a, b| Found { count: a.count + b.count, first: if a.first.1 <= b.first.1 { a.first } else { b.first } })
    };
    Survey {
        non_finite: found(|pixel| pixel.iter().any(|value| !value.is_finite())),
        negative: found(|pixel| pixel.iter().any(|value| *value < 0.0)),
    }
}

/// Text of a file made fit for a message: short, printable ASCII.
pub fn escaped(text: &str) -> String {
    const LONGEST: usize = 120;
    let mut out = String::new();
    for character in text.chars().take(LONGEST) {
        match character {
            '`' => out.push('\''),
            ' '..='~' => out.push(character),
            // Letters of other scripts are fine to show; marks that reorder or hide text are not.
            _ if character.is_alphanumeric() => out.push(character),
            _ => out.extend(character.escape_default()),
        }
    }
    if text.chars().nth(LONGEST).is_some() {
        out.push('…');
    }
    out
}

fn recognized(bytes: &[u8]) -> Result<&'static Format, FormatError> {
    if bytes.is_empty() {
        return Err(FormatError::Unknown("the file is empty".into()));
    }
    FORMATS.iter().find(|format| (format.sniff)(bytes)).ok_or_else(|| {
        let start = String::from_utf8_lossy(&bytes[..bytes.len().min(8)]).into_owned();
        FormatError::Unknown(format!("the file begins with `{}`", escaped(&start)))
    })
}

fn named(format: &str) -> Result<&'static Format, FormatError> {
    FORMATS.iter().find(|row| row.name == format).ok_or_else(|| {
        let names: Vec<_> = FORMATS.iter().map(|row| row.name).collect();
        FormatError::Unwritable(format!("unknown image format `{}`: expected one of {}", escaped(format), names.join(", ")))
    })
}

fn disagreement(name: &str, format: &Format) -> Option<String> {
    let (_, extension) = name.rsplit_once('.')?;
    let promised = by_extension(extension)?;
    let differs = promised.name != format.name;
    differs.then(|| format!("the content is of the format {}, although the name ends in `.{}`", format.title, escaped(extension)))
}

fn no_origin(_: &[u8]) -> Vec<(String, String)> {
    Vec::new()
}

fn layers_left_out(image: &Image, title: &str) -> Vec<String> {
    let names: Vec<_> = image.layers.keys().map(|name| format!("`{}`", escaped(name))).collect();
    if names.is_empty() { Vec::new() } else { vec![format!("{title} holds color only: layers {} are left out", names.join(", "))] }
}

fn trailing_warning(count: usize) -> Option<String> {
    (count > 0).then(|| format!("{count} trailing bytes after the image were ignored"))
}

#[cfg(test)]
mod tests;

//! OpenEXR: scene-linear half or float channels by name, in compressed blocks.
//!
//! The crate `exr` knows the header and the compressions; this file decides what may be allocated, sees
//! that every block arrives exactly once, and places the data window in the display window, which is the
//! picture (zero outside the data). Blocks are decoded in the current pool of threads.
//!
//! `R`, `G`, `B` are the color, or `Y` a grey one; `A` is alpha, stored as it is: nothing is multiplied or
//! divided by it. `NAME.R`, `NAME.G`, `NAME.B` are a color layer, `NAME.Y` a scalar one, `Z` the layer `depth`.
//! Files are written by hand, since the crate orders further attributes by chance: float, ZIP, same bytes for
//! the same image.
//!
//! After the OpenEXR project, "OpenEXR file layout" and "Technical introduction to OpenEXR".

use std::cell::Cell;
use std::collections::BTreeMap;
use std::io::{self, Cursor, Read, Seek, SeekFrom};
use std::panic::{AssertUnwindSafe, catch_unwind};

use ::exr::block::chunk::{Chunk, CompressedBlock};
use ::exr::block::reader::FilteredChunksReader;
use ::exr::block::{BlockIndex, UncompressedBlock};
use ::exr::compression::Compression;
use ::exr::error::Error as ExrError;
use ::exr::math::Vec2;
use ::exr::meta::attribute::{AttributeValue, ChannelDescription, Chromaticities, IntegerBounds, LineOrder, SampleType};
use ::exr::meta::header::Header;
use ::exr::meta::{BlockDescription, MetaData};
use half::f16;
use rayon::prelude::*;

use super::{Decoded, ENTRY_PREFIX, Encoded, Entry, Format, FormatError, Limits};
use crate::image::raster::{Image, Layer, Plane, Raster};

/// The row of this format.
pub const FORMAT: Format = Format {
    name: "exr",
    title: TITLE,
    extensions: &["exr"],
    sniff: |bytes| bytes.starts_with(&MAGIC),
    read,
    write,
    write_picture: None,
    origin,
};

const TITLE: &str = "OpenEXR";
const MAGIC: [u8; 4] = [0x76, 0x2f, 0x31, 0x01];

/// Reads the first part that has color.
pub fn read(bytes: &[u8], limits: &Limits) -> Result<Decoded, FormatError> {
    without_panic(|| decode(bytes, limits))
}

/// Writes color, alpha and layers as float channels, ZIP-compressed in blocks of 16 lines.
pub fn write(image: &Image, entries: &[Entry<'_>]) -> Result<Encoded, FormatError> {
    let sources = sources(image);
    let (width, height) = (image.color.width(), image.color.height());
    let channels = sources.keys().map(|name| ChannelDescription::named(name.as_str(), SampleType::F32)).collect();
    let header = Header::new("".into(), (width, height), channels);
    let header = header.with_encoding(Compression::ZIP16, BlockDescription::ScanLines, LineOrder::Increasing);

    let lines = Compression::ZIP16.scan_lines_per_block();
    let blocks: Vec<Vec<u8>> = (0..height.div_ceil(lines))
        .into_par_iter()
        .map(|index| compressed_block(&header, &sources, index * lines, lines.min(height - index * lines)))
        .collect::<Result<_, _>>()?;

    let mut bytes = written_header(&sources, width, height, entries)?;
    let mut offset = bytes.len() + 8 * blocks.len();
    for block in &blocks {
        bytes.extend((offset as u64).to_le_bytes());
        offset += 8 + block.len();
    }
    bytes.reserve_exact(offset - bytes.len());
    for (index, block) in blocks.into_iter().enumerate() {
        bytes.extend(((index * lines) as i32).to_le_bytes());
        bytes.extend((block.len() as i32).to_le_bytes());
        bytes.extend(block);
    }
    Ok((bytes, Vec::new()))
}

/// The attributes that say where a file comes from.
pub fn origin(bytes: &[u8]) -> Vec<(String, String)> {
    let meta = without_panic(|| MetaData::read_from_buffered(Cursor::new(bytes), false).map_err(|error| header_error(&error)));
    // A file of several parts may say that it has none.
    let Some(header) = meta.iter().flat_map(|meta| &meta.headers).next() else { return Vec::new() };
    let attributes: BTreeMap<String, String> = text_attributes(header).collect();
    let entries = attributes.into_iter().filter_map(|(name, text)| Some((name.strip_prefix(ENTRY_PREFIX)?.to_owned(), text)));
    entries.collect()
}

/// The crate has panicked on damaged files before; here that is one more way in which a file is damaged.
fn without_panic<T>(work: impl FnOnce() -> Result<T, FormatError>) -> Result<T, FormatError> {
    catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|_| Err(FormatError::damaged(TITLE, "invalid data: the decoder gave up")))
}

fn decode(bytes: &[u8], limits: &Limits) -> Result<Decoded, FormatError> {
    let furthest = Cell::new(0);
    let input = Watched { inner: Cursor::new(bytes), furthest: &furthest };
    let reader = ::exr::block::read(input, false).map_err(|error| header_error(&error))?;
    let (part, wanted) = part_with_color(reader.headers())?;
    let header = reader.headers()[part].clone();
    let part_count = reader.headers().len();
    check_block_counts(reader.headers(), bytes.len())?;

    let window = Window::checked(&header, limits)?;
    let mut decoded = described(&header, part_count);
    let mut storage = Storage::checked(&header, wanted, &window, limits, &mut decoded.warnings)?;

    let chunks = reader
        .filter_chunks(false, |_, tile, block| block.layer == part && tile.level_index == Vec2(0, 0))
        .map_err(|error| header_error(&error))?;
    read_blocks(chunks, part, &window, &mut storage)?;

    let reads_all = part_count == 1 && !has_levels(&header);
    decoded.warnings.extend(super::trailing_warning(if reads_all { bytes.len() - furthest.get() } else { 0 }));
    decoded.content = super::Content::Linear(storage.into_image(&window));
    Ok(decoded)
}

/// Remembers how far a file was read, to see what follows the last block.
struct Watched<'a> {
    inner: Cursor<&'a [u8]>,
    furthest: &'a Cell<usize>,
}

impl Read for Watched<'_> {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        let count = self.inner.read(out)?;
        self.furthest.set(self.furthest.get().max(self.inner.position() as usize));
        Ok(count)
    }
}

impl Seek for Watched<'_> {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.inner.seek(to)
    }
}

/// Where a channel's values go.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
enum Target {
    Color,
    Alpha,
    Layer(String),
}

/// Which part of its target's pixel a channel is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Component {
    /// Red, green or blue.
    One(usize),
    /// Grey: all three.
    All,
    /// The number of a plane.
    Scalar,
}

/// For each channel of a part, in its order: where it goes, if anywhere.
type Wanted = Vec<Option<(Target, Component)>>;

fn part_with_color(headers: &[Header]) -> Result<(usize, Wanted), FormatError> {
    let mut first_fault = None;
    for (index, header) in headers.iter().enumerate() {
        match wanted_channels(header) {
            Ok(wanted) => return Ok((index, wanted)),
            Err(fault) => first_fault = first_fault.or(Some(fault)),
        }
    }
    Err(first_fault.unwrap_or_else(|| FormatError::damaged(TITLE, "the header has no part")))
}

fn wanted_channels(header: &Header) -> Result<Wanted, FormatError> {
    if header.deep {
        return Err(FormatError::unsupported(TITLE, "deep data: flatten it first"));
    }
    let names: Vec<String> = header.channels.list.iter().map(|channel| channel.name.to_string()).collect();
    if let Some(twice) = names.iter().enumerate().find(|(index, name)| names[..*index].contains(name)) {
        return Err(FormatError::damaged(TITLE, format!("invalid header: channel `{}` stands twice", super::escaped(twice.1))));
    }
    if header.channels.list.iter().any(|channel| channel.sampling != Vec2(1, 1)) {
        return Err(FormatError::unsupported(TITLE, "subsampled channels (luminance and chroma): convert the file to RGB"));
    }
    let has = |name: &str| names.iter().any(|other| other == name);
    let is_grey = match (["R", "G", "B"].iter().all(|name| has(name)), has("Y")) {
        (true, _) => false,
        (false, true) if !has("RY") && !has("BY") => true,
        _ => {
            let listed: Vec<_> = names.iter().take(12).map(|name| format!("`{}`", super::escaped(name))).collect();
            let feature = format!("no color channels R, G, B and no luminance Y; there are the channels {}", listed.join(", "));
            return Err(FormatError::unsupported(TITLE, feature));
        }
    };
    Ok(names.iter().map(|name| target_of(name, is_grey, &has)).collect())
}

fn target_of(name: &str, is_grey: bool, has: &dyn Fn(&str) -> bool) -> Option<(Target, Component)> {
    const COMPONENTS: [&str; 3] = ["R", "G", "B"];
    let component = |name: &str| COMPONENTS.iter().position(|other| *other == name).map(Component::One);
    match (name, name.rsplit_once('.')) {
        ("Y", _) if is_grey => Some((Target::Color, Component::All)),
        ("A", _) => Some((Target::Alpha, Component::Scalar)),
        ("Z", _) => Some((Target::Layer("depth".into()), Component::Scalar)),
        (_, None) if !is_grey => Some((Target::Color, component(name)?)),
        (_, Some(("", _))) => None,
        (_, Some((layer, "Y"))) if !has(&format!("{layer}.R")) => Some((Target::Layer(layer.into()), Component::Scalar)),
        (_, Some((layer, last))) => {
            let is_whole = COMPONENTS.iter().all(|one| has(&format!("{layer}.{one}")));
            Some((Target::Layer(layer.into()), component(last).filter(|_| is_whole)?))
        }
        _ => None,
    }
}

/// A file has eight bytes in its offset table and eight before each block; a table longer than that is a lie, and
/// must not be given room.
fn check_block_counts(headers: &[Header], file_size: usize) -> Result<(), FormatError> {
    let count = headers.iter().try_fold(0usize, |sum, header| sum.checked_add(header.chunk_count));
    if count.and_then(|count| count.checked_mul(16)).is_none_or(|size| size > file_size) {
        let problem = format!("the data window of the header asks for more blocks than {file_size} bytes can hold");
        return Err(FormatError::truncated(TITLE, problem));
    }
    Ok(())
}

/// The display window, which is the picture, and where in it the data lies.
struct Window {
    width: usize,
    height: usize,
    /// Column and row of the data's first pixel in the picture; may lie outside.
    data_at: (i64, i64),
}

impl Window {
    fn checked(header: &Header, limits: &Limits) -> Result<Self, FormatError> {
        let display = header.shared_attributes.display_window;
        let data = header.layer_size;
        limits.checked(TITLE, data.x() as u64, data.y() as u64)?;
        let (width, height) = limits.checked(TITLE, display.size.x() as u64, display.size.y() as u64)?;
        let position = header.own_attributes.layer_position;
        let along = |data: i32, display: i32| i64::from(data) - i64::from(display);
        Ok(Self { width, height, data_at: (along(position.x(), display.position.x()), along(position.y(), display.position.y())) })
    }

    /// The part of `count` data pixels from `start` that lies in a picture of `size`: how many to skip, where to put the
    /// others, how many there are.
    fn clipped(start: i64, count: usize, size: usize) -> (usize, usize, usize) {
        let first = start.clamp(0, size as i64);
        let end = (start + count as i64).clamp(first, size as i64);
        ((first - start).clamp(0, count as i64) as usize, first as usize, (end - first) as usize)
    }
}

/// Decoded pixels by target, with the way of each channel to its place.
struct Storage {
    channels: Vec<ChannelPlace>,
    planes: Vec<Values>,
    targets: Vec<Target>,
}

struct ChannelPlace {
    sample_type: SampleType,
    /// Index of the plane and the part of its pixel.
    place: Option<(usize, Component)>,
}

enum Values {
    Color(Vec<[f32; 3]>),
    Scalar(Vec<f32>),
}

impl Storage {
    fn checked(header: &Header, wanted: Wanted, window: &Window, limits: &Limits, warnings: &mut Vec<String>) -> Result<Self, FormatError> {
        let of_one = |target: &Target| if *target == Target::Color { 12 } else { 4 };
        let pixel_count = (window.width * window.height) as u64;
        let block_size = header.max_block_pixel_size();
        let (block_width, block_height) = (block_size.x().min(header.layer_size.x()), block_size.y().min(header.layer_size.y()));
        if (block_width * block_height) as u64 * header.channels.bytes_per_pixel as u64 > limits.bytes {
            return Err(FormatError::damaged(TITLE, "one block of the size in the header is larger than the limit for a whole image"));
        }

        let bytes: u64 = wanted.iter().flatten().map(|(target, component)| component.bytes(of_one(target)) * pixel_count).sum();
        let keeps_layers = bytes <= limits.bytes;
        if !keeps_layers {
            warnings.push(format!("layers are left out: with them the image is over the limit of {} MiB", limits.bytes >> 20));
        }
        let is_kept = |target: &Target| keeps_layers || !matches!(target, Target::Layer(_));

        let mut targets: Vec<Target> = Vec::new();
        let mut planes = Vec::new();
        let mut channels = Vec::new();
        for (channel, wanted) in header.channels.list.iter().zip(wanted) {
            let place = wanted.filter(|(target, _)| is_kept(target)).map(|(target, component)| {
                let index = targets.iter().position(|other| *other == target).unwrap_or_else(|| {
                    targets.push(target);
                    planes.push(component.zeros(window.width * window.height));
                    planes.len() - 1
                });
                (index, component)
            });
            channels.push(ChannelPlace { sample_type: channel.sample_type, place });
        }
        Ok(Self { channels, planes, targets })
    }

    /// Puts a block's lines where they belong; what lies outside the picture is dropped.
    fn place(&mut self, block: &UncompressedBlock, window: &Window) {
        let BlockIndex { pixel_position, pixel_size, .. } = block.index;
        let (skipped, x, count) = Window::clipped(window.data_at.0 + pixel_position.x() as i64, pixel_size.x(), window.width);
        let mut lines = Lines { data: &block.data };
        for row in 0..pixel_size.y() {
            let y = window.data_at.1 + (pixel_position.y() + row) as i64;
            for channel in &self.channels {
                let bytes = lines.next(pixel_size.x() * channel.sample_type.bytes_per_sample());
                let Some((plane, component)) = channel.place else { continue };
                if y < 0 || y >= window.height as i64 || count == 0 {
                    continue;
                }
                let start = y as usize * window.width + x;
                let values = Samples { bytes, sample_type: channel.sample_type, skipped };
                self.planes[plane].fill(start..start + count, component, values);
            }
        }
    }

    fn into_image(self, window: &Window) -> Image {
        let mut image = Image::opaque(Raster::new(0, 0, Vec::new()));
        for (target, values) in self.targets.into_iter().zip(self.planes) {
            match (target, values.into_layer(window)) {
                (Target::Color, Layer::Color(color)) => image.color = color,
                (Target::Alpha, Layer::Scalar(alpha)) => image.alpha = Some(alpha),
                (Target::Layer(name), layer) => {
                    image.layers.insert(name, layer);
                }
                _ => unreachable!("color has three components and alpha one"),
            }
        }
        image
    }
}

impl Component {
    /// Bytes that this channel adds to a pixel of its target.
    fn bytes(self, target: u64) -> u64 {
        if self == Self::All { target } else { 4 }
    }

    fn zeros(self, count: usize) -> Values {
        if self == Self::Scalar { Values::Scalar(vec![0.0; count]) } else { Values::Color(vec![[0.0; 3]; count]) }
    }
}

impl Values {
    fn fill(&mut self, range: std::ops::Range<usize>, component: Component, samples: Samples<'_>) {
        match (self, component) {
            (Self::Scalar(plane), _) => samples.each(&mut plane[range], |number, sample| *number = sample),
            (Self::Color(plane), Component::One(index)) => samples.each(&mut plane[range], |pixel, sample| pixel[index] = sample),
            (Self::Color(plane), _) => samples.each(&mut plane[range], |pixel, sample| *pixel = [sample; 3]),
        }
    }

    fn into_layer(self, window: &Window) -> Layer {
        match self {
            Self::Color(pixels) => Layer::Color(Raster::new(window.width, window.height, pixels)),
            Self::Scalar(values) => Layer::Scalar(Plane { width: window.width, height: window.height, values }),
        }
    }
}

struct Lines<'a> {
    data: &'a [u8],
}

impl<'a> Lines<'a> {
    fn next(&mut self, size: usize) -> &'a [u8] {
        let (line, rest) = self.data.split_at(size);
        self.data = rest;
        line
    }
}

/// One channel of one line of a block, in the byte order of this machine.
struct Samples<'a> {
    bytes: &'a [u8],
    sample_type: SampleType,
    skipped: usize,
}

impl Samples<'_> {
    fn each<T>(&self, out: &mut [T], put: impl Fn(&mut T, f32)) {
        match self.sample_type {
            SampleType::F16 => self.put_all::<T, 2>(out, |bytes| f16::from_ne_bytes(bytes).to_f32(), put),
            SampleType::F32 => self.put_all::<T, 4>(out, f32::from_ne_bytes, put),
            SampleType::U32 => self.put_all::<T, 4>(out, |bytes| u32::from_ne_bytes(bytes) as f32, put),
        }
    }

    fn put_all<T, const N: usize>(&self, out: &mut [T], value: impl Fn([u8; N]) -> f32, put: impl Fn(&mut T, f32)) {
        let samples = &self.bytes.as_chunks::<N>().0[self.skipped..];
        out.iter_mut().zip(samples).for_each(|(slot, bytes)| put(slot, value(*bytes)));
    }
}

/// Decodes the blocks in batches, each in parallel, and sees that every one arrives exactly once.
fn read_blocks(
    mut chunks: FilteredChunksReader<Watched<'_>>,
    part: usize,
    window: &Window,
    storage: &mut Storage,
) -> Result<(), FormatError> {
    use ::exr::block::reader::ChunksReader;

    let meta = chunks.meta_data().clone();
    let header = &meta.headers[part];
    let batch_size = 4 * rayon::current_num_threads();
    let mut arrived = Arrived::none_of(header, chunks.expected_chunk_count());
    loop {
        let batch: Vec<Chunk> = chunks.by_ref().take(batch_size).collect::<Result<_, _>>().map_err(|error| block_error(&error))?;
        if batch.is_empty() {
            return arrived.check_complete();
        }
        for chunk in &batch {
            arrived.note(header, part, chunk)?;
        }
        let blocks: Vec<_> = batch.into_par_iter().map(|chunk| UncompressedBlock::decompress_chunk(chunk, &meta, false)).collect();
        for block in blocks {
            let place = format!("block (compression {})", header.compression);
            storage.place(&block.map_err(|error| translated(&error, &place))?, window);
        }
    }
}

/// Which blocks of a part have been seen.
struct Arrived {
    seen: Vec<bool>,
    /// Blocks side by side.
    columns: usize,
    expected_count: usize,
    count: usize,
}

impl Arrived {
    fn none_of(header: &Header, expected_count: usize) -> Self {
        let size = header.max_block_pixel_size();
        let columns = header.layer_size.x().div_ceil(size.x().max(1));
        let rows = header.layer_size.y().div_ceil(size.y().max(1));
        Self { seen: vec![false; columns * rows], columns, expected_count, count: 0 }
    }

    fn note(&mut self, header: &Header, part: usize, chunk: &Chunk) -> Result<(), FormatError> {
        let invalid = |what: String| FormatError::damaged(TITLE, format!("invalid block: {what}"));
        if chunk.layer_index != part {
            return Err(invalid(format!("the offset table leads to a block of part {}", chunk.layer_index)));
        }
        if let CompressedBlock::ScanLine(block) = &chunk.compressed_block {
            let line = i64::from(block.y_coordinate) - i64::from(header.own_attributes.layer_position.y());
            if line < 0 || line % header.compression.scan_lines_per_block() as i64 != 0 {
                return Err(invalid(format!("line coordinate {} begins no block", block.y_coordinate)));
            }
        }
        let at = header.get_block_data_indices(&chunk.compressed_block).map_err(|error| block_error(&error))?;
        let (column, row) = (at.tile_index.x(), at.tile_index.y());
        let slot = (at.level_index == Vec2(0, 0) && column < self.columns)
            .then(|| self.seen.get_mut(row.checked_mul(self.columns)? + column))
            .flatten()
            .ok_or_else(|| invalid(format!("coordinate ({column}, {row}) lies outside the data window")))?;
        if std::mem::replace(slot, true) {
            return Err(invalid(format!("coordinate ({column}, {row}) is a duplicate")));
        }
        self.count += 1;
        Ok(())
    }

    fn check_complete(&self) -> Result<(), FormatError> {
        if self.count == self.seen.len() && self.count == self.expected_count {
            return Ok(());
        }
        Err(FormatError::truncated(TITLE, format!("{} of {} blocks are there", self.count, self.seen.len())))
    }
}

fn has_levels(header: &Header) -> bool {
    use ::exr::meta::attribute::LevelMode;
    matches!(header.blocks, BlockDescription::Tiles(tiles) if tiles.level_mode != LevelMode::Singular)
}

fn described(header: &Header, part_count: usize) -> Decoded {
    let mut decoded = Decoded::linear(FORMAT.name, Image::opaque(Raster::new(0, 0, Vec::new())));
    let channels = header.channels.list.iter().take(64).map(|channel| {
        let kind = match channel.sample_type {
            SampleType::F16 => "half",
            SampleType::F32 => "float",
            SampleType::U32 => "uint",
        };
        format!("{} ({kind})", super::escaped(&channel.name.to_string()))
    });
    let blocks = match header.blocks {
        BlockDescription::ScanLines => "scan lines".to_owned(),
        BlockDescription::Tiles(tiles) => format!("tiles of {} x {}", tiles.tile_size.x(), tiles.tile_size.y()),
    };
    decoded.facts = vec![
        ("channels".into(), channels.collect::<Vec<_>>().join(", ")),
        ("compression".into(), header.compression.to_string()),
        ("blocks".into(), blocks),
        ("data window".into(), window_text(header.data_window())),
        ("display window".into(), window_text(header.shared_attributes.display_window)),
    ];
    if part_count > 1 {
        decoded.facts.push(("parts".into(), part_count.to_string()));
        decoded.warnings.push(format!("the file has {part_count} parts: the first one with color was read"));
    }
    if let Some(given) = header.shared_attributes.chromaticities.filter(|given| !is_rec_709(given)) {
        let text = [given.red, given.green, given.blue, given.white].map(|at| format!("({}, {})", at.x(), at.y())).join(" ");
        decoded.facts.push(("chromaticities".into(), text.clone()));
        decoded.warnings.push(format!("chromaticities {text} are not those of Rec. 709: colors were not converted"));
    }
    let attributes: BTreeMap<String, String> = text_attributes(header).take(64).collect();
    let shown = attributes.into_iter().map(|(name, text)| (super::escaped(&name), super::escaped(&text)));
    decoded.facts.extend(shown);
    decoded
}

fn window_text(window: IntegerBounds) -> String {
    format!("{} x {} at ({}, {})", window.size.x(), window.size.y(), window.position.x(), window.position.y())
}

fn is_rec_709(given: &Chromaticities) -> bool {
    let pairs = [(given.red, (0.64, 0.33)), (given.green, (0.30, 0.60)), (given.blue, (0.15, 0.06)), (given.white, (0.3127, 0.3290))];
    pairs.iter().all(|(at, (x, y))| (at.x() - x).abs() < 0.001 && (at.y() - y).abs() < 0.001)
}

fn text_attributes(header: &Header) -> impl Iterator<Item = (String, String)> {
    header.own_attributes.other.iter().filter_map(|(name, value)| match value {
        AttributeValue::Text(text) => Some((name.to_string(), String::from_utf8_lossy(text.as_slice()).into_owned())),
        _ => None,
    })
}

fn header_error(error: &ExrError) -> FormatError {
    translated(error, "header or attribute")
}

fn block_error(error: &ExrError) -> FormatError {
    translated(error, "block")
}

fn translated(error: &ExrError, place: &str) -> FormatError {
    match error {
        ExrError::NotSupported(feature) => FormatError::unsupported(TITLE, super::escaped(feature)),
        ExrError::Invalid(problem) if problem == "reference to missing bytes" => {
            FormatError::truncated(TITLE, format!("end of the file within a {place}"))
        }
        ExrError::Invalid(problem) => FormatError::damaged(TITLE, format!("invalid {place}: {}", super::escaped(problem))),
        ExrError::Io(problem) => FormatError::damaged(TITLE, format!("invalid {place}: {}", super::escaped(&problem.to_string()))),
        ExrError::Aborted => unreachable!("nothing here aborts a read"),
    }
}

/// One channel to write.
enum Source<'a> {
    Component(&'a Raster, usize),
    Plane(&'a Plane),
}

impl Source<'_> {
    fn write_line(&self, y: usize, out: &mut Vec<u8>) {
        match self {
            Self::Component(raster, index) => out.extend(raster.row(y).iter().flat_map(|pixel| pixel[*index].to_ne_bytes())),
            Self::Plane(plane) => {
                let row = &plane.values[y * plane.width..(y + 1) * plane.width];
                out.extend(row.iter().flat_map(|value| value.to_ne_bytes()));
            }
        }
    }
}

/// The channels of an image by name, in the order of their bytes, as the format asks for.
fn sources(image: &Image) -> BTreeMap<String, Source<'_>> {
    const COMPONENTS: [&str; 3] = ["R", "G", "B"];
    let mut sources = BTreeMap::new();
    for (index, name) in COMPONENTS.iter().enumerate() {
        sources.insert((*name).to_owned(), Source::Component(&image.color, index));
    }
    if let Some(alpha) = &image.alpha {
        sources.insert("A".into(), Source::Plane(alpha));
    }
    for (name, layer) in &image.layers {
        match layer {
            Layer::Color(raster) => {
                for (index, component) in COMPONENTS.iter().enumerate() {
                    sources.insert(format!("{name}.{component}"), Source::Component(raster, index));
                }
            }
            Layer::Scalar(plane) if name == "depth" => drop(sources.insert("Z".into(), Source::Plane(plane))),
            Layer::Scalar(plane) => drop(sources.insert(format!("{name}.Y"), Source::Plane(plane))),
        }
    }
    sources
}

fn compressed_block(
    header: &Header,
    sources: &BTreeMap<String, Source<'_>>,
    first_line: usize,
    line_count: usize,
) -> Result<Vec<u8>, FormatError> {
    let width = header.layer_size.x();
    let mut data = Vec::with_capacity(width * line_count * sources.len() * 4);
    for y in first_line..first_line + line_count {
        sources.values().for_each(|source| source.write_line(y, &mut data));
    }
    let section = IntegerBounds { position: Vec2(0, first_line as i32), size: Vec2(width, line_count) };
    let compressed = header.compression.compress_image_section_to_le(header, data, section);
    compressed.map_err(|error| FormatError::Unwritable(format!("{TITLE}: {error}")))
}

fn written_header(
    sources: &BTreeMap<String, Source<'_>>,
    width: usize,
    height: usize,
    entries: &[Entry<'_>],
) -> Result<Vec<u8>, FormatError> {
    const LONGEST_NAME: usize = 255;
    const LONGEST_SHORT_NAME: usize = 31;
    let names = || sources.keys().cloned().chain(entries.iter().map(|(name, _)| format!("{ENTRY_PREFIX}{name}")));
    if let Some(name) = names().find(|name| name.len() > LONGEST_NAME || name.contains('\0') || name.is_empty()) {
        return Err(FormatError::Unwritable(format!("{TITLE}: `{}` cannot be the name of a channel or attribute", super::escaped(&name))));
    }
    let has_long_names = names().any(|name| name.len() > LONGEST_SHORT_NAME);

    let mut out = MAGIC.to_vec();
    out.extend((2u32 | if has_long_names { 0x400 } else { 0 }).to_le_bytes());
    let mut attribute = |name: &str, kind: &str, value: &[u8]| {
        out.extend([name.as_bytes(), b"\0", kind.as_bytes(), b"\0", &(value.len() as i32).to_le_bytes(), value].concat());
    };
    let window = [0, 0, width as i32 - 1, height as i32 - 1].map(i32::to_le_bytes).concat();
    attribute("channels", "chlist", &channel_list(sources));
    attribute("compression", "compression", &[3]);
    attribute("dataWindow", "box2i", &window);
    attribute("displayWindow", "box2i", &window);
    attribute("lineOrder", "lineOrder", &[0]);
    attribute("pixelAspectRatio", "float", &1f32.to_le_bytes());
    attribute("screenWindowCenter", "v2f", &[0; 8]);
    attribute("screenWindowWidth", "float", &1f32.to_le_bytes());
    for (name, text) in entries {
        attribute(&format!("{ENTRY_PREFIX}{name}"), "string", text.as_bytes());
    }
    out.push(0);
    Ok(out)
}

fn channel_list(sources: &BTreeMap<String, Source<'_>>) -> Vec<u8> {
    const FLOAT: i32 = 2;
    let mut out = Vec::new();
    for name in sources.keys() {
        out.extend(name.as_bytes());
        out.push(0);
        out.extend(FLOAT.to_le_bytes());
        // Not perceptually linear, three bytes of padding, every pixel in both directions.
        out.extend([0; 4]);
        out.extend([1i32, 1].map(i32::to_le_bytes).concat());
    }
    out.push(0);
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::Content;

    fn layered(width: usize, height: usize) -> Image {
        let value = |index: usize, seed: usize| ((index * 37 + seed * 101) % 997) as f32 / 7.0 - 20.0;
        let raster =
            |seed| Raster::new(width, height, (0..width * height).map(|index| [0usize, 1, 2].map(|c| value(index, seed + c))).collect());
        let plane = |seed| Plane { width, height, values: (0..width * height).map(|index| value(index, seed)).collect() };
        let layers = [
            ("depth".to_owned(), Layer::Scalar(plane(9))),
            ("standard_error".to_owned(), Layer::Scalar(plane(10))),
            ("variance".to_owned(), Layer::Color(raster(20))),
        ];
        Image { color: raster(0), alpha: Some(plane(5)), layers: layers.into() }
    }

    fn image(bytes: &[u8]) -> Image {
        let Content::Linear(image) = read(bytes, &Limits::default()).unwrap().content else { panic!("an EXR is linear") };
        image
    }

    #[test]
    fn differences_of_b44_wrap_in_every_build() {
        let image = image(include_bytes!("../../fuzz/seeds/exr/b44-wraps.exr"));
        assert_eq!((image.color.width(), image.color.height()), (40, 4));
    }

    #[test]
    fn color_alpha_and_layers_come_back_as_they_went() {
        for (width, height) in [(1, 1), (33, 40), (64, 16)] {
            let original = layered(width, height);
            let (bytes, _) = write(&original, &[]).unwrap();
            assert_eq!(image(&bytes), original, "{width} x {height}");
            assert_eq!(read(&bytes, &Limits::default()).unwrap().warnings, [""; 0]);
        }
    }

    #[test]
    fn values_that_are_not_numbers_keep_their_bits() {
        let strange = [f32::NAN, f32::INFINITY, -0.0];
        let bytes = write(&Image::opaque(Raster::filled(3, 2, strange)), &[]).unwrap().0;
        assert_eq!(image(&bytes).color.pixel(2, 1).map(f32::to_bits), strange.map(f32::to_bits));
    }

    #[test]
    fn the_origin_is_found_again() {
        let entries = [("pipeline", "coursework"), ("stage", "sphere"), ("coordinate", ""), ("key", "ab12")];
        let bytes = write(&layered(5, 3), &entries).unwrap().0;
        let found: BTreeMap<_, _> = origin(&bytes).into_iter().collect();
        assert_eq!(found, entries.iter().map(|(name, text)| (name.to_string(), text.to_string())).collect());
        assert_eq!(bytes, write(&layered(5, 3), &entries).unwrap().0);
    }

    #[test]
    fn a_block_that_comes_twice_is_refused() {
        let mut bytes = write(&layered(4, 40), &[]).unwrap().0;
        // The second block (of lines 16 to 31) now claims line 0.
        let at = bytes.windows(4).rposition(|window| window == 16i32.to_le_bytes()).unwrap();
        bytes[at..at + 4].copy_from_slice(&0i32.to_le_bytes());
        let error = read(&bytes, &Limits::default()).unwrap_err().to_string();
        assert!(error.contains("duplicate"), "{error}");
    }

    #[test]
    fn a_clipped_line_keeps_what_lies_in_the_picture() {
        assert_eq!(Window::clipped(-2, 5, 10), (2, 0, 3));
        assert_eq!(Window::clipped(8, 5, 10), (0, 8, 2));
        assert_eq!(Window::clipped(12, 5, 10).2, 0);
        assert_eq!(Window::clipped(-9, 5, 10).2, 0);
    }
}

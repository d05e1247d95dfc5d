//! Radiance pictures: RGB with one shared exponent, 4 bytes a pixel, run lengths of two sorts.
//!
//! A channel is m * 2^(e - 136), or 0 where e is 0, without the half quantum that Radiance itself adds.
//! `EXPOSURE` and `COLORCORR` lines are divided out, so that pixels are radiance. All eight scan orders
//! are turned upright. CIE XYZ pixels are refused: the file does not say which white they mean.
//!
//! After G. Ward, "Real pixels" (Graphics Gems II, 1991), and the Radiance file format reference.

use super::{Decoded, Encoded, Entry, Format, FormatError, Limits};
use crate::image::raster::{Image, Raster};

/// The row of this format.
pub const FORMAT: Format = Format {
    name: "hdr",
    title: TITLE,
    extensions: &["hdr", "pic", "rgbe"],
    sniff: |bytes| bytes.starts_with(b"#?"),
    read,
    write,
    write_picture: None,
    origin: super::no_origin,
};

const TITLE: &str = "Radiance HDR";
const LONGEST_HEADER: usize = 1 << 16;

/// Widths that the run lengths of one channel after the other can have.
const CHANNEL_RUN_WIDTHS: std::ops::RangeInclusive<usize> = 8..=32_767;

/// The largest value there is: 255 * 2^119.
const LARGEST: f64 = 255.0 * f64::from_bits((1023 + 119) << 52);

type Rgbe = [u8; 4];

/// Reads a Radiance picture.
pub fn read(bytes: &[u8], limits: &Limits) -> Result<Decoded, FormatError> {
    let header = Header::parse(bytes)?;
    let order = &header.order;
    let (width, height) = limits.checked(TITLE, order.width(), order.height())?;
    let pixels = pixels(&bytes[header.end..], order.line_count as usize, order.line_length as usize, header.factors)?;

    let raster = order.upright(width, height, pixels.values);
    let mut decoded = Decoded::linear(FORMAT.name, Image::opaque(raster));
    decoded.warnings = header.warnings;
    decoded.warnings.extend(super::trailing_warning(bytes.len() - header.end - pixels.size));
    decoded.facts = header.facts;
    Ok(decoded)
}

/// Writes channel-wise run lengths in the usual order, each mantissa rounded to the nearest.
///
/// Negative values and NaN become 0, infinities the largest value; how many is a warning.
pub fn write(image: &Image, _: &[Entry<'_>]) -> Result<Encoded, FormatError> {
    let color = &image.color;
    let header = format!("#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y {} +X {}\n", color.height(), color.width());
    let mut bytes = header.into_bytes();
    for y in 0..color.height() {
        let line: Vec<Rgbe> = color.row(y).iter().map(|pixel| shared_exponent(*pixel)).collect();
        write_line(&line, &mut bytes);
    }
    let is_lost = |value: &f32| !(0.0..=LARGEST).contains(&f64::from(*value));
    let lost = color.pixels().iter().filter(|pixel| pixel.iter().any(is_lost)).count();
    let mut warnings = super::layers_left_out(image, TITLE);
    if lost > 0 {
        warnings.push(format!("{lost} pixels are negative, not finite or over 1.7e38, which {TITLE} cannot hold: they were clipped"));
    }
    Ok((bytes, warnings))
}

struct Header {
    order: ScanOrder,
    /// What each channel is multiplied by.
    factors: [f64; 3],
    facts: Vec<(String, String)>,
    warnings: Vec<String>,
    /// Position of the first byte of pixels.
    end: usize,
}

impl Header {
    fn parse(bytes: &[u8]) -> Result<Self, FormatError> {
        let mut lines = Lines { bytes, position: 0 };
        let signature = lines.next()?;
        if signature != b"#?RADIANCE" && signature != b"#?RGBE" {
            let problem = format!("bad signature `{}`: expected `#?RADIANCE` or `#?RGBE`", shown(signature));
            return Err(FormatError::damaged(TITLE, problem));
        }
        let mut variables = Variables::default();
        loop {
            match lines.next()? {
                b"" => break,
                line if ScanOrder::parse(line).is_some() => {
                    return Err(FormatError::damaged(TITLE, "the resolution line stands before the blank line that ends the header"));
                }
                line => variables.take(line)?,
            }
        }
        let line = lines.next()?;
        let order = ScanOrder::parse(line)
            .ok_or_else(|| FormatError::damaged(TITLE, format!("resolution line `{}`: expected one like `-Y 512 +X 1024`", shown(line))))?;
        let facts = [("scan order".into(), order.text())].into_iter().chain(variables.facts).collect();
        Ok(Self { order, factors: variables.factors, facts, warnings: variables.warnings, end: lines.position })
    }
}

struct Lines<'a> {
    bytes: &'a [u8],
    position: usize,
}

impl<'a> Lines<'a> {
    fn next(&mut self) -> Result<&'a [u8], FormatError> {
        let header = &self.bytes[..self.bytes.len().min(LONGEST_HEADER)];
        let Some(length) = header[self.position..].iter().position(|byte| *byte == b'\n') else {
            return Err(if self.bytes.len() > LONGEST_HEADER {
                FormatError::damaged(TITLE, format!("the header is longer than {LONGEST_HEADER} bytes, or its lines have no end"))
            } else {
                FormatError::truncated(TITLE, "end of the file within the header, before the resolution line")
            });
        };
        let line = &header[self.position..self.position + length];
        self.position += length + 1;
        Ok(line.strip_suffix(b"\r").unwrap_or(line))
    }
}

struct Variables {
    factors: [f64; 3],
    facts: Vec<(String, String)>,
    warnings: Vec<String>,
}

impl Default for Variables {
    fn default() -> Self {
        Self { factors: [1.0; 3], facts: Vec::new(), warnings: Vec::new() }
    }
}

impl Variables {
    fn take(&mut self, line: &[u8]) -> Result<(), FormatError> {
        if line.starts_with(b"#") {
            return Ok(());
        }
        let text = String::from_utf8_lossy(line);
        let Some((name, value)) = text.split_once('=') else { return Ok(()) };
        let value = value.trim();
        match name.trim() {
            "FORMAT" => self.take_format(value)?,
            "EXPOSURE" => self.divide(&[divisor("EXPOSURE", value)?; 3]),
            "COLORCORR" => {
                let parts: Vec<_> = value.split_ascii_whitespace().map(|part| divisor("COLORCORR", part)).collect::<Result<_, _>>()?;
                let parts = parts.try_into().map_err(|_| FormatError::damaged(TITLE, "COLORCORR needs three numbers"))?;
                self.divide(&parts);
            }
            "GAMMA" if value.parse::<f64>().is_ok_and(|gamma| gamma != 1.0) => {
                self.warnings.push(format!("GAMMA={} in the header is not part of the format and was ignored", shown(value.as_bytes())));
            }
            "PRIMARIES" if is_foreign_primaries(value) => {
                self.warnings.push(format!("PRIMARIES={} are not those of Rec. 709: colors were not converted", shown(value.as_bytes())));
            }
            _ => return Ok(()),
        }
        self.facts.push((name.trim().to_ascii_lowercase(), shown(value.as_bytes())));
        Ok(())
    }

    fn take_format(&mut self, value: &str) -> Result<(), FormatError> {
        match value {
            "32-bit_rle_rgbe" => Ok(()),
            "32-bit_rle_xyze" => Err(FormatError::unsupported(
                TITLE,
                "FORMAT=32-bit_rle_xyze: CIE XYZ pixels do not say which white they mean; convert them with `ra_xyze -r`",
            )),
            other => Err(FormatError::damaged(TITLE, format!("FORMAT=`{}`: expected 32-bit_rle_rgbe", shown(other.as_bytes())))),
        }
    }

    fn divide(&mut self, divisors: &[f64; 3]) {
        for (factor, divisor) in self.factors.iter_mut().zip(divisors) {
            *factor /= divisor;
        }
    }
}

fn divisor(name: &str, text: &str) -> Result<f64, FormatError> {
    let number = text.parse::<f64>().ok().filter(|number| number.is_finite() && *number > 0.0);
    number.ok_or_else(|| FormatError::damaged(TITLE, format!("{name} `{}`: expected a positive number", shown(text.as_bytes()))))
}

fn is_foreign_primaries(value: &str) -> bool {
    const RADIANCE: [f64; 6] = [0.640, 0.330, 0.290, 0.600, 0.150, 0.060];
    const REC_709: [f64; 6] = [0.640, 0.330, 0.300, 0.600, 0.150, 0.060];
    let given: Vec<f64> = value.split_ascii_whitespace().filter_map(|word| word.parse().ok()).collect();
    let is_near = |known: &[f64; 6]| known.iter().zip(&given).all(|(a, b)| (a - b).abs() < 0.005);
    // Some writers fill the line with zeros, which are no primaries at all.
    given.len() == 8 && given.iter().any(|value| *value != 0.0) && !is_near(&RADIANCE) && !is_near(&REC_709)
}

/// Which way the lines of a file run.
struct ScanOrder {
    /// Whether lines are columns.
    is_transposed: bool,
    /// Whether the file begins at the right.
    is_right_first: bool,
    /// Whether the file begins at the bottom.
    is_bottom_first: bool,
    line_count: u64,
    line_length: u64,
}

impl ScanOrder {
    fn parse(line: &[u8]) -> Option<Self> {
        let words: Vec<&str> = std::str::from_utf8(line).ok()?.split_ascii_whitespace().collect();
        let [first, count, second, length] = words[..] else { return None };
        let whole = |word: &str| word.bytes().all(|byte| byte.is_ascii_digit()).then(|| word.parse().ok()).flatten();
        let axis = |word: &str| match word {
            "-Y" | "+Y" | "-X" | "+X" => Some((word.ends_with('X'), word.starts_with('-'))),
            _ => None,
        };
        let ((first_is_x, first_is_minus), (second_is_x, second_is_minus)) = (axis(first)?, axis(second)?);
        if first_is_x == second_is_x {
            return None;
        }
        // Y points up: a file that begins at the top has Y decreasing.
        let (x_is_minus, y_is_minus) = if first_is_x { (first_is_minus, second_is_minus) } else { (second_is_minus, first_is_minus) };
        Some(Self {
            is_transposed: first_is_x,
            is_right_first: x_is_minus,
            is_bottom_first: !y_is_minus,
            line_count: whole(count)?,
            line_length: whole(length)?,
        })
    }

    fn width(&self) -> u64 {
        if self.is_transposed { self.line_count } else { self.line_length }
    }

    fn height(&self) -> u64 {
        if self.is_transposed { self.line_length } else { self.line_count }
    }

    fn text(&self) -> String {
        let x = if self.is_right_first { "-X" } else { "+X" };
        let y = if self.is_bottom_first { "+Y" } else { "-Y" };
        if self.is_transposed { format!("{x} {y}") } else { format!("{y} {x}") }
    }

    /// The picture with its top row first; copies only what is not in that order already.
    fn upright(&self, width: usize, height: usize, pixels: Vec<[f32; 3]>) -> Raster {
        if !self.is_transposed && !self.is_right_first && !self.is_bottom_first {
            return Raster::new(width, height, pixels);
        }
        let turned = (0..width * height).map(|index| {
            let (x, y) = (index % width, index / width);
            let x = if self.is_right_first { width - 1 - x } else { x };
            let y = if self.is_bottom_first { height - 1 - y } else { y };
            if self.is_transposed { pixels[x * height + y] } else { pixels[y * width + x] }
        });
        Raster::new(width, height, turned.collect())
    }
}

struct Pixels {
    values: Vec<[f32; 3]>,
    /// How many bytes they took in the file.
    size: usize,
}

/// Decodes all scan lines. Room is taken as lines come, so that a lying header costs nothing.
fn pixels(bytes: &[u8], line_count: usize, line_length: usize, factors: [f64; 3]) -> Result<Pixels, FormatError> {
    let scales = scales(factors);
    let mut input = Input { bytes, position: 0, run: Run::default() };
    let mut line = vec![[0; 4]; line_length];
    let mut values = Vec::new();
    for index in 0..line_count {
        read_line(&mut input, &mut line).map_err(|fault| fault.error(index))?;
        values.extend(line.iter().map(|[r, g, b, e]| {
            let scale = &scales[usize::from(*e)];
            [scale[0] * f64::from(*r), scale[1] * f64::from(*g), scale[2] * f64::from(*b)].map(|value| value as f32)
        }));
    }
    if input.run.left > 0 {
        return Err(Fault::Breaks("a run is longer than the picture".into()).error(line_count - 1));
    }
    values.shrink_to_fit();
    Ok(Pixels { values, size: input.position })
}

/// The value of one unit of mantissa, by exponent and channel.
fn scales(factors: [f64; 3]) -> Vec<[f64; 3]> {
    let power = |exponent: i32| f64::from_bits(((1023 + exponent - 136) as u64) << 52);
    (0..256).map(|exponent| if exponent == 0 { [0.0; 3] } else { factors.map(|factor| factor * power(exponent)) }).collect()
}

/// What is wrong with a scan line.
enum Fault {
    Ends,
    Breaks(String),
}

impl Fault {
    fn error(self, line: usize) -> FormatError {
        match self {
            Self::Ends => FormatError::truncated(TITLE, format!("end of the file within scanline {line}")),
            Self::Breaks(problem) => FormatError::damaged(TITLE, format!("scanline {line}: {problem}")),
        }
    }
}

struct Input<'a> {
    bytes: &'a [u8],
    position: usize,
    run: Run,
}

/// Where an old run stands; it may go on in the next line.
#[derive(Default)]
struct Run {
    /// The pixel that a run repeats.
    previous: Option<Rgbe>,
    /// Repetitions that the line before had no place for.
    left: usize,
    /// Weight of the next count byte, as a number of bits.
    shift: u32,
}

impl Input<'_> {
    fn take(&mut self, count: usize) -> Result<&[u8], Fault> {
        let taken = self.bytes.get(self.position..self.position + count).ok_or(Fault::Ends)?;
        self.position += count;
        Ok(taken)
    }

    fn byte(&mut self) -> Result<u8, Fault> {
        Ok(self.take(1)?[0])
    }

    fn pixel(&mut self) -> Result<Rgbe, Fault> {
        Ok(self.take(4)?.try_into().expect("four bytes were taken"))
    }
}

fn read_line(input: &mut Input<'_>, line: &mut [Rgbe]) -> Result<(), Fault> {
    let rest = &input.bytes[input.position..];
    let is_channel_wise = CHANNEL_RUN_WIDTHS.contains(&line.len()) && rest.len() >= 4 && rest[..2] == [2, 2] && rest[2] < 128;
    if !is_channel_wise || input.run.left > 0 {
        return read_pixel_runs(input, line);
    }
    input.run = Run::default();
    let [_, _, high, low] = input.pixel()?;
    let width = usize::from(high) << 8 | usize::from(low);
    if width != line.len() {
        return Err(Fault::Breaks(format!("its width {width} differs from the {} of the resolution line", line.len())));
    }
    (0..4).try_for_each(|channel| read_channel_runs(input, line, channel))
}

/// New run lengths: of each channel, counts above 128 repeat a byte, others copy bytes.
fn read_channel_runs(input: &mut Input<'_>, line: &mut [Rgbe], channel: usize) -> Result<(), Fault> {
    let mut x = 0;
    while x < line.len() {
        let code = usize::from(input.byte()?);
        let (is_run, count) = if code > 128 { (true, code - 128) } else { (false, code) };
        if count == 0 {
            return Err(Fault::Breaks("a run of length 0".into()));
        }
        let Some(pixels) = line.get_mut(x..x + count) else {
            return Err(Fault::Breaks("a run is longer than the line".into()));
        };
        if is_run {
            let value = input.byte()?;
            pixels.iter_mut().for_each(|pixel| pixel[channel] = value);
        } else {
            pixels.iter_mut().zip(input.take(count)?).for_each(|(pixel, value)| pixel[channel] = *value);
        }
        x += count;
    }
    Ok(())
}

/// Flat pixels and old run lengths: (1, 1, 1, n) repeats the pixel before, further ones count in higher bytes.
///
/// Some writers let a run go on over the end of a line.
fn read_pixel_runs(input: &mut Input<'_>, line: &mut [Rgbe]) -> Result<(), Fault> {
    let mut x = 0;
    while x < line.len() {
        if let (Some(previous), 1..) = (input.run.previous, input.run.left) {
            let count = input.run.left.min(line.len() - x);
            line[x..x + count].fill(previous);
            input.run.left -= count;
            x += count;
            continue;
        }
        let pixel = input.pixel()?;
        if pixel[..3] != [1, 1, 1] {
            line[x] = pixel;
            input.run = Run { previous: Some(pixel), ..Run::default() };
            x += 1;
            continue;
        }
        if input.run.previous.is_none() {
            return Err(Fault::Breaks("a run with no previous pixel".into()));
        }
        // Four count bytes are more than any picture within the limits has pixels.
        if input.run.shift > 24 {
            return Err(Fault::Breaks("a run is longer than the picture".into()));
        }
        input.run.left = usize::from(pixel[3]) << input.run.shift;
        input.run.shift += 8;
    }
    Ok(())
}

/// Common exponent and mantissas of a pixel, to the nearest; the largest mantissa is at least 128.
fn shared_exponent(pixel: [f32; 3]) -> Rgbe {
    let [r, g, b] = pixel.map(|value| if value > 0.0 { f64::from(value).min(LARGEST) } else { 0.0 });
    let brightest = r.max(g).max(b);
    // The exponent for which brightest / 2^(e - 128) lies in [0.5, 1): its own, one higher.
    let mut exponent = (brightest.to_bits() >> 52) as i32 - 1022 + 128;
    let mantissa = |value: f64, exponent: i32| (value * f64::from_bits(((1023 + 136 - exponent) as u64) << 52)).round();
    if brightest > 0.0 && exponent <= 255 && mantissa(brightest, exponent) > 255.0 {
        exponent += 1;
    }
    // Below that the mantissa would lose its leading bit, and (1, 1, 1) would be taken for a run.
    if brightest == 0.0 || exponent < 1 {
        return [0; 4];
    }
    let exponent = exponent.min(255);
    let [r, g, b] = [r, g, b].map(|value| mantissa(value, exponent).min(255.0) as u8);
    [r, g, b, exponent as u8]
}

fn write_line(line: &[Rgbe], out: &mut Vec<u8>) {
    if !CHANNEL_RUN_WIDTHS.contains(&line.len()) {
        return out.extend(line.iter().flatten());
    }
    out.extend([2, 2, (line.len() >> 8) as u8, line.len() as u8]);
    for channel in 0..4 {
        let values: Vec<u8> = line.iter().map(|pixel| pixel[channel]).collect();
        write_runs(&values, out);
    }
}

fn write_runs(values: &[u8], out: &mut Vec<u8>) {
    // A shorter run costs as much as the literal it interrupts.
    const SHORTEST_RUN: usize = 4;
    let run_at = |start: usize| values[start..].iter().take(127).take_while(|value| **value == values[start]).count();
    let mut start = 0;
    while start < values.len() {
        let run = run_at(start);
        if run >= SHORTEST_RUN {
            out.extend([128 + run as u8, values[start]]);
            start += run;
            continue;
        }
        let mut end = start + run;
        while end < values.len() && end - start < 128 && run_at(end) < SHORTEST_RUN {
            end += 1;
        }
        let end = end.min(start + 128);
        out.push((end - start) as u8);
        out.extend(&values[start..end]);
        start = end;
    }
}

fn shown(text: &[u8]) -> String {
    super::escaped(&String::from_utf8_lossy(&text[..text.len().min(80)]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::Content;

    fn color(bytes: &[u8]) -> Raster {
        let Content::Linear(image) = read(bytes, &Limits::default()).unwrap().content else { panic!("an HDR is linear") };
        image.color
    }

    fn file(variables: &str, resolution: &str, data: &[u8]) -> Vec<u8> {
        [format!("#?RADIANCE\n{variables}FORMAT=32-bit_rle_rgbe\n\n{resolution}\n").as_bytes(), data].concat()
    }

    #[test]
    fn every_order_of_scanning_gives_the_same_upright_picture() {
        // A 3 x 2 picture whose pixel (x, y) has the mantissa 10 y + x + 128 at exponent 136, one unit each.
        let pixel = |x: u8, y: u8| [128 + 10 * y + x, 0, 0, 136];
        for (x_order, xs) in [("+X 3", [0, 1, 2]), ("-X 3", [2, 1, 0])] {
            for (y_order, ys) in [("-Y 2", [0, 1]), ("+Y 2", [1, 0])] {
                let rows: Vec<u8> = ys.iter().flat_map(|y| xs.iter().flat_map(move |x| pixel(*x, *y))).collect();
                let columns: Vec<u8> = xs.iter().flat_map(|x| ys.iter().flat_map(move |y| pixel(*x, *y))).collect();
                for (resolution, data) in [(format!("{y_order} {x_order}"), rows), (format!("{x_order} {y_order}"), columns)] {
                    let picture = color(&file("", &resolution, &data));
                    assert_eq!((picture.width(), picture.height()), (3, 2), "{resolution}");
                    let reds: Vec<f32> = picture.pixels().iter().map(|pixel| pixel[0]).collect();
                    assert_eq!(reds, [128.0, 129.0, 130.0, 138.0, 139.0, 140.0], "{resolution}");
                }
            }
        }
    }

    #[test]
    fn exposures_multiply_and_are_divided_out() {
        let bytes = file("EXPOSURE=2\nEXPOSURE= 4.0\nCOLORCORR=1 2 4\n", "-Y 1 +X 1", &[160, 160, 160, 136]);
        assert_eq!(color(&bytes).pixel(0, 0), [20.0, 10.0, 5.0]);
    }

    #[test]
    fn written_values_are_the_nearest_that_the_format_has() {
        for value in [1.0f32, 0.999, 255.0, 255.4, 255.6, 511.0, 0.1, 3e-38, 1e30, 1.0 / 3.0] {
            let image = Image::opaque(Raster::filled(1, 1, [value, value * 0.4, 0.0]));
            let read_back = color(&write(&image, &[]).unwrap().0).pixel(0, 0);
            // Half a unit of a mantissa that is at least 128.
            assert!((read_back[0] - value).abs() <= value / 256.0, "{value}: {read_back:?}");
            assert!((read_back[1] - value * 0.4).abs() <= value / 256.0, "{value}: {read_back:?}");
        }
    }

    #[test]
    fn what_the_format_has_survives_writing_exactly() {
        for width in [1, 7, 8, 9, 130, 300] {
            let pixel = |index: usize| [(index * 7 % 256) as f32, 200.0, if index % 50 < 40 { 3.0 } else { index as f32 % 9.0 }];
            let raster = Raster::new(width, 2, (0..2 * width).map(pixel).collect());
            let bytes = write(&Image::opaque(raster.clone()), &[]).unwrap().0;
            assert_eq!(color(&bytes), raster, "{width}");
            assert!(read(&bytes, &Limits::default()).unwrap().warnings.is_empty());
        }
    }

    #[test]
    fn what_the_format_cannot_hold_is_clipped_and_counted() {
        let raster = Raster::new(4, 1, vec![[-1.0, 0.5, 0.0], [f32::NAN, 1.0, 1.0], [f32::INFINITY, 0.0, 0.0], [1.0; 3]]);
        let (bytes, warnings) = write(&Image::opaque(raster), &[]).unwrap();
        assert!(warnings[0].starts_with("3 pixels"), "{warnings:?}");
        let picture = color(&bytes);
        assert_eq!(picture.row(0)[0], [0.0, 0.5, 0.0]);
        assert_eq!(picture.row(0)[1], [0.0, 1.0, 1.0]);
        assert_eq!(picture.row(0)[2][0], LARGEST as f32);
    }

    #[test]
    fn an_old_run_counts_in_bytes_of_rising_weight() {
        let mut data = vec![200, 100, 50, 136];
        data.extend([1, 1, 1, 43, 1, 1, 1, 1]);
        let picture = color(&file("", "-Y 1 +X 300", &data));
        assert!(picture.pixels().iter().all(|pixel| *pixel == [200.0, 100.0, 50.0]));
        // The same run over the lines of a taller picture.
        let picture = color(&file("", "-Y 30 +X 10", &data));
        assert!(picture.pixels().iter().all(|pixel| *pixel == [200.0, 100.0, 50.0]));
        assert!(read(&file("", "-Y 29 +X 10", &data), &Limits::default()).is_err());
    }
}

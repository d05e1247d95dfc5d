//! The part of the embedded font that a figure needs, to go into the figure: then it looks the same everywhere.
//!
//! Glyphs keep their numbers, so that characters and widths stay as they are; the outlines of glyphs that are not used become empty.
//! Tables after the OpenType specification (`glyf`, `loca`, `head`). Knows nothing of what is written with it.

use std::collections::{BTreeMap, BTreeSet};

/// The tables that readers of TrueType outlines need, in the order of the directory.
const TABLES: [&[u8; 4]; 10] = [b"OS/2", b"cmap", b"glyf", b"head", b"hhea", b"hmtx", b"loca", b"maxp", b"name", b"post"];

/// A font file of the same font with the outlines of these glyphs alone.
///
/// `font` is a file with TrueType outlines and short offsets to them, as the embedded one is.
pub fn subset(font: &[u8], glyphs: impl IntoIterator<Item = u16>) -> Vec<u8> {
    let tables = tables(font);
    let (outlines, offsets) = (tables[b"glyf"], tables[b"loca"]);
    let used = with_parts(outlines, offsets, glyphs);
    let (mut kept, mut kept_offsets) = (Vec::new(), Vec::new());
    for glyph in 0..(offsets.len() / 2 - 1) as u16 {
        kept_offsets.extend(half(kept.len()));
        if used.contains(&glyph) {
            kept.extend_from_slice(outline(outlines, offsets, glyph));
            kept.resize(kept.len().next_multiple_of(4), 0);
        }
    }
    kept_offsets.extend(half(kept.len()));

    let own = |tag: &[u8; 4]| match tag {
        b"glyf" => kept.clone(),
        b"loca" => kept_offsets.clone(),
        _ => tables[tag].to_vec(),
    };
    file(TABLES.iter().filter(|tag| tables.contains_key(**tag)).map(|tag| (**tag, own(tag))).collect())
}

/// An offset as short offsets are stored: halved.
fn half(offset: usize) -> [u8; 2] {
    ((offset / 2) as u16).to_be_bytes()
}

fn number16(bytes: &[u8], at: usize) -> usize {
    usize::from(u16::from_be_bytes([bytes[at], bytes[at + 1]]))
}

fn number32(bytes: &[u8], at: usize) -> usize {
    number16(bytes, at) << 16 | number16(bytes, at + 2)
}

/// The tables of a font file by their tags.
fn tables(font: &[u8]) -> BTreeMap<[u8; 4], &[u8]> {
    let entries = (0..number16(font, 4)).map(|index| &font[12 + 16 * index..28 + 16 * index]);
    entries.map(|entry| ([entry[0], entry[1], entry[2], entry[3]], &font[number32(entry, 8)..][..number32(entry, 12)])).collect()
}

/// The outline of a glyph; empty for a space.
fn outline<'f>(outlines: &'f [u8], offsets: &[u8], glyph: u16) -> &'f [u8] {
    let at = 2 * usize::from(glyph);
    &outlines[2 * number16(offsets, at)..2 * number16(offsets, at + 2)]
}

/// The glyphs, the box that stands for lacking ones, and all of which they are composed.
fn with_parts(outlines: &[u8], offsets: &[u8], glyphs: impl IntoIterator<Item = u16>) -> BTreeSet<u16> {
    let mut waiting: Vec<u16> = glyphs.into_iter().chain([0]).collect();
    let mut used = BTreeSet::new();
    while let Some(glyph) = waiting.pop() {
        if used.insert(glyph) {
            waiting.extend(parts(outline(outlines, offsets, glyph)));
        }
    }
    used
}

/// The glyphs of which an outline is composed; none for one that has contours of its own.
fn parts(outline: &[u8]) -> Vec<u16> {
    const WORDS: usize = 1;
    const ONE_SCALE: usize = 8;
    const MORE: usize = 0x20;
    const TWO_SCALES: usize = 0x40;
    const MATRIX: usize = 0x80;
    let mut parts = Vec::new();
    let is_composite = outline.first().is_some_and(|count| *count >= 0x80);
    let mut next = is_composite.then_some(10);
    while let Some(at) = next {
        let flags = number16(outline, at);
        parts.push(number16(outline, at + 2) as u16);
        let place = if flags & WORDS != 0 { 8 } else { 6 };
        let scale: usize =
            [(ONE_SCALE, 2), (TWO_SCALES, 4), (MATRIX, 8)].iter().filter(|(flag, _)| flags & flag != 0).map(|(_, size)| size).sum();
        next = (flags & MORE != 0).then_some(at + place + scale);
    }
    parts
}

/// A font file of these tables, in the order of their tags.
fn file(mut tables: Vec<([u8; 4], Vec<u8>)>) -> Vec<u8> {
    const ADJUSTMENT: usize = 8;
    let mut head_at = 0;
    let count = tables.len() as u16;
    let rounding = count.ilog2();
    let mut file = vec![0, 1, 0, 0];
    file.extend([count, 16 << rounding, rounding as u16, 16 * count - (16 << rounding)].iter().flat_map(|number| number.to_be_bytes()));
    let mut at = 12 + 16 * tables.len();
    for (tag, table) in &mut tables {
        if tag == b"head" {
            table[ADJUSTMENT..ADJUSTMENT + 4].fill(0);
            head_at = at;
        }
        file.extend_from_slice(tag);
        file.extend([checksum(table), at as u32, table.len() as u32].iter().flat_map(|number| number.to_be_bytes()));
        at += table.len().next_multiple_of(4);
    }
    for (_, table) in tables {
        file.extend(table);
        file.resize(file.len().next_multiple_of(4), 0);
    }
    let adjustment = 0xb1b0_afba_u32.wrapping_sub(checksum(&file));
    file[head_at + ADJUSTMENT..head_at + ADJUSTMENT + 4].copy_from_slice(&adjustment.to_be_bytes());
    file
}

/// The sum of the numbers of four bytes, the last filled up by zeros.
fn checksum(table: &[u8]) -> u32 {
    let number = |bytes: &[u8]| bytes.iter().enumerate().map(|(index, byte)| u32::from(*byte) << (24 - 8 * index)).sum::<u32>();
    table.chunks(4).fold(0, |sum, bytes| sum.wrapping_add(number(bytes)))
}

/// Bytes in the letters of base 64 (RFC 4648).
pub fn base64(bytes: &[u8]) -> String {
    const LETTERS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for group in bytes.chunks(3) {
        let number = group.iter().enumerate().map(|(index, byte)| usize::from(*byte) << (16 - 8 * index)).sum::<usize>();
        for index in 0..4 {
            let letter = LETTERS[number >> (18 - 6 * index) & 63];
            text.push(if index <= group.len() { char::from(letter) } else { '=' });
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use ttf_parser::{Face, GlyphId};

    use super::*;
    use crate::figure::text::{FONT, face, glyphs};

    #[derive(Default, PartialEq, Debug)]
    struct Drawn(Vec<[f32; 7]>);

    impl ttf_parser::OutlineBuilder for Drawn {
        fn move_to(&mut self, x: f32, y: f32) {
            self.0.push([0.0, x, y, 0.0, 0.0, 0.0, 0.0]);
        }

        fn line_to(&mut self, x: f32, y: f32) {
            self.0.push([1.0, x, y, 0.0, 0.0, 0.0, 0.0]);
        }

        fn quad_to(&mut self, x1: f32, y1: f32, x: f32, y: f32) {
            self.0.push([2.0, x1, y1, x, y, 0.0, 0.0]);
        }

        fn curve_to(&mut self, x1: f32, y1: f32, x2: f32, y2: f32, x: f32, y: f32) {
            self.0.push([3.0, x1, y1, x2, y2, x, y]);
        }

        fn close(&mut self) {}
    }

    fn drawn(face: &Face<'_>, glyph: GlyphId) -> Drawn {
        let mut outline = Drawn::default();
        face.outline_glyph(glyph, &mut outline);
        outline
    }

    #[test]
    fn another_reader_finds_the_same_outlines_widths_and_characters() {
        let text = "Äpfel, μm⁻¹ × 10²";
        let part = subset(FONT, glyphs(text).map(|(_, glyph)| glyph.0));
        let subset = Face::parse(&part, 0).unwrap();
        assert!(part.len() < FONT.len() / 2, "{}", part.len());
        for (character, glyph) in glyphs(text) {
            assert_eq!(subset.glyph_index(character), Some(glyph), "{character}");
            assert_eq!(subset.glyph_hor_advance(glyph), face().glyph_hor_advance(glyph));
            assert_eq!(drawn(&subset, glyph), drawn(face(), glyph), "{character}");
        }
        let unused = face().glyph_index('Q').unwrap();
        assert_eq!(drawn(&subset, unused), Drawn::default());
    }

    #[test]
    fn all_sums_are_right() {
        let part = subset(FONT, [40]);
        assert_eq!(checksum(&part), 0xb1b0_afba);
        for index in (0..number16(&part, 4)).filter(|index| &part[12 + 16 * index..16 + 16 * index] != b"head") {
            let entry = &part[12 + 16 * index..];
            assert_eq!(checksum(&part[number32(entry, 8)..][..number32(entry, 12)]) as usize, number32(entry, 4));
        }
    }

    #[test]
    fn letters_of_base_64_are_those_of_the_standard() {
        // RFC 4648, section 10.
        for (bytes, text) in [("", ""), ("f", "Zg=="), ("fo", "Zm8="), ("foo", "Zm9v"), ("foob", "Zm9vYg=="), ("foobar", "Zm9vYmFy")] {
            assert_eq!(base64(bytes.as_bytes()), text);
        }
    }
}

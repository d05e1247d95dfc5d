//! The one embedded font: measures and outlines, the same on every machine.
//!
//! DejaVu Sans, reduced to Latin, Greek, Cyrillic and mathematical signs (`font/LICENSE`). Verdana, its
//! relative, has nearly its widths, which is why it follows in the families that an SVG names.

use std::sync::OnceLock;

use ttf_parser::{Face, GlyphId, OutlineBuilder};

/// The font file.
pub const FONT: &[u8] = include_bytes!("font/dejavu-sans-subset.ttf");

/// What an SVG asks its viewer for, the embedded font's own name first.
pub const FAMILIES: &str = "DejaVu Sans, Bitstream Vera Sans, Verdana, Arial, sans-serif";

/// Height of a capital letter as a fraction of the font's size.
pub const CAPITAL_HEIGHT: f64 = 0.729;

/// How far letters such as `g` reach below the baseline, as a fraction of the font's size.
pub const DESCENT: f64 = 0.236;

/// The parsed font.
pub fn face() -> &'static Face<'static> {
    static FACE: OnceLock<Face<'static>> = OnceLock::new();
    FACE.get_or_init(|| Face::parse(FONT, 0).expect("the embedded font is whole"))
}

/// The glyph of each character; those the font lacks give its empty box.
pub fn glyphs(text: &str) -> impl Iterator<Item = (char, GlyphId)> + '_ {
    text.chars().map(|character| (character, face().glyph_index(character).unwrap_or(GlyphId(0))))
}

/// Advance width of a glyph as a fraction of the font's size.
pub fn advance(glyph: GlyphId) -> f64 {
    f64::from(face().glyph_hor_advance(glyph).unwrap_or(0)) / f64::from(face().units_per_em())
}

/// Width of a line of text at that size, in the unit of the size.
pub fn width(text: &str, size: f64) -> f64 {
    glyphs(text).map(|(_, glyph)| advance(glyph)).sum::<f64>() * size
}

/// Splits `text` at spaces, then after hyphens, into lines no wider than `limit`; what is wider still is split by letters.
pub fn wrapped(text: &str, size: f64, limit: f64) -> Vec<String> {
    let mut lines = vec![String::new()];
    for word in text.split_ascii_whitespace() {
        let line = lines.last_mut().expect("there is always a line");
        let joined = if line.is_empty() { word.to_owned() } else { format!("{line} {word}") };
        if width(&joined, size) <= limit {
            *line = joined;
        } else {
            lines.extend(broken(word, size, limit));
        }
    }
    lines.retain(|line| !line.is_empty());
    lines
}

/// A word cut after hyphens where it is too wide for a line of its own.
fn broken(word: &str, size: f64, limit: f64) -> Vec<String> {
    if width(word, size) <= limit {
        return vec![word.to_owned()];
    }
    let mut lines = vec![String::new()];
    for part in word.split_inclusive('-') {
        let line = lines.last_mut().expect("there is always a line");
        let joined = format!("{line}{part}");
        if width(&joined, size) <= limit {
            *line = joined;
        } else {
            lines.extend(pieces(part, size, limit));
        }
    }
    lines
}

/// A word cut so that each piece fits; one piece where it fits whole.
fn pieces(word: &str, size: f64, limit: f64) -> Vec<String> {
    let mut pieces = vec![String::new()];
    for character in word.chars() {
        let piece = pieces.last_mut().expect("there is always a piece");
        let longer = format!("{piece}{character}");
        if piece.is_empty() || width(&longer, size) <= limit {
            *piece = longer;
        } else {
            pieces.push(character.to_string());
        }
    }
    pieces
}

/// The contours of a line of text at size 1 with its baseline start at the origin, y downwards.
pub fn contours(text: &str) -> Vec<Vec<[f64; 2]>> {
    let mut outline = Contours { scale: 1.0 / f64::from(face().units_per_em()), pen: 0.0, last: [0.0; 2], contours: Vec::new() };
    for (_, glyph) in glyphs(text) {
        face().outline_glyph(glyph, &mut outline);
        outline.pen += advance(glyph);
    }
    outline.contours
}

/// Straight pieces into which a curve of an outline is cut: an error under a thousandth of the size.
const CURVE_PIECES: u32 = 6;

struct Contours {
    scale: f64,
    pen: f64,
    last: [f64; 2],
    contours: Vec<Vec<[f64; 2]>>,
}

impl Contours {
    fn point(&self, x: f32, y: f32) -> [f64; 2] {
        [self.pen + f64::from(x) * self.scale, -f64::from(y) * self.scale]
    }

    fn push(&mut self, point: [f64; 2]) {
        self.contours.last_mut().expect("an outline begins by a move").push(point);
        self.last = point;
    }
}

impl OutlineBuilder for Contours {
    fn move_to(&mut self, x: f32, y: f32) {
        self.contours.push(Vec::new());
        self.push(self.point(x, y));
    }

    fn line_to(&mut self, x: f32, y: f32) {
        self.push(self.point(x, y));
    }

    fn quad_to(&mut self, x1: f32, y1: f32, x: f32, y: f32) {
        let (a, b, c) = (self.last, self.point(x1, y1), self.point(x, y));
        for piece in 1..=CURVE_PIECES {
            let t = f64::from(piece) / f64::from(CURVE_PIECES);
            let s = 1.0 - t;
            self.push([0, 1].map(|k| s * s * a[k] + 2.0 * s * t * b[k] + t * t * c[k]));
        }
    }

    fn curve_to(&mut self, x1: f32, y1: f32, x2: f32, y2: f32, x: f32, y: f32) {
        let (a, b, c, d) = (self.last, self.point(x1, y1), self.point(x2, y2), self.point(x, y));
        for piece in 1..=CURVE_PIECES {
            let t = f64::from(piece) / f64::from(CURVE_PIECES);
            let s = 1.0 - t;
            self.push([0, 1].map(|k| s * s * s * a[k] + 3.0 * s * s * t * b[k] + 3.0 * s * t * t * c[k] + t * t * t * d[k]));
        }
    }

    fn close(&mut self) {}
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_sign_that_figures_write_is_in_the_font() {
        for character in "−±×·°²³⁻⁰¹⁴⁵⁶⁷⁸⁹≤≥≈∝√∞θφωπηαß–—…".chars() {
            assert!(face().glyph_index(character).is_some(), "{character}");
        }
    }

    #[test]
    fn lines_are_wrapped_within_the_limit_and_lose_no_letter() {
        let text = "rows-then-columns importance sampling of averyveryverylongword";
        let lines = wrapped(text, 10.0, 80.0);
        assert!(lines.iter().all(|line| width(line, 10.0) <= 80.0), "{lines:?}");
        assert_eq!(lines.concat().replace(' ', ""), text.replace(' ', ""));
    }

    #[test]
    fn digits_have_one_width_so_that_columns_of_numbers_align() {
        assert!("123456789".chars().all(|digit| width(&digit.to_string(), 1.0) == width("0", 1.0)));
    }

    #[test]
    fn a_capital_is_as_high_as_stated() {
        let top = contours("H").concat().iter().map(|point| point[1]).fold(0.0, f64::min);
        assert!((top + CAPITAL_HEIGHT).abs() < 1e-3, "{top}");
    }
}

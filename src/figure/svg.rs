//! A canvas as SVG, by the SVG backend of plotters.
//!
//! The backend counts in whole units, so the drawing is written in twentieths of a point and the outer
//! element, which is ours, says how large that is. Text stays text; the letters that it needs are inside, and for readers that do
//! not look there the families are named that most machines have.

use std::collections::BTreeSet;

use plotters::prelude::{Color, DrawingBackend, FontTransform, IntoFont, RGBAColor, SVGBackend, ShapeStyle, TextStyle};
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::canvas::{Anchor, Canvas, Ink, Label, Mark};
use super::subset::{base64, subset};
use super::text;

/// Units of the drawing in a point.
const UNITS: f64 = 20.0;

/// The canvas as an SVG document; `metadata` are names and texts of where it comes from.
pub fn encode(canvas: &Canvas, title: &str, metadata: &[(&str, &str)]) -> Vec<u8> {
    let mut body = String::new();
    let mut backend = SVGBackend::with_string(&mut body, (units(canvas.width) as u32, units(canvas.height) as u32));
    for mark in &canvas.marks {
        draw(&mut backend, mark);
    }
    backend.present().expect("writing to a string cannot fail");
    drop(backend);
    let marks = body.split_once('\n').map_or("", |(_, marks)| marks);
    format!("{}{}</g>\n{}", head(canvas, title, metadata), marks.trim_end().trim_end_matches("</svg>"), "</svg>\n").into_bytes()
}

/// The outer element with size, title, origin and what all marks share.
fn head(canvas: &Canvas, title: &str, metadata: &[(&str, &str)]) -> String {
    let mut head = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{}pt\" height=\"{}pt\" viewBox=\"0 0 {} {}\" role=\"img\">\n",
        rounded(canvas.width),
        rounded(canvas.height),
        units(canvas.width),
        units(canvas.height)
    );
    if !title.is_empty() {
        head += &format!("<title>{}</title>\n", escaped(title));
    }
    if !metadata.is_empty() {
        head += "<metadata>\n<origin xmlns=\"urn:pipeline:origin\">\n";
        for (name, value) in metadata {
            head += &format!("<{name}>{}</{name}>\n", escaped(value));
        }
        head += "</origin>\n</metadata>\n";
    }
    head + &font_face(canvas) + "<g stroke-linejoin=\"round\" stroke-linecap=\"butt\">\n"
}

/// The letters of the canvas, under the name that comes first in [`text::FAMILIES`].
fn font_face(canvas: &Canvas) -> String {
    let labels = canvas.marks.iter().filter_map(|mark| if let Mark::Text(label) = mark { Some(label) } else { None });
    let glyphs: BTreeSet<u16> = labels.flat_map(|label| text::glyphs(&label.text)).map(|(_, glyph)| glyph.0).collect();
    if glyphs.is_empty() {
        return String::new();
    }
    let font = base64(&subset(text::FONT, glyphs));
    format!("<style>@font-face {{ font-family: 'DejaVu Sans'; src: url(data:font/ttf;base64,{font}) }}</style>\n")
}

fn draw(backend: &mut SVGBackend<'_>, mark: &Mark) {
    let drawn = match mark {
        Mark::Stroke { points, width, ink } => {
            let style = ShapeStyle { color: color(*ink), filled: false, stroke_width: units(*width).max(1) as u32 };
            backend.draw_path(points.iter().map(|point| place(*point)), &style)
        }
        Mark::Area { points, ink } => backend.fill_polygon(points.iter().map(|point| place(*point)), &color(*ink).filled()),
        Mark::Disk { center, radius, ink } => backend.draw_circle(place(*center), units(*radius) as u32, &color(*ink).filled(), true),
        Mark::Text(label) => return draw_text(backend, label),
    };
    drawn.expect("writing to a string cannot fail");
}

fn draw_text(backend: &mut SVGBackend<'_>, label: &Label) {
    let transform = if label.is_turned { FontTransform::Rotate270 } else { FontTransform::None };
    let horizontal = match label.anchor {
        Anchor::Start => HPos::Left,
        Anchor::Middle => HPos::Center,
        Anchor::End => HPos::Right,
    };
    let ink = color(label.ink);
    // The backend divides the size by 1.24.
    let font = (text::FAMILIES, label.size * UNITS * 1.24).into_font().transform(transform);
    let style = TextStyle::from(font).color(&ink).pos(Pos::new(horizontal, VPos::Top));
    backend.draw_text(&label.text, &style, top(label)).expect("writing to a string cannot fail");
}

/// The point from which the backend reaches the baseline: it goes 0.76 em down, before it turns.
fn top(label: &Label) -> (i32, i32) {
    let [x, y] = label.position;
    let rise = 0.76 * label.size;
    place(if label.is_turned { [x - rise, y] } else { [x, y - rise] })
}

fn place([x, y]: [f64; 2]) -> (i32, i32) {
    (units(x), units(y))
}

fn units(length: f64) -> i32 {
    (length * UNITS).round() as i32
}

fn rounded(length: f64) -> f64 {
    (length * UNITS).round() / UNITS
}

fn color(ink: Ink) -> RGBAColor {
    RGBAColor(ink.rgb[0], ink.rgb[1], ink.rgb[2], ink.opacity)
}

/// Text for the inside of an element; characters that XML 1.0 does not allow become `\u{fffd}`.
fn escaped(text: &str) -> String {
    let mut safe = String::with_capacity(text.len());
    for character in text.chars() {
        match character {
            '<' => safe += "&lt;",
            '>' => safe += "&gt;",
            '&' => safe += "&amp;",
            other => safe.push(allowed(other)),
        }
    }
    safe
}

/// The character, or the replacement character where XML 1.0 does not allow it.
pub fn allowed(character: char) -> char {
    let is_forbidden = (character < ' ' && !"\t\n\r".contains(character)) || ('\u{fffe}'..='\u{ffff}').contains(&character);
    if is_forbidden { char::REPLACEMENT_CHARACTER } else { character }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn page(text: &str) -> String {
        let mut canvas = Canvas { width: 100.0, height: 50.0, marks: Vec::new() };
        let ink = Ink::opaque([0, 0, 0]);
        canvas.stroke(vec![[0.0, 0.0], [10.0, 10.0]], 1.0, ink);
        canvas.text(Label { text: text.into(), position: [5.0, 5.0], anchor: Anchor::Start, size: 9.0, is_turned: false, ink });
        String::from_utf8(encode(&canvas, text, &[("key", text)])).unwrap()
    }

    #[test]
    fn text_from_files_stays_text() {
        let page = page("<script>alert('&')</script>\u{1}");
        assert!(!page.contains("<script>"), "{page}");
        assert_eq!(page.matches("&lt;script&gt;").count(), 3, "{page}");
    }

    #[test]
    fn the_letters_are_inside_and_no_others() {
        let font = |text: &str| page(text).split("base64,").nth(1).map_or(0, |rest| rest.split(')').next().unwrap_or_default().len());
        let (few, many) = (font("ii"), font("The quick brown fox jumps over the lazy dog"));
        assert!(0 < few && few < many && many < text::FONT.len(), "{few} {many}");
    }

    #[test]
    fn elements_are_closed_in_order() {
        let page = page("plain");
        assert!(page.starts_with("<svg xmlns=") && page.ends_with("</g>\n</svg>\n"), "{page}");
        assert_eq!(page.matches("<svg").count(), 1);
        assert_eq!(page.matches("</svg>").count(), 1);
    }
}

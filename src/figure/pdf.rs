//! A canvas as a one-page PDF with its font inside, so that text stays text on any machine.
//!
//! No dates and no random identifiers: equal canvases give equal bytes.

use std::collections::{BTreeMap, BTreeSet};

use pdf_writer::types::{CidFontType, FontFlags, LineJoinStyle, SystemInfo, UnicodeCmap};
use pdf_writer::{Content, Finish, Name, Pdf, Rect, Ref, Str, TextStr};

use super::canvas::{Anchor, Canvas, Ink, Label, Mark};
use super::subset::subset;
use super::text;

const CATALOG: Ref = Ref::new(1);
const PAGES: Ref = Ref::new(2);
const PAGE: Ref = Ref::new(3);
const CONTENT: Ref = Ref::new(4);
const INFORMATION: Ref = Ref::new(5);
const FONT: Ref = Ref::new(6);
const GLYPHS: Ref = Ref::new(7);
const DESCRIPTOR: Ref = Ref::new(8);
const FONT_FILE: Ref = Ref::new(9);
const CHARACTERS: Ref = Ref::new(10);
/// The first graphics state; one for each opacity.
const FIRST_STATE: i32 = 11;

const FONT_NAME: Name<'static> = Name(b"SUBSET+DejaVuSans");
const SYSTEM: SystemInfo<'static> = SystemInfo { registry: Str(b"Adobe"), ordering: Str(b"Identity"), supplement: 0 };

/// The canvas as a PDF document; `metadata` are names and texts of where it comes from.
pub fn encode(canvas: &Canvas, title: &str, metadata: &[(&str, &str)]) -> Vec<u8> {
    let opacities = opacities_of(canvas);
    let mut pdf = Pdf::new();
    pdf.catalog(CATALOG).pages(PAGES);
    pdf.pages(PAGES).kids([PAGE]).count(1);
    write_page(&mut pdf, canvas, &opacities);
    pdf.stream(CONTENT, &content(canvas, &opacities));
    write_information(&mut pdf, title, metadata);
    write_font(&mut pdf, &characters_of(canvas));
    for (opacity, index) in &opacities {
        let fraction = *opacity as f32 / 1000.0;
        pdf.ext_graphics(state(*index)).stroking_alpha(fraction).non_stroking_alpha(fraction);
    }
    pdf.finish()
}

/// Each opacity in thousandths, numbered.
fn opacities_of(canvas: &Canvas) -> BTreeMap<u32, usize> {
    let thousandths: BTreeSet<u32> = canvas.marks.iter().map(|mark| thousandths(ink_of(mark))).collect();
    thousandths.into_iter().enumerate().map(|(index, opacity)| (opacity, index)).collect()
}

fn thousandths(ink: Ink) -> u32 {
    (ink.opacity.clamp(0.0, 1.0) * 1000.0).round() as u32
}

fn ink_of(mark: &Mark) -> Ink {
    match mark {
        Mark::Stroke { ink, .. } | Mark::Area { ink, .. } | Mark::Disk { ink, .. } => *ink,
        Mark::Text(label) => label.ink,
    }
}

fn state(index: usize) -> Ref {
    Ref::new(FIRST_STATE + index as i32)
}

fn state_name(index: usize) -> String {
    format!("G{index}")
}

fn characters_of(canvas: &Canvas) -> BTreeMap<u16, char> {
    let labels = canvas.marks.iter().filter_map(|mark| if let Mark::Text(label) = mark { Some(label) } else { None });
    labels.flat_map(|label| text::glyphs(&label.text)).map(|(character, glyph)| (glyph.0, character)).collect()
}

fn write_page(pdf: &mut Pdf, canvas: &Canvas, opacities: &BTreeMap<u32, usize>) {
    let mut page = pdf.page(PAGE);
    page.media_box(Rect::new(0.0, 0.0, canvas.width as f32, canvas.height as f32)).parent(PAGES).contents(CONTENT);
    let mut resources = page.resources();
    resources.fonts().pair(Name(b"F"), FONT);
    let mut states = resources.ext_g_states();
    for index in opacities.values() {
        states.pair(Name(state_name(*index).as_bytes()), state(*index));
    }
}

fn write_information(pdf: &mut Pdf, title: &str, metadata: &[(&str, &str)]) {
    let mut information = pdf.document_info(INFORMATION);
    if !title.is_empty() {
        information.title(TextStr(title));
    }
    for (name, value) in metadata {
        information.insert(Name(name.as_bytes())).primitive(TextStr(value));
    }
}

fn write_font(pdf: &mut Pdf, characters: &BTreeMap<u16, char>) {
    pdf.type0_font(FONT).base_font(FONT_NAME).encoding_predefined(Name(b"Identity-H")).descendant_font(GLYPHS).to_unicode(CHARACTERS);
    let mut glyphs = pdf.cid_font(GLYPHS);
    glyphs.subtype(CidFontType::Type2).base_font(FONT_NAME).system_info(SYSTEM).font_descriptor(DESCRIPTOR);
    glyphs.default_width(0.0).cid_to_gid_map_predefined(Name(b"Identity"));
    let mut widths = glyphs.widths();
    for glyph in characters.keys() {
        widths.same(*glyph, *glyph, (text::advance(ttf_parser::GlyphId(*glyph)) * 1000.0) as f32);
    }
    widths.finish();
    glyphs.finish();

    let face = text::face();
    let thousandth = |units: i16| f32::from(units) * 1000.0 / f32::from(face.units_per_em());
    let bounds = face.global_bounding_box();
    let mut descriptor = pdf.font_descriptor(DESCRIPTOR);
    descriptor.name(FONT_NAME).flags(FontFlags::NON_SYMBOLIC).italic_angle(0.0).stem_v(80.0).font_file2(FONT_FILE);
    descriptor.bbox(Rect::new(thousandth(bounds.x_min), thousandth(bounds.y_min), thousandth(bounds.x_max), thousandth(bounds.y_max)));
    descriptor.ascent(thousandth(face.ascender())).descent(thousandth(face.descender()));
    descriptor.cap_height((text::CAPITAL_HEIGHT * 1000.0) as f32);
    descriptor.finish();

    let file = subset(text::FONT, characters.keys().copied());
    pdf.stream(FONT_FILE, &file).pair(Name(b"Length1"), file.len() as i32);
    let mut map = UnicodeCmap::new(Name(b"Characters"), SYSTEM);
    for (glyph, character) in characters {
        map.pair(*glyph, *character);
    }
    pdf.stream(CHARACTERS, &map.finish());
}

fn content(canvas: &Canvas, opacities: &BTreeMap<u32, usize>) -> Vec<u8> {
    let mut content = Content::new();
    // The canvas counts downwards from the top.
    content.transform([1.0, 0.0, 0.0, -1.0, 0.0, canvas.height as f32]);
    content.set_line_join(LineJoinStyle::RoundJoin);
    let mut opacity = None;
    for mark in &canvas.marks {
        let wanted = thousandths(ink_of(mark));
        if opacity.replace(wanted) != Some(wanted) {
            content.set_parameters(Name(state_name(opacities[&wanted]).as_bytes()));
        }
        draw(&mut content, mark);
    }
    content.finish().into_vec()
}

fn draw(content: &mut Content, mark: &Mark) {
    let [r, g, b] = ink_of(mark).rgb.map(|channel| f32::from(channel) / 255.0);
    match mark {
        Mark::Stroke { points, width, .. } => {
            content.set_stroke_rgb(r, g, b).set_line_width(hundredth(*width));
            trace(content, points);
            content.stroke();
        }
        Mark::Area { points, .. } => {
            content.set_fill_rgb(r, g, b);
            trace(content, points);
            content.close_path().fill_nonzero();
        }
        Mark::Disk { center, radius, .. } => {
            content.set_fill_rgb(r, g, b);
            trace_circle(content, *center, *radius);
            content.fill_nonzero();
        }
        Mark::Text(label) => {
            content.set_fill_rgb(r, g, b);
            write_text(content, label);
        }
    }
}

fn trace(content: &mut Content, points: &[[f64; 2]]) {
    for (index, point) in points.iter().enumerate() {
        let [x, y] = point.map(hundredth);
        if index == 0 {
            content.move_to(x, y)
        } else {
            content.line_to(x, y)
        };
    }
}

/// Four cubic arcs; off the circle by at most 0.03 % of its radius.
fn trace_circle(content: &mut Content, [x, y]: [f64; 2], radius: f64) {
    let handle = radius * 0.552_284_75;
    let at = |dx: f64, dy: f64| [hundredth(x + dx), hundredth(y + dy)];
    let [start_x, start_y] = at(radius, 0.0);
    content.move_to(start_x, start_y);
    for (cos, sin) in [(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)] {
        let a = at(radius * cos - handle * sin, radius * sin + handle * cos);
        let b = at(-radius * sin + handle * cos, radius * cos + handle * sin);
        let end = at(-radius * sin, radius * cos);
        content.cubic_to(a[0], a[1], b[0], b[1], end[0], end[1]);
    }
}

fn write_text(content: &mut Content, label: &Label) {
    let codes: Vec<u8> = text::glyphs(&label.text).flat_map(|(_, glyph)| glyph.0.to_be_bytes()).collect();
    let shift = match label.anchor {
        Anchor::Start => 0.0,
        Anchor::Middle => -text::width(&label.text, label.size) / 2.0,
        Anchor::End => -text::width(&label.text, label.size),
    };
    let [x, y] = label.position;
    let matrix = if label.is_turned {
        [0.0, -1.0, -1.0, 0.0, hundredth(x), hundredth(y - shift)]
    } else {
        [1.0, 0.0, 0.0, -1.0, hundredth(x + shift), hundredth(y)]
    };
    content.begin_text().set_font(Name(b"F"), hundredth(label.size)).set_text_matrix(matrix).show(Str(&codes)).end_text();
}

/// A length to a hundredth of a point, so that files stay small.
fn hundredth(length: f64) -> f32 {
    ((length * 100.0).round() / 100.0) as f32
}

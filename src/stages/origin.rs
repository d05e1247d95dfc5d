//! What a published file says of where it comes from: PNG text, EXR attributes, SVG and PDF metadata.

use crate::engine::artifact::Origin;
use crate::formats;

/// Longest part of an SVG or PDF file in which its metadata are looked for, from either end, in bytes.
const SEARCHED: usize = 1 << 20;

/// What a file says of its origin; `None` if it says nothing, or its key is no key.
pub fn origin_in(bytes: &[u8]) -> Option<Origin> {
    let entries = match bytes {
        [b'%', b'P', b'D', b'F', ..] => in_pdf(bytes),
        _ if is_svg(bytes) => in_svg(bytes),
        _ => formats::origin(bytes),
    };
    let text = |name: &str| entries.iter().find(|(own, _)| own == name).map(|(_, text)| text.clone()).unwrap_or_default();
    let origin = Origin { pipeline: text("pipeline"), stage: text("stage"), coordinate: text("coordinate"), key: text("key") };
    let is_key = origin.key.len() == 64 && origin.key.bytes().all(|byte| byte.is_ascii_hexdigit());
    is_key.then_some(origin)
}

fn is_svg(bytes: &[u8]) -> bool {
    let head = &bytes[..bytes.len().min(1024)];
    head.windows(4).any(|window| window == b"<svg")
}

fn in_svg(bytes: &[u8]) -> Vec<(String, String)> {
    let text = String::from_utf8_lossy(&bytes[..bytes.len().min(SEARCHED)]);
    let inner = || text.split_once("<origin xmlns=\"urn:pipeline:origin\">")?.1.split_once("</origin>").map(|(inner, _)| inner);
    let Some(inner) = inner() else { return Vec::new() };
    let entry = |name: &str| {
        let (_, rest) = inner.split_once(&format!("<{name}>"))?;
        let (text, _) = rest.split_once(&format!("</{name}>"))?;
        Some((name.to_owned(), unescaped(text)))
    };
    names().into_iter().filter_map(entry).collect()
}

fn names() -> [&'static str; 4] {
    Origin::default().entries().map(|(name, _)| name)
}

fn unescaped(text: &str) -> String {
    text.replace("&lt;", "<")
        .replace("&gt;", ">")
        .replace("&quot;", "\"")
        .replace("&apos;", "'")
        .replace("&#39;", "'")
        .replace("&amp;", "&")
}

/// The information dictionary stands uncompressed: `/pipeline (text)` or `/pipeline <feff…>`.
fn in_pdf(bytes: &[u8]) -> Vec<(String, String)> {
    let head = &bytes[..bytes.len().min(SEARCHED)];
    let tail = &bytes[bytes.len() - bytes.len().min(SEARCHED)..];
    let find = |name: &str| {
        let needle = format!("/{name} ");
        let value = |part: &[u8]| {
            let start = part.windows(needle.len()).position(|window| window == needle.as_bytes())? + needle.len();
            pdf_text(&part[start..])
        };
        Some((name.to_owned(), value(head).or_else(|| value(tail))?))
    };
    names().into_iter().filter_map(find).collect()
}

fn pdf_text(bytes: &[u8]) -> Option<String> {
    match bytes.split_first()? {
        (b'(', rest) => {
            let mut text = Vec::new();
            let mut rest = rest.iter();
            loop {
                match rest.next()? {
                    b')' => return String::from_utf8(text).ok(),
                    b'\\' => text.push(*rest.next()?),
                    byte => text.push(*byte),
                }
            }
        }
        (b'<', rest) => {
            let digits = &rest[..rest.iter().position(|byte| *byte == b'>')?];
            let hex = std::str::from_utf8(digits).ok()?;
            let units: Vec<u16> =
                (0..hex.len() / 4).map(|unit| u16::from_str_radix(hex.get(4 * unit..4 * unit + 4)?, 16).ok()).collect::<Option<_>>()?;
            String::from_utf16(units.strip_prefix(&[0xfeff])?).ok()
        }
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::artifact::Artifact;
    use crate::figure::chart::{Axis, Chart, Scale};
    use crate::image::raster::{Image, Raster};

    fn origin() -> Origin {
        Origin {
            pipeline: "a-b".into(),
            stage: "curve".into(),
            coordinate: "look=<é&\">,n=(6)\\".into(),
            key: "0123456789abcdef".repeat(4),
        }
    }

    fn chart() -> Chart {
        let axis = || Axis { label: "x".into(), unit: String::new(), scale: Scale::Linear, range: None, categories: Vec::new() };
        Chart { title: "t".into(), size_mm: [80.0, 60.0], x: axis(), y: axis(), curves: vec![], guides: vec![], heat: None, notes: vec![] }
    }

    #[test]
    fn every_kind_of_file_that_carries_its_origin_gives_it_back() {
        for format in Chart::FORMATS {
            let bytes = chart().save(format, &origin()).unwrap().bytes;
            assert_eq!(origin_in(&bytes), Some(origin()), "{format}");
        }
        let image = Image::opaque(Raster::filled(2, 2, [0.5; 3]));
        for format in ["exr", "png"] {
            assert_eq!(origin_in(&image.save(format, &origin()).unwrap().bytes), Some(origin()), "{format}");
        }
        for format in ["hdr", "pfm", "npy"] {
            assert_eq!(origin_in(&image.save(format, &origin()).unwrap().bytes), None, "{format}");
        }
    }

    #[test]
    fn broken_files_say_nothing_and_do_no_harm() {
        for format in Chart::FORMATS {
            let bytes = chart().save(format, &origin()).unwrap().bytes;
            for length in (0..bytes.len()).step_by(97) {
                let _ = origin_in(&bytes[..length]);
            }
        }
        for text in ["", "%PDF", "%PDF-1.7 /key <zz>", "%PDF /key (abc", "<svg><origin xmlns=\"urn:pipeline:origin\"><key>", "/key ("] {
            assert_eq!(origin_in(text.as_bytes()), None, "{text}");
        }
    }
}

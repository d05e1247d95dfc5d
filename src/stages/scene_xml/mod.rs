//! Scenes of Mitsuba 3 and Nori in the place of a scene of ours: XML → the tree that the same scene in YAML would be.
//!
//! So whatever follows is one way for all: a schema that checks, mistakes with the line of the XML, files that are inputs,
//! and a key that depends on what is said and not on how. What both programs do not have alike is refused with its line.
//! A root with a `version` is Mitsuba's, one without is Nori's.
//!
//! Reading order: `element`, `fields`, `mitsuba`, `nori`.

mod element;
mod fields;
mod mitsuba;
mod nori;

use roxmltree::{Document, ParsingOptions};

use crate::engine::source::{Finding, Findings, Place};
use crate::engine::yaml::Node;
use crate::stages::scene_xml::element::Xml;

/// Most elements, attributes and texts of a file.
const NODE_LIMIT: u32 = 1 << 20;

/// Reads a scene; `None` where it cannot be one of ours, of which at least one finding tells.
pub fn read(file: u32, text: &str, findings: &mut Findings) -> Option<Node> {
    let options = ParsingOptions { allow_dtd: false, nodes_limit: NODE_LIMIT, ..ParsingOptions::default() };
    let document = match Document::parse_with_options(text, options) {
        Ok(document) => document,
        Err(error) => {
            let at = error.pos();
            let place = Place { file, line: at.row, column: at.col, length: 1 };
            findings.add(Finding::error(place, format!("not well-formed XML: {error}")));
            return None;
        }
    };
    let xml = Xml::new(file, text);
    let root = xml.element(document.root_element());
    let scene = match root.tag() {
        "scene" if root.has("version") => mitsuba::scene(root),
        "scene" => nori::scene(root),
        tag => {
            root.refuse(&format!("the root is `<{tag}>`, and a scene of Mitsuba or Nori begins with `<scene>`"), None);
            None
        }
    };
    let wrong = xml.findings();
    let is_right = wrong.is_empty();
    findings.extend(wrong);
    scene.filter(|_| is_right)
}

#[cfg(test)]
mod tests;

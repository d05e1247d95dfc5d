//! Elements of XML that know where they stand, and the values that their attributes hold.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::Arc;

use roxmltree::Node as XmlNode;
use serde_json::Value as Json;

use crate::catalogue::nearest;
use crate::engine::source::{Finding, Place};
use crate::engine::yaml::{Entry, Node, Value};

/// A file while it is read.
pub struct Xml<'a> {
    file: u32,
    text: &'a str,
    /// Bytes at which lines begin.
    lines: Vec<usize>,
    findings: RefCell<Vec<Finding>>,
    /// Values of `$names`.
    defaults: RefCell<BTreeMap<String, String>>,
}

impl<'a> Xml<'a> {
    /// A file of that index.
    pub fn new(file: u32, text: &'a str) -> Self {
        let lines = std::iter::once(0).chain(text.match_indices('\n').map(|(place, _)| place + 1)).collect();
        Self { file, text, lines, findings: RefCell::default(), defaults: RefCell::default() }
    }

    /// An element of it.
    pub fn element<'x>(&'x self, node: XmlNode<'x, 'x>) -> Element<'x> {
        Element { xml: self, node }
    }

    /// What was found wrong.
    pub fn findings(&self) -> Vec<Finding> {
        self.findings.take()
    }

    /// Sets the value of a `$name`, unless it has one.
    pub fn set_default(&self, name: &str, value: &str) {
        self.defaults.borrow_mut().entry(name.to_owned()).or_insert_with(|| value.to_owned());
    }

    fn place(&self, range: Range<usize>) -> Place {
        let line = self.lines.partition_point(|start| *start <= range.start) - 1;
        let count = |range: Range<usize>| self.text.get(range).map_or(0, |part| part.chars().count()) as u32;
        let end = range.end.min(self.text[range.start..].find('\n').map_or(self.text.len(), |length| range.start + length));
        let column = count(self.lines[line]..range.start) + 1;
        Place { file: self.file, line: line as u32 + 1, column, length: count(range.start..end).max(1) }
    }
}

/// An element of a file.
#[derive(Clone, Copy)]
pub struct Element<'a> {
    xml: &'a Xml<'a>,
    node: XmlNode<'a, 'a>,
}

impl<'a> Element<'a> {
    /// What kind of value or part it is.
    pub fn tag(&self) -> &'a str {
        self.node.tag_name().name()
    }

    /// The file it is from.
    pub fn xml(&self) -> &'a Xml<'a> {
        self.xml
    }

    /// The elements in it.
    pub fn children(&self) -> impl Iterator<Item = Self> + use<'a> {
        let xml = self.xml;
        self.node.children().filter(XmlNode::is_element).map(move |node| Element { xml, node })
    }

    /// Whether it has an attribute.
    pub fn has(&self, attribute: &str) -> bool {
        self.node.has_attribute(attribute)
    }

    /// An attribute, with its `$names` replaced.
    pub fn attribute(&self, name: &str) -> Option<String> {
        self.replaced(self.node.attribute(name)?)
    }

    /// An attribute that must be there.
    pub fn required(&self, name: &str) -> Option<String> {
        if !self.has(name) {
            self.refuse(&format!("{} has no `{name}`", self.described()), None);
        }
        self.attribute(name)
    }

    /// The name by which its owner asks for it.
    pub fn name(&self) -> Option<&'a str> {
        self.node.attribute("name")
    }

    /// What it is of its kind: `diffuse`; empty where it does not say.
    pub fn kind(&self) -> &'a str {
        self.node.attribute("type").unwrap_or("")
    }

    /// What it is, for a message: `<bsdf type="diffuse">`.
    pub fn described(&self) -> String {
        let shown = |name: &str| self.node.attribute(name).map(|value| format!(" {name}=\"{value}\"")).unwrap_or_default();
        format!("`<{}{}{}>`", self.tag(), shown("type"), shown("name"))
    }

    /// Where it stands: the tag that opens it.
    pub fn place(&self) -> Place {
        let Range { start, end } = self.node.range();
        let length = self.xml.text[start..end].find('>').map_or(end - start, |length| length + 1);
        self.xml.place(start..start + length)
    }

    fn place_of(&self, attribute: &str) -> Place {
        self.node.attribute_node(attribute).map_or_else(|| self.place(), |attribute| self.xml.place(attribute.range()))
    }

    /// Whether a texture stands in it.
    pub fn has_texture(&self) -> bool {
        self.node.descendants().any(|node| node.is_element() && node.tag_name().name() == "texture")
    }

    /// Says what is wrong with it.
    pub fn refuse(&self, message: &str, hint: Option<String>) {
        self.xml.findings.borrow_mut().push(Finding::error(self.place(), message).with_hint(hint));
    }

    /// Says that it is of a kind that we do not have.
    pub fn refuse_kind(&self, known: &[&str]) {
        let near = nearest(self.kind(), known.iter().copied()).map(|near| format!("did you mean `{near}`?"));
        let hint = near.unwrap_or_else(|| format!("what is read: `{}`", known.join("`, `")));
        let message = format!("{} is not read", self.described());
        self.xml.findings.borrow_mut().push(Finding::error(self.place_of("type"), message).with_hint(Some(hint)));
    }

    /// The text with each `$name` replaced by its value.
    fn replaced(&self, text: &str) -> Option<String> {
        let mut parts = text.split('$');
        let mut found = parts.next()?.to_owned();
        for part in parts {
            let end = part.find(|letter: char| !letter.is_ascii_alphanumeric() && letter != '_').unwrap_or(part.len());
            let Some(value) = self.xml.defaults.borrow().get(&part[..end]).cloned() else {
                self.refuse(
                    &format!("`${}` has no value", &part[..end]),
                    Some(format!("add `<default name=\"{}\" value=\"...\"/>`", &part[..end])),
                );
                return None;
            };
            found.push_str(&value);
            found.push_str(&part[end..]);
        }
        Some(found)
    }

    /// The numbers of an attribute, apart by commas or spaces; says what is wrong with them.
    pub fn numbers(&self, attribute: &str) -> Option<Vec<f64>> {
        let text = self.required(attribute)?;
        let parts = text.split(|letter: char| letter == ',' || letter.is_whitespace()).filter(|part| !part.is_empty());
        let numbers: Option<Vec<f64>> = parts.map(|part| part.parse().ok().filter(|number: &f64| number.is_finite())).collect();
        if numbers.is_none() {
            self.refuse(&format!("`{attribute}` of {} holds something that is no number", self.described()), None);
        }
        numbers
    }

    /// The one number of an attribute.
    pub fn number(&self, attribute: &str) -> Option<f64> {
        match self.numbers(attribute)?[..] {
            [number] => Some(number),
            _ => {
                self.refuse(&format!("`{attribute}` of {} must be one number", self.described()), None);
                None
            }
        }
    }

    /// A vector: `value="x, y, z"`, or attributes x, y and z that are `usual` where they are absent.
    pub fn vector(&self, usual: f64) -> Option<[f64; 3]> {
        if !self.has("value") {
            let mut vector = [usual; 3];
            for (axis, name) in vector.iter_mut().zip(["x", "y", "z"]) {
                if self.has(name) {
                    *axis = self.number(name)?;
                }
            }
            return Some(vector);
        }
        self.triple("value")
    }

    /// Three numbers, or one for all three.
    pub fn triple(&self, attribute: &str) -> Option<[f64; 3]> {
        match self.numbers(attribute)?[..] {
            [x] => Some([x; 3]),
            [x, y, z] => Some([x, y, z]),
            _ => {
                self.refuse(&format!("`{attribute}` of {} must be three numbers", self.described()), None);
                None
            }
        }
    }

    /// Plain data at the place of this element.
    pub fn node(&self, value: Json) -> Node {
        node(value, self.place())
    }

    /// A map of fields, some of which may be absent, at the place of this element.
    pub fn map(&self, fields: impl IntoIterator<Item = (&'static str, Option<Node>)>) -> Node {
        let place = self.place();
        let entry = |(key, node): (&'static str, Option<Node>)| Some(Entry { key: key.into(), place, node: node? });
        Node::new(Value::Map(fields.into_iter().filter_map(entry).collect()), place)
    }

    /// `{ kind: { fields } }`.
    pub fn kind_map(&self, kind: &'static str, fields: impl IntoIterator<Item = (&'static str, Option<Node>)>) -> Node {
        self.map([(kind, Some(self.map(fields)))])
    }
}

/// Plain data as a tree of which every part stands at one place. A `$` in text is written so that it stays one.
fn node(value: Json, place: Place) -> Node {
    let value = match value {
        Json::Null => Value::Null,
        Json::Bool(value) => Value::Boolean(value),
        Json::Number(number) => match number.as_i64() {
            Some(integer) => Value::Integer(integer.into()),
            None => Value::Number(number.as_f64().unwrap_or(f64::NAN)),
        },
        Json::String(text) => Value::Text(text.replace('$', "$$").into()),
        Json::Array(items) => Value::List(items.into_iter().map(|item| node(item, place)).collect()),
        Json::Object(fields) => {
            let entry = |(key, value): (String, Json)| Entry { key: Arc::from(key), place, node: node(value, place) };
            Value::Map(fields.into_iter().map(entry).collect())
        }
    };
    Node::new(value, place)
}

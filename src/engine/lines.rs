//! JSON as it is written: in one line, or with its two outer levels on lines of their own and all else in one line each.
//!
//! In the second form a manifest shows its parts to a person and gives each of its many jobs a line, which can be found and read without
//! reading the others.

use std::io::{self, Write};

use serde::Serialize;
use serde_json::ser::{Formatter, Serializer};

/// Containers so deep are broken into lines.
const BROKEN_DEPTH: usize = 2;

/// The text in one line, without a line break.
pub fn line(value: &(impl Serialize + ?Sized)) -> String {
    let mut text = Vec::new();
    add_line(value, &mut text);
    String::from_utf8(text).expect("JSON is UTF-8")
}

/// Adds the text in one line to another.
pub fn add_line(value: &(impl Serialize + ?Sized), text: &mut Vec<u8>) {
    serde_json::to_writer(text, value).expect(PLAIN);
}

/// Adds a text in quotes to another.
pub fn add_text(value: &str, text: &mut Vec<u8>) {
    // Nearly all have nothing to escape, which is seen many bytes at once.
    if value.bytes().fold(false, |is_odd, byte| is_odd | (byte < b' ') | (byte == b'"') | (byte == b'\\')) {
        return add_line(value, text);
    }
    text.push(b'"');
    text.extend(value.as_bytes());
    text.push(b'"');
}

const PLAIN: &str = "plain data can be written to memory";

/// The text in lines, with a line break at its end.
pub fn text(value: &impl Serialize) -> Vec<u8> {
    let mut text = Vec::with_capacity(1 << 12);
    let written = value.serialize(&mut Serializer::with_formatter(&mut text, Lines::default()));
    written.expect(PLAIN);
    text.push(b'\n');
    text
}

#[derive(Default)]
struct Lines {
    depth: usize,
    /// Whether the container that ends had anything in it.
    has_value: bool,
}

impl Lines {
    fn is_broken(&self) -> bool {
        self.depth <= BROKEN_DEPTH
    }

    fn begin<W: ?Sized + Write>(&mut self, out: &mut W, bracket: &[u8]) -> io::Result<()> {
        self.depth += 1;
        self.has_value = false;
        out.write_all(bracket)
    }

    fn end<W: ?Sized + Write>(&mut self, out: &mut W, bracket: &[u8]) -> io::Result<()> {
        let is_broken = self.is_broken() && self.has_value;
        self.depth -= 1;
        if is_broken {
            self.new_line(out)?;
        }
        out.write_all(bracket)
    }

    fn next<W: ?Sized + Write>(&mut self, out: &mut W, is_first: bool) -> io::Result<()> {
        if !is_first {
            out.write_all(b",")?;
        }
        if self.is_broken() { self.new_line(out) } else { Ok(()) }
    }

    fn new_line<W: ?Sized + Write>(&self, out: &mut W) -> io::Result<()> {
        out.write_all(&b"\n    "[..1 + 2 * self.depth])
    }
}

impl Formatter for Lines {
    fn begin_array<W: ?Sized + Write>(&mut self, out: &mut W) -> io::Result<()> {
        self.begin(out, b"[")
    }

    fn end_array<W: ?Sized + Write>(&mut self, out: &mut W) -> io::Result<()> {
        self.end(out, b"]")
    }

    fn begin_array_value<W: ?Sized + Write>(&mut self, out: &mut W, is_first: bool) -> io::Result<()> {
        self.next(out, is_first)
    }

    fn end_array_value<W: ?Sized + Write>(&mut self, _: &mut W) -> io::Result<()> {
        self.has_value = true;
        Ok(())
    }

    fn begin_object<W: ?Sized + Write>(&mut self, out: &mut W) -> io::Result<()> {
        self.begin(out, b"{")
    }

    fn end_object<W: ?Sized + Write>(&mut self, out: &mut W) -> io::Result<()> {
        self.end(out, b"}")
    }

    fn begin_object_key<W: ?Sized + Write>(&mut self, out: &mut W, is_first: bool) -> io::Result<()> {
        self.next(out, is_first)
    }

    fn begin_object_value<W: ?Sized + Write>(&mut self, out: &mut W) -> io::Result<()> {
        out.write_all(if self.is_broken() { b": " } else { b":" })
    }

    fn end_object_value<W: ?Sized + Write>(&mut self, _: &mut W) -> io::Result<()> {
        self.has_value = true;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn a_text_is_written_as_serde_writes_it() {
        let odd = (0..=0x7f_u8).map(|byte| format!("a{}b", char::from(byte)));
        for value in odd.chain(["", "plain", "größer ✓", "\u{2028}"].map(str::to_owned)) {
            let mut text = Vec::new();
            add_text(&value, &mut text);
            assert_eq!(String::from_utf8(text).unwrap(), line(&value));
        }
    }

    #[test]
    fn each_item_of_the_second_level_has_a_line() {
        let value = json!({ "a": [{ "b": [1, { "c": 2 }] }, []], "d": {}, "e": "x\ny", "f": { "g": { "h": null } } });
        let expected = "{\n  \"a\": [\n    {\"b\":[1,{\"c\":2}]},\n    []\n  ],\n  \"d\": {},\n  \"e\": \"x\\ny\",\n  \"f\": {\n    \"g\": {\"h\":null}\n  }\n}\n";
        let found = text(&value);
        assert_eq!(String::from_utf8(found.clone()).unwrap(), expected);
        assert_eq!(serde_json::from_slice::<serde_json::Value>(&found).unwrap(), value);
        assert_eq!(serde_json::from_str::<serde_json::Value>(&line(&value)).unwrap(), value);
        assert!(!line(&value).contains('\n'));
    }
}

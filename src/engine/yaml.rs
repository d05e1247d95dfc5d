//! YAML 1.2 with positions: text → a tree of nodes that know where they stand.
//!
//! The events come from `saphyr-parser`; the core schema, merge keys, and the guards against deep, wide
//! and repeated structures are here. Knows nothing of pipelines.

use std::collections::HashMap;
use std::sync::Arc;

use saphyr_parser::{Event, Parser, ScalarStyle, ScanError, Span, StrInput, Tag};

use super::diagnostic::quoted;
use super::source::{Finding, Findings, Place};

/// Deepest nesting of lists and maps.
pub const DEPTH_LIMIT: usize = 64;
/// Most nodes that aliases may stand for, counted with repetition; long text counts as several.
const ALIAS_BUDGET: u64 = 100_000;
/// Bytes of text that count as one node.
const TEXT_PER_NODE: u64 = 64;

/// A value and where it stands.
#[derive(Debug, Clone)]
pub struct Node {
    /// The value.
    pub value: Value,
    /// Where it stands.
    pub place: Place,
    /// The `$name` through which it came here, if it did.
    pub via: Option<Arc<str>>,
}

/// A value of YAML's core schema. Cloning shares lists, maps and texts.
#[derive(Debug, Clone)]
pub enum Value {
    /// `null`, `~` or nothing at all.
    Null,
    /// `true` or `false`.
    Boolean(bool),
    /// An integer.
    Integer(i128),
    /// A number with a point or an exponent; may be infinite or not a number.
    Number(f64),
    /// Text.
    Text(Arc<str>),
    /// A list.
    List(Arc<[Node]>),
    /// A map, without merge keys or repeated keys.
    Map(Arc<[Entry]>),
}

/// One entry of a map.
#[derive(Debug, Clone)]
pub struct Entry {
    /// The key as written.
    pub key: Arc<str>,
    /// Where the key stands.
    pub place: Place,
    /// What it leads to.
    pub node: Node,
}

impl Node {
    /// A node without further ado.
    pub fn new(value: Value, place: Place) -> Self {
        Self { value, place, via: None }
    }

    /// The text, if it is text.
    pub fn text(&self) -> Option<&str> {
        match &self.value {
            Value::Text(text) => Some(text),
            _ => None,
        }
    }

    /// The entries, if it is a map.
    pub fn map(&self) -> Option<&Arc<[Entry]>> {
        match &self.value {
            Value::Map(entries) => Some(entries),
            _ => None,
        }
    }

    /// The items, if it is a list.
    pub fn list(&self) -> Option<&Arc<[Node]>> {
        match &self.value {
            Value::List(items) => Some(items),
            _ => None,
        }
    }

    /// Whether it is null.
    pub fn is_null(&self) -> bool {
        matches!(self.value, Value::Null)
    }

    /// What it is, for a message: `` text `abc` ``, `a list`.
    pub fn described(&self) -> String {
        match &self.value {
            Value::Null => "nothing (null)".to_owned(),
            Value::Boolean(value) => format!("`{value}`"),
            Value::Integer(value) => format!("`{value}`"),
            Value::Number(value) => format!("`{value:?}`"),
            Value::Text(text) => format!("text {}", quoted(text)),
            Value::List(_) => "a list".to_owned(),
            Value::Map(_) => "a map".to_owned(),
        }
    }
}

/// The value under a key.
pub fn entry<'a>(entries: &'a [Entry], key: &str) -> Option<&'a Entry> {
    entries.iter().find(|entry| &*entry.key == key)
}

/// Reads one document. `None` where it is not YAML or passes a limit; then at least one error was added.
pub fn parse(file: u32, text: &str, findings: &mut Findings) -> Option<Node> {
    let mut builder = Builder { file, findings, open: Vec::new(), anchors: HashMap::new(), spent: 0 };
    match builder.document(text) {
        Ok(node) => Some(node),
        Err(finding) => {
            findings.add(*finding);
            None
        }
    }
}

/// The value of plain text on its own, as on the command line.
pub fn plain(text: &str) -> Value {
    resolved(text)
}

/// A collection whose end has not come yet.
struct Open {
    place: Place,
    anchor: usize,
    weight: u64,
    content: OpenContent,
}

enum OpenContent {
    List(Vec<Node>),
    Map { entries: Entries, key: Option<Key>, merges: Vec<(Node, Place)> },
}

/// The entries of a map with their weights.
#[derive(Default)]
struct Entries {
    list: Vec<(Entry, u64)>,
    /// Where each key stands; empty while there are few, which are looked through.
    places: HashMap<Arc<str>, usize>,
}

/// Up to so many keys are few.
const FEW: usize = 16;

impl Entries {
    fn find(&self, key: &str) -> Option<&Entry> {
        let place = match self.places.is_empty() {
            true => self.list.iter().position(|(entry, _)| &*entry.key == key)?,
            false => *self.places.get(key)?,
        };
        Some(&self.list[place].0)
    }

    /// Adds an entry whose key is new.
    fn add(&mut self, entry: Entry, weight: u64) {
        self.list.push((entry, weight));
        if self.list.len() > FEW {
            let first_unlisted = self.places.len();
            let unlisted = self.list.iter().enumerate().skip(first_unlisted);
            self.places.extend(unlisted.map(|(place, (entry, _))| (entry.key.clone(), place)));
        }
    }
}

/// A key that waits for its value.
enum Key {
    Word(Arc<str>, Place),
    Merge(Place),
}

struct Builder<'a> {
    file: u32,
    findings: &'a mut Findings,
    open: Vec<Open>,
    /// Finished anchored nodes with their weight: nodes that they stand for.
    anchors: HashMap<usize, (Node, u64)>,
    spent: u64,
}

type Fatal = Box<Finding>;

fn fatal(place: Place, message: impl Into<String>) -> Fatal {
    Box::new(Finding::error(place, message))
}

/// The bracket that is open before a line, as far as can be told without quoted text and comments, and its line.
fn unclosed(text: &str, before: usize) -> Option<(char, usize)> {
    let mut open = Vec::new();
    for (index, line) in text.lines().enumerate().take(before.saturating_sub(1)) {
        let mut quote = None;
        let mut last = ' ';
        for letter in line.chars() {
            match (quote, letter) {
                (Some(mark), _) => quote = quote.filter(|_| letter != mark),
                (None, '"' | '\'') if !last.is_alphanumeric() => quote = Some(letter),
                (None, '#') if last == ' ' => break,
                (None, '{' | '[') => open.push((letter, index + 1)),
                (None, '}' | ']') => drop(open.pop()),
                _ => {}
            }
            last = letter;
        }
    }
    open.pop()
}

fn too_deep(place: Place) -> Fatal {
    fatal(place, format!("nested deeper than the limit of {DEPTH_LIMIT} levels"))
}

impl Builder<'_> {
    fn document(&mut self, text: &str) -> Result<Node, Fatal> {
        let mut parser = Parser::new(StrInput::new(text));
        let mut root = None;
        let mut document_count = 0;
        while let Some(event) = parser.next_event() {
            let (event, span) = event.map_err(|error| self.not_yaml(text, &error))?;
            let place = self.place(span);
            match event {
                Event::DocumentStart(_) => {
                    document_count += 1;
                    if document_count > 1 {
                        return Err(fatal(place, "a second document begins here; a pipeline file has one"));
                    }
                }
                Event::StreamEnd => break,
                Event::Nothing | Event::StreamStart | Event::DocumentEnd => {}
                event => root = self.event(event, place)?.or(root),
            }
        }
        Ok(root.unwrap_or_else(|| Node::new(Value::Null, Place::of_file(self.file))))
    }

    fn not_yaml(&self, text: &str, error: &ScanError) -> Fatal {
        let marker = error.marker();
        let place = Place { file: self.file, line: marker.line() as u32, column: marker.col() as u32 + 1, length: 1 };
        // The parser has a limit of its own, which it may meet while it looks ahead.
        if error.info().contains("recursion limit") {
            return too_deep(place);
        }
        let hint = match error.info() {
            info if info.contains("tabs") => Some("indent with spaces".to_owned()),
            info if info.contains("flow") => {
                unclosed(text, marker.line()).map(|(bracket, line)| format!("is the `{bracket}` of line {line} closed?"))
            }
            _ => None,
        };
        Box::new(Finding::error(place, format!("not YAML: {}", super::diagnostic::escape(error.info()))).with_hint(hint))
    }

    fn place(&self, span: Span) -> Place {
        let (start, end) = (span.start, span.end);
        let length = if start.line() == end.line() { end.col().saturating_sub(start.col()) } else { 1 };
        Place { file: self.file, line: start.line() as u32, column: start.col() as u32 + 1, length: length.max(1) as u32 }
    }

    /// Takes one event in; gives the root when it is finished.
    fn event(&mut self, event: Event<'_>, place: Place) -> Result<Option<Node>, Fatal> {
        match event {
            Event::Scalar(text, style, anchor, tag) => self.scalar(&text, style, anchor, tag.as_deref(), place),
            Event::Alias(anchor) => self.alias(anchor, place),
            Event::SequenceStart(anchor, tag) => {
                self.collection_tag(tag.as_deref(), "seq", place);
                self.start(OpenContent::List(Vec::new()), anchor, place)
            }
            Event::MappingStart(anchor, tag) => {
                self.collection_tag(tag.as_deref(), "map", place);
                let content = OpenContent::Map { entries: Entries::default(), key: None, merges: Vec::new() };
                self.start(content, anchor, place)
            }
            Event::SequenceEnd | Event::MappingEnd => self.end(),
            _ => Ok(None),
        }
    }

    fn start(&mut self, content: OpenContent, anchor: usize, place: Place) -> Result<Option<Node>, Fatal> {
        if self.open.len() >= DEPTH_LIMIT {
            return Err(too_deep(place));
        }
        if self.expects_key() {
            return Err(fatal(place, "a key must be a single word, not a list or a map"));
        }
        self.open.push(Open { place, anchor, weight: 1, content });
        Ok(None)
    }

    fn expects_key(&self) -> bool {
        matches!(self.open.last(), Some(Open { content: OpenContent::Map { key: None, .. }, .. }))
    }

    fn end(&mut self) -> Result<Option<Node>, Fatal> {
        let open = self.open.pop().expect("the parser closes only what it has opened");
        let (value, weight) = match open.content {
            OpenContent::List(items) => (Value::List(items.into()), open.weight),
            OpenContent::Map { entries, merges, .. } => self.merged(entries, merges),
        };
        self.finished(Node::new(value, open.place), weight, open.anchor)
    }

    /// The own entries, then those of the merged maps whose keys are not there yet.
    fn merged(&mut self, mut entries: Entries, merges: Vec<(Node, Place)>) -> (Value, u64) {
        for (source, place) in merges {
            let maps: Vec<Node> = source.list().map_or_else(|| vec![source.clone()], |items| items.to_vec());
            if maps.iter().any(|map| map.map().is_none()) {
                let message = format!("a merge `<<` takes a map or a list of maps, found {}", source.described());
                self.findings.add(Finding::error(place, message));
                continue;
            }
            for merged in maps.iter().filter_map(Node::map).flat_map(|map| map.iter()) {
                if entries.find(&merged.key).is_none() {
                    entries.add(merged.clone(), weight_of(&merged.node));
                }
            }
        }
        let weight = 1 + entries.list.iter().map(|(_, weight)| weight).sum::<u64>();
        (Value::Map(entries.list.into_iter().map(|(entry, _)| entry).collect()), weight)
    }

    fn scalar(&mut self, text: &str, style: ScalarStyle, anchor: usize, tag: Option<&Tag>, place: Place) -> Result<Option<Node>, Fatal> {
        if self.expects_key() {
            if text.is_empty() && style == ScalarStyle::Plain {
                return Err(fatal(place, "a key is missing before `:`"));
            }
            return self.key(text, style, anchor, place);
        }
        let value = match tag {
            None if style == ScalarStyle::Plain => resolved(text),
            None => Value::Text(text.into()),
            Some(tag) => self.tagged(text, tag, place),
        };
        self.finished(Node::new(value, place), 1 + text.len() as u64 / TEXT_PER_NODE, anchor)
    }

    fn key(&mut self, text: &str, style: ScalarStyle, anchor: usize, place: Place) -> Result<Option<Node>, Fatal> {
        if anchor > 0 {
            self.anchors.insert(anchor, (Node::new(Value::Text(text.into()), place), 1));
        }
        let OpenContent::Map { entries, key, merges } = &mut self.open.last_mut().expect("a key stands in a map").content else {
            unreachable!("only a map expects a key");
        };
        let is_merge = text == "<<" && style == ScalarStyle::Plain;
        let first = if is_merge { merges.first().map(|merge| merge.1) } else { entries.find(text).map(|entry| entry.place) };
        if let Some(first) = first {
            let message = format!("key {} stands twice; it stands in line {} already", quoted(text), first.line);
            self.findings.add(Finding::error(place, message));
        }
        *key = Some(if is_merge { Key::Merge(place) } else { Key::Word(text.into(), place) });
        Ok(None)
    }

    fn alias(&mut self, anchor: usize, place: Place) -> Result<Option<Node>, Fatal> {
        let Some((node, weight)) = self.anchors.get(&anchor).cloned() else {
            return Err(fatal(place, "this alias stands inside its own anchor"));
        };
        if self.expects_key() {
            let key = node.text().map(str::to_owned).ok_or_else(|| fatal(place, "a key must be a single word"))?;
            return self.key(&key, ScalarStyle::DoubleQuoted, 0, place);
        }
        self.spent = self.spent.saturating_add(weight);
        if self.spent > ALIAS_BUDGET {
            return Err(fatal(place, format!("aliases repeat more than the limit of {ALIAS_BUDGET} values")));
        }
        self.finished(node, weight, 0)
    }

    /// Puts a finished node where it belongs.
    fn finished(&mut self, node: Node, weight: u64, anchor: usize) -> Result<Option<Node>, Fatal> {
        if anchor > 0 {
            self.anchors.insert(anchor, (node.clone(), weight));
        }
        let Some(parent) = self.open.last_mut() else {
            return Ok(Some(node));
        };
        parent.weight = parent.weight.saturating_add(weight);
        match &mut parent.content {
            OpenContent::List(items) => items.push(node),
            OpenContent::Map { entries, key, merges } => match key.take() {
                Some(Key::Merge(place)) => merges.push((node, place)),
                Some(Key::Word(word, place)) if entries.find(&word).is_none() => entries.add(Entry { key: word, place, node }, weight),
                _ => {}
            },
        }
        Ok(None)
    }

    fn collection_tag(&mut self, tag: Option<&Tag>, expected: &str, place: Place) {
        if let Some(tag) = tag.filter(|tag| !(tag.is_yaml_core_schema() && tag.suffix == expected)) {
            self.findings.add(refused_tag(tag, place));
        }
    }

    fn tagged(&mut self, text: &str, tag: &Tag, place: Place) -> Value {
        let plain = resolved(text);
        let is_core = tag.is_yaml_core_schema();
        match (tag.suffix.as_str(), &plain) {
            ("str", _) if is_core => return Value::Text(text.into()),
            ("", _) if tag.handle == "!" => return Value::Text(text.into()),
            ("int", Value::Integer(_)) | ("bool", Value::Boolean(_)) | ("null", Value::Null) if is_core => return plain,
            ("float", Value::Number(_)) if is_core => return plain,
            ("float", Value::Integer(value)) if is_core => return Value::Number(*value as f64),
            ("int" | "bool" | "null" | "float", _) if is_core => {
                self.findings
                    .add(Finding::error(place, format!("{} is not of the type that its tag `!!{}` names", quoted(text), tag.suffix)));
            }
            _ => self.findings.add(refused_tag(tag, place)),
        }
        plain
    }
}

fn refused_tag(tag: &Tag, place: Place) -> Finding {
    let written = if tag.is_yaml_core_schema() { format!("!!{}", tag.suffix) } else { format!("{}{}", tag.handle, tag.suffix) };
    Finding::error(place, format!("the tag {} means nothing here", quoted(&written)))
}

fn weight_of(node: &Node) -> u64 {
    match &node.value {
        Value::Text(text) => 1 + text.len() as u64 / TEXT_PER_NODE,
        Value::List(items) => 1 + items.len() as u64,
        Value::Map(entries) => 1 + entries.len() as u64,
        _ => 1,
    }
}

/// A plain scalar by the core schema of YAML 1.2 (section 10.3.2).
fn resolved(text: &str) -> Value {
    match text {
        "" | "~" | "null" | "Null" | "NULL" => return Value::Null,
        "true" | "True" | "TRUE" => return Value::Boolean(true),
        "false" | "False" | "FALSE" => return Value::Boolean(false),
        ".nan" | ".NaN" | ".NAN" => return Value::Number(f64::NAN),
        _ => {}
    }
    integer(text).or_else(|| number(text)).unwrap_or_else(|| Value::Text(text.into()))
}

fn integer(text: &str) -> Option<Value> {
    let in_radix = |digits: &str, radix: u32| {
        let is_digits = !digits.is_empty() && digits.chars().all(|digit| digit.is_digit(radix));
        is_digits.then(|| i128::from_str_radix(digits, radix).map_or(Value::Number(f64::INFINITY), Value::Integer))
    };
    if let Some(digits) = text.strip_prefix("0o") {
        return in_radix(digits, 8);
    }
    if let Some(digits) = text.strip_prefix("0x") {
        return in_radix(digits, 16);
    }
    let digits = text.strip_prefix(['-', '+']).unwrap_or(text);
    let is_digits = !digits.is_empty() && digits.bytes().all(|byte| byte.is_ascii_digit());
    let too_long = || Value::Number(text.parse().unwrap_or(f64::INFINITY));
    is_digits.then(|| text.parse().map_or_else(|_| too_long(), Value::Integer))
}

fn number(text: &str) -> Option<Value> {
    let digits = text.strip_prefix(['-', '+']).unwrap_or(text);
    if matches!(digits, ".inf" | ".Inf" | ".INF") {
        return Some(Value::Number(if text.starts_with('-') { f64::NEG_INFINITY } else { f64::INFINITY }));
    }
    // Rust also reads `inf`, `nan` and `infinity`, which are words in YAML.
    let is_numeric = digits.starts_with(|first: char| first.is_ascii_digit() || first == '.')
        && digits.bytes().any(|byte| byte.is_ascii_digit())
        && digits.bytes().all(|byte| byte.is_ascii_digit() || b".eE+-".contains(&byte));
    is_numeric.then(|| text.parse().ok().map(Value::Number)).flatten()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Node, usize> {
        let mut findings = Findings::default();
        let node = parse(0, text, &mut findings);
        if findings.error_count() > 0 { Err(findings.error_count()) } else { Ok(node.unwrap()) }
    }

    fn described(text: &str) -> String {
        read(text).unwrap().described()
    }

    #[test]
    fn plain_scalars_mean_what_yaml_1_2_says() {
        for (text, expected) in [
            ("no", "text `no`"),
            ("off", "text `off`"),
            ("0o100", "`64`"),
            ("0x40", "`64`"),
            ("0100", "`100`"),
            ("1_000", "text `1_000`"),
            ("1:30", "text `1:30`"),
            ("+64", "`64`"),
            ("1e2", "`100.0`"),
            (".5", "`0.5`"),
            ("-.inf", "`-inf`"),
            ("inf", "text `inf`"),
            ("1e", "text `1e`"),
            ("!!str 64", "text `64`"),
            ("18446744073709551616", "`18446744073709551616`"),
            ("~", "nothing (null)"),
        ] {
            assert_eq!(described(text), expected, "{text}");
        }
    }

    #[test]
    fn an_unclosed_bracket_is_found_where_it_was_opened() {
        let text = "a: { b: [1, 2] }\nc: { d: \"}\", e: { f: 1 } # }\ng: 1\n";
        assert_eq!(unclosed(text, 3), Some(('{', 2)));
        assert_eq!(unclosed("a: 'it''s {'\nb: [1,\n  2\nc: d's\n", 4), Some(('[', 2)));
        assert_eq!(unclosed("a: { b: 1 }\nc: 2\n", 2), None);
    }

    #[test]
    fn an_own_key_wins_over_a_merged_one_and_the_first_merge_wins() {
        let root = read("a: &a { k: 1, l: 1 }\nb: &b { k: 2, m: 2 }\nc: { <<: [*a, *b], l: 3 }").unwrap();
        let c = entry(root.map().unwrap(), "c").unwrap().node.map().unwrap().clone();
        assert_eq!(c.len(), 3);
        let value = |key: &str| entry(&c, key).unwrap().node.described();
        assert_eq!([value("k"), value("l"), value("m")], ["`1`", "`3`", "`2`"]);
    }

    #[test]
    fn hostile_structures_are_refused() {
        for text in [
            "a: 1\na: 2",
            "a: &a [*a]",
            "a: *nope",
            "? [a, b]\n: c",
            "a: !foo 1",
            "a: !!binary NjQ=",
            "x: { <<: 3 }",
            "a: 1\n---\nb: 1",
            "a: 1\n...\n}{",
            "a: [1",
        ] {
            assert!(read(text).is_err(), "{text}");
        }
        assert!(read(&"[".repeat(100_000)).is_err());
        assert!(read(&format!("{}{}", "[".repeat(64), "]".repeat(64))).is_ok());
        assert!(read(&format!("{}{}", "[".repeat(65), "]".repeat(65))).is_err());
    }

    #[test]
    fn aliases_have_a_budget() {
        let mut laughs = String::from("a0: &a0 [l, l, l, l, l, l, l, l, l]\n");
        for level in 1..9 {
            let aliases = vec![format!("*a{}", level - 1); 9].join(", ");
            laughs += &format!("a{level}: &a{level} [{aliases}]\n");
        }
        assert!(read(&laughs).is_err());
        let long = format!("a: &a \"{}\"\nb: [{}]", "x".repeat(100_000), vec!["*a"; 1000].join(", "));
        assert!(read(&long).is_err());
    }

    #[test]
    fn a_node_knows_its_place() {
        let root = read("# é\nkey: { other: [1, wrong] }").unwrap();
        let other = entry(root.map().unwrap(), "key").unwrap().node.map().unwrap()[0].clone();
        assert_eq!(other.node.list().unwrap()[1].place, Place { file: 0, line: 2, column: 19, length: 5 });
        assert_eq!(other.place.column, 8);
    }
}

//! Checks a parameter block against the JSON Schema of its kind, value by value, with positions.
//!
//! The schema is draft-07 as schemars writes it for a kind's struct. Every mistake is found at once and
//! named in the words of the pipeline file. Also finds which fields are ports, files and seeds.
//! Knows no kind.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::fmt;
use std::rc::Rc;
use std::sync::Arc;

use serde_json::{Map, Value as Json};

use super::diagnostic::{escape, listed, quoted};
use super::source::{Place, did_you_mean};
use super::yaml::{Entry, Node, Value};
use crate::catalogue::nearest;

/// One step of a path into a parameter block.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Step {
    /// A field of a map.
    Field(String),
    /// An item of a list.
    Item(usize),
}

/// The way from the root of a parameter block to a value.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct FieldPath(pub Vec<Step>);

impl FieldPath {
    fn with(&self, step: Step) -> Self {
        Self(self.0.iter().cloned().chain([step]).collect())
    }

    /// Reads `a.b[2]`, as serde_path_to_error writes it.
    pub fn parse(text: &str) -> Self {
        let mut steps = Vec::new();
        for part in text.split('.').filter(|part| !part.is_empty() && *part != "?") {
            let (name, items) = part.split_once('[').map_or((part, ""), |(name, items)| (name, items));
            if !name.is_empty() {
                steps.push(Step::Field(name.to_owned()));
            }
            steps.extend(items.split(['[', ']']).filter_map(|index| index.parse().ok()).map(Step::Item));
        }
        Self(steps)
    }

    /// The value it leads to, or the deepest one on the way.
    pub fn follow<'n>(&self, root: &'n Node) -> &'n Node {
        let mut node = root;
        for step in &self.0 {
            let next = match (step, &node.value) {
                (Step::Field(name), Value::Map(entries)) => entries.iter().find(|entry| *entry.key == **name).map(|entry| &entry.node),
                (Step::Item(index), Value::List(items)) => items.get(*index),
                _ => None,
            };
            let Some(next) = next else { break };
            node = next;
        }
        node
    }

    /// The same tree with another value there; what does not lead anywhere changes nothing.
    pub fn replaced(&self, root: &Node, value: &Value) -> Node {
        Self::replaced_at(&self.0, root, value)
    }

    fn replaced_at(steps: &[Step], node: &Node, value: &Value) -> Node {
        let Some((step, rest)) = steps.split_first() else { return Node { value: value.clone(), ..node.clone() } };
        let value = match (step, &node.value) {
            (Step::Field(name), Value::Map(entries)) => {
                let inner = |entry: &Entry| match *entry.key == **name {
                    true => Entry { node: Self::replaced_at(rest, &entry.node, value), ..entry.clone() },
                    false => entry.clone(),
                };
                Value::Map(entries.iter().map(inner).collect())
            }
            (Step::Item(index), Value::List(items)) => {
                let inner = |(at, item): (usize, &Node)| if at == *index { Self::replaced_at(rest, item, value) } else { item.clone() };
                Value::List(items.iter().enumerate().map(inner).collect())
            }
            _ => return node.clone(),
        };
        Node { value, ..node.clone() }
    }

    /// The value there, if there is one.
    pub fn look_up<'j>(&self, root: &'j Json) -> Option<&'j Json> {
        self.0.iter().try_fold(root, |json, step| match step {
            Step::Field(name) => json.get(name),
            Step::Item(index) => json.get(*index),
        })
    }

    /// The place in a JSON value.
    pub fn in_json<'j>(&self, root: &'j mut Json) -> Option<&'j mut Json> {
        self.0.iter().try_fold(root, |json, step| match step {
            Step::Field(name) => json.get_mut(name),
            Step::Item(index) => json.get_mut(*index),
        })
    }

    /// The place in a value for serde.
    pub fn in_yaml<'y>(&self, root: &'y mut serde_yaml::Value) -> Option<&'y mut serde_yaml::Value> {
        self.0.iter().try_fold(root, |yaml, step| match step {
            Step::Field(name) => yaml.get_mut(name.as_str()),
            Step::Item(index) => yaml.get_mut(*index),
        })
    }
}

impl fmt::Display for FieldPath {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (index, step) in self.0.iter().enumerate() {
            match step {
                Step::Field(name) if index == 0 => write!(out, "{name}")?,
                Step::Field(name) => write!(out, ".{name}")?,
                Step::Item(item) => write!(out, "[{item}]")?,
            }
        }
        Ok(())
    }
}

/// What a field means to the engine.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Role {
    /// A reference to one result; the types it takes.
    Port(Arc<[String]>),
    /// References to any number of results; the types it takes.
    Ports(Arc<[String]>),
    /// A file that is read.
    File,
    /// The seed of a stage that draws.
    Seed,
}

/// A field that means something to the engine.
#[derive(Debug, Clone)]
pub struct RoleField {
    /// Which field.
    pub path: FieldPath,
    /// What it means.
    pub role: Role,
    /// Its value.
    pub node: Node,
}

/// Something wrong with a parameter.
#[derive(Debug, Clone)]
pub struct Issue {
    /// Where.
    pub place: Place,
    /// What.
    pub message: String,
    /// What to do.
    pub hint: Option<String>,
}

/// What a check has found.
#[derive(Debug, Default)]
pub struct Checked {
    /// Everything that is wrong, in the order of the text.
    pub issues: Vec<Issue>,
    /// Ports, files and seeds.
    pub roles: Vec<RoleField>,
}

/// The schema of a kind, with what was found out about its parts: blocks of one kind come by the thousand.
pub struct Rules<'s> {
    kind: &'s str,
    root: &'s Json,
    /// By address of the part; the schema outlives this.
    facts: RefCell<BTreeMap<*const Json, Rc<Facts<'s>>>>,
}

/// What a check asks of one part of a schema.
struct Facts<'s> {
    /// See [`resolved`].
    schema: &'s Json,
    role: Option<Role>,
    /// See [`alternatives`].
    alternatives: Rc<[&'s Json]>,
    words: Vec<&'s str>,
    types: Vec<&'s str>,
}

impl Facts<'_> {
    fn may_fit(&self, node: &Node) -> bool {
        match node.text() {
            _ if self.words.is_empty() => self.types.is_empty() || self.types.iter().any(|name| is_of_type(node, name)),
            Some(text) => self.words.contains(&text),
            None => false,
        }
    }
}

impl<'s> Rules<'s> {
    /// The rules of the kind of that name.
    pub fn new(kind: &'s str, schema: &'s Json) -> Self {
        Self { kind, root: schema, facts: RefCell::default() }
    }

    /// Checks a parameter block.
    pub fn check(&self, parameters: &Node) -> Checked {
        let mut walker = Walker { rules: self, checked: Checked::default() };
        walker.value(self.root, parameters, &FieldPath::default());
        walker.checked
    }

    /// The schema of a whole block.
    pub fn root(&self) -> &'s Json {
        self.root
    }

    /// A part of the schema as [`resolved`] gives it, and its [`alternatives`].
    pub fn shape(&self, schema: &'s Json) -> (&'s Json, Rc<[&'s Json]>) {
        let facts = self.facts(schema);
        (facts.schema, facts.alternatives.clone())
    }

    fn facts(&self, schema: &'s Json) -> Rc<Facts<'s>> {
        let address: *const Json = schema;
        if let Some(facts) = self.facts.borrow().get(&address) {
            return facts.clone();
        }
        let resolved = resolved(self.root, schema);
        let facts = Rc::new(Facts {
            schema: resolved,
            role: role_of(self.root, resolved),
            alternatives: alternatives(self.root, resolved).into(),
            words: words(resolved),
            types: types(resolved),
        });
        self.facts.borrow_mut().insert(address, facts.clone());
        facts
    }
}

/// The schema behind `$ref` and a lone `allOf`.
pub fn resolved<'s>(root: &'s Json, schema: &'s Json) -> &'s Json {
    let mut schema = schema;
    // A schema that refers to itself alone describes nothing; a few steps reach any real one.
    for _ in 0..16 {
        let next = schema.get("$ref").and_then(Json::as_str).and_then(|name| root.pointer(name.strip_prefix('#')?));
        let only = schema.get("allOf").and_then(Json::as_array).filter(|all| all.len() == 1 && !has_own_rules(schema)).map(|all| &all[0]);
        match next.or(only) {
            Some(next) => schema = next,
            None => break,
        }
    }
    schema
}

fn has_own_rules(schema: &Json) -> bool {
    ["type", "properties", "enum", "const", "anyOf", "oneOf"].iter().any(|rule| schema.get(rule).is_some())
}

/// What a field means to the engine, if anything.
pub fn role_of(root: &Json, schema: &Json) -> Option<Role> {
    let schema = resolved(root, schema);
    if let Some(types) = schema.get("x-port").and_then(Json::as_array) {
        let types = types.iter().filter_map(Json::as_str).map(str::to_owned).collect();
        return Some(if schema.get("x-collects").is_some() { Role::Ports(types) } else { Role::Port(types) });
    }
    if schema.get("x-file").is_some() {
        return Some(Role::File);
    }
    if schema.get("x-seed").is_some() {
        return Some(Role::Seed);
    }
    let alternatives = ["anyOf", "oneOf", "allOf"].iter().filter_map(|key| schema.get(key)?.as_array()).flatten();
    alternatives.filter(|alternative| !is_null(alternative)).find_map(|alternative| role_of(root, alternative))
}

fn is_null(schema: &Json) -> bool {
    schema.get("type").and_then(Json::as_str) == Some("null")
}

/// The alternatives of a schema, flat and without null; empty if it is not a choice of several.
pub fn alternatives<'s>(root: &'s Json, schema: &'s Json) -> Vec<&'s Json> {
    let schema = resolved(root, schema);
    let list = ["anyOf", "oneOf"].iter().find_map(|key| schema.get(key)?.as_array());
    let Some(list) = list else {
        return Vec::new();
    };
    let flat = list.iter().filter(|alternative| !is_null(alternative)).flat_map(|alternative| {
        let inner = alternatives(root, alternative);
        if inner.is_empty() { vec![resolved(root, alternative)] } else { inner }
    });
    flat.collect()
}

/// The words that a schema allows: constants of text.
pub fn words(schema: &Json) -> Vec<&str> {
    let listed = schema.get("enum").and_then(Json::as_array).into_iter().flatten().filter_map(Json::as_str);
    listed.chain(schema.get("const").and_then(Json::as_str)).collect()
}

/// The types that a schema names, without null.
pub fn types(schema: &Json) -> Vec<&str> {
    match schema.get("type") {
        Some(Json::String(name)) if name != "null" => vec![name],
        Some(Json::Array(names)) => names.iter().filter_map(Json::as_str).filter(|name| *name != "null").collect(),
        _ => Vec::new(),
    }
}

struct Walker<'r, 's> {
    rules: &'r Rules<'s>,
    checked: Checked,
}

impl<'s> Walker<'_, 's> {
    fn issue(&mut self, node: &Node, path: &FieldPath, problem: impl fmt::Display, hint: Option<String>) {
        let name = self.named(path);
        let via = node.via.as_ref().map(|via| format!(" (from {})", quoted(via))).unwrap_or_default();
        self.checked.issues.push(Issue { place: node.place, message: format!("{name}{via} {problem}"), hint });
    }

    fn named(&self, path: &FieldPath) -> String {
        if path.0.is_empty() { format!("the parameters of `{}`", self.rules.kind) } else { quoted(&path.to_string()) }
    }

    fn value(&mut self, schema: &'s Json, node: &Node, path: &FieldPath) {
        let facts = self.rules.facts(schema);
        let choice = facts.schema;
        if node.is_null() {
            return self.issue(node, path, format!("must be {}, found nothing (null)", self.expected(choice)), None);
        }
        if let Some(role) = &facts.role {
            self.checked.roles.push(RoleField { path: path.clone(), role: role.clone(), node: node.clone() });
        }
        let alternatives = &facts.alternatives;
        if alternatives.is_empty() { self.single(choice, node, path) } else { self.choice(choice, alternatives, node, path) }
    }

    /// One schema without alternatives.
    fn single(&mut self, schema: &'s Json, node: &Node, path: &FieldPath) {
        for part in schema.get("allOf").and_then(Json::as_array).into_iter().flatten() {
            self.value(part, node, path);
        }
        let facts = self.rules.facts(schema);
        if !facts.words.is_empty() {
            return self.word(&facts.words, node, path);
        }
        let types = &facts.types;
        if !types.is_empty() && !types.iter().any(|name| is_of_type(node, name)) {
            let problem = format!("must be {}, found {}", self.expected(schema), node.described());
            return self.issue(node, path, problem, None);
        }
        match &node.value {
            Value::Integer(_) | Value::Number(_) => self.number(schema, node, path),
            Value::Text(text) => self.text(schema, text, node, path),
            Value::List(items) => self.list(schema, items, node, path),
            Value::Map(entries) => self.map(schema, entries, node, path),
            Value::Boolean(_) | Value::Null => {}
        }
    }

    fn word(&mut self, words: &[&str], node: &Node, path: &FieldPath) {
        match node.text() {
            Some(text) if words.contains(&text) => {}
            Some(text) => {
                let hint =
                    did_you_mean(nearest(text, words.iter().copied())).unwrap_or_else(|| format!("it may be {}", quoted_list(words)));
                self.issue(node, path, format!("has no choice {}", quoted(text)), Some(hint));
            }
            None => {
                let problem = format!("must be {}, found {}", quoted_list(words), node.described());
                self.issue(node, path, problem, None);
            }
        }
    }

    /// Several schemas of which one must fit.
    fn choice(&mut self, schema: &'s Json, alternatives: &[&'s Json], node: &Node, path: &FieldPath) {
        let (issues, roles) = (self.checked.issues.len(), self.checked.roles.len());
        for alternative in alternatives {
            // What cannot fit is not worth a message that nobody reads.
            if !self.rules.facts(alternative).may_fit(node) {
                continue;
            }
            self.single(alternative, node, path);
            if self.checked.issues.len() == issues {
                return;
            }
            self.checked.issues.truncate(issues);
            self.checked.roles.truncate(roles);
        }
        self.explain_choice(schema, alternatives, node, path);
    }

    fn explain_choice(&mut self, schema: &'s Json, alternatives: &[&'s Json], node: &Node, path: &FieldPath) {
        let words: Vec<&str> = alternatives.iter().flat_map(|alternative| words(alternative)).collect();
        let fitting: Vec<&&Json> =
            alternatives.iter().filter(|one| words_are_absent(one) && types(one).iter().any(|name| is_of_type(node, name))).collect();
        match (&fitting[..], node.text(), node.map()) {
            ([only], _, _) => self.single(only, node, path),
            (_, _, Some(entries)) if !fitting.is_empty() => self.tagged_choice(&fitting, entries, node, path),
            (_, Some(_), _) if !words.is_empty() && alternatives.iter().all(|one| !words_are_absent(one)) => self.word(&words, node, path),
            (_, Some(text), _) if !words.is_empty() => {
                let hint = did_you_mean(nearest(text, words.iter().copied()));
                let problem = format!("must be {}, found {}", self.expected(schema), node.described());
                self.issue(node, path, problem, hint);
            }
            _ => {
                let problem = format!("must be {}, found {}", self.expected(schema), node.described());
                self.issue(node, path, problem, None);
            }
        }
    }

    /// A map whose one key says which alternative is meant.
    fn tagged_choice(&mut self, fitting: &[&&'s Json], entries: &[Entry], node: &Node, path: &FieldPath) {
        let tags: Vec<(&str, &&'s Json)> =
            fitting.iter().flat_map(|one| properties(one).keys().map(move |key| (key.as_str(), *one))).collect();
        let named = entries.iter().find_map(|entry| tags.iter().find(|(tag, _)| *tag == &*entry.key));
        match (named, entries.first()) {
            (Some((_, schema)), _) => self.single(schema, node, path),
            (None, Some(entry)) => {
                let names: Vec<&str> = tags.iter().map(|(tag, _)| *tag).collect();
                let hint = did_you_mean(nearest(&entry.key, names.iter().copied()))
                    .unwrap_or_else(|| format!("it may be {}", quoted_list(&names)));
                let message = format!("{} has no choice {}", self.named(path), quoted(&entry.key));
                self.checked.issues.push(Issue { place: entry.place, message, hint: Some(hint) });
            }
            (None, None) => {
                let names: Vec<&str> = tags.iter().map(|(tag, _)| *tag).collect();
                self.issue(node, path, format!("must name one of {}", quoted_list(&names)), None);
            }
        }
    }

    fn number(&mut self, schema: &Json, node: &Node, path: &FieldPath) {
        let value = number_of(node);
        if !value.is_finite() {
            return self.issue(node, path, format!("must be a finite number, found {}", node.described()), None);
        }
        if !is_within(schema, node, value) {
            self.issue(node, path, format!("must be {}, found {}", self.expected(schema), node.described()), None);
        }
    }

    fn text(&mut self, schema: &Json, text: &str, node: &Node, path: &FieldPath) {
        let length = text.chars().count() as u64;
        if schema.get("minLength").and_then(Json::as_u64).is_some_and(|least| length < least) {
            self.issue(node, path, "must not be empty", None);
        }
        if let Some(most) = schema.get("maxLength").and_then(Json::as_u64).filter(|most| length > *most) {
            self.issue(node, path, format!("must have at most {most} characters, found {length}"), None);
        }
    }

    fn list(&mut self, schema: &'s Json, items: &[Node], node: &Node, path: &FieldPath) {
        let count = items.len() as u64;
        let bound = |key: &str| schema.get(key).and_then(Json::as_u64);
        let (least, most) = (bound("minItems").unwrap_or(0), bound("maxItems").unwrap_or(u64::MAX));
        if count < least || count > most {
            let expected = match (least, most) {
                (least, most) if least == most => format!("exactly {least}"),
                (least, u64::MAX) => format!("at least {least}"),
                (_, most) => format!("at most {most}"),
            };
            self.issue(
                node,
                path,
                format!("must have {expected} {}, found {count}", if expected.ends_with(" 1") { "item" } else { "items" }),
                None,
            );
        }
        for (index, item) in items.iter().enumerate() {
            let schema = match schema.get("items") {
                Some(Json::Array(schemas)) => schemas.get(index),
                Some(schema @ Json::Object(_)) => Some(schema),
                _ => None,
            };
            if let Some(schema) = schema {
                self.value(schema, item, &path.with(Step::Item(index)));
            }
        }
        if schema.get("uniqueItems") == Some(&Json::Bool(true)) {
            self.unique(items, path);
        }
    }

    fn unique(&mut self, items: &[Node], path: &FieldPath) {
        for (index, item) in items.iter().enumerate() {
            if items[..index].iter().any(|other| other.described() == item.described()) {
                self.issue(item, path, format!("has {} twice", item.described()), None);
            }
        }
    }

    fn map(&mut self, schema: &'s Json, entries: &[Entry], node: &Node, path: &FieldPath) {
        let properties = properties(schema);
        for entry in entries {
            let inner = path.with(Step::Field(entry.key.to_string()));
            match (properties.get(&*entry.key), schema.get("additionalProperties")) {
                (Some(schema), _) => self.value(schema, &entry.node, &inner),
                (None, Some(Json::Bool(false))) => self.unknown(entry, properties, path),
                (None, Some(schema @ Json::Object(_))) => self.value(schema, &entry.node, &inner),
                (None, _) => {}
            }
        }
        self.one_of(schema, entries, node, path);
        let required = schema.get("required").and_then(Json::as_array).into_iter().flatten().filter_map(Json::as_str);
        let is_there = |name: &str| entries.iter().any(|entry| &*entry.key == name);
        // A misspelled key was reported as unknown, with what it was meant to be.
        let unknown = || entries.iter().map(|entry| &*entry.key).filter(|key| !properties.contains_key(*key));
        let is_misspelled = |name: &str| unknown().any(|key| nearest(key, properties.keys().map(String::as_str)) == Some(name));
        for name in required.filter(|name| !is_there(name) && !is_misspelled(name)) {
            let field = path.with(Step::Field(name.to_owned()));
            let about = properties.get(name).and_then(|schema| summary(self.rules.root, schema));
            let hint = about.map(|about| format!("`{name}`: {about}"));
            let message = format!("required parameter `{field}` of `{}` is missing", self.rules.kind);
            self.checked.issues.push(Issue { place: node.place, message, hint });
        }
    }

    /// `x-one-of`: a map that says its kind by one of these keys, beside others that all kinds have.
    fn one_of(&mut self, schema: &Json, entries: &[Entry], node: &Node, path: &FieldPath) {
        let Some(kinds) = schema.get("x-one-of").and_then(Json::as_array) else { return };
        let kinds: Vec<&str> = kinds.iter().filter_map(Json::as_str).collect();
        let mut named = entries.iter().filter(|entry| kinds.contains(&&*entry.key));
        match (named.next(), named.next()) {
            (Some(_), None) => {}
            (Some(first), Some(second)) => {
                let message = format!("{} has two kinds, {} and {}", self.named(path), quoted(&first.key), quoted(&second.key));
                let hint = Some("give each an entry of its own".to_owned());
                self.checked.issues.push(Issue { place: second.place, message, hint });
            }
            // An unknown key was reported, and is what the kind was meant to be.
            (None, _) if entries.iter().any(|entry| !properties(schema).contains_key(&*entry.key)) => {}
            (None, _) => self.issue(node, path, format!("must name one of {}", quoted_list(&kinds)), None),
        }
    }

    fn unknown(&mut self, entry: &Entry, properties: &Map<String, Json>, path: &FieldPath) {
        let names: Vec<&str> = properties.keys().map(String::as_str).collect();
        let owner = if path.0.is_empty() { format!("`{}`", self.rules.kind) } else { quoted(&path.to_string()) };
        let glued = entry.key.split_once(':').filter(|(name, _)| names.contains(name));
        let spaced = glued.map(|(name, value)| format!("a space belongs after the colon: `{name}: {}`", escape(value)));
        let hint = spaced.or_else(|| did_you_mean(nearest(&entry.key, names.iter().copied()))).or_else(|| {
            let known = if names.is_empty() { "no parameters".to_owned() } else { quoted_list_and(&names) };
            Some(format!("{owner} takes {known}"))
        });
        let message = format!("unknown parameter {} of {owner}", quoted(&entry.key));
        self.checked.issues.push(Issue { place: entry.place, message, hint });
    }

    fn expected(&self, schema: &Json) -> String {
        expected(self.rules.root, schema)
    }
}

/// What a schema asks for, in words, with all its alternatives: `` a number or `auto` ``.
pub fn expected(root: &Json, schema: &Json) -> String {
    let alternatives = alternatives(root, schema);
    if alternatives.is_empty() || matches!(role_of(root, schema), Some(Role::Port(_) | Role::Ports(_) | Role::File)) {
        return expected_single(root, schema);
    }
    let mut texts: Vec<String> = Vec::new();
    for text in alternatives.iter().map(|alternative| expected_single(root, alternative)) {
        if !texts.contains(&text) {
            texts.push(text);
        }
    }
    listed(&texts, "or")
}

fn words_are_absent(schema: &Json) -> bool {
    words(schema).is_empty()
}

fn properties(schema: &Json) -> &Map<String, Json> {
    static EMPTY: std::sync::LazyLock<Map<String, Json>> = std::sync::LazyLock::new(Map::new);
    schema.get("properties").and_then(Json::as_object).unwrap_or(&EMPTY)
}

/// The first sentence of a field's description.
pub fn summary(root: &Json, schema: &Json) -> Option<String> {
    let own = schema.get("description").or_else(|| resolved(root, schema).get("description"))?.as_str()?;
    let line = own.split("\n\n").next()?.replace('\n', " ");
    Some(line.trim().trim_end_matches('.').to_owned())
}

fn quoted_list(words: &[&str]) -> String {
    listed(&words.iter().map(|word| quoted(word)).collect::<Vec<_>>(), "or")
}

fn quoted_list_and(words: &[&str]) -> String {
    listed(&words.iter().map(|word| quoted(word)).collect::<Vec<_>>(), "and")
}

/// What one schema without alternatives asks for: `an integer from 1 to 65536`.
fn expected_single(root: &Json, schema: &Json) -> String {
    let schema = resolved(root, schema);
    match role_of(root, schema) {
        Some(Role::Port(types)) => return format!("the name of a stage that gives {}", listed(&types, "or")),
        Some(Role::Ports(types)) => return format!("the name of a stage that gives {}, or a list of such names", listed(&types, "or")),
        Some(Role::File) => return "the path of a file".to_owned(),
        _ => {}
    }
    let words = words(schema);
    if !words.is_empty() {
        return quoted_list(&words);
    }
    let texts: Vec<String> = types(schema).iter().map(|name| format!("{}{}", article(name), limits(schema, name))).collect();
    if texts.is_empty() { "a value".to_owned() } else { listed(&texts, "or") }
}

fn article(type_name: &str) -> &'static str {
    match type_name {
        "integer" => "an integer",
        "number" => "a number",
        "string" => "text",
        "boolean" => "`true` or `false`",
        "array" => "a list",
        _ => "a map",
    }
}

fn limits(schema: &Json, type_name: &str) -> String {
    if type_name == "array" {
        let bound = |key: &str| schema.get(key).and_then(Json::as_u64);
        return match (bound("minItems"), bound("maxItems")) {
            (Some(least), Some(most)) if least == most => format!(" of {least}"),
            _ => String::new(),
        };
    }
    if !matches!(type_name, "integer" | "number") {
        return String::new();
    }
    let Bounds { least, above, most, below } = bounds(schema);
    match (least, above, most, below) {
        (Some(least), _, Some(most), _) => format!(" from {least} to {most}"),
        (Some(least), _, _, Some(below)) => format!(" from {least} to below {below}"),
        (_, Some(above), Some(most), _) => format!(" above {above} and at most {most}"),
        (_, Some(above), _, Some(below)) => format!(" between {above} and {below}, neither included"),
        (Some(least), ..) => format!(" of at least {least}"),
        (_, Some(above), ..) => format!(" greater than {above}"),
        (_, _, Some(most), _) => format!(" of at most {most}"),
        (_, _, _, Some(below)) => format!(" less than {below}"),
        _ => String::new(),
    }
}

/// Bounds of a number, as they are shown.
struct Bounds {
    least: Option<String>,
    above: Option<String>,
    most: Option<String>,
    below: Option<String>,
}

fn bounds(schema: &Json) -> Bounds {
    let shown = |key: &str| schema.get(key).and_then(Json::as_f64).map(|_| number_shown(&schema[key]));
    let by_format = integer_range(schema).map(|(least, most)| (least.to_string(), most.to_string()));
    // The range of the machine type is worth showing only where the kind sets no bound of its own.
    let (type_least, type_most) = by_format.unzip();
    let (above, below) = (shown("exclusiveMinimum"), shown("exclusiveMaximum"));
    let least = if above.is_some() { None } else { shown("minimum").or(type_least) };
    let most = if below.is_some() { None } else { shown("maximum").or(type_most) };
    Bounds { least, above, most, below }
}

/// A bound without a needless `.0`.
pub fn number_shown(number: &Json) -> String {
    match number.as_f64() {
        Some(value) if !number.is_i64() && !number.is_u64() && value.fract() == 0.0 && value.abs() < 1e15 => format!("{value:.0}"),
        _ => number.to_string(),
    }
}

/// What the `format` of an integer allows.
fn integer_range(schema: &Json) -> Option<(i128, i128)> {
    Some(match schema.get("format")?.as_str()? {
        "uint8" => (0, i128::from(u8::MAX)),
        "uint16" => (0, i128::from(u16::MAX)),
        "uint32" => (0, i128::from(u32::MAX)),
        "uint64" | "uint" => (0, i128::from(u64::MAX)),
        "int8" => (i128::from(i8::MIN), i128::from(i8::MAX)),
        "int16" => (i128::from(i16::MIN), i128::from(i16::MAX)),
        "int32" => (i128::from(i32::MIN), i128::from(i32::MAX)),
        "int64" | "int" => (i128::from(i64::MIN), i128::from(i64::MAX)),
        _ => return None,
    })
}

fn number_of(node: &Node) -> f64 {
    match &node.value {
        Value::Integer(value) => *value as f64,
        Value::Number(value) => *value,
        _ => f64::NAN,
    }
}

fn is_within(schema: &Json, node: &Node, value: f64) -> bool {
    let bound = |key: &str| schema.get(key).and_then(Json::as_f64);
    let exact = match &node.value {
        Value::Integer(value) => *value,
        _ => value as i128,
    };
    // Formats of numbers with a point have no entry, and all of theirs that is finite is in range.
    integer_range(schema).is_none_or(|(least, most)| (least..=most).contains(&exact))
        && bound("minimum").is_none_or(|least| value >= least)
        && bound("maximum").is_none_or(|most| value <= most)
        && bound("exclusiveMinimum").is_none_or(|above| value > above)
        && bound("exclusiveMaximum").is_none_or(|below| value < below)
}

fn is_of_type(node: &Node, type_name: &str) -> bool {
    match (&node.value, type_name) {
        (Value::Integer(_), "integer" | "number")
        | (Value::Number(_), "number")
        | (Value::Text(_), "string")
        | (Value::Boolean(_), "boolean")
        | (Value::List(_), "array")
        | (Value::Map(_), "object") => true,
        (Value::Number(value), "integer") => value.fract() == 0.0,
        _ => false,
    }
}

/// The value for serde: whole numbers as integers, maps in order.
pub fn to_yaml(node: &Node) -> serde_yaml::Value {
    use serde_yaml::Value as Yaml;
    match &node.value {
        Value::Null => Yaml::Null,
        Value::Boolean(value) => Yaml::Bool(*value),
        Value::Integer(value) => integer_to_yaml(*value),
        Value::Number(value) => match super::coordinate::Scalar::from_number(*value) {
            super::coordinate::Scalar::Integer(whole) => integer_to_yaml(whole),
            _ => Yaml::Number((*value).into()),
        },
        Value::Text(text) => Yaml::String(text.to_string()),
        Value::List(items) => Yaml::Sequence(items.iter().map(to_yaml).collect()),
        Value::Map(entries) => {
            Yaml::Mapping(entries.iter().map(|entry| (Yaml::String(entry.key.to_string()), to_yaml(&entry.node))).collect())
        }
    }
}

fn integer_to_yaml(value: i128) -> serde_yaml::Value {
    match (u64::try_from(value), i64::try_from(value)) {
        (Ok(value), _) => serde_yaml::Value::Number(value.into()),
        (_, Ok(value)) => serde_yaml::Value::Number(value.into()),
        _ => serde_yaml::Value::Number((value as f64).into()),
    }
}

#[cfg(test)]
mod tests {
    use std::num::NonZeroU32;

    use schemars::JsonSchema;
    use schemars::generate::SchemaSettings;

    use super::*;
    use crate::engine::artifact::{AnyArtifact, TypeName};
    use crate::engine::parameter::{Accepts, InputFile, Port, Ports, Seed};
    use crate::engine::source::Findings;

    struct Map;
    impl Accepts for Map {
        const TYPES: &'static [TypeName] = &["envmap"];
        type Value = ();
        fn take(_: AnyArtifact) -> Option<()> {
            None
        }
    }

    /// How.
    #[derive(JsonSchema)]
    #[schemars(rename_all = "kebab-case")]
    #[allow(dead_code)]
    enum Method {
        /// Independent.
        Iid,
        /// By rows.
        RowsThenColumns,
    }

    #[derive(JsonSchema)]
    #[schemars(deny_unknown_fields)]
    #[allow(dead_code)]
    struct Block {
        of: Port<Map>,
        at: Option<Port<Map>>,
        #[serde(default)]
        many: Option<Ports<Map>>,
        /// How many. More text.
        count: NonZeroU32,
        method: Option<Method>,
        methods: Option<Vec<Method>>,
        #[schemars(range(max = 1.0), extend("exclusiveMinimum" = 0))]
        albedo: Option<f32>,
        path: Option<InputFile>,
        #[serde(default)]
        seed: Seed,
        #[schemars(with = "serde_json::Value", extend("anyOf" = [{ "type": "number", "minimum": 0 }, { "const": "auto" }]))]
        exposure: (),
        pair: Option<[f64; 2]>,
        small: Option<u8>,
    }

    fn issues(text: &str) -> Vec<String> {
        let schema: Json = SchemaSettings::draft07().into_generator().into_root_schema_for::<Block>().into();
        let mut findings = Findings::default();
        let node = crate::engine::yaml::parse(0, text, &mut findings).unwrap();
        let checked = Rules::new("block", &schema).check(&node);
        checked.issues.iter().map(|issue| format!("{}; {}", issue.message, issue.hint.clone().unwrap_or_default())).collect()
    }

    #[test]
    fn a_right_block_has_no_issues() {
        let none: Vec<String> = Vec::new();
        assert_eq!(issues("{ of: a, count: 64.0, method: iid, exposure: auto, pair: [1, 2] }"), none);
        assert_eq!(issues("{ of: a, at: b, many: [a, b], count: 1, methods: [iid], albedo: 1, path: x, seed: 3, exposure: 2 }"), none);
        assert_eq!(issues("{ of: a, many: b, count: 1, exposure: 1.5 }"), none);
    }

    #[test]
    fn each_mistake_is_named_with_what_was_expected() {
        for (field, expected) in [
            ("count: 0", "`count` must be an integer from 1 to 4294967295, found `0`"),
            ("count: 64.5", "`count` must be an integer from 1 to 4294967295, found `64.5`"),
            ("count: 1e30", "found `1e30`"),
            ("count: \"64\"", "found text `64`"),
            ("count: null", "found nothing (null)"),
            ("count: .nan", "found `NaN`"),
            ("count: [64]", "found a list"),
            ("count: 1, mehtod: iid", "unknown parameter `mehtod` of `block`; did you mean `method`?"),
            ("count: 1, seed:7", "unknown parameter `seed:7` of `block`; a space belongs after the colon: `seed: 7`"),
            ("count: 1, method: idi", "`method` has no choice `idi`; did you mean `iid`?"),
            ("count: 1, method: 3", "`method` must be `iid` or `rows-then-columns`, found `3`"),
            ("count: 1, methods: [iid, x]", "`methods[1]` has no choice `x`; it may be `iid` or `rows-then-columns`"),
            ("count: 1, albedo: 0", "`albedo` must be a number above 0 and at most 1, found `0`"),
            ("count: 1, albedo: .inf", "`albedo` must be a finite number"),
            ("count: 1, path: \"\"", "`path` must not be empty"),
            ("count: 1, seed: -1", "`seed` must be an integer from 0"),
            ("count: 1, pair: [1]", "`pair` must have exactly 2 items, found 1"),
            ("count: 1, small: 256", "`small` must be an integer from 0 to 255, found `256`"),
            ("count: 1, at: [a]", "`at` must be the name of a stage that gives envmap, found a list"),
            ("count: 1, many: []", "`many` must have at least 1 item, found 0"),
            ("count: 1, many: 3", "`many` must be the name of a stage that gives envmap, or a list of such names, found `3`"),
        ] {
            let found = issues(&format!("{{ of: a, exposure: 1, {field} }}"));
            assert!(found.len() == 1 && found[0].contains(expected), "{field}: {found:?}");
        }
        let found = issues("{ of: a, count: 1, exposure: atuo }");
        assert_eq!(found, ["`exposure` must be a number of at least 0 or `auto`, found text `atuo`; did you mean `auto`?"]);
        let found = issues("{ of: a, exposure: 1, cuont: 1 }");
        assert_eq!(found, ["unknown parameter `cuont` of `block`; did you mean `count`?"]);
        let found = issues("{ of: a, exposure: 1 }");
        assert_eq!(found, ["required parameter `count` of `block` is missing; `count`: How many. More text"]);
    }

    #[test]
    fn roles_are_found_behind_options() {
        let schema: Json = SchemaSettings::draft07().into_generator().into_root_schema_for::<Block>().into();
        let mut findings = Findings::default();
        let node =
            crate::engine::yaml::parse(0, "{ of: a, at: b, many: c, count: 1, path: p, seed: 1, exposure: 1 }", &mut findings).unwrap();
        let roles: Vec<String> =
            Rules::new("block", &schema).check(&node).roles.iter().map(|role| format!("{} {:?}", role.path, role.role)).collect();
        assert_eq!(roles, ["of Port([\"envmap\"])", "at Port([\"envmap\"])", "many Ports([\"envmap\"])", "path File", "seed Seed"]);
    }
}

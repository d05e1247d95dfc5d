//! What the definitions say of each parameter, as data: the terminal and the pages of the book show the same.

use serde_json::Value as Json;

use crate::engine::diagnostic::listed;
use crate::engine::registry::Kind;
use crate::engine::schema::{alternatives, expected, number_shown, resolved, role_of, words};

/// Deepest nesting of parameters that is shown.
const DEPTH_SHOWN: usize = 6;

/// A parameter, or a kind of a choice, as it is explained.
#[derive(Debug, Clone, PartialEq)]
pub struct Entry {
    /// Its key.
    pub name: String,
    /// What it takes, its unit, and its default.
    pub facts: String,
    /// What it means; paragraphs as they were written.
    pub about: String,
    /// Words it takes that have a description of their own, with it.
    pub choices: Vec<(String, String)>,
    /// The parameters within it.
    pub inner: Vec<Entry>,
    /// Names of the definitions that explain what is within, where they are explained elsewhere.
    pub elsewhere: Vec<String>,
}

/// Whether what is within a parameter is told with it, or elsewhere.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Within {
    /// To this depth with the parameter.
    Here(usize),
    /// Definitions that have parameters are named in [`Entry::elsewhere`].
    Elsewhere,
}

impl Within {
    /// All that is shown.
    pub fn here() -> Self {
        Self::Here(DEPTH_SHOWN)
    }
}

/// The description of a kind without its example, and the example.
pub fn about_and_example(schema: &Json) -> (&str, Option<&str>) {
    let text = description(schema).unwrap_or_default();
    let Some((about, rest)) = text.split_once("```yaml\n") else { return (text.trim_end(), None) };
    (about.trim_end(), rest.split_once("```").map(|(example, _)| example.trim_end()))
}

/// The types of a kind's results: `table, image (.map)`.
pub fn gives(kind: &Kind) -> String {
    let results = kind.results.iter().map(|result| {
        let types = listed(result.types, "or");
        if result.name.is_empty() { types } else { format!("{types} (.{})", result.name) }
    });
    results.collect::<Vec<_>>().join(", ")
}

/// The first sentence of a description, on one line.
pub fn first_sentence(schema: &Json) -> String {
    let paragraph = first_paragraph(description(schema).unwrap_or_default());
    paragraph.split(". ").next().unwrap_or_default().trim_end_matches('.').to_owned() + "."
}

/// The first paragraph of a text, on one line.
pub fn first_paragraph(text: &str) -> String {
    text.split("\n\n").next().unwrap_or_default().replace('\n', " ")
}

/// What a schema says of itself.
pub fn description(schema: &Json) -> Option<&str> {
    schema.get("description")?.as_str()
}

/// The parameters of a schema, in the order in which they were written.
pub fn entries(root: &Json, schema: &Json, within: Within) -> Vec<Entry> {
    entries_of(root, schema, within, &mut Vec::new())
}

/// The parameters of a schema; `told` are the fields in which it is.
fn entries_of(root: &Json, schema: &Json, within: Within, told: &mut Vec<*const Json>) -> Vec<Entry> {
    let schema = resolved(root, schema);
    let required: Vec<&str> = schema.get("required").and_then(Json::as_array).into_iter().flatten().filter_map(Json::as_str).collect();
    let fields = schema.get("properties").and_then(Json::as_object).into_iter().flatten();
    fields.map(|(name, field)| entry(root, name, field, required.contains(&name.as_str()), within, told)).collect()
}

fn entry(root: &Json, name: &str, field: &Json, is_required: bool, within: Within, told: &mut Vec<*const Json>) -> Entry {
    let about = description(field).or_else(|| description(resolved(root, field))).unwrap_or_default();
    let (inner, elsewhere) = match within {
        Within::Here(0) => (Vec::new(), Vec::new()),
        Within::Here(depth) => (entries_within(root, field, Within::Here(depth - 1), told), Vec::new()),
        Within::Elsewhere => entries_or_names(root, field, told),
    };
    Entry {
        name: name.to_owned(),
        facts: facts(root, field, is_required),
        about: about.to_owned(),
        choices: choices(root, field),
        inner,
        elsewhere,
    }
}

/// The fields of a field: of a map, of the items of a list, of each alternative. What stands in itself, as a BSDF in a
/// BSDF, is told once.
fn entries_within(root: &Json, field: &Json, within: Within, told: &mut Vec<*const Json>) -> Vec<Entry> {
    let here = std::ptr::from_ref(resolved(root, field));
    if role_of(root, field).is_some() || told.contains(&here) {
        return Vec::new();
    }
    told.push(here);
    let mut inner = entries_of(root, field, within, told);
    for alternative in alternatives(root, field) {
        inner.extend(entries_of(root, alternative, within, told));
    }
    if let Some(items) = resolved(root, field).get("items") {
        inner.extend(entries_within(root, items, within, told));
    }
    told.pop();
    inner
}

/// What is within a field, unless definitions have it; their names then.
fn entries_or_names(root: &Json, field: &Json, told: &mut Vec<*const Json>) -> (Vec<Entry>, Vec<String>) {
    let mut names = Vec::new();
    definitions_of(field, &mut names);
    names.retain(|name| has_fields(root, &root["definitions"][name]));
    if names.is_empty() { (entries_within(root, field, Within::Elsewhere, told), names) } else { (Vec::new(), names) }
}

/// The definitions that a schema refers to, outside the fields of maps.
fn definitions_of(schema: &Json, names: &mut Vec<String>) {
    let name = definition_name(schema).filter(|name| !names.iter().any(|known| known == name));
    names.extend(name.map(str::to_owned));
    let lists = ["anyOf", "oneOf", "allOf"].iter().filter_map(|key| schema.get(key)?.as_array()).flatten();
    let inner = ["items", "additionalProperties"].iter().filter_map(|key| schema.get(key)).filter(|inner| inner.is_object());
    lists.chain(inner).for_each(|part| definitions_of(part, names));
}

/// The name of the definition to which a schema refers.
pub fn definition_name(schema: &Json) -> Option<&str> {
    schema.get("$ref")?.as_str()?.strip_prefix("#/definitions/")
}

/// Whether a schema has parameters of its own, in itself or in an alternative.
pub fn has_fields(root: &Json, schema: &Json) -> bool {
    let has_own = |schema: &Json| {
        resolved(root, schema).get("properties").is_some_and(|fields| fields.as_object().is_some_and(|all| !all.is_empty()))
    };
    has_own(schema) || alternatives(root, schema).into_iter().any(has_own)
}

/// What it takes, its unit, and whether it may be left out.
fn facts(root: &Json, field: &Json, is_required: bool) -> String {
    let unit = |schema: &Json| schema.get("x-unit").and_then(Json::as_str).map(|unit| format!(" ({unit})"));
    let unit = unit(field).or_else(|| unit(resolved(root, field))).unwrap_or_default();
    let default = match field.get("default") {
        _ if is_required => "required".to_owned(),
        // The defaults within a map stand with what is within it.
        Some(Json::Null | Json::Object(_)) | None => "optional".to_owned(),
        Some(Json::String(word)) if word.is_empty() => "optional".to_owned(),
        Some(number @ Json::Number(_)) => format!("default {}", shortest(number)),
        Some(Json::String(word)) => format!("default {word}"),
        Some(other) => format!("default {other}"),
    };
    format!("{}{unit}; {default}", expected(root, field))
}

/// A default as a person wrote it: the schema holds an f32 with the digits of its f64.
fn shortest(number: &Json) -> String {
    match number.as_f64() {
        Some(value) if number.is_f64() && f64::from(value as f32) == value => format!("{}", value as f32),
        _ => number_shown(number),
    }
}

/// The choices of a field that have a description of their own.
fn choices(root: &Json, field: &Json) -> Vec<(String, String)> {
    let field = resolved(root, field);
    let items = field.get("items").map(|items| resolved(root, items));
    let all = [Some(field), items].into_iter().flatten().flat_map(|schema| alternatives(root, schema));
    all.filter_map(|choice| Some(((*words(choice).first()?).to_owned(), first_paragraph(description(choice)?)))).collect()
}

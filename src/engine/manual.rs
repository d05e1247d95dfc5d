//! The manual of the kinds and the schema for editors, from the definitions that read the parameters.
//!
//! Pure functions of the registry: what `pipeline stages`, `pipeline stages KIND` and `pipeline schema` print.

use std::fmt::Write;

use serde_json::{Map, Value as Json, json};

use super::diagnostic::{listed, quoted};
use super::registry::{Kind, Registry};
use super::schema::{alternatives, expected, number_shown, resolved, role_of, words};
use super::source::did_you_mean;
use crate::catalogue::nearest;

/// All kinds, one a line: name, what it gives, what it does.
pub fn kinds(registry: &Registry) -> String {
    let rows: Vec<(&str, String, String)> =
        registry.kinds().iter().map(|(name, kind)| (name, gives(kind), first_sentence(kind.schema()))).collect();
    let name_width = rows.iter().map(|row| row.0.len()).max().unwrap_or(0);
    let gives_width = rows.iter().map(|row| row.1.chars().count()).max().unwrap_or(0);
    let lines = rows.iter().map(|(name, gives, about)| format!("{name:name_width$}  {gives:gives_width$}  {about}\n"));
    lines.collect::<String>() + "\n`pipeline stages KIND` shows the parameters of one.\n"
}

/// One kind with every parameter; the error names the nearest kind.
pub fn kind(registry: &Registry, name: &str) -> Result<String, String> {
    let Some(kind) = registry.kinds().find(name) else {
        let hint = did_you_mean(nearest(name, registry.kinds().names())).map(|hint| format!("; {hint}")).unwrap_or_default();
        return Err(format!("there is no kind {}{hint}", quoted(name)));
    };
    let mut text = format!("{}\n\n", kind.name);
    if let Some(about) = description(kind.schema()) {
        text += &format!("{}\n\n", indented(about, "  "));
    }
    text += &format!("Gives {}. Version {}.\n", gives(kind), kind.version);
    let mut parameters = String::new();
    fields(kind.schema(), kind.schema(), 1, &mut parameters);
    if !parameters.is_empty() {
        text += &format!("\nParameters:\n{parameters}");
    }
    Ok(text)
}

fn gives(kind: &Kind) -> String {
    let results = kind.results.iter().map(|result| {
        let types = listed(result.types, "or");
        if result.name.is_empty() { types } else { format!("{types} (.{})", result.name) }
    });
    results.collect::<Vec<_>>().join(", ")
}

fn description(schema: &Json) -> Option<&str> {
    schema.get("description")?.as_str()
}

fn first_sentence(schema: &Json) -> String {
    let text = description(schema).unwrap_or_default();
    let paragraph = text.split("\n\n").next().unwrap_or_default().replace('\n', " ");
    paragraph.split(". ").next().unwrap_or_default().trim_end_matches('.').to_owned() + "."
}

/// Text with every line indented; lines of one paragraph stay as they were broken.
fn indented(text: &str, indent: &str) -> String {
    let lines = text.lines().map(|line| if line.is_empty() { String::new() } else { format!("{indent}{line}") });
    lines.collect::<Vec<_>>().join("\n")
}

/// Deepest nesting of parameters that is shown.
const DEPTH_SHOWN: usize = 6;

fn fields(root: &Json, schema: &Json, depth: usize, text: &mut String) {
    let schema = resolved(root, schema);
    let required: Vec<&str> = schema.get("required").and_then(Json::as_array).into_iter().flatten().filter_map(Json::as_str).collect();
    for (name, field) in schema.get("properties").and_then(Json::as_object).into_iter().flatten() {
        let indent = "  ".repeat(depth);
        let facts = facts(root, field, required.contains(&name.as_str()));
        writeln!(text, "\n{indent}{name}: {facts}").expect("writing to a String");
        if let Some(about) = description(field).or_else(|| description(resolved(root, field))) {
            writeln!(text, "{}", indented(about, &format!("{indent}    "))).expect("writing to a String");
        }
        choices(root, field, &indent, text);
        if depth < DEPTH_SHOWN {
            fields_within(root, field, depth + 1, text);
        }
    }
}

/// What it takes, its unit, and whether it may be left out.
fn facts(root: &Json, field: &Json, is_required: bool) -> String {
    let unit = |schema: &Json| schema.get("x-unit").and_then(Json::as_str).map(|unit| format!(" ({unit})"));
    let unit = unit(field).or_else(|| unit(resolved(root, field))).unwrap_or_default();
    let default = match field.get("default") {
        _ if is_required => "required".to_owned(),
        Some(Json::Null) | None => "optional".to_owned(),
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
fn choices(root: &Json, field: &Json, indent: &str, text: &mut String) {
    let field = resolved(root, field);
    let items = field.get("items").map(|items| resolved(root, items));
    for choice in [Some(field), items].into_iter().flatten().flat_map(|schema| alternatives(root, schema)) {
        if let (Some(word), Some(about)) = (words(choice).first(), description(choice)) {
            let about = about.split("\n\n").next().unwrap_or_default().replace('\n', " ");
            writeln!(text, "{indent}    - {word}: {about}").expect("writing to a String");
        }
    }
}

/// The fields of a field: of a map, of the items of a list, of each alternative.
fn fields_within(root: &Json, field: &Json, depth: usize, text: &mut String) {
    if role_of(root, field).is_some() {
        return;
    }
    fields(root, field, depth, text);
    for inner in alternatives(root, field) {
        fields(root, inner, depth, text);
    }
    if let Some(items) = resolved(root, field).get("items") {
        fields_within(root, items, depth, text);
    }
}

/// The JSON Schema (draft-07) of a whole pipeline file, for editors.
pub fn schema(registry: &Registry) -> Json {
    let mut definitions = Map::new();
    let mut kinds = Map::new();
    for (name, kind) in registry.kinds().iter() {
        kinds.insert(name.to_owned(), json!({ "$ref": format!("#/definitions/{name}") }));
        add_kind(name, kind, &mut definitions);
    }
    definitions.insert(
        "variable".into(),
        json!({
            "type": "string",
            "pattern": "\\$",
            "description": "A parameter or an axis: `$name`, `$name.field`, or `${name}` inside text.",
        }),
    );
    definitions.insert("stage".into(), stage_schema(registry, kinds));
    definitions.insert("axis".into(), axis_schema());
    json!({
        "$schema": "http://json-schema.org/draft-07/schema#",
        "title": "A pipeline",
        "type": "object",
        "required": ["version", "pipeline", "stages"],
        "additionalProperties": false,
        "properties": {
            "version": { "const": 1, "description": "Version of the language." },
            "pipeline": {
                "type": "string",
                "pattern": "^[A-Za-z0-9_][A-Za-z0-9_.-]{0,63}$",
                "description": "Its name: results go to `outputs/NAME`.",
            },
            "seed": { "type": "integer", "minimum": 0, "maximum": u64::MAX, "description": "The seed of every stage that draws and sets none." },
            "params": { "type": "object", "propertyNames": name_schema(), "description": "Values that stages use as `$name`." },
            "axes": {
                "type": "object",
                "propertyNames": name_schema(),
                "additionalProperties": { "$ref": "#/definitions/axis" },
                "description": "Named lists of values; a stage that mentions one exists once per value.",
            },
            "stages": {
                "type": "object",
                "minProperties": 1,
                "propertyNames": { "pattern": "^[A-Za-z0-9_][A-Za-z0-9_-]{0,63}$" },
                "additionalProperties": { "$ref": "#/definitions/stage" },
                "description": "What is computed, in any order.",
            },
            "include": { "type": "array", "items": { "type": "string", "minLength": 1 }, "description": "Files whose params, axes and stages are added." },
        },
        "definitions": definitions,
    })
}

fn name_schema() -> Json {
    json!({ "pattern": "^[A-Za-z_][A-Za-z0-9_-]{0,63}$" })
}

fn axis_schema() -> Json {
    let numbers =
        |about: &str| json!({ "type": "array", "items": { "type": "number" }, "minItems": 3, "maxItems": 3, "description": about });
    let form = |name: &str, about: &str| json!({ "type": "object", "required": [name], "additionalProperties": false, "properties": { name: numbers(about) } });
    json!({
        "anyOf": [
            { "type": "array", "minItems": 1, "items": { "type": ["number", "string", "boolean"] } },
            { "type": "array", "minItems": 1, "items": { "type": "object", "minProperties": 1 } },
            form("range", "from, to, step; both ends included"),
            form("linspace", "from, to, count; both ends included"),
            form("powers", "base, from, to: powers of the base, both exponents included"),
        ],
    })
}

fn stage_schema(registry: &Registry, kinds: Map<String, Json>) -> Json {
    let mut formats: Vec<&str> = registry.artifacts().iter().flat_map(|(_, artifact)| artifact.formats.iter().copied()).collect();
    formats.sort_unstable();
    formats.dedup();
    let format = json!({ "enum": formats });
    let format_list = json!({ "anyOf": [format, { "type": "array", "items": format, "minItems": 1 }] });
    let one_kind: Vec<Json> = kinds.keys().map(|name| json!({ "required": [name] })).collect();
    let mut properties = kinds;
    properties.insert("save".into(), json!({
        "anyOf": [format, { "type": "array", "items": format, "minItems": 1 }, { "type": "object", "additionalProperties": format_list }],
        "description": "Formats in which results are published; a map names results.",
    }));
    properties.insert(
        "exclude".into(),
        json!({
            "type": "array",
            "items": { "type": "object", "minProperties": 1 },
            "description": "Coordinates that this stage leaves out.",
        }),
    );
    properties.insert("about".into(), json!({ "type": "string", "description": "What it is for; shown in reports." }));
    json!({ "type": "object", "properties": properties, "additionalProperties": false, "oneOf": one_kind })
}

/// Adds the schema of a kind, its own definitions under names that no other kind has.
fn add_kind(name: &str, kind: &Kind, definitions: &mut Map<String, Json>) {
    let mut schema = kind.schema().clone();
    let own = schema.as_object_mut().and_then(|schema| {
        schema.remove("$schema");
        schema.remove("definitions")
    });
    definitions.insert(name.to_owned(), for_editor(name, schema));
    for (inner, schema) in own.iter().flat_map(Json::as_object).flatten() {
        definitions.insert(format!("{name}.{inner}"), for_editor(name, schema.clone()));
    }
}

/// References to the new names, and a variable wherever a value may stand.
fn for_editor(name: &str, schema: Json) -> Json {
    match schema {
        Json::Object(fields) => fields
            .into_iter()
            .map(|(key, value)| {
                let value = match (key.as_str(), value) {
                    ("$ref", Json::String(target)) => json!(target.replace("#/definitions/", &format!("#/definitions/{name}."))),
                    ("properties", Json::Object(properties)) => properties
                        .into_iter()
                        .map(|(field, schema)| (field, or_variable(for_editor(name, schema))))
                        .collect::<Map<_, _>>()
                        .into(),
                    // Values, not schemas.
                    ("default" | "enum" | "const", value) => value,
                    (_, value) => for_editor(name, value),
                };
                (key, value)
            })
            .collect::<Map<_, _>>()
            .into(),
        Json::Array(items) => items.into_iter().map(|item| for_editor(name, item)).collect(),
        other => other,
    }
}

fn or_variable(schema: Json) -> Json {
    let takes_text = schema.get("type").and_then(Json::as_str) == Some("string") && schema.get("enum").is_none();
    if takes_text {
        return schema;
    }
    let about = schema.get("description").cloned();
    let mut choice = Map::new();
    if let Some(about) = about {
        choice.insert("description".into(), about);
    }
    choice.insert("anyOf".into(), json!([schema, { "$ref": "#/definitions/variable" }]));
    choice.into()
}

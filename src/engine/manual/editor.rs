//! The JSON Schema of a whole pipeline file: completion, hover texts and marks of mistakes in editors.
//!
//! Wherever a value may stand, so may a variable. What no schema can say (which stages exist, which axes) is left to `pipeline check`.

use serde_json::{Map, Value as Json, json};

use crate::engine::document::PART_LIMIT;
use crate::engine::registry::{Kind, Registry};

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
    properties.insert("resources".into(), resources_schema());
    let parts = "Most parts in which a `render` is computed, so that several machines can share it; it changes no result.";
    properties.insert("split".into(), json!({ "type": "integer", "minimum": 2, "maximum": PART_LIMIT, "description": parts }));
    properties.insert("about".into(), json!({ "type": "string", "description": "What it is for; shown in reports." }));
    json!({ "type": "object", "properties": properties, "additionalProperties": false, "oneOf": one_kind })
}

fn resources_schema() -> Json {
    json!({
        "type": "object",
        "additionalProperties": false,
        "properties": {
            "threads": { "type": "integer", "minimum": 1, "maximum": 4096, "description": "Threads that a job makes use of." },
            "memory": { "type": "string", "description": "Memory that a job takes, as 512MiB or 8GiB." },
            "time": { "type": "string", "description": "Longest time of a job, as 90m, 12h or 2d." },
        },
        "description": "What each job asks of the machine; it changes no result.",
    })
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
                    ("items" | "additionalProperties", schema @ Json::Object(_)) => or_variable(for_editor(name, schema)),
                    ("items", Json::Array(schemas)) => schemas.into_iter().map(|schema| or_variable(for_editor(name, schema))).collect(),
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

//! The one form of a parameter block that enters a key.
//!
//! Ports are left out (inputs enter by content), so is what stands at its default; files are replaced by
//! their field name, since their digest enters; numbers have one form and keys are sorted.

use serde_json::{Map, Number, Value as Json, json};

use super::coordinate::Scalar;
use super::schema::{FieldPath, Role, Rules, Step};

/// A field that has no place in the key as it stands.
pub struct Replaced<'a> {
    /// Where it is.
    pub path: &'a FieldPath,
    /// What it means.
    pub role: &'a Role,
    /// What stands instead; nothing for `None`.
    pub instead: Option<Json>,
}

/// The canonical form of `parameters`, all fields of a block with those rules.
pub fn canonical(rules: &Rules<'_>, parameters: Json, replaced: &[Replaced<'_>]) -> Json {
    let mut json = parameters;
    strip_defaults(rules, rules.root(), &mut json);
    for Replaced { path, instead, .. } in replaced {
        match instead {
            Some(instead) => put(&mut json, path, instead.clone()),
            None => remove(&mut json, path),
        }
    }
    sorted(json)
}

fn put(json: &mut Json, path: &FieldPath, value: Json) {
    if let Some(place) = path.in_json(json) {
        *place = value;
    } else if let (Json::Object(fields), [Step::Field(name)]) = (json, &path.0[..]) {
        fields.insert(name.clone(), value);
    }
}

fn remove(json: &mut Json, path: &FieldPath) {
    let Some((last, parents)) = path.0.split_last() else { return };
    match (FieldPath(parents.to_vec()).in_json(json), last) {
        (Some(Json::Object(fields)), Step::Field(name)) => {
            fields.shift_remove(name);
        }
        (Some(Json::Array(items)), Step::Item(index)) if *index < items.len() => items[*index] = Json::Null,
        _ => {}
    }
}

/// Removes what is absent or at its default, at any depth of fields, lists and choices.
fn strip_defaults<'s>(rules: &Rules<'s>, schema: &'s Json, json: &mut Json) {
    // Nothing is inside of a plain value.
    if !json.is_object() && !json.is_array() {
        return;
    }
    let (schema, alternatives) = rules.shape(schema);
    if let (Json::Array(items), Some(schema @ Json::Object(_))) = (&mut *json, schema.get("items")) {
        return items.iter_mut().for_each(|item| strip_defaults(rules, schema, item));
    }
    if let Some(chosen) = alternatives.iter().find(|alternative| is_of(alternative, json)) {
        return strip_defaults(rules, chosen, json);
    }
    let properties = schema.get("properties").and_then(Json::as_object);
    let Json::Object(fields) = json else { return };
    // A map with names of the writer's own has one schema for all its values.
    let others = schema.get("additionalProperties").filter(|others| others.is_object());
    if let (None, Some(others)) = (properties, others) {
        return fields.values_mut().for_each(|value| strip_defaults(rules, others, value));
    }
    let Some(properties) = properties else { return };
    fields.retain(|name, value| {
        let schema = properties.get(name);
        let default = schema.and_then(|schema| schema.get("default"));
        let is_default = value.is_null() || default.is_some_and(|default| are_same(default, value));
        if let (Some(schema), false) = (schema, is_default) {
            strip_defaults(rules, schema, value);
        }
        !is_default
    });
}

/// Whether a value is of this alternative of a choice: a list, or a map whose one required key says so.
fn is_of(alternative: &Json, json: &Json) -> bool {
    match json {
        Json::Array(_) => alternative.get("items").is_some_and(Json::is_object),
        Json::Object(fields) => {
            let Some(properties) = alternative.get("properties").and_then(Json::as_object) else { return false };
            let required: Vec<&str> =
                alternative.get("required").and_then(Json::as_array).into_iter().flatten().filter_map(Json::as_str).collect();
            required.iter().all(|name| fields.contains_key(*name)) && fields.keys().all(|name| properties.contains_key(name))
        }
        _ => false,
    }
}

/// Whether two values have one canonical form.
fn are_same(a: &Json, b: &Json) -> bool {
    match (a, b) {
        (Json::Number(a), Json::Number(b)) => a == b || one_form(a.clone()) == one_form(b.clone()),
        (Json::Array(a), Json::Array(b)) => a.len() == b.len() && a.iter().zip(b).all(|(a, b)| are_same(a, b)),
        (Json::Object(a), Json::Object(b)) => a.len() == b.len() && a.iter().all(|(name, a)| b.get(name).is_some_and(|b| are_same(a, b))),
        _ => a == b,
    }
}

/// Keys in order and numbers in their one form, at any depth.
pub fn sorted(json: Json) -> Json {
    match json {
        Json::Object(fields) => {
            let mut entries: Vec<(String, Json)> = fields.into_iter().map(|(name, value)| (name, sorted(value))).collect();
            entries.sort_by(|a, b| a.0.cmp(&b.0));
            Json::Object(entries.into_iter().collect::<Map<_, _>>())
        }
        Json::Array(items) => Json::Array(items.into_iter().map(sorted).collect()),
        Json::Number(number) => one_form(number),
        other => other,
    }
}

/// 1.0 and 1 are one value.
fn one_form(number: Number) -> Json {
    match number.as_f64() {
        Some(value) if number.is_f64() => match Scalar::from_number(value) {
            Scalar::Integer(whole) => i64::try_from(whole).map_or(Json::Number(number), |whole| json!(whole)),
            _ => Json::Number(number),
        },
        _ => Json::Number(number),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn defaults_inside_lists_choices_and_named_entries_do_not_matter() {
        let shape = json!({ "properties": { "radius": { "default": 1 }, "center": {} } });
        let choice = json!({ "oneOf": [
            { "type": "string", "const": "none" },
            { "type": "object", "properties": { "sphere": shape }, "required": ["sphere"] },
            { "type": "object", "properties": { "other": {} }, "required": ["other"] },
        ] });
        let schema = json!({ "properties": {
            "list": { "items": choice },
            "named": { "additionalProperties": choice },
        } });
        let sphere = json!({ "sphere": { "radius": 1.0, "center": 2 } });
        let parameters = json!({ "list": [sphere, "none", { "other": { "radius": 1 } }], "named": { "a": sphere } });
        let found = canonical(&Rules::new("kind", &schema), parameters, &[]).to_string();
        assert_eq!(found, r#"{"list":[{"sphere":{"center":2}},"none",{"other":{"radius":1}}],"named":{"a":{"sphere":{"center":2}}}}"#);
    }

    #[test]
    fn defaults_ports_and_the_form_of_numbers_do_not_matter() {
        let schema = json!({ "properties": { "of": {}, "b": { "default": 2.0 }, "a": {}, "none": {}, "path": {} } });
        let path = |name: &str| FieldPath::parse(name);
        let (of, file) = (path("of"), path("path"));
        let replaced = [
            Replaced { path: &of, role: &Role::Port(Vec::new().into()), instead: None },
            Replaced { path: &file, role: &Role::File, instead: Some(json!({ "file": "path" })) },
        ];
        let parameters = json!({ "path": "/x/y.pfm", "of": "env", "none": null, "b": 2, "a": { "z": 1.0, "c": [0.5] } });
        let canonical = canonical(&Rules::new("kind", &schema), parameters, &replaced);
        assert_eq!(canonical.to_string(), r#"{"a":{"c":[0.5],"z":1},"path":{"file":"path"}}"#);
    }
}

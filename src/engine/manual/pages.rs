//! The manual as pages of Markdown: the reference part of the book, written by `pipeline man --format markdown`.
//!
//! One page for the kinds, one for each parameter block that may stand in a file of its own (scenes), one for the fields of a
//! pipeline file, one for manifests. A test holds the pages in `docs/reference` against these.

use std::fmt::Write;

use schemars::JsonSchema;
use schemars::generate::SchemaSettings;
use serde_json::Value as Json;

use super::editor;
use super::entries::{Entry, Within, about_and_example, definition_name, description, entries, first_sentence, gives, has_fields};
use crate::engine::manifest::{Manifest, ShortManifest};
use crate::engine::registry::{Kind, Registry};
use crate::engine::schema::{alternatives, expected, resolved};

/// What stands first in every page.
pub const GENERATED: &str = "<!-- Written by `pipeline man --format markdown --dir docs/reference`. -->\n";

/// A page of the reference.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Page {
    /// Name of the file, without its extension.
    pub name: String,
    /// Its text.
    pub text: String,
}

/// All pages about what stands in files.
pub fn pages(registry: &Registry) -> Vec<Page> {
    let sections = registry.kinds().iter().flat_map(|(_, kind)| section_pages(kind));
    let page = |name: &str, text: String| Page { name: name.to_owned(), text: format!("{GENERATED}\n{text}") };
    let sections: Vec<Page> = sections.map(|(name, text)| page(&name, text)).collect();
    let mut pages = vec![page("kinds", kinds_page(registry)), page("file", file_page(registry)), page("manifest", manifest_page())];
    pages.extend(sections);
    pages
}

fn kinds_page(registry: &Registry) -> String {
    let mut text = String::from(
        "# Kinds of stages\n\nA stage of a pipeline file has one of these kinds; its parameters stand below the kind's name. \
         `pipeline stages KIND` shows the same on the terminal.\n\n| kind | gives | |\n| --- | --- | --- |\n",
    );
    for (name, kind) in registry.kinds().iter() {
        writeln!(text, "| [`{name}`](#{name}) | {} | {} |", gives(kind), prose(&first_sentence(kind.schema())))
            .expect("writing to a String");
    }
    text += "\nWhat a stage gives can be published in these formats (`save:`):\n\n| type | formats |\n| --- | --- |\n";
    for (name, artifact) in registry.artifacts().iter() {
        let formats: Vec<String> = artifact.formats.iter().map(|format| format!("`{format}`")).collect();
        writeln!(text, "| {name} | {} |", formats.join(", ")).expect("writing to a String");
    }
    registry.kinds().iter().for_each(|(_, kind)| push_kind(kind, &mut text));
    text
}

fn push_kind(kind: &Kind, text: &mut String) {
    let (about, example) = about_and_example(kind.schema());
    writeln!(text, "\n## {}\n\n{}\n", kind.name, prose(about)).expect("writing to a String");
    if let Some(example) = example {
        writeln!(text, "```yaml\n{example}\n```\n").expect("writing to a String");
    }
    writeln!(text, "Gives {}. Version {}.\n", gives(kind), kind.version).expect("writing to a String");
    for entry in entries(kind.schema(), kind.schema(), Within::here()) {
        match section_of(kind, &entry.name) {
            Some(_) => push_entry(&Entry { inner: Vec::new(), ..entry.clone() }, 0, &format!(" [All of it]({}.md).", entry.name), text),
            None => push_entry(&entry, 0, "", text),
        }
    }
}

/// The schema within a parameter that may stand in a file of its own.
fn section_of<'k>(kind: &'k Kind, parameter: &str) -> Option<&'k Json> {
    let field = resolved(kind.schema(), kind.schema().get("properties")?.get(parameter)?);
    let choices = ["anyOf", "allOf"].iter().filter_map(|key| field.get(key)?.as_array()).flatten();
    let section = std::iter::once(field).chain(choices).find(|schema| schema.get("x-section").is_some())?;
    section.get("anyOf")?.get(0)
}

fn section_pages(kind: &Kind) -> Vec<(String, String)> {
    let names = kind.schema().get("properties").and_then(Json::as_object).into_iter().flat_map(|fields| fields.keys());
    let page = |name: &String| {
        let section = section_of(kind, name)?;
        let mut text = format!(
            "# The `{name}` of `{}`\n\nStands below `{name}:` in a pipeline file, or in a YAML file of its own that `{name}: FILE` names.\n",
            kind.name
        );
        push_definitions(kind.schema(), section, &mut text);
        Some((name.clone(), text))
    };
    names.filter_map(page).collect()
}

/// A definition and all to which it refers, each once, in the order in which they are first met.
fn push_definitions(root: &Json, first: &Json, text: &mut String) {
    let mut waiting = vec![String::new()];
    let mut index = 0;
    while let Some(name) = waiting.get(index).cloned() {
        let schema = if name.is_empty() { resolved(root, first) } else { resolved(root, &root["definitions"][&name]) };
        for met in push_definition(root, &name, schema, text) {
            if !waiting.contains(&met) {
                waiting.push(met);
            }
        }
        index += 1;
    }
}

/// Writes a definition; gives the names to which it refers.
fn push_definition(root: &Json, name: &str, schema: &Json, text: &mut String) -> Vec<String> {
    if !name.is_empty() {
        writeln!(text, "\n## {}", title(name)).expect("writing to a String");
    }
    if let Some(about) = description(schema) {
        writeln!(text, "\n{}", prose(about)).expect("writing to a String");
    }
    let mut met = Vec::new();
    let (families, choices) = families_and_choices(root, schema);
    for family in &families {
        writeln!(text, "\nOne of [{}](#{}).", title(family), anchor(&title(family))).expect("writing to a String");
    }
    let has_own = schema.get("properties").is_some() || (choices.is_empty() && families.is_empty());
    met.extend(families);
    if has_own {
        text.push('\n');
        push_entries(&entries(root, schema, Within::Elsewhere), text, &mut met);
    }
    for choice in choices {
        push_choice(root, name, choice, text, &mut met);
    }
    met
}

/// What a schema gives to choose from: families that have a definition of their own, by name, and single kinds.
fn families_and_choices<'s>(root: &'s Json, schema: &'s Json) -> (Vec<String>, Vec<&'s Json>) {
    let listed = ["anyOf", "oneOf"].iter().find_map(|key| schema.get(key)?.as_array()).into_iter().flatten();
    let (mut families, mut choices) = (Vec::new(), Vec::new());
    for choice in listed {
        match definition_name(choice) {
            Some(name) if !alternatives(root, choice).is_empty() && has_fields(root, choice) => families.push(name.to_owned()),
            _ if alternatives(root, choice).is_empty() => choices.push(resolved(root, choice)),
            _ => choices.extend(alternatives(root, choice)),
        }
    }
    choices.retain(|choice| has_fields(root, choice));
    (families, choices)
}

/// One kind of a family: `{ sphere: { … } }`; or a block of parameters that may stand there.
fn push_choice(root: &Json, family: &str, choice: &Json, text: &mut String, met: &mut Vec<String>) {
    let fields: Vec<(&String, &Json)> = choice.get("properties").and_then(Json::as_object).into_iter().flatten().collect();
    let [(kind, parameters)] = fields[..] else {
        let about = description(choice).map(|about| format!("{}\n\n", prose(about))).unwrap_or_default();
        write!(text, "\n{about}").expect("writing to a String");
        return push_entries(&entries(root, choice, Within::Elsewhere), text, met);
    };
    writeln!(text, "\n### {} `{kind}`\n", title(family)).expect("writing to a String");
    let parameters = resolved(root, parameters);
    if let Some(about) = description(choice).or_else(|| description(parameters)) {
        writeln!(text, "{}\n", prose(about)).expect("writing to a String");
    }
    if has_fields(root, parameters) {
        push_entries(&entries(root, parameters, Within::Elsewhere), text, met);
    } else {
        writeln!(text, "Takes {}.", expected(root, parameters)).expect("writing to a String");
    }
}

fn push_entries(entries: &[Entry], text: &mut String, met: &mut Vec<String>) {
    for entry in entries {
        let links: Vec<String> = entry.elsewhere.iter().map(|name| format!("[{}](#{})", title(name), anchor(&title(name)))).collect();
        let see = if links.is_empty() { String::new() } else { format!(" See {}.", links.join(", ")) };
        push_entry(entry, 0, &see, text);
        met.extend(entry.elsewhere.iter().cloned());
        entry.inner.iter().for_each(|inner| met.extend(inner.elsewhere.iter().cloned()));
    }
}

/// An entry as an item of a list; `see` follows the facts.
fn push_entry(entry: &Entry, depth: usize, see: &str, text: &mut String) {
    let indent = "  ".repeat(depth);
    writeln!(text, "{indent}- **`{}`**: {}.{see}", entry.name, prose(&entry.facts)).expect("writing to a String");
    for line in prose(&entry.about).lines() {
        let line = if line.is_empty() { String::new() } else { format!("{indent}  {line}") };
        writeln!(text, "{line}").expect("writing to a String");
    }
    for (word, about) in &entry.choices {
        writeln!(text, "{indent}  - `{word}`: {}", prose(about)).expect("writing to a String");
    }
    entry.inner.iter().for_each(|inner| push_entry(inner, depth + 1, "", text));
}

/// The fields of a pipeline file, but for the parameters of kinds.
fn file_page(registry: &Registry) -> String {
    let schema = editor::schema(registry);
    let mut text = String::from(
        "# The fields of a pipeline file\n\n[The language](../language.md) tells what they mean together. \
         `pipeline schema` prints the JSON Schema of all of it, for editors.\n\n",
    );
    let shallow = |schema_of: &Json| entries(&schema, schema_of, Within::Here(0));
    shallow(&schema).iter().for_each(|entry| push_entry(entry, 0, "", &mut text));
    text += "\n## An axis\n\nA list of values or of maps of values, or one of:\n\n";
    for form in alternatives(&schema, &schema["definitions"]["axis"]) {
        shallow(form).iter().for_each(|entry| push_entry(entry, 0, "", &mut text));
    }
    text += "\n## A stage\n\nOne of the [kinds](kinds.md), and:\n\n";
    let is_kind = |entry: &&Entry| registry.kinds().find(&entry.name).is_some();
    shallow(&schema["definitions"]["stage"]).iter().filter(|entry| !is_kind(entry)).for_each(|entry| push_entry(entry, 0, "", &mut text));
    text
}

fn manifest_page() -> String {
    let mut text = String::from(
        "# The manifest\n\n`outputs/NAME/manifest.json`, and `outputs/NAME/runs/RUN_ID/manifest.json` of each run. \
         [Where results come from](../provenance.md) tells how to ask it questions. `pipeline schema manifest` prints its JSON \
         Schema. A field that is optional is left out where it would be empty.\n",
    );
    push_definitions(&manifest_schema(), &manifest_schema(), &mut text);
    text
}

/// The JSON Schema of a manifest: of a run that changed something, or of one that did not.
pub fn manifest_schema() -> Json {
    SchemaSettings::draft07().into_generator().into_root_schema_for::<AnyManifest>().into()
}

/// The record of a run.
#[derive(JsonSchema)]
#[serde(untagged)]
#[expect(dead_code, reason = "stands for its schema alone")]
enum AnyManifest {
    Whole(Box<Manifest>),
    Short(Box<ShortManifest>),
}

/// The name of a definition as a heading: `RoughConductorParameters` is `Rough conductor`.
fn title(name: &str) -> String {
    let plain = ["Description", "Parameters", "Entry"].iter().fold(name, |name, suffix| name.strip_suffix(suffix).unwrap_or(name));
    let mut title = String::new();
    for (index, letter) in plain.chars().enumerate() {
        match letter {
            '_' | '<' | '>' => title.push(' '),
            _ if index > 0 && letter.is_ascii_uppercase() => title.extend([' ', letter.to_ascii_lowercase()]),
            _ => title.push(letter),
        }
    }
    title
}

/// Where a heading is found on its page.
fn anchor(heading: &str) -> String {
    heading.to_lowercase().replace(' ', "-")
}

/// A description as Markdown: what stands outside of backticks means nothing but itself.
fn prose(text: &str) -> String {
    let mut is_code = false;
    let mut safe = String::with_capacity(text.len());
    for letter in text.chars() {
        match letter {
            '`' => is_code = !is_code,
            '<' if !is_code => {
                safe += "&lt;";
                continue;
            }
            '*' | '|' if !is_code => safe.push('\\'),
            _ => {}
        }
        safe.push(letter);
    }
    safe
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn headings_are_words() {
        assert_eq!(title("RoughConductorParameters"), "Rough conductor");
        assert_eq!(anchor(&title("JobMeasured")), "job-measured");
    }

    #[test]
    fn only_code_keeps_its_signs() {
        assert_eq!(prose("a * b < `c * d < e`"), "a \\* b &lt; `c * d < e`");
    }
}

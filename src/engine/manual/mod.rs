//! The manual of the kinds, from the definitions that read the parameters: what cannot be wrong about them.
//!
//! Pure functions of the registry: what `pipeline stages` prints (here), the schema for editors (`editor`) and the
//! reference pages of the book (`pages`); `entries` is what these have in common.

mod editor;
mod entries;
mod pages;

use std::fmt::Write;

pub use editor::schema;
use entries::{Entry, Within, about_and_example, entries, first_sentence, gives};
pub use pages::{GENERATED, Page, manifest_schema, pages};

use super::diagnostic::quoted;
use super::registry::Registry;
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

/// One kind with an example and every parameter; the error names the nearest kind.
pub fn kind(registry: &Registry, name: &str) -> Result<String, String> {
    let Some(kind) = registry.kinds().find(name) else {
        let hint = did_you_mean(nearest(name, registry.kinds().names())).map(|hint| format!("; {hint}")).unwrap_or_default();
        return Err(format!("there is no kind {}{hint}", quoted(name)));
    };
    let (about, example) = about_and_example(kind.schema());
    let mut text = format!("{}\n\n", kind.name);
    if !about.is_empty() {
        text += &format!("{}\n\n", indented(about, "  "));
    }
    text += &format!("Gives {}. Version {}.\n", gives(kind), kind.version);
    if let Some(example) = example {
        text += &format!("\nExample, below `stages:`\n\n{}\n", indented(example, "  "));
    }
    let parameters = entries(kind.schema(), kind.schema(), Within::here());
    if !parameters.is_empty() {
        text += "\nParameters:\n";
        parameters.iter().for_each(|entry| push_entry(entry, 1, &mut text));
    }
    Ok(text)
}

/// Text with every line indented; lines of one paragraph stay as they were broken.
fn indented(text: &str, indent: &str) -> String {
    let lines = text.lines().map(|line| if line.is_empty() { String::new() } else { format!("{indent}{line}") });
    lines.collect::<Vec<_>>().join("\n")
}

fn push_entry(entry: &Entry, depth: usize, text: &mut String) {
    let indent = "  ".repeat(depth);
    writeln!(text, "\n{indent}{}: {}", entry.name, entry.facts).expect("writing to a String");
    if !entry.about.is_empty() {
        writeln!(text, "{}", indented(&entry.about, &format!("{indent}    "))).expect("writing to a String");
    }
    for (word, about) in &entry.choices {
        writeln!(text, "{indent}    - {word}: {about}").expect("writing to a String");
    }
    entry.inner.iter().for_each(|inner| push_entry(inner, depth + 1, text));
}

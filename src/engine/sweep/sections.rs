//! Sections: parameters that stand in a file of their own are put where the file's path is written.
//!
//! Done once for the whole document, before anything is substituted or checked, so that a section is like text of the
//! pipeline file: it may use parameters and axes, its mistakes have its own lines, and its paths are relative to it. A
//! registry may have other languages than YAML for it, by the ending of the file's name.

use std::collections::HashMap;
use std::path::PathBuf;

use serde_json::Value as Json;

use crate::engine::axes::Axis;
use crate::engine::diagnostic::quoted;
use crate::engine::document::Document;
use crate::engine::registry::Registry;
use crate::engine::source::{Finding, Findings, Sources};
use crate::engine::substitution::{Scope, Template, substitute};
use crate::engine::yaml::{Entry, Node, Value};

/// Replaces every path of a section by what its file says; a stage that cannot have its section is left out.
pub fn put_in(registry: &Registry, document: &mut Document<'_>, axes: &[Axis], sources: &mut Sources, findings: &mut Findings) {
    let scope = Scope::new(&document.params, axes);
    let mut reader = Reader { registry, sources, findings, read: HashMap::new() };
    for stage in &mut document.stages {
        let (Some(kind), Value::Map(entries)) = (stage.kind, &stage.parameters.value) else { continue };
        let put_in = |entry: &Entry| match &entry.node.value {
            Value::Text(_) if is_section(kind.schema(), &entry.key) => {
                reader.section(&entry.node, &scope, &stage.name).map(|node| Entry { node, ..entry.clone() })
            }
            _ => Some(entry.clone()),
        };
        match entries.iter().map(put_in).collect::<Option<Vec<Entry>>>() {
            Some(entries) => stage.parameters.value = Value::Map(entries.into()),
            None => stage.kind = None,
        }
    }
}

fn is_section(schema: &Json, field: &str) -> bool {
    schema.get("properties").and_then(|fields| fields.get(field)?.get("x-section")).is_some()
}

struct Reader<'a> {
    registry: &'a Registry,
    sources: &'a mut Sources,
    findings: &'a mut Findings,
    /// What each file says; `None` where it is wrong, which was reported.
    read: HashMap<PathBuf, Option<Node>>,
}

impl Reader<'_> {
    /// The content of the file that a field names.
    fn section(&mut self, node: &Node, scope: &Scope<'_>, stage: &str) -> Option<Node> {
        let error_count = self.findings.error_count();
        let named = match substitute(node, scope, stage, self.findings) {
            Template::Fixed(named) => named,
            _ => {
                let message = "a file of parameters is named by a path or a parameter, not by an axis";
                let hint = Some("give each file a stage of its own, or write the parameters here".to_owned());
                self.findings.add(Finding::error(node.place, message).in_stage(stage).with_hint(hint));
                return None;
            }
        };
        if self.findings.error_count() > error_count {
            return None;
        }
        // A parameter may hold the section itself; it is put in where all parameters are.
        let Some(text) = named.text() else { return Some(node.clone()) };
        let path = self.sources.get(named.place.file).folder.join(text);
        if let Some(known) = self.read.get(&path) {
            return known.clone();
        }
        let content = self.content(&path, text, &named, stage);
        self.read.insert(path, content.clone());
        content
    }

    fn content(&mut self, path: &std::path::Path, text: &str, named: &Node, stage: &str) -> Option<Node> {
        let subject = format!("file {}", quoted(text));
        let read = if text.is_empty() || text.contains('\0') { None } else { Some(self.sources.read_text(path)) };
        let content = match read {
            Some(Ok(content)) => content,
            Some(Err(error)) => {
                let position = error.position.map(|(line, column)| format!("line {line}, column {column}: ")).unwrap_or_default();
                self.findings.add(Finding::error(named.place, format!("{subject}: {position}{}", error.message)).in_stage(stage));
                return None;
            }
            None => {
                self.findings.add(Finding::error(named.place, format!("{subject}: no such file")).in_stage(stage));
                return None;
            }
        };
        let index = self.sources.add_file(path, String::new());
        let node = self.registry.dialect(path)(index, &content, self.findings);
        self.sources.text_mut(index).text = content;
        let node = node?;
        if node.map().is_none() {
            let message = format!("the file must hold a map of parameters, found {}", node.described());
            self.findings.add(Finding::error(node.place, message).in_stage(stage));
            return None;
        }
        Some(node)
    }
}

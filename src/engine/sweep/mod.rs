//! From a document to the graph: every stage checked, every reference resolved, every job laid out.
//!
//! Reading order: `sections` (parameters in files of their own), `draft` (one stage by itself), `resolve` (references, order, axes), `typing` (what flows),
//! `expand` (jobs). Each step collects its mistakes; nothing is expanded while there are any. Looks at
//! the world only to see whether input files can be read.

mod draft;
mod expand;
mod resolve;
mod sections;
#[cfg(test)]
mod tests;
mod typing;

use std::cell::RefCell;
use std::collections::{BTreeMap, HashMap};
use std::rc::Rc;

use self::draft::{Draft, FileCheck};
use super::axes::{self, Axis};
use super::diagnostic::{Diagnostic, quoted};
use super::document::{self, Document};
use super::graph::Graph;
use super::reference::Selection;
use super::registry::{Kind, Registry};
use super::request::{self, InputPlace, RecordedInput, Request};
use super::schema::Rules;
use super::source::{Finding, Findings, Place, Sources, did_you_mean};
use super::substitution::Scope;
use crate::catalogue::nearest;

/// Reads, checks and lays out a pipeline: the graph with warnings, or every mistake.
pub fn build(registry: &Registry, request: &Request) -> Result<(Graph, Vec<Diagnostic>), Vec<Diagnostic>> {
    build_beside(registry, request, |_| ()).map(|(graph, warnings, ())| (graph, warnings))
}

/// The same, with what is begun as soon as the name of the pipeline is known.
pub fn build_beside<T>(
    registry: &Registry,
    request: &Request,
    begin: impl FnOnce(&str) -> T,
) -> Result<(Graph, Vec<Diagnostic>, T), Vec<Diagnostic>> {
    let mut sources = Sources::given(request.texts.clone());
    let mut findings = Findings::default();
    let built = built(registry, request, &mut sources, &mut findings, begin);
    let (errors, warnings) = sources.diagnostics(findings);
    match built {
        Some((graph, begun)) if errors.is_empty() => Ok((Graph { has_warnings: !warnings.is_empty(), ..graph }, warnings, begun)),
        _ => Err(errors),
    }
}

fn built<T>(
    registry: &Registry,
    request: &Request,
    sources: &mut Sources,
    findings: &mut Findings,
    begin: impl FnOnce(&str) -> T,
) -> Option<(Graph, T)> {
    let mut document = document::read(registry, &request.file, sources, findings)?;
    let begun = begin(&document.pipeline);
    request::apply(request, &mut document, sources, findings);
    let targets = expand::Targets::read(request, sources, findings);
    let limit = request.max_jobs.max(request::JOB_LIMIT);
    let read = |entry: &super::yaml::Entry, findings: &mut Findings| {
        axes::read(&entry.key, entry.place, &entry.node, limit, findings).unwrap_or_else(|| unread_axis(entry))
    };
    let axes: Vec<Axis> = document.axes.iter().map(|entry| read(entry, findings)).collect();
    warn_of_references_in_parameters(&document, &axes, findings);
    sections::put_in(registry, &mut document, &axes, sources, findings);
    let (limit, inputs) = (request.max_jobs, request.inputs.as_ref());
    let world = World { registry, document, axes, sources, limit, inputs, rules: RefCell::default() };
    let drafts = drafts(&world, findings);
    let resolved = resolve::resolve(&world, &drafts, findings);
    let typed = typing::decide(&world, &drafts, &resolved, findings);
    let targets = targets.resolved(&world, &resolved, findings);
    if findings.error_count() > 0 {
        return None;
    }
    let graph = expand::expand(&world, drafts, resolved, typed, targets, request, findings)?;
    if let Some(text) = request.seed.as_ref().filter(|_| graph.jobs.iter().all(|job| job.seed.is_none() || job.has_own_seed)) {
        let message = "no stage draws with it: those that draw set a `seed` of their own";
        let hint = "for other samples change the values of that `seed`, as by `-a AXIS=…` where it is an axis".to_owned();
        let place = Place::of_file(sources.add_argument("--seed", text));
        findings.add(Finding::warning(place, message).with_hint(Some(hint)));
    }
    Some((graph, begun))
}

/// What all steps read.
struct World<'r, 'a> {
    registry: &'r Registry,
    document: Document<'r>,
    axes: Vec<Axis>,
    sources: &'a Sources,
    /// Most jobs.
    limit: u64,
    /// By name of the kind.
    rules: RefCell<HashMap<&'static str, Rc<Rules<'r>>>>,
    /// See [`Request::inputs`].
    inputs: Option<&'a BTreeMap<InputPlace, RecordedInput>>,
}

impl<'r> World<'r, '_> {
    /// What the parameters of a kind must be.
    fn rules(&self, kind: &'r Kind) -> Rc<Rules<'r>> {
        self.rules.borrow_mut().entry(kind.name).or_insert_with(|| Rc::new(Rules::new(kind.name, kind.schema()))).clone()
    }

    /// The name of a stage.
    fn name(&self, stage: usize) -> &str {
        &self.document.stages[stage].name
    }

    /// The index of each stage by its name.
    fn stage_indices(&self) -> HashMap<&str, usize> {
        self.document.stages.iter().enumerate().map(|(index, entry)| (entry.name.as_str(), index)).collect()
    }

    /// The index of an axis and of the values that a selection names; the error has a hint.
    fn selected(&self, selection: &Selection) -> Result<(usize, Vec<u32>), (String, Option<String>)> {
        let axis = self.axis_index(&selection.axis)?;
        let values = selection.values.iter().map(|text| self.value_index(axis, text)).collect::<Result<_, _>>()?;
        Ok((axis, values))
    }

    fn axis_index(&self, name: &str) -> Result<usize, (String, Option<String>)> {
        self.axes.iter().position(|axis| axis.name == name).ok_or_else(|| {
            let hint = did_you_mean(nearest(name, self.axes.iter().map(|axis| axis.name.as_str())));
            (format!("there is no axis {}", quoted(name)), hint)
        })
    }

    fn value_index(&self, axis: usize, text: &str) -> Result<u32, (String, Option<String>)> {
        let axis = &self.axes[axis];
        axis.index_of(text).map(|index| index as u32).ok_or_else(|| {
            let hint = Some(format!("its values are {}", axis.values_listed()));
            (format!("axis {} has no value {}", quoted(&axis.name), quoted(text)), hint)
        })
    }
}

/// A stand-in for an axis that cannot be read, so that what mentions it is not reported as well.
fn unread_axis(entry: &super::yaml::Entry) -> Axis {
    Axis { name: entry.key.to_string(), place: entry.place, values: Vec::new() }
}

fn drafts<'r>(world: &World<'r, '_>, findings: &mut Findings) -> Vec<Option<Draft<'r>>> {
    let scope = Scope::new(&world.document.params, &world.axes);
    let mut files = FileCheck::default();
    (0..world.document.stages.len()).map(|stage| draft::draft(world, &scope, stage, &mut files, findings)).collect()
}

/// A parameter does not refer to another one; what looks like it is taken as text, which is worth a warning.
fn warn_of_references_in_parameters(document: &Document<'_>, axes: &[Axis], findings: &mut Findings) {
    let is_known = |name: &str| document.params.iter().any(|entry| &*entry.key == name) || axes.iter().any(|axis| axis.name == name);
    for entry in &document.params {
        let Some(text) = entry.node.text() else { continue };
        let name = text.strip_prefix("${").and_then(|rest| rest.strip_suffix('}')).or_else(|| text.strip_prefix('$'));
        if name.is_some_and(is_known) {
            let message = format!("parameter {} is the text {}: parameters do not refer to each other", quoted(&entry.key), quoted(text));
            findings.add(Finding::warning(entry.node.place, message));
        }
    }
}

//! What the command line asks of a pipeline: other parameters, axes and seed, and which stages.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;

use serde_json::{Map, Value as Json, json};

use super::coordinate::Coordinate;
use super::diagnostic::quoted;
use super::document::Document;
use super::manifest::coordinate_text;
use super::source::{Finding, Findings, Place, Sources, Texts, did_you_mean};
use super::yaml::{Entry, Node, Value, parse, plain};
use crate::catalogue::nearest;

/// Most jobs of a pipeline unless the command line allows more.
pub const JOB_LIMIT: u64 = 100_000;

/// What is asked of a pipeline.
#[derive(Debug, Clone)]
pub struct Request {
    /// The pipeline file.
    pub file: PathBuf,
    /// `-s name=value`: names and texts.
    pub parameters: Vec<(String, String)>,
    /// `-a axis=value,value`: names and texts.
    pub axes: Vec<(String, String)>,
    /// `--seed`: the seed of stages that set none, as text.
    pub seed: Option<String>,
    /// `--only`: references to the stages that are wanted; all if empty.
    pub only: Vec<String>,
    /// `--force`: references to the stages that run even if the store has their results.
    pub force: Vec<String>,
    /// Most jobs.
    pub max_jobs: u64,
    /// The texts of the pipeline's files, where they are not to be read from the disk. The same text says the same.
    pub texts: Option<Arc<Texts>>,
    /// Where the input files of a recorded run lie now; what the pipeline's text says of their paths does not count then.
    pub inputs: Option<BTreeMap<InputPlace, RecordedInput>>,
}

/// A file parameter of a job.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct InputPlace {
    stage: String,
    coordinate: String,
    parameter: String,
}

impl InputPlace {
    /// The place of a recorded job.
    pub fn of(stage: &str, coordinate: &Json, parameter: &str) -> Self {
        Self { stage: stage.to_owned(), coordinate: coordinate_text(coordinate), parameter: parameter.to_owned() }
    }

    /// The place of a job of a graph.
    pub fn at(stage: &str, coordinate: &Coordinate, parameter: &str) -> Self {
        Self { stage: stage.to_owned(), coordinate: coordinate.to_string(), parameter: parameter.to_owned() }
    }
}

/// An input file of a recorded run.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RecordedInput {
    /// Its path as the manifest shows it.
    pub shown: String,
    /// Where it lies now.
    pub path: PathBuf,
}

impl Request {
    /// The whole pipeline as it stands in the file.
    pub fn of_file(file: impl Into<PathBuf>) -> Self {
        Self {
            file: file.into(),
            parameters: Vec::new(),
            axes: Vec::new(),
            seed: None,
            only: Vec::new(),
            force: Vec::new(),
            max_jobs: JOB_LIMIT,
            texts: None,
            inputs: None,
        }
    }

    /// All that was asked as one text: equal for equal requests from the same folder.
    pub fn identity(&self) -> String {
        let Self { file, parameters, axes, seed, only, force, max_jobs, texts: _, inputs } = self;
        let folder = std::env::current_dir().unwrap_or_default();
        format!("{:?}", (folder, file, parameters, axes, seed, only, force, max_jobs, inputs))
    }

    /// What was changed, for the manifest: `{ params, axes, seed }`, without what was not.
    pub fn overrides(&self) -> Json {
        let texts =
            |pairs: &[(String, String)]| -> Map<String, Json> { pairs.iter().map(|(name, text)| (name.clone(), json!(text))).collect() };
        let mut overrides = Map::new();
        if !self.parameters.is_empty() {
            overrides.insert("params".into(), texts(&self.parameters).into());
        }
        if !self.axes.is_empty() {
            overrides.insert("axes".into(), texts(&self.axes).into());
        }
        if let Some(seed) = &self.seed {
            overrides.insert("seed".into(), json!(seed));
        }
        overrides.into()
    }
}

/// Puts the values of the command line in the place of those of the file.
pub fn apply(request: &Request, document: &mut Document<'_>, sources: &mut Sources, findings: &mut Findings) {
    for (name, text) in &request.parameters {
        let file = sources.add_argument("-s", &format!("{name}={text}"));
        if let Err((message, hint)) = set_parameter(name, text, file, document, findings) {
            findings.add(Finding::error(Place::of_file(file), message).with_hint(hint));
        }
    }
    for (name, text) in &request.axes {
        let file = sources.add_argument("-a", &format!("{name}={text}"));
        if let Err((message, hint)) = set_axis(name, text, file, document, findings) {
            findings.add(Finding::error(Place::of_file(file), message).with_hint(hint));
        }
    }
    if let Some(text) = &request.seed {
        let file = sources.add_argument("--seed", text);
        match text.parse() {
            Ok(seed) => document.seed = seed,
            Err(_) => {
                let message = format!("the seed must be an integer from 0 to {}, found {}", u64::MAX, quoted(text));
                findings.add(Finding::error(Place::of_file(file), message));
            }
        }
    }
}

/// A message and a hint.
type Wrong = (String, Option<String>);

fn set_parameter(name: &str, text: &str, file: u32, document: &mut Document<'_>, findings: &mut Findings) -> Result<(), Wrong> {
    if document.axes.iter().any(|axis| &*axis.key == name) {
        return Err((
            format!("{} is an axis, not a parameter", quoted(name)),
            Some(format!("set its values with `-a {}=…`", super::diagnostic::shortened(name))),
        ));
    }
    let names = document.params.iter().map(|entry| &*entry.key);
    let Some(index) = document.params.iter().position(|entry| &*entry.key == name) else {
        let known: Vec<String> = names.clone().map(quoted).collect();
        let known = if known.is_empty() {
            "the pipeline has no parameters".into()
        } else {
            format!("the parameters are {}", super::diagnostic::listed(&known, "and"))
        };
        return Err((format!("unknown parameter {}", quoted(name)), did_you_mean(nearest(name, names)).or(Some(known))));
    };
    let place = Place::of_file(file);
    let is_text = document.params[index].node.text().is_some();
    let value = if is_text { Value::Text(text.into()) } else { value_of(text, file, findings) };
    document.params[index].node = Node::new(value, place);
    Ok(())
}

/// A value in YAML, its places all those of the argument.
fn value_of(text: &str, file: u32, findings: &mut Findings) -> Value {
    let mut own = Findings::default();
    match parse(file, text, &mut own).filter(|_| own.error_count() == 0) {
        Some(node) => placed(&node, Place::of_file(file)).value,
        None => {
            findings.add(Finding::error(Place::of_file(file), format!("the value {} is not YAML", quoted(text))));
            Value::Null
        }
    }
}

fn placed(node: &Node, place: Place) -> Node {
    let value = match &node.value {
        Value::List(items) => Value::List(items.iter().map(|item| placed(item, place)).collect()),
        Value::Map(entries) => {
            let moved = |entry: &Entry| Entry { key: entry.key.clone(), place, node: placed(&entry.node, place) };
            Value::Map(entries.iter().map(moved).collect())
        }
        value => value.clone(),
    };
    Node::new(value, place)
}

fn set_axis(name: &str, text: &str, file: u32, document: &mut Document<'_>, findings: &mut Findings) -> Result<(), Wrong> {
    let names = document.axes.iter().map(|entry| &*entry.key);
    let Some(index) = document.axes.iter().position(|entry| &*entry.key == name) else {
        if document.params.iter().any(|entry| &*entry.key == name) {
            return Err((
                format!("{} is a parameter, not an axis", quoted(name)),
                Some(format!("set it with `-s {}=…`", super::diagnostic::shortened(name))),
            ));
        }
        let known: Vec<String> = names.clone().map(quoted).collect();
        let known = if known.is_empty() {
            "the pipeline has no axes".into()
        } else {
            format!("the axes are {}", super::diagnostic::listed(&known, "and"))
        };
        return Err((format!("unknown axis {}", quoted(name)), did_you_mean(nearest(name, names)).or(Some(known))));
    };
    if text.trim().is_empty() {
        return Err((format!("axis {} is given no values", quoted(name)), Some(format!("write `-a {name}=value,value`"))));
    }
    let place = Place::of_file(file);
    let declared = document.axes[index].node.clone();
    let value = if text.trim_start().starts_with(['{', '[']) {
        value_of(text, file, findings)
    } else if declared.list().is_some_and(|items| items.iter().any(|item| item.map().is_some())) {
        Value::List(named_entries(&declared, name, text)?.into())
    } else {
        let is_text = declared.list().is_some_and(|items| items.iter().all(|item| item.text().is_some()));
        if let Some([from, to]) = range_of(text).filter(|_| !is_text) {
            let hint = format!("a range is written `-a '{name}={{ range: [{from}, {to}, 1] }}'`");
            return Err((format!("axis {} has no value {}", quoted(name), quoted(text)), Some(hint)));
        }
        let item = |word: &str| if is_text { Value::Text(word.into()) } else { plain(word) };
        Value::List(text.split(',').map(|word| Node::new(item(word.trim()), place)).collect())
    };
    document.axes[index].node = Node::new(value, place);
    document.axes[index].place = place;
    Ok(())
}

/// The two integers of `1..12` or `1-12`, which other programs take for a range.
fn range_of(text: &str) -> Option<[u64; 2]> {
    let (from, to) = text.trim().split_once("..").or_else(|| text.trim().split_once('-'))?;
    Some([from.trim().parse().ok()?, to.trim().trim_start_matches('=').parse().ok()?])
}

/// The entries of a map-valued axis that the command line names, by `name` or by index.
fn named_entries(declared: &Node, axis: &str, text: &str) -> Result<Vec<Node>, Wrong> {
    let items = declared.list().map(|items| &items[..]).unwrap_or_default();
    let name_of = |index: usize, item: &Node| {
        let name = item.map().and_then(|entries| super::yaml::entry(entries, "name"));
        name.and_then(|name| super::axes::scalar_of(&name.node)).map_or_else(|| (index + 1).to_string(), |name| name.to_string())
    };
    let names: Vec<String> = items.iter().enumerate().map(|(index, item)| name_of(index, item)).collect();
    let found = |word: &str| {
        let index = names.iter().position(|name| name == word).ok_or_else(|| {
            let known: Vec<String> = names.iter().map(|name| quoted(name)).collect();
            let hint = did_you_mean(nearest(word, names.iter().map(String::as_str)));
            let known = format!("its values are {}", super::diagnostic::listed(&known, "and"));
            (format!("axis {} has no value {}", quoted(axis), quoted(word)), hint.or(Some(known)))
        })?;
        // An entry without a name is called by its index, which must not change when others are left out.
        Ok(with_name(&items[index], &names[index]))
    };
    text.split(',').map(|word| found(word.trim())).collect()
}

fn with_name(item: &Node, name: &str) -> Node {
    let entries = item.map().map(|entries| entries.to_vec()).unwrap_or_default();
    if super::yaml::entry(&entries, "name").is_some() {
        return item.clone();
    }
    let name = Entry { key: "name".into(), place: item.place, node: Node::new(plain(name), item.place) };
    Node { value: Value::Map(entries.into_iter().chain([name]).collect()), ..item.clone() }
}

//! The text of a pipeline as a document: its files put together, every key known, every kind found.
//!
//! What the parameters of a stage mean is not looked at here; see `sweep`.

use std::collections::HashMap;
use std::num::NonZeroU32;
use std::path::{Path, PathBuf};

use super::diagnostic::quoted;
use super::reference::is_stage_name;
use super::registry::{Kind, Registry};
use super::resources::{self, Resources};
use super::source::{Finding, Findings, Place, Sources, did_you_mean, without_dots};
use super::substitution::is_name;
use super::yaml::{Entry, Node, Value, parse};
use crate::catalogue::nearest;

/// A pipeline's text, put together from its files.
pub struct Document<'r> {
    /// Its name.
    pub pipeline: String,
    /// The seed of stages that set none.
    pub seed: u64,
    /// Parameters, in order.
    pub params: Vec<Entry>,
    /// Axes, in order of declaration, not yet read.
    pub axes: Vec<Entry>,
    /// Stages, in order.
    pub stages: Vec<StageEntry<'r>>,
    /// The whole first file.
    pub place: Place,
}

/// One entry of `stages:`.
pub struct StageEntry<'r> {
    /// Its name.
    pub name: String,
    /// Where its name stands.
    pub place: Place,
    /// Its kind; `None` where that is unknown, which was reported.
    pub kind: Option<&'r Kind>,
    /// Its parameters, a map.
    pub parameters: Node,
    /// The value of `save:`.
    pub save: Option<Node>,
    /// The value of `exclude:`.
    pub exclude: Option<Node>,
    /// The text of `about:`.
    pub about: Option<String>,
    /// What `resources:` asks for.
    pub resources: Resources,
    /// The number of `split:`.
    pub split: Option<NonZeroU32>,
}

const TOP_KEYS: [&str; 7] = ["version", "pipeline", "seed", "params", "axes", "stages", "include"];
/// Keys of an included file.
const INCLUDED_KEYS: [&str; 5] = ["version", "params", "axes", "stages", "include"];
const STAGE_KEYS: [&str; 5] = ["save", "exclude", "about", "resources", "split"];
/// Most parts of a job.
pub const PART_LIMIT: u32 = 1024;
/// Deepest chain of includes.
const INCLUDE_LIMIT: usize = 128;

/// Reads a pipeline file and what it includes. `None` where nothing can be said beyond the findings.
pub fn read<'r>(registry: &'r Registry, file: &Path, sources: &mut Sources, findings: &mut Findings) -> Option<Document<'r>> {
    let mut reader = Reader { registry, sources, findings, root: PathBuf::new(), read: Vec::new(), merged: Merged::default() };
    reader.first_file(file)
}

/// What all files have declared so far, with the names that are taken.
#[derive(Default)]
struct Merged<'r> {
    params: Vec<Entry>,
    axes: Vec<Entry>,
    stages: Vec<StageEntry<'r>>,
    /// Names of parameters and axes, which share one space.
    variables: HashMap<String, (Place, &'static str)>,
    stage_names: HashMap<String, Place>,
}

struct Reader<'a, 'r> {
    registry: &'r Registry,
    sources: &'a mut Sources,
    findings: &'a mut Findings,
    /// Folder of the first file, without links.
    root: PathBuf,
    /// Files that were read, without links.
    read: Vec<PathBuf>,
    merged: Merged<'r>,
}

impl<'r> Reader<'_, 'r> {
    fn first_file(&mut self, file: &Path) -> Option<Document<'r>> {
        let text = self.sources.read_text(file);
        let index = self.sources.add_file(file, String::new());
        let text = self.text_or_finding(text, Place::of_file(index), "")?;
        self.sources.clear();
        let index = self.sources.add_file(file, text);
        let canonical = file.canonicalize().unwrap_or_else(|_| file.to_owned());
        self.root = canonical.parent().map(Path::to_owned).unwrap_or_default();
        let root = self.parsed(index)?;
        let entries = self.map_of(&root, "the pipeline file")?;
        self.unknown_keys(&entries, &TOP_KEYS, "top-level key");
        self.version(&entries, Some(root.place));
        let pipeline = self.pipeline_name(&entries, root.place);
        let seed = self.seed(&entries);
        self.body(&entries, &[canonical], root.place);
        self.stages_exist(&entries, root.place);
        let Merged { params, axes, stages, .. } = std::mem::take(&mut self.merged);
        Some(Document { pipeline, seed, params, axes, stages, place: root.place })
    }

    fn text_or_finding(&mut self, text: Result<String, super::source::ReadError>, place: Place, subject: &str) -> Option<String> {
        match text {
            Ok(text) => Some(text),
            Err(error) => {
                let finding = match error.position {
                    _ if subject.is_empty() => {
                        let (line, column) = error.position.unwrap_or_default();
                        Finding::error(Place { line, column, ..place }, error.message)
                    }
                    Some((line, column)) => Finding::error(place, format!("{subject}: line {line}, column {column}: {}", error.message)),
                    None => Finding::error(place, format!("{subject}: {}", error.message)),
                };
                self.findings.add(finding);
                None
            }
        }
    }

    fn parsed(&mut self, index: u32) -> Option<Node> {
        let text = std::mem::take(&mut self.sources.text_mut(index).text);
        let node = parse(index, &text, self.findings);
        self.sources.text_mut(index).text = text;
        node
    }

    fn map_of(&mut self, node: &Node, what: &str) -> Option<Vec<Entry>> {
        match &node.value {
            Value::Map(entries) => Some(entries.to_vec()),
            Value::Null if what == "the pipeline file" => {
                self.findings.add(Finding::error(node.place, "the file is empty; a pipeline has `version`, `pipeline` and `stages`"));
                None
            }
            _ => {
                self.findings.add(Finding::error(node.place, format!("{what} must be a map, found {}", node.described())));
                None
            }
        }
    }

    fn unknown_keys(&mut self, entries: &[Entry], known: &[&str], what: &str) {
        for entry in entries.iter().filter(|entry| !known.contains(&&*entry.key)) {
            let hint = did_you_mean(nearest(&entry.key, known.iter().copied()));
            let hint = hint.or_else(|| Some(format!("the keys are `{}`", known.join("`, `"))));
            self.findings.add(Finding::error(entry.place, format!("unknown {what} {}", quoted(&entry.key))).with_hint(hint));
        }
    }

    fn version(&mut self, entries: &[Entry], missing: Option<Place>) {
        match (super::yaml::entry(entries, "version").map(|entry| &entry.node), missing) {
            (Some(Node { value: Value::Integer(1), .. }), _) | (None, None) => {}
            (Some(node), _) => {
                let message = format!("`version` must be `1`, the only version of the language, found {}", node.described());
                self.findings.add(Finding::error(node.place, message));
            }
            (None, Some(place)) => {
                let hint = Some("begin the file with `version: 1`".to_owned());
                self.findings.add(Finding::error(place, "key `version` is missing").with_hint(hint));
            }
        }
    }

    fn pipeline_name(&mut self, entries: &[Entry], place: Place) -> String {
        let Some(node) = super::yaml::entry(entries, "pipeline").map(|entry| &entry.node) else {
            let hint = Some("name it: `pipeline: my-figures`; its results go to `outputs/my-figures`".to_owned());
            self.findings.add(Finding::error(place, "key `pipeline` is missing").with_hint(hint));
            return String::new();
        };
        match plain_word(node).filter(|name| is_pipeline_name(name)) {
            Some(name) => name,
            None => {
                let hint = "a name has 1 to 64 letters, digits, `_`, `-` and `.`, begins with a letter, a digit or `_`, and is not `runs`";
                let message = format!("the name of the `pipeline` is not a safe file name: {}", node.described());
                self.findings.add(Finding::error(node.place, message).with_hint(Some(hint.to_owned())));
                String::new()
            }
        }
    }

    fn seed(&mut self, entries: &[Entry]) -> u64 {
        let Some(node) = super::yaml::entry(entries, "seed").map(|entry| &entry.node) else {
            return 0;
        };
        let seed = match &node.value {
            Value::Integer(seed) => u64::try_from(*seed).ok(),
            _ => None,
        };
        seed.unwrap_or_else(|| {
            let message = format!("`seed` must be an integer from 0 to {}, found {}", u64::MAX, node.described());
            self.findings.add(Finding::error(node.place, message));
            0
        })
    }

    /// Includes, parameters, axes and stages of one file; the included ones come first.
    fn body(&mut self, entries: &[Entry], ancestors: &[PathBuf], place: Place) {
        let section = |key: &str| super::yaml::entry(entries, key).map(|entry| &entry.node);
        if let Some(node) = section("include") {
            self.includes(node, ancestors, place.file);
        }
        for (key, noun) in [("params", "parameter"), ("axes", "axis")] {
            if let Some(map) = section(key).and_then(|node| self.map_of(node, &format!("`{key}`"))) {
                map.into_iter().for_each(|entry| self.variable(entry, noun));
            }
        }
        if let Some(map) = section("stages").and_then(|node| self.map_of(node, "`stages`")) {
            map.into_iter().for_each(|entry| self.stage(entry));
        }
    }

    fn stages_exist(&mut self, entries: &[Entry], place: Place) {
        match super::yaml::entry(entries, "stages") {
            None if self.merged.stages.is_empty() => {
                self.findings.add(Finding::error(place, "key `stages` is missing: there is nothing to do"))
            }
            Some(stages) if self.merged.stages.is_empty() && stages.node.map().is_some_and(|map| map.is_empty()) => {
                self.findings.add(Finding::error(stages.place, "`stages` is empty: there is nothing to do"));
            }
            _ => {}
        }
    }

    fn variable(&mut self, entry: Entry, noun: &'static str) {
        if !is_name(&entry.key) {
            let hint = Some("a name has at most 64 letters, digits, `_` and `-`, and begins with a letter or `_`".to_owned());
            let message = format!("{} is not a valid name of {} {noun}", quoted(&entry.key), if noun == "axis" { "an" } else { "a" });
            self.findings.add(Finding::error(entry.place, message).with_hint(hint));
            return;
        }
        if let Some((first, other)) = self.merged.variables.get(&*entry.key).copied() {
            let there = self.where_is(first);
            let message = format!("{noun} {} is defined already, as {other} in {there}", quoted(&entry.key));
            self.findings.add(Finding::error(entry.place, message + "; a name stands for one thing"));
            return;
        }
        self.merged.variables.insert(entry.key.to_string(), (entry.place, if noun == "axis" { "an axis" } else { "a parameter" }));
        if noun == "axis" { self.merged.axes.push(entry) } else { self.merged.params.push(entry) }
    }

    fn where_is(&self, place: Place) -> String {
        format!("line {} of {}", place.line, quoted(&self.sources.get(place.file).shown))
    }

    fn stage(&mut self, entry: Entry) {
        if !is_stage_name(&entry.key) {
            let hint = Some("a name has 1 to 64 letters, digits, `_` and `-`, and does not begin with `-`".to_owned());
            self.findings
                .add(Finding::error(entry.place, format!("{} is not a valid name of a stage", quoted(&entry.key))).with_hint(hint));
            return;
        }
        if let Some(first) = self.merged.stage_names.get(&*entry.key).copied() {
            let message = format!("stage {} is defined already, in {}", quoted(&entry.key), self.where_is(first));
            self.findings.add(Finding::error(entry.place, message));
            return;
        }
        self.merged.stage_names.insert(entry.key.to_string(), entry.place);
        let stage = self.stage_entry(&entry);
        self.merged.stages.push(stage);
    }

    fn stage_entry(&mut self, entry: &Entry) -> StageEntry<'r> {
        let name = entry.key.to_string();
        let mut stage = StageEntry {
            name: name.clone(),
            place: entry.place,
            kind: None,
            parameters: Node::new(Value::Null, entry.node.place),
            save: None,
            exclude: None,
            about: None,
            resources: Resources::default(),
            split: None,
        };
        let Value::Map(entries) = &entry.node.value else {
            let message = format!("a stage is a map with one kind, found {}", entry.node.described());
            let hint = if entry.node.is_null() {
                "its kind stands below its name, further to the right"
            } else {
                "write for example `{ load: { path: map.exr } }`"
            };
            let hint = Some(hint.to_owned());
            let place = if entry.node.is_null() { entry.place } else { entry.node.place };
            self.findings.add(Finding::error(place, message).in_stage(&name).with_hint(hint));
            return stage;
        };
        for part in entries.iter().filter(|part| STAGE_KEYS.contains(&&*part.key)) {
            match &*part.key {
                "save" => stage.save = Some(part.node.clone()),
                "exclude" => stage.exclude = Some(part.node.clone()),
                "resources" => stage.resources = resources::read(&part.node, &name, self.findings),
                "about" => stage.about = self.about(&part.node, &name),
                // Which kinds can be split is known once the kind is.
                _ => {}
            }
        }
        if let Some(part) = self.kind_entry(entries, entry) {
            stage.kind = self.registry.kinds().find(&part.key);
            stage.parameters = self.parameters(part, &name);
        }
        if let Some(part) = entries.iter().find(|part| &*part.key == "split") {
            stage.split = self.split(part, &stage);
        }
        stage
    }

    /// In how many parts the jobs of a stage are to be computed.
    fn split(&mut self, part: &Entry, stage: &StageEntry<'r>) -> Option<NonZeroU32> {
        let count = match &part.node.value {
            Value::Integer(count) => u32::try_from(*count).ok().filter(|count| (2..=PART_LIMIT).contains(count)).and_then(NonZeroU32::new),
            _ => None,
        };
        let finding = match (count, stage.kind.filter(|kind| !kind.splits)) {
            (Some(_), None) => return count,
            (None, _) => {
                let message = format!("`split` must be a number of parts from 2 to {PART_LIMIT}, found {}", part.node.described());
                Finding::error(part.node.place, message)
            }
            (Some(_), Some(kind)) => {
                let able = self.registry.kinds().iter().filter(|(_, kind)| kind.splits).map(|(name, _)| format!("`{name}`"));
                let able: Vec<String> = able.collect();
                let hint = format!("remove it; it is for stages of the kind {}", super::diagnostic::listed(&able, "or"));
                Finding::error(part.place, format!("a job of kind {} cannot be split", quoted(kind.name))).with_hint(Some(hint))
            }
        };
        self.findings.add(finding.in_stage(&stage.name));
        None
    }

    fn about(&mut self, node: &Node, stage: &str) -> Option<String> {
        let text = node.text().map(str::to_owned);
        if text.is_none() {
            self.findings.add(Finding::error(node.place, format!("`about` must be text, found {}", node.described())).in_stage(stage));
        }
        text
    }

    /// The entry that names the kind; everything else is reported.
    fn kind_entry<'e>(&mut self, entries: &'e [Entry], stage: &Entry) -> Option<&'e Entry> {
        let is_kind = |entry: &&Entry| self.registry.kinds().find(&entry.key).is_some();
        let (kinds, unknown): (Vec<&Entry>, Vec<&Entry>) =
            entries.iter().filter(|entry| !STAGE_KEYS.contains(&&*entry.key)).partition(is_kind);
        let mut findings = Vec::new();
        match (&kinds[..], &unknown[..]) {
            ([], []) => {
                let message = if entries.is_empty() { "is empty; it needs one kind with its parameters" } else { "has no kind" };
                findings.push(Finding::error(stage.node.place, message).with_hint(Some(format!("the kinds are {}", self.kinds_listed()))));
            }
            ([first, second, ..], _) => {
                let message = format!("has two kinds, {} and {}; a stage has exactly one", quoted(&first.key), quoted(&second.key));
                findings.push(Finding::error(second.place, message));
            }
            _ => {}
        }
        for part in unknown {
            let kind_names = self.registry.kinds().names();
            let (what, hint) = if kinds.is_empty() {
                ("unknown kind", did_you_mean(nearest(&part.key, kind_names.chain(STAGE_KEYS))))
            } else {
                ("unknown key", did_you_mean(nearest(&part.key, STAGE_KEYS)))
            };
            let known = if kinds.is_empty() {
                format!("the kinds are {}", self.kinds_listed())
            } else {
                "a stage has one kind, and `save`, `exclude`, `about`, `resources`, `split`".to_owned()
            };
            findings.push(Finding::error(part.place, format!("{what} {}", quoted(&part.key))).with_hint(hint.or(Some(known))));
        }
        let is_right = kinds.len() == 1;
        self.findings.extend(findings.into_iter().map(|finding| finding.in_stage(&stage.key)));
        kinds.first().copied().filter(|_| is_right)
    }

    fn kinds_listed(&self) -> String {
        let names: Vec<String> = self.registry.kinds().names().map(|name| format!("`{name}`")).collect();
        super::diagnostic::listed(&names, "and")
    }

    fn parameters(&mut self, part: &Entry, stage: &str) -> Node {
        match &part.node.value {
            Value::Map(_) => part.node.clone(),
            // The schema says what is missing, if anything; a kind without required parameters may stand alone.
            Value::Null => Node::new(Value::Map([].into()), part.place),
            _ => {
                let message = format!("{} takes a map of parameters, found {}", quoted(&part.key), part.node.described());
                self.findings.add(Finding::error(part.node.place, message).in_stage(stage));
                Node::new(Value::Null, part.node.place)
            }
        }
    }

    fn includes(&mut self, node: &Node, ancestors: &[PathBuf], file: u32) {
        let Some(items) = node.list().cloned() else {
            let message = format!("`include` must be a list of files, found {}", node.described());
            self.findings.add(Finding::error(node.place, message));
            return;
        };
        let mut here = Vec::new();
        for item in items.iter() {
            let Some(path) = item.text().filter(|path| !path.is_empty()) else {
                self.findings.add(Finding::error(item.place, format!("`include` takes paths of files, found {}", item.described())));
                continue;
            };
            if here.contains(&path.to_owned()) {
                self.findings.add(Finding::error(item.place, format!("file {} is included twice", quoted(path))));
                continue;
            }
            here.push(path.to_owned());
            self.include(path, item.place, ancestors, file);
        }
    }

    fn include(&mut self, path: &str, place: Place, ancestors: &[PathBuf], file: u32) {
        let error = |message: String| Finding::error(place, format!("`include` {}: {message}", quoted(path)));
        let outside = || error("lies outside the folder of the pipeline file".to_owned());
        let joined = self.sources.get(file).folder.join(path);
        let lexical = std::path::absolute(&joined).map(|path| without_dots(&path)).unwrap_or_else(|_| joined.clone());
        let lexical_root = std::path::absolute(&self.sources.get(0).folder).map(|path| without_dots(&path)).unwrap_or_default();
        if Path::new(path).is_absolute() || !lexical.starts_with(&lexical_root) {
            return self.findings.add(outside());
        }
        if path.contains('\0') {
            return self.findings.add(error("contains a NUL character".to_owned()));
        }
        let canonical = joined.canonicalize().unwrap_or_else(|_| joined.clone());
        if joined.exists() && !canonical.starts_with(&self.root) {
            return self.findings.add(outside());
        }
        if ancestors.contains(&canonical) {
            let mut names: Vec<String> =
                ancestors.iter().skip_while(|ancestor| **ancestor != canonical).map(|path| file_name(path)).collect();
            names.push(file_name(&canonical));
            return self.findings.add(error(format!("a cycle of includes: {}", names.join(" -> "))));
        }
        if self.read.contains(&canonical) {
            return;
        }
        if ancestors.len() > INCLUDE_LIMIT {
            return self.findings.add(error(format!("includes are nested deeper than the limit of {INCLUDE_LIMIT}")));
        }
        let subject = format!("`include` {}", quoted(path));
        let text = self.sources.read_text(&joined);
        let Some(text) = self.text_or_finding(text, place, &subject) else {
            return;
        };
        self.included_file(&joined, text, &[ancestors, &[canonical]].concat());
    }

    fn included_file(&mut self, path: &Path, text: String, ancestors: &[PathBuf]) {
        self.read.extend(ancestors.last().cloned());
        let index = self.sources.add_file(path, text);
        let Some(root) = self.parsed(index) else {
            return;
        };
        let Some(entries) = self.map_of(&root, "an included file") else {
            return;
        };
        self.unknown_keys(&entries, &INCLUDED_KEYS, "key of an included file:");
        self.version(&entries, None);
        self.body(&entries, ancestors, root.place);
    }
}

fn file_name(path: &Path) -> String {
    quoted(&path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default())
}

/// Text, or a number that was meant as text: `pipeline: 2024`.
fn plain_word(node: &Node) -> Option<String> {
    match &node.value {
        Value::Text(text) => Some(text.to_string()),
        Value::Integer(value) => Some(value.to_string()),
        _ => None,
    }
}

fn is_pipeline_name(name: &str) -> bool {
    (1..=64).contains(&name.len())
        && name != "runs"
        && !name.starts_with(['.', '-'])
        && name.bytes().all(|byte| byte.is_ascii_alphanumeric() || b"_.-".contains(&byte))
}

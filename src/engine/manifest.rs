//! The record of a run: what was asked, what every job did, what was published.
//!
//! `plan --format json` shows the same job entries. Nothing in it is an absolute path or a user's name, and
//! equal work has the same `result_id` on any machine.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value as Json;

use super::coordinate::{Coordinate, Scalar};
use super::digest::Digest;
use super::graph::{Graph, InputNode, JobNode, PartOf};
use super::key::add_canonical;
use super::lines::{add_line, add_text};
use super::schema::FieldPath;

/// Name and version of this form.
pub const SCHEMA: &str = "pipeline-manifest-1";

/// How a run ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Status {
    /// Every job has its result and every file is published.
    Done,
    /// A job failed, or the system did.
    Failed,
    /// A signal ended it.
    Interrupted,
}

/// What became of a job, or what is to become of it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Outcome {
    /// Its result was, or is, in the store.
    Hit,
    /// Planned: it will run.
    Run,
    /// Planned: its key waits for the content of an input.
    Maybe,
    /// It ran.
    Ran,
    /// It ran and gave no result.
    Failed,
    /// It was not started, because an input failed or the run ended before.
    Skipped,
    /// It was running when the run was interrupted.
    Interrupted,
}

impl Outcome {
    /// The word for people, the same as in JSON.
    pub fn word(self) -> &'static str {
        match self {
            Outcome::Hit => "hit",
            Outcome::Run => "run",
            Outcome::Maybe => "maybe",
            Outcome::Ran => "ran",
            Outcome::Failed => "failed",
            Outcome::Skipped => "skipped",
            Outcome::Interrupted => "interrupted",
        }
    }
}

/// The record of a run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Manifest {
    /// Name and version of this form.
    pub schema: String,
    /// Name of the pipeline.
    pub pipeline: String,
    /// Unique name of the run, beginning with its time.
    pub run_id: String,
    /// Identity of the work: equal for equal results and equal files, wherever and however they were made.
    pub result_id: Digest,
    /// How it ended.
    pub status: Status,
    /// Whether all jobs of the file were wanted, none left out by the command line.
    pub whole: bool,
    /// The pipeline's seed.
    pub seed: u64,
    /// The pipeline file and what it includes.
    pub spec: Vec<SpecEntry>,
    /// What the command line changed.
    pub overrides: Json,
    /// Every wanted job, inputs before their users.
    pub jobs: Vec<JobEntry>,
    /// The files that this run stands behind.
    pub published: Vec<PublishedEntry>,
    /// Files of earlier runs that this one, being partial or unfinished, left in place.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub kept: Vec<PublishedEntry>,
    /// What a reader of the results must know.
    pub warnings: Vec<WarningEntry>,
    /// The program.
    pub program: Program,
    /// The machine.
    pub machine: Machine,
    /// Times and counts; they differ between equal runs.
    pub measured: Measured,
}

/// A file of the pipeline's text.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SpecEntry {
    /// Path relative to the pipeline file's folder.
    pub path: String,
    /// SHA-256 of the text.
    pub sha256: Digest,
    /// The text, from which the run can be made again.
    pub text: String,
}

/// A job of a run or of a plan.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct JobEntry {
    /// Name of the stage.
    pub stage: String,
    /// Value on each axis.
    pub coordinate: Json,
    /// Name of the kind.
    pub kind: String,
    /// Version of the kind.
    pub version: u32,
    /// The parameters that are not at their default.
    pub parameters: Json,
    /// The seed, if it draws.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub seed: Option<u64>,
    /// The key; null while the content of an input is not known.
    pub key: Option<Digest>,
    /// What became of it.
    pub outcome: Outcome,
    /// Why.
    pub reason: String,
    /// What stood on its ports.
    pub inputs: Vec<InputEntry>,
    /// The files it read.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub files: Vec<FileEntry>,
    /// Its results; empty while they are not known.
    pub outputs: Vec<OutputEntry>,
    /// What it said and what its kind says of such parameters.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub warnings: Vec<String>,
    /// Why it failed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub error: Option<String>,
    /// The parts that were computed for it, where `split:` asks for that and it was not in the store.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub parts: Vec<PartEntry>,
    /// What it cost in this run or, for a hit, when it ran; without its parts.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub measured: Option<JobMeasured>,
}

impl JobEntry {
    /// What each of its parts took, in this run or when it ran.
    pub fn part_seconds(&self) -> impl Iterator<Item = f64> {
        self.parts.iter().filter_map(|part| Some(part.measured.as_ref()?.seconds))
    }
}

/// A part of a job.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PartEntry {
    /// Which one, from 1.
    pub number: usize,
    /// Its key.
    pub key: Option<Digest>,
    /// What became of it.
    pub outcome: Outcome,
    /// What it cost, as of a job.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub measured: Option<JobMeasured>,
}

/// What a job cost.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct JobMeasured {
    /// Time from start to result.
    pub seconds: f64,
    /// Memory beside its inputs, as its kind estimates it, in bytes.
    pub memory: u64,
    /// When it started, in seconds since the run began; only where it ran in this run.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub start: Option<f64>,
    /// The job thread it ran on, from 0; likewise.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub thread: Option<u32>,
    /// Name of the machine whose worker computed it; only of runs with workers.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub host: Option<String>,
}

/// A result on a port.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct InputEntry {
    /// Name of the port.
    pub port: String,
    /// Name of the stage, with `.result` for a further result.
    pub stage: String,
    /// Coordinate of the job it comes from.
    pub coordinate: Json,
    /// Digest of its canonical bytes; null while not known.
    pub sha256: Option<Digest>,
}

/// An input file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct FileEntry {
    /// Name of the parameter.
    pub parameter: String,
    /// Path relative to the pipeline file's folder, or the bare name of a file outside it.
    pub path: String,
    /// Digest of its content.
    pub sha256: Digest,
}

/// A result of a job.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct OutputEntry {
    /// Empty for the first result.
    pub name: String,
    /// Type of the artifact.
    #[serde(rename = "type")]
    pub type_name: String,
    /// Digest of its canonical bytes.
    pub sha256: Digest,
    /// Their number.
    pub bytes: u64,
}

/// A published file.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
pub struct PublishedEntry {
    /// Path below the pipeline's folder of outputs.
    pub path: String,
    /// Digest of its bytes.
    pub sha256: Digest,
    /// `stage` or `stage[axis=value,…]`, with `.result` for a further result.
    pub job: String,
}

/// A warning, said once for all jobs of a stage that gave it.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
pub struct WarningEntry {
    /// Name of the stage; empty where none is to blame.
    pub stage: String,
    /// The text.
    pub message: String,
    /// How many jobs gave it.
    pub jobs: u64,
}

/// The program that ran.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Program {
    /// Its name.
    pub name: String,
    /// Its version.
    pub version: String,
    /// `release` or `debug`.
    pub build: String,
}

impl Program {
    /// This program.
    pub fn this() -> Self {
        let build = if cfg!(debug_assertions) { "debug" } else { "release" };
        Self { name: env!("CARGO_PKG_NAME").into(), version: env!("CARGO_PKG_VERSION").into(), build: build.into() }
    }
}

/// The machine it ran on, without a name.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Machine {
    /// Operating system.
    pub system: String,
    /// Processor architecture.
    pub architecture: String,
    /// Processors that this process may use.
    pub processors: u64,
}

impl Machine {
    /// This machine.
    pub fn this() -> Self {
        let processors = std::thread::available_parallelism().map_or(1, |count| count.get() as u64);
        Self { system: std::env::consts::OS.into(), architecture: std::env::consts::ARCH.into(), processors }
    }
}

/// Times and counts of a run.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
pub struct Measured {
    /// When it began, UTC.
    pub started: String,
    /// How long it took.
    pub seconds: f64,
    /// Threads it could use.
    pub threads: u64,
    /// Memory it could use, in bytes.
    pub memory_limit: u64,
    /// Most memory that values and running jobs were estimated to hold at once, in bytes.
    pub memory_peak: u64,
    /// Jobs by outcome.
    pub jobs: BTreeMap<String, u64>,
    /// Files that were written, beside those that stood already.
    pub files_written: u64,
    /// Files of earlier runs that were removed.
    pub files_removed: u64,
}

/// What a run that changed nothing leaves: the name of the run whose results stand.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ShortManifest {
    /// Name and version of this form.
    pub schema: String,
    /// Name of the pipeline.
    pub pipeline: String,
    /// Unique name of the run.
    pub run_id: String,
    /// The same as that of the run whose results stand.
    pub result_id: Digest,
    /// Always done.
    pub status: Status,
    /// The run whose results stand.
    pub results_of: String,
    /// Times and counts.
    pub measured: Measured,
}

/// What a next run needs of the latest manifest when nothing has changed; the rest is passed over.
#[derive(Debug, Clone, Deserialize)]
pub struct Standing {
    /// Name of the run.
    pub run_id: String,
    /// See [`result_id`].
    pub result_id: Digest,
    /// How it ended.
    pub status: Status,
    /// What it stands behind.
    pub published: Vec<PublishedEntry>,
    /// What it left in place.
    #[serde(default)]
    pub kept: Vec<PublishedEntry>,
}

impl Standing {
    /// Whether a run that changed nothing and came to that end needs no manifest of its own.
    pub fn stands_for(&self, status: Status, result_id: &Digest) -> bool {
        status == Status::Done && self.status == Status::Done && self.result_id == *result_id
    }

    /// The digest that a file should have, if a run published it.
    pub fn digest_of(&self, path: &str) -> Option<Digest> {
        let published = |entries: &[PublishedEntry]| {
            let index = entries.binary_search_by(|entry| entry.path.as_str().cmp(path)).ok()?;
            Some(entries[index].sha256)
        };
        published(&self.published).or_else(|| published(&self.kept))
    }

    /// Reads it from the text of a manifest; `None` if it is none.
    pub fn from_text(text: &[u8]) -> Option<Self> {
        let mut standing: Self = serde_json::from_slice(text).ok()?;
        // They are sorted already unless someone has edited the file.
        standing.published.sort_unstable();
        standing.kept.sort_unstable();
        Some(standing)
    }
}

/// Identity of the work: equal for equal results and equal files, wherever and however they were made.
///
/// SHA-256 of the canonical JSON of the sorted (stage, coordinate, kind, version, parameters, digests of the
/// outputs) and the sorted (path, digest) of the published files.
pub fn result_id(jobs: &[JobEntry], published: &[PublishedEntry]) -> Digest {
    let mut text = b"{\"jobs\":[".to_vec();
    add_sorted(jobs, add_job_identity, &mut text);
    text.extend(b"],\"published\":[");
    add_sorted(published, |entry, text| add_line(&(&entry.path, entry.sha256), text), &mut text);
    text.extend(b"]}");
    Digest::of(&text)
}

/// Adds the texts of items in their order, with commas between.
fn add_sorted<T>(items: &[T], add: impl Fn(&T, &mut Vec<u8>), text: &mut Vec<u8>) {
    // All of them stand in one piece of memory: they are many and short.
    let mut unsorted = Vec::new();
    let mut add_one = |item| {
        let start = unsorted.len();
        add(item, &mut unsorted);
        start..unsorted.len()
    };
    let mut places: Vec<_> = items.iter().map(&mut add_one).collect();
    places.sort_unstable_by(|a, b| unsorted[a.clone()].cmp(&unsorted[b.clone()]));
    for (index, place) in places.into_iter().enumerate() {
        if index > 0 {
            text.push(b',');
        }
        text.extend(&unsorted[place]);
    }
}

fn add_job_identity(job: &JobEntry, text: &mut Vec<u8>) {
    let JobEntry { stage, coordinate, kind, version, parameters, outputs, .. } = job;
    text.push(b'[');
    add_text(stage, text);
    text.push(b',');
    add_canonical(coordinate, text);
    text.push(b',');
    add_text(kind, text);
    text.push(b',');
    add_line(version, text);
    text.push(b',');
    add_canonical(parameters, text);
    text.extend(b",[");
    for (index, output) in outputs.iter().enumerate() {
        if index > 0 {
            text.push(b',');
        }
        add_line(&output.sha256, text);
    }
    text.extend(b"]]");
}

/// The entry of a job, before anything is known of its results.
pub fn job_entry(graph: &Graph, job: &JobNode, files: &[Digest]) -> JobEntry {
    let stage = &graph.stages[job.stage];
    JobEntry {
        stage: stage.name.clone(),
        coordinate: coordinate_json(job),
        kind: stage.kind.to_owned(),
        version: stage.version,
        parameters: job.shown.clone(),
        seed: job.seed,
        key: None,
        outcome: Outcome::Maybe,
        reason: String::new(),
        inputs: input_items(job).map(|(port, item)| input_entry(graph, port, item)).collect(),
        files: job.files.iter().zip(files).map(|((name, path), digest)| file_entry(job, name, path, *digest)).collect(),
        outputs: Vec::new(),
        warnings: Vec::new(),
        error: None,
        parts: Vec::new(),
        measured: None,
    }
}

/// All that stands on the ports of a job, with the name of the port, in the order of [`JobEntry::inputs`].
pub fn input_items(job: &JobNode) -> impl Iterator<Item = (&str, &InputNode)> {
    job.inputs.iter().flat_map(|port| port.items.iter().map(|item| (port.port.as_str(), item)))
}

fn input_entry(graph: &Graph, port: &str, item: &InputNode) -> InputEntry {
    InputEntry { port: port.to_owned(), stage: item.label.clone(), coordinate: coordinate_json(&graph.jobs[item.job]), sha256: None }
}

fn file_entry(job: &JobNode, name: &str, path: &std::path::Path, digest: Digest) -> FileEntry {
    let shown = FieldPath::parse(name).look_up(&job.shown).and_then(Json::as_str).map(str::to_owned);
    let bare = || path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    FileEntry { parameter: name.to_owned(), path: shown.unwrap_or_else(bare), sha256: digest }
}

/// A coordinate as an object from axis to value.
pub fn coordinate_json(job: &JobNode) -> Json {
    serde_json::to_value(&job.coordinate).expect("a coordinate is plain data")
}

/// The text of a coordinate, as [`super::coordinate::Coordinate`] writes it.
pub fn coordinate_text(coordinate: &Json) -> String {
    let fields = coordinate.as_object().into_iter().flatten();
    let texts: Vec<String> = fields.map(|(axis, value)| format!("{axis}={}", plain_text(value))).collect();
    texts.join(",")
}

/// A value as a person writes it: text without quotes.
pub fn plain_text(value: &Json) -> String {
    value.as_str().map_or_else(|| value.to_string(), str::to_owned)
}

/// `stage` or `stage[axis=value,…]`, of what stands in a manifest.
pub fn place_text(stage: &str, coordinate: &Json) -> String {
    let text = coordinate_text(coordinate);
    if text.is_empty() { stage.to_owned() } else { format!("{stage}[{text}]") }
}

/// A coordinate that stands in a manifest.
pub fn coordinate_of(coordinate: &Json) -> Coordinate {
    let scalar = |value: &Json| match value {
        Json::Bool(value) => Scalar::Boolean(*value),
        Json::Number(number) => {
            let whole = number.as_u64().map(i128::from).or_else(|| number.as_i64().map(i128::from));
            whole.map_or_else(|| Scalar::from_number(number.as_f64().unwrap_or_default()), Scalar::Integer)
        }
        other => Scalar::Text(plain_text(other)),
    };
    Coordinate(coordinate.as_object().into_iter().flatten().map(|(axis, value)| (axis.clone(), scalar(value))).collect())
}

/// `stage` or `stage[axis=value,…]`; of a part with ` part 3 of 8`.
pub fn job_name(graph: &Graph, job: &JobNode) -> String {
    let name = named(&graph.stages[job.stage].name, job);
    match job.part_of {
        Some(PartOf { number, count, .. }) => format!("{name} part {number} of {count}"),
        None => name,
    }
}

/// `stage`, `stage.result`, either with `[axis=value,…]`.
pub fn result_name(graph: &Graph, job: &JobNode, result: usize) -> String {
    let stage = &graph.stages[job.stage];
    match stage.results[result].0 {
        "" => named(&stage.name, job),
        name => named(&format!("{}.{name}", stage.name), job),
    }
}

fn named(name: &str, job: &JobNode) -> String {
    if job.coordinate.is_empty() { name.to_owned() } else { format!("{name}[{}]", job.coordinate) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn entry(stage: &str, outcome: Outcome) -> JobEntry {
        JobEntry {
            stage: stage.into(),
            coordinate: serde_json::json!({"n": 64}),
            kind: "k".into(),
            version: 1,
            parameters: serde_json::json!({"b": 1, "a": 2}),
            seed: None,
            key: None,
            outcome,
            reason: String::new(),
            inputs: vec![],
            files: vec![],
            outputs: vec![],
            warnings: vec![],
            error: None,
            parts: vec![],
            measured: None,
        }
    }

    #[test]
    fn equal_work_has_one_identity_in_any_order_and_by_any_way() {
        let mut other = entry("a", Outcome::Hit);
        other.parameters = serde_json::json!({"a": 2, "b": 1});
        let files = |paths: [&str; 2]| paths.map(|path| PublishedEntry { path: path.into(), sha256: Digest::of(b""), job: String::new() });
        let one = result_id(&[entry("a", Outcome::Ran), entry("b", Outcome::Ran)], &files(["x", "y"]));
        let two = result_id(&[entry("b", Outcome::Hit), other], &files(["y", "x"]));
        assert_eq!(one, two);
        assert_ne!(one, result_id(&[entry("a", Outcome::Ran)], &files(["x", "y"])));
        assert_ne!(one, result_id(&[entry("a", Outcome::Ran), entry("b", Outcome::Ran)], &files(["x", "z"])));
    }
}

//! The typed graph: every job with its parameters, its inputs and what it publishes.
//!
//! Pure data; `sweep` makes it from a document, `freshness` and `schedule` read it. Jobs stand in an
//! order in which inputs come before their users.

use std::num::NonZeroU32;
use std::path::PathBuf;

use serde_json::Value as Json;

use super::artifact::TypeName;
use super::coordinate::{Coordinate, Scalar};
use super::resources::Resources;
use super::stage::AnyStage;

/// A checked pipeline, ready to be planned.
pub struct Graph {
    /// Name of the pipeline; a safe file name.
    pub pipeline: String,
    /// The seed of stages that set none.
    pub seed: u64,
    /// Folder of the pipeline file, to which the manifest's paths are relative.
    pub folder: PathBuf,
    /// The pipeline file and what it includes, in the order in which they were read.
    pub sources: Vec<Source>,
    /// What the command line changed: parameters, axes, seed (for the manifest).
    pub overrides: Json,
    /// The whole of what was asked (see [`Request::identity`](super::request::Request::identity)).
    pub request: String,
    /// Whether its text gave warnings, which are shown at every run.
    pub has_warnings: bool,
    /// Whether all jobs run: false under `--only` or an axis override, when nothing may be removed.
    pub is_whole: bool,
    /// The stages in the order of the file.
    pub stages: Vec<StageNode>,
    /// All jobs; inputs come before their users.
    pub jobs: Vec<JobNode>,
}

/// A file of the pipeline's text.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Source {
    /// Path relative to the folder of the pipeline file.
    pub path: String,
    /// Path under which it was read.
    pub read_as: PathBuf,
    /// Its whole text.
    pub text: String,
}

/// A stage with what all its jobs share.
pub struct StageNode {
    /// Name in the file.
    pub name: String,
    /// Name of its kind.
    pub kind: &'static str,
    /// Version of its kind.
    pub version: u32,
    /// The text of `about:`.
    pub about: Option<String>,
    /// What each of its jobs asks of the machine.
    pub resources: Resources,
    /// In how many parts at most its jobs are to be computed; in no key.
    pub split: Option<NonZeroU32>,
    /// File and line (from 1) of its entry.
    pub place: (String, usize),
    /// Its axes, in order of declaration.
    pub axes: Vec<String>,
    /// Name (empty for the first) and type of each result.
    pub results: Vec<(&'static str, TypeName)>,
}

/// One stage at one coordinate.
pub struct JobNode {
    /// Index into [`Graph::stages`].
    pub stage: usize,
    /// Value on each axis of the stage.
    pub coordinate: Coordinate,
    /// The parameters: what runs.
    pub parameters: Box<dyn AnyStage>,
    /// What enters the key: no ports, no fields at their default, no seed where it does not draw, files by
    /// their field name only (their digest is added when it is known). Object keys sorted.
    pub canonical: Json,
    /// What would enter the keys of those jobs from whose results this one can go on, the best first.
    pub prefixes: Vec<Json>,
    /// What the manifest shows: like `canonical`, with files as paths relative to the pipeline's folder.
    pub shown: Json,
    /// What stands on each port.
    pub inputs: Vec<PortInputs>,
    /// Input files by the name of their field.
    pub files: Vec<(String, PathBuf)>,
    /// The seed it draws with; `None` if it does not draw.
    pub seed: Option<u64>,
    /// Whether that is of its stage and not the pipeline's.
    pub has_own_seed: bool,
    /// What is published, in order.
    pub publications: Vec<Publication>,
    /// The jobs before it that compute it in parts, if it has to be computed.
    pub parts: Vec<PartNode>,
    /// What it is a part of. Nothing wants a part but its whole, and only in a run that has to compute that.
    pub part_of: Option<PartOf>,
    /// Whether this run wants it: it is a target or an input of one.
    pub is_wanted: bool,
    /// Whether it is to run even if the store has its result.
    pub is_forced: bool,
}

/// A part of a job.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PartNode {
    /// Index into [`Graph::jobs`].
    pub job: usize,
    /// See [`Part::within`](super::stage::Part::within).
    pub within: usize,
}

/// What a job is a part of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PartOf {
    /// Index into [`Graph::jobs`].
    pub whole: usize,
    /// Which part, from 1.
    pub number: usize,
    /// Of how many.
    pub count: usize,
}

/// What stands on one port of a job.
#[derive(Debug, Clone)]
pub struct PortInputs {
    /// Field name of the port.
    pub port: String,
    /// The reference as written; how the stage asks for it.
    pub reference: String,
    /// Whether it is a collecting port: then label and columns enter the key too.
    pub collects: bool,
    /// The results that stand there; exactly one unless it collects.
    pub items: Vec<InputNode>,
}

/// One result of an earlier job.
#[derive(Debug, Clone)]
pub struct InputNode {
    /// Index into [`Graph::jobs`].
    pub job: usize,
    /// Index into the results of its stage.
    pub result: usize,
    /// Name of its stage, with `.result` for a further result.
    pub label: String,
    /// Collapsed axes and fields of map-valued ones (`axis.field`), in order of declaration.
    pub columns: Vec<(String, Scalar)>,
}

/// A file to publish.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Publication {
    /// Index into the results of the stage.
    pub result: usize,
    /// Format, one of those of the result's type.
    pub format: String,
    /// Path below `outputs/NAME/`, with `/` between folders.
    pub path: String,
}

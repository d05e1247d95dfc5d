//! What a stage kind must offer, and the same free of its type.
//!
//! A kind's struct is its parameter block: serde reads it, its JSON Schema checks it and is its manual,
//! and its canonical JSON enters the key. A field marked `#[serde(default)]` is optional, and a field at
//! its default is left out of the key.

use std::collections::BTreeMap;
use std::num::NonZeroU32;

use schemars::JsonSchema;
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::Value as Json;

use super::artifact::{AnyArtifact, Artifact, TypeName};
use super::job::Job;

/// One result of a kind.
#[derive(Debug, Clone, Copy)]
pub struct ResultDeclaration {
    /// Empty for the first result, which a bare stage name means; else the name after the point.
    pub name: &'static str,
    /// The types it can have. Several mean that inputs or users decide (`load`, `mark`).
    pub types: &'static [TypeName],
}

/// Types of what each single port of a stage takes in, by port name; absent ports are absent.
pub type InputTypes = BTreeMap<String, TypeName>;

/// Bytes that the inputs of a job hold in memory, by port name, summed over a collecting port; and those of its input
/// files, by the name of their parameter.
pub type InputSizes = BTreeMap<String, u64>;

/// A mistake that only the whole parameter block shows (`gamma` together with `agx`).
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Mistake {
    /// The field at fault.
    pub field: String,
    /// What is wrong, values in backticks.
    pub message: String,
    /// What to do, if it can be said.
    pub hint: Option<String>,
}

/// A kind of stage.
pub trait Stage: Serialize + DeserializeOwned + JsonSchema + Send + Sync + 'static {
    /// Its key in the pipeline file, in kebab-case.
    const KIND: &'static str;
    /// Raise when equal parameters would give another result.
    const VERSION: u32;
    /// Its results, the first one first.
    const RESULTS: &'static [ResultDeclaration];
    /// Whether its work can be divided, as `split:` asks for.
    const SPLITS: bool = false;
    /// What `run` gives: an artifact, or a tuple of artifacts in the order of `RESULTS`.
    type Output: Outputs;

    /// The types each result can have, given those of the inputs; several mean that the users decide.
    fn result_types(&self, _inputs: &InputTypes) -> Vec<Vec<TypeName>> {
        Self::RESULTS.iter().map(|result| result.types.to_vec()).collect()
    }

    /// Called when the users have decided between the several types of the first result.
    fn decide_type(&mut self, _type_name: TypeName) {}

    /// Whether it draws random numbers with these parameters; then its seed is in its key.
    fn draws(&self) -> bool {
        false
    }

    /// Mistakes that the schema of single fields cannot show.
    fn mistakes(&self) -> Vec<Mistake> {
        Vec::new()
    }

    /// What the manifest must say of the result: each biased estimator and report's variant in use.
    fn caveats(&self) -> Vec<String> {
        Vec::new()
    }

    /// For collecting kinds that show axes: the columns they use. A collapsed axis among none is an error.
    fn axes_used(&self) -> Option<Vec<String>> {
        None
    }

    /// Bytes needed at the peak beside the inputs.
    fn memory(&self, inputs: &InputSizes) -> u64 {
        inputs.values().sum()
    }

    /// Parameters whose results this job can go on from, the best first; inputs, files and seed are the same.
    ///
    /// If the store has one of them, `run` finds it by [`Job::earlier`]. Its own results must be the same bytes either way.
    fn prefixes(&self) -> Vec<Self> {
        Vec::new()
    }

    /// At most so many jobs that together compute what this one would; none where it is too small to be divided.
    ///
    /// `run` finds their results by [`Job::parts`], without those that it can go on without. Its own results must be the same
    /// bytes for any number of parts and for none.
    fn parts(&self, _count: NonZeroU32) -> Vec<Part<Self>> {
        Vec::new()
    }

    /// Computes the results; a function of the parameters, the inputs and the seed alone.
    fn run(&self, job: &Job<'_>) -> Result<Self::Output, StageError>;
}

/// A part of a job: a job of the same kind with the same inputs, files and seed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Part<T> {
    /// Its parameters.
    pub parameters: T,
    /// So many of the whole's first [`prefixes`](Stage::prefixes) hold all that it would compute: with one of them at hand, it
    /// need not run.
    pub within: usize,
}

/// Why a stage gave no result.
#[derive(Debug, thiserror::Error)]
pub enum StageError {
    /// An input's content or a combination of parameters does not allow a result.
    #[error("{message}")]
    Content {
        /// What is wrong.
        message: String,
        /// What to do, if it can be said.
        hint: Option<String>,
    },
    /// The operating system failed.
    #[error("{context}: {source}")]
    System {
        /// What was attempted.
        context: String,
        /// What the system said.
        source: std::io::Error,
    },
    /// The run was interrupted.
    #[error("interrupted")]
    Interrupted,
}

impl StageError {
    /// Bad content, without a hint.
    pub fn content(message: impl ToString) -> Self {
        Self::Content { message: message.to_string(), hint: None }
    }

    /// Bad content, with what to do.
    pub fn content_with_hint(message: impl ToString, hint: impl ToString) -> Self {
        Self::Content { message: message.to_string(), hint: Some(hint.to_string()) }
    }
}

/// Results of a run, in the order of `RESULTS`.
pub trait Outputs {
    /// The artifacts.
    fn into_artifacts(self) -> Vec<AnyArtifact>;
}

impl<T: Artifact> Outputs for T {
    fn into_artifacts(self) -> Vec<AnyArtifact> {
        vec![AnyArtifact::new(self)]
    }
}

impl<A: Artifact, B: Artifact> Outputs for (A, B) {
    fn into_artifacts(self) -> Vec<AnyArtifact> {
        vec![AnyArtifact::new(self.0), AnyArtifact::new(self.1)]
    }
}

impl Outputs for Vec<AnyArtifact> {
    fn into_artifacts(self) -> Vec<AnyArtifact> {
        self
    }
}

/// A stage of any kind.
pub trait AnyStage: Send + Sync {
    /// The parameter block as JSON, all fields.
    fn parameters(&self) -> Json;
    /// See [`Stage::result_types`].
    fn result_types(&self, inputs: &InputTypes) -> Vec<Vec<TypeName>>;
    /// See [`Stage::decide_type`].
    fn decide_type(&mut self, type_name: TypeName);
    /// See [`Stage::draws`].
    fn draws(&self) -> bool;
    /// See [`Stage::mistakes`].
    fn mistakes(&self) -> Vec<Mistake>;
    /// See [`Stage::caveats`].
    fn caveats(&self) -> Vec<String>;
    /// See [`Stage::axes_used`].
    fn axes_used(&self) -> Option<Vec<String>>;
    /// See [`Stage::memory`].
    fn memory(&self, inputs: &InputSizes) -> u64;
    /// See [`Stage::prefixes`]; parameter blocks as JSON.
    fn prefixes(&self) -> Vec<Json>;
    /// See [`Stage::parts`].
    fn parts(&self, count: NonZeroU32) -> Vec<Part<Box<dyn AnyStage>>>;
    /// See [`Stage::run`].
    fn run(&self, job: &Job<'_>) -> Result<Vec<AnyArtifact>, StageError>;
}

impl<T: Stage> AnyStage for T {
    fn parameters(&self) -> Json {
        serde_json::to_value(self).expect("a parameter block is plain data with text keys")
    }

    fn result_types(&self, inputs: &InputTypes) -> Vec<Vec<TypeName>> {
        Stage::result_types(self, inputs)
    }

    fn decide_type(&mut self, type_name: TypeName) {
        Stage::decide_type(self, type_name);
    }

    fn draws(&self) -> bool {
        Stage::draws(self)
    }

    fn mistakes(&self) -> Vec<Mistake> {
        Stage::mistakes(self)
    }

    fn caveats(&self) -> Vec<String> {
        Stage::caveats(self)
    }

    fn axes_used(&self) -> Option<Vec<String>> {
        Stage::axes_used(self)
    }

    fn memory(&self, inputs: &InputSizes) -> u64 {
        Stage::memory(self, inputs)
    }

    fn prefixes(&self) -> Vec<Json> {
        Stage::prefixes(self).iter().map(AnyStage::parameters).collect()
    }

    fn parts(&self, count: NonZeroU32) -> Vec<Part<Box<dyn AnyStage>>> {
        let boxed = |Part { parameters, within }: Part<T>| Part { parameters: Box::new(parameters) as Box<dyn AnyStage>, within };
        Stage::parts(self, count).into_iter().map(boxed).collect()
    }

    fn run(&self, job: &Job<'_>) -> Result<Vec<AnyArtifact>, StageError> {
        Stage::run(self, job).map(Outputs::into_artifacts)
    }
}

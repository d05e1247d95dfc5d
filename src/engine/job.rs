//! What a stage sees while it runs: its inputs, its files, its seed, and whether to stop.
//!
//! A job is self-contained: a stage touches nothing else.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::{Arc, Mutex};

use super::artifact::{AnyArtifact, Artifact, TypeName};
use super::coordinate::Scalar;
use super::parameter::{Accepts, InputFile, Port, Ports, Seed};
use super::stage::StageError;

/// One artifact on a port, with what a collecting kind may say of it.
pub struct Input {
    /// Name of the stage it comes from, with `.result` for a further result.
    pub label: String,
    /// Its axes that were collapsed, and the fields of map-valued ones as `axis.field`, in order.
    pub columns: Vec<(String, Scalar)>,
    /// The value, or the way to it.
    pub source: Box<dyn Fetch>,
}

/// Gives an artifact when it is asked for, so that a job over many need not hold them all.
pub trait Fetch: Send + Sync {
    /// The artifact; reads it from the store where it is not in memory.
    fn fetch(&self) -> Result<AnyArtifact, StageError>;
}

impl Fetch for AnyArtifact {
    fn fetch(&self) -> Result<AnyArtifact, StageError> {
        Ok(self.clone())
    }
}

/// The types of the results of a part, and the ways to them.
pub type PartResults = Vec<(TypeName, Box<dyn Fetch>)>;

/// The bytes of input files, each read once and checked against the digest that is in the key.
pub trait FileSource: Send + Sync {
    /// All bytes of the file.
    fn read(&self, path: &Path) -> Result<Vec<u8>, StageError>;
}

/// One execution of a stage at one coordinate.
pub struct Job<'a> {
    inputs: BTreeMap<String, Vec<Input>>,
    files: &'a dyn FileSource,
    earlier: Vec<AnyArtifact>,
    parts: Vec<PartResults>,
    seed: u64,
    interrupted: &'a AtomicBool,
    withdrawn: Option<&'a AtomicBool>,
    progress: Arc<AtomicU32>,
    warnings: Mutex<Vec<String>>,
}

impl<'a> Job<'a> {
    /// A job over these inputs, by the text of the references that name them.
    ///
    /// `seed` is the pipeline's, for stages that set none.
    pub fn new(inputs: BTreeMap<String, Vec<Input>>, files: &'a dyn FileSource, seed: u64, interrupted: &'a AtomicBool) -> Self {
        let (earlier, parts) = (Vec::new(), Vec::new());
        Self { inputs, files, earlier, parts, seed, interrupted, withdrawn: None, progress: Arc::default(), warnings: Mutex::default() }
    }

    /// The same job, saying how far it is through a handle that a display looks at.
    #[must_use]
    pub fn with_progress(mut self, progress: Arc<AtomicU32>) -> Self {
        self.progress = progress;
        self
    }

    /// The same job with the results of one that it can go on from.
    #[must_use]
    pub fn with_earlier(mut self, earlier: Vec<AnyArtifact>) -> Self {
        self.earlier = earlier;
        self
    }

    /// A result to go on from, if the store has one of the kind's `prefixes`: the first of that type.
    pub fn earlier<T: Artifact>(&self) -> Option<Arc<T>> {
        self.earlier.iter().find_map(|artifact| artifact.clone().get())
    }

    /// The same job with what its parts have given.
    #[must_use]
    pub fn with_parts(mut self, parts: Vec<PartResults>) -> Self {
        self.parts = parts;
        self
    }

    /// The results of that type of the job's parts, in the order of the kind's `parts`, each fetched when the iterator reaches it.
    ///
    /// Parts that a result to go on from holds already are left out; so are all where nothing is split.
    pub fn parts<T: Artifact>(&self) -> impl Iterator<Item = Result<Arc<T>, StageError>> {
        let of_type = |part: &PartResults| part.iter().find(|(type_name, _)| *type_name == T::TYPE).map(|(_, way)| way.fetch());
        let taken = |artifact: AnyArtifact| artifact.get().ok_or_else(|| StageError::content(format!("a part gave no `{}`", T::TYPE)));
        self.parts.iter().filter_map(of_type).map(move |artifact| artifact.and_then(taken))
    }

    /// The same job, to stop also when this is set: another run computes it already.
    #[must_use]
    pub fn with_withdrawal(mut self, withdrawn: &'a AtomicBool) -> Self {
        self.withdrawn = Some(withdrawn);
        self
    }

    /// What stands on a port.
    pub fn input<T: Accepts>(&self, port: &Port<T>) -> Result<T::Value, StageError> {
        let input = self.inputs_named(port.reference()).first().expect("the plan gives each port its input");
        taken::<T>(input.source.fetch()?)
    }

    /// What stands on a port that may be absent.
    pub fn optional_input<T: Accepts>(&self, port: &Option<Port<T>>) -> Result<Option<T::Value>, StageError> {
        port.as_ref().map(|port| self.input(port)).transpose()
    }

    /// How many artifacts a collecting port has.
    pub fn collected_count<T>(&self, ports: &Ports<T>) -> usize {
        ports.references().iter().map(|reference| self.inputs_named(reference).len()).sum()
    }

    /// The artifacts of a collecting port, one after the other, each fetched when the iterator reaches it.
    pub fn collected<'j, T: Accepts>(
        &'j self,
        ports: &'j Ports<T>,
    ) -> impl Iterator<Item = Result<Collected<'j, T::Value>, StageError>> + 'j {
        ports.references().iter().flat_map(|reference| self.inputs_named(reference)).map(|input| {
            let value = taken::<T>(input.source.fetch()?)?;
            Ok(Collected { label: &input.label, columns: &input.columns, value })
        })
    }

    /// All bytes of an input file.
    pub fn read(&self, file: &InputFile) -> Result<Vec<u8>, StageError> {
        self.files.read(&file.0)
    }

    /// The seed to draw with.
    pub fn seed(&self, seed: Seed) -> u64 {
        seed.0.unwrap_or(self.seed)
    }

    /// Asked at least every 50 ms: an error once the run, or this job, is to stop.
    pub fn check(&self) -> Result<(), StageError> {
        let is_set = |flag: &AtomicBool| flag.load(Ordering::Relaxed);
        if is_set(self.interrupted) || self.withdrawn.is_some_and(is_set) { Err(StageError::Interrupted) } else { Ok(()) }
    }

    /// Says how far the job is, from 0 to 1.
    pub fn report_progress(&self, fraction: f32) {
        self.progress.store((fraction.clamp(0.0, 1.0) * 1000.0) as u32, Ordering::Relaxed);
    }

    /// How far the job said it is, in thousandths.
    pub fn progress_permille(&self) -> u32 {
        self.progress.load(Ordering::Relaxed)
    }

    /// Notes something for the reader of the manifest. Must not depend on threads or time.
    pub fn warn(&self, message: impl Into<String>) {
        self.warnings.lock().expect("no one panics while noting a warning").push(message.into());
    }

    /// Takes the warnings out.
    pub fn take_warnings(&self) -> Vec<String> {
        std::mem::take(&mut *self.warnings.lock().expect("no one panics while noting a warning"))
    }

    fn inputs_named(&self, reference: &str) -> &[Input] {
        self.inputs.get(reference).map(Vec::as_slice).unwrap_or_default()
    }
}

fn taken<T: Accepts>(artifact: AnyArtifact) -> Result<T::Value, StageError> {
    let found = artifact.type_name();
    // A record that was swapped with another object of the store shows itself here at the latest.
    T::take(artifact).ok_or_else(|| StageError::content(format!("expected {}, found `{found}`", T::TYPES.join(" or "))))
}

/// One artifact of a collecting port.
pub struct Collected<'a, T> {
    /// Name of the stage it comes from.
    pub label: &'a str,
    /// Its collapsed axes and their fields.
    pub columns: &'a [(String, Scalar)],
    /// The value.
    pub value: T,
}

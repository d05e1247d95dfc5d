//! Values that pass between jobs in memory, and the way back to the store for those that do not.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};

use crate::engine::artifact::{AnyArtifact, ArtifactKind};
use crate::engine::digest::Digest;
use crate::engine::graph::Graph;
use crate::engine::job::Fetch;
use crate::engine::publish::OutputFolder;
use crate::engine::stage::StageError;
use crate::engine::store::committer::Submit;
use crate::engine::store::library::{INLINE_LIMIT, Library, Lost};
use crate::engine::store::record::Blob;

/// What the job threads share. Only the scheduler decides; here are the values and the ways to them.
pub struct Shared {
    /// The pipeline.
    pub graph: Graph,
    /// The store.
    pub library: Arc<Library>,
    /// Where files are published.
    pub outputs: OutputFolder,
    /// Set when the run is to stop.
    pub interrupted: Arc<AtomicBool>,
    /// Takes records in.
    pub submit: Submit,
    artifacts: BTreeMap<&'static str, ArtifactKind>,
    slots: Vec<Vec<Mutex<Option<AnyArtifact>>>>,
    held: AtomicU64,
}

/// Where a result can be had.
#[derive(Debug, Clone)]
pub struct Source {
    /// Index of the job that gives it.
    pub job: usize,
    /// Index of the result.
    pub result: usize,
    /// Key of that job.
    pub key: Digest,
    /// Its bytes.
    pub blob: Blob,
    /// Whether others will want it too, so that it is kept in memory once it is read.
    pub is_shared: bool,
}

impl Shared {
    /// Nothing is in memory yet.
    pub fn new(
        graph: Graph,
        artifacts: BTreeMap<&'static str, ArtifactKind>,
        library: Arc<Library>,
        outputs: OutputFolder,
        interrupted: Arc<AtomicBool>,
        submit: Submit,
    ) -> Self {
        let slots_of = |stage: usize| graph.stages[stage].results.iter().map(|_| Mutex::default()).collect();
        let slots = graph.jobs.iter().map(|job| slots_of(job.stage)).collect();
        Self { graph, library, outputs, interrupted, submit, artifacts, slots, held: AtomicU64::new(0) }
    }

    /// Bytes that values hold in memory.
    pub fn held(&self) -> u64 {
        self.held.load(Ordering::Relaxed)
    }

    /// Bytes that one value holds in memory; `None` if it is not there.
    pub fn held_by(&self, job: usize, result: usize) -> Option<u64> {
        // A slot that is locked is being read from the store: soon it will be there.
        self.slots[job][result].try_lock().ok()?.as_ref().map(AnyArtifact::memory)
    }

    /// Keeps a value in memory.
    pub fn keep(&self, job: usize, result: usize, artifact: AnyArtifact) {
        let memory = artifact.memory();
        let before = self.slots[job][result].lock().expect(NO_PANIC).replace(artifact);
        self.held.fetch_add(memory, Ordering::Relaxed);
        self.held.fetch_sub(before.map_or(0, |before| before.memory()), Ordering::Relaxed);
    }

    /// Lets the values of a job go; whoever is using one keeps it until it is done.
    pub fn drop_values(&self, job: usize) {
        for slot in &self.slots[job] {
            let before = slot.lock().expect(NO_PANIC).take();
            self.held.fetch_sub(before.map_or(0, |before| before.memory()), Ordering::Relaxed);
        }
    }

    /// A result, from memory or else from the store, verified.
    pub fn value(&self, source: &Source) -> Result<AnyArtifact, Lost> {
        let mut slot = self.slots[source.job][source.result].lock().expect(NO_PANIC);
        if let Some(artifact) = &*slot {
            return Ok(artifact.clone());
        }
        let artifact = self.stored_value(source)?;
        if source.is_shared {
            self.held.fetch_add(artifact.memory(), Ordering::Relaxed);
            *slot = Some(artifact.clone());
        }
        Ok(artifact)
    }

    fn stored_value(&self, source: &Source) -> Result<AnyArtifact, Lost> {
        let type_name = self.graph.stages[self.graph.jobs[source.job].stage].results[source.result].1;
        let kind = self.artifacts.get(type_name).expect("the registry has every type of the graph");
        if source.blob.inline.is_some() || source.blob.size >= INLINE_LIMIT {
            return self.library.read_artifact(kind, &source.blob);
        }
        let record = self.library.expected_result(&source.key)?;
        let output = record.outputs.get(source.result).ok_or(Lost::Missing)?;
        if output.content.digest != source.blob.digest {
            return Err(Lost::Missing);
        }
        self.library.read_artifact(kind, &output.content)
    }

    /// The row of an artifact type.
    pub fn artifact_kind(&self, type_name: &str) -> &ArtifactKind {
        self.artifacts.get(type_name).expect("the registry has every type of the graph")
    }
}

const NO_PANIC: &str = "no one panics while holding a value's lock";

/// Results that the store lost while a job wanted them.
pub type LostResults = Arc<Mutex<Vec<(usize, Lost)>>>;

/// Gives a collected artifact when the stage reaches it.
pub struct Fetcher {
    /// Where the values are.
    pub shared: Arc<Shared>,
    /// Which one.
    pub source: Source,
    /// Takes note if the store has lost it.
    pub lost: LostResults,
}

impl Fetch for Fetcher {
    fn fetch(&self) -> Result<AnyArtifact, StageError> {
        self.shared.value(&self.source).map_err(|lost| {
            let reason = lost.reason();
            self.lost.lock().expect("no one panics while noting a loss").push((self.source.job, lost));
            StageError::content(format!("an input's {reason}"))
        })
    }
}

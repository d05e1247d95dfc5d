//! One run from a checked graph to its manifest: plan, schedule, publish, record.

pub mod ahead;
pub mod memory;
mod restoration;

use std::collections::{BTreeMap, BTreeSet};
use std::hash::{BuildHasher, Hasher};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

use super::artifact::ArtifactKind;
use super::digest::Digest;
use super::events::{Event, Failure, Listener};
use super::executor::ExecutorError;
use super::freshness::{self, InputError, Plan};
use super::graph::Graph;
use super::history::History;
use super::lines;
use super::manifest::{
    JobEntry, Machine, Manifest, Measured, Outcome, Program, PublishedEntry, SCHEMA, ShortManifest, SpecEntry, Standing, Status,
    WarningEntry, result_id,
};
use super::provenance::ro_crate;
use super::publish::OutputFolder;
use super::registry::Registry;
use super::schedule::role::Role;
use super::schedule::values::Shared;
use super::schedule::{Finished, Ledger, Scheduler, Settings, World};
use super::signature::{Content, Signatures};
use super::store::address::{Remote, Unusable};
use super::store::committer::Committer;
use super::store::folder::FolderStore;
use super::store::index::Index;
use super::store::library::Library;
use super::store::tiers::Tiers;
use super::system::{SystemError, beside, let_go};
use super::team::folder::{Assignment, RunFolder, plan_digest};
use super::team::hand::Hand;
use super::team::overseer::{Hiring, Overseer};
use ahead::{Ahead, Known, Latest};
use memory::{Finished as Remembered, Note, RECORDS, contents};

/// Where a run reads and writes.
#[derive(Debug, Clone)]
pub struct Places {
    /// The folder of outputs.
    pub outputs: PathBuf,
    /// The folder of the store.
    pub store: PathBuf,
    /// Whether others may write to the store too.
    pub may_share_store: bool,
    /// A store elsewhere, behind this one.
    pub remote: Option<Remote>,
}

impl Places {
    /// The store; an error if it is open to others and may not be.
    pub fn folder_store(&self) -> Result<FolderStore, SystemError> {
        FolderStore::open(&self.store, self.may_share_store)
    }

    /// What stands in the store and in the one behind it; the same error. One that cannot be reached is done without.
    pub fn library(&self) -> Result<Library, SystemError> {
        self.library_over(self.folder_store()?)
    }

    /// The same, of a folder that was opened in another way.
    pub fn library_over(&self, near: FolderStore) -> Result<Library, SystemError> {
        let Some(remote) = &self.remote else { return Ok(Library::new(Arc::new(near))) };
        match remote.open(self.may_share_store) {
            Ok(far) => Ok(Library::new(Arc::new(Tiers::new(near, far)))),
            Err(Unusable::Refused(error)) => Err(error),
            Err(Unusable::Gone(error)) => {
                let library = Library::new(Arc::new(near));
                library.notice(format!("the remote store is done without: {error}"));
                Ok(library)
            }
        }
    }

    fn pipeline_folder(&self, graph: &Graph) -> PathBuf {
        self.outputs.join(&graph.pipeline)
    }
}

/// Why there was no run at all, or none that could be recorded.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// Named input files cannot be read.
    #[error("{}", .0.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n"))]
    Inputs(Vec<InputError>),
    /// The operating system failed.
    #[error(transparent)]
    System(#[from] SystemError),
}

/// What a run came to.
#[derive(Debug)]
pub struct Summary {
    /// Name of the run.
    pub run_id: String,
    /// See [`result_id`].
    pub result_id: Digest,
    /// How it ended.
    pub status: Status,
    /// The run whose results stand, if this one changed nothing.
    pub results_of: Option<String>,
    /// The manifest of the results.
    pub manifest: PathBuf,
    /// Times and counts.
    pub measured: Measured,
    /// Why jobs failed.
    pub failures: Vec<Failure>,
    /// What the reader of the results must know.
    pub warnings: Vec<WarningEntry>,
    /// What the operating system refused beside the jobs (the store could not be written).
    pub system_error: Option<SystemError>,
    /// Why there were no workers to go on with.
    pub no_workers: Option<ExecutorError>,
}

fn planned(graph: &Graph, ahead: Ahead) -> Result<(Known, Plan), RunError> {
    let mut known = ahead.known()?;
    let plan = freshness::plan(graph, &known.library, &known.index, &mut known.signatures).map_err(RunError::Inputs)?;
    Ok((known, plan))
}

/// What would run and why, as entries of a manifest; writes nothing.
pub fn plan(graph: &Graph, ahead: Ahead) -> Result<(Vec<JobEntry>, Vec<String>), RunError> {
    let folder = ahead.places().pipeline_folder(graph);
    let (known, plan) = planned(graph, ahead)?;
    let mut history = History::new(folder, graph, known.latest.run);
    Ok((freshness::entries(graph, &plan, &mut history), known.library.take_notices()))
}

/// Runs a pipeline: computes what the store lacks, or has workers compute it, publishes, and writes the manifest.
pub fn run(
    graph: Graph,
    registry: &Registry,
    ahead: Ahead,
    settings: Settings,
    interrupted: Arc<AtomicBool>,
    hiring: Option<Hiring<'_>>,
    listener: &mut dyn Listener,
) -> Result<Summary, RunError> {
    let clock = Clock::start();
    let places = &ahead.places().clone();
    let outputs = OutputFolder::at(&places.outputs, &graph.pipeline);
    let (mut known, plan) = planned(&graph, ahead)?;
    let Latest { standing, run } = std::mem::take(&mut known.latest);
    outputs.prepare()?;
    known.library.tidy();
    memory::tell_damage(&graph, places, &known.library);
    let role = role(&graph, &plan, places, &known.library, settings, hiring)?;
    let (library, index) = (known.library.clone(), &known.index);
    let history = History::new(outputs.path(), &graph, run);
    let world = World { history, index, signatures: &mut known.signatures, standing: standing.as_ref(), began: clock.steady, role };
    let (shared, finished) = execute(graph, registry, plan, library, &outputs, world, settings, interrupted, listener);
    let summary = conclude(&shared, finished, known, standing, places, settings, &clock, listener);
    let_go(shared);
    summary
}

/// What this process does of the run: all of it, or it has a folder with workers from here on.
fn role(
    graph: &Graph,
    plan: &Plan,
    places: &Places,
    library: &Library,
    settings: Settings,
    hiring: Option<Hiring<'_>>,
) -> Result<Role, SystemError> {
    let has_work = plan.jobs.iter().flatten().any(|job| job.record.is_none());
    let Some(hiring) = hiring.filter(|_| has_work) else { return Ok(Role::Alone) };
    library.prepare()?;
    let digest = plan_digest(graph, plan, places, settings.keep_going);
    let folder = RunFolder::of_plan(places, &graph.pipeline, &digest);
    let assignment = Assignment::new(graph, plan, digest, hiring.request, places, settings.keep_going);
    Ok(Role::Driver(Box::new(Overseer::begin(folder, &assignment, hiring)?)))
}

#[expect(clippy::too_many_arguments, reason = "joins what the run is made of, once")]
fn execute(
    graph: Graph,
    registry: &Registry,
    plan: Plan,
    library: Arc<Library>,
    outputs: &OutputFolder,
    world: World<'_>,
    settings: Settings,
    interrupted: Arc<AtomicBool>,
    listener: &mut dyn Listener,
) -> (Arc<Shared>, Finished) {
    let artifacts: BTreeMap<&'static str, ArtifactKind> = registry.artifacts().iter().map(|(name, kind)| (name, *kind)).collect();
    let committer = Committer::new(library.clone());
    let shared = Arc::new(Shared::new(graph, artifacts, library, outputs.clone(), interrupted, committer.submit()));
    let mut scheduler = Scheduler::new(shared.clone(), plan, world, committer, settings, listener);
    scheduler.run();
    (shared, scheduler.finish())
}

/// What came of a worker.
#[derive(Debug)]
pub struct Service {
    /// Jobs by what became of them as far as this worker knows.
    pub jobs: BTreeMap<&'static str, usize>,
    /// Why jobs failed.
    pub failures: Vec<Failure>,
    /// Whether it was told to stop.
    pub was_interrupted: bool,
    /// What the operating system refused beside the jobs.
    pub system_error: Option<SystemError>,
}

/// Computes jobs of a run that another process publishes, until there are no more; `None` if that run rests on other inputs
/// or results than those that are seen from here.
pub fn work(
    mut graph: Graph,
    registry: &Registry,
    assignment: &Assignment,
    settings: Settings,
    hand: Hand,
    listener: &mut dyn Listener,
) -> Result<Option<Service>, RunError> {
    let (places, began) = (assignment.places(), Instant::now());
    // What is published and what is to run again whatever the store has is the driver's affair.
    for job in &mut graph.jobs {
        job.publications.clear();
        job.is_forced = false;
    }
    let (mut known, plan) = planned(&graph, Ahead::begin(&places, &graph.pipeline))?;
    if plan_digest(&graph, &plan, &places, settings.keep_going) != assignment.plan {
        return Ok(None);
    }
    known.library.tidy();
    let outputs = OutputFolder::at(&places.outputs, &graph.pipeline);
    let (library, index, interrupted) = (known.library.clone(), &known.index, hand.interrupted.clone());
    let history = History::new(outputs.path(), &graph, known.latest.run.take());
    let role = Role::Worker(Box::new(hand));
    let world = World { history, index, signatures: &mut known.signatures, standing: None, began, role };
    let (_, finished) = execute(graph, registry, plan, library, &outputs, world, settings, interrupted, listener);
    let mut jobs = BTreeMap::new();
    for entry in &finished.entries {
        *jobs.entry(entry.outcome.word()).or_default() += 1;
    }
    let Finished { ledger, was_interrupted, committed, .. } = finished;
    Ok(Some(Service { jobs, failures: ledger.failures, was_interrupted, system_error: committed.err() }))
}

/// After the jobs: removes what is no longer published, updates the caches, writes the manifest.
#[expect(clippy::too_many_arguments, reason = "takes apart what the run was made of, once")]
fn conclude(
    shared: &Shared,
    finished: Finished,
    mut known: Known,
    standing: Option<Standing>,
    places: &Places,
    settings: Settings,
    clock: &Clock,
    listener: &mut dyn Listener,
) -> Result<Summary, RunError> {
    let graph = &shared.graph;
    let outputs = &shared.outputs;
    let Finished { entries, mut ledger, was_interrupted, committed } = finished;
    ledger.published.sort();
    let status = match () {
        () if was_interrupted => Status::Interrupted,
        () if !ledger.failures.is_empty() || ledger.no_workers.is_some() || committed.is_err() => Status::Failed,
        () => Status::Done,
    };

    let earlier = files_left_over(standing.as_ref(), &ledger.published);
    let is_complete = status == Status::Done && graph.is_whole;
    let (removed, kept) =
        if is_complete { (remove_unedited(outputs, &earlier, &mut known.signatures, &mut ledger)?, Vec::new()) } else { (0, earlier) };

    let mut system_error = committed.err();
    let measured = measured(clock.measured(settings), &entries, &ledger, removed);
    ledger.take_notices(&known.library);
    let warnings = warning_entries(graph, &entries, std::mem::take(&mut ledger.warnings));
    let result_id = result_id(&entries, &ledger.published);
    let run_id = new_run_folder(outputs, clock)?;
    let changed_nothing = measured.files_written + removed == 0 && entries.iter().all(|entry| entry.outcome == Outcome::Hit);
    let results_of = standing.filter(|standing| changed_nothing && standing.stands_for(status, &result_id)).map(|standing| standing.run_id);
    let manifest = Manifest {
        schema: SCHEMA.into(),
        pipeline: graph.pipeline.clone(),
        run_id: run_id.clone(),
        result_id,
        status,
        whole: graph.is_whole,
        seed: graph.seed,
        spec: spec_entries(graph),
        overrides: graph.overrides.clone(),
        jobs: entries,
        published: std::mem::take(&mut ledger.published),
        kept,
        warnings: warnings.clone(),
        program: Program::this(),
        machine: Machine::this(),
        measured: measured.clone(),
    };
    let kept = write_records(shared, places, &manifest, results_of.as_deref(), known, &mut ledger, system_error.is_none())?;
    system_error = system_error.or(kept.err());
    for warning in &warnings {
        listener.notify(&Event::Warning { stage: warning.stage.clone(), message: warning.message.clone() });
    }
    listener.notify(&Event::Ended { run_id: run_id.clone(), status, seconds: measured.seconds });
    let_go(manifest);
    let manifest = outputs.path().join("manifest.json");
    let Ledger { failures, no_workers, .. } = ledger;
    Ok(Summary { run_id, result_id, status, results_of, manifest, measured, failures, warnings, system_error, no_workers })
}

/// Writes the manifest with the crate, or the short one of a run that changed nothing, and what the next run can know from it
/// into the store, of which the error is the inner one; of a run whose store could not be written nothing is kept there.
fn write_records(
    shared: &Shared,
    places: &Places,
    manifest: &Manifest,
    results_of: Option<&str>,
    known: Known,
    ledger: &mut Ledger,
    is_kept: bool,
) -> Result<Result<(), SystemError>, SystemError> {
    let (graph, outputs) = (&shared.graph, &shared.outputs);
    let Known { library, index: earlier_index, mut signatures, .. } = known;
    let (index, store) = (std::mem::take(&mut ledger.index), library.clone());
    let keep_index = || if is_kept { keep_index(index, earlier_index, &store, &graph.pipeline) } else { Ok(()) };
    let mut keep_signatures = || {
        let kept = if is_kept { keep_signatures(&mut signatures, &library, outputs, &manifest.published, &ledger.written) } else { Ok(()) };
        let published = contents(&manifest.published, |path| ledger.publication_keys.get(path));
        // What is said once is not for a note.
        let published = published.filter(|_| manifest.status == Status::Done && is_kept && !ledger.has_passing_warnings);
        let run_id = results_of.unwrap_or(&manifest.run_id);
        let found = |published| Remembered { graph, manifest, outputs, published, run_id };
        let note = published.and_then(|published| Note::of(&found(published), places, &mut signatures));
        kept.map(|()| note)
    };
    let (kept_index, note, records) = match results_of {
        Some(earlier) => {
            let kept = (keep_index(), keep_signatures());
            write_short(outputs, &manifest.pipeline, &manifest.run_id, manifest.result_id, earlier, &manifest.measured)?;
            (kept.0, kept.1, memory::records_of(outputs, earlier))
        }
        None => {
            let Written { records, beside_metadata, beside_record } = write_whole(outputs, manifest, keep_index, keep_signatures)?;
            (beside_metadata, beside_record, Some(records))
        }
    };
    Ok(kept_index.and(note).and_then(|note| match note.zip(records) {
        Some((note, records)) => note.keep(records, outputs, &library, &mut signatures),
        None => Ok(()),
    }))
}

/// Times and counts of a run, of which the times are given.
fn measured(times: Measured, entries: &[JobEntry], ledger: &Ledger, files_removed: u64) -> Measured {
    let mut jobs: BTreeMap<String, u64> = BTreeMap::new();
    for entry in entries {
        *jobs.entry(entry.outcome.word().to_owned()).or_default() += 1;
    }
    Measured { memory_peak: ledger.memory_peak, files_written: ledger.written.len() as u64, files_removed, jobs, ..times }
}

/// Files that the last run stood behind and this one does not.
fn files_left_over(standing: Option<&Standing>, published: &[PublishedEntry]) -> Vec<PublishedEntry> {
    let present: BTreeSet<&str> = published.iter().map(|entry| entry.path.as_str()).collect();
    let earlier = standing.into_iter().flat_map(|standing| standing.published.iter().chain(&standing.kept));
    earlier.filter(|entry| !present.contains(entry.path.as_str())).cloned().collect()
}

/// Removes files of earlier runs that no one has changed since; returns their number.
fn remove_unedited(
    outputs: &OutputFolder,
    files: &[PublishedEntry],
    signatures: &mut Signatures,
    ledger: &mut Ledger,
) -> Result<u64, SystemError> {
    let mut removed = 0;
    for entry in files {
        let Some(found) = outputs.content_of(&entry.path, signatures) else { continue };
        if found == entry.sha256 {
            outputs.remove(&entry.path)?;
            removed += 1;
        } else {
            ledger.has_passing_warnings = true;
            let message = format!("`{}` is of an earlier run and has been changed since: it was left in place", entry.path);
            ledger.warnings.push((String::new(), message));
        }
    }
    Ok(removed)
}

/// Writes the index if this run learnt something.
fn keep_index(index: Index, earlier: Index, library: &Library, pipeline: &str) -> Result<(), SystemError> {
    if index.is_within(&earlier) { Ok(()) } else { index.keep(earlier, library, pipeline) }
}

/// Writes the signatures if this run learnt something.
fn keep_signatures(
    signatures: &mut Signatures,
    library: &Library,
    outputs: &OutputFolder,
    published: &[PublishedEntry],
    written: &[String],
) -> Result<(), SystemError> {
    for path in written {
        let entry = published.binary_search_by(|entry| entry.path.as_str().cmp(path));
        if let (Some(signature), Ok(entry)) = (outputs.signature(path), entry) {
            signatures.remember(signature, published[entry].sha256);
        }
    }
    signatures.keep_in(library)
}

/// Each warning once per stage, with the number of jobs that gave it.
fn warning_entries(graph: &Graph, entries: &[JobEntry], others: Vec<(String, String)>) -> Vec<WarningEntry> {
    let of_jobs = entries.iter().flat_map(|entry| entry.warnings.iter().map(|text| (entry.stage.clone(), text.clone())));
    let mut counts: BTreeMap<(String, String), u64> = BTreeMap::new();
    for warning in of_jobs.chain(others) {
        *counts.entry(warning).or_default() += 1;
    }
    let order: BTreeMap<&str, usize> = graph.stages.iter().enumerate().map(|(index, stage)| (stage.name.as_str(), index)).collect();
    let mut warnings: Vec<WarningEntry> =
        counts.into_iter().map(|((stage, message), jobs)| WarningEntry { stage, message, jobs }).collect();
    // By the order of the stages in the file; what no stage is to blame for comes last.
    warnings.sort_by_key(|warning| order.get(warning.stage.as_str()).copied().unwrap_or(usize::MAX));
    warnings
}

fn spec_entries(graph: &Graph) -> Vec<SpecEntry> {
    let entry = |source: &super::graph::Source| SpecEntry {
        path: source.path.clone(),
        sha256: Digest::of(source.text.as_bytes()),
        text: source.text.clone(),
    };
    graph.sources.iter().map(entry).collect()
}

/// The records of a run are written, and something else was done on each of the two threads that wrote them.
struct Written<M, R> {
    /// What is in them, in the order of [`RECORDS`].
    records: [Content; 2],
    beside_metadata: M,
    beside_record: R,
}

/// Writes the records of a run on two threads, each of which does something else besides.
fn write_whole<M: Send, R>(
    outputs: &OutputFolder,
    manifest: &Manifest,
    beside_metadata: impl FnOnce() -> M + Send,
    beside_record: impl FnOnce() -> R,
) -> Result<Written<M, R>, SystemError> {
    let [(record, kept_record), (metadata, kept_metadata)] = RECORDS;
    for (path, text) in ro_crate::workflow_files(manifest) {
        outputs.write(&path, text.as_bytes())?;
    }
    // Both are long where there are many jobs.
    let write_metadata = || {
        let text = ro_crate::text(manifest);
        outputs.write(&run_file(&manifest.run_id, kept_metadata), text.as_bytes())?;
        outputs.write(metadata, text.as_bytes())?;
        Ok((Content::of(text.as_bytes()), beside_metadata()))
    };
    let keep_record = || {
        let text = lines::text(manifest);
        outputs.write(&run_file(&manifest.run_id, kept_record), &text)?;
        Ok((text, beside_record()))
    };
    let (metadata, kept) = beside(write_metadata, keep_record);
    let ((text, beside_record), (metadata, beside_metadata)) = (kept?, metadata?);
    // The manifest beside the files comes last: it says that they are all there.
    outputs.write(record, &text)?;
    Ok(Written { records: [Content::of(&text), metadata], beside_metadata, beside_record })
}

fn write_short(
    outputs: &OutputFolder,
    pipeline: &str,
    run_id: &str,
    result_id: Digest,
    results_of: &str,
    measured: &Measured,
) -> Result<(), SystemError> {
    let manifest = ShortManifest {
        schema: SCHEMA.into(),
        pipeline: pipeline.to_owned(),
        run_id: run_id.to_owned(),
        result_id,
        status: Status::Done,
        results_of: results_of.to_owned(),
        measured: measured.clone(),
    };
    outputs.write(&run_file(run_id, "manifest.json"), &lines::text(&manifest))
}

/// A file of a run, below the pipeline's folder of outputs.
fn run_file(run_id: &str, name: &str) -> String {
    format!("runs/{run_id}/{name}")
}

/// Makes the folder of a run under a name that no other run has.
fn new_run_folder(outputs: &OutputFolder, clock: &Clock) -> Result<String, SystemError> {
    loop {
        let run_id = format!("{}-{:06x}", clock.stamp("%Y%m%dT%H%M%SZ"), random_number() & 0xff_ffff);
        if outputs.make_new_folder(&format!("runs/{run_id}"))? {
            return Ok(run_id);
        }
    }
}

/// A number that two processes are unlikely to share; nothing that is computed depends on it.
fn random_number() -> u64 {
    std::hash::RandomState::new().build_hasher().finish()
}

/// When a run began, by the clock on the wall and by one that only goes forward.
struct Clock {
    wall: jiff::Timestamp,
    steady: Instant,
}

impl Clock {
    fn start() -> Self {
        Self { wall: jiff::Timestamp::now(), steady: Instant::now() }
    }

    fn stamp(&self, format: &str) -> String {
        self.wall.strftime(format).to_string()
    }

    fn measured(&self, settings: Settings) -> Measured {
        Measured {
            started: self.stamp("%Y-%m-%dT%H:%M:%SZ"),
            seconds: self.steady.elapsed().as_secs_f64(),
            threads: settings.threads.get() as u64,
            memory_limit: settings.memory,
            ..Measured::default()
        }
    }
}

#[cfg(test)]
mod tests;

#[cfg(test)]
mod fault_tests;

#[cfg(test)]
mod memory_tests;

#[cfg(test)]
mod sharing_tests;

#[cfg(test)]
mod damage_tests;

#[cfg(test)]
mod tiers_tests;

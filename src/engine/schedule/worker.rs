//! What a job thread does: runs one job, or encodes and publishes the files of one.

use std::any::Any;
use std::collections::{BTreeMap, HashMap};
use std::io::{self, Read, Write};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::mpsc::{Receiver, Sender};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use serde_json::Value as Json;

use super::panics;
use super::values::{Fetcher, LostResults, Shared, Source};
use crate::engine::artifact::{AnyArtifact, Origin, TypeName};
use crate::engine::digest::Digest;
use crate::engine::files::PlainFile;
use crate::engine::graph::{InputNode, PortInputs};
use crate::engine::job::{Fetch, FileSource, Input, Job, PartResults};
use crate::engine::key;
use crate::engine::stage::StageError;
use crate::engine::store::committer::Commit;
use crate::engine::store::library::{CopyError, INLINE_LIMIT, Lost};
use crate::engine::store::record::{Blob, OutputRecord, PublicationRecord, RECORD_VERSION, ResultRecord};
use crate::engine::system::SystemError;

/// Something to do.
pub enum Task {
    /// Run a job.
    Run(RunTask),
    /// Publish files of a job.
    Publish(PublishTask),
}

/// A job to run.
pub struct RunTask {
    /// Index of the job.
    pub job: usize,
    /// Its key.
    pub key: Digest,
    /// Digests of its files, in their order.
    pub files: Vec<Digest>,
    /// Where its inputs can be had: by port and item, as in the graph.
    pub sources: Vec<Vec<Source>>,
    /// Where the results of its parts can be had, by part.
    pub parts: Vec<Vec<Source>>,
    /// Bytes it is expected to need beside its inputs.
    pub memory: u64,
    /// How far it is.
    pub progress: Arc<AtomicU32>,
    /// Set when it is to be left to another run.
    pub withdrawn: Arc<AtomicBool>,
}

/// Files to publish.
pub struct PublishTask {
    /// Index of the job.
    pub job: usize,
    /// Which files, and how.
    pub files: Vec<FileToPublish>,
}

/// A file to publish.
pub struct FileToPublish {
    /// Index into the job's publications.
    pub publication: usize,
    /// See [`crate::engine::key::publication_key`].
    pub key: Digest,
    /// What is written inside.
    pub origin: Origin,
    /// Where the artifact can be had.
    pub source: Source,
    /// The encoded bytes, if the store has them.
    pub record: Option<PublicationRecord>,
}

/// What a job thread reports.
pub struct Report {
    /// Index of the job.
    pub job: usize,
    /// The thread, from 0.
    pub thread: u32,
    /// When the task began.
    pub start: Instant,
    /// How long it took.
    pub time: Duration,
    /// What came of it.
    pub body: Body,
}

/// What came of a task.
pub enum Body {
    /// A job ran.
    Ran(Result<RanJob, Fault>),
    /// Files were published: their records, by index of the publication.
    Published(Result<Vec<(usize, PublicationRecord)>, Fault>),
}

/// A job's results.
pub struct RanJob {
    /// As the store keeps them.
    pub record: ResultRecord,
    /// Bytes that each holds in memory.
    pub sizes: Vec<u64>,
}

/// Why a task gave nothing.
pub enum Fault {
    /// The stage says so.
    Failed {
        /// What is wrong.
        message: String,
        /// What to do.
        hint: Option<String>,
    },
    /// The run is to stop.
    Interrupted,
    /// It was to be left to another run.
    Withdrawn,
    /// The store has lost results of these jobs.
    Lost(Vec<(usize, Lost)>),
    /// The operating system failed.
    System(String),
}

impl From<SystemError> for Fault {
    fn from(error: SystemError) -> Self {
        Fault::System(error.to_string())
    }
}

impl From<StageError> for Fault {
    fn from(error: StageError) -> Self {
        match error {
            StageError::Content { message, hint } => Fault::Failed { message, hint },
            StageError::System { .. } => Fault::System(error.to_string()),
            StageError::Interrupted => Fault::Interrupted,
        }
    }
}

/// Takes tasks until there are no more; `thread` is the number of this one.
pub fn work(thread: u32, shared: &Arc<Shared>, tasks: &Mutex<Receiver<Task>>, reports: &Sender<Report>) {
    loop {
        let task = tasks.lock().expect("no job thread panics while it waits").recv();
        let start = Instant::now();
        let (job, body) = match task {
            Ok(Task::Run(task)) => (task.job, Body::Ran(guarded(|| run(shared, &task)))),
            Ok(Task::Publish(task)) => (task.job, Body::Published(guarded(|| publish(shared, &task)))),
            Err(_) => return,
        };
        if reports.send(Report { job, thread, start, time: start.elapsed(), body }).is_err() {
            return;
        }
    }
}

/// A panic is a fault of the program, but of one job only.
fn guarded<T>(task: impl FnOnce() -> Result<T, Fault>) -> Result<T, Fault> {
    catch_unwind(AssertUnwindSafe(task)).unwrap_or_else(|payload| Err(panic_fault(&*payload)))
}

fn panic_fault(payload: &(dyn Any + Send)) -> Fault {
    let text = payload.downcast_ref::<String>().cloned();
    let text = text.or_else(|| payload.downcast_ref::<&str>().map(|text| (*text).to_owned())).unwrap_or_default();
    let place = panics::place_of(&text).map(|place| format!(" at {place}")).unwrap_or_default();
    Fault::Failed {
        message: format!("the stage panicked{place}: {text}"),
        hint: Some("this is a fault of the program; please report it with the pipeline file".into()),
    }
}

fn run(shared: &Arc<Shared>, task: &RunTask) -> Result<RanJob, Fault> {
    let start = Instant::now();
    let node = &shared.graph.jobs[task.job];
    let lost = LostResults::default();
    let files = KeyedFiles::new(node.files.iter().map(|(_, path)| path.clone()).zip(task.files.iter().copied()));
    let inputs = inputs(shared, task, &lost)?;
    let job = Job::new(inputs, &files, shared.graph.seed, &shared.interrupted).with_progress(task.progress.clone());
    let job = job.with_withdrawal(&task.withdrawn).with_earlier(earlier(shared, task)).with_parts(parts(shared, task, &lost));

    let result = node.parameters.run(&job);
    let lost = std::mem::take(&mut *lost.lock().expect("no one panics while noting a loss"));
    if !lost.is_empty() {
        return Err(Fault::Lost(lost));
    }
    let artifacts = result.map_err(|error| match error {
        StageError::Interrupted if !shared.interrupted.load(Ordering::Relaxed) => Fault::Withdrawn,
        error => error.into(),
    })?;
    let warnings = job.take_warnings();
    drop(job);
    keep_results(shared, task, artifacts, warnings, start)
}

/// Results of the first prefix of a job that the store has whole; none where the job is to run from nothing.
///
/// What the store has lost of them is no loss to this job.
fn earlier(shared: &Shared, task: &RunTask) -> Vec<AnyArtifact> {
    let node = &shared.graph.jobs[task.job];
    let declared = &shared.graph.stages[node.stage].results;
    if node.is_forced {
        return Vec::new();
    }
    let content = |item: &InputNode| {
        let sources = task.sources.iter().flatten();
        let source = sources.into_iter().find(|source| source.job == item.job && source.result == item.result);
        source.expect("a task has a source for every input").blob.digest
    };
    let results = |prefix: &Json| {
        let key = key::key_of_prefix(&shared.graph, node, prefix, &task.files, content);
        let record = shared.library.result(&key).ok()?;
        let has_types = record.outputs.iter().map(|output| output.type_name.as_str()).eq(declared.iter().map(|(_, name)| *name));
        let outputs = record.outputs.iter().filter(|_| has_types);
        let read = |output: &OutputRecord| shared.library.read_artifact(shared.artifact_kind(&output.type_name), &output.content).ok();
        outputs.map(read).collect::<Option<Vec<_>>>().filter(|results| !results.is_empty())
    };
    node.prefixes.iter().find_map(results).unwrap_or_default()
}

/// The ways to the results of its parts.
fn parts(shared: &Arc<Shared>, task: &RunTask, lost: &LostResults) -> Vec<PartResults> {
    let types = shared.graph.stages[shared.graph.jobs[task.job].stage].results.iter().map(|(_, type_name)| *type_name);
    let fetcher = |source: &Source| Box::new(Fetcher { shared: shared.clone(), source: source.clone(), lost: lost.clone() });
    let result = |(type_name, source): (TypeName, &Source)| (type_name, fetcher(source) as Box<dyn Fetch>);
    task.parts.iter().map(|sources| types.clone().zip(sources).map(result).collect()).collect()
}

/// What stands on the ports: single inputs are read now, collected ones when the stage reaches them.
fn inputs(shared: &Arc<Shared>, task: &RunTask, lost: &LostResults) -> Result<BTreeMap<String, Vec<Input>>, Fault> {
    let ports = &shared.graph.jobs[task.job].inputs;
    let mut inputs: BTreeMap<String, Vec<Input>> = BTreeMap::new();
    for (port, sources) in ports.iter().zip(&task.sources) {
        // Two ports may name the same reference; both find the same there.
        if !inputs.contains_key(&port.reference) {
            inputs.insert(port.reference.clone(), port_inputs(shared, port, sources, lost)?);
        }
    }
    Ok(inputs)
}

fn port_inputs(shared: &Arc<Shared>, port: &PortInputs, sources: &[Source], lost: &LostResults) -> Result<Vec<Input>, Fault> {
    let input = |(item, source): (&crate::engine::graph::InputNode, &Source)| {
        let source: Box<dyn Fetch> = if port.collects {
            Box::new(Fetcher { shared: shared.clone(), source: source.clone(), lost: lost.clone() })
        } else {
            Box::new(shared.value(source).map_err(|lost| Fault::Lost(vec![(source.job, lost)]))?)
        };
        Ok(Input { label: item.label.clone(), columns: item.columns.clone(), source })
    };
    port.items.iter().zip(sources).map(input).collect()
}

fn keep_results(
    shared: &Shared,
    task: &RunTask,
    artifacts: Vec<AnyArtifact>,
    warnings: Vec<String>,
    start: Instant,
) -> Result<RanJob, Fault> {
    let declared = &shared.graph.stages[shared.graph.jobs[task.job].stage].results;
    let types: Vec<_> = artifacts.iter().map(AnyArtifact::type_name).collect();
    assert!(types.iter().eq(declared.iter().map(|(_, type_name)| type_name)), "the stage gave {types:?} where {declared:?} is declared");

    let mut outputs = Vec::with_capacity(artifacts.len());
    for ((name, type_name), artifact) in declared.iter().zip(&artifacts) {
        let content = shared.library.write_artifact(artifact)?;
        outputs.push(OutputRecord { name: (*name).to_owned(), type_name: (*type_name).to_owned(), content });
    }
    let record = ResultRecord {
        schema: RECORD_VERSION,
        key: task.key,
        outputs,
        warnings,
        seconds: start.elapsed().as_secs_f64(),
        memory: task.memory,
        program: env!("CARGO_PKG_VERSION").to_owned(),
    };
    shared.submit.submit(Commit::Result(record.clone()));
    let sizes = artifacts.iter().map(AnyArtifact::memory).collect();
    for (result, artifact) in artifacts.into_iter().enumerate() {
        shared.keep(task.job, result, artifact);
    }
    Ok(RanJob { record, sizes })
}

fn publish(shared: &Shared, task: &PublishTask) -> Result<Vec<(usize, PublicationRecord)>, Fault> {
    task.files.iter().map(|file| Ok((file.publication, publish_file(shared, task.job, file)?))).collect()
}

fn publish_file(shared: &Shared, job: usize, file: &FileToPublish) -> Result<PublicationRecord, Fault> {
    if shared.interrupted.load(Ordering::Relaxed) {
        return Err(Fault::Interrupted);
    }
    let publication = &shared.graph.jobs[job].publications[file.publication];
    if let Some(record) = &file.record
        && restore(shared, record, &publication.path)?
    {
        return Ok(record.clone());
    }

    let artifact = shared.value(&file.source).map_err(|lost| Fault::Lost(vec![(file.source.job, lost)]))?;
    let saved = artifact
        .save(&publication.format, &file.origin)
        .map_err(|error| Fault::Failed { message: format!("cannot be saved as `{}`: {error}", publication.format), hint: None })?;
    let content = shared.library.write_bytes(&saved.bytes)?;
    let record = PublicationRecord { schema: RECORD_VERSION, key: file.key, content, warnings: saved.warnings };
    shared.submit.submit(Commit::Publication(record.clone()));
    shared.outputs.write(&publication.path, &saved.bytes)?;
    Ok(record)
}

/// Copies encoded bytes from the store; false if the store has lost them.
fn restore(shared: &Shared, record: &PublicationRecord, path: &str) -> Result<bool, Fault> {
    let Some(blob) = full_blob(shared, record) else { return Ok(false) };
    let mut draft = shared.outputs.begin()?;
    match shared.library.copy_blob(&blob, &mut draft) {
        Ok(()) => {}
        Err(CopyError::Lost(_)) => return Ok(false),
        Err(CopyError::Target(error)) => return Err(SystemError::at("write", shared.outputs.path().join(path))(error).into()),
    }
    draft.flush().map_err(SystemError::at("write", shared.outputs.path().join(path)))?;
    draft.publish(path)?;
    Ok(true)
}

/// The blob of an encoded file; the index leaves out the bytes that the record itself holds.
fn full_blob(shared: &Shared, record: &PublicationRecord) -> Option<Blob> {
    if record.content.inline.is_some() || record.content.size >= INLINE_LIMIT {
        return Some(record.content.clone());
    }
    let full = shared.library.expected_publication(&record.key).ok()?;
    (full.content.digest == record.content.digest).then_some(full.content)
}

/// Input files, each checked against the digest that is in the key.
struct KeyedFiles(HashMap<PathBuf, Digest>);

impl KeyedFiles {
    fn new(files: impl Iterator<Item = (PathBuf, Digest)>) -> Self {
        Self(files.collect())
    }
}

impl FileSource for KeyedFiles {
    fn read(&self, path: &Path) -> Result<Vec<u8>, StageError> {
        let digest = self.0.get(path).expect("a stage reads only files that it declares");
        let changed = || {
            let message = format!("`{}` changed while the pipeline ran", path.display());
            StageError::content_with_hint(message, "run again once nothing writes to it")
        };
        let mut bytes = Vec::new();
        match PlainFile::open_named(path.to_owned()).and_then(|mut file| file.read_to_end(&mut bytes)) {
            Ok(_) if Digest::of(&bytes) == *digest => Ok(bytes),
            Ok(_) => Err(changed()),
            Err(error) if matches!(error.kind(), io::ErrorKind::NotFound | io::ErrorKind::InvalidData) => Err(changed()),
            Err(source) => Err(StageError::System { context: format!("cannot read `{}`", path.display()), source }),
        }
    }
}

//! The folder of a run with workers: what the run is, who works on it, what failed, and whether it is to end.
//!
//! `OUTPUTS/NAME/runs/team-ID/`, where ID is the beginning of the plan's digest, so that whoever asks for the same work
//! finds the same folder. Files are written whole under a name of their own and then linked to their final name, never over
//! another; on a file server, a reader then sees all of a file or none.

use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::SystemTime;

use serde::{Deserialize, Serialize};

use crate::engine::digest::Digest;
use crate::engine::events::Failure;
use crate::engine::files;
use crate::engine::freshness::Plan;
use crate::engine::graph::Graph;
use crate::engine::lines::line;
use crate::engine::manifest::Program;
use crate::engine::request::Request;
use crate::engine::resources::{Resources, classes};
use crate::engine::run::Places;
use crate::engine::source::Texts;
use crate::engine::store::claims::Claims;
use crate::engine::system::{SystemError, temporary_name};

/// Name and version of the form of an assignment.
const SCHEMA: &str = "pipeline-team-1";

/// With this the names of these folders begin, so that they are not taken for those of finished runs.
const PREFIX: &str = "team-";

/// Hexadecimal digits of a run's id.
const ID_LENGTH: usize = 12;

const ASSIGNMENT: &str = "assignment.json";

/// What the run is; written once.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Assignment {
    schema: String,
    /// Name of the pipeline.
    pub pipeline: String,
    /// See [`plan_digest`].
    pub plan: Digest,
    /// The program that planned it; another one may compute something else.
    program: Program,
    /// The working folder, to which paths are relative.
    folder: PathBuf,
    file: PathBuf,
    parameters: Vec<(String, String)>,
    axes: Vec<(String, String)>,
    seed: Option<String>,
    only: Vec<String>,
    max_jobs: u64,
    /// The texts of the pipeline as they were read, by path.
    texts: Vec<(PathBuf, String)>,
    outputs: PathBuf,
    store: PathBuf,
    may_share_store: bool,
    /// Whether jobs that do not depend on a failed one are still computed.
    pub keep_going: bool,
    /// What the classes of workers have, by number.
    pub classes: Vec<Resources>,
    /// Jobs of the run, with the parts of those that have to be computed.
    pub jobs: usize,
    /// Those that were in the store when it was planned.
    pub hits: usize,
}

/// Identity of a plan: equal for those who are to compute the same jobs in the same store.
///
/// Over the recipes of the wanted jobs, which hold all that their results depend on, and into what they are split. What is published, forced or in the
/// store already does not matter to it.
pub fn plan_digest(graph: &Graph, plan: &Plan, places: &Places, keep_going: bool) -> Digest {
    let store = std::path::absolute(&places.store).unwrap_or_else(|_| places.store.clone());
    let mut text = line(&(SCHEMA, &graph.pipeline, Program::this(), keep_going, store)).into_bytes();
    for (node, planned) in graph.jobs.iter().zip(&plan.jobs) {
        if let Some(planned) = planned {
            text.extend(planned.recipe.0);
            let stage = &graph.stages[node.stage];
            text.extend(line(&(stage.resources, stage.split)).bytes());
        }
    }
    Digest::of(&text)
}

impl Assignment {
    /// What a worker needs to get the same graph.
    pub fn new(graph: &Graph, plan: &Plan, digest: Digest, request: &Request, places: &Places, keep_going: bool) -> Self {
        let absolute = |path: &Path| std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
        let wanted = plan.jobs.iter().flatten();
        let parts = graph.jobs.iter().zip(&plan.jobs).filter(|(_, planned)| planned.as_ref().is_some_and(|job| job.record.is_none()));
        Self {
            schema: SCHEMA.into(),
            pipeline: graph.pipeline.clone(),
            plan: digest,
            program: Program::this(),
            folder: std::env::current_dir().unwrap_or_default(),
            file: request.file.clone(),
            parameters: request.parameters.clone(),
            axes: request.axes.clone(),
            seed: request.seed.clone(),
            only: request.only.clone(),
            max_jobs: request.max_jobs,
            texts: graph.sources.iter().map(|source| (source.read_as.clone(), source.text.clone())).collect(),
            outputs: absolute(&places.outputs),
            store: absolute(&places.store),
            may_share_store: places.may_share_store,
            keep_going,
            classes: classes(graph),
            jobs: wanted.clone().count() + parts.map(|(node, _)| node.parts.len()).sum::<usize>(),
            hits: wanted.filter(|job| job.record.is_some()).count(),
        }
    }

    /// What to ask of the engine, in the folder in which it was asked first.
    pub fn request(&self) -> Request {
        let texts: Texts = self.texts.iter().cloned().collect();
        Request {
            parameters: self.parameters.clone(),
            axes: self.axes.clone(),
            seed: self.seed.clone(),
            only: self.only.clone(),
            max_jobs: self.max_jobs,
            texts: Some(Arc::new(texts)),
            ..Request::of_file(&self.file)
        }
    }

    /// Where the run writes.
    pub fn places(&self) -> Places {
        Places { outputs: self.outputs.clone(), store: self.store.clone(), may_share_store: self.may_share_store, remote: None }
    }

    /// The folder to which its paths are relative.
    pub fn folder(&self) -> &Path {
        &self.folder
    }
}

/// Why there is no such run, or none for this program.
#[derive(Debug, thiserror::Error)]
pub enum FolderError {
    /// Nothing of the kind stands there.
    #[error("there is no run with workers `{0}`")]
    Missing(String),
    /// It was made by another program.
    #[error("`{}` was planned by {planned}, and this is {this}: a run is computed by one program", path.display())]
    OtherProgram {
        /// The folder.
        path: PathBuf,
        /// What planned it.
        planned: String,
        /// What this is.
        this: String,
    },
    /// What stands there cannot be read.
    #[error("`{}` is no description of a run: {what}", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        what: String,
    },
}

/// How a run that goes on is to end.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Ending {
    /// Running jobs are finished, and no more are begun.
    Finish,
    /// Running jobs are given up.
    Now,
}

/// What a worker says of a job that failed.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct FailureNote {
    /// Key of the job.
    pub key: Digest,
    /// What is wrong.
    pub message: String,
    /// What to do.
    pub hint: Option<String>,
    /// Whether the operating system failed, and not the job.
    pub is_of_the_system: bool,
    /// The machine on which it failed.
    pub host: String,
}

impl FailureNote {
    /// Of a failure that was reported.
    pub fn new(key: Digest, failure: &Failure, host: &str) -> Self {
        let Failure { message, hint, is_of_the_system, .. } = failure.clone();
        Self { key, message, hint, is_of_the_system, host: host.to_owned() }
    }
}

/// The folder of a run.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RunFolder {
    path: PathBuf,
}

impl RunFolder {
    /// The folder of a plan, which need not exist.
    pub fn of_plan(places: &Places, pipeline: &str, plan: &Digest) -> Self {
        let id = plan.to_string()[..ID_LENGTH].to_owned();
        let path = places.outputs.join(pipeline).join("runs").join(format!("{PREFIX}{id}"));
        Self { path: std::path::absolute(&path).unwrap_or(path) }
    }

    /// A folder that someone names: its path, the id of its run, or a pipeline, which means the run begun last.
    pub fn find(name: &str, outputs: &Path) -> Result<Self, FolderError> {
        let is_folder = |path: &Path| path.join(ASSIGNMENT).is_file();
        let named = Path::new(name);
        if is_folder(named) {
            let path = std::path::absolute(named).unwrap_or_else(|_| named.to_owned());
            return Ok(Self { path });
        }
        let list = |path: &Path| fs::read_dir(path).into_iter().flatten().flatten().map(|entry| entry.path()).collect::<Vec<_>>();
        let runs_of = |pipeline: &Path| list(&pipeline.join("runs")).into_iter().filter(|path| is_folder(path)).collect::<Vec<_>>();
        let by_pipeline = || {
            let is_plain = named.components().count() == 1;
            let mut runs = if is_plain { runs_of(&outputs.join(named)) } else { Vec::new() };
            runs.sort_by_key(|path| fs::metadata(path.join(WORKERS)).and_then(|status| status.modified()).ok());
            runs.pop()
        };
        let id = name.strip_prefix(PREFIX).unwrap_or(name);
        let by_id = || list(outputs).iter().flat_map(|pipeline| runs_of(pipeline)).find(|path| id_of(path) == id);
        let path = by_id().or_else(by_pipeline).ok_or_else(|| FolderError::Missing(name.to_owned()))?;
        Ok(Self { path: std::path::absolute(&path).unwrap_or(path) })
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The run's id.
    pub fn id(&self) -> &str {
        id_of(&self.path)
    }

    /// The name under which a scheduler knows its workers.
    pub fn job_name(&self) -> String {
        format!("pipe-{}", self.id())
    }

    /// Folder of the workers' journals and logs.
    pub fn workers(&self) -> PathBuf {
        self.path.join(WORKERS)
    }

    /// Makes the folder and says what the run is, unless that stands there already.
    pub fn prepare(&self, assignment: &Assignment) -> Result<(), SystemError> {
        for folder in [&self.workers(), &self.path.join(FAILURES), &self.path.join(DRIVERS)] {
            fs::create_dir_all(folder).map_err(SystemError::at("create", folder))?;
        }
        self.put(ASSIGNMENT, line(assignment).as_bytes()).map(drop)
    }

    /// What the run is.
    pub fn assignment(&self) -> Result<Assignment, FolderError> {
        let path = self.path.join(ASSIGNMENT);
        let unreadable = |what: String| FolderError::Unreadable { path: path.clone(), what };
        let text = fs::read(&path).map_err(|error| unreadable(error.to_string()))?;
        let assignment: Assignment = serde_json::from_slice(&text).map_err(|error| unreadable(error.to_string()))?;
        let this = Program::this();
        if assignment.program != this || assignment.schema != SCHEMA {
            let named = |program: &Program| format!("{} {} ({})", program.name, program.version, program.build);
            let (planned, this) = (named(&assignment.program), named(&this));
            return Err(FolderError::OtherProgram { path: self.path.clone(), planned, this });
        }
        Ok(assignment)
    }

    /// Writes a file that is there whole or not at all; false if one of that name stood there, which is left alone.
    fn put(&self, name: &str, bytes: &[u8]) -> Result<bool, SystemError> {
        let path = self.path.join(name);
        let temporary = path.with_file_name(format!(".{}", temporary_name()));
        let write = || {
            let mut file = files::PlainFile::create(temporary.clone(), 0o666)?;
            file.write_all(bytes)?;
            fs::hard_link(&temporary, &path)
        };
        let written = write();
        let _ = files::remove(&temporary);
        match written {
            Ok(()) => Ok(true),
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => Ok(false),
            Err(error) => Err(SystemError::at("write", &path)(error)),
        }
    }

    /// Says why a job failed; the first to say so is heard.
    pub fn note_failure(&self, note: &FailureNote) -> Result<(), SystemError> {
        self.put(&format!("{FAILURES}/{}.json", note.key), line(note).as_bytes()).map(drop)
    }

    /// Why a job failed.
    pub fn failure(&self, key: &Digest) -> Option<FailureNote> {
        let text = fs::read(self.path.join(FAILURES).join(format!("{key}.json"))).ok()?;
        serde_json::from_slice(&text).ok()
    }

    /// The keys of all jobs that failed.
    pub fn failed_keys(&self) -> Vec<Digest> {
        let entries = fs::read_dir(self.path.join(FAILURES)).into_iter().flatten().flatten();
        entries.filter_map(|entry| entry.file_name().to_str()?.strip_suffix(".json")?.parse().ok()).collect()
    }

    /// Says how the run is to end.
    pub fn order_end(&self, ending: Ending) -> Result<(), SystemError> {
        // A run that was to finish its jobs may be told to end at once.
        let name = match ending {
            Ending::Finish => FINISH,
            Ending::Now => NOW,
        };
        self.put(name, b"").map(drop)
    }

    /// How it is to end, if it is.
    pub fn ordered_end(&self) -> Option<Ending> {
        let has = |name: &str| fs::File::open(self.path.join(name)).is_ok();
        if has(NOW) {
            return Some(Ending::Now);
        }
        has(FINISH).then_some(Ending::Finish)
    }

    /// Begins anew: what failed before is tried again.
    pub fn forget_end(&self) {
        for name in [FINISH, NOW] {
            let _ = files::remove(&self.path.join(name));
        }
        for key in self.failed_keys() {
            let _ = files::remove(&self.path.join(FAILURES).join(format!("{key}.json")));
        }
    }

    /// Who drives the run: of several drivers one starts workers, and the others watch.
    pub fn drivers(&self) -> Claims {
        Claims::in_folder(self.path.join(DRIVERS), 0o700)
    }

    /// Says that workers were asked of an executor, so that they can be ended.
    pub fn note_executor(&self, name: &str) {
        let _ = self.put(&format!("executor-{name}"), b"");
    }

    /// Whether workers were asked of it.
    pub fn has_executor(&self, name: &str) -> bool {
        self.path.join(format!("executor-{name}")).exists()
    }

    /// The present by its file server's clock, which need not be ours.
    pub fn now_there(&self) -> Option<SystemTime> {
        let path = self.workers().join(format!(".{}", temporary_name()));
        let time = fs::File::create(&path).and_then(|file| file.metadata()).and_then(|status| status.modified());
        let _ = files::remove(&path);
        time.ok()
    }
}

const WORKERS: &str = "workers";
const FAILURES: &str = "failures";
const DRIVERS: &str = "drivers";
const FINISH: &str = "finish";
const NOW: &str = "cancelled";

fn id_of(path: &Path) -> &str {
    path.file_name().and_then(|name| name.to_str()).and_then(|name| name.strip_prefix(PREFIX)).unwrap_or_default()
}

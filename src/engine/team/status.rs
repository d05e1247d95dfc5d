//! How far a run with workers is, as far as its folder tells.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;

use serde::Serialize;

use super::folder::{Ending, FolderError, RunFolder};
use super::journal::{Journals, SILENCE, Said};
use crate::engine::digest::Digest;
use crate::engine::owner::Owner;

/// How far a run is.
#[derive(Debug, PartialEq, Serialize)]
pub struct Status {
    /// Its id.
    pub run: String,
    /// The pipeline.
    pub pipeline: String,
    /// Its folder.
    pub folder: String,
    /// How it is to end, if it is; null while it goes on.
    pub ending: Option<Ending>,
    /// Whether a driver publishes what is computed.
    pub has_driver: bool,
    /// Its jobs.
    pub jobs: Jobs,
    /// Jobs a minute, over the workers that are at work.
    pub rate: f64,
    /// Its workers.
    pub workers: Vec<Worker>,
}

/// Jobs by what became of them.
#[derive(Debug, PartialEq, Eq, Serialize)]
pub struct Jobs {
    /// All of them.
    pub all: usize,
    /// Those that were in the store before.
    pub known: usize,
    /// Those that its workers have computed.
    pub computed: usize,
    /// Those that its workers compute.
    pub running: usize,
    /// Those that failed.
    pub failed: usize,
    /// Those that are not begun.
    pub waiting: usize,
}

/// Whether a worker is there.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum State {
    /// It is at work.
    Working,
    /// It has ended in good order.
    Ended,
    /// It is gone, or nothing is heard of it.
    Lost,
}

/// A worker.
#[derive(Debug, PartialEq, Serialize)]
pub struct Worker {
    /// Its name; `NAME.log` in the folder of workers has what it told.
    pub name: String,
    /// The machine.
    pub host: String,
    /// Threads it may use.
    pub threads: usize,
    /// Whether it is there.
    pub state: State,
    /// Why it ended.
    pub why: Option<String>,
    /// Seconds since it was last heard.
    pub heard: f64,
    /// Jobs that it has computed.
    pub computed: usize,
    /// What it computes.
    pub running: Vec<String>,
}

/// What a journal comes to.
#[derive(Default)]
struct Told {
    host: String,
    owner: String,
    threads: usize,
    began: f64,
    last: f64,
    ended: Option<String>,
    computed: BTreeSet<Digest>,
    running: BTreeMap<Digest, String>,
}

impl Told {
    fn take(&mut self, said: Said) {
        match said {
            Said::Began { host, owner, threads, at, .. } => {
                (self.host, self.owner, self.threads, self.began, self.last) = (host, owner, threads, at, at);
            }
            Said::Started { key, job } => drop(self.running.insert(key, job)),
            Said::Computed { key, at, .. } => {
                self.running.remove(&key);
                self.computed.insert(key);
                self.last = at;
            }
            Said::GaveUp { key } => drop(self.running.remove(&key)),
            Said::Alive => {}
            Said::Ended { why } => self.ended = Some(why),
        }
    }

    fn state(&self, heard: f64) -> State {
        let owner = Owner::parse(&self.owner).map(|(owner, _)| owner).filter(Owner::is_in_sight);
        match (&self.ended, owner) {
            (Some(_), _) => State::Ended,
            (None, Some(owner)) if owner.is_alive() => State::Working,
            (None, None) if heard < SILENCE.as_secs_f64() => State::Working,
            _ => State::Lost,
        }
    }

    /// Jobs a minute.
    fn rate(&self) -> f64 {
        let time = self.last - self.began;
        if time > 0.0 { 60.0 * self.computed.len() as f64 / time } else { 0.0 }
    }
}

/// How far the run in a folder is.
pub fn status(folder: &RunFolder) -> Result<Status, FolderError> {
    let assignment = folder.assignment()?;
    let mut told: BTreeMap<String, Told> = BTreeMap::new();
    for (name, said) in Journals::in_folder(folder.workers()).news() {
        told.entry(name).or_default().take(said);
    }
    let now = folder.now_there();
    let heard = |name: &str| {
        let modified = fs::metadata(folder.workers().join(format!("{name}.jsonl"))).and_then(|status| status.modified()).ok();
        now.zip(modified).and_then(|(now, modified)| now.duration_since(modified).ok()).map_or(0.0, |time| time.as_secs_f64())
    };
    let computed: BTreeSet<Digest> = told.values().flat_map(|told| told.computed.iter().copied()).collect();
    let failed = folder.failed_keys().len();
    let mut rate = 0.0;
    let mut running = BTreeSet::new();
    let workers: Vec<Worker> = told
        .into_iter()
        .map(|(name, told)| {
            let heard = heard(&name);
            let state = told.state(heard);
            let mut own = Vec::new();
            if state == State::Working {
                rate += told.rate();
                running.extend(told.running.keys().filter(|key| !computed.contains(*key)).copied());
                own = told.running.values().cloned().collect();
            }
            let (host, threads, why, count) = (told.host, told.threads, told.ended, told.computed.len());
            Worker { name, host, threads, state, why, heard, computed: count, running: own }
        })
        .collect();
    let known = assignment.hits;
    let accounted = known + computed.len() + running.len() + failed;
    let jobs = Jobs {
        all: assignment.jobs,
        known,
        computed: computed.len(),
        running: running.len(),
        failed,
        waiting: assignment.jobs.saturating_sub(accounted),
    };
    Ok(Status {
        run: folder.id().to_owned(),
        pipeline: assignment.pipeline,
        folder: folder.path().display().to_string(),
        ending: folder.ordered_end(),
        has_driver: folder.drivers().holder(&super::crew::driver_key()).is_some(),
        jobs,
        rate,
        workers,
    })
}

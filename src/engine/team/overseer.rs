//! What the driver of a run knows of the jobs that its workers compute.

use std::collections::{BTreeMap, BTreeSet};
use std::num::NonZeroUsize;
use std::time::{Duration, Instant};

use super::crew::{Crew, Farewell, driver_key};
use super::folder::{Assignment, Ending, FailureNote, RunFolder};
use super::journal::{Journals, SILENCE, Said};
use crate::engine::digest::{Digest, DigestMap};
use crate::engine::executor::{Executor, ExecutorError};
use crate::engine::request::Request;
use crate::engine::resources::Resources;
use crate::engine::system::SystemError;

/// Makes what starts the workers of the run in a folder.
pub type Maker<'a> = Box<dyn FnOnce(&RunFolder) -> Box<dyn Executor> + 'a>;

/// What a run with workers is begun with.
pub struct Hiring<'a> {
    /// What was asked: a worker gets the same graph from it.
    pub request: &'a Request,
    /// Most workers of each class.
    pub limit: NonZeroUsize,
    /// Whether workers go on when this process is interrupted.
    pub outlives_driver: bool,
    /// Makes what starts workers, when the run has its folder.
    pub executor: Maker<'a>,
    /// Told once, when the run has its folder and something is to be computed.
    pub tell: Box<dyn FnOnce(&RunFolder) + 'a>,
}

/// Least time between two looks at the journals.
const GLANCE: Duration = Duration::from_millis(20);

/// Least time between two looks into the store for all that is awaited.
const SWEEP: Duration = Duration::from_secs(1);

/// A look may take this part of the time: the more there is to look at, the more seldom it is done.
const SHARE: u32 = 10;

/// What has happened since the last look.
#[derive(Debug, Default)]
pub struct News {
    /// Keys of awaited jobs that may be in the store by now.
    pub perhaps_done: Vec<Digest>,
    /// Awaited jobs that failed.
    pub failed: Vec<FailureNote>,
    /// Whether someone has cancelled the run.
    pub is_cancelled: bool,
    /// Awaited jobs that were begun, with the machine.
    pub begun: Vec<(Digest, String)>,
    /// How many workers wait and for what, if none is at work and that was not told yet.
    pub waiting: Option<(usize, String)>,
}

/// The driver's view of its workers.
pub struct Overseer {
    folder: RunFolder,
    classes: Vec<Resources>,
    outlives_driver: bool,
    crew: Crew,
    journals: Journals,
    hosts: BTreeMap<String, String>,
    heard: BTreeMap<String, Instant>,
    /// The machines that computed jobs, by key.
    authors: DigestMap<String>,
    /// Jobs that workers are to compute, by key.
    awaited: DigestMap<usize>,
    /// Their number by class.
    ready: Vec<usize>,
    /// Awaited jobs that a worker says it has computed.
    announced: BTreeSet<Digest>,
    /// What was read and is not told yet.
    unheard: News,
    /// What was told last of workers that wait.
    told_waiting: Option<(usize, String)>,
    next_look: Instant,
    next_sweep: Instant,
}

impl Overseer {
    /// Says what the run is and begins to look after its workers.
    pub fn begin(folder: RunFolder, assignment: &Assignment, hiring: Hiring<'_>) -> Result<Self, SystemError> {
        folder.prepare(assignment)?;
        let mut drivers = folder.drivers();
        let claim = if drivers.holder(&driver_key()).is_none() { drivers.take(&driver_key()) } else { None };
        if claim.is_some() {
            folder.forget_end();
        }
        (hiring.tell)(&folder);
        let executor = (hiring.executor)(&folder);
        let crew = Crew::begin(&folder, executor, &assignment.classes, hiring.limit, claim);
        let now = Instant::now();
        Ok(Self {
            classes: assignment.classes.clone(),
            outlives_driver: hiring.outlives_driver,
            crew,
            journals: Journals::in_folder(folder.workers()),
            folder,
            hosts: BTreeMap::new(),
            heard: BTreeMap::new(),
            authors: DigestMap::default(),
            awaited: DigestMap::default(),
            ready: vec![0; assignment.classes.len()],
            announced: BTreeSet::new(),
            unheard: News::default(),
            told_waiting: None,
            next_look: now,
            next_sweep: now + SWEEP,
        })
    }

    /// Leaves a job to the workers.
    pub fn hand_out(&mut self, key: Digest, job: usize, asked: &Resources) {
        self.awaited.insert(key, job);
        if self.authors.contains_key(&key) {
            self.announced.insert(key);
        }
        let class = self.class_of(asked);
        self.ready[class] += 1;
    }

    /// No longer awaits a job: it is done, or has failed.
    pub fn take_back(&mut self, key: &Digest, asked: &Resources) {
        if self.awaited.remove(key).is_some() {
            let class = self.class_of(asked);
            self.ready[class] -= 1;
        }
        self.announced.remove(key);
    }

    fn class_of(&self, asked: &Resources) -> usize {
        self.classes.binary_search(asked).expect("the classes are those of the graph")
    }

    /// The job that is awaited under a key.
    pub fn awaited(&self, key: &Digest) -> Option<usize> {
        self.awaited.get(key).copied()
    }

    /// Whether workers still have something to do.
    pub fn is_waiting(&self) -> bool {
        !self.awaited.is_empty()
    }

    /// The machine that computed a job, if a worker of this run did.
    pub fn author(&self, key: &Digest) -> Option<&str> {
        self.authors.get(key).map(String::as_str)
    }

    /// Why there will be no workers, if so.
    pub fn problem(&self) -> Option<ExecutorError> {
        self.crew.problem()
    }

    /// Looks at the journals, if it is time to.
    pub fn news(&mut self) -> Option<News> {
        let begun = Instant::now();
        if begun < self.next_look {
            return None;
        }
        let mut news = std::mem::take(&mut self.unheard);
        self.read_journals(&mut news);
        let failed = self.folder.failed_keys();
        news.failed = failed.iter().filter(|key| self.awaited.contains_key(*key)).filter_map(|key| self.folder.failure(key)).collect();
        news.is_cancelled = self.folder.ordered_end() == Some(Ending::Now);
        news.waiting = self.crew.waiting().filter(|waiting| self.told_waiting.as_ref() != Some(waiting));
        self.told_waiting = news.waiting.clone().or(self.told_waiting.take());
        news.perhaps_done = self.announced.iter().copied().collect();
        if begun >= self.next_sweep {
            news.perhaps_done = self.awaited.keys().copied().collect();
        }
        self.next_look = Instant::now() + (begun.elapsed() * SHARE).max(GLANCE);
        Some(news)
    }

    /// Says how many jobs are not done, with what they ask for, and how many are: so many workers are wanted, once there is
    /// something for them to begin with.
    pub fn want(&self, open: &[(Resources, usize)], done: usize) {
        let mut wanted = vec![0; self.classes.len()];
        for (asked, count) in open {
            wanted[self.class_of(asked)] += count;
        }
        for (wanted, ready) in wanted.iter_mut().zip(&self.ready) {
            *wanted = if *ready == 0 { 0 } else { *wanted };
        }
        self.crew.want(wanted, done, self.heard());
    }

    /// Notes how long it took to look for all that was named.
    pub fn has_looked(&mut self, count: usize, time: Duration) {
        if count == self.awaited.len() || Instant::now() >= self.next_sweep {
            self.next_sweep = Instant::now() + (time * SHARE).max(SWEEP);
        }
    }

    /// Reads what was said meanwhile, so that no author is missed.
    pub fn read_again(&mut self) {
        let mut news = std::mem::take(&mut self.unheard);
        self.read_journals(&mut news);
        self.unheard = news;
    }

    fn read_journals(&mut self, news: &mut News) {
        for (worker, said) in self.journals.news() {
            self.heard.insert(worker.clone(), Instant::now());
            match said {
                Said::Began { host, .. } => drop(self.hosts.insert(worker, host)),
                Said::Started { key, .. } if self.awaited.contains_key(&key) => {
                    news.begun.push((key, self.hosts.get(&worker).cloned().unwrap_or_default()));
                }
                Said::Computed { key, .. } => {
                    let host = self.hosts.get(&worker).cloned().unwrap_or_default();
                    self.authors.insert(key, host);
                    if self.awaited.contains_key(&key) {
                        self.announced.insert(key);
                    }
                }
                Said::Ended { .. } => drop(self.heard.remove(&worker)),
                Said::Started { .. } | Said::GaveUp { .. } | Said::Alive => {}
            }
        }
    }

    /// The workers that have been heard of and have not ended, and whether that was lately.
    fn heard(&self) -> BTreeMap<String, bool> {
        self.heard.iter().map(|(worker, moment)| (worker.clone(), moment.elapsed() <= SILENCE)).collect()
    }

    /// The run is over.
    pub fn end(&mut self, was_interrupted: bool) {
        let farewell = match (was_interrupted, self.outlives_driver) {
            (true, true) => Farewell::Leave,
            (true, false) => Farewell::Cancel,
            (false, _) => Farewell::Dismiss,
        };
        self.crew.end(farewell);
    }
}

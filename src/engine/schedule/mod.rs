//! Runs what has to run: a ready queue by critical path, on job threads that start with the first job.
//!
//! One thread, the caller's, owns all state. It hands tasks to job threads over a channel, and takes their
//! reports over another; `worker` is what a job thread does, `values` what the threads share. A job is
//! *settled* once its results are known, by a look into the store or by running; a result that nobody needs
//! is never read. When the store turns out to have lost a result, the job that gave it runs again and the
//! one that wanted it waits.
//!
//! Here are the state and the loop, [`Scheduler::run`]. The steps of the loop: `starting`, `reports`, `settling`,
//! `publishing`, `failing`, `dividing` for jobs in parts, and `elsewhere` for jobs that another run computes at the same time.

mod dividing;
mod elsewhere;
mod failing;
pub mod panics;
mod publishing;
mod reports;
pub mod role;
mod settling;
mod starting;
mod state;
pub mod values;
mod worker;

use std::collections::{BinaryHeap, HashMap, VecDeque};
use std::num::NonZeroUsize;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use super::digest::{Digest, DigestMap};
use super::events::{Event, Failure, Listener};
use super::executor::ExecutorError;
use super::freshness::{Plan, fill_inputs};
use super::history::History;
use super::manifest::{JobEntry, Outcome, PublishedEntry, Standing, job_name};
use super::signature::Signatures;
use super::store::claims::{Claim, Claims};
use super::store::committer::Committer;
use super::store::index::Index;
use super::store::library::Library;
use super::system::SystemError;
use elsewhere::Flight;
use role::Role;
use state::{JobState, Order, Ready};
use values::Shared;
use worker::{PublishTask, Report, Task};

/// How to run.
#[derive(Debug, Clone, Copy)]
pub struct Settings {
    /// Jobs that run at once at most.
    pub threads: NonZeroUsize,
    /// Memory that values and running jobs may hold, in bytes.
    pub memory: u64,
    /// Whether jobs that do not depend on a failed one still run.
    pub keep_going: bool,
    /// Called once, before the first job: builds the pool of that many threads for loops inside the stages.
    pub start_pool: fn(NonZeroUsize),
}

/// After an interrupt, running jobs have so long to end by themselves: five times what a stage may take between two looks
/// at it. What is left of the second is for the manifest, and for a machine on which everything takes longer.
const PATIENCE: Duration = Duration::from_millis(250);

/// How often an interrupt is looked for while jobs run.
const GLANCE: Duration = Duration::from_millis(20);

/// The state of a run.
pub struct Scheduler<'l> {
    /// When the run began.
    began: Instant,
    shared: Arc<Shared>,
    settings: Settings,
    listener: &'l mut dyn Listener,
    history: History,
    /// What earlier runs knew of recipes and files.
    index: &'l Index,
    signatures: &'l mut Signatures,
    standing: Option<&'l Standing>,
    committer: Committer,
    role: Role,

    jobs: Vec<Option<JobState>>,
    /// Wanted jobs that use a result of each job, each once.
    dependents: Vec<Vec<usize>>,
    /// Jobs that are ready, run or have run in this run, by key.
    by_key: DigestMap<usize>,
    ready: BinaryHeap<Ready>,
    to_publish: VecDeque<PublishTask>,
    /// Jobs whose values are in memory, the oldest first.
    in_memory: VecDeque<usize>,

    /// Jobs that run here.
    flights: Vec<Flight>,
    /// Jobs that another run has claimed.
    elsewhere: Vec<usize>,
    next_look_elsewhere: Instant,
    claims: Claims,
    /// Tells other runs that this one is at work.
    presence: Option<Claim>,
    looked_around: Option<Instant>,
    order: Order,

    threads: Vec<std::thread::JoinHandle<()>>,
    tasks: Sender<Task>,
    waiting_tasks: Arc<Mutex<Receiver<Task>>>,
    reports: Receiver<Report>,
    report_to: Sender<Report>,
    running: usize,
    /// What tasks took lately.
    usual_time: Duration,
    reserved: u64,
    is_stopping: bool,
    interrupted_at: Option<Instant>,
    settled_count: usize,
    wanted_count: usize,

    ledger: Ledger,
}

/// What a run leaves for its manifest.
#[derive(Debug, Default)]
pub struct Ledger {
    /// Why jobs failed.
    pub failures: Vec<Failure>,
    /// Warnings with the stage's name.
    pub warnings: Vec<(String, String)>,
    /// Whether some of them are of this run only, and would not be said again.
    pub has_passing_warnings: bool,
    /// Files that the run stands behind.
    pub published: Vec<PublishedEntry>,
    /// The names under which the store has the bytes of those files, by their path.
    pub publication_keys: HashMap<String, Digest>,
    /// Those of them that it wrote.
    pub written: Vec<String>,
    /// Most memory that was taken at once, in bytes.
    pub memory_peak: u64,
    /// What a next run can know without a look at the records.
    pub index: Index,
    /// Why there were no workers to go on with.
    pub no_workers: Option<ExecutorError>,
}

impl Ledger {
    /// Takes over what the store has to say, which is said once.
    pub fn take_notices(&mut self, library: &Library) {
        let notices = library.take_notices();
        self.has_passing_warnings |= !notices.is_empty();
        self.warnings.extend(notices.into_iter().map(|text| (String::new(), text)));
    }
}

/// What the world looked like before the run.
pub struct World<'l> {
    /// Earlier runs.
    pub history: History,
    /// See [`Index`].
    pub index: &'l Index,
    /// See [`Signatures`].
    pub signatures: &'l mut Signatures,
    /// The latest manifest.
    pub standing: Option<&'l Standing>,
    /// When the run began.
    pub began: Instant,
    /// What this process does of it.
    pub role: Role,
}

impl<'l> Scheduler<'l> {
    /// A run that has not begun.
    pub fn new(
        shared: Arc<Shared>,
        plan: Plan,
        world: World<'l>,
        committer: Committer,
        settings: Settings,
        listener: &'l mut dyn Listener,
    ) -> Self {
        let (tasks, waiting_tasks) = channel();
        let (report_to, reports) = channel();
        let claims = shared.library.claims();
        let graph = &shared.graph;
        let jobs: Vec<_> =
            graph.jobs.iter().zip(plan.jobs).map(|(node, planned)| planned.map(|planned| JobState::new(graph, node, planned))).collect();
        let dependents = state::dependents(graph);
        let wanted_count = jobs.iter().flatten().count();
        Self {
            began: world.began,
            jobs,
            dependents,
            shared,
            settings,
            listener,
            history: world.history,
            index: world.index,
            signatures: world.signatures,
            standing: world.standing,
            committer,
            role: world.role,
            by_key: DigestMap::default(),
            ready: BinaryHeap::new(),
            to_publish: VecDeque::new(),
            in_memory: VecDeque::new(),
            flights: Vec::new(),
            elsewhere: Vec::new(),
            next_look_elsewhere: Instant::now(),
            claims,
            presence: None,
            looked_around: None,
            order: Order::Graph,
            threads: Vec::new(),
            tasks,
            waiting_tasks: Arc::new(Mutex::new(waiting_tasks)),
            reports,
            report_to,
            running: 0,
            usual_time: Duration::from_secs(1),
            reserved: 0,
            is_stopping: false,
            interrupted_at: None,
            settled_count: 0,
            wanted_count,
            ledger: Ledger::default(),
        }
    }

    /// The whole run: settles what is known, then starts what can start and takes in what is reported.
    pub fn run(&mut self) {
        self.begin();
        while !self.is_over() {
            self.tend_hand();
            self.look_for_interrupt();
            self.look_elsewhere();
            self.oversee();
            if self.running > 0 {
                self.look_around();
            }
            self.start_what_can();
            self.tend_claims();
            match self.reports.recv_timeout(GLANCE) {
                Ok(report) => self.take_in(report),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => unreachable!("the scheduler holds a sender itself"),
            }
        }
        self.skip_the_rest();
    }

    fn is_over(&self) -> bool {
        if self.running > 0 {
            let waited_enough = self.interrupted_at.is_some_and(|moment| moment.elapsed() > PATIENCE);
            return waited_enough;
        }
        let is_waiting = !self.elsewhere.is_empty() || self.is_waiting_for_workers();
        self.is_stopping || self.is_leaving() || (self.ready.is_empty() && self.to_publish.is_empty() && !is_waiting)
    }

    fn look_for_interrupt(&mut self) {
        if self.interrupted_at.is_none() && self.is_interrupted() {
            self.interrupted_at = Some(Instant::now());
            self.committer.hurry();
            self.is_stopping = true;
        }
        if self.committer.has_failed() {
            self.is_stopping = true;
        }
    }

    // Memory and messages.

    /// Values that fill more than half of the memory give way, the oldest first: the store has them.
    fn relieve_memory(&mut self) {
        while self.shared.held() > self.settings.memory / 2 {
            let Some(oldest) = self.in_memory.pop_front() else { return };
            self.shared.drop_values(oldest);
        }
    }

    fn tell_finished(&mut self, job: usize, error: Option<Failure>) {
        let total = self.wanted_count;
        let entry = &self.state(job).entry;
        let ran = entry.measured.as_ref().filter(|_| entry.outcome == Outcome::Ran);
        let event = Event::Finished {
            job: self.name(job),
            outcome: entry.outcome,
            reason: entry.reason.clone(),
            seconds: ran.map_or(0.0, |measured| measured.seconds),
            done: self.settled_count,
            total,
            is_part: self.whole_of(job).is_some(),
            error,
        };
        self.listener.notify(&event);
    }

    fn warn(&mut self, job: usize, message: String) {
        let stage = self.shared.graph.stages[self.shared.graph.jobs[job].stage].name.clone();
        self.ledger.warnings.push((stage, message));
    }

    fn name(&self, job: usize) -> String {
        job_name(&self.shared.graph, &self.shared.graph.jobs[job])
    }

    fn state(&self, job: usize) -> &JobState {
        self.jobs[job].as_ref().expect("only wanted jobs are scheduled")
    }

    fn state_mut(&mut self, job: usize) -> &mut JobState {
        self.jobs[job].as_mut().expect("only wanted jobs are scheduled")
    }

    /// Ends the run: commits what was computed, and gives all that the manifest needs.
    pub fn finish(mut self) -> Finished {
        self.name_authors();
        let shared = self.shared.clone();
        for (job, node) in shared.graph.jobs.iter().enumerate().filter(|(_, node)| node.is_wanted) {
            let mut inputs = std::mem::take(&mut self.state_mut(job).entry.inputs);
            fill_inputs(&mut inputs, node, |item| self.state(item.job).content(item.result));
            self.state_mut(job).entry.inputs = inputs;
        }
        let entries = self.entries();
        let committed = self.committer.finish();
        Finished { entries, ledger: self.ledger, was_interrupted: self.interrupted_at.is_some(), committed }
    }
}

/// What a run comes to.
pub struct Finished {
    /// Every wanted job.
    pub entries: Vec<JobEntry>,
    /// Files, warnings, failures.
    pub ledger: Ledger,
    /// Whether it was told to stop.
    pub was_interrupted: bool,
    /// Whether the store took everything.
    pub committed: Result<(), SystemError>,
}

/// `1.5 GiB`: a number of bytes for people.
pub fn bytes_text(bytes: u64) -> String {
    let units = ["bytes", "KiB", "MiB", "GiB", "TiB"];
    let mut value = bytes as f64;
    let mut unit = 0;
    while value >= 1024.0 && unit + 1 < units.len() {
        value /= 1024.0;
        unit += 1;
    }
    if unit == 0 { format!("{bytes} bytes") } else { format!("{value:.1} {}", units[unit]) }
}

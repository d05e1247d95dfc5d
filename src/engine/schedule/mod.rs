//! Runs what has to run: a ready queue by critical path, on job threads that start with the first job.
//!
//! One thread, the caller's, owns all state. It hands tasks to job threads over a channel, and takes their
//! reports over another; `worker` is what a job thread does, `values` what the threads share. A job is
//! *settled* once its results are known, by a look into the store or by running; a result that nobody needs
//! is never read. When the store turns out to have lost a result, the job that gave it runs again and the
//! one that wanted it waits.

pub mod panics;
mod state;
pub mod values;
mod worker;

use std::collections::{BinaryHeap, HashMap, VecDeque};
use std::num::NonZeroUsize;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use super::digest::Digest;
use super::events::{Event, Failure, Listener};
use super::freshness::{HIT_REASON, Plan, fill_inputs, is_whole, output_entries};
use super::graph::InputNode;
use super::history::History;
use super::key;
use super::manifest::{JobEntry, JobMeasured, Outcome, PublishedEntry, Standing, job_name, result_name};
use super::signature::Signatures;
use super::store::committer::Committer;
use super::store::index::Index;
use super::store::library::Lost;
use super::store::record::{PublicationRecord, ResultRecord};
use super::system::SystemError;
use state::{JobState, Phase, Ready, critical_paths};
use values::{Shared, Source};
use worker::{Body, Fault, FileToPublish, PublishTask, RanJob, Report, RunTask, Task, work};

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

/// After an interrupt, running jobs have so long to end by themselves.
const PATIENCE: Duration = Duration::from_millis(700);

/// How often an interrupt is looked for while jobs run.
const GLANCE: Duration = Duration::from_millis(20);

/// A job that the store lost so often in one run is not tried again: the disk is at fault.
const RERUN_LIMIT: u32 = 2;

/// The state of a run.
pub struct Scheduler<'l> {
    shared: Arc<Shared>,
    settings: Settings,
    listener: &'l mut dyn Listener,
    history: History,
    /// What earlier runs knew of recipes and files.
    index: &'l Index,
    signatures: &'l mut Signatures,
    standing: Option<&'l Standing>,
    committer: Committer,

    jobs: Vec<Option<JobState>>,
    /// Wanted jobs that use a result of each job, each once.
    dependents: Vec<Vec<usize>>,
    /// Jobs that are ready, run or have run in this run, by key.
    by_key: HashMap<Digest, usize>,
    ready: BinaryHeap<Ready>,
    to_publish: VecDeque<PublishTask>,
    /// Jobs whose values are in memory, the oldest first.
    in_memory: VecDeque<usize>,

    threads: Vec<std::thread::JoinHandle<()>>,
    tasks: Sender<Task>,
    waiting_tasks: Arc<Mutex<Receiver<Task>>>,
    reports: Receiver<Report>,
    report_to: Sender<Report>,
    running: usize,
    reserved: u64,
    is_stopping: bool,
    interrupted_at: Option<Instant>,
    settled_count: usize,

    ledger: Ledger,
}

/// What a run leaves for its manifest.
#[derive(Debug, Default)]
pub struct Ledger {
    /// Why jobs failed.
    pub failures: Vec<Failure>,
    /// Warnings with the stage's name.
    pub warnings: Vec<(String, String)>,
    /// Files that the run stands behind.
    pub published: Vec<PublishedEntry>,
    /// Those of them that it wrote.
    pub written: Vec<String>,
    /// Most memory that was taken at once, in bytes.
    pub memory_peak: u64,
    /// What a next run can know without a look at the records.
    pub index: Index,
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
        let graph = &shared.graph;
        let jobs: Vec<_> =
            graph.jobs.iter().zip(plan.jobs).map(|(node, planned)| planned.map(|planned| JobState::new(graph, node, planned))).collect();
        let dependents = state::dependents(graph);
        let ledger = Ledger { warnings: plan.warnings.into_iter().map(|text| (String::new(), text)).collect(), ..Ledger::default() };
        Self {
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
            by_key: HashMap::new(),
            ready: BinaryHeap::new(),
            to_publish: VecDeque::new(),
            in_memory: VecDeque::new(),
            threads: Vec::new(),
            tasks,
            waiting_tasks: Arc::new(Mutex::new(waiting_tasks)),
            reports,
            report_to,
            running: 0,
            reserved: 0,
            is_stopping: false,
            interrupted_at: None,
            settled_count: 0,
            ledger,
        }
    }

    /// The whole run: settles what is known, then starts what can start and takes in what is reported.
    pub fn run(&mut self) {
        self.begin();
        while !self.is_over() {
            self.look_for_interrupt();
            self.start_what_can();
            match self.reports.recv_timeout(GLANCE) {
                Ok(report) => self.take_in(report),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => unreachable!("the scheduler holds a sender itself"),
            }
        }
        self.skip_the_rest();
    }

    /// Settles every job that the plan found in the store, and prepares those whose inputs are all settled.
    fn begin(&mut self) {
        let wanted: Vec<usize> = (0..self.jobs.len()).filter(|job| self.jobs[*job].is_some()).collect();
        let hits = wanted.iter().filter(|job| self.state(**job).is_hit()).count();
        self.listener.notify(&Event::Planned { jobs: wanted.len(), hits });
        if hits < wanted.len() {
            self.set_priorities();
        }
        for &job in &wanted {
            let uses = self.dependents[job].len();
            let state = self.state_mut(job);
            state.uses = uses;
            // Not counted yet: settling an input must not count it down.
            state.waiting = usize::MAX;
        }
        for &job in &wanted {
            if let Some(record) = self.state_mut(job).planned.record.take() {
                let state = self.state_mut(job);
                state.entry.key = state.planned.key;
                self.settle_one(job, record, Outcome::Hit, HIT_REASON.to_owned());
            }
        }
        for &job in &wanted {
            if !self.state(job).is_settled() {
                self.wait_for_inputs(job);
            }
        }
    }

    fn set_priorities(&mut self) {
        let costs: Vec<f64> = self
            .jobs
            .iter()
            .map(|state| {
                state.as_ref().filter(|state| !state.is_hit()).map_or(0.0, |state| self.history.seconds(&state.entry).unwrap_or(1.0))
            })
            .collect();
        for (state, priority) in self.jobs.iter_mut().zip(critical_paths(&costs, &self.dependents)) {
            if let Some(state) = state {
                state.priority = priority;
            }
        }
    }

    fn is_over(&self) -> bool {
        if self.running > 0 {
            let waited_enough = self.interrupted_at.is_some_and(|moment| moment.elapsed() > PATIENCE);
            return waited_enough;
        }
        self.is_stopping || (self.ready.is_empty() && self.to_publish.is_empty())
    }

    fn look_for_interrupt(&mut self) {
        if self.interrupted_at.is_none() && self.shared.interrupted.load(Ordering::Relaxed) {
            self.interrupted_at = Some(Instant::now());
            self.is_stopping = true;
        }
        if self.committer.has_failed() {
            self.is_stopping = true;
        }
    }

    // Settling: a job's results become known.

    /// Counts what a job still waits for, and prepares it if that is nothing.
    fn wait_for_inputs(&mut self, job: usize) {
        let inputs = state::distinct_inputs(&self.shared.graph.jobs[job]);
        let waiting = inputs.iter().filter(|input| !self.state(**input).is_settled()).count();
        let state = self.state_mut(job);
        state.waiting = waiting;
        state.phase = Phase::Waiting;
        if waiting == 0 {
            self.prepare(job);
        } else if inputs.iter().any(|input| self.state(*input).has_failed()) {
            self.skip(job);
        }
    }

    /// All inputs are known: the key is, too, and the store may have the result (early cutoff).
    fn prepare(&mut self, job: usize) {
        let mut prepared = vec![job];
        while let Some(job) = prepared.pop() {
            // A job that follows another may be named twice.
            let state = self.state(job);
            if state.phase != Phase::Waiting || state.waiting != 0 {
                continue;
            }
            if let Some((record, reason)) = self.prepare_one(job) {
                prepared.extend(self.settle_one(job, record, Outcome::Hit, reason));
            }
        }
    }

    /// The results, if the store or a job with the same key has them; else the job is ready, or follows another.
    fn prepare_one(&mut self, job: usize) -> Option<(ResultRecord, String)> {
        let shared = self.shared.clone();
        let node = &shared.graph.jobs[job];
        let content = |item: &InputNode| self.state(item.job).content(item.result);
        let key = key::key(&shared.graph, node, &self.state(job).planned.files, |item| content(item).expect("all inputs are settled"));
        let mut inputs = std::mem::take(&mut self.state_mut(job).entry.inputs);
        fill_inputs(&mut inputs, node, |item| self.state(item.job).content(item.result));
        let state = self.state_mut(job);
        state.entry.inputs = inputs;
        state.entry.key = Some(key);

        let reason = if !state.planned.reason.is_empty() { state.planned.reason } else { state.rerun_reason };
        if reason.is_empty() {
            if let Some(&leader) = self.by_key.get(&key) {
                return self.follow(job, leader);
            }
            if let Some(record) = self.look_up(job, &key) {
                return Some((record, HIT_REASON.to_owned()));
            }
        }
        self.make_ready(job, key, reason);
        None
    }

    /// A job with the same key as another of this run has its results, or will have.
    fn follow(&mut self, job: usize, leader: usize) -> Option<(ResultRecord, String)> {
        match self.state(leader).record.clone() {
            Some(record) if self.state(leader).is_settled() => {
                let reason = format!("the same as {}", job_name(&self.shared.graph, &self.shared.graph.jobs[leader]));
                Some((record, reason))
            }
            _ => {
                self.state_mut(leader).followers.push(job);
                None
            }
        }
    }

    fn look_up(&mut self, job: usize, key: &Digest) -> Option<ResultRecord> {
        // The plan has looked under this key already.
        if self.state(job).planned.key == Some(*key) {
            return None;
        }
        match self.shared.library.result(key) {
            Ok(record) => Some(record).filter(|record| is_whole(&self.shared.graph, &self.shared.graph.jobs[job], record)),
            Err(Lost::Missing) => None,
            Err(lost @ Lost::Damaged(_)) => {
                self.warn_of_loss(&lost);
                self.state_mut(job).rerun_reason = lost.reason();
                None
            }
        }
    }

    fn make_ready(&mut self, job: usize, key: Digest, reason: &'static str) {
        let reason = if !reason.is_empty() { reason } else { self.state(job).rerun_reason };
        let reason = if reason.is_empty() {
            let entry = self.state(job).entry.clone();
            self.history.reason(&entry)
        } else {
            reason.to_owned()
        };
        self.by_key.insert(key, job);
        let state = self.state_mut(job);
        state.entry.reason = reason;
        state.phase = Phase::Ready;
        let ready = Ready { priority: state.priority, job };
        self.ready.push(ready);
    }

    /// Notes the results of a job, publishes, and gives the jobs that now have all their inputs.
    fn settle_one(&mut self, job: usize, record: ResultRecord, outcome: Outcome, reason: String) -> Vec<usize> {
        let shared = self.shared.clone();
        let node = &shared.graph.jobs[job];
        self.settled_count += 1;
        let state = self.state_mut(job);
        state.phase = Phase::Settled;
        state.entry.outcome = outcome;
        state.entry.reason = reason;
        state.entry.outputs = output_entries(&record);
        state.entry.warnings = record.warnings.iter().cloned().chain(node.parameters.caveats()).collect();
        state.entry.measured = Some(JobMeasured { seconds: record.seconds, memory: record.memory });
        if state.sizes.is_empty() {
            state.sizes = record.outputs.iter().map(|output| output.content.size).collect();
        }
        let (recipe, followers) = (state.planned.recipe, std::mem::take(&mut state.followers));
        self.ledger.index.add_result(recipe, &record);
        self.state_mut(job).record = Some(record);
        self.tell_finished(job, None);
        self.plan_publications(job);

        let mut prepared = followers;
        for dependent in self.dependents[job].clone() {
            let state = self.state_mut(dependent);
            if state.phase == Phase::Waiting && state.waiting != usize::MAX {
                state.waiting -= 1;
                if state.waiting == 0 {
                    prepared.push(dependent);
                }
            }
        }
        self.release_inputs(job);
        self.drop_if_unused(job);
        prepared
    }

    /// The inputs of a job have one user less.
    fn release_inputs(&mut self, job: usize) {
        for input in state::distinct_inputs(&self.shared.graph.jobs[job]) {
            self.state_mut(input).uses -= 1;
            self.drop_if_unused(input);
        }
    }

    fn drop_if_unused(&mut self, job: usize) {
        if self.state(job).uses == 0 {
            self.shared.drop_values(job);
        }
    }

    // Starting.

    fn start_what_can(&mut self) {
        while !self.is_stopping && self.running < self.settings.threads.get() {
            let is_started = if self.to_publish.is_empty() { self.start_next_job() } else { self.start_next_publication() };
            if !is_started {
                return;
            }
        }
    }

    /// Publishing comes first: it needs no other job and lets values go.
    fn start_next_publication(&mut self) -> bool {
        let task = self.to_publish.pop_front().expect("the caller has looked");
        let size = |file: &FileToPublish| self.state(file.source.job).sizes[file.source.result];
        // The artifact may have to be read, and its encoded form is about as large.
        let need = 2 * task.files.iter().map(size).max().unwrap_or(0);
        if !self.has_room(need) {
            self.to_publish.push_front(task);
            return false;
        }
        self.state_mut(task.job).reserved_for_files = need;
        self.expect_in_memory(task.job);
        self.start(Task::Publish(task), need);
        true
    }

    /// Starts the job on the longest path; false if there is none or it has to wait for memory.
    fn start_next_job(&mut self) -> bool {
        let Some(Ready { job, .. }) = self.ready.peek().copied() else { return false };
        let need = self.memory_need(job);
        if need.at_all > self.settings.memory {
            self.ready.pop();
            self.fail_for_memory(job, need.at_all);
            return true;
        }
        if !self.has_room(need.beside_what_is_held) {
            return false;
        }
        self.ready.pop();
        for input in state::distinct_inputs(&self.shared.graph.jobs[job]) {
            self.expect_in_memory(input);
        }
        let task = self.run_task(job, need.of_the_stage);
        let (reason, progress) = (self.state(job).entry.reason.clone(), task.progress.clone());
        self.listener.notify(&Event::Started { job: self.name(job), reason, progress });
        let state = self.state_mut(job);
        state.phase = Phase::Running;
        state.reserved = need.beside_what_is_held;
        self.start(Task::Run(task), need.beside_what_is_held);
        true
    }

    /// Whether so much more fits; with nothing running, room is made by letting values go.
    fn has_room(&mut self, need: u64) -> bool {
        let fits = |scheduler: &Self| scheduler.shared.held() + scheduler.reserved + need <= scheduler.settings.memory;
        while !fits(self) && self.running == 0 {
            let Some(oldest) = self.in_memory.pop_front() else { return true };
            self.shared.drop_values(oldest);
        }
        fits(self)
    }

    /// A value that others want too stays in memory once it is read.
    fn expect_in_memory(&mut self, job: usize) {
        if self.state(job).uses > 1 && self.in_memory.back() != Some(&job) {
            self.in_memory.push_back(job);
        }
    }

    fn start(&mut self, task: Task, reserved: u64) {
        if self.threads.is_empty() {
            (self.settings.start_pool)(self.settings.threads);
            self.committer.start();
        }
        self.running += 1;
        self.reserved += reserved;
        self.ledger.memory_peak = self.ledger.memory_peak.max(self.reserved + self.shared.held());
        if self.threads.len() < self.running {
            let (shared, tasks, reports) = (self.shared.clone(), self.waiting_tasks.clone(), self.report_to.clone());
            let name = format!("job-{}", self.threads.len());
            let thread = std::thread::Builder::new().name(name).spawn(move || work(&shared, &tasks, &reports));
            self.threads.push(thread.expect("the system gives a thread"));
        }
        self.tasks.send(task).expect("the scheduler holds the receiver too");
    }

    fn run_task(&self, job: usize, memory: u64) -> RunTask {
        let state = self.state(job);
        let ports = &self.shared.graph.jobs[job].inputs;
        let sources = ports.iter().map(|port| port.items.iter().map(|item| self.source(item.job, item.result)).collect()).collect();
        RunTask {
            job,
            key: state.entry.key.expect("a ready job has its key"),
            files: state.planned.files.clone(),
            sources,
            memory,
            progress: Arc::default(),
        }
    }

    fn source(&self, job: usize, result: usize) -> Source {
        let state = self.state(job);
        let record = state.record.as_ref().expect("the job is settled");
        let blob = record.outputs[result].content.clone();
        Source { job, result, key: record.key, blob, is_shared: state.uses > 1 }
    }

    fn memory_need(&self, job: usize) -> state::MemoryNeed {
        let size = |item: &InputNode| self.state(item.job).sizes[item.result];
        let is_held = |item: &InputNode| self.shared.held_by(item.job, item.result).is_some();
        state::memory_need(&self.shared.graph.jobs[job], size, is_held)
    }

    // Taking in what job threads report.

    fn take_in(&mut self, report: Report) {
        self.running -= 1;
        let job = report.job;
        match report.body {
            Body::Ran(result) => {
                let reserved = std::mem::take(&mut self.state_mut(job).reserved);
                self.reserved -= reserved;
                match result {
                    Ok(ran) => self.take_result(job, ran),
                    Err(fault) => self.take_fault(job, fault),
                }
            }
            Body::Published(result) => {
                let reserved = std::mem::take(&mut self.state_mut(job).reserved_for_files);
                self.reserved -= reserved;
                match result {
                    Ok(files) => self.take_files(job, files),
                    Err(Fault::Lost(lost)) => self.publish_again(job, lost),
                    Err(fault) => self.fail_publishing(job, fault),
                }
                self.state_mut(job).uses -= 1;
                self.drop_if_unused(job);
            }
        }
        self.relieve_memory();
    }

    fn take_result(&mut self, job: usize, ran: RanJob) {
        let state = self.state_mut(job);
        let before = state.record.take();
        let reason = state.entry.reason.clone();
        state.sizes = ran.sizes;
        self.in_memory.push_back(job);
        if before.is_some_and(|before| output_entries(&before) != output_entries(&ran.record)) {
            let kind = self.shared.graph.stages[self.shared.graph.jobs[job].stage].kind;
            self.warn(job, format!("`{kind}` gave other bytes than before with the same key; its results cannot be relied upon"));
        }
        let prepared = self.settle_one(job, ran.record, Outcome::Ran, reason);
        for job in prepared {
            self.prepare(job);
        }
    }

    fn take_fault(&mut self, job: usize, fault: Fault) {
        match fault {
            Fault::Lost(lost) => {
                let is_hopeless = lost.iter().any(|(input, what)| !self.run_again(*input, what.reason()));
                for (_, what) in &lost {
                    self.warn_of_loss(what);
                }
                if is_hopeless {
                    self.fail(job, "the store keeps losing an input".into(), Some("check the disk".into()), true);
                } else {
                    self.wait_for_inputs_again(job);
                }
            }
            Fault::Failed { message, hint } => self.fail(job, message, hint, false),
            Fault::System(message) => self.fail(job, message, None, true),
            Fault::Interrupted => {
                self.forget_key(job);
                let state = self.state_mut(job);
                state.phase = Phase::Failed;
                state.entry.outcome = Outcome::Interrupted;
                self.look_for_interrupt();
            }
        }
    }

    /// Has a settled job run once more; false if that has been tried too often.
    fn run_again(&mut self, job: usize, reason: &'static str) -> bool {
        if !self.state(job).is_settled() {
            return !self.state(job).has_failed();
        }
        let state = self.state_mut(job);
        state.reruns += 1;
        if state.reruns > RERUN_LIMIT {
            return false;
        }
        state.rerun_reason = reason;
        self.settled_count -= 1;
        // It uses its inputs once more, and is no longer there for its own users.
        for input in state::distinct_inputs(&self.shared.graph.jobs[job]) {
            self.state_mut(input).uses += 1;
        }
        for dependent in self.dependents[job].clone() {
            let state = self.state_mut(dependent);
            if state.phase == Phase::Waiting {
                state.waiting += 1;
            }
        }
        self.wait_for_inputs(job);
        true
    }

    fn wait_for_inputs_again(&mut self, job: usize) {
        self.forget_key(job);
        self.wait_for_inputs(job);
    }

    fn forget_key(&mut self, job: usize) {
        if let Some(key) = self.state(job).entry.key
            && self.by_key.get(&key) == Some(&job)
        {
            self.by_key.remove(&key);
        }
    }

    // Failing.

    fn fail_for_memory(&mut self, job: usize, need: u64) {
        let message = format!("needs about {}, more than the {} it may take", bytes_text(need), bytes_text(self.settings.memory));
        self.fail(job, message, Some("give it more with `--memory`, or ask it for less".into()), false);
    }

    fn fail(&mut self, job: usize, message: String, hint: Option<String>, is_of_the_system: bool) {
        self.forget_key(job);
        let failure = self.failure(job, message, hint, is_of_the_system);
        let state = self.state_mut(job);
        state.phase = Phase::Failed;
        state.entry.outcome = Outcome::Failed;
        state.entry.error = Some(failure.message.clone());
        let followers = std::mem::take(&mut state.followers);
        self.settled_count += 1;
        self.tell_finished(job, Some(failure.clone()));
        self.ledger.failures.push(failure);
        self.stop_unless_keeping_on(is_of_the_system);
        self.release_inputs(job);
        self.skip_dependents(job);
        for follower in followers {
            self.wait_for_inputs(follower);
        }
    }

    fn failure(&self, job: usize, message: String, hint: Option<String>, is_of_the_system: bool) -> Failure {
        let (file, line) = &self.shared.graph.stages[self.shared.graph.jobs[job].stage].place;
        Failure { place: format!("{file}:{line}"), job: self.name(job), message, hint, is_of_the_system }
    }

    fn stop_unless_keeping_on(&mut self, is_of_the_system: bool) {
        // A full disk is full for every job.
        self.is_stopping |= !self.settings.keep_going || is_of_the_system;
    }

    fn skip_dependents(&mut self, job: usize) {
        for dependent in self.dependents[job].clone() {
            if self.state(dependent).phase == Phase::Waiting {
                self.skip(dependent);
            }
        }
    }

    fn skip(&mut self, job: usize) {
        let inputs = state::distinct_inputs(&self.shared.graph.jobs[job]);
        let failed = inputs.into_iter().find(|input| self.state(*input).has_failed());
        let reason = failed.map(|input| format!("input {} failed", self.name(input))).unwrap_or_default();
        let state = self.state_mut(job);
        state.phase = Phase::Failed;
        state.entry.outcome = Outcome::Skipped;
        state.entry.reason = reason;
        self.settled_count += 1;
        self.tell_finished(job, None);
        self.release_inputs(job);
        self.skip_dependents(job);
    }

    /// After the run: what was not started, or was still running when it was given up.
    fn skip_the_rest(&mut self) {
        for state in self.jobs.iter_mut().flatten() {
            match state.phase {
                Phase::Running => state.entry.outcome = Outcome::Interrupted,
                Phase::Waiting | Phase::Ready => {
                    state.entry.outcome = Outcome::Skipped;
                    state.entry.reason = "the run ended before".to_owned();
                }
                Phase::Settled | Phase::Failed => {}
            }
        }
    }

    // Publishing.

    /// Finds the files of a settled job that are not in place, and has them published.
    fn plan_publications(&mut self, job: usize) {
        let shared = self.shared.clone();
        let mut files = Vec::new();
        for (publication, wanted) in shared.graph.jobs[job].publications.iter().enumerate() {
            if self.state(job).published.contains(&publication) {
                continue;
            }
            let file = self.file_to_publish(job, publication);
            match &file.record {
                Some(record) if self.is_in_place(&wanted.path, record.content.digest) => {
                    let record = record.clone();
                    self.note_file(job, publication, &record);
                }
                _ => files.push(file),
            }
        }
        if !files.is_empty() {
            self.state_mut(job).uses += 1;
            self.to_publish.push_back(PublishTask { job, files });
        }
    }

    fn file_to_publish(&self, job: usize, publication: usize) -> FileToPublish {
        let graph = &self.shared.graph;
        let node = &graph.jobs[job];
        let wanted = &node.publications[publication];
        let source = self.source(job, wanted.result);
        let stage = &graph.stages[node.stage];
        let (result_name, type_name) = stage.results[wanted.result];
        let point = if result_name.is_empty() { "" } else { "." };
        let origin = super::artifact::Origin {
            pipeline: graph.pipeline.clone(),
            stage: format!("{}{point}{result_name}", stage.name),
            coordinate: node.coordinate.to_string(),
            key: source.key.to_string(),
        };
        let version = self.shared.artifact_kind(type_name).encoder_version;
        let key = key::publication_key(type_name, &source.blob.digest, &wanted.format, version, &origin);
        let known = self.index.publication(&key).cloned();
        let record = known.or_else(|| self.shared.library.publication(&key).ok());
        FileToPublish { publication, key, origin, source, record }
    }

    /// Whether a published file has its bytes; tells if someone has changed it.
    fn is_in_place(&mut self, path: &str, digest: Digest) -> bool {
        let Some((status, file)) = self.shared.outputs.open(path) else { return false };
        let known = self.signatures.known(&status);
        let Some(found) = known.or_else(|| self.signatures.content_of_file(file).ok().map(|content| content.digest)) else {
            return false;
        };
        if found != digest && self.standing.and_then(|standing| standing.digest_of(path)) != Some(found) {
            self.ledger.warnings.push((String::new(), format!("`{path}` had been changed since it was published, and was replaced")));
        }
        found == digest
    }

    fn take_files(&mut self, job: usize, files: Vec<(usize, PublicationRecord)>) {
        for (publication, record) in files {
            let path = self.shared.graph.jobs[job].publications[publication].path.clone();
            self.listener.notify(&Event::Published { path: path.clone() });
            self.ledger.written.push(path);
            self.note_file(job, publication, &record);
        }
    }

    fn note_file(&mut self, job: usize, publication: usize, record: &PublicationRecord) {
        let graph = &self.shared.graph;
        let node = &graph.jobs[job];
        let wanted = &node.publications[publication];
        let name = result_name(graph, node, wanted.result);
        self.ledger.published.push(PublishedEntry { path: wanted.path.clone(), sha256: record.content.digest, job: name });
        self.ledger.index.add_publication(record);
        for warning in &record.warnings {
            self.warn(job, warning.clone());
        }
        self.state_mut(job).published.push(publication);
    }

    fn publish_again(&mut self, job: usize, lost: Vec<(usize, Lost)>) {
        let reason = lost.first().map_or("result missing", |(_, what)| what.reason());
        for (_, what) in &lost {
            self.warn_of_loss(what);
        }
        // Its files are planned again when it has settled again.
        if !self.run_again(job, reason) {
            self.fail_publishing(job, Fault::System("the store keeps losing a result".into()));
        }
    }

    fn fail_publishing(&mut self, job: usize, fault: Fault) {
        let (message, hint, is_of_the_system) = match fault {
            Fault::Failed { message, hint } => (message, hint, false),
            Fault::System(message) => (message, None, true),
            Fault::Interrupted | Fault::Lost(_) => {
                self.look_for_interrupt();
                return;
            }
        };
        let failure = self.failure(job, message, hint, is_of_the_system);
        let state = self.state_mut(job);
        state.entry.error = Some(failure.message.clone());
        state.entry.outcome = Outcome::Failed;
        self.tell_finished(job, Some(failure.clone()));
        self.ledger.failures.push(failure);
        self.stop_unless_keeping_on(is_of_the_system);
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
        let total = self.jobs.iter().flatten().count();
        let entry = &self.state(job).entry;
        let ran = entry.measured.filter(|_| entry.outcome == Outcome::Ran);
        let event = Event::Finished {
            job: self.name(job),
            outcome: entry.outcome,
            reason: entry.reason.clone(),
            seconds: ran.map_or(0.0, |measured| measured.seconds),
            done: self.settled_count,
            total,
            error,
        };
        self.listener.notify(&event);
    }

    fn warn(&mut self, job: usize, message: String) {
        let stage = self.shared.graph.stages[self.shared.graph.jobs[job].stage].name.clone();
        self.ledger.warnings.push((stage, message));
    }

    fn warn_of_loss(&mut self, lost: &Lost) {
        let message = match lost {
            Lost::Missing => "the store lacked a result and computes it again".to_owned(),
            Lost::Damaged(what) => format!("the store was damaged and is repaired: {what}"),
        };
        self.ledger.warnings.push((String::new(), message));
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
        let shared = self.shared.clone();
        for (job, node) in shared.graph.jobs.iter().enumerate().filter(|(_, node)| node.is_wanted) {
            let mut inputs = std::mem::take(&mut self.state_mut(job).entry.inputs);
            fill_inputs(&mut inputs, node, |item| self.state(item.job).content(item.result));
            self.state_mut(job).entry.inputs = inputs;
        }
        let committed = self.committer.finish();
        let entries = self.jobs.into_iter().flatten().map(|state| state.entry).collect();
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

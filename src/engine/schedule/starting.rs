//! What starts next: files before jobs, the job on the longest path first, and no more than memory allows.

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use super::Scheduler;
use super::elsewhere::Flight;
use super::role::Beginning;
use super::state::{self, Phase, Ready};
use super::values::Source;
use super::worker::{FileToPublish, RunTask, Task, work};
use crate::engine::events::Event;
use crate::engine::files;
use crate::engine::graph::InputNode;

/// While tasks take less than this, more of them are handed out than there are threads.
const TRIVIAL: Duration = Duration::from_millis(1);

/// So many a thread.
const AHEAD: usize = 8;

impl Scheduler<'_> {
    pub(super) fn start_what_can(&mut self) {
        // A thread that finds its next task waiting need not be woken for it, which takes longer than a trivial job.
        let ahead = if self.usual_time < TRIVIAL { AHEAD } else { 1 };
        while !self.is_stopping && !self.is_leaving() && self.running < ahead * self.settings.threads.get() {
            let is_started = if self.to_publish.is_empty() { self.start_next_job() } else { self.start_next_publication() };
            if !is_started {
                return;
            }
        }
    }

    /// Publishing comes first: it needs no other job and lets values go.
    pub(super) fn start_next_publication(&mut self) -> bool {
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
    pub(super) fn start_next_job(&mut self) -> bool {
        let Some(Ready { job, .. }) = self.ready.peek().copied() else { return false };
        if self.is_handed_out(job) {
            self.ready.pop();
            return true;
        }
        let need = self.memory_need(job);
        if need.at_all > self.settings.memory {
            self.ready.pop();
            self.fail_for_memory(job, need.at_all);
            return true;
        }
        let threads = self.threads_of(job);
        if !self.has_threads(threads) || !self.has_room(need.beside_what_is_held) {
            return false;
        }
        self.ready.pop();
        if self.is_left_to_another(job) {
            return true;
        }
        let claim = match self.worker_begins(job) {
            Beginning::Begins(claim) => claim,
            Beginning::IsSettled => return true,
        };
        self.say_started(job);
        for input in self.inputs_of(job) {
            self.expect_in_memory(input);
        }
        let task = self.run_task(job, need.of_the_stage);
        let (reason, progress) = (self.state(job).entry.reason.clone(), task.progress.clone());
        self.listener.notify(&Event::Started { job: self.name(job), reason, progress });
        self.flights.push(Flight::new(job, threads, task.withdrawn.clone(), claim));
        let state = self.state_mut(job);
        state.phase = Phase::Running;
        state.reserved = need.beside_what_is_held;
        self.start(Task::Run(task), need.beside_what_is_held);
        true
    }

    /// Threads that a job counts as: what its stage asks for, and no more than there are.
    fn threads_of(&self, job: usize) -> usize {
        self.asked_by(job).threads.map_or(1, usize::from).min(self.settings.threads.get())
    }

    /// Whether a job that counts as so many threads may start beside those that run.
    fn has_threads(&self, threads: usize) -> bool {
        let is_plain = threads == 1 && self.flights.iter().all(|flight| flight.threads == 1);
        let taken: usize = self.flights.iter().map(|flight| flight.threads).sum();
        is_plain || taken == 0 || taken + threads <= self.settings.threads.get()
    }

    /// Whether so much more fits; with nothing running, room is made by letting values go.
    pub(super) fn has_room(&mut self, need: u64) -> bool {
        let fits = |scheduler: &Self| scheduler.shared.held() + scheduler.reserved + need <= scheduler.settings.memory;
        while !fits(self) && self.running == 0 {
            let Some(oldest) = self.in_memory.pop_front() else { return true };
            self.shared.drop_values(oldest);
        }
        fits(self)
    }

    /// A value that others want too stays in memory once it is read.
    pub(super) fn expect_in_memory(&mut self, job: usize) {
        if self.state(job).uses > 1 && self.in_memory.back() != Some(&job) {
            self.in_memory.push_back(job);
        }
    }

    pub(super) fn start(&mut self, task: Task, reserved: u64) {
        if self.threads.is_empty() {
            (self.settings.start_pool)(self.settings.threads);
            self.committer.start();
        }
        self.running += 1;
        self.reserved += reserved;
        self.ledger.memory_peak = self.ledger.memory_peak.max(self.reserved + self.shared.held());
        if self.threads.len() < self.running.min(self.settings.threads.get()) {
            let (shared, tasks, reports) = (self.shared.clone(), self.waiting_tasks.clone(), self.report_to.clone());
            let number = self.threads.len() as u32;
            let name = format!("job-{number}");
            let thread = std::thread::Builder::new().name(name).spawn(move || work(number, &shared, &tasks, &reports));
            self.threads.push(thread.expect("the system gives a thread"));
        }
        self.tasks.send(task).expect("the scheduler holds the receiver too");
    }

    pub(super) fn run_task(&self, job: usize, memory: u64) -> RunTask {
        let state = self.state(job);
        let ports = &self.shared.graph.jobs[job].inputs;
        let sources = ports.iter().map(|port| port.items.iter().map(|item| self.source(item.job, item.result)).collect()).collect();
        let results = |part: usize| (0..self.state(part).sizes.len()).map(|result| self.source(part, result)).collect();
        RunTask {
            job,
            key: state.entry.key.expect("a ready job has its key"),
            files: state.planned.files.clone(),
            sources,
            parts: self.parts_of(job).map(results).collect(),
            memory,
            progress: Arc::default(),
            withdrawn: Arc::default(),
        }
    }

    pub(super) fn source(&self, job: usize, result: usize) -> Source {
        let state = self.state(job);
        let record = state.record.as_ref().expect("the job is settled");
        let blob = record.outputs[result].content.clone();
        Source { job, result, key: record.key, blob, is_shared: state.uses > 1 }
    }

    pub(super) fn memory_need(&self, job: usize) -> state::MemoryNeed {
        let size = |item: &InputNode| self.state(item.job).sizes[item.result];
        let is_held = |item: &InputNode| self.shared.held_by(item.job, item.result).is_some();
        // A file that is gone by now fails the job when it is read.
        let file_size = |path: &Path| files::status(path).map_or(0, |status| status.len());
        let estimated = state::memory_need(&self.shared.graph.jobs[job], size, is_held, file_size);
        // One part after the other is read.
        let of_part = self.parts_of(job).map(|part| self.state(part).sizes.iter().sum()).max().unwrap_or(0);
        estimated.and(of_part).at_least(self.asked_by(job).memory.unwrap_or(0))
    }
}

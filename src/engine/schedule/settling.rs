//! A job's results become known: by the plan, by a look into the store, from another job, or because it ran.
//!
//! Whatever settles lets its users count down; one that has all its inputs gets its key, and is looked for under it
//! before it is made ready (early cutoff).

use super::Scheduler;
use super::state::{Phase, critical_paths};
use crate::engine::digest::Digest;
use crate::engine::events::Event;
use crate::engine::freshness::{HIT_REASON, fill_inputs, in_parts, is_whole, output_entries};
use crate::engine::graph::InputNode;
use crate::engine::key;
use crate::engine::manifest::{JobMeasured, Outcome, job_name};
use crate::engine::store::library::Lost;
use crate::engine::store::record::ResultRecord;

/// The results of a job, what is to be said to have become of it, and why.
type Known = (ResultRecord, Outcome, String);

impl Scheduler<'_> {
    /// Settles every job that the plan found in the store, and prepares those whose inputs are all settled.
    pub(super) fn begin(&mut self) {
        let wanted: Vec<usize> = (0..self.jobs.len()).filter(|job| self.jobs[*job].is_some()).collect();
        let hits = wanted.iter().filter(|job| self.state(**job).is_hit()).count();
        self.listener.notify(&Event::Planned { jobs: wanted.len(), hits });
        if hits < wanted.len() {
            self.set_priorities();
            self.look_around();
        }
        for &job in &wanted {
            let uses = self.dependents[job].len();
            let state = self.state_mut(job);
            state.uses = uses;
            // Not counted yet: settling an input must not count it down.
            state.waiting = usize::MAX;
        }
        self.fetch_publications(&wanted);
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

    pub(super) fn set_priorities(&mut self) {
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

    /// Counts what a job still waits for, and prepares it if that is nothing.
    pub(super) fn wait_for_inputs(&mut self, job: usize) {
        let inputs = self.inputs_of(job);
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
    pub(super) fn prepare(&mut self, job: usize) {
        let mut prepared = vec![job];
        while let Some(job) = prepared.pop() {
            // A job that follows another may be named twice.
            let state = self.state(job);
            if state.phase != Phase::Waiting || state.waiting != 0 {
                continue;
            }
            if let Some((record, outcome, reason)) = self.prepare_one(job) {
                prepared.extend(self.settle_one(job, record, outcome, reason));
            }
        }
    }

    /// The results, if the store or a job with the same key has them; else the job is ready, or follows another.
    pub(super) fn prepare_one(&mut self, job: usize) -> Option<Known> {
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
                if self.is_of_a_worker(&key) {
                    return Some((record, Outcome::Ran, self.history_reason(job)));
                }
                return Some((record, Outcome::Hit, HIT_REASON.to_owned()));
            }
        }
        self.make_ready(job, key, reason);
        None
    }

    /// A job with the same key as another of this run has its results, or will have.
    pub(super) fn follow(&mut self, job: usize, leader: usize) -> Option<Known> {
        match self.state(leader).record.clone() {
            Some(record) if self.state(leader).is_settled() => {
                let reason = format!("the same as {}", job_name(&self.shared.graph, &self.shared.graph.jobs[leader]));
                Some((record, Outcome::Hit, reason))
            }
            _ => {
                self.state_mut(leader).followers.push(job);
                None
            }
        }
    }

    pub(super) fn look_up(&mut self, job: usize, key: &Digest) -> Option<ResultRecord> {
        // The plan has looked under this key already.
        if self.state(job).planned.key == Some(*key) {
            return None;
        }
        let is_whole = |record: &ResultRecord| is_whole(&self.shared.graph, &self.shared.graph.jobs[job], record);
        if let Some(record) = self.index.result_of_key(key).filter(|record| is_whole(record)) {
            return Some(record.clone());
        }
        match self.shared.library.result(key) {
            Ok(record) => Some(record).filter(is_whole),
            Err(Lost::Missing) => None,
            Err(lost @ Lost::Damaged(_)) => {
                self.state_mut(job).rerun_reason = lost.reason();
                None
            }
        }
    }

    /// Why a job runs that the store does not have.
    fn history_reason(&mut self, job: usize) -> String {
        let entry = self.state(self.whole_of(job).unwrap_or(job)).entry.clone();
        in_parts(&self.shared.graph.jobs[job], self.history.reason(&entry))
    }

    pub(super) fn make_ready(&mut self, job: usize, key: Digest, reason: &'static str) {
        if self.waits_for_parts(job, key) {
            return;
        }
        let reason = if !reason.is_empty() { reason } else { self.state(job).rerun_reason };
        let reason = if reason.is_empty() { self.history_reason(job) } else { reason.to_owned() };
        self.by_key.insert(key, job);
        let state = self.state_mut(job);
        state.entry.reason = reason;
        state.phase = Phase::Ready;
        let priority = state.priority;
        self.push_ready(job, priority);
    }

    /// Notes the results of a job, publishes, and gives the jobs that now have all their inputs.
    pub(super) fn settle_one(&mut self, job: usize, record: ResultRecord, outcome: Outcome, reason: String) -> Vec<usize> {
        let shared = self.shared.clone();
        let node = &shared.graph.jobs[job];
        self.settled_count += 1;
        let host = self.host_of(&record);
        let state = self.state_mut(job);
        state.phase = Phase::Settled;
        state.entry.outcome = outcome;
        state.entry.reason = reason;
        state.entry.outputs = output_entries(&record);
        state.entry.warnings = record.warnings.iter().cloned().chain(node.parameters.caveats()).collect();
        let (start, thread) = state.span.filter(|_| outcome == Outcome::Ran).unzip();
        state.entry.measured = Some(JobMeasured { seconds: record.seconds, memory: record.memory, start, thread, host });
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
    pub(super) fn release_inputs(&mut self, job: usize) {
        for input in self.inputs_of(job) {
            self.state_mut(input).uses -= 1;
            self.drop_if_unused(input);
        }
    }

    pub(super) fn drop_if_unused(&mut self, job: usize) {
        if self.state(job).uses == 0 {
            self.shared.drop_values(job);
        }
    }
}

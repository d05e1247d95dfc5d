//! Takes in what job threads report: results, faults, and results that the store has lost.

use super::Scheduler;
use super::state::Phase;
use super::worker::{Body, Fault, RanJob, Report};
use crate::engine::freshness::output_entries;
use crate::engine::manifest::Outcome;
use crate::engine::store::claims::Claim;

/// A job that the store lost so often in one run is not tried again: the disk is at fault.
const RERUN_LIMIT: u32 = 2;

impl Scheduler<'_> {
    pub(super) fn take_in(&mut self, report: Report) {
        self.running -= 1;
        self.usual_time = (self.usual_time * 3 + report.time) / 4;
        let job = report.job;
        match report.body {
            Body::Ran(result) => {
                let start = report.start.saturating_duration_since(self.began).as_secs_f64();
                self.state_mut(job).span = Some((start, report.thread));
                let reserved = std::mem::take(&mut self.state_mut(job).reserved);
                self.reserved -= reserved;
                let (claim, is_long) = self.end_flight(job);
                match result {
                    Ok(ran) => self.take_result(job, ran),
                    Err(fault) => self.take_fault(job, fault),
                }
                // The record was handed in before the job was reported: the claim goes once it is there.
                self.committer.let_go(claim, is_long);
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

    /// The claim of a job that has ended, and whether others may be waiting for it.
    fn end_flight(&mut self, job: usize) -> (Option<Claim>, bool) {
        let Some(index) = self.flights.iter().position(|flight| flight.job == job) else { return (None, false) };
        let flight = self.flights.swap_remove(index);
        let is_long = flight.is_long();
        (flight.into_claim(), is_long)
    }

    pub(super) fn take_result(&mut self, job: usize, ran: RanJob) {
        let state = self.state_mut(job);
        let before = state.record.take();
        let reason = state.entry.reason.clone();
        state.sizes = ran.sizes;
        self.in_memory.push_back(job);
        if before.is_some_and(|before| output_entries(&before) != output_entries(&ran.record)) {
            let kind = self.shared.graph.stages[self.shared.graph.jobs[job].stage].kind;
            self.ledger.has_passing_warnings = true;
            self.warn(job, format!("`{kind}` gave other bytes than before with the same key; its results cannot be relied upon"));
        }
        self.say_computed(&ran.record);
        let prepared = self.settle_one(job, ran.record, Outcome::Ran, reason);
        for job in prepared {
            self.prepare(job);
        }
    }

    pub(super) fn take_fault(&mut self, job: usize, fault: Fault) {
        self.say_gave_up(job);
        match fault {
            Fault::Lost(lost) => {
                let is_hopeless = lost.iter().any(|(input, what)| !self.run_again(*input, what.reason()));
                if is_hopeless {
                    self.fail(job, "the store keeps losing an input".into(), Some("check the disk".into()), true);
                } else {
                    self.wait_for_inputs_again(job);
                }
            }
            Fault::Failed { message, hint } => self.fail(job, message, hint, false),
            Fault::System(message) => self.fail(job, message, None, true),
            Fault::Withdrawn => self.take_withdrawal(job),
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
    pub(super) fn run_again(&mut self, job: usize, reason: &'static str) -> bool {
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
        for input in self.inputs_of(job) {
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

    pub(super) fn wait_for_inputs_again(&mut self, job: usize) {
        self.forget_key(job);
        self.wait_for_inputs(job);
    }

    pub(super) fn forget_key(&mut self, job: usize) {
        if let Some(key) = self.state(job).entry.key
            && self.by_key.get(&key) == Some(&job)
        {
            self.by_key.remove(&key);
        }
    }
}

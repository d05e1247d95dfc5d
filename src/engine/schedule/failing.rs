//! Jobs that give no result, and what becomes of those that wanted it.

use super::state::Phase;
use super::{Scheduler, bytes_text};
use crate::engine::events::Failure;
use crate::engine::manifest::Outcome;

impl Scheduler<'_> {
    pub(super) fn fail_for_memory(&mut self, job: usize, need: u64) {
        let message = format!("needs about {}, more than the {} it may take", bytes_text(need), bytes_text(self.settings.memory));
        self.fail(job, message, Some("give it more with `--memory`, or ask it for less".into()), false);
    }

    pub(super) fn fail(&mut self, job: usize, message: String, hint: Option<String>, is_of_the_system: bool) {
        self.forget_key(job);
        let failure = self.failure(job, message, hint, is_of_the_system);
        self.note_failure(job, &failure);
        if let Some(whole) = self.whole_of(job) {
            return self.fail_part(job, whole, failure);
        }
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

    pub(super) fn failure(&self, job: usize, message: String, hint: Option<String>, is_of_the_system: bool) -> Failure {
        let (file, line) = &self.shared.graph.stages[self.shared.graph.jobs[job].stage].place;
        Failure { place: format!("{file}:{line}"), job: self.name(job), message, hint, is_of_the_system }
    }

    pub(super) fn stop_unless_keeping_on(&mut self, is_of_the_system: bool) {
        // A full disk is full for every job.
        self.is_stopping |= !self.settings.keep_going || is_of_the_system;
    }

    pub(super) fn skip_dependents(&mut self, job: usize) {
        for dependent in self.dependents[job].clone() {
            if self.state(dependent).phase == Phase::Waiting {
                self.skip(dependent);
            }
        }
    }

    pub(super) fn skip(&mut self, job: usize) {
        let inputs = self.inputs_of(job);
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
    pub(super) fn skip_the_rest(&mut self) {
        let has_begun: Vec<bool> = (0..self.jobs.len()).map(|job| self.parts_of(job).next().is_some()).collect();
        for (state, has_begun) in self.jobs.iter_mut().zip(has_begun).filter_map(|(state, has_begun)| Some((state.as_mut()?, has_begun))) {
            match state.phase {
                Phase::Running => state.entry.outcome = Outcome::Interrupted,
                Phase::Waiting if has_begun => state.entry.outcome = Outcome::Interrupted,
                Phase::Waiting | Phase::Ready | Phase::Elsewhere => {
                    state.entry.outcome = Outcome::Skipped;
                    state.entry.reason = "the run ended before".to_owned();
                }
                Phase::Settled | Phase::Failed => {}
            }
        }
    }
}

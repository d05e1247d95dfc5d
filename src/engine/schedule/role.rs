//! Whose hands do the work: this process's, or those of workers; and what a worker does otherwise.
//!
//! A driver hands every job that may wait to its workers and settles it when its record is in the store. A worker claims a job
//! before it begins it, goes on with what it has in memory, and leaves when it is told to.

use std::sync::atomic::Ordering;
use std::time::Instant;

use super::Scheduler;
use super::state::Phase;
use crate::engine::digest::Digest;
use crate::engine::events::{Event, Failure};
use crate::engine::manifest::Outcome;
use crate::engine::resources::Resources;
use crate::engine::store::claims::Claim;
use crate::engine::store::record::ResultRecord;
use crate::engine::team::folder::FailureNote;
use crate::engine::team::hand::Hand;
use crate::engine::team::journal::{Said, clock};
use crate::engine::team::overseer::Overseer;

/// What this process does of the run.
pub enum Role {
    /// Computes and publishes.
    Alone,
    /// Computes what a driver publishes.
    Worker(Box<Hand>),
    /// Publishes what workers compute.
    Driver(Box<Overseer>),
}

/// What becomes of a job that a worker is about to begin.
pub(super) enum Beginning {
    /// It is begun, under this claim if one could be made.
    Begins(Option<Claim>),
    /// It is taken care of.
    IsSettled,
}

impl Scheduler<'_> {
    /// What a job asks of the machine.
    pub(super) fn asked_by(&self, job: usize) -> Resources {
        self.shared.graph.stages[self.shared.graph.jobs[job].stage].resources
    }

    pub(super) fn is_driver(&self) -> bool {
        matches!(self.role, Role::Driver(_))
    }

    /// Hands a ready job to the workers; false for one that this process has to run itself: one that is to run whatever the
    /// store has, which no record would end.
    pub(super) fn is_handed_out(&mut self, job: usize) -> bool {
        let (Some(key), asked) = (self.awaitable_key(job), self.asked_by(job)) else { return false };
        let Role::Driver(overseer) = &mut self.role else { return false };
        overseer.hand_out(key, job, &asked);
        self.state_mut(job).phase = Phase::Elsewhere;
        true
    }

    /// Whether workers still have something to do.
    pub(super) fn is_waiting_for_workers(&self) -> bool {
        matches!(&self.role, Role::Driver(overseer) if overseer.is_waiting())
    }

    /// Takes in what workers did.
    pub(super) fn oversee(&mut self) {
        let Role::Driver(overseer) = &mut self.role else { return };
        let Some(news) = overseer.news() else { return };
        if news.is_cancelled {
            self.interrupted_at.get_or_insert_with(Instant::now);
            self.is_stopping = true;
        }
        if let Some((workers, reason)) = news.waiting {
            self.listener.notify(&Event::Waiting { workers, reason });
        }
        for (key, host) in news.begun {
            self.tell_begun(&key, &host);
        }
        let begun = Instant::now();
        let count = news.perhaps_done.len();
        for key in news.perhaps_done {
            self.settle_if_done(&key);
        }
        for note in news.failed {
            self.take_failure(note);
        }
        let Role::Driver(overseer) = &mut self.role else { return };
        overseer.has_looked(count, begun.elapsed());
        let open = self.open_jobs();
        let Role::Driver(overseer) = &mut self.role else { return };
        overseer.want(&open, self.settled_count);
        if let Some(problem) = overseer.problem()
            && self.ledger.no_workers.is_none()
        {
            self.ledger.no_workers = Some(problem);
            self.is_stopping = true;
        }
    }

    /// How many jobs of each stage have neither a result nor failed, with what they ask for.
    fn open_jobs(&self) -> Vec<(Resources, usize)> {
        let graph = &self.shared.graph;
        let mut counts: Vec<(Resources, usize)> = graph.stages.iter().map(|stage| (stage.resources, 0)).collect();
        for (node, state) in graph.jobs.iter().zip(&self.jobs) {
            let is_open = state.as_ref().is_some_and(|state| !state.is_settled() && !state.has_failed());
            counts[node.stage].1 += usize::from(is_open);
        }
        // A stage that no one wants has no class.
        counts.retain(|(_, count)| *count > 0);
        counts
    }

    fn awaited(&self, key: &Digest) -> Option<usize> {
        match &self.role {
            Role::Driver(overseer) => overseer.awaited(key),
            Role::Alone | Role::Worker(_) => None,
        }
    }

    fn take_back(&mut self, key: &Digest, job: usize) {
        let asked = self.asked_by(job);
        if let Role::Driver(overseer) = &mut self.role {
            overseer.take_back(key, &asked);
        }
    }

    fn tell_begun(&mut self, key: &Digest, host: &str) {
        if let Some(job) = self.awaited(key) {
            let reason = format!("on {host}");
            self.listener.notify(&Event::Started { job: self.name(job), reason, progress: Default::default() });
        }
    }

    fn settle_if_done(&mut self, key: &Digest) {
        let Some(job) = self.awaited(key) else { return };
        let Some(record) = self.record_of_another(job, key) else { return };
        self.take_back(key, job);
        if self.is_of_a_worker(key) {
            let reason = self.state(job).entry.reason.clone();
            let prepared = self.settle_one(job, record, Outcome::Ran, reason);
            prepared.into_iter().for_each(|job| self.prepare(job));
        } else {
            self.settle_from_another(job, record);
        }
    }

    /// Whether a worker of this run says that it has computed what the store has.
    pub(super) fn is_of_a_worker(&mut self, key: &Digest) -> bool {
        let Role::Driver(overseer) = &mut self.role else { return false };
        if overseer.author(key).is_none() {
            // What is in the store was announced before, but perhaps not read.
            overseer.read_again();
        }
        overseer.author(key).is_some()
    }

    fn take_failure(&mut self, note: FailureNote) {
        let Some(job) = self.awaited(&note.key) else { return };
        self.take_back(&note.key, job);
        let FailureNote { message, hint, is_of_the_system, host, .. } = note;
        let message = if is_of_the_system { format!("on {host}: {message}") } else { message };
        self.fail(job, message, hint, is_of_the_system);
    }

    /// The machine that computed a job, if a worker of this run did.
    pub(super) fn host_of(&self, record: &ResultRecord) -> Option<String> {
        let Role::Driver(overseer) = &self.role else { return None };
        overseer.author(&record.key).map(str::to_owned)
    }

    /// At the end: what was taken for another run's work may turn out to be a worker's.
    pub(super) fn name_authors(&mut self) {
        let Role::Driver(overseer) = &mut self.role else { return };
        overseer.read_again();
        for state in self.jobs.iter_mut().flatten() {
            let author = state.entry.key.as_ref().and_then(|key| overseer.author(key));
            if let (Some(author), Some(measured)) = (author, &mut state.entry.measured) {
                measured.host = Some(author.to_owned());
                if state.entry.outcome == Outcome::Hit && !state.is_hit() {
                    state.entry.outcome = Outcome::Ran;
                }
            }
        }
        overseer.end(self.interrupted_at.is_some());
    }

    // A worker.

    /// Whether it is to begin no more jobs.
    pub(super) fn is_leaving(&self) -> bool {
        matches!(&self.role, Role::Worker(hand) if hand.is_leaving())
    }

    /// Says that this worker is there, and hears whether it is to end.
    pub(super) fn tend_hand(&mut self) {
        if let Role::Worker(hand) = &mut self.role {
            hand.tend();
        }
    }

    /// Whether a job is for others alone: this worker has not what it asks for.
    pub(super) fn is_for_others(&self, job: usize) -> bool {
        matches!(&self.role, Role::Worker(hand) if !hand.takes(&self.asked_by(job)))
    }

    /// Claims a job that this worker is about to begin, so that no other does the same.
    pub(super) fn worker_begins(&mut self, job: usize) -> Beginning {
        let key = self.state(job).entry.key.expect("a ready job has its key");
        let Role::Worker(hand) = &self.role else { return Beginning::Begins(None) };
        if let Some(note) = hand.folder.failure(&key) {
            self.fail_as_noted(job, note);
            return Beginning::IsSettled;
        }
        let claim = self.claims.take(&key);
        if claim.is_none()
            && let Some(holder) = self.claims.holder(&key)
        {
            self.wait_for(job, &holder);
            return Beginning::IsSettled;
        }
        // A claim goes only when the record is there: what another has done since the last look shows now.
        match self.record_of_another(job, &key).filter(|_| self.awaitable_key(job).is_some()) {
            Some(record) => {
                self.settle_from_another(job, record);
                Beginning::IsSettled
            }
            None => Beginning::Begins(claim),
        }
    }

    /// Another worker found that this job fails.
    fn fail_as_noted(&mut self, job: usize, note: FailureNote) {
        let FailureNote { message, hint, is_of_the_system, .. } = note;
        self.fail(job, message, hint, is_of_the_system);
    }

    pub(super) fn say_started(&mut self, job: usize) {
        let (key, name) = (self.state(job).entry.key, self.name(job));
        if let (Role::Worker(hand), Some(key)) = (&mut self.role, key) {
            hand.journal.say(&Said::Started { key, job: name });
        }
    }

    pub(super) fn say_computed(&mut self, record: &ResultRecord) {
        if let Role::Worker(hand) = &mut self.role {
            hand.journal.say(&Said::Computed { key: record.key, seconds: record.seconds, at: clock() });
        }
    }

    pub(super) fn say_gave_up(&mut self, job: usize) {
        let key = self.state(job).entry.key;
        if let Role::Worker(hand) = &mut self.role {
            hand.give_up(key);
        }
    }

    pub(super) fn note_failure(&mut self, job: usize, failure: &Failure) {
        let key = self.state(job).entry.key;
        if let (Role::Worker(hand), Some(key)) = (&self.role, key) {
            hand.note_failure(key, failure);
        }
    }

    /// Whether a job goes on with what this worker has computed and still has in memory: such jobs come first, so that a chain
    /// stays where its data is.
    pub(super) fn is_near(&self, job: usize) -> bool {
        let has_value = |input: usize| {
            let state = self.state(input);
            state.entry.outcome == Outcome::Ran && state.is_settled() && self.shared.held_by(input, 0).is_some()
        };
        matches!(self.role, Role::Worker(_)) && self.inputs_of(job).into_iter().any(has_value)
    }

    /// Whether the run was told to stop from outside.
    pub(super) fn is_interrupted(&self) -> bool {
        self.shared.interrupted.load(Ordering::Relaxed)
    }
}

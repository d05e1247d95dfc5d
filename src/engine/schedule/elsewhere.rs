//! Jobs that another run computes at the same time: waited for, overtaken, or left to it.
//!
//! A job that has run for [`SHORT`] is claimed; shorter ones never pay for a claim. Of them, runs that see each other at work
//! take each in an order of its own, and make their records seen sooner. A job that another run has claimed
//! waits, while others go on, until its record is there or the claim is gone. If two runs began the same job at
//! about the same time, the one that claims second gives it up. All of it rests on looks at the store every
//! [`LOOK`]; nothing is ever refused, and at worst a job is computed twice.

use std::hash::{BuildHasher, Hasher};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use super::Scheduler;
use super::role::Role;
use super::state::{Order, Phase, Ready};
use crate::engine::digest::Digest;
use crate::engine::events::Event;
use crate::engine::freshness::is_whole;
use crate::engine::manifest::Outcome;
use crate::engine::store::claims::{Claim, Holder};
use crate::engine::store::record::ResultRecord;

/// A job that runs longer than this is claimed.
const SHORT: Duration = Duration::from_millis(50);

/// Time between two looks whether other runs are at work.
const GLANCE_AROUND: Duration = Duration::from_millis(50);

/// Time between two looks at the store for what others compute.
const LOOK: Duration = Duration::from_millis(10);

/// Looks take one part in so many of the time at most.
const SHARE: u32 = 10;

/// What is said of a job that another run computed while this one waited or was about to begin.
const COMPUTED_ELSEWHERE: &str = "computed by another run";

/// A job that runs here.
pub struct Flight {
    /// Its index.
    pub job: usize,
    /// Threads that it counts as.
    pub threads: usize,
    since: Instant,
    claim: Option<Claim>,
    /// Whether it was tried to claim it.
    is_settled: bool,
    /// Set when it is left to another run.
    withdrawn: Arc<AtomicBool>,
}

impl Flight {
    /// A job that begins, with its claim if that was made before.
    pub fn new(job: usize, threads: usize, withdrawn: Arc<AtomicBool>, claim: Option<Claim>) -> Self {
        Self { job, threads, since: Instant::now(), is_settled: claim.is_some(), claim, withdrawn }
    }

    /// Its claim, when it has ended.
    pub fn into_claim(self) -> Option<Claim> {
        self.claim
    }

    /// Whether it took so long that others may be waiting for it.
    pub fn is_long(&self) -> bool {
        self.since.elapsed() > SHORT
    }
}

impl Scheduler<'_> {
    /// Whether a job about to start is done, or being done, by another run; then it is taken care of.
    pub(super) fn is_left_to_another(&mut self, job: usize) -> bool {
        let Some(key) = self.awaitable_key(job) else { return false };
        if self.is_for_others(job) {
            self.state_mut(job).phase = Phase::Elsewhere;
            self.elsewhere.push(job);
            return true;
        }
        // First the claim, then the record: a claim goes only when the record is there.
        if let Some(holder) = self.claims.holder(&key) {
            self.wait_for(job, &holder);
            return true;
        }
        match self.record_of_another(job, &key) {
            Some(record) => {
                self.settle_from_another(job, record);
                true
            }
            None => false,
        }
    }

    /// The key under which another run's result would serve; none for a job that is to run whatever the store has.
    pub(super) fn awaitable_key(&self, job: usize) -> Option<Digest> {
        let state = self.state(job);
        let may_wait = state.planned.reason.is_empty() && state.rerun_reason.is_empty();
        state.entry.key.filter(|_| may_wait)
    }

    pub(super) fn wait_for(&mut self, job: usize, holder: &Holder) {
        self.state_mut(job).phase = Phase::Elsewhere;
        self.elsewhere.push(job);
        self.listener.notify(&Event::Elsewhere { job: self.name(job), owner: holder.to_string() });
    }

    pub(super) fn record_of_another(&mut self, job: usize, key: &Digest) -> Option<ResultRecord> {
        let shared = self.shared.clone();
        if !shared.library.may_have_result(key) {
            return None;
        }
        shared.library.result(key).ok().filter(|record| is_whole(&shared.graph, &shared.graph.jobs[job], record))
    }

    pub(super) fn settle_from_another(&mut self, job: usize, record: ResultRecord) {
        let prepared = self.settle_one(job, record, Outcome::Hit, COMPUTED_ELSEWHERE.to_owned());
        for job in prepared {
            self.prepare(job);
        }
    }

    /// Looks whether what other runs compute is done, or was given up.
    pub(super) fn look_elsewhere(&mut self) {
        if self.elsewhere.is_empty() || Instant::now() < self.next_look_elsewhere {
            return;
        }
        let begun = Instant::now();
        for job in std::mem::take(&mut self.elsewhere) {
            let key = self.state(job).entry.key.expect("a job that was ready has its key");
            let is_held = self.claims.holder(&key).is_some() || self.is_for_others(job);
            match self.record_of_another(job, &key) {
                Some(record) => self.settle_from_another(job, record),
                None if is_held => self.elsewhere.push(job),
                None => self.make_ready_again(job),
            }
        }
        // On a file server a look takes its time, and there may be many.
        self.next_look_elsewhere = Instant::now() + LOOK.max(begun.elapsed() * SHARE);
    }

    fn make_ready_again(&mut self, job: usize) {
        if self.is_undivided(job) {
            return self.wait_for_inputs_again(job);
        }
        let state = self.state_mut(job);
        state.phase = Phase::Ready;
        let priority = state.priority;
        self.push_ready(job, priority);
    }

    /// Puts a job among those that can start.
    pub(super) fn push_ready(&mut self, job: usize, priority: f64) {
        let place = self.order.place(job);
        let is_near = self.is_near(job);
        self.ready.push(Ready { is_near, priority, place, job });
    }

    /// Says that this run is at work, and looks from time to time whether others are: then they divide the jobs.
    pub(super) fn look_around(&mut self) {
        if self.is_driver() || self.looked_around.is_some_and(|moment| moment.elapsed() < GLANCE_AROUND) {
            return;
        }
        // The first job makes the folder.
        self.presence = self.presence.take().or_else(|| self.claims.come_in());
        self.looked_around = Some(Instant::now());
        let are_others = matches!(self.role, Role::Worker(_)) || self.claims.are_others_at_work();
        self.committer.share(are_others);
        if are_others && self.order == Order::Graph {
            self.order = Order::Own(std::hash::RandomState::new().build_hasher().finish());
            for Ready { priority, job, .. } in std::mem::take(&mut self.ready) {
                self.push_ready(job, priority);
            }
        }
    }

    /// Claims the jobs that turn out to take a while, and keeps the claims alive.
    pub(super) fn tend_claims(&mut self) {
        if let Some(presence) = &mut self.presence {
            presence.keep_alive();
        }
        for index in 0..self.flights.len() {
            let flight = &mut self.flights[index];
            if let Some(claim) = &mut flight.claim {
                claim.keep_alive();
            } else if !flight.is_settled && flight.since.elapsed() > SHORT {
                flight.is_settled = true;
                self.claim(index);
            }
        }
    }

    fn claim(&mut self, index: usize) {
        let job = self.flights[index].job;
        let Some(key) = self.state(job).entry.key else { return };
        let claim = self.claims.take(&key);
        let is_late = claim.is_none() && self.awaitable_key(job).is_some() && self.claims.holder(&key).is_some();
        self.flights[index].claim = claim;
        if is_late {
            // Whoever claimed it began before us: what is lost is hardly more than `SHORT`.
            self.flights[index].withdrawn.store(true, Ordering::Relaxed);
        }
    }

    /// A job that was given up for another run's sake.
    pub(super) fn take_withdrawal(&mut self, job: usize) {
        let key = self.state(job).entry.key.expect("a job that ran has its key");
        match self.claims.holder(&key) {
            Some(holder) => self.wait_for(job, &holder),
            None => {
                self.state_mut(job).phase = Phase::Elsewhere;
                self.elsewhere.push(job);
            }
        }
    }
}

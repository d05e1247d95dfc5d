//! Jobs in parts: a job that `split:` divides and that has to be computed waits for its parts, which are jobs like others.
//!
//! Until then no one knows of them: what is in the store needs no parts. They are no inputs, and in no key; what holds for
//! inputs while the run lasts (when a job may begin, when values may go, what is lost) holds for them too.

use super::Scheduler;
use super::state::{self, JobState, Phase};
use crate::engine::digest::Digest;
use crate::engine::events::Failure;
use crate::engine::freshness::PlannedJob;
use crate::engine::graph::InputNode;
use crate::engine::key;
use crate::engine::manifest::{JobEntry, Outcome, PartEntry};

impl Scheduler<'_> {
    /// The jobs whose results a job takes, each once: those on its ports, and those of its parts that are computed.
    pub(super) fn inputs_of(&self, job: usize) -> Vec<usize> {
        let mut inputs = state::distinct_inputs(&self.shared.graph.jobs[job]);
        inputs.extend(self.parts_of(job));
        inputs
    }

    /// The parts that are computed for a job, in order.
    pub(super) fn parts_of(&self, job: usize) -> impl Iterator<Item = usize> {
        self.shared.graph.jobs[job].parts.iter().map(|part| part.job).filter(|part| self.jobs[*part].is_some())
    }

    /// The job of which this one is a part.
    pub(super) fn whole_of(&self, job: usize) -> Option<usize> {
        self.shared.graph.jobs[job].part_of.map(|part| part.whole)
    }

    /// Whether a job has parts of which none is computed yet.
    pub(super) fn is_undivided(&self, job: usize) -> bool {
        !self.shared.graph.jobs[job].parts.is_empty() && self.parts_of(job).next().is_none()
    }

    /// Has a job that is about to be ready wait for its parts; false if there are none to wait for.
    pub(super) fn waits_for_parts(&mut self, job: usize, key: Digest) -> bool {
        if !self.is_undivided(job) {
            return false;
        }
        // Another run of the same store may be putting them together already.
        if let Some(holder) = self.awaitable_key(job).and_then(|_| self.claims.holder(&key)) {
            self.wait_for(job, &holder);
            return true;
        }
        let parts = self.missing_parts(job);
        if parts.is_empty() {
            return false;
        }
        self.state_mut(job).waiting = parts.len();
        parts.iter().for_each(|part| self.add_part(job, *part));
        parts.into_iter().for_each(|part| self.prepare(part));
        true
    }

    /// The parts that hold more than the store has already, in a prefix of the job.
    fn missing_parts(&self, job: usize) -> Vec<usize> {
        let node = &self.shared.graph.jobs[job];
        let content = |item: &InputNode| self.state(item.job).content(item.result).expect("all inputs are settled");
        let is_held = |prefix: &serde_json::Value| {
            let files = &self.state(job).planned.files;
            let key = key::key_of_prefix(&self.shared.graph, node, prefix, files, content);
            self.shared.library.may_have_result(&key) && self.shared.library.result(&key).is_ok()
        };
        let best = if node.is_forced { None } else { node.prefixes.iter().position(is_held) };
        let is_missing = |within: usize| best.is_none_or(|best| within <= best);
        node.parts.iter().filter(|part| is_missing(part.within)).map(|part| part.job).collect()
    }

    /// From now on the part is a job of this run.
    fn add_part(&mut self, whole: usize, part: usize) {
        let shared = self.shared.clone();
        let state = self.state(whole);
        let files = state.planned.files.clone();
        let planned = PlannedJob {
            recipe: key::recipe(&shared.graph, &shared.graph.jobs[part], &files, |input| self.state(input).planned.recipe),
            files,
            key: None,
            record: None,
            outcome: Outcome::Run,
            reason: if shared.graph.jobs[whole].is_forced { state.planned.reason } else { "" },
        };
        let mut added = JobState::new(&shared.graph, &shared.graph.jobs[part], planned);
        (added.uses, added.priority) = (1, state.priority);
        self.jobs[part] = Some(added);
        self.dependents[part] = vec![whole];
        self.wanted_count += 1;
        for input in state::distinct_inputs(&shared.graph.jobs[part]) {
            self.state_mut(input).uses += 1;
        }
    }

    /// A part that gives no result is the whole's failure, which is told once.
    pub(super) fn fail_part(&mut self, part: usize, whole: usize, failure: Failure) {
        let state = self.state_mut(part);
        state.phase = Phase::Failed;
        state.entry.outcome = Outcome::Failed;
        let followers = std::mem::take(&mut state.followers);
        self.settled_count += 1;
        self.release_inputs(part);
        if !self.state(whole).has_failed() {
            self.fail(whole, failure.message, failure.hint, failure.is_of_the_system);
        }
        for follower in followers {
            self.wait_for_inputs(follower);
        }
    }

    /// The entries of the jobs, with those of their parts inside.
    pub(super) fn entries(&mut self) -> Vec<JobEntry> {
        let shared = self.shared.clone();
        for (job, node) in shared.graph.jobs.iter().enumerate().filter(|(_, node)| node.is_wanted) {
            let part = |(index, part): (usize, usize)| {
                let JobEntry { key, outcome, measured, .. } = self.jobs[part].take()?.entry;
                Some(PartEntry { number: index + 1, key, outcome, measured })
            };
            let parts = node.parts.iter().map(|part| part.job).enumerate().filter_map(part).collect();
            self.state_mut(job).entry.parts = parts;
        }
        let mut entries = Vec::with_capacity(self.jobs.len());
        entries.extend(self.jobs.drain(..).flatten().map(|state| state.entry));
        entries
    }
}

//! What the scheduler knows of each job.

use std::cmp::Ordering;
use std::path::Path;

use crate::engine::digest::Digest;
use crate::engine::freshness::PlannedJob;
use crate::engine::graph::{Graph, InputNode, JobNode};
use crate::engine::manifest::{JobEntry, Outcome, job_entry};
use crate::engine::stage::InputSizes;
use crate::engine::store::record::ResultRecord;

/// Where a job is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Phase {
    /// Inputs are not settled, or another job with the same key runs.
    Waiting,
    /// It can start.
    Ready,
    /// Another run has claimed it.
    Elsewhere,
    /// A job thread has it.
    Running,
    /// Its results are known.
    Settled,
    /// It will give no result in this run.
    Failed,
}

/// What the scheduler knows of a job.
pub struct JobState {
    /// What the plan said.
    pub planned: PlannedJob,
    /// What the manifest will say.
    pub entry: JobEntry,
    /// Where it is.
    pub phase: Phase,
    /// Inputs that are not settled, each job once.
    pub waiting: usize,
    /// Jobs and files that still want its values.
    pub uses: usize,
    /// Seconds from its start to the end of all that depends on it, as estimated.
    pub priority: f64,
    /// Its results.
    pub record: Option<ResultRecord>,
    /// Bytes that each result holds in memory, or in the store where that is not known.
    pub sizes: Vec<u64>,
    /// Bytes set apart while it runs.
    pub reserved: u64,
    /// Bytes set apart while its files are encoded.
    pub reserved_for_files: u64,
    /// Why it must run though its key is known to the store; else empty.
    pub rerun_reason: &'static str,
    /// How often its results were lost in this run.
    pub reruns: u32,
    /// Jobs with the same key, which wait for this one's results.
    pub followers: Vec<usize>,
    /// Its publications that are in place.
    pub published: Vec<usize>,
    /// When it started, in seconds since the run began, and on which job thread.
    pub span: Option<(f64, u32)>,
}

impl JobState {
    /// A job that nothing was done for.
    pub fn new(graph: &Graph, node: &JobNode, planned: PlannedJob) -> Self {
        let entry = job_entry(graph, node, &planned.files);
        Self {
            planned,
            entry,
            phase: Phase::Waiting,
            waiting: 0,
            uses: 0,
            priority: 0.0,
            record: None,
            sizes: Vec::new(),
            reserved: 0,
            reserved_for_files: 0,
            rerun_reason: "",
            reruns: 0,
            followers: Vec::new(),
            published: Vec::new(),
            span: None,
        }
    }

    /// Whether the plan found its results.
    pub fn is_hit(&self) -> bool {
        self.planned.outcome == Outcome::Hit
    }

    /// Whether its results are known.
    pub fn is_settled(&self) -> bool {
        self.phase == Phase::Settled
    }

    /// Whether it will give no result in this run.
    pub fn has_failed(&self) -> bool {
        self.phase == Phase::Failed
    }

    /// Digest of a result, if it is known.
    pub fn content(&self, result: usize) -> Option<Digest> {
        let record = self.record.as_ref().filter(|_| self.is_settled())?;
        Some(record.outputs[result].content.digest)
    }
}

/// A job that can start; the one on the longest path first, then by the order of this run.
#[derive(Debug, Clone, Copy)]
pub struct Ready {
    /// Whether it goes on with what a worker has in memory.
    pub is_near: bool,
    /// See [`JobState::priority`].
    pub priority: f64,
    /// See [`Order::place`].
    pub place: u64,
    /// Index of the job.
    pub job: usize,
}

/// In which order a run takes jobs that matter equally.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Order {
    /// As they stand in the graph.
    Graph,
    /// In an order of its own, so that runs at work at the same time do not all begin with the same job.
    Own(u64),
}

impl Order {
    /// The place of a job in that order.
    pub fn place(self, job: usize) -> u64 {
        match self {
            Order::Graph => job as u64,
            // The finalizer of splitmix64: every job gets another place.
            Order::Own(number) => {
                let mixed = (job as u64 ^ number).wrapping_add(0x9e37_79b9_7f4a_7c15);
                let mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
                let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
                mixed ^ (mixed >> 31)
            }
        }
    }
}

impl Ord for Ready {
    fn cmp(&self, other: &Self) -> Ordering {
        self.is_near.cmp(&other.is_near).then(self.priority.total_cmp(&other.priority)).then(other.place.cmp(&self.place))
    }
}

impl PartialOrd for Ready {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Ready {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Ready {}

/// The jobs whose results a job takes, each once.
pub fn distinct_inputs(node: &JobNode) -> Vec<usize> {
    let mut inputs: Vec<usize> = node.inputs.iter().flat_map(|port| &port.items).map(|item| item.job).collect();
    inputs.sort_unstable();
    inputs.dedup();
    inputs
}

/// The wanted jobs that take a result of each job, each once.
pub fn dependents(graph: &Graph) -> Vec<Vec<usize>> {
    let mut dependents = vec![Vec::new(); graph.jobs.len()];
    for (job, node) in graph.jobs.iter().enumerate().filter(|(_, node)| node.is_wanted) {
        for input in distinct_inputs(node) {
            dependents[input].push(job);
        }
    }
    dependents
}

/// For each job the cost of the dearest chain that begins with it; inputs stand before their users.
pub fn critical_paths(costs: &[f64], dependents: &[Vec<usize>]) -> Vec<f64> {
    let mut paths = costs.to_vec();
    for job in (0..costs.len()).rev() {
        let longest = dependents[job].iter().map(|dependent| paths[*dependent]).fold(0.0, f64::max);
        paths[job] += longest;
    }
    paths
}

/// Bytes that a job takes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MemoryNeed {
    /// What its kind states: beside the inputs.
    pub of_the_stage: u64,
    /// With the inputs that are not in memory yet.
    pub beside_what_is_held: u64,
    /// With all inputs: what must fit for it to run at all.
    pub at_all: u64,
}

impl MemoryNeed {
    /// The same with so much more.
    pub fn and(self, more: u64) -> Self {
        let Self { of_the_stage, beside_what_is_held, at_all } = self;
        Self { of_the_stage, beside_what_is_held: beside_what_is_held.saturating_add(more), at_all: at_all.saturating_add(more) }
    }

    /// The same where the stage says that it takes so much.
    pub fn at_least(self, stated: u64) -> Self {
        let more = stated.saturating_sub(self.of_the_stage);
        let Self { of_the_stage, beside_what_is_held, at_all } = self;
        Self {
            of_the_stage: of_the_stage + more,
            beside_what_is_held: beside_what_is_held.saturating_add(more),
            at_all: at_all.saturating_add(more),
        }
    }
}

/// What a job takes, given the size of an input and whether it is in memory, and the size of an input file.
///
/// Of a collecting port one artifact at a time is in memory, since the stage fetches one after the other. A file is
/// read whole.
pub fn memory_need(
    node: &JobNode,
    size: impl Fn(&InputNode) -> u64,
    is_held: impl Fn(&InputNode) -> bool,
    file_size: impl Fn(&Path) -> u64,
) -> MemoryNeed {
    let mut sizes = InputSizes::new();
    let (mut all, mut missing) = (0u64, 0u64);
    for port in &node.inputs {
        let total: u64 = port.items.iter().map(&size).sum();
        *sizes.entry(port.port.clone()).or_default() += total;
        let missing_sizes = port.items.iter().filter(|item| !is_held(item)).map(&size);
        if port.collects {
            all += port.items.iter().map(&size).max().unwrap_or(0);
            missing += missing_sizes.max().unwrap_or(0);
        } else {
            all += total;
            missing += missing_sizes.sum::<u64>();
        }
    }
    for (name, path) in &node.files {
        let size = file_size(path);
        sizes.insert(name.clone(), size);
        all = all.saturating_add(size);
        missing = missing.saturating_add(size);
    }
    let of_the_stage = node.parameters.memory(&sizes);
    MemoryNeed { of_the_stage, beside_what_is_held: of_the_stage.saturating_add(missing), at_all: of_the_stage.saturating_add(all) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_at_the_same_time_take_jobs_in_orders_of_their_own() {
        let order = |number: u64| {
            let mut jobs: Vec<usize> = (0..50).collect();
            jobs.sort_by_key(|job| Order::Own(number).place(*job));
            jobs
        };
        assert_ne!(order(1), order(2));
        let mut all = order(1);
        all.sort_unstable();
        assert_eq!(all, (0..50).collect::<Vec<_>>());
    }

    #[test]
    fn the_dearest_chain_starts_first() {
        // 0 -> 1 -> 3 (1 + 5 + 1), 0 -> 2 -> 3 (1 + 1 + 1)
        let paths = critical_paths(&[1.0, 5.0, 1.0, 1.0], &[vec![1, 2], vec![3], vec![3], vec![]]);
        assert_eq!(paths, [7.0, 6.0, 2.0, 1.0]);
        let mut ready = std::collections::BinaryHeap::new();
        let entry = |priority: f64, job: usize| Ready { is_near: false, priority, place: Order::Graph.place(job), job };
        ready.extend([entry(2.0, 2), entry(6.0, 1), entry(6.0, 0)]);
        let order: Vec<usize> = std::iter::from_fn(|| ready.pop()).map(|ready: Ready| ready.job).collect();
        assert_eq!(order, [0, 1, 2]);
    }
}

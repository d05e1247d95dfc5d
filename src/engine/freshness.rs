//! Looks at the world: hashes inputs, asks the store, and says of each job what is to be expected and why.
//!
//! Reads no result and changes nothing.

use std::collections::HashMap;
use std::io;
use std::path::PathBuf;

use super::digest::Digest;
use super::graph::{Graph, InputNode, JobNode};
use super::history::History;
use super::key;
use super::manifest::{InputEntry, JobEntry, Outcome, OutputEntry, input_items, job_entry};
use super::signature::Signatures;
use super::store::index::Index;
use super::store::library::{Library, Lost};
use super::store::objects::Shelf;
use super::store::record::ResultRecord;

/// What is known of a job before anything runs.
#[derive(Debug)]
pub struct PlannedJob {
    /// See [`key::recipe`].
    pub recipe: Digest,
    /// Digests of its files, in the order of [`JobNode::files`].
    pub files: Vec<Digest>,
    /// Its key, once the content of all inputs is known.
    pub key: Option<Digest>,
    /// Its results, if the store has them.
    pub record: Option<ResultRecord>,
    /// Hit, run or maybe.
    pub outcome: Outcome,
    /// Why it runs, where the store itself gave the reason (`damaged`, `forced`); else empty.
    pub reason: &'static str,
}

/// What is to be expected of each job.
#[derive(Debug)]
pub struct Plan {
    /// By index of the graph's jobs; `None` where this run does not want the job.
    pub jobs: Vec<Option<PlannedJob>>,
}

/// An input file that cannot be read.
#[derive(Debug, thiserror::Error)]
#[error("{place}: stage `{stage}`: cannot read `{}`: {source}", path.display())]
pub struct InputError {
    /// `file:line` of the stage.
    pub place: String,
    /// The stage that names it.
    pub stage: String,
    /// The file.
    pub path: PathBuf,
    /// What the system said.
    pub source: io::Error,
}

/// Plans every wanted job.
pub fn plan(graph: &Graph, library: &Library, index: &Index, signatures: &mut Signatures) -> Result<Plan, Vec<InputError>> {
    let files = input_digests(graph, signatures)?;
    let has_results = library.has_results();
    let mut plan = Plan { jobs: graph.jobs.iter().map(|_| None).collect() };
    for wave in waves(graph) {
        let asked: Vec<Asked> = wave.into_iter().map(|job| asked(graph, job, &files, &plan.jobs, index)).collect();
        if has_results {
            library.fetch(Shelf::Results, asked.iter().filter_map(Asked::wanted_key));
        }
        for asked in asked {
            let lookup = |key: &Digest| if has_results { library.result(key) } else { Err(Lost::Missing) };
            let job = asked.job;
            plan.jobs[job] = Some(answered(graph, asked, lookup));
        }
    }
    if !has_results {
        plan.jobs.iter_mut().flatten().filter(|job| job.outcome == Outcome::Maybe).for_each(|job| job.outcome = Outcome::Run);
    }
    Ok(plan)
}

/// Wanted jobs, those together whose inputs all stand in earlier waves: what the store has of a wave can be asked at once.
fn waves(graph: &Graph) -> Vec<Vec<usize>> {
    let mut depths = vec![0; graph.jobs.len()];
    let mut waves: Vec<Vec<usize>> = Vec::new();
    for (index, job) in graph.jobs.iter().enumerate().filter(|(_, job)| job.is_wanted) {
        let depth = input_items(job).map(|(_, item)| depths[item.job] + 1).max().unwrap_or(0);
        depths[index] = depth;
        waves.resize_with(waves.len().max(depth + 1), Vec::new);
        waves[depth].push(index);
    }
    waves
}

/// A job with its key, if that can be known, before the store is asked.
struct Asked {
    job: usize,
    /// What is to be expected if the store has nothing.
    planned: PlannedJob,
}

impl Asked {
    /// The key to ask the store for; none where the answer is known.
    fn wanted_key(&self) -> Option<Digest> {
        self.planned.key.filter(|_| self.planned.outcome != Outcome::Hit && self.planned.reason.is_empty())
    }
}

fn asked(graph: &Graph, index_of_job: usize, files: &HashMap<PathBuf, Digest>, earlier: &[Option<PlannedJob>], index: &Index) -> Asked {
    let job = &graph.jobs[index_of_job];
    let files: Vec<Digest> = job.files.iter().map(|(_, path)| files[path]).collect();
    let planned = |input: usize| earlier[input].as_ref().expect("the inputs of a wanted job are wanted");
    let recipe = key::recipe(graph, job, &files, |input| planned(input).recipe);
    // The index may know the results of a job while an input's record is gone.
    if let Some(record) = index.result(&recipe).filter(|record| !job.is_forced && is_whole(graph, job, record)) {
        let (key, record) = (Some(record.key), Some(record.clone()));
        return Asked { job: index_of_job, planned: PlannedJob { recipe, files, key, record, outcome: Outcome::Hit, reason: "" } };
    }
    let content = |item: &InputNode| planned(item.job).record.as_ref().map(|record| record.outputs[item.result].content.digest);
    let is_known = input_items(job).all(|(_, item)| content(item).is_some());
    let key = is_known.then(|| key::key(graph, job, &files, |item| content(item).expect("all were looked at above")));
    let reason = if job.is_forced { "forced" } else { "" };
    let outcome = if job.is_forced || key.is_some() { Outcome::Run } else { Outcome::Maybe };
    Asked { job: index_of_job, planned: PlannedJob { recipe, files, key, record: None, outcome, reason } }
}

/// The same with the store's answer.
fn answered(graph: &Graph, asked: Asked, lookup: impl FnOnce(&Digest) -> Result<ResultRecord, Lost>) -> PlannedJob {
    let Some(key) = asked.wanted_key() else { return asked.planned };
    let unknown = asked.planned;
    match lookup(&key) {
        Ok(record) if is_whole(graph, &graph.jobs[asked.job], &record) => {
            PlannedJob { record: Some(record), outcome: Outcome::Hit, ..unknown }
        }
        Ok(_) | Err(Lost::Missing) => unknown,
        Err(lost @ Lost::Damaged(_)) => PlannedJob { reason: lost.reason(), ..unknown },
    }
}

/// Whether a record has the results that the kind declares; another program may have written it.
pub fn is_whole(graph: &Graph, job: &JobNode, record: &ResultRecord) -> bool {
    let declared = graph.stages[job.stage].results.iter().map(|(name, type_name)| (*name, *type_name));
    declared.eq(record.outputs.iter().map(|output| (output.name.as_str(), output.type_name.as_str())))
}

/// Digest of each input file that a wanted job reads; each file is looked at once.
fn input_digests(graph: &Graph, signatures: &mut Signatures) -> Result<HashMap<PathBuf, Digest>, Vec<InputError>> {
    let mut digests = HashMap::new();
    let mut errors = Vec::new();
    for job in graph.jobs.iter().filter(|job| job.is_wanted) {
        for (_, path) in &job.files {
            if digests.contains_key(path) {
                continue;
            }
            let content = signatures.content_of_input(path);
            match content {
                Ok(content) => drop(digests.insert(path.clone(), content.digest)),
                Err(source) => {
                    // Reported once, and not looked for again.
                    digests.insert(path.clone(), Digest::of(b""));
                    errors.push(input_error(graph, job, path.clone(), source));
                }
            }
        }
    }
    if errors.is_empty() { Ok(digests) } else { Err(errors) }
}

fn input_error(graph: &Graph, job: &JobNode, path: PathBuf, source: io::Error) -> InputError {
    let stage = &graph.stages[job.stage];
    InputError { place: format!("{}:{}", stage.place.0, stage.place.1), stage: stage.name.clone(), path, source }
}

/// The plan as entries of a manifest, with reasons.
pub fn entries(graph: &Graph, plan: &Plan, history: &mut History) -> Vec<JobEntry> {
    let known = |item: &InputNode| {
        let record = plan.jobs[item.job].as_ref()?.record.as_ref()?;
        Some(record.outputs[item.result].content.digest)
    };
    let planned = graph.jobs.iter().zip(&plan.jobs).filter_map(|(job, planned)| Some((job, planned.as_ref()?)));
    planned
        .map(|(job, planned)| {
            let mut entry = job_entry(graph, job, &planned.files);
            fill_inputs(&mut entry.inputs, job, known);
            entry.key = planned.key;
            entry.outcome = planned.outcome;
            entry.outputs = planned.record.as_ref().map(output_entries).unwrap_or_default();
            let why = reason(&entry, planned, history, || unknown_inputs(job, known));
            entry.reason = if planned.outcome == Outcome::Hit { why } else { in_parts(job, why) };
            entry
        })
        .collect()
}

fn reason(entry: &JobEntry, planned: &PlannedJob, history: &mut History, unknown: impl Fn() -> String) -> String {
    if !planned.reason.is_empty() {
        return planned.reason.to_owned();
    }
    match planned.outcome {
        Outcome::Hit => HIT_REASON.to_owned(),
        _ if planned.key.is_some() => history.reason(entry),
        _ => history.known_difference(entry).unwrap_or_else(unknown),
    }
}

/// The same reason, with the number of parts in which a job is computed.
pub fn in_parts(job: &JobNode, reason: String) -> String {
    match job.parts.len() {
        0 => reason,
        count => format!("{reason}; in {count} parts"),
    }
}

/// What is said of a job whose result is in the store.
pub const HIT_REASON: &str = "in the store";

/// `waits for a, b`: the inputs whose content is not known yet.
fn unknown_inputs(job: &JobNode, known: impl Fn(&InputNode) -> Option<Digest>) -> String {
    let mut labels: Vec<&str> = input_items(job).filter(|(_, item)| known(item).is_none()).map(|(_, item)| item.label.as_str()).collect();
    labels.dedup();
    format!("waits for {}", labels.join(", "))
}

/// Writes the digests that are known into the entries of inputs.
pub fn fill_inputs(entries: &mut [InputEntry], job: &JobNode, known: impl Fn(&InputNode) -> Option<Digest>) {
    for (entry, (_, item)) in entries.iter_mut().zip(input_items(job)) {
        entry.sha256 = known(item);
    }
}

/// The results of a record as entries of a manifest.
pub fn output_entries(record: &ResultRecord) -> Vec<OutputEntry> {
    let entry = |output: &super::store::record::OutputRecord| OutputEntry {
        name: output.name.clone(),
        type_name: output.type_name.clone(),
        sha256: output.content.digest,
        bytes: output.content.size,
    };
    record.outputs.iter().map(entry).collect()
}

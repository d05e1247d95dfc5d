//! What a stage asks of the machine that runs it: `resources: { threads: 4, memory: 8GiB, time: 2h }`.
//!
//! In no key: the same job gives the same bytes wherever it runs. Here, a job counts as so many threads and takes at least
//! so much memory; where workers are asked for, jobs that ask for the same make a class with workers of its own.

use std::fmt;
use std::num::NonZeroUsize;
use std::time::Duration;

use serde::{Deserialize, Serialize};

use super::diagnostic::quoted;
use super::graph::Graph;
use super::quantity;
use super::source::{Finding, Findings, did_you_mean};
use super::yaml::{Entry, Node, Value};
use crate::catalogue::nearest;

/// What a job asks for; nothing where nothing is said.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct Resources {
    /// Threads that it makes use of.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub threads: Option<NonZeroUsize>,
    /// Memory, in bytes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub memory: Option<u64>,
    /// Longest time, in whole seconds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub seconds: Option<u64>,
}

impl fmt::Display for Resources {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let threads = self.threads.map(|threads| format!("{threads} threads"));
        let memory = self.memory.map(super::schedule::bytes_text);
        let time = self.seconds.map(|seconds| format!("{seconds} s"));
        let parts: Vec<String> = [threads, memory, time].into_iter().flatten().collect();
        out.write_str(&if parts.is_empty() { "nothing special".to_owned() } else { parts.join(", ") })
    }
}

impl Resources {
    /// Whether a worker that was given this may run a job that asks for that.
    pub fn suffice_for(&self, asked: &Resources) -> bool {
        let is_enough = |given: Option<u64>, asked: Option<u64>| asked.is_none_or(|asked| given.is_some_and(|given| given >= asked));
        let threads = |resources: &Resources| resources.threads.map(|threads| threads.get() as u64);
        is_enough(threads(self), threads(asked)) && is_enough(self.memory, asked.memory) && is_enough(self.seconds, asked.seconds)
    }
}

/// The different demands of a graph's wanted jobs, in an order that is the same in every process.
pub fn classes(graph: &Graph) -> Vec<Resources> {
    let mut classes: Vec<Resources> = graph.jobs.iter().filter(|job| job.is_wanted).map(|job| graph.stages[job.stage].resources).collect();
    classes.sort_unstable();
    classes.dedup();
    classes
}

const KEYS: [&str; 3] = ["threads", "memory", "time"];

/// Most threads that can be asked for.
const THREAD_LIMIT: i128 = 4096;

/// Reads the value of `resources:`.
pub fn read(node: &Node, stage: &str, findings: &mut Findings) -> Resources {
    let mut resources = Resources::default();
    let Some(entries) = node.map() else {
        let message = format!("`resources` must be a map, found {}", node.described());
        let hint = Some("write for example `resources: { threads: 4, memory: 8GiB, time: 2h }`".to_owned());
        findings.add(Finding::error(node.place, message).in_stage(stage).with_hint(hint));
        return resources;
    };
    for entry in entries.iter() {
        if let Err((message, hint)) = take(entry, &mut resources) {
            let place = if KEYS.contains(&&*entry.key) { entry.node.place } else { entry.place };
            findings.add(Finding::error(place, message).in_stage(stage).with_hint(hint));
        }
    }
    resources
}

fn take(entry: &Entry, resources: &mut Resources) -> Result<(), (String, Option<String>)> {
    let node = &entry.node;
    let wrong = |what: &str| (format!("`{}` must be {what}, found {}", entry.key, node.described()), None);
    match &*entry.key {
        "threads" => {
            let count = match &node.value {
                Value::Integer(count) if (1..=THREAD_LIMIT).contains(count) => NonZeroUsize::new(*count as usize),
                _ => None,
            };
            resources.threads = Some(count.ok_or_else(|| wrong(&format!("a number of threads from 1 to {THREAD_LIMIT}")))?);
        }
        "memory" => {
            let bytes = node.text().and_then(|text| quantity::byte_size(text).ok()).filter(|bytes| *bytes >= 1 << 20);
            resources.memory = Some(bytes.ok_or_else(|| wrong("a size of at least 1MiB, as 512MiB or 8GiB"))?);
        }
        "time" => {
            let time = node.text().and_then(|text| quantity::duration(text).ok()).filter(|time| *time >= Duration::from_secs(60));
            resources.seconds = Some(time.ok_or_else(|| wrong("a time of at least a minute, as 90m, 12h or 2d"))?.as_secs());
        }
        key => {
            let hint = did_you_mean(nearest(key, KEYS)).unwrap_or_else(|| "the keys are `threads`, `memory` and `time`".to_owned());
            return Err((format!("unknown key {} of `resources`", quoted(key)), Some(hint)));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn asks(threads: usize, memory: u64) -> Resources {
        Resources { threads: NonZeroUsize::new(threads), memory: Some(memory).filter(|memory| *memory > 0), seconds: None }
    }

    #[test]
    fn a_worker_runs_what_asks_for_no_more_than_it_has() {
        assert!(asks(4, 100).suffice_for(&asks(4, 100)) && asks(4, 100).suffice_for(&asks(1, 0)));
        assert!(asks(4, 100).suffice_for(&Resources::default()));
        assert!(!asks(4, 100).suffice_for(&asks(5, 0)) && !asks(4, 0).suffice_for(&asks(4, 1)));
        assert!(!Resources::default().suffice_for(&asks(1, 0)), "who was given nothing special has no say");
    }
}

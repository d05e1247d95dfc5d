//! What differs between two runs: the command line, parameters, results, published files.
//!
//! Pure: reads two manifests and nothing else. Changes are told in the words of a plan.

use std::collections::BTreeMap;

use serde::Serialize;

use crate::engine::digest::Digest;
use crate::engine::history::changes;
use crate::engine::manifest::{JobEntry, Manifest, place_text, plain_text};

/// What differs between two runs.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Comparison {
    /// Seed, overrides, program: `seed 7 -> 8`.
    pub settings: Vec<String>,
    /// Jobs that both runs have, and that differ in what they were asked or in what they gave.
    pub jobs: Vec<JobDifference>,
    /// Jobs of the first run alone.
    pub only_first: Vec<String>,
    /// Jobs of the second run alone.
    pub only_second: Vec<String>,
    /// Published files that differ.
    pub files: Vec<FileDifference>,
    /// Jobs that both runs have.
    pub common_jobs: usize,
    /// Files that one of the runs published.
    pub file_count: usize,
}

/// A job that differs.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct JobDifference {
    /// Name of the stage.
    pub stage: String,
    /// Value on each axis.
    pub coordinate: serde_json::Value,
    /// What was asked differently: `parameter gamma 1.8 -> 2.2`, `input env changed`.
    pub changes: Vec<String>,
    /// Results whose bytes differ.
    pub results: Vec<ResultDifference>,
    /// Index of the job in the first manifest.
    #[serde(skip)]
    pub first: usize,
    /// Index of the job in the second manifest.
    #[serde(skip)]
    pub second: usize,
}

/// A result whose bytes differ.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ResultDifference {
    /// Empty for the first result.
    pub name: String,
    /// Type of the artifact in the first run; empty where it gave none.
    #[serde(rename = "type")]
    pub type_name: String,
    /// Digest in the first run; null where it gave none.
    pub first: Option<Digest>,
    /// Digest in the second run; null where it gave none.
    pub second: Option<Digest>,
}

/// A published file that differs.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FileDifference {
    /// Path below the pipeline's folder of outputs.
    pub path: String,
    /// Digest in the first run; null where it published none.
    pub first: Option<Digest>,
    /// Digest in the second run; null where it published none.
    pub second: Option<Digest>,
}

impl Comparison {
    /// Whether both runs gave the same results and files.
    pub fn is_equal(&self) -> bool {
        self.jobs.iter().all(|job| job.results.is_empty())
            && self.only_first.is_empty()
            && self.only_second.is_empty()
            && self.files.is_empty()
    }

    /// Results of common jobs whose bytes differ.
    pub fn result_count(&self) -> usize {
        self.jobs.iter().map(|job| job.results.len()).sum()
    }
}

/// Compares two runs; jobs are paired by stage and coordinate, files by path.
pub fn compare(first: &Manifest, second: &Manifest) -> Comparison {
    let places = |manifest: &Manifest| -> BTreeMap<String, usize> {
        manifest.jobs.iter().enumerate().map(|(index, job)| (place(job), index)).collect()
    };
    let (firsts, seconds) = (places(first), places(second));
    let lacks = |jobs: &[JobEntry], others: &BTreeMap<String, usize>| {
        jobs.iter().map(place).filter(|place| !others.contains_key(place)).collect::<Vec<_>>()
    };
    let pairs: Vec<(usize, usize)> =
        second.jobs.iter().enumerate().filter_map(|(index, job)| Some((*firsts.get(&place(job))?, index))).collect();
    let differing = |(a, b): &(usize, usize)| {
        let (one, other) = (&first.jobs[*a], &second.jobs[*b]);
        let (changes, results) = (changes(one, other), result_differences(one, other));
        let is_equal = changes.is_empty() && results.is_empty();
        let (stage, coordinate) = (other.stage.clone(), other.coordinate.clone());
        (!is_equal).then_some(JobDifference { stage, coordinate, changes, results, first: *a, second: *b })
    };
    let (files, file_count) = file_differences(first, second);
    Comparison {
        settings: setting_changes(first, second),
        jobs: pairs.iter().filter_map(differing).collect(),
        only_first: lacks(&first.jobs, &seconds),
        only_second: lacks(&second.jobs, &firsts),
        files,
        common_jobs: pairs.len(),
        file_count,
    }
}

fn place(job: &JobEntry) -> String {
    place_text(&job.stage, &job.coordinate)
}

fn setting_changes(first: &Manifest, second: &Manifest) -> Vec<String> {
    let mut changes = Vec::new();
    let mut add = |name: &str, old: String, new: String| {
        if old != new {
            changes.push(format!("{name} {old} -> {new}"));
        }
    };
    add("pipeline", first.pipeline.clone(), second.pipeline.clone());
    add("seed", first.seed.to_string(), second.seed.to_string());
    add("program", first.program.version.clone(), second.program.version.clone());
    let flags = [("params", "-s"), ("axes", "-a")];
    for (group, flag) in flags {
        let texts = |manifest: &Manifest| manifest.overrides.get(group).and_then(|group| group.as_object().cloned()).unwrap_or_default();
        let (olds, news) = (texts(first), texts(second));
        let names: std::collections::BTreeSet<&String> = olds.keys().chain(news.keys()).collect();
        let text = |value: Option<&serde_json::Value>| value.map_or_else(|| "as in the file".to_owned(), plain_text);
        for name in names {
            add(&format!("{flag} {name}"), text(olds.get(name)), text(news.get(name)));
        }
    }
    changes
}

/// Results of either job that differ in their bytes, or that one of them lacks.
pub fn result_differences(first: &JobEntry, second: &JobEntry) -> Vec<ResultDifference> {
    let names =
        first.outputs.iter().chain(second.outputs.iter().filter(|output| first.outputs.iter().all(|other| other.name != output.name)));
    let find = |job: &JobEntry, name: &str| job.outputs.iter().find(|output| output.name == name).map(|output| output.sha256);
    let difference = |output: &crate::engine::manifest::OutputEntry| ResultDifference {
        name: output.name.clone(),
        type_name: output.type_name.clone(),
        first: find(first, &output.name),
        second: find(second, &output.name),
    };
    names.map(difference).filter(|difference| difference.first != difference.second).collect()
}

/// Files that differ, and how many there are in all.
pub fn file_differences(first: &Manifest, second: &Manifest) -> (Vec<FileDifference>, usize) {
    let mut files: BTreeMap<&str, FileDifference> = BTreeMap::new();
    let blank = |path: &str| FileDifference { path: path.to_owned(), first: None, second: None };
    for entry in &first.published {
        files.entry(&entry.path).or_insert_with(|| blank(&entry.path)).first = Some(entry.sha256);
    }
    for entry in &second.published {
        files.entry(&entry.path).or_insert_with(|| blank(&entry.path)).second = Some(entry.sha256);
    }
    let count = files.len();
    (files.into_values().filter(|file| file.first != file.second).collect(), count)
}

//! The runs below a folder of outputs: what they named, and whose folders need not be kept.
//!
//! Reads manifests only as far as collection asks; a manifest that cannot be read names nothing.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use serde::Deserialize;

use super::collection::Policy;
use super::inventory::{Entry, entries_of};
use crate::engine::digest::Digest;

/// So many of a pipeline's latest runs are looked at for what was used when.
const RUNS_LOOKED_AT: usize = 16;

/// Bytes of the time in a run's name: `20261122T064038Z`.
const TIME_LENGTH: usize = 16;

/// What a run used.
pub struct Run {
    /// When it ended.
    pub when: SystemTime,
    /// Whether it is among the last ones, whose results stay.
    pub is_kept: bool,
    /// Keys of its jobs.
    pub keys: BTreeSet<Digest>,
    /// Digests of the files that it published.
    pub files: BTreeSet<Digest>,
}

/// What is read of a manifest; a short one has no jobs, but names the run that has them.
#[derive(Deserialize)]
struct ManifestPart {
    #[serde(default)]
    run_id: String,
    #[serde(default)]
    jobs: Vec<JobPart>,
    #[serde(default)]
    published: Vec<FilePart>,
    #[serde(default)]
    results_of: Option<String>,
}

#[derive(Deserialize)]
struct JobPart {
    key: Option<Digest>,
}

#[derive(Deserialize)]
struct FilePart {
    sha256: Digest,
}

/// The latest runs of every pipeline below the folder of outputs.
pub fn runs(outputs: &Path, policy: &Policy, now: SystemTime) -> Vec<Run> {
    let mut runs = Vec::new();
    for pipeline in entries_of(outputs).unwrap_or_default() {
        for (index, entry) in folders(&pipeline.path).iter().enumerate() {
            let is_kept = index < policy.keep_last.unwrap_or(0);
            let age = now.duration_since(entry.modified).unwrap_or_default();
            let is_of_interest = is_kept || index < RUNS_LOOKED_AT || policy.older_than.is_some_and(|limit| age < limit);
            if is_of_interest && let Some(run) = run(entry, is_kept) {
                runs.push(run);
            }
        }
    }
    runs
}

/// The folders of the runs of a pipeline; the latest come first.
fn folders(pipeline: &Path) -> Vec<Entry> {
    let mut folders = entries_of(&pipeline.join("runs")).unwrap_or_default();
    folders.retain(|entry| !entry.is_plain && is_run_id(&entry.name));
    // A run's name begins with its time, in seconds.
    folders.sort_by_key(|entry| std::cmp::Reverse((entry.name.get(..TIME_LENGTH).map(str::to_owned), entry.modified)));
    folders
}

fn run(entry: &Entry, is_kept: bool) -> Option<Run> {
    let manifest = manifest_in(&entry.path)?;
    let manifest = match &manifest.results_of {
        Some(earlier) if !earlier.contains('/') => manifest_in(&entry.path.with_file_name(earlier))?,
        _ => manifest,
    };
    Some(Run {
        when: entry.modified,
        is_kept,
        keys: manifest.jobs.iter().filter_map(|job| job.key).collect(),
        files: manifest.published.iter().map(|file| file.sha256).collect(),
    })
}

fn manifest_in(folder: &Path) -> Option<ManifestPart> {
    serde_json::from_slice(&fs::read(folder.join("manifest.json")).ok()?).ok()
}

/// The folders of runs that the policy lets go: never that of the run whose results stand, nor one that a kept run names.
pub fn surplus_folders(outputs: &Path, policy: &Policy, now: SystemTime) -> Vec<PathBuf> {
    let Some(count) = policy.keep_last.filter(|_| policy.max_bytes.is_none() || policy.older_than.is_some()) else { return Vec::new() };
    let age = policy.older_than.unwrap_or_default().max(policy.grace);
    let is_old = |entry: &Entry| now.duration_since(entry.modified).is_ok_and(|elapsed| elapsed >= age);
    let mut surplus = Vec::new();
    for pipeline in entries_of(outputs).unwrap_or_default() {
        // Where no run stands this may be no pipeline's folder, or a run may be about to end.
        let Some(standing) = manifest_in(&pipeline.path) else { continue };
        let folders = folders(&pipeline.path);
        let (kept, others) = folders.split_at(count.min(folders.len()));
        let mut named: BTreeSet<String> = kept.iter().filter_map(|entry| manifest_in(&entry.path)?.results_of).collect();
        named.insert(standing.run_id);
        surplus.extend(others.iter().filter(|entry| is_old(entry) && !named.contains(&entry.name)).map(|entry| entry.path.clone()));
    }
    surplus
}

/// Whether a folder has a name that a run gives: nothing else is removed.
fn is_run_id(name: &str) -> bool {
    let Some((time, number)) = name.split_once('-') else { return false };
    time.len() == TIME_LENGTH && time.starts_with(|first: char| first.is_ascii_digit()) && time.ends_with('Z') && number.len() == 6
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;
    use crate::engine::trial::{Space, files_below, job};

    const HOUR: Duration = Duration::from_secs(3600);

    fn surplus(space: &Space, policy: Policy, later: Duration) -> Vec<String> {
        let mut names: Vec<String> = surplus_folders(&space.path("outputs"), &policy, SystemTime::now() + later)
            .iter()
            .map(|path| path.file_name().unwrap().to_str().unwrap().to_owned())
            .collect();
        names.sort();
        names
    }

    #[test]
    fn folders_of_runs_that_are_not_kept_go_but_never_that_of_the_standing_run() {
        let policy = Policy { older_than: None, max_bytes: None, keep_last: Some(1), grace: HOUR, is_trial: false };
        let space = Space::new();
        // Names of one second are in no order: folders are told apart by what they hold.
        let first = space.run(&[job("a", "one").saves()]).run_id;
        let second = space.run(&[job("a", "two").saves()]).run_id;
        let short: Vec<String> = (0..3).map(|_| space.run(&[job("a", "two").saves()]).run_id).collect();
        fs::create_dir_all(space.path("outputs/p/runs/my-notes")).unwrap();
        assert!(surplus(&space, policy, Duration::ZERO).is_empty(), "all are young");
        let gone = surplus(&space, policy, 2 * HOUR);
        assert!(gone.contains(&first) && !gone.contains(&second) && !gone.contains(&"my-notes".to_owned()), "{gone:?}");
        assert_eq!(gone.len(), 3, "the first and two of {short:?}");

        let old = Policy { older_than: Some(24 * HOUR), ..policy };
        assert!(surplus(&space, old, 2 * HOUR).is_empty() && surplus(&space, old, 25 * HOUR).len() == 3);
        assert!(surplus(&space, Policy { max_bytes: Some(0), ..policy }, 2 * HOUR).is_empty(), "a limit of the store says nothing of runs");
        assert!(surplus(&space, Policy { keep_last: None, ..old }, 25 * HOUR).is_empty());

        let removed = space.path(&format!("outputs/p/runs/{first}"));
        assert!(files_below(&removed).iter().any(|path| path.ends_with("spec/p.yaml")), "its text is there, and goes with it");
        fs::remove_file(space.path("outputs/p/manifest.json")).unwrap();
        assert!(surplus(&space, policy, 2 * HOUR).is_empty(), "no run stands");
    }
}

//! Why a job runs: what differs from what earlier runs of the pipeline say of it.
//!
//! Reads earlier manifests, and only when something is to run. The store knows no stages, so that this is
//! the one place that can say `gamma 1.8 -> 2.2`.

use std::collections::{HashMap, HashSet};
use std::fs;
use std::path::PathBuf;

use serde_json::Value as Json;

use super::graph::Graph;
use super::manifest::{FileEntry, InputEntry, JobEntry, Manifest, Outcome, coordinate_text, place_text, plain_text};

/// So many of the latest runs are looked at for a job that the latest one does not have.
const RUN_COUNT: usize = 8;

/// Text of a value longer than this is cut in a reason.
const VALUE_LENGTH: usize = 40;

/// Jobs of earlier runs.
pub struct History {
    folder: PathBuf,
    /// What a run of the present graph has: (stage, text of the coordinate).
    present: HashSet<(String, String)>,
    /// The stages of the present graph.
    stages: HashSet<String>,
    loaded: Option<EarlierStages>,
}

/// Earlier jobs by stage, then by the text of their coordinate.
type EarlierStages = HashMap<String, HashMap<String, EarlierJob>>;

struct EarlierJob {
    job: JobEntry,
    is_of_the_latest: bool,
    /// Its place in the order of reading, by which equally near ones are chosen.
    rank: usize,
}

impl History {
    /// The history of a pipeline whose outputs stand in `folder`.
    pub fn new(folder: PathBuf, graph: &Graph) -> Self {
        let name = |job: &super::graph::JobNode| graph.stages[job.stage].name.clone();
        let present = graph.jobs.iter().map(|job| (name(job), job.coordinate.to_string())).collect();
        let stages = graph.stages.iter().map(|stage| stage.name.clone()).collect();
        Self { folder, present, stages, loaded: None }
    }

    /// Why this job has no result in the store, as far as its entry is filled in.
    pub fn reason(&mut self, job: &JobEntry) -> String {
        self.known_difference(job).unwrap_or_else(|| {
            let outcome = self.earlier(job).map(|earlier| earlier.job.outcome);
            match outcome {
                Some(Outcome::Failed) => "failed before".into(),
                Some(Outcome::Interrupted) => "interrupted before".into(),
                _ => "result missing".into(),
            }
        })
    }

    /// What differs already while some inputs of the job are not known yet.
    pub fn known_difference(&mut self, job: &JobEntry) -> Option<String> {
        let Some(earlier) = self.earlier(job) else { return Some("never ran".into()) };
        let told = told(&changes(&earlier.job, job));
        if earlier.job.stage == job.stage {
            return told;
        }
        let renamed = format!("renamed from {}", earlier.job.stage);
        Some(told.map_or_else(|| renamed.clone(), |told| format!("{renamed}; {told}")))
    }

    /// Seconds that this job, or else one of its stage, took when it ran.
    pub fn seconds(&mut self, job: &JobEntry) -> Option<f64> {
        let same = self.earlier(job).and_then(|earlier| earlier.job.measured);
        let other = || {
            let others = self.loaded.as_ref()?.get(&job.stage)?.values().filter(|earlier| earlier.job.measured.is_some());
            others.min_by_key(|earlier| earlier.rank)?.job.measured
        };
        same.or_else(other).map(|measured| measured.seconds)
    }

    /// The nearest earlier record: of the same stage and coordinate, else of a coordinate or a stage that is gone.
    fn earlier(&mut self, job: &JobEntry) -> Option<&EarlierJob> {
        let folder = &self.folder;
        let stages = self.loaded.get_or_insert_with(|| load(folder));
        let Some(entries) = stages.get(&job.stage) else { return renamed(stages, &self.stages, job) };
        if let Some(same) = entries.get(&coordinate_text(&job.coordinate)) {
            return Some(same);
        }
        // A value of an axis that was replaced: its old place, in the latest run, is no longer among the jobs.
        let is_gone = |place: &str| !self.present.contains(&(job.stage.clone(), place.to_owned()));
        let gone = entries.iter().filter(|(place, entry)| entry.is_of_the_latest && is_gone(place)).map(|(_, entry)| entry);
        gone.min_by(|a, b| {
            let distances = [a, b].map(|entry| distance(&entry.job.coordinate, &job.coordinate));
            distances[0].total_cmp(&distances[1]).then_with(|| a.rank.cmp(&b.rank))
        })
    }
}

/// The record of the stage that this one was, under a name that is gone: of its kind, and hardly different.
fn renamed<'e>(stages: &'e EarlierStages, present: &HashSet<String>, job: &JobEntry) -> Option<&'e EarlierJob> {
    let place = coordinate_text(&job.coordinate);
    let gone = stages.iter().filter(|(stage, _)| !present.contains(*stage));
    let same = gone.filter_map(|(_, entries)| entries.get(&place)).filter(|entry| entry.is_of_the_latest && entry.job.kind == job.kind);
    let nearest = same.map(|entry| (changes(&entry.job, job).len(), entry)).min_by_key(|(count, entry)| (*count, entry.rank));
    nearest.filter(|(count, _)| *count <= 1).map(|(_, entry)| entry)
}

/// How many axes differ, and among numbers how far.
fn distance(a: &Json, b: &Json) -> f64 {
    let fields = |json: &Json| json.as_object().cloned().unwrap_or_default();
    let (a, b) = (fields(a), fields(b));
    let axes: HashSet<&String> = a.keys().chain(b.keys()).collect();
    axes.into_iter()
        .map(|axis| match (a.get(axis), b.get(axis)) {
            (Some(one), Some(other)) if one == other => 0.0,
            (Some(one), Some(other)) => match (one.as_f64(), other.as_f64()) {
                // Below one, so that a differing axis never outweighs the number of equal ones.
                (Some(one), Some(other)) => 1.0 - 1.0 / (1.0 + (one - other).abs()) / 2.0,
                _ => 1.0,
            },
            _ => 2.0,
        })
        .sum()
}

/// The latest run's jobs, then those of earlier runs that the later ones lack.
fn load(folder: &std::path::Path) -> EarlierStages {
    let mut stages = EarlierStages::new();
    let latest = read_manifest(&folder.join("manifest.json"));
    let manifests = latest.into_iter().chain(run_folders(folder).filter_map(|run| read_manifest(&run.join("manifest.json"))));
    let jobs = manifests.take(RUN_COUNT).enumerate().flat_map(|(age, manifest)| manifest.jobs.into_iter().map(move |job| (age, job)));
    // A job that was not started has no key and says nothing.
    for (rank, (age, job)) in jobs.filter(|(_, job)| job.key.is_some()).enumerate() {
        let places = stages.entry(job.stage.clone()).or_default();
        places.entry(coordinate_text(&job.coordinate)).or_insert(EarlierJob { job, is_of_the_latest: age == 0, rank });
    }
    stages
}

fn read_manifest(path: &std::path::Path) -> Option<Manifest> {
    serde_json::from_slice(&fs::read(path).ok()?).ok()
}

/// Folders of earlier runs, latest first.
fn run_folders(folder: &std::path::Path) -> impl Iterator<Item = PathBuf> + use<> {
    let entries = fs::read_dir(folder.join("runs")).into_iter().flatten().flatten();
    let mut folders: Vec<PathBuf> = entries.map(|entry| entry.path()).collect();
    folders.sort_unstable_by(|a, b| b.cmp(a));
    // Short manifests of runs that changed nothing do not read as whole ones; they are passed over cheaply.
    folders.into_iter().take(4 * RUN_COUNT)
}

/// What differs between two records of a job, each in the words of a plan; empty if they would have one key.
///
/// Inputs whose content one of the two does not know yet are taken for equal.
pub fn changes(earlier: &JobEntry, job: &JobEntry) -> Vec<String> {
    if earlier.kind != job.kind {
        // The parameters of two kinds have nothing to do with each other.
        return vec![format!("kind {} -> {}", earlier.kind, job.kind)];
    }
    let version = (earlier.version != job.version).then(|| format!("version {} -> {}", earlier.version, job.version));
    let mut changes: Vec<String> = version.into_iter().collect();
    changes.extend(parameter_changes(earlier, job).into_iter().map(|change| format!("{PARAMETER}{change}")));
    changes.extend(file_changes(earlier, job));
    changes.extend(input_changes(earlier, job));
    changes
}

const PARAMETER: &str = "parameter ";

/// So many changes are told in one reason.
const TOLD_COUNT: usize = 2;

/// Changes in one line: `parameters gamma 1.8 -> 2.2, size 64 -> 128 and 3 more`.
pub fn told(changes: &[String]) -> Option<String> {
    let shown = &changes[..changes.len().min(TOLD_COUNT)];
    let parameters: Vec<&str> = shown.iter().filter_map(|change| change.strip_prefix(PARAMETER)).collect();
    let text = if parameters.len() > 1 { format!("parameters {}", parameters.join(", ")) } else { shown.join("; ") };
    match changes.len() - shown.len() {
        _ if changes.is_empty() => None,
        0 => Some(text),
        others => Some(format!("{text} and {others} more")),
    }
}

/// `field old -> new` for each parameter that differs.
fn parameter_changes(earlier: &JobEntry, job: &JobEntry) -> Vec<String> {
    let mut changes = Vec::new();
    collect_changes("", &earlier.parameters, &job.parameters, &mut changes);
    if let (Some(old), Some(new)) = (earlier.seed, job.seed)
        && old != new
        && !changes.iter().any(|change| change.starts_with("seed "))
    {
        changes.push(format!("seed {old} -> {new}"));
    }
    changes
}

/// `path old -> new` for every field that differs, in the order of the fields.
fn collect_changes(path: &str, old: &Json, new: &Json, changes: &mut Vec<String>) {
    match (old, new) {
        (Json::Object(olds), Json::Object(news)) => {
            let mut names: Vec<&String> = olds.keys().chain(news.keys()).collect();
            names.sort_unstable();
            names.dedup();
            for name in names {
                let inner = if path.is_empty() { name.clone() } else { format!("{path}.{name}") };
                let absent = Json::Null;
                collect_changes(&inner, olds.get(name).unwrap_or(&absent), news.get(name).unwrap_or(&absent), changes);
            }
        }
        _ if old == new => {}
        _ => changes.push(format!("{path} {} -> {}", shown(old), shown(new))),
    }
}

fn shown(value: &Json) -> String {
    let text = if value.is_null() { "default".to_owned() } else { plain_text(value) };
    match text.char_indices().nth(VALUE_LENGTH) {
        Some((end, _)) => format!("{}…", &text[..end]),
        None => text,
    }
}

/// Files of the same path and other content; another path shows among the parameters.
fn file_changes(earlier: &JobEntry, job: &JobEntry) -> Vec<String> {
    let is_other = |file: &&FileEntry| {
        let before = earlier.files.iter().find(|other| other.parameter == file.parameter && other.path == file.path);
        before.is_some_and(|before| before.sha256 != file.sha256)
    };
    job.files.iter().filter(is_other).map(|file| format!("file {} changed", file.path)).collect()
}

/// Inputs of other content, of another name, more, fewer, or in another order.
fn input_changes(earlier: &JobEntry, job: &JobEntry) -> Vec<String> {
    let place = |input: &InputEntry| (input.port.clone(), place_text(&input.stage, &input.coordinate));
    let olds: HashMap<_, _> = earlier.inputs.iter().map(|input| (place(input), input)).collect();
    let news: HashSet<_> = job.inputs.iter().map(place).collect();
    let added: Vec<_> = job.inputs.iter().filter(|input| !olds.contains_key(&place(input))).collect();
    let removed: Vec<_> = earlier.inputs.iter().filter(|input| !news.contains(&place(input))).collect();

    let mut changes = match (added.as_slice(), removed.as_slice()) {
        ([new, ..], [old, ..]) if is_exchanged(&added, &removed) => vec![format!("input {} -> {}", old.stage, new.stage)],
        _ => [counted(&added, "added"), counted(&removed, "removed")].concat(),
    };
    let is_other = |input: &&InputEntry| {
        let before = olds.get(&place(input)).and_then(|before| before.sha256);
        matches!((before, input.sha256), (Some(old), Some(new)) if old != new)
    };
    changes.extend(job.inputs.iter().filter(is_other).map(|input| format!("input {} changed", input.stage)));
    if changes.is_empty() && !earlier.inputs.iter().map(place).eq(job.inputs.iter().map(place)) {
        changes.push("inputs in another order".to_owned());
    }
    let mut seen = HashSet::new();
    changes.retain(|change| seen.insert(change.clone()));
    changes
}

/// Whether one stage stands where another one stood.
fn is_exchanged(added: &[&InputEntry], removed: &[&InputEntry]) -> bool {
    let one = |inputs: &[&InputEntry]| inputs.iter().all(|input| input.stage == inputs[0].stage);
    added.len() == removed.len() && one(added) && one(removed) && added[0].stage != removed[0].stage
}

/// `input sphere[n=64] added`, or how many of a stage.
fn counted(inputs: &[&InputEntry], word: &str) -> Vec<String> {
    let mut counts: Vec<(&InputEntry, usize)> = Vec::new();
    for input in inputs {
        match counts.iter_mut().find(|(first, _)| first.stage == input.stage) {
            Some((_, count)) => *count += 1,
            None => counts.push((input, 1)),
        }
    }
    let text = |(first, count): (&InputEntry, usize)| match count {
        1 => format!("input {} {word}", place_text(&first.stage, &first.coordinate)),
        _ => format!("input {}: {count} {word}", first.stage),
    };
    counts.into_iter().map(text).collect()
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn parameters(old: Json, new: Json) -> Vec<String> {
        let mut changes = Vec::new();
        collect_changes("", &old, &new, &mut changes);
        changes
    }

    #[test]
    fn a_change_names_the_field_with_old_and_new_value() {
        assert_eq!(parameters(json!({"gamma": 1.8}), json!({"gamma": 2.2})), ["gamma 1.8 -> 2.2"]);
        assert_eq!(parameters(json!({}), json!({"gamma": "srgb"})), ["gamma default -> srgb"]);
        assert_eq!(parameters(json!({"a": {"b": [1]}, "c": 1}), json!({"a": {"b": [2]}})), ["a.b [1] -> [2]", "c 1 -> default"]);
        assert_eq!(parameters(json!({"a": 1}), json!({"a": 1})), Vec::<String>::new());
        let long = parameters(json!({"a": "x".repeat(100)}), json!({"a": 1})).remove(0);
        assert!(long.chars().count() < 60, "{long}");
    }

    #[test]
    fn a_reason_tells_two_changes_and_counts_the_others() {
        let texts = |changes: &[&str]| told(&changes.iter().map(|text| (*text).to_owned()).collect::<Vec<_>>());
        assert_eq!(texts(&[]), None);
        assert_eq!(texts(&["parameter a 1 -> 2"]).unwrap(), "parameter a 1 -> 2");
        assert_eq!(texts(&["parameter a 1 -> 2", "parameter b 3 -> 4"]).unwrap(), "parameters a 1 -> 2, b 3 -> 4");
        assert_eq!(texts(&["version 2 -> 3", "parameter a 1 -> 2"]).unwrap(), "version 2 -> 3; parameter a 1 -> 2");
        assert_eq!(
            texts(&["parameter a 1 -> 2", "parameter b 3 -> 4", "input c changed"]).unwrap(),
            "parameters a 1 -> 2, b 3 -> 4 and 1 more"
        );
    }

    #[test]
    fn the_nearest_coordinate_shares_most_axes() {
        let near = distance(&json!({"n": 64, "gamma": 1.8}), &json!({"n": 64, "gamma": 2.2}));
        let far = distance(&json!({"n": 64, "gamma": 1.0}), &json!({"n": 64, "gamma": 2.2}));
        let other = distance(&json!({"n": 256, "gamma": 1.8}), &json!({"n": 64, "gamma": 2.2}));
        assert!(near < far && far < other);
        assert_eq!(coordinate_text(&json!({"n": 64, "look": "warm"})), "n=64,look=warm");
    }
}

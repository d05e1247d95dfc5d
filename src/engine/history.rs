//! Why a job runs: what differs from what earlier runs of the pipeline say of it.
//!
//! Reads earlier manifests, and only when something is to run. The store knows no stages, so that this is
//! the one place that can say `gamma 1.8 -> 2.2`.

use std::collections::{HashMap, HashSet};
use std::fs;
use std::path::PathBuf;

use serde_json::Value as Json;

use super::graph::Graph;
use super::manifest::{JobEntry, Manifest};

/// So many of the latest runs are looked at for a job that the latest one does not have.
const RUN_COUNT: usize = 8;

/// Text of a value longer than this is cut in a reason.
const VALUE_LENGTH: usize = 40;

/// Jobs of earlier runs.
pub struct History {
    folder: PathBuf,
    /// What a run of the present graph has: (stage, text of the coordinate).
    present: HashSet<(String, String)>,
    loaded: Option<HashMap<String, Vec<EarlierJob>>>,
}

struct EarlierJob {
    job: JobEntry,
    is_of_the_latest: bool,
}

impl History {
    /// The history of a pipeline whose outputs stand in `folder`.
    pub fn new(folder: PathBuf, graph: &Graph) -> Self {
        let name = |job: &super::graph::JobNode| graph.stages[job.stage].name.clone();
        let present = graph.jobs.iter().map(|job| (name(job), job.coordinate.to_string())).collect();
        Self { folder, present, loaded: None }
    }

    /// Why this job has no result in the store, as far as its entry is filled in.
    pub fn reason(&mut self, job: &JobEntry) -> String {
        match self.earlier(job) {
            Some(earlier) => difference(earlier, job).unwrap_or_else(|| "result missing".into()),
            None => "never ran".into(),
        }
    }

    /// What differs already while some inputs of the job are not known yet.
    pub fn known_difference(&mut self, job: &JobEntry) -> Option<String> {
        match self.earlier(job) {
            Some(earlier) => difference(earlier, job),
            None => Some("never ran".into()),
        }
    }

    /// Seconds that this job, or else one of its stage, took when it ran.
    pub fn seconds(&mut self, job: &JobEntry) -> Option<f64> {
        let same = self.earlier(job).and_then(|earlier| earlier.measured);
        let other = || self.loaded.as_ref()?.get(&job.stage)?.iter().find_map(|earlier| earlier.job.measured);
        same.or_else(other).map(|measured| measured.seconds)
    }

    fn earlier(&mut self, job: &JobEntry) -> Option<&JobEntry> {
        let folder = &self.folder;
        let stages = self.loaded.get_or_insert_with(|| load(folder));
        let entries = stages.get(&job.stage)?;
        if let Some(same) = entries.iter().find(|earlier| earlier.job.coordinate == job.coordinate) {
            return Some(&same.job);
        }
        // A value of an axis that was replaced: its old place, in the latest run, is no longer among the jobs.
        let is_gone = |entry: &&JobEntry| !self.present.contains(&(entry.stage.clone(), coordinate_text(&entry.coordinate)));
        entries.iter().filter(|entry| entry.is_of_the_latest).map(|earlier| &earlier.job).filter(is_gone).min_by(|a, b| {
            let distances = [a, b].map(|entry| distance(&entry.coordinate, &job.coordinate));
            distances[0].partial_cmp(&distances[1]).expect("distances are numbers")
        })
    }
}

/// The text of a coordinate, as [`super::coordinate::Coordinate`] writes it.
fn coordinate_text(coordinate: &Json) -> String {
    let fields = coordinate.as_object().into_iter().flatten();
    let texts: Vec<String> = fields.map(|(axis, value)| format!("{axis}={}", plain_text(value))).collect();
    texts.join(",")
}

fn plain_text(value: &Json) -> String {
    value.as_str().map_or_else(|| value.to_string(), str::to_owned)
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

/// Jobs by stage: the latest run's first, then those of earlier runs that the later ones lack.
fn load(folder: &std::path::Path) -> HashMap<String, Vec<EarlierJob>> {
    let mut stages: HashMap<String, Vec<EarlierJob>> = HashMap::new();
    let mut seen = HashSet::new();
    let latest = read_manifest(&folder.join("manifest.json"));
    let manifests = latest.into_iter().chain(run_folders(folder).filter_map(|run| read_manifest(&run.join("manifest.json"))));
    for (age, manifest) in manifests.take(RUN_COUNT).enumerate() {
        for job in manifest.jobs {
            // A job that was not started has no key and says nothing.
            if job.key.is_some() && seen.insert((job.stage.clone(), coordinate_text(&job.coordinate))) {
                stages.entry(job.stage.clone()).or_default().push(EarlierJob { job, is_of_the_latest: age == 0 });
            }
        }
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

fn difference(earlier: &JobEntry, job: &JobEntry) -> Option<String> {
    if earlier.kind != job.kind {
        return Some(format!("kind {} -> {}", earlier.kind, job.kind));
    }
    if earlier.version != job.version {
        return Some(format!("version {} -> {}", earlier.version, job.version));
    }
    parameter_difference(earlier, job).or_else(|| file_difference(earlier, job)).or_else(|| input_difference(earlier, job))
}

fn parameter_difference(earlier: &JobEntry, job: &JobEntry) -> Option<String> {
    let mut changes = Vec::new();
    collect_changes("", &earlier.parameters, &job.parameters, &mut changes);
    if let (Some(old), Some(new)) = (earlier.seed, job.seed)
        && old != new
        && changes.is_empty()
    {
        changes.push(format!("seed {old} -> {new}"));
    }
    let others = changes.len().saturating_sub(1);
    let first = changes.into_iter().next()?;
    Some(if others == 0 { format!("parameter {first}") } else { format!("parameter {first} and {others} more") })
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

fn file_difference(earlier: &JobEntry, job: &JobEntry) -> Option<String> {
    let changed = job.files.iter().find(|file| {
        let before = earlier.files.iter().find(|other| other.parameter == file.parameter);
        before.is_some_and(|before| before.sha256 != file.sha256)
    })?;
    Some(format!("input {} changed", changed.path))
}

fn input_difference(earlier: &JobEntry, job: &JobEntry) -> Option<String> {
    for (index, input) in job.inputs.iter().enumerate() {
        let before = earlier.inputs.get(index);
        let is_same_place = before.is_some_and(|before| (&before.port, &before.stage) == (&input.port, &input.stage));
        if !is_same_place {
            return Some(format!("input {} is another", input.port));
        }
        if input.sha256.is_some() && before.is_some_and(|before| before.sha256 != input.sha256) {
            return Some(format!("input {} changed", input.stage));
        }
    }
    (earlier.inputs.len() > job.inputs.len()).then(|| "inputs are fewer".to_owned())
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn changes(old: Json, new: Json) -> Vec<String> {
        let mut changes = Vec::new();
        collect_changes("", &old, &new, &mut changes);
        changes
    }

    #[test]
    fn a_change_names_the_field_with_old_and_new_value() {
        assert_eq!(changes(json!({"gamma": 1.8}), json!({"gamma": 2.2})), ["gamma 1.8 -> 2.2"]);
        assert_eq!(changes(json!({}), json!({"gamma": "srgb"})), ["gamma default -> srgb"]);
        assert_eq!(changes(json!({"a": {"b": [1]}, "c": 1}), json!({"a": {"b": [2]}})), ["a.b [1] -> [2]", "c 1 -> default"]);
        assert_eq!(changes(json!({"a": 1}), json!({"a": 1})), Vec::<String>::new());
        let long = changes(json!({"a": "x".repeat(100)}), json!({"a": 1})).remove(0);
        assert!(long.chars().count() < 60, "{long}");
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

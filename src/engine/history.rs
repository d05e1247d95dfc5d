//! Why a job runs: what differs from what earlier runs of the pipeline say of it.
//!
//! Reads earlier manifests, and only when something is to run. The store knows no stages, so that this is
//! the one place that can say `gamma 1.8 -> 2.2`.

use std::collections::{HashMap, HashSet};
use std::fs;
use std::ops::Range;
use std::path::{Path, PathBuf};

use serde::Deserialize;
use serde_json::Value as Json;

use super::graph::Graph;
use super::lines;
use super::manifest::{FileEntry, InputEntry, JobEntry, Manifest, Outcome, coordinate_text, place_text, plain_text};

/// So many of the latest runs are looked at for a job that the latest one does not have.
const RUN_COUNT: usize = 8;

/// Text of a value longer than this is cut in a reason.
const VALUE_LENGTH: usize = 40;

/// Jobs of earlier runs, read when they are asked for.
pub struct History {
    folder: PathBuf,
    /// What a run of the present graph has: (stage, text of the coordinate).
    present: HashSet<(String, String)>,
    /// The stages of the present graph.
    stages: HashSet<String>,
    /// The latest run, then the others as far as they were looked at.
    runs: Vec<EarlierRun>,
    /// Manifests that were not looked at; `None` before the first look.
    unread: Option<std::vec::IntoIter<PathBuf>>,
}

/// The text of a manifest, with the place of each job in it.
pub struct EarlierRun {
    text: String,
    /// By stage, then by the text of the coordinate: which line it is, and where.
    jobs: HashMap<String, HashMap<String, (usize, Range<usize>)>>,
}

impl EarlierRun {
    fn read(path: &Path) -> Option<Self> {
        Self::of_manifest(fs::read_to_string(path).ok()?)
    }

    /// `None` if it is no manifest of a run that did something.
    pub fn of_manifest(text: String) -> Option<Self> {
        let run = Self::of_text(text);
        if !run.jobs.is_empty() {
            return Some(run);
        }
        // Without jobs, or laid out anew by someone.
        let manifest: Manifest = serde_json::from_str(&run.text).ok()?;
        Some(Self::of_text(String::from_utf8(lines::text(&manifest)).ok()?))
    }

    fn of_text(text: String) -> Self {
        let mut jobs: HashMap<String, HashMap<String, (usize, Range<usize>)>> = HashMap::new();
        let mut start = 0;
        for (rank, line) in text.split('\n').enumerate() {
            let entry = line.trim_start();
            let begin = start + line.len() - entry.len();
            start += line.len() + 1;
            if !entry.starts_with(JOB_START) {
                continue;
            }
            let entry = entry.strip_suffix(',').unwrap_or(entry);
            let Some(JobPlace { stage, coordinate }) = place_of(entry) else { continue };
            jobs.entry(stage).or_default().insert(coordinate_text(&coordinate), (rank, begin..begin + entry.len()));
        }
        Self { text, jobs }
    }

    /// A job that was not started has no key and says nothing.
    fn job(&self, line: &Range<usize>) -> Option<JobEntry> {
        serde_json::from_str(&self.text[line.clone()]).ok().filter(|job: &JobEntry| job.key.is_some())
    }

    fn job_at(&self, stage: &str, place: &str) -> Option<JobEntry> {
        self.job(&self.jobs.get(stage)?.get(place)?.1)
    }
}

/// With this an entry of a job begins.
const JOB_START: &str = "{\"stage\":";

/// The first two fields of a job.
#[derive(Deserialize)]
struct JobPlace {
    stage: String,
    coordinate: Json,
}

fn place_of(entry: &str) -> Option<JobPlace> {
    // What comes before the third field is enough, unless an axis is called as that field is.
    let start = entry.find(",\"kind\":").map(|end| format!("{}}}", &entry[..end]));
    let place = start.and_then(|start| serde_json::from_str(&start).ok());
    place.or_else(|| serde_json::from_str(entry).ok())
}

impl History {
    /// The history of a pipeline whose outputs stand in `folder`; the latest run, if it was read already.
    pub fn new(folder: PathBuf, graph: &Graph, latest: Option<EarlierRun>) -> Self {
        let name = |job: &super::graph::JobNode| graph.stages[job.stage].name.clone();
        let present = graph.jobs.iter().map(|job| (name(job), job.coordinate.to_string())).collect();
        let stages = graph.stages.iter().map(|stage| stage.name.clone()).collect();
        Self { folder, present, stages, runs: latest.into_iter().collect(), unread: None }
    }

    /// Why this job has no result in the store, as far as its entry is filled in.
    pub fn reason(&mut self, job: &JobEntry) -> String {
        self.known_difference(job).unwrap_or_else(|| {
            let outcome = self.earlier(job).map(|earlier| earlier.outcome);
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
        let told = told(&changes(&earlier, job));
        if earlier.stage == job.stage {
            return told;
        }
        let renamed = format!("renamed from {}", earlier.stage);
        Some(told.map_or_else(|| renamed.clone(), |told| format!("{renamed}; {told}")))
    }

    /// Seconds that this job, or else one of its stage, took when it ran.
    pub fn seconds(&mut self, job: &JobEntry) -> Option<f64> {
        let seconds = |entry: JobEntry| Some(entry.measured.as_ref()?.seconds + entry.part_seconds().sum::<f64>());
        let same = self.earlier(job).and_then(seconds);
        let other = || {
            let runs = self.runs.iter().filter_map(|run| Some((run, run.jobs.get(&job.stage)?)));
            let entries = runs.flat_map(|(run, places)| in_order(places).into_iter().map(move |line| (run, line)));
            entries.take(SIBLING_COUNT).find_map(|(run, line)| seconds(run.job(&line)?))
        };
        same.or_else(other)
    }

    /// The run of that age: 0 is the latest.
    fn run(&mut self, age: usize) -> Option<&EarlierRun> {
        let (folder, known) = (&self.folder, self.runs.len());
        let unread = self.unread.get_or_insert_with(|| manifests(folder).split_off(known).into_iter());
        while self.runs.len() <= age.min(RUN_COUNT - 1) {
            match unread.find_map(|path| EarlierRun::read(&path)) {
                Some(run) => self.runs.push(run),
                None => break,
            }
        }
        self.runs.get(age)
    }

    /// The nearest earlier record: of the same stage and coordinate, else of a coordinate or a stage that is gone.
    fn earlier(&mut self, job: &JobEntry) -> Option<JobEntry> {
        let place = coordinate_text(&job.coordinate);
        let mut is_known_stage = false;
        for age in 0..RUN_COUNT {
            let Some(run) = self.run(age) else { break };
            is_known_stage |= run.jobs.contains_key(&job.stage);
            if let Some(same) = run.job_at(&job.stage, &place) {
                return Some(same);
            }
        }
        let latest = self.runs.first()?;
        if !is_known_stage {
            return renamed(latest, &self.stages, job);
        }
        // A value of an axis that was replaced: its old place, in the latest run, is no longer among the jobs.
        let is_gone = |place: &str| !self.present.contains(&(job.stage.clone(), place.to_owned()));
        let gone = latest.jobs.get(&job.stage).into_iter().flatten().filter(|(place, _)| is_gone(place));
        let gone = gone.filter_map(|(_, (rank, line))| Some((rank, latest.job(line)?)));
        let nearest = gone.min_by(|a, b| {
            let distances = [a, b].map(|(_, entry)| distance(&entry.coordinate, &job.coordinate));
            distances[0].total_cmp(&distances[1]).then_with(|| a.0.cmp(b.0))
        });
        nearest.map(|(_, entry)| entry)
    }
}

/// So many jobs of a stage are looked at for one that was measured.
const SIBLING_COUNT: usize = 4;

fn in_order(places: &HashMap<String, (usize, Range<usize>)>) -> Vec<Range<usize>> {
    let mut lines: Vec<&(usize, Range<usize>)> = places.values().collect();
    lines.sort_unstable_by_key(|(rank, _)| *rank);
    lines.into_iter().map(|(_, line)| line.clone()).collect()
}

/// The record of the stage that this one was, under a name that is gone: of its kind, and hardly different.
fn renamed(latest: &EarlierRun, present: &HashSet<String>, job: &JobEntry) -> Option<JobEntry> {
    let place = coordinate_text(&job.coordinate);
    let gone = latest.jobs.iter().filter(|(stage, _)| !present.contains(*stage));
    let same = gone.filter_map(|(_, places)| places.get(&place)).filter_map(|(rank, line)| Some((rank, latest.job(line)?)));
    let of_its_kind = same.filter(|(_, entry)| entry.kind == job.kind);
    let nearest = of_its_kind.map(|(rank, entry)| (changes(&entry, job).len(), rank, entry)).min_by_key(|(count, rank, _)| (*count, *rank));
    nearest.filter(|(count, ..)| *count <= 1).map(|(.., entry)| entry)
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

/// Manifests of the pipeline: the latest, then those of earlier runs, the youngest first.
fn manifests(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder.join("runs")).into_iter().flatten().flatten();
    let mut folders: Vec<PathBuf> = entries.map(|entry| entry.path()).collect();
    folders.sort_unstable_by(|a, b| b.cmp(a));
    // Short manifests of runs that executed nothing do not read as whole ones; they are passed over cheaply.
    let runs = folders.into_iter().take(4 * RUN_COUNT);
    std::iter::once(folder.to_owned()).chain(runs).map(|folder| folder.join("manifest.json")).collect()
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

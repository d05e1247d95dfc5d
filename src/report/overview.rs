//! What a reader wants to know first: how the run ended, what was reused, and what to be careful of.

use std::collections::BTreeMap;

use serde::Serialize;

use crate::engine::manifest::{JobEntry, Manifest, Outcome, Status, place_text, plain_text};

/// The head of the page.
#[derive(Debug, Serialize)]
pub struct Overview {
    /// Name of the pipeline.
    pub pipeline: String,
    /// Name of the run.
    pub run_id: String,
    /// How it ended.
    pub status: &'static str,
    /// Names and values, in the order of interest.
    pub facts: Vec<[String; 2]>,
    /// Jobs by outcome.
    pub outcomes: Vec<Count>,
    /// Jobs.
    pub jobs: usize,
    /// Why jobs ran, with their number.
    pub reasons: Vec<Count>,
    /// Jobs that failed: place and message.
    pub failures: Vec<[String; 2]>,
    /// What the reader of the results must know: stage, text, and how many jobs said it.
    pub warnings: Vec<(String, String, u64)>,
    /// Results that should be shown and are gone.
    pub gone: Vec<String>,
    /// How many there are of those.
    pub gone_count: usize,
}

/// A number of jobs.
#[derive(Debug, PartialEq, Serialize)]
pub struct Count {
    /// What they have in common.
    pub name: String,
    /// How many.
    pub count: usize,
    /// Part of all jobs, in per cent of a bar.
    pub width: f64,
}

/// Reasons that are shown.
const REASONS: usize = 12;

/// Places that are named.
const GONE: usize = 8;

/// Of a manifest, and the places of results that are gone.
pub fn overview(manifest: &Manifest, gone: &[String]) -> Overview {
    let jobs = &manifest.jobs;
    Overview {
        pipeline: manifest.pipeline.clone(),
        run_id: manifest.run_id.clone(),
        status: match manifest.status {
            Status::Done => "done",
            Status::Failed => "failed",
            Status::Interrupted => "interrupted",
        },
        facts: facts(manifest),
        outcomes: counts(jobs.iter().map(|job| job.outcome.word().to_owned()), jobs.len(), usize::MAX),
        jobs: jobs.len(),
        reasons: counts(jobs.iter().filter(|job| job.outcome == Outcome::Ran).map(|job| job.reason.clone()), jobs.len(), REASONS),
        failures: jobs.iter().filter_map(|job| Some([place(job), job.error.clone()?])).collect(),
        warnings: manifest.warnings.iter().map(|warning| (warning.stage.clone(), warning.message.clone(), warning.jobs)).collect(),
        gone: gone.iter().take(GONE).cloned().collect(),
        gone_count: gone.len(),
    }
}

fn place(job: &JobEntry) -> String {
    place_text(&job.stage, &job.coordinate)
}

/// The most frequent first, then by name; what only passes a change on comes after what has changed.
fn counts(names: impl Iterator<Item = String>, total: usize, limit: usize) -> Vec<Count> {
    let mut sums: BTreeMap<String, usize> = BTreeMap::new();
    names.for_each(|name| *sums.entry(name).or_default() += 1);
    let mut sums: Vec<_> = sums.into_iter().collect();
    sums.sort_by_key(|(name, count)| (is_passed_on(name), std::cmp::Reverse(*count)));
    sums.truncate(limit);
    let width = |count: usize| (10_000.0 * count as f64 / total.max(1) as f64).round() / 100.0;
    sums.into_iter().map(|(name, count)| Count { name, count, width: width(count) }).collect()
}

/// Whether a reason names nothing but inputs that have changed.
fn is_passed_on(reason: &str) -> bool {
    reason.split("; ").all(|clause| clause.starts_with("input ") && clause.ends_with(" changed"))
}

fn facts(manifest: &Manifest) -> Vec<[String; 2]> {
    let measured = &manifest.measured;
    let started = measured.started.replace('T', " ").replace('Z', " UTC");
    let program = format!("{} {} ({})", manifest.program.name, manifest.program.version, manifest.program.build);
    let machine = format!(
        "{} {}, {} threads of {}",
        manifest.machine.system, manifest.machine.architecture, measured.threads, manifest.machine.processors
    );
    let mut facts = vec![
        ["started".into(), started],
        ["took".into(), seconds_text(measured.seconds)],
        ["files written".into(), measured.files_written.to_string()],
        ["seed".into(), manifest.seed.to_string()],
    ];
    let overrides = manifest.overrides.as_object().into_iter().flatten();
    facts.extend(overrides.map(|(group, value)| {
        let pairs = |fields: &serde_json::Map<String, serde_json::Value>| {
            fields.iter().map(|(name, value)| format!("{name} = {}", plain_text(value))).collect::<Vec<_>>().join(", ")
        };
        [format!("command line: {group}"), value.as_object().map_or_else(|| plain_text(value), pairs)]
    }));
    facts.extend([["program".into(), program], ["machine".into(), machine], ["result".into(), manifest.result_id.to_string()]]);
    facts
}

/// A time for people: `0.8 ms`, `1.31 s`, `2 min 38 s`.
pub fn seconds_text(seconds: f64) -> String {
    match seconds {
        _ if seconds <= 0.0 => "0 s".into(),
        _ if seconds < 0.001 => format!("{:.0} µs", seconds * 1e6),
        _ if seconds < 0.1 => format!("{:.1} ms", seconds * 1e3),
        _ if seconds < 10.0 => format!("{seconds:.2} s"),
        _ if seconds < 60.0 => format!("{seconds:.1} s"),
        _ if seconds < 3600.0 => format!("{} min {:02} s", (seconds / 60.0) as u64, (seconds % 60.0) as u64),
        _ => format!("{} h {:02} min", (seconds / 3600.0) as u64, (seconds % 3600.0 / 60.0) as u64),
    }
}

/// A share for people: `12 %`, `0.3 %`.
pub fn percent_text(share: f64) -> String {
    let percent = 100.0 * share;
    if percent >= 10.0 || percent == 0.0 { format!("{percent:.0} %") } else { format!("{percent:.1} %") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_written_for_people() {
        for (seconds, text) in
            [(0.0, "0 s"), (2e-5, "20 µs"), (0.0123, "12.3 ms"), (1.309, "1.31 s"), (158.1, "2 min 38 s"), (7200.0, "2 h 00 min")]
        {
            assert_eq!(seconds_text(seconds), text);
        }
        assert_eq!([percent_text(0.75), percent_text(0.0123)], ["75 %", "1.2 %"]);
    }

    #[test]
    fn the_most_frequent_comes_first() {
        let names = ["a", "b", "b"].map(str::to_owned);
        let counts = counts(names.into_iter(), 3, 9);
        assert_eq!(counts[0], Count { name: "b".into(), count: 2, width: 66.67 });
    }

    #[test]
    fn a_cause_comes_before_what_follows_from_it() {
        let names = ["input a changed", "input a changed; input b changed", "input a changed", "parameter size 1 -> 2", "input a -> b"];
        let found = counts(names.map(str::to_owned).into_iter(), 5, 3);
        assert_eq!(
            found.iter().map(|count| count.name.as_str()).collect::<Vec<_>>(),
            ["input a -> b", "parameter size 1 -> 2", "input a changed"]
        );
    }
}

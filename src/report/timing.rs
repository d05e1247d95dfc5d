//! Where the time of a run went: its time line, its critical path, and what each kind took.
//!
//! All of it is drawn here, as SVG without text, so that the page needs no script for it.

use std::collections::{BTreeMap, HashMap};
use std::fmt::Write;

use serde::Serialize;

use super::overview::{percent_text, seconds_text};
use super::results::{input_jobs, job_places};
use crate::engine::manifest::{JobEntry, JobMeasured, Manifest, Outcome, place_text};

/// Colors of kinds that the style sheet has; further kinds share the last one.
const COLORS: usize = 8;

/// Bars shorter than this share of the run are put together with their neighbors.
const SHORTEST: f64 = 0.0008;

/// Links of the critical path that are shown.
const PATH_LENGTH: usize = 24;

/// All of it.
#[derive(Debug, Serialize)]
pub struct Timing {
    /// Kinds by the time of their jobs, the longest first.
    pub kinds: Vec<KindTime>,
    /// The drawing of the time line; empty where nothing ran.
    pub line: String,
    /// How many threads are in it.
    pub threads: usize,
    /// Texts at the left and right end of its axis.
    pub axis: [String; 5],
    /// The chain of jobs that the run could not have been shorter than.
    pub path: Vec<Link>,
    /// What that chain took.
    pub path_seconds: String,
    /// Links that are left out at its beginning.
    pub path_left_out: usize,
    /// What all jobs took together.
    pub work_seconds: String,
}

/// What the jobs of a kind took.
#[derive(Debug, Serialize)]
pub struct KindTime {
    /// Name of the kind.
    pub kind: String,
    /// Its color, from 0.
    pub color: usize,
    /// Jobs that ran.
    pub jobs: usize,
    /// Their time.
    pub seconds: String,
    /// Part of the time of all jobs, in per cent.
    pub share: String,
    /// The same as the width of a bar, from 0 to 100.
    pub width: f64,
}

/// A job of the critical path.
#[derive(Debug, Serialize)]
pub struct Link {
    /// Index of the job.
    pub job: usize,
    /// `stage[axis=value]`.
    pub name: String,
    /// Color of its kind.
    pub color: usize,
    /// What it took.
    pub seconds: String,
    /// Width of its bar, from 0 to 100.
    pub width: f64,
}

/// Takes the times from the jobs that ran.
pub fn timing(manifest: &Manifest) -> Timing {
    let jobs = &manifest.jobs;
    let kinds = kinds(jobs);
    let colors: HashMap<&str, usize> = kinds.iter().map(|kind| (kind.kind.as_str(), kind.color)).collect();
    let path = critical_path(jobs);
    let path_seconds: f64 = path.iter().map(|job| seconds(&jobs[*job])).sum();
    let longest = path.iter().map(|job| seconds(&jobs[*job])).fold(f64::MIN_POSITIVE, f64::max);
    let left_out = path.len().saturating_sub(PATH_LENGTH);
    let link = |job: usize| Link {
        job,
        name: place_text(&jobs[job].stage, &jobs[job].coordinate),
        color: colors.get(jobs[job].kind.as_str()).copied().unwrap_or(0),
        seconds: seconds_text(seconds(&jobs[job])),
        width: rounded(100.0 * seconds(&jobs[job]) / longest),
    };
    let links = path[left_out..].iter().map(|job| link(*job)).collect();
    let (line, threads) = time_line(manifest, &colors);
    let total = manifest.measured.seconds;
    Timing {
        axis: [0.0, 0.25, 0.5, 0.75, 1.0].map(|part| seconds_text(part * total)),
        kinds,
        line,
        threads,
        path: links,
        path_seconds: seconds_text(path_seconds),
        path_left_out: left_out,
        work_seconds: seconds_text(jobs.iter().map(work).sum()),
    }
}

/// What was measured of something that ran in this run.
fn ran(outcome: Outcome, measured: Option<&JobMeasured>) -> Option<&JobMeasured> {
    measured.filter(|_| outcome == Outcome::Ran)
}

/// The parts of a job that ran in this run.
fn part_runs(job: &JobEntry) -> impl Iterator<Item = &JobMeasured> {
    job.parts.iter().filter_map(|part| ran(part.outcome, part.measured.as_ref()))
}

/// A job and its parts, as far as they ran in this run.
fn runs(job: &JobEntry) -> impl Iterator<Item = &JobMeasured> {
    part_runs(job).chain(ran(job.outcome, job.measured.as_ref()))
}

/// What a job and its parts took in this run.
fn work(job: &JobEntry) -> f64 {
    runs(job).map(|run| run.seconds).sum()
}

/// The least time in which a job could be done: its parts at once, then itself.
fn seconds(job: &JobEntry) -> f64 {
    let own = ran(job.outcome, job.measured.as_ref()).map_or(0.0, |run| run.seconds);
    own + part_runs(job).map(|run| run.seconds).fold(0.0, f64::max)
}

fn kinds(jobs: &[JobEntry]) -> Vec<KindTime> {
    let mut sums: BTreeMap<&str, (usize, f64)> = BTreeMap::new();
    for job in jobs.iter().filter(|job| job.outcome == Outcome::Ran) {
        let sum = sums.entry(&job.kind).or_default();
        *sum = (sum.0 + 1, sum.1 + work(job));
    }
    let mut sums: Vec<_> = sums.into_iter().collect();
    sums.sort_by(|(_, one), (_, other)| other.1.total_cmp(&one.1));
    let total: f64 = sums.iter().map(|(_, (_, time))| time).sum::<f64>().max(f64::MIN_POSITIVE);
    let longest = sums.first().map_or(1.0, |(_, (_, time))| *time).max(f64::MIN_POSITIVE);
    let row = |(index, (kind, (jobs, time))): (usize, (&str, (usize, f64)))| KindTime {
        kind: kind.to_owned(),
        color: index.min(COLORS - 1),
        jobs,
        seconds: seconds_text(time),
        share: percent_text(time / total),
        width: rounded(100.0 * time / longest),
    };
    sums.into_iter().enumerate().map(row).collect()
}

/// The dearest chain of jobs, its first one first; inputs stand before their users.
fn critical_path(jobs: &[JobEntry]) -> Vec<usize> {
    let places = job_places(jobs);
    let mut ends = vec![0.0; jobs.len()];
    let mut before = vec![None; jobs.len()];
    for (index, job) in jobs.iter().enumerate() {
        let dearest =
            input_jobs(job, &places).filter(|input| *input < index).max_by(|one, other| f64::total_cmp(&ends[*one], &ends[*other]));
        let so_far = dearest.map_or(0.0, |input| ends[input]);
        ends[index] = so_far + seconds(job);
        before[index] = dearest.filter(|_| so_far > 0.0);
    }
    let mut at = (0..jobs.len()).filter(|index| ends[*index] > 0.0).max_by(|one, other| ends[*one].total_cmp(&ends[*other]));
    let mut path = Vec::new();
    while let Some(index) = at {
        path.push(index);
        at = before[index];
    }
    path.reverse();
    path
}

/// A bar of the time line: a job, or many short ones.
struct Bar {
    start: f64,
    end: f64,
    color: usize,
    job: usize,
    count: usize,
    /// What it took.
    seconds: f64,
}

/// One row a thread, one bar a job or a part of one; in parts of the run from 0 to 1000.
fn time_line(manifest: &Manifest, colors: &HashMap<&str, usize>) -> (String, usize) {
    let total = manifest.measured.seconds.max(f64::MIN_POSITIVE);
    let mut rows: BTreeMap<u32, Vec<Bar>> = BTreeMap::new();
    for (index, job) in manifest.jobs.iter().enumerate() {
        let color = colors.get(job.kind.as_str()).copied().unwrap_or(0);
        for JobMeasured { start, thread, seconds, .. } in runs(job) {
            let (Some(start), Some(thread)) = (start, thread) else { continue };
            let end = (start + seconds) / total;
            rows.entry(*thread).or_default().push(Bar { start: start / total, end, color, job: index, count: 1, seconds: *seconds });
        }
    }
    let mut drawing = String::new();
    for (row, bars) in rows.values_mut().enumerate() {
        bars.sort_by(|one, other| one.start.total_cmp(&other.start));
        for bar in joined(std::mem::take(bars)) {
            let x = rounded(1000.0 * bar.start.clamp(0.0, 1.0));
            let width = rounded((1000.0 * (bar.end.min(1.0) - bar.start)).max(0.5));
            let job = &manifest.jobs[bar.job];
            let name = place_text(&job.stage, &job.coordinate);
            let text = if bar.count == 1 {
                format!("{name}: {}", seconds_text(bar.seconds))
            } else {
                format!("{} short jobs, the first is {name}", bar.count)
            };
            let (y, color) = (row * 24, bar.color);
            let _ = write!(
                drawing,
                r#"<rect class="k{color}" x="{x}" y="{y}" width="{width}" height="20" data-job="{}"><title>{}</title></rect>"#,
                bar.job,
                super::page::html(&text)
            );
        }
    }
    (drawing, rows.len())
}

/// Short bars are put together with the short one before, if nothing is between them.
fn joined(bars: Vec<Bar>) -> Vec<Bar> {
    let mut out: Vec<Bar> = Vec::new();
    for bar in bars {
        let is_short = bar.end - bar.start < SHORTEST;
        match out.last_mut() {
            Some(last) if is_short && last.end - last.start < SHORTEST && bar.end - last.start < 2.0 * SHORTEST => {
                last.end = last.end.max(bar.end);
                last.count += bar.count;
            }
            _ => out.push(bar),
        }
    }
    out
}

/// Two decimals are enough for a width.
fn rounded(value: f64) -> f64 {
    (value * 100.0).round() / 100.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::manifest::PartEntry;
    use crate::report::model::tests::job;

    #[test]
    fn the_critical_path_is_the_dearest_chain() {
        // a (1 s) → b (5 s) → d (1 s); a → c (2 s) → d.
        let jobs = [job("a", &[], 1.0), job("b", &["a"], 5.0), job("c", &["a"], 2.0), job("d", &["b", "c"], 1.0), job("e", &[], 6.5)];
        assert_eq!(critical_path(&jobs), [0, 1, 3]);
        assert_eq!(critical_path(&jobs[4..]), [0]);
        assert!(critical_path(&[]).is_empty());
    }

    #[test]
    fn parts_are_work_of_their_whole() {
        let mut whole = job("a", &[], 0.5);
        let part = |number, outcome, seconds| PartEntry { number, key: None, outcome, measured: job("p", &[], seconds).measured };
        whole.parts = vec![part(1, Outcome::Ran, 4.0), part(2, Outcome::Hit, 9.0), part(3, Outcome::Ran, 2.0)];
        assert_eq!((work(&whole), seconds(&whole)), (6.5, 4.5));
        assert_eq!(kinds(&[whole])[0].jobs, 1);
    }

    #[test]
    fn kinds_are_ordered_by_their_time() {
        let jobs = [job("a", &[], 1.0), job("b", &[], 3.0)];
        let kinds = kinds(&jobs);
        assert_eq!(
            kinds.iter().map(|kind| (kind.kind.as_str(), kind.share.as_str())).collect::<Vec<_>>(),
            [("kind-b", "75 %"), ("kind-a", "25 %")]
        );
    }
}

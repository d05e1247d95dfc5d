//! `pipeline plan`: what would run and why.

use std::collections::{BTreeMap, BTreeSet};

use super::Ending;
use super::arguments::{PlanFormat, WorkArguments};
use super::outcomes::{Counts, Outcomes, counted, counts_text};
use super::run::refuse;
use super::screen::{Screen, json_text};
use crate::engine::diagnostic::escape;
use crate::engine::manifest::{JobEntry, Outcome, place_text};
use crate::engine::run;
use crate::engine::run::ahead::Ahead;
use crate::engine::sweep::build_beside;
use crate::stages::registry;

/// Shows the plan; writes nothing.
pub fn plan(work: &WorkArguments, format: PlanFormat, screen: &Screen) -> Ending {
    let as_json = format == PlanFormat::Json;
    let places = work.places.places();
    let (graph, warnings, ahead) = match build_beside(&registry(), &work.request(), |pipeline| Ahead::begin(&places, pipeline)) {
        Ok(built) => built,
        Err(errors) => {
            screen.show(&errors, as_json);
            return Ending::Refused;
        }
    };
    if !work.talk.quiet && !as_json {
        screen.show(&warnings, false);
    }
    let (jobs, store_warnings) = match run::plan(&graph, ahead) {
        Ok(planned) => planned,
        Err(error) => return refuse(&error, as_json, screen),
    };
    store_warnings.iter().for_each(|warning| screen.warning(warning));
    let text = match format {
        PlanFormat::Json => json_text(&serde_json::json!({ "pipeline": graph.pipeline, "jobs": jobs })),
        PlanFormat::Text if work.talk.verbose => job_lines(&graph.pipeline, &jobs),
        PlanFormat::Text => stage_lines(&graph.pipeline, &jobs),
        PlanFormat::Dot => dot(&Drawing::of(&jobs, work.talk.verbose)),
        PlanFormat::Mermaid => mermaid(&Drawing::of(&jobs, work.talk.verbose)),
    };
    screen.print(&text)
}

fn counts<'j>(jobs: impl IntoIterator<Item = &'j JobEntry>) -> Counts {
    jobs.into_iter().fold(Counts::new(), |mut counts, job| {
        *counts.entry(job.outcome).or_default() += 1;
        counts
    })
}

fn headline(pipeline: &str, jobs: &[JobEntry]) -> String {
    format!("{pipeline}: {}: {}\n", counted(jobs.len(), "job"), counts_text(&counts(jobs)))
}

/// A line per stage and reason.
fn stage_lines(pipeline: &str, jobs: &[JobEntry]) -> String {
    let mut outcomes = Outcomes::default();
    jobs.iter().for_each(|job| outcomes.add_planned(job));
    headline(pipeline, jobs) + &outcomes.text() + footnote(jobs)
}

fn job_lines(pipeline: &str, jobs: &[JobEntry]) -> String {
    let name = |job: &JobEntry| escape(&place_text(&job.stage, &job.coordinate));
    let lines = jobs.iter().map(|job| format!("{:5}  {}  {}\n", job.outcome.word(), name(job), escape(&job.reason)));
    headline(pipeline, jobs) + &lines.collect::<String>() + footnote(jobs)
}

/// What the one word means that does not explain itself.
fn footnote(jobs: &[JobEntry]) -> &'static str {
    let has_maybe = jobs.iter().any(|job| job.outcome == Outcome::Maybe);
    if has_maybe { "maybe: a hit if the store has it for what it waits for, else run\n" } else { "" }
}

/// Boxes and arrows: a box per stage, or per job.
struct Drawing {
    /// Name, second line, and whether all is in the store.
    boxes: Vec<(String, String, bool)>,
    /// From and to, as indices of boxes.
    arrows: BTreeSet<(usize, usize)>,
}

impl Drawing {
    fn of(jobs: &[JobEntry], per_job: bool) -> Self {
        let box_name = |stage: &str, coordinate: &serde_json::Value| {
            // A further result, `error.map`, comes from the same box.
            let stage = stage.split('.').next().unwrap_or(stage);
            if per_job { place_text(stage, coordinate) } else { stage.to_owned() }
        };
        let mut places: BTreeMap<String, usize> = BTreeMap::new();
        let mut members: Vec<(String, Vec<&JobEntry>)> = Vec::new();
        let mut arrows = BTreeSet::new();
        for job in jobs {
            let own = box_name(&job.stage, &job.coordinate);
            let index = *places.entry(own.clone()).or_insert_with(|| {
                members.push((own, Vec::new()));
                members.len() - 1
            });
            members[index].1.push(job);
            let inputs = job.inputs.iter().filter_map(|input| places.get(&box_name(&input.stage, &input.coordinate)));
            arrows.extend(inputs.map(|from| (*from, index)));
        }
        let boxed = |(name, jobs): (String, Vec<&JobEntry>)| {
            let counts = counts(jobs);
            let is_hit = counts.keys().all(|outcome| *outcome == Outcome::Hit);
            (name, counts_text(&counts), is_hit)
        };
        Self { boxes: members.into_iter().map(boxed).collect(), arrows }
    }
}

fn dot(drawing: &Drawing) -> String {
    let safe = |text: &str| escape(text).replace('\\', "\\\\").replace('"', "\\\"");
    let boxes = drawing.boxes.iter().enumerate().map(|(index, (name, counts, is_hit))| {
        let style = if *is_hit { "" } else { ", style=bold" };
        format!("  s{index} [label=\"{}\\n{}\"{style}];\n", safe(name), safe(counts))
    });
    let arrows = drawing.arrows.iter().map(|(from, to)| format!("  s{from} -> s{to};\n"));
    format!("digraph pipeline {{\n  rankdir=LR;\n  node [shape=box];\n{}}}\n", boxes.chain(arrows).collect::<String>())
}

fn mermaid(drawing: &Drawing) -> String {
    let safe = |text: &str| escape(text).replace('&', "&amp;").replace('"', "&quot;").replace('<', "&lt;").replace('>', "&gt;");
    let boxes =
        drawing.boxes.iter().enumerate().map(|(index, (name, counts, _))| format!("  s{index}[\"{}<br>{}\"]\n", safe(name), safe(counts)));
    let arrows = drawing.arrows.iter().map(|(from, to)| format!("  s{from} --> s{to}\n"));
    format!("flowchart LR\n{}", boxes.chain(arrows).collect::<String>())
}

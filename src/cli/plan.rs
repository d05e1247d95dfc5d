//! `pipeline plan`: what would run and why.

use std::collections::{BTreeMap, BTreeSet};

use super::Ending;
use super::arguments::{PlanCommand, PlanFormat};
use super::run::refuse;
use super::screen::{Screen, json_text};
use crate::engine::diagnostic::escape;
use crate::engine::manifest::{JobEntry, Outcome};
use crate::engine::run;
use crate::engine::sweep::build;
use crate::stages::registry;

/// Shows the plan; writes nothing.
pub fn plan(command: &PlanCommand, screen: &Screen) -> Ending {
    let as_json = command.format == PlanFormat::Json;
    let (graph, warnings) = match build(&registry(), &command.pipeline.request(&command.targets)) {
        Ok(built) => built,
        Err(errors) => {
            screen.show(&errors, as_json);
            return Ending::Refused;
        }
    };
    if !command.talk.quiet && !as_json {
        screen.show(&warnings, false);
    }
    let (jobs, store_warnings) = match run::plan(&graph, &command.places.places()) {
        Ok(planned) => planned,
        Err(error) => return refuse(&error, as_json, screen),
    };
    store_warnings.iter().for_each(|warning| screen.warning(warning));
    let text = match command.format {
        PlanFormat::Json => json_text(&serde_json::json!({ "pipeline": graph.pipeline, "jobs": jobs })),
        PlanFormat::Text if command.talk.verbose => job_lines(&graph.pipeline, &jobs),
        PlanFormat::Text => stage_lines(&graph.pipeline, &jobs),
        PlanFormat::Dot => dot(&Drawing::of(&jobs, command.talk.verbose)),
        PlanFormat::Mermaid => mermaid(&Drawing::of(&jobs, command.talk.verbose)),
    };
    screen.print(&text)
}

/// Outcomes that a plan has, in the order in which they are shown.
const OUTCOMES: [Outcome; 3] = [Outcome::Hit, Outcome::Run, Outcome::Maybe];

/// Jobs by outcome.
type Counts = BTreeMap<Outcome, usize>;

fn counts<'j>(jobs: impl IntoIterator<Item = &'j JobEntry>) -> Counts {
    jobs.into_iter().fold(Counts::new(), |mut counts, job| {
        *counts.entry(job.outcome).or_default() += 1;
        counts
    })
}

fn counts_text(counts: &Counts) -> String {
    let texts: Vec<String> = OUTCOMES.iter().filter_map(|outcome| Some(format!("{} {}", counts.get(outcome)?, outcome.word()))).collect();
    texts.join(", ")
}

fn headline(pipeline: &str, jobs: &[JobEntry]) -> String {
    format!("{pipeline}: {} jobs: {}\n", jobs.len(), counts_text(&counts(jobs)))
}

/// The stages in order, each with its jobs.
fn by_stage(jobs: &[JobEntry]) -> Vec<(&str, Vec<&JobEntry>)> {
    let mut order: Vec<(&str, Vec<&JobEntry>)> = Vec::new();
    let mut places: BTreeMap<&str, usize> = BTreeMap::new();
    for job in jobs {
        let place = *places.entry(&job.stage).or_insert_with(|| {
            order.push((&job.stage, Vec::new()));
            order.len() - 1
        });
        order[place].1.push(job);
    }
    order
}

/// Columns of a terminal that is not asked for its width.
const WIDTH: usize = 80;

/// Longest name of a stage that is not cut.
const NAME_WIDTH: usize = 24;

/// A line per stage: how many jobs hit, run and wait, and why.
fn stage_lines(pipeline: &str, jobs: &[JobEntry]) -> String {
    let stages = by_stage(jobs);
    let width = stages.iter().map(|(name, _)| name.len()).max().unwrap_or(0).clamp(5, NAME_WIDTH);
    let mut text = headline(pipeline, jobs);
    if jobs.is_empty() {
        return text;
    }
    text += &format!("{:width$} {:>6} {:>6} {:>6}  why\n", "stage", "hit", "run", "maybe");
    for (name, jobs) in &stages {
        let counts = counts(jobs.iter().copied());
        let number = |outcome| counts.get(&outcome).map(ToString::to_string).unwrap_or_default();
        let [hit, run, maybe] = OUTCOMES.map(number);
        let line = format!("{:width$} {hit:>6} {run:>6} {maybe:>6}  {}", cut(name, width), why(jobs));
        text += &format!("{}\n", cut(line.trim_end(), WIDTH));
    }
    text
}

/// The most frequent reason among the jobs that may run, and how many others there are.
fn why(jobs: &[&JobEntry]) -> String {
    let mut reasons: BTreeMap<&str, usize> = BTreeMap::new();
    for job in jobs.iter().filter(|job| job.outcome != Outcome::Hit) {
        *reasons.entry(&job.reason).or_default() += 1;
    }
    let Some((first, _)) = reasons.iter().max_by(|a, b| a.1.cmp(b.1).then(b.0.cmp(a.0))) else { return String::new() };
    let others = reasons.len() - 1;
    let more = if others == 0 { String::new() } else { format!("; {others} more (-v)") };
    escape(first) + &more
}

fn cut(text: &str, width: usize) -> String {
    if text.chars().count() <= width { text.to_owned() } else { text.chars().take(width - 1).chain(['…']).collect() }
}

fn job_lines(pipeline: &str, jobs: &[JobEntry]) -> String {
    let lines = jobs.iter().map(|job| format!("{:5}  {}  {}\n", job.outcome.word(), escape(&name(job)), escape(&job.reason)));
    headline(pipeline, jobs) + &lines.collect::<String>()
}

/// `stage[axis=value,…]`.
fn name(job: &JobEntry) -> String {
    place(&job.stage, &job.coordinate)
}

fn place(stage: &str, coordinate: &serde_json::Value) -> String {
    let axes = coordinate.as_object().into_iter().flatten();
    let text = |value: &serde_json::Value| value.as_str().map_or_else(|| value.to_string(), str::to_owned);
    let axes: Vec<String> = axes.map(|(axis, value)| format!("{axis}={}", text(value))).collect();
    if axes.is_empty() { stage.to_owned() } else { format!("{stage}[{}]", axes.join(",")) }
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
            if per_job { place(stage, coordinate) } else { stage.to_owned() }
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

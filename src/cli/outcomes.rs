//! What becomes of jobs and why, in few lines of at most 80 columns: the same for a plan and after a run.
//!
//! Jobs of a stage with the same outcome and reason share a line; where that is still too long to read, stages
//! with the same outcome and reason do.

use std::collections::{BTreeMap, BTreeSet};

use crate::engine::diagnostic::escape;
use crate::engine::manifest::{JobEntry, Outcome};

/// Columns of a terminal that is not asked for its width.
const WIDTH: usize = 80;

/// Longest name of a stage that is not cut.
const NAME_WIDTH: usize = 24;

/// More lines than this are gathered by reason.
const LINE_COUNT: usize = 40;

/// Jobs by outcome, in the order of the outcomes.
pub type Counts = BTreeMap<Outcome, usize>;

/// `13 hit, 2 run`.
pub fn counts_text(counts: &Counts) -> String {
    let texts: Vec<String> = counts.iter().map(|(outcome, count)| format!("{count} {}", outcome.word())).collect();
    texts.join(", ")
}

/// `1 job`, `2 jobs`.
pub fn counted(count: usize, thing: &str) -> String {
    if count == 1 { format!("1 {thing}") } else { format!("{count} {thing}s") }
}

/// All jobs, gathered as they come.
#[derive(Debug, Default)]
pub struct Outcomes {
    stages: Vec<Stage>,
    places: BTreeMap<String, usize>,
}

#[derive(Debug)]
struct Stage {
    name: String,
    total: usize,
    /// The values seen on each axis, in the order of the axes.
    axes: Vec<(String, BTreeSet<String>)>,
    /// Jobs by outcome and reason, in the order in which they came; without hits.
    groups: Vec<(Outcome, String, usize)>,
}

/// A line: the name (empty where it is that of the line above), how many jobs, over which axes, what and why.
struct Line {
    name: String,
    count: String,
    axes: String,
    outcome: Outcome,
    reason: String,
}

impl Outcomes {
    /// Takes a planned job in, with its place on each axis.
    pub fn add_planned(&mut self, job: &JobEntry) {
        self.add(&job.stage, job.outcome, &job.reason);
        let place = self.place_of(&job.stage);
        let axes = &mut self.stages[place].axes;
        for (axis, value) in job.coordinate.as_object().into_iter().flatten() {
            let known = axes.iter().position(|(name, _)| name == axis).unwrap_or_else(|| {
                axes.push((axis.clone(), BTreeSet::new()));
                axes.len() - 1
            });
            axes[known].1.insert(value.to_string());
        }
    }

    /// Number of a stage.
    fn place_of(&mut self, stage: &str) -> usize {
        if let Some(place) = self.places.get(stage) {
            return *place;
        }
        self.stages.push(Stage { name: stage.to_owned(), total: 0, axes: Vec::new(), groups: Vec::new() });
        self.places.insert(stage.to_owned(), self.stages.len() - 1);
        self.stages.len() - 1
    }

    /// Takes a job in.
    pub fn add(&mut self, stage: &str, outcome: Outcome, reason: &str) {
        let place = self.place_of(stage);
        let stage = &mut self.stages[place];
        stage.total += 1;
        if outcome == Outcome::Hit {
            return;
        }
        match stage.groups.iter_mut().find(|(other, text, _)| *other == outcome && text == reason) {
            Some((.., count)) => *count += 1,
            None => stage.groups.push((outcome, reason.to_owned(), 1)),
        }
    }

    /// The table; empty if every job is a hit.
    pub fn text(&self) -> String {
        let mut lines = self.lines();
        let is_long = lines.len() > LINE_COUNT;
        if is_long {
            lines = self.gathered();
        }
        if lines.is_empty() {
            return String::new();
        }
        let left_out = lines.len().saturating_sub(LINE_COUNT);
        let mut text = table(&lines[..lines.len() - left_out]);
        if left_out > 0 {
            let reasons = if left_out == 1 { "reason" } else { "reasons" };
            text += &format!("and {left_out} more {reasons}; -v shows every job\n");
        } else if is_long {
            text += "-v shows every job\n";
        }
        let idle: Vec<&str> = self.stages.iter().filter(|stage| stage.groups.is_empty()).map(|stage| stage.name.as_str()).collect();
        match idle.len() {
            0 => text,
            count => text + &cut(&format!("nothing to do for {}: {}", counted(count, "stage"), some(&idle, WIDTH - 36)), WIDTH) + "\n",
        }
    }

    /// One line per stage, outcome and reason.
    fn lines(&self) -> Vec<Line> {
        let lines = self.stages.iter().flat_map(|stage| {
            stage.groups.iter().enumerate().map(|(index, (outcome, reason, count))| Line {
                name: if index == 0 { cut(&stage.name, NAME_WIDTH) } else { String::new() },
                count: if *count == stage.total { count.to_string() } else { format!("{count} of {}", stage.total) },
                axes: if index == 0 { axes_text(&stage.axes) } else { String::new() },
                outcome: *outcome,
                reason: reason.clone(),
            })
        });
        lines.collect()
    }

    /// One line per outcome and reason, whatever the stage.
    fn gathered(&self) -> Vec<Line> {
        let mut groups: Vec<(Outcome, String, Vec<&str>, usize)> = Vec::new();
        let mut places: BTreeMap<(Outcome, String), usize> = BTreeMap::new();
        for stage in &self.stages {
            for (outcome, reason, count) in &stage.groups {
                // Each of a thousand stages waits for another one.
                let reason = if reason.starts_with("waits for ") { "waits for inputs" } else { reason };
                let place = *places.entry((*outcome, reason.to_owned())).or_insert(groups.len());
                if place == groups.len() {
                    groups.push((*outcome, reason.to_owned(), Vec::new(), 0));
                }
                groups[place].2.push(&stage.name);
                groups[place].3 += count;
            }
        }
        let line = |(outcome, reason, names, count): (Outcome, String, Vec<&str>, usize)| Line {
            name: some(&names, NAME_WIDTH),
            count: count.to_string(),
            axes: String::new(),
            outcome,
            reason,
        };
        groups.into_iter().map(line).collect()
    }
}

/// `9 n x 8 run`: how many values on each axis.
fn axes_text(axes: &[(String, BTreeSet<String>)]) -> String {
    let texts: Vec<String> = axes.iter().map(|(axis, values)| format!("{} {}", values.len(), escape(axis))).collect();
    texts.join(" x ")
}

/// Columns that reasons have at least, beside the axes.
const LEAST_WHY: usize = 26;

fn table(lines: &[Line]) -> String {
    let widest = |text: fn(&Line) -> &str| lines.iter().map(|line| text(line).chars().count()).max().unwrap_or(0);
    let names = widest(|line| &line.name).max("stage".len());
    let counts = widest(|line| &line.count).max("jobs".len());
    let outcomes = widest(|line| line.outcome.word());
    let axes = widest(|line| &line.axes).min(WIDTH - names - counts - outcomes - 7 - LEAST_WHY);
    let over = if axes > 0 { axes + 2 } else { 0 };
    let indent = names + counts + over + outcomes + 5;
    let heading = if axes > 0 { "axes" } else { "" };
    let mut text = format!("{:names$}  {:>counts$}  {heading:over$}{:outcomes$} why\n", "stage", "jobs", "");
    for line in lines {
        let reason = wrapped(&escape(&line.reason), WIDTH - indent);
        let axes = cut(&line.axes, axes);
        let first = format!("{:names$}  {:>counts$}  {axes:over$}{:outcomes$} {}", line.name, line.count, line.outcome.word(), reason[0]);
        text += &format!("{}\n", first.trim_end());
        text.extend(reason[1..].iter().map(|rest| format!("{:1$}{rest}\n", "", indent)));
    }
    text
}

/// A text in lines of a width, at spaces where there are some; at least one line, at most three.
fn wrapped(text: &str, width: usize) -> Vec<String> {
    let mut lines = vec![String::new()];
    for word in text.split(' ') {
        let last = lines.last_mut().expect("there is a line");
        if last.is_empty() {
            *last = word.to_owned();
        } else if last.chars().count() + 1 + word.chars().count() <= width {
            *last += &format!(" {word}");
        } else {
            lines.push(word.to_owned());
        }
    }
    if lines.len() > 3 {
        lines.truncate(3);
        lines[2] += " …";
    }
    lines.iter().map(|line| cut(line, width)).collect()
}

/// As many names as fit, and how many more there are.
pub fn some(names: &[&str], width: usize) -> String {
    let all = names.join(", ");
    if all.chars().count() <= width {
        return all;
    }
    let fitting = (1..names.len()).rev().map(|count| format!("{} and {} more", names[..count].join(", "), names.len() - count));
    fitting.into_iter().find(|text| text.chars().count() <= width).unwrap_or_else(|| cut(&all, width))
}

/// A text of at most that many characters.
pub fn cut(text: &str, width: usize) -> String {
    if text.chars().count() <= width { text.to_owned() } else { text.chars().take(width.saturating_sub(1)).chain(['…']).collect() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn jobs_with_one_reason_share_a_line() {
        let mut outcomes = Outcomes::default();
        outcomes.add("env", Outcome::Hit, "in the store");
        for gamma in 0..4 {
            let is_new = gamma % 2 == 1;
            outcomes.add("ldr", if is_new { Outcome::Run } else { Outcome::Hit }, "parameter gamma 2.2 -> 2.4");
        }
        outcomes.add("curve", Outcome::Maybe, "waits for ldr");
        let expected = "\
stage    jobs        why
ldr    2 of 4  run   parameter gamma 2.2 -> 2.4
curve       1  maybe waits for ldr
nothing to do for 1 stage: env
";
        assert_eq!(outcomes.text(), expected);
    }

    #[test]
    fn the_axes_of_a_sweep_stand_with_its_jobs() {
        let axes = |axes: &[(&str, usize)]| -> Vec<(String, BTreeSet<String>)> {
            axes.iter().map(|(name, count)| ((*name).to_owned(), (0..*count).map(|value| value.to_string()).collect())).collect()
        };
        let line = |name: &str, axes: String| Line {
            name: name.into(),
            count: "216".into(),
            axes,
            outcome: Outcome::Run,
            reason: "never ran".into(),
        };
        let some = axes_text(&axes(&[("n", 9), ("method", 3), ("run", 8)]));
        let text = table(&[line("sphere", some), line("env", String::new())]);
        let expected = "\
stage   jobs  axes                        why
sphere   216  9 n x 3 method x 8 run  run never ran
env      216                          run never ran
";
        assert_eq!(text, expected);
        let many = axes_text(&axes(&[("a-long-name-of-an-axis", 9); 9]));
        let long = table(&[line(&"s".repeat(NAME_WIDTH), many)]);
        assert!(long.lines().all(|line| line.chars().count() <= WIDTH) && long.contains("9 a-long"), "{long}");
    }

    #[test]
    fn two_thousand_stages_take_few_lines_of_eighty_columns() {
        let mut outcomes = Outcomes::default();
        for stage in 0..2000 {
            let why = if stage == 0 { "never ran".to_owned() } else { format!("waits for s{}", stage - 1) };
            outcomes.add(&format!("s{stage}"), if stage == 0 { Outcome::Run } else { Outcome::Maybe }, &why);
        }
        for stage in 0..100 {
            outcomes.add(
                &format!("t{stage}"),
                Outcome::Run,
                &format!("parameter a-very-long-name-of-a-field {stage} -> {}", "x".repeat(100)),
            );
        }
        let text = outcomes.text();
        assert!(text.lines().count() <= 3 * LINE_COUNT + 3, "{text}");
        assert!(text.lines().all(|line| line.chars().count() <= WIDTH), "{text}");
        assert!(text.contains("and 1990 more") || text.contains("more  "), "{text}");
        assert!(text.contains("more reasons; -v"), "{text}");
    }

    #[test]
    fn hostile_reasons_are_escaped() {
        let mut outcomes = Outcomes::default();
        outcomes.add("a", Outcome::Run, "parameter name x -> \u{1b}[2J\u{202e}");
        assert!(!outcomes.text().contains(['\u{1b}', '\u{202e}']));
    }
}

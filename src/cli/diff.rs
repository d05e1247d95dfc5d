//! `pipeline diff`: what differs between two runs, with errors of images and cells of tables.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;

use serde::Serialize;

use super::Ending;
use super::arguments::{DiffCommand, Format, PlaceArguments};
use super::outcomes::{counted, some};
use super::screen::{Screen, escaped_lines, json_text};
use super::signals::Interrupt;
use super::verify::no_run;
use crate::engine::artifact::AnyArtifact;
use crate::engine::digest::Digest;
use crate::engine::manifest::{JobEntry, coordinate_of, place_text};
use crate::engine::provenance::comparison::{Comparison, JobDifference, ResultDifference, compare};
use crate::engine::provenance::runs::{self, FoundRun};
use crate::engine::registry::Registry;
use crate::engine::save::published_path;
use crate::engine::stage::StageError;
use crate::engine::store::folder::FolderStore;
use crate::engine::store::library::Library;
use crate::engine::system::SystemError;
use crate::stages::difference::{Difference, difference, from_file, metric};
use crate::stages::registry;

/// Lines that are shown of each sort unless all are asked for.
const SHOWN: usize = 20;

/// A run with its store.
struct Side {
    run: FoundRun,
    library: Library,
    folder: Option<PathBuf>,
}

impl Side {
    fn new(run: FoundRun, places: &PlaceArguments) -> Result<Self, SystemError> {
        let outputs = run.outputs.clone().unwrap_or_default();
        let store = places.local.store.clone().unwrap_or_else(|| outputs.join(".store"));
        let folder = run.outputs.as_ref().map(|outputs| outputs.join(&run.manifest.pipeline));
        Ok(Self { library: places.places().library_over(FolderStore::at(store))?, folder, run })
    }

    /// A result, from the store or, where that has it no more, from an image that was published of it.
    fn artifact(&self, registry: &Registry, job: &JobEntry, result: &str, digest: Digest) -> Option<AnyArtifact> {
        let stored = || {
            let record = self.library.result(&job.key?).ok()?;
            let output = record.outputs.into_iter().find(|output| output.name == result && output.content.digest == digest)?;
            self.library.read_artifact(registry.artifacts().find(&output.type_name)?, &output.content).ok()
        };
        stored().or_else(|| self.published(job, result))
    }

    fn published(&self, job: &JobEntry, result: &str) -> Option<AnyArtifact> {
        let point = if result.is_empty() { "" } else { "." };
        let name = place_text(&format!("{}{point}{result}", job.stage), &job.coordinate);
        let entries = self.run.manifest.published.iter().filter(|entry| entry.job == name);
        entries.into_iter().find_map(|entry| {
            let bytes = fs::read(self.folder.as_ref()?.join(&entry.path)).ok()?;
            (Digest::of(&bytes) == entry.sha256).then(|| from_file(&bytes, &entry.path))?
        })
    }
}

/// How a result differs.
#[derive(Serialize)]
struct Shown {
    stage: String,
    coordinate: serde_json::Value,
    result: String,
    #[serde(flatten)]
    difference: Difference,
    /// The image of the differences.
    #[serde(skip_serializing_if = "Option::is_none")]
    written: Option<PathBuf>,
}

/// Shows what differs.
pub fn diff(command: &DiffCommand, screen: &Screen) -> Ending {
    let interrupt = Interrupt::listen();
    let mut metrics = Vec::new();
    for name in &command.metrics {
        match metric(name) {
            Ok(metric) => metrics.push(metric),
            Err(hint) => {
                screen.error(&format!("there is no metric `{name}`"), Some(&hint));
                return Ending::Refused;
            }
        }
    }
    let find = |name: &str| runs::find(name, &command.places.local.outputs);
    let (first, second) = match (find(&command.first), find(&command.second)) {
        (Ok(first), Ok(second)) => (first, second),
        (Err(error), _) | (_, Err(error)) => return no_run(&error, screen),
    };
    let (first, second) = match (Side::new(first, &command.places), Side::new(second, &command.places)) {
        (Ok(first), Ok(second)) => (first, second),
        (Err(error), _) | (_, Err(error)) => {
            screen.error(&error.to_string(), None);
            return Ending::System;
        }
    };
    let mut comparison = compare(&first.run.manifest, &second.run.manifest);
    if let Err(ending) = keep_only(&command.only, &mut comparison, [&first, &second], screen) {
        return ending;
    }

    let registry = registry();
    let mut shown = Vec::new();
    for job in &comparison.jobs {
        for result in &job.results {
            let check = || if interrupt.flag.load(Ordering::Relaxed) { Err(StageError::Interrupted) } else { Ok(()) };
            let difference = between(&registry, [&first, &second], job, result, |one, other| difference(one, other, &metrics, check));
            let (stage, coordinate, result) = (job.stage.clone(), job.coordinate.clone(), result.name.clone());
            let written = match write_image(command.images.as_deref(), &stage, &coordinate, &result, &difference) {
                Ok(written) => written,
                Err((path, error)) => {
                    screen.error(&format!("cannot write `{}`: {error}", path.display()), None);
                    return Ending::System;
                }
            };
            shown.push(Shown { stage, coordinate, result, difference, written });
        }
    }
    let printed = match command.format {
        Format::Json => screen.print(&json_text(&json_of([&first, &second], &comparison, &shown))),
        Format::Text if command.talk.quiet => Ending::Done,
        Format::Text => screen.print(&escaped_lines(&text_of([&first, &second], &comparison, &shown, command.talk.verbose))),
    };
    if comparison.is_equal() { printed } else { Ending::Differs }
}

/// Leaves what concerns the stages that were named.
fn keep_only(only: &[String], comparison: &mut Comparison, sides: [&Side; 2], screen: &Screen) -> Result<(), Ending> {
    if only.is_empty() {
        return Ok(());
    }
    let known = |stage: &String| sides.iter().any(|side| side.run.manifest.jobs.iter().any(|job| job.stage == *stage));
    if let Some(unknown) = only.iter().find(|stage| !known(stage)) {
        screen.error(&format!("neither run has a stage `{unknown}`"), None);
        return Err(Ending::Refused);
    }
    let is_meant = |place: &str| only.iter().any(|stage| place.split('[').next() == Some(stage));
    comparison.jobs.retain(|job| only.contains(&job.stage));
    comparison.only_first.retain(|place| is_meant(place));
    comparison.only_second.retain(|place| is_meant(place));
    let stages: BTreeMap<&str, &str> = sides
        .iter()
        .flat_map(|side| &side.run.manifest.published)
        .map(|entry| (entry.path.as_str(), entry.job.split(['[', '.']).next().unwrap_or_default()))
        .collect();
    comparison.files.retain(|file| stages.get(file.path.as_str()).is_some_and(|stage| only.iter().any(|only| only == stage)));
    Ok(())
}

fn between(
    registry: &Registry,
    [first, second]: [&Side; 2],
    job: &JobDifference,
    result: &ResultDifference,
    measure: impl FnOnce(&AnyArtifact, &AnyArtifact) -> Difference,
) -> Difference {
    let said = |summary: &str| Difference { summary: summary.to_owned(), ..Difference::default() };
    let (one, other) = match (result.first, result.second) {
        (Some(one), Some(other)) => (one, other),
        (Some(_), None) => return said("the second run gave none"),
        (None, _) => return said("the first run gave none"),
    };
    let artifact = |side: &Side, index: usize, digest| side.artifact(registry, &side.run.manifest.jobs[index], &result.name, digest);
    match (artifact(first, job.first, one), artifact(second, job.second, other)) {
        (Some(one), Some(other)) => measure(&one, &other),
        (None, _) => said("other content; the store no longer has that of the first run"),
        (_, None) => said("other content; the store no longer has that of the second run"),
    }
}

type WriteError = (PathBuf, std::io::Error);

fn write_image(
    folder: Option<&Path>,
    stage: &str,
    coordinate: &serde_json::Value,
    result: &str,
    difference: &Difference,
) -> Result<Option<PathBuf>, WriteError> {
    let (Some(folder), Some(bytes)) = (folder, &difference.image) else { return Ok(None) };
    let path = folder.join(published_path(stage, result, &coordinate_of(coordinate), "png"));
    let parent = path.parent().unwrap_or(folder);
    match fs::create_dir_all(parent).and_then(|()| fs::write(&path, bytes)) {
        Ok(()) => Ok(Some(path)),
        Err(error) => Err((path, error)),
    }
}

fn text_of([first, second]: [&Side; 2], comparison: &Comparison, shown: &[Shown], is_long: bool) -> String {
    let (first, second) = (&first.run.manifest, &second.run.manifest);
    let mut text = format!("first   {} {}\nsecond  {} {}\n", first.pipeline, first.run_id, second.pipeline, second.run_id);
    let limit = if is_long { usize::MAX } else { SHOWN };
    let mut section = |title: &str, lines: Vec<String>| {
        if lines.is_empty() {
            return;
        }
        text += &format!("\n{title}\n");
        text.extend(lines.iter().take(limit).map(|line| format!("  {line}\n")));
        if lines.len() > limit {
            text += &format!("  and {} more (-v)\n", lines.len() - limit);
        }
    };
    section("command line and program", comparison.settings.clone());
    section("asked differently", changed(&comparison.jobs));
    section("in the first run only", gathered(&comparison.only_first));
    section("in the second run only", gathered(&comparison.only_second));
    let jobs = comparison.jobs.iter().filter(|job| !job.results.is_empty()).count();
    let of_jobs = format!("of {jobs} of the {} in both runs", counted(comparison.common_jobs, "job"));
    let title = format!("results that differ: {}, {of_jobs}", comparison.result_count());
    section(&title, shown.iter().flat_map(result_lines).collect());
    let files = comparison.files.iter().map(|file| {
        let note = if file.first.is_none() {
            "  (second only)"
        } else if file.second.is_none() {
            "  (first only)"
        } else {
            ""
        };
        format!("{}{note}", file.path)
    });
    section(&format!("files that differ: {} of {}", comparison.files.len(), comparison.file_count), files.collect());
    if comparison.is_equal() {
        let what = format!("{} and {}", counted(comparison.common_jobs, "job"), counted(comparison.file_count, "file"));
        text += &format!("\nthe results are the same: {what}\n");
    }
    text
}

/// Changes of what was asked, jobs of a stage with the same changes in one line.
fn changed(jobs: &[JobDifference]) -> Vec<String> {
    let mut groups: Vec<(&str, &[String], usize)> = Vec::new();
    for job in jobs.iter().filter(|job| !job.changes.is_empty()) {
        match groups.iter_mut().find(|(stage, changes, _)| *stage == job.stage && *changes == job.changes) {
            Some((.., count)) => *count += 1,
            None => groups.push((&job.stage, &job.changes, 1)),
        }
    }
    let line = |(stage, changes, count): (&str, &[String], usize)| {
        let jobs = if count == 1 { String::new() } else { format!(" ({count} jobs)") };
        format!("{stage}{jobs}: {}", changes.join("; "))
    };
    groups.into_iter().map(line).collect()
}

/// Places by stage: `ldr[gamma=2.2]`, or `ldr: 4 jobs`.
fn gathered(places: &[String]) -> Vec<String> {
    let mut stages: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
    for place in places {
        stages.entry(place.split('[').next().unwrap_or_default()).or_default().push(place);
    }
    let line = |(stage, places): (&str, Vec<&str>)| {
        if places.len() == 1 { places[0].to_owned() } else { format!("{stage}: {}", some(&places, 60)) }
    };
    stages.into_iter().map(line).collect()
}

fn result_lines(shown: &Shown) -> Vec<String> {
    let point = if shown.result.is_empty() { "" } else { "." };
    let name = place_text(&format!("{}{point}{}", shown.stage, shown.result), &shown.coordinate);
    let mut lines = vec![format!("{name}: {}", shown.difference.summary)];
    lines.extend(
        shown.difference.cells.iter().map(|cell| format!("  row {}, {}: {} -> {}", cell.row, cell.column, cell.first, cell.second)),
    );
    lines.extend(shown.written.as_ref().map(|path| format!("  see {}", path.display())));
    lines
}

fn json_of([first, second]: [&Side; 2], comparison: &Comparison, shown: &[Shown]) -> serde_json::Value {
    let run = |side: &Side| {
        let manifest = &side.run.manifest;
        serde_json::json!({ "pipeline": manifest.pipeline, "run_id": manifest.run_id, "result_id": manifest.result_id })
    };
    serde_json::json!({
        "first": run(first),
        "second": run(second),
        "is_equal": comparison.is_equal(),
        "comparison": comparison,
        "differences": shown,
    })
}

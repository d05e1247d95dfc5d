//! `pipeline watch`: runs again whenever the pipeline file, an include or an input changes.
//!
//! Looks at stat signatures a few times a second: no watcher of the system sees every file system. While the
//! file has mistakes, it is read again instead, since what it would name is not known.

use std::collections::BTreeSet;
use std::fs;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::time::Duration;

use super::Ending;
use super::arguments::{PlanFormat, WatchCommand};
use super::run::{Manner, conclude, execute, refuse, with_report};
use super::screen::Screen;
use super::signals::Interrupt;
use crate::engine::diagnostic::{Diagnostic, escape, render};
use crate::engine::graph::Graph;
use crate::engine::manifest::Status;
use crate::engine::registry::Registry;
use crate::engine::run::ahead::Ahead;
use crate::engine::source::without_dots;
use crate::engine::sweep::build;
use crate::stages::registry;

/// Time between two looks at the files.
const GLANCE: Duration = Duration::from_millis(200);

/// Time between two readings of a file with mistakes.
const REREAD: Duration = Duration::from_millis(600);

/// Runs, waits, and runs again, until a signal ends it.
pub fn watch(command: &WatchCommand, screen: &Screen) -> Ending {
    let interrupt = Interrupt::listen();
    let registry = registry();
    let view = command.show.view.clone();
    let manner = Manner { machine: command.machine, keep_going: command.keep_going, talk: command.work.talk, view, team: None };
    loop {
        let (graph, warnings) = match built(command, &registry, screen) {
            Ok(built) => built,
            // Nothing is to be ended in good order while it waits: a signal ends the process.
            Err(errors) => {
                wait_for_other_mistakes(command, &registry, &errors);
                continue;
            }
        };
        if !command.work.talk.quiet {
            screen.show(&warnings, false);
        }
        let files = watched(&graph);
        let before = stamps(&files);
        let ahead = Ahead::begin(&command.work.places.places(), &graph.pipeline);
        match execute(graph, &command.work.request(), &registry, ahead, &manner, None, &interrupt, screen) {
            Ok(summary) if summary.status == Status::Interrupted => {
                return conclude(command.work.talk, PlanFormat::Text, &summary, &interrupt, screen);
            }
            Ok(summary) => {
                let talk = command.work.talk;
                let ending = conclude(talk, PlanFormat::Text, &summary, &interrupt, screen);
                if command.show.report {
                    with_report(ending, &summary, &command.work.places.places(), talk, &interrupt, screen);
                }
            }
            Err(error) => drop(refuse(&error, false, screen)),
        }
        interrupt.is_running.store(false, Ordering::Relaxed);
        if interrupt.flag.load(Ordering::Relaxed) {
            return interrupt.ending();
        }
        if !command.work.talk.quiet {
            screen.say(&format!("waiting for changes of {}; Ctrl-C ends\n", named(&files)));
        }
        wait_for_change(&files, &before);
    }
}

fn built(command: &WatchCommand, registry: &Registry, screen: &Screen) -> Result<(Graph, Vec<Diagnostic>), String> {
    build(registry, &command.work.request()).map_err(|errors| {
        screen.show(&errors, false);
        if !command.work.talk.quiet {
            screen.say("waiting for a repair; Ctrl-C ends\n");
        }
        render(&errors, false)
    })
}

/// Until there are no mistakes, or others.
fn wait_for_other_mistakes(command: &WatchCommand, registry: &Registry, known: &str) {
    loop {
        std::thread::sleep(REREAD);
        match build(registry, &command.work.request()) {
            Err(errors) if render(&errors, false) == known => {}
            _ => return,
        }
    }
}

/// The pipeline file, its includes, and every input of a wanted job.
fn watched(graph: &Graph) -> Vec<PathBuf> {
    let sources = graph.sources.iter().map(|source| graph.folder.join(&source.path));
    let inputs = graph.jobs.iter().filter(|job| job.is_wanted).flat_map(|job| job.files.iter().map(|(_, path)| path.clone()));
    let files: BTreeSet<PathBuf> = sources.chain(inputs).map(|path| without_dots(&path)).collect();
    files.into_iter().collect()
}

fn named(files: &[PathBuf]) -> String {
    match files {
        [file] => escape(&file.display().to_string()),
        _ => format!("{} files", files.len()),
    }
}

/// What the file system says of a file's identity and last change; `None` where there is none.
type Stamp = Option<(u64, u64, i64, i64, i64, i64)>;

fn stamps(files: &[PathBuf]) -> Vec<Stamp> {
    let stamp = |path: &PathBuf| {
        let status = fs::metadata(Path::new(path)).ok()?;
        Some((status.ino(), status.size(), status.mtime(), status.mtime_nsec(), status.ctime(), status.ctime_nsec()))
    };
    files.iter().map(stamp).collect()
}

/// Until a file is not as it was before the run, and no one is writing any more.
fn wait_for_change(files: &[PathBuf], before: &[Stamp]) {
    let mut last = stamps(files);
    while last == before {
        std::thread::sleep(GLANCE);
        last = stamps(files);
    }
    loop {
        std::thread::sleep(GLANCE);
        let now = stamps(files);
        if now == last {
            return;
        }
        last = now;
    }
}

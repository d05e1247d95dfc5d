//! `pipeline run`: plan, execute, publish, and tell.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::num::NonZeroUsize;

use super::Ending;
use super::arguments::{PlanFormat, RunCommand};
use super::machine::default_memory;
use super::progress::Progress;
use super::screen::{Screen, json_text};
use super::signals::Interrupt;
use crate::engine::diagnostic::escape;
use crate::engine::events::{Event, Failure, Listener};
use crate::engine::manifest::Status;
use crate::engine::run::{self, RunError, Summary};
use crate::engine::schedule::{Settings, panics};
use crate::engine::sweep::build;
use crate::stages::registry;

/// Runs a pipeline.
pub fn run(command: &RunCommand, screen: &Screen) -> Ending {
    let as_json = command.format == PlanFormat::Json;
    if matches!(command.format, PlanFormat::Dot | PlanFormat::Mermaid) {
        screen.error("`--format dot` and `--format mermaid` show a plan", Some("add -n, or use `pipeline plan`"));
        return Ending::Refused;
    }
    let interrupt = Interrupt::listen();
    let threads = command.threads();
    let settings = Settings { threads, memory: command.memory.unwrap_or_else(default_memory), keep_going: command.keep_going, start_pool };
    let request = command.pipeline.request(&command.targets);
    // Who wants to hear of every job is told of every job.
    if command.events.is_none() && !command.talk.verbose {
        match run::unchanged::run(&request, &command.places.places(), settings) {
            Ok(Some(summary)) => return conclude(command, &summary, &interrupt, screen),
            Ok(None) => {}
            Err(error) => return refuse(&error.into(), as_json, screen),
        }
    }
    let registry = registry();
    let (graph, warnings) = match build(&registry, &request) {
        Ok(built) => built,
        Err(errors) => {
            screen.show(&errors, as_json);
            return Ending::Refused;
        }
    };
    if !command.talk.quiet {
        screen.show(&warnings, false);
    }
    let events = match command.events.as_ref().map(File::create).transpose() {
        Ok(file) => file.map(BufWriter::new),
        Err(error) => {
            let path = command.events.as_ref().map(|path| path.display().to_string()).unwrap_or_default();
            screen.error(&format!("cannot write `{path}`: {error}"), None);
            return Ending::System;
        }
    };

    panics::hush();
    let progress = Progress::new(screen, command.talk, threads);
    let mut listener = Listeners { interrupt: interrupt.clone(), progress, events };
    let result = run::run(graph, &registry, &command.places.places(), settings, interrupt.flag.clone(), &mut listener);
    listener.progress.end();
    match result {
        Ok(summary) => conclude(command, &summary, &interrupt, screen),
        Err(error) => refuse(&error, as_json, screen),
    }
}

/// The pool in which the loops inside stages run.
fn start_pool(threads: NonZeroUsize) {
    // If a pool is there already, as in a test, it serves as well.
    let _ = rayon::ThreadPoolBuilder::new().num_threads(threads.get()).thread_name(|index| format!("pool-{index}")).build_global();
}

/// Why there was no run.
pub fn refuse(error: &RunError, as_json: bool, screen: &Screen) -> Ending {
    let (ending, messages) = match error {
        RunError::Inputs(errors) => (Ending::Refused, errors.iter().map(ToString::to_string).collect()),
        RunError::System(error) => (Ending::System, vec![error.to_string()]),
    };
    if as_json {
        let diagnostics: Vec<_> =
            messages.iter().map(|message| serde_json::json!({ "severity": "error", "message": escape(message) })).collect();
        screen.print(&json_text(&serde_json::json!({ "diagnostics": diagnostics })));
    } else {
        messages.iter().for_each(|message: &String| screen.error(message, None));
    }
    ending
}

fn conclude(command: &RunCommand, summary: &Summary, interrupt: &Interrupt, screen: &Screen) -> Ending {
    if !command.talk.quiet {
        summary.warnings.iter().for_each(|warning| screen.warning(&warning_text(&warning.stage, &warning.message)));
    }
    summary.failures.iter().for_each(|failure| screen.error(&failure_text(failure), failure.hint.as_deref()));
    if let Some(error) = &summary.system_error {
        screen.error(&error.to_string(), None);
    }
    if !command.talk.quiet {
        screen.say(&format!("{}\n", summary_text(summary)));
    }
    let text = if command.format == PlanFormat::Json {
        json_text(&summary_json(summary))
    } else {
        format!("{}\n", escape(&summary.manifest.display().to_string()))
    };
    let printed = screen.print(&text);
    let is_of_the_system = summary.system_error.is_some() || summary.failures.iter().any(|failure| failure.is_of_the_system);
    match summary.status {
        Status::Interrupted => interrupt.ending(),
        _ if is_of_the_system => Ending::System,
        Status::Failed => Ending::Failed,
        Status::Done => printed,
    }
}

fn warning_text(stage: &str, message: &str) -> String {
    if stage.is_empty() { message.to_owned() } else { format!("stage `{stage}`: {message}") }
}

fn failure_text(failure: &Failure) -> String {
    format!("{}: stage `{}`: {}", failure.place, failure.job, failure.message)
}

fn summary_text(summary: &Summary) -> String {
    let word = match summary.status {
        Status::Done => "done",
        Status::Failed => "failed",
        Status::Interrupted => "interrupted",
    };
    let measured = &summary.measured;
    let jobs: Vec<String> = measured.jobs.iter().map(|(outcome, count)| format!("{count} {outcome}")).collect();
    let total: u64 = measured.jobs.values().sum();
    let stands = summary.results_of.as_ref().map(|run| format!("; the results of {run} stand")).unwrap_or_default();
    let files = if measured.files_written == 1 { "file" } else { "files" };
    format!("{word}: {total} jobs ({}), {} {files} written, {:.2} s{stands}", jobs.join(", "), measured.files_written, measured.seconds)
}

fn summary_json(summary: &Summary) -> serde_json::Value {
    serde_json::json!({
        "run_id": summary.run_id,
        "result_id": summary.result_id,
        "status": summary.status,
        "results_of": summary.results_of,
        "manifest": summary.manifest,
        "failures": summary.failures,
        "warnings": summary.warnings,
        "measured": summary.measured,
    })
}

/// All that hear of events.
struct Listeners {
    interrupt: Interrupt,
    progress: Progress,
    events: Option<BufWriter<File>>,
}

impl Listener for Listeners {
    fn notify(&mut self, event: &Event) {
        if matches!(event, Event::Planned { .. }) {
            self.interrupt.is_running.store(true, std::sync::atomic::Ordering::Relaxed);
        }
        self.progress.notify(event);
        if let Some(events) = &mut self.events
            && write_event(events, event).is_err()
        {
            // A full disk does not stop a run for the sake of its log.
            self.events = None;
        }
    }
}

fn write_event(out: &mut impl Write, event: &Event) -> io::Result<()> {
    serde_json::to_writer(&mut *out, event)?;
    out.write_all(b"\n")?;
    out.flush()
}

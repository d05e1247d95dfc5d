//! `pipeline run`: plan, execute, publish, and tell.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::num::NonZeroUsize;

use super::Ending;
use super::arguments::{MachineArguments, PlanFormat, RunCommand, TalkArguments};
use super::progress::Progress;
use super::screen::{Screen, json_text};
use super::signals::Interrupt;
use super::team::Team;
use super::viewing::Viewer;
use crate::engine::diagnostic::escape;
use crate::engine::events::{Event, Failure, Listener};
use crate::engine::graph::Graph;
use crate::engine::manifest::Status;
use crate::engine::registry::Registry;
use crate::engine::request::Request;
use crate::engine::run::ahead::Ahead;
use crate::engine::run::{self, Places, RunError, Summary};
use crate::engine::schedule::{Settings, panics};
use crate::engine::sweep::build_beside;
use crate::stages::registry;

/// Runs a pipeline.
pub fn run(command: &RunCommand, screen: &Screen) -> Ending {
    if matches!(command.format, PlanFormat::Dot | PlanFormat::Mermaid) {
        screen.error("`--format dot` and `--format mermaid` show a plan", Some("add -n, or use `pipeline plan`"));
        return Ending::Refused;
    }
    let interrupt = Interrupt::listen();
    let team = match Team::of(&command.team, command.work.places.remote.store_remote.as_ref()) {
        Ok(team) => team,
        Err(error) => {
            screen.error(&error, None);
            return Ending::Refused;
        }
    };
    let (talk, view) = (command.work.talk, command.show.view.clone());
    let manner = Manner { machine: command.machine, keep_going: command.keep_going, talk, view, team };
    let (request, places) = (command.work.request(), command.work.places.places());
    let finish = |summary: &Summary| {
        let was_interrupted = interrupt.flag.load(std::sync::atomic::Ordering::Relaxed);
        if let Some(farewell) = manner.team.as_ref().filter(|_| was_interrupted).and_then(Team::farewell) {
            screen.say(&farewell);
        }
        let ending = conclude(manner.talk, command.format, summary, &interrupt, screen);
        if command.show.report {
            return with_report(ending, summary, &places, manner.talk, &interrupt, screen);
        }
        if !manner.talk.quiet {
            super::report::tell_if_outdated(summary, screen);
        }
        ending
    };
    // Who wants to hear of every job is told of every job.
    if command.events.is_none() && !manner.talk.verbose && manner.view.is_none() {
        match execute_from_memory(&request, &places, &manner, &interrupt, screen) {
            Ok(Some(summary)) => return finish(&summary),
            Ok(None) => {}
            Err(error) => return refuse(&error, command.format == PlanFormat::Json, screen),
        }
    }
    let registry = registry();
    let (graph, warnings, ahead) = match build_beside(&registry, &request, |pipeline| Ahead::begin(&places, pipeline)) {
        Ok(built) => built,
        Err(errors) => {
            screen.show(&errors, command.format == PlanFormat::Json);
            return Ending::Refused;
        }
    };
    if !command.work.talk.quiet {
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
    let result = execute(graph, &request, &registry, ahead, &manner, events, &interrupt, screen);
    match result {
        Ok(summary) => finish(&summary),
        Err(error) => refuse(&error, command.format == PlanFormat::Json, screen),
    }
}

/// Makes the page of a run that was not interrupted; the run's own ending counts, if it was not a good one.
pub fn with_report(
    ending: Ending,
    summary: &Summary,
    places: &Places,
    talk: TalkArguments,
    interrupt: &Interrupt,
    screen: &Screen,
) -> Ending {
    if summary.status == Status::Interrupted {
        return ending;
    }
    let made = super::report::after_run(&summary.manifest, places, talk, interrupt, screen);
    if ending == Ending::Done { made } else { ending }
}

/// How to run and how to tell of it.
pub struct Manner {
    /// Threads and memory.
    pub machine: MachineArguments,
    /// Whether jobs that do not depend on a failed one still run.
    pub keep_going: bool,
    /// How much to say.
    pub talk: TalkArguments,
    /// Where a viewer may listen.
    pub view: Option<String>,
    /// Who computes, where that is not this process.
    pub team: Option<Team>,
}

impl Manner {
    /// How much of the machine to take, and whether to go on after a failure.
    pub fn settings(&self) -> Settings {
        Settings { threads: self.machine.threads(), memory: self.machine.memory(), keep_going: self.keep_going, start_pool }
    }
}

/// What an earlier run is remembered for, if that is all there is to do.
fn execute_from_memory(
    request: &Request,
    places: &Places,
    manner: &Manner,
    interrupt: &Interrupt,
    screen: &Screen,
) -> Result<Option<Summary>, RunError> {
    let settings = manner.settings();
    let progress = Progress::new(screen, manner.talk, settings.threads);
    let mut listener = Listeners::new(interrupt, progress);
    let result = run::memory::run(request, places, settings, &interrupt.flag, &mut listener);
    listener.progress.end();
    Ok(result?)
}

/// Runs a graph with progress on the screen and events in a file.
#[expect(clippy::too_many_arguments, reason = "joins what a run is made of, once for each command that runs")]
pub fn execute(
    graph: Graph,
    request: &Request,
    registry: &Registry,
    ahead: Ahead,
    manner: &Manner,
    events: Option<BufWriter<File>>,
    interrupt: &Interrupt,
    screen: &Screen,
) -> Result<Summary, RunError> {
    panics::hush();
    let settings = manner.settings();
    let progress = Progress::new(screen, manner.talk, settings.threads);
    let viewer = manner.view.as_ref().and_then(|address| Viewer::connect(address, ahead.places().outputs.join(&graph.pipeline)));
    let mut listener = Listeners { interrupt: interrupt.clone(), progress, events, viewer };
    let hiring = manner.team.as_ref().map(|team| team.hiring(request, &manner.machine, manner.talk, screen));
    let result = run::run(graph, registry, ahead, settings, interrupt.flag.clone(), hiring, &mut listener);
    listener.progress.end();
    listener.viewer.into_iter().for_each(Viewer::end);
    result
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

/// Tells what a run came to.
pub fn conclude(talk: TalkArguments, format: PlanFormat, summary: &Summary, interrupt: &Interrupt, screen: &Screen) -> Ending {
    if !talk.quiet {
        summary.warnings.iter().for_each(|warning| screen.warning(&warning_text(&warning.stage, &warning.message)));
    }
    summary.failures.iter().for_each(|failure| screen.error(&failure_text(failure), failure.hint.as_deref()));
    if let Some(error) = &summary.system_error {
        screen.error(&error.to_string(), None);
    }
    if let Some(error) = &summary.no_workers {
        screen.error(&error.message, error.hint.as_deref());
    }
    if !talk.quiet {
        screen.say(&format!("{}\n", summary_text(summary)));
    }
    let text = if format == PlanFormat::Json {
        json_text(&summary_json(summary))
    } else {
        format!("{}\n", escape(&summary.manifest.display().to_string()))
    };
    let printed = screen.print(&text);
    let is_of_the_system =
        summary.system_error.is_some() || summary.no_workers.is_some() || summary.failures.iter().any(|failure| failure.is_of_the_system);
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

/// A failure in one line, without the word `error`.
pub fn failure_text(failure: &Failure) -> String {
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
pub struct Listeners {
    interrupt: Interrupt,
    progress: Progress,
    events: Option<BufWriter<File>>,
    viewer: Option<Viewer>,
}

impl Listeners {
    /// Progress alone.
    pub fn new(interrupt: &Interrupt, progress: Progress) -> Self {
        Self { interrupt: interrupt.clone(), progress, events: None, viewer: None }
    }

    /// Takes the progress away from the screen.
    pub fn end(&mut self) {
        self.progress.end();
    }
}

impl Listener for Listeners {
    fn notify(&mut self, event: &Event) {
        if matches!(event, Event::Planned { .. }) {
            self.interrupt.begun();
        }
        self.progress.notify(event);
        if let Some(viewer) = &mut self.viewer {
            viewer.notify(event);
        }
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

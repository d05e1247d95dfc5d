//! `pipeline verify`: makes a run again from nothing and compares every byte.

use std::path::PathBuf;

use super::Ending;
use super::arguments::{Format, VerifyCommand};
use super::outcomes::counted;
use super::run::{Manner, execute, failure_text, refuse};
use super::screen::{Screen, json_text};
use super::signals::Interrupt;
use crate::engine::manifest::{Manifest, Program, Status, place_text};
use crate::engine::provenance::runs::{self, FoundRun, LookupError};
use crate::engine::provenance::verification::{Scratch, Verdict, VerificationError, judge};
use crate::engine::run::Summary;
use crate::engine::run::ahead::Ahead;
use crate::engine::sweep::build_beside;
use crate::stages::registry;

/// Differences that are shown of each kind.
const SHOWN: usize = 20;

/// Makes a run again and compares.
pub fn verify(command: &VerifyCommand, screen: &Screen) -> Ending {
    let interrupt = Interrupt::listen();
    let run = match runs::find(&command.run, &command.places.outputs) {
        Ok(run) => run,
        Err(error) => return no_run(&error, screen),
    };
    let folders = if command.inputs.is_empty() { vec![PathBuf::from(".")] } else { command.inputs.clone() };
    let scratch = match Scratch::new(&run.manifest, &folders) {
        Ok(scratch) => scratch,
        Err(error) => return no_scratch(&error, screen),
    };
    let (again, summary) = match run_again(command, &run, &scratch, &interrupt, screen) {
        Ok(again) => again,
        Err(ending) => return ending,
    };
    let verdict = judge(&run.manifest, &again);
    if command.format == Format::Json {
        screen.print(&json_text(&verdict));
    } else {
        screen.print(&text_of(&verdict, &run.manifest));
    }
    summary.failures.iter().for_each(|failure| screen.error(&failure_text(failure), failure.hint.as_deref()));
    match () {
        () if summary.status == Status::Interrupted => interrupt.ending(),
        () if summary.system_error.is_some() || summary.failures.iter().any(|failure| failure.is_of_the_system) => Ending::System,
        () if !verdict.is_equal => Ending::Differs,
        () => Ending::Done,
    }
}

/// Says that there is no such run.
pub fn no_run(error: &LookupError, screen: &Screen) -> Ending {
    screen.error(&error.to_string(), error.hint());
    Ending::Refused
}

fn no_scratch(error: &VerificationError, screen: &Screen) -> Ending {
    match error {
        VerificationError::Inputs(messages) => {
            messages.iter().for_each(|message| screen.error(message, None));
            screen.say("hint: `--inputs DIR` names a folder with the input files\n");
            Ending::Refused
        }
        VerificationError::Manifest(message) => {
            screen.error(message, None);
            Ending::Refused
        }
        VerificationError::System(error) => {
            screen.error(&error.to_string(), None);
            Ending::System
        }
    }
}

fn run_again(
    command: &VerifyCommand,
    run: &FoundRun,
    scratch: &Scratch,
    interrupt: &Interrupt,
    screen: &Screen,
) -> Result<(Manifest, Summary), Ending> {
    let registry = registry();
    let places = scratch.places();
    let (graph, _, ahead) = build_beside(&registry, scratch.request(), |pipeline| Ahead::begin(&places, pipeline)).map_err(|errors| {
        screen.show(&errors, command.format == Format::Json);
        let this = Program::this();
        let recorded = &run.manifest.program.version;
        if *recorded != this.version {
            screen.error(&format!("the run was made by version {recorded} of the program, and this is {}", this.version), None);
        }
        Ending::Refused
    })?;
    // What failed in the recorded run may fail again; everything else is compared.
    let manner = Manner { machine: command.machine, keep_going: true, talk: command.talk, view: None, team: None };
    let summary = execute(graph, scratch.request(), &registry, ahead, &manner, None, interrupt, screen)
        .map_err(|error| refuse(&error, command.format == Format::Json, screen))?;
    match runs::read(&summary.manifest) {
        Ok(again) => Ok((again.manifest, summary)),
        Err(error) => {
            screen.error(&error.to_string(), None);
            Err(Ending::System)
        }
    }
}

fn text_of(verdict: &Verdict, recorded: &Manifest) -> String {
    let what = format!("{} and {}", counted(verdict.jobs, "job"), counted(verdict.files, "file"));
    if verdict.is_equal {
        let status = if recorded.status == Status::Done { "" } else { " (the run did not finish; what it has was compared)" };
        return format!("{}: {what} made again, the same bit for bit{status}\nresult_id {}\n", verdict.run_id, verdict.again);
    }
    let mut text = format!("{}: made again, {what}; not the same:\n", verdict.run_id);
    let jobs = verdict.differing_jobs.iter().map(|job| {
        let results: Vec<&str> =
            job.results.iter().map(|result| if result.name.is_empty() { "its result" } else { &result.name }).collect();
        let gone = job.results.iter().all(|result| result.second.is_none());
        let verb = if gone { "was not made" } else { "has other bytes" };
        let why = if job.changes.is_empty() { String::new() } else { format!(" ({})", job.changes.join("; ")) };
        format!("  {}: {} {verb}{why}\n", place_text(&job.stage, &job.coordinate), results.join(", "))
    });
    let missing = verdict.missing_jobs.iter().map(|job| format!("  {job}: the pipeline no longer has it\n"));
    let files = verdict.differing_files.iter().map(|file| {
        let verb = if file.second.is_none() { "was not made" } else { "has other bytes" };
        format!("  file {} {verb}\n", file.path)
    });
    for lines in [jobs.collect::<Vec<_>>(), missing.collect(), files.collect()] {
        text.extend(lines.iter().take(SHOWN).map(|line| super::screen::escaped_lines(line)));
        if lines.len() > SHOWN {
            text += &format!("  and {} more\n", lines.len() - SHOWN);
        }
    }
    text
}

//! Runs with workers: `pipeline run --executor`, `pipeline worker`, `status` and `cancel`.

use std::num::NonZeroUsize;
use std::sync::OnceLock;
use std::time::Instant;

use super::Ending;
use super::arguments::{CancelCommand, Format, MachineArguments, StatusCommand, TalkArguments, TeamArguments, WorkerCommand};
use super::progress::Progress;
use super::run::{Listeners, Manner, failure_text, refuse};
use super::screen::{Screen, escaped_lines, json_text};
use super::signals::Interrupt;
use crate::engine::diagnostic::escape;
use crate::engine::executor::profile::Profile;
use crate::engine::executor::{EXECUTORS, Executor, Row, THREADS, Terms};
use crate::engine::owner::host_name;
use crate::engine::request::Request;
use crate::engine::run::{self, Service};
use crate::engine::schedule::panics;
use crate::engine::shell;
use crate::engine::store::address::Address;
use crate::engine::sweep::build;
use crate::engine::system::temporary_name;
use crate::engine::team::folder::{Assignment, Ending as Order, RunFolder};
use crate::engine::team::hand::Hand;
use crate::engine::team::journal::Journal;
use crate::engine::team::overseer::Hiring;
use crate::engine::team::status::{self, State, Status, Worker};
use crate::stages::registry;

/// Who computes a run, and on which terms.
pub struct Team {
    row: &'static Row,
    limit: NonZeroUsize,
    profile: Profile,
    /// The id of the run, once it has one.
    run: OnceLock<String>,
}

impl Team {
    /// The workers that the command line asks for; none if this process is to compute.
    ///
    /// Workers see the store of the run and no other, so there is no remote one beside them.
    pub fn of(arguments: &TeamArguments, remote: Option<&Address>) -> Result<Option<Self>, String> {
        let Some(row) = EXECUTORS.iter().find(|row| row.name == arguments.executor) else {
            return match &arguments.profile {
                Some(_) => Err(format!("`--profile` is for workers, and `--executor {THREADS}` has none")),
                None => Ok(None),
            };
        };
        if let Some(remote) = remote {
            return Err(format!(
                "workers share the store of the run, and `--store-remote {remote}` is another: leave it out, with `pipeline store pull` before and \
                 `pipeline store push` after the run"
            ));
        }
        let profile = arguments.profile.as_deref().map(Profile::find).transpose().map_err(|error| error.to_string())?;
        Ok(Some(Self { row, limit: arguments.workers, profile: profile.unwrap_or_default(), run: OnceLock::new() }))
    }

    /// What the engine needs to have workers.
    pub fn hiring<'a>(&'a self, request: &'a Request, machine: &MachineArguments, talk: TalkArguments, screen: &'a Screen) -> Hiring<'a> {
        let (threads, memory) = (NonZeroUsize::new(machine.jobs), machine.memory);
        let executor = move |folder: &RunFolder| {
            folder.note_executor(self.row.name);
            self.executor(folder, threads, memory)
        };
        let tell = move |folder: &RunFolder| {
            let _ = self.run.set(folder.id().to_owned());
            if !talk.quiet {
                screen.say(&format!("run {}: `pipeline status {0}` and `pipeline cancel {0}`; {}\n", folder.id(), self.told(folder)));
            }
        };
        let outlives_driver = self.row.outlives_driver;
        Hiring { request, limit: self.limit, outlives_driver, executor: Box::new(executor), tell: Box::new(tell) }
    }

    /// What someone must know who interrupted the driver.
    pub fn farewell(&self) -> Option<String> {
        let run = self.run.get().filter(|_| self.row.outlives_driver)?;
        Some(format!("the workers of run {run} go on: the same command publishes what they compute, `pipeline cancel {run}` ends them\n"))
    }

    fn told(&self, folder: &RunFolder) -> String {
        match self.row.name {
            "manual" => format!("start workers with\n  pipeline worker --run {}", shell::word(&folder.path().display().to_string())),
            _ => format!("logs in {}", escape(&folder.workers().display().to_string())),
        }
    }

    fn executor(&self, folder: &RunFolder, threads: Option<NonZeroUsize>, memory: Option<u64>) -> Box<dyn Executor> {
        let program = std::env::current_exe().unwrap_or_else(|_| "pipeline".into());
        (self.row.make)(Terms { folder: folder.clone(), program, threads, memory, count: self.limit, profile: self.profile.clone() })
    }
}

/// Computes jobs of a run until there are no more.
pub fn worker(command: &WorkerCommand, screen: &Screen) -> Ending {
    let interrupt = Interrupt::listen_as_worker();
    let refused = |message: String, hint: Option<&str>| {
        screen.error(&message, hint);
        Ending::Refused
    };
    let (folder, assignment) = match RunFolder::find(&command.run.to_string_lossy(), ".".as_ref()).and_then(|folder| {
        let assignment = folder.assignment()?;
        Ok((folder, assignment))
    }) {
        Ok(found) => found,
        Err(error) => return refused(error.to_string(), Some("`pipeline run FILE --executor manual` makes such a folder and names it")),
    };
    if let Err(error) = std::env::set_current_dir(assignment.folder()) {
        let message = format!("cannot enter `{}`, from where the run was begun: {error}", assignment.folder().display());
        return refused(message, Some("the folder of the pipeline must be at the same place on every machine"));
    }
    let given = match command.class.map(|class| assignment.classes.get(class).copied().ok_or(class)).transpose() {
        Ok(given) => given,
        Err(class) => return refused(format!("the run has no class {class} of workers: it has {}", assignment.classes.len()), None),
    };
    let name = command.name.clone().unwrap_or_else(|| format!("{}-{}", host_name(), temporary_name()));
    if !is_file_name(&name) {
        return refused("a worker's name has letters, digits, `.`, `_` and `-`".into(), None);
    }
    let threads = command.machine.threads();
    let journal = match Journal::begin(&folder.workers(), &name, threads.get(), command.class) {
        Ok(journal) => journal,
        Err(error) => {
            screen.error(&error.to_string(), None);
            return Ending::System;
        }
    };
    if !command.talk.quiet {
        screen.say(&format!("worker {name} on {} with {threads} threads: run {} of {}\n", host_name(), folder.id(), assignment.pipeline));
    }
    let mut hand = Hand::new(folder, journal, given, interrupt.flag.clone());
    hand.leaving = interrupt.leaving.clone();
    hand.leaves_at = command.stop_after.map(|time| Instant::now() + time);
    serve(command, &assignment, hand, &interrupt, screen)
}

fn is_file_name(name: &str) -> bool {
    let is_safe = |byte: u8| byte.is_ascii_alphanumeric() || b"._-".contains(&byte);
    (1..=200).contains(&name.len()) && !name.starts_with('.') && name.bytes().all(is_safe)
}

fn serve(command: &WorkerCommand, assignment: &Assignment, hand: Hand, interrupt: &Interrupt, screen: &Screen) -> Ending {
    panics::hush();
    let registry = registry();
    let graph = match build(&registry, &assignment.request()) {
        Ok((graph, _)) => graph,
        Err(errors) => {
            screen.show(&errors, false);
            return Ending::Refused;
        }
    };
    let manner = Manner { machine: command.machine, keep_going: assignment.keep_going, talk: command.talk, view: None, team: None };
    let settings = manner.settings();
    let mut listener = Listeners::new(interrupt, Progress::new(screen, command.talk, settings.threads));
    let served = run::work(graph, &registry, assignment, settings, hand, &mut listener);
    listener.end();
    match served {
        Ok(Some(service)) => conclude(&service, command.talk, interrupt, screen),
        Ok(None) => {
            let hint = "an input file has changed or is another one on this machine; `pipeline run` begins a run of what is there now";
            screen.error("the plan of the run is another one here", Some(hint));
            Ending::Refused
        }
        Err(error) => refuse(&error, false, screen),
    }
}

fn conclude(service: &Service, talk: TalkArguments, interrupt: &Interrupt, screen: &Screen) -> Ending {
    service.failures.iter().for_each(|failure| screen.error(&failure_text(failure), failure.hint.as_deref()));
    if let Some(error) = &service.system_error {
        screen.error(&error.to_string(), None);
    }
    if !talk.quiet {
        let jobs: Vec<String> = service.jobs.iter().map(|(outcome, count)| format!("{count} {outcome}")).collect();
        screen.say(&format!("worker ended: {}\n", jobs.join(", ")));
    }
    match () {
        () if service.was_interrupted => interrupt.ending(),
        () if service.system_error.is_some() || service.failures.iter().any(|failure| failure.is_of_the_system) => Ending::System,
        () if !service.failures.is_empty() => Ending::Failed,
        () => Ending::Done,
    }
}

/// Shows how far a run is.
pub fn status(command: &StatusCommand, screen: &Screen) -> Ending {
    match RunFolder::find(&command.named.run, &command.named.outputs).and_then(|folder| status::status(&folder)) {
        Ok(status) => match command.format {
            Format::Json => screen.print(&json_text(&status)),
            Format::Text => screen.print(&escaped_lines(&status_text(&status))),
        },
        Err(error) => {
            screen.error(&error.to_string(), Some("`--outputs` names the folder of outputs; runs without workers have no status"));
            Ending::Refused
        }
    }
}

fn status_text(status: &Status) -> String {
    let jobs = &status.jobs;
    let state = match (status.ending, status.has_driver) {
        (Some(Order::Now), _) => "cancelled",
        (Some(Order::Finish), _) => "over",
        (None, true) => "going on",
        (None, false) => "without a driver: `pipeline run` publishes what is computed",
    };
    let mut text = format!("run {} of {}: {state}\n", status.run, status.pipeline);
    text += &format!(
        "{} jobs: {} known before, {} computed, {} running, {} failed, {} waiting; {:.0} jobs a minute\n",
        jobs.all, jobs.known, jobs.computed, jobs.running, jobs.failed, jobs.waiting, status.rate
    );
    status.workers.iter().for_each(|worker| text += &worker_text(worker));
    text + &format!("folder {}\n", status.folder)
}

fn worker_text(worker: &Worker) -> String {
    let state = match (worker.state, &worker.why) {
        (State::Working, _) => format!("at work, heard {:.0} s ago", worker.heard),
        (State::Ended, Some(why)) => format!("ended: {why}"),
        (State::Ended, None) => "ended".to_owned(),
        (State::Lost, _) => "lost".to_owned(),
    };
    let running = if worker.running.is_empty() { String::new() } else { format!("; runs {}", worker.running.join(", ")) };
    format!("  {} on {}, {} threads: {state}, {} computed{running}\n", worker.name, worker.host, worker.threads, worker.computed)
}

/// Ends a run and its workers.
pub fn cancel(command: &CancelCommand, screen: &Screen) -> Ending {
    let folder = match RunFolder::find(&command.named.run, &command.named.outputs) {
        Ok(folder) => folder,
        Err(error) => {
            screen.error(&error.to_string(), None);
            return Ending::Refused;
        }
    };
    if let Err(error) = folder.order_end(Order::Now) {
        screen.error(&error.to_string(), None);
        return Ending::System;
    }
    let mut ending = Ending::Done;
    for row in EXECUTORS.iter().filter(|row| folder.has_executor(row.name)) {
        let team = Team { row, limit: NonZeroUsize::MIN, profile: Profile::default(), run: OnceLock::new() };
        if let Err(error) = team.executor(&folder, None, None).cancel() {
            screen.error(&error.message, error.hint.as_deref());
            ending = Ending::System;
        }
    }
    screen.say(&format!("run {} is cancelled; what is done stays in the store\n", folder.id()));
    ending
}

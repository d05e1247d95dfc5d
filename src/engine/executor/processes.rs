//! Worker processes on this machine.

use std::fs::File;
use std::os::unix::process::CommandExt;
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, kill_process};

use super::{Class, Executor, ExecutorError, Present, Row, Terms, worker_arguments};
use crate::engine::owner::Owner;
use crate::engine::system::temporary_name;
use crate::engine::team::journal::{Journals, Said};

/// See [`super::EXECUTORS`].
pub const ROW: Row = Row {
    name: "processes",
    about: "worker processes on this machine",
    outlives_driver: false,
    make: |terms| Box::new(Processes::new(terms)),
};

/// So long workers may take to end by themselves when the run is over.
const FAREWELL: Duration = Duration::from_secs(2);

struct Processes {
    terms: Terms,
    /// Those that this process started.
    children: Vec<(Present, Child)>,
    journals: Journals,
    /// Those that a driver before this one started.
    strangers: Vec<(Present, Owner)>,
}

impl Processes {
    fn new(terms: Terms) -> Self {
        let journals = Journals::in_folder(terms.folder.workers());
        Self { terms, children: Vec::new(), journals, strangers: Vec::new() }
    }

    fn command(&self, class: &Class, name: &str) -> std::io::Result<Command> {
        let log = File::options().create(true).append(true).open(self.log_of(name))?;
        let processors = std::thread::available_parallelism().map_or(1, usize::from);
        let share = (processors / self.terms.count.get()).max(1);
        let threads = class.resources.threads.or(self.terms.threads).map_or(share, usize::from);
        let mut command = Command::new(&self.terms.program);
        command.args(worker_arguments(&self.terms, class)).args(["--name", name, "--jobs", &threads.to_string()]);
        if let Some(memory) = class.resources.memory.or(self.terms.memory) {
            command.args(["--memory", &memory.to_string()]);
        }
        command.stdin(Stdio::null()).stdout(log.try_clone()?).stderr(log);
        // An interrupt of the terminal is for the driver, which tells its workers.
        command.process_group(0);
        Ok(command)
    }

    fn look_for_strangers(&mut self) {
        for (name, said) in self.journals.news() {
            if let Said::Began { owner, class, .. } = said
                && let Some((owner, _)) = Owner::parse(&owner)
                && owner.is_in_sight()
                && !self.children.iter().any(|(present, _)| present.name == name)
            {
                self.strangers.push((Present { name, class, waits_for: None }, owner));
            }
        }
        self.strangers.retain(|(_, owner)| owner.is_alive());
    }

    fn signal(&mut self, signal: Signal) {
        let own = self.children.iter().map(|(_, child)| child.id());
        let others = self.strangers.iter().filter(|(_, owner)| owner.is_alive()).map(|(_, owner)| owner.process());
        for process in own.chain(others).filter_map(|process| Pid::from_raw(process as i32)) {
            let _ = kill_process(process, signal);
        }
    }
}

impl Executor for Processes {
    fn start(&mut self, class: &Class, count: usize) -> Result<(), ExecutorError> {
        for _ in 0..count {
            let name = format!("process-{}", temporary_name());
            let child = self.command(class, &name).and_then(|mut command| command.spawn()).map_err(|error| ExecutorError {
                message: format!("cannot start `{}`: {error}", self.terms.program.display()),
                hint: None,
            })?;
            self.children.push((Present { name, class: Some(class.number), waits_for: None }, child));
        }
        Ok(())
    }

    fn present(&mut self) -> Option<Vec<Present>> {
        self.children.retain_mut(|(_, child)| matches!(child.try_wait(), Ok(None)));
        self.look_for_strangers();
        let own = self.children.iter().map(|(present, _)| present.clone());
        Some(own.chain(self.strangers.iter().map(|(present, _)| present.clone())).collect())
    }

    fn cancel(&mut self) -> Result<(), ExecutorError> {
        self.look_for_strangers();
        self.signal(Signal::TERM);
        self.dismiss();
        self.signal(Signal::KILL);
        self.children.iter_mut().for_each(|(_, child)| drop(child.wait()));
        Ok(())
    }

    /// They have been told, and end with what they are about; that may take longer than is waited for here.
    fn dismiss(&mut self) {
        let begun = Instant::now();
        while begun.elapsed() < FAREWELL && self.present().is_some_and(|present| !present.is_empty()) {
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    fn interval(&self) -> Duration {
        Duration::from_millis(100)
    }

    fn log_of(&self, name: &str) -> PathBuf {
        self.terms.folder.workers().join(format!("{name}.log"))
    }
}

//! What starts the workers of a run: processes of this machine, Slurm, or a person.
//!
//! An executor supplies processes and knows nothing of jobs. What it says of them is a hint: that a job is done, the store says.
//! A new one is a file here and a row in [`EXECUTORS`].

mod manual;
mod processes;
pub mod profile;
mod slurm;

use std::num::NonZeroUsize;
use std::path::PathBuf;
use std::time::Duration;

use super::diagnostic::listed;
use super::resources::Resources;
use super::source::did_you_mean;
use super::team::folder::RunFolder;
use crate::catalogue::nearest;
use profile::Profile;

/// One row of the table.
pub struct Row {
    /// Its name on the command line.
    pub name: &'static str,
    /// What it does, for people.
    pub about: &'static str,
    /// Whether its workers go on when the driver is interrupted.
    pub outlives_driver: bool,
    /// Makes one.
    pub make: fn(Terms) -> Box<dyn Executor>,
}

/// All of them.
pub const EXECUTORS: [Row; 3] = [processes::ROW, slurm::ROW, manual::ROW];

/// The name that means no workers: threads of the process itself.
pub const THREADS: &str = "threads";

/// The name of an executor, or of none; the error says what there is.
pub fn checked_name(text: &str) -> Result<String, String> {
    let names: Vec<&str> = std::iter::once(THREADS).chain(EXECUTORS.iter().map(|row| row.name)).collect();
    if names.contains(&text) {
        return Ok(text.to_owned());
    }
    let near = did_you_mean(nearest(text, names.iter().copied())).map(|hint| format!("{hint} ")).unwrap_or_default();
    let known: Vec<String> = names.iter().map(|name| format!("`{name}`")).collect();
    Err(format!("{near}they are {}", listed(&known, "and")))
}

/// What every worker of a run is given.
#[derive(Debug, Clone)]
pub struct Terms {
    /// The run.
    pub folder: RunFolder,
    /// The program that it runs.
    pub program: PathBuf,
    /// Threads of a worker, unless its class says otherwise.
    pub threads: Option<NonZeroUsize>,
    /// Memory of a worker in bytes, likewise.
    pub memory: Option<u64>,
    /// How many there will be of a class at most.
    pub count: NonZeroUsize,
    /// What a site asks for.
    pub profile: Profile,
}

/// A class of workers.
#[derive(Debug, Clone, Copy)]
pub struct Class {
    /// Its number in the run.
    pub number: usize,
    /// What its workers are given.
    pub resources: Resources,
}

/// A worker that is there, or will be.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Present {
    /// The name under which it writes its journal.
    pub name: String,
    /// Its class; none for one that takes any job.
    pub class: Option<usize>,
    /// Why it has not begun yet, in the words of whoever is to start it.
    pub waits_for: Option<String>,
}

/// Why workers cannot be started or ended.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{message}")]
pub struct ExecutorError {
    /// What is wrong.
    pub message: String,
    /// What to do.
    pub hint: Option<String>,
}

/// Starts workers, looks for them and ends them.
pub trait Executor: Send {
    /// Starts so many more workers of a class.
    fn start(&mut self, class: &Class, count: usize) -> Result<(), ExecutorError>;

    /// The workers of the run, whoever started them; `None` if that cannot be said now.
    fn present(&mut self) -> Option<Vec<Present>>;

    /// Ends all workers of the run at once.
    fn cancel(&mut self) -> Result<(), ExecutorError>;

    /// The run is over: ends those that would find nothing to do.
    fn dismiss(&mut self);

    /// Time between two looks.
    fn interval(&self) -> Duration;

    /// Where a worker's log is, for a message.
    fn log_of(&self, name: &str) -> PathBuf;
}

/// The words of the command of a worker after the program's name.
fn worker_arguments(terms: &Terms, class: &Class) -> Vec<String> {
    let mut words = vec!["worker".to_owned(), "--run".to_owned(), terms.folder.path().display().to_string()];
    words.extend(["--class".to_owned(), class.number.to_string()]);
    words
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_executor_has_a_name_of_its_own_and_says_what_it_does() {
        let mut names: Vec<&str> = EXECUTORS.iter().map(|row| row.name).collect();
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), EXECUTORS.len());
        assert!(EXECUTORS.iter().all(|row| row.about.len() > 10 && row.name != THREADS));
    }
}

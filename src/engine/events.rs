//! What a run says while it goes on. Events only go out: no listener can change a run.

use std::sync::Arc;
use std::sync::atomic::AtomicU32;

use serde::Serialize;

use super::manifest::{Outcome, Status};

/// Something that happened.
#[derive(Debug, Clone, Serialize)]
#[serde(tag = "event", rename_all = "kebab-case")]
pub enum Event {
    /// The plan is made.
    Planned {
        /// Wanted jobs.
        jobs: usize,
        /// Those whose result is in the store.
        hits: usize,
    },
    /// Nothing is computed, but published files of an earlier run are put back.
    Restoring {
        /// Their number.
        files: usize,
        /// How far it is, in thousandths.
        #[serde(skip)]
        progress: Arc<AtomicU32>,
    },
    /// A job begins.
    Started {
        /// `stage[axis=value,…]`.
        job: String,
        /// Why it runs.
        reason: String,
        /// How far it is, in thousandths.
        #[serde(skip)]
        progress: Arc<AtomicU32>,
    },
    /// A job is left to another run, which computes it already.
    Elsewhere {
        /// `stage[axis=value,…]`.
        job: String,
        /// The other run's process.
        owner: String,
    },
    /// No worker is at work, and those that were asked for are not started yet.
    Waiting {
        /// How many there are.
        workers: usize,
        /// Why, in the words of the scheduler.
        reason: String,
    },
    /// A job has its result, or will not have one.
    Finished {
        /// `stage[axis=value,…]`.
        job: String,
        /// What became of it.
        outcome: Outcome,
        /// Why.
        reason: String,
        /// How long it took, if it ran.
        seconds: f64,
        /// Jobs finished so far, this one included.
        done: usize,
        /// Wanted jobs.
        total: usize,
        /// Whether it is a part of another job, which is told of when it is whole.
        is_part: bool,
        /// Why it failed, and where its stage stands (`file:line`).
        #[serde(skip_serializing_if = "Option::is_none")]
        error: Option<Failure>,
    },
    /// A file appeared or was replaced.
    Published {
        /// Path below the pipeline's folder of outputs.
        path: String,
    },
    /// Something that the reader of the results must know.
    Warning {
        /// Name of the stage; empty where none is to blame.
        stage: String,
        /// The text.
        message: String,
    },
    /// The run is over and its manifest is written.
    Ended {
        /// Name of the run.
        run_id: String,
        /// How it ended.
        status: Status,
        /// How long it took.
        seconds: f64,
    },
}

/// Why a job failed.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Failure {
    /// `file:line` of the stage.
    pub place: String,
    /// `stage[axis=value,…]`.
    pub job: String,
    /// What is wrong.
    pub message: String,
    /// What to do, if it can be said.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub hint: Option<String>,
    /// Whether the operating system failed, and not the job.
    pub is_of_the_system: bool,
}

/// Hears of events, on the thread that owns the run's state.
pub trait Listener {
    /// Takes an event in; must be quick.
    fn notify(&mut self, event: &Event);
}

/// Hears nothing.
pub struct Silence;

impl Listener for Silence {
    fn notify(&mut self, _event: &Event) {}
}

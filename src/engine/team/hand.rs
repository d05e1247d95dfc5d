//! A worker's own state: what it may take, when it is to leave, and where it says what it does.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use super::folder::{Ending, FailureNote, RunFolder};
use super::journal::{Journal, Said};
use crate::engine::digest::Digest;
use crate::engine::events::Failure;
use crate::engine::owner::host_name;
use crate::engine::resources::Resources;

/// Time between two looks whether the run is to end.
const LOOK: Duration = Duration::from_millis(500);

/// One worker of a run.
pub struct Hand {
    /// The run.
    pub folder: RunFolder,
    /// Where it says what it does.
    pub journal: Journal,
    /// What it was given; none if it takes any job.
    pub given: Option<Resources>,
    /// Set when it is to begin no more jobs.
    pub leaving: Arc<AtomicBool>,
    /// When it is to begin no more jobs.
    pub leaves_at: Option<Instant>,
    /// Set when it is to give up what it does.
    pub interrupted: Arc<AtomicBool>,
    looked: Option<Instant>,
}

impl Hand {
    /// A worker that has begun nothing.
    pub fn new(folder: RunFolder, journal: Journal, given: Option<Resources>, interrupted: Arc<AtomicBool>) -> Self {
        Self { folder, journal, given, leaving: Arc::default(), leaves_at: None, interrupted, looked: None }
    }

    /// Whether it may take a job that asks for this.
    pub fn takes(&self, asked: &Resources) -> bool {
        self.given.is_none_or(|given| given.suffice_for(asked))
    }

    /// Whether it is to begin no more jobs.
    pub fn is_leaving(&self) -> bool {
        self.leaving.load(Ordering::Relaxed)
    }

    /// To be called often: looks whether the run is to end or the time is over, and says that this worker is there.
    pub fn tend(&mut self) {
        self.journal.keep_alive();
        if self.leaves_at.is_some_and(|moment| Instant::now() >= moment) {
            self.leaving.store(true, Ordering::Relaxed);
        }
        if self.looked.is_some_and(|moment| moment.elapsed() < LOOK) {
            return;
        }
        self.looked = Some(Instant::now());
        match self.folder.ordered_end() {
            Some(Ending::Now) => self.interrupted.store(true, Ordering::Relaxed),
            Some(Ending::Finish) => self.leaving.store(true, Ordering::Relaxed),
            None => {}
        }
    }

    /// Says why a job failed. If that cannot be said, the driver finds it undone and has another worker try.
    pub fn note_failure(&self, key: Digest, failure: &Failure) {
        let _ = self.folder.note_failure(&FailureNote::new(key, failure, &host_name()));
    }

    /// Says that a job gave nothing.
    pub fn give_up(&mut self, key: Option<Digest>) {
        if let Some(key) = key {
            self.journal.say(&Said::GaveUp { key });
        }
    }
}

impl Drop for Hand {
    fn drop(&mut self) {
        let why = match () {
            () if self.interrupted.load(Ordering::Relaxed) => "told to stop",
            () if self.is_leaving() => "told to begin no more jobs",
            () => "nothing left to do",
        };
        self.journal.say(&Said::Ended { why: why.into() });
    }
}

//! Sees to it that a run has as many workers as there is work for.
//!
//! A thread of its own, since what starts workers may take its time. It looks at the workers that are there, starts what is
//! missing, and stops asking when they come to nothing again and again. Of several drivers of a run one does this.

use std::collections::BTreeMap;
use std::num::NonZeroUsize;
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use super::folder::{Ending, RunFolder};
use crate::engine::digest::Digest;
use crate::engine::executor::{Class, Executor, ExecutorError, Present};
use crate::engine::resources::Resources;
use crate::engine::store::claims::{Claim, Claims};

/// So often workers are started while no job gets done.
const PATIENCE: usize = 5;

/// So long it is seen whether workers are missing at all.
const MOMENT: Duration = Duration::from_secs(1);

/// So long after its start a worker must have been heard of.
const DUMB: Duration = Duration::from_secs(120);

/// Time between two looks at what is wanted.
const TICK: Duration = Duration::from_millis(20);

/// What the driver and the thread tell each other.
#[derive(Debug, Default)]
struct Board {
    /// Workers that there would be work for, by class.
    demand: Vec<usize>,
    /// Jobs that are done.
    done: usize,
    /// Workers that have been heard of and have not ended, and whether lately.
    heard: BTreeMap<String, bool>,
    present: Vec<Present>,
    problem: Option<ExecutorError>,
    is_over: bool,
    /// How the workers are to be left.
    farewell: Farewell,
}

/// What becomes of the workers at the end.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Farewell {
    /// They go on.
    #[default]
    Leave,
    /// They end by themselves, or would find nothing to do.
    Dismiss,
    /// They are ended.
    Cancel,
}

/// The workers of a run, as its driver sees them.
pub struct Crew {
    board: Arc<Mutex<Board>>,
    thread: Option<JoinHandle<()>>,
}

const NO_PANIC: &str = "no one panics while holding the board";

impl Crew {
    /// Begins to look after workers, at most `limit` of each class. `first` is the claim on that, if this driver has it.
    pub fn begin(
        folder: &RunFolder,
        executor: Box<dyn Executor>,
        classes: &[Resources],
        limit: NonZeroUsize,
        first: Option<Claim>,
    ) -> Self {
        let board: Arc<Mutex<Board>> = Arc::default();
        board.lock().expect(NO_PANIC).demand = vec![0; classes.len()];
        let classes = classes.iter().enumerate().map(|(number, resources)| Class { number, resources: *resources }).collect();
        let mut foreman = Foreman {
            board: board.clone(),
            executor,
            classes,
            limit: limit.get(),
            drivers: folder.drivers(),
            folder: folder.clone(),
            claim: first,
            looked: None,
            begun: BTreeMap::new(),
            fruitless: 0,
            done_before: 0,
        };
        let thread = std::thread::Builder::new().name("crew".into()).spawn(move || foreman.work());
        Self { board, thread: Some(thread.expect("the system gives a thread")) }
    }

    /// Says how much there is to do.
    pub fn want(&self, demand: Vec<usize>, done: usize, heard: BTreeMap<String, bool>) {
        let mut board = self.board.lock().expect(NO_PANIC);
        (board.demand, board.done, board.heard) = (demand, done, heard);
    }

    /// How many workers there are and why the first of them has not begun, if none has.
    pub fn waiting(&self) -> Option<(usize, String)> {
        let board = self.board.lock().expect(NO_PANIC);
        let reasons: Option<Vec<&String>> = board.present.iter().map(|worker| worker.waits_for.as_ref()).collect();
        let reasons = reasons?;
        Some((reasons.len(), (*reasons.first()?).clone()))
    }

    /// Why there will be no workers, if so.
    pub fn problem(&self) -> Option<ExecutorError> {
        self.board.lock().expect(NO_PANIC).problem.clone()
    }

    /// Ends the care for the workers.
    pub fn end(&mut self, farewell: Farewell) {
        {
            let mut board = self.board.lock().expect(NO_PANIC);
            (board.is_over, board.farewell) = (true, farewell);
        }
        // A scheduler that does not answer must not keep someone who leaves.
        if let Some(thread) = self.thread.take().filter(|_| farewell != Farewell::Leave) {
            let _ = thread.join();
        }
    }
}

/// The name under which drivers claim the care for the workers.
pub fn driver_key() -> Digest {
    Digest::of(b"driver")
}

/// Whether a worker that the executor names is one: seen to have begun so long ago, and heard of lately, or before, or not at all.
///
/// A scheduler that was restarted may name jobs that ended long ago, and a machine may hang before the worker says a word.
fn counts(since: Duration, heard: Option<bool>) -> bool {
    heard.unwrap_or(since < DUMB)
}

/// What the thread knows.
struct Foreman {
    board: Arc<Mutex<Board>>,
    executor: Box<dyn Executor>,
    classes: Vec<Class>,
    limit: usize,
    drivers: Claims,
    folder: RunFolder,
    claim: Option<Claim>,
    looked: Option<Instant>,
    /// When each worker was first seen to have begun.
    begun: BTreeMap<String, Instant>,
    /// So often workers were started since a job was done.
    fruitless: usize,
    done_before: usize,
}

impl Foreman {
    fn work(&mut self) {
        loop {
            let (is_over, has_demand) = {
                let board = self.board.lock().expect(NO_PANIC);
                (board.is_over, board.demand.iter().any(|count| *count > 0))
            };
            if is_over {
                return self.part();
            }
            self.tend_claim();
            let is_due = self.looked.is_none_or(|moment| moment.elapsed() >= self.executor.interval());
            if has_demand && is_due && self.claim.is_some() {
                self.look();
                self.looked = Some(Instant::now());
            }
            std::thread::sleep(TICK);
        }
    }

    fn tend_claim(&mut self) {
        let key = driver_key();
        match &mut self.claim {
            Some(claim) => claim.keep_alive(),
            None if self.drivers.holder(&key).is_none() => self.claim = self.drivers.take(&key),
            None => {}
        }
    }

    fn part(&mut self) {
        let farewell = self.board.lock().expect(NO_PANIC).farewell;
        match farewell {
            // Whoever watches beside another driver leaves the workers to that one.
            _ if self.claim.is_none() => {}
            Farewell::Leave => {}
            Farewell::Dismiss => {
                let _ = self.folder.order_end(Ending::Finish);
                self.executor.dismiss();
            }
            Farewell::Cancel => {
                let _ = self.folder.order_end(Ending::Now);
                let _ = self.executor.cancel();
            }
        }
    }

    fn look(&mut self) {
        // If the scheduler does not answer, those that are there work on, and it is asked again.
        let Some(present) = self.executor.present() else { return };
        let begun = present.iter().filter(|worker| worker.waits_for.is_none()).map(|worker| worker.name.clone());
        self.begun = begun.map(|name| (name.clone(), self.begun.get(&name).copied().unwrap_or_else(Instant::now))).collect();
        {
            let mut board = self.board.lock().expect(NO_PANIC);
            let since = |worker: &Present| self.begun.get(&worker.name).map_or(Duration::ZERO, Instant::elapsed);
            board.present = present.into_iter().filter(|worker| counts(since(worker), board.heard.get(&worker.name).copied())).collect();
        }
        if self.looked.is_some() && self.missing().iter().any(|count| *count > 0) {
            // Workers that are gone may have ended because all is done, which shows itself in a moment.
            std::thread::sleep(self.executor.interval().min(MOMENT));
        }
        let missing = self.missing();
        if missing.iter().all(|count| *count == 0) {
            return;
        }
        self.fruitless += 1;
        if self.fruitless > PATIENCE {
            let problem = self.fruitless_problem();
            self.board.lock().expect(NO_PANIC).problem = Some(problem);
            return;
        }
        missing.into_iter().enumerate().filter(|(_, count)| *count > 0).for_each(|(index, count)| self.start(index, count));
    }

    /// How many workers of each class are fewer than there is work for.
    fn missing(&mut self) -> Vec<usize> {
        let board = self.board.lock().expect(NO_PANIC);
        if board.done > self.done_before {
            (self.fruitless, self.done_before) = (0, board.done);
        }
        if board.is_over {
            return Vec::new();
        }
        let of_class = |number: usize| board.present.iter().filter(|worker| worker.class.is_none_or(|class| class == number)).count();
        board.demand.iter().enumerate().map(|(number, jobs)| self.limit.min(*jobs).saturating_sub(of_class(number))).collect()
    }

    fn start(&mut self, index: usize, count: usize) {
        match self.executor.start(&self.classes[index], count) {
            Ok(()) => {}
            // While others work it is tried again.
            Err(error) => {
                let mut board = self.board.lock().expect(NO_PANIC);
                if board.present.is_empty() {
                    board.problem = Some(error);
                }
            }
        }
    }

    fn fruitless_problem(&self) -> ExecutorError {
        ExecutorError {
            message: format!("workers were started {PATIENCE} times, and ended without finishing a job"),
            hint: Some(format!("their logs say why: {}", self.executor.log_of("*").display())),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_worker_counts_while_it_may_still_say_something() {
        let seconds = Duration::from_secs;
        assert!(counts(seconds(0), None) && counts(seconds(119), None) && counts(seconds(5000), Some(true)));
        assert!(!counts(seconds(121), None) && !counts(seconds(10), Some(false)));
    }
}

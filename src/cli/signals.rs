//! SIGINT and SIGTERM: the first asks the run to end, the second ends the process.
//!
//! A thread waits for the signals, which all others leave to it; so nothing ever runs inside a signal handler.
//! SIGXFSZ, which comes with a write beyond the limit of a file's size, is held back: the write says so too.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU8, Ordering};

use nix::sys::signal::{SigSet, Signal};

use super::Ending;

/// What a run and the thread that waits for signals share.
#[derive(Debug, Clone, Default)]
pub struct Interrupt {
    /// Set when the run is to end.
    pub flag: Arc<AtomicBool>,
    /// Set when no more is to be begun: SIGUSR1, which only a worker listens to.
    pub leaving: Arc<AtomicBool>,
    /// Set while there is something to end in good order.
    pub is_running: Arc<AtomicBool>,
    signal: Arc<AtomicU8>,
}

impl Interrupt {
    /// From now on signals are taken note of. To be called before any other thread starts.
    pub fn listen() -> Self {
        Self::listen_to(&[Signal::SIGINT, Signal::SIGTERM])
    }

    /// The same for a worker, which is told by SIGUSR1 that its time is nearly over.
    pub fn listen_as_worker() -> Self {
        Self::listen_to(&[Signal::SIGINT, Signal::SIGTERM, Signal::SIGUSR1])
    }

    fn listen_to(signals: &[Signal]) -> Self {
        let interrupt = Self::default();
        let signals: SigSet = signals.iter().copied().collect();
        // If it cannot be held back, it ends the process as it ends any other.
        let _ = SigSet::from(Signal::SIGXFSZ).thread_block();
        if signals.thread_block().is_ok() {
            let listener = interrupt.clone();
            let thread = std::thread::Builder::new().name("signals".into()).spawn(move || listener.wait_for(&signals));
            thread.expect("the system gives a thread");
        }
        interrupt
    }

    fn wait_for(&self, signals: &SigSet) {
        while let Ok(signal) = signals.wait() {
            if signal == Signal::SIGUSR1 {
                self.leaving.store(true, Ordering::Relaxed);
                continue;
            }
            let number = signal as i32 as u8;
            self.signal.store(number, Ordering::Relaxed);
            let is_second = self.flag.swap(true, Ordering::Relaxed);
            // Before the first job nothing was written, so that there is nothing to end in good order.
            if is_second || !self.is_running.load(Ordering::Relaxed) {
                std::process::exit(i32::from(Ending::Interrupted(number).code()));
            }
        }
    }

    /// From now on there is something to end in good order, which looks at this.
    pub fn begun(&self) -> &AtomicBool {
        self.is_running.store(true, Ordering::Relaxed);
        &self.flag
    }

    /// How an interrupted run ends.
    pub fn ending(&self) -> Ending {
        // A run that `pipeline cancel` ended has heard no signal.
        Ending::Interrupted(Some(self.signal.load(Ordering::Relaxed)).filter(|signal| *signal != 0).unwrap_or(Signal::SIGTERM as i32 as u8))
    }
}

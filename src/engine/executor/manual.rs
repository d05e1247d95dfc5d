//! Workers that someone else starts: a person on each workstation, or Kubernetes.

use std::path::PathBuf;
use std::time::Duration;

use super::{Class, Executor, ExecutorError, Present, Row, Terms};

/// See [`super::EXECUTORS`].
pub const ROW: Row = Row {
    name: "manual",
    about: "workers are started by you, with `pipeline worker --run FOLDER`, on any machine that sees the folder",
    outlives_driver: true,
    make: |terms| Box::new(Manual(terms)),
};

struct Manual(Terms);

impl Executor for Manual {
    fn start(&mut self, _class: &Class, _count: usize) -> Result<(), ExecutorError> {
        Ok(())
    }

    fn present(&mut self) -> Option<Vec<Present>> {
        None
    }

    /// Workers look for the order to end by themselves.
    fn cancel(&mut self) -> Result<(), ExecutorError> {
        Ok(())
    }

    fn dismiss(&mut self) {}

    fn interval(&self) -> Duration {
        Duration::from_secs(10)
    }

    fn log_of(&self, name: &str) -> PathBuf {
        self.0.folder.workers().join(format!("{name}.jsonl"))
    }
}

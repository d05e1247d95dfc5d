//! Named objects, each visible only whole. Knows nothing of what they hold.

use std::io::{self, Read, Write};
use std::path::PathBuf;
use std::sync::atomic::AtomicBool;

use super::claims::Claims;
use crate::engine::system::SystemError;

/// Where an object stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Shelf {
    /// Bytes by their own digest.
    Blobs,
    /// Records of results by the key of the job.
    Results,
    /// Records of encoded files by artifact, format and origin.
    Publications,
    /// Caches that can be rebuilt: the recipe index of each pipeline, stat signatures.
    Notes,
    /// Manifests of runs that were sent from one store to another.
    Runs,
}

impl Shelf {
    /// Every shelf; records before the blobs that they name.
    pub const ALL: [Shelf; 5] = [Shelf::Runs, Shelf::Results, Shelf::Publications, Shelf::Notes, Shelf::Blobs];

    /// The word for people and paths.
    pub fn folder_name(self) -> &'static str {
        match self {
            Shelf::Blobs => "cas",
            Shelf::Results => "ac",
            Shelf::Publications => "publications",
            Shelf::Notes => "notes",
            Shelf::Runs => "runs",
        }
    }

    /// What stands there, in messages.
    pub fn noun(self) -> &'static str {
        match self {
            Shelf::Blobs => "blob",
            Shelf::Results => "result record",
            Shelf::Publications => "publication record",
            Shelf::Notes => "note",
            Shelf::Runs => "run",
        }
    }
}

/// A store's objects. An object appears at once and whole, and is replaced at once and whole.
pub trait Objects: Send + Sync {
    /// Opens an object for reading.
    ///
    /// `NotFound` if there is none; `InvalidData` if what stands under the name is no plain object.
    fn open(&self, shelf: Shelf, name: &str) -> io::Result<Box<dyn Read + Send>>;

    /// Whether anything stands under the name, good or bad.
    fn has(&self, shelf: Shelf, name: &str) -> bool;

    /// Bytes of what stands under the name, if anything does.
    fn length(&self, shelf: Shelf, name: &str) -> Option<u64>;

    /// Begins an object whose name is not known yet.
    fn draft(&self) -> Result<Box<dyn Draft>, SystemError>;

    /// Removes an object.
    fn remove(&self, shelf: Shelf, name: &str) -> io::Result<()>;

    /// Takes a damaged object out of use, but keeps it for a look: where, if that could be done.
    fn set_aside(&self, shelf: Shelf, name: &str) -> Option<PathBuf>;

    /// Returns when these objects would survive a power cut.
    fn make_durable(&self, objects: &[(Shelf, String)]) -> Result<(), SystemError>;

    /// Names of objects on that shelf, in no order; of more than `limit`, some.
    fn names(&self, shelf: Shelf, limit: usize) -> io::Result<Vec<String>>;

    /// Whether there is any object on that shelf.
    fn has_any(&self, shelf: Shelf) -> bool;

    /// Who is computing what; none where that cannot be said.
    fn claims(&self) -> Option<Claims> {
        None
    }

    /// Clears what dead processes left: unfinished objects and claims.
    fn tidy(&self);

    /// How many calls are made at once when there are many.
    fn at_once(&self) -> usize {
        8
    }

    /// Whether there is anything to be brought near.
    fn has_far_objects(&self) -> bool {
        false
    }

    /// Brings near what is going to be asked for.
    fn fetch(&self, _wanted: &[(Shelf, String)]) {}

    /// Returns when records, which are here with their blobs, can be found by whoever shares the store, or when that was
    /// given up: at the latest soon after `is_hurried` is set.
    fn share(&self, _records: &[(Shelf, String)], _is_hurried: &AtomicBool) {}

    /// What a person should know of how it went so far; once.
    fn take_notices(&self) -> Vec<String> {
        Vec::new()
    }
}

/// An object that is being written; vanishes unless kept.
pub trait Draft: Write + Send {
    /// Makes it visible under a name, in place of what stood there.
    fn keep(self: Box<Self>, shelf: Shelf, name: &str) -> Result<(), SystemError>;

    /// Makes it visible under a name, unless something stands there: then false.
    ///
    /// Where a store cannot tell, it replaces what stood there, which holds the same bytes or is damaged; and after a call that
    /// was repeated, what stands there may be this very object.
    fn keep_new(self: Box<Self>, shelf: Shelf, name: &str) -> Result<bool, SystemError>;

    /// Where it is being written, for messages.
    fn path(&self) -> PathBuf;
}

/// A draft with all of these bytes, to be kept under a name.
pub fn drafted(store: &dyn Objects, bytes: &[u8]) -> Result<Box<dyn Draft>, SystemError> {
    let mut draft = store.draft()?;
    draft.write_all(bytes).map_err(SystemError::at("write", draft.path()))?;
    Ok(draft)
}

//! Named objects, each visible only whole. Knows nothing of what they hold.

use std::io::{self, Read, Write};
use std::path::PathBuf;

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
}

impl Shelf {
    /// Every shelf; records before the blobs that they name.
    pub const ALL: [Shelf; 4] = [Shelf::Results, Shelf::Publications, Shelf::Notes, Shelf::Blobs];

    /// The word for people and paths.
    pub fn folder_name(self) -> &'static str {
        match self {
            Shelf::Blobs => "cas",
            Shelf::Results => "ac",
            Shelf::Publications => "publications",
            Shelf::Notes => "notes",
        }
    }

    /// What stands there, in messages.
    pub fn noun(self) -> &'static str {
        match self {
            Shelf::Blobs => "blob",
            Shelf::Results => "result record",
            Shelf::Publications => "publication record",
            Shelf::Notes => "note",
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

    /// Begins an object whose name is not known yet.
    fn draft(&self) -> Result<Box<dyn Draft>, SystemError>;

    /// Takes a damaged object out of use, but keeps it for a look: where, if that could be done.
    fn set_aside(&self, shelf: Shelf, name: &str) -> Option<PathBuf>;

    /// Returns when these objects would survive a power cut.
    fn make_durable(&self, objects: &[(Shelf, String)]) -> Result<(), SystemError>;

    /// Whether there is any object on that shelf.
    fn has_any(&self, shelf: Shelf) -> bool;

    /// Who is computing what.
    fn claims(&self) -> Claims;

    /// Clears what dead processes left: unfinished objects and claims.
    fn tidy(&self);
}

/// An object that is being written; vanishes unless kept.
pub trait Draft: Write + Send {
    /// Makes it visible under a name, in place of what stood there.
    fn keep(self: Box<Self>, shelf: Shelf, name: &str) -> Result<(), SystemError>;

    /// Where it is being written, for messages.
    fn path(&self) -> PathBuf;
}

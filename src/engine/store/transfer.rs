//! Carries records and what they name from one store to another, and trusts neither.
//!
//! Blobs come first, the record last, so that at no moment a record stands in the target without its blobs. Bytes are hashed
//! on the way. What stands in the target already is left there if it is sound and says the same.

use std::fmt;
use std::io::{self, Read, Write};
use std::sync::atomic::{AtomicBool, Ordering};

use super::library::{DISAGREES, NOTE_LIMIT, RECORD_LIMIT};
use super::objects::{Objects, Shelf, drafted};
use super::record::{Blob, Keyed, PublicationRecord, RECORD_VERSION, ResultRecord, unseal};
use super::signing::Keys;
use crate::engine::digest::{Digest, HashingReader, READ_SIZE};
use crate::engine::system::SystemError;

/// Why something was not carried.
#[derive(Debug)]
pub enum Fault {
    /// The source does not have it.
    Missing,
    /// What the source has is wrong.
    Damaged(&'static str),
    /// No one who is trusted has signed it.
    Untrusted,
    /// The source failed.
    Source(io::Error),
    /// The target failed.
    Target(SystemError),
    /// It was to end.
    Stopped,
}

impl fmt::Display for Fault {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Fault::Missing => write!(out, "it, or what it names, is missing"),
            Fault::Damaged(what) => write!(out, "{what}"),
            Fault::Untrusted => write!(out, "no key that is trusted here has signed it"),
            Fault::Source(error) => write!(out, "{error}"),
            Fault::Target(error) => write!(out, "{error}"),
            Fault::Stopped => write!(out, "interrupted"),
        }
    }
}

/// What became of something that was carried.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Carried {
    /// It stands in the target now.
    New,
    /// It stood there already.
    WasThere,
    /// Another record stands there, with other results for the same key: it was left there.
    Differs,
}

/// A record that may be used.
#[derive(Debug, Clone)]
pub struct SoundRecord {
    /// The text, without a signature.
    pub sealed: String,
    /// What it names, in its order.
    pub blobs: Vec<Blob>,
}

impl SoundRecord {
    /// The blobs that stand by themselves.
    pub fn separate_blobs(&self) -> impl Iterator<Item = &Blob> {
        self.blobs.iter().filter(|blob| blob.inline.is_none())
    }

    fn has_same_results(&self, other: &SoundRecord) -> bool {
        self.blobs.iter().map(|blob| blob.digest).eq(other.blobs.iter().map(|blob| blob.digest))
    }
}

/// Reads a record, and takes it only if its seal, its name and its signature are right.
pub fn read_record(from: &dyn Objects, keys: &Keys, shelf: Shelf, name: &str) -> Result<SoundRecord, Fault> {
    let text = read_text(from, shelf, name)?;
    let sealed = keys.admit(shelf, &text).map_err(|_| Fault::Untrusted)?;
    let body = unseal(sealed).ok_or(Fault::Damaged(DISAGREES))?;
    let blobs = match shelf {
        Shelf::Results => parsed::<ResultRecord>(body, name)?.outputs.into_iter().map(|output| output.content).collect(),
        Shelf::Publications => vec![parsed::<PublicationRecord>(body, name)?.content],
        Shelf::Runs | Shelf::Notes | Shelf::Blobs => Vec::new(),
    };
    Ok(SoundRecord { sealed: sealed.to_owned(), blobs })
}

fn read_text(from: &dyn Objects, shelf: Shelf, name: &str) -> Result<String, Fault> {
    let mut text = String::new();
    let reader = from.open(shelf, name).map_err(of_the_source)?;
    let limit = if shelf == Shelf::Runs { NOTE_LIMIT } else { RECORD_LIMIT };
    reader.take(limit).read_to_string(&mut text).map_err(of_the_source)?;
    Ok(text)
}

fn parsed<T: Keyed>(body: &str, name: &str) -> Result<T, Fault> {
    let record: T = serde_json::from_str(body).map_err(|_| Fault::Damaged("it is no record"))?;
    match () {
        () if record.schema() != RECORD_VERSION => Err(Fault::Missing),
        () if record.key().to_string() != name => Err(Fault::Damaged("it stands under another's name")),
        () => Ok(record),
    }
}

fn of_the_source(error: io::Error) -> Fault {
    use io::ErrorKind::{InvalidData, IsADirectory, NotFound, UnexpectedEof};
    match error.kind() {
        NotFound => Fault::Missing,
        InvalidData | IsADirectory | UnexpectedEof => Fault::Damaged("it cannot be read to its end, or is no text"),
        _ => Fault::Source(error),
    }
}

/// How things are carried.
pub struct Way<'a> {
    /// Where they are.
    pub from: &'a dyn Objects,
    /// Whose records are taken there.
    pub from_keys: &'a Keys,
    /// Where they go.
    pub to: &'a dyn Objects,
    /// Whose records count there, and with what those that come are signed.
    pub to_keys: &'a Keys,
    /// Set when it is to end.
    pub stop: &'a AtomicBool,
    /// Whether what the target has under a name was found to be damaged, and is to be replaced.
    pub is_suspect: &'a (dyn Fn(Shelf, &str) -> bool + Sync),
}

impl Way<'_> {
    /// Carries a record and what it names.
    pub fn carry(&self, shelf: Shelf, name: &str) -> Result<Carried, Fault> {
        let record = read_record(self.from, self.from_keys, shelf, name)?;
        for blob in record.separate_blobs() {
            let name = blob.digest.to_string();
            let length = self.to.length(Shelf::Blobs, &name);
            // What was cut short is replaced; whether the bytes are right is seen by who reads them.
            let is_wrong = length.is_some_and(|length| length != blob.size) || (self.is_suspect)(Shelf::Blobs, &name);
            if is_wrong || length.is_none() {
                self.carry_blob(&blob.digest, Some(blob.size), is_wrong)?;
            }
        }
        self.carry_text(shelf, name, &record)
    }

    fn carry_text(&self, shelf: Shelf, name: &str, record: &SoundRecord) -> Result<Carried, Fault> {
        let text = self.to_keys.signed(shelf, &record.sealed);
        // Asked first, since a server that ignores the condition of `keep_new` would replace what stands there.
        if let Some(carried) = self.compared(shelf, name, record) {
            return Ok(carried);
        }
        let write = || drafted(self.to, text.as_bytes());
        if write().and_then(|draft| draft.keep_new(shelf, name)).map_err(Fault::Target)? {
            return Ok(Carried::New);
        }
        // Another was faster, or a repeated call met its own success, or what stands there cannot be used.
        if let Some(carried) = self.compared(shelf, name, record) {
            return Ok(carried);
        }
        write().and_then(|draft| draft.keep(shelf, name)).map_err(Fault::Target)?;
        Ok(Carried::New)
    }

    /// What the sound record that stands in the target says to this one.
    fn compared(&self, shelf: Shelf, name: &str, record: &SoundRecord) -> Option<Carried> {
        let there = read_record(self.to, self.to_keys, shelf, name).ok()?;
        Some(if there.has_same_results(record) { Carried::WasThere } else { Carried::Differs })
    }

    /// Carries a blob, of which the size may be known, perhaps in the place of what stands there.
    pub fn carry_blob(&self, digest: &Digest, size: Option<u64>, replaces: bool) -> Result<(), Fault> {
        let name = digest.to_string();
        let reader = self.from.open(Shelf::Blobs, &name).map_err(of_the_source)?;
        let mut reader = HashingReader::new(reader.take(size.map_or(u64::MAX, |size| size.saturating_add(1))));
        let mut draft = self.to.draft().map_err(Fault::Target)?;
        let mut buffer = vec![0; READ_SIZE];
        loop {
            if self.stop.load(Ordering::Relaxed) {
                return Err(Fault::Stopped);
            }
            match reader.read(&mut buffer) {
                Ok(0) => break,
                Ok(count) => draft.write_all(&buffer[..count]).map_err(SystemError::at("write", draft.path())).map_err(Fault::Target)?,
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => return Err(of_the_source(error)),
            }
        }
        let (found, length) = reader.finish();
        if found != *digest || size.is_some_and(|size| size != length) {
            return Err(Fault::Damaged(DISAGREES));
        }
        let kept = match replaces {
            true => draft.keep(Shelf::Blobs, &name),
            false => draft.keep_new(Shelf::Blobs, &name).map(drop),
        };
        kept.map_err(Fault::Target)
    }
}

//! What a store holds: a walk over every object, whatever state it is in.

use std::collections::BTreeMap;
use std::fs::DirEntry;
use std::io;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use serde::Serialize;

use super::folder::Layout;
use super::library::Library;
use super::objects::Shelf;
use crate::engine::files;
use crate::engine::system::SystemError;

/// Something that stands in a store.
#[derive(Debug, Clone)]
pub struct Entry {
    /// Its name: a digest, a key, or that of a note.
    pub name: String,
    /// Where it stands.
    pub path: PathBuf,
    /// Its bytes, as the file system counts them.
    pub size: u64,
    /// When it was written or last used.
    pub modified: SystemTime,
    /// Whether it is a regular file.
    pub is_plain: bool,
}

/// Everything on a shelf, by name; nothing where there is no such folder.
pub fn entries(layout: &Layout, shelf: Shelf) -> Result<Vec<Entry>, SystemError> {
    let folder = layout.root().join(shelf.folder_name());
    let found = match shelf {
        Shelf::Notes | Shelf::Runs => entries_of(&folder)?,
        _ => {
            let mut found = Vec::new();
            for part in entries_of(&folder)? {
                // A stray file among the folders counts as an object with a bad name.
                if part.is_plain { found.push(part) } else { found.extend(entries_of(&part.path)?) }
            }
            found
        }
    };
    Ok(found)
}

/// Everything that stands directly in a folder, by name.
pub fn entries_of(folder: &Path) -> Result<Vec<Entry>, SystemError> {
    let listed = match files::list(folder) {
        Ok(listed) => listed,
        Err(error) if matches!(error.kind(), io::ErrorKind::NotFound | io::ErrorKind::NotADirectory) => return Ok(Vec::new()),
        Err(error) => return Err(SystemError::at("read", folder)(error)),
    };
    let mut found = Vec::new();
    for entry in listed {
        let entry = entry.map_err(SystemError::at("read", folder))?;
        // Another run may have replaced or removed it meanwhile.
        found.extend(described(&entry));
    }
    found.sort_by(|a, b| a.name.cmp(&b.name));
    Ok(found)
}

fn described(entry: &DirEntry) -> Option<Entry> {
    let status = files::link_status(&entry.path()).ok()?;
    Some(Entry {
        name: entry.file_name().to_string_lossy().into_owned(),
        path: entry.path(),
        size: if status.is_dir() { 0 } else { status.len() },
        modified: status.modified().unwrap_or(SystemTime::UNIX_EPOCH),
        is_plain: status.is_file(),
    })
}

/// How many things, how large, how old.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Tally {
    /// How many.
    pub count: u64,
    /// Bytes of all.
    pub bytes: u64,
    /// Seconds since the youngest was written or used; absent where there is none.
    pub youngest_seconds: Option<u64>,
    /// Seconds since the oldest was written or used.
    pub oldest_seconds: Option<u64>,
}

impl Tally {
    fn of(entries: &[Entry], now: SystemTime) -> Self {
        let age = |entry: &Entry| now.duration_since(entry.modified).map_or(0, |age| age.as_secs());
        Self {
            count: entries.len() as u64,
            bytes: entries.iter().map(|entry| entry.size).sum(),
            youngest_seconds: entries.iter().map(age).min(),
            oldest_seconds: entries.iter().map(age).max(),
        }
    }
}

/// Results of one type of artifact.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct TypeTally {
    /// Results that records name.
    pub results: u64,
    /// Their bytes; equal results stand in the store once.
    pub bytes: u64,
}

/// What a store holds.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Stats {
    /// Bytes of everything.
    pub bytes: u64,
    /// Blobs: the bytes of results and of encoded files.
    pub blobs: Tally,
    /// Records of jobs.
    pub results: Tally,
    /// Records of encoded files.
    pub publications: Tally,
    /// Caches that can be rebuilt.
    pub notes: Tally,
    /// Runs that were sent here from other stores.
    pub runs: Tally,
    /// Damaged objects that were set aside.
    pub damaged: Tally,
    /// What is being written, or was when its process ended.
    pub unfinished: Tally,
    /// Jobs that runs are computing.
    pub claims: Tally,
    /// Results by the type of their artifact.
    pub types: BTreeMap<String, TypeTally>,
}

/// Counts everything in a store; hashes nothing but the records.
pub fn stats(layout: &Layout, library: &Library) -> Result<Stats, SystemError> {
    let now = SystemTime::now();
    let shelf = |shelf| Ok::<_, SystemError>(Tally::of(&entries(layout, shelf)?, now));
    let folder = |folder: &Path| Ok::<_, SystemError>(Tally::of(&entries_of(folder)?, now));
    let mut stats = Stats {
        bytes: 0,
        blobs: shelf(Shelf::Blobs)?,
        results: shelf(Shelf::Results)?,
        publications: shelf(Shelf::Publications)?,
        notes: shelf(Shelf::Notes)?,
        runs: shelf(Shelf::Runs)?,
        damaged: folder(&layout.damaged())?,
        unfinished: folder(&layout.temporary())?,
        claims: folder(&layout.claims())?,
        types: BTreeMap::new(),
    };
    stats.bytes = [&stats.blobs, &stats.results, &stats.publications, &stats.notes, &stats.runs, &stats.damaged, &stats.unfinished]
        .iter()
        .map(|tally| tally.bytes)
        .sum();
    for entry in entries(layout, Shelf::Results)? {
        // What is damaged is for the verification to find.
        let Some(record) = entry.name.parse().ok().and_then(|key| library.glance_at_result(&key)) else { continue };
        for output in &record.outputs {
            let tally = stats.types.entry(output.type_name.clone()).or_default();
            tally.results += 1;
            tally.bytes += output.content.size;
        }
    }
    Ok(stats)
}

//! Puts the published files of an earlier run back in place, from the store.
//!
//! Does so only where nothing is to be told: a file is missing, or is what the latest run has published. A file that
//! a person has changed, and an object that the store has lost, are left to the run that plans; what was put back
//! by then is right.

use std::collections::HashSet;
use std::fs;
use std::io::{self, Write};
use std::num::NonZeroUsize;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicUsize, Ordering};

use super::memory::{Basis, FileContent, KnownRecord, Odd, kept_record};
use crate::engine::digest::Digest;
use crate::engine::events::{Event, Listener};
use crate::engine::manifest::Standing;
use crate::engine::publish::OutputFolder;
use crate::engine::signature::Signatures;
use crate::engine::store::library::Library;
use crate::engine::system::{SystemError, beside};

/// What was done.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Restored {
    /// Published files that were written.
    pub written: u64,
    /// Those of the latest run that were removed.
    pub removed: u64,
}

/// With what it is done.
pub struct Means<'a> {
    /// The folder of outputs.
    pub outputs: &'a OutputFolder,
    /// The store.
    pub library: &'a Library,
    /// See [`Signatures`].
    pub signatures: &'a mut Signatures,
    /// Threads that write.
    pub threads: NonZeroUsize,
    /// Set when it is to end.
    pub interrupted: &'a AtomicBool,
    /// Who is told of it.
    pub listener: &'a mut dyn Listener,
}

/// Makes the outputs those of an earlier run; `None` if that is not for this module to do, or was interrupted.
pub fn restore(basis: &Basis, contents: &[FileContent], odd: &Odd, means: &mut Means<'_>) -> Result<Option<Restored>, SystemError> {
    let outputs = means.outputs;
    let latest = || {
        let text = odd.has_records.then(|| fs::read(outputs.path().join("manifest.json")).ok());
        text.flatten().and_then(|text| Standing::from_text(&text))
    };
    let (latest, records) = beside(latest, || records_to_write(basis, outputs, odd.has_records, means.signatures));
    let Some(records) = records else { return Ok(None) };
    // If the records in place are those of the run itself, nothing else is published.
    let standing = latest.filter(|_| !records.is_empty());
    let Some(missing) = files_to_write(contents, odd, standing.as_ref(), means) else { return Ok(None) };
    let Some(surplus) = files_to_remove(basis, contents, standing.as_ref(), means) else { return Ok(None) };

    outputs.prepare()?;
    if !write_files(&missing, means)? {
        return Ok(None);
    }
    surplus.iter().try_for_each(|path| outputs.remove(path))?;
    // The manifest comes last: until it is there, the outputs are those of the run before.
    for (record, bytes) in records.iter().rev() {
        outputs.write(&record.name, bytes)?;
    }
    Ok(Some(Restored { written: missing.len() as u64, removed: surplus.len() as u64 }))
}

/// The records that are not the run's own, with the bytes that belong there; `None` if those are gone.
fn records_to_write<'b>(
    basis: &'b Basis,
    outputs: &OutputFolder,
    has_odd: bool,
    signatures: &mut Signatures,
) -> Option<Vec<(&'b KnownRecord, Vec<u8>)>> {
    let mut to_write = Vec::new();
    for record in basis.records.iter().filter(|_| has_odd) {
        // Another length is another content, and records are long where a run has many jobs.
        let is_as_long = outputs.signature(&record.name).is_some_and(|found| found.size() == record.content.size);
        if is_as_long && outputs.content_of(&record.name, signatures) == Some(record.content.digest) {
            continue;
        }
        let bytes = fs::read(outputs.path().join(kept_record(&basis.run_id, record))).ok()?;
        if Digest::of(&bytes) != record.content.digest {
            return None;
        }
        to_write.push((record, bytes));
    }
    Some(to_write)
}

/// The files whose bytes are not in place; `None` if a person has changed one.
fn files_to_write<'c>(
    contents: &'c [FileContent],
    odd: &Odd,
    standing: Option<&Standing>,
    means: &mut Means<'_>,
) -> Option<Vec<&'c FileContent>> {
    let mut missing = Vec::new();
    for index in &odd.files {
        let wanted = contents.get(*index)?;
        match means.content_of(&wanted.path)? {
            Some(found) if found == wanted.digest => {}
            Some(found) if standing?.digest_of(&wanted.path) != Some(found) => return None,
            _ => missing.push(wanted),
        }
    }
    Some(missing)
}

/// The files of the latest run that the earlier one does not have; `None` if a person has changed one.
fn files_to_remove(basis: &Basis, contents: &[FileContent], standing: Option<&Standing>, means: &mut Means<'_>) -> Option<Vec<String>> {
    let Some(standing) = standing else { return Some(Vec::new()) };
    if !basis.is_whole {
        // What a partial run leaves in place depends on what it finds.
        return None;
    }
    let present: HashSet<&str> = contents.iter().map(|file| file.path.as_str()).collect();
    let mut surplus = Vec::new();
    for entry in standing.published.iter().chain(&standing.kept).filter(|entry| !present.contains(entry.path.as_str())) {
        match means.content_of(&entry.path)? {
            None => {}
            Some(found) if found == entry.sha256 => surplus.push(entry.path.clone()),
            Some(_) => return None,
        }
    }
    Some(surplus)
}

/// Writes files on several threads; false if the store has lost the bytes of one, or if it is interrupted.
fn write_files(files: &[&FileContent], means: &mut Means<'_>) -> Result<bool, SystemError> {
    let progress: Arc<AtomicU32> = Arc::default();
    means.listener.notify(&Event::Restoring { files: files.len(), progress: progress.clone() });
    let writer = Writer { outputs: means.outputs, library: means.library, interrupted: means.interrupted };
    let (is_lost, written) = (AtomicBool::new(false), AtomicUsize::new(0));
    let write_part = |part: &[&FileContent]| {
        for file in part.iter().take_while(|_| !is_lost.load(Ordering::Relaxed)) {
            if !writer.write(file)? {
                is_lost.store(true, Ordering::Relaxed);
            }
            let written = written.fetch_add(1, Ordering::Relaxed) + 1;
            progress.store((1000 * written / files.len()) as u32, Ordering::Relaxed);
        }
        Ok(())
    };
    let part_length = files.len().div_ceil(means.threads.get()).max(1);
    let result = std::thread::scope(|scope| {
        let threads: Vec<_> = files.chunks(part_length).skip(1).map(|part| scope.spawn(move || write_part(part))).collect();
        let first = files.chunks(part_length).next().map_or(Ok(()), write_part);
        threads.into_iter().map(|thread| thread.join().expect("no thread panics while it writes files")).fold(first, Result::and)
    });
    result.map(|()| !is_lost.load(Ordering::Relaxed))
}

impl Means<'_> {
    /// Digest of a published file, if there is one; `None` if this is interrupted.
    fn content_of(&mut self, path: &str) -> Option<Option<Digest>> {
        (!self.interrupted.load(Ordering::Relaxed)).then(|| self.outputs.content_of(path, self.signatures))
    }
}

/// What the threads share.
struct Writer<'a> {
    outputs: &'a OutputFolder,
    library: &'a Library,
    interrupted: &'a AtomicBool,
}

impl Writer<'_> {
    /// Writes a file; false if its bytes are lost or this is interrupted.
    fn write(&self, file: &FileContent) -> Result<bool, SystemError> {
        let record = self.library.glance_at_publication(&file.key).filter(|record| record.content.digest == file.digest);
        let Some(record) = record else { return Ok(false) };
        let fault = |error: io::Error| SystemError::at("write", self.outputs.path().join(&file.path))(error);
        let mut draft = Stoppable { inner: self.outputs.begin()?, stop: self.interrupted };
        match self.library.glance_at_blob(&record.content, &mut draft) {
            Ok(true) => {}
            Ok(false) => return Ok(false),
            Err(_) if self.interrupted.load(Ordering::Relaxed) => return Ok(false),
            Err(error) => return Err(fault(error)),
        }
        draft.inner.flush().map_err(fault)?;
        draft.inner.publish(&file.path)?;
        Ok(true)
    }
}

/// Takes nothing more once it is to stop: a file may be long.
struct Stoppable<'a, W> {
    inner: W,
    stop: &'a AtomicBool,
}

impl<W: Write> Write for Stoppable<'_, W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if self.stop.load(Ordering::Relaxed) {
            return Err(io::Error::other("interrupted"));
        }
        self.inner.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.inner.flush()
    }
}

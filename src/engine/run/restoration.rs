//! Puts the published files of an earlier run back in place, from the store.
//!
//! Does so only where nothing is to be told: a file is missing, or is what the latest run has published. A file that
//! a person has changed, and an object that the store has lost, are left to the run that plans; what was put back
//! by then is right.

use std::collections::HashSet;
use std::fs;
use std::io::{self, Write};
use std::num::NonZeroUsize;
use std::sync::atomic::{AtomicBool, Ordering};

use super::memory::{Basis, FileContent, KnownRecord, Odd, kept_record};
use crate::engine::digest::Digest;
use crate::engine::manifest::Standing;
use crate::engine::publish::OutputFolder;
use crate::engine::signature::Signatures;
use crate::engine::store::library::Library;
use crate::engine::system::SystemError;

/// What was done.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Restored {
    /// Published files that were written.
    pub written: u64,
    /// Those of the latest run that were removed.
    pub removed: u64,
}

/// Makes the outputs those of an earlier run; `None` if that is not for this module to do.
pub fn restore(
    basis: &Basis,
    contents: &[FileContent],
    odd: &Odd,
    outputs: &OutputFolder,
    library: &Library,
    signatures: &mut Signatures,
    threads: NonZeroUsize,
) -> Result<Option<Restored>, SystemError> {
    let Some(records) = records_to_write(basis, outputs, odd.has_records, signatures) else { return Ok(None) };
    let standing = match records.is_empty() {
        // The records in place are those of the run itself: nothing else is published.
        true => None,
        false => fs::read(outputs.path().join("manifest.json")).ok().and_then(|text| Standing::from_text(&text)),
    };
    let Some(missing) = files_to_write(contents, odd, standing.as_ref(), outputs, signatures) else { return Ok(None) };
    let Some(surplus) = files_to_remove(basis, contents, standing.as_ref(), outputs, signatures) else { return Ok(None) };

    outputs.prepare()?;
    if !write_files(&missing, outputs, library, threads)? {
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
    let odd = basis.records.iter().filter(|record| has_odd && outputs.content_of(&record.name, signatures) != Some(record.digest));
    let written = odd.map(|record| {
        let bytes = fs::read(outputs.path().join(kept_record(&basis.run_id, record))).ok()?;
        (Digest::of(&bytes) == record.digest).then_some((record, bytes))
    });
    written.collect()
}

/// The files whose bytes are not in place; `None` if a person has changed one.
fn files_to_write<'c>(
    contents: &'c [FileContent],
    odd: &Odd,
    standing: Option<&Standing>,
    outputs: &OutputFolder,
    signatures: &mut Signatures,
) -> Option<Vec<&'c FileContent>> {
    let mut missing = Vec::new();
    for index in &odd.files {
        let wanted = contents.get(*index)?;
        match outputs.content_of(&wanted.path, signatures) {
            Some(found) if found == wanted.digest => {}
            Some(found) if standing?.digest_of(&wanted.path) != Some(found) => return None,
            _ => missing.push(wanted),
        }
    }
    Some(missing)
}

/// The files of the latest run that the earlier one does not have; `None` if a person has changed one.
fn files_to_remove(
    basis: &Basis,
    contents: &[FileContent],
    standing: Option<&Standing>,
    outputs: &OutputFolder,
    signatures: &mut Signatures,
) -> Option<Vec<String>> {
    let Some(standing) = standing else { return Some(Vec::new()) };
    if !basis.is_whole {
        // What a partial run leaves in place depends on what it finds.
        return None;
    }
    let present: HashSet<&str> = contents.iter().map(|file| file.path.as_str()).collect();
    let mut surplus = Vec::new();
    for entry in standing.published.iter().chain(&standing.kept).filter(|entry| !present.contains(entry.path.as_str())) {
        match outputs.content_of(&entry.path, signatures) {
            None => {}
            Some(found) if found == entry.sha256 => surplus.push(entry.path.clone()),
            Some(_) => return None,
        }
    }
    Some(surplus)
}

/// Writes files on several threads; false if the store has lost the bytes of one.
fn write_files(files: &[&FileContent], outputs: &OutputFolder, library: &Library, threads: NonZeroUsize) -> Result<bool, SystemError> {
    let is_lost = AtomicBool::new(false);
    let write_part = |part: &[&FileContent]| {
        for file in part.iter().take_while(|_| !is_lost.load(Ordering::Relaxed)) {
            if !write_file(file, outputs, library)? {
                is_lost.store(true, Ordering::Relaxed);
            }
        }
        Ok(())
    };
    let part_length = files.len().div_ceil(threads.get()).max(1);
    let written = std::thread::scope(|scope| {
        let threads: Vec<_> = files.chunks(part_length).skip(1).map(|part| scope.spawn(move || write_part(part))).collect();
        let first = files.chunks(part_length).next().map_or(Ok(()), write_part);
        threads.into_iter().map(|thread| thread.join().expect("no thread panics while it writes files")).fold(first, Result::and)
    });
    written.map(|()| !is_lost.load(Ordering::Relaxed))
}

fn write_file(file: &FileContent, outputs: &OutputFolder, library: &Library) -> Result<bool, SystemError> {
    let record = library.glance_at_publication(&file.key).filter(|record| record.content.digest == file.digest);
    let Some(record) = record else { return Ok(false) };
    let fault = |error: io::Error| SystemError::at("write", outputs.path().join(&file.path))(error);
    let mut draft = outputs.begin()?;
    if !library.glance_at_blob(&record.content, &mut draft).map_err(fault)? {
        return Ok(false);
    }
    draft.flush().map_err(fault)?;
    draft.publish(&file.path)?;
    Ok(true)
}

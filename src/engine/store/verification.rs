//! Looks at every object of a store, whether or not a run would use it.
//!
//! What is wrong is set aside, so that the next run makes it again. A blob that no record names is no damage: the run
//! that wrote it was ended before the record.

use std::collections::BTreeSet;

use rayon::prelude::*;
use serde::Serialize;

use super::folder::Layout;
use super::inventory::{Entry, entries};
use super::library::{Library, Lost};
use super::objects::Shelf;
use super::record::Blob;
use crate::engine::digest::Digest;
use crate::engine::system::SystemError;

/// What was found.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize)]
pub struct Findings {
    /// Objects that were looked at.
    pub objects: u64,
    /// Bytes that were hashed.
    pub bytes: u64,
    /// Blobs that no record names.
    pub unnamed_blobs: u64,
    /// What was wrong, and has been set aside.
    pub damage: Vec<Damage>,
}

/// Something wrong.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Serialize)]
pub struct Damage {
    /// `blob`, `result record`, `publication record` or `note`.
    pub object: &'static str,
    /// Its name.
    pub name: String,
    /// What is wrong with it.
    pub what: String,
}

/// Hashes every object on all threads of the pool.
pub fn verify(layout: &Layout, library: &Library) -> Result<Findings, SystemError> {
    let mut objects: Vec<(Shelf, Entry)> = Vec::new();
    for shelf in Shelf::ALL {
        objects.extend(entries(layout, shelf)?.into_iter().map(|entry| (shelf, entry)));
    }
    // The large ones first, so that no thread is left with one at the end.
    objects.sort_by_key(|(_, entry)| std::cmp::Reverse(entry.size));
    let looked = objects.par_iter().with_max_len(1).map(|(shelf, entry)| look(layout, library, *shelf, entry)).collect();
    let bytes = objects.iter().map(|(_, entry)| entry.size).sum();
    let mut findings = Findings { objects: objects.len() as u64, bytes, ..Findings::default() };
    join(library, &objects, looked, &mut findings);
    findings.damage.sort();
    Ok(findings)
}

/// What a look at one object gave.
enum Looked {
    Damaged(Damage),
    /// The blobs that it names.
    Whole(Vec<Blob>),
}

fn look(layout: &Layout, library: &Library, shelf: Shelf, entry: &Entry) -> Looked {
    match named_blobs(layout, library, shelf, entry) {
        Ok(blobs) => Looked::Whole(blobs),
        // Replaced or collected by another run since the walk.
        Err(Lost::Missing) => Looked::Whole(Vec::new()),
        Err(Lost::Damaged(what)) => Looked::Damaged(Damage { object: shelf.noun(), name: entry.name.clone(), what }),
    }
}

fn named_blobs(layout: &Layout, library: &Library, shelf: Shelf, entry: &Entry) -> Result<Vec<Blob>, Lost> {
    if shelf == Shelf::Notes {
        return library.checked_note(&entry.name).map(|_| Vec::new());
    }
    if shelf == Shelf::Runs {
        return library.verify_run(&entry.name).map(|()| Vec::new());
    }
    let digest: Option<Digest> = entry.name.parse().ok();
    let Some(digest) = digest.filter(|_| layout.path_of(shelf, &entry.name) == entry.path) else {
        return Err(stray(layout, entry));
    };
    match shelf {
        Shelf::Blobs => library.verify_blob(&digest).map(|()| Vec::new()),
        Shelf::Publications => library.publication(&digest).map(|record| vec![record.content]),
        _ => library.result(&digest).map(|record| record.outputs.into_iter().map(|output| output.content).collect()),
    }
}

/// In a wrong folder an object is never found, and under a wrong name never asked for.
fn stray(layout: &Layout, entry: &Entry) -> Lost {
    let moved = layout.move_away(&entry.path, "stray");
    Lost::Damaged(format!("nothing of that name belongs here{}", if moved.is_err() { ", and it cannot be moved" } else { "" }))
}

/// Records whose blobs are gone are set aside too; blobs that no record names are counted.
fn join(library: &Library, objects: &[(Shelf, Entry)], looked: Vec<Looked>, findings: &mut Findings) {
    let mut sound: BTreeSet<String> = BTreeSet::new();
    for ((shelf, entry), looked) in objects.iter().zip(&looked) {
        if *shelf == Shelf::Blobs && matches!(looked, Looked::Whole(_)) {
            sound.insert(entry.name.clone());
        }
    }
    let mut named = BTreeSet::new();
    for ((shelf, entry), looked) in objects.iter().zip(looked) {
        match looked {
            Looked::Damaged(damage) => findings.damage.push(damage),
            Looked::Whole(blobs) => {
                for blob in blobs.iter().filter(|blob| blob.inline.is_none()) {
                    let name = blob.digest.to_string();
                    // A run that goes on beside us may have written it since the walk.
                    if !sound.contains(&name) && library.verify_blob(&blob.digest).is_err() {
                        let what = format!("its blob `{name}` is missing or damaged");
                        library.set_aside(*shelf, &entry.name);
                        findings.damage.push(Damage { object: shelf.noun(), name: entry.name.clone(), what });
                    }
                    named.insert(name);
                }
            }
        }
    }
    findings.unnamed_blobs = sound.difference(&named).count() as u64;
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::path::PathBuf;

    use super::*;
    use crate::engine::store::inventory::stats;
    use crate::engine::trial::{Space, files_below, job};

    fn filled() -> Space {
        let space = Space::new();
        let long = "long ".repeat(2000);
        space.run(&[job("a", &long).saves(), job("b", "b").of(0).saves(), job("c", "c").saves()]);
        space
    }

    fn look_at(space: &Space) -> Findings {
        let store = space.places().folder_store().unwrap().for_inspection();
        let layout = store.layout().clone();
        let library = Library::new(std::sync::Arc::new(store));
        verify(&layout, &library).unwrap()
    }

    fn objects(space: &Space) -> Vec<PathBuf> {
        ["cas", "ac", "publications", "notes"].iter().flat_map(|shelf| files_below(&space.path("store/v1").join(shelf))).collect()
    }

    #[test]
    fn a_sound_store_shows_nothing_and_all_its_bytes_are_looked_at() {
        let space = filled();
        let findings = look_at(&space);
        assert_eq!((findings.damage.len(), findings.unnamed_blobs), (0, 0), "{findings:?}");
        let bytes: u64 = objects(&space).iter().map(|path| fs::metadata(path).unwrap().len()).sum();
        assert_eq!((findings.objects, findings.bytes), (objects(&space).len() as u64, bytes));
    }

    #[test]
    fn one_flipped_bit_in_any_object_is_found_set_aside_and_healed() {
        let space = filled();
        let count = objects(&space).len();
        assert!(count >= 8, "{count} objects");
        for path in objects(&space) {
            let whole = fs::read(&path).unwrap();
            let mut bytes = whole.clone();
            let middle = bytes.len() / 2;
            bytes[middle] ^= 4;
            fs::write(&path, bytes).unwrap();
            let findings = look_at(&space);
            let name = path.file_name().unwrap().to_str().unwrap();
            assert!(findings.damage.iter().any(|damage| damage.name == name), "{name}: {findings:?}");
            assert!(!path.exists());
            assert_eq!(look_at(&space).damage, [], "a second look finds nothing");
            fs::remove_dir_all(space.path("outputs")).unwrap();
            let long = "long ".repeat(2000);
            space.run(&[job("a", &long).saves(), job("b", "b").of(0).saves(), job("c", "c").saves()]);
            assert_eq!(look_at(&space).damage, []);
        }
    }

    #[test]
    fn exchanged_stray_and_odd_things_are_found_and_blobs_without_records_are_not_damage() {
        let space = filled();
        let blobs = files_below(&space.path("store/v1/cas"));
        fs::copy(&blobs[0], &blobs[1]).unwrap();
        fs::write(space.path("store/v1/cas/stray"), "x").unwrap();
        fs::create_dir_all(space.path("store/v1/ac/zz")).unwrap();
        fs::write(space.path("store/v1/ac/zz/zz"), "x").unwrap();
        let findings = look_at(&space);
        // The blob, the two strays, and the record that named the blob.
        assert!(findings.damage.len() >= 4, "{findings:?}");
        assert!(findings.damage.iter().any(|damage| damage.what.contains("is missing or damaged")));
        assert_eq!(look_at(&space).damage, []);

        let space = filled();
        fs::remove_dir_all(space.path("store/v1/ac")).unwrap();
        let findings = look_at(&space);
        assert_eq!(findings.damage, []);
        assert_eq!(findings.unnamed_blobs, 2);
    }

    #[test]
    fn statistics_count_what_is_there() {
        let space = filled();
        let store = space.places().folder_store().unwrap();
        let layout = store.layout().clone();
        let library = Library::new(std::sync::Arc::new(store));
        let stats = stats(&layout, &library).unwrap();
        assert_eq!((stats.results.count, stats.publications.count, stats.types["text"].results), (3, 3, 3));
        assert_eq!(stats.damaged.count + stats.claims.count + stats.unfinished.count, 0);
        let bytes: u64 = objects(&space).iter().map(|path| fs::metadata(path).unwrap().len()).sum();
        assert_eq!(stats.bytes, bytes);
    }
}

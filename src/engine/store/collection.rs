//! Removes from a store what is not worth its room. Safe beside running pipelines, without a lock.
//!
//! Records go before the blobs that they name, so that no record ever names a blob that collection took. What was
//! written or used within the grace stays: the blob of a running job, whose record is still to come, is young. A
//! run that planned to use an old result which then goes finds it missing, and computes it again; nothing can
//! be wrong, and the grace makes it rare.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

use serde::Serialize;

use super::folder::{FolderStore, Layout};
use super::inventory::{Entry, entries, entries_of};
use super::library::Library;
use super::objects::{Objects, Shelf};
use super::runs::{Run, runs, surplus_folders};
use crate::engine::digest::Digest;
use crate::engine::files;
use crate::engine::system::SystemError;

/// What may go.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Policy {
    /// Results not used for so long go.
    pub older_than: Option<Duration>,
    /// Those not used for longest go until so many bytes are left.
    pub max_bytes: Option<u64>,
    /// What the last so many runs of each pipeline name stays; where nothing else is asked, all other results go. So do the
    /// folders of other runs, if no limit of bytes is asked for, and only those of the age that is.
    pub keep_last: Option<usize>,
    /// What was written or used within this time stays, whatever else is asked.
    pub grace: Duration,
    /// Whether it is only said what would go.
    pub is_trial: bool,
}

/// Objects that were set aside are kept for a look so long.
const DAMAGED_AGE: Duration = Duration::from_secs(7 * 24 * 3600);

/// What went, or would go.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize)]
pub struct Collected {
    /// Records of jobs and of encoded files.
    pub records: u64,
    /// Blobs that no record names any more, or never did.
    pub blobs: u64,
    /// Damaged objects that had been set aside.
    pub damaged: u64,
    /// Caches that named what went; they are made again.
    pub notes: u64,
    /// Bytes of all that.
    pub bytes: u64,
    /// Folders of runs, below the folder of outputs; their bytes are not counted.
    pub runs: u64,
    /// Bytes that are left.
    pub bytes_left: u64,
    /// Records and blobs that would have gone but for the grace.
    pub spared: u64,
}

/// A record with what it names.
struct Record {
    entry: Entry,
    blobs: Vec<String>,
    used: SystemTime,
    is_kept: bool,
}

/// Removes what the policy lets go.
pub fn collect(store: &FolderStore, library: &Library, outputs: &Path, policy: &Policy) -> Result<Collected, SystemError> {
    let layout = store.layout();
    let Some(_lock) = lock(layout)? else { return Ok(Collected::default()) };
    if !policy.is_trial {
        store.tidy();
    }
    let now = SystemTime::now();
    let runs = runs(outputs, policy, now);
    let surplus = surplus_folders(outputs, policy, now);
    let mut world = World::survey(layout, library, &runs, policy, now)?;
    let mut collected = Collected::default();
    let going = world.choose(policy, &mut collected);
    world.remove(layout, &going, policy, &mut collected)?;
    collected.bytes_left = world.total.saturating_sub(collected.bytes);
    for folder in surplus {
        collected.runs += u64::from(policy.is_trial || remove(&folder)?);
    }
    Ok(collected)
}

/// Two collections at once would each count on what the other removes. The lock goes with the process; `None` where there
/// is no store.
fn lock(layout: &Layout) -> Result<Option<fs::File>, SystemError> {
    let folder = match fs::File::open(layout.root()) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        opened => opened.map_err(SystemError::at("open", layout.root()))?,
    };
    match folder.try_lock() {
        Err(fs::TryLockError::WouldBlock) => {
            Err(SystemError::at("collect in", layout.root())(std::io::Error::other("another collection is going on")))
        }
        // A file system without locks: then at worst both remove the same.
        Ok(()) | Err(fs::TryLockError::Error(_)) => Ok(Some(folder)),
    }
}

/// All that collection looks at.
struct World {
    now: SystemTime,
    records: Vec<Record>,
    blobs: BTreeMap<String, Entry>,
    notes: Vec<Entry>,
    damaged: Vec<Entry>,
    /// How many records name each blob.
    uses: BTreeMap<String, usize>,
    total: u64,
}

impl World {
    fn survey(layout: &Layout, library: &Library, runs: &[Run], policy: &Policy, now: SystemTime) -> Result<Self, SystemError> {
        let blobs: BTreeMap<String, Entry> = entries(layout, Shelf::Blobs)?.into_iter().map(|entry| (entry.name.clone(), entry)).collect();
        let mut records = Vec::new();
        for shelf in [Shelf::Results, Shelf::Publications] {
            records.extend(entries(layout, shelf)?.into_iter().filter_map(|entry| record(library, shelf, entry, &blobs, runs, policy)));
        }
        let mut uses = BTreeMap::new();
        for name in records.iter().flat_map(|record| &record.blobs) {
            *uses.entry(name.clone()).or_default() += 1;
        }
        let (notes, damaged) = (entries(layout, Shelf::Notes)?, entries_of(&layout.damaged())?);
        let sizes = records.iter().map(|record| &record.entry).chain(blobs.values()).chain(&notes).chain(&damaged).map(|entry| entry.size);
        let total = sizes.sum();
        Ok(Self { now, records, blobs, notes, damaged, uses, total })
    }

    fn is_older(&self, time: SystemTime, limit: Duration) -> bool {
        self.now.duration_since(time).is_ok_and(|age| age >= limit)
    }

    /// Chooses the records that go: indices into `records`.
    fn choose(&self, policy: &Policy, collected: &mut Collected) -> Vec<usize> {
        let is_asked = |record: &Record| match policy.older_than {
            Some(limit) => self.is_older(record.used, limit),
            None => policy.keep_last.is_some() && policy.max_bytes.is_none(),
        };
        let mut going: Vec<usize> =
            (0..self.records.len()).filter(|index| !self.records[*index].is_kept && is_asked(&self.records[*index])).collect();
        if let Some(limit) = policy.max_bytes {
            self.choose_until(limit, &mut going);
        }
        let before = going.len();
        going.retain(|index| self.is_older(self.records[*index].used, policy.grace));
        collected.spared += (before - going.len()) as u64;
        going
    }

    /// Adds the records that were not used for longest, until what is left is small enough.
    fn choose_until(&self, limit: u64, going: &mut Vec<usize>) {
        let mut uses = self.uses.clone();
        let mut left = self.total - self.damaged.iter().map(|entry| entry.size).sum::<u64>();
        left -= self.blobs.iter().filter(|(name, _)| !self.uses.contains_key(*name)).map(|(_, entry)| entry.size).sum::<u64>();
        let mut let_go = |record: &Record| {
            let mut freed = record.entry.size;
            for name in &record.blobs {
                let count = uses.get_mut(name).expect("the names were counted");
                *count -= 1;
                freed += if *count == 0 { self.blobs.get(name).map_or(0, |blob| blob.size) } else { 0 };
            }
            freed
        };
        for index in going.iter() {
            left -= let_go(&self.records[*index]);
        }
        let chosen: BTreeSet<usize> = going.iter().copied().collect();
        let mut others: Vec<usize> =
            (0..self.records.len()).filter(|index| !self.records[*index].is_kept && !chosen.contains(index)).collect();
        others.sort_by_key(|index| self.records[*index].used);
        for index in others {
            if left <= limit {
                return;
            }
            left -= let_go(&self.records[index]);
            going.push(index);
        }
    }

    /// Removes records, then the notes that may name them, then what is left without a name.
    fn remove(&mut self, layout: &Layout, going: &[usize], policy: &Policy, collected: &mut Collected) -> Result<(), SystemError> {
        let remove = |entry: &Entry, count: &mut u64, bytes: &mut u64| {
            if policy.is_trial || remove(&entry.path)? {
                *count += 1;
                *bytes += entry.size;
            }
            Ok::<(), SystemError>(())
        };
        for index in going {
            let record = &self.records[*index];
            remove(&record.entry, &mut collected.records, &mut collected.bytes)?;
            for name in &record.blobs {
                *self.uses.get_mut(name).expect("the names were counted") -= 1;
            }
        }
        if !going.is_empty() {
            for note in self.notes.iter().filter(|note| note.name != "signatures") {
                remove(note, &mut collected.notes, &mut collected.bytes)?;
            }
        }
        for (name, blob) in self.blobs.iter().filter(|(name, _)| self.uses.get(*name).is_none_or(|count| *count == 0)) {
            // A run may have written it again since the walk: it is young, and a record is to come.
            let is_young = files::link_status(&layout.path_of(Shelf::Blobs, name))
                .and_then(|status| status.modified())
                .is_ok_and(|modified| !self.is_older(modified, policy.grace));
            if is_young {
                collected.spared += 1;
            } else {
                remove(blob, &mut collected.blobs, &mut collected.bytes)?;
            }
        }
        let is_tight = policy.max_bytes.is_some_and(|limit| self.total - collected.bytes > limit);
        let age = policy.older_than.map_or(DAMAGED_AGE, |limit| limit.min(DAMAGED_AGE));
        for entry in self.damaged.iter().filter(|entry| is_tight || self.is_older(entry.modified, age)) {
            remove(entry, &mut collected.damaged, &mut collected.bytes)?;
        }
        Ok(())
    }
}

fn record(library: &Library, shelf: Shelf, entry: Entry, blobs: &BTreeMap<String, Entry>, runs: &[Run], policy: &Policy) -> Option<Record> {
    let key: Digest = entry.name.parse().ok()?;
    let (named, file) = match shelf {
        Shelf::Results => (library.glance_at_result(&key)?.outputs.into_iter().map(|output| output.content).collect::<Vec<_>>(), None),
        _ => {
            let content = library.glance_at_publication(&key)?.content;
            (vec![content.clone()], Some(content.digest))
        }
    };
    let names_it = |run: &&Run| file.map_or_else(|| run.keys.contains(&key), |file| run.files.contains(&file));
    let is_kept = policy.keep_last.is_some() && runs.iter().any(|run| run.is_kept && names_it(&run));
    let named: Vec<String> = named.into_iter().filter(|blob| blob.inline.is_none()).map(|blob| blob.digest.to_string()).collect();
    let of_blobs = named.iter().filter_map(|name| blobs.get(name)).map(|blob| blob.modified);
    let of_runs = runs.iter().filter(names_it).map(|run| run.when);
    let used = of_blobs.chain(of_runs).fold(entry.modified, SystemTime::max);
    Some(Record { entry, blobs: named, used, is_kept })
}

/// Removes whatever stands there; false if it was gone.
fn remove(path: &PathBuf) -> Result<bool, SystemError> {
    let removed = match files::link_status(path) {
        Ok(status) if status.is_dir() => fs::remove_dir_all(path),
        Ok(_) => files::remove(path),
        Err(error) => Err(error),
    };
    match removed {
        Ok(()) => Ok(true),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(false),
        Err(error) => Err(SystemError::at("remove", path)(error)),
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use rustix::io::Errno;

    use super::*;
    use crate::engine::files::faults::{Fault, Faults};
    use crate::engine::store::verification::verify;
    use crate::engine::trial::{Space, TrialJob, files_below, job};

    const DAY: Duration = Duration::from_secs(24 * 3600);

    fn no_policy() -> Policy {
        Policy { older_than: None, max_bytes: None, keep_last: None, grace: Duration::ZERO, is_trial: false }
    }

    fn collected(space: &Space, policy: &Policy) -> Collected {
        let objects = Arc::new(space.places().folder_store().unwrap().for_inspection());
        let library = Library::new(objects.clone());
        collect(&objects, &library, &space.path("outputs"), policy).unwrap()
    }

    fn chain(say: &str) -> Vec<TrialJob> {
        let long = format!("{say} {}", "long ".repeat(2000));
        vec![job("a", &long).saves(), job("b", "b").of(0).saves()]
    }

    /// Makes everything in the store and the runs so far look older.
    fn age(space: &Space, age: Duration) {
        for path in files_below(space.folder.path()) {
            let modified = fs::metadata(&path).unwrap().modified().unwrap();
            fs::File::open(&path).unwrap().set_modified(modified - age).unwrap();
        }
        for folder in fs::read_dir(space.path("outputs/p/runs")).unwrap().flatten() {
            let modified = folder.metadata().unwrap().modified().unwrap();
            fs::File::open(folder.path()).unwrap().set_modified(modified - age).unwrap();
        }
    }

    fn objects(space: &Space) -> usize {
        ["cas", "ac", "publications"].iter().map(|shelf| files_below(&space.path("store/v1").join(shelf)).len()).sum()
    }

    #[test]
    fn without_a_policy_only_what_no_record_names_goes() {
        let space = Space::new();
        space.run(&chain("x"));
        assert_eq!(collected(&space, &no_policy()).records, 0);
        fs::remove_dir_all(space.path("store/v1/ac")).unwrap();
        let spared = collected(&space, &Policy { grace: DAY, ..no_policy() });
        assert_eq!((spared.blobs, spared.spared), (0, 2), "young blobs stay");
        let gone = collected(&space, &no_policy());
        assert_eq!((gone.blobs, gone.spared), (2, 0));
        // The index still knows the results: nothing runs until someone wants one.
        assert_eq!(space.ran(&chain("x")), 0);
        let mut more = chain("x");
        more.push(job("c", "c").of(0));
        assert_eq!(space.ran(&more), 2);
    }

    #[test]
    fn old_results_go_and_what_was_used_lately_stays() {
        let space = Space::new();
        space.run(&chain("old"));
        age(&space, 10 * DAY);
        space.run(&chain("new"));
        let policy = Policy { older_than: Some(5 * DAY), ..no_policy() };
        let before = objects(&space);
        let would = collected(&space, &Policy { is_trial: true, ..policy });
        assert_eq!(objects(&space), before, "a trial removes nothing");
        let gone = collected(&space, &policy);
        assert_eq!(gone, would);
        assert_eq!((gone.records, gone.blobs), (4, 4), "{gone:?}");
        assert_eq!(space.ran(&chain("new")), 0);
        assert_eq!(space.ran(&chain("old")), 2);
    }

    #[test]
    fn a_run_that_changes_nothing_keeps_its_results_young() {
        let space = Space::new();
        space.run(&chain("x"));
        age(&space, 10 * DAY);
        assert_eq!(space.ran(&chain("x")), 0);
        assert_eq!(collected(&space, &Policy { older_than: Some(5 * DAY), ..no_policy() }).records, 0);
    }

    #[test]
    fn the_last_runs_keep_what_they_name() {
        let space = Space::new();
        for say in ["one", "two", "three"] {
            space.run(&chain(say));
            age(&space, DAY);
        }
        let gone = collected(&space, &Policy { keep_last: Some(2), ..no_policy() });
        assert_eq!(gone.records, 4, "{gone:?}");
        assert_eq!((space.ran(&chain("three")), space.ran(&chain("two")), space.ran(&chain("one"))), (0, 0, 2));
        // Kept whatever else is asked.
        age(&space, DAY);
        collected(&space, &Policy { keep_last: Some(1), max_bytes: Some(0), ..no_policy() });
        assert_eq!((space.ran(&chain("one")), space.ran(&chain("two"))), (0, 2));
    }

    #[test]
    fn a_collection_that_is_cut_short_anywhere_leaves_no_record_without_its_blob() {
        // From the n-th call on nothing can be removed, as after a kill.
        for at in 1.. {
            let space = Space::new();
            space.run(&chain("x"));
            let objects = Arc::new(space.places().folder_store().unwrap().for_inspection());
            let library = Library::new(objects.clone());
            let faults = Faults::below(&space.path("store"), at, true, Fault::Error(Errno::IO));
            let collected = collect(&objects, &library, &space.path("outputs"), &Policy { max_bytes: Some(0), ..no_policy() });
            let is_met = faults.count() >= at;
            drop(faults);
            let findings = verify(objects.layout(), &library).unwrap();
            assert_eq!(findings.damage, [], "call {at}");
            if !is_met {
                assert!(collected.unwrap().records > 0);
                return;
            }
        }
    }

    #[test]
    fn a_size_is_kept_to_by_letting_the_longest_unused_go() {
        let space = Space::new();
        for say in ["one", "two", "three"] {
            space.run(&chain(say));
            age(&space, DAY);
        }
        let total = collected(&space, &no_policy()).bytes_left;
        let gone = collected(&space, &Policy { max_bytes: Some(total / 2), ..no_policy() });
        assert!(gone.bytes_left <= total / 2 && gone.records > 0, "{gone:?}");
        assert_eq!(space.ran(&chain("three")), 0);
        let spared = collected(&space, &Policy { max_bytes: Some(0), grace: 100 * DAY, ..no_policy() });
        assert!(spared.records == 0 && spared.spared > 0);
    }

    #[test]
    fn damaged_objects_go_after_a_week_and_a_second_collection_waits() {
        let space = Space::new();
        space.run(&chain("x"));
        fs::create_dir_all(space.path("store/v1/damaged/folder")).unwrap();
        fs::write(space.path("store/v1/damaged/cas-x"), "x").unwrap();
        assert_eq!(collected(&space, &no_policy()).damaged, 0);
        age(&space, 8 * DAY);
        fs::File::open(space.path("store/v1/damaged/folder")).unwrap().set_modified(SystemTime::now() - 8 * DAY).unwrap();
        assert_eq!(collected(&space, &no_policy()).damaged, 2);

        let root = fs::File::open(space.path("store/v1")).unwrap();
        root.lock().unwrap();
        let objects = space.places().folder_store().unwrap();
        let library = Library::new(Arc::new(space.places().folder_store().unwrap()));
        let refused = collect(&objects, &library, &space.path("outputs"), &no_policy());
        assert!(refused.unwrap_err().to_string().contains("another collection"));
    }

    #[test]
    fn a_run_beside_a_collection_of_everything_is_right() {
        let space = Space::new();
        let jobs: Vec<TrialJob> = (0..20).map(|n| job("leaf", &format!("{n} {}", "long ".repeat(1000))).at(n).saves()).collect();
        let expected = Space::new().run(&jobs).result_id;
        space.run(&jobs);
        let is_over = std::sync::atomic::AtomicBool::new(false);
        std::thread::scope(|scope| {
            scope.spawn(|| {
                while !is_over.load(std::sync::atomic::Ordering::Relaxed) {
                    collected(&space, &Policy { max_bytes: Some(0), ..no_policy() });
                }
            });
            for _ in 0..10 {
                let _ = fs::remove_dir_all(space.path("outputs/p/leaf"));
                let summary = space.run(&jobs);
                assert_eq!((summary.failures.len(), summary.result_id), (0, expected), "{summary:?}");
            }
            is_over.store(true, std::sync::atomic::Ordering::Relaxed);
        });
    }
}

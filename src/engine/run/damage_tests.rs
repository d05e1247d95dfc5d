//! Damage of every kind to every sort of object: noticed by the run that uses it, named, set aside and healed.

use std::fs;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};

use rustix::fs::{CWD, FileType, Mode, mknodat};

use crate::engine::manifest::Status;
use crate::engine::trial::{Space, TrialJob, files_below, job};

const KINDS: [&str; 9] = ["truncated", "lengthened", "flipped", "emptied", "exchanged", "folder", "link", "pipe", "gone"];

fn damage(kind: &str, path: &Path, other: &Path) {
    let bytes = fs::read(path).unwrap();
    let replaced = |bytes: &[u8]| fs::write(path, bytes).unwrap();
    match kind {
        "truncated" => replaced(&bytes[..bytes.len() - 1]),
        "lengthened" => replaced(&[&bytes[..], b"x"].concat()),
        "flipped" => {
            let mut bytes = bytes;
            let middle = bytes.len() / 2;
            bytes[middle] ^= 0x10;
            replaced(&bytes);
        }
        "emptied" => replaced(b""),
        "exchanged" => replaced(&fs::read(other).unwrap()),
        _ => {
            fs::remove_file(path).unwrap();
            match kind {
                "folder" => fs::create_dir(path).unwrap(),
                // To a copy of the very bytes: a link is damage even where it leads to the right thing.
                "link" => {
                    let store = path.ancestors().find(|folder| folder.ends_with("store")).unwrap();
                    let copy = store.with_file_name("copy");
                    fs::write(&copy, &bytes).unwrap();
                    symlink(&copy, path).unwrap();
                }
                "pipe" => mknodat(CWD, path, FileType::Fifo, Mode::RUSR | Mode::WUSR, 0).unwrap(),
                _ => {}
            }
        }
    }
}

fn jobs(say: &str) -> Vec<TrialJob> {
    let long = "long ".repeat(2000);
    vec![job("trunk", &long).saves(), job("mid", "m").of(0).saves(), job("leaf", say).of(1).saves()]
}

fn shelf(space: &Space, shelf: &str) -> Vec<PathBuf> {
    files_below(&space.path("store/v1").join(shelf))
}

fn published(space: &Space) -> Vec<Vec<u8>> {
    ["trunk.txt", "mid.txt", "leaf.txt"].map(|path| fs::read(space.path("outputs/p").join(path)).unwrap()).into()
}

/// Damages each object of a shelf in each way before a run, which uses so many of them.
fn heal_all(name: &str, used: usize, prepare: impl Fn(&Space)) {
    let right = {
        let space = Space::new();
        space.run(&jobs("l"));
        published(&space)
    };
    for kind in KINDS {
        let space = Space::new();
        space.run(&jobs("l"));
        let count = shelf(&space, name).len();
        assert!(count >= 2, "{name}: {count} objects");
        let mut told = 0;
        for index in 0..count {
            let objects = shelf(&space, name);
            let (path, other) = (&objects[index], &objects[(index + 1) % count]);
            let named = path.file_name().unwrap().to_str().unwrap().to_owned();
            damage(kind, path, other);
            prepare(&space);
            let summary = space.run(&jobs("l"));
            let place = format!("{name}, {kind}, {named}");
            assert_eq!(summary.status, Status::Done, "{place}: {:?}", summary.failures);
            assert_eq!(published(&space), right, "{place}");
            told += usize::from(summary.warnings.iter().any(|warning| warning.message.contains(&named)));
            // Healed: the same run again has nothing to say.
            prepare(&space);
            let again = space.run(&jobs("l"));
            assert_eq!((again.status, again.warnings.len()), (Status::Done, 0), "{place}: {:?}", again.warnings);
            // As it was before, for the next object.
            fs::remove_dir_all(space.path("store")).unwrap();
            fs::remove_dir_all(space.path("outputs")).unwrap();
            space.run(&jobs("l"));
        }
        // A record or note that is gone was never there, for all that anyone can tell.
        let expected = if kind == "gone" && name != "cas" { 0 } else { used };
        assert_eq!(told, expected, "{name}, {kind}: damage that was not told by name");
    }
}

#[test]
fn a_damaged_blob_is_told_and_healed_by_the_run_that_reads_it() {
    // First all files are copied from the store, then they are made from the results again.
    let outputs = |space: &Space| fs::remove_dir_all(space.path("outputs")).unwrap();
    heal_all("cas", 3, outputs);
    heal_all("cas", 3, |space| {
        outputs(space);
        fs::remove_dir_all(space.path("store/v1/publications")).unwrap();
        forget_index(space);
    });
}

#[test]
fn a_damaged_record_of_a_result_is_told_and_healed_by_the_run_that_reads_it() {
    heal_all("ac", 3, forget_index);
}

#[test]
fn a_damaged_record_of_a_file_is_told_and_healed_by_the_run_that_reads_it() {
    heal_all("publications", 3, forget_index);
}

#[test]
fn a_damaged_index_is_told_and_healed_by_the_next_run() {
    let space = Space::new();
    space.run(&jobs("l"));
    let right = published(&space);
    for kind in KINDS.iter().filter(|kind| **kind != "exchanged") {
        for path in shelf(&space, "notes") {
            damage(kind, &path, &path);
            let name = path.file_name().unwrap().to_str().unwrap();
            let summary = space.run(&jobs("l"));
            assert_eq!(summary.measured.jobs.get("ran"), None, "{kind}, {name}: the records serve");
            assert_eq!((summary.status, published(&space)), (Status::Done, right.clone()));
            let is_told = summary.warnings.iter().any(|warning| warning.message.contains(name));
            assert_eq!(is_told, *kind != "gone", "{kind}, {name}: {:?}", summary.warnings);
            assert!(path.is_file() || name == "signatures", "{kind}, {name}: written again");
        }
    }
}

/// Every record is read.
fn forget_index(space: &Space) {
    let _ = fs::remove_dir_all(space.path("store/v1/notes"));
}

#[test]
fn a_blob_without_its_record_is_no_result() {
    let space = Space::new();
    space.run(&jobs("l"));
    fs::remove_dir_all(space.path("store/v1/ac")).unwrap();
    forget_index(&space);
    assert_eq!(space.ran(&jobs("l")), 3);
}

#[test]
fn an_input_that_is_replaced_with_the_same_size_and_time_never_poisons_the_store() {
    let space = Space::new();
    let path = space.path("input.txt");
    let old = std::time::SystemTime::now() - std::time::Duration::from_secs(1000);
    let write = |text: &str| {
        // As a program does that replaces a file and keeps its time.
        fs::write(space.path("new.txt"), text).unwrap();
        fs::File::options().write(true).open(space.path("new.txt")).unwrap().set_modified(old).unwrap();
        fs::rename(space.path("new.txt"), &path).unwrap();
    };
    let jobs = [job("read", "r").reads(&path).saves()];
    for text in ["one", "two", "six", "one"] {
        write(text);
        space.run(&jobs);
        assert_eq!(space.published("read.txt"), format!("r{text} of read []\n"));
    }
}

#[test]
fn an_input_that_changes_while_the_run_goes_on_fails_its_job_and_leaves_no_result() {
    let space = Space { threads: 1, ..Space::new() };
    let path = space.path("input.txt");
    fs::write(&path, "one").unwrap();
    let jobs = [job("slow", "s").mood(crate::engine::trial::Mood::Slow), job("read", "r").reads(&path).of(0).saves()];
    for change in ["same", "pipe", "gone"] {
        fs::write(&path, "one").unwrap();
        let summary = std::thread::scope(|scope| {
            scope.spawn(|| {
                while !space.path("outputs/p").exists() {
                    std::thread::yield_now();
                }
                std::thread::sleep(std::time::Duration::from_millis(60));
                match change {
                    "same" => fs::write(&path, "two").unwrap(),
                    _ => damage(change, &path, &path),
                }
            });
            space.run(&jobs)
        });
        assert_eq!(summary.status, Status::Failed, "{change}");
        assert!(summary.failures[0].message.contains("changed while the pipeline ran"), "{:?}", summary.failures);
        let _ = fs::remove_file(&path);
        fs::write(&path, "two").unwrap();
        assert_eq!(space.run(&jobs).status, Status::Done);
        assert_eq!(space.published("read.txt"), "rtwo(s) of read []\n");
        fs::remove_dir_all(space.path("store")).unwrap();
        fs::remove_dir_all(space.path("outputs")).unwrap();
    }
}

#[test]
fn a_file_that_does_not_fit_in_memory_fails_its_job_before_it_starts() {
    let space = Space { memory: 1000, ..Space::new() };
    let path = space.path("input.txt");
    fs::write(&path, "x".repeat(2000)).unwrap();
    let summary = space.run(&[job("read", "r").reads(&path)]);
    assert!(summary.failures[0].message.starts_with("needs about 3.9 KiB, more than"), "{:?}", summary.failures);
    assert!(!summary.failures[0].is_of_the_system);
}

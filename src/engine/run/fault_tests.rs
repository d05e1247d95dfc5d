//! Every system call on the files of the store and of the outputs is made to fail, one after the other.
//!
//! After each fault the run either is right, or ends with a message that names a path; and the next run is right and
//! repeats only what was not finished.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use rustix::io::Errno;

use crate::engine::files::faults::{Fault, Faults};
use crate::engine::manifest::Status;
use crate::engine::run::{RunError, Summary};
use crate::engine::trial::{Space, TrialJob, files_below, graph, job};

/// Long results, which stand in blobs, and short ones, which stand in their records.
fn jobs(say: &str) -> Vec<TrialJob> {
    let long = "long ".repeat(2000);
    vec![
        job("trunk", &long),
        job("mid", say).of(0).saves(),
        job("leaf", "l").of(1).keeps(20).saves(),
        job("all", "a").all([0, 1, 2]).saves(),
    ]
}

fn published(space: &Space) -> BTreeMap<String, Vec<u8>> {
    let root = space.path("outputs/p");
    let files = files_below(&root).into_iter().filter(|path| path.extension().is_some_and(|extension| extension == "txt"));
    files.map(|path| (path.strip_prefix(&root).unwrap().display().to_string(), fs::read(&path).unwrap())).collect()
}

/// How the world is before the run in which calls fail.
struct Scene {
    name: &'static str,
    prepare: fn(&Space),
}

const SCENES: [Scene; 4] = [
    Scene { name: "from nothing", prepare: |_| {} },
    Scene { name: "one leaf changed", prepare: |space| drop(space.run(&jobs("another"))) },
    Scene {
        name: "outputs gone",
        prepare: |space| {
            space.run(&jobs("m"));
            fs::remove_dir_all(space.path("outputs")).unwrap();
        },
    },
    Scene {
        name: "outputs and the index gone",
        prepare: |space| {
            space.run(&jobs("m"));
            fs::remove_dir_all(space.path("outputs")).unwrap();
            fs::remove_dir_all(space.path("store/v1/notes")).unwrap();
        },
    },
];

/// One thread, so that the n-th call is the same in every run; in memory, where that is known to be, since there are
/// thousands of runs and each asks the disk to be sure.
fn space() -> Space {
    let folder = tempfile::tempdir_in("/dev/shm").or_else(|_| tempfile::tempdir()).unwrap();
    Space { threads: 1, folder, ..Space::new() }
}

fn is_of_the_system(result: &Result<Summary, RunError>) -> bool {
    let message = match result {
        Err(RunError::System(error)) => error.to_string(),
        Err(RunError::Inputs(_)) => return false,
        Ok(summary) => {
            let failure = summary.failures.iter().find(|failure| failure.is_of_the_system).map(|failure| failure.message.clone());
            match failure.or_else(|| summary.system_error.as_ref().map(ToString::to_string)) {
                Some(message) => message,
                None => return false,
            }
        }
    };
    message.contains("cannot ") && message.contains('/')
}

/// One fault; false once the run makes fewer calls.
fn survive(scene: &Scene, at: usize, is_lasting: bool, fault: Fault, right: &BTreeMap<String, Vec<u8>>) -> bool {
    let space = space();
    (scene.prepare)(&space);
    let place = format!("{}: call {at}, {fault:?}, lasting: {is_lasting}", scene.name);

    let faults = Faults::below(space.folder.path(), at, is_lasting, fault);
    let result = space.try_run(graph(space.folder.path(), &jobs("m")));
    let is_met = faults.count() >= at;
    drop(faults);
    let is_done = result.as_ref().is_ok_and(|summary| summary.status == Status::Done && summary.system_error.is_none());
    if is_done {
        assert_eq!(published(&space), *right, "{place}: done, but not right");
    } else {
        assert!(is_of_the_system(&result), "{place}: {result:?}");
    }
    for (path, bytes) in published(&space) {
        let is_earlier = scene.name == "one leaf changed";
        assert!(bytes == right[&path] || is_earlier, "{place}: {path} is wrong or half");
    }

    // What has its record, and its bytes, is not made again.
    let before = records(&space);
    let next = space.run(&jobs("m"));
    assert_eq!(next.status, Status::Done, "{place}: {:?}", next.failures);
    assert_eq!(published(&space), *right, "{place}: the next run is not right");
    let ran = next.measured.jobs.get("ran").copied().unwrap_or(0) as usize;
    let written = records(&space).difference(&before).count();
    assert!(ran == written || !next.warnings.is_empty(), "{place}: {ran} jobs ran, {written} records are new");
    assert!(space.run(&jobs("m")).measured.jobs.get("ran").is_none(), "{place}");
    is_met
}

fn records(space: &Space) -> std::collections::BTreeSet<std::path::PathBuf> {
    files_below(&space.path("store/v1/ac")).into_iter().collect()
}

fn right() -> BTreeMap<String, Vec<u8>> {
    let space = space();
    space.run(&jobs("m"));
    published(&space)
}

fn survive_all(is_lasting: bool, fault: Fault) {
    survive_scenes(&SCENES, is_lasting, fault);
}

fn survive_scenes(scenes: &[Scene], is_lasting: bool, fault: Fault) {
    let right = right();
    assert_eq!(right.len(), 3);
    for scene in scenes {
        let mut at = 1;
        while survive(scene, at, is_lasting, fault, &right) {
            at += 1;
        }
        assert!(at > 20, "{}: only {at} calls were counted", scene.name);
    }
}

#[test]
fn an_input_output_error_in_any_one_call_does_no_harm() {
    survive_all(false, Fault::Error(Errno::IO));
}

#[test]
fn a_disk_that_is_full_from_any_call_on_does_no_harm() {
    survive_all(true, Fault::Error(Errno::NOSPC));
}

#[test]
fn a_permission_that_is_missing_for_any_one_call_does_no_harm() {
    survive_scenes(&SCENES[2..], false, Fault::Error(Errno::ACCESS));
}

#[test]
fn a_disk_that_fills_within_any_write_does_no_harm() {
    survive_scenes(&SCENES[..1], false, Fault::Short);
}

#[test]
fn an_interrupted_call_is_made_again() {
    survive_scenes(&SCENES[..1], false, Fault::Error(Errno::INTR));
}

#[test]
fn too_many_open_files_at_any_call_do_no_harm() {
    survive_scenes(&SCENES[3..], true, Fault::Error(Errno::MFILE));
}

#[test]
fn a_rule_counts_only_what_is_below_its_folder() {
    let folder = tempfile::tempdir().unwrap();
    let faults = Faults::below(folder.path(), 1, false, Fault::Error(Errno::IO));
    assert!(crate::engine::files::status(Path::new("/")).is_ok());
    assert_eq!(faults.count(), 0);
    assert!(crate::engine::files::status(&folder.path().join("x")).is_err());
    assert_eq!(faults.count(), 1);
}

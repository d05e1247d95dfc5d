//! Whole runs over small graphs: what runs, what is kept, what is healed.

use std::fs;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use crate::engine::freshness::HIT_REASON;
use crate::engine::manifest::{Outcome, ShortManifest, Status};
use crate::engine::run::ahead::Ahead;
use crate::engine::run::{self, RunError};
use crate::engine::trial::{Mood, Space, TrialJob, files_below, graph, job};

/// A trunk, two leaves, a gather; all but the trunk published.
pub fn tree(trunk: &str, leaf: &str) -> Vec<TrialJob> {
    vec![job("trunk", trunk), job("one", leaf).of(0).saves(), job("two", "two").of(0).saves(), job("both", "both").all([1, 2]).saves()]
}

#[test]
fn a_run_publishes_and_a_second_one_does_nothing() {
    let space = Space::new();
    let first = space.run(&tree("t", "l"));
    assert_eq!((first.status, first.measured.jobs["ran"], first.measured.files_written), (Status::Done, 4, 3));
    assert_eq!(space.published("one.txt"), "l(t) of one []\n");
    assert_eq!(space.published("both.txt"), "both+one[]l(t)+two[]two(t) of both []\n");
    let manifest = fs::read(space.path("outputs/p/manifest.json")).unwrap();

    let second = space.run(&tree("t", "l"));
    assert_eq!(second.results_of, Some(first.run_id.clone()));
    assert_eq!(second.result_id, first.result_id);
    assert_eq!(fs::read(space.path("outputs/p/manifest.json")).unwrap(), manifest);
    let short = fs::read(space.path(&format!("outputs/p/runs/{}/manifest.json", second.run_id))).unwrap();
    assert_eq!(serde_json::from_slice::<ShortManifest>(&short).unwrap().results_of, first.run_id);
    assert_eq!(fs::read(space.path(&format!("outputs/p/runs/{}/manifest.json", first.run_id))).unwrap(), manifest);
}

#[test]
fn exactly_what_must_run_runs() {
    let space = Space::new();
    assert_eq!(space.ran(&tree("t", "l")), 4);
    assert_eq!(space.ran(&tree("t", "L")), 2, "a leaf and the gather");
    assert_eq!(space.ran(&tree("t", "l")), 0, "going back");
    // The trunk gives the same bytes: nothing behind it runs.
    let mut cut = tree("t and more", "l");
    cut[0] = cut[0].clone().keeps(1);
    assert_eq!(space.ran(&cut), 1, "early cutoff");
    fs::remove_dir_all(space.path("outputs/p")).unwrap();
    assert_eq!(space.ran(&cut), 0, "outputs come from the store");
    assert_eq!(space.published("one.txt"), "l(t) of one []\n");
    // Without the index the records serve.
    fs::remove_dir_all(space.path("store/v1/notes")).unwrap();
    assert_eq!(space.ran(&cut), 0);
}

#[test]
fn every_job_says_why_it_ran() {
    let space = Space::new();
    space.run(&tree("t", "l"));
    assert!(space.outcomes().values().all(|(outcome, reason)| *outcome == Outcome::Ran && reason == "never ran"));
    space.run(&tree("t", "L"));
    let outcomes = space.outcomes();
    assert_eq!(outcomes["trunk"], (Outcome::Hit, HIT_REASON.into()));
    assert_eq!(outcomes["one"], (Outcome::Ran, "parameter say l -> L".into()));
    assert_eq!(outcomes["both"], (Outcome::Ran, "input one changed".into()));
    let mut forced = tree("t", "L");
    forced[2] = forced[2].clone().forced();
    assert_eq!(space.ran(&forced), 1);
    assert_eq!(space.outcomes()["two"], (Outcome::Ran, "forced".into()));
}

#[test]
fn a_plan_says_the_same_beforehand_and_writes_nothing() {
    let space = Space::new();
    let expect = |jobs: &[TrialJob]| {
        let (entries, _) = run::plan(&graph(space.folder.path(), jobs), Ahead::begin(&space.places(), "p")).unwrap();
        entries.into_iter().map(|entry| (entry.stage, entry.outcome, entry.reason)).collect::<Vec<_>>()
    };
    assert!(expect(&tree("t", "l")).iter().all(|(_, outcome, reason)| *outcome == Outcome::Run && reason == "never ran"));
    assert!(!space.path("outputs").exists() && !space.path("store").exists());
    space.run(&tree("t", "l"));
    let planned = expect(&tree("t", "L"));
    assert_eq!(planned[0], ("trunk".into(), Outcome::Hit, HIT_REASON.into()));
    assert_eq!(planned[1], ("one".into(), Outcome::Run, "parameter say l -> L".into()));
    assert_eq!(planned[3], ("both".into(), Outcome::Maybe, "waits for one".into()));
}

#[test]
fn a_replaced_axis_value_is_told_as_a_change_and_a_new_one_is_not() {
    let space = Space::new();
    space.run(&[job("a", "1.8").at(1), job("a", "2.0").at(5)]);
    space.run(&[job("a", "2.2").at(2), job("a", "2.0").at(5)]);
    let jobs = space.manifest().jobs;
    assert_eq!(jobs[0].reason, "parameter say 1.8 -> 2.2");
    space.run(&[job("a", "2.2").at(2), job("a", "2.0").at(5), job("a", "9").at(9)]);
    assert_eq!(space.manifest().jobs[2].reason, "never ran");
}

#[test]
fn an_input_file_counts_by_its_content() {
    let space = Space::new();
    let path = space.path("input.txt");
    let jobs = [job("read", "r").reads(&path).saves()];
    fs::write(&path, "one").unwrap();
    assert_eq!(space.ran(&jobs), 1);
    fs::write(&path, "one").unwrap();
    assert_eq!(space.ran(&jobs), 0, "touched");
    fs::write(&path, "two").unwrap();
    assert_eq!(space.ran(&jobs), 1);
    assert_eq!(space.outcomes()["read"].1, "file input.txt changed");
    assert_eq!(space.published("read.txt"), "rtwo of read []\n");
    fs::remove_file(&path).unwrap();
    let error = space.try_run(graph(space.folder.path(), &jobs)).unwrap_err();
    assert!(matches!(&error, RunError::Inputs(errors) if errors.len() == 1), "{error}");
}

#[test]
fn damage_of_any_blob_or_record_is_healed_in_the_run_that_meets_it() {
    let long = "long ".repeat(2000);
    let jobs = |say: &str| {
        vec![job("trunk", &long), job("mid", "m").of(0), job("leaf", say).of(1).saves(), job("all", say).all([0, 1, 2]).saves()]
    };
    let space = Space::new();
    space.run(&jobs("0"));
    let clean = Space::new();
    clean.run(&jobs("SAY"));
    let expected = |say: &str| ["leaf.txt", "all.txt"].map(|path| clean.published(path).replace("SAY", say));
    let mut files = space.blobs();
    files.extend(files_below(&space.path("store/v1/ac")));
    let mut healed = 0;
    for (round, path) in files.iter().enumerate().filter(|(_, path)| path.exists()) {
        // Flipped, shortened, lengthened, emptied, gone, replaced by a folder, a link.
        let bytes = fs::read(path).unwrap();
        for damage in 0..7 {
            if !path.exists() {
                continue;
            }
            fs::remove_file(path).unwrap();
            let mut flipped = bytes.clone();
            flipped[bytes.len() / 2] ^= 0x10;
            match damage {
                0 => fs::write(path, flipped).unwrap(),
                1 => fs::write(path, &bytes[..bytes.len() - 1]).unwrap(),
                2 => fs::write(path, [&bytes[..], b"x"].concat()).unwrap(),
                3 => fs::write(path, "").unwrap(),
                4 => {}
                5 => fs::create_dir(path).unwrap(),
                _ => std::os::unix::fs::symlink("/etc/passwd", path).unwrap(),
            }
            fs::remove_dir_all(space.path("outputs")).unwrap();
            fs::remove_dir_all(space.path("store/v1/notes")).unwrap();
            let say = format!("{round}.{damage}");
            let summary = space.run(&jobs(&say));
            assert_eq!(summary.status, Status::Done, "{summary:?}");
            assert_eq!(["leaf.txt", "all.txt"].map(|path| space.published(path)), expected(&say));
            healed += usize::from(!summary.warnings.is_empty());
        }
    }
    assert!(healed > 10, "{healed} of the damages were met and reported");
}

#[test]
fn a_failure_stops_the_run_or_with_keep_going_only_what_depends_on_it() {
    let jobs =
        [job("bad", "b").mood(Mood::Fails), job("after", "a").of(0), job("other", "o").saves(), job("panic", "p").mood(Mood::Panics)];
    let mut space = Space::new();
    space.keep_going = true;
    let summary = space.run(&jobs);
    assert_eq!(summary.status, Status::Failed);
    let outcomes = space.outcomes();
    assert_eq!(outcomes["bad"].0, Outcome::Failed);
    assert_eq!(outcomes["after"], (Outcome::Skipped, "input bad failed".into()));
    assert_eq!(outcomes["other"].0, Outcome::Ran);
    let messages: Vec<&str> = summary.failures.iter().map(|failure| failure.message.as_str()).collect();
    assert!(messages.contains(&"the text is bad") && messages.iter().any(|text| text.contains("out of luck")), "{messages:?}");
    assert_eq!(space.manifest().status, Status::Failed);

    space.keep_going = false;
    space.threads = 1;
    let alone = Space { threads: 1, ..Space::new() };
    alone.run(&jobs);
    assert!(alone.outcomes().values().any(|(outcome, reason)| *outcome == Outcome::Skipped && reason == "the run ended before"));
}

#[test]
fn what_does_not_fit_in_memory_fails_before_it_starts() {
    let space = Space::new();
    let summary = space.run(&[job("big", "b").mood(Mood::Greedy)]);
    assert_eq!(summary.failures[0].message, "needs about 1.0 TiB, more than the 1.0 GiB it may take");
}

#[test]
fn little_memory_changes_nothing_but_the_time() {
    let long = "x".repeat(100_000);
    let mut jobs: Vec<TrialJob> = (0..20).map(|n| job("leaf", &format!("{n}{long}")).at(n).saves()).collect();
    jobs.push(job("all", "").all(0..20).keeps(10).saves());
    let roomy = Space::new();
    roomy.run(&jobs);
    let mut narrow = Space::new();
    narrow.memory = 2_300_000;
    let summary = narrow.run(&jobs);
    assert_eq!(summary.status, Status::Done, "{:?}", summary.failures);
    assert!(summary.measured.memory_peak <= narrow.memory + 200_000, "{:?}", summary.measured);
    assert_eq!(narrow.manifest().result_id, roomy.manifest().result_id);
}

#[test]
fn an_interrupt_ends_the_run_soon_and_keeps_what_is_finished() {
    let space = Space::new();
    let jobs = [job("first", "f").saves(), job("endless", "e").of(0).mood(Mood::Waits).saves(), job("after", "a").of(1)];
    let flag: Arc<AtomicBool> = space.interrupted.clone();
    let published = space.path("outputs/p/first.txt");
    let interrupter = std::thread::spawn(move || {
        while !published.exists() {
            std::thread::yield_now();
        }
        flag.store(true, Ordering::Relaxed);
        Instant::now()
    });
    let summary = space.run(&jobs);
    assert!(interrupter.join().unwrap().elapsed() < Duration::from_secs(1));
    assert_eq!(summary.status, Status::Interrupted);
    let outcomes = space.outcomes();
    assert_eq!((outcomes["first"].0, outcomes["endless"].0, outcomes["after"].0), (Outcome::Ran, Outcome::Interrupted, Outcome::Skipped));
    space.interrupted.store(false, Ordering::Relaxed);
    let again = [jobs[0].clone(), jobs[1].clone().mood(Mood::Fine), jobs[2].clone()];
    assert_eq!(space.ran(&again), 2);
    assert_eq!(std::fs::read_dir(space.path("outputs/.tmp")).unwrap().count(), 0);
}

#[test]
fn a_changed_or_missing_published_file_is_put_right() {
    let space = Space::new();
    space.run(&tree("t", "l"));
    fs::write(space.path("outputs/p/one.txt"), "edited").unwrap();
    fs::remove_file(space.path("outputs/p/two.txt")).unwrap();
    let summary = space.run(&tree("t", "l"));
    assert_eq!((summary.measured.files_written, summary.results_of), (2, None));
    assert!(summary.warnings.iter().any(|warning| warning.message.contains("`one.txt` had been changed")));
    assert_eq!(space.published("one.txt"), "l(t) of one []\n");
    assert!(space.run(&tree("t", "l")).results_of.is_some());
}

#[test]
fn files_that_are_no_longer_published_go_unless_someone_changed_them() {
    let space = Space::new();
    let both = [job("a", "a").at(1).saves(), job("b", "b").saves(), job("c", "c").saves()];
    space.run(&both);
    fs::write(space.path("outputs/p/b.txt"), "mine").unwrap();

    let mut part = graph(space.folder.path(), &both[2..]);
    part.is_whole = false;
    space.run_graph(part);
    assert!(space.path("outputs/p/a/n=1.txt").exists(), "a partial run removes nothing");
    assert_eq!(space.manifest().kept.len(), 2);

    let summary = space.run(&both[2..]);
    assert_eq!(summary.measured.files_removed, 1);
    assert!(!space.path("outputs/p/a").exists());
    assert_eq!(space.published("b.txt"), "mine");
    assert!(summary.warnings.iter().any(|warning| warning.message.contains("b.txt")));
}

#[test]
fn going_back_without_publishing_still_writes_a_manifest() {
    let space = Space::new();
    let one = space.run(&[job("a", "1")]);
    space.run(&[job("a", "2")]);
    let back = space.run(&[job("a", "1")]);
    assert_eq!(back.results_of, None);
    assert_eq!(back.result_id, one.result_id);
    assert_eq!(space.manifest().run_id, back.run_id);
}

#[test]
fn warnings_survive_a_hit_and_are_told_once_a_stage() {
    let space = Space::new();
    let jobs = [job("loud", "noisy").at(1), job("loud", "noisy").at(2), job("odd", "biased")];
    let texts = |space: &Space| {
        let warnings = space.manifest().warnings;
        warnings.into_iter().map(|warning| (warning.stage, warning.message, warning.jobs)).collect::<Vec<_>>()
    };
    space.run(&jobs);
    let expected = vec![("loud".into(), "this is noisy".into(), 2), ("odd".into(), "this is biased".into(), 1)];
    assert_eq!(texts(&space), expected);
    space.run(&[jobs[0].clone(), jobs[1].clone(), jobs[2].clone(), job("new", "n")]);
    assert_eq!(texts(&space), expected);
}

#[test]
fn equal_jobs_of_two_stages_run_once() {
    let space = Space { threads: 4, ..Space::new() };
    let jobs: Vec<TrialJob> = (0..10).map(|n| job("same", "s").at(n)).chain([job("other", "s").saves()]).collect();
    assert_eq!(space.ran(&jobs), 1);
    assert_eq!(space.published("other.txt"), "s of other []\n");
}

#[test]
fn the_result_is_the_same_for_any_number_of_threads() {
    let mut jobs = vec![job("trunk", "t")];
    for n in 0..30 {
        jobs.push(job("leaf", &n.to_string()).at(n).of(0).saves());
    }
    jobs.push(job("all", "a").all(1..31).saves());
    let ids: Vec<_> = [1, 2, 8].map(|threads| Space { threads, ..Space::new() }.run(&jobs).result_id).to_vec();
    assert!(ids.iter().all(|id| *id == ids[0]));
}

#[test]
fn a_format_that_cannot_be_written_is_the_jobs_failure() {
    let space = Space::new();
    let summary = space.run(&[job("a", "a").saves_as("none")]);
    assert_eq!(summary.status, Status::Failed);
    assert_eq!(summary.failures[0].message, "cannot be saved as `none`: this text has no such form");
}

#[test]
fn an_output_folder_that_is_a_file_is_the_systems_failure() {
    let space = Space::new();
    fs::write(space.path("outputs"), "").unwrap();
    let error = space.try_run(graph(space.folder.path(), &tree("t", "l"))).unwrap_err();
    assert!(matches!(&error, RunError::System(_)) && error.to_string().contains("outputs"), "{error}");
}

#[test]
fn a_manifest_names_no_absolute_path() {
    let space = Space::new();
    let path = space.path("input.txt");
    fs::write(&path, "x").unwrap();
    space.run(&[job("read", "r").reads(&path).saves()]);
    let text = fs::read_to_string(space.path("outputs/p/manifest.json")).unwrap();
    assert!(!text.contains(space.folder.path().to_str().unwrap()), "{text}");
}

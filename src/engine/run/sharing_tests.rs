//! Several runs over one store and one folder of outputs at the same time.

use std::os::unix::fs::symlink;
use std::time::{Duration, Instant};

use crate::engine::manifest::{Outcome, Status};
use crate::engine::owner::Owner;
use crate::engine::run;
use crate::engine::run::ahead::Ahead;
use crate::engine::trial::{Mood, Space, TrialJob, graph, job};

/// Jobs that take longer than a claim waits for, and cheap ones behind them.
fn slow_jobs(count: i128) -> Vec<TrialJob> {
    let mut jobs: Vec<TrialJob> = (0..count).map(|n| job("slow", &format!("s{n}")).at(n).mood(Mood::Slow)).collect();
    jobs.extend((0..count).map(|n| job("after", "a").at(n).of(n as usize).saves()));
    jobs
}

#[test]
fn two_runs_at_once_share_the_work_and_are_both_right() {
    let space = Space::new();
    let jobs = slow_jobs(6);
    let summaries: Vec<_> = std::thread::scope(|scope| {
        let threads: Vec<_> = (0..2).map(|_| scope.spawn(|| space.run(&jobs))).collect();
        threads.into_iter().map(|thread| thread.join().unwrap()).collect()
    });
    let alone = Space::new();
    let expected = alone.run(&jobs).result_id;
    for summary in &summaries {
        assert_eq!((summary.status, summary.result_id), (Status::Done, expected), "{:?}", summary.failures);
    }
    // Slow jobs that both begin in the same moment are given up by one of them.
    let ran: u64 = summaries.iter().map(|summary| summary.measured.jobs.get("ran").copied().unwrap_or(0)).sum();
    assert!((12..=18).contains(&ran), "{ran} jobs ran where 12 are needed");
    assert!(std::fs::read_dir(space.path("store/v1/claims")).unwrap().next().is_none(), "a claim is left");
}

#[test]
fn a_job_that_a_live_process_has_claimed_is_waited_for_until_the_claim_goes() {
    let space = Space::new();
    let jobs = [job("a", "a").saves()];
    let (entries, _) = run::plan(&graph(space.folder.path(), &jobs), Ahead::begin(&space.places(), "p")).unwrap();
    let claims = space.path("store/v1/claims");
    std::fs::create_dir_all(&claims).unwrap();
    make_private(&space);
    let claim = claims.join(entries[0].key.unwrap().to_string());
    symlink(format!("{}-other-host", Owner::this_process()), &claim).unwrap();
    let begun = Instant::now();
    std::thread::scope(|scope| {
        scope.spawn(|| {
            std::thread::sleep(Duration::from_millis(150));
            std::fs::remove_file(&claim).unwrap();
        });
        assert_eq!(space.ran(&jobs), 1);
    });
    assert!(begun.elapsed() >= Duration::from_millis(150), "it was waited for");
}

#[test]
fn the_claim_of_a_dead_process_is_overtaken_at_once() {
    let space = Space::new();
    let jobs = [job("a", "a").saves()];
    let (entries, _) = run::plan(&graph(space.folder.path(), &jobs), Ahead::begin(&space.places(), "p")).unwrap();
    let claims = space.path("store/v1/claims");
    std::fs::create_dir_all(&claims).unwrap();
    make_private(&space);
    let this = Owner::this_process().to_string();
    symlink(format!("{}-1-0-host", this.rsplit_once('-').unwrap().0), claims.join(entries[0].key.unwrap().to_string())).unwrap();
    assert_eq!(space.ran(&jobs), 1);
    assert!(std::fs::read_dir(&claims).unwrap().next().is_none(), "the dead claim is left");
}

#[test]
fn a_forced_job_waits_for_no_one() {
    let space = Space::new();
    let jobs = [job("a", "a").saves()];
    space.run(&jobs);
    let key = space.manifest().jobs[0].key.unwrap();
    let claims = space.path("store/v1/claims");
    std::fs::create_dir_all(&claims).unwrap();
    let claim = claims.join(key.to_string());
    symlink(format!("{}-other-host", Owner::this_process()), &claim).unwrap();
    assert_eq!(space.ran(&[jobs[0].clone().forced()]), 1);
    assert!(claim.is_symlink(), "the claim of another is left alone");
}

#[test]
fn what_another_run_finishes_meanwhile_is_taken_from_the_store() {
    let space = Space { threads: 1, ..Space::new() };
    let slow = [job("slow", "s").mood(Mood::Slow), job("b", "b").of(0).saves(), job("c", "c").saves()];
    let other = [slow[2].clone()];
    std::thread::scope(|scope| {
        scope.spawn(|| {
            // The first run has planned by now that `c` is to run, and is busy with `slow`.
            let folder = space.path("outputs/p");
            while !folder.exists() {
                std::thread::yield_now();
            }
            std::thread::sleep(Duration::from_millis(30));
            let second = Space { folder: tempfile::tempdir().unwrap(), ..Space::new() };
            let mut places = space.places();
            places.outputs = second.path("outputs");
            second.run_in(&places, graph(space.folder.path(), &other)).unwrap();
        });
        space.run(&slow);
    });
    let outcomes = space.outcomes();
    assert_eq!(outcomes["slow"].0, Outcome::Ran);
    assert!(outcomes["c"].0 == Outcome::Hit || outcomes["c"].0 == Outcome::Ran);
}

fn make_private(space: &Space) {
    use std::os::unix::fs::PermissionsExt;
    for folder in ["store", "store/v1", "store/v1/claims"] {
        std::fs::set_permissions(space.path(folder), std::fs::Permissions::from_mode(0o700)).unwrap();
    }
}

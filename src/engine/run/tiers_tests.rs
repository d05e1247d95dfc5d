//! Runs over a near and a far store: what is taken from afar, what goes there, and what happens when it fails.

use std::collections::BTreeMap;
use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::PathBuf;

use rustix::io::Errno;

use crate::engine::files::faults::{Fault, Faults};
use crate::engine::manifest::Status;
use crate::engine::run::{Places, RunError, Summary};
use crate::engine::store::address::{Address, Remote};
use crate::engine::store::signing::{Keys, PublicKey, SecretKey};
use crate::engine::trial::{Mood, Space, TrialJob, files_below, graph, job};

/// Long results, which stand in blobs, and short ones, which stand in their records.
fn jobs() -> Vec<TrialJob> {
    vec![
        job("trunk", &"long ".repeat(2000)),
        job("mid", "m").of(0).saves(),
        job("leaf", "l").of(1).keeps(20).saves(),
        job("all", "a").all([0, 1, 2]).saves(),
    ]
}

/// A far store, and machines that have nothing but it in common.
struct World {
    far: tempfile::TempDir,
    source: tempfile::TempDir,
}

impl World {
    fn new() -> Self {
        let memory = || tempfile::tempdir_in("/dev/shm").or_else(|_| tempfile::tempdir()).unwrap();
        Self { far: memory(), source: memory() }
    }

    fn remote(&self) -> Remote {
        Remote { address: Address::Folder(self.far.path().to_owned()), is_read_only: false, keys: Keys::default() }
    }

    fn run_with(&self, machine: &Space, remote: Remote) -> Result<Summary, RunError> {
        let places = Places { remote: Some(remote), ..machine.places() };
        machine.run_in(&places, graph(self.source.path(), &jobs()))
    }

    fn run(&self, machine: &Space) -> Summary {
        self.run_with(machine, self.remote()).unwrap()
    }

    fn objects(&self, shelf: &str) -> Vec<PathBuf> {
        files_below(&self.far.path().join("v1").join(shelf))
    }
}

fn machine() -> Space {
    Space { threads: 1, folder: tempfile::tempdir_in("/dev/shm").or_else(|_| tempfile::tempdir()).unwrap(), ..Space::new() }
}

fn ran(summary: &Summary) -> u64 {
    summary.measured.jobs.get("ran").copied().unwrap_or(0)
}

fn published(space: &Space) -> BTreeMap<String, Vec<u8>> {
    let root = space.path("outputs/p");
    let files = files_below(&root).into_iter().filter(|path| path.extension().is_some_and(|extension| extension == "txt"));
    files.map(|path| (path.strip_prefix(&root).unwrap().display().to_string(), fs::read(&path).unwrap())).collect()
}

fn warnings(summary: &Summary) -> String {
    summary.warnings.iter().map(|warning| warning.message.as_str()).collect::<Vec<_>>().join("\n")
}

/// The same of a run without a far store.
fn right() -> (Summary, BTreeMap<String, Vec<u8>>) {
    let alone = machine();
    let summary = alone.run(&jobs());
    (summary, published(&alone))
}

#[test]
fn a_second_machine_executes_nothing_and_publishes_the_same() {
    let world = World::new();
    let (expected, files) = right();
    let first = machine();
    let summary = world.run(&first);
    assert_eq!((ran(&summary), summary.result_id, warnings(&summary)), (4, expected.result_id, String::new()));
    assert_eq!(world.objects("ac").len(), 4);
    assert!(world.objects("tmp").is_empty() && world.objects("notes").is_empty(), "what is of one machine stays there");

    let second = machine();
    let summary = world.run(&second);
    assert_eq!((ran(&summary), summary.result_id, warnings(&summary)), (0, expected.result_id, String::new()));
    assert_eq!(published(&second), files);
    // The result of `trunk` is asked for by no one: its bytes stay where they are, and its record with them.
    assert!(second.blobs().len() < first.blobs().len(), "{:?}", second.blobs());
    let findings =
        crate::engine::store::verification::verify(second.places().folder_store().unwrap().layout(), &second.places().library().unwrap());
    assert_eq!(findings.unwrap().damage, [], "the near store is whole by itself");

    fs::remove_dir_all(second.path("outputs")).unwrap();
    fs::remove_dir_all(second.path("store/v1/notes")).unwrap();
    assert_eq!(ran(&world.run(&second)), 0, "and again without its index");
}

#[test]
fn a_job_that_needs_far_results_runs_on_them() {
    let world = World::new();
    world.run(&machine());
    let second = machine();
    let mut more = jobs();
    more.push(job("more", "x").of(0).saves());
    let places = Places { remote: Some(world.remote()), ..second.places() };
    let summary = second.run_in(&places, graph(world.source.path(), &more)).unwrap();
    assert_eq!((ran(&summary), warnings(&summary)), (1, String::new()));
    assert_eq!(world.objects("ac").len(), 5, "and what it made is there for others");
}

#[test]
fn nothing_is_written_to_a_store_that_is_only_to_be_read() {
    let world = World::new();
    let remote = || Remote { is_read_only: true, ..world.remote() };
    assert_eq!(ran(&world.run_with(&machine(), remote()).unwrap()), 4);
    assert!(files_below(world.far.path()).is_empty());
    world.run(&machine());
    let before = files_below(world.far.path());
    let summary = world.run_with(&machine(), remote()).unwrap();
    assert_eq!((ran(&summary), warnings(&summary)), (0, String::new()));
    assert_eq!(files_below(world.far.path()), before);
}

#[test]
fn a_far_store_that_is_not_there_is_done_without_and_told_of() {
    let world = World::new();
    let gone = Remote { address: Address::Folder("/nowhere/at/all".into()), ..world.remote() };
    let summary = world.run_with(&machine(), gone).unwrap();
    assert_eq!((summary.status, ran(&summary)), (Status::Done, 4));
    assert!(warnings(&summary).contains("done without: cannot use `/nowhere/at/all`"), "{summary:?}");
}

#[test]
fn a_far_store_that_others_may_write_to_needs_a_word_or_signatures() {
    let world = World::new();
    fs::set_permissions(world.far.path(), fs::Permissions::from_mode(0o2775)).unwrap();
    let refused = world.run_with(&machine(), world.remote()).unwrap_err();
    assert!(refused.to_string().contains("others may write"), "{refused}");

    let key = SecretKey::draw().unwrap();
    let keys = Keys { trusted: Some(vec![key.public()]), signing: Some(key) };
    let remote = || Remote { keys: keys.clone(), ..world.remote() };
    world.run_with(&machine(), remote()).unwrap();
    assert_eq!(ran(&world.run_with(&machine(), remote()).unwrap()), 0);
    for path in world.objects("ac") {
        assert_eq!(fs::metadata(&path).unwrap().permissions().mode() & 0o777, 0o664, "what is made there has its folder's rights");
        assert_eq!(fs::metadata(path.parent().unwrap()).unwrap().permissions().mode() & 0o7777, 0o2775);
    }
}

#[test]
fn records_of_a_key_that_is_not_trusted_are_no_records() {
    let world = World::new();
    let [ours, theirs] = [SecretKey::draw().unwrap(), SecretKey::draw().unwrap()];
    let with = |signing: Option<&SecretKey>, trusted: &[PublicKey]| Remote {
        keys: Keys { signing: signing.cloned(), trusted: (!trusted.is_empty()).then(|| trusted.to_vec()) },
        ..world.remote()
    };
    let read_only = |remote: Remote| Remote { is_read_only: true, ..remote };
    world.run_with(&machine(), with(Some(&theirs), &[])).unwrap();
    let summary = world.run_with(&machine(), read_only(with(None, &[ours.public()]))).unwrap();
    assert_eq!(ran(&summary), 4);
    assert!(warnings(&summary).contains("not signed by a key that is trusted here"), "{}", warnings(&summary));
    assert_eq!(ran(&world.run_with(&machine(), read_only(with(None, &[ours.public(), theirs.public()]))).unwrap()), 0);
    assert_eq!(ran(&world.run_with(&machine(), with(None, &[])).unwrap()), 0, "who asks for no signature takes any");

    // Who may write, and signs, puts records in the place of those that count for nothing.
    assert_eq!(ran(&world.run_with(&machine(), with(Some(&ours), &[ours.public()])).unwrap()), 4);
    assert_eq!(ran(&world.run_with(&machine(), read_only(with(None, &[ours.public()]))).unwrap()), 0);
}

/// What becomes of the bytes of an object; none if it goes.
type Spoil = fn(&[u8]) -> Option<Vec<u8>>;

/// Everything that a far store may hold is wrong in every way, one after the other: never a wrong result, and healed.
#[test]
fn damage_afar_is_passed_over_told_and_healed() {
    let (expected, files) = right();
    let spoils: [(&str, Spoil); 5] = [
        ("gone", |_| None),
        ("empty", |_| Some(Vec::new())),
        ("short", |bytes| Some(bytes[..bytes.len() / 2].to_vec())),
        ("long", |bytes| Some([bytes, b"x"].concat())),
        ("flipped", |bytes| Some(bytes.iter().enumerate().map(|(index, byte)| byte ^ u8::from(index == bytes.len() / 2)).collect())),
    ];
    let world = World::new();
    world.run(&machine());
    for shelf in ["cas", "ac", "publications"] {
        for index in 0..world.objects(shelf).len() {
            for (how, spoil) in spoils {
                let path = world.objects(shelf)[index].clone();
                let place = format!("{how} {}", path.display());
                let sound = fs::read(&path).unwrap();
                fs::remove_file(&path).unwrap();
                let spoiled = spoil(&sound);
                if let Some(bytes) = &spoiled {
                    fs::write(&path, bytes).unwrap();
                }
                let summary = world.run(&machine());
                assert_eq!((summary.status, summary.result_id), (Status::Done, expected.result_id), "{place}");
                let is_told = warnings(&summary).contains("holds what is damaged");
                // Blobs that no one asks for are not looked at.
                let is_unused = fs::read(&path).ok() == spoiled;
                assert!(is_told || how == "gone" || is_unused, "{place}: {}", warnings(&summary));
                if is_unused {
                    assert_eq!(shelf, "cas", "{place} was not healed");
                    fs::write(&path, &sound).unwrap();
                }
                let again = machine();
                assert_eq!((ran(&world.run(&again)), published(&again)), (0, files.clone()), "{place}");
            }
        }
    }
}

/// One fault of the far store; false once the run makes fewer calls there.
fn survive(at: usize, is_lasting: bool, fault: Fault, is_filled: bool, right: &(Summary, BTreeMap<String, Vec<u8>>)) -> bool {
    let world = World::new();
    if is_filled {
        world.run(&machine());
    }
    let place = format!("call {at}, {fault:?}, lasting: {is_lasting}, filled: {is_filled}");
    let space = machine();
    let faults = Faults::below(world.far.path(), at, is_lasting, fault);
    let result = world.run_with(&space, world.remote());
    let is_met = faults.count() >= at;
    drop(faults);
    let summary = result.unwrap_or_else(|error| panic!("{place}: {error}"));
    assert_eq!((summary.status, summary.result_id), (Status::Done, right.0.result_id), "{place}: {summary:?}");
    assert!(summary.system_error.is_none(), "{place}: {summary:?}");
    assert_eq!(published(&space), right.1, "{place}");
    assert_eq!(published_after(&world), right.1, "{place}: the far store was left wrong");
    is_met
}

fn published_after(world: &World) -> BTreeMap<String, Vec<u8>> {
    let space = machine();
    assert_eq!(world.run(&space).status, Status::Done);
    published(&space)
}

fn survive_all(is_lasting: bool, errno: Errno) {
    let right = right();
    for is_filled in [false, true] {
        let mut at = 1;
        while survive(at, is_lasting, Fault::Error(errno), is_filled, &right) {
            at += 1;
        }
        assert!(at > 20, "only {at} calls were counted");
    }
}

#[test]
fn an_error_of_any_one_call_afar_does_no_harm() {
    survive_all(false, Errno::IO);
    survive_all(false, Errno::STALE);
}

#[test]
fn a_far_store_that_fails_from_any_call_on_does_no_harm() {
    survive_all(true, Errno::STALE);
    survive_all(true, Errno::NOSPC);
    survive_all(true, Errno::ACCESS);
}

#[test]
fn a_name_that_is_taken_at_any_one_call_afar_does_no_harm() {
    survive_all(false, Errno::EXIST);
}

#[test]
fn writes_that_end_early_afar_do_no_harm() {
    let right = right();
    let mut at = 1;
    while survive(at, false, Fault::Short, false, &right) {
        at += 1;
    }
}

#[test]
fn a_far_store_that_keeps_failing_is_told_of_once() {
    let world = World::new();
    let space = machine();
    let faults = Faults::below(&world.far.path().join("v1"), 1, true, Fault::Error(Errno::IO));
    let summary = world.run(&space);
    drop(faults);
    assert_eq!((summary.status, ran(&summary)), (Status::Done, 4));
    let text = warnings(&summary);
    assert_eq!(text.matches("was left alone from then on").count(), 1, "{text}");
    assert!(text.contains("records were not sent") && text.contains("store push"), "{text}");
}

#[test]
fn two_machines_at_once_share_the_work() {
    let world = World::new();
    let mut slow: Vec<TrialJob> = (0..6).map(|n| job("slow", &format!("s{n}")).at(n).mood(Mood::Slow)).collect();
    slow.extend((0..6).map(|n| job("after", "a").at(n).of(n as usize).saves()));
    let run = || {
        let machine = Space::new();
        let places = Places { remote: Some(world.remote()), ..machine.places() };
        machine.run_in(&places, graph(world.source.path(), &slow)).unwrap()
    };
    let summaries: Vec<Summary> = std::thread::scope(|scope| {
        let threads: Vec<_> = (0..2).map(|_| scope.spawn(run)).collect();
        threads.into_iter().map(|thread| thread.join().unwrap()).collect()
    });
    assert!(summaries.iter().all(|summary| summary.status == Status::Done && summary.result_id == summaries[0].result_id));
    // Slow jobs that both begin in the same moment are given up by one of them.
    let ran: u64 = summaries.iter().map(ran).sum();
    assert!((12..=18).contains(&ran), "{ran} jobs ran where 12 are needed: {:?}", summaries.iter().map(warnings).collect::<Vec<_>>());
    assert!(files_below(&world.far.path().join("v1/claims")).is_empty(), "a claim is left");
}

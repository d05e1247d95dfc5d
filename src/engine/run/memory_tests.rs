//! Runs over a pipeline file, of which the later ones may need no plan.

use std::fs;
use std::num::NonZeroUsize;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use crate::engine::events::{Event, Listener, Silence};
use crate::engine::manifest::{Manifest, ShortManifest, Status};
use crate::engine::registry::Registry;
use crate::engine::request::Request;
use crate::engine::run::ahead::Ahead;
use crate::engine::run::{self, Summary, memory};
use crate::engine::schedule::Settings;
use crate::engine::sweep::build;
use crate::engine::trial::{Space, Text, Trial, files_below};

/// A trunk that reads a file, a leaf, and another one; only the leaf's own part is said here.
fn text(leaf: &str) -> String {
    let long = "long ".repeat(2000);
    format!(
        "version: 1\npipeline: p\nstages:\n\
         \x20 trunk: {{ trial: {{ say: t, keep: 99, mood: fine, path: in.txt }}, save: txt }}\n\
         \x20 leaf: {{ trial: {{ say: {leaf}, keep: 99, mood: fine, of: trunk }}, save: txt }}\n\
         \x20 other: {{ trial: {{ say: {long}, keep: 99999, mood: fine }}, save: txt }}\n"
    )
}

fn settings() -> Settings {
    Settings { threads: NonZeroUsize::new(2).unwrap(), memory: 1 << 30, keep_going: false, start_pool: |_| {} }
}

fn by_memory(space: &Space) -> Option<Summary> {
    memory::run(&Request::of_file(space.path("p.yaml")), &space.places(), settings(), &space.interrupted, &mut Silence).unwrap()
}

fn by_plan(space: &Space, request: &Request) -> Summary {
    let registry = Registry::default().with::<Trial>().with_artifact::<Text>();
    let graph = build(&registry, request).map_err(|errors| format!("{errors:?}")).unwrap().0;
    let ahead = Ahead::begin(&space.places(), &graph.pipeline);
    run::run(graph, &registry, ahead, settings(), space.interrupted.clone(), None, &mut Silence).unwrap()
}

/// Writes a text and makes a whole run over it.
fn planned(space: &Space, leaf: &str) -> Summary {
    fs::write(space.path("p.yaml"), text(leaf)).unwrap();
    by_plan(space, &Request::of_file(space.path("p.yaml")))
}

fn space() -> Space {
    let space = Space::new();
    fs::write(space.path("in.txt"), "input").unwrap();
    space
}

fn outputs(space: &Space) -> Vec<(String, Vec<u8>)> {
    let root = space.path("outputs/p");
    let files = files_below(&root).into_iter().filter(|path| !path.starts_with(root.join("runs")));
    files.map(|path| (path.strip_prefix(&root).unwrap().display().to_string(), fs::read(&path).unwrap())).collect()
}

#[test]
fn going_back_to_an_earlier_text_needs_no_plan() {
    let space = space();
    let one = planned(&space, "one");
    let after_one = outputs(&space);
    assert_eq!(after_one.len(), 5, "three files, the manifest and the crate");
    planned(&space, "two");
    assert_ne!(outputs(&space), after_one);

    fs::write(space.path("p.yaml"), text("one")).unwrap();
    let back = by_memory(&space).expect("a note of that text");
    assert_eq!(outputs(&space), after_one, "the files, the manifest and the crate of the first run");
    assert_eq!((back.results_of.as_ref(), back.result_id), (Some(&one.run_id), one.result_id));
    assert_eq!((back.measured.files_written, back.measured.jobs["hit"]), (1, 3));
    let short = fs::read(space.path(&format!("outputs/p/runs/{}/manifest.json", back.run_id))).unwrap();
    assert_eq!(serde_json::from_slice::<ShortManifest>(&short).unwrap().results_of, one.run_id);

    fs::write(space.path("p.yaml"), text("three")).unwrap();
    assert!(by_memory(&space).is_none(), "a text that was never run");
}

#[test]
fn deleted_outputs_come_back_and_those_of_the_run_between_go() {
    let space = space();
    planned(&space, "one");
    let after_one = outputs(&space);
    let more = text("two") + "  more: { trial: { say: more, keep: 99, mood: fine }, save: txt }\n";
    fs::write(space.path("p.yaml"), more).unwrap();
    by_plan(&space, &Request::of_file(space.path("p.yaml")));
    for name in ["trunk.txt", "other.txt"] {
        fs::remove_file(space.path("outputs/p").join(name)).unwrap();
    }
    fs::write(space.path("p.yaml"), text("one")).unwrap();
    let back = by_memory(&space).unwrap();
    assert_eq!((back.measured.files_written, back.measured.files_removed), (3, 1));
    assert_eq!(outputs(&space), after_one);
    assert_eq!(fs::read_dir(space.path("outputs/.tmp")).unwrap().count(), 0);
}

#[test]
fn what_a_person_has_changed_is_for_the_plan_to_tell() {
    let space = space();
    planned(&space, "one");
    // At once, with as many bytes: the signature alone could not show it.
    let bytes = fs::read(space.path("outputs/p/leaf.txt")).unwrap();
    fs::write(space.path("outputs/p/leaf.txt"), vec![b'x'; bytes.len()]).unwrap();
    assert!(by_memory(&space).is_none());
    let told = planned(&space, "one");
    assert!(told.warnings.iter().any(|warning| warning.message.contains("`leaf.txt` had been changed")), "{:?}", told.warnings);
    assert_eq!(fs::read(space.path("outputs/p/leaf.txt")).unwrap(), bytes);

    // So is a file that the run between has published and that the earlier one does not have.
    planned(&space, "one");
    fs::write(space.path("p.yaml"), text("two") + "  more: { trial: { say: more, keep: 99, mood: fine }, save: txt }\n").unwrap();
    by_plan(&space, &Request::of_file(space.path("p.yaml")));
    fs::write(space.path("outputs/p/more.txt"), "mine").unwrap();
    fs::write(space.path("p.yaml"), text("one")).unwrap();
    assert!(by_memory(&space).is_none());
    assert_eq!(fs::read(space.path("outputs/p/more.txt")).unwrap(), b"mine");
}

#[test]
fn what_changes_after_the_signatures_are_known_is_noticed() {
    let space = space();
    planned(&space, "one");
    // Once the stamps are old enough, a run takes the signatures down; from then on nothing is read.
    std::thread::sleep(Duration::from_millis(40));
    assert!(by_memory(&space).is_some());
    assert_eq!(by_memory(&space).unwrap().measured.files_written, 0);
    let after_one = outputs(&space);

    fs::remove_file(space.path("outputs/p/trunk.txt")).unwrap();
    assert_eq!(by_memory(&space).unwrap().measured.files_written, 1);
    assert_eq!(outputs(&space), after_one);
    let bytes = fs::read(space.path("outputs/p/leaf.txt")).unwrap();
    fs::write(space.path("outputs/p/leaf.txt"), vec![b'x'; bytes.len()]).unwrap();
    assert!(by_memory(&space).is_none(), "a person's change is for the plan");
}

#[test]
fn an_input_or_a_record_of_the_run_that_has_changed_is_noticed() {
    let space = space();
    let one = planned(&space, "one");
    assert!(by_memory(&space).is_some());
    fs::write(space.path("in.txt"), "inpuT").unwrap();
    assert!(by_memory(&space).is_none(), "another input of the same size");
    fs::write(space.path("in.txt"), "input").unwrap();
    assert!(by_memory(&space).is_some(), "the same bytes again");

    let manifest = fs::read(space.path("outputs/p/manifest.json")).unwrap();
    fs::write(space.path("outputs/p/manifest.json"), "{}").unwrap();
    fs::remove_file(space.path("outputs/p/ro-crate-metadata.json")).unwrap();
    assert!(by_memory(&space).is_some());
    assert_eq!(fs::read(space.path("outputs/p/manifest.json")).unwrap(), manifest, "put back");
    assert!(space.path("outputs/p/ro-crate-metadata.json").exists());
    fs::write(space.path("outputs/p/manifest.json"), " ".repeat(manifest.len())).unwrap();
    assert!(by_memory(&space).is_some());
    assert_eq!(fs::read(space.path("outputs/p/manifest.json")).unwrap(), manifest, "another of the same length is noticed too");

    fs::write(space.path(&format!("outputs/p/runs/{}/manifest.json", one.run_id)), "{}").unwrap();
    assert!(by_memory(&space).is_some(), "the copy is not needed while the other stands");
    fs::write(space.path("outputs/p/manifest.json"), "{}").unwrap();
    assert!(by_memory(&space).is_none(), "no sound copy is left");
}

#[test]
fn an_object_that_the_store_has_lost_is_for_the_plan_to_heal() {
    for (shelf, is_gone) in [("publications", false), ("publications", true), ("cas", false), ("cas", true)] {
        let space = space();
        planned(&space, "one");
        let files = files_below(&space.path("store/v1").join(shelf));
        assert!(!files.is_empty());
        for file in &files {
            if is_gone {
                fs::remove_file(file).unwrap();
            } else {
                let mut bytes = fs::read(file).unwrap();
                let middle = bytes.len() / 2;
                bytes[middle] ^= 1;
                fs::write(file, bytes).unwrap();
            }
        }
        let published = outputs(&space);
        for name in ["trunk.txt", "leaf.txt", "other.txt"] {
            fs::remove_file(space.path("outputs/p").join(name)).unwrap();
        }
        assert!(by_memory(&space).is_none(), "{shelf}");
        let healed = planned(&space, "one");
        assert!(is_gone || healed.warnings.iter().any(|warning| warning.message.contains("damaged")), "{shelf}: {:?}", healed.warnings);
        let texts = |files: Vec<(String, Vec<u8>)>| files.into_iter().filter(|(name, _)| name.ends_with(".txt")).collect::<Vec<_>>();
        assert_eq!(texts(outputs(&space)), texts(published), "{shelf}");
    }
}

#[test]
fn a_run_that_is_told_to_compute_leaves_no_note() {
    let space = space();
    fs::write(space.path("p.yaml"), text("one")).unwrap();
    let request = Request { force: vec!["leaf".into()], ..Request::of_file(space.path("p.yaml")) };
    by_plan(&space, &request);
    assert!(memory::run(&request, &space.places(), settings(), &space.interrupted, &mut Silence).unwrap().is_none());
    assert_eq!(by_plan(&space, &request).measured.jobs["ran"], 1);
}

/// Interrupts the run that begins to put files back.
struct Impatience(Arc<AtomicBool>);

impl Listener for Impatience {
    fn notify(&mut self, event: &Event) {
        if matches!(event, Event::Restoring { files: 3, .. }) {
            self.0.store(true, Ordering::Relaxed);
        }
    }
}

#[test]
fn a_restoration_that_is_interrupted_leaves_a_manifest_that_says_so() {
    let space = space();
    planned(&space, "one");
    let before = outputs(&space);
    for name in ["trunk.txt", "leaf.txt", "other.txt"] {
        fs::remove_file(space.path("outputs/p").join(name)).unwrap();
    }
    let request = Request::of_file(space.path("p.yaml"));
    let mut impatience = Impatience(space.interrupted.clone());
    assert!(memory::run(&request, &space.places(), settings(), &space.interrupted, &mut impatience).unwrap().is_none());
    assert!(!space.path("outputs/p/other.txt").exists(), "nothing more was written");
    assert_eq!(fs::read_dir(space.path("outputs/.tmp")).unwrap().count(), 0);
    let summary = by_plan(&space, &request);
    assert_eq!(summary.status, Status::Interrupted);
    let manifest = fs::read(summary.manifest).unwrap();
    assert_eq!(serde_json::from_slice::<Manifest>(&manifest).unwrap().status, Status::Interrupted);

    space.interrupted.store(false, Ordering::Relaxed);
    assert!(by_memory(&space).is_some());
    assert_eq!(outputs(&space), before);
}

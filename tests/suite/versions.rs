//! A kind that computes something else must say so by its version, or stores would go on giving what it gave before.
//!
//! `versions.txt` lists keys of `versions.yaml` (kind, version, parameters, contents of the inputs) with the digests of
//! what they gave. Another digest for the same key fails. A key that is not in the list, after a version was raised or a
//! kind was added, asks for the list to be written again: `PIPELINE_PIN=1 cargo test --test suite versions`.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

use pipeline::stages::registry;

use crate::space::Space;

/// Stage, coordinate, kind and key, then the digests of the results.
fn line(job: &serde_json::Value) -> (String, String) {
    let values = job["coordinate"].as_object().unwrap().iter().map(|(axis, value)| format!("{axis}={value}"));
    let place = format!("{}[{}]", job["stage"].as_str().unwrap(), values.collect::<Vec<_>>().join(","));
    let digests = job["outputs"].as_array().unwrap().iter().map(|output| output["sha256"].as_str().unwrap()[..16].to_owned());
    let key = &job["key"].as_str().unwrap()[..16];
    let named = format!("{place} {} {key}", job["kind"].as_str().unwrap());
    (named, digests.collect::<Vec<_>>().join(" "))
}

#[test]
fn a_kind_that_gives_something_else_has_another_version() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/suite");
    let space = Space::new();
    space.write("p.yaml", fs::read(folder.join("versions.yaml")).unwrap());
    space.summary(&[]);
    let manifest: serde_json::Value = serde_json::from_slice(&space.read("outputs/versions/manifest.json")).unwrap();
    let jobs = manifest["jobs"].as_array().unwrap();

    let tried: BTreeSet<&str> = jobs.iter().map(|job| job["kind"].as_str().unwrap()).collect();
    let registry = registry();
    let untried: Vec<&str> = registry.kinds().names().filter(|kind| !tried.contains(kind)).collect();
    assert!(untried.is_empty(), "versions.yaml lacks a stage of {untried:?}");

    let found: Vec<(String, String)> = jobs.iter().map(line).collect();
    let text: String = found.iter().map(|(named, digests)| format!("{named}: {digests}\n")).collect();
    let list = folder.join("versions.txt");
    if std::env::var_os("PIPELINE_PIN").is_some() {
        fs::write(&list, text).unwrap();
        return;
    }
    let known = fs::read_to_string(&list).unwrap();
    let pinned = |named: &str| known.lines().find_map(|line| line.strip_prefix(named)?.strip_prefix(": "));
    for (named, digests) in &found {
        let same = pinned(named).is_none_or(|pinned| pinned == digests);
        assert!(same, "{named} gives something else than it did; raise the VERSION of its kind, or mend it");
    }
    let new: Vec<&str> = found.iter().map(|(named, _)| named.as_str()).filter(|named| pinned(named).is_none()).collect();
    assert!(new.is_empty(), "not in versions.txt, which `PIPELINE_PIN=1 cargo test --test suite versions` writes: {new:#?}");
}

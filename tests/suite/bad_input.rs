//! Mistakes of the world and of the file: one clear message, the right exit code, nothing half-written.

use crate::space::Space;

const SMALL: &str = "stages:\n  env: { synthesize: { name: gradient, width: 32 } }\n";

#[test]
fn a_missing_map_is_named_at_its_line() {
    let space = Space::new();
    space.pipeline("stages:\n  env: { load: { path: nowhere.pfm } }\n");
    space.run(&["run", "p.yaml"]).expect(2, &["p.yaml:5:", "nowhere.pfm"]);
    assert!(space.files(".").iter().all(|file| file == "p.yaml"), "nothing is written after a refusal");
}

#[test]
fn a_truncated_map_fails_its_job_and_publishes_nothing() {
    let space = Space::new();
    space.pipeline("stages:\n  env: { load: { path: cut.pfm }, save: pfm }\n");
    space.write("cut.pfm", b"PF\n4 2\n-1.0\n\0\0\0\0");
    space.run(&["run", "p.yaml"]).expect(1, &["cut.pfm", "env"]);
    assert_eq!(space.manifest()["status"], "failed");
    assert!(!space.path("outputs/p/env.pfm").exists());
}

#[test]
fn a_cycle_is_shown_whole() {
    let space = Space::new();
    space.pipeline("stages:\n  a: { tone-map: { of: b } }\n  b: { mark: { on: a, at: a } }\n");
    space.run(&["check", "p.yaml"]).expect(2, &["cycle", "a", "b"]);
}

#[test]
fn a_misspelt_kind_and_a_zero_count_are_shown_at_once() {
    let space = Space::new();
    space.pipeline(&format!("{SMALL}  dist: {{ distribution: {{ of: env }} }}\n  s: {{ smaple: {{ of: dist, count: 4 }} }}\n  t: {{ sample: {{ of: dist, count: 0 }} }}\n"));
    space.run(&["check", "p.yaml"]).expect(2, &["p.yaml:7:", "did you mean `sample`", "p.yaml:8:", "count"]);
}

#[test]
fn a_folder_that_cannot_be_written_is_the_systems_failure() {
    let space = Space::new();
    space.pipeline(SMALL);
    // A file where a folder is needed stops even a privileged user.
    space.write("blocked", "");
    space.run(&["run", "p.yaml", "--outputs", "blocked/here"]).expect(3, &["blocked"]);
}

#[test]
fn a_failure_stops_its_dependents_only_under_keep_going() {
    let space = Space::new();
    space.pipeline(
        "stages:\n  bad: { load: { path: bad.pfm } }\n  after: { tone-map: { of: bad }, save: png }\n  env: { synthesize: { name: gradient, width: 32 }, save: pfm }\n",
    );
    space.write("bad.pfm", "not a map");
    space.run(&["run", "p.yaml", "-k"]).expect(1, &["bad"]);
    assert!(space.path("outputs/p/env.pfm").exists());
    assert!(!space.path("outputs/p/after.png").exists());
    let outcomes: Vec<(String, String)> = space.manifest()["jobs"]
        .as_array()
        .unwrap()
        .iter()
        .map(|job| (job["stage"].as_str().unwrap().into(), job["outcome"].as_str().unwrap().into()))
        .collect();
    assert!(outcomes.contains(&("bad".into(), "failed".into())), "{outcomes:?}");
    assert!(outcomes.contains(&("after".into(), "skipped".into())), "{outcomes:?}");
}

#[test]
fn hostile_text_is_escaped() {
    let space = Space::new();
    space.pipeline("stages:\n  \"a\\e[31mb\": { synthesize: { name: gradient } }\n");
    let finished = space.run(&["check", "p.yaml"]);
    finished.expect(2, &["name"]);
    assert!(!finished.stderr.contains('\u{1b}'), "{}", finished.stderr);
}

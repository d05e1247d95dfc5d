//! Why a job runs: the plan says it with old and new value, and the run says the same.

use std::fs;

use serde_json::Value as Json;

use crate::space::Space;

const PIPELINE: &str = "\
params: { gamma: 1.8, map: map.pfm }
axes: { n: [4, 8] }
stages:
  env: { load: { path: $map } }
  sky: { synthesize: { name: gradient, width: 16 } }
  dist: { distribution: { of: sky } }
  samples: { sample: { of: dist, count: $n } }
  ldr: { tone-map: { of: sky, gamma: $gamma }, save: png }
  cuts: { median-cut: { of: sky, count: $n } }
  both: { table: { of: [cuts] }, save: csv }
";

/// A map of 4 x 2 equal pixels.
fn map(value: f32) -> Vec<u8> {
    [b"PF\n4 2\n-1.0\n".to_vec(), value.to_le_bytes().repeat(24)].concat()
}

fn space() -> Space {
    let space = Space::new();
    space.pipeline(PIPELINE).write("map.pfm", map(1.0));
    space
}

fn ran() -> Space {
    let space = space();
    space.summary(&[]);
    space
}

/// Outcome and reason of a job as a plan gives them.
fn planned(space: &Space, stage: &str, arguments: &[&str]) -> (String, String) {
    let finished = space.run(&[&["plan", "p.yaml", "--format", "json"], arguments].concat());
    finished.expect(0, &[]);
    let plan: Json = serde_json::from_str(&finished.stdout).unwrap();
    of_stage(&plan, stage)
}

fn of_stage(document: &Json, stage: &str) -> (String, String) {
    let job = document["jobs"].as_array().unwrap().iter().find(|job| job["stage"] == stage).expect("the stage is there");
    (job["outcome"].as_str().unwrap().into(), job["reason"].as_str().unwrap().into())
}

/// Checks the reason in the plan, then in the manifest of the run and in its lines.
#[track_caller]
fn expect(space: &Space, stage: &str, arguments: &[&str], outcome: &str, reason: &str) {
    assert_eq!(planned(space, stage, arguments), (outcome.into(), reason.into()), "the plan");
    let finished = space.run(&[&["run", "p.yaml"], arguments].concat());
    finished.expect(0, &[]);
    let (ended, told) = of_stage(&space.manifest(), stage);
    let ended_as = if outcome == "hit" { "hit" } else { "ran" };
    assert_eq!((ended.as_str(), told.as_str()), (ended_as, reason), "the run");
    if outcome != "hit" {
        finished.expect(0, &[reason]);
    }
}

#[test]
fn nothing_has_run_yet() {
    expect(&space(), "ldr", &[], "run", "never ran");
}

#[test]
fn nothing_changed() {
    assert_eq!(planned(&ran(), "ldr", &[]), ("hit".into(), "in the store".into()));
}

#[test]
fn a_parameter_changed() {
    expect(&ran(), "ldr", &["-s", "gamma=2.2"], "run", "parameter gamma 1.8 -> 2.2");
}

#[test]
fn two_parameters_changed() {
    let space = ran();
    space.pipeline(&PIPELINE.replace("gamma: $gamma", "gamma: 2.2, bits: 16"));
    expect(&space, "ldr", &[], "run", "parameters bits default -> 16, gamma 1.8 -> 2.2");
}

#[test]
fn an_input_changed_and_what_follows_is_found_out_by_running() {
    let space = ran();
    assert_eq!(planned(&space, "dist", &["-s", "gamma=1.8"]).0, "hit");
    space.pipeline(&PIPELINE.replace("width: 16", "width: 32"));
    assert_eq!(planned(&space, "sky", &[]), ("run".into(), "parameter width 16 -> 32".into()));
    assert_eq!(planned(&space, "dist", &[]), ("maybe".into(), "waits for sky".into()));
    let plan = space.run(&["plan", "p.yaml"]).expect(0, &[]).stdout.clone();
    assert!(plan.contains("\nmaybe: a hit if "), "{plan}");
    space.summary(&[]);
    assert_eq!(of_stage(&space.manifest(), "dist"), ("ran".into(), "input sky changed".into()));
}

#[test]
fn a_file_changed() {
    let space = ran();
    space.write("map.pfm", map(2.0));
    expect(&space, "env", &[], "run", "file map.pfm changed");
}

#[test]
fn another_file_is_named() {
    let space = ran();
    space.write("other.pfm", map(2.0));
    expect(&space, "env", &["-s", "map=other.pfm"], "run", "parameter path map.pfm -> other.pfm");
}

#[test]
fn a_version_changed() {
    let space = ran();
    for path in space.files("outputs/p").iter().filter(|path| path.ends_with("manifest.json")) {
        let path = format!("outputs/p/{path}");
        let text = String::from_utf8(space.read(&path)).unwrap();
        space.write(&path, text.replace("\"kind\":\"tone-map\",\"version\":1", "\"kind\":\"tone-map\",\"version\":0"));
    }
    fs::remove_dir_all(space.path("outputs/.store")).unwrap();
    expect(&space, "ldr", &[], "run", "version 0 -> 1");
}

#[test]
fn a_result_is_missing() {
    let space = ran();
    fs::remove_dir_all(space.path("outputs/.store")).unwrap();
    expect(&space, "sky", &[], "run", "result missing");
}

#[test]
fn a_stage_is_forced() {
    expect(&ran(), "sky", &["--force", "sky"], "run", "forced");
}

#[test]
fn the_seed_changed() {
    let space = ran();
    assert_eq!(planned(&space, "samples", &["--seed", "8"]), ("run".into(), "parameter seed 7 -> 8".into()));
    space.pipeline(&PIPELINE.replace("of: dist, count: $n", "of: dist, count: $n, seed: 7"));
    assert_eq!(planned(&space, "samples", &[]).0, "hit", "an explicit seed that is the default's is the same");
}

#[test]
fn a_stage_was_renamed() {
    let space = ran();
    space.pipeline(&PIPELINE.replace("ldr:", "picture:").replace("gamma: 1.8", "gamma: 2.2"));
    expect(&space, "picture", &[], "run", "renamed from ldr; parameter gamma 1.8 -> 2.2");
}

#[test]
fn an_input_of_a_table_was_renamed_or_added() {
    let space = ran();
    space.pipeline(&PIPELINE.replace("  cuts:", "  parts:").replace("[cuts]", "[parts]"));
    expect(&space, "both", &[], "run", "input cuts -> parts");
    let space = ran();
    assert_eq!(planned(&space, "both", &["-a", "n=4,8,16"]).1, "input cuts[n=16] added");
}

#[test]
fn a_value_of_an_axis_was_exchanged() {
    let space = ran();
    let plan = space.run(&["plan", "p.yaml", "-a", "n=4,9"]);
    plan.expect(0, &[]);
    assert!(plan.stdout.contains("samples  1 of 2  2 n  run   parameter count 8 -> 9"), "{}", plan.stdout);
}

#[test]
fn a_failure_is_remembered() {
    let space = ran();
    space.write("map.pfm", "PF\nnot a map");
    space.run(&["run", "p.yaml", "-k"]).expect(1, &["file map.pfm changed"]);
    assert_eq!(planned(&space, "env", &[]), ("run".into(), "failed before".into()));
}

#[test]
fn damage_is_said_healed_and_reported() {
    let space = ran();
    let key =
        space.manifest()["jobs"].as_array().unwrap().iter().find(|job| job["stage"] == "sky").unwrap()["key"].as_str().unwrap().to_owned();
    let record = space.files("outputs/.store").into_iter().find(|path| path.ends_with(&key)).expect("there is a record");
    let record = format!("outputs/.store/{record}");
    let bytes = space.read(&record);
    space.write(&record, &bytes[..bytes.len() / 2]);
    // Without the index, so that the record itself is asked for.
    for index in space.files("outputs/.store").iter().filter(|path| path.contains("index") || path.contains("notes")) {
        fs::remove_file(space.path(&format!("outputs/.store/{index}"))).unwrap();
    }
    let finished = space.run(&["run", "p.yaml"]);
    finished.expect(0, &["damaged"]);
    assert_eq!(of_stage(&space.manifest(), "sky"), ("ran".into(), "damaged".into()));
    assert_eq!(planned(&space, "sky", &[]).0, "hit");
}

#[test]
fn a_plan_of_many_stages_is_short_and_fits_a_terminal() {
    let space = Space::new();
    let stages: String =
        (0..300).map(|n| format!("  a-rather-long-name-of-a-stage-{n}: {{ synthesize: {{ name: gradient, width: 16 }} }}\n")).collect();
    space.pipeline(&format!("stages:\n{stages}"));
    let plan = space.run(&["plan", "p.yaml"]);
    assert!(plan.stdout.lines().count() < 6 && plan.stdout.lines().all(|line| line.chars().count() <= 80), "{}", plan.stdout);
    assert!(plan.stdout.contains("300 jobs: 300 run"), "{}", plan.stdout);
    assert_eq!(space.run(&["plan", "p.yaml", "-v"]).stdout.lines().count(), 301);
    assert_eq!(space.run(&["run", "-n", "p.yaml"]).stdout, plan.stdout, "`run -n` is the same");
    assert!(!space.path("outputs").exists());
}

#[test]
fn graphs_are_drawn_by_stage_or_by_job() {
    let space = space();
    let drawn = |arguments: &[&str]| space.run(&[&["plan", "p.yaml", "--format"], arguments].concat()).expect(0, &[]).stdout.clone();
    assert_eq!(drawn(&["dot"]).matches("label=").count(), 7);
    assert_eq!(drawn(&["dot", "-v"]).matches("label=").count(), 9);
    assert_eq!(drawn(&["mermaid"]).matches(" --> ").count(), 5);
    assert_eq!(drawn(&["mermaid", "--only", "ldr"]).matches("[\"").count(), 2);
}

//! What runs again and what does not, and that results never depend on how they were made.

use std::fs;

use crate::space::Space;

const CHAIN: &str = "params: { gamma: 2.2, clamp: 1000 }
axes: { n: [4, 16] }
stages:
  env: { load: { path: 'synthetic:gradient', clamp: $clamp }, save: pfm }
  dist: { distribution: { of: env } }
  samples: { sample: { of: dist, count: $n }, save: csv }
  sphere: { relight: { env: env, with: samples, size: 16 }, save: pfm }
  ldr: { tone-map: { of: sphere, gamma: $gamma }, save: [png, ppm] }
";

fn chain() -> Space {
    let space = Space::new();
    space.pipeline(CHAIN);
    space
}

#[test]
fn a_second_run_executes_nothing() {
    let space = chain();
    assert_eq!(space.executed(&[]), 8);
    assert_eq!(space.executed(&[]), 0);
}

#[test]
fn only_what_depends_on_a_change_runs_and_going_back_is_free() {
    let space = chain();
    space.summary(&[]);
    assert_eq!(space.executed(&["-s", "gamma=1.8"]), 2);
    assert_eq!(space.executed(&[]), 0);
}

#[test]
fn a_change_that_gives_the_same_bytes_stops_there() {
    let space = chain();
    space.summary(&[]);
    // The gradient is far below both limits: the map is loaded again and nothing else.
    assert_eq!(space.executed(&["-s", "clamp=2000"]), 1);
}

#[test]
fn results_do_not_depend_on_threads() {
    let results: Vec<_> = ["1", "2", "8"]
        .map(|jobs| {
            let space = chain();
            let summary = space.summary(&["-j", jobs]);
            (summary["result_id"].clone(), space.read("outputs/p/ldr/n=16.png"))
        })
        .into();
    assert!(results[0].0.is_string());
    assert!(results.iter().all(|result| *result == results[0]));
}

#[test]
fn damage_in_the_store_is_healed_and_never_served() {
    let space = chain();
    space.summary(&[]);
    let sphere = space.read("outputs/p/sphere/n=16.pfm");
    for file in space.files("outputs/.store/v1/cas") {
        let path = space.path("outputs/.store/v1/cas").join(file);
        let mut bytes = fs::read(&path).unwrap();
        bytes[0] ^= 1;
        fs::write(&path, bytes).unwrap();
    }
    fs::remove_dir_all(space.path("outputs/p/sphere")).unwrap();
    space.summary(&["-s", "gamma=1.9"]);
    assert_eq!(space.read("outputs/p/sphere/n=16.pfm"), sphere);
}

#[test]
fn an_edited_result_is_put_right_again() {
    let space = chain();
    space.summary(&[]);
    let right = space.read("outputs/p/samples/n=4.csv");
    space.write("outputs/p/samples/n=4.csv", "edited");
    let finished = space.run(&["run", "p.yaml"]);
    finished.expect(0, &["n=4.csv"]);
    assert_eq!(space.read("outputs/p/samples/n=4.csv"), right);
}

#[test]
fn files_of_a_removed_stage_go_unless_edited() {
    let space = chain();
    space.summary(&[]);
    space.write("outputs/p/ldr/n=4.ppm", "mine now");
    let without = CHAIN.lines().filter(|line| !line.contains("ldr")).collect::<Vec<_>>().join("\n");
    space.pipeline(&format!("{without}\n"));
    space.summary(&[]);
    assert!(!space.path("outputs/p/ldr/n=16.png").exists());
    assert_eq!(space.read("outputs/p/ldr/n=4.ppm"), b"mine now");
}

#[test]
fn the_manifest_names_no_place_of_this_machine() {
    let space = chain();
    space.summary(&[]);
    let manifest = String::from_utf8(space.read("outputs/p/manifest.json")).unwrap();
    assert!(!manifest.contains(space.path("").to_str().unwrap()), "{manifest}");
    let manifest = space.manifest();
    for field in [
        "schema",
        "pipeline",
        "run_id",
        "result_id",
        "status",
        "spec",
        "overrides",
        "jobs",
        "published",
        "warnings",
        "program",
        "machine",
        "measured",
    ] {
        assert!(!manifest[field].is_null(), "`{field}` is missing");
    }
}

#[test]
fn the_plan_says_why() {
    let space = chain();
    space.summary(&[]);
    let finished = space.run(&["plan", "p.yaml", "-s", "gamma=1.8"]);
    assert_eq!(finished.code, 0, "{}", finished.stderr);
    assert!(finished.stdout.contains("parameter gamma 2.2 -> 1.8"), "{}", finished.stdout);
    assert!(finished.stdout.lines().all(|line| line.chars().count() <= 80), "{}", finished.stdout);
}

#[test]
fn a_closed_pipe_is_no_failure() {
    let space = chain();
    let mut child = space.command(&["stages"]).stdout(std::process::Stdio::piped()).spawn().unwrap();
    drop(child.stdout.take());
    assert!(child.wait().unwrap().success());
}

//! What the language means, seen from outside: which jobs there are and what they are called.

use std::collections::BTreeMap;

use serde_json::Value as Json;

use crate::space::Space;

fn jobs_per_stage(space: &Space, arguments: &[&str]) -> BTreeMap<String, usize> {
    let finished = space.run(&[&["plan", "p.yaml", "--format", "json"], arguments].concat());
    assert_eq!(finished.code, 0, "{}", finished.stderr);
    let plan: Json = serde_json::from_str(&finished.stdout).unwrap();
    let mut counts = BTreeMap::new();
    for job in plan["jobs"].as_array().unwrap() {
        *counts.entry(job["stage"].as_str().unwrap().to_owned()).or_insert(0) += 1;
    }
    counts
}

const SWEEP: &str = "axes:
  n: [4, 16]
  gamma: [1.0, 2.2, 3]
stages:
  env: { synthesize: { name: gradient, width: 32 } }
  dist: { distribution: { of: env } }
  samples: { sample: { of: dist, count: $n }, save: csv }
  sphere: { relight: { env: env, with: samples, size: 16 }, save: pfm }
  truth: { relight: { env: env, estimator: exact, size: 16 } }
  ldr: { tone-map: { of: sphere, gamma: $gamma }, save: png }
  error: { compare: { of: sphere, to: truth } }
  errors: { table: { of: error }, save: csv }
";

#[test]
fn axes_travel_with_inputs_and_join_by_name() {
    let space = Space::new();
    space.pipeline(SWEEP);
    let counts = jobs_per_stage(&space, &[]);
    let expected = [("env", 1), ("dist", 1), ("samples", 2), ("sphere", 2), ("truth", 1), ("ldr", 6), ("error", 2), ("errors", 1)];
    assert_eq!(counts, expected.map(|(stage, count)| (stage.to_owned(), count)).into());
    assert_eq!(jobs_per_stage(&space, &["-a", "n=1,4,9", "-a", "gamma=2.2"])["ldr"], 3);
}

#[test]
fn published_files_are_named_by_axis_values() {
    let space = Space::new();
    space.pipeline(SWEEP);
    space.summary(&[]);
    for file in ["samples/n=4.csv", "sphere/n=16.pfm", "ldr/n=4,gamma=1.png", "ldr/n=16,gamma=2.2.png", "errors.csv"] {
        assert!(space.path("outputs/p").join(file).exists(), "{file} is missing among {:?}", space.files("outputs/p"));
    }
    let table = String::from_utf8(space.read("outputs/p/errors.csv")).unwrap();
    assert_eq!(table.lines().next(), Some("stage,n,rmse"), "{table}");
    assert_eq!(table.lines().count(), 3, "{table}");
}

#[test]
fn equal_seeds_share_their_numbers_and_other_seeds_do_not() {
    let space = Space::new();
    space.pipeline(
        "axes: { run: [1, 2] }\nstages:\n  a: { sample: { method: uniform, count: 8, seed: $run }, save: csv }\n  b: { sample: { method: uniform, count: 8, seed: 1 }, save: csv }\n  c: { sample: { method: uniform, count: 8 }, save: csv }\n",
    );
    space.summary(&["--seed", "2"]);
    let read = |file: &str| space.read(&format!("outputs/p/{file}"));
    assert_eq!(read("a/run=1.csv"), read("b.csv"));
    assert_eq!(read("a/run=2.csv"), read("c.csv"));
    assert_ne!(read("b.csv"), read("c.csv"));
}

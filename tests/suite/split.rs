//! Renders that `split:` divides: the bytes of one piece, whatever is there already and whatever goes wrong.

use std::collections::BTreeMap;
use std::fs;

use serde_json::Value as Json;

use crate::space::Space;

/// A ball under a map; `SPLIT` and the rest of the sampler are put in.
fn pipeline(height: u32, sampler: &str, split: &str) -> String {
    format!(
        "params: {{ spp: 16 }}
stages:
  env: {{ synthesize: {{ name: sun-sky, width: 32 }} }}
  ball:
    render:
      env: env
      scene:
        camera: {{ perspective: {{ origin: [0, 0, 4], fov_degrees: 40 }} }}
        film: {{ resolution: [24, {height}], layers: [normal, variance] }}
        sampler: {{ {sampler} }}
        shapes: [{{ sphere: {{}}, bsdf: {{ plastic: {{}} }} }}]
    save: pfm
{split}"
    )
}

const SOBOL: &str = "sobol: { samples_per_pixel: $spp, replicates: 4 }";

fn space(height: u32, sampler: &str, split: &str) -> Space {
    let space = Space::new();
    space.pipeline(&pipeline(height, sampler, split));
    space
}

/// Identity and picture of a run that computes the ball, and what became of its parts.
struct Ball {
    result_id: Json,
    picture: Vec<u8>,
    /// Outcome of each part that was needed, by its number.
    parts: BTreeMap<u64, String>,
}

fn entry(space: &Space) -> Json {
    let manifest = space.manifest();
    manifest["jobs"].as_array().unwrap().iter().find(|job| job["stage"] == "ball").expect("the ball is a job").clone()
}

fn ball(space: &Space, arguments: &[&str]) -> Ball {
    let result_id = space.summary(arguments)["result_id"].clone();
    let entry = entry(space);
    let part = |part: &Json| (part["number"].as_u64().unwrap(), part["outcome"].as_str().unwrap().to_owned());
    let parts = entry["parts"].as_array().into_iter().flatten().map(part).collect();
    Ball { result_id, picture: space.read("outputs/p/ball.pfm"), parts }
}

fn ran(numbers: impl IntoIterator<Item = u64>) -> BTreeMap<u64, String> {
    numbers.into_iter().map(|number| (number, "ran".to_owned())).collect()
}

#[test]
fn a_split_render_has_the_bytes_of_one_piece() {
    let samplers = [SOBOL, "independent: { samples_per_pixel: 21 }", "stratified: { samples_per_pixel: 16 }"];
    // So many bands and blocks: a stratified render is split by bands alone.
    for (sampler, counts) in samplers.into_iter().zip([[5, 8, 2], [5, 6, 3], [5, 2, 0]]) {
        for ((height, split), count) in [(80, 7), (33, 9), (12, 3)].into_iter().zip(counts) {
            let expected = ball(&space(height, sampler, ""), &[]);
            let found = ball(&space(height, sampler, &format!("    split: {split}\n")), &["-j", "2"]);
            assert_eq!(found.parts, ran(1..=count), "{sampler}, {height} rows");
            assert_eq!((found.result_id, found.picture), (expected.result_id, expected.picture), "{sampler}, {height} rows");
        }
    }
}

#[test]
fn how_it_is_split_is_in_no_key() {
    let space = space(48, SOBOL, "    split: 3\n");
    let whole = ball(&space, &[]);
    for split in ["", "    split: 8\n"] {
        space.pipeline(&pipeline(48, SOBOL, split));
        assert_eq!(space.executed(&[]), 0, "{split}");
        assert_eq!(space.read("outputs/p/ball.pfm"), whole.picture);
    }
}

#[test]
fn a_longer_render_repeats_nothing_of_a_shorter_one() {
    let expected = ball(&space(12, SOBOL, ""), &["-s", "spp=64"]);
    // In blocks of four samples of each replicate, the first of which the shorter one has.
    for before in ["", "    split: 2\n"] {
        let space = space(12, SOBOL, before);
        space.summary(&[]);
        space.pipeline(&pipeline(12, SOBOL, "    split: 4\n"));
        let plan = space.run(&["plan", "p.yaml", "-v", "-s", "spp=64"]);
        assert!(plan.expect(0, &[]).stdout.contains("16 -> 64; in 4 parts"), "{}", plan.stdout);
        let found = ball(&space, &["-s", "spp=64"]);
        assert_eq!(found.parts, ran(2..=4), "the first samples are there already");
        assert_eq!((found.result_id, found.picture), (expected.result_id.clone(), expected.picture.clone()));
    }
}

#[test]
fn bands_go_on_from_what_there_is() {
    let expected = ball(&space(48, SOBOL, ""), &["-s", "spp=64"]);
    for before in ["", "    split: 2\n", "    split: 3\n"] {
        let space = space(48, SOBOL, before);
        space.summary(&[]);
        space.pipeline(&pipeline(48, SOBOL, "    split: 3\n"));
        let found = ball(&space, &["-s", "spp=64"]);
        assert_eq!((found.parts, found.result_id), (ran(1..=3), expected.result_id.clone()));
        assert_eq!(found.picture, expected.picture);
    }
}

/// A file of the store's shelf by the digest that names it.
fn stored(space: &Space, shelf: &str, name: &str) -> String {
    let of_shelf = space.files(&format!("outputs/.store/v1/{shelf}"));
    let found = of_shelf.iter().find(|path| path.replace('/', "").contains(name)).unwrap_or_else(|| panic!("{name}"));
    format!("outputs/.store/v1/{shelf}/{found}")
}

#[test]
fn parts_outlive_their_whole_and_a_lost_one_is_computed_again() {
    let space = space(48, SOBOL, "    split: 3\n");
    let whole = ball(&space, &[]);
    let entry = entry(&space);
    let remove_whole = || {
        let digests = entry["outputs"].as_array().unwrap().iter().map(|output| ("cas", &output["sha256"]));
        for (shelf, name) in digests.chain([("ac", &entry["key"])]) {
            fs::remove_file(space.path(&stored(&space, shelf, name.as_str().unwrap()))).unwrap();
        }
        for folder in ["p", ".store/v1/publications", ".store/v1/notes"] {
            fs::remove_dir_all(space.path(&format!("outputs/{folder}"))).unwrap();
        }
    };
    remove_whole();
    let again = ball(&space, &[]);
    assert!(again.parts.values().all(|outcome| outcome == "hit") && again.parts.len() == 3, "{:?}", again.parts);
    assert_eq!((again.result_id, again.picture), (whole.result_id.clone(), whole.picture.clone()));

    remove_whole();
    let second = entry["parts"][1]["key"].as_str().unwrap();
    let text = space.read(&stored(&space, "ac", second));
    let line = text.split(|byte| *byte == b'\n').find(|line| line.starts_with(b"{")).expect("a record is a line of JSON");
    let record: Json = serde_json::from_slice(line).unwrap();
    let film = record["outputs"][1]["content"]["digest"].as_str().unwrap().to_owned();
    fs::write(space.path(&stored(&space, "cas", &film)), "short").unwrap();
    let healed = ball(&space, &[]);
    assert_eq!((healed.parts[&1].as_str(), healed.parts[&2].as_str(), healed.parts[&3].as_str()), ("hit", "ran", "hit"));
    assert_eq!((healed.result_id, healed.picture), (whole.result_id, whole.picture));
}

#[test]
fn an_interrupted_render_goes_on_with_the_parts_that_are_missing() {
    let expected = ball(&space(48, SOBOL, ""), &["-s", "spp=256"]);
    let space = space(48, SOBOL, "    split: 3\n");
    let mut run = space.command(&["run", "p.yaml", "-q", "-j", "1", "-s", "spp=256"]).stdout(std::process::Stdio::null()).spawn().unwrap();
    // The map, and a part.
    while space.files("outputs/.store/v1/ac").len() < 2 {
        assert!(run.try_wait().unwrap().is_none(), "the run ends too soon");
        std::thread::yield_now();
    }
    assert!(std::process::Command::new("kill").args(["-INT", &run.id().to_string()]).status().unwrap().success());
    assert_eq!(run.wait().unwrap().code(), Some(130));
    assert_eq!(entry(&space)["outcome"], "interrupted");
    let plan = space.run(&["plan", "p.yaml", "-v", "-s", "spp=256"]);
    assert!(plan.expect(0, &[]).stdout.contains("run    ball  "), "{}", plan.stdout);
    let found = ball(&space, &["-s", "spp=256"]);
    assert_eq!((found.parts[&1].as_str(), found.parts[&3].as_str()), ("hit", "ran"));
    assert_eq!((found.result_id, found.picture), (expected.result_id, expected.picture));
}

#[test]
fn a_forced_render_is_computed_in_all_its_parts() {
    let space = space(48, SOBOL, "    split: 3\n");
    space.summary(&[]);
    let forced = ball(&space, &["--force", "ball"]);
    assert_eq!(forced.parts, ran(1..=3));
}

#[test]
fn workers_share_one_render() {
    let alone = ball(&space(48, SOBOL, ""), &[]);
    let team = ball(&space(48, SOBOL, "    split: 3\n"), &["--executor", "processes", "--workers", "2"]);
    assert_eq!(team.parts, ran(1..=3));
    assert_eq!((team.result_id, team.picture), (alone.result_id, alone.picture));
}

#[test]
fn a_part_that_fails_fails_the_render_once() {
    let body = |split: &str| {
        let scene = "film: { resolution: [8, 64] }, shapes: [{ mesh: { path: bad.ply } }]";
        format!(
            "stages:\n  ball: {{ render: {{ scene: {{ {scene} }} }}, save: pfm{split} }}\n  all: {{ tone-map: {{ of: ball }}, save: png }}\n"
        )
    };
    let outcome = |split: &str, arguments: &[&str]| {
        let space = Space::new();
        space.pipeline(&body(split)).write("bad.ply", "ply\nformat ascii 1.0\nelement vertex 1\n");
        let finished = space.run(&[&["run", "p.yaml"], arguments].concat());
        assert_eq!(finished.stderr.matches("error:").count(), 1, "{}", finished.stderr);
        let outcomes: Vec<Json> = space.manifest()["jobs"].as_array().unwrap().iter().map(|job| job["outcome"].clone()).collect();
        (finished.code, outcomes)
    };
    let expected = outcome("", &[]);
    assert_eq!(expected.0, 1);
    for arguments in [&[][..], &["-k"], &["--executor", "processes"], &["--executor", "processes", "-k"]] {
        assert_eq!(outcome(", split: 4", arguments), expected, "{arguments:?}");
    }
}

#[test]
fn mistakes_in_split_are_told_with_what_to_do() {
    let check = |split: &str, texts: &[&str]| {
        let space = Space::new();
        space.pipeline(&pipeline(12, SOBOL, &format!("    split: {split}\n")));
        space.run(&["check", "p.yaml"]).expect(2, texts);
    };
    for wrong in ["1", "1025", "2.5", "many"] {
        check(wrong, &["`split` must be a number of parts from 2 to 1024", "p.yaml:16:12"]);
    }
    let space = Space::new();
    space.pipeline("stages:\n  env: { synthesize: { name: sun-sky }, split: 4 }\n");
    space.run(&["check", "p.yaml"]).expect(2, &["a job of kind `synthesize` cannot be split", "`render`"]);
    // Parts count as jobs.
    let space = Space::new();
    space.pipeline(&format!(
        "axes: {{ seed: {{ range: [1, 1000, 1] }} }}\n{}",
        pipeline(12, SOBOL, "    split: 1000\n").replace("env: env", "env: env\n      seed: $seed")
    ));
    space.run(&["check", "p.yaml"]).expect(2, &["over the limit of"]);
}

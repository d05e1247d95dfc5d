//! What can be done with finished runs: verify, diff, which; and what a manifest and a crate say.

use std::fs;

use serde_json::Value as Json;

use crate::space::Space;

const PIPELINE: &str = "\
params: { gamma: 1.8, map: maps/sky.pfm }
axes: { n: [4, 8] }
stages:
  env: { load: { path: $map } }
  dist: { distribution: { of: env } }
  samples: { sample: { of: dist, count: $n }, save: csv }
  ldr: { tone-map: { of: env, gamma: $gamma }, save: png }
  sky: { synthesize: { name: gradient, width: 16 }, save: exr }
  rows: { profile: { of: dist } }
  curve: { plot: { of: rows, x: row, y: [pdf] }, save: [svg, png, pdf] }
";

fn map(value: f32) -> Vec<u8> {
    [b"PF\n4 2\n-1.0\n".to_vec(), value.to_le_bytes().repeat(24)].concat()
}

fn space() -> Space {
    let space = Space::new();
    space.pipeline(PIPELINE.split("  rows").next().unwrap()).write("maps/sky.pfm", map(0.5));
    space
}

fn run_id(summary: &Json) -> String {
    summary["run_id"].as_str().unwrap().to_owned()
}

#[test]
fn a_run_is_made_again_bit_for_bit_by_id_folder_manifest_and_name() {
    let space = space();
    let id = run_id(&space.summary(&[]));
    let before = space.files("outputs");
    for name in [id.clone(), "p".into(), "outputs/p".into(), format!("outputs/p/runs/{id}"), "outputs/p/manifest.json".into()] {
        let verified = space.run(&["verify", &name, "-q"]);
        verified.expect(0, &[]);
        assert!(verified.stdout.contains("6 jobs and 4 files made again, the same bit for bit"), "{}", verified.stdout);
    }
    assert_eq!(space.files("outputs"), before, "verify leaves outputs and store alone");
    let answer: Json = serde_json::from_str(&space.run(&["verify", "p", "--format", "json", "-q"]).stdout).unwrap();
    assert_eq!((answer["is_equal"].as_bool(), &answer["result_id"]), (Some(true), &answer["again"]));
}

#[test]
fn another_result_is_found_and_named() {
    let space = space();
    space.summary(&[]);
    let manifest = space.manifest();
    let digest = manifest["jobs"].as_array().unwrap().iter().find(|job| job["stage"] == "ldr").unwrap()["outputs"][0]["sha256"]
        .as_str()
        .unwrap()
        .to_owned();
    let text = String::from_utf8(space.read("outputs/p/manifest.json")).unwrap();
    space.write("forged.json", text.replace(&digest, &"0".repeat(64)));
    let verified = space.run(&["verify", "forged.json", "-q"]);
    verified.expect(4, &[]);
    assert!(verified.stdout.contains("ldr: its result has other bytes"), "{}", verified.stdout);
}

#[test]
fn inputs_are_found_by_name_or_content_or_asked_for() {
    let space = space();
    space.write("elsewhere/night.pfm", map(2.0));
    let map = format!("map={}", space.path("elsewhere/night.pfm").display());
    space.summary(&["-s", &map]);
    fs::create_dir(space.path("box")).unwrap();
    fs::rename(space.path("elsewhere/night.pfm"), space.path("box/renamed.pfm")).unwrap();
    fs::remove_dir(space.path("elsewhere")).unwrap();
    space.run(&["verify", "p", "-q", "--inputs", "maps"]).expect(2, &["`elsewhere/night.pfm`", "--inputs"]);
    space.run(&["verify", "p", "-q", "--inputs", "box"]).expect(0, &[]);
    // A file of the same name with other content is not taken.
    space.write("maps/elsewhere/night.pfm", self::map(3.0));
    space.run(&["verify", "p", "-q", "--inputs", "maps"]).expect(2, &["other content"]);
}

#[test]
fn partial_and_failed_runs_are_verified_as_far_as_they_went() {
    let space = space();
    space.run(&["run", "p.yaml", "--only", "samples[n=8]"]).expect(0, &[]);
    let verified = space.run(&["verify", "p", "-q"]);
    assert!(verified.stdout.contains("3 jobs and 1 file made again"), "{}{}", verified.stdout, verified.stderr);
    space.write("maps/sky.pfm", "PF\nno map");
    space.run(&["run", "p.yaml", "-k"]).expect(1, &[]);
    let verified = space.run(&["verify", "p", "-q"]);
    verified.expect(0, &["env"]);
    assert!(verified.stdout.contains("did not finish"), "{}", verified.stdout);
}

#[test]
fn includes_and_axes_of_the_command_line_are_made_again() {
    let space = space();
    let body = PIPELINE.split("  rows").next().unwrap();
    space.pipeline(&format!("include: [more/other.yaml]\n{body}"));
    space.write("more/other.yaml", "stages:\n  more: { load: { path: deep.pfm }, save: pfm }\n").write("more/deep.pfm", map(0.25));
    space.summary(&["-a", "n=2,3,5", "--seed", "11"]);
    let verified = space.run(&["verify", "p", "-q"]);
    verified.expect(0, &[]);
    assert!(verified.stdout.contains("8 jobs and 6 files"), "{}", verified.stdout);
}

#[test]
fn a_run_that_is_not_there_or_leads_out_of_its_folder_is_refused() {
    let space = space();
    space.summary(&[]);
    space.run(&["verify", "q"]).expect(2, &["there is no run `q`"]);
    space.run(&["diff", "p", "nowhere"]).expect(2, &["`nowhere`"]);
    space.write("bad.json", "{ \"schema\": 1 }");
    space.run(&["verify", "bad.json"]).expect(2, &["is no manifest"]);
    let text = String::from_utf8(space.read("outputs/p/manifest.json")).unwrap();
    space.write("evil.json", text.replace("\"path\":\"p.yaml\"", "\"path\":\"../../p.yaml\""));
    space.run(&["verify", "evil.json"]).expect(2, &["leads out of its folder"]);
}

#[test]
fn two_runs_are_compared_by_parameters_images_and_tables() {
    let space = space();
    let first = run_id(&space.summary(&[]));
    let second = run_id(&space.summary(&["-s", "gamma=2.2", "--seed", "8"]));
    let compared = space.run(&["diff", &first, &second, "--images", "drawn"]);
    compared.expect(4, &[]);
    for text in [
        "seed 7 -> 8",
        "-s gamma as in the file -> 2.2",
        "ldr: parameter gamma 1.8 -> 2.2",
        "samples (2 jobs): parameter seed 7 -> 8",
        "ldr: rmse 0.0",
        "row 1, ",
        "samples/n=4.csv",
    ] {
        assert!(compared.stdout.contains(text), "`{text}` is missing in:\n{}", compared.stdout);
    }
    assert!(space.read("drawn/ldr.png").starts_with(b"\x89PNG"));
    let json = space.run(&["diff", &first, &second, "--format", "json", "--only", "ldr"]);
    let answer: Json = serde_json::from_str(&json.stdout).unwrap();
    let image = answer["differences"].as_array().unwrap().iter().find(|one| one["result"] == "").unwrap();
    assert!(image["measures"][0]["value"].as_f64().unwrap() > 0.0, "{image}");
    assert_eq!(answer["comparison"]["files"].as_array().unwrap().len(), 1);
}

#[test]
fn equal_runs_are_equal_and_a_run_that_changed_nothing_stands_for_the_other() {
    let space = space();
    let first = run_id(&space.summary(&[]));
    let second = run_id(&space.summary(&[]));
    assert_ne!(first, second);
    let compared = space.run(&["diff", &first, &second]);
    compared.expect(0, &[]);
    assert!(compared.stdout.contains("the results are the same: 6 jobs and 4 files"), "{}", compared.stdout);
    space.run(&["diff", "p", "p", "--metrics", "rsme"]).expect(2, &["there is no metric `rsme`", "rmse"]);
    space.run(&["diff", "p", "p", "--only", "lrd"]).expect(2, &["neither run has a stage `lrd`"]);
}

#[test]
fn a_file_leads_back_to_its_run() {
    let space = space();
    space.pipeline(PIPELINE);
    let id = run_id(&space.summary(&[]));
    let published = ["ldr.png", "sky.exr", "samples/n=8.csv", "curve.svg", "curve.png", "curve.pdf"];
    for path in published {
        let which = space.run(&["which", &format!("outputs/p/{path}")]);
        which.expect(0, &[]);
        assert!(which.stdout.contains(&id) && which.stdout.contains("key "), "{path}: {}", which.stdout);
    }
    // A copy under another name, elsewhere; and one whose bytes were changed but whose origin stands in it.
    let mut bytes = space.read("outputs/p/ldr.png");
    space.write("copy.bin", &bytes);
    assert!(space.run(&["which", "copy.bin"]).stdout.contains("outputs/p/ldr.png"));
    bytes.extend(b"tail");
    space.write("changed.png", &bytes);
    assert!(space.run(&["which", "changed.png"]).stdout.contains("with other bytes"));
    // What the file says of itself needs no run.
    let alone = space.run(&["which", "changed.png", "--outputs", "nowhere", "--format", "json"]);
    let answer: Json = serde_json::from_str(&alone.stdout).unwrap();
    assert_eq!((answer["origin"]["stage"].as_str(), answer["run"].is_null()), (Some("ldr"), true));
    space.run(&["which", "maps/sky.pfm"]).expect(1, &["says nothing of its origin"]);
    space.run(&["which", "absent.png"]).expect(2, &["absent.png"]);
    space.run(&["which", "outputs"]).expect(2, &["not a regular file"]);
}

#[test]
fn a_manifest_says_nothing_of_the_folders_of_the_machine() {
    let space = space();
    space.write("outside/night.pfm", map(2.0)).write("project/p.yaml", fs::read(space.path("p.yaml")).unwrap());
    let map = format!("map={}", space.path("outside/night.pfm").display());
    space.run(&["run", "project/p.yaml", "-s", &map]).expect(0, &[]);
    let root = space.path("").display().to_string();
    for file in ["manifest.json", "ro-crate-metadata.json"] {
        let text = String::from_utf8(space.read(&format!("outputs/p/{file}"))).unwrap();
        assert!(!text.contains(root.trim_end_matches('/')), "{file}: {text}");
    }
    let manifest = space.manifest();
    assert_eq!(manifest["overrides"]["params"]["map"], "night.pfm");
    space.run(&["verify", "p", "-q", "--inputs", "outside"]).expect(0, &[]);
}

#[test]
fn a_crate_stands_beside_the_manifest_and_a_run_that_does_nothing_leaves_it_alone() {
    let space = space();
    let id = run_id(&space.summary(&[]));
    let text = space.read("outputs/p/ro-crate-metadata.json");
    let document: Json = serde_json::from_slice(&text).unwrap();
    let graph = document["@graph"].as_array().unwrap();
    for part in graph[1]["hasPart"].as_array().unwrap() {
        let path = part["@id"].as_str().unwrap();
        assert!(path.starts_with("urn:") || space.path(&format!("outputs/p/{path}")).is_file(), "{path}");
    }
    assert_eq!(graph[1]["mainEntity"]["@id"], format!("runs/{id}/spec/p.yaml"));
    space.summary(&[]);
    assert_eq!(space.read("outputs/p/ro-crate-metadata.json"), text);
}

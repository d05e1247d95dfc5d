//! The store as a user meets it: its commands, who may use it, and a disk that refuses.

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::process::{Command, Stdio};

use serde_json::Value as Json;

use crate::space::{Finished, Space};

const PIPELINE: &str = "axes: { n: [4, 16] }
stages:
  env: { load: { path: 'synthetic:gradient' }, save: pfm }
  dist: { distribution: { of: env } }
  samples: { sample: { of: dist, count: $n }, save: csv }
";

fn filled() -> Space {
    let space = Space::new();
    space.pipeline(PIPELINE);
    space.summary(&[]);
    space
}

fn json(finished: &Finished) -> Json {
    serde_json::from_str(&finished.stdout).unwrap_or_else(|error| panic!("{error}: {}", finished.stdout))
}

/// Runs a shell line in which `$PIPELINE` is the program.
fn shell(space: &Space, line: &str) -> Finished {
    let mut command = Command::new("sh");
    command.args(["-c", line]).current_dir(space.path("")).stdin(Stdio::null()).env("PIPELINE", env!("CARGO_BIN_EXE_pipeline"));
    command.env("NO_COLOR", "1").env_remove("PIPELINE_OUTPUTS").env_remove("PIPELINE_STORE");
    Finished::from(command.output().unwrap())
}

#[test]
fn stats_count_what_a_run_left() {
    let space = filled();
    let finished = space.run(&["store", "stats", "--format", "json"]);
    finished.expect(0, &[]);
    let stats = json(&finished);
    assert_eq!((&stats["results"]["count"], &stats["publications"]["count"]), (&4.into(), &3.into()), "{stats}");
    assert_eq!(stats["types"]["samples"]["results"], 2);
    let text = space.run(&["store", "stats"]);
    assert!(text.stdout.contains("blobs") && text.stdout.contains("of type envmap"), "{}", text.stdout);
}

#[test]
fn verify_finds_damage_and_the_next_run_heals_it() {
    let space = filled();
    space.run(&["store", "verify"]).expect(0, &[]);
    let blob = &space.files("outputs/.store/v1/cas")[0];
    let path = format!("outputs/.store/v1/cas/{blob}");
    let mut bytes = space.read(&path);
    bytes[7] ^= 1;
    space.write(&path, bytes);
    let finished = space.run(&["store", "verify", "--format", "json"]);
    finished.expect(4, &[]);
    let findings = json(&finished);
    assert_eq!(findings["damage"][0]["name"], blob.rsplit_once('/').unwrap().1, "{findings}");
    space.run(&["store", "verify"]).expect(0, &[]);
    assert_eq!(space.files("outputs/.store/v1/damaged").len(), findings["damage"].as_array().unwrap().len());
    fs::remove_dir_all(space.path("outputs/p")).unwrap();
    space.summary(&[]);
    space.run(&["store", "verify"]).expect(0, &[]);
}

#[test]
fn gc_says_what_would_go_then_removes_it_and_results_come_back() {
    let space = filled();
    let samples = space.read("outputs/p/samples/n=4.csv");
    let before = space.files("outputs/.store/v1").len();
    let would = json(&space.run(&["store", "gc", "--max-size", "0", "--grace", "0s", "-n", "--format", "json"]));
    assert_eq!(space.files("outputs/.store/v1").len(), before);
    assert_eq!(would["records"], 7, "{would}");
    space.run(&["store", "gc", "--max-size", "0"]).expect(0, &[]);
    assert_eq!(space.executed(&[]), 0, "what was used within the hour stays");
    let gone = json(&space.run(&["store", "gc", "--max-size", "0", "--grace", "0s", "--format", "json"]));
    assert_eq!(gone["records"], would["records"]);
    assert_eq!(space.files("outputs/.store/v1/ac").len() + space.files("outputs/.store/v1/cas").len(), 0);
    fs::remove_dir_all(space.path("outputs/p")).unwrap();
    assert_eq!(space.executed(&[]), 4);
    assert_eq!(space.read("outputs/p/samples/n=4.csv"), samples);
    space.run(&["store", "gc", "--older-than", "soon"]).expect(2, &["30d"]);
}

#[test]
fn the_commands_on_a_store_that_is_not_there_find_nothing() {
    let space = Space::new();
    for command in ["stats", "verify", "gc"] {
        space.run(&["store", command, "--store", "nowhere"]).expect(0, &[]);
    }
    assert!(!space.path("nowhere").exists());
}

#[test]
fn a_store_that_others_may_write_to_is_refused_with_what_to_do() {
    let space = filled();
    fs::set_permissions(space.path("outputs/.store"), fs::Permissions::from_mode(0o777)).unwrap();
    let refused = ["outputs/.store", "others may write to it", "chmod", "--allow-shared-store"];
    space.run(&["run", "p.yaml", "-s", "x=1"]).expect(2, &["x"]);
    space.run(&["run", "p.yaml", "-a", "n=5"]).expect(3, &refused);
    space.run(&["plan", "p.yaml", "-a", "n=5"]).expect(3, &refused);
    space.run(&["store", "verify"]).expect(3, &refused);
    space.run(&["run", "p.yaml", "-a", "n=5", "--allow-shared-store"]).expect(0, &[]);
    let mut command = space.command(&["run", "p.yaml", "-a", "n=6"]);
    assert!(command.env("PIPELINE_ALLOW_SHARED_STORE", "1").output().unwrap().status.success());
}

#[test]
fn a_disk_that_is_full_is_told_with_the_path_and_afterwards_all_is_right() {
    let space = Space::new();
    space.pipeline(PIPELINE);
    // Files of at most 4 KiB: the map does not fit, and the write says so as on a full disk.
    let finished = shell(&space, "ulimit -f 8; \"$PIPELINE\" run p.yaml");
    finished.expect(3, &["cannot write `outputs/"]);
    assert!(space.files("outputs/.store/v1/tmp").is_empty() && space.files("outputs/.tmp").is_empty(), "no temporary file is left");
    assert_eq!(space.summary(&[])["status"], "done");
    space.run(&["store", "verify"]).expect(0, &[]);
}

#[test]
fn a_reader_that_is_full_is_the_systems_failure() {
    let space = filled();
    if fs::metadata("/dev/full").is_err() {
        println!("skipped: there is no /dev/full here");
        return;
    }
    shell(&space, "\"$PIPELINE\" store stats > /dev/full").expect(3, &["cannot write to stdout"]);
    shell(&space, "\"$PIPELINE\" run p.yaml --format json > /dev/full").expect(3, &["cannot write to stdout"]);
}

#[test]
fn a_folder_that_cannot_be_written_is_told_with_its_path() {
    let space = filled();
    if is_superuser() {
        println!("skipped: the super-user may write anywhere");
        return;
    }
    for folder in ["outputs/p/samples", "outputs/.store/v1/tmp"] {
        fs::set_permissions(space.path(folder), fs::Permissions::from_mode(0o500)).unwrap();
        space.run(&["run", "p.yaml", "-a", "n=8"]).expect(3, &["cannot ", "outputs/"]);
        fs::set_permissions(space.path(folder), fs::Permissions::from_mode(0o700)).unwrap();
        space.run(&["run", "p.yaml", "-a", "n=8"]).expect(0, &[]);
    }
}

fn is_superuser() -> bool {
    Command::new("id").arg("-u").output().is_ok_and(|output| output.stdout.starts_with(b"0\n"))
}

#[test]
fn a_file_that_does_not_fit_in_memory_fails_before_it_is_read() {
    let space = Space::new();
    space.pipeline("stages:\n  env: { load: { path: map.pfm } }\n");
    space.write("map.pfm", [b"PF\n64 32\n-1.0\n".as_slice(), &[0; 12 * 64 * 32]].concat());
    space.run(&["run", "p.yaml", "--memory", "20KiB"]).expect(1, &["needs about 48.0 KiB", "--memory"]);
    space.run(&["run", "p.yaml", "--memory", "1MiB"]).expect(0, &[]);
}

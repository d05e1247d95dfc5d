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

/// Another machine: a folder of its own with the same pipeline.
fn machine() -> Space {
    let space = Space::new();
    space.pipeline(PIPELINE);
    space
}

#[test]
fn a_second_machine_takes_everything_from_the_store_behind_its_own() {
    let (far, one, two) = (Space::new(), machine(), machine());
    fs::set_permissions(far.path(""), fs::Permissions::from_mode(0o700)).unwrap();
    let behind = ["--store-remote", far.path("").to_str().unwrap()].map(str::to_owned);
    let behind: Vec<&str> = behind.iter().map(String::as_str).collect();
    let first = one.summary(&behind);
    let second = two.summary(&behind);
    assert_eq!((&second["measured"]["jobs"]["hit"], &second["result_id"]), (&4.into(), &first["result_id"]), "{second}");
    assert_eq!(one.read("outputs/p/samples/n=4.csv"), two.read("outputs/p/samples/n=4.csv"));
    // The page needs what no one has asked for yet.
    let page = two.run(&[&["report", "p"], behind.as_slice()].concat());
    page.expect(0, &[]);
    assert!(!page.stderr.contains("gone from the store"), "{}", page.stderr);

    fs::set_permissions(far.path(""), fs::Permissions::from_mode(0o777)).unwrap();
    let refused = machine().run(&[&["run", "p.yaml"], behind.as_slice()].concat());
    refused.expect(3, &["others may write to it", "--allow-shared-store", "--store-trust"]);
    machine().run(&["run", "p.yaml", "--store-remote", "http://x/y"]).expect(2, &["s3://BUCKET/PREFIX"]);
    machine().run(&["run", "p.yaml", "--store-trust", "nowhere"]).expect(2, &["cannot read `nowhere`"]);
}

#[test]
fn a_run_is_pushed_checked_and_pulled() {
    let (far, one, two) = (Space::new(), filled(), machine());
    let place = far.path("").to_str().unwrap().to_owned();
    fs::set_permissions(far.path(""), fs::Permissions::from_mode(0o777)).unwrap();
    one.run(&["store", "keygen", "key"]).expect(0, &["key.pub"]);
    one.run(&["store", "keygen", "key"]).expect(3, &["cannot write `key`"]);
    let secret = one.path("key").to_str().unwrap().to_owned();
    let trust = format!("{secret}.pub");

    let sent = one.run(&["store", "push", "p", &place, "--store-sign", &secret, "--store-trust", &trust, "--format", "json"]);
    sent.expect(0, &[]);
    assert_eq!((&json(&sent)["records"], &json(&sent)["new"]), (&7.into(), &7.into()), "{}", sent.stdout);
    one.run(&["store", "push", &place]).expect(2, &["<RUN>"]);
    let brought = two.run(&["store", "pull", "p", &place, "--store-trust", &trust]);
    brought.expect(0, &[]);
    assert!(brought.stdout.contains("7 records here, 7 of them new, 3 files published"), "{}", brought.stdout);
    assert_eq!(two.executed(&[]), 0);
    two.run(&["store", "verify"]).expect(0, &[]);
    two.run(&["diff", "p", one.path("outputs/p").to_str().unwrap()]).expect(0, &[]);
    two.run(&["store", "pull", "q", &place, "--store-trust", &trust]).expect(2, &["holds no run `q`", "did you mean `p`?"]);

    let three = machine();
    three.run(&["store", "keygen", "other"]).expect(0, &[]);
    three.run(&["store", "pull", "p", &place, "--store-trust", "other.pub"]).expect(2, &["no key that is trusted here has signed it"]);
    let all = three.run(&["store", "pull", "--all", &place, "--store-trust", "other.pub"]);
    all.expect(1, &[]);
    assert!(all.stdout.contains("not carried: result record"), "{}", all.stdout);
    assert_eq!(three.executed(&[]), 4);

    let checked = three.run(&["store", "check", &place]);
    checked.expect(0, &[]);
    assert!(checked.stdout.contains("all is as it should be"), "{}", checked.stdout);
    three.run(&["store", "check", "/nowhere"]).expect(3, &["cannot use `/nowhere`"]);
}

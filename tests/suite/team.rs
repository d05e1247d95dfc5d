//! Runs whose jobs are computed by workers: the same results as alone, the same errors, and what is told of them.

use std::path::PathBuf;

use serde_json::Value as Json;

use crate::space::Space;

/// A sweep of two axes with a part that all share and one that collects.
const SWEEP: &str = "\
axes: { n: [4, 8, 16], seed: [1, 2] }
stages:
  env: { synthesize: { name: sun-sky, width: 32 } }
  dist: { distribution: { of: env } }
  samples: { sample: { of: dist, count: $n, seed: $seed }, save: csv }
  sphere: { relight: { env: env, with: samples, estimator: pdf-weighted, size: 9 }, save: exr }
  truth: { relight: { env: env, estimator: exact, size: 9 }, resources: { threads: 2, time: 5m } }
  error: { compare: { of: sphere, to: truth, metrics: [rmse] } }
  all: { table: { of: error, over: [n, seed] }, save: csv }
";

fn published(space: &Space) -> Vec<(String, Vec<u8>)> {
    let files = space.files("outputs/p").into_iter().filter(|path| !path.starts_with("runs/") && !path.ends_with(".json"));
    files.map(|path| (path.clone(), space.read(&format!("outputs/p/{path}")))).collect()
}

fn team_folder(space: &Space) -> PathBuf {
    made_team_folder(space).expect("a run with workers")
}

/// The same while it may not be there yet.
fn made_team_folder(space: &Space) -> Option<PathBuf> {
    let mut runs = std::fs::read_dir(space.path("outputs/p/runs")).ok()?.map(|entry| entry.unwrap().path());
    runs.find(|path| path.file_name().unwrap().to_str().unwrap().starts_with("team-"))
}

#[test]
fn workers_give_the_results_and_files_of_a_run_alone() {
    let (alone, team) = (Space::new(), Space::new());
    let expected = alone.pipeline(SWEEP).summary(&[]);
    let summary = team.pipeline(SWEEP).summary(&["--executor", "processes", "--workers", "2"]);
    assert_eq!(summary["result_id"], expected["result_id"]);
    assert_eq!(summary["measured"]["jobs"], expected["measured"]["jobs"], "all are told as computed by this run");
    assert_eq!(published(&team), published(&alone));
    let manifest = team.manifest();
    let jobs = manifest["jobs"].as_array().unwrap();
    assert!(jobs.iter().all(|job| job["measured"]["host"].is_string()), "every job has the machine that computed it");
    assert!(alone.manifest()["jobs"].as_array().unwrap().iter().all(|job| job["measured"]["host"].is_null()));

    // Nothing is computed twice, and nothing is left over.
    let lines = |path: PathBuf| std::fs::read_to_string(path).unwrap_or_default();
    let journals = std::fs::read_dir(team_folder(&team).join("workers")).unwrap().map(|entry| lines(entry.unwrap().path()));
    let computed: usize = journals.map(|text| text.matches("\"computed\"").count()).sum();
    assert_eq!(computed, jobs.len());
    assert!(team.files("outputs/.store/v1/claims").is_empty() && team.files("outputs/.tmp").is_empty());
    assert_eq!(team.executed(&["--executor", "processes"]), 0, "a second run has nothing to do");
}

#[test]
fn the_status_of_a_run_adds_up_and_its_log_can_be_read() {
    let space = Space::new();
    let jobs = space.pipeline(SWEEP).executed(&["--executor", "processes", "--workers", "3"]);
    let status = space.run(&["status", "p", "--format", "json"]);
    let status: Json = serde_json::from_str(&status.expect(0, &[]).stdout).unwrap();
    assert_eq!((&status["jobs"]["computed"], &status["jobs"]["all"]), (&jobs.into(), &jobs.into()));
    assert_eq!((&status["jobs"]["waiting"], &status["jobs"]["running"]), (&0.into(), &0.into()));
    assert_eq!((&status["ending"], &status["has_driver"]), (&"finish".into(), &false.into()));
    let workers = status["workers"].as_array().unwrap();
    assert!(workers.iter().all(|worker| worker["state"] != "working"), "{workers:?}");
    let id = status["run"].as_str().unwrap();
    assert!(space.run(&["status", id]).expect(0, &[]).stdout.contains("over"));
    let names = workers.iter().map(|worker| team_folder(&space).join("workers").join(format!("{}.log", worker["name"].as_str().unwrap())));
    let logs: String = names.map(|path| std::fs::read_to_string(path).unwrap()).collect();
    assert!(logs.contains("ran  env") && logs.contains("worker ended"), "{logs}");
}

#[test]
fn a_job_that_fails_in_a_worker_fails_the_run_as_alone() {
    let body = "stages:\n  map: { load: { path: map.pfm } }\n  dist: { distribution: { of: map }, save: csv }\n";
    let outcome = |arguments: &[&str]| {
        let space = Space::new();
        space.pipeline(body).write("map.pfm", "PF\n2 2\n-1.0\nshort");
        let finished = space.run(&[&["run", "p.yaml"], arguments].concat());
        let error = finished.stderr.lines().find(|line| line.starts_with("error:")).unwrap_or_default().to_owned();
        let outcomes: Vec<Json> = space.manifest()["jobs"].as_array().unwrap().iter().map(|job| job["outcome"].clone()).collect();
        (finished.code, error, outcomes)
    };
    let expected = outcome(&[]);
    assert_eq!(expected.0, 1);
    assert_eq!(outcome(&["--executor", "processes"]), expected);
    assert_eq!(outcome(&["--executor", "processes", "-k"]), outcome(&["-k"]));
}

#[test]
fn workers_that_a_person_starts_do_the_work() {
    let space = Space::new();
    let expected = Space::new().pipeline(SWEEP).summary(&[])["result_id"].clone();
    let driver = space.pipeline(SWEEP).command(&["run", "p.yaml", "--executor", "manual", "--format", "json"]);
    let mut driver = { driver }.stdout(std::process::Stdio::piped()).stderr(std::process::Stdio::null()).spawn().unwrap();
    let is_ready = || made_team_folder(&space).is_some_and(|folder| folder.join("assignment.json").is_file());
    while !is_ready() {
        assert!(driver.try_wait().unwrap().is_none(), "the driver waits for workers");
        std::thread::yield_now();
    }
    let folder = team_folder(&space);
    let worker = space.run(&["worker", "--run", folder.to_str().unwrap(), "--name", "mine"]);
    worker.expect(0, &["worker mine on", "worker ended"]);
    let output = driver.wait_with_output().unwrap();
    let summary: Json = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!((output.status.code(), &summary["result_id"]), (Some(0), &expected));
}

#[test]
fn a_worker_does_nothing_where_the_inputs_are_others() {
    let space = Space::new();
    space.pipeline("stages:\n  map: { load: { path: map.pfm }, save: exr }\n");
    space.write("map.pfm", [b"PF\n1 1\n-1.0\n".as_slice(), &[0; 12]].concat());
    space.summary(&["--executor", "processes"]);
    let folder = team_folder(&space);
    let worker = |arguments: &[&str]| space.run(&[&["worker", "--run", folder.to_str().unwrap()], arguments].concat());
    worker(&[]).expect(0, &["worker ended: 1 hit"]);
    worker(&["--class", "7"]).expect(2, &["no class 7"]);
    worker(&["--name", "../x"]).expect(2, &["name"]);
    space.write("map.pfm", [b"PF\n1 1\n-1.0\n".as_slice(), &[1; 12]].concat());
    worker(&[]).expect(2, &["the plan of the run is another one here"]);
    space.run(&["worker", "--run", "nowhere"]).expect(2, &["there is no run with workers `nowhere`"]);
    space.run(&["status", "q"]).expect(2, &["there is no run with workers `q`"]);
}

#[test]
fn a_forced_job_is_run_by_the_driver_once() {
    let space = Space::new();
    space.pipeline(SWEEP).summary(&[]);
    assert_eq!(space.executed(&["--executor", "processes", "--force", "dist"]), 1);
}

#[test]
fn a_cancelled_run_says_so_and_goes_on_when_it_is_run_again() {
    let space = Space::new();
    space.pipeline(SWEEP);
    let mut driver = space.command(&["run", "p.yaml", "--executor", "manual"]).stderr(std::process::Stdio::null()).spawn().unwrap();
    while !made_team_folder(&space).is_some_and(|folder| folder.join("executor-manual").is_file()) {
        std::thread::yield_now();
    }
    space.run(&["cancel", "p"]).expect(0, &["is cancelled"]);
    assert_eq!(driver.wait().unwrap().code(), Some(143));
    assert_eq!(space.manifest()["status"], "interrupted");
    assert!(space.executed(&["--executor", "processes"]) > 0);
}

#[test]
fn mistakes_of_resources_profiles_and_executors_are_told_with_their_place() {
    let space = Space::new();
    space.pipeline("stages:\n  env: { synthesize: { name: sun-sky }, resources: { thread: 4, memory: much, time: 3 } }\n");
    space.run(&["check", "p.yaml"]).expect(2, &["p.yaml:5:", "unknown key `thread`", "`threads`?", "`memory` must", "`time` must"]);
    space.pipeline("stages:\n  env: { synthesize: { name: sun-sky } }\n").write("site.yaml", "partitoin: short\n");
    let run = |arguments: &[&str]| space.run(&[&["run", "p.yaml"], arguments].concat());
    run(&["--executor", "slurm", "--profile", "./site.yaml"]).expect(2, &["site.yaml:1:1", "did you mean `partition`?"]);
    run(&["--executor", "slrum"]).expect(2, &["did you mean `slurm`?"]);
    run(&["--profile", "./site.yaml"]).expect(2, &["`--profile` is for workers"]);
}

//! A folder of its own for each test, and the program run in it.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

use serde_json::Value as Json;

/// A folder that is removed with the value.
pub struct Space {
    folder: tempfile::TempDir,
}

/// What a run of the program left.
pub struct Finished {
    pub code: i32,
    pub stdout: String,
    pub stderr: String,
}

impl Space {
    pub fn new() -> Self {
        Self { folder: tempfile::tempdir().expect("the system has a place for temporary folders") }
    }

    /// Writes a file below the folder.
    pub fn write(&self, path: &str, content: impl AsRef<[u8]>) -> &Self {
        let path = self.path(path);
        fs::create_dir_all(path.parent().expect("a file has a folder")).unwrap();
        fs::write(path, content).unwrap();
        self
    }

    /// Writes `p.yaml`: a pipeline called `p` with these lines after the head.
    pub fn pipeline(&self, body: &str) -> &Self {
        self.write("p.yaml", format!("version: 1\npipeline: p\nseed: 7\n{body}"))
    }

    pub fn path(&self, path: &str) -> PathBuf {
        self.folder.path().join(path)
    }

    pub fn read(&self, path: &str) -> Vec<u8> {
        fs::read(self.path(path)).unwrap_or_else(|error| panic!("{path}: {error}"))
    }

    /// Runs the program in the folder.
    pub fn run(&self, arguments: &[&str]) -> Finished {
        let output = self.command(arguments).output().expect("the program starts");
        Finished::from(output)
    }

    /// The program with these arguments, not yet started.
    pub fn command(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_pipeline"));
        command.args(arguments).current_dir(self.folder.path()).stdin(Stdio::null());
        command.env("NO_COLOR", "1").env_remove("PIPELINE_OUTPUTS").env_remove("PIPELINE_STORE");
        command
    }

    /// Runs `p.yaml` with further arguments, which must succeed, and gives the summary.
    pub fn summary(&self, arguments: &[&str]) -> Json {
        let finished = self.run(&[&["run", "p.yaml", "--format", "json"], arguments].concat());
        assert_eq!(finished.code, 0, "{}", finished.stderr);
        serde_json::from_str(&finished.stdout).unwrap_or_else(|error| panic!("{error}: {}", finished.stdout))
    }

    /// Like `summary`, and gives the number of jobs that were executed.
    pub fn executed(&self, arguments: &[&str]) -> u64 {
        self.summary(arguments)["measured"]["jobs"]["ran"].as_u64().unwrap_or(0)
    }

    /// The latest manifest of pipeline `p`.
    pub fn manifest(&self) -> Json {
        serde_json::from_slice(&self.read("outputs/p/manifest.json")).unwrap()
    }

    /// All files below a folder, relative to it, sorted.
    pub fn files(&self, folder: &str) -> Vec<String> {
        let root = self.path(folder);
        let mut found = Vec::new();
        collect(&root, &root, &mut found);
        found.sort();
        found
    }
}

fn collect(root: &Path, folder: &Path, found: &mut Vec<String>) {
    let Ok(entries) = fs::read_dir(folder) else { return };
    for entry in entries.map(Result::unwrap) {
        let path = entry.path();
        if path.is_dir() {
            collect(root, &path, found);
        } else {
            found.push(path.strip_prefix(root).unwrap().to_string_lossy().into_owned());
        }
    }
}

impl From<Output> for Finished {
    fn from(output: Output) -> Self {
        Self {
            code: output.status.code().unwrap_or(-1),
            stdout: String::from_utf8(output.stdout).expect("what is printed is UTF-8"),
            stderr: String::from_utf8(output.stderr).expect("what is printed is UTF-8"),
        }
    }
}

impl Finished {
    /// Checks the exit code and that all of these texts stand in the messages.
    #[track_caller]
    pub fn expect(&self, code: i32, texts: &[&str]) -> &Self {
        assert_eq!(self.code, code, "{}", self.stderr);
        for text in texts {
            assert!(self.stderr.contains(text), "`{text}` is missing in:\n{}", self.stderr);
        }
        assert!(!self.stderr.contains("panicked"), "{}", self.stderr);
        self
    }
}

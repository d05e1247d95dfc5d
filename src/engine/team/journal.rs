//! What each worker says it does: a file of lines for each, that it alone writes.
//!
//! A line that is cut off or cannot be read says nothing. Nothing is decided by them but what is told: which machine computed
//! what, what goes on, and under which keys it is worth while to look into the store.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant, SystemTime};

use serde::{Deserialize, Serialize};

use crate::engine::digest::Digest;
use crate::engine::lines::line;
use crate::engine::owner::{Owner, host_name};
use crate::engine::system::SystemError;

/// How often a worker says that it is there.
pub const HEARTBEAT: Duration = Duration::from_secs(10);

/// A worker that has said nothing for so long is taken for lost where its process cannot be looked for.
pub const SILENCE: Duration = Duration::from_secs(60);

/// A line of a journal.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "event", rename_all = "kebab-case")]
pub enum Said {
    /// The first line.
    Began {
        /// The machine.
        host: String,
        /// The process, as in claims.
        owner: String,
        /// Threads it may use.
        threads: usize,
        /// Its class; none for one that takes any job.
        class: Option<usize>,
        /// When, by its own clock, in seconds since 1970.
        at: f64,
    },
    /// It begins a job.
    Started {
        /// Key of the job.
        key: Digest,
        /// `stage[axis=value,…]`.
        job: String,
    },
    /// It has computed a job.
    Computed {
        /// Key of the job.
        key: Digest,
        /// How long it took.
        seconds: f64,
        /// When it was done, by the same clock.
        at: f64,
    },
    /// A job gave nothing, or was left to another.
    GaveUp {
        /// Key of the job.
        key: Digest,
    },
    /// It is there.
    Alive,
    /// The last line.
    Ended {
        /// Why.
        why: String,
    },
}

/// Seconds since 1970 by this machine's clock.
pub fn clock() -> f64 {
    SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).map_or(0.0, |time| time.as_secs_f64())
}

/// The journal of this worker.
#[derive(Debug)]
pub struct Journal {
    file: File,
    said: Instant,
}

impl Journal {
    /// Begins a journal under a name that no other worker has.
    pub fn begin(folder: &Path, name: &str, threads: usize, class: Option<usize>) -> Result<Self, SystemError> {
        let path = folder.join(format!("{name}.jsonl"));
        let file = File::options().append(true).create_new(true).open(&path).map_err(SystemError::at("create", &path))?;
        let mut journal = Self { file, said: Instant::now() };
        let owner = Owner::this_process().to_string();
        journal.say(&Said::Began { host: host_name(), owner, threads, class, at: clock() });
        Ok(journal)
    }

    /// Adds a line. A full disk does not stop a worker for the sake of its journal.
    pub fn say(&mut self, said: &Said) {
        self.said = Instant::now();
        let _ = self.file.write_all(format!("{}\n", line(said)).as_bytes());
    }

    /// To be called often: says from time to time that the worker is there.
    pub fn keep_alive(&mut self) {
        if self.said.elapsed() >= HEARTBEAT {
            self.say(&Said::Alive);
        }
    }
}

/// The journals of all workers of a run, each read as far as it went.
#[derive(Debug)]
pub struct Journals {
    folder: PathBuf,
    read: BTreeMap<String, Reading>,
}

/// How far a journal was read.
#[derive(Debug, Default)]
struct Reading {
    offset: u64,
    /// A line whose end was not there yet.
    rest: Vec<u8>,
}

impl Journals {
    /// The journals in a folder, none of them read yet.
    pub fn in_folder(folder: PathBuf) -> Self {
        Self { folder, read: BTreeMap::new() }
    }

    /// What was said since the last call, with the worker's name.
    pub fn news(&mut self) -> Vec<(String, Said)> {
        let entries = fs::read_dir(&self.folder).into_iter().flatten().flatten();
        let names = entries.filter_map(|entry| entry.file_name().to_str()?.strip_suffix(".jsonl").map(str::to_owned));
        let mut names: Vec<String> = names.collect();
        names.sort();
        let mut news = Vec::new();
        for name in names {
            let reading = self.read.entry(name.clone()).or_default();
            // A file server shows what was added to whoever opens the file again.
            let lines = reading.lines(&self.folder.join(format!("{name}.jsonl")));
            news.extend(lines.into_iter().filter_map(|text| Some((name.clone(), serde_json::from_slice(&text).ok()?))));
        }
        news
    }
}

impl Reading {
    fn lines(&mut self, path: &Path) -> Vec<Vec<u8>> {
        let mut added = Vec::new();
        let read = File::open(path).and_then(|mut file| {
            file.seek(SeekFrom::Start(self.offset))?;
            file.read_to_end(&mut added)
        });
        self.offset += read.unwrap_or(0) as u64;
        self.rest.append(&mut added);
        let mut lines: Vec<Vec<u8>> = self.rest.split(|byte| *byte == b'\n').map(<[u8]>::to_vec).collect();
        self.rest = lines.pop().unwrap_or_default();
        lines
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_said_is_heard_once_and_half_a_line_only_when_it_is_whole() {
        let folder = tempfile::tempdir().unwrap();
        let mut journals = Journals::in_folder(folder.path().to_owned());
        assert!(journals.news().is_empty());
        let mut journal = Journal::begin(folder.path(), "one", 2, None).unwrap();
        assert!(Journal::begin(folder.path(), "one", 2, None).is_err(), "a name is given once");
        let key = Digest::of(b"key");
        journal.say(&Said::Computed { key, seconds: 0.5, at: 7.0 });
        let news = journals.news();
        assert!(matches!(&news[0], (name, Said::Began { threads: 2, .. }) if name == "one"));
        assert_eq!(news[1].1, Said::Computed { key, seconds: 0.5, at: 7.0 });
        journal.file.write_all(b"{\"event\":").unwrap();
        assert!(journals.news().is_empty());
        journal.file.write_all(b"\"alive\"}\nrubbish\n").unwrap();
        assert_eq!(journals.news(), [("one".to_owned(), Said::Alive)]);
    }
}

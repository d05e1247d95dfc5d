//! What a store keeps of the promises that stores are thought to make.
//!
//! Results are right whatever comes out: bytes are hashed, and records name what they are of. What is missing costs work done twice, or
//! waiting; only a store that does not give back what was written cannot be used at all. What is written for it is removed again.

use std::io::{self, Read};
use std::time::{Duration, Instant};

use serde::Serialize;

use super::objects::{Objects, Shelf, drafted};
use crate::engine::digest::Digest;
use crate::engine::system::{SystemError, temporary_name};

/// Writers that all want the same name.
const WRITERS: usize = 16;

/// Names that they all want, one after the other.
const ROUNDS: usize = 4;

/// Bytes of a large object.
const LARGE: usize = 16 << 20;

/// A listing is waited for so long.
const LAG: Duration = Duration::from_secs(10);

/// Small objects that are written and read for their time.
const SMALL_COUNT: usize = 32;

/// How a promise is kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    /// As it should be.
    Kept,
    /// Not kept: results are right, and something costs more.
    Not,
    /// Not kept: this is no place for results.
    Fails,
    /// Not looked at.
    Skipped,
}

/// A promise, and what was found.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Finding {
    /// The promise.
    pub promise: &'static str,
    /// How it is kept.
    pub verdict: Verdict,
    /// What was seen.
    pub seen: String,
}

/// Looks at a store; writes nothing unless it may.
pub fn probe(store: &dyn Objects, may_write: bool) -> Vec<Finding> {
    let mut findings = vec![readable(store)];
    if !may_write {
        findings.push(Finding { promise: "can be written", verdict: Verdict::Skipped, seen: "it is only read".to_owned() });
        return findings;
    }
    let mut trial = Trial { store, name: format!("check-{}", temporary_name()), written: Vec::new() };
    let writable = trial.writable();
    let goes_on = writable.verdict == Verdict::Kept;
    findings.push(writable);
    if goes_on {
        findings.push(trial.gives_back_at_once());
        findings.push(trial.gives_back_large());
        findings.push(trial.replaces());
        findings.push(trial.keeps_what_is_there());
        findings.push(trial.has_one_winner());
        findings.push(trial.lists());
        findings.push(trial.time_of_small());
        findings.push(trial.removes());
    }
    findings
}

/// Whether results may be kept there.
pub fn is_usable(findings: &[Finding]) -> bool {
    findings.iter().all(|finding| finding.verdict != Verdict::Fails)
}

fn readable(store: &dyn Objects) -> Finding {
    let promise = "can be read";
    match (store.open(Shelf::Results, &Digest::of(b"no such key").to_string()).map(drop), store.names(Shelf::Results, 1)) {
        (Err(error), _) if error.kind() != io::ErrorKind::NotFound => failed(promise, &error.to_string()),
        (_, Ok(_)) => kept(promise, "and listed".to_owned()),
        (_, Err(error)) => not(promise, format!("but not listed ({error}): runs cannot be pulled by their name")),
    }
}

fn kept(promise: &'static str, seen: String) -> Finding {
    Finding { promise, verdict: Verdict::Kept, seen }
}

fn not(promise: &'static str, seen: String) -> Finding {
    Finding { promise, verdict: Verdict::Not, seen }
}

fn failed(promise: &'static str, seen: &str) -> Finding {
    Finding { promise, verdict: Verdict::Fails, seen: seen.to_owned() }
}

struct Trial<'a> {
    store: &'a dyn Objects,
    name: String,
    written: Vec<String>,
}

impl Trial<'_> {
    fn name(&mut self, part: &str) -> String {
        let name = format!("{}-{part}", self.name);
        self.written.push(name.clone());
        name
    }

    fn writable(&mut self) -> Finding {
        let name = self.name("small");
        match put(self.store, &name, b"one") {
            Ok(()) => kept("can be written", String::new()),
            Err(error) => failed("can be written", &error.to_string()),
        }
    }

    fn gives_back_at_once(&self) -> Finding {
        let promise = "read after write";
        match get(self.store, &format!("{}-small", self.name)) {
            Ok(found) if found == b"one" => kept(promise, "what was written is there at once".to_owned()),
            Ok(found) => failed(promise, &format!("{} other bytes came back", found.len())),
            Err(error) if error.kind() == io::ErrorKind::NotFound => {
                not(promise, "what was written cannot be found at once: others compute it again".to_owned())
            }
            Err(error) => failed(promise, &error.to_string()),
        }
    }

    fn gives_back_large(&mut self) -> Finding {
        let (promise, name) = ("large objects", self.name("large"));
        // Not to be compressed on the way.
        let bytes: Vec<u8> = (0..LARGE as u32 / 32).flat_map(|index| Digest::of(&index.to_le_bytes()).0).collect();
        let begun = Instant::now();
        if let Err(error) = put(self.store, &name, &bytes) {
            return failed(promise, &error.to_string());
        }
        let written = begun.elapsed();
        match get(self.store, &name) {
            Ok(found) if found == bytes => {
                let rate = |time: Duration| (LARGE >> 20) as f64 / time.as_secs_f64().max(1e-6);
                let read = begun.elapsed() - written;
                kept(promise, format!("16 MiB come back whole; {:.0} MiB/s written, {:.0} MiB/s read", rate(written), rate(read)))
            }
            Ok(found) => failed(promise, &format!("{} bytes came back of {}", found.len(), bytes.len())),
            Err(error) => failed(promise, &error.to_string()),
        }
    }

    fn replaces(&self) -> Finding {
        let (promise, name) = ("replacement", format!("{}-small", self.name));
        match put(self.store, &name, b"two")
            .map_err(|error| error.to_string())
            .and_then(|()| get(self.store, &name).map_err(|error| error.to_string()))
        {
            Ok(found) if found == b"two" => kept(promise, "an object is replaced at once: damage can be healed".to_owned()),
            Ok(_) => not(promise, "the earlier object was still there after it was replaced".to_owned()),
            Err(error) => not(promise, format!("an object cannot be replaced: damage stays ({error})")),
        }
    }

    fn keeps_what_is_there(&self) -> Finding {
        let (promise, name) = ("creation only if absent", format!("{}-small", self.name));
        let second = put_new(self.store, &name, b"three");
        match (second, get(self.store, &name)) {
            (Ok(false), Ok(found)) if found == b"two" => kept(promise, "a second writer is refused".to_owned()),
            (Ok(_), Ok(found)) if found == b"three" => not(promise, "the condition is ignored: the last writer wins".to_owned()),
            (Err(error), _) => not(promise, error.to_string()),
            _ => not(promise, "a second writer is told that it was the first".to_owned()),
        }
    }

    fn has_one_winner(&mut self) -> Finding {
        let promise = "one winner of a race";
        let names: Vec<String> = (0..ROUNDS).map(|round| self.name(&format!("race-{round}"))).collect();
        let texts: Vec<Vec<u8>> = (0..WRITERS).map(|writer| vec![writer as u8; 20_000]).collect();
        let (store, mut winners) = (self.store, Vec::new());
        for name in &names {
            let won: Vec<bool> = std::thread::scope(|scope| {
                let write = |text| scope.spawn(move || put_new(store, name, text).unwrap_or(false));
                let threads: Vec<_> = texts.iter().map(|text| write(text.as_slice())).collect();
                threads.into_iter().map(|thread| thread.join().expect("no writer panics")).collect()
            });
            match get(self.store, name) {
                Ok(found) if texts.contains(&found) => winners.push(won.iter().filter(|won| **won).count()),
                Ok(_) => return failed(promise, "the object of several writers is a mixture"),
                Err(error) => return failed(promise, &error.to_string()),
            }
        }
        let counts: Vec<String> = winners.iter().map(ToString::to_string).collect();
        let seen = format!("{} of {WRITERS} writers were told that they were first", counts.join(", "));
        match winners.iter().all(|count| *count == 1) {
            true => kept(promise, seen),
            false => not(promise, format!("{seen}: jobs may be computed twice")),
        }
    }

    fn lists(&self) -> Finding {
        let promise = "listing after write";
        let begun = Instant::now();
        loop {
            match self.store.names(Shelf::Notes, usize::MAX) {
                Err(error) => return not(promise, error.to_string()),
                Ok(names) if self.written.iter().all(|name| names.contains(name)) => {
                    let lag = begun.elapsed();
                    return kept(promise, format!("all names are there after {:.1} s", lag.as_secs_f64()));
                }
                Ok(_) if begun.elapsed() > LAG => return not(promise, format!("names are missing after {} s", LAG.as_secs())),
                Ok(_) => std::thread::sleep(Duration::from_millis(100)),
            }
        }
    }

    fn time_of_small(&mut self) -> Finding {
        let promise = "small objects";
        let names: Vec<String> = (0..SMALL_COUNT).map(|index| self.name(&format!("time-{index}"))).collect();
        let begun = Instant::now();
        let put = names.iter().try_for_each(|name| put(self.store, name, &[7; 300]).map_err(|error| error.to_string()));
        let written = begun.elapsed();
        let got = put.and_then(|()| names.iter().try_for_each(|name| get(self.store, name).map(drop).map_err(|error| error.to_string())));
        let read = begun.elapsed() - written;
        let each = |time: Duration| 1000.0 * time.as_secs_f64() / SMALL_COUNT as f64;
        match got {
            Ok(()) => kept(promise, format!("{:.1} ms to write one, {:.1} ms to read one", each(written), each(read))),
            Err(error) => failed(promise, &error),
        }
    }

    fn removes(&mut self) -> Finding {
        let removed =
            std::mem::take(&mut self.written).iter().map(|name| self.store.remove(Shelf::Notes, name)).collect::<io::Result<Vec<()>>>();
        match removed {
            Ok(_) => kept("removal", "what was written for this check is gone".to_owned()),
            Err(error) => not("removal", format!("what was written for this check stays under `notes/{}-…`: {error}", self.name)),
        }
    }
}

fn put(store: &dyn Objects, name: &str, bytes: &[u8]) -> Result<(), SystemError> {
    drafted(store, bytes)?.keep(Shelf::Notes, name)
}

fn put_new(store: &dyn Objects, name: &str, bytes: &[u8]) -> Result<bool, SystemError> {
    drafted(store, bytes)?.keep_new(Shelf::Notes, name)
}

fn get(store: &dyn Objects, name: &str) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    store.open(Shelf::Notes, name)?.read_to_end(&mut bytes)?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::store::folder::FolderStore;
    use crate::engine::trial::files_below;

    #[test]
    fn a_folder_keeps_every_promise_and_is_left_as_it_was() {
        let folder = tempfile::tempdir().unwrap();
        let findings = probe(&FolderStore::at(folder.path()), true);
        assert!(findings.iter().all(|finding| finding.verdict == Verdict::Kept), "{findings:#?}");
        assert_eq!(findings.len(), 10);
        assert!(files_below(&folder.path().join("v1")).is_empty());
    }

    #[test]
    fn a_folder_that_is_only_read_is_not_written_to() {
        let folder = tempfile::tempdir().unwrap();
        let findings = probe(&FolderStore::at(folder.path()), false);
        assert!(is_usable(&findings) && files_below(folder.path()).is_empty(), "{findings:#?}");
    }
}

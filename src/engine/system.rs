//! What the operating system refused, with the path; and who owns a temporary file.

use std::fmt;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, SystemTime};

use super::files;
use super::owner::Owner;

/// The operating system failed us: disk, permission, a folder that is no folder.
#[derive(Debug, thiserror::Error)]
#[error("cannot {action} `{}`: {}", path.display(), SystemText(source))]
pub struct SystemError {
    /// What was attempted: `write`, `create`, `rename`, …
    pub action: &'static str,
    /// The file or folder.
    pub path: PathBuf,
    /// What the system said.
    pub source: io::Error,
}

impl SystemError {
    /// For `map_err`: what was attempted on which path.
    pub fn at(action: &'static str, path: impl Into<PathBuf>) -> impl FnOnce(io::Error) -> Self {
        let path = path.into();
        move |source| Self { action, path, source }
    }
}

/// The system's words without `(os error 28)`, which tells a reader nothing.
struct SystemText<'a>(&'a io::Error);

impl fmt::Display for SystemText<'_> {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let text = self.0.to_string();
        let words = text.split(" (os error").next().unwrap_or(&text);
        let mut letters = words.chars();
        letters.next().into_iter().flat_map(char::to_lowercase).chain(letters).try_for_each(|letter| fmt::Write::write_char(out, letter))
    }
}

/// Does two things at once, the first of them on another thread.
pub fn beside<A: Send, B>(there: impl FnOnce() -> A + Send, here: impl FnOnce() -> B) -> (A, B) {
    std::thread::scope(|scope| {
        let there = scope.spawn(there);
        let here = here();
        (there.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)), here)
    })
}

/// Gives memory back beside what is left to do: many small pieces take their time.
pub fn let_go(what: impl Send + 'static) {
    // Without another thread it is done here.
    let _ = std::thread::Builder::new().spawn(move || drop(what));
}

/// A name for a temporary file that no other process and no other call gives.
///
/// It names its owner, so that a later run can tell the leftovers of a dead process from the work of a live one.
pub fn temporary_name() -> String {
    static COUNTER: AtomicU64 = AtomicU64::new(0);
    format!("{}-{}", Owner::this_process(), COUNTER.fetch_add(1, Ordering::Relaxed))
}

/// A temporary file of another machine or boot is taken for a leftover when nothing wrote to it for so long.
const FOREIGN_AGE: Duration = Duration::from_secs(24 * 3600);

/// Removes what dead processes left in a folder of temporary files.
pub fn remove_leftovers(folder: &Path) {
    let Ok(entries) = files::list(folder) else { return };
    for entry in entries.flatten() {
        if is_leftover(&entry) {
            // Another run may be tidying too: whoever comes second finds nothing, which is right.
            let _ = files::remove(&entry.path());
        }
    }
}

fn is_leftover(entry: &fs::DirEntry) -> bool {
    match entry.file_name().to_str().and_then(Owner::parse) {
        Some((owner, _)) if owner.is_in_sight() => !owner.is_alive(),
        _ => entry.metadata().is_ok_and(|status| is_older(&status, FOREIGN_AGE)),
    }
}

fn is_older(status: &fs::Metadata, age: Duration) -> bool {
    let modified = status.modified().unwrap_or(SystemTime::UNIX_EPOCH);
    SystemTime::now().duration_since(modified).is_ok_and(|elapsed| elapsed > age)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_unique_and_their_owner_is_alive() {
        let name = temporary_name();
        assert_ne!(name, temporary_name());
        let (owner, _) = Owner::parse(&name).unwrap();
        assert!(owner.is_in_sight() && owner.is_alive());
    }

    #[test]
    fn leftovers_of_dead_processes_go_and_those_of_live_ones_stay() {
        let folder = tempfile::tempdir().unwrap();
        let mine = folder.path().join(temporary_name());
        // No process of this machine has started at tick 1 under our own id.
        let this = Owner::this_process().to_string();
        let dead = folder.path().join(format!("{}-1-0", this.rsplit_once('-').unwrap().0));
        let foreign = folder.path().join("0badb007-17-5-0");
        for path in [&mine, &dead, &foreign] {
            fs::write(path, "").unwrap();
        }
        remove_leftovers(folder.path());
        assert!(mine.exists() && !dead.exists() && foreign.exists());
    }

    #[test]
    fn the_message_names_action_path_and_cause() {
        let error = SystemError::at("write", "/x/y")(io::Error::from_raw_os_error(28));
        assert_eq!(error.to_string(), "cannot write `/x/y`: no space left on device");
    }
}

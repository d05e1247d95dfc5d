//! Which process something belongs to, and whether it is still there.
//!
//! Written into the names of temporary files and into claims, so that what a dead process left can be told from
//! the work of a live one.

use std::fmt;
use std::fs;
use std::os::unix::fs::MetadataExt;
use std::sync::OnceLock;

/// A process, named so that neither a reused process id nor another boot or container is taken for it.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct Owner {
    /// Where its id counts: see [`id_space`].
    space: String,
    process: u32,
    /// In ticks since the boot.
    started: u64,
}

impl fmt::Display for Owner {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "{}-{}-{}", self.space, self.process, self.started)
    }
}

impl Owner {
    /// This process.
    pub fn this_process() -> &'static Owner {
        static THIS: OnceLock<Owner> = OnceLock::new();
        THIS.get_or_init(|| {
            let process = std::process::id();
            Owner { space: id_space(), process, started: start_time(process).unwrap_or(0) }
        })
    }

    /// The owner that begins a text of parts with `-` between them, and the parts that follow.
    pub fn parse(text: &str) -> Option<(Owner, &str)> {
        let mut parts = text.splitn(4, '-');
        let space = parts.next()?.to_owned();
        let owner = Owner { space, process: parts.next()?.parse().ok()?, started: parts.next()?.parse().ok()? };
        Some((owner, parts.next().unwrap_or("")))
    }

    /// Its process id.
    pub fn process(&self) -> u32 {
        self.process
    }

    /// Whether it can be seen from here if it lives: it is of this boot and of this container.
    pub fn is_in_sight(&self) -> bool {
        self.space == Self::this_process().space
    }

    /// Whether it lives. To be asked of an owner in sight only.
    pub fn is_alive(&self) -> bool {
        start_time(self.process).is_some_and(|started| started == self.started)
    }
}

/// Where process ids count: eight digits of the id that the kernel draws when it starts, and the number of the
/// namespace of processes, of which each container has its own.
fn id_space() -> String {
    let text = fs::read_to_string("/proc/sys/kernel/random/boot_id").unwrap_or_default();
    let boot: String = text.chars().filter(char::is_ascii_hexdigit).take(8).collect();
    let namespace = fs::metadata("/proc/self/ns/pid").map_or(0, |status| status.ino());
    if boot.is_empty() { "unknown".into() } else { format!("{boot}{namespace:x}") }
}

/// When a process started, in ticks since the boot; `None` if there is none, or only its remains.
fn start_time(process: u32) -> Option<u64> {
    let text = fs::read_to_string(format!("/proc/{process}/stat")).ok()?;
    // The second field is the program's name in parentheses and may hold anything; the 22nd is the start time.
    let mut fields = text.rsplit_once(')')?.1.split_whitespace();
    // A killed process that its parent has not asked after yet does nothing any more.
    let is_over = matches!(fields.next()?, "Z" | "X");
    if is_over { None } else { fields.nth(18)?.parse().ok() }
}

/// The machine's name for people; only letters, digits, points and `_`.
pub fn host_name() -> String {
    let name = fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
    let name: String =
        name.trim().chars().map(|letter| if letter.is_ascii_alphanumeric() || letter == '.' { letter } else { '_' }).collect();
    if name.is_empty() { "unknown".into() } else { name.chars().take(64).collect() }
}

#[cfg(test)]
mod tests {
    use std::process::Command;

    use super::*;

    #[test]
    fn this_process_is_alive_and_survives_as_text() {
        let this = Owner::this_process();
        assert!(this.is_in_sight() && this.is_alive());
        assert_eq!(Owner::parse(&format!("{this}-rest-of-it")), Some((this.clone(), "rest-of-it")));
        assert_eq!(Owner::parse(&this.to_string()), Some((this.clone(), "")));
        for text in ["", "a", "a-b-c", "a-1"] {
            assert_eq!(Owner::parse(text), None, "{text}");
        }
    }

    #[test]
    fn a_process_that_has_ended_is_dead_even_before_its_parent_looks() {
        let mut child = Command::new("true").spawn().unwrap();
        let owner = Owner { process: child.id(), started: start_time(child.id()).unwrap_or(0), ..Owner::this_process().clone() };
        while start_time(child.id()).is_some() {
            std::thread::yield_now();
        }
        assert!(!owner.is_alive(), "a zombie");
        child.wait().unwrap();
        assert!(!owner.is_alive());
        // The same number at another time is another process.
        assert!(!Owner { started: 1, ..Owner::this_process().clone() }.is_alive());
    }
}

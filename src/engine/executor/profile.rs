//! What a site asks for: a file of the user's, never part of a pipeline.
//!
//! `~/.config/pipeline/profiles/NAME.yaml`, or a path. Read once, before anything is submitted.

use std::path::{Path, PathBuf};

use crate::catalogue::nearest;
use crate::engine::diagnostic::{listed, quoted};
use crate::engine::quantity;
use crate::engine::source::{Finding, Findings, Place, Sources, did_you_mean};
use crate::engine::yaml::{Entry, Node, Value, parse};

/// A profile.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Profile {
    /// `partition`: where workers run.
    pub partition: Option<String>,
    /// `account`: who pays.
    pub account: Option<String>,
    /// `qos`: quality of service.
    pub qos: Option<String>,
    /// `time`: how long a worker may stay, in seconds, unless its class asks for more.
    pub seconds: Option<u64>,
    /// `memory`: of a worker in bytes, unless its class says otherwise.
    pub memory: Option<u64>,
    /// `threads`: of a worker, likewise.
    pub threads: Option<usize>,
    /// `options`: further options, passed on as they are.
    pub options: Vec<String>,
    /// `setup`: commands that stand before that of the worker (`module load …`).
    pub setup: Vec<String>,
    /// `program`: path of this program on the nodes, where it is another one there.
    pub program: Option<PathBuf>,
}

const KEYS: [&str; 9] = ["partition", "account", "qos", "time", "memory", "threads", "options", "setup", "program"];

/// Why there is no profile: the messages, each with its place.
#[derive(Debug, thiserror::Error)]
#[error("{}", .0.join("\n"))]
pub struct ProfileError(pub Vec<String>);

impl Profile {
    /// The profile of that name, or in the file of that path.
    pub fn find(name: &str) -> Result<Self, ProfileError> {
        let path = if name.contains('/') || name.ends_with(".yaml") { PathBuf::from(name) } else { folder().join(format!("{name}.yaml")) };
        Self::read(&path).map_err(|mut error| {
            if !path.exists() {
                error.0 = vec![format!("there is no profile {}: no file `{}`{}", quoted(name), path.display(), known())];
            }
            error
        })
    }

    fn read(path: &Path) -> Result<Self, ProfileError> {
        let mut sources = Sources::default();
        let text = match sources.read_text(path) {
            Ok(text) => text,
            Err(error) => return Err(ProfileError(vec![format!("`{}` {}", path.display(), error.message)])),
        };
        let file = sources.add_file(path, text.clone());
        let mut findings = Findings::default();
        let mut profile = Profile::default();
        if let Some(root) = parse(file, &text, &mut findings) {
            profile.take(&root, file, &mut findings);
        }
        let (errors, _) = sources.diagnostics(findings);
        if errors.is_empty() { Ok(profile) } else { Err(ProfileError(errors.iter().map(told).collect())) }
    }

    fn take(&mut self, root: &Node, file: u32, findings: &mut Findings) {
        match &root.value {
            Value::Map(entries) => {
                for entry in entries.iter() {
                    if let Err((message, hint)) = self.take_entry(entry) {
                        let place = if KEYS.contains(&&*entry.key) { entry.node.place } else { entry.place };
                        findings.add(Finding::error(place, message).with_hint(hint));
                    }
                }
            }
            Value::Null => {}
            _ => findings.add(Finding::error(Place::of_file(file), format!("a profile is a map, found {}", root.described()))),
        }
    }

    fn take_entry(&mut self, entry: &Entry) -> Result<(), (String, Option<String>)> {
        let node = &entry.node;
        let wrong = |what: &str| (format!("{} must be {what}, found {}", quoted(&entry.key), node.described()), None);
        let word = || one_word(node).ok_or_else(|| wrong("one word"));
        match &*entry.key {
            "partition" => self.partition = Some(word()?),
            "account" => self.account = Some(word()?),
            "qos" => self.qos = Some(word()?),
            "program" => self.program = Some(node.text().map(PathBuf::from).ok_or_else(|| wrong("a path"))?),
            "threads" => match &node.value {
                Value::Integer(count) if (1..=4096).contains(count) => self.threads = Some(*count as usize),
                _ => return Err(wrong("a number of threads")),
            },
            "memory" => {
                let bytes = node.text().and_then(|text| quantity::byte_size(text).ok()).filter(|bytes| *bytes >= 1 << 20);
                self.memory = Some(bytes.ok_or_else(|| wrong("a size, as 8GiB"))?);
            }
            "time" => {
                let time = node.text().and_then(|text| quantity::duration(text).ok()).map(|time| time.as_secs()).filter(|time| *time >= 60);
                self.seconds = Some(time.ok_or_else(|| wrong("a time of at least a minute, as 90m, 12h or 2d"))?);
            }
            "options" => self.options = lines(node).ok_or_else(|| wrong("a list of options, as [\"--exclude=node7\"]"))?,
            "setup" => self.setup = lines(node).ok_or_else(|| wrong("a list of commands, as [\"module load gcc\"]"))?,
            key => {
                let keys: Vec<String> = KEYS.iter().map(|key| format!("`{key}`")).collect();
                let known = format!("the keys are {}", listed(&keys, "and"));
                let hint = did_you_mean(nearest(key, KEYS)).or(Some(known));
                return Err((format!("unknown key {} of a profile", quoted(key)), hint));
            }
        }
        Ok(())
    }
}

fn told(diagnostic: &crate::engine::diagnostic::Diagnostic) -> String {
    let hint = diagnostic.hint.as_ref().map(|hint| format!(" ({hint})")).unwrap_or_default();
    format!("{}:{}:{}: {}{hint}", diagnostic.file, diagnostic.line, diagnostic.column, diagnostic.message)
}

/// A word that can stand in an option: no spaces, nothing that a line could end with.
fn one_word(node: &Node) -> Option<String> {
    let text = match &node.value {
        Value::Text(text) => text.to_string(),
        Value::Integer(number) => number.to_string(),
        _ => return None,
    };
    let is_word = !text.is_empty() && !text.starts_with('-') && text.chars().all(|letter| letter.is_ascii_graphic());
    is_word.then_some(text)
}

fn lines(node: &Node) -> Option<Vec<String>> {
    let text = |node: &Node| node.text().filter(|text| !text.is_empty() && !text.contains('\n')).map(str::to_owned);
    node.list()?.iter().map(text).collect()
}

fn folder() -> PathBuf {
    let config = std::env::var_os("XDG_CONFIG_HOME").filter(|folder| !folder.is_empty()).map(PathBuf::from);
    let home = || PathBuf::from(std::env::var_os("HOME").unwrap_or_default()).join(".config");
    config.unwrap_or_else(home).join("pipeline").join("profiles")
}

/// The profiles that there are, for a message.
fn known() -> String {
    let entries = std::fs::read_dir(folder()).into_iter().flatten().flatten();
    let mut names: Vec<String> = entries.filter_map(|entry| Some(quoted(entry.file_name().to_str()?.strip_suffix(".yaml")?))).collect();
    names.sort();
    if names.is_empty() { String::new() } else { format!("; there are {}", listed(&names, "and")) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Profile, ProfileError> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("site.yaml");
        std::fs::write(&path, text).unwrap();
        Profile::find(path.to_str().unwrap())
    }

    #[test]
    fn a_profile_says_what_a_site_asks_for() {
        let text = "partition: short\naccount: 1234\ntime: 2h\nmemory: 4GiB\noptions: [--exclude=node7]\nsetup: [module load gcc]\n";
        let profile = read(text).unwrap();
        assert_eq!((profile.partition.as_deref(), profile.account.as_deref()), (Some("short"), Some("1234")));
        assert_eq!((profile.seconds, profile.memory, profile.threads), (Some(7200), Some(4 << 30), None));
        assert_eq!((&profile.options[..], &profile.setup[..]), (&["--exclude=node7".to_owned()][..], &["module load gcc".to_owned()][..]));
        assert_eq!(read("").unwrap(), Profile::default());
    }

    #[test]
    fn mistakes_are_told_with_their_lines() {
        let said = read("partitoin: short\ntime: soon\nqos: a b\nsetup: one\n").unwrap_err().to_string();
        for part in
            ["site.yaml:1:1: unknown key `partitoin`", "did you mean `partition`?", ":2:7: `time` must", ":3:6: `qos`", ":4:8: `setup`"]
        {
            assert!(said.contains(part), "{part}: {said}");
        }
        assert!(Profile::find("no-such-site").unwrap_err().to_string().contains("there is no profile `no-such-site`"));
    }
}

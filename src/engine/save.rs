//! What a stage publishes: the forms of `save:`, and the names of the files.

use std::collections::HashMap;

use sha2::{Digest, Sha256};

use super::artifact::TypeName;
use super::coordinate::Coordinate;
use super::diagnostic::{listed, quoted};
use super::registry::Registry;
use super::source::{Finding, Findings, Place, did_you_mean};
use super::yaml::{Entry, Node, Value};
use crate::catalogue::nearest;

/// A result and a format to write it in.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Save {
    /// Index into the results of the stage.
    pub result: usize,
    /// One of the formats of its type.
    pub format: String,
    /// The extension of a file in that format.
    pub extension: String,
    /// Where it is asked for.
    pub place: Place,
}

/// Reads `save:` of a stage whose results have these names and types.
pub fn read(node: &Node, results: &[(&str, TypeName)], registry: &Registry, stage: &str, findings: &mut Findings) -> Vec<Save> {
    let mut reader = Reader { results, registry, stage, findings, saves: Vec::new() };
    match &node.value {
        Value::Map(entries) if entries.is_empty() => reader.error(node.place, "`save` is an empty map".into(), None),
        Value::Map(entries) => entries.iter().for_each(|entry| reader.named(entry)),
        _ => reader.formats(0, node),
    }
    reader.saves
}

struct Reader<'a> {
    results: &'a [(&'a str, TypeName)],
    registry: &'a Registry,
    stage: &'a str,
    findings: &'a mut Findings,
    saves: Vec<Save>,
}

impl Reader<'_> {
    fn error(&mut self, place: Place, message: String, hint: Option<String>) {
        self.findings.add(Finding::error(place, message).in_stage(self.stage).with_hint(hint));
    }

    /// One entry of the form `{ map: exr }`; the first result goes by the name of its type.
    fn named(&mut self, entry: &Entry) {
        let names: Vec<&str> = self.results.iter().map(|(name, type_name)| if name.is_empty() { *type_name } else { *name }).collect();
        match names.iter().position(|name| *name == &*entry.key) {
            Some(result) => self.formats(result, &entry.node),
            None => {
                let known: Vec<String> = names.iter().map(|name| quoted(name)).collect();
                let hint = did_you_mean(nearest(&entry.key, names.iter().copied()));
                let hint = hint.or_else(|| Some(format!("write `save: {{ RESULT: FORMAT }}`; the results are {}", listed(&known, "and"))));
                self.error(entry.place, format!("`save`: there is no result {}", quoted(&entry.key)), hint);
            }
        }
    }

    fn formats(&mut self, result: usize, node: &Node) {
        match &node.value {
            Value::Text(text) => self.format(result, text, node.place),
            Value::List(items) if items.is_empty() => self.error(node.place, "`save` is an empty list; leave it out".into(), None),
            Value::List(items) => items.iter().for_each(|item| match item.text() {
                Some(text) => self.format(result, text, item.place),
                None => self.error(item.place, format!("`save` takes names of formats, found {}", item.described()), None),
            }),
            _ => self.error(node.place, format!("`save` takes a format, a list of formats or a map, found {}", node.described()), None),
        }
    }

    fn format(&mut self, result: usize, format: &str, place: Place) {
        let type_name = self.results[result].1;
        let artifact = self.registry.artifacts().find(type_name);
        let formats = artifact.map(|artifact| artifact.formats).unwrap_or_default();
        if !formats.contains(&format) {
            let known: Vec<String> = formats.iter().map(|format| quoted(format)).collect();
            let hint = did_you_mean(nearest(format, formats.iter().copied()));
            let hint = hint.or_else(|| Some(format!("{type_name} can be saved as {}", listed(&known, "or"))));
            return self.error(place, format!("`save`: {type_name} cannot be saved in format {}", quoted(format)), hint);
        }
        if self.saves.iter().any(|save| save.result == result && save.format == format) {
            return self.error(place, format!("`save` names format {} twice", quoted(format)), None);
        }
        let extension = artifact.map_or(format, |artifact| artifact.extension(format)).to_owned();
        self.saves.push(Save { result, format: format.to_owned(), extension, place });
    }
}

/// Path of a published file below the folder of its pipeline.
///
/// `STAGE.EXT` without axes, `STAGE/axis=value,….EXT` with them; a further result adds `.RESULT` to the stage.
pub fn published_path(stage: &str, result: &str, coordinate: &Coordinate, extension: &str) -> String {
    let point = if result.is_empty() { "" } else { "." };
    let folder = if coordinate.is_empty() { String::new() } else { format!("/{}", file_stem(coordinate)) };
    format!("{stage}{point}{result}{folder}.{extension}")
}

/// Longest name of a coordinate in a path, in bytes.
const STEM_LENGTH: usize = 200;
/// Bytes of `~` and eight hex digits.
const DIGEST_LENGTH: usize = 9;

/// The text of a coordinate as a file name: bytes outside `[A-Za-z0-9._+-]` of a value as `%XX`, and over
/// 200 bytes a prefix, `~` and 8 hex digits of the SHA-256 of the whole.
pub fn file_stem(coordinate: &Coordinate) -> String {
    let parts = coordinate.0.iter().map(|(axis, value)| format!("{axis}={}", escaped(&value.to_string())));
    let stem = parts.collect::<Vec<_>>().join(",");
    if stem.len() <= STEM_LENGTH {
        return stem;
    }
    let digest = Sha256::digest(stem.as_bytes());
    let hex: String = digest.iter().take(4).map(|byte| format!("{byte:02x}")).collect();
    let mut prefix = &stem[..STEM_LENGTH - DIGEST_LENGTH];
    if let Some(cut) = prefix.len().checked_sub(2).and_then(|from| prefix[from..].find('%').map(|at| from + at)) {
        prefix = &prefix[..cut];
    }
    format!("{prefix}~{hex}")
}

fn escaped(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for byte in text.bytes() {
        match byte {
            byte if byte.is_ascii_alphanumeric() || b"._+-".contains(&byte) => escaped.push(char::from(byte)),
            byte => escaped.push_str(&format!("%{byte:02X}")),
        }
    }
    escaped
}

/// Names below the folder of a pipeline that a run itself writes.
const RESERVED: [&str; 5] = ["manifest.json", "ro-crate-metadata.json", "report.html", "runs", ".store"];

/// All names that were given to published files, to find two that are one.
#[derive(Default)]
pub struct Names {
    /// By the name in lower case: the name itself and the stage.
    taken: HashMap<String, (String, String)>,
}

impl Names {
    /// Takes a name for a stage; the error says why it cannot have it.
    pub fn take(&mut self, path: &str, stage: &str) -> Result<(), String> {
        let folded = path.to_ascii_lowercase();
        let first = folded.split('/').next().unwrap_or_default();
        if RESERVED.contains(&first) {
            return Err(format!("would publish {}, a name that the run itself writes", quoted(path)));
        }
        match self.taken.get(&folded) {
            None => {
                self.taken.insert(folded, (path.to_owned(), stage.to_owned()));
                Ok(())
            }
            Some((other, other_stage)) if other == path => {
                Err(format!("would publish {}, the same file as stage {}", quoted(path), quoted(other_stage)))
            }
            Some((other, other_stage)) => Err(format!(
                "would publish {}, which differs only in case from {} of stage {}",
                quoted(path),
                quoted(other),
                quoted(other_stage)
            )),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::coordinate::Scalar;

    fn coordinate(value: &str) -> Coordinate {
        Coordinate(vec![("p".into(), Scalar::Text(value.into())), ("n".into(), Scalar::Integer(64))])
    }

    #[test]
    fn a_path_says_stage_result_and_coordinate() {
        assert_eq!(published_path("ldr", "", &Coordinate::default(), "png"), "ldr.png");
        assert_eq!(published_path("error", "map", &coordinate("a/g %é"), "exr"), "error.map/p=a%2Fg%20%25%C3%A9,n=64.exr");
    }

    #[test]
    fn a_long_name_is_cut_with_a_digest_and_stays_unique() {
        let a = file_stem(&coordinate(&"x".repeat(300)));
        let b = file_stem(&coordinate(&format!("{}y", "x".repeat(299))));
        assert!(a.len() == STEM_LENGTH && b.len() == STEM_LENGTH && a != b);
        assert!(!file_stem(&coordinate(&"/".repeat(100))).contains("%~"));
        for length in 60..70 {
            let stem = file_stem(&coordinate(&"é".repeat(length)));
            let escapes = stem.split('~').next().unwrap().split('%').skip(1).all(|part| part.len() >= 2);
            assert!(escapes, "{stem}");
        }
    }

    #[test]
    fn names_are_taken_once() {
        let mut names = Names::default();
        assert!(names.take("pic.png", "pic").is_ok());
        assert!(names.take("PIC.png", "PIC").unwrap_err().contains("only in case"));
        assert!(names.take("pic.png", "pic").unwrap_err().contains("same file"));
        assert!(names.take("Manifest.json", "Manifest").is_err());
        assert!(names.take("runs/n=1.png", "runs").is_err());
        assert!(names.take("runs.png", "runs").is_ok());
    }
}

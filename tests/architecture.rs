//! Reads the sources and fails on an import that the table of the rooms does not allow.

use std::fs;
use std::path::{Path, PathBuf};

/// Each room with the rooms that it may name.
const ROOMS: [(&str, &[&str]); 10] = [
    ("math", &[]),
    ("catalogue", &[]),
    ("image", &["math"]),
    ("formats", &["image"]),
    ("light", &["math", "image"]),
    ("render", &["math", "image", "light", "catalogue"]),
    ("figure", &["math", "image"]),
    ("engine", &["catalogue"]),
    ("stages", &["math", "catalogue", "image", "formats", "light", "render", "figure", "engine"]),
    ("report", &["engine", "image", "formats", "figure"]),
];

/// What `cli` may name.
const CLI: &[&str] = &["engine", "stages", "report"];

fn allowed(room: &str) -> Option<&'static [&'static str]> {
    let rooms = ROOMS.iter().chain(&[("cli", CLI)]);
    rooms.into_iter().find(|(name, _)| *name == room).map(|(_, allowed)| *allowed)
}

fn sources(folder: &Path, found: &mut Vec<PathBuf>) {
    let mut entries: Vec<PathBuf> = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    entries.sort();
    for path in entries {
        if path.is_dir() {
            sources(&path, found);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            found.push(path);
        }
    }
}

/// The room of a file: the first name below `src`.
fn room_of(path: &Path, root: &Path) -> String {
    let first = path.strip_prefix(root).unwrap().components().next().unwrap();
    first.as_os_str().to_str().unwrap().trim_end_matches(".rs").to_owned()
}

/// The code of a line: without its comment and without text in quotes.
fn code_of(line: &str) -> &str {
    let code = line.split("//").next().unwrap_or_default();
    code.split('"').next().unwrap_or_default()
}

/// The rooms that a line names as `crate::ROOM`.
fn rooms_named(line: &str) -> Vec<&str> {
    let code = code_of(line);
    // `ro_crate::` is a module of its own.
    let is_root = |at: &usize| !code[..*at].ends_with(|c: char| c.is_alphanumeric() || c == '_');
    let named = code.match_indices("crate::").map(|(at, _)| at).filter(is_root).map(|at| &code[at + "crate::".len()..]);
    named.map(|rest| rest.split(|c: char| !(c.is_alphanumeric() || c == '_')).next().unwrap_or_default()).collect()
}

/// What is wrong with a line of a file of that room.
fn fault(room: &str, line: &str) -> Option<String> {
    let code = code_of(line);
    if code.contains("super::super") {
        return Some("`super::super`: name the room instead".into());
    }
    if code.trim_start().starts_with("use crate::{") {
        return Some("`use crate::{…}`: one line per room".into());
    }
    let allowed = allowed(room)?;
    let is_foreign = |named: &&str| !named.is_empty() && *named != room && !allowed.contains(named);
    rooms_named(line).into_iter().find(is_foreign).map(|named| format!("`{room}` may not name `{named}`"))
}

#[test]
fn every_import_follows_the_table_of_the_rooms() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut files = Vec::new();
    sources(&root, &mut files);
    let mut faults = Vec::new();
    for path in &files {
        let room = room_of(path, &root);
        if matches!(room.as_str(), "lib" | "main") {
            continue;
        }
        let text = fs::read_to_string(path).unwrap();
        assert!(allowed(&room).is_some(), "{}: the room `{room}` is not in the table", path.display());
        for (index, line) in text.lines().enumerate() {
            if let Some(fault) = fault(&room, line) {
                faults.push(format!("{}:{}: {fault}", path.strip_prefix(&root).unwrap().display(), index + 1));
            }
        }
    }
    assert!(files.len() > 40, "the sources were not found");
    assert!(faults.is_empty(), "imports that the table does not allow:\n{}", faults.join("\n"));
}

#[test]
fn a_forbidden_import_is_found() {
    assert!(fault("math", "use crate::image::raster::Image;").is_some());
    assert!(fault("engine", "    let map = crate::light::envmap::EnvMap::new();").is_some());
    assert!(fault("light", "use super::super::image;").is_some());
    assert!(fault("stages", "use crate::{light, image};").is_some());
    assert!(fault("cli", "use crate::image::raster::Image;").is_some());
}

#[test]
fn an_allowed_import_is_left_alone() {
    assert!(fault("light", "use crate::math::stream::Stream;").is_none());
    assert!(fault("engine", "use crate::engine::graph::Graph; // not crate::light").is_none());
    assert!(fault("engine", "    ro_crate::text(manifest)").is_none());
    assert!(fault("stages", "use crate::light::envmap::EnvMap;").is_none());
}

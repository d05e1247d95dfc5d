//! What is embedded in the page and what lies beside it.
//!
//! A page opened from a disk may load classic scripts and nothing else; so data beside it are scripts that hand over
//! one text. They are named by the digest of the result that they hold and by the version of their form, and need not
//! be written twice.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use crate::engine::digest::Digest;
use crate::engine::system::{SystemError, temporary_name};

/// Raise when equal results would be packed as another text.
const VERSION: &str = "1";

/// Length of the name of a text: enough that no two results of a run share it.
const NAME_LENGTH: usize = 24;

/// Texts by name.
#[derive(Debug, Default)]
pub struct Texts {
    /// Those that are part of the page.
    pub embedded: BTreeMap<String, String>,
    /// Names of those beside it.
    pub beside: BTreeSet<String>,
}

/// The name of a result's text.
pub fn name(digest: &Digest) -> String {
    format!("{VERSION}-{}", &digest.to_string()[..NAME_LENGTH])
}

/// Whether a file is one of ours.
fn is_ours(file: &str) -> bool {
    let Some(stem) = file.strip_suffix(".js") else { return false };
    let Some((version, digest)) = stem.split_once('-') else { return false };
    !version.is_empty() && version.bytes().all(|byte| byte.is_ascii_digit()) && digest.bytes().all(|byte| byte.is_ascii_hexdigit())
}

/// The folder of the files beside a page: `report.files` for `report.html`.
pub fn folder_of(page: &Path) -> PathBuf {
    page.with_extension("files")
}

/// Whether the text stands there already.
pub fn is_there(folder: &Path, name: &str) -> bool {
    folder.join(format!("{name}.js")).is_file()
}

/// Writes a text beside the page.
pub fn write(folder: &Path, name: &str, text: &str) -> Result<(), SystemError> {
    fs::create_dir_all(folder).map_err(SystemError::at("create", folder))?;
    // Names and base64 have no character that a script would read otherwise.
    write_whole(&folder.join(format!("{name}.js")), format!("pipelineData(\"{name}\",\"{text}\")\n").as_bytes())
}

/// Writes a file that is either whole or not there.
pub fn write_whole(path: &Path, bytes: &[u8]) -> Result<(), SystemError> {
    let draft = path.with_file_name(format!(".{}", temporary_name()));
    let written = fs::write(&draft, bytes).and_then(|()| fs::rename(&draft, path));
    written.map_err(|error| {
        let _ = fs::remove_file(&draft);
        SystemError::at("write", path)(error)
    })
}

/// Removes files of earlier pages that this one does not name, and the folder if nothing is left.
pub fn tidy(folder: &Path, kept: &BTreeSet<String>) {
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        let Ok(file) = entry.file_name().into_string() else { continue };
        if is_ours(&file) && !kept.contains(file.trim_end_matches(".js")) {
            // What cannot be removed does no harm.
            let _ = fs::remove_file(entry.path());
        }
    }
    let _ = fs::remove_dir(folder);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_our_own_files_are_tidied_away() {
        let folder = tempfile::tempdir().unwrap();
        let place = folder.path().join("report.files");
        let [one, other] = [name(&Digest::of(b"1")), name(&Digest::of(b"2"))];
        for name in [&one, &other] {
            write(&place, name, "AAAA").unwrap();
        }
        fs::write(place.join("mine.js"), "x").unwrap();
        tidy(&place, &[one.clone()].into());
        assert!(is_there(&place, &one) && !is_there(&place, &other) && place.join("mine.js").exists());
        fs::remove_file(place.join("mine.js")).unwrap();
        tidy(&place, &BTreeSet::new());
        assert!(!place.exists());
    }
}

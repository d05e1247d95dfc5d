//! Makes a recorded run again, from nothing but its manifest and its input files, and compares.
//!
//! The text of the pipeline stands in the manifest; input files are found by name and digest. Results and
//! files go to a scratch folder, so that no store can answer for the work.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use serde::Serialize;

use super::comparison::{FileDifference, JobDifference, compare};
use super::runs::is_inside;
use crate::engine::diagnostic::quoted;
use crate::engine::digest::{Digest, HashingReader};
use crate::engine::manifest::{JobEntry, Manifest, place_text, plain_text};
use crate::engine::request::{InputPlace, JOB_LIMIT, RecordedInput, Request};
use crate::engine::run::Places;
use crate::engine::system::SystemError;

/// Why a run cannot be made again.
#[derive(Debug, thiserror::Error)]
pub enum VerificationError {
    /// Input files are not where they were looked for.
    #[error("{}", .0.join("\n"))]
    Inputs(Vec<String>),
    /// The manifest does not say what ran.
    #[error("{0}")]
    Manifest(String),
    /// The operating system failed.
    #[error(transparent)]
    System(#[from] SystemError),
}

/// A place to make a run again in; removed with the value.
pub struct Scratch {
    folder: tempfile::TempDir,
    request: Request,
}

impl Scratch {
    /// Lays out what the run was made of. Input files are looked for in `folders`, by name and then by content.
    pub fn new(manifest: &Manifest, folders: &[PathBuf]) -> Result<Self, VerificationError> {
        let inputs = find_inputs(manifest, folders).map_err(VerificationError::Inputs)?;
        let temporary = std::env::temp_dir();
        let create = || tempfile::Builder::new().prefix("pipeline-verify-").tempdir_in(&temporary);
        let folder = create().map_err(SystemError::at("create a folder in", &temporary))?;
        let spec = folder.path().join("spec");
        for entry in &manifest.spec {
            write(&spec, &entry.path, &entry.text)?;
        }
        let main = manifest.spec.first().ok_or_else(|| VerificationError::Manifest("the manifest has no text of a pipeline".into()))?;
        let request = Request { inputs: Some(inputs), ..request(manifest, spec.join(&main.path)) };
        Ok(Self { folder, request })
    }

    /// What to ask of the engine.
    pub fn request(&self) -> &Request {
        &self.request
    }

    /// Where to run.
    pub fn places(&self) -> Places {
        Places {
            outputs: self.folder.path().join("outputs"),
            store: self.folder.path().join("store"),
            may_share_store: false,
            remote: None,
        }
    }
}

fn write(folder: &Path, path: &str, text: &str) -> Result<(), VerificationError> {
    if !is_inside(path) {
        return Err(VerificationError::Manifest(format!("{} leads out of its folder", quoted(path))));
    }
    let path = folder.join(path);
    let parent = path.parent().unwrap_or(folder);
    fs::create_dir_all(parent).map_err(SystemError::at("create", parent))?;
    Ok(fs::write(&path, text).map_err(SystemError::at("write", &path))?)
}

/// The command line of the run, as far as it changes what is computed.
fn request(manifest: &Manifest, file: PathBuf) -> Request {
    let texts = |name: &str| -> Vec<(String, String)> {
        let fields = manifest.overrides.get(name).and_then(serde_json::Value::as_object).into_iter().flatten();
        fields.filter_map(|(name, text)| Some((name.clone(), text.as_str()?.to_owned()))).collect()
    };
    let seed = manifest.overrides.get("seed").and_then(serde_json::Value::as_str).map(str::to_owned);
    let axes = texts("axes");
    let only = if manifest.whole || !axes.is_empty() { Vec::new() } else { targets(&manifest.jobs) };
    let max_jobs = JOB_LIMIT.max(manifest.jobs.len() as u64);
    Request { parameters: texts("params"), axes, seed, only, max_jobs, ..Request::of_file(file) }
}

/// `--only` for each recorded job; of all coordinates where one cannot be written as a selection.
fn targets(jobs: &[JobEntry]) -> Vec<String> {
    let is_plain = |text: &str| text.bytes().all(|byte| byte.is_ascii_alphanumeric() || b"._+-".contains(&byte));
    let target = |job: &JobEntry| {
        let mut values = job.coordinate.as_object().into_iter().flat_map(|axes| axes.values());
        if values.all(|value| is_plain(&plain_text(value))) { place_text(&job.stage, &job.coordinate) } else { job.stage.clone() }
    };
    jobs.iter().map(target).collect::<BTreeSet<_>>().into_iter().collect()
}

/// Every input file of every job, where it lies now; else what is missing.
fn find_inputs(manifest: &Manifest, folders: &[PathBuf]) -> Result<BTreeMap<InputPlace, RecordedInput>, Vec<String>> {
    let mut wanted: BTreeMap<(&str, Digest), Option<PathBuf>> = BTreeMap::new();
    for file in manifest.jobs.iter().flat_map(|job| &job.files) {
        wanted.entry((&file.path, file.sha256)).or_default();
    }
    for ((path, digest), found) in &mut wanted {
        *found = by_name(path, *digest, folders);
    }
    let missing: BTreeSet<Digest> = wanted.iter().filter(|(_, found)| found.is_none()).map(|((_, digest), _)| *digest).collect();
    if !missing.is_empty() {
        let by_content = by_content(&missing, folders);
        wanted.iter_mut().filter(|(_, found)| found.is_none()).for_each(|((_, digest), found)| *found = by_content.get(digest).cloned());
    }
    let absent: Vec<String> =
        wanted.iter().filter(|(_, found)| found.is_none()).map(|((path, digest), _)| absence(path, *digest, folders)).collect();
    if !absent.is_empty() {
        return Err(absent);
    }
    let files = manifest.jobs.iter().flat_map(|job| job.files.iter().map(move |file| (job, file)));
    let located = files.filter_map(|(job, file)| {
        let path = wanted.get(&(file.path.as_str(), file.sha256))?.clone()?;
        Some((InputPlace::of(&job.stage, &job.coordinate, &file.parameter), RecordedInput { shown: file.path.clone(), path }))
    });
    Ok(located.collect())
}

fn by_name(path: &str, digest: Digest, folders: &[PathBuf]) -> Option<PathBuf> {
    let name = Path::new(path).file_name().map(PathBuf::from);
    let inside = is_inside(path).then(|| PathBuf::from(path));
    let candidates =
        folders.iter().flat_map(|folder| [inside.clone(), name.clone()].into_iter().flatten().map(move |name| folder.join(name)));
    let found = candidates.into_iter().find(|path| digest_of(path).is_ok_and(|found| found == digest))?;
    std::path::absolute(found).ok()
}

/// Most files that are hashed in the search for one under another name.
const SEARCHED_COUNT: usize = 10_000;

/// Files below the folders with these digests, whatever their names.
fn by_content(digests: &BTreeSet<Digest>, folders: &[PathBuf]) -> BTreeMap<Digest, PathBuf> {
    let mut found = BTreeMap::new();
    let mut waiting: Vec<PathBuf> = folders.iter().rev().cloned().collect();
    let mut count = 0;
    while let Some(folder) = waiting.pop() {
        let mut entries: Vec<_> = fs::read_dir(&folder).into_iter().flatten().flatten().collect();
        entries.sort_by_key(fs::DirEntry::file_name);
        for entry in entries {
            let Ok(kind) = entry.file_type() else { continue };
            let is_hidden = entry.file_name().to_string_lossy().starts_with('.');
            if kind.is_dir() && !is_hidden {
                waiting.push(entry.path());
            } else if kind.is_file() && count < SEARCHED_COUNT && found.len() < digests.len() {
                count += 1;
                let digest = digest_of(&entry.path()).ok().filter(|digest| digests.contains(digest));
                if let (Some(digest), Ok(path)) = (digest, std::path::absolute(entry.path())) {
                    found.entry(digest).or_insert(path);
                }
            }
        }
    }
    found
}

fn digest_of(path: &Path) -> io::Result<Digest> {
    if !fs::metadata(path)?.is_file() {
        return Err(io::ErrorKind::InvalidInput.into());
    }
    let mut reader = HashingReader::new(fs::File::open(path)?);
    io::copy(&mut reader, &mut io::sink())?;
    Ok(reader.finish().0)
}

fn absence(path: &str, digest: Digest, folders: &[PathBuf]) -> String {
    let names: Vec<String> = folders.iter().map(|folder| quoted(&folder.to_string_lossy())).collect();
    let is_other = folders.iter().any(|folder| is_inside(path) && folder.join(path).exists());
    let what = if is_other { "has other content now" } else { "is not there" };
    format!("input file {} {what}, and no file of its content (SHA-256 {digest}) was found in {}", quoted(path), names.join(", "))
}

/// What came of making a run again.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Verdict {
    /// The recorded run.
    pub run_id: String,
    /// Identity of its work.
    pub result_id: Digest,
    /// Identity of the work made again.
    pub again: Digest,
    /// Whether everything compared is equal, bit for bit.
    pub is_equal: bool,
    /// Recorded jobs whose results were compared.
    pub jobs: usize,
    /// Recorded files that were compared.
    pub files: usize,
    /// Jobs that gave other bytes, or none.
    pub differing_jobs: Vec<JobDifference>,
    /// Recorded jobs that the pipeline no longer has.
    pub missing_jobs: Vec<String>,
    /// Files of other bytes, or that were not made.
    pub differing_files: Vec<FileDifference>,
}

/// Compares a recorded run with the one made again: everything that the record has.
pub fn judge(recorded: &Manifest, again: &Manifest) -> Verdict {
    let comparison = compare(recorded, again);
    let gave =
        |place: &String| recorded.jobs.iter().any(|job| place_text(&job.stage, &job.coordinate) == *place && !job.outputs.is_empty());
    // What the record lacks, since that run ended before, cannot differ from it.
    let differing = |mut job: JobDifference| {
        job.results.retain(|result| result.first.is_some());
        (!job.results.is_empty()).then_some(job)
    };
    let differing_jobs: Vec<JobDifference> = comparison.jobs.into_iter().filter_map(differing).collect();
    let missing_jobs: Vec<String> = comparison.only_first.into_iter().filter(gave).collect();
    let differing_files: Vec<FileDifference> = comparison.files.into_iter().filter(|file| file.first.is_some()).collect();
    Verdict {
        run_id: recorded.run_id.clone(),
        result_id: recorded.result_id,
        again: again.result_id,
        is_equal: differing_jobs.is_empty() && missing_jobs.is_empty() && differing_files.is_empty(),
        jobs: recorded.jobs.iter().filter(|job| !job.outputs.is_empty()).count(),
        files: recorded.published.len(),
        differing_jobs,
        missing_jobs,
        differing_files,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_found_by_its_name_then_by_its_content() {
        let folder = tempfile::tempdir().unwrap();
        fs::create_dir(folder.path().join("deep")).unwrap();
        fs::write(folder.path().join("a.pfm"), "right").unwrap();
        fs::write(folder.path().join("deep/b.pfm"), "other").unwrap();
        let folders = [folder.path().to_owned()];
        assert!(by_name("maps/a.pfm", Digest::of(b"right"), &folders).is_some(), "the bare name is tried too");
        assert!(by_name("a.pfm", Digest::of(b"wrong"), &folders).is_none());
        assert!(by_name("../a.pfm", Digest::of(b"right"), &folders).is_some());
        let found = by_content(&BTreeSet::from([Digest::of(b"other"), Digest::of(b"none")]), &folders);
        assert_eq!(found.len(), 1);
        assert!(found[&Digest::of(b"other")].ends_with("deep/b.pfm"));
        assert!(absence("a.pfm", Digest::of(b"wrong"), &folders).contains("other content"));
    }
}

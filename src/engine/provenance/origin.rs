//! Finds the run that made a file: by what the file says of itself, else by its bytes.

use std::path::{Path, PathBuf};

use super::runs::{self, FoundRun};
use crate::engine::digest::Digest;
use crate::engine::manifest::{JobEntry, PublishedEntry, place_text};

/// A run that made a file.
#[derive(Debug)]
pub struct FoundOrigin {
    /// The run.
    pub run: FoundRun,
    /// The job, as an index into its jobs.
    pub job: usize,
    /// What it published with just these bytes; `None` where only the key that stands in the file agrees.
    pub published: Option<PublishedEntry>,
}

impl FoundOrigin {
    /// The entry of the job.
    pub fn entry(&self) -> &JobEntry {
        &self.run.manifest.jobs[self.job]
    }

    /// Where the run's files stand, if the place of its manifest tells.
    pub fn folder(&self) -> Option<PathBuf> {
        Some(self.run.outputs.as_ref()?.join(&self.run.manifest.pipeline))
    }
}

/// The latest run that published a file of these bytes; else the latest one with a job of that key.
///
/// `pipeline` and `key` are what the file says of itself.
pub fn find(outputs: &Path, digest: Digest, pipeline: Option<&str>, key: Option<&str>) -> Option<FoundOrigin> {
    by_bytes(outputs, digest, pipeline).or_else(|| by_key(outputs, pipeline, key?))
}

fn by_bytes(outputs: &Path, digest: Digest, pipeline: Option<&str>) -> Option<FoundOrigin> {
    let text = digest.to_string();
    runs::holding(outputs, pipeline, &text).find_map(|run| {
        let published = run.manifest.published.iter().find(|entry| entry.sha256 == digest)?.clone();
        let job = run.manifest.jobs.iter().position(|job| gave(job, &published.job))?;
        Some(FoundOrigin { run, job, published: Some(published) })
    })
}

/// Whether a published file's `stage.result[axis=value]` is of that job.
fn gave(job: &JobEntry, name: &str) -> bool {
    job.outputs.iter().any(|output| {
        let point = if output.name.is_empty() { "" } else { "." };
        place_text(&format!("{}{point}{}", job.stage, output.name), &job.coordinate) == name
    })
}

fn by_key(outputs: &Path, pipeline: Option<&str>, key: &str) -> Option<FoundOrigin> {
    let digest: Digest = key.parse().ok()?;
    runs::holding(outputs, pipeline, key).find_map(|run| {
        let job = run.manifest.jobs.iter().position(|job| job.key == Some(digest))?;
        Some(FoundOrigin { run, job, published: None })
    })
}

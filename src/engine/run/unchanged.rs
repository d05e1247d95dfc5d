//! Whether a run would change nothing, told without making a plan.
//!
//! A run that found everything in place leaves a note of all that it rested on: the program, the request, the
//! texts, the input files and the published files, each with its stat signature. While all of that is as it was, the
//! results stand, and the next run need not read the pipeline. Any difference leads to the plan, which tells
//! what it means; the note decides nothing else. What the signatures can be trusted for is told in `signature`.

use std::fs;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::{Clock, Places, Summary, new_run_folder, write_short};
use crate::engine::digest::Digest;
use crate::engine::graph::Graph;
use crate::engine::manifest::{Outcome, PublishedEntry, Status, WarningEntry};
use crate::engine::publish::OutputFolder;
use crate::engine::request::Request;
use crate::engine::schedule::Settings;
use crate::engine::signature::{Signature, Signatures};
use crate::engine::store::library::Library;
use crate::engine::system::SystemError;

/// A folder below the pipeline's, with the names and signatures of files in it.
type KnownFolder = (String, Vec<(String, Signature)>);

/// What a run that changed nothing rested on.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
struct Basis {
    /// The program's own file.
    program: (String, Signature),
    /// See [`Request::identity`].
    request: String,
    pipeline: String,
    /// Texts and inputs, by absolute path.
    sources: Vec<(PathBuf, Digest, Signature)>,
    /// The latest manifest and the published files, folder by folder below the pipeline's.
    published: Vec<KnownFolder>,
    run_id: String,
    result_id: Digest,
    jobs: u64,
    warnings: Vec<WarningEntry>,
}

/// What stands, as a run has just found it.
pub struct Standstill<'a> {
    /// The pipeline.
    pub graph: &'a Graph,
    /// Its folder.
    pub outputs: &'a OutputFolder,
    /// All files that it stands behind.
    pub published: &'a [PublishedEntry],
    /// The run that made them.
    pub run_id: &'a str,
    /// See [`result_id`](crate::engine::manifest::result_id).
    pub result_id: Digest,
    /// How many jobs were wanted.
    pub jobs: u64,
    /// What is said at each run.
    pub warnings: &'a [WarningEntry],
}

/// Notes what a run rested on that changed nothing; nothing is noted while a file is too young to be known by its
/// signature.
pub fn note(found: &Standstill<'_>, places: &Places, library: &Library, signatures: &mut Signatures) -> Result<(), SystemError> {
    if found.graph.has_warnings {
        return Ok(());
    }
    let Some(basis) = basis(found, signatures) else { return Ok(()) };
    let text = serde_json::to_string(&basis).expect("a basis is plain data");
    library.keep_note(&note_name(&found.graph.request, places), &text)
}

fn basis(found: &Standstill<'_>, signatures: &mut Signatures) -> Option<Basis> {
    let graph = found.graph;
    let texts = graph.sources.iter().map(|source| (graph.folder.join(&source.path), Some(Digest::of(source.text.as_bytes()))));
    let mut inputs: Vec<&PathBuf> =
        graph.jobs.iter().filter(|job| job.is_wanted).flat_map(|job| job.files.iter().map(|(_, path)| path)).collect();
    inputs.sort_unstable();
    inputs.dedup();
    let sources = texts.chain(inputs.into_iter().map(|path| (path.clone(), None)));
    let sources = sources.map(|(path, digest)| known_source(path, digest, signatures)).collect::<Option<_>>()?;

    Some(Basis {
        program: this_program()?,
        request: graph.request.clone(),
        pipeline: graph.pipeline.clone(),
        sources,
        published: known_files(found, signatures)?,
        run_id: found.run_id.to_owned(),
        result_id: found.result_id,
        jobs: found.jobs,
        warnings: found.warnings.to_vec(),
    })
}

/// A file whose digest is known by its signature; that of a text must be the digest of what was read.
fn known_source(path: PathBuf, digest: Option<Digest>, signatures: &mut Signatures) -> Option<(PathBuf, Digest, Signature)> {
    let path = std::path::absolute(path).ok()?;
    if digest.is_some() {
        // Texts are not hashed by way of signatures: this makes theirs known.
        signatures.content_of_input(&path).ok()?;
    }
    let status = fs::metadata(&path).ok()?;
    let known = signatures.known(&status)?;
    digest.is_none_or(|digest| digest == known).then(|| (path, known, Signature::of(&status)))
}

/// The published files by folder; `None` unless each is known to have its bytes.
fn known_files(found: &Standstill<'_>, signatures: &mut Signatures) -> Option<Vec<KnownFolder>> {
    let mut folders = vec![(String::new(), vec![("manifest.json", None)])];
    for entry in found.published {
        let (folder, name) = entry.path.rsplit_once('/').unwrap_or(("", &entry.path));
        if folders.last().is_none_or(|(last, _)| last != folder) {
            folders.push((folder.to_owned(), Vec::new()));
        }
        folders.last_mut()?.1.push((name, Some(entry.sha256)));
    }
    let known = |(folder, files): (String, Vec<(&str, Option<Digest>)>)| {
        let found = found.outputs.signatures(&folder, files.iter().map(|(name, _)| *name));
        let known = found.into_iter().zip(&files).map(|(signature, (name, digest))| {
            let signature = signature?;
            let is_right = digest.is_none_or(|digest| signatures.known_by(&signature) == Some(digest));
            is_right.then(|| ((*name).to_owned(), signature))
        });
        Some((folder, known.collect::<Option<Vec<_>>>()?))
    };
    folders.into_iter().map(known).collect()
}

/// Has a damaged note told and set aside; [`run`] passed it over in silence.
pub fn tell_damage(graph: &Graph, places: &Places, library: &Library) {
    let _ = library.note(&note_name(&graph.request, places));
}

/// The run that changes nothing, with its short manifest, if everything is as the last one left it.
pub fn run(request: &Request, places: &Places, settings: Settings) -> Result<Option<Summary>, SystemError> {
    let clock = Clock::start();
    // What is wrong with the store is told by the run, after what is wrong with the request.
    let Ok(library) = places.library() else { return Ok(None) };
    let identity = request.identity();
    let text = library.glance_at_note(&note_name(&identity, places));
    let Some(basis) = text.and_then(|text| serde_json::from_str::<Basis>(&text).ok()) else { return Ok(None) };
    let outputs = OutputFolder::at(&places.outputs, &basis.pipeline);
    if basis.request != identity || !basis.stands(&outputs) {
        return Ok(None);
    }

    outputs.prepare()?;
    library.tidy();
    let run_id = new_run_folder(&outputs, &clock)?;
    let mut measured = clock.measured(settings);
    measured.jobs.insert(Outcome::Hit.word().to_owned(), basis.jobs);
    write_short(&outputs, &basis.pipeline, &run_id, basis.result_id, &basis.run_id, &measured)?;
    Ok(Some(Summary {
        run_id,
        result_id: basis.result_id,
        status: Status::Done,
        results_of: Some(basis.run_id),
        manifest: outputs.path().join("manifest.json"),
        measured,
        failures: Vec::new(),
        warnings: basis.warnings,
        system_error: None,
    }))
}

impl Basis {
    fn stands(&self, outputs: &OutputFolder) -> bool {
        this_program().as_ref() == Some(&self.program)
            && self.sources.iter().all(|(path, digest, signature)| is_same_file(path, digest, signature))
            && self.published.iter().all(|(folder, files)| {
                let found = outputs.signatures(folder, files.iter().map(|(name, _)| name.as_str()));
                found.into_iter().zip(files).all(|(found, (_, signature))| found.as_ref() == Some(signature))
            })
    }
}

/// By its signature or, where that is another, by its content.
fn is_same_file(path: &Path, digest: &Digest, signature: &Signature) -> bool {
    let Ok(status) = fs::metadata(path) else { return false };
    Signature::of(&status) == *signature
        || status.len() == signature.size() && Signatures::default().content_of_input(path).is_ok_and(|content| content.digest == *digest)
}

/// Version and file of the running program: another build may read a pipeline in another way.
fn this_program() -> Option<(String, Signature)> {
    let file = std::env::current_exe().ok()?;
    Some((env!("CARGO_PKG_VERSION").to_owned(), Signature::of(&fs::metadata(file).ok()?)))
}

/// One note for each request and place of the outputs.
fn note_name(request: &str, places: &Places) -> String {
    let name = Digest::of(format!("{request} {:?}", std::path::absolute(&places.outputs)).as_bytes()).to_string();
    format!("unchanged-{}", &name[..32])
}

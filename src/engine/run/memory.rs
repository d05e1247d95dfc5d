//! What finished runs rested on, remembered: so that a run whose results are all there needs no plan.
//!
//! A run that is done leaves a note of all that its results rest on: the program, the request, the texts, the input
//! files, and the files that it stands behind, each with its stat signature where that can be trusted. While the
//! first of these are as they were, the results are those of that run, and the next one need not read the pipeline: it
//! finds every published file in place, or puts back what differs (`restoration`). There is a note for each of the
//! last texts, so that going back to an earlier one is no more work.
//!
//! A note decides nothing else. Whatever it does not foresee (another input, a file that a person has changed, an object
//! that the store has lost) leads to the plan, which tells what it means. What signatures can be trusted for is told in
//! `signature`.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

use serde::{Deserialize, Serialize};

use super::restoration::{self, Means, Restored};
use super::{Clock, Places, Summary, new_run_folder, run_file, write_short};
use crate::engine::digest::Digest;
use crate::engine::events::{Event, Listener};
use crate::engine::graph::Graph;
use crate::engine::lines::line;
use crate::engine::manifest::{Manifest, Outcome, PublishedEntry, Status, WarningEntry};
use crate::engine::provenance::ro_crate;
use crate::engine::publish::OutputFolder;
use crate::engine::request::Request;
use crate::engine::schedule::Settings;
use crate::engine::signature::{Content, Signature, Signatures};
use crate::engine::source::SIZE_LIMIT;
use crate::engine::store::library::Library;
use crate::engine::system::{SystemError, beside};

/// Notes of so many texts are kept for each request.
const TEXT_COUNT: u8 = 16;

/// What a run rested on.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Basis {
    /// The program's own file.
    program: (String, Signature),
    /// See [`Request::identity`].
    request: String,
    /// Name of the pipeline.
    pub(super) pipeline: String,
    /// Whether all jobs of the file were wanted.
    pub(super) is_whole: bool,
    /// Texts and inputs, by absolute path; the pipeline file first.
    sources: Vec<(PathBuf, Digest, Option<Signature>)>,
    /// The records of the run, which stand beside its files and in its own folder.
    pub(super) records: Vec<KnownRecord>,
    /// The published files, folder by folder below the pipeline's.
    published: Vec<KnownFolder>,
    /// Digest of the note that says what is in those files.
    pub(super) contents: Digest,
    /// The run whose results these are.
    pub(super) run_id: String,
    result_id: Digest,
    jobs: u64,
    warnings: Vec<WarningEntry>,
}

/// A folder below the pipeline's, with the names of files in it and the signatures by which they are known.
type KnownFolder = (String, Vec<(String, Option<Signature>)>);

/// A record of a run.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct KnownRecord {
    /// Its name beside the published files.
    pub(super) name: String,
    /// Its name in the run's folder.
    pub(super) kept_as: String,
    /// What is in it.
    pub(super) content: Content,
    signature: Option<Signature>,
}

/// The records of a run: the name beside the published files, and that in the run's folder.
pub const RECORDS: [(&str, &str); 2] = [("manifest.json", "manifest.json"), (ro_crate::FILE_NAME, "crate.json")];

/// What is in a published file.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct FileContent {
    /// Path below the pipeline's folder of outputs.
    pub path: String,
    /// Digest of its bytes.
    pub digest: Digest,
    /// See [`crate::engine::key::publication_key`].
    pub key: Digest,
}

/// What stands, as a run has just left it, but for its records.
pub struct Finished<'a> {
    /// The pipeline.
    pub graph: &'a Graph,
    /// Its record, which may be one that is not kept.
    pub manifest: &'a Manifest,
    /// Its folder.
    pub outputs: &'a OutputFolder,
    /// All files that it stands behind, in order.
    pub published: Vec<FileContent>,
    /// The run that made them.
    pub run_id: &'a str,
}

/// A note that lacks the records of its run.
pub struct Note {
    name: String,
    contents: String,
    basis: Basis,
}

impl Note {
    /// What a run rested on that is done. A run that is to say or do something every time leaves no note.
    pub fn of(found: &Finished<'_>, places: &Places, signatures: &mut Signatures) -> Option<Self> {
        let graph = found.graph;
        if graph.has_warnings || graph.jobs.iter().any(|job| job.is_forced) {
            return None;
        }
        let contents = line(&found.published);
        let basis = basis(found, Digest::of(contents.as_bytes()), signatures)?;
        let name = note_name(&graph.request, places, &Digest::of(graph.sources.first()?.text.as_bytes()));
        Some(Self { name, contents, basis })
    }

    /// Leaves it in the store, with what is in the records of the run, in the order of [`RECORDS`].
    pub fn keep(
        mut self,
        records: [Content; 2],
        outputs: &OutputFolder,
        library: &Library,
        signatures: &mut Signatures,
    ) -> Result<(), SystemError> {
        let record = |((name, kept_as), content): ((&str, &str), Content)| {
            let (name, kept_as) = (name.to_owned(), kept_as.to_owned());
            KnownRecord { name, kept_as, content, signature: None }
        };
        self.basis.records = RECORDS.into_iter().zip(records).map(record).collect();
        self.basis.learn_signatures_of_records(outputs, signatures);
        library.keep_note(&contents_name(&self.name), &self.contents)?;
        library.keep_note(&self.name, &line(&self.basis))
    }
}

fn basis(found: &Finished<'_>, contents: Digest, signatures: &mut Signatures) -> Option<Basis> {
    let graph = found.graph;
    let texts = graph.sources.iter().map(|source| (graph.folder.join(&source.path), Digest::of(source.text.as_bytes())));
    let wanted = graph.jobs.iter().filter(|job| job.is_wanted).zip(&found.manifest.jobs);
    let inputs = wanted.flat_map(|(job, entry)| job.files.iter().zip(&entry.files).map(|((_, path), file)| (path.clone(), file.sha256)));
    let mut inputs: Vec<(PathBuf, Digest)> = inputs.collect();
    inputs.sort_unstable();
    inputs.dedup();
    let sources = texts.chain(inputs).map(|(path, digest)| known_source(path, digest, signatures)).collect::<Option<_>>()?;

    let mut basis = Basis {
        program: this_program()?,
        request: graph.request.clone(),
        pipeline: graph.pipeline.clone(),
        is_whole: graph.is_whole,
        sources,
        records: Vec::new(),
        published: by_folder(&found.published),
        contents,
        run_id: found.run_id.to_owned(),
        result_id: found.manifest.result_id,
        jobs: found.manifest.jobs.len() as u64,
        warnings: found.manifest.warnings.clone(),
    };
    basis.learn_signatures(found.outputs, &found.published, signatures);
    Some(basis)
}

/// What is in the records of an earlier run, in the order of [`RECORDS`]; `None` if they are gone.
pub fn records_of(outputs: &OutputFolder, run_id: &str) -> Option<[Content; 2]> {
    let content = |kept_as: &str| Some(Content::of(&fs::read(outputs.path().join(run_file(run_id, kept_as))).ok()?));
    let [(_, record), (_, metadata)] = RECORDS;
    Some([content(record)?, content(metadata)?])
}

/// A text or an input with the signature by which its content is known, if it is.
fn known_source(path: PathBuf, digest: Digest, signatures: &mut Signatures) -> Option<(PathBuf, Digest, Option<Signature>)> {
    let path = std::path::absolute(path).ok()?;
    let signature = Signature::of(&fs::metadata(&path).ok()?);
    let is_known = signatures.known_by(&signature) == Some(digest);
    Some((path, digest, is_known.then_some(signature)))
}

fn by_folder(files: &[FileContent]) -> Vec<KnownFolder> {
    let mut folders: Vec<KnownFolder> = Vec::new();
    for file in files {
        let (folder, name) = file.path.rsplit_once('/').unwrap_or(("", &file.path));
        if folders.last().is_none_or(|(last, _)| last != folder) {
            folders.push((folder.to_owned(), Vec::new()));
        }
        folders.last_mut().expect("one was just pushed").1.push((name.to_owned(), None));
    }
    folders
}

/// Has a damaged note told and set aside; [`run`] passed it over in silence.
pub fn tell_damage(graph: &Graph, places: &Places, library: &Library) {
    if let Some(text) = graph.sources.first() {
        let name = note_name(&graph.request, places, &Digest::of(text.text.as_bytes()));
        let _ = (library.note(&name), library.note(&contents_name(&name)));
    }
}

/// The run that executes nothing, with its short manifest, if all that it rests on is as an earlier run has noted it.
///
/// If it is interrupted while it puts files back, there is no such run: the one that plans notes what is in place.
pub fn run(
    request: &Request,
    places: &Places,
    settings: Settings,
    interrupted: &AtomicBool,
    listener: &mut dyn Listener,
) -> Result<Option<Summary>, SystemError> {
    let clock = Clock::start();
    // What is wrong with the store is told by the run, after what is wrong with the request.
    let Ok(library) = places.library() else { return Ok(None) };
    let Some(text) = digest_of_text(&request.file) else { return Ok(None) };
    let identity = request.identity();
    let name = note_name(&identity, places, &text);
    let noted = library.glance_at_note(&name).and_then(|text| serde_json::from_str::<Basis>(&text).ok());
    let Some(mut basis) = noted.filter(|basis| basis.request == identity && basis.is_valid_for(&text)) else { return Ok(None) };
    let outputs = OutputFolder::at(&places.outputs, &basis.pipeline);

    let odd = basis.forget_odd(&outputs);
    let mut restored = Restored::default();
    if !odd.is_empty() {
        let (signatures, contents) = beside(|| Signatures::kept_in(&library), || basis.read_contents(&name, &library));
        let (Some(contents), mut signatures) = (contents, signatures) else { return Ok(None) };
        listener.notify(&Event::Planned { jobs: basis.jobs as usize, hits: basis.jobs as usize });
        let mut means =
            Means { outputs: &outputs, library: &library, signatures: &mut signatures, threads: settings.threads, interrupted, listener };
        match restoration::restore(&basis, &contents, &odd, &mut means)? {
            Some(done) => restored = done,
            None => return Ok(None),
        }
        basis.learn_signatures_of_records(&outputs, &mut signatures);
        basis.learn_signatures(&outputs, &contents, &mut signatures);
        let kept = beside(|| signatures.keep_in(&library), || library.keep_note(&name, &line(&basis)));
        kept.0.and(kept.1)?;
    }
    outputs.prepare()?;
    library.tidy();
    let run_id = new_run_folder(&outputs, &clock)?;
    let mut measured = clock.measured(settings);
    measured.jobs.insert(Outcome::Hit.word().to_owned(), basis.jobs);
    measured.files_written = restored.written;
    measured.files_removed = restored.removed;
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
        no_workers: None,
    }))
}

/// What is not known to be as it was.
#[derive(Debug, Default)]
pub(super) struct Odd {
    /// Published files, by their index among the contents.
    pub(super) files: Vec<usize>,
    /// Whether a record of the run beside them may be another's.
    pub(super) has_records: bool,
}

impl Odd {
    fn is_empty(&self) -> bool {
        self.files.is_empty() && !self.has_records
    }
}

impl Basis {
    /// Whether the program, the texts and the inputs are the same; `text` is the digest of the pipeline file.
    fn is_valid_for(&self, text: &Digest) -> bool {
        let Some(((_, digest, _), others)) = self.sources.split_first() else { return false };
        this_program().as_ref() == Some(&self.program)
            && digest == text
            && others.iter().all(|(path, digest, signature)| is_same_file(path, digest, signature.as_ref()))
    }

    /// What is in the published files.
    fn read_contents(&self, note: &str, library: &Library) -> Option<Vec<FileContent>> {
        let text = library.glance_at_note(&contents_name(note)).filter(|text| Digest::of(text.as_bytes()) == self.contents)?;
        serde_json::from_str(&text).ok()
    }

    /// Looks at every file that the run stands behind, reads none, and forgets the signatures that do not hold.
    fn forget_odd(&mut self, outputs: &OutputFolder) -> Odd {
        let forget = |known: &mut Option<Signature>, found: Option<Signature>| {
            *known = known.filter(|known| found == Some(*known));
            known.is_none()
        };
        let records = outputs.signatures("", self.records.iter().map(|record| record.name.as_str()));
        let mut has_records = false;
        for (record, found) in self.records.iter_mut().zip(records) {
            has_records |= forget(&mut record.signature, found);
        }
        let files = self.published.iter_mut().flat_map(|(folder, files)| {
            let found = outputs.signatures(folder, files.iter().map(|(name, _)| name.as_str()));
            files.iter_mut().map(|(_, known)| known).zip(found)
        });
        let odd = files.map(|(known, found)| forget(known, found)).enumerate().filter(|(_, is_odd)| *is_odd);
        Odd { files: odd.map(|(index, _)| index).collect(), has_records }
    }

    /// Takes down the signatures of the records beside the files, where these are known to have their bytes.
    fn learn_signatures_of_records(&mut self, outputs: &OutputFolder, signatures: &mut Signatures) {
        for record in &mut self.records {
            record.signature = outputs.signature(&record.name).filter(|found| signatures.known_by(found) == Some(record.content.digest));
        }
    }

    /// The same of the files of which none is known.
    fn learn_signatures(&mut self, outputs: &OutputFolder, contents: &[FileContent], signatures: &mut Signatures) {
        let mut known = |found: Option<Signature>, digest: &Digest| found.filter(|found| signatures.known_by(found) == Some(*digest));
        let mut contents = contents.iter();
        for (folder, files) in &mut self.published {
            let unknown: Vec<_> = files.iter_mut().zip(&mut contents).filter(|((_, signature), _)| signature.is_none()).collect();
            let found = outputs.signatures(folder, unknown.iter().map(|((name, _), _)| name.as_str()));
            for (((_, signature), content), found) in unknown.into_iter().zip(found) {
                *signature = known(found, &content.digest);
            }
        }
    }
}

/// By its signature or, where that is another or not to be trusted, by its content.
fn is_same_file(path: &Path, digest: &Digest, signature: Option<&Signature>) -> bool {
    let Ok(status) = fs::metadata(path) else { return false };
    let is_of_that_size = || signature.is_none_or(|signature| status.len() == signature.size());
    signature == Some(&Signature::of(&status))
        || is_of_that_size() && Signatures::default().content_of_input(path).is_ok_and(|content| content.digest == *digest)
}

/// The digest of a pipeline file, as the pipeline's reader would read it.
fn digest_of_text(path: &Path) -> Option<Digest> {
    let is_plain = fs::metadata(path).is_ok_and(|status| status.is_file() && status.len() <= SIZE_LIMIT);
    let bytes = is_plain.then(|| fs::read(path).ok()).flatten()?;
    Some(Digest::of(bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(&bytes)))
}

/// Version and file of the running program: another build may read a pipeline in another way.
fn this_program() -> Option<(String, Signature)> {
    let file = std::env::current_exe().ok()?;
    Some((env!("CARGO_PKG_VERSION").to_owned(), Signature::of(&fs::metadata(file).ok()?)))
}

/// The note for a request, a place of the outputs and a text; a few texts share a name, of which the last one has it.
fn note_name(request: &str, places: &Places, text: &Digest) -> String {
    let name = Digest::of(format!("{request} {:?}", std::path::absolute(&places.outputs)).as_bytes()).to_string();
    format!("run-{}-{}", &name[..32], text.0[0] % TEXT_COUNT)
}

fn contents_name(name: &str) -> String {
    format!("{name}-files")
}

/// The file that a record of a run is kept in.
pub(super) fn kept_record(run_id: &str, record: &KnownRecord) -> String {
    run_file(run_id, &record.kept_as)
}

/// The published files with the names under which the store has them; `None` if one is not among the keys.
pub fn contents<'k>(published: &[PublishedEntry], key: impl Fn(&str) -> Option<&'k Digest>) -> Option<Vec<FileContent>> {
    let content = |entry: &PublishedEntry| Some(FileContent { path: entry.path.clone(), digest: entry.sha256, key: *key(&entry.path)? });
    published.iter().map(content).collect()
}

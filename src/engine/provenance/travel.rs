//! Runs that go from one store to another: their records, their blobs, and what was noted of them.
//!
//! A run in a store elsewhere is one object, its manifest with the keys of its files; all else is found from there. It comes last,
//! so that a run that is found there is whole. What is brought here is checked like all that comes from elsewhere.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use serde::{Deserialize, Serialize};

use super::ro_crate;
use super::runs::checked;
use crate::catalogue::nearest;
use crate::engine::digest::Digest;
use crate::engine::lines;
use crate::engine::manifest::Manifest;
use crate::engine::publish::OutputFolder;
use crate::engine::run::memory::RECORDS;
use crate::engine::store::folder::FolderStore;
use crate::engine::store::library::{CopyError, Library};
use crate::engine::store::objects::{Objects, Shelf, drafted};
use crate::engine::store::record::{PublicationRecord, seal, unseal};
use crate::engine::store::tiers::Far;
use crate::engine::store::transfer::{Carried, Fault, Way, read_record};
use crate::engine::system::SystemError;

/// So many runs are looked through for one.
const RUN_LIMIT: usize = 1_000_000;

/// After so many calls that failed it is given up.
const PATIENCE: u64 = 5;

/// A run, as it is kept in a store.
#[derive(Serialize, Deserialize)]
struct Bundle {
    manifest: Manifest,
    /// Keys of the records of its files.
    publications: Vec<Digest>,
}

/// What became of records that were to be carried.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct Travelled {
    /// The run, if one was asked for.
    pub run_id: Option<String>,
    /// Records that stand in the target now with all that they name.
    pub records: u64,
    /// Those of them that did not stand there before.
    pub new: u64,
    /// Records of which the target has another version, with other results.
    pub differing: Vec<String>,
    /// Records that could not be carried because they, or what they name, are missing, damaged or not signed by a trusted key.
    pub lost: Vec<String>,
    /// Why the others were not carried.
    pub failure: Option<String>,
    /// Published files that were put in place.
    pub files: u64,
}

impl Travelled {
    /// Whether everything is there now.
    pub fn is_whole(&self) -> bool {
        self.lost.is_empty() && self.failure.is_none()
    }
}

/// Why there is nothing to bring.
#[derive(Debug, thiserror::Error)]
pub enum PullError {
    /// There is no such run.
    #[error("`{place}` holds no run `{name}`")]
    NoRun {
        /// What was asked for.
        name: String,
        /// Where.
        place: String,
        /// What to do.
        hint: Option<String>,
    },
    /// What stands there is not to be used.
    #[error("the run `{name}` of `{place}` cannot be used: {what}")]
    Unusable {
        /// The run.
        name: String,
        /// Where.
        place: String,
        /// Why.
        what: String,
    },
    /// The operating system failed.
    #[error(transparent)]
    System(#[from] SystemError),
}

/// Sends a run.
pub fn push_run(
    manifest: &Manifest,
    near: &FolderStore,
    library: &Library,
    far: &Far,
    stop: &AtomicBool,
) -> Result<Travelled, SystemError> {
    let files: BTreeSet<Digest> = manifest.published.iter().map(|entry| entry.sha256).collect();
    let is_of_the_run = |record: &PublicationRecord| files.contains(&record.content.digest);
    let publications: Vec<Digest> = keys_of(near, Shelf::Publications, HERE)?
        .into_iter()
        .filter(|key| library.glance_at_publication(key).is_some_and(|record| is_of_the_run(&record)))
        .collect();
    let mut travelled = carry_all(&far.way_there(near, stop), &records_of(manifest, &publications), far.objects.at_once());
    travelled.run_id = Some(manifest.run_id.clone());
    if travelled.is_whole() {
        let bundle = Bundle { manifest: manifest.clone(), publications };
        let text = far.keys.signed(Shelf::Runs, &seal(&lines::line(&bundle)));
        drafted(&*far.objects, text.as_bytes())?.keep(Shelf::Runs, &bundle_name(manifest))?;
    }
    Ok(travelled)
}

/// Sends all results of a store.
pub fn push_all(near: &FolderStore, far: &Far, stop: &AtomicBool) -> Result<Travelled, SystemError> {
    let records = all_records(near, HERE)?;
    Ok(carry_all(&far.way_there(near, stop), &records, far.objects.at_once()))
}

/// Brings all results of a store elsewhere.
pub fn pull_all(far: &Far, near: &FolderStore, stop: &AtomicBool) -> Result<Travelled, SystemError> {
    let records = all_records(&*far.objects, &far.name)?;
    Ok(carry_all(&far.way_here(near, stop), &records, far.objects.at_once()))
}

/// Brings a run: by its id, or the latest of a pipeline. Where no run of that pipeline stands, it is put in place.
pub fn pull_run(name: &str, far: &Far, near: &FolderStore, outputs: &std::path::Path, stop: &AtomicBool) -> Result<Travelled, PullError> {
    let bundle = find_bundle(name, far)?;
    let manifest = &bundle.manifest;
    let records = records_of(manifest, &bundle.publications);
    let mut travelled = carry_all(&far.way_here(near, stop), &records, far.objects.at_once());
    travelled.run_id = Some(manifest.run_id.clone());

    let outputs = OutputFolder::at(outputs, &manifest.pipeline);
    outputs.prepare()?;
    for (path, text) in ro_crate::workflow_files(manifest) {
        outputs.write(&path, text.as_bytes())?;
    }
    let texts = [lines::text(manifest), ro_crate::text(manifest).into_bytes()];
    for ((_, kept_as), text) in RECORDS.into_iter().zip(&texts) {
        outputs.write(&format!("runs/{}/{kept_as}", manifest.run_id), text)?;
    }
    if travelled.is_whole() && outputs.open(RECORDS[0].0).is_none() {
        travelled.files = publish(&bundle, near, &outputs)?;
        // The manifest comes last: until it is there, no run stands.
        for ((name, _), text) in RECORDS.into_iter().zip(&texts).rev() {
            outputs.write(name, text)?;
        }
    }
    Ok(travelled)
}

fn publish(bundle: &Bundle, near: &FolderStore, outputs: &OutputFolder) -> Result<u64, PullError> {
    let library = Library::new(std::sync::Arc::new(near.clone()));
    let contents = bundle.publications.iter().filter_map(|key| library.glance_at_publication(key)).map(|record| record.content);
    let contents: BTreeMap<Digest, _> = contents.map(|content| (content.digest, content)).collect();
    for entry in &bundle.manifest.published {
        let unusable = |what: &str| PullError::Unusable {
            name: bundle.manifest.run_id.clone(),
            place: outputs.path().display().to_string(),
            what: format!("`{}`: {what}", entry.path),
        };
        let content = contents.get(&entry.sha256).ok_or_else(|| unusable("no record has its bytes"))?;
        let mut draft = outputs.begin()?;
        library.copy_blob(content, &mut draft).map_err(|error| match error {
            CopyError::Lost(lost) => unusable(lost.reason()),
            CopyError::Target(error) => SystemError::at("write", outputs.path().join(&entry.path))(error).into(),
        })?;
        draft.publish(&entry.path)?;
    }
    Ok(bundle.manifest.published.len() as u64)
}

/// `PIPELINE.RUN_ID`: the latest run of a pipeline is its last name.
fn bundle_name(manifest: &Manifest) -> String {
    format!("{}.{}", manifest.pipeline, manifest.run_id)
}

fn find_bundle(wanted: &str, far: &Far) -> Result<Bundle, PullError> {
    let place = far.name.clone();
    let mut names = far.objects.names(Shelf::Runs, RUN_LIMIT).map_err(SystemError::at("read", &place))?;
    names.sort_unstable();
    let is_meant = |name: &str| name.split_once('.').is_some_and(|(pipeline, run_id)| [pipeline, run_id].contains(&wanted));
    let Some(name) = names.iter().rfind(|name| is_meant(name)) else {
        let known = names.iter().filter_map(|name| name.split_once('.')).flat_map(|(pipeline, run_id)| [pipeline, run_id]);
        let hint = match nearest(wanted, known) {
            Some(near) => Some(format!("did you mean `{near}`?")),
            None if names.is_empty() => Some("no run was sent there: `pipeline store push RUN` does that".to_owned()),
            None => None,
        };
        return Err(PullError::NoRun { name: wanted.to_owned(), place, hint });
    };
    let unusable = |what: String| PullError::Unusable { name: name.clone(), place: place.clone(), what };
    let record = read_record(&*far.objects, &far.keys, Shelf::Runs, name).map_err(|fault| unusable(fault.to_string()))?;
    let body = unseal(&record.sealed).expect("the seal was looked at");
    let bundle: Bundle = serde_json::from_str(body).map_err(|error| unusable(error.to_string()))?;
    checked(&bundle.manifest).map_err(unusable)?;
    if bundle_name(&bundle.manifest) != *name {
        return Err(unusable("it stands under another's name".to_owned()));
    }
    Ok(bundle)
}

fn records_of(manifest: &Manifest, publications: &[Digest]) -> Vec<(Shelf, String)> {
    let with_results = manifest.jobs.iter().filter(|job| !job.outputs.is_empty());
    let keys: BTreeSet<Digest> = with_results.filter_map(|job| job.key).collect();
    let results = keys.iter().map(|key| (Shelf::Results, key.to_string()));
    results.chain(publications.iter().map(|key| (Shelf::Publications, key.to_string()))).collect()
}

/// The store of this machine, in messages.
const HERE: &str = "the store";

fn all_records(from: &dyn Objects, place: &str) -> Result<Vec<(Shelf, String)>, SystemError> {
    let mut records = Vec::new();
    for shelf in [Shelf::Results, Shelf::Publications] {
        records.extend(keys_of(from, shelf, place)?.iter().map(|key| (shelf, key.to_string())));
    }
    records.sort_by(|a, b| a.1.cmp(&b.1));
    Ok(records)
}

/// The keys of all records on a shelf, in their order.
fn keys_of(from: &dyn Objects, shelf: Shelf, place: &str) -> Result<Vec<Digest>, SystemError> {
    let names = from.names(shelf, usize::MAX).map_err(SystemError::at("read", place))?;
    let mut keys: Vec<Digest> = names.iter().filter_map(|name| name.parse().ok()).collect();
    keys.sort_unstable();
    Ok(keys)
}

fn carry_all(way: &Way<'_>, records: &[(Shelf, String)], at_once: usize) -> Travelled {
    let travelled = Mutex::new(Travelled::default());
    let (next, failures) = (AtomicUsize::new(0), AtomicUsize::new(0));
    let carry = || {
        while let Some((shelf, name)) = records.get(next.fetch_add(1, Ordering::Relaxed)) {
            if failures.load(Ordering::Relaxed) as u64 >= PATIENCE || way.stop.load(Ordering::Relaxed) {
                return;
            }
            let carried = way.carry(*shelf, name);
            let mut travelled = travelled.lock().expect("no one panics while counting");
            failures.fetch_add(usize::from(travelled.note(*shelf, name, carried)), Ordering::Relaxed);
        }
    };
    std::thread::scope(|scope| (0..at_once.min(records.len())).for_each(|_| drop(scope.spawn(carry))));
    let mut travelled = travelled.into_inner().expect("no one panics while counting");
    travelled.differing.sort_unstable();
    travelled.lost.sort_unstable();
    if way.stop.load(Ordering::Relaxed) && travelled.failure.is_none() {
        travelled.failure = Some("interrupted".to_owned());
    }
    travelled
}

impl Travelled {
    /// Counts one; whether a store failed.
    fn note(&mut self, shelf: Shelf, name: &str, carried: Result<Carried, Fault>) -> bool {
        match carried {
            Ok(Carried::New) => (self.records, self.new) = (self.records + 1, self.new + 1),
            Ok(Carried::WasThere) => self.records += 1,
            Ok(Carried::Differs) => self.differing.push(name.to_owned()),
            Err(Fault::Stopped) => {}
            Err(fault @ (Fault::Missing | Fault::Damaged(_) | Fault::Untrusted)) => {
                self.lost.push(format!("{} `{name}`: {fault}", shelf.noun()));
            }
            Err(fault @ (Fault::Source(_) | Fault::Target(_))) => {
                self.failure.get_or_insert_with(|| fault.to_string());
                return true;
            }
        }
        false
    }
}

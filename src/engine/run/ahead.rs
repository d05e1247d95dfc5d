//! What earlier runs have left, read while the pipeline is laid out: both take as long, and neither needs the other.
//!
//! Nothing is said or set aside here, since the pipeline may prove wrong: what cannot be read is read again by the run,
//! which tells of it.

use std::fs;
use std::path::Path;
use std::sync::Arc;
use std::thread::JoinHandle;

use super::Places;
use crate::engine::history::EarlierRun;
use crate::engine::manifest::Standing;
use crate::engine::signature::Signatures;
use crate::engine::store::index::Index;
use crate::engine::store::library::Library;
use crate::engine::system::SystemError;

/// The reading, under way.
pub struct Ahead {
    places: Places,
    pipeline: String,
    caches: JoinHandle<Caches>,
    latest: JoinHandle<Latest>,
}

/// What the store and the latest run know.
pub(super) struct Known {
    pub(super) library: Arc<Library>,
    pub(super) index: Index,
    pub(super) signatures: Signatures,
    pub(super) latest: Latest,
}

/// The latest manifest, as far as a next run needs it.
#[derive(Default)]
pub(super) struct Latest {
    pub(super) standing: Option<Standing>,
    pub(super) run: Option<EarlierRun>,
}

/// The caches of a store, as far as they are sound.
#[derive(Default)]
struct Caches {
    library: Option<Arc<Library>>,
    index: Option<Index>,
    signatures: Option<Signatures>,
}

impl Ahead {
    /// Begins to read what a run of that pipeline needs.
    pub fn begin(places: &Places, pipeline: &str) -> Self {
        let (of_caches, name, folder) = (places.clone(), pipeline.to_owned(), places.outputs.join(pipeline));
        Self {
            places: places.clone(),
            pipeline: pipeline.to_owned(),
            caches: std::thread::spawn(move || Caches::read(&of_caches, &name)),
            latest: std::thread::spawn(move || Latest::read(&folder)),
        }
    }

    /// Where it is read.
    pub fn places(&self) -> &Places {
        &self.places
    }

    /// Waits for it. What is missing is looked for again, now with a word on what is wrong.
    pub(super) fn known(self) -> Result<Known, SystemError> {
        let Self { places, pipeline, caches, latest } = self;
        let Caches { library, index, signatures } = caches.join().unwrap_or_default();
        let library = match library {
            Some(library) => library,
            None => Arc::new(places.library()?),
        };
        let index = index.unwrap_or_else(|| Index::load(&library, &pipeline));
        let signatures = signatures.unwrap_or_else(|| Signatures::kept_in(&library));
        Ok(Known { library, index, signatures, latest: latest.join().unwrap_or_default() })
    }
}

impl Caches {
    fn read(places: &Places, pipeline: &str) -> Self {
        // A store elsewhere may be slow, and is no one's business before the pipeline is right.
        if places.remote.is_some() {
            return Self::default();
        }
        let Ok(library) = places.library() else { return Self::default() };
        let (signatures, index) = (Signatures::glance(&library), Index::glance(&library, pipeline));
        Self { library: Some(Arc::new(library)), index, signatures }
    }
}

impl Latest {
    fn read(folder: &Path) -> Self {
        let Ok(text) = fs::read_to_string(folder.join("manifest.json")) else { return Self::default() };
        let standing = Standing::from_text(text.as_bytes());
        Self { standing, run: EarlierRun::of_manifest(text) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::trial::{Space, job};

    #[test]
    fn what_a_run_left_is_read_and_damage_is_left_for_the_run_to_tell() {
        let space = Space::new();
        let jobs = [job("a", "a").saves()];
        space.run(&jobs);
        let Latest { standing, run } = Latest::read(&space.path("outputs/p"));
        assert!(standing.is_some() && run.is_some());
        let caches = Caches::read(&space.places(), "p");
        let key = space.manifest().jobs[0].key.unwrap();
        assert!(caches.index.unwrap().result_of_key(&key).is_some());

        let note = space.path("store/v1/notes/recipes-p");
        let damaged = fs::read_to_string(&note).unwrap().replacen('0', "1", 1);
        fs::write(&note, &damaged).unwrap();
        assert!(Caches::read(&space.places(), "p").index.is_none());
        assert_eq!(fs::read_to_string(&note).unwrap(), damaged, "it is still in its place");
        let said: Vec<String> = space.run(&jobs).warnings.into_iter().map(|warning| warning.message).collect();
        assert!(said.iter().any(|message| message.contains("damaged")), "{said:?}");
    }
}

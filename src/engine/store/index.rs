//! From recipes to final ids: what lets a run that changes nothing read no intermediate and few files.
//!
//! One file per pipeline, a cache that can be rebuilt from the records: without it each record is read.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::library::Library;
use super::record::{Blob, PublicationRecord, ResultRecord};
use crate::engine::digest::Digest;
use crate::engine::system::SystemError;

/// Entries of earlier settings that are kept beside those of the present one.
const OLDER_COUNT: usize = 20_000;

/// What is known of results by their recipe.
#[derive(Debug, Default, Serialize, Deserialize)]
pub struct Index {
    results: BTreeMap<Digest, ResultRecord>,
    publications: BTreeMap<Digest, PublicationRecord>,
}

impl Index {
    /// The index of a pipeline; empty if there is none.
    pub fn load(library: &Library, pipeline: &str) -> Self {
        let text = library.note(&note_name(pipeline));
        text.and_then(|text| serde_json::from_str(&text).ok()).unwrap_or_default()
    }

    /// Writes this run's entries, and as many of the earlier ones as are worth keeping.
    pub fn keep(mut self, earlier: Index, library: &Library, pipeline: &str) -> Result<(), SystemError> {
        let new = |older: usize| OLDER_COUNT.saturating_sub(older);
        let (result_room, publication_room) = (new(self.results.len()), new(self.publications.len()));
        let Index { results, publications } = earlier;
        let older: Vec<_> = results.into_iter().filter(|(recipe, _)| !self.results.contains_key(recipe)).take(result_room).collect();
        self.results.extend(older);
        let older: Vec<_> =
            publications.into_iter().filter(|(key, _)| !self.publications.contains_key(key)).take(publication_room).collect();
        self.publications.extend(older);
        let text = serde_json::to_string(&self).expect("an index is plain data");
        library.keep_note(&note_name(pipeline), &text)
    }

    /// The result of a recipe, without the bytes that its record holds.
    pub fn result(&self, recipe: &Digest) -> Option<&ResultRecord> {
        self.results.get(recipe)
    }

    /// An encoded file, without the bytes that its record holds.
    pub fn publication(&self, key: &Digest) -> Option<&PublicationRecord> {
        self.publications.get(key)
    }

    /// Adds a result.
    pub fn add_result(&mut self, recipe: Digest, record: &ResultRecord) {
        let mut record = record.clone();
        record.outputs.iter_mut().for_each(|output| output.content.inline = None);
        self.results.insert(recipe, record);
    }

    /// Adds an encoded file.
    pub fn add_publication(&mut self, record: &PublicationRecord) {
        let content = Blob { inline: None, ..record.content.clone() };
        self.publications.insert(record.key, PublicationRecord { content, ..record.clone() });
    }

    /// Whether another index has all that this one has.
    pub fn is_within(&self, other: &Index) -> bool {
        self.results.iter().all(|(recipe, record)| other.results.get(recipe) == Some(record))
            && self.publications.iter().all(|(key, record)| other.publications.get(key) == Some(record))
    }
}

fn note_name(pipeline: &str) -> String {
    format!("recipes-{pipeline}")
}

//! From recipes to final ids: what lets a run that changes nothing read no intermediate and few files.
//!
//! One file per pipeline, a cache that can be rebuilt from the records: without it each record is read. Its
//! rows are arrays, without names of fields and without the bytes that records hold, since a whole index is read at
//! every plan.

use serde::{Deserialize, Serialize};

use super::library::Library;
use super::record::{Blob, OutputRecord, PublicationRecord, ResultRecord};
use crate::engine::digest::{Digest, DigestMap};
use crate::engine::lines::line;
use crate::engine::system::{SystemError, let_go};

/// Entries of earlier settings that are kept beside those of the present one.
const OLDER_COUNT: usize = 20_000;

/// What is known of results by their recipe.
#[derive(Debug, Default)]
pub struct Index {
    results: DigestMap<ResultRecord>,
    publications: DigestMap<PublicationRecord>,
    /// From a job's key to its recipe.
    recipes: DigestMap<Digest>,
}

/// The file of an index, its rows in the order of their keys.
#[derive(Serialize, Deserialize)]
struct IndexFile {
    results: Vec<ResultRow>,
    publications: Vec<PublicationRow>,
}

/// Recipe, schema, key, outputs, warnings, seconds, memory, program.
type ResultRow = (Digest, u32, Digest, Vec<OutputRow>, Vec<String>, f64, u64, String);
/// Name, type, digest, size.
type OutputRow = (String, String, Digest, u64);
/// Schema, key, digest, size, warnings.
type PublicationRow = (u32, Digest, Digest, u64, Vec<String>);

impl Index {
    /// The index of a pipeline; empty if there is none.
    pub fn load(library: &Library, pipeline: &str) -> Self {
        library.note(&note_name(pipeline)).and_then(|text| Self::from_text(&text)).unwrap_or_default()
    }

    /// The same if it is sound; nothing is said or set aside if not.
    pub fn glance(library: &Library, pipeline: &str) -> Option<Self> {
        Self::from_text(&library.glance_at_note(&note_name(pipeline))?)
    }

    fn from_text(text: &str) -> Option<Self> {
        serde_json::from_str::<IndexFile>(text).ok().map(Self::from_file)
    }

    fn from_file(file: IndexFile) -> Self {
        let mut index = Self::default();
        for (recipe, schema, key, outputs, warnings, seconds, memory, program) in file.results {
            let output = |(name, type_name, digest, size)| OutputRecord { name, type_name, content: Blob { digest, size, inline: None } };
            let outputs = outputs.into_iter().map(output).collect();
            index.recipes.insert(key, recipe);
            index.results.insert(recipe, ResultRecord { schema, key, outputs, warnings, seconds, memory, program });
        }
        for (schema, key, digest, size, warnings) in file.publications {
            let content = Blob { digest, size, inline: None };
            index.publications.insert(key, PublicationRecord { schema, key, content, warnings });
        }
        index
    }

    /// Writes this run's entries, and as many of the earlier ones as are worth keeping.
    pub fn keep(self, earlier: Index, library: &Library, pipeline: &str) -> Result<(), SystemError> {
        let file = IndexFile {
            results: with_older(self.results, earlier.results).into_iter().map(result_row).collect(),
            publications: with_older(self.publications, earlier.publications).into_iter().map(publication_row).collect(),
        };
        let text = line(&file);
        let_go(file);
        library.keep_note(&note_name(pipeline), &text)
    }

    /// The result of a recipe, without the bytes that its record holds.
    pub fn result(&self, recipe: &Digest) -> Option<&ResultRecord> {
        self.results.get(recipe)
    }

    /// The same by the key.
    pub fn result_of_key(&self, key: &Digest) -> Option<&ResultRecord> {
        self.results.get(self.recipes.get(key)?).filter(|record| record.key == *key)
    }

    /// An encoded file, without the bytes that its record holds.
    pub fn publication(&self, key: &Digest) -> Option<&PublicationRecord> {
        self.publications.get(key)
    }

    /// Adds a result.
    pub fn add_result(&mut self, recipe: Digest, record: &ResultRecord) {
        let mut record = record.clone();
        record.outputs.iter_mut().for_each(|output| output.content.inline = None);
        self.recipes.insert(record.key, recipe);
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

/// The rows of this run and the first of the others, in the order of their keys.
fn with_older<T>(rows: DigestMap<T>, older: DigestMap<T>) -> Vec<(Digest, T)> {
    let room = OLDER_COUNT.saturating_sub(rows.len());
    let mut older: Vec<_> = older.into_iter().filter(|(key, _)| !rows.contains_key(key)).collect();
    older.sort_unstable_by_key(|(key, _)| *key);
    let mut all: Vec<_> = rows.into_iter().chain(older.into_iter().take(room)).collect();
    all.sort_unstable_by_key(|(key, _)| *key);
    all
}

fn result_row((recipe, record): (Digest, ResultRecord)) -> ResultRow {
    let ResultRecord { schema, key, outputs, warnings, seconds, memory, program } = record;
    let output = |output: OutputRecord| (output.name, output.type_name, output.content.digest, output.content.size);
    (recipe, schema, key, outputs.into_iter().map(output).collect(), warnings, seconds, memory, program)
}

fn publication_row((key, record): (Digest, PublicationRecord)) -> PublicationRow {
    (record.schema, key, record.content.digest, record.content.size, record.warnings)
}

fn note_name(pipeline: &str) -> String {
    format!("recipes-{pipeline}")
}

//! The tables of a program: its stage kinds and its artifact types.

use std::ffi::OsStr;
use std::path::Path;
use std::sync::OnceLock;

use schemars::generate::SchemaSettings;
use serde_json::Value as Json;

use super::artifact::{Artifact, ArtifactKind};
use super::source::Findings;
use super::stage::{AnyStage, ResultDeclaration, Stage};
use super::yaml::{self, Node};
use crate::catalogue::Catalogue;

/// One row of the table of kinds.
pub struct Kind {
    /// Its key in the pipeline file.
    pub name: &'static str,
    /// Version of its results.
    pub version: u32,
    /// Its results, the first one first.
    pub results: &'static [ResultDeclaration],
    /// Whether `split:` may divide its jobs.
    pub splits: bool,
    /// Made when it is asked for: a pipeline has few of all kinds.
    schema: OnceLock<Json>,
    make_schema: fn() -> Json,
    parse: fn(serde_yaml::Value) -> Result<Box<dyn AnyStage>, ParseError>,
}

impl Kind {
    /// The row of kind `T`.
    pub fn of<T: Stage>() -> Self {
        let make_schema = || SchemaSettings::draft07().into_generator().into_root_schema_for::<T>().into();
        let (schema, parse) = (OnceLock::new(), parse::<T>);
        Self { name: T::KIND, version: T::VERSION, results: T::RESULTS, splits: T::SPLITS, schema, make_schema, parse }
    }

    /// JSON Schema (draft-07) of its parameters, with references resolved by `definitions`.
    pub fn schema(&self) -> &Json {
        self.schema.get_or_init(self.make_schema)
    }

    /// Reads a parameter block.
    pub fn parse(&self, parameters: serde_yaml::Value) -> Result<Box<dyn AnyStage>, ParseError> {
        (self.parse)(parameters)
    }
}

/// A parameter block that serde refuses.
#[derive(Debug, thiserror::Error)]
#[error("{message}")]
pub struct ParseError {
    /// Path of the field from the block's root, as serde_path_to_error writes it: `a.b[2]`.
    pub path: String,
    /// What is wrong.
    pub message: String,
}

/// Choices with parameters of their own are maps of one key (`{ sphere: {...} }`), where serde_yaml alone wants tags.
fn parse<T: Stage>(parameters: serde_yaml::Value) -> Result<Box<dyn AnyStage>, ParseError> {
    let mut track = serde_path_to_error::Track::new();
    let deserializer = serde_path_to_error::Deserializer::new(parameters, &mut track);
    let parsed: Result<T, serde_yaml::Error> = serde_yaml::with::singleton_map_recursive::deserialize(deserializer);
    match parsed {
        Ok(stage) => Ok(Box::new(stage)),
        Err(error) => Err(ParseError { path: track.path().to_string(), message: error.to_string() }),
    }
}

/// All kinds and all artifact types of a program.
#[derive(Default)]
pub struct Registry {
    kinds: Catalogue<Kind>,
    artifacts: Catalogue<ArtifactKind>,
    dialects: Vec<(&'static str, Dialect)>,
}

/// Reads the text of a file, of that index, as the tree that the same would be in YAML; `None` after a finding.
pub type Dialect = fn(u32, &str, &mut Findings) -> Option<Node>;

impl Registry {
    /// Adds a stage kind.
    #[must_use]
    pub fn with<T: Stage>(mut self) -> Self {
        self.kinds.add(T::KIND, Kind::of::<T>());
        self
    }

    /// Adds an artifact type.
    #[must_use]
    pub fn with_artifact<T: Artifact>(mut self) -> Self {
        self.artifacts.add(T::TYPE, ArtifactKind::of::<T>());
        self
    }

    /// Adds another language than YAML for sections that stand in files whose names end so.
    #[must_use]
    pub fn with_dialect(mut self, extension: &'static str, dialect: Dialect) -> Self {
        self.dialects.push((extension, dialect));
        self
    }

    /// What reads a section in a file of that name: by its extension, else YAML.
    pub fn dialect(&self, path: &Path) -> Dialect {
        let extension = path.extension().and_then(OsStr::to_str).unwrap_or("");
        let found = self.dialects.iter().find(|(known, _)| known.eq_ignore_ascii_case(extension));
        found.map_or(yaml::parse, |(_, dialect)| *dialect)
    }

    /// The stage kinds.
    pub fn kinds(&self) -> &Catalogue<Kind> {
        &self.kinds
    }

    /// The artifact types.
    pub fn artifacts(&self) -> &Catalogue<ArtifactKind> {
        &self.artifacts
    }
}

//! Parameter types with a meaning to the engine: ports, input files, sections, seeds.
//!
//! Each marks itself in the JSON Schema of its kind (`x-port`, `x-file`, `x-section`, `x-seed`), and the engine finds
//! them there; so a kind's struct is the only place where they are declared.

use std::borrow::Cow;
use std::marker::PhantomData;
use std::path::PathBuf;
use std::sync::Arc;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::artifact::{AnyArtifact, Artifact, TypeName};

/// What a port can take: one artifact type (as `Arc<T>`), or several behind an enum.
pub trait Accepts {
    /// Names of the types it takes.
    const TYPES: &'static [TypeName];
    /// What a stage gets.
    type Value;

    /// The value, if the artifact is of one of the types.
    fn take(artifact: AnyArtifact) -> Option<Self::Value>;
}

impl<T: Artifact> Accepts for T {
    const TYPES: &'static [TypeName] = &[T::TYPE];
    type Value = Arc<T>;

    fn take(artifact: AnyArtifact) -> Option<Arc<T>> {
        artifact.get()
    }
}

/// A reference to one result of another stage: `name`, `name.result`, `name[axis=value]`.
pub struct Port<T> {
    reference: String,
    accepts: PhantomData<fn() -> T>,
}

impl<T> Port<T> {
    /// A port with that reference, for tests and tools.
    pub fn to(reference: impl Into<String>) -> Self {
        Self { reference: reference.into(), accepts: PhantomData }
    }

    /// The reference as written.
    pub fn reference(&self) -> &str {
        &self.reference
    }
}

impl<T> Clone for Port<T> {
    fn clone(&self) -> Self {
        Self::to(self.reference.clone())
    }
}

impl<T> std::fmt::Debug for Port<T> {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(out, "Port({})", self.reference)
    }
}

impl<T> Serialize for Port<T> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(&self.reference)
    }
}

impl<'de, T> Deserialize<'de> for Port<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        String::deserialize(deserializer).map(Self::to)
    }
}

impl<T: Accepts> JsonSchema for Port<T> {
    fn inline_schema() -> bool {
        true
    }

    fn schema_name() -> Cow<'static, str> {
        format!("Port<{}>", T::TYPES.join("|")).into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({ "type": "string", "x-port": T::TYPES })
    }
}

/// A collecting port: one reference or a list of them.
pub struct Ports<T> {
    references: Vec<String>,
    accepts: PhantomData<fn() -> T>,
}

impl<T> Ports<T> {
    /// Ports with these references, for tests and tools.
    pub fn to(references: impl IntoIterator<Item = impl Into<String>>) -> Self {
        Self { references: references.into_iter().map(Into::into).collect(), accepts: PhantomData }
    }

    /// The references as written.
    pub fn references(&self) -> &[String] {
        &self.references
    }
}

impl<T> Clone for Ports<T> {
    fn clone(&self) -> Self {
        Self::to(self.references.clone())
    }
}

impl<T> std::fmt::Debug for Ports<T> {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(out, "Ports({:?})", self.references)
    }
}

impl<T> Serialize for Ports<T> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.references.serialize(serializer)
    }
}

impl<'de, T> Deserialize<'de> for Ports<T> {
    /// The engine has turned a single reference into a list of one.
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        Vec::<String>::deserialize(deserializer).map(Self::to)
    }
}

impl<T: Accepts> JsonSchema for Ports<T> {
    fn inline_schema() -> bool {
        true
    }

    fn schema_name() -> Cow<'static, str> {
        format!("Ports<{}>", T::TYPES.join("|")).into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({
            "anyOf": [
                { "type": "string" },
                { "type": "array", "items": { "type": "string" }, "minItems": 1 },
            ],
            "x-port": T::TYPES,
            "x-collects": true,
        })
    }
}

/// A file that the stage reads; enters the key as the digest of its content.
///
/// In the pipeline file it is relative to the file in which the text stands; the engine resolves it.
#[derive(Debug, Clone, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(transparent)]
pub struct InputFile(pub PathBuf);

impl JsonSchema for InputFile {
    fn inline_schema() -> bool {
        true
    }

    fn schema_name() -> Cow<'static, str> {
        "InputFile".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({ "type": "string", "minLength": 1, "x-file": true })
    }
}

/// Part of the parameters that may stand in a file of its own: where the path of a YAML file is written, the file's
/// content is put in, with its own lines in messages and its own folder for paths. Parameters may be used in it.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Section<T>(pub T);

impl<T: JsonSchema> JsonSchema for Section<T> {
    fn inline_schema() -> bool {
        true
    }

    fn schema_name() -> Cow<'static, str> {
        format!("Section<{}>", T::schema_name()).into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        let inside = generator.subschema_for::<T>();
        json_schema!({ "anyOf": [inside, { "type": "string", "minLength": 1 }], "x-section": true })
    }
}

/// The seed of a stage that draws; absent means the pipeline's.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Seed(pub Option<u64>);

impl JsonSchema for Seed {
    fn inline_schema() -> bool {
        true
    }

    fn schema_name() -> Cow<'static, str> {
        "Seed".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({ "type": "integer", "format": "uint64", "minimum": 0, "maximum": u64::MAX, "x-seed": true })
    }
}

//! What flows between stages: typed values with one canonical byte form.
//!
//! The engine stores, hashes and hands on artifacts without knowing what they hold; the room `stages`
//! implements the trait for the types of the domain. An artifact never contains its coordinate or the
//! name of a stage.

use std::any::Any;
use std::fmt;
use std::io::{self, Read, Write};
use std::sync::Arc;

/// The name of a type of artifact: `envmap`, `samples`, `table`, …
pub type TypeName = &'static str;

/// A type of artifact.
pub trait Artifact: Any + Send + Sync + Sized {
    /// Its name, as in port types and in records of the store.
    const TYPE: TypeName;
    /// What `save:` can write it as, in the order in which messages list them.
    const FORMATS: &'static [&'static str];
    /// Raise when [`Artifact::save`] would write other bytes for equal content.
    const ENCODER_VERSION: u32 = 1;

    /// The extension of a file in one of `FORMATS`: its name, unless readers expect another.
    fn extension(format: &str) -> &str {
        format
    }

    /// Writes the canonical form: versioned header, little endian, floats by their bits.
    fn write(&self, out: &mut dyn Write) -> io::Result<()>;

    /// Reads the canonical form back; `InvalidData` if these are not such bytes.
    ///
    /// Never allocates more than a small constant beyond what the input really holds.
    fn read(input: &mut dyn Read) -> io::Result<Self>;

    /// Bytes it holds in memory.
    fn memory(&self) -> u64;

    /// Encodes it for a reader outside; `format` is one of `FORMATS`.
    fn save(&self, format: &str, origin: &Origin) -> Result<Saved, SaveError>;
}

/// Where a published file comes from; written inside PNG, EXR and SVG. Says nothing of the run.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Origin {
    /// Name of the pipeline.
    pub pipeline: String,
    /// Name of the stage, with `.result` for a further result.
    pub stage: String,
    /// Text of the coordinate; empty where there is no axis.
    pub coordinate: String,
    /// Key of the job, in hex.
    pub key: String,
}

impl Origin {
    /// Name and text of each entry, in order; what goes into PNG text chunks and EXR attributes.
    pub fn entries(&self) -> [(&'static str, &str); 4] {
        [
            ("pipeline", self.pipeline.as_str()),
            ("stage", self.stage.as_str()),
            ("coordinate", self.coordinate.as_str()),
            ("key", self.key.as_str()),
        ]
    }
}

/// An encoded artifact.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Saved {
    /// The file's bytes.
    pub bytes: Vec<u8>,
    /// What the reader should know (values that were clipped).
    pub warnings: Vec<String>,
}

impl From<Vec<u8>> for Saved {
    fn from(bytes: Vec<u8>) -> Self {
        Self { bytes, warnings: Vec::new() }
    }
}

/// An artifact that cannot be written in a format.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct SaveError(pub String);

/// The functions of one artifact type, free of the type.
#[derive(Clone, Copy)]
pub struct ArtifactKind {
    /// Name of the type.
    pub name: TypeName,
    /// Formats `save:` can write.
    pub formats: &'static [&'static str],
    /// Version of its encoders.
    pub encoder_version: u32,
    extension: fn(&str) -> &str,
    write: fn(&(dyn Any + Send + Sync), &mut dyn Write) -> io::Result<()>,
    read: fn(&mut dyn Read) -> io::Result<Arc<dyn Any + Send + Sync>>,
    memory: fn(&(dyn Any + Send + Sync)) -> u64,
    save: fn(&(dyn Any + Send + Sync), &str, &Origin) -> Result<Saved, SaveError>,
}

impl ArtifactKind {
    /// The row of type `T`.
    pub fn of<T: Artifact>() -> Self {
        Self {
            name: T::TYPE,
            formats: T::FORMATS,
            encoder_version: T::ENCODER_VERSION,
            extension: T::extension,
            write: |value, out| typed::<T>(value).write(out),
            read: |input| Ok(Arc::new(T::read(input)?)),
            memory: |value| typed::<T>(value).memory(),
            save: |value, format, origin| typed::<T>(value).save(format, origin),
        }
    }

    /// The extension of a file in that format.
    pub fn extension<'f>(&self, format: &'f str) -> &'f str {
        (self.extension)(format)
    }

    /// Reads the canonical form.
    pub fn read(&self, input: &mut dyn Read) -> io::Result<AnyArtifact> {
        Ok(AnyArtifact { kind: *self, value: (self.read)(input)? })
    }
}

impl fmt::Debug for ArtifactKind {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "ArtifactKind({})", self.name)
    }
}

fn typed<T: Artifact>(value: &(dyn Any + Send + Sync)) -> &T {
    value.downcast_ref().expect("an artifact travels with the functions of its own type")
}

/// An artifact of any type; cloning shares the value.
#[derive(Clone)]
pub struct AnyArtifact {
    kind: ArtifactKind,
    value: Arc<dyn Any + Send + Sync>,
}

impl AnyArtifact {
    /// Takes a value in.
    pub fn new<T: Artifact>(value: T) -> Self {
        Self { kind: ArtifactKind::of::<T>(), value: Arc::new(value) }
    }

    /// Its type's name.
    pub fn type_name(&self) -> TypeName {
        self.kind.name
    }

    /// The value, if it is a `T`.
    pub fn get<T: Artifact>(&self) -> Option<Arc<T>> {
        self.value.clone().downcast().ok()
    }

    /// Writes the canonical form.
    pub fn write(&self, out: &mut dyn Write) -> io::Result<()> {
        (self.kind.write)(&*self.value, out)
    }

    /// Bytes it holds in memory.
    pub fn memory(&self) -> u64 {
        (self.kind.memory)(&*self.value)
    }

    /// Encodes it for a reader outside.
    pub fn save(&self, format: &str, origin: &Origin) -> Result<Saved, SaveError> {
        (self.kind.save)(&*self.value, format, origin)
    }
}

impl fmt::Debug for AnyArtifact {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "AnyArtifact({})", self.kind.name)
    }
}

//! What the store says of a result, and the sealed text that shows damage.

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::engine::digest::{Digest, bytes_from_hex, hex_from_bytes};

/// Version of the form of records; records of another version are passed over.
pub const RECORD_VERSION: u32 = 1;

/// Bytes by digest, held by the store or, where they are few, by the record itself.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Blob {
    /// SHA-256 of the bytes.
    pub digest: Digest,
    /// How many bytes.
    pub size: u64,
    /// The bytes, where they are few.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub inline: Option<Inline>,
}

/// Few bytes, written as hexadecimal digits.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Inline(pub Vec<u8>);

impl Serialize for Inline {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(&hex_from_bytes(&self.0))
    }
}

impl<'de> Deserialize<'de> for Inline {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = String::deserialize(deserializer)?;
        bytes_from_hex(&text).map(Self).ok_or_else(|| serde::de::Error::custom("not hexadecimal digits"))
    }
}

/// One result of a job.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct OutputRecord {
    /// Empty for the first result.
    pub name: String,
    /// Type of the artifact.
    #[serde(rename = "type")]
    pub type_name: String,
    /// Its canonical bytes.
    pub content: Blob,
}

/// The results of a job, by its key.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ResultRecord {
    /// See [`RECORD_VERSION`].
    pub schema: u32,
    /// The key; it stands inside too, so that exchanged records show.
    pub key: Digest,
    /// The results in the order of the kind's declaration.
    pub outputs: Vec<OutputRecord>,
    /// What the job wanted the reader of a manifest to know; part of the result.
    pub warnings: Vec<String>,
    /// What it cost, in seconds.
    pub seconds: f64,
    /// What it held in memory beside its inputs, in bytes, as its kind estimated.
    pub memory: u64,
    /// Version of the program that made it.
    pub program: String,
}

/// An encoded file, by [`crate::engine::key::publication_key`].
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct PublicationRecord {
    /// See [`RECORD_VERSION`].
    pub schema: u32,
    /// The key; it stands inside too, so that exchanged records show.
    pub key: Digest,
    /// The file's bytes.
    pub content: Blob,
    /// What the encoder wanted the reader to know.
    pub warnings: Vec<String>,
}

/// A record that knows its name.
pub trait Keyed: Serialize + DeserializeOwned {
    /// The name it stands under.
    fn key(&self) -> Digest;
    /// Version of its form.
    fn schema(&self) -> u32;
}

impl Keyed for ResultRecord {
    fn key(&self) -> Digest {
        self.key
    }

    fn schema(&self) -> u32 {
        self.schema
    }
}

impl Keyed for PublicationRecord {
    fn key(&self) -> Digest {
        self.key
    }

    fn schema(&self) -> u32 {
        self.schema
    }
}

/// A text under its own digest.
pub fn seal(text: &str) -> String {
    // In one piece of memory of the right size: notes may be long.
    [&Digest::of(text.as_bytes()).to_string(), "\n", text, "\n"].concat()
}

/// The text under a seal; `None` if they do not belong together.
pub fn unseal(sealed: &str) -> Option<&str> {
    let (digest, text) = sealed.split_once('\n')?;
    let text = text.strip_suffix('\n')?;
    (digest.parse() == Ok(Digest::of(text.as_bytes()))).then_some(text)
}

/// The same without a copy: notes may be long.
pub fn unsealed(mut sealed: String) -> Option<String> {
    let length = unseal(&sealed)?.len();
    sealed.truncate(sealed.len() - 1);
    sealed.drain(..sealed.len() - length);
    Some(sealed)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_seal_shows_every_damage() {
        let sealed = seal("{\"a\":1}");
        assert_eq!(unseal(&sealed), Some("{\"a\":1}"));
        assert_eq!(unsealed(sealed.clone()).as_deref(), unseal(&sealed));
        for index in 0..sealed.len() {
            let mut bytes = sealed.clone().into_bytes();
            bytes[index] ^= 1;
            assert_eq!(unseal(&String::from_utf8(bytes).unwrap()), None, "byte {index}");
        }
        assert_eq!(unseal(&sealed[..sealed.len() - 1]), None);
        assert_eq!(unseal(&format!("{sealed}x")), None);
        assert_eq!(unseal(""), None);
    }
}

//! Where a store elsewhere is, and how it is opened.

use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;

use super::folder::FolderStore;
use super::objects::Objects;
use super::signing::Keys;
use super::tiers::Far;
use crate::engine::system::SystemError;

/// A folder, or a bucket of a server that speaks S3.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Address {
    /// A folder that is there.
    Folder(PathBuf),
    /// `s3://BUCKET/PREFIX`.
    Bucket(String),
}

/// Text that names no store.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
#[error("a store is a folder, `file:///FOLDER` or `s3://BUCKET/PREFIX`")]
pub struct NoAddress;

impl FromStr for Address {
    type Err = NoAddress;

    fn from_str(text: &str) -> Result<Self, NoAddress> {
        match text.split_once("://") {
            Some(("s3", place)) if !place.starts_with('/') && !place.is_empty() => Ok(Address::Bucket(text.to_owned())),
            Some(("file", place)) if place.starts_with('/') => Ok(Address::Folder(place.into())),
            None if !text.is_empty() => Ok(Address::Folder(text.into())),
            _ => Err(NoAddress),
        }
    }
}

impl fmt::Display for Address {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Address::Folder(folder) => write!(out, "{}", folder.display()),
            Address::Bucket(url) => write!(out, "{url}"),
        }
    }
}

/// A store elsewhere, and how to use it.
#[derive(Debug, Clone)]
pub struct Remote {
    /// Where it is.
    pub address: Address,
    /// Whether nothing is to be written there, even if it could be.
    pub is_read_only: bool,
    /// Whose records are taken, and with what ours are signed.
    pub keys: Keys,
}

/// Why a store elsewhere is not used.
#[derive(Debug, thiserror::Error)]
pub enum Unusable {
    /// It is not there now, or cannot be reached.
    #[error(transparent)]
    Gone(SystemError),
    /// It must not be used so.
    #[error(transparent)]
    Refused(SystemError),
}

impl Remote {
    /// The store, if it may be used. Others may write to a folder only if that is said to be meant, or if records must be signed.
    pub fn open(&self, may_be_shared: bool) -> Result<Far, Unusable> {
        let (objects, may_write, is_quick): (Box<dyn Objects>, bool, bool) = match &self.address {
            Address::Folder(folder) => {
                let store = FolderStore::open_remote(folder).map_err(Unusable::Gone)?;
                if !may_be_shared && self.keys.trusted.is_none() {
                    store.refuse_strangers().map_err(Unusable::Refused)?;
                }
                let is_writable = store.is_writable();
                (Box::new(store), is_writable, true)
            }
            Address::Bucket(url) => {
                let (bucket, is_writable) = bucket(url)?;
                (bucket, is_writable, false)
            }
        };
        // Who takes only what is signed, and signs nothing, would put records there that no one who asks the same can take.
        let may_add = self.keys.signing.is_some() || self.keys.trusted.is_none();
        let is_writable = may_write && may_add && !self.is_read_only;
        Ok(Far { objects, name: self.address.to_string(), is_writable, is_quick, keys: self.keys.clone() })
    }
}

/// The bucket, and whether there are credentials to write to it.
#[cfg(feature = "s3")]
fn bucket(url: &str) -> Result<(Box<dyn Objects>, bool), Unusable> {
    let bucket = super::bucket::Bucket::open(url).map_err(Unusable::Refused)?;
    let is_writable = bucket.has_credentials();
    Ok((Box::new(bucket), is_writable))
}

/// The bucket, and whether there are credentials to write to it.
#[cfg(not(feature = "s3"))]
fn bucket(url: &str) -> Result<(Box<dyn Objects>, bool), Unusable> {
    let what = "this program was built without buckets; `cargo install` it with `--features s3`";
    Err(Unusable::Refused(SystemError::at("use", url)(std::io::Error::other(what))))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folders_and_buckets_are_told_apart() {
        assert_eq!("/mnt/store".parse(), Ok(Address::Folder("/mnt/store".into())));
        assert_eq!("file:///mnt/store".parse(), Ok(Address::Folder("/mnt/store".into())));
        assert_eq!("s3://bucket/prefix".parse(), Ok(Address::Bucket("s3://bucket/prefix".into())));
        for text in ["", "s3://", "s3:///x", "http://x/y", "file://x"] {
            assert_eq!(text.parse::<Address>(), Err(NoAddress), "{text}");
        }
    }
}

//! Stat signatures: when a file's digest may be taken from an earlier look at it.
//!
//! A signature is device, inode, size, time of modification and time of change. It is remembered only if,
//! when the content was hashed, both times lay so far back that a later write must get another time stamp:
//! two seconds, or 20 ms where the stamps show that the file system counts finer than milliseconds (kernels
//! stamp by their tick of 1 to 10 ms). Times alone never decide: size, inode and the time of change, which
//! no program can set, must agree too.

use std::collections::HashMap;
use std::fmt::Write as _;
use std::fs::{File, Metadata};
use std::hash::{Hash, Hasher};
use std::io;
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::path::Path;
use std::time::{SystemTime, UNIX_EPOCH};

use rustix::fs::{FileType, OFlags, Stat};
use serde::{Deserialize, Serialize};

use super::digest::Digest;
use super::store::library::Library;
use super::system::SystemError;

/// What the file system says of a file's identity and its last change.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(from = "SignatureFields", into = "SignatureFields")]
pub struct Signature {
    device: u64,
    inode: u64,
    size: u64,
    /// Nanoseconds since 1970.
    modified: i64,
    /// Nanoseconds since 1970.
    changed: i64,
}

impl Hash for Signature {
    /// What tells signatures apart where there are many.
    fn hash<H: Hasher>(&self, hasher: &mut H) {
        (self.inode, self.changed).hash(hasher);
    }
}

/// Device, inode, size, modified, changed.
type SignatureFields = (u64, u64, u64, i64, i64);

impl From<SignatureFields> for Signature {
    fn from((device, inode, size, modified, changed): SignatureFields) -> Self {
        Self { device, inode, size, modified, changed }
    }
}

impl From<Signature> for SignatureFields {
    fn from(signature: Signature) -> Self {
        let Signature { device, inode, size, modified, changed } = signature;
        (device, inode, size, modified, changed)
    }
}

/// A write this long after the stamp gets another stamp on any file system, in nanoseconds.
const COARSE_STEP: i64 = 2_000_000_000;
/// The same where stamps are finer than a millisecond.
const FINE_STEP: i64 = 20_000_000;

impl Signature {
    /// The signature in a file's status.
    pub fn of(status: &Metadata) -> Self {
        Self {
            device: status.dev(),
            inode: status.ino(),
            size: status.size(),
            modified: nanoseconds(status.mtime(), status.mtime_nsec()),
            changed: nanoseconds(status.ctime(), status.ctime_nsec()),
        }
    }

    /// Size of the file in bytes.
    pub fn size(&self) -> u64 {
        self.size
    }

    /// The signature of a regular file, as `fstatat` tells it.
    pub fn of_stat(status: &Stat) -> Option<Self> {
        (FileType::from_raw_mode(status.st_mode) == FileType::RegularFile).then(|| Self {
            device: status.st_dev,
            inode: status.st_ino,
            size: status.st_size as u64,
            modified: nanoseconds(status.st_mtime, status.st_mtime_nsec as i64),
            changed: nanoseconds(status.st_ctime, status.st_ctime_nsec as i64),
        })
    }

    /// Whether a write after the moment `now` must show in the signature.
    fn is_settled(&self, now: i64) -> bool {
        [self.modified, self.changed].into_iter().all(|stamp| {
            let step = if stamp % 1_000_000 == 0 { COARSE_STEP } else { FINE_STEP };
            now.saturating_sub(stamp) > step && stamp > i64::MIN
        })
    }
}

/// Reaches from 1678 to 2262; stamps beyond are taken for the nearest of these, and never count as settled.
fn nanoseconds(seconds: i64, fraction: i64) -> i64 {
    seconds.saturating_mul(1_000_000_000).saturating_add(fraction)
}

fn now() -> i64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |time| time.as_nanos().try_into().unwrap_or(i64::MAX))
}

/// Digest and size of a file's content.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Content {
    /// SHA-256 of all bytes.
    pub digest: Digest,
    /// How many bytes.
    pub size: u64,
}

impl Content {
    /// That of a file with these bytes.
    pub fn of(bytes: &[u8]) -> Self {
        Self { digest: Digest::of(bytes), size: bytes.len() as u64 }
    }
}

/// Digests by signature, from earlier runs and from this one.
#[derive(Debug, Default)]
pub struct Signatures {
    known: HashMap<Signature, Digest>,
    /// In the order of use in this run: what is kept when the file of signatures would grow too long.
    used: Vec<Signature>,
    has_news: bool,
}

/// Name of the note that keeps signatures from run to run.
const NOTE: &str = "signatures";

/// Length of most lines of that note, in bytes.
const LINE_LENGTH: usize = 128;

/// More signatures than this are not kept; the ones not used lately go first.
const KEPT_COUNT: usize = 200_000;

impl Signatures {
    /// Those that earlier runs have left in a store.
    pub fn kept_in(library: &Library) -> Self {
        library.note(NOTE).map(|text| Self::from_text(&text)).unwrap_or_default()
    }

    /// The same if they are sound; nothing is said or set aside if not.
    pub fn glance(library: &Library) -> Option<Self> {
        library.glance_at_note(NOTE).map(|text| Self::from_text(&text))
    }

    /// Leaves them in a store, if this run learnt something.
    pub fn keep_in(&self, library: &Library) -> Result<(), SystemError> {
        if self.has_news { library.keep_note(NOTE, &self.to_text()) } else { Ok(()) }
    }

    /// Reads back what [`Signatures::to_text`] wrote; lines of another form are passed over.
    pub fn from_text(text: &str) -> Self {
        Self { known: text.lines().filter_map(parse_line).collect(), ..Self::default() }
    }

    /// One line per signature; those used in this run first.
    pub fn to_text(&self) -> String {
        let used: std::collections::HashSet<_> = self.used.iter().collect();
        let mut others: Vec<_> = self.known.keys().filter(|signature| !used.contains(signature)).collect();
        others.sort_by_key(|signature| std::cmp::Reverse(signature.changed));
        let mut text = String::with_capacity(LINE_LENGTH * self.known.len());
        for signature in self.used.iter().chain(others).take(KEPT_COUNT) {
            let Signature { device, inode, size, modified, changed } = signature;
            if let Some(digest) = self.known.get(signature) {
                let _ = writeln!(text, "{device} {inode} {size} {modified} {changed} {digest}");
            }
        }
        text
    }

    /// Digest of an input file's content, hashed only if its signature is new.
    ///
    /// Links are followed: a person named this file. Fails on anything but a regular file, without waiting.
    pub fn content_of_input(&mut self, path: &Path) -> io::Result<Content> {
        // Without O_NONBLOCK, opening a pipe would wait for a writer for ever.
        let flags = OFlags::NONBLOCK.bits() as i32;
        self.content_of_file(File::options().read(true).custom_flags(flags).open(path)?)
    }

    /// Digest of an open file's content, hashed only if its signature is new.
    pub fn content_of_file(&mut self, mut file: File) -> io::Result<Content> {
        let status = file.metadata()?;
        if !status.is_file() {
            return Err(io::Error::new(io::ErrorKind::InvalidInput, "not a regular file"));
        }
        let before = Signature::of(&status);
        if let Some(digest) = self.known.get(&before) {
            self.used.push(before);
            return Ok(Content { digest: *digest, size: before.size });
        }

        let (digest, size) = Digest::of_reader(&mut file)?;
        let after = Signature::of(&file.metadata()?);
        if before == after {
            self.remember(after, digest);
        }
        Ok(Content { digest, size })
    }

    /// Digest by a signature that is known, without a look at the content.
    pub fn known_by(&mut self, signature: &Signature) -> Option<Digest> {
        let digest = *self.known.get(signature)?;
        self.used.push(*signature);
        Some(digest)
    }

    /// Notes the digest of a file whose content was written or hashed before `signature` was taken.
    pub fn remember(&mut self, signature: Signature, digest: Digest) {
        if signature.is_settled(now()) && self.known.insert(signature, digest) != Some(digest) {
            self.used.push(signature);
            self.has_news = true;
        }
    }
}

fn parse_line(line: &str) -> Option<(Signature, Digest)> {
    let mut words = line.split(' ');
    let signature = Signature {
        device: words.next()?.parse().ok()?,
        inode: words.next()?.parse().ok()?,
        size: words.next()?.parse().ok()?,
        modified: words.next()?.parse().ok()?,
        changed: words.next()?.parse().ok()?,
    };
    Some((signature, words.next()?.parse().ok()?))
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::time::Duration;

    use super::*;

    fn signature(modified: i64, changed: i64) -> Signature {
        Signature { device: 1, inode: 2, size: 3, modified, changed }
    }

    #[test]
    fn young_stamps_are_not_trusted() {
        let moment = 1_700_000_000_000_000_000;
        assert!(signature(moment, moment).is_settled(moment + 2_000_000_001));
        assert!(!signature(moment, moment).is_settled(moment + 1_900_000_000));
        // Stamps with digits below a millisecond: 20 ms are enough.
        assert!(signature(moment + 1, moment + 1).is_settled(moment + 21_000_000));
        assert!(!signature(moment + 1, moment + 1).is_settled(moment + 19_000_000));
        // A clock that was set back makes the stamp lie in the future.
        assert!(!signature(moment, moment + 10_000_000_000).is_settled(moment));
        assert!(!signature(moment, moment).is_settled(moment - 5_000_000_000));
    }

    #[test]
    fn a_file_of_the_same_size_and_time_but_other_content_is_noticed() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("input");
        let old = SystemTime::now() - Duration::from_secs(100);
        let write = |text: &str| {
            fs::write(&path, text).unwrap();
            File::options().write(true).open(&path).unwrap().set_modified(old).unwrap();
        };
        let mut signatures = Signatures::default();
        write("aaaa");
        assert_eq!(signatures.content_of_input(&path).unwrap().digest, Digest::of(b"aaaa"));
        write("bbbb");
        assert_eq!(signatures.content_of_input(&path).unwrap().digest, Digest::of(b"bbbb"));
    }

    #[test]
    fn signatures_survive_as_text() {
        let mut signatures = Signatures::default();
        signatures.remember(signature(5, 7), Digest::of(b"x"));
        assert!(signatures.has_news);
        let mut again = Signatures::from_text(&format!("nonsense\n{}", signatures.to_text()));
        assert_eq!(again.known, signatures.known);
        again.remember(signature(5, 7), Digest::of(b"x"));
        assert!(!again.has_news);
    }

    #[test]
    fn a_folder_is_no_input_file() {
        let folder = tempfile::tempdir().unwrap();
        assert!(Signatures::default().content_of_input(folder.path()).is_err());
    }
}

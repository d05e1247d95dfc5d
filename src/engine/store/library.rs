//! Reads and writes blobs and records, and trusts nothing that it reads.
//!
//! Every byte that leaves the library was hashed on the way. What is wrong, short, long or no plain file is
//! set aside and reported as lost, never as an error: the caller computes it again. Whatever was found damaged, or gone
//! although a record names it, is noted for the reader of the run ([`Library::take_notices`]).

use std::io::{self, BufWriter, Read, Write};
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex};

use rustix::io::Errno;

use super::claims::Claims;
use super::objects::{Draft, Objects, Shelf, drafted};
use super::record::{Blob, Inline, Keyed, PublicationRecord, RECORD_VERSION, ResultRecord, seal, unseal, unsealed};
use super::signing::split;
use crate::engine::artifact::{AnyArtifact, ArtifactKind};
use crate::engine::digest::{Digest, HashingReader, HashingWriter, READ_SIZE};
use crate::engine::lines::line;
use crate::engine::system::SystemError;

/// Results of fewer bytes stand in their record.
pub const INLINE_LIMIT: u64 = 4096;

/// No record is longer; a longer file is damage.
pub const RECORD_LIMIT: u64 = 64 << 20;

/// No note is longer; a longer file is damage.
pub const NOTE_LIMIT: u64 = 1 << 30;

/// Why the store cannot give what it should have.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Lost {
    /// Nothing stands under the name.
    Missing,
    /// What stood there was wrong and has been set aside.
    Damaged(String),
}

impl Lost {
    /// In the words of a plan.
    pub fn reason(&self) -> &'static str {
        match self {
            Lost::Missing => "result missing",
            Lost::Damaged(_) => "damaged",
        }
    }
}

/// Why a blob was not copied.
#[derive(Debug)]
pub enum CopyError {
    /// The store could not give it.
    Lost(Lost),
    /// The target could not take it.
    Target(io::Error),
}

/// Blobs and records over any store of objects.
pub struct Library {
    objects: Arc<dyn Objects>,
    notices: Mutex<Vec<String>>,
}

impl Library {
    /// The library whose objects these are.
    pub fn new(objects: Arc<dyn Objects>) -> Self {
        Self { objects, notices: Mutex::default() }
    }

    /// The record of a result.
    pub fn result(&self, key: &Digest) -> Result<ResultRecord, Lost> {
        self.record(Shelf::Results, key)
    }

    /// The record of an encoded file.
    pub fn publication(&self, key: &Digest) -> Result<PublicationRecord, Lost> {
        self.record(Shelf::Publications, key)
    }

    /// The record of a result that must be there, because a job was settled by it.
    pub fn expected_result(&self, key: &Digest) -> Result<ResultRecord, Lost> {
        self.result(key).inspect_err(|lost| self.notice_missing(lost, Shelf::Results, key))
    }

    /// The record of an encoded file that must be there.
    pub fn expected_publication(&self, key: &Digest) -> Result<PublicationRecord, Lost> {
        self.publication(key).inspect_err(|lost| self.notice_missing(lost, Shelf::Publications, key))
    }

    /// Whether a record of a result stands under the key, good or bad.
    pub fn may_have_result(&self, key: &Digest) -> bool {
        self.objects.has(Shelf::Results, &key.to_string())
    }

    /// Who is computing what.
    pub fn claims(&self) -> Claims {
        self.objects.claims().expect("the store of a run is a folder, or has one in front of it")
    }

    /// Makes the store, if there is none yet, so that claims can be made in it before the first result.
    pub fn prepare(&self) -> Result<(), SystemError> {
        self.objects.draft().map(drop)
    }

    /// Clears what dead processes left.
    pub fn tidy(&self) {
        self.objects.tidy();
    }

    /// What was found damaged or missing so far, for the reader; once.
    pub fn take_notices(&self) -> Vec<String> {
        let mut notices = std::mem::take(&mut *self.notices.lock().expect(NO_PANIC));
        notices.extend(self.objects.take_notices());
        notices
    }

    /// Brings near what is going to be asked for, if there is a store to bring it from.
    pub fn fetch(&self, shelf: Shelf, keys: impl IntoIterator<Item = Digest>) {
        if !self.objects.has_far_objects() {
            return;
        }
        let wanted: Vec<_> = keys.into_iter().map(|key| (shelf, key.to_string())).collect();
        self.objects.fetch(&wanted);
    }

    /// See [`Objects::share`].
    pub fn share(&self, records: &[(Shelf, String)], is_hurried: &AtomicBool) {
        self.objects.share(records, is_hurried);
    }

    /// Notes something for the reader of the run.
    pub fn notice(&self, text: String) {
        self.notices.lock().expect(NO_PANIC).push(text);
    }

    fn notice_missing(&self, lost: &Lost, shelf: Shelf, digest: &Digest) {
        if *lost == Lost::Missing {
            self.notice(format!("the store has lost the {} `{digest}`, which is made again", shelf.noun()));
        }
    }

    /// Whether there is any result at all.
    pub fn has_results(&self) -> bool {
        self.objects.has_any(Shelf::Results)
    }

    fn record<T: Keyed>(&self, shelf: Shelf, key: &Digest) -> Result<T, Lost> {
        let name = key.to_string();
        let record: T = match self.text(shelf, &name, RECORD_LIMIT).map(|text| parse_record(&text)) {
            Ok(Some(record)) => record,
            Ok(None) => return Err(self.damaged(shelf, &name, DISAGREES)),
            Err(error) => return Err(self.lost(shelf, &name, &error)),
        };
        if record.schema() != RECORD_VERSION {
            return Err(Lost::Missing);
        }
        if record.key() != *key {
            return Err(self.damaged(shelf, &name, "it stands under another's name"));
        }
        Ok(record)
    }

    fn text(&self, shelf: Shelf, name: &str, limit: u64) -> io::Result<String> {
        let mut text = String::new();
        self.objects.open(shelf, name)?.take(limit).read_to_string(&mut text)?;
        Ok(text)
    }

    /// Writes a record, in place of an earlier one.
    pub fn keep_record(&self, shelf: Shelf, record: &impl Keyed) -> Result<(), SystemError> {
        self.keep_text(shelf, &record.key().to_string(), &seal(&line(record)))
    }

    /// A cache by its name; `None` if it is not there or damaged, which is the same to its reader.
    pub fn note(&self, name: &str) -> Option<String> {
        self.checked_note(name).ok()
    }

    /// A cache by its name.
    pub fn checked_note(&self, name: &str) -> Result<String, Lost> {
        let text = self.text(Shelf::Notes, name, NOTE_LIMIT).map_err(|error| self.lost(Shelf::Notes, name, &error))?;
        unsealed(text).ok_or_else(|| self.damaged(Shelf::Notes, name, DISAGREES))
    }

    /// Whether a run that was sent here is as it was sent.
    pub fn verify_run(&self, name: &str) -> Result<(), Lost> {
        let text = self.text(Shelf::Runs, name, NOTE_LIMIT).map_err(|error| self.lost(Shelf::Runs, name, &error))?;
        unseal(split(&text).0).map(drop).ok_or_else(|| self.damaged(Shelf::Runs, name, DISAGREES))
    }

    /// Hashes all of a blob, of whatever size it is.
    pub fn verify_blob(&self, digest: &Digest) -> Result<(), Lost> {
        let name = digest.to_string();
        let reader = self.objects.open(Shelf::Blobs, &name).map_err(|error| self.lost(Shelf::Blobs, &name, &error))?;
        match Digest::of_reader(reader) {
            Ok((found, _)) if found == *digest => Ok(()),
            Ok(_) => Err(self.damaged(Shelf::Blobs, &name, DISAGREES)),
            Err(error) => Err(self.unreadable(Shelf::Blobs, &name, &error)),
        }
    }

    /// A cache, if it is sound; nothing is said or set aside if not.
    pub fn glance_at_note(&self, name: &str) -> Option<String> {
        unsealed(self.text(Shelf::Notes, name, NOTE_LIMIT).ok()?)
    }

    /// The record of a result, if it is sound; nothing is said or set aside if not.
    pub fn glance_at_result(&self, key: &Digest) -> Option<ResultRecord> {
        parse_record(&self.text(Shelf::Results, &key.to_string(), RECORD_LIMIT).ok()?)
    }

    /// The same of an encoded file.
    pub fn glance_at_publication(&self, key: &Digest) -> Option<PublicationRecord> {
        parse_record(&self.text(Shelf::Publications, &key.to_string(), RECORD_LIMIT).ok()?)
    }

    /// Takes an object out of use.
    pub fn set_aside(&self, shelf: Shelf, name: &str) {
        self.objects.set_aside(shelf, name);
    }

    /// Writes a cache, in place of an earlier one.
    pub fn keep_note(&self, name: &str, text: &str) -> Result<(), SystemError> {
        self.keep_text(Shelf::Notes, name, &seal(text))
    }

    fn keep_text(&self, shelf: Shelf, name: &str, text: &str) -> Result<(), SystemError> {
        drafted(&*self.objects, text.as_bytes())?.keep(shelf, name)
    }

    /// Makes blobs durable.
    pub fn make_durable(&self, blobs: &[Digest]) -> Result<(), SystemError> {
        let objects: Vec<_> = blobs.iter().map(|digest| (Shelf::Blobs, digest.to_string())).collect();
        self.objects.make_durable(&objects)
    }

    /// Writes an artifact's canonical bytes, hashing them on the way.
    pub fn write_artifact(&self, artifact: &AnyArtifact) -> Result<Blob, SystemError> {
        self.write(|out| artifact.write(out))
    }

    /// Writes bytes.
    pub fn write_bytes(&self, bytes: &[u8]) -> Result<Blob, SystemError> {
        self.write(|out| out.write_all(bytes))
    }

    fn write(&self, content: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> Result<Blob, SystemError> {
        let mut spill = Spill { objects: &*self.objects, few: Vec::new(), draft: None, fault: None };
        let mut out = BufWriter::with_capacity(READ_SIZE, HashingWriter::new(&mut spill));
        let written = content(&mut out).and_then(|()| out.flush());
        let (hashing, _) = out.into_parts();
        let (digest, size) = hashing.finish();
        let Spill { few, draft, fault, .. } = spill;

        if let Some(fault) = fault {
            return Err(fault);
        }
        let path = draft.as_ref().map(|draft| draft.path()).unwrap_or_default();
        written.map_err(SystemError::at("write", path))?;
        let inline = match draft {
            Some(draft) => draft.keep(Shelf::Blobs, &digest.to_string()).map(|()| None)?,
            None => Some(Inline(few)),
        };
        Ok(Blob { digest, size, inline })
    }

    /// Reads an artifact, verified.
    pub fn read_artifact(&self, kind: &ArtifactKind, blob: &Blob) -> Result<AnyArtifact, Lost> {
        let mut reader = HashingReader::new(self.open(blob)?);
        let read = kind.read(&mut reader).and_then(|artifact| {
            // What an artifact leaves unread is hashed too, and makes the blob longer than it should be.
            io::copy(&mut reader, &mut io::sink())?;
            Ok(artifact)
        });
        match read {
            Ok(artifact) if reader.finish() == (blob.digest, blob.size) => Ok(artifact),
            Ok(_) => Err(self.damaged_blob(blob, DISAGREES)),
            // An artifact that cannot be read from these bytes: they are not what was written.
            Err(error) if is_of_the_object(&error) => Err(self.damaged_blob(blob, &error.to_string())),
            Err(error) => Err(self.unreadable(Shelf::Blobs, &blob.digest.to_string(), &error)),
        }
    }

    /// Copies a blob's bytes, verified: on an error what was written so far must not be used.
    pub fn copy_blob(&self, blob: &Blob, out: &mut dyn Write) -> Result<(), CopyError> {
        match copied(self.open(blob).map_err(CopyError::Lost)?, blob, out).map_err(CopyError::Target)? {
            Ok(true) => Ok(()),
            Ok(false) => Err(CopyError::Lost(self.damaged_blob(blob, DISAGREES))),
            Err(error) => Err(CopyError::Lost(self.unreadable(Shelf::Blobs, &blob.digest.to_string(), &error))),
        }
    }

    /// The same if the bytes are sound; false, with nothing said or set aside, if not. The error is the target's.
    pub fn glance_at_blob(&self, blob: &Blob, out: &mut dyn Write) -> io::Result<bool> {
        let copied = match &blob.inline {
            Some(inline) => copied(inline.0.as_slice(), blob, out)?,
            None => match self.objects.open(Shelf::Blobs, &blob.digest.to_string()) {
                Ok(reader) => copied(reader.take(blob.size.saturating_add(1)), blob, out)?,
                Err(_) => return Ok(false),
            },
        };
        Ok(copied.unwrap_or(false))
    }

    fn open<'b>(&self, blob: &'b Blob) -> Result<Box<dyn Read + 'b>, Lost> {
        if let Some(inline) = &blob.inline {
            return Ok(Box::new(inline.0.as_slice()));
        }
        let name = blob.digest.to_string();
        match self.objects.open(Shelf::Blobs, &name) {
            // One byte more than there should be is enough to see that it is too long.
            Ok(reader) => Ok(Box::new(reader.take(blob.size.saturating_add(1)))),
            Err(error) => {
                Err(self.lost(Shelf::Blobs, &name, &error)).inspect_err(|lost| self.notice_missing(lost, Shelf::Blobs, &blob.digest))
            }
        }
    }

    fn damaged_blob(&self, blob: &Blob, what: &str) -> Lost {
        match blob.inline {
            // The record that holds the bytes agrees with its digest, and yet they do not: it was made so.
            Some(_) => self.noticed(format!("blob `{}`: {what}", blob.digest)),
            None => self.damaged(Shelf::Blobs, &blob.digest.to_string(), what),
        }
    }

    fn damaged(&self, shelf: Shelf, name: &str, what: &str) -> Lost {
        let moved = self.objects.set_aside(shelf, name);
        let place = moved.map(|path| format!(" (kept as `{}`)", path.display())).unwrap_or_default();
        self.noticed(format!("{} `{name}`: {what}{place}", shelf.noun()))
    }

    fn unreadable(&self, shelf: Shelf, name: &str, error: &io::Error) -> Lost {
        self.noticed(format!("{} `{name}` cannot be read: {error}", shelf.noun()))
    }

    fn noticed(&self, what: String) -> Lost {
        self.notice(format!("the store was damaged and is repaired: {what}"));
        Lost::Damaged(what)
    }

    fn lost(&self, shelf: Shelf, name: &str, error: &io::Error) -> Lost {
        match error.kind() {
            io::ErrorKind::NotFound => Lost::Missing,
            _ if is_of_the_object(error) => self.damaged(shelf, name, &error.to_string()),
            // Too many open files, a disk that does not answer: says nothing of the object.
            _ => self.unreadable(shelf, name, error),
        }
    }
}

pub(super) const DISAGREES: &str = "its bytes do not agree with its digest";
const NO_PANIC: &str = "no one panics while noting a loss";

/// Whether an error comes from what stands in the store rather than from the system's state.
fn is_of_the_object(error: &io::Error) -> bool {
    use io::ErrorKind::{InvalidData, InvalidInput, IsADirectory, NotADirectory, Other, PermissionDenied, UnexpectedEof};
    let is_odd = [Errno::LOOP, Errno::NXIO].iter().any(|odd| error.raw_os_error() == Some(odd.raw_os_error()));
    is_odd || matches!(error.kind(), InvalidData | InvalidInput | IsADirectory | NotADirectory | Other | PermissionDenied | UnexpectedEof)
}

/// Copies the bytes of a blob: whether they are its bytes, or why they cannot be read. The outer error is the target's.
fn copied(reader: impl Read, blob: &Blob, out: &mut dyn Write) -> io::Result<io::Result<bool>> {
    let mut reader = HashingReader::new(reader);
    let mut buffer = vec![0; READ_SIZE.min(blob.size.saturating_add(1) as usize)];
    loop {
        match reader.read(&mut buffer) {
            Ok(0) => return Ok(Ok(reader.finish() == (blob.digest, blob.size))),
            Ok(count) => out.write_all(&buffer[..count])?,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Ok(Err(error)),
        }
    }
}

/// A record, whoever has signed it: who may write here is trusted.
fn parse_record<T: Keyed>(text: &str) -> Option<T> {
    serde_json::from_str(unseal(split(text).0)?).ok()
}

/// Takes bytes into memory while they are few, and into a draft from then on.
struct Spill<'a> {
    objects: &'a dyn Objects,
    few: Vec<u8>,
    draft: Option<Box<dyn Draft>>,
    fault: Option<SystemError>,
}

impl Write for Spill<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if self.draft.is_none() {
            if ((self.few.len() + bytes.len()) as u64) < INLINE_LIMIT {
                self.few.extend_from_slice(bytes);
                return Ok(bytes.len());
            }
            self.begin_draft()?;
        }
        let draft = self.draft.as_mut().expect("it was begun above");
        draft.write_all(bytes)?;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        self.draft.as_mut().map_or(Ok(()), |draft| draft.flush())
    }
}

impl Spill<'_> {
    fn begin_draft(&mut self) -> io::Result<()> {
        let mut draft = self.objects.draft().map_err(|fault| {
            self.fault = Some(fault);
            io::Error::other("no draft")
        })?;
        draft.write_all(&std::mem::take(&mut self.few))?;
        self.draft = Some(draft);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::path::{Path, PathBuf};

    use super::*;
    use crate::engine::artifact::Artifact;
    use crate::engine::store::folder::FolderStore;
    use crate::engine::trial::Text;

    fn library(folder: &Path) -> Library {
        Library::new(Arc::new(FolderStore::at(folder)))
    }

    fn long_text() -> AnyArtifact {
        AnyArtifact::new(Text("long ".repeat(2000)))
    }

    fn blob_path(folder: &Path, blob: &Blob) -> PathBuf {
        let name = blob.digest.to_string();
        folder.join("v1/cas").join(&name[..2]).join(name)
    }

    fn read(library: &Library, blob: &Blob) -> Result<String, Lost> {
        let artifact = library.read_artifact(&ArtifactKind::of::<Text>(), blob)?;
        Ok(artifact.get::<Text>().unwrap().0.clone())
    }

    #[test]
    fn artifacts_come_back_from_a_blob_or_inline() {
        let folder = tempfile::tempdir().unwrap();
        let library = library(folder.path());
        let long = library.write_artifact(&long_text()).unwrap();
        assert!(long.inline.is_none() && blob_path(folder.path(), &long).is_file());
        assert_eq!(read(&library, &long).unwrap(), "long ".repeat(2000));

        let short = library.write_artifact(&AnyArtifact::new(Text("short".into()))).unwrap();
        assert!(short.inline.is_some());
        assert_eq!(read(&library, &short).unwrap(), "short");
        let mut bytes = Vec::new();
        Text("short".into()).write(&mut bytes).unwrap();
        assert_eq!(short.digest, Digest::of(&bytes));
    }

    #[test]
    fn every_kind_of_damage_is_noticed_and_set_aside() {
        let folder = tempfile::tempdir().unwrap();
        let library = library(folder.path());
        let blob = library.write_artifact(&long_text()).unwrap();
        let path = blob_path(folder.path(), &blob);
        let whole = fs::read(&path).unwrap();

        let flipped = |index: usize| {
            let mut bytes = whole.clone();
            bytes[index] ^= 0x40;
            bytes
        };
        let longer = [whole.as_slice(), b"x"].concat();
        let cases = [vec![], whole[..100].to_vec(), longer, flipped(0), flipped(5), flipped(whole.len() - 1), vec![0; whole.len()]];
        for bytes in cases {
            fs::write(&path, bytes).unwrap();
            assert!(matches!(read(&library, &blob), Err(Lost::Damaged(_))));
            assert!(!path.exists(), "set aside");
            library.write_artifact(&long_text()).unwrap();
            assert!(read(&library, &blob).is_ok(), "healed");

            fs::write(&path, flipped(7)).unwrap();
            assert!(matches!(library.copy_blob(&blob, &mut Vec::new()), Err(CopyError::Lost(Lost::Damaged(_)))));
            library.write_artifact(&long_text()).unwrap();
        }
        fs::remove_file(&path).unwrap();
        assert_eq!(read(&library, &blob), Err(Lost::Missing));
    }

    #[test]
    fn exchanged_and_damaged_records_are_noticed() {
        let folder = tempfile::tempdir().unwrap();
        let library = library(folder.path());
        let keys = [Digest::of(b"a"), Digest::of(b"b")];
        let record = |key| ResultRecord {
            schema: RECORD_VERSION,
            key,
            outputs: vec![],
            warnings: vec!["w".into()],
            seconds: 0.1,
            memory: 0,
            program: "0".into(),
        };
        let path = |key: Digest| folder.path().join("v1/ac").join(&key.to_string()[..2]).join(key.to_string());
        assert_eq!(library.result(&keys[0]), Err(Lost::Missing));
        for key in keys {
            library.keep_record(Shelf::Results, &record(key)).unwrap();
            assert_eq!(library.result(&key), Ok(record(key)));
        }
        fs::copy(path(keys[0]), path(keys[1])).unwrap();
        assert!(matches!(library.result(&keys[1]), Err(Lost::Damaged(_))));
        assert_eq!(library.result(&keys[1]), Err(Lost::Missing), "set aside");
        fs::write(path(keys[0]), [0xff; 10]).unwrap();
        assert!(matches!(library.result(&keys[0]), Err(Lost::Damaged(_))));
    }

    #[test]
    fn a_damaged_note_is_no_note() {
        let folder = tempfile::tempdir().unwrap();
        let library = library(folder.path());
        assert_eq!(library.note("n"), None);
        library.keep_note("n", "text").unwrap();
        assert_eq!(library.note("n").as_deref(), Some("text"));
        fs::write(folder.path().join("v1/notes/n"), "text").unwrap();
        assert_eq!(library.note("n"), None);
    }
}

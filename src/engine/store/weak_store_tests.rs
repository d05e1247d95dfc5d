//! Far stores that break what stores are thought to promise: a miss or a repetition, never a wrong result.

use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use super::folder::FolderStore;
use super::library::{Library, Lost};
use super::objects::{Draft, Objects, Shelf};
use super::record::{OutputRecord, RECORD_VERSION, ResultRecord};
use super::signing::Keys;
use super::tiers::{Far, Tiers};
use crate::engine::artifact::{AnyArtifact, ArtifactKind};
use crate::engine::digest::Digest;
use crate::engine::system::SystemError;
use crate::engine::trial::Text;

/// How a store is weak.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Weakness {
    /// None.
    Sound,
    /// What was written is not seen.
    Lags,
    /// The condition of `keep_new` is ignored.
    IgnoresConditions,
    /// `keep_new` is refused where nothing stands (412), as after a repeated call.
    AlwaysExists,
    /// The call succeeds, and the answer is lost.
    TimesOutAfterSuccess,
    /// Reading ends early without an error.
    ReadsShort,
    /// Nothing is answered (503).
    IsUnavailable,
    /// Nothing is allowed (403).
    IsForbidden,
    /// The names of objects are mixed up.
    GivesAnother,
}

use Weakness::*;

const ALL: [Weakness; 9] =
    [Sound, Lags, IgnoresConditions, AlwaysExists, TimesOutAfterSuccess, ReadsShort, IsUnavailable, IsForbidden, GivesAnother];

struct Weak {
    inner: FolderStore,
    weakness: Weakness,
}

impl Weak {
    fn refusal(&self) -> io::Result<()> {
        match self.weakness {
            IsUnavailable => Err(io::Error::other("503 Slow Down")),
            IsForbidden => Err(io::ErrorKind::PermissionDenied.into()),
            _ => Ok(()),
        }
    }
}

impl Objects for Weak {
    fn open(&self, shelf: Shelf, name: &str) -> io::Result<Box<dyn Read + Send>> {
        self.refusal()?;
        match self.weakness {
            Lags => Err(io::ErrorKind::NotFound.into()),
            ReadsShort => Ok(Box::new(self.inner.open(shelf, name)?.take(100))),
            GivesAnother => {
                let mut names = self.inner.names(shelf, 10)?;
                names.retain(|other| other != name);
                self.inner.open(shelf, names.first().map_or(name, |other| other.as_str()))
            }
            _ => self.inner.open(shelf, name),
        }
    }

    fn has(&self, shelf: Shelf, name: &str) -> bool {
        self.refusal().is_ok() && self.weakness != Lags && self.inner.has(shelf, name)
    }

    fn length(&self, shelf: Shelf, name: &str) -> Option<u64> {
        self.has(shelf, name).then(|| self.inner.length(shelf, name)).flatten()
    }

    fn draft(&self) -> Result<Box<dyn Draft>, SystemError> {
        self.refusal().map_err(SystemError::at("write", "far"))?;
        Ok(Box::new(WeakDraft { inner: self.inner.draft()?, weakness: self.weakness }))
    }

    fn remove(&self, shelf: Shelf, name: &str) -> io::Result<()> {
        self.inner.remove(shelf, name)
    }

    fn set_aside(&self, _shelf: Shelf, _name: &str) -> Option<PathBuf> {
        panic!("nothing is set aside in another's store")
    }

    fn make_durable(&self, _objects: &[(Shelf, String)]) -> Result<(), SystemError> {
        Ok(())
    }

    fn names(&self, shelf: Shelf, limit: usize) -> io::Result<Vec<String>> {
        self.refusal()?;
        if self.weakness == Lags { Ok(Vec::new()) } else { self.inner.names(shelf, limit) }
    }

    fn has_any(&self, shelf: Shelf) -> bool {
        self.names(shelf, 1).is_ok_and(|names| !names.is_empty())
    }

    fn tidy(&self) {}
}

struct WeakDraft {
    inner: Box<dyn Draft>,
    weakness: Weakness,
}

impl Write for WeakDraft {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.inner.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.inner.flush()
    }
}

impl Draft for WeakDraft {
    fn keep(self: Box<Self>, shelf: Shelf, name: &str) -> Result<(), SystemError> {
        self.inner.keep(shelf, name)?;
        match self.weakness {
            TimesOutAfterSuccess => Err(SystemError::at("write", "far")(io::ErrorKind::TimedOut.into())),
            _ => Ok(()),
        }
    }

    fn keep_new(self: Box<Self>, shelf: Shelf, name: &str) -> Result<bool, SystemError> {
        match self.weakness {
            AlwaysExists => Ok(false),
            IgnoresConditions => self.keep(shelf, name).map(|()| true),
            TimesOutAfterSuccess => {
                self.inner.keep_new(shelf, name)?;
                Err(SystemError::at("write", "far")(io::ErrorKind::TimedOut.into()))
            }
            _ => self.inner.keep_new(shelf, name),
        }
    }

    fn path(&self) -> PathBuf {
        self.inner.path()
    }
}

/// A machine with nothing but a far store.
fn machine(near: &Path, far: &Path, weakness: Weakness, is_quick: bool) -> Library {
    let far = Far {
        objects: Box::new(Weak { inner: FolderStore::at(far), weakness }),
        name: "far".into(),
        is_writable: true,
        is_quick,
        keys: Keys::default(),
    };
    Library::new(Arc::new(Tiers::new(FolderStore::at(near), far)))
}

fn key(index: u8) -> Digest {
    Digest::of(&[index])
}

fn text(index: u8) -> String {
    format!("{index} long ").repeat(1000)
}

fn compute(library: &Library, index: u8) {
    let content = library.write_artifact(&AnyArtifact::new(Text(text(index)))).unwrap();
    let outputs = vec![OutputRecord { name: String::new(), type_name: "text".into(), content }];
    let record =
        ResultRecord { schema: RECORD_VERSION, key: key(index), outputs, warnings: vec![], seconds: 0.0, memory: 0, program: "0".into() };
    library.keep_record(Shelf::Results, &record).unwrap();
    library.share(&[(Shelf::Results, key(index).to_string())], &AtomicBool::new(false));
}

/// The result, computed if it must be; whether it had to be.
fn want(library: &Library, index: u8) -> bool {
    let read = || {
        let record = library.result(&key(index))?;
        library.read_artifact(&ArtifactKind::of::<Text>(), &record.outputs[0].content)
    };
    let found = match read() {
        Ok(found) => found,
        Err(Lost::Damaged(what)) => panic!("what is wrong afar is passed over: {what}"),
        Err(Lost::Missing) => {
            compute(library, index);
            assert_eq!(read().unwrap().get::<Text>().unwrap().0, text(index));
            return true;
        }
    };
    assert_eq!(found.get::<Text>().unwrap().0, text(index));
    false
}

#[test]
fn no_weakness_of_a_far_store_gives_a_wrong_result() {
    for weakness in ALL {
        for (is_filled, is_quick) in [(false, true), (true, true), (true, false)] {
            let place = format!("{weakness:?}, filled: {is_filled}, quick: {is_quick}");
            let [one, two, three, four, far] = std::array::from_fn(|_| tempfile::tempdir().unwrap());
            if is_filled {
                let before = machine(one.path(), far.path(), Sound, true);
                (0..3).for_each(|index| assert!(want(&before, index)));
            }
            let weak = machine(two.path(), far.path(), weakness, is_quick);
            weak.fetch(Shelf::Results, (0..3).map(key));
            let computed = (0..3).filter(|index| want(&weak, *index)).count();
            let can_read = matches!(weakness, Sound | IgnoresConditions | AlwaysExists | TimesOutAfterSuccess);
            assert_eq!(computed, if is_filled && can_read { 0 } else { 3 }, "{place}");
            let notices = weak.take_notices();
            let is_told = matches!(weakness, ReadsShort | IsUnavailable | IsForbidden | GivesAnother);
            assert!(!is_told || (is_quick && !is_filled) || !notices.is_empty(), "{place}: {notices:?}");
            assert!(notices.len() <= 4, "{place}: {notices:?}");

            // Whatever it left there is right for those who come after, and is made whole by them.
            let after = machine(three.path(), far.path(), Sound, true);
            for index in 0..3 {
                let _ = want(&after, index);
            }
            let last = machine(four.path(), far.path(), Sound, true);
            assert!((0..3).all(|index| !want(&last, index)), "{place}: not healed");
            assert_eq!(last.take_notices(), Vec::<String>::new(), "{place}");
        }
    }
}

#[test]
fn another_result_for_the_same_job_is_told_and_left() {
    let [one, two, three, far] = std::array::from_fn(|_| tempfile::tempdir().unwrap());
    want(&machine(one.path(), far.path(), Sound, true), 1);
    let other = machine(two.path(), far.path(), Lags, true);
    assert!(want(&other, 1));
    let noisy = Library::new(Arc::new(FolderStore::at(two.path())));
    let content = noisy.write_bytes(&[9; 9000]).unwrap();
    let mut record = noisy.result(&key(1)).unwrap();
    record.outputs[0].content = content;
    noisy.keep_record(Shelf::Results, &record).unwrap();
    let sound = machine(two.path(), far.path(), Sound, true);
    sound.share(&[(Shelf::Results, key(1).to_string())], &AtomicBool::new(false));
    let notices = sound.take_notices();
    assert!(notices.len() == 1 && notices[0].contains("not deterministic"), "{notices:?}");
    assert!(!want(&machine(three.path(), far.path(), Sound, true), 1), "the first stays");
}

#[test]
fn sending_ends_soon_after_it_is_hurried_and_says_what_was_not_sent() {
    let [one, far] = std::array::from_fn(|_| tempfile::tempdir().unwrap());
    let library = machine(one.path(), far.path(), Sound, true);
    compute(&library, 1);
    let hurried = AtomicBool::new(true);
    let records: Vec<_> = (0..1000).map(|_| (Shelf::Results, key(1).to_string())).collect();
    library.share(&records, &hurried);
    let notices = library.take_notices();
    assert!(notices.is_empty() || notices[0].contains("not sent"), "{notices:?}");
}

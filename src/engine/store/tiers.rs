//! A private store in front of one that is elsewhere: read through, written through.
//!
//! What is asked for is looked for near, then far. What comes from afar is hashed, and a record's signature is checked,
//! before it is here; what is wrong there is passed over like what is missing. A record is kept near only once all its
//! blobs are, so that the near store is whole by itself. What is made here goes to the far store in groups, behind the
//! jobs' back.
//!
//! Nothing that the far store does is an error of a run. A call that fails is made once more; where it fails again, what it was for is
//! missing, or is not sent. After [`PATIENCE`] such calls the far store is left alone. Of all of it the reader of the run is told once.

use std::collections::{HashMap, HashSet};
use std::io::{self, Cursor, Read};
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::channel;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use super::claims::Claims;
use super::folder::FolderStore;
use super::objects::{Draft, Objects, Shelf, drafted};
use super::signing::Keys;
use super::transfer::{Carried, Fault, SoundRecord, Way, read_record};
use crate::engine::system::SystemError;

/// After so many calls that failed, each of them twice, the far store is left alone.
const PATIENCE: u32 = 5;

/// Time between a call that failed and its repetition.
const PAUSE: Duration = Duration::from_millis(20);

/// To look for more than so many, a store where each look takes its time is asked for all names it has.
const MANY: usize = 64;

/// If there are more names than this, one by one is less work.
const CENSUS_LIMIT: usize = 200_000;

/// So long it is believed that what was not there is not there: what others have sent since is computed once more.
const CENSUS_AGE: Duration = Duration::from_secs(600);

/// Time between two looks whether sending is to end.
const LOOK: Duration = Duration::from_millis(20);

/// A store elsewhere, and how it is used.
pub struct Far {
    /// What stands there.
    pub objects: Box<dyn Objects>,
    /// Its name in messages.
    pub name: String,
    /// Whether this process may write there.
    pub is_writable: bool,
    /// Whether looking for one object there takes so little that it can be done for every job that begins.
    pub is_quick: bool,
    /// With what records are signed, and whose are taken.
    pub keys: Keys,
}

impl Far {
    /// The way from there to a store of this machine.
    pub fn way_here<'a>(&'a self, near: &'a FolderStore, stop: &'a AtomicBool) -> Way<'a> {
        Way { from: &*self.objects, from_keys: &self.keys, to: near, to_keys: &Keys::NONE, stop, is_suspect: &|_, _| false }
    }

    /// The way from a store of this machine to there.
    pub fn way_there<'a>(&'a self, near: &'a FolderStore, stop: &'a AtomicBool) -> Way<'a> {
        Way { from: near, from_keys: &Keys::NONE, to: &*self.objects, to_keys: &self.keys, stop, is_suspect: &|_, _| false }
    }
}

/// A near store and a far one, as one.
pub struct Tiers(Arc<Inner>);

struct Inner {
    near: FolderStore,
    far: Far,
    may_write: AtomicBool,
    account: Mutex<Account>,
    borrowed: Mutex<Borrowed>,
    census: Mutex<HashMap<Shelf, Census>>,
}

/// All names on a shelf of the far store, and since when that is known.
struct Census {
    names: HashSet<String>,
    taken: Instant,
}

/// How it went.
#[derive(Default)]
struct Account {
    failures: u32,
    last_failure: String,
    /// Reads that were not allowed, and those that were.
    denied: u64,
    granted: u64,
    untrusted: HashSet<(Shelf, String)>,
    damaged: HashSet<(Shelf, String)>,
    first_damage: String,
    differing: Vec<String>,
    unsent: u64,
    why_not_written: Option<String>,
}

/// Records of the far store some of whose blobs are not here.
#[derive(Default)]
struct Borrowed {
    records: HashMap<(Shelf, String), SoundRecord>,
    /// By blob, the records that wait for it.
    waiting: HashMap<String, Vec<(Shelf, String)>>,
}

impl Tiers {
    /// One store of the two.
    pub fn new(near: FolderStore, far: Far) -> Self {
        let may_write = AtomicBool::new(far.is_writable);
        Self(Arc::new(Inner { near, far, may_write, account: Mutex::default(), borrowed: Mutex::default(), census: Mutex::default() }))
    }
}

impl Objects for Tiers {
    fn open(&self, shelf: Shelf, name: &str) -> io::Result<Box<dyn Read + Send>> {
        match self.0.near.open(shelf, name) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => self.0.open_from_afar(shelf, name).ok_or(error),
            opened => opened,
        }
    }

    fn has(&self, shelf: Shelf, name: &str) -> bool {
        let far_has = || self.0.far.is_quick && self.0.is_in_use() && self.0.far.objects.has(shelf, name);
        self.0.near.has(shelf, name) || (is_shared(shelf) && (self.0.is_borrowed(shelf, name) || far_has()))
    }

    fn length(&self, shelf: Shelf, name: &str) -> Option<u64> {
        self.0.near.length(shelf, name)
    }

    fn draft(&self) -> Result<Box<dyn Draft>, SystemError> {
        self.0.near.draft()
    }

    fn remove(&self, shelf: Shelf, name: &str) -> io::Result<()> {
        self.0.near.remove(shelf, name)
    }

    fn set_aside(&self, shelf: Shelf, name: &str) -> Option<PathBuf> {
        self.0.near.set_aside(shelf, name)
    }

    fn make_durable(&self, objects: &[(Shelf, String)]) -> Result<(), SystemError> {
        self.0.near.make_durable(objects)
    }

    fn names(&self, shelf: Shelf, limit: usize) -> io::Result<Vec<String>> {
        self.0.near.names(shelf, limit)
    }

    fn has_any(&self, shelf: Shelf) -> bool {
        self.0.near.has_any(shelf) || (is_shared(shelf) && self.0.is_in_use() && self.0.far.objects.has_any(shelf))
    }

    fn claims(&self) -> Option<Claims> {
        // Where others compute into the same far store, they are to see what is computed here.
        let far = self.0.may_write.load(Ordering::Relaxed).then(|| self.0.far.objects.claims()).flatten();
        far.or_else(|| self.0.near.claims())
    }

    fn tidy(&self) {
        self.0.near.tidy();
        if self.0.may_write.load(Ordering::Relaxed) {
            self.0.far.objects.tidy();
        }
    }

    fn has_far_objects(&self) -> bool {
        self.0.is_in_use()
    }

    fn fetch(&self, wanted: &[(Shelf, String)]) {
        if !self.0.far.is_quick && wanted.len() > MANY {
            wanted.first().into_iter().for_each(|(shelf, _)| self.0.take_census(*shelf));
        }
        let missing: Vec<_> = wanted.iter().filter(|(shelf, name)| is_shared(*shelf) && !self.0.near.has(*shelf, name)).collect();
        let next = AtomicUsize::new(0);
        let take = || {
            while let Some((shelf, name)) = missing.get(next.fetch_add(1, Ordering::Relaxed)) {
                self.0.receive(*shelf, name);
            }
        };
        std::thread::scope(|scope| {
            (0..self.0.far.objects.at_once().min(missing.len())).for_each(|_| drop(scope.spawn(take)));
        });
    }

    fn share(&self, records: &[(Shelf, String)], is_hurried: &AtomicBool) {
        if !self.0.may_write.load(Ordering::Relaxed) {
            return;
        }
        let stop = Arc::new(AtomicBool::new(false));
        let records = Arc::new(records.to_vec());
        let next = Arc::new(AtomicUsize::new(0));
        let (sender, receiver) = channel();
        // Threads of their own: a far store that does not answer must not keep the run from its end.
        for _ in 0..self.0.far.objects.at_once().min(records.len()) {
            let (inner, records, next, stop, sender) = (self.0.clone(), records.clone(), next.clone(), stop.clone(), sender.clone());
            let send = move || {
                while let Some((shelf, name)) = records.get(next.fetch_add(1, Ordering::Relaxed)) {
                    inner.send(*shelf, name, &stop);
                    if sender.send(()).is_err() {
                        return;
                    }
                }
            };
            if std::thread::Builder::new().name("share".into()).spawn(send).is_err() {
                break;
            }
        }
        drop(sender);
        let mut left = records.len() as u64;
        loop {
            match receiver.recv_timeout(LOOK) {
                Ok(()) => left -= 1,
                Err(std::sync::mpsc::RecvTimeoutError::Timeout) if !is_hurried.load(Ordering::Relaxed) => {}
                Err(_) => break,
            }
        }
        stop.store(true, Ordering::Relaxed);
        if left > 0 {
            self.0.account.lock().expect(NO_PANIC).unsent += left;
        }
    }

    fn take_notices(&self) -> Vec<String> {
        let account = std::mem::take(&mut *self.0.account.lock().expect(NO_PANIC));
        let notices = account.notices(&self.0.far);
        // What was found stays known.
        let mut kept = self.0.account.lock().expect(NO_PANIC);
        kept.failures = account.failures;
        kept.damaged = account.damaged;
        notices
    }
}

const NO_PANIC: &str = "no one panics while noting how the far store does";

/// Notes are of one machine; runs are asked for by name only.
fn is_shared(shelf: Shelf) -> bool {
    matches!(shelf, Shelf::Blobs | Shelf::Results | Shelf::Publications)
}

impl Inner {
    fn is_in_use(&self) -> bool {
        self.account.lock().expect(NO_PANIC).failures < PATIENCE
    }

    /// Does something with the far store, twice if need be; what went wrong is noted.
    fn attempt<T>(&self, object: (Shelf, &str), call: impl Fn() -> Result<T, Fault>) -> Option<T> {
        if !self.is_in_use() {
            return None;
        }
        let done = call().or_else(|fault| match is_worth_repeating(&fault) {
            true => {
                std::thread::sleep(PAUSE);
                call()
            }
            false => Err(fault),
        });
        let mut account = self.account.lock().expect(NO_PANIC);
        match done {
            Ok(done) => {
                account.granted += 1;
                Some(done)
            }
            Err(fault) => {
                account.note(object, fault);
                None
            }
        }
    }

    fn way_here<'a>(&'a self, stop: &'a AtomicBool) -> Way<'a> {
        self.far.way_here(&self.near, stop)
    }

    fn open_from_afar(&self, shelf: Shelf, name: &str) -> Option<Box<dyn Read + Send>> {
        if !is_shared(shelf) {
            return None;
        }
        self.receive(shelf, name);
        match self.borrowed(shelf, name) {
            Some(text) => Some(Box::new(Cursor::new(text.into_bytes()))),
            None => self.near.open(shelf, name).ok(),
        }
    }

    fn borrowed(&self, shelf: Shelf, name: &str) -> Option<String> {
        let borrowed = self.borrowed.lock().expect(NO_PANIC);
        borrowed.records.get(&(shelf, name.to_owned())).map(|record| record.sealed.clone())
    }

    fn take_census(&self, shelf: Shelf) {
        let call = || self.far.objects.names(shelf, CENSUS_LIMIT).map_err(Fault::Source);
        let names = self.attempt((shelf, "all"), call).filter(|names| names.len() < CENSUS_LIMIT);
        if let Some(names) = names {
            let census = Census { names: names.into_iter().collect(), taken: Instant::now() };
            self.census.lock().expect(NO_PANIC).insert(shelf, census);
        }
    }

    /// Whether the far store is known not to have something.
    fn is_known_to_lack(&self, shelf: Shelf, name: &str) -> bool {
        let census = self.census.lock().expect(NO_PANIC);
        census.get(&shelf).is_some_and(|census| census.taken.elapsed() < CENSUS_AGE && !census.names.contains(name))
    }

    fn is_borrowed(&self, shelf: Shelf, name: &str) -> bool {
        self.borrowed.lock().expect(NO_PANIC).records.contains_key(&(shelf, name.to_owned()))
    }

    /// Brings something here, if the far store has it.
    fn receive(&self, shelf: Shelf, name: &str) {
        if self.is_known_to_lack(shelf, name) {
            return;
        }
        if shelf == Shelf::Blobs {
            let Ok(digest) = name.parse() else { return };
            let stop = AtomicBool::new(false);
            // A near store that takes nothing is no fault of the far one, and is told of by whoever writes next.
            let carry = || {
                self.way_here(&stop).carry_blob(&digest, None, false).map_err(|fault| match fault {
                    Fault::Target(_) => Fault::Missing,
                    fault => fault,
                })
            };
            if self.attempt((shelf, name), carry).is_some() {
                self.keep_borrowed(name);
            }
        } else if !self.is_borrowed(shelf, name)
            && let Some(record) = self.attempt((shelf, name), || read_record(&*self.far.objects, &self.far.keys, shelf, name))
        {
            self.borrow(shelf, name, record);
        }
    }

    fn borrow(&self, shelf: Shelf, name: &str, record: SoundRecord) {
        let missing: Vec<String> =
            record.separate_blobs().map(|blob| blob.digest.to_string()).filter(|blob| !self.near.has(Shelf::Blobs, blob)).collect();
        if missing.is_empty() && drafted(&self.near, record.sealed.as_bytes()).and_then(|draft| draft.keep(shelf, name)).is_ok() {
            return;
        }
        let mut borrowed = self.borrowed.lock().expect(NO_PANIC);
        borrowed.records.insert((shelf, name.to_owned()), record);
        for blob in missing {
            borrowed.waiting.entry(blob).or_default().push((shelf, name.to_owned()));
        }
    }

    /// Keeps the records that waited for a blob alone.
    fn keep_borrowed(&self, blob: &str) {
        let waiting = self.borrowed.lock().expect(NO_PANIC).waiting.remove(blob).unwrap_or_default();
        for (shelf, name) in waiting {
            let record = self.borrowed.lock().expect(NO_PANIC).records.remove(&(shelf, name.clone()));
            if let Some(record) = record {
                self.borrow(shelf, &name, record);
            }
        }
    }

    /// Sends a record that is here with its blobs.
    fn send(&self, shelf: Shelf, name: &str, stop: &AtomicBool) {
        if !self.may_write.load(Ordering::Relaxed) {
            return;
        }
        let is_suspect = |shelf: Shelf, name: &str| self.account.lock().expect(NO_PANIC).damaged.contains(&(shelf, name.to_owned()));
        let way = Way { is_suspect: &is_suspect, ..self.far.way_there(&self.near, stop) };
        let carried = self.attempt((shelf, name), || match way.carry(shelf, name) {
            // What is wrong here is found out here.
            Err(Fault::Source(_) | Fault::Missing | Fault::Damaged(_) | Fault::Untrusted) => Ok(None),
            carried => carried.map(Some),
        });
        let mut account = self.account.lock().expect(NO_PANIC);
        match carried {
            Some(Some(Carried::Differs)) => account.differing.push(name.to_owned()),
            // When it is to end, what is left is counted once.
            Some(Some(_)) => {}
            Some(None) | None => account.unsent += u64::from(!stop.load(Ordering::Relaxed)),
        }
        if account.why_not_written.is_some() {
            self.may_write.store(false, Ordering::Relaxed);
        }
    }
}

fn is_worth_repeating(fault: &Fault) -> bool {
    match fault {
        Fault::Source(error) => error.kind() != io::ErrorKind::PermissionDenied,
        Fault::Target(error) => !is_refusal(&error.source),
        // It may have been read while it was replaced, or not to its end.
        Fault::Damaged(_) => true,
        Fault::Missing | Fault::Untrusted | Fault::Stopped => false,
    }
}

/// Whether a store that answers so will not take anything else either.
fn is_refusal(error: &io::Error) -> bool {
    use io::ErrorKind::{PermissionDenied, QuotaExceeded, ReadOnlyFilesystem, StorageFull};
    matches!(error.kind(), PermissionDenied | QuotaExceeded | ReadOnlyFilesystem | StorageFull)
}

impl Account {
    fn note(&mut self, (shelf, name): (Shelf, &str), fault: Fault) {
        match fault {
            Fault::Missing | Fault::Stopped => {}
            Fault::Untrusted => drop(self.untrusted.insert((shelf, name.to_owned()))),
            Fault::Damaged(what) => {
                if self.damaged.insert((shelf, name.to_owned())) && self.first_damage.is_empty() {
                    self.first_damage = format!("{} `{name}`: {what}", shelf.noun());
                }
            }
            Fault::Source(error) if error.kind() == io::ErrorKind::PermissionDenied => {
                self.denied += 1;
                self.last_failure = error.to_string();
            }
            Fault::Source(error) => self.fail(error.to_string()),
            Fault::Target(error) if is_refusal(&error.source) => self.why_not_written = Some(error.to_string()),
            Fault::Target(error) => self.fail(error.to_string()),
        }
    }

    fn fail(&mut self, what: String) {
        self.failures += 1;
        self.last_failure = what;
    }

    /// What is to be told, a line for each sort.
    fn notices(&self, far: &Far) -> Vec<String> {
        let store = format!("the remote store `{}`", far.name);
        let last = &self.last_failure;
        let mut notices = Vec::new();
        if !self.last_failure.is_empty() && self.failures > 0 {
            let end = if self.failures >= PATIENCE { ", and was left alone from then on" } else { "" };
            notices.push(format!("{store} failed {}{end}: {last}", times(self.failures.into())));
        }
        // A bucket that may not be listed answers so for what it does not have.
        if self.denied > 0 && (self.granted == 0 || far.is_quick) {
            notices.push(format!("{store} refused to be read {}: {last}", times(self.denied)));
        }
        if !self.first_damage.is_empty() {
            notices.push(format!(
                "{store} holds what is damaged ({} in this run), which was passed over: {}",
                self.damaged.len(),
                self.first_damage
            ));
        }
        if !self.untrusted.is_empty() {
            let records =
                if self.untrusted.len() == 1 { "1 record is".to_owned() } else { format!("{} records are", self.untrusted.len()) };
            notices.push(format!("{store}: {records} not signed by a key that is trusted here, and passed over"));
        }
        if let Some(first) = self.differing.first() {
            let others = self.differing.len() - 1;
            let more = if others > 0 { format!(" and {others} more") } else { String::new() };
            notices.push(format!(
                "{store} has other results for the job `{first}`{more} than were computed here: its kind is not deterministic, or one of the two \
                 programs is at fault"
            ));
        }
        if let Some(why) = &self.why_not_written {
            notices.push(format!("{store} does not take results: {why}"));
        }
        if self.unsent > 0 {
            notices.push(format!("{} not sent to {store}; `pipeline store push` sends what is here", were(self.unsent)));
        }
        notices
    }
}

fn times(count: u64) -> String {
    if count == 1 { "once".into() } else { format!("{count} times") }
}

fn were(count: u64) -> String {
    if count == 1 { "1 record was".into() } else { format!("{count} records were") }
}

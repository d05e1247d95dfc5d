//! Makes results durable in groups: blobs, one sync, then the records that name them.
//!
//! A record never stands on disk before its bytes; where the store is shared with other machines, it goes there with its group. Jobs do not wait for it: what is lost with the power is
//! the last group, and its jobs run again. Between groups the committer sleeps, so that handing a record in wakes no one.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, TryRecvError, channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use super::claims::Claim;
use super::library::Library;
use super::objects::Shelf;
use super::record::{Blob, PublicationRecord, ResultRecord};
use crate::engine::digest::Digest;
use crate::engine::system::SystemError;

/// What comes within this time of the first record makes a group.
const GROUP_TIME: Duration = Duration::from_millis(50);

/// The same while other runs may be waiting to see the records.
const SHARED_GROUP_TIME: Duration = Duration::from_millis(5);

/// A record whose blobs are written but perhaps not durable.
pub enum Commit {
    /// Of a job.
    Result(ResultRecord),
    /// Of an encoded file.
    Publication(PublicationRecord),
}

impl Commit {
    fn blobs(&self) -> Vec<&Blob> {
        match self {
            Commit::Result(record) => record.outputs.iter().map(|output| &output.content).collect(),
            Commit::Publication(record) => vec![&record.content],
        }
    }

    fn name(&self) -> (Shelf, String) {
        match self {
            Commit::Result(record) => (Shelf::Results, record.key.to_string()),
            Commit::Publication(record) => (Shelf::Publications, record.key.to_string()),
        }
    }
}

enum Message {
    Commit(Commit),
    /// What was handed in before stands under this claim; whether others may be waiting for it.
    LetGo(Claim, bool),
    End,
}

/// Takes records from the job threads; its own thread starts when there is something to commit.
pub struct Committer {
    library: Arc<Library>,
    sender: Sender<Message>,
    receiver: Option<Receiver<Message>>,
    is_hurried: Arc<AtomicBool>,
    is_shared: Arc<AtomicBool>,
    thread: Option<JoinHandle<Result<(), SystemError>>>,
}

/// Hands records to the committer, from any thread.
#[derive(Clone)]
pub struct Submit(Sender<Message>);

impl Submit {
    /// Commits with the next group. Nothing happens if the committer has failed: its error ends the run.
    pub fn submit(&self, commit: Commit) {
        let _ = self.0.send(Message::Commit(commit));
    }
}

impl Committer {
    /// A committer that has not started.
    pub fn new(library: Arc<Library>) -> Self {
        let (sender, receiver) = channel();
        Self { library, sender, receiver: Some(receiver), is_hurried: Arc::default(), is_shared: Arc::default(), thread: None }
    }

    /// A way to hand records in.
    pub fn submit(&self) -> Submit {
        Submit(self.sender.clone())
    }

    /// Lets a claim go when what was handed in so far can be found: at once if another run may be waiting for it, else with
    /// the next group.
    pub fn let_go(&self, claim: Option<Claim>, is_awaited: bool) {
        if let Some(claim) = claim {
            // If the committer has failed, the claim goes at once.
            let _ = self.sender.send(Message::LetGo(claim, is_awaited));
            if is_awaited {
                self.wake();
            }
        }
    }

    fn wake(&self) {
        if let Some(thread) = &self.thread {
            thread.thread().unpark();
        }
    }

    /// Starts the thread, if it has not started.
    pub fn start(&mut self) {
        let Some(receiver) = self.receiver.take() else { return };
        let (library, is_hurried, is_shared) = (self.library.clone(), self.is_hurried.clone(), self.is_shared.clone());
        let commit = move || commit_groups(&library, &receiver, &is_hurried, &is_shared);
        let thread = std::thread::Builder::new().name("commit".into()).spawn(commit);
        self.thread = Some(thread.expect("the system gives a thread"));
    }

    /// From now on the disk is not waited for: a run that is to end within a second keeps what it has, and only a power cut
    /// within moments could cost a result.
    pub fn hurry(&self) {
        self.is_hurried.store(true, Ordering::Relaxed);
        self.wake();
    }

    /// Whether other runs are to see records soon.
    pub fn share(&self, is_shared: bool) {
        self.is_shared.store(is_shared, Ordering::Relaxed);
    }

    /// Whether it has ended early, which only an error makes it do.
    pub fn has_failed(&self) -> bool {
        self.thread.as_ref().is_some_and(JoinHandle::is_finished)
    }

    /// Commits what was handed in, and ends.
    pub fn finish(mut self) -> Result<(), SystemError> {
        // If it has ended already, its error comes with the join.
        let _ = self.sender.send(Message::End);
        self.wake();
        let thread = self.thread.take();
        thread.map_or(Ok(()), |thread| thread.join().expect("the committer does not panic"))
    }
}

fn commit_groups(
    library: &Library,
    receiver: &Receiver<Message>,
    is_hurried: &AtomicBool,
    is_shared: &AtomicBool,
) -> Result<(), SystemError> {
    loop {
        let (group, claims, is_last) = next_group(receiver, is_shared);
        commit_group(library, &group, is_hurried)?;
        drop(claims);
        if is_last {
            return Ok(());
        }
    }
}

/// The next records with the claims on them, and whether there will be no more.
fn next_group(receiver: &Receiver<Message>, is_shared: &AtomicBool) -> (Vec<Commit>, Vec<Claim>, bool) {
    let (mut group, mut claims) = (Vec::new(), Vec::new());
    let mut is_awaited = false;
    let mut next = receiver.recv().ok();
    let deadline = Instant::now() + if is_shared.load(Ordering::Relaxed) { SHARED_GROUP_TIME } else { GROUP_TIME };
    loop {
        match next {
            Some(Message::Commit(commit)) => group.push(commit),
            Some(Message::LetGo(claim, awaited)) => {
                claims.push(claim);
                is_awaited |= awaited;
            }
            Some(Message::End) | None => return (group, claims, true),
        }
        next = match receiver.try_recv() {
            Ok(message) => Some(message),
            Err(TryRecvError::Disconnected) => None,
            Err(TryRecvError::Empty) => {
                let left = deadline.saturating_duration_since(Instant::now());
                if left.is_zero() || is_awaited {
                    return (group, claims, false);
                }
                std::thread::park_timeout(left);
                match receiver.try_recv() {
                    Ok(message) => Some(message),
                    Err(_) => return (group, claims, false),
                }
            }
        };
    }
}

fn commit_group(library: &Library, group: &[Commit], is_hurried: &AtomicBool) -> Result<(), SystemError> {
    if group.is_empty() {
        return Ok(());
    }
    let blobs: Vec<Digest> = group.iter().flat_map(Commit::blobs).filter(|blob| blob.inline.is_none()).map(|blob| blob.digest).collect();
    if !is_hurried.load(Ordering::Relaxed) {
        library.make_durable(&blobs)?;
    }
    for commit in group {
        match commit {
            Commit::Result(record) => library.keep_record(Shelf::Results, record)?,
            Commit::Publication(record) => library.keep_record(Shelf::Publications, record)?,
        }
    }
    let records: Vec<_> = group.iter().map(Commit::name).collect();
    library.share(&records, is_hurried);
    Ok(())
}

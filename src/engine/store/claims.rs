//! Who is computing what: claims, which save work and decide nothing.
//!
//! A job that takes a while is claimed by a link `claims/KEY` whose text names its owner: making a link is one call
//! that exactly one of many wins, and there is never half a claim. The owner renews the link's time. Another run
//! that comes to the same job waits for the record, or takes the job over when the owner is gone: at once where its
//! process can be looked for, else when the claim was not renewed for [`PATIENCE`], as seen by the looker's own clock,
//! so that clocks need not agree. Where links cannot be made, or two runs both think that a job is theirs, it is
//! computed twice and nothing else happens. The record in the store alone says that a job is done.

use std::collections::HashMap;
use std::fmt;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant, SystemTime};

use crate::engine::digest::Digest;
use crate::engine::files;
use crate::engine::owner::{Owner, host_name};

/// Claims that were not renewed for so long are no claims.
pub const PATIENCE: Duration = Duration::from_secs(30);

/// How often an owner renews its claims.
pub const HEARTBEAT: Duration = Duration::from_secs(5);

/// With this the name of a link begins that claims no job, but says that a run is at work.
const PRESENCE: &str = "run-";

/// The claims of a store, as one run sees them.
#[derive(Debug)]
pub struct Claims {
    folder: PathBuf,
    folder_mode: u32,
    /// Text of our claims.
    text: String,
    /// Claims of others whose process cannot be looked for: their time, and since when they have it.
    watched: HashMap<PathBuf, (SystemTime, Instant)>,
    /// Owners that renewed nothing for [`PATIENCE`], and the latest time of what was given up for it.
    silent: HashMap<Owner, SystemTime>,
}

/// Who holds a claim.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Holder {
    host: String,
    process: u32,
}

impl fmt::Display for Holder {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "process {} on {}", self.process, self.host)
    }
}

impl Claims {
    /// The claims in a folder, which need not exist; `folder_mode` is for making it.
    pub fn in_folder(folder: PathBuf, folder_mode: u32) -> Self {
        static COUNTER: AtomicU64 = AtomicU64::new(0);
        let run = COUNTER.fetch_add(1, Ordering::Relaxed);
        let text = format!("{}-{run}-{}", Owner::this_process(), host_name());
        Self { folder, folder_mode, text, watched: HashMap::new(), silent: HashMap::new() }
    }

    /// Another run that is computing this; `None` if it may be begun, as far as one can see.
    pub fn holder(&mut self, key: &Digest) -> Option<Holder> {
        let path = self.path(key);
        let held = files::link_text(&path).ok().and_then(|text| self.holder_by(&path, text.to_str()?));
        if held.is_none() {
            self.watched.remove(&path);
        }
        held
    }

    fn holder_by(&mut self, path: &Path, text: &str) -> Option<Holder> {
        if text == self.text {
            return None;
        }
        let (owner, rest) = Owner::parse(text)?;
        if !self.is_kept(path, &owner)? {
            remove_if(path, text);
            return None;
        }
        let host = rest.split_once('-').map_or("", |(_, host)| host);
        Some(Holder { host: host.to_owned(), process: owner.process() })
    }

    /// Whether the owner of a link can be taken to be at work; `None` if the link is gone.
    fn is_kept(&mut self, path: &Path, owner: &Owner) -> Option<bool> {
        let modified = files::link_status(path).ok()?.modified().ok()?;
        let watched = self.watched.entry(path.to_owned()).or_insert_with(|| (modified, Instant::now()));
        if watched.0 != modified {
            *watched = (modified, Instant::now());
        }
        // A process that was stopped lives, but does not work.
        if watched.1.elapsed() > PATIENCE {
            let last = self.silent.entry(owner.clone()).or_insert(modified);
            *last = modified.max(*last);
            return Some(false);
        }
        // Whoever is silent in one thing renews nothing else, so that no two leases are waited for one after the other.
        let is_silent = self.silent.get(owner).is_some_and(|last| modified <= *last + 2 * HEARTBEAT);
        let is_dead = is_silent || (owner.is_in_sight() && !owner.is_alive());
        Some(!is_dead)
    }

    /// Says that this run computes that; `None` if another has said so, or if it cannot be said here.
    pub fn take(&self, key: &Digest) -> Option<Claim> {
        self.take_path(self.path(key))
    }

    fn take_path(&self, path: PathBuf) -> Option<Claim> {
        let make = || files::link(&path, &self.text);
        let made = make().or_else(|error| match error.kind() {
            // Another run may make the folder in the same moment.
            io::ErrorKind::NotFound => match files::make_folder(&self.folder, self.folder_mode) {
                Err(error) if error.kind() != io::ErrorKind::AlreadyExists => Err(error),
                _ => make(),
            },
            // A file server may answer the repetition of a call that had succeeded.
            io::ErrorKind::AlreadyExists if is_text(&path, &self.text) => Ok(()),
            _ => Err(error),
        });
        made.is_ok().then(|| Claim { path, text: self.text.clone(), renewed: Instant::now() })
    }

    /// Says that this run is at work, so that others can divide the jobs with it; `None` if it cannot be said here.
    pub fn come_in(&self) -> Option<Claim> {
        self.take_path(self.folder.join(format!("{PRESENCE}{}", self.text)))
    }

    /// Whether another run is at work, as far as one can see.
    pub fn are_others_at_work(&mut self) -> bool {
        let Ok(entries) = files::list(&self.folder) else { return false };
        let mut are_others = false;
        for path in entries.flatten().map(|entry| entry.path()) {
            let text = path.file_name().and_then(|name| name.to_str()?.strip_prefix(PRESENCE)).filter(|text| *text != self.text);
            let Some((owner, _)) = text.and_then(Owner::parse) else { continue };
            match self.is_kept(&path, &owner) {
                Some(true) => are_others = true,
                // Left by a machine that is gone, whose process no one can look for.
                Some(false) => drop(files::remove(&path)),
                None => {}
            }
        }
        are_others
    }

    /// Removes the claims of processes that can be seen to be gone.
    pub fn remove_dead(&self) {
        let Ok(entries) = files::list(&self.folder) else { return };
        for path in entries.flatten().map(|entry| entry.path()) {
            let text = files::link_text(&path).ok().and_then(|text| text.to_str().map(str::to_owned));
            if let Some(text) = text
                && Owner::parse(&text).is_some_and(|(owner, _)| owner.is_in_sight() && !owner.is_alive())
            {
                remove_if(&path, &text);
            }
        }
    }

    fn path(&self, key: &Digest) -> PathBuf {
        self.folder.join(key.to_string())
    }
}

/// Says, while it is there, that this run computes something.
#[derive(Debug)]
pub struct Claim {
    path: PathBuf,
    text: String,
    renewed: Instant,
}

impl Claim {
    /// To be called often: renews the claim when that is due.
    pub fn keep_alive(&mut self) {
        if self.renewed.elapsed() < HEARTBEAT {
            return;
        }
        self.renewed = Instant::now();
        // Whoever overtook us keeps the claim.
        if is_text(&self.path, &self.text) {
            let _ = files::touch_link(&self.path);
        }
    }
}

impl Drop for Claim {
    fn drop(&mut self) {
        remove_if(&self.path, &self.text);
    }
}

fn is_text(path: &Path, text: &str) -> bool {
    files::link_text(path).is_ok_and(|found| found.to_str() == Some(text))
}

/// Removes a claim that still has that text. If another takes its place in between, a job is computed twice.
fn remove_if(path: &Path, text: &str) {
    if is_text(path, text) {
        let _ = files::remove(path);
    }
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::symlink;

    use super::*;

    fn two_runs() -> (tempfile::TempDir, Claims, Claims) {
        let folder = tempfile::tempdir().unwrap();
        let claims = || Claims::in_folder(folder.path().join("claims"), 0o700);
        let (one, two) = (claims(), claims());
        (folder, one, two)
    }

    #[test]
    fn one_of_two_runs_has_a_claim_until_it_lets_go() {
        let (_folder, mut one, mut two) = two_runs();
        let key = Digest::of(b"job");
        assert_eq!((one.holder(&key), two.holder(&key)), (None, None));
        let claim = one.take(&key).unwrap();
        assert!(two.take(&key).is_none());
        assert_eq!(one.holder(&key), None, "our own does not keep us waiting");
        assert_eq!(two.holder(&key).unwrap().process, std::process::id());
        drop(claim);
        assert_eq!(two.holder(&key), None);
        assert!(two.take(&key).is_some());
    }

    #[test]
    fn runs_see_each_other_while_they_are_at_work() {
        let (folder, mut one, mut two) = two_runs();
        assert!(!one.are_others_at_work());
        let presence = one.come_in();
        assert!(presence.is_some() && !one.are_others_at_work() && two.are_others_at_work());
        drop(presence);
        assert!(!two.are_others_at_work());
        let this = Owner::this_process().to_string();
        let dead = format!("{PRESENCE}{}-1-0-host", this.rsplit_once('-').unwrap().0);
        symlink("anything", folder.path().join("claims").join(dead)).unwrap();
        assert!(!two.are_others_at_work(), "a dead one is not at work");
        let elsewhere = folder.path().join("claims").join(format!("{PRESENCE}0badb007-17-5-0-elsewhere"));
        symlink("anything", &elsewhere).unwrap();
        assert!(two.are_others_at_work());
        two.watched.get_mut(&elsewhere).unwrap().1 = Instant::now().checked_sub(PATIENCE + Duration::from_secs(1)).unwrap();
        assert!(!two.are_others_at_work() && !elsewhere.is_symlink(), "a machine that is gone is forgotten");
    }

    #[test]
    fn exactly_one_of_many_threads_wins_a_claim() {
        // Without a folder of claims, which one of them makes.
        let (_folder, one, _) = two_runs();
        let key = Digest::of(b"job");
        let others: Vec<Claims> = (0..8).map(|_| Claims::in_folder(one.folder.clone(), 0o700)).collect();
        let claims: Vec<Option<Claim>> = std::thread::scope(|scope| {
            let threads: Vec<_> = others.iter().map(|claims| scope.spawn(|| claims.take(&key))).collect();
            threads.into_iter().map(|thread| thread.join().unwrap()).collect()
        });
        assert_eq!(claims.iter().flatten().count(), 1);
    }

    #[test]
    fn a_dead_owner_blocks_no_one_and_its_claim_goes() {
        let (folder, mut one, _) = two_runs();
        let key = Digest::of(b"job");
        drop(one.take(&key));
        // No process of this machine has started at tick 1 under our own id.
        let this = Owner::this_process().to_string();
        let dead = format!("{}-1-0-host", this.rsplit_once('-').unwrap().0);
        let path = folder.path().join("claims").join(key.to_string());
        symlink(&dead, &path).unwrap();
        assert_eq!(one.holder(&key), None);
        assert!(!path.is_symlink());
        symlink(&dead, &path).unwrap();
        symlink("0badb007-17-5-0-elsewhere", folder.path().join("claims").join(Digest::of(b"other").to_string())).unwrap();
        one.remove_dead();
        assert!(!path.is_symlink());
        assert_eq!(one.holder(&Digest::of(b"other")).unwrap().to_string(), "process 17 on elsewhere");
    }

    #[test]
    fn a_claim_from_elsewhere_counts_while_it_is_renewed() {
        let (folder, mut one, _) = two_runs();
        let key = Digest::of(b"job");
        std::fs::create_dir(folder.path().join("claims")).unwrap();
        let path = folder.path().join("claims").join(key.to_string());
        symlink("0badb007-17-5-0-elsewhere", &path).unwrap();
        assert!(one.holder(&key).is_some());
        // As if it had been seen long ago with the same time; then it is renewed; then not again.
        let age = |one: &mut Claims| {
            let watched = one.watched.get_mut(&path).unwrap();
            watched.1 = Instant::now().checked_sub(PATIENCE + Duration::from_secs(1)).unwrap();
        };
        age(&mut one);
        files::touch_link(&path).unwrap();
        assert!(one.holder(&key).is_some(), "renewed");
        age(&mut one);
        assert_eq!(one.holder(&key), None, "given up");
        assert!(one.take(&key).is_some(), "overtaken");
    }

    #[test]
    fn whoever_gives_up_one_claim_has_given_up_all_of_that_time() {
        let (folder, mut one, _) = two_runs();
        std::fs::create_dir(folder.path().join("claims")).unwrap();
        let [first, second, others] = ["first", "second", "others"].map(|name| Digest::of(name.as_bytes()));
        let path = |key: &Digest| folder.path().join("claims").join(key.to_string());
        let lost = "0badb007-17-5-0-elsewhere";
        for (key, text) in [(&first, lost), (&second, lost), (&others, "0badb007-18-5-0-elsewhere")] {
            symlink(text, path(key)).unwrap();
        }
        assert!(one.holder(&first).is_some());
        one.watched.get_mut(&path(&first)).unwrap().1 = Instant::now().checked_sub(PATIENCE + Duration::from_secs(1)).unwrap();
        assert_eq!(one.holder(&first), None);
        assert_eq!(one.holder(&second), None, "never looked at before");
        assert!(one.holder(&others).is_some(), "another process");
        // It was only slow: what it claims later counts.
        symlink(lost, path(&second)).unwrap();
        let later = std::fs::symlink_metadata(path(&second)).unwrap().modified().unwrap() - 3 * HEARTBEAT;
        one.silent.values_mut().for_each(|last| *last = later);
        assert!(one.holder(&second).is_some());
    }

    #[test]
    fn who_was_overtaken_leaves_the_new_claim_alone() {
        let (_folder, one, two) = two_runs();
        let key = Digest::of(b"job");
        let mut first = one.take(&key).unwrap();
        remove_if(&first.path, &first.text);
        let second = two.take(&key).unwrap();
        first.renewed = Instant::now().checked_sub(HEARTBEAT).unwrap();
        first.keep_alive();
        drop(first);
        assert!(is_text(&second.path, &two.text));
    }

    #[test]
    fn odd_things_in_the_folder_of_claims_are_no_claims() {
        let (folder, mut one, _) = two_runs();
        let key = Digest::of(b"job");
        let path = folder.path().join("claims").join(key.to_string());
        std::fs::create_dir(folder.path().join("claims")).unwrap();
        std::fs::write(&path, "text").unwrap();
        assert_eq!(one.holder(&key), None);
        assert!(one.take(&key).is_none(), "computed without a claim");
        std::fs::remove_file(&path).unwrap();
        symlink("no owner", &path).unwrap();
        assert_eq!(one.holder(&key), None);
        std::fs::remove_dir_all(folder.path().join("claims")).unwrap();
        std::fs::write(folder.path().join("claims"), "a file").unwrap();
        assert_eq!(one.holder(&key), None);
        assert!(one.take(&key).is_none());
        one.remove_dead();
    }
}

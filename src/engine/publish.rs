//! The folder of outputs: files that appear whole, one by one, and never outside it.
//!
//! Folders below the root are opened one component after the other without following links, so that
//! nothing that stands in the folder of outputs can lead a write out of it.

use std::collections::HashMap;
use std::fs::{self, File};
use std::io::{self, Write};
use std::os::fd::OwnedFd;
use std::path::PathBuf;
use std::sync::{Arc, Mutex};

use rustix::fs::{AtFlags, CWD, Mode, OFlags};
use rustix::io::Errno;

use super::digest::Digest;
use super::files::{PlainFile, faults};
use super::signature::{Signature, Signatures};
use super::system::{SystemError, remove_leftovers, temporary_name};

/// Below the root: what is being written.
const TEMPORARY: &str = ".tmp";

/// Folders that are kept open at most; beyond, all are let go.
const OPENED_COUNT: usize = 32;

/// The folder of one pipeline's outputs.
#[derive(Debug, Clone)]
pub struct OutputFolder {
    root: PathBuf,
    pipeline: String,
    /// Folders that were opened already, by their path below the root.
    opened: Arc<Mutex<HashMap<String, Arc<OwnedFd>>>>,
}

impl OutputFolder {
    /// `root/pipeline`; makes nothing.
    pub fn at(root: impl Into<PathBuf>, pipeline: &str) -> Self {
        Self { root: root.into(), pipeline: pipeline.to_owned(), opened: Arc::default() }
    }

    /// The path for people.
    pub fn path(&self) -> PathBuf {
        self.root.join(&self.pipeline)
    }

    /// Makes the folder and finds out whether it can be written to; clears what dead processes left.
    pub fn prepare(&self) -> Result<(), SystemError> {
        fs::create_dir_all(&self.root).map_err(SystemError::at("create", &self.root))?;
        self.again_if_gone(|| self.folder(&[&self.pipeline])).map_err(SystemError::at("create", self.path()))?;
        let temporary = self.root.join(TEMPORARY);
        self.again_if_gone(|| self.folder(&[TEMPORARY])).map_err(SystemError::at("create", &temporary))?;
        remove_leftovers(&temporary);
        Ok(())
    }

    /// A file; `None` if there is no such plain file.
    pub fn open(&self, path: &str) -> Option<File> {
        let (folders, name) = self.split(path);
        let folder = self.existing_folder(&folders).ok()?;
        faults::point(&self.root).ok()?;
        let flags = OFlags::RDONLY | OFlags::NOFOLLOW | OFlags::NONBLOCK | OFlags::CLOEXEC;
        let file = File::from(rustix::fs::openat(&folder, name, flags, Mode::empty()).ok()?);
        file.metadata().ok()?.is_file().then_some(file)
    }

    /// Signature of a plain file; `None` if there is no such file.
    pub fn signature(&self, path: &str) -> Option<Signature> {
        let (folders, name) = self.split(path);
        let folder = self.existing_folder(&folders).ok()?;
        faults::point(&self.root).ok()?;
        Signature::of_stat(&rustix::fs::statat(&folder, name, AtFlags::SYMLINK_NOFOLLOW).ok()?)
    }

    /// Digest of a published file's bytes, which are read only if its signature is new; `None` if there is no such plain
    /// file, or it cannot be read.
    pub fn content_of(&self, path: &str, signatures: &mut Signatures) -> Option<Digest> {
        let known = signatures.known_by(&self.signature(path)?);
        known.or_else(|| Some(signatures.content_of_file(self.open(path)?).ok()?.digest))
    }

    /// Signatures of plain files in one folder below the pipeline's (empty for that itself), by their names;
    /// `None` where there is no such plain file.
    pub fn signatures<'n>(&self, folder: &str, names: impl Iterator<Item = &'n str>) -> Vec<Option<Signature>> {
        let parts: Vec<&str> = std::iter::once(self.pipeline.as_str()).chain(folder.split('/').filter(|part| !part.is_empty())).collect();
        let opened = self.existing_folder(&parts).ok();
        let status = |name: &str| rustix::fs::statat(opened.as_ref()?, name, AtFlags::SYMLINK_NOFOLLOW).ok();
        names.map(|name| Signature::of_stat(&status(name)?)).collect()
    }

    /// Begins a file whose name is given later.
    pub fn begin(&self) -> Result<OutputDraft<'_>, SystemError> {
        let name = temporary_name();
        let path = self.root.join(TEMPORARY).join(&name);
        let create = || {
            let folder = self.folder(&[TEMPORARY])?;
            let flags = OFlags::WRONLY | OFlags::CREATE | OFlags::EXCL | OFlags::CLOEXEC;
            faults::point(&path)?;
            let file = rustix::fs::openat(&folder, name.as_str(), flags, Mode::from_raw_mode(0o666))?;
            io::Result::Ok((folder, PlainFile::of(File::from(file), path.clone())))
        };
        let (folder, file) = self.again_if_gone(create).map_err(SystemError::at("create", &path))?;
        Ok(OutputDraft { outputs: self, folder, name, is_kept: false, file })
    }

    /// Writes a whole file.
    pub fn write(&self, path: &str, bytes: &[u8]) -> Result<(), SystemError> {
        let mut draft = self.begin()?;
        draft.write_all(bytes).map_err(SystemError::at("write", self.path().join(path)))?;
        draft.publish(path)
    }

    /// Makes a folder that must not exist yet; false if it does.
    pub fn make_new_folder(&self, path: &str) -> Result<bool, SystemError> {
        let (folders, name) = self.split(path);
        let make = || {
            let folder = self.folder(&folders)?;
            faults::point(&self.root)?;
            match rustix::fs::mkdirat(&folder, name, Mode::from_raw_mode(0o777)) {
                Err(Errno::EXIST) => Ok(false),
                made => Ok(made.map(|()| true)?),
            }
        };
        self.again_if_gone(make).map_err(SystemError::at("create", self.path().join(path)))
    }

    /// Removes a file and the folder that it leaves empty.
    pub fn remove(&self, path: &str) -> Result<(), SystemError> {
        let (folders, name) = self.split(path);
        let remove = || {
            let folder = self.existing_folder(&folders)?;
            faults::point(&self.root)?;
            Ok(rustix::fs::unlinkat(&folder, name, AtFlags::empty())?)
        };
        remove().map_err(SystemError::at("remove", self.path().join(path)))?;
        if let [parents @ .., last] = folders.as_slice()
            && !parents.is_empty()
            && let Ok(parent) = self.existing_folder(parents)
        {
            // Fails where it is not empty, which is right.
            let _ = rustix::fs::unlinkat(&parent, *last, AtFlags::REMOVEDIR);
        }
        Ok(())
    }

    /// The folders from the root to a file of the pipeline, and its name.
    fn split<'p>(&'p self, path: &'p str) -> (Vec<&'p str>, &'p str) {
        let mut parts: Vec<&str> = std::iter::once(self.pipeline.as_str()).chain(path.split('/')).collect();
        let name = parts.pop().expect("a path has a name");
        (parts, name)
    }

    fn existing_folder(&self, parts: &[&str]) -> io::Result<Arc<OwnedFd>> {
        self.walk(parts, |folder, part| Ok(open_folder(folder, part)?))
    }

    fn folder(&self, parts: &[&str]) -> io::Result<Arc<OwnedFd>> {
        self.walk(parts, |folder, part| match open_folder(folder, part) {
            Err(Errno::NOENT) => {
                faults::point(&self.root)?;
                match rustix::fs::mkdirat(folder, part, Mode::from_raw_mode(0o777)) {
                    // Another run was faster.
                    Ok(()) | Err(Errno::EXIST) => {}
                    Err(error) => return Err(error.into()),
                }
                Ok(open_folder(folder, part)?)
            }
            opened => Ok(opened?),
        })
    }

    /// Opens a folder, one component after the other, unless it stands open.
    fn walk(&self, parts: &[&str], step: impl Fn(&OwnedFd, &str) -> io::Result<OwnedFd>) -> io::Result<Arc<OwnedFd>> {
        let path = parts.join("/");
        if let Some(folder) = self.opened.lock().expect(NO_PANIC).get(&path) {
            return Ok(folder.clone());
        }
        // The root itself may be a link: where outputs go is the user's choice.
        faults::point(&self.root)?;
        let root = rustix::fs::openat(CWD, &self.root, OFlags::DIRECTORY | OFlags::CLOEXEC, Mode::empty())?;
        let folder = parts.iter().try_fold(root, |folder, part| {
            // Paths come from a manifest too, which anyone may have edited.
            if part.is_empty() || *part == "." || *part == ".." {
                return Err(io::Error::new(io::ErrorKind::InvalidInput, "the path leaves the folder of outputs"));
            }
            faults::point(&self.root)?;
            step(&folder, part)
        })?;
        let folder = Arc::new(folder);
        let mut opened = self.opened.lock().expect(NO_PANIC);
        if opened.len() >= OPENED_COUNT {
            opened.clear();
        }
        opened.insert(path, folder.clone());
        Ok(folder)
    }

    /// Another run may remove a folder, being empty, between our making or opening it and our using it.
    fn again_if_gone<T>(&self, step: impl Fn() -> io::Result<T>) -> io::Result<T> {
        const TRIES: usize = 100;
        for _ in 1..TRIES {
            match step() {
                Err(error) if error.kind() == io::ErrorKind::NotFound => self.opened.lock().expect(NO_PANIC).clear(),
                done => return done,
            }
        }
        step()
    }
}

const NO_PANIC: &str = "no one panics while holding the open folders";

fn open_folder(folder: &OwnedFd, name: &str) -> Result<OwnedFd, Errno> {
    rustix::fs::openat(folder, name, OFlags::DIRECTORY | OFlags::NOFOLLOW | OFlags::CLOEXEC, Mode::empty())
}

/// A file that is being written; vanishes unless published.
pub struct OutputDraft<'a> {
    outputs: &'a OutputFolder,
    folder: Arc<OwnedFd>,
    name: String,
    file: PlainFile,
    is_kept: bool,
}

impl Write for OutputDraft<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.file.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

impl OutputDraft<'_> {
    /// Gives the file its name, in place of what stood there.
    pub fn publish(mut self, path: &str) -> Result<(), SystemError> {
        let (folders, name) = self.outputs.split(path);
        let rename = || {
            let target = self.outputs.folder(&folders)?;
            faults::point(&self.outputs.root)?;
            Ok(rustix::fs::renameat(&self.folder, self.name.as_str(), &target, name)?)
        };
        self.outputs.again_if_gone(rename).map_err(SystemError::at("write", self.outputs.path().join(path)))?;
        self.is_kept = true;
        Ok(())
    }
}

impl Drop for OutputDraft<'_> {
    fn drop(&mut self) {
        if !self.is_kept {
            let _ = rustix::fs::unlinkat(&self.folder, self.name.as_str(), AtFlags::empty());
        }
    }
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::symlink;

    use super::*;

    fn outputs(folder: &std::path::Path) -> OutputFolder {
        let outputs = OutputFolder::at(folder.join("outputs"), "p");
        outputs.prepare().unwrap();
        outputs
    }

    #[test]
    fn a_file_appears_whole() {
        let folder = tempfile::tempdir().unwrap();
        let outputs = outputs(folder.path());
        let mut draft = outputs.begin().unwrap();
        draft.write_all(b"bytes").unwrap();
        assert!(outputs.open("stage/n=1.txt").is_none());
        draft.publish("stage/n=1.txt").unwrap();
        assert_eq!(fs::read(folder.path().join("outputs/p/stage/n=1.txt")).unwrap(), b"bytes");

        outputs.remove("stage/n=1.txt").unwrap();
        assert!(!folder.path().join("outputs/p/stage").exists(), "an empty folder goes too");
        assert_eq!(fs::read_dir(folder.path().join("outputs/.tmp")).unwrap().count(), 0);
    }

    #[test]
    fn a_run_that_removes_files_does_not_disturb_one_that_publishes() {
        let folder = tempfile::tempdir().unwrap();
        let outputs = outputs(folder.path());
        let other = outputs.clone();
        let is_over = std::sync::atomic::AtomicBool::new(false);
        std::thread::scope(|scope| {
            scope.spawn(|| {
                while !is_over.load(std::sync::atomic::Ordering::Relaxed) {
                    let _ = other.remove("stage/x");
                }
            });
            let written = (0..2000).try_for_each(|_| outputs.write("stage/x", b"bytes"));
            is_over.store(true, std::sync::atomic::Ordering::Relaxed);
            written.unwrap();
        });
    }

    #[test]
    fn a_file_is_never_seen_half() {
        let folder = tempfile::tempdir().unwrap();
        let outputs = outputs(folder.path());
        let [one, two] = [vec![1; 400_000], vec![2; 400_000]];
        outputs.write("stage/x", &one).unwrap();
        let is_over = std::sync::atomic::AtomicBool::new(false);
        std::thread::scope(|scope| {
            scope.spawn(|| {
                (0..100).for_each(|round| outputs.write("stage/x", if round % 2 == 0 { &two } else { &one }).unwrap());
                is_over.store(true, std::sync::atomic::Ordering::Relaxed);
            });
            while !is_over.load(std::sync::atomic::Ordering::Relaxed) {
                let found = fs::read(folder.path().join("outputs/p/stage/x")).unwrap();
                assert!(found == one || found == two, "{} bytes", found.len());
            }
        });
    }

    #[test]
    fn a_draft_that_is_not_published_leaves_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let outputs = outputs(folder.path());
        drop(outputs.begin().unwrap());
        assert_eq!(fs::read_dir(folder.path().join("outputs/.tmp")).unwrap().count(), 0);
    }

    #[test]
    fn nothing_is_written_or_removed_through_a_link_or_by_climbing() {
        let folder = tempfile::tempdir().unwrap();
        let outputs = outputs(folder.path());
        let outside = folder.path().join("outside");
        fs::create_dir(&outside).unwrap();
        fs::write(outside.join("x"), "precious").unwrap();
        symlink(&outside, folder.path().join("outputs/p/stage")).unwrap();
        symlink(outside.join("x"), folder.path().join("outputs/p/link")).unwrap();

        assert!(outputs.write("stage/x", b"new").is_err());
        assert!(outputs.remove("stage/x").is_err());
        assert!(outputs.remove("../../outside/x").is_err());
        assert!(outputs.open("link").is_none());
        // A link in the place of the file itself is replaced, not followed.
        outputs.write("link", b"new").unwrap();
        assert_eq!(fs::read(outside.join("x")).unwrap(), b"precious");
        assert!(!folder.path().join("outputs/p/link").is_symlink());
    }
}

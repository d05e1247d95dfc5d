//! A store in a local folder, private to its user.
//!
//! `cas/ab/<digest>`, `ac/ab/<key>`, `publications/ab/<key>`, `notes/NAME`; what is being written stands in
//! `tmp`, what was damaged in `bad`. The folder comes into being with the first object.

use std::collections::BTreeSet;
use std::fs::{self, DirBuilder, File};
use std::io::{self, BufReader, Read, Write};
use std::os::unix::fs::{DirBuilderExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use rustix::fs::OFlags;

use super::objects::{Draft, Objects, Shelf};
use crate::engine::digest::READ_SIZE;
use crate::engine::system::{SystemError, remove_leftovers, temporary_name};

/// Version of the layout; another one is another folder beside this.
const LAYOUT: &str = "v1";

/// Tells back-up programs to leave the folder out (bford.info/cachedir).
const CACHE_TAG: &str = "Signature: 8a477f597d28d172789f06886806bc55\n\
    # This folder is the store of `pipeline`: all in it can be computed again.\n";

/// Beyond so many files one sync of the whole file system is cheaper than a sync of each. Below, it would wait for
/// whatever other programs have written, which on a busy machine takes seconds.
const SYNC_ONE_BY_ONE: usize = 256;

/// A store in a local folder.
pub struct FolderStore {
    parent: PathBuf,
    root: PathBuf,
    made: OnceLock<()>,
}

impl FolderStore {
    /// The store in `folder`, which need not exist.
    pub fn at(folder: impl Into<PathBuf>) -> Self {
        let parent = folder.into();
        Self { root: parent.join(LAYOUT), parent, made: OnceLock::new() }
    }

    fn path_of(&self, shelf: Shelf, name: &str) -> PathBuf {
        object_path(&self.root, shelf, name)
    }

    /// Makes the folder when something is first written, and clears what dead processes left.
    fn prepare(&self) -> Result<(), SystemError> {
        if self.made.get().is_some() {
            return Ok(());
        }
        let temporary = self.root.join("tmp");
        make_folder(&temporary)?;
        let tag = self.parent.join("CACHEDIR.TAG");
        if !tag.exists() {
            fs::write(&tag, CACHE_TAG).map_err(SystemError::at("write", tag))?;
        }
        remove_leftovers(&temporary);
        let _ = self.made.set(());
        Ok(())
    }
}

fn object_path(root: &Path, shelf: Shelf, name: &str) -> PathBuf {
    let folder = root.join(folder_name(shelf));
    match shelf {
        Shelf::Notes => folder.join(name),
        // 256 folders keep each short enough for any file system.
        _ => folder.join(&name[..2]).join(name),
    }
}

fn folder_name(shelf: Shelf) -> &'static str {
    match shelf {
        Shelf::Blobs => "cas",
        Shelf::Results => "ac",
        Shelf::Publications => "publications",
        Shelf::Notes => "notes",
    }
}

/// Makes a folder and those above it, open to no one else.
fn make_folder(path: &Path) -> Result<(), SystemError> {
    DirBuilder::new().recursive(true).mode(0o700).create(path).map_err(SystemError::at("create", path))
}

impl Objects for FolderStore {
    fn open(&self, shelf: Shelf, name: &str) -> io::Result<Box<dyn Read + Send>> {
        // Neither a link nor a pipe that someone put there is followed or waited for.
        let flags = (OFlags::NOFOLLOW | OFlags::NONBLOCK).bits() as i32;
        let path = self.path_of(shelf, name);
        let file = File::options().read(true).custom_flags(flags).open(path)?;
        if !file.metadata()?.is_file() {
            return Err(io::Error::new(io::ErrorKind::InvalidData, "not a regular file"));
        }
        Ok(Box::new(BufReader::with_capacity(READ_SIZE, file)))
    }

    fn draft(&self) -> Result<Box<dyn Draft>, SystemError> {
        self.prepare()?;
        let path = self.root.join("tmp").join(temporary_name());
        let create = || File::options().write(true).create_new(true).mode(0o600).open(&path);
        let file = create().map_err(SystemError::at("create", &path))?;
        Ok(Box::new(FileDraft { path, file, root: self.root.clone(), is_kept: false }))
    }

    fn set_aside(&self, shelf: Shelf, name: &str) {
        let path = self.path_of(shelf, name);
        let bad = self.root.join("bad");
        let target = bad.join(format!("{}-{name}-{}", folder_name(shelf), temporary_name()));
        // Where it cannot even be moved it stays: it will be noticed again, and was not used.
        if make_folder(&bad).is_err() || fs::rename(&path, target).is_err() {
            let _ = fs::remove_file(&path);
        }
    }

    fn make_durable(&self, objects: &[(Shelf, String)]) -> Result<(), SystemError> {
        if objects.len() > SYNC_ONE_BY_ONE {
            return sync_file_system(&self.root);
        }
        let mut folders = BTreeSet::new();
        for (shelf, name) in objects {
            let path = self.path_of(*shelf, name);
            sync_if_there(&path, File::sync_data).map_err(SystemError::at("sync", &path))?;
            folders.extend(path.parent().map(Path::to_owned));
        }
        // The entries that name the files.
        folders.into_iter().try_for_each(|folder| sync_if_there(&folder, File::sync_all).map_err(SystemError::at("sync", &folder)))
    }

    fn has_any(&self, shelf: Shelf) -> bool {
        fs::read_dir(self.root.join(folder_name(shelf))).is_ok_and(|mut entries| entries.next().is_some())
    }
}

/// Another process may have found an object damaged meanwhile and set it aside: then there is nothing to keep.
fn sync_if_there(path: &Path, sync: impl Fn(&File) -> io::Result<()>) -> io::Result<()> {
    match File::open(path) {
        Ok(file) => sync(&file),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
        Err(error) => Err(error),
    }
}

#[cfg(target_os = "linux")]
fn sync_file_system(root: &Path) -> Result<(), SystemError> {
    let folder = File::open(root).map_err(SystemError::at("open", root))?;
    rustix::fs::syncfs(&folder).map_err(|error| SystemError::at("sync", root)(error.into()))
}

#[cfg(not(target_os = "linux"))]
fn sync_file_system(_root: &Path) -> Result<(), SystemError> {
    rustix::fs::sync();
    Ok(())
}

struct FileDraft {
    path: PathBuf,
    file: File,
    root: PathBuf,
    is_kept: bool,
}

impl Write for FileDraft {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.file.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

impl Draft for FileDraft {
    fn keep(mut self: Box<Self>, shelf: Shelf, name: &str) -> Result<(), SystemError> {
        let target = object_path(&self.root, shelf, name);
        let folder = target.parent().expect("objects stand in folders");
        let renamed = fs::rename(&self.path, &target).or_else(|error| match error.kind() {
            io::ErrorKind::NotFound => {
                make_folder(folder).map_err(|error| error.source)?;
                fs::rename(&self.path, &target)
            }
            // A folder stands where the object belongs.
            io::ErrorKind::IsADirectory => {
                let bad = self.root.join("bad");
                make_folder(&bad).map_err(|error| error.source)?;
                fs::rename(&target, bad.join(temporary_name()))?;
                fs::rename(&self.path, &target)
            }
            _ => Err(error),
        });
        renamed.map_err(SystemError::at("write", target))?;
        self.is_kept = true;
        Ok(())
    }

    fn path(&self) -> PathBuf {
        self.path.clone()
    }
}

impl Drop for FileDraft {
    fn drop(&mut self) {
        if !self.is_kept {
            let _ = fs::remove_file(&self.path);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::{PermissionsExt, symlink};

    use super::*;

    const NAME: &str = "abcd";

    fn put(store: &FolderStore, bytes: &[u8]) {
        let mut draft = store.draft().unwrap();
        draft.write_all(bytes).unwrap();
        draft.keep(Shelf::Blobs, NAME).unwrap();
    }

    fn get(store: &FolderStore) -> io::Result<Vec<u8>> {
        let mut bytes = Vec::new();
        store.open(Shelf::Blobs, NAME)?.read_to_end(&mut bytes)?;
        Ok(bytes)
    }

    #[test]
    fn an_object_is_there_once_it_is_kept() {
        let folder = tempfile::tempdir().unwrap();
        let store = FolderStore::at(folder.path().join("store"));
        assert_eq!(get(&store).unwrap_err().kind(), io::ErrorKind::NotFound);
        assert!(!folder.path().join("store").exists(), "looking makes no folder");
        put(&store, b"one");
        put(&store, b"two");
        assert_eq!(get(&store).unwrap(), b"two");
        store.make_durable(&[(Shelf::Blobs, NAME.into())]).unwrap();
        sync_file_system(&store.root).unwrap();
    }

    #[test]
    fn a_draft_that_is_not_kept_leaves_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let store = FolderStore::at(folder.path());
        drop(store.draft().unwrap());
        assert_eq!(fs::read_dir(folder.path().join("v1/tmp")).unwrap().count(), 0);
    }

    #[test]
    fn folders_are_private_and_marked_as_a_cache() {
        let folder = tempfile::tempdir().unwrap();
        let store = FolderStore::at(folder.path().join("store"));
        put(&store, b"x");
        let mode = fs::metadata(folder.path().join("store/v1/cas/ab")).unwrap().permissions().mode();
        assert_eq!(mode & 0o777, 0o700);
        assert!(fs::read_to_string(folder.path().join("store/CACHEDIR.TAG")).unwrap().starts_with("Signature: 8a477f597d28d172"));
    }

    #[test]
    fn links_pipes_and_folders_are_not_read_and_give_way() {
        let folder = tempfile::tempdir().unwrap();
        let store = FolderStore::at(folder.path());
        put(&store, b"x");
        let path = store.path_of(Shelf::Blobs, NAME);
        let secret = folder.path().join("secret");
        fs::write(&secret, "x").unwrap();

        let tricks: [&dyn Fn(); 3] = [&|| symlink(&secret, &path).unwrap(), &|| fs::create_dir(&path).unwrap(), &|| {
            rustix::fs::mknodat(rustix::fs::CWD, &path, rustix::fs::FileType::Fifo, rustix::fs::Mode::RUSR, 0).unwrap();
        }];
        for trick in tricks {
            fs::remove_file(&path).unwrap();
            trick();
            assert_ne!(get(&store).unwrap_err().kind(), io::ErrorKind::NotFound);
            put(&store, b"good");
            assert_eq!(get(&store).unwrap(), b"good");
        }
        assert_eq!(fs::read_to_string(secret).unwrap(), "x");
    }

    #[test]
    fn what_is_set_aside_is_kept_for_a_look() {
        let folder = tempfile::tempdir().unwrap();
        let store = FolderStore::at(folder.path());
        put(&store, b"x");
        store.set_aside(Shelf::Blobs, NAME);
        assert_eq!(get(&store).unwrap_err().kind(), io::ErrorKind::NotFound);
        assert_eq!(fs::read_dir(folder.path().join("v1/bad")).unwrap().count(), 1);
    }
}

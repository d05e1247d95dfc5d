//! A store in a local folder, private to its user.
//!
//! `cas/ab/<digest>`, `ac/ab/<key>`, `publications/ab/<key>`, `notes/NAME`; what is being written stands in
//! `tmp`, what was damaged in `damaged`, who computes what in `claims`. The folder comes into being with the first
//! object. Whoever may write to it decides what later runs find, so that one open to others is refused unless
//! that is wanted; objects are hashed when they are read, but records can be forged.

use std::collections::BTreeSet;
use std::fs::Metadata;
use std::io::{self, BufReader, Read, Write};
use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use std::time::{Duration, SystemTime};

use super::claims::Claims;
use super::objects::{Draft, Objects, Shelf};
use crate::engine::digest::READ_SIZE;
use crate::engine::files::{self, PlainFile};
use crate::engine::system::{SystemError, remove_leftovers, temporary_name};

/// Version of the layout; another one is another folder beside this.
const LAYOUT: &str = "v1";

/// Tells back-up programs to leave the folder out (bford.info/cachedir).
const CACHE_TAG: &str = "Signature: 8a477f597d28d172789f06886806bc55\n\
    # This folder is the store of `pipeline`: all in it can be computed again.\n";

/// Beyond so many files one sync of the whole file system is cheaper than a sync of each. Below, it would wait for
/// whatever other programs have written, which on a busy machine takes seconds.
const SYNC_ONE_BY_ONE: usize = 256;

/// An object that is used has its time renewed if it is older than this: collection goes by it.
const RENEWAL: Duration = Duration::from_secs(24 * 3600);

/// Rights of folders that are their user's alone.
const PRIVATE: u32 = 0o700;

/// A store in a local folder.
#[derive(Clone)]
pub struct FolderStore {
    parent: PathBuf,
    layout: Layout,
    is_inspected: bool,
    made: OnceLock<()>,
}

/// Where things stand below the root, and with which rights.
#[derive(Debug, Clone)]
pub struct Layout {
    root: PathBuf,
    folder_mode: u32,
}

impl FolderStore {
    /// The store in `folder`, which need not exist.
    ///
    /// One that belongs to another user, or that others may write to, is refused unless it may be shared.
    pub fn open(folder: impl Into<PathBuf>, may_be_shared: bool) -> Result<Self, SystemError> {
        let mut store = Self::at(folder);
        let status = match files::status(&store.parent) {
            Ok(status) => status,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(store),
            Err(error) => return Err(SystemError::at("use", store.parent)(error)),
        };
        if may_be_shared {
            // What is made in a shared folder is shared with the same people.
            store.layout.folder_mode = if is_open_to_others(&status) { status.mode() & 0o2777 } else { PRIVATE };
        } else {
            store.refuse_strangers()?;
        }
        Ok(store)
    }

    /// The store in `folder`, whoever may write to it.
    pub fn at(folder: impl Into<PathBuf>) -> Self {
        let parent = folder.into();
        Self { layout: Layout { root: parent.join(LAYOUT), folder_mode: PRIVATE }, parent, is_inspected: false, made: OnceLock::new() }
    }

    /// A folder that others may use too, which must be there: what is made in it has the rights that it has.
    pub fn open_remote(folder: impl Into<PathBuf>) -> Result<Self, SystemError> {
        let mut store = Self::at(folder);
        let status = files::status(&store.parent).map_err(SystemError::at("use", &store.parent))?;
        if !status.is_dir() {
            return Err(SystemError::at("use", &store.parent)(io::ErrorKind::NotADirectory.into()));
        }
        store.layout.folder_mode = status.mode() & 0o2777;
        Ok(store)
    }

    /// Whether this process may make objects in it, as far as the rights tell.
    pub fn is_writable(&self) -> bool {
        let folder = if self.layout.root.is_dir() { &self.layout.root } else { &self.parent };
        rustix::fs::access(folder, rustix::fs::Access::WRITE_OK).is_ok()
    }

    /// The same store, its objects only looked at: that does not count as their use.
    #[must_use]
    pub fn for_inspection(mut self) -> Self {
        self.is_inspected = true;
        self
    }

    /// Where things stand.
    pub fn layout(&self) -> &Layout {
        &self.layout
    }

    /// An error if it is not its user's alone.
    pub fn refuse_strangers(&self) -> Result<(), SystemError> {
        let shelves = Shelf::ALL.iter().map(|shelf| self.layout.root.join(shelf.folder_name()));
        let user = rustix::process::geteuid().as_raw();
        for folder in [self.parent.clone(), self.layout.root.clone()].into_iter().chain(shelves) {
            // What is not there, or cannot be looked at, is found out when it is used.
            let Ok(status) = files::status(&folder) else { continue };
            if let Some(what) = danger(&status, user) {
                let advice = "if that is meant to be so, pass `--allow-shared-store` (of a remote store, `--store-trust` does too)";
                return Err(SystemError::at("use", &folder)(io::Error::other(format!("{what}; {advice}"))));
            }
        }
        Ok(())
    }

    /// Makes the folder when something is first written.
    fn prepare(&self) -> Result<(), SystemError> {
        if self.made.get().is_some() {
            return Ok(());
        }
        self.layout.make_above().map_err(SystemError::at("create", &self.layout.root))?;
        let temporary = self.layout.temporary();
        self.layout.make_folders(&temporary).map_err(SystemError::at("create", &temporary))?;
        let tag = self.parent.join("CACHEDIR.TAG");
        match PlainFile::create(tag.clone(), self.layout.file_mode()).and_then(|mut file| file.write_all(CACHE_TAG.as_bytes())) {
            Err(error) if error.kind() != io::ErrorKind::AlreadyExists => return Err(SystemError::at("write", tag)(error)),
            _ => {}
        }
        let _ = self.made.set(());
        Ok(())
    }
}

/// Why a folder is not its user's alone.
fn danger(status: &Metadata, user: u32) -> Option<String> {
    let owner = status.uid();
    if owner != user && owner != 0 {
        return Some(format!("it belongs to another user (number {owner})"));
    }
    let mode = status.permissions().mode() & 0o777;
    is_open_to_others(status).then(|| format!("others may write to it (mode {mode:03o}): `chmod -R go-w` makes it private"))
}

fn is_open_to_others(status: &Metadata) -> bool {
    status.permissions().mode() & 0o022 != 0
}

impl Layout {
    /// The folder of this version's objects.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// Where what is being written stands.
    pub fn temporary(&self) -> PathBuf {
        self.root.join("tmp")
    }

    /// Where damaged objects are kept for a look.
    pub fn damaged(&self) -> PathBuf {
        self.root.join("damaged")
    }

    /// Where claims stand.
    pub fn claims(&self) -> PathBuf {
        self.root.join("claims")
    }

    /// Where an object stands.
    pub fn path_of(&self, shelf: Shelf, name: &str) -> PathBuf {
        let folder = self.root.join(shelf.folder_name());
        match shelf {
            Shelf::Notes | Shelf::Runs => folder.join(name),
            // 256 folders keep each short enough for any file system.
            _ => folder.join(&name[..2]).join(name),
        }
    }

    fn claims_of_runs(&self) -> Claims {
        Claims::in_folder(self.claims(), self.folder_mode)
    }

    fn file_mode(&self) -> u32 {
        self.folder_mode & 0o666
    }

    /// Makes the root and what is above it.
    fn make_above(&self) -> io::Result<()> {
        if files::status(&self.root).is_ok_and(|status| status.is_dir()) {
            return Ok(());
        }
        let missing: Vec<&Path> = self.root.ancestors().take_while(|folder| files::status(folder).is_err()).collect();
        missing.into_iter().rev().filter(|folder| !folder.as_os_str().is_empty()).try_for_each(|folder| self.make_folder(folder))
    }

    /// Makes a folder below the root and those between; what stands in the way is set aside.
    fn make_folders(&self, folder: &Path) -> io::Result<()> {
        let below: Vec<&Path> = folder.ancestors().take_while(|above| *above != self.root).collect();
        below.into_iter().rev().try_for_each(|folder| {
            self.make_folder(folder)?;
            if files::link_status(folder)?.is_dir() {
                return Ok(());
            }
            self.move_away(folder, "folder")?;
            self.make_folder(folder)
        })
    }

    fn make_folder(&self, folder: &Path) -> io::Result<()> {
        match files::make_folder(folder, self.folder_mode) {
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => Ok(()),
            made => made,
        }
    }

    /// Moves something among the damaged objects; `name` begins its name there.
    pub fn move_away(&self, path: &Path, name: &str) -> io::Result<PathBuf> {
        let damaged = self.damaged();
        self.make_folder(&damaged)?;
        let target = damaged.join(format!("{name}-{}", temporary_name()));
        files::rename(path, &target)?;
        Ok(target)
    }
}

impl Objects for FolderStore {
    fn open(&self, shelf: Shelf, name: &str) -> io::Result<Box<dyn Read + Send>> {
        let file = PlainFile::open(self.layout.path_of(shelf, name))?;
        if shelf != Shelf::Notes && !self.is_inspected {
            renew(&file);
        }
        Ok(Box::new(BufReader::with_capacity(READ_SIZE, file)))
    }

    fn has(&self, shelf: Shelf, name: &str) -> bool {
        files::link_status(&self.layout.path_of(shelf, name)).is_ok()
    }

    fn length(&self, shelf: Shelf, name: &str) -> Option<u64> {
        files::link_status(&self.layout.path_of(shelf, name)).ok().map(|status| status.len())
    }

    fn draft(&self) -> Result<Box<dyn Draft>, SystemError> {
        self.prepare()?;
        let path = self.layout.temporary().join(temporary_name());
        let create = || PlainFile::create(path.clone(), self.layout.file_mode());
        let file = create().or_else(|error| match error.kind() {
            io::ErrorKind::NotFound | io::ErrorKind::NotADirectory => {
                self.layout.make_folders(&self.layout.temporary())?;
                create()
            }
            _ => Err(error),
        });
        let file = file.map_err(SystemError::at("create", &path))?;
        Ok(Box::new(FileDraft { file, layout: self.layout.clone(), is_kept: false }))
    }

    fn remove(&self, shelf: Shelf, name: &str) -> io::Result<()> {
        files::remove(&self.layout.path_of(shelf, name))
    }

    fn set_aside(&self, shelf: Shelf, name: &str) -> Option<PathBuf> {
        let path = self.layout.path_of(shelf, name);
        let moved = self.layout.move_away(&path, &format!("{}-{name}", shelf.folder_name())).ok();
        if moved.is_none() {
            // Where it cannot even be removed it stays: it will be noticed again, and was not used.
            let _ = files::remove(&path);
        }
        moved
    }

    fn make_durable(&self, objects: &[(Shelf, String)]) -> Result<(), SystemError> {
        if objects.len() > SYNC_ONE_BY_ONE {
            return files::sync_file_system(&self.layout.root).map_err(SystemError::at("sync", &self.layout.root));
        }
        let mut folders = BTreeSet::new();
        for (shelf, name) in objects {
            let path = self.layout.path_of(*shelf, name);
            if_there(PlainFile::open(path.clone()).and_then(|file| file.sync())).map_err(SystemError::at("sync", &path))?;
            folders.extend(path.ancestors().skip(1).take(2).map(Path::to_owned));
        }
        // The entries that name the files, and those that name the folders.
        let sync = |folder: PathBuf| if_there(files::sync_folder(&folder)).map_err(SystemError::at("sync", folder));
        folders.into_iter().try_for_each(sync)
    }

    fn names(&self, shelf: Shelf, limit: usize) -> io::Result<Vec<String>> {
        let mut names = Vec::new();
        add_names(&self.layout.root.join(shelf.folder_name()), limit, &mut names)?;
        Ok(names)
    }

    fn has_any(&self, shelf: Shelf) -> bool {
        files::list(&self.layout.root.join(shelf.folder_name())).is_ok_and(|mut entries| entries.next().is_some())
    }

    fn claims(&self) -> Option<Claims> {
        Some(self.layout.claims_of_runs())
    }

    fn tidy(&self) {
        remove_leftovers(&self.layout.temporary());
        self.layout.claims_of_runs().remove_dead();
    }
}

/// Names of the files in a folder and in those in it; none if it is not there.
fn add_names(folder: &Path, limit: usize, names: &mut Vec<String>) -> io::Result<()> {
    let entries = match files::list(folder) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
        listed => listed?,
    };
    for entry in entries {
        let entry = entry?;
        match entry.file_name().into_string() {
            _ if names.len() >= limit => return Ok(()),
            _ if entry.file_type()?.is_dir() => add_names(&entry.path(), limit, names)?,
            Ok(name) => names.push(name),
            Err(_) => {}
        }
    }
    Ok(())
}

/// Another process may have found an object damaged meanwhile and set it aside: then there is nothing to keep.
fn if_there(done: io::Result<()>) -> io::Result<()> {
    match done {
        Err(error) if matches!(error.kind(), io::ErrorKind::NotFound | io::ErrorKind::InvalidData) => Ok(()),
        done => done,
    }
}

/// Notes that an object was used. Where that is not allowed, collection goes by an older time.
fn renew(file: &PlainFile) {
    let now = SystemTime::now();
    let modified = file.status().and_then(|status| status.modified());
    if modified.is_ok_and(|modified| now.duration_since(modified).is_ok_and(|age| age > RENEWAL)) {
        let _ = file.set_modified(now);
    }
}

struct FileDraft {
    file: PlainFile,
    layout: Layout,
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
        let target = self.layout.path_of(shelf, name);
        self.put(&target, files::rename).map_err(SystemError::at("write", target))?;
        self.is_kept = true;
        Ok(())
    }

    fn keep_new(self: Box<Self>, shelf: Shelf, name: &str) -> Result<bool, SystemError> {
        // On a file server, a name that is taken by renaming is lost to those who are reading what stood there.
        let target = self.layout.path_of(shelf, name);
        match self.put(&target, files::second_name) {
            // The temporary name goes with the draft.
            Ok(()) => Ok(true),
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => Ok(false),
            // A file system without second names.
            Err(_) => self.keep(shelf, name).map(|()| true),
        }
    }

    fn path(&self) -> PathBuf {
        self.file.path().to_owned()
    }
}

impl FileDraft {
    /// Gives it a name; the folder for it is made if need be.
    fn put(&self, target: &Path, name_it: fn(&Path, &Path) -> io::Result<()>) -> io::Result<()> {
        name_it(self.file.path(), target).or_else(|error| {
            match error.kind() {
                io::ErrorKind::NotFound | io::ErrorKind::NotADirectory => {
                    self.layout.make_folders(target.parent().expect("objects stand in folders"))?;
                }
                // A folder stands where the object belongs.
                io::ErrorKind::IsADirectory => drop(self.layout.move_away(target, "folder")?),
                _ => return Err(error),
            }
            name_it(self.file.path(), target)
        })
    }
}

impl Drop for FileDraft {
    fn drop(&mut self) {
        if !self.is_kept {
            let _ = files::remove(self.file.path());
        }
    }
}

#[cfg(test)]
mod tests {
    use std::fs;
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
        files::sync_file_system(&store.layout.root).unwrap();
    }

    #[test]
    fn an_object_is_never_seen_half() {
        let folder = tempfile::tempdir().unwrap();
        let store = FolderStore::at(folder.path());
        let [one, two] = [vec![1; 400_000], vec![2; 400_000]];
        put(&store, &one);
        let is_over = std::sync::atomic::AtomicBool::new(false);
        std::thread::scope(|scope| {
            scope.spawn(|| {
                (0..100).for_each(|round| put(&store, if round % 2 == 0 { &two } else { &one }));
                is_over.store(true, std::sync::atomic::Ordering::Relaxed);
            });
            while !is_over.load(std::sync::atomic::Ordering::Relaxed) {
                let found = get(&store).unwrap();
                assert!(found == one || found == two, "{} bytes", found.len());
            }
        });
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
        let path = store.layout.path_of(Shelf::Blobs, NAME);
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
        let kept = store.set_aside(Shelf::Blobs, NAME).unwrap();
        assert_eq!(get(&store).unwrap_err().kind(), io::ErrorKind::NotFound);
        assert_eq!(fs::read(kept).unwrap(), b"x");
        assert_eq!(fs::read_dir(folder.path().join("v1/damaged")).unwrap().count(), 1);
        assert_eq!(store.set_aside(Shelf::Blobs, NAME), None, "nothing is there any more");
    }

    #[test]
    fn files_in_the_place_of_folders_give_way() {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path().join("v1");
        for blocked in ["cas/ab", "cas", "tmp"] {
            let store = FolderStore::at(folder.path());
            put(&store, b"x");
            fs::remove_dir_all(root.join(blocked)).unwrap();
            fs::write(root.join(blocked), "in the way").unwrap();
            put(&store, b"good");
            assert_eq!(get(&store).unwrap(), b"good", "{blocked}");
        }
    }

    #[test]
    fn a_store_that_others_may_write_to_is_refused_unless_it_may_be_shared() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("store");
        assert!(FolderStore::open(&path, false).is_ok(), "it is not there yet");
        put(&FolderStore::open(&path, false).unwrap(), b"x");
        assert!(FolderStore::open(&path, false).is_ok());
        for open in ["", "v1", "v1/ac", "v1/cas"] {
            let open = path.join(open);
            fs::create_dir_all(&open).unwrap();
            for mode in [0o770, 0o707] {
                fs::set_permissions(&open, fs::Permissions::from_mode(mode)).unwrap();
                let message = FolderStore::open(&path, false).map(drop).unwrap_err().to_string();
                assert!(message.contains("others may write to it") && message.contains("--allow-shared-store"), "{message}");
                assert!(FolderStore::open(&path, true).is_ok());
            }
            fs::set_permissions(&open, fs::Permissions::from_mode(0o700)).unwrap();
        }
        // What is made in a shared store is shared with the same people.
        fs::set_permissions(&path, fs::Permissions::from_mode(0o2775)).unwrap();
        let shared = FolderStore::open(&path, true).unwrap();
        let mut draft = shared.draft().unwrap();
        draft.write_all(b"shared").unwrap();
        draft.keep(Shelf::Blobs, "cdef").unwrap();
        let mode = |path: &str| fs::metadata(folder.path().join("store/v1").join(path)).unwrap().permissions().mode();
        assert_eq!(mode("cas/cd") & 0o777, 0o775);
        assert_eq!(mode("cas/cd/cdef") & 0o222, 0o200 | (mode("cas/cd/cdef") & 0o020), "never for everyone");
    }

    #[test]
    fn the_store_of_another_user_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let status = fs::metadata(folder.path()).unwrap();
        assert_eq!(danger(&status, status.uid()), None);
        let message = danger(&status, status.uid() + 1);
        assert_eq!(message.is_some(), status.uid() != 0, "that of the super-user is trusted");
    }

    #[test]
    fn an_object_that_is_used_is_young_again() {
        let folder = tempfile::tempdir().unwrap();
        let store = FolderStore::at(folder.path());
        put(&store, b"x");
        let path = store.layout.path_of(Shelf::Blobs, NAME);
        let old = SystemTime::now() - RENEWAL - Duration::from_secs(60);
        fs::File::open(&path).unwrap().set_modified(old).unwrap();
        get(&store).unwrap();
        assert!(fs::metadata(&path).unwrap().modified().unwrap() > old + RENEWAL);
    }
}

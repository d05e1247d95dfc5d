//! Every system call on a file that the engine keeps, so that a test can make each one fail.
//!
//! A call first passes [`faults::point`], which in the program itself is nothing at all. Knows nothing of stores
//! and outputs; what an error means is the caller's affair.

use std::fs::{self, DirBuilder, Metadata, Permissions, ReadDir};
use std::io::{self, Read, Write};
use std::os::unix::fs::{DirBuilderExt, OpenOptionsExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use rustix::fs::{AtFlags, CWD, OFlags, Timespec, Timestamps, UTIME_NOW};

/// An open regular file.
#[derive(Debug)]
pub struct PlainFile {
    file: fs::File,
    path: PathBuf,
}

impl PlainFile {
    /// Opens a file for reading; neither a link nor a pipe that someone put there is followed or waited for.
    ///
    /// `InvalidData` if what stands there is no regular file.
    pub fn open(path: PathBuf) -> io::Result<Self> {
        Self::open_with(path, OFlags::NOFOLLOW | OFlags::NONBLOCK)
    }

    /// Opens a file that a person named, following links; a pipe is not waited for.
    ///
    /// `InvalidData` if what stands there is no regular file.
    pub fn open_named(path: PathBuf) -> io::Result<Self> {
        Self::open_with(path, OFlags::NONBLOCK)
    }

    fn open_with(path: PathBuf, flags: OFlags) -> io::Result<Self> {
        faults::point(&path)?;
        let file = fs::File::options().read(true).custom_flags(flags.bits() as i32).open(&path)?;
        let opened = Self { file, path };
        if !opened.status()?.is_file() {
            return Err(io::Error::new(io::ErrorKind::InvalidData, "not a regular file"));
        }
        Ok(opened)
    }

    /// Makes a file that must not exist yet, for writing.
    pub fn create(path: PathBuf, mode: u32) -> io::Result<Self> {
        faults::point(&path)?;
        let file = fs::File::options().write(true).create_new(true).mode(mode).open(&path)?;
        if mode & 0o077 != 0 {
            // Meant for others, whatever the process masks.
            file.set_permissions(Permissions::from_mode(mode))?;
        }
        Ok(Self { file, path })
    }

    /// A file that was opened by way of its folder.
    pub fn of(file: fs::File, path: PathBuf) -> Self {
        Self { file, path }
    }

    /// What the system says of it.
    pub fn status(&self) -> io::Result<Metadata> {
        faults::point(&self.path)?;
        self.file.metadata()
    }

    /// Returns when its bytes would survive a power cut.
    pub fn sync(&self) -> io::Result<()> {
        faults::point(&self.path)?;
        self.file.sync_data()
    }

    /// Sets the time of its last change.
    pub fn set_modified(&self, time: SystemTime) -> io::Result<()> {
        faults::point(&self.path)?;
        self.file.set_modified(time)
    }

    /// Where it stood when it was opened.
    pub fn path(&self) -> &Path {
        &self.path
    }
}

impl Read for PlainFile {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        faults::point(&self.path)?;
        self.file.read(buffer)
    }
}

impl Write for PlainFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let granted = faults::granted(&self.path, bytes.len())?;
        self.file.write(&bytes[..granted])
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

/// Gives a file another name, in place of what stood there.
pub fn rename(from: &Path, to: &Path) -> io::Result<()> {
    faults::point(to)?;
    fs::rename(from, to)
}

/// Gives a file a second name, which must not exist yet.
pub fn second_name(from: &Path, to: &Path) -> io::Result<()> {
    faults::point(to)?;
    fs::hard_link(from, to)
}

/// Removes a file, a link or a pipe.
pub fn remove(path: &Path) -> io::Result<()> {
    faults::point(path)?;
    fs::remove_file(path)
}

/// What the system says of a path, links followed.
pub fn status(path: &Path) -> io::Result<Metadata> {
    faults::point(path)?;
    fs::metadata(path)
}

/// What the system says of a path, links not followed.
pub fn link_status(path: &Path) -> io::Result<Metadata> {
    faults::point(path)?;
    fs::symlink_metadata(path)
}

/// What stands in a folder.
pub fn list(path: &Path) -> io::Result<ReadDir> {
    faults::point(path)?;
    fs::read_dir(path)
}

/// Makes a folder in one that is there; `mode` is what it gets whatever the process masks.
pub fn make_folder(path: &Path, mode: u32) -> io::Result<()> {
    faults::point(path)?;
    DirBuilder::new().mode(mode).create(path)?;
    if mode & 0o077 == 0 {
        return Ok(());
    }
    faults::point(path)?;
    fs::set_permissions(path, Permissions::from_mode(mode))
}

/// Returns when the names in a folder would survive a power cut.
pub fn sync_folder(path: &Path) -> io::Result<()> {
    faults::point(path)?;
    fs::File::open(path)?.sync_all()
}

/// Returns when all of a file system that was written so far would survive a power cut.
#[cfg(target_os = "linux")]
pub fn sync_file_system(path: &Path) -> io::Result<()> {
    faults::point(path)?;
    Ok(rustix::fs::syncfs(fs::File::open(path)?)?)
}

/// Returns when all of a file system that was written so far would survive a power cut.
#[cfg(not(target_os = "linux"))]
pub fn sync_file_system(path: &Path) -> io::Result<()> {
    faults::point(path)?;
    rustix::fs::sync();
    Ok(())
}

/// Makes a link that must not exist yet.
pub fn link(path: &Path, text: &str) -> io::Result<()> {
    faults::point(path)?;
    std::os::unix::fs::symlink(text, path)
}

/// The text of a link.
pub fn link_text(path: &Path) -> io::Result<PathBuf> {
    faults::point(path)?;
    fs::read_link(path)
}

/// Gives a link, not what it points to, the present time.
pub fn touch_link(path: &Path) -> io::Result<()> {
    faults::point(path)?;
    let now = Timespec { tv_sec: 0, tv_nsec: UTIME_NOW };
    Ok(rustix::fs::utimensat(CWD, path, &Timestamps { last_access: now, last_modification: now }, AtFlags::SYMLINK_NOFOLLOW)?)
}

#[cfg(not(test))]
pub mod faults {
    //! Nothing fails but what the system lets fail.

    use std::io;
    use std::path::Path;

    /// A call on `path` may go on.
    #[inline(always)]
    pub fn point(_path: &Path) -> io::Result<()> {
        Ok(())
    }

    /// How many of so many bytes may be written at once.
    #[inline(always)]
    pub fn granted(_path: &Path, length: usize) -> io::Result<usize> {
        Ok(length)
    }
}

#[cfg(test)]
pub mod faults {
    //! Makes the n-th call below a folder fail.

    use std::io;
    use std::path::{Path, PathBuf};
    use std::sync::{Arc, Mutex};

    use rustix::io::Errno;

    /// What a call is answered with.
    #[derive(Debug, Clone, Copy, PartialEq, Eq)]
    pub enum Fault {
        /// This error.
        Error(Errno),
        /// Of a write, the first byte is taken and all later writes fail with `ENOSPC`; another call fails with `EIO`.
        Short,
    }

    /// Which calls fail.
    #[derive(Debug)]
    struct Rule {
        folder: PathBuf,
        state: Mutex<State>,
    }

    #[derive(Debug)]
    struct State {
        /// Calls so far.
        count: usize,
        /// The call that fails, counted from 1; 0 for none.
        at: usize,
        /// Whether all after it fail too.
        is_lasting: bool,
        fault: Fault,
        is_disk_full: bool,
    }

    static RULES: Mutex<Vec<Arc<Rule>>> = Mutex::new(Vec::new());

    /// Holds while calls below a folder are counted and one of them fails.
    pub struct Faults(Arc<Rule>);

    impl Faults {
        /// The call number `at` below `folder`, and with `is_lasting` all that follow, gets this answer.
        pub fn below(folder: &Path, at: usize, is_lasting: bool, fault: Fault) -> Self {
            let state = Mutex::new(State { count: 0, at, is_lasting, fault, is_disk_full: false });
            let rule = Arc::new(Rule { folder: folder.to_owned(), state });
            RULES.lock().unwrap().push(rule.clone());
            Self(rule)
        }

        /// Calls so far.
        pub fn count(&self) -> usize {
            self.0.state.lock().unwrap().count
        }
    }

    impl Drop for Faults {
        fn drop(&mut self) {
            RULES.lock().unwrap().retain(|rule| !Arc::ptr_eq(rule, &self.0));
        }
    }

    fn next(path: &Path, is_write: bool) -> Option<(Arc<Rule>, Fault)> {
        let rule = RULES.lock().unwrap().iter().find(|rule| path.starts_with(&rule.folder)).cloned()?;
        let mut state = rule.state.lock().unwrap();
        state.count += 1;
        let is_hit = state.at != 0 && (state.count == state.at || (state.is_lasting && state.count > state.at));
        let is_full = is_write && state.is_disk_full;
        let fault = if is_full { Some(Fault::Error(Errno::NOSPC)) } else { is_hit.then_some(state.fault) };
        drop(state);
        Some((rule, fault?))
    }

    /// The answer to a call on `path`.
    pub fn point(path: &Path) -> io::Result<()> {
        match next(path, false) {
            None => Ok(()),
            Some((_, Fault::Error(errno))) => Err(errno.into()),
            Some((_, Fault::Short)) => Err(Errno::IO.into()),
        }
    }

    /// The answer to a write.
    pub fn granted(path: &Path, length: usize) -> io::Result<usize> {
        match next(path, true) {
            None => Ok(length),
            Some((_, Fault::Error(errno))) => Err(errno.into()),
            Some((rule, Fault::Short)) => {
                rule.state.lock().unwrap().is_disk_full = true;
                Ok(length.min(1))
            }
        }
    }
}

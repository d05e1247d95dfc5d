//! Sends finished images to a running tev. If none listens, or it goes away, there is nothing to be said.

use std::collections::HashSet;
use std::fs;
use std::io::Write;
use std::net::{TcpStream, ToSocketAddrs};
use std::path::PathBuf;
use std::sync::mpsc::{Sender, channel};
use std::thread::JoinHandle;
use std::time::Duration;

use crate::engine::events::Event;
use crate::engine::provenance::runs;
use crate::report::tev;

/// Where tev listens unless it is told otherwise.
pub const ADDRESS: &str = tev::ADDRESS;

/// What tev may take to answer, and to take in a message.
const PATIENCE: [Duration; 2] = [Duration::from_millis(300), Duration::from_secs(10)];

/// Extensions of image files, the most faithful first.
const EXTENSIONS: [&str; 5] = ["exr", "pfm", "hdr", "npy", "png"];

/// A viewer that listens, and a thread that sends.
pub struct Viewer {
    /// Folder of the published files.
    folder: PathBuf,
    /// Results that were sent, by their path without its extension.
    sent: HashSet<String>,
    queue: Sender<String>,
    thread: JoinHandle<()>,
}

impl Viewer {
    /// The viewer at that address (`HOST:PORT`), if one listens.
    pub fn connect(address: &str, folder: PathBuf) -> Option<Self> {
        let [to_answer, to_take] = PATIENCE;
        let mut stream = address.to_socket_addrs().ok()?.find_map(|address| TcpStream::connect_timeout(&address, to_answer).ok())?;
        stream.set_write_timeout(Some(to_take)).ok()?;
        let (queue, paths) = channel::<String>();
        let root = folder.clone();
        let send = move || {
            for path in paths {
                let Some(messages) = fs::read(root.join(&path)).ok().and_then(|file| tev::messages(&path, &file)) else { continue };
                if messages.iter().any(|message| stream.write_all(message).is_err()) {
                    return;
                }
            }
        };
        let thread = std::thread::Builder::new().name("viewer".into()).spawn(send).ok()?;
        Some(Self { folder, sent: HashSet::new(), queue, thread })
    }

    /// Takes in what happened: a file that appeared is sent, if it is the first image of its result.
    pub fn notify(&mut self, event: &Event) {
        if let Event::Published { path } = event {
            self.show(path);
        }
    }

    fn show(&mut self, path: &str) {
        let Some((stem, extension)) = path.rsplit_once('.') else { return };
        if EXTENSIONS.contains(&extension) && self.sent.insert(stem.to_owned()) {
            // If the thread has ended, so has the viewer.
            let _ = self.queue.send(path.to_owned());
        }
    }

    /// Sends what stood there already, and waits until all is sent.
    pub fn end(mut self) {
        if let Ok(run) = runs::read(&self.folder.join("manifest.json")) {
            for extension in EXTENSIONS {
                let paths = run.manifest.published.iter().map(|entry| entry.path.as_str());
                paths.filter(|path| path.rsplit('.').next() == Some(extension)).for_each(|path| self.show(path));
            }
        }
        drop(self.queue);
        let _ = self.thread.join();
    }
}

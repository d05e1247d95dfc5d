//! A store in a bucket of a server that speaks S3, for the feature `s3`.
//!
//! The usual variables say where and as whom (`AWS_ENDPOINT_URL`, `AWS_REGION`, `AWS_ACCESS_KEY_ID`, `AWS_SECRET_ACCESS_KEY`, …); without
//! credentials the bucket is only read. Nothing rests on the server's conditions: where it ignores them, the last writer wins, and
//! records of one key say the same. Nothing of the asynchronous runtime is seen outside this file, and no connection is made before it is needed.

use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::PathBuf;
use std::sync::OnceLock;
use std::time::Duration;

use futures_util::StreamExt;
use futures_util::stream::BoxStream;
use object_store::aws::{AmazonS3, AmazonS3Builder};
use object_store::path::Path;
use object_store::{BackoffConfig, ClientConfigKey, ClientOptions, Error, ObjectStore, ObjectStoreExt, PutMode, PutPayload, RetryConfig};
use tokio::runtime::Runtime;

use super::objects::{Draft, Objects, Shelf};
use crate::engine::system::SystemError;

/// Version of the layout, as of a folder.
const LAYOUT: &str = "v1";

/// An object of more bytes is sent in parts of as many.
const PART: usize = 16 << 20;

/// How long a server may be silent.
const SILENCE: Duration = Duration::from_secs(20);

/// How long a call that the server refuses for now is repeated.
const PATIENCE: RetryConfig = RetryConfig {
    backoff: BackoffConfig { init_backoff: Duration::from_millis(100), max_backoff: Duration::from_secs(3), base: 2.0 },
    max_retries: 4,
    retry_timeout: Duration::from_secs(30),
};

/// Any of these gives credentials.
const CREDENTIALS: [&str; 5] = [
    "AWS_ACCESS_KEY_ID",
    "AWS_WEB_IDENTITY_TOKEN_FILE",
    "AWS_CONTAINER_CREDENTIALS_RELATIVE_URI",
    "AWS_CONTAINER_CREDENTIALS_FULL_URI",
    "AWS_METADATA_ENDPOINT",
];

/// Characters of a server's answer that are shown.
const SHOWN: usize = 300;

/// A store in a bucket.
pub struct Bucket {
    url: String,
    prefix: String,
    connection: OnceLock<Connection>,
}

struct Connection {
    server: AmazonS3,
    runtime: Runtime,
}

impl Bucket {
    /// The store at `s3://BUCKET/PREFIX`; asks no one yet.
    pub fn open(url: &str) -> Result<Self, SystemError> {
        let prefix = url.trim_start_matches("s3://").split_once('/').map_or("", |(_, prefix)| prefix).trim_matches('/').to_owned();
        let bucket = Self { url: url.to_owned(), prefix, connection: OnceLock::new() };
        // What is wrong with the name or the variables is wrong for every call.
        bucket.builder().build().map_err(in_words).map_err(SystemError::at("use", url))?;
        Ok(bucket)
    }

    /// Whether there are credentials, so that it may be written to.
    pub fn has_credentials(&self) -> bool {
        CREDENTIALS.iter().any(|name| std::env::var_os(name).is_some_and(|value| !value.is_empty()))
    }

    fn builder(&self) -> AmazonS3Builder {
        let is_plain = ["AWS_ENDPOINT_URL_S3", "AWS_ENDPOINT_URL", "AWS_ENDPOINT"]
            .iter()
            .any(|name| std::env::var(name).is_ok_and(|endpoint| endpoint.starts_with("http://")));
        let options = ClientOptions::new()
            .with_timeout_disabled()
            .with_config(ClientConfigKey::ReadTimeout, format!("{} seconds", SILENCE.as_secs()))
            .with_connect_timeout(SILENCE)
            // Whoever names such an address wants it.
            .with_allow_http(is_plain);
        let builder = AmazonS3Builder::from_env().with_url(&self.url).with_client_options(options).with_retry(PATIENCE);
        builder.with_skip_signature(!self.has_credentials())
    }

    fn connection(&self) -> io::Result<&Connection> {
        if let Some(connection) = self.connection.get() {
            return Ok(connection);
        }
        let server = self.builder().build().map_err(in_words)?;
        let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).thread_name("bucket").enable_all().build()?;
        Ok(self.connection.get_or_init(|| Connection { server, runtime }))
    }

    fn call<'c, T, F: Future<Output = Result<T, Error>>>(&'c self, call: impl FnOnce(&'c AmazonS3) -> F) -> io::Result<T> {
        let Connection { server, runtime } = self.connection()?;
        runtime.block_on(call(server)).map_err(in_words)
    }

    fn folder(&self, shelf: Shelf) -> Path {
        Path::from(format!("{}/{LAYOUT}/{}", self.prefix, shelf.folder_name()))
    }

    fn path_of(&self, shelf: Shelf, name: &str) -> Path {
        Path::from(format!("{}/{LAYOUT}/{}/{name}", self.prefix, shelf.folder_name()))
    }
}

/// The error as the system would give it.
fn in_words(error: Error) -> io::Error {
    let kind = match &error {
        Error::NotFound { .. } => io::ErrorKind::NotFound,
        Error::AlreadyExists { .. } | Error::Precondition { .. } => io::ErrorKind::AlreadyExists,
        Error::PermissionDenied { .. } | Error::Unauthenticated { .. } => io::ErrorKind::PermissionDenied,
        Error::NotSupported { .. } | Error::NotImplemented { .. } => io::ErrorKind::Unsupported,
        _ => io::ErrorKind::Other,
    };
    let text = error.to_string().split_whitespace().collect::<Vec<_>>().join(" ");
    let cut = text.char_indices().nth(SHOWN).map_or(text.len(), |(index, _)| index);
    io::Error::new(kind, if cut < text.len() { format!("{}…", &text[..cut]) } else { text })
}

impl Objects for Bucket {
    fn open(&self, shelf: Shelf, name: &str) -> io::Result<Box<dyn Read + Send>> {
        let path = self.path_of(shelf, name);
        let found = self.call(|server| async move { server.get(&path).await })?;
        let runtime = self.connection()?.runtime.handle().clone();
        Ok(Box::new(Incoming { runtime, stream: found.into_stream(), part: bytes::Bytes::new() }))
    }

    fn has(&self, shelf: Shelf, name: &str) -> bool {
        self.length(shelf, name).is_some()
    }

    fn length(&self, shelf: Shelf, name: &str) -> Option<u64> {
        let path = self.path_of(shelf, name);
        self.call(|server| async move { server.head(&path).await }).ok().map(|object| object.size)
    }

    fn draft(&self) -> Result<Box<dyn Draft>, SystemError> {
        let file = tempfile::tempfile().map_err(SystemError::at("create a temporary file for", &self.url))?;
        // A draft outlives the call, and the store is not behind a pointer: it has a connection of its own, which is made cheaply.
        let connection = self.connection().map_err(SystemError::at("use", &self.url))?;
        let (server, runtime) = (connection.server.clone(), connection.runtime.handle().clone());
        let root = format!("{}/{LAYOUT}", self.prefix);
        Ok(Box::new(Outgoing { file, size: 0, server, runtime, root, url: self.url.clone() }))
    }

    fn names(&self, shelf: Shelf, limit: usize) -> io::Result<Vec<String>> {
        let folder = self.folder(shelf);
        self.call(|server| async move {
            let mut names = Vec::new();
            let mut listed = server.list(Some(&folder));
            while names.len() < limit
                && let Some(object) = listed.next().await
            {
                names.extend(object?.location.filename().map(str::to_owned));
            }
            Ok(names)
        })
    }

    fn remove(&self, shelf: Shelf, name: &str) -> io::Result<()> {
        let path = self.path_of(shelf, name);
        self.call(|server| async move { server.delete(&path).await })
    }

    /// A bucket is no place for a look at what is damaged: it is replaced.
    fn set_aside(&self, _shelf: Shelf, _name: &str) -> Option<PathBuf> {
        None
    }

    fn make_durable(&self, _objects: &[(Shelf, String)]) -> Result<(), SystemError> {
        Ok(())
    }

    fn has_any(&self, shelf: Shelf) -> bool {
        self.names(shelf, 1).is_ok_and(|names| !names.is_empty())
    }

    fn tidy(&self) {}

    fn at_once(&self) -> usize {
        32
    }
}

/// An object that is being read.
struct Incoming {
    runtime: tokio::runtime::Handle,
    stream: BoxStream<'static, Result<bytes::Bytes, Error>>,
    part: bytes::Bytes,
}

impl Read for Incoming {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        while self.part.is_empty() {
            match self.runtime.block_on(self.stream.next()) {
                None => return Ok(0),
                Some(part) => self.part = part.map_err(in_words)?,
            }
        }
        let count = buffer.len().min(self.part.len());
        buffer[..count].copy_from_slice(&self.part.split_to(count));
        Ok(count)
    }
}

/// An object that is being written: a nameless file until it is sent.
struct Outgoing {
    file: std::fs::File,
    size: u64,
    server: AmazonS3,
    runtime: tokio::runtime::Handle,
    root: String,
    url: String,
}

impl Write for Outgoing {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let count = self.file.write(bytes)?;
        self.size += count as u64;
        Ok(count)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Outgoing {
    fn send(&mut self, shelf: Shelf, name: &str, mode: PutMode) -> io::Result<()> {
        let path = Path::from(format!("{}/{}/{name}", self.root, shelf.folder_name()));
        self.file.seek(SeekFrom::Start(0))?;
        if self.size > PART as u64 {
            return self.send_in_parts(&path);
        }
        let mut bytes = Vec::with_capacity(self.size as usize);
        self.file.read_to_end(&mut bytes)?;
        self.runtime.block_on(self.server.put_opts(&path, PutPayload::from(bytes), mode.into())).map(drop).map_err(in_words)
    }

    /// Parts become an object all at once, when the last is there.
    fn send_in_parts(&mut self, path: &Path) -> io::Result<()> {
        let mut upload = self.runtime.block_on(self.server.put_multipart(path)).map_err(in_words)?;
        let mut send = || {
            let mut left = self.size;
            while left > 0 {
                let mut part = vec![0; (PART as u64).min(left) as usize];
                self.file.read_exact(&mut part)?;
                left -= part.len() as u64;
                self.runtime.block_on(upload.put_part(PutPayload::from(part))).map_err(in_words)?;
            }
            self.runtime.block_on(upload.complete()).map(drop).map_err(in_words)
        };
        send().inspect_err(|_| drop(self.runtime.block_on(upload.abort())))
    }
}

impl Draft for Outgoing {
    fn keep(mut self: Box<Self>, shelf: Shelf, name: &str) -> Result<(), SystemError> {
        self.send(shelf, name, PutMode::Overwrite).map_err(SystemError::at("write", self.path()))
    }

    fn keep_new(mut self: Box<Self>, shelf: Shelf, name: &str) -> Result<bool, SystemError> {
        match self.send(shelf, name, PutMode::Create) {
            Ok(()) => Ok(true),
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => Ok(false),
            // A server that knows no such condition.
            Err(error) if error.kind() == io::ErrorKind::Unsupported => self.keep(shelf, name).map(|()| true),
            Err(error) => Err(SystemError::at("write", self.path())(error)),
        }
    }

    fn path(&self) -> PathBuf {
        self.url.clone().into()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn objects_stand_below_the_prefix() {
        for (url, expected) in [("s3://b", "v1/ac/x"), ("s3://b/", "v1/ac/x"), ("s3://b/some/where/", "some/where/v1/ac/x")] {
            assert_eq!(Bucket::open(url).unwrap().path_of(Shelf::Results, "x").as_ref(), expected);
        }
    }
}

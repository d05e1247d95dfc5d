//! The texts a pipeline is read from, places in them, and what is found wrong there.
//!
//! A file is read once, with its guards: regular, at most 16 MiB, UTF-8, no NUL. An argument of the
//! command line is a source of its own, so that a value keeps the place from which it came.

use std::collections::{BTreeMap, HashSet};
use std::fs::File;
use std::io::Read;
use std::path::{Component, Path, PathBuf};
use std::sync::Arc;

use super::diagnostic::{Diagnostic, Severity, escape, excerpt, shortened};

/// Largest pipeline file, in bytes.
pub const SIZE_LIMIT: u64 = 16 << 20;

/// A stretch of one line of one source.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
pub struct Place {
    /// Index into [`Sources`].
    pub file: u32,
    /// Line from 1; 0 for the source as a whole.
    pub line: u32,
    /// Column in characters, from 1.
    pub column: u32,
    /// Length in characters.
    pub length: u32,
}

impl Place {
    /// The source as a whole.
    pub fn of_file(file: u32) -> Self {
        Self { file, ..Self::default() }
    }
}

/// Something found at a place, before it is given its excerpt.
#[derive(Debug, Clone)]
pub struct Finding {
    /// How bad it is.
    pub severity: Severity,
    /// Where.
    pub place: Place,
    /// Which stage it concerns; escaped when it is shown.
    pub stage: Option<String>,
    /// What is wrong; built of quoted words.
    pub message: String,
    /// What to do.
    pub hint: Option<String>,
}

impl Finding {
    /// An error.
    pub fn error(place: Place, message: impl Into<String>) -> Self {
        Self { severity: Severity::Error, place, stage: None, message: message.into(), hint: None }
    }

    /// A warning.
    pub fn warning(place: Place, message: impl Into<String>) -> Self {
        Self { severity: Severity::Warning, ..Self::error(place, message) }
    }

    /// With its stage.
    #[must_use]
    pub fn in_stage(self, stage: &str) -> Self {
        Self { stage: Some(stage.to_owned()), ..self }
    }

    /// With what to do, where that can be said.
    #[must_use]
    pub fn with_hint(self, hint: Option<String>) -> Self {
        Self { hint, ..self }
    }
}

/// `did you mean `x`?`, where there is a nearest word.
pub fn did_you_mean(nearest: Option<&str>) -> Option<String> {
    nearest.map(|word| format!("did you mean `{}`?", shortened(word)))
}

/// Most findings that are kept: beyond, the first ones are to be repaired first.
const FINDING_LIMIT: usize = 200;

/// All findings, each once.
#[derive(Debug, Default)]
pub struct Findings {
    list: Vec<Finding>,
    seen: HashSet<(Place, String)>,
    error_count: usize,
}

impl Findings {
    /// Takes one in, unless it stands there already.
    pub fn add(&mut self, finding: Finding) {
        let is_error = finding.severity == Severity::Error;
        if !self.seen.insert((finding.place, finding.message.clone())) {
            return;
        }
        self.error_count += usize::from(is_error);
        self.list.push(finding);
    }

    /// Takes many in.
    pub fn extend(&mut self, findings: impl IntoIterator<Item = Finding>) {
        findings.into_iter().for_each(|finding| self.add(finding));
    }

    /// All of them, as they came.
    pub fn list(&self) -> &[Finding] {
        &self.list
    }

    /// How many errors there are.
    pub fn error_count(&self) -> usize {
        self.error_count
    }

    /// Whether more need not be looked for.
    pub fn is_full(&self) -> bool {
        self.error_count >= FINDING_LIMIT
    }
}

/// One text.
#[derive(Debug)]
pub struct SourceText {
    /// Name in messages.
    pub shown: String,
    /// Path under which it was read; empty for an argument.
    pub path: PathBuf,
    /// The folder to which its paths are relative.
    pub folder: PathBuf,
    /// The text, without a byte-order mark.
    pub text: String,
    /// Whether it is a file and not an argument of the command line.
    is_file: bool,
}

/// All texts, in the order in which they were read.
#[derive(Debug, Default)]
pub struct Sources {
    texts: Vec<SourceText>,
    /// See [`Sources::given`].
    given: Option<Arc<Texts>>,
}

/// Texts of files by the path under which they were read.
pub type Texts = BTreeMap<PathBuf, String>;

impl Sources {
    /// Nothing is read yet. With texts, files are taken from these alone and not from the disk.
    pub fn given(texts: Option<Arc<Texts>>) -> Self {
        Self { texts: Vec::new(), given: texts }
    }

    /// The text of a file, see [`read_text`].
    pub fn read_text(&self, path: &Path) -> Result<String, ReadError> {
        match &self.given {
            Some(texts) => texts.get(path).cloned().ok_or_else(|| ReadError::whole("is not among the texts of the run")),
            None => read_text(path),
        }
    }

    /// Forgets what was read.
    pub fn clear(&mut self) {
        self.texts.clear();
    }

    /// Adds a file.
    pub fn add_file(&mut self, path: &Path, text: String) -> u32 {
        let folder = path.parent().unwrap_or(Path::new("")).to_owned();
        self.add(SourceText { shown: path.display().to_string(), path: path.to_owned(), folder, text, is_file: true })
    }

    /// Adds an argument of the command line; `flag` stands before it in messages.
    pub fn add_argument(&mut self, flag: &str, text: &str) -> u32 {
        let shown = format!("{flag} {text}");
        self.add(SourceText { shown, path: PathBuf::new(), folder: PathBuf::new(), text: String::new(), is_file: false })
    }

    fn add(&mut self, source: SourceText) -> u32 {
        self.texts.push(source);
        u32::try_from(self.texts.len() - 1).expect("far fewer files than 2^32")
    }

    /// The source of that index.
    pub fn get(&self, file: u32) -> &SourceText {
        &self.texts[file as usize]
    }

    /// The source of that index, to be changed.
    pub fn text_mut(&mut self, file: u32) -> &mut SourceText {
        &mut self.texts[file as usize]
    }

    /// The files, without the arguments.
    pub fn files(&self) -> impl Iterator<Item = &SourceText> {
        self.texts.iter().filter(|source| source.is_file)
    }

    /// Whether it is a file and not an argument.
    pub fn is_file(&self, file: u32) -> bool {
        self.texts.get(file as usize).is_some_and(|source| source.is_file)
    }

    /// The findings in the order of the text, with their excerpts: errors and warnings.
    pub fn diagnostics(&self, findings: Findings) -> (Vec<Diagnostic>, Vec<Diagnostic>) {
        let mut list = findings.list;
        list.sort_by_key(|finding| (finding.place.file, finding.place.line, finding.place.column));
        let mut lines = BTreeMap::new();
        let (mut errors, mut warnings) = (Vec::new(), Vec::new());
        let mut left_out = 0;
        for finding in list {
            let is_error = finding.severity == Severity::Error;
            let kept = if is_error { &mut errors } else { &mut warnings };
            if kept.len() < FINDING_LIMIT {
                kept.push(self.diagnostic(finding, &mut lines));
            } else {
                left_out += usize::from(is_error);
            }
        }
        if left_out > 0 {
            errors.push(Diagnostic::of_file("", format!("{left_out} more errors are not shown; repair the first ones")));
        }
        (errors, warnings)
    }

    fn diagnostic<'a>(&'a self, finding: Finding, lines: &mut BTreeMap<u32, Vec<&'a str>>) -> Diagnostic {
        let Finding { severity, place, stage, message, hint } = finding;
        let Some(source) = self.texts.get(place.file as usize) else {
            return Diagnostic { severity, stage, hint, ..Diagnostic::of_file("", message) };
        };
        let stage = stage.map(|name| shortened(&name));
        let shown = Diagnostic { severity, stage, hint, ..Diagnostic::of_file(&shortened_path(&source.shown), message) };
        if place.line == 0 || !self.is_file(place.file) {
            return shown;
        }
        let lines = lines.entry(place.file).or_insert_with(|| lines_of(&source.text));
        let (column, length) = (place.column as usize, place.length.max(1) as usize);
        let line = lines.get(place.line as usize - 1).copied().filter(|_| !source.text.is_empty());
        let excerpt = line.map(|line| excerpt(line, column, length));
        Diagnostic { line: place.line as usize, column, length, excerpt, ..shown }
    }
}

/// Longest file name in a message, in characters.
const PATH_LENGTH: usize = 300;

fn shortened_path(path: &str) -> String {
    let count = path.chars().count();
    if count <= PATH_LENGTH { path.to_owned() } else { format!("…{}", path.chars().skip(count - PATH_LENGTH).collect::<String>()) }
}

/// The lines of a text by YAML's line breaks: LF, CR LF, CR.
fn lines_of(text: &str) -> Vec<&str> {
    let mut lines = Vec::new();
    for line in text.split('\n') {
        let line = line.strip_suffix('\r').unwrap_or(line);
        lines.extend(line.split('\r'));
    }
    lines
}

/// A path without `.` and, where it can be said from the text alone, without `..`.
pub fn without_dots(path: &Path) -> PathBuf {
    let mut clean = PathBuf::new();
    for component in path.components() {
        let is_in_folder = matches!(clean.components().next_back(), Some(Component::Normal(_)));
        match component {
            Component::CurDir => {}
            Component::ParentDir if is_in_folder => {
                clean.pop();
            }
            // Above the root there is only the root.
            Component::ParentDir if clean.has_root() => {}
            component => clean.push(component),
        }
    }
    clean
}

/// A file that cannot be taken for a pipeline's text.
#[derive(Debug)]
pub struct ReadError {
    /// What is wrong.
    pub message: String,
    /// Line and column, where one can be said.
    pub position: Option<(u32, u32)>,
}

impl ReadError {
    fn whole(message: impl Into<String>) -> Self {
        Self { message: message.into(), position: None }
    }
}

/// Reads a pipeline file: regular, at most 16 MiB, UTF-8 with or without a byte-order mark, no NUL.
fn read_text(path: &Path) -> Result<String, ReadError> {
    let said = |error: std::io::Error| ReadError::whole(unreadable(&error));
    let metadata = std::fs::metadata(path).map_err(said)?;
    if metadata.is_dir() {
        return Err(ReadError::whole("is a directory, not a file"));
    }
    if !metadata.is_file() {
        return Err(ReadError::whole("is not a regular file"));
    }
    let too_large = || ReadError::whole(format!("is larger than the limit of {} MiB for a pipeline file", SIZE_LIMIT >> 20));
    if metadata.len() > SIZE_LIMIT {
        return Err(too_large());
    }
    let mut bytes = Vec::with_capacity(metadata.len() as usize + 1);
    File::open(path).and_then(|file| file.take(SIZE_LIMIT + 1).read_to_end(&mut bytes)).map_err(said)?;
    if bytes.len() as u64 > SIZE_LIMIT {
        return Err(too_large());
    }
    decoded(bytes)
}

/// What the system says of a file that cannot be read, without its numbers.
pub fn unreadable(error: &std::io::Error) -> String {
    use std::io::ErrorKind;
    match error.kind() {
        ErrorKind::NotFound => "no such file".to_owned(),
        ErrorKind::PermissionDenied => "is not readable: permission denied".to_owned(),
        ErrorKind::InvalidFilename => "is too long for a file name".to_owned(),
        ErrorKind::NotADirectory => "no such file: a part of its path is not a directory".to_owned(),
        _ => format!("is not readable: {}", escape(&error.to_string())),
    }
}

fn decoded(mut bytes: Vec<u8>) -> Result<String, ReadError> {
    if bytes.starts_with(&[0xff, 0xfe]) || bytes.starts_with(&[0xfe, 0xff]) {
        return Err(ReadError::whole("is UTF-16 or UTF-32; a pipeline file is UTF-8"));
    }
    if bytes.starts_with(b"\xef\xbb\xbf") {
        bytes.drain(..3);
    }
    let text = String::from_utf8(bytes).map_err(|error| {
        let (valid, rest) = error.as_bytes().split_at(error.utf8_error().valid_up_to());
        let message = format!("byte 0x{:02x} is not UTF-8; a pipeline file is UTF-8", rest[0]);
        ReadError { message, position: Some(position_after(valid)) }
    })?;
    if let Some(index) = text.bytes().position(|byte| byte == 0) {
        return Err(ReadError { message: "contains a NUL character".into(), position: Some(position_after(&text.as_bytes()[..index])) });
    }
    Ok(text)
}

fn position_after(bytes: &[u8]) -> (u32, u32) {
    let line = bytes.iter().filter(|byte| **byte == b'\n').count();
    let start = bytes.iter().rposition(|byte| *byte == b'\n').map_or(0, |index| index + 1);
    let column = String::from_utf8_lossy(&bytes[start..]).chars().count();
    (line as u32 + 1, column as u32 + 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_that_is_not_utf8_is_refused_at_its_place() {
        assert_eq!(decoded(b"a\nb\xffc".to_vec()).unwrap_err().position, Some((2, 2)));
        assert_eq!(decoded(b"a\nbc\0".to_vec()).unwrap_err().position, Some((2, 3)));
        assert!(decoded(b"\xff\xfea\0".to_vec()).unwrap_err().message.contains("UTF-16"));
        assert_eq!(decoded("\u{feff}a".into()).unwrap(), "a");
    }

    #[test]
    fn dots_are_taken_out_of_a_path() {
        for (path, expected) in [("a/./b/../c", "a/c"), ("../a", "../a"), ("/../a", "/a"), ("a/../../b", "../b")] {
            assert_eq!(without_dots(Path::new(path)), Path::new(expected), "{path}");
        }
    }

    #[test]
    fn a_finding_is_kept_once() {
        let mut findings = Findings::default();
        findings.add(Finding::error(Place::default(), "wrong"));
        findings.add(Finding::error(Place::default(), "wrong"));
        findings.add(Finding::warning(Place::default(), "odd"));
        assert_eq!(findings.error_count(), 1);
    }
}

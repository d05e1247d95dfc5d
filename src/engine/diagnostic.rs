//! Messages to the person who has to repair a pipeline file: what is wrong, where, and what to do.
//!
//! Text from files and arguments is hostile until it has passed [`escape`]; every message is built of
//! [`quoted`] pieces, and the excerpt is escaped and cut here. Knows nothing of what can be wrong.

use std::fmt::Write;
use std::ops::Range;

use annotate_snippets::renderer::DecorStyle;
use annotate_snippets::{AnnotationKind, Group, Level, Renderer, Snippet};
use serde_json::{Value as Json, json};

/// How bad it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Severity {
    /// Nothing runs.
    Error,
    /// Worth a look.
    Warning,
}

impl Severity {
    /// The word that begins the message.
    pub fn word(self) -> &'static str {
        match self {
            Severity::Error => "error",
            Severity::Warning => "warning",
        }
    }
}

/// One message. All texts are escaped already.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Diagnostic {
    /// How bad it is.
    pub severity: Severity,
    /// The file, or the argument of the command line; empty where there is neither.
    pub file: String,
    /// Line, from 1; 0 where the message concerns the file or the argument as a whole.
    pub line: usize,
    /// Column in characters, from 1; 0 like the line.
    pub column: usize,
    /// Characters at fault; at least one where there is a column.
    pub length: usize,
    /// The line itself, cut around the column where it is long.
    pub excerpt: Option<Excerpt>,
    /// The stage it is about.
    pub stage: Option<String>,
    /// What is wrong.
    pub message: String,
    /// What to do.
    pub hint: Option<String>,
}

/// A line of a file as it is shown.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Excerpt {
    /// The line or a part of it, escaped.
    pub text: String,
    /// Bytes of `text` that are at fault.
    pub marked: Range<usize>,
}

impl Diagnostic {
    /// An error about a file or an argument as a whole.
    pub fn of_file(file: &str, message: impl Into<String>) -> Self {
        Self {
            severity: Severity::Error,
            file: escape(file),
            line: 0,
            column: 0,
            length: 0,
            excerpt: None,
            stage: None,
            message: message.into(),
            hint: None,
        }
    }

    /// `FILE:LINE:COLUMN: stage `NAME`: MESSAGE`, without the word `error`.
    pub fn title(&self) -> String {
        let mut title = String::new();
        if !self.file.is_empty() {
            title.push_str(&self.file);
            if self.line > 0 {
                write!(title, ":{}:{}", self.line, self.column).expect("writing to a String");
            }
            title.push_str(": ");
        }
        if let Some(stage) = &self.stage {
            write!(title, "stage `{stage}`: ").expect("writing to a String");
        }
        title + &self.message
    }

    /// The same for programs.
    pub fn to_json(&self) -> Json {
        let place = |number: usize| if number == 0 { Json::Null } else { json!(number) };
        json!({
            "severity": self.severity.word(),
            "file": self.file,
            "line": place(self.line),
            "column": place(self.column),
            "length": place(self.length),
            "excerpt": self.excerpt.as_ref().map(|excerpt| &excerpt.text),
            "stage": self.stage,
            "message": self.message,
            "hint": self.hint,
        })
    }
}

/// All messages as text for a terminal, each with its excerpt and hint, an empty line between two.
pub fn render(diagnostics: &[Diagnostic], color: bool) -> String {
    let renderer = if color { Renderer::styled() } else { Renderer::plain() };
    let renderer = renderer.decor_style(DecorStyle::Ascii);
    let texts: Vec<String> = diagnostics.iter().map(|diagnostic| rendered(&renderer, diagnostic)).collect();
    texts.join("\n\n") + if texts.is_empty() { "" } else { "\n" }
}

fn rendered(renderer: &Renderer, diagnostic: &Diagnostic) -> String {
    let level = match diagnostic.severity {
        Severity::Error => Level::ERROR,
        Severity::Warning => Level::WARNING,
    };
    let title = level.primary_title(diagnostic.title());
    let mut groups = vec![match &diagnostic.excerpt {
        Some(excerpt) => {
            let marked = AnnotationKind::Primary.span(excerpt.marked.clone());
            title.element(Snippet::source(excerpt.text.as_str()).line_start(diagnostic.line).annotation(marked))
        }
        None => Group::with_title(title),
    }];
    let Some(hint) = &diagnostic.hint else {
        return renderer.render(&groups);
    };
    let hint = Group::with_title(Level::HELP.with_name("hint").secondary_title(hint.as_str()));
    if diagnostic.excerpt.is_none() {
        // Together they would be joined by an empty margin.
        return format!("{}\n{}", renderer.render(&groups), renderer.render(&[hint]));
    }
    groups.push(hint);
    renderer.render(&groups)
}

/// Longest part of a line that is shown, in characters.
const EXCERPT_LENGTH: usize = 120;

/// Cuts and escapes a line; `column` counts characters from 1.
pub fn excerpt(line: &str, column: usize, length: usize) -> Excerpt {
    let start = column.saturating_sub(1);
    let first = if line.chars().count() <= EXCERPT_LENGTH { 0 } else { start.saturating_sub(EXCERPT_LENGTH / 3) };
    let mut text = String::from(if first > 0 { "…" } else { "" });
    let (mut from, mut to) = (None, None);
    let mut shown_count = 0;
    for (index, character) in line.chars().enumerate().skip(first).take(EXCERPT_LENGTH) {
        if index == start {
            from = Some(text.len());
        }
        if index == start + length {
            to = Some(text.len());
        }
        push_escaped(&mut text, character);
        shown_count += 1;
    }
    let end = text.len();
    if line.chars().nth(first + shown_count).is_some() {
        text.push('…');
    }
    let from = from.unwrap_or(end);
    Excerpt { marked: from..to.unwrap_or(end).max(from), text }
}

/// Text that is safe on a terminal: no control, bidi or invisible characters.
pub fn escape(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    text.chars().for_each(|character| push_escaped(&mut escaped, character));
    escaped
}

fn push_escaped(text: &mut String, character: char) {
    match character {
        '\n' => text.push_str("\\n"),
        '\r' => text.push_str("\\r"),
        '\t' => text.push_str("\\t"),
        character if is_hidden(character) => text.extend(character.escape_unicode()),
        character => text.push(character),
    }
}

/// C0, C1, DEL, bidi controls, zero-width and other characters that change a text without being seen.
fn is_hidden(character: char) -> bool {
    character.is_control()
        || matches!(character,
            '\u{ad}' | '\u{61c}' | '\u{180e}' | '\u{200b}'..='\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2060}'..='\u{206f}'
            | '\u{feff}' | '\u{fff9}'..='\u{fffb}' | '\u{e0000}'..='\u{e007f}')
}

/// Longest word in a message, in characters.
const WORD_LENGTH: usize = 80;

/// A word of a file in backticks, escaped and cut.
pub fn quoted(word: &str) -> String {
    format!("`{}`", shortened(word))
}

/// A word of a file, escaped and cut in the middle where it is long.
pub fn shortened(word: &str) -> String {
    let count = word.chars().count();
    if count <= WORD_LENGTH {
        return escape(word);
    }
    let head: String = word.chars().take(WORD_LENGTH * 3 / 4).collect();
    let tail: String = word.chars().skip(count - WORD_LENGTH / 4).collect();
    format!("{}…{}", escape(&head), escape(&tail))
}

/// `a`, `a or b`, `a, b or c`.
pub fn listed<T: AsRef<str>>(words: &[T], last: &str) -> String {
    match words {
        [] => String::new(),
        [only] => only.as_ref().to_owned(),
        [start @ .., end] => {
            let start: Vec<&str> = start.iter().map(AsRef::as_ref).collect();
            format!("{} {last} {}", start.join(", "), end.as_ref())
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_message_shows_place_excerpt_and_hint() {
        let line = "  sphere: { relight: { smaples: 3 } }";
        let diagnostic = Diagnostic {
            line: 14,
            column: 24,
            length: 7,
            excerpt: Some(excerpt(line, 24, 7)),
            stage: Some("sphere".into()),
            hint: Some("did you mean `samples`?".into()),
            ..Diagnostic::of_file("pipelines/coursework.yaml", "unknown parameter `smaples`")
        };
        let expected = "\
error: pipelines/coursework.yaml:14:24: stage `sphere`: unknown parameter `smaples`
   |
14 |   sphere: { relight: { smaples: 3 } }
   |                        ^^^^^^^
   |
hint: did you mean `samples`?
";
        assert_eq!(render(&[diagnostic], false), expected);
    }

    #[test]
    fn nothing_hidden_reaches_the_terminal() {
        assert_eq!(escape("a\u{1b}[31m\u{202e}b\u{200b}\n\u{9b}"), "a\\u{1b}[31m\\u{202e}b\\u{200b}\\n\\u{9b}");
        let shown = excerpt("x: \u{1b}[2J bad", 9, 3);
        assert_eq!(&shown.text[shown.marked.clone()], "bad");
    }

    #[test]
    fn a_long_line_is_cut_around_its_fault() {
        let line = format!("{}FAULT{}", "x".repeat(300_000), "y".repeat(300_000));
        let shown = excerpt(&line, 300_001, 5);
        assert_eq!(&shown.text[shown.marked.clone()], "FAULT");
        assert!(shown.text.chars().count() <= EXCERPT_LENGTH + 2);
    }

    #[test]
    fn a_long_word_is_cut() {
        assert_eq!(shortened(&"k".repeat(2000)).chars().count(), WORD_LENGTH + 1);
    }
}

//! Writing to stdout and stderr: what a closed pipe means, and when there is color.

use std::io::{self, IsTerminal, Write};

use super::Ending;
use crate::engine::diagnostic::{Diagnostic, escape, render};

/// Where people and programs read.
#[derive(Debug, Clone, Copy)]
pub struct Screen {
    /// Whether stderr is a terminal.
    pub is_terminal: bool,
    has_color: bool,
}

impl Screen {
    /// The screen of this process.
    pub fn of_the_process() -> Self {
        let is_terminal = io::stderr().is_terminal();
        // no-color.org: any text but the empty one.
        let no_color = std::env::var_os("NO_COLOR").is_some_and(|value| !value.is_empty());
        Self { is_terminal, has_color: is_terminal && !no_color }
    }

    /// Prints results. A reader that went away has what it wanted.
    pub fn print(&self, text: &str) -> Ending {
        let mut out = io::stdout().lock();
        match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
            Ok(()) => Ending::Done,
            Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Ending::Done,
            Err(error) => {
                self.error(&format!("cannot write to stdout: {error}"), None);
                Ending::System
            }
        }
    }

    /// Says something to a person. If no one can hear it there is no one to tell.
    pub fn say(&self, text: &str) {
        let _ = io::stderr().lock().write_all(text.as_bytes());
    }

    /// Says what is wrong.
    pub fn error(&self, message: &str, hint: Option<&str>) {
        self.message("error", message, hint);
    }

    /// Says what a reader must know.
    pub fn warning(&self, message: &str) {
        self.message("warning", message, None);
    }

    fn message(&self, word: &str, message: &str, hint: Option<&str>) {
        let hint = hint.map(|hint| format!("hint: {}\n", escaped_lines(hint))).unwrap_or_default();
        let (bold, plain) = if self.has_color { (if word == "error" { "\x1b[1;31m" } else { "\x1b[1;33m" }, "\x1b[0m") } else { ("", "") };
        self.say(&format!("{bold}{word}{plain}: {}\n{hint}", escaped_lines(message)));
    }

    /// Shows messages about a pipeline file, to a person or to a program.
    pub fn show(&self, diagnostics: &[Diagnostic], as_json: bool) -> Ending {
        if as_json {
            return self.print(&json_text(&serde_json::json!({ "diagnostics": diagnostics_json(diagnostics) })));
        }
        if !diagnostics.is_empty() {
            self.say(&render(diagnostics, self.has_color));
        }
        Ending::Done
    }
}

/// The messages for programs.
pub fn diagnostics_json(diagnostics: &[Diagnostic]) -> Vec<serde_json::Value> {
    diagnostics.iter().map(Diagnostic::to_json).collect()
}

/// JSON as it is printed.
pub fn json_text(value: &impl serde::Serialize) -> String {
    format!("{}\n", serde_json::to_string_pretty(value).expect("what is printed is plain data"))
}

/// A text of several lines, each safe on a terminal.
pub fn escaped_lines(text: &str) -> String {
    text.split('\n').map(escape).collect::<Vec<_>>().join("\n")
}

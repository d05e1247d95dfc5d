//! `pipeline init`: a small pipeline with comments, to begin with.

use std::fs::File;
use std::io::{ErrorKind, Write};

use super::Ending;
use super::arguments::InitCommand;
use super::screen::Screen;
use crate::engine::diagnostic::{escape, quoted};

/// The file, but for the name.
const TEXT: &str = include_str!("init.yaml");

/// What stands in the place of the name.
const NAME: &str = "@NAME@";

/// Writes the file unless there is one of that name.
pub fn init(command: &InitCommand, screen: &Screen) -> Ending {
    let name = command.name.strip_suffix(".yaml").unwrap_or(&command.name);
    if !is_name(name) {
        let hint = "use letters, digits, `_` and `-`, up to 64 of them, not beginning with `-`";
        screen.error(&format!("{} is no name of a pipeline", quoted(&command.name)), Some(hint));
        return Ending::Refused;
    }
    let path = format!("{name}.yaml");
    let created = File::create_new(&path).and_then(|mut file| file.write_all(TEXT.replace(NAME, name).as_bytes()));
    match created {
        Ok(()) => screen.print(&format!(
            "{0}\n\nNext:\n  pipeline run {0}      make its figures in outputs/{name}/\n  pipeline plan {0}     after a change: what would run, and why\n",
            escape(&path)
        )),
        Err(error) if error.kind() == ErrorKind::AlreadyExists => {
            screen.error(&format!("`{path}` exists already"), Some("give another name: `pipeline init NAME`"));
            Ending::Refused
        }
        Err(error) => {
            screen.error(&format!("cannot write `{path}`: {error}"), None);
            Ending::System
        }
    }
}

fn is_name(text: &str) -> bool {
    let is_plain = text.bytes().all(|byte| byte.is_ascii_alphanumeric() || b"_-".contains(&byte));
    is_plain && !text.is_empty() && text.len() <= 64 && !text.starts_with('-')
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_is_a_plain_word() {
        assert!(is_name("night-sky_2") && !is_name("") && !is_name("-x") && !is_name("../x") && !is_name("a b"));
    }
}

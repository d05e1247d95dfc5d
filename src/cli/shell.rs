//! `pipeline completions` and `pipeline man`: made of the definitions of the command line itself.

use std::path::Path;

use clap::CommandFactory;

use super::Ending;
use super::arguments::{Arguments, CompletionsCommand, ManCommand, ManFormat};
use super::screen::Screen;
use crate::engine::diagnostic::quoted;
use crate::engine::manual;
use crate::stages::registry;

/// Prints the completions of a shell.
pub fn completions(command: &CompletionsCommand, screen: &Screen) -> Ending {
    let mut text = Vec::new();
    clap_complete::generate(command.shell, &mut Arguments::command(), "pipeline", &mut text);
    screen.print(&String::from_utf8_lossy(&text))
}

/// Prints a page of the manual, or writes all of them.
pub fn man(command: &ManCommand, screen: &Screen) -> Ending {
    if let Some(folder) = &command.dir {
        return write_all(folder, command.format, screen);
    }
    let program = program();
    let Some(name) = &command.command else { return screen.print(&page(&program)) };
    let names: Vec<String> = program.get_subcommands().map(|command| command.get_name().to_owned()).collect();
    match program.get_subcommands().find(|command| command.get_name() == name) {
        Some(command) => screen.print(&page(command)),
        None => {
            screen.error(&format!("there is no command {}", quoted(name)), Some(&format!("the commands are {}", names.join(", "))));
            Ending::Refused
        }
    }
}

fn program() -> clap::Command {
    let mut program = Arguments::command();
    program.build();
    program
}

/// The name of a command's page: `pipeline-run`.
fn name_of(command: &clap::Command) -> String {
    command.get_display_name().unwrap_or_else(|| command.get_name()).to_owned()
}

fn page(command: &clap::Command) -> String {
    let mut text = Vec::new();
    let page = clap_mangen::Man::new(command.clone()).title(name_of(command));
    page.render(&mut text).expect("writing to memory cannot fail");
    String::from_utf8_lossy(&text).into_owned()
}

/// The pages of all commands for `man`, or all pages of the reference: names of files, and texts.
fn all_pages(format: ManFormat) -> Vec<(String, String)> {
    let program = program();
    let commands = program.get_subcommands().chain([&program]);
    match format {
        ManFormat::Roff => commands.map(|command| (format!("{}.1", name_of(command)), page(command))).collect(),
        ManFormat::Markdown => {
            let pages = manual::pages(&registry()).into_iter().map(|page| (format!("{}.md", page.name), page.text));
            pages.chain([("commands.md".to_owned(), commands_page(&program))]).collect()
        }
    }
}

fn write_all(folder: &Path, format: ManFormat, screen: &Screen) -> Ending {
    let written = std::fs::create_dir_all(folder)
        .and_then(|()| all_pages(format).iter().try_for_each(|(name, text)| std::fs::write(folder.join(name), text)));
    match written {
        Ok(()) => Ending::Done,
        Err(error) => {
            screen.error(&format!("cannot write into `{}`: {error}", folder.display()), None);
            Ending::System
        }
    }
}

/// Columns of the help in the book.
const HELP_WIDTH: usize = 100;

/// The help of the program and of each command.
fn commands_page(program: &clap::Command) -> String {
    let mut text = format!("{}\n# The command line\n", manual::GENERATED);
    for command in with_subcommands(program) {
        let help = command.clone().term_width(HELP_WIDTH).render_long_help().to_string();
        let lines: Vec<&str> = help.lines().map(str::trim_end).collect();
        text += &format!("\n## {}\n\n```text\n{}\n```\n", name_of(&command).replace('-', " "), lines.join("\n").trim_end());
    }
    text
}

/// A command and all that stand below it, in the order of the help.
fn with_subcommands(command: &clap::Command) -> Vec<clap::Command> {
    let below = command.get_subcommands().flat_map(with_subcommands);
    std::iter::once(command.clone()).chain(below).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_command_has_a_page_that_shows_its_options() {
        let program = program();
        for command in program.get_subcommands() {
            let text = page(command);
            assert!(text.contains(&format!("pipeline\\-{}", command.get_name().replace('-', "\\-"))), "{text}");
            for option in command.get_arguments().filter_map(clap::Arg::get_long) {
                assert!(text.contains(&format!("\\-\\-{}", option.replace('-', "\\-"))), "{option}");
            }
        }
    }

    #[test]
    fn every_command_and_option_is_explained() {
        for command in program().get_subcommands() {
            assert!(command.get_about().is_some(), "{}", command.get_name());
            for argument in command.get_arguments() {
                assert!(argument.get_help().is_some(), "{} {}", command.get_name(), argument.get_id());
            }
        }
    }
}

//! `pipeline completions` and `pipeline man`: made of the definitions of the command line itself.

use std::path::Path;

use clap::CommandFactory;

use super::Ending;
use super::arguments::{Arguments, CompletionsCommand, ManCommand};
use super::screen::Screen;
use crate::engine::diagnostic::quoted;

/// Prints the completions of a shell.
pub fn completions(command: &CompletionsCommand, screen: &Screen) -> Ending {
    let mut text = Vec::new();
    clap_complete::generate(command.shell, &mut Arguments::command(), "pipeline", &mut text);
    screen.print(&String::from_utf8_lossy(&text))
}

/// Prints a page of the manual, or writes all of them.
pub fn man(command: &ManCommand, screen: &Screen) -> Ending {
    if let Some(folder) = &command.dir {
        return write_all(folder, screen);
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

fn write_all(folder: &Path, screen: &Screen) -> Ending {
    let program = program();
    let pages = program.get_subcommands().chain([&program]);
    let written = std::fs::create_dir_all(folder).and_then(|()| {
        pages.into_iter().try_for_each(|command| {
            let path = folder.join(format!("{}.1", name_of(command)));
            std::fs::write(path, page(command))
        })
    });
    match written {
        Ok(()) => Ending::Done,
        Err(error) => {
            screen.error(&format!("cannot write into `{}`: {error}", folder.display()), None);
            Ending::System
        }
    }
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

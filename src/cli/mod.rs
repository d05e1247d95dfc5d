//! The command line: arguments, progress, messages, exit codes. The only room that prints.

mod arguments;
mod check;
mod diff;
mod images;
mod init;
mod machine;
mod manual;
mod outcomes;
mod plan;
mod progress;
mod report;
mod run;
mod screen;
mod shell;
mod signals;
mod store;
mod team;
mod travel;
mod verify;
mod viewing;
mod watch;
mod which;

use std::process::ExitCode;

use arguments::{Arguments, Command};
use clap::Parser;
use screen::Screen;

/// How a command ended; the numbers are those of the manual.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ending {
    /// All went well, or the reader of our output went away.
    Done,
    /// A job failed, or a file given to be read is bad.
    Failed,
    /// The pipeline file, the command line or a named input is wrong.
    Refused,
    /// The operating system failed us.
    System,
    /// Two things that were compared are not the same.
    Differs,
    /// A signal of that number ended it.
    Interrupted(u8),
}

impl Ending {
    /// The number that the process ends with.
    pub fn code(self) -> u8 {
        match self {
            Ending::Done => 0,
            Ending::Failed => 1,
            Ending::Refused => 2,
            Ending::System => 3,
            Ending::Differs => 4,
            Ending::Interrupted(signal) => 128 + signal,
        }
    }
}

/// Runs the command that the process was given.
pub fn main() -> ExitCode {
    let screen = Screen::of_the_process();
    let ending = match Arguments::try_parse() {
        Ok(arguments) => execute(arguments, &screen),
        Err(error) => explain(&error, &screen),
    };
    ExitCode::from(ending.code())
}

fn execute(arguments: Arguments, screen: &Screen) -> Ending {
    match arguments.command {
        Command::Run(command) if command.dry_run => plan::plan(&command.work, command.format, screen),
        Command::Run(command) => run::run(&command, screen),
        Command::Plan(command) => plan::plan(&command.work, command.format, screen),
        Command::Check(command) => check::check(&command, screen),
        Command::Stages(command) => manual::stages(&command, screen),
        Command::Schema(command) => manual::schema(&command, screen),
        Command::Info(command) => images::info(&command, screen),
        Command::Convert(command) => images::convert(&command, screen),
        Command::Verify(command) => verify::verify(&command, screen),
        Command::Report(command) => report::report(&command, screen),
        Command::Diff(command) => diff::diff(&command, screen),
        Command::Which(command) => which::which(&command, screen),
        Command::Watch(command) => watch::watch(&command, screen),
        Command::Worker(command) => team::worker(&command, screen),
        Command::Status(command) => team::status(&command, screen),
        Command::Cancel(command) => team::cancel(&command, screen),
        Command::Init(command) => init::init(&command, screen),
        Command::Completions(command) => shell::completions(&command, screen),
        Command::Man(command) => shell::man(&command, screen),
        Command::Store(command) => store::store(&command, screen),
    }
}

/// Help goes to stdout, a wrong command line to stderr; what was typed is escaped in both.
fn explain(error: &clap::Error, screen: &Screen) -> Ending {
    let text = screen::escaped_lines(&error.render().to_string());
    if error.exit_code() == 0 {
        return screen.print(&text);
    }
    screen.say(&text);
    Ending::Refused
}

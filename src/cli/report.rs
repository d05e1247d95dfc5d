//! `pipeline report`: a run as a page.

use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;

use super::Ending;
use super::arguments::{ReportCommand, TalkArguments};
use super::outcomes::counted;
use super::screen::Screen;
use super::signals::Interrupt;
use super::verify::no_run;
use crate::engine::diagnostic::escape;
use crate::engine::provenance::runs::{self, FoundRun};
use crate::engine::run::{Places, Summary};
use crate::engine::schedule::bytes_text;
use crate::engine::store::folder::FolderStore;
use crate::report::{self, ReportError, Settings, Written};
use crate::stages::registry;

/// Makes the page of a run.
pub fn report(command: &ReportCommand, screen: &Screen) -> Ending {
    let interrupt = Interrupt::listen();
    interrupt.begun();
    let run = match runs::find(&command.run, &command.places.local.outputs) {
        Ok(run) => run,
        Err(error) => return no_run(&error, screen),
    };
    let store = command.places.local.store.clone().unwrap_or_else(|| run.outputs.clone().unwrap_or_default().join(".store"));
    let page = command.out.clone().unwrap_or_else(|| report::place_of(&run));
    match write(&run, &command.places.places(), store, Settings { page, budget: command.budget }, &interrupt) {
        Ok(written) => {
            tell(&written, command.talk, screen);
            screen.print(&format!("{}\n", escape(&written.page.display().to_string())))
        }
        Err(error) => failed(&error, &interrupt, screen),
    }
}

/// Makes the page of a run that has just ended, beside its published files.
pub fn after_run(manifest: &std::path::Path, places: &Places, talk: TalkArguments, interrupt: &Interrupt, screen: &Screen) -> Ending {
    let run = match runs::read(manifest) {
        Ok(run) => run,
        Err(error) => return no_run(&error, screen),
    };
    let page = manifest.with_file_name("report.html");
    match write(&run, places, places.store.clone(), Settings { page, budget: report::BUDGET }, interrupt) {
        Ok(written) => {
            tell(&written, talk, screen);
            Ending::Done
        }
        Err(error) => failed(&error, interrupt, screen),
    }
}

/// After a run that made no page: whether one of an earlier run stands beside its files.
pub fn tell_if_outdated(summary: &Summary, screen: &Screen) {
    let page = summary.manifest.with_file_name("report.html");
    if let (None, true, Some(name)) = (&summary.results_of, page.is_file(), summary.manifest.parent().and_then(Path::file_name)) {
        let (page, name) = (escape(&page.display().to_string()), escape(&name.to_string_lossy()));
        screen.say(&format!("{page} is of an earlier run; `pipeline report {name}` makes it again\n"));
    }
}

fn write(run: &FoundRun, places: &Places, store: PathBuf, settings: Settings, interrupt: &Interrupt) -> Result<Written, ReportError> {
    let library = places.library_over(FolderStore::at(store))?;
    report::write(run, library, &registry(), &settings, &|| interrupt.flag.load(Ordering::Relaxed))
}

fn tell(written: &Written, talk: TalkArguments, screen: &Screen) {
    if !written.gone.is_empty() {
        screen.warning(&format!("{} gone from the store and the outputs; the page says which", counted(written.gone.len(), "result")));
    }
    if talk.quiet {
        return;
    }
    let beside = match written.beside {
        0 => String::new(),
        count => format!("; {} beside it in {}", counted(count, "file"), written.folder.display()),
    };
    screen.say(&format!("report: {}, {}{}\n", escape(&written.page.display().to_string()), bytes_text(written.bytes), escape(&beside)));
}

fn failed(error: &ReportError, interrupt: &Interrupt, screen: &Screen) -> Ending {
    match error {
        ReportError::Interrupted => interrupt.ending(),
        ReportError::System(error) => {
            screen.error(&error.to_string(), None);
            Ending::System
        }
    }
}

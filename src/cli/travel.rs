//! `pipeline store push, pull, check, keygen`: results that go from one store to another.

use std::sync::Arc;

use super::Ending;
use super::arguments::{CheckStoreCommand, Format, KeygenCommand, LocalStoreArguments, PullCommand, PushCommand};
use super::outcomes::counted;
use super::screen::{Screen, escaped_lines, json_text};
use super::signals::Interrupt;
use super::verify::no_run;
use crate::engine::diagnostic::escape;
use crate::engine::provenance::runs;
use crate::engine::provenance::travel::{self, PullError, Travelled};
use crate::engine::store::address::{Address, Remote, Unusable};
use crate::engine::store::folder::FolderStore;
use crate::engine::store::library::Library;
use crate::engine::store::probe::{Finding, Verdict, is_usable, probe};
use crate::engine::store::signing::{Keys, SecretKey, public_path};
use crate::engine::store::tiers::Far;
use crate::engine::system::SystemError;

/// Lines that are shown of each sort.
const SHOWN: usize = 10;

/// Sends a run or all results.
pub fn push(command: &PushCommand, screen: &Screen) -> Result<Ending, SystemError> {
    let (near, far) = stores(&command.store, &command.target)?;
    if !far.is_writable {
        screen.error(
            &format!("`{}` can only be read", far.name),
            Some("there are no credentials or no rights to write there, or `--store-trust` is given without a key that signs"),
        );
        return Ok(Ending::System);
    }
    let interrupt = Interrupt::listen();
    let travelled = match &command.run {
        None => travel::push_all(&near, &far, interrupt.begun())?,
        Some(name) => {
            let run = match runs::find(name, &command.store.places.outputs) {
                Ok(run) => run,
                Err(error) => return Ok(no_run(&error, screen)),
            };
            let library = Library::new(Arc::new(near.clone()));
            travel::push_run(&run.manifest, &near, &library, &far, interrupt.begun())?
        }
    };
    Ok(tell(&travelled, &format!("in `{}`", far.name), command.store.format, &interrupt, screen))
}

/// Brings a run or all results.
pub fn pull(command: &PullCommand, screen: &Screen) -> Result<Ending, SystemError> {
    let (near, far) = stores(&command.store, &command.source)?;
    let interrupt = Interrupt::listen();
    let travelled = match &command.run {
        None => travel::pull_all(&far, &near, interrupt.begun())?,
        Some(name) => match travel::pull_run(name, &far, &near, &command.store.places.outputs, interrupt.begun()) {
            Ok(travelled) => travelled,
            Err(PullError::System(error)) => return Err(error),
            Err(error) => {
                let hint = if let PullError::NoRun { hint, .. } = &error { hint.as_deref() } else { None };
                screen.error(&error.to_string(), hint);
                return Ok(Ending::Refused);
            }
        },
    };
    Ok(tell(&travelled, "here", command.store.format, &interrupt, screen))
}

/// The store of this machine, and the other.
fn stores(arguments: &LocalStoreArguments, address: &Address) -> Result<(FolderStore, Far), SystemError> {
    let places = arguments.places.places();
    let remote = Remote { address: address.clone(), is_read_only: false, keys: arguments.keys.keys() };
    let far = remote.open(places.may_share_store).map_err(told)?;
    Ok((places.folder_store()?.for_inspection(), far))
}

fn told(unusable: Unusable) -> SystemError {
    let (Unusable::Gone(error) | Unusable::Refused(error)) = unusable;
    error
}

fn tell(travelled: &Travelled, place: &str, format: Format, interrupt: &Interrupt, screen: &Screen) -> Ending {
    let printed = match format {
        Format::Json => screen.print(&json_text(travelled)),
        Format::Text => screen.print(&escaped_lines(&travelled_text(travelled, place))),
    };
    match () {
        () if interrupt.flag.load(std::sync::atomic::Ordering::Relaxed) => interrupt.ending(),
        () if travelled.failure.is_some() => Ending::System,
        () if !travelled.lost.is_empty() => Ending::Failed,
        () if !travelled.differing.is_empty() => Ending::Differs,
        () => printed,
    }
}

fn travelled_text(travelled: &Travelled, place: &str) -> String {
    let mut lines = Vec::new();
    let mut list = |title: &str, items: &[String]| {
        lines.extend(items.iter().take(SHOWN).map(|item| format!("{title}: {item}")));
        if items.len() > SHOWN {
            lines.push(format!("{title}: and {} more", items.len() - SHOWN));
        }
    };
    list("not carried", &travelled.lost);
    list("other results for the same job stand there", &travelled.differing);
    if let Some(failure) = &travelled.failure {
        lines.push(format!("given up: {failure}"));
    }
    let run = travelled.run_id.as_ref().map(|run_id| format!("{run_id}: ")).unwrap_or_default();
    let files = if travelled.files > 0 { format!(", {} published", counted(travelled.files as usize, "file")) } else { String::new() };
    lines.push(format!("{run}{} {place}, {} of them new{files}", counted(travelled.records as usize, "record"), travelled.new));
    lines.join("\n") + "\n"
}

/// Shows what a store keeps of its promises.
pub fn check(command: &CheckStoreCommand, screen: &Screen) -> Result<Ending, SystemError> {
    // Whoever else may write there: nothing is taken from it.
    let remote = Remote { address: command.target.clone(), is_read_only: command.read_only, keys: Keys::default() };
    let far = remote.open(true).map_err(told)?;
    let findings = probe(&*far.objects, far.is_writable);
    let printed = match command.format {
        Format::Json => screen.print(&json_text(&findings)),
        Format::Text => screen.print(&escaped_lines(&findings_text(&findings))),
    };
    Ok(if is_usable(&findings) { printed } else { Ending::Failed })
}

fn findings_text(findings: &[Finding]) -> String {
    let word = |verdict| match verdict {
        Verdict::Kept => "yes",
        Verdict::Not => "no",
        Verdict::Fails => "FAILS",
        Verdict::Skipped => "-",
    };
    let width = findings.iter().map(|finding| finding.promise.len()).max().unwrap_or(0);
    let mut lines: Vec<String> = findings
        .iter()
        .map(|finding| format!("{:<width$}  {:<5}  {}", finding.promise, word(finding.verdict), finding.seen).trim_end().to_owned())
        .collect();
    let is_weak = findings.iter().any(|finding| finding.verdict == Verdict::Not);
    lines.push(match (is_usable(findings), is_weak) {
        (false, _) => "this is no place for results".to_owned(),
        (true, true) => "results are right here; what is not kept costs work done twice".to_owned(),
        (true, false) => "all is as it should be".to_owned(),
    });
    lines.join("\n") + "\n"
}

/// Writes a new key.
pub fn keygen(command: &KeygenCommand, screen: &Screen) -> Result<Ending, SystemError> {
    let key = SecretKey::draw().map_err(SystemError::at("read", "/dev/urandom"))?;
    key.write(&command.file).map_err(SystemError::at("write", &command.file))?;
    let (secret, public) = (command.file.display().to_string(), public_path(&command.file).display().to_string());
    screen.say(&escape(&format!("{secret} signs, and is to stay secret; others trust {public}")));
    screen.say("\n");
    Ok(screen.print(&format!("{}\n", key.public())))
}

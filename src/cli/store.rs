//! `pipeline store`: what the store holds, whether it is sound, and what may go.

use std::time::Instant;

use super::arguments::{Format, GcCommand, StoreArguments, StoreCommand};
use super::screen::{Screen, escaped_lines, json_text};
use super::{Ending, travel};
use crate::engine::schedule::bytes_text;
use crate::engine::store::collection::{Collected, Policy, collect};
use crate::engine::store::folder::FolderStore;
use crate::engine::store::inventory::{Stats, Tally, stats};
use crate::engine::store::library::Library;
use crate::engine::store::verification::{Findings, verify};
use crate::engine::system::SystemError;

/// Looks after a store.
pub fn store(command: &StoreCommand, screen: &Screen) -> Ending {
    let done = match command {
        StoreCommand::Stats(arguments) => show_stats(arguments, screen),
        StoreCommand::Verify(arguments) => show_verification(arguments, screen),
        StoreCommand::Gc(command) => show_collection(command, screen),
        StoreCommand::Push(command) => travel::push(command, screen),
        StoreCommand::Pull(command) => travel::pull(command, screen),
        StoreCommand::Check(command) => travel::check(command, screen),
        StoreCommand::Keygen(command) => travel::keygen(command, screen),
    };
    done.unwrap_or_else(|error| {
        screen.error(&error.to_string(), None);
        Ending::System
    })
}

/// The store, its objects not counted as used by being looked at.
fn opened(arguments: &StoreArguments) -> Result<(std::sync::Arc<FolderStore>, Library), SystemError> {
    let store = std::sync::Arc::new(arguments.places.places().folder_store()?.for_inspection());
    Ok((store.clone(), Library::new(store)))
}

fn answer(screen: &Screen, format: Format, value: &impl serde::Serialize, text: impl FnOnce() -> String) -> Ending {
    match format {
        Format::Json => screen.print(&json_text(value)),
        Format::Text => screen.print(&escaped_lines(&text())),
    }
}

fn show_stats(arguments: &StoreArguments, screen: &Screen) -> Result<Ending, SystemError> {
    let (store, library) = opened(arguments)?;
    let stats = stats(store.layout(), &library)?;
    Ok(answer(screen, arguments.format, &stats, || stats_text(&store.layout().root().display().to_string(), &stats)))
}

fn stats_text(place: &str, stats: &Stats) -> String {
    let mut lines = vec![format!("{place}: {}", bytes_text(stats.bytes))];
    let rows = [
        ("blobs", &stats.blobs),
        ("results", &stats.results),
        ("publications", &stats.publications),
        ("notes", &stats.notes),
        ("runs", &stats.runs),
        ("set aside", &stats.damaged),
        ("unfinished", &stats.unfinished),
        ("claims", &stats.claims),
    ];
    lines.extend(rows.iter().map(|(name, tally)| tally_text(name, tally)));
    for (name, tally) in &stats.types {
        lines.push(format!("  of type {name:<12} {:>7} results  {:>10}", tally.results, bytes_text(tally.bytes)));
    }
    lines.join("\n") + "\n"
}

fn tally_text(name: &str, tally: &Tally) -> String {
    let ages = match (tally.youngest_seconds, tally.oldest_seconds) {
        (Some(youngest), Some(oldest)) => format!("  used {} to {} ago", age_text(youngest), age_text(oldest)),
        _ => String::new(),
    };
    format!("  {name:<13} {:>7}  {:>10}{ages}", tally.count, bytes_text(tally.bytes))
}

fn age_text(seconds: u64) -> String {
    match seconds {
        0..120 => format!("{seconds} s"),
        120..7200 => format!("{} min", seconds / 60),
        7200..172_800 => format!("{} h", seconds / 3600),
        _ => format!("{} days", seconds / 86400),
    }
}

fn show_verification(arguments: &StoreArguments, screen: &Screen) -> Result<Ending, SystemError> {
    let (store, library) = opened(arguments)?;
    let begun = Instant::now();
    let findings = verify(store.layout(), &library)?;
    let seconds = begun.elapsed().as_secs_f64();
    let printed = answer(screen, arguments.format, &findings, || findings_text(&findings, seconds));
    Ok(if findings.damage.is_empty() { printed } else { Ending::Differs })
}

fn findings_text(findings: &Findings, seconds: f64) -> String {
    let mut lines: Vec<String> =
        findings.damage.iter().map(|damage| format!("damaged: {} {}: {}", damage.object, damage.name, damage.what)).collect();
    let count = match findings.damage.len() {
        0 => "all sound".to_owned(),
        1 => "1 damaged and set aside; the next run makes it again".to_owned(),
        count => format!("{count} damaged and set aside; the next run makes them again"),
    };
    lines.push(format!("{} objects, {} hashed in {seconds:.2} s: {count}", findings.objects, bytes_text(findings.bytes)));
    if findings.unnamed_blobs > 0 {
        lines.push(format!("{} blobs have no record (`pipeline store gc` removes them)", findings.unnamed_blobs));
    }
    lines.join("\n") + "\n"
}

fn show_collection(command: &GcCommand, screen: &Screen) -> Result<Ending, SystemError> {
    let (store, library) = opened(&command.store)?;
    let policy = Policy {
        older_than: command.older_than,
        max_bytes: command.max_size,
        keep_last: command.keep_last,
        grace: command.grace,
        is_trial: command.dry_run,
    };
    let collected = collect(&store, &library, &command.store.places.outputs, &policy)?;
    Ok(answer(screen, command.store.format, &collected, || collected_text(&collected, command.dry_run)))
}

fn collected_text(collected: &Collected, is_trial: bool) -> String {
    let word = if is_trial { "would remove" } else { "removed" };
    let Collected { records, blobs, damaged, notes, .. } = collected;
    let runs = match collected.runs {
        0 => String::new(),
        1 => ", the folder of 1 run".to_owned(),
        count => format!(", the folders of {count} runs"),
    };
    let (freed, left) = (bytes_text(collected.bytes), bytes_text(collected.bytes_left));
    let spared = match collected.spared {
        0 => String::new(),
        count => format!("{count} objects stay because they were used lately (`--grace`)\n"),
    };
    format!("{word} {records} records, {blobs} blobs, {damaged} set aside, {notes} notes{runs}: {freed}; {left} left\n{spared}")
}

//! `pipeline check`: every mistake of a file.

use super::Ending;
use super::arguments::{CheckCommand, Format};
use super::screen::{Screen, diagnostics_json, json_text};
use crate::engine::sweep::build;
use crate::stages::registry;

/// Shows every mistake, or how much there is to do.
pub fn check(command: &CheckCommand, screen: &Screen) -> Ending {
    let as_json = command.format == Format::Json;
    match build(&registry(), &command.pipeline.request(&command.targets)) {
        Err(errors) => {
            screen.show(&errors, as_json);
            Ending::Refused
        }
        Ok((_, warnings)) if as_json => screen.print(&json_text(&serde_json::json!({ "diagnostics": diagnostics_json(&warnings) }))),
        Ok((graph, warnings)) => {
            screen.show(&warnings, false);
            let wanted = graph.jobs.iter().filter(|job| job.is_wanted).count();
            screen.print(&format!("{}: no mistakes; {} stages, {wanted} jobs\n", graph.pipeline, graph.stages.len()))
        }
    }
}

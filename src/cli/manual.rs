//! `pipeline stages` and `pipeline schema`: the manual of the kinds, and the schema for editors.

use super::Ending;
use super::arguments::{SchemaCommand, SchemaOf, StagesCommand};
use super::screen::{Screen, json_text};
use crate::engine::manual;
use crate::stages::registry;

/// Lists the kinds, or shows one with every parameter.
pub fn stages(command: &StagesCommand, screen: &Screen) -> Ending {
    let registry = registry();
    match &command.kind {
        None => screen.print(&manual::kinds(&registry)),
        Some(kind) => match manual::kind(&registry, kind) {
            Ok(text) => screen.print(&text),
            Err(message) => {
                screen.error(&message, None);
                Ending::Refused
            }
        },
    }
}

/// Prints the JSON Schema of pipeline files or of manifests.
pub fn schema(command: &SchemaCommand, screen: &Screen) -> Ending {
    let schema = match command.of {
        SchemaOf::Pipeline => manual::schema(&registry()),
        SchemaOf::Manifest => manual::manifest_schema(),
    };
    screen.print(&json_text(&schema))
}

//! The engine: text → document → sweep → graph → freshness → run record. Knows no light.
//!
//! Reading order: `stage` (what a kind must offer), `artifact` (what flows), `job` (what a stage sees),
//! `registry` (the tables), then the path of a run.

pub mod artifact;
pub mod axes;
pub mod canonical;
pub mod coordinate;
pub mod diagnostic;
pub mod digest;
pub mod document;
pub mod events;
pub mod executor;
pub mod files;
pub mod freshness;
pub mod graph;
pub mod history;
pub mod job;
pub mod key;
pub mod lines;
pub mod manifest;
pub mod manual;
pub mod owner;
pub mod parameter;
pub mod provenance;
pub mod publish;
pub mod quantity;
pub mod reference;
pub mod registry;
pub mod relation;
pub mod request;
pub mod resources;
pub mod run;
pub mod save;
pub mod schedule;
pub mod schema;
pub mod shell;
pub mod signature;
pub mod source;
pub mod stage;
pub mod store;
pub mod substitution;
pub mod sweep;
pub mod system;
pub mod team;
pub mod yaml;

#[cfg(test)]
mod trial;

//! Behavior of the whole program, through its binary: what a user types, sees and finds on disk.

mod bad_input;
mod book;
mod commands;
mod language;
mod mistakes;
mod photographs;
mod provenance;
mod reasons;
mod render_options;
mod rendering;
mod report;
mod reuse;
mod space;
mod split;
mod store;
mod team;
mod versions;

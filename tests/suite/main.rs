//! Behavior of the whole program, through its binary: what a user types, sees and finds on disk.

mod bad_input;
mod language;
mod rendering;
mod reuse;
mod space;

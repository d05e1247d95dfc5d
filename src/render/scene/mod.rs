//! The description of a scene as a person writes it.

pub mod vector;

//! The run in a public form.

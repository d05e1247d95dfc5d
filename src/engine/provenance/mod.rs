//! What can be said of finished runs from their manifests: where they are, how two differ, whether one can be
//! made again, which one made a file, and the same facts in a public form.
//!
//! Reading order: `runs` (finding manifests), `comparison`, `verification`, `origin`, `ro_crate`.

pub mod comparison;
pub mod origin;
pub mod ro_crate;
pub mod runs;
pub mod travel;
pub mod verification;

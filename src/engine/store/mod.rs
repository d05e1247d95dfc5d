//! What was computed before: immutable blobs by their digest, result records by their key.
//!
//! `objects` is the small trait that a local folder, a shared folder or a bucket stands behind; `folder` the
//! local one; `record` what a record says; `library` reads and writes blobs and records through the trait and
//! trusts nothing that it reads; `committer` makes results durable in groups; `claims` says who is computing what, which
//! saves work and decides nothing; `index` and the file of stat signatures are caches that can be rebuilt. `inventory`,
//! `verification`, `collection` and `runs` look after a store as a whole.
//!
//! A store elsewhere (`address`: a folder, or a `bucket`) may stand behind the local one; `tiers` joins the two. `transfer` carries
//! records and blobs from one store to another and checks all that it takes, `signing` knows who vouches for them, and `probe` finds
//! out what a store promises.

pub mod address;
#[cfg(feature = "s3")]
pub mod bucket;
pub mod claims;
pub mod collection;
pub mod committer;
pub mod folder;
pub mod index;
pub mod inventory;
pub mod library;
pub mod objects;
pub mod probe;
pub mod record;
pub mod runs;
pub mod signing;
pub mod tiers;
pub mod transfer;
pub mod verification;

#[cfg(test)]
mod weak_store_tests;

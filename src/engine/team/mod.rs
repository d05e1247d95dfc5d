//! One run by many processes: a driver that plans, publishes and tells, and workers that compute.
//!
//! A worker is the same engine on the same plan with the same store. It takes jobs by claims, as any two runs over one store
//! do, and publishes nothing. What the run is stands in its folder (`folder`), from which a worker gets exactly the same
//! graph; what each worker does it writes in a file of its own (`journal`). The store alone says what is done: journals
//! and whatever starts workers (`executor`) are hints. `crew` sees to it that there are as many workers as there is work for,
//! `overseer` is the driver's view of what they do, `hand` is a worker's own state, `status` is for people.

pub mod crew;
pub mod folder;
pub mod hand;
pub mod journal;
pub mod overseer;
pub mod status;

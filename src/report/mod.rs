//! A finished run as a page that can be opened, read and sent: one HTML file, with large data in files beside it.
//!
//! Made of the manifest and of what the store or the published files still hold of its results; so equal manifests and
//! results give equal bytes, and what is gone is said to be gone. The page needs no network, and without scripts it
//! still shows pictures, plots and tables. Knows no stage: results are read as the types and formats that they are
//! saved in.
//!
//! Reading order: `results` (where content comes from), `pictures` (previews, statistics, pixels for the viewer),
//! `packing` and `sidecars` (what is embedded and what lies beside), `tables`, `timing`, `commands`, `overview`,
//! `model` (all that the page says), `page` (HTML). Beside them `tev`: images for a viewer that is running.

mod commands;
mod model;
mod overview;
mod packing;
mod page;
mod pictures;
mod results;
mod sidecars;
mod tables;
pub mod tev;
mod timing;

use std::path::{Path, PathBuf};

use crate::engine::manifest::Manifest;
use crate::engine::provenance::runs::FoundRun;
use crate::engine::registry::Registry;
use crate::engine::store::library::Library;
use crate::engine::system::SystemError;
use model::{Links, Model};
use results::Results;

/// Bytes of a page unless something else is asked: what most mail takes.
pub const BUDGET: u64 = 24 << 20;

/// How to make a page.
#[derive(Debug, Clone)]
pub struct Settings {
    /// Where to write it.
    pub page: PathBuf,
    /// Bytes of the page; its text and drawings are in it even if they are more.
    pub budget: u64,
}

/// A page that was written.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Written {
    /// Where it is.
    pub page: PathBuf,
    /// Its bytes.
    pub bytes: u64,
    /// Files beside it, and the folder that they are in.
    pub beside: usize,
    /// See above.
    pub folder: PathBuf,
    /// Results that it should show and that are gone from the store and the outputs.
    pub gone: Vec<String>,
}

/// Why there is no page.
#[derive(Debug, thiserror::Error)]
pub enum ReportError {
    /// The system failed.
    #[error(transparent)]
    System(#[from] SystemError),
    /// It was told to stop.
    #[error("interrupted")]
    Interrupted,
}

/// Where the page of a run belongs: beside the manifest that was read.
pub fn place_of(run: &FoundRun) -> PathBuf {
    run.path.with_file_name("report.html")
}

/// Writes the page of a run, and what lies beside it.
pub fn write(
    run: &FoundRun,
    library: Library,
    registry: &Registry,
    settings: &Settings,
    is_stopped: &(dyn Fn() -> bool + Sync),
) -> Result<Written, ReportError> {
    let results = Results::new(run, library, registry);
    let links = Links::from_page(&settings.page, run);
    let mut model = Model::of(&run.manifest, &results, &links, settings.budget, is_stopped)?;
    let bare = page::html_page(&model).len() as u64;
    let folder = sidecars::folder_of(&settings.page);
    model.embed(&run.manifest, &results, settings.budget.saturating_sub(bare), &folder, is_stopped)?;
    let text = page::html_page(&model);
    sidecars::write_whole(&settings.page, text.as_bytes())?;
    sidecars::tidy(&folder, &model.texts.beside);
    Ok(Written {
        page: settings.page.clone(),
        bytes: text.len() as u64,
        beside: model.texts.beside.len(),
        folder,
        gone: model.gone.clone(),
    })
}

/// Whether a page lies where the published files of its run can be reached by relative addresses.
fn prefix_of(page: &Path, run: &FoundRun, manifest: &Manifest) -> Option<String> {
    let published = std::path::absolute(run.outputs.as_ref()?.join(&manifest.pipeline)).ok()?;
    let folder = std::path::absolute(page).ok()?.parent()?.to_owned();
    let below = folder.strip_prefix(&published).ok()?;
    Some("../".repeat(below.components().count()))
}

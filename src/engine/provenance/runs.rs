//! Finds runs: by id, folder, manifest, or the name of a pipeline.
//!
//! A manifest may come from anywhere, so that its names are checked before anything is written under them.

use std::fs;
use std::path::{Component, Path, PathBuf};

use crate::catalogue::nearest;
use crate::engine::diagnostic::quoted;
use crate::engine::manifest::{Manifest, SCHEMA, ShortManifest};

/// A run with its manifest.
#[derive(Debug, Clone)]
pub struct FoundRun {
    /// The manifest, of the run whose results stand where the named one changed nothing.
    pub manifest: Manifest,
    /// Where it was read.
    pub path: PathBuf,
    /// The folder of outputs that it lies in, as far as its place tells.
    pub outputs: Option<PathBuf>,
}

/// Why there is no such run.
#[derive(Debug, thiserror::Error)]
pub enum LookupError {
    /// Nothing has that name.
    #[error("there is no run {}: it is no manifest, no folder with one, and no run or pipeline below `{}`", quoted(name), outputs.display())]
    Missing {
        /// What was asked for.
        name: String,
        /// Where it was looked for.
        outputs: PathBuf,
        /// What to do.
        hint: Option<String>,
    },
    /// The file cannot be read.
    #[error("cannot read `{}`: {source}", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The file is something else.
    #[error("`{}` is no manifest of a run: {what}", path.display())]
    Foreign {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        what: String,
    },
}

impl LookupError {
    /// What to do about it.
    pub fn hint(&self) -> Option<&str> {
        match self {
            LookupError::Missing { hint, .. } => hint.as_deref(),
            LookupError::Unreadable { .. } | LookupError::Foreign { .. } => None,
        }
    }
}

const MANIFEST: &str = "manifest.json";

/// The run of that name: a manifest's path, a folder with a manifest, a run id, or a pipeline (its latest run).
pub fn find(name: &str, outputs: &Path) -> Result<FoundRun, LookupError> {
    let path = Path::new(name);
    if path.is_file() {
        return read(path);
    }
    if path.join(MANIFEST).is_file() {
        return read(&path.join(MANIFEST));
    }
    let is_plain = matches!(path.components().collect::<Vec<_>>().as_slice(), [Component::Normal(_)]);
    let candidates = pipelines(outputs).into_iter().filter(|_| is_plain).flat_map(|pipeline| {
        let latest = (pipeline.file_name().is_some_and(|own| own == name)).then(|| pipeline.join(MANIFEST));
        [Some(pipeline.join("runs").join(name).join(MANIFEST)), latest]
    });
    match candidates.flatten().find(|path| path.is_file()) {
        Some(path) => read(&path),
        None => Err(LookupError::Missing { name: name.to_owned(), outputs: outputs.to_owned(), hint: hint(name, outputs) }),
    }
}

/// The folders of pipelines, by name.
fn pipelines(outputs: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(outputs).into_iter().flatten().flatten();
    let mut folders: Vec<PathBuf> = entries.map(|entry| entry.path()).filter(|path| path.join(MANIFEST).is_file()).collect();
    folders.sort();
    folders
}

fn hint(name: &str, outputs: &Path) -> Option<String> {
    let pipelines = pipelines(outputs);
    let names = |folder: &Path| {
        let entries = fs::read_dir(folder).into_iter().flatten().flatten();
        entries.filter_map(|entry| entry.file_name().into_string().ok()).collect::<Vec<_>>()
    };
    let mut known: Vec<String> = pipelines.iter().filter_map(|path| Some(path.file_name()?.to_str()?.to_owned())).collect();
    known.extend(pipelines.iter().flat_map(|path| names(&path.join("runs"))));
    if let Some(near) = nearest(name, known.iter().map(String::as_str)) {
        return Some(format!("did you mean {}?", quoted(near)));
    }
    let is_of_a_run = |name: &String| name.starts_with(|first: char| first.is_ascii_digit());
    let latest = pipelines.iter().flat_map(|path| names(&path.join("runs"))).filter(is_of_a_run).max();
    Some(match latest {
        Some(latest) => format!("the latest run is {}", quoted(&latest)),
        None => "no pipeline has run yet there; `--outputs` names another folder".to_owned(),
    })
}

/// Reads a manifest; of a run that changed nothing, that of the run whose results stand.
pub fn read(path: &Path) -> Result<FoundRun, LookupError> {
    let text = fs::read_to_string(path).map_err(|source| LookupError::Unreadable { path: path.to_owned(), source })?;
    let foreign = |what: String| LookupError::Foreign { path: path.to_owned(), what };
    match serde_json::from_str::<Manifest>(&text) {
        Ok(manifest) => {
            checked(&manifest).map_err(foreign)?;
            let outputs = outputs_of(path, &manifest.run_id);
            Ok(FoundRun { manifest, path: path.to_owned(), outputs })
        }
        Err(error) => {
            let short = serde_json::from_str::<ShortManifest>(&text).map_err(|_| foreign(error.to_string()))?;
            let standing = Path::new(&short.results_of);
            let is_plain = matches!(standing.components().collect::<Vec<_>>().as_slice(), [Component::Normal(_)]);
            let runs = path.parent().and_then(Path::parent).filter(|_| is_plain);
            let whole = runs.map(|runs| runs.join(standing).join(MANIFEST)).filter(|whole| whole != path);
            read(&whole.ok_or_else(|| foreign(format!("the run {} whose results stand is not beside it", quoted(&short.results_of))))?)
        }
    }
}

/// `OUTPUTS/NAME/runs/ID/manifest.json` or `OUTPUTS/NAME/manifest.json`.
fn outputs_of(path: &Path, run_id: &str) -> Option<PathBuf> {
    let path = std::path::absolute(path).ok()?;
    let folder = path.parent()?;
    let pipeline = if folder.ends_with(Path::new("runs").join(run_id)) { folder.parent()?.parent()? } else { folder };
    Some(pipeline.parent()?.to_owned())
}

/// Whether it is of this form and its names are safe to write under.
pub fn checked(manifest: &Manifest) -> Result<(), String> {
    if manifest.schema != SCHEMA {
        return Err(format!("its form is {}, and this program reads `{SCHEMA}`", quoted(&manifest.schema)));
    }
    let axes =
        |coordinate: &serde_json::Value| coordinate.as_object().into_iter().flat_map(|axes| axes.keys().cloned()).collect::<Vec<_>>();
    for job in &manifest.jobs {
        let names = std::iter::once(job.stage.clone()).chain(axes(&job.coordinate));
        if let Some(odd) = names.into_iter().find(|name| !is_name(name)) {
            return Err(format!("{} is no name of a stage or an axis", quoted(&odd)));
        }
    }
    let paths = manifest.spec.iter().map(|entry| &entry.path).chain(manifest.published.iter().map(|entry| &entry.path));
    let odd = paths.into_iter().chain([&manifest.pipeline, &manifest.run_id]).find(|path| !is_inside(path));
    odd.map_or(Ok(()), |odd| Err(format!("{} leads out of its folder", quoted(odd))))
}

fn is_name(text: &str) -> bool {
    !text.is_empty() && text.len() <= 64 && text.bytes().all(|byte| byte.is_ascii_alphanumeric() || b"_-".contains(&byte))
}

/// Whether a path stays below the folder that it is relative to.
pub fn is_inside(path: &str) -> bool {
    let mut components = Path::new(path).components();
    !path.is_empty() && !path.contains('\0') && components.all(|component| matches!(component, Component::Normal(_)))
}

/// Manifests below a folder of outputs, the latest of each pipeline first; those of one pipeline only, if it is named.
///
/// Files that do not hold `needle` are passed over without being parsed.
pub fn holding<'a>(outputs: &Path, pipeline: Option<&'a str>, needle: &'a str) -> impl Iterator<Item = FoundRun> + use<'a> {
    let is_meant = move |path: &PathBuf| pipeline.is_none_or(|name| path.file_name().is_some_and(|own| own == name));
    let folders = pipelines(outputs).into_iter().filter(is_meant);
    let candidates = folders.flat_map(|folder| {
        let entries = fs::read_dir(folder.join("runs")).into_iter().flatten().flatten();
        let mut runs: Vec<PathBuf> = entries.map(|entry| entry.path().join(MANIFEST)).collect();
        runs.sort_unstable_by(|a, b| b.cmp(a));
        std::iter::once(folder.join(MANIFEST)).chain(runs)
    });
    let holds = move |path: &PathBuf| fs::read_to_string(path).is_ok_and(|text| text.contains(needle));
    candidates.filter(holds).filter_map(|path| read(&path).ok())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_path_that_leads_out_of_its_folder_is_refused() {
        for (path, expected) in [("a.yaml", true), ("a/b.yaml", true), ("../a", false), ("a/../../b", false), ("/a", false), ("", false)] {
            assert_eq!(is_inside(path), expected, "{path}");
        }
        assert!(is_name("ldr-map_2") && !is_name("a/b") && !is_name(""));
    }

    #[test]
    fn the_folder_of_outputs_is_found_from_the_place_of_a_manifest() {
        let outputs = |path: &str| outputs_of(Path::new(path), "r1");
        assert_eq!(outputs("/o/p/runs/r1/manifest.json"), Some("/o".into()));
        assert_eq!(outputs("/o/p/manifest.json"), Some("/o".into()));
    }

    #[test]
    fn what_is_not_there_is_said_with_a_hint() {
        let folder = tempfile::tempdir().unwrap();
        let error = find("nowhere", folder.path()).unwrap_err();
        assert!(error.to_string().contains("`nowhere`") && error.hint().unwrap().contains("no pipeline has run"));
        fs::create_dir_all(folder.path().join("night/runs/20260101T000000Z-abcdef")).unwrap();
        fs::write(folder.path().join("night/manifest.json"), "{}").unwrap();
        assert_eq!(find("nigth", folder.path()).unwrap_err().hint(), Some("did you mean `night`?"));
        assert!(matches!(find("night", folder.path()), Err(LookupError::Foreign { .. })));
        assert!(find("../night", folder.path()).is_err());
    }
}

//! Where the content of results comes from: the store, verified, or else files that the run published, checked
//! against the digests of its manifest.

use std::collections::{BTreeMap, HashMap};
use std::fs;
use std::path::PathBuf;

use serde_json::Value as Json;

use crate::engine::artifact::{AnyArtifact, Origin};
use crate::engine::digest::Digest;
use crate::engine::manifest::{InputEntry, JobEntry, Manifest, OutputEntry, PublishedEntry, place_text};
use crate::engine::provenance::runs::FoundRun;
use crate::engine::registry::Registry;
use crate::engine::store::library::Library;
use crate::figure::table::{Cell, Column, Table};
use crate::formats::{self, Content as FileContent, Limits};
use crate::image::raster::{Image, Picture};

/// How results of a type are shown.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sort {
    /// A lat-long map of linear light.
    Map,
    /// Linear light.
    Linear,
    /// A picture for a display.
    Display,
    /// Rows and columns.
    Table,
    /// A drawing.
    Figure,
    /// Points on a map.
    Samples,
    /// Regions of a map, each with a point.
    Lights,
}

impl Sort {
    /// By the name of a type; `None` for types that a page cannot show.
    pub fn of(type_name: &str) -> Option<Self> {
        Some(match type_name {
            "envmap" => Self::Map,
            "image" => Self::Linear,
            "picture" => Self::Display,
            "table" => Self::Table,
            "figure" => Self::Figure,
            "samples" => Self::Samples,
            "lights" => Self::Lights,
            _ => return None,
        })
    }

    /// Whether it has pixels.
    pub fn is_image(self) -> bool {
        matches!(self, Self::Map | Self::Linear | Self::Display)
    }

    /// Formats in which a published file can stand for the result, the most faithful one first.
    fn formats(self) -> &'static [&'static str] {
        match self {
            Self::Map | Self::Linear => &["exr", "pfm", "npy", "hdr"],
            Self::Display => &["png", "ppm"],
            Self::Table | Self::Samples => &["csv"],
            Self::Figure => &["svg"],
            Self::Lights => &["json"],
        }
    }
}

/// What a result holds.
#[derive(Debug, Clone)]
pub enum Content {
    /// Linear light.
    Linear(Image),
    /// A picture for a display.
    Display(Picture),
    /// Rows and columns.
    Table(Table),
    /// The text of an SVG.
    Figure(String),
    /// Marks on a map.
    Marks(Marks),
}

/// Points, or regions with a point each, in pixels from the upper left corner of a map.
#[derive(Debug, Clone, PartialEq)]
pub struct Marks {
    /// Size of the map, where it is known.
    pub map: Option<[u32; 2]>,
    /// `x y` of each point, or `x0 y0 x1 y1 x y` of each region.
    pub values: Vec<f32>,
}

/// The results of a run.
pub struct Results<'a> {
    library: Library,
    registry: &'a Registry,
    /// The folder of the published files, if the place of the manifest tells.
    folder: Option<PathBuf>,
    published: BTreeMap<&'a str, Vec<&'a PublishedEntry>>,
}

impl<'a> Results<'a> {
    /// Those of a run whose store is at hand.
    pub fn new(run: &'a FoundRun, library: Library, registry: &'a Registry) -> Self {
        let folder = run.outputs.as_ref().map(|outputs| outputs.join(&run.manifest.pipeline));
        Self { library, registry, folder, published: by_job(&run.manifest) }
    }

    /// The files that the run published of a result.
    pub fn files(&self, job: &JobEntry, result: &str) -> &[&'a PublishedEntry] {
        self.published.get(result_place(job, result).as_str()).map(Vec::as_slice).unwrap_or_default()
    }

    /// The content of a result that can be shown; `None` where it is gone.
    pub fn content(&self, job: &JobEntry, output: &OutputEntry) -> Option<Content> {
        let sort = Sort::of(&output.type_name)?;
        let stored = self.stored(job, output).and_then(|artifact| of_artifact(sort, &artifact));
        stored.or_else(|| self.published_content(sort, job, output))
    }

    fn stored(&self, job: &JobEntry, output: &OutputEntry) -> Option<AnyArtifact> {
        let record = self.library.result(&job.key?).ok()?;
        let found = record.outputs.into_iter().find(|found| found.name == output.name && found.content.digest == output.sha256)?;
        self.library.read_artifact(self.registry.artifacts().find(&found.type_name)?, &found.content).ok()
    }

    fn published_content(&self, sort: Sort, job: &JobEntry, output: &OutputEntry) -> Option<Content> {
        let files = self.files(job, &output.name);
        let named = |format: &str| files.iter().find(|entry| entry.path.rsplit('.').next() == Some(format));
        sort.formats().iter().filter_map(|format| named(format)).find_map(|entry| {
            let bytes = fs::read(self.folder.as_ref()?.join(&entry.path)).ok()?;
            (Digest::of(&bytes) == entry.sha256).then(|| of_file(sort, &bytes))?
        })
    }
}

/// `stage.result[axis=value]`, as published files name it.
pub fn result_place(job: &JobEntry, result: &str) -> String {
    let point = if result.is_empty() { "" } else { "." };
    place_text(&format!("{}{point}{result}", job.stage), &job.coordinate)
}

/// Indices of jobs by `stage[axis=value]`.
pub fn job_places(jobs: &[JobEntry]) -> HashMap<String, usize> {
    jobs.iter().enumerate().map(|(index, job)| (place_text(&job.stage, &job.coordinate), index)).collect()
}

/// The job that an input comes from.
pub fn source_of(input: &InputEntry, places: &HashMap<String, usize>) -> Option<usize> {
    let stage = input.stage.split('.').next().unwrap_or_default();
    places.get(&place_text(stage, &input.coordinate)).copied()
}

/// The jobs that a job takes results of.
pub fn input_jobs<'a>(job: &'a JobEntry, places: &'a HashMap<String, usize>) -> impl Iterator<Item = usize> + 'a {
    job.inputs.iter().filter_map(|input| source_of(input, places))
}

fn by_job(manifest: &Manifest) -> BTreeMap<&str, Vec<&PublishedEntry>> {
    let mut files: BTreeMap<&str, Vec<&PublishedEntry>> = BTreeMap::new();
    for entry in manifest.published.iter().chain(&manifest.kept) {
        files.entry(&entry.job).or_default().push(entry);
    }
    files
}

fn of_artifact(sort: Sort, artifact: &AnyArtifact) -> Option<Content> {
    let saved = |format: &str| Some(artifact.save(format, &Origin::default()).ok()?.bytes);
    match sort {
        Sort::Map => of_file(sort, &saved("pfm")?),
        Sort::Linear => artifact.get::<Image>().map(|image| Content::Linear((*image).clone())),
        Sort::Display => artifact.get::<Picture>().map(|picture| Content::Display((*picture).clone())),
        Sort::Table => artifact.get::<Table>().map(|table| Content::Table((*table).clone())),
        Sort::Figure => of_file(sort, &saved("svg")?),
        Sort::Samples => of_file(sort, &saved("csv")?),
        Sort::Lights => of_file(sort, &saved("json")?),
    }
}

fn of_file(sort: Sort, bytes: &[u8]) -> Option<Content> {
    match sort {
        Sort::Map | Sort::Linear | Sort::Display => match formats::read(bytes, "", &Limits::default()).ok()?.content {
            FileContent::Linear(image) => Some(Content::Linear(image)),
            FileContent::Display(picture) => Some(Content::Display(picture)),
        },
        Sort::Table => table_of_csv(bytes).map(Content::Table),
        Sort::Figure => String::from_utf8(bytes.to_vec()).ok().map(Content::Figure),
        Sort::Samples => samples(&table_of_csv(bytes)?).map(Content::Marks),
        Sort::Lights => lights(&serde_json::from_slice(bytes).ok()?).map(Content::Marks),
    }
}

/// A table without its units, which CSV does not have.
fn table_of_csv(bytes: &[u8]) -> Option<Table> {
    let mut reader = csv::Reader::from_reader(bytes);
    let mut table = Table::new(reader.headers().ok()?.iter().map(|name| Column::new(name, "")).collect());
    for record in reader.records() {
        table.push(record.ok()?.iter().map(cell_of_text).collect());
    }
    Some(table)
}

fn cell_of_text(text: &str) -> Cell {
    match text.parse::<f64>() {
        _ if text.is_empty() => Cell::Empty,
        Ok(value) => Cell::from_number(value),
        Err(_) => Cell::Text(text.to_owned()),
    }
}

/// The pixels' centers.
fn samples(table: &Table) -> Option<Marks> {
    let columns = [table.column("x")?, table.column("y")?];
    let values = table.rows.iter().flat_map(|row| columns.map(|column| row[column].number().unwrap_or(f64::NAN) as f32 + 0.5));
    Some(Marks { map: None, values: values.collect() })
}

fn lights(value: &Json) -> Option<Marks> {
    let number = |value: &Json| value.as_f64().map(|value| value as f32);
    let size = |name: &str| Some(value.get("map")?.get(name)?.as_u64()? as u32);
    let light = |light: &Json| {
        let region = light.get("region")?;
        let [x0, y0, x1, y1] = ["x0", "y0", "x1", "y1"].map(|name| region.get(name).and_then(number));
        let position = light.get("position")?;
        Some([x0?, y0?, x1?, y1?, number(position.get(0)?)?, number(position.get(1)?)?])
    };
    let values: Option<Vec<[f32; 6]>> = value.get("lights")?.as_array()?.iter().map(light).collect();
    Some(Marks { map: Some([size("width")?, size("height")?]), values: values?.into_flattened() })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_of_a_file_has_its_numbers_and_texts() {
        let table = table_of_csv(b"n,name,error\n64,\"a,b\",1e-3\n,c,NaN\n").unwrap();
        assert_eq!(table.names(), ["n", "name", "error"]);
        assert_eq!(table.rows[0], [Cell::Integer(64), Cell::Text("a,b".into()), Cell::Number(1e-3)]);
        assert_eq!(table.rows[1][0], Cell::Empty);
        assert!(table_of_csv(b"a,b\n1\n").is_none());
    }

    #[test]
    fn marks_of_lights_are_regions_with_a_point() {
        let text = r#"{"map":{"width":8,"height":4},"lights":[{"region":{"x0":0,"y0":1,"x1":2,"y1":3},"position":[0.5,2]}]}"#;
        let marks = lights(&serde_json::from_str(text).unwrap()).unwrap();
        assert_eq!(marks, Marks { map: Some([8, 4]), values: vec![0.0, 1.0, 2.0, 3.0, 0.5, 2.0] });
        assert!(lights(&serde_json::json!({ "lights": [{}], "map": { "width": 1, "height": 1 } })).is_none());
    }
}

//! All that the page says, gathered from a manifest and its results.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::path::Path;

use rayon::prelude::*;
use serde::Serialize;
use serde_json::{Map, Value as Json, json};

use super::overview::{Overview, overview, seconds_text};
use super::packing::{base64, packed_floats};
use super::pictures::{Look, Preview, Statistics, packed_image, packed_picture, preview, preview_of_picture};
use super::results::{Content, Results, Sort, input_jobs, job_places, result_place, source_of};
use super::sidecars::{self, Texts};
use super::tables::{self, Shown};
use super::timing::{Timing, timing};
use super::{ReportError, commands, prefix_of};
use crate::engine::manifest::{InputEntry, JobEntry, Manifest, OutputEntry, PublishedEntry, place_text, plain_text};
use crate::engine::provenance::runs::FoundRun;

/// The kind whose pictures are sheets of other pictures: shown among the figures.
const SHEET_KIND: &str = "grid";

/// The kind that measures a result (`of`) against a reference (`to`).
const COMPARING_KIND: &str = "compare";

/// Widths of previews, in pixels; the widest is taken with which all of them fit into half of the budget.
const WIDTHS: [usize; 8] = [360, 300, 240, 200, 160, 120, 80, 48];

/// Bytes of a preview's text for each pixel, in noise.
const BYTES_PER_PIXEL: f64 = 2.0;

/// Bytes that are set apart for the markup around an embedded text.
const MARKUP: u64 = 512;

/// Results that are packed at the same time: bounds the memory that it takes.
const BATCH: usize = 8;

/// How the page reaches the published files.
pub struct Links(Option<String>);

impl Links {
    /// From a page to the files of a run; none where the page lies elsewhere.
    pub fn from_page(page: &Path, run: &FoundRun) -> Self {
        Self(prefix_of(page, run, &run.manifest))
    }

    /// Text and address of each file.
    fn of(&self, files: &[&PublishedEntry]) -> Vec<[String; 2]> {
        let Some(prefix) = &self.0 else { return Vec::new() };
        let link = |entry: &&PublishedEntry| {
            let extension = entry.path.rsplit('.').next().unwrap_or_default().to_owned();
            [extension, format!("{prefix}{}", address(&entry.path))]
        };
        files.iter().map(link).collect()
    }
}

/// A relative path as an address.
fn address(path: &str) -> String {
    let mut out = String::with_capacity(path.len());
    for byte in path.bytes() {
        match byte {
            b'/' | b'-' | b'_' | b'.' | b'~' | b'0'..=b'9' | b'a'..=b'z' | b'A'..=b'Z' => out.push(char::from(byte)),
            _ => out.push_str(&format!("%{byte:02X}")),
        }
    }
    // A first part with a colon would be a scheme, and is escaped above.
    out
}

/// All that the page says.
#[derive(Serialize)]
pub struct Model {
    /// The head.
    pub overview: Overview,
    /// Images by stage: those that were published, then the others.
    pub groups: Vec<Group>,
    /// How many of the groups were published.
    pub published_groups: usize,
    /// Drawings and sheets.
    pub figures: Vec<Figure>,
    /// Errors against references.
    pub errors: Vec<Shown>,
    /// Published tables.
    pub tables: Vec<Shown>,
    /// Other tables.
    pub further_tables: Vec<Shown>,
    /// Where the time went.
    pub timing: Timing,
    /// Jobs by stage.
    pub stages: Vec<StageJobs>,
    /// The pipeline file and its includes: path and text.
    pub sources: Vec<[String; 2]>,
    /// The command that makes all of it again.
    pub command: String,
    /// Name of the folder beside the page.
    pub folder: String,
    /// What the script reads.
    pub data: Json,
    /// Pixels.
    #[serde(skip)]
    pub texts: Texts,
    /// Results that should be shown and are gone.
    #[serde(skip)]
    pub gone: Vec<String>,
    #[serde(skip)]
    previews: Vec<Option<Preview>>,
    #[serde(skip)]
    needed: Vec<Need>,
}

/// Images of one result of a stage.
#[derive(Debug, Serialize)]
pub struct Group {
    /// `stage` or `stage.result`.
    pub label: String,
    /// Name of the kind.
    pub kind: String,
    /// Axes, in order.
    pub axes: Vec<String>,
    /// Its images.
    pub images: Vec<Shot>,
}

/// An image of the page.
#[derive(Debug, Serialize)]
pub struct Shot {
    /// Its number.
    pub id: usize,
    /// What tells it from the others of its group.
    pub caption: String,
    /// `stage.result[axis=value]`.
    pub place: String,
    /// The preview in base64; none where it is gone or does not fit.
    pub source: Option<String>,
    /// Size of the preview.
    pub size: [usize; 2],
    /// Size of the image.
    pub full_size: [usize; 2],
    /// Whether it could not be read.
    pub is_gone: bool,
    /// What must be said of its pixels.
    pub remarks: Vec<String>,
    /// Links to published files.
    pub files: Vec<[String; 2]>,
}

/// A drawing.
#[derive(Debug, Serialize)]
pub struct Figure {
    /// `stage[axis=value]`.
    pub place: String,
    /// Index of its job.
    pub job: usize,
    /// An SVG in base64.
    pub source: String,
    /// The image that it is, where it is a sheet.
    pub image: Option<usize>,
    /// Links to published files.
    pub files: Vec<[String; 2]>,
}

/// Jobs of a stage.
#[derive(Debug, Serialize)]
pub struct StageJobs {
    /// Name of the stage.
    pub stage: String,
    /// Its kind, with its version.
    pub kind: String,
    /// What became of its jobs.
    pub outcomes: String,
    /// What they took.
    pub seconds: String,
    /// Rows.
    pub rows: Vec<JobRow>,
}

/// A job in the list.
#[derive(Debug, Serialize)]
pub struct JobRow {
    /// Its number.
    pub job: usize,
    /// Text of its coordinate.
    pub coordinate: String,
    /// What became of it.
    pub outcome: &'static str,
    /// Why.
    pub reason: String,
    /// What it took.
    pub seconds: String,
    /// First digits of its key.
    pub key: String,
}

/// A result whose content the viewer can ask for.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
struct Need {
    /// Bytes of its canonical form: small ones are embedded first.
    bytes: u64,
    /// Name of its text.
    name: String,
    job: usize,
    output: usize,
}

/// A result that has a place on the page.
#[derive(Debug, Clone, Copy)]
struct Entry<'m> {
    job: usize,
    output: usize,
    sort: Sort,
    entry: &'m JobEntry,
    result: &'m OutputEntry,
}

impl<'m> Entry<'m> {
    fn label(&self) -> String {
        label(&self.entry.stage, &self.result.name)
    }

    fn need(&self) -> Need {
        Need { bytes: self.result.bytes, name: sidecars::name(&self.result.sha256), job: self.job, output: self.output }
    }
}

fn label(stage: &str, result: &str) -> String {
    if result.is_empty() { stage.to_owned() } else { format!("{stage}.{result}") }
}

fn entries(manifest: &Manifest) -> Vec<Entry<'_>> {
    let mut entries = Vec::new();
    for (job, entry) in manifest.jobs.iter().enumerate() {
        for (output, result) in entry.outputs.iter().enumerate() {
            entries.extend(Sort::of(&result.type_name).map(|sort| Entry { job, output, sort, entry, result }));
        }
    }
    entries
}

/// Entries by label, in order of first appearance.
fn grouped<'m>(entries: impl Iterator<Item = Entry<'m>>) -> Vec<(String, Vec<Entry<'m>>)> {
    let mut groups: Vec<(String, Vec<Entry<'m>>)> = Vec::new();
    let mut places: HashMap<String, usize> = HashMap::new();
    for entry in entries {
        let label = entry.label();
        let place = *places.entry(label.clone()).or_insert(groups.len());
        if place == groups.len() {
            groups.push((label, Vec::new()));
        }
        groups[place].1.push(entry);
    }
    groups
}

impl Model {
    /// Everything but pixels of the viewer and the texts of previews.
    pub fn of(
        manifest: &Manifest,
        results: &Results<'_>,
        links: &Links,
        budget: u64,
        is_stopped: &(dyn Fn() -> bool + Sync),
    ) -> Result<Self, ReportError> {
        let entries = entries(manifest);
        let is_published = |entry: &Entry<'_>| !results.files(entry.entry, &entry.result.name).is_empty();
        let mut image_groups = grouped(entries.iter().copied().filter(|entry| entry.sort.is_image()));
        let (sheets, images): (Vec<_>, Vec<_>) = image_groups.drain(..).partition(|(_, group)| group[0].entry.kind == SHEET_KIND);
        let (published, others): (Vec<_>, Vec<_>) = images.into_iter().partition(|(_, group)| group.iter().any(is_published));
        let published_groups = published.len();
        let all: Vec<(String, Vec<Entry<'_>>)> = published.into_iter().chain(others).chain(sheets).collect();

        let count = all.iter().map(|(_, group)| group.len()).sum();
        let width = preview_width(count, budget);
        let previews: Vec<Vec<Option<Preview>>> = all
            .par_iter()
            .map(|(_, group)| if is_stopped() { Err(ReportError::Interrupted) } else { Ok(previews(group, results, width)) })
            .collect::<Result<_, _>>()?;

        let mut groups = Vec::new();
        let mut figures = Vec::new();
        let mut shots = Vec::new();
        let mut needed = BTreeSet::new();
        let mut gone = Vec::new();
        for ((label, group), previews) in all.iter().zip(&previews) {
            let first = shots.len();
            let axes = axes(group);
            let made: Vec<Shot> = group
                .iter()
                .zip(previews)
                .enumerate()
                .map(|(index, (entry, preview))| shot(first + index, entry, preview.as_ref(), results, links))
                .collect();
            for (entry, preview) in group.iter().zip(previews) {
                match preview {
                    Some(_) => drop(needed.insert(entry.need())),
                    None => gone.push(result_place(entry.entry, &entry.result.name)),
                }
                shots.push(image_data(entry, preview.as_ref(), groups.len(), results));
            }
            if group[0].entry.kind == SHEET_KIND {
                figures.extend(made.into_iter().zip(group).filter(|(shot, _)| !shot.is_gone).map(|(shot, entry)| Figure {
                    place: shot.place,
                    job: entry.job,
                    source: String::new(),
                    image: Some(shot.id),
                    files: shot.files,
                }));
            } else {
                groups.push(Group { label: label.clone(), kind: group[0].entry.kind.clone(), axes, images: made });
            }
        }
        let previews: Vec<Option<Preview>> = previews.into_iter().flatten().collect();

        let drawings = drawings(&entries, results, links, &mut gone);
        let sheet_figures = std::mem::take(&mut figures);
        let figures = drawings.into_iter().chain(sheet_figures).collect();
        let (errors, tables, further_tables) = all_tables(&entries, results, links, &mut gone);
        let marks = marks(&entries, &all, manifest, results, &mut needed, &mut gone);
        let references = references(manifest, &all);
        for (image, reference) in references {
            shots[image]["ref"] = json!(reference);
        }
        let run_command = commands::run_command(manifest);
        let data = json!({
            "run": { "pipeline": manifest.pipeline, "id": manifest.run_id, "command": run_command },
            "groups": groups.iter().map(|group: &Group| json!({ "label": group.label, "axes": group.axes })).collect::<Vec<_>>(),
            "images": shots,
            "marks": marks,
            "jobs": jobs(manifest, results, links),
            "embedded": [],
        });
        Ok(Self {
            overview: overview(manifest, &gone),
            groups,
            published_groups,
            figures,
            errors,
            tables,
            further_tables,
            timing: timing(manifest),
            stages: stages(manifest),
            sources: manifest.spec.iter().map(|spec| [spec.path.clone(), spec.text.clone()]).collect(),
            command: run_command,
            folder: String::new(),
            data,
            texts: Texts::default(),
            gone,
            previews,
            needed: needed.into_iter().collect(),
        })
    }

    /// Puts previews and pixels into so many bytes, and the rest of the pixels beside the page.
    pub fn embed(
        &mut self,
        manifest: &Manifest,
        results: &Results<'_>,
        budget: u64,
        folder: &Path,
        is_stopped: &(dyn Fn() -> bool + Sync),
    ) -> Result<(), ReportError> {
        self.folder = folder.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        let mut left = self.embed_previews(budget);
        let mut needed = std::mem::take(&mut self.needed);
        needed.sort();
        needed.dedup_by(|one, other| one.name == other.name);
        for batch in needed.chunks(BATCH) {
            if is_stopped() {
                return Err(ReportError::Interrupted);
            }
            // Once nothing more fits, what stands beside the page already need not be packed again.
            let is_full = left == 0;
            let pack = |need: &Need| if is_full && sidecars::is_there(folder, &need.name) { None } else { packed(need, manifest, results) };
            let packed: Vec<Option<String>> = batch.par_iter().map(pack).collect();
            for (need, text) in batch.iter().zip(packed) {
                match text {
                    Some(text) if text.len() as u64 + MARKUP <= left => {
                        left -= text.len() as u64 + MARKUP;
                        self.texts.embedded.insert(need.name.clone(), text);
                    }
                    Some(text) => {
                        left = 0;
                        sidecars::write(folder, &need.name, &text)?;
                        self.texts.beside.insert(need.name.clone());
                    }
                    None => drop(self.texts.beside.insert(need.name.clone())),
                }
            }
        }
        self.data["embedded"] = self.texts.embedded.keys().cloned().collect::<Vec<_>>().into();
        Ok(())
    }

    /// Gives what is left of the budget.
    fn embed_previews(&mut self, budget: u64) -> u64 {
        let mut left = budget;
        let previews = std::mem::take(&mut self.previews);
        let mut text = |id: usize| {
            let text = base64(&previews[id].as_ref()?.png);
            left = left.checked_sub(text.len() as u64 + MARKUP)?;
            Some(text)
        };
        for figure in &mut self.figures {
            figure.source = figure.image.map_or_else(|| std::mem::take(&mut figure.source), |id| text(id).unwrap_or_default());
        }
        for shot in self.groups.iter_mut().flat_map(|group| &mut group.images) {
            shot.source = text(shot.id);
        }
        left
    }
}

fn preview_width(count: usize, budget: u64) -> usize {
    let fits = |width: &&usize| count as f64 * (**width * **width) as f64 * BYTES_PER_PIXEL <= budget as f64 / 2.0;
    *WIDTHS.iter().find(fits).unwrap_or(&WIDTHS[WIDTHS.len() - 1])
}

/// Those of linear images with one exposure, chosen by the first that has light.
fn previews(group: &[Entry<'_>], results: &Results<'_>, width: usize) -> Vec<Option<Preview>> {
    let is_error = group[0].entry.kind == COMPARING_KIND;
    let width = if group[0].entry.kind == SHEET_KIND { width.max(WIDTHS[0]) * 2 } else { width };
    let mut stops = None;
    let made = |entry: &Entry<'_>| match results.content(entry.entry, entry.result)? {
        Content::Linear(image) => {
            let preview = preview(&image, Look { width, stops, is_error });
            if preview.statistics.max.is_some_and(|max| max > 0.0) {
                stops = stops.or(Some(preview.stops));
            }
            Some(preview)
        }
        Content::Display(picture) => Some(preview_of_picture(&picture, width)),
        _ => None,
    };
    group.iter().map(made).collect()
}

fn axes(group: &[Entry<'_>]) -> Vec<String> {
    let mut axes: Vec<String> = Vec::new();
    for axis in group.iter().filter_map(|entry| entry.entry.coordinate.as_object()).flat_map(Map::keys) {
        if !axes.contains(axis) {
            axes.push(axis.clone());
        }
    }
    axes
}

fn shot(id: usize, entry: &Entry<'_>, preview: Option<&Preview>, results: &Results<'_>, links: &Links) -> Shot {
    let coordinate = entry.entry.coordinate.as_object().into_iter().flatten();
    let caption: Vec<String> = coordinate.map(|(axis, value)| format!("{axis} = {}", plain_text(value))).collect();
    Shot {
        id,
        caption: caption.join(", "),
        place: result_place(entry.entry, &entry.result.name),
        source: None,
        size: preview.map_or([0, 0], |preview| preview.size),
        full_size: preview.map_or([0, 0], |preview| preview.full_size),
        is_gone: preview.is_none(),
        remarks: preview.map(|preview| remarks(&preview.statistics)).unwrap_or_default(),
        files: links.of(results.files(entry.entry, &entry.result.name)),
    }
}

fn remarks(statistics: &Statistics) -> Vec<String> {
    let of = |count: u64, what: &str| (count > 0).then(|| format!("{count} {what}"));
    let Statistics { nan, infinite, negative, .. } = *statistics;
    [of(nan, "NaN"), of(infinite, "infinite"), of(negative, "negative")].into_iter().flatten().collect()
}

fn image_data(entry: &Entry<'_>, preview: Option<&Preview>, group: usize, results: &Results<'_>) -> Json {
    let coordinate = entry.entry.coordinate.as_object().into_iter().flatten();
    let texts: Map<String, Json> = coordinate.map(|(axis, value)| (axis.clone(), plain_text(value).into())).collect();
    let mut data = json!({
        "place": result_place(entry.entry, &entry.result.name),
        "group": group,
        "job": entry.job,
        "at": texts,
        "map": entry.sort == Sort::Map,
        "display": entry.sort == Sort::Display,
        "published": !results.files(entry.entry, &entry.result.name).is_empty(),
    });
    if let Some(preview) = preview {
        let [width, height] = preview.full_size;
        data["size"] = json!([width, height]);
        data["stops"] = json!((preview.stops * 100.0).round() / 100.0);
        data["stats"] = json!(preview.statistics);
        data["data"] = sidecars::name(&entry.result.sha256).into();
    }
    data
}

fn packed(need: &Need, manifest: &Manifest, results: &Results<'_>) -> Option<String> {
    let job = &manifest.jobs[need.job];
    Some(match results.content(job, &job.outputs[need.output])? {
        Content::Linear(image) => packed_image(&image),
        Content::Display(picture) => packed_picture(&picture),
        Content::Marks(marks) => packed_floats(&[marks.values]),
        Content::Table(_) | Content::Figure(_) => return None,
    })
}

fn drawings(entries: &[Entry<'_>], results: &Results<'_>, links: &Links, gone: &mut Vec<String>) -> Vec<Figure> {
    let figures = entries.iter().filter(|entry| entry.sort == Sort::Figure);
    let read: Vec<_> = figures.map(|entry| (entry, results.content(entry.entry, entry.result))).collect();
    let mut drawings = Vec::new();
    for (entry, content) in read {
        let place = result_place(entry.entry, &entry.result.name);
        match content {
            Some(Content::Figure(text)) => drawings.push(Figure {
                place,
                job: entry.job,
                source: base64(text.as_bytes()),
                image: None,
                files: links.of(results.files(entry.entry, &entry.result.name)),
            }),
            _ => gone.push(place),
        }
    }
    drawings
}

/// Errors against a reference, published tables, and the others.
fn all_tables(entries: &[Entry<'_>], results: &Results<'_>, links: &Links, gone: &mut Vec<String>) -> (Vec<Shown>, Vec<Shown>, Vec<Shown>) {
    let (mut errors, mut tables, mut others) = (Vec::new(), Vec::new(), Vec::new());
    for (label, group) in grouped(entries.iter().copied().filter(|entry| entry.sort == Sort::Table)) {
        let mut parts = Vec::new();
        for entry in &group {
            match results.content(entry.entry, entry.result) {
                Some(Content::Table(table)) => parts.push((&entry.entry.coordinate, table)),
                _ => gone.push(result_place(entry.entry, &entry.result.name)),
            }
        }
        if parts.is_empty() {
            continue;
        }
        let mut table = tables::shown(label, &parts);
        table.files = group.iter().flat_map(|entry| links.of(results.files(entry.entry, &entry.result.name))).take(4).collect();
        let is_published = group.iter().any(|entry| !results.files(entry.entry, &entry.result.name).is_empty());
        if group[0].entry.kind == COMPARING_KIND {
            table.note = compared(group[0].entry);
            errors.push(table);
        } else if is_published {
            tables.push(table);
        } else {
            others.push(table);
        }
    }
    (errors, tables, others)
}

/// `sphere against exact`.
fn compared(job: &JobEntry) -> String {
    let on_port = |name: &str| job.inputs.iter().find(|input| input.port == name).map_or("?", |input| input.stage.as_str());
    format!("{} against {}", on_port("of"), on_port("to"))
}

/// The reference of each image that a comparison measured.
fn references(manifest: &Manifest, groups: &[(String, Vec<Entry<'_>>)]) -> BTreeMap<usize, usize> {
    let ids: HashMap<String, usize> = groups
        .iter()
        .flat_map(|(_, group)| group)
        .enumerate()
        .map(|(id, entry)| (result_place(entry.entry, &entry.result.name), id))
        .collect();
    let on_port = |job: &JobEntry, name: &str| {
        let input = job.inputs.iter().find(|input| input.port == name)?;
        ids.get(&place_text(&input.stage, &input.coordinate)).copied()
    };
    let comparisons = manifest.jobs.iter().filter(|job| job.kind == COMPARING_KIND);
    comparisons.filter_map(|job| Some((on_port(job, "of")?, on_port(job, "to")?))).collect()
}

/// Samples and lights that can be laid over maps.
fn marks(
    entries: &[Entry<'_>],
    groups: &[(String, Vec<Entry<'_>>)],
    manifest: &Manifest,
    results: &Results<'_>,
    needed: &mut BTreeSet<Need>,
    gone: &mut Vec<String>,
) -> Vec<Json> {
    let places = job_places(&manifest.jobs);
    let maps = groups.iter().flat_map(|(_, group)| group).enumerate().filter(|(_, entry)| entry.sort == Sort::Map);
    let maps: HashMap<usize, usize> = maps.map(|(id, entry)| (entry.job, id)).collect();
    let mut marks = Vec::new();
    for entry in entries.iter().filter(|entry| matches!(entry.sort, Sort::Samples | Sort::Lights)) {
        let place = result_place(entry.entry, &entry.result.name);
        let Some(Content::Marks(content)) = results.content(entry.entry, entry.result) else {
            gone.push(place);
            continue;
        };
        needed.insert(entry.need());
        marks.push(json!({
            "place": place,
            "regions": entry.sort == Sort::Lights,
            "count": content.values.len() / if entry.sort == Sort::Lights { 6 } else { 2 },
            "size": content.map,
            "of": map_behind(entry.job, manifest, &places, &maps),
            "data": sidecars::name(&entry.result.sha256),
        }));
    }
    marks
}

/// The image of the map that a job descends from, the nearest first.
fn map_behind(job: usize, manifest: &Manifest, places: &HashMap<String, usize>, maps: &HashMap<usize, usize>) -> Option<usize> {
    let mut seen = BTreeSet::from([job]);
    let mut level = vec![job];
    while !level.is_empty() {
        if let Some(id) = level.iter().find_map(|job| maps.get(job)) {
            return Some(*id);
        }
        let inputs = level.iter().flat_map(|job| input_jobs(&manifest.jobs[*job], places));
        level = inputs.filter(|input| seen.insert(*input)).collect();
    }
    None
}

/// What is shown of a job when it is asked for.
fn jobs(manifest: &Manifest, results: &Results<'_>, links: &Links) -> Vec<Json> {
    let places = job_places(&manifest.jobs);
    let input = |input: &InputEntry| json!([input.port, place_text(&input.stage, &input.coordinate), source_of(input, &places)]);
    let entry = |job: &JobEntry| {
        let mut entry = json!({
            "place": place_text(&job.stage, &job.coordinate),
            "kind": format!("{} (version {})", job.kind, job.version),
            "outcome": job.outcome.word(),
            "reason": job.reason,
            "only": commands::only(job),
        });
        let mut add = |name: &str, value: Json, is_there: bool| {
            if is_there {
                entry[name] = value;
            }
        };
        let parameters = job.parameters.as_object().is_some_and(|parameters| !parameters.is_empty());
        add("parameters", job.parameters.clone(), parameters);
        add("seed", json!(job.seed), job.seed.is_some());
        add("key", json!(job.key), job.key.is_some());
        add("time", json!(time_text(job)), job.measured.is_some());
        add("inputs", job.inputs.iter().map(input).collect(), !job.inputs.is_empty());
        let read = job.files.iter().map(|file| json!([file.parameter, file.path, file.sha256]));
        add("read", read.collect(), !job.files.is_empty());
        add("warnings", json!(job.warnings), !job.warnings.is_empty());
        add("error", json!(job.error), job.error.is_some());
        let outputs = job.outputs.iter().map(|output| {
            let files: Vec<Json> = results
                .files(job, &output.name)
                .iter()
                .map(|file| json!([file.path, links.of(&[file]).first().map(|link| &link[1])]))
                .collect();
            json!([output.name, output.type_name, output.sha256, output.bytes, files])
        });
        add("outputs", outputs.collect(), !job.outputs.is_empty());
        entry
    };
    manifest.jobs.iter().map(entry).collect()
}

fn stages(manifest: &Manifest) -> Vec<StageJobs> {
    let mut order: Vec<&str> = Vec::new();
    let mut jobs: HashMap<&str, Vec<usize>> = HashMap::new();
    for (index, job) in manifest.jobs.iter().enumerate() {
        let of_stage = jobs.entry(&job.stage).or_default();
        if of_stage.is_empty() {
            order.push(&job.stage);
        }
        of_stage.push(index);
    }
    order.into_iter().map(|stage| stage_jobs(stage, &jobs[stage], manifest)).collect()
}

fn stage_jobs(stage: &str, jobs: &[usize], manifest: &Manifest) -> StageJobs {
    let entries = || jobs.iter().map(|job| &manifest.jobs[*job]);
    let mut outcomes: BTreeMap<&str, usize> = BTreeMap::new();
    entries().for_each(|job| *outcomes.entry(job.outcome.word()).or_default() += 1);
    let outcomes: Vec<String> = outcomes.iter().map(|(word, count)| format!("{count} {word}")).collect();
    let time = |job: &JobEntry| job.measured.as_ref().map_or(0.0, |measured| measured.seconds);
    let row = |index: &usize| {
        let job = &manifest.jobs[*index];
        let coordinate = job.coordinate.as_object().into_iter().flatten();
        let texts: Vec<String> = coordinate.map(|(axis, value)| format!("{axis} = {}", plain_text(value))).collect();
        JobRow {
            job: *index,
            coordinate: texts.join(", "),
            outcome: job.outcome.word(),
            reason: job.error.clone().unwrap_or_else(|| job.reason.clone()),
            seconds: job.measured.as_ref().map(|measured| seconds_text(measured.seconds)).unwrap_or_default(),
            key: job.key.map(|key| key.to_string()[..12].to_owned()).unwrap_or_default(),
        }
    };
    let first = &manifest.jobs[jobs[0]];
    StageJobs {
        stage: stage.to_owned(),
        kind: first.kind.clone(),
        outcomes: outcomes.join(", "),
        seconds: seconds_text(entries().map(time).sum()),
        rows: jobs.iter().map(row).collect(),
    }
}

/// What a job took, and what its parts took.
fn time_text(job: &JobEntry) -> String {
    let own = job.measured.as_ref().map_or(0.0, |measured| measured.seconds);
    match job.part_seconds().count() {
        0 => seconds_text(own),
        count => format!("{}, and {} in {count} parts", seconds_text(own), seconds_text(job.part_seconds().sum())),
    }
}

#[cfg(test)]
pub mod tests {
    use super::*;
    use crate::engine::digest::Digest;
    use crate::engine::manifest::{JobMeasured, Outcome};

    /// A job without axes that ran for so long, and took the first results of others.
    pub fn job(stage: &str, inputs: &[&str], seconds: f64) -> JobEntry {
        let input = |stage: &&str| InputEntry { port: "of".into(), stage: (*stage).into(), coordinate: json!({}), sha256: None };
        JobEntry {
            stage: stage.into(),
            coordinate: json!({}),
            kind: format!("kind-{stage}"),
            version: 1,
            parameters: json!({}),
            seed: None,
            key: Some(Digest::of(stage.as_bytes())),
            outcome: Outcome::Ran,
            reason: "never ran".into(),
            inputs: inputs.iter().map(input).collect(),
            files: Vec::new(),
            outputs: Vec::new(),
            warnings: Vec::new(),
            error: None,
            parts: Vec::new(),
            measured: Some(JobMeasured { seconds, memory: 0, start: Some(0.0), thread: Some(0), host: None }),
        }
    }

    #[test]
    fn addresses_have_no_character_with_a_meaning() {
        assert_eq!(address("sphere/n=64,g=2.2.png"), "sphere/n%3D64%2Cg%3D2.2.png");
        assert_eq!(address("javascript:alert(1)"), "javascript%3Aalert%281%29");
        assert_eq!(address("a%20\"<b>"), "a%2520%22%3Cb%3E");
    }

    #[test]
    fn previews_get_smaller_as_there_are_more() {
        assert_eq!(preview_width(1, 24 << 20), 360);
        assert!(preview_width(200, 24 << 20) < 200);
        assert_eq!(preview_width(100_000, 24 << 20), 48);
    }
}

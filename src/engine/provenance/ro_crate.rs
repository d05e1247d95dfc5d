//! A run as a research object: `ro-crate-metadata.json`, RO-Crate 1.1 with the Provenance Run Crate profile 0.5.
//!
//! Made of the manifest alone, so that equal manifests give equal bytes. The crate is the folder of the
//! pipeline's outputs: its files are the published ones, the manifest, and the pipeline's text, which is kept
//! with the run. Every job is an action of a tool (its kind); jobs that this run executed are also steps that it
//! controlled, while one taken from the store was executed by an earlier run. Says no more of the machine and
//! its user than the manifest does. After <https://w3id.org/ro/wfrun/provenance/0.5>.

use std::collections::{BTreeMap, HashMap, HashSet};
use std::fmt::Write;

use serde_json::Value as Json;

use crate::engine::lines::{add_line, add_text};
use crate::engine::manifest::{FileEntry, JobEntry, Manifest, Outcome, Status, place_text, plain_text};

/// Name of the file, beside the manifest.
pub const FILE_NAME: &str = "ro-crate-metadata.json";

const CRATE: &str = "https://w3id.org/ro/crate/1.1";
const WORKFLOW_CRATE: &str = "https://w3id.org/workflowhub/workflow-ro-crate/1.0";

/// Profiles of a run, each with name and version; the last one only if a job was executed.
const PROFILES: [(&str, &str, &str); 4] = [
    ("https://w3id.org/ro/wfrun/process/0.5", "Process Run Crate", "0.5"),
    ("https://w3id.org/ro/wfrun/workflow/0.5", "Workflow Run Crate", "0.5"),
    (WORKFLOW_CRATE, "Workflow RO-Crate", "1.0"),
    ("https://w3id.org/ro/wfrun/provenance/0.5", "Provenance Run Crate", "0.5"),
];

const ENGINE: &str = "#engine";
const LANGUAGE: &str = "#language";
const RUN: &str = "#run";

/// Where the text of the pipeline is kept with a run, below the folder of its outputs: (path, text).
pub fn workflow_files(manifest: &Manifest) -> impl Iterator<Item = (String, &str)> {
    manifest.spec.iter().map(|entry| (workflow_path(manifest, &entry.path), entry.text.as_str()))
}

fn workflow_path(manifest: &Manifest, path: &str) -> String {
    format!("runs/{}/spec/{path}", manifest.run_id)
}

/// The text of the crate.
pub fn text(manifest: &Manifest) -> String {
    let head = format!("{{\"@context\":[\"{CRATE}/context\",\"https://w3id.org/ro/terms/workflow-run/context\"],\"@graph\":[\n");
    // About as much as a job with a file takes.
    let mut text = Vec::with_capacity(head.len() + (manifest.jobs.len() + manifest.published.len() + 8) * 768);
    text.extend(head.as_bytes());
    Crate::new(manifest).write(&mut Entities { text: &mut text, has_any: false });
    text.extend(b"\n]}\n");
    String::from_utf8(text).expect("JSON is UTF-8")
}

/// The entities of a crate, one behind the other: there may be several for each of many thousand jobs.
struct Entities<'t> {
    text: &'t mut Vec<u8>,
    has_any: bool,
}

impl Entities<'_> {
    /// Begins one.
    fn add(&mut self, id: &str, types: &[&str]) -> Entity<'_> {
        if self.has_any {
            self.text.extend(b",\n");
        }
        self.has_any = true;
        self.text.extend(b"{\"@id\":");
        let entity = Entity { text: self.text }.value(id);
        match types {
            [only] => entity.text("@type", only),
            several => {
                let entity = entity.name("@type");
                add_line(several, entity.text);
                entity
            }
        }
    }
}

/// An entity that is being written.
#[must_use = "it is not closed before its end"]
struct Entity<'t> {
    text: &'t mut Vec<u8>,
}

impl Entity<'_> {
    fn value(self, text: &str) -> Self {
        add_text(text, self.text);
        self
    }

    fn name(mut self, name: &str) -> Self {
        self.text.push(b',');
        self = self.value(name);
        self.text.push(b':');
        self
    }

    fn text(self, name: &str, text: &str) -> Self {
        self.name(name).value(text)
    }

    fn reference(mut self, name: &str, id: &str) -> Self {
        self = self.name(name);
        self.text.extend(b"{\"@id\":");
        self = self.value(id);
        self.text.push(b'}');
        self
    }

    fn references(mut self, name: &str, ids: impl IntoIterator<Item = impl AsRef<str>>) -> Self {
        self = self.name(name);
        self.text.push(b'[');
        for (index, id) in ids.into_iter().enumerate() {
            self.text.extend(if index == 0 { b"{\"@id\":".as_slice() } else { b",{\"@id\":" });
            self = self.value(id.as_ref());
            self.text.push(b'}');
        }
        self.text.push(b']');
        self
    }

    fn end(self) {
        self.text.push(b'}');
    }
}

struct Crate<'m> {
    manifest: &'m Manifest,
    /// Published files by the job that gave them, as [`place_text`] names its result.
    files: HashMap<&'m str, Vec<&'m str>>,
    /// Stages in the order of their first job, each with that job.
    stages: Vec<&'m JobEntry>,
    /// Jobs with results, and those that failed: each is an action.
    jobs: Vec<&'m JobEntry>,
    has_steps: bool,
}

impl<'m> Crate<'m> {
    fn new(manifest: &'m Manifest) -> Self {
        let mut files: HashMap<&str, Vec<&str>> = HashMap::new();
        for entry in &manifest.published {
            files.entry(&entry.job).or_default().push(&entry.path);
        }
        let jobs: Vec<&JobEntry> = manifest.jobs.iter().filter(|job| !job.outputs.is_empty() || job.outcome == Outcome::Failed).collect();
        let mut seen = HashSet::new();
        let stages = jobs.iter().copied().filter(|job| seen.insert(job.stage.as_str())).collect();
        let has_steps = jobs.iter().any(|job| was_executed(job));
        Self { manifest, files, stages, jobs, has_steps }
    }

    fn write(&self, out: &mut Entities<'_>) {
        let no_license = "The author of the pipeline decides on the license of its results.";
        out.add(FILE_NAME, &["CreativeWork"]).reference("about", "./").references("conformsTo", [CRATE, WORKFLOW_CRATE]).end();
        self.add_root(out);
        self.add_workflow(out);
        for (id, name, version) in self.profiles() {
            out.add(id, &["CreativeWork"]).text("name", name).text("version", version).end();
        }
        out.add("#no-license", &["CreativeWork"]).text("name", "No license is stated").text("description", no_license).end();
        self.add_programs(out);
        self.add_parameters(out);
        self.add_data(out);
        self.add_actions(out);
    }

    fn profiles(&self) -> impl Iterator<Item = (&'static str, &'static str, &'static str)> + use<> {
        PROFILES.into_iter().take(if self.has_steps { PROFILES.len() } else { PROFILES.len() - 1 })
    }

    fn main_id(&self) -> String {
        self.manifest.spec.first().map(|entry| path_id(&workflow_path(self.manifest, &entry.path))).unwrap_or_default()
    }

    fn add_root(&self, out: &mut Entities<'_>) {
        let manifest = self.manifest;
        let texts = workflow_files(manifest).map(|(path, _)| path_id(&path));
        let published = manifest.published.iter().map(|entry| path_id(&entry.path));
        let parts = texts.chain(["manifest.json".to_owned()]).chain(published).chain(self.inputs().into_keys());
        let description =
            format!("Files that the pipeline {} published, and how each was made; result_id {}", manifest.pipeline, manifest.result_id);
        out.add("./", &["Dataset"])
            .text("name", &format!("Run {} of the pipeline {}", manifest.run_id, manifest.pipeline))
            .text("description", &description)
            .text("datePublished", &manifest.measured.started)
            .reference("license", "#no-license")
            .references("conformsTo", self.profiles().map(|(id, ..)| id))
            .reference("mainEntity", &self.main_id())
            .references("hasPart", parts)
            .references("mentions", self.has_steps.then_some("#organize").into_iter().chain([RUN]))
            .end();
    }

    fn add_workflow(&self, out: &mut Entities<'_>) {
        let manifest = self.manifest;
        let digest = manifest.spec.first().map(|entry| entry.sha256.to_string()).unwrap_or_default();
        let types = ["File", "SoftwareSourceCode", "ComputationalWorkflow", "HowTo"];
        let workflow = out
            .add(&self.main_id(), if self.has_steps { &types } else { &types[..3] })
            .text("name", &manifest.pipeline)
            .text("encodingFormat", "application/yaml")
            .text("sha256", &digest)
            .reference("programmingLanguage", LANGUAGE)
            .references("input", self.formal_inputs().map(|(id, ..)| id))
            .references("output", self.published_stages().keys().map(|stage| output_id(stage)))
            .references("hasPart", self.tools().into_keys());
        if self.has_steps { workflow.references("step", self.stages.iter().map(|job| step_id(&job.stage))).end() } else { workflow.end() }
    }

    /// Kinds by their identifier: name and version.
    fn tools(&self) -> BTreeMap<String, (&'m str, u32)> {
        // A stage has one kind.
        self.stages.iter().map(|job| (tool_id(job), (job.kind.as_str(), job.version))).collect()
    }

    fn add_programs(&self, out: &mut Entities<'_>) {
        let program = &self.manifest.program;
        out.add(LANGUAGE, &["ComputerLanguage"])
            .text("name", "pipeline file")
            .text("alternateName", "YAML")
            .reference("identifier", "https://yaml.org/spec/1.2.2/")
            .reference("url", "https://yaml.org/")
            .end();
        out.add(ENGINE, &["SoftwareApplication"])
            .text("name", &program.name)
            .text("softwareVersion", &program.version)
            .text("description", &format!("{} build", program.build))
            .end();
        for (id, (kind, version)) in self.tools() {
            out.add(&id, &["SoftwareApplication"])
                .text("name", kind)
                .text("softwareVersion", &version.to_string())
                .text("description", &format!("Stages of the kind {kind}; `pipeline stages {kind}` explains it"))
                .end();
        }
        for (index, job) in self.stages.iter().enumerate().filter(|_| self.has_steps) {
            out.add(&step_id(&job.stage), &["HowToStep"])
                .text("name", &job.stage)
                .text("position", &(index + 1).to_string())
                .reference("workExample", &tool_id(job))
                .end();
        }
    }

    /// What the command line changed, and the seed: identifier, name, value.
    fn formal_inputs(&self) -> impl Iterator<Item = (String, String, String)> + use<> {
        let overrides = &self.manifest.overrides;
        let texts = |group: &str, flag: &str| {
            let fields = overrides.get(group).and_then(Json::as_object).into_iter().flatten();
            fields.map(|(name, text)| (format!("#{flag}-{}", id_part(name)), name.clone(), plain_text(text))).collect::<Vec<_>>()
        };
        let seed = ("#seed".to_owned(), "seed".to_owned(), self.manifest.seed.to_string());
        [vec![seed], texts("params", "parameter"), texts("axes", "axis")].into_iter().flatten()
    }

    fn add_parameters(&self, out: &mut Entities<'_>) {
        for (id, name, value) in self.formal_inputs() {
            let value_id = format!("{id}-value");
            let formal = out.add(&id, &["FormalParameter"]).text("additionalType", "PropertyValue").text("name", &name);
            formal.reference("workExample", &value_id).end();
            out.add(&value_id, &["PropertyValue"]).text("name", &name).text("value", &value).reference("exampleOfWork", &id).end();
        }
        for (stage, paths) in self.published_stages() {
            let formal = out.add(&output_id(stage), &["FormalParameter"]).text("additionalType", "File").text("name", stage);
            formal.references("workExample", paths.into_iter().map(path_id)).end();
        }
    }

    /// Paths of published files by stage, with `.result` for a further one.
    fn published_stages(&self) -> BTreeMap<&'m str, Vec<&'m str>> {
        self.manifest.published.iter().fold(BTreeMap::new(), |mut stages: BTreeMap<_, Vec<_>>, entry| {
            stages.entry(stage_of(&entry.job)).or_default().push(entry.path.as_str());
            stages
        })
    }

    /// Input files by their identifier, which is their digest: they are no part of the folder.
    fn inputs(&self) -> BTreeMap<String, &'m FileEntry> {
        self.manifest.jobs.iter().flat_map(|job| &job.files).map(|file| (input_id(file), file)).collect()
    }

    fn add_data(&self, out: &mut Entities<'_>) {
        let manifest = self.manifest;
        out.add("manifest.json", &["File"])
            .text("name", "The program's own record of the run")
            .text("encodingFormat", "application/json")
            .end();
        for entry in manifest.spec.iter().skip(1) {
            out.add(&path_id(&workflow_path(manifest, &entry.path)), &["File", "SoftwareSourceCode"])
                .text("name", &entry.path)
                .text("encodingFormat", "application/yaml")
                .text("sha256", &entry.sha256.to_string())
                .end();
        }
        for (id, file) in self.inputs() {
            out.add(&id, &["File"]).text("name", &file.path).text("sha256", &file.sha256.to_string()).end();
        }
        for entry in &manifest.published {
            out.add(&path_id(&entry.path), &["File"])
                .text("name", &entry.job)
                .text("encodingFormat", encoding_format(&entry.path))
                .text("sha256", &entry.sha256.to_string())
                .reference("exampleOfWork", &output_id(stage_of(&entry.job)))
                .end();
        }
    }

    fn add_actions(&self, out: &mut Entities<'_>) {
        let manifest = self.manifest;
        let started = &manifest.measured.started;
        let ended = end_of(started, manifest.measured.seconds);
        self.add_run(out, &ended);
        let numbered = || self.jobs.iter().enumerate();
        if self.has_steps {
            let controls = numbered().filter(|(_, job)| was_executed(job));
            out.add("#organize", &["OrganizeAction"])
                .text("name", &format!("Scheduling of run {}", manifest.run_id))
                .reference("instrument", ENGINE)
                .text("startTime", started)
                .text("endTime", &ended)
                .references("object", controls.clone().map(|(index, _)| format!("#control-{index}")))
                .reference("result", RUN)
                .end();
            for (index, job) in controls {
                out.add(&format!("#control-{index}"), &["ControlAction"])
                    .text("name", &place_text(&job.stage, &job.coordinate))
                    .text("description", &job.reason)
                    .reference("instrument", &step_id(&job.stage))
                    .reference("object", &format!("#job-{index}"))
                    .end();
            }
        }
        numbered().for_each(|(index, job)| self.add_action(out, index, job));
    }

    /// The run as a whole.
    fn add_run(&self, out: &mut Entities<'_>, ended: &str) {
        let manifest = self.manifest;
        let is_done = manifest.status == Status::Done;
        let values = self.formal_inputs().map(|(id, ..)| format!("{id}-value"));
        let run = out
            .add(RUN, &["CreateAction"])
            .text("name", &format!("Run {} of {}", manifest.run_id, manifest.pipeline))
            .reference("instrument", &self.main_id())
            .text("startTime", &manifest.measured.started)
            .text("endTime", ended)
            .text("actionStatus", action_status(is_done))
            .references("object", values.chain(self.inputs().into_keys()))
            .references("result", manifest.published.iter().map(|entry| path_id(&entry.path)));
        match manifest.jobs.iter().find_map(|job| job.error.as_ref()).filter(|_| !is_done) {
            Some(error) => run.text("error", error).end(),
            None => run.end(),
        }
    }

    /// The work of one job: with which tool, of what, and what came of it.
    fn add_action(&self, out: &mut Entities<'_>, index: usize, job: &JobEntry) {
        let id = format!("#job-{index}");
        let how = if was_executed(job) { "executed by this run" } else { "executed by an earlier run, its results taken from the store" };
        let key = job.key.map(|key| format!("; key {key}")).unwrap_or_default();
        let mut action = out
            .add(&id, &["CreateAction"])
            .text("name", &place_text(&job.stage, &job.coordinate))
            .text("description", &format!("{how}{key}"))
            .reference("instrument", &tool_id(job))
            .text("actionStatus", action_status(job.outcome != Outcome::Failed));
        let published = job.outputs.iter().filter_map(|output| self.files.get(result_place(job, &output.name).as_str()));
        let results: Vec<String> = published.flatten().map(|path| path_id(path)).collect();
        if !results.is_empty() {
            action = action.references("result", results);
        }
        if let Some(error) = &job.error {
            action = action.text("error", error);
        }
        let has_parameters = job.parameters.as_object().is_some_and(|fields| !fields.is_empty());
        let parameters = has_parameters.then(|| format!("{id}-parameters"));
        let objects: Vec<String> = job.files.iter().map(input_id).chain(parameters.clone()).collect();
        if !objects.is_empty() {
            action = action.references("object", objects);
        }
        action.end();
        if let Some(id) = parameters {
            out.add(&id, &["PropertyValue"]).text("name", "parameters").text("value", &job.parameters.to_string()).end();
        }
    }
}

fn was_executed(job: &JobEntry) -> bool {
    matches!(job.outcome, Outcome::Ran | Outcome::Failed)
}

fn action_status(is_done: bool) -> &'static str {
    if is_done { "http://schema.org/CompletedActionStatus" } else { "http://schema.org/FailedActionStatus" }
}

/// `2026-01-02T03:04:05Z` and some seconds later, in whole seconds.
fn end_of(started: &str, seconds: f64) -> String {
    let moment = started.parse::<jiff::Timestamp>().ok();
    let end = moment.and_then(|moment| moment.checked_add(jiff::SignedDuration::try_from_secs_f64(seconds).ok()?).ok());
    end.map_or_else(|| started.to_owned(), |end| end.strftime("%Y-%m-%dT%H:%M:%SZ").to_string())
}

/// A path as a URI: bytes that a URI may not hold as they are become `%XX`.
fn path_id(path: &str) -> String {
    let is_plain = |byte: u8| byte.is_ascii_alphanumeric() || b"-._~/=,+@!$&'()*;".contains(&byte);
    path.bytes().fold(String::with_capacity(path.len()), |mut id, byte| {
        if is_plain(byte) {
            id.push(char::from(byte));
        } else {
            write!(id, "%{byte:02X}").expect("writing to a String");
        }
        id
    })
}

fn id_part(name: &str) -> String {
    path_id(name).replace('/', "%2F")
}

fn tool_id(job: &JobEntry) -> String {
    format!("#kind-{}-{}", id_part(&job.kind), job.version)
}

fn step_id(stage: &str) -> String {
    format!("#stage-{stage}")
}

fn output_id(stage: &str) -> String {
    format!("#output-{stage}")
}

fn input_id(file: &FileEntry) -> String {
    format!("urn:sha256:{}", file.sha256)
}

/// The stage, with `.result`, of a published file's job.
fn stage_of(job: &str) -> &str {
    job.split('[').next().unwrap_or(job)
}

fn result_place(job: &JobEntry, result: &str) -> String {
    let point = if result.is_empty() { "" } else { "." };
    place_text(&format!("{}{point}{result}", job.stage), &job.coordinate)
}

fn encoding_format(path: &str) -> &'static str {
    match path.rsplit_once('.').map_or("", |(_, extension)| extension) {
        "png" => "image/png",
        "svg" => "image/svg+xml",
        "pdf" => "application/pdf",
        "csv" => "text/csv",
        "json" => "application/json",
        "exr" => "image/x-exr",
        "hdr" => "image/vnd.radiance",
        "ppm" => "image/x-portable-pixmap",
        "obj" => "model/obj",
        "html" => "text/html",
        _ => "application/octet-stream",
    }
}

/// What a reader of the crate needs to hold: every `@id` once, every reference to something in it.
#[cfg(test)]
fn faults(text: &str) -> Vec<String> {
    let document: Json = serde_json::from_str(text).expect("a crate is JSON");
    let graph = document["@graph"].as_array().expect("a crate has a graph");
    let mut ids: BTreeMap<&str, usize> = BTreeMap::new();
    graph.iter().for_each(|entity| *ids.entry(entity["@id"].as_str().unwrap_or_default()).or_default() += 1);
    let mut faults: Vec<String> = ids.iter().filter(|(_, count)| **count > 1).map(|(id, _)| format!("{id} stands twice")).collect();
    for entity in graph {
        let fields = entity.as_object().expect("an entity is an object");
        faults.extend((!fields.contains_key("@type")).then(|| format!("{entity} has no type")));
        for (name, value) in fields {
            let values = value.as_array().cloned().unwrap_or_else(|| vec![value.clone()]);
            let targets = values.iter().filter_map(|value| value.get("@id")?.as_str());
            let dangling = targets.filter(|target| !target.starts_with("http") && !ids.contains_key(target));
            faults.extend(dangling.map(|target| format!("{name} leads to {target}, which is not there")));
        }
    }
    faults
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use crate::engine::digest::Digest;
    use crate::engine::manifest::{Machine, Measured, OutputEntry, Program, PublishedEntry, SCHEMA, SpecEntry};

    fn job(stage: &str, n: u32, outcome: Outcome) -> JobEntry {
        let output = OutputEntry { name: String::new(), type_name: "image".into(), sha256: Digest::of(stage.as_bytes()), bytes: 3 };
        JobEntry {
            stage: stage.into(),
            coordinate: json!({ "n": n }),
            kind: "tone-map".into(),
            version: 2,
            parameters: json!({ "gamma": 2.2 }),
            seed: None,
            key: Some(Digest::of(b"key")),
            outcome,
            reason: "never ran".into(),
            inputs: vec![],
            files: vec![FileEntry { parameter: "path".into(), path: "a map.pfm".into(), sha256: Digest::of(b"map") }],
            outputs: if outcome == Outcome::Failed { vec![] } else { vec![output] },
            warnings: vec![],
            error: None,
            parts: Vec::new(),
            measured: None,
        }
    }

    fn manifest(outcome: Outcome) -> Manifest {
        Manifest {
            schema: SCHEMA.into(),
            pipeline: "p".into(),
            run_id: "20260102T030405Z-abcdef".into(),
            result_id: Digest::of(b"work"),
            status: Status::Done,
            whole: true,
            seed: 7,
            spec: vec![SpecEntry { path: "my pipe.yaml".into(), sha256: Digest::of(b"text"), text: "text".into() }],
            overrides: json!({ "params": { "gamma": "2.2" } }),
            jobs: vec![job("a", 1, outcome), job("a", 2, Outcome::Hit)],
            published: vec![PublishedEntry { path: "a/n=1.png".into(), sha256: Digest::of(b"png"), job: "a[n=1]".into() }],
            kept: vec![],
            warnings: vec![],
            program: Program::this(),
            machine: Machine::this(),
            measured: Measured { started: "2026-01-02T03:04:05Z".into(), seconds: 61.5, ..Measured::default() },
        }
    }

    #[test]
    fn a_crate_is_whole_and_the_same_each_time() {
        for outcome in [Outcome::Ran, Outcome::Hit, Outcome::Failed] {
            let text = text(&manifest(outcome));
            assert_eq!(faults(&text), Vec::<String>::new());
            assert_eq!(text, super::text(&manifest(outcome)));
        }
    }

    #[test]
    fn only_what_was_executed_was_controlled() {
        let text_of = |outcome| text(&manifest(outcome));
        let (ran, hit) = (text_of(Outcome::Ran), text_of(Outcome::Hit));
        assert_eq!(ran.matches("\"ControlAction\"").count(), 1);
        assert!(ran.contains("wfrun/provenance/0.5") && ran.contains("\"endTime\":\"2026-01-02T03:05:06Z\""));
        assert!(!hit.contains("ControlAction") && !hit.contains("wfrun/provenance") && !hit.contains("HowTo"));
        assert_eq!(ran.matches("\"CreateAction\"").count(), 3, "the run and two jobs");
    }

    #[test]
    fn a_path_becomes_a_uri() {
        assert_eq!(path_id("runs/1/my pipe%é.yaml"), "runs/1/my%20pipe%25%C3%A9.yaml");
        assert_eq!(path_id("ldr/n=64,gamma=2.2.png"), "ldr/n=64,gamma=2.2.png");
        assert!(
            faults(r##"{"@graph":[{"@id":"a","@type":"T","x":{"@id":"#b"}},{"@id":"a","@type":"T"}]}"##).len() == 2,
            "faults are found"
        );
    }
}

//! A run as a research object: `ro-crate-metadata.json`, RO-Crate 1.1 with the Provenance Run Crate profile 0.5.
//!
//! Made of the manifest alone, so that equal manifests give equal bytes. The crate is the folder of the
//! pipeline's outputs: its files are the published ones, the manifest, and the pipeline's text, which is kept
//! with the run. Every job is an action of a tool (its kind); jobs that this run executed are also steps that it
//! controlled, while one taken from the store was executed by an earlier run. Says no more of the machine and
//! its user than the manifest does. After <https://w3id.org/ro/wfrun/provenance/0.5>.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::fmt::Write;

use serde_json::{Value as Json, json};

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
    let entities = Crate::new(manifest).entities();
    let mut text = format!("{{\"@context\":[\"{CRATE}/context\",\"https://w3id.org/ro/terms/workflow-run/context\"],\"@graph\":[\n");
    for (index, entity) in entities.iter().enumerate() {
        let comma = if index + 1 < entities.len() { "," } else { "" };
        writeln!(text, "{entity}{comma}").expect("writing to a String");
    }
    text + "]}\n"
}

struct Crate<'m> {
    manifest: &'m Manifest,
    /// Paths of published files by the job that gave them, as [`place_text`] names its result.
    files: HashMap<&'m str, Vec<&'m str>>,
    /// Stages in the order of their first job.
    stages: Vec<&'m str>,
    /// Jobs with results: each is an action.
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
        let mut seen = BTreeSet::new();
        let stages = jobs.iter().map(|job| job.stage.as_str()).filter(|stage| seen.insert(*stage)).collect();
        let has_steps = jobs.iter().any(|job| was_executed(job));
        Self { manifest, files, stages, jobs, has_steps }
    }

    fn entities(&self) -> Vec<Json> {
        let mut entities = vec![descriptor(), self.root(), self.workflow()];
        entities.extend(
            self.profiles().map(|(id, name, version)| json!({ "@id": id, "@type": "CreativeWork", "name": name, "version": version })),
        );
        entities.push(json!({ "@id": "#no-license", "@type": "CreativeWork", "name": "No license is stated", "description": "The pipeline's author decides on the license of its results." }));
        entities.extend(self.programs());
        entities.extend(self.parameters());
        entities.extend(self.data());
        entities.extend(self.actions());
        entities
    }

    fn profiles(&self) -> impl Iterator<Item = (&'static str, &'static str, &'static str)> + use<> {
        PROFILES.into_iter().take(if self.has_steps { PROFILES.len() } else { PROFILES.len() - 1 })
    }

    fn main_path(&self) -> String {
        self.manifest.spec.first().map(|entry| workflow_path(self.manifest, &entry.path)).unwrap_or_default()
    }

    fn root(&self) -> Json {
        let manifest = self.manifest;
        let mut parts: Vec<String> = workflow_files(manifest).map(|(path, _)| path).collect();
        parts.push("manifest.json".into());
        parts.extend(manifest.published.iter().map(|entry| entry.path.clone()));
        let parts = parts.iter().map(|path| path_id(path)).chain(self.inputs().into_keys());
        json!({
            "@id": "./",
            "@type": "Dataset",
            "name": format!("Run {} of the pipeline {}", manifest.run_id, manifest.pipeline),
            "description": format!("Files that the pipeline {} published, and how each was made; result_id {}", manifest.pipeline, manifest.result_id),
            "datePublished": manifest.measured.started,
            "license": reference("#no-license"),
            "conformsTo": references(self.profiles().map(|(id, ..)| id)),
            "mainEntity": path_reference(&self.main_path()),
            "hasPart": references(parts),
            "mentions": references(self.has_steps.then_some("#organize").into_iter().chain([RUN])),
        })
    }

    fn workflow(&self) -> Json {
        let manifest = self.manifest;
        let mut types = vec!["File", "SoftwareSourceCode", "ComputationalWorkflow"];
        types.extend(self.has_steps.then_some("HowTo"));
        let mut workflow = json!({
            "@id": path_id(&self.main_path()),
            "@type": types,
            "name": manifest.pipeline,
            "encodingFormat": "application/yaml",
            "sha256": manifest.spec.first().map(|entry| entry.sha256),
            "programmingLanguage": reference(LANGUAGE),
            "input": references(self.formal_inputs().map(|(id, ..)| id)),
            "output": references(self.published_stages().map(|stage| output_id(stage))),
            "hasPart": references(self.tools().keys().cloned()),
        });
        if self.has_steps {
            workflow["step"] = references(self.stages.iter().map(|stage| step_id(stage)));
        }
        workflow
    }

    /// Kinds by their identifier: name and version.
    fn tools(&self) -> BTreeMap<String, (&'m str, u32)> {
        self.jobs.iter().map(|job| (tool_id(job), (job.kind.as_str(), job.version))).collect()
    }

    fn programs(&self) -> Vec<Json> {
        let program = &self.manifest.program;
        let mut entities = vec![
            json!({ "@id": LANGUAGE, "@type": "ComputerLanguage", "name": "pipeline file", "identifier": { "@id": "https://yaml.org/spec/1.2.2/" }, "url": { "@id": "https://yaml.org/" }, "alternateName": "YAML" }),
            json!({ "@id": ENGINE, "@type": "SoftwareApplication", "name": program.name, "softwareVersion": program.version, "description": format!("{} build", program.build) }),
        ];
        let tool = |(id, (kind, version)): (String, (&str, u32))| json!({ "@id": id, "@type": "SoftwareApplication", "name": kind, "softwareVersion": version.to_string(), "description": format!("Stages of the kind {kind}; `pipeline stages {kind}` explains it") });
        entities.extend(self.tools().into_iter().map(tool));
        if self.has_steps {
            let kinds: HashMap<&str, &JobEntry> = self.jobs.iter().rev().map(|job| (job.stage.as_str(), *job)).collect();
            let step = |(index, stage): (usize, &&str)| json!({ "@id": step_id(stage), "@type": "HowToStep", "name": stage, "position": (index + 1).to_string(), "workExample": reference(&tool_id(kinds[*stage])) });
            entities.extend(self.stages.iter().enumerate().map(step));
        }
        entities
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

    fn parameters(&self) -> Vec<Json> {
        let mut entities = Vec::new();
        for (id, name, value) in self.formal_inputs() {
            let value_id = format!("{id}-value");
            entities.push(json!({ "@id": id, "@type": "FormalParameter", "additionalType": "PropertyValue", "name": name, "workExample": reference(&value_id) }));
            entities
                .push(json!({ "@id": value_id, "@type": "PropertyValue", "name": name, "value": value, "exampleOfWork": reference(&id) }));
        }
        for stage in self.published_stages() {
            let files = self.manifest.published.iter().filter(|entry| stage_of(&entry.job) == stage).map(|entry| path_id(&entry.path));
            entities.push(json!({ "@id": output_id(stage), "@type": "FormalParameter", "additionalType": "File", "name": stage, "workExample": references(files) }));
        }
        entities
    }

    /// Stages, with `.result` for a further one, that published something.
    fn published_stages(&self) -> impl Iterator<Item = &'m str> + use<'m> {
        self.manifest.published.iter().map(|entry| stage_of(&entry.job)).collect::<BTreeSet<_>>().into_iter()
    }

    /// Input files by their identifier, which is their digest: they are no part of the folder.
    fn inputs(&self) -> BTreeMap<String, &'m FileEntry> {
        self.manifest.jobs.iter().flat_map(|job| &job.files).map(|file| (input_id(file), file)).collect()
    }

    fn data(&self) -> Vec<Json> {
        let manifest = self.manifest;
        let mut entities = vec![
            json!({ "@id": "manifest.json", "@type": "File", "name": "The program's own record of the run", "encodingFormat": "application/json" }),
        ];
        entities.extend(manifest.spec.iter().skip(1).map(|entry| {
            json!({ "@id": path_id(&workflow_path(manifest, &entry.path)), "@type": ["File", "SoftwareSourceCode"], "name": entry.path, "encodingFormat": "application/yaml", "sha256": entry.sha256 })
        }));
        entities.extend(
            self.inputs().into_iter().map(|(id, file)| json!({ "@id": id, "@type": "File", "name": file.path, "sha256": file.sha256 })),
        );
        entities.extend(manifest.published.iter().map(|entry| {
            let format = encoding_format(&entry.path);
            json!({ "@id": path_id(&entry.path), "@type": "File", "name": entry.job, "encodingFormat": format, "sha256": entry.sha256, "exampleOfWork": reference(&output_id(stage_of(&entry.job))) })
        }));
        entities
    }

    fn actions(&self) -> Vec<Json> {
        let manifest = self.manifest;
        let started = &manifest.measured.started;
        let ended = end_of(started, manifest.measured.seconds);
        let values = self.formal_inputs().map(|(id, ..)| format!("{id}-value"));
        let mut run = json!({
            "@id": RUN,
            "@type": "CreateAction",
            "name": format!("Run {} of {}", manifest.run_id, manifest.pipeline),
            "instrument": path_reference(&self.main_path()),
            "startTime": started,
            "endTime": ended,
            "actionStatus": action_status(manifest.status == Status::Done),
            "object": references(values.chain(self.inputs().into_keys())),
            "result": references(manifest.published.iter().map(|entry| path_id(&entry.path))),
        });
        if let Some(error) = manifest.jobs.iter().find_map(|job| job.error.as_ref()).filter(|_| manifest.status != Status::Done) {
            run["error"] = json!(error);
        }
        let mut entities = vec![run];
        let numbered = || self.jobs.iter().enumerate();
        if self.has_steps {
            let controls = numbered().filter(|(_, job)| was_executed(job));
            entities.push(json!({
                "@id": "#organize",
                "@type": "OrganizeAction",
                "name": format!("Scheduling of run {}", manifest.run_id),
                "instrument": reference(ENGINE),
                "startTime": started,
                "endTime": ended,
                "object": references(controls.clone().map(|(index, _)| format!("#control-{index}"))),
                "result": reference(RUN),
            }));
            entities.extend(controls.map(|(index, job)| {
                json!({ "@id": format!("#control-{index}"), "@type": "ControlAction", "name": place_text(&job.stage, &job.coordinate), "description": job.reason, "instrument": reference(&step_id(&job.stage)), "object": reference(&format!("#job-{index}")) })
            }));
        }
        entities.extend(numbered().flat_map(|(index, job)| self.action(index, job)));
        entities
    }

    /// The work of one job: with which tool, of what, and what came of it.
    fn action(&self, index: usize, job: &JobEntry) -> Vec<Json> {
        let id = format!("#job-{index}");
        let how = if was_executed(job) { "executed by this run" } else { "executed by an earlier run, its results taken from the store" };
        let key = job.key.map(|key| format!("; key {key}")).unwrap_or_default();
        let mut action = json!({
            "@id": id,
            "@type": "CreateAction",
            "name": place_text(&job.stage, &job.coordinate),
            "description": format!("{how}{key}"),
            "instrument": reference(&tool_id(job)),
            "actionStatus": action_status(job.outcome != Outcome::Failed),
        });
        let results: Vec<String> = job
            .outputs
            .iter()
            .filter_map(|output| self.files.get(result_place(job, &output.name).as_str()))
            .flatten()
            .map(|path| path_id(path))
            .collect();
        if !results.is_empty() {
            action["result"] = references(results);
        }
        if let Some(error) = &job.error {
            action["error"] = json!(error);
        }
        let mut objects: Vec<String> = job.files.iter().map(input_id).collect();
        let parameters = job.parameters.as_object().filter(|fields| !fields.is_empty()).map(|_| {
            let id = format!("{id}-parameters");
            objects.push(id.clone());
            json!({ "@id": id, "@type": "PropertyValue", "name": "parameters", "value": job.parameters.to_string() })
        });
        if !objects.is_empty() {
            action["object"] = references(objects);
        }
        std::iter::once(action).chain(parameters).collect()
    }
}

fn descriptor() -> Json {
    json!({
        "@id": FILE_NAME,
        "@type": "CreativeWork",
        "about": reference("./"),
        "conformsTo": references([CRATE, WORKFLOW_CRATE]),
    })
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

fn reference(id: &str) -> Json {
    json!({ "@id": id })
}

fn references(ids: impl IntoIterator<Item = impl AsRef<str>>) -> Json {
    ids.into_iter().map(|id| reference(id.as_ref())).collect()
}

fn path_reference(path: &str) -> Json {
    reference(&path_id(path))
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

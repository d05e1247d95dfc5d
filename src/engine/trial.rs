//! Small kinds and graphs for the engine's own tests.

use std::collections::BTreeMap;
use std::io::{self, Read, Write};
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use serde_json::json;

use super::artifact::{Artifact, Origin, SaveError, Saved, TypeName};
use super::coordinate::{Coordinate, Scalar};
use super::events::Silence;
use super::graph::{Graph, InputNode, JobNode, PortInputs, Publication, Source, StageNode};
use super::job::Job;
use super::manifest::{Manifest, Outcome};
use super::parameter::{InputFile, Port, Ports};
use super::registry::Registry;
use super::resources::Resources;
use super::run::ahead::Ahead;
use super::run::{self, Places, RunError, Summary};
use super::schedule::Settings;
use super::stage::{InputSizes, ResultDeclaration, Stage, StageError};

/// A text as an artifact.
#[derive(Debug, PartialEq)]
pub struct Text(pub String);

impl Artifact for Text {
    const TYPE: TypeName = "text";
    const FORMATS: &'static [&'static str] = &["txt", "none"];

    fn write(&self, out: &mut dyn Write) -> io::Result<()> {
        out.write_all(b"text1")?;
        out.write_all(&(self.0.len() as u64).to_le_bytes())?;
        out.write_all(self.0.as_bytes())
    }

    fn read(input: &mut dyn Read) -> io::Result<Self> {
        let mut header = [0; 13];
        input.read_exact(&mut header)?;
        let length = u64::from_le_bytes(header[5..].try_into().unwrap());
        let mut text = String::new();
        input.take(length).read_to_string(&mut text)?;
        if &header[..5] != b"text1" || text.len() as u64 != length {
            return Err(io::ErrorKind::InvalidData.into());
        }
        Ok(Text(text))
    }

    fn memory(&self) -> u64 {
        self.0.len() as u64
    }

    fn save(&self, format: &str, origin: &Origin) -> Result<Saved, SaveError> {
        match format {
            "txt" => Ok(format!("{} of {} [{}]\n", self.0, origin.stage, origin.coordinate).into_bytes().into()),
            _ => Err(SaveError("this text has no such form".into())),
        }
    }
}

/// How a trial job behaves.
#[derive(Debug, Clone, Copy, PartialEq, Default, serde::Serialize, serde::Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Mood {
    /// Gives its text.
    #[default]
    Fine,
    /// Bad content.
    Fails,
    /// A fault of the program.
    Panics,
    /// Ends only when the run is interrupted, and interrupts it itself.
    Waits,
    /// Takes a fifth of a second.
    Slow,
    /// Wants a terabyte.
    Greedy,
}

/// Joins a file, its inputs and a text.
#[derive(Debug, Clone, serde::Serialize, serde::Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Trial {
    /// Its own part of the text.
    pub say: String,
    /// Only its first letters are given: a change behind them gives the same bytes.
    pub keep: usize,
    /// How it behaves.
    pub mood: Mood,
    /// A single input.
    pub of: Option<Port<Text>>,
    /// Collected inputs.
    pub all: Option<Ports<Text>>,
    /// A file.
    pub path: Option<InputFile>,
}

impl Stage for Trial {
    const KIND: &'static str = "trial";
    const VERSION: u32 = 1;
    const RESULTS: &'static [ResultDeclaration] = &[ResultDeclaration { name: "", types: &["text"] }];
    type Output = Text;

    fn caveats(&self) -> Vec<String> {
        (self.say == "biased").then(|| "this is biased".to_owned()).into_iter().collect()
    }

    fn memory(&self, inputs: &InputSizes) -> u64 {
        if self.mood == Mood::Greedy { 1 << 40 } else { inputs.values().sum() }
    }

    fn run(&self, job: &Job<'_>) -> Result<Text, StageError> {
        let mut text = self.say.clone();
        if let Some(file) = &self.path {
            text += &String::from_utf8_lossy(&job.read(file)?);
        }
        if let Some(of) = job.optional_input(&self.of)? {
            text += &format!("({})", of.0);
        }
        for collected in self.all.iter().flat_map(|all| job.collected(all)) {
            let collected = collected?;
            text += &format!("+{}{:?}{}", collected.label, collected.columns, collected.value.0);
        }
        match self.mood {
            Mood::Fine | Mood::Greedy => {}
            Mood::Slow => wait_a_while(job)?,
            Mood::Fails => return Err(StageError::content_with_hint("the text is bad", "write a better one")),
            Mood::Panics => panic!("out of luck"),
            Mood::Waits => loop {
                job.check()?;
                std::thread::yield_now();
            },
        }
        if self.say == "noisy" {
            job.warn("this is noisy");
        }
        text.truncate(self.keep);
        Ok(Text(text))
    }
}

fn wait_a_while(job: &Job<'_>) -> Result<(), StageError> {
    let begun = std::time::Instant::now();
    while begun.elapsed() < std::time::Duration::from_millis(200) {
        job.check()?;
        std::thread::sleep(std::time::Duration::from_millis(1));
    }
    Ok(())
}

/// A stage of a trial graph at one coordinate.
#[derive(Clone)]
pub struct TrialJob {
    stage: &'static str,
    coordinate: Coordinate,
    parameters: Trial,
    of: Option<usize>,
    all: Vec<usize>,
    save: Option<&'static str>,
    is_forced: bool,
}

/// A job that says something; its name is its stage's.
pub fn job(stage: &'static str, say: &str) -> TrialJob {
    let parameters = Trial { say: say.into(), keep: usize::MAX, mood: Mood::Fine, of: None, all: None, path: None };
    TrialJob { stage, coordinate: Coordinate::default(), parameters, of: None, all: vec![], save: None, is_forced: false }
}

impl TrialJob {
    pub fn at(mut self, n: i128) -> Self {
        self.coordinate = Coordinate(vec![("n".into(), Scalar::Integer(n))]);
        self
    }

    pub fn of(mut self, input: usize) -> Self {
        self.of = Some(input);
        self
    }

    pub fn all(mut self, inputs: impl IntoIterator<Item = usize>) -> Self {
        self.all = inputs.into_iter().collect();
        self
    }

    pub fn reads(mut self, path: &Path) -> Self {
        self.parameters.path = Some(InputFile(path.to_owned()));
        self
    }

    pub fn keeps(mut self, keep: usize) -> Self {
        self.parameters.keep = keep;
        self
    }

    pub fn mood(mut self, mood: Mood) -> Self {
        self.parameters.mood = mood;
        self
    }

    pub fn saves(mut self) -> Self {
        self.save = Some("txt");
        self
    }

    pub fn saves_as(mut self, format: &'static str) -> Self {
        self.save = Some(format);
        self
    }

    pub fn forced(mut self) -> Self {
        self.is_forced = true;
        self
    }
}

/// A graph of such jobs; inputs are indices into the list.
pub fn graph(folder: &Path, jobs: &[TrialJob]) -> Graph {
    let mut stages: Vec<StageNode> = Vec::new();
    let mut nodes = Vec::new();
    for trial in jobs {
        let stage = stages.iter().position(|stage| stage.name == trial.stage).unwrap_or_else(|| {
            stages.push(stage_node(trial, stages.len()));
            stages.len() - 1
        });
        nodes.push(job_node(trial, stage, jobs));
    }
    Graph {
        pipeline: "p".into(),
        seed: 0,
        folder: folder.to_owned(),
        sources: vec![Source { path: "p.yaml".into(), read_as: "p.yaml".into(), text: "text".into() }],
        request: String::new(),
        has_warnings: false,
        overrides: json!({}),
        is_whole: true,
        stages,
        jobs: nodes,
    }
}

fn stage_node(trial: &TrialJob, index: usize) -> StageNode {
    StageNode {
        name: trial.stage.into(),
        kind: Trial::KIND,
        version: Trial::VERSION,
        about: None,
        resources: Resources::default(),
        split: None,
        place: ("p.yaml".into(), index + 1),
        axes: trial.coordinate.0.iter().map(|(axis, _)| axis.clone()).collect(),
        results: vec![("", "text")],
    }
}

fn job_node(trial: &TrialJob, stage: usize, jobs: &[TrialJob]) -> JobNode {
    let item =
        |input: &usize| InputNode { job: *input, result: 0, label: jobs[*input].stage.into(), columns: jobs[*input].coordinate.0.clone() };
    let mut parameters = trial.parameters.clone();
    let mut inputs = Vec::new();
    if let Some(input) = &trial.of {
        parameters.of = Some(Port::to("single"));
        inputs.push(PortInputs { port: "of".into(), reference: "single".into(), collects: false, items: vec![item(input)] });
    }
    if !trial.all.is_empty() {
        parameters.all = Some(Ports::to(["many"]));
        let items = trial.all.iter().map(item).collect();
        inputs.push(PortInputs { port: "all".into(), reference: "many".into(), collects: true, items });
    }
    let mood = if parameters.mood == Mood::Waits { Mood::Fine } else { parameters.mood };
    let files = parameters.path.iter().map(|file| ("path".to_owned(), file.0.clone())).collect();
    let place = if trial.coordinate.is_empty() { String::new() } else { format!("/{}", trial.coordinate) };
    let publication =
        |format: &&'static str| Publication { result: 0, format: (*format).into(), path: format!("{}{place}.txt", trial.stage) };
    let canonical = json!({"say": parameters.say, "keep": parameters.keep, "mood": mood});
    JobNode {
        stage,
        coordinate: trial.coordinate.clone(),
        parameters: Box::new(parameters),
        shown: canonical.clone(),
        canonical,
        prefixes: Vec::new(),
        inputs,
        files,
        seed: None,
        has_own_seed: false,
        publications: trial.save.iter().map(publication).collect(),
        parts: Vec::new(),
        part_of: None,
        is_wanted: true,
        is_forced: trial.is_forced,
    }
}

/// A folder in which trial graphs run.
pub struct Space {
    pub folder: tempfile::TempDir,
    pub threads: usize,
    pub keep_going: bool,
    pub memory: u64,
    pub interrupted: Arc<AtomicBool>,
}

impl Space {
    pub fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        Self { folder, threads: 2, keep_going: false, memory: 1 << 30, interrupted: Arc::default() }
    }

    pub fn path(&self, path: &str) -> PathBuf {
        self.folder.path().join(path)
    }

    pub fn places(&self) -> Places {
        Places { outputs: self.path("outputs"), store: self.path("store"), may_share_store: false, remote: None }
    }

    pub fn try_run(&self, graph: Graph) -> Result<Summary, RunError> {
        self.run_in(&self.places(), graph)
    }

    pub fn run_in(&self, places: &Places, graph: Graph) -> Result<Summary, RunError> {
        let settings = Settings {
            threads: NonZeroUsize::new(self.threads).unwrap(),
            memory: self.memory,
            keep_going: self.keep_going,
            start_pool: |_| {},
        };
        let registry = Registry::default().with::<Trial>().with_artifact::<Text>();
        let ahead = Ahead::begin(places, &graph.pipeline);
        run::run(graph, &registry, ahead, settings, self.interrupted.clone(), None, &mut Silence)
    }

    pub fn run_graph(&self, graph: Graph) -> Summary {
        self.try_run(graph).unwrap()
    }

    pub fn run(&self, jobs: &[TrialJob]) -> Summary {
        self.run_graph(graph(self.folder.path(), jobs))
    }

    /// How many jobs ran, of these.
    pub fn ran(&self, jobs: &[TrialJob]) -> u64 {
        self.run(jobs).measured.jobs.get("ran").copied().unwrap_or(0)
    }

    pub fn manifest(&self) -> Manifest {
        serde_json::from_slice(&std::fs::read(self.path("outputs/p/manifest.json")).unwrap()).unwrap()
    }

    /// Outcome and reason of each job of the latest manifest, by name of the stage.
    pub fn outcomes(&self) -> BTreeMap<String, (Outcome, String)> {
        self.manifest().jobs.into_iter().map(|job| (job.stage, (job.outcome, job.reason))).collect()
    }

    pub fn published(&self, path: &str) -> String {
        std::fs::read_to_string(self.path("outputs/p").join(path)).unwrap()
    }

    /// All files of the store's blobs.
    pub fn blobs(&self) -> Vec<PathBuf> {
        files_below(&self.path("store/v1/cas"))
    }
}

/// All plain files below a folder.
pub fn files_below(folder: &Path) -> Vec<PathBuf> {
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        let path = entry.path();
        if path.is_dir() { files.extend(files_below(&path)) } else { files.push(path) }
    }
    files.sort();
    files
}

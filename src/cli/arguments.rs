//! What can be typed.

use std::num::NonZeroUsize;
use std::path::PathBuf;
use std::time::Duration;

use clap::{Args, Parser, Subcommand, ValueEnum};

use crate::engine::executor::{self, THREADS};
use crate::engine::quantity;
use crate::engine::request::{JOB_LIMIT, Request};
use crate::engine::run::Places;
use crate::engine::store::address::{Address, Remote};
use crate::engine::store::signing::{Keys, PublicKey, SecretKey};

/// What stands below the list of commands.
const FIRST_STEPS: &str = "\
First steps:
  pipeline init first          write first.yaml, a small pipeline with comments
  pipeline run first.yaml      compute it; results appear in outputs/first/
  pipeline plan first.yaml     after a change: what would run again, and why
  pipeline stages              the kinds of stages; `pipeline stages sample` shows one with an example
  pipeline completions bash    Tab completes commands, options and files; see its --help

RUN, in the commands above, is a run id, a run's folder, a manifest or the
name of a pipeline (the run whose results stand).

Exit codes:
  0    done
  1    a job failed, or no origin found
  2    the pipeline file, the command line or a named input is wrong
  3    the system failed (disk, permission)
  4    verify or diff found a difference
  130  interrupted (143: terminated)";

/// A declarative batch pipeline for image-based lighting.
#[derive(Debug, Parser)]
#[command(name = "pipeline", version, disable_help_subcommand = true, after_help = FIRST_STEPS)]
pub struct Arguments {
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
}

/// What to do.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Compute what the store lacks, publish, and write the manifest
    Run(RunCommand),
    /// Show what would run and why
    Plan(PlanCommand),
    /// Show every mistake of a pipeline file
    Check(CheckCommand),
    /// List the kinds of stages, or show one with every parameter
    Stages(StagesCommand),
    /// Print the JSON Schema of pipeline files, for editors, or of manifests
    Schema(SchemaCommand),
    /// Show what an image file holds
    Info(InfoCommand),
    /// Convert an image file to another format
    Convert(ConvertCommand),
    /// Make a run again from nothing and compare every byte
    Verify(VerifyCommand),
    /// Make a page of a run: images to compare, figures, tables, times, and where each result comes from
    Report(ReportCommand),
    /// Show what differs between two runs: parameters, tables, images
    Diff(DiffCommand),
    /// Find the stage, the parameters and the run that made a file
    Which(WhichCommand),
    /// Run again whenever the pipeline file, an include or an input changes
    Watch(WatchCommand),
    /// Compute jobs of a run that another process drives
    Worker(WorkerCommand),
    /// Show how far a run with workers is
    Status(StatusCommand),
    /// End a run with workers
    Cancel(CancelCommand),
    /// Write a small pipeline with comments, to begin with
    Init(InitCommand),
    /// Look after the store
    #[command(subcommand)]
    Store(StoreCommand),
    /// Print the completions of a shell
    Completions(CompletionsCommand),
    /// Print the manual page of the program or of a command
    Man(ManCommand),
}

/// Which pipeline, and what to change in it.
#[derive(Debug, Clone, Args)]
pub struct PipelineArguments {
    /// The pipeline file
    pub file: PathBuf,
    /// Set a parameter
    #[arg(short = 's', long = "set", value_name = "NAME=VALUE", value_parser = pair)]
    pub set: Vec<(String, String)>,
    /// Set the values of an axis: `n=16,64`, or `'run={ range: [1, 12, 1] }'`
    #[arg(short = 'a', long = "axis", value_name = "AXIS=VALUE,…", value_parser = pair)]
    pub axis: Vec<(String, String)>,
    /// The seed of stages that set none
    #[arg(long, value_name = "N", allow_hyphen_values = true)]
    pub seed: Option<String>,
    /// Most jobs that the axes may make
    #[arg(long, value_name = "N", default_value_t = JOB_LIMIT)]
    pub max_jobs: u64,
}

impl PipelineArguments {
    /// What is asked of the engine.
    pub fn request(&self, targets: &TargetArguments) -> Request {
        Request {
            file: self.file.clone(),
            parameters: self.set.clone(),
            axes: self.axis.clone(),
            seed: self.seed.clone(),
            only: targets.only.clone(),
            force: targets.force.clone(),
            max_jobs: self.max_jobs,
            texts: None,
            inputs: None,
        }
    }
}

/// Which stages.
#[derive(Debug, Clone, Default, Args)]
pub struct TargetArguments {
    /// Only this stage and what it needs: STAGE or STAGE[axis=value]
    #[arg(long, value_name = "STAGE", allow_hyphen_values = true)]
    pub only: Vec<String>,
    /// Run this stage even if the store has its results
    #[arg(long, value_name = "STAGE", allow_hyphen_values = true)]
    pub force: Vec<String>,
}

/// Where to write on this machine.
#[derive(Debug, Clone, Args)]
pub struct LocalPlaceArguments {
    /// Folder of published files and manifests
    #[arg(long, value_name = "DIR", env = "PIPELINE_OUTPUTS", default_value = "outputs")]
    pub outputs: PathBuf,
    /// Folder of the store [default: .store in the folder of outputs]
    #[arg(long, value_name = "DIR", env = "PIPELINE_STORE")]
    pub store: Option<PathBuf>,
    /// Use a store even if others may write to it: they decide what is found there
    #[arg(long, env = "PIPELINE_ALLOW_SHARED_STORE", value_parser = clap::builder::FalseyValueParser::new())]
    pub allow_shared_store: bool,
}

impl LocalPlaceArguments {
    /// The folders.
    pub fn places(&self) -> Places {
        let store = self.store.clone().unwrap_or_else(|| self.outputs.join(".store"));
        Places { outputs: self.outputs.clone(), store, may_share_store: self.allow_shared_store, remote: None }
    }
}

/// Where to write, and where else to look.
#[derive(Debug, Clone, Args)]
pub struct PlaceArguments {
    /// On this machine.
    #[command(flatten)]
    pub local: LocalPlaceArguments,
    /// Another store behind this one.
    #[command(flatten)]
    pub remote: RemoteArguments,
}

impl PlaceArguments {
    /// The stores and folders.
    pub fn places(&self) -> Places {
        Places { remote: self.remote.remote(), ..self.local.places() }
    }
}

/// A store elsewhere.
#[derive(Debug, Clone, Args)]
pub struct RemoteArguments {
    /// A store that others use too, behind the private one: a folder that is there, or s3://BUCKET/PREFIX. What is missing here is
    /// looked for there, and what is computed here goes there
    #[arg(long, value_name = "FOLDER|URL", env = "PIPELINE_STORE_REMOTE")]
    pub store_remote: Option<Address>,
    /// Write nothing to the remote store
    #[arg(long, env = "PIPELINE_STORE_REMOTE_READ_ONLY", value_parser = clap::builder::FalseyValueParser::new())]
    pub store_remote_read_only: bool,
    /// Keys of this remote store.
    #[command(flatten)]
    pub keys: KeyArguments,
}

impl RemoteArguments {
    /// The store, if there is one.
    fn remote(&self) -> Option<Remote> {
        let address = self.store_remote.clone()?;
        Some(Remote { address, is_read_only: self.store_remote_read_only, keys: self.keys.keys() })
    }
}

/// Who vouches for records that go from machine to machine.
#[derive(Debug, Clone, Default, Args)]
pub struct KeyArguments {
    /// Sign what goes to another store with the key in this file (`pipeline store keygen`)
    #[arg(long, value_name = "FILE", env = "PIPELINE_STORE_SIGN", value_parser = secret_key)]
    pub store_sign: Option<SecretKey>,
    /// Take from another store only what one of these keys, or the one that signs, has signed: a file of public keys, or
    /// ed25519:KEY; may be given several times
    #[arg(long, value_name = "FILE|KEY", env = "PIPELINE_STORE_TRUST", value_delimiter = ',', value_parser = trusted_keys)]
    pub store_trust: Vec<TrustedKeys>,
}

impl KeyArguments {
    /// The keys.
    pub fn keys(&self) -> Keys {
        let trusted = self.store_trust.iter().flat_map(|keys| keys.0.iter().copied()).collect();
        Keys { signing: self.store_sign.clone(), trusted: (!self.store_trust.is_empty()).then_some(trusted) }
    }
}

/// Keys that one argument names.
#[derive(Debug, Clone)]
pub struct TrustedKeys(Vec<PublicKey>);

fn secret_key(text: &str) -> Result<SecretKey, String> {
    SecretKey::in_file(std::path::Path::new(text)).map_err(|error| error.to_string())
}

fn trusted_keys(text: &str) -> Result<TrustedKeys, String> {
    PublicKey::all_of(text).map(TrustedKeys).map_err(|error| error.to_string())
}

/// How much to say.
#[derive(Debug, Clone, Copy, Default, Args)]
pub struct TalkArguments {
    /// Say nothing but errors, and the path of the result
    #[arg(short, long, conflicts_with = "verbose")]
    pub quiet: bool,
    /// Say more
    #[arg(short, long)]
    pub verbose: bool,
}

/// What `run`, `plan` and `watch` ask alike: which pipeline, which stages, where, and how to tell.
#[derive(Debug, Clone, Args)]
pub struct WorkArguments {
    /// Which pipeline.
    #[command(flatten)]
    pub pipeline: PipelineArguments,
    /// Which stages.
    #[command(flatten)]
    pub targets: TargetArguments,
    /// Where to write, and where earlier runs wrote.
    #[command(flatten)]
    pub places: PlaceArguments,
    /// How much to say.
    #[command(flatten)]
    pub talk: TalkArguments,
}

impl WorkArguments {
    /// What is asked of the engine.
    pub fn request(&self) -> Request {
        self.pipeline.request(&self.targets)
    }
}

/// How much of the machine to take.
#[derive(Debug, Clone, Copy, Args)]
pub struct MachineArguments {
    /// Threads; 0 for one per processor
    #[arg(short, long, value_name = "N", default_value_t = 0)]
    pub jobs: usize,
    /// Memory that jobs may take, as 512MiB, 4GiB or 50% [default: 80%]
    #[arg(long, value_name = "SIZE", value_parser = super::machine::memory_size)]
    pub memory: Option<u64>,
}

impl MachineArguments {
    /// Threads to use.
    pub fn threads(&self) -> NonZeroUsize {
        let all = || std::thread::available_parallelism().unwrap_or(NonZeroUsize::MIN);
        NonZeroUsize::new(self.jobs).unwrap_or_else(all)
    }

    /// Bytes that jobs may take.
    pub fn memory(&self) -> u64 {
        self.memory.unwrap_or_else(super::machine::default_memory)
    }
}

/// How to show the results.
#[derive(Debug, Clone, Args)]
pub struct ShowArguments {
    /// Make a page of the run, as `pipeline report` does
    #[arg(long)]
    pub report: bool,
    /// Send finished images to a running tev, if one listens [default address: 127.0.0.1:14158]
    #[arg(long, value_name = "HOST:PORT", num_args = 0..=1, require_equals = true, default_missing_value = super::viewing::ADDRESS)]
    pub view: Option<String>,
}

/// Who computes the jobs of a run.
#[derive(Debug, Clone, Args)]
pub struct TeamArguments {
    /// Who computes: threads of this process, processes, slurm, or manual (workers that you start)
    #[arg(long, value_name = "NAME", default_value = THREADS, value_parser = executor::checked_name)]
    pub executor: String,
    /// Most workers at once, of each class of resources
    #[arg(long, value_name = "W", default_value = "2")]
    pub workers: NonZeroUsize,
    /// What the site asks for: the name of a file in ~/.config/pipeline/profiles, or a path
    #[arg(long, value_name = "NAME")]
    pub profile: Option<String>,
}

/// Arguments of `worker`.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  pipeline worker --run /shared/outputs/light/runs/team-0f3a5b7c9d1e      on each machine that is to help
  pipeline worker --run FOLDER --stop-after 55m                           where a job may run for an hour")]
pub struct WorkerCommand {
    /// The run's folder, which `pipeline run` names
    #[arg(long, value_name = "FOLDER")]
    pub run: PathBuf,
    /// Take only jobs that ask for no more than this class of the run has
    #[arg(long, value_name = "N")]
    pub class: Option<usize>,
    /// Name of the worker in the run's folder [default: the machine's name and the process]
    #[arg(long, value_name = "NAME")]
    pub name: Option<String>,
    /// Begin no more jobs after this time, as 55m or 2h
    #[arg(long, value_name = "TIME", value_parser = quantity::duration)]
    pub stop_after: Option<Duration>,
    /// How much of the machine to take.
    #[command(flatten)]
    pub machine: MachineArguments,
    /// How much to say.
    #[command(flatten)]
    pub talk: TalkArguments,
}

/// A run with workers.
#[derive(Debug, Args)]
pub struct TeamRunArguments {
    /// The run: its id, its folder, or the name of a pipeline (its last run with workers)
    pub run: String,
    /// Where the run writes.
    #[arg(long, value_name = "DIR", env = "PIPELINE_OUTPUTS", default_value = "outputs")]
    pub outputs: PathBuf,
}

/// Arguments of `status`.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  pipeline status light                           the run of this pipeline that was begun last
  pipeline status 0f3a5b7c9d1e --format json | jq .jobs")]
pub struct StatusCommand {
    /// Which run.
    #[command(flatten)]
    pub named: TeamRunArguments,
    /// Form of the answer
    #[arg(long, value_enum, default_value_t)]
    pub format: Format,
}

/// Arguments of `cancel`.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  pipeline cancel light      what is done stays in the store; `pipeline run` goes on from there")]
pub struct CancelCommand {
    /// Which run.
    #[command(flatten)]
    pub named: TeamRunArguments,
}

/// Arguments of `run`.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  pipeline run light.yaml                          compute what the store lacks
  pipeline run light.yaml -s map=sky.hdr -a n=16,64   with another map and another sweep
  pipeline run light.yaml --only 'sphere[n=64]'     one result and what it needs
  pipeline run light.yaml -k -j 4 --memory 2GiB     go on after a failure, on 4 threads
  pipeline run light.yaml --format json | jq .measured
  pipeline run light.yaml --executor slurm --workers 50 --profile hpc   on a cluster: see docs/cluster.md")]
pub struct RunCommand {
    /// What `plan` asks too.
    #[command(flatten)]
    pub work: WorkArguments,
    /// How much of the machine to take.
    #[command(flatten)]
    pub machine: MachineArguments,
    /// Run what does not depend on a failed job
    #[arg(short, long)]
    pub keep_going: bool,
    /// Show what would run and why, and run nothing: the same as `pipeline plan`
    #[arg(short = 'n', long)]
    pub dry_run: bool,
    /// Write what happens to a file, one JSON object a line
    #[arg(long, value_name = "FILE")]
    pub events: Option<PathBuf>,
    /// Who computes.
    #[command(flatten)]
    pub team: TeamArguments,
    /// What is made beside the published files.
    #[command(flatten)]
    pub show: ShowArguments,
    /// Form of the results, and with json of errors, on stdout
    #[arg(long, value_enum, default_value_t)]
    pub format: PlanFormat,
}

/// Arguments of `plan`.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  pipeline plan light.yaml                    a line per stage: how many jobs, over which axes, why
  pipeline plan light.yaml -v                 a line per job
  pipeline plan light.yaml -s gamma=1.8       what a change would cost
  pipeline plan light.yaml --format dot | dot -Tsvg > light.svg")]
pub struct PlanCommand {
    /// What `run` asks too.
    #[command(flatten)]
    pub work: WorkArguments,
    /// Form of the plan
    #[arg(long, value_enum, default_value_t)]
    pub format: PlanFormat,
}

/// Form of a plan.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, ValueEnum)]
pub enum PlanFormat {
    /// For people: a line per stage, with -v one per job
    #[default]
    Text,
    /// For programs
    Json,
    /// Graphviz, a node per stage, with -v one per job (of a plan)
    Dot,
    /// Mermaid, likewise (of a plan)
    Mermaid,
}

/// Arguments of `check`.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  pipeline check light.yaml
  pipeline check light.yaml --format json | jq '.diagnostics[].message'")]
pub struct CheckCommand {
    /// Which pipeline.
    #[command(flatten)]
    pub pipeline: PipelineArguments,
    /// Which stages.
    #[command(flatten)]
    pub targets: TargetArguments,
    /// Form of the messages
    #[arg(long, value_enum, default_value_t)]
    pub format: Format,
}

/// Form of an answer.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, ValueEnum)]
pub enum Format {
    /// For people
    #[default]
    Text,
    /// For programs
    Json,
}

/// Arguments of `stages`.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  pipeline stages             all kinds, a line each
  pipeline stages relight     an example and every parameter of one")]
pub struct StagesCommand {
    /// The kind to show
    pub kind: Option<String>,
}

/// Arguments of `schema`.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  pipeline schema > pipeline.schema.json
  # In an editor with the YAML language server, the first line of a pipeline file is then
  # yaml-language-server: $schema=pipeline.schema.json")]
pub struct SchemaCommand {
    /// The files that it describes
    #[arg(value_enum, default_value_t)]
    pub of: SchemaOf,
}

/// What a schema describes.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, ValueEnum)]
pub enum SchemaOf {
    /// Pipeline files
    #[default]
    Pipeline,
    /// The records of runs
    Manifest,
}

/// Arguments of `info`.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  pipeline info sky.hdr
  pipeline info sphere.exr --format json")]
pub struct InfoCommand {
    /// The image file
    pub file: PathBuf,
    /// Form of the answer
    #[arg(long, value_enum, default_value_t)]
    pub format: Format,
}

/// Arguments of `convert`.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  pipeline convert sky.hdr sky.exr
  pipeline convert sphere.pfm sphere.npy")]
pub struct ConvertCommand {
    /// The image file to read; its format is found by its content
    pub input: PathBuf,
    /// The image file to write; its extension names the format
    pub output: PathBuf,
}

/// Arguments of `verify`.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  pipeline verify light                                    the run whose results stand
  pipeline verify outputs/light/runs/20260101T120000Z-ab12cd --inputs maps")]
pub struct VerifyCommand {
    /// The run: its id, its folder, its manifest, or the name of a pipeline (its latest run)
    pub run: String,
    /// Folder in which to look for the input files of the run, by name, then by content; may be given several times
    /// [default: the working folder]
    #[arg(long, value_name = "DIR")]
    pub inputs: Vec<PathBuf>,
    /// Where the run wrote.
    #[command(flatten)]
    pub places: LocalPlaceArguments,
    /// How much to say.
    #[command(flatten)]
    pub talk: TalkArguments,
    /// How much of the machine to take.
    #[command(flatten)]
    pub machine: MachineArguments,
    /// Form of the answer
    #[arg(long, value_enum, default_value_t)]
    pub format: Format,
}

/// Arguments of `report`.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  pipeline report light                       outputs/light/report.html, the page of the latest run
  pipeline report light --out light.html --budget 1GiB   all of it in one file, to be sent
  pipeline run light.yaml --report            run, then make the page; `watch --report` keeps it fresh")]
pub struct ReportCommand {
    /// The run: its id, its folder, its manifest, or the name of a pipeline (its latest run)
    pub run: String,
    /// Where to write the page [default: report.html beside the manifest]; large data go into a folder beside it
    #[arg(short, long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// How large the page may get before pixels go into files beside it, as 24MiB or 2GiB
    #[arg(long, value_name = "SIZE", value_parser = quantity::byte_size, default_value = "24MiB")]
    pub budget: u64,
    /// Where the run wrote.
    #[command(flatten)]
    pub places: PlaceArguments,
    /// How much to say.
    #[command(flatten)]
    pub talk: TalkArguments,
}

/// Arguments of `diff`.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  pipeline diff before/light after/light
  pipeline diff light outputs/light/runs/20260101T120000Z-ab12cd --images difference")]
pub struct DiffCommand {
    /// The first run: its id, its folder, its manifest, or the name of a pipeline (its latest run)
    pub first: String,
    /// The second run; images of the first are measured against it
    pub second: String,
    /// Only this stage; may be given several times
    #[arg(long, value_name = "STAGE", allow_hyphen_values = true)]
    pub only: Vec<String>,
    /// Measures of images that differ: rmse, mse, relmse, smape, psnr, flip, hdr-flip
    #[arg(long, value_name = "METRIC,…", value_delimiter = ',', default_value = "rmse,flip")]
    pub metrics: Vec<String>,
    /// Write an image of the differences of each pair of images below this folder, in false color
    #[arg(long, value_name = "DIR")]
    pub images: Option<PathBuf>,
    /// Where the runs wrote.
    #[command(flatten)]
    pub places: PlaceArguments,
    /// How much to say.
    #[command(flatten)]
    pub talk: TalkArguments,
    /// Form of the answer
    #[arg(long, value_enum, default_value_t)]
    pub format: Format,
}

/// Arguments of `which`.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  pipeline which outputs/light/map.png
  pipeline which figure-from-a-mail.pdf")]
pub struct WhichCommand {
    /// A file that a pipeline published, or a copy of one
    pub file: PathBuf,
    /// Folder of published files and manifests, in which the run is looked for
    #[arg(long, value_name = "DIR", env = "PIPELINE_OUTPUTS", default_value = "outputs")]
    pub outputs: PathBuf,
    /// Form of the answer
    #[arg(long, value_enum, default_value_t)]
    pub format: Format,
}

/// Arguments of `watch`.
#[derive(Debug, Args)]
pub struct WatchCommand {
    /// What `run` asks too.
    #[command(flatten)]
    pub work: WorkArguments,
    /// How much of the machine to take.
    #[command(flatten)]
    pub machine: MachineArguments,
    /// Run what does not depend on a failed job
    #[arg(short, long)]
    pub keep_going: bool,
    /// What is made beside the published files.
    #[command(flatten)]
    pub show: ShowArguments,
}

/// Arguments of `init`.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  pipeline init night && pipeline run night.yaml")]
pub struct InitCommand {
    /// Name of the pipeline; the file is NAME.yaml in the working folder
    #[arg(default_value = "first")]
    pub name: String,
}

/// Arguments of `completions`.
#[derive(Debug, Args)]
#[command(after_help = "\
To use them:
  bash   pipeline completions bash > ~/.local/share/bash-completion/completions/pipeline
  zsh    pipeline completions zsh > \"${fpath[1]}/_pipeline\"
  fish   pipeline completions fish > ~/.config/fish/completions/pipeline.fish")]
pub struct CompletionsCommand {
    /// The shell
    #[arg(value_enum)]
    pub shell: clap_complete::Shell,
}

/// Arguments of `man`.
#[derive(Debug, Args)]
#[command(after_help = "\
To read a page:
  pipeline man run | man -l -
  pipeline man --dir ~/.local/share/man/man1 && man pipeline-run")]
pub struct ManCommand {
    /// The command whose page to print; the program's own page by default
    #[arg(conflicts_with = "dir")]
    pub command: Option<String>,
    /// Write all pages into this folder instead
    #[arg(long, value_name = "DIR")]
    pub dir: Option<PathBuf>,
    /// Form of the pages
    #[arg(long, value_enum, default_value_t, requires = "dir")]
    pub format: ManFormat,
}

/// Form of the manual.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, ValueEnum)]
pub enum ManFormat {
    /// For `man`
    #[default]
    Roff,
    /// The reference of the book: the commands, the kinds, scenes, the fields of files, manifests
    Markdown,
}

/// Arguments of `store`.
#[derive(Debug, Subcommand)]
pub enum StoreCommand {
    /// Show what the store holds
    Stats(StoreArguments),
    /// Hash every object, and set aside what is damaged
    Verify(StoreArguments),
    /// Remove what is not worth its room; safe beside running pipelines
    Gc(GcCommand),
    /// Send a run, or all results, to another store
    Push(PushCommand),
    /// Bring a run, or all results, from another store
    Pull(PullCommand),
    /// Show what a store elsewhere keeps of the promises that stores make
    Check(CheckStoreCommand),
    /// Write a key that signs what goes to other stores
    Keygen(KeygenCommand),
}

/// Arguments of `store push`.
#[derive(Debug, Args)]
#[command(
    allow_missing_positional = true,
    after_help = "\
Examples:
  pipeline store push light /mnt/group/store
  pipeline store push --all s3://bucket/store --store-sign lab.key"
)]
pub struct PushCommand {
    /// The run: its id, its folder, its manifest, or the name of a pipeline (its latest run)
    #[arg(required_unless_present = "all", conflicts_with = "all")]
    pub run: Option<String>,
    /// Send all results of the store, and no run
    #[arg(long)]
    pub all: bool,
    /// Where to: a folder that is there, or s3://BUCKET/PREFIX
    #[arg(value_name = "FOLDER|URL")]
    pub target: Address,
    /// Which store.
    #[command(flatten)]
    pub store: LocalStoreArguments,
}

/// Arguments of `store pull`.
#[derive(Debug, Args)]
#[command(
    allow_missing_positional = true,
    after_help = "\
Examples:
  pipeline store pull light /mnt/group/store
  pipeline store pull 20260101T120000Z-ab12cd s3://bucket/store --store-trust lab.keys"
)]
pub struct PullCommand {
    /// The run that was sent there: its id, or the name of a pipeline (its latest run)
    #[arg(required_unless_present = "all", conflicts_with = "all")]
    pub run: Option<String>,
    /// Bring all results that are there, and no run
    #[arg(long)]
    pub all: bool,
    /// Where from: a folder, or s3://BUCKET/PREFIX
    #[arg(value_name = "FOLDER|URL")]
    pub source: Address,
    /// Which store.
    #[command(flatten)]
    pub store: LocalStoreArguments,
}

/// A store of this machine, and how it deals with others.
#[derive(Debug, Args)]
pub struct LocalStoreArguments {
    /// Where it is.
    #[command(flatten)]
    pub places: LocalPlaceArguments,
    /// Keys of the other store.
    #[command(flatten)]
    pub keys: KeyArguments,
    /// Form of the answer
    #[arg(long, value_enum, default_value_t)]
    pub format: Format,
}

/// Arguments of `store check`.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  pipeline store check /mnt/group/store
  pipeline store check s3://bucket/store")]
pub struct CheckStoreCommand {
    /// The store: a folder that is there, or s3://BUCKET/PREFIX
    #[arg(value_name = "FOLDER|URL")]
    pub target: Address,
    /// Write nothing there
    #[arg(long)]
    pub read_only: bool,
    /// Form of the answer
    #[arg(long, value_enum, default_value_t)]
    pub format: Format,
}

/// Arguments of `store keygen`.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  pipeline store keygen lab.key     lab.key stays here; lab.key.pub is what others trust")]
pub struct KeygenCommand {
    /// The file for the secret key, which must not be there; the public one goes beside it, with `.pub` at its end
    pub file: PathBuf,
}

/// Which store.
#[derive(Debug, Args)]
pub struct StoreArguments {
    /// Where it is.
    #[command(flatten)]
    pub places: LocalPlaceArguments,
    /// Form of the answer
    #[arg(long, value_enum, default_value_t)]
    pub format: Format,
}

/// Arguments of `store gc`.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  pipeline store gc --older-than 30d --dry-run
  pipeline store gc --max-size 10GiB --keep-last 5")]
pub struct GcCommand {
    /// Which store.
    #[command(flatten)]
    pub store: StoreArguments,
    /// Remove what was not used for longest until so much is left, as 512MiB or 4GiB
    #[arg(long, value_name = "SIZE", value_parser = quantity::byte_size)]
    pub max_size: Option<u64>,
    /// Remove what was not used for so long, as 90m, 12h, 30d or 8w
    #[arg(long, value_name = "AGE", value_parser = quantity::duration)]
    pub older_than: Option<Duration>,
    /// Keep what the last N runs of each pipeline below the folder of outputs made or used; alone, remove the rest, with the
    /// folders of other runs but that of the run whose results stand
    #[arg(long, value_name = "N")]
    pub keep_last: Option<usize>,
    /// Keep what was written or used so lately, since a running pipeline may count on it
    #[arg(long, value_name = "AGE", default_value = "1h", value_parser = quantity::duration)]
    pub grace: Duration,
    /// Show what would go, and remove nothing
    #[arg(short = 'n', long)]
    pub dry_run: bool,
}

/// `name=value`, the value being anything.
fn pair(text: &str) -> Result<(String, String), String> {
    match text.split_once('=') {
        Some((name, value)) if !name.is_empty() => Ok((name.to_owned(), value.to_owned())),
        _ => Err("write NAME=VALUE".to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    use super::*;

    #[test]
    fn the_definitions_agree_with_each_other() {
        Arguments::command().debug_assert();
    }

    #[test]
    fn a_pair_is_cut_at_the_first_sign() {
        assert_eq!(pair("a=b=c"), Ok(("a".into(), "b=c".into())));
        assert_eq!(pair("n="), Ok(("n".into(), String::new())));
        assert!(pair("map").is_err() && pair("=x").is_err());
    }
}

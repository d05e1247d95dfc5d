//! Pipelines of a tiny registry: what a file means, job by job, and what is said of a wrong one.

use std::io::{self, Read, Write};
use std::num::NonZeroU32;
use std::path::PathBuf;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::build;
use crate::engine::artifact::{AnyArtifact, Artifact, Origin, SaveError, Saved, TypeName};
use crate::engine::diagnostic::{Diagnostic, render};
use crate::engine::graph::Graph;
use crate::engine::job::Job;
use crate::engine::manual;
use crate::engine::parameter::{Accepts, InputFile, Port, Ports, Seed};
use crate::engine::registry::Registry;
use crate::engine::request::Request;
use crate::engine::stage::{InputTypes, Mistake, ResultDeclaration, Stage, StageError};

macro_rules! artifact {
    ($name:ident, $type_name:literal, $formats:expr) => {
        struct $name;
        impl Artifact for $name {
            const TYPE: TypeName = $type_name;
            const FORMATS: &'static [&'static str] = &$formats;
            fn write(&self, _: &mut dyn Write) -> io::Result<()> {
                Ok(())
            }
            fn read(_: &mut dyn Read) -> io::Result<Self> {
                Ok(Self)
            }
            fn memory(&self) -> u64 {
                0
            }
            fn save(&self, _: &str, _: &Origin) -> Result<Saved, SaveError> {
                Ok(Vec::new().into())
            }
        }
    };
}

artifact!(Map, "map", ["exr", "png"]);
artifact!(Picture, "picture", ["png", "ppm"]);
artifact!(Table, "table", ["csv", "json"]);

struct MapOrPicture;
impl Accepts for MapOrPicture {
    const TYPES: &'static [TypeName] = &["map", "picture"];
    type Value = ();
    fn take(_: AnyArtifact) -> Option<()> {
        None
    }
}

const MAP_OR_PICTURE: &[ResultDeclaration] = &[ResultDeclaration { name: "", types: &["map", "picture"] }];

macro_rules! never_runs {
    () => {
        type Output = Vec<AnyArtifact>;
        fn run(&self, _: &Job<'_>) -> Result<Vec<AnyArtifact>, StageError> {
            unreachable!("these kinds are only planned")
        }
    };
}

/// Reads a file.
#[derive(Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Source {
    /// The file.
    path: InputFile,
    #[serde(default = "one")]
    #[schemars(range(min = 0.0))]
    gain: f64,
    #[serde(default, skip_deserializing)]
    #[schemars(skip)]
    decided: Option<String>,
}

fn one() -> f64 {
    1.0
}

impl Stage for Source {
    const KIND: &'static str = "source";
    const VERSION: u32 = 1;
    const RESULTS: &'static [ResultDeclaration] = MAP_OR_PICTURE;
    fn decide_type(&mut self, type_name: TypeName) {
        self.decided = Some(type_name.to_owned());
    }
    never_runs!();
}

/// Draws.
#[derive(Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Draw {
    /// From what.
    of: Port<Map>,
    /// How many.
    count: NonZeroU32,
    #[serde(default)]
    label: Option<String>,
    #[serde(default)]
    seed: Seed,
}

impl Stage for Draw {
    const KIND: &'static str = "draw";
    const VERSION: u32 = 2;
    const RESULTS: &'static [ResultDeclaration] =
        &[ResultDeclaration { name: "", types: &["table"] }, ResultDeclaration { name: "map", types: &["map"] }];
    fn draws(&self) -> bool {
        self.count.get() > 1
    }
    fn mistakes(&self) -> Vec<Mistake> {
        let is_odd = self.count.get() == 13;
        is_odd.then(|| Mistake { field: "count".into(), message: "13 brings no luck".into(), hint: None }).into_iter().collect()
    }
    never_runs!();
}

/// Gives what it takes.
#[derive(Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Same {
    of: Port<MapOrPicture>,
    #[serde(default)]
    to: Option<Port<MapOrPicture>>,
    #[serde(default)]
    gamma: Option<f64>,
}

impl Stage for Same {
    const KIND: &'static str = "same";
    const VERSION: u32 = 1;
    const RESULTS: &'static [ResultDeclaration] = MAP_OR_PICTURE;
    fn result_types(&self, inputs: &InputTypes) -> Vec<Vec<TypeName>> {
        vec![vec![inputs["of"]]]
    }
    never_runs!();
}

/// Shows pictures.
#[derive(Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Show {
    of: Port<Picture>,
}

impl Stage for Show {
    const KIND: &'static str = "show";
    const VERSION: u32 = 1;
    const RESULTS: &'static [ResultDeclaration] = &[ResultDeclaration { name: "", types: &["picture"] }];
    never_runs!();
}

/// Puts tables together.
#[derive(Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Gather {
    of: Ports<Table>,
    #[serde(default)]
    over: Option<Vec<String>>,
    #[serde(default)]
    x: Option<String>,
    #[serde(default)]
    title: Option<String>,
}

impl Stage for Gather {
    const KIND: &'static str = "gather";
    const VERSION: u32 = 1;
    const RESULTS: &'static [ResultDeclaration] = &[ResultDeclaration { name: "", types: &["table"] }];
    fn axes_used(&self) -> Option<Vec<String>> {
        self.x.clone().map(|x| x.split(' ').map(str::to_owned).collect())
    }
    never_runs!();
}

fn registry() -> Registry {
    Registry::default()
        .with::<Source>()
        .with::<Draw>()
        .with::<Same>()
        .with::<Show>()
        .with::<Gather>()
        .with_artifact::<Map>()
        .with_artifact::<Picture>()
        .with_artifact::<Table>()
}

/// A folder with one pipeline and its inputs.
struct Space {
    folder: tempfile::TempDir,
}

impl Space {
    fn new(body: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let space = Self { folder };
        space.write("map.exr", "").write("p.yaml", &format!("version: 1\npipeline: test\nseed: 7\n{body}"));
        space
    }

    fn write(&self, name: &str, text: &str) -> &Self {
        let path = self.folder.path().join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, text).unwrap();
        self
    }

    fn request(&self) -> Request {
        Request::of_file(self.folder.path().join("p.yaml"))
    }

    fn build(&self, request: &Request) -> Result<(Graph, Vec<Diagnostic>), String> {
        let folder = format!("{}/", self.folder.path().display());
        build(&registry(), request).map_err(|errors| render(&errors, false).replace(&folder, ""))
    }

    fn graph(&self) -> Graph {
        self.build(&self.request()).unwrap_or_else(|errors| panic!("{errors}")).0
    }

    fn errors(&self) -> String {
        self.build(&self.request()).err().expect("the pipeline is wrong")
    }
}

/// `stage coordinate` of every job.
fn jobs(graph: &Graph) -> Vec<String> {
    graph.jobs.iter().map(|job| format!("{} {}", graph.stages[job.stage].name, job.coordinate).trim_end().to_owned()).collect()
}

fn job<'g>(graph: &'g Graph, name: &str) -> &'g crate::engine::graph::JobNode {
    &graph.jobs[jobs(graph).iter().position(|job| job == name).unwrap_or_else(|| panic!("no job `{name}` in {:?}", jobs(graph)))]
}

/// The jobs on a port, with their columns.
fn inputs(graph: &Graph, name: &str, port: usize) -> Vec<String> {
    let all = jobs(graph);
    let shown = |columns: &[(String, crate::engine::coordinate::Scalar)]| {
        columns.iter().map(|(name, value)| format!(" {name}:{value}")).collect::<String>()
    };
    job(graph, name).inputs[port].items.iter().map(|item| format!("{}{}", all[item.job], shown(&item.columns))).collect()
}

#[test]
fn inputs_are_joined_on_shared_axes_and_broadcast_over_others() {
    let graph = Space::new(
        "axes: { n: [4, 8], g: [1, 2.5] }
stages:
  env: { source: { path: map.exr } }
  a: { draw: { of: env, count: $n } }
  b: { same: { of: a.map, gamma: $g } }
  c: { same: { of: b, to: a.map } }
  d: { same: { of: b, to: \"a.map[n=8]\" } }",
    )
    .graph();
    assert_eq!(jobs(&graph).iter().filter(|job| job.starts_with('c')).count(), 4);
    assert_eq!(inputs(&graph, "c n=4,g=2.5", 0), ["b n=4,g=2.5"]);
    assert_eq!(inputs(&graph, "c n=4,g=2.5", 1), ["a n=4"]);
    assert_eq!(inputs(&graph, "d n=4,g=1", 1), ["a n=8"]);
}

#[test]
fn a_collecting_port_collapses_all_axes_or_those_named() {
    let space = Space::new(
        "axes:
  look: [{ name: warm, g: 1 }, { name: cold, g: 2 }]
  n: [4, 8]
stages:
  env: { source: { path: map.exr } }
  a: { draw: { of: env, count: $n, label: \"g ${look.g}\" } }
  all: { gather: { of: a } }
  by-look: { gather: { of: a, over: [n] } }
  none: { gather: { of: [a, b], over: [] } }
  titled: { gather: { of: a, title: \"n = ${n}\" } }
  b: { draw: { of: env, count: 3 } }",
    );
    let graph = space.graph();
    assert_eq!(
        inputs(&graph, "all", 0),
        [
            "a look=warm,n=4 look:warm look.g:1 n:4",
            "a look=warm,n=8 look:warm look.g:1 n:8",
            "a look=cold,n=4 look:cold look.g:2 n:4",
            "a look=cold,n=8 look:cold look.g:2 n:8"
        ]
    );
    assert_eq!(inputs(&graph, "by-look look=cold", 0), ["a look=cold,n=4 n:4", "a look=cold,n=8 n:8"]);
    assert_eq!(inputs(&graph, "none look=warm,n=4", 1), ["b"]);
    assert_eq!(inputs(&graph, "titled n=8", 0).len(), 2);
}

#[test]
fn excluded_coordinates_are_gone_with_what_depends_on_them() {
    let graph = Space::new(
        "axes: { n: [4, 8, 16], g: [1, 2] }
stages:
  env: { source: { path: map.exr } }
  a: { draw: { of: env, count: $n, label: \"${g}\" }, exclude: [{ n: [4, 8], g: 1 }, { n: 16 }] }
  b: { same: { of: a.map } }
  all: { gather: { of: a } }",
    )
    .graph();
    assert_eq!(jobs(&graph), ["env", "a n=4,g=2", "a n=8,g=2", "b n=4,g=2", "b n=8,g=2", "all"]);
    assert_eq!(inputs(&graph, "all", 0).len(), 2);
}

#[test]
fn the_key_holds_what_matters_and_nothing_else() {
    let space = Space::new(
        "stages:
  env: { source: { path: sub/../map.exr, gain: 1.0 } }
  loud: { source: { path: map.exr, gain: 2.0 } }
  one: { draw: { of: env, count: 1 } }
  two: { draw: { of: env, count: 2 } }
  own: { draw: { count: 2.0, of: env, seed: 18446744073709551615 } }",
    );
    space.write("sub/x", "");
    let graph = space.graph();
    let canonical = |name: &str| job(&graph, name).canonical.to_string();
    assert_eq!(canonical("env"), r#"{"decided":"map","path":{"file":"path"}}"#);
    assert_eq!(canonical("loud"), r#"{"decided":"map","gain":2,"path":{"file":"path"}}"#);
    assert_eq!(canonical("one"), r#"{"count":1}"#);
    assert_eq!(canonical("two"), r#"{"count":2,"seed":7}"#);
    assert_eq!(canonical("own"), r#"{"count":2,"seed":18446744073709551615}"#);
    assert_eq!(job(&graph, "one").seed, None);
    assert_eq!(job(&graph, "loud").shown.to_string(), r#"{"decided":"map","gain":2,"path":"map.exr"}"#);
    assert_eq!(job(&graph, "loud").files, [("path".to_owned(), space.folder.path().join("map.exr"))]);
}

#[test]
fn users_decide_the_type_of_a_result() {
    let graph = Space::new(
        "stages:
  env: { source: { path: map.exr } }
  copy: { same: { of: env } }
  shown: { show: { of: env }, save: [png, ppm] }",
    )
    .graph();
    assert_eq!(graph.stages[0].results, [("", "picture")]);
    assert_eq!(graph.stages[1].results, [("", "picture")]);
    assert_eq!(job(&graph, "shown").publications[1].path, "shown.ppm");
    let graph = Space::new(
        "stages:
  env: { source: { path: map.exr } }
  copy: { same: { of: env } }
  again: { same: { of: copy } }
  shown: { show: { of: again } }",
    )
    .graph();
    assert_eq!(graph.stages.iter().map(|stage| stage.results[0].1).collect::<Vec<_>>(), ["picture"; 4]);
    let errors = Space::new(
        "stages:
  env: { source: { path: map.exr } }
  a: { draw: { of: env, count: 4 } }
  b: { show: { of: a } }
  c: { show: { of: env } }",
    )
    .errors();
    assert!(errors.contains("p.yaml:7:20: stage `b`: `of` of `show` takes picture, but `a` gives table"), "{errors}");
    assert!(errors.contains("the users of `env` cannot agree on its type: `a` takes map and `c` takes picture"), "{errors}");
}

#[test]
fn results_are_saved_by_name_and_type() {
    let graph = Space::new(
        "axes: { n: [4, 8] }
stages:
  env: { source: { path: map.exr } }
  a: { draw: { of: env, count: $n }, save: { table: csv, map: [exr, png] } }",
    )
    .graph();
    let paths: Vec<&str> = job(&graph, "a n=8").publications.iter().map(|publication| publication.path.as_str()).collect();
    assert_eq!(paths, ["a/n=8.csv", "a.map/n=8.exr", "a.map/n=8.png"]);
}

#[test]
fn an_include_brings_its_own_folder() {
    let space = Space::new("include: [sub/more.yaml]\nstages:\n  a: { draw: { of: env, count: $n } }");
    space.write("sub/more.yaml", "axes: { n: [1, 2] }\nstages:\n  env: { source: { path: near.exr } }").write("sub/near.exr", "");
    let graph = space.graph();
    assert_eq!(job(&graph, "env").files[0].1, space.folder.path().join("sub/near.exr"));
    assert_eq!(job(&graph, "env").shown["path"], "sub/near.exr");
    assert_eq!(graph.sources.iter().map(|source| source.path.as_str()).collect::<Vec<_>>(), ["p.yaml", "sub/more.yaml"]);
}

#[test]
fn the_command_line_changes_parameters_axes_seed_and_targets() {
    let space = Space::new(
        "params: { label: text, gain: 1 }
axes: { n: [4, 8], look: [{ name: warm, g: 1 }, { name: cold, g: 2 }] }
stages:
  env: { source: { path: map.exr, gain: $gain } }
  a: { draw: { of: env, count: $n, label: $label } }
  b: { same: { of: a.map, gamma: $look.g } }",
    );
    let pair = |name: &str, text: &str| (name.to_owned(), text.to_owned());
    let request = Request {
        parameters: vec![pair("label", "64"), pair("gain", "0.5")],
        axes: vec![pair("n", "2,3"), pair("look", "cold")],
        seed: Some("9".into()),
        only: vec!["a[n=3]".into()],
        force: vec!["env".into()],
        ..space.request()
    };
    let graph = space.build(&request).unwrap_or_else(|errors| panic!("{errors}")).0;
    assert_eq!(jobs(&graph), ["env", "a n=2", "a n=3", "b n=2,look=cold", "b n=3,look=cold"]);
    assert_eq!(job(&graph, "a n=3").canonical.to_string(), r#"{"count":3,"label":"64","seed":9}"#);
    let wanted: Vec<bool> = graph.jobs.iter().map(|job| job.is_wanted).collect();
    assert_eq!(wanted, [true, false, true, false, false]);
    assert!(graph.jobs[0].is_forced && !graph.is_whole);
    assert_eq!(graph.overrides.to_string(), r#"{"params":{"label":"64","gain":"0.5"},"axes":{"n":"2,3","look":"cold"},"seed":"9"}"#);
}

#[test]
fn wrong_arguments_are_named() {
    let space = Space::new(
        "params: { map: map.exr }\naxes: { n: [4, 8] }\nstages:\n  env: { source: { path: $map } }\n  a: { draw: { of: env, count: $n } }",
    );
    let pair = |name: &str, text: &str| vec![(name.to_owned(), text.to_owned())];
    let only = |text: &str| vec![text.to_owned()];
    let base = space.request();
    for (request, expected) in [
        (Request { parameters: pair("mpa", "x"), ..base.clone() }, "-s mpa=x: unknown parameter `mpa`\nhint: did you mean `map`?"),
        (Request { parameters: pair("n", "4"), ..base.clone() }, "-s n=4: `n` is an axis, not a parameter"),
        (Request { axes: pair("n", ""), ..base.clone() }, "-a n=: axis `n` is given no values"),
        (Request { axes: pair("n", "64,x"), ..base.clone() }, "-a n=64,x: stage `a`: `count` (from `$n`) must be an integer"),
        (Request { axes: pair("n", "4,4"), ..base.clone() }, "-a n=4,4: axis `n`: value `4` stands twice"),
        (Request { axes: pair("n", "1..12"), ..base.clone() }, "hint: a range is written `-a 'n={ range: [1, 12, 1] }'`"),
        (Request { axes: pair("n", "1-12"), ..base.clone() }, "-a n=1-12: axis `n` has no value `1-12`"),
        (Request { seed: Some("-1".into()), ..base.clone() }, "--seed -1: the seed must be an integer"),
        (Request { only: only("evn"), ..base.clone() }, "--only evn: there is no stage `evn`\nhint: did you mean `env`?"),
        (Request { only: only("a[n=7]"), ..base.clone() }, "--only a[n=7]: axis `n` has no value `7`"),
        (Request { force: only("a\u{1b}[31m"), ..base.clone() }, "--force a\\u{1b}[31m"),
        (
            Request { parameters: pair("map", "none.exr"), ..base.clone() },
            "-s map=none.exr: stage `env`: input file `none.exr` (from `$map`): no such file",
        ),
    ] {
        let errors = space.build(&request).err().unwrap();
        assert!(errors.contains(expected), "{errors}");
    }
}

#[test]
fn a_text_with_a_hyphen_is_a_value_and_no_range() {
    let space = Space::new(
        "axes: { label: [1-2, 3-4] }\nstages:\n  env: { source: { path: map.exr } }\n  a: { draw: { of: env, count: 4, label: $label } }",
    );
    let request = Request { axes: vec![("label".into(), "3-4".into())], ..space.request() };
    let graph = space.build(&request).unwrap_or_else(|errors| panic!("{errors}")).0;
    assert_eq!(jobs(&graph), ["env", "a label=3-4"]);
}

#[test]
fn a_seed_that_reaches_no_stage_is_told() {
    let warnings = |stages: &str| {
        let space = Space::new(stages);
        let request = Request { seed: Some("9".into()), ..space.request() };
        render(&space.build(&request).unwrap_or_else(|errors| panic!("{errors}")).1, false)
    };
    let own = "axes: { run: [1, 2] }\nstages:\n  env: { source: { path: map.exr } }\n  a: { draw: { of: env, count: 4, seed: $run } }";
    let found = warnings(own);
    assert!(found.contains("--seed 9: no stage draws with it"), "{found}");
    let reached = "stages:\n  env: { source: { path: map.exr } }\n  a: { draw: { of: env, count: 4 } }";
    assert_eq!(warnings(reached), "");
}

#[test]
fn all_mistakes_are_shown_at_once_in_order_each_with_its_place() {
    let errors = Space::new(
        "extra: 1
axes: { n: [4, 13, x], k: [] }
stages:
  env: { source: { path: mapp.exr } }
  a: { darw: { of: env } }
  b: { draw: { of: nev, count: $n, lable: x } }
  c: { same: { of: c } }
  e: { same: { of: a, gamma: $k } }",
    )
    .errors();
    let titles: Vec<&str> = errors.lines().filter_map(|line| line.strip_prefix("error: ")).collect();
    assert_eq!(
        titles,
        [
            "p.yaml:4:1: unknown top-level key `extra`",
            "p.yaml:5:20: stage `b`: `count` (from `$n`) must be an integer from 1 to 4294967295, found text `x`",
            "p.yaml:5:27: axis `k`: has no values",
            "p.yaml:7:26: stage `env`: input file `mapp.exr`: no such file",
            "p.yaml:8:8: stage `a`: unknown kind `darw`",
            "p.yaml:9:20: stage `b`: there is no stage `nev`",
            "p.yaml:9:36: stage `b`: unknown parameter `lable` of `draw`",
            "p.yaml:10:20: stage `c`: a cycle: the stage needs itself",
        ]
    );
    for hint in ["`map.exr`", "`draw`", "`env`", "`label`"] {
        assert!(errors.contains(&format!("hint: did you mean {hint}?")), "{hint}: {errors}");
    }
}

#[test]
fn the_mistakes_of_a_kind_stand_at_their_value() {
    let errors =
        Space::new("axes: { n: [4, 13] }\nstages:\n  env: { source: { path: map.exr } }\n  a: { draw: { of: env, count: $n } }").errors();
    assert!(errors.starts_with("error: p.yaml:4:16: stage `a`: 13 brings no luck\n"), "{errors}");
}

#[test]
fn references_and_axes_that_do_not_fit_are_refused() {
    let stages = "axes: { n: [4, 8], g: [1, 2] }
stages:
  env: { source: { path: map.exr } }
  a: { draw: { of: env, count: $n }, exclude: [{ n: 4 }] }
";
    for (stage, expected) in [
        ("same: { of: \"a.map[n=4]\" }", "selects nothing"),
        ("same: { of: \"a.map[g=1]\" }", "stage `a` has no axis `g`"),
        ("same: { of: \"a.map[n=5]\" }", "axis `n` has no value `5`"),
        ("same: { of: \"a.map[z=5]\" }", "there is no axis `z`"),
        ("same: { of: a.mpa }", "stage `a` has no result `mpa`"),
        ("same: { of: \"${n}\" }", "may use parameters, not axes"),
        ("gather: { of: a, over: [g] }", "has no axis `g`"),
        ("gather: { of: a, over: [n, n] }", "stands twice"),
        ("gather: { of: a, over: [n], title: \"${n}\" }", "cannot be collapsed"),
        ("gather: { of: a, x: g }", "axis `n` of `a` is collapsed, but `gather` uses it nowhere (it names `g`)"),
        ("gather: { of: [a, a] }", "stands twice in `of`"),
        ("same: { of: env }, exclude: [{ n: 4 }]", "the stage has no axis `n`"),
        ("same: { of: env }, save: pgn", "map cannot be saved in format `pgn`"),
        ("same: { of: env }, save: { map: svg }", "map cannot be saved in format `svg`"),
        ("same: { of: env }, cut: 4", "unknown key `cut`"),
    ] {
        let errors = Space::new(&format!("{stages}  x: {{ {stage} }}")).errors();
        assert!(errors.contains(expected) && errors.matches("error:").count() == 1, "{stage}: {errors}");
    }
}

#[test]
fn jobs_are_counted_before_they_are_laid_out() {
    let axes: String = (0..70).map(|index| format!("  p{index}: [0, 1]\n")).collect();
    let label: String = (0..70).map(|index| format!("${{p{index}}}")).collect();
    let stages = format!("stages:\n  env: {{ source: {{ path: map.exr }} }}\n  a: {{ draw: {{ of: env, count: 1, label: \"{label}\" }} }}");
    let errors = Space::new(&format!("axes:\n{axes}{stages}")).errors();
    assert!(errors.contains(&format!("has {} jobs, over the limit of 100000", (1_u128 << 70) + 1)), "{errors}");
}

#[test]
fn a_long_chain_needs_no_stack_and_a_long_cycle_is_shortened() {
    let chain: String = (0..5000).rev().map(|index| format!("  s{}: {{ same: {{ of: s{index} }} }}\n", index + 1)).collect();
    let graph = Space::new(&format!("stages:\n{chain}  s0: {{ source: {{ path: map.exr }} }}")).graph();
    assert_eq!((graph.jobs.len(), jobs(&graph)[0].as_str()), (5001, "s0"));
    let errors = Space::new(&format!("stages:\n{chain}  s0: {{ same: {{ of: s5000 }} }}")).errors();
    assert!(errors.contains("`s5000` -> `s4999`") && errors.contains("more) -> "), "{errors}");
    assert!(errors.len() < 1000);
}

#[test]
fn a_missing_file_and_a_wrong_name_of_the_pipeline_are_errors() {
    let request = Request::of_file(PathBuf::from("/no/such/pipeline.yaml"));
    let errors = render(&build(&registry(), &request).err().unwrap(), false);
    assert_eq!(errors, "error: /no/such/pipeline.yaml: no such file\n");
    for name in ["..", "runs", ".store", "-rf", "a/b", "\"\"", "null", "[a]"] {
        let space = Space::new("");
        space.write("p.yaml", &format!("version: 1\npipeline: {name}\nstages:\n  env: {{ source: {{ path: map.exr }} }}"));
        assert!(space.errors().contains("p.yaml:2:11: the name of the `pipeline`"), "{name}");
    }
}

proptest::proptest! {
    #[test]
    fn any_text_is_read_or_refused(text in "[\\[\\]{}:,&*!|>'\"#$\\\\ \\n\\ta-c0-9.=-]{0,120}", at in 0_usize..200) {
        let whole = "axes: { n: [4, 8] }\nstages:\n  env: { source: { path: map.exr } }\n  a: { draw: { of: env, count: $n }, save: csv }\n";
        let space = Space::new(&format!("{}{text}{}", &whole[..at.min(whole.len())], &whole[at.min(whole.len())..]));
        let errors = space.build(&space.request()).err().unwrap_or_default();
        proptest::prop_assert!(!errors.contains(|c: char| c.is_control() && c != '\n'));
    }
}

#[test]
fn the_manual_shows_kinds_parameters_and_defaults() {
    let registry = registry();
    assert!(manual::kinds(&registry).contains("draw    table, map (.map)  Draws.\n"), "{}", manual::kinds(&registry));
    let text = manual::kind(&registry, "draw").unwrap();
    assert!(text.contains("  count: an integer from 1 to 4294967295; required\n      How many.\n"), "{text}");
    assert!(text.contains("  of: the name of a stage that gives map; required\n"), "{text}");
    assert_eq!(manual::kind(&registry, "darw").unwrap_err(), "there is no kind `darw`; did you mean `draw`?");
    let schema = manual::schema(&registry);
    assert_eq!(schema["definitions"]["stage"]["properties"]["draw"]["$ref"], "#/definitions/draw");
}

//! Jobs: every stage at every coordinate, with its parameters, inputs and published files.

use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};

use serde_json::{Value as Json, json};

use super::World;
use super::draft::{Checker, Draft, FileCheck, file_path};
use super::resolve::{Link, Placed, Resolved};
use super::typing::{Typed, input_types};
use crate::catalogue::nearest;
use crate::engine::canonical::{Replaced, canonical};
use crate::engine::coordinate::{Coordinate, Scalar};
use crate::engine::diagnostic::{escape, quoted};
use crate::engine::graph::{Graph, InputNode, JobNode, PartNode, PartOf, PortInputs, Publication, Source, StageNode};
use crate::engine::reference::Reference;
use crate::engine::relation::{Relation, Row};
use crate::engine::request::{InputPlace, RecordedInput, Request};
use crate::engine::save::{Names, published_path};
use crate::engine::schema::{FieldPath, Role, RoleField};
use crate::engine::source::{Finding, Findings, Place, Sources, did_you_mean, without_dots};
use crate::engine::stage::{AnyStage, Part};
use crate::engine::yaml::{Node, Value};

/// `--only` and `--force` as written.
pub struct Targets {
    only: Vec<(Reference, u32)>,
    force: Vec<(Reference, u32)>,
}

/// Stages and values of their axes.
pub struct Selected {
    only: Vec<Selection>,
    force: Vec<Selection>,
    /// Whether any `--only` was given, right or wrong.
    is_partial: bool,
}

struct Selection {
    stage: usize,
    values: Vec<(usize, Vec<u32>)>,
}

impl Selection {
    fn takes(&self, relation: &Relation, row: &[u32]) -> bool {
        self.values.iter().all(|(axis, values)| values.contains(&relation.key(row, &[*axis])[0]))
    }
}

impl Targets {
    /// Takes the references of the command line apart.
    pub fn read(request: &Request, sources: &mut Sources, findings: &mut Findings) -> Self {
        let mut references = |flag: &str, texts: &[String]| {
            let mut read = Vec::new();
            for text in texts {
                let file = sources.add_argument(flag, text);
                match Reference::parse(text) {
                    Ok(reference) if reference.result.is_none() => read.push((reference, file)),
                    Ok(_) => findings.add(Finding::error(Place::of_file(file), "names a result; all results of a stage come together")),
                    Err(message) => findings.add(Finding::error(Place::of_file(file), message)),
                }
            }
            read
        };
        Self { only: references("--only", &request.only), force: references("--force", &request.force) }
    }

    /// The stages and values that they name.
    pub fn resolved(self, world: &World<'_, '_>, resolved: &Resolved, findings: &mut Findings) -> Selected {
        let is_partial = !self.only.is_empty();
        let mut selections = |references: Vec<(Reference, u32)>| {
            let found = references.into_iter().filter_map(|(reference, file)| match selection(world, resolved, &reference) {
                Ok(selection) => selection,
                Err((message, hint)) => {
                    findings.add(Finding::error(Place::of_file(file), message).with_hint(hint));
                    None
                }
            });
            found.collect()
        };
        Selected { only: selections(self.only), force: selections(self.force), is_partial }
    }
}

/// `None` where the stage itself is wrong, which was reported.
fn selection(world: &World<'_, '_>, resolved: &Resolved, reference: &Reference) -> Result<Option<Selection>, (String, Option<String>)> {
    let stages = &world.document.stages;
    let Some(stage) = stages.iter().position(|entry| entry.name == reference.stage) else {
        let hint = did_you_mean(nearest(&reference.stage, stages.iter().map(|entry| entry.name.as_str())));
        return Err((format!("there is no stage {}", quoted(&reference.stage)), hint));
    };
    let Some(placed) = &resolved.stages[stage] else { return Ok(None) };
    let values: Vec<(usize, Vec<u32>)> =
        reference.selections.iter().map(|selection| world.selected(selection)).collect::<Result<_, _>>()?;
    if let Some((axis, _)) = values.iter().find(|(axis, _)| !placed.relation.axes.contains(axis)) {
        return Err((format!("stage {} has no axis {}", quoted(&reference.stage), quoted(&world.axes[*axis].name)), None));
    }
    let left = values.iter().fold(placed.relation.clone(), |relation, (axis, values)| relation.restricted(*axis, values));
    if left.count() == Some(0) {
        return Err((format!("nothing is left of stage {} there: those coordinates are excluded", quoted(&reference.stage)), None));
    }
    Ok(Some(Selection { stage, values }))
}

/// Lays out all jobs; `None` if a combination of axis values is wrong.
pub fn expand<'r>(
    world: &World<'r, '_>,
    mut drafts: Vec<Option<Draft<'r>>>,
    resolved: Resolved,
    typed: Vec<Option<Typed>>,
    targets: Selected,
    request: &Request,
    findings: &mut Findings,
) -> Option<Graph> {
    let folder = folder_of(&request.file);
    let stages = stage_nodes(world, &resolved, &typed)?;
    let mut layout = Layout {
        world,
        resolved: &resolved,
        typed: &typed,
        folder: &folder,
        targets: &targets,
        jobs: Vec::new(),
        rows: resolved.stages.iter().map(|_| Vec::new()).collect(),
        first_job: vec![0; resolved.stages.len()],
        names: Names::default(),
        files: FileCheck::default(),
    };
    for stage in resolved.order.iter().copied() {
        layout.stage(stage, drafts[stage].as_mut()?, findings)?;
        if findings.is_full() {
            break;
        }
    }
    let mut jobs = layout.jobs;
    want_inputs(&mut jobs);
    Some(Graph {
        pipeline: world.document.pipeline.clone(),
        seed: world.document.seed,
        sources: sources(world.sources, &folder),
        folder,
        overrides: portable(request.overrides(), &jobs),
        request: request.identity(),
        has_warnings: false,
        is_whole: !targets.is_partial && request.axes.is_empty(),
        stages,
        jobs,
    })
}

/// The folder of a file; the working folder as `.`, so that it is a path.
fn folder_of(file: &Path) -> PathBuf {
    file.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new(".")).to_owned()
}

fn sources(sources: &Sources, folder: &Path) -> Vec<Source> {
    let files = sources.files();
    files
        .map(|file| Source { path: relative(Path::new(&file.shown), folder), read_as: file.path.clone(), text: file.text.clone() })
        .collect()
}

/// A path as the manifest shows it: relative to the pipeline's folder, or the name alone where it lies elsewhere.
fn relative(path: &Path, folder: &Path) -> String {
    let clean = |path: &Path| std::path::absolute(path).map_or_else(|_| path.to_owned(), |path| without_dots(&path));
    let path = clean(path);
    let inside = path.strip_prefix(clean(folder)).ok();
    let shown = inside.or_else(|| path.file_name().map(Path::new)).unwrap_or(&path);
    shown.to_string_lossy().into_owned()
}

fn stage_nodes(world: &World<'_, '_>, resolved: &Resolved, typed: &[Option<Typed>]) -> Option<Vec<StageNode>> {
    let stages = world.document.stages.iter().enumerate();
    stages
        .map(|(index, entry)| {
            let kind = entry.kind?;
            Some(StageNode {
                name: entry.name.clone(),
                kind: kind.name,
                version: kind.version,
                about: entry.about.clone(),
                resources: entry.resources,
                split: entry.split,
                place: (escape(&world.sources.get(entry.place.file).shown), entry.place.line as usize),
                axes: resolved.stages[index].as_ref()?.relation.axes.iter().map(|axis| world.axes[*axis].name.clone()).collect(),
                results: typed[index].as_ref()?.results.clone(),
            })
        })
        .collect()
}

/// The changes of the command line without the folders of input files, which are no one else's business.
fn portable(mut overrides: Json, jobs: &[JobNode]) -> Json {
    let groups = overrides.as_object_mut().into_iter().flat_map(|groups| groups.values_mut());
    let texts: Vec<&mut Json> = groups.filter_map(Json::as_object_mut).flat_map(|texts| texts.values_mut()).collect();
    if texts.is_empty() {
        return overrides;
    }
    let files = jobs.iter().flat_map(|job| job.files.iter().map(move |(name, path)| (job, name, path)));
    let shown = files.filter_map(|(job, name, path)| Some((path.to_str()?, FieldPath::parse(name).look_up(&job.shown)?.as_str()?)));
    let names: BTreeMap<&str, &str> = shown.filter(|(path, shown)| path != shown).collect();
    for text in texts {
        let Json::String(text) = text else { continue };
        for (path, shown) in names.iter().rev() {
            if text == path || (path.starts_with('/') && text.contains(path)) {
                *text = text.replace(path, shown);
            }
        }
    }
    overrides
}

/// A job is wanted if one that needs it is; users stand behind their inputs.
fn want_inputs(jobs: &mut [JobNode]) {
    for index in (0..jobs.len()).rev() {
        if jobs[index].is_wanted {
            let inputs: Vec<usize> = jobs[index].inputs.iter().flat_map(|port| port.items.iter().map(|item| item.job)).collect();
            inputs.into_iter().for_each(|input| jobs[input].is_wanted = true);
        }
    }
}

struct Layout<'a, 'r, 's> {
    world: &'a World<'r, 's>,
    resolved: &'a Resolved,
    typed: &'a [Option<Typed>],
    folder: &'a Path,
    targets: &'a Selected,
    jobs: Vec<JobNode>,
    /// By stage, ascending; the job of row i is `first_job + i`.
    rows: Vec<Vec<Row>>,
    first_job: Vec<usize>,
    names: Names,
    files: FileCheck,
}

/// A job with its parts, which have no place among the jobs yet, and how many of its prefixes hold each.
struct Divided {
    whole: JobNode,
    parts: Vec<(JobNode, usize)>,
}

/// The rows of a target by the values on the axes that it shares with its user.
struct Grouped<'l> {
    port: usize,
    link: &'l Link,
    axes: Vec<usize>,
    rows: HashMap<Row, Vec<usize>>,
    label: String,
}

impl<'r> Layout<'_, 'r, '_> {
    fn stage(&mut self, stage: usize, draft: &mut Draft<'r>, findings: &mut Findings) -> Option<()> {
        let placed = self.resolved.stages[stage].as_ref()?;
        let typed = self.typed[stage].as_ref()?;
        let inputs = placed.ports.iter().enumerate().flat_map(|(port, declared)| declared.links.iter().map(move |link| (port, link)));
        let grouped: Vec<Grouped<'_>> = inputs.map(|(port, link)| self.grouped(port, link)).collect::<Option<_>>()?;
        let rows = placed.relation.rows();
        let mut jobs = Vec::with_capacity(rows.len());
        for row in &rows {
            if findings.is_full() {
                return None;
            }
            jobs.extend(self.job(stage, draft, placed, typed, &grouped, row, findings));
        }
        // Jobs are numbered by rows; after a mistake there is no graph to number.
        if jobs.len() < rows.len() {
            return None;
        }
        self.add(stage, jobs);
        self.rows[stage] = rows;
        Some(())
    }

    /// Adds the jobs of a stage: first the parts of all of them, so that the jobs stand in the order of rows.
    fn add(&mut self, stage: usize, jobs: Vec<Divided>) {
        let first_part = self.jobs.len();
        let first_job = first_part + jobs.iter().map(|job| job.parts.len()).sum::<usize>();
        let mut wholes = Vec::with_capacity(jobs.len());
        for (row, Divided { mut whole, parts }) in jobs.into_iter().enumerate() {
            let count = parts.len();
            for (index, (part, within)) in parts.into_iter().enumerate() {
                whole.parts.push(PartNode { job: self.jobs.len(), within });
                self.jobs.push(JobNode { part_of: Some(PartOf { whole: first_job + row, number: index + 1, count }), ..part });
            }
            wholes.push(whole);
        }
        self.first_job[stage] = first_job;
        self.jobs.extend(wholes);
    }

    fn grouped<'l>(&self, port: usize, link: &'l Link) -> Option<Grouped<'l>> {
        let target = &self.resolved.stages[link.target].as_ref()?.relation;
        let axes = link.kept_axes(target);
        let mut rows: HashMap<Row, Vec<usize>> = HashMap::new();
        for (index, row) in self.rows[link.target].iter().enumerate() {
            if link.selections.iter().all(|(axis, values)| values.contains(&target.key(row, &[*axis])[0])) {
                rows.entry(target.key(row, &axes)).or_default().push(index);
            }
        }
        let result = self.typed[link.target].as_ref()?.results[link.result].0;
        let point = if result.is_empty() { "" } else { "." };
        Some(Grouped { port, link, axes, rows, label: format!("{}{point}{result}", self.world.name(link.target)) })
    }

    #[allow(clippy::too_many_arguments, reason = "one job is where all that is known of a stage comes together")]
    fn job(
        &mut self,
        stage: usize,
        draft: &mut Draft<'r>,
        placed: &Placed,
        typed: &Typed,
        grouped: &[Grouped<'_>],
        row: &Row,
        findings: &mut Findings,
    ) -> Option<Divided> {
        let world = self.world;
        let index_of = |axis: usize| placed.relation.axes.iter().position(|own| *own == axis).map_or(0, |position| row[position] as usize);
        let node = if draft.own_axes.is_empty() { draft.base.clone() } else { draft.template.at(&world.axes, &index_of) };
        let checker = Checker { world, kind: draft.kind, stage: world.name(stage) };
        // Each value of a single axis was checked with its stage; only combinations are new.
        let (roles, instance) = match draft.own_axes.len() {
            // The block was read with its stage, and serves the first job.
            0 => (draft.roles.clone(), draft.instance.take().or_else(|| checker.parsed(&node, &draft.roles, findings))),
            _ => checker.checked(&node, &mut self.files, findings),
        };
        let coordinate = self.coordinate(&placed.relation, row);
        let recorded = |field: &RoleField| world.inputs?.get(&InputPlace::at(checker.stage, &coordinate, &field.path.to_string()));
        let (roles, instance) = match roles.iter().any(|field| recorded(field).is_some()) {
            true => checker.checked(&with_files(&node, &roles, recorded), &mut self.files, findings),
            false => (roles, instance),
        };
        let mut instance = instance?;
        self.type_of_job(stage, instance.as_mut(), placed, typed, findings)?;
        let inputs = self.inputs(placed, grouped, row);
        let own_seed = own_seed(&roles);
        let (seed, has_own_seed) = (instance.draws().then(|| own_seed.unwrap_or(world.document.seed)), own_seed.is_some());
        let publications = self.publications(stage, typed, &coordinate, findings);
        let parameters = instance.parameters();
        // They differ in how files are named alone.
        let reads_files = roles.iter().any(|field| field.role == Role::File);
        let shown_file = |field: &RoleField| recorded(field).map_or_else(|| self.shown_file(&field.node), |input| json!(input.shown));
        let shown = reads_files.then(|| self.described(draft, parameters.clone(), &roles, seed, shown_file));
        let canonical = self.in_key(draft, parameters, &roles, seed);
        let is_selected = |selections: &[Selection]| selections.iter().any(|one| one.stage == stage && one.takes(&placed.relation, row));
        let whole = JobNode {
            stage,
            coordinate,
            prefixes: self.prefixes(draft, instance.as_ref(), &roles, seed),
            parameters: instance,
            shown: shown.unwrap_or_else(|| canonical.clone()),
            canonical,
            inputs,
            files: self.files_of(&roles),
            seed,
            has_own_seed,
            publications,
            parts: Vec::new(),
            part_of: None,
            is_wanted: !self.targets.is_partial || is_selected(&self.targets.only),
            is_forced: is_selected(&self.targets.force),
        };
        Some(self.divided(draft, &roles, whole))
    }

    /// A job with the parts in which `split:` has it computed.
    fn divided(&self, draft: &Draft<'r>, roles: &[RoleField], whole: JobNode) -> Divided {
        let part = |Part { parameters, within }: Part<Box<dyn AnyStage>>| {
            let canonical = self.in_key(draft, parameters.parameters(), roles, whole.seed);
            let node = JobNode {
                stage: whole.stage,
                coordinate: whole.coordinate.clone(),
                prefixes: self.prefixes(draft, parameters.as_ref(), roles, whole.seed),
                parameters,
                shown: canonical.clone(),
                canonical,
                inputs: whole.inputs.clone(),
                files: whole.files.clone(),
                seed: whole.seed,
                has_own_seed: whole.has_own_seed,
                publications: Vec::new(),
                parts: Vec::new(),
                part_of: None,
                is_wanted: false,
                is_forced: whole.is_forced,
            };
            (node, within)
        };
        let split = self.world.document.stages[whole.stage].split;
        let parts = split.map(|count| whole.parameters.parts(count)).unwrap_or_default();
        let parts = parts.into_iter().map(part).collect();
        Divided { whole, parts }
    }

    /// The parameters as they enter the key: see [`JobNode::canonical`].
    fn in_key(&self, draft: &Draft<'r>, parameters: Json, roles: &[RoleField], seed: Option<u64>) -> Json {
        self.described(draft, parameters, roles, seed, |field| json!({ "file": field.path.to_string() }))
    }

    /// See [`JobNode::prefixes`].
    fn prefixes(&self, draft: &Draft<'r>, of: &dyn AnyStage, roles: &[RoleField], seed: Option<u64>) -> Vec<Json> {
        of.prefixes().into_iter().map(|prefix| self.in_key(draft, prefix, roles, seed)).collect()
    }

    fn type_of_job(
        &self,
        stage: usize,
        instance: &mut dyn AnyStage,
        placed: &Placed,
        typed: &Typed,
        findings: &mut Findings,
    ) -> Option<()> {
        let candidates = instance.result_types(&input_types(&placed.ports, self.typed)?);
        for ((name, decided), types) in typed.results.iter().zip(&candidates) {
            if !types.contains(decided) {
                let result = if name.is_empty() { "its result".to_owned() } else { format!("its result `{name}`") };
                let message =
                    format!("{result} is {decided} at some values of its axes and {} at others; a stage has one type", types.join(" or "));
                findings.add(Finding::error(self.world.document.stages[stage].place, message).in_stage(self.world.name(stage)));
                return None;
            }
        }
        if typed.is_decided {
            instance.decide_type(typed.results[0].1);
        }
        Some(())
    }

    fn coordinate(&self, relation: &Relation, row: &[u32]) -> Coordinate {
        let value = |(axis, index): (&usize, &u32)| {
            let axis = &self.world.axes[*axis];
            (axis.name.clone(), axis.values[*index as usize].scalar.clone())
        };
        Coordinate(relation.axes.iter().zip(row).map(value).collect())
    }

    fn inputs(&self, placed: &Placed, grouped: &[Grouped<'_>], row: &Row) -> Vec<PortInputs> {
        let inputs = grouped.iter().map(|group| {
            let port = &placed.ports[group.port];
            let key = placed.relation.key(row, &group.axes);
            let rows = group.rows.get(&key).map(Vec::as_slice).unwrap_or_default();
            let items = rows.iter().map(|row| self.input(group, *row)).collect();
            PortInputs { port: port.name.clone(), reference: group.link.written.clone(), collects: port.collects, items }
        });
        inputs.collect()
    }

    fn input(&self, group: &Grouped<'_>, row_index: usize) -> InputNode {
        let target = group.link.target;
        let mut columns: Vec<(String, Scalar)> = Vec::new();
        if !group.link.collapsed.is_empty() {
            let relation = &self.resolved.stages[target].as_ref().expect("a target is placed before its users").relation;
            let row = &self.rows[target][row_index];
            for (axis, index) in relation.axes.iter().zip(row).filter(|(axis, _)| group.link.collapsed.contains(axis)) {
                let axis = &self.world.axes[*axis];
                columns.push((axis.name.clone(), axis.values[*index as usize].scalar.clone()));
                columns.extend(axis.columns(*index as usize));
            }
        }
        InputNode { job: self.first_job[target] + row_index, result: group.link.result, label: group.label.clone(), columns }
    }

    fn publications(&mut self, stage: usize, typed: &Typed, coordinate: &Coordinate, findings: &mut Findings) -> Vec<Publication> {
        let name = self.world.name(stage);
        let mut publications = Vec::with_capacity(typed.saves.len());
        for save in &typed.saves {
            let path = published_path(name, typed.results[save.result].0, coordinate, &save.extension);
            if let Err(message) = self.names.take(&path, name) {
                findings.add(Finding::error(save.place, message).in_stage(name));
            }
            publications.push(Publication { result: save.result, format: save.format.clone(), path });
        }
        publications
    }

    /// The parameters without ports and defaults, files shown by a function.
    fn described(
        &self,
        draft: &Draft<'r>,
        parameters: Json,
        roles: &[RoleField],
        seed: Option<u64>,
        shown: impl Fn(&RoleField) -> Json,
    ) -> Json {
        let mut replaced: Vec<Replaced<'_>> = Vec::with_capacity(roles.len());
        for field in roles {
            let instead = match &field.role {
                Role::Port(_) | Role::Ports(_) => None,
                Role::Seed => seed.map(|seed| json!(seed)),
                Role::File if file_path(&field.node, self.world.sources).is_none() => continue,
                Role::File => Some(shown(field)),
            };
            replaced.push(Replaced { path: &field.path, role: &field.role, instead });
        }
        let own_seed = FieldPath::parse("seed");
        if let (Some(seed), false) = (seed, roles.iter().any(|field| field.role == Role::Seed)) {
            replaced.push(Replaced { path: &own_seed, role: &Role::Seed, instead: Some(json!(seed)) });
        }
        canonical(&self.world.rules(draft.kind), parameters, &replaced)
    }

    fn shown_file(&self, node: &Node) -> Json {
        let path = file_path(node, self.world.sources).unwrap_or_default();
        json!(relative(&path, self.folder))
    }

    fn files_of(&self, roles: &[RoleField]) -> Vec<(String, PathBuf)> {
        let files = roles.iter().filter(|field| field.role == Role::File);
        files.filter_map(|field| Some((field.path.to_string(), file_path(&field.node, self.world.sources)?))).collect()
    }
}

/// The parameters with the paths of a recorded run's files as they are now.
fn with_files<'f>(node: &Node, roles: &[RoleField], recorded: impl Fn(&RoleField) -> Option<&'f RecordedInput>) -> Node {
    let files = roles.iter().filter_map(|field| Some((field, recorded(field)?)));
    files.fold(node.clone(), |node, (field, input)| {
        let text = Value::Text(input.path.to_string_lossy().into());
        field.path.replaced(&node, &text)
    })
}

/// The seed that the stage itself sets.
fn own_seed(roles: &[RoleField]) -> Option<u64> {
    let field = roles.iter().find(|field| field.role == Role::Seed)?;
    match &field.node.value {
        Value::Integer(seed) => u64::try_from(*seed).ok(),
        Value::Number(seed) => Some(*seed as u64),
        _ => None,
    }
}

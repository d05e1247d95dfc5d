//! One stage by itself: its parameters substituted, checked against the schema and read by its kind.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::fs::File;
use std::path::{Path, PathBuf};

use super::World;
use crate::catalogue::nearest;
use crate::engine::axes::scalar_of;
use crate::engine::diagnostic::{escape, quoted};
use crate::engine::registry::Kind;
use crate::engine::schema::{FieldPath, Role, RoleField, to_yaml};
use crate::engine::source::{Finding, Findings, Place, Sources, did_you_mean, unreadable};
use crate::engine::stage::AnyStage;
use crate::engine::substitution::{Scope, Template, substitute};
use crate::engine::yaml::{Entry, Node, Value};

/// A stage before its references are resolved.
pub struct Draft<'r> {
    /// Its kind.
    pub kind: &'r Kind,
    /// Its parameters, axes still open.
    pub template: Template,
    /// The axes that its parameters mention.
    pub own_axes: BTreeSet<usize>,
    /// Its parameters at the first value of every axis.
    pub base: Node,
    /// Its ports, files and seeds.
    pub roles: Vec<RoleField>,
    /// Its parameters as its kind reads them, at the first value of every axis; `None` if something is wrong.
    pub instance: Option<Box<dyn AnyStage>>,
}

/// Checks a stage for every value of every axis that it mentions. `None` if nothing can be said of it.
pub fn draft<'r>(
    world: &World<'r, '_>,
    scope: &Scope<'_>,
    stage: usize,
    files: &mut FileCheck,
    findings: &mut Findings,
) -> Option<Draft<'r>> {
    let entry = &world.document.stages[stage];
    let kind = entry.kind.filter(|_| entry.parameters.map().is_some())?;
    let error_count = findings.error_count();
    let template = substitute(&entry.parameters, scope, &entry.name, findings);
    let mut own_axes = BTreeSet::new();
    template.add_axes(&mut own_axes);
    if findings.error_count() > error_count || own_axes.iter().any(|axis| world.axes[*axis].values.is_empty()) {
        return None;
    }
    let left = Remaining::new(world, &own_axes, entry.exclude.as_ref());
    let first = left.first(None).unwrap_or_else(|| left.zero());
    let base = template.at(&world.axes, &|axis| first[&axis]);
    let checker = Checker { world, kind, stage: &entry.name };
    let (roles, instance) = checker.checked(&base, files, findings);
    for axis in &own_axes {
        for value in (0..world.axes[*axis].values.len()).filter(|value| *value != first[axis]) {
            if findings.is_full() {
                break;
            }
            // A value that `exclude` leaves nowhere need not be right.
            let Some(chosen) = left.first(Some((*axis, value))) else { continue };
            checker.checked(&template.at(&world.axes, &|axis| chosen[&axis]), files, findings);
        }
    }
    let instance = instance.filter(|_| findings.error_count() == error_count);
    Some(Draft { kind, template, own_axes, base, roles, instance })
}

/// Most coordinates that are tried to find one that `exclude` leaves.
const TRIED: usize = 100_000;

/// The coordinates that a stage's own `exclude` leaves, over the axes that its parameters mention.
struct Remaining<'a> {
    /// Number of values of each axis.
    counts: Vec<(usize, usize)>,
    exclusions: Vec<BTreeMap<usize, Vec<usize>>>,
    own_axes: &'a BTreeSet<usize>,
}

impl<'a> Remaining<'a> {
    /// Reads what is right of `exclude`; what is wrong with it is reported where references are resolved.
    fn new(world: &World<'_, '_>, own_axes: &'a BTreeSet<usize>, exclude: Option<&Node>) -> Self {
        let counts = own_axes.iter().map(|axis| (*axis, world.axes[*axis].values.len())).collect();
        let exclusion = |item: &Node| -> Option<BTreeMap<usize, Vec<usize>>> {
            let entries = item.map()?.iter();
            let values = |entry: &Entry| {
                let axis = world.axis_index(&entry.key).ok()?;
                let index = |value: &Node| world.axes[axis].index_of(&scalar_of(value)?.to_string());
                Some((axis, texts(&entry.node).into_iter().map(index).collect::<Option<_>>()?))
            };
            entries.map(values).collect()
        };
        let items = exclude.and_then(Node::list).map(|items| &**items).unwrap_or_default();
        Self { counts, exclusions: items.iter().filter_map(exclusion).collect(), own_axes }
    }

    /// The first value of every axis.
    fn zero(&self) -> BTreeMap<usize, usize> {
        self.own_axes.iter().map(|axis| (*axis, 0)).collect()
    }

    /// The first coordinate that is left, with the given value on the given axis.
    fn first(&self, fixed: Option<(usize, usize)>) -> Option<BTreeMap<usize, usize>> {
        let mut coordinate = self.zero();
        coordinate.extend(fixed);
        for _ in 0..TRIED {
            if !self.is_excluded(&coordinate) {
                return Some(coordinate);
            }
            let turned = self.counts.iter().rev().filter(|(axis, _)| fixed.is_none_or(|(pinned, _)| pinned != *axis));
            let mut is_over = true;
            for (axis, count) in turned {
                let value = coordinate.get_mut(axis).expect("a coordinate has every axis");
                *value = (*value + 1) % count;
                if *value != 0 {
                    is_over = false;
                    break;
                }
            }
            if is_over {
                return None;
            }
        }
        None
    }

    /// Whether an exclusion over no other axes drops the coordinate.
    fn is_excluded(&self, coordinate: &BTreeMap<usize, usize>) -> bool {
        let drops = |exclusion: &BTreeMap<usize, Vec<usize>>| {
            exclusion.iter().all(|(axis, values)| coordinate.get(axis).is_some_and(|value| values.contains(value)))
        };
        self.exclusions.iter().any(drops)
    }
}

/// Checks parameter blocks of one stage.
pub struct Checker<'a, 'r, 's> {
    /// What all steps read.
    pub world: &'a World<'r, 's>,
    /// The kind of the stage.
    pub kind: &'r Kind,
    /// Name of the stage.
    pub stage: &'a str,
}

impl Checker<'_, '_, '_> {
    /// The roles of its fields, and the block as its kind reads it if nothing is wrong.
    pub fn checked(&self, node: &Node, files: &mut FileCheck, findings: &mut Findings) -> (Vec<RoleField>, Option<Box<dyn AnyStage>>) {
        let checked = self.world.rules(self.kind).check(node);
        let is_right = checked.issues.is_empty();
        for issue in checked.issues {
            findings.add(Finding::error(issue.place, issue.message).in_stage(self.stage).with_hint(issue.hint));
        }
        // The files of a recorded run were found by their digests before.
        for field in checked.roles.iter().filter(|field| field.role == Role::File && self.world.inputs.is_none()) {
            files.check(&field.node, self.world.sources, self.stage, findings);
        }
        let instance = if is_right { self.parsed(node, &checked.roles, findings) } else { None };
        (checked.roles, instance)
    }

    /// The block as its kind reads it, with the mistakes that only the kind knows.
    pub fn parsed(&self, node: &Node, roles: &[RoleField], findings: &mut Findings) -> Option<Box<dyn AnyStage>> {
        let instance = match self.kind.parse(for_serde(node, roles, self.world.sources)) {
            Ok(instance) => instance,
            Err(error) => {
                let path = FieldPath::parse(&error.path);
                let name = if path.0.is_empty() { String::new() } else { format!("{}: ", quoted(&path.to_string())) };
                let message = format!("{name}{}", cut(&error.message));
                findings.add(Finding::error(path.follow(node).place, message).in_stage(self.stage));
                return None;
            }
        };
        let mistakes = instance.mistakes();
        for mistake in &mistakes {
            let place = FieldPath::parse(&mistake.field).follow(node).place;
            let hint = mistake.hint.as_deref().map(cut);
            findings.add(Finding::error(place, cut(&mistake.message)).in_stage(self.stage).with_hint(hint));
        }
        mistakes.is_empty().then_some(instance)
    }
}

/// Longest message of a kind, in characters.
const MESSAGE_LENGTH: usize = 400;

fn cut(message: &str) -> String {
    let shown: String = message.chars().take(MESSAGE_LENGTH).collect();
    escape(&shown) + if shown.len() < message.len() { "…" } else { "" }
}

/// The block for serde: a single reference as a list of one where many may stand, and paths resolved.
fn for_serde(node: &Node, roles: &[RoleField], sources: &Sources) -> serde_yaml::Value {
    let mut yaml = to_yaml(node);
    for field in roles {
        let Some(place) = field.path.in_yaml(&mut yaml) else { continue };
        match &field.role {
            Role::Ports(_) if place.is_string() => *place = serde_yaml::Value::Sequence(vec![place.clone()]),
            Role::File => {
                if let Some(path) = file_path(&field.node, sources) {
                    *place = serde_yaml::Value::String(path.to_string_lossy().into_owned());
                }
            }
            _ => {}
        }
    }
    yaml
}

/// The file that a field names; `None` for a map without a file (`synthetic:NAME`).
pub fn file_path(node: &Node, sources: &Sources) -> Option<PathBuf> {
    let text = node.text().filter(|text| !text.starts_with("synthetic:"))?;
    Some(sources.get(node.place.file).folder.join(text))
}

/// Looks once at every input file.
#[derive(Default)]
pub struct FileCheck {
    verdicts: HashMap<PathBuf, Option<String>>,
    /// Places at which something was reported: one sweep over missing files is one message.
    reported: BTreeSet<Place>,
}

impl FileCheck {
    /// Reports a file that is missing, unreadable or no regular file.
    pub fn check(&mut self, node: &Node, sources: &Sources, stage: &str, findings: &mut Findings) {
        let Some(path) = file_path(node, sources) else { return };
        let verdict = self.verdicts.entry(path).or_insert_with_key(|path| verdict(path));
        let Some(problem) = verdict else { return };
        if !self.reported.insert(node.place) {
            return;
        }
        let text = node.text().unwrap_or_default();
        let via = node.via.as_ref().map(|via| format!(" (from {})", quoted(via))).unwrap_or_default();
        let hint = nearest_file(text, node, sources).or_else(|| tried(text, node, sources));
        findings.add(Finding::error(node.place, format!("input file {}{via}: {problem}", quoted(text))).in_stage(stage).with_hint(hint));
    }
}

fn verdict(path: &Path) -> Option<String> {
    let text = path.to_string_lossy();
    if text.contains('\0') {
        return Some("contains a NUL character".to_owned());
    }
    if path.to_str().is_none() {
        return Some("lies in a folder whose name is not UTF-8".to_owned());
    }
    match std::fs::metadata(path) {
        Err(_) if text.contains("://") => Some("no such file; files are read from disk only, not from the network".to_owned()),
        Err(error) => Some(unreadable(&error)),
        Ok(metadata) if metadata.is_dir() => Some("is a directory, not a file".to_owned()),
        Ok(metadata) if !metadata.is_file() => Some("is not a regular file".to_owned()),
        Ok(_) => File::open(path).err().map(|error| unreadable(&error)),
    }
}

/// The whole path, for a relative one: it counts from the folder of the file in which it stands.
fn tried(text: &str, node: &Node, sources: &Sources) -> Option<String> {
    let path = std::path::absolute(file_path(node, sources)?).ok()?;
    let is_told = Path::new(text).is_absolute() || text.contains("://") || std::fs::symlink_metadata(&path).is_ok();
    (!is_told).then(|| format!("looked for as {}", quoted(&path.to_string_lossy())))
}

/// Most files of a folder among which a similar name is looked for.
const LOOKED_AT: usize = 2000;

fn nearest_file(text: &str, node: &Node, sources: &Sources) -> Option<String> {
    let path = file_path(node, sources)?;
    let wanted = path.file_name()?.to_str()?.to_owned();
    if std::fs::symlink_metadata(&path).is_ok() {
        return None;
    }
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let entries = std::fs::read_dir(folder).ok()?.take(LOOKED_AT).filter_map(|entry| entry.ok()?.file_name().into_string().ok());
    let mut names: Vec<String> = entries.collect();
    names.sort();
    let found = nearest(&wanted, names.iter().map(String::as_str))?;
    did_you_mean(Some(&format!("{}{found}", text.strip_suffix(wanted.as_str())?)))
}

/// Whether a value is text, for messages about ports.
pub fn texts(node: &Node) -> Vec<&Node> {
    match &node.value {
        Value::List(items) => items.iter().collect(),
        _ => vec![node],
    }
}

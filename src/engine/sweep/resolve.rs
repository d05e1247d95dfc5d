//! References, the order of stages, and the coordinates of each.

use std::collections::{BTreeSet, HashMap};
use std::sync::Arc;

use super::World;
use super::draft::{Draft, texts};
use crate::catalogue::nearest;
use crate::engine::diagnostic::{listed, quoted};
use crate::engine::reference::Reference;
use crate::engine::relation::{Relation, TooMany};
use crate::engine::schema::Role;
use crate::engine::source::{Finding, Findings, Place, did_you_mean};
use crate::engine::substitution::Template;
use crate::engine::yaml::{Node, Value};

/// Everything that is known once references are resolved.
pub struct Resolved {
    /// Stages in an order in which inputs come before their users; without those on a cycle.
    pub order: Vec<usize>,
    /// By stage; `None` where something it depends on is wrong.
    pub stages: Vec<Option<Placed>>,
}

/// A stage with its inputs and coordinates.
pub struct Placed {
    /// Its ports, in the order of its text.
    pub ports: Vec<Port>,
    /// All its coordinates.
    pub relation: Relation,
}

/// One port.
pub struct Port {
    /// Name of its field.
    pub name: String,
    /// Types it takes.
    pub accepts: Arc<[String]>,
    /// Whether it takes any number of results.
    pub collects: bool,
    /// What stands there.
    pub links: Vec<Link>,
}

/// One reference, resolved.
pub struct Link {
    /// As written.
    pub written: String,
    /// Where.
    pub place: Place,
    /// Index of the stage it names.
    pub target: usize,
    /// Index of the result.
    pub result: usize,
    /// Axes of which some values are meant.
    pub selections: Vec<(usize, Vec<u32>)>,
    /// Axes of the target that are collapsed.
    pub collapsed: Vec<usize>,
}

impl Link {
    /// The coordinates it names; an axis of which one value is picked is gone.
    fn relation(&self, target: &Relation) -> Relation {
        let restricted = self.selections.iter().fold(target.clone(), |relation, (axis, values)| relation.restricted(*axis, values));
        let picked: Vec<usize> = self.selections.iter().filter(|(_, values)| values.len() == 1).map(|(axis, _)| *axis).collect();
        restricted.without(&picked)
    }

    /// The axes that it shares with its user.
    pub fn kept_axes(&self, target: &Relation) -> Vec<usize> {
        let is_picked = |axis: &usize| self.selections.iter().any(|(selected, values)| selected == axis && values.len() == 1);
        target.axes.iter().filter(|axis| !is_picked(axis) && !self.collapsed.contains(axis)).copied().collect()
    }
}

/// Resolves all references and gives every stage its coordinates.
pub fn resolve(world: &World<'_, '_>, drafts: &[Option<Draft<'_>>], findings: &mut Findings) -> Resolved {
    let mut linker = Linker { world, indices: world.stage_indices(), findings };
    let mut ports: Vec<Option<Vec<Port>>> = Vec::with_capacity(drafts.len());
    for (stage, draft) in drafts.iter().enumerate() {
        ports.push(draft.as_ref().and_then(|draft| linker.ports(stage, draft)));
    }
    let order = order(world, &ports, findings);
    let mut stages: Vec<Option<Placed>> = drafts.iter().map(|_| None).collect();
    for stage in order.iter().copied() {
        if let (Some(draft), Some(ports)) = (&drafts[stage], ports[stage].take()) {
            stages[stage] = placed(world, &stages, stage, draft, ports, findings);
        }
    }
    check_count(world, &stages, findings);
    Resolved { order, stages }
}

struct Linker<'w, 'r, 'a> {
    world: &'w World<'r, 'a>,
    indices: HashMap<&'w str, usize>,
    findings: &'w mut Findings,
}

impl Linker<'_, '_, '_> {
    /// The ports of a stage; `None` if one of its references leads nowhere.
    fn ports(&mut self, stage: usize, draft: &Draft<'_>) -> Option<Vec<Port>> {
        let mut ports = Vec::new();
        let mut is_right = true;
        for field in &draft.roles {
            let (accepts, collects) = match &field.role {
                Role::Port(accepts) => (accepts, false),
                Role::Ports(accepts) => (accepts, true),
                Role::File | Role::Seed => continue,
            };
            if !matches!(draft.template.follow(&field.path), Some(Template::Fixed(_))) {
                let message = format!("{} names a stage; it may use parameters, not axes", quoted(&field.path.to_string()));
                let hint = Some("select a coordinate instead: `name[axis=value]`".to_owned());
                self.findings.add(Finding::error(field.node.place, message).in_stage(self.world.name(stage)).with_hint(hint));
                is_right = false;
                continue;
            }
            let mut links: Vec<Link> = Vec::new();
            for node in texts(&field.node) {
                // Anything but text was refused by the schema.
                let Some(text) = node.text() else {
                    is_right = false;
                    continue;
                };
                if links.iter().any(|link| link.written == text) {
                    self.error(stage, node, format!("{} stands twice in {}", quoted(text), quoted(&field.path.to_string())), None);
                    is_right = false;
                    continue;
                }
                match self.link(stage, text, node) {
                    Some(link) => links.push(link),
                    None => is_right = false,
                }
            }
            ports.push(Port { name: field.path.to_string(), accepts: accepts.clone(), collects, links });
        }
        is_right.then_some(ports)
    }

    fn error(&mut self, stage: usize, node: &Node, message: String, hint: Option<String>) {
        self.findings.add(Finding::error(node.place, message).in_stage(self.world.name(stage)).with_hint(hint));
    }

    fn link(&mut self, stage: usize, text: &str, node: &Node) -> Option<Link> {
        let reference = match Reference::parse(text) {
            Ok(reference) => reference,
            Err(message) => {
                self.error(stage, node, message, None);
                return None;
            }
        };
        let Some(target) = self.indices.get(reference.stage.as_str()).copied() else {
            let hint = did_you_mean(nearest(&reference.stage, self.world.document.stages.iter().map(|entry| entry.name.as_str())));
            self.error(stage, node, format!("there is no stage {}", quoted(&reference.stage)), hint);
            return None;
        };
        // A target of unknown kind was reported where it stands.
        let kind = self.world.document.stages[target].kind?;
        let result = match &reference.result {
            None => 0,
            Some(name) => match kind.results.iter().skip(1).position(|result| result.name == name) {
                Some(index) => index + 1,
                None => {
                    let names: Vec<&str> = kind.results.iter().skip(1).map(|result| result.name).collect();
                    let known: Vec<String> = names.iter().map(|name| format!("`{}.{name}`", reference.stage)).collect();
                    let known = if known.is_empty() {
                        "it has one result, which its bare name means".into()
                    } else {
                        format!("its further results are {}", listed(&known, "and"))
                    };
                    let hint = did_you_mean(nearest(name, names)).or(Some(known));
                    self.error(stage, node, format!("stage {} has no result {}", quoted(&reference.stage), quoted(name)), hint);
                    return None;
                }
            },
        };
        let selections: Result<Vec<_>, _> = reference.selections.iter().map(|selection| self.world.selected(selection)).collect();
        match selections {
            Ok(selections) => Some(Link { written: text.to_owned(), place: node.place, target, result, selections, collapsed: Vec::new() }),
            Err((message, hint)) => {
                self.error(stage, node, format!("{message}, selected in {}", quoted(text)), hint);
                None
            }
        }
    }
}

/// Inputs before their users, otherwise in the order of the file. Reports every cycle.
fn order(world: &World<'_, '_>, ports: &[Option<Vec<Port>>], findings: &mut Findings) -> Vec<usize> {
    #[derive(Clone, Copy, PartialEq)]
    enum Color {
        White,
        Gray,
        Black,
    }
    let links: Vec<Vec<(usize, Place)>> = ports
        .iter()
        .map(|ports| ports.iter().flatten().flat_map(|port| &port.links).map(|link| (link.target, link.place)).collect())
        .collect();
    let mut color = vec![Color::White; links.len()];
    let mut on_cycle = vec![false; links.len()];
    let mut order = Vec::with_capacity(links.len());
    for start in 0..links.len() {
        if color[start] != Color::White {
            continue;
        }
        color[start] = Color::Gray;
        let mut path: Vec<(usize, usize)> = vec![(start, 0)];
        while let Some((stage, next)) = path.last_mut() {
            let stage = *stage;
            let Some((target, place)) = links[stage].get(*next).copied() else {
                color[stage] = Color::Black;
                order.push(stage);
                path.pop();
                continue;
            };
            *next += 1;
            match color[target] {
                Color::White => {
                    color[target] = Color::Gray;
                    path.push((target, 0));
                }
                Color::Gray => {
                    let cycle: Vec<usize> = path.iter().map(|(stage, _)| *stage).skip_while(|stage| *stage != target).collect();
                    cycle.iter().for_each(|stage| on_cycle[*stage] = true);
                    report_cycle(world, &cycle, place, findings);
                }
                Color::Black => {}
            }
        }
    }
    order.retain(|stage| !on_cycle[*stage]);
    order
}

/// Most stages of a cycle that are shown.
const CYCLE_SHOWN: usize = 12;

fn report_cycle(world: &World<'_, '_>, cycle: &[usize], place: Place, findings: &mut Findings) {
    let last = *cycle.last().expect("a cycle has a stage");
    let mut names: Vec<String> = cycle.iter().map(|stage| quoted(world.name(*stage))).collect();
    names.push(names[0].clone());
    if names.len() > CYCLE_SHOWN {
        let left_out = names.len() - CYCLE_SHOWN + 1;
        names.splice(CYCLE_SHOWN / 2..names.len() - CYCLE_SHOWN / 2 + 1, [format!("({left_out} more)")]);
    }
    let message = match cycle {
        [_] => "a cycle: the stage needs itself".to_owned(),
        _ => format!("a cycle: {}, each of which needs the next", names.join(" -> ")),
    };
    findings.add(Finding::error(place, message).in_stage(world.name(last)));
}

/// The coordinates of a stage whose inputs are placed.
fn placed(
    world: &World<'_, '_>,
    stages: &[Option<Placed>],
    stage: usize,
    draft: &Draft<'_>,
    mut ports: Vec<Port>,
    findings: &mut Findings,
) -> Option<Placed> {
    let name = world.name(stage);
    let mut plain: Vec<Relation> = Vec::new();
    let mut collected: Vec<Relation> = Vec::new();
    let error_count = findings.error_count();
    for port in &ports {
        for link in &port.links {
            let target = &stages[link.target].as_ref()?.relation;
            match linked(world, link, target) {
                Ok(relation) if port.collects => collected.push(relation),
                Ok(relation) => plain.push(relation),
                Err((message, hint)) => findings.add(Finding::error(link.place, message).in_stage(name).with_hint(hint)),
            }
        }
    }
    if findings.error_count() > error_count {
        return None;
    }
    let axes_of =
        |relations: &[Relation]| -> BTreeSet<usize> { relations.iter().flat_map(|relation| relation.axes.iter().copied()).collect() };
    let collected_axes = axes_of(&collected);
    let mut fixed_axes = axes_of(&plain);
    fixed_axes.extend(&draft.own_axes);
    let has_collecting_port = ports.iter().any(|port| port.collects);
    let collapsed = match draft.template.follow(&crate::engine::schema::FieldPath::parse("over")) {
        Some(over) if has_collecting_port => over_axes(world, name, &over, &collected_axes, &fixed_axes, findings)?,
        _ => collected_axes.difference(&fixed_axes).copied().collect(),
    };
    for link in ports.iter_mut().filter(|port| port.collects).flat_map(|port| &mut port.links) {
        let target = &stages[link.target].as_ref()?.relation;
        link.collapsed = collapsed.iter().filter(|axis| target.axes.contains(axis)).copied().collect();
    }
    let own = draft.own_axes.iter().map(|axis| Relation::of_axis(*axis, world.axes[*axis].values.len()));
    let parts = plain.into_iter().chain(collected.iter().map(|relation| relation.without(&collapsed))).chain(own);
    let limit = listing_limit(world);
    let entry = &world.document.stages[stage];
    let joined = parts.into_iter().try_fold(Relation::unit(), |joined, part| joined.joined(&part, limit));
    let too_many = |findings: &mut Findings, TooMany(count): TooMany| {
        let count = count.map_or_else(|| format!("more than {limit}"), |count| count.to_string());
        let message = format!("has {count} coordinates before `exclude`, over the limit of {limit}");
        findings.add(Finding::error(entry.place, message).in_stage(name));
    };
    let joined = joined.map_err(|error| too_many(findings, error)).ok()?;
    let exclusions = match &entry.exclude {
        Some(node) => exclusions(world, name, node, &joined, findings)?,
        None => Vec::new(),
    };
    let relation = joined.excluding(&exclusions, limit).map_err(|error| too_many(findings, error)).ok()?;
    if relation.count() == Some(0) && joined.count() != Some(0) {
        let place = entry.exclude.as_ref().map_or(entry.place, |node| node.place);
        findings.add(Finding::warning(place, "`exclude` leaves nothing of this stage: it has no jobs").in_stage(name));
    } else if joined.count() == Some(0) && stages_have_coordinates(&ports, stages) {
        findings.add(Finding::warning(entry.place, "its inputs have no coordinate in common: it has no jobs").in_stage(name));
    }
    Some(Placed { ports, relation })
}

fn stages_have_coordinates(ports: &[Port], stages: &[Option<Placed>]) -> bool {
    let targets = ports.iter().flat_map(|port| &port.links).filter_map(|link| stages[link.target].as_ref());
    targets.into_iter().all(|placed| placed.relation.count() != Some(0))
}

/// Coordinates that may be listed before `exclude` drops most of them.
fn listing_limit(world: &World<'_, '_>) -> u64 {
    world.limit.saturating_mul(10).max(1_000_000)
}

fn linked(world: &World<'_, '_>, link: &Link, target: &Relation) -> Result<Relation, (String, Option<String>)> {
    let name = quoted(world.name(link.target));
    for (axis, _) in &link.selections {
        if !target.axes.contains(axis) {
            let names: Vec<String> = target.axes.iter().map(|axis| quoted(&world.axes[*axis].name)).collect();
            let hint = if names.is_empty() { "it has no axes".to_owned() } else { format!("its axes are {}", listed(&names, "and")) };
            return Err((
                format!("stage {name} has no axis {}, selected in {}", quoted(&world.axes[*axis].name), quoted(&link.written)),
                Some(hint),
            ));
        }
    }
    let relation = link.relation(target);
    if relation.count() == Some(0) && target.count() != Some(0) {
        return Err((format!("{} selects nothing: those coordinates of stage {name} are excluded", quoted(&link.written)), None));
    }
    Ok(relation)
}

/// The axes that `over:` names.
fn over_axes(
    world: &World<'_, '_>,
    name: &str,
    over: &Template,
    collected: &BTreeSet<usize>,
    fixed: &BTreeSet<usize>,
    findings: &mut Findings,
) -> Option<Vec<usize>> {
    let Template::Fixed(node) = over else {
        let place = over.at(&world.axes, &|_| 0).place;
        findings.add(Finding::error(place, "`over` names axes; it may use parameters, not values of axes").in_stage(name));
        return None;
    };
    let mut axes: Vec<usize> = Vec::new();
    let error_count = findings.error_count();
    for item in texts(node) {
        let text = item.text()?;
        let wrong = match world.axis_index(text) {
            Err(wrong) => Some(wrong),
            Ok(axis) if axes.contains(&axis) => Some((format!("axis {} stands twice in `over`", quoted(text)), None)),
            Ok(axis) if !collected.contains(&axis) => {
                let names: Vec<String> = collected.iter().map(|axis| quoted(&world.axes[*axis].name)).collect();
                let hint = if names.is_empty() { "it has no axes".to_owned() } else { format!("its axes are {}", listed(&names, "and")) };
                Some((format!("`over`: what is collected has no axis {}", quoted(text)), Some(hint)))
            }
            Ok(axis) if fixed.contains(&axis) => {
                Some((format!("`over`: axis {} cannot be collapsed, for this stage depends on it otherwise", quoted(text)), None))
            }
            Ok(axis) => {
                axes.push(axis);
                None
            }
        };
        if let Some((message, hint)) = wrong {
            findings.add(Finding::error(item.place, message).in_stage(name).with_hint(hint));
        }
    }
    (findings.error_count() == error_count).then_some(axes)
}

type Exclusion = Vec<(usize, Vec<u32>)>;

/// `exclude: [{ n: 64 }, { n: [64, 256], gamma: 1 }]`.
fn exclusions(world: &World<'_, '_>, name: &str, node: &Node, relation: &Relation, findings: &mut Findings) -> Option<Vec<Exclusion>> {
    let Value::List(items) = &node.value else {
        let hint = Some("write `exclude: [{ axis: value }]`".to_owned());
        findings.add(
            Finding::error(node.place, format!("`exclude` must be a list of maps, found {}", node.described()))
                .in_stage(name)
                .with_hint(hint),
        );
        return None;
    };
    let error_count = findings.error_count();
    let mut exclusions = Vec::new();
    for item in items.iter() {
        let Some(entries) = item.map().filter(|entries| !entries.is_empty()) else {
            let found = if item.map().is_some() { "an empty map".to_owned() } else { item.described() };
            let message = format!("`exclude` takes maps from axes to values, found {found}");
            findings.add(Finding::error(item.place, message).in_stage(name));
            continue;
        };
        let mut exclusion = Vec::new();
        for entry in entries.iter() {
            match excluded_values(world, &entry.key, entry.place, &entry.node, relation) {
                Ok(values) => exclusion.push(values),
                Err((place, message, hint)) => {
                    findings.add(Finding::error(place, format!("`exclude`: {message}")).in_stage(name).with_hint(hint))
                }
            }
        }
        exclusions.push(exclusion);
    }
    (findings.error_count() == error_count).then_some(exclusions)
}

type Wrong = (Place, String, Option<String>);

fn excluded_values(world: &World<'_, '_>, key: &str, place: Place, node: &Node, relation: &Relation) -> Result<(usize, Vec<u32>), Wrong> {
    let axis = world.axis_index(key).map_err(|(message, hint)| (place, message, hint))?;
    if !relation.axes.contains(&axis) {
        let names: Vec<String> = relation.axes.iter().map(|axis| quoted(&world.axes[*axis].name)).collect();
        let hint = if names.is_empty() { "it has no axes".to_owned() } else { format!("its axes are {}", listed(&names, "and")) };
        return Err((place, format!("the stage has no axis {}", quoted(key)), Some(hint)));
    }
    let value = |item: &Node| match crate::engine::axes::scalar_of(item) {
        Some(scalar) => world.value_index(axis, &scalar.to_string()).map_err(|(message, hint)| (item.place, message, hint)),
        None => Err((item.place, format!("axis {} has no value that is {}", quoted(key), item.described()), None)),
    };
    if node.list().is_some_and(|items| items.is_empty()) {
        return Err((node.place, format!("axis {} is given no values", quoted(key)), None));
    }
    Ok((axis, texts(node).into_iter().map(value).collect::<Result<_, _>>()?))
}

/// The number of jobs against the limit, before anything is expanded.
fn check_count(world: &World<'_, '_>, stages: &[Option<Placed>], findings: &mut Findings) {
    let with_parts =
        |stage: usize, count: u128| count.checked_mul(world.document.stages[stage].split.map_or(1, |parts| 1 + u128::from(parts.get())));
    let count = |(stage, placed): (usize, &Option<Placed>)| {
        Some((stage, placed.as_ref()?.relation.count().and_then(|count| with_parts(stage, count))))
    };
    let counts = || stages.iter().enumerate().filter_map(count);
    let total = counts().try_fold(0_u128, |sum, (_, count)| sum.checked_add(count?));
    if total.is_some_and(|total| total <= u128::from(world.limit)) {
        return;
    }
    let total = total.map_or_else(|| "more than 2^128".to_owned(), |total| total.to_string());
    let Some((largest, count)) = counts().max_by_key(|(_, count)| count.unwrap_or(u128::MAX)) else { return };
    let count = count.map_or_else(|| "more than 2^128".to_owned(), |count| count.to_string());
    let message = format!("the pipeline has {total} jobs, over the limit of {}; {count} of them are of this stage", world.limit);
    let axes: Vec<String> =
        stages[largest].iter().flat_map(|placed| &placed.relation.axes).take(8).map(|axis| quoted(&world.axes[*axis].name)).collect();
    let hint = format!("its axes are {}; `--max-jobs N` allows more jobs", listed(&axes, "and"));
    findings.add(Finding::error(world.document.stages[largest].place, message).in_stage(world.name(largest)).with_hint(Some(hint)));
}

//! What flows along the references: the type of every result, decided by kinds and users together.

use super::World;
use super::draft::Draft;
use super::resolve::{Link, Placed, Port, Resolved};
use crate::engine::artifact::TypeName;
use crate::engine::diagnostic::{listed, quoted};
use crate::engine::document::StageEntry;
use crate::engine::save::{self, Save};
use crate::engine::source::{Finding, Findings};
use crate::engine::stage::InputTypes;

/// What is known of a stage once its results have types.
pub struct Typed {
    /// Name (empty for the first) and type of each result.
    pub results: Vec<(&'static str, TypeName)>,
    /// Whether its users decided between several types of the first result.
    pub is_decided: bool,
    /// What it publishes.
    pub saves: Vec<Save>,
}

/// Someone who takes a result.
struct User<'a> {
    stage: usize,
    port: &'a Port,
    link: &'a Link,
}

/// Decides the types, in the order of the stages. `None` where something is wrong.
pub fn decide(world: &World<'_, '_>, drafts: &[Option<Draft<'_>>], resolved: &Resolved, findings: &mut Findings) -> Vec<Option<Typed>> {
    let users = users(resolved);
    let wanted = wanted(world, drafts, resolved, &users);
    let mut typed: Vec<Option<Typed>> = drafts.iter().map(|_| None).collect();
    for stage in resolved.order.iter().copied() {
        if let (Some(draft), Some(placed)) = (&drafts[stage], &resolved.stages[stage]) {
            typed[stage] =
                typed_stage(world, stage, draft, placed, Wishes { users: &users[stage], wanted: &wanted[stage] }, &typed, findings);
        }
    }
    typed
}

fn users(resolved: &Resolved) -> Vec<Vec<User<'_>>> {
    let mut users: Vec<Vec<User<'_>>> = resolved.stages.iter().map(|_| Vec::new()).collect();
    for (stage, placed) in resolved.stages.iter().enumerate() {
        for port in placed.iter().flat_map(|placed| &placed.ports) {
            for link in &port.links {
                users[link.target].push(User { stage, port, link });
            }
        }
    }
    users
}

/// What the users of a stage ask of its results.
#[derive(Clone, Copy)]
struct Wishes<'a> {
    users: &'a [User<'a>],
    /// By result: the types with which all users can do their work; `None` if there are no users.
    wanted: &'a [Option<Vec<TypeName>>],
}

/// By stage and result, the types with which all users, and the users of what they make of it, can work.
///
/// So `load` gives an image where a stage between passes on what it takes and an image is asked of that.
fn wanted(
    world: &World<'_, '_>,
    drafts: &[Option<Draft<'_>>],
    resolved: &Resolved,
    users: &[Vec<User<'_>>],
) -> Vec<Vec<Option<Vec<TypeName>>>> {
    let result_count = |stage: usize| world.document.stages[stage].kind.map_or(0, |kind| kind.results.len());
    let mut wanted: Vec<Vec<Option<Vec<TypeName>>>> = (0..drafts.len()).map(|stage| vec![None; result_count(stage)]).collect();
    for stage in resolved.order.iter().rev().copied() {
        for user in &users[stage] {
            let works = |type_name: &TypeName| {
                user.port.accepts.iter().any(|accepted| accepted == type_name)
                    && works_with(&drafts[user.stage], &resolved.stages[user.stage], user.port, type_name, &wanted[user.stage])
            };
            let before = &wanted[stage][user.link.result];
            let types: Vec<TypeName> = match before {
                Some(types) => types.iter().copied().filter(works).collect(),
                None => world.registry.artifacts().names().filter(works).collect(),
            };
            wanted[stage][user.link.result] = Some(types);
        }
    }
    wanted
}

/// Whether a stage with this type on that port gives what its own users want.
fn works_with(
    draft: &Option<Draft<'_>>,
    placed: &Option<Placed>,
    port: &Port,
    type_name: TypeName,
    wanted: &[Option<Vec<TypeName>>],
) -> bool {
    let (Some(Some(instance)), Some(placed), false) = (draft.as_ref().map(|draft| &draft.instance), placed, port.collects) else {
        return true;
    };
    // The kinds whose results follow an input follow a single one; what stands on the others does not matter.
    let inputs: InputTypes = placed.ports.iter().filter(|port| !port.collects).map(|other| (other.name.clone(), type_name)).collect();
    let candidates = instance.result_types(&inputs);
    candidates.iter().zip(wanted).all(|(types, wanted)| wanted.as_ref().is_none_or(|wanted| types.iter().any(|one| wanted.contains(one))))
}

/// The types of what stands on the single ports; `None` if one is not known.
pub fn input_types(ports: &[Port], typed: &[Option<Typed>]) -> Option<InputTypes> {
    let single = ports.iter().filter(|port| !port.collects).flat_map(|port| port.links.iter().map(move |link| (port, link)));
    single.map(|(port, link)| Some((port.name.clone(), typed[link.target].as_ref()?.results[link.result].1))).collect()
}

fn typed_stage(
    world: &World<'_, '_>,
    stage: usize,
    draft: &Draft<'_>,
    placed: &Placed,
    wishes: Wishes<'_>,
    typed: &[Option<Typed>],
    findings: &mut Findings,
) -> Option<Typed> {
    let name = world.name(stage);
    let inputs = input_types(&placed.ports, typed)?;
    // A stage with mistakes still has the types that its kind declares, so that its users can be checked.
    let declared = || draft.kind.results.iter().map(|result| result.types.to_vec()).collect();
    let candidates: Vec<Vec<TypeName>> = draft.instance.as_ref().map_or_else(declared, |instance| instance.result_types(&inputs));
    let is_decided = candidates.first().is_some_and(|types| types.len() > 1);
    let mut results = Vec::new();
    for (index, declaration) in draft.kind.results.iter().enumerate() {
        let types = candidates.get(index).filter(|types| !types.is_empty()).map_or(declaration.types, Vec::as_slice);
        let users: Vec<&User<'_>> = wishes.users.iter().filter(|user| user.link.result == index).collect();
        let meets_wishes = |candidate: &&TypeName| wishes.wanted[index].as_ref().is_none_or(|wanted| wanted.contains(candidate));
        let type_name = match types.iter().find(meets_wishes) {
            Some(type_name) => type_name,
            None => decided(world, stage, draft, types, &users, findings),
        };
        results.push((declaration.name, type_name));
    }
    check_columns(world, stage, draft, placed, findings);
    let saves = match &world.document.stages[stage].save {
        Some(node) => save::read(node, &results, world.registry, name, findings),
        None => Vec::new(),
    };
    Some(Typed { results, is_decided, saves })
}

/// The first candidate that all users take; where there is none, each user at fault is reported.
fn decided(
    world: &World<'_, '_>,
    stage: usize,
    draft: &Draft<'_>,
    candidates: &[TypeName],
    users: &[&User<'_>],
    findings: &mut Findings,
) -> TypeName {
    let takes = |user: &User<'_>, candidate: TypeName| user.port.accepts.iter().any(|accepted| accepted == candidate);
    if let Some(common) = candidates.iter().find(|candidate| users.iter().all(|user| takes(user, candidate))) {
        return common;
    }
    let at_fault: Vec<&&User<'_>> = users.iter().filter(|user| !candidates.iter().any(|candidate| takes(user, candidate))).collect();
    for user in &at_fault {
        let user_kind = world.document.stages[user.stage].kind.map_or("", |kind| kind.name);
        let message = format!(
            "{} of `{user_kind}` takes {}, but {} gives {}",
            quoted(&user.port.name),
            listed(&user.port.accepts, "or"),
            quoted(&user.link.written),
            listed(candidates, "or")
        );
        let hint = stand_in(world, stage, user);
        findings.add(Finding::error(user.link.place, message).in_stage(world.name(user.stage)).with_hint(hint));
    }
    if let ([], Some(first), Some(_)) = (&at_fault[..], users.first(), &draft.instance) {
        let wanted: Vec<String> =
            users.iter().map(|user| format!("{} takes {}", quoted(world.name(user.stage)), listed(&user.port.accepts, "or"))).collect();
        let message = format!("the users of {} cannot agree on its type: {}", quoted(world.name(stage)), listed(&wanted, "and"));
        let hint = Some(format!("let each kind of user have its own `{}` stage", draft.kind.name));
        findings.add(Finding::error(first.link.place, message).in_stage(world.name(first.stage)).with_hint(hint));
    }
    candidates[0]
}

/// A stage that gives what a port takes, first among those that come from the one that stands there.
fn stand_in(world: &World<'_, '_>, stage: usize, user: &User<'_>) -> Option<String> {
    let entries = &world.document.stages;
    let gives = |entry: &&StageEntry<'_>| {
        let types = entry.kind.and_then(|kind| kind.results.first()).map_or(&[][..], |result| result.types);
        types.iter().any(|name| user.port.accepts.iter().any(|accepted| accepted == name))
    };
    let comes_from_it = |entry: &&StageEntry<'_>| {
        let fields = entry.parameters.map().map(|fields| &fields[..]).unwrap_or_default();
        fields.iter().any(|field| field.node.text() == Some(world.name(stage)))
    };
    let others = || entries.iter().filter(|entry| entry.name != world.name(user.stage)).filter(gives);
    let entry = others().find(comes_from_it)?;
    Some(format!("did you mean {}, line {}? it gives {}", quoted(&entry.name), entry.place.line, listed(&user.port.accepts, "or")))
}

/// A collapsed axis that a figure uses nowhere would lay its values over each other unseen.
fn check_columns(world: &World<'_, '_>, stage: usize, draft: &Draft<'_>, placed: &Placed, findings: &mut Findings) {
    let Some(used) = draft.instance.as_ref().and_then(|instance| instance.axes_used()) else { return };
    for port in placed.ports.iter().filter(|port| port.collects) {
        for (link, axis) in port.links.iter().flat_map(|link| link.collapsed.iter().map(move |axis| (link, *axis))) {
            let axis = &world.axes[axis].name;
            if used.iter().any(|column| column == axis || column.strip_prefix(axis.as_str()).is_some_and(|rest| rest.starts_with('.'))) {
                continue;
            }
            let columns: Vec<String> = used.iter().map(|column| quoted(column)).collect();
            let shown = if columns.is_empty() { "it names none".to_owned() } else { format!("it names {}", listed(&columns, "and")) };
            let message = format!(
                "axis {} of {} is collapsed, but `{}` uses it nowhere ({shown})",
                quoted(axis),
                quoted(&link.written),
                draft.kind.name
            );
            let hint = Some(format!("use it, select one of its values, or leave it out of `over` to get one result per value of `{axis}`"));
            findings.add(Finding::error(link.place, message).in_stage(world.name(stage)).with_hint(hint));
        }
    }
}

//! Substitution: `$x` alone keeps the value's type, `${x}` stands inside text, `$$` is a dollar.
//!
//! Parameters are put in once; what an axis decides remains open in a [`Template`] and is put in for
//! each job. No arithmetic, no code, no environment.

use std::collections::{BTreeSet, HashMap};
use std::sync::Arc;

use super::axes::{Axis, scalar_of};
use super::diagnostic::{listed, quoted};
use super::schema::{FieldPath, Step};
use super::source::{Finding, Findings, Place, did_you_mean};
use super::yaml::{Entry, Node, Value, entry};
use crate::catalogue::nearest;

/// The names that a parameter may mention.
pub struct Scope<'a> {
    params: &'a [Entry],
    axes: &'a [Axis],
    names: HashMap<&'a str, Variable>,
}

#[derive(Clone, Copy)]
enum Variable {
    Parameter(usize),
    Axis(usize),
}

impl<'a> Scope<'a> {
    /// A scope of parameters and axes.
    pub fn new(params: &'a [Entry], axes: &'a [Axis]) -> Self {
        let parameters = params.iter().enumerate().map(|(index, entry)| (&*entry.key, Variable::Parameter(index)));
        let named_axes = axes.iter().enumerate().map(|(index, axis)| (axis.name.as_str(), Variable::Axis(index)));
        Self { params, axes, names: parameters.chain(named_axes).collect() }
    }

    /// The axes, in order of declaration.
    pub fn axes(&self) -> &'a [Axis] {
        self.axes
    }

    fn nearest(&self, word: &str) -> Option<&'a str> {
        let params = self.params.iter().map(|entry| &*entry.key);
        nearest(word, params.chain(self.axes.iter().map(|axis| axis.name.as_str())))
    }
}

/// A parameter value in which axes are still open.
#[derive(Debug, Clone)]
pub enum Template {
    /// No axis in it.
    Fixed(Node),
    /// An axis alone, or one field of it.
    Axis {
        /// Index of the axis.
        axis: usize,
        /// Field of a map-valued axis.
        field: Option<Arc<str>>,
        /// As written: `$look.gamma`.
        written: Arc<str>,
        /// Where it stands.
        place: Place,
    },
    /// Text with axes inside.
    Text(Vec<Piece>, Place),
    /// A list with axes inside.
    List(Vec<Template>, Place),
    /// A map with axes inside.
    Map(Vec<(Arc<str>, Place, Template)>, Place),
}

/// A part of a text.
#[derive(Debug, Clone)]
pub enum Piece {
    /// As it is.
    Literal(String),
    /// The value of an axis, or of one field of it.
    Axis(usize, Option<Arc<str>>),
}

impl Template {
    /// The value at a coordinate; `index_of` gives the index of the value on an axis.
    pub fn at(&self, axes: &[Axis], index_of: &dyn Fn(usize) -> usize) -> Node {
        match self {
            Template::Fixed(node) => node.clone(),
            Template::Axis { axis, field, written, .. } => {
                let value = axis_node(&axes[*axis], index_of(*axis), field.as_deref());
                Node { via: Some(written.clone()), ..value }
            }
            Template::Text(pieces, place) => {
                let texts = pieces.iter().map(|piece| match piece {
                    Piece::Literal(text) => text.clone(),
                    Piece::Axis(axis, field) => text_of(&axis_node(&axes[*axis], index_of(*axis), field.as_deref())).unwrap_or_default(),
                });
                Node::new(Value::Text(texts.collect::<String>().into()), *place)
            }
            Template::List(items, place) => Node::new(Value::List(items.iter().map(|item| item.at(axes, index_of)).collect()), *place),
            Template::Map(entries, place) => {
                let entries = entries.iter().map(|(key, place, template)| Entry {
                    key: key.clone(),
                    place: *place,
                    node: template.at(axes, index_of),
                });
                Node::new(Value::Map(entries.collect()), *place)
            }
        }
    }

    /// Adds the axes that are mentioned.
    pub fn add_axes(&self, found: &mut BTreeSet<usize>) {
        match self {
            Template::Fixed(_) => {}
            Template::Axis { axis, .. } => {
                found.insert(*axis);
            }
            Template::Text(pieces, _) => found.extend(pieces.iter().filter_map(|piece| match piece {
                Piece::Axis(axis, _) => Some(*axis),
                Piece::Literal(_) => None,
            })),
            Template::List(items, _) => items.iter().for_each(|item| item.add_axes(found)),
            Template::Map(entries, _) => entries.iter().for_each(|(_, _, template)| template.add_axes(found)),
        }
    }

    /// The template that a path leads to.
    pub fn follow(&self, path: &FieldPath) -> Option<Template> {
        path.0.iter().try_fold(self.clone(), |template, step| match (step, &template) {
            (Step::Field(key), Template::Fixed(node)) => entry(node.map()?, key).map(|entry| Template::Fixed(entry.node.clone())),
            (Step::Field(key), Template::Map(entries, _)) => {
                entries.iter().find(|(name, _, _)| **name == **key).map(|(_, _, template)| template.clone())
            }
            (Step::Item(index), Template::Fixed(node)) => node.list()?.get(*index).cloned().map(Template::Fixed),
            (Step::Item(index), Template::List(items, _)) => items.get(*index).cloned(),
            _ => None,
        })
    }
}

/// The coordinate of a value, or one of its fields.
fn axis_node(axis: &Axis, index: usize, field: Option<&str>) -> Node {
    let value = &axis.values[index];
    match field {
        Some(field) => value.node.map().and_then(|entries| entry(entries, field)).expect("the field was checked").node.clone(),
        None if value.node.map().is_some() => {
            let value_of_name = match &value.scalar {
                super::coordinate::Scalar::Integer(number) => Value::Integer(*number),
                super::coordinate::Scalar::Number(number) => Value::Number(*number),
                super::coordinate::Scalar::Boolean(truth) => Value::Boolean(*truth),
                super::coordinate::Scalar::Text(text) => Value::Text(text.as_str().into()),
            };
            Node::new(value_of_name, value.node.place)
        }
        None => value.node.clone(),
    }
}

fn text_of(node: &Node) -> Option<String> {
    scalar_of(node).map(|scalar| scalar.to_string())
}

/// Puts the parameters of the scope into a value.
pub fn substitute(node: &Node, scope: &Scope<'_>, stage: &str, findings: &mut Findings) -> Template {
    match &node.value {
        Value::Text(text) if text.contains('$') => match substituted_text(text, node.place, scope) {
            Ok(template) => template,
            Err((message, hint)) => {
                findings.add(Finding::error(node.place, message).in_stage(stage).with_hint(hint));
                Template::Fixed(Node::new(Value::Null, node.place))
            }
        },
        Value::List(items) => {
            let items: Vec<Template> = items.iter().map(|item| substitute(item, scope, stage, findings)).collect();
            fixed_list(&items, node).unwrap_or(Template::List(items, node.place))
        }
        Value::Map(entries) => {
            let substituted =
                |entry: &Entry, findings: &mut Findings| (entry.key.clone(), entry.place, substitute(&entry.node, scope, stage, findings));
            let entries: Vec<_> = entries.iter().map(|entry| substituted(entry, findings)).collect();
            fixed_map(&entries, node).unwrap_or(Template::Map(entries, node.place))
        }
        _ => Template::Fixed(node.clone()),
    }
}

fn fixed_list(items: &[Template], node: &Node) -> Option<Template> {
    let nodes: Option<Arc<[Node]>> = items.iter().map(fixed).collect();
    nodes.map(|nodes| Template::Fixed(Node { value: Value::List(nodes), ..node.clone() }))
}

fn fixed_map(entries: &[(Arc<str>, Place, Template)], node: &Node) -> Option<Template> {
    let nodes: Option<Arc<[Entry]>> =
        entries.iter().map(|(key, place, template)| Some(Entry { key: key.clone(), place: *place, node: fixed(template)? })).collect();
    nodes.map(|nodes| Template::Fixed(Node { value: Value::Map(nodes), ..node.clone() }))
}

fn fixed(template: &Template) -> Option<Node> {
    match template {
        Template::Fixed(node) => Some(node.clone()),
        _ => None,
    }
}

/// A message and a hint.
type Wrong = (String, Option<String>);

fn substituted_text(text: &str, place: Place, scope: &Scope<'_>) -> Result<Template, Wrong> {
    if let Some(name) = text.strip_prefix('$').filter(|name| is_path(name)) {
        return whole_value(name, text, place, scope);
    }
    let mut pieces = Vec::new();
    for part in parts(text)? {
        match part {
            Part::Literal(literal) => push_literal(&mut pieces, &literal),
            Part::Variable(name) => match found(name, scope)? {
                Found::Value(node) => push_literal(&mut pieces, &inserted(name, &node)?),
                Found::Axis(axis, field) => {
                    for index in 0..scope.axes[axis].values.len() {
                        inserted(name, &axis_node(&scope.axes[axis], index, field.as_deref()))?;
                    }
                    pieces.push(Piece::Axis(axis, field));
                }
            },
        }
    }
    match &pieces[..] {
        [] => Ok(Template::Fixed(Node::new(Value::Text("".into()), place))),
        [Piece::Literal(only)] => Ok(Template::Fixed(Node::new(Value::Text(only.as_str().into()), place))),
        _ => Ok(Template::Text(pieces, place)),
    }
}

fn push_literal(pieces: &mut Vec<Piece>, text: &str) {
    match pieces.last_mut() {
        Some(Piece::Literal(before)) => before.push_str(text),
        _ => pieces.push(Piece::Literal(text.to_owned())),
    }
}

fn inserted(name: &str, node: &Node) -> Result<String, Wrong> {
    text_of(node).ok_or_else(|| (format!("`${{{name}}}` is {}, which has no place inside text", node.described()), None))
}

fn whole_value(name: &str, written: &str, place: Place, scope: &Scope<'_>) -> Result<Template, Wrong> {
    Ok(match found(name, scope)? {
        Found::Value(node) => Template::Fixed(Node { via: Some(written.into()), ..node }),
        Found::Axis(axis, field) => Template::Axis { axis, field, written: written.into(), place },
    })
}

enum Found {
    Value(Node),
    Axis(usize, Option<Arc<str>>),
}

fn found(path: &str, scope: &Scope<'_>) -> Result<Found, Wrong> {
    let mut fields = path.split('.');
    let name = fields.next().unwrap_or_default();
    match scope.names.get(name) {
        None => {
            let hint = did_you_mean(scope.nearest(name))
                .or_else(|| Some("declare it under `params` or `axes`, or write `$$` for a dollar".into()));
            Err((format!("unknown name {}: no parameter and no axis is called that", quoted(&format!("${name}"))), hint))
        }
        Some(Variable::Parameter(index)) => {
            fields.try_fold(scope.params[*index].node.clone(), |node, field| field_of(&node, field, path)).map(Found::Value)
        }
        Some(Variable::Axis(index)) => axis_field(&scope.axes[*index], *index, fields.collect(), path),
    }
}

fn axis_field(axis: &Axis, index: usize, fields: Vec<&str>, path: &str) -> Result<Found, Wrong> {
    match &fields[..] {
        [] => Ok(Found::Axis(index, None)),
        [field] => {
            for value in &axis.values {
                field_of(&value.node, field, path)?;
            }
            Ok(Found::Axis(index, Some((*field).into())))
        }
        [_, deeper, ..] => Err((format!("`${path}`: field {} is deeper than an axis goes", quoted(deeper)), None)),
    }
}

fn field_of(node: &Node, field: &str, path: &str) -> Result<Node, Wrong> {
    let written = quoted(&format!("${path}"));
    let Some(entries) = node.map() else {
        return Err((format!("{written} asks for field {} of {}, which is no map", quoted(field), node.described()), None));
    };
    entry(entries, field).map(|entry| entry.node.clone()).ok_or_else(|| {
        let names: Vec<String> = entries.iter().map(|entry| quoted(&entry.key)).collect();
        let hint = did_you_mean(nearest(field, entries.iter().map(|entry| &*entry.key)));
        let known = (!names.is_empty()).then(|| format!("its fields are {}", listed(&names, "and")));
        (format!("{written}: there is no field {}", quoted(field)), hint.or(known))
    })
}

/// Whether a word may be the name of a parameter or an axis.
pub fn is_name(word: &str) -> bool {
    word.len() <= 64
        && word.starts_with(|first: char| first.is_ascii_alphabetic() || first == '_')
        && word.bytes().all(|byte| byte.is_ascii_alphanumeric() || byte == b'_' || byte == b'-')
}

fn is_path(word: &str) -> bool {
    word.split('.').enumerate().all(|(index, part)| if index == 0 { is_name(part) } else { is_field(part) })
}

fn is_field(word: &str) -> bool {
    !word.is_empty() && word.bytes().all(|byte| byte.is_ascii_alphanumeric() || byte == b'_' || byte == b'-')
}

enum Part<'t> {
    Literal(String),
    Variable(&'t str),
}

/// A text in its parts: literals and `${name}`.
fn parts(text: &str) -> Result<Vec<Part<'_>>, Wrong> {
    let mut parts = Vec::new();
    let mut rest = text;
    while let Some(index) = rest.find('$') {
        parts.push(Part::Literal(rest[..index].to_owned()));
        let after = &rest[index + 1..];
        if let Some(after) = after.strip_prefix('$') {
            parts.push(Part::Literal("$".into()));
            rest = after;
        } else if let Some(after) = after.strip_prefix('{') {
            let Some(end) = after.find('}') else {
                return Err((format!("`${{` without `}}` in {}", quoted(text)), Some("write `$$` for a dollar".into())));
            };
            let name = &after[..end];
            if !is_path(name) {
                let message = format!("{} is no name of a parameter or an axis", quoted(&format!("${{{name}}}")));
                return Err((message, Some("a name has letters, digits, `_` and `-`; there is no arithmetic and no code".into())));
            }
            parts.push(Part::Variable(name));
            rest = &after[end + 1..];
        } else {
            return Err((format!("a lone `$` in {}", quoted(text)), Some(lone_dollar_hint(after))));
        }
    }
    parts.push(Part::Literal(rest.to_owned()));
    Ok(parts)
}

fn lone_dollar_hint(after: &str) -> String {
    let name: String = after.chars().take_while(|c| c.is_ascii_alphanumeric() || *c == '_').collect();
    if is_name(&name) { format!("inside text write `${{{name}}}`; `$$` is a dollar") } else { "write `$$` for a dollar".to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn described(params: &str, text: &str) -> Result<String, String> {
        let mut findings = Findings::default();
        let params = crate::engine::yaml::parse(0, params, &mut findings).unwrap();
        let entries = params.map().unwrap().clone();
        substituted_text(text, Place::default(), &Scope::new(&entries, &[]))
            .map(|template| fixed(&template).unwrap().described())
            .map_err(|(message, hint)| format!("{message}; {}", hint.unwrap_or_default()))
    }

    #[test]
    fn a_whole_value_keeps_its_type_and_text_does_not() {
        let params = "{ k: 64, set: { count: 9 }, list: [1] }";
        for (text, expected) in [
            ("$k", "`64`"),
            ("$set.count", "`9`"),
            ("$list", "a list"),
            ("${k}", "text `64`"),
            ("a${k}b$$c", "text `a64b$c`"),
            ("$$k", "text `$k`"),
        ] {
            assert_eq!(described(params, text).unwrap(), expected, "{text}");
        }
    }

    #[test]
    fn anything_else_is_an_error_with_a_hint() {
        let params = "{ k: 64, set: { a: 1 }, list: [1] }";
        for (text, expected) in [
            ("$kk", "did you mean `k`?"),
            ("${k", "without"),
            ("${}", "no name"),
            ("$", "write `$$`"),
            ("$set.b", "did you mean `a`?"),
            ("$k.fov", "no map"),
            ("${k * 2}", "no arithmetic"),
            ("${${k}}", "no name"),
            ("$HOME", "unknown name"),
            ("a$k", "inside text write `${k}`"),
            ("$set..a", "lone `$`"),
            ("${list}", "a list"),
            ("$(touch x)", "lone `$`"),
        ] {
            let message = described(params, text).unwrap_err();
            assert!(message.contains(expected), "{text}: {message}");
        }
    }
}

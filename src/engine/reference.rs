//! References: `name`, `name.result`, `name[n=1024]`, `name.map[n=64|256,gamma=2.2]`.

use super::diagnostic::quoted;

/// A reference as written, taken apart.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Reference {
    /// Name of the stage.
    pub stage: String,
    /// Name of a further result; `None` for the first.
    pub result: Option<String>,
    /// Axes of which only some values are meant.
    pub selections: Vec<Selection>,
}

/// Some values of one axis.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Selection {
    /// Name of the axis.
    pub axis: String,
    /// Texts of the values; at least one.
    pub values: Vec<String>,
}

impl Reference {
    /// Takes a reference apart; the error says what is wrong with it.
    pub fn parse(text: &str) -> Result<Self, String> {
        let (target, selections) = match text.split_once('[') {
            None => (text, Vec::new()),
            Some((target, rest)) => (target, selections(text, rest)?),
        };
        let (stage, result) = match target.split_once('.') {
            None => (target, None),
            Some((stage, result)) => (stage, Some(result.to_owned())),
        };
        if target.is_empty() {
            return Err("expected the name of a stage, found empty text".to_owned());
        }
        if !is_stage_name(stage) || !result.as_deref().is_none_or(is_stage_name) {
            return Err(format!("{} is no reference to a stage; expected `name`, `name.result` or `name[axis=value]`", quoted(text)));
        }
        Ok(Self { stage: stage.to_owned(), result, selections })
    }
}

fn selections(text: &str, rest: &str) -> Result<Vec<Selection>, String> {
    let Some(inner) = rest.strip_suffix(']') else {
        return Err(format!("the selection in {} does not end with `]`", quoted(text)));
    };
    if inner.trim().is_empty() {
        return Err(format!("the selection `[]` in {} is empty; expected `[axis=value]`", quoted(text)));
    }
    let mut selections: Vec<Selection> = Vec::new();
    for part in inner.split(',') {
        let Some((axis, values)) = part.split_once('=') else {
            return Err(format!("the selection {} has no `=`; expected `[axis=value]`", quoted(part)));
        };
        let axis = axis.trim();
        if selections.iter().any(|selection| selection.axis == axis) {
            return Err(format!("axis {} is selected twice in {}; several values are written `[axis=64|256]`", quoted(axis), quoted(text)));
        }
        let values: Vec<String> = values.split('|').map(|value| value.trim().to_owned()).collect();
        if axis.is_empty() || values.iter().any(String::is_empty) {
            return Err(format!("the selection {} lacks an axis or a value", quoted(part)));
        }
        selections.push(Selection { axis: axis.to_owned(), values });
    }
    Ok(selections)
}

/// Whether a word may be the name of a stage: `[A-Za-z0-9_-]{1,64}`, not starting with `-`.
pub fn is_stage_name(word: &str) -> bool {
    (1..=64).contains(&word.len())
        && !word.starts_with('-')
        && word.bytes().all(|byte| byte.is_ascii_alphanumeric() || byte == b'_' || byte == b'-')
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_form_is_taken_apart() {
        let reference = Reference::parse("error.map[n=64|256, gamma=2.2]").unwrap();
        assert_eq!((reference.stage.as_str(), reference.result.as_deref()), ("error", Some("map")));
        assert_eq!(reference.selections[0], Selection { axis: "n".into(), values: vec!["64".into(), "256".into()] });
        assert_eq!(reference.selections[1], Selection { axis: "gamma".into(), values: vec!["2.2".into()] });
        assert_eq!(Reference::parse("a").unwrap().selections, []);
    }

    #[test]
    fn anything_else_is_refused() {
        for text in ["", "dist ", "./dist", "a[n=1", "a[]", "a[n]", "a[n=1,n=2]", "a[n=]", "a[=1]", "-a", "a.", "a.b.c", "a[n=1]x"] {
            assert!(Reference::parse(text).is_err(), "{text}");
        }
    }
}

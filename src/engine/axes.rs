//! Axes: the forms in which their values may be written, and the values.

use std::collections::HashMap;

use super::coordinate::Scalar;
use super::diagnostic::{listed, quoted};
use super::source::{Finding, Findings, Place, did_you_mean};
use super::yaml::{Entry, Node, Value, entry};
use crate::catalogue::nearest;

/// A named list of values.
#[derive(Debug, Clone)]
pub struct Axis {
    /// Its name.
    pub name: String,
    /// Where it is declared.
    pub place: Place,
    /// Its values; never empty, no two with one text.
    pub values: Vec<AxisValue>,
}

/// One value of an axis.
#[derive(Debug, Clone)]
pub struct AxisValue {
    /// What stands in coordinates.
    pub scalar: Scalar,
    /// The value as written: a scalar, or the map of values that go together.
    pub node: Node,
}

impl Axis {
    /// The index of the value of that text.
    pub fn index_of(&self, text: &str) -> Option<usize> {
        let is_same_number = |scalar: &Scalar| matches!(number_of(text), Some(number) if scalar.number() == Some(number));
        let by_text = self.values.iter().position(|value| value.scalar.to_string() == text);
        by_text.or_else(|| self.values.iter().position(|value| is_same_number(&value.scalar)))
    }

    /// The scalar fields of a value of a map-valued axis, as `axis.field`.
    pub fn columns(&self, index: usize) -> impl Iterator<Item = (String, Scalar)> + '_ {
        let entries = self.values[index].node.map().map(|entries| &entries[..]).unwrap_or_default();
        let fields = entries.iter().filter(|entry| &*entry.key != "name");
        fields.filter_map(|entry| Some((format!("{}.{}", self.name, entry.key), scalar_of(&entry.node)?)))
    }

    /// Its values for a message: `64, 256, 1024`.
    pub fn values_listed(&self) -> String {
        const SHOWN_COUNT: usize = 8;
        let mut texts: Vec<String> = self.values.iter().take(SHOWN_COUNT).map(|value| quoted(&value.scalar.to_string())).collect();
        if self.values.len() > SHOWN_COUNT {
            texts.push(format!("{} more", self.values.len() - SHOWN_COUNT));
        }
        listed(&texts, "and")
    }
}

fn number_of(text: &str) -> Option<f64> {
    match super::yaml::plain(text) {
        Value::Integer(value) => Some(value as f64),
        Value::Number(value) => Some(value),
        _ => None,
    }
}

/// The scalar of a node; `None` for null, lists, maps and numbers that are not finite.
pub fn scalar_of(node: &Node) -> Option<Scalar> {
    match &node.value {
        Value::Boolean(value) => Some(Scalar::Boolean(*value)),
        Value::Integer(value) => Some(Scalar::Integer(*value)),
        Value::Number(value) if value.is_finite() => Some(Scalar::from_number(*value)),
        Value::Text(text) => Some(Scalar::Text(text.to_string())),
        _ => None,
    }
}

/// What is wrong with an axis, and where.
struct Wrong {
    place: Place,
    message: String,
    hint: Option<String>,
}

fn wrong<T>(place: Place, message: impl Into<String>) -> Result<T, Wrong> {
    Err(Wrong { place, message: message.into(), hint: None })
}

/// Reads the values of an axis, at most `limit` of them.
pub fn read(name: &str, place: Place, node: &Node, limit: u64, findings: &mut Findings) -> Option<Axis> {
    match values(node, limit).and_then(without_repetition) {
        Ok(values) => Some(Axis { name: name.to_owned(), place, values }),
        Err(Wrong { place, message, hint }) => {
            findings.add(Finding::error(place, format!("axis {}: {message}", quoted(name))).with_hint(hint));
            None
        }
    }
}

fn values(node: &Node, limit: u64) -> Result<Vec<AxisValue>, Wrong> {
    match &node.value {
        Value::List(items) if items.is_empty() => wrong(node.place, "has no values"),
        Value::List(items) if items.len() as u64 > limit => wrong(node.place, too_many(items.len() as u128, limit)),
        Value::List(items) if items.iter().any(|item| item.map().is_some()) => maps(items),
        Value::List(items) => items.iter().map(scalar_value).collect(),
        Value::Map(entries) => generated(node, entries, limit),
        _ => wrong(node.place, format!("expected a list of values, found {}", node.described())),
    }
}

fn too_many(count: u128, limit: u64) -> String {
    format!("{count} values; the limit is {limit}, and `--max-jobs N` allows more")
}

fn scalar_value(node: &Node) -> Result<AxisValue, Wrong> {
    match scalar_of(node) {
        Some(scalar) => Ok(AxisValue { scalar, node: node.clone() }),
        None => wrong(node.place, format!("expected a number, text, `true` or `false`, found {}", node.described())),
    }
}

/// Values that go together: maps of the same fields, each with a unique `name` or none.
fn maps(items: &[Node]) -> Result<Vec<AxisValue>, Wrong> {
    let Some(fields) = items.iter().find_map(Node::map).map(|entries| field_names(entries)) else {
        return Ok(Vec::new());
    };
    let mut values = Vec::with_capacity(items.len());
    for (index, item) in items.iter().enumerate() {
        let Some(entries) = item.map() else {
            return wrong(item.place, format!("has maps and other values; found {}", item.described()));
        };
        if field_names(entries) != fields {
            let expected: Vec<String> = fields.iter().map(|field| quoted(field)).collect();
            return wrong(item.place, format!("every map must have the same fields, here {}", listed(&expected, "and")));
        }
        if let Some(null) = entries.iter().find(|entry| entry.node.is_null()) {
            return wrong(null.node.place, format!("field {} has no value", quoted(&null.key)));
        }
        values.push(AxisValue { scalar: name_of(entries, index)?, node: item.clone() });
    }
    Ok(values)
}

fn field_names(entries: &[Entry]) -> Vec<String> {
    let mut names: Vec<String> = entries.iter().map(|entry| entry.key.to_string()).collect();
    names.sort();
    names
}

fn name_of(entries: &[Entry], index: usize) -> Result<Scalar, Wrong> {
    match entry(entries, "name") {
        None => Ok(Scalar::Integer(index as i128 + 1)),
        Some(name) => scalar_value(&name.node).map(|value| value.scalar),
    }
}

fn without_repetition(values: Vec<AxisValue>) -> Result<Vec<AxisValue>, Wrong> {
    let mut seen = HashMap::new();
    for value in &values {
        let text = value.scalar.to_string();
        if seen.insert(text.clone(), ()).is_some() {
            return wrong(value.node.place, format!("value {} stands twice", quoted(&text)));
        }
    }
    Ok(values)
}

const FORMS: [&str; 3] = ["range", "linspace", "powers"];

/// `{ range: [from, to, step] }`, `{ linspace: [from, to, count] }`, `{ powers: [base, from, to] }`.
fn generated(node: &Node, entries: &[Entry], limit: u64) -> Result<Vec<AxisValue>, Wrong> {
    let forms = "a list, or one of `range: [from, to, step]`, `linspace: [from, to, count]`, `powers: [base, from, to]`";
    let [form] = entries else {
        return wrong(node.place, format!("expected {forms}"));
    };
    if !FORMS.contains(&&*form.key) {
        let hint = did_you_mean(nearest(&form.key, FORMS)).or_else(|| Some(format!("write {forms}")));
        return Err(Wrong { place: form.place, message: format!("unknown form {}", quoted(&form.key)), hint });
    }
    let three = numbers(&form.node).map_err(|message| Wrong {
        place: form.node.place,
        message: format!("`{}` {message}", form.key),
        hint: None,
    })?;
    let scalars = match &*form.key {
        "range" => range(three, limit),
        "linspace" => linspace(three, limit),
        _ => powers(three, limit),
    };
    let scalars = scalars.map_err(|message| Wrong { place: form.node.place, message: format!("`{}` {message}", form.key), hint: None })?;
    Ok(scalars.into_iter().map(|scalar| generated_value(scalar, form.node.place)).collect())
}

fn generated_value(scalar: Scalar, place: Place) -> AxisValue {
    let value = match &scalar {
        Scalar::Integer(value) => Value::Integer(*value),
        Scalar::Number(value) => Value::Number(*value),
        Scalar::Boolean(value) => Value::Boolean(*value),
        Scalar::Text(text) => Value::Text(text.as_str().into()),
    };
    AxisValue { scalar, node: Node::new(value, place) }
}

fn numbers(node: &Node) -> Result<[Scalar; 3], String> {
    let items = node.list().map(|items| &items[..]).unwrap_or_default();
    let scalars: Vec<Scalar> = items.iter().filter_map(scalar_of).filter(|scalar| scalar.number().is_some()).collect();
    let count = scalars.len();
    match <[Scalar; 3]>::try_from(scalars) {
        Ok(three) if items.len() == 3 => Ok(three),
        _ if items.len() == 3 && count < 3 => Err("takes three finite numbers".to_owned()),
        _ => Err(format!("takes a list of three numbers, found {}", node.described())),
    }
}

/// From `from` in steps towards `to`, which is included where a step meets it.
fn range([from, to, step]: [Scalar; 3], limit: u64) -> Result<Vec<Scalar>, String> {
    let (digits, [from, to, step]) = on_one_grid([&from, &to, &step])?;
    if step == 0 {
        return Err("has a step of zero".to_owned());
    }
    if (to > from && step < 0) || (to < from && step > 0) {
        return Err("has a step that leads away from its end".to_owned());
    }
    let count = (to - from) / step + 1;
    if count > i128::from(limit) {
        return Err(format!("gives {}", too_many(count.unsigned_abs(), limit)));
    }
    Ok((0..count).map(|index| from_grid(from + index * step, digits)).collect())
}

/// Most decimals with which a range is counted.
const GRID_DIGITS: u32 = 18;

/// The numbers as integers in units of the smallest decimal among them, so that 0.1 steps stay exact.
fn on_one_grid(numbers: [&Scalar; 3]) -> Result<(u32, [i128; 3]), String> {
    let decimals = numbers.map(decimal_of);
    let digits = decimals.iter().map(|(_, exponent)| -exponent).max().unwrap_or(0).max(0) as u32;
    if digits > GRID_DIGITS {
        return Err(format!("has more than {GRID_DIGITS} decimals"));
    }
    let mut grid = [0; 3];
    for (place, (mantissa, exponent)) in grid.iter_mut().zip(decimals) {
        let shift = (exponent + digits as i32) as u32;
        let scaled = 10_i128.checked_pow(shift).and_then(|power| power.checked_mul(mantissa));
        *place = scaled.filter(|value| value.abs() < i128::MAX / 4).ok_or("has numbers too far apart to be counted")?;
    }
    Ok((digits, grid))
}

/// Mantissa and decimal exponent of the shortest decimal form.
fn decimal_of(number: &Scalar) -> (i128, i32) {
    let text = match number {
        Scalar::Integer(value) => return (*value, 0),
        other => format!("{:e}", other.number().expect("only numbers are counted")),
    };
    let (mantissa, exponent) = text.split_once('e').expect("`{:e}` writes an exponent");
    let decimals = mantissa.split_once('.').map_or(0, |(_, decimals)| decimals.len() as i32);
    let digits: String = mantissa.chars().filter(|character| *character != '.').collect();
    let exponent: i32 = exponent.parse().expect("`{:e}` writes an integer exponent");
    (digits.parse().expect("at most 17 digits"), exponent - decimals)
}

fn from_grid(value: i128, digits: u32) -> Scalar {
    if digits == 0 { Scalar::Integer(value) } else { Scalar::from_number(format!("{value}e-{digits}").parse().expect("a decimal number")) }
}

/// `count` values from `from` to `to`, both included.
fn linspace([from, to, count]: [Scalar; 3], limit: u64) -> Result<Vec<Scalar>, String> {
    let count = match count {
        Scalar::Integer(count) if count >= 1 => count,
        other => return Err(format!("takes a positive integer as count, found `{other}`")),
    };
    if count > i128::from(limit) {
        return Err(format!("gives {}", too_many(count.unsigned_abs(), limit)));
    }
    if count == 1 {
        return if from == to { Ok(vec![from]) } else { Err("has one value but two different ends".to_owned()) };
    }
    Ok((0..count).map(|index| between(&from, &to, index, count - 1)).collect())
}

fn between(from: &Scalar, to: &Scalar, index: i128, last: i128) -> Scalar {
    if let (Scalar::Integer(from), Scalar::Integer(to)) = (from, to) {
        let product = to.checked_sub(*from).and_then(|distance| distance.checked_mul(index));
        if let Some(product) = product.filter(|product| product % last == 0) {
            return Scalar::Integer(from + product / last);
        }
    }
    if index == 0 || index == last {
        return if index == 0 { from.clone() } else { to.clone() };
    }
    let (from, to) = (from.number().expect("a number"), to.number().expect("a number"));
    Scalar::from_number((from * (last - index) as f64 + to * index as f64) / last as f64)
}

/// base^from … base^to, both included.
fn powers([base, from, to]: [Scalar; 3], limit: u64) -> Result<Vec<Scalar>, String> {
    let (Scalar::Integer(from), Scalar::Integer(to)) = (from, to) else {
        return Err("takes integers as exponents".to_owned());
    };
    let count = from.abs_diff(to).saturating_add(1);
    if count > u128::from(limit) {
        return Err(format!("gives {}", too_many(count, limit)));
    }
    let step = if to < from { -1 } else { 1 };
    (0..count as i128).map(|index| power(&base, from + step * index)).collect()
}

/// A power by repeated multiplication, whose rounding is the same on every machine.
fn power(base: &Scalar, exponent: i128) -> Result<Scalar, String> {
    let too_large = || format!("has a value that is no finite number: {base}^{exponent}");
    let size = u32::try_from(exponent.unsigned_abs()).ok().filter(|size| *size <= 2048).ok_or_else(too_large)?;
    if let (Scalar::Integer(base), true) = (base, exponent >= 0)
        && let Some(value) = base.checked_pow(size)
    {
        return Ok(Scalar::Integer(value));
    }
    let base = base.number().expect("a number");
    let product = (0..size).fold(1.0, |product, _| product * base);
    let value = if exponent < 0 { 1.0 / product } else { product };
    if value.is_finite() && (value != 0.0 || base == 0.0) { Ok(Scalar::from_number(value)) } else { Err(too_large()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read_axis(text: &str) -> Result<Vec<String>, String> {
        let mut findings = Findings::default();
        let node = crate::engine::yaml::parse(0, text, &mut findings).unwrap();
        let axis = values(&node, 100_000).and_then(without_repetition);
        axis.map(|values| values.iter().map(|value| value.scalar.to_string()).collect()).map_err(|wrong| wrong.message)
    }

    #[test]
    fn each_form_gives_its_values_with_both_ends() {
        for (text, expected) in [
            ("[64, 1.5, a, true]", "64 1.5 a true"),
            ("{ range: [0, 10, 4] }", "0 4 8"),
            ("{ range: [2, -3, -2] }", "2 0 -2"),
            ("{ range: [0, 0.5, 0.1] }", "0 0.1 0.2 0.3 0.4 0.5"),
            ("{ range: [1, 1, 1] }", "1"),
            ("{ linspace: [1, 3, 5] }", "1 1.5 2 2.5 3"),
            ("{ linspace: [0.1, 0.3, 2] }", "0.1 0.3"),
            ("{ powers: [2, 6, 10] }", "64 128 256 512 1024"),
            ("{ powers: [10, 1, -1] }", "10 1 0.1"),
            ("[{ name: warm, g: 1 }, { name: cold, g: 2 }]", "warm cold"),
            ("[{ g: 1 }, { g: 2 }]", "1 2"),
        ] {
            assert_eq!(read_axis(text).unwrap().join(" "), expected, "{text}");
        }
    }

    #[test]
    fn what_is_no_axis_is_refused() {
        for text in [
            "[]",
            "64",
            "null",
            "[[64]]",
            "[null]",
            "[.nan]",
            "[64, { a: 1 }]",
            "[{ a: 1 }, { b: 1 }]",
            "{ range: [1, 2] }",
            "{ range: [1, 2, 1], linspace: [1, 2, 2] }",
            "{ range: [1, 9, 0] }",
            "{ range: [1, 9, -1] }",
            "{ range: [0, .inf, 1] }",
            "{ range: [0, 1000000000000000000, 1] }",
            "{ range: [1, 2, 1e-300] }",
            "{ range: [1e17, 1e18, 1] }",
            "{ linspace: [1, 2, 0] }",
            "{ linspace: [1, 2, 2.5] }",
            "{ linspace: [1, 2, 1000000000000] }",
            "{ powers: [2, 0, 1000000000] }",
            "{ powers: [10, 300, 400] }",
            "[2.2, 2.20]",
            "[1, 1.0]",
            "[{ name: a }, { name: a }]",
        ] {
            assert!(read_axis(text).is_err(), "{text}");
        }
    }

    #[test]
    fn steps_are_exact_decimals() {
        let values = read_axis("{ range: [-1, 1, 0.05] }").unwrap();
        assert_eq!(values.len(), 41);
        assert_eq!(values[23], "0.15");
    }
}

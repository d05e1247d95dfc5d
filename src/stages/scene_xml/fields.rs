//! The parts of an element, each of which must be asked for by name: what no one asked for is refused.

use serde_json::json;

use crate::catalogue::nearest;
use crate::engine::yaml::Node;
use crate::render::transform::{Factors, LookAt, Rotate, Step};
use crate::stages::scene_xml::element::Element;

/// The parts of one element.
pub struct Fields<'a> {
    owner: Element<'a>,
    rest: Vec<Element<'a>>,
    /// Names that were asked for.
    asked: Vec<&'static str>,
}

impl<'a> Fields<'a> {
    /// All parts of an element.
    pub fn of(owner: Element<'a>) -> Self {
        Self { owner, rest: owner.children().collect(), asked: Vec::new() }
    }

    /// The element.
    pub fn owner(&self) -> Element<'a> {
        self.owner
    }

    /// The part of that name, if it is of one of the tags.
    pub fn take(&mut self, tags: &[&str], name: &'static str) -> Option<Element<'a>> {
        self.asked.push(name);
        let place = self.rest.iter().position(|part| part.name() == Some(name))?;
        let part = self.rest.remove(place);
        if tags.contains(&part.tag()) {
            return Some(part);
        }
        part.refuse(&format!("{} must be `<{}>`", part.described(), tags.join(">` or `<")), None);
        None
    }

    /// All parts of one tag, whatever their names.
    pub fn take_all(&mut self, tag: &str) -> Vec<Element<'a>> {
        let (taken, rest) = std::mem::take(&mut self.rest).into_iter().partition(|part| part.tag() == tag);
        self.rest = rest;
        taken
    }

    /// Gives back what was taken and not used.
    pub fn put_back(&mut self, parts: impl IntoIterator<Item = Element<'a>>) {
        self.rest.extend(parts);
    }

    /// The one part of a tag, if there is one; several are refused.
    pub fn take_one(&mut self, tag: &str) -> Option<Element<'a>> {
        let mut all = self.take_all(tag);
        all.iter().skip(1).for_each(|part| part.refuse(&format!("{} has more than one `<{tag}>`", self.owner.described()), None));
        all.drain(..).next()
    }

    /// Takes parts that change nothing of a picture.
    pub fn ignore(&mut self, names: &[&'static str]) {
        self.rest.retain(|part| !part.name().is_some_and(|name| names.contains(&name)));
    }

    /// A number.
    pub fn number(&mut self, name: &'static str) -> Option<f64> {
        self.take(&["float", "integer"], name)?.number("value")
    }

    /// A whole number.
    pub fn integer(&mut self, name: &'static str) -> Option<i64> {
        let part = self.take(&["integer"], name)?;
        let number = part.number("value")?;
        if number.fract() != 0.0 || number.abs() > 1e15 {
            part.refuse(&format!("{} must be a whole number", part.described()), None);
            return None;
        }
        Some(number as i64)
    }

    /// Yes or no.
    pub fn boolean(&mut self, name: &'static str) -> Option<bool> {
        let part = self.take(&["boolean"], name)?;
        match part.required("value")?.as_str() {
            "true" => Some(true),
            "false" => Some(false),
            _ => {
                part.refuse(&format!("{} must be `true` or `false`", part.described()), None);
                None
            }
        }
    }

    /// Text.
    pub fn text(&mut self, name: &'static str) -> Option<(Element<'a>, String)> {
        let part = self.take(&["string"], name)?;
        Some((part, part.required("value")?))
    }

    /// A number, at its place.
    pub fn number_node(&mut self, name: &'static str) -> Option<Node> {
        let part = self.take(&["float", "integer"], name)?;
        Some(part.node(json!(part.number("value")?)))
    }

    /// The path of a file, relative to this one.
    pub fn file(&mut self, name: &'static str) -> Option<Node> {
        let (part, path) = self.text(name)?;
        Some(part.node(json!(path)))
    }

    /// The steps of a transform; none where it is absent.
    pub fn transform(&mut self, name: &'static str) -> Vec<Step> {
        let Some(part) = self.take(&["transform"], name) else { return Vec::new() };
        part.children().filter_map(step).collect()
    }

    /// Refuses a setting of any other value than ours.
    pub fn must_be(&mut self, name: &'static str, ours: bool) {
        let part = self.rest.iter().find(|part| part.name() == Some(name)).copied();
        if self.boolean(name).is_some_and(|found| found != ours)
            && let Some(part) = part
        {
            part.refuse(&format!("{} is not read with another value than `{ours}`", part.described()), None);
        }
    }

    /// Refuses planes nearer and farther than the usual ones, at which something may be cut off: cameras here see everything.
    pub fn must_not_clip(&mut self, [(near, usual_near), (far, usual_far)]: [(&'static str, f64); 2]) {
        let mut check = |name: &'static str, is_usual: &dyn Fn(f64) -> bool| {
            let Some(part) = self.take(&["float", "integer"], name) else { return };
            if part.number("value").is_some_and(|distance| !is_usual(distance)) {
                let hint = "remove it, if nothing stands beyond it; our cameras see all that is in front of them".to_owned();
                part.refuse(&format!("{} is not read: it may cut something off", part.described()), Some(hint));
            }
        };
        check(near, &|distance| distance <= usual_near);
        check(far, &|distance| distance >= usual_far);
    }

    /// Refuses what no one asked for.
    pub fn finish(self) {
        for part in &self.rest {
            let near = part.name().and_then(|name| nearest(name, self.asked.iter().copied()));
            let hint = near.map(|near| format!("did you mean `{near}`?"));
            part.refuse(&format!("{} of {} is not read", part.described(), self.owner.described()), hint);
        }
    }
}

/// One step, which both programs apply in the order in which they stand.
fn step(part: Element<'_>) -> Option<Step> {
    Some(match part.tag() {
        "translate" => Step::Translate(part.vector(0.0)?),
        "scale" => Step::Scale(Factors(part.vector(1.0)?)),
        "rotate" => {
            let axis = if part.has("axis") { part.triple("axis")? } else { part.vector(0.0)? };
            Step::Rotate(Rotate { axis, degrees: part.number("angle")? })
        }
        "lookat" | "look_at" => {
            let up = if part.has("up") { part.triple("up")? } else { [0.0, 1.0, 0.0] };
            Step::LookAt(LookAt { origin: part.triple("origin")?, target: part.triple("target")?, up })
        }
        "matrix" => {
            let values = part.numbers("value")?;
            if values.len() != 16 {
                part.refuse("a matrix has 16 numbers", None);
                return None;
            }
            Step::Matrix(std::array::from_fn(|row| std::array::from_fn(|column| values[4 * row + column])))
        }
        _ => {
            let known = "`translate`, `rotate`, `scale`, `lookat` and `matrix`";
            part.refuse(&format!("{} is no step of a transform", part.described()), Some(format!("the steps are {known}")));
            return None;
        }
    })
}

//! Mitsuba 3: a scene of `directional` emitters, to be included in another or loaded alone.
//!
//! Right-handed, +y up, as here. `direction` is where the light goes; `irradiance` is on a surface that faces it.
//!
//! After Jakob et al., "Mitsuba 3", plugin `directional`.

use std::fmt::Write;

use crate::light::rigs::{Rig, number, numbers};

/// The file's text.
pub fn text(rig: &Rig, made_by: &str) -> String {
    let mut text = format!(
        "<?xml version=\"1.0\" encoding=\"utf-8\"?>\n<!--\n  {}.\n  Put <include filename=\"this file\"/> into a scene.\n  \
         irradiance is on a surface that faces the light, linear Rec.709 RGB, radiance of the map times steradian.\n  \
         Right-handed, +y up; direction is that in which the light travels.\n-->\n<scene version=\"3.0.0\">\n",
        in_comment(&rig.provenance(made_by))
    );
    for light in &rig.lights {
        let [x, y, z] = (-light.towards).to_array().map(number);
        write!(
            text,
            "    <emitter type=\"directional\" id=\"{}\">\n        <vector name=\"direction\" x=\"{x}\" y=\"{y}\" z=\"{z}\"/>\n        \
             <rgb name=\"irradiance\" value=\"{}\"/>\n    </emitter>\n",
            light.name(),
            numbers(&light.irradiance, ", ")
        )
        .expect("text takes all there is");
    }
    text + "</scene>\n"
}

/// Two hyphens end a comment of XML, or make it ill-formed.
fn in_comment(text: &str) -> String {
    text.replace("--", "- -")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::rigs::examples;

    #[test]
    fn directions_are_those_in_which_the_light_travels() {
        let text = text(&examples::rig(), "pipeline -- 1");
        assert_eq!(text.matches("<emitter type=\"directional\"").count(), 3);
        assert!(text.contains("<vector name=\"direction\" x=\"0.6\" y=\"0.0\" z=\"-0.8\"/>"), "{text}");
        assert!(text.contains("<rgb name=\"irradiance\" value=\"0.1, 0.3, 0.0\"/>"));
        assert!(text.contains("by pipeline - - 1.\n"));
    }
}

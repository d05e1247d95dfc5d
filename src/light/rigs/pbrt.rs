//! pbrt-v4: lines for the world of a scene, by `Include`.
//!
//! Directions are those here, +y up: they hold under the transformation that is current where the file is included.
//! `L` of a `distant` light is the irradiance on a surface that faces it.
//!
//! After Pharr, Jakob, Humphreys, "pbrt-v4 input file format".

use std::fmt::Write;

use crate::light::rigs::{Rig, numbers};

/// The file's text.
pub fn text(rig: &Rig, made_by: &str) -> String {
    let mut text = format!(
        "# {}.\n\
         # Include this file after WorldBegin; its transformation is the one current there.\n\
         # L is the irradiance on a surface that faces the light, linear Rec.709 RGB, radiance of the map times steradian.\n\
         # Right-handed, +y up: light comes from `from` towards `to`. pbrt's own camera is left-handed: one that looks\n\
         # along -z with x to the right has `Scale -1 1 1` before its LookAt.\n",
        rig.provenance(made_by)
    );
    for light in &rig.lights {
        let (irradiance, from) = (numbers(&light.irradiance, " "), numbers(&light.towards.to_array(), " "));
        writeln!(
            text,
            "LightSource \"distant\" \"rgb L\" [ {irradiance} ] \"point3 from\" [ {from} ] \"point3 to\" [ 0 0 0 ] # {}",
            light.name()
        )
        .expect("text takes all there is");
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::rigs::examples;

    #[test]
    fn every_light_is_a_line() {
        let text = text(&examples::rig(), "pipeline 1");
        let lines: Vec<_> = text.lines().filter(|line| !line.starts_with('#')).collect();
        assert_eq!(lines.len(), 3);
        assert_eq!(
            lines[0],
            "LightSource \"distant\" \"rgb L\" [ 2.0 1.0 0.5 ] \"point3 from\" [ 0.0 1.0 0.0 ] \"point3 to\" [ 0 0 0 ] # light_0000"
        );
    }
}

//! USD as text: a layer with one `DistantLight` a light.
//!
//! Right-handed, +y up, as here. A light shines along its local -z. `inputs:normalize` makes the intensity the
//! irradiance on a surface that faces the light, whatever the angle, which is that of the sun.
//!
//! After Pixar, "UsdLux: USD lighting schema", schema `DistantLight`.

use std::fmt::Write;

use crate::light::rigs::{Rig, number, numbers, orientation};

/// Apparent diameter of each light in degrees: the schema's default, the sun's.
const ANGLE: f64 = 0.53;

/// The file's text.
pub fn text(rig: &Rig, made_by: &str) -> String {
    let mut text = format!(
        "#usda 1.0\n(\n    defaultPrim = \"lights\"\n    doc = \"{}. Intensity is the largest channel of the irradiance on a \
         surface that faces the light, in units of radiance of the map times steradian (normalize is on); color is linear Rec.709 RGB \
         over it. Right-handed, +y up; each light shines along its local -z.\"\n    metersPerUnit = 1\n    upAxis = \"Y\"\n)\n\n\
         def Xform \"lights\"\n{{\n",
        rig.provenance(made_by)
    );
    for light in &rig.lights {
        let q = orientation(light.towards);
        let mut line = |words: &str, value: &str| writeln!(text, "{words}{value}").expect("text takes all there is");
        line("    def DistantLight ", &format!("\"{}\"\n    {{", light.name()));
        line("        float inputs:angle = ", &number(ANGLE));
        line("        color3f inputs:color = ", &format!("({})", numbers(&light.color(), ", ")));
        line("        float inputs:intensity = ", &number(light.intensity()));
        line("        bool inputs:normalize = ", "1");
        line("        quatd xformOp:orient = ", &format!("({})", numbers(&[q.w, q.x, q.y, q.z], ", ")));
        line("        uniform token[] xformOpOrder = ", "[\"xformOp:orient\"]\n    }");
    }
    text + "}\n"
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::rigs::examples;

    #[test]
    fn every_light_is_a_prim_with_its_numbers() {
        let text = text(&examples::rig(), "pipeline 1");
        assert!(text.starts_with("#usda 1.0\n(\n") && text.contains("upAxis = \"Y\"") && text.contains("3 directional lights of a 8 x 4"));
        assert_eq!(text.matches("def DistantLight").count(), 3);
        assert!(text.contains("def DistantLight \"light_0002\"\n"));
        assert!(text.contains("inputs:color = (1.0, 0.5, 0.25)") && text.contains("inputs:intensity = 2.0"));
        // From straight behind: half a turn about x, real part first.
        assert!(text.contains("xformOp:orient = (0.0, 1.0, 0.0, 0.0)"), "{text}");
        assert_eq!(text.matches('{').count(), text.matches('}').count());
    }
}

//! Blender: a Python script that adds the lights as suns in a collection of their own.
//!
//! Blender has +z up: (x, y, z) here is (x, -z, y) there, as its importers of glTF and USD have it. A sun shines
//! along its local -z, and its strength is the irradiance on a surface that faces it.
//!
//! After Blender Foundation, "Blender Python API", `bpy.types.SunLight`.

use std::fmt::Write;

use glam::DVec3;

use crate::light::rigs::{Rig, number, numbers, orientation};

/// What the script does with its table of lights.
const BODY: &str = r#"

def add(lights):
    """Puts the lights into a collection named `lights`, in place of those that an earlier run put there."""
    scene = bpy.context.scene
    collection = bpy.data.collections.get("lights") or bpy.data.collections.new("lights")
    if collection.name not in scene.collection.children:
        scene.collection.children.link(collection)
    for old in list(collection.objects):
        if old.type == "LIGHT":
            bpy.data.lights.remove(old.data)
    for name, strength, color, rotation in lights:
        sun = bpy.data.lights.new(name, "SUN")
        sun.energy = strength
        sun.color = color
        sun.angle = 0.0
        lamp = bpy.data.objects.new(name, sun)
        lamp.rotation_mode = "QUATERNION"
        lamp.rotation_quaternion = rotation
        collection.objects.link(lamp)
    # Linear values in the picture, as in the map; choose another view transform for a display.
    scene.view_settings.view_transform = "Raw"


add(LIGHTS)
"#;

/// The file's text.
pub fn text(rig: &Rig, made_by: &str) -> String {
    let mut text = format!(
        "# {}.\n\
         # Run it in Blender: blender --python FILE, or open it in the text editor. It adds suns and leaves all else as it is;\n\
         # the background of the world adds light of its own.\n\
         # strength is the largest channel of the irradiance on a surface that faces the sun, in units of radiance of the map\n\
         # times steradian; color is linear Rec.709 RGB over it. Blender has +z up: (x, y, z) of the map is (x, -z, y) here.\n\
         import bpy\n\n# Name, strength, color, rotation as a quaternion (w, x, y, z).\nLIGHTS = [\n",
        rig.provenance(made_by)
    );
    for light in &rig.lights {
        let DVec3 { x, y, z } = light.towards;
        let q = orientation(DVec3::new(x, -z, y));
        writeln!(
            text,
            "    (\"{}\", {}, ({}), ({})),",
            light.name(),
            number(light.intensity()),
            numbers(&light.color(), ", "),
            numbers(&[q.w, q.x, q.y, q.z], ", ")
        )
        .expect("text takes all there is");
    }
    text + "]\n" + BODY
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::rigs::examples;

    #[test]
    fn light_from_above_needs_no_turn_in_blender() {
        let text = text(&examples::rig(), "pipeline 1");
        // +y here is +z there.
        assert!(text.contains("(\"light_0000\", 2.0, (1.0, 0.5, 0.25), (1.0, 0.0, 0.0, 0.0)),"), "{text}");
        assert_eq!(text.matches("    (\"light_").count(), 3);
        assert!(text.lines().next().unwrap().starts_with("# 3 directional lights"));
    }
}

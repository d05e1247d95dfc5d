//! glTF 2.0 with `KHR_lights_punctual`: a scene of directional lights and nothing else.
//!
//! Right-handed, +y up, as here. A light shines along its node's local -z. Intensity is in lux; one lux stands for one
//! unit of irradiance. Files of glTF have no comments: what there is to say stands in `asset.extras`.
//!
//! After Khronos, "glTF 2.0 specification" and "KHR_lights_punctual" (2021).

use serde_json::{Value, json};

use crate::light::rigs::{Rig, orientation};

/// The file's text.
pub fn text(rig: &Rig, made_by: &str) -> String {
    let lights: Vec<Value> = rig
        .lights
        .iter()
        .map(|light| json!({ "name": light.name(), "type": "directional", "color": light.color(), "intensity": light.intensity() }))
        .collect();
    let nodes: Vec<Value> = rig
        .lights
        .iter()
        .enumerate()
        .map(|(index, light)| {
            let rotation = orientation(light.towards).to_array();
            json!({ "name": light.name(), "rotation": rotation, "extensions": { "KHR_lights_punctual": { "light": index } } })
        })
        .collect();
    let extras = json!({
        "contents": rig.provenance(made_by),
        "units": "intensity is the largest channel of the irradiance on a surface that faces the light, one lux for each unit of \
            radiance times steradian; color is linear Rec.709 RGB over it. Blender's importer takes these numbers in its mode `Unitless`.",
        "axes": "right-handed, +y up; each light shines along the local -z of its node",
    });
    let mut document = json!({
        "asset": { "version": "2.0", "generator": made_by, "extras": extras },
        "scene": 0,
        "scenes": [{ "name": "lights" }],
    });
    // Arrays must not be empty in glTF: without lights there are none.
    if !rig.lights.is_empty() {
        document["extensionsUsed"] = json!(["KHR_lights_punctual"]);
        document["extensions"] = json!({ "KHR_lights_punctual": { "lights": lights } });
        document["scenes"][0]["nodes"] = json!((0..rig.lights.len()).collect::<Vec<_>>());
        document["nodes"] = json!(nodes);
    }
    serde_json::to_string_pretty(&document).expect("a document of text and finite numbers can be written") + "\n"
}

#[cfg(test)]
mod tests {
    use glam::{DQuat, DVec3};

    use super::*;
    use crate::light::rigs::examples;

    #[test]
    fn nodes_and_lights_say_direction_and_irradiance() {
        let rig = examples::rig();
        let document: Value = serde_json::from_str(&text(&rig, "pipeline 1")).unwrap();
        let nodes = document["nodes"].as_array().unwrap();
        assert_eq!(nodes.len(), rig.lights.len());
        for (node, expected) in nodes.iter().zip(&rig.lights) {
            let index = node["extensions"]["KHR_lights_punctual"]["light"].as_u64().unwrap() as usize;
            let light = &document["extensions"]["KHR_lights_punctual"]["lights"][index];
            let rotation: [f64; 4] = serde_json::from_value(node["rotation"].clone()).unwrap();
            let shines_along = DQuat::from_array(rotation) * DVec3::NEG_Z;
            assert!((shines_along + expected.towards).length() < 1e-15);
            let color: [f64; 3] = serde_json::from_value(light["color"].clone()).unwrap();
            for (found, wanted) in color.iter().zip(expected.irradiance) {
                assert!((found * light["intensity"].as_f64().unwrap() - wanted).abs() < 1e-15);
            }
        }
    }

    #[test]
    fn a_rig_without_lights_has_no_empty_arrays() {
        let rig = Rig { lights: Vec::new(), ..examples::rig() };
        let document: Value = serde_json::from_str(&text(&rig, "pipeline 1")).unwrap();
        assert!(document.get("nodes").is_none() && document.get("extensions").is_none());
    }
}

//! What a scene of another program becomes, and where it is refused.

use serde_json::Value as Json;

use super::*;
use crate::engine::yaml::Value;
use crate::render::scene::SceneDescription;

fn json(node: &Node) -> Json {
    match &node.value {
        Value::Null => Json::Null,
        Value::Boolean(value) => (*value).into(),
        Value::Integer(value) => i64::try_from(*value).unwrap().into(),
        Value::Number(value) => (*value).into(),
        Value::Text(text) => text.to_string().into(),
        Value::List(items) => items.iter().map(json).collect(),
        Value::Map(entries) => entries.iter().map(|entry| (entry.key.to_string(), json(&entry.node))).collect(),
    }
}

fn scene(text: &str) -> SceneDescription {
    let mut findings = Findings::default();
    let node = read(0, text, &mut findings).unwrap_or_else(|| panic!("{findings:#?}"));
    let scene: SceneDescription = serde_json::from_value(json(&node)).unwrap();
    assert_eq!(scene.mistakes(), []);
    scene
}

/// Lines and messages of what is refused.
fn refused(text: &str) -> Vec<(u32, String)> {
    let mut findings = Findings::default();
    let node = read(0, text, &mut findings);
    assert_eq!(node.is_none(), findings.error_count() > 0, "{text}");
    findings.list().iter().map(|finding| (finding.place.line, finding.message.clone())).collect()
}

fn same(xml: &str, yaml: &str) {
    let text = serde_yaml::Deserializer::from_str(yaml);
    let expected: SceneDescription = serde_yaml::with::singleton_map_recursive::deserialize(text).unwrap();
    assert_eq!(scene(xml), expected, "{xml}");
}

/// A sensor and a path integrator around some parts.
fn mitsuba(parts: &str) -> String {
    format!(
        r#"<scene version="3.0.0">
<sensor type="perspective">
  <float name="fov" value="40"/>
  <transform name="to_world"><lookat origin="0,0,4" target="0,0,3" up="0,1,0"/></transform>
  <film type="hdrfilm"><integer name="width" value="8"/><integer name="height" value="6"/><rfilter type="box"/></film>
  <sampler type="independent"><integer name="sample_count" value="16"/></sampler>
</sensor>
<integrator type="path"><integer name="max_depth" value="5"/></integrator>
{parts}
</scene>"#
    )
}

const HEAD: &str = "
camera: { perspective: { origin: [0, 0, 4], target: [0, 0, 3], up: [0, 1, 0], fov_degrees: 40 } }
film: { resolution: [8, 6], filter: { box: {} } }
sampler: { independent: { samples_per_pixel: 16 } }
integrator: { path: { max_depth: 4, roulette_depth: 4 } }
";

#[test]
fn a_scene_of_mitsuba_is_ours() {
    same(
        &mitsuba(
            r#"<default name="grey" value="0.25"/>
<bsdf type="twosided" id="wall"><bsdf type="diffuse"><rgb name="reflectance" value="$grey, 0.5 1"/></bsdf></bsdf>
<shape type="rectangle">
  <transform name="to_world"><scale value="2"/><rotate x="1" angle="-90"/><translate y="-1"/></transform>
  <ref id="wall"/>
</shape>
<shape type="sphere"><point name="center" x="1" y="2" z="3"/><float name="radius" value="0.5"/>
  <bsdf type="roughconductor"><string name="material" value="Au"/><float name="alpha" value="0.25"/><string name="distribution" value="ggx"/></bsdf></shape>
<shape type="cube"><emitter type="area"><rgb name="radiance" value="1 2 3"/></emitter></shape>
<shape type="ply"><string name="filename" value="a$$grey.ply"/><boolean name="face_normals" value="true"/>
  <bsdf type="dielectric"><float name="int_ior" value="1.5"/><string name="ext_ior" value="vacuum"/></bsdf></shape>
<emitter type="point"><point name="position" value="1, 2, 3"/><rgb name="intensity" value="2"/></emitter>
<emitter type="spot"><transform name="to_world"><lookat origin="0,1,0" target="0,-1,0" up="1,0,0"/></transform><rgb name="intensity" value="4"/></emitter>"#,
        )
        .replace("a$$grey", "a"),
        &format!(
            "{HEAD}
materials: {{ wall: {{ diffuse: {{ reflectance: [0.25, 0.5, 1] }} }} }}
shapes:
  - {{ rectangle: {{}}, transform: [{{ scale: 2 }}, {{ rotate: {{ axis: [1, 0, 0], degrees: -90 }} }}, {{ translate: [0, -1, 0] }}], bsdf: wall }}
  - {{ sphere: {{ center: [1, 2, 3], radius: 0.5 }}, bsdf: {{ rough-conductor: {{ metal: gold, alpha: 0.25, distribution: ggx, masking: separable, one_sided: true }} }} }}
  - {{ box: {{}}, bsdf: {{ diffuse: {{ one_sided: true }} }}, emitter: {{ area: {{ radiance: [1, 2, 3] }} }} }}
  - {{ mesh: {{ path: a.ply, normals: flat }}, bsdf: {{ dielectric: {{ eta: 1.5 }} }} }}
emitters:
  - {{ point: {{ position: [1, 2, 3], intensity: 2 }} }}
  - {{ spot: {{ position: [0, 1, 0], target: [0, -1, 0], intensity: 4, cutoff_degrees: 20, beam_degrees: 15, falloff: mitsuba }} }}
"
        ),
    );
}

#[test]
fn media_are_read_with_their_boundaries() {
    let parts = r#"<medium type="homogeneous" id="smoke"><float name="sigma_t" value="2"/><float name="scale" value="3"/>
  <rgb name="albedo" value="0.5, 0.6, 0.7"/><phase type="hg"><float name="g" value="0.6"/></phase></medium>
<shape type="cube"><bsdf type="null"/><ref name="interior" id="smoke"/></shape>
<shape type="cube"><transform name="to_world"><scale value="2"/></transform><bsdf type="null"/>
  <medium name="interior" type="heterogeneous"><float name="scale" value="5"/>
    <volume name="sigma_t" type="gridvolume"><string name="filename" value="fog.vol"/>
      <transform name="to_world"><translate value="-0.5"/><scale value="4"/></transform></volume></medium></shape>"#;
    same(
        &mitsuba(parts).replace("type=\"path\"", "type=\"volpath\""),
        &format!(
            "{}
materials: {{}}
shapes:
  - {{ box: {{}}, medium: {{ homogeneous: {{ sigma_t: 6, albedo: [0.5, 0.6, 0.7], phase: {{ henyey-greenstein: {{ g: 0.6 }} }} }} }} }}
  - {{ box: {{}}, transform: [{{ scale: 2 }}], medium: {{ grid: {{ sigma_t: 5, albedo: 0.75, path: fog.vol }} }} }}
",
            HEAD.replace("path:", "volume-path:")
        ),
    );
    let colored = mitsuba(&parts.replace("<float name=\"sigma_t\" value=\"2\"/>", "<rgb name=\"sigma_t\" value=\"1,2,3\"/>"));
    let found = refused(&colored);
    assert!(found.len() == 1 && found[0].0 == 9 && found[0].1.contains("grey"), "{found:?}");
    let moved = refused(&mitsuba(&parts.replace("value=\"4\"", "value=\"3\"")));
    assert!(moved.len() == 1 && moved[0].0 == 14 && moved[0].1.contains("extent"), "{moved:?}");
}

#[test]
fn what_is_around_everything_is_read() {
    let parts = |emitter: &str| mitsuba(emitter);
    let expected = |emitter: &str| format!("{HEAD}\nmaterials: {{}}\nshapes: []\nemitters: [{emitter}]");
    same(
        &parts("<emitter type=\"constant\"><rgb name=\"radiance\" value=\"1, 2, 3\"/></emitter>"),
        &expected("{ environment: { radiance: [1, 2, 3] } }"),
    );
    let turned = r#"<emitter type="envmap"><string name="filename" value="sky.exr"/><float name="scale" value="2"/>
<transform name="to_world"><rotate y="1" angle="0"/><translate x="5"/></transform></emitter>"#;
    same(&parts(turned), &expected("{ environment: { path: sky.exr, strength: 2, rotate_degrees: 90 } }"));
}

#[test]
fn cameras_may_not_cut_anything_off() {
    let clipped = |near: &str, far: &str| {
        let planes = format!("<float name=\"near_clip\" value=\"{near}\"/><float name=\"far_clip\" value=\"{far}\"/>");
        mitsuba("").replace("<float name=\"fov\" value=\"40\"/>", &format!("<float name=\"fov\" value=\"40\"/>{planes}"))
    };
    scene(&clipped("0.01", "20000"));
    for (near, far, name) in [("0.5", "1e4", "near_clip"), ("0.001", "100", "far_clip")] {
        let found = refused(&clipped(near, far));
        assert!(found.len() == 1 && found[0].0 == 3 && found[0].1.contains(name), "{found:?}");
    }
}

#[test]
fn a_scene_of_nori_is_ours() {
    same(
        r#"<?xml version="1.0"?>
<scene>
  <integrator type="path_mis"/>
  <sampler type="independent"><integer name="sampleCount" value="32"/></sampler>
  <camera type="perspective">
    <transform name="toWorld"><scale value="-1,1,1"/><lookat target="0,0,3" origin="0,0,4" up="0,1,0"/></transform>
    <float name="fov" value="40"/><integer name="width" value="8"/><integer name="height" value="6"/><rfilter type="box"/>
  </camera>
  <mesh type="obj"><string name="filename" value="wall.obj"/><bsdf type="diffuse"><color name="albedo" value="0.1,0.2,0.3"/></bsdf></mesh>
  <mesh type="sphere"><float name="radius" value="2"/><bsdf type="mirror"/><emitter type="area"><color name="radiance" value="4,4,4"/></emitter></mesh>
</scene>"#,
        "
camera: { perspective: { origin: [0, 0, 4], target: [0, 0, 3], up: [0, 1, 0], fov_degrees: 40 } }
film: { resolution: [8, 6], filter: { box: {} } }
sampler: { independent: { samples_per_pixel: 32 } }
integrator: { path: { max_depth: 1000000 } }
shapes:
  - { mesh: { path: wall.obj, normals: file }, bsdf: { diffuse: { reflectance: [0.1, 0.2, 0.3], one_sided: true } } }
  - { sphere: { radius: 2 }, bsdf: { mirror: { one_sided: true } }, emitter: { area: { radiance: 4 } } }
",
    );
}

#[test]
fn what_differs_is_refused_with_its_line() {
    for (parts, line, said) in [
        ("<shape type=\"cylinder\"/>", 9, "cylinder"),
        ("<shape type=\"sphere\">\n<float name=\"radios\" value=\"1\"/></shape>", 10, "radios"),
        ("<emitter type=\"envmap\"/>", 9, "no `filename`"),
        (
            "<emitter type=\"envmap\"><string name=\"filename\" value=\"a.exr\"/><transform name=\"to_world\"><rotate x=\"1\" angle=\"90\"/></transform></emitter>",
            9,
            "upright",
        ),
        ("<shape type=\"cube\"><ref id=\"nowhere\"/></shape>", 9, "nowhere"),
        ("<bsdf type=\"twosided\" id=\"a\"><ref id=\"a\"/></bsdf>", 9, "nested"),
        ("<bsdf type=\"diffuse\" id=\"a\"><float name=\"reflectance\" value=\"x\"/></bsdf>", 9, "no number"),
        ("<bsdf type=\"diffuse\" id=\"a\"><float name=\"reflectance\"/></bsdf>", 9, "no `value`"),
        ("<bsdf type=\"diffuse\" id=\"a\"><float name=\"reflectance\" value=\"$b\"/></bsdf>", 9, "`$b` has no value"),
        ("<shape type=\"sphere\"><transform name=\"to_world\"><rotate x=\"1\"/></transform></shape>", 9, "angle"),
        (
            "<shape type=\"sphere\"><bsdf type=\"diffuse\"><texture name=\"reflectance\" type=\"bitmap\"><string name=\"filename\" value=\"a.png\"/></texture></bsdf></shape>",
            9,
            "textures lie otherwise",
        ),
        ("<sensor type=\"perspective\"/>", 9, "more than one"),
        ("<include filename=\"a.xml\"/>", 9, "not read"),
        ("<shape", 10, "well-formed"),
    ] {
        let found = refused(&mitsuba(parts));
        assert!(found.iter().any(|(at, message)| *at == line && message.contains(said)), "{parts}: {found:?}");
    }
    for (text, said) in [
        ("<scene version=\"0.5.0\"/>", "0.5.0"),
        ("<scene/>", "camera"),
        ("<other/>", "root"),
        ("<!DOCTYPE a [<!ENTITY b \"c\">]><scene/>", "well-formed"),
        ("", "well-formed"),
    ] {
        let found = refused(text);
        assert!(found.iter().any(|(_, message)| message.contains(said)), "{text}: {found:?}");
    }
}

#[test]
fn depth_and_size_are_no_danger() {
    let deep = format!("<scene version=\"3.0.0\">{}{}</scene>", "<shape>".repeat(100_000), "</shape>".repeat(100_000));
    assert!(!refused(&deep).is_empty());
    let nested = format!("<bsdf type=\"twosided\">{}</bsdf>", "<bsdf type=\"twosided\">".repeat(50) + &"</bsdf>".repeat(50));
    assert!(!refused(&mitsuba(&format!("<shape type=\"cube\">{nested}</shape>"))).is_empty());
}

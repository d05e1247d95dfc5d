//! Scenes of Nori, the teaching renderer of Jakob, as far as both renderers mean the same by them.
//!
//! Its cameras look along +z with +x to the right, which mirrors what a right-handed map makes: scenes begin their camera's
//! transform with `<scale value="-1,1,1"/>`. Its surfaces have one side, its paths any length.

use serde_json::json;

use crate::engine::yaml::{Node, Value};
use crate::stages::scene_xml::element::Element;
use crate::stages::scene_xml::fields::Fields;
use crate::stages::scene_xml::mitsuba::{color, placed, view};

/// The scene of a root; `None` where its findings leave nothing of it.
pub fn scene(root: Element<'_>) -> Option<Node> {
    let mut fields = Fields::of(root);
    let shapes: Vec<Node> = fields.take_all("mesh").into_iter().filter_map(shape).collect();
    let emitters: Vec<Node> = fields.take_all("emitter").into_iter().filter_map(emitter).collect();
    let camera = fields.take_one("camera");
    let sampler = fields.take_one("sampler").map_or(Some(None), |part| sampler(part).map(Some));
    let integrator = fields.take_one("integrator");
    fields.finish();
    let (Some(camera_part), Some(integrator_part)) = (camera, integrator) else {
        root.refuse("a scene of Nori has a `<camera>` and an `<integrator>`", None);
        return None;
    };
    let [camera, film] = camera_of(camera_part)?;
    let place = root.place();
    let list = |nodes: Vec<Node>| Some(Node::new(Value::List(nodes.into()), place));
    Some(root.map([
        ("camera", Some(camera)),
        ("film", Some(film)),
        ("sampler", Some(sampler?.unwrap_or_else(|| samples(root, 1)))),
        ("integrator", Some(integrator_of(integrator_part)?)),
        ("shapes", list(shapes)),
        ("emitters", list(emitters)),
    ]))
}

fn samples(part: Element<'_>, count: i64) -> Node {
    part.node(json!({ "independent": { "samples_per_pixel": count } }))
}

fn sampler(part: Element<'_>) -> Option<Node> {
    if part.kind() != "independent" {
        part.refuse_kind(&["independent"]);
        return None;
    }
    let mut fields = Fields::of(part);
    let count = fields.integer("sampleCount").unwrap_or(1);
    fields.finish();
    Some(samples(part, count))
}

/// The camera and the film.
fn camera_of(camera: Element<'_>) -> Option<[Node; 2]> {
    let kind = match camera.kind() {
        "perspective" => "perspective",
        "thinlens" => "thin-lens",
        _ => {
            camera.refuse_kind(&["perspective", "thinlens"]);
            return None;
        }
    };
    let mut fields = Fields::of(camera);
    let steps = fields.transform("toWorld");
    let to_world = placed(camera, &steps)?;
    if to_world.matrix3.determinant() > 0.0 {
        let hint = "let the transform begin with `<scale value=\"-1,1,1\"/>`".to_owned();
        camera.refuse("`toWorld` mirrors the picture, which our cameras do not", Some(hint));
    }
    let size = [fields.integer("width").unwrap_or(1280), fields.integer("height").unwrap_or(720)];
    let [origin, target, up] = view(&steps, &to_world).map(|point| Some(camera.node(json!(point.to_array()))));
    let fov = fields.number("fov").unwrap_or(30.0);
    let mut parameters = vec![("origin", origin), ("target", target), ("up", up), ("fov_degrees", Some(camera.node(json!(fov))))];
    if kind == "thin-lens" {
        parameters.push(("aperture_radius", fields.number_node("apertureRadius").or_else(|| Some(camera.node(json!(0.0))))));
        parameters.push(("focus_distance", fields.number_node("focalDistance").or_else(|| Some(camera.node(json!(10.0))))));
    }
    let filter = fields.take_one("rfilter");
    fields.must_not_clip([("nearClip", 1e-4), ("farClip", 1e4)]);
    fields.finish();
    let filter = filter.map_or_else(|| Some(bell(camera, 2.0, 0.5)), filter_of)?;
    let film = camera.map([("resolution", Some(camera.node(json!(size)))), ("filter", Some(filter))]);
    Some([camera.kind_map(kind, parameters), film])
}

fn bell(part: Element<'_>, radius: f64, deviation: f64) -> Node {
    part.node(json!({ "gaussian": { "radius": radius, "deviation": deviation } }))
}

fn filter_of(filter: Element<'_>) -> Option<Node> {
    let mut fields = Fields::of(filter);
    let node = match filter.kind() {
        "gaussian" => bell(filter, fields.number("radius").unwrap_or(2.0), fields.number("stddev").unwrap_or(0.5)),
        "tent" => filter.node(json!({ "tent": {} })),
        "box" => filter.node(json!({ "box": {} })),
        _ => {
            filter.refuse_kind(&["gaussian", "tent", "box"]);
            return None;
        }
    };
    fields.finish();
    Some(node)
}

fn integrator_of(integrator: Element<'_>) -> Option<Node> {
    let fields = Fields::of(integrator);
    let node = match integrator.kind() {
        "normals" => json!({ "normals": {} }),
        "direct_ems" => json!({ "direct": { "strategy": "emitter" } }),
        "direct_mats" => json!({ "direct": { "strategy": "bsdf" } }),
        "direct_mis" | "direct" => json!({ "direct": {} }),
        "path_mats" => json!({ "path": { "strategy": "bsdf", "max_depth": 1_000_000 } }),
        "path_mis" | "path" => json!({ "path": { "max_depth": 1_000_000 } }),
        _ => {
            integrator.refuse_kind(&["normals", "direct_ems", "direct_mats", "direct_mis", "path_mats", "path_mis"]);
            return None;
        }
    };
    fields.finish();
    Some(integrator.node(node))
}

fn shape(shape: Element<'_>) -> Option<Node> {
    let mut fields = Fields::of(shape);
    let steps = fields.transform("toWorld");
    let (kind, parameters) = match shape.kind() {
        // Without normals in the file its triangles are flat.
        "obj" => ("mesh", shape.map([("path", fields.file("filename")), ("normals", Some(shape.node(json!("file"))))])),
        "sphere" => {
            let center = fields.take(&["point"], "center").map_or(Some([0.0; 3]), |center| center.vector(0.0))?;
            let radius = fields.number("radius").unwrap_or(1.0);
            if !steps.is_empty() {
                shape.refuse("a sphere of Nori has no transform", None);
            }
            ("sphere", shape.node(json!({ "center": center, "radius": radius })))
        }
        _ => {
            shape.refuse_kind(&["obj", "sphere"]);
            return None;
        }
    };
    let bsdf = fields.take_one("bsdf").map_or_else(|| Some(shape.node(json!({ "diffuse": { "one_sided": true } }))), bsdf);
    let emitter = fields.take_one("emitter").map_or(Some(None), |part| area(part).map(Some));
    fields.finish();
    let transform = (!steps.is_empty()).then(|| shape.node(json!(steps)));
    Some(shape.map([(kind, Some(parameters)), ("transform", transform), ("bsdf", Some(bsdf?)), ("emitter", emitter?)]))
}

fn bsdf(bsdf: Element<'_>) -> Option<Node> {
    let mut fields = Fields::of(bsdf);
    let one_sided = Some(bsdf.node(json!(true)));
    let node = match bsdf.kind() {
        "diffuse" => {
            let albedo = fields.take(&["color"], "albedo").map_or(Some(bsdf.node(json!(0.5))), color)?;
            bsdf.kind_map("diffuse", [("reflectance", Some(albedo)), ("one_sided", one_sided)])
        }
        "mirror" => bsdf.kind_map("mirror", [("one_sided", one_sided)]),
        "dielectric" => {
            let eta = fields.number("intIOR").unwrap_or(1.5046) / fields.number("extIOR").unwrap_or(1.000277);
            bsdf.kind_map("dielectric", [("eta", Some(bsdf.node(json!(eta))))])
        }
        _ => {
            bsdf.refuse_kind(&["diffuse", "mirror", "dielectric"]);
            return None;
        }
    };
    fields.finish();
    Some(node)
}

fn area(emitter: Element<'_>) -> Option<Node> {
    if emitter.kind() != "area" {
        emitter.refuse_kind(&["area"]);
        return None;
    }
    let mut fields = Fields::of(emitter);
    let radiance = fields.take(&["color"], "radiance").or_else(|| {
        emitter.refuse("an area light has a `radiance`", None);
        None
    });
    fields.finish();
    Some(emitter.kind_map("area", [("radiance", Some(color(radiance?)?))]))
}

fn emitter(emitter: Element<'_>) -> Option<Node> {
    if emitter.kind() != "point" {
        emitter.refuse_kind(&["point"]);
        return None;
    }
    let mut fields = Fields::of(emitter);
    let position = fields.take(&["point"], "position").map_or(Some([0.0; 3]), |position| position.vector(0.0))?;
    // Nori's point lights have a `power` of all directions together.
    let power = fields.take(&["color"], "power").map_or(Some([1.0; 3]), |power| power.triple("value"))?;
    let intensity = power.map(|power| power / (4.0 * std::f64::consts::PI));
    fields.finish();
    Some(emitter.node(json!({ "point": { "position": position, "intensity": intensity } })))
}

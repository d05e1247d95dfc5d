//! Scenes of Mitsuba 3, as far as both renderers mean the same by them.
//!
//! What differs is translated: Mitsuba counts one path segment more (`max_depth`), its surfaces have one side except under
//! `twosided`, its microfacets mask separately, its cameras look along +z with +x to the left, its textures begin at the
//! top. What cannot be translated is refused.

use std::collections::BTreeMap;

use glam::{DAffine3, DMat3, DVec3};
use serde_json::{Value as Json, json};

use crate::engine::yaml::{Entry, Node, Value};
use crate::math::elementary;
use crate::render::transform::{Step, affine};
use crate::stages::scene_xml::element::Element;
use crate::stages::scene_xml::fields::Fields;

/// Deepest nesting of BSDFs and references.
const DEPTH_LIMIT: usize = 16;

/// The scene of a root; `None` where its findings leave nothing of it.
pub fn scene(root: Element<'_>) -> Option<Node> {
    let version = root.required("version")?;
    if !version.starts_with(['2', '3']) {
        root.refuse(&format!("scenes of Mitsuba 2 and 3 are read, and this one is of version {version}"), None);
    }
    for part in root.children().filter(|part| part.tag() == "default") {
        if let (Some(name), Some(value)) = (part.name(), part.required("value")) {
            part.xml().set_default(name, &value);
        }
    }
    let mut reader = Reader { named: BTreeMap::new() };
    for part in root.children() {
        if let Some(id) = part.attribute("id") {
            reader.named.insert(id, part);
        }
    }
    let (mut sensor, mut integrator) = (None, None);
    let (mut materials, mut shapes, mut emitters) = (Vec::new(), Vec::new(), Vec::new());
    for part in root.children() {
        match part.tag() {
            "sensor" => only_one(&mut sensor, part),
            "integrator" => only_one(&mut integrator, part),
            "bsdf" => materials.extend(reader.material(part)),
            "shape" => shapes.extend(reader.shape(part)),
            "emitter" => emitters.extend(reader.emitter(part)),
            // They are read where they are used.
            "default" | "medium" | "texture" => {}
            "include" => part.refuse(&format!("{} is not read", part.described()), Some("put what is in that file here".into())),
            _ => part.refuse(&format!("{} of the scene is not read", part.described()), None),
        }
    }
    let Some(sensor) = sensor else {
        root.refuse("the scene has no `<sensor>`", None);
        return None;
    };
    let [camera, film, sampler] = reader.sensor(sensor)?;
    let integrator = integrator.map_or(Some(root.kind_map("path", [])), |integrator| reader.integrator(integrator))?;
    let place = root.place();
    let list = |nodes: Vec<Node>| Some(Node::new(Value::List(nodes.into()), place));
    Some(root.map([
        ("camera", Some(camera)),
        ("film", Some(film)),
        ("sampler", Some(sampler)),
        ("integrator", Some(integrator)),
        ("materials", Some(Node::new(Value::Map(materials.into()), place))),
        ("shapes", list(shapes)),
        ("emitters", list(emitters)),
    ]))
}

fn only_one<'a>(slot: &mut Option<Element<'a>>, part: Element<'a>) {
    if slot.replace(part).is_some() {
        part.refuse(&format!("the scene has more than one `<{}>`", part.tag()), None);
    }
}

/// A scene while it is read.
struct Reader<'a> {
    /// Parts with an `id`.
    named: BTreeMap<String, Element<'a>>,
}

/// A BSDF as a shape has it.
enum Surface {
    /// None was given.
    Usual,
    /// `null`: there is no surface.
    None,
    /// A BSDF.
    Bsdf(Node),
}

impl<'a> Reader<'a> {
    /// The element itself, or the one that a `<ref>` names.
    fn resolved(&self, part: Element<'a>) -> Option<Element<'a>> {
        if part.tag() != "ref" {
            return Some(part);
        }
        let id = part.required("id")?;
        let found = self.named.get(&id).copied();
        if found.is_none() {
            part.refuse(&format!("nothing in the scene has the id `{id}`"), None);
        }
        found
    }

    fn sensor(&self, sensor: Element<'a>) -> Option<[Node; 3]> {
        let mut fields = Fields::of(sensor);
        let steps = fields.transform("to_world");
        let film = fields.take_one("film").or_else(|| missing(sensor, "film"));
        let sampler = fields.take_one("sampler");
        let (film, [width, height]) = self.film(film?)?;
        let sampler = match sampler {
            Some(sampler) => self.sampler(sampler)?,
            None => sensor.kind_map("independent", [("samples_per_pixel", Some(sensor.node(json!(4))))]),
        };
        fields.must_not_clip([("near_clip", 1e-2), ("far_clip", 1e4)]);
        let to_world = placed(sensor, &steps)?;
        let [origin, target, up] = view(&steps, &to_world);
        if to_world.matrix3.determinant() < 0.0 {
            sensor.refuse("`to_world` mirrors the picture, which our cameras do not", None);
        }
        let point = |point: DVec3| Some(sensor.node(json!(point.to_array())));
        let mut places = vec![("origin", point(origin)), ("target", point(target)), ("up", point(up))];
        let camera = match sensor.kind() {
            kind @ ("perspective" | "thinlens") => {
                places.push(("fov_degrees", Some(sensor.node(json!(horizontal_fov(&mut fields, width / height)?)))));
                if kind == "thinlens" {
                    places.push(("aperture_radius", fields.number_node("aperture_radius").or_else(|| missing(sensor, "aperture_radius"))));
                    places.push(("focus_distance", fields.number_node("focus_distance").or_else(|| missing(sensor, "focus_distance"))));
                    sensor.kind_map("thin-lens", places)
                } else {
                    sensor.kind_map("perspective", places)
                }
            }
            "orthographic" => {
                places.push(("width", Some(sensor.node(json!(2.0 * to_world.matrix3.x_axis.length())))));
                sensor.kind_map("orthographic", places)
            }
            _ => {
                sensor.refuse_kind(&["perspective", "thinlens", "orthographic"]);
                return None;
            }
        };
        fields.finish();
        Some([camera, film, sampler])
    }

    /// The film, and its width and height.
    fn film(&self, film: Element<'a>) -> Option<(Node, [f64; 2])> {
        if film.kind() != "hdrfilm" {
            film.refuse_kind(&["hdrfilm"]);
        }
        let mut fields = Fields::of(film);
        let size = [fields.integer("width").unwrap_or(768), fields.integer("height").unwrap_or(576)];
        let filter = match fields.take_one("rfilter") {
            Some(filter) => self.filter(filter)?,
            None => gaussian(film, 0.5),
        };
        fields.ignore(&["file_format", "pixel_format", "component_format", "sample_border"]);
        fields.finish();
        let node = film.map([("resolution", Some(film.node(json!(size)))), ("filter", Some(filter))]);
        Some((node, size.map(|side| side as f64)))
    }

    fn filter(&self, filter: Element<'a>) -> Option<Node> {
        let mut fields = Fields::of(filter);
        let node = match filter.kind() {
            "box" => filter.kind_map("box", []),
            "tent" => filter.kind_map("tent", [("radius", fields.number_node("radius"))]),
            "gaussian" => gaussian(filter, fields.number("stddev").unwrap_or(0.5)),
            _ => {
                filter.refuse_kind(&["box", "tent", "gaussian"]);
                return None;
            }
        };
        fields.finish();
        Some(node)
    }

    fn sampler(&self, sampler: Element<'a>) -> Option<Node> {
        let kind = match sampler.kind() {
            "independent" => "independent",
            "stratified" | "multijitter" => "stratified",
            "ldsampler" => "sobol",
            _ => {
                sampler.refuse_kind(&["independent", "stratified", "multijitter", "ldsampler"]);
                return None;
            }
        };
        let mut fields = Fields::of(sampler);
        let count = fields.integer("sample_count").unwrap_or(4);
        fields.ignore(&["seed", "jitter"]);
        fields.finish();
        Some(sampler.kind_map(kind, [("samples_per_pixel", Some(sampler.node(json!(count))))]))
    }

    fn integrator(&self, integrator: Element<'a>) -> Option<Node> {
        let mut fields = Fields::of(integrator);
        fields.must_be("hide_emitters", false);
        let node = match integrator.kind() {
            "direct" => integrator.kind_map("direct", []),
            kind @ ("path" | "volpath" | "volpathmis") => {
                let depth = match fields.integer("max_depth").unwrap_or(-1) {
                    0 => {
                        integrator.refuse("`max_depth` of 0 is a black picture", None);
                        None
                    }
                    -1 => Some(1_000_000),
                    // One path segment more than scatterings.
                    depth => Some(depth - 1),
                };
                let roulette = (fields.integer("rr_depth").unwrap_or(5) - 1).max(0);
                let parameters =
                    [("max_depth", Some(integrator.node(json!(depth?)))), ("roulette_depth", Some(integrator.node(json!(roulette))))];
                integrator.kind_map(if kind == "path" { "path" } else { "volume-path" }, parameters)
            }
            _ => {
                integrator.refuse_kind(&["path", "direct", "volpath", "volpathmis"]);
                return None;
            }
        };
        fields.finish();
        Some(node)
    }

    /// A BSDF of the scene under its id.
    fn material(&self, bsdf: Element<'a>) -> Option<Entry> {
        let Some(id) = bsdf.attribute("id") else {
            bsdf.refuse("a BSDF of the scene has an `id`, by which shapes refer to it", None);
            return None;
        };
        match self.bsdf(bsdf, true, 0)? {
            // There is nothing to name; shapes that refer to it find it by themselves.
            Surface::None | Surface::Usual => None,
            Surface::Bsdf(node) => Some(Entry { key: id.into(), place: bsdf.place(), node }),
        }
    }

    fn bsdf(&self, bsdf: Element<'a>, one_sided: bool, depth: usize) -> Option<Surface> {
        if depth > DEPTH_LIMIT {
            bsdf.refuse(&format!("BSDFs are nested more than {DEPTH_LIMIT} deep, or refer to themselves"), None);
            return None;
        }
        let mut fields = Fields::of(bsdf);
        let sides = || ("one_sided", one_sided.then(|| bsdf.node(json!(true))));
        let separable = || ("masking", Some(bsdf.node(json!("separable"))));
        let node = match bsdf.kind() {
            "null" => {
                fields.finish();
                return Some(Surface::None);
            }
            "twosided" => {
                let inner = self.nested(&mut fields)?;
                fields.finish();
                return self.bsdf(inner, false, depth + 1);
            }
            "diffuse" => bsdf.kind_map("diffuse", [("reflectance", self.texture(&mut fields, "reflectance", Meaning::Color)), sides()]),
            "dielectric" => {
                let [reflectance, transmittance] = self.speculars(&mut fields);
                bsdf.kind_map("dielectric", [("eta", eta(&mut fields, 1.5046)), reflectance, transmittance])
            }
            "roughdielectric" => {
                let [reflectance, transmittance] = self.speculars(&mut fields);
                let [distribution, alpha] = self.facets(&mut fields);
                let parameters = [("eta", eta(&mut fields, 1.5046)), distribution, alpha, separable(), reflectance, transmittance];
                bsdf.kind_map("rough-dielectric", parameters)
            }
            "conductor" => {
                let [metal, eta, k] = self.metal(&mut fields);
                let reflectance = ("reflectance", self.texture(&mut fields, "specular_reflectance", Meaning::Color));
                bsdf.kind_map("conductor", [metal, eta, k, reflectance, sides()])
            }
            "roughconductor" => {
                let [metal, eta, k] = self.metal(&mut fields);
                let [distribution, alpha] = self.facets(&mut fields);
                let reflectance = ("reflectance", self.texture(&mut fields, "specular_reflectance", Meaning::Color));
                bsdf.kind_map("rough-conductor", [metal, eta, k, distribution, alpha, separable(), reflectance, sides()])
            }
            "plastic" => bsdf.kind_map(
                "plastic",
                [
                    ("eta", eta(&mut fields, 1.49)),
                    ("diffuse", self.texture(&mut fields, "diffuse_reflectance", Meaning::Color)),
                    ("specular", self.texture(&mut fields, "specular_reflectance", Meaning::Color)),
                    ("nonlinear", fields.boolean("nonlinear").map(|nonlinear| bsdf.node(json!(nonlinear)))),
                    sides(),
                ],
            ),
            "normalmap" => {
                fields.must_be("flip_invalid_normals", true);
                let softens = fields.boolean("use_shadowing_function").unwrap_or(true);
                let inner = self.nested(&mut fields)?;
                let map = self.texture(&mut fields, "normalmap", Meaning::Normals).or_else(|| missing(bsdf, "normalmap"));
                let Surface::Bsdf(inner) = self.bsdf(inner, one_sided, depth + 1)? else {
                    bsdf.refuse("a normal map needs a surface under it", None);
                    return None;
                };
                let shadowing = bsdf.node(json!(if softens { "microfacet" } else { "none" }));
                bsdf.kind_map("normal-map", [("map", map), ("shadowing", Some(shadowing)), ("bsdf", Some(inner))])
            }
            _ => {
                bsdf.refuse_kind(&[
                    "diffuse",
                    "dielectric",
                    "roughdielectric",
                    "conductor",
                    "roughconductor",
                    "plastic",
                    "twosided",
                    "normalmap",
                    "null",
                ]);
                return None;
            }
        };
        fields.finish();
        Some(Surface::Bsdf(node))
    }

    /// The one BSDF within another.
    fn nested(&self, fields: &mut Fields<'a>) -> Option<Element<'a>> {
        let owner = fields.owner();
        let mut inner = fields.take_all("bsdf");
        inner.extend(fields.take_all("ref"));
        match inner[..] {
            [one] => self.resolved(one),
            _ => {
                owner.refuse(&format!("{} is read with one BSDF in it, and has {}", owner.described(), inner.len()), None);
                None
            }
        }
    }

    fn speculars(&self, fields: &mut Fields<'a>) -> [(&'static str, Option<Node>); 2] {
        [
            ("reflectance", self.texture(fields, "specular_reflectance", Meaning::Color)),
            ("transmittance", self.texture(fields, "specular_transmittance", Meaning::Color)),
        ]
    }

    fn facets(&self, fields: &mut Fields<'a>) -> [(&'static str, Option<Node>); 2] {
        let owner = fields.owner();
        let named = fields.text("distribution").map_or_else(|| "beckmann".to_owned(), |(_, name)| name);
        if !["beckmann", "ggx"].contains(&named.as_str()) {
            owner.refuse(&format!("the distribution `{named}` is not read"), Some("it is `beckmann` or `ggx`".into()));
        }
        fields.must_be("sample_visible", true);
        let alpha = self.texture(fields, "alpha", Meaning::Number).unwrap_or_else(|| owner.node(json!(0.1)));
        [("distribution", Some(owner.node(json!(named)))), ("alpha", Some(alpha))]
    }

    /// The metal by its name, or its index of refraction.
    fn metal(&self, fields: &mut Fields<'a>) -> [(&'static str, Option<Node>); 3] {
        let owner = fields.owner();
        let index = |name: &'static str, fields: &mut Fields<'a>| self.texture(fields, name, Meaning::Index);
        let (eta, k) = (index("eta", fields), index("k", fields));
        let material = fields.text("material").map(|(_, name)| name);
        let metal = match material.as_deref() {
            Some("Al") => Some("aluminum"),
            Some("Cu") => Some("copper"),
            Some("Au") => Some("gold"),
            Some("Pt") => Some("platinum"),
            Some("Ag") => Some("silver"),
            Some("none") => Some("ideal"),
            Some(other) => {
                let known = "`Al`, `Cu`, `Au`, `Pt`, `Ag` and `none`; others by `eta` and `k`";
                owner.refuse(&format!("the material `{other}` is not read"), Some(format!("the metals are {known}")));
                None
            }
            None if eta.is_none() && k.is_none() => Some("copper"),
            None => None,
        };
        [("metal", metal.map(|metal| owner.node(json!(metal)))), ("eta", eta), ("k", k)]
    }

    /// A value or a texture of that name.
    fn texture(&self, fields: &mut Fields<'a>, name: &'static str, meaning: Meaning) -> Option<Node> {
        let part = fields.take(&["rgb", "spectrum", "float", "integer", "texture", "ref"], name)?;
        let part = self.resolved(part)?;
        match part.tag() {
            "rgb" => color(part),
            "float" | "integer" => Some(part.node(json!(part.number("value")?))),
            "spectrum" if meaning != Meaning::Light => Some(part.node(json!(part.number("value")?))),
            "texture" => self.pattern(part, meaning),
            tag => {
                part.refuse(&format!("{} must be a color or a texture, and is `<{tag}>`", part.described()), Some("use `<rgb>`".into()));
                None
            }
        }
    }

    fn pattern(&self, texture: Element<'a>, meaning: Meaning) -> Option<Node> {
        let mut fields = Fields::of(texture);
        let node = match texture.kind() {
            "bitmap" => {
                let wrap = fields.text("wrap_mode").map_or_else(|| "repeat".to_owned(), |(_, mode)| mode);
                let filter = fields.text("filter_type").map_or_else(|| "bilinear".to_owned(), |(_, filter)| filter);
                let is_raw = fields.boolean("raw").unwrap_or(false);
                if is_raw != (meaning == Meaning::Normals) && meaning != Meaning::Number {
                    texture.refuse("`raw` is for normals and numbers, which need it", None);
                }
                // Mitsuba's v begins at the top of the picture, ours at its bottom.
                let flipped = [("scale", texture.node(json!([1.0, -1.0]))), ("offset", texture.node(json!([0.0, 1.0])))];
                let [scale, offset] = flipped.map(|(name, node)| (name, Some(node)));
                let path = fields.file("filename").or_else(|| missing(texture, "filename"));
                let (wrap, filter) = (texture.node(json!(wrap)), texture.node(json!(filter)));
                texture.kind_map("bitmap", [("path", path), ("wrap", Some(wrap)), ("filter", Some(filter)), scale, offset])
            }
            _ => {
                texture.refuse_kind(&["bitmap"]);
                return None;
            }
        };
        fields.finish();
        Some(node)
    }

    fn shape(&self, shape: Element<'a>) -> Option<Node> {
        let mut fields = Fields::of(shape);
        let steps = fields.transform("to_world");
        fields.must_be("flip_normals", false);
        let (kind, parameters) = self.form(shape, &mut fields)?;
        let surface = self.surface_of(&mut fields, kind)?;
        let emitter = fields.take_one("emitter").and_then(|emitter| self.area(emitter, kind));
        let medium = match fields.take(&["medium", "ref"], "interior") {
            Some(medium) => Some(self.medium(self.resolved(medium)?, shape, &steps)?),
            None => None,
        };
        fields.finish();
        let bsdf = match surface {
            Surface::Bsdf(node) => Some(node),
            // Without a BSDF Mitsuba's surface is grey on one side.
            Surface::Usual => Some(shape.node(json!({ "diffuse": { "one_sided": true } }))),
            Surface::None if medium.is_none() => {
                shape.refuse("the surface is `null` and nothing is in it", None);
                None
            }
            Surface::None => None,
        };
        let transform = (!steps.is_empty()).then(|| shape.node(json!(steps)));
        Some(shape.map([(kind, Some(parameters)), ("transform", transform), ("bsdf", bsdf), ("emitter", emitter), ("medium", medium)]))
    }

    fn form(&self, shape: Element<'a>, fields: &mut Fields<'a>) -> Option<(&'static str, Node)> {
        Some(match shape.kind() {
            "sphere" => {
                let center = match fields.take(&["point"], "center") {
                    Some(center) => center.vector(0.0)?,
                    None => [0.0; 3],
                };
                let radius = fields.number("radius").unwrap_or(1.0);
                ("sphere", shape.node(json!({ "center": center, "radius": radius })))
            }
            "rectangle" => ("rectangle", shape.node(json!({}))),
            "disk" => ("disk", shape.node(json!({}))),
            "cube" => ("box", shape.node(json!({}))),
            kind @ ("obj" | "ply") => {
                fields.must_be("flip_tex_coords", kind == "obj");
                let normals = if fields.boolean("face_normals").unwrap_or(false) { "flat" } else { "auto" };
                let path = fields.file("filename").or_else(|| missing(shape, "filename"));
                ("mesh", shape.map([("path", path), ("normals", Some(shape.node(json!(normals))))]))
            }
            _ => {
                shape.refuse_kind(&["sphere", "rectangle", "disk", "cube", "obj", "ply"]);
                return None;
            }
        })
    }

    fn surface_of(&self, fields: &mut Fields<'a>, kind: &str) -> Option<Surface> {
        let mut found: Vec<Element<'a>> = fields.take_all("bsdf");
        let is_bsdf = |part: &Element<'a>| self.resolved(*part).is_some_and(|part| part.tag() == "bsdf");
        let references = fields.take_all("ref");
        found.extend(references.iter().filter(|part| is_bsdf(part)));
        fields.put_back(references.into_iter().filter(|part| !is_bsdf(part)));
        let Some(bsdf) = found.first().copied() else { return Some(Surface::Usual) };
        if found.len() > 1 {
            fields.owner().refuse("the shape has more than one BSDF", None);
        }
        let resolved = self.resolved(bsdf)?;
        if resolved.has_texture() {
            self.check_uv(bsdf, kind);
        }
        if bsdf.tag() != "ref" || resolved.kind() == "null" {
            return self.bsdf(resolved, true, 0);
        }
        Some(Surface::Bsdf(bsdf.node(json!(bsdf.required("id")?))))
    }

    /// Refuses textures where uv of both programs differ.
    fn check_uv(&self, part: Element<'a>, kind: &str) {
        if !["rectangle", "mesh"].contains(&kind) {
            part.refuse(&format!("textures lie otherwise on our `{kind}`"), Some("use a rectangle or a mesh with uv".into()));
        }
    }

    fn area(&self, emitter: Element<'a>, kind: &str) -> Option<Node> {
        if emitter.kind() != "area" {
            emitter.refuse_kind(&["area"]);
            return None;
        }
        let mut fields = Fields::of(emitter);
        if emitter.has_texture() {
            self.check_uv(emitter, kind);
        }
        let radiance = self.texture(&mut fields, "radiance", Meaning::Light).or_else(|| missing(emitter, "radiance"));
        fields.finish();
        Some(emitter.kind_map("area", [("radiance", radiance)]))
    }

    fn emitter(&self, emitter: Element<'a>) -> Option<Node> {
        let mut fields = Fields::of(emitter);
        let steps = fields.transform("to_world");
        let to_world = placed(emitter, &steps)?;
        let node = match emitter.kind() {
            "point" => {
                let position = match fields.take(&["point"], "position") {
                    Some(position) => position.vector(0.0)?,
                    None => to_world.translation.to_array(),
                };
                let intensity = self.texture(&mut fields, "intensity", Meaning::Light).or_else(|| missing(emitter, "intensity"));
                emitter.kind_map("point", [("position", Some(emitter.node(json!(position)))), ("intensity", intensity)])
            }
            "directional" => {
                let way = match fields.take(&["vector"], "direction") {
                    Some(direction) => direction.vector(0.0)?.map(|axis| -axis),
                    None => (-to_world.matrix3.z_axis).to_array(),
                };
                let irradiance = self.texture(&mut fields, "irradiance", Meaning::Light).or_else(|| missing(emitter, "irradiance"));
                emitter.kind_map("directional", [("towards", Some(emitter.node(json!(way)))), ("irradiance", irradiance)])
            }
            "spot" => {
                let [position, target, _] = view(&steps, &to_world);
                let cutoff = fields.number("cutoff_angle").unwrap_or(20.0);
                let beam = fields.number("beam_width").unwrap_or(0.75 * cutoff);
                let node = |value: Json| Some(emitter.node(value));
                let intensity = self.texture(&mut fields, "intensity", Meaning::Light).or_else(|| missing(emitter, "intensity"));
                let parameters = [
                    ("position", node(json!(position.to_array()))),
                    ("target", node(json!(target.to_array()))),
                    ("intensity", intensity),
                    ("cutoff_degrees", node(json!(cutoff))),
                    ("beam_degrees", node(json!(beam))),
                    ("falloff", node(json!("mitsuba"))),
                ];
                emitter.kind_map("spot", parameters)
            }
            "constant" => {
                let radiance = fields.take(&["float", "integer", "rgb"], "radiance").or_else(|| missing(emitter, "radiance"))?;
                emitter.kind_map("environment", [("radiance", Some(color(radiance)?))])
            }
            "envmap" => {
                let path = fields.file("filename").or_else(|| missing(emitter, "filename"));
                let strength = fields.number_node("scale");
                fields.ignore(&["mis_compensation"]);
                let turn = turn_about_y(&to_world).or_else(|| {
                    emitter.refuse("a map of ours stands upright: `to_world` may turn it about y alone", None);
                    None
                })?;
                // What we have at +z stands at +x there.
                let turn = Some(emitter.node(json!(90.0 + turn)));
                emitter.kind_map("environment", [("path", path), ("strength", strength), ("rotate_degrees", turn)])
            }
            _ => {
                emitter.refuse_kind(&["point", "directional", "spot", "constant", "envmap"]);
                return None;
            }
        };
        fields.finish();
        Some(node)
    }

    fn medium(&self, medium: Element<'a>, shape: Element<'a>, shape_steps: &[Step]) -> Option<Node> {
        let mut fields = Fields::of(medium);
        let scale = fields.number("scale").unwrap_or(1.0);
        let phase = match fields.take_one("phase") {
            Some(phase) => Some(self.phase(phase)?),
            None => None,
        };
        let albedo = self.value_of(&mut fields, "albedo").unwrap_or([0.75; 3]);
        let parameters = |sigma_t: f64, more: (&'static str, Option<Node>)| {
            let sigma_t = Some(medium.node(json!(sigma_t)));
            [("sigma_t", sigma_t), ("albedo", Some(medium.node(json!(albedo)))), ("phase", phase), more]
        };
        let node = match medium.kind() {
            "homogeneous" => {
                let sigma_t = self.value_of(&mut fields, "sigma_t").unwrap_or([1.0; 3]);
                if sigma_t[0] != sigma_t[1] || sigma_t[0] != sigma_t[2] {
                    let hint = "color can come from the `albedo`".to_owned();
                    medium.refuse("a medium of ours has a grey `sigma_t`: one number for all channels", Some(hint));
                }
                medium.kind_map("homogeneous", parameters(scale * sigma_t[0], ("", None)))
            }
            "heterogeneous" => {
                let volume = fields.take(&["volume", "ref"], "sigma_t").and_then(|volume| self.resolved(volume));
                let file = self.grid(volume.or_else(|| missing(medium, "sigma_t"))?, shape, shape_steps)?;
                medium.kind_map("grid", parameters(scale, ("path", Some(file))))
            }
            _ => {
                medium.refuse_kind(&["homogeneous", "heterogeneous"]);
                return None;
            }
        };
        fields.ignore(&["sample_emitters"]);
        fields.finish();
        Some(node)
    }

    fn phase(&self, phase: Element<'a>) -> Option<Node> {
        let mut fields = Fields::of(phase);
        let node = match phase.kind() {
            "isotropic" => phase.kind_map("isotropic", []),
            "hg" => phase.kind_map("henyey-greenstein", [("g", Some(phase.node(json!(fields.number("g").unwrap_or(0.8)))))]),
            _ => {
                phase.refuse_kind(&["isotropic", "hg"]);
                return None;
            }
        };
        fields.finish();
        Some(node)
    }

    /// A number or a color, which may stand in a constant volume.
    fn value_of(&self, fields: &mut Fields<'a>, name: &'static str) -> Option<[f64; 3]> {
        let part = self.resolved(fields.take(&["float", "integer", "rgb", "volume", "ref"], name)?)?;
        if part.tag() != "volume" {
            return part.triple("value");
        }
        if part.kind() != "constvolume" {
            part.refuse_kind(&["constvolume"]);
            return None;
        }
        let mut inner = Fields::of(part);
        let value = inner.take(&["float", "integer", "rgb"], "value").or_else(|| missing(part, "value"));
        inner.finish();
        value?.triple("value")
    }

    /// The file of a grid, which must lie where its shape lies.
    fn grid(&self, volume: Element<'a>, shape: Element<'a>, shape_steps: &[Step]) -> Option<Node> {
        if volume.kind() != "gridvolume" {
            volume.refuse_kind(&["gridvolume"]);
            return None;
        }
        let mut fields = Fields::of(volume);
        // From the unit cube; the one around our shapes goes from -1 to 1.
        let steps = fields.transform("to_world");
        let of_grid = placed(volume, &steps)? * DAffine3::from_scale(DVec3::splat(0.5)) * DAffine3::from_translation(DVec3::ONE);
        let of_shape = placed(shape, shape_steps)?;
        if shape.kind() != "cube" || !of_grid.abs_diff_eq(of_shape, 1e-6 * (1.0 + of_shape.translation.length())) {
            let hint = "let `to_world` of the volume take [0, 1]³ to where the shape's takes [-1, 1]³".to_owned();
            volume.refuse("a grid of ours fills its shape, which must be a `cube` of the same extent", Some(hint));
        }
        let is_default = |found: Option<(Element<'a>, String)>, usual: &str| {
            if let Some((part, text)) = found
                && text != usual
            {
                part.refuse(&format!("{} is read as `{usual}` alone", part.described()), None);
            }
        };
        is_default(fields.text("filter_type"), "trilinear");
        is_default(fields.text("wrap_mode"), "clamp");
        fields.ignore(&["raw", "accel"]);
        let file = fields.file("filename").or_else(|| missing(volume, "filename"));
        fields.finish();
        file
    }
}

/// What the values of a texture are for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Meaning {
    Color,
    Light,
    Number,
    Index,
    Normals,
}

/// Says that a part is missing.
fn missing<T>(owner: Element<'_>, name: &str) -> Option<T> {
    owner.refuse(&format!("{} has no `{name}`", owner.described()), None);
    None
}

/// The map of some steps, which all exist.
pub fn placed(owner: Element<'_>, steps: &[Step]) -> Option<DAffine3> {
    affine(steps).map_err(|error| owner.refuse(&error.to_string(), None)).ok()
}

/// Origin, a point ahead (along +z) and the way up of what stands there: as written, where that is all that is written.
pub fn view(steps: &[Step], to_world: &DAffine3) -> [DVec3; 3] {
    if let Some((Step::LookAt(look), [])) = steps.split_last() {
        return [look.origin, look.target, look.up].map(DVec3::from);
    }
    let ahead = to_world.matrix3.z_axis.normalize_or_zero();
    [to_world.translation, to_world.translation + ahead, to_world.matrix3.y_axis.normalize_or_zero()]
}

/// The angle in degrees of a right-handed turn about +y, if there is nothing else in the map but a shift.
fn turn_about_y(to_world: &DAffine3) -> Option<f64> {
    let ahead = to_world.matrix3.z_axis;
    let degrees = elementary::atan2(ahead.x, ahead.z).to_degrees();
    let turn = DMat3::from_rotation_y(degrees.to_radians());
    to_world.matrix3.abs_diff_eq(turn, 1e-6).then_some(degrees)
}

/// `value="r, g, b"`.
pub fn color(part: Element<'_>) -> Option<Node> {
    Some(part.node(json!(part.triple("value")?)))
}

/// Mitsuba's bell curve ends at four standard deviations.
fn gaussian(owner: Element<'_>, deviation: f64) -> Node {
    owner.node(json!({ "gaussian": { "deviation": deviation, "radius": 4.0 * deviation } }))
}

/// The horizontal field of view for a ratio of width to height.
fn horizontal_fov(fields: &mut Fields<'_>, aspect: f64) -> Option<f64> {
    let owner = fields.owner();
    let fov = fields.number("fov").or_else(|| missing(owner, "fov"))?;
    let axis = fields.text("fov_axis").map_or_else(|| "x".to_owned(), |(_, axis)| axis);
    // Tangent of half the angle across the picture, over that across the axis at hand.
    let factor = match axis.as_str() {
        "x" => 1.0,
        "y" => aspect,
        "diagonal" => aspect / (1.0 + aspect * aspect).sqrt(),
        "smaller" => aspect.max(1.0),
        "larger" => aspect.min(1.0),
        _ => {
            owner.refuse(&format!("the axis `{axis}` of the field of view is not read"), None);
            return None;
        }
    };
    let half = 0.5 * fov.to_radians();
    if factor == 1.0 { Some(fov) } else { Some(2.0 * elementary::atan(factor * elementary::tan(half)).to_degrees()) }
}

/// Index of refraction inside over outside.
fn eta(fields: &mut Fields<'_>, usual: f64) -> Option<Node> {
    let owner = fields.owner();
    let inside = index_of(fields, "int_ior", usual)?;
    let outside = index_of(fields, "ext_ior", 1.000277)?;
    Some(owner.node(json!(inside / outside)))
}

/// An index of refraction: a number, or the name of a substance.
fn index_of(fields: &mut Fields<'_>, name: &'static str, usual: f64) -> Option<f64> {
    let Some(part) = fields.take(&["float", "integer", "string"], name) else { return Some(usual) };
    if part.tag() != "string" {
        return part.number("value");
    }
    let substance = part.required("value")?;
    let found = INDICES.iter().find(|(known, _)| *known == substance).map(|(_, index)| *index);
    if found.is_none() {
        let known: Vec<&str> = INDICES.iter().map(|(name, _)| *name).collect();
        part.refuse(&format!("the substance `{substance}` is not known"), Some(format!("known are {}", known.join(", "))));
    }
    found
}

/// Indices of refraction by Mitsuba's names.
const INDICES: [(&str, f64); 12] = [
    ("vacuum", 1.0),
    ("air", 1.000277),
    ("water ice", 1.31),
    ("water", 1.333),
    ("ethanol", 1.361),
    ("fused quartz", 1.458),
    ("pyrex", 1.47),
    ("acrylic glass", 1.49),
    ("polypropylene", 1.49),
    ("bk7", 1.5046),
    ("sodium chloride", 1.544),
    ("diamond", 2.419),
];

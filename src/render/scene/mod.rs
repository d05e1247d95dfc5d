//! A scene as a person writes it, what is wrong with it, and the flat tables it becomes.
//!
//! World: right-handed, +y up. Every part is one kind key with its parameters; what the schema cannot see is in
//! [`SceneDescription::mistakes`], with the path of the field at fault. Reading order: this file, `placed`, `compiled`.

pub mod compiled;
pub mod placed;
pub mod vector;

use std::collections::BTreeMap;

use glam::Vec3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::catalogue::nearest;
use crate::render::bsdf::material::Material;
use crate::render::bsdf::{BsdfDescription, DirectionSampling};
use crate::render::camera::CameraDescription;
use crate::render::emitter::{DirectionalParameters, EmitterDescription, EnvironmentParameters};
use crate::render::film::{FilmDescription, LayerKind};
use crate::render::integrator::IntegratorDescription;
use crate::render::medium::media::MEDIA_LIMIT;
use crate::render::sampler::SamplerDescription;
use crate::render::scene::placed::{BsdfChoice, PlacedShape};
use crate::render::transform;

/// What is rendered, and how.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SceneDescription {
    /// Where the picture is taken from. Default `perspective` at `[0, 0, 4]`, looking at the origin.
    #[serde(default)]
    pub camera: CameraDescription,
    /// How large the picture is and what it holds beside the color.
    #[serde(default)]
    pub film: FilmDescription,
    /// How many samples a pixel has, and how they are spread. Default `sobol` with 16.
    #[serde(default)]
    pub sampler: SamplerDescription,
    /// How radiance is estimated. Default `path`.
    #[serde(default)]
    pub integrator: IntegratorDescription,
    /// BSDFs by name, for use by several shapes.
    #[serde(default)]
    pub materials: BTreeMap<String, BsdfDescription>,
    /// What rays hit: each entry names one kind of shape, and may have `transform`, `bsdf`, `emitter` and `medium`.
    #[serde(default)]
    pub shapes: Vec<PlacedShape>,
    /// Light that is no shape's. The map of `env` and the lights of `lights` are there without an entry.
    #[serde(default)]
    pub emitters: Vec<EmitterDescription>,
}

/// Something that the schema of single fields cannot show.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SceneMistake {
    /// Path of the field, within the scene: `shapes[1].bsdf`.
    pub field: String,
    /// What is wrong.
    pub message: String,
    /// What to do, if it can be said.
    pub hint: Option<String>,
}

/// Most shapes and emitters of a scene.
const PART_LIMIT: usize = 1 << 20;
/// Most numbers that a film may add up, in bytes.
const FILM_LIMIT: usize = 64 << 30;

impl SceneDescription {
    /// Everything that is wrong beyond single fields; nothing is loaded or generated for it.
    pub fn mistakes(&self) -> Vec<SceneMistake> {
        let mut found = Vec::new();
        self.camera_mistakes(&mut found);
        self.film_mistakes(&mut found);
        self.material_mistakes(&mut found);
        self.shape_mistakes(&mut found);
        self.medium_mistakes(&mut found);
        self.emitter_mistakes(&mut found);
        found
    }

    /// Samples of each replicate.
    pub fn samples_per_replicate(&self) -> u32 {
        self.sampler.samples_per_pixel() / self.replicates()
    }

    /// Independently scrambled sets of samples: as written, else two where an error bar is asked for that one
    /// sequence cannot give.
    pub fn replicates(&self) -> u32 {
        let usual = if self.needs_replicates() { 2 } else { 1 };
        self.sampler.replicates().unwrap_or(usual)
    }

    fn needs_replicates(&self) -> bool {
        self.film.has(LayerKind::Variance) && !matches!(self.sampler, SamplerDescription::Independent(_))
    }

    fn camera_mistakes(&self, found: &mut Vec<SceneMistake>) {
        if let Err(error) = self.camera.compiled(self.film.resolution) {
            let field = format!("camera.{}.{}", self.camera.name(), error.field());
            found.push(SceneMistake { field, message: error.to_string(), hint: None });
        }
    }

    fn film_mistakes(&self, found: &mut Vec<SceneMistake>) {
        let (samples, replicates) = (self.sampler.samples_per_pixel(), self.replicates());
        let mut add = |field: &str, message: String, hint: &str| {
            found.push(SceneMistake { field: field.into(), message, hint: Some(hint.into()) });
        };
        if self.needs_replicates() && replicates < 2 {
            add("sampler", "the layer `variance` needs at least 2 `replicates` with this sampler".into(), "set `replicates: 2`");
        }
        if !samples.is_multiple_of(replicates) {
            let message = format!("`samples_per_pixel` is `{samples}`, which cannot be split into {replicates} replicates");
            let next = samples.next_multiple_of(replicates);
            add("sampler", message, &format!("for example `samples_per_pixel: {next}`"));
        }
        if self.film.has(LayerKind::Variance) && samples < 2 {
            add("sampler", "the layer `variance` needs at least 2 samples a pixel".into(), "raise `samples_per_pixel`");
        }
        let bytes = self.film.pixel_count().saturating_mul(replicates as usize).saturating_mul(56);
        if bytes > FILM_LIMIT {
            let message = format!("the sums of that many pixels need {} GiB, over the limit of {}", bytes >> 30, FILM_LIMIT >> 30);
            add("film.resolution", message, "lower `resolution` or `replicates`");
        }
    }

    fn material_mistakes(&self, found: &mut Vec<SceneMistake>) {
        for (name, description) in &self.materials {
            if let Err(error) = Material::new(description, DirectionSampling::default()) {
                let field = format!("materials.{name}");
                found.push(SceneMistake { field, message: error.to_string(), hint: None });
            }
        }
    }

    fn shape_mistakes(&self, found: &mut Vec<SceneMistake>) {
        if self.shapes.len() > PART_LIMIT {
            let message = format!("a scene has at most {PART_LIMIT} shapes, found {}", self.shapes.len());
            found.push(SceneMistake { field: "shapes".into(), message, hint: None });
        }
        for (index, shape) in self.shapes.iter().enumerate() {
            if let Some(error) = shape.shape.contradiction() {
                found.push(SceneMistake { field: format!("shapes[{index}]"), message: error.to_string(), hint: None });
            }
            let mut add = |part: &str, message: String, hint: Option<String>| {
                found.push(SceneMistake { field: format!("shapes[{index}].{part}"), message, hint });
            };
            if let Err(error) = transform::affine(&shape.transform) {
                add("transform", error.to_string(), None);
            }
            match &shape.bsdf {
                Some(BsdfChoice::Named(name)) if !self.materials.contains_key(name) => {
                    let (message, hint) = self.unknown_material(name);
                    add("bsdf", message, Some(hint));
                }
                Some(BsdfChoice::Inline(description)) => {
                    if let Err(error) = Material::new(description, DirectionSampling::default()) {
                        add("bsdf", error.to_string(), None);
                    }
                }
                _ => {}
            }
        }
    }

    fn medium_mistakes(&self, found: &mut Vec<SceneMistake>) {
        let mut count = 0;
        for (index, shape) in self.shapes.iter().enumerate() {
            let Some(medium) = &shape.medium else { continue };
            count += 1;
            let mut add = |part: &str, message: String, hint: &str| {
                found.push(SceneMistake { field: format!("shapes[{index}]{part}"), message, hint: Some(hint.into()) });
            };
            if !self.integrator.follows_media() {
                add(".medium", "the integrator sees no media".into(), "set `integrator: { volume-path: {} }`");
            }
            if count == MEDIA_LIMIT + 1 {
                add(".medium", format!("a scene has at most {MEDIA_LIMIT} shapes with a medium"), "put densities on a grid");
            }
            if !shape.shape.is_closed() {
                add("", "a medium fills a shape, and this one has no inside".into(), "take a `box`, a `sphere` or a closed mesh");
            }
            if let Some((parameter, message)) = medium.contradiction() {
                add(format!(".medium.{}.{parameter}", medium.name()).trim_end_matches('.'), message, "see `pipeline stages render`");
            }
            if self.is_opaque(shape) {
                let message = "no light gets through this surface to its medium".to_owned();
                add("", message, "leave out `bsdf` and `emitter`, or take a `dielectric`");
            }
        }
    }

    /// Whether a shape is a surface through which no light passes.
    fn is_opaque(&self, shape: &PlacedShape) -> bool {
        let description = match &shape.bsdf {
            Some(BsdfChoice::Named(name)) => self.materials.get(name),
            Some(BsdfChoice::Inline(description)) => Some(description),
            None => return !shape.is_boundary(),
        };
        let material = description.and_then(|description| Material::new(description, DirectionSampling::default()).ok());
        material.is_some_and(|material| !material.is_transmissive())
    }

    fn unknown_material(&self, name: &str) -> (String, String) {
        let names: Vec<&str> = self.materials.keys().map(String::as_str).collect();
        let hint = match nearest(name, names.iter().copied()) {
            Some(near) => format!("did you mean `{near}`?"),
            None if names.is_empty() => "define it under `materials`, or write the BSDF here".to_owned(),
            None => format!("the materials are `{}`", names.join("`, `")),
        };
        (format!("there is no material `{name}`"), hint)
    }

    fn emitter_mistakes(&self, found: &mut Vec<SceneMistake>) {
        let (mut environments, mut light_sets) = (0, 0);
        for (index, emitter) in self.emitters.iter().enumerate() {
            let mut add = |part: &str, message: &str| {
                found.push(SceneMistake { field: format!("emitters[{index}]{part}"), message: message.into(), hint: None });
            };
            match emitter {
                EmitterDescription::Environment(parameters) => {
                    environments += 1;
                    if environments > 1 {
                        add("", "a scene has one environment, and it has one already");
                    }
                    if parameters.path.is_some() && parameters.radiance.is_some() {
                        add(".environment.radiance", "`path` and `radiance` both say what is around the scene");
                    }
                }
                EmitterDescription::Lights(_) => {
                    light_sets += 1;
                    if light_sets > 1 {
                        add("", "the lights of `lights` are in the scene already");
                    }
                }
                EmitterDescription::Directional(DirectionalParameters { towards, .. }) if towards.vec3() == Vec3::ZERO => {
                    add(".directional.towards", "`towards` is zero; it is a direction from the scene towards the light");
                }
                EmitterDescription::Spot(spot) => {
                    if let Some((field, message)) = spot.mistake() {
                        add(&format!(".spot.{field}"), &message);
                    }
                }
                EmitterDescription::Directional(_) | EmitterDescription::Point(_) => {}
            }
        }
    }

    /// The shapes that are surfaces, which those are not that are boundaries of media alone.
    pub fn surfaces(&self) -> impl Iterator<Item = &PlacedShape> {
        self.shapes.iter().filter(|shape| !shape.is_boundary())
    }

    /// The entry that says what is around the scene.
    pub fn environment(&self) -> Option<&EnvironmentParameters> {
        self.emitters.iter().find_map(|emitter| match emitter {
            EmitterDescription::Environment(parameters) => Some(parameters),
            _ => None,
        })
    }

    /// Whether the lights of `lights` are asked for by an entry of their own.
    pub fn has_lights_entry(&self) -> bool {
        self.emitters.iter().any(|emitter| matches!(emitter, EmitterDescription::Lights(_)))
    }
}

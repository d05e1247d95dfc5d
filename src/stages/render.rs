//! The kind `render`.

use std::collections::BTreeMap;
use std::num::NonZeroU32;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value as Json;

use super::grid::Shown;
use crate::catalogue::nearest;
use crate::engine::job::Job;
use crate::engine::parameter::{InputFile, Port, Section, Seed};
use crate::engine::stage::{InputSizes, Mistake, Part, ResultDeclaration, Stage, StageError};
use crate::formats::{self, Content, Limits};
use crate::image::raster::Image;
use crate::light::envmap::EnvMap;
use crate::light::lights::LightSet;
use crate::render::emitter::EnvironmentParameters;
use crate::render::film::sums::{Assembly, Block, Film, Window};
use crate::render::medium::grid::Voxels;
use crate::render::mesh::{Mesh, read};
use crate::render::picture::{self, Request};
use crate::render::scene::compiled::{Library, Scene, SceneError, Surroundings};
use crate::render::scene::{SceneDescription, SceneMistake};
use crate::render::scene_file::SceneFile;
use crate::render::shape::Shape;
use crate::render::shape::mesh::MeshShape;
use crate::render::texture::bitmap::Pixels;
use crate::render::texture::parameter::Origin;

/// Renders a scene by path tracing.
///
/// Right-handed, +y up. The map of `env` surrounds the scene and the lights of `lights` shine on it; both may be placed
/// by entries of `emitters`. Samples are addressed by seed, pixel and index: the picture is the same for any number
/// of threads, and a run with more samples goes on from one with a power of two of them.
///
/// ```yaml
/// traced:
///   render:
///     env: env
///     scene:
///       camera: { perspective: { origin: [0, 1, 4], target: [0, 0.5, 0], fov_degrees: 40 } }
///       film: { resolution: [320, 240] }
///       sampler: { sobol: { samples_per_pixel: 64 } }
///       shapes:
///         - { sphere: { center: [0, 0.5, 0], radius: 0.5 }, bsdf: { conductor: { metal: gold } } }
///   save: exr
/// ```
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Render {
    /// The map that surrounds the scene.
    #[serde(default)]
    pub env: Option<Port<EnvMap>>,
    /// Lights that shine on the scene, each from one direction.
    #[serde(default)]
    pub lights: Option<Port<LightSet>>,
    /// Meshes that shapes name by `mesh: { of: NAME }`, so that they can come from other stages.
    #[serde(default)]
    pub meshes: BTreeMap<String, Port<Mesh>>,
    /// Pictures that textures name by `bitmap: { of: NAME }`, so that they can come from other stages.
    #[serde(default)]
    pub textures: BTreeMap<String, Port<Shown>>,
    /// The scene: its parameters, or the path of a file that holds them: YAML, or a scene of Mitsuba 3 or Nori (`.xml`).
    pub scene: Section<SceneDescription>,
    /// Another seed gives another, equally good picture; by default the pipeline's.
    #[serde(default)]
    pub seed: Seed,
    /// What a part of a split render computes; no one writes it.
    #[serde(default, skip_deserializing, skip_serializing_if = "Option::is_none")]
    #[schemars(skip)]
    pub part: Option<FilmPart>,
}

/// A band of rows and the samples from one on, up to the last one of the sampler.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct FilmPart {
    /// First row, and the row after the last.
    rows: [u32; 2],
    /// Index of the first sample of each replicate.
    first_sample: u32,
}

/// A band of a split render has so many rows at least, so that several threads find something to do in it.
const BAND_ROWS: u32 = 16;

impl Stage for Render {
    const KIND: &'static str = "render";
    const VERSION: u32 = 4;
    const RESULTS: &'static [ResultDeclaration] =
        &[ResultDeclaration { name: "", types: &["image"] }, ResultDeclaration { name: "film", types: &["film"] }];
    const SPLITS: bool = true;
    type Output = (Image, Film);

    fn draws(&self) -> bool {
        true
    }

    fn mistakes(&self) -> Vec<Mistake> {
        let of_scene = |SceneMistake { field, message, hint }| Mistake { field: format!("scene.{field}"), message, hint };
        let mut mistakes: Vec<Mistake> = self.scene.0.mistakes().into_iter().map(of_scene).collect();
        mistakes.extend(self.missing_ports());
        mistakes.extend(self.mesh_mistakes());
        mistakes.extend(self.texture_mistakes());
        mistakes
    }

    fn caveats(&self) -> Vec<String> {
        self.scene.0.integrator.caveats()
    }

    /// The sums, the picture, and about as much for the scene as its inputs hold.
    fn memory(&self, inputs: &InputSizes) -> u64 {
        let film = &self.scene.0.film;
        let per_pixel = 56 * u64::from(self.scene.0.replicates()) + 16 + 12 * film.layers.len() as u64;
        self.window().pixel_count() as u64 * per_pixel + 2 * inputs.values().sum::<u64>()
    }

    /// The same with a smaller power of two of samples in each replicate, of the whole film before its part.
    fn prefixes(&self) -> Vec<Self> {
        let with = |count: u32| {
            let whole = Self { part: None, ..self.with_samples(count) };
            std::iter::once(whole).chain(self.part.map(|_| self.with_samples(count)))
        };
        self.prefix_counts().into_iter().flat_map(with).collect()
    }

    /// Bands of rows; where there are too few rows for so many, blocks of samples of each.
    fn parts(&self, count: NonZeroU32) -> Vec<Part<Self>> {
        let window = self.window();
        let bands = count.get().min(window.height() as u32 / BAND_ROWS).max(1);
        let blocks = self.blocks(count.get() / bands);
        if bands == 1 && blocks.len() < 2 {
            return Vec::new();
        }
        let prefixes = self.prefix_counts();
        let part = |window: Window, block: Block| {
            let end = block.first + block.count;
            let part = FilmPart { rows: [window.y0, window.y1], first_sample: block.first };
            // The first samples of the whole film are a render like any other.
            let is_prefix = bands == 1 && block.first == 0;
            let parameters = Self { part: (!is_prefix).then_some(part), ..self.with_samples(end) };
            Part { parameters, within: prefixes.iter().filter(|count| **count >= end).count() }
        };
        window
            .bands(bands)
            .flat_map(|window| blocks.iter().map(move |block| (window, *block)))
            .map(|(window, block)| part(window, block))
            .collect()
    }

    fn run(&self, job: &Job<'_>) -> Result<(Image, Film), StageError> {
        let description = &self.scene.0;
        let scene = self.compiled(job)?;
        let start = job.earlier::<Film>();
        let request = Request { window: self.window(), block: self.block(), replicates: description.replicates(), start: start.as_deref() };
        let film = match assembled(&request, job)? {
            Some(film) => film,
            None => picture::render(&scene, &request, || job.check(), |part| job.report_progress(part))?,
        };
        warn(&scene, &film, job);
        Ok((film.image(&description.film), film))
    }
}

/// What the parts of the job and the film to go on from make together, if that is all of it.
fn assembled(request: &Request<'_>, job: &Job<'_>) -> Result<Option<Film>, StageError> {
    let mut parts = job.parts::<Film>().peekable();
    if parts.peek().is_none() {
        return Ok(None);
    }
    let mut assembly = Assembly::new(request.window, request.block, request.replicates);
    for part in parts {
        job.check()?;
        let part = Arc::unwrap_or_clone(part?);
        let start = request.start.filter(|_| !assembly.expects(&part)).and_then(|start| start.cropped(part.window));
        if !start.is_none_or(|start| assembly.take(start)) || !assembly.take(part) {
            return Ok(None);
        }
    }
    Ok(assembly.finish())
}

impl Render {
    /// The pixels that it computes.
    fn window(&self) -> Window {
        let whole = Window::whole(self.scene.0.film.resolution);
        self.part.map_or(whole, |FilmPart { rows: [y0, y1], .. }| Window { y0, y1, ..whole })
    }

    /// The samples of each replicate that it computes.
    fn block(&self) -> Block {
        let first = self.part.map_or(0, |part| part.first_sample);
        Block { first, count: self.scene.0.samples_per_replicate() - first }
    }

    /// The same with so many samples in each replicate, where a shorter render is the beginning of a longer one.
    fn with_samples(&self, count: u32) -> Self {
        let (mut fewer, scene) = (self.clone(), &self.scene.0);
        if scene.sampler.is_prefix_stable() {
            let samples = NonZeroU32::new(count * scene.replicates()).expect("a block of samples is not empty");
            fewer.scene.0.sampler = scene.sampler.with_samples(samples);
        }
        fewer
    }

    /// Smaller numbers of samples in each replicate from whose sums it can go on, the largest first.
    fn prefix_counts(&self) -> Vec<u32> {
        let Block { first, count } = self.block();
        let counts = (0..count.max(1).ilog2() + 1).rev().map(|level| 1 << level).filter(|fewer| *fewer < count);
        counts.filter(|_| first == 0 && self.scene.0.sampler.is_prefix_stable()).collect()
    }

    /// Its samples in so many blocks at most, each at a node of the tree of samples.
    fn blocks(&self, most: u32) -> Vec<Block> {
        let Block { first, count } = self.block();
        if most < 2 || !self.scene.0.sampler.is_prefix_stable() {
            return vec![Block { first, count }];
        }
        let size = count.div_ceil(most).next_power_of_two();
        (first..first + count).step_by(size as usize).map(|start| Block { first: start, count: size.min(first + count - start) }).collect()
    }

    fn compiled(&self, job: &Job<'_>) -> Result<Scene, StageError> {
        let (env, lights) = (job.optional_input(&self.env)?, job.optional_input(&self.lights)?);
        let surroundings = Surroundings { env: env.as_deref(), lights: lights.as_deref(), seed: job.seed(self.seed) };
        Scene::new(&self.scene.0, &surroundings, &mut Files { render: self, job }, || job.check()).map_err(|error| match error {
            SceneError::Outside(error) => error,
            other => StageError::content(other),
        })
    }

    /// The mesh of a file or of another stage, with the normals that the shape asks for.
    fn mesh(&self, shape: &MeshShape, job: &Job<'_>) -> Result<Arc<Mesh>, StageError> {
        if let Some(port) = shape.of.as_ref().and_then(|name| self.meshes.get(name)) {
            let mesh = job.input(port)?;
            return Ok(Arc::new(shape.normals.of((*mesh).clone())));
        }
        let SceneFile(path) = shape.path.as_ref().ok_or_else(|| StageError::content("a mesh has neither a file nor a stage"))?;
        let buffers = shape.buffers.iter().map(|SceneFile(path)| Ok((path, job.read(&InputFile(path.clone()))?)));
        let buffers: Vec<(&PathBuf, Vec<u8>)> = buffers.collect::<Result<_, StageError>>()?;
        let named = |name: &str| buffers.iter().find(|(path, _)| path.ends_with(name)).map(|(_, bytes)| bytes.clone());
        let in_file = |message: String| StageError::content(format!("`{}`: {message}", path.display()));
        let (mesh, warnings) = read::read(&job.read(&InputFile(path.clone()))?, &named).map_err(|error| in_file(error.to_string()))?;
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        warnings.into_iter().for_each(|warning| job.warn(format!("`{name}`: {warning}")));
        Ok(Arc::new(shape.normals.of(mesh)))
    }

    /// Meshes that are named in two ways, in none, or by a name that means nothing.
    fn mesh_mistakes(&self) -> Vec<Mistake> {
        let shapes = self.scene.0.shapes.iter().enumerate();
        let meshes = shapes.filter_map(|(index, placed)| match &placed.shape {
            Shape::Mesh(mesh) => Some((index, mesh)),
            _ => None,
        });
        meshes.filter_map(|(index, mesh)| self.mesh_mistake(index, mesh)).collect()
    }

    fn mesh_mistake(&self, index: usize, mesh: &MeshShape) -> Option<Mistake> {
        let mistake = |part: &str, message: String, hint: String| {
            Some(Mistake { field: format!("scene.shapes[{index}].mesh{part}"), message, hint: Some(hint) })
        };
        let files = mesh.path.iter().chain(&mesh.buffers);
        if let Some(file) = files.into_iter().find(|SceneFile(path)| path.to_string_lossy().starts_with("synthetic:")) {
            let message = format!("`{}` is a map and not a mesh", file.0.display());
            return mistake("", message, "meshes without a file are `icosphere`, `uv-sphere`, `torus`, `knot` and `blob`".into());
        }
        match (&mesh.path, &mesh.of) {
            (Some(_), Some(_)) => mistake(".of", "`path` and `of` both name the mesh".into(), "remove one of them".into()),
            (None, None) => {
                mistake("", "the mesh needs a `path`, or `of` with a name of the stage's `meshes`".into(), "add `path: FILE`".into())
            }
            (None, Some(name)) if !self.meshes.contains_key(name) => {
                let near = nearest(name, self.meshes.keys().map(String::as_str)).map(|near| format!("did you mean `{near}`?"));
                let hint = near.unwrap_or_else(|| format!("set `meshes: {{ {name}: STAGE }}`"));
                mistake(".of", format!("there is no mesh `{name}` among the stage's `meshes`"), hint)
            }
            _ => None,
        }
    }

    /// Pictures that are named in two ways, in none, or by a name that means nothing.
    fn texture_mistakes(&self) -> Vec<Mistake> {
        let Ok(scene) = serde_json::to_value(&self.scene.0) else { return Vec::new() };
        let mut bitmaps = Vec::new();
        blocks(&scene, "bitmap", "scene", &mut bitmaps);
        bitmaps.into_iter().filter_map(|(field, bitmap)| self.texture_mistake(field, bitmap)).collect()
    }

    fn texture_mistake(&self, field: String, bitmap: &Json) -> Option<Mistake> {
        let [path, of] = ["path", "of"].map(|key| bitmap.get(key).and_then(Json::as_str));
        let (message, hint) = match (path, of) {
            (Some(_), Some(_)) => ("`path` and `of` both name the picture".into(), "remove one of them".into()),
            (None, None) => {
                let message = "the bitmap needs a `path`, or `of` with a name of the stage's `textures`".into();
                (message, "add `path: FILE`".into())
            }
            (None, Some(name)) if !self.textures.contains_key(name) => {
                let near = nearest(name, self.textures.keys().map(String::as_str)).map(|near| format!("did you mean `{near}`?"));
                let hint = near.unwrap_or_else(|| format!("set `textures: {{ {name}: STAGE }}`"));
                (format!("there is no texture `{name}` among the stage's `textures`"), hint)
            }
            _ => return None,
        };
        Some(Mistake { field, message, hint: Some(hint) })
    }

    /// Entries of emitters that stand for what the stage was not given, or hide what it was.
    fn missing_ports(&self) -> Vec<Mistake> {
        let scene = &self.scene.0;
        let missing = [
            ("env", scene.environment().is_some_and(EnvironmentParameters::is_of_stage) && self.env.is_none(), "envmap"),
            ("lights", scene.has_lights_entry() && self.lights.is_none(), "lights"),
        ];
        let is_unseen = self.env.is_some() && scene.environment().is_some_and(|environment| !environment.is_of_stage());
        let unseen = is_unseen.then(|| Mistake {
            field: "env".into(),
            message: "the scene has an `environment` of its own, and nothing would be seen of `env`".into(),
            hint: Some("remove one of them".into()),
        });
        let mistake = |(port, _, gives): (&str, bool, &str)| Mistake {
            field: "scene.emitters".into(),
            message: format!("the scene asks for the stage's `{port}`, which is missing"),
            hint: Some(format!("set `{port}` to a stage that gives {gives}")),
        };
        missing.into_iter().filter(|(_, is_missing, _)| *is_missing).map(mistake).chain(unseen).collect()
    }
}

/// What the scene of a job names.
struct Files<'a, 'j> {
    render: &'a Render,
    job: &'a Job<'j>,
}

impl Library for Files<'_, '_> {
    type Error = StageError;

    fn mesh(&mut self, shape: &MeshShape) -> Result<Arc<Mesh>, StageError> {
        self.render.mesh(shape, self.job)
    }

    fn pixels(&mut self, origin: &Origin) -> Result<Pixels, StageError> {
        match origin {
            Origin::File(SceneFile(path)) => picture_file(path, self.job),
            Origin::Stage(name) => {
                let port = self.render.textures.get(name).ok_or_else(|| StageError::content(format!("there is no texture `{name}`")))?;
                Ok(match self.job.input(port)? {
                    Shown::Picture(picture) => Pixels::Display((*picture).clone()),
                    Shown::Image(image) => Pixels::Linear(image.color.clone()),
                    Shown::Map(map) => Pixels::Linear(map.raster.clone()),
                })
            }
        }
    }

    fn voxels(&mut self, SceneFile(path): &SceneFile) -> Result<Voxels, StageError> {
        let bytes = self.job.read(&InputFile(path.clone()))?;
        Voxels::read(&bytes).map_err(|error| StageError::content(format!("`{}`: {error}", path.display())))
    }
}

/// The pixels of a picture's file, without its alpha.
fn picture_file(path: &Path, job: &Job<'_>) -> Result<Pixels, StageError> {
    let bytes = job.read(&InputFile(path.to_owned()))?;
    let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let in_file = |error| StageError::content(format!("`{}`: {error}", path.display()));
    let decoded = formats::read(&bytes, &name, &Limits::default()).map_err(in_file)?;
    decoded.warnings.into_iter().for_each(|warning| job.warn(format!("`{name}`: {warning}")));
    Ok(match decoded.content {
        Content::Linear(image) => Pixels::Linear(image.color),
        Content::Display(picture) => Pixels::Display(picture),
    })
}

/// The blocks of that name anywhere in a scene, with their paths, so that every texture is found wherever one may stand.
fn blocks<'j>(json: &'j Json, name: &str, path: &str, found: &mut Vec<(String, &'j Json)>) {
    let fields = json.as_object().into_iter().flatten().map(|(key, value)| (format!("{path}.{key}"), key == name, value));
    let items = json.as_array().into_iter().flatten().enumerate().map(|(index, value)| (format!("{path}[{index}]"), false, value));
    for (path, is_found, value) in fields.chain(items) {
        if is_found {
            found.push((path.clone(), value));
        }
        blocks(value, name, &path, found);
    }
}

/// What the reader of the manifest should know of what was found in the inputs and the samples.
fn warn(scene: &Scene, film: &Film, job: &Job<'_>) {
    if scene.negative_count > 0 {
        job.warn(format!("{} pixels of `env` have a negative channel, which counts as zero", scene.negative_count));
    }
    if let Some(at) = film.refused.first {
        let where_first = format!("pixel ({}, {}), sample {} of replicate {}", at.x, at.y, at.index, at.replicate);
        job.warn(format!("{} samples are not finite and count as zero; the first is {where_first}", film.refused.count));
    }
}

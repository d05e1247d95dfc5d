//! A scene in the form in which it is traced: flat tables, everything loaded and checked.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::sync::Arc;

use glam::{DAffine3, DMat3, DVec3, Vec3};

use crate::image::raster::Raster;
use crate::light::envmap::EnvMap;
use crate::light::lights::LightSet;
use crate::math::elementary;
use crate::render::bsdf::BsdfDescription;
use crate::render::bsdf::BsdfError;
use crate::render::bsdf::diffuse::DiffuseParameters;
use crate::render::bsdf::material::Material;
use crate::render::camera::{Camera, CameraError};
use crate::render::emitter::environment::{Environment, EnvironmentError};
use crate::render::emitter::lights::{Lights, Source};
use crate::render::emitter::{EmitterDescription, EnvironmentParameters, LightsParameters, ShapeEmitter};
use crate::render::film::filter::Filter;
use crate::render::film::{Background, LayerKind};
use crate::render::integrator::Integrator;
use crate::render::medium::grid::Voxels;
use crate::render::medium::media::Media;
use crate::render::medium::{Medium, MediumDescription, MediumError, Place, Tracking};
use crate::render::mesh::Mesh;
use crate::render::sampler::Sampler;
use crate::render::scene::SceneDescription;
use crate::render::scene::placed::BsdfChoice;
use crate::render::scene_file::SceneFile;
use crate::render::shape::geometry::{Geometry, Placed};
use crate::render::shape::mesh::MeshShape;
use crate::render::shape::{Form, Shape, ShapeError, forms};
use crate::render::texture::bitmap::{Decoding, Pixels, TexelError};
use crate::render::texture::parameter::{Origin, Parameter, Pictures, Reflectance};
use crate::render::texture::value::{Color, Value};
use crate::render::transform::{self, TransformError};

/// A scene to trace.
#[derive(Debug, Clone)]
pub struct Scene {
    /// Where rays begin.
    pub camera: Camera,
    /// Where samples of a pixel lie.
    pub filter: Filter,
    /// What stands where nothing is hit.
    pub background: Background,
    /// The numbers of the samples.
    pub sampler: Sampler,
    /// What samples add up beside the color.
    pub kept: Kept,
    /// How radiance is estimated.
    pub integrator: Integrator,
    /// What rays hit.
    pub geometry: Geometry,
    /// What is between the surfaces.
    pub media: Media,
    /// Where light comes from.
    pub lights: Lights,
    /// What negative pixels the map had; they count as zero.
    pub negative_count: u64,
    materials: Vec<Material>,
    /// By shape: index of its material.
    material_of_shape: Vec<u32>,
}

/// What samples add up beside the color.
#[derive(Debug, Clone, Copy)]
pub struct Kept {
    /// Squares of the color, where the variance comes from them.
    pub squares: bool,
    /// Albedo of the first surface.
    pub albedo: bool,
    /// Normal of the first surface.
    pub normal: bool,
    /// Distance of the first surface.
    pub depth: bool,
    /// Whether there is a first surface.
    pub coverage: bool,
}

impl Kept {
    fn of(description: &SceneDescription) -> Self {
        let film = &description.film;
        Self {
            squares: film.has(LayerKind::Variance) && description.replicates() == 1,
            albedo: film.has(LayerKind::Albedo),
            normal: film.has(LayerKind::Normal),
            depth: film.has(LayerKind::Depth),
            coverage: film.has(LayerKind::Depth) || film.background == Background::Transparent,
        }
    }
}

/// What a scene takes from outside.
pub struct Surroundings<'a> {
    /// The map around everything.
    pub env: Option<&'a EnvMap>,
    /// Lights of one direction each.
    pub lights: Option<&'a LightSet>,
    /// The seed of all samples.
    pub seed: u64,
}

/// Files and results of other stages that a scene names.
pub trait Library {
    /// Why something cannot be had.
    type Error: Send;

    /// The mesh of a shape, with the normals that it asks for.
    fn mesh(&mut self, shape: &MeshShape) -> Result<Arc<Mesh>, Self::Error>;

    /// The pixels of a picture.
    fn pixels(&mut self, origin: &Origin) -> Result<Pixels, Self::Error>;

    /// The densities of a grid.
    fn voxels(&mut self, file: &SceneFile) -> Result<Voxels, Self::Error>;
}

/// The library of scenes that name nothing.
#[derive(Debug, Clone, Copy, Default)]
pub struct NoLibrary;

impl Library for NoLibrary {
    type Error = std::io::Error;

    fn mesh(&mut self, _: &MeshShape) -> Result<Arc<Mesh>, Self::Error> {
        Err(std::io::ErrorKind::NotFound.into())
    }

    fn pixels(&mut self, _: &Origin) -> Result<Pixels, Self::Error> {
        Err(std::io::ErrorKind::NotFound.into())
    }

    fn voxels(&mut self, _: &SceneFile) -> Result<Voxels, Self::Error> {
        Err(std::io::ErrorKind::NotFound.into())
    }
}

/// Pictures of a library, each of them read and decoded once; keeps the first error.
struct Shelf<'l, L: Library> {
    library: RefCell<&'l mut L>,
    pictures: RefCell<BTreeMap<(Origin, Decoding), Arc<Raster>>>,
    error: RefCell<Option<L::Error>>,
}

impl<'l, L: Library> Shelf<'l, L> {
    fn new(library: &'l mut L) -> Self {
        Self { library: RefCell::new(library), pictures: RefCell::default(), error: RefCell::new(None) }
    }

    /// The first error.
    fn checked(&self) -> Result<(), L::Error> {
        self.error.take().map_or(Ok(()), Err)
    }
}

impl<L: Library> Pictures for Shelf<'_, L> {
    fn picture(&self, origin: &Origin, decoding: Decoding) -> Option<Arc<Raster>> {
        let key = (origin.clone(), decoding);
        if let Some(known) = self.pictures.borrow().get(&key) {
            return Some(known.clone());
        }
        match self.library.borrow_mut().pixels(origin) {
            Ok(pixels) => {
                let raster = Arc::new(pixels.decoded(decoding));
                self.pictures.borrow_mut().insert(key, raster.clone());
                Some(raster)
            }
            Err(error) => {
                self.error.borrow_mut().get_or_insert(error);
                None
            }
        }
    }
}

/// A scene that cannot be traced.
#[derive(Debug, thiserror::Error)]
pub enum SceneError<E> {
    /// A camera that sees nothing.
    #[error(transparent)]
    Camera(#[from] CameraError),
    /// A BSDF whose parameters contradict each other.
    #[error(transparent)]
    Bsdf(#[from] BsdfError),
    /// A light with a radiance that cannot be.
    #[error("light of shape {0}: {1}")]
    Light(usize, TexelError),
    /// A transform that cannot be used.
    #[error("shape {0}: {1}")]
    Transform(usize, TransformError),
    /// A shape that cannot be used.
    #[error(transparent)]
    Shape(#[from] ShapeError),
    /// A medium that cannot be used.
    #[error("medium of shape {0}: {1}")]
    Medium(usize, MediumError),
    /// A map with pixels that are not finite.
    #[error(transparent)]
    Environment(EnvironmentError<std::convert::Infallible>),
    /// A name that means nothing.
    #[error("there is no material `{0}`")]
    Material(String),
    /// What was asked from outside failed, or the work was stopped.
    #[error(transparent)]
    Outside(E),
}

/// An error of what is outside, for the closures that go through the rooms of shapes and maps.
enum Passed<E> {
    Shape(ShapeError),
    Outside(E),
}

impl<E> From<ShapeError> for Passed<E> {
    fn from(error: ShapeError) -> Self {
        Self::Shape(error)
    }
}

impl<E> From<Passed<E>> for SceneError<E> {
    fn from(error: Passed<E>) -> Self {
        match error {
            Passed::Shape(error) => Self::Shape(error),
            Passed::Outside(error) => Self::Outside(error),
        }
    }
}

impl Scene {
    /// Compiles a description; `library` gives what it names, `check` is asked often whether to stop.
    pub fn new<L: Library>(
        description: &SceneDescription,
        surroundings: &Surroundings<'_>,
        library: &mut L,
        check: impl Fn() -> Result<(), L::Error> + Sync,
    ) -> Result<Self, SceneError<L::Error>> {
        let shelf = Shelf::new(library);
        let compiled = materials(description, &shelf).and_then(|materials| Ok((materials, areas(description, &shelf)?)));
        let own_map = map_of_scene(description, &shelf);
        // A file that cannot be read comes before what is wrong with its stand-in.
        shelf.checked().map_err(SceneError::Outside)?;
        let ((materials, material_of_shape), areas) = compiled?;
        let shapes: Vec<&Shape> = description.shapes.iter().map(|placed| &placed.shape).collect();
        let forms = forms(&shapes, |mesh| library.mesh(mesh).map_err(Passed::Outside))?;
        let (mut placed, mut filled) = (Vec::with_capacity(forms.len()), Vec::new());
        for (index, (form, shape)) in forms.into_iter().zip(&description.shapes).enumerate() {
            let to_world = transform::affine(&shape.transform).map_err(|error| SceneError::Transform(index, error))?;
            let one = Placed { form, to_world, is_emitter: shape.emitter.is_some() };
            if let Some(medium) = &shape.medium {
                filled.push((index, Placed { is_emitter: false, ..one.clone() }, medium));
            }
            if !shape.is_boundary() {
                placed.push(one);
            }
        }
        let geometry = Geometry::build(&placed, || check().map_err(Passed::Outside))?;
        let media = media(&filled, description.integrator.tracking(), library, &check)?;
        let surroundings = &Surroundings { env: own_map.as_ref().or(surroundings.env), ..*surroundings };
        let (mut sources, negative_count) = sources(description, surroundings, &check)?;
        sources.extend(areas);
        let lights = Lights::new(sources, &geometry);
        Ok(Self {
            camera: description.camera.compiled(description.film.resolution)?,
            filter: description.film.filter.compiled(),
            background: description.film.background,
            sampler: description.sampler.compiled(surroundings.seed, description.samples_per_replicate()),
            kept: Kept::of(description),
            integrator: description.integrator.compiled(surroundings.env.is_some()),
            geometry,
            media,
            lights,
            negative_count,
            materials,
            material_of_shape,
        })
    }

    /// The material of a shape.
    #[inline]
    pub fn material_of(&self, shape: u32) -> &Material {
        &self.materials[self.material_of_shape[shape as usize] as usize]
    }
}

/// All materials, and which one each shape has.
fn materials<E>(description: &SceneDescription, pictures: &dyn Pictures) -> Result<(Vec<Material>, Vec<u32>), SceneError<E>> {
    let directions = description.integrator.direction_sampling();
    let names: Vec<&String> = description.materials.keys().collect();
    let mut materials: Vec<Material> =
        description.materials.values().map(|bsdf| Material::with_pictures(bsdf, directions, pictures)).collect::<Result<_, _>>()?;
    let usual = BsdfDescription::Diffuse(DiffuseParameters { reflectance: usual_reflectance(), one_sided: false });
    let mut of_shape = Vec::with_capacity(description.shapes.len());
    for placed in description.surfaces() {
        let bsdf = match &placed.bsdf {
            Some(BsdfChoice::Named(name)) => {
                let index = names.iter().position(|known| *known == name).ok_or_else(|| SceneError::Material(name.clone()))?;
                of_shape.push(index as u32);
                continue;
            }
            Some(BsdfChoice::Inline(bsdf)) => bsdf,
            None => &usual,
        };
        let material = Material::with_pictures(bsdf, directions, pictures)?;
        let index = materials.iter().position(|known| *known == material).unwrap_or_else(|| {
            materials.push(material);
            materials.len() - 1
        });
        of_shape.push(index as u32);
    }
    Ok((materials, of_shape))
}

/// What is between the surfaces, of shapes with their index in the scene.
fn media<L: Library>(
    filled: &[(usize, Placed, &MediumDescription)],
    tracking: Tracking,
    library: &mut L,
    check: &(impl Fn() -> Result<(), L::Error> + Sync),
) -> Result<Media, SceneError<L::Error>> {
    let shapes: Vec<Placed> = filled.iter().map(|(_, placed, _)| placed.clone()).collect();
    let boundaries = Geometry::build(&shapes, || check().map_err(Passed::Outside))?;
    let mut media = Vec::with_capacity(filled.len());
    for (place, (index, placed, description)) in filled.iter().enumerate() {
        let voxels = description.file().map(|file| library.voxels(file)).transpose().map_err(SceneError::Outside)?;
        let around = Place { bounds: boundaries.bounds_of_shape(place), to_world: placed.to_world * around(&placed.form) };
        let medium = Medium::new(description, &around, voxels).and_then(|medium| medium.checked(&around, tracking));
        media.push(medium.map_err(|error| SceneError::Medium(*index, error))?);
    }
    Ok(Media::new(boundaries, media, tracking))
}

/// From the cube [-1, 1]³ to the box around a form.
fn around(form: &Form) -> DAffine3 {
    match form {
        Form::Unit(_, to_place) => *to_place,
        Form::Mesh(mesh) => {
            let corners = mesh.positions().iter().map(|corner| corner.as_dvec3());
            let (min, max) = corners.fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(min, max), corner| (min.min(corner), max.max(corner)));
            DAffine3 { matrix3: DMat3::from_diagonal((max - min) / 2.0), translation: (min + max) / 2.0 }
        }
    }
}

/// Half of the light.
fn usual_reflectance() -> Reflectance {
    Parameter::Constant(Color::grey(0.5).expect("a half is between 0 and 1"))
}

/// All lights, and how many pixels of the map are negative.
fn sources<E: Send>(
    description: &SceneDescription,
    surroundings: &Surroundings<'_>,
    check: &(impl Fn() -> Result<(), E> + Sync),
) -> Result<(Vec<Source>, u64), SceneError<E>> {
    let mut sources = Vec::new();
    let mut negative_count = 0;
    let mut emitters = description.emitters.clone();
    if description.environment().is_none() {
        emitters.push(EmitterDescription::Environment(EnvironmentParameters::default()));
    }
    if !description.has_lights_entry() {
        emitters.push(EmitterDescription::Lights(LightsParameters::default()));
    }
    for emitter in &emitters {
        match emitter {
            EmitterDescription::Environment(parameters) => {
                let Some(map) = surroundings.env else { continue };
                let density = description.integrator.environment_density();
                let (environment, count) = Environment::new(map, parameters, density, check).map_err(|error| match error {
                    EnvironmentError::NotFinite { x, y } => SceneError::Environment(EnvironmentError::NotFinite { x, y }),
                    EnvironmentError::Interrupted(error) => SceneError::Outside(error),
                })?;
                negative_count = count;
                sources.push(Source::Environment(Box::new(environment)));
            }
            EmitterDescription::Lights(parameters) => {
                sources.extend(surroundings.lights.into_iter().flat_map(|set| parallel(set, parameters)))
            }
            EmitterDescription::Point(parameters) => {
                sources.push(Source::Point { position: parameters.position.vec3(), intensity: parameters.intensity.inner() });
            }
            EmitterDescription::Spot(parameters) => sources.push(Source::Spot(parameters.spot())),
            EmitterDescription::Directional(parameters) => {
                let towards = parameters.towards.vec3().normalize_or_zero();
                sources.push(Source::Directional { towards, irradiance: parameters.irradiance.inner() });
            }
        }
    }
    Ok((sources, negative_count))
}

/// The map around everything, where the scene has one of its own.
fn map_of_scene(description: &SceneDescription, pictures: &dyn Pictures) -> Option<EnvMap> {
    /// Pixels of a map that is the same everywhere.
    const SAME: [usize; 2] = [4, 2];
    let environment = description.environment()?;
    if let Some(radiance) = environment.radiance {
        return Some(EnvMap::new(Raster::filled(SAME[0], SAME[1], radiance.inner().to_array())));
    }
    let raster = pictures.picture(&Origin::File(environment.path.clone()?), Decoding::Srgb)?;
    Some(EnvMap::new((*raster).clone()))
}

/// The lights of shapes.
fn areas<E>(description: &SceneDescription, pictures: &dyn Pictures) -> Result<Vec<Source>, SceneError<E>> {
    let shining = description.surfaces().enumerate().filter_map(|(index, placed)| Some((index, placed.emitter.as_ref()?)));
    let area = |(index, ShapeEmitter::Area(area)): (usize, &ShapeEmitter)| {
        let radiance = area.radiance.texture(pictures).map_err(|error| SceneError::Light(index, error))?;
        Ok(Source::Area { shape: index as u32, radiance })
    };
    shining.map(area).collect()
}

/// The lights of a cut, turned about +y.
fn parallel<'a>(set: &'a LightSet, parameters: &LightsParameters) -> impl Iterator<Item = Source> + 'a {
    let (sine, cosine) = elementary::sin_cos(parameters.rotate_degrees.to_radians());
    let strength = f64::from(parameters.strength);
    set.lights.iter().map(move |light| {
        let DVec3 { x, y, z } = light.direction;
        let towards = DVec3::new(x * cosine + z * sine, y, z * cosine - x * sine);
        let irradiance = Vec3::from_array(light.irradiance.map(|value| (value.max(0.0) * strength).min(f64::from(f32::MAX)) as f32));
        Source::Directional { towards: towards.as_vec3().normalize_or_zero(), irradiance }
    })
}

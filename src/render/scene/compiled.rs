//! A scene in the form in which it is traced: flat tables, everything loaded and checked.

use std::sync::Arc;

use glam::{DAffine3, DMat3, DVec3, Vec3};

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
use crate::render::medium::grid::GridError;
use crate::render::medium::media::Media;
use crate::render::medium::{Medium, MediumDescription, MediumError, Place, Tracking};
use crate::render::mesh::Mesh;
use crate::render::sampler::Sampler;
use crate::render::scene::SceneDescription;
use crate::render::scene::placed::BsdfChoice;
use crate::render::shape::geometry::{Geometry, Placed};
use crate::render::shape::mesh::MeshShape;
use crate::render::shape::{Form, Shape, ShapeError, forms};
use crate::render::texture::parameter::{Parameter, Reflectance};
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

/// A scene that cannot be traced.
#[derive(Debug, thiserror::Error)]
pub enum SceneError<E> {
    /// A camera that sees nothing.
    #[error(transparent)]
    Camera(#[from] CameraError),
    /// A BSDF whose parameters contradict each other.
    #[error(transparent)]
    Bsdf(#[from] BsdfError),
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
    /// Compiles a description; `load` gives the meshes that it names, `check` is asked often whether to stop.
    pub fn new<E: Send>(
        description: &SceneDescription,
        surroundings: &Surroundings<'_>,
        mut load: impl FnMut(&MeshShape) -> Result<Arc<Mesh>, E>,
        check: impl Fn() -> Result<(), E> + Sync,
    ) -> Result<Self, SceneError<E>> {
        let (materials, material_of_shape) = materials(description)?;
        let shapes: Vec<&Shape> = description.shapes.iter().map(|placed| &placed.shape).collect();
        let forms = forms(&shapes, |mesh| load(mesh).map_err(Passed::Outside))?;
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
        let media = media(&filled, description.integrator.tracking(), &check)?;
        let (sources, negative_count) = sources(description, surroundings, &check)?;
        let lights = Lights::new(sources, &geometry);
        Ok(Self {
            camera: description.camera.compiled(description.film.resolution)?,
            filter: description.film.filter.compiled(),
            background: description.film.background,
            sampler: description.sampler.compiled(surroundings.seed, description.samples_per_replicate()),
            kept: Kept::of(description),
            integrator: description.integrator.compiled(),
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
fn materials<E>(description: &SceneDescription) -> Result<(Vec<Material>, Vec<u32>), SceneError<E>> {
    let directions = description.integrator.direction_sampling();
    let names: Vec<&String> = description.materials.keys().collect();
    let mut materials: Vec<Material> =
        description.materials.values().map(|bsdf| Material::new(bsdf, directions)).collect::<Result<_, _>>()?;
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
        let material = Material::new(bsdf, directions)?;
        let index = materials.iter().position(|known| *known == material).unwrap_or_else(|| {
            materials.push(material);
            materials.len() - 1
        });
        of_shape.push(index as u32);
    }
    Ok((materials, of_shape))
}

/// What is between the surfaces, of shapes with their index in the scene.
fn media<E: Send>(
    filled: &[(usize, Placed, &MediumDescription)],
    tracking: Tracking,
    check: &(impl Fn() -> Result<(), E> + Sync),
) -> Result<Media, SceneError<E>> {
    let shapes: Vec<Placed> = filled.iter().map(|(_, placed, _)| placed.clone()).collect();
    let boundaries = Geometry::build(&shapes, || check().map_err(Passed::Outside))?;
    let of_shape = |(place, (index, placed, description)): (usize, &(usize, Placed, &MediumDescription))| {
        let around = Place { bounds: boundaries.bounds_of_shape(place), to_world: placed.to_world * around(&placed.form) };
        let medium = Medium::new(description, &around, |_| Err(MediumError::from(GridError::Uneven)));
        let medium = medium.and_then(|medium| medium.checked(&around, tracking));
        medium.map_err(|error| SceneError::Medium(*index, error))
    };
    let media = filled.iter().enumerate().map(of_shape).collect::<Result<_, _>>()?;
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
    if !description.has_environment_entry() {
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
            EmitterDescription::Directional(parameters) => {
                let towards = parameters.towards.vec3().normalize_or_zero();
                sources.push(Source::Directional { towards, irradiance: parameters.irradiance.inner() });
            }
        }
    }
    for (index, placed) in description.surfaces().enumerate() {
        if let Some(ShapeEmitter::Area(area)) = &placed.emitter {
            sources.push(Source::Area { shape: index as u32, radiance: area.radiance.texture() });
        }
    }
    Ok((sources, negative_count))
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

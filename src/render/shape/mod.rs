//! What rays hit: shapes, meshes, transforms, instances, and the tree over them.
//!
//! [`Shape`] is the table of kinds as a scene writes them; [`Shape::form`] makes of each one of four unit shapes under a
//! transform, or a mesh. Adding a kind is one file and one row here. Reading order: this file, `placed`, `unit`, `bvh`,
//! `triangles`, `geometry`.

pub mod bvh;
pub mod cuboid;
pub mod disk;
pub mod generated;
pub mod geometry;
#[cfg(test)]
mod laws;
pub mod mesh;
pub mod rectangle;
pub mod sphere;
pub mod triangles;
pub mod unit;

use std::sync::Arc;

use glam::DAffine3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::render::mesh::{Mesh, MeshError};
use crate::render::shape::cuboid::Cuboid;
use crate::render::shape::disk::Disk;
use crate::render::shape::generated::{Blob, Icosphere, Knot, Torus, UvSphere};
use crate::render::shape::mesh::MeshShape;
use crate::render::shape::rectangle::Rectangle;
use crate::render::shape::sphere::Sphere;
use crate::render::shape::unit::Unit;

/// A shape as a scene describes it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum Shape {
    /// A sphere.
    Sphere(Sphere),
    /// The square [-1, 1]² in the plane z = 0, its normal +z.
    Rectangle(Rectangle),
    /// A disk about the origin in the plane z = 0, its normal +z.
    Disk(Disk),
    /// A box along the axes.
    Box(Cuboid),
    /// A triangle mesh from a file or another stage.
    Mesh(MeshShape),
    /// A generated sphere of triangles of nearly equal size.
    Icosphere(Icosphere),
    /// A generated sphere of triangles along circles of latitude, with an optional relief.
    UvSphere(UvSphere),
    /// A generated ring.
    Torus(Torus),
    /// A generated knotted tube, as complex as a scanned dragon.
    Knot(Knot),
    /// A generated smooth body with lobes, as complex as a scanned bunny.
    Blob(Blob),
}

/// A shape in the form in which rays meet it.
#[derive(Debug, Clone, PartialEq)]
pub enum Form {
    /// A unit shape, and the map that gives it its size and place.
    Unit(Unit, DAffine3),
    /// A mesh; shapes with the very same `Arc` share one tree.
    Mesh(Arc<Mesh>),
}

impl Shape {
    /// What of its parameters contradicts another, found without making anything.
    pub fn contradiction(&self) -> Option<ShapeError> {
        match self {
            Self::Box(cuboid) => cuboid.form().err(),
            Self::Torus(torus) => torus.contradiction(),
            _ => None,
        }
    }

    /// Whether it has an inside.
    pub fn is_closed(&self) -> bool {
        !matches!(self, Self::Rectangle(_) | Self::Disk(_))
    }

    /// Its form; `load` gives the mesh that a file or a stage names.
    pub fn form<E: From<ShapeError>>(&self, load: impl FnOnce(&MeshShape) -> Result<Arc<Mesh>, E>) -> Result<Form, E> {
        Ok(match self {
            Self::Sphere(sphere) => sphere.form(),
            Self::Rectangle(_) => Form::Unit(Unit::Rectangle, DAffine3::IDENTITY),
            Self::Disk(disk) => disk.form(),
            Self::Box(cuboid) => cuboid.form()?,
            Self::Mesh(mesh) => Form::Mesh(load(mesh)?),
            Self::Icosphere(sphere) => Form::Mesh(Arc::new(sphere.mesh().map_err(ShapeError::from)?)),
            Self::UvSphere(sphere) => Form::Mesh(Arc::new(sphere.mesh().map_err(ShapeError::from)?)),
            Self::Torus(torus) => Form::Mesh(Arc::new(torus.mesh()?)),
            Self::Knot(knot) => Form::Mesh(Arc::new(knot.mesh().map_err(ShapeError::from)?)),
            Self::Blob(blob) => Form::Mesh(Arc::new(blob.mesh().map_err(ShapeError::from)?)),
        })
    }
}

/// The forms of all shapes of a scene, in their order; equal generated meshes and equal files are one mesh.
pub fn forms<E: From<ShapeError>>(shapes: &[&Shape], mut load: impl FnMut(&MeshShape) -> Result<Arc<Mesh>, E>) -> Result<Vec<Form>, E> {
    let mut forms: Vec<Form> = Vec::with_capacity(shapes.len());
    for (index, shape) in shapes.iter().enumerate() {
        let form = match shapes[..index].iter().position(|earlier| earlier == shape) {
            Some(same) => forms[same].clone(),
            None => shape.form(&mut load)?,
        };
        forms.push(form);
    }
    Ok(forms)
}

/// Parameters of a shape that contradict each other.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ShapeError {
    /// A box without a volume.
    #[error("`min` of the box must be below `max` on every axis, but they are `{min:?}` and `{max:?}`")]
    EmptyBox {
        /// One corner.
        min: [f64; 3],
        /// The opposite corner.
        max: [f64; 3],
    },
    /// A ring that passes through itself.
    #[error("`tube_radius` of the torus is `{tube_radius}`; it must be below `radius`, which is `{radius}`")]
    FatTorus {
        /// Radius of the tube.
        tube_radius: f64,
        /// Radius of the ring.
        radius: f64,
    },
    /// A generated mesh that single precision cannot hold.
    #[error(transparent)]
    Mesh(#[from] MeshError),
    /// A size or a place that single precision cannot hold.
    #[error("shape {shape} is too large, too small or too far away for single precision; keep sizes and places between 1e-18 and 1e18")]
    OutOfRange {
        /// Its index in the scene.
        shape: usize,
    },
}

//! All shapes of a scene: what a ray meets first, whether it meets anything, the surface there, and points on lights.
//!
//! A mesh that stands in the scene once is put into world coordinates; one that stands there several times has one tree
//! in its own, and rays are moved to it. Unit shapes are met in double precision in their own coordinates.

use std::sync::Arc;

use glam::{DAffine3, DMat3, DVec3, Vec3};

use crate::render::frame::Frame;
use crate::render::mesh::Mesh;
use crate::render::ray::{AreaSample, Hit, Ray, Surface};
use crate::render::shape::bvh::{self, Bounds, Bvh};
use crate::render::shape::triangles::{TriangleHit, Triangles};
use crate::render::shape::unit::{self, Unit};
use crate::render::shape::{Form, ShapeError};

/// A shape at its place.
#[derive(Debug, Clone)]
pub struct Placed {
    /// What it is.
    pub form: Form,
    /// Where it is: from the form's coordinates to the world's.
    pub to_world: DAffine3,
    /// Whether points will be drawn from it; then its areas are tabulated.
    pub is_emitter: bool,
}

/// Shapes, ready for rays.
#[derive(Debug, Clone)]
pub struct Geometry {
    objects: Vec<Object>,
    triangles: Vec<Triangles>,
    top: Bvh,
    order: Vec<u32>,
    leaves: Vec<std::ops::Range<u32>>,
    bounds: Bounds,
}

/// A placed shape, compiled.
#[derive(Debug, Clone)]
struct Object {
    place: Place,
    solid: Solid,
}

#[derive(Debug, Clone)]
enum Solid {
    Unit(Unit),
    /// Triangles that are hit where they are; the mesh's own coordinates only matter for its normals.
    Baked {
        triangles: usize,
    },
    /// Triangles to whose coordinates the ray is moved.
    Shared {
        triangles: usize,
    },
}

/// From local coordinates to the world and back.
#[derive(Debug, Clone)]
struct Place {
    to_world: DAffine3,
    to_local: DAffine3,
    /// Maps a normal times an area; the determinant times the inverse transpose.
    cofactor: DMat3,
    /// Sign of the determinant: -1 where the map mirrors.
    handedness: f64,
    is_identity: bool,
    /// Whether it keeps angles, and so solid angles.
    is_similarity: bool,
    areas: Areas,
}

/// What it takes to draw points uniformly by area in the world.
#[derive(Debug, Clone, Default)]
enum Areas {
    /// Not an emitter.
    #[default]
    None,
    /// A unit shape: areas of pairs of faces, and their sum.
    Faces([f64; 3], f64),
    /// A mesh: sums of areas up to and including each triangle.
    Triangles(Arc<[f64]>),
}

/// How far from a triangle a new ray starts, as a part of its corners' largest coordinate: above the bound of the
/// rounding errors of a point on it (7 of f32::EPSILON / 2) and of the intersection that follows (about as many).
const TRIANGLE_ERROR: f32 = 16.0 * (f32::EPSILON / 2.0);
/// The same for a point that was computed in double precision: two roundings.
const POINT_ERROR: f32 = 4.0 * (f32::EPSILON / 2.0);

impl Geometry {
    /// Compiles the shapes of a scene, in their order; `check` is asked now and then whether to stop.
    pub fn build<E: From<ShapeError> + Send>(placed: &[Placed], check: impl Fn() -> Result<(), E> + Sync) -> Result<Self, E> {
        let mut geometry = Self {
            objects: Vec::new(),
            triangles: Vec::new(),
            top: Bvh::default(),
            order: Vec::new(),
            leaves: Vec::new(),
            bounds: Bounds::EMPTY,
        };
        let mut shared: Vec<(*const Mesh, usize)> = Vec::new();
        let mut bounds = Vec::with_capacity(placed.len());
        for (shape, Placed { form, to_world, is_emitter }) in placed.iter().enumerate() {
            let (solid, to_world) = match form {
                Form::Unit(unit, form) => (Solid::Unit(*unit), *to_world * *form),
                Form::Mesh(mesh) => (geometry.mesh_solid(mesh, to_world, placed, &mut shared, &check)?, *to_world),
            };
            let place = Place::new(to_world).ok_or(ShapeError::OutOfRange { shape })?;
            let mut object = Object { place, solid };
            if *is_emitter {
                object.place.areas = geometry.areas(&object);
            }
            let around = geometry.bounds_of(&object);
            if !around.min.is_finite() || !around.max.is_finite() {
                return Err(ShapeError::OutOfRange { shape }.into());
            }
            geometry.bounds = geometry.bounds.union(around);
            bounds.push(around);
            geometry.objects.push(object);
        }
        let bvh::Built { bvh, order, leaves, .. } = bvh::build(bounds.len(), |object| bounds[object], &check)?;
        Ok(Self { top: bvh, order, leaves, ..geometry })
    }

    fn mesh_solid<E: Send>(
        &mut self,
        mesh: &Arc<Mesh>,
        to_world: &DAffine3,
        placed: &[Placed],
        shared: &mut Vec<(*const Mesh, usize)>,
        check: &(impl Fn() -> Result<(), E> + Sync),
    ) -> Result<Solid, E> {
        let is_same = |other: &&Placed| matches!(&other.form, Form::Mesh(other) if Arc::ptr_eq(other, mesh));
        let next = self.triangles.len();
        if placed.iter().filter(is_same).count() == 1 {
            let place = (*to_world != DAffine3::IDENTITY).then_some(to_world);
            self.triangles.push(Triangles::build(Arc::clone(mesh), place, check)?);
            return Ok(Solid::Baked { triangles: next });
        }
        if let Some((_, triangles)) = shared.iter().find(|(known, _)| *known == Arc::as_ptr(mesh)) {
            return Ok(Solid::Shared { triangles: *triangles });
        }
        self.triangles.push(Triangles::build(Arc::clone(mesh), None, check)?);
        shared.push((Arc::as_ptr(mesh), next));
        Ok(Solid::Shared { triangles: next })
    }

    /// How many shapes there are.
    pub fn shape_count(&self) -> usize {
        self.objects.len()
    }

    /// The box around everything; without shapes, the empty one.
    pub fn bounds(&self) -> Bounds {
        self.bounds
    }

    /// The box around one shape.
    pub fn bounds_of_shape(&self, shape: usize) -> Bounds {
        self.bounds_of(&self.objects[shape])
    }

    /// Bytes it holds beside the meshes.
    pub fn memory(&self) -> u64 {
        let objects = size_of_val(&*self.objects) as u64;
        objects + self.top.memory() + self.triangles.iter().map(Triangles::memory).sum::<u64>()
    }

    /// The nearest thing that a ray meets.
    pub fn intersect(&self, ray: &Ray) -> Option<Hit> {
        let mut nearest = None;
        if let [object] = self.objects.as_slice() {
            return self.intersect_object(0, object, ray, ray.reach);
        }
        self.top.nearest(ray.origin, ray.direction, ray.reach, |leaf, mut reach| {
            let leaf = &self.leaves[leaf as usize];
            for &index in &self.order[leaf.start as usize..leaf.end as usize] {
                if let Some(hit) = self.intersect_object(index, &self.objects[index as usize], ray, reach) {
                    reach = hit.distance;
                    nearest = Some(hit);
                }
            }
            reach
        });
        nearest
    }

    #[inline]
    fn intersect_object(&self, shape: u32, object: &Object, ray: &Ray, reach: f32) -> Option<Hit> {
        let of_triangle = |hit: TriangleHit| Hit { distance: hit.distance, shape, primitive: hit.place, barycentric: hit.barycentric };
        match object.solid {
            Solid::Unit(unit) => {
                let (origin, direction) = object.place.ray_to_local(ray);
                let (distance, primitive) = unit::intersect(unit, origin, direction, reach.into())?;
                // Rounding may lift the distance onto the reach, and nothing else.
                let distance = distance as f32;
                (distance < reach && distance > 0.0).then_some(Hit { distance, shape, primitive, barycentric: [0.0; 2] })
            }
            Solid::Baked { triangles } => self.triangles[triangles].intersect(ray.origin, ray.direction, reach).map(of_triangle),
            Solid::Shared { triangles } => {
                let (origin, direction) = object.place.ray_to_local(ray);
                self.triangles[triangles].intersect(origin.as_vec3(), direction.as_vec3(), reach).map(of_triangle)
            }
        }
    }

    /// Whether a ray meets anything before its reach.
    pub fn is_occluded(&self, ray: &Ray) -> bool {
        if let [object] = self.objects.as_slice() {
            return self.is_object_in_the_way(object, ray);
        }
        self.top.any(ray.origin, ray.direction, ray.reach, |leaf| {
            let leaf = &self.leaves[leaf as usize];
            let objects = &self.order[leaf.start as usize..leaf.end as usize];
            objects.iter().any(|&index| self.is_object_in_the_way(&self.objects[index as usize], ray))
        })
    }

    #[inline]
    fn is_object_in_the_way(&self, object: &Object, ray: &Ray) -> bool {
        match object.solid {
            Solid::Unit(unit) => {
                let (origin, direction) = object.place.ray_to_local(ray);
                unit::intersect(unit, origin, direction, ray.reach.into()).is_some()
            }
            Solid::Baked { triangles } => self.triangles[triangles].is_occluded(ray.origin, ray.direction, ray.reach),
            Solid::Shared { triangles } => {
                let (origin, direction) = object.place.ray_to_local(ray);
                self.triangles[triangles].is_occluded(origin.as_vec3(), direction.as_vec3(), ray.reach)
            }
        }
    }

    /// The surface where a ray met it.
    pub fn surface(&self, ray: &Ray, hit: &Hit) -> Surface {
        let object = &self.objects[hit.shape as usize];
        match object.solid {
            Solid::Unit(unit) => {
                let (origin, direction) = object.place.ray_to_local(ray);
                let local = unit::point(unit, origin + direction * f64::from(hit.distance), hit.primitive);
                object.place.unit_surface(&local, hit.shape)
            }
            Solid::Baked { triangles } | Solid::Shared { triangles } => {
                self.triangle_surface(object, &self.triangles[triangles], hit.primitive, hit.barycentric, hit.shape)
            }
        }
    }

    /// Triangle of the mesh, or face of the box, that was met; else 0.
    pub fn primitive(&self, hit: &Hit) -> u32 {
        match self.objects[hit.shape as usize].solid {
            Solid::Unit(_) => hit.primitive,
            Solid::Baked { triangles } | Solid::Shared { triangles } => self.triangles[triangles].triangle(hit.primitive),
        }
    }

    fn triangle_surface(&self, object: &Object, triangles: &Triangles, place: u32, barycentric: [f32; 2], shape: u32) -> Surface {
        let corners = triangles.corners(place);
        let indices = triangles.mesh().triangles()[triangles.triangle(place) as usize];
        match object.solid {
            Solid::Baked { .. } => object.place.triangle_surface(triangles.mesh(), indices, corners, 0.0, barycentric, shape),
            _ => {
                // Rounding of the corners and of the ray that was moved to local coordinates.
                let local = corners.map(|corner| corner.abs().max_element()).into_iter().fold(0.0, f32::max);
                let error = object.place.stretch() as f32 * local * TRIANGLE_ERROR;
                let corners = corners.map(|corner| object.place.to_world.transform_point3(corner.as_dvec3()).as_vec3());
                object.place.triangle_surface(triangles.mesh(), indices, corners, error, barycentric, shape)
            }
        }
    }

    /// A point of the shape and its density per steradian at `reference`, for two uniform numbers.
    ///
    /// Uniform on the cone of directions to a sphere seen from outside, else uniform by area. `None` where the point is
    /// seen edge-on or is the reference itself, or the shape was not built as an emitter.
    pub fn sample(&self, shape: u32, reference: Vec3, u: [f32; 2]) -> Option<AreaSample> {
        let object = &self.objects[shape as usize];
        let u = u.map(f64::from);
        match (&object.place.areas, &object.solid) {
            (Areas::Faces(areas, total), Solid::Unit(unit)) => {
                if let Some(from) = object.cone_origin(reference)
                    && let Some((point, pdf)) = unit::sample_cone(from, u)
                {
                    let surface = object.place.unit_surface(&point, shape);
                    return Some(AreaSample { position: surface.position, normal: surface.normal, uv: surface.uv, pdf: pdf as f32 });
                }
                let (axis, u) = chosen_face(areas, *total, u);
                let (point, local_pdf) = unit::sample_area(*unit, axis, u);
                let surface = object.place.unit_surface(&point, shape);
                let pdf_per_area = match unit {
                    // On an ellipsoid equal local areas are not equal in the world.
                    Unit::Sphere => local_pdf / (object.place.cofactor * point.normal).length(),
                    _ => 1.0 / total,
                };
                as_seen(&surface, reference, pdf_per_area)
            }
            (Areas::Triangles(sums), Solid::Baked { triangles } | Solid::Shared { triangles }) => {
                let surface = self.point_of_mesh(object, &self.triangles[*triangles], sums, u, shape);
                as_seen(&surface, reference, 1.0 / sums.last()?)
            }
            _ => None,
        }
    }

    /// Density per steradian at `reference` with which [`Geometry::sample`] gives this point of an emitter.
    pub fn pdf(&self, reference: Vec3, surface: &Surface) -> f32 {
        let object = &self.objects[surface.shape as usize];
        let pdf_per_area = match (&object.place.areas, &object.solid) {
            (Areas::Faces(_, total), Solid::Unit(unit)) => {
                if let Some(pdf) = object.cone_origin(reference).and_then(|from| unit::cone_pdf(from.length_squared())) {
                    return pdf as f32;
                }
                match unit {
                    Unit::Sphere => {
                        let normal = object.place.to_local.transform_point3(surface.position.as_dvec3()).normalize();
                        1.0 / (4.0 * std::f64::consts::PI * (object.place.cofactor * normal).length())
                    }
                    _ => 1.0 / total,
                }
            }
            (Areas::Triangles(sums), _) => 1.0 / sums.last().copied().unwrap_or(f64::INFINITY),
            _ => return 0.0,
        };
        as_seen(surface, reference, pdf_per_area).map_or(0.0, |sample| sample.pdf)
    }

    /// Area of a shape that was built as an emitter, in the world; 0 of another.
    pub fn area(&self, shape: u32) -> f64 {
        match &self.objects[shape as usize].place.areas {
            Areas::None => 0.0,
            Areas::Faces(_, total) => *total,
            Areas::Triangles(sums) => sums.last().copied().unwrap_or(0.0),
        }
    }

    fn point_of_mesh(&self, object: &Object, triangles: &Triangles, sums: &[f64], u: [f64; 2], shape: u32) -> Surface {
        let wanted = u[0] * sums[sums.len() - 1];
        let triangle = sums.partition_point(|&sum| sum <= wanted).min(sums.len() - 1);
        let before = if triangle == 0 { 0.0 } else { sums[triangle - 1] };
        // What is left of the number is as uniform as before.
        let rest = ((wanted - before) / (sums[triangle] - before)).clamp(0.0, 1.0 - f64::EPSILON);
        let root = rest.sqrt();
        let barycentric = [(root * (1.0 - u[1])) as f32, (root * u[1]) as f32];
        let mesh = triangles.mesh();
        let corners = mesh.corners(triangle).map(|corner| object.place.to_world.transform_point3(corner.as_dvec3()).as_vec3());
        object.place.triangle_surface(mesh, mesh.triangles()[triangle], corners, 0.0, barycentric, shape)
    }

    fn areas(&self, object: &Object) -> Areas {
        match object.solid {
            Solid::Unit(unit) => {
                let areas = unit::face_areas(unit, object.place.cofactor);
                Areas::Faces(areas, areas.iter().sum())
            }
            Solid::Baked { triangles } | Solid::Shared { triangles } => {
                let mesh = self.triangles[triangles].mesh();
                let mut sum = 0.0;
                let sums = (0..mesh.triangles().len()).map(|triangle| {
                    let [a, b, c] = mesh.corners(triangle).map(Vec3::as_dvec3);
                    sum += 0.5 * (object.place.cofactor * (b - a).cross(c - a)).length();
                    sum
                });
                Areas::Triangles(sums.collect())
            }
        }
    }

    fn bounds_of(&self, object: &Object) -> Bounds {
        match object.solid {
            Solid::Baked { triangles } => self.triangles[triangles].bounds(),
            Solid::Unit(unit) => object.place.bounds(DVec3::ZERO, unit::half_extent(unit), unit == Unit::Sphere),
            Solid::Shared { triangles } => {
                let Bounds { min, max } = self.triangles[triangles].bounds();
                let (min, max) = (min.as_dvec3(), max.as_dvec3());
                object.place.bounds((min + max) / 2.0, (max - min) / 2.0, false)
            }
        }
    }
}

impl Object {
    /// The reference point in local coordinates, if directions from there to a sphere can be drawn there.
    fn cone_origin(&self, reference: Vec3) -> Option<DVec3> {
        let is_sphere = matches!(self.solid, Solid::Unit(Unit::Sphere)) && self.place.is_similarity;
        let from = is_sphere.then(|| self.place.to_local.transform_point3(reference.as_dvec3()))?;
        // A reference on the sphere itself, but for rounding, sees a half-space: there area is better.
        (from.length_squared() > 1.0 + 1e-4).then_some(from)
    }
}

/// The pair of faces for the first number, and the number that is left.
fn chosen_face(areas: &[f64; 3], total: f64, u: [f64; 2]) -> (usize, [f64; 2]) {
    let mut rest = u[0] * total;
    for (axis, &area) in areas.iter().enumerate() {
        if rest < area {
            return (axis, [rest / area, u[1]]);
        }
        rest -= area;
    }
    let last = (0..3).rev().find(|&axis| areas[axis] > 0.0).unwrap_or(0);
    (last, [1.0 - f64::EPSILON, u[1]])
}

/// The point with its density per steradian; `None` where that is not a positive number.
fn as_seen(surface: &Surface, reference: Vec3, pdf_per_area: f64) -> Option<AreaSample> {
    let way = surface.position.as_dvec3() - reference.as_dvec3();
    let squared = way.length_squared();
    let cos = way.dot(surface.normal.as_dvec3()).abs() / squared.sqrt();
    let pdf = (pdf_per_area * squared / cos) as f32;
    let is_positive = pdf > 0.0 && pdf.is_finite();
    is_positive.then_some(AreaSample { position: surface.position, normal: surface.normal, uv: surface.uv, pdf })
}

impl Place {
    fn new(to_world: DAffine3) -> Option<Self> {
        let matrix = to_world.matrix3;
        let determinant = matrix.determinant();
        if !determinant.is_normal() || !to_world.is_finite() {
            return None;
        }
        let inverse = to_world.inverse();
        let gram = matrix.transpose() * matrix;
        let scale = gram.x_axis.x;
        Some(Self {
            to_world,
            to_local: inverse,
            cofactor: inverse.matrix3.transpose() * determinant,
            handedness: determinant.signum(),
            is_identity: to_world == DAffine3::IDENTITY,
            is_similarity: gram.abs_diff_eq(DMat3::from_diagonal(DVec3::splat(scale)), 1e-9 * scale),
            areas: Areas::None,
        })
    }

    /// A ray in local coordinates, its parameter unchanged.
    #[inline]
    fn ray_to_local(&self, ray: &Ray) -> (DVec3, DVec3) {
        (self.to_local.transform_point3(ray.origin.as_dvec3()), self.to_local.transform_vector3(ray.direction.as_dvec3()))
    }

    /// An outward normal in the world, of unit length.
    fn normal(&self, local: DVec3) -> Vec3 {
        (self.cofactor * local * self.handedness).normalize().as_vec3()
    }

    /// The longest axis of the image of the unit cube, and no less than any stretch.
    fn stretch(&self) -> f64 {
        let matrix = self.to_world.matrix3;
        [matrix.x_axis, matrix.y_axis, matrix.z_axis].map(DVec3::length).iter().sum()
    }

    fn unit_surface(&self, local: &unit::UnitPoint, shape: u32) -> Surface {
        let position = self.to_world.transform_point3(local.position).as_vec3();
        let normal = self.normal(local.normal);
        let dp_du = self.to_world.transform_vector3(local.dp_du).as_vec3();
        let dp_dv = self.to_world.transform_vector3(local.dp_dv).as_vec3();
        let frame = Frame::along(normal, dp_du);
        let offset = position.abs().max_element() * POINT_ERROR;
        Surface { position, normal, frame, uv: local.uv, dp_du, dp_dv, shape, offset }
    }

    fn triangle_surface(
        &self,
        mesh: &Mesh,
        indices: [u32; 3],
        corners: [Vec3; 3],
        error: f32,
        barycentric: [f32; 2],
        shape: u32,
    ) -> Surface {
        let [b1, b2] = barycentric;
        let b0 = 1.0 - b1 - b2;
        let [p0, p1, p2] = corners;
        let position = p0 * b0 + p1 * b1 + p2 * b2;
        let (e1, e2) = (p1 - p0, p2 - p0);
        let normal = triangle_normal(e1, e2) * self.handedness as f32;
        let size = p0.abs().max(p1.abs()).max(p2.abs()).max_element();
        let shading = match mesh.normals() {
            [] => normal,
            normals => {
                let [n0, n1, n2] = indices.map(|index| normals[index as usize]);
                let local = n0 * b0 + n1 * b1 + n2 * b2;
                let world = if self.is_identity { local } else { (self.cofactor * local.as_dvec3() * self.handedness).as_vec3() };
                lifted(world.normalize_or(normal), normal)
            }
        };
        let (uv, dp_du, dp_dv) = match mesh.uvs() {
            [] => ([b1, b2], e1, e2),
            uvs => {
                let uvs = indices.map(|index| uvs[index as usize]);
                let uv = [0, 1].map(|axis| uvs[0][axis] * b0 + uvs[1][axis] * b1 + uvs[2][axis] * b2);
                let (dp_du, dp_dv) = tangents(e1, e2, uvs).unwrap_or_else(|| {
                    let frame = Frame::about(shading);
                    (frame.tangent, frame.bitangent)
                });
                (uv, dp_du, dp_dv)
            }
        };
        let frame = Frame::along(shading, dp_du);
        Surface { position, normal, frame, uv, dp_du, dp_dv, shape, offset: size * TRIANGLE_ERROR + error }
    }
}

/// The shading normal, kept on the side of the surface on which it should be: coarse meshes can have it on the other.
fn lifted(shading: Vec3, normal: Vec3) -> Vec3 {
    const LOWEST: f32 = 0.05;
    let cos = shading.dot(normal);
    if cos < LOWEST { (shading + normal * (LOWEST - cos)).normalize() } else { shading }
}

/// The unit normal of a triangle by its edges; in double precision where single has no digits left.
fn triangle_normal(e1: Vec3, e2: Vec3) -> Vec3 {
    let normal = e1.cross(e2);
    let squared = normal.length_squared();
    // Needles, and triangles so small or large that the square under- or overflows.
    if squared > 1e-6 * e1.length_squared() * e2.length_squared() && squared.is_normal() {
        return normal / squared.sqrt();
    }
    e1.as_dvec3().cross(e2.as_dvec3()).normalize().as_vec3()
}

/// Changes of the position with u and v; `None` where the texture coordinates do not span a plane.
fn tangents(e1: Vec3, e2: Vec3, uvs: [[f32; 2]; 3]) -> Option<(Vec3, Vec3)> {
    let (du1, dv1) = (uvs[1][0] - uvs[0][0], uvs[1][1] - uvs[0][1]);
    let (du2, dv2) = (uvs[2][0] - uvs[0][0], uvs[2][1] - uvs[0][1]);
    let determinant = du1 * dv2 - dv1 * du2;
    let inverse = 1.0 / determinant;
    let (dp_du, dp_dv) = ((e1 * dv2 - e2 * dv1) * inverse, (e2 * du1 - e1 * du2) * inverse);
    (determinant != 0.0 && dp_du.is_finite() && dp_dv.is_finite()).then_some((dp_du, dp_dv))
}

impl Place {
    /// The box around the image of a box, or of the ellipsoid within it.
    fn bounds(&self, center: DVec3, half: DVec3, is_round: bool) -> Bounds {
        let matrix = self.to_world.matrix3;
        let center = self.to_world.transform_point3(center);
        let rows = [matrix.row(0), matrix.row(1), matrix.row(2)];
        let half = DVec3::from(rows.map(|row| if is_round { (row * half).length() } else { (row * half).abs().element_sum() }));
        // A few roundings outwards.
        let margin = (center.abs() + half) * 1e-6;
        Bounds { min: (center - half - margin).as_vec3(), max: (center + half + margin).as_vec3() }
    }
}

//! Triangle meshes: the checked arrays, and the ways to get them.
//!
//! A [`Mesh`] is finite, its indices exist and its triangles have an area, so whoever takes one need not look again.
//! Readers take bytes and never more memory than a small multiple of them. Reading order: this file, `obj`, `ply`,
//! `gltf`, `read`, `write`; formulas are in `shape::generated`.

pub mod gltf;
pub mod obj;
pub mod ply;
pub mod read;
pub mod write;

use glam::{DVec3, Vec3};

/// Triangles over shared vertices.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Mesh {
    positions: Vec<Vec3>,
    normals: Vec<Vec3>,
    uvs: Vec<[f32; 2]>,
    triangles: Vec<[u32; 3]>,
}

/// The arrays of a mesh as they come, not yet checked.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Arrays {
    /// Corners, in the units of the file.
    pub positions: Vec<Vec3>,
    /// A normal per position, of any length; or none.
    pub normals: Vec<Vec3>,
    /// Texture coordinates per position, u to the right and v up; or none.
    pub uvs: Vec<[f32; 2]>,
    /// Positions of each triangle's corners, counter-clockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
}

/// What makes a mesh unusable.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum MeshError {
    /// Nothing to hit.
    #[error("the mesh has no triangle with an area ({degenerate} degenerate triangles were left out)")]
    Empty {
        /// How many triangles had no area.
        degenerate: usize,
    },
    /// A number that is NaN or infinite.
    #[error("{what} {index} of the mesh is not finite: `{value}`")]
    NotFinite {
        /// `vertex`, `normal` or `texture coordinate`.
        what: &'static str,
        /// Its index, from 0.
        index: usize,
        /// The value.
        value: String,
    },
    /// Coordinates whose differences overflow single precision.
    #[error("vertex {index} of the mesh is at `{value}`, beyond 1e18 from the origin; scale the mesh down")]
    TooLarge {
        /// Its index, from 0.
        index: usize,
        /// The value.
        value: String,
    },
    /// A corner that does not exist.
    #[error("triangle {triangle} of the mesh has the vertex index {index}, but there are {count} vertices")]
    Index {
        /// The triangle, from 0.
        triangle: usize,
        /// The index.
        index: u32,
        /// How many vertices there are.
        count: usize,
    },
    /// Arrays of different lengths.
    #[error("the mesh has {found} {what}s for {expected} vertices")]
    Count {
        /// `normal` or `texture coordinate`.
        what: &'static str,
        /// How many there are.
        found: usize,
        /// How many there should be.
        expected: usize,
    },
    /// More than indices can count.
    #[error("the mesh has {0} triangles; at most 2^29 can be used")]
    TooMany(usize),
}

/// Squares of differences of coordinates up to this stay finite in single precision.
const LARGEST: f32 = 1e18;
/// The tree addresses triangles by 29 bits.
const MOST_TRIANGLES: usize = 1 << 29;

impl Mesh {
    /// Checks the arrays; leaves out triangles without an area, and says how many.
    ///
    /// Normals come out with unit length; a zero normal is replaced by that of a triangle around its vertex. Where the
    /// normals of a triangle say that its corners stand in the wrong order, they are put right: files are seldom wrong
    /// about normals and often about that.
    pub fn new(arrays: Arrays) -> Result<(Self, usize), MeshError> {
        let Arrays { positions, mut normals, uvs, mut triangles } = arrays;
        check_numbers(&positions, &normals, &uvs)?;
        if triangles.len() > MOST_TRIANGLES {
            return Err(MeshError::TooMany(triangles.len()));
        }
        for (triangle, corners) in triangles.iter().enumerate() {
            if let Some(&index) = corners.iter().find(|&&corner| corner as usize >= positions.len()) {
                return Err(MeshError::Index { triangle, index, count: positions.len() });
            }
        }
        let all = triangles.len();
        triangles.retain(|corners| has_area(corners.map(|corner| positions[corner as usize])));
        let degenerate = all - triangles.len();
        if triangles.is_empty() {
            return Err(MeshError::Empty { degenerate });
        }
        normals.iter_mut().for_each(|normal| *normal = normal.try_normalize().unwrap_or(Vec3::ZERO));
        if !normals.is_empty() {
            triangles.iter_mut().filter(|corners| is_inside_out(**corners, &positions, &normals)).for_each(|corners| corners.swap(1, 2));
        }
        let mut mesh = Self { positions, normals, uvs, triangles };
        mesh.fill_missing_normals();
        Ok((mesh, degenerate))
    }

    /// The mesh that has exactly these arrays, if a mesh can have them.
    pub fn restored(arrays: Arrays) -> Option<Self> {
        let Arrays { positions, normals, uvs, triangles } = arrays;
        check_numbers(&positions, &normals, &uvs).ok()?;
        let exists = |corner: &u32| (*corner as usize) < positions.len();
        let is_sound = !triangles.is_empty() && triangles.len() <= MOST_TRIANGLES && triangles.as_flattened().iter().all(exists);
        let is_unit = |normal: &Vec3| (normal.length_squared() - 1.0).abs() < 1e-5;
        let has_areas = || triangles.iter().all(|corners| has_area(corners.map(|corner| positions[corner as usize])));
        (is_sound && normals.iter().all(is_unit) && has_areas()).then_some(Self { positions, normals, uvs, triangles })
    }

    /// Corners.
    pub fn positions(&self) -> &[Vec3] {
        &self.positions
    }

    /// A unit normal per position; empty where the mesh is flat shaded.
    pub fn normals(&self) -> &[Vec3] {
        &self.normals
    }

    /// Texture coordinates per position, u to the right and v up; may be empty.
    pub fn uvs(&self) -> &[[f32; 2]] {
        &self.uvs
    }

    /// Positions of the corners of each triangle.
    pub fn triangles(&self) -> &[[u32; 3]] {
        &self.triangles
    }

    /// The corners of a triangle.
    pub fn corners(&self, triangle: usize) -> [Vec3; 3] {
        self.triangles[triangle].map(|corner| self.positions[corner as usize])
    }

    /// Bytes it holds.
    pub fn memory(&self) -> u64 {
        let arrays = size_of_val(&*self.positions) + size_of_val(&*self.normals) + size_of_val(&*self.uvs) + size_of_val(&*self.triangles);
        arrays as u64
    }

    /// The same mesh, scaled and moved: its longest side has that length, and it stands on y = 0 about the y axis.
    pub fn standing(self, length: f64) -> Result<Self, MeshError> {
        let [low, high] = self.positions.iter().fold([DVec3::INFINITY, DVec3::NEG_INFINITY], |[low, high], position| {
            let position = position.as_dvec3();
            [low.min(position), high.max(position)]
        });
        let foot = DVec3::new((low.x + high.x) / 2.0, low.y, (low.z + high.z) / 2.0);
        let scale = length / (high - low).max_element();
        let positions = self.positions.iter().map(|position| ((position.as_dvec3() - foot) * scale).as_vec3()).collect();
        Ok(Self::new(Arrays { positions, normals: self.normals, uvs: self.uvs, triangles: self.triangles })?.0)
    }

    /// The same mesh without normals, so that every triangle is seen flat.
    #[must_use]
    pub fn flat(mut self) -> Self {
        self.normals = Vec::new();
        self
    }

    /// The same mesh with a normal per vertex from the triangles around it, each weighted by its angle there.
    ///
    /// Thürmer & Wüthrich, "Computing vertex normals from polygonal facets", Journal of Graphics Tools 3(1) (1998).
    #[must_use]
    pub fn smooth(mut self) -> Self {
        let mut normals = vec![Vec3::ZERO; self.positions.len()];
        for corners in &self.triangles {
            let points = corners.map(|corner| self.positions[corner as usize]);
            let normal = (points[1] - points[0]).cross(points[2] - points[0]).normalize_or_zero();
            for k in 0..3 {
                let [a, b] = [points[(k + 1) % 3] - points[k], points[(k + 2) % 3] - points[k]].map(Vec3::normalize_or_zero);
                normals[corners[k] as usize] += normal * angle(a, b);
            }
        }
        self.normals = normals.into_iter().map(Vec3::normalize_or_zero).collect();
        self.fill_missing_normals();
        self
    }

    /// Where a normal is zero, takes that of the first triangle around.
    fn fill_missing_normals(&mut self) {
        if self.normals.iter().all(|normal| *normal != Vec3::ZERO) {
            return;
        }
        for corners in &self.triangles {
            let points = corners.map(|corner| self.positions[corner as usize]);
            for corner in corners.map(|corner| corner as usize) {
                if self.normals[corner] == Vec3::ZERO {
                    self.normals[corner] = face_normal(points);
                }
            }
        }
        // What no triangle uses.
        self.normals.iter_mut().filter(|normal| **normal == Vec3::ZERO).for_each(|normal| *normal = Vec3::Y);
    }
}

/// Angle between unit vectors; from the half chord, which keeps its digits for small angles.
fn angle(a: Vec3, b: Vec3) -> f32 {
    let half = ((a - b).length() / 2.0).min(1.0);
    2.0 * arc_sine(half)
}

/// Arc sine on [0, 1] to 7e-5 (Abramowitz & Stegun 4.4.45): weights of an average need no more.
fn arc_sine(x: f32) -> f32 {
    let series = 1.570_728_8 + x * (-0.212_114_4 + x * (0.074_261 + x * -0.018_729_3));
    std::f32::consts::FRAC_PI_2 - (1.0 - x).sqrt() * series
}

/// The unit normal of a triangle that has an area; in double precision, so that no needle loses its own.
pub fn face_normal(points: [Vec3; 3]) -> Vec3 {
    let [a, b, c] = points.map(Vec3::as_dvec3);
    (b - a).cross(c - a).normalize_or_zero().as_vec3()
}

fn has_area(points: [Vec3; 3]) -> bool {
    let [a, b, c] = points.map(Vec3::as_dvec3);
    let edges = [b - a, c - b, a - c];
    let longest = edges.iter().map(|edge| edge.length_squared()).fold(0.0, f64::max);
    // A height below a ten-millionth of the longest edge is what rounding to single precision leaves of a line.
    edges[0].cross(edges[1]).length() > 1e-7 * longest
}

fn is_inside_out(corners: [u32; 3], positions: &[Vec3], normals: &[Vec3]) -> bool {
    let of_vertices: Vec3 = corners.iter().map(|&corner| normals[corner as usize]).sum();
    face_normal(corners.map(|corner| positions[corner as usize])).dot(of_vertices) < 0.0
}

fn check_numbers(positions: &[Vec3], normals: &[Vec3], uvs: &[[f32; 2]]) -> Result<(), MeshError> {
    let expected = positions.len();
    for (what, found) in [("normal", normals.len()), ("texture coordinate", uvs.len())] {
        if found != 0 && found != expected {
            return Err(MeshError::Count { what, found, expected });
        }
    }
    if let Some(index) = positions.iter().position(|position| !position.is_finite()) {
        return Err(MeshError::NotFinite { what: "vertex", index, value: positions[index].to_string() });
    }
    if let Some(index) = positions.iter().position(|position| position.abs().max_element() > LARGEST) {
        return Err(MeshError::TooLarge { index, value: positions[index].to_string() });
    }
    if let Some(index) = normals.iter().position(|normal| !normal.is_finite()) {
        return Err(MeshError::NotFinite { what: "normal", index, value: normals[index].to_string() });
    }
    match uvs.iter().position(|uv| uv.iter().any(|value| !value.is_finite())) {
        Some(index) => Err(MeshError::NotFinite { what: "texture coordinate", index, value: format!("{:?}", uvs[index]) }),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tetrahedron() -> Arrays {
        Arrays {
            positions: vec![Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::Z],
            triangles: vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]],
            ..Arrays::default()
        }
    }

    #[test]
    fn bad_arrays_are_refused_with_the_place() {
        let broken = |change: &dyn Fn(&mut Arrays)| {
            let mut arrays = tetrahedron();
            change(&mut arrays);
            Mesh::new(arrays).unwrap_err().to_string()
        };
        assert!(broken(&|arrays| arrays.positions[2].y = f32::NAN).contains("vertex 2"));
        assert!(broken(&|arrays| arrays.positions[1].x = 3e38).contains("beyond 1e18"));
        assert!(broken(&|arrays| arrays.triangles[3][1] = 4).contains("triangle 3 of the mesh has the vertex index 4"));
        assert!(broken(&|arrays| arrays.normals = vec![Vec3::X; 3]).contains("3 normals for 4"));
        assert!(broken(&|arrays| arrays.normals = vec![Vec3::INFINITY; 4]).contains("normal 0"));
        assert!(broken(&|arrays| arrays.uvs = vec![[0.0, f32::NAN]; 4]).contains("texture coordinate 0"));
        assert!(broken(&|arrays| arrays.triangles.clear()).contains("no triangle"));
        assert!(broken(&|arrays| arrays.triangles = vec![[0, 0, 1]; 7]).contains("7 degenerate"));
    }

    #[test]
    fn triangles_without_an_area_are_left_out_and_counted() {
        let mut arrays = tetrahedron();
        arrays.positions.push(Vec3::splat(0.5));
        arrays.positions.push(Vec3::splat(1.0));
        arrays.triangles.extend([[0, 4, 5], [1, 1, 2]]);
        let (mesh, degenerate) = Mesh::new(arrays).unwrap();
        assert_eq!((mesh.triangles().len(), degenerate), (4, 2));
    }

    #[test]
    fn smooth_normals_are_those_of_the_angles() {
        let (mesh, _) = Mesh::new(tetrahedron()).unwrap();
        let mesh = mesh.smooth();
        // At the origin three right angles meet.
        assert!((mesh.normals()[0] + Vec3::splat(1.0 / 3.0_f32.sqrt())).length() < 1e-5);
        assert!(mesh.normals().iter().all(|normal| (normal.length() - 1.0).abs() < 1e-6));
        assert!(mesh.flat().normals().is_empty());
    }

    #[test]
    fn a_zero_normal_becomes_that_of_its_triangle() {
        let mut arrays = tetrahedron();
        arrays.normals = vec![Vec3::ZERO, 2.0 * Vec3::X, Vec3::Y, Vec3::Z];
        arrays.triangles.truncate(3);
        let (mesh, _) = Mesh::new(arrays).unwrap();
        assert_eq!(mesh.normals(), [-Vec3::Z, Vec3::X, Vec3::Y, Vec3::Z]);
    }

    #[test]
    fn corners_in_the_wrong_order_are_turned_by_the_normals() {
        let mut arrays = tetrahedron();
        arrays.normals = arrays.positions.iter().map(|position| *position - Vec3::splat(0.25)).collect();
        let right = Mesh::new(arrays.clone()).unwrap().0;
        arrays.triangles.iter_mut().for_each(|corners| corners.swap(1, 2));
        let turned = Mesh::new(arrays.clone()).unwrap().0;
        assert_eq!(right.triangles(), tetrahedron().triangles);
        assert_eq!(turned.triangles(), right.triangles());
    }

    #[test]
    fn the_arc_sine_is_good_enough_for_weights() {
        for k in 0..=100_u8 {
            let x = f32::from(k) / 100.0;
            assert!((f64::from(arc_sine(x)) - crate::math::elementary::asin(f64::from(x))).abs() < 1e-4);
        }
    }
}

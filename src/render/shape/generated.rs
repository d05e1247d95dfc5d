//! Meshes made of formulas: spheres with a relief, a ring, and stand-ins for scanned models of like complexity.
//!
//! All are about the origin, closed, with outward normals, and the same bytes on every machine.

use std::collections::HashMap;
use std::f64::consts::{PI, TAU};

use glam::{DVec3, Vec3};
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::math::elementary;
use crate::math::noise;
use crate::render::mesh::{Arrays, Mesh, MeshError};
use crate::render::shape::ShapeError;

/// Hills and valleys along the radius: radius (1 + amplitude * fractal noise(frequency * direction)).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Relief {
    /// Height of the hills as a part of the radius.
    #[schemars(range(min = 0.0, max = 0.9))]
    pub amplitude: f64,
    /// How many hills there are, about, along a radius.
    #[serde(default = "four")]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub frequency: f64,
    /// Sizes of hills: each octave has twice the frequency and half the height.
    #[serde(default = "six")]
    #[schemars(range(min = 1, max = 16))]
    pub octaves: u32,
    /// Another seed gives other hills.
    #[serde(default)]
    pub seed: u64,
}

fn four() -> f64 {
    4.0
}

fn six() -> u32 {
    6
}

fn one() -> f64 {
    1.0
}

impl Relief {
    fn factor(&self, direction: DVec3) -> f64 {
        // Away from the lattice point at the center, where all gradient noise is zero.
        let place = direction * self.frequency + DVec3::new(17.31, 5.47, 31.73);
        1.0 + self.amplitude * noise::fractal(place, self.octaves, 0.5, self.seed)
    }
}

/// A sphere of triangles of nearly equal size: an icosahedron, each of whose triangles is cut in four again and again.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Icosphere {
    /// How often: 20 * 4^n triangles (5 gives 20 480, 8 gives 1 310 720).
    #[serde(default = "five")]
    #[schemars(range(min = 0, max = 10))]
    pub subdivisions: u32,
    /// The radius.
    #[serde(default = "one")]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub radius: f64,
    /// Hills and valleys; by default none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub relief: Option<Relief>,
}

fn five() -> u32 {
    5
}

/// A sphere of triangles along circles of latitude, with texture coordinates.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct UvSphere {
    /// Vertices around the equator; 2 columns (rows - 1) triangles in all (128 and 64 give 16 128, 1000 and 500 a million).
    #[serde(default = "default_columns")]
    #[schemars(range(min = 3, max = 16384))]
    pub columns: u32,
    /// Rows from pole to pole.
    #[serde(default = "default_rows")]
    #[schemars(range(min = 2, max = 8192))]
    pub rows: u32,
    /// The radius.
    #[serde(default = "one")]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub radius: f64,
    /// Hills and valleys; by default none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub relief: Option<Relief>,
}

fn default_columns() -> u32 {
    128
}

fn default_rows() -> u32 {
    64
}

/// A ring about the y axis.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Torus {
    /// From the center to the middle of the tube.
    #[serde(default = "one")]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub radius: f64,
    /// Radius of the tube.
    #[serde(default = "default_tube")]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub tube_radius: f64,
    /// Vertices around the ring; 2 columns rows triangles in all.
    #[serde(default = "default_columns")]
    #[schemars(range(min = 3, max = 16384))]
    pub columns: u32,
    /// Vertices around the tube.
    #[serde(default = "default_rows")]
    #[schemars(range(min = 3, max = 8192))]
    pub rows: u32,
}

fn default_tube() -> f64 {
    0.4
}

/// A tube along a torus knot, scaled and ridged like a scaly body: 100 000 triangles by default, as the scanned dragon has.
///
/// The curve is (2 + cos q t) (cos p t, 0, sin p t) + sin q t about the y axis, within a radius of 1.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Knot {
    /// Turns about the axis.
    #[serde(default = "two")]
    #[schemars(range(min = 1, max = 32))]
    pub p: u32,
    /// Turns about the ring; without a common divisor with `p`.
    #[serde(default = "three")]
    #[schemars(range(min = 1, max = 32))]
    pub q: u32,
    /// Radius of the tube, where the knot fills a sphere of radius 1.
    #[serde(default = "knot_tube")]
    #[schemars(range(min = 0.001, max = 0.3))]
    pub tube_radius: f64,
    /// Height of the ridges as a part of the tube's radius.
    #[serde(default = "ridge")]
    #[schemars(range(min = 0.0, max = 0.5))]
    pub ridges: f64,
    /// Vertices along the tube.
    #[serde(default = "segments")]
    #[schemars(range(min = 8, max = 100_000))]
    pub columns: u32,
    /// Vertices around the tube.
    #[serde(default = "sides")]
    #[schemars(range(min = 3, max = 4096))]
    pub rows: u32,
}

fn two() -> u32 {
    2
}

fn three() -> u32 {
    3
}

fn knot_tube() -> f64 {
    0.14
}

fn ridge() -> f64 {
    0.15
}

fn segments() -> u32 {
    1000
}

fn sides() -> u32 {
    50
}

/// A smooth body with a head, two long ears, paws and a tail, and a fine relief like fur: 81 920 triangles by default,
/// as many as the scanned bunny has, about. Within a radius of 1.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Blob {
    /// An icosphere of 20 * 4^n triangles is what it is made of.
    #[serde(default = "six")]
    #[schemars(range(min = 0, max = 10))]
    pub subdivisions: u32,
    /// Height of the fur as a part of the radius.
    #[serde(default = "fur")]
    #[schemars(range(min = 0.0, max = 0.2))]
    pub fur: f64,
    /// Another seed gives other fur.
    #[serde(default)]
    pub seed: u64,
}

fn fur() -> f64 {
    0.03
}

/// Names of the generated meshes.
pub const NAMES: [&str; 5] = ["icosphere", "uv-sphere", "torus", "knot", "blob"];

/// The generated mesh of that name with default parameters.
pub fn named(name: &str) -> Option<Result<Mesh, ShapeError>> {
    Some(match name {
        "icosphere" => usual::<Icosphere>().mesh().map_err(ShapeError::from),
        "uv-sphere" => usual::<UvSphere>().mesh().map_err(ShapeError::from),
        "torus" => usual::<Torus>().mesh(),
        "knot" => usual::<Knot>().mesh().map_err(ShapeError::from),
        "blob" => usual::<Blob>().mesh().map_err(ShapeError::from),
        _ => return None,
    })
}

/// What `{}` means in a scene.
fn usual<T: serde::de::DeserializeOwned>() -> T {
    serde_json::from_str("{}").expect("every parameter has a default")
}

impl Icosphere {
    /// The mesh, without texture coordinates.
    pub fn mesh(&self) -> Result<Mesh, MeshError> {
        let (directions, triangles) = subdivided(self.subdivisions);
        radial(&directions, triangles, Vec::new(), self.relief.is_some(), |d| {
            self.radius * self.relief.as_ref().map_or(1.0, |r| r.factor(d))
        })
    }
}

impl UvSphere {
    /// The mesh; u runs with the longitude and v from the south pole to the north, to the right and up seen from outside.
    pub fn mesh(&self) -> Result<Mesh, MeshError> {
        let (columns, rows) = (self.columns, self.rows);
        // The first column stands twice, with u = 0 and u = 1.
        let grid = |row: u32, column: u32| row * (columns + 1) + column;
        let places: Vec<(u32, u32)> = (0..=rows).flat_map(|row| (0..=columns).map(move |column| (row, column))).collect();
        let directions: Vec<DVec3> = places
            .par_iter()
            .map(|&(row, column)| {
                let (sin, cos) = elementary::sin_cos(PI * f64::from(row) / f64::from(rows));
                let (sin_phi, cos_phi) = elementary::sin_cos(TAU * f64::from(column % columns) / f64::from(columns));
                // The poles are single points, exactly.
                let sin = if row == 0 || row == rows { 0.0 } else { sin };
                DVec3::new(sin * cos_phi, -cos, -sin * sin_phi)
            })
            .collect();
        let uv = |&(row, column): &(u32, u32)| {
            let shift = if row == 0 || row == rows { 0.5 } else { 0.0 };
            [((f64::from(column) + shift) / f64::from(columns)) as f32, (f64::from(row) / f64::from(rows)) as f32]
        };
        let uvs = places.iter().map(uv).collect();
        let mut triangles = Vec::with_capacity(2 * columns as usize * (rows as usize - 1));
        for row in 0..rows {
            for column in 0..columns {
                let [a, b] = [grid(row, column), grid(row, column + 1)];
                let [c, d] = [grid(row + 1, column), grid(row + 1, column + 1)];
                // A quad at a pole is one triangle.
                if row + 1 == rows {
                    triangles.push([a, b, c]);
                    continue;
                }
                if row > 0 {
                    triangles.push([a, b, d]);
                }
                triangles.push([a, d, c]);
            }
        }
        let factor = |d: DVec3| self.radius * self.relief.as_ref().map_or(1.0, |relief| relief.factor(d));
        let mesh = radial(&directions, triangles, uvs, false, factor)?;
        if self.relief.is_some() { with_seamless_normals(mesh, columns, rows) } else { Ok(mesh) }
    }
}

/// Smooth normals of a grid whose first and last columns are one, and whose first and last rows are points.
fn with_seamless_normals(mesh: Mesh, columns: u32, rows: u32) -> Result<Mesh, MeshError> {
    let weld = |vertex: u32| {
        let (row, column) = (vertex / (columns + 1), vertex % (columns + 1));
        let column = if row == 0 || row == rows { 0 } else { column % columns };
        row * (columns + 1) + column
    };
    let welded = Arrays {
        positions: mesh.positions().to_vec(),
        triangles: mesh.triangles().iter().map(|corners| corners.map(weld)).collect(),
        ..Arrays::default()
    };
    let smooth = checked(welded)?.smooth();
    let normals = (0..mesh.positions().len() as u32).map(|vertex| smooth.normals()[weld(vertex) as usize]).collect();
    let (positions, uvs, triangles) = (mesh.positions().to_vec(), mesh.uvs().to_vec(), mesh.triangles().to_vec());
    checked(Arrays { positions, normals, uvs, triangles })
}

impl Torus {
    /// A ring that would pass through itself.
    pub fn contradiction(&self) -> Option<ShapeError> {
        let Self { tube_radius, radius, .. } = *self;
        (tube_radius >= radius).then_some(ShapeError::FatTorus { tube_radius, radius })
    }

    /// The mesh; u runs around the ring, v around the tube.
    pub fn mesh(&self) -> Result<Mesh, ShapeError> {
        if let Some(error) = self.contradiction() {
            return Err(error);
        }
        tube(self.columns, self.rows, |u, v| {
            let (sin_phi, cos_phi) = elementary::sin_cos(TAU * u);
            let (sin, cos) = elementary::sin_cos(TAU * v);
            let outwards = DVec3::new(cos_phi, 0.0, -sin_phi);
            let normal = outwards * cos + DVec3::Y * sin;
            (outwards * self.radius + normal * self.tube_radius, Some(normal))
        })
        .map_err(ShapeError::from)
    }
}

impl Knot {
    /// The mesh; u runs along the tube, v around it.
    pub fn mesh(&self) -> Result<Mesh, MeshError> {
        let (p, q) = (f64::from(self.p), f64::from(self.q));
        // The curve reaches 3 from the axis; with the tube the whole fits into the unit sphere.
        let scale = (1.0 - self.tube_radius * (1.0 + self.ridges)) / 3.0;
        let curve = |t: f64| {
            let ((sin_p, cos_p), (sin_q, cos_q)) = (elementary::sin_cos(p * t), elementary::sin_cos(q * t));
            DVec3::new((2.0 + cos_q) * cos_p, sin_q, -(2.0 + cos_q) * sin_p) * scale
        };
        tube(self.columns, self.rows, |u, v| {
            let t = TAU * u;
            let step = 1e-4;
            let (before, here, after) = (curve(t - step), curve(t), curve(t + step));
            let tangent = (after - before).normalize();
            // Across the ring's own circle, which turns with the curve and comes back with it.
            let (sin_p, cos_p) = elementary::sin_cos(p * t);
            let middle = DVec3::new(cos_p, 0.0, -sin_p) * (2.0 * scale);
            let outwards = here - middle;
            let side = (outwards - tangent * outwards.dot(tangent)).normalize();
            let (sin, cos) = elementary::sin_cos(TAU * v);
            let across = side * cos + side.cross(tangent) * sin;
            let ridge = elementary::sin(TAU * (32.0 * q * u)) * elementary::cos(TAU * 4.0 * v);
            (here + across * (self.tube_radius * (1.0 + self.ridges * ridge)), None)
        })
    }
}

/// A closed surface over the unit torus of (u, v), `columns` by `rows` quads; its normals point to the side from which
/// u goes to the right where v goes up.
fn tube(columns: u32, rows: u32, place: impl Fn(f64, f64) -> (DVec3, Option<DVec3>) + Sync) -> Result<Mesh, MeshError> {
    let at = |column: u32, row: u32| place(f64::from(column % columns) / f64::from(columns), f64::from(row % rows) / f64::from(rows));
    let places: Vec<(u32, u32)> = (0..=rows).flat_map(|row| (0..=columns).map(move |column| (row, column))).collect();
    let points: Vec<(DVec3, Option<DVec3>)> = places.par_iter().map(|&(row, column)| at(column, row)).collect();
    let grid = |row: u32, column: u32| row * (columns + 1) + column;
    let quads = (0..rows).flat_map(|row| (0..columns).map(move |column| (row, column)));
    let triangles: Vec<[u32; 3]> = quads
        .flat_map(|(row, column)| {
            let [a, b, c, d] = [grid(row, column), grid(row, column + 1), grid(row + 1, column), grid(row + 1, column + 1)];
            [[a, b, d], [a, d, c]]
        })
        .collect();
    let positions = points.iter().map(|(position, _)| position.as_vec3()).collect::<Vec<Vec3>>();
    let normals = match points.iter().map(|(_, normal)| normal.map(DVec3::as_vec3)).collect::<Option<Vec<Vec3>>>() {
        Some(normals) => normals,
        None => {
            let weld = |vertex: u32| grid(vertex / (columns + 1) % rows, vertex % (columns + 1) % columns);
            let welded = Arrays {
                positions: positions.clone(),
                triangles: triangles.iter().map(|corners| corners.map(weld)).collect(),
                ..Arrays::default()
            };
            let smooth = checked(welded)?.smooth();
            (0..positions.len() as u32).map(|vertex| smooth.normals()[weld(vertex) as usize]).collect()
        }
    };
    let uvs = places.iter().map(|&(row, column)| [column as f32 / columns as f32, row as f32 / rows as f32]).collect();
    checked(Arrays { positions, normals, uvs, triangles })
}

impl Blob {
    /// The mesh, without texture coordinates.
    pub fn mesh(&self) -> Result<Mesh, MeshError> {
        let (directions, triangles) = subdivided(self.subdivisions);
        let fur = Relief { amplitude: self.fur, frequency: 12.0, octaves: 4, seed: self.seed };
        radial(&directions, triangles, Vec::new(), true, |direction| {
            // Direction, sharpness and height of: head, two ears, two paws, tail.
            const LOBES: [([f64; 3], f64, f64); 6] = [
                ([0.5, 0.75, 0.0], 6.0, 0.45),
                ([0.25, 1.0, 0.3], 60.0, 0.75),
                ([0.25, 1.0, -0.3], 60.0, 0.75),
                ([0.8, -0.55, 0.45], 18.0, 0.3),
                ([0.8, -0.55, -0.45], 18.0, 0.3),
                ([-1.0, -0.15, 0.0], 30.0, 0.25),
            ];
            let lobes: f64 = LOBES
                .iter()
                .map(|(toward, sharpness, height)| {
                    let cos = direction.dot(DVec3::from(*toward).normalize());
                    height * elementary::exp(sharpness * (cos - 1.0))
                })
                .sum();
            // The longest ear and the highest fur stay within 1.
            0.5 * (1.0 + lobes) * fur.factor(direction) / 1.1
        })
    }
}

/// Directions on the unit sphere and triangles between them.
fn subdivided(subdivisions: u32) -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let g = (1.0 + 5.0_f64.sqrt()) / 2.0;
    let mut directions: Vec<DVec3> = [
        [-1.0, g, 0.0],
        [1.0, g, 0.0],
        [-1.0, -g, 0.0],
        [1.0, -g, 0.0],
        [0.0, -1.0, g],
        [0.0, 1.0, g],
        [0.0, -1.0, -g],
        [0.0, 1.0, -g],
        [g, 0.0, -1.0],
        [g, 0.0, 1.0],
        [-g, 0.0, -1.0],
        [-g, 0.0, 1.0],
    ]
    .map(|corner| DVec3::from(corner).normalize())
    .to_vec();
    let mut triangles: Vec<[u32; 3]> = vec![
        [0, 11, 5],
        [0, 5, 1],
        [0, 1, 7],
        [0, 7, 10],
        [0, 10, 11],
        [1, 5, 9],
        [5, 11, 4],
        [11, 10, 2],
        [10, 7, 6],
        [7, 1, 8],
        [3, 9, 4],
        [3, 4, 2],
        [3, 2, 6],
        [3, 6, 8],
        [3, 8, 9],
        [4, 9, 5],
        [2, 4, 11],
        [6, 2, 10],
        [8, 6, 7],
        [9, 8, 1],
    ];
    for _ in 0..subdivisions {
        // An edge is found by its ends; three new vertices for two triangles.
        let mut middles = HashMap::new();
        let mut middle = |a: u32, b: u32| {
            *middles.entry((a.min(b), a.max(b))).or_insert_with(|| {
                directions.push((directions[a as usize] + directions[b as usize]).normalize());
                directions.len() as u32 - 1
            })
        };
        let mut finer = Vec::with_capacity(4 * triangles.len());
        for [a, b, c] in triangles {
            let [ab, bc, ca] = [middle(a, b), middle(b, c), middle(c, a)];
            finer.extend([[a, ab, ca], [b, bc, ab], [c, ca, bc], [ab, bc, ca]]);
        }
        triangles = finer;
    }
    (directions, triangles)
}

/// A star-shaped body: each direction at its radius. Normals are the directions where all radii are one.
fn radial(
    directions: &[DVec3],
    triangles: Vec<[u32; 3]>,
    uvs: Vec<[f32; 2]>,
    is_uneven: bool,
    radius: impl Fn(DVec3) -> f64 + Sync,
) -> Result<Mesh, MeshError> {
    let positions: Vec<Vec3> = directions.par_iter().map(|&direction| (direction * radius(direction)).as_vec3()).collect();
    let normals = if is_uneven { Vec::new() } else { directions.iter().map(|direction| direction.as_vec3()).collect() };
    let mesh = checked(Arrays { positions, normals, uvs, triangles })?;
    Ok(if is_uneven { mesh.smooth() } else { mesh })
}

/// The formulas give indices that exist; a radius may be beyond single precision, and triangles to which it leaves no
/// area are left out.
fn checked(arrays: Arrays) -> Result<Mesh, MeshError> {
    Mesh::new(arrays).map(|(mesh, _)| mesh)
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;

    fn meshes() -> Vec<(&'static str, Mesh, usize)> {
        let relief = Some(Relief { amplitude: 0.3, frequency: 3.0, octaves: 5, seed: 2 });
        vec![
            ("icosphere", Icosphere { subdivisions: 4, radius: 1.0, relief: None }.mesh().unwrap(), 5120),
            ("icosphere with a relief", Icosphere { subdivisions: 4, radius: 1.0, relief: relief.clone() }.mesh().unwrap(), 5120),
            ("uv-sphere", UvSphere { columns: 40, rows: 20, radius: 2.0, relief: None }.mesh().unwrap(), 1520),
            ("uv-sphere with a relief", UvSphere { columns: 40, rows: 20, radius: 2.0, relief }.mesh().unwrap(), 1520),
            ("torus", Torus { radius: 1.0, tube_radius: 0.4, columns: 40, rows: 20 }.mesh().unwrap(), 1600),
            ("knot", Knot { p: 2, q: 3, tube_radius: 0.14, ridges: 0.15, columns: 400, rows: 16 }.mesh().unwrap(), 12_800),
            ("blob", Blob { subdivisions: 4, fur: 0.03, seed: 0 }.mesh().unwrap(), 5120),
        ]
    }

    /// How often each edge is passed in each direction, by the places of its ends.
    fn edges(mesh: &Mesh) -> BTreeMap<[[u32; 3]; 2], i32> {
        let mut edges = BTreeMap::new();
        for corners in mesh.triangles() {
            for k in 0..3 {
                // A zero has two signs and one place.
                let place = |corner: u32| (mesh.positions()[corner as usize] + Vec3::ZERO).to_array().map(f32::to_bits);
                let (a, b) = (place(corners[k]), place(corners[(k + 1) % 3]));
                *edges.entry(if a < b { [a, b] } else { [b, a] }).or_insert(0) += if a < b { 1 } else { -1 };
            }
        }
        edges
    }

    /// Six times the volume, positive where triangles face outwards.
    fn volume(mesh: &Mesh) -> f64 {
        let of = |triangle: usize| {
            let [a, b, c] = mesh.corners(triangle).map(Vec3::as_dvec3);
            a.dot(b.cross(c))
        };
        (0..mesh.triangles().len()).map(of).sum()
    }

    #[test]
    fn generated_meshes_are_closed_and_face_outwards() {
        for (name, mesh, count) in meshes() {
            assert_eq!(mesh.triangles().len(), count, "{name}");
            assert!(edges(&mesh).values().all(|&balance| balance == 0), "{name} has a hole");
            assert!(volume(&mesh) > 0.0, "{name}");
            for (triangle, corners) in mesh.triangles().iter().enumerate() {
                let normal = crate::render::mesh::face_normal(mesh.corners(triangle));
                let mean: Vec3 = corners.iter().map(|&corner| mesh.normals()[corner as usize]).sum();
                assert!(normal.dot(mean) > 0.0, "{name} {triangle}");
            }
        }
    }

    #[test]
    fn volumes_are_those_of_the_bodies() {
        let sphere = Icosphere { subdivisions: 6, radius: 1.0, relief: None }.mesh().unwrap();
        assert!((volume(&sphere) / 6.0 / (4.0 * PI / 3.0) - 1.0).abs() < 1e-3);
        let torus = Torus { radius: 1.0, tube_radius: 0.4, columns: 256, rows: 128 }.mesh().unwrap();
        assert!((volume(&torus) / 6.0 / (2.0 * PI * PI * 0.16) - 1.0).abs() < 1e-3);
    }

    #[test]
    fn stand_ins_are_as_complex_as_what_they_stand_for_and_fit_the_unit_sphere() {
        let shape = |text: &str| serde_json::from_str::<crate::render::shape::Shape>(text).unwrap();
        for (text, counts) in [(r#"{"knot":{}}"#, 90_000..110_000), (r#"{"blob":{}}"#, 60_000..90_000)] {
            let crate::render::shape::Form::Mesh(mesh) =
                shape(text).form(|_| -> Result<_, ShapeError> { unreachable!("no file is named") }).unwrap()
            else {
                panic!("{text}")
            };
            assert!(counts.contains(&mesh.triangles().len()), "{text}");
            let farthest = mesh.positions().iter().map(|position| position.length()).fold(0.0, f32::max);
            assert!(farthest > 0.8 && farthest <= 1.0, "{text}: {farthest}");
        }
    }

    #[test]
    fn what_cannot_be_made_is_an_error() {
        assert!(matches!(Torus { radius: 1.0, tube_radius: 1.0, columns: 9, rows: 9 }.mesh(), Err(ShapeError::FatTorus { .. })));
        assert!(Icosphere { subdivisions: 1, radius: 1e300, relief: None }.mesh().is_err());
        assert!(Icosphere { subdivisions: 1, radius: 1e-300, relief: None }.mesh().is_err());
    }
}

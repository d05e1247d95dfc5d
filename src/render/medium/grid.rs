//! Densities on a grid: voxels of a file or of the scene, interpolated linearly between their centers.
//!
//! The grid fills the box around the shape, in the shape's own coordinates, so that it is moved and turned with it.
//! Between the outermost centers and the faces of the box the value stays what it is at the outermost center.

use std::sync::Arc;

use glam::{DAffine3, DMat3, DVec3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::render::medium::phase::PhaseDescription;
use crate::render::medium::{Extinction, Place, isotropic, unit_extinction, white};
use crate::render::ray::Ray;
use crate::render::scene_file::SceneFile;
use crate::render::texture::value::{Color, Number, Share};

/// Densities on a grid that fills the box around the shape, in the shape's own coordinates.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct GridParameters {
    /// Extinction where the density is 1: one number, since the color comes from the `albedo`. Default 1.
    #[serde(default = "unit_extinction")]
    #[schemars(extend("x-unit" = "1/length"))]
    pub sigma_t: Number<Extinction>,
    /// Share of a collision that is scattered on: a number or `[r, g, b]`. Default 1.
    #[serde(default = "white")]
    pub albedo: Color<Share>,
    /// Into which directions it scatters. Default `isotropic`.
    #[serde(default = "isotropic")]
    pub phase: PhaseDescription,
    /// A file of densities: NPY with three axes (z, y, x), or a volume of Mitsuba (VOL) with one channel.
    #[serde(default)]
    pub path: Option<SceneFile>,
    /// The densities themselves, by z, y and x: `[[[0, 1], [1, 0]], [[1, 1], [0, 0]]]`.
    #[serde(default)]
    pub values: Option<Vec<Vec<Vec<f32>>>>,
}

impl GridParameters {
    /// The parameter that cannot be used with the others.
    pub fn contradiction(&self) -> Option<(&'static str, String)> {
        match (&self.path, &self.values) {
            (None, None) => Some(("", GridError::Missing.to_string())),
            (Some(_), Some(_)) => Some(("values", "`path` and `values` both give the densities".to_owned())),
            (None, Some(_)) => self.own_voxels()?.err().map(|error| ("values", error.to_string())),
            (Some(_), None) => None,
        }
    }

    /// The voxels that stand in the scene itself.
    pub fn own_voxels(&self) -> Option<Result<Voxels, GridError>> {
        let layers = self.values.as_ref()?;
        let rows = layers.first().map_or(0, Vec::len);
        let columns = layers.first().and_then(|layer| layer.first()).map_or(0, Vec::len);
        let is_even = layers.iter().all(|layer| layer.len() == rows && layer.iter().all(|row| row.len() == columns));
        let values = || layers.iter().flatten().flatten().copied().collect();
        Some(if is_even { Voxels::new([columns, rows, layers.len()], values()) } else { Err(GridError::Uneven) })
    }
}

/// What is wrong with voxels.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum GridError {
    /// None at all.
    #[error("the grid needs the `path` of a file, or `values`")]
    Missing,
    /// Lists of different lengths.
    #[error("the lists of `values` must have the same length within each other")]
    Uneven,
    /// None, or too many.
    #[error("a grid has from 1 to {LIMIT} voxels, and this one is {0} x {1} x {2}")]
    Size(usize, usize, usize),
    /// A density that cannot be.
    #[error("voxel {0} is {1}; a density is a number from 0 to 1e6")]
    Value(usize, f32),
    /// Bytes that are no grid.
    #[error("{0}")]
    File(String),
}

/// Most voxels.
const LIMIT: usize = 1 << 28;
/// The greatest density.
const GREATEST: f32 = 1e6;

/// Densities in a box, by x, then y, then z.
#[derive(Debug, Clone, PartialEq)]
pub struct Voxels {
    size: [usize; 3],
    values: Vec<f32>,
    greatest: f32,
}

impl Voxels {
    /// Checks them.
    pub fn new(size: [usize; 3], values: Vec<f32>) -> Result<Self, GridError> {
        let [x, y, z] = size;
        let count = checked_count(size)?;
        if values.len() != count {
            return Err(GridError::Size(x, y, z));
        }
        if let Some(place) = values.iter().position(|value| !(0.0..=GREATEST).contains(value)) {
            return Err(GridError::Value(place, values[place]));
        }
        let greatest = values.iter().copied().fold(0.0, f32::max);
        Ok(Self { size, values, greatest })
    }

    /// Reads NPY with three axes, or Mitsuba's VOL.
    pub fn read(bytes: &[u8]) -> Result<Self, GridError> {
        if bytes.starts_with(b"VOL") {
            read_vol(bytes)
        } else if bytes.starts_with(b"\x93NUMPY") {
            read_npy(bytes)
        } else {
            Err(GridError::File("neither NPY nor a volume of Mitsuba (VOL)".to_owned()))
        }
    }

    /// Voxels along x, y and z.
    pub fn size(&self) -> [usize; 3] {
        self.size
    }

    /// The value at a point of the unit cube, trilinear between the centers.
    #[inline]
    fn at(&self, point: DVec3) -> f64 {
        let axis = |k: usize| {
            let count = self.size[k];
            let place = (point[k] * count as f64 - 0.5).clamp(0.0, (count - 1) as f64);
            let low = (place as usize).min(count - 1);
            (low, (low + 1).min(count - 1), (place - low as f64) as f32)
        };
        let [(x0, x1, fx), (y0, y1, fy), (z0, z1, fz)] = [axis(0), axis(1), axis(2)];
        let row = |y: usize, z: usize| {
            let start = (z * self.size[1] + y) * self.size[0];
            mix(self.values[start + x0], self.values[start + x1], fx)
        };
        let layer = |z: usize| mix(row(y0, z), row(y1, z), fy);
        mix(layer(z0), layer(z1), fz).into()
    }
}

fn checked_count([x, y, z]: [usize; 3]) -> Result<usize, GridError> {
    let count = x.checked_mul(y).and_then(|count| count.checked_mul(z));
    count.filter(|count| (1..=LIMIT).contains(count)).ok_or(GridError::Size(x, y, z))
}

/// Between `a` and `b`, never beyond either: the majorant is the greatest voxel.
#[inline]
fn mix(a: f32, b: f32, share: f32) -> f32 {
    (a + (b - a) * share).clamp(a.min(b), a.max(b))
}

/// "VOL", version 3, then little-endian: 1 (for f32), three sizes, channels, a box of six f32, and the values by x, y, z.
fn read_vol(bytes: &[u8]) -> Result<Voxels, GridError> {
    const HEADER: usize = 48;
    let wrong = |what: &str| Err(GridError::File(format!("VOL: {what}")));
    if bytes.len() < HEADER {
        return wrong("the file ends within its header");
    }
    let integer = |place: usize| i32::from_le_bytes(std::array::from_fn(|k| bytes[place + k]));
    if bytes[3] != 3 || integer(4) != 1 {
        return wrong("only version 3 with values of 32-bit floats (type 1) is read");
    }
    if integer(20) != 1 {
        return wrong("a density has one channel");
    }
    let size = [8, 12, 16].map(|place| usize::try_from(integer(place)).unwrap_or(0));
    let count = checked_count(size)?;
    if bytes.len() - HEADER != 4 * count {
        return wrong(&format!("{} bytes of values where {} voxels need {}", bytes.len() - HEADER, count, 4 * count));
    }
    Voxels::new(size, floats(&bytes[HEADER..], f32::from_le_bytes))
}

fn floats<const N: usize>(bytes: &[u8], of: impl Fn([u8; N]) -> f32) -> Vec<f32> {
    bytes.as_chunks::<N>().0.iter().map(|bytes| of(*bytes)).collect()
}

/// NPY with the shape (z, y, x) in C order: little-endian f4 or f8, or u1 (255 is 1).
fn read_npy(bytes: &[u8]) -> Result<Voxels, GridError> {
    let wrong = |what: &str| GridError::File(format!("NPY: {what}"));
    let (start, length): (usize, usize) = match bytes.get(6) {
        Some(1) if bytes.len() >= 10 => (10, usize::from(u16::from_le_bytes([bytes[8], bytes[9]]))),
        Some(2 | 3) if bytes.len() >= 12 => (12, u32::from_le_bytes([bytes[8], bytes[9], bytes[10], bytes[11]]) as usize),
        _ => return Err(wrong("the file ends within its header, or its version is unknown")),
    };
    let header = bytes.get(start..start.saturating_add(length)).ok_or_else(|| wrong("the file ends within its header"))?;
    let header = str::from_utf8(header).map_err(|_| wrong("the header is not text"))?;
    if !after(header, "'fortran_order'").is_some_and(|rest| rest.starts_with("False")) {
        return Err(wrong("only C order is read: numpy.ascontiguousarray"));
    }
    let shape = after(header, "'shape'").and_then(|rest| rest.strip_prefix('(')?.split_once(')'));
    let (shape, _) = shape.ok_or_else(|| wrong("the header has no `shape`"))?;
    let axes: Vec<usize> = shape.split(',').map(str::trim).filter(|part| !part.is_empty()).map_while(|part| part.parse().ok()).collect();
    let [z, y, x] = axes[..] else { return Err(wrong("a grid has three axes: z, y, x")) };
    let count = checked_count([x, y, z])?;
    let values = &bytes[start + length..];
    let sized = |width: usize| {
        let message = format!("{} bytes of values where {count} voxels need {}", values.len(), width * count);
        (values.len() == width * count).then_some(()).ok_or_else(|| wrong(&message))
    };
    let descr = after(header, "'descr'").unwrap_or("");
    let values = match descr.get(..5) {
        Some("'<f4'") => sized(4).map(|()| floats(values, f32::from_le_bytes)),
        Some("'<f8'") => sized(8).map(|()| floats(values, |bytes| f64::from_le_bytes(bytes) as f32)),
        Some("'|u1'") => sized(1).map(|()| values.iter().map(|value| f32::from(*value) / 255.0).collect()),
        _ => Err(wrong("values are read of the types f4, f8 (little-endian) and u1 alone")),
    }?;
    Voxels::new([x, y, z], values)
}

/// What stands behind a key of the header.
fn after<'a>(header: &'a str, key: &str) -> Option<&'a str> {
    Some(header.split_once(key)?.1.trim_start().strip_prefix(':')?.trim_start())
}

/// Voxels in their place.
#[derive(Debug, Clone, PartialEq)]
pub struct Grid {
    voxels: Arc<Voxels>,
    /// From the world to the unit cube.
    to_unit: DAffine3,
}

impl Grid {
    /// In the box around a shape.
    pub fn new(voxels: Arc<Voxels>, place: &Place) -> Self {
        let halves = DAffine3 { matrix3: DMat3::from_diagonal(DVec3::splat(0.5)), translation: DVec3::splat(0.5) };
        Self { voxels, to_unit: halves * place.to_world.inverse() }
    }

    /// The greatest density.
    pub fn greatest(&self) -> f64 {
        self.voxels.greatest.into()
    }

    /// The density at a point of a ray.
    #[inline]
    pub fn at(&self, ray: &Ray, distance: f64) -> f64 {
        let point = ray.origin.as_dvec3() + ray.direction.as_dvec3() * distance;
        self.voxels.at(self.to_unit.transform_point3(point))
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;
    use crate::render::shape::bvh::Bounds;

    fn parameters(text: &str) -> GridParameters {
        serde_yaml::from_str(text).unwrap()
    }

    #[test]
    fn lists_of_values_are_layers_of_rows() {
        let voxels = parameters("{ values: [[[0, 1, 2]], [[3, 4, 5]]] }").own_voxels().unwrap().unwrap();
        assert_eq!((voxels.size(), voxels.greatest), ([3, 1, 2], 5.0));
        for (text, field) in [
            ("{}", ""),
            ("{ values: [[[0, 1], [1]]] }", "values"),
            ("{ values: [] }", "values"),
            ("{ values: [[[-1]]] }", "values"),
            ("{ values: [[[0]]], path: a.npy }", "values"),
        ] {
            assert_eq!(parameters(text).contradiction().unwrap().0, field, "{text}");
        }
        assert_eq!(parameters("{ path: a.npy }").contradiction(), None);
    }

    #[test]
    fn densities_are_linear_between_centers_and_constant_beyond() {
        let voxels = Arc::new(parameters("{ values: [[[1, 2], [1, 2]]] }").own_voxels().unwrap().unwrap());
        let to_world = DAffine3::from_translation(DVec3::X) * DAffine3::from_scale(DVec3::new(2.0, 1.0, 1.0));
        let place = Place { bounds: Bounds::EMPTY, to_world };
        let grid = Grid::new(voxels, &place);
        // The box goes from -1 to 3, so that the centers are at 0 and 2.
        for (x, expected) in [(-1.0, 1.0), (-0.2, 1.0), (0.5, 1.25), (1.0, 1.5), (2.0, 2.0), (2.9, 2.0)] {
            let found = grid.at(&Ray::new(Vec3::ZERO, Vec3::X), x);
            assert!((found - expected).abs() < 1e-6, "{x}: {found}");
        }
    }

    #[test]
    fn npy_and_vol_hold_the_same() {
        let values: Vec<f32> = (0..24).map(|k| k as f32 / 8.0).collect();
        let expected = Voxels::new([2, 3, 4], values.clone()).unwrap();
        let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        let mut vol = b"VOL\x03".to_vec();
        [1, 2, 3, 4, 1].into_iter().for_each(|value: i32| vol.extend(value.to_le_bytes()));
        vol.extend([0; 24]);
        vol.extend(&bytes);
        assert_eq!(Voxels::read(&vol), Ok(expected.clone()));
        let npy = |descr: &str, shape: &str, values: &[u8]| {
            let header = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': ({shape}), }}\n");
            [b"\x93NUMPY\x01\x00".as_slice(), &(header.len() as u16).to_le_bytes(), header.as_bytes(), values].concat()
        };
        assert_eq!(Voxels::read(&npy("<f4", "4, 3, 2", &bytes)), Ok(expected));
        for (wrong, said) in [
            (npy("<f4", "4, 6", &bytes), "three axes"),
            (npy("<i4", "4, 3, 2", &bytes), "types"),
            (npy("<f4", "4, 3, 3", &bytes), "144"),
            (npy("<f4", "99999999, 99999999, 99999999", &bytes), "voxels"),
            (vol[..60].to_vec(), "VOL"),
            (b"PF".to_vec(), "neither"),
        ] {
            let message = Voxels::read(&wrong).unwrap_err().to_string();
            assert!(message.contains(said), "{message}");
        }
    }
}

//! glTF 2.0 and GLB: all triangles of the default scene, moved to where their nodes are.
//!
//! The crate gltf reads and checks the JSON; numbers are taken out of the buffers here, since that crate panics on
//! accessors of odd types. Materials, skins, morph targets and animations are left out; u, v are turned so that v is up.
//! Source: Khronos, "glTF 2.0 specification" (2021).

use std::collections::BTreeSet;

use glam::{DAffine3, DMat4, Vec3};
use gltf::accessor::{DataType, Dimensions};
use gltf::mesh::Mode;
use gltf::{Accessor, Document, Node, Primitive, Semantic};

use crate::render::mesh::read::{ReadError, degenerate_warning, shown};
use crate::render::mesh::{Arrays, Mesh};

const FORMAT: &str = "glTF";
/// Nodes below nodes; a cycle is deeper than any tree.
const DEEPEST: usize = 256;
/// A small file can place a mesh again and again.
const MOST_TRIANGLES: usize = 1 << 25;

/// Gives the content of a file beside the glTF file, by its relative path as the file has it.
pub type Buffers<'a> = dyn Fn(&str) -> Option<Vec<u8>> + 'a;

/// Reads a file's bytes; the mesh and what is odd about it.
pub fn read(bytes: &[u8], files: &Buffers<'_>) -> Result<(Mesh, Vec<String>), ReadError> {
    let parsed = gltf::Gltf::from_slice_without_validation(bytes).map_err(|error| refused(&error))?;
    let document = checked(parsed.document)?;
    let buffers = buffers(&document, parsed.blob, files)?;
    let mut found = Found { buffers, arrays: Arrays::default(), has_normals: true, has_uvs: true, passed_over: 0 };
    match document.default_scene().or_else(|| document.scenes().next()) {
        Some(scene) => scene.nodes().try_for_each(|node| found.node(&node, DAffine3::IDENTITY, 0))?,
        None => {
            let children: BTreeSet<usize> = document.nodes().flat_map(|node| node.children()).map(|child| child.index()).collect();
            let mut roots = document.nodes().filter(|node| !children.contains(&node.index()));
            roots.try_for_each(|node| found.node(&node, DAffine3::IDENTITY, 0))?;
        }
    }
    let (arrays, passed_over) = found.finished();
    let (mesh, degenerate) = Mesh::new(arrays).map_err(|error| ReadError::mesh(FORMAT, error))?;
    let points = (passed_over > 0).then(|| format!("{passed_over} primitives of points or lines were left out"));
    Ok((mesh, points.into_iter().chain(degenerate_warning(degenerate)).collect()))
}

fn damaged(problem: impl Into<String>) -> ReadError {
    ReadError::damaged(FORMAT, problem)
}

fn refused(error: &gltf::Error) -> ReadError {
    damaged(shown_text(&error.to_string()))
}

/// The document, found to be valid. The crate's own check goes by the accessor of a primitive's positions before it
/// has checked that there is one.
fn checked(document: Document) -> Result<Document, ReadError> {
    let json = document.into_json();
    let primitives = json.meshes.iter().flat_map(|mesh| &mesh.primitives);
    let mut accessors = primitives.flat_map(|primitive| primitive.attributes.values());
    if let Some(missing) = accessors.find(|accessor| accessor.value() >= json.accessors.len()) {
        return Err(damaged(format!("a primitive names accessor {}, and there are {}", missing.value(), json.accessors.len())));
    }
    Document::from_json(json).map_err(|error| refused(&error))
}

fn shown_text(text: &str) -> String {
    text.chars().take(200).filter(|character| !character.is_control()).collect()
}

fn buffers(document: &Document, mut blob: Option<Vec<u8>>, files: &Buffers<'_>) -> Result<Vec<Vec<u8>>, ReadError> {
    let content = |buffer: gltf::Buffer<'_>| -> Result<Vec<u8>, ReadError> {
        match buffer.source() {
            gltf::buffer::Source::Bin => blob.take().ok_or_else(|| damaged("the binary part of the file is missing")),
            gltf::buffer::Source::Uri(uri) => match uri.strip_prefix("data:") {
                Some(data) => data_of(data).ok_or_else(|| damaged("a data URI is not base64")),
                None => files(&decoded(uri)).ok_or_else(|| ReadError::MissingBuffer(shown(uri.as_bytes()))),
            },
        }
    };
    document.buffers().map(content).collect()
}

/// The bytes of `[TYPE];base64,DATA`.
fn data_of(uri: &str) -> Option<Vec<u8>> {
    let (kind, data) = uri.split_once(',')?;
    kind.ends_with(";base64").then(|| base64(data.as_bytes()))?
}

/// RFC 4648, with or without padding.
fn base64(text: &[u8]) -> Option<Vec<u8>> {
    let text = text.strip_suffix(b"==").or_else(|| text.strip_suffix(b"=")).unwrap_or(text);
    let mut bytes = Vec::with_capacity(text.len() / 4 * 3 + 3);
    for group in text.chunks(4) {
        let mut bits = 0_u32;
        for &letter in group {
            let six = match letter {
                b'A'..=b'Z' => letter - b'A',
                b'a'..=b'z' => letter - b'a' + 26,
                b'0'..=b'9' => letter - b'0' + 52,
                b'+' => 62,
                b'/' => 63,
                _ => return None,
            };
            bits = (bits << 6) | u32::from(six);
        }
        bits <<= 6 * (4 - group.len());
        let count = match group.len() {
            1 => return None,
            length => length - 1,
        };
        bytes.extend(&bits.to_be_bytes()[1..=count]);
    }
    Some(bytes)
}

/// A URI's path without its percent signs.
fn decoded(uri: &str) -> String {
    let bytes = uri.as_bytes();
    let (mut out, mut place) = (Vec::new(), 0);
    while place < bytes.len() {
        let code = (bytes[place] == b'%').then(|| uri.get(place + 1..place + 3)).flatten();
        match code.and_then(|code| u8::from_str_radix(code, 16).ok()) {
            Some(byte) => {
                out.push(byte);
                place += 3;
            }
            None => {
                out.push(bytes[place]);
                place += 1;
            }
        }
    }
    String::from_utf8_lossy(&out).into_owned()
}

/// The arrays so far.
struct Found {
    buffers: Vec<Vec<u8>>,
    arrays: Arrays,
    has_normals: bool,
    has_uvs: bool,
    passed_over: usize,
}

impl Found {
    fn node(&mut self, node: &Node<'_>, parent: DAffine3, depth: usize) -> Result<(), ReadError> {
        let local = DMat4::from_cols_array_2d(&node.transform().matrix().map(|column| column.map(f64::from)));
        let place = parent * DAffine3::from_mat4(local);
        if let Some(mesh) = node.mesh() {
            mesh.primitives().try_for_each(|primitive| self.primitive(&primitive, &place))?;
        }
        if depth == DEEPEST {
            return Err(damaged(format!("nodes are nested more than {DEEPEST} deep, or in a circle")));
        }
        node.children().try_for_each(|child| self.node(&child, place, depth + 1))
    }

    fn primitive(&mut self, primitive: &Primitive<'_>, place: &DAffine3) -> Result<(), ReadError> {
        if matches!(primitive.mode(), Mode::Points | Mode::Lines | Mode::LineLoop | Mode::LineStrip) {
            self.passed_over += 1;
            return Ok(());
        }
        let Some(positions) = primitive.get(&Semantic::Positions) else { return Ok(()) };
        let base = self.arrays.positions.len();
        let positions = self.numbers(&positions, 3)?;
        let count = positions.len() / 3;
        let whole = |values: Option<Vec<f32>>, width: usize| values.filter(|values| values.len() == width * count);
        let normals = primitive.get(&Semantic::Normals).map(|accessor| self.numbers(&accessor, 3)).transpose()?;
        let uvs = primitive.get(&Semantic::TexCoords(0)).map(|accessor| self.numbers(&accessor, 2)).transpose()?;
        let (normals, uvs) = (whole(normals, 3), whole(uvs, 2));
        let indices = match primitive.indices() {
            Some(accessor) => self.indices(&accessor)?,
            None => (0..count as u32).collect(),
        };
        let is_mirrored = place.matrix3.determinant() < 0.0;
        let corners = triangles_of(primitive.mode(), &indices);
        if self.arrays.triangles.len() + corners.len() > MOST_TRIANGLES || base + count > u32::MAX as usize {
            return Err(ReadError::unsupported(FORMAT, format!("more than {MOST_TRIANGLES} triangles after all nodes are placed")));
        }
        for corners in corners {
            if let Some(index) = corners.iter().find(|&&index| index as usize >= count) {
                return Err(damaged(format!("there is no vertex with the index `{index}`; the primitive has {count}")));
            }
            let [a, b, c] = corners.map(|index| index + base as u32);
            self.arrays.triangles.push(if is_mirrored { [a, c, b] } else { [a, b, c] });
        }
        let points = positions.chunks_exact(3).map(|point| place.transform_point3(Vec3::from_slice(point).as_dvec3()).as_vec3());
        self.arrays.positions.extend(points);
        // The inverse transpose, but for a positive factor.
        let cofactor = {
            let [x, y, z] = [place.matrix3.x_axis, place.matrix3.y_axis, place.matrix3.z_axis];
            let sign = if is_mirrored { -1.0 } else { 1.0 };
            [y.cross(z) * sign, z.cross(x) * sign, x.cross(y) * sign]
        };
        self.has_normals &= normals.is_some();
        if let Some(normals) = normals {
            let turned = |n: &[f32]| cofactor[0] * f64::from(n[0]) + cofactor[1] * f64::from(n[1]) + cofactor[2] * f64::from(n[2]);
            self.arrays.normals.extend(normals.chunks_exact(3).map(|normal| turned(normal).normalize_or_zero().as_vec3()));
        }
        self.has_uvs &= uvs.is_some();
        if let Some(uvs) = uvs {
            self.arrays.uvs.extend(uvs.chunks_exact(2).map(|uv| [uv[0], 1.0 - uv[1]]));
        }
        Ok(())
    }

    /// Normals and texture coordinates count only if every primitive has them.
    fn finished(mut self) -> (Arrays, usize) {
        if !self.has_normals {
            self.arrays.normals = Vec::new();
        }
        if !self.has_uvs {
            self.arrays.uvs = Vec::new();
        }
        (self.arrays, self.passed_over)
    }

    /// The bytes of each item of an accessor, if the buffer has them all.
    fn items<'s>(&'s self, accessor: &Accessor<'_>, width: usize) -> Result<impl Iterator<Item = &'s [u8]>, ReadError> {
        if accessor.sparse().is_some() {
            return Err(ReadError::unsupported(FORMAT, "sparse accessors"));
        }
        let outside = || damaged(format!("accessor {} lies outside its buffer", accessor.index()));
        let view = accessor.view().ok_or_else(|| damaged(format!("accessor {} has no buffer view", accessor.index())))?;
        let data = self.buffers.get(view.buffer().index()).ok_or_else(outside)?;
        let end = view.offset().checked_add(view.length()).ok_or_else(outside)?;
        let data = data.get(view.offset()..end).ok_or_else(outside)?.get(accessor.offset()..).ok_or_else(outside)?;
        let (count, stride) = (accessor.count(), view.stride().unwrap_or(width).max(width));
        let needed = count.saturating_sub(1).checked_mul(stride).and_then(|length| length.checked_add(width)).ok_or_else(outside)?;
        if count > 0 && needed > data.len() {
            return Err(outside());
        }
        Ok((0..count).map(move |item| &data[item * stride..item * stride + width]))
    }

    /// Floats, or normalized integers as floats.
    fn numbers(&self, accessor: &Accessor<'_>, dimension: usize) -> Result<Vec<f32>, ReadError> {
        let expected = if dimension == 3 { Dimensions::Vec3 } else { Dimensions::Vec2 };
        if accessor.dimensions() != expected {
            return Err(damaged(format!("accessor {} has items of another number of components than {dimension}", accessor.index())));
        }
        let size = accessor.data_type().size();
        let component: fn(&[u8]) -> f32 = match (accessor.data_type(), accessor.normalized()) {
            (DataType::F32, _) => |bytes| f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]),
            (DataType::U8, true) => |bytes| f32::from(bytes[0]) / 255.0,
            (DataType::I8, true) => |bytes| (f32::from(bytes[0] as i8) / 127.0).max(-1.0),
            (DataType::U16, true) => |bytes| f32::from(u16::from_le_bytes([bytes[0], bytes[1]])) / 65535.0,
            (DataType::I16, true) => |bytes| (f32::from(i16::from_le_bytes([bytes[0], bytes[1]])) / 32767.0).max(-1.0),
            _ => return Err(ReadError::unsupported(FORMAT, format!("accessor {} of whole numbers", accessor.index()))),
        };
        let items = self.items(accessor, size * dimension)?;
        Ok(items.flat_map(|item| item.chunks_exact(size).map(component)).collect())
    }

    fn indices(&self, accessor: &Accessor<'_>) -> Result<Vec<u32>, ReadError> {
        let index: fn(&[u8]) -> u32 = match (accessor.dimensions(), accessor.data_type()) {
            (Dimensions::Scalar, DataType::U8) => |bytes| u32::from(bytes[0]),
            (Dimensions::Scalar, DataType::U16) => |bytes| u32::from(u16::from_le_bytes([bytes[0], bytes[1]])),
            (Dimensions::Scalar, DataType::U32) => |bytes| u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]),
            _ => return Err(damaged(format!("accessor {} is not one of indices", accessor.index()))),
        };
        Ok(self.items(accessor, accessor.data_type().size())?.map(index).collect())
    }
}

fn triangles_of(mode: Mode, indices: &[u32]) -> Vec<[u32; 3]> {
    let third = |k: usize| [indices[k], indices[k + 1], indices[k + 2]];
    let count = indices.len().saturating_sub(2);
    match mode {
        Mode::TriangleStrip => {
            (0..count).map(third).enumerate().map(|(k, [a, b, c])| if k % 2 == 0 { [a, b, c] } else { [b, a, c] }).collect()
        }
        Mode::TriangleFan => (1..=count).map(|k| [indices[0], indices[k], indices[k + 1]]).collect(),
        _ => indices.chunks_exact(3).map(|corners| [corners[0], corners[1], corners[2]]).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::mesh::write;

    /// Two nodes that show one triangle, the second mirrored, moved and below another.
    fn file(buffer: &str) -> String {
        format!(
            r#"{{ "asset": {{ "version": "2.0" }}, "scene": 0, "scenes": [{{ "nodes": [0, 1] }}],
            "nodes": [{{ "mesh": 0 }}, {{ "children": [2], "translation": [0, 0, 5] }}, {{ "mesh": 0, "scale": [-2, 2, 2] }}],
            "meshes": [{{ "primitives": [{{ "attributes": {{ "POSITION": 0, "TEXCOORD_0": 1 }}, "indices": 2 }}] }}],
            "accessors": [
              {{ "bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0] }},
              {{ "bufferView": 0, "byteOffset": 4, "componentType": 5126, "count": 3, "type": "VEC2" }},
              {{ "bufferView": 1, "componentType": 5123, "count": 3, "type": "SCALAR" }}],
            "bufferViews": [{{ "buffer": 0, "byteLength": 36, "byteStride": 12 }}, {{ "buffer": 0, "byteOffset": 36, "byteLength": 6 }}],
            "buffers": [{{ "byteLength": 42, "uri": "{buffer}" }}] }}"#
        )
    }

    fn numbers() -> Vec<u8> {
        let floats = [0.0_f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0].into_iter().flat_map(f32::to_le_bytes);
        floats.chain([0_u16, 1, 2].into_iter().flat_map(u16::to_le_bytes)).collect()
    }

    fn to_base64(bytes: &[u8]) -> String {
        const LETTERS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
        let group = |chunk: &[u8]| {
            let bits = chunk.iter().chain([0; 2].iter()).take(3).fold(0_u32, |bits, &byte| (bits << 8) | u32::from(byte));
            let letters: String = (0..4).map(|k| char::from(LETTERS[(bits >> (18 - 6 * k)) as usize & 63])).collect();
            letters[..=chunk.len()].to_owned() + &"=".repeat(3 - chunk.len())
        };
        bytes.chunks(3).map(group).collect()
    }

    fn check(mesh: &Mesh) {
        assert_eq!(mesh.triangles(), [[0, 1, 2], [3, 5, 4]]);
        assert_eq!(mesh.positions()[3..], [Vec3::new(0.0, 0.0, 5.0), Vec3::new(-2.0, 0.0, 5.0), Vec3::new(0.0, 2.0, 5.0)]);
        assert_eq!(mesh.uvs()[..3], [[0.0, 1.0], [0.0, 1.0], [1.0, 1.0]]);
        assert!(mesh.normals().is_empty());
    }

    #[test]
    fn nodes_place_their_triangles() {
        let text = file(&format!("data:application/octet-stream;base64,{}", to_base64(&numbers())));
        check(&read(text.as_bytes(), &|_| None).unwrap().0);
        let beside = |name: &str| (name == "a b.bin").then(numbers);
        check(&read(file("a%20b.bin").as_bytes(), &beside).unwrap().0);
    }

    #[test]
    fn a_file_beside_that_is_not_given_is_named() {
        let error = read(file("mesh.bin").as_bytes(), &|_| None).unwrap_err();
        assert_eq!(error, ReadError::MissingBuffer("mesh.bin".into()));
    }

    #[test]
    fn a_single_file_has_its_numbers_inside() {
        let mut json = file("").replace(r#", "uri": """#, "").into_bytes();
        json.resize(json.len().next_multiple_of(4), b' ');
        let mut data = numbers();
        data.resize(data.len().next_multiple_of(4), 0);
        let chunk = |kind: &[u8; 4], data: &[u8]| [&(data.len() as u32).to_le_bytes(), kind.as_slice(), data].concat();
        let body = [chunk(b"JSON", &json), chunk(b"BIN\0", &data)].concat();
        let bytes = [b"glTF".as_slice(), &2_u32.to_le_bytes(), &(12 + body.len() as u32).to_le_bytes(), &body].concat();
        check(&read(&bytes, &|_| None).unwrap().0);
        for end in 0..bytes.len() {
            // The crate that reads the frame accepts a chunk whose padding is missing.
            let _ = read(&bytes[..end], &|_| None);
        }
    }

    #[test]
    fn odd_accessors_and_circles_are_refused() {
        let with = |from: &str, to: &str| {
            let text = file("x").replace(from, to);
            read(text.as_bytes(), &|_| Some(numbers())).unwrap_err().to_string()
        };
        assert!(with(r#""componentType": 5123"#, r#""componentType": 5126"#).contains("not one of indices"));
        assert!(with(r#""byteLength": 6"#, r#""byteLength": 5"#).contains("outside its buffer"));
        assert!(
            with(r#""componentType": 5126, "count": 3, "type": "VEC3""#, r#""componentType": 5126, "count": 4000000000, "type": "VEC3""#)
                .contains("outside its buffer")
        );
        assert!(
            with(r#""componentType": 5126, "count": 3, "type": "VEC3""#, r#""componentType": 5123, "count": 3, "type": "VEC3""#)
                .contains("whole numbers")
        );
        assert!(with(r#""scale": [-2, 2, 2]"#, r#""children": [1]"#).contains("in a circle"));
        assert!(with(r#""version": "2.0""#, r#""version": "2.0", "minVersion": 7"#).starts_with("glTF"));
        assert!(with(r#""scene": 0,"#, r#""scene": 0, "extensionsRequired": ["KHR_draco_mesh_compression"],"#).starts_with("glTF"));
    }

    #[test]
    fn base64_is_that_of_the_standard() {
        for (text, bytes) in [("", ""), ("Zg==", "f"), ("Zm8=", "fo"), ("Zm9v", "foo"), ("Zm9vYg", "foob"), ("Zm9vYmFy", "foobar")] {
            assert_eq!(base64(text.as_bytes()).unwrap(), bytes.as_bytes());
        }
        assert_eq!(base64(b"Z"), None);
        assert_eq!(base64(b"Zm9*"), None);
    }

    #[test]
    fn other_formats_are_no_gltf() {
        let sphere = crate::render::shape::generated::UvSphere { columns: 4, rows: 3, radius: 1.0, relief: None }.mesh().unwrap();
        assert!(read(&write::ply(&sphere), &|_| None).is_err());
    }
}

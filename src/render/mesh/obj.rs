//! Wavefront OBJ, by lines: vertices, normals, texture coordinates, polygons. Materials and groups are left out.
//!
//! Our own reader, because a mistake has to be named with its line. Polygons are cut into a fan from their first corner,
//! as if they were convex. Source: the appendix "Object Files (.obj)" of Wavefront's Advanced Visualizer manual.

use std::collections::HashMap;
use std::str::FromStr;

use glam::Vec3;

use crate::render::mesh::read::{ReadError, shown};
use crate::render::mesh::{Arrays, Mesh};

const FORMAT: &str = "OBJ";

/// Statements that say nothing about triangles and are passed over.
const PASSED_OVER: [&str; 36] = [
    "o",
    "g",
    "s",
    "usemtl",
    "mtllib",
    "l",
    "p",
    "mg",
    "vp",
    "deg",
    "bmat",
    "step",
    "cstype",
    "curv",
    "curv2",
    "surf",
    "parm",
    "trim",
    "hole",
    "scrv",
    "sp",
    "end",
    "con",
    "bevel",
    "c_interp",
    "d_interp",
    "lod",
    "shadow_obj",
    "trace_obj",
    "ctech",
    "stech",
    "usemap",
    "maplib",
    "call",
    "csh",
    "fo",
];

/// What the corners of a polygon name: position, texture coordinate and normal, from 0; the latter two may be absent.
type Corner = [u32; 3];
const ABSENT: u32 = u32::MAX;
const KINDS: [&str; 3] = ["vertex", "texture coordinate", "normal"];

/// Reads a file's bytes; the mesh and what is odd about it.
pub fn read(bytes: &[u8]) -> Result<(Mesh, Vec<String>), ReadError> {
    let mut file = File::default();
    for line in Lines::new(bytes) {
        file.statement(&line)?;
    }
    file.check_indices()?;
    if file.triangles.is_empty() {
        return Err(ReadError::damaged(FORMAT, "there is no face (triangle) in the file"));
    }
    let warnings = file.warnings();
    let (mesh, degenerate) = Mesh::new(file.arrays()).map_err(|error| ReadError::mesh(FORMAT, error))?;
    Ok((mesh, warnings.into_iter().chain(super::read::degenerate_warning(degenerate)).collect()))
}

#[derive(Default)]
struct File {
    positions: Vec<Vec3>,
    uvs: Vec<[f32; 2]>,
    normals: Vec<Vec3>,
    triangles: Vec<[Corner; 3]>,
    /// The largest index of each kind, and the line where it stands: what it names may follow later.
    largest: [Option<(u32, usize)>; 3],
    unknown: Option<(String, usize)>,
    unknown_count: usize,
}

/// A statement: continued lines are one.
struct Line<'a> {
    number: usize,
    text: std::borrow::Cow<'a, [u8]>,
}

struct Lines<'a> {
    rest: &'a [u8],
    number: usize,
}

impl<'a> Lines<'a> {
    fn new(bytes: &'a [u8]) -> Self {
        Self { rest: bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes), number: 0 }
    }

    fn physical(&mut self) -> Option<&'a [u8]> {
        if self.rest.is_empty() {
            return None;
        }
        self.number += 1;
        let end = self.rest.iter().position(|&byte| byte == b'\n').unwrap_or(self.rest.len());
        let line = &self.rest[..end];
        self.rest = self.rest.get(end + 1..).unwrap_or_default();
        Some(line.strip_suffix(b"\r").unwrap_or(line))
    }
}

impl<'a> Iterator for Lines<'a> {
    type Item = Line<'a>;

    fn next(&mut self) -> Option<Line<'a>> {
        let first = self.physical()?;
        let number = self.number;
        let Some(begin) = first.strip_suffix(b"\\") else { return Some(Line { number, text: first.into() }) };
        let mut text = begin.to_vec();
        while let Some(next) = self.physical() {
            text.push(b' ');
            match next.strip_suffix(b"\\") {
                Some(part) => text.extend(part),
                None => {
                    text.extend(next);
                    break;
                }
            }
        }
        Some(Line { number, text: text.into() })
    }
}

impl File {
    fn statement(&mut self, line: &Line<'_>) -> Result<(), ReadError> {
        let text = line.text.split(|&byte| byte == b'#').next().unwrap_or_default();
        let mut words = text.split(|byte| byte.is_ascii_whitespace()).filter(|word| !word.is_empty());
        let at = |problem: String| ReadError::damaged(FORMAT, format!("line {}: {problem}", line.number));
        match words.next() {
            None => {}
            Some(b"v") => {
                let [x, y, z] = numbers(words, 3, "vertex").map_err(at)?;
                self.positions.push(Vec3::new(x, y, z));
            }
            Some(b"vt") => {
                let [u, v, _] = numbers(words, 1, "texture coordinate").map_err(at)?;
                self.uvs.push([u, v]);
            }
            Some(b"vn") => {
                let [x, y, z] = numbers(words, 3, "normal").map_err(at)?;
                self.normals.push(Vec3::new(x, y, z));
            }
            Some(b"f" | b"fo") => self.face(words, line.number).map_err(at)?,
            Some(b"mtllib") => check_library(words.next().unwrap_or_default()).map_err(at)?,
            Some(word) if PASSED_OVER.iter().any(|known| known.as_bytes() == word) => {}
            Some(word) => {
                self.unknown_count += 1;
                self.unknown.get_or_insert_with(|| (shown(word), line.number));
            }
        }
        Ok(())
    }

    fn face<'w>(&mut self, words: impl Iterator<Item = &'w [u8]>, line: usize) -> Result<(), String> {
        let (mut first, mut previous, mut count) = ([0; 3], [0; 3], 0);
        for word in words {
            let corner = self.corner(word, line)?;
            match count {
                0 => first = corner,
                1 => {}
                _ => self.triangles.push([first, previous, corner]),
            }
            previous = corner;
            count += 1;
        }
        if count < 3 { Err(format!("a face has at least 3 corners, not {count}")) } else { Ok(()) }
    }

    /// `v`, `v/vt`, `v//vn` or `v/vt/vn`; numbers from 1, or negative from the last one back.
    fn corner(&mut self, word: &[u8], line: usize) -> Result<Corner, String> {
        let mut corner = [ABSENT; 3];
        let counts = [self.positions.len(), self.uvs.len(), self.normals.len()];
        let mut parts = word.split(|&byte| byte == b'/');
        for (kind, slot) in corner.iter_mut().enumerate() {
            let Some(part) = parts.next() else { break };
            if part.is_empty() && kind > 0 {
                continue;
            }
            let number: i64 = parsed(part).ok_or_else(|| format!("`{}` is not a whole number of a {}", shown(part), KINDS[kind]))?;
            let index = if number > 0 { number.checked_sub(1) } else { number.checked_add(counts[kind] as i64).filter(|_| number < 0) };
            let index = index.and_then(|index| u32::try_from(index).ok()).filter(|&index| index != ABSENT);
            let index = index.ok_or_else(|| format!("there is no {} with the index `{number}`", KINDS[kind]))?;
            if self.largest[kind].is_none_or(|(largest, _)| index > largest) {
                self.largest[kind] = Some((index, line));
            }
            *slot = index;
        }
        if parts.next().is_some() { Err(format!("`{}` has more than three indices", shown(word))) } else { Ok(corner) }
    }

    fn check_indices(&self) -> Result<(), ReadError> {
        let counts = [self.positions.len(), self.uvs.len(), self.normals.len()];
        for ((kind, count), largest) in KINDS.iter().zip(counts).zip(self.largest) {
            if let Some((index, line)) = largest.filter(|&(index, _)| index as usize >= count) {
                let problem = format!("line {line}: there is no {kind} with the index `{}`; the file has {count}", u64::from(index) + 1);
                return Err(ReadError::damaged(FORMAT, problem));
            }
        }
        Ok(())
    }

    fn warnings(&self) -> Option<String> {
        let (word, line) = self.unknown.as_ref()?;
        Some(format!("{} lines begin with an unknown word and were left out, the first one, `{word}`, in line {line}", self.unknown_count))
    }

    /// One vertex per combination of position, texture coordinate and normal, in the order of their first use; the
    /// positions as they are where nothing else is used.
    fn arrays(self) -> Arrays {
        let is_used = |kind: usize| self.triangles.iter().flatten().any(|corner| corner[kind] != ABSENT);
        let (has_uvs, has_normals) = (is_used(1), is_used(2));
        if !has_uvs && !has_normals {
            let triangles = self.triangles.iter().map(|corners| corners.map(|corner| corner[0])).collect();
            return Arrays { positions: self.positions, triangles, ..Arrays::default() };
        }
        let mut arrays = Arrays::default();
        let mut vertices: HashMap<Corner, u32> = HashMap::new();
        for corners in &self.triangles {
            arrays.triangles.push(corners.map(|corner| {
                *vertices.entry(corner).or_insert_with(|| {
                    let [position, uv, normal] = corner.map(|index| index as usize);
                    arrays.positions.push(self.positions[position]);
                    if has_uvs {
                        arrays.uvs.push(self.uvs.get(uv).copied().unwrap_or_default());
                    }
                    if has_normals {
                        // A zero normal becomes that of a triangle around.
                        arrays.normals.push(self.normals.get(normal).copied().unwrap_or_default());
                    }
                    arrays.positions.len() as u32 - 1
                })
            }));
        }
        arrays
    }
}

fn parsed<T: FromStr>(word: &[u8]) -> Option<T> {
    std::str::from_utf8(word).ok()?.parse().ok()
}

/// Up to three finite numbers, at least `least`; what is absent is zero.
fn numbers<'w>(words: impl Iterator<Item = &'w [u8]>, least: usize, what: &str) -> Result<[f32; 3], String> {
    let (mut values, mut count) = ([0.0_f32; 3], 0);
    for (value, word) in values.iter_mut().zip(words) {
        *value = parsed(word).ok_or_else(|| format!("`{}` is not a number of a {what}", shown(word)))?;
        if !value.is_finite() {
            return Err(format!("the {what} is not finite: `{}`", shown(word)));
        }
        count += 1;
    }
    if count < least { Err(format!("a {what} has {least} numbers, not {count}")) } else { Ok(values) }
}

/// A library is not read; but one outside the file's folder is a trick or a mistake.
fn check_library(path: &[u8]) -> Result<(), String> {
    let is_outside = path.starts_with(b"/") || path.split(|byte| matches!(byte, b'/' | b'\\')).any(|part| part == b"..");
    if is_outside { Err(format!("the material library `{}` is outside the folder of the file", shown(path))) } else { Ok(()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CORNERS: &str = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\n";

    fn mesh(text: &str) -> (Mesh, Vec<String>) {
        read(text.as_bytes()).unwrap()
    }

    fn refused(text: &str) -> String {
        read(text.as_bytes()).unwrap_err().to_string()
    }

    #[test]
    fn faces_are_read_in_all_their_forms() {
        for face in ["f 1 2 3", "f -4 -3 -2", "f 1 \\\n 2 3", "f 1// 2// 3//", "f\t1  2 3 # a comment"] {
            let (mesh, warnings) = mesh(&format!("{CORNERS}{face}\r\n"));
            assert_eq!((mesh.triangles(), mesh.positions().len(), warnings.len()), ([[0, 1, 2]].as_slice(), 4, 0), "{face}");
        }
        // Vertices may follow their faces.
        assert_eq!(mesh(&format!("f 1 2 4\n{CORNERS}")).0.triangles(), [[0, 1, 3]]);
    }

    #[test]
    fn corners_with_other_normals_or_coordinates_are_other_vertices() {
        let text = format!("{CORNERS}vt 0 0\nvt 1 0.5\nvn 0 0 2\nvn 0 0 4\nf 1/1/1 2/2/1 3/1/1\nf 3/1/1 2/2/1 4/2/2\nf 1/1 2 4//2\n");
        let (mesh, _) = mesh(&text);
        assert_eq!(mesh.triangles(), [[0, 1, 2], [2, 1, 3], [4, 5, 6]]);
        assert_eq!(mesh.uvs()[1], [1.0, 0.5]);
        assert_eq!(mesh.uvs()[5], [0.0, 0.0]);
        assert!(mesh.normals().iter().all(|normal| *normal == Vec3::Z));
    }

    #[test]
    fn polygons_are_fans() {
        assert_eq!(mesh(&format!("{CORNERS}f 1 2 4 3\n")).0.triangles(), [[0, 1, 3], [0, 3, 2]]);
    }

    #[test]
    fn mistakes_are_named_with_their_line() {
        for (face, word) in [
            ("f 0 1 2", "`0`"),
            ("f 1 2 5", "`5`"),
            ("f 1 2 -5", "`-5`"),
            ("f 1 2", "3 corners"),
            ("f", "3 corners"),
            ("f 1.5 2 3", "`1.5`"),
            ("f 1 2 18446744073709551617", "18446744073709551617"),
            ("f 1/ / 3", "``"),
            ("f 1/7 2/7 3/7", "texture coordinate"),
            ("f 1//7 2//7 3//7", "normal"),
            ("f 1/1/1/1 2 3", "three indices"),
            ("f 1 2 4294967297", "4294967297"),
            ("f -9223372036854775808 1 2", "-9223372036854775808"),
        ] {
            let message = refused(&format!("{CORNERS}{face}\n"));
            assert!(message.contains("line 5") && message.contains(word), "{face}: {message}");
        }
        for vertex in ["v nan 0 0", "v 1e400 0 0", "v 1 2", "v", "v x y z", "vn 1 2", "vt", "vt inf", "mtllib ../x.mtl", "mtllib /x"] {
            let message = refused(&format!("{vertex}\n{CORNERS}f 1 2 3\n"));
            assert!(message.contains("line 1"), "{vertex}: {message}");
        }
        assert!(refused("").contains("no face") && refused(CORNERS).contains("no face"));
        assert!(refused(&format!("{CORNERS}f 1 1 1\n")).contains("1 degenerate"));
    }

    #[test]
    fn unknown_words_and_flat_triangles_are_warnings() {
        let (mesh, warnings) = mesh(&format!("{CORNERS}what is this\nf 1 2 3\nf 1 2 2\n"));
        assert_eq!(mesh.triangles().len(), 1);
        assert!(warnings[0].contains("`what`, in line 5") && warnings[1].contains("1 triangle"), "{warnings:?}");
    }

    #[test]
    fn the_crate_tobj_reads_the_same() {
        let sphere = crate::render::shape::generated::UvSphere { columns: 12, rows: 6, radius: 2.0, relief: None }.mesh().unwrap();
        let bytes = crate::render::mesh::write::obj(&sphere);
        let (ours, _) = read(&bytes).unwrap();
        let options = tobj::LoadOptions { single_index: true, triangulate: true, ..Default::default() };
        let (models, _) = tobj::load_obj_buf(&mut bytes.as_slice(), &options, |_| Ok(Default::default())).unwrap();
        let theirs = &models[0].mesh;
        let flat = |mesh: &Mesh| mesh.triangles().iter().flatten().map(|&corner| mesh.positions()[corner as usize]).collect::<Vec<_>>();
        let of_theirs = |index: &u32| Vec3::from_slice(&theirs.positions[3 * *index as usize..]);
        assert_eq!(flat(&ours), theirs.indices.iter().map(of_theirs).collect::<Vec<_>>());
        assert_eq!(flat(&ours), flat(&sphere));
    }
}

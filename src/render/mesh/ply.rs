//! PLY, the Stanford polygon format: ascii, binary little endian, binary big endian.
//!
//! Elements `vertex` (x y z; nx ny nz; u v, s t or texture_u texture_v) and `face` (a list vertex_indices or
//! vertex_index); others are passed over. Nothing is given storage that the bytes at hand cannot fill. Polygons are cut
//! into fans. Source: Turk, "The PLY polygon file format" (1994).

use glam::Vec3;

use crate::render::mesh::read::{ReadError, degenerate_warning, shown};
use crate::render::mesh::{Arrays, Mesh};

const FORMAT: &str = "PLY";

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Encoding {
    Ascii,
    LittleEndian,
    BigEndian,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Type {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Type {
    fn named(name: &[u8]) -> Option<Self> {
        Some(match name {
            b"char" | b"int8" => Self::I8,
            b"uchar" | b"uint8" => Self::U8,
            b"short" | b"int16" => Self::I16,
            b"ushort" | b"uint16" => Self::U16,
            b"int" | b"int32" => Self::I32,
            b"uint" | b"uint32" => Self::U32,
            b"float" | b"float32" => Self::F32,
            b"double" | b"float64" => Self::F64,
            _ => return None,
        })
    }

    fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    fn is_float(self) -> bool {
        matches!(self, Self::F32 | Self::F64)
    }

    /// The value of that many bytes; every type fits a double.
    fn value(self, bytes: &[u8], is_big: bool) -> f64 {
        fn ordered<const N: usize>(bytes: &[u8], is_big: bool) -> [u8; N] {
            let mut array: [u8; N] = bytes[..N].try_into().expect("a slice of N bytes");
            if is_big {
                array.reverse();
            }
            array
        }
        match self {
            Self::I8 => f64::from(bytes[0] as i8),
            Self::U8 => f64::from(bytes[0]),
            Self::I16 => f64::from(i16::from_le_bytes(ordered(bytes, is_big))),
            Self::U16 => f64::from(u16::from_le_bytes(ordered(bytes, is_big))),
            Self::I32 => f64::from(i32::from_le_bytes(ordered(bytes, is_big))),
            Self::U32 => f64::from(u32::from_le_bytes(ordered(bytes, is_big))),
            Self::F32 => f64::from(f32::from_le_bytes(ordered(bytes, is_big))),
            Self::F64 => f64::from_le_bytes(ordered(bytes, is_big)),
        }
    }
}

#[derive(Debug, Clone)]
struct Property {
    name: Vec<u8>,
    /// Type of the count, for a list.
    count: Option<Type>,
    value: Type,
}

#[derive(Debug, Clone)]
struct Element {
    name: Vec<u8>,
    count: u64,
    properties: Vec<Property>,
}

impl Element {
    /// Bytes that a row has at least; an ascii number is a digit and a space, but for the last of the file.
    fn smallest_row(&self, encoding: Encoding) -> usize {
        let of = |property: &Property| match encoding {
            Encoding::Ascii => 2,
            _ => property.count.unwrap_or(property.value).size(),
        };
        self.properties.iter().map(of).sum()
    }
}

/// Reads a file's bytes; the mesh and what is odd about it.
pub fn read(bytes: &[u8]) -> Result<(Mesh, Vec<String>), ReadError> {
    let (encoding, elements, data) = header(bytes)?;
    let mut values = Values { rest: data, encoding };
    let mut arrays = Arrays::default();
    let (mut has_vertices, mut has_faces) = (false, false);
    for element in &elements {
        values.check_room(element)?;
        match element.name.as_slice() {
            b"vertex" => {
                has_vertices = true;
                vertices(element, &mut values, &mut arrays)?;
            }
            b"face" => {
                has_faces = true;
                faces(element, &mut values, &mut arrays)?;
            }
            _ => pass_over(element, &mut values)?,
        }
    }
    if !has_vertices || !has_faces {
        return Err(damaged(format!("there is no element `{}`", if has_vertices { "face" } else { "vertex" })));
    }
    let is_left = values.rest.iter().any(|byte| encoding != Encoding::Ascii || !byte.is_ascii_whitespace());
    let (mesh, degenerate) = Mesh::new(arrays).map_err(|error| ReadError::mesh(FORMAT, error))?;
    let trailing = is_left.then(|| format!("{} bytes after the last element were left out", values.rest.len()));
    Ok((mesh, trailing.into_iter().chain(degenerate_warning(degenerate)).collect()))
}

fn damaged(problem: impl Into<String>) -> ReadError {
    ReadError::damaged(FORMAT, problem)
}

/// Encoding, elements, and the bytes behind the header.
fn header(bytes: &[u8]) -> Result<(Encoding, Vec<Element>, &[u8]), ReadError> {
    const LONGEST: usize = 1 << 16;
    let (mut rest, mut number) = (bytes, 0);
    let (mut encoding, mut elements): (_, Vec<Element>) = (None, Vec::new());
    loop {
        number += 1;
        let end = rest.iter().take(LONGEST).position(|&byte| byte == b'\n');
        let end = end.ok_or_else(|| damaged(format!("the header has no line `end_header`; it breaks off in line {number}")))?;
        let line = rest[..end].strip_suffix(b"\r").unwrap_or(&rest[..end]);
        rest = &rest[end + 1..];
        let at = |problem: String| damaged(format!("line {number} of the header: {problem}"));
        let words: Vec<&[u8]> = line.split(|byte| byte.is_ascii_whitespace()).filter(|word| !word.is_empty()).collect();
        match words.as_slice() {
            [b"ply"] if number == 1 => {}
            _ if number == 1 => return Err(at("expected `ply`".to_owned())),
            [] | [b"comment" | b"obj_info", ..] => {}
            [b"format", name, version] if encoding.is_none() => {
                encoding = Some(match *name {
                    b"ascii" => Encoding::Ascii,
                    b"binary_little_endian" => Encoding::LittleEndian,
                    b"binary_big_endian" => Encoding::BigEndian,
                    _ => return Err(at(format!("unknown format `{}`", shown(name)))),
                });
                if *version != b"1.0" {
                    return Err(at(format!("version `{}` of the format, not 1.0", shown(version))));
                }
            }
            [b"element", name, count] => {
                let count = std::str::from_utf8(count).ok().and_then(|count| count.parse().ok());
                let count = count.ok_or_else(|| at(format!("the count of element `{}` is not a whole number", shown(name))))?;
                if elements.iter().any(|element| element.name == *name) {
                    return Err(at(format!("a second element `{}`", shown(name))));
                }
                elements.push(Element { name: name.to_vec(), count, properties: Vec::new() });
            }
            [b"property", words @ ..] => {
                let element = elements.last_mut().ok_or_else(|| at("a property before the first element".to_owned()))?;
                element.properties.push(property(words).map_err(at)?);
            }
            [b"end_header"] => break,
            [word, ..] => return Err(at(format!("unexpected `{}`", shown(word)))),
        }
    }
    Ok((encoding.ok_or_else(|| damaged("the header has no line `format`"))?, elements, rest))
}

fn property(words: &[&[u8]]) -> Result<Property, String> {
    let of = |name: &[u8]| Type::named(name).ok_or_else(|| format!("unknown type `{}` of a property", shown(name)));
    match words {
        [b"list", count, value, name] => {
            let count = of(count)?;
            if count.is_float() {
                return Err(format!("the count of list `{}` has a floating-point type", shown(name)));
            }
            Ok(Property { name: name.to_vec(), count: Some(count), value: of(value)? })
        }
        [value, name] => Ok(Property { name: name.to_vec(), count: None, value: of(value)? }),
        _ => Err("a property is `property TYPE NAME` or `property list TYPE TYPE NAME`".to_owned()),
    }
}

/// The numbers behind the header, one after the other.
struct Values<'a> {
    rest: &'a [u8],
    encoding: Encoding,
}

impl Values<'_> {
    /// Whether the bytes can hold all rows of the element at all.
    fn check_room(&self, element: &Element) -> Result<(), ReadError> {
        let needed = u128::from(element.count) * element.smallest_row(self.encoding) as u128;
        // The last number of an ascii file needs no space after it.
        if needed > self.rest.len() as u128 + 1 {
            return Err(damaged(format!(
                "truncated: {} rows of element `{}` need at least {needed} bytes, and {} are left",
                element.count,
                shown(&element.name),
                self.rest.len()
            )));
        }
        Ok(())
    }

    fn next(&mut self, kind: Type) -> Result<f64, String> {
        match self.encoding {
            Encoding::Ascii => self.next_word(kind),
            encoding => {
                let (value, rest) = self.rest.split_at_checked(kind.size()).ok_or("truncated: the data ends within a number")?;
                self.rest = rest;
                Ok(kind.value(value, encoding == Encoding::BigEndian))
            }
        }
    }

    fn next_word(&mut self, kind: Type) -> Result<f64, String> {
        let begin = self.rest.trim_ascii_start();
        let end = begin.iter().position(u8::is_ascii_whitespace).unwrap_or(begin.len());
        let (word, rest) = begin.split_at(end);
        self.rest = rest;
        let text = std::str::from_utf8(word).unwrap_or("");
        if text.is_empty() && word.is_empty() {
            return Err("truncated: the data ends before the last number".to_owned());
        }
        let value = if kind.is_float() { text.parse().ok() } else { text.parse::<i64>().ok().map(|value| value as f64) };
        value.ok_or_else(|| format!("`{}` is not a number of its property's type", shown(word)))
    }

    /// The count of a list, if as many values can follow.
    fn next_count(&mut self, kind: Type, value: Type) -> Result<usize, String> {
        let count = self.next(kind)?;
        let smallest = if self.encoding == Encoding::Ascii { 2 } else { value.size() };
        if count < 0.0 || count * smallest as f64 > self.rest.len() as f64 + 1.0 {
            return Err(format!("truncated, or a list of `{count}` values, and {} bytes are left", self.rest.len()));
        }
        Ok(count as usize)
    }
}

fn row_error(element: &Element, row: u64) -> impl Fn(String) -> ReadError {
    move |problem| damaged(format!("element `{}`, row {row}: {problem}", shown(&element.name)))
}

fn vertices(element: &Element, values: &mut Values<'_>, arrays: &mut Arrays) -> Result<(), ReadError> {
    const NAMES: [&[&[u8]]; 8] = [
        &[b"x"],
        &[b"y"],
        &[b"z"],
        &[b"nx"],
        &[b"ny"],
        &[b"nz"],
        &[b"u", b"s", b"texture_u", b"texture_s"],
        &[b"v", b"t", b"texture_v", b"texture_t"],
    ];
    let place = |names: &[&[u8]]| {
        element.properties.iter().position(|property| names.contains(&property.name.as_slice()) && property.count.is_none())
    };
    let places: [Option<usize>; 8] = NAMES.map(place);
    if let Some(missing) = (0..3).find(|&axis| places[axis].is_none()) {
        return Err(damaged(format!("element `vertex` has no property `{}`", shown(NAMES[missing][0]))));
    }
    let has_normals = places[3..6].iter().all(Option::is_some);
    let has_uvs = places[6..].iter().all(Option::is_some);
    let mut slots = vec![usize::MAX; element.properties.len()];
    places.iter().enumerate().for_each(|(slot, place)| place.iter().for_each(|&place| slots[place] = slot));
    arrays.positions.reserve(element.count as usize);
    for row in 0..element.count {
        let mut found = [0.0_f64; 8];
        for (property, &slot) in element.properties.iter().zip(&slots) {
            match property.count {
                Some(count) => pass_over_list(count, property.value, values).map_err(row_error(element, row))?,
                None => {
                    let value = values.next(property.value).map_err(row_error(element, row))?;
                    if let Some(place) = found.get_mut(slot) {
                        *place = value;
                    }
                }
            }
        }
        let [x, y, z, nx, ny, nz, u, v] = found.map(|value| value as f32);
        arrays.positions.push(Vec3::new(x, y, z));
        if has_normals {
            arrays.normals.push(Vec3::new(nx, ny, nz));
        }
        if has_uvs {
            arrays.uvs.push([u, v]);
        }
    }
    Ok(())
}

fn faces(element: &Element, values: &mut Values<'_>, arrays: &mut Arrays) -> Result<(), ReadError> {
    let is_corners = |property: &Property| matches!(property.name.as_slice(), b"vertex_indices" | b"vertex_index");
    let Some(corners) = element.properties.iter().position(|property| is_corners(property) && property.count.is_some()) else {
        return Err(damaged("element `face` has no list `vertex_indices`"));
    };
    if element.properties[corners].value.is_float() {
        return Err(damaged("the list `vertex_indices` of element `face` has a floating-point type"));
    }
    arrays.triangles.reserve(element.count as usize);
    for row in 0..element.count {
        for (place, property) in element.properties.iter().enumerate() {
            let done = match property.count {
                Some(count) if place == corners => polygon(count, property.value, values, arrays),
                Some(count) => pass_over_list(count, property.value, values),
                None => values.next(property.value).map(|_| ()),
            };
            done.map_err(row_error(element, row))?;
        }
    }
    Ok(())
}

fn polygon(count: Type, value: Type, values: &mut Values<'_>, arrays: &mut Arrays) -> Result<(), String> {
    let count = values.next_count(count, value)?;
    if count < 3 {
        return Err(format!("a face has at least 3 corners, not {count}"));
    }
    let (mut first, mut previous) = (0, 0);
    for corner in 0..count {
        let index = values.next(value)?;
        if !(0.0..f64::from(u32::MAX)).contains(&index) {
            return Err(format!("there is no vertex with the index `{index}`"));
        }
        let index = index as u32;
        match corner {
            0 => first = index,
            1 => {}
            _ => arrays.triangles.push([first, previous, index]),
        }
        previous = index;
    }
    Ok(())
}

fn pass_over_list(count: Type, value: Type, values: &mut Values<'_>) -> Result<(), String> {
    let count = values.next_count(count, value)?;
    (0..count).try_for_each(|_| values.next(value).map(|_| ()))
}

fn pass_over(element: &Element, values: &mut Values<'_>) -> Result<(), ReadError> {
    if element.properties.is_empty() {
        return Ok(());
    }
    for row in 0..element.count {
        for property in &element.properties {
            let done = match property.count {
                Some(count) => pass_over_list(count, property.value, values),
                None => values.next(property.value).map(|_| ()),
            };
            done.map_err(row_error(element, row))?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::render::mesh::write;

    const HEADER: &str = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n\
                          element face 1\nproperty list uchar int vertex_indices\nend_header\n";
    const CORNERS: &str = "0 0 0\n1 0 0\n1 1 0\n0 1 0\n";

    fn sphere() -> Mesh {
        crate::render::shape::generated::UvSphere { columns: 8, rows: 5, radius: 3.0, relief: None }.mesh().unwrap()
    }

    /// The binary file with every number's bytes in the other order.
    fn big_endian(mesh: &Mesh) -> Vec<u8> {
        let bytes = write::ply(mesh);
        let end = b"end_header\n";
        let data = bytes.windows(end.len()).position(|window| window == end).unwrap() + end.len();
        let header = String::from_utf8(bytes[..data].to_vec()).unwrap().replace("little", "big");
        let vertices = mesh.positions().len() * 32;
        let (vertices, faces) = bytes[data..].split_at(vertices);
        let turned = |four: &[u8]| four.iter().rev().copied().collect::<Vec<u8>>();
        let mut out = header.into_bytes();
        vertices.chunks(4).for_each(|four| out.extend(turned(four)));
        for face in faces.chunks(13) {
            out.push(face[0]);
            face[1..].chunks(4).for_each(|four| out.extend(turned(four)));
        }
        out
    }

    #[test]
    fn what_is_written_is_read_in_both_byte_orders() {
        let mesh = sphere();
        assert_eq!(read(&write::ply(&mesh)).unwrap(), (mesh.clone(), Vec::new()));
        assert_eq!(read(&big_endian(&mesh)).unwrap().0, mesh);
    }

    #[test]
    fn quads_and_other_elements_are_understood() {
        let header = HEADER.replace("element face", "element edge 2\nproperty list uchar float f\nproperty int a\nelement face");
        let header = header.replace("property float y", "comment odd\nproperty uchar flag\nproperty double y");
        let text = format!("{header}0 1 0 0\n1 2 0 0\n1 3 1 0\n0 4 1 0\n2 0.5 nan 7\n0 8\n4 0 1 2 3");
        let (mesh, warnings) = read(text.replace('\n', "\r\n").as_bytes()).unwrap();
        assert_eq!(mesh.triangles(), [[0, 1, 2], [0, 2, 3]]);
        assert_eq!((mesh.positions()[2], warnings.len()), (Vec3::new(1.0, 1.0, 0.0), 0));
    }

    #[test]
    fn mistakes_are_named() {
        let refused = |text: String| read(text.as_bytes()).unwrap_err().to_string();
        let good = format!("{HEADER}{CORNERS}3 0 1 2\n");
        assert!(read(good.as_bytes()).is_ok());
        for (from, to, word) in [
            ("element vertex 4", "element vertex 1000000000000000000", "truncated: 1000000000000000000 rows of element `vertex`"),
            ("element vertex 4", "element vertex -1", "line 3 of the header"),
            ("element vertex 4", "element vertex 18446744073709551617", "line 3 of the header"),
            ("element face 1", "element face 4", "truncated"),
            ("ascii", "morse", "unknown format `morse`"),
            ("float z", "float w", "no property `z`"),
            ("float z", "half z", "unknown type `half`"),
            ("uchar int", "float int", "floating-point"),
            ("uchar int", "uchar float", "floating-point"),
            ("end_header", "end", "unexpected `end`"),
            ("3 0 1 2", "3 0 1 4", "vertex index 4"),
            ("3 0 1 2", "3 0 1 -4", "index `-4`"),
            ("3 0 1 2", "3 0 1 x", "`x` is not a number"),
            ("3 0 1 2", "2 0 1", "3 corners"),
            ("3 0 1 2", "255 0 1", "list of `255`"),
            ("3 0 1 2", "3 0 1", "truncated"),
            ("1 1 0", "1 nan 0", "vertex 2 of the mesh is not finite"),
            ("ply\n", "plain\n", "expected `ply`"),
            ("element face 1\nproperty list uchar int vertex_indices\n", "", "no element `face`"),
        ] {
            let message = refused(good.replacen(from, to, 1));
            assert!(message.contains(word), "{from} -> {to}: {message}");
        }
    }

    #[test]
    fn a_file_cut_anywhere_is_refused() {
        let bytes = write::ply(&sphere());
        assert!((0..bytes.len()).all(|end| read(&bytes[..end]).is_err()));
    }

    proptest! {
        #[test]
        fn no_bytes_make_the_reader_panic(places in prop::collection::vec((0_usize..4096, any::<u8>()), 1..12)) {
            let mut bytes = write::ply(&sphere());
            for (place, byte) in places {
                let length = bytes.len();
                bytes[place % length] = byte;
            }
            let _ = read(&bytes);
        }
    }
}

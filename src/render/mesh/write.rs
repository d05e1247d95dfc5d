//! Writing meshes: PLY (binary, little endian) and OBJ.

use std::fmt::Write;

use crate::render::mesh::Mesh;

/// A binary PLY file.
pub fn ply(mesh: &Mesh) -> Vec<u8> {
    let mut header = format!(
        "ply\nformat binary_little_endian 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n",
        mesh.positions().len()
    );
    if !mesh.normals().is_empty() {
        header.push_str("property float nx\nproperty float ny\nproperty float nz\n");
    }
    if !mesh.uvs().is_empty() {
        header.push_str("property float u\nproperty float v\n");
    }
    let faces = mesh.triangles().len();
    header.push_str(&format!("element face {faces}\nproperty list uchar uint vertex_indices\nend_header\n"));
    let mut bytes = header.into_bytes();
    bytes.reserve(mesh.positions().len() * 32 + faces * 13);
    for vertex in 0..mesh.positions().len() {
        let normal = mesh.normals().get(vertex).map(|normal| normal.to_array());
        let numbers = mesh.positions()[vertex].to_array().into_iter().chain(normal.into_iter().flatten());
        let numbers = numbers.chain(mesh.uvs().get(vertex).copied().into_iter().flatten());
        numbers.for_each(|number| bytes.extend(number.to_le_bytes()));
    }
    for corners in mesh.triangles() {
        bytes.push(3);
        corners.iter().for_each(|corner| bytes.extend(corner.to_le_bytes()));
    }
    bytes
}

/// An OBJ file; numbers in their shortest form that reads back equal.
pub fn obj(mesh: &Mesh) -> Vec<u8> {
    let mut text = String::new();
    let infallible = "writing to a string does not fail";
    for position in mesh.positions() {
        writeln!(text, "v {} {} {}", position.x, position.y, position.z).expect(infallible);
    }
    for [u, v] in mesh.uvs() {
        writeln!(text, "vt {u} {v}").expect(infallible);
    }
    for normal in mesh.normals() {
        writeln!(text, "vn {} {} {}", normal.x, normal.y, normal.z).expect(infallible);
    }
    for corners in mesh.triangles() {
        text.push('f');
        for corner in corners.map(|corner| u64::from(corner) + 1) {
            match (mesh.uvs().is_empty(), mesh.normals().is_empty()) {
                (true, true) => write!(text, " {corner}"),
                (false, true) => write!(text, " {corner}/{corner}"),
                (true, false) => write!(text, " {corner}//{corner}"),
                (false, false) => write!(text, " {corner}/{corner}/{corner}"),
            }
            .expect(infallible);
        }
        text.push('\n');
    }
    text.into_bytes()
}

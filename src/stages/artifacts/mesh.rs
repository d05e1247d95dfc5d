//! `mesh`: triangles with normals and texture coordinates.
//!
//! Bytes: how many positions, normals, texture coordinates and triangles there are, then the arrays in this order.

use std::io::{self, Read, Write};

use glam::Vec3;

use crate::engine::artifact::{Artifact, Origin, SaveError, Saved, TypeName};
use crate::render::mesh::{Arrays, Mesh, write};
use crate::stages::artifacts::canonical::{Decoder, Encoder, invalid};

const VERSION: u32 = 1;

impl Artifact for Mesh {
    const TYPE: TypeName = "mesh";
    const FORMATS: &'static [&'static str] = &["ply", "obj"];

    fn write(&self, out: &mut dyn Write) -> io::Result<()> {
        let mut encoder = Encoder::new(out, Self::TYPE, VERSION)?;
        for count in [self.positions().len(), self.normals().len(), self.uvs().len(), self.triangles().len()] {
            encoder.count(count as u64)?;
        }
        self.positions().iter().chain(self.normals()).try_for_each(|vector| encoder.singles(&vector.to_array()))?;
        encoder.singles(self.uvs().as_flattened())?;
        self.triangles().as_flattened().iter().try_for_each(|corner| encoder.put(&corner.to_le_bytes()))?;
        encoder.finish()
    }

    fn read(input: &mut dyn Read) -> io::Result<Self> {
        let mut decoder = Decoder::new(input, Self::TYPE, VERSION)?;
        let [positions, normals, uvs, triangles] = [decoder.count()?, decoder.count()?, decoder.count()?, decoder.count()?];
        let vector = |bytes: [u8; 12]| Vec3::from_array(numbers(bytes, f32::from_le_bytes));
        let arrays = Arrays {
            positions: decoder.list(positions, vector)?,
            normals: decoder.list(normals, vector)?,
            uvs: decoder.list(uvs, |bytes: [u8; 8]| numbers(bytes, f32::from_le_bytes))?,
            triangles: decoder.list(triangles, |bytes: [u8; 12]| numbers(bytes, u32::from_le_bytes))?,
        };
        decoder.finish()?;
        // A checked mesh passes its own checks without a change.
        match Mesh::restored(arrays) {
            Some(mesh) => Ok(mesh),
            None => Err(invalid("arrays that are no mesh")),
        }
    }

    fn memory(&self) -> u64 {
        Mesh::memory(self)
    }

    fn save(&self, format: &str, _: &Origin) -> Result<Saved, SaveError> {
        match format {
            "ply" => Ok(write::ply(self).into()),
            "obj" => Ok(write::obj(self).into()),
            _ => Err(SaveError(format!("a mesh is not written as `{format}`"))),
        }
    }
}

/// The numbers in a run of bytes.
fn numbers<const B: usize, const N: usize, T: Copy + Default>(bytes: [u8; B], number: fn([u8; 4]) -> T) -> [T; N] {
    let mut numbers = [T::default(); N];
    for (number_out, four) in numbers.iter_mut().zip(bytes.as_chunks::<4>().0) {
        *number_out = number(*four);
    }
    numbers
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::mesh::read;
    use crate::render::shape::generated::{Icosphere, UvSphere};

    fn meshes() -> [Mesh; 3] {
        let sphere = UvSphere { columns: 8, rows: 5, radius: 3.0, relief: None }.mesh().unwrap();
        [sphere.clone(), sphere.flat(), Icosphere { subdivisions: 1, radius: 1.0, relief: None }.mesh().unwrap()]
    }

    fn bytes(mesh: &Mesh) -> Vec<u8> {
        let mut bytes = Vec::new();
        Artifact::write(mesh, &mut bytes).unwrap();
        bytes
    }

    #[test]
    fn canonical_bytes_come_back_equal_and_broken_ones_are_refused() {
        for mesh in meshes() {
            let bytes = bytes(&mesh);
            let read = |bytes: &[u8]| <Mesh as Artifact>::read(&mut &*bytes);
            assert_eq!(read(&bytes).unwrap(), mesh);
            for end in 0..bytes.len() {
                assert_eq!(read(&bytes[..end]).unwrap_err().kind(), io::ErrorKind::InvalidData);
            }
            for place in 0..bytes.len() {
                let mut broken = bytes.clone();
                broken[place] = 0xff;
                let _ = read(&broken);
            }
        }
    }

    #[test]
    fn what_is_saved_reads_back_equal() {
        for mesh in meshes() {
            for format in Mesh::FORMATS {
                let saved = mesh.save(format, &Origin::default()).unwrap();
                let (found, warnings) = read::read(&saved.bytes, &|_| None).unwrap();
                assert_eq!((found.triangles().len(), warnings.len()), (mesh.triangles().len(), 0), "{format}");
                let corner =
                    |mesh: &Mesh| mesh.triangles().as_flattened().iter().map(|&c| mesh.positions()[c as usize]).collect::<Vec<_>>();
                assert_eq!(corner(&found), corner(&mesh), "{format}");
            }
            assert!(mesh.save("stl", &Origin::default()).is_err());
        }
    }
}

//! Arrays for numpy: one in a `.npy`, several by name in a `.npz`.

use std::io::{Cursor, Write};

use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, DateTime, ZipWriter};

use crate::engine::artifact::SaveError;

/// Bytes of a `.npy` (format 1.0) with f64 in C order; `values` are as many as the product of `shape`.
pub fn npy(shape: &[usize], values: impl Iterator<Item = f64>) -> Vec<u8> {
    let sizes: String = shape.iter().map(|size| format!("{size}, ")).collect();
    let header = format!("{{'descr': '<f8', 'fortran_order': False, 'shape': ({}), }}", sizes.trim_end());
    // Magic, version, length and header with its line feed are together a multiple of 64 bytes.
    let padded = (10 + header.len() + 1).next_multiple_of(64) - 11;
    let mut bytes = Vec::with_capacity(padded + 11 + 8 * shape.iter().product::<usize>());
    bytes.extend_from_slice(b"\x93NUMPY\x01\x00");
    bytes.extend_from_slice(&((padded + 1) as u16).to_le_bytes());
    bytes.extend_from_slice(format!("{header:padded$}\n").as_bytes());
    values.for_each(|value| bytes.extend_from_slice(&value.to_le_bytes()));
    bytes
}

/// Bytes of a `.npz`: each array under its name, not compressed, with the earliest time a zip can bear.
pub fn npz(arrays: &[(&str, Vec<u8>)]) -> Result<Vec<u8>, SaveError> {
    let failed = |error: &dyn std::fmt::Display| SaveError(format!("no zip archive: {error}"));
    let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
    for (name, bytes) in arrays {
        let options = SimpleFileOptions::default()
            .compression_method(CompressionMethod::Stored)
            .last_modified_time(DateTime::default())
            .large_file(bytes.len() > u32::MAX as usize);
        archive.start_file(format!("{name}.npy"), options).map_err(|error| failed(&error))?;
        archive.write_all(bytes).map_err(|error| failed(&error))?;
    }
    archive.finish().map(Cursor::into_inner).map_err(|error| failed(&error))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_array_has_an_aligned_header_that_numpy_reads() {
        for (shape, text) in [(vec![6], "(6,)"), (vec![2, 3], "(2, 3,)")] {
            let bytes = npy(&shape, (0..6).map(f64::from));
            let length = usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
            let header = std::str::from_utf8(&bytes[10..10 + length]).unwrap();
            assert_eq!((10 + length) % 64, 0);
            assert!(header.contains(&format!("'shape': {text}")) && header.ends_with('\n'), "{header:?}");
            assert_eq!(bytes.len(), 10 + length + 6 * 8);
            assert_eq!(&bytes[bytes.len() - 8..], 5.0_f64.to_le_bytes());
        }
    }

    #[test]
    fn equal_arrays_give_equal_archives() {
        let archive = || npz(&[("a", npy(&[1], [1.0].into_iter())), ("b", npy(&[0], [].into_iter()))]).unwrap();
        assert_eq!(archive(), archive());
        let mut reader = zip::ZipArchive::new(Cursor::new(archive())).unwrap();
        assert_eq!(reader.by_index(1).unwrap().name().unwrap(), "b.npy");
    }
}

//! NumPy archives: arrays by name in a zip without compression.
//!
//! Same arrays, same bytes: no clock enters the archive. Only written, never read.

use std::io::{Cursor, Write};

use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, DateTime, ZipWriter};

/// An archive of arrays, each as `npy` writes it; a name becomes `NAME.npy`.
pub fn write(arrays: &[(&str, Vec<u8>)]) -> Vec<u8> {
    let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
    for (name, bytes) in arrays {
        let options = SimpleFileOptions::default()
            .compression_method(CompressionMethod::Stored)
            .last_modified_time(DateTime::default())
            .unix_permissions(0o644)
            .large_file(bytes.len() > u32::MAX as usize);
        archive.start_file(format!("{name}.npy"), options).expect("each array has a name of its own");
        archive.write_all(bytes).expect("memory takes what is written");
    }
    archive.finish().expect("memory takes what is written").into_inner()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::npy;

    #[test]
    fn the_archive_holds_the_arrays_and_no_time() {
        let arrays = [("marginal", npy::write_f64(&[2], &[0.25, 0.75])), ("conditional", npy::write_f32(&[1, 1], &[1.0]))];
        let bytes = write(&arrays);
        let mut archive = zip::ZipArchive::new(Cursor::new(&bytes)).unwrap();
        for (name, array) in &arrays {
            let mut found = Vec::new();
            std::io::copy(&mut archive.by_name(&format!("{name}.npy")).unwrap(), &mut found).unwrap();
            assert_eq!(&found, array);
        }
        assert_eq!(bytes, write(&arrays));
    }
}

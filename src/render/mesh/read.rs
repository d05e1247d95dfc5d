//! Reading a mesh file of any of the formats, told from its content.

use crate::render::mesh::gltf::{self, Buffers};
use crate::render::mesh::{Mesh, MeshError, obj, ply};

/// Why a file gave no mesh.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ReadError {
    /// The content breaks the rules of its format.
    #[error("{format}: {problem}")]
    Damaged {
        /// Title of the format.
        format: &'static str,
        /// What is wrong and where.
        problem: String,
    },
    /// The arrays make no mesh.
    #[error("{format}: {error}")]
    Mesh {
        /// Title of the format.
        format: &'static str,
        /// What is wrong.
        error: MeshError,
    },
    /// Legal content that is not read here.
    #[error("{format}: unsupported: {feature}")]
    Unsupported {
        /// Title of the format.
        format: &'static str,
        /// What it is.
        feature: String,
    },
    /// A file beside the file.
    #[error("glTF: the numbers are in the file `{0}`; name it in `buffers`, or export a single file (.glb)")]
    MissingBuffer(String),
}

impl ReadError {
    pub(super) fn damaged(format: &'static str, problem: impl Into<String>) -> Self {
        Self::Damaged { format, problem: problem.into() }
    }

    pub(super) fn mesh(format: &'static str, error: MeshError) -> Self {
        Self::Mesh { format, error }
    }

    pub(super) fn unsupported(format: &'static str, feature: impl Into<String>) -> Self {
        Self::Unsupported { format, feature: feature.into() }
    }
}

/// Reads a mesh; with what is odd about the file. `buffers` gives the content of files beside a glTF file.
pub fn read(bytes: &[u8], buffers: &Buffers<'_>) -> Result<(Mesh, Vec<String>), ReadError> {
    let begin = bytes.trim_ascii_start();
    if bytes.starts_with(b"ply") {
        ply::read(bytes)
    } else if bytes.starts_with(b"glTF") || begin.starts_with(b"{") {
        gltf::read(bytes, buffers)
    } else {
        obj::read(bytes)
    }
}

/// Whether bytes begin like a mesh in a format that has a signature; an OBJ file has none.
pub fn has_signature(bytes: &[u8]) -> bool {
    bytes.starts_with(b"ply\n") || bytes.starts_with(b"ply\r") || bytes.starts_with(b"glTF") || bytes.trim_ascii_start().starts_with(b"{")
}

pub(super) fn degenerate_warning(count: usize) -> Option<String> {
    match count {
        0 => None,
        1 => Some("1 triangle without an area was left out".to_owned()),
        count => Some(format!("{count} triangles without an area were left out")),
    }
}

/// A word of a file as a message may show it.
pub(super) fn shown(word: &[u8]) -> String {
    const LONGEST: usize = 40;
    let text: String = word.iter().take(LONGEST).flat_map(|&byte| byte.escape_ascii()).map(char::from).collect();
    let text = text.replace('`', "'");
    if word.len() > LONGEST { text + "…" } else { text }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn formats_are_told_from_the_content() {
        let title = |bytes: &[u8]| read(bytes, &|_| None).unwrap_err().to_string();
        assert!(title(b"ply\nx").starts_with("PLY"));
        assert!(title(b"glTFx").starts_with("glTF"));
        assert!(title(b" {}").starts_with("glTF"));
        assert!(title(b"# nothing").starts_with("OBJ"));
        assert!(has_signature(b"ply\nformat") && !has_signature(b"v 0 0 0"));
    }

    #[test]
    fn words_of_files_are_shown_harmlessly() {
        assert_eq!(shown(b"a\x1b[31m`\xff"), "a\\x1b[31m'\\xff");
        assert!(shown(&[b'x'; 100]).ends_with("x…"));
    }
}

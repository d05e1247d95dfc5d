//! A mesh that a scene names: a file, or the result of another stage.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::render::mesh::Mesh;
use crate::render::scene_file::SceneFile;

/// A triangle mesh: OBJ, PLY, glTF or GLB, told from the content.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct MeshShape {
    /// The file.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub path: Option<SceneFile>,
    /// Name of an entry of the stage's `meshes`, instead of a file.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub of: Option<String>,
    /// Which normals it is shaded with.
    #[serde(default)]
    pub normals: Normals,
    /// Files that a glTF file keeps its numbers in, found by their names. A GLB or data URIs need none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub buffers: Vec<SceneFile>,
}

/// Where the normals for shading come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Normals {
    /// Those of the file, or smooth ones where it has none.
    #[default]
    Auto,
    /// Those of the file, or each triangle its own where it has none.
    File,
    /// At each vertex the mean of the triangles around, weighted by their angles.
    Smooth,
    /// Each triangle its own.
    Flat,
}

impl Normals {
    /// The mesh with these normals.
    #[must_use]
    pub fn of(self, mesh: Mesh) -> Mesh {
        match self {
            Self::Auto if !mesh.normals().is_empty() => mesh,
            Self::File => mesh,
            Self::Auto | Self::Smooth => mesh.smooth(),
            Self::Flat => mesh.flat(),
        }
    }
}

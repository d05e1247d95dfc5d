//! A file that a scene names: a mesh, a texture.
//!
//! This room reads no files. The path marks itself in the schema as one (`x-file`), so that it is checked,
//! hashed and handed over by whoever runs the renderer, wherever in a scene it stands.

use std::borrow::Cow;
use std::path::PathBuf;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Serialize};

/// The path of a file; in a scene's text relative to the file in which the text stands.
#[derive(Debug, Clone, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(transparent)]
pub struct SceneFile(pub PathBuf);

impl JsonSchema for SceneFile {
    fn inline_schema() -> bool {
        true
    }

    fn schema_name() -> Cow<'static, str> {
        "SceneFile".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({ "type": "string", "minLength": 1, "x-file": true })
    }
}

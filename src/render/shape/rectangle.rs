//! The square [-1, 1]² in the plane z = 0; its transform gives it size and place.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The square [-1, 1]² in the plane z = 0 with normal +z; texture coordinates run along x and y from 0 to 1.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Rectangle {}

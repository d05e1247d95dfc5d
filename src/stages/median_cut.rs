//! The kind `median-cut`.

use std::num::NonZeroU32;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::engine::job::Job;
use crate::engine::parameter::Port;
use crate::engine::stage::{InputSizes, Mistake, ResultDeclaration, Stage, StageError};
use crate::light::envmap::{Angles, EnvMap};
use crate::light::lights::LightSet;
use crate::light::median_cut::{self, MedianCutError, Place, Settings, Variant};

/// Cuts a map into regions of equal energy, or of least variance, and puts one directional light into each.
///
/// After Debevec, "A median cut algorithm for light probe sampling" (2005), and Viriyothai and Debevec, "Variance
/// minimization light probe sampling" (2009). Needs little memory beside the map.
///
/// ```yaml
/// cut: { median-cut: { of: env, count: 64 }, save: [csv, gltf, blender] }
/// ```
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct MedianCut {
    /// The map to cut.
    pub of: Port<EnvMap>,
    /// How many lights. A power of two cuts every region equally often; otherwise the most energetic regions (for
    /// `variance`: those of most variance) are cut once more. Fewer lights result, with a warning, where regions of one pixel leave nothing to cut.
    pub count: NonZeroU32,
    /// What is balanced, and which side of a region is the longer one. Default `debevec`.
    #[serde(default)]
    pub variant: Variant,
    /// Where in its region each light stands. By default as in the variant's source: `centroid` for
    /// `debevec`, `median` for `coursework-2021`, `vector-mean` for `variance`.
    #[serde(default)]
    pub place: Option<Place>,
    /// At which polar angle `coursework-2021` takes the sine of a row. By default `edge`, which gives the
    /// report's total; the others use exact solid angles and take no such choice.
    #[serde(default)]
    pub angles: Option<Angles>,
}

impl MedianCut {
    fn settings(&self) -> Settings {
        Settings {
            count: self.count,
            variant: self.variant,
            place: self.place.unwrap_or(self.variant.usual_place()),
            sine_at: self.angles.unwrap_or(Angles::Edge),
        }
    }
}

impl Stage for MedianCut {
    const KIND: &'static str = "median-cut";
    const VERSION: u32 = 2;
    const RESULTS: &'static [ResultDeclaration] = &[ResultDeclaration { name: "", types: &["lights"] }];
    type Output = LightSet;

    fn mistakes(&self) -> Vec<Mistake> {
        if self.angles.is_none() || self.variant == Variant::Coursework2021 {
            return Vec::new();
        }
        let message =
            "only `coursework-2021` weights rows by a sine; the others take their solid angle, so `angles` has no meaning".to_string();
        vec![Mistake { field: "angles".into(), message, hint: Some("remove `angles`, or set `variant: coursework-2021`".into()) }]
    }

    fn caveats(&self) -> Vec<String> {
        match self.variant {
            Variant::Debevec | Variant::Variance => Vec::new(),
            Variant::Coursework2021 => {
                vec!["`variant: coursework-2021` is the second report's: rows count by the sine at their edge, sides by pixels".into()]
            }
        }
    }

    /// Sums along the sides of regions: at most 64 pieces of three f64 a column.
    fn memory(&self, inputs: &InputSizes) -> u64 {
        let width = (inputs.values().sum::<u64>() / 6).isqrt();
        width * 64 * 4 * 8 + u64::from(self.count.get()).min(1 << 24) * 256
    }

    fn run(&self, job: &Job<'_>) -> Result<LightSet, StageError> {
        let map = job.input(&self.of)?;
        let lights = median_cut::median_cut(&map, &self.settings(), || job.check())?;
        if lights.lights.len() < self.count.get() as usize {
            let found = lights.lights.len();
            job.warn(format!("gives {found} lights instead of {}: regions of one pixel cannot be cut", self.count));
        }
        Ok(lights)
    }
}

impl From<MedianCutError> for StageError {
    fn from(error: MedianCutError) -> Self {
        StageError::content(error)
    }
}

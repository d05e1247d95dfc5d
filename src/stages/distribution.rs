//! `distribution`: how probable each pixel of a map is to be drawn.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::engine::artifact::Artifact;
use crate::engine::job::Job;
use crate::engine::parameter::Port;
use crate::engine::stage::{InputSizes, ResultDeclaration, Stage, StageError};
use crate::light::distribution::{Distribution, DistributionError, Intensity, Settings, Sine, memory_of};
use crate::light::envmap::EnvMap;

/// Turns a map into the probability of each of its pixels, for `sample` to draw from.
///
/// A pixel's weight is its intensity times a factor of its row. Negative channels count as 0; a pixel that
/// is not finite is refused; a map without any weight gives the uniform distribution of the sphere. Source:
/// Pharr, Jakob, Humphreys, "Physically Based Rendering", 3rd edition, section 14.2.4.
///
/// ```yaml
/// dist: { distribution: { of: env } }
/// ```
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DistributionStage {
    /// The map.
    pub of: Port<EnvMap>,
    /// Factor of a row, which makes up for pixels that get smaller towards the poles.
    #[serde(default)]
    pub sine: Sine,
    /// What of a pixel's color counts.
    #[serde(default)]
    pub intensity: Intensity,
    /// Limit of each channel, in the map's units, before the intensity is taken; above 0. Without it there is none.
    ///
    /// Changes the probabilities only, not the map (the second report clamped at 1).
    #[serde(default)]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub clamp: Option<f64>,
    /// Takes the sphere's uniform density off and draws from what is left (Karlík et al. 2019): for `relight` with `mis-balance` or
    /// `mis-power` alone, where the other technique covers the rest. No effect on a map that is even to 1 %.
    #[serde(default)]
    pub mis_compensation: bool,
    /// Share of the sphere's uniform density in a mixture with the rest, 0 to 1; taken after the compensation. Default 0.
    ///
    /// Bounds the weight of any sample by radiance x 4 pi / share, and reaches directions that the map alone never gives.
    #[serde(default)]
    #[schemars(range(min = 0, max = 1))]
    pub defensive: f64,
}

impl DistributionStage {
    fn settings(&self) -> Settings {
        Settings {
            sine: self.sine,
            intensity: self.intensity,
            clamp: self.clamp.map(|limit| limit as f32),
            is_compensated: self.mis_compensation,
            defensive: self.defensive,
        }
    }
}

impl Stage for DistributionStage {
    const KIND: &'static str = "distribution";
    const VERSION: u32 = 1;
    const RESULTS: &'static [ResultDeclaration] = &[ResultDeclaration { name: "", types: &[Distribution::TYPE] }];
    type Output = Distribution;

    fn caveats(&self) -> Vec<String> {
        let of_sine = match self.sine {
            Sine::Center | Sine::Exact => None,
            Sine::Edge => Some("sine `edge` (first report): the top row is never drawn"),
            Sine::EdgeInclusive => Some("sine `edge-inclusive` (second report): the top and the bottom row are never drawn"),
            Sine::None => Some("sine `none`: directions near the poles are drawn too often for their solid angle"),
        };
        let of_clamp = self.clamp.map(|limit| format!("clamp `{limit}` (second report): probabilities follow the clamped map"));
        let is_partial = self.mis_compensation && self.defensive == 0.0;
        let of_compensation = is_partial
            .then(|| "mis_compensation: part of the sphere is never drawn; biased unless another technique covers it".to_string());
        of_sine.map(String::from).into_iter().chain(of_clamp).chain(of_compensation).collect()
    }

    fn memory(&self, inputs: &InputSizes) -> u64 {
        let bytes_per_pixel = size_of::<[f32; 3]>() as u64;
        memory_of(inputs.values().sum::<u64>() / bytes_per_pixel)
    }

    fn run(&self, job: &Job<'_>) -> Result<Distribution, StageError> {
        let map = job.input(&self.of)?;
        let distribution = Distribution::build(&map, &self.settings(), || job.check()).map_err(stage_error)?;
        if distribution.negative_count() > 0 {
            job.warn(format!("{} pixels have negative channels, which count as 0", distribution.negative_count()));
        }
        if distribution.is_uniform() {
            job.warn("no pixel of the map has any weight: the distribution is uniform over the sphere");
        }
        if self.mis_compensation && self.defensive == 0.0 && !distribution.is_compensated() {
            job.warn("`mis_compensation` has no effect: the map is even to 1 %");
        }
        Ok(distribution)
    }
}

fn stage_error(error: DistributionError<StageError>) -> StageError {
    match error {
        DistributionError::Interrupted(error) => error,
        DistributionError::NotFinite { .. } => StageError::content_with_hint(error, "`sanitize: zero` of `load` makes such pixels black"),
        DistributionError::Size { .. } => StageError::content(error),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::registry::Kind;

    #[test]
    fn the_parameters_of_a_file_become_settings() {
        let stage: DistributionStage = serde_yaml::from_str("{ of: env, sine: edge-inclusive, intensity: rec709, clamp: 1 }").unwrap();
        let expected = Settings { sine: Sine::EdgeInclusive, intensity: Intensity::Rec709, clamp: Some(1.0), ..Settings::default() };
        assert_eq!(stage.settings(), expected);
        assert_eq!(stage.caveats().len(), 2);
        let mixed: DistributionStage = serde_yaml::from_str("{ of: env, mis_compensation: true, defensive: 0.1 }").unwrap();
        assert!(mixed.settings().is_compensated && mixed.settings().defensive == 0.1 && mixed.caveats().is_empty());
        let partial: DistributionStage = serde_yaml::from_str("{ of: env, mis_compensation: true }").unwrap();
        assert!(partial.caveats()[0].contains("biased"));
        let plain: DistributionStage = serde_yaml::from_str("{ of: env }").unwrap();
        assert_eq!(plain.settings(), Settings::default());
        assert!(plain.caveats().is_empty());
    }

    #[test]
    fn a_clamp_must_be_above_zero() {
        let kind = Kind::of::<DistributionStage>();
        let schema = kind.schema();
        assert_eq!(schema["properties"]["clamp"]["exclusiveMinimum"], 0);
        assert!(serde_yaml::from_str::<DistributionStage>("{ of: env, sinus: center }").is_err());
    }

    #[test]
    fn a_pixel_that_is_not_finite_says_what_to_do() {
        let error = stage_error(DistributionError::NotFinite { x: 3, y: 4, value: [0.0, f32::NAN, 0.0] });
        let StageError::Content { message, hint } = error else { panic!("{error}") };
        assert!(message.contains("(3, 4)") && message.contains("NaN"), "{message}");
        assert!(hint.unwrap().contains("sanitize"));
    }
}

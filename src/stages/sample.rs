//! `sample`: directions drawn from a distribution, the sphere or about a normal.

use std::num::NonZeroU32;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::engine::artifact::Artifact;
use crate::engine::job::Job;
use crate::engine::parameter::{Port, Seed};
use crate::engine::stage::{InputSizes, Mistake, ResultDeclaration, Stage, StageError};
use crate::light::distribution::Distribution;
use crate::light::envmap::EnvMap;
use crate::light::samples::{Sample, SampleSet};
use crate::light::sampling::{self, SamplingError};

/// How directions are drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Method {
    /// Each independently of the others, from the distribution of `of`.
    #[default]
    Iid,
    /// As many rows as columns in each row, from the distribution of `of`; `count` is a square number (second report).
    RowsThenColumns,
    /// One in each of `count` equal cells of the unit square, then by the distribution of `of`. The cells are a grid
    /// as near to a square as the factors of `count` allow.
    Stratified,
    /// Uniform on the sphere; needs no distribution.
    Uniform,
    /// Density cosine / pi about +z, turned to each normal by `relight`; needs no distribution.
    Cosine,
}

impl Method {
    fn needs_distribution(self) -> bool {
        match self {
            Method::Iid | Method::RowsThenColumns | Method::Stratified => true,
            Method::Uniform | Method::Cosine => false,
        }
    }

    /// As it is written in a pipeline file.
    fn name(self) -> &'static str {
        match self {
            Method::Iid => "iid",
            Method::RowsThenColumns => "rows-then-columns",
            Method::Stratified => "stratified",
            Method::Uniform => "uniform",
            Method::Cosine => "cosine",
        }
    }
}

/// Draws directions, more where a map is brighter.
///
/// A direction drawn from a distribution is the one its pixel stands for. Inversion is `lower-bound`: the
/// first row, then the first column, whose cumulative probability exceeds a uniform number.
/// Source: Pharr, Jakob, Humphreys, "Physically Based Rendering", 3rd edition, section 13.6.7.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SampleStage {
    /// The distribution to draw from; none for `uniform` and `cosine`.
    #[serde(default)]
    pub of: Option<Port<Distribution>>,
    /// A map whose radiance is noted with each direction; for `uniform` also the map whose pixels are counted. None for `cosine`.
    #[serde(default)]
    pub env: Option<Port<EnvMap>>,
    /// How many directions, up to a hundred million.
    #[schemars(range(min = 1, max = 100_000_000))]
    pub count: NonZeroU32,
    /// How they are drawn.
    #[serde(default)]
    pub method: Method,
    /// Another seed gives another, equally good set; by default the pipeline's.
    #[serde(default)]
    pub seed: Seed,
}

impl SampleStage {
    fn draw(&self, job: &Job<'_>, env: Option<&EnvMap>) -> Result<SampleSet, SamplingError<StageError>> {
        let (count, seed) = (self.count.get() as usize, job.seed(self.seed));
        let distribution = job.optional_input(&self.of).map_err(SamplingError::Interrupted)?;
        let check = || job.check();
        match (self.method, distribution.as_deref()) {
            (Method::Iid, Some(distribution)) => sampling::independent(distribution, count, seed, check),
            (Method::RowsThenColumns, Some(distribution)) => sampling::rows_then_columns(distribution, count, seed, check),
            (Method::Stratified, Some(distribution)) => sampling::stratified(distribution, count, seed, check),
            (Method::Uniform, None) => sampling::uniform(env.map(size), count, seed, check),
            (Method::Cosine, None) => sampling::cosine(count, seed, check),
            (method, _) => unreachable!("the plan refuses method `{}` with this `of`", method.name()),
        }
    }
}

impl Stage for SampleStage {
    const KIND: &'static str = "sample";
    const VERSION: u32 = 1;
    const RESULTS: &'static [ResultDeclaration] = &[ResultDeclaration { name: "", types: &[SampleSet::TYPE] }];
    type Output = SampleSet;

    fn draws(&self) -> bool {
        true
    }

    fn mistakes(&self) -> Vec<Mistake> {
        let method = self.method.name();
        let mistake = |field: &str, message: String, hint: &str| Mistake { field: field.into(), message, hint: Some(hint.into()) };
        let mut mistakes = Vec::new();
        match (&self.of, self.method.needs_distribution()) {
            (None, true) => mistakes.push(mistake(
                "of",
                format!("method `{method}` draws from a distribution, and `of` names none"),
                "name a `distribution` stage, or choose method `uniform` or `cosine`",
            )),
            (Some(_), false) => {
                mistakes.push(mistake(
                    "of",
                    format!("method `{method}` draws from no distribution"),
                    "leave `of` out, or choose method `iid`",
                ));
            }
            _ => {}
        }
        if self.method == Method::Cosine && self.env.is_some() {
            let message = format!("directions of method `{method}` have no radiance before `relight` turns them to a normal");
            mistakes.push(mistake("env", message, "leave `env` out here"));
        }
        let side = self.count.get().isqrt();
        if self.method == Method::RowsThenColumns && side * side != self.count.get() {
            let message = format!("method `{method}` needs a square number of directions, not `{}`", self.count);
            let nearest = format!("try `{}` or `{}`", u64::from(side).pow(2), (u64::from(side) + 1).pow(2));
            mistakes.push(mistake("count", message, &nearest));
        }
        mistakes
    }

    fn caveats(&self) -> Vec<String> {
        match self.method {
            Method::RowsThenColumns => {
                vec!["method `rows-then-columns` (second report): unbiased cluster sampling, of larger variance than `iid`".into()]
            }
            Method::Iid | Method::Stratified | Method::Uniform | Method::Cosine => Vec::new(),
        }
    }

    fn memory(&self, _: &InputSizes) -> u64 {
        u64::from(self.count.get()) * size_of::<Sample>() as u64
    }

    fn run(&self, job: &Job<'_>) -> Result<SampleSet, StageError> {
        let env = job.optional_input(&self.env)?;
        let mut set = self.draw(job, env.as_deref()).map_err(stage_error)?;
        if let Some(env) = env {
            sampling::look_up(&mut set, &env);
        }
        Ok(set)
    }
}

fn size(map: &EnvMap) -> [u32; 2] {
    [map.width() as u32, map.height() as u32]
}

fn stage_error(error: SamplingError<StageError>) -> StageError {
    match error {
        SamplingError::Interrupted(error) => error,
        SamplingError::NotSquare { .. } => StageError::content(error),
        SamplingError::TooMany { .. } => StageError::content_with_hint(error, "draw fewer, or several sets with different seeds"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::registry::Kind;

    fn stage(yaml: &str) -> SampleStage {
        serde_yaml::from_str(yaml).unwrap()
    }

    /// Fields at fault.
    fn faults(yaml: &str) -> Vec<String> {
        stage(yaml).mistakes().into_iter().map(|mistake| mistake.field).collect()
    }

    #[test]
    fn a_distribution_is_asked_for_exactly_where_it_is_drawn_from() {
        for method in ["iid", "rows-then-columns", "stratified"] {
            assert_eq!(faults(&format!("{{ count: 16, method: {method} }}")), ["of"]);
            assert!(faults(&format!("{{ of: dist, count: 16, method: {method} }}")).is_empty());
        }
        for method in ["uniform", "cosine"] {
            assert_eq!(faults(&format!("{{ of: dist, count: 16, method: {method} }}")), ["of"]);
            assert!(faults(&format!("{{ count: 16, method: {method} }}")).is_empty());
        }
        assert_eq!(faults("{ env: env, count: 16, method: cosine }"), ["env"]);
        assert!(faults("{ env: env, count: 16, method: uniform }").is_empty());
    }

    #[test]
    fn a_count_that_is_no_square_is_refused_with_its_neighbors() {
        assert_eq!(faults("{ of: dist, count: 32, method: rows-then-columns }"), ["count"]);
        let mistakes = stage("{ of: dist, count: 32, method: rows-then-columns }").mistakes();
        assert!(mistakes[0].message.contains("square"));
        assert_eq!(mistakes[0].hint.as_deref(), Some("try `25` or `36`"));
    }

    #[test]
    fn a_count_of_zero_or_over_a_hundred_million_is_outside_the_schema() {
        let schema = Kind::of::<SampleStage>().schema;
        let count = &schema["properties"]["count"];
        assert_eq!((count["minimum"].as_u64(), count["maximum"].as_u64()), (Some(1), Some(100_000_000)), "{count}");
        assert!(serde_yaml::from_str::<SampleStage>("{ of: dist, count: 0 }").is_err());
    }

    #[test]
    fn names_of_methods_are_those_of_the_file() {
        for method in [Method::Iid, Method::RowsThenColumns, Method::Stratified, Method::Uniform, Method::Cosine] {
            assert_eq!(serde_json::to_value(method).unwrap(), method.name());
        }
    }
}

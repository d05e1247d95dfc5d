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
use crate::light::points::Arrangement;
use crate::light::samples::{Sample, SampleSet};
use crate::light::sampling::{self, Draw, Placement, SamplingError};
use crate::light::warp::{WarpKind, memory_per_pixel};

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
    /// The first `count` points of Sobol's sequence, scrambled after Owen by hashing (Burley 2020), then by the
    /// distribution of `of`. Any count; powers of two are spread best. Each seed is an independent scrambling.
    Sobol,
    /// Uniform on the sphere; needs no distribution.
    Uniform,
    /// Density cosine / pi about +z, turned to each normal by `relight`; needs no distribution.
    Cosine,
}

impl Method {
    /// How its points are spread where it draws from a distribution.
    pub fn arrangement(self) -> Option<Arrangement> {
        match self {
            Method::Iid => Some(Arrangement::Independent),
            Method::RowsThenColumns => Some(Arrangement::RowsThenColumns),
            Method::Stratified => Some(Arrangement::Stratified),
            Method::Sobol => Some(Arrangement::Sobol),
            Method::Uniform | Method::Cosine => None,
        }
    }

    fn needs_distribution(self) -> bool {
        self.arrangement().is_some()
    }

    /// As it is written in a pipeline file.
    fn name(self) -> &'static str {
        match self {
            Method::Iid => "iid",
            Method::RowsThenColumns => "rows-then-columns",
            Method::Stratified => "stratified",
            Method::Sobol => "sobol",
            Method::Uniform => "uniform",
            Method::Cosine => "cosine",
        }
    }
}

/// How a point of the unit square finds its pixel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Warp {
    /// Row, then column, by inverting cumulative probabilities.
    #[default]
    Marginal,
    /// Row, then column, by alias tables (Walker 1977, Vose 1991): constant time, eight bytes a pixel; well-spread points lose most of
    /// their order.
    Alias,
    /// Halving down a pyramid of sums (Clarberg et al. 2005): neighbors on the square stay neighbors on the map.
    Hierarchical,
}

/// How a cumulative probability is inverted by `warp: marginal`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Inversion {
    /// The first row, then column, whose cumulative probability exceeds the number: realizes the distribution.
    #[default]
    LowerBound,
    /// The one whose cumulative probability is nearest to the number (second report): realizes a distribution that is shifted by
    /// half a pixel and blurred, (p_j + p_{j+1}) / 2.
    Nearest,
}

/// Which probability samples of `inversion: nearest` carry.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Reported {
    /// The one with which they are drawn.
    #[default]
    Realized,
    /// The one of the distribution, as in the second report: estimates are biased.
    Intended,
}

/// Where in its pixel a direction lies.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum InPixel {
    /// At the direction that the pixel stands for.
    #[default]
    Center,
    /// Uniform in u and v; the density grows towards the poles within a pixel.
    Uv,
    /// Uniform in solid angle; the density is constant within a pixel.
    SolidAngle,
}

impl From<Warp> for WarpKind {
    fn from(warp: Warp) -> Self {
        match warp {
            Warp::Marginal => WarpKind::Marginal,
            Warp::Alias => WarpKind::Alias,
            Warp::Hierarchical => WarpKind::Hierarchical,
        }
    }
}

impl From<InPixel> for Placement {
    fn from(place: InPixel) -> Self {
        match place {
            InPixel::Center => Placement::Center,
            InPixel::Uv => Placement::Uv,
            InPixel::SolidAngle => Placement::SolidAngle,
        }
    }
}

/// Draws directions, more where a map is brighter.
///
/// Points of the unit square (`method`) find their pixels (`warp`) and places in them (`in_pixel`); every combination realizes
/// the probabilities of the distribution, except `inversion: nearest`. A sample carries the probability of its pixel and
/// its density per steradian. Source: Pharr, Jakob, Humphreys, "Physically Based Rendering", 3rd edition, section 13.6.7.
///
/// ```yaml
/// samples: { sample: { of: dist, count: $n, method: sobol }, save: csv } # one set for each n
/// ```
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
    /// How a point finds its pixel. Default `marginal`.
    #[serde(default)]
    pub warp: Warp,
    /// How `warp: marginal` inverts. Default `lower-bound`.
    #[serde(default)]
    pub inversion: Inversion,
    /// Which probability samples of `inversion: nearest` carry. Default `realized`.
    #[serde(default)]
    pub pdf: Option<Reported>,
    /// Where in its pixel a direction lies. Default `center`; the others need a map with `angles: center`.
    #[serde(default)]
    pub in_pixel: InPixel,
    /// Another seed gives another, equally good set; by default the pipeline's.
    #[serde(default)]
    pub seed: Seed,
}

impl SampleStage {
    fn draw(&self, job: &Job<'_>, env: Option<&EnvMap>) -> Result<SampleSet, SamplingError<StageError>> {
        let (count, seed) = (self.count.get() as usize, job.seed(self.seed));
        let distribution = job.optional_input(&self.of).map_err(SamplingError::Interrupted)?;
        let check = || job.check();
        match (self.method.arrangement(), distribution.as_deref()) {
            (Some(arrangement), Some(distribution)) => {
                if distribution.is_compensated() {
                    job.warn(
                        "`of` is compensated: part of the sphere is never drawn, and an estimate from these directions alone is biased",
                    );
                }
                let draw = Draw { count, seed, arrangement, warp: self.warp_kind(), placement: self.in_pixel.into() };
                sampling::draw(distribution, &draw, check)
            }
            (None, None) if self.method == Method::Uniform => sampling::uniform(env.map(size), count, seed, check),
            (None, None) => sampling::cosine(count, seed, check),
            _ => unreachable!("the plan refuses method `{}` with this `of`", self.method.name()),
        }
    }

    fn warp_kind(&self) -> WarpKind {
        match self.inversion {
            Inversion::LowerBound => self.warp.into(),
            Inversion::Nearest => WarpKind::Nearest { reports_intended: self.pdf == Some(Reported::Intended) },
        }
    }

    /// Fields that the method or another field leaves without a meaning.
    fn combinations_without_meaning(&self) -> Vec<Mistake> {
        let draws = self.method.needs_distribution();
        let (is_plain, is_nearest) = (self.warp == Warp::Marginal, self.inversion == Inversion::Nearest);
        let method = self.method.name();
        let wrong = [
            ("warp", !draws && !is_plain, format!("method `{method}` draws from no distribution")),
            ("inversion", !draws && is_nearest, format!("method `{method}` draws from no distribution")),
            ("in_pixel", !draws && self.in_pixel != InPixel::Center, format!("method `{method}` draws from no distribution")),
            (
                "warp",
                self.method == Method::RowsThenColumns && !is_plain,
                format!("method `{method}` is an inversion of rows, then columns"),
            ),
            ("inversion", draws && is_nearest && !is_plain, "`nearest` is an inversion, for `warp: marginal` alone".into()),
            (
                "in_pixel",
                draws && is_nearest && self.in_pixel != InPixel::Center,
                "`inversion: nearest` gives pixels, no places inside them".into(),
            ),
            ("pdf", !is_nearest && self.pdf.is_some(), "only with `inversion: nearest` do the two differ".into()),
        ];
        let mistake =
            |(field, _, message): (&str, bool, String)| Mistake { field: field.into(), message, hint: Some(format!("remove `{field}`")) };
        wrong.into_iter().filter(|(_, is_wrong, _)| *is_wrong).map(mistake).collect()
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
        mistakes.extend(self.combinations_without_meaning());
        mistakes
    }

    fn caveats(&self) -> Vec<String> {
        let mut caveats = Vec::new();
        if self.method == Method::RowsThenColumns {
            caveats.push("method `rows-then-columns` (second report): unbiased cluster sampling, of larger variance than `iid`".into());
        }
        if self.inversion == Inversion::Nearest {
            let reported = match self.pdf.unwrap_or_default() {
                Reported::Realized => "its own probabilities are reported",
                Reported::Intended => "the intended probabilities are reported, and estimates are biased",
            };
            caveats.push(format!("inversion `nearest` (second report): draws from a shifted and blurred distribution; {reported}"));
        }
        caveats
    }

    fn memory(&self, inputs: &InputSizes) -> u64 {
        // A distribution holds at least four bytes a pixel.
        let pixels = inputs.get("of").copied().unwrap_or(0) / 4;
        u64::from(self.count.get()) * size_of::<Sample>() as u64 + pixels * memory_per_pixel(self.warp_kind())
    }

    fn run(&self, job: &Job<'_>) -> Result<SampleSet, StageError> {
        let env = job.optional_input(&self.env)?;
        let mut set = self.draw(job, env.as_deref()).map_err(sampling_error)?;
        if let Some(env) = env {
            sampling::look_up(&mut set, &env);
        }
        Ok(set)
    }
}

fn size(map: &EnvMap) -> [u32; 2] {
    [map.width() as u32, map.height() as u32]
}

/// What to do about directions that cannot be drawn.
pub fn sampling_error(error: SamplingError<StageError>) -> StageError {
    match error {
        SamplingError::Interrupted(error) => error,
        SamplingError::NotSquare { .. } => StageError::content(error),
        SamplingError::NotCentered => StageError::content_with_hint(error, "set `in_pixel: center`, or `angles: center` of `load`"),
        SamplingError::NoPlaces => StageError::content_with_hint(error, "set `in_pixel: center`"),
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
        for method in ["iid", "rows-then-columns", "stratified", "sobol"] {
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
    fn combinations_that_mean_nothing_are_refused() {
        for (rest, field) in [
            ("method: sobol, warp: alias, inversion: nearest", "inversion"),
            ("method: rows-then-columns, warp: hierarchical", "warp"),
            ("inversion: nearest, in_pixel: uv", "in_pixel"),
            ("pdf: intended", "pdf"),
        ] {
            assert_eq!(faults(&format!("{{ of: dist, count: 16, {rest} }}")), [field], "{rest}");
        }
        for rest in ["warp: alias", "inversion: nearest", "in_pixel: uv"] {
            assert_eq!(faults(&format!("{{ count: 16, method: uniform, {rest} }}")).len(), 1, "{rest}");
        }
        for rest in
            ["method: sobol, warp: hierarchical, in_pixel: solid-angle", "method: rows-then-columns, inversion: nearest, pdf: intended"]
        {
            assert!(faults(&format!("{{ of: dist, count: 16, {rest} }}")).is_empty(), "{rest}");
        }
        assert!(stage("{ of: dist, count: 16, inversion: nearest, pdf: intended }").caveats()[0].contains("biased"));
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
        let kind = Kind::of::<SampleStage>();
        let schema = kind.schema();
        let count = &schema["properties"]["count"];
        assert_eq!((count["minimum"].as_u64(), count["maximum"].as_u64()), (Some(1), Some(100_000_000)), "{count}");
        assert!(serde_yaml::from_str::<SampleStage>("{ of: dist, count: 0 }").is_err());
    }

    #[test]
    fn names_of_methods_are_those_of_the_file() {
        for method in [Method::Iid, Method::RowsThenColumns, Method::Stratified, Method::Sobol, Method::Uniform, Method::Cosine] {
            assert_eq!(serde_json::to_value(method).unwrap(), method.name());
        }
    }
}

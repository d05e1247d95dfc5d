//! The kind `relight`.

use std::borrow::Cow;
use std::fmt;
use std::sync::Arc;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::de::{SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::engine::artifact::{AnyArtifact, TypeName};
use crate::engine::job::Job;
use crate::engine::parameter::{Accepts, Port};
use crate::engine::stage::{InputSizes, Mistake, ResultDeclaration, Stage, StageError};
use crate::image::raster::Image;
use crate::light::envmap::EnvMap;
use crate::light::harmonics::Coefficients;
use crate::light::lights::LightSet;
use crate::light::relight::estimators::{RelightError, SampleEstimator, WeightedDirections};
use crate::light::relight::exact;
use crate::light::relight::limits::Integrand;
use crate::light::relight::supersample;
use crate::light::relight::turned::TurnedDirections;
use crate::light::relight::views::{self, Encoding, Lookup};
use crate::light::samples::{Frame, SampleSet};

/// Shows a sphere under a map: diffuse by one of several estimators, as a mirror, or its normals.
///
/// The camera is orthographic and looks along -z, +x to the right, +y up. Alpha is 1 where the center of a pixel
/// shows the sphere. One set of samples serves all pixels.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Relight {
    /// The map that lights the sphere. Not needed for `lights`, nor for samples that carry radiance.
    #[serde(default)]
    pub env: Option<Port<EnvMap>>,
    /// Samples or lights to estimate with; not for `exact` and `sh9`, nor for the mirror and normal views.
    #[serde(default)]
    pub with: Option<Port<Illumination>>,
    /// How radiance is found. By default `pdf-weighted` for samples and `lights` for lights.
    #[serde(default)]
    pub estimator: Option<Estimator>,
    /// What the sphere is made of. Default `diffuse`.
    #[serde(default)]
    pub view: View,
    /// Width and height of the picture in pixels. Default 511, the coursework's.
    #[serde(default = "usual_size")]
    #[schemars(range(min = 1, max = 65536), extend("x-unit" = "px"))]
    pub size: u32,
    /// Points along each side of a pixel over which the picture is averaged; alpha is then the part of the pixel that
    /// shows the sphere. Default 1: the center alone. A path tracer's box filter is compared with 4 or more.
    #[serde(default = "one")]
    #[schemars(range(min = 1, max = 32))]
    pub supersample: u32,
    /// Share of the light that the diffuse sphere reflects: a number or `[r, g, b]`, from 0 to 1. Default 1.
    #[serde(default)]
    pub albedo: Option<Albedo>,
    /// For the mirror view: how the map is read between pixels. Default `bilinear`.
    #[serde(default)]
    pub lookup: Option<Lookup>,
    /// For the normal view: how components become color. Default `unit`.
    #[serde(default)]
    pub encoding: Option<Encoding>,
}

fn usual_size() -> u32 {
    511
}

fn one() -> u32 {
    1
}

/// What the sphere is made of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum View {
    /// Lambert's reflection of all light.
    #[default]
    Diffuse,
    /// A perfect mirror, as a light probe is photographed; takes `env` alone.
    Mirror,
    /// The normals as colors.
    Normal,
}

/// How the radiance of the diffuse sphere is found.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Estimator {
    /// The mean of radiance times cosine: the first report's equation 4. Tends to a mean weighted by
    /// brightness, not to the radiance.
    EqualWeight,
    /// Intensity times normalized color over probability: the first report's equation 5 as printed. Leaves out
    /// the solid angle and dims saturated colors.
    NormalizedColor,
    /// The same with the intensity scaled by the sine: the other reading of equation 5.
    NormalizedColorSine,
    /// Radiance over density: unbiased.
    PdfWeighted,
    /// The sum over the directional lights of a cut.
    Lights,
    /// Nine spherical harmonics of the map (Ramamoorthi and Hanrahan 2001).
    Sh9,
    /// The sum over every pixel of the map.
    Exact,
}

impl Estimator {
    fn of_samples(self) -> Option<SampleEstimator> {
        match self {
            Self::EqualWeight => Some(SampleEstimator::EqualWeight),
            Self::NormalizedColor => Some(SampleEstimator::NormalizedColor),
            Self::NormalizedColorSine => Some(SampleEstimator::NormalizedColorSine),
            Self::PdfWeighted => Some(SampleEstimator::PdfWeighted),
            Self::Lights | Self::Sh9 | Self::Exact => None,
        }
    }

    fn name(self) -> &'static str {
        match self {
            Self::Lights => "lights",
            Self::Sh9 => "sh9",
            Self::Exact => "exact",
            Self::EqualWeight | Self::NormalizedColor | Self::NormalizedColorSine | Self::PdfWeighted => {
                self.of_samples().map_or("", SampleEstimator::name)
            }
        }
    }

    /// What the manifest must say of it.
    fn caveat(self) -> Option<&'static str> {
        match self {
            Self::EqualWeight => {
                Some("is equation 4 of the first report and biased: it tends to a mean weighted by brightness, not to the radiance")
            }
            Self::NormalizedColor => {
                Some("is equation 5 of the first report as printed and biased: it leaves out the solid angle and dims saturated colors")
            }
            Self::NormalizedColorSine => Some(
                "is the other reading of equation 5 of the first report and biased: \
                 it dims saturated colors and its scale is not radiance",
            ),
            Self::Lights => Some("has an error of its own that no number of pixels averages out: each region shines from one direction"),
            Self::Sh9 => Some("keeps nine harmonics of the light: it errs by some percent, more under a single lamp, and may be negative"),
            Self::PdfWeighted | Self::Exact => None,
        }
    }
}

/// A number, or one per channel; from 0 to 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Albedo {
    /// The same for all channels.
    Gray(f64),
    /// Red, green, blue.
    Color([f64; 3]),
}

impl Albedo {
    fn rgb(self) -> [f64; 3] {
        match self {
            Albedo::Gray(value) => [value; 3],
            Albedo::Color(color) => color,
        }
    }
}

impl Serialize for Albedo {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Albedo::Gray(value) => value.serialize(serializer),
            Albedo::Color(color) => color.serialize(serializer),
        }
    }
}

impl<'de> Deserialize<'de> for Albedo {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Forms;

        impl<'de> Visitor<'de> for Forms {
            type Value = Albedo;

            fn expecting(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
                out.write_str("a number or a list of three numbers")
            }

            fn visit_f64<E>(self, value: f64) -> Result<Albedo, E> {
                Ok(Albedo::Gray(value))
            }

            fn visit_u64<E>(self, value: u64) -> Result<Albedo, E> {
                Ok(Albedo::Gray(value as f64))
            }

            fn visit_seq<A: SeqAccess<'de>>(self, sequence: A) -> Result<Albedo, A::Error> {
                <[f64; 3]>::deserialize(serde::de::value::SeqAccessDeserializer::new(sequence)).map(Albedo::Color)
            }
        }

        deserializer.deserialize_any(Forms)
    }
}

impl JsonSchema for Albedo {
    fn inline_schema() -> bool {
        true
    }

    fn schema_name() -> Cow<'static, str> {
        "Albedo".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        let channel = json_schema!({ "type": "number", "minimum": 0, "maximum": 1 });
        json_schema!({
            "anyOf": [channel, { "type": "array", "items": channel, "minItems": 3, "maxItems": 3 }],
        })
    }
}

/// What estimates can be made with.
#[derive(Debug, Clone)]
pub enum Illumination {
    /// Directions drawn at random.
    Samples(Arc<SampleSet>),
    /// The lights of a cut.
    Lights(Arc<LightSet>),
}

impl Accepts for Illumination {
    const TYPES: &'static [TypeName] = &["samples", "lights"];
    type Value = Self;

    fn take(artifact: AnyArtifact) -> Option<Self> {
        artifact.get().map(Self::Samples).or_else(|| artifact.get().map(Self::Lights))
    }
}

impl Stage for Relight {
    const KIND: &'static str = "relight";
    const VERSION: u32 = 1;
    const RESULTS: &'static [ResultDeclaration] = &[ResultDeclaration { name: "", types: &["image"] }];
    type Output = Image;

    fn mistakes(&self) -> Vec<Mistake> {
        let mut mistakes = self.fields_without_meaning();
        mistakes.extend(self.missing_port());
        mistakes.extend(self.too_many_points());
        mistakes
    }

    fn caveats(&self) -> Vec<String> {
        let said = |estimator: Estimator| Some(format!("`estimator: {}` {}", estimator.name(), estimator.caveat()?));
        self.estimator.and_then(said).into_iter().collect()
    }

    /// The picture, and for the exact sum its running sums; the map is not known better than by its bytes.
    fn memory(&self, inputs: &InputSizes) -> u64 {
        let size = self.points();
        let picture = 16 * (size * size) as u64;
        match self.estimator {
            Some(Estimator::Exact) => picture + exact::memory(map_width(inputs.get("env").copied().unwrap_or(0)), size),
            _ => picture + inputs.get("with").copied().unwrap_or(0),
        }
    }

    fn run(&self, job: &Job<'_>) -> Result<Image, StageError> {
        let env = job.optional_input(&self.env)?;
        let size = self.points();
        let image = match self.view {
            View::Diffuse => self.diffuse(env, job),
            View::Mirror => views::mirror(&*given(env)?, self.lookup.unwrap_or_default(), size, || job.check()),
            View::Normal => views::normals(self.encoding.unwrap_or_default(), size, || job.check()),
        };
        Ok(supersample::averaged(image?, self.supersample as usize))
    }
}

impl Relight {
    /// Points along each side of the picture.
    fn points(&self) -> usize {
        self.size as usize * self.supersample as usize
    }

    fn diffuse(&self, env: Option<Arc<EnvMap>>, job: &Job<'_>) -> Result<Image, StageError> {
        let (size, albedo) = (self.points(), self.albedo.map_or([1.0; 3], Albedo::rgb));
        match (self.estimator, job.optional_input(&self.with)?) {
            (Some(Estimator::Exact), _) => exact::relight(&*given(env)?, &Integrand::radiance(), size, albedo, || job.check()),
            (Some(Estimator::Sh9), _) => Coefficients::of(&*given(env)?, || job.check())?.relight(size, albedo, || job.check()),
            (None | Some(Estimator::Lights), Some(Illumination::Lights(lights))) => {
                WeightedDirections::of_lights(&lights).relight(size, albedo, || job.check())
            }
            (estimator, Some(Illumination::Samples(samples))) => {
                let estimator = estimator.unwrap_or(Estimator::PdfWeighted).of_samples().ok_or_else(lights_from_samples)?;
                from_samples(&samples, env.as_deref(), estimator, size, albedo, job)
            }
            (Some(estimator), Some(Illumination::Lights(_))) => Err(samples_from_lights(estimator)),
            (_, None) => Err(StageError::content("there is nothing to estimate with; set `with` to samples or lights")),
        }
    }

    /// Fields that the view or the estimator does not read.
    fn fields_without_meaning(&self) -> Vec<Mistake> {
        let is_diffuse = self.view == View::Diffuse;
        let is_by_map = matches!(self.estimator, Some(Estimator::Exact | Estimator::Sh9));
        let unread = [
            ("estimator", !is_diffuse && self.estimator.is_some(), "is for `view: diffuse` alone"),
            ("albedo", !is_diffuse && self.albedo.is_some(), "is for `view: diffuse` alone"),
            ("with", !is_diffuse && self.with.is_some(), "is for `view: diffuse` alone"),
            ("with", is_diffuse && is_by_map && self.with.is_some(), "is not read: this estimator uses every pixel of `env`"),
            ("lookup", self.view != View::Mirror && self.lookup.is_some(), "is for `view: mirror` alone"),
            ("encoding", self.view != View::Normal && self.encoding.is_some(), "is for `view: normal` alone"),
        ];
        let mistake = |(field, _, why): (&str, bool, &str)| Mistake {
            field: field.into(),
            message: format!("`{field}` {why}"),
            hint: Some(format!("remove `{field}`")),
        };
        unread.into_iter().filter(|(_, is_unread, _)| *is_unread).map(mistake).collect()
    }

    /// A picture of more points than memory can be asked for.
    fn too_many_points(&self) -> Option<Mistake> {
        const LIMIT: usize = 65_536;
        (self.points() > LIMIT).then(|| Mistake {
            field: "supersample".into(),
            message: format!("`size` times `supersample` is `{}`, over the limit of {LIMIT} points a side", self.points()),
            hint: Some("lower one of them".into()),
        })
    }

    fn missing_port(&self) -> Option<Mistake> {
        let mistake = |field: &str, message: &str, hint: &str| {
            Some(Mistake { field: field.into(), message: message.into(), hint: Some(hint.into()) })
        };
        let needs_env = match self.view {
            View::Diffuse => matches!(self.estimator, Some(Estimator::Exact | Estimator::Sh9)),
            View::Mirror => true,
            View::Normal => false,
        };
        if needs_env && self.env.is_none() {
            return mistake("env", "`env` is missing: the sphere shows a map", "set `env` to a stage that gives an envmap");
        }
        if self.view == View::Diffuse && !needs_env && self.with.is_none() {
            let hint = "set `with` to a stage that gives samples or lights, or `estimator: exact`";
            return mistake("with", "`with` is missing: there is nothing to estimate with", hint);
        }
        None
    }
}

fn from_samples(
    samples: &SampleSet,
    env: Option<&EnvMap>,
    estimator: SampleEstimator,
    size: usize,
    albedo: [f64; 3],
    job: &Job<'_>,
) -> Result<Image, StageError> {
    match samples.frame {
        Frame::World => {
            let directions = WeightedDirections::of_samples(samples, env, estimator)?;
            warn_of_skipped(directions.skipped_count, job);
            directions.relight(size, albedo, || job.check())
        }
        Frame::Normal => {
            let env = env.ok_or_else(|| {
                StageError::content("samples about the normal meet other directions at every pixel; set `env` to the map that lights it")
            })?;
            let directions = TurnedDirections::new(samples, env, estimator)?;
            warn_of_skipped(directions.skipped_count, job);
            directions.relight(size, albedo, || job.check())
        }
    }
}

fn warn_of_skipped(count: usize, job: &Job<'_>) {
    if count > 0 {
        job.warn(format!("{count} samples have probability 0 and count as black; the estimate is biased"));
    }
}

fn given(env: Option<Arc<EnvMap>>) -> Result<Arc<EnvMap>, StageError> {
    env.ok_or_else(|| StageError::content("`env` is missing; set it to the map that the sphere shows"))
}

fn lights_from_samples() -> StageError {
    StageError::content_with_hint(
        "`estimator: lights` needs lights, `with` gives samples",
        "set `with` to a `median-cut` stage, or `estimator: pdf-weighted`",
    )
}

fn samples_from_lights(estimator: Estimator) -> StageError {
    StageError::content_with_hint(
        format!("`estimator: {}` needs samples, `with` gives lights", estimator.name()),
        "set `with` to a `sample` stage, or `estimator: lights`",
    )
}

/// Columns of a map of twice as many columns as rows that holds that many bytes: three f32 a pixel.
fn map_width(bytes: u64) -> usize {
    (bytes as f64 / 12.0 * 2.0).sqrt() as usize
}

impl From<RelightError> for StageError {
    fn from(error: RelightError) -> Self {
        StageError::content(error)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parsed(yaml: &str) -> Relight {
        serde_yaml::from_str(yaml).unwrap()
    }

    fn faulty_fields(yaml: &str) -> Vec<String> {
        parsed(yaml).mistakes().into_iter().map(|mistake| mistake.field).collect()
    }

    #[test]
    fn complete_parameter_blocks_have_no_mistakes() {
        for yaml in [
            "{ env: e, with: s }",
            "{ with: l }",
            "{ env: e, with: s, estimator: normalized-color-sine, albedo: 0.5 }",
            "{ env: e, estimator: exact, albedo: [1, 0.5, 0] }",
            "{ env: e, estimator: sh9, size: 64 }",
            "{ env: e, view: mirror, lookup: nearest }",
            "{ view: normal, encoding: raw }",
            "{ env: e, view: normal }",
        ] {
            assert!(faulty_fields(yaml).is_empty(), "{yaml}");
        }
    }

    #[test]
    fn fields_that_mean_nothing_or_are_missing_are_named() {
        for (yaml, fields) in [
            ("{ env: e }", vec!["with"]),
            ("{ estimator: exact }", vec!["env"]),
            ("{ env: e, with: s, estimator: sh9 }", vec!["with"]),
            ("{ view: mirror }", vec!["env"]),
            ("{ env: e, view: mirror, estimator: exact, albedo: 1 }", vec!["estimator", "albedo"]),
            ("{ view: normal, with: s, lookup: nearest }", vec!["with", "lookup"]),
            ("{ env: e, with: s, encoding: raw }", vec!["encoding"]),
        ] {
            assert_eq!(faulty_fields(yaml), fields, "{yaml}");
        }
    }

    #[test]
    fn an_albedo_is_a_number_or_three() {
        assert_eq!(parsed("{ albedo: 1 }").albedo, Some(Albedo::Gray(1.0)));
        assert_eq!(parsed("{ albedo: [0, 0.5, 1] }").albedo, Some(Albedo::Color([0.0, 0.5, 1.0])));
        assert!(serde_yaml::from_str::<Relight>("{ albedo: [0, 1] }").is_err());
        assert!(serde_yaml::from_str::<Relight>("{ albedo: white }").is_err());
        assert_eq!(serde_json::to_string(&Albedo::Color([0.0, 0.5, 1.0])).unwrap(), "[0.0,0.5,1.0]");
    }

    #[test]
    fn only_biased_estimators_have_a_caveat() {
        let caveats = |name: &str| parsed(&format!("{{ env: e, estimator: {name} }}")).caveats();
        assert!(caveats("exact").is_empty() && caveats("pdf-weighted").is_empty());
        for name in ["equal-weight", "normalized-color", "normalized-color-sine", "sh9"] {
            assert!(caveats(name)[0].contains(name), "{name}");
        }
    }
}

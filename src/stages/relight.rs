//! The kind `relight`.

use std::borrow::Cow;
use std::fmt;
use std::num::NonZeroU32;
use std::sync::Arc;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::de::{SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::engine::artifact::{AnyArtifact, TypeName};
use crate::engine::job::Job;
use crate::engine::parameter::{Accepts, Port, Seed};
use crate::engine::stage::{InputSizes, Mistake, ResultDeclaration, Stage, StageError};
use crate::image::raster::Image;
use crate::light::distribution::Distribution;
use crate::light::envmap::EnvMap;
use crate::light::harmonics::Coefficients;
use crate::light::lights::LightSet;
use crate::light::points::Arrangement;
use crate::light::relight::drawn::{Drawing, Technique};
use crate::light::relight::estimators::{RelightError, SampleEstimator, WeightedDirections, weighted_lights, weighted_samples};
use crate::light::relight::exact;
use crate::light::relight::limits::Integrand;
use crate::light::relight::lobe::Lobe;
use crate::light::relight::reflected;
use crate::light::relight::supersample;
use crate::light::relight::turned::TurnedDirections;
use crate::light::relight::views::{self, Encoding, Lookup};
use crate::light::samples::{Frame, SampleSet};
use crate::light::sampling::{Sampler, SamplingError};
use crate::light::warp::memory_per_pixel;
use crate::stages::sample::{InPixel, Method, Warp, sampling_error};

/// Shows a sphere under a map: diffuse or glossy by one of several estimators, as a mirror, or its normals.
///
/// The camera is orthographic and looks along -z, +x to the right, +y up. Alpha is 1 where the center of a pixel
/// shows the sphere. A set of samples serves all pixels; with a distribution in `with`, and for `lobe-weighted`, each pixel draws `count`
/// directions for itself. Combinations of two techniques after Veach and Guibas (1995).
///
/// ```yaml
/// sphere: { relight: { env: env, with: samples }, save: pfm } # from a set of samples
/// truth: { relight: { env: env, estimator: exact } } # from every pixel of the map
/// ```
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Relight {
    /// The map that lights the sphere. Not needed for `lights`, nor for samples that carry radiance.
    #[serde(default)]
    pub env: Option<Port<EnvMap>>,
    /// Samples or lights to estimate with, or a distribution to draw from; not for `exact`, `sh9` and `lobe-weighted`, nor for the mirror and
    /// normal views.
    #[serde(default)]
    pub with: Option<Port<Source>>,
    /// How radiance is found. By default `pdf-weighted` for samples and distributions, and `lights` for lights.
    #[serde(default)]
    pub estimator: Option<Estimator>,
    /// Gives what the estimator tends to with ever more samples from the distribution in `with`, summed over every pixel of the map: its
    /// limit in closed form. For the estimators of samples. Default false.
    #[serde(default)]
    pub limit: bool,
    /// What the sphere is made of. Default `diffuse`.
    #[serde(default)]
    pub view: View,
    /// For the glossy view: the shape of its reflection.
    #[serde(default)]
    pub lobe: Option<LobeShape>,
    /// Width and height of the picture in pixels. Default 511, the coursework's.
    #[serde(default = "usual_size")]
    #[schemars(range(min = 1, max = 65536), extend("x-unit" = "px"))]
    pub size: u32,
    /// Points along each side of a pixel over which the picture is averaged; alpha is then the part of the pixel that
    /// shows the sphere. Default 1: the center alone. A path tracer's box filter is compared with 4 or more.
    #[serde(default = "one")]
    #[schemars(range(min = 1, max = 32))]
    pub supersample: u32,
    /// Share of the light that the sphere reflects: a number or `[r, g, b]`, from 0 to 1. Default 1.
    #[serde(default)]
    pub albedo: Option<Albedo>,
    /// Where pixels draw for themselves: directions of each, up to a million. Combinations draw half by the map and half by the lobe.
    #[serde(default)]
    #[schemars(range(min = 1, max = 1_000_000))]
    pub count: Option<NonZeroU32>,
    /// Where pixels draw for themselves: how points are spread. Default `iid`.
    #[serde(default)]
    pub method: Option<PixelMethod>,
    /// Where pixels draw for themselves: how a point finds its pixel of the map. Default `marginal`.
    #[serde(default)]
    pub warp: Option<Warp>,
    /// Where pixels draw for themselves: where in a pixel of the map a direction lies. By default `center`, and `solid-angle` for combinations,
    /// which need a density at every direction.
    #[serde(default)]
    pub in_pixel: Option<InPixel>,
    /// Where pixels draw for themselves: whether they share their points. Default `per-pixel`.
    #[serde(default)]
    pub points: Option<PointSharing>,
    /// Where pixels draw for themselves: another seed gives other, equally good points; by default the pipeline's.
    #[serde(default)]
    pub seed: Seed,
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

/// The shape of a glossy reflection, white and without Fresnel factor.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum LobeShape {
    /// (e + 2) / (2 pi) cos^e about the mirror direction (Lafortune and Willems 1994): reflects at most all light.
    Phong(Phong),
    /// GGX with height-correlated masking, single scattering (Walter et al. 2007, Heitz 2014).
    Ggx(Ggx),
}

/// Phong's lobe.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Phong {
    /// The exponent, a whole number: the larger, the sharper.
    #[schemars(range(min = 1, max = 100_000))]
    pub exponent: NonZeroU32,
}

/// A rough mirror.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Ggx {
    /// Width of the distribution of slopes, from 0.001 to 1: the smaller, the sharper.
    #[schemars(range(min = 0.001, max = 1))]
    pub alpha: f64,
}

impl From<LobeShape> for Lobe {
    fn from(shape: LobeShape) -> Self {
        match shape {
            LobeShape::Phong(Phong { exponent }) => Lobe::Phong { exponent: exponent.get() },
            LobeShape::Ggx(Ggx { alpha }) => Lobe::Ggx { alpha },
        }
    }
}

/// How the points of a pixel are spread.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum PixelMethod {
    /// Each independent of the others.
    #[default]
    Iid,
    /// One in each of as many equal cells.
    Stratified,
    /// Sobol points scrambled after Owen.
    Sobol,
}

impl PixelMethod {
    fn arrangement(self) -> Arrangement {
        let method = match self {
            Self::Iid => Method::Iid,
            Self::Stratified => Method::Stratified,
            Self::Sobol => Method::Sobol,
        };
        method.arrangement().expect("these draw from distributions")
    }
}

/// Whether pixels have points of their own.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum PointSharing {
    /// Each its own: errors are grain.
    #[default]
    PerPixel,
    /// All the same: errors are smooth, and alike in neighboring pixels.
    Shared,
}

/// What the sphere is made of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum View {
    /// Lambert's reflection of all light.
    #[default]
    Diffuse,
    /// Reflection by `lobe`.
    Glossy,
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
    /// Directions drawn by the lobe (Lambert's cosine, for the diffuse view) alone, radiance times lobe over density: unbiased.
    LobeWeighted,
    /// Half drawn by the distribution, half by the lobe, combined by the balance heuristic: unbiased.
    MisBalance,
    /// The same by the power heuristic with exponent 2: unbiased.
    MisPower,
}

impl Estimator {
    fn of_samples(self) -> Option<SampleEstimator> {
        match self {
            Self::EqualWeight => Some(SampleEstimator::EqualWeight),
            Self::NormalizedColor => Some(SampleEstimator::NormalizedColor),
            Self::NormalizedColorSine => Some(SampleEstimator::NormalizedColorSine),
            Self::PdfWeighted => Some(SampleEstimator::PdfWeighted),
            Self::Lights | Self::Sh9 | Self::Exact | Self::LobeWeighted | Self::MisBalance | Self::MisPower => None,
        }
    }

    /// What pixels that draw for themselves draw by; `None` where they do not.
    fn technique(self) -> Option<Technique> {
        match self {
            Self::PdfWeighted => Some(Technique::Map),
            Self::LobeWeighted => Some(Technique::Lobe),
            Self::MisBalance => Some(Technique::Balance),
            Self::MisPower => Some(Technique::Power),
            _ => None,
        }
    }

    fn name(self) -> &'static str {
        match self {
            Self::Lights => "lights",
            Self::Sh9 => "sh9",
            Self::Exact => "exact",
            Self::LobeWeighted => "lobe-weighted",
            Self::MisBalance => "mis-balance",
            Self::MisPower => "mis-power",
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
            Self::PdfWeighted | Self::Exact | Self::LobeWeighted | Self::MisBalance | Self::MisPower => None,
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

/// Directions with radiance: what a map has been reduced to.
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

/// What estimates can be made with.
#[derive(Debug, Clone)]
pub enum Source {
    /// Directions for all pixels.
    Illumination(Illumination),
    /// Probabilities by which pixels draw for themselves.
    Distribution(Arc<Distribution>),
}

impl Accepts for Source {
    const TYPES: &'static [TypeName] = &["samples", "lights", "distribution"];
    type Value = Self;

    fn take(artifact: AnyArtifact) -> Option<Self> {
        artifact.get().map(Self::Distribution).or_else(|| Illumination::take(artifact).map(Self::Illumination))
    }
}

impl Stage for Relight {
    const KIND: &'static str = "relight";
    const VERSION: u32 = 1;
    const RESULTS: &'static [ResultDeclaration] = &[ResultDeclaration { name: "", types: &["image"] }];
    type Output = Image;

    fn draws(&self) -> bool {
        self.count.is_some()
    }

    fn mistakes(&self) -> Vec<Mistake> {
        let mut mistakes = self.fields_without_meaning();
        mistakes.extend(self.missing_field());
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
        let map = inputs.get("env").copied().unwrap_or(0);
        match self.estimator {
            Some(Estimator::Exact) if self.view == View::Glossy => picture + reflected::memory(map / 12),
            Some(Estimator::Exact) => picture + exact::memory(map_width(map), size),
            _ if self.limit => picture + exact::memory(map_width(map), size).max(reflected::memory(map / 12)),
            _ if self.count.is_some() => picture + map / 12 * memory_per_pixel(self.warp.unwrap_or_default().into()),
            _ => picture + inputs.get("with").copied().unwrap_or(0),
        }
    }

    fn run(&self, job: &Job<'_>) -> Result<Image, StageError> {
        let env = job.optional_input(&self.env)?;
        let size = self.points();
        let image = match self.view {
            View::Diffuse => self.shaded(env, Lobe::Diffuse, job),
            View::Glossy => self.shaded(env, self.lobe.map_or(Lobe::Diffuse, Lobe::from), job),
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

    fn rgb(&self) -> [f64; 3] {
        self.albedo.map_or([1.0; 3], Albedo::rgb)
    }

    fn shaded(&self, env: Option<Arc<EnvMap>>, lobe: Lobe, job: &Job<'_>) -> Result<Image, StageError> {
        let (size, albedo) = (self.points(), self.rgb());
        match (self.estimator, job.optional_input(&self.with)?) {
            (Some(Estimator::Exact), _) => {
                let env = given(env)?;
                warn_of_narrow_lobe(&env, lobe, job);
                self.summed(&env, &Integrand::radiance(), lobe, job)
            }
            (Some(Estimator::Sh9), _) => Coefficients::of(&*given(env)?, || job.check())?.relight(size, albedo, || job.check()),
            (Some(Estimator::LobeWeighted), _) => self.drawn(&*given(env)?, None, lobe, job),
            (None | Some(Estimator::Lights), Some(Source::Illumination(Illumination::Lights(lights)))) => match lobe {
                Lobe::Diffuse => WeightedDirections::of_lights(&lights).relight(size, albedo, || job.check()),
                _ => reflected::by_directions(&weighted_lights(&lights), lobe, size, albedo, || job.check()),
            },
            (estimator, Some(Source::Distribution(distribution))) => {
                let env = given(env)?;
                check_distribution(&distribution, &env)?;
                match (self.limit, estimator.unwrap_or(Estimator::PdfWeighted).of_samples()) {
                    (true, Some(estimator)) => self.summed(&env, &Integrand::drawn_from(estimator, &distribution), lobe, job),
                    _ => self.drawn(&env, Some(&distribution), lobe, job),
                }
            }
            (_, Some(_)) if self.limit || self.count.is_some() => Err(needs_distribution()),
            (estimator, Some(Source::Illumination(Illumination::Samples(samples)))) => {
                let estimator = estimator.unwrap_or(Estimator::PdfWeighted);
                let estimator = estimator.of_samples().ok_or_else(|| other_from_samples(estimator))?;
                self.by_samples(&samples, env.as_deref(), estimator, lobe, job)
            }
            (Some(estimator), Some(Source::Illumination(Illumination::Lights(_)))) => Err(samples_from_lights(estimator)),
            (_, None) => Err(StageError::content("there is nothing to estimate with; set `with` to samples or lights")),
        }
    }

    /// The sphere from a set of samples.
    fn by_samples(
        &self,
        samples: &SampleSet,
        env: Option<&EnvMap>,
        estimator: SampleEstimator,
        lobe: Lobe,
        job: &Job<'_>,
    ) -> Result<Image, StageError> {
        let (size, albedo) = (self.points(), self.rgb());
        match (samples.frame, lobe) {
            (Frame::World, Lobe::Diffuse) => {
                let directions = WeightedDirections::of_samples(samples, env, estimator)?;
                warn_of_skipped(directions.skipped_count, job);
                directions.relight(size, albedo, || job.check())
            }
            (Frame::World, _) => {
                let (directions, skipped_count) = weighted_samples(samples, env, estimator)?;
                warn_of_skipped(skipped_count, job);
                reflected::by_directions(&directions, lobe, size, albedo, || job.check())
            }
            (Frame::Normal, Lobe::Diffuse) => {
                let env = env.ok_or_else(|| {
                    StageError::content(
                        "samples about the normal meet other directions at every pixel; set `env` to the map that lights it",
                    )
                })?;
                let directions = TurnedDirections::new(samples, env, estimator)?;
                warn_of_skipped(directions.skipped_count, job);
                directions.relight(size, albedo, || job.check())
            }
            (Frame::Normal, _) => Err(StageError::content_with_hint(
                "samples about the normal follow a cosine, not a glossy lobe",
                "set `estimator: lobe-weighted` with `count`, and leave `with` out",
            )),
        }
    }

    /// The sum over every pixel of a map.
    fn summed(&self, env: &EnvMap, integrand: &Integrand<'_>, lobe: Lobe, job: &Job<'_>) -> Result<Image, StageError> {
        match lobe {
            Lobe::Diffuse => exact::relight(env, integrand, self.points(), self.rgb(), || job.check()),
            _ => reflected::exact(env, integrand, lobe, self.points(), self.rgb(), || job.check()),
        }
    }

    /// Pixels that draw for themselves.
    fn drawn(&self, env: &EnvMap, distribution: Option<&Distribution>, lobe: Lobe, job: &Job<'_>) -> Result<Image, StageError> {
        let estimator = self.estimator.unwrap_or(Estimator::PdfWeighted);
        let technique = estimator.technique().ok_or_else(|| samples_from_distribution(estimator))?;
        let count = self.count.ok_or_else(|| {
            StageError::content_with_hint(
                "`with` gives a distribution, and `count` is missing",
                "set `count` to the directions of each pixel, or `limit: true`",
            )
        })?;
        if technique == Technique::Map && distribution.is_some_and(Distribution::is_compensated) {
            job.warn("the distribution is compensated: part of the sphere is never drawn, and the estimate is biased; use `mis-balance` or `mis-power`");
        }
        let usual = if matches!(technique, Technique::Balance | Technique::Power) { InPixel::SolidAngle } else { InPixel::Center };
        let (warp, place) = (self.warp.unwrap_or_default().into(), self.in_pixel.unwrap_or(usual).into());
        let sampler = distribution.map(|distribution| Sampler::new(distribution, warp, place, || job.check()));
        let sampler = sampler.transpose().map_err(|error: SamplingError<StageError>| sampling_error(error))?;
        let drawing = Drawing {
            map: env,
            sampler: sampler.as_ref(),
            lobe,
            technique,
            arrangement: self.method.unwrap_or_default().arrangement(),
            count: count.get() as usize,
            seed: job.seed(self.seed),
            is_shared: self.points == Some(PointSharing::Shared),
        };
        drawing.relight(self.points(), self.rgb(), || job.check())
    }

    /// Whether radiance is estimated: not for what shows the map or the normals themselves.
    fn is_shaded(&self) -> bool {
        matches!(self.view, View::Diffuse | View::Glossy)
    }

    /// Fields that the view or the estimator does not read.
    fn fields_without_meaning(&self) -> Vec<Mistake> {
        let is_shaded = self.is_shaded();
        let is_by_map = matches!(self.estimator, Some(Estimator::Exact | Estimator::Sh9));
        let is_by_lobe = self.estimator == Some(Estimator::LobeWeighted);
        let is_combined = matches!(self.estimator, Some(Estimator::MisBalance | Estimator::MisPower));
        let estimates = self.estimator.is_none_or(|estimator| estimator.of_samples().is_some());
        let of_glossy = self
            .estimator
            .is_none_or(|estimator| estimator.technique().is_some() || matches!(estimator, Estimator::Lights | Estimator::Exact));
        let draws = self.estimator.is_none_or(|estimator| estimator.technique().is_some());
        let (is_drawn, alone) = (self.count.is_some(), "is for pixels that draw for themselves: with `count` alone");
        let is_inside = self.in_pixel.is_some_and(|place| place == InPixel::Center);
        let unread = [
            ("estimator", !is_shaded && self.estimator.is_some(), "is for the views `diffuse` and `glossy` alone"),
            ("estimator", self.view == View::Glossy && !of_glossy, "of this kind is for `view: diffuse` alone"),
            ("albedo", !is_shaded && self.albedo.is_some(), "is for the views `diffuse` and `glossy` alone"),
            ("with", !is_shaded && self.with.is_some(), "is for the views `diffuse` and `glossy` alone"),
            ("with", is_shaded && is_by_map && self.with.is_some(), "is not read: this estimator uses every pixel of `env`"),
            ("with", is_by_lobe && self.with.is_some(), "is not read: this estimator draws by the lobe"),
            ("lobe", self.view != View::Glossy && self.lobe.is_some(), "is for `view: glossy` alone"),
            ("limit", self.limit && !(is_shaded && estimates), "is for the estimators of samples alone"),
            ("count", self.limit && is_drawn, "is not read: a limit has no number of samples"),
            (
                "count",
                is_drawn && !self.limit && !(is_shaded && draws),
                "is for estimators that draw directions: `pdf-weighted`, `lobe-weighted` and combinations",
            ),
            ("method", !is_drawn && self.method.is_some(), alone),
            ("points", !is_drawn && self.points.is_some(), alone),
            ("seed", !is_drawn && self.seed.0.is_some(), alone),
            ("warp", (!is_drawn || is_by_lobe) && self.warp.is_some(), "is for pixels that draw by a distribution alone"),
            ("in_pixel", (!is_drawn || is_by_lobe) && self.in_pixel.is_some(), "is for pixels that draw by a distribution alone"),
            ("in_pixel", is_combined && is_inside, "must not be `center` for a combination, which needs a density at every direction"),
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

    fn missing_field(&self) -> Option<Mistake> {
        let mistake = |field: &str, message: &str, hint: &str| {
            Some(Mistake { field: field.into(), message: message.into(), hint: Some(hint.into()) })
        };
        let is_by_lobe = self.estimator == Some(Estimator::LobeWeighted);
        let is_combined = matches!(self.estimator, Some(Estimator::MisBalance | Estimator::MisPower));
        let needs_no_port = is_by_lobe || matches!(self.estimator, Some(Estimator::Exact | Estimator::Sh9));
        let needs_env = match self.view {
            View::Diffuse | View::Glossy => needs_no_port || self.count.is_some() || self.limit,
            View::Mirror => true,
            View::Normal => false,
        };
        if needs_env && self.env.is_none() {
            return mistake("env", "`env` is missing: the sphere shows a map", "set `env` to a stage that gives an envmap");
        }
        if self.is_shaded() && !needs_no_port && self.with.is_none() {
            let hint = "set `with` to a stage that gives samples, lights or a distribution, or `estimator: exact`";
            return mistake("with", "`with` is missing: there is nothing to estimate with", hint);
        }
        if self.view == View::Glossy && self.lobe.is_none() {
            return mistake(
                "lobe",
                "`lobe` is missing: a glossy sphere needs the shape of its reflection",
                "set `lobe: { phong: { exponent: 32 } }`",
            );
        }
        if (is_by_lobe || is_combined) && self.is_shaded() && self.count.is_none() {
            return mistake("count", "`count` is missing: this estimator draws directions", "set `count` to the directions of each pixel");
        }
        if is_combined && self.count.is_some_and(|count| count.get() < 2) {
            return mistake("count", "a combination of two techniques needs at least 2 directions", "set `count: 2` or more");
        }
        None
    }
}

fn check_distribution(distribution: &Distribution, env: &EnvMap) -> Result<(), RelightError> {
    let (drawn, map) = ([distribution.width(), distribution.height()], [env.width(), env.height()]);
    if drawn == map { Ok(()) } else { Err(RelightError::OtherDistribution { drawn, map }) }
}

/// Relative error that is worth a word.
const NOTABLE_ERROR: f64 = 0.01;

fn warn_of_narrow_lobe(env: &EnvMap, lobe: Lobe, job: &Job<'_>) {
    let error = reflected::error_of_centers(env, lobe);
    if lobe != Lobe::Diffuse && error > NOTABLE_ERROR {
        let percent = 100.0 * error;
        job.warn(format!(
            "the lobe is narrow beside a pixel of the map: the sum over pixel centers errs by up to {percent:.0} % of a bright pixel's light; load a map of more pixels"
        ));
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

fn other_from_samples(estimator: Estimator) -> StageError {
    let hint = match estimator {
        Estimator::Lights => "set `with` to a `median-cut` stage, or `estimator: pdf-weighted`",
        _ => "set `with` to a `distribution` stage, or `estimator: pdf-weighted`",
    };
    StageError::content_with_hint(format!("`estimator: {}` cannot be had from samples, which `with` gives", estimator.name()), hint)
}

fn samples_from_distribution(estimator: Estimator) -> StageError {
    StageError::content_with_hint(
        format!("`estimator: {}` needs a set of samples, `with` gives a distribution", estimator.name()),
        "set `with` to a `sample` stage, or `limit: true` for what the estimator tends to",
    )
}

fn needs_distribution() -> StageError {
    StageError::content_with_hint(
        "`limit` and `count` are for a distribution in `with`",
        "set `with` to a `distribution` stage, or remove them",
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
        serde_yaml::with::singleton_map_recursive::deserialize(serde_yaml::Deserializer::from_str(yaml)).unwrap()
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
            "{ env: e, with: d, count: 16, method: sobol, warp: hierarchical, points: shared, seed: 3 }",
            "{ env: e, with: d, estimator: equal-weight, limit: true }",
            "{ env: e, with: d, estimator: mis-power, count: 16, in_pixel: uv }",
            "{ env: e, estimator: lobe-weighted, count: 1 }",
            "{ env: e, view: glossy, lobe: { phong: { exponent: 32 } }, estimator: exact }",
            "{ env: e, with: l, view: glossy, lobe: { ggx: { alpha: 0.25 } } }",
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
            ("{ env: e, with: d, method: sobol, warp: alias, seed: 3 }", vec!["method", "seed", "warp"]),
            ("{ env: e, with: d, estimator: mis-balance, count: 8, in_pixel: center }", vec!["in_pixel"]),
            ("{ env: e, with: d, estimator: mis-balance, count: 1 }", vec!["count"]),
            ("{ env: e, with: d, estimator: mis-balance }", vec!["count"]),
            ("{ with: d, count: 8 }", vec!["env"]),
            ("{ env: e, with: d, estimator: equal-weight, limit: true, count: 8 }", vec!["count"]),
            ("{ env: e, estimator: exact, limit: true }", vec!["limit"]),
            ("{ env: e, with: s, view: glossy }", vec!["lobe"]),
            ("{ env: e, with: s, view: glossy, lobe: { phong: { exponent: 4 } }, estimator: equal-weight }", vec!["estimator"]),
            ("{ env: e, with: s, lobe: { phong: { exponent: 4 } } }", vec!["lobe"]),
            ("{ env: e, with: d, estimator: lobe-weighted, count: 4 }", vec!["with"]),
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

//! The kind `assemble`; the mathematics is in `image::assembly`.

use std::borrow::Cow;
use std::num::NonZeroU32;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Deserializer, Serialize, Serializer, de};

use crate::engine::artifact::{AnyArtifact, Artifact};
use crate::engine::job::{Collected, Job};
use crate::engine::parameter::{InputFile, Ports};
use crate::engine::stage::{InputSizes, Mistake, ResultDeclaration, Stage, StageError};
use crate::figure::table::{Cell, Column, Table};
use crate::formats::{self, Content, Limits};
use crate::image::assembly::response::{self, Recovery};
use crate::image::assembly::{self, Assembled, AssemblyError, Exposure, Exposures, Response, Settings, Weighting};
use crate::image::raster::{Image, Picture, PictureSamples, Plane, Raster};
use crate::math::elementary;
use crate::stages::plot::with_axes_of_fields;
use crate::stages::rasters::LinearOrPicture;

/// Puts photographs with different exposure times together into one image of linear light.
///
/// Either `files` names the photographs with their times, or `of` takes them from other stages and `seconds` says which
/// axis holds the times. Where a photograph has alpha 0, so has the image. ln E is the mean of ln X(z) - ln t over the exposures, weighted by the code z; X is the response
/// (Debevec & Malik 1997, equation 6). A radiance of 1 is what is just white in one second. Each channel is
/// taken by itself; pixels that no exposure shows well are bounds, and are counted in a warning. `.response` is the
/// recovered curve (empty if none was asked for), `.range` one row: how many exposures, saturated and black pixels, and the
/// dynamic range.
///
/// ```yaml
/// env-ball:
///   assemble:
///     files: [{ path: ball-1s.png, seconds: 1 }, { path: ball-4s.png, seconds: 4 }]
///     response: recovered
///   save: exr
/// ```
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Assemble {
    /// The photographs as files, with their times.
    #[serde(default)]
    pub files: Vec<Photograph>,
    /// The photographs from other stages: pictures, or images whose values are codes from 0 to 1.
    #[serde(default)]
    pub of: Option<Ports<LinearOrPicture>>,
    /// For `of`: the axis whose value, or `axis.field` whose content, is the exposure time of each photograph in seconds.
    #[serde(default)]
    pub seconds: Option<String>,
    /// The axes that are put together; by default all. The others remain axes of the stage.
    #[serde(default)]
    pub over: Option<Vec<String>>,
    /// What light a code stands for: `srgb`, `linear`, a number from 0.1 to 10 (code to that power), or `recovered` from the
    /// photographs. By default `srgb` for pictures and `linear` for images.
    #[serde(default)]
    pub response: Option<ResponseChoice>,
    /// How much a code counts by its distance from black and white.
    #[serde(default)]
    pub weighting: Weighting,
    /// Codes below are not used; a share of the largest code. Default 0.005, the coursework's.
    #[serde(default = "usual_least")]
    #[schemars(range(min = 0, max = 1))]
    pub ignore_below: f64,
    /// Codes above are not used; a share of the largest code. Default 0.92, the coursework's.
    #[serde(default = "usual_greatest")]
    #[schemars(range(min = 0, max = 1))]
    pub ignore_above: f64,
    /// For `response: recovered`: weight of a smooth curve against one that follows every photograph (lambda of Debevec &
    /// Malik), for as many observations as there are codes. Default 10; more for noisy photographs.
    #[serde(default)]
    #[schemars(range(max = 1e6), extend("exclusiveMinimum" = 0))]
    pub smoothness: Option<f64>,
    /// For `response: recovered`: how many pixels are used, on an even lattice. Default 2000.
    #[serde(default)]
    #[schemars(range(max = 1_000_000))]
    pub pixel_count: Option<NonZeroU32>,
}

/// One photograph.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Photograph {
    /// The file: PNG or PPM; or PFM, HDR, EXR, NPY with codes from 0 to 1.
    pub path: InputFile,
    /// Its exposure time.
    #[schemars(extend("exclusiveMinimum" = 0, "x-unit" = "s"))]
    pub seconds: f64,
}

/// What light codes stand for, as it is asked for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ResponseChoice {
    /// The curve of IEC 61966-2-1.
    Srgb,
    /// Codes are proportional to light.
    Linear,
    /// Found from the photographs (Debevec & Malik 1997).
    Recovered,
    /// Light is code to this power.
    Gamma(f64),
}

const GAMMA_RANGE: [f64; 2] = [0.1, 10.0];

fn usual_least() -> f64 {
    0.005
}

fn usual_greatest() -> f64 {
    0.92
}

impl Serialize for ResponseChoice {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Srgb => serializer.serialize_str("srgb"),
            Self::Linear => serializer.serialize_str("linear"),
            Self::Recovered => serializer.serialize_str("recovered"),
            Self::Gamma(gamma) => serializer.serialize_f64(*gamma),
        }
    }
}

impl<'de> Deserialize<'de> for ResponseChoice {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Forms;

        impl de::Visitor<'_> for Forms {
            type Value = ResponseChoice;

            fn expecting(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                let [least, greatest] = GAMMA_RANGE;
                write!(out, "a number from {least} to {greatest}, `srgb`, `linear` or `recovered`")
            }

            fn visit_f64<E: de::Error>(self, value: f64) -> Result<ResponseChoice, E> {
                let is_possible = (GAMMA_RANGE[0]..=GAMMA_RANGE[1]).contains(&value);
                if is_possible { Ok(ResponseChoice::Gamma(value)) } else { Err(E::invalid_value(de::Unexpected::Float(value), &self)) }
            }

            fn visit_u64<E: de::Error>(self, value: u64) -> Result<ResponseChoice, E> {
                self.visit_f64(value as f64)
            }

            fn visit_i64<E: de::Error>(self, value: i64) -> Result<ResponseChoice, E> {
                self.visit_f64(value as f64)
            }

            fn visit_str<E: de::Error>(self, word: &str) -> Result<ResponseChoice, E> {
                match word {
                    "srgb" => Ok(ResponseChoice::Srgb),
                    "linear" => Ok(ResponseChoice::Linear),
                    "recovered" => Ok(ResponseChoice::Recovered),
                    _ => Err(E::invalid_value(de::Unexpected::Str(word), &self)),
                }
            }
        }

        deserializer.deserialize_any(Forms)
    }
}

impl JsonSchema for ResponseChoice {
    fn inline_schema() -> bool {
        true
    }

    fn schema_name() -> Cow<'static, str> {
        "ResponseChoice".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        let [least, greatest] = GAMMA_RANGE;
        json_schema!({
            "anyOf": [
                { "type": "number", "minimum": least, "maximum": greatest },
                { "const": "srgb" },
                { "const": "linear" },
                { "const": "recovered" },
            ],
        })
    }
}

impl Stage for Assemble {
    const KIND: &'static str = "assemble";
    const VERSION: u32 = 1;
    const RESULTS: &'static [ResultDeclaration] = &[
        ResultDeclaration { name: "", types: &[Image::TYPE] },
        ResultDeclaration { name: "response", types: &[Table::TYPE] },
        ResultDeclaration { name: "range", types: &[Table::TYPE] },
    ];
    type Output = Vec<AnyArtifact>;

    fn mistakes(&self) -> Vec<Mistake> {
        let is_recovered = self.response == Some(ResponseChoice::Recovered);
        let rules = [
            (self.files.is_empty() && self.of.is_none(), "files", "there are no photographs", "set `files`, or `of` and `seconds`"),
            (!self.files.is_empty() && self.of.is_some(), "of", "`files` and `of` both name the photographs", "remove one of them"),
            (self.files.len() == 1, "files", "one exposure has no more range than itself", "name two or more with different times"),
            (
                self.of.is_some() && self.seconds.is_none(),
                "of",
                "the exposure times are missing",
                "set `seconds` to the axis, or to the `axis.field`, that holds them",
            ),
            (
                self.of.is_none() && self.seconds.is_some(),
                "seconds",
                "`seconds` names an axis of `of`, which is not set",
                "write the times of `files` beside their paths",
            ),
            (self.of.is_none() && self.over.is_some(), "over", "`over` is for photographs from other stages", "remove `over`"),
            (self.ignore_below >= self.ignore_above, "ignore_below", "no code is between `ignore_below` and `ignore_above`", "lower it"),
            (
                self.smoothness.is_some() && !is_recovered,
                "smoothness",
                "only a recovered response is smoothed",
                "set `response: recovered`",
            ),
            (
                self.pixel_count.is_some() && !is_recovered,
                "pixel_count",
                "only a recovered response is found from single pixels",
                "set `response: recovered`",
            ),
        ];
        let broken = rules.into_iter().filter(|(is_broken, ..)| *is_broken);
        let mistake = |(_, field, message, hint): (bool, &str, &str, &str)| Mistake {
            field: field.into(),
            message: message.into(),
            hint: Some(hint.into()),
        };
        broken.map(mistake).chain(self.impossible_times()).collect()
    }

    fn axes_used(&self) -> Option<Vec<String>> {
        Some(with_axes_of_fields(self.seconds.iter().cloned().collect()))
    }

    /// Every photograph in f32, and the result.
    fn memory(&self, inputs: &InputSizes) -> u64 {
        5 * inputs.values().sum::<u64>()
    }

    fn run(&self, job: &Job<'_>) -> Result<Vec<AnyArtifact>, StageError> {
        let (photographs, is_linear) = self.photographs(job)?;
        let exposures = Exposures::new(photographs)?;
        let response = self.response(&exposures, is_linear, job)?;
        let (ignore_below, ignore_above) = (self.ignore_below, self.ignore_above);
        let settings = Settings { weighting: self.weighting, ignore_below, ignore_above, response };
        let assembled = assembly::assemble(&exposures, &settings, || job.check())?;
        warn(&assembled, &exposures, job);
        let range = range_table(&assembled, &exposures);
        let image = Image { alpha: assembled.alpha, ..Image::opaque(assembled.radiance) };
        Ok(vec![AnyArtifact::new(image), AnyArtifact::new(response_table(&settings.response)), AnyArtifact::new(range)])
    }
}

impl Assemble {
    fn impossible_times(&self) -> Option<Mistake> {
        let first = self.files.first()?.seconds;
        let is_recovered = self.response == Some(ResponseChoice::Recovered);
        let all_alike = is_recovered && self.files.len() > 1 && self.files.iter().all(|file| file.seconds == first);
        all_alike.then(|| Mistake {
            field: "files".into(),
            message: format!("all exposure times are `{first}`, which tells nothing of the response"),
            hint: Some("take exposures one or two stops apart".into()),
        })
    }

    /// The photographs, and whether all of them are images of linear values.
    fn photographs(&self, job: &Job<'_>) -> Result<(Vec<Exposure>, bool), StageError> {
        let mut photographs = Vec::new();
        let mut is_linear = true;
        for file in &self.files {
            job.check()?;
            let name = file.path.0.file_name().unwrap_or_default().to_string_lossy().into_owned();
            let decoded = formats::read(&job.read(&file.path)?, &name, &Limits::default()).map_err(StageError::content)?;
            let (codes, alpha) = match decoded.content {
                Content::Linear(image) => (image.color, image.alpha),
                Content::Display(picture) => {
                    is_linear = false;
                    (codes(&picture), alpha(&picture))
                }
            };
            photographs.push(Exposure { name: format!("`{}`", formats::escaped(&name)), codes, alpha, seconds: file.seconds });
        }
        let collected = self.of.iter().flat_map(|ports| job.collected(ports));
        for input in collected {
            job.check()?;
            let input = input?;
            let (name, seconds) = (name_of(&input), self.time_of(&input)?);
            let (codes, alpha) = match input.value {
                LinearOrPicture::Linear(image) => (image.color.clone(), image.alpha.clone()),
                LinearOrPicture::Picture(picture) => {
                    is_linear = false;
                    (codes(&picture), alpha(&picture))
                }
            };
            photographs.push(Exposure { name, codes, alpha, seconds });
        }
        Ok((photographs, is_linear))
    }

    fn time_of(&self, input: &Collected<'_, LinearOrPicture>) -> Result<f64, StageError> {
        let column = self.seconds.as_deref().unwrap_or_default();
        let Some((_, value)) = input.columns.iter().find(|(name, _)| name == column) else {
            let known: Vec<String> = input.columns.iter().map(|(name, _)| format!("`{name}`")).collect();
            let known = if known.is_empty() { "it has none".to_owned() } else { format!("it has {}", known.join(", ")) };
            return Err(StageError::content_with_hint(
                format!("{} has no axis or field `{column}` with its exposure time ({known})", name_of(input)),
                "set `seconds` to the one that holds the times",
            ));
        };
        value.number().ok_or_else(|| StageError::content(format!("the exposure time `{value}` of {} is not a number", name_of(input))))
    }

    fn response(&self, exposures: &Exposures, is_linear: bool, job: &Job<'_>) -> Result<Response, StageError> {
        let usual = if is_linear { ResponseChoice::Linear } else { ResponseChoice::Srgb };
        Ok(match self.response.unwrap_or(usual) {
            ResponseChoice::Srgb => Response::Srgb,
            ResponseChoice::Linear => Response::Linear,
            ResponseChoice::Gamma(gamma) => Response::Gamma(gamma),
            ResponseChoice::Recovered => {
                let pixel_count = self.pixel_count.map_or(2000, |count| count.get() as usize);
                let recovery = Recovery { pixel_count, smoothness: self.smoothness.unwrap_or(10.0) };
                let curves = response::recover(exposures, &recovery, || job.check())?;
                for (curve, channel) in curves.iter().zip(["red", "green", "blue"]) {
                    if let Some(code) = curve.first_fall() {
                        job.warn(format!("the recovered response of {channel} does not rise at code {code}; raise `smoothness`"));
                    }
                }
                Response::Recovered(Box::new(curves))
            }
        })
    }
}

/// Codes over the largest code.
fn codes(picture: &Picture) -> Raster {
    let pixels = match &picture.samples {
        PictureSamples::Eight(samples) => samples.iter().map(|pixel| pixel.map(|code| f32::from(code) / 255.0)).collect(),
        PictureSamples::Sixteen(samples) => samples.iter().map(|pixel| pixel.map(|code| f32::from(code) / 65_535.0)).collect(),
    };
    Raster::new(picture.width, picture.height, pixels)
}

/// Where a picture shows something: only whether alpha is 0 counts.
fn alpha(picture: &Picture) -> Option<Plane> {
    let alpha = picture.alpha.as_ref()?;
    Some(Plane { width: picture.width, height: picture.height, values: alpha.iter().map(|alpha| f32::from((*alpha).min(1))).collect() })
}

/// `shot[seconds=0.5]`.
fn name_of<T>(input: &Collected<'_, T>) -> String {
    let columns: Vec<String> =
        input.columns.iter().filter(|(name, _)| !name.contains('.')).map(|(name, value)| format!("{name}={value}")).collect();
    let coordinate = if columns.is_empty() { String::new() } else { format!("[{}]", columns.join(",")) };
    format!("`{}{coordinate}`", input.label)
}

fn warn(assembled: &Assembled, exposures: &Exposures, job: &Job<'_>) {
    let count = assembled.radiance.pixels().len();
    let share = |part: u64| 100.0 * part as f64 / count as f64;
    let times = exposures.as_slice();
    let (shortest, longest) = (&times[0], &times[times.len() - 1]);
    if assembled.saturated_count > 0 {
        job.warn(format!(
            "{} pixels ({:.2} %) are saturated or hidden even in the shortest exposure that shows them: their radiance is the least it can be; \
             the shortest is {} with {} s",
            assembled.saturated_count,
            share(assembled.saturated_count),
            shortest.name,
            shortest.seconds
        ));
    }
    if assembled.black_count > 0 {
        job.warn(format!(
            "{} pixels ({:.2} %) are black in every exposure; the longest is {} with {} s",
            assembled.black_count,
            share(assembled.black_count),
            longest.name,
            longest.seconds
        ));
    }
}

/// One row for each of the 256 codes of a recovered response, none for others.
fn response_table(response: &Response) -> Table {
    let columns = [("code", ""), ("r", ""), ("g", ""), ("b", "")];
    let mut table = Table::new(columns.map(|(name, unit)| Column::new(name, unit)).to_vec());
    let Response::Recovered(curves) = response else { return table };
    for code in 0..response::KNOT_COUNT {
        let values = curves.iter().map(|curve| Cell::Number(curve.knots()[code]));
        table.push(std::iter::once(Cell::Integer(code as i128)).chain(values).collect());
    }
    table
}

fn range_table(assembled: &Assembled, exposures: &Exposures) -> Table {
    let columns = [
        ("exposures", ""),
        ("saturated_pixels", ""),
        ("black_pixels", ""),
        ("least_luminance", ""),
        ("greatest_luminance", ""),
        ("dynamic_range", ""),
        ("dynamic_range_stops", "stops"),
    ];
    let mut table = Table::new(columns.map(|(name, unit)| Column::new(name, unit)).to_vec());
    let numbers = match assembled.range {
        Some([least, greatest]) if least > 0.0 => [least, greatest, greatest / least, elementary::log2(greatest / least)].map(Cell::Number),
        _ => [const { Cell::Empty }; 4],
    };
    let counts = [exposures.as_slice().len() as u64, assembled.saturated_count, assembled.black_count];
    table.push(counts.map(|count| Cell::Integer(i128::from(count))).into_iter().chain(numbers).collect());
    table
}

impl From<AssemblyError> for StageError {
    fn from(error: AssemblyError) -> Self {
        Self::content(error)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stages::rasters::trial;

    fn picture(codes: &[u8]) -> AnyArtifact {
        let samples = PictureSamples::Eight(codes.iter().map(|code| [*code; 3]).collect());
        AnyArtifact::new(Picture { width: codes.len(), height: 1, samples, alpha: None })
    }

    #[test]
    fn photographs_without_times_and_fields_without_meaning_are_mistakes() {
        let mistakes = |text: &str| trial::mistakes::<Assemble>(text);
        assert!(mistakes("{}")[0].contains("there are no photographs"));
        assert!(mistakes("{ of: [a] }")[0].contains("times are missing"));
        assert!(mistakes("{ files: [{ path: a.png, seconds: 1 }] }")[0].contains("one exposure"));
        let two = "files: [{ path: a.png, seconds: 1 }, { path: b.png, seconds: 1 }]";
        assert!(mistakes(&format!("{{ {two}, response: recovered }}"))[0].contains("all exposure times are `1`"));
        assert_eq!(mistakes(&format!("{{ {two}, seconds: t, over: [t], of: [a] }}")).len(), 1);
        assert_eq!(mistakes(&format!("{{ {two}, seconds: t, over: [t] }}")).len(), 2);
        assert_eq!(mistakes(&format!("{{ {two}, smoothness: 3, pixel_count: 4, ignore_below: 0.95 }}")).len(), 3);
    }

    #[test]
    fn a_missing_column_is_told_with_those_that_are_there() {
        let (result, _) = trial::run::<Assemble>("{ of: [a], seconds: t }", [("a", vec![picture(&[128]), picture(&[20])])]);
        let message = result.unwrap_err().to_string();
        assert!(message.contains("`input` has no axis or field `t`") && message.contains("it has none"), "{message}");
    }

    #[test]
    fn a_response_is_a_word_or_a_number() {
        for (text, expected) in [
            ("srgb", ResponseChoice::Srgb),
            ("recovered", ResponseChoice::Recovered),
            ("2.2", ResponseChoice::Gamma(2.2)),
            ("1", ResponseChoice::Gamma(1.0)),
        ] {
            let found: ResponseChoice = serde_yaml::from_str(text).unwrap();
            assert_eq!(found, expected);
            assert_eq!(serde_yaml::from_value::<ResponseChoice>(serde_yaml::to_value(found).unwrap()).unwrap(), expected);
        }
        for text in ["0", "rgb", "-2"] {
            assert!(serde_yaml::from_str::<ResponseChoice>(text).unwrap_err().to_string().contains("`recovered`"), "{text}");
        }
    }
}

//! The kind `mark`.

use std::borrow::Cow;
use std::fmt;
use std::sync::Arc;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::de::{Error, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::engine::artifact::{AnyArtifact, TypeName};
use crate::engine::job::Job;
use crate::engine::parameter::{Accepts, Port};
use crate::engine::stage::{InputTypes, Mistake, ResultDeclaration, Stage, StageError};
use crate::image::drawing::{Canvas, Rectangle};
use crate::image::raster::{Image, Picture};
use crate::light::envmap::EnvMap;
use crate::light::lights::{Light, LightSet, Region};
use crate::light::samples::{Frame, Sample};
use crate::stages::relight::Illumination;

/// Marks samples or lights on a map: a block for each, and the edges of the lights' regions.
///
/// The result is of the same sort as what is marked: linear for a map or an image, encoded for a picture.
///
/// ```yaml
/// on-map: { mark: { on: picture, at: samples, size: 5, color: blue }, save: png }
/// ```
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Mark {
    /// What is marked; as large as the map that was sampled or cut.
    pub on: Port<Surface>,
    /// Where the marks are.
    pub at: Port<Illumination>,
    /// Side of a block in pixels, odd. Default 5, the coursework's.
    #[serde(default = "usual_size")]
    #[schemars(range(min = 1, max = 255), extend("x-unit" = "px"))]
    pub size: u32,
    /// Color of the blocks, by name or as `[r, g, b]` in the values of what is marked, 0 to 1 on a picture. Default `blue`.
    #[serde(default)]
    pub color: Color,
    /// What is shown. Default `over`.
    #[serde(default)]
    pub show: Show,
    /// Whether the edges of the lights' regions are drawn, one pixel wide. By default they are where `show` is `over`.
    #[serde(default)]
    pub regions: Option<bool>,
    /// Color of the edges. Default `white`.
    #[serde(default = "usual_edge_color")]
    pub edge_color: Color,
}

fn usual_size() -> u32 {
    5
}

fn usual_edge_color() -> Color {
    Color::Named("white")
}

/// What is shown.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Show {
    /// Blocks of one color over what is marked.
    #[default]
    Over,
    /// Black, but for a window around each mark that shows what was there.
    SamplesOnly,
    /// Black, but for a block at each light of its RGB irradiance (radiance times solid angle, summed over
    /// its region). For lights on linear maps and images.
    RadianceAtCentroid,
}

/// Names and values of the colors that can be asked for by name.
const NAMED: [(&str, [f32; 3]); 9] = [
    ("black", [0.0, 0.0, 0.0]),
    ("white", [1.0, 1.0, 1.0]),
    ("gray", [0.5, 0.5, 0.5]),
    ("red", [1.0, 0.0, 0.0]),
    ("green", [0.0, 1.0, 0.0]),
    ("blue", [0.0, 0.0, 1.0]),
    ("yellow", [1.0, 1.0, 0.0]),
    ("cyan", [0.0, 1.0, 1.0]),
    ("magenta", [1.0, 0.0, 1.0]),
];

/// A color by name, or red, green and blue.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Color {
    /// One of the named colors.
    Named(&'static str),
    /// Not negative; above 1 is brighter than white on a linear map, and white on a picture.
    Rgb([f32; 3]),
}

impl Default for Color {
    fn default() -> Self {
        Color::Named("blue")
    }
}

impl Color {
    fn rgb(self) -> [f32; 3] {
        match self {
            Color::Named(name) => NAMED.iter().find(|(known, _)| *known == name).expect("only known names are read").1,
            Color::Rgb(rgb) => rgb,
        }
    }
}

impl Serialize for Color {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Color::Named(name) => name.serialize(serializer),
            Color::Rgb(rgb) => rgb.serialize(serializer),
        }
    }
}

impl<'de> Deserialize<'de> for Color {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Forms;

        impl<'de> Visitor<'de> for Forms {
            type Value = Color;

            fn expecting(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
                out.write_str("the name of a color or a list of three numbers")
            }

            fn visit_str<E: Error>(self, name: &str) -> Result<Color, E> {
                match NAMED.iter().find(|(known, _)| *known == name) {
                    Some((known, _)) => Ok(Color::Named(known)),
                    None => Err(E::custom(format!("`{name}` is no known color; choose one of {}", NAMED.map(|(name, _)| name).join(", ")))),
                }
            }

            fn visit_seq<A: SeqAccess<'de>>(self, sequence: A) -> Result<Color, A::Error> {
                <[f32; 3]>::deserialize(serde::de::value::SeqAccessDeserializer::new(sequence)).map(Color::Rgb)
            }
        }

        deserializer.deserialize_any(Forms)
    }
}

impl JsonSchema for Color {
    fn inline_schema() -> bool {
        true
    }

    fn schema_name() -> Cow<'static, str> {
        "Color".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({
            "anyOf": [
                { "type": "string", "enum": NAMED.map(|(name, _)| name) },
                { "type": "array", "items": { "type": "number", "minimum": 0, "maximum": f32::MAX }, "minItems": 3, "maxItems": 3 },
            ],
        })
    }
}

/// What can be marked.
#[derive(Debug, Clone)]
pub enum Surface {
    /// A map.
    EnvMap(Arc<EnvMap>),
    /// A linear image.
    Image(Arc<Image>),
    /// A display picture.
    Picture(Arc<Picture>),
}

impl Accepts for Surface {
    const TYPES: &'static [TypeName] = &["envmap", "image", "picture"];
    type Value = Self;

    fn take(artifact: AnyArtifact) -> Option<Self> {
        let image = || artifact.get().map(Self::Image);
        let picture = || artifact.get().map(Self::Picture);
        artifact.get().map(Self::EnvMap).or_else(image).or_else(picture)
    }
}

impl Stage for Mark {
    const KIND: &'static str = "mark";
    const VERSION: u32 = 1;
    const RESULTS: &'static [ResultDeclaration] = &[ResultDeclaration { name: "", types: Surface::TYPES }];
    type Output = Vec<AnyArtifact>;

    fn result_types(&self, inputs: &InputTypes) -> Vec<Vec<TypeName>> {
        vec![inputs.get("on").map_or_else(|| Surface::TYPES.to_vec(), |on| vec![*on])]
    }

    fn mistakes(&self) -> Vec<Mistake> {
        if self.size % 2 == 1 {
            return Vec::new();
        }
        let message = format!("`size: {}` is even, so a block has no pixel in its middle", self.size);
        vec![Mistake { field: "size".into(), message, hint: Some(format!("write `size: {}`", self.size + 1)) }]
    }

    fn run(&self, job: &Job<'_>) -> Result<Self::Output, StageError> {
        let at = job.input(&self.at)?;
        let marked = match job.input(&self.on)? {
            Surface::EnvMap(map) => AnyArtifact::new(EnvMap { raster: self.marked(&map.raster, &at, Values::Linear)?, angles: map.angles }),
            Surface::Image(image) => AnyArtifact::new(self.marked(&*image, &at, Values::Linear)?),
            Surface::Picture(picture) => AnyArtifact::new(self.marked(&*picture, &at, Values::Encoded)?),
        };
        Ok(vec![marked])
    }
}

/// Whether pixels are linear radiance or encoded for a display.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Values {
    Linear,
    Encoded,
}

impl Mark {
    fn marked<C: Canvas>(&self, original: &C, at: &Illumination, values: Values) -> Result<C, StageError> {
        check_size(original.size(), at)?;
        let blocks: Vec<Rectangle> =
            pixels(original.size(), at)?.into_iter().map(|[x, y]| Rectangle::around(x, y, self.size as usize)).collect();
        let mut canvas = if self.show == Show::Over { original.clone() } else { original.blackened() };

        // Windows lie under the edges, so that no copy hides a line; blocks of color lie over them.
        if self.show == Show::SamplesOnly {
            blocks.iter().for_each(|block| canvas.copy(original, *block));
        }
        if self.regions.unwrap_or(self.show == Show::Over) {
            regions(at).for_each(|region| canvas.outline(rectangle(region), 1, self.edge_color.rgb()));
        }
        match self.show {
            Show::Over => blocks.iter().for_each(|block| canvas.fill(*block, self.color.rgb())),
            Show::SamplesOnly => {}
            Show::RadianceAtCentroid => {
                let colors = irradiances(at, values)?;
                blocks.iter().zip(colors).for_each(|(block, color)| canvas.fill(*block, color));
            }
        }
        Ok(canvas)
    }
}

/// That pixels of the sampled or cut map are pixels of what is marked.
fn check_size((width, height): (usize, usize), at: &Illumination) -> Result<(), StageError> {
    let (name, map_width, map_height) = match at {
        Illumination::Samples(set) => ("samples", set.map_width, set.map_height),
        Illumination::Lights(set) => ("lights", set.map_width, set.map_height),
    };
    // Samples that come from no map lie on the unit square, which any picture can show.
    if map_width == 0 || (map_width as usize, map_height as usize) == (width, height) {
        return Ok(());
    }
    Err(StageError::content_with_hint(
        format!("the {name} belong to a map of `{map_width}x{map_height}`, `on` has `{width}x{height}`"),
        "mark the map that was sampled or cut, or a picture of it of the same size",
    ))
}

/// The pixel of each mark.
fn pixels((width, height): (usize, usize), at: &Illumination) -> Result<Vec<[usize; 2]>, StageError> {
    let pixel = |x: f64, y: f64| [(x as usize).min(width - 1), (y as usize).min(height - 1)];
    match at {
        Illumination::Lights(set) => Ok(set.lights.iter().map(|light| pixel(light.x, light.y)).collect()),
        Illumination::Samples(set) if set.frame == Frame::Normal => Err(StageError::content_with_hint(
            "samples about a normal have no place on the map",
            "set `at` to samples with `method: uniform` or drawn from a distribution",
        )),
        Illumination::Samples(set) => {
            let of_sample = |sample: &Sample| match set.map_width {
                0 => pixel(sample.u * width as f64, sample.v * height as f64),
                _ => pixel(f64::from(sample.x), f64::from(sample.y)),
            };
            Ok(set.samples.iter().map(of_sample).collect())
        }
    }
}

fn regions(at: &Illumination) -> impl Iterator<Item = Region> + '_ {
    let lights: &[Light] = match at {
        Illumination::Samples(_) => &[],
        Illumination::Lights(set) => &set.lights,
    };
    lights.iter().map(|light| light.region)
}

fn rectangle(Region { x0, y0, x1, y1 }: Region) -> Rectangle {
    Rectangle { x0: x0 as usize, y0: y0 as usize, x1: x1 as usize, y1: y1 as usize }
}

fn irradiances(at: &Illumination, values: Values) -> Result<Vec<[f32; 3]>, StageError> {
    let (Illumination::Lights(set), Values::Linear) = (at, values) else {
        return Err(StageError::content_with_hint(
            "`show: radiance-at-centroid` draws the irradiance of lights, which needs lights and linear pixels",
            "set `at` to a `median-cut` stage and `on` to the map; tone-map the result",
        ));
    };
    Ok(irradiances_of(set))
}

fn irradiances_of(set: &LightSet) -> Vec<[f32; 3]> {
    set.lights.iter().map(|light| light.irradiance.map(|channel| channel as f32)).collect()
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::image::raster::{PictureSamples, Raster};
    use crate::light::samples::SampleSet;

    fn parsed(yaml: &str) -> Mark {
        serde_yaml::from_str(yaml).unwrap()
    }

    fn two_lights() -> Illumination {
        let light = |x0: u32, red: f64| Light {
            region: Region { x0, y0: 0, x1: x0 + 4, y1: 4 },
            x: f64::from(x0) + 2.5,
            y: 2.5,
            direction: DVec3::Y,
            irradiance: [red, 0.0, 0.0],
            solid_angle: 1.0,
            energy: 1.0,
        };
        Illumination::Lights(Arc::new(LightSet { map_width: 8, map_height: 4, lights: vec![light(0, 7.0), light(4, 8.0)] }))
    }

    fn one_sample(map_width: u32) -> Illumination {
        let sample = Sample { x: 5, y: 1, u: 0.7, v: 0.3, direction: DVec3::X, pmf: 0.1, pdf: 0.1, radiance: None };
        let set = SampleSet { map_width, map_height: map_width / 2, frame: Frame::World, samples: vec![sample] };
        Illumination::Samples(Arc::new(set))
    }

    /// One letter a pixel.
    fn letters(raster: &Raster) -> Vec<String> {
        let letter = |pixel: &[f32; 3]| match pixel {
            [0.0, 0.0, 0.0] => '.',
            [1.0, 1.0, 1.0] => 'w',
            [0.0, 0.0, 1.0] => 'b',
            [7.0, ..] => '7',
            [8.0, ..] => '8',
            _ => '?',
        };
        (0..raster.height()).map(|y| raster.row(y).iter().map(letter).collect()).collect()
    }

    #[test]
    fn lights_get_white_edges_under_blue_blocks() {
        let mark = parsed("{ on: a, at: b, size: 1 }");
        let marked = mark.marked(&Raster::filled(8, 4, [0.0; 3]), &two_lights(), Values::Linear).unwrap();
        assert_eq!(letters(&marked), ["wwwwwwww", "w...w..w", "w.b.w.bw", "wwwwwwww"]);
    }

    #[test]
    fn the_irradiance_of_each_region_stands_on_black_without_edges() {
        let mark = parsed("{ on: a, at: b, size: 3, show: radiance-at-centroid }");
        let marked = mark.marked(&Raster::filled(8, 4, [0.5; 3]), &two_lights(), Values::Linear).unwrap();
        assert_eq!(letters(&marked), ["........", ".777.888", ".777.888", ".777.888"]);
        assert!(mark.marked(&Raster::filled(8, 4, [0.5; 3]), &one_sample(8), Values::Linear).is_err());
        let picture = Picture { width: 8, height: 4, samples: PictureSamples::Eight(vec![[0; 3]; 32]), alpha: None };
        assert!(mark.marked(&picture, &two_lights(), Values::Encoded).is_err());
    }

    #[test]
    fn samples_show_through_black_with_what_was_there() {
        let mark = parsed("{ on: a, at: b, size: 3, show: samples-only }");
        let original = Raster::filled(8, 4, [7.0, 1.0, 1.0]);
        let marked = mark.marked(&original, &one_sample(8), Values::Linear).unwrap();
        assert_eq!(letters(&marked), ["....777.", "....777.", "....777.", "........"]);
    }

    #[test]
    fn samples_of_no_map_are_placed_by_the_unit_square() {
        let mark = parsed("{ on: a, at: b, size: 1 }");
        let marked = mark.marked(&Raster::filled(10, 10, [0.0; 3]), &one_sample(0), Values::Linear).unwrap();
        assert_eq!(marked.pixel(7, 3), [0.0, 0.0, 1.0]);
    }

    #[test]
    fn another_size_is_refused_with_both_sizes() {
        let mark = parsed("{ on: a, at: b }");
        let error = mark.marked(&Raster::filled(9, 4, [0.0; 3]), &two_lights(), Values::Linear).unwrap_err().to_string();
        assert!(error.contains("`8x4`") && error.contains("`9x4`"), "{error}");
    }

    #[test]
    fn colors_have_names_or_three_numbers() {
        assert_eq!(parsed("{ on: a, at: b, color: red }").color.rgb(), [1.0, 0.0, 0.0]);
        assert_eq!(parsed("{ on: a, at: b, color: [0, 50, 0.5] }").color.rgb(), [0.0, 50.0, 0.5]);
        assert_eq!(parsed("{ on: a, at: b }").edge_color.rgb(), [1.0; 3]);
        assert!(serde_yaml::from_str::<Mark>("{ on: a, at: b, color: bleu }").is_err());
        assert_eq!(serde_json::to_string(&Color::Named("blue")).unwrap(), "\"blue\"");
    }

    #[test]
    fn an_even_block_is_a_mistake() {
        assert_eq!(parsed("{ on: a, at: b, size: 4 }").mistakes()[0].field, "size");
        assert!(parsed("{ on: a, at: b, size: 9 }").mistakes().is_empty());
    }
}

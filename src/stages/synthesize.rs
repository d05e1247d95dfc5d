//! The kind `synthesize`; the maps are in `light::synthesis`.

use std::borrow::Cow;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Deserializer, Serialize, Serializer, de};

use crate::engine::artifact::Artifact;
use crate::engine::job::Job;
use crate::engine::parameter::Seed;
use crate::engine::stage::{InputSizes, Mistake, ResultDeclaration, Stage, StageError};
use crate::light::envmap::EnvMap;
use crate::light::synthesis::plain::{Checker, Gradient, OnePixel};
use crate::light::synthesis::sky::SunSky;
use crate::light::synthesis::{self, Rgb, Synthetic};

/// Makes an environment map without a file: test patterns with known answers, a sky, a studio, a cathedral.
///
/// `load: { path: synthetic:NAME }` is the map of that name with default parameters, and seed 0 where it draws.
/// A parameter that the named map does not use is a mistake.
///
/// ```yaml
/// env: { synthesize: { name: cathedral, width: 512 } }
/// ```
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Synthesize {
    /// Which map.
    pub name: MapName,
    /// Width in pixels, an even number; a map is half as high.
    #[serde(default = "default_width")]
    #[schemars(range(min = 2, max = 65536), extend("x-unit" = "pixels"))]
    pub width: u32,
    /// Radiance of `constant`, of the pixel of `one-pixel`, of the bright squares of `checker`: a number or `[r, g, b]`; 1 by default.
    #[serde(default)]
    pub radiance: Option<Radiance>,
    /// Radiance of the other pixels of `one-pixel`, of the dark squares of `checker`; 0 by default.
    #[serde(default)]
    pub background: Option<Radiance>,
    /// Radiance of `gradient` at the zenith; 1 by default.
    #[serde(default)]
    pub top: Option<Radiance>,
    /// Radiance of `gradient` at the nadir; 0 by default.
    #[serde(default)]
    pub bottom: Option<Radiance>,
    /// Column and row of the pixel of `one-pixel`, from 0; by default `[width / 16, width / 8]` rounded down, which is 45 degrees
    /// up and about 22.5 degrees from +x towards +z.
    #[serde(default)]
    pub pixel: Option<[u32; 2]>,
    /// Squares of `checker` from pole to pole, at most the map's height; there are twice as many around. 8 by default.
    #[serde(default)]
    #[schemars(range(min = 1, max = 32768))]
    pub squares: Option<u32>,
    /// Height of the sun's center over the horizon in `sun-sky`; 40 by default.
    #[serde(default)]
    #[schemars(range(min = 0, max = 90), extend("x-unit" = "degrees"))]
    pub sun_elevation_degrees: Option<f64>,
    /// Where the sun stands in `sun-sky`, from +x towards +z; 60 by default.
    #[serde(default)]
    #[schemars(range(min = -360, max = 360), extend("x-unit" = "degrees"))]
    pub sun_azimuth_degrees: Option<f64>,
    /// Haze of `sun-sky`: 2 very clear, 3 clear, 6 hazy, 10 almost fog (Preetham et al. 1999); 3 by default.
    #[serde(default)]
    #[schemars(range(min = 2, max = 10))]
    pub turbidity: Option<f64>,
    /// Diffuse reflectance of the ground below `sun-sky`; 0.2 by default.
    #[serde(default)]
    #[schemars(range(min = 0, max = 1))]
    pub ground_albedo: Option<f64>,
    /// Varies stone, tiles and glass of `cathedral`; by default the pipeline's seed.
    #[serde(default)]
    pub seed: Seed,
}

fn default_width() -> u32 {
    1024
}

/// The maps.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum MapName {
    /// The same `radiance` everywhere.
    Constant,
    /// Linear in height from `bottom` to `top`: irradiance is pi ((top + bottom) / 2 + n.y (top - bottom) / 3).
    Gradient,
    /// One `pixel` of another radiance than all others.
    OnePixel,
    /// Squares in angle, alternately of two radiances.
    Checker,
    /// Preetham's clear sky with the sun over a diffuse ground; luminance in kcd/m^2.
    SunSky,
    /// A dark room with softboxes.
    Studio,
    /// A gothic interior with stained glass, chandeliers and candles; dynamic range over 1e5 at the default width.
    Cathedral,
}

impl MapName {
    /// As it is written.
    fn text(self) -> &'static str {
        match self {
            Self::Constant => "constant",
            Self::Gradient => "gradient",
            Self::OnePixel => "one-pixel",
            Self::Checker => "checker",
            Self::SunSky => "sun-sky",
            Self::Studio => "studio",
            Self::Cathedral => "cathedral",
        }
    }
}

/// A radiance: one number for grey, or red, green and blue; 0 to 1e9.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Radiance(pub Rgb);

impl Serialize for Radiance {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let [r, g, b] = self.0;
        // Grey has one form, so that both ways of writing it have one key.
        if r == g && g == b { serializer.serialize_f64(r) } else { self.0.serialize(serializer) }
    }
}

impl<'de> Deserialize<'de> for Radiance {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Visitor;

        impl<'de> de::Visitor<'de> for Visitor {
            type Value = Radiance;

            fn expecting(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                out.write_str("a number or `[r, g, b]`, each from 0 to 1e9")
            }

            fn visit_f64<E: de::Error>(self, value: f64) -> Result<Radiance, E> {
                checked([value; 3])
            }

            fn visit_u64<E: de::Error>(self, value: u64) -> Result<Radiance, E> {
                checked([value as f64; 3])
            }

            fn visit_i64<E: de::Error>(self, value: i64) -> Result<Radiance, E> {
                checked([value as f64; 3])
            }

            fn visit_seq<A: de::SeqAccess<'de>>(self, sequence: A) -> Result<Radiance, A::Error> {
                checked(Rgb::deserialize(de::value::SeqAccessDeserializer::new(sequence))?)
            }
        }

        deserializer.deserialize_any(Visitor)
    }
}

fn checked<E: de::Error>(color: Rgb) -> Result<Radiance, E> {
    match color.into_iter().find(|channel| !(0.0..=1e9).contains(channel)) {
        Some(channel) => Err(E::custom(format!("radiance `{channel}` is not from 0 to 1e9"))),
        None => Ok(Radiance(color)),
    }
}

impl JsonSchema for Radiance {
    fn inline_schema() -> bool {
        true
    }

    fn schema_name() -> Cow<'static, str> {
        "Radiance".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        let number = json_schema!({ "type": "number", "minimum": 0, "maximum": 1e9 });
        json_schema!({ "anyOf": [number, { "type": "array", "items": number, "minItems": 3, "maxItems": 3 }] })
    }
}

impl Stage for Synthesize {
    const KIND: &'static str = "synthesize";
    const VERSION: u32 = 1;
    const RESULTS: &'static [ResultDeclaration] = &[ResultDeclaration { name: "", types: &[EnvMap::TYPE] }];
    type Output = EnvMap;

    fn draws(&self) -> bool {
        self.name == MapName::Cathedral
    }

    fn mistakes(&self) -> Vec<Mistake> {
        let height = self.width / 2;
        let odd = (!self.width.is_multiple_of(2)).then(|| {
            let even = self.width + 1;
            mistake("width", format!("width `{}` is odd", self.width), Some(format!("a map is half as high as wide: take `{even}`")))
        });
        let outside = self.pixel.filter(|[x, y]| *x >= self.width || *y >= height).map(|[x, y]| {
            let message = format!("pixel `[{x}, {y}]` lies outside the map of {} x {height}", self.width);
            mistake("pixel", message, Some("columns and rows count from 0, rows from the top".into()))
        });
        let many = self.squares.filter(|squares| *squares > height).map(|squares| {
            mistake("squares", format!("`{squares}` squares do not fit into {height} rows"), Some(format!("take at most `{height}`")))
        });
        self.unused().into_iter().chain(odd).chain(outside).chain(many).collect()
    }

    fn memory(&self, _: &InputSizes) -> u64 {
        let pixels = u64::from(self.width) * u64::from(self.width / 2);
        pixels * if self.name == MapName::Cathedral { 40 } else { 12 }
    }

    fn run(&self, job: &Job<'_>) -> Result<EnvMap, StageError> {
        synthesis::synthesize(&self.map(job.seed(self.seed)), self.width as usize, || job.check())
    }
}

impl Synthesize {
    /// The map with the defaults filled in.
    fn map(&self, seed: u64) -> Synthetic {
        let or = |radiance: Option<Radiance>, default: f64| radiance.map_or([default; 3], |radiance| radiance.0);
        let (radiance, background) = (or(self.radiance, 1.0), or(self.background, 0.0));
        match self.name {
            MapName::Constant => Synthetic::Constant(radiance),
            MapName::Gradient => Synthetic::Gradient(Gradient { top: or(self.top, 1.0), bottom: or(self.bottom, 0.0) }),
            MapName::OnePixel => {
                let pixel = self.pixel.map(|pixel| pixel.map(|index| index as usize));
                Synthetic::OnePixel(OnePixel { pixel, radiance, background })
            }
            MapName::Checker => {
                let squares = self.squares.unwrap_or(8.min(self.width / 2)) as usize;
                Synthetic::Checker(Checker { squares, radiance, background })
            }
            MapName::SunSky => Synthetic::SunSky(self.sky()),
            MapName::Studio => Synthetic::Studio,
            MapName::Cathedral => Synthetic::Cathedral(seed),
        }
    }

    fn sky(&self) -> SunSky {
        let default = SunSky::default();
        SunSky {
            sun_elevation_degrees: self.sun_elevation_degrees.unwrap_or(default.sun_elevation_degrees),
            sun_azimuth_degrees: self.sun_azimuth_degrees.unwrap_or(default.sun_azimuth_degrees),
            turbidity: self.turbidity.unwrap_or(default.turbidity),
            ground_albedo: self.ground_albedo.unwrap_or(default.ground_albedo),
        }
    }

    /// Parameters that were given though the map does not use them.
    fn unused(&self) -> Vec<Mistake> {
        use MapName::{Cathedral, Checker, Constant, Gradient, OnePixel, SunSky};
        let uses: [(&str, bool, &[MapName]); 11] = [
            ("radiance", self.radiance.is_some(), &[Constant, OnePixel, Checker]),
            ("background", self.background.is_some(), &[OnePixel, Checker]),
            ("top", self.top.is_some(), &[Gradient]),
            ("bottom", self.bottom.is_some(), &[Gradient]),
            ("pixel", self.pixel.is_some(), &[OnePixel]),
            ("squares", self.squares.is_some(), &[Checker]),
            ("sun_elevation_degrees", self.sun_elevation_degrees.is_some(), &[SunSky]),
            ("sun_azimuth_degrees", self.sun_azimuth_degrees.is_some(), &[SunSky]),
            ("turbidity", self.turbidity.is_some(), &[SunSky]),
            ("ground_albedo", self.ground_albedo.is_some(), &[SunSky]),
            ("seed", self.seed.0.is_some(), &[Cathedral]),
        ];
        let unused = uses.into_iter().filter(|(_, is_given, users)| *is_given && !users.contains(&self.name));
        unused
            .map(|(field, _, users)| {
                let users = users.iter().map(|name| format!("`{}`", name.text())).collect::<Vec<_>>().join(", ");
                mistake(field, format!("the map `{}` does not use `{field}`", self.name.text()), Some(format!("it is for {users}")))
            })
            .collect()
    }
}

fn mistake(field: &str, message: String, hint: Option<String>) -> Mistake {
    Mistake { field: field.into(), message, hint }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stage(text: &str) -> Synthesize {
        serde_yaml::from_str(text).unwrap()
    }

    #[test]
    fn names_of_the_kind_are_those_of_the_maps() {
        for name in synthesis::NAMES {
            assert_eq!(stage(&format!("name: {name}")).name.text(), name);
        }
        assert!(serde_yaml::from_str::<Synthesize>("name: cathedrale").is_err());
    }

    #[test]
    fn defaults_of_the_kind_are_those_of_the_maps() {
        for name in synthesis::NAMES {
            assert_eq!(Synthetic::named(name), Some(stage(&format!("name: {name}")).map(0)));
        }
    }

    #[test]
    fn a_parameter_of_another_map_is_a_mistake() {
        let fields = |text: &str| stage(text).mistakes().into_iter().map(|mistake| mistake.field).collect::<Vec<_>>();
        assert_eq!(fields("{ name: studio, turbidity: 3, seed: 1 }"), ["turbidity", "seed"]);
        assert_eq!(fields("{ name: sun-sky, turbidity: 3 }"), [""; 0]);
        assert_eq!(fields("{ name: constant, width: 15 }"), ["width"]);
        assert_eq!(fields("{ name: one-pixel, width: 16, pixel: [3, 8] }"), ["pixel"]);
        assert_eq!(fields("{ name: checker, width: 16, squares: 9 }"), ["squares"]);
    }

    #[test]
    fn a_radiance_is_a_number_or_three() {
        assert_eq!(stage("{ name: constant, radiance: 2 }").radiance, Some(Radiance([2.0; 3])));
        assert_eq!(stage("{ name: constant, radiance: [1, 0.5, 0] }").radiance, Some(Radiance([1.0, 0.5, 0.0])));
        for bad in ["-1", "[1, 2]", "[1, 2, 3, 4]", "1e10", "red", ".nan"] {
            assert!(serde_yaml::from_str::<Synthesize>(&format!("{{ name: constant, radiance: {bad} }}")).is_err(), "{bad}");
        }
        let [number, list] =
            ["2.5", "[2.5, 2.5, 2.5]"].map(|text| serde_json::to_value(stage(&format!("{{ name: constant, radiance: {text} }}"))).unwrap());
        assert_eq!(number, list);
    }

    #[test]
    fn only_the_cathedral_draws() {
        let drawing: Vec<_> = synthesis::NAMES.into_iter().filter(|name| stage(&format!("name: {name}")).draws()).collect();
        assert_eq!(drawing, ["cathedral"]);
    }
}

//! What a person writes where a reflectance, a radiance or a roughness is asked for.

use std::borrow::Cow;
use std::fmt;
use std::marker::PhantomData;
use std::sync::Arc;

use glam::Vec2;
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Deserializer, Serialize, Serializer, de};

use crate::image::raster::Raster;
use crate::math::noise::Octaves;
use crate::render::scene_file::SceneFile;
use crate::render::texture::Texture;
use crate::render::texture::bitmap::{Bitmap, Decoding, Interpolation, Layout, TexelError, Wrap};
use crate::render::texture::checker::Checker;
use crate::render::texture::noise::{Basis, Domain, Noise};
use crate::render::texture::stripes::Stripes;
use crate::render::texture::value::{Alpha, Color, Fraction, Index, Light, Number, Share, Value};

/// The share of light of each channel that comes back: from 0 to 1.
pub type Reflectance = Parameter<Color<Share>>;

/// Radiance of each channel.
pub type Radiance = Parameter<Color<Light>>;

/// Width of a microfacet distribution: from 0.001 to 1.
pub type Roughness = Parameter<Number<Alpha>>;

/// Part of a complex index of refraction, of each channel: from 0 to 100.
pub type RefractiveIndex = Parameter<Color<Index>>;

/// A number from 0 to 1.
pub type Portion = Parameter<Number<Fraction>>;

/// A value, or a pattern of values.
#[derive(Debug, Clone, PartialEq)]
pub enum Parameter<V> {
    /// The same everywhere.
    Constant(V),
    /// As the pattern says.
    Pattern(Pattern<V>),
}

/// Values that vary over a surface.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Pattern<V> {
    /// A picture: PNG, PPM, EXR, HDR, PFM or NPY.
    Bitmap(BitmapParameters),
    /// Squares of two values, alternating over u and v.
    Checker(CheckerParameters<V>),
    /// Stripes of two values along u.
    Stripes(StripesParameters<V>),
    /// Gradient noise between two values (Perlin, "Improving noise", 2002); half way between them at lattice points.
    Perlin(NoiseParameters<V>),
    /// Random values at lattice points, between which it goes by the cosine: the fourth report's noise, which is not Perlin's.
    ValueNoise(NoiseParameters<V>),
    /// The coordinates themselves: red is the fraction of u, green that of v; as one number, that of u.
    Uv(UvParameters),
}

/// A picture: PNG, PPM, EXR, HDR, PFM or NPY, told from the content. One number is the luminance of its color.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct BitmapParameters {
    /// The file. Its bottom row lies at v = 0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub path: Option<SceneFile>,
    /// Name of an entry of the stage's `textures`, instead of a file.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub of: Option<String>,
    /// Pictures per unit of u and of v: a number, or one for each. Default 1.
    #[serde(default = "Pair::one")]
    pub scale: Pair,
    /// Added to u and v after that, in pictures: a number, or one for each. Default 0.
    #[serde(default)]
    pub offset: Pair,
    /// What stands beyond the edge of the picture.
    #[serde(default)]
    pub wrap: Wrap,
    /// What stands between the centers of texels. Linear values are interpolated.
    #[serde(default)]
    pub filter: Interpolation,
    /// What the values of a PNG or PPM mean; other formats are linear. Default `srgb` for light and reflectances, `data`
    /// for numbers, indices of refraction and normals.
    #[serde(default)]
    pub decoding: Option<Decoding>,
    /// Factor on the values. Default 1.
    #[serde(default = "one")]
    #[schemars(range(min = 0, max = 1e9))]
    pub factor: f64,
    /// Whether values that the parameter may not have are cut to the nearest that it may; by default they are an error.
    #[serde(default)]
    pub clamp: bool,
}

/// Squares of two values, alternating over u and v.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CheckerParameters<V> {
    /// Value of the square at u = v = 0.
    pub a: V,
    /// Value of its neighbors.
    pub b: V,
    /// Squares per unit of u and of v; above 0.
    #[serde(default = "one")]
    #[schemars(range(max = 1_000_000), extend("exclusiveMinimum" = 0))]
    pub scale: f64,
}

/// Stripes of two values along u: `a` where the fraction of `scale` u is below `delta`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct StripesParameters<V> {
    /// Value of the stripe that begins at u = 0.
    pub a: V,
    /// Value of the other.
    pub b: V,
    /// Width of the first, as a share of both. Default 0.5.
    #[serde(default = "half")]
    #[schemars(range(min = 0, max = 1))]
    pub delta: f64,
    /// Pairs of stripes per unit of u; above 0.
    #[serde(default = "one")]
    #[schemars(range(max = 1_000_000), extend("exclusiveMinimum" = 0))]
    pub scale: f64,
}

/// Noise between two values: sum of gain^k noise(lacunarity^k p) over sum of gain^k.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct NoiseParameters<V> {
    /// Value where the noise is least.
    pub a: V,
    /// Value where it is greatest.
    pub b: V,
    /// Cells of the lattice per unit, of the first octave; above 0.
    #[serde(default = "one")]
    #[schemars(range(max = 1_000_000), extend("exclusiveMinimum" = 0))]
    pub scale: f64,
    /// How many noises are added, each finer and weaker. Default 1; the fourth report has 9.
    #[serde(default = "one_octave")]
    #[schemars(range(min = 1, max = 16))]
    pub octaves: u32,
    /// Frequency of each octave over that of the one before. Default 2.
    #[serde(default = "two")]
    #[schemars(range(min = 1, max = 16))]
    pub lacunarity: f64,
    /// Amplitude of each octave over that of the one before. Default 0.5.
    #[serde(default = "half")]
    #[schemars(range(min = 0, max = 1))]
    pub gain: f64,
    /// What it is a function of.
    #[serde(default)]
    pub domain: Domain,
    /// Another seed gives another field. Default 0; the stage's seed does not matter.
    #[serde(default)]
    pub seed: u32,
}

/// The coordinates themselves.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct UvParameters {}

/// A number for u and one for v.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Pair(pub [f64; 2]);

fn one() -> f64 {
    1.0
}

fn two() -> f64 {
    2.0
}

fn half() -> f64 {
    0.5
}

fn one_octave() -> u32 {
    1
}

impl Pair {
    fn one() -> Self {
        Self([1.0; 2])
    }

    fn vec2(self) -> Vec2 {
        Vec2::from_array(self.0.map(|value| value as f32))
    }
}

/// The greatest magnitude of a scale or an offset.
const LARGEST: f64 = 1e6;

impl Serialize for Pair {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let [u, v] = self.0;
        // Equal numbers have one form, so that both ways of writing them have one key.
        if u == v { serializer.serialize_f64(u) } else { self.0.serialize(serializer) }
    }
}

impl<'de> Deserialize<'de> for Pair {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        #[derive(Deserialize)]
        #[serde(untagged)]
        enum Written {
            Both(f64),
            Each([f64; 2]),
        }
        let pair = match Written::deserialize(deserializer)? {
            Written::Both(value) => [value; 2],
            Written::Each(values) => values,
        };
        let is_sound = pair.iter().all(|value| value.abs() <= LARGEST);
        if is_sound { Ok(Self(pair)) } else { Err(de::Error::custom(format!("numbers from -{LARGEST} to {LARGEST} are expected"))) }
    }
}

impl JsonSchema for Pair {
    fn inline_schema() -> bool {
        true
    }

    fn schema_name() -> Cow<'static, str> {
        "Pair".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        let number = json_schema!({ "type": "number", "minimum": -LARGEST, "maximum": LARGEST });
        json_schema!({ "anyOf": [number, { "type": "array", "items": number, "minItems": 2, "maxItems": 2 }] })
    }
}

/// Where the pixels of a picture come from.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub enum Origin {
    /// A file.
    File(SceneFile),
    /// Another stage, by the name that the scene has for it.
    Stage(String),
}

impl fmt::Display for Origin {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::File(SceneFile(path)) => write!(out, "`{}`", path.display()),
            Self::Stage(name) => write!(out, "texture `{name}`"),
        }
    }
}

/// Gives the pictures that textures name.
pub trait Pictures {
    /// A picture; `None` where files are not read, or this one could not be.
    fn picture(&self, origin: &Origin, decoding: Decoding) -> Option<Arc<Raster>>;
}

/// Of no file: for checks before anything is read, in which a picture stands for the least value of its parameter.
#[derive(Debug, Clone, Copy)]
pub struct Unread;

impl Pictures for Unread {
    fn picture(&self, _: &Origin, _: Decoding) -> Option<Arc<Raster>> {
        None
    }
}

impl<V: Value> Parameter<V> {
    /// As a scene holds it.
    pub fn texture(&self, pictures: &dyn Pictures) -> Result<Texture<V::Inner>, TexelError> {
        Ok(match self {
            Self::Constant(value) => Texture::Constant(value.inner()),
            Self::Pattern(Pattern::Bitmap(bitmap)) => bitmap.texture::<V>(pictures)?,
            Self::Pattern(Pattern::Checker(CheckerParameters { a, b, scale })) => {
                Texture::Checker(Checker { a: a.inner(), b: b.inner(), scale: *scale as f32 })
            }
            Self::Pattern(Pattern::Stripes(StripesParameters { a, b, delta, scale })) => {
                Texture::Stripes(Stripes { a: a.inner(), b: b.inner(), delta: *delta as f32, scale: *scale as f32 })
            }
            Self::Pattern(Pattern::Perlin(noise)) => Texture::Noise(noise.noise(Basis::Perlin)),
            Self::Pattern(Pattern::ValueNoise(noise)) => Texture::Noise(noise.noise(Basis::CosineValue)),
            Self::Pattern(Pattern::Uv(_)) => Texture::Uv,
        })
    }
}

impl BitmapParameters {
    /// The file or else the stage that is named; `None` where neither is.
    fn origin(&self) -> Option<Origin> {
        let stage = self.of.clone().map(Origin::Stage);
        self.path.clone().map(Origin::File).or(stage)
    }

    fn texture<V: Value>(&self, pictures: &dyn Pictures) -> Result<Texture<V::Inner>, TexelError> {
        let decoding = self.decoding.unwrap_or(V::USUAL_DECODING);
        let least = Texture::Constant(V::least());
        let Some(origin) = self.origin() else { return Ok(least) };
        let Some(raster) = pictures.picture(&origin, decoding) else { return Ok(least) };
        let layout = Layout { scale: self.scale.vec2(), offset: self.offset.vec2(), wrap: self.wrap, filter: self.filter };
        let bitmap = Bitmap::new(raster, layout, self.factor as f32, V::LIMITS.map(|limit| limit as f32));
        match bitmap.outside(&origin).filter(|_| !self.clamp) {
            Some(error) => Err(error),
            None => Ok(Texture::Bitmap(bitmap)),
        }
    }
}

impl<V: Value> NoiseParameters<V> {
    fn noise(&self, basis: Basis) -> Noise<V::Inner> {
        let &Self { a, b, scale, octaves, lacunarity, gain, domain, seed } = self;
        let octaves = Octaves { count: octaves, lacunarity, gain };
        Noise { a: a.inner(), b: b.inner(), basis, octaves, scale, domain, seed: seed.into() }
    }
}

impl<V: Value> Serialize for Parameter<V> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Constant(value) => value.serialize(serializer),
            Self::Pattern(pattern) => pattern.serialize(serializer),
        }
    }
}

impl<'de, V: Value> Deserialize<'de> for Parameter<V> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(ParameterVisitor(PhantomData))
    }
}

struct ParameterVisitor<V>(PhantomData<V>);

impl<'de, V: Value> de::Visitor<'de> for ParameterVisitor<V> {
    type Value = Parameter<V>;

    fn expecting(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str("a number, a color `[r, g, b]` or a texture such as `{ checker: {...} }`")
    }

    fn visit_f64<E: de::Error>(self, value: f64) -> Result<Self::Value, E> {
        V::deserialize(de::value::F64Deserializer::new(value)).map(Parameter::Constant)
    }

    fn visit_u64<E: de::Error>(self, value: u64) -> Result<Self::Value, E> {
        self.visit_f64(value as f64)
    }

    fn visit_i64<E: de::Error>(self, value: i64) -> Result<Self::Value, E> {
        self.visit_f64(value as f64)
    }

    fn visit_seq<A: de::SeqAccess<'de>>(self, sequence: A) -> Result<Self::Value, A::Error> {
        V::deserialize(de::value::SeqAccessDeserializer::new(sequence)).map(Parameter::Constant)
    }

    fn visit_map<A: de::MapAccess<'de>>(self, map: A) -> Result<Self::Value, A::Error> {
        Pattern::deserialize(de::value::MapAccessDeserializer::new(map)).map(Parameter::Pattern)
    }
}

impl<V: Value> JsonSchema for Parameter<V> {
    fn inline_schema() -> bool {
        true
    }

    fn schema_name() -> Cow<'static, str> {
        format!("{}Texture", V::schema_name()).into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        let pattern = generator.subschema_for::<Pattern<V>>();
        json_schema!({ "anyOf": [V::json_schema(generator), pattern] })
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;
    use crate::render::texture::TexturePoint;

    #[test]
    fn a_number_a_color_and_a_pattern_are_read() {
        let at = TexturePoint::at([0.6, 0.1], Vec3::ZERO);
        let value = |text: &str| serde_yaml::from_str::<Reflectance>(text).unwrap().texture(&Unread).unwrap().at(&at);
        assert_eq!(value("0.25"), Vec3::splat(0.25));
        assert_eq!(value("1"), Vec3::ONE);
        assert_eq!(value("[0, 0.5, 1]"), Vec3::new(0.0, 0.5, 1.0));
        assert_eq!(value("{ checker: { a: 0, b: [1, 0.5, 0], scale: 2 } }"), Vec3::new(1.0, 0.5, 0.0));
        assert_eq!(value("{ stripes: { a: 0, b: [1, 0.5, 0], delta: 0.4 } }"), Vec3::new(1.0, 0.5, 0.0));
        assert_eq!(value("{ perlin: { a: 0, b: [1, 0.5, 0] } }"), Vec3::new(0.5, 0.25, 0.0));
        assert_eq!(value("{ uv: {} }"), Vec3::new(0.6, 0.1, 0.0));
        assert_eq!(value("{ bitmap: { path: not-read.png } }"), Vec3::ZERO);
    }

    #[test]
    fn what_is_written_comes_back() {
        for text in ["0.25", "[0.0,0.5,1.0]", r#"{"checker":{"a":0.0,"b":1.0,"scale":2.0}}"#, r#"{"uv":{}}"#] {
            let parameter: Reflectance = serde_yaml::from_str(text).unwrap();
            assert_eq!(serde_json::to_string(&parameter).unwrap(), text);
        }
    }

    /// Grey values 0.25 and 1.5 side by side.
    struct Grey;

    impl Pictures for Grey {
        fn picture(&self, _: &Origin, decoding: Decoding) -> Option<Arc<Raster>> {
            let value = if decoding == Decoding::Data { 0.25 } else { 0.05 };
            Some(Arc::new(Raster::new(2, 1, vec![[value; 3], [1.5; 3]])))
        }
    }

    #[test]
    fn a_picture_is_decoded_for_light_and_taken_as_it_is_for_numbers() {
        let at = TexturePoint::at([0.25, 0.1], Vec3::ZERO);
        let nearest = "{ bitmap: { path: a.png, filter: nearest, clamp: true DECODING } }";
        let text = |decoding: &str| nearest.replace("DECODING", decoding);
        let color = |text: &str| serde_yaml::from_str::<Reflectance>(text).unwrap().texture(&Grey).unwrap().at(&at).x;
        let number = |text: &str| serde_yaml::from_str::<Roughness>(text).unwrap().texture(&Grey).unwrap().at(&at);
        assert_eq!([color(&text("")), number(&text(""))], [0.05, 0.25]);
        assert_eq!([color(&text(", decoding: data")), number(&text(", decoding: srgb"))], [0.25, 0.05]);
    }

    #[test]
    fn texels_beyond_the_limits_are_an_error_unless_they_are_cut_or_scaled() {
        let texture = |more: &str| {
            let text = format!("{{ bitmap: {{ path: a.png, filter: nearest {more} }} }}");
            serde_yaml::from_str::<Reflectance>(&text).unwrap().texture(&Grey)
        };
        let message = texture("").unwrap_err().to_string();
        assert!(message.contains("`a.png`") && message.contains("column 1 of row 0") && message.contains("`1.5`"), "{message}");
        let right = TexturePoint::at([0.75, 0.1], Vec3::ZERO);
        assert_eq!(texture(", clamp: true").unwrap().at(&right), Vec3::ONE);
        assert_eq!(texture(", factor: 0.5").unwrap().at(&right), Vec3::splat(0.75));
    }

    #[test]
    fn wrong_values_are_refused() {
        for text in ["2", "-1", "[1, 1]", "text", "{ chequer: {} }", "{ checker: { a: 2, b: 0 } }", "{ checker: { a: 0, b: 0, c: 1 } }"] {
            assert!(serde_yaml::from_str::<Reflectance>(text).is_err(), "{text}");
        }
    }
}

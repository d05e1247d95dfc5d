//! A number or a linear color as a person writes it, with its limits in the type and in the schema.

use std::borrow::Cow;
use std::fmt;
use std::marker::PhantomData;

use glam::Vec3;
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Deserializer, Serialize, Serializer, de};

use crate::render::texture::Texel;
use crate::render::texture::bitmap::Decoding;

/// The numbers that a parameter may take.
pub trait Limits: Copy + fmt::Debug + PartialEq + 'static {
    /// Name of such a value, for messages and schemas.
    const NAME: &'static str;
    /// The least.
    const MINIMUM: f64;
    /// The greatest.
    const MAXIMUM: f64;
    /// What colors of a display's picture mean. Default light.
    const USUAL_DECODING: Decoding = Decoding::Srgb;
}

/// A share of the light: from 0 to 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Share;

impl Limits for Share {
    const NAME: &'static str = "Reflectance";
    const MINIMUM: f64 = 0.0;
    const MAXIMUM: f64 = 1.0;
}

/// Light: from 0 to 1e9.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Light;

impl Limits for Light {
    const NAME: &'static str = "Radiance";
    const MINIMUM: f64 = 0.0;
    const MAXIMUM: f64 = 1e9;
}

/// The width of a microfacet distribution: from 0.001 to 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Alpha;

impl Limits for Alpha {
    const NAME: &'static str = "Roughness";
    const MINIMUM: f64 = 0.001;
    const MAXIMUM: f64 = 1.0;
}

/// Part of a complex index of refraction: from 0 to 100.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Index;

impl Limits for Index {
    const NAME: &'static str = "Index";
    const MINIMUM: f64 = 0.0;
    const MAXIMUM: f64 = 100.0;
    const USUAL_DECODING: Decoding = Decoding::Data;
}

/// A part of a whole: from 0 to 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fraction;

impl Limits for Fraction {
    const NAME: &'static str = "Fraction";
    const MINIMUM: f64 = 0.0;
    const MAXIMUM: f64 = 1.0;
}

/// A component of a unit vector, (c + 1) / 2: from 0 to 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Component;

impl Limits for Component {
    const NAME: &'static str = "Component";
    const MINIMUM: f64 = 0.0;
    const MAXIMUM: f64 = 1.0;
    const USUAL_DECODING: Decoding = Decoding::Data;
}

/// A height over a surface: from -1e6 to 1e6.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Height;

impl Limits for Height {
    const NAME: &'static str = "Height";
    const MINIMUM: f64 = -1e6;
    const MAXIMUM: f64 = 1e6;
}

/// What a texture may hold: [`Number`] or [`Color`].
pub trait Value: Copy + PartialEq + fmt::Debug + Serialize + for<'de> Deserialize<'de> + JsonSchema {
    /// The same inside the renderer.
    type Inner: Texel;
    /// The least and the greatest number.
    const LIMITS: [f64; 2];
    /// What the values of a display's picture mean.
    const USUAL_DECODING: Decoding;

    /// Without its limits.
    fn inner(self) -> Self::Inner;

    /// The least, in every channel.
    fn least() -> Self::Inner;
}

/// One number within its limits.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Number<L>(f64, PhantomData<L>);

impl<L: Limits> Number<L> {
    /// The number, if it is within the limits.
    pub fn new(value: f64) -> Option<Self> {
        is_within::<L>(value).then_some(Self(value, PhantomData))
    }

    /// The number.
    pub fn value(self) -> f64 {
        self.0
    }
}

impl<L: Limits> Value for Number<L> {
    type Inner = f32;
    const LIMITS: [f64; 2] = [L::MINIMUM, L::MAXIMUM];
    const USUAL_DECODING: Decoding = Decoding::Data;

    fn inner(self) -> f32 {
        self.0 as f32
    }

    fn least() -> f32 {
        L::MINIMUM as f32
    }
}

/// A linear color, each channel within its limits; grey is written as one number.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Color<L>([f64; 3], PhantomData<L>);

impl<L: Limits> Color<L> {
    /// The color, if each channel is within the limits.
    pub fn new(channels: [f64; 3]) -> Option<Self> {
        channels.into_iter().all(is_within::<L>).then_some(Self(channels, PhantomData))
    }

    /// A grey, if the number is within the limits.
    pub fn grey(value: f64) -> Option<Self> {
        Self::new([value; 3])
    }

    /// Red, green and blue.
    pub fn channels(self) -> [f64; 3] {
        self.0
    }
}

impl<L: Limits> Value for Color<L> {
    type Inner = Vec3;
    const LIMITS: [f64; 2] = [L::MINIMUM, L::MAXIMUM];
    const USUAL_DECODING: Decoding = L::USUAL_DECODING;

    fn inner(self) -> Vec3 {
        Vec3::from_array(self.0.map(|channel| channel as f32))
    }

    fn least() -> Vec3 {
        Vec3::splat(L::MINIMUM as f32)
    }
}

fn is_within<L: Limits>(value: f64) -> bool {
    (L::MINIMUM..=L::MAXIMUM).contains(&value)
}

fn checked<L: Limits, E: de::Error>(value: f64) -> Result<f64, E> {
    let (least, greatest) = (L::MINIMUM, L::MAXIMUM);
    if is_within::<L>(value) { Ok(value) } else { Err(E::custom(format!("`{value}` is not from {least} to {greatest}"))) }
}

impl<L: Limits> Serialize for Number<L> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_f64(self.0)
    }
}

impl<'de, L: Limits> Deserialize<'de> for Number<L> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        checked::<L, D::Error>(f64::deserialize(deserializer)?).map(|value| Self(value, PhantomData))
    }
}

impl<L: Limits> Serialize for Color<L> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let [r, g, b] = self.0;
        // Grey has one form, so that both ways of writing it have one key.
        if r == g && g == b { serializer.serialize_f64(r) } else { self.0.serialize(serializer) }
    }
}

impl<'de, L: Limits> Deserialize<'de> for Color<L> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(ColorVisitor(PhantomData))
    }
}

struct ColorVisitor<L>(PhantomData<L>);

impl<L: Limits> ColorVisitor<L> {
    fn color<E: de::Error>(channels: [f64; 3]) -> Result<Color<L>, E> {
        for channel in channels {
            checked::<L, E>(channel)?;
        }
        Ok(Color(channels, PhantomData))
    }
}

impl<'de, L: Limits> de::Visitor<'de> for ColorVisitor<L> {
    type Value = Color<L>;

    fn expecting(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "a number or `[r, g, b]`, each from {} to {}", L::MINIMUM, L::MAXIMUM)
    }

    fn visit_f64<E: de::Error>(self, value: f64) -> Result<Self::Value, E> {
        Self::color([value; 3])
    }

    fn visit_u64<E: de::Error>(self, value: u64) -> Result<Self::Value, E> {
        Self::color([value as f64; 3])
    }

    fn visit_i64<E: de::Error>(self, value: i64) -> Result<Self::Value, E> {
        Self::color([value as f64; 3])
    }

    fn visit_seq<A: de::SeqAccess<'de>>(self, sequence: A) -> Result<Self::Value, A::Error> {
        Self::color(<[f64; 3]>::deserialize(de::value::SeqAccessDeserializer::new(sequence))?)
    }
}

impl<L: Limits> JsonSchema for Number<L> {
    fn inline_schema() -> bool {
        true
    }

    fn schema_name() -> Cow<'static, str> {
        format!("{}Number", L::NAME).into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({ "type": "number", "minimum": L::MINIMUM, "maximum": L::MAXIMUM })
    }
}

impl<L: Limits> JsonSchema for Color<L> {
    fn inline_schema() -> bool {
        true
    }

    fn schema_name() -> Cow<'static, str> {
        format!("{}Color", L::NAME).into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        let number = Number::<L>::json_schema(generator);
        json_schema!({ "anyOf": [number, { "type": "array", "items": number, "minItems": 3, "maxItems": 3 }] })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn grey_has_one_form() {
        let grey: Color<Share> = serde_yaml::from_str("[0.5, 0.5, 0.5]").unwrap();
        assert_eq!(serde_yaml::to_string(&grey).unwrap().trim(), "0.5");
        assert_eq!(serde_yaml::from_str::<Color<Share>>("0.5").unwrap(), grey);
        assert_eq!(serde_yaml::from_str::<Color<Share>>("1").unwrap().inner(), Vec3::ONE);
    }

    #[test]
    fn values_beyond_their_limits_are_refused_with_the_limits() {
        let message = serde_yaml::from_str::<Color<Share>>("[0.5, 1.5, 0]").unwrap_err().to_string();
        assert!(message.contains("`1.5` is not from 0 to 1"), "{message}");
        assert!(serde_yaml::from_str::<Color<Share>>("[0.5, .nan, 0]").is_err());
        assert!(serde_yaml::from_str::<Color<Share>>("[0.5, 0.5]").is_err());
        assert!(serde_yaml::from_str::<Number<Alpha>>("0.0005").is_err());
        assert!(Number::<Alpha>::new(0.005).is_some());
    }
}

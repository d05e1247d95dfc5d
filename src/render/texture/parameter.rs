//! What a person writes where a reflectance, a radiance or a roughness is asked for.

use std::borrow::Cow;
use std::fmt;
use std::marker::PhantomData;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Deserializer, Serialize, Serializer, de};

use crate::render::texture::Texture;
use crate::render::texture::checker::Checker;
use crate::render::texture::value::{Alpha, Color, Light, Number, Share, Value};

/// The share of light of each channel that comes back: from 0 to 1.
pub type Reflectance = Parameter<Color<Share>>;

/// Radiance of each channel.
pub type Radiance = Parameter<Color<Light>>;

/// Width of a microfacet distribution: from 0.001 to 1.
pub type Roughness = Parameter<Number<Alpha>>;

/// A value, or a pattern of values.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Parameter<V> {
    /// The same everywhere.
    Constant(V),
    /// As the pattern says.
    Pattern(Pattern<V>),
}

/// Values that vary over a surface.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Pattern<V> {
    /// Squares of two values, alternating over u and v.
    Checker(CheckerParameters<V>),
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
    #[serde(default = "default_scale")]
    #[schemars(range(max = 1_000_000), extend("exclusiveMinimum" = 0))]
    pub scale: f64,
}

fn default_scale() -> f64 {
    1.0
}

impl<V: Value> Parameter<V> {
    /// As a scene holds it.
    pub fn texture(&self) -> Texture<V::Inner> {
        match self {
            Self::Constant(value) => Texture::Constant(value.inner()),
            Self::Pattern(Pattern::Checker(CheckerParameters { a, b, scale })) => {
                Texture::Checker(Checker { a: a.inner(), b: b.inner(), scale: *scale as f32 })
            }
        }
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
        out.write_str("a number, a color `[r, g, b]` or a texture `{ checker: {...} }`")
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
    use glam::{Vec2, Vec3};

    use super::*;
    use crate::render::texture::TexturePoint;

    #[test]
    fn a_number_a_color_and_a_pattern_are_read() {
        let at = TexturePoint { uv: Vec2::new(0.6, 0.1), position: Vec3::ZERO };
        let value = |text: &str| serde_yaml::from_str::<Reflectance>(text).unwrap().texture().at(&at);
        assert_eq!(value("0.25"), Vec3::splat(0.25));
        assert_eq!(value("1"), Vec3::ONE);
        assert_eq!(value("[0, 0.5, 1]"), Vec3::new(0.0, 0.5, 1.0));
        assert_eq!(value("{ checker: { a: 0, b: [1, 0.5, 0], scale: 2 } }"), Vec3::new(1.0, 0.5, 0.0));
    }

    #[test]
    fn what_is_written_comes_back() {
        for text in ["0.25", "[0.0,0.5,1.0]", r#"{"checker":{"a":0.0,"b":1.0,"scale":2.0}}"#] {
            let parameter: Reflectance = serde_yaml::from_str(text).unwrap();
            assert_eq!(serde_json::to_string(&parameter).unwrap(), text);
        }
    }

    #[test]
    fn wrong_values_are_refused() {
        for text in ["2", "-1", "[1, 1]", "text", "{ chequer: {} }", "{ checker: { a: 2, b: 0 } }", "{ checker: { a: 0, b: 0, c: 1 } }"] {
            assert!(serde_yaml::from_str::<Reflectance>(text).is_err(), "{text}");
        }
    }
}

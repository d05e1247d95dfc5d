//! A shape in its place: one kind key, with `transform`, `bsdf`, `emitter` and `medium` beside it.
//!
//! The kinds are those of [`Shape`]; its schema is spread into this one, so a new shape needs no row here.

use std::borrow::Cow;
use std::fmt;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::de::value::StrDeserializer;
use serde::de::{DeserializeSeed, EnumAccess, Error, IntoDeserializer, MapAccess, VariantAccess, Visitor};
use serde::ser::SerializeMap;
use serde::{Deserialize, Deserializer, Serialize, Serializer, forward_to_deserialize_any};
use serde_json::{Map, Value as Json, json};

use crate::render::bsdf::BsdfDescription;
use crate::render::emitter::ShapeEmitter;
use crate::render::medium::MediumDescription;
use crate::render::shape::Shape;
use crate::render::transform::Step;

/// A shape in its place.
#[derive(Debug, Clone, PartialEq)]
pub struct PlacedShape {
    /// What it is.
    pub shape: Shape,
    /// Where it is: steps, the first one applied first.
    pub transform: Vec<Step>,
    /// How it scatters light; by default `diffuse` with a reflectance of 0.5.
    pub bsdf: Option<BsdfChoice>,
    /// Light of its own; by default none.
    pub emitter: Option<ShapeEmitter>,
    /// What fills it; by default nothing.
    pub medium: Option<MediumDescription>,
}

/// A BSDF, or the name of one of the scene's materials.
#[derive(Debug, Clone, PartialEq)]
#[expect(clippy::large_enum_variant, reason = "a scene has few, and most are of the large variants")]
pub enum BsdfChoice {
    /// The name of a material.
    Named(String),
    /// The BSDF itself.
    Inline(BsdfDescription),
}

/// Keys that any shape may have beside its kind.
const OWN_KEYS: [&str; 4] = ["transform", "bsdf", "emitter", "medium"];

impl PlacedShape {
    /// A shape where its own coordinates put it, of the usual BSDF.
    pub fn of(shape: Shape) -> Self {
        Self { shape, transform: Vec::new(), bsdf: None, emitter: None, medium: None }
    }

    /// Whether it is nothing but the boundary of its medium, and no surface.
    pub fn is_boundary(&self) -> bool {
        self.medium.is_some() && self.bsdf.is_none() && self.emitter.is_none()
    }
}

impl Serialize for PlacedShape {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let shape = serde_json::to_value(&self.shape).map_err(serde::ser::Error::custom)?;
        let mut map = serializer.serialize_map(None)?;
        for (kind, parameters) in shape.as_object().into_iter().flatten() {
            map.serialize_entry(kind, parameters)?;
        }
        if !self.transform.is_empty() {
            map.serialize_entry("transform", &self.transform)?;
        }
        if let Some(bsdf) = &self.bsdf {
            map.serialize_entry("bsdf", bsdf)?;
        }
        if let Some(emitter) = &self.emitter {
            map.serialize_entry("emitter", emitter)?;
        }
        if let Some(medium) = &self.medium {
            map.serialize_entry("medium", medium)?;
        }
        map.end()
    }
}

impl<'de> Deserialize<'de> for PlacedShape {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_map(PlacedVisitor)
    }
}

struct PlacedVisitor;

impl<'de> Visitor<'de> for PlacedVisitor {
    type Value = PlacedShape;

    fn expecting(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str("a shape: one kind with its parameters, and `transform`, `bsdf`, `emitter` or `medium`")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<PlacedShape, A::Error> {
        let mut shape: Option<Shape> = None;
        let (mut transform, mut bsdf, mut emitter, mut medium) = (Vec::new(), None, None, None);
        while let Some(key) = map.next_key::<String>()? {
            match key.as_str() {
                "transform" => transform = map.next_value()?,
                "bsdf" => bsdf = Some(map.next_value()?),
                "emitter" => emitter = Some(map.next_value()?),
                "medium" => medium = Some(map.next_value()?),
                kind => {
                    let found = map.next_value_seed(OfKind(kind))?;
                    if shape.replace(found).is_some() {
                        return Err(A::Error::custom("a shape has one kind, and this one has two"));
                    }
                }
            }
        }
        let shape = shape.ok_or_else(|| A::Error::custom("the kind of the shape is missing"))?;
        Ok(PlacedShape { shape, transform, bsdf, emitter, medium })
    }
}

/// Reads the parameters of a shape whose kind is known.
struct OfKind<'k>(&'k str);

impl<'de> DeserializeSeed<'de> for OfKind<'_> {
    type Value = Shape;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Shape, D::Error> {
        Shape::deserialize(Tagged { kind: self.0, parameters: deserializer })
    }
}

/// An enum whose variant and content come from different places.
struct Tagged<'k, D> {
    kind: &'k str,
    parameters: D,
}

impl<'de, D: Deserializer<'de>> Deserializer<'de> for Tagged<'_, D> {
    type Error = D::Error;

    fn deserialize_any<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, D::Error> {
        visitor.visit_enum(self)
    }

    forward_to_deserialize_any! {
        bool i8 i16 i32 i64 i128 u8 u16 u32 u64 u128 f32 f64 char str string bytes byte_buf option unit unit_struct
        newtype_struct seq tuple tuple_struct map struct enum identifier ignored_any
    }
}

impl<'de, D: Deserializer<'de>> EnumAccess<'de> for Tagged<'_, D> {
    type Error = D::Error;
    type Variant = Content<D>;

    fn variant_seed<V: DeserializeSeed<'de>>(self, seed: V) -> Result<(V::Value, Content<D>), D::Error> {
        let kind: StrDeserializer<'_, D::Error> = self.kind.into_deserializer();
        Ok((seed.deserialize(kind)?, Content(self.parameters)))
    }
}

/// What stands under the kind.
struct Content<D>(D);

impl<'de, D: Deserializer<'de>> VariantAccess<'de> for Content<D> {
    type Error = D::Error;

    fn unit_variant(self) -> Result<(), D::Error> {
        Err(D::Error::custom("a kind has a map of parameters, `{}` if there are none"))
    }

    fn newtype_variant_seed<T: DeserializeSeed<'de>>(self, seed: T) -> Result<T::Value, D::Error> {
        seed.deserialize(self.0)
    }

    fn tuple_variant<V: Visitor<'de>>(self, _: usize, visitor: V) -> Result<V::Value, D::Error> {
        self.0.deserialize_any(visitor)
    }

    fn struct_variant<V: Visitor<'de>>(self, _: &'static [&'static str], visitor: V) -> Result<V::Value, D::Error> {
        self.0.deserialize_any(visitor)
    }
}

impl JsonSchema for PlacedShape {
    fn schema_name() -> Cow<'static, str> {
        "PlacedShape".into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        let shapes: Json = Shape::json_schema(generator).into();
        let mut properties = Map::new();
        for alternative in shapes.get("oneOf").and_then(Json::as_array).into_iter().flatten() {
            let description = alternative.get("description").cloned();
            for (kind, schema) in alternative.get("properties").and_then(Json::as_object).into_iter().flatten() {
                let described = match &description {
                    Some(text) => json!({ "description": text, "allOf": [schema] }),
                    None => schema.clone(),
                };
                properties.insert(kind.clone(), described);
            }
        }
        let kinds: Vec<String> = properties.keys().cloned().collect();
        let own = [
            ("Where it is: steps, the first one applied first.", generator.subschema_for::<Vec<Step>>()),
            (
                "How it scatters light: a BSDF, or the name of a material. Default `diffuse` with a reflectance of 0.5; of a shape \
                 with a medium alone, none: light passes its surface.",
                generator.subschema_for::<BsdfChoice>(),
            ),
            ("Light of its own. Default none.", generator.subschema_for::<ShapeEmitter>()),
            ("What fills it, for the integrator `volume-path`. Default nothing.", generator.subschema_for::<MediumDescription>()),
        ];
        for (name, (description, schema)) in OWN_KEYS.into_iter().zip(own) {
            properties.insert(name.to_owned(), json!({ "description": description, "allOf": [schema] }));
        }
        json_schema!({ "type": "object", "properties": properties, "additionalProperties": false, "x-one-of": kinds })
    }
}

impl Serialize for BsdfChoice {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Named(name) => serializer.serialize_str(name),
            Self::Inline(description) => description.serialize(serializer),
        }
    }
}

impl<'de> Deserialize<'de> for BsdfChoice {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Choice;

        impl<'de> Visitor<'de> for Choice {
            type Value = BsdfChoice;

            fn expecting(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
                out.write_str("a BSDF, or the name of a material")
            }

            fn visit_str<E: Error>(self, name: &str) -> Result<BsdfChoice, E> {
                Ok(BsdfChoice::Named(name.to_owned()))
            }

            fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<BsdfChoice, A::Error> {
                BsdfDescription::deserialize(serde::de::value::MapAccessDeserializer::new(map)).map(BsdfChoice::Inline)
            }
        }

        deserializer.deserialize_any(Choice)
    }
}

impl JsonSchema for BsdfChoice {
    fn schema_name() -> Cow<'static, str> {
        "BsdfChoice".into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        let bsdf = generator.subschema_for::<BsdfDescription>();
        json_schema!({ "anyOf": [bsdf, { "type": "string", "minLength": 1 }] })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_placed_shape_is_written_as_it_is_read() {
        for text in [
            r#"{"sphere":{"center":[1.0,2.0,3.0],"radius":2.0},"bsdf":"copper"}"#,
            r#"{"rectangle":{},"transform":[{"translate":[0.0,3.0,0.0]}],"emitter":{"area":{"radiance":[4.0,3.0,1.0]}}}"#,
            r#"{"box":{"min":[-1.0,-1.0,-1.0],"max":[1.0,1.0,1.0]},"medium":{"homogeneous":{"sigma_t":1.5,"albedo":[0.9,0.8,0.6],"phase":{"henyey-greenstein":{"g":0.6}}}}}"#,
        ] {
            let placed: PlacedShape = serde_json::from_str(text).unwrap();
            assert_eq!(serde_json::to_string(&placed).unwrap(), text);
            let yaml: PlacedShape =
                serde_yaml::with::singleton_map_recursive::deserialize(serde_yaml::Deserializer::from_str(text)).unwrap();
            assert_eq!(yaml, placed);
        }
    }

    #[test]
    fn a_shape_has_exactly_one_kind() {
        let error = |text: &str| serde_json::from_str::<PlacedShape>(text).unwrap_err().to_string();
        assert!(error(r#"{"bsdf":"copper"}"#).contains("missing"));
        assert!(error(r#"{"rectangle":{},"sphere":{}}"#).contains("two"));
        assert!(error(r#"{"shpere":{}}"#).contains("shpere"));
    }
}

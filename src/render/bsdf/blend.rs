//! Two BSDFs, mixed by a number or a texture.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use glam::Vec3;

use crate::render::bsdf::material::Material;
use crate::render::bsdf::{Bsdf, BsdfDescription, BsdfError, BsdfSample, DirectionSampling, Transport};
use crate::render::texture::parameter::{Parameter, Pictures, Portion};
use crate::render::texture::value::Number;
use crate::render::texture::{Texture, TexturePoint};

/// Two BSDFs, mixed by a number or a texture: (1 - weight) `first` + weight `second`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct BlendParameters {
    /// Share of `second`, 0 to 1: a number or a texture.
    #[serde(default = "half")]
    pub weight: Portion,
    /// The BSDF where the weight is 0; it may be a blend itself.
    pub first: Box<BsdfDescription>,
    /// The BSDF where the weight is 1; it may be a blend itself.
    pub second: Box<BsdfDescription>,
}

fn half() -> Portion {
    Parameter::Constant(Number::new(0.5).expect("within the limits"))
}

/// Two materials of a scene, mixed.
#[derive(Debug, Clone, PartialEq)]
pub struct BlendMaterial {
    weight: Texture<f32>,
    first: Box<Material>,
    second: Box<Material>,
}

impl BlendMaterial {
    /// With these parameters, and those pictures for its textures.
    pub fn new(parameters: &BlendParameters, directions: DirectionSampling, pictures: &dyn Pictures) -> Result<Self, BsdfError> {
        let material = |part: &BsdfDescription| Material::with_pictures(part, directions, pictures).map(Box::new);
        Ok(Self {
            weight: parameters.weight.texture(pictures)?,
            first: material(&parameters.first)?,
            second: material(&parameters.second)?,
        })
    }

    /// What it is at that point.
    pub fn at(&self, point: &TexturePoint) -> Blend<'_> {
        Blend { material: self, weight: self.weight.at(point), point: *point }
    }

    /// Whether light passes through one of both.
    pub fn is_transmissive(&self) -> bool {
        self.first.is_transmissive() || self.second.is_transmissive()
    }
}

/// Two BSDFs at one point, mixed. They are looked up when they are asked for: a copy would hold any number of others.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Blend<'m> {
    material: &'m BlendMaterial,
    weight: f32,
    point: TexturePoint,
}

impl<'m> Blend<'m> {
    /// Both BSDFs.
    pub fn parts(&self) -> [Bsdf<'m>; 2] {
        [self.material.first.at(&self.point), self.material.second.at(&self.point)]
    }

    /// Draws from one of both; the value is that of both, but for delta lobes.
    pub fn sample(&self, outgoing: Vec3, choice: f32, point: [f32; 2], transport: Transport) -> Option<BsdfSample> {
        let [first, second] = self.parts();
        // What is left of the number chooses within the part.
        let (drawn, share, choice) = match choice < self.weight {
            true => (second, self.weight, choice / self.weight),
            false => (first, 1.0 - self.weight, (choice - self.weight) / (1.0 - self.weight)),
        };
        let sample = drawn.sample(outgoing, choice.min(1.0 - f32::EPSILON / 2.0), point, transport)?;
        if sample.is_delta {
            return Some(BsdfSample { pdf: share * sample.pdf, ..sample });
        }
        let (value, pdf) = self.evaluate_with_pdf(outgoing, sample.direction, transport);
        (pdf > 0.0).then(|| BsdfSample { weight: value / pdf, pdf, ..sample })
    }

    /// The mean of both, weighted.
    pub fn evaluate_with_pdf(&self, outgoing: Vec3, incoming: Vec3, transport: Transport) -> (Vec3, f32) {
        let [(value, pdf), (other_value, other_pdf)] = self.parts().map(|part| part.evaluate_with_pdf(outgoing, incoming, transport));
        (value.lerp(other_value, self.weight), pdf + (other_pdf - pdf) * self.weight)
    }

    /// The mean of both, weighted.
    pub fn albedo(&self) -> Vec3 {
        let [first, second] = self.parts().map(|part| part.albedo());
        first.lerp(second, self.weight)
    }
}

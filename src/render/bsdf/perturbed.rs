//! Normals that a texture bends: normal maps and bump maps over any BSDF.
//!
//! The bent normal lies in the frame for shading, z its normal and x along dp/du. A direction counts only if it is on
//! the same side of the surface by both normals, in values, densities and drawn directions alike. Where the bent normal
//! turns away from who looks, it is mirrored at the normal (x and y negated): that facet has a neighbor which is seen
//! (after Schuessler et al., "Microfacet-based normal mapping for robust Monte Carlo path tracing", 2017).

use glam::Vec3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::render::bsdf::material::Material;
use crate::render::bsdf::{Bsdf, BsdfDescription, BsdfError, DirectionSampling};
use crate::render::frame::Frame;
use crate::render::texture::parameter::{Parameter, Pictures};
use crate::render::texture::value::{Color, Component, Height, Number};
use crate::render::texture::{Texture, TexturePoint};

/// A BSDF whose normals a picture holds, in the frame of the surface: x along u, z away from it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct NormalMapParameters {
    /// The normals, each component c as (c + 1) / 2; `[0.5, 0.5, 1]` bends nothing. In 8 bits no value is 0.5: 128 tilts
    /// by 0.32 degrees.
    pub map: Parameter<Color<Component>>,
    /// Factor on the slopes. Default 1.
    #[serde(default = "one")]
    #[schemars(range(min = 0, max = 1000))]
    pub scale: f64,
    /// How light that the bent normals alone would let in is softened.
    #[serde(default)]
    pub shadowing: Shadowing,
    /// The BSDF; its normals may be bent again.
    pub bsdf: Box<BsdfDescription>,
}

/// A BSDF whose normals are those of a relief of small heights.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct BumpMapParameters {
    /// Heights along the normal, in the units of the world: a texture. Steps have no slope.
    pub map: Parameter<Number<Height>>,
    /// Factor on the heights. Default 1.
    #[serde(default = "one")]
    #[schemars(range(min = -1e6, max = 1e6))]
    pub scale: f64,
    /// How light that the bent normals alone would let in is softened.
    #[serde(default)]
    pub shadowing: Shadowing,
    /// The BSDF; its normals may be bent again.
    pub bsdf: Box<BsdfDescription>,
}

/// How light that bent normals alone would let in is softened.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Shadowing {
    /// Not at all: light ends at the horizon of the surface.
    #[default]
    None,
    /// As by facets of which the bent normal is one: smooth towards the horizon, and darker (Conty Estevez et al. 2019;
    /// Mitsuba's default).
    Microfacet,
}

fn one() -> f64 {
    1.0
}

/// A material whose normals are bent.
#[derive(Debug, Clone, PartialEq)]
pub struct PerturbedMaterial {
    normals: Normals,
    shadowing: Shadowing,
    inner: Box<Material>,
}

/// Where bent normals come from.
#[derive(Debug, Clone, PartialEq)]
enum Normals {
    Map { map: Texture<Vec3>, scale: f32 },
    Bump { heights: Texture<f32>, scale: f32 },
}

impl PerturbedMaterial {
    /// Normals from a picture.
    pub fn normal_map(parameters: &NormalMapParameters, directions: DirectionSampling, pictures: &dyn Pictures) -> Result<Self, BsdfError> {
        let normals = Normals::Map { map: parameters.map.texture(pictures)?, scale: parameters.scale as f32 };
        let inner = Box::new(Material::with_pictures(&parameters.bsdf, directions, pictures)?);
        Ok(Self { normals, shadowing: parameters.shadowing, inner })
    }

    /// Normals of a relief.
    pub fn bump_map(parameters: &BumpMapParameters, directions: DirectionSampling, pictures: &dyn Pictures) -> Result<Self, BsdfError> {
        let normals = Normals::Bump { heights: parameters.map.texture(pictures)?, scale: parameters.scale as f32 };
        let inner = Box::new(Material::with_pictures(&parameters.bsdf, directions, pictures)?);
        Ok(Self { normals, shadowing: parameters.shadowing, inner })
    }

    /// What it is at that point.
    pub fn at(&self, point: &TexturePoint) -> Bsdf<'_> {
        let normal = self.normals.at(point);
        if normal == Vec3::Z {
            return self.inner.at(point);
        }
        let frame = Frame::along(normal, Vec3::X);
        let tangents = point.tangents.map(|tangent| frame.to_local(tangent));
        self.inner.at(&TexturePoint { tangents, ..*point }).bent(&frame, self.shadowing)
    }

    /// Whether light passes through.
    pub fn is_transmissive(&self) -> bool {
        self.inner.is_transmissive()
    }
}

impl Normals {
    /// The unit normal there, on the side of z; z itself where the texture gives none.
    fn at(&self, point: &TexturePoint) -> Vec3 {
        let bent = match self {
            Self::Map { map, scale } => (map.at(point) * 2.0 - Vec3::ONE) * Vec3::new(*scale, *scale, 1.0),
            Self::Bump { heights, scale } => {
                let slopes = heights.slope(point).map(|slope| slope * scale);
                // Tangents of the raised surface; what they had along the normal is replaced.
                let [u, v] = [0, 1].map(|k| point.tangents[k].truncate().extend(slopes[k]));
                let cross = u.cross(v);
                // A mirrored uv turns the cross product round.
                if cross.z < 0.0 { -cross } else { cross }
            }
        };
        // What bends nothing is z to the last digit.
        let is_bent = bent.x != 0.0 || bent.y != 0.0;
        let is_usable = is_bent && bent.z > 0.0 && bent.is_finite() && bent.length_squared().is_normal();
        if is_usable { bent.normalize() } else { Vec3::Z }
    }
}

/// A normal that is bent, in the frame for shading.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bend {
    /// Unit vector, z above 0.
    pub normal: Vec3,
    /// How light beyond it is softened.
    pub shadowing: Shadowing,
}

impl Bend {
    /// The frame about the bent normal as it is seen from `outgoing`; `None` where it is seen from neither side.
    #[inline]
    pub fn frame(&self, outgoing: Vec3) -> Option<Frame> {
        let is_seen = |normal: Vec3| normal.dot(outgoing) * outgoing.z > 0.0;
        let mirrored = Vec3::new(-self.normal.x, -self.normal.y, self.normal.z);
        let normal = [self.normal, mirrored].into_iter().find(|normal| is_seen(*normal))?;
        Some(Frame::along(normal, Vec3::X))
    }

    /// Factor on the light from that direction: 2 / (1 + sqrt(1 + a² tan²)), a² = min(1, tan²(bent normal) / 8).
    #[inline]
    pub fn shadow(&self, incoming: Vec3) -> f32 {
        let tan2 = |w: Vec3| (w.x * w.x + w.y * w.y) / (w.z * w.z);
        match self.shadowing {
            Shadowing::None => 1.0,
            Shadowing::Microfacet => 2.0 / (1.0 + (1.0 + (0.125 * tan2(self.normal)).min(1.0) * tan2(incoming)).sqrt()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::sphere::uniform_sphere;
    use crate::math::stream::{Purpose, Stream};
    use crate::render::bsdf::Transport;

    fn material(text: &str) -> Material {
        let json: serde_json::Value = serde_yaml::from_str(text).unwrap();
        Material::new(&serde_json::from_value(json).unwrap(), DirectionSampling::Bsdf).unwrap()
    }

    fn directions(count: u64, seed: u64) -> impl Iterator<Item = Vec3> {
        let stream = Stream::new(seed, Purpose::Test);
        (0..count).map(move |index| uniform_sphere(stream.generator(index).uniform_pair()).as_vec3().normalize())
    }

    /// Each of the kinds, under a bend of BEND.
    const KINDS: [&str; 6] = [
        "diffuse: {}",
        "rough-conductor: { metal: gold, alpha: 0.4 }",
        "plastic: {}",
        "rough-dielectric: { alpha: 0.3 }",
        "mirror: {}",
        "blend: { first: { diffuse: {} }, second: { mirror: {} } }",
    ];

    #[test]
    fn a_flat_map_changes_nothing_at_all() {
        for kind in KINDS {
            let plain = material(kind);
            for flat in [
                format!("normal-map: {{ map: [0.5, 0.5, 1], bsdf: {{ {kind} }} }}"),
                format!("normal-map: {{ map: [0.9, 0.2, 0.8], scale: 0, bsdf: {{ {kind} }} }}"),
                format!("bump-map: {{ map: {{ perlin: {{ a: 3, b: 3 }} }}, bsdf: {{ {kind} }} }}"),
            ] {
                let bent = material(&flat);
                for (outgoing, incoming) in directions(50, 1).zip(directions(50, 2)) {
                    let value = |material: &Material| {
                        material.at(&TexturePoint::ANYWHERE).evaluate_with_pdf(outgoing, incoming, Transport::Radiance)
                    };
                    assert_eq!(value(&plain), value(&bent), "{flat}");
                    let drawn =
                        |material: &Material| material.at(&TexturePoint::ANYWHERE).sample(outgoing, 0.3, [0.2, 0.7], Transport::Radiance);
                    assert_eq!(drawn(&plain), drawn(&bent), "{flat}");
                }
            }
        }
    }

    #[test]
    fn directions_on_other_sides_of_both_normals_count_for_nothing() {
        for kind in KINDS {
            let material = material(&format!("normal-map: {{ map: [0.9, 0.4, 0.75], bsdf: {{ {kind} }} }}"));
            let bsdf = material.at(&TexturePoint::ANYWHERE);
            let normal = bsdf.shading_normal();
            assert!((normal - Vec3::new(0.8, -0.2, 0.5).normalize()).length() < 1e-6);
            let mut mirrored = 0;
            for (outgoing, incoming) in directions(2000, 1).zip(directions(2000, 2)) {
                let is_flipped = normal.dot(outgoing) * outgoing.z <= 0.0;
                let seen = if is_flipped { Vec3::new(-normal.x, -normal.y, normal.z) } else { normal };
                let (value, pdf) = bsdf.evaluate_with_pdf(outgoing, incoming, Transport::Radiance);
                let agrees = seen.dot(incoming) * incoming.z > 0.0;
                assert!(agrees || (value == Vec3::ZERO && pdf == 0.0), "{kind}");
                if is_flipped && value != Vec3::ZERO {
                    mirrored += 1;
                }
                for choice in [0.1, 0.6, 0.99] {
                    if let Some(sample) = bsdf.sample(outgoing, choice, [0.3, 0.8], Transport::Radiance) {
                        assert!(seen.dot(sample.direction) * sample.direction.z > 0.0, "{kind}");
                        let (value, pdf) = bsdf.evaluate_with_pdf(outgoing, sample.direction, Transport::Radiance);
                        assert!(sample.is_delta || (pdf / sample.pdf - 1.0).abs() < 1e-2, "{kind}: {pdf} {sample:?}");
                        assert!(sample.is_delta || (value / pdf - sample.weight).abs().max_element() < 1e-2, "{kind}");
                    }
                }
            }
            assert!(mirrored > 100 || kind.starts_with("mirror"), "{kind}: {mirrored}");
        }
    }

    /// Lambert's surface under a bent normal m: rho / pi (m.i) for light above both horizons, and softened as published.
    #[test]
    fn a_diffuse_surface_is_lit_by_the_bent_normal() {
        let text = |more: &str| format!("normal-map: {{ map: [0.75, 0.5, 1] {more}, bsdf: {{ diffuse: {{ reflectance: 1 }} }} }}");
        let (hard, soft) = (material(&text("")), material(&text(", shadowing: microfacet")));
        let normal = Vec3::new(0.5, 0.0, 1.0).normalize();
        let incoming = Vec3::new(-0.6, 0.0, 0.8);
        let value =
            |material: &Material| material.at(&TexturePoint::ANYWHERE).evaluate_with_pdf(Vec3::Z, incoming, Transport::Radiance).0.x;
        let expected = normal.dot(incoming) * std::f32::consts::FRAC_1_PI;
        assert!((value(&hard) - expected).abs() < 1e-6);
        // tan² of the normal is 1/4, of the light 9/16: a² = 1/32.
        let factor = 2.0 / (1.0 + (1.0 + 9.0 / 512.0_f32).sqrt());
        assert!((value(&soft) - expected * factor).abs() < 1e-6);
    }

    #[test]
    fn normals_are_bent_again_in_the_bent_frame() {
        let once = "normal-map: { map: [0.75, 0.5, 1], bsdf: { diffuse: {} } }";
        let twice = material(&format!("normal-map: {{ map: [0.5, 0.75, 1], bsdf: {{ {once} }} }}"));
        let frame = Frame::along(Vec3::new(0.0, 0.5, 1.0).normalize(), Vec3::X);
        let expected = frame.to_world(Vec3::new(0.5, 0.0, 1.0).normalize());
        assert!((twice.at(&TexturePoint::ANYWHERE).shading_normal() - expected).length() < 1e-6);
    }

    /// h(u, v) = u / 4 over tangents of length 2 and 1: dz/dx = 1/8, whichever way v goes.
    #[test]
    fn a_bump_map_has_the_normal_of_its_relief() {
        let bump = material("bump-map: { map: { uv: {} }, scale: 0.25, bsdf: { diffuse: {} } }");
        for v in [1.0, -1.0] {
            let tangents = [Vec3::new(2.0, 0.0, 0.3), Vec3::new(0.5, v, 0.0)];
            let normal = bump.at(&TexturePoint { tangents, ..TexturePoint::ANYWHERE }).shading_normal();
            // dz/du = 1/4 = 2 dz/dx, and dz/dv = 0 = dz/dx / 2 + v dz/dy.
            let slope = [0.125, -0.0625 / v];
            let expected = Vec3::new(-slope[0], -slope[1], 1.0).normalize();
            assert!((normal - expected).length() < 1e-6, "{normal} instead of {expected}");
        }
    }
}

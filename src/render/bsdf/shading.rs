//! Scattering in the world, where the shading normal may differ from that of the geometry.
//!
//! Here alone is the guard against light that leaks through a surface: a direction counts only if both normals
//! agree on which side of the surface it is, in values, densities and drawn directions alike.

use glam::Vec3;
use wide::f32x4;

use crate::render::bsdf::{Bsdf, BsdfSample, Transport};
use crate::render::frame::Frame;
use crate::render::lanes::{Vectors, Weighted};

/// A BSDF in its place, seen from one direction.
#[derive(Debug, Clone, Copy)]
pub struct Shading<'m> {
    bsdf: Bsdf<'m>,
    frame: Frame,
    /// In the frame, on the side of its z.
    geometric: Vec3,
    /// In the frame.
    outgoing: Vec3,
}

impl<'m> Shading<'m> {
    /// A surface of that frame and geometric normal, seen from the direction `outgoing`; all in the world.
    ///
    /// Where the shading normal shows `outgoing` the wrong side, as interpolated normals do at silhouettes, the
    /// geometric one takes its place: black or leaking pixels would be the alternatives.
    #[inline]
    pub fn new(bsdf: Bsdf<'m>, frame: &Frame, geometric_normal: Vec3, outgoing: Vec3) -> Self {
        let normal = if geometric_normal.dot(frame.normal) < 0.0 { -geometric_normal } else { geometric_normal };
        let local = frame.to_local(outgoing);
        let agrees = local.z * normal.dot(outgoing) > 0.0;
        if agrees {
            return Self { bsdf, frame: *frame, geometric: frame.to_local(normal), outgoing: local };
        }
        let flat = Frame::along(normal, frame.tangent);
        Self { bsdf, frame: flat, geometric: Vec3::Z, outgoing: flat.to_local(outgoing) }
    }

    /// Draws a direction of the world; see [`Bsdf::sample`].
    #[inline]
    pub fn sample(&self, choice: f32, point: [f32; 2], transport: Transport) -> Option<BsdfSample> {
        let sample = self.bsdf.sample(self.outgoing, choice, point, transport)?;
        let is_honest = self.agrees(sample.direction);
        is_honest.then(|| BsdfSample { direction: self.frame.to_world(sample.direction).normalize(), ..sample })
    }

    /// Value times |cosine| and density for a direction of the world; see [`Bsdf::evaluate_with_pdf`].
    #[inline]
    pub fn evaluate_with_pdf(&self, incoming: Vec3, transport: Transport) -> (Vec3, f32) {
        let local = self.frame.to_local(incoming);
        if !self.agrees(local) {
            return (Vec3::ZERO, 0.0);
        }
        self.bsdf.evaluate_with_pdf(self.outgoing, local, transport)
    }

    /// The same for four directions at once.
    #[inline]
    pub fn evaluate_lanes(&self, incoming: &Vectors, transport: Transport) -> Weighted {
        let local = self.frame.to_local_lanes(incoming);
        let Some(Weighted { value, pdf }) = self.bsdf.evaluate_lanes(self.outgoing, &local) else {
            return Weighted::one_by_one(incoming, |incoming| self.evaluate_with_pdf(incoming, transport));
        };
        let agrees = (local.z * local.dot(self.geometric)).simd_gt(f32x4::ZERO);
        Weighted { value: Vectors { x: value.x & agrees, y: value.y & agrees, z: value.z & agrees }, pdf: pdf & agrees }
    }

    /// The BSDF.
    pub fn bsdf(&self) -> &Bsdf<'m> {
        &self.bsdf
    }

    /// Whether both normals see a direction of the frame on the same side.
    fn agrees(&self, local: Vec3) -> bool {
        local.z * self.geometric.dot(local) > 0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::sphere::uniform_sphere;
    use crate::math::stream::{Purpose, Stream};
    use crate::render::bsdf::material::Material;
    use crate::render::bsdf::{BsdfDescription, DirectionSampling};
    use crate::render::texture::TexturePoint;

    fn bsdf(json: &str) -> Bsdf<'static> {
        let description: BsdfDescription = serde_json::from_str(json).unwrap();
        let material = Material::new(&description, DirectionSampling::Bsdf).unwrap();
        Box::leak(Box::new(material)).at(&TexturePoint::ANYWHERE)
    }

    fn bsdfs() -> [Bsdf<'static>; 4] {
        let bent = r#"{"normal-map":{"map":[0.7,0.4,0.9],"bsdf":{"diffuse":{}}}}"#;
        [r#"{"diffuse":{}}"#, r#"{"rough-conductor":{"metal":"gold","alpha":0.3}}"#, r#"{"rough-dielectric":{"alpha":0.3}}"#, bent]
            .map(bsdf)
    }

    /// Random directions: geometric normal, shading normal within 40 degrees or so, outgoing, incoming.
    fn situations() -> impl Iterator<Item = [Vec3; 4]> {
        let stream = Stream::new(5, Purpose::Test);
        (0..3000).map(move |index| {
            let mut numbers = stream.generator(index);
            let [geometric, tilt, outgoing, incoming] =
                std::array::from_fn(|_| uniform_sphere(numbers.uniform_pair()).as_vec3().normalize());
            [geometric, (geometric + 0.6 * tilt).normalize(), outgoing, incoming]
        })
    }

    #[test]
    fn no_light_leaks_through_whatever_the_shading_normal() {
        for bsdf in bsdfs() {
            for [geometric, shading, outgoing, incoming] in situations() {
                let is_passed = geometric.dot(outgoing) * geometric.dot(incoming) < 0.0;
                let place = Shading::new(bsdf, &Frame::about(shading), geometric, outgoing);
                let (value, pdf) = place.evaluate_with_pdf(incoming, Transport::Radiance);
                assert!(!is_passed || bsdf.is_transmissive() || (value == Vec3::ZERO && pdf == 0.0));
                if let Some(sample) = place.sample(0.3, [0.2, 0.7], Transport::Radiance) {
                    let is_passed = geometric.dot(outgoing) * geometric.dot(sample.direction) < 0.0;
                    assert_eq!(is_passed, sample.eta != 1.0, "{geometric} {shading} {outgoing} {sample:?}");
                }
            }
        }
    }

    #[test]
    fn lanes_have_the_bits_of_single_directions() {
        let others = [r#"{"diffuse":{"reflectance":[0.2,0.5,0.9],"one_sided":true}}"#, r#"{"plastic":{}}"#].map(bsdf);
        for bsdf in bsdfs().into_iter().chain(others) {
            let situations: Vec<[Vec3; 4]> = situations().collect();
            for four in situations.as_chunks::<4>().0 {
                let [geometric, shading, outgoing, _] = four[0];
                let place = Shading::new(bsdf, &Frame::about(shading), geometric, outgoing);
                let incoming = four.map(|[_, _, _, incoming]| incoming);
                let Weighted { value, pdf } = place.evaluate_lanes(&Vectors::of(incoming), Transport::Radiance);
                for (lane, incoming) in incoming.into_iter().enumerate() {
                    let single = place.evaluate_with_pdf(incoming, Transport::Radiance);
                    assert_eq!((value.lane(lane), pdf.to_array()[lane]), single, "{bsdf:?}");
                }
            }
        }
    }

    #[test]
    fn drawn_directions_have_the_density_and_value_that_is_told_of_them() {
        for bsdf in bsdfs() {
            for [geometric, shading, outgoing, _] in situations() {
                let place = Shading::new(bsdf, &Frame::about(shading), geometric, outgoing);
                let Some(sample) = place.sample(0.6, [0.4, 0.1], Transport::Radiance) else { continue };
                let (value, pdf) = place.evaluate_with_pdf(sample.direction, Transport::Radiance);
                assert!((pdf / sample.pdf - 1.0).abs() < 1e-3, "{pdf} {sample:?}");
                assert!((value / pdf - sample.weight).abs().max_element() < 1e-3 * sample.weight.max_element().max(0.1));
            }
        }
    }

    #[test]
    fn equal_normals_change_nothing_and_the_sign_of_the_geometric_one_does_not_matter() {
        let bsdf = bsdf(r#"{"rough-conductor":{"metal":"gold","alpha":0.3}}"#);
        for [normal, shading, outgoing, incoming] in situations() {
            let frame = Frame::about(normal);
            let place = Shading::new(bsdf, &frame, normal, outgoing);
            let local = bsdf.evaluate_with_pdf(frame.to_local(outgoing), frame.to_local(incoming), Transport::Radiance);
            assert_eq!(place.evaluate_with_pdf(incoming, Transport::Radiance), local);
            let frame = Frame::about(shading);
            let [one, other] = [normal, -normal].map(|normal| Shading::new(bsdf, &frame, normal, outgoing));
            let value = |place: &Shading| place.evaluate_with_pdf(incoming, Transport::Radiance);
            assert_eq!(value(&one), value(&other));
        }
    }

    #[test]
    fn a_silhouette_is_lit_rather_than_black() {
        let geometric = Vec3::Z;
        let shading = Vec3::new(0.8, 0.0, 0.6);
        let outgoing = Vec3::new(-0.995, 0.0, 0.0998).normalize();
        assert!(shading.dot(outgoing) < 0.0 && geometric.dot(outgoing) > 0.0);
        let place = Shading::new(bsdf(r#"{"diffuse":{"reflectance":1}}"#), &Frame::about(shading), geometric, outgoing);
        let (value, _) = place.evaluate_with_pdf(Vec3::Z, Transport::Radiance);
        assert!((value.x - std::f32::consts::FRAC_1_PI).abs() < 1e-6);
    }
}

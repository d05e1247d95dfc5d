//! Scattering in the world, where the shading normal may differ from that of the geometry.
//!
//! Here alone is the guard against light that leaks through a surface: a direction counts only if both normals
//! agree on which side of the surface it is, in values, densities and drawn directions alike.

use glam::Vec3;

use crate::render::bsdf::{Bsdf, BsdfSample, Transport};
use crate::render::frame::Frame;

/// A BSDF in its place, seen from one direction.
#[derive(Debug, Clone, Copy)]
pub struct Shading {
    bsdf: Bsdf,
    frame: Frame,
    /// In the frame, on the side of its z.
    geometric: Vec3,
    /// In the frame.
    outgoing: Vec3,
}

impl Shading {
    /// A surface of that frame and geometric normal, seen from the direction `outgoing`; all in the world.
    ///
    /// Where the shading normal shows `outgoing` the wrong side, as interpolated normals do at silhouettes, the
    /// geometric one takes its place: black or leaking pixels would be the alternatives.
    #[inline]
    pub fn new(bsdf: Bsdf, frame: &Frame, geometric_normal: Vec3, outgoing: Vec3) -> Self {
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

    /// The BSDF.
    pub fn bsdf(&self) -> &Bsdf {
        &self.bsdf
    }

    /// Whether both normals see a direction of the frame on the same side.
    fn agrees(&self, local: Vec3) -> bool {
        local.z * self.geometric.dot(local) > 0.0
    }
}

//! All media of a scene, and which of them a ray is in.
//!
//! Nothing is remembered along a path: for each ray it is found anew in which shapes its origin lies, by whether it leaves
//! or enters each of them first. So a point that rounding put on the wrong side of a boundary leads to no wrong medium
//! further on. Shapes with a medium alone are no surfaces; they stand here and not among those that rays hit, so a
//! path past them has the bits of one without them. Where media overlap, the one that stands last in the scene counts.

use glam::Vec3;

use crate::render::medium::phase::Phase;
use crate::render::medium::{Flight, Medium, Stretch, Tracking, exponential_variate};
use crate::render::ray::Ray;
use crate::render::sampler::Further;
use crate::render::shape::geometry::Geometry;

/// Most shapes of a scene that have a medium: one bit each.
pub const MEDIA_LIMIT: usize = 64;

/// All media of a scene.
#[derive(Debug, Clone)]
pub struct Media {
    /// The shapes that they fill, in the order of the scene.
    boundaries: Geometry,
    /// What fills each of them.
    media: Vec<Medium>,
    tracking: Tracking,
}

/// A place where a medium scatters a ray.
#[derive(Debug, Clone, Copy)]
pub struct Collision<'a> {
    /// Where.
    pub position: Vec3,
    /// What is left of the light that is scattered.
    pub weight: Vec3,
    /// Into which directions.
    pub phase: &'a Phase,
}

impl Media {
    /// Media, and the shapes that they fill.
    pub fn new(boundaries: Geometry, media: Vec<Medium>, tracking: Tracking) -> Self {
        Self { boundaries, media, tracking }
    }

    /// Whether there are none.
    #[inline]
    pub fn is_empty(&self) -> bool {
        self.media.is_empty()
    }

    /// Where a ray collides before its reach; `u`, from [0, 1), is the first number that this takes.
    #[inline]
    pub fn collision(&self, ray: &Ray, u: f64, further: &mut Further) -> Option<Collision<'_>> {
        if self.is_empty() {
            return None;
        }
        let mut left = exponential_variate(u);
        self.stretches(ray, |medium, stretch| match medium.fly(ray, stretch, left, self.tracking, further) {
            Flight::Passed { left: rest } => {
                left = rest;
                None
            }
            Flight::Collided { distance, weight } => {
                let position = (ray.origin.as_dvec3() + ray.direction.as_dvec3() * distance).as_vec3();
                Some(Collision { position, weight, phase: medium.phase() })
            }
        })
    }

    /// The share of light that comes through along a ray up to its reach: exact or an estimate, from 0 to 1.
    #[inline]
    pub fn transmittance(&self, ray: &Ray, further: &mut Further) -> f32 {
        if self.is_empty() {
            return 1.0;
        }
        let mut share = 1.0;
        let _: Option<()> = self.stretches(ray, |medium, stretch| {
            share *= medium.transmittance(ray, stretch, self.tracking, further);
            (share == 0.0).then_some(())
        });
        share as f32
    }

    /// Goes along a ray from medium to medium, until one of them has an answer.
    fn stretches<'a, A>(&'a self, ray: &Ray, mut answer: impl FnMut(&'a Medium, Stretch) -> Option<A>) -> Option<A> {
        let mut inside = self.around(ray);
        let mut start = 0.0;
        let mut rest = *ray;
        loop {
            let hit = self.boundaries.intersect(&rest);
            let length = hit.map_or(rest.reach, |hit| hit.distance);
            let end = start + f64::from(length);
            // A medium has a boundary all around it: without one ahead its inside was left by rounding, or is open.
            if inside != 0 && length.is_finite() {
                let medium = &self.media[inside.ilog2() as usize];
                if let Some(found) = answer(medium, [start, end]) {
                    return Some(found);
                }
            }
            let hit = hit?;
            let surface = self.boundaries.surface(&rest, &hit);
            let bit = 1_u64 << hit.shape;
            if rest.direction.dot(surface.normal) < 0.0 {
                inside |= bit
            } else {
                inside &= !bit
            }
            start = end;
            rest = Ray { reach: rest.reach - hit.distance, ..surface.spawn(rest.direction) };
        }
    }

    /// The media in which a ray begins: the shapes that it leaves before it enters them.
    fn around(&self, ray: &Ray) -> u64 {
        let mut unknown = u64::MAX >> (MEDIA_LIMIT - self.media.len());
        let mut inside = 0;
        let mut rest = Ray { reach: f32::INFINITY, ..*ray };
        while unknown != 0 {
            let Some(hit) = self.boundaries.intersect(&rest) else { break };
            let surface = self.boundaries.surface(&rest, &hit);
            let bit = unknown & (1 << hit.shape);
            unknown &= !bit;
            if rest.direction.dot(surface.normal) > 0.0 {
                inside |= bit;
            }
            rest = surface.spawn(rest.direction);
        }
        inside
    }
}

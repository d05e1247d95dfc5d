//! Measures of a BSDF by quadrature: directional albedo, the integral of its density, and how drawing fits the density.
//!
//! Independent of how directions are drawn: nodes lie on a grid of slopes of facets, mirrored and refracted in double
//! precision, or on a grid of the hemisphere. Delta lobes are no part of the integrals.

use std::f64::consts::{PI, TAU};

use glam::{DVec3, Vec3};

use crate::math::elementary;
use crate::math::statistics::{ChiSquareTest, chi_square_test};
use crate::math::stream::{Purpose, Stream};
use crate::render::bsdf::{Bsdf, BsdfSample, Lobe, Transport};

/// At least one of each kind, over their choices, as a person writes them: what tests and benchmarks walk.
pub const EXAMPLES: [&str; 34] = [
    "diffuse: { reflectance: [0.2, 0.5, 0.8] }",
    "mirror: { reflectance: 0.9 }",
    "dielectric: {}",
    "dielectric: { eta: 0.75, fresnel: schlick, transmittance: [1, 0.9, 0.8] }",
    "conductor: { metal: copper }",
    "conductor: { eta: [0.2, 0.9, 1.1], k: [3.9, 2.4, 2.1], fresnel: approximate }",
    "conductor: { eta: { checker: { a: 0.2, b: 1.4 } }, k: 3 }",
    "rough-conductor: { eta: 0.3, k: { uv: {} }, alpha: { stripes: { a: 0.3, b: 0.5 } } }",
    "rough-conductor: { metal: gold, alpha: 0.005 }",
    "rough-conductor: { metal: gold, alpha: 0.05, distribution: beckmann }",
    "rough-conductor: { metal: gold, alpha: 0.25 }",
    "rough-conductor: { metal: gold, alpha: 0.25, distribution: beckmann }",
    "rough-conductor: { metal: ideal, alpha: 0.5, masking: separable }",
    "rough-conductor: { metal: ideal, alpha: 0.5, distribution: beckmann, masking: separable, sampling: all-normals }",
    "rough-conductor: { metal: platinum, alpha: 1, distribution: beckmann }",
    "rough-conductor: { metal: silver, alpha: 1, sampling: all-normals }",
    "rough-dielectric: { alpha: 0.005 }",
    "rough-dielectric: { alpha: 0.1, distribution: beckmann }",
    "rough-dielectric: { alpha: 0.5 }",
    "rough-dielectric: { alpha: 0.5, eta: 0.7, sampling: all-normals, masking: separable }",
    "rough-dielectric: { alpha: 0.3, eta: 1.33, distribution: beckmann, fresnel: schlick }",
    "plastic: { diffuse: [0.2, 0.5, 0.8] }",
    "plastic: { diffuse: 0.9, nonlinear: true, eta: 1.9 }",
    "plastic: { diffuse: 0.5, specular: 0, one_sided: true }",
    "disney: { base_color: [0.2, 0.5, 0.8] }",
    "disney: { base_color: [0.9, 0.6, 0.2], metallic: 1, roughness: 0.3, specular_g: burley-2014 }",
    "disney: { base_color: 1, roughness: 1, specular_tint: 0.5, sampling: all-normals }",
    "disney: { base_color: [0.7, 0.1, 0.1], roughness: 0.6, metallic: 0.3, clearcoat: 1, clearcoat_gloss: 0.2, one_sided: true }",
    "normal-map: { map: [0.6, 0.45, 0.95], bsdf: { diffuse: { reflectance: [0.2, 0.5, 0.8] } } }",
    "normal-map: { map: [0.7, 0.5, 0.9], shadowing: microfacet, bsdf: { rough-conductor: { metal: gold, alpha: 0.5 } } }",
    "bump-map: { map: { uv: {} }, scale: 0.3, bsdf: { plastic: {} } }",
    "blend: { weight: 0.3, first: { diffuse: { reflectance: 0.8 } }, second: { rough-conductor: { metal: gold, alpha: 0.25 } } }",
    "blend: { first: { rough-dielectric: { alpha: 0.4 } }, second: { diffuse: { one_sided: true } } }",
    "blend: { first: { mirror: {} }, second: { blend: { first: { diffuse: {} }, second: { disney: {} } } } }",
];

/// The direction at that angle from +z, towards +x.
pub fn outgoing_at(degrees: f64) -> Vec3 {
    let (sine, cosine) = elementary::sin_cos(degrees * PI / 180.0);
    DVec3::new(sine, 0.0, cosine).as_vec3()
}

/// A BSDF seen from one direction.
#[derive(Debug, Clone, Copy)]
pub struct View<'m> {
    /// The BSDF.
    pub bsdf: Bsdf<'m>,
    /// Unit vector away from the surface.
    pub outgoing: Vec3,
}

/// What decides where the nodes of a quadrature lie.
#[derive(Debug, Clone, Copy)]
struct Shape {
    /// Width of the lobe as a slope.
    alpha: f64,
    /// Relative index, if the lobe has a part on the other side.
    eta: Option<f64>,
    /// Whether the lobe is made of facets.
    is_facets: bool,
}

impl Shape {
    /// Without a peak.
    const BROAD: Self = Self { alpha: 1.0, eta: None, is_facets: false };

    fn of(bsdf: &Bsdf<'_>, outgoing: Vec3) -> Self {
        // A bent lobe does not peak about the mirrored direction.
        if bsdf.shading_normal() != Vec3::Z {
            return Self::BROAD;
        }
        let facets = |alpha: f32| Self { alpha: f64::from(alpha), eta: None, is_facets: true };
        match bsdf.lobe() {
            Lobe::RoughConductor(lobe) => facets(lobe.facets.alpha),
            Lobe::RoughDielectric(lobe) => Self { eta: Some(f64::from(lobe.relative_index(outgoing))), ..facets(lobe.facets.alpha) },
            Lobe::Disney(lobe) => facets(lobe.least_alpha()),
            // That of the narrower part, and of a part that lets light through.
            Lobe::Blend(blend) => {
                let [a, b] = blend.parts().map(|part| Self::of(&part, outgoing));
                let narrower = if b.is_facets && (!a.is_facets || b.alpha < a.alpha) { b } else { a };
                Self { eta: a.eta.or(b.eta), ..narrower }
            }
            _ => Self::BROAD,
        }
    }
}

impl<'m> View<'m> {
    /// From that angle to the normal in degrees, in the plane of x and z; beyond 90 degrees from behind.
    pub fn at_degrees(bsdf: Bsdf<'m>, degrees: f64) -> Self {
        Self { bsdf, outgoing: outgoing_at(degrees) }
    }

    fn shape(&self) -> Shape {
        Shape::of(&self.bsdf, self.outgoing)
    }

    /// Visits the nodes of a quadrature over incoming directions: direction and solid angle.
    ///
    /// `resolution` is the number of steps in slope or height; there are twice as many around.
    pub fn for_each_node(&self, resolution: u32, mut visit: impl FnMut(DVec3, f64)) {
        let shape = self.shape();
        let outgoing = self.outgoing.as_dvec3();
        let side = outgoing.z.signum();
        for step in 0..resolution {
            for turn in 0..2 * resolution {
                let (sine, cosine) = elementary::sin_cos(PI * (f64::from(turn) + 0.5) / f64::from(resolution));
                // Steps are shifted from turn to turn, so that no ring of nodes lies along the edge of a cell.
                let shift = (f64::from(turn) * GOLDEN).fract();
                let t = (f64::from(step) + shift) / f64::from(resolution);
                let share = 1.0 / f64::from(resolution) * PI / f64::from(resolution);
                if shape.is_facets {
                    // Slopes alpha t / (1 - t): as many nodes in the tail as in the peak.
                    let slope = shape.alpha * t / (1.0 - t);
                    let half = DVec3::new(slope * cosine, slope * sine, 1.0).normalize();
                    let area = slope * shape.alpha / ((1.0 - t) * (1.0 - t)) * share;
                    visit_facet(&shape, outgoing, half * DVec3::new(1.0, 1.0, side), area * half.z * half.z * half.z, &mut visit);
                } else {
                    let radius = (1.0 - t * t).sqrt();
                    visit(DVec3::new(radius * cosine, radius * sine, side * t), share);
                }
            }
        }
    }

    /// The integral of value times |cosine| over incoming directions, for each channel.
    pub fn directional_albedo(&self, resolution: u32, transport: Transport) -> DVec3 {
        let mut sum = DVec3::ZERO;
        self.for_each_node(resolution, |incoming, solid_angle| {
            sum += self.bsdf.evaluate(self.outgoing, incoming.as_vec3(), transport).as_dvec3() * solid_angle;
        });
        sum
    }

    /// The integral of the density over incoming directions: one less the probability of drawing none or a delta lobe.
    pub fn integral_of_pdf(&self, resolution: u32) -> f64 {
        let mut sum = 0.0;
        self.for_each_node(resolution, |incoming, solid_angle| sum += self.pdf(incoming) * solid_angle);
        sum
    }

    fn pdf(&self, incoming: DVec3) -> f64 {
        f64::from(self.bsdf.pdf(self.outgoing, incoming.as_vec3()))
    }

    /// Draws the sample of that index out of independent ones.
    pub fn draw(&self, stream: &Stream, index: u64, transport: Transport) -> Option<BsdfSample> {
        let mut numbers = stream.generator(index);
        let mut uniform = || (numbers.uniform() as f32).min(1.0 - f32::EPSILON / 2.0);
        let (choice, point) = (uniform(), [uniform(), uniform()]);
        self.bsdf.sample(self.outgoing, choice, point, transport)
    }

    /// The mean weight of drawn directions, delta lobes included, and its standard error.
    pub fn mean_weight(&self, count: u32, seed: u64, transport: Transport) -> (f64, f64) {
        let stream = Stream::new(seed, Purpose::Test);
        let (mut sum, mut squares) = (0.0, 0.0);
        for index in 0..u64::from(count) {
            let weight = self.draw(&stream, index, transport).map_or(0.0, |sample| f64::from(sample.weight.element_sum() / 3.0));
            sum += weight;
            squares += weight * weight;
        }
        let n = f64::from(count);
        (sum / n, ((squares / n - (sum / n) * (sum / n)).max(0.0) / (n - 1.0)).sqrt())
    }

    /// Whether drawn directions fall into cells as their density says; failures and delta lobes share a cell.
    pub fn chi_square(&self, count: u32, seed: u64, resolution: u32) -> ChiSquareTest {
        chi_square_test(&self.counts(count, seed), &self.expectations(count, resolution))
    }

    /// How many of `count` drawn directions fall into each cell.
    pub fn counts(&self, count: u32, seed: u64) -> Vec<u64> {
        self.counts_of(self, count, seed)
    }

    /// How many of `count` directions that another view draws fall into each of this one's cells, whose size goes with
    /// its roughness: what a control needs, since in cells of its own a lobe that is too wide looks right.
    pub fn counts_of(&self, drawn: &Self, count: u32, seed: u64) -> Vec<u64> {
        let stream = Stream::new(seed, Purpose::Test);
        let mut counts = vec![0; CELL_COUNT + 1];
        for index in 0..u64::from(count) {
            let smooth = drawn.draw(&stream, index, Transport::Energy).filter(|sample| !sample.is_delta);
            let cell = smooth.map_or(CELL_COUNT, |sample| self.cell(sample.direction.as_dvec3()));
            counts[cell] += 1;
        }
        counts
    }

    /// How many of `count` directions should fall into each cell.
    pub fn expectations(&self, count: u32, resolution: u32) -> Vec<f64> {
        let mut shares = vec![0.0; CELL_COUNT + 1];
        self.for_each_node(resolution, |incoming, solid_angle| shares[self.cell(incoming)] += self.pdf(incoming) * solid_angle);
        let drawn: f64 = shares.iter().sum();
        shares[CELL_COUNT] = (1.0 - drawn).max(0.0);
        // A cell that lies between the nodes is not impossible, only rare.
        shares.into_iter().map(|share| share.max(1e-9) * f64::from(count)).collect()
    }

    /// Cells are rings and sectors about the mirrored, the refracted or the normal direction, finer towards it.
    fn cell(&self, incoming: DVec3) -> usize {
        let shape = self.shape();
        let outgoing = self.outgoing.as_dvec3();
        let is_transmitted = incoming.z * outgoing.z < 0.0;
        let center = match (shape.is_facets, is_transmitted) {
            (false, _) => DVec3::Z * outgoing.z.signum(),
            (true, false) => DVec3::new(-outgoing.x, -outgoing.y, outgoing.z),
            (true, true) => straight_through(outgoing, shape.eta.unwrap_or(1.0)),
        };
        let distance = (incoming - center).length() / shape.alpha;
        let ring = (RINGS as f64 * distance / (distance + 1.0)) as usize;
        let sector = elementary::atan2(incoming.y - center.y, incoming.x - center.x).rem_euclid(TAU) / TAU * SECTORS as f64;
        (usize::from(is_transmitted) * RINGS + ring.min(RINGS - 1)) * SECTORS + (sector as usize).min(SECTORS - 1)
    }
}

/// Multiples of it are spread evenly between whole numbers.
const GOLDEN: f64 = 0.618_033_988_749_894_8;

const RINGS: usize = 12;
const SECTORS: usize = 16;
const CELL_COUNT: usize = 2 * RINGS * SECTORS;

/// Visits the directions into which a facet of that normal and solid angle mirrors and refracts.
fn visit_facet(shape: &Shape, outgoing: DVec3, half: DVec3, solid_angle: f64, visit: &mut impl FnMut(DVec3, f64)) {
    let cos_oh = outgoing.dot(half);
    if cos_oh <= 0.0 {
        return;
    }
    let mirrored = 2.0 * cos_oh * half - outgoing;
    if mirrored.z * outgoing.z > 0.0 {
        visit(mirrored, 4.0 * cos_oh * solid_angle);
    }
    let Some(eta) = shape.eta else { return };
    let sine2 = (1.0 - cos_oh * cos_oh) / (eta * eta);
    if sine2 >= 1.0 {
        return;
    }
    let cos_ih = -(1.0 - sine2).sqrt();
    let refracted = (half * cos_oh - outgoing) / eta + half * cos_ih;
    if refracted.z * outgoing.z < 0.0 {
        let length = cos_oh + eta * cos_ih;
        visit(refracted.normalize(), length * length / (eta * eta * cos_ih.abs()) * solid_angle);
    }
}

/// Where a flat boundary refracts; along the boundary where it reflects everything.
fn straight_through(outgoing: DVec3, eta: f64) -> DVec3 {
    let (x, y) = (-outgoing.x / eta, -outgoing.y / eta);
    DVec3::new(x, y, -outgoing.z.signum() * (1.0 - x * x - y * y).max(0.0).sqrt()).normalize()
}

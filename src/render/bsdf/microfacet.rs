//! Statistics of microfacets: how their normals are distributed, how they hide each other, and how normals are drawn.
//!
//! Everything is about +z, for unit vectors on its side. Instead of Smith's G1 the functions use the projected area of
//! the facets that face a direction, A(w) = int D(h) max(0, w.h) dh = cos (1 + Lambda) = cos / G1, which is never 0 and
//! loses no digits at grazing angles.
//!
//! After Walter et al., "Microfacet models for refraction through rough surfaces" (2007); Heitz, "Understanding the
//! masking-shadowing function", JCGT 3(2) (2014); Heitz and d'Eon, "Importance sampling microfacet-based BSDFs using the
//! distribution of visible normals" (2014); Dupuy and Benyoub, "Sampling visible GGX normals with spherical caps" (2023).

use std::f32::consts::{FRAC_2_SQRT_PI, PI};

use glam::Vec3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::math::single;

/// How the normals of the facets are distributed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum FacetDistribution {
    /// D = alpha² / (pi (cos² (alpha² - 1) + 1)²), with long tails (Trowbridge and Reitz 1975; Walter et al. 2007).
    #[default]
    Ggx,
    /// D = exp(-tan² / alpha²) / (pi alpha² cos⁴): a surface of Gaussian heights (Beckmann and Spizzichino 1963).
    Beckmann,
}

/// How facets hide and shadow each other.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Masking {
    /// G2 = 1 / (1 + Lambda(i) + Lambda(o)): high facets are both seen and lit (Smith; Heitz 2014).
    #[default]
    Correlated,
    /// G2 = G1(i) G1(o): as if being seen and being lit were independent (Walter et al. 2007; Mitsuba).
    Separable,
}

/// How normals of facets are drawn. The mean is the same; the noise is not.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum NormalSampling {
    /// Those that are seen, by their projected area (Heitz 2018).
    #[default]
    VisibleNormals,
    /// All, by D times their cosine (Walter et al. 2007).
    AllNormals,
}

/// Half way between two unit vectors, on the side of +z: the normal of the facets that mirror one into the other.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HalfWay {
    /// Along it.
    pub sum: Vec3,
    /// The square of the length of that.
    pub length2: f32,
    /// The length of that.
    pub length: f32,
    /// Cosine between either and it.
    pub cosine: f32,
}

impl HalfWay {
    /// `None` where `incoming` is not above the surface, on which side `outgoing` must be.
    #[inline]
    pub fn between(outgoing: Vec3, incoming: Vec3) -> Option<Self> {
        let sum = outgoing + incoming;
        let length2 = sum.length_squared();
        if incoming.z <= 0.0 || length2 <= 0.0 {
            return None;
        }
        let length = length2.sqrt();
        // For unit vectors, o.h = |o + i| / 2.
        Some(Self { sum, length2, length, cosine: (0.5 * length).min(1.0) })
    }
}

/// `outgoing` mirrored by a facet of that unit normal, the cosine to which is `cos_oh`.
#[inline]
pub fn mirrored_by(outgoing: Vec3, half: Vec3, cos_oh: f32) -> Vec3 {
    (2.0 * cos_oh * half - outgoing).normalize()
}

/// Facets of one roughness.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Facets {
    /// Which distribution.
    pub distribution: FacetDistribution,
    /// How they hide each other.
    pub masking: Masking,
    /// How normals are drawn.
    pub sampling: NormalSampling,
    /// Width of the distribution, at least [`SMOOTHEST`].
    pub alpha: f32,
}

/// Textures that go below are taken for this: single precision tells no smaller slopes apart.
pub const SMOOTHEST: f32 = 0.001;

impl Facets {
    /// D(h) of the direction of `half`, which may have any length; `length2` is its square.
    #[inline]
    pub fn density(&self, half: Vec3, length2: f32) -> f32 {
        let alpha2 = self.alpha * self.alpha;
        // sin² and cos² times length2, without the cancellation of 1 - cos².
        let (sin2, cos2) = (half.x * half.x + half.y * half.y, half.z * half.z);
        match self.distribution {
            FacetDistribution::Ggx => {
                let stretched = alpha2 * cos2 + sin2;
                alpha2 * length2 * length2 / (PI * stretched * stretched)
            }
            FacetDistribution::Beckmann => {
                let cos2 = (cos2 / length2).max(1e-14);
                single::exp(-(sin2 / length2) / (alpha2 * cos2)) / (PI * alpha2 * cos2 * cos2)
            }
        }
    }

    /// A(w) = int D(h) max(0, w.h) dh, at least |cos|; the side of `w` does not matter.
    #[inline]
    pub fn projected_area(&self, w: Vec3) -> f32 {
        let cos = w.z.abs();
        let sin2 = w.x * w.x + w.y * w.y;
        match self.distribution {
            FacetDistribution::Ggx => 0.5 * (cos + (cos * cos + self.alpha * self.alpha * sin2).sqrt()),
            FacetDistribution::Beckmann => beckmann_area(cos, self.alpha * sin2.sqrt()),
        }
    }

    /// G2 / (cos_o cos_i) times cos_i, where the areas are those of both directions.
    #[inline]
    fn masking_over_outgoing(&self, cos_o: f32, area_o: f32, cos_i: f32, area_i: f32) -> f32 {
        match self.masking {
            // 1 + Lambda_o + Lambda_i = A_o / cos_o + A_i / cos_i - 1.
            Masking::Correlated => cos_i / (area_o * cos_i + area_i * cos_o - cos_o * cos_i),
            Masking::Separable => cos_i / (area_o * area_i),
        }
    }

    /// G2 / cos_o and, over it, the density of the drawn normals per |o.h| D: what a value and a density are made of.
    ///
    /// The value of a reflection times cos_i is F D G2 / (4 cos_o), its density p(h) / (4 |o.h|). For either way of
    /// drawing, p(h) = D |o.h| q with q = 1 / A(o) for visible normals and cos_h / |o.h| for all.
    #[inline]
    pub fn masking_and_density(&self, outgoing: Vec3, incoming: Vec3, cos_h: f32, cos_oh: f32) -> (f32, f32) {
        let (cos_o, cos_i) = (outgoing.z.abs(), incoming.z.abs());
        let (area_o, area_i) = (self.projected_area(outgoing), self.projected_area(incoming));
        let masking = self.masking_over_outgoing(cos_o, area_o, cos_i, area_i);
        (masking, self.drawn(area_o, cos_h, cos_oh))
    }

    /// q, where p(h) = D |o.h| q is the density of the drawn normals.
    #[inline]
    fn drawn(&self, area_o: f32, cos_h: f32, cos_oh: f32) -> f32 {
        match self.sampling {
            NormalSampling::VisibleNormals => 1.0 / area_o,
            NormalSampling::AllNormals => cos_h / cos_oh,
        }
    }

    /// The same for an outgoing direction.
    #[inline]
    pub fn drawn_from(&self, outgoing: Vec3, cos_h: f32, cos_oh: f32) -> f32 {
        self.drawn(self.projected_area(outgoing), cos_h, cos_oh)
    }

    /// A unit normal above the surface, for `outgoing` above it.
    #[inline]
    pub fn sample(&self, outgoing: Vec3, point: [f32; 2]) -> Vec3 {
        match (self.sampling, self.distribution) {
            (NormalSampling::AllNormals, FacetDistribution::Ggx) => self.sloped((point[0] / (1.0 - point[0])).sqrt(), point[1]),
            (NormalSampling::AllNormals, FacetDistribution::Beckmann) => self.sloped((-single::ln(1.0 - point[0])).sqrt(), point[1]),
            (NormalSampling::VisibleNormals, FacetDistribution::Ggx) => self.visible_ggx(outgoing, point),
            (NormalSampling::VisibleNormals, FacetDistribution::Beckmann) => self.visible_beckmann(outgoing, point),
        }
    }

    /// The normal of slope alpha times `slope`, in the direction of 2 pi `turn`.
    fn sloped(&self, slope: f32, turn: f32) -> Vec3 {
        let (sine, cosine) = single::sin_cos_of_turns(turn);
        let tangent = self.alpha * slope;
        Vec3::new(tangent * cosine, tangent * sine, 1.0).normalize()
    }

    /// A normal with density D(h) max(0, o.h) / A(o): a uniform point on the cap of the sphere that the stretched
    /// direction sees, halved towards it and stretched back (Dupuy and Benyoub 2023, listing 3).
    #[inline]
    fn visible_ggx(&self, outgoing: Vec3, point: [f32; 2]) -> Vec3 {
        let stretched = self.stretched(outgoing);
        // The cap reaches from z = 1 down to z = -stretched.z; `drop` is 1 - z and needs no cancellation.
        let height = 1.0 + stretched.z;
        let drop = point[0] * height;
        let radius = (drop * (2.0 - drop)).max(0.0).sqrt();
        let (sine, cosine) = single::sin_cos_of_turns(point[1]);
        let half = Vec3::new(radius * cosine + stretched.x, radius * sine + stretched.y, height - drop);
        Vec3::new(self.alpha * half.x, self.alpha * half.y, half.z).normalize()
    }

    /// A normal with density D(h) max(0, o.h) / A(o), by two slopes: the one away from `outgoing` is Gaussian, the one
    /// towards it has density proportional to e^(-s²) (1 - s tan) up to s = cot, and is found by its cdf.
    fn visible_beckmann(&self, outgoing: Vec3, point: [f32; 2]) -> Vec3 {
        let stretched = self.stretched(outgoing);
        let sine = (stretched.x * stretched.x + stretched.y * stretched.y).sqrt();
        let along = visible_slope(sine / stretched.z, point[0]);
        let across = single::inverse_gaussian_cdf(point[1].max(LEAST_PROBABILITY));
        let azimuth = if sine > 0.0 { [stretched.x / sine, stretched.y / sine] } else { [1.0, 0.0] };
        // A slope towards +x tilts the normal towards -x; slopes are in the sense of (dz/dx, dz/dy).
        let x = azimuth[0] * along - azimuth[1] * across;
        let y = azimuth[1] * along + azimuth[0] * across;
        Vec3::new(-self.alpha * x, -self.alpha * y, 1.0).normalize()
    }

    /// The direction as seen by facets of alpha = 1.
    #[inline]
    fn stretched(&self, outgoing: Vec3) -> Vec3 {
        Vec3::new(self.alpha * outgoing.x, self.alpha * outgoing.y, outgoing.z).normalize()
    }
}

/// Uniform numbers below are taken for this: the slopes beyond would be infinite.
const LEAST_PROBABILITY: f32 = 2.3e-10;

/// A(w) for a direction of that cosine and of `alpha` times that sine.
///
/// cos (1 + Lambda) with Lambda = e^(-x²) / (2 x sqrt pi) - (1 - erf x) / 2 and x = cos / (alpha sin) (Walter 2007).
#[inline]
fn beckmann_area(cosine: f32, alpha_sine: f32) -> f32 {
    // Beyond x = 4 no facet is hidden, to nine digits.
    if cosine >= 4.0 * alpha_sine {
        return cosine;
    }
    let x = cosine / alpha_sine;
    let hidden = single::exp(-x * x);
    cosine * (1.0 - 0.5 * hidden * single::scaled_erfc(x)) + hidden * alpha_sine * (0.25 * FRAC_2_SQRT_PI)
}

/// The slope s at which the cdf of e^(-s²) (1 - s `tangent`) on (-inf, 1 / `tangent`] is `u`.
///
/// The cdf is (1 + erf s + tangent e^(-s²) / sqrt pi) over its value at the end. Euler's iteration in s by the parabola
/// through value, slope and curvature, which suits the flat end and triples the digits, kept between bounds that close in.
fn visible_slope(tangent: f32, u: f32) -> f32 {
    const LEAST_SLOPE: f32 = -5.0;
    let u = u.max(LEAST_PROBABILITY);
    if tangent < 1e-4 {
        return single::inverse_gaussian_cdf(u);
    }
    let greatest = (1.0 / tangent).min(-LEAST_SLOPE);
    let target = u * slope_sum(greatest, tangent).0;
    let (mut low, mut high) = (LEAST_SLOPE, greatest);
    let mut slope = first_slope(tangent, u).clamp(low, high);
    for _ in 0..8 {
        let (sum, gauss) = slope_sum(slope, tangent);
        let excess = sum - target;
        if excess > 0.0 {
            high = slope
        } else {
            low = slope
        }
        let rest = 1.0 - slope * tangent;
        let first = FRAC_2_SQRT_PI * gauss * rest;
        let second_over_first = -2.0 * slope - tangent / rest;
        let newton = excess / first;
        let next = slope - 2.0 * newton / (1.0 + (1.0 - 2.0 * newton * second_over_first).max(0.0).sqrt());
        let next = if next >= low && next <= high { next } else { 0.5 * (low + high) };
        let step = (next - slope).abs();
        slope = next;
        if step < 1e-4 {
            break;
        }
    }
    slope
}

/// 1 + erf s + tangent e^(-s²) / sqrt pi, and e^(-s²).
#[inline]
fn slope_sum(slope: f32, tangent: f32) -> (f32, f32) {
    let gauss = single::exp(-slope * slope);
    let tail = gauss * single::scaled_erfc(slope.abs());
    let one_and_erf = if slope < 0.0 { tail } else { 2.0 - tail };
    (one_and_erf + 0.5 * FRAC_2_SQRT_PI * tangent * gauss, gauss)
}

/// Where the search starts: between the slopes of a direction along the normal and of a grazing one.
fn first_slope(tangent: f32, u: f32) -> f32 {
    let from_above = single::inverse_gaussian_cdf(u);
    let grazing = -(-single::ln(u)).sqrt();
    let share = tangent / (tangent + 1.5);
    from_above + (grazing - from_above) * share
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use glam::DVec3;

    use super::*;
    use crate::math::elementary;

    fn facets(distribution: FacetDistribution, alpha: f32) -> Facets {
        Facets { distribution, masking: Masking::Correlated, sampling: NormalSampling::VisibleNormals, alpha }
    }

    const DISTRIBUTIONS: [FacetDistribution; 2] = [FacetDistribution::Ggx, FacetDistribution::Beckmann];

    /// int g(h) D(h) dh over the upper hemisphere, on a grid of slopes.
    fn integral(facets: &Facets, g: impl Fn(DVec3) -> f64) -> f64 {
        let side = 400;
        let alpha = f64::from(facets.alpha);
        let mut sum = 0.0;
        for k in 0..side * side {
            let t = (f64::from(k / side) + 0.5) / f64::from(side);
            let (sine, cosine) = elementary::sin_cos(TAU * (f64::from(k % side) + 0.5) / f64::from(side));
            let slope = alpha * t / (1.0 - t);
            let half = DVec3::new(slope * cosine, slope * sine, 1.0).normalize();
            let area = slope * alpha / ((1.0 - t) * (1.0 - t)) * TAU / f64::from(side * side) * half.z * half.z * half.z;
            sum += g(half) * f64::from(facets.density(half.as_vec3(), 1.0)) * area;
        }
        sum
    }

    #[test]
    fn normals_cover_the_surface_once() {
        for distribution in DISTRIBUTIONS {
            for alpha in [0.001, 0.005, 0.05, 0.25, 0.5, 1.0] {
                let covered = integral(&facets(distribution, alpha), |half| half.z);
                assert!((covered - 1.0).abs() < 1e-3, "{distribution:?} {alpha}: {covered}");
            }
        }
    }

    #[test]
    fn projected_areas_are_what_faces_the_direction() {
        for distribution in DISTRIBUTIONS {
            for alpha in [0.005, 0.1, 0.5, 1.0] {
                let facets = facets(distribution, alpha);
                for degrees in [0.0, 30.0, 60.0, 80.0, 89.0, 90.0] {
                    let (sine, cosine) = elementary::sin_cos(degrees * TAU / 360.0);
                    let w = DVec3::new(sine, 0.0, cosine.max(0.0));
                    let exact = integral(&facets, |half| half.dot(w).max(0.0));
                    let found = f64::from(facets.projected_area(w.as_vec3()));
                    assert!((found - exact).abs() < 1e-3 * exact + 1e-6, "{distribution:?} {alpha} {degrees}: {found} {exact}");
                    assert!(found >= w.z * 0.999_999);
                }
            }
        }
    }

    /// The rational form of Walter et al. (2007), whose G1 errs by at most .32 %.
    #[test]
    fn beckmanns_masking_is_near_the_rational_form() {
        for step in 1..400_u16 {
            let x = f64::from(step) / 100.0;
            let lambda = if x < 1.6 { (1.0 - 1.259 * x + 0.396 * x * x) / (3.535 * x + 2.181 * x * x) } else { 0.0 };
            // cos = x and alpha sin = 1: A / cos = 1 + Lambda.
            let found = f64::from(beckmann_area(x as f32, 1.0)) / x;
            assert!((found / (1.0 + lambda) - 1.0).abs() < 3.3e-3, "{x}: {found} {lambda}");
        }
    }

    /// (1 + erf s + tangent e^(-s²) / sqrt pi), over its value at the end.
    fn slope_cdf(slope: f64, tangent: f64) -> f64 {
        let sum = |s: f64| 1.0 + elementary::erf(s) + tangent * elementary::exp(-s * s) / std::f64::consts::PI.sqrt();
        sum(slope) / sum(1.0 / tangent)
    }

    #[test]
    fn visible_slopes_lead_back_to_their_probability() {
        for tangent in [2e-4_f32, 1e-2, 0.1, 0.5, 1.0, 3.0, 10.0, 100.0, 1e4] {
            for step in 1..1000_u16 {
                let u = f32::from(step) / 1000.0;
                let slope = visible_slope(tangent, u);
                let back = slope_cdf(f64::from(slope), f64::from(tangent));
                assert!((back - f64::from(u)).abs() < 2e-6, "{tangent} {u}: {slope}, {back}");
            }
            assert!(visible_slope(tangent, 0.0).is_finite() && visible_slope(tangent, 0.999_999_94).is_finite());
        }
    }

    /// The lowest and the highest number lead to the rim of what is seen, without a jump.
    #[test]
    fn drawn_normals_are_above_the_surface_and_face_the_direction() {
        let numbers = [0.0, 1e-7, 0.1, 0.5, 0.9, 0.999_999_94];
        for distribution in DISTRIBUTIONS {
            for sampling in [NormalSampling::VisibleNormals, NormalSampling::AllNormals] {
                for (alpha, z) in [0.001, 0.1, 1.0].into_iter().flat_map(|alpha| [1.0, 0.5, 1e-3, 1e-7].map(|z| (alpha, z))) {
                    let outgoing = Vec3::new((1.0_f32 - z * z).sqrt(), 0.0, z);
                    for point in numbers.into_iter().flat_map(|x| numbers.map(|y| [x, y])) {
                        let half = Facets { sampling, ..facets(distribution, alpha) }.sample(outgoing, point);
                        assert!(half.is_normalized() && half.z >= 0.0, "{distribution:?} {alpha} {z} {point:?}: {half}");
                        // The rim itself is one point, whose normal is lost in rounding.
                        if sampling == NormalSampling::VisibleNormals && point[0] < 0.99 {
                            assert!(outgoing.dot(half) > -1e-3 * alpha, "{distribution:?} {alpha} {z} {point:?}: {half}");
                        }
                    }
                }
            }
        }
    }
}

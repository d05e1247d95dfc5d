//! What a sphere's surface does with light: Lambert's cosine, Phong's lobe, or a rough mirror.
//!
//! Value, sampler and density of each stand side by side. The camera looks along -z, so the direction towards it is
//! +z at every point. Knows no map.
//!
//! Phong's lobe normalized as in Lafortune and Willems, "Using the modified Phong reflectance model for physically based
//! rendering" (1994). GGX after Walter et al., "Microfacet models for refraction through rough surfaces" (2007), with the
//! height-correlated masking and the sampling of visible normals of Heitz, "Sampling the GGX distribution of visible
//! normals", JCGT 7(4) (2018); no Fresnel factor, no multiple scattering.

use std::f64::consts::PI;

use glam::{DMat3, DVec3};

use crate::math::elementary;
use crate::math::sphere::{cosine_hemisphere, frame_about};

/// A way of reflecting, white.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Lobe {
    /// f = 1 / pi.
    Diffuse,
    /// f = (e + 2) / (2 pi) (r . w)+^e about the mirror direction r; reflects at most all light.
    Phong {
        /// e, at least 1.
        exponent: u32,
    },
    /// f = D G2 / (4 (n . wi) (n . wo)): a rough mirror that loses what would be scattered twice.
    Ggx {
        /// Width of the distribution of slopes, above 0 and at most 1.
        alpha: f64,
    },
}

/// A lobe at a point of the sphere.
#[derive(Debug, Clone, Copy)]
pub struct Reflection {
    lobe: Lobe,
    normal: DVec3,
    /// Where a mirror would show the camera.
    mirrored: DVec3,
}

impl Lobe {
    /// The lobe on a surface of that unit normal, which looks towards the camera.
    pub fn at(self, normal: DVec3) -> Reflection {
        let mirrored = DVec3::new(2.0 * normal.z * normal.x, 2.0 * normal.z * normal.y, 2.0 * normal.z * normal.z - 1.0);
        Reflection { lobe: self, normal, mirrored }
    }

    /// e of a lobe that falls as 1 - e t² / 2 with the angle t from its peak, seen head-on; towards the sphere's edge that of GGX grows.
    pub fn sharpness(self) -> f64 {
        match self {
            Lobe::Diffuse => 1.0,
            Lobe::Phong { exponent } => f64::from(exponent) + 1.0,
            // D falls as 1 - 2 h² / alpha² with the angle h of the half vector, which is half of t.
            Lobe::Ggx { alpha } => 1.0 / (alpha * alpha),
        }
    }
}

impl Reflection {
    /// f (n . w)+ for light from the unit direction `w`.
    #[inline]
    pub fn value(&self, w: DVec3) -> f64 {
        let cosine = self.normal.dot(w);
        if cosine <= 0.0 {
            return 0.0;
        }
        match self.lobe {
            Lobe::Diffuse => cosine / PI,
            Lobe::Phong { exponent } => (f64::from(exponent) + 2.0) / (2.0 * PI) * whole_power(self.mirrored.dot(w), exponent) * cosine,
            Lobe::Ggx { alpha } => {
                let g2 = 1.0 / (1.0 + lambda(alpha, cosine) + lambda(alpha, self.normal.z));
                distribution_of_normals(alpha, self.cosine_of_half(w, cosine)) * g2 / (4.0 * self.normal.z)
            }
        }
    }

    /// Density per steradian with which [`Self::sample`] gives the unit direction `w`.
    #[inline]
    pub fn pdf(&self, w: DVec3) -> f64 {
        match self.lobe {
            Lobe::Diffuse => self.normal.dot(w).max(0.0) / PI,
            Lobe::Phong { exponent } => (f64::from(exponent) + 1.0) / (2.0 * PI) * whole_power(self.mirrored.dot(w), exponent),
            Lobe::Ggx { alpha } => {
                let g1 = 1.0 / (1.0 + lambda(alpha, self.normal.z));
                let half = self.cosine_of_half(w, self.normal.dot(w));
                if half > 0.0 { g1 * distribution_of_normals(alpha, half) / (4.0 * self.normal.z) } else { 0.0 }
            }
        }
    }

    /// A unit direction with density [`Self::pdf`]; of Phong and GGX some lie below the surface, where the value is 0.
    pub fn sample(&self, u: [f64; 2]) -> DVec3 {
        match self.lobe {
            Lobe::Diffuse => frame_about(self.normal) * cosine_hemisphere(u),
            Lobe::Phong { exponent } => frame_about(self.mirrored) * power_cosine(exponent, u),
            Lobe::Ggx { alpha } => {
                let frame = frame_about(self.normal);
                let half = frame * visible_normal(alpha, towards_camera(&frame), u);
                let reflected = 2.0 * half.z * half - DVec3::Z;
                reflected.normalize()
            }
        }
    }

    /// n . h of the half vector between `w` and the camera.
    #[inline]
    fn cosine_of_half(&self, w: DVec3, cosine: f64) -> f64 {
        (cosine + self.normal.z) / (2.0 * (1.0 + w.z)).max(f64::MIN_POSITIVE).sqrt()
    }
}

/// +z in a frame.
fn towards_camera(frame: &DMat3) -> DVec3 {
    frame.transpose() * DVec3::Z
}

/// max(0, base) to a whole power, by squaring: the same digits everywhere.
#[inline]
fn whole_power(base: f64, exponent: u32) -> f64 {
    let (mut square, mut rest, mut power) = (base.max(0.0), exponent, 1.0);
    while rest > 0 {
        if rest & 1 == 1 {
            power *= square;
        }
        square *= square;
        rest >>= 1;
    }
    power
}

/// A direction about +z with density (e + 1) / (2 pi) z^e.
fn power_cosine(exponent: u32, u: [f64; 2]) -> DVec3 {
    let z = elementary::pow(1.0 - u[0], 1.0 / (f64::from(exponent) + 1.0));
    let (sin, cos) = elementary::sin_cos(2.0 * PI * u[1]);
    let sine = ((1.0 - z) * (1.0 + z)).max(0.0).sqrt();
    DVec3::new(sine * cos, sine * sin, z)
}

/// D = a² / (pi ((a² - 1) c² + 1)²) at the cosine c of a microscopic normal.
#[inline]
fn distribution_of_normals(alpha: f64, cosine: f64) -> f64 {
    let square = alpha * alpha;
    let below = (square - 1.0) * cosine * cosine + 1.0;
    square / (PI * below * below)
}

/// Smith's Lambda: (sqrt(1 + a² tan²) - 1) / 2 at a cosine above 0.
#[inline]
fn lambda(alpha: f64, cosine: f64) -> f64 {
    let square = cosine * cosine;
    ((1.0 + alpha * alpha * (1.0 - square).max(0.0) / square).sqrt() - 1.0) / 2.0
}

/// A microscopic normal seen from `view`, both about +z (Heitz 2018, listing 1).
fn visible_normal(alpha: f64, view: DVec3, u: [f64; 2]) -> DVec3 {
    let stretched = DVec3::new(alpha * view.x, alpha * view.y, view.z).normalize();
    let across = stretched.x * stretched.x + stretched.y * stretched.y;
    let first = if across > 0.0 { DVec3::new(-stretched.y, stretched.x, 0.0) / across.sqrt() } else { DVec3::X };
    let second = stretched.cross(first);
    let radius = u[0].sqrt();
    let (sin, cos) = elementary::sin_cos(2.0 * PI * u[1]);
    let x = radius * cos;
    let share = 0.5 * (1.0 + stretched.z);
    let y = (1.0 - share) * (1.0 - x * x).max(0.0).sqrt() + share * radius * sin;
    let normal = x * first + y * second + (1.0 - x * x - y * y).max(0.0).sqrt() * stretched;
    DVec3::new(alpha * normal.x, alpha * normal.y, normal.z.max(0.0)).normalize()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::sphere::uniform_sphere;

    const LOBES: [Lobe; 6] = [
        Lobe::Diffuse,
        Lobe::Phong { exponent: 1 },
        Lobe::Phong { exponent: 20 },
        Lobe::Ggx { alpha: 0.25 },
        Lobe::Ggx { alpha: 0.5 },
        Lobe::Ggx { alpha: 1.0 },
    ];

    /// A normal seen at that angle from +z.
    fn tilted(degrees: f64) -> DVec3 {
        let (sin, cos) = elementary::sin_cos(degrees.to_radians());
        DVec3::new(0.6 * sin, 0.8 * sin, cos)
    }

    /// Centers of cells of equal solid angle.
    fn integral(side: usize, value: impl Fn(DVec3) -> f64) -> f64 {
        let cell = |k: usize| uniform_sphere([((k % side) as f64 + 0.5) / side as f64, ((k / side) as f64 + 0.5) / side as f64]);
        (0..side * side).map(|k| value(cell(k))).sum::<f64>() * 4.0 * PI / (side * side) as f64
    }

    /// math.md section 8: GGX with F = 1, single scattering, correlated masking, at 0, 45 and 75 degrees.
    #[test]
    fn ggx_has_the_published_albedos() {
        for (alpha, albedos) in [(0.25, [0.9158, 0.8862, 0.8393]), (0.5, [0.6878, 0.6828, 0.7614]), (1.0, [0.3069, 0.3768, 0.5906])] {
            for (degrees, expected) in [0.0, 45.0, 75.0].into_iter().zip(albedos) {
                let reflection = Lobe::Ggx { alpha }.at(tilted(degrees));
                let found = integral(300, |w| reflection.value(w));
                assert!((found - expected).abs() < 1.5e-3, "{alpha} {degrees}: {found}");
            }
        }
    }

    /// Seen straight on, integral of (e + 2) / (2 pi) cos^(e + 1) over the hemisphere is 1; from elsewhere it is less.
    #[test]
    fn phong_reflects_all_light_straight_on_and_never_more() {
        for exponent in [1, 5, 20] {
            let albedo = |degrees| {
                let reflection = Lobe::Phong { exponent }.at(tilted(degrees));
                integral(300, |w| reflection.value(w))
            };
            assert!((albedo(0.0) - 1.0).abs() < 2e-3, "{}", albedo(0.0));
            assert!(albedo(60.0) < 1.0 && albedo(80.0) < albedo(60.0));
        }
    }

    #[test]
    fn densities_integrate_to_one() {
        for lobe in LOBES {
            for degrees in [0.0, 45.0, 75.0] {
                let reflection = lobe.at(tilted(degrees));
                let found = integral(300, |w| reflection.pdf(w));
                assert!((found - 1.0).abs() < 4e-3, "{lobe:?} {degrees}: {found}");
            }
        }
    }

    /// Weighing samples by value over density gives the integral of the value; stratified points, so few are enough.
    #[test]
    fn samplers_follow_their_densities() {
        for lobe in LOBES {
            for degrees in [0.0, 45.0, 75.0] {
                let reflection = lobe.at(tilted(degrees));
                let side = 60;
                let tint = |w: DVec3| 1.5 + w.x + 0.5 * w.y * w.z;
                let mut estimate = 0.0;
                for k in 0..side * side {
                    let u = [f64::from(k % side) + 0.5, f64::from(k / side) + 0.5].map(|place| place / f64::from(side));
                    let w = reflection.sample(u);
                    assert!((w.length() - 1.0).abs() < 1e-12);
                    let pdf = reflection.pdf(w);
                    estimate += if pdf > 0.0 { tint(w) * reflection.value(w) / pdf } else { 0.0 };
                }
                let found = estimate / f64::from(side * side);
                let expected = integral(300, |w| tint(w) * reflection.value(w));
                assert!((found / expected - 1.0).abs() < 1e-2, "{lobe:?} {degrees}: {found} {expected}");
            }
        }
    }

    #[test]
    fn whole_powers_are_powers() {
        for (base, exponent) in [(0.5, 1), (0.9, 7), (0.99, 1000), (1.0, 10_000), (0.0, 3), (-0.5, 2)] {
            let expected = if base > 0.0 { elementary::pow(base, f64::from(exponent)) } else { 0.0 };
            assert!((whole_power(base, exponent) - expected).abs() <= 1e-12 * expected);
        }
    }
}

//! Fresnel reflectance of a smooth boundary between two dielectrics, and Schlick's approximation.
//!
//! All angles are measured from the normal; `eta_i` is the index on the side the light comes from. The first
//! coursework report has the names of the two polarizations exchanged: its "parallel" is perpendicular here.
//!
//! After Born and Wolf, "Principles of optics", 1.5; Schlick, "An inexpensive BRDF model for physically-based
//! rendering" (1994).

use std::f64::consts::{FRAC_PI_2, PI};

use crate::math::elementary;

/// The boundary between two dielectrics, as met by light that comes from the side of `eta_i`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Boundary {
    /// Index of refraction where the light comes from; positive.
    pub eta_i: f64,
    /// Index of refraction where it is transmitted to; positive.
    pub eta_t: f64,
}

impl Boundary {
    /// From vacuum into a material of that index.
    pub fn entering(eta: f64) -> Self {
        Self { eta_i: 1.0, eta_t: eta }
    }

    /// From a material of that index into vacuum.
    pub fn leaving(eta: f64) -> Self {
        Self { eta_i: eta, eta_t: 1.0 }
    }

    /// cos theta_t by Snell's law, eta_i sin theta_i = eta_t sin theta_t; `None` beyond the critical angle.
    pub fn refracted_cosine(&self, cos_i: f64) -> Option<f64> {
        let ratio = self.eta_i / self.eta_t;
        // 1 - cos^2, without cancellation near the normal.
        let sin2_t = ratio * ratio * ((1.0 - cos_i) * (1.0 + cos_i));
        (sin2_t < 1.0).then(|| (1.0 - sin2_t).sqrt())
    }

    /// Reflectance of light polarized across the plane of incidence (s).
    ///
    /// r = (eta_i cos theta_i - eta_t cos theta_t) / (eta_i cos theta_i + eta_t cos theta_t), and the result is r^2;
    /// one beyond the critical angle.
    pub fn perpendicular(&self, cos_i: f64) -> f64 {
        let &Self { eta_i, eta_t } = self;
        let Some(cos_t) = self.refracted_cosine(cos_i) else { return self.without_transmission() };
        let r = (eta_i * cos_i - eta_t * cos_t) / (eta_i * cos_i + eta_t * cos_t);
        r * r
    }

    /// Reflectance of light polarized in the plane of incidence (p).
    ///
    /// r = (eta_t cos theta_i - eta_i cos theta_t) / (eta_t cos theta_i + eta_i cos theta_t), and the result is r^2;
    /// one beyond the critical angle.
    pub fn parallel(&self, cos_i: f64) -> f64 {
        let &Self { eta_i, eta_t } = self;
        let Some(cos_t) = self.refracted_cosine(cos_i) else { return self.without_transmission() };
        let r = (eta_t * cos_i - eta_i * cos_t) / (eta_t * cos_i + eta_i * cos_t);
        r * r
    }

    /// One; but no boundary, met at 90 degrees, reflects nothing.
    fn without_transmission(&self) -> f64 {
        if self.eta_i == self.eta_t { 0.0 } else { 1.0 }
    }

    /// Reflectance of unpolarized light: the mean of both polarizations.
    pub fn unpolarized(&self, cos_i: f64) -> f64 {
        (self.perpendicular(cos_i) + self.parallel(cos_i)) / 2.0
    }

    /// R0 = ((eta_i - eta_t) / (eta_i + eta_t))^2, the reflectance at normal incidence.
    pub fn at_normal(&self) -> f64 {
        let r = (self.eta_i - self.eta_t) / (self.eta_i + self.eta_t);
        r * r
    }

    /// Schlick's approximation of [`Self::unpolarized`].
    ///
    /// Into the denser medium with cos theta_i; into the rarer one with cos theta_t, and one beyond the
    /// critical angle: with cos theta_i it would not know total reflection.
    pub fn schlick(&self, cos_i: f64) -> f64 {
        if self.eta_i <= self.eta_t {
            return schlick(self.at_normal(), cos_i);
        }
        self.refracted_cosine(cos_i).map_or(1.0, |cos_t| schlick(self.at_normal(), cos_t))
    }

    /// The angle at which nothing of the parallel polarization is reflected, atan(eta_t / eta_i), in radians.
    pub fn brewster_angle(&self) -> f64 {
        elementary::atan(self.eta_t / self.eta_i)
    }

    /// The angle beyond which all is reflected, asin(eta_t / eta_i), in radians; `None` into a denser medium.
    pub fn critical_angle(&self) -> Option<f64> {
        (self.eta_t < self.eta_i).then(|| elementary::asin(self.eta_t / self.eta_i))
    }

    /// The largest |schlick - unpolarized| and the angle in radians at which it occurs.
    ///
    /// The angle is found to 1e-8 by golden sections around the largest of 9001 values.
    pub fn largest_schlick_error(&self) -> (f64, f64) {
        let error = |angle: f64| {
            let cosine = elementary::cos(angle).max(0.0);
            (self.schlick(cosine) - self.unpolarized(cosine)).abs()
        };
        let step = FRAC_PI_2 / 9000.0;
        let best = (0..=9000).map(|index| f64::from(index) * step).fold(0.0, |a, b| if error(b) > error(a) { b } else { a });
        let angle = greatest(error, (best - step).max(0.0), (best + step).min(FRAC_PI_2));
        (error(angle), angle)
    }
}

/// R = R0 + (1 - R0) (1 - cos)^5 (Schlick 1994, eq. 15).
pub fn schlick(at_normal: f64, cosine: f64) -> f64 {
    let w = 1.0 - cosine;
    at_normal + (1.0 - at_normal) * (w * w * w * w * w)
}

/// Angle in radians of an angle in degrees.
pub fn radians(degrees: f64) -> f64 {
    degrees * (PI / 180.0)
}

/// Angle in degrees of an angle in radians.
pub fn degrees(radians: f64) -> f64 {
    radians * (180.0 / PI)
}

/// Cosine of an angle in degrees, from 0 to 90; exact at both ends.
pub fn cosine_of_degrees(degrees: f64) -> f64 {
    if degrees >= 90.0 { 0.0 } else { elementary::cos(radians(degrees)) }
}

/// Where `f`, which has one maximum between `low` and `high`, is greatest (Kiefer 1953).
fn greatest(f: impl Fn(f64) -> f64, mut low: f64, mut high: f64) -> f64 {
    const GOLDEN: f64 = 0.618_033_988_749_894_8;
    while high - low > 1e-8 {
        let third = GOLDEN * (high - low);
        if f(high - third) > f(low + third) {
            high = low + third;
        } else {
            low = high - third;
        }
    }
    (low + high) / 2.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[track_caller]
    fn assert_near(value: f64, expected: f64, half_digit: f64) {
        assert!((value - expected).abs() <= half_digit, "{value} instead of {expected}");
    }

    #[test]
    fn brewster_and_critical_angles_are_the_published_ones() {
        for (eta, entering, leaving, critical) in [(1.4, 54.46, 35.54, 45.58), (1.45, 55.41, 34.59, 43.60)] {
            assert_near(degrees(Boundary::entering(eta).brewster_angle()), entering, 0.005);
            assert_near(degrees(Boundary::leaving(eta).brewster_angle()), leaving, 0.005);
            assert_near(degrees(Boundary::leaving(eta).critical_angle().unwrap()), critical, 0.005);
            assert_eq!(Boundary::entering(eta).critical_angle(), None);
        }
    }

    #[test]
    fn reflectance_at_the_normal_is_the_published_one() {
        for (eta, expected) in [(1.4, 0.027_778), (1.45, 0.033_736), (1.5, 0.04)] {
            for boundary in [Boundary::entering(eta), Boundary::leaving(eta)] {
                assert_near(boundary.at_normal(), expected, 5e-7);
                assert_near(boundary.unpolarized(1.0), boundary.at_normal(), 1e-15);
                assert_near(boundary.schlick(1.0), boundary.at_normal(), 1e-15);
            }
        }
    }

    #[test]
    fn only_the_parallel_polarization_vanishes_at_brewsters_angle() {
        for boundary in [Boundary::entering(1.4), Boundary::leaving(1.45)] {
            let cosine = elementary::cos(boundary.brewster_angle());
            assert!(boundary.parallel(cosine) < 1e-30);
            assert!(boundary.perpendicular(cosine) > 0.1);
        }
    }

    #[test]
    fn all_is_reflected_at_grazing_and_beyond_the_critical_angle() {
        for boundary in [Boundary::entering(1.5), Boundary::leaving(1.5)] {
            assert_eq!((boundary.perpendicular(0.0), boundary.parallel(0.0), boundary.schlick(0.0)), (1.0, 1.0, 1.0));
        }
        let leaving = Boundary::leaving(1.5);
        let beyond = elementary::cos(leaving.critical_angle().unwrap() + 1e-3);
        assert_eq!((leaving.perpendicular(beyond), leaving.parallel(beyond), leaving.schlick(beyond)), (1.0, 1.0, 1.0));
    }

    #[test]
    fn no_boundary_reflects_nothing() {
        for cosine in [0.0, 1e-300, 0.3, 1.0] {
            // The refracted cosine comes back with a rounding or two, whose square is left.
            assert!(Boundary::entering(1.0).unpolarized(cosine) < 1e-30);
        }
    }

    #[test]
    fn reflectance_is_the_same_from_both_sides() {
        let (enter, leave) = (Boundary::entering(1.45), Boundary::leaving(1.45));
        for step in 1..90 {
            let cos_i = cosine_of_degrees(f64::from(step));
            let cos_t = enter.refracted_cosine(cos_i).unwrap();
            // Going back through Snell's law divides a few roundings by the cosine, twice.
            let tolerance = 4.0 * f64::EPSILON / (cos_i * cos_i);
            assert_near(enter.perpendicular(cos_i), leave.perpendicular(cos_t), tolerance);
            assert_near(enter.parallel(cos_i), leave.parallel(cos_t), tolerance);
            assert_near(enter.schlick(cos_i), leave.schlick(cos_t), tolerance);
        }
    }

    #[test]
    fn schlick_errs_by_the_published_amounts() {
        for (eta, error, angle) in [(1.4, 0.0461, 84.3), (1.45, 0.0398, 84.7)] {
            let (found, at) = Boundary::entering(eta).largest_schlick_error();
            assert_near(found, error, 5e-5);
            assert_near(degrees(at), angle, 0.05);
            assert_near(Boundary::leaving(eta).largest_schlick_error().0, error, 5e-5);
        }
    }

    #[test]
    fn hemispherical_means_are_the_published_ones_and_satisfy_the_identity() {
        // The integral of 2 F(c) c over c, midpoint rule in c^2.
        let mean = |boundary: Boundary| {
            let count = 200_000;
            let value = |index| boundary.unpolarized(((f64::from(index) + 0.5) / f64::from(count)).sqrt());
            (0..count).map(value).sum::<f64>() / f64::from(count)
        };
        let (enter, leave) = (mean(Boundary::entering(1.4)), mean(Boundary::leaving(1.4)));
        assert_near(enter, 0.07681, 5e-6);
        assert_near(leave, 0.528_985, 1e-6);
        assert_near(1.0 - leave, (1.0 - enter) / (1.4 * 1.4), 1e-6);
    }
}

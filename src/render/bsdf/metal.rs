//! Complex indices of refraction of metals, for red, green and blue.
//!
//! An index eta + i k of a spectrum has no single triple of colors. `cie-rgb` weights the spectrum with the CIE 1931
//! 2-degree matching functions and takes the result to linear Rec.709 primaries, as pbrt and Mitsuba do;
//! `three-wavelengths` takes it at 614, 549 and 466 nm, as the CS184 course does.
//!
//! Measured spectra: copper, gold, silver and aluminum of `cie-rgb` are the tables spds/metals of pbrt-v2; of
//! `three-wavelengths` Johnson and Christy, "Optical constants of the noble metals" (1972) for copper, gold and silver,
//! and Rakić, "Algorithm for the determination of intrinsic optical constants of metal films" (1995) for aluminum.
//! Platinum is the Brendel-Bormann model of Rakić et al., "Optical properties of metallic films" (1998). Data by
//! refractiveindex.info (public domain).

use glam::Vec3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::render::bsdf::BsdfError;
use crate::render::texture::parameter::{Pictures, RefractiveIndex};
use crate::render::texture::{Texture, TexturePoint};

/// A metal by its name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Metal {
    /// Aluminum.
    Aluminum,
    /// Copper.
    Copper,
    /// Gold.
    Gold,
    /// Platinum.
    Platinum,
    /// Silver.
    Silver,
    /// Reflects all light at all angles, as no metal does.
    Ideal,
}

/// How a spectrum became three numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Spectrum {
    /// By the CIE 1931 matching functions, in linear Rec.709 (pbrt, Mitsuba).
    #[default]
    CieRgb,
    /// At 614, 549 and 466 nm (CS184).
    ThreeWavelengths,
}

/// How the reflectance of a metal depends on the angle.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum ConductorFresnel {
    /// Fresnel's equations for a complex index and unpolarized light.
    #[default]
    Exact,
    /// The usual approximation for large eta² + k² (CS184); off by at most 0.0067 for copper (`cie-rgb`).
    Approximate,
}

/// The complex index of refraction of a metal over that of the medium in front of it, for red, green and blue.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ComplexIndex {
    /// Real part.
    pub eta: Vec3,
    /// Imaginary part.
    pub k: Vec3,
}

impl Metal {
    /// Its index, by that reading of its spectrum.
    pub fn index(self, spectrum: Spectrum) -> ComplexIndex {
        let (eta, k) = match (self, spectrum) {
            (Self::Aluminum, Spectrum::CieRgb) => ([1.65746, 0.88037, 0.52123], [9.22387, 6.26952, 4.83702]),
            (Self::Aluminum, Spectrum::ThreeWavelengths) => ([1.33515, 1.01095, 0.68955], [7.33983, 6.61574, 5.64713]),
            (Self::Copper, Spectrum::CieRgb) => ([0.20042, 0.92405, 1.10222], [3.91294, 2.45284, 2.14220]),
            (Self::Copper, Spectrum::ThreeWavelengths) => ([0.33228, 1.01618, 1.24737], [3.16457, 2.57852, 2.46035]),
            (Self::Gold, Spectrum::CieRgb) => ([0.14312, 0.37494, 1.44251], [3.98317, 2.38573, 1.60321]),
            (Self::Gold, Spectrum::ThreeWavelengths) => ([0.21646, 0.42833, 1.32844], [3.23900, 2.45987, 1.86612]),
            (Self::Platinum, Spectrum::CieRgb) => ([2.80149, 1.96032, 1.64949], [5.05094, 3.48914, 2.78625]),
            (Self::Platinum, Spectrum::ThreeWavelengths) => ([2.26517, 2.08211, 1.88153], [4.07410, 3.70960, 3.22891]),
            (Self::Silver, Spectrum::CieRgb) => ([0.15526, 0.11672, 0.13838], [4.82834, 3.12224, 2.14696]),
            (Self::Silver, Spectrum::ThreeWavelengths) => ([0.05919, 0.05988, 0.04737], [4.12828, 3.58925, 2.81316]),
            // An index without a real part reflects everything, whatever k is.
            (Self::Ideal, _) => ([0.0; 3], [1.0; 3]),
        };
        ComplexIndex { eta: Vec3::from_array(eta), k: Vec3::from_array(k) }
    }
}

/// The index of a material, which may vary over its surface.
#[derive(Debug, Clone, PartialEq)]
pub struct IndexTexture {
    eta: Texture<Vec3>,
    k: Texture<Vec3>,
}

impl IndexTexture {
    /// What it is at that point.
    pub fn at(&self, point: &TexturePoint) -> ComplexIndex {
        ComplexIndex { eta: self.eta.at(point), k: self.k.at(point) }
    }

    /// Whether it is the same everywhere.
    pub fn is_constant(&self) -> bool {
        self.eta.constant().is_some() && self.k.constant().is_some()
    }
}

impl From<ComplexIndex> for IndexTexture {
    fn from(ComplexIndex { eta, k }: ComplexIndex) -> Self {
        Self { eta: Texture::Constant(eta), k: Texture::Constant(k) }
    }
}

/// The index that these parameters name; `metal` is its other name for `eta` and `k`.
pub fn index_of(
    metal: Option<Metal>,
    spectrum: Spectrum,
    [eta, k]: [Option<&RefractiveIndex>; 2],
    pictures: &dyn Pictures,
) -> Result<IndexTexture, BsdfError> {
    match (metal, eta, k) {
        (Some(metal), None, None) => Ok(metal.index(spectrum).into()),
        (None, Some(eta), Some(k)) => Ok(IndexTexture { eta: eta.texture(pictures)?, k: k.texture(pictures)? }),
        (Some(_), Some(_), _) => Err(BsdfError::MetalTwice("eta")),
        (Some(_), None, Some(_)) => Err(BsdfError::MetalTwice("k")),
        (None, Some(_), None) => Err(BsdfError::MetalMissing("k")),
        (None, None, Some(_)) => Err(BsdfError::MetalMissing("eta")),
        (None, None, None) => Err(BsdfError::MetalMissing("metal")),
    }
}

impl ComplexIndex {
    /// Share of unpolarized light that is reflected at that cosine from the normal.
    #[inline]
    pub fn reflectance(&self, cosine: f32, fresnel: ConductorFresnel) -> Vec3 {
        match fresnel {
            ConductorFresnel::Exact => self.exact(cosine),
            ConductorFresnel::Approximate => self.approximate(cosine),
        }
    }

    /// a² + b² = sqrt((eta² - k² - s²)² + 4 eta² k²), a² = (a² + b² + eta² - k² - s²) / 2;
    /// Rs = (a² + b² + c² - 2 a c) / (a² + b² + c² + 2 a c),
    /// Rp = Rs (c² (a² + b²) + s⁴ - 2 a c s²) / (c² (a² + b²) + s⁴ + 2 a c s²); the mean of both.
    ///
    /// With c and s the cosine and the sine of the angle from the normal (Born and Wolf, 14.2; Lagarde 2013).
    #[inline]
    fn exact(&self, c: f32) -> Vec3 {
        let (c2, s2) = (c * c, ((1.0 - c) * (1.0 + c)).max(0.0));
        let difference = self.eta * self.eta - self.k * self.k - Vec3::splat(s2);
        let product = self.eta * self.k;
        let sum = square_root(difference * difference + 4.0 * product * product);
        let a = square_root(((sum + difference) * 0.5).max(Vec3::ZERO));
        let s_even = sum + c2;
        let s_odd = 2.0 * c * a;
        // An index of nothing reflects all, along the normal too.
        let p_even = c2 * sum + s2 * s2 + f32::MIN_POSITIVE;
        let p_odd = s_odd * s2;
        // (Rs + Rs Rp') / 2 = Rs p_even / (p_even + p_odd), one division for both.
        (s_even - s_odd) * p_even / ((s_even + s_odd) * (p_even + p_odd))
    }

    /// Rs = (eta² + k² - 2 eta c + c²) / (eta² + k² + 2 eta c + c²), Rp = ((eta² + k²) c² - 2 eta c + 1) / (... + ...);
    /// the mean of both.
    #[inline]
    fn approximate(&self, c: f32) -> Vec3 {
        let sum = self.eta * self.eta + self.k * self.k;
        let odd = 2.0 * c * self.eta;
        let ratio = |even: Vec3| (even - odd) / (even + odd);
        (ratio(sum + c * c + f32::MIN_POSITIVE) + ratio(sum * (c * c) + 1.0)) * 0.5
    }
}

/// Of each channel.
#[inline]
fn square_root(v: Vec3) -> Vec3 {
    Vec3::new(v.x.sqrt(), v.y.sqrt(), v.z.sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    const NAMED: [Metal; 5] = [Metal::Aluminum, Metal::Copper, Metal::Gold, Metal::Platinum, Metal::Silver];

    /// ((eta - 1)² + k²) / ((eta + 1)² + k²) as published beside the indices.
    #[test]
    fn reflectances_along_the_normal_are_the_published_ones() {
        let rows = [
            (Metal::Copper, [0.95215, 0.61967, 0.51058], [0.88726, 0.62061, 0.55066]),
            (Metal::Gold, [0.96666, 0.80220, 0.32405], [0.92767, 0.78825, 0.40322]),
            (Metal::Silver, [0.97480, 0.95754, 0.90627], [0.98697, 0.98290, 0.97897]),
            (Metal::Aluminum, [0.92805, 0.91780, 0.91891], [0.90998, 0.91542, 0.92062]),
            (Metal::Platinum, [0.71959, 0.62549, 0.55368], [0.66762, 0.64195, 0.59816]),
        ];
        for (metal, cie, three) in rows {
            for (spectrum, expected) in [(Spectrum::CieRgb, cie), (Spectrum::ThreeWavelengths, three)] {
                for fresnel in [ConductorFresnel::Exact, ConductorFresnel::Approximate] {
                    let found = metal.index(spectrum).reflectance(1.0, fresnel);
                    assert!((found - Vec3::from_array(expected)).abs().max_element() < 2e-5, "{metal:?} {spectrum:?}: {found}");
                }
            }
        }
    }

    #[test]
    fn an_index_of_nothing_reflects_all() {
        let nothing = ComplexIndex { eta: Vec3::ZERO, k: Vec3::ZERO };
        for fresnel in [ConductorFresnel::Exact, ConductorFresnel::Approximate] {
            for cosine in [0.0, 1e-20, 1e-3, 0.5, 1.0 - f32::EPSILON, 1.0] {
                assert_eq!(nothing.reflectance(cosine, fresnel), Vec3::ONE, "{fresnel:?} {cosine}");
            }
        }
    }

    /// Fresnel's coefficients with complex numbers: r_s = (c - n t) / (c + n t), r_p = (n c - t) / (n c + t),
    /// with n t = sqrt(n² - s²).
    fn by_complex_numbers(eta: f64, k: f64, c: f64) -> f64 {
        let square_root = |(re, im): (f64, f64)| {
            let length = (re * re + im * im).sqrt();
            (((length + re) / 2.0).sqrt(), ((length - re) / 2.0).sqrt().copysign(im))
        };
        let times = |a: (f64, f64), b: (f64, f64)| (a.0 * b.0 - a.1 * b.1, a.0 * b.1 + a.1 * b.0);
        let ratio = |a: (f64, f64), b: (f64, f64)| {
            let (minus, plus) = ((a.0 - b.0, a.1 - b.1), (a.0 + b.0, a.1 + b.1));
            (minus.0 * minus.0 + minus.1 * minus.1) / (plus.0 * plus.0 + plus.1 * plus.1)
        };
        let squared = times((eta, k), (eta, k));
        let nt = square_root((squared.0 - (1.0 - c * c), squared.1));
        (ratio((c, 0.0), nt) + ratio((squared.0 * c, squared.1 * c), nt)) / 2.0
    }

    #[test]
    fn exact_reflectances_are_those_of_complex_numbers() {
        for metal in NAMED {
            let index = metal.index(Spectrum::CieRgb);
            for step in 0..=100_u8 {
                let c = f32::from(step) / 100.0;
                let found = index.reflectance(c, ConductorFresnel::Exact);
                for channel in 0..3 {
                    let exact = by_complex_numbers(f64::from(index.eta[channel]), f64::from(index.k[channel]), f64::from(c));
                    assert!((f64::from(found[channel]) - exact).abs() < 2e-6, "{metal:?} at {c}: {found} {exact}");
                }
            }
        }
    }

    /// Section 7 of the specification: off by at most .0067 for copper.
    #[test]
    fn the_approximation_errs_by_the_published_amount() {
        let index = Metal::Copper.index(Spectrum::CieRgb);
        let error = |c: f32| index.reflectance(c, ConductorFresnel::Exact) - index.reflectance(c, ConductorFresnel::Approximate);
        let worst = (0..=1000_u16).map(|step| error(f32::from(step) / 1000.0).abs().max_element()).fold(0.0, f32::max);
        assert!((worst - 0.0067).abs() < 5e-5, "{worst}");
    }

    #[test]
    fn the_ideal_metal_reflects_everything() {
        for step in 0..=100_u8 {
            let found = Metal::Ideal.index(Spectrum::CieRgb).reflectance(f32::from(step) / 100.0, ConductorFresnel::Exact);
            assert!((found - Vec3::ONE).abs().max_element() < 1e-6, "{found}");
        }
    }
}

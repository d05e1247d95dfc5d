//! Into which directions a medium scatters: phase functions, which integrate to one.
//!
//! The angle is between the ways of light before and after, so that `g` > 0 scatters forwards.
//! After Henyey and Greenstein, "Diffuse radiation in the galaxy" (1941).

use std::f64::consts::{PI, TAU};

use glam::Vec3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::math::elementary;
use crate::render::frame::Frame;

/// Into which directions a medium scatters.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum PhaseDescription {
    /// Alike to all sides.
    Isotropic(IsotropicParameters),
    /// Forwards or backwards, by one number (Henyey and Greenstein 1941).
    HenyeyGreenstein(HenyeyGreensteinParameters),
}

/// Alike to all sides.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct IsotropicParameters {}

/// Forwards or backwards, by one number.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct HenyeyGreensteinParameters {
    /// Mean cosine between the ways of light before and after: above 0 forwards, below 0 backwards.
    #[schemars(range(min = -0.999, max = 0.999))]
    pub g: f64,
}

impl Default for PhaseDescription {
    fn default() -> Self {
        Self::Isotropic(IsotropicParameters {})
    }
}

impl PhaseDescription {
    /// Ready to scatter.
    pub fn compiled(&self) -> Phase {
        match self {
            Self::Isotropic(_) => Phase { g: 0.0 },
            Self::HenyeyGreenstein(kind) => Phase { g: kind.g },
        }
    }
}

/// A phase function of a scene.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Phase {
    g: f64,
}

/// Below this, Henyey and Greenstein's formula for the cosine loses its digits, and the lobe is as good as isotropic.
const LEAST_G: f64 = 1e-6;

impl Phase {
    /// Value, which is also the density per steradian of [`Self::sample`]: light along `way` is scattered into `to`.
    ///
    /// p = (1 - g²) / (4 pi (1 + g² - 2 g cos)^(3/2)).
    #[inline]
    pub fn value(&self, way: Vec3, to: Vec3) -> f32 {
        let g = self.g;
        // From the chord to the middle of the lobe, since 1 + g² - 2 g cos would lose the digits of small angles.
        let middle = if g < 0.0 { -way } else { way };
        let chord_squared = f64::from((middle - to).length_squared());
        let base = (1.0 - g.abs()) * (1.0 - g.abs()) + g.abs() * chord_squared;
        ((1.0 - g * g) / (4.0 * PI * base * base.sqrt())) as f32
    }

    /// A direction for light that went along `way`, drawn by the value, for two numbers from [0, 1).
    #[inline]
    pub fn sample(&self, way: Vec3, u: [f32; 2]) -> Vec3 {
        let cosine = self.cosine(u[0].into());
        let sine = (1.0 - cosine * cosine).max(0.0).sqrt();
        let (sin_phi, cos_phi) = elementary::sin_cos(TAU * f64::from(u[1]));
        let local = Vec3::new((sine * cos_phi) as f32, (sine * sin_phi) as f32, cosine as f32);
        Frame::about(way).to_world(local).normalize()
    }

    /// cos = (1 + g² - ((1 - g²) / (1 - g + 2 g u))²) / (2 g); 2 u - 1 for g → 0.
    fn cosine(&self, u: f64) -> f64 {
        let g = self.g;
        if g.abs() < LEAST_G {
            return 2.0 * u - 1.0;
        }
        let root = (1.0 - g * g) / (1.0 - g + 2.0 * g * u);
        ((1.0 + g * g - root * root) / (2.0 * g)).clamp(-1.0, 1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::sphere::uniform_sphere;
    use crate::math::statistics::{chi_square_test, sidak_level};
    use crate::math::stream::{Purpose, Stream};

    const GS: [f64; 7] = [0.0, 1e-4, 0.3, 0.6, 0.9, -0.5, -0.95];

    fn phase(g: f64) -> Phase {
        PhaseDescription::HenyeyGreenstein(HenyeyGreensteinParameters { g }).compiled()
    }

    /// ∫ over the cosine from a to b, all the way around.
    fn integral(phase: &Phase, a: f64, b: f64, factor: impl Fn(f64) -> f64) -> f64 {
        // The narrowest lobe falls within a thousandth of the cosine; a step is a tenth of that.
        const PARTS: usize = 20_000;
        let middle = |k: usize| a + (b - a) * (k as f64 + 0.5) / PARTS as f64;
        let value = |cosine: f64| {
            let to = Vec3::new((1.0 - cosine * cosine).max(0.0).sqrt() as f32, 0.0, cosine as f32);
            f64::from(phase.value(Vec3::Z, to)) * factor(cosine)
        };
        TAU * (b - a) / PARTS as f64 * (0..PARTS).map(|k| value(middle(k))).sum::<f64>()
    }

    #[test]
    fn it_integrates_to_one_with_g_as_its_mean_cosine() {
        for g in GS {
            let phase = phase(g);
            assert!((integral(&phase, -1.0, 1.0, |_| 1.0) - 1.0).abs() < 1e-3, "{g}");
            let mean = integral(&phase, -1.0, 1.0, |cosine| cosine);
            assert!((mean - g).abs() < 1e-3, "{g}: {mean}");
        }
    }

    #[test]
    fn drawn_directions_have_the_density_that_is_told_of_them() {
        const COUNT: u64 = 200_000;
        const BANDS: usize = 40;
        let level = sidak_level(1e-3, GS.len() as u32);
        for (run, g) in GS.into_iter().enumerate() {
            let phase = phase(g);
            let stream = Stream::new(run as u64 + 1, Purpose::Test);
            let way = uniform_sphere(stream.generator(0).uniform_pair()).as_vec3().normalize();
            let frame = Frame::about(way);
            // Bands of equal probability would hide errors in the drawing; bands of equal solid angle do not. In four quarters each.
            let mut found = vec![0_u64; BANDS * 4];
            let mut mean = 0.0;
            for index in 0..COUNT {
                let to = frame.to_local(phase.sample(way, stream.generator(index + 1).uniform_pair().map(|u| u as f32)));
                let band = (((f64::from(to.z) + 1.0) / 2.0 * BANDS as f64) as usize).min(BANDS - 1);
                found[band * 4 + usize::from(to.x > 0.0) * 2 + usize::from(to.y > 0.0)] += 1;
                mean += f64::from(to.z) / COUNT as f64;
            }
            let edge = |band: usize| 2.0 * band as f64 / BANDS as f64 - 1.0;
            let share = |cell: usize| integral(&phase, edge(cell / 4), edge(cell / 4 + 1), |_| 1.0) / 4.0;
            let expected: Vec<f64> = (0..BANDS * 4).map(|cell| COUNT as f64 * share(cell)).collect();
            let test = chi_square_test(&found, &expected);
            assert!(test.p_value > level, "g = {g}: {test:?}");
            // The cosine's variance is at most 1: four standard errors.
            assert!((mean - g).abs() < 4.0 / (COUNT as f64).sqrt(), "g = {g}: {mean}");
        }
    }

    #[test]
    fn forwards_is_where_light_was_going() {
        assert!(phase(0.6).value(Vec3::X, Vec3::X) > phase(0.6).value(Vec3::X, Vec3::NEG_X));
        let forwards = phase(0.95).sample(Vec3::X, [0.7, 0.2]);
        assert!(forwards.dot(Vec3::X) > 0.8, "{forwards}");
    }
}

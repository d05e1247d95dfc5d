//! A spotlight: light from a point within a cone, fading towards its edge.

use std::f64::consts::PI;

use glam::Vec3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::math::elementary;
use crate::render::scene::vector::Vector;
use crate::render::texture::value::{Color, Light, Value};

/// Light from a point within a cone, fading towards its edge.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SpotParameters {
    /// Where it is.
    pub position: Vector,
    /// A point in the middle of its cone. Default `[0, 0, 0]`.
    #[serde(default = "Vector::zero")]
    pub target: Vector,
    /// Power per solid angle along its axis: a number or `[r, g, b]`.
    #[schemars(extend("x-unit" = "W/sr"))]
    pub intensity: Color<Light>,
    /// Angle from the axis to the edge, beyond which it is dark. Default 30. The fourth report gives the cosine of this.
    #[serde(default = "cutoff")]
    #[schemars(range(max = 180), extend("exclusiveMinimum" = 0, "x-unit" = "degrees"))]
    pub cutoff_degrees: f64,
    /// Angle from the axis to where it begins to fade, at most `cutoff_degrees`. Default 3/4 of that.
    #[serde(default)]
    #[schemars(range(min = 0, max = 180), extend("x-unit" = "degrees"))]
    pub beam_degrees: Option<f64>,
    /// How it fades from there to the edge.
    #[serde(default)]
    pub falloff: Falloff,
}

fn cutoff() -> f64 {
    30.0
}

/// How a spotlight fades from its beam to its edge.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Falloff {
    /// By the angle, in a straight line: (cutoff - angle) / (cutoff - beam), as Mitsuba.
    #[default]
    Mitsuba,
    /// t^4 with t = (cos - cos cutoff) / (cos beam - cos cutoff), as pbrt-v3.
    Pbrt3,
    /// t² (3 - 2 t) of the same t, as pbrt-v4: smooth at both ends.
    Pbrt4,
}

/// A spotlight of a scene.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Spot {
    /// Where it is.
    pub position: Vec3,
    /// Power per solid angle along the axis.
    pub intensity: Vec3,
    axis: Vec3,
    /// Angles in radians.
    beam: f64,
    cutoff: f64,
    falloff: Falloff,
}

impl SpotParameters {
    /// What is wrong beyond single fields: the field and the problem.
    pub fn mistake(&self) -> Option<(&'static str, String)> {
        let beam = self.beam_degrees.filter(|beam| *beam > self.cutoff_degrees);
        let too_wide = beam
            .map(|beam| ("beam_degrees", format!("`beam_degrees` is {beam}, beyond `cutoff_degrees`, which is {}", self.cutoff_degrees)));
        let is_undirected = self.target.vec3() == self.position.vec3();
        too_wide.or_else(|| is_undirected.then(|| ("target", "`target` of the spotlight is its `position`".to_owned())))
    }

    /// As a scene holds it.
    pub fn spot(&self) -> Spot {
        let position = self.position.vec3();
        Spot {
            position,
            intensity: self.intensity.inner(),
            axis: (self.target.vec3() - position).normalize_or_zero(),
            beam: self.beam_degrees.unwrap_or(0.75 * self.cutoff_degrees).to_radians(),
            cutoff: self.cutoff_degrees.to_radians(),
            falloff: self.falloff,
        }
    }
}

impl Spot {
    /// Power per solid angle in a unit direction away from the light.
    pub fn towards(&self, direction: Vec3) -> Vec3 {
        self.intensity * self.share(f64::from(direction.dot(self.axis).clamp(-1.0, 1.0))) as f32
    }

    /// The share of the intensity at that cosine to the axis.
    fn share(&self, cosine: f64) -> f64 {
        let angle = elementary::acos(cosine);
        if angle >= self.cutoff {
            return 0.0;
        }
        if angle <= self.beam {
            return 1.0;
        }
        let (beam, cutoff) = (elementary::cos(self.beam), elementary::cos(self.cutoff));
        let t = (cosine - cutoff) / (beam - cutoff);
        match self.falloff {
            Falloff::Mitsuba => (self.cutoff - angle) / (self.cutoff - self.beam),
            Falloff::Pbrt3 => t * t * t * t,
            Falloff::Pbrt4 => t * t * (3.0 - 2.0 * t),
        }
    }

    /// Power over intensity, the solid angle of a light as bright everywhere: int of the share, in closed form.
    pub fn solid_angle(&self) -> f64 {
        let (beam, cutoff) = (elementary::cos(self.beam), elementary::cos(self.cutoff));
        let edge = match self.falloff {
            Falloff::Pbrt3 => (beam - cutoff) / 5.0,
            Falloff::Pbrt4 => (beam - cutoff) / 2.0,
            Falloff::Mitsuba if self.cutoff > self.beam => {
                beam - (elementary::sin(self.cutoff) - elementary::sin(self.beam)) / (self.cutoff - self.beam)
            }
            Falloff::Mitsuba => 0.0,
        };
        2.0 * PI * (1.0 - beam + edge)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn spot(falloff: Falloff, beam: f64, cutoff: f64) -> Spot {
        let parameters = SpotParameters {
            position: Vector([0.0, 0.0, 2.0]),
            target: Vector::zero(),
            intensity: Color::grey(1.0).unwrap(),
            cutoff_degrees: cutoff,
            beam_degrees: Some(beam),
            falloff,
        };
        assert_eq!(parameters.mistake(), None);
        parameters.spot()
    }

    const FALLOFFS: [Falloff; 3] = [Falloff::Pbrt3, Falloff::Pbrt4, Falloff::Mitsuba];

    /// Section 11 of the specification: 20 and 30 degrees.
    #[test]
    fn powers_are_the_published_ones() {
        for (falloff, expected) in FALLOFFS.into_iter().zip([0.4715, 0.6104, 0.5959]) {
            let found = spot(falloff, 20.0, 30.0).solid_angle();
            assert!((found - expected).abs() < 1e-4, "{falloff:?}: {found}");
        }
    }

    #[test]
    fn powers_are_the_integrals_of_intensities() {
        for falloff in FALLOFFS {
            for (beam, cutoff) in [(20.0, 30.0), (0.0, 90.0), (45.0, 45.0), (10.0, 170.0), (0.0, 180.0)] {
                let spot = spot(falloff, beam, cutoff);
                let count = 200_000;
                let ring = |k: u32| {
                    let cosine = 2.0 * (f64::from(k) + 0.5) / f64::from(count) - 1.0;
                    let sine = (1.0 - cosine * cosine).sqrt();
                    // In single precision, as lights are asked.
                    let direction = Vec3::new(sine as f32, 0.0, -cosine as f32).normalize();
                    f64::from(spot.towards(direction).x) * 4.0 * PI / f64::from(count)
                };
                let integral: f64 = (0..count).map(ring).sum();
                assert!((integral - spot.solid_angle()).abs() < 2e-4 * integral.max(0.1), "{falloff:?} {beam} {cutoff}: {integral}");
            }
        }
    }

    #[test]
    fn intensity_is_whole_in_the_beam_and_nothing_beyond_the_edge() {
        for falloff in FALLOFFS {
            let spot = spot(falloff, 20.0, 30.0);
            let at = |degrees: f64| spot.share(elementary::cos(degrees.to_radians()));
            assert_eq!([at(0.0), at(19.9), at(30.1), at(180.0)], [1.0, 1.0, 0.0, 0.0]);
            assert!(at(25.0) > 0.0 && at(25.0) < 1.0 && at(21.0) > at(29.0), "{falloff:?}");
        }
        assert!((spot(Falloff::Mitsuba, 20.0, 30.0).share(elementary::cos(25.0_f64.to_radians())) - 0.5).abs() < 1e-12);
    }

    #[test]
    fn a_beam_beyond_the_edge_and_a_light_without_direction_are_refused() {
        let right = SpotParameters {
            position: Vector([0.0, 1.0, 0.0]),
            target: Vector::zero(),
            intensity: Color::grey(1.0).unwrap(),
            cutoff_degrees: 30.0,
            beam_degrees: None,
            falloff: Falloff::default(),
        };
        assert_eq!(right.mistake(), None);
        assert_eq!(SpotParameters { beam_degrees: Some(31.0), ..right }.mistake().unwrap().0, "beam_degrees");
        assert_eq!(SpotParameters { target: right.position, ..right }.mistake().unwrap().0, "target");
    }
}

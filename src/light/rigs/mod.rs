//! Lights in the words of other programs: glTF, USD, pbrt-v4, Mitsuba 3, Blender.
//!
//! Each gives the same irradiance there as `relight: lights` gives here, and each file says its units and axes. The
//! functions give text; who writes it is the caller's matter. `docs/rigs.md` tells how the agreement was measured.
//! Reading order: here what is common, then `gltf`, `usda`, `pbrt`, `mitsuba`, `blender`.

pub mod blender;
pub mod gltf;
pub mod mitsuba;
pub mod pbrt;
pub mod usda;

use glam::{DQuat, DVec3};

use crate::light::lights::LightSet;

/// One light of a rig: what every program wants to know.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RigLight {
    /// Index in the set it was taken from; black lights are left out, so numbers may be missing.
    pub index: usize,
    /// Unit vector from the scene towards the light; +y up.
    pub towards: DVec3,
    /// RGB irradiance on a surface that faces it, no channel negative and at least one positive.
    pub irradiance: [f64; 3],
}

impl RigLight {
    /// The largest channel of the irradiance: the intensity where a program wants a number and a color.
    pub fn intensity(&self) -> f64 {
        self.irradiance.into_iter().fold(0.0, f64::max)
    }

    /// The irradiance over the largest channel: the color, whose largest channel is 1.
    pub fn color(&self) -> [f64; 3] {
        let intensity = self.intensity();
        self.irradiance.map(|channel| channel / intensity)
    }

    /// `light_0007`.
    pub fn name(&self) -> String {
        format!("light_{:04}", self.index)
    }
}

/// Lights that other programs can take.
#[derive(Debug, Clone, PartialEq)]
pub struct Rig {
    /// The lights, in the order of the set.
    pub lights: Vec<RigLight>,
    /// How many of the set are black, and left out.
    pub black_count: usize,
    /// How many have a negative channel, which counts as zero.
    pub negative_count: usize,
    /// Size of the map that was cut, in pixels.
    pub map_size: [u32; 2],
}

/// Lights that no program can take.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum RigError {
    /// An irradiance is NaN or beyond single precision, in which the programs compute.
    #[error("the irradiance of light {0} is not a number of single precision; repair the map with `sanitize: zero` or `clamp` of `load`")]
    Irradiance(usize),
    /// A direction has no length.
    #[error("light {0} has no direction")]
    Direction(usize),
}

impl Rig {
    /// The lights of a set, without black ones; negative channels count as zero.
    pub fn of(set: &LightSet) -> Result<Self, RigError> {
        let mut rig = Self { lights: Vec::new(), black_count: 0, negative_count: 0, map_size: [set.map_width, set.map_height] };
        for (index, light) in set.lights.iter().enumerate() {
            if light.irradiance.iter().any(|channel| !(*channel as f32).is_finite()) {
                return Err(RigError::Irradiance(index));
            }
            let towards = light.direction.try_normalize().ok_or(RigError::Direction(index))?;
            let irradiance = light.irradiance.map(|channel| channel.max(0.0));
            rig.negative_count += usize::from(light.irradiance.iter().any(|channel| *channel < 0.0));
            // What single precision cannot tell from zero is black to the programs.
            if irradiance.iter().all(|channel| *channel as f32 == 0.0) {
                rig.black_count += 1;
            } else {
                rig.lights.push(RigLight { index, towards, irradiance });
            }
        }
        Ok(rig)
    }

    /// What the person who saves the rig should know.
    pub fn warnings(&self) -> Vec<String> {
        let lights = |count: usize| if count == 1 { "1 light".to_owned() } else { format!("{count} lights") };
        let black = (self.black_count > 0).then(|| format!("{} of no irradiance left out of the rig", lights(self.black_count)));
        let negative = (self.negative_count > 0).then(|| {
            format!("{} with a negative channel, which other programs cannot show: it is written as zero", lights(self.negative_count))
        });
        black.into_iter().chain(negative).collect()
    }

    /// One sentence on where the lights come from.
    fn provenance(&self, made_by: &str) -> String {
        let [width, height] = self.map_size;
        let lights =
            if self.lights.len() == 1 { "1 directional light".to_owned() } else { format!("{} directional lights", self.lights.len()) };
        format!("{lights} of a {width} x {height} lat-long map, by {made_by}")
    }
}

/// The rotation that brings +z to `towards`, so that a light that shines along its own -z shines from there.
///
/// q = (z × d, 1 + z·d) normalized. The real part is written without cancellation near d = -z; there half a turn
/// about x stands for the many rotations that would do.
pub fn orientation(towards: DVec3) -> DQuat {
    let across = towards.x * towards.x + towards.y * towards.y;
    let real = if towards.z < 0.0 { across / (1.0 - towards.z) } else { 1.0 + towards.z };
    let length = (across + real * real).sqrt();
    if length == 0.0 {
        return DQuat::from_xyzw(1.0, 0.0, 0.0, 0.0);
    }
    DQuat::from_xyzw(-towards.y / length, towards.x / length, 0.0, real / length)
}

/// A number in its shortest form that reads back to the same bits; zero without a sign.
fn number(value: f64) -> String {
    // Adding positive zero turns a negative one into it.
    format!("{:?}", value + 0.0)
}

/// Numbers with something between them.
fn numbers(values: &[f64], between: &str) -> String {
    values.iter().map(|value| number(*value)).collect::<Vec<_>>().join(between)
}

#[cfg(test)]
pub(crate) mod examples {
    use glam::DVec3;

    use super::*;
    use crate::light::lights::{Light, Region};

    /// Lights from above, from the left, and from behind; one black.
    pub fn set() -> LightSet {
        let light = |direction: DVec3, irradiance| Light {
            region: Region { x0: 0, y0: 0, x1: 1, y1: 1 },
            x: 0.5,
            y: 0.5,
            direction,
            irradiance,
            solid_angle: 0.1,
            energy: 1.0,
        };
        let lights = vec![
            light(DVec3::Y, [2.0, 1.0, 0.5]),
            light(DVec3::new(-0.6, 0.0, 0.8), [0.0; 3]),
            light(DVec3::new(-0.6, 0.0, 0.8), [0.1, 0.3, -0.2]),
            light(DVec3::new(0.0, 0.0, -1.0), [1e-3, 0.0, 0.0]),
        ];
        LightSet { map_width: 8, map_height: 4, lights }
    }

    pub fn rig() -> Rig {
        Rig::of(&set()).unwrap()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::sphere;

    #[test]
    fn black_lights_are_left_out_and_negative_channels_are_zero() {
        let rig = examples::rig();
        assert_eq!(rig.lights.iter().map(|light| light.index).collect::<Vec<_>>(), [0, 2, 3]);
        assert_eq!((rig.black_count, rig.negative_count), (1, 1));
        assert_eq!((rig.lights[1].intensity(), rig.lights[1].color()), (0.3, [0.1 / 0.3, 1.0, 0.0]));
        assert_eq!(rig.lights[1].name(), "light_0002");
        assert!(rig.warnings()[0].starts_with("1 light of no irradiance") && rig.warnings()[1].contains("negative"));
    }

    #[test]
    fn what_is_no_number_or_has_no_direction_is_refused_by_its_index() {
        for (change, expected) in [
            ((DVec3::Y, [f64::NAN, 0.0, 0.0]), RigError::Irradiance(2)),
            ((DVec3::Y, [1e300, 0.0, 0.0]), RigError::Irradiance(2)),
            ((DVec3::ZERO, [1.0; 3]), RigError::Direction(2)),
        ] {
            let mut set = examples::set();
            (set.lights[2].direction, set.lights[2].irradiance) = change;
            assert_eq!(Rig::of(&set), Err(expected));
        }
    }

    #[test]
    fn the_orientation_brings_z_to_every_direction() {
        let near = |x: f64, y: f64| DVec3::new(x, y, -1.0).normalize();
        let directions = (0..400).map(|k| sphere::uniform_sphere([f64::from(k % 20) / 20.0, f64::from(k / 20) / 20.0]));
        let hard = [DVec3::Z, -DVec3::Z, DVec3::X, -DVec3::Y, near(1e-9, 0.0), near(-1e-5, 1e-7), near(0.0, -1e-12)];
        for towards in directions.chain(hard) {
            let q = orientation(towards);
            assert!((q.length() - 1.0).abs() < 1e-15, "{towards}: {q}");
            assert!((q * DVec3::Z - towards).length() < 2e-15, "{towards}: {}", q * DVec3::Z);
        }
    }

    #[test]
    fn numbers_read_back_to_the_same_bits() {
        assert_eq!([number(-0.0), number(1.0), number(1e-7), number(1.0 / 3.0)], ["0.0", "1.0", "1e-7", "0.3333333333333333"]);
        assert_eq!(numbers(&[1.0, 2.5], ", "), "1.0, 2.5");
    }
}

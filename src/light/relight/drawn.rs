//! A sphere whose pixels draw directions for themselves: by the map, by the lobe, or by both combined.
//!
//! Directions of a combination are weighted by the balance or the power heuristic, in solid angle. Each pixel has a set of
//! points of its own, so that errors are grain, or all share one, so that they are smooth and alike in neighbors. What a
//! pixel draws is a function of seed and pixel alone.
//!
//! After Veach and Guibas, "Optimally combining sampling techniques for Monte Carlo rendering" (1995).

use glam::DVec3;

use crate::image::raster::Image;
use crate::light::envmap::EnvMap;
use crate::light::points::{Arrangement, PointSet};
use crate::light::relight::lobe::{Lobe, Reflection};
use crate::light::relight::sphere::{self, Scanline};
use crate::light::sampling::{Lit, Sampler};
use crate::math::stream::Purpose;

/// By what directions are drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Technique {
    /// By the map alone.
    Map,
    /// By the lobe alone; for Lambert's that is the cosine.
    Lobe,
    /// Half by the map, half by the lobe (of an odd number one more by the map), each weighted by its share of the sum of densities.
    Balance,
    /// The same with squares of the densities: less noise where one technique is good.
    Power,
}

impl Technique {
    /// How many of `count` directions are drawn by the map and by the lobe.
    fn counts(self, count: usize) -> [usize; 2] {
        match self {
            Technique::Map => [count, 0],
            Technique::Lobe => [0, count],
            Technique::Balance | Technique::Power => [count - count / 2, count / 2],
        }
    }

    /// Weight of a direction over its density: w / (n p) for one drawn with `own` = n p, where the other technique has `other`.
    #[inline]
    fn weight(self, own: f64, other: f64) -> f64 {
        match self {
            Technique::Map | Technique::Lobe => 1.0 / own,
            Technique::Balance => 1.0 / (own + other),
            // own² / (own² + other²) / own, without squares that overflow.
            Technique::Power => {
                let ratio = other / own;
                1.0 / (own * (1.0 + ratio * ratio))
            }
        }
    }
}

/// How a sphere draws its directions.
#[derive(Debug, Clone, Copy)]
pub struct Drawing<'a> {
    /// The map that lights the sphere.
    pub map: &'a EnvMap,
    /// Draws by the map; its density is asked of directions drawn by the lobe. Not needed for `Technique::Lobe`.
    pub sampler: Option<&'a Sampler<'a>>,
    /// What the sphere is made of.
    pub lobe: Lobe,
    /// By what directions are drawn.
    pub technique: Technique,
    /// How points are spread; not `RowsThenColumns`.
    pub arrangement: Arrangement,
    /// Directions of each pixel.
    pub count: usize,
    /// The seed.
    pub seed: u64,
    /// Whether all pixels share one set of points.
    pub is_shared: bool,
}

/// Directions drawn before the caller is asked whether to stop: a few milliseconds.
const DIRECTIONS_PER_CHECK: usize = 1 << 12;

/// Directions that are drawn together.
const BATCH: usize = 32;

impl Drawing<'_> {
    /// The picture of the sphere, `size` x `size` pixels.
    ///
    /// # Errors
    /// What `check` gives.
    ///
    /// # Panics
    /// Without a sampler, if the technique draws by the map.
    pub fn relight<E: Send>(&self, size: usize, albedo: [f64; 3], check: impl Fn() -> Result<(), E> + Sync) -> Result<Image, E> {
        sphere::picture(size, |line: &Scanline| {
            let colors = line.normals.iter().enumerate().map(|(place, normal)| {
                let pixel = (line.row * size + line.first + place) as u64;
                let radiance = self.radiance(*normal, pixel, &check)?;
                Ok([0, 1, 2].map(|channel| albedo[channel] * radiance[channel]))
            });
            colors.collect()
        })
    }

    /// Radiance of a white surface of that unit normal at the pixel of that number.
    ///
    /// # Errors
    /// What `check` gives.
    pub fn radiance<E>(&self, normal: DVec3, pixel: u64, check: &impl Fn() -> Result<(), E>) -> Result<[f64; 3], E> {
        let reflection = self.lobe.at(normal);
        let counts = self.technique.counts(self.count);
        let set = if self.is_shared { 0 } else { pixel };
        let points = |purpose, count| PointSet::new(self.arrangement, count, self.seed, purpose, set);
        let mut sum = [0.0; 3];
        self.add_by_map(&reflection, counts, points(Purpose::PixelSampling, counts[0]), &mut sum, check)?;
        self.add_by_lobe(&reflection, counts, points(Purpose::LobeSampling, counts[1]), &mut sum, check)?;
        Ok(sum)
    }

    fn add_by_map<E>(
        &self,
        reflection: &Reflection,
        counts: [usize; 2],
        points: PointSet,
        sum: &mut [f64; 3],
        check: &impl Fn() -> Result<(), E>,
    ) -> Result<(), E> {
        let [by_map, by_lobe] = counts.map(|count| count as f64);
        for first in (0..counts[0]).step_by(BATCH) {
            if first % DIRECTIONS_PER_CHECK == 0 {
                check()?;
            }
            let sampler = self.sampler.expect("a technique that draws by the map has a sampler");
            let batch: [[f64; 2]; BATCH] = std::array::from_fn(|i| points.point((first + i) as u64));
            for Lit { direction, radiance, pdf } in sampler.lit(self.map, &batch).into_iter().take(counts[0] - first) {
                let value = reflection.value(direction);
                if value > 0.0 && pdf > 0.0 {
                    let other = if counts[1] > 0 { by_lobe * reflection.pdf(direction) } else { 0.0 };
                    add(sum, radiance, value * self.technique.weight(by_map * pdf, other));
                }
            }
        }
        Ok(())
    }

    fn add_by_lobe<E>(
        &self,
        reflection: &Reflection,
        counts: [usize; 2],
        points: PointSet,
        sum: &mut [f64; 3],
        check: &impl Fn() -> Result<(), E>,
    ) -> Result<(), E> {
        let [by_map, by_lobe] = counts.map(|count| count as f64);
        for k in 0..counts[1] {
            if k % DIRECTIONS_PER_CHECK == 0 {
                check()?;
            }
            let direction = reflection.sample(points.point(k as u64));
            let (value, pdf) = (reflection.value(direction), reflection.pdf(direction));
            if value > 0.0 && pdf > 0.0 {
                let other = if counts[0] > 0 { by_map * self.sampler.map_or(0.0, |sampler| sampler.pdf(direction)) } else { 0.0 };
                add(sum, self.map.nearest(direction), value * self.technique.weight(by_lobe * pdf, other));
            }
        }
        Ok(())
    }
}

#[inline]
fn add(sum: &mut [f64; 3], radiance: [f32; 3], weight: f64) {
    (0..3).for_each(|channel| sum[channel] += f64::from(radiance[channel]) * weight);
}

#[cfg(test)]
mod tests {
    use std::convert::Infallible;

    use super::*;
    use crate::light::distribution::{Distribution, Settings};
    use crate::light::relight::limits::Integrand;
    use crate::light::relight::reflected;
    use crate::light::sampling::Placement;
    use crate::light::test_maps::{constant, noisy};
    use crate::light::warp::WarpKind;
    use crate::math::statistics::{mean, standard_error};

    fn go() -> Result<(), Infallible> {
        Ok(())
    }

    const TECHNIQUES: [Technique; 4] = [Technique::Map, Technique::Lobe, Technique::Balance, Technique::Power];

    /// Over seeds the mean of every technique is the sum over all pixels, within four standard errors.
    #[test]
    fn every_technique_has_the_same_mean_for_every_lobe() {
        let map = noisy(64, 32);
        let normal = DVec3::new(0.36, 0.48, 0.8);
        for is_compensated in [false, true] {
            let table = Distribution::build(&map, &Settings { is_compensated, ..Settings::default() }, go).unwrap();
            let sampler = Sampler::new(&table, WarpKind::Hierarchical, Placement::SolidAngle, go).unwrap();
            for lobe in [Lobe::Diffuse, Lobe::Phong { exponent: 8 }, Lobe::Ggx { alpha: 0.4 }] {
                let mut truth = [0.0; 3];
                let reflection = lobe.at(normal);
                for y in 0..32 {
                    for x in 0..64 {
                        add(&mut truth, map.raster.pixel(x, y), reflection.value(map.direction(x, y)) * map.solid_angle(y));
                    }
                }
                for technique in TECHNIQUES {
                    if is_compensated && technique == Technique::Map {
                        continue;
                    }
                    let estimate = |seed| {
                        let arrangement = Arrangement::Sobol;
                        let sampler = Some(&sampler);
                        let drawing = Drawing { map: &map, sampler, lobe, technique, arrangement, count: 65, seed, is_shared: false };
                        drawing.radiance(normal, 3, &go).unwrap()[1]
                    };
                    let values: Vec<f64> = (0..100).map(estimate).collect();
                    // Pixel centers stand for pixels in the truth: a thousandth at this size.
                    let distance = (mean(&values) - truth[1]).abs();
                    let bound = 4.0 * standard_error(&values) + 1.5e-3 * truth[1];
                    assert!(distance < bound, "{lobe:?} {technique:?} {is_compensated}: {distance} over {bound}");
                }
            }
        }
    }

    #[test]
    fn heuristics_weigh_to_one() {
        for [a, b] in [[1.0, 2.0], [0.5, 0.0], [1e-200, 1e-190], [1e200, 3e200]] {
            for technique in [Technique::Balance, Technique::Power] {
                let second = if b > 0.0 { b * technique.weight(b, a) } else { 0.0 };
                assert!((a * technique.weight(a, b) + second - 1.0).abs() < 1e-12, "{technique:?} {a} {b}");
            }
        }
    }

    #[test]
    fn the_cosine_alone_is_exact_in_a_constant_map() {
        let map = constant(8, 4, [2.0, 1.0, 0.5]);
        let drawing = Drawing {
            map: &map,
            sampler: None,
            lobe: Lobe::Diffuse,
            technique: Technique::Lobe,
            arrangement: Arrangement::Independent,
            count: 3,
            seed: 1,
            is_shared: false,
        };
        let image = drawing.relight(5, [1.0; 3], go).unwrap();
        assert!((0..25).filter(|index| image.is_covered(*index)).all(|index| (image.color.pixels()[index][0] - 2.0).abs() < 1e-6));
    }

    /// Neighbors that share points err alike; those that do not, independently.
    #[test]
    fn shared_points_give_smooth_errors_and_own_points_grain() {
        let map = noisy(32, 16);
        let table = Distribution::build(&map, &Settings::default(), go).unwrap();
        let sampler = Sampler::new(&table, WarpKind::Marginal, Placement::Center, go).unwrap();
        let exact = reflected::exact(&map, &Integrand::radiance(), Lobe::Diffuse, 15, [1.0; 3], go).unwrap();
        let correlation = |is_shared| {
            let (arrangement, technique) = (Arrangement::Independent, Technique::Map);
            let drawing =
                Drawing { map: &map, sampler: Some(&sampler), lobe: Lobe::Diffuse, technique, arrangement, count: 16, seed: 4, is_shared };
            let image = drawing.relight(15, [1.0; 3], go).unwrap();
            let error = |index: usize| f64::from(image.color.pixels()[index][1] - exact.color.pixels()[index][1]);
            let pairs: Vec<usize> = (0..224).filter(|&index| image.is_covered(index) && image.is_covered(index + 1)).collect();
            let product: f64 = pairs.iter().map(|&index| error(index) * error(index + 1)).sum();
            product / pairs.iter().map(|&index| error(index) * error(index)).sum::<f64>()
        };
        assert!(correlation(true) > 0.8, "{}", correlation(true));
        assert!(correlation(false).abs() < 0.3, "{}", correlation(false));
    }
}

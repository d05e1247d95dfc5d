//! Ways from a point of the unit square to a pixel of a distribution: by search, by alias tables, down a pyramid.
//!
//! All but `Nearest` realize the probabilities of the distribution; they differ in speed, memory, and in what becomes of
//! points that are well spread. Each gives the place within the pixel as well.

use crate::light::alias::{AliasTables, Found};
use crate::light::distribution::{Distribution, Pixel, Placed};
use crate::light::hierarchical::Hierarchy;
use crate::light::nearest;

/// How a point finds its pixel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WarpKind {
    /// Row, then column, by inverting cumulative probabilities: well-spread points stay so along rows. No memory beside the distribution's.
    Marginal,
    /// Row, then column, by alias tables: constant time, sixteen bytes a pixel; well-spread points lose most of their order.
    Alias,
    /// Halving down a pyramid of sums: neighbors stay neighbors in both directions; three bytes a pixel.
    Hierarchical,
    /// The second report's look-up of the nearest cumulative probability.
    Nearest {
        /// Whether samples carry the probability that is intended, as in the report, or the one that is realized.
        reports_intended: bool,
    },
}

/// A warp that is ready to be used.
#[derive(Debug)]
pub struct Warp<'a> {
    distribution: &'a Distribution,
    table: Table,
}

#[derive(Debug)]
enum Table {
    Marginal,
    Alias(AliasTables),
    Hierarchical(Hierarchy),
    Nearest { reports_intended: bool },
}

impl<'a> Warp<'a> {
    /// Builds what the warp needs beside the distribution.
    ///
    /// # Errors
    /// What `check` gives.
    pub fn new<E: Send>(distribution: &'a Distribution, kind: WarpKind, check: impl Fn() -> Result<(), E> + Sync) -> Result<Self, E> {
        check()?;
        let table = match kind {
            WarpKind::Marginal => Table::Marginal,
            WarpKind::Alias => Table::Alias(AliasTables::new(distribution, check)?),
            WarpKind::Hierarchical => {
                Table::Hierarchical(Hierarchy::new(distribution.width(), distribution.height(), |x, y| distribution.weight(x, y)))
            }
            WarpKind::Nearest { reports_intended } => Table::Nearest { reports_intended },
        };
        Ok(Self { distribution, table })
    }

    /// The distribution that is drawn from.
    pub fn distribution(&self) -> &'a Distribution {
        self.distribution
    }

    /// The pixels of points of [0, 1)², without the places in them.
    ///
    /// Step by step for all points together, so that their reads are on their way at once.
    pub fn sample_all<const N: usize>(&self, points: &[[f64; 2]; N]) -> [Pixel; N] {
        match &self.table {
            Table::Marginal => self.distribution.sample_all(points),
            _ => self.place_all(points).map(|placed| placed.pixel),
        }
    }

    /// The pixels of points of [0, 1)², and where in each the point lies.
    pub fn place_all<const N: usize>(&self, points: &[[f64; 2]; N]) -> [Placed; N] {
        let distribution = self.distribution;
        match &self.table {
            Table::Marginal => distribution.place_all(points),
            Table::Alias(tables) => tables.find_all(points).map(|Found { x, y, intensity, inside }| {
                let pmf = distribution.pmf_of_intensity(intensity, y);
                Placed { pixel: Pixel { x: x as u32, y: y as u32, pmf }, inside }
            }),
            Table::Hierarchical(hierarchy) => std::array::from_fn(|k| {
                let cell = hierarchy.find(points[k], |x, y| distribution.weight(x, y));
                self.placed(cell.x, cell.y, cell.inside)
            }),
            Table::Nearest { reports_intended } => std::array::from_fn(|k| {
                let pixel = nearest::sample(distribution, points[k]);
                let intended = || distribution.pmf(pixel.x as usize, pixel.y as usize);
                let pixel = if *reports_intended { Pixel { pmf: intended(), ..pixel } } else { pixel };
                Placed { pixel, inside: [0.5; 2] }
            }),
        }
    }

    #[inline]
    fn placed(&self, x: usize, y: usize, inside: [f64; 2]) -> Placed {
        Placed { pixel: Pixel { x: x as u32, y: y as u32, pmf: self.distribution.pmf(x, y) }, inside }
    }

    /// Bytes it holds in memory beside the distribution.
    pub fn memory(&self) -> u64 {
        match &self.table {
            Table::Alias(tables) => tables.memory(),
            Table::Hierarchical(hierarchy) => hierarchy.memory(),
            Table::Marginal | Table::Nearest { .. } => 0,
        }
    }
}

/// Bytes a pixel that a warp needs beside the distribution, at most, but for its rows.
pub fn memory_per_pixel(kind: WarpKind) -> u64 {
    match kind {
        WarpKind::Alias => 16,
        WarpKind::Hierarchical => 3,
        WarpKind::Marginal | WarpKind::Nearest { .. } => 0,
    }
}

#[cfg(test)]
mod tests {
    use std::convert::Infallible;

    use super::*;
    use crate::image::raster::Raster;
    use crate::light::distribution::Settings;
    use crate::light::envmap::EnvMap;
    use crate::light::test_maps::{constant, noisy};
    use crate::math::stream::{Purpose, Stream};

    const KINDS: [WarpKind; 3] = [WarpKind::Marginal, WarpKind::Alias, WarpKind::Hierarchical];

    fn build(map: &EnvMap) -> Distribution {
        Distribution::build(map, &Settings::default(), || Ok::<(), Infallible>(())).unwrap()
    }

    fn lit(width: usize, height: usize, is_lit: impl Fn(usize, usize) -> bool) -> EnvMap {
        let color = |k: usize| if is_lit(k % width, k / width) { [2.0, 1.0, 0.5] } else { [0.0; 3] };
        EnvMap::new(Raster::new(width, height, (0..width * height).map(color).collect()))
    }

    /// On a grid of points every warp sends to a pixel what its probability says, on maps of every odd shape.
    #[test]
    fn every_warp_realizes_the_same_probabilities() {
        let maps = [
            ("black", lit(8, 4, |_, _| false)),
            ("one pixel", lit(16, 8, |x, y| (x, y) == (11, 2))),
            ("bright pole row", lit(12, 6, |_, y| y == 0)),
            ("seam column", lit(12, 6, |x, _| x == 11)),
            ("1 x 1", constant(1, 1, [1.0; 3])),
            ("3 x 5", noisy(3, 5)),
            ("37 x 9", noisy(37, 9)),
        ];
        for (name, map) in maps {
            let table = build(&map);
            for kind in KINDS {
                let warp = Warp::new(&table, kind, || Ok::<(), Infallible>(())).unwrap();
                let (width, height) = (map.width(), map.height());
                let side = 240;
                let mut counts = vec![0_u32; width * height];
                for k in 0..side * side {
                    let u = [(k % side) as f64 + 0.5, (k / side) as f64 + 0.5].map(|place| place / side as f64);
                    let Placed { pixel, inside } = warp.place_all(&[u])[0];
                    assert_eq!(pixel.pmf, table.pmf(pixel.x as usize, pixel.y as usize));
                    assert!(inside.iter().all(|place| (0.0..1.0).contains(place)));
                    counts[(pixel.y as usize) * width + pixel.x as usize] += 1;
                }
                for (k, count) in counts.into_iter().enumerate() {
                    let (share, pmf) = (f64::from(count) / (side * side) as f64, table.pmf(k % width, k / width));
                    assert!(pmf > 0.0 || count == 0, "{name} {kind:?}: drew a pixel of no weight");
                    // The edges of a pixel's share cross at most so many lines of points.
                    assert!((share - pmf).abs() < 6.0 / side as f64, "{name} {kind:?} {k}: {share} instead of {pmf}");
                }
            }
        }
    }

    #[test]
    fn places_within_pixels_are_uniform_through_every_warp() {
        let table = build(&noisy(8, 4));
        let stream = Stream::new(6, Purpose::Test);
        for kind in KINDS {
            let warp = Warp::new(&table, kind, || Ok::<(), Infallible>(())).unwrap();
            let count = 40_000;
            let mut moments = [0.0; 5];
            for k in 0..count {
                let [u, v] = warp.place_all(&[stream.generator(k).uniform_pair()])[0].inside;
                let terms = [u - 0.5, v - 0.5, u * u - 1.0 / 3.0, v * v - 1.0 / 3.0, (u - 0.5) * (v - 0.5)];
                (0..5).for_each(|term| moments[term] += terms[term] / count as f64);
            }
            // Standard deviations of the terms over sqrt(count), five of them.
            let deviations = [1.0 / 12.0_f64, 1.0 / 12.0, 4.0 / 45.0, 4.0 / 45.0, 1.0 / 144.0].map(f64::sqrt);
            let bound = 5.0 / (count as f64).sqrt();
            assert!(moments.iter().zip(deviations).all(|(moment, deviation)| moment.abs() < bound * deviation), "{kind:?} {moments:?}");
        }
    }

    #[test]
    fn the_reports_look_up_carries_the_probability_asked_for() {
        let table = build(&noisy(24, 12));
        for reports_intended in [false, true] {
            let kind = WarpKind::Nearest { reports_intended };
            let warp = Warp::new(&table, kind, || Ok::<(), Infallible>(())).unwrap();
            let pixel = warp.sample_all(&[[0.3, 0.7]])[0];
            let (x, y) = (pixel.x as usize, pixel.y as usize);
            assert_eq!(pixel.pmf, if reports_intended { table.pmf(x, y) } else { nearest::pmf(&table, x, y) });
        }
    }

    #[test]
    fn memory_is_within_what_is_said() {
        let table = build(&constant(256, 128, [1.0; 3]));
        for kind in KINDS {
            let warp = Warp::new(&table, kind, || Ok::<(), Infallible>(())).unwrap();
            assert!(warp.memory() <= memory_per_pixel(kind) * 256 * 128 + 128 * 8, "{kind:?}");
        }
    }
}

//! Sums of a map's energy along the columns and the rows of a region, with or without directions.
//!
//! What a cut needs to know of a region is how its energy lies along each side. One look at each pixel of the region tells
//! that, in f64 and without the cancellation of a summed-area table, and takes no memory that grows with the map's
//! area: a cut of 16384 x 8192 pixels needs the decoded map and little else. Knows nothing of where to cut; see `median_cut`.

use std::ops::Range;

use rayon::prelude::*;

use crate::image::color::luminance;
use crate::image::raster::Raster;
use crate::light::lights::Region;

/// The energy of a pixel: an intensity times a factor of its row.
#[derive(Debug, Clone)]
pub struct Energy {
    /// Which intensity.
    pub measure: Measure,
    /// Factor of each row.
    pub of_rows: Vec<f64>,
}

/// What of a color is energy; at least 0.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Measure {
    /// Luminance of the Rec. 709 primaries.
    Luminance,
    /// (R + G + B) / 3.
    Mean,
}

impl Measure {
    /// The intensity of a color, 0 where it is negative.
    #[inline]
    pub fn of(self, color: [f32; 3]) -> f64 {
        match self {
            Measure::Luminance => lit_luminance(color),
            Measure::Mean => lit_mean(color),
        }
    }
}

#[inline]
fn lit_luminance(color: [f32; 3]) -> f64 {
    luminance(color).max(0.0)
}

#[inline]
fn lit_mean(color: [f32; 3]) -> f64 {
    let [r, g, b] = color.map(f64::from);
    ((r + g + b) / 3.0).max(0.0)
}

/// Energy, and energy times direction.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Moment {
    /// Sum of the energies.
    pub energy: f64,
    /// Sum of energy times unit direction: x, y, z.
    pub vector: [f64; 3],
}

impl Moment {
    /// The sum of two.
    #[inline]
    #[must_use]
    pub fn plus(self, other: Self) -> Self {
        let [a, b] = [self.vector, other.vector];
        Self { energy: self.energy + other.energy, vector: [a[0] + b[0], a[1] + b[1], a[2] + b[2]] }
    }

    /// Sum of energy times squared distance (along the chord) to the mean direction: m0 - |m1|² / m0.
    #[inline]
    pub fn variance(self) -> f64 {
        let [x, y, z] = self.vector;
        if self.energy > 0.0 { (self.energy - (x * x + y * y + z * z) / self.energy).max(0.0) } else { 0.0 }
    }
}

/// Cosine and sine of the angle of each row or column.
pub type Turns = Vec<[f64; 2]>;

/// The energy of each column of a region.
///
/// # Errors
/// What `check` gives, asked every few milliseconds; so for all of this file.
pub fn of_columns<E: Send>(
    raster: &Raster,
    energy: &Energy,
    region: Region,
    check: &(impl Fn() -> Result<(), E> + Sync),
) -> Result<Vec<f64>, E> {
    match energy.measure {
        Measure::Luminance => columns_by(raster, &energy.of_rows, region, lit_luminance, check),
        Measure::Mean => columns_by(raster, &energy.of_rows, region, lit_mean, check),
    }
}

/// The energy of each row of a region.
pub fn of_rows<E: Send>(
    raster: &Raster,
    energy: &Energy,
    region: Region,
    check: &(impl Fn() -> Result<(), E> + Sync),
) -> Result<Vec<f64>, E> {
    match energy.measure {
        Measure::Luminance => rows_by(raster, &energy.of_rows, region, lit_luminance, check),
        Measure::Mean => rows_by(raster, &energy.of_rows, region, lit_mean, check),
    }
}

/// Energy with directions of each column and of each row of a region; `columns` and `rows` are the angles of the whole map.
pub fn with_directions<E: Send>(
    raster: &Raster,
    energy: &Energy,
    [columns, rows]: [&Turns; 2],
    region: Region,
    check: &(impl Fn() -> Result<(), E> + Sync),
) -> Result<[Vec<Moment>; 2], E> {
    match energy.measure {
        Measure::Luminance => directions_by(raster, &energy.of_rows, [columns, rows], region, lit_luminance, check),
        Measure::Mean => directions_by(raster, &energy.of_rows, [columns, rows], region, lit_mean, check),
    }
}

/// Pixels of one piece of parallel work, at least one row.
const PIECE: usize = 1 << 15;

/// Pieces of a region at most: each holds sums of its own.
const PIECE_LIMIT: usize = 64;

/// Columns of the region.
fn across(region: Region) -> Range<usize> {
    region.x0 as usize..region.x1 as usize
}

/// Rows of each piece of a region: a function of the region alone, so that sums are the same for any number of threads.
fn pieces(region: Region) -> Vec<Range<usize>> {
    let (width, height) = (across(region).len(), (region.y1 - region.y0) as usize);
    let rows = (PIECE / width).max(height.div_ceil(PIECE_LIMIT)).max(1);
    (region.y0 as usize..region.y1 as usize).step_by(rows).map(|y| y..(y + rows).min(region.y1 as usize)).collect()
}

/// `sum` of every piece, in order.
fn of_pieces<T: Send, E: Send>(
    region: Region,
    sum: impl Fn(Range<usize>) -> T + Sync,
    check: &(impl Fn() -> Result<(), E> + Sync),
) -> Result<Vec<T>, E> {
    let checked = |rows: Range<usize>| check().map(|()| sum(rows));
    let pieces = pieces(region);
    if pieces.len() == 1 {
        return pieces.into_iter().map(checked).collect();
    }
    pieces.into_par_iter().map(checked).collect()
}

fn columns_by<E: Send>(
    raster: &Raster,
    factors: &[f64],
    region: Region,
    intensity: impl Fn([f32; 3]) -> f64 + Sync,
    check: &(impl Fn() -> Result<(), E> + Sync),
) -> Result<Vec<f64>, E> {
    let of_piece = |rows: Range<usize>| {
        let mut sums = vec![0.0; across(region).len()];
        for y in rows {
            let colors = &raster.row(y)[across(region)];
            sums.iter_mut().zip(colors).for_each(|(sum, color)| *sum += intensity(*color) * factors[y]);
        }
        sums
    };
    let mut pieces = of_pieces(region, of_piece, check)?.into_iter();
    let mut sums = pieces.next().unwrap_or_default();
    for piece in pieces {
        sums.iter_mut().zip(piece).for_each(|(sum, more)| *sum += more);
    }
    Ok(sums)
}

fn rows_by<E: Send>(
    raster: &Raster,
    factors: &[f64],
    region: Region,
    intensity: impl Fn([f32; 3]) -> f64 + Sync,
    check: &(impl Fn() -> Result<(), E> + Sync),
) -> Result<Vec<f64>, E> {
    let of_row = |y: usize| in_lanes(&raster.row(y)[across(region)], &intensity) * factors[y];
    let pieces = of_pieces(region, |rows| rows.map(of_row).collect::<Vec<f64>>(), check)?;
    Ok(pieces.into_iter().flatten().collect())
}

/// Partial sums that are kept side by side, so that one addition need not wait for the other.
const LANES: usize = 4;

/// A sum over colors, in lanes that are added last.
#[inline]
fn in_lanes(colors: &[[f32; 3]], value: impl Fn([f32; 3]) -> f64) -> f64 {
    let mut lanes = [0.0; LANES];
    let (whole, rest) = colors.as_chunks::<LANES>();
    for chunk in whole {
        lanes.iter_mut().zip(chunk).for_each(|(lane, color)| *lane += value(*color));
    }
    lanes.iter_mut().zip(rest).for_each(|(lane, color)| *lane += value(*color));
    (lanes[0] + lanes[1]) + (lanes[2] + lanes[3])
}

/// Of each column: energy, and energy times the sine and the cosine of the row's polar angle.
type ColumnSums = [Vec<f64>; 3];

fn directions_by<E: Send>(
    raster: &Raster,
    factors: &[f64],
    [columns, rows]: [&Turns; 2],
    region: Region,
    intensity: impl Fn([f32; 3]) -> f64 + Sync,
    check: &(impl Fn() -> Result<(), E> + Sync),
) -> Result<[Vec<Moment>; 2], E> {
    let (across, turns) = (across(region), &columns[across(region)]);
    let of_piece = |piece: Range<usize>| {
        let mut sums: ColumnSums = std::array::from_fn(|_| vec![0.0; across.len()]);
        let mut energies = vec![0.0; across.len()];
        let of_row = |y: usize| {
            let (colors, [cos_theta, sin_theta]) = (&raster.row(y)[across.clone()], rows[y]);
            energies.iter_mut().zip(colors).for_each(|(energy, color)| *energy = intensity(*color) * factors[y]);
            let [plain, sines, cosines] = &mut sums;
            let each = plain.iter_mut().zip(sines.iter_mut()).zip(cosines.iter_mut()).zip(&energies);
            for (((plain, sine), cosine), energy) in each {
                *plain += energy;
                *sine += energy * sin_theta;
                *cosine += energy * cos_theta;
            }
            let [energy, cos_phi, sin_phi] = sums_of_row(&energies, turns);
            Moment { energy, vector: [sin_theta * cos_phi, cos_theta * energy, sin_theta * sin_phi] }
        };
        let moments: Vec<Moment> = piece.map(of_row).collect();
        (sums, moments)
    };
    let mut of_rows = Vec::with_capacity((region.y1 - region.y0) as usize);
    let mut sums: ColumnSums = std::array::from_fn(|_| vec![0.0; across.len()]);
    for (piece, moments) in of_pieces(region, of_piece, check)? {
        of_rows.extend(moments);
        for (sums, piece) in sums.iter_mut().zip(piece) {
            sums.iter_mut().zip(piece).for_each(|(sum, more)| *sum += more);
        }
    }
    let [plain, sines, cosines] = &sums;
    let of_column = |(x, [cos_phi, sin_phi]): (usize, &[f64; 2])| Moment {
        energy: plain[x],
        vector: [sines[x] * cos_phi, cosines[x], sines[x] * sin_phi],
    };
    Ok([turns.iter().enumerate().map(of_column).collect(), of_rows])
}

/// Sums of energy, and of energy times the cosine and the sine of the column's azimuth.
#[inline]
fn sums_of_row(energies: &[f64], turns: &[[f64; 2]]) -> [f64; 3] {
    let mut lanes = [[0.0; LANES]; 3];
    let (whole, rest) = energies.as_chunks::<LANES>();
    let (whole_turns, rest_turns) = turns.as_chunks::<LANES>();
    let mut add = |lane: usize, energy: f64, [cos, sin]: [f64; 2]| {
        lanes[0][lane] += energy;
        lanes[1][lane] += energy * cos;
        lanes[2][lane] += energy * sin;
    };
    for (energies, turns) in whole.iter().zip(whole_turns) {
        (0..LANES).for_each(|lane| add(lane, energies[lane], turns[lane]));
    }
    rest.iter().zip(rest_turns).enumerate().for_each(|(lane, (energy, turn))| add(lane, *energy, *turn));
    lanes.map(|[a, b, c, d]| (a + b) + (c + d))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::envmap::EnvMap;
    use crate::light::test_maps::noisy;
    use crate::math::elementary;

    fn energy(map: &EnvMap, measure: Measure) -> Energy {
        Energy { measure, of_rows: (0..map.height()).map(|y| map.solid_angle(y)).collect() }
    }

    fn turns(map: &EnvMap) -> [Turns; 2] {
        let of = |angle: f64| {
            let (sin, cos) = elementary::sin_cos(angle);
            [cos, sin]
        };
        [(0..map.width()).map(|x| of(map.phi(x))).collect(), (0..map.height()).map(|y| of(map.theta(y))).collect()]
    }

    fn near(found: f64, expected: f64) -> bool {
        (found - expected).abs() <= 1e-12 * expected.abs() + 1e-300
    }

    #[test]
    fn sums_are_those_of_the_pixels_one_by_one() {
        let map = noisy(203, 401);
        let [columns, rows] = turns(&map);
        let go = || Ok::<(), ()>(());
        for measure in [Measure::Luminance, Measure::Mean] {
            let energy = energy(&map, measure);
            for region in [
                Region { x0: 0, y0: 0, x1: 203, y1: 401 },
                Region { x0: 7, y0: 30, x1: 12, y1: 371 },
                Region { x0: 3, y0: 9, x1: 4, y1: 10 },
            ] {
                let value = |x: u32, y: u32| measure.of(map.raster.pixel(x as usize, y as usize)) * map.solid_angle(y as usize);
                let direction = |x: u32, y: u32| map.direction(x as usize, y as usize);
                let by_column = of_columns(&map.raster, &energy, region, &go).unwrap();
                let by_row = of_rows(&map.raster, &energy, region, &go).unwrap();
                let [with_columns, with_rows] = with_directions(&map.raster, &energy, [&columns, &rows], region, &go).unwrap();
                for (x, (found, moment)) in (region.x0..).zip(by_column.iter().zip(&with_columns)) {
                    let sum: f64 = (region.y0..region.y1).map(|y| value(x, y)).sum();
                    let vector: f64 = (region.y0..region.y1).map(|y| value(x, y) * direction(x, y).y).sum();
                    assert!(near(*found, sum) && near(moment.energy, sum) && (moment.vector[1] - vector).abs() < 1e-12 * sum);
                }
                for (y, (found, moment)) in (region.y0..).zip(by_row.iter().zip(&with_rows)) {
                    let sum: f64 = (region.x0..region.x1).map(|x| value(x, y)).sum();
                    let vector: f64 = (region.x0..region.x1).map(|x| value(x, y) * direction(x, y).z).sum();
                    assert!(near(*found, sum) && near(moment.energy, sum) && (moment.vector[2] - vector).abs() < 1e-12 * sum);
                }
                assert_eq!(with_columns.len() as u32, region.x1 - region.x0);
                assert_eq!(with_rows.len() as u32, region.y1 - region.y0);
            }
        }
    }

    #[test]
    fn variance_is_the_sum_of_energy_times_squared_distance() {
        let directions = [glam::DVec3::X, glam::DVec3::new(0.6, 0.8, 0.0), glam::DVec3::new(0.0, 0.6, 0.8)];
        let energies = [1.0, 2.0, 0.5];
        let moments = directions.iter().zip(energies).map(|(d, energy)| Moment { energy, vector: (*d * energy).to_array() });
        let sum = moments.fold(Moment::default(), Moment::plus);
        let mean = glam::DVec3::from_array(sum.vector) / sum.energy;
        let expected: f64 = directions.iter().zip(energies).map(|(d, energy)| energy * (*d - mean).length_squared()).sum();
        assert!((sum.variance() - expected).abs() < 1e-14);
        assert_eq!(Moment::default().variance(), 0.0);
    }

    #[test]
    fn summing_stops_when_told_to() {
        let map = noisy(300, 300);
        let whole = Region { x0: 0, y0: 0, x1: 300, y1: 300 };
        assert_eq!(of_columns(&map.raster, &energy(&map, Measure::Mean), whole, &|| Err("stop")), Err("stop"));
    }
}

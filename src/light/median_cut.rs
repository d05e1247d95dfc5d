//! Cuts of a map into regions, one directional light for each: of equal energy, or of little variance.
//!
//! A cut looks once at each pixel of a region (`profiles`), so a level of cuts costs a look at the map. Knows nothing of how
//! lights are used; see `relight`.
//!
//! After Debevec, "A median cut algorithm for light probe sampling" (2005), and Viriyothai and Debevec,
//! "Variance minimization light probe sampling" (SIGGRAPH 2009 posters).

use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::f64::consts::PI;
use std::num::NonZeroU32;

use glam::DVec3;
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::light::envmap::{Angles, EnvMap, direction_at, square_at, theta_of_row};
use crate::light::lights::{Light, LightSet, Region};
use crate::light::profiles::{self, Energy, Measure, Moment, Turns};
use crate::math::elementary;

/// What is called energy, and along which side a region is cut.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Variant {
    /// Debevec 2005: Rec.709 luminance times solid angle; the longer side is measured on the sphere, the
    /// width shrunk by the sine of the polar angle at the region's center.
    #[default]
    Debevec,
    /// The second coursework report: mean of R, G and B times the sine at the row's edge; the longer side is
    /// measured in plain pixels.
    #[serde(rename = "coursework-2021")]
    Coursework2021,
    /// Viriyothai and Debevec 2009: energy as in `debevec`; a region is cut where the larger of its parts' variances is
    /// least, along either side. Variance is energy times squared distance (on the sphere, along the chord) to the
    /// region's mean direction.
    Variance,
}

/// Where in its region a light stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Place {
    /// The middle of the region.
    Center,
    /// The mean of the pixels' centers, weighted by energy.
    Centroid,
    /// The mean of the pixels' directions, weighted by energy: right near the poles and for wide regions too.
    VectorMean,
    /// The column and the row that each halve the energy (the second report).
    Median,
}

impl Variant {
    /// Where this variant's source puts its lights.
    pub fn usual_place(self) -> Place {
        match self {
            Variant::Debevec => Place::Centroid,
            Variant::Coursework2021 => Place::Median,
            Variant::Variance => Place::VectorMean,
        }
    }
}

/// How to cut.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Settings {
    /// How many lights are wanted.
    pub count: NonZeroU32,
    /// What is balanced.
    pub variant: Variant,
    /// Where each light stands.
    pub place: Place,
    /// At which angle `coursework-2021` takes the sine of a row; the report's is the upper edge.
    pub sine_at: Angles,
}

impl Settings {
    /// A cut as the variant's source makes it.
    pub fn of(variant: Variant, count: NonZeroU32) -> Self {
        Self { count, variant, place: variant.usual_place(), sine_at: Angles::Edge }
    }
}

/// A map that cannot be cut.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum MedianCutError {
    /// NaN or infinity has no half.
    #[error("the pixel in column `{x}` of row `{y}` is not a finite number; load the map with `sanitize: zero`")]
    NotFinite {
        /// Column, from the left.
        x: usize,
        /// Row, from the top.
        y: usize,
    },
}

/// Cuts `map` into `settings.count` regions, or fewer where regions of a single pixel leave nothing to cut.
///
/// All regions are cut floor(log2 count) times; beyond that, the one of most energy (for `variance`: of most variance) is
/// cut until there are `count`. Both parts stand where their region stood, top or left first. Negative pixels count
/// as dark when energy is balanced, and as they are in the lights' irradiance.
///
/// # Errors
/// `NotFinite` for the first such pixel; what `check` gives.
pub fn median_cut<E: From<MedianCutError> + Send>(
    map: &EnvMap,
    settings: &Settings,
    check: impl Fn() -> Result<(), E> + Sync,
) -> Result<LightSet, E> {
    check()?;
    let is_wrong = |color: &[f32; 3]| color.iter().any(|channel| !channel.is_finite());
    if let Some(index) = map.raster.pixels().par_iter().position_first(is_wrong) {
        return Err(MedianCutError::NotFinite { x: index % map.width(), y: index / map.width() }.into());
    }
    let cutter = Cutter::new(map, settings);
    let regions = cutter.regions(settings.count, &check)?;
    let lights: Result<Vec<Light>, E> = regions.into_par_iter().map(|region| cutter.light(region, settings.place, &check)).collect();
    Ok(LightSet { map_width: map.width() as u32, map_height: map.height() as u32, lights: lights? })
}

/// What a variant calls the energy of a pixel.
fn energy_of(map: &EnvMap, settings: &Settings) -> Energy {
    let (measure, of_row): (_, &dyn Fn(usize) -> f64) = match settings.variant {
        Variant::Debevec | Variant::Variance => (Measure::Luminance, &|y| map.solid_angle(y)),
        Variant::Coursework2021 => (Measure::Mean, &|y| elementary::sin(theta_of_row(y, map.height(), settings.sine_at))),
    };
    Energy { measure, of_rows: (0..map.height()).map(of_row).collect() }
}

/// The side along which a region is cut.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Axis {
    Columns,
    Rows,
}

/// Regions whose energies differ by less than this share of them are equal.
const TIE: f64 = 1e-12;

/// A region with what decides whether it is cut next: its energy, or its variance.
#[derive(Debug, Clone, Copy)]
struct Piece {
    region: Region,
    priority: f64,
}

/// A map with all that cutting it needs.
struct Cutter<'a> {
    map: &'a EnvMap,
    variant: Variant,
    energy: Energy,
    /// Cosine and sine of the azimuth of each column.
    columns: Turns,
    /// Cosine and sine of the polar angle of each row.
    rows: Turns,
}

impl<'a> Cutter<'a> {
    fn new(map: &'a EnvMap, settings: &Settings) -> Self {
        let turn = |angle: f64| {
            let (sin, cos) = elementary::sin_cos(angle);
            [cos, sin]
        };
        Self {
            map,
            variant: settings.variant,
            energy: energy_of(map, settings),
            columns: (0..map.width()).map(|x| turn(map.phi(x))).collect(),
            rows: (0..map.height()).map(|y| turn(map.theta(y))).collect(),
        }
    }

    /// The regions of a cut into `count`, in order.
    fn regions<E: Send>(&self, count: NonZeroU32, check: &(impl Fn() -> Result<(), E> + Sync)) -> Result<Vec<Region>, E> {
        // The priority of the whole is never asked for.
        let mut pieces = vec![Piece { region: whole(self.map), priority: 0.0 }];
        for _ in 0..count.ilog2() {
            let before = pieces.len();
            pieces = self.cut_all(&pieces, check)?;
            if pieces.len() == before {
                break;
            }
        }
        if pieces.len() < count.get() as usize {
            pieces = self.cut_strongest(pieces, count.get() as usize, check)?;
        }
        Ok(pieces.into_iter().map(|piece| piece.region).collect())
    }

    fn cut_all<E: Send>(&self, pieces: &[Piece], check: &(impl Fn() -> Result<(), E> + Sync)) -> Result<Vec<Piece>, E> {
        let cut = |piece: &Piece| Ok(self.cut(piece.region, check)?.map_or_else(|| vec![*piece], Vec::from));
        let parts: Result<Vec<Vec<Piece>>, E> = pieces.par_iter().map(cut).collect();
        Ok(parts?.into_iter().flatten().collect())
    }

    /// Cuts the piece of highest priority, the first of equals, until there are `count` or none can be cut.
    fn cut_strongest<E: Send>(
        &self,
        pieces: Vec<Piece>,
        count: usize,
        check: &(impl Fn() -> Result<(), E> + Sync),
    ) -> Result<Vec<Piece>, E> {
        let mut finished = Vec::new();
        let mut open: BinaryHeap<Candidate> =
            pieces.into_iter().enumerate().map(|(index, piece)| Candidate::new(piece, vec![index as u32])).collect();
        while finished.len() + open.len() < count {
            check()?;
            let Some(strongest) = open.pop() else { break };
            match self.cut(strongest.piece.region, check)? {
                Some(halves) => open.extend(halves.into_iter().zip(0..).map(|(piece, half)| {
                    let place = strongest.place.0.iter().copied().chain([half]).collect();
                    Candidate::new(piece, place)
                })),
                None => finished.push(strongest),
            }
        }
        finished.extend(open);
        finished.sort_by(|a, b| b.place.cmp(&a.place));
        Ok(finished.into_iter().map(|candidate| candidate.piece).collect())
    }

    /// The two parts of a region; `None` for a single pixel.
    fn cut<E: Send>(&self, region: Region, check: &(impl Fn() -> Result<(), E> + Sync)) -> Result<Option<[Piece; 2]>, E> {
        let Some(longer) = self.longer_side(region) else { return Ok(None) };
        match self.variant {
            Variant::Debevec | Variant::Coursework2021 => {
                let balance = balance(&self.energies(region, longer, check)?);
                Ok(Some(parts(region, longer, balance.at, balance.energies)))
            }
            Variant::Variance => {
                let moments = profiles::with_directions(&self.map.raster, &self.energy, [&self.columns, &self.rows], region, check)?;
                let side = if longer == Axis::Columns { 0 } else { 1 };
                if moments[side].iter().all(|moment| moment.energy == 0.0) {
                    return Ok(Some(parts(region, longer, moments[side].len() / 2, [0.0; 2])));
                }
                let [columns, rows] = moments.map(|moments| least_variance(&moments));
                let energy_tie = columns.energy.max(rows.energy) * TIE;
                let is_row = rows.larger() < columns.larger() - energy_tie;
                let (axis, split) = if is_row { (Axis::Rows, rows) } else { (Axis::Columns, columns) };
                Ok(Some(parts(region, axis, split.at, split.variances)))
            }
        }
    }

    /// Energies of the columns, or of the rows, of a region.
    fn energies<E: Send>(&self, region: Region, axis: Axis, check: &(impl Fn() -> Result<(), E> + Sync)) -> Result<Vec<f64>, E> {
        match axis {
            Axis::Columns => profiles::of_columns(&self.map.raster, &self.energy, region, check),
            Axis::Rows => profiles::of_rows(&self.map.raster, &self.energy, region, check),
        }
    }

    /// The side to cut: rows only if the height is strictly larger, and never a side of one pixel.
    fn longer_side(&self, region: Region) -> Option<Axis> {
        let (width, height) = (region.x1 - region.x0, region.y1 - region.y0);
        match (width > 1, height > 1) {
            (false, false) => None,
            (true, false) => Some(Axis::Columns),
            (false, true) => Some(Axis::Rows),
            (true, true) => Some(if self.is_higher_than_wide(region) { Axis::Rows } else { Axis::Columns }),
        }
    }

    fn is_higher_than_wide(&self, region: Region) -> bool {
        let (width, height) = (f64::from(region.x1 - region.x0), f64::from(region.y1 - region.y0));
        match self.variant {
            Variant::Coursework2021 => height > width,
            Variant::Debevec | Variant::Variance => {
                let theta = f64::from(region.y0 + region.y1) / 2.0 * PI / self.map.height() as f64;
                let angle_down = height * PI / self.map.height() as f64;
                let angle_across = width * 2.0 * PI / self.map.width() as f64 * elementary::sin(theta);
                angle_down > angle_across
            }
        }
    }

    fn light<E: Send>(&self, region: Region, place: Place, check: &(impl Fn() -> Result<(), E> + Sync)) -> Result<Light, E> {
        let moments = self.moments(region, place, check)?;
        let (position, direction) = match place {
            Place::Median if moments.energy > 0.0 => {
                let position = [self.median(region, Axis::Columns, check)?, self.median(region, Axis::Rows, check)?];
                (position, self.direction_of(position))
            }
            _ => self.place(region, place, &moments),
        };
        Ok(Light {
            region,
            x: position[0],
            y: position[1],
            direction,
            irradiance: moments.irradiance,
            solid_angle: moments.solid_angle,
            energy: moments.energy,
        })
    }

    /// The column or row that halves the energy of a region; its middle where it is one pixel long.
    fn median<E: Send>(&self, region: Region, axis: Axis, check: &(impl Fn() -> Result<(), E> + Sync)) -> Result<f64, E> {
        let (first, end) = match axis {
            Axis::Columns => (region.x0, region.x1),
            Axis::Rows => (region.y0, region.y1),
        };
        if end - first < 2 {
            return Ok(f64::from(first + end) / 2.0);
        }
        let at = balance(&self.energies(region, axis, check)?).at;
        Ok(f64::from(first) + at as f64)
    }

    /// Position in pixels and unit direction of a region's light; the middle where it has no energy.
    fn place(&self, region: Region, place: Place, moments: &Moments) -> ([f64; 2], DVec3) {
        let center = [f64::from(region.x0 + region.x1) / 2.0, f64::from(region.y0 + region.y1) / 2.0];
        let position = match place {
            Place::Center => center,
            Place::Centroid if moments.energy > 0.0 => moments.position.map(|moment| moment / moments.energy),
            Place::VectorMean => match moments.vector.try_normalize() {
                Some(direction) => return (self.position_of(direction), direction),
                None => center,
            },
            Place::Centroid | Place::Median => center,
        };
        (position, self.direction_of(position))
    }

    /// The direction of a point of the map, in pixels from its upper left corner.
    ///
    /// The center of pixel (x, y) is the point (x + 1/2, y + 1/2) and has the pixel's direction.
    fn direction_of(&self, [x, y]: [f64; 2]) -> DVec3 {
        let [scale, shift] = self.pixels_per_turn();
        direction_at((y - shift[1]) / scale[1] * PI, (x - shift[0]) / scale[0] * 2.0 * PI)
    }

    /// The point of the map that has this direction.
    fn position_of(&self, direction: DVec3) -> [f64; 2] {
        let [scale, shift] = self.pixels_per_turn();
        let [u, v] = square_at(direction);
        let (width, height) = (self.map.width() as f64, self.map.height() as f64);
        [(u * scale[0] + shift[0]) % width, (v * scale[1] + shift[1]).clamp(0.0, height)]
    }

    /// Pixels around and from pole to pole, and where in pixels both angles are 0.
    fn pixels_per_turn(&self) -> [[f64; 2]; 2] {
        let (width, height) = (self.map.width() as f64, self.map.height() as f64);
        match self.map.angles {
            Angles::Center => [[width, height], [0.0, 0.0]],
            Angles::Edge => [[width, height], [0.5, 0.5]],
            Angles::EdgeInclusive => [[width, (height - 1.0).max(1.0)], [0.5, 0.5]],
        }
    }

    /// What a region's light is made of, summed row by row.
    fn moments<E>(&self, region: Region, place: Place, check: &impl Fn() -> Result<(), E>) -> Result<Moments, E> {
        let columns = &self.columns[region.x0 as usize..region.x1 as usize];
        let mut moments = Moments::default();
        for y in region.y0 as usize..region.y1 as usize {
            check()?;
            let row = &self.map.raster.row(y)[region.x0 as usize..region.x1 as usize];
            moments.add_radiance(row, self.map.solid_angle(y));
            let energies = row.iter().map(|pixel| self.energy.measure.of(*pixel) * self.energy.of_rows[y]);
            match place {
                Place::VectorMean => moments.add_directions(energies, columns, self.rows[y]),
                Place::Center | Place::Centroid | Place::Median => moments.add_positions(energies, region.x0, y),
            }
        }
        Ok(moments)
    }
}

fn whole(map: &EnvMap) -> Region {
    Region { x0: 0, y0: 0, x1: map.width() as u32, y1: map.height() as u32 }
}

/// A positive number with its last 12 bits rounded off: energies equal but for 1e-12 compare as equal.
fn comparable(energy: f64) -> u64 {
    (energy.to_bits() + (1 << 11)) >> 12
}

/// A piece that may be cut; the greatest is the one of highest priority, of equals the first in the list.
#[derive(Debug)]
struct Candidate {
    priority: u64,
    /// Index among the pieces before, then 0 or 1 for each half taken: sorts as the list would.
    place: Reverse<Vec<u32>>,
    piece: Piece,
}

impl Candidate {
    fn new(piece: Piece, place: Vec<u32>) -> Self {
        Self { priority: comparable(piece.priority), place: Reverse(place), piece }
    }
}

impl PartialEq for Candidate {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other).is_eq()
    }
}

impl Eq for Candidate {}

impl PartialOrd for Candidate {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Candidate {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.priority.cmp(&other.priority).then_with(|| self.place.cmp(&other.place))
    }
}

/// The two parts of a region that is cut `at` columns or rows from its beginning.
fn parts(region: Region, axis: Axis, at: usize, priorities: [f64; 2]) -> [Piece; 2] {
    let [first, second] = match axis {
        Axis::Columns => [Region { x1: region.x0 + at as u32, ..region }, Region { x0: region.x0 + at as u32, ..region }],
        Axis::Rows => [Region { y1: region.y0 + at as u32, ..region }, Region { y0: region.y0 + at as u32, ..region }],
    };
    [Piece { region: first, priority: priorities[0] }, Piece { region: second, priority: priorities[1] }]
}

/// A cut by energy.
struct Balance {
    /// Items before it.
    at: usize,
    /// Of both parts.
    energies: [f64; 2],
}

/// The cut at which the two parts of at least two items differ least in energy, the smallest of equals.
///
/// Both parts have at least one item; the middle (rounded down) where there is no energy.
fn balance(energies: &[f64]) -> Balance {
    let total: f64 = energies.iter().sum();
    let mut sum = 0.0;
    let before: Vec<f64> = energies[..energies.len() - 1]
        .iter()
        .map(|energy| {
            sum += energy;
            sum
        })
        .collect();
    let imbalance = |sum: f64| (2.0 * sum - total).abs();
    let least = before.iter().fold(f64::INFINITY, |least, sum| least.min(imbalance(*sum)));
    let first = before.iter().position(|sum| imbalance(*sum) <= least + TIE * total).unwrap_or(0) + 1;
    let at = if total > 0.0 { first } else { energies.len() / 2 };
    Balance { at, energies: [before[at - 1], (total - before[at - 1]).max(0.0)] }
}

/// A cut by variance.
#[derive(Debug, Clone, Copy)]
struct Split {
    /// Items before it; 0 where a single item cannot be cut.
    at: usize,
    /// Of both parts; infinite where there is no cut.
    variances: [f64; 2],
    /// Of the region.
    energy: f64,
}

impl Split {
    fn larger(&self) -> f64 {
        self.variances[0].max(self.variances[1])
    }
}

/// The cut at which the larger of the parts' variances is least, the smallest of equals.
fn least_variance(moments: &[Moment]) -> Split {
    let running = |sum: &mut Moment, moment: &Moment| {
        *sum = sum.plus(*moment);
        Some(*sum)
    };
    // Each part is summed from its own end: differences would lose the small variances.
    let before: Vec<Moment> = moments.iter().scan(Moment::default(), running).collect();
    let mut after: Vec<Moment> = moments.iter().rev().scan(Moment::default(), running).collect();
    after.reverse();
    let energy = before.last().map_or(0.0, |moment| moment.energy);
    let variances = |at: usize| [before[at - 1].variance(), after[at].variance()];
    let larger = |at: usize| variances(at)[0].max(variances(at)[1]);
    let least = (1..moments.len()).map(larger).fold(f64::INFINITY, f64::min);
    match (1..moments.len()).find(|at| larger(*at) <= least + TIE * energy) {
        Some(at) => Split { at, variances: variances(at), energy },
        None => Split { at: 0, variances: [f64::INFINITY; 2], energy },
    }
}

/// Sums over the pixels of a region.
#[derive(Debug, Default)]
struct Moments {
    /// Radiance times solid angle.
    irradiance: [f64; 3],
    solid_angle: f64,
    energy: f64,
    /// Energy times the pixel's center, in pixels.
    position: [f64; 2],
    /// Energy times the pixel's direction.
    vector: DVec3,
}

impl Moments {
    fn add_radiance(&mut self, row: &[[f32; 3]], solid_angle: f64) {
        let mut sum = [0.0; 3];
        for pixel in row {
            sum.iter_mut().zip(pixel).for_each(|(sum, channel)| *sum += f64::from(*channel));
        }
        self.irradiance.iter_mut().zip(sum).for_each(|(irradiance, sum)| *irradiance += sum * solid_angle);
        self.solid_angle += row.len() as f64 * solid_angle;
    }

    fn add_positions(&mut self, energies: impl Iterator<Item = f64>, x0: u32, y: usize) {
        let (mut energy_of_row, mut position) = (0.0, 0.0);
        for (x, energy) in (x0..).zip(energies) {
            energy_of_row += energy;
            position += energy * (f64::from(x) + 0.5);
        }
        self.energy += energy_of_row;
        self.position[0] += position;
        self.position[1] += energy_of_row * (y as f64 + 0.5);
    }

    fn add_directions(&mut self, energies: impl Iterator<Item = f64>, columns: &[[f64; 2]], [cos_theta, sin_theta]: [f64; 2]) {
        let (mut energy_of_row, mut across) = (0.0, [0.0; 2]);
        for ([cos_phi, sin_phi], energy) in columns.iter().zip(energies) {
            energy_of_row += energy;
            across[0] += energy * cos_phi;
            across[1] += energy * sin_phi;
        }
        self.energy += energy_of_row;
        self.vector += DVec3::new(sin_theta * across[0], cos_theta * energy_of_row, sin_theta * across[1]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::raster::Raster;
    use crate::light::test_maps::{constant, grace, noisy};

    fn cut(map: &EnvMap, variant: Variant, count: u32) -> LightSet {
        cut_as(map, Settings::of(variant, NonZeroU32::new(count).unwrap()))
    }

    fn cut_as(map: &EnvMap, settings: Settings) -> LightSet {
        median_cut(map, &settings, || Ok::<(), MedianCutError>(())).unwrap()
    }

    /// Total, least and greatest energy, and the number of regions one pixel thin.
    fn summary(lights: &LightSet) -> (f64, f64, f64, usize) {
        let energies = lights.lights.iter().map(|light| light.energy);
        let is_thin = |light: &&Light| light.region.x1 - light.region.x0 == 1 || light.region.y1 - light.region.y0 == 1;
        (
            energies.clone().sum(),
            energies.clone().fold(f64::INFINITY, f64::min),
            energies.fold(0.0, f64::max),
            lights.lights.iter().filter(is_thin).count(),
        )
    }

    #[track_caller]
    fn assert_near(value: f64, expected: f64, half_digit: f64) {
        assert!((value - expected).abs() <= half_digit, "{value} instead of {expected}");
    }

    #[test]
    fn grace_gives_the_energies_of_the_second_report() {
        let Some(map) = grace() else { return };
        for (count, mean, least, greatest, thin) in
            [(16, 11127.8, 10839.9, 11470.4, None), (64, 2781.95, 2532.6, 3013.5, None), (256, 695.49, 507.7, 889.8, Some(6))]
        {
            let lights = cut(&map, Variant::Coursework2021, count);
            let found = summary(&lights);
            assert_eq!(lights.lights.len(), count as usize);
            assert_near(found.0, 178_045.0, 0.05);
            assert_near(found.0 / f64::from(count), mean, 0.05);
            assert_near(found.1, least, 0.05);
            assert_near(found.2, greatest, 0.05);
            assert!(thin.is_none_or(|thin| found.3 == thin), "{} thin regions", found.3);
        }
    }

    #[test]
    fn grace_gives_the_three_totals_of_the_three_angles() {
        let Some(map) = grace() else { return };
        let one = Settings::of(Variant::Coursework2021, NonZeroU32::MIN);
        for (sine_at, total) in [(Angles::Edge, 178_045.0), (Angles::EdgeInclusive, 178_183.8), (Angles::Center, 178_484.7)] {
            assert_near(cut_as(&map, Settings { sine_at, ..one }).lights[0].energy, total, 0.05);
        }
    }

    #[test]
    fn grace_gives_debevecs_energies() {
        let Some(map) = grace() else { return };
        for (count, least, greatest) in [(16, 0.35050, 0.39063), (64, 0.06775, 0.12089), (256, 0.01187, 0.03939)] {
            let found = summary(&cut(&map, Variant::Debevec, count));
            assert_near(found.0, 5.92464, 5e-6);
            assert_near(found.1, least, 5e-6);
            assert_near(found.2, greatest, 5e-6);
        }
    }

    #[test]
    fn regions_cover_every_pixel_once_and_carry_all_light() {
        let map = noisy(48, 24);
        let mut truth = [0.0; 3];
        for y in 0..24 {
            for pixel in map.raster.row(y) {
                (0..3).for_each(|c| truth[c] += f64::from(pixel[c]) * map.solid_angle(y));
            }
        }
        for variant in [Variant::Debevec, Variant::Coursework2021, Variant::Variance] {
            for count in [1, 2, 3, 5, 7, 16, 100, 1151, 1152] {
                let set = cut(&map, variant, count);
                let mut covered = vec![0; 48 * 24];
                for Light { region, .. } in &set.lights {
                    for y in region.y0..region.y1 {
                        (region.x0..region.x1).for_each(|x| covered[(y * 48 + x) as usize] += 1);
                    }
                }
                assert!(covered.iter().all(|times| *times == 1), "{variant:?} {count}");
                for (c, truth) in truth.iter().enumerate() {
                    let sum: f64 = set.lights.iter().map(|light| light.irradiance[c]).sum();
                    assert!((sum / truth - 1.0).abs() < 1e-12, "{sum} {truth}");
                }
                let solid_angle: f64 = set.lights.iter().map(|light| light.solid_angle).sum();
                assert!((solid_angle - 4.0 * PI).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn each_cut_is_the_best_one_found_by_trying_all() {
        let map = noisy(31, 17);
        let settings = Settings::of(Variant::Coursework2021, NonZeroU32::new(2).unwrap());
        let sine = |y: usize| elementary::sin(y as f64 * PI / 17.0);
        let column = |x: usize| -> f64 { (0..17).map(|y| Measure::Mean.of(map.raster.pixel(x, y)) * sine(y)).sum() };
        let imbalance = |at: usize| ((0..at).map(column).sum::<f64>() - (at..31).map(column).sum::<f64>()).abs();
        let best = (1..31).min_by(|a, b| imbalance(*a).total_cmp(&imbalance(*b))).unwrap();
        let set = cut_as(&map, settings);
        assert_eq!((set.lights[0].region.x1, set.lights[1].region.x0), (best as u32, best as u32));
    }

    #[test]
    fn other_counts_cut_the_strongest_region_and_the_first_of_equals() {
        let map = constant(64, 32, [1.0; 3]);
        let four = cut(&map, Variant::Coursework2021, 4);
        let five = cut(&map, Variant::Coursework2021, 5);
        // By symmetry about the equator energies are nearly but not quite equal; the cut must be of the greatest.
        let strongest = four.lights.iter().map(|light| comparable(light.energy)).max().unwrap();
        let index = four.lights.iter().position(|light| comparable(light.energy) == strongest).unwrap();
        let regions = |set: &LightSet| set.lights.iter().map(|light| light.region).collect::<Vec<_>>();
        let mut joined = regions(&five);
        let second = joined.remove(index + 1);
        joined[index] = Region { x1: joined[index].x1.max(second.x1), y1: joined[index].y1.max(second.y1), ..joined[index] };
        assert_eq!(joined, regions(&four));
    }

    #[test]
    fn a_single_pixel_is_a_leaf_and_fewer_lights_come_back() {
        let set = cut(&noisy(2, 1), Variant::Debevec, 64);
        assert_eq!(set.lights.len(), 2);
        assert_eq!(cut(&noisy(1, 1), Variant::Coursework2021, 7).lights.len(), 1);
        assert_eq!(cut(&noisy(3, 2), Variant::Coursework2021, 1000).lights.len(), 6);
    }

    #[test]
    fn a_black_map_is_halved_in_the_middle() {
        for variant in [Variant::Debevec, Variant::Coursework2021, Variant::Variance] {
            let set = cut(&constant(10, 5, [0.0; 3]), variant, 2);
            assert_eq!(set.lights[0].region, Region { x0: 0, y0: 0, x1: 5, y1: 5 });
            assert_eq!((set.lights[1].x, set.lights[1].y), (7.5, 2.5));
        }
    }

    #[test]
    fn the_smallest_of_equal_cuts_is_taken() {
        // The dark columns 3 to 6 leave equal cuts at 3, 4, 5, 6 and 7.
        let dark = |x: usize| (3..7).contains(&x);
        let pixels = (0..20).map(|index| if dark(index % 10) { [0.0; 3] } else { [1.0; 3] }).collect();
        let set = cut(&EnvMap::new(Raster::new(10, 2, pixels)), Variant::Coursework2021, 2);
        assert_eq!(set.lights[0].region.x1, 3);
    }

    #[test]
    fn places_agree_with_the_pixel_where_one_pixel_shines() {
        for angles in [Angles::Center, Angles::Edge, Angles::EdgeInclusive] {
            let mut map = constant(16, 8, [0.0; 3]);
            map.angles = angles;
            map.raster.set_pixel(11, 2, [1.0, 2.0, 3.0]);
            for place in [Place::Centroid, Place::VectorMean] {
                let settings = Settings { place, ..Settings::of(Variant::Debevec, NonZeroU32::MIN) };
                let light = cut_as(&map, settings).lights[0];
                assert!((light.direction - map.direction(11, 2)).length() < 1e-14, "{angles:?} {place:?}");
                assert!((light.x - 11.5).abs() + (light.y - 2.5).abs() < 1e-12, "{angles:?} {place:?}");
            }
        }
    }

    /// All cuts of both sides, each variance from its definition: energy times squared distance to the mean direction.
    #[test]
    fn a_cut_by_variance_is_the_best_one_found_by_trying_all() {
        for (width, height) in [(9, 5), (6, 6), (2, 7), (1, 5), (5, 1)] {
            let map = noisy(width, height);
            let energy = |x: usize, y: usize| Measure::Luminance.of(map.raster.pixel(x, y)) * map.solid_angle(y);
            let variance = |x: std::ops::Range<usize>, y: std::ops::Range<usize>| {
                let pixels: Vec<(f64, DVec3)> =
                    y.flat_map(|y| x.clone().map(move |x| (x, y))).map(|(x, y)| (energy(x, y), map.direction(x, y))).collect();
                let sum: f64 = pixels.iter().map(|(energy, _)| energy).sum();
                let mean = pixels.iter().map(|(energy, direction)| *direction * *energy).sum::<DVec3>() / sum;
                pixels.iter().map(|(energy, direction)| energy * (*direction - mean).length_squared()).sum::<f64>()
            };
            let columns = (1..width).map(|at| {
                (variance(0..at, 0..height).max(variance(at..width, 0..height)), Region { x0: 0, y0: 0, x1: at as u32, y1: height as u32 })
            });
            let rows = (1..height).map(|at| {
                (variance(0..width, 0..at).max(variance(0..width, at..height)), Region { x0: 0, y0: 0, x1: width as u32, y1: at as u32 })
            });
            let best = columns.chain(rows).min_by(|a, b| a.0.total_cmp(&b.0)).unwrap();
            assert_eq!(cut(&map, Variant::Variance, 2).lights[0].region, best.1, "{width}x{height}");
        }
    }

    #[test]
    fn other_counts_cut_the_region_of_most_variance() {
        let map = noisy(64, 32);
        let regions = |count| cut(&map, Variant::Variance, count).lights.iter().map(|light| light.region).collect::<Vec<_>>();
        let variance = |region: &Region| {
            let cutter = Cutter::new(&map, &Settings::of(Variant::Variance, NonZeroU32::MIN));
            let rows =
                profiles::with_directions(&map.raster, &cutter.energy, [&cutter.columns, &cutter.rows], *region, &|| Ok::<(), ()>(()))
                    .unwrap();
            rows[1].iter().fold(Moment::default(), |sum, moment| sum.plus(*moment)).variance()
        };
        let (four, five) = (regions(4), regions(5));
        let gone: Vec<&Region> = four.iter().filter(|region| !five.contains(region)).collect();
        let most = four.iter().max_by(|a, b| variance(a).total_cmp(&variance(b))).unwrap();
        assert_eq!(gone, [most]);
    }

    #[test]
    fn cuts_of_degenerate_maps_cover_them() {
        let lit = |width: usize, height: usize, is_lit: &dyn Fn(usize, usize) -> bool| {
            let color = |k: usize| if is_lit(k % width, k / width) { [1.0, 2.0, 3.0] } else { [0.0; 3] };
            EnvMap::new(Raster::new(width, height, (0..width * height).map(color).collect()))
        };
        let maps = [
            lit(16, 8, &|x, y| (x, y) == (5, 3)),
            lit(16, 8, &|_, y| y == 0),
            lit(16, 8, &|x, _| x == 15),
            lit(1, 1, &|_, _| true),
            noisy(3, 5),
        ];
        for map in maps {
            let total: f64 =
                (0..map.height()).map(|y| map.raster.row(y).iter().map(|p| f64::from(p[2])).sum::<f64>() * map.solid_angle(y)).sum();
            for variant in [Variant::Debevec, Variant::Coursework2021, Variant::Variance] {
                for place in [Place::Center, Place::Centroid, Place::VectorMean, Place::Median] {
                    for count in [1, 2, 7, 64] {
                        let set = cut_as(&map, Settings { place, ..Settings::of(variant, NonZeroU32::new(count).unwrap()) });
                        let sum: f64 = set.lights.iter().map(|light| light.irradiance[2]).sum();
                        assert!((sum / total - 1.0).abs() < 1e-12, "{variant:?} {place:?} {count}");
                        assert!(set.lights.iter().all(|light| (light.direction.length() - 1.0).abs() < 1e-12));
                        assert_eq!(set.lights.len(), (count as usize).min(map.width() * map.height()));
                    }
                }
            }
        }
    }

    #[test]
    fn cuts_do_not_depend_on_the_number_of_threads() {
        let map = noisy(600, 300);
        let pool = |count| rayon::ThreadPoolBuilder::new().num_threads(count).build().unwrap();
        for variant in [Variant::Debevec, Variant::Variance] {
            assert_eq!(pool(1).install(|| cut(&map, variant, 37)), pool(3).install(|| cut(&map, variant, 37)));
        }
    }

    #[test]
    fn a_pixel_that_is_not_finite_is_named() {
        let mut map = noisy(16, 8);
        map.raster.set_pixel(3, 0, [f32::NAN, 0.0, 0.0]);
        map.raster.set_pixel(1, 5, [0.0, f32::NEG_INFINITY, 0.0]);
        let settings = Settings::of(Variant::Coursework2021, NonZeroU32::MIN);
        let error = median_cut(&map, &settings, || Ok::<(), MedianCutError>(())).unwrap_err();
        assert_eq!(error, MedianCutError::NotFinite { x: 3, y: 0 });
    }
}

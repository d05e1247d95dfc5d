//! Median cut: splits a map into regions of equal energy, one directional light for each.
//!
//! Energies come from a summed-area table, so that a cut costs as many look-ups as the region is long.
//! Knows nothing of how lights are used; see `relight`.
//!
//! After Debevec, "A median cut algorithm for light probe sampling" (2005).

use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::f64::consts::PI;
use std::num::NonZeroU32;

use glam::DVec3;
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::image::color::luminance;
use crate::light::envmap::{Angles, EnvMap, direction_at, square_at, theta_of_row};
use crate::light::lights::{Light, LightSet, Region};
use crate::light::relight::estimators::intensity;
use crate::light::summed_area::SummedArea;
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
/// All regions are cut floor(log2 count) times; beyond that, the most energetic one is cut until there are
/// `count`. Both parts stand where their region stood, top or left first. Negative pixels count as dark when
/// energy is balanced, and as they are in the lights' irradiance.
///
/// # Errors
/// `NotFinite` for the first such pixel; what `check` gives.
pub fn median_cut<E: From<MedianCutError> + Send>(
    map: &EnvMap,
    settings: &Settings,
    check: impl Fn() -> Result<(), E> + Sync,
) -> Result<LightSet, E> {
    let weights = Weights::of(map, settings);
    let cutter = Cutter::new(map, &weights, &check)?;
    let regions = cutter.regions(settings.count, &check)?;

    let lights: Vec<Result<Light, E>> = regions.into_par_iter().map(|region| cutter.light(region, settings.place, &check)).collect();
    let lights = lights.into_iter().collect::<Result<Vec<_>, E>>()?;
    Ok(LightSet { map_width: map.width() as u32, map_height: map.height() as u32, lights })
}

/// The energy of a pixel: an intensity times a factor of its row.
struct Weights {
    variant: Variant,
    of_rows: Vec<f64>,
}

impl Weights {
    fn of(map: &EnvMap, settings: &Settings) -> Self {
        let of_row = |y| match settings.variant {
            Variant::Debevec => map.solid_angle(y),
            Variant::Coursework2021 => elementary::sin(theta_of_row(y, map.height(), settings.sine_at)),
        };
        Self { variant: settings.variant, of_rows: (0..map.height()).map(of_row).collect() }
    }

    /// Energy of a pixel of row `y`; never negative, and NaN or infinite only if the pixel is.
    fn energy(&self, y: usize, pixel: [f32; 3]) -> f64 {
        let intensity = match self.variant {
            Variant::Debevec => luminance(pixel),
            Variant::Coursework2021 => intensity(pixel.map(f64::from)),
        };
        // Not `max`, which would turn NaN into 0.
        if intensity < 0.0 { 0.0 } else { intensity * self.of_rows[y] }
    }
}

/// The side along which a region is cut.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Axis {
    Columns,
    Rows,
}

/// Regions whose energies differ by less than this share of them are equal.
const TIE: f64 = 1e-12;

/// Differences of the table err by a few roundings of its total: 2^-53 each, of up to six additions.
const TABLE_ERROR: f64 = 1e-15;

/// A map with all that cutting it needs.
struct Cutter<'a> {
    map: &'a EnvMap,
    weights: &'a Weights,
    energies: SummedArea,
    total: f64,
}

impl<'a> Cutter<'a> {
    fn new<E: From<MedianCutError> + Send>(
        map: &'a EnvMap,
        weights: &'a Weights,
        check: &(impl Fn() -> Result<(), E> + Sync),
    ) -> Result<Self, E> {
        let fill = |y: usize, energies: &mut [f64]| {
            for (x, (energy, pixel)) in energies.iter_mut().zip(map.raster.row(y)).enumerate() {
                *energy = weights.energy(y, *pixel);
                // The weight of a row may be 0, so the pixel itself is asked as well.
                if !(energy.is_finite() && pixel.iter().all(|channel| channel.is_finite())) {
                    return Err(MedianCutError::NotFinite { x, y }.into());
                }
            }
            Ok(())
        };
        let energies = SummedArea::new(map.width(), map.height(), fill, check)?;
        let total = energies.sum(whole(map));
        Ok(Self { map, weights, energies, total })
    }

    /// The regions of a cut into `count`, in order.
    fn regions<E>(&self, count: NonZeroU32, check: &impl Fn() -> Result<(), E>) -> Result<Vec<Region>, E> {
        let mut regions = vec![whole(self.map)];
        for _ in 0..count.ilog2() {
            let before = regions.len();
            regions = self.cut_all(&regions, check)?;
            if regions.len() == before {
                return Ok(regions);
            }
        }
        if count.is_power_of_two() { Ok(regions) } else { self.cut_strongest(regions, count.get() as usize, check) }
    }

    fn cut_all<E>(&self, regions: &[Region], check: &impl Fn() -> Result<(), E>) -> Result<Vec<Region>, E> {
        let mut parts = Vec::with_capacity(2 * regions.len());
        for region in regions {
            check()?;
            match self.cut(*region) {
                Some(halves) => parts.extend(halves),
                None => parts.push(*region),
            }
        }
        Ok(parts)
    }

    /// Cuts the most energetic region, the first of equals, until there are `count` or none can be cut.
    fn cut_strongest<E>(&self, regions: Vec<Region>, count: usize, check: &impl Fn() -> Result<(), E>) -> Result<Vec<Region>, E> {
        let mut finished = Vec::new();
        let mut open: BinaryHeap<Candidate> =
            regions.into_iter().enumerate().map(|(index, region)| self.candidate(region, vec![index as u32])).collect();
        while finished.len() + open.len() < count {
            check()?;
            let Some(strongest) = open.pop() else { break };
            match self.cut(strongest.region) {
                Some(halves) => open.extend(halves.into_iter().zip(0..).map(|(region, half)| {
                    let place = strongest.place.0.iter().copied().chain([half]).collect();
                    self.candidate(region, place)
                })),
                None => finished.push(strongest),
            }
        }
        finished.extend(open);
        finished.sort_by(|a, b| b.place.cmp(&a.place));
        Ok(finished.into_iter().map(|candidate| candidate.region).collect())
    }

    fn candidate(&self, region: Region, place: Vec<u32>) -> Candidate {
        Candidate { energy: comparable(self.energy(region)), place: Reverse(place), region }
    }

    fn energy(&self, region: Region) -> f64 {
        let energy = self.energies.sum(region);
        if energy <= TABLE_ERROR * self.total { 0.0 } else { energy }
    }

    /// The two halves of a region; `None` for a single pixel.
    fn cut(&self, region: Region) -> Option<[Region; 2]> {
        let axis = self.longer_side(region)?;
        let at = self.balance(region, axis)?;
        Some(match axis {
            Axis::Columns => [Region { x1: at, ..region }, Region { x0: at, ..region }],
            Axis::Rows => [Region { y1: at, ..region }, Region { y0: at, ..region }],
        })
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
        match self.weights.variant {
            Variant::Coursework2021 => height > width,
            Variant::Debevec => {
                let theta = f64::from(region.y0 + region.y1) / 2.0 * PI / self.map.height() as f64;
                let angle_down = height * PI / self.map.height() as f64;
                let angle_across = width * 2.0 * PI / self.map.width() as f64 * elementary::sin(theta);
                angle_down > angle_across
            }
        }
    }

    /// The cut along `axis` at which the two parts differ least in energy, the smallest of equals.
    ///
    /// Both parts have at least one pixel; the middle (rounded down) where there is no energy, and `None`
    /// where the side is one pixel long.
    fn balance(&self, region: Region, axis: Axis) -> Option<u32> {
        let (first, end) = match axis {
            Axis::Columns => (region.x0, region.x1),
            Axis::Rows => (region.y0, region.y1),
        };
        if end - first < 2 {
            return None;
        }
        let energy = self.energy(region);
        if energy == 0.0 {
            return Some(first + (end - first) / 2);
        }

        let imbalance = |at| {
            let before = match axis {
                Axis::Columns => Region { x1: at, ..region },
                Axis::Rows => Region { y1: at, ..region },
            };
            (2.0 * self.energies.sum(before) - energy).abs()
        };
        let least = (first + 1..end).map(imbalance).fold(f64::INFINITY, f64::min);
        (first + 1..end).find(|at| imbalance(*at) <= least + TIE * energy)
    }

    fn light<E>(&self, region: Region, place: Place, check: &impl Fn() -> Result<(), E>) -> Result<Light, E> {
        let moments = self.moments(region, place, check)?;
        let (position, direction) = self.place(region, place, &moments);
        Ok(Light {
            region,
            x: position[0],
            y: position[1],
            direction,
            irradiance: moments.irradiance,
            solid_angle: moments.solid_angle,
            energy: self.energy(region),
        })
    }

    /// Position in pixels and unit direction of a region's light; the middle where it has no energy.
    fn place(&self, region: Region, place: Place, moments: &Moments) -> ([f64; 2], DVec3) {
        let center = [f64::from(region.x0 + region.x1) / 2.0, f64::from(region.y0 + region.y1) / 2.0];
        let position = match place {
            Place::Center => center,
            Place::Centroid if moments.energy > 0.0 => moments.position.map(|moment| moment / moments.energy),
            Place::Median if self.energy(region) > 0.0 => {
                let at = |axis, middle| self.balance(region, axis).map_or(middle, f64::from);
                [at(Axis::Columns, center[0]), at(Axis::Rows, center[1])]
            }
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
        let directions = (place == Place::VectorMean).then(|| self.column_directions(region));
        let needs_position = place == Place::Centroid;
        let mut moments = Moments::default();
        for y in region.y0 as usize..region.y1 as usize {
            check()?;
            let row = &self.map.raster.row(y)[region.x0 as usize..region.x1 as usize];
            moments.add_radiance(row, self.map.solid_angle(y));
            if needs_position {
                moments.add_positions(row.iter().map(|pixel| self.weights.energy(y, *pixel)), region.x0, y);
            }
            if let Some(directions) = &directions {
                moments.add_directions(row.iter().map(|pixel| self.weights.energy(y, *pixel)), directions, self.map.theta(y));
            }
        }
        Ok(moments)
    }

    /// Cosine and sine of the azimuth of each column of a region.
    fn column_directions(&self, region: Region) -> Vec<[f64; 2]> {
        let of_column = |x| {
            let (sin, cos) = elementary::sin_cos(self.map.phi(x));
            [cos, sin]
        };
        (region.x0 as usize..region.x1 as usize).map(of_column).collect()
    }
}

fn whole(map: &EnvMap) -> Region {
    Region { x0: 0, y0: 0, x1: map.width() as u32, y1: map.height() as u32 }
}

/// A positive number with its last 12 bits rounded off: energies equal but for 1e-12 compare as equal.
fn comparable(energy: f64) -> u64 {
    (energy.to_bits() + (1 << 11)) >> 12
}

/// A region that may be cut; the greatest is the most energetic, of equals the first in the list.
#[derive(Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Candidate {
    energy: u64,
    /// Index among the regions before, then 0 or 1 for each half taken: sorts as the list would.
    place: Reverse<Vec<u32>>,
    region: Region,
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

    fn add_directions(&mut self, energies: impl Iterator<Item = f64>, columns: &[[f64; 2]], theta: f64) {
        let (mut energy_of_row, mut across) = (0.0, [0.0; 2]);
        for ([cos_phi, sin_phi], energy) in columns.iter().zip(energies) {
            energy_of_row += energy;
            across[0] += energy * cos_phi;
            across[1] += energy * sin_phi;
        }
        let (sin_theta, cos_theta) = elementary::sin_cos(theta);
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
        for variant in [Variant::Debevec, Variant::Coursework2021] {
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
        let weights = Weights::of(&map, &settings);
        let column = |x: usize| -> f64 { (0..17).map(|y| weights.energy(y, map.raster.pixel(x, y))).sum() };
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
        for variant in [Variant::Debevec, Variant::Coursework2021] {
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

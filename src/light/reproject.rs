//! Maps into other layouts and back, and turned: each pixel gets the mean over its own solid angle.
//!
//! The parts that two pixels share come from `overlap`, so that light is neither lost nor made: the sum of radiance times
//! solid angle is the same before and after, but for the straight edges there (`docs/rigs.md` has the bound). A map
//! counts as constant over each of its pixels, as everywhere.

use glam::DMat3;
use rayon::prelude::*;

use crate::image::raster::{Image, Plane, Raster};
use crate::light::envmap::EnvMap;
use crate::light::layout::Chart;
use crate::light::overlap::{Grid, Patch, Scratch};

/// A map that was made from a picture.
#[derive(Debug, Clone, PartialEq)]
pub struct Unwrapped {
    /// The map.
    pub map: EnvMap,
    /// How many of its pixels the picture does not show, not even in part; they continue their neighbors.
    pub hidden_count: usize,
}

/// The picture of a map in another layout; alpha is 0 where a pixel stands for no direction.
pub fn wrap<E: Send>(map: &EnvMap, chart: &Chart, check: impl Fn() -> Result<(), E> + Sync) -> Result<Image, E> {
    let color = gathered(map, chart, check)?;
    let values: Vec<f32> =
        (0..chart.height()).flat_map(|y| (0..chart.width()).map(move |x| f32::from(u8::from(chart.is_covered(x, y))))).collect();
    let is_opaque = values.iter().all(|alpha| *alpha == 1.0);
    let alpha = (!is_opaque).then_some(Plane { width: chart.width(), height: chart.height(), values });
    Ok(Image { alpha, ..Image::opaque(color) })
}

/// The map turned as a rigid sphere: what was at direction d is then at `turn` d.
pub fn turned<E: Send>(map: &EnvMap, turn: DMat3, check: impl Fn() -> Result<(), E> + Sync) -> Result<EnvMap, E> {
    let chart = Chart::turned_map([map.width(), map.height()], turn);
    Ok(EnvMap { raster: gathered(map, &chart, check)?, angles: map.angles })
}

/// The mean of the map over each pixel of a chart.
fn gathered<E: Send>(map: &EnvMap, chart: &Chart, check: impl Fn() -> Result<(), E> + Sync) -> Result<Raster, E> {
    let grid = Grid::new(map.width(), map.height());
    let mut pixels = vec![[0.0_f32; 3]; chart.width() * chart.height()];
    pixels.par_chunks_mut(chart.width()).enumerate().try_for_each_init(Scratch::default, |scratch, (y, row)| {
        for (x, pixel) in row.iter_mut().enumerate().filter(|(x, _)| chart.is_covered(*x, y)) {
            if x % PIXELS_PER_CHECK == 0 {
                check()?;
            }
            let (mut sum, mut area) = ([0.0; 3], 0.0);
            shares(chart, &grid, (x, y), scratch, |column, row, share| {
                let radiance = map.raster.pixel(column, row);
                (0..3).for_each(|channel| sum[channel] += share * f64::from(radiance[channel]));
                area += share;
            });
            *pixel = sum.map(|light| if area > 0.0 { (light / area) as f32 } else { 0.0 });
        }
        Ok(())
    })?;
    Ok(Raster::new(chart.width(), chart.height(), pixels))
}

/// How often a long row asks whether to stop.
const PIXELS_PER_CHECK: usize = 256;

/// Calls `found` with the pixels of a map under a pixel of a chart.
fn shares(chart: &Chart, grid: &Grid, (x, y): (usize, usize), scratch: &mut Scratch, mut found: impl FnMut(usize, usize, f64)) {
    let parts = chart.parts_per_side();
    // Division of whole numbers: parts that meet have the same corner to the last bit.
    let edge = |pixel: usize, part: usize| (pixel * parts + part) as f64 / parts as f64;
    for row in 0..parts {
        for column in 0..parts {
            let patch = Patch {
                from: [edge(x, column), edge(y, row)],
                to: [edge(x, column + 1), edge(y, row + 1)],
                direction: |point| chart.direction((x, y), point),
            };
            grid.overlap(&patch, scratch, &mut found);
        }
    }
}

/// The map that a picture shows. Pixels of alpha 0 show nothing.
///
/// At the rim of a disk a pixel that is partly inside has the color of the next one towards the center. What the
/// picture does not show at all continues its surroundings. `None` if it shows nothing.
pub fn unwrap<E: Send>(
    picture: &Image,
    chart: &Chart,
    [width, height]: [usize; 2],
    check: impl Fn() -> Result<(), E> + Sync,
) -> Result<Option<Unwrapped>, E> {
    let grid = Grid::new(width, height);
    let light = scattered(picture, chart, &grid, &check)?;
    let mut pixels: Vec<Option<[f32; 3]>> = light
        .chunks(width)
        .enumerate()
        .flat_map(|(y, row)| {
            let least = LEAST_SHARE * grid.solid_angle(y);
            row.iter().map(move |sum| (sum.area > least).then(|| sum.light.map(|light| (light / sum.area) as f32)))
        })
        .collect();
    let hidden_count = pixels.iter().filter(|pixel| pixel.is_none()).count();
    if hidden_count == pixels.len() {
        return Ok(None);
    }
    while pixels.iter().any(Option::is_none) {
        check()?;
        pixels = grown(&pixels, width, height);
    }
    let pixels = pixels.into_iter().map(|pixel| pixel.expect("the last round left none")).collect();
    Ok(Some(Unwrapped { map: EnvMap::new(Raster::new(width, height, pixels)), hidden_count }))
}

/// Part of a pixel that must be shown for it to count: less may be rounding.
const LEAST_SHARE: f64 = 1e-9;

/// Radiance times solid angle that fell on a pixel, and the solid angle.
#[derive(Debug, Clone, Copy, Default)]
struct Received {
    light: [f64; 3],
    area: f64,
}

/// Gives the light of every pixel of a picture to the pixels of the map below it.
///
/// Rows of the picture are computed at once and added in their order, so that sums do not depend on threads.
fn scattered<E: Send>(
    picture: &Image,
    chart: &Chart,
    grid: &Grid,
    check: &(impl Fn() -> Result<(), E> + Sync),
) -> Result<Vec<Received>, E> {
    // Shares that wait to be added, 32 bytes each: a large map under a small picture has many a row.
    const SHARES_AT_ONCE: usize = 1 << 20;
    let shares_per_row = grid.width() * grid.height() / chart.height() + 4 * chart.width();
    let rows_at_once = (SHARES_AT_ONCE / shares_per_row).clamp(1, 64);
    let mut received = vec![Received::default(); grid.width() * grid.height()];
    for first in (0..chart.height()).step_by(rows_at_once) {
        let rows = first..(first + rows_at_once).min(chart.height());
        let given: Result<Vec<_>, E> =
            rows.into_par_iter().map_init(Scratch::default, |scratch, y| row_given(picture, chart, grid, y, scratch, check)).collect();
        for (index, share, light) in given?.into_iter().flatten() {
            let sum = &mut received[index];
            (0..3).for_each(|channel| sum.light[channel] += share * f64::from(light[channel]));
            sum.area += share;
        }
    }
    Ok(received)
}

/// Index of the pixel of the map, common solid angle, radiance.
type Given = (usize, f64, [f32; 3]);

fn row_given<E>(
    picture: &Image,
    chart: &Chart,
    grid: &Grid,
    y: usize,
    scratch: &mut Scratch,
    check: &impl Fn() -> Result<(), E>,
) -> Result<Vec<Given>, E> {
    let mut given = Vec::new();
    for x in (0..chart.width()).filter(|x| chart.is_touched(*x, y)) {
        if x % PIXELS_PER_CHECK == 0 {
            check()?;
        }
        let Some((column, row)) = chart.inner(x, y).filter(|(x, y)| picture.is_covered(y * chart.width() + x)) else { continue };
        let light = picture.color.pixel(column, row);
        shares(chart, grid, (x, y), scratch, |x, y, share| given.push((y * grid.width() + x, share, light)));
    }
    Ok(given)
}

/// Each missing pixel beside one that is there becomes the mean of those; columns go round.
fn grown(pixels: &[Option<[f32; 3]>], width: usize, height: usize) -> Vec<Option<[f32; 3]>> {
    let neighbors = |x: usize, y: usize| {
        let beside = [((x + 1) % width, y), ((x + width - 1) % width, y)];
        let across = ((x + width / 2) % width, y);
        let above = if y > 0 { (x, y - 1) } else { across };
        let below = if y + 1 < height { (x, y + 1) } else { across };
        [beside[0], beside[1], above, below]
    };
    let mean = |index: usize| {
        let there: Vec<[f32; 3]> = neighbors(index % width, index / width).into_iter().filter_map(|(x, y)| pixels[y * width + x]).collect();
        let count = there.len() as f32;
        (!there.is_empty()).then(|| [0, 1, 2].map(|channel| there.iter().map(|pixel| pixel[channel]).sum::<f32>() / count))
    };
    pixels.par_iter().enumerate().map(|(index, pixel)| pixel.or_else(|| mean(index))).collect()
}

#[cfg(test)]
mod tests {
    use std::convert::Infallible;
    use std::f64::consts::PI;

    use glam::DVec3;

    use super::*;
    use crate::image::filter;
    use crate::light::layout::{Disk, Layout};
    use crate::math::elementary;
    use crate::math::stream::{Purpose, Stream};

    const ALL: [Layout; 5] = [Layout::CubeCross, Layout::CubeStrip, Layout::Octahedral, Layout::Angular, Layout::MirrorBall];

    fn on() -> Result<(), Infallible> {
        Ok(())
    }

    fn chart(layout: Layout, side: usize) -> Chart {
        Chart::new(layout, layout.size(side), &Disk::inscribed(side)).unwrap()
    }

    fn map_of(width: usize, radiance: impl Fn(DVec3) -> [f64; 3]) -> EnvMap {
        let (height, mut map) = (width / 2, EnvMap::new(Raster::filled(width, width / 2, [0.0; 3])));
        for y in 0..height {
            for x in 0..width {
                let color = radiance(map.direction(x, y)).map(|value| value as f32);
                map.raster.set_pixel(x, y, color);
            }
        }
        map
    }

    /// A different number in every pixel, over five decades.
    fn noise(width: usize, height: usize) -> EnvMap {
        let mut generator = Stream::new(3, Purpose::Test).generator(0);
        let mut next = || elementary::exp2(16.0 * (generator.uniform() - 0.5)) as f32;
        EnvMap::new(Raster::new(width, height, (0..width * height).map(|_| [next(), next(), next()]).collect()))
    }

    fn total(map: &EnvMap) -> [f64; 3] {
        let mut total = [0.0; 3];
        for y in 0..map.height() {
            for x in 0..map.width() {
                (0..3).for_each(|channel| total[channel] += map.solid_angle(y) * f64::from(map.raster.pixel(x, y)[channel]));
            }
        }
        total
    }

    /// Solid angle of each pixel of a chart and, of each pixel of the map, the part that is covered.
    fn areas(chart: &Chart, width: usize, height: usize) -> (Vec<f64>, Vec<f64>) {
        let (grid, mut scratch) = (Grid::new(width, height), Scratch::default());
        let (mut of_chart, mut of_map) = (vec![0.0; chart.width() * chart.height()], vec![0.0; width * height]);
        for y in 0..chart.height() {
            for x in (0..chart.width()).filter(|x| chart.is_touched(*x, y)) {
                shares(chart, &grid, (x, y), &mut scratch, |column, row, share| {
                    of_chart[y * chart.width() + x] += share;
                    of_map[row * width + column] += share / grid.solid_angle(row);
                });
            }
        }
        (of_chart, of_map)
    }

    #[test]
    fn every_layout_covers_every_pixel_of_a_map_once() {
        for layout in ALL {
            for (side, [width, height]) in [(1, [8, 4]), (2, [3, 5]), (5, [16, 8]), (16, [9, 6]), (24, [64, 32])] {
                let (_, covered) = areas(&chart(layout, side), width, height);
                for (index, part) in covered.into_iter().enumerate() {
                    let (x, y) = (index % width, index / width);
                    assert!((part - 1.0).abs() < 1e-9, "{} {side}, ({x}, {y}) of {width} x {height}: {part}", layout.name());
                }
            }
        }
    }

    #[test]
    fn a_turned_map_covers_every_pixel_once() {
        for turn in [DMat3::IDENTITY, DMat3::from_rotation_x(PI / 2.0), DMat3::from_axis_angle(DVec3::new(0.6, 0.0, 0.8), 1.0)] {
            for [width, height] in [[1, 1], [3, 5], [16, 8], [40, 20]] {
                let (_, covered) = areas(&Chart::turned_map([width, height], turn), width, height);
                assert!(covered.iter().all(|part| (part - 1.0).abs() < 1e-9), "{width} x {height}: {covered:?}");
            }
        }
    }

    #[test]
    fn pixels_of_faces_and_squares_have_their_solid_angles() {
        let (side, width) = (16, 128);
        let (octahedral, _) = areas(&chart(Layout::Octahedral, side), width, width / 2);
        for area in octahedral {
            assert!((area * (side * side) as f64 / (4.0 * PI) - 1.0).abs() < 2e-4, "{area}");
        }
        // From the corner of a face: atan(x y / sqrt(x² + y² + 1)) for the rectangle from its middle to (x, y).
        let corner = |x: f64, y: f64| elementary::atan2(x * y, (x * x + y * y + 1.0).sqrt());
        let edge = |k: usize| 2.0 * k as f64 / side as f64 - 1.0;
        let (strip, _) = areas(&chart(Layout::CubeStrip, side), width, width / 2);
        for y in 0..side {
            for x in 0..6 * side {
                let [x0, x1, y0, y1] = [edge(x % side), edge(x % side + 1), edge(y), edge(y + 1)];
                let expected = corner(x1, y1) - corner(x0, y1) - corner(x1, y0) + corner(x0, y0);
                let found = strip[y * 6 * side + x];
                assert!((found / expected - 1.0).abs() < 2e-4, "({x}, {y}): {found} for {expected}");
            }
        }
    }

    #[test]
    fn a_constant_map_stays_constant_in_every_layout_and_back() {
        let map = EnvMap::new(Raster::filled(32, 16, [0.3, 1.0, 7.0]));
        for layout in ALL {
            let chart = chart(layout, 20);
            let picture = wrap(&map, &chart, on).unwrap();
            for (index, pixel) in picture.color.pixels().iter().enumerate() {
                assert_eq!(*pixel, if picture.is_covered(index) { [0.3, 1.0, 7.0] } else { [0.0; 3] }, "{} {index}", layout.name());
            }
            let back = unwrap(&picture, &chart, [32, 16], on).unwrap().unwrap();
            assert_eq!((back.hidden_count, &back.map), (0, &map), "{}", layout.name());
        }
    }

    #[test]
    fn no_light_is_lost_or_made_on_the_way_there_and_back() {
        let map = noise(48, 24);
        let before = total(&map);
        for layout in [Layout::CubeCross, Layout::CubeStrip, Layout::Octahedral] {
            for side in [7, 32] {
                let chart = chart(layout, side);
                let picture = wrap(&map, &chart, on).unwrap();
                let back = unwrap(&picture, &chart, [48, 24], on).unwrap().unwrap().map;
                for (before, after) in before.into_iter().zip(total(&back)) {
                    // Rounding to single precision, twice.
                    assert!((after / before - 1.0).abs() < 1e-7, "{} {side}: {after} for {before}", layout.name());
                }
            }
        }
        let turned = turned(&map, DMat3::from_axis_angle(DVec3::new(0.0, 0.6, 0.8), 2.0), on).unwrap();
        for (before, after) in before.into_iter().zip(total(&turned)) {
            // Here also the bound of the straight edges.
            assert!((after / before - 1.0).abs() < 1e-5, "{after} for {before}");
        }
    }

    /// Harmonics of degrees 0, 1 and 2, so smooth that pixels may be compared with points.
    fn smooth(d: DVec3) -> [f64; 3] {
        [1.0 + 0.5 * d.x - 0.3 * d.y, 2.0 + d.z * d.x - d.y, 1.5 + d.y * d.y - 0.4 * d.x * d.z]
    }

    #[test]
    fn a_smooth_map_is_found_at_its_directions_in_every_layout() {
        let map = map_of(256, smooth);
        for layout in ALL {
            let chart = chart(layout, 64);
            let picture = wrap(&map, &chart, on).unwrap();
            for y in 0..chart.height() {
                for x in (0..chart.width()).filter(|x| chart.is_covered(*x, y)) {
                    // Towards the rim of a ball pixels are large.
                    let from_middle = elementary::hypot(x as f64 - 31.5, y as f64 - 31.5) / 32.0;
                    if layout.is_disk() && from_middle > 0.9 {
                        continue;
                    }
                    let direction = chart.direction((x, y), [x as f64 + 0.5, y as f64 + 0.5]);
                    for (found, expected) in picture.color.pixel(x, y).into_iter().zip(smooth(direction)) {
                        assert!((f64::from(found) - expected).abs() < 0.01, "{} ({x}, {y}): {found} for {expected}", layout.name());
                    }
                }
            }
        }
    }

    #[test]
    fn a_smooth_map_comes_back_from_every_layout() {
        let map = map_of(64, smooth);
        for layout in ALL {
            let chart = chart(layout, 128);
            let back = unwrap(&wrap(&map, &chart, on).unwrap(), &chart, [64, 32], on).unwrap().unwrap().map;
            let mut worst = [0.0_f64; 2];
            for y in 0..32 {
                for x in 0..64 {
                    // The last pixels of the ball's rim show the whole of its back.
                    let is_behind = layout == Layout::MirrorBall && map.direction(x, y).z < -0.97;
                    for (found, expected) in back.raster.pixel(x, y).into_iter().zip(map.raster.pixel(x, y)) {
                        let worst = &mut worst[usize::from(is_behind)];
                        *worst = worst.max(f64::from((found - expected).abs()));
                    }
                }
            }
            assert!(worst[0] < 0.03 && worst[1] < 0.3, "{}: {worst:?}", layout.name());
        }
    }

    #[test]
    fn the_mirror_ball_is_that_of_the_sphere_view() {
        let map = map_of(512, smooth);
        let picture = wrap(&map, &chart(Layout::MirrorBall, 63), on).unwrap();
        let view = crate::light::relight::views::mirror(&map, crate::light::relight::views::Lookup::Bilinear, 63, on).unwrap();
        assert_eq!(picture.alpha, view.alpha);
        for (index, (found, expected)) in picture.color.pixels().iter().zip(view.color.pixels()).enumerate() {
            let from_middle = elementary::hypot((index % 63) as f64 - 31.0, (index / 63) as f64 - 31.0) / 31.5;
            if from_middle < 0.9 {
                assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 0.02), "{index}: {found:?} for {expected:?}");
            }
        }
    }

    #[test]
    fn a_turn_moves_what_was_at_d_to_r_d() {
        let map = map_of(128, smooth);
        let turn = DMat3::from_axis_angle(DVec3::new(1.0, 2.0, -2.0) / 3.0, 2.5);
        let turned = turned(&map, turn, on).unwrap();
        let mut squares = 0.0;
        for y in 0..64 {
            for x in 0..128 {
                let expected = smooth(turn.transpose() * map.direction(x, y));
                for (found, expected) in turned.raster.pixel(x, y).into_iter().zip(expected) {
                    let error = f64::from(found) - expected;
                    squares += error * error * map.solid_angle(y) / (3.0 * 4.0 * PI);
                    // The narrow pixels at the poles may lie within one pixel of the old map, whose middle is at most half its
                    // diagonal away: 0.035 times the slope of the map, 1.5.
                    assert!(error.abs() < 0.053, "({x}, {y}): {found} for {expected}");
                }
            }
        }
        assert!(squares.sqrt() < 5e-3, "{}", squares.sqrt());
    }

    #[test]
    fn a_turn_about_the_axis_is_a_shift_of_columns() {
        let map = noise(24, 12);
        for degrees in [15.0, 90.0, -7.0, 22.5] {
            let turned = turned(&map, DMat3::from_rotation_y(f64::to_radians(degrees)), on).unwrap();
            let shifted = filter::shift_columns(&map.raster, -degrees / 360.0 * 24.0, on).unwrap();
            for (found, expected) in turned.raster.pixels().iter().zip(shifted.pixels()) {
                for (found, expected) in found.iter().zip(expected) {
                    // Neighbors are up to 2^16 apart, and their shares right to rounding in double.
                    assert!((found - expected).abs() < 1e-5 * expected.max(1e-3), "{degrees}: {found} for {expected}");
                }
            }
        }
    }

    #[test]
    fn a_lone_pixel_keeps_its_light_wherever_it_lies() {
        let chart = chart(Layout::Octahedral, 32);
        for (x, y) in [(0, 0), (5, 0), (15, 7), (0, 3), (8, 4)] {
            let mut map = EnvMap::new(Raster::filled(16, 8, [0.0; 3]));
            map.raster.set_pixel(x, y, [1e5, 0.0, 1.0]);
            let picture = wrap(&map, &chart, on).unwrap();
            let light: f64 = picture.color.pixels().iter().map(|pixel| f64::from(pixel[0])).sum::<f64>() * 4.0 * PI / 1024.0;
            let expected = 1e5 * map.solid_angle(y);
            assert!((light / expected - 1.0).abs() < 1e-4, "({x}, {y}): {light} for {expected}");
        }
    }

    #[test]
    fn what_a_picture_does_not_show_continues_its_surroundings() {
        let chart = chart(Layout::CubeStrip, 8);
        let mut picture = Image::opaque(Raster::filled(48, 8, [2.0; 3]));
        // The face -y is masked, as a tripod would be.
        let values = (0..48 * 8).map(|index| if index % 48 / 8 == 3 { 0.0 } else { 1.0 }).collect();
        picture.alpha = Some(Plane { width: 48, height: 8, values });
        let found = unwrap(&picture, &chart, [32, 16], on).unwrap().unwrap();
        assert!((40..140).contains(&found.hidden_count), "{}", found.hidden_count);
        assert!(found.map.raster.pixels().iter().all(|pixel| *pixel == [2.0; 3]));
        picture.alpha.as_mut().unwrap().values.fill(0.0);
        assert_eq!(unwrap(&picture, &chart, [32, 16], on).unwrap(), None);
    }

    #[test]
    fn an_interruption_is_passed_on() {
        let map = noise(16, 8);
        let chart = chart(Layout::Octahedral, 16);
        assert_eq!(wrap(&map, &chart, || Err("stop")), Err("stop"));
        assert_eq!(unwrap(&Image::opaque(Raster::filled(16, 16, [1.0; 3])), &chart, [16, 8], || Err("stop")), Err("stop"));
    }
}

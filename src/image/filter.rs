//! Resampling: exact areas for images and for lat-long maps, bilinear, and turns by parts of a pixel.
//!
//! All of it is separable: each target row is a weighted sum of source rows, each target pixel a weighted
//! sum of that row. Sums are in f64 and in a fixed order. With `Rows::SolidAngle` a map keeps its integral
//! over the sphere, because a source row counts by the solid angle that it shares with the target row.
//!
//! The light of a pixel is taken to fill it evenly; after Debevec, "A median cut algorithm" (2005), section 2.

use std::f64::consts::PI;

use rayon::prelude::*;

use crate::image::raster::Raster;
use crate::math::elementary;

/// How rows are weighted when a raster gets another height.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Rows {
    /// By the part of the height they share: plain images.
    Area,
    /// By the solid angle they share: lat-long maps, whose top row is at a pole.
    SolidAngle,
}

/// A raster of `width` x `height` in which every pixel is the mean of what it covers.
///
/// Enlarging repeats pixels. `check` is asked for each row and ends the work by its error.
pub fn resize_exactly<E: Send>(
    raster: &Raster,
    [width, height]: [usize; 2],
    rows: Rows,
    check: impl Fn() -> Result<(), E> + Sync,
) -> Result<Raster, E> {
    let rows = match rows {
        Rows::Area => Weights::of_overlap(raster.height(), height, |at| at),
        // The cosine of the polar angle falls evenly with solid angle.
        Rows::SolidAngle => Weights::of_overlap(raster.height(), height, |at| sine_of_half_square(at * PI)),
    };
    resampled(raster, &Weights::of_overlap(raster.width(), width, |at| at), &rows, check)
}

/// A raster of `width` x `height` that interpolates linearly between pixel centers; edges are repeated.
///
/// Right for enlarging; shrinking skips pixels. `check` is asked for each row and ends the work by its error.
pub fn resize_bilinear<E: Send>(
    raster: &Raster,
    [width, height]: [usize; 2],
    check: impl Fn() -> Result<(), E> + Sync,
) -> Result<Raster, E> {
    resampled(raster, &Weights::between_centers(raster.width(), width), &Weights::between_centers(raster.height(), height), check)
}

/// A raster whose content has moved to the right by `shift` pixels (any number, parts too), around the edge.
///
/// A pixel that falls between two is shared by them in the exact proportion, so that each row keeps its sum.
pub fn shift_columns<E: Send>(raster: &Raster, shift: f64, check: impl Fn() -> Result<(), E> + Sync) -> Result<Raster, E> {
    let width = raster.width();
    let shift = shift.rem_euclid(width as f64);
    let (whole, part) = (shift.floor(), shift - shift.floor());
    let mut pixels = vec![[0.0; 3]; raster.pixels().len()];
    pixels.par_chunks_mut(width).enumerate().try_for_each(|(y, out)| {
        check()?;
        let row = raster.row(y);
        for (x, pixel) in out.iter_mut().enumerate() {
            // Source column x - whole; what moved on by `part` comes from the one before it.
            let here = (x + 2 * width - whole as usize) % width;
            let before = (here + width - 1) % width;
            *pixel = if part == 0.0 { row[here] } else { mixed(row[here], row[before], part) };
        }
        Ok(())
    })?;
    Ok(Raster::new(width, raster.height(), pixels))
}

/// The mirror image, left to right.
pub fn flip_horizontally(raster: &mut Raster) {
    let width = raster.width().max(1);
    raster.pixels_mut().par_chunks_mut(width).for_each(<[[f32; 3]]>::reverse);
}

/// The mirror image, top to bottom.
pub fn flip_vertically(raster: &mut Raster) {
    let (width, height) = (raster.width(), raster.height());
    let (top, bottom) = raster.pixels_mut().split_at_mut(width * (height / 2));
    let bottom = &mut bottom[width * (height % 2)..];
    top.chunks_mut(width.max(1)).zip(bottom.chunks_mut(width.max(1)).rev()).for_each(|(a, b)| a.swap_with_slice(b));
}

/// For each target index along one axis: the first source index and the weights from there on, which sum to one.
struct Weights(Vec<(usize, Vec<f64>)>);

impl Weights {
    /// Weights by shared length, after `measure` has mapped [0, 1] to itself monotonically.
    fn of_overlap(source: usize, target: usize, measure: impl Fn(f64) -> f64) -> Self {
        let edges: Vec<f64> = (0..=source).map(|index| measure(index as f64 / source as f64)).collect();
        Self((0..target).map(|index| overlaps(index, source, target, &edges, &measure)).collect())
    }

    /// Weights of the two source centers around each target center.
    fn between_centers(source: usize, target: usize) -> Self {
        let weights = |index: usize| {
            let at = ((index as f64 + 0.5) * source as f64 / target as f64 - 0.5).clamp(0.0, (source - 1) as f64);
            let (first, part) = (at.floor(), at - at.floor());
            (first as usize, if part == 0.0 { vec![1.0] } else { vec![1.0 - part, part] })
        };
        Self((0..target).map(weights).collect())
    }
}

fn overlaps(index: usize, source: usize, target: usize, edges: &[f64], measure: &impl Fn(f64) -> f64) -> (usize, Vec<f64>) {
    // Whole numbers decide which source pixels are met, so that edges which coincide share nothing.
    let first = index * source / target;
    let last = ((index + 1) * source).div_ceil(target);
    let (low, high) = (measure(index as f64 / target as f64), measure((index + 1) as f64 / target as f64));
    let shared: Vec<f64> = (first..last).map(|at| (edges[at + 1].min(high) - edges[at].max(low)).max(0.0)).collect();
    let total: f64 = shared.iter().sum();
    (first, shared.into_iter().map(|part| part / total).collect())
}

fn resampled<E: Send>(raster: &Raster, columns: &Weights, rows: &Weights, check: impl Fn() -> Result<(), E> + Sync) -> Result<Raster, E> {
    let (width, height) = (columns.0.len(), rows.0.len());
    let mut pixels = vec![[0.0; 3]; width * height];
    pixels.par_chunks_mut(width).zip(&rows.0).try_for_each(|(out, (first, weights))| {
        check()?;
        let mut sums = vec![[0.0f64; 3]; raster.width()];
        for (offset, weight) in weights.iter().enumerate() {
            for (sum, pixel) in sums.iter_mut().zip(raster.row(first + offset)) {
                add(sum, weight, pixel.map(f64::from));
            }
        }
        for (pixel, (first, weights)) in out.iter_mut().zip(&columns.0) {
            let mut sum = [0.0; 3];
            weights.iter().zip(&sums[*first..]).for_each(|(weight, value)| add(&mut sum, weight, *value));
            *pixel = sum.map(|value| value as f32);
        }
        Ok(())
    })?;
    Ok(Raster::new(width, height, pixels))
}

fn add(sum: &mut [f64; 3], weight: &f64, value: [f64; 3]) {
    for channel in 0..3 {
        sum[channel] += weight * value[channel];
    }
}

fn mixed(here: [f32; 3], before: [f32; 3], part: f64) -> [f32; 3] {
    [0, 1, 2].map(|channel| ((1.0 - part) * f64::from(here[channel]) + part * f64::from(before[channel])) as f32)
}

/// (1 - cos theta) / 2, the part of the sphere above theta, written without cancellation.
fn sine_of_half_square(theta: f64) -> f64 {
    let sine = elementary::sin(theta / 2.0);
    sine * sine
}

#[cfg(test)]
mod tests {
    use std::convert::Infallible;

    use super::*;

    fn sample(width: usize, height: usize) -> Raster {
        let value = |index: usize, channel: usize| ((index * 31 + channel * 17) % 23) as f32;
        Raster::new(width, height, (0..width * height).map(|index| [0, 1, 2].map(|channel| value(index, channel))).collect())
    }

    fn never() -> Result<(), Infallible> {
        Ok(())
    }

    /// Integral over the sphere by the closed form of each row's solid angle.
    fn over_sphere(raster: &Raster) -> [f64; 3] {
        let edge = |y: usize| elementary::cos(y as f64 * PI / raster.height() as f64);
        let mut total = [0.0; 3];
        for y in 0..raster.height() {
            let solid_angle = 2.0 * PI / raster.width() as f64 * (edge(y) - edge(y + 1));
            raster.row(y).iter().for_each(|pixel| add(&mut total, &solid_angle, pixel.map(f64::from)));
        }
        total
    }

    #[test]
    fn a_map_keeps_its_integral_at_every_size() {
        let map = sample(48, 24);
        for size in [[24, 12], [7, 5], [1, 1], [96, 48], [100, 31]] {
            let resized = resize_exactly(&map, size, Rows::SolidAngle, never).unwrap();
            for (a, b) in over_sphere(&resized).iter().zip(over_sphere(&map)) {
                // One rounding to f32 in each pixel.
                assert!((a - b).abs() < 1e-7 * b, "{size:?}: {a} {b}");
            }
        }
    }

    #[test]
    fn halving_an_image_gives_means_of_four() {
        let image = sample(6, 4);
        let half = resize_exactly(&image, [3, 2], Rows::Area, never).unwrap();
        for (x, y) in [(0, 0), (2, 0), (1, 1)] {
            let four = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(dx, dy)| image.pixel(2 * x + dx, 2 * y + dy)[0]);
            assert_eq!(half.pixel(x, y)[0], four.iter().sum::<f32>() / 4.0);
        }
    }

    #[test]
    fn the_same_size_changes_nothing() {
        let image = sample(5, 3);
        assert_eq!(resize_exactly(&image, [5, 3], Rows::SolidAngle, never).unwrap(), image);
        assert_eq!(resize_bilinear(&image, [5, 3], never).unwrap(), image);
        assert_eq!(shift_columns(&image, 0.0, never).unwrap(), image);
        assert_eq!(shift_columns(&image, -5.0, never).unwrap(), image);
    }

    #[test]
    fn bilinear_enlargement_continues_a_ramp() {
        let ramp = Raster::new(4, 1, (0..4).map(|x| [x as f32; 3]).collect());
        let larger = resize_bilinear(&ramp, [8, 2], never).unwrap();
        let found: Vec<f32> = larger.row(1).iter().map(|pixel| pixel[0]).collect();
        assert_eq!(found, [0.0, 0.25, 0.75, 1.25, 1.75, 2.25, 2.75, 3.0]);
    }

    #[test]
    fn a_shift_moves_to_the_right_and_around() {
        let row = Raster::new(4, 1, [8.0, 0.0, 0.0, 4.0].map(|value| [value; 3]).to_vec());
        let reds = |raster: Raster| raster.row(0).iter().map(|pixel| pixel[0]).collect::<Vec<_>>();
        assert_eq!(reds(shift_columns(&row, 1.0, never).unwrap()), [4.0, 8.0, 0.0, 0.0]);
        assert_eq!(reds(shift_columns(&row, 0.25, never).unwrap()), [7.0, 2.0, 0.0, 3.0]);
        assert_eq!(reds(shift_columns(&row, -0.75, never).unwrap()), [2.0, 0.0, 3.0, 7.0]);
    }

    #[test]
    fn flips_are_their_own_inverse() {
        for (width, height) in [(4, 3), (5, 4), (1, 1)] {
            let original = sample(width, height);
            let mut flipped = original.clone();
            flip_horizontally(&mut flipped);
            assert_eq!(flipped.pixel(width - 1, height / 2), original.pixel(0, height / 2));
            flip_vertically(&mut flipped);
            assert_eq!(flipped.pixel(0, height - 1), original.pixel(width - 1, 0));
            flip_horizontally(&mut flipped);
            flip_vertically(&mut flipped);
            assert_eq!(flipped, original);
        }
    }

    #[test]
    fn an_interruption_ends_the_work() {
        assert_eq!(resize_exactly(&sample(8, 8), [4, 4], Rows::Area, || Err("stop")).unwrap_err(), "stop");
    }
}

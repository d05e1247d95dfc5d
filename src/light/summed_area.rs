//! Sums over rectangles of a grid in constant time.
//!
//! Sums are in f64, so the sum over a region is right to about 1e-16 of the sum over everything: compare
//! with a tolerance, not with zero. Knows nothing of what is summed; see `median_cut`.
//!
//! After Crow, "Summed-area tables for texture mapping" (1984), with the table cut into bands of rows so
//! that it is built in one parallel pass, always in the same order.

use rayon::prelude::*;

use crate::light::lights::Region;

/// Rows summed by one task; part of the result's last bits, so never taken from the thread count.
const BAND: usize = 64;

/// Sums over all rectangles that touch the upper left corner.
pub struct SummedArea {
    width: usize,
    /// Entry (x, y) is the sum over columns 0..=x of the rows of its band up to y.
    within_bands: Vec<f64>,
    /// Entry (x, band) is the sum over columns 0..=x of all rows above the band.
    above_bands: Vec<f64>,
}

impl SummedArea {
    /// Sums a grid whose rows `fill` writes: `fill(y, row)` sets the values of row `y`.
    ///
    /// # Errors
    /// The first error of `fill` by row; what `check` gives, which is asked once a row.
    pub fn new<E: Send>(
        width: usize,
        height: usize,
        fill: impl Fn(usize, &mut [f64]) -> Result<(), E> + Sync,
        check: &(impl Fn() -> Result<(), E> + Sync),
    ) -> Result<Self, E> {
        let mut within_bands = vec![0.0; width * height];
        let outcomes: Vec<Result<(), E>> = within_bands
            .par_chunks_mut((BAND * width).max(1))
            .enumerate()
            .map(|(band, rows)| sum_band(width, rows, |y, row| check().and_then(|()| fill(band * BAND + y, row))))
            .collect();
        outcomes.into_iter().collect::<Result<(), E>>()?;

        let above_bands = sums_above(width, height, &within_bands);
        Ok(Self { width, within_bands, above_bands })
    }

    /// The sum over `region`.
    pub fn sum(&self, region: Region) -> f64 {
        let Region { x0, y0, x1, y1 } = region;
        (self.corner(x1, y1) - self.corner(x0, y1)) - (self.corner(x1, y0) - self.corner(x0, y0))
    }

    /// The sum over columns below `x` and rows below `y`.
    fn corner(&self, x: u32, y: u32) -> f64 {
        if x == 0 || y == 0 {
            return 0.0;
        }
        let (column, row) = (x as usize - 1, y as usize - 1);
        self.above_bands[row / BAND * self.width + column] + self.within_bands[row * self.width + column]
    }
}

/// Fills the rows of one band one after the other and turns them into sums from its upper left corner.
fn sum_band<E>(width: usize, rows: &mut [f64], fill: impl Fn(usize, &mut [f64]) -> Result<(), E>) -> Result<(), E> {
    for y in 0..rows.len() / width {
        let (before, rest) = rows.split_at_mut(y * width);
        let row = &mut rest[..width];
        fill(y, row)?;

        let mut along_row = 0.0;
        match before.rchunks_exact(width).next() {
            None => row.iter_mut().for_each(|value| {
                along_row += *value;
                *value = along_row;
            }),
            Some(above) => row.iter_mut().zip(above).for_each(|(value, above)| {
                along_row += *value;
                *value = along_row + above;
            }),
        }
    }
    Ok(())
}

/// The sums of the rows above each band, one row per band.
fn sums_above(width: usize, height: usize, within_bands: &[f64]) -> Vec<f64> {
    let mut above = vec![0.0; width * height.div_ceil(BAND)];
    for band in 1..height.div_ceil(BAND) {
        let last_row = &within_bands[(band * BAND - 1) * width..band * BAND * width];
        let (before, rest) = above.split_at_mut(band * width);
        let before = &before[(band - 1) * width..];
        for ((sum, before), last) in rest.iter_mut().zip(before).zip(last_row) {
            *sum = before + last;
        }
    }
    above
}

#[cfg(test)]
mod tests {
    use std::convert::Infallible;

    use super::*;

    #[test]
    fn a_region_sums_to_its_cells_across_bands() {
        let (width, height) = (7, 3 * BAND + 5);
        let value = |x: usize, y: usize| ((x * 31 + y * 17) % 101) as f64;
        let fill = |y: usize, row: &mut [f64]| {
            row.iter_mut().enumerate().for_each(|(x, cell)| *cell = value(x, y));
            Ok::<(), Infallible>(())
        };
        let table = SummedArea::new(width, height, fill, &|| Ok(())).unwrap();

        for (y0, y1) in [(0, height), (1, 2), (BAND - 1, BAND + 1), (BAND, 2 * BAND), (60, height - 1)] {
            for (x0, x1) in [(0, width), (2, 3), (3, 3)] {
                // Small integers: both ways of summing are exact.
                let expected: f64 = (y0..y1).flat_map(|y| (x0..x1).map(move |x| value(x, y))).sum();
                let region = Region { x0: x0 as u32, y0: y0 as u32, x1: x1 as u32, y1: y1 as u32 };
                assert_eq!(table.sum(region), expected, "{region:?}");
            }
        }
    }

    #[test]
    fn the_first_row_at_fault_is_named() {
        let fill = |y: usize, _: &mut [f64]| if y % 100 == 99 { Err(y) } else { Ok(()) };
        assert_eq!(SummedArea::new(2, 1000, fill, &|| Ok(())).err(), Some(99));
    }
}

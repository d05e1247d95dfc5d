//! Inversion by the nearest value of the CDF, as the second report's code does it, and what it really draws.
//!
//! Taking the index whose cumulative probability is nearest to u, in place of the first that exceeds it, gives
//! index j the probability (p_j + p_{j+1}) / 2 (the first p_0 + p_1 / 2, the last p_last / 2): a shift by half a
//! pixel and a blur, and pixels that weigh nothing can be drawn. An estimate that divides by the intended
//! probability is biased; one that divides by the realized one is not, where that covers all that shines.

use crate::light::distribution::{Distribution, Pixel};

/// Draws a pixel: `u[1]` chooses the row, `u[0]` the column in it; reports the realized probability.
///
/// In a row without any weight, which this look-up can reach, columns are equally likely.
pub fn sample(distribution: &Distribution, u: [f64; 2]) -> Pixel {
    let row_above = distribution.row_at(u[1]);
    let row_cdf = |y: usize| distribution.marginal_cdf(y);
    let y = nearer(row_above, u[1], row_cdf);
    let column_above = match distribution.row_sum(y) > 0.0 {
        true => distribution.column_at(y, u[0]),
        false => ((u[0] * distribution.width() as f64) as usize).min(distribution.width() - 1),
    };
    let x = nearer(column_above, u[0], |x| column_cdf(distribution, x, y));
    Pixel { x: x as u32, y: y as u32, pmf: pmf(distribution, x, y) }
}

/// The probability with which [`sample`] draws the pixel in column `x` of row `y`.
pub fn pmf(distribution: &Distribution, x: usize, y: usize) -> f64 {
    let row = realized(y, distribution.height(), |y| distribution.marginal_pmf(y));
    let column = |x: usize| match distribution.row_sum(y) > 0.0 {
        true => f64::from(distribution.intensities()[y * distribution.width() + x]) / distribution.row_sum(y),
        false => 1.0 / distribution.width() as f64,
    };
    row * realized(x, distribution.width(), column)
}

/// Of the first index beyond `u` and the one before it, that whose cumulative probability is nearer; the later on ties.
fn nearer(above: usize, u: f64, cdf: impl Fn(usize) -> f64) -> usize {
    if above > 0 && u - cdf(above - 1) < cdf(above) - u { above - 1 } else { above }
}

/// Cumulative probability of the columns of row `y` up to and with `x`, given the row.
fn column_cdf(distribution: &Distribution, x: usize, y: usize) -> f64 {
    match distribution.row_sum(y) > 0.0 {
        true => distribution.conditional_before(x + 1, y),
        false => (x + 1) as f64 / distribution.width() as f64,
    }
}

/// Probability of index `j` of `count` under the look-up, from the intended ones.
fn realized(j: usize, count: usize, intended: impl Fn(usize) -> f64) -> f64 {
    let own = if j == 0 { intended(0) } else { intended(j) / 2.0 };
    if j + 1 < count { own + intended(j + 1) / 2.0 } else { own }
}

#[cfg(test)]
mod tests {
    use std::convert::Infallible;

    use super::*;
    use crate::light::distribution::{Intensity, Settings, Sine};
    use crate::light::envmap::EnvMap;
    use crate::light::test_maps::{constant, grace, noisy};

    fn build(map: &EnvMap, sine: Sine) -> Distribution {
        let settings = Settings { sine, intensity: Intensity::Mean, ..Settings::default() };
        Distribution::build(map, &settings, || Ok::<(), Infallible>(())).unwrap()
    }

    /// A map with black pixels and rows.
    fn holey(width: usize, height: usize) -> EnvMap {
        let mut map = noisy(width, height);
        for k in 0..width * height {
            if k % 5 < 2 || (k / width) % 4 == 1 {
                map.raster.set_pixel(k % width, k / width, [0.0; 3]);
            }
        }
        map
    }

    #[test]
    fn realized_probabilities_sum_to_one() {
        for (width, height) in [(24, 12), (7, 5), (1, 1), (1, 6), (6, 1)] {
            for sine in [Sine::Center, Sine::Edge] {
                let table = build(&holey(width, height), sine);
                let sum: f64 = (0..width * height).map(|k| pmf(&table, k % width, k / width)).sum();
                assert!((sum - 1.0).abs() < 1e-12, "{width}x{height}: {sum}");
            }
        }
    }

    /// The definition itself: the index at the least distance, by trying all of them.
    #[test]
    fn the_nearest_value_of_the_cdf_is_taken() {
        let table = build(&holey(24, 12), Sine::Center);
        let least = |values: Vec<f64>, u: f64| values.iter().map(|value| (value - u).abs()).fold(f64::INFINITY, f64::min);
        for k in 0..2000 {
            let u = [(f64::from(k) * 0.618_034).fract(), (f64::from(k) * 0.754_877_7).fract()];
            let pixel = sample(&table, u);
            let (x, y) = (pixel.x as usize, pixel.y as usize);
            let rows: Vec<f64> = (0..12).map(|y| table.marginal_cdf(y)).collect();
            assert!((rows[y] - u[1]).abs() <= least(rows.clone(), u[1]) + 1e-14);
            if table.row_weight(y) > 0.0 {
                let columns: Vec<f64> = table.conditional_cdf(y).collect();
                assert!((columns[x] - u[0]).abs() <= least(columns.clone(), u[0]) + 1e-14);
            }
            assert_eq!(pixel.pmf, pmf(&table, x, y));
            assert!(pixel.pmf > 0.0);
        }
    }

    #[test]
    fn shares_of_the_square_are_the_realized_probabilities() {
        let table = build(&holey(6, 5), Sine::Center);
        let side = 500;
        let mut counts = [0_u32; 30];
        for k in 0..side * side {
            let pixel = sample(&table, [(k % side) as f64 + 0.5, (k / side) as f64 + 0.5].map(|place| place / side as f64));
            counts[(pixel.y * 6 + pixel.x) as usize] += 1;
        }
        for (k, count) in counts.into_iter().enumerate() {
            let share = f64::from(count) / (side * side) as f64;
            assert!((share - pmf(&table, k % 6, k / 6)).abs() < 2.0 / side as f64, "{k}: {share}");
        }
    }

    #[test]
    fn grace_is_as_far_from_the_intention_as_published() {
        let Some(map) = grace() else { return };
        let table = build(&map, Sine::Center);
        let distance: f64 =
            (0..1024 * 512).map(|k| (pmf(&table, k % 1024, k / 1024) - table.pmf(k % 1024, k / 1024)).abs()).sum::<f64>() / 2.0;
        assert!((distance - 0.0468).abs() < 5.1e-5, "{distance}");
    }

    #[test]
    fn an_even_map_gives_the_first_column_half_as_much_again() {
        let table = build(&constant(4, 1, [1.0; 3]), Sine::None);
        assert_eq!([0, 1, 2, 3].map(|x| pmf(&table, x, 0)), [0.375, 0.25, 0.25, 0.125]);
    }
}

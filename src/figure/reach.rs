//! Where a measured curve comes below a level for good.
//!
//! Between two measurements the curve is taken for a power law, a straight line in logarithms, as errors over
//! counts are. Knows nothing of what is measured.

use crate::math::elementary;

/// Where a curve has come below a level.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reach {
    /// The x between two measurements at which a power law through both crosses the level.
    pub interpolated: f64,
    /// The first x measured from which on all measurements are at or below the level.
    pub measured: f64,
}

/// Where the curve through points (x, y), sorted by x, comes to `level` and stays at or below it; `None` if its last point is above.
pub fn reach(points: &[(f64, f64)], level: f64) -> Option<Reach> {
    let last_above = points.iter().rposition(|&(_, y)| y.is_nan() || y > level);
    let first = last_above.map_or(0, |above| above + 1);
    let &(measured, y) = points.get(first)?;
    let interpolated = match last_above.map(|above| points[above]) {
        Some((x_above, y_above)) if x_above > 0.0 && y > 0.0 && y_above.is_finite() && level > 0.0 => {
            let share = elementary::ln(y_above / level) / elementary::ln(y_above / y);
            x_above * elementary::pow(measured / x_above, share)
        }
        _ => measured,
    };
    Some(Reach { interpolated, measured })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_power_law_is_found_where_it_crosses() {
        let points: Vec<(f64, f64)> = [1.0, 4.0, 16.0, 64.0, 256.0].map(|x: f64| (x, 0.5 / x.sqrt())).to_vec();
        let found = reach(&points, 0.1).unwrap();
        assert!((found.interpolated - 25.0).abs() < 1e-9 && found.measured == 64.0, "{found:?}");
        assert_eq!(reach(&points, 0.5).unwrap(), Reach { interpolated: 1.0, measured: 1.0 });
        assert_eq!(reach(&points, 0.01), None);
    }

    #[test]
    fn a_curve_must_stay_below_the_level() {
        let points = [(1.0, 0.05), (2.0, 0.2), (4.0, 0.1), (8.0, 0.05)];
        assert_eq!(reach(&points, 0.1).unwrap().measured, 4.0);
        assert_eq!(reach(&[(1.0, 0.05), (2.0, f64::NAN)], 0.1), None);
        assert_eq!(reach(&[], 0.1), None);
    }

    #[test]
    fn an_error_of_zero_is_reached_where_it_was_measured() {
        assert_eq!(reach(&[(1.0, 0.5), (3.0, 0.0)], 0.1).unwrap(), Reach { interpolated: 3.0, measured: 3.0 });
    }
}

//! Small dense systems of linear equations.

/// Solves A x = b for a symmetric, positive definite A given by rows; `None` if it is not (to rounding).
///
/// A = L D Lᵀ without square roots (Golub & Van Loan, "Matrix Computations", 4th edition, section 4.1.2), O(n³ / 6). Only the
/// lower half of A is read.
///
/// # Panics
/// If `matrix` is not a square of the length of `right`.
pub fn solve_symmetric(mut matrix: Vec<f64>, mut right: Vec<f64>) -> Option<Vec<f64>> {
    let n = right.len();
    assert_eq!(matrix.len(), n * n, "the system is a square");
    let largest = (0..n).map(|k| matrix[k * n + k]).fold(0.0, f64::max);
    for j in 0..n {
        let (before, rest) = matrix.split_at_mut(j * n);
        let row_j = &mut rest[..n];
        // Row j of L was kept times D; its quotients with D give L itself and the pivot.
        let mut pivot = row_j[j];
        for k in 0..j {
            let scaled = row_j[k];
            let factor = scaled / before[k * n + k];
            pivot -= scaled * factor;
            row_j[k] = factor;
        }
        // A pivot lost in rounding is none.
        if pivot.is_nan() || pivot <= largest * f64::EPSILON {
            return None;
        }
        row_j[j] = pivot;
        let row_j = row_j.to_vec();
        for row_i in rest[n..].chunks_exact_mut(n) {
            let dot: f64 = (0..j).map(|k| row_i[k] * row_j[k]).sum();
            row_i[j] -= dot;
        }
    }
    for i in 0..n {
        let dot: f64 = (0..i).map(|k| matrix[i * n + k] * right[k]).sum();
        right[i] -= dot;
    }
    for i in (0..n).rev() {
        let dot: f64 = (i + 1..n).map(|k| matrix[k * n + i] * right[k]).sum();
        right[i] = right[i] / matrix[i * n + i] - dot;
    }
    Some(right)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::stream::{Purpose, Stream};

    #[test]
    fn the_answer_fulfils_the_equations() {
        let mut generator = Stream::new(1, Purpose::Test).generator(0);
        for n in [1, 2, 7, 40] {
            // Bᵀ B + 1 is positive definite for any B.
            let b: Vec<f64> = (0..n * n).map(|_| generator.uniform() - 0.5).collect();
            let element = |i: usize, j: usize| (0..n).map(|k| b[k * n + i] * b[k * n + j]).sum::<f64>() + f64::from(u8::from(i == j));
            let matrix: Vec<f64> = (0..n * n).map(|at| element(at / n, at % n)).collect();
            let expected: Vec<f64> = (0..n).map(|_| generator.uniform()).collect();
            let right = (0..n).map(|i| (0..n).map(|j| matrix[i * n + j] * expected[j]).sum()).collect();
            let found = solve_symmetric(matrix, right).unwrap();
            assert!(found.iter().zip(&expected).all(|(a, b)| (a - b).abs() < 1e-12), "{n}: {found:?} for {expected:?}");
        }
    }

    #[test]
    fn the_published_example_is_met() {
        // The 3 x 3 of 4, 12, -16; 12, 37, -43; -16, -43, 98 has L D Lᵀ with D = 4, 1, 9; the right side is that of (1, 2, 3).
        let matrix = vec![4.0, 12.0, -16.0, 12.0, 37.0, -43.0, -16.0, -43.0, 98.0];
        let found = solve_symmetric(matrix, vec![-20.0, -43.0, 192.0]).unwrap();
        assert!(found.iter().zip([1.0, 2.0, 3.0]).all(|(a, b)| (a - b).abs() < 1e-12), "{found:?}");
    }

    #[test]
    fn what_is_not_positive_definite_has_no_answer() {
        assert_eq!(solve_symmetric(vec![1.0, 1.0, 1.0, 1.0], vec![1.0, 1.0]), None);
        assert_eq!(solve_symmetric(vec![-1.0], vec![1.0]), None);
        assert_eq!(solve_symmetric(vec![f64::NAN], vec![1.0]), None);
    }
}

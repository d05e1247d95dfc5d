//! Sums over windows of a plane, by doubling: the cost grows with the logarithm of the window's length.
//!
//! A sum of 2n neighbors is the sum of two sums of n, and any length is put together of powers of two. Nothing is ever
//! subtracted, so large values beside a window do not leave their rounding in it, as they would in running sums.

use std::num::NonZeroUsize;

/// Buffers for sums over windows, reused from call to call.
#[derive(Debug, Default)]
pub struct WindowSums {
    /// Sums of 2^k neighbors each.
    powers: Vec<Vec<f32>>,
}

impl WindowSums {
    /// `values[i]` becomes the sum of `values[i + k * stride]` for k below `length`, for every i where all exist.
    ///
    /// The last `(length - 1) * stride` values are left without meaning. With a stride of one the windows run along the
    /// rows of a plane (and over the ends of rows into the next ones, where their sums mean nothing either), with its
    /// width as the stride down its columns.
    pub fn slide(&mut self, values: &mut Vec<f32>, length: NonZeroUsize, stride: usize) {
        let (length, top) = (length.get(), length.ilog2() as usize);
        self.powers.resize_with(self.powers.len().max(top + 1), Vec::new);
        self.powers.iter_mut().for_each(|power| power.resize(values.len(), 0.0));
        std::mem::swap(values, &mut self.powers[0]);
        for level in 1..=top {
            let (lower, upper) = self.powers.split_at_mut(level);
            add_ahead(&mut upper[0], &lower[level - 1], &lower[level - 1], (stride << level) / 2);
        }
        let mut covered = 1 << top;
        std::mem::swap(values, &mut self.powers[top]);
        for level in (0..top).rev().filter(|level| length >> level & 1 == 1) {
            add_to(values, &self.powers[level], covered * stride);
            covered += 1 << level;
        }
    }
}

/// out[i] = near[i] + far[i + shift].
fn add_ahead(out: &mut [f32], near: &[f32], far: &[f32], shift: usize) {
    let far = far.get(shift..).unwrap_or_default();
    for ((out, near), far) in out.iter_mut().zip(near).zip(far) {
        *out = near + far;
    }
}

/// out[i] += far[i + shift].
fn add_to(out: &mut [f32], far: &[f32], shift: usize) {
    for (out, far) in out.iter_mut().zip(far.get(shift..).unwrap_or_default()) {
        *out += far;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn windows_of_any_length_hold_the_sums_of_their_values() {
        let values: Vec<f32> = (0..200_u8).map(|i| f32::from(i.wrapping_mul(37) % 64)).collect();
        let mut sums = WindowSums::default();
        for stride in [1, 3, 17] {
            for length in 1..12 {
                let mut slid = values.clone();
                sums.slide(&mut slid, NonZeroUsize::new(length).unwrap(), stride);
                for i in 0..values.len() - (length - 1) * stride {
                    let expected: f32 = (0..length).map(|k| values[i + k * stride]).sum();
                    assert_eq!(slid[i], expected, "length {length}, stride {stride}, at {i}");
                }
            }
        }
    }

    #[test]
    fn a_large_neighbor_leaves_no_trace() {
        let mut values = vec![1.0_f32; 64];
        values[20] = 1e30;
        WindowSums::default().slide(&mut values, NonZeroUsize::new(7).unwrap(), 1);
        assert!(values[21..57].iter().all(|sum| *sum == 7.0));
    }
}

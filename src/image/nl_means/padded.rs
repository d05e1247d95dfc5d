//! The rasters of a filter as separate planes with a margin on every side, so that no loop asks for the edge.

use crate::image::raster::{Plane, Raster};

use super::{Border, FEATURE_FLOOR, FEATURE_K, Guide, Settings};

/// Planes with margins.
pub struct Padded {
    /// Pixels in a row of every plane.
    pub width: usize,
    /// Pixels of the margin on each side.
    pub margin: usize,
    /// The target's channels.
    pub target: [Vec<f32>; 3],
    /// The guide's channels.
    pub color: [Vec<f32>; 3],
    /// Their variances.
    pub variance: [Vec<f32>; 3],
    /// 1 for pixels that may be averaged, else 0.
    pub counts: Vec<f32>,
    /// Features, one channel after the other.
    pub features: Vec<Feature>,
}

/// One channel of a feature.
pub struct Feature {
    /// Its values.
    pub values: Vec<f32>,
    /// What the square of a difference from what is expected of this pixel's surroundings is multiplied with.
    pub scale: Vec<f32>,
    /// Change from pixel to pixel, across and down, by which the surroundings are expected to go on.
    pub slopes: [Vec<f32>; 2],
}

impl Padded {
    /// With a margin as wide as the filter reaches.
    pub fn new(target: &Raster, guide: Guide<'_>, settings: Settings) -> Self {
        let margin = settings.window_radius as usize + settings.reach();
        let frame = Frame { width: target.width(), height: target.height(), margin, border: settings.border };
        let channels = |raster: &Raster| std::array::from_fn(|c| frame.plane(|index| raster.pixels()[index][c]));
        let features = guide.features.iter().flat_map(|raster| (0..3).map(|c| frame.feature(raster, c))).collect();
        Self {
            width: frame.width + 2 * margin,
            margin,
            target: channels(target),
            color: channels(guide.color),
            variance: channels(guide.variance),
            counts: frame.counts(guide.coverage),
            features,
        }
    }
}

/// An image's size and what lies around it.
struct Frame {
    width: usize,
    height: usize,
    margin: usize,
    border: Border,
}

impl Frame {
    /// Each position with the index of the pixel that is seen there.
    fn plane(&self, value: impl Fn(usize) -> f32) -> Vec<f32> {
        let columns: Vec<usize> = (0..self.width + 2 * self.margin).map(|x| self.seen(x, self.width)).collect();
        let rows = (0..self.height + 2 * self.margin).map(|y| self.seen(y, self.height) * self.width);
        rows.flat_map(|row| columns.iter().map(move |column| row + column)).map(value).collect()
    }

    /// The pixel that stands at a position counted from the start of the margin.
    fn seen(&self, position: usize, length: usize) -> usize {
        match self.border {
            Border::Clamp => position.saturating_sub(self.margin).min(length - 1),
            Border::Wrap => (position + length * self.margin.div_ceil(length) - self.margin) % length,
        }
    }

    fn counts(&self, coverage: Option<&Plane>) -> Vec<f32> {
        let mut counts = self.plane(|index| coverage.map_or(1.0, |plane| if plane.values[index] > 0.0 { 1.0 } else { 0.0 }));
        if self.border == Border::Clamp {
            let is_inside = |position: usize, length: usize| (self.margin..self.margin + length).contains(&position);
            for (y, row) in counts.chunks_exact_mut(self.width + 2 * self.margin).enumerate() {
                let is_row_inside = is_inside(y, self.height);
                let outside = row.iter_mut().enumerate().filter(|(x, _)| !is_row_inside || !is_inside(*x, self.width));
                outside.for_each(|(_, count)| *count = 0.0);
            }
        }
        counts
    }

    /// A channel of a feature, with differences measured against its own gradient.
    fn feature(&self, raster: &Raster, channel: usize) -> Feature {
        let value = |index: usize| raster.pixels()[index][channel];
        let across = |index: usize| Self::changes(index, index % self.width, self.width, 1, value);
        let down = |index: usize| Self::changes(index, index / self.width, self.height, self.width, value);
        let scale = |index: usize| {
            let [across, down] = [across(index), down(index)].map(|[before, behind]| 0.5 * (before + behind));
            1.0 / (FEATURE_K * FEATURE_K * (across * across + down * down).max(FEATURE_FLOOR))
        };
        let slopes = [self.plane(|index| lesser(across(index))), self.plane(|index| lesser(down(index)))];
        Feature { values: self.plane(value), scale: self.plane(scale), slopes }
    }

    /// The changes from the neighbor before and to the one behind, `step` indices away, of the pixel at that place of so many: at
    /// the edge of the image the other change twice.
    fn changes(index: usize, place: usize, length: usize, step: usize, value: impl Fn(usize) -> f32) -> [f32; 2] {
        let before = (place > 0).then(|| value(index) - value(index - step));
        let behind = (place + 1 < length).then(|| value(index + step) - value(index));
        [before.or(behind).unwrap_or(0.0), behind.or(before).unwrap_or(0.0)]
    }
}

/// Of two changes that agree in their direction the lesser, and else none: so a slope goes on, and an edge is none.
///
/// The limiter called minmod, after Roe, "Characteristic-based schemes for the Euler equations" (1986).
fn lesser([one, other]: [f32; 2]) -> f32 {
    match one * other {
        product if product > 0.0 => one.abs().min(other.abs()).copysign(one),
        _ => 0.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn margins_repeat_the_edge_or_the_image() {
        let frame = |border| Frame { width: 3, height: 1, margin: 4, border };
        let row = |border| frame(border).plane(|index| index as f32)[..11].to_vec();
        assert_eq!(row(Border::Clamp), [0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 2.0, 2.0, 2.0, 2.0, 2.0]);
        assert_eq!(row(Border::Wrap), [2.0, 0.0, 1.0, 2.0, 0.0, 1.0, 2.0, 0.0, 1.0, 2.0, 0.0]);
    }

    #[test]
    fn a_slope_goes_on_and_an_edge_has_none() {
        assert_eq!([[0.5, 0.25], [-1.0, -3.0], [0.0, 0.6], [0.5, -0.5]].map(lesser), [0.25, -1.0, 0.0, 0.0]);
    }

    #[test]
    fn only_pixels_of_the_image_count_unless_it_repeats() {
        let sum = |border| Frame { width: 3, height: 2, margin: 2, border }.counts(None).iter().sum::<f32>();
        assert_eq!((sum(Border::Clamp), sum(Border::Wrap)), (6.0, 42.0));
    }
}

//! Pictures on a surface: which texel stands where, between texels and beyond the edge.
//!
//! Entry "uv of shapes" of docs/conventions.md: u goes to the right and v up, so v = 0 is the bottom row. The center of
//! texel i of W lies at u = (i + 1/2) / W. There are no smaller copies for distant surfaces: the samples of a pixel do
//! the filtering. Interpolation acts on linear values.

use std::marker::PhantomData;
use std::sync::Arc;

use glam::{Vec2, Vec3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::image::display;
use crate::image::raster::{Picture, Raster};
use crate::render::texture::Texel;
use crate::render::texture::parameter::Origin;

/// The pixels of a file, before it is known what they mean.
#[derive(Debug, Clone, PartialEq)]
pub enum Pixels {
    /// Linear values: EXR, HDR, PFM, NPY.
    Linear(Raster),
    /// Values for a display: PNG, PPM.
    Display(Picture),
}

impl Pixels {
    /// As the values of a texture.
    pub fn decoded(self, decoding: Decoding) -> Raster {
        match (self, decoding) {
            (Self::Linear(raster), _) => raster,
            (Self::Display(picture), Decoding::Srgb) => display::decoded(&picture).color,
            (Self::Display(picture), Decoding::Data) => display::undecoded(&picture),
        }
    }
}

/// What the values of a display's picture mean.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Decoding {
    /// Light, encoded by the sRGB curve.
    Srgb,
    /// Numbers from 0 to 1 as they stand: normals, roughness, heights.
    Data,
}

/// What stands beyond the edge of a picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Wrap {
    /// The picture again.
    #[default]
    Repeat,
    /// Its outermost texels.
    Clamp,
    /// The picture mirrored, so that edges meet themselves.
    Mirror,
}

/// What stands between the centers of texels.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Interpolation {
    /// The mean of the four nearest, weighted by distance.
    #[default]
    Bilinear,
    /// The nearest.
    Nearest,
}

/// How a picture lies on a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Layout {
    /// Pictures per unit of u and v.
    pub scale: Vec2,
    /// Added to u and v after that, in pictures.
    pub offset: Vec2,
    /// Beyond the edge.
    pub wrap: Wrap,
    /// Between texels.
    pub filter: Interpolation,
}

/// A picture on a surface.
#[derive(Debug, Clone)]
pub struct Bitmap<T> {
    raster: Arc<Raster>,
    layout: Layout,
    factor: f32,
    least: f32,
    greatest: f32,
    value: PhantomData<fn() -> T>,
}

/// A texel that the parameter may not have.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error(
    "{origin}: the pixel in column {x} of row {y} gives `{value}`, which is not from {least} to {greatest}: set `clamp: true`, or a `factor`"
)]
pub struct TexelError {
    origin: Origin,
    x: usize,
    y: usize,
    value: f32,
    least: f32,
    greatest: f32,
}

impl<T> PartialEq for Bitmap<T> {
    /// Of one file, read once: pictures are not compared texel by texel.
    fn eq(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.raster, &other.raster)
            && (self.layout, self.factor, self.least, self.greatest) == (other.layout, other.factor, other.least, other.greatest)
    }
}

impl<T: Texel> Bitmap<T> {
    /// A picture whose values times `factor` are cut to that range.
    pub fn new(raster: Arc<Raster>, layout: Layout, factor: f32, [least, greatest]: [f32; 2]) -> Self {
        Self { raster, layout, factor, least, greatest, value: PhantomData }
    }

    /// The first texel outside the range, if there is one; `origin` is for the message.
    pub fn outside(&self, origin: &Origin) -> Option<TexelError> {
        let (least, greatest) = (self.least, self.greatest);
        let place = |index| (index % self.raster.width(), index / self.raster.width());
        self.raster.pixels().iter().enumerate().find_map(|(index, pixel)| {
            let value = (T::of_color(Vec3::from_array(*pixel)) * self.factor).outside(least, greatest)?;
            let (x, y) = place(index);
            Some(TexelError { origin: origin.clone(), x, y, value, least, greatest })
        })
    }

    /// The value at those coordinates.
    #[inline]
    pub fn at(&self, uv: Vec2) -> T {
        let place = self.place(uv);
        let value = match self.layout.filter {
            Interpolation::Nearest => {
                let [x, y] = place.map(|coordinate| whole((coordinate + 0.5).floor()));
                self.texel(x, y)
            }
            Interpolation::Bilinear => {
                let ([[a, b], [c, d]], [s, t]) = self.corners(place);
                a.mixed(b, s).mixed(c.mixed(d, s), t)
            }
        };
        value.clamped(self.least, self.greatest)
    }

    /// Change of the interpolated value with u and v, whatever the filter.
    pub fn slope(&self, uv: Vec2) -> [T; 2] {
        let ([[a, b], [c, d]], [s, t]) = self.corners(self.place(uv));
        let [per_u, per_v] = [self.raster.width() as f32 * self.layout.scale.x, self.raster.height() as f32 * self.layout.scale.y];
        let along_x = (b - a).mixed(d - c, t) * per_u;
        // Rows go down and v goes up.
        let along_y = (c - a).mixed(d - b, s) * -per_v;
        [along_x, along_y]
    }

    /// The mean of all texels.
    pub fn mean(&self) -> T {
        // Row by row, so that few digits are lost in single precision.
        let rows = 0..self.raster.height();
        let row_mean =
            |y: usize| self.raster.row(y).iter().map(|pixel| Vec3::from_array(*pixel)).sum::<Vec3>() / self.raster.width() as f32;
        let mean = rows.clone().map(row_mean).sum::<Vec3>() / rows.len() as f32;
        (T::of_color(mean) * self.factor).clamped(self.least, self.greatest)
    }

    /// Place among the texels: whole numbers are centers, x to the right and y down.
    #[inline]
    fn place(&self, uv: Vec2) -> [f32; 2] {
        let [u, v] = (uv * self.layout.scale + self.layout.offset).to_array();
        [u * self.raster.width() as f32 - 0.5, (1.0 - v) * self.raster.height() as f32 - 0.5]
    }

    /// The four texels around a place, row by row, and how far it is from the first towards the last.
    #[inline]
    fn corners(&self, place: [f32; 2]) -> ([[T; 2]; 2], [f32; 2]) {
        let corner = place.map(f32::floor);
        let [x, y] = corner.map(whole);
        let row = |y| [self.texel(x, y), self.texel(x.saturating_add(1), y)];
        ([row(y), row(y.saturating_add(1))], [place[0] - corner[0], place[1] - corner[1]])
    }

    #[inline]
    fn texel(&self, x: i32, y: i32) -> T {
        let x = self.layout.wrap.index(x, self.raster.width());
        let y = self.layout.wrap.index(y, self.raster.height());
        T::of_color(Vec3::from_array(self.raster.pixel(x, y))) * self.factor
    }
}

/// A float without a fraction as an index; what is too large, or no number, stays within the range of one.
#[inline]
fn whole(value: f32) -> i32 {
    value as i32
}

impl Wrap {
    /// The index within `count` that stands for any index.
    #[inline]
    fn index(self, index: i32, count: usize) -> usize {
        let (index, count) = (i64::from(index), count as i64);
        let within = match self {
            Self::Repeat => index.rem_euclid(count),
            Self::Clamp => index.clamp(0, count - 1),
            Self::Mirror => {
                let twice = index.rem_euclid(2 * count);
                twice.min(2 * count - 1 - twice)
            }
        };
        within as usize
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Upper row 0, 1; lower row 2, 4.
    fn four(wrap: Wrap, filter: Interpolation) -> Bitmap<f32> {
        let raster = Raster::new(2, 2, [0.0, 1.0, 2.0, 4.0].map(|value| [value; 3]).to_vec());
        let layout = Layout { scale: Vec2::ONE, offset: Vec2::ZERO, wrap, filter };
        Bitmap::new(Arc::new(raster), layout, 1.0, [0.0, 100.0])
    }

    fn assert_values(bitmap: &Bitmap<f32>, values: &[([f32; 2], f32)]) {
        for (uv, expected) in values {
            let found = bitmap.at(Vec2::from_array(*uv));
            assert!((found - expected).abs() < 1e-5, "{:?} at {uv:?}: {found} instead of {expected}", bitmap.layout);
        }
    }

    /// Weights by hand: u = 0.4 is 0.3 from the left centers to the right ones, v = 0.6 is 0.3 from the upper to the lower.
    #[test]
    fn four_texels_at_four_asymmetric_points() {
        let by_hand = |s: f32, t: f32| (1.0 - t) * s + t * (2.0 * (1.0 - s) + 4.0 * s);
        let points = [
            ([0.4, 0.6], by_hand(0.3, 0.3)),
            ([0.3, 0.35], by_hand(0.1, 0.8)),
            ([0.7, 0.7], by_hand(0.9, 0.1)),
            ([0.55, 0.4], by_hand(0.6, 0.7)),
        ];
        assert_values(&four(Wrap::Clamp, Interpolation::Bilinear), &points);
        let nearest = [([0.4, 0.6], 0.0), ([0.7, 0.7], 1.0), ([0.3, 0.35], 2.0), ([0.55, 0.4], 4.0)];
        assert_values(&four(Wrap::Clamp, Interpolation::Nearest), &nearest);
    }

    #[test]
    fn beyond_the_edge_the_picture_repeats_stays_or_turns_round() {
        let row = |wrap| [-0.75, -0.25, 0.25, 0.75, 1.25, 1.75, 2.25].map(|u| four(wrap, Interpolation::Nearest).at(Vec2::new(u, 0.25)));
        assert_eq!(row(Wrap::Repeat), [2.0, 4.0, 2.0, 4.0, 2.0, 4.0, 2.0]);
        assert_eq!(row(Wrap::Clamp), [2.0, 2.0, 2.0, 4.0, 4.0, 4.0, 4.0]);
        assert_eq!(row(Wrap::Mirror), [4.0, 2.0, 2.0, 4.0, 4.0, 2.0, 2.0]);
        // Half a texel beyond the edge the mean of the first and the last, if it repeats.
        assert_values(&four(Wrap::Repeat, Interpolation::Bilinear), &[([0.0, 0.25], 3.0), ([1.0, 0.75], 0.5), ([0.25, 1.0], 1.0)]);
        assert_values(&four(Wrap::Mirror, Interpolation::Bilinear), &[([0.0, 0.25], 2.0), ([1.0, 0.75], 1.0), ([0.25, 0.0], 2.0)]);
    }

    #[test]
    fn extreme_coordinates_give_some_texel() {
        for wrap in [Wrap::Repeat, Wrap::Clamp, Wrap::Mirror] {
            for filter in [Interpolation::Bilinear, Interpolation::Nearest] {
                for u in [f32::MAX, f32::MIN, 1e10, f32::INFINITY, f32::NAN] {
                    let value = four(wrap, filter).at(Vec2::new(u, 0.3));
                    assert!(value.is_nan() || (0.0..=4.0).contains(&value), "{wrap:?} {u}: {value}");
                }
            }
        }
    }

    #[test]
    fn slopes_are_differences_of_values() {
        let bitmap = four(Wrap::Clamp, Interpolation::Bilinear);
        let at = Vec2::new(0.4, 0.55);
        let step = 1e-2;
        let [u, v] = bitmap.slope(at);
        let difference = |offset: Vec2| (bitmap.at(at + offset) - bitmap.at(at - offset)) / (2.0 * step);
        assert!((u - difference(Vec2::new(step, 0.0))).abs() < 1e-3);
        assert!((v - difference(Vec2::new(0.0, step))).abs() < 1e-3);
    }

    #[test]
    fn texels_outside_the_range_are_told_by_their_place() {
        let file = Origin::Stage("a".into());
        let bitmap = Bitmap::<f32> { greatest: 3.0, ..four(Wrap::Clamp, Interpolation::Nearest) };
        let error = bitmap.outside(&file).unwrap();
        assert_eq!((error.x, error.y, error.value), (1, 1, 4.0));
        assert_eq!(bitmap.at(Vec2::new(0.9, 0.1)), 3.0);
        assert_eq!(four(Wrap::Clamp, Interpolation::Nearest).outside(&file), None);
        assert_eq!(bitmap.mean(), 1.75);
    }
}

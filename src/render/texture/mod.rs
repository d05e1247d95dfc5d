//! Values that vary over a surface: constants, pictures and patterns, of one number or of a color.
//!
//! A person writes a number, `[r, g, b]` or `{ PATTERN: {...} }` wherever a reflectance, a radiance or a roughness
//! is asked for (`parameter`); a scene holds the same without names or limits ([`Texture`]). Reading order: `value`,
//! `parameter`, then `bitmap` and the patterns. A new pattern is a file, a row in `Pattern` and a row in `Texture`.

pub mod bitmap;
pub mod checker;
pub mod noise;
pub mod parameter;
pub mod stripes;
pub mod value;

use std::ops::{Add, Mul, Sub};

use glam::{Vec2, Vec3};

use crate::image::color::luminance;
use crate::render::ray::Surface;
use crate::render::texture::bitmap::Bitmap;
use crate::render::texture::checker::Checker;
use crate::render::texture::noise::Noise;
use crate::render::texture::stripes::Stripes;

/// Where a texture is asked for its value.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TexturePoint {
    /// Coordinates on the surface.
    pub uv: Vec2,
    /// The point in the world, for textures that fill space.
    pub position: Vec3,
    /// Change of the position with u and v, in the world.
    pub world_tangents: [Vec3; 2],
    /// The same in the frame for shading, for textures that bend its normal.
    pub tangents: [Vec3; 2],
}

impl TexturePoint {
    /// The origin of everything, for what is the same everywhere.
    pub const ANYWHERE: Self =
        Self { uv: Vec2::ZERO, position: Vec3::ZERO, world_tangents: [Vec3::X, Vec3::Y], tangents: [Vec3::X, Vec3::Y] };

    /// A point of a surface, for values; slopes need [`Self::of`].
    #[inline]
    pub fn at(uv: [f32; 2], position: Vec3) -> Self {
        Self { uv: uv.into(), position, ..Self::ANYWHERE }
    }

    /// A point of a surface.
    #[inline]
    pub fn of(surface: &Surface) -> Self {
        let world_tangents = [surface.dp_du, surface.dp_dv];
        let tangents = world_tangents.map(|tangent| surface.frame.to_local(tangent));
        Self { uv: surface.uv.into(), position: surface.position, world_tangents, tangents }
    }
}

/// A texture of a scene: `T` is `f32` or the linear color `Vec3`.
#[derive(Debug, Clone, PartialEq)]
pub enum Texture<T> {
    /// The same everywhere.
    Constant(T),
    /// A picture.
    Bitmap(Bitmap<T>),
    /// Squares of two values.
    Checker(Checker<T>),
    /// Stripes of two values.
    Stripes(Stripes<T>),
    /// Noise between two values.
    Noise(Noise<T>),
    /// The coordinates themselves.
    Uv,
}

/// What a texture consists of.
pub trait Texel: Copy + Add<Output = Self> + Sub<Output = Self> + Mul<f32, Output = Self> {
    /// Of a color.
    fn of_color(color: Vec3) -> Self;
    /// Of coordinates.
    fn of_uv(uv: Vec2) -> Self;
    /// `self` + (`other` - `self`) `share`.
    #[inline]
    fn mixed(self, other: Self, share: f32) -> Self {
        self + (other - self) * share
    }
    /// Each number cut to that range.
    fn clamped(self, least: f32, greatest: f32) -> Self;
    /// A number that is not in that range, if there is one.
    fn outside(self, least: f32, greatest: f32) -> Option<f32>;
}

impl Texel for f32 {
    /// Rec. 709 luminance.
    #[inline]
    fn of_color(color: Vec3) -> Self {
        // A grey keeps its digits.
        if color.x == color.y && color.y == color.z { color.x } else { luminance(color.to_array()) as Self }
    }

    /// u alone.
    fn of_uv(uv: Vec2) -> Self {
        uv.x
    }

    #[inline]
    fn clamped(self, least: f32, greatest: f32) -> Self {
        self.max(least).min(greatest)
    }

    fn outside(self, least: f32, greatest: f32) -> Option<f32> {
        (!(least..=greatest).contains(&self)).then_some(self)
    }
}

impl Texel for Vec3 {
    #[inline]
    fn of_color(color: Vec3) -> Self {
        color
    }

    /// Red is u, green is v.
    fn of_uv(uv: Vec2) -> Self {
        uv.extend(0.0)
    }

    #[inline]
    fn clamped(self, least: f32, greatest: f32) -> Self {
        self.max(Self::splat(least)).min(Self::splat(greatest))
    }

    fn outside(self, least: f32, greatest: f32) -> Option<f32> {
        self.to_array().into_iter().find_map(|channel| channel.outside(least, greatest))
    }
}

impl<T: Texel> Texture<T> {
    /// The value there.
    #[inline]
    pub fn at(&self, point: &TexturePoint) -> T {
        match self {
            Self::Constant(value) => *value,
            other => other.varying(point),
        }
    }

    /// Kept apart, so that constants stay cheap wherever they are asked for.
    fn varying(&self, point: &TexturePoint) -> T {
        match self {
            Self::Constant(value) => *value,
            Self::Bitmap(bitmap) => bitmap.at(point.uv),
            Self::Checker(checker) => checker.at(point.uv),
            Self::Stripes(stripes) => stripes.at(point.uv),
            Self::Noise(noise) => noise.at(point),
            Self::Uv => T::of_uv(point.uv - point.uv.floor()),
        }
    }

    /// Change of the value with u and v. Edges of patterns have none: they are steps and not slopes.
    pub fn slope(&self, point: &TexturePoint) -> [T; 2] {
        match self {
            Self::Bitmap(bitmap) => bitmap.slope(point.uv),
            Self::Noise(noise) => noise.slope(point),
            Self::Uv => [T::of_uv(Vec2::X), T::of_uv(Vec2::Y)],
            Self::Constant(_) | Self::Checker(_) | Self::Stripes(_) => [T::of_uv(Vec2::ZERO); 2],
        }
    }

    /// The value, if it is the same everywhere.
    pub fn constant(&self) -> Option<T> {
        if let Self::Constant(value) = self { Some(*value) } else { None }
    }
}

impl Texture<Vec3> {
    /// About the mean over the unit square: of a picture the mean of its texels, else by points on a grid.
    pub fn mean(&self) -> Vec3 {
        const SIDE: u32 = 16;
        let at = |index: u32| {
            let [u, v] = [index % SIDE, index / SIDE].map(|step| (step as f32 + 0.5) / SIDE as f32);
            self.at(&TexturePoint::at([u, v], Vec3::ZERO))
        };
        match self {
            Self::Constant(value) => *value,
            Self::Bitmap(bitmap) => bitmap.mean(),
            _ => (0..SIDE * SIDE).map(at).sum::<Vec3>() / (SIDE * SIDE) as f32,
        }
    }
}

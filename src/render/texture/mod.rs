//! Values that vary over a surface: constants and patterns, of one number or of a color.
//!
//! A person writes a number, `[r, g, b]` or `{ PATTERN: {...} }` wherever a reflectance, a radiance or a roughness
//! is asked for (`parameter`); a scene holds the same without names or limits (`Texture`). Reading order: `value`,
//! `parameter`, then the patterns. A new pattern is a file, a row in `Pattern` and a row in `Texture`.

pub mod checker;
pub mod parameter;
pub mod value;

use glam::{Vec2, Vec3};

use crate::render::texture::checker::Checker;

/// Where a texture is asked for its value.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TexturePoint {
    /// Coordinates on the surface.
    pub uv: Vec2,
    /// The point in the world, for textures that fill space.
    pub position: Vec3,
}

/// A texture of a scene: `T` is `f32` or the linear color `Vec3`.
#[derive(Debug, Clone, PartialEq)]
pub enum Texture<T> {
    /// The same everywhere.
    Constant(T),
    /// Squares of two values.
    Checker(Checker<T>),
}

impl<T: Copy> Texture<T> {
    /// The value there.
    #[inline]
    pub fn at(&self, point: &TexturePoint) -> T {
        match self {
            Self::Constant(value) => *value,
            Self::Checker(checker) => checker.at(point.uv),
        }
    }

    /// The value, if it is the same everywhere.
    pub fn constant(&self) -> Option<T> {
        if let Self::Constant(value) = self { Some(*value) } else { None }
    }
}

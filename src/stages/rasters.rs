//! Ports that take several sorts of rasters: images and environment maps, and pictures beside them.

use std::sync::Arc;

use crate::engine::artifact::{AnyArtifact, Artifact, TypeName};
use crate::engine::parameter::Accepts;
use crate::image::raster::{Image, Picture};
use crate::light::envmap::EnvMap;

/// A linear raster: an image, or an environment map taken as an opaque image.
pub struct LinearRaster;

impl Accepts for LinearRaster {
    const TYPES: &'static [TypeName] = &[Image::TYPE, EnvMap::TYPE];
    type Value = Arc<Image>;

    fn take(artifact: AnyArtifact) -> Option<Arc<Image>> {
        artifact.get::<Image>().or_else(|| artifact.get::<EnvMap>().map(|map| Arc::new(Image::opaque(map.raster.clone()))))
    }
}

/// A linear raster or a picture.
pub enum LinearOrPicture {
    /// An image, or an environment map taken as an opaque image.
    Linear(Arc<Image>),
    /// A display-referred picture.
    Picture(Arc<Picture>),
}

impl Accepts for LinearOrPicture {
    const TYPES: &'static [TypeName] = &[Image::TYPE, EnvMap::TYPE, Picture::TYPE];
    type Value = Self;

    fn take(artifact: AnyArtifact) -> Option<Self> {
        artifact.get::<Picture>().map(Self::Picture).or_else(|| LinearRaster::take(artifact).map(Self::Linear))
    }
}

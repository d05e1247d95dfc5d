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

/// Runs single stages without a pipeline around them.
#[cfg(test)]
pub(crate) mod trial {
    use std::collections::BTreeMap;
    use std::path::Path;
    use std::sync::atomic::AtomicBool;

    use crate::engine::artifact::AnyArtifact;
    use crate::engine::job::{FileSource, Input, Job};
    use crate::engine::registry::Kind;
    use crate::engine::stage::{AnyStage, Stage, StageError};

    struct NoFiles;

    impl FileSource for NoFiles {
        fn read(&self, path: &Path) -> Result<Vec<u8>, StageError> {
            Err(StageError::content(format!("`{}` is not there", path.display())))
        }
    }

    /// The parameter block in this YAML text, or what serde says of it.
    pub fn parsed<T: Stage>(text: &str) -> Result<Box<dyn AnyStage>, String> {
        let parameters = serde_yaml::from_str(text).unwrap();
        Kind::of::<T>().parse(parameters).map_err(|error| format!("{}: {}", error.path, error.message))
    }

    /// Messages of the mistakes in a parameter block.
    pub fn mistakes<T: Stage>(text: &str) -> Vec<String> {
        parsed::<T>(text).unwrap().mistakes().into_iter().map(|mistake| format!("{}: {}", mistake.field, mistake.message)).collect()
    }

    /// Results and warnings of a stage with these artifacts on its ports, by reference; the pipeline's seed is 7.
    pub fn run<T: Stage>(
        text: &str,
        inputs: impl IntoIterator<Item = (&'static str, Vec<AnyArtifact>)>,
    ) -> (Result<Vec<AnyArtifact>, StageError>, Vec<String>) {
        let input = |artifact| Input { label: "input".into(), columns: Vec::new(), source: Box::new(artifact) };
        let inputs: BTreeMap<String, Vec<Input>> =
            inputs.into_iter().map(|(name, artifacts)| (name.to_string(), artifacts.into_iter().map(input).collect())).collect();
        let interrupted = AtomicBool::new(false);
        let job = Job::new(inputs, &NoFiles, 7, &interrupted);
        let result = parsed::<T>(text).unwrap().run(&job);
        (result, job.take_warnings())
    }
}

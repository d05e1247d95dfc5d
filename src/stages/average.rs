//! The kind `average`; the mathematics is in `image::average`.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::engine::artifact::Artifact;
use crate::engine::job::Job;
use crate::engine::parameter::Ports;
use crate::engine::stage::{InputSizes, ResultDeclaration, Stage, StageError};
use crate::image::average::{AverageError, RunningMean};
use crate::image::raster::Image;

/// Averages images over an axis and says how sure the mean is.
///
/// The result has the mean as its color and, of more than one image, two layers with a value for each channel:
/// `variance`, the sample variance among the images (divided by n - 1), and `standard_error` of the mean, the root of
/// variance / n, which `compare` uses for `mean-z`. Images must have one size and the same alpha. Layers such as albedo
/// or depth are averaged where all images have them.
///
/// ```yaml
/// mean: { average: { of: repeated, over: [run] }, save: exr } # over the runs of a seed
/// ```
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Average {
    /// The images: one reference or a list.
    pub of: Ports<Image>,
    /// The axes that are averaged over; by default all. The others remain axes of the stage.
    #[serde(default)]
    pub over: Option<Vec<String>>,
}

impl Stage for Average {
    const KIND: &'static str = "average";
    const VERSION: u32 = 1;
    const RESULTS: &'static [ResultDeclaration] = &[ResultDeclaration { name: "", types: &[Image::TYPE] }];
    type Output = Image;

    fn memory(&self, inputs: &InputSizes) -> u64 {
        // One image at a time (counted with the inputs), two numbers in f64 for each of its f32, and the result; the
        // size of one image is not known here, so that of all bounds it.
        4 * inputs.values().sum::<u64>()
    }

    fn run(&self, job: &Job<'_>) -> Result<Image, StageError> {
        let count = job.collected_count(&self.of);
        let mut mean: Option<RunningMean> = None;
        for (index, image) in job.collected(&self.of).enumerate() {
            job.check()?;
            let image = image?;
            match &mut mean {
                None => mean = Some(RunningMean::of(&image.value)),
                Some(mean) => mean.push(&image.value)?,
            }
            job.report_progress((index + 1) as f32 / count as f32);
        }
        mean.map(RunningMean::finish).ok_or_else(|| StageError::content("there is no image to average"))
    }
}

impl From<AverageError> for StageError {
    fn from(error: AverageError) -> Self {
        Self::content(error)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::artifact::AnyArtifact;
    use crate::image::raster::{Layer, Raster};
    use crate::stages::rasters::trial;

    fn image(width: usize, value: f32) -> AnyArtifact {
        AnyArtifact::new(Image::opaque(Raster::filled(width, 1, [value; 3])))
    }

    #[test]
    fn images_of_several_references_are_averaged_together() {
        let inputs = [("a", vec![image(2, 1.0), image(2, 2.0)]), ("b", vec![image(2, 6.0)])];
        let (results, _) = trial::run::<Average>("{ of: [a, b] }", inputs);
        let average = results.unwrap()[0].get::<Image>().unwrap();
        assert_eq!(average.color.pixel(0, 0), [3.0; 3]);
        assert_eq!(average.layers["variance"], Layer::Color(Raster::filled(2, 1, [7.0; 3])));
    }

    #[test]
    fn sizes_that_differ_are_told() {
        let (results, _) = trial::run::<Average>("{ of: [a] }", [("a", vec![image(2, 1.0), image(3, 1.0)])]);
        assert!(results.unwrap_err().to_string().starts_with("image 2 has 3 x 1 pixels"));
    }
}

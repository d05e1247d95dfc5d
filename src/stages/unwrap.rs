//! The kind `unwrap`; the mathematics is in `light::reproject`.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::engine::artifact::Artifact;
use crate::engine::job::Job;
use crate::engine::parameter::Port;
use crate::engine::stage::{InputSizes, Mistake, ResultDeclaration, Stage, StageError};
use crate::formats::Limits;
use crate::image::raster::Image;
use crate::light::envmap::EnvMap;
use crate::light::layout::{Chart, Layout};
use crate::light::reproject;
use crate::stages::layouts::View;

/// Makes a lat-long map of a cube map, an octahedral square, an angular map or a photograph of a mirror ball.
///
/// The light of each pixel goes to the pixels of the map that share its solid angle: none is lost or made. Pixels
/// of alpha 0 show nothing; directions that the picture does not show at all continue their surroundings, and are counted
/// in a warning. `wrap` is the way back.
///
/// ```yaml
/// from-ball: { unwrap: { of: ball, layout: mirror-ball, height: 512 }, save: exr }
/// ```
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Unwrap {
    /// The picture, of linear light.
    pub of: Port<Image>,
    /// How directions lie in the picture.
    pub layout: Layout,
    /// Rows of the map, which is twice as wide. By default about the resolution of the picture: its side, or twice that of
    /// a face of a cube.
    #[serde(default)]
    #[schemars(range(min = 1, max = 16384), extend("x-unit" = "px"))]
    pub height: Option<u32>,
    /// For `angular` and `mirror-ball`: where the camera looks, and where the disk lies.
    #[serde(default)]
    pub view: View,
}

impl Stage for Unwrap {
    const KIND: &'static str = "unwrap";
    const VERSION: u32 = 1;
    const RESULTS: &'static [ResultDeclaration] = &[ResultDeclaration { name: "", types: &[EnvMap::TYPE] }];
    type Output = EnvMap;

    fn mistakes(&self) -> Vec<Mistake> {
        self.view.mistakes(self.layout)
    }

    /// Sums in f64, and shares of some rows of the picture at a time.
    fn memory(&self, inputs: &InputSizes) -> u64 {
        let height = u64::from(self.height.unwrap_or(0));
        2 * 64 * height * height + 8 * inputs.values().sum::<u64>()
    }

    fn run(&self, job: &Job<'_>) -> Result<EnvMap, StageError> {
        let picture = job.input(&self.of)?;
        let size = [picture.color.width(), picture.color.height()];
        let disk = self.view.disk(size);
        let chart = Chart::new(self.layout, size, &disk)?;
        let side = if self.layout.is_disk() { (2.0 * disk.radius).ceil() as usize } else { self.layout.side_of(size) };
        let height = self.height.map_or_else(|| self.layout.map_height_for(side), |height| height as usize);
        let (width, height) = Limits::default().checked("map", 2 * height as u64, height as u64).map_err(StageError::content)?;
        let found = reproject::unwrap(&picture, &chart, [width, height], || job.check())?;
        let found = found.ok_or_else(|| StageError::content("the picture shows no direction: its alpha is 0 everywhere"))?;
        if found.hidden_count > 0 {
            let share = 100.0 * found.hidden_count as f64 / (width * height) as f64;
            job.warn(format!(
                "{} pixels of the map ({share:.2} %) are not in the picture and continue their surroundings",
                found.hidden_count
            ));
        }
        Ok(found.map)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::artifact::AnyArtifact;
    use crate::image::raster::{Plane, Raster};
    use crate::stages::rasters::trial;

    fn run(text: &str, image: Image) -> (Result<Vec<AnyArtifact>, StageError>, Vec<String>) {
        trial::run::<Unwrap>(text, [("p", vec![AnyArtifact::new(image)])])
    }

    #[test]
    fn a_shape_that_does_not_fit_the_layout_is_told() {
        let (result, _) = run("{ of: p, layout: cube-cross }", Image::opaque(Raster::filled(8, 8, [1.0; 3])));
        assert!(result.unwrap_err().to_string().contains("`cube-cross` is a third wider than high"));
    }

    #[test]
    fn a_picture_that_shows_nothing_is_told_and_hidden_parts_are_counted() {
        let mut image = Image::opaque(Raster::filled(12, 2, [1.0; 3]));
        let mut values = vec![1.0; 24];
        // Face -y.
        (0..24).filter(|index| index % 12 / 2 == 3).for_each(|index| values[index] = 0.0);
        image.alpha = Some(Plane { width: 12, height: 2, values });
        let (result, warnings) = run("{ of: p, layout: cube-strip, height: 16 }", image.clone());
        assert_eq!(result.unwrap()[0].get::<EnvMap>().unwrap().height(), 16);
        assert!(warnings[0].contains("are not in the picture"), "{warnings:?}");
        image.alpha.as_mut().unwrap().values.fill(0.0);
        assert!(run("{ of: p, layout: cube-strip }", image).0.unwrap_err().to_string().contains("no direction"));
    }

    #[test]
    fn the_usual_height_is_that_of_the_disk() {
        let (result, _) = run("{ of: p, layout: mirror-ball, view: { radius: 10 } }", Image::opaque(Raster::filled(40, 30, [1.0; 3])));
        assert_eq!(result.unwrap()[0].get::<EnvMap>().unwrap().height(), 20);
    }
}

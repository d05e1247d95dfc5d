//! The kind `wrap`; the mathematics is in `light::reproject`.

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

/// Lays a map out as a cube map, an octahedral square, an angular map or a mirror ball.
///
/// Each pixel is the mean of the map over its own solid angle, so that no light is lost or made. `unwrap` is the way
/// back. Pixels that stand for no direction have alpha 0.
///
/// ```yaml
/// cube: { wrap: { of: env, layout: cube-cross, size: 256 }, save: exr }
/// ```
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Wrap {
    /// The map.
    pub of: Port<EnvMap>,
    /// How directions lie in the picture.
    pub layout: Layout,
    /// Side in pixels: of the square, or of each face of a cube. By default about the resolution of the map: its height,
    /// or half of it for a cube.
    #[serde(default)]
    #[schemars(range(min = 1, max = 16384), extend("x-unit" = "px"))]
    pub size: Option<u32>,
    /// For `angular` and `mirror-ball`: where the camera looks, and where the disk lies.
    #[serde(default)]
    pub view: View,
}

impl Stage for Wrap {
    const KIND: &'static str = "wrap";
    const VERSION: u32 = 1;
    const RESULTS: &'static [ResultDeclaration] = &[ResultDeclaration { name: "", types: &[Image::TYPE] }];
    type Output = Image;

    fn mistakes(&self) -> Vec<Mistake> {
        let [width, height] = self.layout.size(self.size.unwrap_or(1) as usize);
        let too_large = Limits::default().checked("size", width as u64, height as u64).err();
        let too_large = too_large.map(|error| Mistake { field: "size".into(), message: error.to_string(), hint: None });
        self.view.mistakes(self.layout).into_iter().chain(too_large).collect()
    }

    fn memory(&self, inputs: &InputSizes) -> u64 {
        let [width, height] = self.layout.size(self.size.unwrap_or(0) as usize);
        (16 * width * height) as u64 + inputs.values().sum::<u64>()
    }

    fn run(&self, job: &Job<'_>) -> Result<Image, StageError> {
        let map = job.input(&self.of)?;
        let side = self.size.map_or_else(|| self.layout.side_for(map.height()), |side| side as usize);
        let size = self.layout.size(side);
        Limits::default().checked("picture", size[0] as u64, size[1] as u64).map_err(StageError::content)?;
        let chart = Chart::new(self.layout, size, &self.view.disk(size))?;
        reproject::wrap(&map, &chart, || job.check())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::artifact::AnyArtifact;
    use crate::image::raster::Raster;
    use crate::stages::rasters::trial;

    #[test]
    fn the_usual_size_follows_the_map() {
        for (layout, size) in [("cube-cross", (32, 24)), ("cube-strip", (48, 8)), ("octahedral", (16, 16)), ("mirror-ball", (16, 16))] {
            let map = AnyArtifact::new(EnvMap::new(Raster::filled(32, 16, [1.0; 3])));
            let (results, _) = trial::run::<Wrap>(&format!("{{ of: m, layout: {layout} }}"), [("m", vec![map])]);
            let image = results.unwrap()[0].get::<Image>().unwrap();
            assert_eq!((image.color.width(), image.color.height()), size, "{layout}");
        }
    }

    #[test]
    fn fields_without_meaning_and_impossible_sizes_are_mistakes() {
        assert!(trial::mistakes::<Wrap>("{ of: m, layout: octahedral, view: { radius: 3 } }")[0].starts_with("view.radius"));
        assert!(trial::mistakes::<Wrap>("{ of: m, layout: cube-strip, size: 16384 }")[0].starts_with("size"));
    }
}

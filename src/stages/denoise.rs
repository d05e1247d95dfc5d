//! The kind `denoise`; the mathematics is in `image::nl_means`.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::engine::artifact::Artifact;
use crate::engine::job::Job;
use crate::engine::parameter::Port;
use crate::engine::stage::{InputSizes, ResultDeclaration, Stage, StageError};
use crate::image::average::NOISE_LAYERS;
use crate::image::nl_means::{self, Border, Guide, Settings};
use crate::image::raster::{Image, Layer, Raster};

/// Removes the noise of a render by non-local means.
///
/// Every pixel becomes a weighted mean of those in a window around it; weights fall with the distance of the patches
/// around both, measured in units of their known noise, so noise is averaged and detail stays. The noise is that of the
/// image's layer `standard_error` or `variance` (of the pixel's value), which `render` keeps with `layers: [variance]`
/// and `average` gives; or it is found from two independent images, `of` and `with`. Alpha and other layers stay as they are;
/// those of the noise are left out, for what remains is not known. The result is biased, as that of every such filter.
/// Rousselle, Knaus and Zwicker (2012).
///
/// ```yaml
/// clean: { denoise: { of: traced, features: [albedo, normal] }, save: exr }
/// ```
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Denoise {
    /// The noisy image.
    pub of: Port<Image>,
    /// A second image of the same scene, from another seed and with as many samples: each is filtered with weights
    /// from the other, so that weights do not follow the noise they average, and the result is the mean of both.
    #[serde(default)]
    pub with: Option<Port<Image>>,
    /// f: patches of 2 f + 1 pixels along each side are compared. Default 3.
    #[serde(default = "patch_radius")]
    #[schemars(range(max = 64), extend("x-unit" = "px"))]
    pub patch_radius: u32,
    /// r: a window of 2 r + 1 pixels along each side is searched. Default 10.
    #[serde(default = "window_radius")]
    #[schemars(range(max = 256), extend("x-unit" = "px"))]
    pub window_radius: u32,
    /// Differences are measured in k standard deviations: larger smooths more. Default 0.45.
    #[serde(default = "k")]
    #[schemars(range(min = 0.01, max = 100))]
    pub k: f32,
    /// Averages whole patches instead of their centers: smoother on flat ground, at a little more time. Default no.
    #[serde(default)]
    pub patchwise: bool,
    /// Layers of the scene that must agree too where pixels are averaged. Default none.
    #[serde(default)]
    #[schemars(extend("uniqueItems" = true))]
    pub features: Vec<FeatureLayer>,
    /// What is done to the variance before it is used.
    #[serde(default)]
    pub variance_prefilter: VariancePrefilter,
    /// What lies beyond the edge. Default `clamp`.
    #[serde(default)]
    pub border: Border,
}

/// A layer that tells surfaces apart without noise.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum FeatureLayer {
    /// Color of the surface without light.
    Albedo,
    /// Where the surface faces.
    Normal,
}

/// What is done to the variance before it is used.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum VariancePrefilter {
    /// Nothing.
    #[default]
    None,
    /// It is raised to the mean over 3 x 3 pixels at least, so that samples that agree by chance count as noisy too.
    MaxBox,
}

fn patch_radius() -> u32 {
    3
}

fn window_radius() -> u32 {
    10
}

fn k() -> f32 {
    0.45
}

impl Stage for Denoise {
    const KIND: &'static str = "denoise";
    const VERSION: u32 = 2;
    const RESULTS: &'static [ResultDeclaration] = &[ResultDeclaration { name: "", types: &[Image::TYPE] }];
    type Output = Image;

    fn caveats(&self) -> Vec<String> {
        vec!["denoised: the noise is exchanged for a bias; errors against a reference contain both".into()]
    }

    /// Planes of target, guide, variance and features with their margins, beside the result.
    fn memory(&self, inputs: &InputSizes) -> u64 {
        8 * inputs.values().sum::<u64>()
    }

    fn run(&self, job: &Job<'_>) -> Result<Image, StageError> {
        let image = job.input(&self.of)?;
        let Some(other) = job.optional_input(&self.with)? else {
            let variance = nl_means::of_one(&image).ok_or_else(no_variance)?;
            let color = self.filtered(&image.color, &image, &variance, job)?;
            return Ok(with_color(&image, color));
        };
        self.check_sizes(&image, &other)?;
        let variance = nl_means::of_two(&image, &other);
        let first = self.filtered(&image.color, &other, &variance, job)?;
        job.report_progress(0.5);
        let second = self.filtered(&other.color, &image, &variance, job)?;
        Ok(with_color(&image, nl_means::mean_of_two(&first, &second)))
    }
}

impl Denoise {
    /// `target` by weights that the guide's color and features give.
    fn filtered(&self, target: &Raster, guide: &Image, variance: &Raster, job: &Job<'_>) -> Result<Raster, StageError> {
        check_numbers(&guide.color, "color", f32::MIN)?;
        check_numbers(variance, "variance", 0.0)?;
        let variance = match self.variance_prefilter {
            VariancePrefilter::None => variance,
            VariancePrefilter::MaxBox => &nl_means::raised(variance),
        };
        let features = self.features.iter().map(|layer| layer.of(guide)).collect::<Result<Vec<_>, _>>()?;
        let guide = Guide { color: &guide.color, variance, coverage: guide.alpha.as_ref(), features: &features };
        nl_means::filter(target, guide, self.settings(), || job.check())
    }

    fn settings(&self) -> Settings {
        let Self { patch_radius, window_radius, k, patchwise, border, .. } = *self;
        Settings { patch_radius, window_radius, k, patchwise, border }
    }

    fn check_sizes(&self, image: &Image, other: &Image) -> Result<(), StageError> {
        let size = |image: &Image| (image.color.width(), image.color.height());
        let ((width, height), (other_width, other_height)) = (size(image), size(other));
        if (width, height) != (other_width, other_height) {
            let message = format!("`of` has {width} x {height} pixels and `with` {other_width} x {other_height}; both must show the same");
            return Err(StageError::content(message));
        }
        if image.alpha != other.alpha {
            return Err(StageError::content("`of` and `with` have different alpha; both must show the same"));
        }
        if image.color == other.color {
            return Err(StageError::content(
                "`of` and `with` are the same image, which says nothing of its noise; render one with another `seed`",
            ));
        }
        Ok(())
    }
}

impl FeatureLayer {
    /// The layer of that name.
    fn of(self, image: &Image) -> Result<&Raster, StageError> {
        let name = match self {
            Self::Albedo => "albedo",
            Self::Normal => "normal",
        };
        match image.layers.get(name) {
            Some(Layer::Color(raster)) => check_numbers(raster, name, f32::MIN).map(|()| raster),
            _ => Err(StageError::content(format!("the image has no layer `{name}`; add it to `layers` of the render's film"))),
        }
    }
}

fn no_variance() -> StageError {
    StageError::content(
        "the image does not say how noisy it is; give the render's film `layers: [variance]`, or a second image of another `seed` as `with`",
    )
}

/// Refuses what would spread from one pixel over its window.
fn check_numbers(raster: &Raster, name: &str, least: f32) -> Result<(), StageError> {
    let is_wrong = |pixel: &[f32; 3]| pixel.iter().any(|value| !value.is_finite() || *value < least);
    let Some(index) = raster.pixels().iter().position(is_wrong) else { return Ok(()) };
    let ([x, y], pixel) = ([index % raster.width(), index / raster.width()], raster.pixels()[index]);
    Err(StageError::content(format!(
        "the {name} of pixel ({x}, {y}) is {pixel:?}; what is filtered must be finite, and variances at least zero"
    )))
}

/// The image with another color, without the layers that told of its noise.
fn with_color(image: &Image, color: Raster) -> Image {
    let layers = image.layers.iter().filter(|(name, _)| !NOISE_LAYERS.contains(&name.as_str()));
    Image { color, alpha: image.alpha.clone(), layers: layers.map(|(name, layer)| (name.clone(), layer.clone())).collect() }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;
    use crate::engine::artifact::AnyArtifact;
    use crate::stages::rasters::trial;

    fn image(color: [f32; 3], layers: &[(&str, [f32; 3])]) -> Image {
        let layers = layers.iter().map(|(name, value)| (name.to_string(), Layer::Color(Raster::filled(4, 3, *value)))).collect();
        Image { layers, ..Image::opaque(Raster::filled(4, 3, color)) }
    }

    fn result(text: &str, images: &[&Image]) -> Result<Image, String> {
        let ports = ["a", "b"].into_iter().zip(images);
        let inputs = ports.map(|(name, image)| (name, vec![AnyArtifact::new((*image).clone())]));
        let (results, _) = trial::run::<Denoise>(text, inputs.collect::<Vec<_>>());
        results.map(|results| (*results[0].get::<Image>().unwrap()).clone()).map_err(|error| error.to_string())
    }

    #[test]
    fn what_was_known_of_the_noise_is_left_out_and_the_rest_stays() {
        let noisy = image([2.0; 3], &[("variance", [0.1; 3]), ("standard_error", [0.3; 3]), ("albedo", [0.5; 3])]);
        let clean = result("{ of: a, features: [albedo] }", &[&noisy]).unwrap();
        assert_eq!(clean, image([2.0; 3], &[("albedo", [0.5; 3])]));
    }

    #[test]
    fn two_images_become_the_mean_of_both() {
        let (a, b) = (image([1.0; 3], &[]), image([3.0; 3], &[]));
        assert_eq!(result("{ of: a, with: b, variance_prefilter: max-box }", &[&a, &b]).unwrap(), image([2.0; 3], &[]));
    }

    #[test]
    fn what_cannot_be_filtered_is_refused_with_what_to_do() {
        let plain = image([1.0; 3], &[]);
        let bad = image([1.0, f32::NAN, 0.0], &[("variance", [1.0; 3])]);
        let negative = image([1.0; 3], &[("variance", [-1.0; 3])]);
        let small = Image { layers: BTreeMap::new(), ..Image::opaque(Raster::filled(2, 2, [1.0; 3])) };
        let cases: [(&str, &[&Image], &str); 6] = [
            ("{ of: a }", &[&plain], "the image does not say how noisy it is; give the render's film `layers: [variance]`"),
            ("{ of: a }", &[&bad], "the color of pixel (0, 0) is [1.0, NaN, 0.0]"),
            ("{ of: a }", &[&negative], "the variance of pixel (0, 0) is"),
            ("{ of: a, with: b }", &[&plain, &small], "`of` has 4 x 3 pixels and `with` 2 x 2"),
            ("{ of: a, with: b }", &[&plain, &plain], "`of` and `with` are the same image"),
            ("{ of: a, with: b, features: [normal] }", &[&plain, &image([2.0; 3], &[])], "the image has no layer `normal`"),
        ];
        for (text, images, expected) in cases {
            let message = result(text, images).unwrap_err();
            assert!(message.starts_with(expected), "{message}");
        }
    }
}

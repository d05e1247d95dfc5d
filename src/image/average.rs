//! The mean of many images with its uncertainty, taking in one image at a time.
//!
//! Welford's update ("Note on a method for calculating corrected sums of squares and products", 1962) in f64
//! and in the order of the images, so that nothing is lost to cancellation and no image need be kept.

use std::collections::BTreeMap;

use rayon::prelude::*;

use crate::image::raster::{Image, Layer, Plane, Raster};

/// Layer with the sample variance of each channel among the images, divided by n - 1.
pub const VARIANCE: &str = "variance";
/// Layer with the standard error of each channel of the mean: the root of variance over n.
pub const STANDARD_ERROR: &str = "standard_error";

/// Layer of a render with the variance that each channel would have if its samples were independent.
pub const SAMPLE_VARIANCE: &str = "sample_variance";
/// Layers that tell of the noise of one image, and not of the scene.
pub const NOISE_LAYERS: [&str; 3] = [VARIANCE, STANDARD_ERROR, SAMPLE_VARIANCE];

/// Images that cannot be averaged.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum AverageError {
    /// Widths or heights differ.
    #[error("image {position} has {width} x {height} pixels and the first {first_width} x {first_height}; all must have one size")]
    SizesDiffer {
        /// Position of the image, from 1.
        position: u64,
        /// Its width.
        width: usize,
        /// Its height.
        height: usize,
        /// Width of the first image.
        first_width: usize,
        /// Height of the first image.
        first_height: usize,
    },
    /// Coverage differs, so that a mean of colors would mix covered and uncovered.
    #[error("image {position} has another alpha than the first; only images of the same coverage have a mean")]
    AlphaDiffers {
        /// Position of the image, from 1.
        position: u64,
    },
}

/// The mean of the images so far.
pub struct RunningMean {
    count: u64,
    width: usize,
    height: usize,
    alpha: Option<Plane>,
    mean: Vec<f64>,
    /// Sum of squared deviations from the mean of the images so far.
    squares: Vec<f64>,
    /// Sums of the further layers that all images have.
    layers: BTreeMap<String, LayerSum>,
}

/// Sum of one further layer, and how many numbers a pixel it has.
struct LayerSum {
    channels: usize,
    values: Vec<f64>,
}

/// Numbers that one thread takes at a time.
const CHUNK: usize = 1 << 14;

impl RunningMean {
    /// Begins with a first image.
    pub fn of(first: &Image) -> Self {
        let mean: Vec<f64> = first.color.pixels().iter().flatten().copied().map(f64::from).collect();
        let further = first.layers.iter().filter(|(name, _)| !NOISE_LAYERS.contains(&name.as_str()));
        Self {
            count: 1,
            width: first.color.width(),
            height: first.color.height(),
            alpha: first.alpha.clone(),
            squares: vec![0.0; mean.len()],
            mean,
            layers: further.map(|(name, layer)| (name.clone(), LayerSum::of(layer))).collect(),
        }
    }

    /// Takes in one more image of the same size and alpha.
    pub fn push(&mut self, image: &Image) -> Result<(), AverageError> {
        let position = self.count + 1;
        let (width, height) = (image.color.width(), image.color.height());
        if (width, height) != (self.width, self.height) {
            return Err(AverageError::SizesDiffer { position, width, height, first_width: self.width, first_height: self.height });
        }
        if image.alpha != self.alpha {
            return Err(AverageError::AlphaDiffers { position });
        }
        self.count = position;
        self.update_color(image.color.pixels().as_flattened());
        self.layers.retain(|name, sum| image.layers.get(name).is_some_and(|layer| sum.add(layer)));
        Ok(())
    }

    /// m ← m + (x - m) / n and s ← s + (x - m before) (x - m after).
    fn update_color(&mut self, values: &[f32]) {
        let count = self.count as f64;
        let chunks = self.mean.par_chunks_mut(CHUNK).zip(self.squares.par_chunks_mut(CHUNK)).zip(values.par_chunks(CHUNK));
        chunks.for_each(|((means, squares), values)| {
            for ((mean, square), value) in means.iter_mut().zip(squares).zip(values) {
                let before = f64::from(*value) - *mean;
                *mean += before / count;
                *square += before * (f64::from(*value) - *mean);
            }
        });
    }

    /// The mean, with the layers `variance` and `standard_error` if there was more than one image.
    ///
    /// Further layers (albedo, normal, depth) are averaged where all images have them.
    pub fn finish(self) -> Image {
        let count = self.count as f64;
        let raster = |f: &dyn Fn(usize) -> f64| raster_of(self.width, self.height, f);
        let color = raster(&|index| self.mean[index]);
        let mut layers: BTreeMap<String, Layer> =
            self.layers.iter().map(|(name, sum)| (name.clone(), sum.mean(self.width, self.height, count))).collect();
        if self.count > 1 {
            let variance = |index: usize| self.squares[index] / (count - 1.0);
            layers.insert(VARIANCE.into(), Layer::Color(raster(&variance)));
            layers.insert(STANDARD_ERROR.into(), Layer::Color(raster(&|index| (variance(index) / count).sqrt())));
        }
        Image { color, alpha: self.alpha, layers }
    }
}

impl LayerSum {
    fn of(layer: &Layer) -> Self {
        let (channels, values) = numbers(layer);
        Self { channels, values: values.iter().copied().map(f64::from).collect() }
    }

    /// Adds a layer; false if it is of another sort.
    fn add(&mut self, layer: &Layer) -> bool {
        let (channels, values) = numbers(layer);
        if (channels, values.len()) != (self.channels, self.values.len()) {
            return false;
        }
        self.values.iter_mut().zip(values).for_each(|(sum, value)| *sum += f64::from(*value));
        true
    }

    fn mean(&self, width: usize, height: usize, count: f64) -> Layer {
        if self.channels == 1 {
            Layer::Scalar(Plane { width, height, values: self.values.iter().map(|sum| (sum / count) as f32).collect() })
        } else {
            Layer::Color(raster_of(width, height, &|index| self.values[index] / count))
        }
    }
}

fn numbers(layer: &Layer) -> (usize, &[f32]) {
    match layer {
        Layer::Scalar(plane) => (1, &plane.values),
        Layer::Color(raster) => (3, raster.pixels().as_flattened()),
    }
}

/// A raster from the numbers of its channels, pixel by pixel.
fn raster_of(width: usize, height: usize, f: &dyn Fn(usize) -> f64) -> Raster {
    let pixel = |index: usize| std::array::from_fn(|channel| f(3 * index + channel) as f32);
    Raster::new(width, height, (0..width * height).map(pixel).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(values: [f32; 3]) -> Image {
        Image::opaque(Raster::filled(2, 1, values))
    }

    fn averaged(images: &[Image]) -> Image {
        let mut mean = RunningMean::of(&images[0]);
        images[1..].iter().for_each(|image| mean.push(image).unwrap());
        mean.finish()
    }

    fn layer(image: &Image, name: &str) -> [f32; 3] {
        match &image.layers[name] {
            Layer::Color(raster) => raster.pixel(1, 0),
            Layer::Scalar(plane) => [plane.values[1]; 3],
        }
    }

    #[test]
    fn mean_variance_and_standard_error_are_those_of_the_textbook() {
        let average = averaged(&[image([1.0, 5.0, 0.0]), image([2.0, 5.0, 0.0]), image([6.0, 5.0, 3.0])]);
        assert_eq!(average.color.pixel(1, 0), [3.0, 5.0, 1.0]);
        assert_eq!(layer(&average, VARIANCE), [7.0, 0.0, 3.0]);
        assert_eq!(layer(&average, STANDARD_ERROR), [(7.0_f64 / 3.0).sqrt() as f32, 0.0, 1.0]);
    }

    #[test]
    fn a_small_variance_on_a_large_mean_is_not_lost() {
        // In f32 squares of 4096 have steps of 1; the variance is 1/4 of a step of the values.
        let average = averaged(&[image([4096.0; 3]), image([4_096.000_5; 3])]);
        let step = f64::from(4_096.000_5_f32) - 4096.0;
        assert_eq!(layer(&average, VARIANCE), [(step * step / 2.0) as f32; 3]);
    }

    #[test]
    fn one_image_is_its_own_mean_without_uncertainty() {
        let average = averaged(&[image([1.0, 2.0, 3.0])]);
        assert_eq!(average, image([1.0, 2.0, 3.0]));
    }

    #[test]
    fn layers_that_all_have_are_averaged_and_old_uncertainties_dropped() {
        let with = |depth: f32, albedo: bool| {
            let mut image = image([1.0; 3]);
            image.layers.insert("depth".into(), Layer::Scalar(Plane { width: 2, height: 1, values: vec![depth; 2] }));
            image.layers.insert(VARIANCE.into(), Layer::Color(Raster::filled(2, 1, [9.0; 3])));
            if albedo {
                image.layers.insert("albedo".into(), Layer::Color(Raster::filled(2, 1, [0.5; 3])));
            }
            image
        };
        let average = averaged(&[with(1.0, true), with(2.0, false)]);
        assert_eq!(layer(&average, "depth"), [1.5; 3]);
        assert_eq!(layer(&average, VARIANCE), [0.0; 3]);
        assert!(!average.layers.contains_key("albedo"));
    }

    #[test]
    fn images_of_another_size_or_alpha_are_refused() {
        let mut mean = RunningMean::of(&image([1.0; 3]));
        let other_size = Image::opaque(Raster::filled(1, 2, [1.0; 3]));
        assert_eq!(mean.push(&other_size).unwrap_err().to_string(), "image 2 has 1 x 2 pixels and the first 2 x 1; all must have one size");
        let mut other_alpha = image([1.0; 3]);
        other_alpha.alpha = Some(Plane { width: 2, height: 1, values: vec![0.0, 1.0] });
        assert_eq!(mean.push(&other_alpha).unwrap_err(), AverageError::AlphaDiffers { position: 2 });
    }
}

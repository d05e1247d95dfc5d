//! Photographs of one view with different exposure times, as one image of linear light.
//!
//! Reading order: here the sum over exposures, then `response`, which finds the curve of a camera from the photographs
//! themselves. Values are codes over the largest code, 0 to 1; of their file formats nothing is known here.
//!
//! After Debevec & Malik, "Recovering high dynamic range radiance maps from photographs" (1997), equation 6.

pub mod response;

use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::image::assembly::response::Curve;
use crate::image::color;
use crate::image::raster::{Plane, Raster};
use crate::math::elementary;

/// A photograph and how long it was exposed.
#[derive(Debug, Clone)]
pub struct Exposure {
    /// What it is called in messages.
    pub name: String,
    /// Codes over the largest code, 0 to 1.
    pub codes: Raster,
    /// Alpha; where it is 0 in any photograph, nothing is known. `None` means 1 everywhere.
    pub alpha: Option<Plane>,
    /// Exposure time; any unit that is the same for all.
    pub seconds: f64,
}

/// How much a code counts, by its distance from black and white.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Weighting {
    /// 16 z² (1 - z)²: flat at its ends and 1 in the middle, as the coursework asks for.
    #[default]
    Course,
    /// 1 - |2 z - 1|: Debevec & Malik's hat (1997, equation 4).
    Hat,
    /// All alike.
    Uniform,
}

impl Weighting {
    /// The weight of a code from 0 to 1.
    pub fn weight(self, z: f64) -> f64 {
        match self {
            Self::Course => 16.0 * z * z * (1.0 - z) * (1.0 - z),
            Self::Hat => 1.0 - (2.0 * z - 1.0).abs(),
            Self::Uniform => 1.0,
        }
    }
}

/// What light a code stands for.
#[derive(Debug, Clone)]
pub enum Response {
    /// Codes are proportional to light.
    Linear,
    /// Light is code to this power.
    Gamma(f64),
    /// The curve of IEC 61966-2-1.
    Srgb,
    /// A curve for each channel.
    Recovered(Box<[Curve; 3]>),
}

impl Response {
    /// Exposure (irradiance times time) of a code of a channel; 1 is what the largest code of `linear` and `srgb` stands for.
    pub fn exposure(&self, channel: usize, z: f64) -> f64 {
        match self {
            Self::Linear => z,
            Self::Gamma(gamma) => elementary::pow(z, *gamma),
            Self::Srgb => color::srgb_decode(z),
            Self::Recovered(curves) => elementary::exp(curves[channel].log_exposure(z)),
        }
    }
}

/// How exposures become one image.
#[derive(Debug, Clone)]
pub struct Settings {
    /// What a code counts.
    pub weighting: Weighting,
    /// Codes below are not used; 0 to 1.
    pub ignore_below: f64,
    /// Codes above are not used; 0 to 1.
    pub ignore_above: f64,
    /// What light a code stands for.
    pub response: Response,
}

/// The image, and how sure it is.
#[derive(Debug, Clone, PartialEq)]
pub struct Assembled {
    /// Radiance up to a factor: a pixel that would be just white in one second has 1.
    pub radiance: Raster,
    /// 0 where a photograph has alpha 0, else 1; `None` where all are opaque.
    pub alpha: Option<Plane>,
    /// Pixels with a channel that is too bright in every exposure in which it is not too dark: the value is the least it
    /// can be.
    pub saturated_count: u64,
    /// Pixels with a channel that is too dark in every exposure: the value is what the longest says.
    pub black_count: u64,
    /// Least and greatest luminance among pixels all of whose channels were well exposed; `None` if there is none.
    pub range: Option<[f64; 2]>,
}

/// Photographs that give no image.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum AssemblyError {
    /// One is no set.
    #[error("there are too few exposures: {0}; two or more with different times make an image of high range")]
    TooFew(usize),
    /// The camera moved, or the pictures are of different things.
    #[error("{name} has {width} x {height} pixels, but {first} has {first_width} x {first_height}")]
    Size {
        /// The photograph.
        name: String,
        /// Its pixels in a row.
        width: usize,
        /// Its rows.
        height: usize,
        /// The first photograph.
        first: String,
        /// Its pixels in a row.
        first_width: usize,
        /// Its rows.
        first_height: usize,
    },
    /// A time that no camera has.
    #[error("{name} has an exposure time of `{seconds}` seconds; a time is a number above 0")]
    Time {
        /// The photograph.
        name: String,
        /// Its time.
        seconds: f64,
    },
    /// Nothing between black and white.
    #[error("no pixel of any exposure has a value between {below} and {above}: all are black or saturated ({names})")]
    NothingExposed {
        /// The least code used.
        below: f64,
        /// The greatest code used.
        above: f64,
        /// The photographs.
        names: String,
    },
    /// The response cannot be found.
    #[error("the response cannot be recovered: {0}")]
    Response(&'static str),
}

/// Photographs that are fit to be put together, the shortest time first.
#[derive(Debug)]
pub struct Exposures(Vec<Exposure>);

impl Exposures {
    /// Checks that there are at least two, of one size, with times.
    pub fn new(mut exposures: Vec<Exposure>) -> Result<Self, AssemblyError> {
        if let Some(Exposure { name, seconds, .. }) =
            exposures.iter().find(|exposure| !(exposure.seconds > 0.0 && exposure.seconds.is_finite()))
        {
            return Err(AssemblyError::Time { name: name.clone(), seconds: *seconds });
        }
        let [first, rest @ ..] = exposures.as_slice() else { return Err(AssemblyError::TooFew(0)) };
        let size = |exposure: &Exposure| (exposure.codes.width(), exposure.codes.height());
        if let Some(other) = rest.iter().find(|other| size(other) != size(first)) {
            let ((width, height), (first_width, first_height)) = (size(other), size(first));
            return Err(AssemblyError::Size {
                name: other.name.clone(),
                width,
                height,
                first: first.name.clone(),
                first_width,
                first_height,
            });
        }
        if rest.is_empty() {
            return Err(AssemblyError::TooFew(1));
        }
        exposures.sort_by(|a, b| a.seconds.total_cmp(&b.seconds));
        Ok(Self(exposures))
    }

    /// The photographs, the shortest time first.
    pub fn as_slice(&self) -> &[Exposure] {
        &self.0
    }

    /// Whether all photographs show something there.
    fn is_covered(&self, [x, y]: [usize; 2]) -> bool {
        self.0.iter().all(|exposure| exposure.alpha.as_ref().is_none_or(|alpha| alpha.values[y * alpha.width + x] > 0.0))
    }

    fn size(&self) -> [usize; 2] {
        [self.0[0].codes.width(), self.0[0].codes.height()]
    }

    fn names(&self) -> String {
        self.0.iter().map(|exposure| exposure.name.as_str()).collect::<Vec<_>>().join(", ")
    }
}

/// What is known of one channel of one pixel.
enum Found {
    Measured(f64),
    AtLeast(f64),
    TooDark(f64),
}

/// Puts exposures together.
///
/// Each channel by itself: ln E = Σ w(z) (ln X(z) - ln t) / Σ w(z) over the exposures whose code z is within the limits.
pub fn assemble<E: Send + From<AssemblyError>>(
    exposures: &Exposures,
    settings: &Settings,
    check: impl Fn() -> Result<(), E> + Sync,
) -> Result<Assembled, E> {
    let [width, height] = exposures.size();
    let mut pixels = vec![[0.0_f32; 3]; width * height];
    let rows: Vec<RowCounts> = pixels
        .par_chunks_mut(width.max(1))
        .enumerate()
        .map(|(y, row)| {
            check()?;
            Ok(assemble_row(exposures, settings, y, row))
        })
        .collect::<Result<_, E>>()?;
    let sum = |count: fn(&RowCounts) -> u64| rows.iter().map(count).sum::<u64>();
    if sum(|row| row.measured) == 0 {
        let (below, above) = (settings.ignore_below, settings.ignore_above);
        return Err(AssemblyError::NothingExposed { below, above, names: exposures.names() }.into());
    }
    let range = rows.iter().filter_map(|row| row.range).reduce(|a, b| [a[0].min(b[0]), a[1].max(b[1])]);
    let is_opaque = exposures.0.iter().all(|exposure| exposure.alpha.is_none());
    let coverage = |index: usize| f32::from(u8::from(exposures.is_covered([index % width, index / width])));
    Ok(Assembled {
        radiance: Raster::new(width, height, pixels),
        alpha: (!is_opaque).then(|| Plane { width, height, values: (0..width * height).map(coverage).collect() }),
        saturated_count: sum(|row| row.saturated),
        black_count: sum(|row| row.black),
        range,
    })
}

#[derive(Default)]
struct RowCounts {
    /// Channels that some exposure shows well.
    measured: u64,
    saturated: u64,
    black: u64,
    range: Option<[f64; 2]>,
}

fn assemble_row(exposures: &Exposures, settings: &Settings, y: usize, row: &mut [[f32; 3]]) -> RowCounts {
    let mut counts = RowCounts::default();
    for (x, pixel) in row.iter_mut().enumerate().filter(|(x, _)| exposures.is_covered([*x, y])) {
        let found = [0, 1, 2].map(|channel| of_channel(exposures, settings, [x, y], channel));
        counts.measured += found.iter().filter(|found| matches!(found, Found::Measured(_))).count() as u64;
        counts.saturated += u64::from(found.iter().any(|found| matches!(found, Found::AtLeast(_))));
        counts.black += u64::from(found.iter().any(|found| matches!(found, Found::TooDark(_))));
        let is_measured = found.iter().all(|found| matches!(found, Found::Measured(_)));
        *pixel = found.map(|found| match found {
            Found::Measured(value) | Found::AtLeast(value) | Found::TooDark(value) => value as f32,
        });
        if is_measured {
            let luminance = color::luminance(*pixel);
            let [least, most] = counts.range.unwrap_or([luminance; 2]);
            counts.range = Some([least.min(luminance), most.max(luminance)]);
        }
    }
    counts
}

fn of_channel(exposures: &Exposures, settings: &Settings, [x, y]: [usize; 2], channel: usize) -> Found {
    let (mut sum, mut weight) = (0.0, 0.0);
    // The shortest that is too bright, the longest that is too dark.
    let (mut bright, mut dark) = (None, None);
    for Exposure { codes, seconds, .. } in &exposures.0 {
        let z = f64::from(codes.pixel(x, y)[channel]);
        if z > settings.ignore_above {
            bright = bright.or(Some((z.min(1.0), seconds)));
            continue;
        }
        // A value that is no number is dark too.
        let exposure = if z >= settings.ignore_below { settings.response.exposure(channel, z) } else { 0.0 };
        let share = if exposure > 0.0 { settings.weighting.weight(z) } else { 0.0 };
        if share > 0.0 {
            sum += share * (elementary::ln(exposure) - elementary::ln(*seconds));
            weight += share;
        } else {
            dark = Some((z.max(0.0), seconds));
        }
    }
    match (bright, dark) {
        _ if weight > 0.0 => Found::Measured(elementary::exp(sum / weight)),
        (Some((z, seconds)), _) => Found::AtLeast(settings.response.exposure(channel, z) / seconds),
        (None, Some((z, seconds))) => Found::TooDark(if z > 0.0 { settings.response.exposure(channel, z) / seconds } else { 0.0 }),
        (None, None) => Found::TooDark(0.0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Never stops.
    fn on() -> Result<(), AssemblyError> {
        Ok(())
    }

    fn exposure(codes: Vec<[f32; 3]>, seconds: f64) -> Exposure {
        Exposure { name: format!("`{seconds} s`"), codes: Raster::new(codes.len(), 1, codes), alpha: None, seconds }
    }

    fn settings(response: Response) -> Settings {
        Settings { weighting: Weighting::Course, ignore_below: 0.005, ignore_above: 0.92, response }
    }

    /// Photographs of these radiances by a camera of 8 bits.
    fn photographs(radiance: &[f64], encode: impl Fn(f64) -> f64, times: &[f64]) -> Exposures {
        let code = |light: f64| ((encode(light.min(1.0)) * 255.0).round() / 255.0) as f32;
        Exposures::new(times.iter().map(|time| exposure(radiance.iter().map(|light| [code(light * time); 3]).collect(), *time)).collect())
            .unwrap()
    }

    #[test]
    fn the_weights_are_those_of_their_sources() {
        for weighting in [Weighting::Course, Weighting::Hat] {
            assert_eq!([0.0, 0.5, 1.0].map(|z| weighting.weight(z)), [0.0, 1.0, 0.0]);
        }
        // The course asks for a slope of zero at both ends.
        assert!(Weighting::Course.weight(1e-4) < 1e-6 && Weighting::Course.weight(1.0 - 1e-4) < 1e-6);
        assert_eq!((Weighting::Hat.weight(0.25), Weighting::Uniform.weight(0.01)), (0.5, 1.0));
    }

    #[test]
    fn seven_exposures_two_stops_apart_give_five_decades_back() {
        let radiance: Vec<f64> = (0..200).map(|k| elementary::exp2(-16.0 + 16.0 * f64::from(k) / 199.0)).collect();
        let times = [1.0, 4.0, 16.0, 64.0, 256.0, 1024.0, 4096.0];
        for (response, encode) in [
            (Response::Srgb, color::srgb_encode as fn(f64) -> f64),
            (Response::Gamma(2.2), |light| elementary::pow(light, 1.0 / 2.2)),
            (Response::Linear, |light| light),
        ] {
            let found = assemble(&photographs(&radiance, encode, &times), &settings(response), on).unwrap();
            for (pixel, expected) in found.radiance.pixels().iter().zip(&radiance) {
                // The brightest fourteenth of the curve is not used in the shortest time.
                if *expected < 0.8 {
                    assert!((f64::from(pixel[0]) / expected - 1.0).abs() < 0.02, "{pixel:?} for {expected}");
                }
            }
            assert!(found.saturated_count < 5 && found.black_count == 0);
        }
    }

    #[test]
    fn the_mean_is_of_logarithms_by_weight() {
        let found = assemble::<AssemblyError>(
            &Exposures::new(vec![exposure(vec![[0.5; 3]], 1.0), exposure(vec![[0.75; 3]], 2.0)]).unwrap(),
            &Settings { weighting: Weighting::Hat, ..settings(Response::Linear) },
            on,
        );
        // (1 ln 0.5 + 0.5 ln 0.375) / 1.5.
        let expected = elementary::exp((elementary::ln(0.5) + 0.5 * elementary::ln(0.375)) / 1.5);
        assert!((f64::from(found.unwrap().radiance.pixel(0, 0)[0]) - expected).abs() < 1e-7);
    }

    #[test]
    fn saturated_and_black_pixels_are_bounds_and_are_counted() {
        let exposures = Exposures::new(vec![
            exposure(vec![[1.0; 3], [0.0; 3], [0.5; 3], [0.003; 3]], 0.5),
            exposure(vec![[1.0; 3], [0.0; 3], [1.0; 3], [1.0; 3]], 2.0),
        ]);
        let found = assemble(&exposures.unwrap(), &settings(Response::Linear), on).unwrap();
        // White at half a second is at least 2; black stays 0; between the two limits lies what no exposure shows well.
        let values: Vec<f32> = found.radiance.pixels().iter().map(|pixel| pixel[0]).collect();
        assert_eq!(values, [2.0, 0.0, 1.0, 0.5]);
        assert_eq!((found.saturated_count, found.black_count), (2, 1));
        assert_eq!(found.range.map(|range| range.map(|value| (value * 1e6).round() / 1e6)), Some([1.0, 1.0]));
    }

    #[test]
    fn what_a_photograph_does_not_show_is_not_counted() {
        let mut exposures = vec![exposure(vec![[0.5; 3], [0.0; 3]], 1.0), exposure(vec![[0.5; 3], [0.0; 3]], 2.0)];
        exposures[1].alpha = Some(Plane { width: 2, height: 1, values: vec![1.0, 0.0] });
        let found = assemble(&Exposures::new(exposures).unwrap(), &settings(Response::Linear), on).unwrap();
        assert_eq!((found.alpha.unwrap().values, found.black_count), (vec![1.0, 0.0], 0));
    }

    #[test]
    fn sets_that_are_none_are_refused_by_name() {
        let error = |exposures| Exposures::new(exposures).unwrap_err().to_string();
        assert!(error(vec![]).contains("too few exposures: 0"));
        assert!(error(vec![exposure(vec![[0.5; 3]], 1.0)]).contains("too few exposures: 1"));
        assert!(
            error(vec![exposure(vec![[0.5; 3]], 1.0), exposure(vec![[0.5; 3]; 2], 2.0)])
                .starts_with("`2 s` has 2 x 1 pixels, but `1 s` has 1 x 1")
        );
        for time in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(error(vec![exposure(vec![[0.5; 3]], time), exposure(vec![[0.5; 3]], 1.0)]).contains("above 0"));
        }
        let all = |code: f32| Exposures::new(vec![exposure(vec![[code; 3]], 1.0), exposure(vec![[code; 3]], 2.0)]).unwrap();
        for code in [0.0, 1.0, f32::NAN] {
            let message = assemble(&all(code), &settings(Response::Srgb), on).unwrap_err().to_string();
            assert!(message.contains("black or saturated (`1 s`, `2 s`)"), "{message}");
        }
    }
}

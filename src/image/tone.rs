//! From linear light to a picture: exposure, tone curve, display encoding, quantization.
//!
//! The chain is scale → operator → clamp to [0, 1] → encode → round. What is not a number becomes 0 and is
//! counted, infinity becomes white, negative light black. Knows no file; see `formats` for PNG and PPM.

use std::borrow::Cow;
use std::fmt;

use rayon::prelude::*;
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Deserializer, Serialize, Serializer, de};

use crate::image::color;
use crate::image::colormap::Colormap;
use crate::image::raster::{Image, Picture, PictureSamples, Raster};
use crate::math::elementary;
use crate::math::stream::{Purpose, Stream};

/// A tone curve; takes scaled linear light to [0, 1].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Operator {
    /// The value itself; what is above 1 is clipped.
    #[default]
    Linear,
    /// x / (1 + x) in each channel (Reinhard et al. 2002, eq. 3, without the key).
    Reinhard,
    /// x (1 + x / white²) / (1 + x) in each channel: `white` becomes 1 (Reinhard et al. 2002, eq. 4).
    ReinhardExtended,
    /// Hable's filmic curve (Uncharted 2, 2010) with exposure bias 2 and white 11.2, in each channel.
    Hable,
    /// Narkowicz's fit of the ACES curve (2016), in each channel, without his optional scale of 0.6.
    AcesNarkowicz,
    /// Hill's fit of ACES: reference rendering and output transform with their color matrices.
    AcesHill,
    /// AgX, base look, by Wrensch's fit; its output is display-encoded already, so there is no `gamma`.
    Agx,
    /// Khronos PBR neutral (2024): true to base colors up to 0.76, compresses and whitens above.
    Neutral,
}

impl Operator {
    /// Whether what it gives is encoded for the display already.
    pub fn is_display_encoded(self) -> bool {
        self == Self::Agx
    }

    /// The toned color of a scaled linear color without negative channels; may leave [0, 1] on both sides.
    ///
    /// `white` is what `reinhard-extended` takes to 1; the other operators do not look at it.
    pub fn toned(self, color: [f64; 3], white: f64) -> [f64; 3] {
        match self {
            Self::Linear => color,
            Self::Reinhard => color.map(|x| x / (1.0 + x)),
            Self::ReinhardExtended => color.map(|x| x * (1.0 + x / (white * white)) / (1.0 + x)),
            Self::Hable => color.map(|x| hable_curve(2.0 * x) / hable_curve(11.2)),
            Self::AcesNarkowicz => color.map(|x| x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14)),
            Self::AcesHill => aces_hill(color),
            Self::Agx => agx(color),
            Self::Neutral => neutral(color),
        }
    }
}

/// How bright the picture is made before the operator.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Exposure {
    /// Times 2 to this power.
    Stops(f64),
    /// So that a high percentile of the luminance becomes 1.
    Auto,
}

impl Default for Exposure {
    fn default() -> Self {
        Self::Stops(0.0)
    }
}

/// Stops beyond this in either direction leave the range of f32.
const MOST_STOPS: f64 = 128.0;

/// How linear values are encoded for the display.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Gamma {
    /// v to the power 1 / gamma.
    Power(f64),
    /// The curve of IEC 61966-2-1, near a gamma of 2.2.
    Srgb,
}

impl Gamma {
    /// The encoded value of a linear one in [0, 1].
    pub fn encode(self, v: f64) -> f64 {
        match self {
            Self::Power(gamma) => elementary::pow(v, 1.0 / gamma),
            Self::Srgb => color::srgb_encode(v),
        }
    }

    /// The linear value of an encoded one in [0, 1].
    pub fn decode(self, v: f64) -> f64 {
        match self {
            Self::Power(gamma) => elementary::pow(v, gamma),
            Self::Srgb => color::srgb_decode(v),
        }
    }
}

impl fmt::Display for Gamma {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Power(gamma) => write!(out, "{gamma}"),
            Self::Srgb => write!(out, "srgb"),
        }
    }
}

/// Gammas outside are mistakes, not wishes.
const GAMMA_RANGE: [f64; 2] = [0.1, 10.0];

/// Bits of each channel of a picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Bits {
    /// 0 to 255.
    #[default]
    Eight,
    /// 0 to 65535.
    Sixteen,
}

impl Bits {
    /// As a number.
    pub fn count(self) -> u8 {
        match self {
            Self::Eight => 8,
            Self::Sixteen => 16,
        }
    }

    /// The code of white.
    pub fn greatest_code(self) -> u16 {
        match self {
            Self::Eight => 255,
            Self::Sixteen => 65535,
        }
    }
}

/// What is done with alpha.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum AlphaTreatment {
    /// The image is laid over black, in linear light; the picture is opaque.
    #[default]
    OverBlack,
    /// The picture has the image's alpha (PNG shows it; PPM cannot and is black there).
    Keep,
}

/// Division by the brightest value before the exposure.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Normalization {
    /// None.
    #[default]
    None,
    /// By the greatest channel of all covered pixels, as the coursework's f / max(f).
    Max,
}

/// All choices of the chain.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ToneSettings {
    /// Division by the brightest value, first of all.
    pub normalize: Normalization,
    /// Exposure.
    pub exposure: Exposure,
    /// Percentile that `Exposure::Auto` takes to 1, in [0, 100].
    pub auto_percentile: f64,
    /// Tone curve.
    pub operator: Operator,
    /// What `reinhard-extended` takes to 1, after the exposure; above 0.
    pub white: f64,
    /// Display encoding; not looked at where the operator's output is encoded.
    pub gamma: Gamma,
    /// Scale of colors for the luminance of what the operator gives, in place of gamma.
    pub colormap: Option<Colormap>,
    /// Bits of each channel.
    pub bits: Bits,
    /// Seed of the noise that hides the steps of quantization; `None` for plain rounding.
    pub dither: Option<u64>,
    /// What is done with alpha.
    pub alpha: AlphaTreatment,
}

impl Default for ToneSettings {
    /// No exposure, linear, sRGB, 8 bits, over black.
    fn default() -> Self {
        Self {
            normalize: Normalization::None,
            exposure: Exposure::default(),
            auto_percentile: DEFAULT_AUTO_PERCENTILE,
            operator: Operator::Linear,
            white: DEFAULT_WHITE,
            gamma: Gamma::Srgb,
            colormap: None,
            bits: Bits::Eight,
            dither: None,
            alpha: AlphaTreatment::OverBlack,
        }
    }
}

/// Percentile of luminance that `Exposure::Auto` takes to 1 if nothing else is said.
pub const DEFAULT_AUTO_PERCENTILE: f64 = 99.0;
/// What `reinhard-extended` takes to 1 if nothing else is said.
pub const DEFAULT_WHITE: f64 = 4.0;

/// A picture and what was found and decided on the way.
#[derive(Debug, Clone, PartialEq)]
pub struct Developed {
    /// The picture.
    pub picture: Picture,
    /// The exposure in use, found or given, in stops; the normalization is not in it.
    pub exposure_stops: f64,
    /// The factor on linear light: 2 to the stops, over the greatest value if normalized by it.
    pub scale: f64,
    /// What was counted over the covered pixels.
    pub counts: Counts,
    /// Whether `Exposure::Auto` or `Normalization::Max` found no light and did nothing.
    pub is_black: bool,
}

/// Pixels of which something must be said; only those whose alpha is not 0.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Counts {
    /// All that are covered.
    pub covered: u64,
    /// With a channel that the operator gives above 1, so that it was clipped.
    pub clipped: u64,
    /// With a negative channel, shown as 0.
    pub negative: u64,
    /// With a channel that is not a number, shown as 0.
    pub not_a_number: u64,
}

impl Counts {
    fn plus(self, other: Self) -> Self {
        Self {
            covered: self.covered + other.covered,
            clipped: self.clipped + other.clipped,
            negative: self.negative + other.negative,
            not_a_number: self.not_a_number + other.not_a_number,
        }
    }
}

/// Makes a picture of an image; `check` is asked for each block of rows.
pub fn tone_map<E: Send>(image: &Image, settings: &ToneSettings, check: impl Fn() -> Result<(), E> + Sync) -> Result<Developed, E> {
    let is_covered = |index: usize| image.is_covered(index);
    let (scale, exposure_stops, is_black) = scale_of(&image.color, is_covered, settings);
    let developer = Developer { image, settings, scale, codes: EightBitCodes::new(settings.gamma) };
    let (samples, counts) = match settings.bits {
        Bits::Eight => {
            let (samples, counts) = developer.develop(|index, toned| developer.eight_bits(index, toned), &check)?;
            (PictureSamples::Eight(samples), counts)
        }
        Bits::Sixteen => {
            let (samples, counts) = developer.develop(|index, toned| developer.codes(index, toned), &check)?;
            (PictureSamples::Sixteen(samples), counts)
        }
    };
    let picture = Picture { width: image.color.width(), height: image.color.height(), samples, alpha: developer.alpha() };
    Ok(Developed { picture, exposure_stops, scale, counts, is_black })
}

/// The factor on linear light, the stops in it, and whether there was no light to find them by.
fn scale_of(raster: &Raster, is_covered: impl Fn(usize) -> bool + Copy, settings: &ToneSettings) -> (f64, f64, bool) {
    let greatest = match settings.normalize {
        Normalization::None => Some(1.0),
        Normalization::Max => greatest_channel(raster, is_covered),
    };
    let divisor = greatest.unwrap_or(1.0);
    let stops = match settings.exposure {
        Exposure::Stops(stops) => Some(stops),
        Exposure::Auto => percentile_of_luminance(raster, is_covered, settings.auto_percentile)
            .map(|luminance| elementary::log2(divisor / luminance).clamp(-MOST_STOPS, MOST_STOPS)),
    };
    let is_black = greatest.is_none() || stops.is_none();
    let stops = stops.unwrap_or(0.0);
    (elementary::exp2(stops) / divisor, stops, is_black)
}

/// The greatest finite channel of the covered pixels, if it is above 0.
fn greatest_channel(raster: &Raster, is_covered: impl Fn(usize) -> bool) -> Option<f64> {
    let covered = raster.pixels().iter().enumerate().filter(|(index, _)| is_covered(*index));
    let channels = covered.flat_map(|(_, color)| *color).filter(|v| v.is_finite());
    let greatest = channels.fold(0.0, f32::max);
    (greatest > 0.0).then_some(f64::from(greatest))
}

/// A percentile of luminance over the covered, finite pixels, if it is above 0.
///
/// Linear interpolation between order statistics: rank p / 100 (n - 1) from 0. Every pixel counts alike, also
/// those of a lat-long map near its poles.
fn percentile_of_luminance(raster: &Raster, is_covered: impl Fn(usize) -> bool, percentile: f64) -> Option<f64> {
    let covered = raster.pixels().iter().enumerate().filter(|(index, _)| is_covered(*index));
    let mut luminances: Vec<f64> = covered.map(|(_, color)| color::luminance(*color)).filter(|v| v.is_finite()).collect();
    let found = interpolated_order_statistic(&mut luminances, percentile / 100.0)?;
    (found > 0.0).then_some(found)
}

/// The value at rank `fraction` (n - 1), linearly between its neighbors; reorders `values`.
fn interpolated_order_statistic(values: &mut [f64], fraction: f64) -> Option<f64> {
    let rank = fraction * values.len().checked_sub(1)? as f64;
    let (_, &mut lower, above) = values.select_nth_unstable_by(rank as usize, f64::total_cmp);
    let upper = above.iter().copied().min_by(f64::total_cmp).unwrap_or(lower);
    Some(lower + (rank - rank.floor()) * (upper - lower))
}

/// Rows between two questions whether to go on.
const BLOCK_PIXELS: usize = 1 << 14;

struct Developer<'a> {
    image: &'a Image,
    settings: &'a ToneSettings,
    scale: f64,
    codes: EightBitCodes,
}

impl Developer<'_> {
    /// All pixels, each from its index and toned color by `quantized`, and what was counted.
    fn develop<T: Copy + Default + Send, E: Send>(
        &self,
        quantized: impl Fn(usize, [f64; 3]) -> [T; 3] + Sync,
        check: impl Fn() -> Result<(), E> + Sync,
    ) -> Result<(Vec<[T; 3]>, Counts), E> {
        let mut samples = vec![[T::default(); 3]; self.image.color.pixels().len()];
        let blocks = samples.par_chunks_mut(BLOCK_PIXELS).enumerate().map(|(block, samples)| {
            check()?;
            let mut counts = Counts::default();
            for (offset, sample) in samples.iter_mut().enumerate() {
                let index = block * BLOCK_PIXELS + offset;
                *sample = quantized(index, self.toned(index, &mut counts));
            }
            Ok(counts)
        });
        let counts = blocks.try_reduce(Counts::default, |one, other| Ok(one.plus(other)))?;
        Ok((samples, counts))
    }

    /// The color of a pixel after the operator, not yet clamped.
    fn toned(&self, index: usize, counts: &mut Counts) -> [f64; 3] {
        let color = self.image.color.pixels()[index];
        let coverage = self.image.alpha.as_ref().map_or(1.0, |alpha| alpha.values[index]);
        let shown = match self.settings.alpha {
            AlphaTreatment::OverBlack => f64::from(coverage),
            AlphaTreatment::Keep if coverage > 0.0 => 1.0,
            AlphaTreatment::Keep => 0.0,
        };
        // Black stays black under every operator but `agx`, whose black is a hair above 0.
        let light = color.map(|v| light(v) * (self.scale * shown));
        let toned = self.settings.operator.toned(light, self.settings.white);
        if coverage > 0.0 {
            counts.covered += 1;
            counts.clipped += u64::from(toned.iter().any(|v| *v > 1.0));
            counts.negative += u64::from(color.iter().any(|v| *v < 0.0));
            counts.not_a_number += u64::from(color.iter().any(|v| v.is_nan()));
        }
        toned
    }

    fn eight_bits(&self, index: usize, toned: [f64; 3]) -> [u8; 3] {
        let is_plain = self.settings.dither.is_none() && self.settings.colormap.is_none() && !self.settings.operator.is_display_encoded();
        if is_plain { toned.map(|v| self.codes.code(v)) } else { self.codes(index, toned).map(|code| code as u8) }
    }

    /// The codes of a pixel by the functions themselves.
    fn codes(&self, index: usize, toned: [f64; 3]) -> [u16; 3] {
        let greatest = f64::from(self.settings.bits.greatest_code());
        let encoded = self.encoded(toned);
        match self.settings.dither {
            None => encoded.map(|v| quantized(v, greatest, 0.0)),
            Some(seed) => {
                let mut generator = Stream::new(seed, Purpose::Dither).generator(index as u64);
                encoded.map(|v| {
                    let [one, other] = generator.uniform_pair();
                    quantized(v, greatest, one + other - 1.0)
                })
            }
        }
    }

    fn encoded(&self, toned: [f64; 3]) -> [f64; 3] {
        let clamped = toned.map(|v| v.clamp(0.0, 1.0));
        if let Some(colormap) = self.settings.colormap {
            let [r, g, b] = clamped;
            let [wr, wg, wb] = color::REC709_WEIGHTS;
            return colormap.color(wr * r + wg * g + wb * b).map(|code| f64::from(code) / 255.0);
        }
        if self.settings.operator.is_display_encoded() { clamped } else { clamped.map(|v| self.settings.gamma.encode(v)) }
    }

    fn alpha(&self) -> Option<Vec<u16>> {
        let greatest = f64::from(self.settings.bits.greatest_code());
        let kept = self.image.alpha.as_ref().filter(|_| self.settings.alpha == AlphaTreatment::Keep)?;
        Some(kept.values.iter().map(|&v| quantized(f64::from(v).clamp(0.0, 1.0), greatest, 0.0)).collect())
    }
}

/// A channel as light: not a number and negative are 0, infinity the largest f32.
fn light(v: f32) -> f64 {
    if v > 0.0 { f64::from(v.min(f32::MAX)) } else { 0.0 }
}

/// floor(greatest v + noise + 1/2), within the codes.
fn quantized(v: f64, greatest: f64, noise: f64) -> u16 {
    (greatest * v + noise + 0.5).floor().clamp(0.0, greatest) as u16
}

/// The 8-bit code of any linear value by comparison, without computing a power for each pixel.
///
/// Holds the least linear value of each code, so that the answer is that of encoding and rounding, and finds
/// it from a value's leading bits.
struct EightBitCodes {
    /// At q: the least value whose code is at least q; -infinity at 0 and +infinity behind the last.
    least: [f64; 257],
    /// Leading bits of the first bucket.
    first_bucket: u64,
    /// The code of the least value of each bucket.
    bucket_codes: Vec<u8>,
}

/// A bucket holds values that agree in sign, exponent and this many bits less than the mantissa has.
const BUCKET_SHIFT: u32 = 52 - 6;

impl EightBitCodes {
    fn new(gamma: Gamma) -> Self {
        let mut least = [f64::INFINITY; 257];
        least[0] = f64::NEG_INFINITY;
        for (code, value) in least.iter_mut().enumerate().take(256).skip(1) {
            *value = least_value(gamma, code as u16);
        }
        let first_bucket = least[1].to_bits() >> BUCKET_SHIFT;
        let last_bucket = 1.0_f64.to_bits() >> BUCKET_SHIFT;
        let code_at = |bucket: u64| {
            let value = f64::from_bits(bucket << BUCKET_SHIFT);
            (least.partition_point(|least| *least <= value) - 1) as u8
        };
        Self { least, first_bucket, bucket_codes: (first_bucket..=last_bucket).map(code_at).collect() }
    }

    /// The code of a linear value, clamped to [0, 1].
    fn code(&self, v: f64) -> u8 {
        let v = v.min(1.0);
        if v < self.least[1] {
            return 0;
        }
        let bucket = (v.to_bits() >> BUCKET_SHIFT) - self.first_bucket;
        let mut code = self.bucket_codes[bucket as usize];
        while v >= self.least[usize::from(code) + 1] {
            code += 1;
        }
        code
    }
}

/// The least linear value that is encoded and rounded to `code` or more.
fn least_value(gamma: Gamma, code: u16) -> f64 {
    let reaches = |v: f64| quantized(gamma.encode(v), 255.0, 0.0) >= code;
    // The inverse curve ends some roundings off; from there the edge is near.
    let mut value = gamma.decode((f64::from(code) - 0.5) / 255.0);
    while !reaches(value) {
        value = value.next_up();
    }
    while reaches(value.next_down()) {
        value = value.next_down();
    }
    value
}

fn hable_curve(v: f64) -> f64 {
    (v * (0.15 * v + 0.05) + 0.004) / (v * (0.15 * v + 0.5) + 0.06) - 1.0 / 15.0
}

type Matrix = [[f64; 3]; 3];

fn multiplied(matrix: &Matrix, v: [f64; 3]) -> [f64; 3] {
    matrix.map(|row| row[0] * v[0] + row[1] * v[1] + row[2] * v[2])
}

/// Linear sRGB to the space of the curve: XYZ, D65 to D60, ACEScg, desaturation of the reference rendering.
const ACES_INPUT: Matrix = [[0.59719, 0.35458, 0.04823], [0.076, 0.90834, 0.01566], [0.0284, 0.13383, 0.83777]];
/// From the curve back to linear sRGB.
const ACES_OUTPUT: Matrix = [[1.60475, -0.53108, -0.07367], [-0.10208, 1.10813, -0.00605], [-0.00327, -0.07276, 1.07602]];

fn aces_hill(color: [f64; 3]) -> [f64; 3] {
    let curve = |v: f64| (v * (v + 0.024_578_6) - 0.000_090_537) / (v * (0.983_729 * v + 0.432_951) + 0.238_081);
    multiplied(&ACES_OUTPUT, multiplied(&ACES_INPUT, color).map(curve))
}

/// Moves the primaries inwards, so that bright saturated light can go to white.
const AGX_INSET: Matrix = [
    [0.842_479_062_253_094, 0.078_433_599_999_999_2, 0.079_223_745_147_764_3],
    [0.042_328_242_261_012_3, 0.878_468_636_469_772, 0.079_166_127_460_543_3],
    [0.042_375_654_905_705_1, 0.078_433_6, 0.879_142_973_793_104],
];
/// Moves them out again, on encoded values.
const AGX_OUTSET: Matrix = [
    [1.196_879_005_120_17, -0.098_020_881_140_136_8, -0.099_029_744_079_720_5],
    [-0.052_896_851_757_456_2, 1.151_903_129_904_17, -0.098_961_176_844_843_3],
    [-0.052_971_635_514_443_8, -0.098_043_450_117_124_1, 1.151_073_672_641_16],
];
/// Base-two logarithms of the darkest and the brightest light.
const AGX_STOPS: [f64; 2] = [-12.473_93, 4.026_069];

fn agx(color: [f64; 3]) -> [f64; 3] {
    let [darkest, brightest] = AGX_STOPS;
    let curve = |v: f64| {
        // The smallest positive number stands for black, whose logarithm is none.
        let stops = elementary::log2(v.max(f64::MIN_POSITIVE)).clamp(darkest, brightest);
        let x = (stops - darkest) / (brightest - darkest);
        let x2 = x * x;
        let x4 = x2 * x2;
        15.5 * x4 * x2 - 40.14 * x4 * x + 31.96 * x4 - 6.868 * x2 * x + 0.4298 * x2 + 0.1191 * x - 0.00232
    };
    multiplied(&AGX_OUTSET, multiplied(&AGX_INSET, color).map(curve))
}

fn neutral(color: [f64; 3]) -> [f64; 3] {
    const COMPRESSION_START: f64 = 0.8 - 0.04;
    const DESATURATION: f64 = 0.15;
    let darkest = color[0].min(color[1]).min(color[2]);
    let offset = if darkest < 0.08 { darkest - 6.25 * darkest * darkest } else { 0.04 };
    let color = color.map(|v| v - offset);
    let peak = color[0].max(color[1]).max(color[2]);
    if peak < COMPRESSION_START {
        return color;
    }
    let d = 1.0 - COMPRESSION_START;
    let new_peak = 1.0 - d * d / (peak + d - COMPRESSION_START);
    let whiteness = 1.0 - 1.0 / (DESATURATION * (peak - new_peak) + 1.0);
    color.map(|v| (1.0 - whiteness) * (v * new_peak / peak) + whiteness * new_peak)
}

/// Reads a number or one word, and says what else would have been right.
struct NumberOr {
    word: &'static str,
    least: f64,
    greatest: f64,
}

impl de::Visitor<'_> for NumberOr {
    /// `None` for the word.
    type Value = Option<f64>;

    fn expecting(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "a number from {} to {} or `{}`", self.least, self.greatest, self.word)
    }

    fn visit_f64<E: de::Error>(self, number: f64) -> Result<Option<f64>, E> {
        let is_inside = (self.least..=self.greatest).contains(&number);
        if is_inside { Ok(Some(number)) } else { Err(E::invalid_value(de::Unexpected::Float(number), &self)) }
    }

    fn visit_u64<E: de::Error>(self, number: u64) -> Result<Option<f64>, E> {
        self.visit_f64(number as f64)
    }

    fn visit_i64<E: de::Error>(self, number: i64) -> Result<Option<f64>, E> {
        self.visit_f64(number as f64)
    }

    fn visit_str<E: de::Error>(self, word: &str) -> Result<Option<f64>, E> {
        if word == self.word { Ok(None) } else { Err(E::invalid_value(de::Unexpected::Str(word), &self)) }
    }
}

impl Serialize for Exposure {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Stops(stops) => serializer.serialize_f64(*stops),
            Self::Auto => serializer.serialize_str("auto"),
        }
    }
}

impl<'de> Deserialize<'de> for Exposure {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let visitor = NumberOr { word: "auto", least: -MOST_STOPS, greatest: MOST_STOPS };
        Ok(deserializer.deserialize_any(visitor)?.map_or(Self::Auto, Self::Stops))
    }
}

impl JsonSchema for Exposure {
    fn inline_schema() -> bool {
        true
    }

    fn schema_name() -> Cow<'static, str> {
        "Exposure".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({ "anyOf": [{ "type": "number", "minimum": -MOST_STOPS, "maximum": MOST_STOPS }, { "const": "auto" }] })
    }
}

impl Serialize for Gamma {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Power(gamma) => serializer.serialize_f64(*gamma),
            Self::Srgb => serializer.serialize_str("srgb"),
        }
    }
}

impl<'de> Deserialize<'de> for Gamma {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let visitor = NumberOr { word: "srgb", least: GAMMA_RANGE[0], greatest: GAMMA_RANGE[1] };
        Ok(deserializer.deserialize_any(visitor)?.map_or(Self::Srgb, Self::Power))
    }
}

impl JsonSchema for Gamma {
    fn inline_schema() -> bool {
        true
    }

    fn schema_name() -> Cow<'static, str> {
        "Gamma".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        let [least, greatest] = GAMMA_RANGE;
        json_schema!({ "anyOf": [{ "type": "number", "minimum": least, "maximum": greatest }, { "const": "srgb" }] })
    }
}

impl Serialize for Bits {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_u8(self.count())
    }
}

impl<'de> Deserialize<'de> for Bits {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        match u64::deserialize(deserializer)? {
            8 => Ok(Self::Eight),
            16 => Ok(Self::Sixteen),
            other => Err(de::Error::invalid_value(de::Unexpected::Unsigned(other), &"8 or 16")),
        }
    }
}

impl JsonSchema for Bits {
    fn inline_schema() -> bool {
        true
    }

    fn schema_name() -> Cow<'static, str> {
        "Bits".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({ "type": "integer", "enum": [8, 16] })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::raster::Plane;
    use std::convert::Infallible;

    const OPERATORS: [Operator; 8] = [
        Operator::Linear,
        Operator::Reinhard,
        Operator::ReinhardExtended,
        Operator::Hable,
        Operator::AcesNarkowicz,
        Operator::AcesHill,
        Operator::Agx,
        Operator::Neutral,
    ];

    fn developed(image: &Image, settings: &ToneSettings) -> Developed {
        tone_map(image, settings, || Ok::<(), Infallible>(())).unwrap()
    }

    fn eight(developed: &Developed) -> &[[u8; 3]] {
        match &developed.picture.samples {
            PictureSamples::Eight(samples) => samples,
            PictureSamples::Sixteen(_) => panic!("eight bits were asked for"),
        }
    }

    fn sixteen(developed: &Developed) -> &[[u16; 3]] {
        match &developed.picture.samples {
            PictureSamples::Sixteen(samples) => samples,
            PictureSamples::Eight(_) => panic!("sixteen bits were asked for"),
        }
    }

    fn grey_image(values: &[f32]) -> Image {
        Image::opaque(Raster::new(values.len(), 1, values.iter().map(|v| [*v; 3]).collect()))
    }

    #[test]
    fn middle_grey_has_the_published_value_under_every_operator() {
        let published = [
            (Operator::Linear, 0.18),
            (Operator::Reinhard, 0.152_542),
            (Operator::Hable, 0.128_338),
            (Operator::AcesNarkowicz, 0.266_899),
            (Operator::AcesHill, 0.105_591),
            (Operator::Neutral, 0.14),
            (Operator::Agx, 0.496_676),
        ];
        for (operator, expected) in published {
            let [red, green, blue] = operator.toned([0.18; 3], DEFAULT_WHITE);
            assert!((red - expected).abs() < 6e-7, "{operator:?}: {red} for {expected}");
            // The rows of the matrices of `aces-hill` and `agx` do not sum to one exactly.
            assert!((green - red).abs() < 1e-4 && (blue - red).abs() < 1e-4, "{operator:?}: {green} {blue}");
        }
    }

    #[test]
    fn encoded_middle_grey_has_the_published_codes() {
        assert!((Gamma::Power(2.2).encode(0.18) - 0.458_656).abs() < 5e-7);
        for (gamma, code) in [(Gamma::Power(2.2), 117), (Gamma::Srgb, 118), (Gamma::Power(1.0), 46)] {
            let settings = ToneSettings { gamma, ..ToneSettings::default() };
            assert_eq!(eight(&developed(&grey_image(&[0.18]), &settings)), [[code; 3]], "{gamma}");
        }
    }

    #[test]
    fn reinhard_extended_takes_white_to_one() {
        let [white, ..] = Operator::ReinhardExtended.toned([7.5; 3], 7.5);
        assert!((white - 1.0).abs() < 1e-15);
    }

    #[test]
    fn neutral_keeps_base_colors_and_whitens_bright_ones() {
        // Up to 0.76 only the offset of 0.04 is taken off.
        assert_eq!(Operator::Neutral.toned([0.5, 0.3, 0.1], 1.0), [0.46, 0.26, 0.060_000_000_000_000_005]);
        let [r, g, b] = Operator::Neutral.toned([50.0, 20.0, 10.0], 1.0);
        assert!(r < 1.0 && r > g && g > b && b > 0.8, "{r} {g} {b}");
    }

    #[test]
    fn brighter_light_is_never_shown_darker() {
        for operator in OPERATORS {
            let mut before = -1.0;
            for step in 0..4000 {
                let v = elementary::exp2(f64::from(step) / 100.0 - 20.0);
                let shown = operator.toned([v; 3], DEFAULT_WHITE)[1].clamp(0.0, 1.0);
                // The polynomial of AgX is flat at its lower end within its own precision.
                assert!(shown >= before - if operator == Operator::Agx { 2e-3 } else { 1e-12 }, "{operator:?} at {v}");
                before = shown;
            }
        }
    }

    #[test]
    fn the_table_of_codes_is_encoding_and_rounding() {
        for gamma in [0.1, 0.45, 1.0, 1.8, 2.1, 2.2, 2.5, 3.0, 10.0].map(Gamma::Power).into_iter().chain([Gamma::Srgb]) {
            let codes = EightBitCodes::new(gamma);
            let direct = |v: f64| quantized(gamma.encode(v.clamp(0.0, 1.0)), 255.0, 0.0) as u8;
            let edges = codes.least[1..256].iter().flat_map(|v| [v.next_down(), *v, v.next_up()]);
            let steps = (0..40_000).map(|i| f64::from(i) / 39_999.0);
            let octaves = (0..20_000).map(|i| elementary::exp2(f64::from(i) / -200.0));
            let beyond = [0.0, -0.0, -1.0, 1.0, 1.5, 1e300, f64::MIN_POSITIVE, f64::INFINITY];
            for v in edges.chain(steps).chain(octaves).chain(beyond) {
                assert_eq!(codes.code(v), direct(v), "{gamma} at {v:e}");
            }
        }
    }

    #[test]
    fn one_stop_doubles_the_light() {
        let settings = ToneSettings { exposure: Exposure::Stops(1.0), gamma: Gamma::Power(1.0), ..ToneSettings::default() };
        let result = developed(&grey_image(&[0.1, 0.5, 0.6]), &settings);
        assert_eq!(eight(&result), [[51; 3], [255; 3], [255; 3]]);
        assert_eq!((result.scale, result.counts.clipped), (2.0, 1));
    }

    #[test]
    fn the_coursework_divides_by_the_greatest_channel_first() {
        let image = Image::opaque(Raster::new(2, 1, vec![[2.0, 1.0, 0.0], [0.5, 8.0, 1.0]]));
        let settings = ToneSettings { normalize: Normalization::Max, gamma: Gamma::Power(1.0), ..ToneSettings::default() };
        assert_eq!(eight(&developed(&image, &settings)), [[64, 32, 0], [16, 255, 32]]);
    }

    #[test]
    fn auto_exposure_takes_the_percentile_to_one() {
        // 101 greys 0, 1, … 100: the 99th percentile is 99 and the 98.5th lies half-way below it.
        let image = grey_image(&(0..=100).map(|v| v as f32).collect::<Vec<_>>());
        for (percentile, value) in [(99.0, 99.0), (98.5, 98.5), (100.0, 100.0)] {
            let settings = ToneSettings { exposure: Exposure::Auto, auto_percentile: percentile, ..ToneSettings::default() };
            let result = developed(&image, &settings);
            // Luminance weights sum to one within a rounding.
            assert!((result.scale * value - 1.0).abs() < 1e-12, "{percentile}: {}", result.scale);
            assert!((elementary::exp2(result.exposure_stops) - result.scale).abs() < 1e-15);
        }
    }

    #[test]
    fn auto_exposure_does_not_look_where_alpha_is_zero() {
        let mut image = grey_image(&[1e6, 0.25, 0.25]);
        image.alpha = Some(Plane { width: 3, height: 1, values: vec![0.0, 1.0, 1.0] });
        let result = developed(&image, &ToneSettings { exposure: Exposure::Auto, ..ToneSettings::default() });
        assert!((result.exposure_stops - 2.0).abs() < 1e-12, "{}", result.exposure_stops);
        assert_eq!(eight(&result), [[0; 3], [255; 3], [255; 3]]);
    }

    #[test]
    fn a_black_image_stays_as_it_is_and_says_so() {
        for settings in [
            ToneSettings { exposure: Exposure::Auto, ..ToneSettings::default() },
            ToneSettings { normalize: Normalization::Max, ..ToneSettings::default() },
        ] {
            let result = developed(&grey_image(&[0.0, 0.0]), &settings);
            assert!(result.is_black);
            assert_eq!(eight(&result), [[0; 3]; 2]);
        }
        assert!(developed(&grey_image(&[]), &ToneSettings { exposure: Exposure::Auto, ..ToneSettings::default() }).is_black);
    }

    #[test]
    fn what_is_no_light_has_its_rule_and_is_counted() {
        for operator in OPERATORS {
            let image = grey_image(&[f32::NAN, f32::INFINITY, -1.0, f32::NEG_INFINITY, f32::MAX]);
            let result = developed(&image, &ToneSettings { operator, exposure: Exposure::Stops(128.0), ..ToneSettings::default() });
            let shown = eight(&result);
            let black = operator.toned([0.0; 3], DEFAULT_WHITE).map(|v| quantized(v, 255.0, 0.0) as u8);
            assert_eq!([shown[0], shown[2], shown[3]], [black; 3], "{operator:?}");
            // Wrensch's polynomial ends a hair below 1, at 0.9945.
            assert!(shown[1][0] >= 253 && shown[1] == shown[4], "{operator:?}: {:?}", shown[1]);
            assert_eq!((result.counts.covered, result.counts.negative, result.counts.not_a_number), (5, 2, 1));
        }
    }

    #[test]
    fn alpha_is_laid_over_black_or_kept() {
        let mut image = grey_image(&[1.0, 1.0]);
        image.alpha = Some(Plane { width: 2, height: 1, values: vec![0.0, 0.5] });
        let linear = ToneSettings { gamma: Gamma::Power(1.0), ..ToneSettings::default() };
        let over = developed(&image, &linear);
        assert_eq!((eight(&over), &over.picture.alpha), (&[[0; 3], [128; 3]][..], &None));
        let kept = developed(&image, &ToneSettings { alpha: AlphaTreatment::Keep, ..linear });
        assert_eq!((eight(&kept), &kept.picture.alpha), (&[[0; 3], [255; 3]][..], &Some(vec![0, 128])));
    }

    #[test]
    fn sixteen_bits_are_rounded_to_the_nearest_code() {
        let settings = ToneSettings { bits: Bits::Sixteen, gamma: Gamma::Power(1.0), ..ToneSettings::default() };
        assert_eq!(sixteen(&developed(&grey_image(&[0.0, 0.25, 1.0]), &settings)), [[0; 3], [16384; 3], [65535; 3]]);
    }

    #[test]
    fn dither_keeps_the_mean_that_rounding_loses() {
        let value = 0.3 / 255.0 + 100.0 / 255.0;
        let image = Image::opaque(Raster::filled(200, 200, [value as f32; 3]));
        let plain = ToneSettings { gamma: Gamma::Power(1.0), ..ToneSettings::default() };
        let dithered = ToneSettings { dither: Some(7), ..plain };
        assert!(eight(&developed(&image, &plain)).iter().all(|sample| *sample == [100; 3]));
        let result = developed(&image, &dithered);
        let sum: f64 = eight(&result).iter().flatten().map(|code| f64::from(*code)).sum();
        // Noise of variance 1/6 and rounding of at most 1/12 more, over 120 000 codes: five standard errors.
        assert!((sum / 120_000.0 - 100.3).abs() < 5.0 * 0.5 / 120_000.0_f64.sqrt(), "{}", sum / 120_000.0);
        assert_eq!(result, developed(&image, &dithered));
        assert_ne!(result, developed(&image, &ToneSettings { dither: Some(8), ..plain }));
    }

    #[test]
    fn a_colormap_shows_luminance() {
        let settings = ToneSettings { colormap: Some(Colormap::Magma), ..ToneSettings::default() };
        let result = developed(&grey_image(&[0.0, 1.0]), &settings);
        assert_eq!(eight(&result), [[0, 0, 4], [252, 253, 191]]);
    }

    #[test]
    fn words_and_numbers_are_read_back_as_written() {
        for (text, expected) in [("2.2", Gamma::Power(2.2)), ("1", Gamma::Power(1.0)), ("srgb", Gamma::Srgb)] {
            let gamma: Gamma = serde_yaml::from_str(text).unwrap();
            assert_eq!(gamma, expected);
            assert_eq!(serde_yaml::from_value::<Gamma>(serde_yaml::to_value(gamma).unwrap()).unwrap(), expected);
        }
        assert_eq!(serde_yaml::from_str::<Exposure>("-3").unwrap(), Exposure::Stops(-3.0));
        assert_eq!(serde_yaml::from_str::<Exposure>("auto").unwrap(), Exposure::Auto);
        assert!(serde_yaml::from_str::<Gamma>("0").unwrap_err().to_string().contains("a number from 0.1 to 10 or `srgb`"));
        assert!(serde_yaml::from_str::<Bits>("12").unwrap_err().to_string().contains("8 or 16"));
    }
}

//! The kind `tone-map`; the mathematics is in `image::tone`.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::engine::artifact::Artifact;
use crate::engine::job::Job;
use crate::engine::parameter::{Port, Seed};
use crate::engine::stage::{InputSizes, Mistake, ResultDeclaration, Stage, StageError};
use crate::figure::table::{Cell, Column, Table};
use crate::image::colormap::Colormap;
use crate::image::raster::Picture;
use crate::image::tone::{self, AlphaTreatment, Bits, Developed, Exposure, Gamma, Normalization, Operator, ToneSettings};
use crate::stages::rasters::LinearRaster;

/// Makes a picture for a display of linear light.
///
/// The chain is: divide by the maximum (`normalize`), times 2^`exposure_stops`, `operator`, clamp to [0, 1], encode
/// (`gamma`), round to `bits`. What is not a number is shown as 0 and counted, infinity as white, negative light as
/// 0. The result `.settings` is a table of one row with what was used and how many pixels were clipped.
///
/// ```yaml
/// picture: { tone-map: { of: sphere, exposure_stops: 1, gamma: srgb }, save: png }
/// ```
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ToneMap {
    /// The image or environment map to show.
    pub of: Port<LinearRaster>,
    /// Division by the greatest channel before the exposure, as the coursework's f / max(f).
    #[serde(default)]
    pub normalize: Normalization,
    /// Exposure in stops, from -128 to 128; or `auto`: the 99th percentile of luminance becomes 1.
    ///
    /// The percentile is over pixels whose alpha is not 0 and interpolates linearly between order statistics
    /// (rank p / 100 (n - 1)); pixels of a lat-long map count alike at poles and horizon.
    #[serde(default)]
    #[schemars(extend("x-unit" = "stops"))]
    pub exposure_stops: Exposure,
    /// Another percentile for `exposure_stops: auto`, from 0 to 100; 99 by default.
    #[serde(default)]
    #[schemars(range(min = 0, max = 100), extend("x-unit" = "%"))]
    pub auto_percentile: Option<f64>,
    /// The tone curve.
    #[serde(default)]
    pub operator: Operator,
    /// What `reinhard-extended` takes to 1, after the exposure; 4 by default.
    #[serde(default)]
    #[schemars(extend("exclusiveMinimum" = 0, "maximum" = 1e9))]
    pub white: Option<f64>,
    /// Display encoding: v^(1 / gamma) for a number from 0.1 to 10, or `srgb` (IEC 61966-2-1), the default.
    ///
    /// Not with `operator: agx`, whose output is encoded already, nor with `colormap`.
    #[serde(default)]
    pub gamma: Option<Gamma>,
    /// False colors for the luminance of what the operator gives, from 0 to 1; for error maps.
    #[serde(default)]
    pub colormap: Option<Colormap>,
    /// Bits of each channel, 8 or 16; a code is floor((2^bits - 1) v + 1/2).
    #[serde(default)]
    pub bits: Bits,
    /// Adds seeded noise, triangular over one code to both sides, before rounding, so that no bands show.
    #[serde(default)]
    pub dither: bool,
    /// Whether the image is laid over black or keeps its alpha.
    #[serde(default)]
    pub alpha: AlphaTreatment,
    /// Seed of the dither; by default the pipeline's.
    #[serde(default)]
    pub seed: Seed,
}

impl Stage for ToneMap {
    const KIND: &'static str = "tone-map";
    const VERSION: u32 = 1;
    const RESULTS: &'static [ResultDeclaration] =
        &[ResultDeclaration { name: "", types: &[Picture::TYPE] }, ResultDeclaration { name: "settings", types: &[Table::TYPE] }];
    type Output = (Picture, Table);

    fn draws(&self) -> bool {
        self.dither
    }

    fn mistakes(&self) -> Vec<Mistake> {
        let rules = [
            (
                self.gamma.is_some() && self.operator.is_display_encoded(),
                "gamma",
                "`agx` gives encoded values already",
                "leave `gamma` out",
            ),
            (self.gamma.is_some() && self.colormap.is_some(), "gamma", "the colors of `colormap` are encoded already", "leave `gamma` out"),
            (
                self.white.is_some() && self.operator != Operator::ReinhardExtended,
                "white",
                "only `reinhard-extended` has a white",
                "leave `white` out, or use that operator",
            ),
            (
                self.auto_percentile.is_some() && self.exposure_stops != Exposure::Auto,
                "auto_percentile",
                "the exposure is given, not found",
                "use `exposure_stops: auto`",
            ),
            (
                self.normalize != Normalization::None && self.exposure_stops == Exposure::Auto,
                "normalize",
                "`exposure_stops: auto` finds the scale itself",
                "use one of the two",
            ),
        ];
        let broken = rules.into_iter().filter(|(is_broken, ..)| *is_broken);
        broken.map(|(_, field, message, hint)| Mistake { field: field.into(), message: message.into(), hint: Some(hint.into()) }).collect()
    }

    fn memory(&self, inputs: &InputSizes) -> u64 {
        // An environment map is copied, and `auto` sorts one f64 for each 12 bytes of color.
        2 * inputs.values().sum::<u64>()
    }

    fn run(&self, job: &Job<'_>) -> Result<(Picture, Table), StageError> {
        let image = job.input(&self.of)?;
        let settings = self.settings(job.seed(self.seed));
        let developed = tone::tone_map(&image, &settings, || job.check())?;
        if developed.is_black {
            job.warn("the input is black; no exposure was found and none was used");
        }
        if developed.counts.not_a_number > 0 {
            job.warn(format!("{} pixels are not a number and shown as 0", developed.counts.not_a_number));
        }
        let table = self.table(&developed);
        Ok((developed.picture, table))
    }
}

impl ToneMap {
    fn settings(&self, seed: u64) -> ToneSettings {
        ToneSettings {
            normalize: self.normalize,
            exposure: self.exposure_stops,
            auto_percentile: self.auto_percentile.unwrap_or(tone::DEFAULT_AUTO_PERCENTILE),
            operator: self.operator,
            white: self.white.unwrap_or(tone::DEFAULT_WHITE),
            gamma: self.gamma.unwrap_or(Gamma::Srgb),
            colormap: self.colormap,
            bits: self.bits,
            dither: self.dither.then_some(seed),
            alpha: self.alpha,
        }
    }

    /// One row: what was used, and what was counted over the pixels whose alpha is not 0.
    fn table(&self, developed: &Developed) -> Table {
        let gamma = match self.gamma.unwrap_or(Gamma::Srgb) {
            _ if self.operator.is_display_encoded() || self.colormap.is_some() => Cell::Empty,
            Gamma::Power(gamma) => Cell::Number(gamma),
            Gamma::Srgb => Cell::Text("srgb".into()),
        };
        let white = (self.operator == Operator::ReinhardExtended).then(|| self.white.unwrap_or(tone::DEFAULT_WHITE));
        let count = |count: u64| Cell::Integer(count.into());
        let cells = [
            ("operator", "", word(&self.operator)),
            ("normalize", "", word(&self.normalize)),
            ("exposure_stops", "stops", Cell::Number(developed.exposure_stops)),
            ("scale", "", Cell::Number(developed.scale)),
            ("white", "", white.map_or(Cell::Empty, Cell::Number)),
            ("gamma", "", gamma),
            ("colormap", "", self.colormap.as_ref().map_or(Cell::Empty, word)),
            ("bits", "bit", count(self.bits.count().into())),
            ("dither", "", Cell::Boolean(self.dither)),
            ("alpha", "", word(&self.alpha)),
            ("covered_pixels", "px", count(developed.counts.covered)),
            ("clipped_pixels", "px", count(developed.counts.clipped)),
            ("negative_pixels", "px", count(developed.counts.negative)),
            ("not_a_number_pixels", "px", count(developed.counts.not_a_number)),
        ];
        let mut table = Table::new(cells.iter().map(|(name, unit, _)| Column::new(*name, *unit)).collect());
        table.push(cells.into_iter().map(|(_, _, cell)| cell).collect());
        table
    }
}

/// The word of a choice as it is written in pipelines.
fn word(choice: &impl Serialize) -> Cell {
    let json = serde_json::to_value(choice).expect("a choice is plain text");
    Cell::Text(json.as_str().unwrap_or_default().into())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::artifact::AnyArtifact;
    use crate::image::raster::{Image, PictureSamples, Raster};
    use crate::light::envmap::EnvMap;
    use crate::stages::rasters::trial;

    fn run(text: &str, artifact: AnyArtifact) -> (PictureSamples, Table, Vec<String>) {
        let (results, warnings) = trial::run::<ToneMap>(text, [("a", vec![artifact])]);
        let results = results.unwrap();
        let picture = results[0].get::<Picture>().unwrap();
        (picture.samples.clone(), (*results[1].get::<Table>().unwrap()).clone(), warnings)
    }

    fn grey(v: f32) -> AnyArtifact {
        AnyArtifact::new(Image::opaque(Raster::filled(2, 1, [v; 3])))
    }

    fn cell(table: &Table, name: &str) -> Cell {
        table.rows[0][table.column(name).unwrap()].clone()
    }

    #[test]
    fn a_picture_comes_with_what_was_used() {
        let (samples, table, warnings) = run("{ of: a, exposure_stops: -1, gamma: 2.2 }", grey(0.36));
        assert_eq!(samples, PictureSamples::Eight(vec![[117; 3]; 2]));
        assert_eq!(cell(&table, "operator"), Cell::Text("linear".into()));
        assert_eq!(cell(&table, "exposure_stops"), Cell::Number(-1.0));
        assert_eq!(cell(&table, "gamma"), Cell::Number(2.2));
        assert_eq!(cell(&table, "clipped_pixels"), Cell::Integer(0));
        assert!(warnings.is_empty());
    }

    #[test]
    fn a_found_exposure_is_told() {
        let (_, table, _) = run("{ of: a, exposure_stops: auto }", grey(0.125));
        let Cell::Number(stops) = cell(&table, "exposure_stops") else { panic!("a number of stops") };
        assert!((stops - 3.0).abs() < 1e-12, "{stops}");
    }

    #[test]
    fn environment_maps_are_shown_like_images() {
        let map = AnyArtifact::new(EnvMap::new(Raster::filled(2, 1, [0.18; 3])));
        assert_eq!(run("{ of: a }", map).0, run("{ of: a }", grey(0.18)).0);
    }

    #[test]
    fn what_was_no_number_is_told() {
        let (_, table, warnings) = run("{ of: a }", grey(f32::NAN));
        assert_eq!(warnings, ["2 pixels are not a number and shown as 0"]);
        assert_eq!(cell(&table, "not_a_number_pixels"), Cell::Integer(2));
        assert_eq!(run("{ of: a, normalize: max }", grey(0.0)).2.len(), 1);
    }

    #[test]
    fn only_dither_draws() {
        assert!(!trial::parsed::<ToneMap>("{ of: a }").unwrap().draws());
        assert!(trial::parsed::<ToneMap>("{ of: a, dither: true }").unwrap().draws());
    }

    #[test]
    fn choices_that_exclude_each_other_are_mistakes() {
        let mistakes = |text: &str| trial::mistakes::<ToneMap>(text);
        assert_eq!(mistakes("{ of: a, operator: agx, gamma: srgb }"), ["gamma: `agx` gives encoded values already"]);
        assert_eq!(mistakes("{ of: a, white: 2, auto_percentile: 95 }").len(), 2);
        assert_eq!(mistakes("{ of: a, normalize: max, exposure_stops: auto }").len(), 1);
        assert!(mistakes("{ of: a, operator: reinhard-extended, white: 2, gamma: srgb, normalize: max, exposure_stops: -2.9 }").is_empty());
    }

    #[test]
    fn all_parameters_go_to_json_and_back() {
        let text = "{ of: a, exposure_stops: auto, auto_percentile: 95, operator: hable, gamma: 2.5, bits: 16, dither: true, alpha: keep, seed: 3 }";
        let json = trial::parsed::<ToneMap>(text).unwrap().parameters();
        assert_eq!(trial::parsed::<ToneMap>(&json.to_string().replace("null", "~")).unwrap().parameters(), json);
        assert_eq!((&json["bits"], &json["exposure_stops"], &json["gamma"]), (&16.into(), &"auto".into(), &2.5.into()));
    }

    #[test]
    fn a_wrong_bit_count_or_gamma_is_refused_with_the_right_ones() {
        let message = |text: &str| trial::parsed::<ToneMap>(text).err().unwrap();
        assert!(message("{ of: a, bits: 12 }").contains("8 or 16"));
        assert!(message("{ of: a, gamma: rgb }").contains("`srgb`"));
    }
}

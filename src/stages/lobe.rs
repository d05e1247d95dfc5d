//! The kind `lobe`.

use std::num::NonZeroU32;

use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::engine::artifact::AnyArtifact;
use crate::engine::job::Job;
use crate::engine::parameter::Seed;
use crate::engine::stage::{Mistake, ResultDeclaration, Stage, StageError};
use crate::figure::bitmap::Bitmap;
use crate::figure::sheet::{self, Sheet};
use crate::figure::table::{Cell, Column, Table};
use crate::image::colormap::Colormap;
use crate::image::raster::Picture;
use crate::math::elementary;
use crate::render::bsdf::disney::Gtr1;
use crate::render::bsdf::material::Material;
use crate::render::bsdf::measure::{View, outgoing_at};
use crate::render::bsdf::microfacet::{FacetDistribution, Facets, Masking, NormalSampling};
use crate::render::bsdf::{BsdfDescription, DirectionSampling};
use crate::render::medium::phase::PhaseDescription;
use crate::render::scatter::{Cells, Count, Scatter, Scattering, Survey, Warp};
use crate::render::texture::TexturePoint;

/// Measures how a BSDF, a phase function or a warp scatters light, and whether it draws directions by the density that it tells.
///
/// The first result is a slice of the lobe in the plane of incidence: `angle_deg` from the normal, positive on the side
/// to which a mirror reflects (beyond 90 degrees below the surface), `r`, `g`, `b` of value times cosine, and `pdf`. `cells`
/// has the expected and the drawn number of directions of every cell of a grid of equal solid angles, and `picture` shows
/// both side by side. `test` is the chi-square test of them. `albedo` has the share of light that is scattered, by
/// the angle of the outgoing direction: by integration (delta lobes apart) and as the mean weight of drawn directions.
/// Of a phase function, light comes out at `outgoing_degrees` and directions are those from which it came: `g` > 0 has its peak opposite.
///
/// ```yaml
/// gold: { lobe: { of: { bsdf: { rough-conductor: { metal: gold, alpha: 0.2 } } }, outgoing_degrees: 60 }, save: { picture: png, test: csv } }
/// ```
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Lobe {
    /// What is measured. Textures are asked at u = v = 0; a picture file cannot be read here.
    pub of: Measured,
    /// Angle between the outgoing direction and the normal; beyond 90 from behind. Default 45. Without meaning for a warp.
    #[serde(default = "usual_angle")]
    #[schemars(range(min = 0, max = 180), extend("x-unit" = "degrees"))]
    pub outgoing_degrees: f64,
    /// Directions that are drawn. Default 100000.
    #[serde(default = "usual_draws")]
    #[schemars(range(min = 100, max = 100_000_000))]
    pub draws: u32,
    /// Rows of cells from pole to pole, or to the horizon; there are twice as many columns. Default 30.
    #[serde(default = "usual_rows")]
    #[schemars(range(min = 2, max = 500))]
    pub rows: NonZeroU32,
    /// Distance of the angles of the slice and, ten times as far, of the albedo. Default 0.5.
    #[serde(default = "usual_step")]
    #[schemars(range(min = 0.01, max = 5), extend("x-unit" = "degrees"))]
    pub step_degrees: f64,
    /// Another seed draws other directions; by default the pipeline's.
    #[serde(default)]
    pub seed: Seed,
}

fn usual_angle() -> f64 {
    45.0
}

fn usual_draws() -> u32 {
    100_000
}

fn usual_rows() -> NonZeroU32 {
    NonZeroU32::new(30).expect("not zero")
}

fn usual_step() -> f64 {
    0.5
}

/// What draws directions.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
#[expect(clippy::large_enum_variant, reason = "a scene has few, and most are of the large variants")]
pub enum Measured {
    /// A BSDF, as in a scene.
    Bsdf(BsdfDescription),
    /// A phase function, as in a scene's media.
    Phase(PhaseDescription),
    /// A map of the unit square to directions.
    Warp(WarpDescription),
}

/// Maps of the unit square to directions.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum WarpDescription {
    /// All directions alike.
    UniformSphere,
    /// By the cosine to the normal, of a square laid on the disk without folds (Shirley and Chiu 1997).
    CosineHemisphere,
    /// By the cosine to the normal, in polar coordinates.
    PolarCosineHemisphere,
    /// Normals of the facets of GGX (GTR2): by D cos.
    Ggx(Width),
    /// Normals of the facets of Beckmann: by D cos.
    Beckmann(Width),
    /// Normals of the clear coat of `disney` (Burley 2012): by D cos.
    Gtr1(CoatWidth),
}

/// Of a distribution of normals.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Width {
    /// Width of the distribution of slopes.
    #[schemars(range(min = 0.001, max = 1))]
    pub alpha: f32,
}

/// Of a clear coat's normals.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CoatWidth {
    /// Width of the distribution, below 1.
    #[schemars(range(min = 0.001, max = 0.99))]
    pub alpha: f32,
}

impl WarpDescription {
    fn compiled(self) -> Warp {
        let normals = |distribution, Width { alpha }| {
            Warp::Normals(Facets { distribution, masking: Masking::default(), sampling: NormalSampling::AllNormals, alpha })
        };
        match self {
            Self::UniformSphere => Warp::UniformSphere,
            Self::CosineHemisphere => Warp::CosineHemisphere,
            Self::PolarCosineHemisphere => Warp::PolarCosineHemisphere,
            Self::Ggx(width) => normals(FacetDistribution::Ggx, width),
            Self::Beckmann(width) => normals(FacetDistribution::Beckmann, width),
            Self::Gtr1(CoatWidth { alpha }) => Warp::CoatNormals(Gtr1::new(alpha)),
        }
    }
}

impl Stage for Lobe {
    const KIND: &'static str = "lobe";
    const VERSION: u32 = 1;
    const RESULTS: &'static [ResultDeclaration] = &[
        ResultDeclaration { name: "", types: &["table"] },
        ResultDeclaration { name: "cells", types: &["table"] },
        ResultDeclaration { name: "picture", types: &["picture"] },
        ResultDeclaration { name: "test", types: &["table"] },
        ResultDeclaration { name: "albedo", types: &["table"] },
    ];
    type Output = Vec<AnyArtifact>;

    fn draws(&self) -> bool {
        true
    }

    fn mistakes(&self) -> Vec<Mistake> {
        let Measured::Bsdf(description) = &self.of else { return Vec::new() };
        let error = Material::new(description, DirectionSampling::Bsdf).err();
        error.map(|error| Mistake { field: "of".into(), message: error.to_string(), hint: None }).into_iter().collect()
    }

    fn run(&self, job: &Job<'_>) -> Result<Self::Output, StageError> {
        match &self.of {
            Measured::Bsdf(description) => {
                let material = Material::new(description, DirectionSampling::Bsdf).map_err(StageError::content)?;
                let bsdf = material.at(&TexturePoint::ANYWHERE);
                let last = if bsdf.is_transmissive() { 180.0 } else { 90.0 };
                self.measured(job, last, |degrees| View::at_degrees(bsdf, degrees))
            }
            Measured::Phase(description) => {
                let phase = description.compiled();
                self.measured(job, 180.0, |degrees| Scattering { phase, outgoing: outgoing_at(degrees) })
            }
            Measured::Warp(description) => {
                let warp = description.compiled();
                self.measured(job, 0.0, |_| warp)
            }
        }
    }
}

impl Lobe {
    /// All results, of what is seen from an angle in degrees, up to the last one that means something.
    fn measured<S: Scatter>(&self, job: &Job<'_>, last: f64, at: impl Fn(f64) -> S + Sync) -> Result<Vec<AnyArtifact>, StageError> {
        let seed = job.seed(self.seed);
        let scatter = at(self.outgoing_degrees);
        let cells = Cells::of(&scatter, self.rows.get() as usize);
        let survey = cells.survey(&scatter);
        job.check()?;
        let count = cells.count_drawn(&scatter, self.draws, seed);
        job.check()?;
        let albedo = albedos(&multiples(10.0 * self.step_degrees, 0.0, last), self.draws, seed, job, at)?;
        Ok(vec![
            AnyArtifact::new(slice(&scatter, self.step_degrees)),
            AnyArtifact::new(cell_table(&cells, &survey, &count)),
            AnyArtifact::new(picture(&cells, &survey, &count)),
            AnyArtifact::new(test(&survey, &count)),
            AnyArtifact::new(albedo),
        ])
    }
}

fn table(columns: &[(&str, &str)]) -> Table {
    Table::new(columns.iter().map(|(name, unit)| Column::new(*name, *unit)).collect())
}

/// From `first` to at most `last`; the last one itself is grazing and left out.
fn multiples(step: f64, first: f64, last: f64) -> Vec<f64> {
    let angles = (0..).map(|k| first + f64::from(k) * step);
    let found: Vec<f64> = angles.take_while(|angle| *angle < last - 1e-9).filter(|angle| (angle - 90.0).abs() > 1e-9).collect();
    if found.is_empty() { vec![first] } else { found }
}

fn slice(scatter: &impl Scatter, step: f64) -> Table {
    let mut rows = table(&[("angle_deg", "deg"), ("r", ""), ("g", ""), ("b", ""), ("pdf", "1/sr")]);
    let last = if scatter.covers_sphere() { 180.0 } else { 90.0 };
    let count = (last / step).floor() as i32;
    for k in -count..=count {
        let angle = f64::from(k) * step;
        let (sine, cosine) = elementary::sin_cos(angle.to_radians());
        // The outgoing direction is on the side of +x, and what a mirror reflects on that of -x.
        let (value, pdf) = scatter.value_and_pdf(glam::DVec3::new(-sine, 0.0, cosine).as_vec3());
        let [r, g, b] = value.to_array().map(f64::from);
        rows.push([angle, r, g, b, f64::from(pdf)].map(Cell::Number).to_vec());
    }
    rows
}

fn cell_table(cells: &Cells, survey: &Survey, count: &Count) -> Table {
    let mut rows = table(&[("azimuth_deg", "deg"), ("polar_deg", "deg"), ("expected", ""), ("drawn", "")]);
    let draws = count.counts.iter().sum::<u64>() as f64;
    for index in 0..cells.count() {
        let [column, row] = [index % cells.columns, index / cells.columns].map(|place| place as f64 + 0.5);
        let polar = elementary::acos(cells.direction(column, row).z).to_degrees();
        let azimuth = 360.0 * column / cells.columns as f64;
        rows.push([azimuth, polar, survey.probability[index] * draws, count.counts[index] as f64].map(Cell::Number).to_vec());
    }
    rows
}

fn test(survey: &Survey, count: &Count) -> Table {
    let mut rows = table(&[
        ("draws", ""),
        ("chi_square", ""),
        ("degrees_of_freedom", ""),
        ("p_value", ""),
        ("integral_of_pdf", ""),
        ("drawn_share", ""),
    ]);
    let result = survey.test(count);
    let draws = count.counts.iter().sum::<u64>() as f64;
    let none = count.counts.last().map_or(0.0, |count| *count as f64);
    let numbers = [draws, result.statistic, result.degrees_of_freedom as f64, result.p_value, survey.drawn(), 1.0 - none / draws];
    rows.push(numbers.map(Cell::Number).to_vec());
    rows
}

/// Rows of the grid for albedos: they need no fine cells, since every cell is refined where it has to be.
const ALBEDO_ROWS: usize = 12;

fn albedos<S: Scatter>(angles: &[f64], draws: u32, seed: u64, job: &Job<'_>, at: impl Fn(f64) -> S + Sync) -> Result<Table, StageError> {
    let row = |degrees: &f64| -> Result<Vec<Cell>, StageError> {
        job.check()?;
        let scatter = at(*degrees);
        let cells = Cells::of(&scatter, ALBEDO_ROWS);
        let albedo = cells.survey(&scatter).albedo;
        let count = cells.count_drawn(&scatter, draws.min(20_000), seed);
        let drawn = count.mean_weight.element_sum() / 3.0;
        Ok([*degrees, albedo.x, albedo.y, albedo.z, drawn, count.standard_error].map(Cell::Number).to_vec())
    };
    let mut rows = table(&[("outgoing_deg", "deg"), ("r", ""), ("g", ""), ("b", ""), ("drawn", ""), ("drawn_error", "")]);
    rows.rows = angles.par_iter().map(row).collect::<Result<_, _>>()?;
    Ok(rows)
}

/// Expected and drawn directions side by side: azimuth across, the pole above; colors are logarithmic and the same in both.
fn picture(cells: &Cells, survey: &Survey, count: &Count) -> Picture {
    let draws = count.counts.iter().sum::<u64>() as f64;
    let expected: Vec<f64> = survey.probability.iter().map(|share| share * draws).collect();
    let drawn: Vec<f64> = count.counts[..cells.count()].iter().map(|count| *count as f64).collect();
    let largest = expected.iter().chain(&drawn).fold(1.0_f64, |largest, value| largest.max(*value));
    let shade = |value: &f64| Colormap::Viridis.color(elementary::ln_1p(*value) / elementary::ln_1p(largest));
    let panel = |values: &[f64]| {
        let bitmap = Bitmap { width: cells.columns, height: cells.rows, pixels: values.iter().map(shade).collect() };
        Some(sheet::fitted(bitmap, PANEL_WIDTH))
    };
    let p_value = survey.test(count).p_value;
    sheet::draw(&Sheet {
        title: format!("{draws} directions, chi-square p = {p_value:.3}"),
        row_labels: vec![String::new()],
        column_labels: vec!["expected".into(), "drawn".into()],
        cells: vec![panel(&expected), panel(&drawn)],
        cell_width: PANEL_WIDTH,
        gap: 10,
        background: [255; 3],
    })
}

const PANEL_WIDTH: usize = 360;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn angles_stop_before_grazing_and_pass_over_it() {
        assert_eq!(multiples(30.0, 0.0, 90.0), [0.0, 30.0, 60.0]);
        assert_eq!(multiples(45.0, 0.0, 180.0), [0.0, 45.0, 135.0]);
        assert_eq!(multiples(5.0, 0.0, 0.0), [0.0]);
    }

    #[test]
    fn the_slice_of_a_metal_peaks_where_a_mirror_reflects() {
        let text = serde_json::json!({ "rough-conductor": { "metal": "gold", "alpha": 0.05 } });
        let material = Material::new(&serde_json::from_value(text).unwrap(), DirectionSampling::Bsdf).unwrap();
        let rows = slice(&View::at_degrees(material.at(&TexturePoint::ANYWHERE), 30.0), 0.5).rows;
        let brightest = rows.iter().max_by(|a, b| a[1].number().unwrap().total_cmp(&b[1].number().unwrap())).unwrap();
        assert!((brightest[0].number().unwrap() - 30.0).abs() <= 0.5);
        assert_eq!(rows.len(), 361);
    }
}

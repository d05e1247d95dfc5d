//! One file per stage kind; the only room that knows both the engine and the domain.
//!
//! A kind's struct is its parameter block and its manual. `artifacts` gives the domain's types their
//! canonical bytes. Adding a kind is one file here and one row in `registry`.

pub mod artifacts;
pub mod assemble;
pub mod assess;
pub mod average;
pub mod compare;
pub mod conversion;
pub mod denoise;
pub mod difference;
pub mod distribution;
pub mod fresnel;
pub mod grid;
pub mod layouts;
pub mod load;
pub mod lobe;
pub mod mark;
pub mod median_cut;
pub mod names;
pub mod origin;
pub mod plot;
pub mod profile;
pub mod rasters;
pub mod reach;
pub mod relight;
pub mod render;
pub mod rotate;
pub mod sample;
pub mod scene_xml;
pub mod synthesize;
pub mod table;
pub mod tone_map;
pub mod unwrap;
pub mod wrap;

use crate::engine::registry::Registry;
use crate::figure::chart::Chart;
use crate::figure::table::Table;
use crate::image::raster::{Image, Picture};
use crate::light::distribution::Distribution;
use crate::light::envmap::EnvMap;
use crate::light::lights::LightSet;
use crate::light::samples::SampleSet;
use crate::render::film::sums::Film;
use crate::render::mesh::Mesh;
use crate::stages::distribution::DistributionStage;
use crate::stages::profile::ProfileStage;
use crate::stages::sample::SampleStage;

/// All kinds and artifact types of the program.
#[rustfmt::skip] // One row a line.
pub fn registry() -> Registry {
    Registry::default()
        .with::<load::Load>()
        .with::<synthesize::Synthesize>()
        .with::<assemble::Assemble>()
        .with::<unwrap::Unwrap>()
        .with::<wrap::Wrap>()
        .with::<rotate::Rotate>()
        .with::<DistributionStage>()
        .with::<SampleStage>()
        .with::<ProfileStage>()
        .with::<median_cut::MedianCut>()
        .with::<mark::Mark>()
        .with::<relight::Relight>()
        .with::<render::Render>()
        .with::<denoise::Denoise>()
        .with::<fresnel::Fresnel>()
        .with::<lobe::Lobe>()
        .with::<tone_map::ToneMap>()
        .with::<compare::Compare>()
        .with::<average::Average>()
        .with::<assess::Assess>()
        .with::<table::Collect>()
        .with::<reach::ReachStage>()
        .with::<plot::Plot>()
        .with::<grid::Grid>()
        .with_dialect("xml", scene_xml::read)
        .with_artifact::<EnvMap>()
        .with_artifact::<Image>()
        .with_artifact::<Picture>()
        .with_artifact::<Distribution>()
        .with_artifact::<SampleSet>()
        .with_artifact::<LightSet>()
        .with_artifact::<Mesh>()
        .with_artifact::<Table>()
        .with_artifact::<Chart>()
        .with_artifact::<Film>()
}

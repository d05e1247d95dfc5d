//! The kind `grid`: pictures as a contact sheet.

use std::collections::BTreeMap;
use std::num::NonZeroU32;
use std::sync::Arc;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::names::Names;
use super::plot::with_axes_of_fields;
use super::table::cell;
use crate::engine::artifact::{AnyArtifact, Artifact, TypeName};
use crate::engine::coordinate::Scalar;
use crate::engine::job::Job;
use crate::engine::parameter::{Accepts, Ports};
use crate::engine::stage::{InputSizes, ResultDeclaration, Stage, StageError};
use crate::figure::bitmap::Bitmap;
use crate::figure::curves::{value_label, with_names_of_files};
use crate::figure::sheet::{self, Sheet};
use crate::figure::table::{Cell, Column};
use crate::image::display;
use crate::image::raster::{Image, Picture};
use crate::light::envmap::EnvMap;

/// Lays pictures out in rows and columns, labelled by their axes.
///
/// Pictures are shown as they are; linear images and maps are clipped and sRGB-encoded (use `tone-map` to choose how). A coordinate
/// that does not exist leaves its cell empty; a picture without one of the axes stands at every value of it.
///
/// ```yaml
/// sheet: { grid: { of: picture, columns: n, title: By count, cell: 256 }, save: png }
/// ```
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Grid {
    /// The pictures: one stage or a list of them.
    pub of: Ports<Shown>,
    /// The axes to collapse into the sheet; by default all.
    #[serde(default)]
    pub over: Option<Vec<String>>,
    /// The axes that number the rows, or `stage`: one name or a list.
    #[serde(default)]
    pub rows: Names,
    /// The axes that number the columns, or `stage`: one name or a list. By default `stage` where there are no `rows` either.
    #[serde(default)]
    pub columns: Names,
    /// Width of a column in pixels, to which pictures are scaled: smaller by averaging light, larger by repeating pixels.
    /// By default that of the widest picture, at most 512.
    #[serde(default)]
    #[schemars(range(min = 8, max = 8192), extend("x-unit" = "pixels"))]
    pub cell: Option<NonZeroU32>,
    /// Free space between pictures in pixels; default 12.
    #[serde(default = "usual_gap")]
    #[schemars(range(max = 1000), extend("x-unit" = "pixels"))]
    pub gap: u32,
    /// Color of the sheet; default `white`.
    #[serde(default)]
    pub background: Background,
    /// Above the sheet; by default nothing.
    #[serde(default)]
    pub title: String,
    /// Text for readers in place of names of axes and of values: `{ pdf-weighted: unbiased }`. A file is named by the end of its path.
    #[serde(default)]
    pub names: BTreeMap<String, String>,
}

fn usual_gap() -> u32 {
    12
}

/// Color of a sheet.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Background {
    /// White, for paper.
    #[default]
    White,
    /// Half-way grey, which flatters neither dark nor bright pictures.
    Gray,
    /// Black, for screens.
    Black,
}

impl Background {
    fn rgb(self) -> [u8; 3] {
        match self {
            Background::White => [255; 3],
            Background::Gray => [119; 3],
            Background::Black => [0; 3],
        }
    }
}

/// What can be shown on a sheet.
pub enum Shown {
    /// As it is.
    Picture(Arc<Picture>),
    /// Clipped and sRGB-encoded.
    Image(Arc<Image>),
    /// Clipped and sRGB-encoded.
    Map(Arc<EnvMap>),
}

impl Accepts for Shown {
    const TYPES: &'static [TypeName] = &[Picture::TYPE, Image::TYPE, EnvMap::TYPE];
    type Value = Shown;

    fn take(artifact: AnyArtifact) -> Option<Shown> {
        let picture = artifact.get().map(Shown::Picture);
        picture.or_else(|| artifact.get().map(Shown::Image)).or_else(|| artifact.get().map(Shown::Map))
    }
}

impl Shown {
    /// The pixels over a background, with a warning if some were clipped.
    fn bitmap(&self, background: [u8; 3]) -> (Bitmap, Vec<String>) {
        let (picture, warnings) = match self {
            Shown::Picture(picture) => return (sheet::flattened(picture, background), Vec::new()),
            Shown::Image(image) => display::encoded(image),
            Shown::Map(map) => display::encoded(&Image::opaque(map.raster.clone())),
        };
        (sheet::flattened(&picture, background), warnings)
    }
}

/// Widest column that is chosen by itself.
const USUAL_WIDTH: usize = 512;

impl Stage for Grid {
    const KIND: &'static str = "grid";
    const VERSION: u32 = 2;
    const RESULTS: &'static [ResultDeclaration] = &[ResultDeclaration { name: "", types: &[Picture::TYPE] }];
    type Output = Picture;

    fn axes_used(&self) -> Option<Vec<String>> {
        Some(with_axes_of_fields(self.rows.0.iter().chain(&self.columns.0).cloned().collect()))
    }

    fn memory(&self, inputs: &InputSizes) -> u64 {
        // Pictures are taken one by one and kept at their size on the sheet.
        inputs.values().sum::<u64>() / 2
    }

    fn run(&self, job: &Job<'_>) -> Result<Picture, StageError> {
        let mut tiles = Vec::new();
        for (index, input) in job.collected(&self.of).enumerate() {
            job.check()?;
            let input = input?;
            tiles.push(self.tile(job, input.label, input.columns, &input.value));
            job.report_progress(index as f32 / job.collected_count(&self.of) as f32);
        }
        Ok(sheet::draw(&self.sheet(tiles)?))
    }
}

/// A picture at its size on the sheet, with the values of its axes.
struct Tile {
    values: Vec<(String, Cell)>,
    bitmap: Bitmap,
}

impl Tile {
    /// Its value on each of these axes; empty on those it lacks.
    fn place(&self, axes: &[String]) -> Vec<Cell> {
        axes.iter().map(|axis| self.value(axis).cloned().unwrap_or(Cell::Empty)).collect()
    }

    fn value(&self, axis: &str) -> Option<&Cell> {
        self.values.iter().find(|(name, _)| name == axis).map(|(_, value)| value)
    }
}

impl Grid {
    fn tile(&self, job: &Job<'_>, label: &str, columns: &[(String, Scalar)], shown: &Shown) -> Tile {
        let (bitmap, warnings) = shown.bitmap(self.background.rgb());
        warnings.into_iter().for_each(|warning| job.warn(format!("`{label}`: {warning}")));
        let width = self.cell.map_or(bitmap.width.min(USUAL_WIDTH), |cell| cell.get() as usize);
        let stage = ("stage".to_owned(), Cell::Text(label.to_owned()));
        let axes = columns.iter().map(|(name, value)| (name.clone(), cell(value)));
        Tile { values: std::iter::once(stage).chain(axes).collect(), bitmap: sheet::fitted(bitmap, width) }
    }

    fn sheet(&self, tiles: Vec<Tile>) -> Result<Sheet, StageError> {
        let by_stage = Names(vec!["stage".into()]);
        let column_axes = if self.rows.is_empty() && self.columns.is_empty() { &by_stage } else { &self.columns };
        self.check_axes(&tiles, column_axes)?;
        let (rows, columns) = (places(&tiles, &self.rows.0), places(&tiles, &column_axes.0));
        let names = with_names_of_files(&self.names, rows.iter().chain(&columns).flatten());
        let label = |axes: &Names, place: &[Cell]| label(axes, place, &names);
        let mut owners: Vec<Option<usize>> = vec![None; rows.len() * columns.len()];
        for (index, tile) in tiles.iter().enumerate() {
            let (row_place, column_place) = (tile.place(&self.rows.0), tile.place(&column_axes.0));
            for row in (0..rows.len()).filter(|row| agree(&row_place, &rows[*row])) {
                for column in (0..columns.len()).filter(|column| agree(&column_place, &columns[*column])) {
                    let owner = &mut owners[row * columns.len() + column];
                    if let Some(first) = owner.replace(index) {
                        let place = [(&self.rows, &rows[row]), (column_axes, &columns[column])].map(|(axes, place)| label(axes, place));
                        return Err(self.collision(place, &tiles[first], tile, column_axes));
                    }
                }
            }
        }
        Ok(Sheet {
            title: self.title.clone(),
            row_labels: rows.iter().map(|place| label(&self.rows, place)).collect(),
            column_labels: columns.iter().map(|place| label(column_axes, place)).collect(),
            cell_width: self.cell.map_or_else(|| tiles.iter().map(|tile| tile.bitmap.width).max().unwrap_or(1), |cell| cell.get() as usize),
            cells: owners.into_iter().map(|owner| owner.map(|index| tiles[index].bitmap.clone())).collect(),
            gap: self.gap as usize,
            background: self.background.rgb(),
        })
    }

    /// An axis that no picture has is a mistake.
    fn check_axes(&self, tiles: &[Tile], column_axes: &Names) -> Result<(), StageError> {
        let unknown = self.rows.0.iter().chain(&column_axes.0).find(|axis| tiles.iter().all(|tile| tile.value(axis).is_none()));
        let Some(axis) = unknown else { return Ok(()) };
        let mut known: Vec<&str> = Vec::new();
        for (name, _) in tiles.iter().flat_map(|tile| &tile.values) {
            if !known.contains(&name.as_str()) {
                known.push(name);
            }
        }
        let message = format!(
            "no picture has the axis `{axis}`; there are {}",
            known.iter().map(|name| format!("`{name}`")).collect::<Vec<_>>().join(", ")
        );
        let nearest = crate::catalogue::nearest(axis, known);
        Err(nearest.map_or_else(
            || StageError::content(&message),
            |name| StageError::content_with_hint(&message, format!("did you mean `{name}`?")),
        ))
    }

    /// Two pictures for one cell: names what tells them apart and is used nowhere.
    fn collision(&self, place: [String; 2], first: &Tile, second: &Tile, column_axes: &Names) -> StageError {
        let is_used = |axis: &String| self.rows.0.contains(axis) || column_axes.0.contains(axis);
        let differing = first.values.iter().chain(&second.values).map(|(axis, _)| axis);
        let differing = differing.filter(|axis| !is_used(axis) && first.value(axis) != second.value(axis));
        let place = place.into_iter().filter(|label| !label.is_empty()).collect::<Vec<_>>().join(", ");
        let message = format!("several pictures for the cell `{place}`");
        match differing.clone().find(|axis| *axis != "stage").or_else(|| differing.clone().next()) {
            Some(axis) => StageError::content_with_hint(
                format!("{message}: they differ in `{axis}`, which is used nowhere"),
                format!("add `{axis}` to `rows` or `columns`, or take one value of it as in `\"name[{axis}=…]\"`"),
            ),
            None => StageError::content(message),
        }
    }
}

/// What stands beside a row or above a column.
fn label(axes: &Names, place: &[Cell], names: &BTreeMap<String, String>) -> String {
    let values = axes.0.iter().zip(place).filter_map(|(axis, value)| value_label(&Column::new(axis, ""), value, names));
    values.collect::<Vec<_>>().join(", ")
}

/// The places along these axes in order of appearance; one that holds for all others is none of its own.
fn places(tiles: &[Tile], axes: &[String]) -> Vec<Vec<Cell>> {
    let mut places: Vec<Vec<Cell>> = Vec::new();
    for place in tiles.iter().map(|tile| tile.place(axes)) {
        if !places.contains(&place) {
            places.push(place);
        }
    }
    let all = places.clone();
    places.retain(|place| !all.iter().any(|other| other != place && agree(place, other)));
    places
}

/// Whether a picture at `place` belongs to `other`: equal wherever it has a value.
fn agree(place: &[Cell], other: &[Cell]) -> bool {
    place.iter().zip(other).all(|(mine, other)| *mine == Cell::Empty || mine == other)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::raster::PictureSamples;

    fn grid(rows: &[&str], columns: &[&str]) -> Grid {
        let yaml = format!("{{ of: [a], rows: [{}], columns: [{}], gap: 4, cell: 16 }}", rows.join(", "), columns.join(", "));
        serde_yaml::from_str(&yaml).unwrap()
    }

    fn tile(stage: &str, axes: &[(&str, i128)]) -> Tile {
        let axes = axes.iter().map(|(axis, value)| ((*axis).to_owned(), Cell::Integer(*value)));
        let values = std::iter::once(("stage".to_owned(), Cell::Text(stage.into()))).chain(axes).collect();
        Tile { values, bitmap: Bitmap::filled(16, 16, [9; 3]) }
    }

    #[test]
    fn a_picture_without_an_axis_stands_at_every_value_and_missing_ones_leave_a_hole() {
        let tiles = vec![tile("ldr", &[("n", 64)]), tile("ldr", &[("n", 256)]), tile("truth", &[]), tile("other", &[("n", 64)])];
        let sheet = grid(&["stage"], &["n"]).sheet(tiles).unwrap();
        assert_eq!(sheet.column_labels, ["n\u{a0}=\u{a0}64", "n\u{a0}=\u{a0}256"]);
        assert_eq!(sheet.row_labels, ["ldr", "truth", "other"]);
        assert_eq!(sheet.cells.iter().map(Option::is_some).collect::<Vec<_>>(), [true, true, true, true, true, false]);
        let PictureSamples::Eight(pixels) = sheet::draw(&sheet).samples else { panic!("eight bits") };
        assert_eq!(pixels.iter().filter(|pixel| **pixel == [9; 3]).count(), 5 * 256);
    }

    #[test]
    fn two_pictures_for_one_cell_name_the_axis_that_is_used_nowhere() {
        let tiles = vec![tile("ldr", &[("n", 64), ("gamma", 1)]), tile("ldr", &[("n", 64), ("gamma", 2)])];
        let error = grid(&[], &["n"]).sheet(tiles).unwrap_err();
        assert!(error.to_string().contains("they differ in `gamma`"), "{error}");
    }

    #[test]
    fn an_axis_that_no_picture_has_is_told() {
        let error = grid(&["gama"], &["n"]).sheet(vec![tile("ldr", &[("n", 64), ("gamma", 1)])]).unwrap_err();
        let StageError::Content { message, hint } = error else { panic!("bad content") };
        assert!(message.contains("`gama`") && hint.unwrap().contains("`gamma`"));
    }
}

//! How two artifacts differ, for `pipeline diff`: errors of images, cells of tables and of what reads as one.
//!
//! The first is the reference, as in `compare`: the second is judged by it.

use serde::Serialize;

use crate::engine::artifact::{AnyArtifact, Origin};
use crate::engine::parameter::Accepts;
use crate::engine::stage::StageError;
use crate::formats::{self, Content, Limits};
use crate::image::colormap::Colormap;
use crate::image::metrics::{self, Compared, Measurement, Metric, MetricSettings};
use crate::image::raster::{Picture, PictureSamples, Plane};
use crate::stages::compare::comparable;
use crate::stages::rasters::LinearOrPicture;

/// How two artifacts differ.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Difference {
    /// In a few words.
    pub summary: String,
    /// Metrics of images, in the order in which they were asked for; infinite values are null.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub measures: Vec<Measure>,
    /// Cells of tables that differ, the first ones.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub cells: Vec<CellDifference>,
    /// The errors of the last metric that has some of single pixels, in false color; a PNG.
    #[serde(skip)]
    pub image: Option<Vec<u8>>,
}

/// The value of a metric.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Measure {
    /// Name of the metric.
    pub metric: &'static str,
    /// Its value.
    pub value: f64,
    /// Its unit; empty where it has none.
    #[serde(skip_serializing_if = "str::is_empty")]
    pub unit: &'static str,
}

/// A cell that differs.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct CellDifference {
    /// Row, from 1.
    pub row: usize,
    /// Name of the column.
    pub column: String,
    /// Text in the first table.
    pub first: String,
    /// Text in the second table.
    pub second: String,
}

/// Cells that are kept; all are counted.
const CELL_COUNT: usize = 5;

/// Artifacts that hold more than this, in bytes, are not compared cell by cell.
const TABLE_LIMIT: u64 = 64 << 20;

/// The metric of that name; the error lists them.
pub fn metric(name: &str) -> Result<Metric, String> {
    let all = [Metric::Rmse, Metric::Mse, Metric::Relmse, Metric::Smape, Metric::Psnr, Metric::Flip, Metric::HdrFlip];
    let names: Vec<&str> = all.iter().map(|metric| metric.name()).collect();
    all.into_iter().find(|metric| metric.name() == name).ok_or_else(|| format!("the metrics are {}", names.join(", ")))
}

/// How the second differs from the first. Metrics that do not fit the images are left out and named.
pub fn difference(
    first: &AnyArtifact,
    second: &AnyArtifact,
    metrics: &[Metric],
    check: impl Fn() -> Result<(), StageError> + Sync,
) -> Difference {
    match (LinearOrPicture::take(first.clone()), LinearOrPicture::take(second.clone())) {
        (Some(first), Some(second)) => of_images(&first, &second, metrics, check),
        _ => of_tables(first, second),
    }
}

/// An image file's content as an artifact; `None` if it is no image.
pub fn from_file(bytes: &[u8], name: &str) -> Option<AnyArtifact> {
    match formats::read(bytes, name, &Limits::default()).ok()?.content {
        Content::Linear(image) => Some(AnyArtifact::new(image)),
        Content::Display(picture) => Some(AnyArtifact::new(picture)),
    }
}

fn of_images(
    first: &LinearOrPicture,
    second: &LinearOrPicture,
    metrics: &[Metric],
    check: impl Fn() -> Result<(), StageError> + Sync,
) -> Difference {
    let sizes = [first, second].map(size);
    if sizes[0] != sizes[1] {
        let [first, second] = sizes.map(|(width, height)| format!("{width} x {height}"));
        return Difference { summary: format!("{first} -> {second} pixels"), ..Difference::default() };
    }
    let mut difference = Difference::default();
    let mut left_out: Vec<String> = Vec::new();
    for metric in metrics {
        match measured(*metric, first, second, &check) {
            Ok(measurement) => {
                difference.measures.push(Measure { metric: metric.name(), value: measurement.value, unit: metric.unit() });
                difference.image = measurement.map.map(|map| false_color(*metric, &map)).or(difference.image);
            }
            Err(error) => left_out.push(error.to_string()),
        }
    }
    left_out.dedup();
    let values = difference.measures.iter().map(|measure| {
        let unit = if measure.unit.is_empty() { String::new() } else { format!(" {}", measure.unit) };
        format!("{} {}{unit}", measure.metric, short(measure.value))
    });
    difference.summary = values.chain(left_out).collect::<Vec<_>>().join(", ");
    difference
}

fn size(image: &LinearOrPicture) -> (usize, usize) {
    match image {
        LinearOrPicture::Linear(image) => (image.color.width(), image.color.height()),
        LinearOrPicture::Picture(picture) => (picture.width, picture.height),
    }
}

fn measured(
    metric: Metric,
    first: &LinearOrPicture,
    second: &LinearOrPicture,
    check: impl Fn() -> Result<(), StageError> + Sync,
) -> Result<Measurement, StageError> {
    let [of, to] = comparable(metric, second, first)?;
    metrics::measure(metric, &Compared::new(&of, &to)?, &MetricSettings::default(), check)
}

/// FLIP as it is, other errors relative to their greatest value.
fn false_color(metric: Metric, map: &Plane) -> Vec<u8> {
    let greatest = map.values.iter().copied().filter(|value| value.is_finite()).fold(0.0_f32, f32::max);
    let is_relative = matches!(metric, Metric::Flip | Metric::HdrFlip) || greatest == 0.0;
    let scale = if is_relative { 1.0 } else { f64::from(greatest) };
    let samples = map.values.iter().map(|value| Colormap::Magma.color(f64::from(*value) / scale)).collect();
    let picture = Picture { width: map.width, height: map.height, samples: PictureSamples::Eight(samples), alpha: None };
    formats::encode_picture(&picture, "png", &[]).map(|(bytes, _)| bytes).unwrap_or_default()
}

/// Four significant digits.
fn short(value: f64) -> String {
    match value.abs() {
        size if !size.is_finite() || size == 0.0 => format!("{value}"),
        size if (1e-3..1e4).contains(&size) => format!("{value:.4}"),
        _ => format!("{value:.3e}"),
    }
}

/// Whatever can be saved as CSV is compared by its cells.
fn of_tables(first: &AnyArtifact, second: &AnyArtifact) -> Difference {
    let said = |summary: &str| Difference { summary: summary.to_owned(), ..Difference::default() };
    if first.type_name() != second.type_name() {
        return said(&format!("{} -> {}", first.type_name(), second.type_name()));
    }
    if first.memory().max(second.memory()) > TABLE_LIMIT {
        return said("too large to be compared cell by cell");
    }
    let [Some(first), Some(second)] = [first, second].map(rows) else { return said("other content") };
    let (Some(head), Some(other_head)) = (first.first(), second.first()) else { return said("other content") };
    if head != other_head {
        let lacks = |these: &[String], others: &[String]| these.iter().filter(|name| !others.contains(name)).cloned().collect::<Vec<_>>();
        let (removed, added) = (lacks(head, other_head), lacks(other_head, head));
        let mut parts = Vec::new();
        parts.extend((!removed.is_empty()).then(|| format!("columns removed: {}", removed.join(", "))));
        parts.extend((!added.is_empty()).then(|| format!("columns added: {}", added.join(", "))));
        return said(&if parts.is_empty() { "columns in another order".to_owned() } else { parts.join("; ") });
    }
    cells(head, &first[1..], &second[1..])
}

fn cells(head: &[String], first: &[Vec<String>], second: &[Vec<String>]) -> Difference {
    let pairs = first.iter().zip(second).enumerate().flat_map(|(row, (one, other))| {
        let cells = head.iter().zip(one.iter().zip(other)).filter(|(_, (one, other))| one != other);
        cells.map(move |(column, (one, other))| CellDifference {
            row: row + 1,
            column: column.clone(),
            first: one.clone(),
            second: other.clone(),
        })
    });
    let differing: Vec<CellDifference> = pairs.collect();
    let row_count = differing.iter().map(|cell| cell.row).collect::<std::collections::BTreeSet<_>>().len();
    let rows = if first.len() == second.len() { String::new() } else { format!("{} -> {} rows; ", first.len(), second.len()) };
    let summary = format!("{rows}{} cells in {row_count} of {} rows differ", differing.len(), first.len().min(second.len()));
    Difference { summary, cells: differing.into_iter().take(CELL_COUNT).collect(), ..Difference::default() }
}

/// The head and all rows as text.
fn rows(artifact: &AnyArtifact) -> Option<Vec<Vec<String>>> {
    let saved = artifact.save("csv", &Origin::default()).ok()?;
    let mut reader = csv::ReaderBuilder::new().has_headers(false).flexible(true).from_reader(saved.bytes.as_slice());
    reader.records().map(|record| record.ok().map(|record| record.iter().map(str::to_owned).collect())).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::figure::table::{Cell, Column, Table};
    use crate::image::raster::{Image, Raster};

    fn image(value: f32) -> AnyArtifact {
        AnyArtifact::new(Image::opaque(Raster::filled(8, 4, [value; 3])))
    }

    fn table(values: &[f64]) -> AnyArtifact {
        let mut table = Table::new(vec![Column::new("n", ""), Column::new("rmse", "")]);
        values.iter().enumerate().for_each(|(n, value)| table.push(vec![Cell::Integer(n as i128), Cell::Number(*value)]));
        AnyArtifact::new(table)
    }

    fn between(first: &AnyArtifact, second: &AnyArtifact) -> Difference {
        difference(first, second, &[Metric::Rmse, Metric::Flip], || Ok(()))
    }

    #[test]
    fn images_are_measured_and_drawn() {
        let found = between(&image(0.5), &image(0.25));
        assert_eq!((found.measures[0].metric, found.measures[0].value), ("rmse", 0.25));
        assert!(found.measures[1].value > 0.0 && found.summary.starts_with("rmse 0.2500, flip 0."), "{}", found.summary);
        let drawn = from_file(&found.image.unwrap(), "map.png").unwrap();
        assert_eq!(drawn.get::<Picture>().unwrap().width, 8);
    }

    #[test]
    fn images_that_cannot_be_compared_are_named() {
        let other = AnyArtifact::new(Image::opaque(Raster::filled(3, 4, [0.0; 3])));
        let found = between(&image(0.5), &other);
        assert!(found.measures.is_empty() && found.image.is_none());
        assert_eq!(found.summary, "8 x 4 -> 3 x 4 pixels");
    }

    #[test]
    fn cells_that_differ_are_named_and_counted() {
        let found = between(&table(&[0.5, 1.5, 2.5]), &table(&[0.5, 1.75, 2.75]));
        assert_eq!(found.summary, "2 cells in 2 of 3 rows differ");
        let cell = CellDifference { row: 2, column: "rmse".into(), first: "1.5".into(), second: "1.75".into() };
        assert_eq!(found.cells[0], cell);
        assert!(between(&table(&[1.0]), &table(&[1.0, 2.0])).summary.starts_with("1 -> 2 rows"));
        assert_eq!(between(&table(&[1.0]), &image(1.0)).summary, "table -> image");
    }

    #[test]
    fn metrics_go_by_their_names() {
        assert_eq!(metric("hdr-flip"), Ok(Metric::HdrFlip));
        assert!(metric("flipp").unwrap_err().contains("hdr-flip"));
    }
}

//! What a figure says: axes, curves, guide lines, heat; a plain description with every number in it.
//!
//! Says nothing of where on the paper things stand (see `layout`) or of where numbers come from (see
//! `curves`). All numbers are finite.

use serde::{Deserialize, Serialize};

use super::bitmap;
use super::estimate::PowerLaw;
use super::{layout, pdf, svg};

/// A figure.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Chart {
    /// Above the figure; may be empty.
    pub title: String,
    /// Width and height on paper in millimeters; the height grows where a legend needs it.
    pub size_mm: [f64; 2],
    /// The horizontal axis.
    pub x: Axis,
    /// The vertical axis.
    pub y: Axis,
    /// The curves, in the order of the legend.
    pub curves: Vec<Curve>,
    /// Lines across the whole frame.
    pub guides: Vec<Guide>,
    /// A field of colors, under everything.
    pub heat: Option<Heat>,
    /// Small print below the figure: what bars mean, how many runs a mean is of, what was left out.
    pub notes: Vec<String>,
}

/// One axis.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Axis {
    /// What is measured.
    pub label: String,
    /// In which unit; empty where it has none.
    pub unit: String,
    /// How numbers are spaced.
    pub scale: Scale,
    /// First and last number; by default what the data need.
    pub range: Option<[f64; 2]>,
    /// Names of the positions 0, 1, 2, …, where the axis shows names in place of numbers.
    pub categories: Vec<String>,
}

/// How numbers are spaced along an axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Scale {
    /// Equal differences.
    #[default]
    Linear,
    /// Equal ratios; only positive numbers are shown.
    Logarithmic,
}

/// One entry of the legend and what it stands for.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Curve {
    /// Text in the legend; may be empty where there is one curve.
    pub label: String,
    /// How its points are shown.
    pub look: Look,
    /// Number of its color and marker.
    pub hue: usize,
    /// Number of its line style.
    pub dash: usize,
    /// Its points, in the order in which a line joins them.
    pub points: Vec<Point>,
    /// How intervals are shown.
    pub interval: IntervalLook,
    /// A fitted law, drawn as a thin line and told in the legend.
    pub fit: Option<PowerLaw>,
}

/// How the points of a curve are shown.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Look {
    /// Joined by a line; with markers where there are few.
    Line,
    /// Markers alone.
    Points,
    /// A staircase: each value holds until the next x.
    Steps,
    /// A filled staircase from zero: each value holds until the next x.
    Filled,
    /// A bar from zero at each x, side by side with those of other curves.
    Bars,
    /// One value for all x: a line across the frame.
    Level,
}

/// How intervals are shown.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum IntervalLook {
    /// A line with ends through each point.
    #[default]
    Whiskers,
    /// A lighter band along the curve.
    Band,
}

/// One point of a curve.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Point {
    /// Across.
    pub x: f64,
    /// Up.
    pub y: f64,
    /// Lower and upper end of its interval.
    pub interval: Option<[f64; 2]>,
    /// How many measurements it is the mean of.
    pub count: usize,
}

impl Point {
    /// A single measurement.
    pub fn single(x: f64, y: f64) -> Self {
        Self { x, y, interval: None, count: 1 }
    }
}

/// A line across the whole frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Guide {
    /// Across which axis it stands: on x it is vertical.
    pub axis: GuideAxis,
    /// Where.
    pub at: f64,
    /// What it marks.
    pub label: String,
}

/// The axis on which a guide line marks a value.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum GuideAxis {
    /// A vertical line.
    X,
    /// A horizontal line.
    Y,
}

/// A field of colors.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Heat {
    /// What the columns stand for, within their borders.
    pub x_values: Vec<f64>,
    /// What the rows stand for, within their borders.
    pub y_values: Vec<f64>,
    /// Borders of the columns, one more than there are.
    pub x_edges: Vec<f64>,
    /// Borders of the rows, one more than there are.
    pub y_edges: Vec<f64>,
    /// A value for each row and column, row by row; nothing is drawn where there is none.
    pub values: Vec<Option<f64>>,
    /// What the colors mean; its range and scale are theirs.
    pub axis: Axis,
}

/// Resolution of PNG files.
pub const DOTS_PER_INCH: f64 = 300.0;

impl Chart {
    /// The figure as SVG; `metadata` are names and texts of where it comes from.
    pub fn to_svg(&self, metadata: &[(&str, &str)]) -> Vec<u8> {
        svg::encode(&layout::canvas(self), &self.title, metadata)
    }

    /// The figure as PNG with 300 dots per inch.
    pub fn to_png(&self, metadata: &[(&str, &str)]) -> Vec<u8> {
        bitmap::encode_png(&bitmap::render(&layout::canvas(self), DOTS_PER_INCH), DOTS_PER_INCH, metadata)
    }

    /// The figure as a one-page PDF.
    pub fn to_pdf(&self, metadata: &[(&str, &str)]) -> Vec<u8> {
        pdf::encode(&layout::canvas(self), &self.title, metadata)
    }
}

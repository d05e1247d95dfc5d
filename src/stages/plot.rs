//! The kind `plot`: collected rows as a figure.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fmt;
use std::num::NonZeroU32;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::de::{MapAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::names::Names;
use super::table::{Rows, collected, table_error, usual_level};
use crate::engine::artifact::Artifact;
use crate::engine::job::Job;
use crate::engine::parameter::{Port, Ports};
use crate::engine::stage::{Mistake, ResultDeclaration, Stage, StageError};
use crate::figure::chart::{Chart, GuideAxis, IntervalLook, Look, Scale};
use crate::figure::curves::{self, CurveError, Form, Request};
use crate::figure::table::Table;

/// Draws collected rows as curves, points, bars, a histogram or a heat map.
///
/// Columns are those of the kind `table`: `stage`, the collapsed axes, then the tables' own. A row whose `x` is empty holds for all
/// x and becomes a level line. Where several stages are collected, each has curves of its own.
///
/// ```yaml
/// curve: { plot: { of: error, x: n, y: [rmse], scale: log-log, fit: true }, save: [svg, pdf, png] }
/// ```
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Plot {
    /// The tables: one stage or a list of them.
    pub of: Ports<Rows>,
    /// The axes to collapse into rows; by default all.
    #[serde(default)]
    pub over: Option<Vec<String>>,
    /// How data are shown; default `line`.
    #[serde(default)]
    pub kind: PlotKind,
    /// The column across. Names in it (text) stand side by side, in order of appearance.
    pub x: String,
    /// The columns up, a curve for each; for a heat map the one column of its rows; none for a histogram, which counts `x`.
    #[serde(default)]
    pub y: Names,
    /// The column of a heat map's colors.
    #[serde(default)]
    pub value: Option<String>,
    /// The columns that tell curves apart: one name or a list.
    #[serde(default)]
    pub series: Names,
    /// An axis of repetitions (seeds): their mean is shown with an interval, and their number below the figure.
    #[serde(default)]
    pub repeat: Option<String>,
    /// Level of the Student t interval of those means; default 0.95.
    #[serde(default = "usual_level")]
    #[schemars(extend("exclusiveMinimum" = 0, "exclusiveMaximum" = 1))]
    pub interval: f64,
    /// How intervals are shown; default `whiskers`.
    #[serde(default)]
    pub interval_look: IntervalMarks,
    /// Fits y = a x^b to each curve by least squares of ln y on ln x and shows the slope b ± its standard error; `{ from, to }` fits
    /// between two x only. Of repetitions the means are fitted. Default false.
    #[serde(default)]
    pub fit: Fit,
    /// Scales of the axes; default `linear`.
    #[serde(default)]
    pub scale: Scales,
    /// Scale of a heat map's colors; default `linear`.
    #[serde(default)]
    pub color_scale: ColorScale,
    /// A table whose numbers are drawn as guide lines with their names (Brewster's angle).
    #[serde(default)]
    pub lines: Option<Port<Table>>,
    /// The columns of `lines` to draw; by default all that hold measured numbers.
    #[serde(default)]
    pub line_columns: Names,
    /// The axis on which guide lines stand; default `x`, vertical lines.
    #[serde(default)]
    pub line_axis: LineAxis,
    /// Number of bins of a histogram; by default the root of the number of values, 5 to 60.
    #[serde(default)]
    #[schemars(range(min = 1, max = 10_000))]
    pub bins: Option<NonZeroU32>,
    /// Above the figure; by default nothing.
    #[serde(default)]
    pub title: String,
    /// Label of the x axis; by default the column's name. The column's unit is added.
    #[serde(default)]
    pub x_label: Option<String>,
    /// Label of the y axis; by default the column's name if there is one. The column's unit is added.
    #[serde(default)]
    pub y_label: Option<String>,
    /// Label of a heat map's colors; by default the column's name.
    #[serde(default)]
    pub value_label: Option<String>,
    /// First and last number of the x axis; by default what the data need.
    #[serde(default)]
    pub x_range: Option<[f64; 2]>,
    /// First and last number of the y axis; by default what the data need.
    #[serde(default)]
    pub y_range: Option<[f64; 2]>,
    /// Text for readers in place of names of columns and of values in the legend: `{ rs: perpendicular }`. A file is named by the end of
    /// its path.
    #[serde(default)]
    pub names: BTreeMap<String, String>,
    /// Width and height on paper in millimeters, 40 to 1000; PNG has 300 dots per inch. A long legend adds height. Default [120, 80].
    #[serde(default = "usual_size")]
    #[schemars(inner(range(min = 40.0, max = 1000.0)), extend("x-unit" = "mm"))]
    pub size: [f64; 2],
}

fn usual_size() -> [f64; 2] {
    [120.0, 80.0]
}

/// How data are shown.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum PlotKind {
    /// Points joined from left to right, with markers where there are at most 40.
    #[default]
    Line,
    /// Markers alone.
    Points,
    /// A staircase: each value holds until the next x (a CDF over rows).
    Steps,
    /// Bars from zero, those of several curves side by side.
    Bars,
    /// How many values of `x` fall in each bin.
    Histogram,
    /// Colors over `x` and `y`.
    HeatMap,
}

/// How intervals are shown.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum IntervalMarks {
    /// A line with ends through each point.
    #[default]
    Whiskers,
    /// A lighter band along the curve.
    Band,
}

/// Scales of both axes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Scales {
    /// Both linear.
    #[default]
    Linear,
    /// Both logarithmic.
    LogLog,
    /// x logarithmic.
    LogX,
    /// y logarithmic.
    LogY,
}

/// Scale of colors.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum ColorScale {
    /// Equal differences.
    #[default]
    Linear,
    /// Equal ratios.
    Log,
}

/// The axis on which guide lines stand.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum LineAxis {
    /// Vertical lines at values of x.
    #[default]
    X,
    /// Horizontal lines at values of y.
    Y,
}

/// Whether and where power laws are fitted.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Fit {
    /// Not at all.
    #[default]
    Off,
    /// To all points.
    All,
    /// To the points between two x, both included; an open end is `None`.
    Range([Option<f64>; 2]),
}

impl Serialize for Fit {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Fit::Off => serializer.serialize_bool(false),
            Fit::All => serializer.serialize_bool(true),
            Fit::Range(ends) => {
                serializer.collect_map(["from", "to"].into_iter().zip(ends).filter_map(|(name, end)| end.map(|end| (name, end))))
            }
        }
    }
}

impl<'de> Deserialize<'de> for Fit {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(FitVisitor)
    }
}

struct FitVisitor;

impl<'de> Visitor<'de> for FitVisitor {
    type Value = Fit;

    fn expecting(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str("`true`, `false` or `{ from, to }`")
    }

    fn visit_bool<E>(self, is_on: bool) -> Result<Fit, E> {
        Ok(if is_on { Fit::All } else { Fit::Off })
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Fit, A::Error> {
        let mut ends = [None, None];
        while let Some(name) = map.next_key::<String>()? {
            match name.as_str() {
                "from" => ends[0] = Some(map.next_value()?),
                "to" => ends[1] = Some(map.next_value()?),
                other => return Err(serde::de::Error::unknown_field(other, &["from", "to"])),
            }
        }
        Ok(Fit::Range(ends))
    }
}

impl JsonSchema for Fit {
    fn inline_schema() -> bool {
        true
    }

    fn schema_name() -> Cow<'static, str> {
        "Fit".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({
            "anyOf": [
                { "type": "boolean" },
                {
                    "type": "object",
                    "properties": { "from": { "type": "number" }, "to": { "type": "number" } },
                    "additionalProperties": false,
                },
            ],
        })
    }
}

impl Stage for Plot {
    const KIND: &'static str = "plot";
    const VERSION: u32 = 3;
    const RESULTS: &'static [ResultDeclaration] = &[ResultDeclaration { name: "", types: &[Chart::TYPE] }];
    type Output = Chart;

    fn axes_used(&self) -> Option<Vec<String>> {
        let mut columns = vec![self.x.clone()];
        columns.extend(self.y.0.iter().chain(&self.series.0).chain(&self.repeat).cloned());
        Some(with_axes_of_fields(columns))
    }

    fn mistakes(&self) -> Vec<Mistake> {
        let mistake =
            |field: &str, message: &str, hint: &str| Mistake { field: field.into(), message: message.into(), hint: Some(hint.into()) };
        let mut mistakes = Vec::new();
        match self.kind {
            PlotKind::HeatMap if self.y.0.len() != 1 => {
                mistakes.push(mistake("y", "a heat map has one column of rows", "name one column in `y`"))
            }
            PlotKind::Histogram if !self.y.is_empty() => {
                mistakes.push(mistake("y", "a histogram counts the values of `x`", "leave `y` out"))
            }
            PlotKind::Histogram | PlotKind::HeatMap => {}
            _ if self.y.is_empty() => mistakes.push(mistake("y", "no column to draw", "name one column or several in `y`")),
            _ => {}
        }
        if (self.kind == PlotKind::HeatMap) != self.value.is_some() {
            mistakes.push(mistake(
                "value",
                "a heat map, and nothing else, has a column of colors",
                "set `kind: heat-map` and `value: COLUMN` together",
            ));
        }
        let is_curves = !matches!(self.kind, PlotKind::Histogram | PlotKind::HeatMap);
        if self.fit != Fit::Off && !matches!(self.kind, PlotKind::Line | PlotKind::Points) {
            mistakes.push(mistake("fit", "laws are fitted to lines and points", "set `kind` to `line` or `points`, or leave `fit` out"));
        }
        if self.repeat.is_some() && self.kind == PlotKind::Histogram {
            mistakes.push(mistake("repeat", "a histogram counts every value by itself", "leave `repeat` out"));
        }
        if !is_curves && self.kind == PlotKind::HeatMap && !self.series.is_empty() {
            mistakes.push(mistake("series", "a heat map has no curves", "leave `series` out"));
        }
        if !self.line_columns.is_empty() && self.lines.is_none() {
            mistakes.push(mistake("line_columns", "there is no table to take guide lines from", "name one in `lines`"));
        }
        for (field, range, is_logarithmic) in [("x_range", self.x_range, self.scales()[0]), ("y_range", self.y_range, self.scales()[1])] {
            let Some([low, high]) = range else { continue };
            if low >= high {
                mistakes.push(mistake(field, "the first number is not below the last", "write `[low, high]`"));
            } else if is_logarithmic == Scale::Logarithmic && low <= 0.0 {
                mistakes.push(mistake(field, "a logarithmic axis begins above 0", "choose a positive first number"));
            }
        }
        if let Fit::Range([Some(from), Some(to)]) = self.fit
            && from >= to
        {
            mistakes.push(mistake("fit", "`from` is not below `to`", "write `{ from: 64, to: 4096 }`"));
        }
        mistakes
    }

    fn run(&self, job: &Job<'_>) -> Result<Chart, StageError> {
        let mut chart = curves::chart(&collected(job, &self.of)?, &self.request()).map_err(curve_error)?;
        if let Some(lines) = job.optional_input(&self.lines)? {
            let axis = if self.line_axis == LineAxis::X { GuideAxis::X } else { GuideAxis::Y };
            chart.guides = curves::guides(&lines, &self.line_columns.0, axis, &self.names).map_err(curve_error)?;
        }
        chart.notes.iter().filter(|note| note.contains("not shown")).for_each(|note| job.warn(note.trim_end_matches('.')));
        Ok(chart)
    }
}

impl Plot {
    fn scales(&self) -> [Scale; 3] {
        use Scale::{Linear, Logarithmic};
        let [x, y] = match self.scale {
            Scales::Linear => [Linear, Linear],
            Scales::LogLog => [Logarithmic, Logarithmic],
            Scales::LogX => [Logarithmic, Linear],
            Scales::LogY => [Linear, Logarithmic],
        };
        [x, y, if self.color_scale == ColorScale::Log { Logarithmic } else { Linear }]
    }

    fn request(&self) -> Request {
        Request {
            form: match self.kind {
                PlotKind::Line => Form::Curve(Look::Line),
                PlotKind::Points => Form::Curve(Look::Points),
                PlotKind::Steps => Form::Curve(Look::Steps),
                PlotKind::Bars => Form::Curve(Look::Bars),
                PlotKind::Histogram => Form::Histogram,
                PlotKind::HeatMap => Form::HeatMap,
            },
            x: self.x.clone(),
            y: self.y.0.clone(),
            value: self.value.clone(),
            series: self.series.0.clone(),
            repeat: self.repeat.clone(),
            level: self.interval,
            interval: if self.interval_look == IntervalMarks::Band { IntervalLook::Band } else { IntervalLook::Whiskers },
            fit: match self.fit {
                Fit::Off => None,
                Fit::All => Some([f64::NEG_INFINITY, f64::INFINITY]),
                Fit::Range([from, to]) => Some([from.unwrap_or(f64::NEG_INFINITY), to.unwrap_or(f64::INFINITY)]),
            },
            scales: self.scales(),
            names: self.names.clone(),
            title: self.title.clone(),
            labels: [self.x_label.clone(), self.y_label.clone(), self.value_label.clone()],
            ranges: [self.x_range, self.y_range],
            bins: self.bins.map(|bins| bins.get() as usize),
            size_mm: self.size,
        }
    }
}

/// Columns, and for fields of map-valued axes (`look.gamma`) also the axis itself.
pub fn with_axes_of_fields(columns: Vec<String>) -> Vec<String> {
    let axes: Vec<String> = columns.iter().filter_map(|column| column.split_once('.')).map(|(axis, _)| axis.to_owned()).collect();
    columns.into_iter().chain(axes).collect()
}

fn curve_error(error: CurveError) -> StageError {
    match error {
        CurveError::Table(error) => table_error(error),
        CurveError::Empty => StageError::content_with_hint(error, "look at the tables by a stage of kind `table` with `save: csv`"),
        CurveError::NotNumbers { .. } => StageError::content_with_hint(error, "choose a column of numbers"),
        CurveError::RepeatedTwice { .. } | CurveError::CellTwice { .. } => {
            StageError::content_with_hint(error, "name the axis in which they differ in `series` or `repeat`")
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plot(fields: &str) -> Plot {
        serde_yaml::from_str(&format!("{{ of: [error], {fields} }}")).unwrap()
    }

    #[test]
    fn a_block_at_its_defaults_has_no_mistakes_and_says_which_axes_it_uses() {
        let plot = plot("x: n, y: [rmse], series: look.gamma, repeat: run, scale: log-log, fit: true");
        assert_eq!(plot.mistakes(), []);
        assert_eq!(plot.axes_used().unwrap(), ["n", "rmse", "look.gamma", "run", "look"]);
        assert_eq!(plot.request().scales[..2], [Scale::Logarithmic; 2]);
    }

    #[test]
    fn combinations_without_a_meaning_are_told() {
        let field_at_fault = |fields: &str| plot(fields).mistakes().into_iter().map(|mistake| mistake.field).collect::<Vec<_>>();
        assert_eq!(field_at_fault("x: n"), ["y"]);
        assert_eq!(field_at_fault("x: n, kind: histogram, y: a, fit: true"), ["y", "fit"]);
        assert_eq!(field_at_fault("x: n, kind: heat-map, y: a"), ["value"]);
        assert_eq!(field_at_fault("x: n, y: a, x_range: [2, 1]"), ["x_range"]);
        assert_eq!(field_at_fault("x: n, y: a, scale: log-y, y_range: [0, 1]"), ["y_range"]);
        assert_eq!(field_at_fault("x: n, y: a, fit: { from: 4, to: 2 }, line_columns: b"), ["line_columns", "fit"]);
    }

    #[test]
    fn a_fit_is_a_truth_value_or_a_range() {
        assert_eq!(plot("x: n, fit: { from: 64 }").fit, Fit::Range([Some(64.0), None]));
        assert_eq!(serde_json::to_string(&plot("x: n, fit: { to: 64 }").fit).unwrap(), r#"{"to":64.0}"#);
        assert!(serde_yaml::from_str::<Fit>("{ form: 1 }").is_err());
    }
}

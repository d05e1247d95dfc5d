//! From a collected table to a chart: which rows make a curve, which repetitions a mean, what the legend says.
//!
//! A row whose x is empty holds for all x and becomes a level line; a row whose series column is empty becomes a
//! curve of its own. A mean is never shown without the number of measurements it is made of.

use std::collections::{BTreeMap, BTreeSet};

use super::axis::{significant, unit_sign};
use super::chart::{Axis, Chart, Curve, Guide, GuideAxis, Heat, IntervalLook, Look, Point, Scale};
use super::estimate::{self, PowerLaw};
use super::table::{Cell, Collection, Column, Table, TableError};
use crate::math::elementary;

/// What of a table is to be shown, and how.
#[derive(Debug, Clone, PartialEq)]
pub struct Request {
    /// How data are shown.
    pub form: Form,
    /// The column across.
    pub x: String,
    /// The columns up: one curve each; of a heat map the one column of its rows.
    pub y: Vec<String>,
    /// The column of a heat map's colors.
    pub value: Option<String>,
    /// Columns that tell curves apart, besides `y`.
    pub series: Vec<String>,
    /// The column that numbers repetitions, of which means are shown.
    pub repeat: Option<String>,
    /// Level of the intervals of those means, in (0, 1).
    pub level: f64,
    /// How those intervals are shown.
    pub interval: IntervalLook,
    /// Fits a power law to each curve between two x (infinite where open).
    pub fit: Option<[f64; 2]>,
    /// Scales of x, of y and of a heat map's colors.
    pub scales: [Scale; 3],
    /// Text in place of names of columns and of values, by name.
    pub names: BTreeMap<String, String>,
    /// Above the figure.
    pub title: String,
    /// In place of the columns' names on x, y and the color bar.
    pub labels: [Option<String>; 3],
    /// First and last number of x and y.
    pub ranges: [Option<[f64; 2]>; 2],
    /// Bins of a histogram; by default the root of the count of values.
    pub bins: Option<usize>,
    /// Width and height in millimeters.
    pub size_mm: [f64; 2],
}

/// How data are shown.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Form {
    /// As this sort of curve.
    Curve(Look),
    /// As counts of the values of x.
    Histogram,
    /// As colors.
    HeatMap,
}

/// A table that does not allow the figure that was asked of it.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum CurveError {
    /// A column is not there.
    #[error(transparent)]
    Table(#[from] TableError),
    /// There is no row.
    #[error("nothing to draw: the collected table has no row")]
    Empty,
    /// A column that must hold numbers holds something else.
    #[error("column `{column}` must hold numbers, and holds `{found}`")]
    NotNumbers {
        /// The column.
        column: String,
        /// The first other cell.
        found: String,
    },
    /// Two rows for one repetition of one point.
    #[error("several rows of `{series}` have {x_column} = {x} and {repeat} = {repetition}")]
    RepeatedTwice {
        /// The curve's name.
        series: String,
        /// The column across.
        x_column: String,
        /// The point.
        x: String,
        /// The column of repetitions.
        repeat: String,
        /// The repetition.
        repetition: String,
    },
    /// Two rows for one cell of a heat map.
    #[error("several rows have {x_column} = {x} and {y_column} = {y}")]
    CellTwice {
        /// The column across.
        x_column: String,
        /// Its value.
        x: String,
        /// The column up.
        y_column: String,
        /// Its value.
        y: String,
    },
}

/// The chart that a request makes of a table.
pub fn chart(collection: &Collection, request: &Request) -> Result<Chart, CurveError> {
    let table = &collection.table;
    if table.rows.is_empty() {
        return Err(CurveError::Empty);
    }
    let request = &Request { names: with_names_of_files(&request.names, table.rows.iter().flatten()), ..request.clone() };
    let mut chart = match request.form {
        Form::Curve(look) => curve_chart(table, request, look)?,
        Form::Histogram => histogram(table, request)?,
        Form::HeatMap => heat_map(table, request)?,
    };
    note_hidden(&mut chart);
    Ok(chart)
}

/// Guide lines at the numbers in these columns; all columns of numbers where none is named.
///
/// A label is the column's name and the value; where the table has several rows, also what tells them apart in the columns before the
/// first of these.
pub fn guides(table: &Table, columns: &[String], axis: GuideAxis, names: &BTreeMap<String, String>) -> Result<Vec<Guide>, CurveError> {
    let names = &with_names_of_files(names, table.rows.iter().flatten());
    let chosen = if columns.is_empty() {
        let is_numbers = |column: &usize| table.rows.iter().any(|row| matches!(row[*column], Cell::Number(_)));
        (0..table.columns.len()).filter(is_numbers).collect()
    } else {
        table.required_columns(columns)?
    };
    let first = chosen.iter().copied().min().unwrap_or(0);
    let labels: Vec<usize> = (0..first).filter(|column| varies(table, *column)).collect();
    let mut guides = Vec::new();
    for row in &table.rows {
        let context: Vec<String> = labels.iter().filter_map(|column| value_label(&table.columns[*column], &row[*column], names)).collect();
        let context = if context.is_empty() { String::new() } else { format!(" ({})", context.join(", ")) };
        for &column in &chosen {
            let Some(at) = finite_number(&table.columns[column], &row[column])? else { continue };
            let Column { unit, .. } = &table.columns[column];
            let sign = unit_sign(unit);
            let space = if sign.is_empty() || sign == "°" { "" } else { " " };
            let name = capitalized(&column_label(&table.columns[column], names));
            let label = format!("{name} {}{space}{sign}{context}", significant(at, 4));
            guides.push(Guide { axis, at, label });
        }
    }
    Ok(guides)
}

fn capitalized(word: &str) -> String {
    let mut letters = word.chars();
    letters.next().map_or(String::new(), |first| first.to_uppercase().chain(letters).collect())
}

fn varies(table: &Table, column: usize) -> bool {
    table.rows.iter().any(|row| row[column] != table.rows[0][column])
}

/// The number in a cell; `None` for an empty cell and for what is not finite.
fn finite_number(column: &Column, cell: &Cell) -> Result<Option<f64>, CurveError> {
    match cell {
        Cell::Empty => Ok(None),
        Cell::Integer(_) | Cell::Number(_) => Ok(cell.number().filter(|value| value.is_finite())),
        Cell::Boolean(_) | Cell::Text(_) => Err(CurveError::NotNumbers { column: column.name.clone(), found: cell.to_string() }),
    }
}

/// A column's name for readers: as `names` has it, else without the unit at its end and with spaces.
fn column_label(column: &Column, names: &BTreeMap<String, String>) -> String {
    if let Some(name) = names.get(&column.name) {
        return name.clone();
    }
    let suffix = format!("_{}", column.unit);
    let bare = if column.unit.is_empty() { &column.name } else { column.name.strip_suffix(&suffix).unwrap_or(&column.name) };
    bare.replace('_', " ")
}

/// A value for the legend: text by itself, a number with its column's name; nothing for an empty cell.
pub fn value_label(column: &Column, cell: &Cell, names: &BTreeMap<String, String>) -> Option<String> {
    let text = cell.to_string();
    match cell {
        Cell::Empty => None,
        _ if names.contains_key(&text) => names.get(&text).cloned(),
        Cell::Text(_) => Some(text),
        Cell::Boolean(_) | Cell::Integer(_) | Cell::Number(_) => {
            // Spaces that do not break keep name and value on one line.
            Some(format!("{}\u{a0}=\u{a0}{}{}", column_label(column, names), text.replace('-', "−"), unit_sign(&column.unit)))
        }
    }
}

/// Adds to `names` one for each file among the values: as little of the end of its path as tells it from the other
/// files, without the ending.
pub fn with_names_of_files<'c>(names: &BTreeMap<String, String>, cells: impl Iterator<Item = &'c Cell>) -> BTreeMap<String, String> {
    let path_of = |cell: &'c Cell| match cell {
        Cell::Text(text) if is_file_path(text) && !names.contains_key(text) => Some(text.as_str()),
        _ => None,
    };
    let paths: BTreeSet<&str> = cells.filter_map(path_of).collect();
    let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
    for tail in paths.iter().flat_map(|path| path_tails(path)) {
        *counts.entry(tail).or_default() += 1;
    }
    let name_of = |path: &&str| ((*path).to_owned(), path_tails(path).find(|tail| counts[tail] == 1).unwrap_or(path).to_owned());
    names.clone().into_iter().chain(paths.iter().map(name_of)).collect()
}

/// Whether a text is folders and a file with an ending, not `on/off`.
fn is_file_path(text: &str) -> bool {
    text.rsplit_once('/').and_then(|(_, file)| file.rsplit_once('.')).is_some_and(|(stem, ending)| !stem.is_empty() && !ending.is_empty())
}

/// The file's name without its ending, then with one more folder at a time.
fn path_tails(path: &str) -> impl Iterator<Item = &str> {
    let bare = path.rsplit_once('.').map_or(path, |(bare, _)| bare);
    bare.rmatch_indices('/').map(|(slash, _)| &bare[slash + 1..]).chain([bare])
}

/// Positions of the columns that a request names.
struct Columns {
    x: usize,
    series: Vec<usize>,
    repeat: Option<usize>,
    stage: Option<usize>,
}

impl Columns {
    fn of(table: &Table, request: &Request) -> Result<Self, TableError> {
        let x = table.required_column(&request.x)?;
        let series = table.required_columns(&request.series)?;
        let repeat = request.repeat.as_ref().map(|name| table.required_column(name)).transpose()?;
        let stage = table.column("stage").filter(|stage| *stage != x && !series.contains(stage) && varies(table, *stage));
        Ok(Self { x, series, repeat, stage })
    }
}

/// The rows of one curve of one y column.
struct Group<'t> {
    label: String,
    rows: Vec<&'t [Cell]>,
}

/// Rows that belong together, with a label for the legend.
///
/// Where several stages were collected, each has curves of its own; its name is in the label unless the series alone tell them apart.
fn groups<'t>(table: &'t Table, columns: &Columns, names: &BTreeMap<String, String>) -> Vec<Group<'t>> {
    let keys: Vec<usize> = columns.series.iter().chain(&columns.stage).copied().collect();
    let label_of = |row: &[Cell], keys: &[usize]| -> String {
        keys.iter().filter_map(|key| value_label(&table.columns[*key], &row[*key], names)).collect::<Vec<_>>().join(", ")
    };
    let groups = table.groups(&keys);
    let plain: Vec<String> = groups.iter().map(|rows| label_of(rows[0], &columns.series)).collect();
    let is_clear = |label: &String| !label.is_empty() && plain.iter().filter(|other| *other == label).count() == 1;
    let stage_first: Vec<usize> = columns.stage.iter().chain(&columns.series).copied().collect();
    groups
        .into_iter()
        .zip(&plain)
        .map(|(rows, plain)| Group { label: if is_clear(plain) { plain.clone() } else { label_of(rows[0], &stage_first) }, rows })
        .collect()
}

fn curve_chart(table: &Table, request: &Request, look: Look) -> Result<Chart, CurveError> {
    let columns = Columns::of(table, request)?;
    let y_columns = table.required_columns(&request.y)?;
    let groups = groups(table, &columns, &request.names);
    let categories = categories(table, columns.x);
    let mut left_out = 0;
    let mut curves = Vec::new();
    for (group_index, group) in groups.iter().enumerate() {
        for (y_index, &y) in y_columns.iter().enumerate() {
            let measured = Measured { table, columns: &columns, y, categories: &categories, request };
            let (points, level) = measured.points(group, &mut left_out)?;
            let is_crossed = groups.len() > 1 && y_columns.len() > 1;
            let index = if is_crossed { group_index } else { group_index.max(y_index) };
            let label = curve_label(&group.label, &table.columns[y], y_columns.len() > 1, &request.names);
            let styles = if is_crossed { [index, y_index] } else { [index, index / 7] };
            let entry = |look, points, fit| Curve {
                label: label.clone(),
                look,
                hue: styles[0],
                dash: styles[1],
                points,
                interval: request.interval,
                fit,
            };
            if !points.is_empty() {
                let fit = request.fit.and_then(|range| fitted(&points, range));
                curves.push(entry(look, points, fit));
            }
            curves.extend(level.map(|point| entry(Look::Level, vec![point], None)));
        }
    }
    let mut notes = repetition_note(&curves, request);
    if left_out > 0 {
        notes.push(format!("{left_out} {} not finite and not shown.", if left_out == 1 { "value is" } else { "values are" }));
    }
    Ok(Chart {
        title: request.title.clone(),
        size_mm: request.size_mm,
        x: Axis { categories, ..axis(&[&table.columns[columns.x]], request, 0) },
        y: axis(&y_columns.iter().map(|y| &table.columns[*y]).collect::<Vec<_>>(), request, 1),
        curves,
        guides: Vec::new(),
        heat: None,
        notes,
    })
}

fn curve_label(group: &str, y: &Column, names_y: bool, names: &BTreeMap<String, String>) -> String {
    let y = column_label(y, names);
    match (names_y, group.is_empty()) {
        (false, _) => group.to_owned(),
        (true, true) => y,
        (true, false) => format!("{y}, {group}"),
    }
}

/// The axis of these columns: x is number 0, y is 1, the colors are 2.
fn axis(columns: &[&Column], request: &Request, number: usize) -> Axis {
    let unit = &columns[0].unit;
    let unit = if columns.iter().all(|column| column.unit == *unit) { unit.clone() } else { String::new() };
    let name = if columns.len() == 1 { column_label(columns[0], &request.names) } else { String::new() };
    let label = request.labels[number].clone().unwrap_or(name);
    let scale = request.scales[number];
    Axis { label, unit, scale, range: request.ranges.get(number).copied().flatten(), categories: Vec::new() }
}

/// Names of positions, in order of appearance, where a column holds more than numbers.
fn categories(table: &Table, column: usize) -> Vec<String> {
    if !table.rows.iter().any(|row| matches!(row[column], Cell::Text(_) | Cell::Boolean(_))) {
        return Vec::new();
    }
    let mut categories: Vec<String> = Vec::new();
    for cell in table.rows.iter().map(|row| &row[column]).filter(|cell| **cell != Cell::Empty) {
        if !categories.contains(&cell.to_string()) {
            categories.push(cell.to_string());
        }
    }
    categories
}

/// Where a cell stands on an axis with these categories.
fn position(column: &Column, cell: &Cell, categories: &[String]) -> Result<Option<f64>, CurveError> {
    if categories.is_empty() {
        return finite_number(column, cell);
    }
    Ok(categories.iter().position(|category| *category == cell.to_string()).map(|index| index as f64))
}

/// One y column of a table.
struct Measured<'a> {
    table: &'a Table,
    columns: &'a Columns,
    y: usize,
    categories: &'a [String],
    request: &'a Request,
}

impl Measured<'_> {
    /// The points of a group, and the one that holds for all x.
    fn points(&self, group: &Group<'_>, left_out: &mut usize) -> Result<(Vec<Point>, Option<Point>), CurveError> {
        let mut values: Vec<(Option<f64>, f64, &[Cell])> = Vec::new();
        for &row in &group.rows {
            let x = position(&self.table.columns[self.columns.x], &row[self.columns.x], self.categories)?;
            let is_for_all = row[self.columns.x] == Cell::Empty;
            match finite_number(&self.table.columns[self.y], &row[self.y])? {
                Some(y) if x.is_some() || is_for_all => values.push((x, y, row)),
                _ if row[self.y] == Cell::Empty => {}
                _ => *left_out += 1,
            }
        }
        if self.request.repeat.is_none() && self.request.form == Form::Curve(Look::Points) {
            let points = values.iter().filter_map(|(x, y, _)| Some(Point::single((*x)?, *y)));
            return Ok((points.collect(), self.mean_at(None, &values, group)?));
        }
        // Lines are drawn from left to right, whatever the order of the rows.
        let mut places: Vec<f64> = values.iter().filter_map(|(x, _, _)| *x).collect();
        places.sort_by(f64::total_cmp);
        if self.request.repeat.is_some() {
            places.dedup();
            let points = places.iter().map(|x| self.mean_at(Some(*x), &values, group)).collect::<Result<Vec<_>, _>>()?;
            return Ok((points.into_iter().flatten().collect(), self.mean_at(None, &values, group)?));
        }
        let mut points: Vec<Point> = values.iter().filter_map(|(x, y, _)| Some(Point::single((*x)?, *y))).collect();
        points.sort_by(|a, b| a.x.total_cmp(&b.x));
        Ok((points, self.mean_at(None, &values, group)?))
    }

    /// The mean of the repetitions at `x`, or of those that hold for all x.
    fn mean_at(&self, x: Option<f64>, values: &[(Option<f64>, f64, &[Cell])], group: &Group<'_>) -> Result<Option<Point>, CurveError> {
        let here = || values.iter().filter(|(at, _, _)| *at == x);
        let numbers: Vec<f64> = here().map(|(_, y, _)| *y).collect();
        if let (Some(repeat), Some(name)) = (self.columns.repeat, &self.request.repeat) {
            let mut seen: Vec<String> = Vec::new();
            for (_, _, row) in here() {
                let repetition = row[repeat].to_string();
                if seen.contains(&repetition) {
                    let (series, x_column) = (group.label.clone(), self.request.x.clone());
                    return Err(CurveError::RepeatedTwice {
                        series,
                        x_column,
                        x: row[self.columns.x].to_string(),
                        repeat: name.clone(),
                        repetition,
                    });
                }
                seen.push(repetition);
            }
        }
        let estimate = estimate::mean_interval(&numbers, self.request.level);
        let place = x.unwrap_or_default();
        Ok(estimate.map(|estimate| Point { x: place, y: estimate.mean, interval: estimate.interval, count: estimate.count }))
    }
}

fn fitted(points: &[Point], [from, to]: [f64; 2]) -> Option<PowerLaw> {
    let used: Vec<[f64; 2]> = points.iter().filter(|point| from <= point.x && point.x <= to).map(|point| [point.x, point.y]).collect();
    estimate::power_law(&used)
}

/// How many measurements each mean is made of, and what its interval is.
fn repetition_note(curves: &[Curve], request: &Request) -> Vec<String> {
    let Some(repeat) = &request.repeat else { return Vec::new() };
    let points = curves.iter().filter(|curve| curve.look != Look::Level).flat_map(|curve| &curve.points);
    let counts: Vec<usize> = points.map(|point| point.count).collect();
    let Some(number) = number_of_values(&counts) else { return Vec::new() };
    let interval = match request.interval {
        IntervalLook::Whiskers => "error bars",
        IntervalLook::Band => "bands",
    };
    let name = column_label(&Column::new(repeat, ""), &request.names);
    let level = format!("{} %", Cell::from_number((request.level * 1e6).round() / 1e4));
    let tail =
        if counts.iter().any(|count| *count > 1) { format!("; {interval} show the {level} interval (Student t)") } else { String::new() };
    vec![format!("Each point is the mean of {number} values over {name}{tail}.")]
}

/// `16`, or `8 to 16` where they differ.
fn number_of_values(counts: &[usize]) -> Option<String> {
    let (least, most) = (counts.iter().min()?, counts.iter().max()?);
    Some(if least == most { least.to_string() } else { format!("{least} to {most}") })
}

fn histogram(table: &Table, request: &Request) -> Result<Chart, CurveError> {
    let columns = Columns::of(table, request)?;
    let column = &table.columns[columns.x];
    let scale = request.scales[0];
    let groups = groups(table, &columns, &request.names);
    let mut sets: Vec<Vec<f64>> = Vec::new();
    for group in &groups {
        let numbers = group.rows.iter().map(|row| finite_number(column, &row[columns.x])).collect::<Result<Vec<_>, _>>()?;
        sets.push(numbers.into_iter().flatten().filter(|value| scale == Scale::Linear || *value > 0.0).collect());
    }
    let edges = bin_edges(&sets.concat(), request.bins, scale);
    let curves = groups.iter().zip(&sets).enumerate().map(|(index, (group, values))| Curve {
        label: group.label.clone(),
        look: Look::Filled,
        hue: index,
        dash: index / 7,
        points: counted(values, &edges),
        interval: IntervalLook::Whiskers,
        fit: None,
    });
    let count: usize = sets.iter().map(Vec::len).sum();
    let y = Axis { label: request.labels[1].clone().unwrap_or("count".into()), ..axis(&[&Column::new("count", "")], request, 1) };
    Ok(Chart {
        title: request.title.clone(),
        size_mm: request.size_mm,
        x: axis(&[column], request, 0),
        y,
        curves: curves.collect(),
        guides: Vec::new(),
        heat: None,
        notes: vec![format!("{count} values in {} bins.", edges.len() - 1)],
    })
}

/// Borders of bins of equal width (equal ratio on a logarithmic axis) that hold all values.
fn bin_edges(values: &[f64], bins: Option<usize>, scale: Scale) -> Vec<f64> {
    let bins = bins.unwrap_or(((values.len() as f64).sqrt().ceil() as usize).clamp(5, 60));
    let [low, high] = values.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], value| [low.min(*value), high.max(*value)]);
    let [low, high] = match scale {
        _ if low > high => [1.0, 2.0],
        Scale::Linear if low == high => [low - 0.5, high + 0.5],
        Scale::Logarithmic if low == high => [low / 2.0, high * 2.0],
        _ => [low, high],
    };
    let at = |fraction: f64| match scale {
        Scale::Linear => low + (high - low) * fraction,
        Scale::Logarithmic => low * elementary::pow(high / low, fraction),
    };
    (0..=bins).map(|index| if index == bins { high } else { at(index as f64 / bins as f64) }).collect()
}

/// How many values fall between each two borders; the last border belongs to the last bin.
fn counted(values: &[f64], edges: &[f64]) -> Vec<Point> {
    let bins = edges.len() - 1;
    let mut counts = vec![0_u32; bins];
    for value in values {
        let bin = edges[1..bins].partition_point(|edge| edge <= value);
        counts[bin] += 1;
    }
    (0..=bins).map(|index| Point::single(edges[index], f64::from(counts[index.min(bins - 1)]))).collect()
}

fn heat_map(table: &Table, request: &Request) -> Result<Chart, CurveError> {
    let columns = Columns::of(table, request)?;
    let y = table.required_column(request.y.first().map_or("", String::as_str))?;
    let value = table.required_column(request.value.as_deref().unwrap_or_default())?;
    let [x_categories, y_categories] = [columns.x, y].map(|column| categories(table, column));
    let place = |row: &[Cell]| -> Result<Option<[f64; 2]>, CurveError> {
        let across = position(&table.columns[columns.x], &row[columns.x], &x_categories)?;
        let up = position(&table.columns[y], &row[y], &y_categories)?;
        Ok(across.zip(up).map(|(across, up)| [across, up]))
    };
    let placed = table.rows.iter().map(|row| Ok((place(row)?, row))).collect::<Result<Vec<_>, CurveError>>()?;
    let coordinates = [0, 1].map(|k| distinct(placed.iter().filter_map(|(place, _)| place.map(|place| place[k]))));
    let [xs, ys] = &coordinates;
    if xs.is_empty() {
        return Err(CurveError::Empty);
    }
    let mut cells: Vec<Vec<(f64, &Vec<Cell>)>> = vec![Vec::new(); xs.len() * ys.len()];
    for (place, row) in &placed {
        let (Some([across, up]), Some(number)) = (place, finite_number(&table.columns[value], &row[value])?) else { continue };
        let [column, line] = [(xs, across), (ys, up)].map(|(values, at)| values.iter().position(|value| value == at).unwrap_or_default());
        cells[line * xs.len() + column].push((number, row));
    }
    if let Some(cell) = cells.iter().find(|cell| cell.len() > 1 && request.repeat.is_none()) {
        let row = cell[0].1;
        let (x_column, y_column) = (request.x.clone(), table.columns[y].name.clone());
        return Err(CurveError::CellTwice { x_column, x: row[columns.x].to_string(), y_column, y: row[y].to_string() });
    }
    let mean =
        |cell: &Vec<(f64, &Vec<Cell>)>| estimate::mean_interval(&cell.iter().map(|(value, _)| *value).collect::<Vec<_>>(), request.level);
    let counts: Vec<usize> = cells.iter().map(Vec::len).filter(|count| *count > 0).collect();
    let repeat = request.repeat.as_ref().zip(number_of_values(&counts));
    let notes = repeat.map(|(repeat, number)| format!("Each color is the mean of {number} values over {repeat}.")).into_iter().collect();
    let heat = Heat {
        x_edges: borders(xs, request.scales[0]),
        y_edges: borders(ys, request.scales[1]),
        values: cells.iter().map(|cell| mean(cell).map(|estimate| estimate.mean)).collect(),
        axis: axis(&[&table.columns[value]], request, 2),
        x_values: coordinates[0].clone(),
        y_values: coordinates[1].clone(),
    };
    Ok(Chart {
        title: request.title.clone(),
        size_mm: request.size_mm,
        x: Axis { categories: x_categories, ..axis(&[&table.columns[columns.x]], request, 0) },
        y: Axis { categories: y_categories, ..axis(&[&table.columns[y]], request, 1) },
        curves: Vec::new(),
        guides: Vec::new(),
        heat: Some(heat),
        notes,
    })
}

fn distinct(values: impl Iterator<Item = f64>) -> Vec<f64> {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values.dedup();
    values
}

/// Borders half-way between neighbors (by ratio on a logarithmic axis), the outer ones as far out as the inner ones are in.
fn borders(values: &[f64], scale: Scale) -> Vec<f64> {
    let is_logarithmic = scale == Scale::Logarithmic && values.iter().all(|value| *value > 0.0);
    let places: Vec<f64> = values.iter().map(|value| if is_logarithmic { elementary::ln(*value) } else { *value }).collect();
    let last = places.len() - 1;
    let half = |index: usize| if last == 0 { 0.5 } else { (places[index + 1] - places[index]) / 2.0 };
    let mut borders = vec![places[0] - half(0)];
    borders.extend((0..last).map(|index| places[index] + half(index)));
    borders.push(places[last] + half(last.saturating_sub(1)));
    borders.into_iter().map(|border| if is_logarithmic { elementary::exp(border) } else { border }).collect()
}

/// Says how many points a logarithmic axis cannot show.
fn note_hidden(chart: &mut Chart) {
    let is_hidden = |point: &&Point| {
        (chart.x.scale == Scale::Logarithmic && chart.x.categories.is_empty() && point.x <= 0.0)
            || (chart.y.scale == Scale::Logarithmic && point.y <= 0.0)
    };
    let counted = chart.curves.iter().filter(|curve| matches!(curve.look, Look::Line | Look::Points | Look::Steps));
    let hidden = counted.flat_map(|curve| &curve.points).filter(is_hidden).count();
    if hidden > 0 {
        let points = if hidden == 1 { "point is" } else { "points are" };
        chart.notes.push(format!("{hidden} {points} at or below 0 and not shown on a logarithmic axis."));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::figure::table::{Part, collect};

    fn request(x: &str, y: &[&str]) -> Request {
        Request {
            form: Form::Curve(Look::Line),
            x: x.into(),
            y: y.iter().map(|name| (*name).into()).collect(),
            value: None,
            series: Vec::new(),
            repeat: None,
            level: 0.95,
            interval: IntervalLook::Whiskers,
            fit: None,
            scales: [Scale::Linear; 3],
            names: BTreeMap::new(),
            title: String::new(),
            labels: [None, None, None],
            ranges: [None, None],
            bins: None,
            size_mm: [120.0, 80.0],
        }
    }

    fn one(value: f64) -> Table {
        let mut table = Table::new(vec![Column::new("rmse", "")]);
        table.push(vec![Cell::Number(value)]);
        table
    }

    /// The error of two methods at three counts in four runs, and a floor without any axis.
    fn sweep() -> Collection {
        let mut tables = Vec::new();
        for (method, slope) in [("iid", -0.5), ("rows", -0.25)] {
            for n in [256_i128, 16, 64] {
                for run in 0..4_i128 {
                    let axes: Vec<(String, Cell)> = vec![
                        ("method".into(), Cell::Text(method.into())),
                        ("n".into(), Cell::Integer(n)),
                        ("run".into(), Cell::Integer(run)),
                    ];
                    tables.push(("error", axes, one(elementary::pow(n as f64, slope) * (1.0 + 0.1 * (run as f64 - 1.5)))));
                }
            }
        }
        tables.push(("floor", Vec::new(), one(0.01)));
        let parts: Vec<Part<'_>> = tables.iter().map(|(label, axes, table)| Part { label, axes, table }).collect();
        collect(&parts).unwrap()
    }

    #[test]
    fn files_are_named_by_as_little_of_their_paths_as_tells_them_apart() {
        let cell = |text: &str| Cell::Text(text.into());
        let texts = ["../maps/grace.pfm", "studio.hdr", "on/off", "1k/noon.hdr", "2k/noon.hdr", "a/x.exr", "a/x.hdr", "maps/own.pfm", ".."];
        let cells: Vec<Cell> = texts.map(cell).into();
        let own = BTreeMap::from([("maps/own.pfm".to_owned(), "Own".to_owned())]);
        let names = with_names_of_files(&own, cells.iter().chain(&cells));
        let label = |text: &str| value_label(&Column::new("map", ""), &cell(text), &names).unwrap();
        assert_eq!(texts.map(label), ["grace", "studio.hdr", "on/off", "1k/noon", "2k/noon", "a/x.exr", "a/x.hdr", "Own", ".."]);
    }

    fn swept() -> Request {
        let (series, repeat) = (vec!["method".into()], Some("run".into()));
        Request { series, repeat, scales: [Scale::Logarithmic; 3], fit: Some([0.0, f64::INFINITY]), ..request("n", &["rmse"]) }
    }

    #[test]
    fn repetitions_become_means_with_intervals_counts_and_slopes() {
        let chart = chart(&sweep(), &swept()).unwrap();
        assert_eq!(chart.curves.iter().map(|curve| curve.label.as_str()).collect::<Vec<_>>(), ["iid", "rows", "floor"]);
        let iid = &chart.curves[0];
        assert_eq!(iid.points.iter().map(|point| point.x).collect::<Vec<_>>(), [16.0, 64.0, 256.0]);
        assert!(iid.points.iter().all(|point| point.count == 4));
        assert!((iid.points[0].y - 0.25).abs() < 1e-15);
        // s = 0.25 x 0.1 sqrt(5/3), t(0.975, 3) = 3.182446.
        let half = 3.182_446_305 * 0.25 * 0.1 * (5.0_f64 / 3.0).sqrt() / 2.0;
        assert!((iid.points[0].interval.unwrap()[1] - 0.25 - half).abs() < 1e-9);
        assert!((iid.fit.unwrap().slope + 0.5).abs() < 1e-12);
        assert!((chart.curves[1].fit.unwrap().slope + 0.25).abs() < 1e-12);
        assert_eq!(chart.notes, ["Each point is the mean of 4 values over run; error bars show the 95 % interval (Student t)."]);
    }

    #[test]
    fn a_row_without_x_holds_for_all_x() {
        let chart = chart(&sweep(), &swept()).unwrap();
        let floor = chart.curves.last().unwrap();
        assert_eq!((floor.look, floor.points[0].y), (Look::Level, 0.01));
    }

    #[test]
    fn an_axis_that_was_forgotten_is_told() {
        let forgotten = Request { series: Vec::new(), ..swept() };
        let error = chart(&sweep(), &forgotten).unwrap_err();
        assert!(matches!(&error, CurveError::RepeatedTwice { x, .. } if x == "16"), "{error}");
    }

    #[test]
    fn a_missing_column_is_named_with_those_there_are() {
        let error = chart(&sweep(), &request("n", &["rsme"])).unwrap_err();
        assert_eq!(error.to_string(), "no column `rsme`; there are `stage`, `method`, `n`, `run`, `rmse`");
    }

    #[test]
    fn text_cannot_be_drawn_upwards_but_stands_side_by_side_across() {
        assert!(matches!(chart(&sweep(), &request("n", &["method"])), Err(CurveError::NotNumbers { .. })));
        let bars =
            Request { form: Form::Curve(Look::Bars), series: vec!["n".into()], repeat: Some("run".into()), ..request("method", &["rmse"]) };
        let chart = chart(&sweep(), &bars).unwrap();
        assert_eq!(chart.x.categories, ["iid", "rows"]);
        assert_eq!(chart.curves[0].label, "n\u{a0}=\u{a0}256");
    }

    #[test]
    fn a_histogram_counts_every_value_once() {
        let histogram = Request { form: Form::Histogram, bins: Some(7), ..request("rmse", &[]) };
        let chart = chart(&sweep(), &histogram).unwrap();
        let count: f64 = chart.curves.iter().map(|curve| curve.points[..7].iter().map(|point| point.y).sum::<f64>()).sum();
        assert_eq!(count, 25.0);
    }

    #[test]
    fn a_heat_map_has_a_mean_for_each_cell_and_refuses_two_values() {
        let heat = Request { form: Form::HeatMap, value: Some("rmse".into()), repeat: Some("run".into()), ..request("n", &["method"]) };
        let map = chart(&sweep(), &heat).unwrap().heat.unwrap();
        assert_eq!((map.x_values.as_slice(), map.values.len()), (&[16.0, 64.0, 256.0][..], 6));
        assert!((map.values[0].unwrap() - 0.25).abs() < 1e-15);
        assert!(matches!(chart(&sweep(), &Request { repeat: None, ..heat }), Err(CurveError::CellTwice { .. })));
    }

    #[test]
    fn guide_lines_carry_their_value_and_what_tells_them_apart() {
        let mut angles = Table::new(vec![Column::new("eta", ""), Column::new("brewster_deg", "deg")]);
        for eta in [1.4, 1.45] {
            angles.push(vec![Cell::Number(eta), Cell::Number(elementary::atan(eta).to_degrees())]);
        }
        let guides = guides(&angles, &["brewster_deg".into()], GuideAxis::X, &BTreeMap::new()).unwrap();
        assert_eq!(guides[0].label, "Brewster 54.46° (eta\u{a0}=\u{a0}1.4)");
        assert_eq!(guides[1].label, "Brewster 55.41° (eta\u{a0}=\u{a0}1.45)");
    }

    #[test]
    fn what_a_logarithmic_axis_hides_is_said() {
        let mut table = one(0.0);
        table.push(vec![Cell::Number(2.0)]);
        table.push(vec![Cell::Number(f64::NAN)]);
        let collection = collect(&[Part { label: "a", axes: &[], table: &table }]).unwrap();
        let logarithmic = Request { scales: [Scale::Logarithmic; 3], ..request("rmse", &["rmse"]) };
        let notes = chart(&collection, &logarithmic).unwrap().notes;
        assert_eq!(notes, ["1 value is not finite and not shown.", "1 point is at or below 0 and not shown on a logarithmic axis."]);
    }
}

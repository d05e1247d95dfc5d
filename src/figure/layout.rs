//! Where everything in a figure stands on its paper.
//!
//! Lengths are in points. Room is given from the outside in: title, notes and legend first, then the
//! labels of the axes, and the frame has the rest; the page grows where the frame would be too low. Nothing
//! is drawn over data but data: the legend stands outside, names of guide lines above the frame.

use super::axis::{self, Reach, Span, Tick, Ticks};
use super::canvas::{Anchor, Canvas, Ink, Label, clipped_area, clipped_line};
use super::chart::{Axis, Chart, Curve, Guide, GuideAxis, Heat, IntervalLook, Look, Point, Scale};
use super::palette::{self, BLACK, FINE_GRID, GREY, GRID, WHITE};
use super::text::{self, CAPITAL_HEIGHT};
use crate::math::elementary;

const POINTS_PER_MM: f64 = 72.0 / 25.4;
const TITLE_SIZE: f64 = 10.5;
const LABEL_SIZE: f64 = 9.0;
const TICK_SIZE: f64 = 8.0;
const LEGEND_SIZE: f64 = 8.0;
const NOTE_SIZE: f64 = 6.5;
/// Line spacing as a multiple of the font's size.
const LEADING: f64 = 1.35;
/// Free paper around everything.
const BORDER: f64 = 5.0;
const GAP: f64 = 4.0;
const TICK_LENGTH: f64 = 3.0;
/// Width of the sample of a curve in the legend.
const SAMPLE_WIDTH: f64 = 20.0;
const LEAST_FRAME_HEIGHT: f64 = 90.0;
/// The frame has at least this part of the height that was asked for.
const LEAST_FRAME_SHARE: f64 = 0.55;
const LINE_WIDTH: f64 = 1.4;
const MARKER_RADIUS: f64 = 2.3;
/// Lines with more points than this have no markers.
const MARKER_LIMIT: usize = 40;
const COLOR_BAR_WIDTH: f64 = 9.0;

/// The chart as a drawing.
pub fn canvas(chart: &Chart) -> Canvas {
    let page = Page::of(chart);
    let mut canvas = Canvas { width: page.size[0], height: page.size[1], marks: Vec::new() };
    canvas.rectangle([0.0, 0.0], page.size, WHITE);
    draw_heat(&mut canvas, chart, &page);
    draw_axes(&mut canvas, chart, &page);
    draw_guides(&mut canvas, &page);
    draw_bands(&mut canvas, chart, &page.frame);
    for (index, curve) in chart.curves.iter().enumerate() {
        draw_curve(&mut canvas, chart, index, curve, &page.frame);
    }
    draw_frame(&mut canvas, &page.frame);
    draw_texts(&mut canvas, chart, &page);
    canvas
}

/// The rectangle in which data are drawn, with the numbers along its sides.
struct Frame {
    /// Upper left corner.
    low: [f64; 2],
    /// Lower right corner.
    high: [f64; 2],
    x: Span,
    y: Span,
}

impl Frame {
    fn at_x(&self, value: f64) -> f64 {
        self.low[0] + self.x.fraction_or_below(value) * (self.high[0] - self.low[0])
    }

    fn at_y(&self, value: f64) -> f64 {
        self.high[1] - self.y.fraction_or_below(value) * (self.high[1] - self.low[1])
    }

    fn at(&self, x: f64, y: f64) -> [f64; 2] {
        [self.at_x(x), self.at_y(y)]
    }

    fn contains(&self, point: [f64; 2]) -> bool {
        (0..2).all(|k| self.low[k] - 0.01 <= point[k] && point[k] <= self.high[k] + 0.01)
    }
}

/// A guide line with the place of its label.
struct PlacedGuide<'a> {
    guide: &'a Guide,
    /// Number of the line of text above the frame, from below.
    row: usize,
    /// Left end of its label.
    start: f64,
    size: f64,
}

/// Everything that is measured before something is drawn.
struct Page<'a> {
    size: [f64; 2],
    title: Vec<String>,
    notes: Vec<String>,
    legend: Legend,
    frame: Frame,
    x_ticks: Ticks,
    /// The lines of each label below the frame.
    x_labels: Vec<Vec<String>>,
    x_label_size: f64,
    y_ticks: Ticks,
    /// The lines of the label at the left.
    y_title: Vec<String>,
    guides: Vec<PlacedGuide<'a>>,
    /// Left edge of what stands right of the frame: names of level guides, the color bar, the legend.
    beside: f64,
    color_ticks: Ticks,
}

impl<'a> Page<'a> {
    fn of(chart: &'a Chart) -> Self {
        let width = chart.size_mm[0] * POINTS_PER_MM;
        let inner = width - 2.0 * BORDER;
        let title = text::wrapped(&chart.title, TITLE_SIZE, inner);
        let notes: Vec<String> = chart.notes.iter().flat_map(|note| text::wrapped(note, NOTE_SIZE, inner)).collect();
        let legend = Legend::of(chart, width);

        let title_height = if title.is_empty() { 0.0 } else { lines_height(&title, TITLE_SIZE) + GAP };
        let label_height = if chart.x.label.is_empty() && chart.x.unit.is_empty() { 0.0 } else { line_height(LABEL_SIZE) + 1.0 };
        let notes_height = if notes.is_empty() { 0.0 } else { lines_height(&notes, NOTE_SIZE) + GAP };
        let under_numbers = BORDER + TICK_LENGTH + 2.0 + label_height + legend.height_below() + notes_height;
        let above = BORDER + title_height + CAPITAL_HEIGHT * TICK_SIZE / 2.0;

        let [x, y] = spans(chart);
        let paper_height = chart.size_mm[1] * POINTS_PER_MM;
        let least_height = LEAST_FRAME_HEIGHT.max(LEAST_FRAME_SHARE * paper_height);
        let tentative = (paper_height - above - under_numbers - line_height(TICK_SIZE)).max(least_height);
        let y_ticks = axis::ticks(&chart.y, y, label_count(y, tentative), &own_y(chart));
        // The frame is at least that high, so the label stays beside it.
        let y_title = text::wrapped(&axis::title(&chart.y, y_ticks.exponent), LABEL_SIZE, least_height);
        let left =
            BORDER + y_title.len().max(1) as f64 * line_height(LABEL_SIZE) + GAP + widest(&y_ticks.major, TICK_SIZE) + 2.0 + TICK_LENGTH;
        let color_ticks = chart.heat.as_ref().map(|heat| color_ticks(heat, tentative)).unwrap_or_default();
        let beside_width = beside_width(chart, &color_ticks) + legend.width_beside();
        let room = width - left - BORDER - beside_width;
        let x_ticks = fitting_x_ticks(chart, x, room);
        let overhang = x_ticks.major.last().map_or(0.0, |tick| overhang_of(tick, x, room));
        let right = width - BORDER - beside_width.max(overhang);
        let (x_labels, x_label_size) = x_labels(chart, &x_ticks, right - left);

        let guides = placed_guides(chart, x, left, right, width);
        let guide_height = guides.iter().map(|placed| placed.row + 1).max().map_or(0.0, |rows| rows as f64 * line_height(TICK_SIZE) + 2.0);
        let top = above + guide_height;
        let below = under_numbers + numbers_height(&x_labels);
        let height = paper_height.max(top + below + least_height.max(legend.least_frame_height()));
        let frame = Frame { low: [left, top], high: [right, height - below], x, y };
        let beside = right + 2.0 * GAP;
        Self {
            size: [width, height],
            title,
            notes,
            legend,
            beside,
            frame,
            x_ticks,
            x_labels,
            x_label_size,
            y_ticks,
            y_title,
            guides,
            color_ticks,
        }
    }
}

fn line_height(size: f64) -> f64 {
    size * LEADING
}

fn lines_height(lines: &[String], size: f64) -> f64 {
    lines.len() as f64 * line_height(size)
}

fn widest(ticks: &[Tick], size: f64) -> f64 {
    ticks.iter().map(|tick| text::width(&tick.label, size)).fold(0.0, f64::max)
}

/// How far the label of the last value reaches beyond the frame.
fn overhang_of(tick: &Tick, span: Span, room: f64) -> f64 {
    let free = (1.0 - span.fraction_or_below(tick.value)) * room;
    (text::width(&tick.label, TICK_SIZE) / 2.0 - free).max(0.0)
}

/// The numbers along both sides.
fn spans(chart: &Chart) -> [Span; 2] {
    let points = || chart.curves.iter().filter(|curve| curve.look != Look::Level).flat_map(|curve| &curve.points);
    let heat_edges = |edges: fn(&Heat) -> &Vec<f64>| chart.heat.iter().flat_map(edges).copied();
    let is_bars = chart.curves.iter().any(|curve| matches!(curve.look, Look::Bars | Look::Filled));
    let has_markers = chart.curves.iter().any(|curve| has_markers(curve) || curve.look == Look::Bars);

    let x_margin = if chart.heat.is_none() && has_markers { 0.04 } else { 0.0 };
    let guides = |axis: GuideAxis| chart.guides.iter().filter(move |guide| guide.axis == axis).map(|guide| guide.at);
    let x_data = points().map(|point| point.x).chain(heat_edges(|heat| &heat.x_edges)).chain(guides(GuideAxis::X));
    let x = axis::span(&chart.x, x_data, Reach { margin: x_margin, is_from_zero: false });

    let y_margin = if chart.heat.is_some() { 0.0 } else { 0.04 };
    // What a logarithmic axis cannot show of an interval does not stretch it; nor does what the x range leaves out.
    let shown = chart.curves.iter().flat_map(|curve| curve.points.iter().map(move |point| (curve.look == Look::Level, point)));
    let shown = shown.filter(|(is_level, point)| *is_level || chart.x.range.is_none_or(|[low, high]| low <= point.x && point.x <= high));
    let ends = shown.flat_map(|(_, point)| [Some(point.y), point.interval.map(|i| i[0]), point.interval.map(|i| i[1])]).flatten();
    let zero = is_bars.then_some(0.0);
    // A fitted law is monotonic, so its ends are all that it needs.
    let is_in_x = |at: &f64| chart.x.range.is_none_or(|[low, high]| (low..=high).contains(at));
    let fits = chart.curves.iter().filter_map(|curve| curve.fit.as_ref());
    let fits = fits.flat_map(|fit| fit.range.into_iter().filter(is_in_x).map(|x| fit.at(x)));
    let y_data = ends.chain(fits).chain(heat_edges(|heat| &heat.y_edges)).chain(guides(GuideAxis::Y)).chain(zero);
    let y = axis::span(&chart.y, y_data, Reach { margin: y_margin, is_from_zero: chart.heat.is_none() });
    [x, y]
}

fn own_x(chart: &Chart) -> Vec<f64> {
    let points = chart.curves.iter().filter(|curve| curve.look != Look::Level).flat_map(|curve| &curve.points).map(|point| point.x);
    points.chain(chart.heat.iter().flat_map(|heat| heat.x_values.iter().copied())).collect()
}

/// Measured values are never labels of their own; rows of a heat map are.
fn own_y(chart: &Chart) -> Vec<f64> {
    chart.heat.iter().flat_map(|heat| heat.y_values.iter().copied()).collect()
}

/// How many labels have room along a side of that height.
fn label_count(span: Span, height: f64) -> f64 {
    match span.scale {
        Scale::Linear => height / 22.0,
        Scale::Logarithmic => height / 16.0,
    }
}

/// The lines of each label below the frame: one, but for names that are wider than their share of the side.
///
/// Names are first written smaller before words are cut.
fn x_labels(chart: &Chart, ticks: &Ticks, width: f64) -> (Vec<Vec<String>>, f64) {
    if chart.x.categories.is_empty() {
        return (ticks.major.iter().map(|tick| vec![tick.label.clone()]).collect(), TICK_SIZE);
    }
    let share = (width / chart.x.categories.len() as f64 - 3.0).max(TICK_SIZE);
    let words = || ticks.major.iter().flat_map(|tick| tick.label.split_ascii_whitespace()).flat_map(|word| word.split_inclusive('-'));
    let widest = words().map(|word| text::width(word, TICK_SIZE)).fold(0.0, f64::max);
    let size = TICK_SIZE * (share / widest.max(share)).max(0.62);
    (ticks.major.iter().map(|tick| text::wrapped(&tick.label, size, share)).collect(), size)
}

/// Height of the labels below the frame.
fn numbers_height(labels: &[Vec<String>]) -> f64 {
    labels.iter().map(|lines| lines_height(lines, TICK_SIZE)).fold(line_height(TICK_SIZE), f64::max)
}

/// As many numbers below the frame as stand apart; names all stay, and are broken into lines instead.
fn fitting_x_ticks(chart: &Chart, span: Span, room: f64) -> Ticks {
    let mut count = room / 30.0;
    let mut ticks = axis::ticks(&chart.x, span, count, &own_x(chart));
    if !chart.x.categories.is_empty() {
        return ticks;
    }
    while !stand_apart(&ticks.major, span, room) && count > 1.5 {
        count -= 1.0;
        ticks = axis::ticks(&chart.x, span, count, &own_x(chart));
    }
    let all = std::mem::take(&mut ticks.major);
    let mut strides = (1..=all.len()).map(|stride| all.iter().step_by(stride).cloned().collect::<Vec<_>>());
    ticks.major = strides.find(|kept| stand_apart(kept, span, room)).unwrap_or_default();
    ticks.minor.extend(all.iter().map(|tick| tick.value).filter(|value| ticks.major.iter().all(|tick| tick.value != *value)));
    ticks
}

fn stand_apart(ticks: &[Tick], span: Span, room: f64) -> bool {
    ticks.windows(2).all(|pair| {
        let distance = (span.fraction_or_below(pair[1].value) - span.fraction_or_below(pair[0].value)) * room;
        let half_widths = (text::width(&pair[0].label, TICK_SIZE) + text::width(&pair[1].label, TICK_SIZE)) / 2.0;
        distance > half_widths + 5.0
    })
}

/// Room right of the frame for names of level guides and the color bar.
fn beside_width(chart: &Chart, color_ticks: &Ticks) -> f64 {
    let names = chart.guides.iter().filter(|guide| guide.axis == GuideAxis::Y).map(|guide| text::width(&guide.label, TICK_SIZE));
    let names = names.fold(0.0, f64::max);
    let bar = COLOR_BAR_WIDTH + TICK_LENGTH + 2.0 + widest(&color_ticks.major, TICK_SIZE) + GAP + line_height(LABEL_SIZE);
    let bar = if chart.heat.is_some() { bar } else { 0.0 };
    if names + bar > 0.0 { names + bar + 2.0 * GAP } else { 0.0 }
}

/// Lines of text above the frame such that no leader crosses a label.
///
/// A label begins at its line and runs right, so what stands left of another goes above it; where labels would leave the page, all
/// run left instead.
fn placed_guides(chart: &Chart, x: Span, left: f64, right: f64, width: f64) -> Vec<PlacedGuide<'_>> {
    let place = |guide: &Guide| left + x.fraction_or_below(guide.at) * (right - left);
    let mut guides: Vec<&Guide> = chart.guides.iter().filter(|guide| guide.axis == GuideAxis::X).collect();
    guides.retain(|guide| (left - 0.01..=right + 0.01).contains(&place(guide)));
    guides.sort_by(|a, b| b.at.total_cmp(&a.at));
    let overflows = guides.iter().any(|guide| place(guide) + text::width(&guide.label, TICK_SIZE) + 2.0 > width - BORDER);
    if overflows {
        guides.reverse();
    }
    let mut placed: Vec<PlacedGuide<'_>> = Vec::new();
    for guide in guides {
        let size = fitting_size(&guide.label, TICK_SIZE, width - 2.0 * BORDER);
        let (x, length) = (place(guide), text::width(&guide.label, size));
        let wanted = if overflows { x - 2.5 - length } else { x + 2.5 };
        let start = wanted.min(width - BORDER - length).max(BORDER);
        // It goes above every label that it would touch and above every leader that it would cross.
        let touches = |other: &&PlacedGuide<'_>| {
            let (leader, end) = (place(other.guide), other.start + text::width(&other.guide.label, other.size));
            start < leader.max(end) + 2.0 * GAP && leader.min(other.start) - 2.0 * GAP < start + length
        };
        let under = placed.iter().filter(touches).map(|other| other.row + 1).max();
        placed.push(PlacedGuide { guide, row: under.unwrap_or(0), start, size });
    }
    placed
}

/// The list of what the curves mean.
struct Legend {
    place: LegendPlace,
    /// For each curve the lines of its text; empty for curves that need none.
    entries: Vec<Vec<String>>,
    column_width: f64,
    columns: usize,
}

#[derive(PartialEq)]
enum LegendPlace {
    None,
    Beside,
    Below,
}

impl Legend {
    fn of(chart: &Chart, width: f64) -> Self {
        let texts: Vec<String> = chart.curves.iter().map(legend_text).collect();
        let is_needed =
            texts.iter().any(|text| !text.is_empty()) && (texts.len() > 1 || chart.curves.iter().any(|curve| curve.fit.is_some()));
        if !is_needed {
            return Self { place: LegendPlace::None, entries: Vec::new(), column_width: 0.0, columns: 1 };
        }
        // One entry takes a single line below; several take one each.
        let share = if texts.len() > 1 { 0.36 } else { 0.3 };
        if let Some(entries) = narrow_entries(chart, share * width - SAMPLE_WIDTH - GAP) {
            return Self { place: LegendPlace::Beside, column_width: SAMPLE_WIDTH + GAP + widest_line(&entries), entries, columns: 1 };
        }
        let room = width - 2.0 * BORDER;
        let limit = room - SAMPLE_WIDTH - GAP;
        let entries: Vec<Vec<String>> = texts.iter().map(|text| text::wrapped(text, LEGEND_SIZE, limit)).collect();
        let column_width = SAMPLE_WIDTH + GAP + widest_line(&entries);
        let columns = ((room + 3.0 * GAP) / (column_width + 3.0 * GAP)).floor().clamp(1.0, entries.len() as f64) as usize;
        Self { place: LegendPlace::Below, entries, column_width, columns }
    }

    fn rows(&self) -> usize {
        self.entries.len().div_ceil(self.columns)
    }

    /// Height of row `row`: the entry with most lines decides.
    fn row_height(&self, row: usize) -> f64 {
        let lines = self.entries.iter().skip(row).step_by(self.rows()).map(Vec::len).max().unwrap_or(1);
        line_height(LEGEND_SIZE) * lines.max(1) as f64 + 1.0
    }

    fn height(&self) -> f64 {
        (0..self.rows()).map(|row| self.row_height(row)).sum()
    }

    fn height_below(&self) -> f64 {
        if self.place == LegendPlace::Below { self.height() + 1.5 * GAP } else { 0.0 }
    }

    fn width_beside(&self) -> f64 {
        if self.place == LegendPlace::Beside { self.column_width + 2.5 * GAP } else { 0.0 }
    }

    fn least_frame_height(&self) -> f64 {
        if self.place == LegendPlace::Beside { self.height() } else { 0.0 }
    }
}

/// The lines of each entry if all of them fit beside the frame: names as they are, slopes on a line of their own where they must be.
fn narrow_entries(chart: &Chart, limit: f64) -> Option<Vec<Vec<String>>> {
    let fits = |line: &String| text::width(line, LEGEND_SIZE) <= limit;
    let entry = |curve: &Curve| {
        let joined = legend_text(curve);
        let parts = [curve.label.clone(), slope_text(curve).unwrap_or_default()];
        let lines = if fits(&joined) { vec![joined] } else { parts.to_vec() };
        let lines: Vec<String> = lines.into_iter().filter(|line| !line.is_empty()).collect();
        lines.iter().all(fits).then_some(lines)
    };
    chart.heat.is_none().then(|| chart.curves.iter().map(entry).collect())?
}

fn widest_line(entries: &[Vec<String>]) -> f64 {
    entries.iter().flatten().map(|line| text::width(line, LEGEND_SIZE)).fold(0.0, f64::max)
}

/// The label of a curve with its fitted slope.
fn legend_text(curve: &Curve) -> String {
    let parts = [Some(curve.label.clone()).filter(|label| !label.is_empty()), slope_text(curve)];
    parts.into_iter().flatten().collect::<Vec<_>>().join(": ")
}

fn slope_text(curve: &Curve) -> Option<String> {
    let fit = curve.fit.as_ref()?;
    let decimals = 3;
    let error = fit.slope_error.map_or(String::new(), |error| format!(" ± {}", axis::fixed(error, decimals)));
    Some(format!("slope {}{error}", axis::fixed(fit.slope, decimals)))
}

fn has_markers(curve: &Curve) -> bool {
    match curve.look {
        Look::Points => true,
        Look::Line => curve.points.len() <= MARKER_LIMIT,
        Look::Steps | Look::Filled | Look::Bars | Look::Level => false,
    }
}

fn draw_axes(canvas: &mut Canvas, chart: &Chart, page: &Page<'_>) {
    let frame = &page.frame;
    let is_named = |axis: &Axis| !axis.categories.is_empty();
    if chart.heat.is_some() {
        return;
    }
    for value in &page.x_ticks.minor {
        vertical(canvas, frame, frame.at_x(*value), 0.5, FINE_GRID);
    }
    for value in &page.y_ticks.minor {
        horizontal(canvas, frame, frame.at_y(*value), 0.5, FINE_GRID);
    }
    for tick in page.x_ticks.major.iter().filter(|_| !is_named(&chart.x)) {
        vertical(canvas, frame, frame.at_x(tick.value), 0.6, GRID);
    }
    for tick in page.y_ticks.major.iter().filter(|_| !is_named(&chart.y)) {
        horizontal(canvas, frame, frame.at_y(tick.value), 0.6, GRID);
    }
}

fn vertical(canvas: &mut Canvas, frame: &Frame, x: f64, width: f64, ink: Ink) {
    canvas.stroke(vec![[x, frame.low[1]], [x, frame.high[1]]], width, ink);
}

fn horizontal(canvas: &mut Canvas, frame: &Frame, y: f64, width: f64, ink: Ink) {
    canvas.stroke(vec![[frame.low[0], y], [frame.high[0], y]], width, ink);
}

/// The two sides that carry numbers, over what data reach onto them.
fn draw_frame(canvas: &mut Canvas, frame: &Frame) {
    let [left, top] = frame.low;
    let [right, bottom] = frame.high;
    canvas.stroke(vec![[left, top], [left, bottom], [right, bottom]], 0.8, BLACK);
}

fn draw_guides(canvas: &mut Canvas, page: &Page<'_>) {
    let frame = &page.frame;
    for PlacedGuide { guide, row, start, size } in &page.guides {
        let x = frame.at_x(guide.at);
        let baseline = frame.low[1] - 4.0 - *row as f64 * line_height(TICK_SIZE);
        let top = baseline - CAPITAL_HEIGHT * TICK_SIZE;
        canvas.dashed(vec![[x, frame.high[1]], [x, frame.low[1]]], palette::dashes(1), 0.8, GREY);
        canvas.stroke(vec![[x, frame.low[1]], [x, top]], 0.6, GREY);
        write(canvas, &guide.label, [*start, baseline], Anchor::Start, *size, BLACK);
    }
}

fn draw_level_guides(canvas: &mut Canvas, chart: &Chart, page: &Page<'_>) {
    let frame = &page.frame;
    for guide in chart.guides.iter().filter(|guide| guide.axis == GuideAxis::Y) {
        let y = frame.at_y(guide.at);
        if frame.contains([frame.low[0], y]) {
            canvas.dashed(vec![[frame.low[0], y], [frame.high[0], y]], palette::dashes(1), 0.8, GREY);
            write(canvas, &guide.label, [frame.high[0] + GAP, y + CAPITAL_HEIGHT * TICK_SIZE / 2.0], Anchor::Start, TICK_SIZE, BLACK);
        }
    }
}

fn heat_span(heat: &Heat) -> Span {
    axis::span(&heat.axis, heat.values.iter().flatten().copied(), Reach { margin: 0.0, is_from_zero: false })
}

fn color_ticks(heat: &Heat, height: f64) -> Ticks {
    let span = heat_span(heat);
    axis::ticks(&heat.axis, span, label_count(span, height), &[])
}

fn draw_heat(canvas: &mut Canvas, chart: &Chart, page: &Page<'_>) {
    let Some(heat) = &chart.heat else { return };
    let frame = &page.frame;
    let span = heat_span(heat);
    let columns = heat.x_edges.len() - 1;
    for (index, value) in heat.values.iter().enumerate() {
        let Some(fraction) = value.and_then(|value| span.fraction(value)) else { continue };
        let (row, column) = (index / columns, index % columns);
        let [x0, x1] = [0, 1].map(|k| frame.at_x(heat.x_edges[column + k]).clamp(frame.low[0], frame.high[0]));
        let [y0, y1] = [0, 1].map(|k| frame.at_y(heat.y_edges[row + k]).clamp(frame.low[1], frame.high[1]));
        // A little overlap to the right and up hides the seams that viewers leave between neighbors.
        canvas.rectangle([x0, y1], [(x1 + 0.3).min(frame.high[0]), (y0 + 0.3).min(frame.high[1])], palette::heat(fraction));
    }
    draw_color_bar(canvas, heat, page, span);
}

fn draw_color_bar(canvas: &mut Canvas, heat: &Heat, page: &Page<'_>, span: Span) {
    let (left, top, bottom) = (page.beside, page.frame.low[1], page.frame.high[1]);
    let right = left + COLOR_BAR_WIDTH;
    let height = bottom - top;
    let bands = 128;
    for band in 0..bands {
        let fraction = (f64::from(band) + 0.5) / f64::from(bands);
        let low = bottom - height * f64::from(band) / f64::from(bands);
        let high = (bottom - height * f64::from(band + 1) / f64::from(bands) - 0.3).max(top);
        canvas.rectangle([left, high], [right, low], palette::heat(fraction));
    }
    for tick in &page.color_ticks.major {
        let y = bottom - span.fraction_or_below(tick.value) * height;
        canvas.stroke(vec![[right, y], [right + TICK_LENGTH, y]], 0.8, BLACK);
        write(canvas, &tick.label, [right + TICK_LENGTH + 2.0, y + CAPITAL_HEIGHT * TICK_SIZE / 2.0], Anchor::Start, TICK_SIZE, BLACK);
    }
    let title = axis::title(&heat.axis, page.color_ticks.exponent);
    let x = right + TICK_LENGTH + 2.0 + widest(&page.color_ticks.major, TICK_SIZE) + GAP + CAPITAL_HEIGHT * LABEL_SIZE;
    write_turned(canvas, &title, [x, (top + bottom) / 2.0], fitting_size(&title, LABEL_SIZE, height));
}

/// Bands lie under all curves, so that none hides another's line.
fn draw_bands(canvas: &mut Canvas, chart: &Chart, frame: &Frame) {
    for curve in chart.curves.iter().filter(|curve| curve.interval == IntervalLook::Band && curve.look != Look::Level) {
        let ends: Vec<(f64, [f64; 2])> = curve.points.iter().filter_map(|point| Some((point.x, point.interval?))).collect();
        let upper = ends.iter().map(|(x, [_, high])| frame.at(*x, *high));
        let lower = ends.iter().rev().map(|(x, [low, _])| frame.at(*x, *low));
        canvas.area(clipped_area(upper.chain(lower).collect(), frame.low, frame.high), palette::hue(curve.hue).with_opacity(0.2));
    }
}

fn draw_curve(canvas: &mut Canvas, chart: &Chart, index: usize, curve: &Curve, frame: &Frame) {
    let ink = palette::hue(curve.hue);
    let places: Vec<[f64; 2]> =
        curve.points.iter().filter(|point| is_drawable(point, frame)).map(|point| frame.at(point.x, point.y)).collect();
    match curve.look {
        Look::Line => draw_line(canvas, &places, curve, frame),
        Look::Steps => draw_line(canvas, &staircase(&places), curve, frame),
        Look::Filled => {
            let floor = frame.at_y(0.0).min(frame.high[1] + 1e3);
            let mut outline = staircase(&places);
            if let (Some(first), Some(last)) = (outline.first().copied(), outline.last().copied()) {
                outline.extend([[last[0], floor], [first[0], floor]]);
                canvas.area(clipped_area(outline.clone(), frame.low, frame.high), ink.with_opacity(0.35));
                outline.rotate_right(1);
                draw_line(canvas, &outline, curve, frame);
            }
        }
        Look::Bars => draw_bars(canvas, chart, index, frame),
        Look::Level => {
            let level = curve.points.first().map(|point| frame.at_y(point.y));
            if let Some(y) = level.filter(|y| frame.contains([frame.low[0], *y])) {
                canvas.dashed(vec![[frame.low[0], y], [frame.high[0], y]], palette::dashes(1), LINE_WIDTH, ink);
            }
        }
        Look::Points => {}
    }
    draw_fit(canvas, curve, frame);
    if curve.look != Look::Bars && (curve.interval == IntervalLook::Whiskers || curve.look == Look::Points) {
        draw_whiskers(canvas, curve, frame);
    }
    if has_markers(curve) {
        for place in places.iter().filter(|place| frame.contains(**place)) {
            draw_marker(canvas, *place, curve.hue, MARKER_RADIUS);
        }
    }
}

fn is_drawable(point: &Point, frame: &Frame) -> bool {
    frame.x.fraction(point.x).is_some() && frame.y.fraction(point.y).is_some()
}

fn draw_line(canvas: &mut Canvas, places: &[[f64; 2]], curve: &Curve, frame: &Frame) {
    // Dense curves are drawn thinner: their turns would run together.
    let width = if places.len() > 300 { 0.8 * LINE_WIDTH } else { LINE_WIDTH };
    for part in clipped_line(places, frame.low, frame.high) {
        // A fitted law is drawn over its data, which step back.
        let opacity = if curve.fit.is_some() { 0.4 } else { 1.0 };
        canvas.dashed(part, palette::dashes(curve.dash), width, palette::hue(curve.hue).with_opacity(opacity));
    }
}

/// The corners of a staircase: each height holds until the next place.
fn staircase(places: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let mut corners: Vec<[f64; 2]> = places.first().copied().into_iter().collect();
    for pair in places.windows(2) {
        corners.extend([[pair[1][0], pair[0][1]], pair[1]]);
    }
    corners
}

fn draw_fit(canvas: &mut Canvas, curve: &Curve, frame: &Frame) {
    let Some(fit) = &curve.fit else { return };
    let [from, to] = fit.range;
    // A power law is straight on two logarithmic axes and bent on all others.
    let places: Vec<[f64; 2]> = (0..=64)
        .map(|step| from * elementary::pow(to / from, f64::from(step) / 64.0))
        .filter(|x| frame.x.fraction(*x).is_some() && frame.y.fraction(fit.at(*x)).is_some())
        .map(|x| frame.at(x, fit.at(x)))
        .collect();
    for part in clipped_line(&places, frame.low, frame.high) {
        canvas.dashed(part, palette::dashes(1), 1.0, palette::hue(curve.hue));
    }
}

fn draw_whiskers(canvas: &mut Canvas, curve: &Curve, frame: &Frame) {
    let ink = palette::hue(curve.hue);
    for point in curve.points.iter().filter(|point| frame.x.fraction(point.x).is_some()) {
        let Some([low, high]) = point.interval else { continue };
        draw_whisker(canvas, frame.at_x(point.x), [low, high], frame, ink);
    }
}

fn draw_whisker(canvas: &mut Canvas, x: f64, interval: [f64; 2], frame: &Frame, ink: Ink) {
    const HALF_CAP: f64 = 2.2;
    let [bottom, top] = interval.map(|value| frame.at_y(value));
    for part in clipped_line(&[[x, bottom], [x, top]], frame.low, frame.high) {
        canvas.stroke(part, 0.9, ink);
    }
    for y in [bottom, top].into_iter().filter(|y| frame.contains([x, *y])) {
        canvas.stroke(vec![[x - HALF_CAP, y], [x + HALF_CAP, y]], 0.9, ink);
    }
}

/// A shape in the curve's color with a thin white rim, so that it stands apart from lines under it.
fn draw_marker(canvas: &mut Canvas, [x, y]: [f64; 2], index: usize, radius: f64) {
    for (radius, ink) in [(radius + 0.6, WHITE), (radius, palette::hue(index))] {
        match palette::marker(index) {
            None => canvas.disk([x, y], radius, ink),
            Some(outline) => canvas.area(outline.iter().map(|[dx, dy]| [x + dx * radius, y + dy * radius]).collect(), ink),
        }
    }
}

/// The bars of curve number `index`, beside those of the others at the same places.
fn draw_bars(canvas: &mut Canvas, chart: &Chart, index: usize, frame: &Frame) {
    let places: Vec<f64> = own_x(chart).into_iter().filter(|x| frame.x.fraction(*x).is_some()).map(|x| frame.at_x(x)).collect();
    let mut sorted = places.clone();
    sorted.sort_by(f64::total_cmp);
    sorted.dedup();
    let nearest = sorted.windows(2).map(|pair| pair[1] - pair[0]).fold((frame.high[0] - frame.low[0]) / 2.0, f64::min);
    let is_bars = |curve: &&Curve| curve.look == Look::Bars;
    let count = chart.curves.iter().filter(is_bars).count() as f64;
    let position = chart.curves[..index].iter().filter(is_bars).count() as f64;
    let width = (0.8 * nearest / count).min(60.0);
    let floor = if frame.y.scale == Scale::Logarithmic { frame.high[1] } else { frame.at_y(0.0).clamp(frame.low[1], frame.high[1]) };
    let curve = &chart.curves[index];
    for point in curve.points.iter().filter(|point| is_drawable(point, frame)) {
        let center = frame.at_x(point.x) + (position - (count - 1.0) / 2.0) * width;
        let bar = vec![[center - 0.46 * width, floor], [center + 0.46 * width, floor]];
        let y = frame.at_y(point.y);
        let bar = bar.into_iter().chain([[center + 0.46 * width, y], [center - 0.46 * width, y]]).collect();
        canvas.area(clipped_area(bar, frame.low, frame.high), palette::hue(curve.hue));
        if let Some(interval) = point.interval {
            draw_whisker(canvas, center, interval, frame, BLACK);
        }
    }
}

fn draw_texts(canvas: &mut Canvas, chart: &Chart, page: &Page<'_>) {
    draw_level_guides(canvas, chart, page);
    let mut top = BORDER;
    for line in &page.title {
        write(canvas, line, [page.size[0] / 2.0, top + TITLE_SIZE], Anchor::Middle, TITLE_SIZE, BLACK);
        top += line_height(TITLE_SIZE);
    }
    let bottom = draw_x_labels(canvas, chart, page);
    draw_y_labels(canvas, page);
    draw_legend(canvas, chart, page, bottom);
    let notes_top = page.size[1] - BORDER - lines_height(&page.notes, NOTE_SIZE);
    for (index, line) in page.notes.iter().enumerate() {
        let baseline = notes_top + index as f64 * line_height(NOTE_SIZE) + NOTE_SIZE;
        write(canvas, line, [BORDER, baseline], Anchor::Start, NOTE_SIZE, GREY);
    }
}

/// Numbers and label below the frame; gives where they end.
fn draw_x_labels(canvas: &mut Canvas, chart: &Chart, page: &Page<'_>) -> f64 {
    let (frame, ticks) = (&page.frame, &page.x_ticks);
    let bottom = frame.high[1];
    for value in &ticks.minor {
        let x = frame.at_x(*value);
        canvas.stroke(vec![[x, bottom], [x, bottom + 0.6 * TICK_LENGTH]], 0.6, BLACK);
    }
    let first_baseline = bottom + TICK_LENGTH + 2.0 + TICK_SIZE;
    for (tick, lines) in ticks.major.iter().zip(&page.x_labels) {
        let x = frame.at_x(tick.value);
        canvas.stroke(vec![[x, bottom], [x, bottom + TICK_LENGTH]], 0.8, BLACK);
        for (index, line) in lines.iter().enumerate() {
            let half = text::width(line, page.x_label_size) / 2.0;
            let x = x.min(page.size[0] - BORDER - half).max(BORDER + half);
            write(
                canvas,
                line,
                [x, first_baseline + index as f64 * line_height(page.x_label_size)],
                Anchor::Middle,
                page.x_label_size,
                BLACK,
            );
        }
    }
    let under_ticks = bottom + TICK_LENGTH + 2.0 + numbers_height(&page.x_labels);
    let title = axis::title(&chart.x, ticks.exponent);
    if title.is_empty() {
        return under_ticks;
    }
    let size = fitting_size(&title, LABEL_SIZE, page.size[0] - 2.0 * BORDER);
    let half = text::width(&title, size) / 2.0;
    let center = ((frame.low[0] + frame.high[0]) / 2.0).min(page.size[0] - BORDER - half).max(BORDER + half);
    write(canvas, &title, [center, under_ticks + 1.0 + LABEL_SIZE], Anchor::Middle, size, BLACK);
    under_ticks + 1.0 + line_height(LABEL_SIZE)
}

fn draw_y_labels(canvas: &mut Canvas, page: &Page<'_>) {
    let (frame, ticks) = (&page.frame, &page.y_ticks);
    let left = frame.low[0];
    for value in &ticks.minor {
        let y = frame.at_y(*value);
        canvas.stroke(vec![[left - 0.6 * TICK_LENGTH, y], [left, y]], 0.6, BLACK);
    }
    for tick in &ticks.major {
        let y = frame.at_y(tick.value);
        canvas.stroke(vec![[left - TICK_LENGTH, y], [left, y]], 0.8, BLACK);
        write(canvas, &tick.label, [left - TICK_LENGTH - 2.0, y + CAPITAL_HEIGHT * TICK_SIZE / 2.0], Anchor::End, TICK_SIZE, BLACK);
    }
    for (index, line) in page.y_title.iter().enumerate() {
        let baseline = BORDER + LABEL_SIZE + index as f64 * line_height(LABEL_SIZE);
        write_turned(canvas, line, [baseline, (frame.low[1] + frame.high[1]) / 2.0], LABEL_SIZE);
    }
}

/// The size at which a line fits, at most `size`.
fn fitting_size(line: &str, size: f64, room: f64) -> f64 {
    let width = text::width(line, size);
    if width > room { size * room / width } else { size }
}

fn draw_legend(canvas: &mut Canvas, chart: &Chart, page: &Page<'_>, bottom: f64) {
    let legend = &page.legend;
    if let Some(labels) = direct_labels(chart, page) {
        return labels.iter().for_each(|label| draw_direct_label(canvas, chart, page, label));
    }
    let [left, mut top] = match legend.place {
        LegendPlace::None => return,
        LegendPlace::Beside => [page.size[0] - BORDER - legend.column_width, page.frame.low[1]],
        LegendPlace::Below => {
            let width = legend.columns as f64 * (legend.column_width + 3.0 * GAP) - 3.0 * GAP;
            let center = ((page.frame.low[0] + page.frame.high[0]) / 2.0).min(page.size[0] - BORDER - width / 2.0);
            [(center - width / 2.0).max(BORDER), bottom + 1.5 * GAP]
        }
    };
    for row in 0..legend.rows() {
        for column in 0..legend.columns {
            let index = column * legend.rows() + row;
            if let Some(lines) = legend.entries.get(index) {
                let x = left + column as f64 * (legend.column_width + 3.0 * GAP);
                draw_entry(canvas, &chart.curves[index], lines, [x, top]);
            }
        }
        top += legend.row_height(row);
    }
}

/// A label that stands where its curve ends.
struct DirectLabel {
    curve: usize,
    /// Where the curve ends.
    end: [f64; 2],
    /// Top of the label's first line.
    top: f64,
}

/// Ends of curves that are nearer than this cannot be told apart.
const LEAST_DISTANCE: f64 = 5.0;

/// Labels at the ends of the curves in place of a legend beside the frame, where all curves reach the right side and end apart.
fn direct_labels(chart: &Chart, page: &Page<'_>) -> Option<Vec<DirectLabel>> {
    let legend = &page.legend;
    let has_levels = chart.guides.iter().any(|guide| guide.axis == GuideAxis::Y);
    if legend.place != LegendPlace::Beside || has_levels || legend.entries.iter().any(Vec::is_empty) {
        return None;
    }
    let ends: Option<Vec<[f64; 2]>> = chart.curves.iter().map(|curve| end_of(curve, &page.frame)).collect();
    let mut ends: Vec<(usize, [f64; 2])> = ends?.into_iter().enumerate().collect();
    ends.sort_by(|(_, a), (_, b)| a[1].total_cmp(&b[1]));
    if ends.windows(2).any(|pair| pair[1].1[1] - pair[0].1[1] < LEAST_DISTANCE) {
        return None;
    }
    Some(spread(&ends, legend, page.frame.high[1]))
}

/// Where a line ends, if that is near the right side.
fn end_of(curve: &Curve, frame: &Frame) -> Option<[f64; 2]> {
    let is_line = matches!(curve.look, Look::Line | Look::Steps | Look::Level);
    let last = curve.points.last().filter(|_| is_line)?;
    let x = if curve.look == Look::Level { frame.high[0] } else { frame.at_x(last.x) };
    let y = frame.at_y(last.y);
    let is_near = frame.high[0] - x <= 0.08 * (frame.high[0] - frame.low[0]);
    (is_near && frame.contains([x, y])).then_some([x, y])
}

/// Labels as near to their ends as they can stand without touching: moved down where they must be, then up from the bottom.
fn spread(ends: &[(usize, [f64; 2])], legend: &Legend, bottom: f64) -> Vec<DirectLabel> {
    let height = |curve: usize| lines_height(&legend.entries[curve], LEGEND_SIZE) + 1.0;
    let first_line = LEGEND_SIZE - CAPITAL_HEIGHT * LEGEND_SIZE / 2.0;
    let mut labels: Vec<DirectLabel> = Vec::with_capacity(ends.len());
    for &(curve, end) in ends {
        let free = labels.last().map_or(f64::NEG_INFINITY, |above| above.top + height(above.curve));
        labels.push(DirectLabel { curve, end, top: (end[1] - first_line).max(free) });
    }
    let mut limit = bottom + line_height(LEGEND_SIZE) / 2.0;
    for label in labels.iter_mut().rev() {
        label.top = label.top.min(limit - height(label.curve));
        limit = label.top;
    }
    labels
}

/// A label with a line to it from the end of its curve.
fn draw_direct_label(canvas: &mut Canvas, chart: &Chart, page: &Page<'_>, label: &DirectLabel) {
    let left = page.size[0] - BORDER - page.legend.column_width;
    let middle = label.top + LEGEND_SIZE - CAPITAL_HEIGHT * LEGEND_SIZE / 2.0;
    let knee = [page.frame.high[0] + GAP, label.end[1]];
    canvas.stroke(
        vec![label.end, knee, [left + SAMPLE_WIDTH - GAP, middle], [left + SAMPLE_WIDTH, middle]],
        0.7,
        palette::hue(chart.curves[label.curve].hue),
    );
    write_lines(canvas, &page.legend.entries[label.curve], [left + SAMPLE_WIDTH + GAP, label.top + LEGEND_SIZE]);
}

/// The lines of an entry, the first one on that baseline.
fn write_lines(canvas: &mut Canvas, lines: &[String], [x, baseline]: [f64; 2]) {
    for (index, line) in lines.iter().enumerate() {
        write(canvas, line, [x, baseline + index as f64 * line_height(LEGEND_SIZE)], Anchor::Start, LEGEND_SIZE, BLACK);
    }
}

fn draw_entry(canvas: &mut Canvas, curve: &Curve, lines: &[String], [x, top]: [f64; 2]) {
    let ink = palette::hue(curve.hue);
    let middle = top + LEGEND_SIZE - CAPITAL_HEIGHT * LEGEND_SIZE / 2.0;
    let line = vec![[x, middle], [x + SAMPLE_WIDTH, middle]];
    match curve.look {
        Look::Filled | Look::Bars => {
            let opacity = if curve.look == Look::Bars { 1.0 } else { 0.35 };
            canvas.rectangle([x + 4.0, middle - 3.2], [x + SAMPLE_WIDTH - 4.0, middle + 3.2], ink.with_opacity(opacity));
        }
        Look::Level => canvas.dashed(line, palette::dashes(1), LINE_WIDTH, ink),
        Look::Line | Look::Steps => canvas.dashed(line, palette::dashes(curve.dash), LINE_WIDTH, ink),
        Look::Points => {}
    }
    if has_markers(curve) {
        draw_marker(canvas, [x + SAMPLE_WIDTH / 2.0, middle], curve.hue, MARKER_RADIUS);
    }
    write_lines(canvas, lines, [x + SAMPLE_WIDTH + GAP, top + LEGEND_SIZE]);
}

fn write(canvas: &mut Canvas, line: &str, position: [f64; 2], anchor: Anchor, size: f64, ink: Ink) {
    canvas.text(Label { text: line.into(), position, anchor, size, is_turned: false, ink });
}

fn write_turned(canvas: &mut Canvas, line: &str, position: [f64; 2], size: f64) {
    canvas.text(Label { text: line.into(), position, anchor: Anchor::Middle, size, is_turned: true, ink: BLACK });
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::figure::canvas::Mark;
    use crate::figure::estimate::PowerLaw;

    fn axis(label: &str, scale: Scale) -> Axis {
        Axis { label: label.into(), unit: String::new(), scale, range: None, categories: Vec::new() }
    }

    fn curve(index: usize, label: &str) -> Curve {
        let points = (4..13).map(|k| Point {
            x: f64::from(1 << k),
            y: (index + 1) as f64 / f64::from(1 << k),
            interval: Some([1e-9, 2.0]),
            count: 16,
        });
        let interval = IntervalLook::Whiskers;
        Curve { label: label.into(), look: Look::Line, hue: index, dash: 0, points: points.collect(), interval, fit: None }
    }

    fn crowded(size_mm: [f64; 2], label: &str) -> Chart {
        let at = |at: f64| Guide { axis: GuideAxis::X, at, label: format!("Brewster {at}° of a material with a name") };
        Chart {
            title: "A title that is so long that it needs more than one line on any paper of a usual size".into(),
            size_mm,
            x: axis("number of samples per pixel and light", Scale::Logarithmic),
            y: axis("root mean square error over the whole sphere, alpha excluded", Scale::Logarithmic),
            curves: (0..6).map(|index| curve(index, label)).collect(),
            guides: vec![at(54.0), at(55.0), at(56.0), at(3000.0)],
            heat: None,
            notes: vec!["Each point is the mean of 16 values over run; bars show the 95 % interval (Student t).".into()],
        }
    }

    /// Left, top, right and bottom of a line of text.
    fn bounds(label: &Label) -> [f64; 4] {
        let width = text::width(&label.text, label.size);
        let start = match label.anchor {
            Anchor::Start => 0.0,
            Anchor::Middle => -width / 2.0,
            Anchor::End => -width,
        };
        let [x, y] = label.position;
        let (ascent, descent) = (CAPITAL_HEIGHT * label.size, 0.0);
        if label.is_turned {
            [x - ascent, y - start - width, x + descent, y - start]
        } else {
            [x + start, y - ascent, x + start + width, y + descent]
        }
    }

    fn labels(canvas: &Canvas) -> Vec<[f64; 4]> {
        canvas.marks.iter().filter_map(|mark| if let Mark::Text(label) = mark { Some(bounds(label)) } else { None }).collect()
    }

    #[test]
    fn no_text_is_clipped_or_lies_on_another_whatever_the_size() {
        for size in [[80.0, 50.0], [120.0, 80.0], [200.0, 60.0]] {
            for label in ["uniform", "rows-then-columns with a long description that cannot stand beside the frame"] {
                let canvas = canvas(&crowded(size, label));
                let labels = labels(&canvas);
                for (index, a) in labels.iter().enumerate() {
                    let is_inside = a[0] >= 0.0 && a[1] >= 0.0 && a[2] <= canvas.width && a[3] <= canvas.height;
                    assert!(is_inside, "{size:?} {label}: {a:?}");
                    for b in &labels[index + 1..] {
                        let is_apart = a[2] <= b[0] || b[2] <= a[0] || a[3] <= b[1] || b[3] <= a[1];
                        assert!(is_apart, "{size:?} {label}: {a:?} {b:?}");
                    }
                }
            }
        }
    }

    #[test]
    fn every_mark_is_finite_and_data_stay_within_the_page() {
        let mut chart = crowded([120.0, 80.0], "uniform");
        chart.x.range = Some([100.0, 1000.0]);
        chart.y.range = Some([1e-3, 1e-2]);
        let canvas = canvas(&chart);
        for mark in &canvas.marks {
            let points = match mark {
                Mark::Stroke { points, .. } | Mark::Area { points, .. } => points.clone(),
                Mark::Disk { center, .. } => vec![*center],
                Mark::Text(label) => vec![label.position],
            };
            let is_inside = |[x, y]: &[f64; 2]| (0.0..=canvas.width).contains(x) && (0.0..=canvas.height).contains(y);
            assert!(points.iter().all(is_inside), "{mark:?}");
        }
    }

    /// Where the text of an entry stands: its baseline.
    fn baseline_of(canvas: &Canvas, text: &str) -> f64 {
        let is_it = |mark: &&Mark| matches!(mark, Mark::Text(label) if label.text == text);
        canvas.marks.iter().find(is_it).map(|mark| if let Mark::Text(label) = mark { label.position[1] } else { 0.0 }).unwrap()
    }

    #[test]
    fn curves_that_end_apart_are_named_at_their_ends() {
        let mut chart = crowded([120.0, 80.0], "");
        chart.guides.clear();
        chart.curves = (0..3).map(|index| curve(4 * index, &format!("c{index}"))).collect();
        chart.curves.iter_mut().flat_map(|curve| &mut curve.points).for_each(|point| point.interval = None);
        let canvas = canvas(&chart);
        let frame = Page::of(&chart).frame;
        for (index, curve) in chart.curves.iter().enumerate() {
            let end = frame.at_y(curve.points.last().unwrap().y);
            let off = baseline_of(&canvas, &format!("c{index}")) - CAPITAL_HEIGHT * LEGEND_SIZE / 2.0 - end;
            // The lowest of three lines of text is moved by no more than its own height.
            assert!(off.abs() <= line_height(LEGEND_SIZE), "{index}: {off}");
        }
        // The larger y is higher on the page, whatever the order of the curves.
        assert!(baseline_of(&canvas, "c2") < baseline_of(&canvas, "c1") && baseline_of(&canvas, "c1") < baseline_of(&canvas, "c0"));
    }

    #[test]
    fn a_fitted_law_is_shown_whole() {
        let mut chart = crowded([120.0, 80.0], "");
        let fit = PowerLaw { coefficient: 1.0, slope: -2.0, slope_error: None, range: [16.0, 4096.0] };
        chart.curves = vec![Curve { fit: Some(fit), ..curve(0, "c") }];
        let [x, y] = spans(&chart);
        assert!(y.fraction(fit.at(4096.0)).unwrap() > 0.0 && y.fraction(fit.at(16.0)).unwrap() < 1.0 && x.high >= 4096.0);
    }

    #[test]
    fn curves_that_end_together_keep_the_order_of_their_legend() {
        let mut chart = crowded([120.0, 80.0], "");
        chart.guides.clear();
        chart.curves = (0..3).map(|index| curve(0, &format!("c{index}"))).collect();
        let canvas = canvas(&chart);
        let step = baseline_of(&canvas, "c1") - baseline_of(&canvas, "c0");
        assert!((step - line_height(LEGEND_SIZE) - 1.0).abs() < 1e-9, "{step}");
    }

    #[test]
    fn the_legend_lies_outside_the_frame() {
        let chart = crowded([120.0, 80.0], "uniform");
        let page = Page::of(&chart);
        let text = |mark: &Mark| if let Mark::Text(label) = mark { Some(label.clone()) } else { None };
        let entries: Vec<Label> = canvas(&chart).marks.iter().filter_map(text).filter(|label| label.text == "uniform").collect();
        assert_eq!(entries.len(), 6);
        assert!(entries.iter().all(|label| !page.frame.contains(label.position)));
    }
}

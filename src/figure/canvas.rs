//! A drawing: strokes, areas and lines of text at exact places, before any file format.
//!
//! Coordinates are points (1/72 inch) from the top left corner, y downwards. Later marks cover earlier
//! ones. Knows nothing of charts; `layout` fills it, `svg`, `bitmap` and `pdf` write it.

/// An sRGB color with its opacity.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ink {
    /// Encoded sRGB.
    pub rgb: [u8; 3],
    /// From 0, invisible, to 1.
    pub opacity: f64,
}

impl Ink {
    /// An opaque color.
    pub const fn opaque(rgb: [u8; 3]) -> Self {
        Self { rgb, opacity: 1.0 }
    }

    /// The same color with that opacity.
    pub const fn with_opacity(self, opacity: f64) -> Self {
        Self { rgb: self.rgb, opacity }
    }
}

/// Where a line of text has its given position.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Anchor {
    /// At its beginning.
    Start,
    /// At its middle.
    Middle,
    /// At its end.
    End,
}

/// A line of text.
#[derive(Debug, Clone, PartialEq)]
pub struct Label {
    /// The text.
    pub text: String,
    /// A point of the baseline.
    pub position: [f64; 2],
    /// Which point of the baseline.
    pub anchor: Anchor,
    /// Size of the font in points.
    pub size: f64,
    /// Whether it is turned by a quarter to read from below.
    pub is_turned: bool,
    /// Its color.
    pub ink: Ink,
}

/// One thing that is drawn.
#[derive(Debug, Clone, PartialEq)]
pub enum Mark {
    /// A polyline with round joins.
    Stroke {
        /// The corners.
        points: Vec<[f64; 2]>,
        /// Width of the line in points.
        width: f64,
        /// Its color.
        ink: Ink,
    },
    /// A filled polygon.
    Area {
        /// The corners.
        points: Vec<[f64; 2]>,
        /// Its color.
        ink: Ink,
    },
    /// A filled circle.
    Disk {
        /// Its center.
        center: [f64; 2],
        /// Its radius in points.
        radius: f64,
        /// Its color.
        ink: Ink,
    },
    /// A line of text.
    Text(Label),
}

/// A page of marks.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Canvas {
    /// Width in points.
    pub width: f64,
    /// Height in points.
    pub height: f64,
    /// What is drawn, in order.
    pub marks: Vec<Mark>,
}

impl Canvas {
    /// Draws a polyline; fewer than two points draw nothing.
    pub fn stroke(&mut self, points: Vec<[f64; 2]>, width: f64, ink: Ink) {
        if points.len() > 1 {
            self.marks.push(Mark::Stroke { points, width, ink });
        }
    }

    /// Draws a polyline in dashes: lengths drawn and left out in turn, in points; empty is unbroken.
    pub fn dashed(&mut self, points: Vec<[f64; 2]>, dashes: &[f64], width: f64, ink: Ink) {
        if dashes.is_empty() {
            return self.stroke(points, width, ink);
        }
        for dash in cut_into_dashes(&points, dashes) {
            self.stroke(dash, width, ink);
        }
    }

    /// Fills a polygon; fewer than three points draw nothing.
    pub fn area(&mut self, points: Vec<[f64; 2]>, ink: Ink) {
        if points.len() > 2 {
            self.marks.push(Mark::Area { points, ink });
        }
    }

    /// Fills the rectangle between two corners.
    pub fn rectangle(&mut self, [x0, y0]: [f64; 2], [x1, y1]: [f64; 2], ink: Ink) {
        self.area(vec![[x0, y0], [x1, y0], [x1, y1], [x0, y1]], ink);
    }

    /// Fills a circle.
    pub fn disk(&mut self, center: [f64; 2], radius: f64, ink: Ink) {
        self.marks.push(Mark::Disk { center, radius, ink });
    }

    /// Writes a line of text.
    pub fn text(&mut self, label: Label) {
        if !label.text.is_empty() {
            self.marks.push(Mark::Text(label));
        }
    }
}

/// The pieces of a polyline that the dashes cover.
fn cut_into_dashes(points: &[[f64; 2]], dashes: &[f64]) -> Vec<Vec<[f64; 2]>> {
    let mut pieces = vec![points.first().copied().into_iter().collect::<Vec<_>>()];
    let (mut index, mut left) = (0, dashes[0]);
    for ends in points.windows(2) {
        let [from, to] = [ends[0], ends[1]];
        let length = ((to[0] - from[0]) * (to[0] - from[0]) + (to[1] - from[1]) * (to[1] - from[1])).sqrt();
        let mut done = 0.0;
        while length - done > left {
            done += left;
            let at = [0, 1].map(|k| from[k] + (to[k] - from[k]) * done / length);
            // Even entries are drawn: at the end of one its piece is complete, at the end of a gap a new one begins.
            if index % 2 == 0 {
                pieces.last_mut().expect("there is always a piece").push(at);
            } else {
                pieces.push(vec![at]);
            }
            index += 1;
            left = dashes[index % dashes.len()];
        }
        left -= length - done;
        if index % 2 == 0 {
            pieces.last_mut().expect("there is always a piece").push(to);
        }
    }
    pieces.retain(|piece| piece.len() > 1);
    pieces
}

/// The parts of a polyline within the rectangle between the corners `low` and `high`.
pub fn clipped_line(points: &[[f64; 2]], low: [f64; 2], high: [f64; 2]) -> Vec<Vec<[f64; 2]>> {
    let mut parts: Vec<Vec<[f64; 2]>> = Vec::new();
    for ends in points.windows(2) {
        let Some([from, to]) = clipped_segment(ends[0], ends[1], low, high) else { continue };
        match parts.last_mut() {
            Some(part) if part.last() == Some(&from) => part.push(to),
            _ => parts.push(vec![from, to]),
        }
    }
    parts
}

/// Liang and Barsky, "A new concept and method for line clipping" (1984).
fn clipped_segment(from: [f64; 2], to: [f64; 2], low: [f64; 2], high: [f64; 2]) -> Option<[[f64; 2]; 2]> {
    let (mut enter, mut leave) = (0.0_f64, 1.0_f64);
    for k in 0..2 {
        let step = to[k] - from[k];
        for (distance, speed) in [(from[k] - low[k], -step), (high[k] - from[k], step)] {
            if speed == 0.0 && distance < 0.0 {
                return None;
            }
            if speed < 0.0 {
                enter = enter.max(distance / speed);
            } else if speed > 0.0 {
                leave = leave.min(distance / speed);
            }
        }
    }
    let at = |t: f64| {
        if t == 0.0 {
            from
        } else if t == 1.0 {
            to
        } else {
            [0, 1].map(|k| from[k] + t * (to[k] - from[k]))
        }
    };
    (enter <= leave).then(|| [at(enter), at(leave)])
}

/// The part of a polygon within the rectangle between the corners `low` and `high`.
///
/// Sutherland and Hodgman, "Reentrant polygon clipping" (1974).
pub fn clipped_area(points: Vec<[f64; 2]>, low: [f64; 2], high: [f64; 2]) -> Vec<[f64; 2]> {
    let edges = [(0, low[0], 1.0), (0, high[0], -1.0), (1, low[1], 1.0), (1, high[1], -1.0)];
    edges.into_iter().fold(points, |polygon, (axis, bound, side)| clipped_at(&polygon, axis, bound, side))
}

fn clipped_at(polygon: &[[f64; 2]], axis: usize, bound: f64, side: f64) -> Vec<[f64; 2]> {
    let depth = |point: [f64; 2]| (point[axis] - bound) * side;
    let mut kept = Vec::new();
    for (index, &point) in polygon.iter().enumerate() {
        let before = polygon[(index + polygon.len() - 1) % polygon.len()];
        if (depth(before) < 0.0) != (depth(point) < 0.0) {
            let t = depth(before) / (depth(before) - depth(point));
            kept.push([0, 1].map(|k| before[k] + t * (point[k] - before[k])));
        }
        if depth(point) >= 0.0 {
            kept.push(point);
        }
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_is_cut_where_it_leaves_the_frame_and_goes_on_where_it_returns() {
        let line = [[-1.0, 0.5], [0.5, 0.5], [0.5, 2.0], [0.75, 0.5]];
        let parts = clipped_line(&line, [0.0, 0.0], [1.0, 1.0]);
        assert_eq!(parts.len(), 2);
        assert_eq!(parts[0], [[0.0, 0.5], [0.5, 0.5], [0.5, 1.0]]);
        assert_eq!(parts[1].last(), Some(&[0.75, 0.5]));
    }

    #[test]
    fn an_area_keeps_what_lies_within() {
        let triangle = vec![[-1.0, 0.0], [1.0, 0.0], [1.0, 2.0]];
        let kept = clipped_area(triangle, [0.0, 0.0], [1.0, 1.0]);
        let doubled: f64 = (0..kept.len()).map(|i| (kept[i], kept[(i + 1) % kept.len()])).map(|(a, b)| a[0] * b[1] - a[1] * b[0]).sum();
        // The unit square without nothing: the line y = x + 1 touches it in one corner only.
        assert!((doubled / 2.0 - 1.0).abs() < 1e-12, "{doubled}");
    }

    #[test]
    fn dashes_cover_their_share_of_the_line() {
        let pieces = cut_into_dashes(&[[0.0, 0.0], [7.0, 0.0], [7.0, 5.0]], &[2.0, 1.0]);
        let drawn: f64 = pieces.iter().flat_map(|piece| piece.windows(2)).map(|w| (w[1][0] - w[0][0]) + (w[1][1] - w[0][1])).sum();
        assert!((drawn - 8.0).abs() < 1e-12, "{drawn}");
        assert_eq!(pieces.len(), 4);
    }
}

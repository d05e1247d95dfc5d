//! How much of each pixel of a lat-long map lies in a patch of the sphere.
//!
//! In the coordinates azimuth and cosine of the polar angle (Lambert's cylindrical projection) area is solid angle, and
//! the pixels of a map are rectangles. A patch becomes a polygon there, whose part in every rectangle has a closed form.
//! Patches that share a corner or an edge share the vertices, so patches that cover the sphere once cover every pixel
//! once, to rounding: no light is lost or made. The edges between vertices are straight in these coordinates instead of
//! on the sphere, which moves a little of the area of a patch to its neighbor (tests: below 2e-4 of it, on pictures of 16 pixels a side) and adds nothing.
//!
//! Knows no layout; see `layout` for patches and `reproject` for what is done with the parts.

use std::f64::consts::{PI, TAU};

use glam::DVec3;

use crate::math::elementary;

/// The pixels of a lat-long map as rectangles of azimuth and cosine.
#[derive(Debug, Clone)]
pub struct Grid {
    width: usize,
    height: usize,
    /// Cosine of the polar angle at the borders of rows, from 1 down to -1; one more than there are rows.
    borders: Vec<f64>,
}

/// Room that is used again from patch to patch.
#[derive(Debug, Clone, Default)]
pub struct Scratch {
    /// The polygon: column as a number that goes on across the seam, and cosine of the polar angle.
    polygon: Vec<[f64; 2]>,
    /// Parts of the rectangles around the polygon, row by row.
    parts: Vec<f64>,
}

/// A patch of the sphere: the image of a rectangle of some plane.
pub struct Patch<F> {
    /// Lower corner of the rectangle.
    pub from: [f64; 2],
    /// Upper corner of the rectangle.
    pub to: [f64; 2],
    /// Unit direction of a point of the rectangle; where patches meet, all give the same.
    pub direction: F,
}

/// Edges are halved until they turn less about the axis of the map than this, in radians,
const LONGEST_TURN: f64 = 0.02;
/// and are shorter than this,
const LONGEST_CHORD: f64 = 0.01;
/// or this often.
const DEEPEST: u32 = 12;
/// Squared distance from the axis below which a vertex has no azimuth.
const AT_POLE: f64 = 1e-28;

impl Grid {
    /// The pixels of a map of that size.
    pub fn new(width: usize, height: usize) -> Self {
        let mut borders: Vec<f64> = (0..=height).map(|row| elementary::cos(row as f64 * PI / height as f64)).collect();
        (borders[0], borders[height]) = (1.0, -1.0);
        Self { width, height, borders }
    }

    /// Pixels around the horizon.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Pixels from pole to pole.
    pub fn height(&self) -> usize {
        self.height
    }

    /// Steradians of a pixel in row `y`.
    pub fn solid_angle(&self, y: usize) -> f64 {
        TAU / self.width as f64 * (self.borders[y] - self.borders[y + 1])
    }

    /// Calls `found` with column, row and common steradians of every pixel that the patch may overlap.
    ///
    /// A patch holds at most one pole and spans less than half of the sphere.
    pub fn overlap(&self, patch: &Patch<impl Fn([f64; 2]) -> DVec3>, scratch: &mut Scratch, mut found: impl FnMut(usize, usize, f64)) {
        self.trace(patch, &mut scratch.polygon);
        let Some(window) = self.window(&scratch.polygon) else { return };
        scratch.parts.clear();
        scratch.parts.resize(window.columns * window.rows, 0.0);
        let polygon = &scratch.polygon;
        let twice_area: f64 = edges(polygon).map(|([xa, za], [xb, zb])| (xb - xa) * (za + zb)).sum();
        for ([xa, za], [xb, zb]) in edges(polygon) {
            self.sweep([xa, za], [xb, zb], &window, &mut scratch.parts);
        }
        // The way round is a matter of the layout; area is positive.
        let steradians_per_part = TAU / self.width as f64 * 1.0_f64.copysign(twice_area);
        for row in 0..window.rows {
            for column in 0..window.columns {
                let part = scratch.parts[row * window.columns + column];
                if part != 0.0 {
                    let x = (window.first_column + column as i64).rem_euclid(self.width as i64) as usize;
                    found(x, window.first_row + row, part * steradians_per_part);
                }
            }
        }
    }

    /// The outline of a patch in column and cosine; closed, also where it goes around a pole.
    fn trace(&self, patch: &Patch<impl Fn([f64; 2]) -> DVec3>, polygon: &mut Vec<[f64; 2]>) {
        polygon.clear();
        let ([x0, y0], [x1, y1]) = (patch.from, patch.to);
        let center = (patch.direction)([0.5 * (x0 + x1), 0.5 * (y0 + y1)]);
        let corners = [[x0, y0], [x1, y0], [x1, y1], [x0, y1]].map(|point| Vertex { point, direction: (patch.direction)(point) });
        let center_azimuth = (!at_pole(center)).then(|| azimuth(center));
        let mut outline = Outline { polygon, azimuth: 0.0, center: center_azimuth, first: None, pole: None };
        for side in 0..4 {
            outline.vertex(corners[side].direction);
            halved(&patch.direction, &corners[side], &corners[(side + 1) % 4], 0, &mut outline);
        }
        outline.close(corners[0].direction, center.y);
        let columns_per_radian = self.width as f64 / TAU;
        polygon.iter_mut().for_each(|vertex| vertex[0] *= columns_per_radian);
    }

    /// The pixels around a polygon; `None` if it has no extent.
    fn window(&self, polygon: &[[f64; 2]]) -> Option<Window> {
        let extent = |axis: usize| {
            polygon
                .iter()
                .fold([f64::INFINITY, f64::NEG_INFINITY], |[least, most], vertex| [least.min(vertex[axis]), most.max(vertex[axis])])
        };
        let ([left, right], [low, high]) = (extent(0), extent(1));
        if !(left < right && low < high) {
            return None;
        }
        let first_row = (self.borders.partition_point(|border| *border > high).max(1) - 1).min(self.height - 1);
        let end_row = self.borders.partition_point(|border| *border > low).clamp(first_row + 1, self.height);
        let first_column = left.floor() as i64;
        let columns = (right.ceil() as i64 - first_column).max(1) as usize;
        Some(Window { first_column, columns, first_row, rows: end_row - first_row })
    }

    /// Adds, for each rectangle, the signed area between an edge and the lower border of the window, in columns times
    /// cosine. Around a closed polygon what lies below it cancels.
    fn sweep(&self, [xa, za]: [f64; 2], [xb, zb]: [f64; 2], window: &Window, parts: &mut [f64]) {
        // What is narrower has no area, and its slope no number.
        if (xa - xb).abs() < 1e-200 {
            return;
        }
        let (left, right, sign) = if xa < xb { (xa, xb, 1.0) } else { (xb, xa, -1.0) };
        let slope = (zb - za) / (xb - xa);
        let bounds = if za < zb { [za, zb] } else { [zb, za] };
        let height_at = |x: f64| (za + slope * (x - xa)).clamp(bounds[0], bounds[1]);
        let end_column = (right.ceil() as i64 - window.first_column).min(window.columns as i64);
        for column in (left.floor() as i64 - window.first_column).max(0)..end_column {
            let start = (window.first_column + column) as f64;
            let (from, to) = (left.max(start), right.min(start + 1.0));
            if from >= to {
                continue;
            }
            let (a, b) = (height_at(from), height_at(to));
            for row in (0..window.rows).rev() {
                let (low, high) = (self.borders[window.first_row + row + 1], self.borders[window.first_row + row]);
                if a <= low && b <= low {
                    break;
                }
                parts[row * window.columns + column as usize] += sign * (to - from) * mean_between(a - low, b - low, high - low);
            }
        }
    }
}

/// A rectangle of pixels; columns may lie beyond the seam.
struct Window {
    first_column: i64,
    columns: usize,
    first_row: usize,
    rows: usize,
}

struct Vertex {
    point: [f64; 2],
    direction: DVec3,
}

/// Vertices between two, so many that straight edges between them serve; the same seen from either end.
fn halved(direction: &impl Fn([f64; 2]) -> DVec3, a: &Vertex, b: &Vertex, depth: u32, outline: &mut Outline<'_>) {
    let is_short = (a.direction - b.direction).length_squared() < LONGEST_CHORD * LONGEST_CHORD;
    // Without an azimuth the turn is that of the other end to anything, and the edge a meridian.
    let turn = if at_pole(a.direction) || at_pole(b.direction) { 0.0 } else { wrapped(azimuth(b.direction) - azimuth(a.direction)).abs() };
    if depth >= DEEPEST || is_short && turn < LONGEST_TURN {
        return;
    }
    let point = [0.5 * (a.point[0] + b.point[0]), 0.5 * (a.point[1] + b.point[1])];
    let middle = Vertex { point, direction: direction(point) };
    halved(direction, a, &middle, depth + 1, outline);
    outline.vertex(middle.direction);
    halved(direction, &middle, b, depth + 1, outline);
}

/// Follows an outline around the axis.
struct Outline<'p> {
    polygon: &'p mut Vec<[f64; 2]>,
    /// Azimuth of the last vertex, going on across the seam.
    azimuth: f64,
    /// Azimuth of the middle of the patch: from a corner at the pole, the patch lies to that side. None where the middle
    /// is the pole itself.
    center: Option<f64>,
    first: Option<f64>,
    /// Cosine of the pole at which the last vertex lies.
    pole: Option<f64>,
}

impl Outline<'_> {
    fn vertex(&mut self, direction: DVec3) {
        if at_pole(direction) {
            let cosine = 1.0_f64.copysign(direction.y);
            if self.first.is_some() {
                self.polygon.push([self.azimuth, cosine]);
            }
            if let Some(center) = self.center {
                self.turn_to(center);
            }
            self.polygon.push([self.azimuth, cosine]);
            self.pole = Some(cosine);
        } else {
            self.turn_to(azimuth(direction));
            if let Some(cosine) = self.pole.take() {
                self.polygon.push([self.azimuth, cosine]);
            }
            self.polygon.push([self.azimuth, direction.y.clamp(-1.0, 1.0)]);
        }
        self.first.get_or_insert(self.azimuth);
    }

    fn turn_to(&mut self, azimuth: f64) {
        self.azimuth = if self.first.is_some() { self.azimuth + wrapped(azimuth - self.azimuth) } else { azimuth };
    }

    /// Comes back to the first vertex; if the way went around a pole, the patch reaches to it.
    fn close(&mut self, first: DVec3, side: f64) {
        let Some(begun) = self.first else { return };
        self.vertex(first);
        if (self.azimuth - begun).abs() > PI {
            let pole = 1.0_f64.copysign(side);
            self.polygon.push([self.azimuth, pole]);
            self.polygon.push([begun, pole]);
        }
    }
}

fn at_pole(direction: DVec3) -> bool {
    direction.x * direction.x + direction.z * direction.z < AT_POLE
}

fn azimuth(direction: DVec3) -> f64 {
    elementary::atan2(direction.z, direction.x)
}

/// The same angle between -pi and pi.
fn wrapped(angle: f64) -> f64 {
    angle - TAU * (angle / TAU).round()
}

fn edges(polygon: &[[f64; 2]]) -> impl Iterator<Item = ([f64; 2], [f64; 2])> + '_ {
    (0..polygon.len()).map(|index| (polygon[index], polygon[(index + 1) % polygon.len()]))
}

/// Mean of clamp(t, 0, h) for t from a to b.
///
/// With G(t) the integral of the clamped line, (G(b) - G(a)) / (b - a); for an edge that is nearly level, the middle.
fn mean_between(a: f64, b: f64, h: f64) -> f64 {
    if a.min(b) >= 0.0 && a.max(b) <= h {
        return 0.5 * (a + b);
    }
    if (b - a).abs() < 1e-9 * h {
        return (0.5 * (a + b)).clamp(0.0, h);
    }
    let integral = |t: f64| {
        if t <= 0.0 {
            0.0
        } else if t < h {
            0.5 * t * t
        } else {
            h * (t - 0.5 * h)
        }
    };
    (integral(b) - integral(a)) / (b - a)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::envmap;

    /// Common steradians of a patch with every pixel.
    fn shares(grid: &Grid, patch: &Patch<impl Fn([f64; 2]) -> DVec3>) -> Vec<f64> {
        let mut shares = vec![0.0; grid.width * grid.height];
        grid.overlap(patch, &mut Scratch::default(), |x, y, share| shares[y * grid.width + x] += share);
        shares
    }

    /// A cap about a unit axis, as the image of a disk's bounding square would not be: polar coordinates.
    fn sector(axis: DVec3, angle: f64, turns: [f64; 2]) -> Patch<impl Fn([f64; 2]) -> DVec3> {
        let frame = crate::math::sphere::frame_about(axis);
        let direction = move |[turn, theta]: [f64; 2]| {
            let (sine, cosine) = elementary::sin_cos(theta);
            let (sin_phi, cos_phi) = elementary::sin_cos(turn * TAU);
            frame * DVec3::new(sine * cos_phi, sine * sin_phi, cosine)
        };
        Patch { from: [turns[0], 0.0], to: [turns[1], angle], direction }
    }

    #[test]
    fn a_pixel_overlaps_itself_alone() {
        let (width, height) = (16, 8);
        let grid = Grid::new(width, height);
        for y in 0..height {
            for x in [0, 5, 15] {
                let direction = |[u, v]: [f64; 2]| envmap::direction_at(v * PI / height as f64, u * TAU / width as f64);
                let patch = Patch { from: [x as f64, y as f64], to: [x as f64 + 1.0, y as f64 + 1.0], direction };
                for (index, share) in shares(&grid, &patch).into_iter().enumerate() {
                    let expected = if index == y * width + x { grid.solid_angle(y) } else { 0.0 };
                    assert!((share - expected).abs() < 1e-14, "({x}, {y}) {index}: {share} for {expected}");
                }
            }
        }
    }

    #[test]
    fn sectors_of_a_cap_have_its_solid_angle_wherever_it_lies() {
        let grid = Grid::new(36, 18);
        let angle = 0.4;
        let expected = TAU * (1.0 - elementary::cos(angle));
        for axis in [DVec3::Y, -DVec3::Y, DVec3::X, DVec3::new(1.0, 0.0, -1e-3).normalize(), DVec3::new(0.2, 0.9, 0.1).normalize()] {
            let total: f64 = (0..5).flat_map(|k| shares(&grid, &sector(axis, angle, [f64::from(k) / 5.0, f64::from(k + 1) / 5.0]))).sum();
            // Chords of 0.01 in a circle of radius 0.4 cut off a sixth of the square of 0.025.
            assert!((total / expected - 1.0).abs() < 1.1e-4, "{axis}: {total} for {expected}");
        }
    }

    #[test]
    fn a_patch_around_a_pole_takes_it_in() {
        let grid = Grid::new(12, 8);
        for side in [1.0, -1.0] {
            let direction = |[a, b]: [f64; 2]| DVec3::new(a, side, b).normalize();
            let found = shares(&grid, &Patch { from: [-0.1, -0.1], to: [0.1, 0.1], direction });
            // The solid angle of a centered rectangle a x b at distance d: 4 atan(a b / (2 d sqrt(4 d² + a² + b²))).
            let expected = 4.0 * elementary::atan(0.2 * 0.2 / (2.0 * (4.0_f64 + 0.08).sqrt()));
            assert!((found.iter().sum::<f64>() / expected - 1.0).abs() < 1e-4, "{} for {expected}", found.iter().sum::<f64>());
            assert!(found.iter().all(|share| *share > -1e-15));
            let row = if side > 0.0 { 0 } else { 7 };
            let (least, most) = found[row * 12..(row + 1) * 12].iter().fold((f64::INFINITY, 0.0_f64), |(a, b), c| (a.min(*c), b.max(*c)));
            // Thirty degrees of a square have tan 30 / 2 of a quarter beside the axes, and 1 - tan 30 at the diagonals.
            assert!((least / most - 0.288_675 / 0.422_65).abs() < 5e-3, "{least} {most}");
        }
    }

    #[test]
    fn the_mean_of_a_clamped_line_is_that_of_many_points() {
        for (a, b, h) in [(-1.0, 2.0, 1.0), (0.2, 0.7, 1.0), (3.0, -0.5, 1.0), (-2.0, -1.0, 1.0), (1.5, 2.0, 1.0), (0.5, 0.5, 1.0)] {
            let points = 100_000;
            let mean = (0..points).map(|k| (a + (b - a) * (f64::from(k) + 0.5) / f64::from(points)).clamp(0.0, h)).sum::<f64>()
                / f64::from(points);
            assert!((mean_between(a, b, h) - mean).abs() < 1e-9, "{a} {b}: {} for {mean}", mean_between(a, b, h));
        }
    }
}

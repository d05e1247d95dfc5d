//! Ways to lay the sphere of directions out on a picture: cube maps, octahedral and angular maps, mirror balls.
//!
//! Each says which direction a point of a pixel looks in, and which pixels have directions. Knows no radiance; see
//! `reproject`. The axes are those of the world, right-handed with +y up; `docs/conventions.md`.
//!
//! After Debevec, "Light probe image gallery" (angular maps); Clarberg, "Fast equal-area mapping of the (hemi)sphere using
//! SIMD", JGT 13(3) (2008), as in pbrt-v4; Khronos, "OpenGL specification", table of cube map faces.

use std::f64::consts::PI;

use glam::{DMat3, DVec3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::light::envmap;
use crate::math::elementary;

/// How directions lie in a picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Layout {
    /// Six faces of a cube unfolded as a cross of 4 x 3, seen from inside: -x, -z, +x, +z from left to right, +y above -z
    /// and -y below it. Half of the picture is empty.
    CubeCross,
    /// Six faces of a cube side by side: +x, -x, +y, -y, +z, -z, each turned as OpenGL and KTX have it.
    CubeStrip,
    /// A square, unfolded from an octahedron so that every pixel has the same solid angle: that of pbrt-v4, +z in the
    /// middle and -z in the corners, with our axes as they are.
    Octahedral,
    /// A disk around the direction of view whose radius is proportional to the angle from it, up to 180 degrees at its
    /// rim; seen from inside. Debevec's angular maps.
    Angular,
    /// A photograph of a mirroring ball: the middle shows what is behind the camera, the rim what is behind the ball.
    MirrorBall,
}

impl Layout {
    /// Its name in the pipeline file.
    pub fn name(self) -> &'static str {
        match self {
            Self::CubeCross => "cube-cross",
            Self::CubeStrip => "cube-strip",
            Self::Octahedral => "octahedral",
            Self::Angular => "angular",
            Self::MirrorBall => "mirror-ball",
        }
    }

    /// Whether it is a disk about a direction.
    pub fn is_disk(self) -> bool {
        matches!(self, Self::Angular | Self::MirrorBall)
    }

    /// Width and height of the picture whose square, or each of whose faces, has that side.
    pub fn size(self, side: usize) -> [usize; 2] {
        match self {
            Self::CubeCross => [4 * side, 3 * side],
            Self::CubeStrip => [6 * side, side],
            Self::Octahedral | Self::Angular | Self::MirrorBall => [side, side],
        }
    }

    /// The side of the square, or of each face, of a picture of that size.
    pub fn side_of(self, [width, height]: [usize; 2]) -> usize {
        match self {
            Self::CubeCross => width / 4,
            Self::CubeStrip => height,
            Self::Octahedral | Self::Angular | Self::MirrorBall => width.min(height),
        }
    }

    /// The side for which a picture has about the resolution of a map of that height.
    pub fn side_for(self, map_height: usize) -> usize {
        match self {
            Self::CubeCross | Self::CubeStrip => map_height.div_ceil(2),
            Self::Octahedral | Self::Angular | Self::MirrorBall => map_height,
        }
    }

    /// The height of a map that has about the resolution of a picture of that side.
    pub fn map_height_for(self, side: usize) -> usize {
        match self {
            Self::CubeCross | Self::CubeStrip => 2 * side,
            Self::Octahedral | Self::Angular | Self::MirrorBall => side,
        }
    }
}

/// Where a disk lies in its picture and which way it looks.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Disk {
    /// Its center in pixels from the upper left corner.
    pub center: [f64; 2],
    /// Its radius in pixels.
    pub radius: f64,
    /// For a ball: distance of the camera from its center over its radius, above 1; infinite for parallel rays.
    pub camera_distance: f64,
    /// The direction in which the camera looks; of any length but none.
    pub looks_along: DVec3,
    /// A direction that is up in the picture.
    pub up: DVec3,
}

impl Disk {
    /// The largest disk of a square picture, seen along -z from afar with +y up.
    pub fn inscribed(side: usize) -> Self {
        let half = 0.5 * side as f64;
        Self { center: [half; 2], radius: half, camera_distance: f64::INFINITY, looks_along: DVec3::NEG_Z, up: DVec3::Y }
    }
}

/// Why a picture has no directions.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum LayoutError {
    /// The sides do not fit together.
    #[error("a picture in layout `{layout}` is {expected}, but this one has {width} x {height} pixels")]
    Size {
        /// Name of the layout.
        layout: &'static str,
        /// The shape it must have.
        expected: &'static str,
        /// Pixels in a row.
        width: usize,
        /// Rows.
        height: usize,
    },
    /// The camera's axes do not stand on each other.
    #[error("`looks_along` and `up` have no length or are parallel, so there is no picture's right")]
    Axes,
    /// No pixel's center lies in the disk.
    #[error("the disk of radius `{radius}` around ({x}, {y}) covers no pixel of the picture")]
    Nowhere {
        /// Pixels.
        radius: f64,
        /// Column of its center.
        x: f64,
        /// Row of its center.
        y: f64,
    },
}

/// A picture of a certain size in a layout.
#[derive(Debug, Clone)]
pub struct Chart {
    width: usize,
    height: usize,
    sort: Sort,
}

#[derive(Debug, Clone)]
enum Sort {
    Cross {
        side: usize,
    },
    Strip {
        side: usize,
    },
    Octahedral {
        side: usize,
    },
    Disk {
        disk: Disk,
        is_ball: bool,
        frame: DMat3,
    },
    /// A lat-long map, and what turns its directions.
    LatLong {
        turn: DMat3,
    },
}

impl Chart {
    /// A picture of that size; `disk` is read by the layouts that are one.
    pub fn new(layout: Layout, [width, height]: [usize; 2], disk: &Disk) -> Result<Self, LayoutError> {
        let size = |is_right: bool, expected| {
            if is_right { Ok(()) } else { Err(LayoutError::Size { layout: layout.name(), expected, width, height }) }
        };
        let sort = match layout {
            Layout::CubeCross => {
                size(width % 4 == 0 && width / 4 * 3 == height, "a third wider than high: 4 faces by 3")?;
                Sort::Cross { side: width / 4 }
            }
            Layout::CubeStrip => {
                size(width == 6 * height, "six times as wide as high")?;
                Sort::Strip { side: height }
            }
            Layout::Octahedral => {
                size(width == height, "a square")?;
                Sort::Octahedral { side: width }
            }
            Layout::Angular | Layout::MirrorBall => {
                let is_ball = layout == Layout::MirrorBall;
                Sort::Disk { disk: *disk, is_ball, frame: disk_frame(disk, is_ball)? }
            }
        };
        let chart = Self { width, height, sort };
        match chart.sort {
            Sort::Disk { disk: Disk { radius, center: [x, y], .. }, .. } if !chart.has_pixels() => {
                Err(LayoutError::Nowhere { radius, x, y })
            }
            _ => Ok(chart),
        }
    }

    /// A lat-long map of that size, what it showed at direction d now being at `turn` d.
    pub fn turned_map([width, height]: [usize; 2], turn: DMat3) -> Self {
        Self { width, height, sort: Sort::LatLong { turn: turn.transpose() } }
    }

    /// Pixels in a row.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// Whether the pixel stands for directions: its center lies on a face, or in the disk.
    pub fn is_covered(&self, x: usize, y: usize) -> bool {
        match &self.sort {
            Sort::Cross { side } => y / side == 1 || x / side == 1,
            Sort::Disk { disk, .. } => from_center(disk, [x as f64 + 0.5, y as f64 + 0.5]).1 < 1.0,
            Sort::Strip { .. } | Sort::Octahedral { .. } | Sort::LatLong { .. } => true,
        }
    }

    /// Whether any part of the pixel stands for directions; more than `is_covered` at the rim of a disk alone.
    pub fn is_touched(&self, x: usize, y: usize) -> bool {
        match &self.sort {
            Sort::Disk { disk, .. } => {
                let nearest = [(disk.center[0]).clamp(x as f64, x as f64 + 1.0), (disk.center[1]).clamp(y as f64, y as f64 + 1.0)];
                from_center(disk, nearest).1 < 1.0
            }
            _ => self.is_covered(x, y),
        }
    }

    /// The pixel whose color stands for a pixel at the rim of a disk: itself if its center lies inside, else the next one
    /// towards the center that does.
    pub fn inner(&self, x: usize, y: usize) -> Option<(usize, usize)> {
        let Sort::Disk { disk, .. } = &self.sort else { return Some((x, y)) };
        let center = [x as f64 + 0.5, y as f64 + 0.5];
        let steps = (0..8).map(|half_step| {
            let length = elementary::hypot(center[0] - disk.center[0], center[1] - disk.center[1]);
            let share = 0.5 * f64::from(half_step) / length.max(1.0);
            [0, 1].map(|axis| (center[axis] + share * (disk.center[axis] - center[axis])).floor())
        });
        let mut pixels = steps.filter(|[x, y]| *x >= 0.0 && *y >= 0.0 && *x < self.width as f64 && *y < self.height as f64);
        pixels.find(|[x, y]| self.is_covered(*x as usize, *y as usize)).map(|[x, y]| (x as usize, y as usize))
    }

    /// Into how many parts a side each pixel is cut, so that no part is a large piece of the sphere and none has a pole
    /// on an edge.
    pub fn parts_per_side(&self) -> usize {
        const FEWEST: usize = 16;
        let side = match &self.sort {
            Sort::Cross { side } | Sort::Strip { side } => 2 * side,
            Sort::Octahedral { side } => *side,
            Sort::Disk { disk, .. } => disk.radius as usize,
            Sort::LatLong { .. } => self.width.min(2 * self.height),
        };
        let parts = FEWEST.div_ceil(side.max(1)).min(FEWEST);
        // The axes x and y end in the middle of the sides of an octahedral square, which are folded there.
        if matches!(self.sort, Sort::Octahedral { side } if side % 2 == 1) { parts.next_multiple_of(2) } else { parts }
    }

    /// Unit direction of a point of pixel (x, y), given in pixels from the upper left corner of the picture.
    ///
    /// Beyond the rim of a disk, that of the nearest point on it.
    pub fn direction(&self, (x, y): (usize, usize), point: [f64; 2]) -> DVec3 {
        match &self.sort {
            Sort::Cross { side } => {
                let [s, t] = on_face(point, *side, [x / side, y / side]);
                let direction = match (x / side, y / side) {
                    (_, 0) => DVec3::new(s, 1.0, -t),
                    (_, 2) => DVec3::new(s, -1.0, t),
                    (0, _) => DVec3::new(-1.0, -t, -s),
                    (1, _) => DVec3::new(s, -t, -1.0),
                    (2, _) => DVec3::new(1.0, -t, s),
                    _ => DVec3::new(-s, -t, 1.0),
                };
                direction.normalize()
            }
            Sort::Strip { side } => {
                let [s, t] = on_face(point, *side, [x / side, 0]);
                let direction = match x / side {
                    0 => DVec3::new(1.0, -t, -s),
                    1 => DVec3::new(-1.0, -t, s),
                    2 => DVec3::new(s, 1.0, t),
                    3 => DVec3::new(s, -1.0, -t),
                    4 => DVec3::new(s, -t, 1.0),
                    _ => DVec3::new(-s, -t, -1.0),
                };
                direction.normalize()
            }
            Sort::Octahedral { side } => octahedral_direction(point.map(|along| along / *side as f64)),
            Sort::Disk { disk, is_ball, frame } => {
                let ([right, down], radius) = from_center(disk, point);
                // All of the rim of an angular map, and of a ball seen from afar, is one direction.
                let angle = if *is_ball { reflected_angle(radius.min(1.0), disk.camera_distance) } else { radius.min(1.0) * PI };
                let (sine, cosine) = if angle >= PI { (0.0, -1.0) } else { elementary::sin_cos(angle) };
                *frame * DVec3::new(sine * right, -sine * down, cosine)
            }
            Sort::LatLong { turn } => {
                *turn * envmap::direction_at(point[1] * PI / self.height as f64, point[0] * 2.0 * PI / self.width as f64)
            }
        }
    }

    fn has_pixels(&self) -> bool {
        (0..self.height).any(|y| (0..self.width).any(|x| self.is_covered(x, y)))
    }
}

/// Axes of a disk as columns: right, up, and the direction of its center.
fn disk_frame(disk: &Disk, is_ball: bool) -> Result<DMat3, LayoutError> {
    let view = disk.looks_along.try_normalize().ok_or(LayoutError::Axes)?;
    let upward = disk.up.try_normalize().ok_or(LayoutError::Axes)?;
    let right = view.cross(upward);
    if right.length() < 1e-6 {
        return Err(LayoutError::Axes);
    }
    let right = right.normalize();
    Ok(DMat3::from_cols(right, right.cross(view), if is_ball { -view } else { view }))
}

/// Unit vector from the center of a disk to a point, rightwards and downwards, and the distance over the radius.
fn from_center(disk: &Disk, point: [f64; 2]) -> ([f64; 2], f64) {
    let [x, y] = [point[0] - disk.center[0], point[1] - disk.center[1]];
    let length = elementary::hypot(x, y);
    if length > 0.0 { ([x / length, y / length], length / disk.radius) } else { ([1.0, 0.0], 0.0) }
}

/// Angle between the direction to the camera's side and what a ball shows at `radius` (0 to 1) of its picture.
///
/// From afar 2 asin(r). A camera at distance D (in radii of the ball) sees its rim at the angle asin(1 / D) from the axis,
/// the ray at angle a with tan a = r tan asin(1 / D) meets the ball where its normal is at b = asin(D sin a) - a, and
/// goes on at 2 b + a.
pub fn reflected_angle(radius: f64, camera_distance: f64) -> f64 {
    if camera_distance.is_infinite() {
        return 2.0 * elementary::asin(radius);
    }
    let tangent = radius / (camera_distance * camera_distance - 1.0).sqrt();
    let ray = elementary::atan(tangent);
    let normal = elementary::asin((camera_distance * tangent / (1.0 + tangent * tangent).sqrt()).min(1.0)) - ray;
    2.0 * normal + ray
}

/// Coordinates from -1 to 1, rightwards and downwards, on the face in that column and row of faces.
fn on_face(point: [f64; 2], side: usize, face: [usize; 2]) -> [f64; 2] {
    [0, 1].map(|axis| 2.0 * (point[axis] - (face[axis] * side) as f64) / side as f64 - 1.0)
}

/// Clarberg's map from the unit square to the sphere, which keeps areas (pbrt-v4, `EqualAreaSquareToSphere`).
pub fn octahedral_direction([x, y]: [f64; 2]) -> DVec3 {
    let (u, v) = (2.0 * x - 1.0, 2.0 * y - 1.0);
    let (along, across) = (u.abs(), v.abs());
    let above = 1.0 - (along + across);
    let r = 1.0 - above.abs();
    let phi = if r <= 0.0 { 0.25 * PI } else { ((across - along) / r + 1.0) * 0.25 * PI };
    let z = (1.0 - r * r).copysign(above);
    let (sine, cosine) = elementary::sin_cos(phi);
    let ring = r * (2.0 - r * r).max(0.0).sqrt();
    DVec3::new(cosine.abs().copysign(u) * ring, sine.abs().copysign(v) * ring, z)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chart(layout: Layout, side: usize) -> Chart {
        Chart::new(layout, layout.size(side), &Disk::inscribed(side)).unwrap()
    }

    /// Direction of the middle of a pixel.
    fn at(chart: &Chart, x: usize, y: usize) -> DVec3 {
        chart.direction((x, y), [x as f64 + 0.5, y as f64 + 0.5])
    }

    fn same(a: DVec3, b: DVec3) -> bool {
        (a - b).length() < 1e-12
    }

    #[test]
    fn middles_of_faces_are_the_axes() {
        let cross = chart(Layout::CubeCross, 3);
        let expected =
            [((1, 4), -DVec3::X), ((4, 4), -DVec3::Z), ((7, 4), DVec3::X), ((10, 4), DVec3::Z), ((4, 1), DVec3::Y), ((4, 7), -DVec3::Y)];
        for ((x, y), axis) in expected {
            assert!(same(at(&cross, x, y), axis), "({x}, {y})");
        }
        let strip = chart(Layout::CubeStrip, 3);
        for (face, axis) in [DVec3::X, -DVec3::X, DVec3::Y, -DVec3::Y, DVec3::Z, -DVec3::Z].into_iter().enumerate() {
            assert!(same(at(&strip, 3 * face + 1, 1), axis), "{face}");
        }
    }

    #[test]
    fn faces_of_the_cross_join_at_their_edges() {
        let chart = chart(Layout::CubeCross, 4);
        for k in 0..=4 {
            let along = f64::from(k);
            for ((a, p), (b, q)) in [
                (((3, 5), [4.0, 4.0 + along]), ((4, 5), [4.0, 4.0 + along])),
                (((7, 5), [8.0, 4.0 + along]), ((8, 5), [8.0, 4.0 + along])),
                (((11, 5), [12.0, 4.0 + along]), ((12, 5), [12.0, 4.0 + along])),
                (((5, 3), [4.0 + along, 4.0]), ((5, 4), [4.0 + along, 4.0])),
                (((5, 7), [4.0 + along, 8.0]), ((5, 8), [4.0 + along, 8.0])),
                // The two ends of the row of four.
                (((0, 5), [0.0, 4.0 + along]), ((15, 5), [16.0, 4.0 + along])),
            ] {
                assert!(same(chart.direction(a, p), chart.direction(b, q)), "{a:?} {p:?}");
            }
        }
    }

    #[test]
    fn the_strip_is_that_of_the_published_table() {
        // OpenGL 4.6, table 8.19: for +x, s = (-rz / |rx| + 1) / 2 and t = (-ry / |rx| + 1) / 2, and so on.
        let table = |d: DVec3| {
            let (face, sc, tc, ma) = match d.abs().to_array() {
                [x, y, z] if x > y && x > z => {
                    if d.x > 0.0 {
                        (0, -d.z, -d.y, x)
                    } else {
                        (1, d.z, -d.y, x)
                    }
                }
                [_, y, z] if y > z => {
                    if d.y > 0.0 {
                        (2, d.x, d.z, y)
                    } else {
                        (3, d.x, -d.z, y)
                    }
                }
                [_, _, z] => {
                    if d.z > 0.0 {
                        (4, d.x, -d.y, z)
                    } else {
                        (5, -d.x, -d.y, z)
                    }
                }
            };
            (face, 0.5 * (sc / ma + 1.0), 0.5 * (tc / ma + 1.0))
        };
        let (side, strip) = (8, chart(Layout::CubeStrip, 8));
        for y in 0..side {
            for x in 0..6 * side {
                let (face, s, t) = table(at(&strip, x, y));
                let expected = ((x % side) as f64 + 0.5, y as f64 + 0.5);
                assert_eq!(face, x / side);
                assert!((s * side as f64 - expected.0).abs() < 1e-12 && (t * side as f64 - expected.1).abs() < 1e-12);
            }
        }
    }

    /// pbrt-v4's `EqualAreaSphereToSquare` by its formulas, with the exact arc tangent.
    fn octahedral_square(d: DVec3) -> [f64; 2] {
        let (x, y, z) = (d.x.abs(), d.y.abs(), d.z.abs());
        let r = (1.0 - z).max(0.0).sqrt();
        let phi = if x.max(y) == 0.0 { 0.0 } else { elementary::atan(x.min(y) / x.max(y)) * 2.0 / PI };
        let phi = if x < y { 1.0 - phi } else { phi };
        let (mut v, mut u) = (phi * r, r - phi * r);
        if d.z < 0.0 {
            (u, v) = (1.0 - v, 1.0 - u);
        }
        [0.5 * (u.copysign(d.x) + 1.0), 0.5 * (v.copysign(d.y) + 1.0)]
    }

    #[test]
    fn the_octahedral_square_is_that_of_pbrt() {
        for (x, y, axis) in [
            (0.5, 0.5, DVec3::Z),
            (1.0, 0.5, DVec3::X),
            (0.0, 0.5, -DVec3::X),
            (0.5, 1.0, DVec3::Y),
            (0.5, 0.0, -DVec3::Y),
            (0.0, 1.0, -DVec3::Z),
        ] {
            assert!((octahedral_direction([x, y]) - axis).length() < 1e-12, "({x}, {y}): {}", octahedral_direction([x, y]));
        }
        for k in 0..900 {
            let point = [(f64::from(k % 30) + 0.3) / 30.0, (f64::from(k / 30) + 0.6) / 30.0];
            let direction = octahedral_direction(point);
            let again = octahedral_square(direction);
            assert!((direction.length() - 1.0).abs() < 1e-14);
            assert!((again[0] - point[0]).abs() < 1e-9 && (again[1] - point[1]).abs() < 1e-9, "{point:?}: {again:?}");
        }
    }

    #[test]
    fn the_angular_map_has_the_view_in_its_middle_and_right_at_its_right() {
        let chart = chart(Layout::Angular, 5);
        assert!(same(at(&chart, 2, 2), -DVec3::Z));
        // A quarter of a turn is half of the radius.
        assert!(same(chart.direction((4, 2), [3.75, 2.5]), DVec3::X) && same(chart.direction((2, 0), [2.5, 1.25]), DVec3::Y));
        assert!(same(chart.direction((4, 4), [5.0, 5.0]), DVec3::Z));
    }

    #[test]
    fn the_ball_shows_the_camera_in_its_middle() {
        let chart = chart(Layout::MirrorBall, 101);
        assert!(same(at(&chart, 50, 50), DVec3::Z));
        // r = 2 (n·v) n - v for the normal of each point.
        for (x, y) in [(60, 50), (50, 20), (90, 70), (12, 40)] {
            let n = DVec2Like::of(x, y, 101);
            let expected = 2.0 * n.z * n - DVec3::Z;
            assert!(same(at(&chart, x, y), expected), "({x}, {y})");
        }
    }

    struct DVec2Like;

    impl DVec2Like {
        fn of(x: usize, y: usize, side: usize) -> DVec3 {
            let (x, y) = (2.0 * (x as f64 + 0.5) / side as f64 - 1.0, 1.0 - 2.0 * (y as f64 + 0.5) / side as f64);
            DVec3::new(x, y, (1.0 - x * x - y * y).sqrt())
        }
    }

    #[test]
    fn a_camera_near_by_sees_less_around_the_ball() {
        for distance in [1.5, 4.0, 100.0] {
            // At the rim the ray passes on: what is seen is as far from the axis as the rim itself.
            let rim = PI - elementary::asin(1.0 / distance);
            assert!((reflected_angle(1.0, distance) - rim).abs() < 1e-7, "{distance}");
            // Traced by hand: the ray meets the unit sphere, and turns about the normal there.
            for radius in [0.0, 0.2, 0.7, 0.99] {
                let slope = radius / (distance * distance - 1.0_f64).sqrt();
                let ray = DVec3::new(slope, 0.0, -1.0).normalize();
                let origin = DVec3::new(0.0, 0.0, distance);
                let half = origin.dot(ray);
                let hit = origin + ray * (-half - (half * half - distance * distance + 1.0).sqrt());
                let out = ray - 2.0 * ray.dot(hit) * hit;
                let expected = elementary::atan2(out.x, out.z);
                assert!((reflected_angle(radius, distance) - expected).abs() < 1e-9, "{distance} {radius}");
            }
        }
        assert!((reflected_angle(0.5, 1e9) - reflected_angle(0.5, f64::INFINITY)).abs() < 1e-8);
    }

    #[test]
    fn wrong_shapes_and_axes_are_told() {
        let disk = Disk::inscribed(4);
        let error = |layout, size, disk: &Disk| Chart::new(layout, size, disk).unwrap_err().to_string();
        assert!(error(Layout::CubeCross, [8, 8], &disk).contains("4 faces by 3"));
        assert!(error(Layout::CubeStrip, [8, 8], &disk).contains("8 x 8"));
        assert!(error(Layout::Octahedral, [8, 7], &disk).contains("square"));
        assert!(error(Layout::Angular, [4, 4], &Disk { up: DVec3::Z, ..disk }).contains("`up`"));
        assert!(error(Layout::MirrorBall, [4, 4], &Disk { center: [9.0, 9.0], ..disk }).contains("no pixel"));
    }

    #[test]
    fn the_rim_of_a_disk_takes_the_color_of_the_next_pixel_inside() {
        let chart = chart(Layout::MirrorBall, 64);
        for y in 0..64 {
            for x in 0..64 {
                let Some((a, b)) = chart.inner(x, y) else {
                    assert!(!chart.is_touched(x, y), "({x}, {y})");
                    continue;
                };
                assert!(chart.is_covered(a, b));
                assert!(!chart.is_covered(x, y) || (a, b) == (x, y));
                assert!(a.abs_diff(x) <= 3 && b.abs_diff(y) <= 3);
            }
        }
    }
}

//! The building as a signed distance: one bay of a three-aisled nave, repeated, with an apse and a west wall.
//!
//! World: meters, +y up, the floor at y = 0, the nave along x with the apse at -x. The distance is
//! positive in air and never larger than about the true one, so that a ray may step by it (Hart,
//! "Sphere tracing", 1996). Everything is single precision and made of the four operations, square
//! roots and rounding: the same bits everywhere. Says nothing of light.

use glam::{Vec2, Vec3};

/// Length of a bay; piers stand at odd multiples of half a bay.
pub const BAY: f32 = 6.0;
/// Where the nave ends and the apse begins.
pub const EAST: f32 = -27.0;
/// The inner face of the west wall.
pub const WEST: f32 = 15.0;
/// Distance of the nave's walls from its axis.
pub const NAVE_HALF_WIDTH: f32 = 5.25;
/// Distance of the outer walls from the axis.
pub const OUTER_HALF_WIDTH: f32 = 11.0;
/// Height at which the main vault springs.
pub const VAULT_SPRING: f32 = 12.0;
/// Height of the main vault's ridge.
pub const VAULT_RIDGE: f32 = 18.84;
/// Chandeliers hang over the axis at every second bay: at odd multiples of this.
pub const CHANDELIER_HALF_SPACING: f32 = 6.0;
/// Height of the rings of the chandeliers.
pub const CHANDELIER_HEIGHT: f32 = 6.4;
/// Radius of the rings of the chandeliers.
pub const CHANDELIER_RADIUS: f32 = 1.15;
/// Center and radius of the rose window, in the west wall.
pub const ROSE: (f32, f32) = (11.6, 3.3);

const PIER_DISTANCE: f32 = 5.8;
const ARCADE_SPRING: f32 = 6.4;
const HALF_BAY: f32 = 0.5 * BAY;
const CENTER_OF_AISLE: f32 = 8.67;
const APSE_HALF_FACE: f32 = 1.706;

/// What a surface is made of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Part {
    /// Tiles of the nave's and the choir's floor.
    Floor,
    /// Plastered webs of the vaults.
    Web,
    /// Ribs, shafts, capitals, moldings: worked stone.
    Rib,
    /// Walls of squared stones.
    Wall,
    /// Stained glass.
    Glass,
    /// Pews and the door.
    Wood,
    /// Chandeliers and their chains.
    Iron,
    /// The altar's table.
    Marble,
    /// The cross and the shrine.
    Gold,
}

/// Larger and smaller of two numbers that are not NaN.
///
/// `f32::max` and `f32::min` also settle NaN, which costs four instructions instead of one, some fifty times a step.
trait Bounded {
    /// The larger one.
    fn at_least(self, least: f32) -> f32;
    /// The smaller one.
    fn at_most(self, most: f32) -> f32;
}

impl Bounded for f32 {
    #[inline(always)]
    fn at_least(self, least: f32) -> f32 {
        if self > least { self } else { least }
    }

    #[inline(always)]
    fn at_most(self, most: f32) -> f32 {
        if self < most { self } else { most }
    }
}

/// The nearest surface so far.
#[derive(Debug, Clone, Copy)]
struct Nearest {
    distance: f32,
    part: Part,
}

impl Nearest {
    #[inline(always)]
    fn add(&mut self, distance: f32, part: Part) {
        if distance < self.distance {
            *self = Self { distance, part };
        }
    }
}

/// A pointed arch: two arcs that meet over the middle, on straight jambs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Arch {
    /// Half the span.
    pub half_span: f32,
    /// How far beyond the middle each arc's center lies.
    pub overshoot: f32,
    /// Height of the springing.
    pub spring: f32,
}

impl Arch {
    /// Signed distance of (across, y) to the opening, negative inside; `across` is not negative.
    #[inline(always)]
    pub fn distance(&self, across: f32, y: f32) -> f32 {
        if y < self.spring {
            across - self.half_span
        } else {
            Vec2::new(across + self.overshoot, y - self.spring).length() - (self.half_span + self.overshoot)
        }
    }
}

/// A window: a pointed arch over a sill, in a wall.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Opening {
    /// Its outline.
    pub arch: Arch,
    /// Height of its sill.
    pub sill: f32,
}

impl Opening {
    /// Signed distance to the opening, negative inside.
    #[inline(always)]
    pub fn distance(&self, across: f32, y: f32) -> f32 {
        self.arch.distance(across, y).at_least(self.sill - y)
    }
}

/// Windows of the aisles.
pub const AISLE_WINDOW: Opening = Opening { arch: Arch { half_span: 1.25, overshoot: 1.1, spring: 6.0 }, sill: 2.4 };
/// Windows high in the nave.
pub const CLERESTORY_WINDOW: Opening = Opening { arch: Arch { half_span: 1.55, overshoot: 1.6, spring: 15.3 }, sill: 13.0 };
/// Windows of the apse.
pub const APSE_WINDOW: Opening = Opening { arch: Arch { half_span: 1.15, overshoot: 1.3, spring: 12.2 }, sill: 3.6 };
/// Distance of the glass of the three kinds of windows from the axis.
pub const AISLE_GLASS: f32 = 11.45;
/// See [`AISLE_GLASS`].
pub const CLERESTORY_GLASS: f32 = 5.85;
/// See [`AISLE_GLASS`]; from the center of the apse.
pub const APSE_GLASS: f32 = 5.7;

const NAVE_VAULT: Arch = Arch { half_span: NAVE_HALF_WIDTH, overshoot: 1.832, spring: VAULT_SPRING };
const NAVE_CROSS_VAULT: Arch = Arch { half_span: HALF_BAY, overshoot: 6.3, spring: VAULT_SPRING };
const AISLE_VAULT: Arch = Arch { half_span: 2.325, overshoot: 1.53, spring: ARCADE_SPRING };
const AISLE_CROSS_VAULT: Arch = Arch { half_span: 2.75, overshoot: 0.9, spring: ARCADE_SPRING };
const ARCADE: Arch = Arch { half_span: 2.1, overshoot: 1.3, spring: ARCADE_SPRING };
const NICHE: Opening = Opening { arch: Arch { half_span: 0.46, overshoot: 0.46, spring: 11.55 }, sill: 10.75 };
const DOOR: Arch = Arch { half_span: 1.3, overshoot: 1.0, spring: 3.0 };

/// Distance to the nearest surface, a lower bound; positive in air.
pub fn distance(p: Vec3) -> f32 {
    above_floor(p).distance.at_most(p.y)
}

/// Unit normal of the surface near `p`, into the air.
///
/// Differences over the corners of a tetrahedron, `reach` from `p`.
pub fn normal(p: Vec3, reach: f32) -> Vec3 {
    let corners = [Vec3::new(1.0, -1.0, -1.0), Vec3::new(-1.0, -1.0, 1.0), Vec3::new(-1.0, 1.0, -1.0), Vec3::ONE];
    let gradient: Vec3 = corners.into_iter().map(|corner| corner * distance(p + corner * reach)).sum();
    gradient.normalize_or(Vec3::Y)
}

/// Where a ray meets a surface.
#[derive(Debug, Clone, Copy)]
pub struct Hit {
    /// Distance along the ray.
    pub t: f32,
    /// What is there.
    pub part: Part,
}

/// Follows a ray from `start` to the first surface; `None` if it meets none before `end`.
///
/// The floor is met by its equation: stepping towards a plane at a flat angle would take ever smaller steps.
pub fn trace(origin: Vec3, direction: Vec3, start: f32, end: f32) -> Option<Hit> {
    let to_floor = if direction.y < 0.0 { -origin.y / direction.y } else { f32::INFINITY };
    let end_of_air = end.at_most(to_floor);
    let mut t = start;
    for _ in 0..160 {
        if t >= end_of_air {
            return (to_floor < end).then_some(Hit { t: to_floor, part: Part::Floor });
        }
        let near = above_floor(origin + direction * t);
        if near.distance < 4e-4 + 7e-4 * t {
            return Some(Hit { t, part: near.part });
        }
        t += near.distance;
    }
    // A ray that creeps along a wall this long is as good as on it.
    Some(Hit { t, part: above_floor(origin + direction * t).part })
}

/// How far all rays within `spread` (tangent of the half angle) of `direction` are free, but for the floor.
pub fn free_distance(origin: Vec3, direction: Vec3, spread: f32) -> f32 {
    let mut t = 0.0;
    for _ in 0..60 {
        // What is left of the ball beside the cone's own width is free for every ray of the cone.
        let margin = above_floor(origin + direction * t).distance - spread * t;
        if margin < 0.05 + 0.2 * spread * t {
            break;
        }
        t += margin / (1.0 + spread);
    }
    t
}

/// The largest integer not above `x`, which is within the range of `i32`.
///
/// Without the instructions of newer processors, `f32::floor` is a call.
#[inline(always)]
pub fn floor(x: f32) -> f32 {
    let whole = x as i32 as f32;
    if whole > x { whole - 1.0 } else { whole }
}

/// Distance of `x` from the nearest multiple of `period`.
#[inline(always)]
fn folded(x: f32, period: f32) -> f32 {
    x - period * floor(x * (1.0 / period) + 0.5)
}

/// The part of `x` after the point.
#[inline(always)]
fn fraction(x: f32) -> f32 {
    x - floor(x)
}

/// Folds x into its bay: distance from the bay's middle, 0 to 3.
#[inline(always)]
pub fn fold_bay(x: f32) -> f32 {
    folded(x, BAY).abs()
}

/// Outward distance and place along the face, for the face of the apse that `p` looks at.
///
/// The apse is half a decagon: faces at 0, 36 and 72 degrees to both sides of the axis.
#[inline(always)]
pub fn apse_face(p: Vec3) -> (f32, f32, i32) {
    let (ahead, aside) = (EAST - p.x, p.z.abs());
    let faces = [(1.0, 0.0), (0.809_017, 0.587_785_25), (0.309_017, 0.951_056_5)];
    let mut best = (f32::NEG_INFINITY, 0.0, 0);
    for (index, (cosine, sine)) in faces.into_iter().enumerate() {
        let out = ahead * cosine + aside * sine;
        if out > best.0 {
            best = (out, aside * cosine - ahead * sine, index as i32);
        }
    }
    best
}

fn above_floor(p: Vec3) -> Nearest {
    let mut near = Nearest { distance: f32::MAX, part: Part::Floor };
    if p.x < -20.0 {
        near.add(steps(p), Part::Floor);
    }
    if p.x < EAST {
        apse(p, &mut near)
    } else {
        nave(p, &mut near)
    }
    chancel_arch(p, &mut near);
    if p.x < -18.0 {
        altar(p, &mut near);
    }
    // Beyond the border stands what this side's formula does not know; a step may cross it only by a little.
    near.distance = near.distance.at_most((p.x - EAST).abs() + 0.4);
    near.distance *= 0.93;
    near
}

/// The steps up to the choir and to the altar.
fn steps(p: Vec3) -> f32 {
    let aisle = p.z.abs() - 5.0;
    let step = |at: f32, height: f32| (p.x - at).at_least(p.y - height).at_least(aisle);
    step(-22.0, 0.17).at_most(step(-22.45, 0.34)).at_most(step(-25.5, 0.51))
}

fn nave(p: Vec3, near: &mut Nearest) {
    let (along, out, y) = (fold_bay(p.x), p.z.abs(), p.y);
    near.add(VAULT_RIDGE + 0.6 - y, Part::Web);
    arcade(along, out, y, near);
    west_wall(p, near);
    aisle(p, along, out, y, near);
    if 11.8 - y < near.distance {
        nave_vault(along, out, y, near);
    }
    furniture(p, out, near);
    chandelier(p, near);
}

/// The wall between nave and aisle: piers, arches, gallery, clerestory.
#[inline(always)]
fn arcade(along: f32, out: f32, y: f32, near: &mut Nearest) {
    let depth = (out - PIER_DISTANCE).abs();
    if depth - 1.15 > near.distance {
        return;
    }
    let from_pier = HALF_BAY - along;
    let opening = ARCADE.distance(along, y);
    let outer_order = (depth - 0.55).at_least(0.3 - opening);
    let middle_order = (depth - 0.4).at_least(0.14 - opening);
    let inner_order = (depth - 0.22).at_least(-opening);
    let mut wall = outer_order.at_most(middle_order).at_most(inner_order).at_least(6.3 - y);
    if y > 9.8 {
        let inner_face = out - NAVE_HALF_WIDTH;
        let splay = (0.35 * (CLERESTORY_GLASS - out)).at_least(0.0).at_most(0.25);
        wall = wall.at_least(splay - CLERESTORY_WINDOW.distance(along, y));
        let column = fraction(along / 1.5) - 0.5;
        wall = wall.at_least(-(NICHE.distance(1.5 * column.abs(), y).at_least(out - 5.62)));
        near.add((CLERESTORY_GLASS - out).at_least(CLERESTORY_WINDOW.distance(along, y) - 0.1), Part::Glass);
        near.add(Vec2::new(y - 10.3, inner_face).length() - 0.13, Part::Rib);
        near.add(Vec2::new(y - 12.75, inner_face).length() - 0.1, Part::Rib);
    } else if y > 6.0 {
        near.add(Vec2::new(opening - 0.5, depth - 0.55).length().at_least((0.05 - from_pier).at_least(6.5 - y)) - 0.07, Part::Rib);
    }
    near.add(wall, Part::Wall);
    if y - 6.6 < near.distance {
        pier(from_pier, out - PIER_DISTANCE, y, near);
    }
    if 6.4 - y < near.distance {
        vault_shafts(from_pier, out, y, near);
    }
}

/// A clustered pier with base and capital.
#[inline(always)]
fn pier(along: f32, across: f32, y: f32, near: &mut Nearest) {
    let (a, b) = (along.abs().at_least(across.abs()), along.abs().at_most(across.abs()));
    if a - 1.15 > near.distance {
        return;
    }
    let core = Vec2::new(a, b).length() - 0.6;
    let shafts = Vec2::new(a - 0.66, b).length() - 0.19;
    let minor = Vec2::new(a - 0.5, b - 0.5).length() - 0.13;
    let base = 0.26 * (1.0 - ((y - 0.3) / 0.28).at_least(0.0).at_most(1.0)) + 0.1 * (1.0 - ((y - 0.62) / 0.06).abs()).at_least(0.0);
    let flare = ((y - 5.62) / 0.72).at_least(0.0).at_most(1.0);
    // Two rows of leaves: the capital's outline waves with height.
    let leaves = 0.05 * (1.0 - (2.0 * fraction(2.0 * flare) - 1.0).abs()) * f32::from(u8::from(flare > 0.0));
    let ring = 0.06 * (1.0 - ((y - 5.58) / 0.07).abs()).at_least(0.0);
    near.add(core.at_most(shafts).at_most(minor) - base - 0.28 * flare * flare - leaves - ring, Part::Rib);
    near.add((a.at_least(0.72 * (a + b)) - 1.02).at_least((y - 6.45).abs() - 0.11), Part::Rib);
}

/// Three shafts on the nave's face of the wall, from the pier up to the vault.
#[inline(always)]
fn vault_shafts(from_pier: f32, out: f32, y: f32, near: &mut Nearest) {
    let across = out - NAVE_HALF_WIDTH;
    if from_pier.at_least(across.abs()) - 0.65 > near.distance {
        return;
    }
    let middle = Vec2::new(from_pier, across + 0.05).length() - 0.22;
    let sides = Vec2::new(from_pier - 0.3, across).length() - 0.13;
    let flare = ((y - 11.5) / 0.5).at_least(0.0).at_most(1.0);
    let ring = 0.05 * (1.0 - ((y - 11.45) / 0.06).abs()).at_least(0.0);
    near.add((middle.at_most(sides) - 0.16 * flare * flare - ring).at_least(y - 12.15).at_least(6.4 - y), Part::Rib);
}

/// Quadripartite vault: two pointed barrels that cross, with ribs on the creases.
#[inline(always)]
fn nave_vault(along: f32, out: f32, y: f32, near: &mut Nearest) {
    let main = NAVE_VAULT.distance(out, y);
    let cross = NAVE_CROSS_VAULT.distance(along, y);
    near.add((-main.at_most(cross)).at_least(11.9 - y).at_least(out - 6.3), Part::Web);
    let above = 11.8 - y;
    let transverse = Vec2::new(HALF_BAY - along, main).length() - 0.3;
    let diagonal = Vec2::new(main, cross).length() * 0.85 - 0.15;
    let wall_rib = Vec2::new(cross, out - NAVE_HALF_WIDTH).length() - 0.13;
    let ridges = Vec2::new(along.at_most(out), y - VAULT_RIDGE).length() - 0.1;
    let boss = Vec3::new(along, y - VAULT_RIDGE + 0.1, out).length() - 0.42;
    near.add(transverse.at_most(diagonal).at_most(wall_rib).at_most(ridges).at_most(boss).at_least(above).at_least(out - 5.6), Part::Rib);
}

/// Side aisle: low vault, outer wall, windows; closed at the east end.
#[inline(always)]
fn aisle(p: Vec3, along: f32, out: f32, y: f32, near: &mut Nearest) {
    if 5.9 - out > near.distance {
        return;
    }
    let splay = (0.4 * (AISLE_GLASS - out)).at_least(0.0).at_most(0.3);
    let window = AISLE_WINDOW.distance(along, y);
    near.add((OUTER_HALF_WIDTH - out).at_least(splay - window), Part::Wall);
    near.add((AISLE_GLASS - out).at_least(window - 0.1), Part::Glass);
    near.add(Vec2::new(y - 2.0, out - OUTER_HALF_WIDTH).length() - 0.1, Part::Rib);
    near.add((p.x - EAST).at_least(6.3 - out), Part::Wall);

    let from_pier = HALF_BAY - along;
    if (OUTER_HALF_WIDTH - out).at_least(from_pier) - 0.5 < near.distance {
        let shaft = Vec2::new(from_pier, out - OUTER_HALF_WIDTH).length() - 0.3;
        let flare = ((y - 5.8) / 0.5).at_least(0.0).at_most(1.0);
        near.add((shaft - 0.15 * flare * flare).at_least(y - 6.45), Part::Rib);
    }
    if 6.35 - y < near.distance {
        let across = (out - CENTER_OF_AISLE).abs();
        let main = AISLE_VAULT.distance(across, y);
        let cross = AISLE_CROSS_VAULT.distance(along, y);
        let limits = (6.35 - y).at_least(6.2 - out);
        near.add((-main.at_most(cross)).at_least(limits), Part::Web);
        let transverse = Vec2::new(from_pier, main).length() - 0.26;
        let diagonal = Vec2::new(main, cross).length() * 0.85 - 0.12;
        near.add(transverse.at_most(diagonal).at_least(limits), Part::Rib);
    }
}

fn west_wall(p: Vec3, near: &mut Nearest) {
    let before = WEST - p.x;
    if before - 0.3 > near.distance {
        return;
    }
    let (height, radius) = ROSE;
    let from_rose = Vec2::new(p.z, p.y - height).length() - radius;
    let door = DOOR.distance(p.z.abs(), p.y);
    let wall = before.at_least(-(from_rose.at_most(door)) + 0.3 * (0.5 + before).at_least(0.0).at_most(0.5));
    near.add(wall, Part::Wall);
    near.add(before + 0.45, if from_rose < 0.2 { Part::Glass } else { Part::Wood });
    near.add(Vec2::new(from_rose - 0.35, before).length() - 0.14, Part::Rib);
    near.add(Vec2::new(door - 0.3, before).length() - 0.12, Part::Rib);
}

fn apse(p: Vec3, near: &mut Nearest) {
    let (out, place, _) = apse_face(p);
    let (across, y) = (place.abs(), p.y);
    let window = APSE_WINDOW.distance(across, y);
    let splay = (0.4 * (APSE_GLASS - out)).at_least(0.0).at_most(0.18);
    near.add((NAVE_HALF_WIDTH - out).at_least(splay - window), Part::Wall);
    near.add((APSE_GLASS - out).at_least(window - 0.1), Part::Glass);
    let vault = NAVE_VAULT.distance(out.at_least(0.0), y);
    near.add((-vault).at_least(11.9 - y), Part::Web);
    let rib = Vec2::new((out / NAVE_HALF_WIDTH * APSE_HALF_FACE - across) * 0.95, vault).length() - 0.17;
    near.add(rib, Part::Rib);
    near.add(Vec2::new(y - 3.2, out - NAVE_HALF_WIDTH).length() - 0.11, Part::Rib);
    near.add(Vec2::new(y - 12.1, out - NAVE_HALF_WIDTH).length().at_least(-0.15 - window) - 0.1, Part::Rib);
}

fn chancel_arch(p: Vec3, near: &mut Nearest) {
    let before = (p.x - EAST).abs();
    if before - 0.7 > near.distance {
        return;
    }
    let vault = NAVE_VAULT.distance(p.z.abs(), p.y);
    let beam = Vec2::new(before - 0.3, vault + 0.08).length() - 0.33;
    near.add(beam.at_most(before.at_least(-vault - 0.36) - 0.2), Part::Rib);
}

/// Pews to both sides of the middle way.
fn furniture(p: Vec3, out: f32, near: &mut Nearest) {
    let region = ((p.x + 12.0).abs() - 8.2).at_most((p.x - 7.2).abs() - 3.6);
    let beside = (out - 2.85).abs() - 1.6;
    let bound = region.at_least(beside).at_least(p.y - 1.05);
    if bound > near.distance {
        return;
    }
    let pitch = 1.1;
    let x = folded(p.x, pitch);
    let across = (out - 2.85).abs();
    let back = (x.abs() - 0.03).at_least((p.y - 0.62).abs() - 0.3);
    let seat = ((x + 0.2).abs() - 0.2).at_least((p.y - 0.44).abs() - 0.025);
    let ends =
        ((x + 0.16).abs() - 0.26).at_least((across - 1.52).abs() - 0.035).at_least((p.y - 0.5).abs() - 0.52 + 0.6 * (x + 0.16).abs());
    near.add(back.at_most(seat).at_least(across - 1.52).at_most(ends).at_least(region), Part::Wood);
}

/// Iron rings over the axis, on chains.
fn chandelier(p: Vec3, near: &mut Nearest) {
    if p.x < EAST + 2.0 || p.x > 13.0 || p.z.abs() > 4.5 {
        return;
    }
    let spacing = 2.0 * CHANDELIER_HALF_SPACING;
    let x = folded(p.x - CHANDELIER_HALF_SPACING, spacing);
    let radius = Vec2::new(x, p.z).length();
    let y = p.y - CHANDELIER_HEIGHT;
    let bound = (radius - 1.4).at_least(-0.5 - y);
    if bound > near.distance {
        return;
    }
    let ring = (radius - CHANDELIER_RADIUS).abs().at_least((y + 0.02).abs() - 0.075) - 0.02;
    let upper = Vec2::new(radius - 0.55, y - 0.55).length() - 0.04;
    let chain = (radius - 0.022 - 0.012 * (1.0 - (2.0 * fraction(y * 4.0) - 1.0).abs())).at_least(0.9 - y);
    // Four stays from the lower ring to the chain.
    let (a, b) = (x.abs().at_least(p.z.abs()), x.abs().at_most(p.z.abs()));
    let lean = (a - CHANDELIER_RADIUS * (1.0 - y / 2.2).at_least(0.0)) * 0.886;
    let stays = Vec2::new(lean, b).length().at_least(y - 2.2).at_least(-y) - 0.018;
    near.add(ring.at_most(upper).at_most(chain).at_most(stays), Part::Iron);
}

fn altar(p: Vec3, near: &mut Nearest) {
    let q = Vec3::new(p.x + 29.3, p.y - 0.51, p.z);
    let bound = boxed(q - Vec3::new(-0.3, 2.6, 0.0), Vec3::new(1.0, 2.6, 2.0));
    if bound > near.distance {
        return;
    }
    let table = boxed(q - Vec3::new(0.0, 0.5, 0.0), Vec3::new(0.45, 0.5, 1.5));
    let top = boxed(q - Vec3::new(0.0, 1.04, 0.0), Vec3::new(0.6, 0.06, 1.7));
    near.add(table.at_most(top), Part::Marble);
    let shrine = boxed(q - Vec3::new(-0.9, 1.3, 0.0), Vec3::new(0.15, 1.3, 1.9));
    let gable = (shrine - 0.02).at_most(boxed(q - Vec3::new(-0.9, 2.8, 0.0), Vec3::new(0.12, 0.4, 0.8)));
    let upright = boxed(q - Vec3::new(-0.8, 4.1, 0.0), Vec3::new(0.06, 1.0, 0.09));
    let bar = boxed(q - Vec3::new(-0.8, 4.5, 0.0), Vec3::new(0.06, 0.09, 0.55));
    near.add(gable.at_most(upright).at_most(bar), Part::Gold);
}

fn boxed(p: Vec3, half: Vec3) -> f32 {
    let q = p.abs() - half;
    q.max(Vec3::ZERO).length() + q.max_element().at_most(0.0)
}

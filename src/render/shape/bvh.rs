//! A tree of boxes, four to a node: building it by the surface area heuristic, and following a ray through it.
//!
//! A leaf is a run of at most four items, whose intersection is the caller's: so one tree serves triangles and whole
//! shapes. Its form depends on the boxes alone, not on threads. No branch is deeper than `DEEPEST`, whatever the boxes
//! (fifty thousand at one place are split by count), so the stack of a ray has a fixed size.
//!
//! Wald, "On fast construction of SAH-based bounding volume hierarchies" (2007); boxes are tested conservatively after
//! Ize, "Robust BVH ray traversal", JCGT 2(2) (2013).

use std::ops::Range;

use glam::{Vec3, Vec3A};
use rayon::prelude::*;
use wide::{f32x4, i32x4};

/// Boxes tested at once, and items in a leaf.
pub const WIDTH: usize = 4;
/// Nodes on the way from the root to any leaf.
const DEEPEST: usize = 20;
/// A node leaves at most three others for later.
const STACK: usize = 3 * DEEPEST + 1;
/// Children of a node: an index of a node, or with this bit of a leaf.
const LEAF: u32 = 1 << 31;
/// A child that does not exist; its box is empty, so no ray goes there.
const NOTHING: u32 = u32::MAX;

/// An axis-aligned box.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bounds {
    /// Least coordinates.
    pub min: Vec3,
    /// Greatest coordinates.
    pub max: Vec3,
}

impl Bounds {
    /// The box that contains nothing.
    pub const EMPTY: Self = Self { min: Vec3::INFINITY, max: Vec3::NEG_INFINITY };

    /// The smallest box around these points.
    pub fn around(points: impl IntoIterator<Item = Vec3>) -> Self {
        points.into_iter().fold(Self::EMPTY, |all, point| Self { min: all.min.min(point), max: all.max.max(point) })
    }

    /// The smallest box around both.
    #[must_use]
    pub fn union(self, other: Self) -> Self {
        Self { min: self.min.min(other.min), max: self.max.max(other.max) }
    }
}

/// Four boxes side by side: per axis the four least and the four greatest coordinates.
#[derive(Debug, Clone, Copy)]
#[repr(align(64))]
struct Node {
    planes: [f32x4; 6],
    children: [u32; WIDTH],
}

/// The tree.
#[derive(Debug, Clone, Default)]
pub struct Bvh {
    nodes: Vec<Node>,
}

/// The tree over some boxes, and the order of the items: a leaf is a range of it.
pub struct Built {
    /// The tree; its leaves are numbered as in `leaves`.
    pub bvh: Bvh,
    /// Items in the order of the leaves.
    pub order: Vec<u32>,
    /// Where each leaf begins in `order` and ends.
    pub leaves: Vec<Range<u32>>,
    /// The box around everything.
    pub bounds: Bounds,
}

/// Builds the tree over `count` boxes; `check` is asked now and then whether to stop.
pub fn build<E: Send>(count: usize, bounds: impl Fn(usize) -> Bounds + Sync, check: impl Fn() -> Result<(), E> + Sync) -> Result<Built, E> {
    assert!(count < LEAF as usize, "items are counted by 31 bits");
    let mut references = Vec::new();
    let reference = |item: u32| {
        let Bounds { min, max } = bounds(item as usize);
        Reference { min, item, max }
    };
    (0..count as u32).into_par_iter().map(reference).collect_into_vec(&mut references);
    let whole = bounds_of(&references);
    let part = if count > 0 { grow(&mut references, 0, whole, DEEPEST, &check)? } else { Part::default() };
    let order = references.iter().map(|reference| reference.item).collect();
    let bounds = Bounds { min: whole.min.into(), max: whole.max.into() };
    Ok(Built { bvh: Bvh { nodes: part.nodes }, order, leaves: part.leaves, bounds })
}

/// An item while the tree is built.
#[derive(Clone, Copy)]
struct Reference {
    min: Vec3,
    item: u32,
    max: Vec3,
}

impl Reference {
    fn bounds(&self) -> Extent {
        Extent { min: self.min.into(), max: self.max.into() }
    }

    /// Twice the center: as good to sort by.
    fn center(&self) -> Vec3A {
        Vec3A::from(self.min) + Vec3A::from(self.max)
    }
}

/// A box in registers.
#[derive(Clone, Copy)]
struct Extent {
    min: Vec3A,
    max: Vec3A,
}

impl Extent {
    const EMPTY: Self = Self { min: Vec3A::INFINITY, max: Vec3A::NEG_INFINITY };

    fn union(self, other: Self) -> Self {
        Self { min: self.min.min(other.min), max: self.max.max(other.max) }
    }

    fn with(self, point: Vec3A) -> Self {
        Self { min: self.min.min(point), max: self.max.max(point) }
    }

    /// Half the area of the surface; 0 of the empty box.
    fn half_area(self) -> f32 {
        let size = (self.max - self.min).max(Vec3A::ZERO);
        size.x * size.y + size.y * size.z + size.z * size.x
    }
}

/// From this many items on, passes over them are split among threads. Sums of boxes and counts are exact in any order.
const MANY: usize = 1 << 16;
/// Items that one thread takes at a time.
const CHUNK: usize = 1 << 14;
/// Below this many items a subtree is one thread's.
const TASK: usize = 1 << 14;

fn bounds_of(references: &[Reference]) -> Extent {
    let serial = |references: &[Reference]| references.iter().fold(Extent::EMPTY, |all, reference| all.union(reference.bounds()));
    if references.len() < MANY {
        serial(references)
    } else {
        references.par_chunks(CHUNK).map(serial).reduce(|| Extent::EMPTY, Extent::union)
    }
}

fn centers_of(references: &[Reference]) -> Extent {
    let serial = |references: &[Reference]| references.iter().fold(Extent::EMPTY, |all, reference| all.with(reference.center()));
    if references.len() < MANY {
        serial(references)
    } else {
        references.par_chunks(CHUNK).map(serial).reduce(|| Extent::EMPTY, Extent::union)
    }
}

/// A subtree: its root is node 0, children count from it.
#[derive(Default)]
struct Part {
    nodes: Vec<Node>,
    leaves: Vec<Range<u32>>,
}

impl Part {
    /// Puts another subtree behind; gives its root's index.
    fn append(&mut self, other: Part) -> u32 {
        let (node_base, leaf_base) = (self.nodes.len() as u32, self.leaves.len() as u32);
        self.leaves.extend(other.leaves);
        self.nodes.extend(other.nodes.into_iter().map(|mut node| {
            for child in node.children.iter_mut().filter(|child| **child != NOTHING) {
                *child += if *child & LEAF != 0 { leaf_base } else { node_base };
            }
            node
        }));
        node_base
    }
}

/// One of the up to four parts of a node: how many references, and the box around them.
#[derive(Clone, Copy)]
struct Set {
    start: usize,
    end: usize,
    extent: Extent,
}

impl Set {
    fn len(&self) -> usize {
        self.end - self.start
    }
}

fn grow<E: Send>(
    references: &mut [Reference],
    start: u32,
    extent: Extent,
    levels: usize,
    check: &(impl Fn() -> Result<(), E> + Sync),
) -> Result<Part, E> {
    check()?;
    if references.len() < TASK {
        let mut part = Part::default();
        grow_here(references, start, extent, levels, &mut part);
        return Ok(part);
    }
    let (sets, count) = divided(references, extent, levels);
    let mut rest = references;
    let mut jobs = Vec::with_capacity(WIDTH);
    for set in &sets[..count] {
        let (own, others) = rest.split_at_mut(set.len());
        jobs.push((own, *set));
        rest = others;
    }
    let parts: Vec<Result<Part, E>> =
        jobs.into_par_iter().map(|(own, set)| grow(own, start + set.start as u32, set.extent, levels - 1, check)).collect();
    let mut whole = Part { nodes: vec![Node::EMPTY], leaves: Vec::new() };
    for (slot, part) in parts.into_iter().enumerate() {
        let child = whole.append(part?);
        whole.nodes[0].set(slot, sets[slot].extent, child);
    }
    Ok(whole)
}

fn grow_here(references: &mut [Reference], start: u32, extent: Extent, levels: usize, part: &mut Part) -> u32 {
    let index = part.nodes.len();
    part.nodes.push(Node::EMPTY);
    let (sets, count) = divided(references, extent, levels);
    for (slot, set) in sets[..count].iter().enumerate() {
        let first = start + set.start as u32;
        let child = if set.len() <= WIDTH {
            part.leaves.push(first..start + set.end as u32);
            LEAF | (part.leaves.len() - 1) as u32
        } else {
            grow_here(&mut references[set.start..set.end], first, set.extent, levels - 1, part)
        };
        part.nodes[index].set(slot, set.extent, child);
    }
    index as u32
}

/// Cuts the references into up to four sets, each time the one with the largest box.
fn divided(references: &mut [Reference], extent: Extent, levels: usize) -> ([Set; WIDTH], usize) {
    let mut sets = [Set { start: 0, end: references.len(), extent }; WIDTH];
    // A subtree of k levels holds 4^(k + 1) items, if it is balanced; near that limit only counts decide.
    let may_be_uneven = levels > 16 || references.len() <= 1 << (2 * levels);
    let mut count = 1;
    while count < WIDTH {
        let splittable = (0..count).filter(|&k| sets[k].len() > WIDTH);
        let chosen = if may_be_uneven {
            // Of boxes as large the one with more in it, so that coincident items make a balanced tree.
            splittable.max_by(|&a, &b| {
                let areas = sets[a].extent.half_area().total_cmp(&sets[b].extent.half_area());
                areas.then(sets[a].len().cmp(&sets[b].len()))
            })
        } else {
            splittable.max_by_key(|&k| sets[k].len())
        };
        let Some(chosen) = chosen else { break };
        let set = sets[chosen];
        let own = &mut references[set.start..set.end];
        let Split { middle, left, right } = if may_be_uneven { split_by_area(own) } else { split_by_count(own) };
        // Sets stay in the order of the references.
        sets.copy_within(chosen + 1..count, chosen + 2);
        sets[chosen] = Set { start: set.start, end: set.start + middle, extent: left };
        sets[chosen + 1] = Set { start: set.start + middle, end: set.end, extent: right };
        count += 1;
    }
    (sets, count)
}

/// Where references were cut, and the boxes around both sides.
struct Split {
    middle: usize,
    left: Extent,
    right: Extent,
}

/// Halves along the longest axis of the centers.
fn split_by_count(references: &mut [Reference]) -> Split {
    let centers = centers_of(references);
    let axis = (centers.max - centers.min).max_position();
    let middle = references.len() / 2;
    references.select_nth_unstable_by(middle, |a, b| a.center()[axis].total_cmp(&b.center()[axis]).then(a.item.cmp(&b.item)));
    Split { middle, left: bounds_of(&references[..middle]), right: bounds_of(&references[middle..]) }
}

/// Boxes and counts of the items whose centers fall into each of `N` bins of each axis.
#[derive(Clone)]
struct Bins<const N: usize> {
    extents: [[Extent; N]; 3],
    counts: [[u32; N]; 3],
}

/// How centers become bins: subtract, multiply, round down.
#[derive(Clone, Copy)]
struct Binning {
    least: Vec3A,
    scale: Vec3A,
    last: i32,
}

impl Binning {
    #[inline(always)]
    fn bins(&self, center: Vec3A) -> [usize; 3] {
        let [x, y, z] = ((center - self.least) * self.scale).to_array();
        // The greatest center falls on the end of the last bin; what is NaN becomes a negative number, and that 0.
        let bins = f32x4::new([x, y, z, 0.0]).fast_trunc_int();
        let [x, y, z, _] = bins.max(i32x4::ZERO).min(i32x4::splat(self.last)).to_array();
        [x as usize, y as usize, z as usize]
    }

    #[inline(always)]
    fn bin(&self, center: Vec3A, axis: usize) -> usize {
        self.bins(center)[axis]
    }
}

/// The best cut that bins show: its axis, and the boxes around both sides.
struct Cut {
    cost: f32,
    axis: usize,
    first_right: usize,
    left: Extent,
    right: Extent,
}

impl<const N: usize> Bins<N> {
    const EMPTY: Self = Self { extents: [[Extent::EMPTY; N]; 3], counts: [[0; N]; 3] };

    fn of(references: &[Reference], binning: &Binning) -> Self {
        let mut all = Self::EMPTY;
        for reference in references {
            let extent = reference.bounds();
            let [x, y, z] = binning.bins(reference.center());
            for (axis, bin) in [x, y, z].into_iter().enumerate() {
                let bin = bin.min(N - 1);
                all.extents[axis][bin] = all.extents[axis][bin].union(extent);
                all.counts[axis][bin] += 1;
            }
        }
        all
    }

    fn union(mut self, other: Self) -> Self {
        for axis in 0..3 {
            for bin in 0..N {
                self.extents[axis][bin] = self.extents[axis][bin].union(other.extents[axis][bin]);
                self.counts[axis][bin] += other.counts[axis][bin];
            }
        }
        self
    }

    fn best(&self) -> Cut {
        let mut best = Cut { cost: f32::INFINITY, axis: 0, first_right: 0, left: Extent::EMPTY, right: Extent::EMPTY };
        for axis in 0..3 {
            let mut rights = [(Extent::EMPTY, 0.0); N];
            let (mut extent, mut items) = (Extent::EMPTY, 0);
            for bin in (1..N).rev() {
                extent = extent.union(self.extents[axis][bin]);
                items += self.counts[axis][bin];
                rights[bin] = (extent, extent.half_area() * leaf_count(items));
            }
            let total = items + self.counts[axis][0];
            let (mut left, mut items) = (Extent::EMPTY, 0);
            for (bin, (right, right_cost)) in rights.into_iter().enumerate().skip(1) {
                left = left.union(self.extents[axis][bin - 1]);
                items += self.counts[axis][bin - 1];
                let cost = left.half_area() * leaf_count(items) + right_cost;
                if items > 0 && items < total && cost < best.cost {
                    best = Cut { cost, axis, first_right: bin, left, right };
                }
            }
        }
        best
    }
}

fn leaf_count(items: u32) -> f32 {
    items.div_ceil(WIDTH as u32) as f32
}

/// Parts the references where the surface area heuristic is least among equally spaced cuts of all axes.
fn split_by_area(references: &mut [Reference]) -> Split {
    match references.len() {
        0..24 => split_at_bins::<6>(references),
        24..256 => split_at_bins::<12>(references),
        _ => split_at_bins::<16>(references),
    }
}

fn split_at_bins<const N: usize>(references: &mut [Reference]) -> Split {
    let centers = centers_of(references);
    // Axes on which all centers agree have an infinite scale; their centers land in bin 0 by the NaN rule.
    let scale = Vec3A::splat(N as f32) / (centers.max - centers.min);
    let binning = Binning { least: centers.min, scale, last: N as i32 - 1 };
    let bins = if references.len() < MANY {
        Bins::<N>::of(references, &binning)
    } else {
        references.par_chunks(CHUNK).map(|chunk| Bins::<N>::of(chunk, &binning)).reduce(|| Bins::EMPTY, Bins::union)
    };
    let Cut { cost, axis, first_right, left, right } = bins.best();
    if !cost.is_finite() {
        return split_by_count(references);
    }
    let middle = partition(references, |reference| binning.bin(reference.center(), axis) < first_right);
    Split { middle, left, right }
}

/// Puts the items that belong to the left first; gives their number.
fn partition(references: &mut [Reference], is_left: impl Fn(&Reference) -> bool) -> usize {
    let (mut left, mut right) = (0, references.len());
    loop {
        while left < right && is_left(&references[left]) {
            left += 1;
        }
        while left < right && !is_left(&references[right - 1]) {
            right -= 1;
        }
        if left >= right {
            return left;
        }
        references.swap(left, right - 1);
    }
}

impl Node {
    const EMPTY: Self = {
        let (least, greatest) = (f32x4::new([f32::INFINITY; 4]), f32x4::new([f32::NEG_INFINITY; 4]));
        Self { planes: [least, greatest, least, greatest, least, greatest], children: [NOTHING; WIDTH] }
    };

    fn set(&mut self, slot: usize, extent: Extent, child: u32) {
        for axis in 0..3 {
            self.planes[2 * axis].as_mut_array()[slot] = extent.min[axis];
            self.planes[2 * axis + 1].as_mut_array()[slot] = extent.max[axis];
        }
        self.children[slot] = child;
    }
}

/// What a ray needs to be tested against boxes.
struct Slabs {
    origin: [f32x4; 3],
    inverse: [f32x4; 3],
    /// Which of the two planes of an axis it enters by.
    near: [usize; 3],
}

impl Slabs {
    fn new(origin: Vec3, direction: Vec3) -> Self {
        // No component is zero, so that no product of zero and infinity arises; a box is missed by nothing for it.
        let direction = direction.to_array().map(|d| if d.abs() < 1e-18 { 1e-18_f32.copysign(d) } else { d });
        Self {
            origin: origin.to_array().map(f32x4::splat),
            inverse: direction.map(|d| f32x4::splat(1.0 / d)),
            near: direction.map(|d| usize::from(d < 0.0)),
        }
    }

    /// Which boxes are met before `reach`, as bits, and at what distances.
    #[inline(always)]
    fn meet(&self, node: &Node, reach: f32) -> (u32, f32x4) {
        /// Two roundings of the differences and products, twice, over one.
        const ROUNDING: f32 = 1.0 + 6.0 * f32::EPSILON;
        let at = |axis: usize, side: usize| (node.planes[2 * axis + (side & 1)] - self.origin[axis]) * self.inverse[axis];
        let near = at(0, self.near[0]).fast_max(at(1, self.near[1])).fast_max(at(2, self.near[2]).fast_max(f32x4::ZERO));
        let far = at(0, 1 - self.near[0]).fast_min(at(1, 1 - self.near[1])).fast_min(at(2, 1 - self.near[2]));
        let far = (far * f32x4::splat(ROUNDING)).fast_min(f32x4::splat(reach));
        (near.simd_le(far).to_bitmask(), near)
    }
}

impl Bvh {
    /// Bytes it holds.
    pub fn memory(&self) -> u64 {
        size_of_val(&*self.nodes) as u64
    }

    /// Follows a ray from leaf to leaf, nearer boxes first. `leaf` is given a leaf and how far the ray still counts,
    /// and says how far it counts from then on; gives what it said last.
    pub fn nearest(&self, origin: Vec3, direction: Vec3, mut reach: f32, mut leaf: impl FnMut(u32, f32) -> f32) -> f32 {
        if self.nodes.is_empty() {
            return reach;
        }
        let slabs = Slabs::new(origin, direction);
        let mut stack = [(0_u32, 0.0_f32); STACK];
        let mut height = 0;
        let mut current = 0;
        loop {
            if current & LEAF != 0 {
                reach = leaf(current & !LEAF, reach);
            } else {
                let node = &self.nodes[current as usize];
                let (mut mask, near) = slabs.meet(node, reach);
                if mask != 0 {
                    let near = near.to_array();
                    let first = mask.trailing_zeros() as usize & 3;
                    mask &= mask - 1;
                    if mask == 0 {
                        current = node.children[first];
                        continue;
                    }
                    let base = height;
                    let mut entry = (node.children[first], near[first]);
                    while mask != 0 {
                        let next = mask.trailing_zeros() as usize & 3;
                        mask &= mask - 1;
                        let mut other = (node.children[next], near[next]);
                        if other.1 < entry.1 {
                            std::mem::swap(&mut other, &mut entry);
                        }
                        // The farther one goes below what is nearer than it.
                        let mut place = height;
                        while place > base && stack[place - 1].1 < other.1 {
                            stack[place] = stack[place - 1];
                            place -= 1;
                        }
                        stack[place] = other;
                        height += 1;
                    }
                    current = entry.0;
                    continue;
                }
            }
            current = loop {
                if height == 0 {
                    return reach;
                }
                height -= 1;
                if stack[height].1 < reach {
                    break stack[height].0;
                }
            };
        }
    }

    /// Whether `leaf` says yes to any leaf that the ray may meet.
    pub fn any(&self, origin: Vec3, direction: Vec3, reach: f32, mut leaf: impl FnMut(u32) -> bool) -> bool {
        if self.nodes.is_empty() {
            return false;
        }
        let slabs = Slabs::new(origin, direction);
        let mut stack = [0_u32; STACK];
        let mut height = 1;
        while height > 0 {
            height -= 1;
            let current = stack[height];
            if current & LEAF != 0 {
                if leaf(current & !LEAF) {
                    return true;
                }
                continue;
            }
            let node = &self.nodes[current as usize];
            let (mut mask, _) = slabs.meet(node, reach);
            while mask != 0 {
                stack[height] = node.children[mask.trailing_zeros() as usize & 3];
                height += 1;
                mask &= mask - 1;
            }
        }
        false
    }
}

#[cfg(test)]
mod tests {
    use std::convert::Infallible;

    use proptest::prelude::*;

    use super::*;

    fn built(boxes: &[Bounds]) -> Built {
        build(boxes.len(), |item| boxes[item], || Ok::<(), Infallible>(())).unwrap()
    }

    fn cube(center: Vec3, half: f32) -> Bounds {
        Bounds { min: center - half, max: center + half }
    }

    /// Depth of the tree; checks that boxes hold what is below and that every leaf is there once.
    fn depth(built: &Built, boxes: &[Bounds]) -> usize {
        fn below(built: &Built, boxes: &[Bounds], node: u32, seen: &mut [bool]) -> (Bounds, usize) {
            let node = &built.bvh.nodes[node as usize];
            let (mut whole, mut deepest) = (Bounds::EMPTY, 0);
            for slot in (0..WIDTH).filter(|&slot| node.children[slot] != NOTHING) {
                let at = |plane: usize| node.planes[plane].to_array()[slot];
                let own = Bounds { min: Vec3::new(at(0), at(2), at(4)), max: Vec3::new(at(1), at(3), at(5)) };
                let child = node.children[slot];
                let (inside, depth) = if child & LEAF != 0 {
                    let leaf = (child & !LEAF) as usize;
                    assert!(!std::mem::replace(&mut seen[leaf], true), "leaf {leaf} twice");
                    let range = built.leaves[leaf].clone();
                    assert!((1..=WIDTH as u32).contains(&(range.end - range.start)));
                    let items = &built.order[range.start as usize..range.end as usize];
                    (items.iter().fold(Bounds::EMPTY, |all, &item| all.union(boxes[item as usize])), 0)
                } else {
                    below(built, boxes, child, seen)
                };
                assert_eq!(own, inside);
                whole = whole.union(own);
                deepest = deepest.max(depth + 1);
            }
            (whole, deepest)
        }
        let mut seen = vec![false; built.leaves.len()];
        let (_, depth) = below(built, boxes, 0, &mut seen);
        assert!(seen.iter().all(|&seen| seen));
        let mut items = built.order.clone();
        items.sort_unstable();
        assert!(items.into_iter().eq(0..boxes.len() as u32), "every item stands in the order once");
        depth
    }

    fn random_boxes(count: usize, seed: u64) -> Vec<Bounds> {
        use crate::math::stream::{Purpose, Stream};
        let stream = Stream::new(seed, Purpose::Test);
        let of = |index: usize| {
            let mut numbers = stream.generator(index as u64);
            let mut next = || numbers.uniform() as f32;
            cube(Vec3::new(next(), next(), next()) * 10.0, next() * 0.1)
        };
        (0..count).map(of).collect()
    }

    #[test]
    fn every_item_is_in_one_leaf_and_boxes_hold_what_is_below() {
        for count in [1, 2, 4, 5, 17, 1000, 40_000] {
            let boxes = random_boxes(count, 1);
            assert!(depth(&built(&boxes), &boxes) <= DEEPEST);
        }
        assert!(built(&[]).bvh.nodes.is_empty());
    }

    #[test]
    fn fifty_thousand_boxes_at_one_place_make_a_shallow_tree() {
        let boxes = vec![cube(Vec3::ONE, 0.5); 50_000];
        assert!(depth(&built(&boxes), &boxes) <= 9);
    }

    #[test]
    fn boxes_that_grow_without_end_stay_within_the_depth() {
        // Each next one is twice as far: the heuristic would cut them off one by one.
        let place = |k: i32| (0..k % 100).fold(1.0_f32, |place, _| place * 1.5);
        let boxes: Vec<Bounds> = (0..20_000).map(|k| cube(Vec3::X * place(k), 1e-3)).collect();
        assert!(depth(&built(&boxes), &boxes) <= DEEPEST);
    }

    #[test]
    fn the_tree_does_not_depend_on_threads() {
        let boxes = random_boxes(100_000, 2);
        let of = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let built = pool.install(|| built(&boxes));
            (built.order, built.leaves, built.bvh.nodes.iter().map(|node| node.children).collect::<Vec<_>>())
        };
        assert!(of(1) == of(3));
    }

    #[test]
    fn a_build_stops_when_it_is_told_to() {
        let boxes = random_boxes(1000, 3);
        assert_eq!(build(boxes.len(), |item| boxes[item], || Err("stop")).err(), Some("stop"));
    }

    /// Entry and exit in double precision.
    fn meets(bounds: &Bounds, origin: Vec3, direction: Vec3) -> Option<f64> {
        let (mut near, mut far) = (0.0_f64, f64::INFINITY);
        for axis in 0..3 {
            let (o, d) = (f64::from(origin[axis]), f64::from(direction[axis]));
            let (a, b) = ((f64::from(bounds.min[axis]) - o) / d, (f64::from(bounds.max[axis]) - o) / d);
            (near, far) = (near.max(a.min(b)), far.min(a.max(b)));
        }
        (near <= far).then_some(near)
    }

    proptest! {
        #[test]
        fn a_ray_comes_to_every_box_that_it_meets(seed in 0_u64..1000, target in prop::array::uniform3(0.0_f32..10.0), axis in 0_usize..4) {
            let boxes = random_boxes(200, seed);
            let built = built(&boxes);
            let origin = Vec3::new(-3.0, 5.0, 4.0);
            let direction = [(Vec3::from(target) - origin).normalize(), Vec3::X, Vec3::new(1.0, 0.0, -0.0), -Vec3::Z][axis];
            let mut reached = Vec::new();
            built.bvh.nearest(origin, direction, f32::INFINITY, |leaf, reach| {
                let range = built.leaves[leaf as usize].clone();
                reached.extend(&built.order[range.start as usize..range.end as usize]);
                reach
            });
            let mut all = 0;
            built.bvh.any(origin, direction, f32::INFINITY, |leaf| {
                all += built.leaves[leaf as usize].len();
                false
            });
            prop_assert_eq!(all, reached.len());
            for (item, bounds) in boxes.iter().enumerate() {
                if direction.to_array().iter().all(|d| *d != 0.0) && meets(bounds, origin, direction).is_some() {
                    prop_assert!(reached.contains(&(item as u32)), "box {}", item);
                }
            }
        }
    }
}

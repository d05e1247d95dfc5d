//! Triangles under a tree, four to a leaf, tested at once.
//!
//! Woop, Benthin, Wald, "Watertight ray/triangle intersection", JCGT 2(1) (2013): the two triangles at an edge decide by
//! the same rounded numbers on which side a ray passes, and both count the edge itself, so no ray slips between them.

use std::sync::Arc;

use glam::{DAffine3, Vec3};
use rayon::prelude::*;
use wide::f32x4;

use crate::render::mesh::Mesh;
use crate::render::shape::bvh::{self, Bounds, Bvh, WIDTH};

/// Up to four triangles: corner by corner, axis by axis, side by side.
#[derive(Debug, Clone)]
struct Pack {
    corners: [[f32x4; 3]; 3],
    triangles: [u32; WIDTH],
}

/// A mesh, ready to be hit: in its own coordinates, or in those of the world.
#[derive(Debug, Clone)]
pub struct Triangles {
    mesh: Arc<Mesh>,
    bvh: Bvh,
    packs: Vec<Pack>,
    bounds: Bounds,
}

/// Where a ray meets a triangle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TriangleHit {
    /// The ray's parameter.
    pub distance: f32,
    /// Four times the pack plus the lane; see [`Triangles::triangle`].
    pub place: u32,
    /// Weights of the second and third corner.
    pub barycentric: [f32; 2],
}

/// What a ray needs to be tested against triangles: it is sheared onto its longest axis.
struct Shear {
    axes: [usize; 3],
    origin: [f32x4; 3],
    shear: [f32x4; 3],
}

impl Shear {
    fn new(origin: Vec3, direction: Vec3) -> Self {
        let z = direction.abs().max_position();
        let (x, y) = ((z + 1) % 3, (z + 2) % 3);
        let shear = [direction[x] / direction[z], direction[y] / direction[z], 1.0 / direction[z]];
        Self { axes: [x, y, z], origin: [x, y, z].map(|axis| f32x4::splat(origin[axis])), shear: shear.map(f32x4::splat) }
    }

    /// A corner relative to the ray's origin, sheared across the ray; its height along the axis is left as it is.
    #[inline(always)]
    fn apply(&self, corner: &[f32x4; 3]) -> [f32x4; 3] {
        let z = corner[self.axes[2]] - self.origin[2];
        let x = (corner[self.axes[0]] - self.origin[0]) - self.shear[0] * z;
        let y = (corner[self.axes[1]] - self.origin[1]) - self.shear[1] * z;
        [x, y, z]
    }

    /// The lanes that are hit at a parameter in (0, reach), and their parameters, weights and the sum of the weights.
    #[inline(always)]
    fn meet(&self, pack: &Pack, reach: f32) -> Option<Met> {
        let [a, b, c] = [self.apply(&pack.corners[0]), self.apply(&pack.corners[1]), self.apply(&pack.corners[2])];
        let u = c[0] * b[1] - c[1] * b[0];
        let v = a[0] * c[1] - a[1] * c[0];
        let w = b[0] * a[1] - b[1] * a[0];
        let (least, greatest) = (u.fast_min(v).fast_min(w), u.fast_max(v).fast_max(w));
        let is_inside = least.simd_ge(f32x4::ZERO) | greatest.simd_le(f32x4::ZERO);
        if !is_inside.any() {
            return None;
        }
        let determinant = u + v + w;
        let distance = (u * a[2] + v * b[2] + w * c[2]) * self.shear[2] / determinant;
        let is_met = is_inside & determinant.simd_ne(f32x4::ZERO) & distance.simd_gt(f32x4::ZERO) & distance.simd_lt(f32x4::splat(reach));
        let mask = is_met.to_bitmask();
        (mask != 0).then_some(Met { mask, distance, v, w, determinant })
    }
}

struct Met {
    mask: u32,
    distance: f32x4,
    v: f32x4,
    w: f32x4,
    determinant: f32x4,
}

impl Triangles {
    /// Makes the tree over a mesh; `place` moves it first, and `None` leaves it where it is.
    pub fn build<E: Send>(mesh: Arc<Mesh>, place: Option<&DAffine3>, check: impl Fn() -> Result<(), E> + Sync) -> Result<Self, E> {
        let positions = mesh.positions();
        let placed = |corner: u32| match place {
            Some(place) => place.transform_point3(positions[corner as usize].as_dvec3()).as_vec3(),
            None => positions[corner as usize],
        };
        let corners = |triangle: u32| mesh.triangles()[triangle as usize].map(placed);
        let bvh::Built { bvh, order, leaves } =
            bvh::build(mesh.triangles().len(), |triangle| Bounds::around(corners(triangle as u32)), &check)?;
        check()?;
        let packed = |leaf: &std::ops::Range<u32>| {
            let mut pack = Pack { corners: [[f32x4::ZERO; 3]; 3], triangles: [0; WIDTH] };
            for (lane, &triangle) in order[leaf.start as usize..leaf.end as usize].iter().enumerate() {
                pack.triangles[lane] = triangle;
                for (corner, point) in corners(triangle).into_iter().enumerate() {
                    (0..3).for_each(|axis| pack.corners[corner][axis].as_mut_array()[lane] = point[axis]);
                }
            }
            pack
        };
        let mut packs = Vec::new();
        leaves.par_iter().map(packed).collect_into_vec(&mut packs);
        let bounds = (0..mesh.triangles().len() as u32).into_par_iter().with_min_len(1 << 14).map(|t| Bounds::around(corners(t)));
        let bounds = bounds.reduce(|| Bounds::EMPTY, Bounds::union);
        Ok(Self { mesh, bvh, packs, bounds })
    }

    /// The mesh.
    pub fn mesh(&self) -> &Mesh {
        &self.mesh
    }

    /// The box around all triangles.
    pub fn bounds(&self) -> Bounds {
        self.bounds
    }

    /// Bytes it holds beside the mesh.
    pub fn memory(&self) -> u64 {
        self.bvh.memory() + size_of_val(&*self.packs) as u64
    }

    /// The triangle of the mesh at a place.
    pub fn triangle(&self, place: u32) -> u32 {
        self.packs[place as usize / WIDTH].triangles[place as usize % WIDTH]
    }

    /// The corners at a place, as they are hit.
    pub fn corners(&self, place: u32) -> [Vec3; 3] {
        let (pack, lane) = (&self.packs[place as usize / WIDTH], place as usize % WIDTH);
        pack.corners.map(|corner| Vec3::from_array(corner.map(|axis| axis.to_array()[lane])))
    }

    /// The nearest hit at a parameter in (0, reach); of equals the one that the tree comes to first.
    pub fn intersect(&self, origin: Vec3, direction: Vec3, reach: f32) -> Option<TriangleHit> {
        let shear = Shear::new(origin, direction);
        let mut hit = None;
        self.bvh.nearest(origin, direction, reach, |leaf, reach| {
            let Some(met) = shear.meet(&self.packs[leaf as usize], reach) else { return reach };
            let distances = met.distance.to_array();
            let mut mask = met.mask;
            let mut lane = mask.trailing_zeros() as usize & 3;
            mask &= mask - 1;
            while mask != 0 {
                let next = mask.trailing_zeros() as usize & 3;
                mask &= mask - 1;
                lane = if distances[next] < distances[lane] { next } else { lane };
            }
            let of_lane = |values: f32x4| values.to_array()[lane];
            let determinant = of_lane(met.determinant);
            hit = Some(TriangleHit {
                distance: distances[lane],
                place: leaf * WIDTH as u32 + lane as u32,
                barycentric: [of_lane(met.v) / determinant, of_lane(met.w) / determinant],
            });
            distances[lane]
        });
        hit
    }

    /// Whether anything is hit at a parameter in (0, reach).
    pub fn is_occluded(&self, origin: Vec3, direction: Vec3, reach: f32) -> bool {
        let shear = Shear::new(origin, direction);
        self.bvh.any(origin, direction, reach, |leaf| shear.meet(&self.packs[leaf as usize], reach).is_some())
    }
}

//! The nearest shape and occlusion by way of a bounding volume hierarchy, where shapes are too many to ask all. A node holds
//! the boxes of up to four children, quantised; a leaf is one shape. Laid out by `bvh_build`.
//! GPU twin: kernels/scene/bvh.wesl

use super::compiled::{CompiledScene, ShapeIndex, Triangle};
use super::rows::Row;
use super::shapes::{Hit, Ray, T_MISS, intersect_quad, intersect_sphere};
use super::triangle::{RayShear, intersect_triangle, ray_shear};
use glam::{BVec4A, UVec4, Vec3, Vec4};

/// Marks the number of a shape where a node could stand.
pub const LEAF: u32 = 1 << 31;
/// Rows of a node.
pub const NODE_ROWS: usize = 3;
/// Children of a node, at most.
pub const WIDTH: usize = 4;
/// Children that a walk may have to come back to at once, in any hierarchy.
pub const MOST_DEPTH: u32 = 96;
/// Factor on the far side of a box that makes up for the rounding of both sides (Ize 2013).
const FAR_SIDE: f32 = 1.000002;

/// In a node's first row, last word, above the exponents: the number of children that are nodes, three bits …
pub const INNER_BIT: u32 = 1 << 24;
/// … of all children, three bits …
pub const COUNT_BIT: u32 = 1 << 27;
/// … and whether its shapes are not numbered in a row.
pub const LIST_BIT: u32 = 1 << 30;

/// Nodes of three rows:
/// origin of the grid, exponents of its steps along x, y, z in a byte each and the counts above ·
/// least coordinates of the boxes in steps, a byte for each of four children, along x, y, z, number of the first child that is a node ·
/// greatest coordinates likewise, [`LEAF`] with the number that the child in slot 0 would have if all were shapes.
/// Children that are nodes come first and are numbered in a row. If a node's shapes are not, the last word is the number of a row
/// behind all nodes that lists what is in each slot.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Bvh {
    pub rows: Vec<Row>,
    /// How many nodes there are.
    pub nodes: usize,
    /// Children that a walk may have to come back to at once, at most.
    pub depth: u32,
    /// How long it took to build.
    pub seconds: f64,
}

/// 1/direction, finite where a component is zero, and small enough to be multiplied by any extent.
#[inline(always)]
fn inverse_direction(direction: Vec3) -> Vec3 {
    let tiny = Vec3::splat(1e-18);
    let signed = Vec3::select(direction.cmpge(Vec3::ZERO), tiny, -tiny);
    Vec3::ONE / Vec3::select(direction.abs().cmplt(tiny), signed, direction)
}

/// The four bytes of a word.
#[inline(always)]
fn bytes_of(word: u32) -> Vec4 {
    Vec4::from_array(word.to_le_bytes().map(f32::from))
}

/// Where a ray enters the boxes of a node, T_MISS where it does not, and what leads to its children.
struct NodeMet {
    t: Vec4,
    counts: u32,
    first_node: u32,
    first_shape: u32,
}

/// The node, and which of its children the ray meets before `t_max`.
#[inline(always)]
fn node_met(bvh: &Bvh, node: u32, walker: &Walker, t_max: f32) -> NodeMet {
    let [frame, low, high] = &bvh.rows.as_chunks().0[node as usize];
    let begin = (corner(frame) - walker.ray.origin) * walker.inverse;
    let (mut enter, mut leave) = (Vec4::ZERO, Vec4::splat(t_max));
    for k in 0..3 {
        let step = f32::from_bits((frame[3] >> (8 * k) & 255) << 23) * walker.inverse[k];
        let (near, far) = if walker.inverse[k] < 0.0 { (high[k], low[k]) } else { (low[k], high[k]) };
        enter = enter.max(bytes_of(near) * step + begin[k]);
        leave = leave.min(bytes_of(far) * step + begin[k]);
    }
    let exists = UVec4::new(0, 1, 2, 3).cmplt(UVec4::splat(frame[3] / COUNT_BIT & 7));
    let met = enter.cmple(leave * FAR_SIDE) & BVec4A::from_array(exists.into());
    NodeMet {
        t: Vec4::select(met, enter, Vec4::splat(T_MISS)),
        counts: frame[3],
        first_node: low[3],
        first_shape: high[3],
    }
}

#[inline(always)]
fn corner(row: &Row) -> Vec3 {
    Vec3::from_array([row[0], row[1], row[2]].map(f32::from_bits))
}

/// What is in a slot: the number of a node, or of a shape with [`LEAF`].
#[inline(always)]
fn child(bvh: &Bvh, node: &NodeMet, slot: u32) -> u32 {
    if slot < (node.counts / INNER_BIT & 7) {
        return node.first_node + slot;
    }
    if node.counts & LIST_BIT != 0 {
        return bvh.rows[node.first_shape as usize][slot as usize];
    }
    node.first_shape.wrapping_add(slot)
}

/// Distances in their order, each with its slot in its lowest two bits; [`NOTHING`] where the box is not met.
#[inline(always)]
fn sorted(t: Vec4) -> [u32; WIDTH] {
    let key = |slot: usize| if t[slot] < T_MISS { t[slot].to_bits() & !3 | slot as u32 } else { NOTHING };
    let (a, b) = (key(0).min(key(1)), key(0).max(key(1)));
    let (c, d) = (key(2).min(key(3)), key(2).max(key(3)));
    let (low, high) = (a.max(c), b.min(d));
    [a.min(c), low.min(high), low.max(high), b.max(d)]
}
/// Behind all distances.
const NOTHING: u32 = u32::MAX;

/// What is in a node, and the boxes around: for tests.
#[cfg(test)]
pub(super) fn children(bvh: &Bvh, node: u32) -> Vec<(u32, [Vec3; 2])> {
    let [frame, low, high] = &bvh.rows.as_chunks::<NODE_ROWS>().0[node as usize];
    let step = Vec3::from_array([0, 8, 16].map(|at| f32::from_bits((frame[3] >> at & 255) << 23)));
    let met = NodeMet { t: Vec4::ZERO, counts: frame[3], first_node: low[3], first_shape: high[3] };
    let at = |row: &Row, slot: usize| {
        corner(frame) + step * Vec3::from_array([0, 1, 2].map(|k| f32::from(row[k].to_le_bytes()[slot])))
    };
    let count = frame[3] / COUNT_BIT & 7;
    (0..count).map(|i| (child(bvh, &met, i), [at(low, i as usize), at(high, i as usize)])).collect()
}

/// A ray with what nodes and triangles ask of it.
struct Walker {
    ray: Ray,
    inverse: Vec3,
    view: RayShear,
}

#[inline(always)]
fn walker(ray: Ray) -> Walker {
    Walker { ray, inverse: inverse_direction(ray.direction), view: ray_shear(ray.direction) }
}

/// Distance to one shape, T_MISS if there is none.
#[inline(always)]
fn shape_distance(scene: &CompiledScene, walker: &Walker, shape: u32) -> f32 {
    match scene.shape_index(shape) {
        ShapeIndex::Sphere(i) => intersect_sphere(&walker.ray, &scene.spheres[i]),
        ShapeIndex::Quad(i) => intersect_quad(&walker.ray, &scene.quads[i]),
        ShapeIndex::Triangle(i) => {
            let Triangle { a, b, c, .. } = scene.triangles[i];
            let t = intersect_triangle(walker.ray.origin, &walker.view, a, b, c);
            if t > 0.0 { t } else { T_MISS }
        }
    }
}

/// What a walk still has to visit.
struct Waiting {
    nodes: [u32; MOST_DEPTH as usize],
    count: usize,
}

impl Waiting {
    #[inline(always)]
    fn none() -> Self {
        Waiting { nodes: [0; MOST_DEPTH as usize], count: 0 }
    }

    #[inline(always)]
    fn push(&mut self, node: u32) {
        self.nodes[self.count] = node;
        self.count += 1;
    }

    /// Pushes the children that are met but the nearest, which is returned.
    #[inline(always)]
    fn push_farther(&mut self, bvh: &Bvh, node: &NodeMet) -> Option<u32> {
        let keys = sorted(node.t);
        for key in [keys[3], keys[2], keys[1]] {
            if key != NOTHING {
                self.push(child(bvh, node, key & 3));
            }
        }
        (keys[0] != NOTHING).then(|| child(bvh, node, keys[0] & 3))
    }

    #[inline(always)]
    fn pop(&mut self) -> Option<u32> {
        self.count = self.count.checked_sub(1)?;
        Some(self.nodes[self.count])
    }
}

/// The nearest shape that the ray meets, of equally near ones the first.
pub fn intersect(scene: &CompiledScene, bvh: &Bvh, ray: Ray) -> Option<Hit> {
    let walker = walker(ray);
    let mut hit = Hit { t: T_MISS, shape: u32::MAX };
    let mut waiting = Waiting::none();
    let mut at = 0;
    loop {
        if at & LEAF != 0 {
            let shape = at & !LEAF;
            let t = shape_distance(scene, &walker, shape);
            if t < hit.t || (t == hit.t && shape < hit.shape && t < T_MISS) {
                hit = Hit { t, shape };
            }
        } else {
            let node = node_met(bvh, at, &walker, hit.t);
            if let Some(nearest) = waiting.push_farther(bvh, &node) {
                at = nearest;
                continue;
            }
        }
        match waiting.pop() {
            Some(node) => at = node,
            None => return (hit.shape != u32::MAX).then_some(hit),
        }
    }
}

/// Whether anything but `excluded` (the light aimed at) lies nearer than `t_max`.
pub fn occluded(scene: &CompiledScene, bvh: &Bvh, ray: Ray, t_max: f32, excluded: u32) -> bool {
    let walker = walker(ray);
    let mut waiting = Waiting::none();
    let mut at = 0;
    loop {
        if at & LEAF != 0 {
            let shape = at & !LEAF;
            if shape != excluded && shape_distance(scene, &walker, shape) < t_max {
                return true;
            }
        } else {
            let node = node_met(bvh, at, &walker, t_max);
            if let Some(nearest) = waiting.push_farther(bvh, &node) {
                at = nearest;
                continue;
            }
        }
        match waiting.pop() {
            Some(node) => at = node,
            None => return false,
        }
    }
}

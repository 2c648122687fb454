//! The nearest shape and occlusion by way of a bounding volume hierarchy, where shapes are too many to ask all. A node holds
//! the boxes of its two children; a leaf is one shape. Laid out by `bvh_build`. GPU twin: kernels/scene/bvh.wesl

use super::compiled::{CompiledScene, ShapeIndex, Triangle};
use super::rows::Row;
use super::shapes::{Hit, Ray, T_MISS, intersect_quad, intersect_sphere};
use super::triangle::{RayShear, intersect_triangle, ray_shear};
use glam::{Vec3, Vec3A, Vec4};

/// Marks the number of a shape where a node could stand.
pub const LEAF: u32 = 1 << 31;
/// Rows of a node.
pub const NODE_ROWS: usize = 4;
/// Nodes that a walk may have to come back to at once, in any hierarchy.
pub const MOST_DEPTH: u32 = 96;
/// Factor on the far side of a box that makes up for the rounding of both sides (Ize 2013).
pub(super) const FAR_SIDE: f32 = 1.0000005;

/// Two boxes, and what is in each: the number of another node, or of a shape with [`LEAF`]. In rows:
/// minimum, child · maximum, 0 of the first; the same of the second.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Bvh {
    pub rows: Vec<Row>,
    /// Nodes that a walk may have to come back to at once, at most.
    pub depth: u32,
    /// How long it took to build.
    pub seconds: f64,
}

/// 1/direction, finite where a component is zero.
#[inline(always)]
pub(super) fn inverse_direction(direction: Vec3) -> Vec3 {
    let tiny = Vec3::splat(1e-30);
    let signed = Vec3::select(direction.cmpge(Vec3::ZERO), tiny, -tiny);
    Vec3::ONE / Vec3::select(direction.abs().cmplt(tiny), signed, direction)
}

#[inline(always)]
pub(super) fn corner(row: &Row) -> Vec3A {
    Vec3A::from_vec4(Vec4::from_array(row.map(f32::from_bits)))
}

/// Where the ray enters the box, T_MISS if it does not before `t_max`.
#[inline(always)]
fn box_distance(origin: Vec3A, inverse: Vec3A, low: &Row, high: &Row, t_max: f32) -> f32 {
    let a = (corner(low) - origin) * inverse;
    let b = (corner(high) - origin) * inverse;
    let (near, far) = (a.min(b), a.max(b));
    let enter = near.max_element().max(0.0);
    let leave = far.min_element().min(t_max);
    if enter <= leave * FAR_SIDE { enter } else { T_MISS }
}

/// Which children of a node the ray meets before `t_max`; where it meets one, that is the nearer.
pub(super) struct ChildrenMet {
    pub any: bool,
    pub both: bool,
    pub nearer: u32,
    pub farther: u32,
}

/// What a walk does at a node, by the distances to its boxes.
#[inline(always)]
pub(super) fn children_met(bvh: &Bvh, node: u32, distance: impl Fn(&Row, &Row) -> f32) -> ChildrenMet {
    let [low0, high0, low1, high1] = &bvh.rows.as_chunks().0[node as usize];
    let (t0, t1) = (distance(low0, high0), distance(low1, high1));
    let (nearer, farther) = if t0 <= t1 { (low0[3], low1[3]) } else { (low1[3], low0[3]) };
    ChildrenMet { any: t0.min(t1) < T_MISS, both: t0.max(t1) < T_MISS, nearer, farther }
}

/// A ray with what nodes and triangles ask of it.
pub(super) struct Walker {
    pub ray: Ray,
    origin: Vec3A,
    inverse: Vec3A,
    pub view: RayShear,
}

#[inline(always)]
pub(super) fn walker(ray: Ray) -> Walker {
    let inverse = inverse_direction(ray.direction).into();
    Walker { ray, origin: ray.origin.into(), inverse, view: ray_shear(ray.direction) }
}

/// Distance to one shape, T_MISS if there is none.
#[inline(always)]
pub(super) fn shape_distance(scene: &CompiledScene, walker: &Walker, shape: u32) -> f32 {
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

/// What a walk still has to visit, so much at most.
pub(super) struct Waiting<const MOST: usize> {
    nodes: [u32; MOST],
    pub count: usize,
}

impl<const MOST: usize> Waiting<MOST> {
    #[inline(always)]
    pub fn none() -> Self {
        Waiting { nodes: [0; MOST], count: 0 }
    }

    #[inline(always)]
    pub fn push(&mut self, node: u32) {
        self.nodes[self.count] = node;
        self.count += 1;
    }

    #[inline(always)]
    pub fn pop(&mut self) -> Option<u32> {
        self.count = self.count.checked_sub(1)?;
        Some(self.nodes[self.count])
    }
}

/// The nearest shape that the ray meets, of equally near ones the first.
pub fn intersect(scene: &CompiledScene, bvh: &Bvh, ray: Ray) -> Option<Hit> {
    let walker = walker(ray);
    let mut hit = Hit { t: T_MISS, shape: u32::MAX };
    let mut waiting = Waiting::<{ MOST_DEPTH as usize }>::none();
    let mut at = 0;
    loop {
        if at & LEAF != 0 {
            let shape = at & !LEAF;
            let t = shape_distance(scene, &walker, shape);
            if t < hit.t || (t == hit.t && shape < hit.shape && t < T_MISS) {
                hit = Hit { t, shape };
            }
        } else {
            let met = children_met(bvh, at, |low, high| {
                box_distance(walker.origin, walker.inverse, low, high, hit.t)
            });
            if met.any {
                at = met.nearer;
                if met.both {
                    waiting.push(met.farther);
                }
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
    let mut waiting = Waiting::<{ MOST_DEPTH as usize }>::none();
    let mut at = 0;
    loop {
        if at & LEAF != 0 {
            let shape = at & !LEAF;
            if shape != excluded && shape_distance(scene, &walker, shape) < t_max {
                return true;
            }
        } else {
            let met = children_met(bvh, at, |low, high| {
                box_distance(walker.origin, walker.inverse, low, high, t_max)
            });
            if met.any {
                at = met.nearer;
                if met.both {
                    waiting.push(met.farther);
                }
                continue;
            }
        }
        match waiting.pop() {
            Some(node) => at = node,
            None => return false,
        }
    }
}

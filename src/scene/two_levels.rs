//! The nearest shape and occlusion where meshes are shared: a hierarchy over the shapes that are laid out and the instances, and
//! one over each mesh, in its own coordinates. Boxes of a mesh are met there, by the ray brought to them and with room for what
//! that rounds; triangles are met in the world, where the instance puts them. So what is found is what the walk through one
//! hierarchy over all triangles would find, bit for bit. GPU twin: kernels/scene/two_levels.wesl

use super::bvh::{
    Bvh, FAR_SIDE, LEAF, MOST_DEPTH, NODE_ROWS, Walker, corner, inverse_direction, shape_distance, walker,
};
use super::compiled::{CompiledScene, Triangle};
use super::instance::{Instance, place_triangle, to_mesh};
use super::rows::Row;
use super::shapes::{Hit, Ray, T_MISS};
use super::triangle::intersect_triangle;
use glam::Vec3A;

/// Marks, of a leaf, the number of an instance.
pub const INSTANCE: u32 = 1 << 30;

/// Where boxes are met: a ray in their coordinates. Their low sides are seen from above it, their high sides from below, by as
/// much as it may be off.
struct BoxFrame {
    above: Vec3A,
    below: Vec3A,
    inverse: Vec3A,
}

/// In the world, where the ray is as it is.
#[inline(always)]
fn world_frame(ray: Ray) -> BoxFrame {
    let origin = ray.origin.into();
    BoxFrame { above: origin, below: origin, inverse: inverse_direction(ray.direction).into() }
}

/// In the coordinates of a mesh. The direction keeps its length in the world, so that distances are the world's.
#[inline(always)]
fn mesh_frame(instance: &Instance, ray: Ray) -> BoxFrame {
    let origin = to_mesh(instance, ray.origin - instance.translation);
    let slack = instance.slack * (ray.origin.abs().max_element() + instance.reach);
    let inverse = inverse_direction(to_mesh(instance, ray.direction));
    BoxFrame { above: (origin + slack).into(), below: (origin - slack).into(), inverse: inverse.into() }
}

/// Where the ray enters the box, T_MISS if it does not before `t_max`.
#[inline(always)]
fn widened_distance(frame: &BoxFrame, low: &Row, high: &Row, t_max: f32) -> f32 {
    let a = (corner(low) - frame.above) * frame.inverse;
    let b = (corner(high) - frame.below) * frame.inverse;
    let (near, far) = (a.min(b), a.max(b));
    let enter = near.max_element().max(0.0);
    let leave = far.min_element().min(t_max);
    if enter <= leave * FAR_SIDE { enter } else { T_MISS }
}

/// Which children of a node the ray meets before `t_max`; where it meets one, that is the nearer.
struct ChildrenMet {
    any: bool,
    both: bool,
    nearer: u32,
    farther: u32,
}

#[inline(always)]
fn children_met(bvh: &Bvh, node: u32, frame: &BoxFrame, t_max: f32) -> ChildrenMet {
    let [low0, high0, low1, high1] = &bvh.rows.as_chunks::<NODE_ROWS>().0[node as usize];
    let t0 = widened_distance(frame, low0, high0, t_max);
    let t1 = widened_distance(frame, low1, high1, t_max);
    let (nearer, farther) = if t0 <= t1 { (low0[3], low1[3]) } else { (low1[3], low0[3]) };
    ChildrenMet { any: t0.min(t1) < T_MISS, both: t0.max(t1) < T_MISS, nearer, farther }
}

/// Distance to a triangle of an instance, by its number in the mesh; T_MISS if it is not met.
#[inline(always)]
fn instanced_distance(scene: &CompiledScene, walker: &Walker, instance: &Instance, number: u32) -> f32 {
    let stored = scene.shared_triangle((instance.first_triangle + number) as usize);
    let Triangle { a, b, c, .. } = place_triangle(instance, stored);
    let t = intersect_triangle(walker.ray.origin, &walker.view, a, b, c);
    if t > 0.0 { t } else { T_MISS }
}

/// What a walk still has to visit.
struct Waiting {
    nodes: [u32; 2 * MOST_DEPTH as usize],
    count: usize,
}

impl Waiting {
    #[inline(always)]
    fn none() -> Self {
        Waiting { nodes: [0; 2 * MOST_DEPTH as usize], count: 0 }
    }

    #[inline(always)]
    fn push(&mut self, node: u32) {
        self.nodes[self.count] = node;
        self.count += 1;
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
    let mut frame = world_frame(ray);
    let mut hit = Hit { t: T_MISS, shape: u32::MAX };
    let mut waiting = Waiting::none();
    // The instance that the walk is in, its first shape, and how much was waiting when it came in.
    let (mut within, mut first_shape, mut floor) = (None, 0, 0);
    let mut at = 0;
    loop {
        if within.is_none() && at & (LEAF | INSTANCE) == LEAF | INSTANCE {
            let instance = &scene.shared.instances[(at & !(LEAF | INSTANCE)) as usize];
            frame = mesh_frame(instance, ray);
            (within, first_shape, floor) = (Some(instance), instance.first_shape, waiting.count);
            at = instance.first_node;
            continue;
        }
        if at & LEAF != 0 {
            let shape = first_shape + (at & !LEAF);
            let t = match within {
                None => shape_distance(scene, &walker, shape),
                Some(instance) => instanced_distance(scene, &walker, instance, at & !LEAF),
            };
            if t < hit.t || (t == hit.t && shape < hit.shape && t < T_MISS) {
                hit = Hit { t, shape };
            }
        } else {
            let met = children_met(bvh, at, &frame, hit.t);
            if met.any {
                at = met.nearer;
                if met.both {
                    waiting.push(met.farther);
                }
                continue;
            }
        }
        if within.is_some() && waiting.count == floor {
            (within, first_shape) = (None, 0);
            frame = world_frame(ray);
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
    let mut frame = world_frame(ray);
    let mut waiting = Waiting::none();
    let (mut within, mut first_shape, mut floor) = (None, 0, 0);
    let mut at = 0;
    loop {
        if within.is_none() && at & (LEAF | INSTANCE) == LEAF | INSTANCE {
            let instance = &scene.shared.instances[(at & !(LEAF | INSTANCE)) as usize];
            frame = mesh_frame(instance, ray);
            (within, first_shape, floor) = (Some(instance), instance.first_shape, waiting.count);
            at = instance.first_node;
            continue;
        }
        if at & LEAF != 0 {
            let shape = first_shape + (at & !LEAF);
            let t = match within {
                None => shape_distance(scene, &walker, shape),
                Some(instance) => instanced_distance(scene, &walker, instance, at & !LEAF),
            };
            if shape != excluded && t < t_max {
                return true;
            }
        } else {
            let met = children_met(bvh, at, &frame, t_max);
            if met.any {
                at = met.nearer;
                if met.both {
                    waiting.push(met.farther);
                }
                continue;
            }
        }
        if within.is_some() && waiting.count == floor {
            (within, first_shape) = (None, 0);
            frame = world_frame(ray);
        }
        match waiting.pop() {
            Some(node) => at = node,
            None => return false,
        }
    }
}

//! The nearest shape and occlusion where meshes are shared: a hierarchy over the shapes that are laid out and the instances, and
//! one over each mesh, in its own coordinates. Boxes of a mesh are met there, by the ray brought to them and with room for what
//! that rounds; triangles are met in the world, where the instance puts them. So what is found is what the walk through one
//! hierarchy over all triangles would find, bit for bit. GPU twin: kernels/scene/two_levels.wesl

use super::bvh::{
    Bvh, FAR_SIDE, LEAF, MOST_DEPTH, Waiting, Walker, children_met, corner, inverse_direction,
    shape_distance, walker,
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

/// Distance to a triangle of an instance, by its number in the mesh; T_MISS if it is not met.
#[inline(always)]
fn instanced_distance(scene: &CompiledScene, walker: &Walker, instance: &Instance, number: u32) -> f32 {
    let stored = scene.shared_triangle((instance.first_triangle + number) as usize);
    let Triangle { a, b, c, .. } = place_triangle(instance, stored);
    let t = intersect_triangle(walker.ray.origin, &walker.view, a, b, c);
    if t > 0.0 { t } else { T_MISS }
}

/// Where a walk is: in the world, or within an instance.
struct Walk<'a> {
    scene: &'a CompiledScene,
    walker: Walker,
    frame: BoxFrame,
    within: Option<&'a Instance>,
    /// Of both levels; below `floor` lies what waited when the walk came in.
    waiting: Waiting<{ 2 * MOST_DEPTH as usize }>,
    floor: usize,
}

impl<'a> Walk<'a> {
    #[inline(always)]
    fn new(scene: &'a CompiledScene, ray: Ray) -> Self {
        let (walker, frame) = (walker(ray), world_frame(ray));
        Walk { scene, walker, frame, within: None, waiting: Waiting::none(), floor: 0 }
    }

    /// Goes into the instance that stands at `at`, if one does: the top node of its mesh.
    #[inline(always)]
    fn enter(&mut self, at: u32) -> Option<u32> {
        if self.within.is_some() || at & (LEAF | INSTANCE) != LEAF | INSTANCE {
            return None;
        }
        let instance = &self.scene.shared.instances[(at & !(LEAF | INSTANCE)) as usize];
        self.frame = mesh_frame(instance, self.walker.ray);
        (self.within, self.floor) = (Some(instance), self.waiting.count);
        Some(instance.first_node)
    }

    /// The shape of a leaf, and how far it is.
    #[inline(always)]
    fn leaf(&self, at: u32) -> Hit {
        let number = at & !LEAF;
        match self.within {
            None => Hit { t: shape_distance(self.scene, &self.walker, number), shape: number },
            Some(instance) => {
                let t = instanced_distance(self.scene, &self.walker, instance, number);
                Hit { t, shape: instance.first_shape + number }
            }
        }
    }

    /// Where to go on from a node: to the nearer of its children that the ray meets before `t_max`.
    #[inline(always)]
    fn descend(&mut self, bvh: &Bvh, at: u32, t_max: f32) -> Option<u32> {
        let met = children_met(bvh, at, |low, high| widened_distance(&self.frame, low, high, t_max));
        if met.both {
            self.waiting.push(met.farther);
        }
        met.any.then_some(met.nearer)
    }

    /// What is to be visited next, out of the instance if nothing is left in it.
    #[inline(always)]
    fn next(&mut self) -> Option<u32> {
        if self.within.is_some() && self.waiting.count == self.floor {
            self.within = None;
            self.frame = world_frame(self.walker.ray);
        }
        self.waiting.pop()
    }
}

/// The nearest shape that the ray meets, of equally near ones the first.
pub fn intersect(scene: &CompiledScene, bvh: &Bvh, ray: Ray) -> Option<Hit> {
    let mut walk = Walk::new(scene, ray);
    let mut nearest = Hit { t: T_MISS, shape: u32::MAX };
    let mut next = Some(0);
    while let Some(at) = next {
        if let Some(top) = walk.enter(at) {
            next = Some(top);
            continue;
        }
        if at & LEAF != 0 {
            let hit = walk.leaf(at);
            if hit.t < nearest.t || (hit.t == nearest.t && hit.shape < nearest.shape && hit.t < T_MISS) {
                nearest = hit;
            }
        } else if let Some(child) = walk.descend(bvh, at, nearest.t) {
            next = Some(child);
            continue;
        }
        next = walk.next();
    }
    (nearest.shape != u32::MAX).then_some(nearest)
}

/// Whether anything but `excluded` (the light aimed at) lies nearer than `t_max`.
pub fn occluded(scene: &CompiledScene, bvh: &Bvh, ray: Ray, t_max: f32, excluded: u32) -> bool {
    let mut walk = Walk::new(scene, ray);
    let mut next = Some(0);
    while let Some(at) = next {
        if let Some(top) = walk.enter(at) {
            next = Some(top);
            continue;
        }
        if at & LEAF != 0 {
            let hit = walk.leaf(at);
            if hit.shape != excluded && hit.t < t_max {
                return true;
            }
        } else if let Some(child) = walk.descend(bvh, at, t_max) {
            next = Some(child);
            continue;
        }
        next = walk.next();
    }
    false
}

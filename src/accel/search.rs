//! How the CPU finds what a ray meets: by the scene's hierarchy where it has one, else by asking all shapes, eight at a time.

use super::{RayLanes, ShadowEnds, ShapeLanes};
use crate::scene::bvh::{self, Bvh};
use crate::scene::compiled::CompiledScene;
use crate::scene::shapes::{Hit, Ray};
use crate::scene::two_levels;

/// Finds shapes of a scene. Cheap to make: what it copies are the shapes of small scenes.
#[derive(Clone, Debug)]
pub enum Search<'a> {
    /// Shapes few enough to ask them all.
    All(ShapeLanes),
    /// The walk that the GPU takes, one ray at a time.
    Hierarchy(&'a CompiledScene, &'a Bvh),
    /// The same where meshes are shared.
    TwoLevels(&'a CompiledScene, &'a Bvh),
}

impl<'a> Search<'a> {
    pub fn new(scene: &'a CompiledScene) -> Search<'a> {
        match &scene.bvh {
            Some(bvh) if scene.shared.instances.is_empty() => Search::Hierarchy(scene, bvh),
            Some(bvh) => Search::TwoLevels(scene, bvh),
            None => Search::All(ShapeLanes::new(scene)),
        }
    }

    /// The nearest shape that the ray meets.
    #[inline]
    pub fn intersect(&self, ray: Ray) -> Option<Hit> {
        match self {
            Search::All(lanes) => lanes.intersect(ray),
            Search::Hierarchy(scene, bvh) => bvh::intersect(scene, bvh, ray),
            Search::TwoLevels(scene, bvh) => two_levels::intersect(scene, bvh, ray),
        }
    }

    /// Whether anything but `excluded` (the light aimed at) lies nearer than `t_max`.
    #[inline]
    pub fn occluded(&self, ray: Ray, t_max: f32, excluded: u32) -> bool {
        match self {
            Search::All(lanes) => lanes.occluded(ray, t_max, excluded),
            Search::Hierarchy(scene, bvh) => bvh::occluded(scene, bvh, ray, t_max, excluded),
            Search::TwoLevels(scene, bvh) => two_levels::occluded(scene, bvh, ray, t_max, excluded),
        }
    }

    /// [`Search::intersect`] for the first `count` of eight rays; for the others it may be anything.
    #[inline]
    pub fn intersect_eight(&self, rays: &RayLanes, count: usize) -> [Option<Hit>; RayLanes::COUNT] {
        match self {
            Search::All(lanes) => lanes.intersect_eight(rays),
            _ => std::array::from_fn(|i| if i < count { self.intersect(rays.get(i)) } else { None }),
        }
    }

    /// [`Search::occluded`] for the first `count` of eight rays: a bit for each.
    #[inline]
    pub fn occluded_eight(&self, rays: &RayLanes, ends: &ShadowEnds, count: usize) -> u32 {
        match self {
            Search::All(lanes) => lanes.occluded_eight(rays, ends),
            _ => (0..count).fold(0, |blocked, i| {
                let (t_max, excluded) = ends.get(i);
                blocked | u32::from(self.occluded(rays.get(i), t_max, excluded)) << i
            }),
        }
    }
}

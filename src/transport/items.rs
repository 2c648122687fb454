//! Work items: what travels through the queues. Declared here once; the kernels' structs are generated from these.

use crate::gpu_struct;
use glam::Vec3;

gpu_struct! {
    /// A ray in flight with the state of its path. 48 bytes.
    pub struct RayItem {
        origin: Vec3,
        /// Number of the path within its batch, where paths split of its place: the first of those that this ray's path
        /// has to itself; `u32::MAX` marks a dead slot before compaction.
        path: u32,
        /// Unit length.
        direction: Vec3,
        /// Surfaces met so far: 0 for a camera ray. Where paths split, how many places it owns as well: see
        /// [`super::split`].
        bounce: u32,
        /// Product of f·cosθ/pdf and roulette weights so far; non-negative and finite.
        throughput: Vec3,
        /// Density with which the BSDF chose `direction`, in sr⁻¹; 0 for camera rays and delta lobes.
        pdf: f32,
    }
    /// A ray's nearest hit, waiting in the queue of its material kind. 12 bytes.
    pub struct HitItem {
        /// Where the ray lies in its queue.
        slot: u32,
        /// Shape hit: spheres first, then quads; `u32::MAX` for the environment.
        shape: u32,
        /// Distance along the ray.
        t: f32,
    }
    /// A shadow ray towards a light. 48 bytes.
    pub struct ShadowItem {
        origin: Vec3,
        /// Distance to the light; beyond everything to the environment.
        t_max: f32,
        direction: Vec3,
        path: u32,
        /// What arrives at the camera if nothing is in the way.
        radiance: Vec3,
        /// The light itself, which cannot shade the side that it shows; `u32::MAX` for the environment.
        light_shape: u32,
    }
}

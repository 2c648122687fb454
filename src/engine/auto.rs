//! Which GPU engine `auto` takes. By what was measured on an H100 (benches/results/, docs/PERFORMANCE.md), not by taste.

use super::{EngineKind, RenderOptions};
use crate::gpu::key::KernelKey;
use crate::scene::compiled::CompiledScene;

/// Shape tests per level up to which tracing costs less than carrying a ray through a queue and back (96 bytes).
const FEW_TESTS: usize = 8;
/// Levels up to which paths that sample no lights stay so alike that a megakernel loses little to divergence.
const SHORT_PATHS: u32 = 8;

/// The engine that is faster for this scene. A level costs the wavefront its memory traffic and the megakernel its
/// divergence: with few shapes, or short paths without direct light, the megakernel ran 1.4 to 5.9 times as fast
/// (bansal-exp-*, furnace-*, glass-caustic), elsewhere the wavefront's fused schedule 1.2 to 1.9 times (bansal-room-1,
/// cornell-box, glossy-box, many-lights, door-ajar).
///
/// Options that only the wavefront knows imply it.
pub fn preferred_engine(
    scene: &CompiledScene,
    key: &KernelKey,
    max_bounces: u32,
    options: &RenderOptions,
) -> EngineKind {
    if options.schedule.is_some() || options.pool.is_some() {
        return EngineKind::Wavefront;
    }
    let shapes = scene.spheres.len() + scene.quads.len();
    let tests = shapes * if key.direct_light { 2 } else { 1 };
    let short = !key.direct_light && max_bounces <= SHORT_PATHS;
    if tests <= FEW_TESTS || short { EngineKind::Megakernel } else { EngineKind::Wavefront }
}

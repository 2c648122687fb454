//! Which GPU engine `auto` takes. By what was measured on an H100 (benches/results/, docs/PERFORMANCE.md), not by taste.

use super::{EngineKind, RenderOptions};
use crate::gpu::key::KernelKey;
use crate::scene::compiled::CompiledScene;

/// Shape tests per level from which on the wavefront is faster: by then its queues' traffic hides behind them, and the
/// megakernel loses more to invocations that wait for each other.
const MANY_TESTS: usize = 64;

/// The engine that is faster for this scene: the megakernel up to 63 shape tests a level (0.98 to 5.8 times as fast as
/// the fused schedule on the shipped scenes), beyond that the wavefront (door-ajar 1.17, glass-shelf 1.05, many-lights 1.03 times
/// as fast). docs/PERFORMANCE.md.
///
/// Options that only the wavefront knows imply it.
pub fn preferred_engine(scene: &CompiledScene, key: &KernelKey, options: &RenderOptions) -> EngineKind {
    if options.schedule.is_some() || options.pool.is_some() {
        return EngineKind::Wavefront;
    }
    let tests = scene.tests_per_ray() * if key.direct_light { 2 } else { 1 };
    if tests < MANY_TESTS { EngineKind::Megakernel } else { EngineKind::Wavefront }
}

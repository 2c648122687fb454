//! Which GPU engine `auto` takes. By what was measured on an H100 (benches/results/), not by taste.

use super::EngineKind;
use crate::gpu::key::KernelKey;

/// Levels up to which paths stay so alike that a megakernel loses little to divergence.
const SHORT_PATHS: u32 = 8;

/// The faster engine for scenes with this key. Short paths that sample no lights are cheaper to carry in registers than
/// through queues: Bansal's experiments ran 1.4 to 2.1 times as fast as a megakernel. With direct light or long paths the
/// wavefront's fused schedule won, by 1.2 (bansal-room-1) to 1.9 times (door-ajar).
pub fn preferred_engine(key: &KernelKey, max_bounces: u32) -> EngineKind {
    if !key.direct_light && max_bounces <= SHORT_PATHS {
        EngineKind::Megakernel
    } else {
        EngineKind::Wavefront
    }
}

//! Many paths at a time on one thread, stage by stage: what the wavefront does on a GPU, small enough for a core's cache.
//! A path alone is a chain in which everything waits for what comes before; the same stage for many paths keeps a core
//! busy. Every path sees the same functions in the same order as in [`Transport::trace`], so bits are the same.

use crate::guiding::{Trail, Transition};
use crate::scene::shapes::{Hit, Ray};
use crate::transport::items::{RayItem, ShadowItem};
use crate::transport::path::Transport;
use glam::Vec3;

/// Paths in flight.
const POOL: usize = 64;

/// A path in flight.
#[derive(Clone, Copy, Default)]
struct Flight {
    ray: RayItem,
    trail: Trail,
    /// Which of the radiances is its own.
    place: usize,
}

/// A shadow ray that waits for its test.
#[derive(Clone, Copy, Default)]
struct Waiting {
    shadow: ShadowItem,
    /// What the slot learns if nothing is in the way.
    slot: u32,
    value: f32,
    place: usize,
}

/// Traces the paths and puts what each brings to the camera into its place of `radiance`, which must be zero. Returns how
/// many rays that took, shadow rays not counted.
pub fn trace_all(transport: &Transport, paths: &[u32], radiance: &mut [Vec3]) -> u64 {
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx2") {
        // SAFETY: the processor has AVX2.
        return unsafe { trace_all_avx2(transport, paths, radiance) };
    }
    trace_levels(transport, paths, radiance)
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn trace_all_avx2(transport: &Transport, paths: &[u32], radiance: &mut [Vec3]) -> u64 {
    trace_levels(transport, paths, radiance)
}

#[inline(always)]
fn trace_levels(transport: &Transport, paths: &[u32], radiance: &mut [Vec3]) -> u64 {
    let mut flights = [Flight::default(); POOL];
    let mut hits = [None::<Hit>; POOL];
    let mut shadows = [Waiting::default(); POOL];
    let (mut live, mut rays) = (0, 0);
    let mut fresh = paths.iter().enumerate();
    loop {
        for (place, &path) in fresh.by_ref().take(POOL - live) {
            flights[live] = Flight { ray: transport.generate(path), trail: Trail::default(), place };
            live += 1;
        }
        if live == 0 {
            return rays;
        }
        rays += live as u64;

        for (hit, Flight { ray, .. }) in hits.iter_mut().zip(&flights[..live]) {
            *hit = transport.lanes.intersect(Ray { origin: ray.origin, direction: ray.direction });
        }

        let (mut kept, mut waiting) = (0, 0);
        for i in 0..live {
            let Flight { ray, trail, place } = flights[i];
            let Some(hit) = hits[i] else {
                let value = transport.environment_value(&trail);
                transport.learn(&Transition { slot: trail.slot, value, ..Default::default() });
                radiance[place] += transport.environment(&ray);
                continue;
            };
            let shaded = transport.shade(&ray, &trail, hit);
            transport.learn(&shaded.transition);
            radiance[place] += shaded.emitted;
            if let Some(shadow) = shaded.shadow {
                shadows[waiting] = Waiting { shadow, slot: trail.slot, value: shaded.shadow_value, place };
                waiting += 1;
            }
            if let Some(ray) = shaded.ray {
                flights[kept] = Flight { ray, trail: shaded.trail, place };
                kept += 1;
            }
        }
        live = kept;

        for Waiting { shadow, slot, value, place } in &shadows[..waiting] {
            let towards = Ray { origin: shadow.origin, direction: shadow.direction };
            if !transport.lanes.occluded(towards, shadow.t_max, shadow.light_shape) {
                transport.learn(&Transition { slot: *slot, value: *value, ..Default::default() });
                radiance[*place] += shadow.radiance;
            }
        }
    }
}

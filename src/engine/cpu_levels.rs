//! Many paths at a time on one thread, stage by stage: what the wavefront does on a GPU, small enough for a core's cache.
//! A path alone is a chain in which everything waits for what comes before; the same stage for many paths keeps a core
//! busy. Every path sees the same functions in the same order as in [`Transport::trace`], so bits are the same.

use crate::accel::{RayLanes, ShadowEnds};
use crate::guiding::{Trail, Transition};
use crate::scene::shapes::{Hit, Ray};
use crate::transport::items::RayItem;
use crate::transport::path::Transport;
use glam::Vec3;

/// Paths in flight.
const POOL: usize = 64;
/// Rays that are intersected together.
const TOGETHER: usize = RayLanes::COUNT;

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
    radiance: Vec3,
    /// What the slot learns if nothing is in the way.
    slot: u32,
    value: f32,
    place: usize,
}

/// Traces the paths and puts what each brings to the camera into its place of `radiance`, which must be zero. Returns how
/// many rays that took, shadow rays not counted.
pub fn trace_all(transport: &Transport, paths: &[u32], radiance: &mut [Vec3]) -> u64 {
    if transport.places > 1 {
        return trace_each(transport, paths, radiance);
    }
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx2") {
        // SAFETY: the processor has AVX2.
        return unsafe { trace_all_avx2(transport, paths, radiance) };
    }
    trace_levels(transport, paths, radiance)
}

/// Paths that may split, one after the other: their copies would not fit a pool of fixed size.
fn trace_each(transport: &Transport, paths: &[u32], radiance: &mut [Vec3]) -> u64 {
    let traced = paths.iter().zip(radiance).map(|(&path, radiance)| {
        let (sum, rays) = transport.trace(path);
        *radiance = sum;
        u64::from(rays)
    });
    traced.sum()
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn trace_all_avx2(transport: &Transport, paths: &[u32], radiance: &mut [Vec3]) -> u64 {
    trace_levels(transport, paths, radiance)
}

/// Without a guide, a copy that the compiler knows to be without one.
#[inline(always)]
fn trace_levels(transport: &Transport, paths: &[u32], radiance: &mut [Vec3]) -> u64 {
    match transport.guidance {
        None => levels(&Transport { guidance: None, ..*transport }, paths, radiance),
        Some(_) => levels(transport, paths, radiance),
    }
}

#[inline(always)]
fn levels(transport: &Transport, paths: &[u32], radiance: &mut [Vec3]) -> u64 {
    let mut flights = [Flight::default(); POOL];
    let mut lanes = [RayLanes::default(); POOL / TOGETHER];
    let mut shadows = [Waiting::default(); POOL];
    let mut shadow_lanes = [<(RayLanes, ShadowEnds)>::default(); POOL / TOGETHER];
    let mut hits = [[None::<Hit>; TOGETHER]; POOL / TOGETHER];
    let (mut live, mut rays) = (0, 0);
    let mut fresh = paths.iter().enumerate();
    loop {
        for (place, &path) in fresh.by_ref().take(POOL - live) {
            let ray = transport.generate(path);
            lanes[live / TOGETHER].set(live % TOGETHER, ray_of(&ray));
            flights[live] = Flight { ray, trail: Trail::default(), place };
            live += 1;
        }
        if live == 0 {
            return rays;
        }
        rays += live as u64;

        for (i, hits) in hits.iter_mut().enumerate().take(live.div_ceil(TOGETHER)) {
            let count = TOGETHER.min(live - i * TOGETHER);
            *hits = transport.search.intersect_eight(&lanes[i], count);
        }

        let (mut kept, mut waiting) = (0, 0);
        for i in 0..live {
            let Flight { ray, trail, place } = flights[i];
            let Some(hit) = hits[i / TOGETHER][i % TOGETHER] else {
                let value = transport.environment_value(&ray, &trail);
                transport.learn(&Transition { slot: trail.slot, value, ..Default::default() });
                radiance[place] += transport.environment(&ray);
                continue;
            };
            let shaded = transport.shade(&ray, &trail, hit);
            transport.learn(&shaded.transition);
            radiance[place] += shaded.emitted;
            if let Some(shadow) = shaded.shadow {
                let (rays, ends) = &mut shadow_lanes[waiting / TOGETHER];
                rays.set(waiting % TOGETHER, Ray { origin: shadow.origin, direction: shadow.direction });
                ends.set(waiting % TOGETHER, shadow.t_max, shadow.light_shape);
                let (radiance, value) = (shadow.radiance, shaded.shadow_value);
                shadows[waiting] = Waiting { radiance, slot: trail.slot, value, place };
                waiting += 1;
            }
            if let Some(ray) = shaded.ray {
                lanes[kept / TOGETHER].set(kept % TOGETHER, ray_of(&ray));
                flights[kept] = Flight { ray, trail: shaded.trail, place };
                kept += 1;
            }
        }
        live = kept;

        for (shadows, (rays, ends)) in shadows[..waiting].chunks(TOGETHER).zip(&shadow_lanes) {
            let blocked = transport.search.occluded_eight(rays, ends, shadows.len());
            for (i, waiting) in shadows.iter().enumerate() {
                if blocked >> i & 1 == 0 {
                    let Waiting { slot, value, .. } = *waiting;
                    transport.learn(&Transition { slot, value, ..Default::default() });
                    radiance[waiting.place] += waiting.radiance;
                }
            }
        }
    }
}

#[inline(always)]
fn ray_of(item: &RayItem) -> Ray {
    Ray { origin: item.origin, direction: item.direction }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::accel::Search;
    use crate::random::Sampler;
    use crate::scene::Scene;
    use crate::scene::compiled::CompiledScene;
    use crate::transport::roulette::Roulette;

    #[test]
    fn many_paths_at_a_time_bring_what_each_brings_alone_bit_for_bit() {
        for name in ["cornell-box", "bansal-room-1", "glossy-box", "furnace-open-half", "many-lights"] {
            let described = Scene::load(format!("scenes/{name}.toml")).unwrap();
            let scene = CompiledScene::new(&described);
            let search = Search::new(&scene);
            let mut uniforms = scene.uniforms(&described.camera, 16, 12, 9);
            (uniforms.max_bounces, uniforms.pixel_count, uniforms.sample_count) = (64, 16 * 12, 3);
            uniforms.roulette_scale = 1.0;
            for (direct_light, roulette) in [(true, Roulette::Off), (false, Roulette::Throughput)] {
                let transport = Transport {
                    sampler: Sampler::Stratified,
                    direct_light: direct_light && scene.has_light_to_sample(),
                    roulette,
                    ..Transport::plain(&scene, &search, &uniforms)
                };
                // In an order of their own, and not a multiple of what fits.
                let paths: Vec<u32> = (0..555).map(|i| i * 7 % 555).collect();
                let alone: Vec<_> = paths.iter().map(|&path| transport.trace(path)).collect();
                let alone_rays: u64 = alone.iter().map(|(_, rays)| u64::from(*rays)).sum();
                for trace in [trace_all, trace_levels] {
                    let mut radiance = vec![Vec3::ZERO; paths.len()];
                    assert_eq!(trace(&transport, &paths, &mut radiance), alone_rays, "{name}");
                    for (i, (together, (alone, _))) in radiance.iter().zip(&alone).enumerate() {
                        let (together, alone) = (together.to_array(), alone.to_array());
                        assert_eq!(together.map(f32::to_bits), alone.map(f32::to_bits), "{name}, path {i}");
                    }
                    assert!(radiance.iter().any(|r| r.max_element() > 0.0));
                }
            }
        }
    }
}

//! How long work may take at most, before any was timed: what the first submission goes by. By the times of an H100
//! (docs/PERFORMANCE.md) and by how much slower another adapter may be.

use crate::gpu::device::AdapterSummary;
use crate::gpu::key::KernelKey;
use crate::scene::compiled::CompiledScene;
use crate::transport::roulette::Roulette;

/// Nanoseconds for a ray's shading and for each shape that it asks, its shadow ray's too, on an H100: so many that shipped
/// scenes were measured to take 0.2 to 0.5 of the sum.
const SHADING: f64 = 0.03;
const SHAPE_TEST: f64 = 0.003;
/// … for each of what stands for a walk through the hierarchy ([`CompiledScene::tests_per_ray`]), which reads memory.
const WALK_TEST: f64 = 0.006;
/// … for a ray's way through queues: 344 bytes (docs/KERNELS.md) at three quarters of the 3 TB/s that a copy reaches.
const QUEUES: f64 = 0.15;
/// How many times as long a ray may take that asks a table and teaches it, a guess: two walks through trees and two sums.
const LEARNING: f64 = 4.0;

/// How many times slower than an H100 with its 67 TFLOP/s other GPUs are taken to be at most, by kind: discrete ones have
/// 2.2 TFLOP/s then, integrated ones a third of one.
const SLOWEST_DISCRETE: f64 = 30.0;
const SLOWEST_INTEGRATED: f64 = 200.0;
/// Lavapipe on two cores takes 7000 times as long (cornell-box, 64 levels, direct light); they may be shared.
const SLOWEST_SOFTWARE: f64 = 14_000.0;

/// Seconds that the first submission may take on the slowest adapter of its kind, if every path is as long as is reckoned
/// with. Drivers on laptops reset a GPU that is busy for about two. On an H100 it is 13 ms at most.
const FIRST_SECONDS: f64 = 0.4;
/// Levels of a path on average, where roulette is played: shipped scenes have 1.2 to 10.5, but for a furnace that absorbs a
/// hundredth (48), where the first submission takes three times as long as reckoned with, if it takes that.
const LEVELS_WITH_ROULETTE: u32 = 16;

/// The most time that rays of a scene may take on an adapter.
#[derive(Clone, Copy, Debug)]
pub struct Workload {
    /// Of a ray and its shadow ray.
    ray_seconds: f64,
    /// Of its way through queues.
    queue_seconds: f64,
    /// Levels of a path.
    levels: u32,
}

impl Workload {
    pub fn new(scene: &CompiledScene, key: &KernelKey, max_bounces: u32, adapter: &AdapterSummary) -> Self {
        let tests = scene.tests_per_ray() as f64 * if key.direct_light { 2.0 } else { 1.0 };
        let each = if key.bvh.is_some() { WALK_TEST } else { SHAPE_TEST };
        let learning = if key.guide.is_some() { LEARNING } else { 1.0 };
        let slowness = match (adapter.software, adapter.integrated) {
            (true, _) => SLOWEST_SOFTWARE,
            (_, true) => SLOWEST_INTEGRATED,
            _ => SLOWEST_DISCRETE,
        };
        // Learnt roulette lets paths go on, as copies even, where they are worth it.
        let shortened = key.roulette == Roulette::Throughput;
        Workload {
            ray_seconds: 1e-9 * slowness * learning * (SHADING + each * tests),
            queue_seconds: 1e-9 * slowness * QUEUES,
            levels: if shortened { max_bounces.min(LEVELS_WITH_ROULETTE) } else { max_bounces } * key.places,
        }
    }

    /// Paths of a first submission that traces them to their ends.
    pub fn first_paths(&self) -> u64 {
        (FIRST_SECONDS / (self.ray_seconds * f64::from(self.levels))).max(1.0) as u64
    }

    /// Rays of a first submission that visits them in queues, each time for so many levels of their paths.
    pub fn first_rays(&self, levels: u32) -> u64 {
        (FIRST_SECONDS / (self.ray_seconds + self.queue_seconds / f64::from(levels))).max(1.0) as u64
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Scene;
    use crate::engine::RenderOptions;

    /// What is reckoned with for a shipped scene, on a discrete GPU, an integrated one, and software.
    fn workloads(file: &str, change: impl Fn(&mut RenderOptions)) -> [Workload; 3] {
        let path = format!("{}/scenes/{file}.toml", env!("CARGO_MANIFEST_DIR"));
        let scene = Scene::load(path).expect("a shipped scene loads");
        let mut options = RenderOptions::default();
        change(&mut options);
        let estimators = options.estimators(&scene);
        let compiled = CompiledScene::new(&scene);
        let key = KernelKey::new(&compiled, &estimators);
        [(false, false), (true, false), (false, true)].map(|(integrated, software)| {
            let adapter = AdapterSummary {
                name: String::new(),
                driver: String::new(),
                backend: String::new(),
                software,
                integrated,
                max_binding: 1 << 30,
                max_buffer: 1 << 30,
                timestamps: true,
            };
            Workload::new(&compiled, &key, estimators.max_bounces, &adapter)
        })
    }

    /// Nanoseconds of a ray on an H100, by GPU ms, million paths and rays a path of docs/PERFORMANCE.md.
    #[test]
    fn no_scene_takes_longer_than_is_reckoned_with() {
        let measured = [
            ("cornell-box", 6.71, 19.66, 5.2),
            ("bansal-room-5", 51.6, 19.66, 55.4),
            ("door-ajar", 147.7, 19.66, 61.5),
            ("glass-shelf", 94.3, 19.66, 41.6),
        ];
        for (file, ms, paths, rays) in measured {
            let [discrete, ..] = workloads(file, |o| o.direct_light = Some(true));
            let ratio = ms / (paths * rays) / (1e9 * discrete.ray_seconds / SLOWEST_DISCRETE);
            assert!(ratio > 0.2 && ratio < 0.6, "{file}: {ratio} of what is reckoned with");
        }
        let [walk, ..] = workloads("many-lights", |o| o.light_tree = Some(true));
        let ratio = 56.9 / (19.66 * 4.2) / (1e9 * walk.ray_seconds / SLOWEST_DISCRETE);
        assert!(ratio > 0.2 && ratio < 0.6, "many-lights: {ratio} of what is reckoned with");
    }

    /// What the slowest adapter of a kind takes for the first submission, if paths are as long as they are.
    #[test]
    fn the_first_submission_is_large_but_safe() {
        let [discrete, integrated, software] = workloads("cornell-box", |_| ());
        assert!(discrete.first_paths() >= 640 * 480 * 16, "{}", discrete.first_paths());
        let seconds = |w: &Workload, rays: f64| w.first_paths() as f64 * rays * w.ray_seconds;
        for workload in [discrete, integrated, software] {
            assert!(seconds(&workload, 2.7) < 0.1 && seconds(&workload, 16.0) <= FIRST_SECONDS);
        }
        let [all_levels, ..] = workloads("cornell-box", |o| o.roulette = Some(Roulette::Off));
        assert_eq!(discrete.first_paths() / all_levels.first_paths(), 4, "64 levels for 16");
        assert!(software.first_paths() < integrated.first_paths());
        assert!(integrated.first_paths() < discrete.first_paths());
    }

    #[test]
    fn what_takes_longer_is_submitted_in_smaller_parts() {
        let [plain, ..] = workloads("cornell-box", |_| ());
        let [guided, ..] = workloads("cornell-box", |o| o.guide.mode = crate::guiding::GuideMode::Adaptive);
        let [walk, ..] = workloads("many-lights", |_| ());
        for slower in [guided, walk] {
            assert!(slower.first_paths() < plain.first_paths() / 2);
            assert!(slower.first_rays(2) < plain.first_rays(2));
        }
        assert!(plain.first_rays(1) < plain.first_rays(2), "each visit costs a way through the queues");
        assert!(plain.first_rays(2) >= (6 * 2) << 22, "6 levels of the pool: {}", plain.first_rays(2));
    }
}

//! Which GPU engine `auto` takes, and which schedule the wavefront. By what was measured on an H100 (benches/results/, docs/PERFORMANCE.md), not by taste.

use super::{EngineKind, RenderOptions};
use crate::gpu::key::KernelKey;
use crate::gpu::stage::Schedule;
use crate::scene::compiled::{CompiledScene, KIND_DIFFUSE, KIND_ROUGH_DIELECTRIC};

/// Shape tests per level from which on the wavefront is faster: by then its queues' traffic hides behind them, and the
/// megakernel loses more to invocations that wait for each other.
const MANY_TESTS: usize = 64;
/// Kinds of materials from which on a kernel for each pays, where there are meshes.
const MANY_KINDS: u32 = 3;

/// The engine that is faster for this scene: the megakernel up to 63 shape tests a level, and where invocations do much alike
/// whatever they meet: everything diffuse, nothing textured or smoothed, no tree of lights (1.02 to 1.42 times as fast as the
/// fused schedule on the shipped scenes that it is taken for; door-ajar 1.06, guided 1.11; mesh 1.08). Else the wavefront
/// (fused: glass-shelf 1.05, many-lights 1.07, surfaces 1.02; streamed: interior 1.29, the chess model 1.33, still-life 1.50
/// times as fast, at commit dad6cce). Rough glass, whose shading takes longer than what its neighbours do, and environment
/// maps, which are searched in memory, always go to the wavefront (rough-glass 1.09, open-sky 1.03, by those scenes alone).
/// docs/PERFORMANCE.md.
///
/// Options that only the wavefront knows imply it.
pub fn preferred_engine(scene: &CompiledScene, key: &KernelKey, options: &RenderOptions) -> EngineKind {
    if options.schedule.is_some() || options.pool.is_some() {
        return EngineKind::Wavefront;
    }
    let tests = scene.tests_per_ray() * if key.direct_light { 2 } else { 1 };
    let uneven = key.kinds[KIND_ROUGH_DIELECTRIC as usize] || key.environment_map;
    let diffuse = key.kinds[KIND_DIFFUSE as usize] && key.material_queues() == 1;
    let plain = !key.textures && !key.smooth && !key.light_tree;
    if (tests < MANY_TESTS || diffuse && plain) && !uneven {
        EngineKind::Megakernel
    } else {
        EngineKind::Wavefront
    }
}

/// The schedule for which the caller did not ask: `Streamed` for meshes of several materials, where the fused kernel waits for
/// the longest of many walks and for materials that its neighbours do not have; else `Fused`, whose rays travel less.
/// Milliseconds on an H100, 640 × 480 × 64, megakernel, fused, streamed, compacted:
///
/// | scene (kinds of materials) | megakernel | fused | streamed | compacted |
/// |---|---|---|---|---|
/// | still-life (7) | 99.0 | 79.7 | 66.1 | 71.3 |
/// | interior (7) | 38.3 | 35.9 | 29.6 | 34.0 |
/// | chess model (3) | 42.3 | 37.3 | 31.7 | 33.3 |
/// | glass-shelf (4, no mesh; neither roulette nor direct light) | 94.3 | 91.3 | 134.1 | 188.3 |
///
/// With a guide, too (`interior`, 4 s: 7296 samples streamed, 4224 fused). A grain is a number of levels of the fused kernel.
pub fn preferred_schedule(key: &KernelKey, options: &RenderOptions) -> Schedule {
    let walks_differ = key.triangles && key.material_queues() >= MANY_KINDS;
    let usual = if walks_differ && options.grain.is_none() { Schedule::Streamed } else { Schedule::Fused };
    options.schedule.unwrap_or(usual)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Scene;
    use crate::guiding::GuideMode;

    /// The schedule for a shipped scene.
    fn schedule(file: &str, change: impl FnOnce(&mut RenderOptions)) -> Schedule {
        let path = format!("{}/scenes/{file}", env!("CARGO_MANIFEST_DIR"));
        let scene = Scene::load(path).expect("a shipped scene loads");
        let mut options = RenderOptions::default();
        change(&mut options);
        let key = KernelKey::new(&CompiledScene::new(&scene), &options.estimators(&scene));
        preferred_schedule(&key, &options)
    }

    #[test]
    fn few_shapes_and_plain_diffuse_ones_go_to_the_megakernel_but_for_rough_glass() {
        let engine = |file: &str| {
            let path = format!("{}/scenes/{file}", env!("CARGO_MANIFEST_DIR"));
            let scene = Scene::load(path).expect("a shipped scene loads");
            let (options, compiled) = (RenderOptions::default(), CompiledScene::new(&scene));
            let key = KernelKey::new(&compiled, &options.estimators(&scene));
            preferred_engine(&compiled, &key, &options)
        };
        let few = ["cornell-box.toml", "bansal-room-5.toml", "metal-spheres.toml", "glass-caustic.toml"];
        for file in few.into_iter().chain(["door-ajar.toml", "mesh.toml"]) {
            assert_eq!(engine(file), EngineKind::Megakernel, "{file}");
        }
        for file in [
            "rough-glass.toml",
            "open-sky.toml",
            "many-lights.toml",
            "surfaces.toml",
            "still-life.toml",
            "glass-shelf.toml",
        ] {
            assert_eq!(engine(file), EngineKind::Wavefront, "{file}");
        }
    }

    #[test]
    fn meshes_of_several_materials_stream() {
        for file in ["still-life.toml", "interior.toml", "models/chess.glb"] {
            assert_eq!(schedule(file, |_| ()), Schedule::Streamed, "{file}");
        }
        for file in ["cornell-box.toml", "glass-shelf.toml", "mesh.toml", "rough-glass.toml"] {
            assert_eq!(schedule(file, |_| ()), Schedule::Fused, "{file}");
        }
    }

    #[test]
    fn what_the_caller_says_decides() {
        let file = "interior.toml";
        assert_eq!(schedule(file, |o| o.schedule = Some(Schedule::Compacted)), Schedule::Compacted);
        assert_eq!(schedule(file, |o| o.grain = Some(4)), Schedule::Fused);
        assert_eq!(schedule(file, |o| o.guide.mode = GuideMode::Adaptive), Schedule::Streamed);
    }
}

//! A queue that runs over is an error that names it. No right kernel lets one run over, so wrong ones are linked here.

use super::*;
use crate::engine::Engine;
use crate::film::Film;
use crate::gpu::link::{MODULES, link_modules};
use crate::gpu::stage::Schedule;
use crate::guiding::GuideMode;
use crate::scene::Scene;
use crate::transport::estimators::Estimators;

/// Renders with `stage` linked from sources in which queues end at 20 rays. The message, or None if all went well.
fn overflow(scene: &str, schedule: Schedule, stage: Stage, limit: &str) -> Option<String> {
    let path = format!("{}/scenes/{scene}.toml", env!("CARGO_MANIFEST_DIR"));
    let scene = Scene::load(path).expect("the scene loads");
    let compiled = CompiledScene::new(&scene);
    let uniforms = Uniforms { max_bounces: 8, ..compiled.uniforms(&scene.camera, 16, 16, 1) };
    let key = KernelKey::new(&compiled, &Estimators { direct_light: true, ..Default::default() });
    let adapter = std::env::var("QTRACER_TEST_ADAPTER").ok();
    let gpu = Gpu::open(adapter.as_deref()).expect("GPU tests need an adapter: run tests/run");
    let options = RenderOptions { schedule: Some(schedule), ..Default::default() };
    let mut engine = WavefrontEngine::new(gpu, &compiled, uniforms, Keys { own: key, plain: None }, &options)
        .expect("the engine starts");

    let (from, to) = ("slot >= uniforms.capacity", format!("slot >= {limit}"));
    assert!(MODULES.iter().any(|(_, text)| text.contains(from)));
    let modules: Vec<(&str, String)> =
        MODULES.iter().map(|(name, text)| (*name, text.replace(from, &to))).collect();
    let modules: Vec<(&str, &str)> = modules.iter().map(|(name, text)| (*name, text.as_str())).collect();
    let wgsl = link_modules(&modules, stage, &key, schedule).expect("the sabotaged kernel links");
    let kernel = engine.gpu.gpu.kernel(&stage.name(), &wgsl).expect("the sabotaged kernel compiles");
    engine.gpu.kernels.insert(stage, kernel);

    let mut film = Film::new(16, 16);
    let outcome = engine.render(0..1, &mut film, &CancelToken::default());
    if outcome.is_err() {
        assert_eq!(film.samples(), (0, 0), "a batch that lost rays was used");
    }
    outcome.err().map(|error| error.to_string())
}

#[test]
fn a_queue_that_runs_over_is_an_error_that_names_it() {
    let cases = [
        ("cornell-box", Schedule::Fused, Stage::Step, "survivors"),
        ("cornell-box", Schedule::Compacted, Stage::Compact, "survivors"),
        ("cornell-box", Schedule::Streamed, Stage::Intersect, "diffuse hits"),
        ("furnace-open-half", Schedule::Streamed, Stage::Intersect, "environment"),
        ("bansal-room-1", Schedule::Compacted, Stage::Shade(0), "shadows"),
    ];
    for (scene, schedule, stage, queue) in cases {
        let message = overflow(scene, schedule, stage, "20u").unwrap_or_default();
        assert!(message.contains("queue overflow") && message.contains(queue), "{stage:?}: \"{message}\"");
        assert_eq!(
            overflow(scene, schedule, stage, "uniforms.capacity"),
            None,
            "{stage:?} is right as it is"
        );
    }
}

/// A scene that no binding holds is an error that says so, before anything of it is copied.
#[test]
fn a_scene_beyond_the_adapter_is_refused() {
    let adapter = std::env::var("QTRACER_TEST_ADAPTER").ok();
    let mut gpu = Gpu::open(adapter.as_deref()).expect("GPU tests need an adapter: run tests/run");
    gpu.summary.max_binding = 1 << 20;
    let scene = Scene::load(format!("{}/scenes/mesh.toml", env!("CARGO_MANIFEST_DIR"))).expect("it loads");
    let compiled = CompiledScene::new(&scene);
    let key = KernelKey::new(&compiled, &Estimators { direct_light: true, ..Default::default() });
    let uniforms = compiled.uniforms(&scene.camera, 16, 16, 1);
    let keys = Keys { own: key, plain: None };
    let engine = WavefrontEngine::new(gpu, &compiled, uniforms, keys, &RenderOptions::default());
    let message = engine.err().expect("11 MB in one").to_string();
    assert!(message.contains("binds at most 1048576 bytes, but the scene needs 11"), "{message}");
}

/// Queues of the largest pool fit into the adapter's largest binding, with and without what a path remembers.
#[test]
fn the_largest_pool_fits_the_adapter() {
    let scene =
        Scene::load(format!("{}/scenes/cornell-box.toml", env!("CARGO_MANIFEST_DIR"))).expect("it loads");
    let compiled = CompiledScene::new(&scene);
    for guide in [GuideMode::Off, GuideMode::Adaptive] {
        let estimators = Estimators { direct_light: true, guide, ..Default::default() };
        let key = KernelKey::new(&compiled, &estimators);
        let adapter = std::env::var("QTRACER_TEST_ADAPTER").ok();
        let gpu = Gpu::open(adapter.as_deref()).expect("GPU tests need an adapter: run tests/run");
        let options = RenderOptions { pool: Some(1 << 26), ..Default::default() };
        let uniforms = compiled.uniforms(&scene.camera, 16, 16, 1);
        let engine = WavefrontEngine::new(gpu, &compiled, uniforms, Keys { own: key, plain: None }, &options)
            .expect("the engine starts");
        let largest = Batch { first_pixel: 0, pixel_count: 1 << 30, first_sample: 0, sample_count: 1 };
        let bytes = u64::from(engine.capacity(&largest)) * engine.ray_bytes();
        assert!(bytes <= engine.gpu.gpu.summary.max_binding, "{guide}: {bytes}");
    }
}

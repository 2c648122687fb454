//! The kernels as text: they link for every key, are valid, have the layouts that Rust has, and hold only what is needed.

use qtracer::gpu::key::KernelKey;
use qtracer::gpu::link::link;
use qtracer::gpu::stage::{Schedule, Stage};
use qtracer::scene::compiled::CompiledScene;
use qtracer::{Sampler, Scene};

const SCHEDULES: [Schedule; 3] = [Schedule::Compacted, Schedule::Streamed, Schedule::Fused];

fn scene(name: &str) -> Scene {
    Scene::load(format!("scenes/{name}.toml")).unwrap()
}

fn validate(wgsl: &str) -> naga::Module {
    let module = naga::front::wgsl::parse_str(wgsl)
        .unwrap_or_else(|e| panic!("{}\n{wgsl}", e.emit_to_string(wgsl)));
    naga::valid::Validator::new(naga::valid::ValidationFlags::all(), naga::valid::Capabilities::empty())
        .validate(&module)
        .unwrap_or_else(|e| panic!("{}\n{wgsl}", e.emit_to_string(wgsl)));
    module
}

fn all_stages(key: &KernelKey) -> Vec<(Stage, Schedule)> {
    let mut stages: Vec<_> = Stage::megakernel().into_iter().map(|s| (s, Schedule::Fused)).collect();
    for schedule in SCHEDULES {
        stages.extend(Stage::wavefront(key, schedule).into_iter().map(|s| (s, schedule)));
    }
    stages
}

#[test]
fn every_stage_links_and_validates_for_every_kind_of_scene() {
    for name in ["cornell-box", "bansal-room-1", "furnace-open", "glass-caustic", "glossy-box"] {
        let compiled = CompiledScene::new(&scene(name));
        for direct_light in [false, true] {
            for roulette in [false, true] {
                for sampler in [Sampler::Independent, Sampler::Stratified] {
                    let key = KernelKey::new(&compiled, direct_light, roulette, sampler);
                    for (stage, schedule) in all_stages(&key) {
                        validate(&link(stage, &key, schedule).unwrap());
                    }
                }
            }
        }
    }
}

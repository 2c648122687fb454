//! Intersection and leaving of shapes, by the kernels themselves on the adapter under test and by their twins on the CPU,
//! against geometry in f64. `cargo test … -- --nocapture` shows the worst errors measured, which docs/ACCURACY.md lists.

mod edges;
pub mod hierarchy;
mod leaving;
mod quads;
mod rectangles;
mod spheres;
mod twins;

use crate::probe::{Input, Numbers, Probe};
use crate::support::estimators;
use glam::DVec3;
use qtracer::gpu::device::Gpu;
use qtracer::gpu::key::KernelKey;
use qtracer::guiding::GuideMode;
use qtracer::scene::compiled::CompiledScene;
use qtracer::scene::rows::{self, Row};
use qtracer::scene::{Camera, Material as SceneMaterial, Scene, SceneBuilder};
use qtracer::transport::roulette::Roulette;
use wgpu::BufferUsages;

pub fn key(scene: &CompiledScene) -> KernelKey {
    KernelKey::new(scene, &estimators(GuideMode::Off, Roulette::Off))
}

/// Asks a probe that reads shapes of this scene.
pub fn ask<const Q: usize, const A: usize>(
    gpu: &Gpu,
    probe: &Probe<Q, A>,
    scene: &CompiledScene,
    hot: &[Row],
    questions: &[[Row; Q]],
) -> Vec<[Row; A]> {
    // Any: no test looks through it.
    let camera = Camera {
        origin: DVec3::ZERO,
        target: DVec3::NEG_Z,
        up: DVec3::Y,
        fov_y_deg: 45.0,
        width: 1,
        height: 1,
    };
    let uniforms = scene.uniforms(&camera, 1, 1, 0);
    let packed = rows::pack(scene);
    let inputs: [Input<'_>; 3] = [
        ("uniforms", bytemuck::bytes_of(&uniforms), BufferUsages::UNIFORM),
        ("scene_rows", bytemuck::cast_slice(&packed), BufferUsages::STORAGE),
        ("hot_rows", bytemuck::cast_slice(hot), BufferUsages::UNIFORM),
    ];
    probe.ask(gpu, &inputs, questions)
}

/// A unit vector at right angles to `n`.
fn tangent(numbers: &mut Numbers, n: DVec3) -> DVec3 {
    let d = numbers.direction();
    (d - n * d.dot(n)).normalize()
}

/// A scene to add shapes of material "m" to.
fn empty() -> SceneBuilder {
    let builder = Scene::builder("shapes").camera([0.0, 0.0, 1.0], [0.0; 3], 40.0);
    builder.material("m", SceneMaterial::diffuse([0.5; 3]))
}

//! Meshes that are stored once and seen in many places: the same picture as if each instance had triangles of its own, in the
//! memory of one.

mod files;
mod images;
mod walks;

use crate::probe::Numbers;
use crate::support::icosphere;
use glam::{DAffine3, DMat3, DQuat, DVec3};
use qtracer::scene::compiled::CompiledScene;
use qtracer::scene::{Instancing, Material, MeshData, Scene, SceneBuilder};

/// A closed, dented ball of 20 · 4^levels triangles, of size 1 about.
fn rock(numbers: &mut Numbers, levels: u32) -> MeshData {
    let mut data = icosphere(levels);
    data.positions.iter_mut().for_each(|p| *p *= numbers.between(0.8, 1.2));
    data
}

/// Any turn.
fn turn(numbers: &mut Numbers) -> DMat3 {
    DMat3::from_quat(DQuat::from_axis_angle(numbers.direction(), numbers.between(0.0, 6.3)))
}

/// Turned and scaled, the same on all axes or not, sheared or mirrored by chance; within `half` of the origin.
fn somewhere(numbers: &mut Numbers, sizes: [f64; 2], half: f64) -> DAffine3 {
    let mut size = || numbers.of_any_size(sizes[0], sizes[1]);
    let even = DVec3::splat(size());
    let uneven = DVec3::new(size(), size(), size());
    let scale = [even, uneven][numbers.below(2)];
    let mirror = DVec3::new(numbers.sign(), 1.0, 1.0);
    let mut matrix = turn(numbers) * DMat3::from_diagonal(scale * mirror);
    if numbers.below(2) == 0 {
        matrix *= turn(numbers);
    }
    DAffine3 { matrix3: matrix, translation: numbers.in_box(half) }
}

/// What both ways of storing it make of a scene.
fn both(scene: &Scene) -> [CompiledScene; 2] {
    [Instancing::Shared, Instancing::LaidOut].map(|how| CompiledScene::with_instances(scene, how))
}

/// A scene under a white sky, with two materials.
fn under_a_sky(eye: [f64; 3], target: [f64; 3]) -> SceneBuilder {
    Scene::builder("rocks")
        .camera(eye, target, 40.0)
        .size(24, 18)
        .environment([0.6, 0.8, 1.0])
        .material("grey", Material::diffuse([0.5; 3]))
        .material("red", Material::diffuse([0.8, 0.1, 0.1]))
        .material("metal", Material::metal([0.9, 0.8, 0.6], 0.3))
}

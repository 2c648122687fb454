//! Instances out of files: which are shared, what that takes, and what is refused.

use super::{rock, under_a_sky};
use crate::models::builder::{Gltf, Place};
use crate::probe::Numbers;
use crate::support::*;
use glam::{DAffine3, DVec3};
use qtracer::RenderError;
use qtracer::gpu::key::KernelKey;
use qtracer::guiding::GuideMode;
use qtracer::scene::compiled::CompiledScene;
use qtracer::scene::sharing::{MOST_WASTED, shared_bytes};
use qtracer::scene::{Geometry, Instancing, Material, MeshData, Scene, rows};
use qtracer::transport::roulette::Roulette;
use qtracer::{RenderOptions, Renderer};
use serde_json::json;
use std::fmt::Write;

fn instances(scene: &Scene) -> usize {
    scene.shapes.iter().filter(|shape| matches!(shape.geometry, Geometry::Instance(_))).count()
}

/// A file of a ball of 20 · 4^levels triangles.
fn ball(levels: u32) -> Gltf {
    let (mut file, data) = (Gltf::new(), icosphere(levels));
    let corners: Vec<[f32; 3]> = data.positions.iter().map(|p| p.as_vec3().to_array()).collect();
    let (positions, indices) = (file.positions(&corners), file.indices(&data.triangles));
    file.mesh(json!({ "attributes": { "POSITION": positions }, "indices": indices }));
    file
}

#[test]
fn nodes_of_a_gltf_file_share_their_mesh_where_it_is_large() {
    // 5,120 triangles at each of five places: 20,480 are spared.
    let mut file = ball(4);
    for x in 0..5 {
        file.stand(json!({ "mesh": 0, "translation": [3 * x, 0, 0], "scale": [1, -1, 0.5] }));
    }
    let scene = file.scene();
    assert_eq!((instances(&scene), scene.triangle_count()), (5, 5 * 5120));
    let [low, high] = scene.shapes[4].geometry.mesh_bounds().unwrap();
    assert!(
        (low.x - 11.0).abs() < 0.05 && (high.x - 13.0).abs() < 0.05 && (high.z - 0.5).abs() < 0.05,
        "{low} {high}"
    );
    // One without area is left out, and so many that are small have triangles of their own.
    file.stand(json!({ "mesh": 0, "scale": [1, 0, 0] }));
    let scene = file.scene();
    assert_eq!((instances(&scene), scene.shapes.len()), (5, 5));
    assert!(scene.warnings().iter().any(|w| w.to_string().contains("has no area where it stands")));
    let mut small = ball(2);
    for x in 0..5 {
        small.stand(json!({ "mesh": 0, "translation": [3 * x, 0, 0] }));
    }
    assert_eq!(instances(&small.scene()), 0);
    // What shines is no instance.
    file.add("materials", json!({ "emissiveFactor": [1, 1, 1] }));
    file.json["meshes"][0]["primitives"][0]["material"] = json!(0);
    assert_eq!(instances(&file.scene()), 0);
}

const HEAD: &str = "name = 's'\n[camera]\norigin = [0, 0, 4]\ntarget = [0, 0, 0]\nfov_y_deg = 40\nwidth = 8\nheight = 8\n\
    [environment]\nradiance = [1, 1, 1]\n[materials.a]\ntype = 'diffuse'\ncolor = [1, 0, 0]\n\
    [materials.b]\ntype = 'metal'\ncolor = [1, 1, 1]\nroughness = 0.4\n\
    [materials.lamp]\ntype = 'diffuse'\ncolor = [1, 1, 1]\nemission = [1, 1, 1]\n";

fn obj(data: &MeshData) -> String {
    let mut text = String::new();
    data.positions
        .iter()
        .for_each(|p| writeln!(text, "v {} {} {}", p.x as f32, p.y as f32, p.z as f32).unwrap());
    data.triangles.iter().for_each(|[a, b, c]| writeln!(text, "f {} {} {}", a + 1, b + 1, c + 1).unwrap());
    text
}

/// A file that a scene places often is shared, with the material of each place; what stands once is as it always was.
#[test]
fn a_scene_shares_the_file_that_it_places_often() {
    let place = Place::new();
    place.write("ball.obj", obj(&icosphere(4)));
    place.write("once.obj", obj(&icosphere(5)));
    let mut text = HEAD.to_owned();
    let mut add = |file: &str, material: &str, x: u32| {
        write!(
            text,
            "[[shapes]]\ntype = 'mesh'\nfile = '{file}'\nmaterial = '{material}'\ntranslate = [{x}, 0, 0]\n"
        )
        .unwrap();
    };
    (0..4).for_each(|x| add("ball.obj", ["a", "b"][x as usize % 2], 3 * x));
    add("ball.obj", "lamp", 20);
    add("once.obj", "a", 30);
    let scene = Scene::load(place.write("scene.toml", &text)).unwrap();
    assert_eq!((instances(&scene), scene.shapes.len()), (4, 6));
    let compiled = CompiledScene::with_instances(&scene, Instancing::Shared);
    let kinds: Vec<u32> = compiled.shared.instances.iter().map(|i| i.kind).collect();
    assert_eq!((kinds, compiled.lights.len()), (vec![0, 4, 0, 4], 5120));
    // 4 · 5,120 triangles are little memory.
    assert!(CompiledScene::new(&scene).shared.instances.is_empty());
    assert_ne!(compiled.light_fingerprint(), CompiledScene::new(&scene).light_fingerprint());
    let mut moved = compiled.clone();
    moved.shared.instances[2].translation.x += 1.0;
    assert_ne!(compiled.light_fingerprint(), moved.light_fingerprint(), "fingerprints do not know instances");
}

/// A scene that places a file of 41 million triangles a hundred times is refused before any of them is placed, which would take
/// minutes.
#[test]
fn more_triangles_than_have_numbers_are_refused_before_they_are_placed() {
    let (place, mut file) = (Place::new(), ball(5));
    for x in 0..2000 {
        file.stand(json!({ "mesh": 0, "translation": [3 * x, 0, 0] }));
    }
    place.write("balls.glb", file.glb());
    let mut text = HEAD.to_owned();
    for x in 0..110 {
        write!(text, "[[shapes]]\ntype = 'mesh'\nfile = 'balls.glb'\ntranslate = [0, {x}, 0]\n").unwrap();
    }
    let start = std::time::Instant::now();
    let refused = Scene::load(place.write("scene.toml", &text)).unwrap_err().to_string();
    assert!(refused.contains("brings the scene to 4505600000 triangles, each instance counted"), "{refused}");
    assert!(start.elapsed().as_secs() < 20, "{:?}", start.elapsed());
}

/// A mesh with a triangle of next to no area is laid out where it stands often, and that is told.
#[test]
fn meshes_that_cannot_be_shared_are_told() {
    let place = Place::new();
    let mut data = icosphere(4);
    let first = data.positions.len() as u32;
    data.positions.extend([DVec3::ZERO, DVec3::X, DVec3::new(0.5, 1e-6, 0.0)]);
    data.triangles.push([first, first + 1, first + 2]);
    place.write("ball.obj", obj(&data));
    let mut text = HEAD.to_owned();
    for x in 0..5 {
        write!(
            text,
            "[[shapes]]\ntype = 'mesh'\nfile = 'ball.obj'\nmaterial = 'a'\ntranslate = [{x}, 1000, 0]\n"
        )
        .unwrap();
    }
    let scene = Scene::load(place.write("scene.toml", &text)).unwrap();
    assert_eq!(instances(&scene), 0);
    let warnings: Vec<String> = scene.warnings().iter().map(ToString::to_string).collect();
    assert!(warnings.iter().any(|w| w.contains("can't share its triangles")), "{warnings:?}");
}

/// A thousand places of a mesh of 20,480 triangles: the memory of one, as measured on what a GPU gets.
#[test]
fn a_thousand_instances_take_the_memory_of_one() {
    let places = |count: u32| {
        let at =
            |i: u32| DAffine3::from_translation(DVec3::new(f64::from(i % 32), 0.0, f64::from(i / 32)) * 3.0);
        let scene = under_a_sky([0.0, 0.0, 9.0], [0.0; 3])
            .mesh_in_places(icosphere(5), (0..count).map(|i| (at(i), "grey")));
        CompiledScene::new(&scene.build().unwrap())
    };
    let (one, thousand) = (rows::bytes(&places(1)), places(1000));
    let bytes = rows::bytes(&thousand);
    println!("one: {one} bytes, a thousand: {bytes}");
    assert_eq!((thousand.shape_count(), thousand.shared.instances.len()), (20_480_000, 1000));
    // A row of numbers and a node each.
    assert!(bytes < one + 1000 * 200, "{bytes} for {one}");
    let [shared, laid_out] = shared_bytes(&thousand);
    assert!(shared <= bytes && shared > bytes - 1000 && laid_out == 20_480_000 * 112, "{shared} {laid_out}");
    let stats = qtracer::engine::InstanceStats::new(&thousand).unwrap();
    assert_eq!((stats.meshes, stats.stored_triangles, stats.bytes), (1, 20_480, shared));
}

/// Sharing begins where laying out would waste more than the constant.
#[test]
fn memory_decides_what_is_shared() {
    let triangles = 1280u64;
    let count = |wasted: u64| 1 + wasted / (triangles * 112 - 192);
    let compile = |count: u64, how| {
        let at = |i: u64| (DAffine3::from_translation(DVec3::X * 3.0 * i as f64), "grey");
        let scene = under_a_sky([0.0, 0.0, 9.0], [0.0; 3]).mesh_in_places(icosphere(3), (0..count).map(at));
        CompiledScene::with_instances(&scene.build().unwrap(), how).shared.instances.len() as u64
    };
    let most = count(MOST_WASTED);
    assert_eq!([most, most + 2].map(|count| compile(count, Instancing::Auto)), [0, most + 2]);
    assert_eq!([Instancing::Shared, Instancing::LaidOut].map(|how| compile(3, how)), [3, 0]);
}

#[test]
fn what_has_no_numbers_or_shines_is_refused() {
    let mut scene = under_a_sky([0.0, 0.0, 9.0], [0.0; 3])
        .material("lamp", Material::diffuse([0.0; 3]).emitting([1.0; 3]))
        .mesh_in_places(icosphere(5), [(DAffine3::IDENTITY, "grey"), (DAffine3::IDENTITY, "lamp")])
        .build()
        .unwrap();
    assert_eq!(instances(&scene), 1, "the lamp is no instance");
    let options = RenderOptions { instances: Instancing::LaidOut, ..RenderOptions::cpu() };
    let one = scene.shapes[0].clone();
    // As many as have numbers among instances, but too many to lay out; then too many for either.
    scene.shapes = vec![one.clone(); 60_000];
    let refused = Renderer::new(&scene, options).err().unwrap();
    assert!(matches!(&refused, RenderError::Option { option: "instances", .. }), "{refused}");
    assert!(refused.to_string().contains("1228800000 triangles"), "{refused}");
    assert_eq!(scene.validate(), Ok(()));
    scene.shapes = vec![one; 250_000];
    let refused = scene.validate().unwrap_err().to_string();
    assert!(refused.contains("5120000000 triangles, each instance counted"), "{refused}");
    scene.shapes.truncate(1);
    scene.shapes[0].material = scene.materials.iter().position(|m| m.name == "lamp").unwrap();
    let refused = scene.validate().unwrap_err().to_string();
    assert!(refused.contains("\"lamp\" emits, which instances can't"), "{refused}");
}

/// Scenes without instances link nothing of them.
#[test]
fn without_instances_nothing_of_them_is_linked() {
    let estimators = estimators(GuideMode::Off, Roulette::Throughput);
    let link = |how| {
        let scene = under_a_sky([0.0, 0.0, 9.0], [0.0; 3]).mesh_in_places(
            rock(&mut Numbers(1), 1),
            [(DAffine3::IDENTITY, "grey"), (DAffine3::IDENTITY, "red")],
        );
        let compiled = CompiledScene::with_instances(&scene.build().unwrap(), how);
        let key = KernelKey::new(&compiled, &estimators);
        qtracer::gpu::link::link(qtracer::gpu::stage::Stage::Step, &key, qtracer::gpu::stage::Schedule::Fused)
            .unwrap()
    };
    let [shared, laid_out] = [Instancing::Shared, Instancing::LaidOut].map(link);
    for word in ["nstance", "mesh_frame", "place_"] {
        assert!(shared.contains(word) && !laid_out.contains(word), "{word}");
    }
    assert!(shared.contains("fn place_corner") && !shared.contains("fn place_normal"));
}

//! Pictures of instances on every engine: those of the same triangles laid out.

use super::{rock, somewhere, under_a_sky};
use crate::probe::Numbers;
use crate::support::*;
use glam::{DAffine3, DVec3};
use qtracer::RenderOptions;
use qtracer::guiding::{GuideMode, GuideOptions};
use qtracer::scene::{Instancing, Material, MaterialTextures, MeshData, Scene, Texture, TextureRef};

fn by(how: Instancing, options: &RenderOptions) -> RenderOptions {
    RenderOptions { instances: how, ..options.clone() }
}

/// Rocks of three materials on a floor, under a lamp, some of them mirrored and stretched.
fn grove(data: MeshData) -> Scene {
    let mut numbers = Numbers(9);
    let materials = ["grey", "red", "metal"];
    let place = |i: usize| (somewhere(&mut numbers, [0.3, 0.7], 2.0), materials[i % 3]);
    let places: Vec<_> = (0..12).map(place).collect();
    under_a_sky([0.0, 3.0, 7.0], [0.0; 3])
        .material("lamp", Material::diffuse([0.0; 3]).emitting([9.0; 3]))
        .quad([-5.0, -2.5, -5.0], [0.0, 0.0, 10.0], [10.0, 0.0, 0.0], "grey")
        .sphere([2.0, 4.0, 2.0], 0.5, "lamp")
        .mesh_in_places(data, places)
        .build()
        .unwrap()
}

/// Flat ones: in every bit, on every engine. Negative control: another place of one of them shows.
#[test]
fn pictures_of_flat_instances_are_those_of_laid_out_ones() {
    let scene = grove(rock(&mut Numbers(3), 2));
    let mut moved = scene.clone();
    moved.shapes.pop();
    for engine in ENGINES {
        let options = small(24, 18, 5);
        let shared = render(&scene, engine, &by(Instancing::Shared, &options), 4);
        let laid_out = render(&scene, engine, &by(Instancing::LaidOut, &options), 4);
        assert_eq!(differing_pixels(&shared.film, &laid_out.film), 0, "{engine:?}");
        let stats = shared.stats.instances.unwrap();
        assert_eq!(
            (stats.instances, stats.meshes, stats.stored_triangles, stats.seen_triangles),
            (12, 1, 320, 3840)
        );
        assert!(laid_out.stats.instances.is_none());
        let other = render(&moved, engine, &by(Instancing::Shared, &options), 4);
        assert!(differing_pixels(&shared.film, &other.film) > 5, "{engine:?}: nothing noticed");
    }
}

/// Mean difference of a pixel against the mean brightness.
fn difference(scene: &Scene, engine: Engine, options: &RenderOptions, spp: u32) -> f64 {
    let [shared, laid_out] = [Instancing::Shared, Instancing::LaidOut]
        .map(|how| render(scene, engine, &by(how, options), spp).image);
    let pairs = || shared.rgb.iter().flatten().zip(laid_out.rgb.iter().flatten());
    let apart: f64 = pairs().map(|(a, b)| f64::from((a - b).abs())).sum();
    apart / pairs().map(|(_, b)| f64::from(*b)).sum::<f64>()
}

/// Normals at the corners of a ball, and coordinates that wind around it.
fn smooth_and_textured(levels: u32) -> MeshData {
    let data = rock(&mut Numbers(4), levels);
    let uvs = data.positions.iter().map(|p| [p.x as f32, p.y as f32]).collect();
    MeshData { normals: data.positions.clone(), uvs, ..data }
}

#[test]
fn smooth_instances_look_as_laid_out_ones_do() {
    let scene = grove(smooth_and_textured(2));
    for engine in ENGINES {
        let apart = difference(&scene, engine, &small(24, 18, 6), 8);
        println!("{engine:?}: {apart:e} apart");
        assert!(apart < SMOOTH_APART, "{engine:?}: {apart}");
    }
    let flat = grove(rock(&mut Numbers(4), 2));
    let [a, b] = [&scene, &flat].map(|scene| render(scene, Engine::Cpu, &small(24, 18, 6), 8).image);
    let apart: f64 =
        a.rgb.iter().flatten().zip(b.rgb.iter().flatten()).map(|(a, b)| f64::from((a - b).abs())).sum();
    let apart = apart / a.rgb.iter().flatten().map(|x| f64::from(*x)).sum::<f64>();
    println!("without normals: {apart:e} apart");
    assert!(apart > 1000.0 * SMOOTH_APART, "negative control: normals change nothing: {apart}");
}

/// Of the light in a picture: normals of instances are rounded to 16 bits before they are placed, those laid out behind it.
/// The worst measured is 1.6e-7.
const SMOOTH_APART: f64 = 4e-7;

#[test]
fn textured_instances_are_those_laid_out_in_every_bit() {
    let bytes: Vec<u8> = (0..16u8).flat_map(|i| [i * 15, 255 - i * 15, (i % 4) * 60, 255]).collect();
    let textures = MaterialTextures { color: Some(TextureRef::new(0)), ..Default::default() };
    let mut numbers = Numbers(10);
    let places: Vec<_> = (0..8).map(|_| (somewhere(&mut numbers, [0.4, 0.8], 1.5), "wood")).collect();
    let data = MeshData { normals: Vec::new(), ..smooth_and_textured(2) };
    let scene = under_a_sky([0.0, 2.0, 6.0], [0.0; 3])
        .texture(Texture::new("wood", 4, 4, bytes))
        .material("wood", Material::diffuse([1.0; 3]).textured(textures))
        .mesh_in_places(data, places)
        .build()
        .unwrap();
    for engine in [ENGINES[0], ENGINES[1], ENGINES[3]] {
        assert_eq!(difference(&scene, engine, &small(24, 18, 6), 2), 0.0, "{engine:?}");
    }
}

/// With a guide and learnt roulette, on the CPU and on a GPU: what is learnt is the same too.
#[test]
fn guiding_works_on_instances() {
    let scene = grove(rock(&mut Numbers(3), 1));
    let guide = GuideOptions { mode: GuideMode::Adaptive, ..Default::default() };
    let options = RenderOptions { guide, ..small(16, 12, 7) };
    for engine in [ENGINES[0], ENGINES[1], ENGINES[3], ENGINES[4], ENGINES[5]] {
        let [a, b] = [Instancing::Shared, Instancing::LaidOut]
            .map(|how| render(&scene, engine, &by(how, &options), 16));
        assert_eq!(differing_pixels(&a.film, &b.film), 0, "{engine:?}");
        assert!(a.stats.guide.is_some());
    }
}

/// A camera within a mirrored ball sees the inner sides of its triangles, outside the outer ones: glass shows which.
#[test]
fn mirrored_instances_keep_their_outer_sides() {
    let glass = |mirror: f64| {
        under_a_sky([0.0, 0.0, 4.0], [0.0; 3])
            .material("glass", Material::dielectric([1.0, 0.7, 0.7], 1.5))
            .sphere([0.0, 0.0, -3.0], 1.5, "red")
            .mesh_in_places(icosphere(3), [(DAffine3::from_scale(DVec3::new(mirror, 1.0, 1.0)), "glass")])
            .build()
            .unwrap()
    };
    // The ball is its own mirror image, but for the order of its triangles.
    let options = small(16, 12, 8);
    let mean = |mirror, how| {
        let image = render(&glass(mirror), Engine::Cpu, &by(how, &options), 64).image;
        image.rgb.iter().map(|p| f64::from(p[1])).sum::<f64>() / image.rgb.len() as f64
    };
    let [plain, mirrored, laid_out] =
        [(1.0, Instancing::Shared), (-1.0, Instancing::Shared), (-1.0, Instancing::LaidOut)]
            .map(|(mirror, how)| mean(mirror, how));
    assert_eq!(mirrored, laid_out);
    assert!((mirrored / plain - 1.0).abs() < 0.01, "{mirrored} {plain}");
}

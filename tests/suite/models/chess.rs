//! The model that is shipped, scenes/models/chess.glb, as a user would drop it in.

use super::builder::warnings;
use crate::failing_images::expect_agreement;
use crate::support::*;
use qtracer::Scene;
use qtracer::gpu::stage::Schedule;
use qtracer::scene::MaterialKind;
use qtracer::stats::{ZTestOptions, differences, z_test};
use std::collections::BTreeSet;

fn chess() -> Scene {
    Scene::load(root().join("scenes/models/chess.glb")).unwrap_or_else(|error| panic!("{error}"))
}

#[test]
fn the_shipped_model_loads_whole_and_without_a_warning() {
    let scene = chess();
    assert_eq!(warnings(&scene), [""; 0]);
    assert_eq!((scene.shapes.len(), scene.textures.len()), (20, 2));
    assert_eq!((scene.camera.width, scene.camera.height), (640, 480));
    let kinds: BTreeSet<&str> = scene
        .materials
        .iter()
        .map(|material| match material.kind {
            MaterialKind::MetallicRoughness { metallic: 1.0, .. } => "metal",
            MaterialKind::MetallicRoughness { .. } => "plastic",
            MaterialKind::Dielectric { .. } => "glass",
            MaterialKind::RoughDielectric { .. } => "rough glass",
            _ => "other",
        })
        .collect();
    assert_eq!(kinds, BTreeSet::from(["metal", "plastic", "glass", "rough glass"]));
    // The lamp's factor 1 times its strength 36.
    let brightest = scene.materials.iter().map(|material| material.emission.x).fold(0.0, f64::max);
    assert_eq!(brightest, 36.0);
    let textured: Vec<_> = scene.materials.iter().filter(|material| material.textures.any()).collect();
    let [board] = textured[..] else { panic!("{} materials with textures", textured.len()) };
    assert!(board.textures.color.is_some() && board.textures.metallic_roughness.is_some());
}

/// The same sums from all kernels where the driver neither fuses nor reorders; nearly the same pixels as the CPU's at the same
/// seed; and the same image at another, α = 1e-3.
#[test]
fn the_shipped_model_looks_the_same_on_all_engines() {
    let scene = chess();
    let options = small(32, 24, 3);
    let [cpu, reference] =
        [Engine::Cpu, Engine::Megakernel].map(|engine| render(&scene, engine, &options, 32));
    let found = differences(&reference.image.view(), &cpu.image.view()).unwrap();
    println!("{:.2} % of pixels within 1e-3 of the CPU's", 100.0 * found.share_within_1e3);
    assert!(found.share_within_1e3 >= 0.95, "{found:?}");
    for schedule in SCHEDULES {
        let other = render(&scene, Engine::Wavefront(schedule), &options, 32);
        let close = differences(&other.image.view(), &reference.image.view()).unwrap();
        assert!(close.share_within_1e3 >= 0.95, "{schedule:?}: {close:?}");
        if open_gpu().summary.software {
            assert_eq!(differing_pixels(&reference.film, &other.film), 0, "{schedule:?}");
        }
    }
    let other = render(
        &scene,
        Engine::Wavefront(Schedule::Fused),
        &qtracer::RenderOptions { seed: 4, ..options },
        64,
    );
    let report =
        z_test(&cpu.image.view(), &other.image.view(), &ZTestOptions { alpha: 1e-3, ..Default::default() })
            .unwrap();
    expect_agreement(report.passes, "the chess model, CPU and fused", 4, (&other.image, &cpu.image), &report);
    // Negative control: another seed has other pixels.
    assert!(differences(&other.image.view(), &cpu.image.view()).unwrap().share_within_1e3 < 0.5);
}

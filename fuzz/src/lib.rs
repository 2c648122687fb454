//! What the targets do with what they read: make a scene of it, compile that, render a few pixels.

use std::panic;

use qtracer::scene::compiled::CompiledScene;
use qtracer::scene::{Material, MeshData};
use qtracer::{RenderOptions, Renderer, Scene};

/// Larger scenes are only compiled.
const MOST_RENDERED: usize = 3_000;

/// To be called once, before the first input. Rendering takes one thread.
///
/// A panic in qtracer's own code is a finding even where the library would catch it. Decoders of others may panic where
/// qtracer makes an error of that, so theirs are findings only if nothing catches them.
pub fn prepare() {
    rayon::ThreadPoolBuilder::new().num_threads(1).build_global().expect("called once, before anything else");
    let abort = panic::take_hook();
    let shown = std::env::var_os("FUZZ_SHOW_PANICS").is_some();
    panic::set_hook(Box::new(move |panic| {
        let file = panic.location().map_or("", |location| location.file());
        let own = !file.contains("/registry/") && !file.contains("/rustc/") && !file.contains("/library/");
        if own {
            abort(panic);
        } else if shown {
            eprintln!("{panic}");
        }
    }));
}

/// A scene that was accepted is valid, can be told about, compiled and seen.
pub fn use_scene(scene: &Scene) {
    assert_eq!(scene.validate(), Ok(()), "accepted, yet invalid");
    for warning in scene.warnings() {
        assert!(!warning.to_string().is_empty());
    }
    let shapes = |shape: &qtracer::scene::Shape| shape.geometry.mesh().map_or(1, |mesh| mesh.len());
    let small = scene.shapes.iter().map(shapes).sum::<usize>() <= MOST_RENDERED;
    match small {
        true => render(scene, RenderOptions::cpu()),
        false => drop(CompiledScene::new(scene)),
    }
}

/// Six pixels, one sample each.
pub fn render(scene: &Scene, options: RenderOptions) {
    let options = RenderOptions { size: Some((3, 2)), max_bounces: Some(4), ..options };
    let Ok(mut renderer) = Renderer::new(scene, options) else { return };
    if renderer.step(1).is_ok() {
        assert_eq!(renderer.image().rgb.len(), 6);
    }
}

/// Puts a mesh that was read before a camera, as it is and as a lamp.
pub fn use_mesh(data: MeshData) {
    let lamp = Material::diffuse([0.5; 3]).emitting([1.0; 3]);
    let scene = Scene::builder("mesh")
        .camera([0.0, 1.0, 4.0], [0.0; 3], 45.0)
        .size(3, 2)
        .environment([0.5; 3])
        .material("lamp", lamp)
        .mesh(data, "lamp")
        .build();
    match scene {
        Ok(scene) => use_scene(&scene),
        Err(error) => assert!(!error.to_string().is_empty()),
    }
}

/// A square that fills the view.
pub fn square() -> qtracer::scene::SceneBuilder {
    Scene::builder("square").camera([0.0, 0.0, 2.0], [0.0; 3], 45.0).size(3, 2).environment([0.5; 3]).quad(
        [-1.0, -1.0, 0.0],
        [2.0, 0.0, 0.0],
        [0.0, 2.0, 0.0],
        "grey",
    )
}

//! A scene built in code: a glass ball and a lamp in a room, rendered on whatever the machine has.
//! `cargo run --release --example scene_in_code`

use qtracer::film::{WriteOptions, write_image};
use qtracer::scene::Material;
use qtracer::{RenderOptions, Renderer, Scene};
use std::path::Path;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let scene = Scene::builder("glass ball")
        .camera([0.0, 1.2, 5.0], [0.0, 0.9, 0.0], 40.0)
        .size(320, 240)
        .material("floor", Material::diffuse([0.7, 0.7, 0.7]))
        .material("wall", Material::diffuse([0.2, 0.4, 0.7]))
        .material("glass", Material::dielectric([1.0, 1.0, 1.0], 1.5))
        .material("lamp", Material::diffuse([0.0, 0.0, 0.0]).emitting([12.0, 11.0, 9.0]))
        .quad([-5.0, 0.0, -5.0], [0.0, 0.0, 10.0], [10.0, 0.0, 0.0], "floor")
        .quad([-5.0, 0.0, -2.5], [10.0, 0.0, 0.0], [0.0, 6.0, 0.0], "wall")
        .sphere([0.0, 0.9, 0.0], 0.9, "glass")
        .sphere([1.5, 3.2, 1.0], 0.4, "lamp")
        .build()?;
    for warning in scene.warnings() {
        eprintln!("warning: {warning}");
    }

    let mut renderer = Renderer::new(&scene, RenderOptions::default())?;
    while renderer.samples() < 64 {
        renderer.step(64 - renderer.samples())?;
    }
    write_image(Path::new("glass-ball.png"), &renderer.image(), &WriteOptions { exposure: 1.0 })?;
    println!("glass-ball.png: {} samples a pixel on {}", renderer.samples(), renderer.device());
    Ok(())
}

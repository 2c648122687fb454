//! Renders a scene file step by step and writes an image after each doubling of the samples.
//! `cargo run --release --example progressive -- scenes/cornell-box.toml 64 out.png`

use qtracer::film::{WriteOptions, write_image};
use qtracer::{RenderOptions, Renderer, Scene};
use std::path::Path;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let path = arguments.next().unwrap_or_else(|| "scenes/cornell-box.toml".into());
    let spp: u32 = arguments.next().map_or(Ok(64), |s| s.parse())?;
    let output = arguments.next().unwrap_or_else(|| "progressive.png".into());

    let scene = Scene::load(&path)?;
    let mut renderer = Renderer::new(&scene, RenderOptions::default())?;
    println!("{} on {} ({})", scene.name, renderer.engine(), renderer.device());
    let mut next_write = 1;
    while renderer.samples() < spp {
        renderer.step(spp - renderer.samples())?;
        if renderer.samples() >= next_write || renderer.samples() == spp {
            write_image(Path::new(&output), &renderer.image(), &WriteOptions::default())?;
            println!(
                "{:>6} samples a pixel, error {:.4}",
                renderer.samples(),
                renderer.film().relative_error()
            );
            next_write = renderer.samples() * 2;
        }
    }
    Ok(())
}

//! One image in two shards, as two machines would render it, and put together: bit for bit the image of one render.
//! Another thread could end it early through the cancel token.
//! `cargo run --release --example shards`

use qtracer::{EngineChoice, Film, RenderOptions, Renderer, Scene};

fn render(scene: &Scene, first_sample: u32, samples: u32) -> Result<Film, Box<dyn std::error::Error>> {
    let options =
        RenderOptions { first_sample, size: Some((128, 128)), ..RenderOptions::on(EngineChoice::Auto) };
    let mut renderer = Renderer::new(scene, options)?;
    while renderer.samples() < samples && !renderer.cancel_token().is_cancelled() {
        renderer.step(samples - renderer.samples())?;
    }
    Ok(renderer.film().clone())
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let scene = Scene::load("scenes/cornell-box.toml")?;
    let mut merged = render(&scene, 0, 32)?;
    merged.merge(&render(&scene, 32, 32)?)?;
    let whole = render(&scene, 0, 64)?;
    println!("shards equal the whole: {}", merged.mean() == whole.mean());
    Ok(())
}

use qtracer::film::read_image;
use qtracer::stats::{Comparison, ComparisonOptions};
use qtracer::*;
use std::path::Path;
fn main() -> Result<(), Box<dyn std::error::Error>> {
    let a: Vec<String> = std::env::args().skip(1).collect();
    let scene = Scene::load(&a[0])?;
    let mut reference = read_image(Path::new(&a[1]))?;
    reference.standard_error = Some(read_image(Path::new(&a[1].replace(".exr", ".se.exr")))?.rgb);
    let spp: u32 = a[2].parse()?;
    let engine = match a.get(3).map(String::as_str) {
        Some("mega") => EngineChoice::Megakernel,
        Some("wave") => EngineChoice::Wavefront,
        _ => EngineChoice::Cpu,
    };
    let sampler = Sampler::Independent;
    let options = RenderOptions {
        size: Some((reference.width, reference.height)),
        sampler,
        roulette: Some(true),
        direct_light: Some(true),
        ..RenderOptions::on(engine)
    };
    let mut r = Renderer::new(&scene, options)?;
    while r.samples() < spp {
        r.step(spp - r.samples())?;
    }
    println!("{:.1} s", r.stats().seconds);
    println!("{}", Comparison::new(&r.image().view(), &reference.view(), &ComparisonOptions::default())?);
    qtracer::film::write_image(Path::new(&format!("{}.png", scene.name)), &r.image(), &Default::default())?;
    Ok(())
}

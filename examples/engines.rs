//! Renders one scene on each engine and schedule and prints time and difference to the first.
//! `cargo run --release --example engines -- scenes/cornell-box.toml 32 128x128`

use qtracer::gpu::stage::Schedule;
use qtracer::{EngineChoice, RenderOptions, Renderer, Scene};
use std::time::Instant;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let path = arguments.first().map_or("scenes/cornell-box.toml", String::as_str);
    let spp: u32 = arguments.get(1).map_or(Ok(32), |s| s.parse())?;
    let size = arguments.get(2).and_then(|s| s.split_once('x'));
    let size = size.map_or(Ok((128, 128)), |(w, h)| w.parse().and_then(|w| Ok((w, h.parse()?))))?;

    let scene = Scene::load(path)?;
    let runs = [
        (EngineChoice::Cpu, Schedule::Fused),
        (EngineChoice::Megakernel, Schedule::Fused),
        (EngineChoice::Wavefront, Schedule::Fused),
        (EngineChoice::Wavefront, Schedule::Streamed),
        (EngineChoice::Wavefront, Schedule::Compacted),
    ];
    let mut reference: Option<Vec<[f32; 3]>> = None;
    for (engine, schedule) in runs {
        let options = RenderOptions { size: Some(size), schedule: Some(schedule), ..RenderOptions::on(engine) };
        let start = Instant::now();
        let mut renderer = match Renderer::new(&scene, options) {
            Ok(renderer) => renderer,
            Err(error) => {
                println!("{engine:?}: {error}");
                continue;
            }
        };
        while renderer.samples() < spp {
            renderer.step(spp - renderer.samples())?;
        }
        let rgb = renderer.film().mean();
        let mean: f32 = rgb.iter().map(|p| p.iter().sum::<f32>()).sum::<f32>() / (3 * rgb.len()) as f32;
        let same = reference.as_ref().map_or(1.0, |r| {
            let close = |a: &[f32; 3], b: &[f32; 3]| (0..3).all(|c| (a[c] - b[c]).abs() <= 1e-3 * b[c].abs());
            rgb.iter().zip(r).filter(|(a, b)| close(a, b)).count() as f64 / rgb.len() as f64
        });
        println!(
            "{:<10} {schedule:<9?} mean {mean:.5}, {:.2} % of pixels within 1e-3 of the first, {:.2} s",
            renderer.engine().to_string(),
            100.0 * same,
            start.elapsed().as_secs_f64()
        );
        reference.get_or_insert(rgb);
    }
    Ok(())
}

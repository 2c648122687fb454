//! How much error is left after so many seconds or samples? Guides and roulettes side by side, several seeds each, learning
//! charged: the clock runs from the first sample to the last, lessons and tables included.
//!
//! A variant is GUIDE:ROULETTE[:SCALE], such as `off:throughput:4` or `adaptive:learnt:3`. Errors are relMSE against a
//! reference of the same size (`--reference`), minus what the reference's own standard errors make of it. Rows as JSON lines.
//!
//! `cargo bench --bench efficiency -- --scene scenes/door-ajar.toml --reference door.exr --variant off:throughput:4 \
//!  adaptive:learnt:3 --seconds 1,4 --seeds 3`

use clap::Parser;
use qtracer::film::read_image;
use qtracer::guiding::GuideMode;
use qtracer::stats::relative_mse;
use qtracer::transport::roulette::Roulette;
use qtracer::{EngineChoice, Image, RenderOptions, Renderer, Sampler, Scene};
use serde_json::json;
use std::error::Error;
use std::io::Write;
use std::time::Instant;

#[derive(Parser)]
struct Arguments {
    #[arg(long)]
    scene: String,
    #[arg(long)]
    reference: String,
    #[arg(long, required = true, num_args = 1..)]
    variant: Vec<String>,
    /// Check points of one render, in seconds.
    #[arg(long, value_delimiter = ',')]
    seconds: Vec<f64>,
    /// Check points of one render, in samples per pixel.
    #[arg(long, value_delimiter = ',')]
    spp: Vec<u32>,
    #[arg(long, default_value_t = 3)]
    seeds: u32,
    /// Width and height; the reference's if not given.
    #[arg(long, default_value = "cpu")]
    engine: String,
    #[arg(long, default_value_t = true, num_args = 1)]
    direct_light: bool,
    #[arg(long, default_value_t = 64)]
    max_bounces: u32,
    #[arg(long, default_value_t = 0.01)]
    epsilon: f64,
    #[arg(long)]
    mixture: Option<f32>,
    #[arg(long)]
    depth: Option<u32>,
    #[arg(long)]
    learning: Option<u32>,
    #[arg(long)]
    cell: Option<f32>,
    #[arg(long)]
    json: Option<String>,
    /// Given by `cargo bench`.
    #[arg(long, hide = true)]
    bench: bool,
}

/// What was found at a check point.
struct Point {
    seconds: f64,
    samples: u32,
    relative_mse: f64,
    trimmed: f64,
}

fn options(
    arguments: &Arguments,
    variant: &str,
    seed: u32,
    size: (u32, u32),
) -> Result<RenderOptions, String> {
    let mut parts = variant.split(':');
    let mode = match parts.next().unwrap_or("") {
        "off" => GuideMode::Off,
        "bansal" => GuideMode::Bansal,
        "bansal-reweighted" => GuideMode::BansalReweighted,
        "octant" => GuideMode::Octant,
        "adaptive" => GuideMode::Adaptive,
        other => return Err(format!("guide {other}")),
    };
    let roulette = match parts.next().unwrap_or("throughput") {
        "off" => Roulette::Off,
        "throughput" => Roulette::Throughput,
        "learnt" => Roulette::Learnt,
        other => return Err(format!("roulette {other}")),
    };
    let scale = parts.next().map(|scale| scale.parse().map_err(|_| format!("scale {scale}"))).transpose()?;
    let mut options = RenderOptions {
        size: Some(size),
        seed,
        engine: match arguments.engine.as_str() {
            "cpu" => EngineChoice::Cpu,
            "megakernel" => EngineChoice::Megakernel,
            "wavefront" => EngineChoice::Wavefront,
            _ => EngineChoice::Auto,
        },
        direct_light: Some(arguments.direct_light),
        roulette: Some(roulette),
        roulette_scale: scale,
        max_bounces: Some(arguments.max_bounces),
        sampler: Sampler::Stratified,
        ..Default::default()
    };
    let guide = &mut options.guide;
    guide.mode = mode;
    guide.mixture = arguments.mixture.unwrap_or(guide.mixture);
    guide.depth = arguments.depth.unwrap_or(guide.depth);
    guide.learning_samples = arguments.learning.unwrap_or(guide.learning_samples);
    guide.cell_size = arguments.cell.or(guide.cell_size);
    Ok(options)
}

/// Renders until the last check point.
fn render(
    arguments: &Arguments,
    scene: &Scene,
    options: RenderOptions,
    reference: &Image,
) -> Result<Vec<Point>, Box<dyn Error>> {
    let mut renderer = Renderer::new(scene, options)?;
    let mut points = Vec::new();
    let mut elapsed = 0.0;
    let by_time = !arguments.seconds.is_empty();
    let goals = if by_time { arguments.seconds.len() } else { arguments.spp.len() };
    while points.len() < goals {
        let samples = renderer.samples();
        let asked = if by_time {
            let rest: f64 = arguments.seconds[points.len()] - elapsed;
            if samples == 0 { 1 } else { ((f64::from(samples) / elapsed * rest * 0.5) as u32).max(1) }
        } else {
            arguments.spp[points.len()] - samples
        };
        let start = Instant::now();
        renderer.step(asked)?;
        elapsed += start.elapsed().as_secs_f64();
        let reached = if by_time {
            elapsed >= arguments.seconds[points.len()]
        } else {
            renderer.samples() >= arguments.spp[points.len()]
        };
        if reached {
            let image = renderer.image();
            let error = relative_mse(&image.view(), &reference.view(), arguments.epsilon)?;
            points.push(Point {
                seconds: elapsed,
                samples: renderer.samples(),
                relative_mse: error.plain,
                trimmed: error.trimmed,
            });
        }
    }
    Ok(points)
}

fn mean_and_spread(values: &[f64]) -> (f64, f64) {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0).max(1.0);
    (mean, variance.sqrt())
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments = Arguments::parse();
    let scene = Scene::load(&arguments.scene)?;
    let reference = read_image(std::path::Path::new(&arguments.reference))?;
    let size = (reference.width, reference.height);
    let noise = reference.standard_error.as_ref().map_or(0.0, |errors| {
        let pairs = errors.iter().flatten().zip(reference.rgb.iter().flatten());
        let sum: f64 =
            pairs.map(|(&e, &r)| f64::from(e).powi(2) / (f64::from(r).powi(2) + arguments.epsilon)).sum();
        sum / (3 * errors.len()) as f64
    });
    println!("| variant | check | samples | seconds | relMSE | spread | trimmed | 1/(relMSE·s) | trimmed |");
    println!("|---|---|---|---|---|---|---|---|---|");
    for variant in &arguments.variant {
        let mut runs = Vec::new();
        for seed in 0..arguments.seeds {
            runs.push(render(&arguments, &scene, options(&arguments, variant, seed + 1, size)?, &reference)?);
        }
        for check in 0..runs[0].len() {
            let column =
                |f: &dyn Fn(&Point) -> f64| -> Vec<f64> { runs.iter().map(|run| f(&run[check])).collect() };
            let (error, spread) = mean_and_spread(&column(&|p| p.relative_mse - noise));
            let (trimmed, _) = mean_and_spread(&column(&|p| p.trimmed - noise));
            let (seconds, _) = mean_and_spread(&column(&|p| p.seconds));
            let (samples, _) = mean_and_spread(&column(&|p| f64::from(p.samples)));
            println!(
                "| {variant} | {check} | {samples:.0} | {seconds:.3} | {error:.5} | {spread:.5} | {trimmed:.5} | {:.2} | {:.2} |",
                1.0 / (error * seconds),
                1.0 / (trimmed * seconds)
            );
        }
        if let Some(path) = &arguments.json {
            let mut file = std::fs::OpenOptions::new().create(true).append(true).open(path)?;
            for (seed, run) in runs.iter().enumerate() {
                for point in run {
                    writeln!(
                        file,
                        "{}",
                        json!({
                            "scene": scene.name, "variant": variant, "seed": seed + 1, "engine": arguments.engine,
                            "direct_light": arguments.direct_light, "seconds": point.seconds, "samples": point.samples,
                            "relative_mse": point.relative_mse, "trimmed": point.trimmed, "reference_noise": noise,
                        })
                    )?;
                }
            }
        }
    }
    Ok(())
}

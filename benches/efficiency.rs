//! How much error is left after so many seconds or samples? Guides and roulettes side by side, several seeds each, learning
//! charged: the clock runs from the first sample to the last, lessons and tables included.
//!
//! A variant is GUIDE[:ROULETTE[:SCALE[:SPLIT]]], such as `off:throughput:4`, `adaptive:learnt:3`, `adaptive:learnt:1:4` or
//! `auto`. Errors are relMSE against a reference of the same size (`--reference`), minus what the reference's own standard
//! errors make of it, or, without one, the scatter between seeds. Work is seconds, and rays, which no other program slows
//! down. Rows as JSON lines.
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
    /// Converged image of the same size; without it, seeds are compared with each other.
    #[arg(long)]
    reference: Option<String>,
    /// Width and height, where no reference says.
    #[arg(long, num_args = 2, default_values_t = [640, 480])]
    size: Vec<u32>,
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
    /// Millions of rays, shadow rays not counted.
    rays: f64,
    image: Image,
}

/// relMSE of an image, all pixels and without the worst 0.1 %.
struct Noise {
    plain: f64,
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
        "adaptive" | "auto" => GuideMode::Adaptive,
        other => return Err(format!("guide {other}")),
    };
    let roulette = match parts.next() {
        None => None,
        Some("off") => Some(Roulette::Off),
        Some("throughput") => Some(Roulette::Throughput),
        Some("learnt") => Some(Roulette::Learnt),
        Some(other) => return Err(format!("roulette {other}")),
    };
    let scale = parts.next().map(|scale| scale.parse().map_err(|_| format!("scale {scale}"))).transpose()?;
    let split = parts.next().map(|split| split.parse().map_err(|_| format!("split {split}"))).transpose()?;
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
        roulette,
        roulette_scale: scale,
        split,
        max_bounces: Some(arguments.max_bounces),
        sampler: Sampler::Stratified,
        ..Default::default()
    };
    let guide = &mut options.guide;
    guide.mode = mode;
    guide.trial = variant.starts_with("auto");
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
            let rays = renderer.stats().rays as f64 * 1e-6;
            let (samples, image) = (renderer.samples(), renderer.image());
            points.push(Point { seconds: elapsed, samples, rays, image });
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

/// The mean of images of equal size.
fn mean_image(images: &[&Image]) -> Image {
    let mut mean = Image::new(images[0].width, images[0].height, vec![[0.0; 3]; images[0].rgb.len()]);
    for image in images {
        for (sum, rgb) in mean.rgb.iter_mut().zip(&image.rgb) {
            (0..3).for_each(|c| sum[c] += rgb[c] / images.len() as f32);
        }
    }
    mean
}

/// What the errors of runs are measured against.
enum Truth<'a> {
    /// A converged image and what its own noise adds to a relMSE.
    Reference { image: &'a Image, noise: f64 },
    /// Each other, since all of them estimate the same: the variance, by squares relative to this image.
    Seeds { scale: &'a Image },
}

impl Truth<'_> {
    /// The noise of the images of one variant at one check point.
    fn noise(&self, images: &[&Image], epsilon: f64) -> Result<Vec<Noise>, Box<dyn Error>> {
        match self {
            Truth::Reference { image, noise } => images
                .iter()
                .map(|i| {
                    let error = relative_mse(&i.view(), &image.view(), epsilon)?;
                    Ok(Noise { plain: error.plain - noise, trimmed: error.trimmed - noise })
                })
                .collect(),
            Truth::Seeds { scale } => {
                let mean = mean_image(images);
                let n = images.len() as f64;
                Ok(images.iter().map(|i| scatter(i, &mean, scale, epsilon, n / (n - 1.0))).collect())
            }
        }
    }
}

/// Mean of factor · (image − mean)² / (scale² + epsilon).
fn scatter(image: &Image, mean: &Image, scale: &Image, epsilon: f64, factor: f64) -> Noise {
    let mut errors: Vec<f64> = (0..image.rgb.len())
        .map(|i| {
            let relative = |c: usize| {
                let [v, m, s] = [image.rgb[i][c], mean.rgb[i][c], scale.rgb[i][c]].map(f64::from);
                (v - m).powi(2) / (s * s + epsilon)
            };
            factor * (0..3).map(relative).sum::<f64>() / 3.0
        })
        .collect();
    let average = |errors: &[f64]| errors.iter().sum::<f64>() / errors.len() as f64;
    let plain = average(&errors);
    errors.sort_by(f64::total_cmp);
    Noise { plain, trimmed: average(&errors[..errors.len() - errors.len() / 1000]) }
}

/// What a reference's standard errors add to a relMSE against it.
fn reference_noise(reference: &Image, epsilon: f64) -> f64 {
    reference.standard_error.as_ref().map_or(0.0, |errors| {
        let pairs = errors.iter().flatten().zip(reference.rgb.iter().flatten());
        let sum: f64 = pairs.map(|(&e, &r)| f64::from(e).powi(2) / (f64::from(r).powi(2) + epsilon)).sum();
        sum / (3 * errors.len()) as f64
    })
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments = Arguments::parse();
    let scene = Scene::load(&arguments.scene)?;
    let reference = arguments.reference.as_ref().map(|path| read_image(path.as_ref())).transpose()?;
    if reference.is_none() && arguments.seeds < 2 {
        return Err("without --reference, give at least 2 --seeds".into());
    }
    let size = reference
        .as_ref()
        .map_or((arguments.size[0], arguments.size[1]), |reference| (reference.width, reference.height));
    let mut runs: Vec<Vec<Vec<Point>>> = Vec::new();
    for variant in &arguments.variant {
        let seeds = 1..=arguments.seeds;
        let variant: Result<_, Box<dyn Error>> =
            seeds.map(|seed| render(&arguments, &scene, options(&arguments, variant, seed, size)?)).collect();
        runs.push(variant?);
    }
    let last: Vec<&Image> =
        runs.iter().flatten().filter_map(|run| run.last().map(|point| &point.image)).collect();
    let scale = mean_image(&last);
    let truth = match &reference {
        Some(image) => Truth::Reference { image, noise: reference_noise(image, arguments.epsilon) },
        None => Truth::Seeds { scale: &scale },
    };
    report(&arguments, &scene, &runs, &truth)
}

fn report(
    arguments: &Arguments,
    scene: &Scene,
    runs: &[Vec<Vec<Point>>],
    truth: &Truth,
) -> Result<(), Box<dyn Error>> {
    println!(
        "| {} | check | samples | seconds | relMSE | spread | trimmed | 1/(relMSE·s) | trimmed | Mrays | 1/(relMSE·Mray) |",
        scene.name
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|");
    for (variant, runs) in arguments.variant.iter().zip(runs) {
        for check in 0..runs[0].len() {
            let images: Vec<&Image> = runs.iter().map(|run| &run[check].image).collect();
            let noise = truth.noise(&images, arguments.epsilon)?;
            let points: Vec<&Point> = runs.iter().map(|run| &run[check]).collect();
            let mean = |values: Vec<f64>| mean_and_spread(&values).0;
            let (error, spread) = mean_and_spread(&noise.iter().map(|n| n.plain).collect::<Vec<_>>());
            let trimmed = mean(noise.iter().map(|n| n.trimmed).collect());
            let seconds = mean(points.iter().map(|p| p.seconds).collect());
            let samples = mean(points.iter().map(|p| f64::from(p.samples)).collect());
            let rays = mean(points.iter().map(|p| p.rays).collect());
            println!(
                "| {variant} | {check} | {samples:.0} | {seconds:.3} | {error:.6} | {spread:.6} | {trimmed:.6} | {:.2} | {:.2} | {rays:.2} | {:.3} |",
                1.0 / (error * seconds),
                1.0 / (trimmed * seconds),
                1.0 / (error * rays)
            );
            write_rows(arguments, scene, variant, &points, &noise)?;
        }
    }
    Ok(())
}

/// A JSON line per seed.
fn write_rows(
    arguments: &Arguments,
    scene: &Scene,
    variant: &str,
    points: &[&Point],
    noise: &[Noise],
) -> Result<(), Box<dyn Error>> {
    let Some(path) = &arguments.json else { return Ok(()) };
    let mut file = std::fs::OpenOptions::new().create(true).append(true).open(path)?;
    for (seed, (point, noise)) in points.iter().zip(noise).enumerate() {
        let row = json!({
            "scene": scene.name, "variant": variant, "seed": seed + 1, "engine": arguments.engine,
            "direct_light": arguments.direct_light, "epsilon": arguments.epsilon, "seconds": point.seconds,
            "samples": point.samples, "mrays": point.rays, "relative_mse": noise.plain, "trimmed": noise.trimmed,
        });
        writeln!(file, "{row}")?;
    }
    Ok(())
}

//! How long does each engine and schedule take for one scene? GPU time by the GPU's clock, median and range of several
//! repetitions within one process, after a warm-up. One row per engine; rows as JSON lines with `--json FILE`.
//!
//! `cargo bench --bench engine_times -- --scene scenes/bansal-exp-3.toml --spp 64 --max-bounces 8`

use clap::Parser;
use qtracer::gpu::stage::Schedule;
use qtracer::scene::Instancing;
use qtracer::transport::roulette::Roulette;
use qtracer::{EngineChoice, RenderOptions, Renderer, Sampler, Scene};
use serde_json::json;
use std::io::Write;

#[derive(Parser)]
struct Arguments {
    #[arg(long, required = true, num_args = 1..)]
    scene: Vec<String>,
    #[arg(long, default_value_t = 64)]
    spp: u32,
    #[arg(long, default_value_t = 7)]
    repetitions: usize,
    #[arg(long)]
    max_bounces: Option<u32>,
    /// Width and height; the scene's own if not given.
    #[arg(long, num_args = 2)]
    size: Option<Vec<u32>>,
    #[arg(long, num_args = 1)]
    direct_light: Option<bool>,
    /// Whether a tree chooses among many lights.
    #[arg(long, num_args = 1)]
    light_tree: Option<bool>,
    /// Whether instances share their mesh: auto, shared, laid-out.
    #[arg(long, default_value = "auto")]
    instances: String,
    #[arg(long, num_args = 1)]
    roulette: Option<bool>,
    /// Low-discrepancy samples instead of independent ones.
    #[arg(long)]
    stratified: bool,
    #[arg(long)]
    pool: Option<u32>,
    /// Levels or paths at once; see `qtracer render --help`.
    #[arg(long)]
    grain: Option<u32>,
    /// Engines to run: cpu, mega, fused, sorted, streamed, compacted.
    #[arg(long, value_delimiter = ',', default_value = "mega,fused,sorted,streamed,compacted")]
    engines: Vec<String>,
    #[arg(long)]
    json: Option<String>,
    /// Given by `cargo bench`.
    #[arg(long, hide = true)]
    bench: bool,
}

struct Row {
    gpu_ms: Vec<f64>,
    wall_ms: Vec<f64>,
    stats: qtracer::RenderStats,
    paths: u64,
}

fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted[sorted.len() / 2]
}

/// Renders `spp` samples again and again: first a warm-up in which pipelines compile and submissions find their size.
fn measure(
    scene: &Scene,
    options: RenderOptions,
    spp: u32,
    repetitions: usize,
) -> Result<Row, Box<dyn std::error::Error>> {
    let mut renderer = Renderer::new(scene, options)?;
    let mut row = Row { gpu_ms: vec![], wall_ms: vec![], stats: renderer.stats(), paths: 0 };
    for repetition in 0..repetitions + 3 {
        let before = renderer.stats();
        let mut left = spp;
        while left > 0 {
            left -= renderer.step(left)?;
        }
        let after = renderer.stats();
        if repetition >= 3 {
            row.gpu_ms.push(1e3 * (after.gpu_seconds - before.gpu_seconds));
            row.wall_ms.push(1e3 * (after.seconds - before.seconds));
        }
        row.paths = after.paths - before.paths;
        row.stats = after;
        row.stats.rays = row.stats.rays.saturating_sub(before.rays);
        row.stats.submissions -= before.submissions;
        row.stats.iterations -= before.iterations;
    }
    Ok(row)
}

fn run(arguments: &Arguments, path: &str, engine: &str) -> Result<(), Box<dyn std::error::Error>> {
    let scene = Scene::load(path)?;
    let (choice, schedule) = match engine {
        "cpu" => (EngineChoice::Cpu, None),
        "mega" => (EngineChoice::Megakernel, None),
        "fused" => (EngineChoice::Wavefront, Some(Schedule::Fused)),
        "sorted" => (EngineChoice::Wavefront, Some(Schedule::Sorted)),
        "streamed" => (EngineChoice::Wavefront, Some(Schedule::Streamed)),
        "compacted" => (EngineChoice::Wavefront, Some(Schedule::Compacted)),
        other => return Err(format!("no engine is called {other}").into()),
    };
    let options = RenderOptions {
        size: arguments.size.as_ref().map(|s| (s[0], s[1])),
        direct_light: arguments.direct_light,
        light_tree: arguments.light_tree,
        instances: match arguments.instances.as_str() {
            "auto" => Instancing::Auto,
            "shared" => Instancing::Shared,
            "laid-out" => Instancing::LaidOut,
            other => return Err(format!("instances are auto, shared or laid-out, not {other}").into()),
        },
        roulette: arguments.roulette.map(|on| if on { Roulette::Throughput } else { Roulette::Off }),
        max_bounces: arguments.max_bounces,
        sampler: if arguments.stratified { Sampler::Stratified } else { Sampler::Independent },
        schedule,
        pool: arguments.pool,
        grain: arguments.grain,
        ..RenderOptions::on(choice)
    };
    let row = measure(&scene, options, arguments.spp, arguments.repetitions)?;
    let gpu = choice != EngineChoice::Cpu;
    let ms = median(if gpu { &row.gpu_ms } else { &row.wall_ms });
    let range =
        |v: &[f64]| (v.iter().copied().fold(f64::MAX, f64::min), v.iter().copied().fold(0.0, f64::max));
    let (low, high) = range(if gpu { &row.gpu_ms } else { &row.wall_ms });
    println!(
        "| {} | {engine} | {ms:.3} | {low:.3}-{high:.3} | {:.2} | {:.0} | {:.2} | {} | {} |",
        scene.name,
        median(&row.wall_ms),
        row.paths as f64 / ms / 1e3,
        row.stats.rays as f64 / ms / 1e6,
        row.stats.iterations,
        row.stats.submissions,
    );
    if let Some(file) = &arguments.json {
        let mut file = std::fs::OpenOptions::new().create(true).append(true).open(file)?;
        let line = json!({
            "scene": scene.name, "engine": engine, "spp": arguments.spp, "max_bounces": arguments.max_bounces,
            "direct_light": arguments.direct_light, "light_tree": arguments.light_tree, "instances": arguments.instances, "roulette": arguments.roulette, "stratified": arguments.stratified,
            "pool": arguments.pool, "size": arguments.size, "gpu_ms": row.gpu_ms, "wall_ms": row.wall_ms,
            "paths": row.paths, "stats": row.stats,
        });
        writeln!(file, "{line}")?;
    }
    Ok(())
}

fn main() {
    let arguments = Arguments::parse();
    println!("| scene | engine | GPU ms | range | wall ms | Mpaths/s | Grays/s | levels | submissions |");
    println!("|---|---|---|---|---|---|---|---|---|");
    for path in &arguments.scene {
        for engine in &arguments.engines {
            if let Err(error) = run(&arguments, path, engine) {
                println!("| {path} | {engine} | {error} |");
            }
        }
    }
}

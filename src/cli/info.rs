//! `info`: the machine as qtracer sees it.

use super::console;
use super::failure::Failure;
use clap::Args;
use qtracer::gpu::device::{AdapterSummary, list_adapters};
use qtracer::scene::Material;
use qtracer::{RenderError, RenderOptions, Renderer, Scene};
use serde::Serialize;
use std::fmt::Write;

#[derive(Args)]
#[command(after_help = "\
Examples:
  qtracer info
      Version, GPUs, and what --engine auto would pick.
  qtracer info --json | jq -r '.adapters[].name'
      Names to give to --adapter (a part will do).
  VK_DRIVER_FILES=/path/to/driver.json qtracer info
      Is this Vulkan driver found?")]
pub struct InfoArgs {
    /// Print JSON
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct Info {
    version: &'static str,
    cpu_threads: usize,
    adapters: Vec<AdapterSummary>,
    auto: Auto,
}

/// What `--engine auto` picks.
#[derive(Serialize)]
struct Auto {
    engine: Option<String>,
    device: Option<String>,
    why: String,
}

pub fn run(args: &InfoArgs) -> Result<(), Failure> {
    let info = Info {
        version: env!("CARGO_PKG_VERSION"),
        cpu_threads: rayon::current_num_threads(),
        adapters: list_adapters(),
        auto: auto(),
    };
    match args.json {
        true => console::json(&info),
        false => console::data(text(&info)),
    }
}

/// Asks the renderer itself, with a scene that costs nothing, so that this never says other than what it does.
fn auto() -> Auto {
    match smallest_renderer() {
        Ok(renderer) => Auto {
            engine: Some(renderer.engine().to_string()),
            device: Some(renderer.device()),
            why: match renderer.notices() {
                [] => "the first real GPU".to_string(),
                notices => notices.join("; "),
            },
        },
        Err(error) => Auto { engine: None, device: None, why: error },
    }
}

fn smallest_renderer() -> Result<Renderer, String> {
    let scene = Scene::builder("probe")
        .camera([0.0, 0.0, 4.0], [0.0; 3], 45.0)
        .size(1, 1)
        .environment([1.0; 3])
        .material("grey", Material::diffuse([0.5; 3]))
        .sphere([0.0; 3], 1.0, "grey")
        .build()
        .map_err(|e| e.to_string())?;
    Renderer::new(&scene, RenderOptions::default()).map_err(|e: RenderError| e.to_string())
}

fn text(info: &Info) -> String {
    let mut text = format!("qtracer {}\nCPU   {} threads\n", info.version, info.cpu_threads);
    if info.adapters.is_empty() {
        text += "GPU   none found: no driver for Vulkan, Metal or DirectX 12\n";
    }
    for adapter in &info.adapters {
        let kind = match (adapter.software, adapter.integrated) {
            (true, _) => "software, runs on the CPU",
            (_, true) => "integrated",
            _ => "GPU",
        };
        let clock = if adapter.timestamps { "yes" } else { "no" };
        let mebibytes = |bytes: u64| bytes >> 20;
        let _ = writeln!(text, "GPU   {} ({kind})", adapter.name);
        let _ = writeln!(text, "      {}, driver {}", adapter.backend, adapter.driver);
        let _ = writeln!(
            text,
            "      largest binding {} MiB, largest buffer {} MiB, clock: {clock}",
            mebibytes(adapter.max_binding),
            mebibytes(adapter.max_buffer)
        );
    }
    let Auto { engine, device, why } = &info.auto;
    let engine = engine.as_deref().unwrap_or("nothing");
    let device = device.as_ref().map(|d| format!(" on {d}")).unwrap_or_default();
    let _ = writeln!(text, "auto  {engine}{device}: {why}");
    text
}

//! `info`: the machine as qtracer sees it.

use super::console;
use super::failure::Failure;
use clap::Args;
use qtracer::gpu::device::{AdapterSummary, Gpu, list_adapters};
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
    engine: String,
    device: String,
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

/// What `--engine auto` does on this machine; between the GPU engines it decides by the scene.
fn auto() -> Auto {
    match Gpu::open(None) {
        Ok(gpu) if gpu.summary.software => Auto {
            engine: "cpu".into(),
            device: format!("{} threads", rayon::current_num_threads()),
            why: format!("the only adapter is a software one ({})", gpu.summary.name),
        },
        Ok(gpu) => Auto {
            engine: "wavefront or megakernel, by scene".into(),
            device: gpu.summary.name.clone(),
            why: "the first real GPU; scenes of few shapes go to the megakernel".into(),
        },
        Err(error) => Auto {
            engine: "cpu".into(),
            device: format!("{} threads", rayon::current_num_threads()),
            why: error.to_string(),
        },
    }
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
    let _ = writeln!(text, "auto  {engine} on {device}: {why}");
    text
}

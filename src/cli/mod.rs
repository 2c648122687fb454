//! Floor 4: raw arguments → validated configuration → run → exit code. Data goes to stdout, everything else to stderr.

mod check;
mod compare;
mod console;
mod diff;
mod failure;
mod guide_args;
mod info;
mod kernels;
mod merge;
mod progress;
mod render;
mod render_args;
mod signals;
mod stats;
mod stop;
mod values;
mod waiting;

use clap::{Parser, Subcommand};
use failure::Failure;
use std::process::ExitCode;

/// Renders scenes by path tracing: on any GPU that Vulkan, Metal or DirectX 12 reaches, else on the CPU.
#[derive(Parser)]
#[command(name = "qtracer", version, arg_required_else_help = true, after_help = EXAMPLES)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

const EXAMPLES: &str = "\
Examples:
  qtracer render scenes/cornell-box.toml
      Renders the Cornell box to cornell-box.png.
  qtracer render scenes/cornell-box.toml --time 90s -o box.exr -o box.png
      Renders for 90 seconds; keeps the exact values and a picture to look at.
  qtracer compare box.exr reference.exr --z-test
      Is the image right? Exits 1 if not.
  qtracer info
      Which GPUs are there, and which would be used?

Exit codes: 0 done; 1 failed, or images differ; 2 bad arguments, scenes or images.
`qtracer COMMAND --help` has more examples.";

#[derive(Subcommand)]
enum Command {
    /// Render a scene to PNG and EXR images.
    Render(Box<render_args::RenderArgs>),
    /// Measure how far an image is from a reference, and test whether noise explains it.
    Compare(compare::CompareArgs),
    /// Combine renders of different samples of one scene.
    Merge(merge::MergeArgs),
    /// Show the GPUs and what --engine auto would pick.
    Info(info::InfoArgs),
    /// Load scenes and say what is in them, or what is wrong with them.
    Check(check::CheckArgs),
}

pub fn main() -> ExitCode {
    match run(Cli::parse().command) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => failure.report(),
    }
}

fn run(command: Command) -> Result<(), Failure> {
    match command {
        Command::Render(args) => render::run(*args),
        Command::Compare(args) => compare::run(&args),
        Command::Merge(args) => merge::run(&args),
        Command::Info(args) => info::run(&args),
        Command::Check(args) => check::run(&args),
    }
}

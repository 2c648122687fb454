//! Lists the GPUs that qtracer can run on, the best first; fails if there is none.
//! `cargo run --release --example adapters`

use qtracer::gpu::device::list_adapters;
use std::process::ExitCode;

fn main() -> ExitCode {
    let adapters = list_adapters();
    for adapter in &adapters {
        let kind = if adapter.software { ", software" } else { "" };
        println!("{} ({}{kind}): {}", adapter.name, adapter.backend, adapter.driver);
    }
    match adapters.len() {
        0 => {
            eprintln!("no GPU adapter found");
            ExitCode::FAILURE
        }
        _ => ExitCode::SUCCESS,
    }
}

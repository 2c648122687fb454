//! What a render built and spent.

use std::collections::BTreeMap;

/// Figures for `--stats` and for tests.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize)]
pub struct RenderStats {
    pub engine: String,
    pub device: String,
    /// What the kernels were specialised to; empty on the CPU.
    pub kernel_key: String,
    /// Kernels linked.
    pub kernels: Vec<String>,
    /// Bytes of each GPU buffer.
    pub buffers: BTreeMap<String, u64>,
    /// Paths traced.
    pub paths: u64,
    /// Rays traced, shadow rays not included.
    pub rays: u64,
    /// Seconds that the GPU worked, by its own clock; 0 where it has none.
    pub gpu_seconds: f64,
    /// Seconds within the engine, waiting included.
    pub seconds: f64,
    /// Submissions to the GPU.
    pub submissions: u64,
    /// Levels recorded by the wavefront engine.
    pub iterations: u64,
}

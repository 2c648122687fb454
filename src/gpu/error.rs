//! What can go wrong on a GPU, each with its remedy.

/// A failure of the GPU, its driver or its limits.
#[derive(Clone, Debug, thiserror::Error)]
pub enum GpuError {
    #[error("{}", no_adapter(wanted, found))]
    NoAdapter { wanted: Option<String>, found: Vec<String> },
    #[error("GPU \"{adapter}\": {reason}; try --engine cpu")]
    Device { adapter: String, reason: String },
    #[error(
        "GPU \"{adapter}\" was lost: {reason}; what was rendered before is kept; a driver reset is the usual cause"
    )]
    DeviceLost { adapter: String, reason: String },
    #[error("GPU \"{adapter}\" is out of memory: {reason}; choose a smaller --size or --pool")]
    OutOfMemory { adapter: String, reason: String },
    #[error(
        "GPU \"{adapter}\" binds at most {limit} bytes, but buffer \"{buffer}\" needs {bytes}; choose a smaller --size or --pool, or --engine cpu"
    )]
    BufferTooLarge { adapter: String, buffer: String, bytes: u64, limit: u64 },
    #[error(
        "GPU \"{adapter}\" binds at most {limit} bytes, but the scene needs {bytes}; give it fewer triangles, or take --engine cpu"
    )]
    SceneTooLarge { adapter: String, bytes: u64, limit: u64 },
    #[error("kernel {kernel}: {reason}")]
    Kernel { kernel: String, reason: String },
    #[error(transparent)]
    Link(#[from] super::link::LinkError),
    #[error(
        "queue overflow in {queues}: rays would have been lost, so the batch was not used; this is a bug in qtracer"
    )]
    QueueOverflow { queues: String },
    #[error(
        "after {levels} levels {flying} rays are still in flight, which can't be: a bug in qtracer or the driver; try --engine megakernel or cpu"
    )]
    NoProgress { levels: u32, flying: u32 },
}

fn no_adapter(wanted: &Option<String>, found: &[String]) -> String {
    match wanted {
        Some(name) if !found.is_empty() => {
            format!("no GPU is called \"{name}\"; there are: {}", found.join(", "))
        }
        _ => "no GPU was found (no Vulkan, Metal or DX12 driver); use --engine cpu, or install mesa-vulkan-drivers"
            .to_string(),
    }
}

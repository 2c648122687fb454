//! Why a render could not start or go on.

use crate::gpu::error::GpuError;

#[derive(Clone, Debug, thiserror::Error)]
pub enum RenderError {
    #[error(transparent)]
    Guide(#[from] crate::guiding::LearnerError),
    #[error(transparent)]
    Gpu(#[from] GpuError),
    #[error("the render was cancelled; what was finished before is kept")]
    Cancelled,
    #[error(transparent)]
    Scene(#[from] crate::scene::SceneError),
    #[error("{option} {value}: {remedy}")]
    Option { option: &'static str, value: String, remedy: String },
    #[error("sample {last} is beyond the last one, {max}; start at a lower first sample", max = u32::MAX)]
    TooManySamples { last: u64 },
}

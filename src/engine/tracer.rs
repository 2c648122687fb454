//! What the GPU engines have in common: batch after batch is prepared, traced and resolved into the film.

use super::batch::{batch_samples, batches, full_batch};
use super::gpu_film::GpuFilm;
use super::strategy::Pass;
use super::{Batch, CancelToken, Engine, EngineKind, RenderError, RenderStats};
use crate::film::Film;
use crate::guiding::{Committed, GuideUpdate};
use std::ops::Range;
use std::time::Instant;

/// A way to trace the paths of a batch on a GPU. Whatever is one is an [`Engine`].
pub trait Tracer: Send {
    const KIND: EngineKind;

    fn gpu(&self) -> &GpuFilm;
    fn gpu_mut(&mut self) -> &mut GpuFilm;

    /// Makes buffers and bind groups for batches of this size.
    fn prepare(&mut self, batch: &Batch) -> Result<(), RenderError>;

    /// Forgets its bind groups, since buffers were replaced.
    fn unbind(&mut self);

    /// Leaves the radiance of every path of the batch in its buffer; false if cancelled before that.
    /// While the GPU works, sums of the batch before are added to the film.
    fn trace(&mut self, batch: &Batch, film: &mut Film, cancel: &CancelToken) -> Result<bool, RenderError>;
}

impl<T: Tracer> Engine for T {
    fn kind(&self) -> EngineKind {
        T::KIND
    }

    fn device(&self) -> String {
        self.gpu().stats.device.clone()
    }

    fn render(
        &mut self,
        range: Range<u32>,
        film: &mut Film,
        cancel: &CancelToken,
    ) -> Result<(), RenderError> {
        let start = Instant::now();
        let traced = trace_batches(self, range, film, cancel);
        if traced.is_err() {
            self.gpu_mut().forget_sums();
        }
        self.gpu_mut().stats.seconds += start.elapsed().as_secs_f64();
        traced
    }

    fn set_pass(&mut self, pass: &Pass) -> Result<(), RenderError> {
        if self.gpu_mut().set_pass(pass) {
            self.unbind();
        }
        Ok(())
    }

    /// Half of what a binding holds, since tables grow from pass to pass and are only then found to be too large.
    fn largest_guide(&self) -> u64 {
        let summary = &self.gpu().gpu.summary;
        summary.max_binding.min(summary.max_buffer) / 2
    }

    fn set_guide(&mut self, update: GuideUpdate) -> Result<(), RenderError> {
        if self.gpu_mut().set_guide(&update)? {
            self.unbind();
        }
        Ok(())
    }

    fn begin_commit(&mut self) {
        self.gpu_mut().begin_commit();
    }

    fn commit(&mut self) -> Result<Committed, RenderError> {
        self.gpu_mut().commit()
    }

    /// Whole batches: as many as fit into the time of a step by what earlier ones took.
    fn step_samples(&self) -> u32 {
        let gpu = self.gpu();
        let batch = batch_samples(gpu.pixels(), gpu.max_paths);
        let samples = gpu.stats.paths as f64 / f64::from(gpu.pixels());
        let fitting = match gpu.stats.paths {
            0 => 1.0,
            _ => STEP_SECONDS * samples / gpu.stats.seconds.max(1e-9) / f64::from(batch),
        };
        batch.saturating_mul(fitting.clamp(1.0, 256.0) as u32)
    }

    fn stats(&self) -> RenderStats {
        self.gpu().stats.clone()
    }
}

/// How long a step should take, in seconds.
const STEP_SECONDS: f64 = 0.25;

/// Traces the batches of a range, each while the sums of the one before travel to the host.
fn trace_batches<T: Tracer>(
    tracer: &mut T,
    range: Range<u32>,
    film: &mut Film,
    cancel: &CancelToken,
) -> Result<(), RenderError> {
    if tracer.gpu().may_learn() {
        // Passes double: buffers for the largest batch at once, not new ones for each.
        tracer.prepare(&full_batch(tracer.gpu().pixels(), tracer.gpu().max_paths))?;
    }
    for batch in batches(tracer.gpu().pixels(), range, tracer.gpu().max_paths) {
        tracer.prepare(&batch)?;
        let finished = tracer.trace(&batch, film, cancel)?;
        tracer.gpu_mut().receive_sums(film)?;
        if !finished {
            return Ok(());
        }
        tracer.gpu_mut().send_sums(&batch);
    }
    tracer.gpu_mut().receive_sums(film)
}

//! What the GPU engines have in common: batch after batch is prepared, traced and resolved into the film.

use super::batch::{batch_samples, batches};
use super::gpu_film::GpuFilm;
use super::{Batch, CancelToken, Engine, EngineKind, RenderError, RenderStats};
use crate::film::Film;
use crate::guiding::{GuideTable, Lessons};
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
    fn trace(&mut self, batch: &Batch, cancel: &CancelToken) -> Result<bool, RenderError>;
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
        for batch in batches(self.gpu().pixels(), range, self.gpu().max_paths) {
            self.prepare(&batch)?;
            if !self.trace(&batch, cancel)? {
                break;
            }
            self.gpu_mut().resolve(&batch, film)?;
        }
        self.gpu_mut().stats.seconds += start.elapsed().as_secs_f64();
        Ok(())
    }

    fn set_guide(&mut self, table: GuideTable) -> Result<(), RenderError> {
        if self.gpu_mut().set_guide(&table)? {
            self.unbind();
        }
        Ok(())
    }

    fn take_lessons(&mut self) -> Result<Lessons, RenderError> {
        self.gpu_mut().take_lessons()
    }

    fn step_samples(&self) -> u32 {
        batch_samples(self.gpu().pixels(), self.gpu().max_paths)
    }

    fn stats(&self) -> RenderStats {
        self.gpu().stats.clone()
    }
}

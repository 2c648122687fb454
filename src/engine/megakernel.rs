//! The megakernel engine: a whole path per invocation. Its dispatches cover ranges of paths.

use super::batch::{batch_samples, batches};
use super::gpu_film::{GpuFilm, Pacer, grid};
use super::{Batch, CancelToken, Engine, EngineKind, RenderError, RenderStats};
use crate::film::Film;
use crate::gpu::device::Gpu;
use crate::gpu::key::KernelKey;
use crate::gpu::stage::{Schedule, Stage};
use crate::scene::compiled::{CompiledScene, Uniforms};
use std::ops::Range;
use std::time::Instant;

pub struct MegakernelEngine {
    gpu: GpuFilm,
    binds: Option<(wgpu::BindGroup, wgpu::BindGroup)>,
    pacer: Pacer,
}

impl MegakernelEngine {
    pub fn new(
        gpu: Gpu,
        scene: &CompiledScene,
        uniforms: Uniforms,
        key: KernelKey,
    ) -> Result<Self, RenderError> {
        let first = if gpu.summary.software { 1 << 13 } else { 1 << 16 };
        let stages = Stage::megakernel();
        let gpu = GpuFilm::new(gpu, scene, uniforms, key, &stages, Schedule::Fused, "megakernel")?;
        Ok(MegakernelEngine { gpu, binds: None, pacer: Pacer::new(first) })
    }

    /// Traces a batch in dispatches of paced size; false if cancelled.
    fn trace(&mut self, batch: &Batch, cancel: &CancelToken) -> Result<bool, RenderError> {
        let uniforms = self.gpu.batch_uniforms(batch);
        let mut path = 0;
        while path < batch.paths() {
            if cancel.is_cancelled() {
                return Ok(false);
            }
            let count = self.pacer.amount().min(batch.paths() - path);
            self.gpu.write_uniforms(&Uniforms { first_path: path, path_count: count, ..uniforms });
            let bind = self.binds.as_ref().map(|(bind, _)| bind);
            let (_, seconds) = self.gpu.submit(None, |this, pass| {
                pass.set_pipeline(&this.kernels[&Stage::Megakernel].pipeline);
                pass.set_bind_group(0, bind, &[]);
                let [x, y] = grid(count);
                pass.dispatch_workgroups(x, y, 1);
            })?;
            self.pacer.observe(count, seconds);
            path += count;
        }
        Ok(true)
    }
}

impl Engine for MegakernelEngine {
    fn kind(&self) -> EngineKind {
        EngineKind::Megakernel
    }

    fn device(&self) -> String {
        self.gpu.stats.device.clone()
    }

    fn render(
        &mut self,
        range: Range<u32>,
        film: &mut Film,
        cancel: &CancelToken,
    ) -> Result<(), RenderError> {
        let start = Instant::now();
        let pixels = self.gpu.uniforms.width * self.gpu.uniforms.height;
        for batch in batches(pixels, range, self.gpu.max_paths) {
            if self.gpu.reserve(&batch)? || self.binds.is_none() {
                let bind = |stage| self.gpu.kernels[&stage].bind(&self.gpu.gpu, &self.gpu.buffers, &[]);
                self.binds = Some((bind(Stage::Megakernel), bind(Stage::Resolve)));
            }
            if !self.trace(&batch, cancel)? {
                break;
            }
            if let Some((_, resolve)) = &self.binds {
                self.gpu.resolve(&batch, resolve, film)?;
            }
        }
        self.gpu.stats.seconds += start.elapsed().as_secs_f64();
        Ok(())
    }

    fn step_samples(&self) -> u32 {
        batch_samples(self.gpu.uniforms.width * self.gpu.uniforms.height, self.gpu.max_paths)
    }

    fn stats(&self) -> RenderStats {
        self.gpu.stats.clone()
    }
}

//! The megakernel engine: a whole path per invocation. Its dispatches cover ranges of paths.

use super::gpu_film::{GpuFilm, Keys, Pacer, grid};
use super::tracer::Tracer;
use super::{Batch, CancelToken, EngineKind, RenderError};
use crate::film::Film;
use crate::gpu::device::Gpu;
use crate::gpu::stage::{Counter, Schedule, Stage, counter_words};
use crate::scene::compiled::{CompiledScene, Uniforms};
use wgpu::BufferUsages;

pub struct MegakernelEngine {
    gpu: GpuFilm,
    bind: Option<wgpu::BindGroup>,
    pacer: Pacer,
}

impl MegakernelEngine {
    pub fn new(gpu: Gpu, scene: &CompiledScene, uniforms: Uniforms, keys: Keys) -> Result<Self, RenderError> {
        let first = if gpu.summary.software { 1 << 13 } else { 1 << 16 };
        let mut gpu =
            GpuFilm::new(gpu, scene, uniforms, keys, |_| Stage::megakernel(), Schedule::Fused, "megakernel")?;
        let usage = BufferUsages::STORAGE | BufferUsages::COPY_SRC | BufferUsages::COPY_DST;
        gpu.buffers.create(&gpu.gpu, "counters", 4 * u64::from(counter_words(&keys.own)), usage)?;
        Ok(MegakernelEngine { gpu, bind: None, pacer: Pacer::new(first) })
    }
}

impl Tracer for MegakernelEngine {
    const KIND: EngineKind = EngineKind::Megakernel;

    fn gpu(&self) -> &GpuFilm {
        &self.gpu
    }
    fn gpu_mut(&mut self) -> &mut GpuFilm {
        &mut self.gpu
    }

    fn prepare(&mut self, batch: &Batch) -> Result<(), RenderError> {
        if self.gpu.reserve(batch)? || self.bind.is_none() {
            self.bind = Some(self.gpu.bind(Stage::Megakernel, &[]));
        }
        Ok(())
    }

    fn unbind(&mut self) {
        self.bind = None;
    }

    /// In dispatches of paced size.
    fn trace(&mut self, batch: &Batch, film: &mut Film, cancel: &CancelToken) -> Result<bool, RenderError> {
        let uniforms = self.gpu.batch_uniforms(batch);
        let (mut path, mut rays) = (0, 0);
        let zeros = vec![0u32; counter_words(&self.gpu.key) as usize];
        self.gpu.gpu.queue.write_buffer(self.gpu.buffers.get("counters"), 0, bytemuck::cast_slice(&zeros));
        while path < batch.paths() {
            if cancel.is_cancelled() {
                return Ok(false);
            }
            let count = self.pacer.amount().min(batch.paths() - path);
            self.gpu.write_uniforms(&Uniforms { first_path: path, path_count: count, ..uniforms });
            let bind = self.bind.as_ref();
            let flight = self.gpu.launch(Some("counters"), |this, pass| {
                pass.set_pipeline(&this.kernels[&Stage::Megakernel].pipeline);
                pass.set_bind_group(0, bind, &[]);
                let [x, y] = grid(count);
                pass.dispatch_workgroups(x, y, 1);
            });
            self.gpu.receive_sums(film)?;
            let (counters, seconds): (Vec<u32>, f64) = self.gpu.land(flight, bytemuck::pod_collect_to_vec)?;
            self.pacer.observe(count, seconds);
            path += count;
            rays = counters[Counter::Rays as usize];
        }
        self.gpu.stats.rays += u64::from(rays);
        Ok(true)
    }
}

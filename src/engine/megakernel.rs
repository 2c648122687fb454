//! The megakernel engine: whole paths in one kernel. Its dispatches cover ranges of paths.

use super::gpu_film::{GpuFilm, Keys, grid_of};
use super::pacing::{Pacer, PathLengths, Shares};
use super::tracer::Tracer;
use super::workload::Workload;
use super::{Batch, CancelToken, EngineKind, RenderError, RenderOptions};
use crate::film::Film;
use crate::gpu::device::Gpu;
use crate::gpu::stage::{Counter, MEGAKERNEL_WORKGROUP, Schedule, Stage, counter_words};
use crate::scene::compiled::{CompiledScene, Uniforms};
use wgpu::BufferUsages;

pub struct MegakernelEngine {
    gpu: GpuFilm,
    bind: Option<wgpu::BindGroup>,
    pacer: Pacer,
    lengths: PathLengths,
    /// Paths per invocation, if the caller decides.
    grain: Option<u32>,
}

impl MegakernelEngine {
    pub fn new(
        gpu: Gpu,
        scene: &CompiledScene,
        uniforms: Uniforms,
        keys: Keys,
        options: &RenderOptions,
    ) -> Result<Self, RenderError> {
        let first = Workload::new(scene, &keys.own, uniforms.max_bounces, &gpu.summary).first_paths();
        let mut gpu =
            GpuFilm::new(gpu, scene, uniforms, keys, Stage::megakernel, Schedule::Fused, "megakernel")?;
        let usage = BufferUsages::STORAGE | BufferUsages::COPY_SRC | BufferUsages::COPY_DST;
        gpu.buffers.create(&gpu.gpu, "counters", 4 * u64::from(counter_words(&keys.own)), usage)?;
        let lengths = keys.lengths(uniforms.max_bounces);
        Ok(MegakernelEngine { gpu, bind: None, pacer: Pacer::new(first), lengths, grain: options.grain })
    }
}

/// Turns of all loops together after which llvmpipe ends every loop of an invocation, whatever its condition says: it
/// counts 65,535 for each group of eight invocations, and the first group of a workgroup takes all paths there are to take.
const SOFTWARE_TURNS: u32 = 60_000;

impl MegakernelEngine {
    /// Paths per invocation that the adapter can trace: on software few, so that its loops are not cut short. A walk through
    /// the hierarchy may take two turns a shape; among triangles that bound leaves no room for a second path.
    fn most_grain(&self, max_bounces: u32) -> u32 {
        if !self.gpu.gpu.summary.software {
            return u32::MAX;
        }
        if self.gpu.key.triangles {
            return 1;
        }
        let shapes = u64::from(self.gpu.uniforms.sphere_count) + u64::from(self.gpu.uniforms.quad_count);
        let turns_a_level = 1 + shapes * if self.gpu.key.bvh.is_some() { 4 } else { 2 };
        let turns_a_path = u64::from(max_bounces) * u64::from(self.gpu.key.places) * turns_a_level;
        let paths = u64::from(SOFTWARE_TURNS) / turns_a_path;
        1 + paths.saturating_sub(1) as u32 / (MEGAKERNEL_WORKGROUP / 8)
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
            let count = self.pacer.part(batch.paths() - path);
            let grain = self.grain.unwrap_or_else(|| self.lengths.paths_at_once(count));
            let shares = Shares::new(count, grain.min(self.most_grain(uniforms.max_bounces)));
            let Shares { grain, early_groups, late_grain } = shares;
            let part =
                Uniforms { first_path: path, path_count: count, grain, early_groups, late_grain, ..uniforms };
            self.gpu.write_uniforms(&part);
            let bind = self.bind.as_ref();
            let flight = self.gpu.launch(Some("counters"), |this, pass| {
                pass.set_pipeline(&this.kernels[&Stage::Megakernel].pipeline);
                pass.set_bind_group(0, bind, &[]);
                let [x, y] = grid_of(shares.groups(count));
                pass.dispatch_workgroups(x, y, 1);
            });
            self.gpu.receive_sums(film)?;
            let (counters, seconds): (Vec<u32>, f64) = self.gpu.land(flight, bytemuck::pod_collect_to_vec)?;
            self.pacer.observe(count.into(), seconds);
            path += count;
            rays = counters[Counter::Rays as usize];
            self.lengths.observe(u64::from(rays), u64::from(path));
        }
        self.gpu.stats.rays += u64::from(rays);
        Ok(true)
    }
}

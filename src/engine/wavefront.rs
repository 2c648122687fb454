//! The wavefront engine: a kernel per stage, rays in explicit bounded queues. The host records levels; the queues'
//! lengths stay on the GPU, where they become indirect arguments. docs/KERNELS.md tells the stages' contracts.

use super::auto::preferred_schedule;
use super::gpu_film::{GpuFilm, Keys};
use super::submissions::{Seen, Submission, Submissions, Work};
use super::tracer::Tracer;
use super::workload::Workload;
use super::{Batch, CancelToken, EngineKind, RenderError, RenderOptions};
use crate::film::Film;
use crate::gpu::device::Gpu;
use crate::gpu::error::GpuError;
use crate::gpu::key::KernelKey;
use crate::gpu::stage::{Counter, Schedule, Stage, argument_words, counter_words, length_rows, queue_names};
use crate::guiding::{Trail, Transition};
use crate::scene::compiled::{CompiledScene, Uniforms};
use crate::transport::items::{HitItem, RayItem, ShadowItem};
use wgpu::BufferUsages;

/// Rays that queues hold by kind of adapter, where --pool does not say. Each takes 96 bytes of queues, in the sorted schedule 24 more
/// for each material of the scene.
const POOL: u32 = 1 << 22;
const POOL_INTEGRATED: u32 = 1 << 20;
const POOL_SOFTWARE: u32 = 1 << 16;

/// Part of a pool that a level of the fused schedule traces at least, by longer visits where fewer rays are left. On an H100 a
/// fourth to a sixteenth were as good (docs/PERFORMANCE.md).
const LEAST_PART: u32 = 8;

pub struct WavefrontEngine {
    gpu: GpuFilm,
    schedule: Schedule,
    /// Stages of a level of the kernels in use, in order.
    level: Vec<Stage>,
    /// Bind groups of each stage of a level when it reads the first ray queue, and when it reads the second.
    binds: Vec<[wgpu::BindGroup; 2]>,
    pool: u32,
    submissions: Submissions,
}

/// Levels of a path that a visit may have on software, where rays walk through a hierarchy: llvmpipe ends loops early, and those of
/// walks have many turns. One level has not been cut short by any scene here, eight have by none of those shipped.
const SOFTWARE_WALKS: u32 = 8;

impl WavefrontEngine {
    pub fn new(
        gpu: Gpu,
        scene: &CompiledScene,
        uniforms: Uniforms,
        keys: Keys,
        options: &RenderOptions,
    ) -> Result<Self, RenderError> {
        let pool = options.pool.unwrap_or(match (gpu.summary.software, gpu.summary.integrated) {
            (true, _) => POOL_SOFTWARE,
            (_, true) => POOL_INTEGRATED,
            _ => POOL,
        });
        let schedule = preferred_schedule(&keys.own, options);
        let stages = |key: &KernelKey| Stage::wavefront(key, schedule);
        let gpu = GpuFilm::new(gpu, scene, uniforms, keys, stages, schedule, "wavefront")?;
        let lengths = keys.lengths(uniforms.max_bounces);
        let workload = Workload::new(scene, &keys.own, uniforms.max_bounces, &gpu.gpu.summary);
        let walks = gpu.gpu.summary.software && keys.own.bvh.is_some();
        let most_in_a_row = if walks { SOFTWARE_WALKS } else { uniforms.max_bounces };
        let first_rays = |levels| workload.first_rays(levels);
        let submissions = Submissions::new(schedule, options.grain, most_in_a_row, lengths, first_rays);
        Ok(WavefrontEngine { gpu, schedule, level: Vec::new(), binds: Vec::new(), pool, submissions })
    }

    /// Bytes of a ray or a shadow ray. Where something is learnt, they have a fourth row: what their path remembers.
    fn ray_bytes(&self) -> u64 {
        let trail = if self.gpu.may_learn() { size_of::<Trail>() } else { 0 };
        (size_of::<RayItem>().max(size_of::<ShadowItem>()) + trail) as u64
    }

    /// Bytes of all the hits that a ray may be in the queues of.
    fn hit_bytes(&self) -> u64 {
        let key = &self.gpu.key;
        let sorted = self.schedule == Schedule::Sorted;
        let queues = if sorted { key.material_queues() } else { key.hit_queues() };
        size_of::<HitItem>() as u64 * u64::from(queues)
    }

    /// Rays per queue for a batch: the pool, less if the batch has fewer, all copies counted, or a binding can't hold it.
    fn capacity(&self, batch: &Batch) -> u32 {
        let widest = self.hit_bytes().max(self.ray_bytes());
        let fitting = self.gpu.gpu.summary.max_binding.min(self.gpu.gpu.summary.max_buffer) / widest;
        let most = batch.paths().saturating_mul(self.gpu.key.places);
        self.pool.min(most).min(fitting.min(u64::from(u32::MAX)) as u32)
    }

    /// The queues that some kernel binds, at the capacity in the uniforms.
    fn create_queues(&mut self) -> Result<(), RenderError> {
        let capacity = u64::from(self.gpu.uniforms.capacity);
        let ray_bytes = self.ray_bytes();
        let sorted = self.schedule == Schedule::Sorted;
        let queue_bytes = [
            ("rays_a", ray_bytes, true),
            ("rays_b", ray_bytes, true),
            ("hits", self.hit_bytes(), self.gpu.is_bound("hits") && !sorted),
            ("hits_a", self.hit_bytes(), sorted),
            ("hits_b", self.hit_bytes(), sorted),
            ("shadows", ray_bytes, self.gpu.is_bound("shadows")),
            ("transitions", size_of::<Transition>() as u64, self.gpu.is_bound("transitions")),
        ];
        let usage = BufferUsages::STORAGE | BufferUsages::COPY_SRC | BufferUsages::COPY_DST;
        for (name, item_bytes, bound) in queue_bytes {
            if bound {
                self.gpu.buffers.create(&self.gpu.gpu, name, item_bytes * capacity, usage)?;
            }
        }
        let words = |count: u32| u64::from(count) * 4;
        let key = self.gpu.key;
        self.gpu.buffers.create(&self.gpu.gpu, "counters", words(counter_words(&key)), usage)?;
        self.gpu.buffers.create(
            &self.gpu.gpu,
            "lengths",
            words(4 * length_rows(&key)),
            usage | BufferUsages::UNIFORM,
        )?;
        self.gpu.buffers.create(
            &self.gpu.gpu,
            "arguments",
            words(argument_words(&key)),
            usage | BufferUsages::INDIRECT,
        )?;
        self.gpu.stats.buffers = self.gpu.buffers.bytes();
        Ok(())
    }

    /// Binds each stage for both roles of the two ray queues.
    fn bind_stages(&mut self) {
        self.level = Stage::wavefront(&self.gpu.key, self.schedule);
        self.level.retain(|stage| stage.is_in_level());
        let sorted = self.schedule == Schedule::Sorted;
        let bind = |stage: Stage, names: &[(&str, &str)]| self.gpu.bind(stage, names);
        self.binds = self
            .level
            .iter()
            .map(|&stage| {
                // Generation appends to the queue that the rest of the level reads.
                let out = |this, other| if stage == Stage::Generate { this } else { other };
                let roles = |this, other, hits, next| {
                    let rays = [("rays_in", this), ("rays_out", out(this, other))];
                    // Hits have two buffers only where a level makes the next one's.
                    let hits =
                        if sorted { [("hits", hits), ("hits_out", next)] } else { [("hits", "hits"); 2] };
                    bind(stage, &[rays, hits].concat())
                };
                [roles("rays_a", "rays_b", "hits_a", "hits_b"), roles("rays_b", "rays_a", "hits_b", "hits_a")]
            })
            .collect();
    }

    fn work(&self, batch: &Batch) -> Work {
        Work {
            paths: batch.paths(),
            pool: self.gpu.uniforms.capacity,
            places: self.gpu.key.places,
            max_bounces: self.gpu.uniforms.max_bounces,
        }
    }

    /// Submits `count` levels, the first of which is number `first`, and reads the counters behind them.
    fn submit_levels(
        &mut self,
        first: u32,
        count: u32,
        film: &mut Film,
    ) -> Result<(Vec<u32>, f64), RenderError> {
        let (level, binds) = (&self.level, &self.binds);
        let flight = self.gpu.launch(Some("counters"), |gpu, pass| {
            for i in first..first + count {
                record_level(gpu, level, binds, pass, (i % 2) as usize);
            }
        });
        self.gpu.receive_sums(film)?;
        self.gpu.land(flight, bytemuck::pod_collect_to_vec)
    }

    /// A queue that ran over is an error, never a darker image.
    fn check_overflow(&self, counters: &[u32]) -> Result<(), RenderError> {
        let overflow = counters[Counter::Overflow as usize];
        if overflow == 0 {
            return Ok(());
        }
        let names = queue_names(&self.gpu.key);
        let over = |i: &usize| overflow >> i & 1 == 1;
        let queues: Vec<&str> = (0..names.len()).filter(over).map(|i| names[i].as_str()).collect();
        Err(GpuError::QueueOverflow { queues: queues.join(", ") }.into())
    }
}

/// Records one level of all paths in flight; `parity` says which ray queue it reads.
fn record_level(
    gpu: &GpuFilm,
    level: &[Stage],
    binds: &[[wgpu::BindGroup; 2]],
    pass: &mut wgpu::ComputePass,
    parity: usize,
) {
    for (stage, binds) in level.iter().zip(binds) {
        pass.set_pipeline(&gpu.kernels[stage].pipeline);
        pass.set_bind_group(0, &binds[parity], &[]);
        match stage.argument(&gpu.key) {
            Some(slot) => {
                pass.dispatch_workgroups_indirect(gpu.buffers.get("arguments"), 12 * u64::from(slot));
            }
            None => pass.dispatch_workgroups(1, 1, 1),
        }
    }
}

impl Tracer for WavefrontEngine {
    const KIND: EngineKind = EngineKind::Wavefront;

    fn gpu(&self) -> &GpuFilm {
        &self.gpu
    }
    fn gpu_mut(&mut self) -> &mut GpuFilm {
        &mut self.gpu
    }

    fn prepare(&mut self, batch: &Batch) -> Result<(), RenderError> {
        let capacity = self.capacity(batch);
        let grown = self.gpu.reserve(batch)?;
        let more_capacity = self.gpu.uniforms.capacity < capacity;
        if more_capacity {
            self.gpu.uniforms.capacity = capacity;
            self.create_queues()?;
        }
        if grown || more_capacity || self.binds.is_empty() {
            self.bind_stages();
        }
        Ok(())
    }

    fn unbind(&mut self) {
        self.binds.clear();
    }

    /// Levels until the batch is done.
    fn trace(&mut self, batch: &Batch, film: &mut Film, cancel: &CancelToken) -> Result<bool, RenderError> {
        let uniforms = self.gpu.batch_uniforms(batch);
        let mut counters = vec![0u32; counter_words(&self.gpu.key) as usize];
        self.gpu.gpu.queue.write_buffer(self.gpu.buffers.get("counters"), 0, bytemuck::cast_slice(&counters));
        let (work, mut seen) = (self.work(batch), Seen::default());
        loop {
            if cancel.is_cancelled() {
                return Ok(false);
            }
            let submission = self.submissions.next(&work, &seen);
            let Submission { levels: count, rays, grain } = submission;
            let longest_visit = self.submissions.longest_visit(&work);
            let least_rays = work.pool / LEAST_PART;
            self.gpu.write_uniforms(&Uniforms {
                capacity: rays,
                grain,
                longest_visit,
                least_rays,
                ..uniforms
            });
            let (status, seconds) = self.submit_levels(seen.levels, count, film)?;
            counters = status;
            self.check_overflow(&counters)?;
            let counter = |c: Counter| counters[c as usize];
            let now = Seen {
                levels: seen.levels + count,
                started: counter(Counter::NextPath),
                flying: counter(Counter::Survivors),
                rays: counter(Counter::Rays),
            };
            self.submissions.learn(&work, &submission, &seen, &now, seconds);
            seen = now;
            let flying = seen.flying + counter(Counter::Shadows) + counter(Counter::Transitions);
            if flying == 0 && seen.started == work.paths {
                break;
            }
            if seen.levels > work.most_levels() {
                return Err(GpuError::NoProgress { levels: seen.levels, flying }.into());
            }
        }
        // Not those that were recorded: some had nothing to do.
        self.submissions.end_batch(counters[Counter::Levels as usize]);
        self.gpu.stats.iterations += u64::from(seen.levels);
        self.gpu.stats.rays += u64::from(seen.rays);
        Ok(true)
    }
}

/// Here since it holds an engine still in the midst of a level.
#[path = "recorded.rs"]
pub mod recorded;

#[cfg(test)]
#[path = "wavefront_tests.rs"]
mod tests;

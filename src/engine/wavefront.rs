//! The wavefront engine: a kernel per stage, rays in explicit bounded queues. The host records levels; the queues'
//! lengths stay on the GPU, where they become indirect arguments. docs/KERNELS.md tells the stages' contracts.

use super::auto::preferred_schedule;
use super::gpu_film::{GpuFilm, Keys};
use super::pacing::{Pacer, PathLengths, Progress, UNKNOWN_LEVELS, VisitLengths};
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
/// level of so many takes about twice what an empty one does; a fourth to a sixteenth were as good (docs/PERFORMANCE.md).
const LEAST_PART: u32 = 8;

pub struct WavefrontEngine {
    gpu: GpuFilm,
    schedule: Schedule,
    /// Stages of a level of the kernels in use, in order.
    level: Vec<Stage>,
    /// Bind groups of each stage of a level when it reads the first ray queue, and when it reads the second.
    binds: Vec<[wgpu::BindGroup; 2]>,
    pool: u32,
    /// In places of a queue, times levels of a path.
    pacer: Pacer,
    lengths: PathLengths,
    /// Levels of a path that a visit traces, if the caller decides.
    grain: Option<u32>,
    /// Of the sorted schedule.
    visits: VisitLengths,
    /// Levels that the last batch needed, 0 before the first: how many to record at first.
    expected_levels: u32,
}

/// Levels of a path that a visit may have on software, where rays walk through a hierarchy.
const SOFTWARE_WALKS: u32 = 8;

/// What is submitted at once.
struct Submission {
    levels: u32,
    /// Rays that are in flight in each, at most.
    rays: u32,
    /// Levels of its path that a visit to a ray traces: of `step` at least, of `follow_*` at most.
    grain: u32,
}

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
        let visits = VisitLengths::unknown();
        let first = workload.first_rays(levels_a_visit(schedule, options.grain, &lengths, visits).1);
        Ok(WavefrontEngine {
            gpu,
            schedule,
            level: Vec::new(),
            binds: Vec::new(),
            pool,
            pacer: Pacer::new(first),
            lengths,
            grain: options.grain,
            visits,
            expected_levels: 0,
        })
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

    /// Levels after which any batch is done: the pool is filled again at the latest when all its paths are at their end. It
    /// holds as many paths as it has room for all their copies.
    fn most_levels(&self, batch: &Batch) -> u32 {
        let paths = self.gpu.uniforms.capacity / self.gpu.key.places;
        let fillings = batch.paths().div_ceil(paths) + 1;
        // Copies wait a level at each split on their way, which at least halves the places that they own.
        let waits = self.gpu.key.places.next_power_of_two().ilog2();
        fillings * (self.gpu.uniforms.max_bounces + waits + 1) + 4
    }

    /// What to submit after `level` levels, which left these counters.
    fn next_submission(&self, batch: &Batch, level: u32, counters: &[u32]) -> Submission {
        let amount = self.pacer.amount();
        let pool = self.gpu.uniforms.capacity;
        let (mut grain, mut reckoned) = self.levels_a_visit();
        // A level is submitted whole, so it is the levels of a visit that must not be too many.
        while self.grain.is_none() && reckoned > 1 && u64::from(pool) * u64::from(reckoned) > amount {
            reckoned /= 2;
            grain = grain.min(if self.schedule == Schedule::Sorted { 2 * reckoned } else { reckoned });
        }
        let (mut rays, mut left) = (pool, self.levels_left(batch, level, counters, reckoned));
        if self.leaves_none(grain) && counters[Counter::Survivors as usize] == 0 {
            let waiting = batch.paths() - counters[Counter::NextPath as usize];
            rays = pool.max((amount / u64::from(grain)).min(u64::from(waiting)) as u32);
            left = waiting.div_ceil(rays);
        }
        let in_time = amount / (u64::from(rays) * u64::from(reckoned));
        let levels = u64::from(left.min(self.most_levels(batch))).min(in_time).max(1);
        Submission { levels: levels as u32, rays, grain }
    }

    /// Levels of a path that a visit traces: `grain`, if the caller decides, and how many to reckon with.
    fn levels_a_visit(&self) -> (u32, u32) {
        let (grain, reckoned) = levels_a_visit(self.schedule, self.grain, &self.lengths, self.visits);
        let most = self.most_levels_a_visit();
        (grain.min(most), reckoned.min(most))
    }

    /// Levels of a path that the adapter can trace in a row. On software loops end early, and walks through a hierarchy have many
    /// turns: so many levels were never cut short.
    fn most_levels_a_visit(&self) -> u32 {
        let walks = self.gpu.gpu.summary.software && self.gpu.key.bvh.is_some();
        self.gpu.uniforms.max_bounces.min(if walks { SOFTWARE_WALKS } else { u32::MAX })
    }

    /// Whether visits of so many levels trace paths to their ends. None comes back to a queue then, so there may be more at once
    /// than a queue holds.
    fn leaves_none(&self, grain: u32) -> bool {
        self.schedule == Schedule::Fused && self.gpu.key.places == 1 && grain >= self.gpu.uniforms.max_bounces
    }

    /// Levels that are left after `level` of them: as many as the last batch needed, or by what is seen of this one.
    fn levels_left(&self, batch: &Batch, level: u32, counters: &[u32], reckoned: u32) -> u32 {
        let visit = if self.schedule == Schedule::Sorted { (reckoned / 2).max(1) } else { reckoned };
        match self.expected_levels.saturating_sub(level) {
            0 if level == 0 => UNKNOWN_LEVELS,
            0 => {
                let counter = |c: Counter| counters[c as usize];
                let progress = Progress {
                    levels: level,
                    paths: batch.paths(),
                    started: counter(Counter::NextPath),
                    flying: counter(Counter::Survivors),
                    visits: counter(Counter::Rays) / visit,
                };
                progress.levels_left()
            }
            expected => expected,
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

    /// Learns how long a submission took, in which so many rays were traced.
    fn learn_pace(&mut self, submission: &Submission, traced: u64, seconds: f64) {
        let visits = u64::from(submission.levels) * u64::from(submission.rays);
        let full = visits * u64::from(submission.grain);
        let (amount, least) = match self.schedule {
            // Most visits end before their last level: what was traced took that long.
            Schedule::Sorted => (traced, visits),
            _ if self.leaves_none(submission.grain) => (full, visits),
            _ => (full, full),
        };
        // Levels that were nearly empty say nothing of full ones, unless even they took too long.
        if 2 * traced >= least || seconds > Pacer::TARGET {
            self.pacer.observe(amount, seconds);
        }
        // A batch begins with fresh paths alone, whose visits end with their camera rays.
        if submission.levels > 1 {
            self.visits.observe(traced, visits);
        }
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

/// The same for any adapter.
fn levels_a_visit(
    schedule: Schedule,
    grain: Option<u32>,
    lengths: &PathLengths,
    visits: VisitLengths,
) -> (u32, u32) {
    let both = |levels: u32| (levels, levels);
    match schedule {
        Schedule::Fused => both(grain.unwrap_or_else(|| lengths.levels_at_once())),
        Schedule::Sorted => grain.map_or((visits.most(), visits.reckoned()), both),
        Schedule::Streamed | Schedule::Compacted => both(1),
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
        let mut level = 0;
        loop {
            if cancel.is_cancelled() {
                return Ok(false);
            }
            let submission = self.next_submission(batch, level, &counters);
            let Submission { levels: count, rays, grain } = submission;
            let longest_visit = if self.grain.is_some() { grain } else { self.most_levels_a_visit() };
            let least_rays = uniforms.capacity / LEAST_PART;
            self.gpu.write_uniforms(&Uniforms {
                capacity: rays,
                grain,
                longest_visit,
                least_rays,
                ..uniforms
            });
            let (status, seconds) = self.submit_levels(level, count, film)?;
            let traced = status[Counter::Rays as usize].saturating_sub(counters[Counter::Rays as usize]);
            self.learn_pace(&submission, u64::from(traced), seconds);
            level += count;
            counters = status;
            self.check_overflow(&counters)?;
            let counter = |c: Counter| counters[c as usize];
            let flying =
                counter(Counter::Survivors) + counter(Counter::Shadows) + counter(Counter::Transitions);
            // At least so many: where paths split, several survivors may be of one.
            let ended = counter(Counter::NextPath).saturating_sub(counter(Counter::Survivors));
            self.lengths.observe(u64::from(counter(Counter::Rays)), u64::from(ended));
            if flying == 0 && counter(Counter::NextPath) == batch.paths() {
                break;
            }
            if level > self.most_levels(batch) {
                return Err(GpuError::NoProgress { levels: level, flying }.into());
            }
        }
        // Not those that were recorded: some had nothing to do.
        self.expected_levels = counters[Counter::Levels as usize];
        self.gpu.stats.iterations += u64::from(level);
        self.gpu.stats.rays += u64::from(counters[Counter::Rays as usize]);
        Ok(true)
    }
}

/// Here since it holds an engine still in the midst of a level.
#[path = "recorded.rs"]
pub mod recorded;

#[cfg(test)]
#[path = "wavefront_tests.rs"]
mod tests;

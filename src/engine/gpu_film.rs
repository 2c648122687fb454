//! What both GPU engines share: the scene's buffers, the radiance of a batch, its sums, its way to the host.

use super::gpu_guide::GpuLessons;
use super::pacing::PathLengths;
use super::strategy::Pass;
use super::{Batch, RenderError, RenderStats};
use crate::film::{BlockSum, Film};
use crate::gpu::buffers::Buffers;
use crate::gpu::device::Gpu;
use crate::gpu::error::GpuError;
use crate::gpu::kernel::Kernel;
use crate::gpu::key::KernelKey;
use crate::gpu::link::link;
use crate::gpu::stage::{GRID_WIDTH, Schedule, Stage, WORKGROUP};
use crate::scene::compiled::{CompiledScene, Uniforms};
use crate::scene::rows;
use crate::transport::roulette::Roulette;
use rayon::prelude::*;
use std::collections::HashMap;
use std::time::Instant;
use wgpu::BufferUsages;

/// Bytes before the sums: the number of samples that were lost.
const LOST_BYTES: u64 = 4;
/// Bytes of radiance per path, and where paths split per place.
const RADIANCE_BYTES: u64 = 12;
/// Paths of a batch by kind of adapter: enough to fill it, few enough that a step stays short.
const BATCH_PATHS: u64 = 1 << 25;
const BATCH_PATHS_INTEGRATED: u64 = 1 << 22;
const BATCH_PATHS_SOFTWARE: u64 = 1 << 18;

/// A GPU with a scene on it, and everything that does not depend on how paths are scheduled.
pub struct GpuFilm {
    pub gpu: Gpu,
    /// What the kernels in use can do.
    pub key: KernelKey,
    pub kernels: HashMap<Stage, Kernel>,
    /// Kernels for other passes: those that only ask the table, those that do without.
    pub(super) spares: Vec<KernelSet>,
    pub buffers: Buffers,
    pub uniforms: Uniforms,
    pub stats: RenderStats,
    /// Paths of the largest batch.
    pub max_paths: u32,
    /// Bytes of radiance that a path has, in whatever pass.
    path_bytes: u64,
    resolve_bind: Option<wgpu::BindGroup>,
    clock: Clock,
    /// Sums on their way to the host.
    pending: Option<(Batch, Flight)>,
    sums_staging: Option<wgpu::Buffer>,
    /// What learning needs at a pass's end.
    pub(super) lessons: GpuLessons,
}

/// What the kernels of a render must be able to do: its own, and where plain tracing is tried too, that.
#[derive(Clone, Copy, Debug)]
pub struct Keys {
    pub own: KernelKey,
    pub plain: Option<KernelKey>,
}

impl Keys {
    /// What these kernels say of the lengths of paths.
    pub fn lengths(&self, max_bounces: u32) -> PathLengths {
        PathLengths::unknown(max_bounces, self.own.roulette != Roulette::Off, self.own.direct_light)
    }
}

/// Kernels, and what they can do.
pub(super) type KernelSet = (KernelKey, HashMap<Stage, Kernel>);

/// The kernels that each key needs, compiled side by side: a guide that is only tried needs three sets (still-life on an H100 with
/// 16 cores: 0.27 s until all is ready, 1.2 s one after the other).
fn compile_all(
    gpu: &Gpu,
    keys: &[KernelKey],
    stages: impl Fn(&KernelKey) -> Vec<Stage>,
    schedule: Schedule,
) -> Result<Vec<KernelSet>, RenderError> {
    let of = |set: usize| stages(&keys[set]).into_iter().map(move |stage| (set, stage));
    let wanted: Vec<(usize, Stage)> = (0..keys.len()).flat_map(of).collect();
    let compile = |(set, stage): (usize, Stage)| {
        let wgsl = link(stage, &keys[set], schedule).map_err(GpuError::from)?;
        Ok((set, stage, gpu.kernel(&stage.name(), &wgsl)?))
    };
    let kernels: Vec<_> = wanted.into_par_iter().map(compile).collect::<Result<_, RenderError>>()?;
    let mut sets: Vec<KernelSet> = keys.iter().map(|&key| (key, HashMap::new())).collect();
    for (set, stage, kernel) in kernels {
        sets[set].1.insert(stage, kernel);
    }
    Ok(sets)
}

/// The GPU's own clock around each submission, where it has one.
struct Clock {
    queries: Option<wgpu::QuerySet>,
    ticks: Option<wgpu::Buffer>,
}

impl GpuFilm {
    pub fn new(
        gpu: Gpu,
        scene: &CompiledScene,
        uniforms: Uniforms,
        keys: Keys,
        stages: impl Fn(&KernelKey) -> Vec<Stage>,
        schedule: Schedule,
        engine: &str,
    ) -> Result<GpuFilm, RenderError> {
        let frozen = keys.own.teaches.then(|| keys.own.frozen());
        let all: Vec<KernelKey> = [keys.own].into_iter().chain(frozen).chain(keys.plain).collect();
        let mut spares = compile_all(&gpu, &all, &stages, schedule)?;
        let (key, kernels) = spares.remove(0);
        let pixels = u64::from(uniforms.width) * u64::from(uniforms.height);
        let batch = match (gpu.summary.software, gpu.summary.integrated) {
            (true, _) => BATCH_PATHS_SOFTWARE,
            (_, true) => BATCH_PATHS_INTEGRATED,
            _ => BATCH_PATHS,
        };
        // With one sample per pixel, the sums take more than the radiance.
        let path_bytes = RADIANCE_BYTES * u64::from(key.places);
        let widest = path_bytes.max(size_of::<BlockSum>() as u64);
        let limit = (gpu.summary.max_binding.min(gpu.summary.max_buffer) - 16) / widest;
        // A pass over all pixels in one batch where that is possible at all, and never more than will be asked for. Places
        // count as paths do: a batch with splitting takes no more memory.
        let places = batch.max(pixels.min(1 << 25)).min(u64::from(u32::MAX));
        let max_paths = (places / u64::from(key.places)).min(limit) as u32;
        let clock = Clock::new(&gpu);
        let mut film = GpuFilm {
            stats: RenderStats {
                engine: engine.to_string(),
                device: gpu.summary.name.clone(),
                kernel_key: key.to_string(),
                kernels: stages(&key).iter().map(|s| s.name()).collect(),
                ..Default::default()
            },
            gpu,
            key,
            kernels,
            spares,
            buffers: Buffers::default(),
            uniforms,
            max_paths,
            path_bytes,
            resolve_bind: None,
            clock,
            pending: None,
            sums_staging: None,
            lessons: GpuLessons::default(),
        };
        film.upload_scene(scene)?;
        Ok(film)
    }

    /// Whether any kernel binds a buffer of this name.
    pub fn is_bound(&self, name: &str) -> bool {
        let spares = self.spares.iter().flat_map(|(_, kernels)| kernels.values());
        self.kernels.values().chain(spares).any(|k| k.bindings.iter().any(|(_, bound)| bound == name))
    }

    /// Whether anything may be learnt, by the kernels in use or the others.
    pub fn may_learn(&self) -> bool {
        self.key.teaches || self.spares.iter().any(|(key, _)| key.teaches)
    }

    /// Takes the kernels for a pass; true if others were in use.
    pub fn set_pass(&mut self, pass: &Pass) -> bool {
        self.uniforms.roulette_scale = pass.strategy.roulette_scale;
        let fits =
            |key: &KernelKey| key.guide.is_some() == pass.strategy.informed && key.teaches == pass.teaches();
        if fits(&self.key) {
            return false;
        }
        if let Some((key, kernels)) = self.spares.iter_mut().find(|(key, _)| fits(key)) {
            std::mem::swap(&mut self.key, key);
            std::mem::swap(&mut self.kernels, kernels);
        }
        self.resolve_bind = self.buffers.size("block_sums").map(|_| self.bind(Stage::Resolve, &[]));
        true
    }

    fn upload_scene(&mut self, scene: &CompiledScene) -> Result<(), RenderError> {
        let summary = &self.gpu.summary;
        let (bytes, limit) = (rows::bytes(scene), summary.max_binding.min(summary.max_buffer));
        if bytes > limit {
            return Err(GpuError::SceneTooLarge { adapter: summary.name.clone(), bytes, limit }.into());
        }
        let arrays = [
            ("scene_rows", rows::pack(scene), BufferUsages::STORAGE),
            ("hot_rows", rows::hot(scene), BufferUsages::UNIFORM),
        ];
        for (name, rows, usage) in arrays {
            if self.is_bound(name) {
                self.buffers.upload(&self.gpu, name, &bytes_of(&rows), usage)?;
            }
        }
        let size = size_of::<Uniforms>() as u64;
        let usage = BufferUsages::UNIFORM | BufferUsages::COPY_DST;
        Ok(self.buffers.create(&self.gpu, "uniforms", size, usage)?)
    }

    /// Makes the radiance and the sums large enough for `batch`; true if bind groups must be made anew.
    pub fn reserve(&mut self, batch: &Batch) -> Result<bool, RenderError> {
        let radiance = u64::from(batch.paths()) * self.path_bytes;
        let sums = sums_bytes(batch);
        let have = self.buffers.bytes();
        let enough = |name: &str, bytes: u64| have.get(name).is_some_and(|&b| b >= bytes);
        if enough("radiance", radiance) && enough("block_sums", sums) {
            return Ok(false);
        }
        let usage = BufferUsages::STORAGE | BufferUsages::COPY_SRC;
        self.buffers.create(&self.gpu, "radiance", radiance, usage)?;
        self.buffers.create(&self.gpu, "block_sums", sums, usage | BufferUsages::COPY_DST)?;
        self.stats.buffers = self.buffers.bytes();
        self.resolve_bind = Some(self.bind(Stage::Resolve, &[]));
        Ok(true)
    }

    /// Binds the buffers of a stage, with some renamed; see [`Kernel::bind`].
    pub fn bind(&self, stage: Stage, renamed: &[(&str, &str)]) -> wgpu::BindGroup {
        self.kernels[&stage].bind(&self.gpu, &self.buffers, renamed)
    }

    /// Pixels of the image.
    pub fn pixels(&self) -> u32 {
        self.uniforms.width * self.uniforms.height
    }

    /// The uniforms of a batch.
    pub fn batch_uniforms(&self, batch: &Batch) -> Uniforms {
        Uniforms {
            first_pixel: batch.first_pixel,
            pixel_count: batch.pixel_count,
            first_sample: batch.first_sample,
            sample_count: batch.sample_count,
            path_count: batch.paths(),
            first_path: 0,
            ..self.uniforms
        }
    }

    pub fn write_uniforms(&self, uniforms: &Uniforms) {
        self.gpu.queue.write_buffer(self.buffers.get("uniforms"), 0, bytemuck::bytes_of(uniforms));
    }

    /// Records one compute pass and submits it with a copy of `status` behind it, without waiting: [`GpuFilm::land`] does.
    pub fn launch(
        &mut self,
        status: Option<&str>,
        record: impl FnOnce(&GpuFilm, &mut wgpu::ComputePass),
    ) -> Flight {
        let copied = status.map(|name| self.buffers.get(name)).map(|buffer| (buffer.clone(), buffer.size()));
        let bytes = copied.as_ref().map_or(0, |(_, bytes)| *bytes);
        let staging = self.staging(bytes + TICK_BYTES);
        self.launch_into(staging, copied, record)
    }

    /// A buffer that the host can read.
    pub(super) fn staging(&self, size: u64) -> wgpu::Buffer {
        self.gpu.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("staging"),
            size,
            usage: BufferUsages::MAP_READ | BufferUsages::COPY_DST,
            mapped_at_creation: false,
        })
    }

    fn launch_into(
        &mut self,
        staging: wgpu::Buffer,
        copied: Option<(wgpu::Buffer, u64)>,
        record: impl FnOnce(&GpuFilm, &mut wgpu::ComputePass),
    ) -> Flight {
        let start = Instant::now();
        let mut encoder = self.gpu.device.create_command_encoder(&Default::default());
        {
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
                label: None,
                timestamp_writes: self.clock.writes(),
            });
            record(self, &mut pass);
        }
        let mut bytes = 0;
        if let Some((buffer, size)) = copied {
            encoder.copy_buffer_to_buffer(&buffer, 0, &staging, 0, size);
            bytes = size;
        }
        self.clock.resolve(&mut encoder, &staging, bytes);
        let submission = self.gpu.queue.submit([encoder.finish()]);
        staging.map_async(wgpu::MapMode::Read, ..bytes + TICK_BYTES, |_| ());
        self.stats.submissions += 1;
        Flight { submission, staging, bytes, start }
    }

    /// Waits for a flight, hands what it copied to `receive`, and returns the seconds that it took on the GPU (by the host's
    /// clock where the GPU has none).
    pub fn land<T>(
        &mut self,
        flight: Flight,
        receive: impl FnOnce(&[u8]) -> T,
    ) -> Result<(T, f64), RenderError> {
        self.gpu.wait_for(flight.submission)?;
        let view = flight.staging.slice(..flight.bytes + TICK_BYTES).get_mapped_range();
        let view = view.map_err(|e| GpuError::DeviceLost {
            adapter: self.gpu.summary.name.clone(),
            reason: e.to_string(),
        })?;
        let (copied, ticks) = view.split_at(flight.bytes as usize);
        let seconds = match self.clock.queries.is_some() {
            true => {
                let ticks: [u64; 2] = bytemuck::pod_read_unaligned(ticks);
                let period = f64::from(self.gpu.queue.get_timestamp_period());
                ticks[1].saturating_sub(ticks[0]) as f64 * period * 1e-9
            }
            false => flight.start.elapsed().as_secs_f64(),
        };
        let received = receive(copied);
        drop(view);
        flight.staging.unmap();
        self.stats.gpu_seconds += seconds;
        Ok((received, seconds))
    }

    /// Sums the batch's radiance per pixel and block, and sends the sums on their way to the host, where
    /// [`GpuFilm::receive_sums`] takes them: the GPU can trace the next batch meanwhile.
    pub fn send_sums(&mut self, batch: &Batch) {
        let bind = self.resolve_bind.clone();
        let items = batch.pixel_count * batch.blocks();
        let bytes = sums_bytes(batch);
        // Kept from batch to batch: a new one of tens of megabytes costs milliseconds of page faults.
        let staging = match self.sums_staging.take() {
            Some(staging) if staging.size() >= bytes + TICK_BYTES => staging,
            _ => self.staging(bytes + TICK_BYTES),
        };
        let sums = self.buffers.get("block_sums").clone();
        self.gpu.queue.write_buffer(&sums, 0, &[0; LOST_BYTES as usize]);
        let flight = self.launch_into(staging, Some((sums, bytes)), |this, pass| {
            pass.set_pipeline(&this.kernels[&Stage::Resolve].pipeline);
            pass.set_bind_group(0, bind.as_ref(), &[]);
            let [x, y] = grid(items);
            pass.dispatch_workgroups(x, y, 1);
        });
        self.pending = Some((*batch, flight));
    }

    /// Adds the sums that are on their way, if any, to the host's film.
    pub fn receive_sums(&mut self, film: &mut Film) -> Result<(), RenderError> {
        let Some((batch, flight)) = self.pending.take() else { return Ok(()) };
        let staging = flight.staging.clone();
        let (lost, _) = self.land(flight, |bytes| {
            let (lost, bytes) = bytes.split_at(LOST_BYTES as usize);
            let size = batch.pixel_count as usize * size_of::<BlockSum>();
            for (block, sums) in bytes.chunks(size).enumerate() {
                let samples = batch.block_samples(block as u32);
                film.add_block(batch.first_pixel as usize, samples, bytemuck::cast_slice(sums));
            }
            bytemuck::pod_read_unaligned::<u32>(lost)
        })?;
        self.stats.lost_samples += u64::from(lost);
        self.sums_staging = Some(staging);
        self.stats.paths += u64::from(batch.paths());
        Ok(())
    }

    /// Forgets sums on their way: after a failure they may never come.
    pub fn forget_sums(&mut self) {
        self.pending = None;
    }
}

/// Bytes of the sums of a batch, and of what lies before them.
fn sums_bytes(batch: &Batch) -> u64 {
    LOST_BYTES + u64::from(batch.pixel_count * batch.blocks()) * size_of::<BlockSum>() as u64
}

/// Bytes of the two time stamps behind what a flight copies.
const TICK_BYTES: u64 = 16;

/// A submission on its way, and what it brings back.
pub struct Flight {
    submission: wgpu::SubmissionIndex,
    staging: wgpu::Buffer,
    /// Bytes copied, before the time stamps.
    bytes: u64,
    start: Instant,
}

/// The bytes of `items`, or of one zeroed item: no binding may be empty.
fn bytes_of<T: bytemuck::Pod>(items: &[T]) -> Vec<u8> {
    if items.is_empty() { vec![0; size_of::<T>()] } else { bytemuck::cast_slice(items).to_vec() }
}

impl Clock {
    fn new(gpu: &Gpu) -> Clock {
        let queries = gpu.summary.timestamps.then(|| {
            gpu.device.create_query_set(&wgpu::QuerySetDescriptor {
                label: Some("clock"),
                ty: wgpu::QueryType::Timestamp,
                count: 2,
            })
        });
        let ticks = gpu.summary.timestamps.then(|| {
            gpu.device.create_buffer(&wgpu::BufferDescriptor {
                label: Some("ticks"),
                size: TICK_BYTES,
                usage: BufferUsages::QUERY_RESOLVE | BufferUsages::COPY_SRC,
                mapped_at_creation: false,
            })
        });
        Clock { queries, ticks }
    }

    fn writes(&self) -> Option<wgpu::ComputePassTimestampWrites<'_>> {
        self.queries.as_ref().map(|query_set| wgpu::ComputePassTimestampWrites {
            query_set,
            beginning_of_pass_write_index: Some(0),
            end_of_pass_write_index: Some(1),
        })
    }

    /// Copies the two time stamps to `offset` of `to`.
    fn resolve(&self, encoder: &mut wgpu::CommandEncoder, to: &wgpu::Buffer, offset: u64) {
        if let (Some(queries), Some(ticks)) = (&self.queries, &self.ticks) {
            encoder.resolve_query_set(queries, 0..2, ticks, 0);
            encoder.copy_buffer_to_buffer(ticks, 0, to, offset, TICK_BYTES);
        }
    }
}

/// Workgroups of the two-dimensional grid for `items` invocations.
pub fn grid(items: u32) -> [u32; 2] {
    grid_of(items.div_ceil(WORKGROUP))
}

/// … of so many in all, whatever their size.
pub fn grid_of(groups: u32) -> [u32; 2] {
    [groups.min(GRID_WIDTH), groups.div_ceil(GRID_WIDTH)]
}

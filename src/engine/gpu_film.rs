//! What both GPU engines share: the scene's buffers, the radiance of a batch, its sums, its way to the host.

use super::{Batch, RenderError, RenderStats};
use crate::film::{BlockSum, Film};
use crate::gpu::buffers::Buffers;
use crate::gpu::device::Gpu;
use crate::gpu::kernel::Kernel;
use crate::gpu::key::KernelKey;
use crate::gpu::link::link;
use crate::gpu::stage::{GRID_WIDTH, Schedule, Stage, WORKGROUP};
use crate::guiding::{GuideTable, GuideUniforms, LessonLayout, Lessons};
use crate::scene::compiled::{CompiledScene, Uniforms};
use crate::scene::rows;
use std::collections::HashMap;
use std::time::Instant;
use wgpu::BufferUsages;

/// Bytes of radiance per path.
const RADIANCE_BYTES: u64 = 12;
/// Paths of a batch by kind of adapter: enough to fill it, few enough that a step stays short.
const BATCH_PATHS: u64 = 1 << 25;
const BATCH_PATHS_INTEGRATED: u64 = 1 << 22;
const BATCH_PATHS_SOFTWARE: u64 = 1 << 18;

/// A GPU with a scene on it, and everything that does not depend on how paths are scheduled.
pub struct GpuFilm {
    pub gpu: Gpu,
    pub key: KernelKey,
    pub kernels: HashMap<Stage, Kernel>,
    pub buffers: Buffers,
    pub uniforms: Uniforms,
    pub stats: RenderStats,
    /// Paths of the largest batch.
    pub max_paths: u32,
    resolve_bind: Option<wgpu::BindGroup>,
    clock: Clock,
    /// How the sums of what is learnt lie in their buffer.
    lessons: LessonLayout,
}

/// The GPU's own clock around each submission, where it has one.
struct Clock {
    queries: Option<wgpu::QuerySet>,
}

impl GpuFilm {
    pub fn new(
        gpu: Gpu,
        scene: &CompiledScene,
        uniforms: Uniforms,
        key: KernelKey,
        stages: &[Stage],
        schedule: Schedule,
        engine: &str,
    ) -> Result<GpuFilm, RenderError> {
        let mut kernels = HashMap::new();
        for &stage in stages {
            let wgsl = link(stage, &key, schedule).map_err(crate::gpu::error::GpuError::from)?;
            kernels.insert(stage, gpu.kernel(&stage.name(), &wgsl)?);
        }
        let pixels = u64::from(uniforms.width) * u64::from(uniforms.height);
        let batch = match (gpu.summary.software, gpu.summary.integrated) {
            (true, _) => BATCH_PATHS_SOFTWARE,
            (_, true) => BATCH_PATHS_INTEGRATED,
            _ => BATCH_PATHS,
        };
        // With one sample per pixel, the sums take more than the radiance.
        let widest = RADIANCE_BYTES.max(size_of::<BlockSum>() as u64);
        let limit = gpu.summary.max_binding.min(gpu.summary.max_buffer) / widest;
        // A pass over all pixels in one batch where that is possible at all, and never more than will be asked for.
        let max_paths = batch.max(pixels.min(1 << 25)).min(limit).min(u64::from(u32::MAX)) as u32;
        let clock = Clock::new(&gpu);
        let mut film = GpuFilm {
            stats: RenderStats {
                engine: engine.to_string(),
                device: gpu.summary.name.clone(),
                kernel_key: key.to_string(),
                kernels: stages.iter().map(|s| s.name()).collect(),
                ..Default::default()
            },
            gpu,
            key,
            kernels,
            buffers: Buffers::default(),
            uniforms,
            max_paths,
            resolve_bind: None,
            clock,
            lessons: LessonLayout::default(),
        };
        film.upload_scene(scene)?;
        Ok(film)
    }

    /// Whether any kernel binds a buffer of this name.
    pub fn is_bound(&self, name: &str) -> bool {
        self.kernels.values().any(|k| k.bindings.iter().any(|(_, bound)| bound == name))
    }

    fn upload_scene(&mut self, scene: &CompiledScene) -> Result<(), RenderError> {
        let (arrays, usage) = match self.key.small_scene {
            Some(_) => (arrays_of(scene), BufferUsages::UNIFORM),
            None => (vec![("scene_rows", bytes_of(&rows::pack(scene)))], BufferUsages::STORAGE),
        };
        for (name, data) in arrays {
            if self.is_bound(name) {
                self.buffers.upload(&self.gpu, name, &data, usage)?;
            }
        }
        let size = size_of::<Uniforms>() as u64;
        let usage = BufferUsages::UNIFORM | BufferUsages::COPY_DST;
        Ok(self.buffers.create(&self.gpu, "uniforms", size, usage)?)
    }

    /// Makes the radiance and the sums large enough for `batch`; true if bind groups must be made anew.
    pub fn reserve(&mut self, batch: &Batch) -> Result<bool, RenderError> {
        let radiance = u64::from(batch.paths()) * RADIANCE_BYTES;
        let sums = u64::from(batch.pixel_count * batch.blocks()) * size_of::<BlockSum>() as u64;
        let have = self.buffers.bytes();
        let enough = |name: &str, bytes: u64| have.get(name).is_some_and(|&b| b >= bytes);
        if enough("radiance", radiance) && enough("block_sums", sums) {
            return Ok(false);
        }
        let usage = BufferUsages::STORAGE | BufferUsages::COPY_SRC;
        self.buffers.create(&self.gpu, "radiance", radiance, usage)?;
        self.buffers.create(&self.gpu, "block_sums", sums, usage)?;
        self.stats.buffers = self.buffers.bytes();
        self.resolve_bind = Some(self.bind(Stage::Resolve, &[]));
        Ok(true)
    }

    /// Uploads a table and clears the sums; true if bind groups must be made anew.
    pub fn set_guide(&mut self, table: &GuideTable) -> Result<bool, RenderError> {
        if !self.is_bound("guide_rows") {
            return Ok(false);
        }
        self.lessons = LessonLayout::new(&table.uniforms);
        let (storage, uniform) = (BufferUsages::STORAGE | BufferUsages::COPY_DST, BufferUsages::UNIFORM);
        let wanted = [
            ("guide_rows", 16 * table.rows.len() as u64, storage),
            ("guide", size_of::<GuideUniforms>() as u64, uniform | BufferUsages::COPY_DST),
            ("lessons", 4 * self.lessons.words(), storage | BufferUsages::COPY_SRC),
        ];
        let mut grown = false;
        for (name, bytes, usage) in wanted {
            if self.is_bound(name) && self.buffers.size(name).is_none_or(|size| size < bytes) {
                // Tables grow from pass to pass: room to spare keeps the buffers for some passes.
                let room = if name == "guide" { bytes } else { bytes + bytes / 2 };
                let room = room.min(self.gpu.summary.max_binding.max(bytes));
                self.buffers.create(&self.gpu, name, room, usage)?;
                grown = true;
            }
        }
        let queue = &self.gpu.queue;
        queue.write_buffer(self.buffers.get("guide_rows"), 0, bytemuck::cast_slice(&table.rows));
        queue.write_buffer(self.buffers.get("guide"), 0, bytemuck::bytes_of(&table.uniforms));
        if self.is_bound("lessons") {
            let mut encoder = self.gpu.device.create_command_encoder(&Default::default());
            encoder.clear_buffer(self.buffers.get("lessons"), 0, None);
            queue.submit([encoder.finish()]);
        }
        self.stats.buffers = self.buffers.bytes();
        self.gpu.check()?;
        Ok(grown)
    }

    /// What was learnt since the table was put in place.
    pub fn take_lessons(&mut self) -> Result<Lessons, RenderError> {
        if !self.is_bound("lessons") {
            return Ok(Lessons::default());
        }
        let bytes = (4 * self.lessons.words()).max(4);
        let words = self.gpu.read(&[(self.buffers.get("lessons"), bytes)])?;
        Ok(Lessons::from_words(self.lessons, &bytemuck::pod_collect_to_vec::<u8, u32>(&words[0])))
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

    /// Records one compute pass, submits it with a copy of `status` behind it, waits, and returns the status and the
    /// seconds that it took on the GPU (by the host's clock where the GPU has none).
    pub fn submit(
        &mut self,
        status: Option<&str>,
        record: impl FnOnce(&GpuFilm, &mut wgpu::ComputePass),
    ) -> Result<(Vec<u8>, f64), RenderError> {
        let start = Instant::now();
        let mut encoder = self.gpu.device.create_command_encoder(&Default::default());
        {
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
                label: None,
                timestamp_writes: self.clock.writes(),
            });
            record(self, &mut pass);
        }
        let mut readback = Vec::new();
        if let Some(name) = status {
            let buffer = self.buffers.get(name);
            readback.push((buffer, buffer.size()));
        }
        let ticks = self.clock.resolve(&self.gpu, &mut encoder);
        self.gpu.queue.submit([encoder.finish()]);
        if let Some(ticks) = &ticks {
            readback.push((ticks, ticks.size()));
        }
        let mut copies = self.gpu.read(&readback)?;
        let seconds = match ticks.and_then(|_| copies.pop()) {
            Some(bytes) => {
                let ticks: &[u64] = bytemuck::cast_slice(&bytes);
                let period = f64::from(self.gpu.queue.get_timestamp_period());
                ticks[1].saturating_sub(ticks[0]) as f64 * period * 1e-9
            }
            None => start.elapsed().as_secs_f64(),
        };
        self.stats.submissions += 1;
        self.stats.gpu_seconds += seconds;
        Ok((copies.pop().unwrap_or_default(), seconds))
    }

    /// Sums the batch's radiance per pixel and block, and adds the sums to the host's film.
    pub fn resolve(&mut self, batch: &Batch, film: &mut Film) -> Result<(), RenderError> {
        let bind = self.resolve_bind.clone();
        let items = batch.pixel_count * batch.blocks();
        let (bytes, _) = self.submit(Some("block_sums"), |this, pass| {
            let kernel = &this.kernels[&Stage::Resolve];
            pass.set_pipeline(&kernel.pipeline);
            pass.set_bind_group(0, bind.as_ref(), &[]);
            let [x, y] = grid(items);
            pass.dispatch_workgroups(x, y, 1);
        })?;
        let size = size_of::<BlockSum>();
        for block in 0..batch.blocks() {
            let begin = (block * batch.pixel_count) as usize * size;
            let sums = &bytes[begin..begin + batch.pixel_count as usize * size];
            let sums: Vec<BlockSum> = bytemuck::pod_collect_to_vec(sums);
            film.add_block(batch.first_pixel as usize, batch.block_samples(block), &sums);
        }
        self.stats.paths += u64::from(batch.paths());
        Ok(())
    }
}

/// The arrays of a small scene, by the names of their buffers.
fn arrays_of(scene: &CompiledScene) -> Vec<(&'static str, Vec<u8>)> {
    vec![
        ("spheres", bytes_of(&scene.spheres)),
        ("quads", bytes_of(&scene.quads)),
        ("materials", bytes_of(&scene.materials)),
        ("lights", bytes_of(&scene.lights)),
    ]
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
        Clock { queries }
    }

    fn writes(&self) -> Option<wgpu::ComputePassTimestampWrites<'_>> {
        self.queries.as_ref().map(|query_set| wgpu::ComputePassTimestampWrites {
            query_set,
            beginning_of_pass_write_index: Some(0),
            end_of_pass_write_index: Some(1),
        })
    }

    fn resolve(&self, gpu: &Gpu, encoder: &mut wgpu::CommandEncoder) -> Option<wgpu::Buffer> {
        let queries = self.queries.as_ref()?;
        let ticks = gpu.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("ticks"),
            size: 16,
            usage: BufferUsages::QUERY_RESOLVE | BufferUsages::COPY_SRC,
            mapped_at_creation: false,
        });
        encoder.resolve_query_set(queries, 0..2, &ticks, 0);
        Some(ticks)
    }
}

/// Workgroups of the two-dimensional grid for `items` invocations.
pub fn grid(items: u32) -> [u32; 2] {
    let groups = items.div_ceil(WORKGROUP);
    [groups.min(GRID_WIDTH), groups.div_ceil(GRID_WIDTH)]
}

/// How much work to submit at once: grows or shrinks so that a submission takes [`Pacer::TARGET`] seconds, short enough
/// that no driver takes the GPU for hung. It changes what is submitted together, never what is computed.
pub struct Pacer {
    amount: f64,
}

impl Pacer {
    /// Seconds of a submission; drivers on laptops reset a GPU that is busy for about two.
    const TARGET: f64 = 0.08;

    pub fn new(first: u32) -> Pacer {
        Pacer { amount: f64::from(first) }
    }

    pub fn amount(&self) -> u32 {
        self.amount as u32
    }

    /// Learns that `amount` took `seconds`.
    pub fn observe(&mut self, amount: u32, seconds: f64) {
        let fitting = f64::from(amount) * Self::TARGET / seconds.max(1e-6);
        // An amount that was cut short says little about larger ones: grow at most eightfold from what was seen.
        let grown = fitting.min(f64::from(amount) * 8.0);
        if grown > self.amount || fitting < self.amount {
            self.amount = grown.clamp(1.0, f64::from(u32::MAX));
        }
    }
}

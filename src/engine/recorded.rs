//! A level of the wavefront engine, held still: each of its stages can be run on the same queues again and again, to time it.
//! For benches and tests; renders don't come here.

use super::super::batch::full_batch;
use super::super::gpu_film::grid;
use super::super::guided::Guided;
use super::*;
use crate::guiding::GuideTable;
use crate::scene::Scene;

/// What a level changes, but for radiance and the sums of what is learnt: adding to those once more takes as long.
const CHANGED: [&str; 10] = [
    "counters",
    "lengths",
    "arguments",
    "rays_a",
    "rays_b",
    "hits",
    "hits_a",
    "hits_b",
    "shadows",
    "transitions",
];

/// A stage of a level, and how much work was waiting for it.
#[derive(Clone, Debug, PartialEq)]
pub struct RecordedStage {
    pub name: String,
    pub stage: Stage,
    /// Items that it works on; 1 for the stages that run once a level.
    pub items: u64,
}

/// The queues of a render as they were before one stage of one level.
pub struct RecordedLevel {
    engine: WavefrontEngine,
    batch: Batch,
    /// Names and copies of what the stage may change.
    saved: Vec<(&'static str, wgpu::Buffer)>,
    counters: Vec<u32>,
    /// What the level was told that it has to do, once it is prepared.
    lengths: Vec<u32>,
    /// What guides paths, if anything does.
    table: Option<GuideTable>,
    /// Which ray queue the level reads.
    parity: usize,
    /// Place of the stage in the level; `resolve` comes behind the last.
    place: usize,
}

impl RecordedLevel {
    /// Renders the first batch up to level number `level` (0 has nothing but fresh paths), and stops before its first stage.
    /// Whatever learns starts from the table in the options, without one from an empty one.
    pub fn record(scene: &Scene, options: &RenderOptions, level: u32) -> Result<RecordedLevel, RenderError> {
        options.validate(scene)?;
        let compiled = CompiledScene::with_instances(scene, options.instances);
        let (width, height) = options.size.unwrap_or((scene.camera.width, scene.camera.height));
        let estimators = options.estimators(scene);
        let uniforms = Uniforms {
            max_bounces: estimators.max_bounces,
            roulette_scale: estimators.roulette_scale,
            ..compiled.uniforms(&scene.camera, width, height, options.seed)
        };
        let keys = Keys { own: KernelKey::new(&compiled, &estimators), plain: None };
        let gpu = Gpu::open(options.adapter.as_deref())?;
        let mut engine = WavefrontEngine::new(gpu, &compiled, uniforms, keys, options)?;
        let guided = Guided::start(options, estimators, &compiled, &uniforms, &mut engine)?;
        let unknown = vec![0.0; (width * height) as usize];
        let table = guided.map(|guided| guided.learner().table(true, &unknown));
        let batch = full_batch(width * height, engine.gpu.max_paths);
        engine.prepare(&batch)?;
        engine.gpu.write_uniforms(&engine.gpu.batch_uniforms(&batch));
        let counters = vec![0u32; counter_words(&engine.gpu.key) as usize];
        engine.gpu.gpu.queue.write_buffer(
            engine.gpu.buffers.get("counters"),
            0,
            bytemuck::cast_slice(&counters),
        );
        let parity = (level % 2) as usize;
        let saved = Vec::new();
        let mut recorded =
            RecordedLevel { engine, batch, saved, counters, lengths: Vec::new(), table, parity, place: 0 };
        for before in 0..level {
            (recorded.counters, _) =
                recorded.engine.submit_levels(before, 1, &mut Film::new(width, height))?;
        }
        recorded.make_copies();
        recorded.save()?;
        Ok(recorded)
    }

    /// What it runs on.
    pub fn device(&self) -> &str {
        &self.engine.gpu.stats.device
    }

    /// Whether times are by the GPU's own clock; else by the host's, the way to the GPU and back included.
    pub fn has_clock(&self) -> bool {
        self.engine.gpu.gpu.summary.timestamps
    }

    /// The stage that the queues wait for; None behind the last.
    pub fn stage(&self) -> Option<RecordedStage> {
        let stage = self.current()?;
        let key = &self.engine.gpu.key;
        let counter = |at: Counter| u64::from(self.counters[at as usize]);
        let hits = |queue: u32| u64::from(self.counters[(Counter::FirstHit as u32 + queue) as usize]);
        let length = |queue: u32| u64::from(self.lengths[(Counter::FirstHit as u32 + queue) as usize]);
        let items = match stage {
            Stage::Generate => counter(Counter::Live) - counter(Counter::FreshBegin),
            Stage::Intersect | Stage::Compact | Stage::Step => counter(Counter::Live),
            // Paths of the level that stand at surfaces of that kind; all others, and fresh ones.
            Stage::Follow(kind) => length(key.hit_queue(kind)),
            Stage::FollowOthers => {
                let own = key.own_kernel().map_or(0, |kind| length(key.hit_queue(kind)));
                counter(Counter::Live) - own
            }
            Stage::Shadow => counter(Counter::ShadowsLive),
            Stage::Learn => counter(Counter::TransitionsLive),
            Stage::Environment => hits(key.hit_queues() - 1),
            Stage::Shade(kind) => hits(key.hit_queue(kind)),
            Stage::Resolve => u64::from(self.batch.paths()),
            _ => 1,
        };
        Some(RecordedStage { name: stage.name(), stage, items })
    }

    /// Runs the stage once on the queues as they were before it, and returns its seconds. Copying the queues back is not in
    /// them.
    pub fn run(&mut self) -> Result<f64, RenderError> {
        let Some(stage) = self.current() else { return Ok(0.0) };
        self.restore()?;
        let resolve = (stage == Stage::Resolve).then(|| self.engine.gpu.bind(stage, &[]));
        let (level, binds) = (&self.engine.level, &self.engine.binds);
        let (place, parity) = (self.place, self.parity);
        let threads = self.batch.pixel_count * self.batch.blocks();
        let flight = self.engine.gpu.launch(Some("counters"), |gpu, pass| match resolve {
            None => record_level(gpu, &level[place..=place], &binds[place..=place], pass, parity),
            Some(bind) => {
                pass.set_pipeline(&gpu.kernels[&stage].pipeline);
                pass.set_bind_group(0, &bind, &[]);
                let [x, y] = grid(threads);
                pass.dispatch_workgroups(x, y, 1);
            }
        });
        let (counters, seconds) = self.engine.gpu.land(flight, bytemuck::pod_collect_to_vec)?;
        self.counters = counters;
        if stage == Stage::PrepareRays {
            self.lengths = self.words("lengths")?.unwrap_or_default();
        }
        self.engine.check_overflow(&self.counters)?;
        Ok(seconds)
    }

    /// Runs the stage for good: the queues are as they are before the next one.
    pub fn advance(&mut self) -> Result<(), RenderError> {
        self.run()?;
        self.place += 1;
        self.save()
    }

    /// Goes on to the first stage of the next level. All stages of this one but `resolve`, which changes no queue, must be
    /// behind it.
    pub fn next_level(&mut self) {
        assert_eq!(self.current(), Some(Stage::Resolve), "the level is not at its end");
        (self.place, self.parity) = (0, 1 - self.parity);
    }

    /// The words of a buffer as the next stage finds it, by the name that kernels call it (where hits have two buffers, those of
    /// this level are `hits_in`): `rays_in` are the rays of this level. None if there is no such buffer.
    pub fn words(&self, name: &str) -> Result<Option<Vec<u32>>, RenderError> {
        let rays = ["rays_a", "rays_b"];
        let name = match name {
            "rays_in" => rays[self.parity],
            "rays_out" => rays[1 - self.parity],
            "hits_in" => ["hits_a", "hits_b"][self.parity],
            "hits_out" => ["hits_a", "hits_b"][1 - self.parity],
            name => name,
        };
        let Some(bytes) = self.engine.gpu.buffers.size(name) else { return Ok(None) };
        let read = self.engine.gpu.gpu.read(&[(self.engine.gpu.buffers.get(name), bytes)])?;
        Ok(Some(bytemuck::pod_collect_to_vec(&read[0])))
    }

    /// What the kernels are told of the batch.
    pub fn uniforms(&self) -> Uniforms {
        self.engine.gpu.batch_uniforms(&self.batch)
    }

    /// What the kernels were linked for.
    pub fn key(&self) -> &KernelKey {
        &self.engine.gpu.key
    }

    /// The table that guides paths.
    pub fn table(&self) -> Option<&GuideTable> {
        self.table.as_ref()
    }

    fn current(&self) -> Option<Stage> {
        let level = &self.engine.level;
        level.iter().copied().chain([Stage::Resolve]).nth(self.place)
    }

    fn make_copies(&mut self) {
        let (gpu, buffers) = (&self.engine.gpu.gpu, &self.engine.gpu.buffers);
        let copy = |name: &'static str| {
            let copy = gpu.device.create_buffer(&wgpu::BufferDescriptor {
                label: Some(name),
                size: buffers.size(name)?,
                usage: BufferUsages::COPY_SRC | BufferUsages::COPY_DST,
                mapped_at_creation: false,
            });
            Some((name, copy))
        };
        self.saved = CHANGED.into_iter().filter_map(copy).collect();
    }

    fn save(&self) -> Result<(), RenderError> {
        self.copy(|live, saved| (live, saved))
    }

    fn restore(&self) -> Result<(), RenderError> {
        self.copy(|live, saved| (saved, live))
    }

    /// Copies between the live buffers and the saved ones, and waits.
    fn copy(
        &self,
        direction: for<'a> fn(&'a wgpu::Buffer, &'a wgpu::Buffer) -> (&'a wgpu::Buffer, &'a wgpu::Buffer),
    ) -> Result<(), RenderError> {
        let gpu = &self.engine.gpu.gpu;
        let mut encoder = gpu.device.create_command_encoder(&Default::default());
        for (name, saved) in &self.saved {
            let (from, to) = direction(self.engine.gpu.buffers.get(name), saved);
            encoder.copy_buffer_to_buffer(from, 0, to, 0, saved.size());
        }
        gpu.queue.submit([encoder.finish()]);
        Ok(gpu.wait()?)
    }
}

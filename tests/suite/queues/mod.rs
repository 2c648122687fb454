//! Queue laws on the GPU itself: single kernels on queues made by hand, read back, and whole levels of real renders. What is
//! pushed is there exactly once, what is not is not, and what does not fit is reported.

mod committing;
mod compaction;
mod hits;
mod learning;
mod levels;
mod paths;
mod sorted;

use crate::support::{estimators, open_gpu, scene};
use bytemuck::Zeroable;
use glam::Vec3;
use proptest::prelude::*;
use proptest::test_runner::{RngAlgorithm, TestRng, TestRunner};
use qtracer::gpu::buffers::Buffers;
use qtracer::gpu::device::Gpu;
use qtracer::gpu::kernel::Kernel;
use qtracer::gpu::key::KernelKey;
use qtracer::gpu::link::link;
use qtracer::gpu::stage::{Counter, Schedule, Stage, WORKGROUP, counter_words};
use qtracer::guiding::GuideMode;
use qtracer::scene::compiled::{CompiledScene, NONE, Uniforms};
use qtracer::transport::estimators::Estimators;
use qtracer::transport::items::RayItem;
use qtracer::transport::roulette::Roulette;
use std::collections::BTreeSet;
use wgpu::BufferUsages;

/// Draws the same questions in every run, and no more than `cases`: each is a dispatch.
fn runner(cases: u32) -> TestRunner {
    let config = ProptestConfig { cases, failure_persistence: None, ..Default::default() };
    TestRunner::new_with_rng(config, TestRng::deterministic_rng(RngAlgorithm::ChaCha))
}

/// What slots hold that no kernel wrote.
const UNTOUCHED: u32 = 0xdead_beef;

/// One kernel, to be run on queues made by hand.
struct Harness {
    gpu: Gpu,
    kernel: Kernel,
    key: KernelKey,
}

impl Harness {
    fn new(stage: Stage, scene: &CompiledScene, schedule: Schedule) -> Harness {
        Harness::guided(stage, scene, schedule, GuideMode::Off)
    }

    fn guided(stage: Stage, scene: &CompiledScene, schedule: Schedule, guide: GuideMode) -> Harness {
        Harness::with(stage, scene, schedule, estimators(guide, Roulette::Throughput))
    }

    fn with(stage: Stage, scene: &CompiledScene, schedule: Schedule, estimators: Estimators) -> Harness {
        let gpu = open_gpu();
        let key = KernelKey::new(scene, &estimators);
        let kernel = gpu.kernel(&stage.name(), &link(stage, &key, schedule).unwrap()).unwrap();
        Harness { gpu, kernel, key }
    }

    /// Runs `groups` workgroups on these buffers and returns the contents of those in `wanted`.
    fn run(
        &self,
        uniforms: Uniforms,
        contents: &[(&str, &[u8])],
        groups: u32,
        wanted: &[&str],
    ) -> Vec<Vec<u8>> {
        let mut buffers = Buffers::default();
        buffers.upload(&self.gpu, "uniforms", bytemuck::bytes_of(&uniforms), BufferUsages::UNIFORM).unwrap();
        // As if the level had been prepared, unless that is what is asked.
        let lengths = contents.iter().find(|(name, _)| *name == "counters").map(|(_, counters)| {
            let mut lengths = counters.to_vec();
            lengths.resize(counters.len().next_multiple_of(16), 0);
            lengths
        });
        let prepared = lengths.as_ref().map(|lengths| ("lengths", lengths.as_slice()));
        let told = contents.iter().any(|(name, _)| *name == "lengths");
        for (name, data) in contents.iter().copied().chain(prepared.filter(|_| !told)) {
            // What every ray reads of small scenes is a uniform buffer.
            let uniform = matches!(name, "hot_rows" | "guide" | "lengths");
            let uniform = if uniform { BufferUsages::UNIFORM } else { BufferUsages::empty() };
            let usage = BufferUsages::STORAGE | BufferUsages::COPY_SRC | uniform;
            buffers.upload(&self.gpu, name, data, usage).unwrap();
        }
        let bind = self.kernel.bind(&self.gpu, &buffers, &[]);
        let mut encoder = self.gpu.device.create_command_encoder(&Default::default());
        {
            let mut pass = encoder.begin_compute_pass(&Default::default());
            pass.set_pipeline(&self.kernel.pipeline);
            pass.set_bind_group(0, &bind, &[]);
            pass.dispatch_workgroups(groups, 1, 1);
        }
        self.gpu.queue.submit([encoder.finish()]);
        let size = |name: &str| contents.iter().find(|(n, _)| *n == name).unwrap().1.len() as u64;
        let wanted: Vec<_> = wanted.iter().map(|name| (buffers.get(name), size(name))).collect();
        self.gpu.read(&wanted).unwrap()
    }

    /// Counters at zero but for these.
    fn counters(&self, set: &[(Counter, u32)]) -> Vec<u32> {
        let mut counters = vec![0; counter_words(&self.key) as usize];
        set.iter().for_each(|&(counter, value)| counters[counter as usize] = value);
        counters
    }
}

fn words(bytes: &[u8]) -> Vec<u32> {
    bytemuck::pod_collect_to_vec(bytes)
}

/// A ray that can be told from all others in every field.
fn marked_ray(i: u32, path: u32) -> RayItem {
    let x = i as f32;
    RayItem {
        origin: Vec3::new(x, 2.0 * x, 3.0 * x),
        path,
        direction: Vec3::new(-x, 0.5, x),
        bounce: i % 64,
        throughput: Vec3::new(0.25 * x, x, 1.0),
        pdf: 7.0 + x,
    }
}

/// Words past the end of a queue that no kernel may touch.
const TAIL: usize = 64;

/// A queue of rays as it lies in a buffer: a plane of `capacity` slots for each row of four words, then a tail. Slots
/// without a ray are untouched.
fn to_planes(rays: &[RayItem], first: usize, capacity: u32) -> Vec<u32> {
    let mut planes = vec![UNTOUCHED; 12 * capacity as usize + TAIL];
    for (i, ray) in rays.iter().enumerate() {
        let words: &[u32] = bytemuck::cast_slice(std::slice::from_ref(ray));
        for row in 0..3 {
            let at = 4 * (row * capacity as usize + first + i);
            planes[at..at + 4].copy_from_slice(&words[4 * row..4 * row + 4]);
        }
    }
    planes
}

/// The rays of a queue; untouched slots give [`untouched_ray`].
fn from_planes(planes: &[u32], capacity: u32) -> Vec<RayItem> {
    let ray = |slot: usize| {
        let row = |row: usize| &planes[4 * (row * capacity as usize + slot)..][..4];
        bytemuck::pod_read_unaligned(bytemuck::cast_slice(&[row(0), row(1), row(2)].concat()))
    };
    (0..capacity as usize).map(ray).collect()
}

fn untouched_ray() -> RayItem {
    bytemuck::cast([UNTOUCHED; 12])
}

fn is_untouched(ray: &RayItem) -> bool {
    bytemuck::bytes_of(ray) == bytemuck::bytes_of(&untouched_ray())
}

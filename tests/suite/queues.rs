//! Queue laws on the GPU itself: single kernels on recorded queues, read back. What is pushed is there exactly once,
//! what is not is not, and what does not fit is reported.

use crate::support::{estimators, open_gpu, scene};
use crate::tables::learnt;
use bytemuck::Zeroable;
use glam::Vec3;
use proptest::prelude::*;
use proptest::test_runner::TestRunner;
use qtracer::gpu::buffers::Buffers;
use qtracer::gpu::device::Gpu;
use qtracer::gpu::kernel::Kernel;
use qtracer::gpu::key::KernelKey;
use qtracer::gpu::link::link;
use qtracer::gpu::stage::{
    Argument, Counter, GRID_WIDTH, Schedule, Stage, WORKGROUP, argument_words, counter_words,
};
use qtracer::guiding::{GuideMode, LessonLayout, LessonSums, Lessons, Transition, lessons};
use qtracer::scene::compiled::{CompiledScene, NONE, Sphere, Uniforms};
use qtracer::scene::rows;
use qtracer::scene::shapes::{Ray, intersect, shape_info};
use qtracer::transport::estimators::Estimators;
use qtracer::transport::items::{HitItem, RayItem};
use qtracer::transport::roulette::Roulette;
use std::collections::BTreeSet;
use wgpu::BufferUsages;

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
        for (name, data) in contents {
            // What every ray reads of small scenes is a uniform buffer.
            let uniform = matches!(*name, "hot_rows" | "guide");
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

/// Compacts the rays that are marked live behind `already` others. The counters and the queue afterwards.
fn compact(harness: &Harness, live: &[bool], already: u32, capacity: u32) -> (Vec<u32>, Vec<RayItem>) {
    let rays: Vec<RayItem> =
        live.iter().zip(0..).map(|(&live, i)| marked_ray(i, if live { i } else { NONE })).collect();
    let counters = harness.counters(&[(Counter::Live, live.len() as u32), (Counter::Survivors, already)]);
    let read = harness.run(
        Uniforms { capacity, ..Uniforms::zeroed() },
        &[
            ("counters", bytemuck::cast_slice(&counters)),
            ("rays_in", bytemuck::cast_slice(&to_planes(&rays, 0, capacity))),
            ("rays_out", bytemuck::cast_slice(&to_planes(&[], 0, capacity))),
        ],
        // More than the rays need: invocations past the end must do nothing.
        live.len().div_ceil(WORKGROUP as usize) as u32 + 1,
        &["counters", "rays_out"],
    );
    let planes = words(&read[1]);
    assert!(
        planes[12 * capacity as usize..].iter().all(|w| *w == UNTOUCHED),
        "wrote past the end of the queue"
    );
    (words(&read[0]), from_planes(&planes, capacity))
}

/// What is wrong with a compaction, if anything.
fn compaction_fault(live: &[bool], already: u32, counters: &[u32], queue: &[RayItem]) -> Option<String> {
    let expected: BTreeSet<u32> = live.iter().zip(0..).filter(|(live, _)| **live).map(|(_, i)| i).collect();
    let end = already as usize + expected.len();
    if counters[Counter::Survivors as usize] as usize != end {
        return Some(format!("{} survivors for {end}", counters[Counter::Survivors as usize]));
    }
    if counters[Counter::Overflow as usize] != 0 {
        return Some(format!("overflow {:b}", counters[Counter::Overflow as usize]));
    }
    let found: Vec<u32> = queue[already as usize..end].iter().map(|ray| ray.path).collect();
    let distinct: BTreeSet<u32> = found.iter().copied().collect();
    if distinct.len() != found.len() || distinct != expected {
        return Some(format!("{found:?} for {expected:?}"));
    }
    if let Some(ray) = queue[already as usize..end].iter().find(|ray| **ray != marked_ray(ray.path, ray.path))
    {
        return Some(format!("{ray:?} was changed"));
    }
    let outside = queue[..already as usize].iter().chain(&queue[end..]);
    outside.into_iter().any(|ray| !is_untouched(ray)).then(|| "wrote outside its slots".to_string())
}

#[test]
fn compaction_keeps_each_live_path_exactly_once() {
    let harness =
        Harness::new(Stage::Compact, &CompiledScene::new(&scene("cornell-box")), Schedule::Compacted);
    let edges: Vec<(Vec<bool>, u32)> = [0, 1, 255, 256, 257, 1000]
        .iter()
        .flat_map(|&n| [(vec![true; n], 0), (vec![false; n], 3), ((0..n).map(|i| i % 3 == 0).collect(), 300)])
        .collect();
    let mut runner = TestRunner::new_with_rng(
        ProptestConfig { cases: 24, failure_persistence: None, ..Default::default() },
        proptest::test_runner::TestRng::deterministic_rng(proptest::test_runner::RngAlgorithm::ChaCha),
    );
    let strategy = (0.0..1.0f64, 0usize..1500, 0u32..600).prop_flat_map(|(share, n, already)| {
        (prop::collection::vec(prop::bool::weighted(share), n), Just(already))
    });
    runner
        .run(&strategy, |(live, already)| {
            let (counters, queue) = compact(&harness, &live, already, 4096);
            prop_assert_eq!(compaction_fault(&live, already, &counters, &queue), None);
            Ok(())
        })
        .unwrap();
    for (live, already) in edges {
        let (counters, queue) = compact(&harness, &live, already, 4096);
        assert_eq!(compaction_fault(&live, already, &counters, &queue), None, "{} rays", live.len());
    }
}

/// Negative control: a path lost, doubled, changed or put beyond the end is found.
#[test]
fn a_faulty_compaction_is_found() {
    let harness =
        Harness::new(Stage::Compact, &CompiledScene::new(&scene("cornell-box")), Schedule::Compacted);
    let live: Vec<bool> = (0..600).map(|i| i % 2 == 0).collect();
    let (counters, queue) = compact(&harness, &live, 5, 4096);
    assert_eq!(compaction_fault(&live, 5, &counters, &queue), None);
    type Fault<'a> = &'a dyn Fn(&mut [u32], &mut [RayItem]);
    let faults: [Fault; 5] = [
        &|counters, _| counters[Counter::Survivors as usize] -= 1,
        &|counters, _| counters[Counter::Overflow as usize] = 2,
        &|_, queue| queue[7] = queue[8],
        &|_, queue| queue[7].pdf += 1.0,
        &|_, queue| queue[304 + 5] = marked_ray(1, 1),
    ];
    for (i, fault) in faults.iter().enumerate() {
        let (mut counters, mut queue) = (counters.clone(), queue.clone());
        fault(&mut counters, &mut queue);
        assert!(compaction_fault(&live, 5, &counters, &queue).is_some(), "fault {i} was not found");
    }
}

/// What does not fit is not written anywhere, and the queue's bit says so.
#[test]
fn a_push_past_capacity_sets_the_overflow_bit_and_writes_nothing_beyond() {
    let harness =
        Harness::new(Stage::Compact, &CompiledScene::new(&scene("cornell-box")), Schedule::Compacted);
    for (live, already, capacity, overflows) in [
        (600, 0, 599, true),
        (600, 0, 600, false),
        (600, 100, 650, true),
        (1, 700, 700, true),
        (0, 700, 700, false),
    ] {
        let (counters, queue) = compact(&harness, &vec![true; live], already, capacity);
        let bit = u32::from(overflows) << Counter::Survivors as u32;
        assert_eq!(counters[Counter::Overflow as usize], bit, "{live} behind {already} in {capacity}");
        let written = queue.iter().filter(|ray| !is_untouched(ray)).count() as u32;
        assert_eq!(written, (live as u32).min(capacity - already));
        assert!(queue[..already as usize].iter().all(is_untouched), "wrote over what was there already");
    }
}

/// Twin of refine_sphere_distance: what shading makes of the distance in the queue.
fn refined(ray: &RayItem, sphere: &Sphere, t: f32) -> f32 {
    let f = ray.origin - sphere.center;
    let b = -f.dot(ray.direction);
    let sum = b.abs() + (t - b).abs();
    if t.abs() >= 0.5 * sum {
        return t;
    }
    let refined = (f.dot(f) - sphere.radius * sphere.radius) / sum.copysign(b);
    if refined > 0.0 { refined } else { t }
}

/// Every ray lands in the queue of its hit's material, misses in the environment's, each once; and the hit is the CPU's
/// but for rays within rounding of an edge.
#[test]
fn intersection_pushes_every_ray_to_exactly_one_queue() {
    for name in
        ["bansal-room-1", "cornell-box", "glossy-box", "furnace-open-half", "door-ajar", "many-lights"]
    {
        let compiled = CompiledScene::new(&scene(name));
        let harness = Harness::new(Stage::Intersect, &compiled, Schedule::Streamed);
        let camera = scene(name).camera;
        let rays: Vec<RayItem> = (0..3000u32)
            .map(|i| {
                // Directions on a spiral over the sphere, from the camera.
                let z = 1.0 - (2.0 * i as f32 + 1.0) / 3000.0;
                let (sin, cos) = (2.399_963 * i as f32).sin_cos();
                let r = (1.0 - z * z).sqrt();
                let direction = Vec3::new(r * cos, r * sin, z);
                RayItem { origin: camera.origin.as_vec3(), direction, path: i, ..RayItem::zeroed() }
            })
            .collect();
        let capacity = 3000;
        let queues = harness.key.hit_queues() as usize;
        let uniforms = Uniforms { capacity, ..compiled.uniforms(&camera, 1, 1, 0) };
        let hits = vec![UNTOUCHED; 3 * queues * capacity as usize];
        let rays_in = to_planes(&rays, 0, capacity);
        let counters = harness.counters(&[(Counter::Live, rays.len() as u32)]);
        let mut contents: Vec<(&str, &[u8])> = vec![
            ("counters", bytemuck::cast_slice(&counters)),
            ("rays_in", bytemuck::cast_slice(&rays_in)),
            ("hits", bytemuck::cast_slice(&hits)),
        ];
        let (rows, hot) = (rows::pack(&compiled), rows::hot(&compiled));
        contents.push(("scene_rows", bytemuck::cast_slice(&rows)));
        contents.push(("hot_rows", bytemuck::cast_slice(&hot)));
        let read = harness.run(uniforms, &contents, 3000u32.div_ceil(WORKGROUP), &["counters", "hits"]);
        let (counters, hits) = (words(&read[0]), words(&read[1]));
        // A plane of all queues for each of the three words.
        let hit = |queue: usize, i: usize| {
            let word = |plane: usize| hits[(queue + plane * queues) * capacity as usize + i];
            HitItem { slot: word(0), shape: word(1), t: f32::from_bits(word(2)) }
        };

        assert_eq!(counters[Counter::Overflow as usize], 0);
        let (mut seen, mut differing) = (BTreeSet::new(), 0);
        for queue in 0..queues {
            let length = counters[Counter::FirstHit as usize + queue] as usize;
            for (i, item) in (0..capacity as usize).map(|i| hit(queue, i)).enumerate() {
                assert_eq!(i < length, item.slot != UNTOUCHED, "{name}: queue {queue} is not dense");
                if i >= length {
                    continue;
                }
                assert!(seen.insert(item.slot), "{name}: ray {} was pushed twice", item.slot);
                let expected = match item.shape {
                    NONE => harness.key.hit_queues() - 1,
                    shape => harness.key.hit_queue(shape_info(&compiled, shape).kind),
                };
                assert_eq!(queue as u32, expected, "{name}: {item:?}");
                let ray = &rays[item.slot as usize];
                let cpu = intersect(&compiled, Ray { origin: ray.origin, direction: ray.direction });
                let same = match cpu {
                    None => item.shape == NONE,
                    Some(hit) => {
                        let t = match compiled.spheres.get(hit.shape as usize) {
                            Some(sphere) => refined(ray, sphere, item.t),
                            None => item.t,
                        };
                        hit.shape == item.shape && (hit.t - t).abs() <= 1e-5 * hit.t.max(1.0)
                    }
                };
                differing += usize::from(!same);
            }
        }
        let misses = rays.iter().filter(|ray| {
            intersect(&compiled, Ray { origin: ray.origin, direction: ray.direction }).is_none()
        });
        let dark = if harness.key.environment { 0 } else { misses.count() };
        assert!(
            seen.len().abs_diff(3000 - dark) <= 3,
            "{name}: {} of {} rays pushed",
            seen.len(),
            3000 - dark
        );
        assert!(differing <= 3, "{name}: {differing} hits differ from the CPU's");
    }
}

/// The step between two levels: survivors and fresh paths fill the pool exactly, no path is started twice or never, and
/// the dispatch arguments cover every item.
#[test]
fn preparing_a_level_fills_the_pool_and_loses_no_path() {
    let harness =
        Harness::new(Stage::PrepareRays, &CompiledScene::new(&scene("cornell-box")), Schedule::Streamed);
    let mut runner = TestRunner::new_with_rng(
        ProptestConfig { cases: 40, failure_persistence: None, ..Default::default() },
        proptest::test_runner::TestRng::deterministic_rng(proptest::test_runner::RngAlgorithm::ChaCha),
    );
    let strategy = (1u32..1 << 25, 0.0..=1.0f64, 0u32..1 << 25, 0.0..=1.0f64, 0.0..=1.0f64);
    runner
        .run(&strategy, |(capacity, full, paths, begun, shadowed)| {
            let survivors = (f64::from(capacity) * full) as u32;
            let next = (f64::from(paths) * begun) as u32;
            let shadows = (f64::from(capacity) * shadowed) as u32;
            let counters = harness.counters(&[
                (Counter::Survivors, survivors),
                (Counter::NextPath, next),
                (Counter::Shadows, shadows),
                (Counter::Rays, 100),
                (Counter::FirstHit, 17),
            ]);
            let arguments = vec![UNTOUCHED; argument_words(&harness.key) as usize];
            let uniforms = Uniforms { capacity, path_count: paths, ..Uniforms::zeroed() };
            let read = harness.run(
                uniforms,
                &[
                    ("counters", bytemuck::cast_slice(&counters)),
                    ("arguments", bytemuck::cast_slice(&arguments)),
                ],
                1,
                &["counters", "arguments"],
            );
            let (after, arguments) = (words(&read[0]), words(&read[1]));
            let counter = |c: Counter| after[c as usize];
            let fresh = (capacity - survivors).min(paths - next);
            prop_assert_eq!(counter(Counter::Live), survivors + fresh);
            prop_assert_eq!(counter(Counter::FreshBegin), survivors);
            prop_assert_eq!(counter(Counter::NextPath), next + fresh);
            prop_assert_eq!(counter(Counter::Rays), 100 + survivors + fresh);
            prop_assert_eq!(counter(Counter::ShadowsLive), shadows);
            prop_assert_eq!(counter(Counter::Overflow), 0);
            for cleared in [Counter::Survivors, Counter::Shadows, Counter::FirstHit] {
                prop_assert_eq!(counter(cleared), 0);
            }
            for (slot, items) in [
                (Argument::Generate, fresh),
                (Argument::Intersect, survivors + fresh),
                (Argument::Shadow, shadows),
            ] {
                let [x, y, z] = [0, 1, 2].map(|i| arguments[3 * slot as usize + i]);
                prop_assert!(x <= GRID_WIDTH && y <= 65_535 && z == 1, "{slot:?}: {x} {y} {z}");
                let invocations = u64::from(x) * u64::from(y) * u64::from(WORKGROUP);
                prop_assert!(invocations >= u64::from(items), "{slot:?}: {x} × {y} for {items}");
                // In full rows, no more than one of waste.
                let row = u64::from(GRID_WIDTH * WORKGROUP);
                prop_assert!(invocations < u64::from(items) + row.max(u64::from(WORKGROUP)));
                prop_assert!(items > 0 || invocations == 0);
            }
            Ok(())
        })
        .unwrap();
}

/// Where paths split, fresh ones are admitted as far as there is room for all copies that those in flight and they may
/// still become, and never further.
#[test]
fn preparing_a_level_leaves_room_for_every_copy() {
    let compiled = CompiledScene::new(&scene("cornell-box"));
    for split in [2, 5, 8] {
        let estimators = Estimators { split, ..estimators(GuideMode::Adaptive, Roulette::Learnt) };
        let harness = Harness::with(Stage::PrepareRays, &compiled, Schedule::Fused, estimators);
        for (capacity, survivors, owned, paths, next, fresh) in [
            (256, 0, 0, 1000, 0, 256 / split),
            (256, 0, 0, 7, 3, 4),
            (256, 20, 20, 1000, 100, 236 / split),
            (256, 20, 20 * split, 1000, 100, (256 - 20 * split) / split),
            (256, 250, 256, 1000, 100, 0),
            (256, 256, 256, 1000, 1000, 0),
            (1 << 22, 5, 8, 1 << 22, 0, ((1 << 22) - 8) / split),
        ] {
            let counters = harness.counters(&[
                (Counter::Survivors, survivors),
                (Counter::Places, owned),
                (Counter::NextPath, next),
            ]);
            let arguments = vec![UNTOUCHED; argument_words(&harness.key) as usize];
            let read = harness.run(
                Uniforms { capacity, path_count: paths, ..Uniforms::zeroed() },
                &[
                    ("counters", bytemuck::cast_slice(&counters)),
                    ("arguments", bytemuck::cast_slice(&arguments)),
                ],
                1,
                &["counters"],
            );
            let after = words(&read[0]);
            let counter = |c: Counter| after[c as usize];
            assert!(owned + fresh * split <= capacity, "the test is wrong");
            assert_eq!(counter(Counter::NextPath), next + fresh, "{split} {capacity} {survivors} {owned}");
            assert_eq!(counter(Counter::Live), survivors + fresh);
            assert_eq!((counter(Counter::Survivors), counter(Counter::Places)), (0, 0));
        }
    }
}

/// Transitions of every kind: few slots, so that sums carry; values beyond 32 bits; what is no radiance; points without a
/// cell.
fn transition(i: u32, layout: &LessonLayout) -> Transition {
    let values = [0.0, 1.0, 1e-9, 3e4, 1e9, f32::MAX, f32::NAN, f32::INFINITY, -1.0, -0.0, 0.037];
    let at =
        |salt: u32, n: u32| i.wrapping_mul(2_654_435_761).wrapping_add(salt.wrapping_mul(40_503)) / 7 % n;
    let missed = at(1, 5) == 0;
    let visited =
        if missed { lessons::MISSING | at(2, layout.missing) } else { at(3, layout.visits.min(13)) };
    Transition {
        slot: at(4, layout.slots.min(29)),
        value: values[at(5, values.len() as u32) as usize],
        visited,
        visit: if missed { 1.0 } else { values[at(6, values.len() as u32) as usize] },
    }
}

/// The queue of transitions is added up exactly, in whatever order, to what Rust adds up; what lies behind its end is not.
#[test]
fn learning_adds_every_transition_exactly_once() {
    let compiled = CompiledScene::new(&scene("cornell-box"));
    let harness = Harness::guided(Stage::Learn, &compiled, Schedule::Streamed, GuideMode::Adaptive);
    let table = learnt(GuideMode::Adaptive, 1).table;
    let layout = LessonLayout::new(&table.uniforms);
    for n in [0u32, 1, 255, 256, 257, 20_000] {
        let transitions: Vec<Transition> = (0..n + 300).map(|i| transition(i, &layout)).collect();
        let counters = harness.counters(&[(Counter::TransitionsLive, n)]);
        let sums = vec![0u32; layout.words() as usize];
        let read = harness.run(
            Uniforms { capacity: n + 300, ..Uniforms::zeroed() },
            &[
                ("counters", bytemuck::cast_slice(&counters)),
                ("transitions", bytemuck::cast_slice(&transitions)),
                ("lessons", bytemuck::cast_slice(&sums)),
                ("guide", bytemuck::bytes_of(&table.uniforms)),
            ],
            n.div_ceil(WORKGROUP) + 1,
            &["lessons"],
        );
        let added = |count: u32| {
            let mut expected = LessonSums::new(layout);
            transitions[..count as usize].iter().for_each(|t| expected.learn(&table, t));
            expected.take()
        };
        let found = Lessons::from_words(layout, &words(&read[0]));
        assert!(found == added(n), "{n} transitions");
        // Negative control: without the last of those that count, the sums are others.
        assert!(n < 300 || found != added(n - 30), "{n} transitions");
        assert!(n < 300 || found.values.iter().any(|sum| *sum > 1 << 33), "no sum carried");
    }
}

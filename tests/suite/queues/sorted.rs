//! Paths sorted by material: each that goes on is in the list of what it met, once.

use super::*;
use crate::recorded_levels::skip_to;
use crate::support::{Engine, adapter, differing_pixels, render};
use qtracer::RenderOptions;
use qtracer::engine::RecordedLevel;
use qtracer::gpu::stage::{Argument, ITEMS, argument_words, length_rows};
use qtracer::scene::shapes::{Ray, intersect, shape_info};
use qtracer::transport::items::HitItem;

/// Lists of a level as they lie in buffers.
struct Lists {
    counters: Vec<u32>,
    lengths: Vec<u32>,
    rays_in: Vec<RayItem>,
    rays_out: Vec<RayItem>,
    hits_in: Vec<u32>,
    hits_out: Vec<u32>,
    queues: usize,
    capacity: usize,
}

impl Lists {
    fn read(recorded: &RecordedLevel) -> Lists {
        let words = |name: &str| recorded.words(name).unwrap().unwrap();
        let capacity = recorded.uniforms().capacity;
        Lists {
            counters: words("counters"),
            lengths: words("lengths"),
            rays_in: from_planes(&words("rays_in"), capacity),
            rays_out: from_planes(&words("rays_out"), capacity),
            hits_in: words("hits_in"),
            hits_out: words("hits_out"),
            queues: recorded.key().material_queues() as usize,
            capacity: capacity as usize,
        }
    }

    /// The first `count` hits of a list.
    fn list(&self, hits: &[u32], queue: usize, count: u32) -> Vec<HitItem> {
        let word = |plane: usize, i: usize| hits[(queue + plane * self.queues) * self.capacity + i];
        let hit = |i| HitItem { slot: word(0, i), shape: word(1, i), t: f32::from_bits(word(2, i)) };
        (0..count as usize).map(hit).collect()
    }

    /// Paths that stood at a surface when the level began, or started in it.
    fn paths_in(&self) -> BTreeSet<u32> {
        let length = |counter: Counter| self.lengths[counter as usize];
        let fresh = length(Counter::Live) - length(Counter::FreshBegin);
        let listed = (0..self.queues).flat_map(|queue| {
            self.list(&self.hits_in, queue, self.lengths[Counter::FirstHit as usize + queue])
        });
        let standing = listed.map(|hit| self.rays_in[hit.slot as usize].path);
        standing.chain(length(Counter::NextPath) - fresh..length(Counter::NextPath)).collect()
    }

    /// What is wrong with the lists of the next level, if anything.
    fn fault(&self, compiled: &CompiledScene, key: &KernelKey) -> Option<String> {
        let count = |counter: usize| self.counters[counter];
        if count(Counter::Overflow as usize) != 0 {
            return Some("overflow".into());
        }
        let (mut slots, mut paths, mut strange) = (BTreeSet::new(), BTreeSet::new(), 0);
        let paths_in = self.paths_in();
        for queue in 0..self.queues {
            for hit in self.list(&self.hits_out, queue, count(Counter::FirstHit as usize + queue)) {
                let kind = shape_info(compiled, hit.shape).kind;
                if key.hit_queue(kind) as usize != queue {
                    return Some(format!("a hit of kind {kind} in list {queue}"));
                }
                if hit.slot as usize >= self.capacity || !slots.insert(hit.slot) {
                    return Some(format!("slot {} twice, or out of bounds", hit.slot));
                }
                let ray = &self.rays_out[hit.slot as usize];
                if !paths_in.contains(&ray.path) || !paths.insert(ray.path) {
                    return Some(format!("path {} twice, or out of nowhere", ray.path));
                }
                let met = intersect(compiled, Ray { origin: ray.origin, direction: ray.direction });
                strange += u32::from(met.is_none_or(|met| met.shape != hit.shape));
            }
        }
        if slots.len() != count(Counter::Survivors as usize) as usize {
            return Some(format!("{} in lists of {}", slots.len(), count(Counter::Survivors as usize)));
        }
        // Rays within rounding of an edge.
        (strange as usize > 1 + slots.len() / 200)
            .then(|| format!("{strange} hits are not what their rays meet"))
    }
}

fn recorded(name: &str, pool: u32, seed: u32) -> RecordedLevel {
    let options = RenderOptions {
        size: Some((24, 16)),
        seed,
        schedule: Some(Schedule::Sorted),
        pool: Some(pool),
        adapter: adapter(),
        ..Default::default()
    };
    RecordedLevel::record(&scene(name), &options, 0).unwrap()
}

/// Runs a level but for its sums.
fn run_level(recorded: &mut RecordedLevel) {
    while recorded.stage().is_some_and(|stage| stage.stage != Stage::Resolve) {
        recorded.advance().unwrap();
    }
}

/// After some levels, of pools of any size: who goes on is in one list, the one of what its ray meets.
#[test]
fn every_path_that_goes_on_is_in_the_list_of_what_it_met() {
    let scenes = prop::sample::select(vec![
        "cornell-box",
        "bansal-room-1",
        "furnace-open-half",
        "glossy-box",
        "metal-spheres",
    ]);
    let pools = prop_oneof![Just(256), Just(512), 256u32..3000];
    let law = |(name, pool, seed, level): (&str, u32, u32, u32)| {
        let mut recorded = recorded(name, pool, seed);
        skip_to(&mut recorded, 0, level);
        run_level(&mut recorded);
        let lists = Lists::read(&recorded);
        prop_assert!(!lists.paths_in().is_empty());
        prop_assert_eq!(lists.fault(&CompiledScene::new(&scene(name)), recorded.key()), None);
        Ok(())
    };
    runner(16).run(&(scenes, pools, any::<u32>(), 0u32..5), law).unwrap();
}

/// Negative controls: a hit in another material's list, a slot or a path twice, a hit that its ray does not meet.
#[test]
fn a_path_in_the_wrong_list_is_found() {
    let compiled = CompiledScene::new(&scene("bansal-room-1"));
    let mut recorded = recorded("bansal-room-1", 2000, 5);
    skip_to(&mut recorded, 0, 2);
    run_level(&mut recorded);
    let fault = |change: &dyn Fn(&mut Lists)| {
        let mut lists = Lists::read(&recorded);
        change(&mut lists);
        lists.fault(&compiled, recorded.key())
    };
    assert_eq!(fault(&|_| ()), None);
    let swap_first = |lists: &mut Lists| {
        let at = lists.queues * lists.capacity;
        lists.hits_out.swap(at, at + lists.capacity);
    };
    for change in [
        &swap_first as &dyn Fn(&mut Lists),
        &|l| l.hits_out[0] = l.hits_out[1],
        &|l| l.rays_out[l.hits_out[0] as usize].path = l.rays_out[l.hits_out[1] as usize].path,
        &|l| l.counters[Counter::FirstHit as usize] -= 1,
        &|l| l.rays_out.iter_mut().for_each(|ray| ray.direction = -ray.direction),
        &|l| l.lengths[Counter::FirstHit as usize] = 0,
    ] {
        assert!(fault(change).is_some());
    }
}

/// What was pushed is what is to do: the lists' lengths, and workgroups for each of them.
#[test]
fn preparing_a_level_covers_every_list() {
    let harness =
        Harness::new(Stage::PrepareRays, &CompiledScene::new(&scene("bansal-room-1")), Schedule::Sorted);
    let queues = harness.key.material_queues() as usize;
    let first = Counter::FirstHit as usize;
    let law = |(pushed, paths): (Vec<u32>, u32)| {
        let survivors: u32 = pushed.iter().sum();
        let mut counters = harness.counters(&[(Counter::Survivors, survivors), (Counter::Rays, 100)]);
        counters[first..first + queues].copy_from_slice(&pushed);
        let arguments = vec![UNTOUCHED; argument_words(&harness.key) as usize];
        let lengths = vec![UNTOUCHED; 4 * length_rows(&harness.key) as usize];
        let capacity = survivors + 5000;
        let read = harness.run(
            Uniforms { capacity, path_count: paths, ..Uniforms::zeroed() },
            &[
                ("counters", bytemuck::cast_slice(&counters)),
                ("arguments", bytemuck::cast_slice(&arguments)),
                ("lengths", bytemuck::cast_slice(&lengths)),
            ],
            1,
            &["counters", "arguments", "lengths"],
        );
        let [after, arguments, lengths] = [0, 1, 2].map(|i| words(&read[i]));
        let fresh = paths.min(5000);
        prop_assert_eq!(&lengths[first..first + queues], &pushed[..]);
        prop_assert_eq!(&after[first..first + queues], &vec![0; queues][..]);
        prop_assert_eq!(lengths[Counter::Live as usize], survivors + fresh);
        prop_assert_eq!(after[Counter::Rays as usize], 100, "who traces rays counts them");
        let groups = |slot: usize| {
            let [x, y] = [0, 1].map(|i| u64::from(arguments[3 * slot + i]));
            prop_assert!(x <= 32768 && arguments[3 * slot + 2] == 1);
            Ok(x * y)
        };
        let needed = |items: u32, share: u32| u64::from(items.div_ceil(share));
        // The first list has the kernel of its own, whose invocations take several items where it is long.
        let each = (pushed[0] / (WORKGROUP * 1024)).clamp(1, ITEMS);
        // An eighth of it is shared out one by one.
        let early = (pushed[0] - pushed[0] / 8) / (WORKGROUP * each);
        let own = u64::from(early) + needed(pushed[0] - early * WORKGROUP * each, WORKGROUP);
        let others: u64 = pushed[1..].iter().chain([&fresh]).map(|&n| needed(n, WORKGROUP)).sum();
        for (slot, needed) in [(Argument::FirstHit as usize, own), (Argument::Intersect as usize, others)] {
            let groups = groups(slot)?;
            prop_assert!(groups >= needed && groups < needed + 32768, "{} for {}", groups, needed);
            prop_assert!(needed > 32768 || groups == needed);
        }
        Ok(())
    };
    let pushed = prop::collection::vec(prop_oneof![Just(0), 0u32..1000, 0u32..3 << 20], queues);
    runner(40).run(&(pushed, 0u32..20_000), law).unwrap();
}

/// A list so long that an invocation takes as many items as it may, as on a large GPU, and less at every level.
#[test]
fn long_lists_are_shared_out_without_losing_a_path() {
    let exact = open_gpu().summary.software;
    let scene = scene("cornell-box");
    let options = RenderOptions {
        size: Some((1152, 1000)),
        pool: Some(1 << 21),
        max_bounces: Some(4),
        direct_light: Some(false),
        seed: 3,
        ..Default::default()
    };
    // All levels that the material lasts: the pacing of a software adapter would leave it at one.
    let [mega, sorted] = [(Engine::Megakernel, None), (Engine::Wavefront(Schedule::Sorted), Some(64))]
        .map(|(engine, grain)| render(&scene, engine, &RenderOptions { grain, ..options.clone() }, 1));
    assert_eq!(1152 * 1000 / (WORKGROUP * 1024), ITEMS, "not what this test is for");
    if exact {
        assert_eq!(differing_pixels(&mega.film, &sorted.film), 0);
        assert_eq!(mega.stats.rays, sorted.stats.rays);
    } else {
        assert!(mega.stats.rays.abs_diff(sorted.stats.rays) < mega.stats.rays / 1000);
    }
}

//! Whole levels of real renders: where each path is.

use super::*;
use crate::recorded_levels::{Queues, skip_to, walk_level};
use crate::support::adapter;
use qtracer::RenderOptions;
use qtracer::engine::RecordedLevel;
use qtracer::gpu::key::KernelKey;

/// Where the paths of a level are between two of its stages.
struct Paths {
    key: KernelKey,
    schedule: Schedule,
    /// Those whose rays the level began with.
    live: BTreeSet<u32>,
    /// Hit queues whose stage has run.
    shaded: Vec<u32>,
}

impl Paths {
    /// What is wrong after `stage`, if anything.
    fn fault(&mut self, stage: Stage, before: &Queues, after: &Queues) -> Option<String> {
        match stage {
            Stage::PrepareRays => self.shaded.clear(),
            Stage::Generate => return self.start(after),
            Stage::Shade(kind) => self.shaded.push(self.key.hit_queue(kind)),
            Stage::Environment => self.shaded.push(self.key.hit_queues() - 1),
            _ => {}
        }
        match stage {
            Stage::Intersect | Stage::Environment | Stage::Shade(_) => self.places(stage, after),
            Stage::Compact => {
                let kept = paths_of((0..before.count(Counter::Live)).map(|slot| before.ray_in(slot).ray));
                let moved =
                    paths_of((0..after.count(Counter::Survivors)).map(|slot| after.ray_out(slot).ray));
                (kept != moved).then(|| format!("{kept:?} became {moved:?}"))
            }
            _ => None,
        }
    }

    /// Survivors and fresh paths: each once, and the fresh ones are the next in order.
    fn start(&mut self, queues: &Queues) -> Option<String> {
        let [begin, live, next] =
            [Counter::FreshBegin, Counter::Live, Counter::NextPath].map(|counter| queues.count(counter));
        let fresh: Vec<u32> = (begin..live).map(|slot| queues.ray_in(slot).ray.path).collect();
        let paths = paths_of((0..live).map(|slot| queues.ray_in(slot).ray));
        self.live = paths.iter().copied().collect();
        if !fresh.iter().copied().eq(next - fresh.len() as u32..next) {
            return Some(format!("{fresh:?} are fresh, the next is {next}"));
        }
        (self.live.len() != live as usize).then(|| format!("{} paths in {live} rays", self.live.len()))
    }

    /// A live path waits in one hit queue, or goes on with one ray, or has ended; none is in two places.
    fn places(&self, stage: Stage, queues: &Queues) -> Option<String> {
        let hits = (0..self.key.hit_queues())
            .flat_map(|queue| (0..queues.hit_count(queue)).map(move |i| (queue, i)));
        let (done, waiting): (Vec<_>, Vec<_>) = hits.partition(|(queue, _)| self.shaded.contains(queue));
        let ray = |&(queue, i): &(u32, u32)| queues.ray_in(queues.hit(queue, i).slot).ray;
        let on = match self.schedule {
            Schedule::Compacted => paths_of(done.iter().map(ray)),
            _ => paths_of((0..queues.count(Counter::Survivors)).map(|slot| queues.ray_out(slot).ray)),
        };
        let waiting = paths_of(waiting.iter().map(ray));
        let all: BTreeSet<u32> = waiting.iter().chain(&on).copied().collect();
        if all.len() != waiting.len() + on.len() {
            return Some(format!(
                "{} waiting and {} going on are {} paths",
                waiting.len(),
                on.len(),
                all.len()
            ));
        }
        if !all.is_subset(&self.live) {
            return Some("a path that was not there".to_string());
        }
        let shadows = (0..queues.count(Counter::Shadows)).map(|slot| queues.shadow(slot).0.path);
        let shadows: Vec<u32> = if self.key.direct_light { shadows.collect() } else { Vec::new() };
        let distinct: BTreeSet<u32> = shadows.iter().copied().collect();
        if distinct.len() != shadows.len() || !distinct.is_subset(&self.live) {
            return Some(format!("{} shadow rays of {} paths", shadows.len(), distinct.len()));
        }
        // Where the environment shines, misses have a queue too.
        let all_queued = stage == Stage::Intersect && self.key.environment;
        (all_queued && all != self.live).then(|| format!("{} of {} paths", all.len(), self.live.len()))
    }
}

/// Paths of the rays that are not dead, sorted; twice, who is there twice.
fn paths_of(rays: impl Iterator<Item = RayItem>) -> Vec<u32> {
    let mut paths: Vec<u32> = rays.map(|ray| ray.path).filter(|&path| path != NONE).collect();
    paths.sort_unstable();
    paths
}

/// After each stage of some levels, of pools of any size.
#[test]
fn every_live_path_is_in_exactly_one_queue() {
    let scenes =
        prop::sample::select(vec!["cornell-box", "bansal-room-1", "furnace-open-half", "glossy-box"]);
    let schedules = prop::sample::select(vec![Schedule::Streamed, Schedule::Compacted]);
    let pools = prop_oneof![Just(256), Just(512), 256u32..3000];
    let law = |(name, schedule, pool, seed, level): (&str, Schedule, u32, u32, u32)| {
        let options = RenderOptions {
            size: Some((24, 16)),
            seed,
            schedule: Some(schedule),
            pool: Some(pool),
            adapter: adapter(),
            ..Default::default()
        };
        let mut recorded = RecordedLevel::record(&scene(name), &options, 0).unwrap();
        let mut paths = Paths { key: *recorded.key(), schedule, live: BTreeSet::new(), shaded: Vec::new() };
        skip_to(&mut recorded, 0, level);
        let mut faults = Vec::new();
        walk_level(&mut recorded, |stage, before, after| {
            faults
                .extend(paths.fault(stage, before, after).map(|fault| format!("{}: {fault}", stage.name())));
        });
        prop_assert!(!paths.live.is_empty());
        prop_assert_eq!(faults, Vec::<String>::new());
        Ok(())
    };
    runner(12).run(&(scenes, schedules, pools, any::<u32>(), 0u32..5), law).unwrap();
}

/// Negative control: who does not know that a stage has run finds its paths in two places; who does not know of a path that
/// was started finds it where it should not be.
#[test]
fn a_path_in_two_places_is_found() {
    let options = RenderOptions {
        size: Some((24, 16)),
        schedule: Some(Schedule::Streamed),
        pool: Some(1000),
        adapter: adapter(),
        ..Default::default()
    };
    let mut recorded = RecordedLevel::record(&scene("glossy-box"), &options, 0).unwrap();
    let key = *recorded.key();
    let paths = || Paths { key, schedule: Schedule::Streamed, live: BTreeSet::new(), shaded: Vec::new() };
    let (mut forgetful, mut ignorant) = (paths(), paths());
    let (mut twice, mut strange) = (0, 0);
    let mut shaded = 0;
    walk_level(&mut recorded, |stage, before, after| {
        twice += u32::from(forgetful.fault(stage, before, after).is_some());
        shaded += u32::from(matches!(stage, Stage::Shade(_)));
        if shaded == 1 {
            forgetful.shaded.clear();
        }
        strange += u32::from(ignorant.fault(stage, before, after).is_some());
        if stage == Stage::Generate {
            ignorant.live.pop_last();
        }
    });
    assert!(twice > 0 && strange > 0, "{twice} {strange}");
}

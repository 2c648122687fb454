//! Levels held still: their queues as structs, their stages one after the other.

use crate::support::*;
use glam::Vec3;
use qtracer::RenderOptions;
use qtracer::engine::RecordedLevel;
use qtracer::gpu::key::KernelKey;
use qtracer::gpu::stage::{Counter, Schedule, Stage};
use qtracer::guiding::{Trail, Transition};
use qtracer::transport::items::{HitItem, RayItem, ShadowItem};
use std::collections::BTreeMap;

/// A ray and what its path remembers.
#[derive(Clone, Copy, Debug, Default)]
pub struct Flight {
    pub ray: RayItem,
    pub trail: Trail,
}

/// What lies in the queues between two stages, each buffer in words.
#[derive(Clone, Default)]
pub struct Queues {
    pub counters: Vec<u32>,
    capacity: usize,
    hit_queues: usize,
    teaches: bool,
    rays_in: Vec<u32>,
    rays_out: Vec<u32>,
    hits: Vec<u32>,
    shadows: Vec<u32>,
    transitions: Vec<u32>,
    radiance: Vec<u32>,
    pub block_sums: Vec<u32>,
    pub lessons: Vec<u32>,
}

impl Queues {
    pub fn read(recorded: &RecordedLevel) -> Queues {
        let words = |name: &str| recorded.words(name).unwrap().unwrap_or_default();
        let key: &KernelKey = recorded.key();
        Queues {
            counters: words("counters"),
            capacity: recorded.uniforms().capacity as usize,
            hit_queues: key.hit_queues() as usize,
            teaches: key.teaches,
            rays_in: words("rays_in"),
            rays_out: words("rays_out"),
            hits: words("hits"),
            shadows: words("shadows"),
            transitions: words("transitions"),
            radiance: words("radiance"),
            block_sums: words("block_sums"),
            lessons: words("lessons"),
        }
    }

    pub fn count(&self, counter: Counter) -> u32 {
        self.counters[counter as usize]
    }

    pub fn hit_count(&self, queue: u32) -> u32 {
        self.counters[Counter::FirstHit as usize + queue as usize]
    }

    /// Row `row` of item `slot` in a queue of planes.
    fn row(&self, planes: &[u32], slot: u32, row: usize) -> [u32; 4] {
        let at = 4 * (row * self.capacity + slot as usize);
        planes[at..at + 4].try_into().unwrap()
    }

    fn rows(&self, planes: &[u32], slot: u32) -> [[u32; 4]; 3] {
        [0, 1, 2].map(|row| self.row(planes, slot, row))
    }

    fn trail(&self, planes: &[u32], slot: u32) -> Trail {
        if self.teaches { bytemuck::cast(self.row(planes, slot, 3)) } else { Trail::default() }
    }

    /// A ray of this level; one that is dead has the path `NONE`.
    pub fn ray_in(&self, slot: u32) -> Flight {
        let planes = &self.rays_in;
        Flight { ray: bytemuck::cast(self.rows(planes, slot)), trail: self.trail(planes, slot) }
    }

    /// A ray of the next level.
    pub fn ray_out(&self, slot: u32) -> Flight {
        let planes = &self.rays_out;
        Flight { ray: bytemuck::cast(self.rows(planes, slot)), trail: self.trail(planes, slot) }
    }

    pub fn shadow(&self, slot: u32) -> (ShadowItem, Trail) {
        (bytemuck::cast(self.rows(&self.shadows, slot)), self.trail(&self.shadows, slot))
    }

    pub fn transition(&self, i: u32) -> Transition {
        bytemuck::cast(self.row(&self.transitions, i, 0))
    }

    /// Hit number `i` of a queue: a plane of all queues for each of the three words.
    pub fn hit(&self, queue: u32, i: u32) -> HitItem {
        let word =
            |plane: usize| self.hits[(queue as usize + plane * self.hit_queues) * self.capacity + i as usize];
        HitItem { slot: word(0), shape: word(1), t: f32::from_bits(word(2)) }
    }

    pub fn radiance(&self, path: u32) -> Vec3 {
        let at = 3 * path as usize;
        Vec3::from_slice(bytemuck::cast_slice(&self.radiance[at..at + 3]))
    }

    /// All of it, three floats a path.
    pub fn all_radiance(&self) -> &[[f32; 3]] {
        bytemuck::cast_slice(&self.radiance)
    }
}

/// Runs the stages of a level, one after the other, and hands each to `look` when it has run.
pub fn walk_level(recorded: &mut RecordedLevel, mut look: impl FnMut(Stage, &Queues, &Queues)) {
    let mut before = Queues::read(recorded);
    while let Some(stage) = recorded.stage() {
        if stage.stage == Stage::Resolve {
            recorded.run().unwrap();
            look(stage.stage, &before, &Queues::read(recorded));
            return;
        }
        recorded.advance().unwrap();
        let after = Queues::read(recorded);
        look(stage.stage, &before, &after);
        before = after;
    }
}

/// Runs the stages of the levels up to number `level`, not looking.
pub fn skip_to(recorded: &mut RecordedLevel, from: u32, level: u32) {
    for _ in from..level {
        while recorded.stage().is_some_and(|stage| stage.stage != Stage::Resolve) {
            recorded.advance().unwrap();
        }
        recorded.next_level();
    }
}

/// A stage run again on recorded queues does the same again, and the queues hold what the stages hand on.
#[test]
fn recorded_levels_can_be_run_again() {
    let scene = scene("bansal-room-1");
    let adapter = adapter();
    for schedule in SCHEDULES {
        let options = RenderOptions {
            size: Some((24, 16)),
            schedule: Some(schedule),
            adapter: adapter.clone(),
            ..Default::default()
        };
        let mut recorded = RecordedLevel::record(&scene, &options, 2).unwrap();
        let mut items = BTreeMap::new();
        while let Some(stage) = recorded.stage() {
            for _ in 0..2 {
                assert!(recorded.run().unwrap() >= 0.0);
            }
            items.insert(stage.name.clone(), stage.items);
            recorded.advance().unwrap();
        }
        assert!(items["resolve"] > 0, "{items:?}");
        if schedule == Schedule::Fused {
            assert!(items["step"] > 0, "{items:?}");
            continue;
        }
        if schedule == Schedule::Sorted {
            assert!(items["follow_diffuse"] > 0 && items["follow_others"] > 0, "{items:?}");
            continue;
        }
        // A closed room: every ray hits something of one of its materials.
        let shaded: u64 = items.iter().filter(|(name, _)| name.starts_with("shade_")).map(|(_, n)| n).sum();
        assert!(shaded > 0 && shaded == items["intersect"], "{items:?}");
    }
}

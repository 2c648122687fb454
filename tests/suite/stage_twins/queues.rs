//! The queues of a recorded level, as structs.

use glam::Vec3;
use qtracer::engine::RecordedLevel;
use qtracer::gpu::key::KernelKey;
use qtracer::gpu::stage::Counter;
use qtracer::guiding::{Trail, Transition};
use qtracer::transport::items::{HitItem, RayItem, ShadowItem};

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

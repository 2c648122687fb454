//! What paths taught in one pass: fixed-point sums, which come out the same in whatever order they are added.
//! GPU twin: kernels/guiding/lessons.wesl

use super::table::{GuideTable, GuideUniforms};
use crate::gpu_struct;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};

gpu_struct! {
    /// What a path remembers of the last surface that learns: where the light that it finds belongs. 16 bytes.
    pub struct Trail {
        /// Slot of the direction taken.
        slot: u32,
        /// What radiance found from here on counts there: cosθ/pdf, and what mirrors and roulette did since; 0 if nothing
        /// is to be learnt.
        weight: f32,
        _pad0: u32,
        _pad1: u32,
    }
    /// A transition: what a path found for the surface that it came from, and the visit to the one where it is. 16 bytes.
    pub struct Transition {
        /// Slot that learns.
        slot: u32,
        /// Radiance times the trail's weight; 0 if there is nothing to learn.
        value: f32,
        /// Visit counter, or [`MISSING`] + base cell where no cell exists yet.
        visited: u32,
        /// What the visit counts; 0 for none.
        visit: f32,
    }
}

/// Marks the base cell of a surface point without a cell, in place of a visit counter.
pub const MISSING: u32 = 1 << 31;
/// Fixed-point units of a visit's weight.
pub const VISIT_UNIT: f32 = 1_048_576.0;
/// The largest number that one addition makes, so that 65,535 of them fit.
const LARGEST: f32 = 281_474_976_710_656.0;

/// A non-negative number as a whole number of units; 0 for anything negative, infinite or NaN, which thereby never
/// reach the table.
pub fn fixed(value: f32, unit: f32) -> u64 {
    let scaled = value * unit;
    // By its bits: compilers for GPUs may assume that there is no NaN.
    if scaled.to_bits() >= f32::INFINITY.to_bits() {
        return 0;
    }
    (scaled.min(LARGEST) + 0.5) as u64
}

/// How the sums are laid out; the same in Rust and WGSL.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LessonLayout {
    /// 64-bit sums of values: eight per cell, four per quadtree node.
    pub slots: u32,
    /// 64-bit sums of visits: eight per cell. By eighths of the cell if cells can be cut, else by octants of directions.
    pub visits: u32,
    /// 32-bit words: surface points that no cell exists for, by base cell and sector.
    pub missing: u32,
}

impl LessonLayout {
    pub fn new(uniforms: &GuideUniforms) -> LessonLayout {
        LessonLayout {
            slots: 8 * uniforms.cell_count + 4 * uniforms.node_count,
            visits: 8 * uniforms.cell_count,
            missing: uniforms.base_words(),
        }
    }

    /// 32-bit words in all, as the GPU's buffer has them.
    pub fn words(&self) -> u64 {
        2 * (u64::from(self.slots) + u64::from(self.visits)) + u64::from(self.missing)
    }
}

/// Sums in flight, for many threads.
#[derive(Debug, Default)]
pub struct LessonSums {
    pub layout: LessonLayout,
    values: Vec<AtomicU64>,
    visits: Vec<AtomicU64>,
    missing: Vec<AtomicU32>,
}

/// Sums of a finished pass.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Lessons {
    pub values: Vec<u64>,
    pub visits: Vec<u64>,
    pub missing: Vec<u32>,
}

impl LessonSums {
    pub fn new(layout: LessonLayout) -> LessonSums {
        fn zeros<T: Default>(count: u32) -> Vec<T> {
            (0..count).map(|_| T::default()).collect()
        }
        LessonSums {
            layout,
            values: zeros(layout.slots),
            visits: zeros(layout.visits),
            missing: zeros(layout.missing),
        }
    }

    /// Adds a transition. Adding is exact, so the order does not matter.
    pub fn learn(&self, table: &GuideTable, transition: &Transition) {
        let value = fixed(transition.value, table.uniforms.unit);
        if value > 0 {
            self.values[transition.slot as usize].fetch_add(value, Ordering::Relaxed);
        }
        let visit = fixed(transition.visit, VISIT_UNIT);
        if visit > 0 {
            match transition.visited.checked_sub(MISSING) {
                Some(base) => self.missing[base as usize].store(1, Ordering::Relaxed),
                None => {
                    self.visits[transition.visited as usize].fetch_add(visit, Ordering::Relaxed);
                }
            }
        }
    }

    /// The sums so far; they start again from zero.
    pub fn take(&mut self) -> Lessons {
        let wide = |sums: &mut Vec<AtomicU64>| sums.iter_mut().map(|s| std::mem::take(s.get_mut())).collect();
        let narrow =
            |sums: &mut Vec<AtomicU32>| sums.iter_mut().map(|s| std::mem::take(s.get_mut())).collect();
        Lessons {
            values: wide(&mut self.values),
            visits: wide(&mut self.visits),
            missing: narrow(&mut self.missing),
        }
    }
}

impl Lessons {
    /// From the words of the GPU's buffer: low words of the values, their high words, the same for visits, the rest.
    pub fn from_words(layout: LessonLayout, words: &[u32]) -> Lessons {
        let (slots, visits) = (layout.slots as usize, layout.visits as usize);
        let wide = |words: &[u32], count: usize| -> Vec<u64> {
            (0..count).map(|i| u64::from(words[i]) | u64::from(words[count + i]) << 32).collect()
        };
        let (values, rest) = words.split_at(2 * slots);
        let (visit_words, missing) = rest.split_at(2 * visits);
        Lessons {
            values: wide(values, slots),
            visits: wide(visit_words, visits),
            missing: missing[..layout.missing as usize].to_vec(),
        }
    }
}

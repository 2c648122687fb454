//! Cuts a range of samples into batches that a GPU engine traces at once.

use crate::gpu::stage::BLOCK;
use std::ops::Range;

/// Consecutive pixels, and consecutive samples of each.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Batch {
    pub first_pixel: u32,
    pub pixel_count: u32,
    pub first_sample: u32,
    pub sample_count: u32,
}

impl Batch {
    pub fn paths(&self) -> u32 {
        self.pixel_count * self.sample_count
    }

    /// Blocks of samples that are summed apart.
    pub fn blocks(&self) -> u32 {
        self.sample_count.div_ceil(BLOCK)
    }

    /// Samples in block `i`.
    pub fn block_samples(&self, i: u32) -> u32 {
        BLOCK.min(self.sample_count - i * BLOCK)
    }
}

/// Samples of each pixel in a full batch: whole blocks if that many paths fit, else a power of two. It depends on sizes
/// alone, never on time, so that the same render always sums in the same order.
pub fn batch_samples(pixels: u32, max_paths: u32) -> u32 {
    let fitting = (max_paths / pixels).max(1);
    if fitting >= BLOCK { fitting / BLOCK * BLOCK } else { 1 << fitting.ilog2() }
}

/// The largest batch there will be.
pub fn full_batch(pixels: u32, max_paths: u32) -> Batch {
    let pixel_count = pixels.min(max_paths.max(1));
    Batch { first_pixel: 0, pixel_count, first_sample: 0, sample_count: batch_samples(pixels, max_paths) }
}

/// The batches of samples `range` of `pixels` pixels, each of at most `max_paths` paths. Cuts within a block of samples
/// happen only at the ends of `range` or where a block does not fit, so ranges that meet at multiples of [`BLOCK`] add up
/// to exactly what one range gives.
pub fn batches(pixels: u32, range: Range<u32>, max_paths: u32) -> Vec<Batch> {
    let full = batch_samples(pixels, max_paths);
    let mut batches = Vec::new();
    let mut sample = range.start;
    while sample < range.end {
        let alignment = full.min(BLOCK);
        let to_boundary = alignment - sample % alignment;
        let count = if to_boundary < alignment { to_boundary } else { full };
        let count = count.min(range.end - sample);
        let mut pixel = 0;
        while pixel < pixels {
            let pixel_count = max_paths.max(1).min(pixels - pixel);
            batches.push(Batch {
                first_pixel: pixel,
                pixel_count,
                first_sample: sample,
                sample_count: count,
            });
            pixel += pixel_count;
        }
        sample += count;
    }
    batches
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn batches_cover_every_sample_of_every_pixel_once(
            pixels in 1u32..5000, start in 0u32..100, count in 0u32..200, max_paths in 1u32..20000
        ) {
            let all = batches(pixels, start..start + count, max_paths);
            let mut next = (start, 0);
            for b in &all {
                prop_assert_eq!((b.first_sample, b.first_pixel), next);
                prop_assert!(b.paths() <= max_paths && b.paths() > 0);
                next = if b.first_pixel + b.pixel_count == pixels {
                    (b.first_sample + b.sample_count, 0)
                } else {
                    (b.first_sample, b.first_pixel + b.pixel_count)
                };
            }
            prop_assert_eq!(next, (start + count, 0));
        }

        /// The blocks in which samples are summed do not depend on where a range is cut, if it is cut at their ends.
        #[test]
        fn cuts_at_block_ends_do_not_move_blocks(pixels in 1u32..3000, max_paths in 1u32..200000, cut in 0u32..4) {
            let blocks = |range: Range<u32>| -> Vec<(u32, u32, u32)> {
                batches(pixels, range, max_paths)
                    .iter()
                    .flat_map(|b| (0..b.blocks()).map(|i| (b.first_pixel, b.first_sample + i * BLOCK, b.block_samples(i))))
                    .collect()
            };
            let whole = blocks(0..4 * BLOCK);
            let parts = [blocks(0..cut * BLOCK), blocks(cut * BLOCK..4 * BLOCK)].concat();
            let sorted = |mut v: Vec<_>| { v.sort(); v };
            prop_assert_eq!(sorted(whole), sorted(parts));
        }
    }
}

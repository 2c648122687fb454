//! Counter-based random numbers: (pixel, sample, dimension, seed) → four numbers in [0, 1).
//! No state is carried along a path, so every schedule traces the same paths and any range of samples can be
//! rendered alone. GPU twin: kernels/base/random.wesl

use glam::Vec4;

/// How the samples of a pixel relate to each other.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Sampler {
    /// Every sample is independent of every other: standard errors are exact.
    Independent,
    /// Every event's numbers follow a low-discrepancy sequence over the samples of the pixel: less noise as a
    /// rule; the standard errors, which are estimated as if samples were independent, are then usually too large.
    #[default]
    Stratified,
}

/// What numbers an event may draw. Camera: film position. Per bounce one block for the BSDF (u, v, lobe, roulette)
/// and one for the light (choice, u, v; then map or lamp, and more digits of the choice).
pub const DIMENSION_CAMERA: u32 = 0;
#[inline]
pub fn dimension_bsdf(bounce: u32) -> u32 {
    1 + 2 * bounce
}
#[inline]
pub fn dimension_light(bounce: u32) -> u32 {
    2 + 2 * bounce
}

/// Numbers for further draws where a guided direction is not taken: in octants that the horizon cuts, by Bansal's rule. Quadtrees
/// need none of their own. Beyond the dimensions of 64 levels.
#[inline]
pub fn dimension_guide(bounce: u32, draw: u32) -> u32 {
    1024 + 16 * bounce + draw
}

/// Identifies one path: everything its random numbers depend on.
#[derive(Clone, Copy, Debug)]
pub struct SampleKey {
    pub pixel: u32,
    pub sample: u32,
    pub seed: u32,
}

/// PCG4D, Jarzynski & Olano 2020, "Hash Functions for GPU Rendering".
#[inline(always)]
pub fn pcg4d(key: [u32; 4]) -> [u32; 4] {
    let [mut x, mut y, mut z, mut w] = key.map(|k| k.wrapping_mul(1664525).wrapping_add(1013904223));
    for round in 0..2 {
        x = x.wrapping_add(y.wrapping_mul(w));
        y = y.wrapping_add(z.wrapping_mul(x));
        z = z.wrapping_add(x.wrapping_mul(y));
        w = w.wrapping_add(y.wrapping_mul(z));
        if round == 0 {
            [x, y, z, w] = [x, y, z, w].map(|v| v ^ (v >> 16));
        }
    }
    [x, y, z, w]
}

/// The upper 24 bits as a multiple of 2⁻²⁴, so that the result is exact and below 1.
#[inline]
fn unit_float(bits: [u32; 4]) -> Vec4 {
    Vec4::from_array(bits.map(|b| (b >> 8) as f32 * (1.0 / 16_777_216.0)))
}

/// Nested uniform scramble (Laine & Karras 2011, constants by Vegdahl) of an index: it permutes every aligned
/// block of 2ᵏ indices into another such block, which keeps a low-discrepancy sequence one.
#[inline(always)]
fn shuffle_index(index: u32, seed: u32) -> u32 {
    let mut x = index.reverse_bits();
    x ^= x.wrapping_mul(0x3d20adea);
    x = x.wrapping_add(seed);
    x = x.wrapping_mul((seed >> 16) | 1);
    x ^= x.wrapping_mul(0x05526c56);
    x ^= x.wrapping_mul(0x53a22864);
    x.reverse_bits()
}

/// Steps of the planar R2 sequence (Roberts 2018) in units of 2⁻³²: 1/g and 1/g² with g³ = g + 1.
const R2: [u32; 2] = [3242174889, 2447445414];

/// Four numbers for one event of one path.
///
/// Stratified: two planar R2 sequences over the samples of the pixel, each started at a random point and walked in its
/// own shuffled order, so that dimensions stay independent.
#[inline(always)]
pub fn sample4(sampler: Sampler, key: SampleKey, dimension: u32) -> Vec4 {
    match sampler {
        Sampler::Independent => unit_float(pcg4d([key.pixel, key.sample, dimension, key.seed])),
        Sampler::Stratified => {
            let [x, y, z, w] = pcg4d([key.pixel, 0x9e3779b9, dimension, key.seed]);
            let first = shuffle_index(key.sample, x ^ z);
            let second = shuffle_index(key.sample, y.wrapping_add(w));
            unit_float([
                first.wrapping_mul(R2[0]).wrapping_add(x),
                first.wrapping_mul(R2[1]).wrapping_add(y),
                second.wrapping_mul(R2[0]).wrapping_add(z),
                second.wrapping_mul(R2[1]).wrapping_add(w),
            ])
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn key(pixel: u32, sample: u32) -> SampleKey {
        SampleKey { pixel, sample, seed: 7 }
    }

    #[test]
    fn numbers_lie_in_the_half_open_unit_interval() {
        for sampler in [Sampler::Independent, Sampler::Stratified] {
            for sample in (0..5000).chain([u32::MAX - 1, u32::MAX]) {
                let v = sample4(sampler, key(sample.wrapping_mul(77), sample), 5);
                assert!(v.min_element() >= 0.0 && v.max_element() < 1.0);
            }
        }
    }

    /// Any aligned block of 256 samples leaves no cell of a 8×8 grid empty; independent samples leave one in 56 empty.
    #[test]
    fn stratified_samples_fill_the_square_in_every_aligned_block() {
        for block in [0u32, 1, 13] {
            for dimension in 0..20 {
                for pixel in 0..20 {
                    let mut counts = [[0u32; 64]; 2];
                    for sample in 256 * block..256 * (block + 1) {
                        let v = sample4(Sampler::Stratified, key(pixel, sample), dimension);
                        let cell = |x: f32, y: f32| (x * 8.0) as usize * 8 + (y * 8.0) as usize;
                        counts[0][cell(v.x, v.y)] += 1;
                        counts[1][cell(v.z, v.w)] += 1;
                    }
                    assert!(counts.iter().flatten().all(|&c| (1..=8).contains(&c)));
                }
            }
        }
    }
}

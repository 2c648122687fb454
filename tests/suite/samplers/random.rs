//! The numbers themselves: the same on both sides, spread evenly, independent of each other.

use super::ALPHA;
use super::twins::{Side, Twins, World, all_obey};
use crate::guiding_maths::cases;
use proptest::prelude::*;
use qtracer::Sampler;
use qtracer::random::{SampleKey, sample4};
use qtracer::scene::rows::Row;
use qtracer::stats::{chi2_test, normal_two_sided_threshold, sidak};

const NUMBERS: (&str, &str) = (
    "import package::base::random::{SampleKey, sample4};",
    "out0 = bitcast<vec4<u32>>(sample4(SampleKey(a.x, a.y, a.z), a.w));",
);

/// The same four numbers, bit for bit, of any pixel, sample, seed and dimension.
#[test]
fn numbers_are_the_same_on_both_sides() {
    for sampler in [Sampler::Independent, Sampler::Stratified] {
        let world = World { sampler, ..World::of_all_materials() };
        let twins = Twins::new(&world, NUMBERS, |world, [[pixel, sample, seed, dimension]]| {
            let key = SampleKey { pixel: *pixel, sample: *sample, seed: *seed };
            [sample4(world.sampler, key, *dimension).to_array().map(f32::to_bits)]
        });
        let word = || prop_oneof![any::<u32>(), 0..100u32, Just(u32::MAX)];
        let faults = |keys: &[Row]| {
            let questions: Vec<[Row; 1]> = keys.iter().map(|key| [*key]).collect();
            let both = [Side::Cpu, Side::Gpu].map(|side| twins.answer(side, &questions));
            let fault = |(a, b): (&[Row; 1], &[Row; 1])| (a != b).then(|| format!("{a:?}, {b:?}"));
            both[0].iter().zip(&both[1]).map(fault).collect()
        };
        all_obey("numbers", prop::array::uniform4(word()), 40_000, faults);
    }
    // Negative control: another seed's differ.
    let at = |seed| sample4(Sampler::Stratified, SampleKey { pixel: 1, sample: 2, seed }, 3);
    assert!(at(4).cmpne(at(5)).all());
}

/// What walks the circle: the R2 sequence's steps in units of 2⁻³², as the program has them.
const STEPS: [u32; 2] = [3242174889, 2447445414];

/// The fewest and the most of `count` points i·step that any arc of `width` holds, wherever it lies, in turns of 2³².
fn crowding(step: u32, count: u32, width: u64) -> (usize, usize) {
    let mut points: Vec<u64> = (0..count).map(|i| u64::from(i.wrapping_mul(step))).collect();
    points.sort_unstable();
    let around: Vec<u64> = points.iter().copied().chain(points.iter().map(|p| p + (1 << 32))).collect();
    // Extremes are at arcs that begin just behind, or at, a point.
    let within = |from: u64, i: usize, open: bool| {
        around[i..].partition_point(|p| if open { *p <= from + width } else { *p < from + width })
    };
    let n = points.len();
    let fewest = (0..n).map(|i| within(around[i], i, false) - 1).min().unwrap();
    let most = (0..n).map(|i| within(around[i], i, true)).max().unwrap();
    (fewest, most)
}

/// What an aligned block of 2ᵏ samples, 16 to 131,072 of them, promises in each number that it draws: an interval as wide as
/// eight of the samples' shares, wherever it lies, holds five to twelve of them. (Of random ones, less or more in one of six.)
const WIDTH: u64 = 8;
const FEWEST: usize = 5;
const MOST: usize = 12;

/// The samples of an aligned block walk one stretch of the sequence in some order, so how they crowd depends on its length
/// alone, and all lengths can be tried.
#[test]
fn every_stretch_of_the_sequence_keeps_its_promise() {
    for k in 4..=17 {
        for step in STEPS {
            let (fewest, most) = crowding(step, 1 << k, WIDTH << (32 - k));
            println!("2^{k} samples, step {step}: {fewest} to {most} in the width of 8");
            assert!(fewest >= FEWEST && most <= MOST, "2^{k} samples: {fewest} to {most}");
        }
    }
    // Negative control: a step near a fraction does not.
    assert!(crowding(0x8000_1000, 1 << 10, WIDTH << 22).1 > 100);
}

/// Sixteenths of a square that a block of `samples` leaves empty, and its most crowded one, of both pairs of numbers; and
/// whether each number keeps its promise in the strata of that width.
fn spread(key: SampleKey, dimension: u32, k: u32) -> Option<String> {
    let block = key.sample >> k << k;
    let count = 1usize << k;
    let samples: Vec<_> = (0..count as u32)
        .map(|i| sample4(Sampler::Stratified, SampleKey { sample: block + i, ..key }, dimension))
        .collect();
    for c in 0..4 {
        let mut strata = vec![0; count / WIDTH as usize];
        samples.iter().for_each(|u| strata[(u[c] * (count / WIDTH as usize) as f32) as usize] += 1);
        if !strata.iter().all(|n| (FEWEST..=MOST).contains(n)) {
            return Some(format!("number {c}: {strata:?}"));
        }
    }
    // A square of as many cells as there are samples to each 4: none is empty, none has more than 12.
    let side = 1 << ((k - 2) / 2);
    for pair in [[0, 1], [2, 3]] {
        let mut cells = vec![0; side * side];
        let at = |u: f32| (u * side as f32) as usize;
        samples.iter().for_each(|u| cells[at(u[pair[0]]) * side + at(u[pair[1]])] += 1);
        if !cells.iter().all(|n| (1..=4 * count / (side * side)).contains(n)) {
            return Some(format!("numbers {pair:?}: {cells:?}"));
        }
    }
    None
}

proptest! {
    #![proptest_config(cases(3000))]

    /// Of any pixel, seed and dimension, in any aligned block of 16 to 1024 samples.
    #[test]
    fn aligned_blocks_of_stratified_samples_are_spread_evenly(
        pixel: u32, seed: u32, dimension in 0..2048u32, sample in prop_oneof![0..1u32 << 16, any::<u32>()], k in 4..=10u32
    ) {
        prop_assert_eq!(spread(SampleKey { pixel, sample, seed }, dimension, k), None);
    }
}

/// Independent samples are not spread like that, and the test sees it.
#[test]
fn independent_samples_are_not_spread_evenly() {
    let strata = |c: usize| {
        let mut strata = vec![0; 32];
        for sample in 0..256 {
            let u = sample4(Sampler::Independent, SampleKey { pixel: 1, sample, seed: 2 }, 3);
            strata[(u[c] * 32.0) as usize] += 1;
        }
        strata.iter().all(|n| (FEWEST..=MOST).contains(n))
    };
    assert!(!(0..4).any(strata));
}

/// Correlation of two sequences of numbers.
fn correlation(a: &[f64], b: &[f64]) -> f64 {
    let n = a.len() as f64;
    let mean = |v: &[f64]| v.iter().sum::<f64>() / n;
    let (ma, mb) = (mean(a), mean(b));
    let sum = |f: &dyn Fn(usize) -> f64| (0..a.len()).map(f).sum::<f64>();
    let covariance = sum(&|i| (a[i] - ma) * (b[i] - mb));
    covariance / (sum(&|i| (a[i] - ma).powi(2)) * sum(&|i| (b[i] - mb).powi(2))).sqrt()
}

/// Sequences of which each pair must be independent: over samples, of neighbouring dimensions, pixels and seeds.
fn neighbours(sampler: Sampler, count: u32) -> Vec<Vec<f64>> {
    let mut keys = Vec::new();
    for dimension in [0, 1, 2, 3, 64] {
        keys.push((5, dimension, 1));
    }
    for (pixel, seed) in [(6, 1), (7, 1), (261, 1), (5, 2), (5, 3), (5, u32::MAX)] {
        keys.extend([(pixel, 0, seed), (pixel, 1, seed)]);
    }
    let mut sequences = Vec::new();
    for (pixel, dimension, seed) in keys {
        let numbers: Vec<_> =
            (0..count).map(|sample| sample4(sampler, SampleKey { pixel, sample, seed }, dimension)).collect();
        for c in 0..4 {
            sequences.push(numbers.iter().map(|v| f64::from(v[c])).collect());
        }
    }
    sequences
}

/// Over 4096 samples, α = 1e-3 for all 2278 pairs together (Šidák). Low-discrepancy sequences correlate less than chance
/// within a pair of coordinates and as much between pairs, so the same bound holds for them. The kernels draw the same.
#[test]
fn numbers_of_different_dimensions_pixels_and_seeds_are_independent() {
    let count = 4096;
    for sampler in [Sampler::Independent, Sampler::Stratified] {
        let sequences = neighbours(sampler, count);
        let pairs = sequences.len() * (sequences.len() - 1) / 2;
        let bound = normal_two_sided_threshold(sidak(1e-3, pairs)) / f64::from(count).sqrt();
        let mut worst = (0.0, 0, 0);
        for i in 0..sequences.len() {
            for j in 0..i {
                let r = correlation(&sequences[i], &sequences[j]).abs();
                if r > worst.0 {
                    worst = (r, i, j);
                }
            }
        }
        assert!(worst.0 < bound, "{sampler:?}: sequences correlate by {worst:?}, bound {bound}");
    }
    // Negative control: a sequence and itself.
    let sequence = &neighbours(Sampler::Stratified, count)[0];
    assert!(correlation(sequence, sequence) > 0.99);
}

/// Means over samples are unbiased over pixels: 20,000 pixels, α = 6.3e-5 per coordinate.
#[test]
fn stratified_numbers_are_uniform_over_pixels() {
    for sample in [0, 1, 100] {
        for c in 0..4 {
            let mut counts = [0u64; 64];
            for pixel in 0..20_000 {
                let u = sample4(Sampler::Stratified, SampleKey { pixel, sample, seed: 9 }, 2)[c];
                counts[(u * 64.0) as usize] += 1;
            }
            let p = chi2_test(&counts, &[20_000.0 / 64.0; 64]).unwrap().p_value;
            assert!(p > ALPHA, "sample {sample}, coordinate {c}: p = {p}");
        }
    }
}

//! Samplers of directions, each with its density beside it. GPU twin: kernels/base/sampling.wesl

use glam::{Vec2, Vec3};
use std::f32::consts::{FRAC_1_PI, PI};
use std::ops::Range;

/// The largest number below 1.
pub const BELOW_ONE: f32 = 1.0 - f32::EPSILON / 2.0;

/// Direction about +z with density cosθ/π, in sr⁻¹. `u` in [0, 1)².
#[inline]
pub fn sample_cosine(u: Vec2) -> Vec3 {
    let radius = u.x.sqrt();
    let phi = 2.0 * PI * u.y;
    Vec3::new(radius * phi.cos(), radius * phi.sin(), (1.0 - u.x).sqrt())
}
#[inline]
pub fn pdf_cosine(cos_theta: f32) -> f32 {
    cos_theta.max(0.0) * FRAC_1_PI
}

/// Direction within a cone about +z; `one_minus_cos_max` = 1 − cosθmax is what small cones keep exact. Uniform.
#[inline]
pub fn sample_cone(u: Vec2, one_minus_cos_max: f32) -> Vec3 {
    let one_minus_cos = u.x * one_minus_cos_max;
    let sin_theta = (one_minus_cos * (2.0 - one_minus_cos)).sqrt();
    let phi = 2.0 * PI * u.y;
    Vec3::new(sin_theta * phi.cos(), sin_theta * phi.sin(), 1.0 - one_minus_cos)
}
#[inline]
pub fn pdf_cone(one_minus_cos_max: f32) -> f32 {
    1.0 / (2.0 * PI * one_minus_cos_max)
}

/// ln(1 − x), exact for small x, which 1 − x would round away. A series, so that it rounds as the kernels do.
#[inline]
fn log_one_minus(x: f32) -> f32 {
    if x < 0.02 { -x * (1.0 + x * (0.5 + x * (1.0 / 3.0 + x * 0.25))) } else { (1.0 - x).max(1e-37).ln() }
}

/// 1 − exp(−y), exact for small y.
#[inline]
fn one_minus_exp(y: f32) -> f32 {
    if y < 0.02 { y * (1.0 - y * (0.5 - y * (1.0 / 6.0 - y / 24.0))) } else { 1.0 - (-y).exp() }
}

/// Direction about +z with density (n + 1)/2π · cosⁿθ over the upper hemisphere of z. By way of 1 − cosθ, which narrow
/// lobes keep exact.
#[inline]
pub fn sample_phong(u: Vec2, exponent: f32) -> Vec3 {
    let one_minus_cos = one_minus_exp(-log_one_minus(u.x) / (exponent + 1.0));
    let sin_theta = (one_minus_cos * (2.0 - one_minus_cos)).sqrt();
    let phi = 2.0 * PI * u.y;
    Vec3::new(sin_theta * phi.cos(), sin_theta * phi.sin(), 1.0 - one_minus_cos)
}
#[inline]
pub fn pdf_phong(one_minus_cos: f32, exponent: f32) -> f32 {
    let lobe = if one_minus_cos < 1.0 { (exponent * log_one_minus(one_minus_cos)).exp() } else { 0.0 };
    (exponent + 1.0) * (0.5 * FRAC_1_PI) * lobe
}

/// Where in 0..1 a density falls that goes from `a` to `b` in a line; neither is negative, nor both 0.
#[inline(always)]
pub fn sample_linear(u: f32, a: f32, b: f32) -> f32 {
    let sum = (a + b).max(1e-37);
    let (a, b) = (a / sum, b / sum);
    let root = (a * a * (1.0 - u) + b * b * u).sqrt();
    (u / (a + root).max(1e-20)).min(1.0)
}

/// One row of an [`AliasTable`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AliasRow {
    /// Probability of this entry: how many of the 2²⁴ numbers that may be drawn choose it, exactly.
    pub probability: f32,
    /// The share of this row that is the entry itself; the rest is `alias`.
    pub threshold: f32,
    pub alias: u32,
}

/// Walker's alias table (Vose 1991): an entry drawn in constant time with probability proportional to its weight.
#[derive(Clone, Debug, Default)]
pub struct AliasTable {
    pub rows: Vec<AliasRow>,
}

/// How many numbers may be drawn: the multiples of 2⁻²⁴ below 1.
const DRAWABLE: u32 = 1 << 24;
/// Entries are drawn at least this much as often as the average one, however light, and by at least [`LEAST_DRAWS`] numbers, as
/// long as there are that many. Rare ones would else be drawn by one number or by none, whatever they weigh.
const LEAST_SHARE: f64 = 1.0 / 4096.0;
const LEAST_DRAWS: f64 = 16.0;

/// The row of a table of `count` that `u` falls into, and how far into it.
#[inline(always)]
pub fn alias_row(count: u32, u: f32) -> (u32, f32) {
    let scaled = u * count as f32;
    let i = (scaled as u32).min(count - 1);
    (i, scaled - i as f32)
}

/// The first of `numbers`, in units of 2⁻²⁴, that reaches something; the end of the range if none does.
fn first_reaching(numbers: Range<u32>, reaches: impl Fn(f32) -> bool) -> u32 {
    let Range { mut start, mut end } = numbers;
    while start < end {
        let middle = start + (end - start) / 2;
        match reaches(middle as f32 / DRAWABLE as f32) {
            true => end = middle,
            false => start = middle + 1,
        }
    }
    start
}

impl AliasTable {
    /// `weights` are finite and not negative; those of 0 are never drawn unless all are. Probabilities are those with which
    /// entries are really drawn, so that what is sampled is what is evaluated: by weight but for rounding, and for entries
    /// lighter than 1/4096 of the average.
    pub fn new(weights: &[f64]) -> AliasTable {
        AliasTable::rounded(weights, |threshold| threshold)
    }

    /// The same with thresholds of so many bits, and below 1.
    pub fn coarse(weights: &[f64], threshold_bits: u32) -> AliasTable {
        let levels = (1u32 << threshold_bits) as f32;
        AliasTable::rounded(weights, |threshold| (threshold * levels).round().min(levels - 1.0) / levels)
    }

    fn rounded(weights: &[f64], round: impl Fn(f32) -> f32) -> AliasTable {
        let mut table = AliasTable { rows: split_among_rows(weights) };
        table.rows.iter_mut().for_each(|row| row.threshold = round(row.threshold));
        table.count_draws();
        table
    }

    /// The probabilities, by counting the numbers that lead to each entry.
    fn count_draws(&mut self) {
        let count = self.rows.len() as u32;
        let mut draws = vec![0u32; self.rows.len()];
        let mut begin = 0;
        for (i, row) in (0..count).zip(&self.rows) {
            let end = first_reaching(begin..DRAWABLE, |u| alias_row(count, u).0 > i);
            let alias = first_reaching(begin..end, |u| alias_row(count, u).1 >= row.threshold);
            draws[i as usize] += alias - begin;
            draws[row.alias as usize] += end - alias;
            begin = end;
        }
        for (row, draws) in self.rows.iter_mut().zip(draws) {
            row.probability = draws as f32 / DRAWABLE as f32;
        }
    }
}

/// Rows without probabilities: each holds what is left of a light entry and tops up with a heavy one.
fn split_among_rows(weights: &[f64]) -> Vec<AliasRow> {
    let count = weights.len();
    let average = weights.iter().sum::<f64>() / count as f64;
    let least = LEAST_SHARE.max(LEAST_DRAWS * count as f64 / f64::from(DRAWABLE)).min(1.0) * average;
    let heaviest = (0..count).max_by(|&a, &b| weights[a].total_cmp(&weights[b])).unwrap_or(0);
    let black = |i: usize| weights[i] == 0.0 && weights[heaviest] > 0.0;
    let raised = |i: usize| if black(i) { 0.0 } else { weights[i].max(least).max(f64::MIN_POSITIVE) };
    let raised: Vec<f64> = (0..count).map(raised).collect();
    let total: f64 = raised.iter().sum();
    let mut share: Vec<f64> = raised.iter().map(|w| w / total * count as f64).collect();
    let (mut small, mut large): (Vec<usize>, Vec<usize>) = (0..count).partition(|&i| share[i] < 1.0);
    let mut rows: Vec<AliasRow> =
        (0..count).map(|i| AliasRow { probability: 0.0, threshold: 1.0, alias: i as u32 }).collect();
    while let (Some(s), Some(&l)) = (small.pop(), large.last()) {
        rows[s].threshold = share[s] as f32;
        rows[s].alias = l as u32;
        share[l] -= 1.0 - share[s];
        if share[l] < 1.0 {
            small.push(l);
            large.pop();
        }
    }
    // Rounding may leave rows over, which stay whole, but for those of entries that are never drawn.
    for row in small.into_iter().filter(|&row| black(row)) {
        (rows[row].threshold, rows[row].alias) = (0.0, heaviest as u32);
    }
    rows
}

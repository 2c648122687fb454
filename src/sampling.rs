//! Samplers of directions, each with its density beside it. GPU twin: kernels/base/sampling.wesl

use glam::{Vec2, Vec3};
use std::f32::consts::{FRAC_1_PI, PI};

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

/// One row of an [`AliasTable`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AliasRow {
    /// Probability of this entry.
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

impl AliasTable {
    /// `weights` are positive and finite. Probabilities are those that the rounded thresholds really give, so that what
    /// is sampled is what is evaluated.
    pub fn new(weights: &[f64]) -> AliasTable {
        let count = weights.len();
        let total: f64 = weights.iter().sum();
        let mut share: Vec<f64> = weights.iter().map(|w| w / total * count as f64).collect();
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
        let mut probability = vec![0.0; count];
        for (i, row) in rows.iter().enumerate() {
            probability[i] += f64::from(row.threshold);
            probability[row.alias as usize] += 1.0 - f64::from(row.threshold);
        }
        for (row, p) in rows.iter_mut().zip(&probability) {
            row.probability = (p / count as f64) as f32;
        }
        AliasTable { rows }
    }
}

//! The normal distribution: tails, quantiles, and thresholds for many tests at once.

use std::f64::consts::{PI, SQRT_2};

use super::gamma::gamma_q;

/// Complementary error function; relative error below 1e-12, in the far tail too.
pub fn erfc(x: f64) -> f64 {
    if x >= 0.0 { gamma_q(0.5, x * x) } else { 2.0 - gamma_q(0.5, x * x) }
}

/// P(Z ≤ z).
pub fn normal_cdf(z: f64) -> f64 {
    0.5 * erfc(-z / SQRT_2)
}

/// P(Z > z), accurate where it is tiny.
pub fn normal_survival(z: f64) -> f64 {
    0.5 * erfc(z / SQRT_2)
}

/// The z with P(Z ≤ z) = p; ±∞ at p = 1 and 0, NaN outside [0, 1].
/// Acklam's rational approximation (1e-9) and one step of Halley's method against [`erfc`].
pub fn normal_quantile(p: f64) -> f64 {
    if p.is_nan() || !(0.0..=1.0).contains(&p) {
        return f64::NAN;
    }
    if p > 0.5 { -lower_quantile(1.0 - p) } else { lower_quantile(p) }
}

/// Quantile for 0 ≤ p ≤ 1/2.
fn lower_quantile(p: f64) -> f64 {
    if p == 0.0 {
        return f64::NEG_INFINITY;
    }
    let z = acklam(p);
    let error = (normal_cdf(z) - p) * (2.0 * PI).sqrt() * (0.5 * z * z).exp();
    let refined = z - error / (1.0 + 0.5 * z * error);
    if refined.is_finite() { refined } else { z }
}

fn polynomial(coefficients: &[f64], x: f64) -> f64 {
    coefficients.iter().fold(0.0, |sum, c| sum * x + c)
}

/// P. J. Acklam 2003, for 0 < p ≤ 1/2.
fn acklam(p: f64) -> f64 {
    const A: [f64; 6] = [
        -3.969683028665376e1,
        2.209460984245205e2,
        -2.759285104469687e2,
        1.383_577_518_672_69e2,
        -3.066479806614716e1,
        2.506628277459239,
    ];
    const B: [f64; 6] = [
        -5.447609879822406e1,
        1.615858368580409e2,
        -1.556989798598866e2,
        6.680131188771972e1,
        -1.328068155288572e1,
        1.0,
    ];
    const C: [f64; 6] = [
        -7.784894002430293e-3,
        -3.223964580411365e-1,
        -2.400758277161838,
        -2.549732539343734,
        4.374664141464968,
        2.938163982698783,
    ];
    const D: [f64; 5] =
        [7.784695709041462e-3, 3.224671290700398e-1, 2.445134137142996, 3.754408661907416, 1.0];
    if p < 0.02425 {
        let q = (-2.0 * p.ln()).sqrt();
        polynomial(&C, q) / polynomial(&D, q)
    } else {
        let q = p - 0.5;
        q * polynomial(&A, q * q) / polynomial(&B, q * q)
    }
}

/// Level of each of `tests` tests so that all together err with probability `alpha`: 1 − (1 − α)^(1/m).
/// Exact for independent tests, on the safe side for any jointly normal two-sided ones (Šidák 1967).
pub fn sidak(alpha: f64, tests: usize) -> f64 {
    -((-alpha).ln_1p() / tests.max(1) as f64).exp_m1()
}

/// The t with P(|Z| > t) = level.
pub fn normal_two_sided_threshold(level: f64) -> f64 {
    -normal_quantile(0.5 * level)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// As the C library has them.
    #[test]
    fn erfc_matches_known_values() {
        let known = [
            (0.0, 1.0),
            (0.5, 0.479_500_122_186_953_5),
            (1.0, 0.157_299_207_050_285_13),
            (2.0, 0.004_677_734_981_047_266),
            (3.0, 2.209_049_699_858_544e-5),
            (5.0, 1.537_459_794_428_035e-12),
            (10.0, 2.088_487_583_762_545e-45),
            (-1.0, 1.842_700_792_949_715),
        ];
        for (x, want) in known {
            assert!((erfc(x) / want - 1.0).abs() < 1e-12, "erfc({x}) = {} not {want}", erfc(x));
        }
    }

    #[test]
    fn quantile_matches_known_values() {
        let known = [
            (0.5, 0.0),
            (0.975, 1.959_963_984_540_054),
            (0.995, 2.575_829_303_548_901),
            (0.841_344_746_068_542_9, 1.0),
            (0.001, -3.090_232_306_167_813_5),
            (1e-6, -4.753_424_308_822_899),
            (1e-12, -7.034_483_825_301_131),
        ];
        for (p, want) in known {
            assert!((normal_quantile(p) - want).abs() < 1e-10, "{p}: {} not {want}", normal_quantile(p));
        }
    }

    #[test]
    fn quantile_inverts_the_cdf() {
        for i in 1..600 {
            let z = f64::from(i) * -0.05;
            assert!((normal_quantile(normal_cdf(z)) - z).abs() < 1e-9 * (1.0 - z), "z = {z}");
        }
        assert!(normal_quantile(-0.1).is_nan() && normal_quantile(f64::NAN).is_nan());
        assert_eq!(normal_quantile(0.0), f64::NEG_INFINITY);
        assert_eq!(normal_quantile(1.0), f64::INFINITY);
    }

    #[test]
    fn sidak_keeps_the_family_at_alpha() {
        for tests in [1, 3, 3072, 1_000_000] {
            let each = sidak(0.01, tests);
            assert!((1.0 - (1.0 - each).powi(tests as i32) - 0.01).abs() < 1e-9);
        }
        assert!((normal_two_sided_threshold(0.05) - 1.959_963_984_540_054).abs() < 1e-10);
    }
}

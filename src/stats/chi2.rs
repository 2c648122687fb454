//! Pearson's χ² test: do these counts come from this distribution?

use super::StatsError;
use super::gamma::gamma_q;

/// P(χ² with `dof` degrees of freedom > x).
pub fn chi2_survival(x: f64, dof: f64) -> f64 {
    gamma_q(0.5 * dof, 0.5 * x)
}

/// Outcome of [`chi2_test`].
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct ChiSquare {
    /// Σ (observed − expected)² / expected over the pooled cells.
    pub statistic: f64,
    /// Pooled cells − 1.
    pub dof: usize,
    /// Chance of a statistic as large if the expectation is right. 1 where a single cell is left: nothing was tested.
    pub p_value: f64,
}

/// Cells that expect fewer are pooled: below this the statistic is not χ² distributed.
const MIN_EXPECTED: f64 = 5.0;

/// Pearson's test of counts against expected counts (same total).
/// A count in a cell that expects exactly 0 is impossible and gives p = 0.
pub fn chi2_test(observed: &[u64], expected: &[f64]) -> Result<ChiSquare, StatsError> {
    if observed.len() != expected.len() {
        return Err(StatsError::CellMismatch { observed: observed.len(), expected: expected.len() });
    }
    if let Some(cell) = expected.iter().position(|e| !(e.is_finite() && *e >= 0.0)) {
        return Err(StatsError::BadExpectation { cell, value: expected[cell] });
    }
    let cells: Vec<(f64, f64)> = observed.iter().map(|&o| o as f64).zip(expected.iter().copied()).collect();
    let impossible = cells.iter().any(|&(o, e)| o > 0.0 && e == 0.0);
    let pooled = pool(cells);
    let dof = pooled.len().saturating_sub(1);
    if impossible {
        return Ok(ChiSquare { statistic: f64::INFINITY, dof, p_value: 0.0 });
    }
    let statistic = pooled.iter().map(|(o, e)| (o - e) * (o - e) / e).sum();
    let p_value = if dof == 0 { 1.0 } else { chi2_survival(statistic, dof as f64) };
    Ok(ChiSquare { statistic, dof, p_value })
}

/// Joins the smallest cells until each expects at least [`MIN_EXPECTED`].
fn pool(mut cells: Vec<(f64, f64)>) -> Vec<(f64, f64)> {
    cells.sort_by(|a, b| a.1.total_cmp(&b.1));
    let mut pooled = Vec::new();
    let mut open = (0.0, 0.0);
    for (observed, expected) in cells {
        open = (open.0 + observed, open.1 + expected);
        if open.1 >= MIN_EXPECTED {
            pooled.push(std::mem::take(&mut open));
        }
    }
    match pooled.last_mut() {
        Some(last) => *last = (last.0 + open.0, last.1 + open.1),
        None if open.1 > 0.0 => pooled.push(open),
        None => {}
    }
    pooled
}

#[cfg(test)]
mod tests {
    use super::super::test_images::Rng;
    use super::*;

    #[test]
    fn survival_matches_tabulated_critical_values() {
        let known = [
            (3.841_458_820_694_124, 1.0, 0.05),
            (18.307_038_053_275_146, 10.0, 0.05),
            (23.209_251_158_954_356, 10.0, 0.01),
            (124.342_113_404_004_1, 100.0, 0.05),
            (2.0 * 10f64.ln(), 2.0, 0.1),
        ];
        for (x, dof, want) in known {
            assert!(
                (chi2_survival(x, dof) - want).abs() < 1e-9,
                "χ²({x}; {dof}) = {}",
                chi2_survival(x, dof)
            );
        }
        assert_eq!(chi2_survival(0.0, 7.0), 1.0);
        assert!((chi2_survival(1e5, 1e5) - 0.5).abs() < 2e-3);
    }

    #[test]
    fn small_cells_are_pooled() {
        let result = chi2_test(&[1, 1, 1, 2, 0, 100], &[1.0, 1.0, 1.0, 1.0, 1.0, 100.0]).unwrap();
        assert_eq!((result.dof, result.statistic, result.p_value), (1, 0.0, 1.0));
        assert_eq!(chi2_test(&[3], &[3.0]).unwrap().p_value, 1.0);
        assert_eq!(chi2_test(&[], &[]).unwrap().dof, 0);
    }

    #[test]
    fn a_count_where_none_can_be_has_no_chance() {
        assert_eq!(chi2_test(&[1, 99], &[0.0, 100.0]).unwrap().p_value, 0.0);
    }

    #[test]
    fn bad_expectations_are_errors() {
        assert!(chi2_test(&[1], &[]).is_err());
        assert!(chi2_test(&[1], &[f64::NAN]).is_err());
        assert!(chi2_test(&[1], &[-1.0]).is_err());
    }

    fn histogram(rng: &mut Rng, draws: usize, cells: usize, power: f64) -> Vec<u64> {
        let mut counts = vec![0; cells];
        for _ in 0..draws {
            counts[(rng.uniform().powf(power) * cells as f64) as usize] += 1;
        }
        counts
    }

    /// 1000 seeds at α = 0.05: 50 ± 6.9 false alarms; the bounds are 4 σ.
    #[test]
    fn uniform_counts_pass_as_often_as_promised_and_skewed_ones_fail() {
        let expected = vec![50.0; 20];
        let p = |seed, power| {
            chi2_test(&histogram(&mut Rng::new(seed), 1000, 20, power), &expected).unwrap().p_value
        };
        let alarms = (0..1000).filter(|&seed| p(seed, 1.0) < 0.05).count();
        assert!((22..=78).contains(&alarms), "{alarms} false alarms in 1000");
        assert!((0..20).all(|seed| p(seed, 1.5) < 1e-4));
    }
}

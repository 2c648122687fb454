//! Directions counted in cells, and what a density says of their numbers.

use glam::{DVec3, Vec3};
use qtracer::math::{frame_around, to_world};
use qtracer::stats::chi2_test;
use std::f64::consts::TAU;

pub const ALPHA: f64 = 1e-4;
pub const WRONG: f64 = 1e-9;

/// Cells in which directions are counted: equal steps of z between `bottom` and `top`, and of φ, about `axis`.
pub struct Cells {
    pub axis: Vec3,
    pub bottom: f64,
    pub top: f64,
    pub rows: usize,
    pub columns: usize,
}

impl Cells {
    pub fn sphere(axis: Vec3) -> Cells {
        Cells { axis, bottom: -1.0, top: 1.0, rows: 20, columns: 12 }
    }

    pub fn hemisphere(axis: Vec3) -> Cells {
        Cells { bottom: 0.0, rows: 16, ..Cells::sphere(axis) }
    }

    /// Index of the cell, None outside.
    fn find(&self, direction: Vec3) -> Option<usize> {
        let (tangent, bitangent) = frame_around(self.axis);
        let z = f64::from(direction.dot(self.axis));
        let phi = f64::from(direction.dot(bitangent)).atan2(direction.dot(tangent).into()).rem_euclid(TAU);
        // Directions on the very edge belong to the outermost cells: f32 puts them on either side.
        let row = (z - self.bottom) / (self.top - self.bottom) * self.rows as f64;
        if row < -1e-3 || row > self.rows as f64 + 1e-3 {
            return None;
        }
        let row = (row.max(0.0) as usize).min(self.rows - 1);
        Some(row * self.columns + ((phi / TAU * self.columns as f64) as usize).min(self.columns - 1))
    }

    /// ∫ pdf dω over each cell: midpoints of a fine grid, which discontinuities within a cell survive.
    pub fn integrate(&self, pdf: impl Fn(Vec3) -> f64) -> Vec<f64> {
        const FINE: usize = 48;
        let (rows, columns) = (self.rows * FINE, self.columns * FINE);
        let area = (self.top - self.bottom) / rows as f64 * TAU / columns as f64;
        let mut cells = vec![0.0; self.rows * self.columns];
        for row in 0..rows {
            let z = self.bottom + (self.top - self.bottom) * (row as f64 + 0.5) / rows as f64;
            for column in 0..columns {
                let phi = TAU * (column as f64 + 0.5) / columns as f64;
                let r = (1.0 - z * z).sqrt();
                let local = DVec3::new(r * phi.cos(), r * phi.sin(), z).as_vec3();
                cells[row / FINE * self.columns + column / FINE] += area * pdf(to_world(local, self.axis));
            }
        }
        cells
    }

    /// p-value of 100,000 draws against the density, of which `missing` is the share that gives no direction.
    pub fn chi2(&self, sample: impl Fn(u32) -> Option<Vec3>, pdf: impl Fn(Vec3) -> f64) -> f64 {
        self.chi2_of(sample, &self.integrate(pdf))
    }

    /// The same, for a density of which the integrals over the cells are known.
    pub fn chi2_of(&self, sample: impl Fn(u32) -> Option<Vec3>, integrals: &[f64]) -> f64 {
        self.p_value((0..100_000).map(sample), integrals)
    }

    /// p-value of these draws.
    pub fn p_value(&self, draws: impl ExactSizeIterator<Item = Option<Vec3>>, integrals: &[f64]) -> f64 {
        let count = draws.len() as f64;
        let mut expected: Vec<f64> = integrals.iter().map(|p| p * count).collect();
        let mut observed = vec![0u64; expected.len() + 1];
        for draw in draws {
            match draw {
                Some(direction) => {
                    let cell = self.find(direction);
                    observed[cell.unwrap_or_else(|| panic!("{direction} is outside all cells"))] += 1;
                }
                None => *observed.last_mut().unwrap() += 1,
            }
        }
        expected.push((count - expected.iter().sum::<f64>()).max(0.0));
        // A cell of which the quadrature saw next to nothing joins the others.
        expected.iter_mut().for_each(|e| *e = e.max(1e-6));
        chi2_test(&observed, &expected).unwrap().p_value
    }

    /// The draws follow the density of these integrals, and would not follow one 3 % greater on one side and 3 % less on
    /// the other.
    pub fn are_followed(&self, what: &str, draws: &[Option<Vec3>], integrals: &[f64]) {
        let p = self.p_value(draws.iter().copied(), integrals);
        assert!(p > ALPHA, "{what}: p = {p}");
        let side = |i: usize| if 2 * (i % self.columns) < self.columns { 1.03 } else { 0.97 };
        let askew: Vec<f64> = integrals.iter().enumerate().map(|(i, p)| p * side(i)).collect();
        let p = self.p_value(draws.iter().copied(), &askew);
        assert!(p < WRONG, "{what}: a density 3 % askew passes with p = {p}");
    }
}

//! An environment map as rays meet it: packed texels, and tables that draw the patches between them by radiance.

use std::f64::consts::PI;

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::EnvironmentMap;
use crate::gpu_struct;
use crate::sampling::{AliasRow, AliasTable};

gpu_struct! {
    /// A row of patches in the alias table of rows.
    pub struct SkyRow {
        /// Stay on this row below, go to alias_index from here on.
        threshold: f32,
        alias_index: u32,
        _pad0: u32,
        _pad1: u32,
    }
    /// A texel, and the patch of which it is the lower left corner. 16 bytes.
    pub struct SkyCell {
        /// Three numbers of 18 bits, then 8 bits of an exponent that they share: see [`pack_radiance`].
        radiance_low: u32,
        radiance_high: u32,
        /// The patch's row of the alias table of its row: 18 bits of threshold, above these 14 of another column.
        choice: u32,
        /// Density of a direction within the patch over (R + G + B)/sinθ there; 0 where no patch is drawn.
        density: f32,
    }
}

/// Bits of a threshold in [`SkyCell::choice`].
pub const THRESHOLD_BITS: u32 = 18;
/// Bits of each channel.
pub const CHANNEL_BITS: u32 = 18;
/// Patches of less than this share of the average are not drawn; what little they hold is found by chance.
const NEGLIGIBLE: f64 = 1e-20;

/// A compiled map. Patches lie between the centres of four texels, those of the first and the last row between a row of
/// texels and a pole: there are `height + 1` rows of patches, and as many rows of cells. Row r of cells holds texels of
/// row r, the last those of the row before once more; a patch has its own row of cells below and the one before above.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Sky {
    pub width: u32,
    pub height: u32,
    /// By how much of a whole turn the map's longitude is ahead of the world's.
    pub turn: f32,
    /// Chance that direct light asks the map, not a lamp.
    pub share: f32,
    pub rows: Vec<SkyRow>,
    pub cells: Vec<SkyCell>,
    /// ∫ (R + G + B) dω over all directions.
    pub irradiance: f64,
    /// The largest texel, each channel for itself.
    pub brightest: Vec3,
}

impl Sky {
    /// None if the map is black.
    pub fn new(map: &EnvironmentMap, tint: DVec3) -> Option<Sky> {
        let tinted = |texel: &[f32; 3]| (Vec3::from(*texel).as_dvec3() * tint).as_vec3().to_array();
        let packed: Vec<[u32; 2]> = map.texels.iter().map(|texel| pack_radiance(tinted(texel))).collect();
        let brightest = packed.iter().fold(Vec3::ZERO, |most, &p| most.max(unpack_radiance(p)));
        let patches = Patches::new(map.width as usize, map.height as usize, packed);
        let numbers = (0..=patches.height).into_par_iter();
        let powers: Vec<f64> = numbers.clone().map(|row| patches.power(row)).collect();
        let irradiance: f64 = powers.iter().sum();
        if irradiance <= 0.0 {
            return None;
        }
        let least = NEGLIGIBLE * irradiance / (patches.width * powers.len()) as f64;
        let table = AliasTable::new(&powers).rows;
        let cells = numbers.flat_map_iter(|row| patches.cells(row, table[row].probability, least)).collect();
        let row =
            |row: AliasRow| SkyRow { threshold: row.threshold, alias_index: row.alias, ..Default::default() };
        Some(Sky {
            width: map.width,
            height: map.height,
            turn: (map.rotate_y_deg / 360.0).rem_euclid(1.0) as f32,
            share: 0.0,
            rows: table.into_iter().map(row).collect(),
            cells,
            irradiance,
            brightest,
        })
    }

    /// Bytes on a GPU.
    pub fn bytes(&self) -> usize {
        size_of_val(&self.rows[..]) + size_of_val(&self.cells[..])
    }
}

/// The patches between texels, row by row.
struct Patches {
    width: usize,
    height: usize,
    packed: Vec<[u32; 2]>,
    /// R + G + B of each texel as packed.
    sums: Vec<f64>,
}

impl Patches {
    fn new(width: usize, height: usize, packed: Vec<[u32; 2]>) -> Patches {
        let sums = packed.iter().map(|&p| unpack_radiance(p).as_dvec3().element_sum()).collect();
        Patches { width, height, packed, sums }
    }

    /// The number of a texel; columns go around, the last row comes twice.
    fn texel(&self, column: usize, row: usize) -> usize {
        row.min(self.height - 1) * self.width + column % self.width
    }

    /// The mean of a patch is that of its four corners.
    fn mean(&self, column: usize, row: usize) -> f64 {
        let above = row.saturating_sub(1);
        let at = |column| self.sums[self.texel(column, above)] + self.sums[self.texel(column, row)];
        0.25 * (at(column) + at(column + 1))
    }

    /// What a row sends, all channels together.
    fn power(&self, row: usize) -> f64 {
        let means: f64 = (0..self.width).map(|column| self.mean(column, row)).sum();
        means * patch_solid_angle(row, self.width, self.height)
    }

    /// The cells of a row that is drawn with that probability, without patches that send less than `least`.
    fn cells(&self, row: usize, row_probability: f32, least: f64) -> Vec<SkyCell> {
        let solid_angle = patch_solid_angle(row, self.width, self.height);
        let area = patch_area(row, self.width, self.height);
        let weigh = |column| Some(self.mean(column, row)).filter(|mean| mean * solid_angle > least);
        let weights: Vec<f64> = (0..self.width).map(|column| weigh(column).unwrap_or(0.0)).collect();
        let levels = 1u32 << THRESHOLD_BITS;
        let cell = |(column, choice): (usize, AliasRow)| {
            let [radiance_low, radiance_high] = self.packed[self.texel(column, row)];
            let probability = f64::from(row_probability) * f64::from(choice.probability);
            let density = if weights[column] > 0.0 { probability / (area * weights[column]) } else { 0.0 };
            let threshold = ((choice.threshold * levels as f32) as u32).min(levels - 1);
            let choice = threshold | choice.alias << THRESHOLD_BITS;
            SkyCell { radiance_low, radiance_high, choice, density: density as f32 }
        };
        AliasTable::coarse(&weights, THRESHOLD_BITS).rows.into_iter().enumerate().map(cell).collect()
    }
}

/// Colatitudes between which a row of patches lies.
fn patch_edges(row: usize, height: usize) -> [f64; 2] {
    let [low, high] = [(row as f64 - 0.5).max(0.0), (row as f64 + 0.5).min(height as f64)];
    [low * PI / height as f64, high * PI / height as f64]
}

/// Of one patch, in sr.
fn patch_solid_angle(row: usize, width: usize, height: usize) -> f64 {
    let [low, high] = patch_edges(row, height);
    (low.cos() - high.cos()) * 2.0 * PI / width as f64
}

/// Of one patch, in longitude × colatitude.
fn patch_area(row: usize, width: usize, height: usize) -> f64 {
    let [low, high] = patch_edges(row, height);
    (high - low) * 2.0 * PI / width as f64
}

/// Three numbers as multiples of a power of two that they share, to within 2⁻¹⁸ of the largest of them: a file's half
/// floats and shared exponents of 8 bits lose nothing that could be seen. Numbers below 2⁻¹⁰⁸ become 0.
pub fn pack_radiance(radiance: [f32; 3]) -> [u32; 2] {
    let largest = radiance.into_iter().fold(0f32, f32::max);
    let levels = f64::from(1u32 << CHANNEL_BITS);
    // The power of two that makes the largest number a whole one of 18 bits; one more if rounding needs a 19th.
    let step = |exponent: i32| f64::from(exponent).exp2();
    let mut exponent = (f64::from(largest).log2().floor() as i32).max(-200) + 1 - CHANNEL_BITS as i32;
    if (f64::from(largest) / step(exponent)).round() >= levels {
        exponent += 1;
    }
    let biased = exponent + 127;
    if largest <= 0.0 || biased < 1 {
        return [0, 0];
    }
    let [r, g, b] = radiance.map(|v| (f64::from(v) / step(exponent)).round() as u32);
    [r | g << 18, g >> 14 | b << 4 | (biased as u32) << 22]
}

/// What was packed. GPU twin: unpack_radiance in kernels/scene/sky.wesl
#[inline(always)]
pub fn unpack_radiance([low, high]: [u32; 2]) -> Vec3 {
    let scale = f32::from_bits((high >> 22) << 23);
    let green = low >> 18 | (high & 0xf) << 14;
    Vec3::new((low & 0x3ffff) as f32, green as f32, (high >> 4 & 0x3ffff) as f32) * scale
}

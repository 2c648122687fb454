//! The environment map: what arrives from a direction, and directions by what arrives. Radiance is linear between the centres
//! of texels, so within a patch between four of them it is sampled exactly but for the sine of the colatitude; patches are
//! drawn by their mean radiance times their solid angle. (Maps by alias tables: Pharr, Jakob, Humphreys 2023, 12.5.)
//! GPU twin: kernels/scene/sky.wesl

use super::compiled::CompiledScene;
use super::environment::{Sky, THRESHOLD_BITS, unpack_radiance};
use crate::math::angle_of;
use crate::sampling::{alias_row, sample_linear};
use glam::{Vec3, Vec4};
use std::f32::consts::PI;

/// What a map sends from a direction.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SkySample {
    pub wi: Vec3,
    pub radiance: Vec3,
    /// Density with which [`sample_sky`] chooses the direction, in sr⁻¹.
    pub pdf: f32,
}

/// What lies between four texels' centres, from the upper left on, left to right.
struct SkyPatch {
    corners: [Vec3; 4],
    /// See [`SkyCell::density`](super::environment::SkyCell).
    density: f32,
}

/// Sines below this are taken for it: the poles have no longitude.
const LEAST_SINE: f32 = 1e-9;

#[inline(always)]
fn sky_patch(sky: &Sky, column: u32, row: u32) -> SkyPatch {
    let right = if column + 1 == sky.width { 0 } else { column + 1 };
    let above = row.max(1) - 1;
    let cell = |column: u32, row: u32| &sky.cells[(row * sky.width + column) as usize];
    let own = cell(column, row);
    let cells = [cell(column, above), cell(right, above), own, cell(right, row)];
    SkyPatch {
        corners: cells.map(|cell| unpack_radiance([cell.radiance_low, cell.radiance_high])),
        density: own.density,
    }
}

#[inline(always)]
fn channel_sum(radiance: Vec3) -> f32 {
    radiance.x + radiance.y + radiance.z
}

#[inline(always)]
fn mix(a: Vec3, b: Vec3, t: f32) -> Vec3 {
    a * (1.0 - t) + b * t
}

/// Radiance and density at a place in a patch, both coordinates in 0..1 from its upper left.
#[inline(always)]
fn at_place(patch: &SkyPatch, wi: Vec3, [x, y]: [f32; 2], sine: f32) -> SkySample {
    let [a, b, c, d] = patch.corners;
    let radiance = mix(mix(a, b, x), mix(c, d, x), y);
    SkySample { wi, radiance, pdf: patch.density * channel_sum(radiance) / sine.max(LEAST_SINE) }
}

/// What arrives from the direction `wi`.
#[inline(always)]
pub fn sky_at(sky: &Sky, wi: Vec3) -> SkySample {
    let (width, height) = (sky.width as f32, sky.height as f32);
    let sine = (wi.x * wi.x + wi.z * wi.z).sqrt();
    let longitude = angle_of(wi.x, -wi.z) * (0.5 / PI) + sky.turn;
    let x = (longitude - longitude.floor()) * width - 0.5;
    let x = if x < 0.0 { x + width } else { x };
    let y = angle_of(sine, wi.y) * (height / PI) + 0.5;
    let (column, row) = ((x as u32).min(sky.width - 1), (y as u32).min(sky.height));
    at_place(&sky_patch(sky, column, row), wi, [x - column as f32, y - row as f32], sine)
}

/// The row of patches that `u` chooses, then the column that `v` chooses in it.
#[inline(always)]
fn choose_patch(sky: &Sky, u: f32, v: f32) -> [u32; 2] {
    let (row, share) = alias_row(sky.height + 1, u);
    let entry = &sky.rows[row as usize];
    let row = if share >= entry.threshold { entry.alias_index } else { row };
    let (column, share) = alias_row(sky.width, v);
    let choice = sky.cells[(row * sky.width + column) as usize].choice;
    let threshold = (choice & ((1 << THRESHOLD_BITS) - 1)) as f32 * (1.0 / (1u32 << THRESHOLD_BITS) as f32);
    [if share >= threshold { choice >> THRESHOLD_BITS } else { column }, row]
}

/// A direction by radiance, `u` in [0, 1)⁴; its density is 0 where the map is black.
#[inline(always)]
pub fn sample_sky(scene: &CompiledScene, u: Vec4) -> SkySample {
    let Some(sky) = &scene.sky else { return SkySample::default() };
    let [column, row] = choose_patch(sky, u.x, u.y);
    let patch = sky_patch(sky, column, row);
    let [a, b, c, d] = patch.corners.map(channel_sum);
    let y = sample_linear(u.z, a + b, c + d);
    let x = sample_linear(u.w, a * (1.0 - y) + c * y, b * (1.0 - y) + d * y);
    // The first and the last row of patches are half as high: their corners above are those below.
    let top = (row as f32 - 0.5).max(0.0);
    let bottom = (row as f32 + 0.5).min(sky.height as f32);
    let colatitude = (top + (bottom - top) * y) * (PI / sky.height as f32);
    let longitude = (column as f32 + 0.5 + x) / sky.width as f32 - sky.turn;
    // Within half a turn, where sines are exact.
    let angle = 2.0 * PI * (longitude - (longitude + 0.5).floor());
    let sine = colatitude.sin();
    let wi = Vec3::new(sine * angle.sin(), colatitude.cos(), -sine * angle.cos());
    at_place(&patch, wi, [x, y], sine)
}

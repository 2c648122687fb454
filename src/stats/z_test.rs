//! Do two images differ by more than their noise?
//!
//! Four families of statistics, of which the decisive ones share the error rate α (Šidák):
//! block means and whole-image means, which are sums of many samples and so close to normal, always decide.
//! Single pixels and the dispersion of the blocks are reported, and decide only by option: at finite samples a
//! pixel's own standard error is uncertain and heavy-tailed (a pixel that has not yet seen its rare bright path
//! claims to be exact), which makes both fail for right images.

use super::StatsError;
use super::chi2::chi2_survival;
use super::normal::{normal_two_sided_threshold, sidak};
use super::view::{ImageView, check_pair};
use super::z_report::{Dispersion, Extreme, PixelReport, ZReport};

/// How to test. The default suits renders of different engines with their own standard errors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ZTestOptions {
    /// Chance that a right image fails.
    pub alpha: f64,
    /// Side of the square blocks, in pixels.
    pub block: usize,
    /// Let single pixels decide too.
    pub pixels_decisive: bool,
    /// Let the mean of the squared block z decide too.
    pub dispersion_decisive: bool,
}

impl Default for ZTestOptions {
    fn default() -> Self {
        Self { alpha: 0.01, block: 8, pixels_decisive: false, dispersion_decisive: false }
    }
}

/// Values that claim to be exact may differ by this much, relatively: f32 arithmetic in another order.
const EXACT_TOLERANCE: f64 = 1e-5;
/// Standard deviation of that rounding, added to the noise of values that have some.
const ROUNDING: f64 = 0.25 * EXACT_TOLERANCE;

/// Compares two images with standard errors (`None`: exact; at least one must have them).
pub fn z_test(a: &ImageView, b: &ImageView, options: &ZTestOptions) -> Result<ZReport, StatsError> {
    check_pair(a, b)?;
    check_options(options)?;
    if a.standard_error.is_none() && b.standard_error.is_none() {
        return Err(StatsError::NoStandardErrors);
    }
    check_errors(a, "first")?;
    check_errors(b, "second")?;

    let families = 2 + usize::from(options.pixels_decisive) + usize::from(options.dispersion_decisive);
    let level = sidak(options.alpha, families);
    let blocks = Family::over_tiles(a, b, options.block.min(a.width), options.block.min(a.height));
    let means = Family::over_tiles(a, b, a.width, a.height).extreme(level);
    let pixels = Family::over_tiles(a, b, 1, 1).pixel_report(level);
    let dispersion = blocks.dispersion(level);
    let blocks = blocks.extreme(level);
    let passes = blocks.passes()
        && means.passes()
        && (!options.pixels_decisive || pixels.extreme.passes())
        && (!options.dispersion_decisive || dispersion.passes());
    let ZTestOptions { alpha, pixels_decisive, dispersion_decisive, .. } = *options;
    Ok(ZReport { alpha, blocks, means, pixels, dispersion, pixels_decisive, dispersion_decisive, passes })
}

fn check_options(options: &ZTestOptions) -> Result<(), StatsError> {
    match *options {
        ZTestOptions { alpha, .. } if !(alpha > 0.0 && alpha < 1.0) => Err(StatsError::BadAlpha(alpha)),
        ZTestOptions { block: 0, .. } => Err(StatsError::EmptyBlock),
        _ => Ok(()),
    }
}

/// An unknown (infinite) error would let anything pass.
fn check_errors(view: &ImageView, what: &'static str) -> Result<(), StatsError> {
    let errors = view.standard_error.unwrap_or_default();
    let bad = |rgb: &[f32; 3]| rgb.iter().copied().find(|se| !(se.is_finite() && *se >= 0.0));
    match errors.iter().enumerate().find_map(|(pixel, rgb)| bad(rgb).map(|value| (pixel, value))) {
        Some((pixel, value)) => {
            Err(StatsError::BadStandardError { what, x: pixel % view.width, y: pixel / view.width, value })
        }
        None => Ok(()),
    }
}

/// z of one difference; infinite where it can't be (see [`EXACT_TOLERANCE`]) or where a value is NaN.
fn z_score(a: f64, b: f64, variance: f64) -> f64 {
    let magnitude = a.abs().max(b.abs());
    let z = if a == b {
        0.0
    } else if variance == 0.0 {
        if (a - b).abs() <= EXACT_TOLERANCE * magnitude { 0.0 } else { f64::INFINITY }
    } else {
        (a - b) / (variance + (ROUNDING * magnitude).powi(2)).sqrt()
    };
    if z.is_nan() { f64::INFINITY } else { z }
}

/// One tile's z per channel.
struct TileZ {
    x: usize,
    y: usize,
    z: [f64; 3],
}

/// The z statistics of all tiles of one size.
struct Family {
    tiles: Vec<TileZ>,
}

impl Family {
    /// Tiles of `w` × `h` pixels, cut off at the right and lower edge.
    fn over_tiles(a: &ImageView, b: &ImageView, w: usize, h: usize) -> Self {
        let corners = (0..a.height).step_by(h).flat_map(|y| (0..a.width).step_by(w).map(move |x| (x, y)));
        let tiles =
            corners.map(|(x, y)| TileZ { x, y, z: [0, 1, 2].map(|c| tile_z(a, b, (x, y), (w, h), c)) });
        Self { tiles: tiles.collect() }
    }

    fn extreme(&self, level: f64) -> Extreme {
        let tests = 3 * self.tiles.len();
        let threshold = normal_two_sided_threshold(sidak(level, tests));
        let mut worst = Extreme { tests, max_abs_z: 0.0, threshold, x: 0, y: 0, channel: 0 };
        for tile in &self.tiles {
            for (channel, z) in tile.z.iter().enumerate() {
                if z.abs() > worst.max_abs_z {
                    worst = Extreme { max_abs_z: z.abs(), x: tile.x, y: tile.y, channel, ..worst };
                }
            }
        }
        worst
    }

    fn values(&self) -> impl Iterator<Item = f64> {
        self.tiles.iter().flat_map(|tile| tile.z)
    }

    fn pixel_report(&self, level: f64) -> PixelReport {
        let above = self.values().filter(|z| z.abs() > 3.0).count();
        let extreme = self.extreme(level);
        PixelReport { extreme, share_above_3: above as f64 / extreme.tests as f64 }
    }

    /// With fully correlated channels Σz²/3 over n blocks is χ² with n degrees of freedom; with less it varies less.
    fn dispersion(&self, level: f64) -> Dispersion {
        let dof = self.tiles.len() as f64;
        let mean_square_z = self.values().map(|z| z * z).sum::<f64>() / (3.0 * dof);
        Dispersion { mean_square_z, p_value: chi2_survival(mean_square_z * dof, dof), level }
    }
}

fn tile_z(
    a: &ImageView,
    b: &ImageView,
    (x, y): (usize, usize),
    (w, h): (usize, usize),
    channel: usize,
) -> f64 {
    let (mut sum_a, mut sum_b, mut variance, mut count) = (0.0, 0.0, 0.0, 0.0);
    for row in y..(y + h).min(a.height) {
        for pixel in row * a.width + x..row * a.width + (x + w).min(a.width) {
            sum_a += f64::from(a.rgb[pixel][channel]);
            sum_b += f64::from(b.rgb[pixel][channel]);
            variance += a.error_at(pixel, channel).powi(2) + b.error_at(pixel, channel).powi(2);
            count += 1.0;
        }
    }
    z_score(sum_a / count, sum_b / count, variance / (count * count))
}

#[cfg(test)]
#[path = "z_test_tests.rs"]
mod tests;

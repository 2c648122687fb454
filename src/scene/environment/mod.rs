//! Light from far away that differs by direction: environment maps, as given and checked.
//!
//! A map is a picture in latitude and longitude. Its middle lies in +z, its left and right edges meet in −z, its top row is
//! +y: seen from inside it looks as the picture does, not mirrored. This is how Mitsuba 3 and pbrt-v3 (its y up) lay it.
//! Longitude grows to the right by atan2(x, −z), from −z over +x to +z; `rotate_y_deg` turns the sky as it turns a box,
//! counterclockwise from above: by 90°, the middle comes to lie in +x.
//!
//! Between the centres of texels radiance is interpolated in both directions, across the seam as elsewhere; from the
//! outermost rows to the poles it stays what it is in those.

mod cells;
mod file;
mod share;
#[cfg(test)]
mod tests;

use std::sync::Arc;

use super::SceneError;
use super::error::Fault;

pub use cells::{Sky, SkyCell, SkyRow, THRESHOLD_BITS, pack_radiance, unpack_radiance};
pub(super) use file::of_scene;
pub(super) use share::environment_share;

/// Longest sides of a map: columns are numbered with 14 bits.
const WIDEST: u32 = 16384;
const HIGHEST: u32 = 8192;
/// Texels that a map may have: 4096 × 2048, 128 MiB on a GPU.
const MOST_TEXELS: u64 = 1 << 23;

/// Radiance by direction; see the [module](self) for which. Cheap to clone.
#[derive(Clone, Debug, PartialEq)]
pub struct EnvironmentMap {
    width: u32,
    height: u32,
    /// Row by row from the top, each from the left; finite and ≥ 0.
    texels: Arc<[[f32; 3]]>,
    rotate_y_deg: f64,
    negative: usize,
}

impl EnvironmentMap {
    /// A map of linear RGB radiance, row by row from the top, each from the left. Negative numbers become 0, which
    /// [`warnings`](super::Scene::warnings) tell.
    ///
    /// # Errors
    /// Sizes of zero, above 16384 × 8192 or 2²³ texels, or that don't fit the number of texels; texels that are infinite or
    /// no numbers.
    pub fn new(width: u32, height: u32, texels: Vec<[f32; 3]>) -> Result<Self, SceneError> {
        Self::checked(width, height, texels).map_err(|problem| Fault::from(problem).of("environment", None))
    }

    fn checked(width: u32, height: u32, mut texels: Vec<[f32; 3]>) -> Result<Self, String> {
        check_size(width.into(), height.into())?;
        let (expected, given) = (width as usize * height as usize, texels.len());
        if given != expected {
            return Err(format!("is {width} × {height} but has {given} texels; give {expected}"));
        }
        if let Some(bad) = texels.iter().position(|texel| !texel.iter().all(|v| v.is_finite())) {
            let (column, row) = (bad as u32 % width, bad as u32 / width);
            return Err(format!(
                "has a texel (column {column}, row {row}, from 0) that is infinite or no number; replace it by a finite radiance"
            ));
        }
        let mut negative = 0;
        for texel in texels.iter_mut().filter(|texel| texel.iter().any(|v| *v < 0.0)) {
            *texel = texel.map(|v| v.max(0.0));
            negative += 1;
        }
        Ok(Self { width, height, texels: texels.into(), rotate_y_deg: 0.0, negative })
    }

    /// The same map, turned about the y axis so many degrees instead, counterclockwise from above.
    #[must_use]
    pub fn rotated(self, rotate_y_deg: f64) -> Self {
        Self { rotate_y_deg, ..self }
    }

    /// Columns, 1 to 16384.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Rows, 1 to 8192.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// Radiance, row by row from the top, each from the left.
    pub fn texels(&self) -> &[[f32; 3]] {
        &self.texels
    }

    /// Degrees by which it is turned about the y axis.
    pub fn rotate_y_deg(&self) -> f64 {
        self.rotate_y_deg
    }

    /// Texels in which something negative became 0.
    pub fn negative(&self) -> usize {
        self.negative
    }

    /// The largest number in it.
    pub fn brightest(&self) -> f32 {
        self.texels.iter().flatten().copied().fold(0.0, f32::max)
    }
}

/// Before anything of that size is allocated.
fn check_size(width: u64, height: u64) -> Result<(), String> {
    if width == 0 || height == 0 {
        return Err("has no texels; give it a width and a height".to_owned());
    }
    let fits = width <= WIDEST.into() && height <= HIGHEST.into();
    if !fits || width * height > MOST_TEXELS {
        return Err(format!(
            "is {width} × {height}, too large; scale it down to {WIDEST} × {HIGHEST} and {MOST_TEXELS} texels (4096 × 2048, 128 MiB on a GPU) at most"
        ));
    }
    Ok(())
}

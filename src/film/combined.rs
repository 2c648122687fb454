//! Passes of different noise put together: each is unbiased, so any weights that do not depend on its own noise keep the
//! mean right, and the inverse of its variance makes the sum least noisy.

use super::{Film, Image};
use rayon::prelude::*;

/// Per pixel: weighted means of passes.
#[derive(Clone, Debug, Default)]
pub struct CombinedFilm {
    pixels: Vec<CombinedPixel>,
    /// Weight of a sample of the last pass, per colour of the checkerboard.
    weights: [f64; 2],
}

#[derive(Clone, Copy, Debug, Default)]
struct CombinedPixel {
    /// Σ weight · mean.
    mean: [f64; 3],
    /// Σ weight² · squared standard error.
    variance: [f64; 3],
    weight: f64,
}

impl CombinedFilm {
    /// Adds a finished pass, or one on its way. `estimates` are rough luminances of the pixels, to judge errors by.
    ///
    /// A pixel's weight is the inverse of the pass's mean relative variance, estimated from the pixels of the other colour
    /// of a checkerboard: those are independent of the pixel's own noise, so the estimate does not bias it. A sample counts
    /// at least as much as one of any earlier pass, since learning makes passes better and a short pass that missed what is
    /// rare only seems less noisy.
    pub fn add(&mut self, pass: &Film, estimates: &[f32]) {
        let width = pass.width() as usize;
        self.pixels.resize(pass.pixels().len(), CombinedPixel::default());
        for (colour, weight) in self.weights.iter_mut().enumerate() {
            let least = weight.max(LEAST_WEIGHT);
            *weight =
                relative_variance(pass, estimates, colour).map_or(least, |v| least.max(1.0 / v.max(1e-12)));
        }
        let weights = self.weights;
        self.pixels.par_iter_mut().with_min_len(1 << 12).zip(pass.pixels()).enumerate().for_each(
            |(i, (combined, pixel))| {
                // Nobody knows the error of a single sample: it counts only where there is nothing else.
                if pixel.count == 0 || (pixel.count == 1 && combined.weight > 0.0) {
                    return;
                }
                let weight = weights[1 - (i % width + i / width) % 2] * pixel.count as f64;
                let (mean, error) = (pixel.mean(), pixel.standard_error());
                for channel in 0..3 {
                    combined.mean[channel] += weight * mean[channel];
                    combined.variance[channel] += (weight * error[channel]).powi(2);
                }
                combined.weight += weight;
            },
        );
    }

    /// Mean radiance per pixel, 0 where there is none.
    pub fn mean(&self) -> Vec<[f32; 3]> {
        self.map(|pixel| pixel.mean.map(|v| (v / pixel.weight) as f32))
    }

    /// Standard error of the mean per pixel.
    pub fn standard_error(&self) -> Vec<[f32; 3]> {
        self.map(|pixel| pixel.variance.map(|v| (v.sqrt() / pixel.weight) as f32))
    }

    fn map(&self, value: impl Fn(&CombinedPixel) -> [f32; 3] + Sync) -> Vec<[f32; 3]> {
        let value = |pixel: &CombinedPixel| if pixel.weight > 0.0 { value(pixel) } else { [0.0; 3] };
        self.pixels.par_iter().with_min_len(1 << 12).map(value).collect()
    }

    /// `image` with the combined mean and its standard error.
    pub fn put_into(&self, image: Image) -> Image {
        Image { rgb: self.mean(), standard_error: Some(self.standard_error()), ..image }
    }
}

/// Weight of a sample where nothing is known.
const LEAST_WEIGHT: f64 = 1e-12;

/// Mean over the pixels of one colour of a checkerboard: variance of a sample / estimated luminance². None where no pixel
/// has two samples and an estimate.
pub fn relative_variance(pass: &Film, estimates: &[f32], colour: usize) -> Option<f64> {
    let width = pass.width() as usize;
    let (mut sum, mut count) = (0.0, 0u64);
    for (i, (pixel, &estimate)) in pass.pixels().iter().zip(estimates).enumerate() {
        if (i % width + i / width) % 2 != colour || pixel.count < 2 || estimate <= 0.0 {
            continue;
        }
        let variance: f64 = pixel.standard_error().iter().map(|e| e * e).sum();
        sum += variance * pixel.count as f64 / (3.0 * f64::from(estimate).powi(2));
        count += 1;
    }
    (count > 0).then(|| sum / count as f64)
}

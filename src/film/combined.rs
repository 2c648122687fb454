//! Passes of different noise put together: each is unbiased, so any weights that do not depend on its own noise keep the
//! mean right, and the inverse of its variance makes the sum least noisy.

use super::{Film, Image, PixelSum, luminance};
use rayon::prelude::*;

/// Samples of each pixel that a pass needs for its noise to be judged by.
const JUDGED_SAMPLES: u64 = 2;

/// Relative variance of a sample below which passes are alike.
const LEAST_VARIANCE: f64 = 1e-9;
/// A relative variance that any real one is below.
const UNKNOWN: f64 = 1e12;
/// Luminance, relative to the image's mean, below which errors of pixels are seen as they are instead of relative to the pixel: else
/// a few pixels that are nearly black would tell how noisy passes are. With its square as ε this is relMSE.
const DARK: f64 = 0.2;

/// Per pixel: weighted means of passes, cut from a film that only grows.
#[derive(Clone, Debug, Default)]
pub struct CombinedFilm {
    pixels: Vec<CombinedPixel>,
    /// The film as it was when the last pass ended.
    before: Vec<PixelSum>,
    /// Variance of a single sample in the last pass, for each colour of the checkerboard.
    variance: [f64; 2],
    /// The least of those before it: what a sample at least counts by.
    least: [f64; 2],
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
    pub fn new(film: &Film) -> CombinedFilm {
        CombinedFilm {
            pixels: vec![CombinedPixel::default(); film.pixels().len()],
            before: film.pixels().to_vec(),
            variance: [UNKNOWN; 2],
            least: [UNKNOWN; 2],
        }
    }

    /// Ends a pass: what `film` got since the last one. `estimates` are rough luminances of the pixels, to judge errors by.
    ///
    /// A pixel's weight is the inverse of the pass's mean relative variance, estimated from the pixels of the other colour
    /// of a checkerboard: those are independent of the pixel's own noise, but for the estimates, whose windows overlap (a bias of
    /// some per cent in images of 8×6 pixels, of a thousandth in 32×24). A sample counts at least as much as one of any earlier
    /// pass, since learning makes passes better, and a short pass that missed what is rare only seems less noisy.
    pub fn end_pass(&mut self, film: &Film, estimates: &[f32]) {
        self.judge(film, estimates);
        self.add_pass(film);
    }

    /// Adds what `film` got since the last pass ended, by the noise that it was judged to have.
    pub fn add_pass(&mut self, film: &Film) {
        let width = film.width() as usize;
        let variance = [0, 1].map(|c| self.variance[c].min(self.least[c]));
        self.least = variance;
        let rows = self.pixels.par_chunks_mut(width).zip(self.before.par_chunks_mut(width));
        rows.zip(film.pixels().par_chunks(width)).enumerate().for_each(|(y, ((pixels, before), now))| {
            for (x, ((pixel, before), now)) in pixels.iter_mut().zip(before).zip(now).enumerate() {
                pixel.add(&now.since(before), variance[1 - colour(x, y)]);
                *before = *now;
            }
        });
    }

    /// Has all passes so far count `share` of what they counted.
    pub fn fade(&mut self, share: f64) {
        for pixel in &mut self.pixels {
            pixel.mean = pixel.mean.map(|mean| share * mean);
            pixel.variance = pixel.variance.map(|variance| share * share * variance);
            pixel.weight *= share;
        }
    }

    /// Finds the variance of the pass on its way; that of the last pass stands in while there are too few samples to tell.
    pub fn judge(&mut self, film: &Film, estimates: &[f32]) {
        let passed = |(now, before): (&PixelSum, &PixelSum)| now.count - before.count;
        if film.pixels().iter().zip(&self.before).next().map_or(0, passed) >= JUDGED_SAMPLES {
            let variance = relative_variance(film.pixels(), &self.before, estimates, film.width() as usize);
            // An image of one pixel has one colour only.
            let found = [0, 1].map(|c| variance[c].or(variance[1 - c]));
            self.variance = [0, 1].map(|c| found[c].map_or(self.variance[c], |v| v.max(LEAST_VARIANCE)));
        }
    }

    /// Relative variance of a single sample in the last pass.
    pub fn variance(&self) -> f64 {
        0.5 * (self.variance[0] + self.variance[1])
    }

    /// Whether any pixel got samples since the last pass ended.
    fn has_news(&self, film: &Film) -> bool {
        film.pixels().iter().zip(&self.before).any(|(now, before)| now.count > before.count)
    }

    /// `image` with the mean of all passes, the one on its way included, and its standard error.
    pub fn put_into(mut self, image: Image, film: &Film, estimates: &[f32]) -> Image {
        if self.has_news(film) {
            self.end_pass(film, estimates);
        }
        let map = |value: fn(&CombinedPixel) -> [f64; 3]| -> Vec<[f32; 3]> {
            self.pixels.par_iter().with_min_len(1 << 12).map(|p| value(p).map(|v| v as f32)).collect()
        };
        Image {
            rgb: map(CombinedPixel::combined_mean),
            standard_error: Some(map(CombinedPixel::standard_error)),
            ..image
        }
    }
}

impl CombinedPixel {
    /// Adds what a pass found, whose single samples have about that `variance`.
    fn add(&mut self, pass: &PixelSum, variance: f64) {
        // A single sample says nothing of its error: it waits for a second, unless it is all there is.
        if pass.count == 0 || pass.count < JUDGED_SAMPLES && self.weight > 0.0 {
            return;
        }
        let weight = pass.count as f64 / variance;
        let (mean, error) = (pass.mean(), pass.standard_error());
        for channel in 0..3 {
            self.mean[channel] += weight * mean[channel];
            self.variance[channel] += (weight * error[channel]).powi(2);
        }
        self.weight += weight;
    }

    /// 0 where there are no samples.
    fn combined_mean(&self) -> [f64; 3] {
        if self.weight > 0.0 { self.mean.map(|v| v / self.weight) } else { [0.0; 3] }
    }

    /// Infinite (unknown) where there are no samples.
    fn standard_error(&self) -> [f64; 3] {
        if self.weight > 0.0 { self.variance.map(|v| v.sqrt() / self.weight) } else { [f64::INFINITY; 3] }
    }
}

/// Which colour of the checkerboard a pixel has.
fn colour(x: usize, y: usize) -> usize {
    (x + y) % 2
}

/// For each colour of a checkerboard the mean over its pixels of variance of a sample / (estimated luminance² + ε); None where there is
/// no such pixel, or no light was seen.
/// Added up row by row, so that it does not depend on the number of threads.
fn relative_variance(
    now: &[PixelSum],
    before: &[PixelSum],
    estimates: &[f32],
    width: usize,
) -> [Option<f64>; 2] {
    let mean = estimates.iter().map(|&estimate| f64::from(estimate)).sum::<f64>() / estimates.len() as f64;
    let epsilon = (DARK * mean).powi(2);
    let rows = now.par_chunks(width).zip(before.par_chunks(width)).zip(estimates.par_chunks(width));
    let sums: Vec<[[f64; 2]; 2]> = rows
        .enumerate()
        .map(|(y, ((now, before), estimates))| {
            let mut sums = [[0.0; 2]; 2];
            for (x, ((now, before), &estimate)) in now.iter().zip(before).zip(estimates).enumerate() {
                let pass = now.since(before);
                if pass.count >= JUDGED_SAMPLES && estimate > 0.0 {
                    let variance: f64 = pass.standard_error().iter().map(|e| e * e).sum();
                    let [sum, count] = &mut sums[colour(x, y)];
                    *sum += variance * pass.count as f64 / (3.0 * (f64::from(estimate).powi(2) + epsilon));
                    *count += 1.0;
                }
            }
            sums
        })
        .collect();
    [0, 1].map(|c| {
        let sum: f64 = sums.iter().map(|row| row[c][0]).sum();
        let count: f64 = sums.iter().map(|row| row[c][1]).sum();
        (count > 0.0).then(|| sum / count)
    })
}

/// Rough luminances of the pixels: the mean over a square around each, wide enough to hold `samples` samples.
pub fn rough_luminances(film: &Film, samples: f64) -> Vec<f32> {
    /// Least estimate, relative to the image's mean.
    const DARKEST: f64 = 1e-3;
    let (width, height) = (film.width() as usize, film.height() as usize);
    let have = film.pixels().first().map_or(1, |p| p.count.max(1)) as f64;
    let radius = (((samples / have).sqrt() - 1.0) / 2.0).ceil().clamp(0.0, 16.0) as usize;
    // Sums over the window within each row, then over rows.
    let (rows, totals): (Vec<Vec<f64>>, Vec<f64>) =
        film.pixels().par_chunks(width).map(|row| window_sums(row, radius)).unzip();
    let darkest = DARKEST * totals.iter().sum::<f64>() / (width * height) as f64;
    let mut estimates = vec![0.0; width * height];
    estimates.par_chunks_mut(width).enumerate().for_each(|(y, estimates)| {
        let window = &rows[y.saturating_sub(radius)..(y + radius + 1).min(height)];
        let mut sums = vec![0.0; width];
        for row in window {
            sums.iter_mut().zip(row).for_each(|(sum, value)| *sum += value);
        }
        for (x, (estimate, sum)) in estimates.iter_mut().zip(sums).enumerate() {
            let columns = (x + radius + 1).min(width) - x.saturating_sub(radius);
            *estimate = (sum / (columns * window.len()) as f64).max(darkest) as f32;
        }
    });
    estimates
}

/// For each pixel of a row the sum of the luminances of those at most `radius` away, and the sum of all.
fn window_sums(row: &[PixelSum], radius: usize) -> (Vec<f64>, f64) {
    let mut below = Vec::with_capacity(row.len() + 1);
    below.push(0.0);
    for pixel in row {
        below.push(below[below.len() - 1] + luminance(pixel.mean()));
    }
    let within =
        |x: usize, radius: usize| below[(x + radius + 1).min(row.len())] - below[x.saturating_sub(radius)];
    let sums = (0..row.len()).map(|x| within(x, radius)).collect();
    (sums, (0..row.len()).map(|x| within(x, 0)).sum())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A film of two pixels in which pass after pass, as many samples each, brought these values.
    fn combined(passes: &[(u32, f32)], faded_after: Option<usize>) -> (Film, CombinedFilm) {
        let mut film = Film::new(2, 1);
        let mut combined = CombinedFilm::new(&film);
        for (i, &(samples, value)) in passes.iter().enumerate() {
            for pixel in film.pixels_mut() {
                for sample in 0..samples {
                    // Scattered about the value by a tenth of it.
                    let scatter = if sample % 2 == 0 { 1.1 } else { 0.9 };
                    pixel.add([value * scatter; 3].into());
                }
            }
            combined.end_pass(&film, &[1.0; 2]);
            if faded_after == Some(i) {
                combined.fade(0.125);
            }
        }
        (film, combined)
    }

    /// A pixel of a hundredth of the mean, whose noise nobody sees, does not tell how noisy a pass is.
    #[test]
    fn noise_is_judged_by_what_is_seen() {
        let judged = |dark: f32| {
            let mut film = Film::new(4, 1);
            let mut combined = CombinedFilm::new(&film);
            let values = [1.0, dark, 1.0, dark];
            for (pixel, value) in film.pixels_mut().iter_mut().zip(values) {
                for sample in 0..64 {
                    // The bright ones scatter by a tenth, the dark ones by their threefold.
                    let scatter = if value < 1.0 { 3.0 * value } else { 0.1 };
                    pixel.add([value + if sample % 2 == 0 { scatter } else { -scatter }; 3].into());
                }
            }
            combined.judge(&film, &values);
            combined.variance()
        };
        let (dark, dim) = (judged(0.01), judged(0.5));
        // Half of 0.01, more or less, in the one case; half of 9, less by epsilon, in the other.
        assert!(dark < 0.05, "{dark}");
        assert!((3.0..4.6).contains(&dim), "{dim}: what is seen counts");
    }

    /// Of a pass without noise that is known; of one that saw nothing, it is not.
    #[test]
    fn no_noise_is_known_to_be_none() {
        for (width, value, expected) in
            [(2, 1.0, LEAST_VARIANCE), (1, 1.0, LEAST_VARIANCE), (2, 0.0, UNKNOWN)]
        {
            let mut film = Film::new(width, 1);
            let mut combined = CombinedFilm::new(&film);
            film.pixels_mut().iter_mut().for_each(|pixel| (0..16).for_each(|_| pixel.add([value; 3].into())));
            combined.judge(&film, &rough_luminances(&film, 16.0));
            assert_eq!(combined.variance(), expected, "{width} pixels of {value}");
        }
    }

    #[test]
    fn faded_passes_count_that_share_of_what_they_counted() {
        let mean = |faded| combined(&[(64, 1.0), (64, 2.0)], faded).1.pixels[0].combined_mean()[0];
        let whole = mean(None);
        assert!((whole - 1.5).abs() < 0.1, "{whole}");
        let weight = (whole - 1.0) / (2.0 - whole);
        let expected = (1.0 + 2.0 * 8.0 * weight) / (1.0 + 8.0 * weight);
        assert!((mean(Some(0)) - expected).abs() < 1e-6, "{} for {expected}", mean(Some(0)));
        assert!((mean(Some(1)) - whole).abs() < 1e-6, "what fades as a whole stays what it is");
        let error = |faded| combined(&[(64, 1.0), (64, 2.0)], faded).1.pixels[0].standard_error()[0];
        assert!((error(Some(1)) / error(None) - 1.0).abs() < 1e-6);
    }
}

//! Passes of different noise put together: each is unbiased, so any weights that do not depend on its own noise keep the
//! mean right, and the inverse of its variance makes the sum least noisy.

use super::accumulate::relative_error;
use super::{Film, Image, PixelSum, luminance};
use rayon::prelude::*;

/// Samples of each pixel that a pass needs for its noise to be judged by.
const JUDGED_SAMPLES: u64 = 2;

/// Relative variance of a sample below which passes are alike.
const LEAST_VARIANCE: f64 = 1e-9;
/// A relative variance that any real one is below.
const UNKNOWN: f64 = 1e12;
/// Luminance, relative to the mean of the pixels of its colour, below which errors of pixels are seen as they are instead of relative to the pixel: else
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
    /// of a checkerboard: those are independent of the pixel's own noise. A sample counts at least as much as one of any earlier
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

    /// All passes, the one on its way included.
    pub fn with_news(mut self, film: &Film, estimates: &[f32]) -> CombinedFilm {
        if self.has_news(film) {
            self.end_pass(film, estimates);
        }
        self
    }

    /// What [`Film::relative_error`] is of a film.
    pub fn relative_error(&self) -> f64 {
        relative_error(self.pixels.iter().map(|pixel| (pixel.combined_mean(), pixel.standard_error())))
    }

    /// `image` with the mean of all passes and its standard error.
    pub fn put_into(&self, image: Image) -> Image {
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
    let luminances: Vec<Vec<f64>> =
        estimates.par_chunks(width).map(|row| row.iter().map(|&estimate| estimate.into()).collect()).collect();
    let epsilon = colour_means(&luminances).map(|mean| (DARK * mean).powi(2));
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
                    let scale = f64::from(estimate).powi(2) + epsilon[colour(x, y)];
                    *sum += variance * pass.count as f64 / (3.0 * scale);
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

/// Rough luminances of the pixels: the mean over those of its own colour in a square around each, wide enough to hold `samples`
/// samples. Of its own colour, so that what is judged by them of one colour does not depend on the other's noise.
pub fn rough_luminances(film: &Film, samples: f64) -> Vec<f32> {
    /// Least estimate, relative to the mean of the image's pixels of that colour.
    const DARKEST: f64 = 1e-3;
    let (width, height) = (film.width() as usize, film.height() as usize);
    let have = film.pixels().first().map_or(1, |p| p.count.max(1)) as f64;
    // Half of a square's pixels are of one colour.
    let side = if have < samples { (2.0 * samples / have).sqrt() } else { 1.0 };
    let radius = ((side - 1.0) / 2.0).ceil().min(16.0) as usize;
    let columns: Vec<[f64; 2]> = window_sums(&vec![1.0; width], radius);
    // Sums over the window within each row, then over rows.
    let luminances = |row: &[PixelSum]| row.iter().map(|pixel| luminance(pixel.mean())).collect();
    let luminances: Vec<Vec<f64>> = film.pixels().par_chunks(width).map(luminances).collect();
    let rows: Vec<_> = luminances.par_iter().map(|row| window_sums(row, radius)).collect();
    let darkest = colour_means(&luminances).map(|mean| DARKEST * mean);
    let mut estimates = vec![0.0; width * height];
    estimates.par_chunks_mut(width).enumerate().for_each(|(y, estimates)| {
        let mut sums = vec![[0.0; 2]; width];
        for row in y.saturating_sub(radius)..(y + radius + 1).min(height) {
            for (x, [sum, count]) in sums.iter_mut().enumerate() {
                // Whether the row's pixels of this one's colour are in odd columns.
                let odd = colour(x, y + row);
                *sum += rows[row][x][odd];
                *count += columns[x][odd];
            }
        }
        for (x, (estimate, [sum, count])) in estimates.iter_mut().zip(sums).enumerate() {
            *estimate = (sum / count).max(darkest[colour(x, y)]) as f32;
        }
    });
    estimates
}

/// For each place in a row the sums of the values at even and at odd places that are at most `radius` away.
fn window_sums(row: &[f64], radius: usize) -> Vec<[f64; 2]> {
    let mut below = vec![[0.0; 2]];
    for (x, value) in row.iter().enumerate() {
        let mut sums = below[x];
        sums[x % 2] += value;
        below.push(sums);
    }
    let within = |x: usize| {
        let (from, to) = (below[x.saturating_sub(radius)], below[(x + radius + 1).min(row.len())]);
        [to[0] - from[0], to[1] - from[1]]
    };
    (0..row.len()).map(within).collect()
}

/// For each colour of the checkerboard the mean of its pixels; 0 where it has none.
fn colour_means(rows: &[Vec<f64>]) -> [f64; 2] {
    let mut sums = [[0.0; 2]; 2];
    for (y, row) in rows.iter().enumerate() {
        for (x, value) in row.iter().enumerate() {
            let [sum, count] = &mut sums[colour(x, y)];
            *sum += value;
            *count += 1.0;
        }
    }
    sums.map(|[sum, count]| if count > 0.0 { sum / count } else { 0.0 })
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
            let values = [1.0, 1.0, dark, dark];
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

    /// Whatever pixels of one colour of the checkerboard saw, those of the other weigh their passes alike.
    #[test]
    fn weights_do_not_depend_on_a_pixels_own_noise() {
        let weights = |own: f32, others: f32| {
            let mut film = Film::new(8, 6);
            let mut combined = CombinedFilm::new(&film);
            for pass in 1..3u32 {
                for (i, pixel) in film.pixels_mut().iter_mut().enumerate() {
                    let scale = if colour(i % 8, i / 8) == 0 { own } else { others };
                    (0..16 * pass).for_each(|sample| pixel.add([scale * (sample * (i as u32 + 3) % 7) as f32; 3].into()));
                }
                combined.end_pass(&film, &rough_luminances(&film, 64.0));
            }
            combined.pixels[0].weight
        };
        assert_eq!(weights(1.0, 1.0), weights(100.0, 1.0));
        // Negative control: they do depend on the others'. Scaled as a whole these would be as noisy as before.
        let askew = |i: u32| weights(1.0, if i == 0 { 1.0 } else { 0.0 });
        assert_ne!(askew(0), askew(1));
    }

    /// Small images of three passes, most of whose light is rare, have the right mean; weighed by their pixels' own noise they are
    /// darker. α = 1e-4.
    #[test]
    fn small_images_of_several_passes_have_the_right_mean() {
        const IMAGES: u32 = 2000;
        let mut state = 1u64;
        let mut chance = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 40) as f32 / (1 << 24) as f32
        };
        let mut mean_of_means = |by_own_noise: bool| -> (f64, f64) {
            let found: Vec<f64> = (0..IMAGES)
                .map(|_| {
                    let mut film = Film::new(8, 6);
                    let mut combined = CombinedFilm::new(&film);
                    for samples in [16, 32, 64] {
                        for pixel in film.pixels_mut() {
                            // Mean 1: a ninth part is seen by every sample, the rest by one in 512.
                            let value = |rare: bool| 1.0 / 9.0 + if rare { 512.0 * 8.0 / 9.0 } else { 0.0 };
                            (0..samples).for_each(|_| pixel.add([value(chance() < 1.0 / 512.0); 3].into()));
                        }
                        combined.judge(&film, &rough_luminances(&film, 512.0));
                        if by_own_noise {
                            combined.variance.reverse();
                        }
                        combined.add_pass(&film);
                    }
                    let mean = |pixel: &CombinedPixel| pixel.combined_mean()[0];
                    combined.pixels.iter().map(mean).sum::<f64>() / 48.0
                })
                .collect();
            let mean = found.iter().sum::<f64>() / f64::from(IMAGES);
            let variance = found.iter().map(|m| (m - mean).powi(2)).sum::<f64>() / f64::from(IMAGES - 1);
            (mean, (variance / f64::from(IMAGES)).sqrt())
        };
        let (mean, error) = mean_of_means(false);
        assert!((mean - 1.0).abs() < 3.9 * error, "{mean} ± {error}");
        let (mean, error) = mean_of_means(true);
        assert!(1.0 - mean > 5.0 * error, "{mean} ± {error}, weighed by its own noise");
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

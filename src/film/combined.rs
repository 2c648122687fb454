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
/// Luminance, relative to the mean of the pixels of its colour, below which errors of pixels are seen as they are instead of relative
/// to the pixel: else a few pixels that are nearly black would tell how noisy passes are. With its square as ε this is relMSE.
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
    /// of a checkerboard: those are independent of the pixel's own noise. (An image of one pixel has no other: there, passes weigh
    /// by their samples.) A sample counts at least as much as one of any earlier pass, since learning makes passes better, and a short
    /// pass that missed what is rare only seems less noisy.
    pub fn end_pass(&mut self, film: &Film, estimates: &[f32]) {
        self.judge(film, estimates);
        self.add_pass(film);
    }

    /// Adds what `film` got since the last pass ended, by the noise that it was judged to have.
    pub fn add_pass(&mut self, film: &Film) {
        self.least = self.weighing(self.variance);
        let (width, variance) = (film.width() as usize, self.least);
        let rows = self.pixels.par_chunks_mut(width).zip(self.before.par_chunks_mut(width));
        rows.zip(film.pixels().par_chunks(width)).enumerate().for_each(|(y, ((pixels, before), now))| {
            for (x, ((pixel, before), now)) in pixels.iter_mut().zip(before).zip(now).enumerate() {
                pixel.add(&now.since(before), variance[1 - colour(x, y)]);
                *before = *now;
            }
        });
    }

    /// What a pass of that variance is weighed by.
    fn weighing(&self, variance: [f64; 2]) -> [f64; 2] {
        match self.pixels.len() {
            1 => [1.0; 2],
            _ => [0, 1].map(|c| variance[c].min(self.least[c])),
        }
    }

    /// Finds the variance of the pass on its way; that of the last pass stands in while there are too few samples to tell.
    pub fn judge(&mut self, film: &Film, estimates: &[f32]) {
        self.variance = self.judged(film, estimates);
    }

    /// What [`CombinedFilm::judge`] finds.
    fn judged(&self, film: &Film, estimates: &[f32]) -> [f64; 2] {
        let passed = |(now, before): (&PixelSum, &PixelSum)| now.count - before.count;
        if film.pixels().iter().zip(&self.before).next().map_or(0, passed) < JUDGED_SAMPLES {
            return self.variance;
        }
        let found = relative_variance(film.pixels(), &self.before, estimates, film.width() as usize);
        [0, 1].map(|c| found[c].map_or(self.variance[c], |v| v.max(LEAST_VARIANCE)))
    }

    /// Relative variance of a single sample in the last pass, by what is known of it.
    pub fn variance(&self) -> f64 {
        match self.variance.map(|variance| variance < UNKNOWN) {
            [true, false] => self.variance[0],
            [false, true] => self.variance[1],
            _ => 0.5 * (self.variance[0] + self.variance[1]),
        }
    }

    /// `image` with the mean of all passes, the one on its way included, and its standard error. Those that have ended count `share`
    /// of what they counted.
    pub fn put_into(&self, image: Image, film: &Film, estimates: &[f32], share: f64) -> Image {
        let pixel = self.pixels_with(film, estimates, share);
        let map = |value: fn(&CombinedPixel) -> [f64; 3]| -> Vec<[f32; 3]> {
            let pixels = (0..self.pixels.len()).into_par_iter().with_min_len(1 << 12);
            pixels.map(|i| value(&pixel(i)).map(|v| v as f32)).collect()
        };
        Image {
            rgb: map(CombinedPixel::combined_mean),
            standard_error: Some(map(CombinedPixel::standard_error)),
            ..image
        }
    }

    /// What [`Film::relative_error`] is of a film, of that image.
    pub fn relative_error(&self, film: &Film, estimates: &[f32], share: f64) -> f64 {
        let pixel = self.pixels_with(film, estimates, share);
        relative_error(film.width(), film.height(), |i| {
            let pixel = pixel(i);
            (pixel.combined_mean(), pixel.standard_error())
        })
    }

    /// Pixels by number, with what `film` got since the last pass ended.
    fn pixels_with(&self, film: &Film, estimates: &[f32], share: f64) -> impl Fn(usize) -> CombinedPixel {
        let variance = self.weighing(self.judged(film, estimates));
        let width = film.width() as usize;
        move |i| {
            let mut pixel = self.pixels[i].faded(share);
            pixel.add(&film.pixels()[i].since(&self.before[i]), variance[1 - colour(i % width, i / width)]);
            pixel
        }
    }
}

impl CombinedPixel {
    /// Of which all counts `share` of what it counted.
    fn faded(&self, share: f64) -> CombinedPixel {
        CombinedPixel {
            mean: self.mean.map(|mean| share * mean),
            variance: self.variance.map(|variance| share * share * variance),
            weight: share * self.weight,
        }
    }

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
    let means = colour_means(estimates.iter().map(|&estimate| f64::from(estimate)), width);
    let epsilon = means.map(|mean| (DARK * mean).powi(2));
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
    let columns = window_sums(&vec![1.0; width], radius);
    // Sums over the window within each row, then over rows.
    let luminances = |row: &[PixelSum]| row.iter().map(|pixel| luminance(pixel.mean())).collect();
    let luminances: Vec<Vec<f64>> = film.pixels().par_chunks(width).map(luminances).collect();
    let rows: Vec<_> = luminances.par_iter().map(|row| window_sums(row, radius)).collect();
    let darkest = colour_means(luminances.iter().flatten().copied(), width).map(|mean| DARKEST * mean);
    let mut estimates = vec![0.0; width * height];
    estimates.par_chunks_mut(width).enumerate().for_each(|(y, estimates)| {
        let (mut sums, mut counts) = (vec![0.0; width], vec![0.0; width]);
        let from = y.saturating_sub(radius);
        for (row, values) in (from..).zip(&rows[from..(y + radius + 1).min(height)]) {
            // In every other row, pixels of the same colour are an odd number of columns away.
            let odd = (y + row) % 2;
            sums.iter_mut().zip(&values[odd]).for_each(|(sum, value)| *sum += value);
            counts.iter_mut().zip(&columns[odd]).for_each(|(count, columns)| *count += columns);
        }
        for (x, (estimate, (sum, count))) in estimates.iter_mut().zip(sums.iter().zip(counts)).enumerate() {
            *estimate = (sum / count).max(darkest[colour(x, y)]) as f32;
        }
    });
    estimates
}

/// For each place in a row the sums of the values that are at most `radius` away from it: by an even number of places, by an odd one.
fn window_sums(row: &[f64], radius: usize) -> [Vec<f64>; 2] {
    // Before each place, of even and of odd places.
    let mut below = vec![[0.0; 2]];
    for (x, value) in row.iter().enumerate() {
        let mut sums = below[x];
        sums[x % 2] += value;
        below.push(sums);
    }
    [0, 1].map(|odd| {
        let within = |x: usize| {
            let parity = (x + odd) % 2;
            below[(x + radius + 1).min(row.len())][parity] - below[x.saturating_sub(radius)][parity]
        };
        (0..row.len()).map(within).collect()
    })
}

/// For each colour of the checkerboard the mean of its pixels' values, row by row; 0 where it has none.
fn colour_means(values: impl Iterator<Item = f64>, width: usize) -> [f64; 2] {
    let mut sums = [[0.0; 2]; 2];
    for (i, value) in values.enumerate() {
        let [sum, count] = &mut sums[colour(i % width, i / width)];
        *sum += value;
        *count += 1.0;
    }
    sums.map(|[sum, count]| if count > 0.0 { sum / count } else { 0.0 })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A film of two pixels in which pass after pass, as many samples each, brought these values, and the combination of those of them
    /// that have ended.
    fn combined(passes: &[(u32, f32)], ended: usize) -> (Film, CombinedFilm) {
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
            if i < ended {
                combined.end_pass(&film, &[1.0; 2]);
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

    /// Estimates are means over the pixels of the same colour in a square, cut off at the borders.
    #[test]
    fn rough_luminances_are_means_over_pixels_of_one_colour() {
        for (width, height) in [(9, 7), (1, 5), (40, 1), (1, 1), (12, 37)] {
            let mut film = Film::new(width, height);
            for (i, pixel) in film.pixels_mut().iter_mut().enumerate() {
                (0..8).for_each(|_| pixel.add([(i * i % 23) as f32 + 1.0; 3].into()));
            }
            let (width, height) = (width as usize, height as usize);
            // Eight samples a pixel, half of the pixels: squares 1, 2, 4 and 6.3 pixels wide.
            for (samples, radius) in [(8.0, 0), (16.0, 1), (64.0, 2), (160.0, 3)] {
                let found = rough_luminances(&film, samples);
                for (x, y) in (0..height).flat_map(|y| (0..width).map(move |x| (x, y))) {
                    let near = |a: usize, b: usize| a.abs_diff(b) <= radius;
                    let of_window = |i: &usize| {
                        let at = (i % width, i / width);
                        near(at.0, x) && near(at.1, y) && colour(at.0, at.1) == colour(x, y)
                    };
                    let window: Vec<f64> = (0..width * height)
                        .filter(of_window)
                        .map(|i| luminance(film.pixels()[i].mean()))
                        .collect();
                    let expected = window.iter().sum::<f64>() / window.len() as f64;
                    let error = (f64::from(found[y * width + x]) / expected - 1.0).abs();
                    assert!(error < 1e-6, "{width}x{height}, {samples} samples, ({x}, {y})");
                }
            }
        }
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
                    (0..16 * pass).for_each(|sample| {
                        pixel.add([scale * (sample * (i as u32 + 3) % 7) as f32; 3].into())
                    });
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

    /// Small images of three passes, whose light is mostly or all rare, have the right mean; weighed by their pixels' own noise they
    /// have not. α = 1e-4 each.
    #[test]
    fn small_images_of_several_passes_have_the_right_mean() {
        let mut state = 1u64;
        let mut chance = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 40) as f32 / (1 << 24) as f32
        };
        // The mean over images, whose light is 1, and its standard error. `always` of it is seen by every sample, the rest by few.
        let mut mean_of_means = |width: u32, height: u32, always: f32, by_own_noise: bool| {
            let (rarity, images) = (if always > 0.0 { 512.0 } else { 256.0 }, 48_000 / (width * height));
            let found: Vec<f64> = (0..images)
                .map(|_| {
                    let mut film = Film::new(width, height);
                    let mut combined = CombinedFilm::new(&film);
                    for samples in [16, 32, 64] {
                        for pixel in film.pixels_mut() {
                            let value =
                                |rare: bool| always + if rare { rarity * (1.0 - always) } else { 0.0 };
                            (0..samples).for_each(|_| pixel.add([value(chance() < 1.0 / rarity); 3].into()));
                        }
                        combined.judge(&film, &rough_luminances(&film, 512.0));
                        if by_own_noise {
                            combined.variance.reverse();
                        }
                        combined.add_pass(&film);
                    }
                    let mean = |pixel: &CombinedPixel| pixel.combined_mean()[0];
                    combined.pixels.iter().map(mean).sum::<f64>() / f64::from(width * height)
                })
                .collect();
            let mean = found.iter().sum::<f64>() / f64::from(images);
            let variance = found.iter().map(|m| (m - mean).powi(2)).sum::<f64>() / f64::from(images - 1);
            (mean, (variance / f64::from(images)).sqrt())
        };
        for (width, height) in [(8, 6), (4, 3), (3, 1), (2, 1), (1, 1)] {
            for always in [1.0 / 9.0, 0.0] {
                let (mean, error) = mean_of_means(width, height, always, false);
                assert!((mean - 1.0).abs() < 3.9 * error, "{width}x{height}, {always}: {mean} ± {error}");
            }
        }
        // Negative control. (Of light that is all rare it would not tell: without any, no variance is known.)
        let (mean, error) = mean_of_means(8, 6, 1.0 / 9.0, true);
        assert!(1.0 - mean > 4.5 * error, "{mean} ± {error} by own noise");
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
        let image = |ended, share| {
            let (film, combined) = combined(&[(64, 1.0), (64, 2.0)], ended);
            let image = combined.put_into(film.image(), &film, &[1.0; 2], share);
            let error = image.standard_error.expect("it has errors")[0][0];
            (f64::from(image.rgb[0][0]), f64::from(error), combined.relative_error(&film, &[1.0; 2], share))
        };
        let mean = |ended, share| image(ended, share).0;
        let whole = mean(1, 1.0);
        assert!((whole - 1.5).abs() < 0.1, "{whole}");
        let weight = (whole - 1.0) / (2.0 - whole);
        let expected = (1.0 + 2.0 * 8.0 * weight) / (1.0 + 8.0 * weight);
        assert!((mean(1, 0.125) - expected).abs() < 1e-6, "{} for {expected}", mean(1, 0.125));
        assert_eq!(mean(2, 1.0), whole, "whether the last pass has ended changes nothing");
        assert!((mean(2, 0.125) - whole).abs() < 1e-6, "what fades as a whole stays what it is");
        assert!((image(2, 0.125).1 / image(2, 1.0).1 - 1.0).abs() < 1e-6);
        for (value, error, relative) in [image(1, 1.0), image(1, 0.125), image(2, 1.0)] {
            let expected = error / (value * value + 0.01).sqrt();
            assert!((relative / expected - 1.0).abs() < 1e-6, "{relative} for {expected}");
        }
    }
}

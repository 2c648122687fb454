//! Sums of samples. Adding and merging only add, so a render cut into shards is put together by adding them.

use crate::gpu_struct;
use glam::Vec3;
use rayon::prelude::*;

use super::{Image, is_countable};

/// Sums of one pixel's samples, in f64: 1e9 samples leave seven digits.
#[derive(Debug, Clone, Copy, Default, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
pub struct PixelSum {
    pub sum: [f64; 3],
    pub sum_sq: [f64; 3],
    pub count: u64,
}

impl PixelSum {
    /// Adds one sample.
    pub fn add(&mut self, rgb: Vec3) {
        for (channel, value) in rgb.to_array().into_iter().enumerate() {
            let value = f64::from(value);
            self.sum[channel] += value;
            self.sum_sq[channel] += value * value;
        }
        self.count += 1;
    }

    /// Adds a sample as it was traced, or black if it is not countable; whether it was.
    pub fn add_traced(&mut self, rgb: Vec3) -> bool {
        let countable = is_countable(rgb);
        self.add(if countable { rgb } else { Vec3::ZERO });
        countable
    }

    /// Adds the sums of `samples` samples.
    pub fn add_block(&mut self, block: &BlockSum, samples: u32) {
        for channel in 0..3 {
            self.sum[channel] += f64::from(block.sum[channel]);
            self.sum_sq[channel] += f64::from(block.sum_sq[channel]);
        }
        self.count += u64::from(samples);
    }

    /// Adds another shard's sums.
    pub fn merge(&mut self, other: &PixelSum) {
        for channel in 0..3 {
            self.sum[channel] += other.sum[channel];
            self.sum_sq[channel] += other.sum_sq[channel];
        }
        self.count += other.count;
    }

    /// What was added since `earlier`, a copy of this pixel.
    pub fn since(&self, earlier: &PixelSum) -> PixelSum {
        let less = |a: [f64; 3], b: [f64; 3]| [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
        PixelSum {
            sum: less(self.sum, earlier.sum),
            sum_sq: less(self.sum_sq, earlier.sum_sq),
            count: self.count - earlier.count,
        }
    }

    /// Mean of the samples; 0 without any.
    pub fn mean(&self) -> [f64; 3] {
        let count = self.count.max(1) as f64;
        self.sum.map(|sum| sum / count)
    }

    /// Standard error of the mean, never NaN: infinite (unknown) below 2 samples and where sums are not finite,
    /// 0 where all samples were equal.
    pub fn standard_error(&self) -> [f64; 3] {
        let n = self.count as f64;
        [0, 1, 2].map(|channel| {
            let scatter = self.sum_sq[channel] - self.sum[channel] * self.sum[channel] / n;
            if self.count < 2 || !scatter.is_finite() {
                return f64::INFINITY;
            }
            (scatter.max(0.0) / (n * (n - 1.0))).sqrt()
        })
    }
}

gpu_struct! {
    /// What a GPU returns for one pixel: f32 sums over a block of samples small enough for f32.
    pub struct BlockSum {
        sum: [f32; 3],
        sum_sq: [f32; 3],
    }
}

/// Luminance of linear sRGB (Rec. 709 primaries).
pub fn luminance([r, g, b]: [f64; 3]) -> f64 {
    0.2126 * r + 0.7152 * g + 0.0722 * b
}

/// Why two films don't merge.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum FilmError {
    #[error("cannot merge a film of {0}x{1} pixels with one of {2}x{3}; render all shards at one size")]
    SizeMismatch(u32, u32, u32, u32),
}

/// Per pixel: sum, sum of squares (f64, per channel) and sample count. Row 0 at the top.
///
/// Merging equals rendering in one go but for the rounding of f64 additions in another order (about 1e-16 each).
#[derive(Debug, Clone, PartialEq)]
pub struct Film {
    width: u32,
    height: u32,
    pixels: Vec<PixelSum>,
}

/// Below this many pixels, threads cost more than they gain.
const PARALLEL_PIXELS: usize = 1 << 14;

impl Film {
    /// An empty film. The size was validated with the scene.
    pub fn new(width: u32, height: u32) -> Film {
        Film { width, height, pixels: vec![PixelSum::default(); width as usize * height as usize] }
    }

    pub fn width(&self) -> u32 {
        self.width
    }

    pub fn height(&self) -> u32 {
        self.height
    }

    pub fn pixels(&self) -> &[PixelSum] {
        &self.pixels
    }

    /// All pixels, row by row: `film.pixels_mut().par_chunks_mut(width)` fills rows in parallel.
    pub fn pixels_mut(&mut self) -> &mut [PixelSum] {
        &mut self.pixels
    }

    /// Adds one sample. `pixel` is below width × height, as for a slice.
    pub fn add_sample(&mut self, pixel: usize, rgb: Vec3) {
        self.pixels[pixel].add(rgb);
    }

    /// Adds sums over `samples` samples each for the pixels from `first_pixel` on. They lie within the film, as for a slice.
    pub fn add_block(&mut self, first_pixel: usize, samples: u32, sums: &[BlockSum]) {
        let pixels = &mut self.pixels[first_pixel..first_pixel + sums.len()];
        if sums.len() < PARALLEL_PIXELS {
            pixels.iter_mut().zip(sums).for_each(|(pixel, sum)| pixel.add_block(sum, samples));
        } else {
            pixels
                .par_iter_mut()
                .with_min_len(PARALLEL_PIXELS / 4)
                .zip(sums)
                .for_each(|(pixel, sum)| pixel.add_block(sum, samples));
        }
    }

    /// Adds another film of the same size.
    pub fn merge(&mut self, other: &Film) -> Result<(), FilmError> {
        if (self.width, self.height) != (other.width, other.height) {
            return Err(FilmError::SizeMismatch(self.width, self.height, other.width, other.height));
        }
        self.pixels
            .par_iter_mut()
            .with_min_len(PARALLEL_PIXELS)
            .zip(&other.pixels)
            .for_each(|(a, b)| a.merge(b));
        Ok(())
    }

    /// Mean radiance per pixel; 0 where there are no samples.
    pub fn mean(&self) -> Vec<[f32; 3]> {
        self.map(|pixel| pixel.mean().map(|v| v as f32))
    }

    /// Standard error of [`mean`](Film::mean) per pixel and channel; see [`PixelSum::standard_error`].
    pub fn standard_error(&self) -> Vec<[f32; 3]> {
        self.map(|pixel| pixel.standard_error().map(|v| v as f32))
    }

    /// Fewest and most samples of a pixel; (0, 0) without pixels.
    pub fn samples(&self) -> (u64, u64) {
        let counts = self.pixels.iter().map(|pixel| pixel.count);
        (counts.clone().min().unwrap_or(0), counts.max().unwrap_or(0))
    }

    /// Relative standard error of the image: √ mean over pixels and channels of se² / (mean² + ε), ε = 0.01, the
    /// expectation of √relMSE as `compare` takes it. Infinite below 2 samples a pixel and for an image that is black.
    pub fn relative_error(&self) -> f64 {
        relative_error(self.width, self.height, |i| (self.pixels[i].mean(), self.pixels[i].standard_error()))
    }

    /// The finished image, with errors and sample counts; features and metadata are the caller's to add.
    pub fn image(&self) -> Image {
        let mut image = Image::new(self.width, self.height, self.mean());
        image.standard_error = Some(self.standard_error());
        image.samples = Some(self.map(|pixel| pixel.count as f32));
        image
    }

    fn map<T: Send>(&self, f: impl Fn(&PixelSum) -> T + Sync + Send) -> Vec<T> {
        self.pixels.par_iter().with_min_len(PARALLEL_PIXELS).map(f).collect()
    }
}

/// √ mean over pixels and channels of se² / (mean² + ε) of the pixels' means and standard errors; infinite where one is unknown, and
/// for an image that is black. Added up row by row, so that it does not depend on the number of threads.
pub(super) fn relative_error(
    width: u32,
    height: u32,
    pixel: impl Fn(usize) -> ([f64; 3], [f64; 3]) + Sync,
) -> f64 {
    const EPSILON: f64 = 0.01;
    let (width, height) = (width as usize, height as usize);
    let row = |y: usize| {
        (y * width..(y + 1) * width).fold((0.0, false), |(sum, lit), i| {
            let (mean, error) = pixel(i);
            let squares = (0..3).map(|c| error[c] * error[c] / (mean[c] * mean[c] + EPSILON));
            (sum + squares.sum::<f64>() / 3.0, lit || mean != [0.0; 3])
        })
    };
    let rows: Vec<(f64, bool)> = (0..height).into_par_iter().map(row).collect();
    let sum: f64 = rows.iter().map(|row| row.0).sum();
    let lit = rows.iter().any(|row| row.1);
    if lit && sum.is_finite() { (sum / (width * height) as f64).sqrt() } else { f64::INFINITY }
}

#[cfg(test)]
mod tests {
    use super::super::test_files::Rng;
    use super::*;

    fn samples(seed: u64, count: usize) -> Vec<(usize, Vec3)> {
        let mut rng = Rng::new(seed);
        (0..count)
            .map(|_| {
                (
                    rng.below(12) as usize,
                    Vec3::new(rng.uniform_f32(), 4.0 * rng.uniform_f32(), rng.uniform_f32() - 0.2),
                )
            })
            .collect()
    }

    fn render(samples: &[(usize, Vec3)]) -> Film {
        let mut film = Film::new(4, 3);
        samples.iter().for_each(|&(pixel, rgb)| film.add_sample(pixel, rgb));
        film
    }

    fn close(a: f64, b: f64) -> bool {
        (a - b).abs() <= 1e-12 * a.abs().max(b.abs())
    }

    #[test]
    fn merging_shards_equals_one_render() {
        let all = samples(1, 5000);
        let whole = render(&all);
        let mut merged = render(&all[..1234]);
        merged.merge(&render(&all[1234..4000])).unwrap();
        merged.merge(&render(&all[4000..])).unwrap();
        for (a, b) in merged.pixels().iter().zip(whole.pixels()) {
            assert_eq!(a.count, b.count);
            assert!((0..3).all(|c| close(a.sum[c], b.sum[c]) && close(a.sum_sq[c], b.sum_sq[c])));
        }
    }

    /// Multiples of 1/256 have exact sums, so order can't matter at all.
    #[test]
    fn merging_exact_sums_is_exact_in_any_order() {
        let all: Vec<_> = samples(2, 3000).iter().map(|(p, v)| (*p, (*v * 256.0).round() / 256.0)).collect();
        let (mut ab, a, b) = (render(&all[..999]), render(&all[..999]), render(&all[999..]));
        ab.merge(&b).unwrap();
        let mut ba = b.clone();
        ba.merge(&a).unwrap();
        assert_eq!(ab, render(&all));
        assert_eq!(ba, ab);
    }

    #[test]
    fn films_of_different_sizes_do_not_merge() {
        let error = Film::new(4, 3).merge(&Film::new(3, 4)).unwrap_err();
        assert_eq!(error, FilmError::SizeMismatch(4, 3, 3, 4));
    }

    #[test]
    fn blocks_of_sums_equal_single_samples() {
        let mut single = Film::new(200, 100);
        let mut block = Film::new(200, 100);
        let mut rng = Rng::new(3);
        let mut sums = vec![BlockSum::default(); 19_000];
        for (pixel, sum) in sums.iter_mut().enumerate() {
            for _ in 0..4 {
                let value = Vec3::splat(rng.below(64) as f32 / 16.0);
                single.add_sample(pixel + 500, value);
                *sum = BlockSum {
                    sum: (Vec3::from(sum.sum) + value).to_array(),
                    sum_sq: (Vec3::from(sum.sum_sq) + value * value).to_array(),
                };
            }
        }
        block.add_block(500, 4, &sums);
        assert_eq!(block, single);
        assert_eq!(block.samples(), (0, 4));
    }

    #[test]
    fn mean_and_standard_error_are_the_textbook_ones() {
        let mut film = Film::new(1, 1);
        [1.0, 2.0, 3.0, 6.0].iter().for_each(|&v| film.add_sample(0, Vec3::new(v, 5.0, 0.0)));
        assert_eq!(film.mean(), [[3.0, 5.0, 0.0]]);
        let want = (14.0f32 / 3.0 / 4.0).sqrt();
        assert_eq!(film.standard_error(), [[want, 0.0, 0.0]]);
    }

    #[test]
    fn an_unknown_error_is_infinite_and_never_nan() {
        let mut film = Film::new(1, 1);
        assert_eq!((film.mean()[0], film.standard_error()[0]), ([0.0; 3], [f32::INFINITY; 3]));
        film.add_sample(0, Vec3::ONE);
        assert_eq!(film.standard_error(), [[f32::INFINITY; 3]]);
        assert_eq!(film.relative_error(), f64::INFINITY);
        film.add_sample(0, Vec3::new(1.0, f32::INFINITY, f32::NAN));
        assert_eq!(film.standard_error(), [[0.0, f32::INFINITY, f32::INFINITY]]);
        assert_eq!(film.relative_error(), f64::INFINITY);
    }

    #[test]
    fn relative_error_is_the_root_of_the_expected_relative_mse_and_falls_with_samples() {
        let mut film = Film::new(1, 2);
        for value in [1.0, 3.0] {
            film.add_sample(0, Vec3::splat(value));
            film.add_sample(1, Vec3::splat(2.0));
        }
        assert!((film.relative_error() - (1.0 / 4.01f64 / 2.0).sqrt()).abs() < 1e-12);
        let (few, many) =
            (render(&samples(4, 1000)).relative_error(), render(&samples(4, 16_000)).relative_error());
        assert!((few / many - 4.0).abs() < 0.4, "{few} {many}");
        let mut black = Film::new(1, 1);
        (0..9).for_each(|_| black.add_sample(0, Vec3::ZERO));
        assert_eq!(black.relative_error(), f64::INFINITY);
    }

    #[test]
    fn a_million_samples_do_not_drift() {
        let mut film = Film::new(1, 1);
        (0..1_000_000).for_each(|_| film.add_sample(0, Vec3::splat(0.1)));
        assert_eq!(film.mean(), [[0.1; 3]]);
        assert!(film.standard_error()[0][0] < 1e-9);
    }
}
